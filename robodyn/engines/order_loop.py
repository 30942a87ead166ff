"""The series of a motion with the order as a loop: its formulas do not grow with the order.

The first orders are recorded one by one, as they are special; one more is recorded for an order p
that is not known.  Coefficients lie in memory, a series a column: what was found at earlier orders
is read there, and sums over j run there, but for the terms that this order itself finds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

from robodyn.engines.arithmetic import Value, convolution, plus, times, weighted
from robodyn.engines.expansion import MotionProgram, Start
from robodyn.engines.expression import Expression, Graph, needed
from robodyn.engines.formulas import RECORDED
from robodyn.engines.frames import Framed
from robodyn.engines.series import Series
from robodyn.mechanics import program as rows
from robodyn.mechanics.program import COORDINATES, Row, Slot


class Order:
    """p + offset, past all special cases: no whole number equals it, and all are below."""

    def __init__(self, p: Value, offset: int = 0) -> None:
        self.p, self.offset = p, offset

    def __add__(self, other: Any) -> Any:
        if isinstance(other, float):
            return self.p + (self.offset + other)
        return Order(self.p, self.offset + other)

    def __sub__(self, other: Any) -> Any:
        if isinstance(other, Order):
            return self.offset - other.offset
        return Order(self.p, self.offset - other)

    def __mul__(self, other: Any) -> Value:
        return (self + 0.0) * (other + 0.0 if isinstance(other, Order) else other)

    __rmul__ = __mul__

    def __lt__(self, other: Any) -> bool:
        return isinstance(other, Order) and self.offset < other.offset

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Order) and self.offset == other.offset

    def __hash__(self) -> int:
        return hash((Order, self.offset))


class Stored:
    """The coefficients of a series, as a list has them: of the first orders, and of this one."""

    def __init__(self, loop: Loop, index: int) -> None:
        self.loop, self.index = loop, index
        self.first: dict[int, Value] = {}
        self.now: dict[int, Value] = {}  # by the offset from p
        self.read = False  # at a later order than that which found it

    def __setitem__(self, m: int | Order, value: Value) -> None:
        if isinstance(m, Order):
            self.now[m.offset] = value
        else:
            self.first[m] = value

    def __getitem__(self, m: int | Order) -> Value:
        if not isinstance(m, Order):
            return self.first.get(m, 0.0)
        if m.offset in self.now:
            return self.now[m.offset]
        self.read = True
        self.loop.offsets.add(m.offset)
        return self.loop.graph.variable(f"{self.index}@{m.offset}")


class Sum(NamedTuple):
    """Of (slope j + level) x_j y_{p+m-j} for j from `first` to p + `last`, all of it in memory."""

    x: Stored
    y: Stored
    m: int
    first: int
    last: int
    slope: float
    level: Value


class Loop:
    """Numbers whose series are `Stored`, and the sums over them that were asked for."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.p = graph, graph.variable("p")
        self.series: list[Stored] = []
        self.offsets: set[int] = set()  # from p, of what is read of earlier orders
        self.sums: dict[tuple[object, ...], tuple[str, Sum]] = {}
        self.arithmetic = replace(
            RECORDED, room=self._room, convolve=self._convolve, weigh=self._weigh
        )

    def _room(self, orders: int) -> Stored:
        self.series.append(Stored(self, len(self.series)))
        return self.series[-1]

    def _convolve(self, x: Stored, y: Stored, m: Any, first: int, last: Any) -> Value:
        if not isinstance(m, Order):
            return convolution(x, y, m, first, last)
        return self._weigh(x, y, m, first, last, 0.0, 1.0)

    def _weigh(
        self, x: Stored, y: Stored, m: Any, first: int, last: Any, slope: float, level: Value
    ) -> Value:
        if not isinstance(m, Order):
            return weighted(x, y, m, first, last, slope, level)
        begin = max([first, *(m.offset - i + 1 for i in y.now)])
        end = min([last.offset, *(i - 1 for i in x.now)])
        x.read = y.read = True
        wanted = Sum(x, y, m.offset, begin, end, slope, level)
        key = (x.index, y.index, *wanted[2:6], getattr(level, "index", level))
        name, _ = self.sums.setdefault(key, (f"sum{len(self.sums)}", wanted))
        total: Value = self.graph.variable(name)
        own = [Order(self.p, i) for i in range(end + 1, last.offset + 1)]
        for j in (*range(first, begin), *own):  # what is found at this order
            weight = level if slope == 0.0 else slope * j + level
            total = plus(total, times(times(weight, x[j]), y[m - j]))
        return total


class _PlanarStored(dict[Any, Framed]):
    """The coefficients of a planar slot: those of earlier orders are read in the ground's frame."""

    def __init__(self, series: LoopSeries, slot: Slot) -> None:
        self.series, self.slot = series, slot

    def __missing__(self, m: int | Order) -> Framed:
        return self.series.earlier(self.slot, m)


class LoopSeries(Series):
    """A series of which one order stands for all but the first.

    There each order waits for the one before, so that the second derivative of a direction is
    (p + 1) (p + 2) times its square's coefficient, and the unknown u itself: no product of theta.
    """

    def known(self, slot: Slot, row: Row, m: Any) -> Any:
        turn = self._bent(row)
        slides = turn is not None and isinstance(self.program.rows[turn], rows.Slide)
        if not isinstance(m, Order) or turn is None or slides:
            return super().known(slot, row, m)
        (link, _, _), *_ = self.planar[turn][m + 2]
        by = self.arithmetic.keep(-0.5 * ((m + 1.0) * (m + 2.0)))
        bend = times(by, self._square[turn]), self.unknown_values.get(turn, 0.0)
        return ((link, None, bend),)

    def change(self, slot: Slot, row: Row, m: Any, change: dict[Slot, Any]) -> Any:
        turn = self._bent(row)
        if not isinstance(m, Order) or turn is None:
            return super().change(slot, row, m, change)
        unknown = self.unknown_values.get(turn, 0.0)
        if isinstance(self.program.rows[turn], rows.Slide):
            return unknown
        (link, _, _), *_ = self.planar[turn][m + 2]
        return ((link, None, (0.0, unknown)),)

    def _bent(self, row: Row) -> Slot | None:
        """The coordinate that a row is the second derivative of."""
        rate = self.program.rows[row.x] if isinstance(row, rows.Derivative) else None
        if isinstance(rate, rows.Derivative) and isinstance(self.program.rows[rate.x], COORDINATES):
            return rate.x
        return None

    def _turn(self, slot: Slot, link: int, m: Any) -> Framed:
        if not isinstance(m, Order):
            return super()._turn(slot, link, m)
        rho, theta = self._moment[slot]
        both = (self.convolve(x, x, m, 1, m - 1) for x in (rho, theta))
        self._square[slot] = square = plus(*both)
        rho[m], theta[m] = value = (self.arithmetic.keep(times(-0.5, square)), 0.0)
        return ((link, None, value),)

    @cached_property
    def _square(self) -> dict[Slot, Value]:
        """What is known of a direction's square at the present order."""
        return {}

    def planar_room(self, slot: Slot, orders: int) -> Any:
        return _PlanarStored(self, slot)

    def earlier(self, slot: Slot, m: Any) -> Framed:
        """A planar coefficient of an order before this one."""
        row = self.program.rows[slot]
        if isinstance(row, rows.Turn):
            rho, theta = self._moment[slot]
            return ((row.link, None, (rho[m], theta[m])),)
        if slot not in self._kept:
            room = self.arithmetic.room
            self._kept[slot] = {None: (room(0), room(0))}
            known: Any = self.planar[slot]
            for each in list(known):
                self._remember(slot, None, each)
        ((frame, (x, y)), *_) = self._kept[slot].items()
        return ((frame, None, (x[m], y[m])),)


class LoopExpansion(NamedTuple):
    """Formulas of all orders.

    `columns` are the series that are kept: first rho and theta of each link, then those of
    `watched`, then the power, where there is one; `spanned` are the places of what is so.  Orders
    below `first` are recorded one by one; that of the loop ends at `last`.
    """

    start: Start
    sums: list[tuple[str, Sum]]
    columns: list[Stored]
    offsets: set[int]  # from p, of what is read one by one
    watched: int
    power: bool
    spanned: list[int]
    first: int
    last: int

    def known(self) -> Iterator[tuple[int, int, Value]]:
        """Column, order and coefficient of what is found before the loop."""
        for column, series in enumerate(self.columns):
            yield from ((column, m, value) for m, value in series.first.items())

    def grown(self) -> Iterator[tuple[int, int, Value]]:
        """Column, offset from p and coefficient of what the loop finds."""
        for column, series in enumerate(self.columns):
            yield from ((column, m, value) for m, value in series.now.items())

    def steady(self) -> list[Value]:
        """What the loop takes that is the same at every order."""
        moving: set[int] = set()
        found: list[Value] = []
        for node in needed([value for *_, value in self.grown()]):
            name = str(node.args[0]) if node.op == "var" else ""
            below = [a for a in node.args if isinstance(a, Expression)]
            if name == "p" or "@" in name or name.startswith("sum"):
                moving.add(node.index)
            elif any(a.index in moving for a in below):
                moving.add(node.index)
                found += [a for a in below if a.index not in moving and not a.constant]
        return found

    @property
    def outputs(self) -> list[Value]:
        """All formulas."""
        found = [value for part in (self.known(), self.grown()) for *_, value in part]
        return [*found, *(x.level for _, x in self.sums)]


def loop_expansion(motion: MotionProgram, order: int) -> LoopExpansion:
    """The formulas of a step's series, numbers and torques as parameters; see `expansion`."""
    start = motion.start(generic=True)
    loop = Loop(start.graph)
    slots = [*motion.power, *motion.bends]
    series = LoopSeries(
        motion.program, loop.arithmetic, start.numbers, order, start.state, slots=slots
    )
    kinds = [type(row) for _, row in series.rows]
    special = rows.Given in kinds or rows.Function in kinds  # in their coefficient 1
    first = 2 if special else 1
    for p in range(first):
        series.advance(p)
    series.advance(Order(loop.p))
    columns = [x for slot in motion.turns for x in series.turn(slot)]
    columns += [series.real[slot] for slot in [*motion.bends, *motion.power]]
    spanned = [series.real[x.slot] for x in motion.spans]
    columns += spanned
    for _, one in loop.sums.values():  # series that are summed alike, side by side
        columns += [one.x, one.y]
    columns = list(dict.fromkeys([*columns, *(x for x in loop.series if x.read)]))
    return LoopExpansion(
        start,
        list(loop.sums.values()),
        columns,
        loop.offsets,
        len(motion.bends),
        bool(motion.power),
        [columns.index(x) for x in spanned],
        first,
        order if motion.power else order - 1,
    )
