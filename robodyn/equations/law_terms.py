"""Laws of couplings in equations, with names for each law and its derivatives.

A coupling's law h1 has the derivative h1_2 by q2, whose derivative by q3 is h1_2_3.  Their formulas
are read back from the law's rows (`mechanics/law_rows.py`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations_with_replacement
from typing import Any

from robodyn.elements.program import (
    Function,
    Given,
    Number,
    Power,
    Primitive,
    Product,
    Program,
    Quotient,
    Slot,
    Sum,
)
from robodyn.equations import symbolic
from robodyn.equations.named_laws import Definition, Formula, formula_of, with_symbols
from robodyn.equations.symbolic import ONE, Atom, Role, of
from robodyn.mechanics.expression_rows import Part, Slotted
from robodyn.mechanics.law_rows import LawRows
from robodyn.scene.expressions import names_of
from robodyn.scene.scene import Coupling, Law
from robodyn.scene.syntax import Node

Value = Any
_JOINT = re.compile("q[0-9]+|t")


TIME = -1  # among joints


@dataclass(frozen=True)
class LawTerms:
    """A law in the gap -arm h, with its nonzero first and second derivatives.

    Joints are keys; TIME stands for time among them.
    """

    arm: Value
    value: Value
    slopes: Mapping[int, Value]
    second: Mapping[tuple[int, int], Value]

    def each(self, change: Callable[[Value], Value]) -> LawTerms:
        """Return these terms with `change` applied to each value."""
        slopes = {k: change(x) for k, x in self.slopes.items()}
        second = {pair: change(x) for pair, x in self.second.items()}
        return LawTerms(change(self.arm), change(self.value), slopes, second)

    def bend(self, qd: Any) -> Value:
        """Return the sum of second derivatives times both rates, for rates qd (n)."""
        total: Value = 0.0
        for (k, j), x in self.second.items():
            part = x
            for moved in (k, j):
                part = part if moved == TIME else part * qd[moved]
            total = total + (part if k == j else part * 2)
        return total


def law_terms(
    c: int, coupling: Coupling, arm: symbolic.Sum, units: Callable[[int], str]
) -> tuple[LawTerms, tuple[Definition, ...]]:
    """Return the named terms of coupling c's law, and the definitions of the names.

    `units` gives the unit of a joint, rad or m.
    """
    law = coupling.law
    assert isinstance(law, Law)
    program = Program()

    def variable(name: str) -> Slot:
        return program.add(Given(name))

    rows, joints = LawRows(program, variable), sorted(coupling.others)
    joints += [TIME] if coupling.timed else []

    def slot_name(k: int) -> str:
        return "t" if k == TIME else f"q{k}"

    def shown(k: int) -> str:
        return "t" if k == TIME else f"q{k + 1}"

    value = rows.value(law._replace(node=with_symbols(law.node)))
    definitions: list[Definition] = []
    own, letter = units(coupling.joint), f"h{c + 1}"

    def named(part: Part, by: tuple[int, ...], meaning: str) -> symbolic.Sum:
        """Return a name for a formula; numbers stay as they are."""
        if not isinstance(part, Slotted):
            return ONE.times(Fraction(repr(float(part))))
        name = "_".join([letter, *("t" if k == TIME else str(k + 1) for k in by)])
        formula = _formula(law, program, int(part)) if by else formula_of(law, {})
        unit = _unit(own, ["s" if k == TIME else units(k) for k in by])
        definitions.append(Definition(name, formula, unit, meaning))
        return of(Atom(Role.length, (c, name), name))

    told = f"law of coupling {c + 1}"
    h = named(value, (), told)
    slopes: dict[int, Any] = {}
    second: dict[tuple[int, int], Any] = {}
    names = [slot_name(k) for k in joints]
    first = dict(zip(joints, rows.slopes(value, names), strict=True))
    for k, part in first.items():
        if isinstance(part, Slotted) or part:
            slopes[k] = named(part, (k,), f"derivative of {letter} by {shown(k)}")
    for k, j in combinations_with_replacement(joints, 2):
        (part,) = rows.slopes(first[k], [slot_name(j)])
        if isinstance(part, Slotted) or part:
            by = f"{shown(k)} and {shown(j)}" if k != j else f"{shown(k)} twice"
            second[k, j] = named(part, (k, j), f"derivative of {letter} by {by}")
    return LawTerms(arm, h, slopes, second), tuple(definitions)


def _unit(above: str, below: list[str]) -> str:
    """Return the unit of a quotient."""
    left = below.copy()
    if above in left:
        left.remove(above)
        above = ""
    if not left:
        return above
    squared = len(left) == 2 and left[0] == left[1]
    under = f"{left[0]}²" if squared else left[0] if len(left) == 1 else f"({' '.join(left)})"
    return f"{above or '1'}/{under}"


def _formula(law: Law, program: Program, slot: Slot) -> Formula:
    """Return the contents of a slot as a formula."""
    tree = _tree(program, slot)
    names = formula_of(law, {}).names
    return Formula(tree, names)


def _tree(program: Program, slot: Slot) -> Node:
    """Return the rows of a slot as an expression's tree."""

    def of_slot(x: Slot) -> Node:
        return _tree(program, x)

    match program.rows[slot]:
        case Given(name=name):
            return name
        case Sum(constant=constant, terms=terms):
            total: Node | None = None
            for c, x in terms:
                by, part = _number(program, c), of_slot(x)
                if type(part) is tuple and part[0] == "neg":
                    by, part = -by, part[1]
                if type(part) is tuple and part[0] == "*" and isinstance(part[1], float):
                    by, part = by * part[1], part[2]
                part = part if abs(by) == 1.0 else ("*", abs(by), part)
                if total is None:
                    total = ("neg", part) if by < 0.0 else part
                else:
                    total = ("-" if by < 0.0 else "+", total, part)
            number = _number(program, constant)
            if total is None or not number:
                return number if total is None else total
            return ("+", total, number) if number > 0.0 else ("-", total, -number)
        case Product(x=x, y=y) if x == y:
            return "**", of_slot(x), 2.0
        case Product(x=x, y=y):
            return _signed("*", *sorted((of_slot(x), of_slot(y)), key=_moves))
        case Quotient(x=x, y=y):
            return _signed("/", of_slot(x), of_slot(y))
        case Power(x=x, exponent=exponent):
            return ("sqrt", of_slot(x)) if exponent == 0.5 else ("**", of_slot(x), exponent)
        case Function(name=name, x=x) | Primitive(name=name, x=x):
            return name, of_slot(x)
    raise AssertionError(program.rows[slot])


def _moves(tree: Node) -> bool:
    """Return whether a joint occurs in a tree; constants stand before what moves."""
    return any(_JOINT.fullmatch(name) for name in names_of(tree))


def _signed(operation: str, *parts: Node) -> Node:
    """Return a product or quotient with its sign in front."""
    plain = [x[1] if type(x) is tuple and x[0] == "neg" else x for x in parts]
    odd = sum(x is not y for x, y in zip(parts, plain, strict=True)) % 2
    found = operation, *plain
    return ("neg", found) if odd else found


def _number(program: Program, c: float | Number) -> float:
    return program.numbers[c.place] * c.sign if isinstance(c, Number) else c
