"""Evaluates a program of rows as power series in time, order by order, over any numbers.

`Arithmetic` defines the numbers: floats, nodes of a recorded formula, numpy arrays over lanes, or
numbers of many digits.  One order is enough for values: the accelerations at a state.

At order p every slot gets the coefficient that the program's schedule wants.  First its known part
is computed, with the unknowns of this order set to zero.  Then the residuals are solved for the
unknowns, and the rest is added.  The unknowns of every order enter through the same matrix K = [M
Psi^T; Psi 0], which is found by walking the rows, and factored once.

A direction is E_m = (rho_m + i theta_m) E_0.  As |E| = 1, its radial coefficient is known,

    rho_m = -1/2 sum_{0<j<m} (rho_j rho_{m-j} + theta_j theta_{m-j}),

and theta_m = u/(m (m-1)) with the unknown u of order m - 2, at order 0 the link's angular
acceleration.  Planar coefficients stay sums over the frames E_0, and a moment about a link is taken
in the link's frame, so products of two directions are computed once.

The rule of a row for its next coefficient has two halves: the part known before the unknowns of the
order (`known`), and what the unknowns add (`change`).

A program coefficient before a component of a planar slot is multiplied once, when the frame is
requested.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from robodyn.elements import program as rows
from robodyn.elements.program import (
    COORDINATES,
    Coefficient,
    PlanarCoefficient,
    Program,
    Row,
    Slot,
)
from robodyn.engines.arithmetic import (
    ZERO,
    Arithmetic,
    Planar,
    Value,
    conjugate_times,
    difference,
    over,
    planar_plus,
    planar_times,
    plus,
    some,
    times,
)
from robodyn.engines.factors import Factors
from robodyn.mechanics.planar_model import Mechanism


class State(NamedTuple):
    """The start of a series: directions E (n), rates w of x = J q, and the values of `Given` rows.

    A sliding joint has no E; its displacement is given like other values.  `given` maps a name to
    its first coefficients, or to a function that returns the coefficient of an order.  `turn(j, k)`
    returns conj(E_j) E_k if there is a cheaper way than a product.  If `accelerations` (n) of the
    links are given, the residuals of order 0 include them.
    """

    E: Sequence[Planar]
    w: Sequence[Value]
    given: dict[str, Sequence[Value] | Callable[[int], Value]]
    turn: Callable[[int, int], Planar] | None = None
    accelerations: Sequence[Value] | None = None


def absolute(mechanism: Mechanism, relative: Sequence[Any]) -> list[Any]:
    """Return J times joint values of any kind."""
    values = list(relative)
    for k in mechanism.order:
        above = mechanism.above[k]
        if above is not None:
            values[k] = values[above] + values[k]
    return values


def relative(mechanism: Mechanism, absolute: Sequence[Any]) -> list[Any]:
    """Return J^-1 times link values."""
    above = [None if k is None else absolute[k] for k in mechanism.above]
    return [x if y is None else x - y for x, y in zip(absolute, above, strict=True)]


def start(
    mechanism: Mechanism,
    arithmetic: Arithmetic,
    joints: tuple[Sequence[Value], Sequence[Value]],
    links: tuple[Sequence[Value], Sequence[Value]] | None = None,
    turn: Callable[[int, int], Planar] | None = None,
    accelerations: Sequence[Value] | None = None,
) -> State:
    """Return the start of series from q and qd (n), or also from x = J q and its rates `links`.

    The caller may add to its `given`.
    """
    x, rates = links or (absolute(mechanism, joints[0]), absolute(mechanism, joints[1]))
    named = {"q": joints[0], "qd": joints[1], "alpha": x}
    given: dict[str, Any] = {
        f"{name}{k}": (value,) for name, values in named.items() for k, value in enumerate(values)
    }
    slides, cos, sin = set(mechanism.slides), arithmetic.cos, arithmetic.sin
    E = [(1.0, 0.0) if k in slides else (cos(a), sin(a)) for k, a in enumerate(x)]
    return State(E, rates, given, turn, accelerations)


PRODUCTS = (rows.Product, rows.Scaled, rows.Inner)
FUNCTIONS = (rows.Quotient, rows.Power, rows.Function, rows.Step, rows.Primitive)
SUMS = (rows.Sum, rows.PlanarSum, rows.RealPart)
LINEAR = {*SUMS, rows.Integral, rows.Anchored, rows.Derivative}
# f' = sign g and g' = back f: the name of g, sign, back
_PARTNERS = {
    "sin": ("cos", 1.0, -1.0),
    "cos": ("sin", -1.0, 1.0),
    "sinh": ("cosh", 1.0, 1.0),
    "cosh": ("sinh", 1.0, 1.0),
}


def planar_scaled(scale: Value, z: Planar) -> Planar:
    """Return a real number times a planar one."""
    return times(scale, z[0]), times(scale, z[1])


# frame (a link, or None: the ground's), coefficient that is not yet multiplied, value
Framed = tuple[tuple[int | None, PlanarCoefficient | None, Planar], ...]


@dataclass(eq=False, repr=False)
class Series:
    """The coefficients of a program's slots along one motion.

    `orders` is the number of orders of the unknowns.  `slots` are wanted besides the residuals.
    With `grounded`, forces are summed in the ground's frame, which is cheaper for deep trees.
    """

    program: Program
    arithmetic: Arithmetic
    numbers: Sequence[Value]
    orders: int
    state: State
    slots: Sequence[Slot] = ()
    grounded: bool = False

    def __post_init__(self) -> None:
        order, self.ahead, self.live = self.program.schedule(self.slots)
        self.rows: list[tuple[Slot, Row]] = [(x, self.program.rows[x]) for x in order]
        self.real: dict[Slot, Any] = {}  # coefficients of real slots
        self.planar: dict[Slot, list[Framed]] = {}
        self.unknown_values: dict[Slot, Value] = {}
        self._factor: dict[tuple[int | None, int | None, PlanarCoefficient | None], Planar] = {}
        # series of planar slots in one frame
        self._kept: dict[Slot, dict[int | None, tuple[Any, Any]]] = {}
        # rho, theta of directions; F of moments in their frame
        self._moment: dict[Slot, tuple[Any, Any]] = {}
        self._extra: dict[Slot, Any] = {}  # series that functions take besides their own

        program, room, K = self.program, self.arithmetic.room, self.orders + 3
        for slot, row in self.rows:
            if program.planar[slot]:
                self.planar[slot] = self.planar_room(slot, K)
                if isinstance(row, rows.Turn):
                    self._moment[slot] = (room(K), room(K))  # rho, theta
            else:
                self.real[slot] = room(K)
            if isinstance(row, rows.Slide):
                self._extra[slot] = room(K)
                self._extra[slot][0] = 1.0
            if isinstance(row, rows.Moment):
                self._moment[slot] = (room(K), room(K))
            if isinstance(row, rows.Function):
                self._extra[slot] = room(K)
        for slot, row in self.rows:
            for m in range(self.ahead[slot]):
                self.put(slot, m, self.known(slot, row, m))
        self._balance: dict[Slot, int] = {}
        self._residuals: list[Value] = []
        self.factors: Factors | None = None
        self.p = 0

    def planar_room(self, slot: Slot, orders: int) -> Any:
        """Return storage for the coefficients of a planar slot."""
        return [()] * orders

    # -- planar coefficients -----------------------------------------------------------------------

    def coefficient(self, c: Coefficient) -> Value:
        """Return the number of a program coefficient."""
        if isinstance(c, float):
            return c
        return times(c.sign, self.numbers[c.place])

    def _pair(self, c: PlanarCoefficient) -> Planar:
        return self.coefficient(c[0]), self.coefficient(c[1])

    def factor(self, to: int | None, frame: int | None, c: PlanarCoefficient | None) -> Planar:
        """Return c E_frame in the frame `to`: conj(E_to) c E_frame."""
        key = (to, frame, c)
        found = self._factor.get(key)
        if found is None:
            if c is not None:
                found = planar_times(self._pair(c), self.factor(to, frame, None))
                found = self.arithmetic.keep(found[0]), self.arithmetic.keep(found[1])
            elif to == frame:
                found = (1.0, 0.0)
            elif to is None:
                assert frame is not None
                found = self.state.E[frame]
            elif frame is None:
                E = self.state.E[to]
                found = E[0], -E[1]
            elif self.state.turn is not None:
                found = self.state.turn(to, frame)
            else:
                found = conjugate_times(self.state.E[to], self.state.E[frame])
            self._factor[key] = found
        return found

    def into(self, to: int | None, framed: Framed) -> Planar:
        """Return a planar coefficient in one frame."""
        total = ZERO
        for frame, c, value in framed:
            total = planar_plus(total, planar_times(self.factor(to, frame, c), value))
        return total

    def real_part(self, framed: Framed) -> Value:
        """Return the real part of a planar coefficient."""
        total: Value = 0.0
        for frame, c, value in framed:
            by = self.factor(None, frame, c)
            total = plus(total, times(by[0], value[0]))
            total = difference(total, times(by[1], value[1]))
        return total

    def ground(self, z: Slot, m: int) -> Planar:
        """Return coefficient m of a planar slot in the ground's frame."""
        return self.into(None, self.planar[z][m])

    # -- rows --------------------------------------------------------------------------------------

    def put(self, slot: Slot, m: int, value: Any) -> None:
        if slot in self.planar:
            self.planar[slot][m] = value
            for frame in self._kept.get(slot, ()):
                self._remember(slot, frame, m)
        else:
            self.real[slot][m] = value

    def columns(self, z: Slot, last: int, frame: int | None = None) -> tuple[Any, Any]:
        """Return the series of a planar slot in one frame; it is stored and grows."""
        kept = self._kept.setdefault(z, {})
        if frame not in kept:
            room = self.arithmetic.room
            kept[frame] = (room(self.orders + 3), room(self.orders + 3))
            for m in range(max(last + 1, self.ahead[z])):
                self._remember(z, frame, m)
        return kept[frame]

    def _remember(self, z: Slot, frame: int | None, m: int) -> None:
        x, y = self._kept[z][frame]
        x[m], y[m] = self.into(frame, self.planar[z][m])

    def convolve(self, x: Any, y: Any, m: Any, first: int = 0, last: Any = None) -> Value:
        """Return the sum of x_j y_{m-j} for j from `first` to `last` (default m)."""
        last = m if last is None else last
        if last < first:
            return 0.0
        return self.arithmetic.convolve(x, y, m, first, last)

    def slope(self, x: Any, y: Any, m: int) -> Value:
        """Return coefficient m of the integral of x' y: 1/m sum j x_j y_{m-j}."""
        return over(self.arithmetic.weigh(x, y, m, 1, m, 1.0, 0.0), m)

    # -- what is known of a coefficient ------------------------------------------------------------

    def known(self, slot: Slot, row: Row, m: int) -> Any:
        """Return coefficient m of a slot with the unknowns of the present order set to zero."""
        return _KNOWN[type(row)](self, slot, row, m)

    def _given(self, slot: Slot, row: Row, m: int) -> Any:
        """Return the known part of given values and of coordinates with their rates."""
        match row:
            case rows.Given(name=name):
                given = self.state.given[name]
                if callable(given):
                    return given(m)
                return given[m] if m < len(given) else 0.0
            case rows.Turn(link=k):
                return self._turn(slot, k, m)
            case rows.Slide(joint=k):
                return self._slide(k, m)
            case rows.Rate(turn=E):
                return self._rate(slot, E, m)
        return 0.0

    def _sum(self, slot: Slot, row: Row, m: int) -> Any:
        if m == 0 and isinstance(row, (rows.Integral, rows.Anchored)):
            return self._first(row.start)
        return self._linear(row, m, self._found, m == 0)

    def _first(self, name: str) -> Value:
        """Return the first coefficient of a given value."""
        given = self.state.given[name]
        return given(0) if callable(given) else given[0]

    def _found(self, x: Slot, m: int) -> Any:
        """Return a stored coefficient m of a slot."""
        return self.planar[x][m] if x in self.planar else self.real[x][m]

    def _product(self, slot: Slot, row: Row, m: int) -> Any:
        """Return products of two series; those with a direction in its own frame."""
        match row:
            case rows.Product(x=x, y=y):
                return self.convolve(self.real[x], self.real[y], m)
            case rows.Scaled(x=x, z=z):
                frame = self._frame(z)
                if frame is None:
                    frame = next(iter(self._kept.get(z, (None,))))  # one that it is kept in
                a, b = self._moment[z] if z in self._moment else self.columns(z, m, frame)
                own = self.convolve(self.real[x], a, m), self.convolve(self.real[x], b, m)
                return ((frame, None, own),)
            case rows.Inner(z=z, w=w):
                frame = self._frame(z)
                a, b = self._moment[z] if z in self._moment else self.columns(z, m)
                c, d = self.columns(w, m, frame)
                return plus(self.convolve(a, c, m), self.convolve(b, d, m))
        raise AssertionError(row)

    def _function(self, slot: Slot, row: Row, m: int) -> Value:
        """Return a function by its value at order 0, then by its differential equation."""
        real, weigh, divide = self.real, self.arithmetic.weigh, self.arithmetic.divide
        match row:
            case rows.Quotient(x=x, y=y):
                known = self.convolve(real[slot], real[y], m, 0, m - 1)
                return divide(difference(real[x][m], known), real[y][0])
            case rows.Power(x=x, exponent=exponent):
                if m == 0:
                    return self.arithmetic.power(real[x][0], exponent)
                known = weigh(real[x], real[slot], m, 1, m, exponent + 1.0, -1.0 * m)
                return divide(over(known, m), real[x][0])
            case rows.Function(name=name, x=x):
                return self._smooth(slot, name, real[x], m)
            case rows.Step(x=x):
                return self._stepped(row, real[x][0]) if m == 0 else 0.0
            case rows.Primitive(name=name, x=x, density=y):
                if m == 0:
                    return self.arithmetic.functions[name](real[x][0])
                known = weigh(real[slot], real[y], m, 1, m - 1, 1.0, 0.0)
                return divide(difference(real[x][m], over(known, m)), real[y][0])
        raise AssertionError(row)

    def _stepped(self, row: rows.Step, x: Value) -> Value:
        """Return the value of a step function at x."""
        arithmetic = self.arithmetic
        if not row.period:
            return arithmetic.chosen(x, row.knots, row.values)
        periods = arithmetic.functions["floor"]((x - row.first) / row.period)
        value = arithmetic.chosen(x - row.period * periods, row.knots, row.values)
        return plus(value, times(row.rise, periods))

    def _accumulate(self, total: Value, c: Coefficient, value: Value) -> Value:
        """Return total + c value; a coefficient of +-1 costs no product."""
        negative = c < 0.0 if isinstance(c, float) else c.sign < 0.0
        if not negative or (type(total) is float and total == 0.0):
            return plus(total, times(self.coefficient(c), value))
        return difference(total, times(self.coefficient(-c), value))

    def _linear(
        self, row: Row, m: int, of: Callable[[Slot, int], Any], begins: bool = False
    ) -> Any:
        """Return a linear row from `of(slot, order)`; None there adds nothing.

        With `begins`, the row's constant is included.
        """
        match row:
            case rows.Sum(constant=constant, terms=terms):
                total: Value = self.coefficient(constant) if begins else 0.0
                for c, x in terms:
                    if (value := of(x, m)) is not None:
                        total = self._accumulate(total, c, value)
                return total
            case rows.PlanarSum(constant=by, terms=planar_terms):
                start: Framed = ()
                if begins and by != (0.0, 0.0):
                    start = ((None, by, (1.0, 0.0)),)
                given = ((c, z, of(z, m)) for c, z in planar_terms)
                framed = [
                    (c, value if z in self.planar else ((None, None, (value, 0.0)),))
                    for c, z, value in given
                    if value is not None
                ]
                return start + self._planar_sum(framed)
            case rows.Integral(x=x):
                return over(of(x, m - 1), m)
            case rows.Anchored(x=x):
                return of(x, m)
            case rows.Derivative(x=x) if x in self.planar:
                return tuple((f, c, planar_scaled(m + 1.0, z)) for f, c, z in of(x, m + 1))
            case rows.Derivative(x=x):
                return times(m + 1.0, of(x, m + 1))
            case rows.RealPart(z=z):
                return self.real_part(of(z, m))
        raise AssertionError(row)

    def _planar_sum(self, terms: Sequence[tuple[PlanarCoefficient, Framed]]) -> Framed:
        if self.grounded:  # one sum in the ground's frame
            total = ZERO
            for c, framed in terms:
                total = planar_plus(total, planar_times(self._pair(c), self.into(None, framed)))
            return ((None, None, total),)
        return tuple(
            (frame, c, value if inner is None else planar_times(self._pair(inner), value))
            for c, framed in terms
            for frame, inner, value in framed
        )

    def _turn(self, slot: Slot, link: int, m: int) -> Framed:
        rho, theta = self._moment[slot]
        if m == 0:
            rho[0], theta[0] = value = (1.0, 0.0)
        elif m == 1:
            rho[1], theta[1] = value = (0.0, self.state.w[link])
        else:
            square = plus(self._half_square(rho, m), self._half_square(theta, m))
            given = self.state.accelerations
            turning = over(given[link], 2) if given is not None and m == 2 else 0.0
            rho[m], theta[m] = value = (self.arithmetic.keep(times(-1.0, square)), turning)
        return ((link, None, value),)

    def _slide(self, joint: int, m: int) -> Value:
        if m < 2:
            return self._first(f"{('q', 'qd')[m]}{joint}")
        known = self.state.accelerations
        return over(known[joint], 2) if known is not None and m == 2 else 0.0

    def _half_square(self, x: Any, m: int) -> Value:
        """Return 1/2 sum of x_j x_{m-j} for 0 < j < m."""
        total = self.convolve(x, x, m, 1, (m - 1) // 2)
        if m % 2 == 0:
            half = x[m // 2]
            total = plus(total, times(0.5, times(half, half)))
        return total

    def _rate(self, slot: Slot, E: Slot, m: int) -> Value:
        """Return the known terms of w in z' = i w z."""
        rho, theta = self._moment[E]
        known = self.convolve(self.real[slot], rho, m, 0, m - 1)
        return difference(times(m + 1.0, theta[m + 1]), known)

    def _known_moment(self, slot: Slot, row: rows.Moment, m: int) -> Value:
        """Return Im(conj(z) F) in the link's frame, with the link's own inertia in F."""
        rho, theta = self._moment[row.turn]
        own = self.coefficient(row.inertia)
        _, _, bend = self.planar[row.bend][m][0]
        force = self.into(self._link(row.turn), self.planar[row.F][m])
        x, y = self._moment[slot]
        x[m] = plus(force[0], times(own, bend[0]))
        y[m] = plus(force[1], times(own, bend[1]))
        total = plus(y[m], self.convolve(rho, y, m, 1, m))  # rho_1 = 0
        return difference(total, self.convolve(theta, x, m, 1, m))

    def _smooth(self, slot: Slot, name: str, x: Any, m: int) -> Value:
        """Return a function by its differential equation; `_extra` stores its auxiliary series."""
        y, other, functions = self.real[slot], self._extra[slot], self.arithmetic.functions
        if name == "exp":
            return functions["exp"](x[0]) if m == 0 else self.slope(x, y, m)
        if name == "tanh":  # y' = x' (1 - y^2)
            if m == 0:
                return functions["tanh"](x[0])
            square = self.convolve(y, y, m - 1)
            keep = self.arithmetic.keep
            other[m - 1] = keep(difference(1.0 if m == 1 else 0.0, square))
            return keep(self.slope(x, other, m))
        partner, sign, back = _PARTNERS[name]
        if m == 0:
            other[0] = functions[partner](x[0])
            return functions[name](x[0])
        found, gained = self.slope(x, other, m), self.slope(x, y, m)
        other[m] = times(back, gained)
        return times(sign, found)

    # -- what the unknowns change ------------------------------------------------------------------

    def change(self, slot: Slot, row: Row, m: int, change: dict[Slot, Any]) -> Any:
        """Return what the unknowns add to coefficient m of a live slot.

        `change` has what they add to other slots.
        """
        real = self.real

        def of(x: Slot) -> Value:
            return change.get(x, 0.0)

        match row:
            case rows.Unknown():
                return self.unknown_values.get(slot, 0.0)
            case rows.Turn(link=k):
                added = over(self.unknown_values.get(slot, 0.0), m * (m - 1))
                return ((k, None, (0.0, added)),)
            case rows.Slide():
                return over(self.unknown_values.get(slot, 0.0), m * (m - 1))
            case rows.Rate(turn=E):
                _, _, (_, theta) = change[E][0]
                return times(m + 1.0, theta)
            case _ if type(row) in LINEAR:
                return self._linear(row, m, lambda x, _: change.get(x))
            case rows.Product(x=x, y=y):
                return plus(times(of(x), real[y][0]), times(real[x][0], of(y)))
            case rows.Moment():
                return self._moment_change(row, change)[1]  # z_0 = 1
            case rows.Inner(z=z, w=w):
                frame = self._frame(z)
                total: Value = 0.0
                for one, two in ((z, w), (w, z)):
                    if one in change:
                        a, b = self.into(frame, change[one])
                        c, d = self.into(frame, self.planar[two][0])
                        total = plus(total, plus(times(a, c), times(b, d)))
                return total
            case rows.Scaled(x=x, z=z):
                frame = self._frame(z)
                result = planar_scaled(of(x), self.into(frame, self.planar[z][0]))
                if z in change:
                    result = planar_plus(
                        result, planar_scaled(real[x][0], self.into(frame, change[z]))
                    )
                return ((frame, None, result),)
        return self._function_change(slot, row, of)

    def _function_change(self, slot: Slot, row: Row, of: Callable[[Slot], Value]) -> Value:
        """Return the function's slope at order 0 times what its arguments change."""
        real, divide = self.real, self.arithmetic.divide
        match row:
            case rows.Quotient(x=x, y=y):
                return divide(difference(of(x), times(real[slot][0], of(y))), real[y][0])
            case rows.Power(x=x, exponent=exponent):
                return divide(times(times(exponent, real[slot][0]), of(x)), real[x][0])
            case rows.Primitive(x=x, density=y):
                return divide(of(x), real[y][0])
            case rows.Step():
                return 0.0
            case rows.Function(name="exp", x=x):
                return times(real[slot][0], of(x))
            case rows.Function(name="tanh", x=x):
                return times(self._extra[slot][0], of(x))
            case rows.Function(name=name, x=x):
                return times(_PARTNERS[name][1], times(self._extra[slot][0], of(x)))
        raise AssertionError(row)

    def _moment_change(self, row: rows.Moment, change: dict[Slot, Any]) -> Planar:
        """Return what unknowns add to the force F + inertia P, in the link's frame."""
        force, own = ZERO, ZERO
        if row.F in change:
            force = self.into(self._link(row.turn), change[row.F])
        if row.bend in change:
            own = change[row.bend][0][2]
        by = self.coefficient(row.inertia)
        return plus(force[0], times(by, own[0])), plus(force[1], times(by, own[1]))

    def _frame(self, z: Slot) -> int | None:
        """Return the frame of a direction, which is its own; None (ground) for other slots."""
        return self._link(z) if z in self._moment else None

    def _link(self, turn: Slot) -> int:
        row = self.program.rows[turn]
        assert isinstance(row, rows.Turn)
        return row.link

    # -- one order ---------------------------------------------------------------------------------

    def residuals(self, p: int) -> list[Value]:
        """Return the residuals at order p, with the unknowns of that order set to zero."""
        self.p, self.unknown_values = p, {}
        for slot, row in self.rows:
            m = p + self.ahead[slot]
            self.put(slot, m, self.known(slot, row, m))
        self._residuals = [self.real[slot][p] for slot in self.program.residuals]
        return self._residuals

    def complete(self, unknowns: Sequence[Value], balanced: bool = False) -> None:
        """Add the contributions of the unknowns of this order.

        If `balanced`, the unknowns solve the residuals.
        """
        self._balance = self._balances() if balanced else {}
        p, program = self.p, self.program
        self.unknown_values = dict(zip(program.unknowns, unknowns, strict=True))
        change: dict[Slot, Any] = {}
        for slot, row in self.rows:
            if slot not in self.live:
                continue
            m = p + self.ahead[slot]
            through = {x: change[x] for x in self.live[slot]}
            delta = change[slot] = self.change(slot, row, m, through)
            match row:
                case rows.Turn(link=k):
                    rho, theta = self._moment[slot]
                    theta[m] = self.arithmetic.keep(delta[0][2][1])
                    self.put(slot, m, ((k, None, (rho[m], theta[m])),))
                case rows.Derivative() if program.planar[slot]:
                    self.put(slot, m, self.known(slot, row, m))
                case _ if program.planar[slot]:
                    self.put(slot, m, (*self.planar[slot][m], *delta))
                case rows.Moment():
                    x, y = self._moment[slot]
                    added = self._moment_change(row, through)
                    if slot in self._balance:  # its residual vanishes: no need to add up again
                        delta = change[slot] = times(-1.0, self._residuals[self._balance[slot]])
                    else:
                        delta = added[1]
                    x[m] = self.arithmetic.keep(plus(x[m], added[0]))
                    y[m] = self.arithmetic.keep(plus(y[m], delta))
                    self.real[slot][m] = plus(self.real[slot][m], delta)
                case _:
                    self.real[slot][m] = plus(self.real[slot][m], delta)
                    if isinstance(row, rows.Function) and row.name in _PARTNERS:
                        _, _, back = _PARTNERS[row.name]
                        other = self._extra[slot]
                        gained = times(self.real[slot][0], change.get(row.x, 0.0))
                        other[m] = plus(other[m], times(back, gained))

    def expand(self, factors: Factors | None = None) -> list[list[Value]]:
        """Compute all orders; return the unknowns of each."""
        return [self.advance(p, factors) for p in range(self.orders)]

    def advance(self, p: Any, factors: Factors | None = None) -> list[Value]:
        """Compute order p after all lower orders; return its unknowns."""
        right = [times(-1.0, x) if type(x) is float else -x for x in self.residuals(p)]
        self.factors = self.factors or factors or self.factorise()
        solution = self.factors.solve(right)
        self.complete(solution, balanced=True)
        return solution

    def turn(self, slot: Slot) -> tuple[Any, Any]:
        """Return the coefficients rho and theta of a direction; 1 and s of a displacement s.

        So a rate is Im(conj(z) z') of z = rho + i theta for both.
        """
        if slot in self._moment:
            return self._moment[slot]
        return self._extra[slot], self.real[slot]

    def factorise(self) -> Factors:
        """Factor K, after `residuals(0)`."""
        return Factors(self.matrix(), self.first_unknowns, self.arithmetic.keep)

    @property
    def first_unknowns(self) -> int:
        """The number of unknowns that are accelerations."""
        program = self.program
        return sum(isinstance(program.rows[x], COORDINATES) for x in program.unknowns)

    def _balances(self) -> dict[Slot, int]:
        """Return moments that change with the unknowns exactly as a residual does."""
        found: dict[Slot, int] = {}
        for place, slot in enumerate(self.program.residuals):
            while isinstance(row := self.program.rows[slot], rows.Sum):
                changing = [(c, x) for c, x in row.terms if x in self.live[slot]]
                if len(changing) != 1 or changing[0][0] != 1.0:
                    break
                slot = changing[0][1]
            if isinstance(row, rows.Moment):
                found[slot] = place
        return found

    def matrix(self) -> list[dict[int, Value]]:
        """Return the rows of K, the derivatives of residuals by unknowns, after `residuals(0)`."""
        place = {slot: i for i, slot in enumerate(self.program.unknowns)}
        tangents: dict[Slot, dict[Slot, Any]] = {}
        for slot, row in self.rows:
            if slot not in self.live:
                continue
            tangents[slot] = {}
            by_unknown: dict[Slot, dict[Slot, Any]] = {}
            if isinstance(row, (*COORDINATES, rows.Unknown)):
                by_unknown[slot] = {}
            else:
                for x in self.live[slot]:
                    for unknown, value in tangents[x].items():
                        by_unknown.setdefault(unknown, {})[x] = value
            for unknown, change in by_unknown.items():
                self.unknown_values = {unknown: 1.0}
                tangents[slot][unknown] = self.change(slot, row, self.ahead[slot], change)
        self.unknown_values = {}
        return [
            {place[u]: value for u, value in tangents.get(slot, {}).items() if some(value)}
            for slot in self.program.residuals
        ]


_KNOWN: dict[type, Callable[[Any, Slot, Any, Any], Any]] = {
    **dict.fromkeys((rows.Given, rows.Unknown, rows.Turn, rows.Slide, rows.Rate), Series._given),
    **dict.fromkeys(LINEAR, Series._sum),
    **dict.fromkeys(PRODUCTS, Series._product),
    **dict.fromkeys(FUNCTIONS, Series._function),
    rows.Moment: Series._known_moment,
}
