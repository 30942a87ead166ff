"""Units in expressions, `q1 > 90 deg` or `2 N m*sin(3 rad/s*t)`: the table and grammar of values.

A unit stands behind a number, pi or a parenthesis.  A number without a unit may be in any; where an
expression has units, they must fit one another, and those of t, q and qd.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Container
from contextlib import suppress
from typing import Any, NamedTuple

from robodyn.scene.quantities import dimension_of
from robodyn.scene.syntax import FUNCTIONS, MARK, parsed, unit_of
from robodyn.scene.unit_arithmetic import ALIKE, ANGULAR, Value, power, product, unit_value
from robodyn.scene.units import PLAIN, Dimension, fits, shown_dimension, times


class Marked(NamedTuple):
    """Expressions whose numbers with units are names; the place in the text of each letter."""

    nodes: list[ast.expr]
    quantities: dict[str, Value]
    places: list[int]


def marked(text: str, variable: Callable[[str], bool]) -> Marked:
    """The expressions of a text, their numbers with units as names, by what is a variable.

    Raises SyntaxError where it has none, OverflowError for numbers too large.
    """
    tree = parsed(text, variable, FUNCTIONS)
    marking = _Marking(tree.line)
    return Marked([marking.of(node) for node in tree.nodes], marking.quantities, tree.places)


class _Marking:
    """Gives each unit to the number before it: in 2 x*3 mm/s to the 3, in x/3 mm to none."""

    def __init__(self, line: str) -> None:
        self.line = line
        self.quantities: dict[str, Value] = {}
        self.bare: set[str] = set()  # which of them are units without a number

    def of(self, node: ast.expr) -> ast.expr:
        """The expression, after its parts."""
        if unit := unit_of(node):
            return self._named(unit_value(unit), node, bare=True)
        for name, value in ast.iter_fields(node):
            if isinstance(value, list):
                setattr(node, name, [self.of(x) if isinstance(x, ast.expr) else x for x in value])
            elif isinstance(value, ast.expr):
                setattr(node, name, self.of(value))
        if not isinstance(node, ast.BinOp):
            return node
        left, right = node.left, node.right
        if isinstance(node.op, ast.Pow) and self._is_bare(left):
            with suppress(ValueError):
                if type(k := ast.literal_eval(right)) is int:
                    return self._named(power(self._value(left), Value(float(k))), node, bare=True)
        joins = isinstance(node.op, ast.MatMult)
        if self._is_bare(right) and isinstance(node.op, ast.MatMult | ast.Mult | ast.Div):
            sign = -1 if isinstance(node.op, ast.Div) else 1
            apart = ")" in self.line[left.end_col_offset : right.col_offset]
            number = joins or isinstance(left, ast.Constant)
            found = None if apart else self._joined(left, self._value(right), sign, number)
            if found is not None:
                part: Any = found
                while part.end_col_offset != node.end_col_offset:  # its last factor is longer
                    part.end_col_offset = node.end_col_offset
                    part = getattr(part, "operand", None) or getattr(part, "right", part)
                return found
        if joins:
            node.op = ast.Mult()
        return node

    def _joined(self, left: ast.expr, unit: Value, sign: int, number: bool) -> ast.expr | None:
        """`left` with a unit at its last factor, if this has one already, or is a `number`."""
        match left:
            case ast.Name(id=name) if name in self.quantities:
                return self._named(product(self.quantities[name], unit, sign), left)
            case ast.Constant(value=int() | float() as value) if number:
                return self._named(product(Value(float(value)), unit, sign), left)
            case ast.UnaryOp(operand=last) | ast.BinOp(op=ast.Mult() | ast.Mod(), right=last):
                inside = last.end_col_offset != left.end_col_offset  # of parentheses
                if not inside and (found := self._joined(last, unit, sign, number)):
                    name = "operand" if isinstance(left, ast.UnaryOp) else "right"
                    setattr(left, name, found)
                    return left
        return None

    def _named(self, value: Value, node: ast.expr, bare: bool = False) -> ast.expr:
        name = f"{MARK}{len(self.quantities)}"
        self.quantities[name] = value
        if bare:
            self.bare.add(name)
        return ast.copy_location(ast.Name(name), node)

    def _is_bare(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Name) and node.id in self.bare

    def _value(self, node: ast.expr) -> Value:
        return self.quantities[node.id]  # type: ignore[attr-defined]


def _bare(of: Dimension) -> Dimension:
    """Without radians, which are 1."""
    return {base: power for base, power in of.items() if base != "rad"}


def _told(of: Dimension) -> str:
    return shown_dimension(_bare(of) or of) if of else "a plain number"


class Measure(NamedTuple):
    """What an expression is in, and whether a unit says so (else it may be in any)."""

    of: Dimension
    sure: bool = False


NUMBER_ALONE = Measure(PLAIN)


def state_dimension(slides: Container[int]) -> Callable[[str], Dimension | None]:
    """What t, q0.. and qd0.. are in."""

    def of(name: str) -> Dimension | None:
        kind = name.rstrip("0123456789")
        length = kind != name and int(name[len(kind) :]) in slides
        units = {"t": "s", "q": "m" if length else "rad", "qd": "m/s" if length else "rad/s"}
        return dimension_of(units[kind]) if kind in units else None

    return of


class Measuring(NamedTuple):
    """Finds what expressions are in: of their quantities, and of their names."""

    quantities: dict[str, Value]
    named: Callable[[str], Dimension | None]

    def of(self, node: ast.expr) -> Measure | None:
        """What an expression is in, None where numbers leave that open.

        Raises ValueError, with the expression that has no sense, where units do not fit.
        """
        match node:
            case ast.Name(id=name) if name in self.quantities:
                return Measure(self.quantities[name].of, True)
            case ast.Name(id=name):
                known = self.named(name)
                return None if known is None else Measure(known)
            case ast.UnaryOp(operand=operand):
                return self.of(operand)
            case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mod(), right=right):
                return _same(node, "a sum", self.of(left), self.of(right))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return _power(self.of(left), right)
            case ast.BinOp(left=left, op=op, right=right):
                return _product(self.of(left), self.of(right), isinstance(op, ast.Div))
            case ast.Compare(left=left, comparators=[right]):
                _same(node, "a comparison", self.of(left), self.of(right))
            case ast.IfExp(test=test, body=body, orelse=orelse):
                self.of(test)
                return _same(node, "a choice", self.of(body), self.of(orelse))
            case ast.Call(func=ast.Name(id=name), args=args):
                return _called(node, name, [self.of(x) for x in args])
        return NUMBER_ALONE


def _power(base: Measure | None, exponent: ast.expr) -> Measure | None:
    if base is None or not base.of or not isinstance(exponent, ast.Constant):
        return NUMBER_ALONE if base is not None and not base.of else None
    return Measure(times(PLAIN, base.of, float(exponent.value)), base.sure)  # type: ignore[arg-type]


def _product(a: Measure | None, b: Measure | None, divided: bool) -> Measure | None:
    if a is None or b is None:
        return None
    if NUMBER_ALONE in (a, b) and not (a.sure or b.sure):
        return a if a == b else None
    return Measure(times(a.of, b.of, -1.0 if divided else 1.0), a.sure or b.sure)


def _called(node: ast.expr, name: str, given: list[Measure | None]) -> Measure | None:
    if name in ALIKE or name == "atan2":
        both = given[0]
        for other in given[1:]:
            both = _same(node, name, both, other)
        return NUMBER_ALONE if name == "atan2" else both
    (first, *_) = given
    if name == "sqrt" and first is not None:
        return Measure(times(PLAIN, first.of, 0.5), first.sure)
    odd = first is not None and (_bare(first.of) or (first.of and name not in ANGULAR))
    if first is not None and first.sure and odd and name != "sign":
        raise ValueError(f"{name} of {shown_dimension(first.of)}", node)
    return NUMBER_ALONE


def _same(node: ast.expr, what: str, a: Measure | None, b: Measure | None) -> Measure | None:
    """What two parts are both in; ValueError where they cannot be."""
    if a is None or b is None or not (a.sure or b.sure):
        return a if a == b else next((x for x in (a, b) if x is not None and x.sure), None)
    sure, other = (a, b) if a.sure else (b, a)
    fit = other.of and (sure.of or not other.sure) and fits(sure.of, other.of)
    alike = fit or _bare(a.of) == _bare(b.of)
    if a.of and b.of and not _bare({**a.of, **b.of}) and a.of != b.of and other.sure:
        alike = False  # an angle and its square
    if not alike:
        raise ValueError(f"{what} of {_told(a.of)} and {_told(b.of)}", node)
    return sure


def misfit(found: Measure | None, unit: str) -> str:
    """Why an expression cannot stand in a place of this unit; nothing where it can."""
    place = dimension_of(unit)
    if found is None or not found.sure or fits(found.of, place) or _bare(found.of) == _bare(place):
        return ""
    return f"must be in {unit}, not in {_told(found.of)}"
