"""Which columns of tables are drawn, in which panels, with which ticks: a chart before it is drawn.

Curves of one unit share a panel; panels are stacked and share x.

Charts made of characters are drawn on a `Canvas`: braille dots, two across and four up in each, or
plain marks; x to the right and y up, from the lower left corner.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.columns import (
    TURNING,
    check_degrees,
    in_degrees,
    quantity_of,
    unit_of,
    with_unit,
)
from robodyn.errors import InputError
from robodyn.tables.arrays import Array, Complex
from robodyn.tables.csv_fields import columns_told, shown
from robodyn.tables.table import Reader

Opened = AbstractContextManager[tuple[BinaryIO, str]]  # a table of CSV, and its name
Rows = NDArray[np.int64]

USUAL = ("q*", "tau*")  # what is drawn where nothing is asked for
ROW = "row"  # the name of x where there is no t
MOST_POINTS = 20_000  # of a curve, before it is thinned
BINS = 4_000
LARGEST = 1e290


class Curve(NamedTuple):
    """One column of one file against x, (T,) each; y is nan at gaps, but not everywhere.

    Its points are `joined` by a line, or stand alone.
    """

    column: str
    file: int
    label: str
    x: Array
    y: Array
    joined: bool = True

    @property
    def seen(self) -> Rows:
        """Which of the points are no gaps."""
        return np.flatnonzero(~np.isnan(self.y))

    @property
    def end(self) -> int:
        """The point that its name stands at: that of the largest x of a line that rises."""
        seen = self.seen
        return int(seen[self.x[seen].argmax()] if self.rises else seen[-1])

    @property
    def runs(self) -> list[Rows]:
        """The points that lines join, one array a line; of one point where it stands alone."""
        seen = self.seen
        return np.split(seen, np.flatnonzero((np.diff(seen) > 1) | (not self.joined)) + 1)

    @property
    def rises(self) -> bool:
        """Whether it is a line along rising x, as against time."""
        return self.joined and bool((np.diff(self.x[self.seen]) >= 0.0).all())


class Panel(NamedTuple):
    """The curves of one unit, and what stands at their axis."""

    label: str
    curves: tuple[Curve, ...]


class Chart(NamedTuple):
    """Panels over one x."""

    x_label: str
    panels: tuple[Panel, ...]
    to_scale: bool  # x and y are both metres of the plane
    files: tuple[str, ...] = ()  # short names, where there are several

    @property
    def curves(self) -> list[Curve]:
        return [curve for panel in self.panels for curve in panel.curves]


def choose_x(header: Sequence[str], wanted: str | None, source: str) -> str | None:
    """The column along x: the one wanted, else t, else None for the number of the row."""
    if wanted is None:
        return "t" if "t" in header else None
    return header[place_of(wanted, "--x", header, source)]


def place_of(name: str, option: str, header: Sequence[str], source: str) -> int:
    """Return a column's index in the header; InputError lists the columns if it is missing."""
    if name not in header:
        limit = f"is no column; there are {columns_told(header, name)}"
        raise InputError(option, where=source, value=shown(name), limit=limit)
    return header.index(name)


def choose_columns(
    header: Sequence[str], patterns: Sequence[str] | None, x: str | None, source: str
) -> list[str]:
    """The columns to draw; InputError, with those that are there, where one is not.

    In a pattern `*` stands for a number, and where no column has one there, for anything: `q*` is
    q1, q2, ...  None takes q* and tau*, else all columns with a unit, else all but x.
    """
    others = [name for name in header if name != x]
    if patterns is None:
        usual = [name for p in USUAL for name in _matching(others, p, r"\d+")]
        chosen = usual or [name for name in others if unit_of(name)] or others
        if not chosen:
            raise InputError("no column to draw", where=source, limit=f"there is only {x}")
        return chosen
    found: list[str] = []
    for pattern in patterns:
        names = _matching(header, pattern, r"\d+") or _matching(header, pattern, ".*")
        found += names or [header[place_of(pattern, "--y", header, source)]]  # which raises
    return list(dict.fromkeys(found))


def _matching(header: Sequence[str], pattern: str, star: str) -> list[str]:
    first, *parts = map(re.escape, re.sub(r"\*+", "*", pattern).split("*"))
    # all but the last star take once and for all as little as they can: else many never end
    parts = [f"(?>{star}?{part})" for part in parts[:-1]] + [star + part for part in parts[-1:]]
    expression = re.compile("".join([first, *parts]))
    return [name for name in header if expression.fullmatch(name)]


def chart(
    sources: Sequence[str],
    xs: Sequence[str | None],
    tables: Sequence[dict[str, Array]],
    units: Mapping[str, str] = TURNING,
    scattered: Sequence[bool] = (),
) -> Chart:
    """The chart of tables: of each its name, its column along x, and its columns, (T,) each.

    `units` are those of a scene (`columns.scene_units`).  A value that is nan is a gap.  The
    points of tables that are `scattered` are not joined.

    Raises InputError where a table has no row, the tables have different columns along x, or
    nothing but gaps.
    """
    if len(set(xs)) > 1:
        named = ", ".join(f"{s}: {x or ROW}" for s, x in zip(sources, xs, strict=True))
        raise InputError("the files have different x", value=named, limit="give --x")
    labels = short_names(sources)
    grouped: dict[str, list[Curve]] = {}
    for file, (table, x) in enumerate(zip(tables, xs, strict=True)):
        columns = [name for name in table if name != x or len(table) == 1]
        if not all(len(values) for values in table.values()):
            limit = "the header is followed by no row: nothing to draw"
            raise InputError("no rows", where=sources[file], limit=limit)
        for name in columns:
            y = drawable(name, table[name], sources[file])
            rows = np.arange(1.0, len(y) + 1.0)
            along = rows if x is None else drawable(x, table[x], sources[file])
            label = shown(f"{name} {labels[file]}".rstrip())
            gaps = np.isnan(along) | np.isnan(y)
            if not gaps.all():
                joined, y = not any(scattered[file : file + 1]), np.where(gaps, np.nan, y)
                curve = Curve(name, file, label, *thinned(along, y, joined), joined)
                grouped.setdefault(unit_of(name, units), []).append(curve)
    x_name = xs[0] or ROW
    if not grouped:
        limit = f"no row has both {shown(x_name)} and a value to draw over it"
        raise InputError("nothing to draw", where=sources[0], limit=limit)
    panels = tuple(Panel(_label(unit, curves), tuple(curves)) for unit, curves in grouped.items())
    to_scale = {unit_of(x_name, units)} == grouped.keys() == {"m"}
    files = tuple(map(shown, labels)) if len(labels) > 1 else ()
    return Chart(shown(with_unit(x_name, units)), panels, to_scale, files)


def _label(unit: str, curves: Sequence[Curve]) -> str:
    names = list(dict.fromkeys(curve.column for curve in curves))
    if len(names) > 1:
        names = list(dict.fromkeys(map(quantity_of, names)))
    named = ", ".join(names) if len(names) <= 3 else ""
    return shown(f"{named} [{unit}]".strip() if unit else named)


def short_names(sources: Sequence[str]) -> list[str]:
    """Return labels that distinguish files: "" for one, else names without directories."""
    if len(sources) == 1:
        return [""]
    short = [re.sub(r"^.*[/\\]|\.csv$", "", source) for source in sources]
    return short if len(set(short)) == len(short) else list(sources)


def drawable(name: str, values: Array, where: str = "", flush: bool = True) -> Array:
    """Values whose sums and differences are numbers; with `flush` those next to 0 are 0."""
    size = np.abs(values)
    for value in values[size > LARGEST].tolist():
        limit = f"beyond {LARGEST:g} nothing can be drawn"
        raise InputError(name, where=where, value=value, limit=limit)
    return np.where(size < 1.0 / LARGEST, 0.0, values) if flush else values


def read_chart(
    tables: Iterable[Opened],
    x: str | None,
    patterns: Sequence[str] | None,
    units: Mapping[str, str],
    degrees: bool,
    tell: Callable[[str], object] = lambda text: None,
    points: bool = False,
) -> Chart:
    """The chart of the tables: the column x, else t or the row, and those that patterns name.

    With `points` these are not joined, nor are rows of a sweep in no order of x.  It tells of rows
    without a value, which are gaps.
    """
    names: list[str] = []
    along: list[str | None] = []
    read: list[dict[str, Array]] = []
    scattered: list[bool] = []
    for table in tables:
        with table as (stream, name):
            reader = Reader(stream, name, gaps=True)
            own = choose_x(reader.header, x, name)
            columns = choose_columns(reader.header, patterns, own, name)
            columns = list(dict.fromkeys([*columns, *([own] if own else [])]))
            blocks = [chunk.values for chunk in reader.chunks(columns)]
        names.append(name)
        along.append(own)
        values = np.concatenate([np.zeros((0, len(columns))), *blocks])
        read.append(dict(zip(columns, values.T, strict=True)))
        swept = "outcome" in reader.header and "t" not in reader.header
        scattered.append(points or (swept and not (own and _in_order(read[-1][own]))))
        tell_gaps(columns, values, name, tell)
    if degrees:
        check_degrees((name for columns_of in read for name in columns_of), units)
        along = [name and in_degrees(name, units)[0] for name in along]
        for k, columns_of in enumerate(read):
            told = {name: in_degrees(name, units) for name in columns_of}
            read[k] = {told[x][0]: told[x][1] * values for x, values in columns_of.items()}
    return chart(names, along, read, units, scattered)


def _in_order(x: Array) -> bool:
    """Whether the values, gaps aside, rise or fall throughout."""
    steps = np.diff(x[~np.isnan(x)])
    return bool((steps > 0.0).all() or (steps < 0.0).all())


def tell_gaps(
    columns: Sequence[str], values: Array, source: str, tell: Callable[[str], object]
) -> None:
    """Tell how many of the rows (T, k) have no value, column by column."""
    counts = zip(columns, np.isnan(values).sum(axis=0).tolist(), strict=True)
    told = ", ".join(f"{count} without {shown(name)}" for name, count in counts if count)
    if told:
        tell(f"Note: {source}: {len(values)} rows, {told}: not drawn")


def thinned(x: Array, y: Array, joined: bool = True) -> tuple[Array, Array]:
    """A long line along rising x, less the points that nobody could see.

    Of each of many equal parts of the rows the least and the largest y are kept, a gap, and both
    ends.
    """
    gaps = np.isnan(y)
    if len(x) <= MOST_POINTS or not joined or not (np.diff(x[~gaps]) >= 0.0).all():
        return x, y
    edges = list(itertools.pairwise(np.linspace(0, len(y), BINS + 1).astype(int).tolist()))
    low, high = np.where(gaps, np.inf, y), np.where(gaps, -np.inf, y)
    least = [begin + np.argmin(low[begin:end]) for begin, end in edges]
    most = [begin + np.argmax(high[begin:end]) for begin, end in edges]
    missing = [begin + np.argmax(gaps[begin:end]) for begin, end in edges if gaps[begin:end].any()]
    places = np.unique([0, *least, *most, *missing, len(y) - 1])
    return x[places], y[places]


def limits(values: Sequence[Array]) -> tuple[float, float]:
    """The least and the largest value, gaps aside, apart also where all are equal (to rounding)."""
    low = min(float(np.nanmin(v)) for v in values)
    high = max(float(np.nanmax(v)) for v in values)
    size = max(abs(low), abs(high))
    if high - low <= 1e-12 * size or high == low:
        half = 0.05 * size or 1.0
        return 0.5 * (low + high) - half, 0.5 * (low + high) + half
    return low, high


def multiples(low: float, high: float, apart: float) -> range:
    """The whole numbers k with k apart in [low, high], to rounding."""
    rounding = 1e-9 + 1e-15 * max(abs(low), abs(high)) / apart
    return range(math.ceil(low / apart - rounding), math.floor(high / apart + rounding) + 1)


def ticks(low: float, high: float, most: int) -> list[float]:
    """At most `most` round numbers in [low, high], 1, 2 or 5 times a power of ten apart.

    Two at least, which may then be farther apart.
    """
    power = 10.0 ** math.floor(math.log10((high - low) / most))
    found: list[float] = []
    for factor in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0):
        apart, finer = factor * power, found
        found = [k * apart for k in multiples(low, high, apart)]
        if len(found) <= most:
            break
    return found if len(found) > 1 or len(finer) < 2 else [finer[0], finer[-1]]


def tick_texts(values: Sequence[float]) -> list[str]:
    """The ticks as short texts that differ."""
    texts: list[str] = []
    for digits in (6, 9, 12, 17):
        texts = [f"{value:.{digits}g}" for value in values]
        if len(set(texts)) == len(texts):
            break
    return [text.replace("e+0", "e").replace("e-0", "e-") for text in texts]


def spread(wanted: Sequence[float], gap: float, low: float, high: float) -> list[float] | None:
    """Places near those wanted, at least `gap` apart, in [low, high]; None if they do not fit."""
    if (len(wanted) - 1) * gap > high - low:
        return None
    order = sorted(range(len(wanted)), key=lambda k: wanted[k])
    groups: list[tuple[float, list[int]]] = []  # the lowest place of each, and who is in it
    for k in order:
        place, members = min(max(wanted[k], low), high), [k]
        while groups and groups[-1][0] + gap * len(groups[-1][1]) > place + 1e-12 * gap:
            members = groups.pop()[1] + members
            centre = sum(wanted[m] - gap * i for i, m in enumerate(members)) / len(members)
            place = min(max(centre, low), high - gap * (len(members) - 1))
        groups.append((place, members))
    places = [0.0] * len(wanted)
    for place, members in groups:
        for i, k in enumerate(members):
            places[k] = place + gap * i
    return places


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
    """Return the left edge of each row: a line with ticks at some rows, and their labels."""
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
