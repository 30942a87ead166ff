"""How much rounding may have added to an expression's value: a running analysis of its errors.

Times and states are right to a few spacings of floats of the largest among them; each operation
hands errors on by its derivatives and adds a rounding of its own.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bounded = tuple[Any, Any]  # values, and bounds of their errors

EPS = float(np.finfo(float).eps)
STATE = 8.0 * EPS  # of the largest of the angles, or rates, that a series or an interpolant adds
SLOPES: dict[str, Callable[[Any, Any], Any]] = {  # of functions, by their argument and value
    "sin": lambda x, value: np.abs(np.cos(x)),
    "cos": lambda x, value: np.abs(np.sin(x)),
    "tan": lambda x, value: 1.0 + value**2,
    "asin": lambda x, value: 1.0 / np.sqrt(1.0 - x**2),
    "acos": lambda x, value: 1.0 / np.sqrt(1.0 - x**2),
    "atan": lambda x, value: 1.0 / (1.0 + x**2),
    "sinh": lambda x, value: np.cosh(x),
    "cosh": lambda x, value: np.abs(np.sinh(x)),
    "tanh": lambda x, value: 1.0 - value**2,
    "exp": lambda x, value: value,
    "sqrt": lambda x, value: 0.5 / value,
    "abs": lambda x, value: 1.0,
    "sign": lambda x, value: 0.0,
    "floor": lambda x, value: 0.0,
}
ARRAYS: dict[str, Callable[..., Any]] = {"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan}


def bound_of(tree: ast.expr, n: int) -> Callable[[Array, Array], Array]:
    """The bound (k,) on the rounding of an expression's values at times (k,), states (k, 2n..)."""

    def bound(t: Array, y: Array) -> Array:
        with np.errstate(all="ignore"):
            largest = [float(np.abs(part).max()) for part in (y[:, :n], y[:, n : 2 * n])]

            def known(name: str) -> Bounded:
                if name == "t":
                    return t, EPS * np.abs(t)
                rate = name.startswith("qd")
                column = int(name.lstrip("qd")) + n * rate
                return y[:, column], STATE * largest[rate]

            return np.asarray(_bounded(tree, known)[1] + np.zeros(len(t)))

    return bound


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
        case ast.Add():
            value, error = a + b, da + db
        case ast.Sub():
            value, error = a - b, da + db
        case ast.Mult():
            value, error = a * b, np.abs(a) * db + np.abs(b) * da
        case ast.Div():
            value = np.divide(a, b)
            error = (da + np.abs(value) * db) / np.abs(b)
        case ast.Mod():
            value, error = np.mod(a, b), da + np.abs(np.floor(np.divide(a, b))) * db
        case _:
            return _power(left, right)
    return value, error + EPS * np.abs(value)


def _power(base: Bounded, exponent: Bounded) -> Bounded:
    (a, da), (b, db) = base, exponent
    value = np.power(a, b)
    error = np.abs(b * np.power(a, b - 1.0)) * da
    if np.any(db):
        error = error + np.abs(value * np.log(np.abs(a))) * db
    return value, error + 2.0 * EPS * np.abs(value)


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
            error = (np.abs(b) * dx + np.abs(x) * db) / (x**2 + b**2)
        case "log":
            b, db = others[0] if others else (math.e, 0.0)
            value = np.log(x) / np.log(b)
            error = (dx / np.abs(x) + np.abs(value / b) * db) / np.abs(np.log(b))
        case _:
            value = (ARRAYS.get(name) or getattr(np, name))(x)
            error = SLOPES[name](x, value) * dx
    return value, error + 2.0 * EPS * np.abs(value)
