"""How far an expression is from its value at a point: where rounding is all, or in a box.

Each operation hands on how far its operands may be off by its largest slopes in that reach, and
adds a rounding of its own.  None of the expression's switches (`smooth_parts.py`) may pass zero in
the reach: what jumps stays as it is at the point.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any

import numpy as np

from robodyn.tables.arrays import Array

Bounded = tuple[Any, Any]  # values, and bounds of their errors

EPS = float(np.finfo(float).eps)
STATE = 8.0 * EPS  # of the largest of the angles, or rates, that a series or an interpolant adds
# of functions, by their argument, how far it may be off, and the value
SLOPES: dict[str, Callable[[Any, Any, Any], Any]] = {
    "sin": lambda x, dx, value: np.minimum(np.abs(np.cos(x)) + dx, 1.0),
    "cos": lambda x, dx, value: np.minimum(np.abs(np.sin(x)) + dx, 1.0),
    "tan": lambda x, dx, value: 1.0 + np.maximum(np.tan(x - dx) ** 2, np.tan(x + dx) ** 2),
    "asin": lambda x, dx, value: 1.0 / np.sqrt(_positive(1.0 - (np.abs(x) + dx) ** 2)),
    "acos": lambda x, dx, value: 1.0 / np.sqrt(_positive(1.0 - (np.abs(x) + dx) ** 2)),
    "atan": lambda x, dx, value: 1.0 / (1.0 + _positive(np.abs(x) - dx) ** 2),
    "sinh": lambda x, dx, value: np.cosh(np.abs(x) + dx),
    "cosh": lambda x, dx, value: np.sinh(np.abs(x) + dx),
    "tanh": lambda x, dx, value: 1.0 - np.tanh(_positive(np.abs(x) - dx)) ** 2,
    "exp": lambda x, dx, value: np.exp(x + dx),
    "sqrt": lambda x, dx, value: 1.0 / np.maximum(value + np.sqrt(_positive(x - dx)), np.sqrt(dx)),
    "abs": lambda x, dx, value: 1.0,
    "sign": lambda x, dx, value: 0.0,
    "floor": lambda x, dx, value: 0.0,
}
ARRAYS: dict[str, Callable[..., Any]] = {"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan}


def _positive(x: Any) -> Any:
    return np.maximum(x, 0.0)


def bound_of(tree: ast.expr, n: int) -> Callable[[Array, Array], Array]:
    """The bound (..., k or 1) on the rounding of an expression's values along a step.

    Those are at its times (..., k), of its states (..., k, 2n or more).
    """

    def bound(t: Array, y: Array) -> Array:
        off = np.maximum.reduce(np.abs(y[..., : 2 * n]), axis=-2, keepdims=True)
        for part in (off[..., :n], off[..., n:]) if n > 1 else ():
            part[:] = np.maximum.reduce(part, axis=-1, keepdims=True)
        off *= STATE
        return np.atleast_1d(_bounded(tree, _known(t, t, y, off, n))[1])

    return bound


def around_of(tree: ast.expr, n: int) -> Callable[[Array, Array, Array, Array], Bounded]:
    """An expression's values (k,) in the middle of boxes, and how far they go from there.

    Those are times from begin (k,) to end, and states as far as dy (k, 2n..) from y.
    """

    def around(begin: Array, end: Array, y: Array, dy: Array) -> Bounded:
        return _bounded(tree, _known(begin, end, y, dy, n))

    return around


def _known(begin: Array, end: Array, y: Array, dy: Array, n: int) -> Callable[[str], Bounded]:
    def known(name: str) -> Bounded:
        if name == "t":
            half = 0.5 * (end - begin)
            t = begin + half
            return t, np.abs(half) + EPS * np.abs(t)
        column = int(name.lstrip("qd")) + n * name.startswith("qd")
        return y[..., column], dy[..., column]

    return known


def _bounded(node: ast.expr, known: Callable[[str], Bounded]) -> Bounded:
    match node:
        case ast.Constant(value=value):
            return float(value), 0.0  # type: ignore[arg-type]
        case ast.Name(id=name):
            return known(name)
        case ast.UnaryOp(op=op, operand=operand):
            value, error = _bounded(operand, known)
            return (-value if isinstance(op, ast.USub) else value), error
        case ast.BinOp(left=left, op=op, right=right):
            return _operated(op, _bounded(left, known), _bounded(right, known))
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            a, b = _bounded(left, known)[0], _bounded(right, known)[0]
            above = isinstance(op, ast.Gt | ast.GtE)
            return (a > b if above else a < b) * 1.0, 0.0
        case ast.IfExp(test=test, body=body, orelse=orelse):
            chosen = np.asarray(_bounded(test, known)[0]) != 0.0
            (a, da), (b, db) = _bounded(body, known), _bounded(orelse, known)
            return np.where(chosen, a, b), np.where(chosen, da, db)
        case ast.Call(func=ast.Name(id=name), args=args):
            return _called(name[1:], [_bounded(x, known) for x in args])
    raise TypeError(ast.dump(node))


def _operated(op: ast.operator, left: Bounded, right: Bounded) -> Bounded:
    (a, da), (b, db) = left, right
    match op:
        case ast.Add() | ast.Sub():
            value = a + b if isinstance(op, ast.Add) else a - b
            # of a plain number there is none: a sum less, at many small calls
            error = da if isinstance(db, float) and db == 0.0 else da + db
        case ast.Mult():
            value, error = a * b, abs(a) * db + abs(b) * da + da * db
        case ast.Div():
            value = np.divide(a, b)
            error = np.divide(da + abs(value) * db, _positive(abs(b) - db))
        case ast.Mod():
            value, error = np.mod(a, b), da + np.abs(np.floor(np.divide(a, b))) * db
        case _:
            return _power(left, right)
    return value, error + EPS * abs(value)


def _power(base: Bounded, exponent: Bounded) -> Bounded:
    (a, da), (b, db) = base, exponent
    value = np.power(a, b)
    ends = _positive(abs(a) - da), abs(a) + da
    varies = bool(np.any(db))

    def largest(p: Any) -> Any:
        """Of the powers of a in its reach."""
        powers = [np.power(x, y) for x in ends for y in ((p - db, p + db) if varies else (p,))]
        return np.maximum.reduce(np.broadcast_arrays(*powers))

    error = (abs(b) + db) * largest(b - 1.0) * da
    if varies:
        steepest = np.maximum(*(np.abs(np.log(x)) for x in ends))
        error = error + largest(b) * steepest * db
    return value, error + 2.0 * EPS * abs(value)


def _called(name: str, args: list[Bounded]) -> Bounded:
    (x, dx), *others = args
    match name:
        case "pow":
            return _power(args[0], args[1])
        case "min" | "max":
            reduce = np.minimum.reduce if name == "min" else np.maximum.reduce
            values = np.broadcast_arrays(*(a for a, _ in args))
            errors = np.broadcast_arrays(*(da for _, da in args))
            return reduce(values), np.maximum.reduce(errors)
        case "hypot":
            value = np.sqrt(sum(a**2 for a, _ in args))
            error = sum(da for _, da in args)
        case "atan2":
            b, db = others[0]
            value = np.arctan2(x, b)
            nearest = _positive(np.abs(x) - dx) ** 2 + _positive(np.abs(b) - db) ** 2
            error = ((np.abs(b) + db) * dx + (np.abs(x) + dx) * db) / nearest
        case "log":
            value, error = np.log(x), np.divide(dx, _positive(np.abs(x) - dx))
            if others:
                base = _called("log", others)
                return _operated(ast.Div(), (value, error + 2.0 * EPS * np.abs(value)), base)
        case _:
            value = (ARRAYS.get(name) or getattr(np, name))(x)
            error = SLOPES[name](x, dx, value) * dx
    return value, error + 2.0 * EPS * np.abs(value)
