"""Expressions as rows of the program: smooth functions of its slots.

Functions without a series (comparisons, abs, min, ...) are refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

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
from robodyn.mechanics.kinks import switch_number
from robodyn.scene.expressions import changed, code_of, fold
from robodyn.scene.syntax import FUNCTIONS, Node

MOST_FACTORS = 64  # of a whole power that is written as products


class Slotted(int):
    """A slot, as distinct from a number."""


Part = Slotted | float  # a number may be a formula of numbers of the scene


@dataclass
class ExpressionRows:
    """Rows of expressions; constant parts stay numbers.

    `variable` returns the slot of a name, `refused` the error for a function without a series.
    `held` has the values of switches (see `torque_rows.torque_slots`).
    """

    program: Program
    variable: Callable[[str], Slot]
    refused: Callable[[str], Exception]
    held: Sequence[float] | None = None

    def slot(self, part: Part) -> Slot:
        """Return the slot of a part; a constant gets one."""
        if isinstance(part, Slotted):
            return int(part)
        return self.program.add(Sum(self.program.number(part), ()))

    def read(self, tree: Node) -> Part:
        """Return the part of an expression."""
        return fold(self.chosen(tree), self.leaf, self.applied)

    def chosen(self, tree: Node) -> Node:
        """Return the tree with the branches that its switches select, or all of it."""
        held = self.held
        if held is None:
            return tree

        def choose(node: tuple[Any, ...]) -> Node:
            k = _held(node[1]) if node[0] in ("if", "min_of", "max_of") else None
            if k is None:
                return node
            parts = (node[3], node[2]) if node[0] == "if" else node[2:]
            return math.nan if math.isnan(held[k]) else parts[int(held[k])]

        return changed(tree, choose)

    def leaf(self, leaf: float | str) -> Part:
        """Return the part of a number or name."""
        if not isinstance(leaf, str):
            return leaf
        k = switch_number(leaf)
        if k is not None:
            return 0.0 if self.held is None else self.held[k]
        return Slotted(self.variable(leaf))

    def applied(self, node: tuple[Any, ...], x: list[Part]) -> Part:
        """Return the part of an operation on parts."""
        match node[0]:
            case "+":
                return self.sum(x[0], x[1], 1.0)
            case "-":
                return self.sum(x[0], x[1], -1.0)
            case "*" | "abs_of":
                return self.product(*x)
            case "/":
                return self.quotient(*x)
            case "**" | "pow":
                return self.power(*x)
            case "neg":
                return self.product(-1.0, *x)
            case "int":
                return x[0]
            case "if" | "min_of" | "max_of" if _held(node[1]) is not None:
                return x[1] if node[0] == "if" else x[-1]  # all serve
            case "if" | "%" | "<" | "<=" | ">" | ">=":
                raise self.refused(f"`{code_of(node)[:60]}`")
        return self.function(node[0], x)

    def sum(self, a: Part, b: Part, sign: float) -> Part:
        """Return a + sign b."""
        if not isinstance(a, Slotted) and not isinstance(b, Slotted):
            return a + sign * b
        terms = [(c, int(x)) for c, x in ((1.0, a), (sign, b)) if isinstance(x, Slotted)]
        constant = sum(c * x for c, x in ((1.0, a), (sign, b)) if not isinstance(x, Slotted))
        return Slotted(self.program.sum(*terms, constant=self.program.number(constant)))

    def product(self, a: Part, b: Part) -> Part:
        """Return a b."""
        if isinstance(a, Slotted) and isinstance(b, Slotted):
            return Slotted(self.program.add(Product(int(a), int(b))))
        if isinstance(a, Slotted):
            a, b = b, a
        if isinstance(b, Slotted):
            factor = a if a in (1.0, -1.0) else self.program.number(a)
            return Slotted(self.program.sum((factor, int(b)))) if a else 0.0
        return a * b

    def quotient(self, a: Part, b: Part) -> Part:
        """Return a / b."""
        if not isinstance(b, Slotted):
            if b == 0.0:
                return Slotted(self.program.add(Quotient(self.slot(a), self.slot(b))))
            return a / b if not isinstance(a, Slotted) else self.product(a, 1.0 / b)
        return Slotted(self.program.add(Quotient(self.slot(a), int(b))))

    def power(self, base: Part, exponent: Part) -> Part:
        """Return base to an exponent, by products for small whole exponents."""
        if not isinstance(exponent, Slotted | float):
            exponent = Slotted(self.slot(exponent))
        if isinstance(exponent, Slotted):
            return self.function("exp", [self.product(exponent, self.function("log", [base]))])
        if not isinstance(base, Slotted | float):
            base = Slotted(self.slot(base))
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
        """Return a function of x.

        Rows use sin' = cos x', exp' = exp x', and y' = x'/density for log and inverse functions.
        """
        add = self.program.add
        if all(isinstance(part, float) for part in x):
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


def _held(test: Node) -> int | None:
    """Return the number of the switch that a condition is, or None."""
    name = test[1] if type(test) is tuple else test
    return switch_number(name) if isinstance(name, str) else None
