"""Motions past a nearly missed change point: steps short enough to stay on their branch.

A loop that misses a change point by gamma turns back within sqrt(gamma) of it.  A step as long as
this distance leaps to the other branch without any visible error.  So steps nearby are bounded, and
a step that leapt is repeated: the orientation of the loop's rows in Psi turns over across the leap.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import reduce
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robodyn.engines.coupling_laws import laws_of
from robodyn.loops import closures
from robodyn.loops.change_points import (
    EPS,
    SAME,
    Singular,
    apart,
    nearest_of,
    nearest_singular,
    nearness,
)
from robodyn.loops.closing import NEAR_SINGULAR, close_positions, regular_rank
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import Placed, placed
from robodyn.tables.arrays import Array

Value = Any  # a float, an array, or an expression
Matrix = Sequence[Mapping[int, Value]]  # rows, with their columns that are not zero

SHARE = 0.5  # of the distance to a missed change point that a step may go
FINE = 1e-3  # of it, rad, that a step may err
ROUNDING = 10.0 * EPS  # of the rates, at a distance of 1 rad
TURN = 1.5  # rad of the fastest joint in a step: two change points on its way would hide each other
CLOSEST = 1e-9  # rad, the least distance that is counted with
SLOWEST = 1e-9  # rad/s: what is slower is held like this
FAR = 1.0  # rad, within which steps that are not held are no use


def orientation(mechanism: Mechanism, Psi: Matrix, other: Matrix) -> list[Value]:
    """Return per loop a value that is negative if its rows turn over between two states' Psi.

    They are determinants of Psi Psi'^T up to this loop, divided by those up to the one before, so
    that loops which leap together do not hide one another.
    """
    loops: dict[object, list[int]] = {}
    for r, row in enumerate(mechanism.rows):
        loops.setdefault(r if row.closure is None else f"closure {row.closure}", []).append(r)
    joined: dict[int, list[int]] = {}  # the rows of a link
    for s, two in enumerate(other):
        for k in two:
            joined.setdefault(k, []).append(s)
    rows: list[dict[int, Value]] = [{} for _ in Psi]
    for one, products in zip(Psi, rows, strict=True):
        for k, value in one.items():
            for s in joined[k]:
                product = value * other[s][k]
                products[s] = products[s] + product if s in products else product
    pivots: list[Value] = []
    for i, upper in enumerate(rows):
        pivots.append(upper.get(i, 0.0))
        later = [s for s in upper if s > i]  # rows have entries where columns have
        for t in later:
            factor = rows[t][i] / pivots[i]
            for s in later:
                rows[t][s] = rows[t].get(s, 0.0) - factor * upper[s]
    return [reduce(mul, (pivots[r] for r in members)) for members in loops.values()]


def sparse_rows(mechanism: Mechanism, at: Placed, t: ArrayLike) -> list[dict[int, Value]]:
    """Return the nonzero entries (...) of each row of Psi, in absolute coordinates, at t."""
    found: list[dict[int, Value]] = []
    laws = laws_of(mechanism)
    slopes = None
    if laws is not None:  # d gap/dx of the laws
        slopes = np.zeros((*at.x.shape[:-1], len(mechanism.rows), mechanism.n))
        laws.add_jacobian(at.x, t, slopes)
    for r, row in enumerate(mechanism.rows):
        entries: dict[int, Value] = dict(row.angles)
        line = 1.0 if row.line is None else at.E[..., row.line].conj()
        across: Value = row.ground

        def add(k: int, value: Value, entries: dict[int, Value] = entries) -> None:
            entries[k] = entries[k] + value if k in entries else value

        for k, p in row.P:
            across = across + p * at.X[..., k]
            turned = -(line * p * at.X[..., k]).imag
            if k not in mechanism.slides:
                add(k, turned)
                continue
            add(k, (line * p * at.E[..., k]).real)
            if (d := mechanism.frames[k]) is not None:
                add(d, turned)
        if row.line is not None:
            add(row.line, (line * across).imag)
        if row.law is not None and slopes is not None:
            for k in _columns_of(slopes[..., r, :]):
                add(k, slopes[..., r, k])
        found.append(entries)
    return found


def _columns_of(rows: Array) -> list[int]:
    """Return the columns in which rows (..., n) are not zero everywhere."""
    return [int(k) for k in np.flatnonzero(rows.reshape(-1, rows.shape[-1]).any(axis=0))]


class Misses:
    """The singular configurations that one run of a mechanism has met.

    They bound the steps of an integrator.  Another run starts without any, so that it does not
    depend on earlier runs.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.met: list[Singular] = []
        regular = regular_rank(mechanism) == len(mechanism.rows)
        self._guards = regular and not mechanism.driven

    def nearest(self, q: Array) -> Singular | None:
        """Return the singular configuration near q (n,) and record it; None if there is none."""
        return nearest_singular(self.mechanism, q, self.met)

    def distance(self, q: Array | Sequence[float]) -> float:
        """Return the distance to the nearest recorded miss, rad; infinite if there is none."""
        missed = [each for each in self.met if not each.crosses]
        least = min(
            (float(apart(self.mechanism, np.asarray(q), each.q)) for each in missed), default=np.inf
        )
        return max(least, CLOSEST)

    def holds(self, y: Array | Sequence[float]) -> tuple[float, float, float]:
        """Return for a step from y = (q, qd, ...): longest step (s), error (rad), rate noise.

        The rate noise (rad/s) is an error of the rates that no tolerance can avoid.
        """
        n = self.mechanism.n
        fastest = max(*map(abs, y[n : 2 * n]), SLOWEST)
        if not self.met:
            return TURN / fastest, math.inf, 0.0
        distance = self.distance(y[:n])
        longest = min(SHARE * distance, TURN) / fastest
        return longest, FINE * distance, ROUNDING * fastest / distance

    def near(self, q: Array) -> bool:
        """Return whether the nearest recorded configuration around q is a miss."""
        found = nearest_of(self.mechanism, self.met, q, SAME)
        return found is not None and not found.crosses

    def crosses(self, q: Array) -> bool:
        """Return whether a state of suspect quality is near a change point, not near a miss."""
        found = self.nearest(q)
        if found is None:  # what it is near to is not known
            Psi = closures.scaled_jacobian(self.mechanism, q, 0.0)
            return bool(nearness(self.mechanism, Psi) < NEAR_SINGULAR)
        return found.crosses

    def leaps(self, t: Array, y: Array) -> list[int]:
        """Return the steps between states y (T + 1, N) at t (T + 1,) that leapt over a miss.

        A miss found here is recorded and bounds the next steps.
        """
        q = y[:, : self.mechanism.n]
        if not self._guards or len(q) < 2 or not np.isfinite(q).all():
            return []
        rows = sparse_rows(self.mechanism, placed(self.mechanism, q), t)
        Psi = [
            [
                {k: x[part] if isinstance(x, np.ndarray) else x for k, x in row.items()}
                for row in rows
            ]
            for part in (slice(1, None), slice(-1))
        ]
        with np.errstate(all="ignore"):
            kept = [np.asarray(x > 0.0) for x in orientation(self.mechanism, *Psi)]
            turned = ~np.all(np.broadcast_arrays(*kept, np.ones(len(q) - 1, bool)), axis=0)
        return [
            int(k)
            for k in np.flatnonzero(turned)
            if self._between(q[k], q[k + 1]) and self.holds(y[k])[0] < 0.9 * abs(t[k + 1] - t[k])
        ]

    def _between(self, begin: Array, end: Array) -> bool:
        """Return whether a miss lies between two states."""
        way = begin + np.linspace(0.0, 1.0, 33)[:, None] * (end - begin)
        far = [(float(apart(self.mechanism, way, x.q).min()), x.crosses) for x in self.met]
        nearest, crosses = min(far, default=(np.inf, False))
        if nearest <= SAME:
            return not crosses
        way = close_positions(self.mechanism, way, t=0.0)
        near = nearness(self.mechanism, closures.scaled_jacobian(self.mechanism, way, 0.0))
        found = self.nearest(way[int(np.argmin(near))])
        return found is not None and not found.crosses
