"""A map: values over two columns, as the cells of a grid or as points, and the colours they get."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.columns import TURNING, check_degrees, in_degrees, unit_of
from robodyn.errors import InputError, at_place
from robodyn.pictures.chart import (
    Opened,
    Rows,
    choose_columns,
    choose_x,
    drawable,
    limits,
    multiples,
    place_of,
    tell_gaps,
    tick_texts,
    ticks,
)
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import finite, is_missing, shown, split_fields, unquoted
from robodyn.tables.table import Reader

Rgb = tuple[int, int, int]

# Okabe and Ito's colours, which colour-blind people tell apart
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#222222")
NONE = "#d4d4d4"  # a point without a value
# matplotlib's viridis (van der Walt and Smith, 2015) at 17 even places: as much lighter as larger
VIRIDIS = (
    *("#440154", "#48186a", "#472d7b", "#424086", "#3b528b", "#33638d", "#2c728e", "#26818e"),
    *("#21908c", "#1f9f88", "#28ae80", "#3ebc74", "#5dc963", "#82d34c", "#abdc32", "#d5e21a"),
    "#fde725",
)
LEVELS = 160  # shades of a scale


class ColourScale(NamedTuple):
    """The values from `low` to `high`, linear or logarithmic, over [0, 1]."""

    low: float
    high: float
    log: bool

    def fraction(self, values: Array) -> Array:
        """Return the position of values along the scale, 0 to 1; nan stays nan."""
        low, high = self.low, self.high
        if self.log:
            values, low, high = np.log(values), math.log(low), math.log(high)
        # in halves: high - low itself may overflow
        far = (0.5 * values - 0.5 * low) / (0.5 * high - 0.5 * low)
        return np.asarray(np.clip(far, 0.0, 1.0))

    def ticks(self, most: int) -> tuple[list[float], list[str]]:
        """At most `most` round values along the scale, and their texts."""
        values = log_ticks(self.low, self.high, most) if self.log else []
        if len(values) < 2:
            values = ticks(self.low, self.high, most)
        return values, tick_texts(values)


def colour_scale(values: Array, log: bool) -> ColourScale | None:
    """The scale of values (k,) of which some may be nan; None where all are.

    A logarithmic one takes values > 0.
    """
    there = values[np.isfinite(values)]
    if not len(there):
        return None
    if not log:
        return ColourScale(*limits([there]), False)
    low, high = float(there.min()), float(there.max())
    if high - low <= 1e-12 * high:
        low, high = max(0.5 * low, math.ulp(0.0)), 2.0 * high
    return ColourScale(low, high, True)


def log_ticks(low: float, high: float, most: int) -> list[float]:
    """At most `most` of 1, 2 and 5, or 1, times powers of ten (or of 100, ...) in [low, high]."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    found: list[float] = []
    for factors, apart in [("125", 1), ("13", 1), *(("1", k) for k in range(1, 700))]:
        powers = range(math.ceil(first / apart) * apart, last + 1, apart)
        marks = [float(f"{factor}e{power}") for power in powers for factor in factors]
        found = [mark for mark in marks if low * (1 - 1e-9) <= mark <= high * (1 + 1e-9)]
        if len(found) <= most:
            break
    return found


def angle_ticks(low: float, high: float, most: int) -> tuple[list[float], list[str]]:
    """Ticks of an axis in radians: multiples of pi/4, pi/2 or pi where there are three or more."""
    for parts, factor in ((4, 1), (2, 1), (1, 1), (1, 2), (1, 5), (1, 10)):
        apart = math.pi * factor / parts
        numbers = multiples(low, high, apart)
        if len(numbers) <= most:
            break
    if not 3 <= len(numbers) <= most:
        values = ticks(low, high, most)
        return values, tick_texts(values)
    return [k * apart for k in numbers], [_multiple_of_pi(k * factor, parts) for k in numbers]


def _multiple_of_pi(number: int, parts: int) -> str:
    shared = math.gcd(number, parts)
    number, parts = number // shared, parts // shared
    text = {0: "0", 1: "π", -1: "-π"}.get(number, f"{number}π")
    return f"{text}/{parts}" if parts > 1 and number else text


def rgb(colour: str) -> Rgb:
    """Red, green and blue of `#rrggbb`, 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def viridis(fractions: Array) -> NDArray[np.uint8]:
    """The colours (..., 3) of fractions (...), 0 dark to 1 bright."""
    places = np.linspace(0.0, 1.0, len(VIRIDIS))
    parts = np.array([rgb(colour) for colour in VIRIDIS], float).T
    shades = np.stack([np.interp(fractions, places, part) for part in parts], axis=-1)
    return np.asarray(np.round(shades), np.uint8)


def word_colours(count: int) -> list[Rgb]:
    """A colour for each of so many words: those that differ most while they last."""
    if count <= len(COLOURS):
        return [rgb(colour) for colour in COLOURS[:count]]
    return [(r, g, b) for r, g, b in viridis(np.linspace(0.0, 1.0, count)).tolist()]


def painted(values: Array, scale: ColourScale | None, words: Sequence[str]) -> NDArray[np.uint8]:
    """Colours (..., 3) of values (...): numbers on the scale, or places in `words`; nan is NONE."""
    if scale is None:
        table, places = np.array([*word_colours(len(words)), rgb(NONE)], np.uint8), values
    else:
        table, places = viridis(np.linspace(0.0, 1.0, LEVELS)), scale.fraction(values)
        places = np.rint(places * (LEVELS - 1))
    shades: NDArray[np.uint8] = table[np.nan_to_num(places).astype(int)]
    shades[np.isnan(values)] = rgb(NONE)
    return shades


MOST_WORDS = 20  # that colours can tell apart
ALIKE = 1e-9  # of the span: values of x this close are one line of the grid
EVEN = 0.1  # of a step, by which a line of an even grid may be off its place
MOST_LINES = 1.25  # times those with points has an even grid
LEAST_FILLED = 0.5  # of the cells of a grid have more than this share a row
MOST_FLAT = 5.0  # width to height, or height to width, of a map to scale


class Grid(NamedTuple):
    """Cells with edges x (nx + 1,) and y (ny + 1,), rising.

    `row` (ny, nx) is the row of the table that each cell shows, -1 where there is none; `hidden`
    counts the rows that show nowhere, as a later one has the same cell.
    """

    x_edges: Array
    y_edges: Array
    row: Rows
    hidden: int


class ValueMap(NamedTuple):
    """Values (T,) at points x, y (T,).

    Values are numbers on a scale, or places in `words`; nan is a point without a value.
    """

    x_name: str
    y_name: str
    name: str
    x: Array
    y: Array
    values: Array
    words: tuple[str, ...]
    scale: ColourScale | None
    grid: Grid | None
    units: Mapping[str, str] = TURNING  # of the scene

    @property
    def has_none(self) -> bool:
        """Whether a point has no value."""
        return bool(np.isnan(self.values).any())

    @property
    def box(self) -> tuple[float, float, float, float]:
        """The least and the largest x, then y, that are drawn."""
        if self.grid is None:
            return (*limits([self.x]), *limits([self.y]))
        x, y = self.grid.x_edges, self.grid.y_edges
        return float(x[0]), float(x[-1]), float(y[0]), float(y[-1])

    @property
    def flat(self) -> float:
        """Its extent along x to that along y."""
        left, right, bottom, top = self.box
        return (right - left) / (top - bottom)

    @property
    def to_scale(self) -> bool:
        """Whether x and y have one unit, and extents that can be drawn to one scale."""
        alike = unit_of(self.x_name, self.units) == unit_of(self.y_name, self.units) != ""
        return alike and 1.0 / MOST_FLAT <= self.flat <= MOST_FLAT

    def rows_at(self, columns: int, rows: int) -> Rows:
        """The row of the table (rows, columns) at each dot of a raster over the box, -1 for none.

        y rises from raster row to raster row.  A cell of a grid shows at the dots whose centres it
        holds; of several points in a dot the last shows, and one with a value before one without.
        """
        left, right, bottom, top = self.box
        if self.grid is not None:
            x = left + (np.arange(columns) + 0.5) / columns * (right - left)
            y = bottom + (np.arange(rows) + 0.5) / rows * (top - bottom)
            column = np.searchsorted(self.grid.x_edges, x).clip(1, self.grid.row.shape[1]) - 1
            row = np.searchsorted(self.grid.y_edges, y).clip(1, self.grid.row.shape[0]) - 1
            found: Rows = self.grid.row[row[:, None], column]
            return found
        column = ((self.x - left) / (right - left) * columns).astype(int).clip(0, columns - 1)
        row = ((self.y - bottom) / (top - bottom) * rows).astype(int).clip(0, rows - 1)
        found = np.full((rows, columns), -1)
        for group in (np.isnan(self.values), ~np.isnan(self.values)):
            found[row[group], column[group]] = np.flatnonzero(group)
        return found


def value_map(
    names: tuple[str, str, str],
    x: Array,
    y: Array,
    values: Array,
    words: Sequence[str] = (),
    log: bool = False,
) -> ValueMap:
    """The map of the columns `names`: x, y and colour.  Arrays (T,), as ValueMap has them.

    Raises InputError where there is no row, or a number is too large to be drawn.
    """
    if not len(x):
        raise InputError("no rows", limit="the header is followed by no row: nothing to draw")
    x, y = drawable(names[0], x), drawable(names[1], y)
    if not words:
        values = drawable(names[2], values, flush=not log)
    scale = None if words else colour_scale(values, log)
    return ValueMap(*names, x, y, values, tuple(words), scale, find_grid(x, y))


def read_map(
    tables: Iterable[Opened],
    x: str,
    patterns: Sequence[str],
    colour: str,
    log: bool,
    units: Mapping[str, str],
    degrees: bool,
    tell: Callable[[str], object],
) -> ValueMap:
    """The map of the column `colour` over x and the one that the patterns name.

    Points that others hide are told, and rows that are left out, as they have no place.
    """
    fields: list[tuple[str, str]] = []
    blocks, ys = [np.zeros((0, 2))], []
    for table in tables:
        with table as (stream, source):
            reader = Reader(stream, source, gaps=True)
            choose_x(reader.header, x, source)
            ys += choose_columns(reader.header, patterns, x, source)
            if len(set(ys)) > 1:
                told = ", ".join(dict.fromkeys(ys))
                raise InputError("--y", value=told, limit="a map has one column along y")
            place, begin = place_of(colour, "--colour", reader.header, source), len(blocks)
            for chunk in reader.chunks([x, ys[0]]):
                for line, number in zip(chunk.lines, chunk.line_numbers, strict=True):
                    text = unquoted(split_fields(line)[place]).strip()
                    fields.append((text, f"{source}: line {number}"))
                blocks.append(chunk.values)
            if len(blocks) > begin:
                tell_gaps([x, ys[0]], np.concatenate(blocks[begin:]), source, tell)
    values, words = colour_values(colour, fields, log)
    if log and words:
        limit = "needs a column of numbers; this one holds words"
        raise InputError("--log", value=shown(colour), limit=limit)
    columns, names = np.concatenate(blocks).T, (x, ys[0], colour)
    placed = ~np.isnan(columns).any(axis=0)
    columns, values = columns[:, placed], values[placed]
    if degrees:
        check_degrees(names, units)
    scaled = [in_degrees(name, units) if degrees else (name, 1.0) for name in names]
    (x_name, across), (y_name, up), (name, factor) = scaled
    shades = values if words else factor * values
    names = x_name, y_name, name
    with at_place(source, "no rows"):
        mapped = value_map(names, across * columns[0], up * columns[1], shades, words, log)
    if mapped.grid is not None and mapped.grid.hidden:
        tell(f"Note: {mapped.grid.hidden} rows are hidden by later ones with the same {x}, {ys[0]}")
    return mapped._replace(units=units)


def find_grid(x: Array, y: Array) -> Grid | None:
    """The grid on which the points x, y (T,) lie, None where they fill half of none.

    Lines of an even grid that have no point at all are found too.
    """
    x_lines, y_lines = _lines(x), _lines(y)
    cells = len(x_lines) * len(y_lines)
    if min(len(x_lines), len(y_lines)) < 2 or len(x) <= LEAST_FILLED * cells:
        return None
    x_edges, y_edges = _edges(x_lines), _edges(y_lines)
    row = np.full((len(y_lines), len(x_lines)), -1)
    row[np.searchsorted(y_edges, y) - 1, np.searchsorted(x_edges, x) - 1] = np.arange(len(x))
    filled = int((row >= 0).sum())
    if filled <= LEAST_FILLED * cells:
        return None
    return Grid(x_edges, y_edges, row, len(x) - filled)


def _lines(values: Array) -> Array:
    """The different values, rising, and those that an even grid of them lacks."""
    lines: Array = np.unique(values)
    if len(lines) < 2:
        return lines
    span = lines[-1] - lines[0]
    lines = lines[np.append(True, np.diff(lines) > ALIKE * span)]
    steps = round(span / np.median(np.diff(lines)))
    place = (lines - lines[0]) / span * steps
    even = (np.abs(place - place.round()) < EVEN).all() and (np.diff(place.round()) > 0).all()
    if even and len(lines) < steps + 1 <= MOST_LINES * len(lines):
        return np.linspace(lines[0], lines[-1], steps + 1)
    return lines


def _edges(lines: Array) -> Array:
    """Halfway between the lines, and as far beyond the first and the last."""
    middle = 0.5 * (lines[1:] + lines[:-1])
    return np.concatenate([[2.0 * lines[0] - middle[0]], middle, [2.0 * lines[-1] - middle[-1]]])


def colour_values(
    name: str, fields: Sequence[tuple[str, str]], positive: bool = False
) -> tuple[Array, tuple[str, ...]]:
    """Return numbers (T,) for the fields of a column, or indices in its sorted words.

    Fields are texts with places; the first with a value decides what the column holds.  Empty ones,
    and nan, are nan.  Raises InputError, with the place, if one is neither empty nor a number (with
    `positive`, > 0).
    """
    fields = [("" if is_missing(text) else text, where) for text, where in fields]
    worded = _is_word(next((text for text, _ in fields if text), "0"))
    words = tuple(sorted({text for text, _ in fields if text})) if worded else ()
    if len(words) > MOST_WORDS:
        limit = f"has more than {MOST_WORDS} different words: no colours for so many"
        raise InputError("--colour", value=shown(name), limit=limit)
    known = {"": math.nan} | {word: float(k) for k, word in enumerate(words)}
    values = []
    for text, where in fields:
        value = known[text] if worded or not text else finite(text)
        if value is None or (positive and not worded and value <= 0.0):
            limit = "must be a finite number or empty" if value is None else "must be > 0 for --log"
            raise InputError(name, where=where, value=shown(text), limit=limit)
        values.append(value)
    return np.array(values, float), words


def _is_word(text: str) -> bool:
    """Whether a field is no number, not even inf."""
    try:
        float(text)
    except ValueError:
        return True
    return False
