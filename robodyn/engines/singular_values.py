"""Singular value decompositions that always end.

LAPACK's divide and conquer, which numpy takes, gives up on some matrices near singular ones (of 100
closures in a row, say); its QR iteration does not.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from robodyn.tables.arrays import Array

WELL = 1e7  # condition number below which a matrix may be inverted


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


def least_solution(matrices: Array, right: Array, cut: float) -> Array:
    """x (k, n) of least norm that makes |matrices x - right| least, of (k, r, n) and (k, r).

    Singular values up to the part `cut` of the largest count as zero.  Square matrices that lose
    less than half of the digits are inverted instead, which takes a tenth of the time.
    """
    x, left = np.zeros((len(right), matrices.shape[-1])), np.ones(len(right), bool)
    if matrices.shape[-1] == matrices.shape[-2]:
        with suppress(np.linalg.LinAlgError):
            inverses = np.linalg.inv(matrices)
            x = (inverses @ right[..., None])[..., 0]
            squares = [np.square(each).sum(axis=(-1, -2)) for each in (matrices, inverses)]
            left = ~(squares[0] * squares[1] <= WELL * WELL)
    if left.any():
        U, s, Vt = svd(matrices[left])
        kept = s > cut * s[..., :1]
        along = np.divide(1.0, s, out=np.zeros_like(s), where=kept)
        along = along * np.einsum("...ij,...i->...j", U, right[left])
        x[left] = np.einsum("...ji,...j->...i", Vt, along)
    return np.asarray(x)


def damped(matrix: Array, right: Array, damping: Array | float, least: float = 0.0) -> Array:
    """x (..., n) of least |matrix x - right|^2 + damping |x|^2: a step of Levenberg and Marquardt.

    Singular values up to `least` count as zero, along which x is none; right is (..., r).
    """
    U, s, Vt = svd(matrix)
    kept = s > least
    parts = np.where(kept, s, 0.0) / np.where(kept, s * s + np.asarray(damping)[..., None], 1.0)
    parts = parts * (np.swapaxes(U, -1, -2) @ right[..., None])[..., 0]
    return np.asarray((np.swapaxes(Vt, -1, -2) @ parts[..., None])[..., 0])
