"""Decides whether a singular configuration is a change point or only nearly one.

At a configuration q* where Psi loses rank, with U0 and V0 its left and right null spaces there,

    gamma = U0^T gap(q*)                          the miss, m
    the branches near q*:  gamma + 1/2 x^T H x = 0,     H = -V0^T diag(Re((u^T P) E)) V0, u of U0

A **change point** has one freedom beside it, a miss at rounding level, and an indefinite H: two
branches cross there, and a motion goes straight on.  At distance d from it, accelerations lose
accuracy as eps/d^2 although the motion is smooth.  So values there are interpolated along the
branch, from K states before and K behind, at q + k step qd/max|qd|, where Psi is regular.  The wide
step is used if two orders of interpolation agree, else the narrow one.

Everywhere else the equations are solved as they are, on accurately closed states (`closing.py`).
Motions of a loop that **misses** a change point are treated in `misses.py`.

The distance of a state is measured by s/L: s the least singular value of Psi that matters, L the
size of the loop (`singular_size`).  Solvers without singular values compare pivots with squared
lengths, which are about (s/L)^2: this number is called quality.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.factors import svd
from robodyn.loops import closures
from robodyn.loops.closing import (
    close_positions,
    closed_jacobians,
    exact_gap,
    loop_size,
    regular_rank,
    singular_size,
    wrapped,
)
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

# of t and a state: the nearest closed one, and how regular Psi is there, about (s/L)^2
Closing = Callable[[float, Array], tuple[Array, float]]

EPS = float(np.finfo(float).eps)
NEAR = 0.1  # s/L below which the nearest singular configuration is looked for
SUSPECT = NEAR**2  # the same as a quality
EXACT = 0.04  # part of what is suspect below which a state is closed exactly: s/L < 2 NEAR_SINGULAR
USUAL = 0.13  # part of what is usual below which a quality is suspect
ROUNDING = 4.0 * EPS  # a miss, part of L; meant in decimals it was 0.62 eps on 622 four-bars
WORTH_SAYING = 1e4 * EPS  # a miss, part of L, below which a scene may have meant none
ALIKE = 5.0  # singular values up to so many times the least vanish with it
DEFINITE = 1e-6  # ratio of eigenvalues of H of one sign, from which it is definite
FOUND = 1e-9  # rad, the last step of a search that has found; s/L there
LOST = 1e-7  # s/L below which a singular value is none, in a configuration so found
FEW = 12  # rows of Psi up to which singular values cost no more than their squares
COARSE = 1e-5  # s/L from which these tell it to 1e-6
REACH = 1.0  # rad, how far a singular configuration may be from a state that is near it
SAME = 0.3  # rad, from one that a run has met within which no other is looked for
STEPS_TO_FIND = 10
CELL = 0.05  # rad, between the points that searches begin at
KEPT = 1024  # points whose searches are kept
MISSES = "misses a change point by"
LOOKED_AT = 32  # states of a batch, the nearest to singular ones, of which a miss is told

BESIDE = 0.08  # part of s/L beside it below which a state is taken from the branch
STRAIGHT = 1e-9  # part of the loop's size that an interpolated position may be open by
STEPS = (0.1, 0.03)  # rad of the fastest joint; the first serves up to d = 0.046
SMOOTH = 1e-9  # part of the largest value by which two orders may differ
K = 6


class Singular(NamedTuple):
    """A configuration q (n,) where Psi loses rank, its miss (m), and its kind."""

    q: Array
    miss: float
    crosses: bool  # a change point
    misses: bool  # by more than rounding
    freedoms: int  # beside it
    worth_saying: bool  # as a miss


@lru_cache(maxsize=64)
def suspect_quality(mechanism: Mechanism) -> float:
    """Pivot quality, about (s/L)^2, below which a closed state counts as near singular.

    Loops of many links have small pivots everywhere, so the bound is relative to random closed
    states.
    """
    sizes = [row.size**2 for row in mechanism.rows]
    # pivots of Psi Psi^T are squares of the diagonal of R in Psi^T = Q R
    found = [
        (np.asarray(np.linalg.qr(Psi.T, mode="r")).diagonal() ** 2 / sizes).min()
        for Psi in closed_jacobians(mechanism)
        if len(sizes) <= mechanism.n
    ]
    return min(SUSPECT, USUAL * float(np.median(found))) if found else SUSPECT


def nearness(mechanism: Mechanism, Psi: Array) -> Array:
    """Return s/L (...) of Psi (..., r, n)."""
    s = np.linalg.svd(Psi, compute_uv=False)
    return np.asarray(s[..., regular_rank(mechanism) - 1] / singular_size(mechanism))


def _measured(mechanism: Mechanism, q: Array) -> tuple[int, float]:
    """Return the rank of Psi on the branch around q (n,), and s/L at q."""
    Psi = closures.scaled_jacobian(mechanism, q, 0.0)
    regular, size = regular_rank(mechanism), loop_size(mechanism)
    if mechanism.laws and not np.isfinite(Psi).all():  # beyond where a law has a value
        return regular, 1.0
    if regular == len(Psi) > FEW:  # squares, which tell no small ones, in a third of the time
        least = float(np.linalg.eigvalsh(Psi @ Psi.T)[0])
        if least > (COARSE * size) ** 2:
            return regular, math.sqrt(least) / singular_size(mechanism)
    s = np.linalg.svd(Psi, compute_uv=False)
    if s[regular - 1] <= FOUND * size:
        regular = _branch_rank(mechanism, _cell(mechanism, q))
    return regular, float(s[regular - 1] / singular_size(mechanism))


def _cell(mechanism: Mechanism, q: Array) -> tuple[float, ...]:
    """Return the point nearest to q (n,) of a grid with spacing CELL rad, in steps of the grid.

    Results of a search from a grid point may be cached: they do not depend on which state near the
    point came first.
    """
    return tuple(np.rint(q / (CELL * mechanism.arrays.units)).tolist())


def _at_cell(mechanism: Mechanism, cell: tuple[float, ...]) -> Array:
    """Return the configuration (n,) of a grid point."""
    return np.array(cell) * CELL * mechanism.arrays.units


@lru_cache(maxsize=KEPT)
def _branch_rank(mechanism: Mechanism, cell: tuple[float, ...]) -> int:
    """Return the rank of Psi on the branch beside a singular configuration near a grid point."""
    return max(1, rank_beside(mechanism, _at_cell(mechanism, cell), 1e-2, 8))


def rank_beside(mechanism: Mechanism, q: Array, away: float, count: int) -> int:
    """Return the largest rank of Psi at closed states about `away` rad from q (n,)."""
    noise = np.random.default_rng(0).normal(size=(count, mechanism.n))
    beside = close_positions(mechanism, q + away * noise * mechanism.arrays.units, t=0.0)
    gap = np.abs(closures.closure_gap(mechanism, beside, 0.0)).max(axis=-1)
    closed = beside[gap < 1e-9 * loop_size(mechanism)]
    return int(rank(mechanism, closures.scaled_jacobian(mechanism, closed, 0.0)).max(initial=0))


def rank(mechanism: Mechanism, Psi: Array) -> NDArray[np.int64]:
    """Return the rank (...) of Psi (..., r, n)."""
    s = np.linalg.svd(Psi, compute_uv=False)
    return np.asarray((s > LOST * loop_size(mechanism)).sum(axis=-1))


# -- the nearest singular configuration ------------------------------------------------------------


def nearest_singular(
    mechanism: Mechanism, q: Array, met: list[Singular] | None = None
) -> Singular | None:
    """Return the singular configuration near q (n,); None if there is none.

    If one of `met`, those met by a run, is within SAME rad, it is returned.  A new one is added to
    `met`.
    """
    if mechanism.driven or not np.isfinite(q).all():  # laws of the time lead through no such place
        return None
    regular, near = _measured(mechanism, q)
    if near > NEAR:
        return None
    if met and (old := nearest_of(mechanism, met, q, SAME)) is not None:
        return old
    found = _found_near(mechanism, _cell(mechanism, q), regular)
    if met is not None and found is not None:
        old = nearest_of(mechanism, met, found.q, 1e-6)
        if old is None:
            met.append(found)
        found = old or found
    return found


@lru_cache(maxsize=KEPT)
def _found_near(mechanism: Mechanism, cell: tuple[float, ...], usual: int) -> Singular | None:
    """Return the singular configuration near a grid point; None if the search fails."""
    return _search(mechanism, _at_cell(mechanism, cell), usual)


def apart(mechanism: Mechanism, q: Array, other: Array) -> Array:
    """Return the largest joint distance (...) of q (..., n) from `other` (n,), turns aside, rad."""
    way = q - other
    if mechanism.description.couplings:
        way = way / mechanism.arrays.units
    else:
        way = wrapped(mechanism, way)
    return np.asarray(np.abs(way).max(axis=-1))


def nearest_of(
    mechanism: Mechanism, met: list[Singular], q: Array, within: float
) -> Singular | None:
    """Return the nearest of `met` to q (n,); None if none is within `within` rad."""
    distances = [float(apart(mechanism, q, each.q)) for each in met]
    least = min(distances, default=np.inf)
    return met[distances.index(least)] if least <= within else None


def _search(mechanism: Mechanism, q: Array, usual: int) -> Singular | None:
    """Return a configuration near q (n,) at which Psi loses its usual rank.

    The search first looks for the loss of all small singular values, then of one.
    """
    size = loop_size(mechanism)
    s = np.linalg.svd(closures.scaled_jacobian(mechanism, q, 0.0), compute_uv=False)[:usual]
    most = int((s <= max(ALIKE * s[-1], SUSPECT * FOUND * size)).sum())
    tried = (_singular(mechanism, q, usual - lost, usual) for lost in sorted({most, 1})[::-1])
    return next((found for found in tried if found is not None), None)


def _singular(mechanism: Mechanism, start: Array, regular: int, usual: int) -> Singular | None:
    """Return the configuration near `start` at which Psi has rank `regular`, with its kind.

    Newton's method closes the regular part, and moves within V0 until Psi vanishes there.  Returns
    None if it does not converge.
    """
    size, units = loop_size(mechanism), mechanism.arrays.units
    q = start
    for _ in range(STEPS_TO_FIND):
        Psi = closures.scaled_jacobian(mechanism, q, 0.0)
        U, s, Vt = svd(Psi, full=True)
        left, right = U[:, regular:], Vt[regular:].T
        H = _curvature(mechanism, q, left, right)
        slope = left.T @ Psi @ right
        z = np.linalg.lstsq(H.reshape(-1, H.shape[-1]), -slope.ravel(), rcond=1e-9)[0]
        gap = exact_gap(mechanism, q, 0.0)
        step = right @ z - Vt[:regular].T @ ((U[:, :regular].T @ gap) / s[:regular])
        q = q + step * units
        if not np.abs((q - start) / units).max() <= REACH:
            return None
        if np.abs(step).max() <= FOUND:
            break
    U, s, Vt = svd(closures.scaled_jacobian(mechanism, q, 0.0), full=True)
    if not np.abs(step).max() <= FOUND or not (s[regular:usual] <= FOUND * size).all():
        return None
    regular = int((s > LOST * size).sum())  # there more may vanish than beside it
    left, right = U[:, regular:], Vt[regular:].T
    miss = float(np.abs(left.T @ exact_gap(mechanism, q, 0.0)).max())
    values = np.linalg.eigvalsh(_curvature(mechanism, q, left, right))
    top = np.abs(values).max(axis=-1)
    definite = (values.min(axis=-1) > -DEFINITE * top) | (values.max(axis=-1) < DEFINITE * top)
    freedoms, misses = mechanism.n - usual, miss > ROUNDING * size
    crosses = freedoms == 1 and not misses and not (definite & (top > DEFINITE * size)).any()
    said = misses and miss <= WORTH_SAYING * size
    return Singular(q, miss, bool(crosses), misses, freedoms, said)


def _curvature(mechanism: Mechanism, q: Array, left: Array, right: Array) -> Array:
    """Return H (c, f, f), one for each column of `left`, within the columns of `right`.

    The acceleration of the gap is a quadratic form of the rates, so pairs of rates determine H.
    """
    ways = right.T * mechanism.arrays.units
    pairs = ways[:, None] + ways[None, :]
    own, both = (closures.closure_bias(mechanism, q, x, 0.0) @ left for x in (ways, pairs))
    H: Array = 0.5 * (both - own[:, None] - own[None, :])
    return np.moveaxis(H, -1, 0)


def miss_remark(mechanism: Mechanism, states: Array) -> str:
    """Return a remark if one of the states (..., n) is near a missed change point, else ""."""
    q_all = states.reshape(-1, mechanism.n)
    if len(q_all) > LOOKED_AT:
        near_all = nearness(mechanism, closures.scaled_jacobian(mechanism, q_all, 0.0))
        q_all = q_all[np.argpartition(near_all, LOOKED_AT)[:LOOKED_AT]]
    for q in q_all:
        near = nearest_singular(mechanism, q)
        if near is not None and near.worth_saying:
            return f"{MISSES} {near.miss:.2g} m"
    return ""


# -- what is taken from the branch ----------------------------------------------------------------


def lagrange(nodes: Array, x: Array) -> Array:
    """Return the weights (T, nodes) of the polynomial through the nodes, at x (T,)."""
    weights = np.ones((len(x), len(nodes)))
    for i, node in enumerate(nodes):
        for other in np.delete(nodes, i):
            weights[:, i] *= (x - other) / (node - other)
    return weights


OFFSETS = np.array([k for k in range(-K, K + 1) if k])
WEIGHTS = lagrange(OFFSETS, np.zeros(1))[0]  # of the values there for the one in the middle
LOWER = np.pad(lagrange(OFFSETS[1:-1], np.zeros(1))[0], 1)  # two orders less


def lead_across(
    mechanism: Mechanism,
    closing: Closing,
    y: Array,
    near: Singular,
    evaluate: Callable[[Array], Array],
) -> Array | None:
    """Interpolate `evaluate` at y along its branch from states beside it; None if far away.

    `near` is a change point.  `evaluate` takes states (2K, len(y)), y = (q, qd, ...), to values
    (2K, m).  Components of y after the rates are copied to all states.
    """
    n = mechanism.n
    fastest = float(np.abs(y[n : 2 * n]).max())
    if not 0.0 < fastest < np.inf:
        return None
    away = float(apart(mechanism, y[:n], near.q))
    for step in STEPS:
        close = away <= 2.0 * BESIDE * K * step
        around = _beside(mechanism, closing, y, step / fastest) if close else None
        if around is None:
            continue
        values = evaluate(around)
        middle: Array = WEIGHTS @ values
        differ = np.abs(middle - LOWER @ values)
        if step == STEPS[-1] or (differ <= SMOOTH * np.abs(values).max()).all():
            return middle
    return None


def _beside(mechanism: Mechanism, closing: Closing, y: Array, step: float) -> Array | None:
    """Return closed states (2K, len(y)) on both sides of y, `step` seconds apart.

    Returns None if y is not near a change point.
    """
    n = mechanism.n
    rows = np.repeat(y[None, :], len(OFFSETS), axis=0)
    rows[:, :n] += step * OFFSETS[:, None] * y[n : 2 * n]
    rows[0], rows[-1] = (closing(0.0, rows[k])[0] for k in (0, -1))
    here, *there = (_measured(mechanism, row[:n])[1] for row in (y, rows[0], rows[-1]))
    if here > BESIDE * max(there):
        return None
    for k in range(1, len(rows) - 1):
        rows[k], _ = closing(0.0, rows[k])
    gap = closures.closure_gap(mechanism, (WEIGHTS @ rows)[:n], 0.0)
    return rows if np.abs(gap).max() <= STRAIGHT * loop_size(mechanism) else None
