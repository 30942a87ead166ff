"""A map: values over two columns, as the cells of a grid or as points, before it is drawn."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import InputError, at_place
from robodyn.pictures.chart import Opened, choose_columns, choose_x, drawable, limits, place_of
from robodyn.pictures.colour_scale import ColourScale, colour_scale
from robodyn.pictures.column_units import TURNING, in_degrees, unit_of
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import finite, shown, split_fields, unquoted
from robodyn.tables.table import Chunk, Reader

Rows = NDArray[np.int64]

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


def _map_in_degrees(mapped: ValueMap, units: Mapping[str, str]) -> ValueMap:
    """The map with its angles in degrees."""
    names = mapped.x_name, mapped.y_name, mapped.name
    told = [in_degrees(name, units) for name in names]
    values = told[2][1] * mapped.values if mapped.scale else mapped.values
    log = mapped.scale is not None and mapped.scale.log
    x, y = told[0][1] * mapped.x, told[1][1] * mapped.y
    new = value_map((told[0][0], told[1][0], told[2][0]), x, y, values, mapped.words, log)
    return new._replace(units=units)


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

    Points that others hide are told.
    """
    column = ColourColumn(colour, positive=log)
    blocks, ys = [np.zeros((0, 2))], []
    for table in tables:
        with table as (stream, source):
            reader = Reader(stream, source)
            choose_x(reader.header, x, source)
            ys += choose_columns(reader.header, patterns, x, source)
            if len(set(ys)) > 1:
                raise InputError(
                    "--y", value=", ".join(dict.fromkeys(ys)), limit="a map has one column along y"
                )
            place = place_of(colour, "--colour", reader.header, source)
            for chunk in reader.chunks([x, ys[0]]):
                column.add(chunk, place, source)
                blocks.append(chunk.values)
    if log and column.words:
        limit = "needs a column of numbers; this one holds words"
        raise InputError("--log", value=shown(colour), limit=limit)
    along, up = np.concatenate(blocks).T
    with at_place(source, "no rows"):
        mapped = value_map((x, ys[0], colour), along, up, column.values, column.words, log)
    if mapped.grid is not None and mapped.grid.hidden:
        tell(f"Note: {mapped.grid.hidden} rows are hidden by later ones with the same {x}, {ys[0]}")
    return _map_in_degrees(mapped, units) if degrees else mapped._replace(units=units)


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


class ColourColumn:
    """One column of successive chunks; its first field that is not empty tells what it holds.

    After all `add`, `values` (T,) are the numbers, or places in the sorted `words`; nan where
    the field is empty.  With `positive`, numbers must be > 0.
    """

    def __init__(self, name: str, positive: bool = False) -> None:
        self.name = name
        self._positive = positive
        self._of_words: bool | None = None  # nothing seen so far
        self._places: dict[str, int] = {}  # of words as they came
        self._values: list[float] = []

    def add(self, chunk: Chunk, place: int, source: str) -> None:
        """Take the fields at a place of a chunk's lines.

        Raises InputError, with the line of `source`, where one is neither empty nor what the
        column holds.
        """
        for line, number in zip(chunk.lines, chunk.line_numbers, strict=True):
            text = unquoted(split_fields(line)[place]).strip()
            if text and self._of_words is None:
                self._of_words = _is_word(text)
            if not text:
                self._values.append(math.nan)
            elif self._of_words:
                self._values.append(self._places.setdefault(text, len(self._places)))
            else:
                value = finite(text)
                if value is None or (self._positive and value <= 0.0):
                    where, limit = f"{source}: line {number}", "must be > 0 for --log"
                    limit = "must be a finite number or empty" if value is None else limit
                    raise InputError(self.name, where=where, value=shown(text), limit=limit)
                self._values.append(value)
        if len(self._places) > MOST_WORDS:
            limit = f"has more than {MOST_WORDS} different words: no colours for so many"
            raise InputError("--colour", value=shown(self.name), limit=limit)

    @property
    def words(self) -> tuple[str, ...]:
        return tuple(sorted(self._places))

    @property
    def values(self) -> Array:
        values = np.array(self._values, float)
        if self._places:
            order = np.array([self.words.index(word) for word in self._places], float)
            there = ~np.isnan(values)
            values[there] = order[values[there].astype(int)]
        return values


def _is_word(text: str) -> bool:
    """Whether a field is no number, not even nan or inf."""
    try:
        float(text)
    except ValueError:
        return True
    return False
