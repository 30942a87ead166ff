"""Pictures made of characters: braille dots, two across and four up in each, or plain marks.

canvas = Canvas(columns, rows)
canvas.line(z, owner)            # dots, x to the right and y up, from the lower left corner
canvas.lines()
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robodyn.pictures.chart import Chart, limits, spread, tick_texts, ticks

if TYPE_CHECKING:
    from robodyn.pictures.drawing import Drawing

Complex = NDArray[np.complex128]

BRAILLE = 0x2800
DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # row from the top, side
MARKS = "*+ox#@%&"  # of curves, where there are no dots
COLOURS = (34, 33, 32, 35, 36, 31)  # of a terminal
FRAMES = {False: tuple("┤│└─┬"), True: tuple("-|+-+")}  # True: plain ones
LEAST_WIDTH, LEAST_HEIGHT = 12, 3  # of a panel's inside, characters
TALL = 2.0  # height to width of a character
LINES = ("link", "support", "guide", "block", "spring")  # shapes of which outlines are drawn


class Canvas:
    """A field of characters; lines and texts have owners, which tell colours and plain marks."""

    def __init__(self, columns: int, rows: int, ascii: bool = False) -> None:
        self.columns, self.rows, self.ascii = columns, rows, ascii
        self.across, self.up = (1, 1) if ascii else (2, 4)  # dots of a character
        self.width, self.height = columns * self.across, rows * self.up  # dots
        self._dots = np.zeros((self.height, self.width), bool)
        self._owner = np.full((rows, columns), -1)
        self._text = np.full((rows, columns), "")

    def line(self, z: Complex, owner: int) -> None:
        """A line through points x + i y, dots from the centre of that at the lower left."""
        pieces = [z[-1:]]
        for a, b in zip(z[:-1].tolist(), z[1:].tolist(), strict=True):
            most = max(abs((b - a).real), abs((b - a).imag))
            count = min(4 * (self.width + self.height), math.ceil(most))
            pieces.append(a + (b - a) * np.arange(count) / max(count, 1))
        dots = np.concatenate(pieces)
        x, y = np.floor(dots.real + 0.5), np.floor(dots.imag + 0.5)
        seen = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        column, row = x[seen].astype(int), self.height - 1 - y[seen].astype(int)
        self._dots[row, column] = True
        self._owner[row // self.up, column // self.across] = owner

    def cell(self, dot: complex) -> tuple[int, int]:
        """The column and the row of the character in which a dot lies."""
        x, y = math.floor(dot.real + 0.5), math.floor(dot.imag + 0.5)
        return x // self.across, self.rows - 1 - y // self.up

    def text(self, column: int, row: int, text: str, owner: int = -1) -> None:
        """Characters over the dots, from a column to the right; rows count from the top."""
        for k, character in enumerate(text, column):
            if 0 <= k < self.columns and 0 <= row < self.rows:
                self._text[row, k], self._owner[row, k] = character, owner

    def lines(self, colour: bool = False) -> list[str]:
        """The rows from the top, without spaces at their ends."""
        if self.ascii:
            drawn = np.where(self._dots, np.array(list(MARKS))[self._owner % len(MARKS)], " ")
        else:
            blocks = self._dots.reshape(self.rows, 4, self.columns, 2)
            codes = np.einsum("rucs,us->rc", blocks, DOTS)
            drawn = np.where(codes, np.vectorize(chr)(BRAILLE + codes), " ")
        drawn = np.where(self._text == "", drawn, self._text)
        lines = ["".join(row).rstrip() for row in drawn.tolist()]
        if not colour:
            return lines

        def front(character: str, owner: int) -> str | None:
            told = str(COLOURS[owner % len(COLOURS)]) if owner >= 0 else ""
            return None if character == " " else told

        return [
            styled((c, front(c, owner), "") for c, owner in zip(line, row, strict=False))
            for line, row in zip(lines, self._owner.tolist(), strict=True)
        ]


def styled(cells: Iterable[tuple[str, str | None, str]]) -> str:
    """Characters with a terminal's codes of their colour and of that behind; None: as before."""
    text, now = "", ("", "")
    for character, front, back in cells:
        if front is not None and (front, back) != now:
            text += "\x1b[0m" if not front or (now[1] and not back) else ""
            now = front, back
            text += "".join(f"\x1b[{code}m" for code in now if code)
        text += character
    return text + ("\x1b[0m" if now[0] else "")


def plain(text: str, ascii: bool) -> str:
    """A name as it is, or of plain characters alone."""
    return text.replace("²", "^2").encode("ascii", "replace").decode() if ascii else text


def x_axis(
    name: str, at: Sequence[int], texts: Sequence[str], left: int, inside: int, ascii: bool
) -> list[str]:
    """The line below a picture with its ticks `at` columns of it, their texts, and its name."""
    _, _, corner, dash, cross = FRAMES[ascii]
    foot = "".join(cross if column in at else dash for column in range(inside))
    below = written([left + column for column in at], texts)
    return [" " * (left - 1) + corner + foot, below, plain(name, ascii).rjust(left + inside)]


def written(at: Sequence[int], texts: Sequence[str]) -> str:
    """Texts below their places, less those that have no room."""
    line, end = "", -1
    for place, text in zip(at, texts, strict=True):
        begin = max(0, place - len(text) // 2)
        if begin > end:
            line = line.ljust(begin) + text
            end = len(line)
    return line


def chart_lines(
    chart: Chart, width: int, height: int, ascii: bool = False, colour: bool = False
) -> list[str]:
    """The chart as lines of `width` characters at most, each panel `height` rows high or more.

    Curves are labelled at their right ends.
    """
    low, high = limits([curve.x for curve in chart.curves])
    scales = [limits([curve.y for curve in panel.curves]) for panel in chart.panels]
    numbers = [ticks(*scale, max(3, min(6, height // 2))) for scale in scales]
    left = max(len(text) for values in numbers for text in tick_texts(values)) + 2
    labels = [plain(curve.label, ascii) for curve in chart.curves]
    if ascii:
        labels = [f"{MARKS[k % len(MARKS)]} {label}" for k, label in enumerate(labels)]
    right = max(0, min(max(map(len, labels)) + 1, width - left - LEAST_WIDTH))
    inside = max(LEAST_WIDTH, width - left - right)
    tick, bar, *_ = FRAMES[ascii]
    lines: list[str] = []
    owner = 0
    for panel, values, (y_low, y_high) in zip(chart.panels, numbers, scales, strict=True):
        rows = max(height, LEAST_HEIGHT, len(panel.curves))
        canvas = Canvas(left + inside + right, rows, ascii)
        for row in range(rows):
            canvas.text(left - 1, row, bar)
        for value, text in zip(values, tick_texts(values), strict=True):
            row = rows - 1 - round((value - y_low) / (y_high - y_low) * (rows - 1))
            canvas.text(0, row, f"{text.rjust(left - 2)} {tick}")
        ends = []
        for k, curve in enumerate(panel.curves, owner):
            x = (curve.x - low) / (high - low) * (inside * canvas.across - 1)
            y = (curve.y - y_low) / (y_high - y_low) * (canvas.height - 1)
            canvas.line(left * canvas.across + x + 1j * y, k)
            ends.append(float(rows - 1 - y[curve.x.argmax()] / (canvas.height - 1) * (rows - 1)))
        for k, place in enumerate(spread(ends, 1.0, 0.0, rows - 1.0) or ends, owner):
            canvas.text(left + inside + 1, round(place), labels[k][: max(right - 1, 0)], k)
        if panel.label:
            lines.append(" " * (left - 1) + plain(panel.label, ascii))
        lines += canvas.lines(colour)
        owner += len(panel.curves)
    values = ticks(low, high, max(2, inside // 12))
    at = [round((value - low) / (high - low) * (inside - 1)) for value in values]
    return lines + x_axis(chart.x_label, at, tick_texts(values), left, inside, ascii)


def drawing_lines(
    drawn: Drawing,
    names: Sequence[str],
    width: int,
    height: int,
    ascii: bool = False,
    colour: bool = False,
) -> list[str]:
    """The poses of a mechanism to scale, as at most `height` lines of `width` characters at most.

    Outlines of links, supports and guides, an o for each joint, and the links' `names`, if any,
    at the last pose.
    """
    left, bottom, right, top = drawn.box()
    canvas = Canvas(width, height, ascii)
    stretch = canvas.up / canvas.across / TALL  # dots up for one across
    scale = min((canvas.width - 1) / (right - left), (canvas.height - 1) / (top - bottom) / stretch)
    rows = min(height, int((top - bottom) * scale * stretch / canvas.up) + 1)
    canvas = Canvas(width, rows, ascii)

    def dots(z: Complex) -> Complex:
        return np.asarray(scale * ((z.real - left) + 1j * stretch * (z.imag - bottom)), complex)

    joints = []
    for pose in range(len(drawn.q)):
        for b, shape, z in drawn.placed(pose):
            if shape.kind in LINES:
                line = np.append(z, z[0]) if shape.closed else z
                canvas.line(dots(line), drawn.bodies[b].link or 0)
            elif shape.kind == "joint":
                joints.append(dots(z).mean())
    for joint in joints:
        canvas.text(*canvas.cell(joint), "o")
    for k, name in enumerate(names):
        b = drawn.body_of(k)
        middle = 0.5 * drawn.mechanism.description.links[k].l
        column, row = canvas.cell(dots(drawn.place[-1:, b] + middle * drawn.turn[-1:, b])[0])
        canvas.text(max(0, min(column + 2, width - len(name))), row, name, k)
    return canvas.lines(colour)
