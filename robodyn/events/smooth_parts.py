"""Where an expression is smooth: between the zeros of its switches.

`abs(x)` bends where x passes zero, `floor(x)` jumps where sin(pi x) does, `a if b > c else d` may
jump where b - c does, `sqrt(x)` ends there.  Between zeros of all of these an expression is as
smooth as the motion is.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from itertools import combinations


def switches(tree: ast.expr) -> list[ast.expr]:
    """Functions between whose zeros the expression is smooth, each once, what they hold first."""
    found: dict[str, ast.expr] = {}
    for switch in _all(tree):
        found.setdefault(ast.unparse(ast.fix_missing_locations(switch)), switch)
    return list(found.values())


def has_one_sign(node: ast.expr) -> bool:
    """Whether an expression says that it is nowhere below zero: abs(x), sqrt(x), their powers."""
    match node:
        case ast.Call(func=ast.Name(id="_abs" | "_sqrt" | "_hypot")):
            return True
        case ast.BinOp(left=left, op=ast.Sub(), right=ast.Constant(value=0)):
            return has_one_sign(left)
        case (
            ast.BinOp(left=left, op=ast.Pow()) | ast.Call(func=ast.Name(id="_pow"), args=[left, _])
        ):
            return has_one_sign(left)
    return False


def _all(node: ast.expr) -> Iterator[ast.expr]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            yield from _all(child)
    for switch in _own(node):
        if any(isinstance(x, ast.Name) and not x.id.startswith("_") for x in ast.walk(switch)):
            yield switch


def _own(node: ast.expr) -> list[ast.expr]:
    """The switches of a node, less those of its parts."""
    match node:
        case ast.Compare(left=left, comparators=[right]):
            return [_less(left, right)]
        case ast.IfExp(test=test) if not isinstance(test, ast.Compare):
            return [test]
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return [right]
        case ast.BinOp(left=left, op=ast.Mod(), right=right):
            return [right, _whole(ast.BinOp(left, ast.Div(), right))]
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            try:
                positive = float(ast.literal_eval(right)) >= 0.0
            except ValueError:
                positive = False
            return [] if positive else [left]
        case ast.Call(func=ast.Name(id=name), args=args):
            return _of_call(name, args)
    return []


def _of_call(name: str, args: list[ast.expr]) -> list[ast.expr]:
    match name:
        case "_abs" | "_sign" | "_sqrt" | "_atan2" | "_pow":
            return args[:1]
        case "_log":
            return [*args, *(_less(base, ast.Constant(1.0)) for base in args[1:])]
        case "_hypot" if len(args) == 1:
            return args
        case "_floor":
            return [_whole(args[0])]
        case "_tan":
            return [ast.Call(ast.Name("_cos", ast.Load()), args, [])]
        case "_asin" | "_acos":
            return [_less(args[0], ast.Constant(x)) for x in (1.0, -1.0)]
        case "_min" | "_max":
            return [_less(a, b) for a, b in combinations(args, 2)]
    return []


def _less(left: ast.expr, right: ast.expr) -> ast.expr:
    return ast.BinOp(left, ast.Sub(), right)


def _whole(x: ast.expr) -> ast.expr:
    """What passes zero where x is a whole number."""
    turned = ast.BinOp(ast.Constant(math.pi), ast.Mult(), x)
    return ast.Call(ast.Name("_sin", ast.Load()), [turned], [])
