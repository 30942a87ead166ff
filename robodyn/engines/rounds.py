"""Solves f = part |N + f B|, for forces that depend on their own effect.

Friction by the forces in pins and slides is of this kind.  N (c,) and B (c, c) are planar; B[j][i]
is what f_j adds to the N of f_i.  Fixed-point rounds from f = part |N| converge if friction is
small.  If they are slow, Newton's method goes on; its result counts only if rounds nearby converge
to it.
"""

from __future__ import annotations

import math
import operator
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
    """`part` (c), N (c) and B (c, c) as formulas, in a formula with unknowns f0, f1, ..."""

    part: Sequence[Value]
    N: Sequence[Planar]
    B: Sequence[Sequence[Planar]]

    @property
    def values(self) -> list[Value]:
        """Return all its formulas: `part`, then x and y of N, then B row by row."""
        planar = [*self.N, *(z for row in self.B for z in row)]
        return [*self.part, *(x for z in planar for x in z)]


def by_rounds(part: Array, N: Complex, B: Complex) -> tuple[Array, NDArray[np.bool_]]:
    """Return f (T, c) for states, and whether each state (T,) has no solution.

    f is nan for states that are not finite.
    """
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


def of_one(part: Array, N: Complex, B: Complex) -> Array | None:
    """Return f (c,) of one state by plain numbers, which are faster; None if there is none."""
    parts, forces, columns = part.tolist(), N.tolist(), B.T.tolist()
    each = list(zip(parts, forces, columns, strict=True))
    f = [p * abs(z) for p, z in zip(parts, forces, strict=True)]
    for _ in range(FEW_ROUNDS):
        before = f
        f = [p * abs(sum(map(operator.mul, before, row), z)) for p, z, row in each]
        least = SETTLED * max(map(abs, f), default=0.0)
        if all(abs(x - y) <= least < math.inf for x, y in zip(f, before, strict=True)):
            return np.array(f)
    return by_newton(part, N, B, np.array(f))


def by_newton(part: Array, N: Complex, B: Complex, f: Array) -> Array | None:
    """Return f (c,) of one state by Newton's method from an approximate f; None if it fails."""
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
