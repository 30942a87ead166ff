"""The rule of each row: its next coefficient from those of the slots that it reads.

A rule has two halves: what is known before the unknowns of an order are (`known`), and what these
add (`change`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from robodyn.engines.arithmetic import (
    ZERO,
    Planar,
    Value,
    difference,
    over,
    planar_plus,
    planar_times,
    plus,
    times,
)
from robodyn.engines.frames import Framed, Frames
from robodyn.mechanics import program as rows
from robodyn.mechanics.program import Coefficient, PlanarCoefficient, Row, Slot

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
    """A planar number times a real one."""
    return times(scale, z[0]), times(scale, z[1])


class Rules(Frames):
    """The rules by which the coefficients of a program's slots grow."""

    def known(self, slot: Slot, row: Row, m: int) -> Any:
        """Coefficient m of a slot; of unknowns of the present order nothing."""
        return _KNOWN[type(row)](self, slot, row, m)

    def _given(self, slot: Slot, row: Row, m: int) -> Any:
        """What is given, and the coordinates with their rates; of unknowns nothing."""
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
        """What is given as the first coefficient."""
        given = self.state.given[name]
        return given(0) if callable(given) else given[0]

    def _found(self, x: Slot, m: int) -> Any:
        """Coefficient m of a slot, which is there."""
        return self.planar[x][m] if x in self.planar else self.real[x][m]

    def _product(self, slot: Slot, row: Row, m: int) -> Any:
        """Products of two series; those with a direction in its own frame."""
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
        """By its value at order 0, and its differential equation from there on."""
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
        """The value of x's interval."""
        arithmetic = self.arithmetic
        if not row.period:
            return arithmetic.chosen(x, row.knots, row.values)
        periods = arithmetic.functions["floor"]((x - row.first) / row.period)
        value = arithmetic.chosen(x - row.period * periods, row.knots, row.values)
        return plus(value, times(row.rise, periods))

    def _accumulate(self, total: Value, c: Coefficient, value: Value) -> Value:
        """total + c value, with the sign of a coefficient 1 or -1 free."""
        negative = c < 0.0 if isinstance(c, float) else c.sign < 0.0
        if not negative or (type(total) is float and total == 0.0):
            return plus(total, times(self.coefficient(c), value))
        return difference(total, times(self.coefficient(-c), value))

    def _linear(
        self, row: Row, m: int, of: Callable[[Slot, int], Any], begins: bool = False
    ) -> Any:
        """A row that is a sum of others, by what `of(slot, order)` gives; None adds nothing.

        Where it `begins`, with its constant.
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
        """1/2 sum of x_j x_{m-j} for 0 < j < m."""
        total = self.convolve(x, x, m, 1, (m - 1) // 2)
        if m % 2 == 0:
            half = x[m // 2]
            total = plus(total, times(0.5, times(half, half)))
        return total

    def _rate(self, slot: Slot, E: Slot, m: int) -> Value:
        """Of w in z' = i w z: the terms that are known."""
        rho, theta = self._moment[E]
        known = self.convolve(self.real[slot], rho, m, 0, m - 1)
        return difference(times(m + 1.0, theta[m + 1]), known)

    def _known_moment(self, slot: Slot, row: rows.Moment, m: int) -> Value:
        """Im(conj(z) F) in the frame of the link, with its own part inertia P in F."""
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
        """By the function's differential equation; `_extra` holds the other series it takes."""
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
        """What the unknowns add to coefficient m of a live slot, given what they add to others."""
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
        raise AssertionError(row)

    def _moment_change(self, row: rows.Moment, change: dict[Slot, Any]) -> Planar:
        """What the unknowns add to the force F + inertia P on a link, in the link's frame."""
        force, own = ZERO, ZERO
        if row.F in change:
            force = self.into(self._link(row.turn), change[row.F])
        if row.bend in change:
            own = change[row.bend][0][2]
        by = self.coefficient(row.inertia)
        return plus(force[0], times(by, own[0])), plus(force[1], times(by, own[1]))

    def _frame(self, z: Slot) -> int | None:
        """That of a direction is its own, of others the ground's."""
        return self._link(z) if z in self._moment else None

    def _link(self, turn: Slot) -> int:
        row = self.program.rows[turn]
        assert isinstance(row, rows.Turn)
        return row.link


_KNOWN: dict[type, Callable[[Any, Slot, Any, Any], Any]] = {
    **dict.fromkeys((rows.Given, rows.Unknown, rows.Turn, rows.Slide, rows.Rate), Rules._given),
    **dict.fromkeys(LINEAR, Rules._sum),
    **dict.fromkeys(PRODUCTS, Rules._product),
    **dict.fromkeys(FUNCTIONS, Rules._function),
    rows.Moment: Rules._known_moment,
}
