"""Numbers f that depend on their own effect: f = part |N + f B|.

Friction by the forces in pins and slides is such.  With planar N (c) and B (c, c), where B[j][i] is
what f_j adds to the N of f_i, rounds from f = part |N| on settle if friction is small.  Where they
are slow Newton's method goes on; what it finds counts if rounds beside it come to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.arithmetic import Planar, Value
from robodyn.tables.arrays import Array, Complex

SETTLED = 1e-13  # part of the largest f that a round changes in the end
FEW_ROUNDS = 40  # after which Newton's method takes over
MOST_STEPS = 60  # of it


class Rounds(NamedTuple):
    """`part` (c), N (c) and B (c, c) as formulas; the formula they stand in has f0, f1, ..."""

    part: Sequence[Value]
    N: Sequence[Planar]
    B: Sequence[Sequence[Planar]]

    @property
    def values(self) -> list[Value]:
        """All of its formulas: those of `part`, then x and y of N, then those of B, row by row."""
        planar = [*self.N, *(z for row in self.B for z in row)]
        return [*self.part, *(x for z in planar for x in z)]


def by_rounds(part: Array, N: Complex, B: Complex) -> tuple[Array, NDArray[np.bool_]]:
    """f (T, c) of states, and whether a state (T,) has none; of one that is not finite f is nan."""
    f: Array = part * np.abs(N)
    finite = np.asarray(np.isfinite(f).all(axis=-1) & np.isfinite(B).all(axis=(-1, -2)))
    left = finite
    with np.errstate(all="ignore"):  # f may leave the floats
        for _ in range(FEW_ROUNDS):
            before, f = f, part * np.abs(N + (f[..., None] * B).sum(axis=-2))
            least = SETTLED * np.abs(f).max(axis=-1, keepdims=True)
            steady = (np.abs(f - before) <= least) & np.isfinite(f)
            left = np.asarray(finite & ~steady.all(axis=-1))
            if not left.any():
                break
    f[~finite] = np.nan
    for state in np.flatnonzero(left):
        found = by_newton(part[state], N[state], B[state], before[state])
        left[state] = found is None
        f[state] = np.nan if found is None else found
    return f, left


def by_newton(part: Array, N: Complex, B: Complex, f: Array) -> Array | None:
    """f (c) of one state by Newton's method from an f that rounds left; None if there is none."""
    one = np.eye(len(f))
    if not np.isfinite(f).all():
        f = part * np.abs(N)
    for _ in range(MOST_STEPS):
        with np.errstate(all="ignore"):
            z = N + f @ B
            size = np.abs(z)
            now: Array = part * size
            away = f - now
            slope = ((part * z.conj() / np.where(size > 0.0, size, 1.0)) * B).real  # [j, i]
        if not (np.isfinite(slope).all() and np.isfinite(now).all()):
            return None
        if np.abs(away).max() <= SETTLED * np.abs(now).max():
            return now if np.abs(np.linalg.eigvals(slope)).max() < 1.0 else None
        try:
            f = f - np.linalg.solve(one - slope.T, away)
        except np.linalg.LinAlgError:
            return None
    return None
