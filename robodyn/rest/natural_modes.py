"""The natural modes of a linear model x' = A x + B u with x = (z, z'), and what A and B tell.

A = [[0, I], [A21, A22]], (2f, 2f).  An eigenvalue s, |s| = w, has the frequency w/(2 pi) and the
damping ratio -Re(s)/w, its eigenvector is (shape, s shape).  Where A22 = 0, s^2 are the eigenvalues
of A21, and nothing is damped by rounding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robodyn.tables.arrays import Array, Complex
from robodyn.tables.short_repr import short_repr

ZERO = 1e-7  # part of the largest eigenvalue below which one is zero: a double zero errs by this
GROWS = 1e-10  # part of the largest eigenvalue above which a real part grows
UNREACHED = 1e-9  # of [A - s I, B], scaled: a singular value below it is zero


@short_repr
class NaturalMode(NamedTuple):
    """One pair of conjugate eigenvalues, by that with Im >= 0, or one real eigenvalue.

    `frequency` |s|/(2 pi), Hz; `damping` -Re(s)/|s|, 1 for what dies away, -1 for what grows
    without a swing, 0 where s = 0; `shape` (f,) how coordinates move, the largest at 1: where some
    lag behind it is complex.
    """

    eigenvalue: complex
    frequency: float
    damping: float
    shape: Complex


def eigenvalues(A21: Array, A22: Array, rate: float = 0.0) -> tuple[Complex, Complex]:
    """All 2f of A, and the shapes (f, 2f) of their eigenvectors; rounding of zeros is taken away.

    It is a small part of the largest, or of a `rate` that what acts would have uncancelled, 1/s.
    """
    f = len(A21)
    if not A22.any():
        squares, V = np.linalg.eig(A21)
        largest = max(float(np.abs(squares).max()), rate**2)
        squares = np.where(np.abs(squares) <= ZERO**2 * largest, 0.0, squares)
        roots = np.sqrt(squares.astype(complex))
        return np.concatenate([roots, 0.0 - roots]), np.concatenate([V, V], axis=1).astype(complex)
    A = np.block([[np.zeros((f, f)), np.eye(f)], [A21, A22]])
    values, vectors = np.linalg.eig(A)
    largest = max(float(np.abs(values).max()), rate)
    values = np.where(np.abs(values) <= ZERO * largest, 0.0, values)
    return values.astype(complex), vectors[:f].astype(complex)


def natural_modes(values: Complex, shapes: Complex, units: Array) -> list[NaturalMode]:
    """The modes of `eigenvalues`, the slowest first; displacements are told in units (f,)."""
    found = []
    for s, shape in zip(values, shapes.T, strict=True):
        if s.imag < 0.0:
            continue
        w = abs(s)
        most = int(np.argmax(np.abs(shape) / units))
        shape = shape / shape[most] + 0.0  # no -0.0
        shape[most] = 1.0
        damping = float(-s.real / w) + 0.0 if w else 0.0
        found.append(NaturalMode(complex(s), float(w) / (2.0 * np.pi), damping, shape))
    return sorted(found, key=lambda mode: (mode.frequency, mode.eigenvalue.real))


def stable_by(values: Complex) -> bool | None:
    """Whether no motion grows; None where one neither grows nor returns: an eigenvalue is zero."""
    if (values.real > GROWS * np.abs(values).max()).any():
        return False
    return None if (values == 0.0).any() else True


def controllable(A: Array, B: Array) -> bool:
    """Whether [A - s I, B] has full rank at each eigenvalue s (Popov, Belevitch and Hautus)."""
    f = len(A) // 2
    rate = float(np.sqrt(np.abs(A[f:, :f]).max())) or 1.0  # rates in units of it
    scale = np.repeat([1.0, rate], f)
    scaled = A * scale / scale[:, None] / rate
    inputs = B / (np.abs(B).max(initial=0.0) or 1.0)
    return all(
        np.linalg.svd(np.hstack([scaled - s * np.eye(2 * f), inputs]), compute_uv=False)[-1]
        > UNREACHED * max(1.0, abs(s))
        for s in np.linalg.eigvals(scaled)
    )
