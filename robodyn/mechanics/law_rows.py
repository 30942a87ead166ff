"""Laws of couplings as rows: the law and its slopes by joints.

A slope is a `Part` like the law itself: a slot, or a number if it is constant.  Series and machine
code need slopes as rows, for coefficients of every order; numpy evaluates the same rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robodyn.elements.program import (
    Function,
    Power,
    Primitive,
    Product,
    Program,
    Quotient,
    Slot,
    Sum,
)
from robodyn.errors import InputError
from robodyn.mechanics.expression_rows import ExpressionRows, Part, Slotted
from robodyn.mechanics.signal_rows import edges, step
from robodyn.scene.scene import Curve, Law


class LawRows:
    """The rows of laws; `variable` returns the slot of q0, q1, .."""

    def __init__(self, program: Program, variable: Callable[[str], Slot]) -> None:
        self.program, self.variable = program, variable
        self.made = ExpressionRows(program, variable, lambda what: InputError(what))

    def value(self, law: Law | Curve) -> Part:
        """Return the law."""
        return self.made.read(law.node) if isinstance(law, Law) else self._curve(law)

    def _curve(self, curve: Curve) -> Part:
        """Return c0 + xi (c1 + xi (c2 + xi c3)), xi = x - x_k in interval k."""
        made, x = self.made, self.variable(curve.over)

        def of(values: Sequence[float], rise: float = 0.0) -> Part:
            return Slotted(self.program.add(step(x, curve.x, curve.repeats, values, rise)))

        first, last = curve.x[0], curve.x[-1]
        begins = of(curve.x[:-1], last - first if curve.repeats else 0.0)
        xi = made.sum(Slotted(x), begins, -1.0)
        c0, *others = zip(*curve.pieces, strict=True)
        total: Part = 0.0
        for c in reversed(others):
            total = made.product(xi, made.sum(of(c), total, 1.0))
        return made.sum(of(c0, curve.rise), total, 1.0)

    def edges(self, curve: Curve) -> list[Slot]:
        """Return the edges of a curve's interval; see `signal_rows.edges`."""
        return edges(self.program, self.variable(curve.over), curve.x, curve.repeats)

    def slopes(self, value: Part, names: Sequence[str]) -> list[Part]:
        """Return the derivatives of a value by the variables `names`."""
        return [self._slope(value, self.variable(name), {}) for name in names]

    def _slope(self, value: Part, by: Slot, known: dict[Slot, Part]) -> Part:
        """Return the derivative of a value by a variable's slot; `known` caches those of parts."""
        if not isinstance(value, Slotted):
            return 0.0
        slot = int(value)
        if slot == by:
            return 1.0
        if slot not in known:
            known[slot] = self._of_row(slot, by, known)
        return known[slot]

    def _of_row(self, slot: Slot, by: Slot, known: dict[Slot, Part]) -> Part:
        made = self.made

        def of(x: Slot) -> Part:
            return self._slope(Slotted(x), by, known)

        match self.program.rows[slot]:
            case Sum(terms=terms):
                total: Part = 0.0
                for c, x in terms:
                    factor = c if isinstance(c, float) else self.program.numbers[c.place] * c.sign
                    total = made.sum(total, made.product(factor, of(x)), 1.0)
                return total
            case Product(x=x, y=y) if x == y:
                return made.product(2.0, made.product(Slotted(x), of(x)))
            case Product(x=x, y=y):
                one, other = made.product(of(x), Slotted(y)), made.product(Slotted(x), of(y))
                return made.sum(one, other, 1.0)
            case Quotient(x=x, y=y):
                less = made.product(Slotted(slot), of(y))
                inner = made.sum(of(x), less, -1.0)
                return made.quotient(inner, Slotted(y)) if _moves(inner) else 0.0
            case Power(x=x, exponent=exponent):
                outer = made.product(exponent, made.power(Slotted(x), exponent - 1.0))
                return made.product(outer, of(x))
            case Primitive(x=x, density=y):
                inner = of(x)
                return made.quotient(inner, Slotted(y)) if _moves(inner) else 0.0
            case Function(name=name, x=x):
                inner = of(x)
                return (
                    made.product(self._of_function(name, slot, x), inner) if _moves(inner) else 0.0
                )
        return 0.0  # what does not move with the variable

    def _of_function(self, name: str, slot: Slot, x: Slot) -> Part:
        """Return f' of a function f with value in `slot`."""
        made = self.made
        match name:
            case "exp":
                return Slotted(slot)
            case "tanh":
                return made.sum(1.0, made.product(Slotted(slot), Slotted(slot)), -1.0)
        partner, sign = PARTNERS[name]
        return made.product(sign, Slotted(self.program.add(Function(partner, x))))


PARTNERS = {
    "sin": ("cos", 1.0),
    "cos": ("sin", -1.0),
    "sinh": ("cosh", 1.0),
    "cosh": ("sinh", 1.0),
}


def _moves(part: Part) -> bool:
    """Return whether a part is other than zero."""
    return isinstance(part, Slotted) or part != 0.0
