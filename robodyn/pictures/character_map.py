"""Maps made of characters: coloured half blocks, shades, or plain marks.

In colours each character holds two dots, one above the other, which are about square; without
them it holds one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn.pictures.character_plot import FRAMES, LEAST_HEIGHT, LEAST_WIDTH, MARKS
from robodyn.pictures.chart import tick_texts, ticks
from robodyn.pictures.colour_scale import NONE, angle_ticks, painted, rgb, viridis, word_colours
from robodyn.pictures.column_units import unit_of
from robodyn.pictures.value_map import ValueMap
from robodyn.tables.csv_fields import shown

Array = NDArray[np.float64]
Colours = NDArray[np.uint8]  # (..., 3)
Flags = NDArray[np.bool_]

TALL = 2.0  # height to width of a character
SHADES = {False: "░▒▓█", True: ":-=+*#%@"}  # True: plain ones
NO_VALUE = {False: "·", True: "."}
NO_ROW = " "
BAR = 24  # most characters of the colour bar
LEAST_BAR = 6
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
    legend = _legend(content, max(LEAST_BAR, min(BAR, width - 20)), ascii, colours)
    beside = BESIDE + max(len(re.sub("\x1b[^m]*m", "", line)) for line in legend)
    fewest = max(LEAST_HEIGHT, height - AXIS - len(legend))
    y_values, y_texts = _ticks(content.y_name, bottom, top, max(3, fewest // 3), ascii)
    left = max(map(len, y_texts), default=0) + 2
    inside, rows = _extent(content, width - left, fewest)
    wider = _extent(content, width - left - beside, height - AXIS)
    fits = left + wider[0] + beside <= width and wider[1] >= len(legend)
    if fits and wider[1] > rows and wider[0] >= inside:
        inside, rows = wider
    else:
        beside = 0
    up = 2 if colours and not ascii else 1
    drawn = _drawn(content, inside, rows, up, ascii, colours)
    axis, corner, dash, cross = FRAMES[ascii]
    lines = [" " * (left - 1) + ("|" if ascii else "│")] * rows
    for value, text in zip(y_values, y_texts, strict=True):
        lines[rows - 1 - _place(value, bottom, top, rows)] = f"{text.rjust(left - 2)} {axis}"
    for k, line in enumerate(drawn):
        more = " " * BESIDE + legend[k] if beside and k < len(legend) else ""
        lines[k] = f"{lines[k]}{line}{more}".rstrip()
    x_values, x_texts = _ticks(content.x_name, left_edge, right_edge, max(3, inside // 10), ascii)
    at = [_place(value, left_edge, right_edge, inside) for value in x_values]
    foot = [corner, *dash * inside]
    for column in at:
        foot[1 + column] = cross
    return [
        " " * (left - 1) + _named(content.y_name, ascii),
        *lines,
        " " * (left - 1) + "".join(foot),
        _written([left + place for place in at], x_texts),
        _named(content.x_name, ascii).rjust(left + inside),
        *([] if beside else [" " * left + line for line in legend]),
    ]


def _extent(content: ValueMap, most_columns: int, most_rows: int) -> tuple[int, int]:
    """Columns and rows of characters, as many of each for every cell of the grid if they can."""
    columns, rows = max(LEAST_WIDTH, most_columns), max(LEAST_HEIGHT, most_rows)
    if content.to_scale:
        left, right, bottom, top = content.box
        flat = (right - left) / (top - bottom)
        columns = min(columns, round(rows * TALL * flat))
        rows = min(rows, max(LEAST_HEIGHT, round(columns / TALL / flat)))
    columns = max(columns, LEAST_WIDTH)
    if content.grid is not None:
        ny, nx = content.grid.row.shape
        columns = columns // nx * nx if nx <= columns else columns
        rows = rows // ny * ny if ny <= rows else rows
    return columns, rows


def _drawn(
    content: ValueMap, columns: int, rows: int, up: int, ascii: bool, colours: str
) -> list[str]:
    """The characters inside the frame, rows from the top."""
    row = content.rows_at(columns, rows * up)[::-1]
    there = row >= 0
    values = np.where(there, content.values[row], np.nan)
    if up == 2:
        shades = painted(values, content.scale, content.words)
        pairs = [slice(2 * k, 2 * k + 2) for k in range(rows)]
        return [_half_blocks(shades[p], there[p], colours) for p in pairs]
    marks = np.where(there, _marks(content, values, ascii), NO_ROW)
    if not colours:
        return ["".join(line) for line in marks.tolist()]
    shades = painted(values, content.scale, content.words)
    lines = zip(marks.tolist(), shades, there, strict=True)
    return [_coloured(*line, colours) for line in lines]


def _marks(content: ValueMap, values: Array, ascii: bool) -> NDArray[np.str_]:
    """The character of each value: of its word, or of its share of the scale."""
    none = np.isnan(values)
    characters = _word_marks(content) if content.words else list(SHADES[ascii])
    if content.words:
        level = np.where(none, 0.0, values)
    elif content.scale is not None:
        level = content.scale.fraction(np.where(none, content.scale.low, values)) * len(characters)
    else:
        level = np.zeros(values.shape)
    places = np.clip(level.astype(int), 0, len(characters) - 1)
    return np.where(none, NO_VALUE[ascii], np.array(characters)[places])


def _word_marks(content: ValueMap) -> list[str]:
    letters = MARKS + "abcdefghijklmn"
    return list(letters[: len(content.words)])


def _coloured(characters: Sequence[str], shades: Colours, there: Flags, colours: str) -> str:
    """Characters in their colours; a colour is told where it changes."""
    text, now = "", ""
    for character, shade, seen in zip(characters, shades.tolist(), there.tolist(), strict=True):
        wanted = _code(shade, colours) if seen else now
        text += (f"\x1b[38;{wanted}m" if wanted != now else "") + character
        now = wanted
    return text + ("\x1b[0m" if now else "")


def _half_blocks(shades: Colours, there: Flags, colours: str) -> str:
    """One line of characters from two of dots (2, columns, 3), the first above."""
    text, now = "", ("", "")
    for upper, lower, (above, below) in zip(*shades.tolist(), there.T.tolist(), strict=True):
        front, back, character = "", "", " "
        if above and below:
            front, back, character = _code(upper, colours), _code(lower, colours), "▀"
        elif above or below:
            front, character = _code(upper if above else lower, colours), "▀" if above else "▄"
        if (front, back) != now:
            text += "\x1b[0m" if not front or (now[1] and not back) else ""
            text += f"\x1b[38;{front}m" if front else ""
            text += f"\x1b[48;{back}m" if back else ""
            now = front, back
        text += character
    return text + ("\x1b[0m" if now[0] else "")


def _code(shade: Sequence[int], colours: str) -> str:
    """What tells a terminal this colour."""
    if colours == DEEP:
        return "2;{};{};{}".format(*shade)
    red, green, blue = shade
    if max(shade) - min(shade) < 12:  # a grey: 232 to 255 are 8, 18, ... 238
        return f"5;{232 + min(23, max(0, round((red - 8) / 10)))}"
    steps = (0, 95, 135, 175, 215, 255)
    near = [min(range(6), key=lambda k: abs(steps[k] - part)) for part in (red, green, blue)]
    return f"5;{16 + 36 * near[0] + 6 * near[1] + near[2]}"


def _legend(content: ValueMap, long: int, ascii: bool, colours: str) -> list[str]:
    """What colours and characters stand for."""
    name = _named(content.name, ascii)
    none = NO_VALUE[ascii] if not colours or ascii else "█"
    grey = _sample(none, rgb(NONE), colours) + " none" if content.has_none else ""
    if content.words:
        marks = _word_marks(content) if not colours or ascii else ["█"] * len(content.words)
        samples = [
            f"{_sample(mark, colour, colours)} {shown(word)[:60]}"
            for mark, colour, word in zip(
                marks, word_colours(len(content.words)), content.words, strict=True
            )
        ]
        return [f"{name}:", *samples, *([grey] if grey else [])]
    if content.scale is None:
        return [f"{name}: {grey}"]
    fractions = (np.arange(long) + 0.5) / long
    levels = SHADES[ascii]
    shades = viridis(fractions)
    bar = [levels[int(f * len(levels))] if not colours or ascii else "█" for f in fractions]
    text = _coloured(bar, shades, np.ones(long, bool), colours) if colours else "".join(bar)
    values, texts = content.scale.ticks(max(3, long // 7))
    at = (content.scale.fraction(np.array(values)) * (long - 1)).round().astype(int).tolist()
    named = f"{name}, log" if content.scale.log else name
    return [named, f"{text}  {grey}".rstrip(), _written(at, texts)]


def _sample(mark: str, colour: Sequence[int], colours: str) -> str:
    return f"\x1b[38;{_code(colour, colours)}m{mark}\x1b[0m" if colours else mark


def _ticks(
    name: str, low: float, high: float, most: int, ascii: bool
) -> tuple[list[float], list[str]]:
    if unit_of(name) == "rad":
        values, texts = angle_ticks(low, high, most)
        return values, [text.replace("π", "pi") for text in texts] if ascii else texts
    values = ticks(low, high, most)
    return values, tick_texts(values)


def _place(value: float, low: float, high: float, count: int) -> int:
    """Which of so many characters between two edges holds a value."""
    return min(count - 1, max(0, int((value - low) / (high - low) * count)))


def _written(at: Sequence[int], texts: Sequence[str]) -> str:
    """Texts below their places, less those that have no room."""
    line, end = "", -1
    for place, text in zip(at, texts, strict=True):
        begin = max(0, place - len(text) // 2)
        if begin > end:
            line = line.ljust(begin) + text
            end = len(line)
    return line


def _named(name: str, ascii: bool) -> str:
    unit = unit_of(name)
    text = f"{shown(name)} [{unit}]" if unit else shown(name)
    return text.replace("²", "^2").encode("ascii", "replace").decode() if ascii else text
