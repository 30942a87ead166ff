"""Maps made of characters: coloured half blocks, shades, or plain marks.

In colours each character holds two dots, one above the other, which are about square; without
them it holds one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn.pictures.character_plot import (
    FRAMES,
    LEAST_HEIGHT,
    LEAST_WIDTH,
    MARKS,
    TALL,
    plain,
    styled,
    written,
    x_axis,
)
from robodyn.pictures.colour_scale import NONE, axis_ticks, painted, rgb, viridis, word_colours
from robodyn.pictures.column_units import with_unit
from robodyn.pictures.value_map import ValueMap
from robodyn.tables.csv_fields import shown

Array = NDArray[np.float64]

SHADES = {False: "░▒▓█", True: ":-=+*#%@"}  # True: plain ones
NO_VALUE = {False: "·", True: "."}
LETTERS = MARKS + "abcdefghijklmn"  # of words
LEAST_BAR, BAR = 6, 24  # characters of the colour bar
AXIS = 4  # lines above and below the map
BESIDE = 3  # characters between the map and what stands beside it
DEEP, PALETTE = "deep", "palette"  # how a terminal is told colours: 24 bits, or 256 numbered ones


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
    y_values, y_texts = axis_ticks(content.y_name, bottom, top, max(3, fewest // 3), ascii)
    left = max(map(len, y_texts), default=0) + 2
    inside, rows = _extent(content, width - left, fewest)
    wider = _extent(content, width - left - beside, height - AXIS)
    fits = left + wider[0] + beside <= width and wider[1] >= len(legend)
    aside = fits and wider[1] > rows and wider[0] >= inside
    inside, rows = wider if aside else (inside, rows)
    tick, bar, *_ = FRAMES[ascii]
    edge = [" " * (left - 1) + bar] * rows
    for value, text in zip(y_values, y_texts, strict=True):
        edge[rows - 1 - _place(value, bottom, top, rows)] = f"{text.rjust(left - 2)} {tick}"
    more = [" " * BESIDE + line for line in legend] if aside else []
    more += [""] * (rows - len(more))
    drawn = zip(edge, _drawn(content, inside, rows, ascii, colours), more, strict=True)
    x_most = max(3, inside // 10)
    x_values, x_texts = axis_ticks(content.x_name, left_edge, right_edge, x_most, ascii)
    at = [_place(value, left_edge, right_edge, inside) for value in x_values]
    return [
        " " * (left - 1) + plain(with_unit(shown(content.y_name)), ascii),
        *("".join(parts).rstrip() for parts in drawn),
        *x_axis(with_unit(shown(content.x_name)), at, x_texts, left, inside, ascii),
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
    """The characters inside the frame, rows from the top."""
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
    """What tells a terminal this colour."""
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

    name = plain(with_unit(shown(content.name)), ascii)
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
