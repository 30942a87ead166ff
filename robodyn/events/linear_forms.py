"""Functions of events that are linear in the state and in time, as machine code takes them."""

from __future__ import annotations

import ast

import numpy as np

from robodyn.dynamics.placed import relative_matrix
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array


def linear_form(mechanism: Mechanism, tree: ast.expr) -> Array | None:
    """The coefficients (2 + 4n) of 1, t, q, qd, and once more of q and qd by absolute rates.

    None where an expression is not linear.
    """
    n, relative = mechanism.n, relative_matrix(mechanism)
    with np.errstate(all="ignore"):
        found = _form(tree, n)
    if found is None or not np.isfinite(found).all():
        return None
    absolute = found[2:].reshape(2, n) @ relative
    return np.concatenate([found, absolute.ravel()])


def _form(node: ast.expr, n: int) -> Array | None:
    form = np.zeros(2 + 2 * n)
    match node:
        case ast.Constant(value=int() | float() as value):
            form[0] = value
        case ast.Name(id="t"):
            form[1] = 1.0
        case ast.Name(id=name) if name.lstrip("qd").isdecimal():
            form[2 + int(name.lstrip("qd")) + n * name.startswith("qd")] = 1.0
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            inner = _form(operand, n)
            return None if inner is None else -inner
        case ast.BinOp(left=left, op=op, right=right):
            a, b = _form(left, n), _form(right, n)
            return None if a is None or b is None else _operated(op, a, b)
        case _:
            return None
    return form


def _operated(op: ast.operator, a: Array, b: Array) -> Array | None:
    match op:
        case ast.Add():
            return a + b
        case ast.Sub():
            return a - b
        case ast.Mult() if not a[1:].any():
            return np.asarray(a[0] * b)
        case ast.Mult() | ast.Div() if not b[1:].any():
            return np.asarray(a * b[0] if isinstance(op, ast.Mult) else a / b[0])
    return None
