"""One step of a motion's Taylor series as a formula: its coefficients, length and end state.

Every engine that takes steps evaluates this formula or generates code from it.

With the order as a loop (`LoopSeries`) the size of the formulas does not depend on the order.  The
first orders are special and recorded one by one; one more is recorded for a symbolic order p.
Coefficients are stored in memory, one column per series.  The loop reads coefficients of earlier
orders from there, and sums over j run over memory, except for terms that this order itself
produces.

A function may be flat at the start of a step, or on one piece of a table; its series then knows
nothing of what lies beyond.  `strays` finds steps in which the argument leaves this region.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

from robodyn.elements import program as rows
from robodyn.elements.program import (
    COORDINATES,
    Function,
    Given,
    Power,
    Primitive,
    Program,
    Quotient,
    Row,
    Slot,
    arguments,
)
from robodyn.engines import expression
from robodyn.engines.arithmetic import Arithmetic, Planar, Value, convolution, plus, times, weighted
from robodyn.engines.expression import Expression, Graph, needed
from robodyn.engines.formulas import RECORDED, Recorded
from robodyn.engines.series import Framed, Series, State, start
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.planar_model import Mechanism
from robodyn.mechanics.torque_rows import torque_slots

FLAT = 45.0  # exp(-FLAT) is nothing beside 1
_STEEP = {"exp": 1.0, "sinh": 1.0, "cosh": 1.0, "tanh": 2.0}  # as exp(-steep |x|) where x is large


class Span(NamedTuple):
    """The argument of a function whose series may not hold along a whole step: see `strays`.

    With `steep`, the function is flat up to exp(-`steep` |x|) for large |x|.  An `edge` is a
    distance from the end of a piece of a table.  Else the argument is the base of a power, or a
    divisor, which may pass zero (`passes`), as in sin(x)/x, but not turn back beside it.
    """

    slot: Slot
    steep: float = 0.0
    edge: bool = False
    passes: bool = False


def spans(program: Program, wanted: Sequence[Slot]) -> list[Span]:
    """Return the spans of the functions that a series up to `wanted` slots computes.

    Functions of time alone may be flat: no step is longer than a time on which they are resolved.
    """
    varying: set[Slot] = set()
    moving: set[Slot] = set()
    steep: dict[Slot, float] = {}
    passes: dict[Slot, bool] = {}
    for slot in program.schedule(wanted).slots:
        row = program.rows[slot]
        timed = isinstance(row, Given) and row.name == "t"
        if isinstance(row, COORDINATES) or not moving.isdisjoint(arguments(row)):
            moving.add(slot)
        elif not timed and varying.isdisjoint(arguments(row)):
            continue
        varying.add(slot)
        match row:
            case Function(name, x) if name in _STEEP and x in moving:
                steep[x] = max(steep.get(x, 0.0), _STEEP[name])
            case Power(x, _) | Quotient(_, x) | Primitive(_, _, x):
                if x in varying and not isinstance(program.rows[x], Power):  # whose base tells it
                    passes[x] = isinstance(row, Quotient) and passes.get(x, True)
    edges = [Span(x, edge=True) for x in program.named.get("edges", ())]
    divisors = [Span(x, passes=may) for x, may in passes.items()]
    return [*(Span(*each) for each in steep.items()), *divisors, *edges]


def strays(spanned: Sequence[Span], series: Sequence[Sequence[Value]], x: Value) -> Value:
    """Return 1 if no argument leaves the region of its series within a step x.

    Else the result is the part of the step to try next: one half, or what ends just beyond a piece
    of a table, so that the next step starts on the next one.

    Values at the ends of a step would not do: a motion may meet and leave a narrow force within it.
    """
    part: Value = 1.0
    for span, each in zip(spanned, series, strict=True):
        if span.edge:
            nearer = _before_edge(each, x)
        elif span.steep:
            nearer = _flat(each, x, span.steep)
        else:
            nearer = _off_zero(each, x, span.passes)
        part = expression.least(part, nearer)
    return part


def _off_zero(each: Sequence[Value], x: Value, passes: bool) -> Value:
    """Return one half if an argument turns back near to zero within a step x, else 1.

    Unless it `passes`, it may not reach zero either.

    The series of sqrt(u^2 + small) for u far from zero shows nothing of what lies beyond.  Where
    the argument does not turn, what it comes near to is at the step's end, and seen there.  Between
    two of the places where it is seen it is off a straight line by at most the square of their
    distance times its second derivative over 8.
    """
    first, h = each[0], abs(x)
    bend: Value = 0.0
    for k in range(len(each) - 1, 1, -1):
        bend = bend * h + (k * (k - 1.0)) * abs(each[k])
    bend = bend * (h * h)
    nearest: Value = first * first
    turned: Value = 0.0
    way = each[1]
    for k in range(1, SEEN + 1):
        value, slope = horner(each, k / SEEN * x)
        nearest = expression.least(nearest, first * value)
        turned = expression.least(turned, way * slope)
        way = slope
    least = nearest - abs(first) * bend * (0.125 / SEEN**2)
    near = expression.choose(least, NEAR * first * first, 0.5, 1.0)
    near = expression.choose(turned, 0.0, near, 1.0)
    return expression.choose(0.0, nearest, near, 1.0 if passes else 0.5)


def _flat(each: Sequence[Value], x: Value, steep: float) -> Value:
    """Return one half if an argument leaves, in a step x, where its function is flat; else 1.

    The series of exp(-steep |x|) has its largest term at order steep |change of x|; step control
    sees it if the series has so many terms.
    """
    low, high, _ = _hull(each, x)
    near = steep * expression.greatest(expression.greatest(low, -high), 0.0)
    passed = steep * abs(each[0]) - near - len(each)
    return expression.choose(near, FLAT, expression.choose(0.0, passed, 0.5, 1.0), 1.0)


def _before_edge(each: Sequence[Value], x: Value) -> Value:
    """Return 1 if a distance from the edge of a piece stays positive, but for `LEFT`, in a step x.

    Else the part of the step that ends just beyond the edge, by Newton's method.
    """
    low, _, bent = _hull(each, x)
    second, third = (*each[1:3], 0.0, 0.0)[:2]
    value, slope = horner(each, x)
    last = second + 2.0 * third * x
    steady = expression.least(abs(second), abs(last)) - bent
    steady = expression.choose(0.0, second * last, steady, -1.0)  # it neither rests nor turns
    low = expression.choose(0.0, steady, expression.least(each[0], value), low)
    nearer = x
    for _ in range(NEWTON):
        nearer = nearer - (value + LANDED) / (slope + TINY)
        value, slope = horner(each, nearer)
    nearer = nearer / x
    inside = expression.choose(nearer, 1.0 - ROUNDED, nearer, 0.5)
    shorter = expression.choose(LEAST, nearer, inside, 0.5)
    return expression.choose(LEFT, -low, shorter, 1.0)


def _hull(each: Sequence[Value], x: Value) -> tuple[Value, Value, Value]:
    """Return bounds of an argument in a step x, and of what its slope changes beyond order 2.

    An argument stays within the hull of the Bezier points of its first three terms, widened by the
    sizes of the others.
    """
    h, rest, bent = abs(x), 0.0, 0.0
    for k in range(len(each) - 1, 2, -1):
        rest = rest * h + abs(each[k])
        bent = bent * h + k * abs(each[k])
    rest, bent = rest * (h * h * h), bent * (h * h)
    first, second, third = (*each[:3], 0.0, 0.0)[:3]
    middle, end = first + 0.5 * second * x, first + (second + third * x) * x
    low = expression.least(expression.least(first, middle), end) - rest
    high = expression.greatest(expression.greatest(first, middle), end) + rest
    return low, high, bent


LEFT = 1e-8  # of the narrowest piece of a table, by which a step may leave one
LANDED = 0.125 * LEFT  # so far beyond it a step ends
NEWTON = 5  # iterations to there
LEAST = 1e-6  # part of a step that Newton's method leaves, at least
ROUNDED = 1e-12  # and takes off
SEEN = 8  # parts of a step, at whose ends what divides is seen
NEAR = 1.0 / 256.0  # of its size at the start, which it must keep
TINY = 1e-290  # in place of a coefficient that vanishes
TURN = 2.0  # rad: a link that turns farther in a step may not have its turns counted


class Coefficients(NamedTuple):
    """The series of one motion.

    `rho`, `theta` (n, order + 2) are the links' turns from the start of the step.  `power` (order +
    1) is the power of what changes the energy; the work of constant torques is tau times the
    displacement instead (empty if none).  `spanned` (order each) are arguments to be checked by
    `strays`.
    """

    rho: list[list[Value]]
    theta: list[list[Value]]
    power: list[Value]
    spanned: Sequence[list[Value]] = ()


class Start(NamedTuple):
    """The state of a motion as formulas, and the numbers that its rows take."""

    graph: Graph
    numbers: list[Value]
    steady: list[Value]  # constant torques
    state: State


class MotionProgram:
    """The program of a mechanism with its torques, and its expansion.

    `held` has the values of switches in expressions.
    Raises InputError if a torque has no series.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        actuation: Actuation,
        work: bool,
        held: Sequence[float] | None = None,
    ) -> None:
        self.mechanism, self.actuation, self.held = mechanism, actuation, held
        equations = EquationsOfMotion(mechanism)
        self.program = equations.program
        slots = torque_slots(equations, actuation, held)
        equations.write(slots, work, steady=actuation.constants is not None)
        self.turns = equations.x
        self.power = self.program.named.get("power", [])
        self.slots = [*self.power, *self.program.named.get("edges", ())]
        self.spans = spans(self.program, self.slots)
        laws = any(row.law is not None for row in mechanism.rows)
        given = actuation.constants is not None or actuation.linear
        # whether a series may not hold as far as its last coefficients tell
        self.checked = bool(self.spans or mechanism.signals or laws) or not given
        self.steady = actuation.constants is not None and not mechanism.timed

    def start(self, generic: bool = False) -> Start:
        """Return the start state of a step as formulas.

        With `generic`, numbers of the rows are parameters c0, c1, ..., and constant torques u0, u1,
        ...
        """
        names = ("qd", "tau", "dtau")
        recorded = Recorded(self.mechanism, names, by_direction=True, generic=generic)
        numbers, relative = recorded.numbers(self.program), recorded.relative
        steady = [
            recorded.parameter(f"u{j}", tau) if tau else 0.0
            for j, tau in enumerate(self.actuation.constants or ())
        ]
        y, torques = [*relative["q"], *relative["qd"]], (relative["tau"], relative["dtau"])
        state = self.state(RECORDED, recorded.graph.variable("t"), y, torques, steady)
        return Start(recorded.graph, numbers, steady, state)

    def state(
        self,
        arithmetic: Arithmetic,
        t: Value,
        y: Sequence[Value],
        torques: tuple[Sequence[Value], Sequence[Value]],
        steady: Sequence[Value] = (),
    ) -> State:
        """Return the state at which the series start, y = (q, qd, ...) at time t.

        `torques` are values and slopes of torques linear in time.  `steady` (n) are formulas for
        constant torques.
        """
        n, constants = self.mechanism.n, steady or self.actuation.constants
        state = start(self.mechanism, arithmetic, (y[:n], y[n : 2 * n]))
        state.given["t"] = t, 1.0
        for j in range(n):
            if constants is not None:
                state.given[f"tau{j}"] = (constants[j],)
            elif torques[0]:
                state.given[f"tau{j}"] = torques[0][j], torques[1][j]
        return state

    def expand(
        self,
        arithmetic: Arithmetic,
        numbers: Sequence[Value],
        order: int,
        state: State,
    ) -> Coefficients:
        """Return the series up to an order; raise ZeroDivisionError if there are none."""
        series = Series(
            self.program,
            arithmetic,
            numbers,
            order,
            state,
            slots=self.slots,
        )
        series.expand()
        if self.power and self.mechanism.driven:  # the multipliers of laws work
            series.advance(order)
        elif self.power:  # the residuals of the last order are not wanted, what works there is
            series.residuals(order)
        turns = [series.turn(slot) for slot in self.turns]
        return Coefficients(
            [list(rho[: order + 2]) for rho, _ in turns],
            [list(theta[: order + 2]) for _, theta in turns],
            [series.real[slot][m] for slot in self.power for m in range(order + 1)],
            [[series.real[x.slot][m] for m in range(order)] for x in self.spans],
        )


def longest_step(
    series: Coefficients,
    w: Sequence[Value],
    rtol: Value,
    atol: Value,
    power: Callable[[Value, float], Value] = expression.power,
    slides: Sequence[int] = (),
    steady: bool = True,
) -> Value:
    """Return the step at which the last coefficients reach the tolerance.

    Two orders are compared, since every other coefficient may vanish.  A rate may err by atol +
    rtol |w|, an angle by atol + rtol, and no link may turn so far that its turns are lost.
    Displacements of `slides` (m) and their rates count like angles.

    If forces are not `steady`, most coefficients may vanish, as in E = exp(i c t^m), and the last
    ones show nothing.  Then the remainder from order p + 2 on is estimated: after a last term x of
    order k it is less than x^((p + 2)/k)/2, and p + 2 times that for rates.  Work may need shorter
    steps than a displacement: if the rate of a slide is exp(-a t), the power of its damper has
    terms 2^k times as large.  So with slides, the last terms of the work must be below atol + rtol
    of h times the sizes of the power's terms at h/2.
    """
    rho, theta = series.rho, series.theta
    p = len(rho[0]) - 2

    def largest(k: int) -> Value:  # without squares: past a near miss they are beyond the floats
        return _largest([abs(each[k]) for each in (*rho, *theta)])

    fast = _largest([abs(x) for x in w])
    tol = atol + rtol * fast
    h = power(tol / ((p + 1.0) * largest(p + 1) + TINY), 1.0 / p)
    before = power(tol / (float(p) * largest(p) + TINY), 1.0 / (p - 1))
    h = expression.least(h, before)
    turning = [abs(x) for k, x in enumerate(w) if k not in slides]
    if turning:
        h = expression.least(h, TURN / (_largest(turning) + TINY))
    angle = (p + 1.0) * (atol + rtol)
    shorter = h * power(angle / (h * tol), 1.0 / (p + 1))
    h = expression.choose(angle, h * tol, shorter, h)
    turns = [] if steady else [k for k in range(len(w)) if k not in slides]
    radius = power(2.0 * (atol + rtol) / (p + 2.0), 1.0 / (p + 2)) if turns else 0.0
    for k in range((p + 1) // 2 + 1, p) if turns else ():
        sizes = _largest([abs(each[j][k]) for each in (rho, theta) for j in turns])
        h = expression.least(h, radius * power(sizes + TINY, -1.0 / k))
    if slides and len(series.power):
        terms = [abs(x) for x in series.power]
        allowed = (atol + rtol) * horner(terms, 0.5 * h)[0]
        for k in (p, p - 1):
            shorter = power((k + 1.0) * allowed / (terms[k] + TINY), 1.0 / k)
            shorter = expression.choose(TINY, terms[k], shorter, math.inf)
            h = expression.choose(shorter, h, shorter, h)  # not where terms are beyond the floats
    tails: Value = 0.0  # comparisons may pass over what is not finite
    for each in theta:
        tails = tails + each[p + 1]
    return expression.choose(abs(tails), math.inf, h, math.nan)


def rough(a: Value, exponent: float) -> Value:
    """Return a power, too small by some percent."""
    return 0.96 * expression.rough_power(a, exponent)


def _largest(values: Sequence[Value]) -> Value:
    found = values[0]
    for value in values[1:]:
        found = expression.greatest(found, value)
    return found


def horner(coefficients: Sequence[Value], x: Value) -> tuple[Value, Value]:
    """Return the value of a polynomial at x, and its slope."""
    value: Value = coefficients[-1]
    slope: Value = 0.0
    for coefficient in reversed(coefficients[:-1]):
        slope = slope * x + value
        value = value * x + coefficient
    return value, slope


def turning(z: Planar, slope: Planar) -> Value:
    """Return the rate of the angle of z, Im(conj(z) z')/|z|^2."""
    (r, t), (dr, dt) = z, slope
    return (r * dt - t * dr) / (r * r + t * t)


def ends(
    mechanism: Mechanism,
    turns: Sequence[tuple[Planar, Planar]],
    power: Value,
    steady: Sequence[Value],
    work: bool,
    given: Callable[[str], Value],
) -> list[Value]:
    """Return q, qd (n each) and, if `work`, the work done, at the end of a step.

    `turns` are rho + i theta of the coordinates with slopes; `power` is the integral of the power.
    """
    slides = set(mechanism.slides)
    ways: list[Value] = []
    rates: list[Value] = []
    for j, (z, slope) in enumerate(turns):
        ways.append(z[1] if j in slides else expression.arctangent(z[1], z[0]))
        rates.append(slope[1] if j in slides else turning(z, slope))
    q, qd, own = [], [], []
    for j, above in enumerate(mechanism.above):
        way, rate = ways[j], rates[j]
        if above is not None:
            way, rate = way - ways[above], rate - rates[above]
        q.append(way if j in slides else given(f"q{j}") + way)
        own.append(way - given(f"q{j}") if j in slides else way)
        qd.append(rate)
    if not work:
        return [*q, *qd]
    total: Value = given("work") + power
    for tau, way in zip(steady, own, strict=False):
        total = total + tau * way
    return [*q, *qd, total]


def integral(coefficients: Sequence[Value], x: Value) -> Value:
    """Return the integral of a series from 0 to x."""
    total: Value = coefficients[-1] * (1.0 / len(coefficients))
    for k in reversed(range(len(coefficients) - 1)):
        total = total * x + coefficients[k] * (1.0 / (k + 1))
    return total * x


class Order:
    """A symbolic order p + offset.  It is greater than every int: special cases never match."""

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
    """The coefficients of a series as a list: those of the first orders, and of order p."""

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
    """The sum of (slope j + level) x_j y_{p+m-j} for j from `first` to p + `last`, from memory."""

    x: Stored
    y: Stored
    m: int
    first: int
    last: int
    slope: float
    level: Value


class Loop:
    """Arithmetic whose series are `Stored`, with the sums that were requested."""

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
    """The coefficients of a planar slot; earlier orders are read in the ground's frame."""

    def __init__(self, series: LoopSeries, slot: Slot) -> None:
        self.series, self.slot = series, slot

    def __missing__(self, m: int | Order) -> Framed:
        return self.series.earlier(self.slot, m)


class LoopSeries(Series):
    """A series in which one symbolic order stands for all but the first orders.

    Each order needs the one before.  So the second derivative of a direction is (p + 1)(p + 2)
    times the coefficient of its square plus the unknown u itself, without a product of theta.
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
        """Return the coordinate of which a row is the second derivative, or None."""
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
        """Return the known parts of squares of directions; the loop knows none."""
        return {}

    def planar_room(self, slot: Slot, orders: int) -> Any:
        return _PlanarStored(self, slot)

    def earlier(self, slot: Slot, m: Any) -> Framed:
        """Return a planar coefficient of an earlier order."""
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

    `columns` are the stored series: rho and theta of each link, then the power if any; `spanned`
    are indices of columns.  Orders below `first` are recorded one by one; the
    loop ends at order `last`.
    """

    start: Start
    sums: list[tuple[str, Sum]]
    columns: list[Stored]
    offsets: set[int]  # from p, of what is read one by one
    power: bool
    spanned: list[int]
    first: int
    last: int

    def known(self) -> Iterator[tuple[int, int, Value]]:
        """Yield column, order and coefficient of what is computed before the loop."""
        for column, series in enumerate(self.columns):
            yield from ((column, m, value) for m, value in series.first.items())

    def grown(self) -> Iterator[tuple[int, int, Value]]:
        """Yield column, offset from p and coefficient of what the loop computes."""
        for column, series in enumerate(self.columns):
            yield from ((column, m, value) for m, value in series.now.items())

    def steady(self) -> list[Value]:
        """Return the values used in the loop that do not depend on the order."""
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
        """Return all formulas."""
        found = [value for part in (self.known(), self.grown()) for *_, value in part]
        return [*found, *(x.level for _, x in self.sums)]


def loop_expansion(motion: MotionProgram, order: int) -> LoopExpansion:
    """Return the formulas of a step's series, with numbers and torques as parameters."""
    start = motion.start(generic=True)
    loop = Loop(start.graph)
    series = LoopSeries(
        motion.program, loop.arithmetic, start.numbers, order, start.state, slots=motion.slots
    )
    kinds = [type(row) for _, row in series.rows]
    special = rows.Given in kinds or rows.Function in kinds  # in their coefficient 1
    first = 2 if special else 1
    for p in range(first):
        series.advance(p)
    series.advance(Order(loop.p))
    columns = [x for slot in motion.turns for x in series.turn(slot)]
    columns += [series.real[slot] for slot in motion.power]
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
        bool(motion.power),
        [columns.index(x) for x in spanned],
        first,
        order if motion.power else order - 1,
    )
