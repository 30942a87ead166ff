"""Least squares from many starts at once: Levenberg and Marquardt's method, a start in each lane.

Unknowns u are within [0, 1].  A step solves (J^T J + mu D) s = -J^T r over the unknowns that are
free, D the largest squares of J's columns so far; those at a bound that the slope pushes outward
stay there.  mu follows the ratio of what a step gains to what it promised (H. B. Nielsen, IMM,
DTU, 1999).  A step to where residuals are not finite is refused like one that gains nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robodyn.tables.arrays import Array

Places = NDArray[np.int64]
# residuals (m, R) and their derivatives (m, R, k) at u (m, k) of these lanes (m,)
Evaluate = Callable[[Array, Places], tuple[Array, Array]]

FIRST = 1e-3  # mu
LAST = 1e20
SMALL = 1e-10  # a step that no unknown moves by more: what is left is for one start alone
GAIN = 1e-13  # of the sum of squares, likewise


def lane_least_squares(
    evaluate: Evaluate, start: Array, steps: int, tell: Callable[[float], object]
) -> tuple[Array, Array]:
    """u (S, k) where the sum of squares is least near each start, and half that sum (S,)."""
    u, (S, k) = start.copy(), start.shape
    lanes = np.arange(S)
    r, J = evaluate(u, lanes)
    cost = _cost(r)
    H, g = _normal(r, J)
    mu, factor = np.full(S, FIRST), np.full(S, 2.0)
    scale = np.zeros((S, k))
    lanes = np.flatnonzero(np.isfinite(cost))
    for done in range(steps):
        if not lanes.size:
            break
        tell(done / steps)
        scale[lanes] = np.maximum(scale[lanes], np.einsum("nii->ni", H[lanes]))
        step = _step(H[lanes], g[lanes], u[lanes], scale[lanes], mu[lanes])
        there = np.clip(u[lanes] + step, 0.0, 1.0)
        step = there - u[lanes]
        r, J = evaluate(there, lanes)
        new = _cost(r)
        promised = -np.einsum("ni,ni->n", g[lanes] + 0.5 * _times(H[lanes], step), step)
        gained = cost[lanes] - new
        good = np.isfinite(new) & (gained > 0.0)
        size = np.abs(step).max(axis=-1)
        over = (size <= SMALL) | (promised <= GAIN * cost[lanes]) | (cost[lanes] == 0.0)
        ratio = np.where(good, gained / np.where(promised > 0.0, promised, 1.0), 0.0)
        shrink = np.maximum(1.0 / 3.0, 1.0 - (2.0 * np.minimum(ratio, 1.0) - 1.0) ** 3)
        mu[lanes] = np.where(good, mu[lanes] * shrink, mu[lanes] * factor[lanes])
        factor[lanes] = np.where(good, 2.0, np.minimum(2.0 * factor[lanes], 1e6))
        moved = lanes[good]
        u[moved], cost[moved] = there[good], new[good]
        H[moved], g[moved] = _normal(r[good], J[good])
        lanes = lanes[~over & (mu[lanes] < LAST)]
    return u, cost


def _cost(r: Array) -> Array:
    with np.errstate(all="ignore"):
        cost = 0.5 * np.einsum("nr,nr->n", r, r)
    return np.where(np.isfinite(cost), cost, np.inf)


def _normal(r: Array, J: Array) -> tuple[Array, Array]:
    """J^T J and J^T r."""
    with np.errstate(all="ignore"):
        return np.swapaxes(J, 1, 2) @ J, np.einsum("nrk,nr->nk", J, r)


def _times(H: Array, s: Array) -> Array:
    return np.asarray((H @ s[..., None])[..., 0])


def _step(H: Array, g: Array, u: Array, scale: Array, mu: Array) -> Array:
    held = ((u <= 0.0) & (g > 0.0)) | ((u >= 1.0) & (g < 0.0))
    least = 1e-16 * scale.max(axis=-1, keepdims=True) + 1e-300
    D = np.where(scale > least, scale, 1.0 * least)
    free = ~held
    A = H * (free[:, :, None] & free[:, None, :])
    k = np.arange(u.shape[-1])
    A[:, k, k] = np.where(free, A[:, k, k] + mu[:, None] * D, 1.0)
    d = 1.0 / np.sqrt(A[:, k, k])  # scaled: what is added decides how regular it is
    A = A * d[:, :, None] * d[:, None, :]
    A[:, k, k] += 1e-15
    right = np.where(free, -g, 0.0) * d
    return np.asarray(np.linalg.solve(A, right[..., None])[..., 0] * d)
