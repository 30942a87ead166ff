"""Values of a scene's fields that are no numbers: points, laws, tables and curves."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

from robodyn.elements.keys import Declared, Way, key
from robodyn.tables.records import Record

FRAMES = ("ground", "link")  # in which a load's force stays


class Point(Declared):
    """A point of a link (its index; `at` in the link's frame) or of the ground (link None), m."""

    link: int | None = key("link_name", "the link's name")
    at: complex = key("vector", "where, [x, y] in the link's frame", unit="m")

    ways: ClassVar[tuple[Way, ...]] = (
        Way("link_point", "point", "A point of a link."),
        Way("link_point", "moving_point", "A point of a link."),
    )


class Law(Record):
    """A smooth expression: its text, its tree (`scene/syntax.py`), and its names."""

    text: str
    node: Any
    names: frozenset[str]  # t, q0.., qd0..; of a spring x, its extension, and v, its rate


class Lines(NamedTuple):
    """A piecewise linear function with increasing knots x (k + 1,).

    `first` and `last` (k,) are its values at both ends of each piece.
    """

    x: tuple[float, ...]
    first: tuple[float, ...]
    last: tuple[float, ...]

    @property
    def slopes(self) -> tuple[float, ...]:
        """The slope of each piece."""
        each = zip(pairwise(self.x), self.first, self.last, strict=True)
        return tuple((d - c) / (b - a) for (a, b), c, d in each)

    @property
    def jumps(self) -> tuple[float, ...]:
        """The knots at which the value jumps."""
        each = zip(self.x[1:-1], self.last, self.first[1:], strict=False)
        return tuple(x for x, before, after in each if before != after)


def lines_of(x: Sequence[float], F: Sequence[float], hold: bool) -> Lines:
    """Return the function with rows x, F: linear between them, or with `hold` by steps.

    Two rows at one x are a step; the value there is the later one.
    """
    pairs = list(zip(pairwise(x), pairwise(F), strict=True))
    wide = [((a, b), (c, c if hold else d)) for (a, b), (c, d) in pairs if b > a]
    knots = (*(a for (a, _), _ in wide), wide[-1][0][1])
    return Lines(knots, tuple(c for _, (c, _) in wide), tuple(d for _, (_, d) in wide))


class Table(Declared):
    """A function of one variable by rows, x increasing: linear between them, or `hold` steps.

    Over t two rows may have one time: there the value jumps.
    """

    file: str = key("name", "the CSV file, from the scene file's folder", name="table")
    over: str = key("name", "t, or a joint q1, ..: its column tells where the rows are")
    column: str = key("name", "the column of the force or torque")
    hold: bool = key(
        "truth",
        "true: the value of a row holds until the next; over t",
        default=False,
        told="false",
    )
    x: tuple[float, ...] = ()
    F: tuple[float, ...] = ()
    repeats: bool = False  # after its span; else it ends there

    ways: ClassVar[tuple[Way, ...]] = (
        Way("load_table", "varying", "A force or torque by a table, linear between its rows."),
    )

    @property
    def lines(self) -> Lines:
        """The table as a piecewise linear function."""
        return lines_of(self.x, self.F, self.hold)

    @property
    def names(self) -> frozenset[str]:
        """The name of its variable: t or q0..; x for a spring."""
        return frozenset((self.over,))


MOST_DECIMALS = 14  # from which the digits of a file are those of floats


def _decimals(value: float) -> int:
    """Return the number of decimals with which a number is written."""
    number, _, power = repr(round(value, MOST_DECIMALS)).partition("e")
    written = number.rstrip("0").partition(".")[2]
    return max(0, len(written) - int(power or 0))


class Curve(Record):
    """A cubic spline through the rows of a table, twice differentiable: a coupling's law.

    On piece k, from x_k to x_{k+1}, it is the sum of `pieces[k][i]` (x - x_k)^i.  If it `repeats`
    it gains `rise` per period; otherwise it ends at its first and last row.
    """

    file: str  # the CSV file, from the scene file's folder
    over: str  # t, or a joint q0, ..
    column: str
    x: tuple[float, ...]
    pieces: tuple[tuple[float, float, float, float], ...]
    rise: float
    repeats: bool

    @property
    def names(self) -> frozenset[str]:
        """The name of its variable."""
        return frozenset((self.over,))

    @property
    def text(self) -> str:
        """The file and its columns, for messages."""
        over = self.over if self.over == "t" else f"q{int(self.over[1:]) + 1}"
        return f"{self.column} over {over} in {self.file}"

    @property
    def largest_bend(self) -> float:
        """The largest second derivative, which is at a row."""
        widths = [b - a for a, b in pairwise(self.x)]
        ends = [
            (2 * c, 2 * c + 6 * d * h) for (_, _, c, d), h in zip(self.pieces, widths, strict=True)
        ]
        return max(abs(x) for pair in ends for x in pair)

    @property
    def bend_of_digits(self) -> float:
        """The error of the second derivative caused by the rounding of values in the file.

        A value rounded by d changes a second difference over rows h apart by 4 d/h^2, and the
        spline by at most three times as much.
        """
        decimals = max(_decimals(piece[0]) for piece in self.pieces)
        if decimals >= MOST_DECIMALS:
            return 0.0
        h = min(b - a for a, b in pairwise(self.x))
        return 12.0 * 0.5 * 10.0**-decimals / (h * h)


Signal = Law | Table

# of files that a scene names: x and value of each row, by file, both columns' names, and whether
# x is an angle that turns
Tables = dict[tuple[str, str, str, bool], tuple[tuple[float, ...], tuple[float, ...]]]


def told(signal: Signal) -> str:
    """Return an expression's text, or the file of a table."""
    return signal.text if isinstance(signal, Law) else signal.file
