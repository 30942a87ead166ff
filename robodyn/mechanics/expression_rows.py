"""Expressions as rows of the program: smooth functions of its slots.

What has no series (comparisons, abs, min, ...) is refused.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
from robodyn.scene.syntax import FUNCTIONS

MOST_FACTORS = 64  # of a whole power that is written as products


class Slotted(int):
    """A slot, told from a number."""


Part = Slotted | float


@dataclass
class ExpressionRows:
    """Rows of expressions; what is constant stays a number.

    `variable` has the slot of a name, `refused` the error of what has no series.  `held` tells how
    the switches of an expression stand (see `torque_rows.torque_slots`).
    """

    program: Program
    variable: Callable[[str], Slot]
    refused: Callable[[str], Exception]
    held: Sequence[float] | None = None

    def slot(self, part: Part) -> Slot:
        """The slot of a part, constants included."""
        if isinstance(part, Slotted):
            return int(part)
        return self.program.add(Sum(self.program.number(part), ()))

    def read(self, tree: ast.expr) -> Part:
        """What an expression is, after its parts."""
        match tree:
            case ast.Constant(value=int() | float() as value):
                return float(value)
            case ast.Name(id=name):
                return Slotted(self.variable(name))
            case ast.UnaryOp(op=sign, operand=operand):
                part = self.read(operand)
                return part if isinstance(sign, ast.UAdd) else self.product(-1.0, part)
            case ast.BinOp(left=left, op=operation, right=right) if type(operation) in _OPERATIONS:
                return _OPERATIONS[type(operation)](self, self.read(left), self.read(right))
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
        raise self.refused(f"`{ast.unparse(tree)[:60]}`")

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
        raise self.refused(f"function {name}")


_OPERATIONS: dict[type, Callable[[ExpressionRows, Part, Part], Part]] = {
    ast.Add: lambda rows, a, b: rows.sum(a, b, 1.0),
    ast.Sub: lambda rows, a, b: rows.sum(a, b, -1.0),
    ast.Mult: ExpressionRows.product,
    ast.Div: ExpressionRows.quotient,
    ast.Pow: ExpressionRows.power,
}
