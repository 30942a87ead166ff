"""Singular value decompositions that always end.

LAPACK's divide and conquer, which numpy takes, gives up on some matrices near singular ones (of 100
closures in a row, say); its QR iteration does not.
"""

from __future__ import annotations

import numpy as np

from robodyn.tables.arrays import Array


def svd(a: Array, full: bool = False) -> tuple[Array, Array, Array]:
    """U, s, Vt of matrices (..., r, n), which must be finite; with `full` U and Vt are square."""
    try:
        U, s, Vt = np.linalg.svd(a, full_matrices=full)
    except np.linalg.LinAlgError:
        from scipy.linalg import svd as decompose

        parts = [
            decompose(each, full_matrices=full, lapack_driver="gesvd")
            for each in a.reshape(-1, *a.shape[-2:])
        ]
        U, s, Vt = (
            np.array(x).reshape(*a.shape[:-2], *x[0].shape) for x in zip(*parts, strict=True)
        )
    return U, s, Vt


def damped(matrix: Array, right: Array, damping: Array | float, least: float = 0.0) -> Array:
    """x (..., n) of least |matrix x - right|^2 + damping |x|^2: a step of Levenberg and Marquardt.

    Singular values up to `least` count as zero, along which x is none; right is (..., r).
    """
    U, s, Vt = svd(matrix)
    kept = s > least
    parts = np.where(kept, s, 0.0) / np.where(kept, s * s + np.asarray(damping)[..., None], 1.0)
    parts = parts * (np.swapaxes(U, -1, -2) @ right[..., None])[..., 0]
    return np.asarray((np.swapaxes(Vt, -1, -2) @ parts[..., None])[..., 0])
