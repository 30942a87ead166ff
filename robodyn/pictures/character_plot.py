"""Pictures made of characters: braille dots, two across and four up in each, or plain marks.

canvas = Canvas(columns, rows)
canvas.line(z, owner)            # dots, x to the right and y up, from the lower left corner
canvas.lines()
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn.pictures.chart import Chart, Curve, Panel, limits, spread, tick_texts, ticks

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

BRAILLE = 0x2800
DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # row from the top, side
MARKS = "*+ox#@%&"  # of curves, where there are no dots
COLOURS = (34, 33, 32, 35, 36, 31)  # of a terminal
FRAMES = {False: ("┤", "└", "─", "┬"), True: ("-", "+", "-", "+")}  # True: plain ones
LEAST_WIDTH, LEAST_HEIGHT = 12, 3  # of a panel's inside, characters


class Canvas:
    """A field of characters; lines have owners, which tell colours and plain marks."""

    def __init__(self, columns: int, rows: int, ascii: bool = False) -> None:
        self.columns, self.rows, self.ascii = columns, rows, ascii
        self.across, self.up = (1, 1) if ascii else (2, 4)  # dots of a character
        self._dots = np.zeros((rows * self.up, columns * self.across), bool)
        self._owner = np.full((rows, columns), -1)
        self._text: dict[tuple[int, int], tuple[str, int]] = {}

    @property
    def width(self) -> int:
        """Dots across."""
        return self._dots.shape[1]

    @property
    def height(self) -> int:
        """Dots up."""
        return self._dots.shape[0]

    def line(self, z: Complex, owner: int) -> None:
        """A line through points x + i y, dots from the centre of that at the lower left."""
        for a, b in zip(z[:-1].tolist(), z[1:].tolist(), strict=True):
            most = max(abs((b - a).real), abs((b - a).imag))
            count = min(4 * (self.width + self.height), math.ceil(most))
            self._set(a + (b - a) * np.arange(count) / max(count, 1), owner)
        self._set(z[-1:], owner)

    def cell(self, dot: complex) -> tuple[int, int]:
        """The column and the row of the character in which a dot lies."""
        x, y = math.floor(dot.real + 0.5), math.floor(dot.imag + 0.5)
        return x // self.across, self.rows - 1 - y // self.up

    def _set(self, z: Complex, owner: int) -> None:
        x, y = np.floor(z.real + 0.5), np.floor(z.imag + 0.5)
        seen = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        column, row = x[seen].astype(int), self.height - 1 - y[seen].astype(int)
        self._dots[row, column] = True
        self._owner[row // self.up, column // self.across] = owner

    def text(self, column: int, row: int, text: str, owner: int = -1) -> None:
        """Characters over the dots, from a column to the right; rows count from the top."""
        for k, character in enumerate(text):
            if 0 <= column + k < self.columns and 0 <= row < self.rows:
                self._text[row, column + k] = character, owner

    def lines(self, colour: bool = False) -> list[str]:
        """The rows from the top, without spaces at their ends."""
        if self.ascii:
            marks = [MARKS[owner % len(MARKS)] for owner in range(self._owner.max(initial=0) + 1)]
            drawn = np.where(self._dots, np.array(marks)[self._owner], " ")
        else:
            blocks = self._dots.reshape(self.rows, 4, self.columns, 2)
            codes = np.einsum("rucs,us->rc", blocks, DOTS)
            drawn = np.where(codes, np.vectorize(chr)(BRAILLE + codes), " ")
        rows = []
        for r in range(self.rows):
            cells = [(str(drawn[r, c]), int(self._owner[r, c])) for c in range(self.columns)]
            for c in range(self.columns):
                cells[c] = self._text.get((r, c), cells[c])
            rows.append(_joined(cells, colour))
        return rows


def _joined(cells: Sequence[tuple[str, int]], colour: bool) -> str:
    if not colour:
        return "".join(character for character, _ in cells).rstrip()
    text, now = "", -1
    for character, owner in cells:
        wanted = now if character == " " else owner
        if wanted != now:
            text += "\x1b[0m" if wanted < 0 else f"\x1b[{COLOURS[wanted % len(COLOURS)]}m"
            now = wanted
        text += character
    return text.rstrip() + ("\x1b[0m" if now >= 0 else "")


def chart_lines(
    chart: Chart, width: int, height: int, ascii: bool = False, colour: bool = False
) -> list[str]:
    """The chart as lines of `width` characters at most, each panel `height` rows high or more.

    Curves are labelled at their right ends.
    """
    low, high = limits([curve.x for curve in chart.curves])
    numbers = [_y_ticks(panel, height) for panel in chart.panels]
    left = max(len(text) for _, texts in numbers for text in texts) + 2
    labels = [_label(chart, curve, ascii) for curve in chart.curves]
    right = max(map(len, labels)) + 1
    if width - left - right < LEAST_WIDTH:
        right = max(0, width - left - LEAST_WIDTH)
    inside = max(LEAST_WIDTH, width - left - right)
    lines: list[str] = []
    first = 0
    for panel, (values, texts) in zip(chart.panels, numbers, strict=True):
        rows = max(height, LEAST_HEIGHT, len(panel.curves))
        canvas = Canvas(left + inside + right, rows, ascii)
        y_low, y_high = limits([curve.y for curve in panel.curves])
        for row in range(rows):
            canvas.text(left - 1, row, "|" if ascii else "│")
        for value, text in zip(values, texts, strict=True):
            row = rows - 1 - round((value - y_low) / (y_high - y_low) * (rows - 1))
            canvas.text(0, row, text.rjust(left - 2) + " " + FRAMES[ascii][0])
        dots_left, dots_wide = left * canvas.across, inside * canvas.across - 1
        ends = []
        for k, curve in enumerate(panel.curves):
            x = dots_left + (curve.x - low) / (high - low) * dots_wide
            y = (curve.y - y_low) / (y_high - y_low) * (canvas.height - 1)
            canvas.line(x + 1j * y, first + k)
            ends.append(float(rows - 1 - y[curve.x.argmax()] / (canvas.height - 1) * (rows - 1)))
        places = spread(ends, 1.0, 0.0, rows - 1.0) or ends
        for k, place in enumerate(places):
            label = labels[first + k][: max(right - 1, 0)]
            canvas.text(left + inside + 1, round(place), label, first + k)
        if panel.label:
            lines.append(" " * (left - 1) + _plain(panel.label, ascii))
        lines += canvas.lines(colour)
        first += len(panel.curves)
    return lines + _x_axis(chart.x_label, low, high, left, inside, ascii)


def _label(chart: Chart, curve: Curve, ascii: bool) -> str:
    """A curve's name, with its mark where marks tell curves apart."""
    mark = MARKS[chart.curves.index(curve) % len(MARKS)]
    return f"{mark} {curve.label}" if ascii else curve.label


def _plain(label: str, ascii: bool) -> str:
    return label.replace("²", "^2") if ascii else label


def _y_ticks(panel: Panel, height: int) -> tuple[list[float], list[str]]:
    low, high = limits([curve.y for curve in panel.curves])
    values = ticks(low, high, max(3, min(6, height // 2)))
    return values, tick_texts(values)


def _x_axis(label: str, low: float, high: float, left: int, inside: int, ascii: bool) -> list[str]:
    """The line below the panels, its numbers, and its name at the right."""
    values = ticks(low, high, max(2, inside // 12))
    _, corner, dash, cross = FRAMES[ascii]
    line, below = [corner, *dash * inside], [" "] * (left + inside + 8)
    for value, text in zip(values, tick_texts(values), strict=True):
        column = round((value - low) / (high - low) * (inside - 1))
        line[1 + column] = cross
        begin = max(0, left + column - len(text) // 2)
        below[begin : begin + len(text)] = text
    name = _plain(label, ascii).rjust(left + inside)
    return [" " * (left - 1) + "".join(line), "".join(below).rstrip(), name]
