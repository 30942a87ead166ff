"""Charts and maps made of characters, and what they are drawn on.

canvas = Canvas(columns, rows)   # braille dots, two across and four up in each, or plain marks
canvas.line(z, owner)            # dots, x to the right and y up, from the lower left corner
canvas.lines()

A map is of coloured half blocks, two dots one above the other in each character, which are about
square; without colours of shades or plain marks, one in each.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn.pictures.chart import Chart, limits, spread, tick_texts, ticks
from robodyn.pictures.colour_scale import NONE, axis_ticks, painted, rgb, viridis, word_colours
from robodyn.pictures.column_units import unit_of, with_unit
from robodyn.pictures.value_map import ValueMap
from robodyn.tables.arrays import Array, Complex
from robodyn.tables.csv_fields import shown

BRAILLE = 0x2800
DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # row from the top, side
MARKS = "*+ox#@%&"  # of curves, where there are no dots
COLOURS = (34, 33, 32, 35, 36, 31)  # of a terminal
FRAMES = {False: tuple("┤│└─┬"), True: tuple("-|+-+")}  # True: plain ones
LEAST_WIDTH, LEAST_HEIGHT = 12, 3  # of a panel's inside, characters
TALL = 2.0  # height to width of a character
SHADES = {False: "░▒▓█", True: ":-=+*#%@"}  # True: plain ones
NO_VALUE = {False: "·", True: "."}
LETTERS = MARKS + "abcdefghijklmn"  # of words
LEAST_BAR, BAR = 6, 24  # characters of the colour bar
AXIS = 4  # lines above and below the map
BESIDE = 3  # characters between the map and what stands beside it
DEEP, PALETTE = "deep", "palette"  # how a terminal is told colours: 24 bits, or 256 numbered ones


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


def map_lines(
    content: ValueMap, width: int, height: int, ascii: bool = False, colours: str = ""
) -> list[str]:
    """The map as lines of `width` characters at most, about `height` of them.

    With `colours` (DEEP or PALETTE) in those of a terminal.
    """
    left_edge, right_edge, bottom, top = content.box
    long = max(LEAST_BAR, min(BAR, width - 20))
    legend = _legend(content, long, ascii, colours)
    beside = BESIDE + max(map(len, _legend(content, long, ascii, "")))
    fewest = max(LEAST_HEIGHT, height - AXIS - len(legend))
    x_unit, y_unit = (unit_of(name, content.units) for name in (content.x_name, content.y_name))
    y_values, y_texts = axis_ticks(y_unit, bottom, top, max(3, fewest // 3), ascii)
    left = max(map(len, y_texts), default=0) + 2
    inside, rows = _extent(content, width - left, fewest)
    wider = _extent(content, width - left - beside, height - AXIS)
    fits = left + wider[0] + beside <= width and wider[1] >= len(legend)
    aside = fits and wider[1] > rows and wider[0] >= inside
    inside, rows = wider if aside else (inside, rows)
    at = [rows - 1 - _place(value, bottom, top, rows) for value in y_values]
    edge = y_axis(at, y_texts, rows, left, ascii)
    more = [" " * BESIDE + line for line in legend] if aside else []
    more += [""] * (rows - len(more))
    drawn = zip(edge, _drawn(content, inside, rows, ascii, colours), more, strict=True)
    x_most = max(3, inside // 10)
    x_values, x_texts = axis_ticks(x_unit, left_edge, right_edge, x_most, ascii)
    at = [_place(value, left_edge, right_edge, inside) for value in x_values]
    return [
        " " * (left - 1) + plain(with_unit(shown(content.y_name), content.units), ascii),
        *("".join(parts).rstrip() for parts in drawn),
        *x_axis(with_unit(shown(content.x_name), content.units), at, x_texts, left, inside, ascii),
        *([] if aside else [" " * left + line for line in legend]),
    ]


def _extent(content: ValueMap, most_columns: int, most_rows: int) -> tuple[int, int]:
    """Columns and rows of characters, as many of each for every cell of the grid if they can."""
    columns, rows = max(LEAST_WIDTH, most_columns), max(LEAST_HEIGHT, most_rows)
    if content.to_scale:
        columns = min(columns, round(rows * TALL * content.flat))
        rows = min(rows, max(LEAST_HEIGHT, round(columns / TALL / content.flat)))
    columns = max(columns, LEAST_WIDTH)
    if content.grid is not None:
        ny, nx = content.grid.row.shape
        columns = columns // nx * nx or columns
        rows = rows // ny * ny or rows
    return columns, rows


def _drawn(content: ValueMap, columns: int, rows: int, ascii: bool, colours: str) -> list[str]:
    blocks = bool(colours) and not ascii
    row = content.rows_at(columns, rows * (1 + blocks))[::-1]
    there = row >= 0
    values = np.where(there, content.values[row], np.nan)
    marks = np.where(there, _marks(content, values, ascii), " ")
    if not colours:
        return ["".join(line) for line in marks.tolist()]
    shades = painted(values, content.scale, content.words)
    codes = [
        [_code(shade, colours) if seen else "" for shade, seen in zip(*line, strict=True)]
        for line in zip(shades.tolist(), there.tolist(), strict=True)
    ]
    if blocks:
        pairs = zip(codes[::2], codes[1::2], strict=True)
        return [styled(map(_half_block, *pair)) for pair in pairs]
    lines = zip(marks.tolist(), codes, strict=True)
    return [
        styled((mark, f"38;{code}" if code else None, "") for mark, code in zip(*line, strict=True))
        for line in lines
    ]


def _half_block(above: str, below: str) -> tuple[str, str, str]:
    """The character of two dots, with its colour and that behind; "" is no dot."""
    front, back = above or below, below if above else ""
    block = "▀" if above else "▄" if below else " "
    return block, front and f"38;{front}", back and f"48;{back}"


def _marks(content: ValueMap, values: Array, ascii: bool) -> NDArray[np.str_]:
    """The character of each value: of its word, or of its share of the scale."""
    marks = np.array(list(LETTERS if content.words else SHADES[ascii]))
    level = values
    if content.scale is not None:
        level = content.scale.fraction(values) * len(marks)
    places = np.nan_to_num(level).astype(int).clip(0, len(marks) - 1)
    return np.where(np.isnan(values), NO_VALUE[ascii], marks[places])


def _code(shade: Sequence[int], colours: str) -> str:
    if colours == DEEP:
        return "2;{};{};{}".format(*shade)
    if max(shade) - min(shade) < 12:  # a grey: 232 to 255 are 8, 18, ... 238
        return f"5;{232 + min(23, max(0, round((shade[0] - 8) / 10)))}"
    steps = (0, 95, 135, 175, 215, 255)
    red, green, blue = (min(range(6), key=lambda k: abs(steps[k] - part)) for part in shade)
    return f"5;{16 + 36 * red + 6 * green + blue}"


def _legend(content: ValueMap, long: int, ascii: bool, colours: str) -> list[str]:
    """What colours and characters stand for."""

    def sample(marks: Sequence[str], shades: Sequence[Sequence[int]]) -> str:
        marks = "█" * len(marks) if colours and not ascii else marks
        codes = [f"38;{_code(shade, colours)}" if colours else "" for shade in shades]
        return styled(zip(marks, codes, [""] * len(marks), strict=True))

    name = plain(with_unit(shown(content.name), content.units), ascii)
    grey = [sample(NO_VALUE[ascii], [rgb(NONE)]) + " none"] if content.has_none else []
    if content.words:
        count = len(content.words)
        told = zip(LETTERS[:count], word_colours(count), content.words, strict=True)
        samples = [f"{sample(mark, [colour])} {shown(word)[:60]}" for mark, colour, word in told]
        return [f"{name}:", *samples, *grey]
    if content.scale is None:
        return [f"{name}: {grey[0]}"]
    fractions = (np.arange(long) + 0.5) / long
    levels = SHADES[ascii]
    bar = sample([levels[int(f * len(levels))] for f in fractions], viridis(fractions).tolist())
    values, texts = content.scale.ticks(max(3, long // 7))
    at = (content.scale.fraction(np.array(values)) * (long - 1)).round().astype(int).tolist()
    named = f"{name}, log" if content.scale.log else name
    return [named, "  ".join([bar, *grey]), written(at, texts)]


def _place(value: float, low: float, high: float, count: int) -> int:
    """Which of so many characters between two edges holds a value."""
    return min(count - 1, max(0, int((value - low) / (high - low) * count)))
