"""Evaluates a program of rows as power series in time, order by order, over any kind of numbers.

The numbers are what `Arithmetic` says: floats, nodes of a recorded formula, numpy arrays over
lanes, or numbers of many digits.  One order is enough for values: the accelerations at a state.

At order p every slot gets the coefficient that the program's schedule wants: first what is known of
it (the unknowns of this order taken as zero), then, once the residuals are solved for the unknowns,
the rest.  The unknowns of every order enter through the same matrix K = [M Psi^T; Psi 0], which
follows from the rows by walking them; it is factored once.

A direction is E_m = (rho_m + i theta_m) E_0.  As |E| = 1 its radial coefficient is known,

    rho_m = -1/2 sum_{0<j<m} (rho_j rho_{m-j} + theta_j theta_{m-j}),

and theta_m = u/(m (m-1)) with the unknown u of order m - 2, which at order 0 is the link's angular
acceleration.  Planar coefficients stay sums over such frames E_0, and a moment about a link is
taken in the frame of that link: products of two directions are found once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from robodyn.engines.factors import Factors
from robodyn.mechanics.program import (
    Anchored,
    Coefficient,
    Derivative,
    Function,
    Given,
    Inner,
    Integral,
    Moment,
    PlanarCoefficient,
    PlanarSum,
    Power,
    Primitive,
    Product,
    Program,
    Quotient,
    Rate,
    RealPart,
    Row,
    Scaled,
    Slot,
    Sum,
    Turn,
    Unknown,
)

Value = Any
Planar = tuple[Value, Value]
# frame (a link, or None: the ground's), coefficient that is not yet multiplied, value
Framed = tuple[tuple[int | None, PlanarCoefficient | None, Planar], ...]
Tangent = dict[Slot, Value]

ZERO: Planar = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """The functions of one kind of numbers; +, -, *, / are the numbers' own."""

    cos: Callable[[Value], Value]
    sin: Callable[[Value], Value]
    power: Callable[[Value, float], Value]
    functions: dict[str, Callable[[Value], Value]] = field(default_factory=dict)
    # sum of x_j y_{m-j} for j from first to last
    convolve: Callable[[Any, Any, int, int, int], Value] | None = None
    room: Callable[[int], Any] = lambda orders: [0.0] * orders
    keep: Callable[[Value], Value] = lambda value: value  # marks what is used again and again


_FUNCTIONS = ("exp", "tanh", "sin", "cos", "sinh", "cosh", "log", "atan", "asin", "acos")
FLOATS = Arithmetic(
    cos=math.cos,
    sin=math.sin,
    power=math.pow,
    functions={name: getattr(math, name) for name in _FUNCTIONS},
)


def times(a: Value, b: Value) -> Value:
    """a b, without the products of a structural zero or one."""
    if type(a) is float:
        if a == 0.0:
            return 0.0
        if a == 1.0:
            return b
    if type(b) is float:
        if b == 0.0:
            return 0.0
        if b == 1.0:
            return a
    return a * b


def plus(a: Value, b: Value) -> Value:
    """a + b, without adding a structural zero."""
    if type(a) is float and a == 0.0:
        return b
    if type(b) is float and b == 0.0:
        return a
    return a + b


def over(a: Value, k: int) -> Value:
    """a / k; of recorded numbers a product with 1/k, of longer ones to their last digit."""
    return 0.0 if type(a) is float and a == 0.0 else a / float(k)


def planar_times(a: Planar, b: Planar) -> Planar:
    """a b of complex numbers."""
    return (
        plus(times(a[0], b[0]), times(-1.0, times(a[1], b[1])) if _some(a[1], b[1]) else 0.0),
        plus(times(a[0], b[1]), times(a[1], b[0])),
    )


def _some(*values: Value) -> bool:
    return not any(type(x) is float and x == 0.0 for x in values)


def difference(a: Value, b: Value) -> Value:
    """a - b, without a structural zero."""
    if type(b) is float and b == 0.0:
        return a
    return a - b


def conjugate_times(a: Planar, b: Planar) -> Planar:
    """conj(a) b."""
    return (
        plus(times(a[0], b[0]), times(a[1], b[1])),
        difference(times(a[0], b[1]), times(a[1], b[0])),
    )


def _scaled(scale: float, framed: Framed) -> Framed:
    """A planar coefficient times a number."""
    return tuple((f, c, (times(scale, a), times(scale, b))) for f, c, (a, b) in framed)


def planar_plus(a: Planar, b: Planar) -> Planar:
    """a + b of complex numbers."""
    return plus(a[0], b[0]), plus(a[1], b[1])


@dataclass(frozen=True, slots=True)
class State:
    """Where a series starts: the links' directions E (n), rates w, and the values of `Given`s.

    `given` maps a name to its first coefficients, or to a function of the order that returns one.
    `turn` (j, k) gives conj(E_j) E_k where there is a cheaper way than to multiply.
    """

    E: Sequence[Planar]
    w: Sequence[Value]
    given: dict[str, Sequence[Value] | Callable[[int], Value]]
    turn: Callable[[int, int], Planar] | None = None


class Series:
    """The coefficients of a program's slots along one motion."""

    def __init__(
        self,
        program: Program,
        arithmetic: Arithmetic,
        numbers: Sequence[Value],
        orders: int,
        state: State,
        *,
        slots: Sequence[Slot] = (),
        grounded: bool = False,
    ) -> None:
        """`orders` of unknowns are expanded; `slots` are wanted besides the residuals.

        With `grounded` forces are summed in the ground's frame, which pays on deep trees.
        """
        self.program, self.arithmetic, self.numbers, self.state = (
            program,
            arithmetic,
            numbers,
            state,
        )
        self.orders, self.grounded = orders, grounded
        order, self.ahead, self.live = program.schedule(slots)
        self.rows: list[tuple[Slot, Row]] = [(x, program.rows[x]) for x in order]
        self.real: dict[Slot, Any] = {}
        self.planar: dict[Slot, list[Framed]] = {}
        self._factor: dict[tuple[int | None, int | None, PlanarCoefficient | None], Planar] = {}
        self._ground: dict[Slot, tuple[Any, Any]] = {}
        self._moment: dict[Slot, tuple[Any, Any]] = {}
        self._extra: dict[Slot, Any] = {}
        self.unknown_values: dict[Slot, Value] = {}
        room, K = arithmetic.room, orders + 3
        for slot, row in self.rows:
            if program.planar[slot]:
                self.planar[slot] = [()] * K
                if isinstance(row, Turn):
                    self._moment[slot] = (room(K), room(K))  # rho, theta
            else:
                self.real[slot] = room(K)
            if isinstance(row, Moment):
                self._moment[slot] = (room(K), room(K))
            if isinstance(row, Function):
                self._extra[slot] = room(K)
        for slot, row in self.rows:
            for m in range(self.ahead[slot]):
                self._set(slot, m, self._known(slot, row, m))
        self._balance: dict[Slot, int] = {}
        self._residuals: list[Value] = []
        self.factors: Factors | None = None
        self.p = 0

    # -- one order ---------------------------------------------------------------------------------

    def residuals(self, p: int) -> list[Value]:
        """What the residuals are at order p with the unknowns of that order zero."""
        self.p, self.unknown_values = p, {}
        for slot, row in self.rows:
            m = p + self.ahead[slot]
            self._set(slot, m, self._known(slot, row, m))
        self._residuals = [self.real[slot][p] for slot in self.program.residuals]
        return self._residuals

    def complete(self, unknowns: Sequence[Value], balanced: bool = False) -> None:
        """Add what the unknowns of this order make; `balanced`: they solve the residuals."""
        self._balance = self._balances() if balanced else {}
        p, program = self.p, self.program
        self.unknown_values = dict(zip(program.unknowns, unknowns, strict=True))
        change: dict[Slot, Any] = {}
        for slot, row in self.rows:
            if slot not in self.live:
                continue
            m = p + self.ahead[slot]
            through = {x: change[x] for x in self.live[slot]}
            delta = change[slot] = self._change(slot, row, m, through)
            match row:
                case Turn(link=k):
                    rho, theta = self._moment[slot]
                    theta[m] = self.arithmetic.keep(delta[0][2][1])
                    self._set(slot, m, ((k, None, (rho[m], theta[m])),))
                case Derivative() if program.planar[slot]:
                    self._set(slot, m, self._known(slot, row, m))
                case _ if program.planar[slot]:
                    self._set(slot, m, (*self.planar[slot][m], *delta))
                case Moment():
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

    def expand(self, factors: Factors | None = None) -> list[list[Value]]:
        """All orders; the unknowns of each."""
        found: list[list[Value]] = []
        for p in range(self.orders):
            right = [times(-1.0, x) if type(x) is float else -x for x in self.residuals(p)]
            if p == 0:
                self.factors = factors or self.factorise()
            assert self.factors is not None
            solution = self.factors.solve(right)
            self.complete(solution, balanced=True)
            found.append(solution)
        return found

    def turn(self, slot: Slot) -> tuple[Any, Any]:
        """The coefficients rho and theta of a direction."""
        return self._moment[slot]

    def factorise(self) -> Factors:
        """K factored; after `residuals(0)`."""
        return Factors(self.matrix(), self.first_unknowns, self.arithmetic.keep)

    @property
    def first_unknowns(self) -> int:
        """How many of the unknowns are accelerations."""
        rows = self.program.rows
        return sum(isinstance(rows[x], Turn) for x in self.program.unknowns)

    def _balances(self) -> dict[Slot, int]:
        """The moments that the unknowns change by as much as they change a residual."""
        found: dict[Slot, int] = {}
        for place, slot in enumerate(self.program.residuals):
            while isinstance(row := self.program.rows[slot], Sum):
                changing = [(c, x) for c, x in row.terms if x in self.live[slot]]
                if len(changing) != 1 or changing[0][0] != 1.0:
                    break
                slot = changing[0][1]
            if isinstance(row, Moment):
                found[slot] = place
        return found

    def matrix(self) -> list[dict[int, Value]]:
        """The rows of K, the tangents of the residuals in the unknowns; after `residuals(0)`."""
        place = {slot: i for i, slot in enumerate(self.program.unknowns)}
        tangents: dict[Slot, dict[Slot, Any]] = {}
        for slot, row in self.rows:
            if slot not in self.live:
                continue
            tangents[slot] = {}
            by_unknown: dict[Slot, dict[Slot, Any]] = {}
            if isinstance(row, (Turn, Unknown)):
                by_unknown[slot] = {}
            else:
                for x in self.live[slot]:
                    for unknown, value in tangents[x].items():
                        by_unknown.setdefault(unknown, {})[x] = value
            for unknown, change in by_unknown.items():
                self.unknown_values = {unknown: 1.0}
                tangents[slot][unknown] = self._change(slot, row, self.ahead[slot], change)
        self.unknown_values = {}
        return [
            {place[u]: value for u, value in tangents.get(slot, {}).items() if _some(value)}
            for slot in self.program.residuals
        ]

    # -- planar coefficients -----------------------------------------------------------------------

    def coefficient(self, c: Coefficient) -> Value:
        """The number that a coefficient is."""
        if isinstance(c, float):
            return c
        return times(c.sign, self.numbers[c.place])

    def factor(self, to: int | None, frame: int | None, c: PlanarCoefficient | None) -> Planar:
        """c E_frame in the frame `to`: conj(E_to) c E_frame."""
        key = (to, frame, c)
        found = self._factor.get(key)
        if found is None:
            if c is not None:
                number = self.coefficient(c[0]), self.coefficient(c[1])
                found = planar_times(number, self.factor(to, frame, None))
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
        """The value of a planar coefficient in one frame."""
        total = ZERO
        for frame, c, value in framed:
            total = planar_plus(total, planar_times(self.factor(to, frame, c), value))
        return total

    def real_part(self, framed: Framed) -> Value:
        """Re of a planar coefficient."""
        total: Value = 0.0
        for frame, c, value in framed:
            by = self.factor(None, frame, c)
            total = plus(total, times(by[0], value[0]))
            total = difference(total, times(by[1], value[1]))
        return total

    def ground(self, z: Slot, m: int) -> Planar:
        """Coefficient m of a planar slot in the ground's frame."""
        return self.into(None, self.planar[z][m])

    # -- rows --------------------------------------------------------------------------------------

    def _set(self, slot: Slot, m: int, value: Any) -> None:
        if slot in self.planar:
            self.planar[slot][m] = value
            if slot in self._ground:
                self._remember(slot, m)
        else:
            self.real[slot][m] = value

    def _grounded(self, z: Slot, last: int) -> tuple[Any, Any]:
        """The series of a planar slot in the ground's frame, kept as it grows."""
        if z not in self._ground:
            room = self.arithmetic.room
            self._ground[z] = (room(self.orders + 3), room(self.orders + 3))
            for m in range(last + 1):
                self._remember(z, m)
        return self._ground[z]

    def _remember(self, z: Slot, m: int) -> None:
        x, y = self._ground[z]
        x[m], y[m] = self.ground(z, m)

    def convolve(self, x: Any, y: Any, m: int, first: int = 0, last: int | None = None) -> Value:
        """Sum of x_j y_{m-j} for j from `first` to `last` (m, unless given)."""
        last = m if last is None else last
        if last < first:
            return 0.0
        if self.arithmetic.convolve is not None:
            return self.arithmetic.convolve(x, y, m, first, last)
        total: Value = 0.0
        if x is y and first + last == m:  # a square: equal terms once
            for j in range(first, (m + 1) // 2):
                total = plus(total, times(x[j], x[m - j]))
            total = times(2.0, total)
            return plus(total, times(x[m // 2], x[m // 2])) if m % 2 == 0 else total
        for j in range(first, last + 1):
            total = plus(total, times(x[j], y[m - j]))
        return total

    def slope(self, x: Any, y: Any, m: int) -> Value:
        """Coefficient m of the integral of x' y: 1/m sum j x_j y_{m-j}."""
        total: Value = 0.0
        for j in range(1, m + 1):
            total = plus(total, times(times(float(j), x[j]), y[m - j]))
        return over(total, m)

    def _known(self, slot: Slot, row: Row, m: int) -> Any:
        """Coefficient m of a slot; of unknowns of the present order nothing."""
        real, planar = self.real, self.planar
        match row:
            case Given(name=name):
                given = self.state.given[name]
                if callable(given):
                    return given(m)
                return given[m] if m < len(given) else 0.0
            case Unknown():
                return 0.0
            case Turn(link=k):
                return self._turn(slot, k, m)
            case Rate(turn=E):
                return self._rate(E, m)
            case Integral(x=x, start=start):
                if m == 0:
                    given = self.state.given[start]
                    return given(0) if callable(given) else given[0]
                return over(real[x][m - 1], m)
            case Anchored(x=x, start=start):
                return self._known(slot, Integral(x, start), 0) if m == 0 else real[x][m]
            case Derivative(x=x) if x in planar:
                return _scaled(m + 1.0, planar[x][m + 1])
            case Derivative(x=x):
                return times(m + 1.0, real[x][m + 1])
            case Sum(constant=constant, terms=terms):
                total: Value = self.coefficient(constant) if m == 0 else 0.0
                for c, x in terms:
                    total = self._accumulate(total, c, real[x][m])
                return total
            case PlanarSum(constant=by, terms=planar_terms):
                start_value: Framed = ()
                if m == 0 and by != (0.0, 0.0):
                    start_value = ((None, by, (1.0, 0.0)),)
                return start_value + self._planar_sum(planar_terms, lambda z: self._value(z, m))
            case RealPart(z=z):
                return self.real_part(planar[z][m])
            case Product(x=x, y=y):
                return self.convolve(real[x], real[y], m)
            case Scaled(x=x, z=z):
                a, b = self._grounded(z, m)
                return ((None, None, (self.convolve(real[x], a, m), self.convolve(real[x], b, m))),)
            case Inner(z=z, w=w):
                (a, b), (c, d) = self._grounded(z, m), self._grounded(w, m)
                return plus(self.convolve(a, c, m), self.convolve(b, d, m))
            case Moment():
                return self._known_moment(slot, row, m)
            case Quotient(x=x, y=y):
                known = self.convolve(real[slot], real[y], m, 0, m - 1)
                return difference(real[x][m], known) / real[y][0]
            case Power(x=x, exponent=exponent):
                if m == 0:
                    return self.arithmetic.power(real[x][0], exponent)
                total = 0.0
                for j in range(1, m + 1):
                    weight = (exponent + 1.0) * j - m
                    total = plus(total, times(times(weight, real[x][j]), real[slot][m - j]))
                return over(total, m) / real[x][0]
            case Function(name=name, x=x):
                return self._function(slot, name, real[x], m)
            case Primitive(name=name, x=x, density=y):
                if m == 0:
                    return self.arithmetic.functions[name](real[x][0])
                known = 0.0
                for j in range(1, m):
                    product = times(times(float(j), real[slot][j]), real[y][m - j])
                    known = plus(known, product)
                return difference(real[x][m], over(known, m)) / real[y][0]
        raise AssertionError(row)

    def _accumulate(self, total: Value, c: Coefficient, value: Value) -> Value:
        """total + c value, with the sign of a coefficient 1 or -1 free."""
        negative = c < 0.0 if isinstance(c, float) else c.sign < 0.0
        if not negative or (type(total) is float and total == 0.0):
            return plus(total, times(self.coefficient(c), value))
        return difference(total, times(self.coefficient(-c), value))

    def _value(self, z: Slot, m: int) -> Framed:
        """Coefficient m of a planar or real slot, as a planar one."""
        if z in self.planar:
            return self.planar[z][m]
        return ((None, None, (self.real[z][m], 0.0)),)

    def _planar_sum(
        self, terms: Sequence[tuple[PlanarCoefficient, Slot]], value: Callable[[Slot], Framed]
    ) -> Framed:
        parts: list[tuple[int | None, PlanarCoefficient | None, Planar]] = []
        for c, z in terms:
            framed = value(z)
            if self.grounded and any(frame is not None for frame, _, _ in framed):
                framed = ((None, None, self.into(None, framed)),)
            for frame, inner, (a, b) in framed:
                if inner is not None:
                    a, b = planar_times(
                        (self.coefficient(inner[0]), self.coefficient(inner[1])), (a, b)
                    )
                parts.append((frame, c, (a, b)))
        return tuple(parts)

    def _turn(self, slot: Slot, link: int, m: int) -> Framed:
        rho, theta = self._moment[slot]
        if m == 0:
            rho[0], theta[0] = value = (1.0, 0.0)
        elif m == 1:
            rho[1], theta[1] = value = (0.0, self.state.w[link])
        else:
            square = plus(self._half_square(rho, m), self._half_square(theta, m))
            rho[m], theta[m] = value = (self.arithmetic.keep(times(-1.0, square)), 0.0)
        return ((link, None, value),)

    def _half_square(self, x: Any, m: int) -> Value:
        """1/2 sum of x_j x_{m-j} for 0 < j < m."""
        total = self.convolve(x, x, m, 1, (m - 1) // 2)
        if m % 2 == 0:
            half = x[m // 2]
            total = plus(total, times(0.5, times(half, half)))
        return total

    def _rate(self, E: Slot, m: int) -> Value:
        """Of w = Im(conj(z) z'): the terms that are known."""
        rho, theta = self._moment[E]
        total: Value = 0.0
        for j in range(m + 1):
            total = plus(total, times(j + 1.0, times(rho[m - j], theta[j + 1])))
            total = difference(total, times(j + 1.0, times(theta[m - j], rho[j + 1])))
        return total

    def _known_moment(self, slot: Slot, row: Moment, m: int) -> Value:
        """Im(conj(z) F) in the frame of the link, with its own part inertia P in F."""
        rho, theta = self._moment[row.turn]
        own = self.coefficient(row.inertia)
        _, _, bend = self.planar[row.bend][m][0]
        force = self.into(self._link(row.turn), self.planar[row.F][m])
        x, y = self._moment[slot]
        x[m] = plus(force[0], times(own, bend[0]))
        y[m] = plus(force[1], times(own, bend[1]))
        total = y[m]
        total = plus(total, self.convolve(rho, y, m, 2, m))
        return difference(total, self.convolve(theta, x, m, 1, m))

    def _function(self, slot: Slot, name: str, x: Any, m: int) -> Value:
        """By the function's differential equation; `_extra` holds the other series it takes."""
        y, other, functions = self.real[slot], self._extra[slot], self.arithmetic.functions
        if name == "exp":
            return functions["exp"](x[0]) if m == 0 else self.slope(x, y, m)
        if name == "tanh":  # y' = x' (1 - y^2)
            if m == 0:
                return functions["tanh"](x[0])
            square = self.convolve(y, y, m - 1)
            other[m - 1] = difference(1.0 if m == 1 else 0.0, square)
            return self.slope(x, other, m)
        partner = {"sin": "cos", "cos": "sin", "sinh": "cosh", "cosh": "sinh"}[name]
        if m == 0:
            other[0] = functions[partner](x[0])
            return functions[name](x[0])
        found = self.slope(x, other, m)
        back = self.slope(x, y, m)
        if name == "cos":  # cos' = -sin, sin' = cos
            found = times(-1.0, found)
        elif name == "sin":
            back = times(-1.0, back)
        other[m] = back
        return found

    # -- what the unknowns change ------------------------------------------------------------------

    def _change(self, slot: Slot, row: Row, m: int, change: dict[Slot, Any]) -> Any:
        """What the unknowns add to coefficient m of a live slot, given what they add to others."""
        real = self.real

        def of(x: Slot) -> Value:
            return change.get(x, 0.0)

        match row:
            case Unknown():
                return self.unknown_values.get(slot, 0.0)
            case Turn(link=k):
                added = over(self.unknown_values.get(slot, 0.0), m * (m - 1))
                return ((k, None, (0.0, added)),)
            case Rate(turn=E):
                _, _, (_, theta) = change[E][0]
                return times(m + 1.0, theta)
            case Derivative(x=x) if x in self.planar:
                return _scaled(m + 1.0, change[x])
            case Derivative(x=x):
                return times(m + 1.0, of(x))
            case Integral(x=x):
                return over(of(x), m)
            case Anchored(x=x):
                return of(x)
            case Sum(terms=terms):
                total: Value = 0.0
                for c, x in terms:
                    if x in change:
                        total = self._accumulate(total, c, change[x])
                return total
            case PlanarSum(terms=planar_terms):
                kept = [(c, z) for c, z in planar_terms if z in change]
                return self._planar_sum(kept, lambda z: self._as_planar(change[z], z))
            case RealPart(z=z):
                return self.real_part(change[z])
            case Product(x=x, y=y):
                return plus(times(of(x), real[y][0]), times(real[x][0], of(y)))
            case Moment():
                return self._moment_change(row, change)[1]  # z_0 = 1
            case Inner(z=z, w=w):
                total = 0.0
                for one, two in ((z, w), (w, z)):
                    if one in change:
                        a, b = self.into(None, change[one])
                        c, d = self.ground(two, 0)
                        total = plus(total, plus(times(a, c), times(b, d)))
                return total
            case Scaled(x=x, z=z):
                a, b = self.ground(z, 0)
                result = (times(of(x), a), times(of(x), b))
                if z in change:
                    c, d = self.into(None, change[z])
                    result = planar_plus(result, (times(real[x][0], c), times(real[x][0], d)))
                return ((None, None, result),)
        raise AssertionError(row)

    def _moment_change(self, row: Moment, change: dict[Slot, Any]) -> Planar:
        """What the unknowns add to the force F + inertia P on a link, in the link's frame."""
        force, own = ZERO, ZERO
        if row.F in change:
            force = self.into(self._link(row.turn), change[row.F])
        if row.bend in change:
            own = change[row.bend][0][2]
        by = self.coefficient(row.inertia)
        return plus(force[0], times(by, own[0])), plus(force[1], times(by, own[1]))

    def _link(self, turn: Slot) -> int:
        row = self.program.rows[turn]
        assert isinstance(row, Turn)
        return row.link

    def _as_planar(self, change: Any, z: Slot) -> Framed:
        return change if z in self.planar else ((None, None, (change, 0.0)),)
