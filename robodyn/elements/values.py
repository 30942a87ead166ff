"""What fields of a scene hold beside numbers: points, and what varies."""

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
    """A smooth expression: as its file has it, its tree (`scene/syntax.py`), and its names."""

    text: str
    node: Any
    names: frozenset[str]  # t, q0.., qd0..; of a spring x, its extension, and v, its rate


class Lines(NamedTuple):
    """A function that is a line on each piece between increasing knots x (k + 1,).

    `first` and `last` (k,) are its values at the ends of each piece.
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
    """The function of rows x, F: linear between them, or of `hold` steps; two at one x are a step.

    The value at a step is that which follows it.
    """
    pairs = list(zip(pairwise(x), pairwise(F), strict=True))
    wide = [((a, b), (c, c if hold else d)) for (a, b), (c, d) in pairs if b > a]
    knots = (*(a for (a, _), _ in wide), wide[-1][0][1])
    return Lines(knots, tuple(c for _, (c, _) in wide), tuple(d for _, (_, d) in wide))


class Table(Declared):
    """A function of one variable by rows, x increasing: linear between them, or of `hold` steps.

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
        """The lines of which it is."""
        return lines_of(self.x, self.F, self.hold)

    @property
    def names(self) -> frozenset[str]:
        """The variable, as a law has its own; t or q0..; of a spring x."""
        return frozenset((self.over,))


MOST_DECIMALS = 14  # from which the digits of a file are those of floats


def _decimals(value: float) -> int:
    """The decimals that a number is written with."""
    number, _, power = repr(round(value, MOST_DECIMALS)).partition("e")
    written = number.rstrip("0").partition(".")[2]
    return max(0, len(written) - int(power or 0))


class Curve(Record):
    """A cubic spline through the rows of a table, twice differentiable: a coupling's law.

    On piece k, from x_k to x_{k+1}, it is the sum of `pieces[k][i]` (x - x_k)^i.  If it `repeats`
    it gains `rise` with each span; else it ends at its first and last row.
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
        """The variable, as a law has its own."""
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
        """What the second derivative may be off by, as the values have only so many decimals.

        A value that is rounded by d makes 4 d/h^2 of a second difference over rows h apart, and a
        spline three times as much at most.
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
    """An expression as its file has it, or the file of a table."""
    return signal.text if isinstance(signal, Law) else signal.file
