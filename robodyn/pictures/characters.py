"""Charts made of characters, and what they are drawn on.

canvas = Canvas(columns, rows)   # braille dots, two across and four up in each, or plain marks
canvas.line(z, owner)            # dots, x to the right and y up, from the lower left corner
canvas.lines()
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from robodyn.pictures.chart import Chart, limits, spread, tick_texts, ticks
from robodyn.tables.arrays import Complex

BRAILLE = 0x2800
DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # row from the top, side
MARKS = "*+ox#@%&"  # of curves, where there are no dots
COLOURS = (34, 33, 32, 35, 36, 31)  # of a terminal
FRAMES = {False: tuple("┤│└─┬"), True: tuple("-|+-+")}  # True: plain ones
LEAST_WIDTH, LEAST_HEIGHT = 12, 3  # of a panel's inside, characters


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
            styled((c, front(c, owner)) for c, owner in zip(line, row, strict=False))
            for line, row in zip(lines, self._owner.tolist(), strict=True)
        ]


def styled(cells: Iterable[tuple[str, str | None]]) -> str:
    """Characters with a terminal's codes of their colours; None: as before."""
    text, now = "", ""
    for character, front in cells:
        if front is not None and front != now:
            text += f"\x1b[{front or 0}m"
            now = front
        text += character
    return text + ("\x1b[0m" if now else "")


def plain(text: str, ascii: bool) -> str:
    """A name as it is, or of plain characters alone."""
    return text.replace("²", "^2").encode("ascii", "replace").decode() if ascii else text


def y_axis(at: Sequence[int], texts: Sequence[str], rows: int, left: int, ascii: bool) -> list[str]:
    """What stands at the left of each row: a line with its ticks at some rows, and their texts."""
    tick, bar, *_ = FRAMES[ascii]
    edge = [" " * (left - 1) + bar] * rows
    for row, text in zip(at, texts, strict=True):
        edge[row] = f"{text.rjust(left - 2)} {tick}"
    return edge


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
    lines: list[str] = []
    owner = 0
    for panel, values, (y_low, y_high) in zip(chart.panels, numbers, scales, strict=True):
        rows = max(height, LEAST_HEIGHT, len(panel.curves))
        canvas = Canvas(inside + right, rows, ascii)
        at = [rows - 1 - round((v - y_low) / (y_high - y_low) * (rows - 1)) for v in values]
        edge = y_axis(at, tick_texts(values), rows, left, ascii)
        ends = []
        for k, curve in enumerate(panel.curves, owner):
            x = (curve.x - low) / (high - low) * (inside * canvas.across - 1)
            y = (curve.y - y_low) / (y_high - y_low) * (canvas.height - 1)
            for run in curve.runs:
                canvas.line((x + 1j * y)[run], k)
            end = y[curve.seen[curve.x[curve.seen].argmax()]]
            ends.append(float(rows - 1 - end / (canvas.height - 1) * (rows - 1)))
        for k, place in enumerate(spread(ends, 1.0, 0.0, rows - 1.0) or ends, owner):
            canvas.text(inside + 1, round(place), labels[k][: max(right - 1, 0)], k)
        if panel.label:
            lines.append(" " * (left - 1) + plain(panel.label, ascii))
        lines += map(str.__add__, edge, canvas.lines(colour))
        owner += len(panel.curves)
    values = ticks(low, high, max(2, inside // 12))
    at = [round((value - low) / (high - low) * (inside - 1)) for value in values]
    return lines + x_axis(chart.x_label, at, tick_texts(values), left, inside, ascii)
