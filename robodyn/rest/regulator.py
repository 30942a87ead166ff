"""The gain that keeps a mechanism at a pose at the least cost (LQR).

    tau = tau0 - K [z - z0; z']      K = U^-1 B^T P      A^T P + P A - P B U^-1 B^T P + X = 0

makes the integral of x^T X x + u^T U u the least, x = (dz, dz') and u = tau - tau0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from robodyn.errors import InputError, RobodynError
from robodyn.rest.linear_model import LinearModel
from robodyn.tables.arrays import Array

ROUNDING = 1e-12  # part of the largest weight that an eigenvalue may be below zero


STANDS = 1e-9  # part of the fastest eigenvalue below which one is zero but for rounding


def lqr(model: LinearModel, weights_x: ArrayLike = 1.0, weights_u: ArrayLike = 1.0) -> Array:
    """K (m, 2f) of a linear model at rest.

    Weights are one value, one a state or an actuated joint, or all of a symmetric matrix, row by
    row; X must be positive semidefinite, U positive definite.  Raises InputError where they are
    not, RobodynError away from rest and where no gain makes the pose stable.
    """
    if not model.B.shape[1]:
        raise RobodynError("no gain", limit="no joint is actuated")
    X = _weights("weights_x", weights_x, len(model.A), definite=False)
    U = _weights("weights_u", weights_u, model.B.shape[1], definite=True)
    if model.modes is None:
        raise RobodynError("no gain", limit=model.remark)
    from scipy.linalg import solve_continuous_are

    try:
        P = solve_continuous_are(model.A, model.B, X, U)
        K = np.asarray(np.linalg.solve(U, model.B.T @ P), float)
        ways = np.linalg.eigvals(model.A - model.B @ K)
        settles = bool((ways.real < -STANDS * np.abs(ways).max()).all())
    except (np.linalg.LinAlgError, ValueError):
        settles = False
    if not settles:
        none = "no gain brings it to rest there"
        if not model.controllable:
            raise RobodynError(none, limit="it is not controllable")
        limit = f"{none}: weigh all that moves by itself"
        raise RobodynError("weights_x", value=_shown(np.ravel(weights_x)), limit=limit)
    return K


def _weights(name: str, given: ArrayLike, size: int, definite: bool) -> Array:
    values = np.asarray(given, float)
    if values.size not in (1, size, size * size):
        limit = f"needs 1, {size} or, for a matrix, {size * size} values"
        limit = limit if size > 1 else "needs 1 value"
        raise InputError(name, value=f"{values.size} values", limit=limit)
    flat = values.ravel()
    weights = (
        flat.reshape(size, size) if flat.size == size * size else np.diag(flat * np.ones(size))
    )
    if not np.isfinite(weights).all():
        raise InputError(name, limit="must be finite")
    largest = float(np.abs(weights).max(initial=0.0))
    if np.abs(weights - weights.T).max(initial=0.0) > ROUNDING * largest:
        raise InputError(name, value=_shown(flat), limit="must be a symmetric matrix")
    least = float(np.linalg.eigvalsh(weights).min(initial=np.inf))
    if least < -ROUNDING * largest or (definite and least <= ROUNDING * largest):
        word = "definite" if definite else "semidefinite"
        limit = f"must be positive {word}; its least eigenvalue is {least:.6g}"
        raise InputError(name, value=_shown(flat), limit=limit)
    return weights


def _shown(values: Array) -> str:
    return ", ".join(f"{x:g}" for x in values)
