"""Joint torques as rows of the program: constants, tables, and smooth expressions of t, q and qd.

What has no series (comparisons, abs, min, ... of the state, and functions of Python) is refused;
those of time alone stand still between the times at which they switch.
"""

from __future__ import annotations

import ast
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence

from robodyn.errors import InputError
from robodyn.mechanics.actuation import FUNCTIONS, Actuation
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.program import (
    Function,
    Given,
    Power,
    Primitive,
    Product,
    Quotient,
    Slot,
    Sum,
)

MOST_FACTORS = 64  # of a whole power that is written as products


def torque_slots(
    equations: EquationsOfMotion, actuation: Actuation, held: Sequence[float] | None = None
) -> list[Slot | None]:
    """The slots of the joint torques (n), None where there is none.

    Those of constants and of what is linear between kinks are `Given` as tau0, tau1, ...  `held`
    tells how the switches of an expression stand; None: every branch is read, to see that it
    serves.  Raises InputError for a torque that has no series.
    """
    n, add = equations.mechanism.n, equations.program.add
    if actuation.constants is not None:
        return [add(Given(f"tau{j}")) if x else None for j, x in enumerate(actuation.constants)]
    if actuation.linear:
        driven = set(equations.mechanism.actuated)
        return [add(Given(f"tau{j}")) if j in driven else None for j in range(n)]
    if actuation.control is not None:
        raise _refused("a controller that acts continuously")
    reader = _Reader(equations, held)
    slots: list[Slot | None] = [None] * n
    for line in actuation.lines:
        match ast.parse(line).body:
            case [ast.Assign(targets=[ast.Name(id="_s")])]:
                pass
            case [ast.Assign(targets=[ast.Name(id=name)], value=value)]:
                torque = reader.read(value)
                if isinstance(torque, Slotted) or torque:
                    slots[int(name.removeprefix("tau"))] = reader.slot(torque)
            case _:
                raise _refused("a function of Python")
    return slots


def linear_piece(
    actuation: Actuation,
    torques: Callable[[float, Sequence[float]], Sequence[float]],
    t: float,
    y: Sequence[float],
    direction: float,
) -> tuple[list[float], list[float]]:
    """Of what is linear between kinks: the torques at t and their slopes up to the next."""
    kinks = actuation.kinks
    if direction > 0.0:
        end = kinks[min(bisect_right(kinks, t), len(kinks) - 1)]
    else:
        end = kinks[max(bisect_left(kinks, t) - 1, 0)]
    third = (end - t) / 3.0 or 1.0
    first, second = (torques(t + k * third, y) for k in (1, 2))
    slopes = [(b - a) / third for a, b in zip(first, second, strict=True)]
    return [a - s * third for a, s in zip(first, slopes, strict=True)], slopes


class Slotted(int):
    """A slot, told from a number."""


Part = Slotted | float


class _Reader:
    """Rows of expressions; what is constant stays a number."""

    def __init__(self, equations: EquationsOfMotion, held: Sequence[float] | None) -> None:
        self.held = held
        self.equations, self.program = equations, equations.program

    def slot(self, part: Part) -> Slot:
        """The slot of a part, constants included."""
        if isinstance(part, Slotted):
            return int(part)
        return self.program.add(Sum(self.program.number(part), ()))

    def read(self, tree: ast.expr) -> Part:
        """What an expression is, after its parts."""
        equations = self.equations
        match tree:
            case ast.Constant(value=int() | float() as value):
                return float(value)
            case ast.Name(id="t"):
                return Slotted(equations.t())
            case ast.Name(id=name) if name.startswith("qd"):
                return Slotted(equations.v(int(name[2:])))
            case ast.Name(id=name) if name.startswith("q"):
                return Slotted(equations.q(int(name[1:])))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.read(operand)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self.sum(0.0, self.read(operand), -1.0)
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return self.sum(self.read(left), self.read(right), 1.0)
            case ast.BinOp(left=left, op=ast.Sub(), right=right):
                return self.sum(self.read(left), self.read(right), -1.0)
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                return self.product(self.read(left), self.read(right))
            case ast.BinOp(left=left, op=ast.Div(), right=right):
                return self.quotient(self.read(left), self.read(right))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self.power(self.read(left), self.read(right))
            case ast.Subscript(slice=ast.Constant(value=int() as k)):
                return 0.0 if self.held is None else self.held[k]
            case ast.Call(func=ast.Name(id="_int"), args=[switch]):
                return self.read(switch)
            case ast.IfExp(test=ast.Call(args=[ast.Subscript(slice=index)])):
                return self.chosen(index, [tree.orelse, tree.body])
            case ast.Call(func=ast.Name(id="_pick"), args=[ast.Subscript(slice=index), *parts]):
                return self.chosen(index, parts)
            case ast.Call(func=ast.Name(id="_pow"), args=[left, right]):
                return self.power(self.read(left), self.read(right))
            case ast.Call(func=ast.Name(id=name), args=args):
                return self.function(name.removeprefix("_"), [self.read(x) for x in args])
        raise _refused(f"`{ast.unparse(tree)[:60]}`")

    def chosen(self, index: ast.expr, parts: list[ast.expr]) -> Part:
        """The part that a switch holds; of all, where it is not known, to see that they serve."""
        if self.held is None:
            return [self.read(part) for part in parts][-1]
        held = self.held[ast.literal_eval(index)]
        return math.nan if math.isnan(held) else self.read(parts[int(held)])

    def sum(self, a: Part, b: Part, sign: float) -> Part:
        """a + sign b."""
        if not isinstance(a, Slotted) and not isinstance(b, Slotted):
            return a + sign * b
        terms = [(c, int(x)) for c, x in ((1.0, a), (sign, b)) if isinstance(x, Slotted)]
        constant = sum(c * x for c, x in ((1.0, a), (sign, b)) if not isinstance(x, Slotted))
        return Slotted(self.program.sum(*terms, constant=self.program.number(constant)))

    def product(self, a: Part, b: Part) -> Part:
        """a b."""
        if isinstance(a, Slotted) and isinstance(b, Slotted):
            return Slotted(self.program.add(Product(int(a), int(b))))
        if isinstance(a, Slotted):
            a, b = b, a
        if isinstance(b, Slotted):
            factor = a if a in (1.0, -1.0) else self.program.number(a)
            return Slotted(self.program.sum((factor, int(b)))) if a else 0.0
        return a * b

    def quotient(self, a: Part, b: Part) -> Part:
        """a / b."""
        if not isinstance(b, Slotted):
            if b == 0.0:
                return Slotted(self.program.add(Quotient(self.slot(a), self.slot(b))))
            return a / b if not isinstance(a, Slotted) else self.product(a, 1.0 / b)
        return Slotted(self.program.add(Quotient(self.slot(a), int(b))))

    def power(self, base: Part, exponent: Part) -> Part:
        """base to an exponent: products where it is a small whole number."""
        if isinstance(exponent, Slotted):
            return self.function("exp", [self.product(exponent, self.function("log", [base]))])
        if not isinstance(base, Slotted):
            try:
                return math.pow(base, exponent)
            except (ValueError, OverflowError):  # a switch that stands at zero
                return math.nan
        if not (exponent.is_integer() and 0.0 <= exponent <= MOST_FACTORS):
            return Slotted(self.program.add(Power(int(base), exponent)))
        result: Part = 1.0
        square: Part = base
        factors = int(exponent)
        while factors:
            if factors % 2:
                result = self.product(result, square)
            factors //= 2
            if factors:
                square = self.product(square, square)
        return result

    def function(self, name: str, x: list[Part]) -> Part:
        """sin' = cos x', exp' = exp x', and y' = x'/density for log and the inverse functions."""
        add = self.program.add
        if not any(isinstance(part, Slotted) for part in x):
            try:
                return float(FUNCTIONS[name](*x))
            except (ValueError, ArithmeticError):  # outside its domain: no state has a series
                return math.nan
        if name == "log" and len(x) == 2:
            return self.quotient(self.function("log", x[:1]), self.function("log", x[1:]))
        if name == "hypot":
            total: Part = 0.0
            for part in x:
                total = self.sum(total, self.product(part, part), 1.0)
            return self.power(total, 0.5)
        slot = self.slot(x[0])
        match name:
            case "sin" | "cos" | "sinh" | "cosh" | "tanh" | "exp":
                return Slotted(add(Function(name, slot)))
            case "tan":
                sine, cosine = (add(Function(kind, slot)) for kind in ("sin", "cos"))
                return Slotted(add(Quotient(sine, cosine)))
            case "sqrt":
                return Slotted(add(Power(slot, 0.5)))
            case "log":
                return Slotted(add(Primitive(name, slot, slot)))
            case "atan":
                density = self.sum(1.0, self.product(x[0], x[0]), 1.0)
                return Slotted(add(Primitive(name, slot, self.slot(density))))
            case "asin" | "acos":
                root = self.power(self.sum(1.0, self.product(x[0], x[0]), -1.0), 0.5)
                sign = 1.0 if name == "asin" else -1.0
                return Slotted(add(Primitive(name, slot, self.slot(self.product(sign, root)))))
        raise _refused(f"function {name}")


def _refused(what: str) -> InputError:
    limit = "the Taylor series expands arithmetic and smooth functions: take --method DOP853"
    return InputError(f"torque: {what} has no series", limit=limit)
