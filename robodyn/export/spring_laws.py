"""Laws of springs in MJCF, which has polynomials up to the third power, from MuJoCo 3.7 on.

A spring there pulls by k1 x + k2 x^2 + k3 x^3, and its damper by d1 v + d3 v^3; both are zero where
the spring is free and at rest.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Mapping

from robodyn.scene.scene import Law, Signal

Powers = tuple[int, int]  # of x and of v
MOST = 3
LIMIT = "MJCF has polynomials k1 x + k2 x^2 + k3 x^3 + d1 v + d3 v^3 alone, and no tables"


def polynomial(law: Signal | None) -> dict[str, str] | None:
    """The attributes `stiffness` and `damping` of a spring with this law; None where none have it.

    They are numbers, as many as are needed; no law has none.
    """
    if law is None:
        return {}
    if not isinstance(law, Law):
        return None
    terms = _terms(ast.parse(law.code, mode="eval").body)
    if terms is None or any(c and (i, j) not in _SAID for (i, j), c in terms.items()):
        return None
    pulls = [[terms.get((i, 0), 0.0) for i in range(1, MOST + 1)]]
    pulls.append([terms.get((0, j), 0.0) for j in range(1, MOST + 1)])
    return {
        name: " ".join(repr(c + 0.0) for c in part[: max(k + 1 for k, c in enumerate(part) if c)])
        for name, part in zip(("stiffness", "damping"), pulls, strict=True)
        if any(part)
    }


_SAID = {(i, 0) for i in range(1, MOST + 1)} | {(0, 1), (0, 3)}


def _terms(tree: ast.expr) -> Mapping[Powers, float] | None:
    """The coefficients of a polynomial in x and v; None for what is none, or of a high power."""
    match tree:
        case ast.Constant(value=float() as value):
            return {(0, 0): value}
        case ast.Name(id=name):
            return {(1, 0) if name == "x" else (0, 1): 1.0}
        case ast.UnaryOp(op=operation, operand=operand):
            sign = -1.0 if isinstance(operation, ast.USub) else 1.0
            return _product({(0, 0): sign}, _terms(operand))
        case ast.BinOp(left=left, op=(ast.Add() | ast.Sub()) as operation, right=right):
            sign = -1.0 if isinstance(operation, ast.Sub) else 1.0
            a, b = _terms(left), _product({(0, 0): sign}, _terms(right))
            if a is None or b is None:
                return None
            return {key: a.get(key, 0.0) + b.get(key, 0.0) for key in (*a, *b)}
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return _product(_terms(left), _terms(right))
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            by = _terms(right)
            if by is None or by.keys() != {(0, 0)} or not by[0, 0]:
                return None
            return _product(_terms(left), {(0, 0): 1.0 / by[0, 0]})
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=float() as power)):
            if power not in range(MOST + 1):
                return None
            found: Mapping[Powers, float] | None = {(0, 0): 1.0}
            for _ in range(int(power)):
                found = _product(found, _terms(left))
            return found
    return None


def _product(
    a: Mapping[Powers, float] | None, b: Mapping[Powers, float] | None
) -> Mapping[Powers, float] | None:
    if a is None or b is None:
        return None
    found: dict[Powers, float] = defaultdict(float)
    for (i, j), x in a.items():
        for (k, l), y in b.items():
            found[i + k, j + l] += x * y
    return found
