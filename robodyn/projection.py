"""The nearest state that keeps the closures: Newton steps of least norm.

    q - Psi^T (Psi Psi^T)^-1 gap(q)    and    qd - Psi^T (Psi Psi^T)^-1 Psi qd

Written out as straight-line floats for small mechanisms, and with singular values where Psi is
near singular or its rows depend on one another; `sparse.py` has that of large ones.  Each tells
how regular Psi is there, about d^2 at a distance d from a configuration where it loses rank.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from robodyn import closed_form, straightline
from robodyn.assembly import close_positions, loop_size
from robodyn.change_points import Closing, across, beside
from robodyn.formulas import projection_formula
from robodyn.mechanism import Mechanism

Array = NDArray[np.float64]

SINGULAR = 1e-6  # relative pivot below which the written-out solve is not trusted
CUT = 1e-10  # singular values of Psi below this part of the largest are left alone
CLOSED = 1.5e-16  # a gap below this part of the loop's size is rounding
PASSES = 4


def dense_closing(mechanism: Mechanism) -> Closing:
    """By singular values; directions that the closures hardly hold are left alone."""
    n, size = mechanism.n, loop_size(mechanism)
    rank = regular_rank(mechanism)

    def nearest(y: Array) -> tuple[Array, float]:
        closed = y.copy()
        q, qd = closed[:n], closed[n : 2 * n]
        for _ in range(PASSES):
            gap = closed_form.closure_gap(mechanism, q)
            if np.abs(gap).max() <= CLOSED * size:
                break
            Psi = closed_form.closure_jacobian(mechanism, q)
            q -= np.linalg.pinv(Psi, rcond=CUT) @ gap
        Psi = closed_form.closure_jacobian(mechanism, q)
        U, s, Vt = np.linalg.svd(Psi, full_matrices=False)
        held = s > CUT * s[0]
        qd -= Vt[held].T @ ((U[:, held].T @ (Psi @ qd)) / s[held])
        return closed, float((s[rank - 1] / s[0]) ** 2)

    return nearest


def straight_closing(mechanism: Mechanism) -> Closing:
    """By generated straight-line floats, handed to `dense_closing` where a pivot is too small."""
    n, r = mechanism.n, len(mechanism.rows)
    newton_step = _newton_step(mechanism)
    dense = dense_closing(mechanism)
    rounding = CLOSED * loop_size(mechanism)

    def nearest(y: Array) -> tuple[Array, float]:
        values: list[float] = y.tolist()
        q, qd = values[:n], values[n : 2 * n]
        for _ in range(PASSES):
            try:
                out = newton_step(*q, *qd)
            except ZeroDivisionError:
                return dense(y)
            gap, pivots = out[2 * n : 2 * n + r], out[2 * n + r :]
            if not all(pivot > SINGULAR for pivot in pivots):  # nan is no pivot
                return dense(y)
            if max(gap) <= rounding and min(gap) >= -rounding:
                break  # what is closed to rounding stays: moving it would add noise
            q = list(out[:n])
        qd = list(out[n : 2 * n])
        return np.array([*q, *qd, *values[2 * n :]]), min(pivots)

    return nearest


def projection(mechanism: Mechanism, closing: Closing) -> Callable[[Array], Array]:
    """The state itself; next to a change point that of the branch which leads across."""

    def project(y: Array) -> Array:
        closed, quality = closing(y)
        around = beside(mechanism, closing, y, quality)
        return closed if around is None else across(around)

    return project


@lru_cache(maxsize=64)
def regular_rank(mechanism: Mechanism) -> int:
    """The rank of Psi at closed configurations, but for singular ones."""
    rows, size = len(mechanism.rows), loop_size(mechanism)
    drawn = np.random.default_rng(0).uniform(-np.pi, np.pi, (16, mechanism.n))
    q = close_positions(mechanism, drawn)
    closes = np.abs(closed_form.closure_gap(mechanism, q)).max(axis=-1) <= 1e-9 * size
    if not closes.any():
        return min(rows, mechanism.n)
    s = np.linalg.svd(closed_form.closure_jacobian(mechanism, q[closes]), compute_uv=False)
    return max(1, int((s > 1e-7 * size).sum(axis=-1).max()))


@lru_cache(maxsize=64)
def _newton_step(mechanism: Mechanism) -> straightline.FloatFunction:
    return straightline.compile_floats(projection_formula(mechanism), "newton_step")
