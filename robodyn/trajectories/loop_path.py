"""The path of all joints of a mechanism when its actuated joints follow a path of their own.

The passive joints are interpolated between the nodes of `continuation.py` and corrected by Newton's
method.  A path that runs straight across a change point is smooth, so within STEP of it they are
interpolated, to order 12, from states on both sides.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robodyn.loops.change_points import OFFSETS, lagrange, miss_remark
from robodyn.loops.loop_rates import loop_accelerations, loop_velocities
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array
from robodyn.trajectories.continuation import (
    TRAVEL,
    Follower,
    PathEndError,
    TravelError,
    Watch,
    corrected,
    hermite,
)
from robodyn.trajectories.joint_paths import JointPath, Pieces, Values, travels

Columns = Callable[[Array, Pieces], Array]  # values (T, columns) at u (T,) of these pieces
Samples = tuple[Array, Pieces]  # u (T,) and the piece of each

STEP = 0.03  # rad of the fastest joint, between the states that lead across a change point
FEWEST = 64  # samples of a path of few pieces
MOST_SAMPLES = 1_000_000
ROUNDS = 13  # of the search between samples: each makes the interval four times shorter
MOST_PLACES = 64  # of one column, at which to search
BLOCK = 20_000  # samples evaluated at once


class WholePath(JointPath):
    """The path of all joints of a mechanism that follows a path of its actuated joints.

    As it is, of a mechanism of which every joint is actuated and no loop is to be kept.
    """

    def __init__(self, mechanism: Mechanism, path: JointPath) -> None:
        self.mechanism, self.path, self.breaks = mechanism, path, path.breaks

    def within(self, u: Array, piece: Pieces) -> Values:
        """q, q', q'' of all joints at u (T,), each (T, n), as these pieces have it."""
        return self.path.within(u, piece)

    def driven(self, u: Array, piece: Pieces) -> Values:
        """The same of the actuated joints, (T, m) each."""
        return self.path.evaluate(u, piece)

    def peaks(self) -> Array:
        """The largest |q'| and |q''| of each actuated joint, (2, m)."""
        pieces = len(self.breaks) - 1
        counts = np.full(pieces, max(8, FEWEST // pieces))
        return self.largest(samples(self.breaks, np.arange(pieces), counts))

    def largest(self, grid: Samples) -> Array:
        """The same, looked for between these samples."""

        def of(order: int, joint: int) -> float:
            return largest(lambda *at: self.driven(*at)[order][:, [joint]], grid)

        joints = range(len(self.mechanism.actuated))
        return np.array([[of(order, joint) for joint in joints] for order in (1, 2)])

    def grid(self) -> Samples:
        """Samples (u, piece) close enough to follow the path, the ends of each piece included."""
        edges = self.path.breaks
        if len(returns := self.path.returns()):
            edges = np.array([0.0, returns[0]])
        pieces = len(edges) - 1
        counts = np.full(pieces, max(8.0, FEWEST // pieces))
        if counts.sum() <= MOST_SAMPLES:
            counts = np.maximum(np.ceil(travels(self.path, edges) / (0.5 * TRAVEL)), counts)
        if not counts.sum() <= MOST_SAMPLES:
            limit = f"takes more than the {MOST_SAMPLES:,} samples in which limits are looked for"
            raise TravelError(self.mechanism, f"{self.path.travel:.6g} rad", limit)
        found = samples(edges, np.arange(pieces), counts.astype(int))
        return _repeated(*found, float(edges[-1]))


class LoopPath(WholePath):
    """The path of all joints of a mechanism with passive joints, from the closed state `start`.

    Raises PathEndError where the loops cannot be closed all the way, or the actuated joints do not
    determine the others.
    """

    def __init__(
        self, mechanism: Mechanism, path: JointPath, start: Array, watch: Watch = lambda u: None
    ) -> None:
        super().__init__(mechanism, path)
        self._nodes = Follower(mechanism, path, watch).nodes(start)

    @property
    def remark(self) -> str:
        """What is said of a change point that the loops just miss on the way, if they do."""
        return miss_remark(self.mechanism, self._nodes.q)

    def within(self, u: Array, piece: Pieces) -> Values:
        """As told; SingularError where the actuated joints determine no others."""
        result = [np.zeros((len(u), self.mechanism.n)) for _ in range(3)]
        direct = np.ones(len(u), bool)
        period = self._nodes.period
        for at, fastest in self._nodes.crossings:
            of = int(np.flatnonzero((self.breaks[:-1] <= at) & (at <= self.breaks[1:]))[0])
            begin, end = self.breaks[of : of + 2].tolist()
            if at + period <= end:  # of a path that repeats itself: there is room on both sides
                at += period
            offsets, step = _beside(at, STEP / fastest, begin, end)
            turn = np.round((u - at) / period) * (period < 1.0)
            off = u - at - turn * period
            near = np.flatnonzero(direct & (piece == of) & (np.abs(off) < 0.5 * step))
            if len(near):
                beside = self._closed(at + step * offsets, np.full(len(offsets), of))
                weights = lagrange(offsets, off[near] / step)
                held = self.path.evaluate(u[near], piece[near])
                for values, known, given in zip(result, beside, held, strict=True):
                    values[near] = weights @ known
                    if known is beside[0]:
                        values[near] += turn[near, None] * self._nodes.rise
                    values[near[:, None], list(self.mechanism.actuated)] = given
                direct[near] = False
        if direct.any():
            closed = self._closed(u[direct], piece[direct])
            for values, found in zip(result, closed, strict=True):
                values[direct] = found
        return result[0], result[1], result[2]

    def grid(self) -> Samples:
        pieces = self._nodes.pieces
        per_piece = np.bincount(pieces, minlength=len(self.path.breaks) - 1)
        least = max(8, FEWEST // len(per_piece))
        share = np.maximum(4, np.ceil(least / np.maximum(per_piece, 1))).astype(int)
        found = samples(self._nodes.u, pieces, share[pieces])
        return _repeated(*found, self._nodes.period)

    def _closed(self, u: Array, piece: Pieces) -> Values:
        nodes = self._nodes
        p, p1, p2 = self.path.evaluate(u, piece)
        turn = np.clip(np.floor(u / nodes.period), 0, _last_turn(nodes.period))
        v = u - turn * nodes.period
        k = np.clip(np.searchsorted(nodes.u, v, side="right") - 1, 0, len(nodes.u) - 2)
        h = (nodes.u[k + 1] - nodes.u[k])[:, None]
        x = (v - nodes.u[k])[:, None] / h
        q = hermite(x, h, nodes.q[k], nodes.begins[k], nodes.q[k + 1], nodes.ends[k])
        q += turn[:, None] * nodes.rise
        q[:, self.mechanism.actuated] = p
        q, closed = corrected(self.mechanism, q)
        if not closed.all():
            worst = int(np.argmin(closed))
            reason = f"they are open at u = {u[worst]:.9g} between two closed states"
            raise PathEndError(self.mechanism, float(u[worst]), q[worst], reason)
        q1 = loop_velocities(self.mechanism, q, p1)
        return q, q1, loop_accelerations(self.mechanism, q, q1, p2)


def _beside(at: float, step: float, begin: float, end: float) -> tuple[Array, float]:
    """Where states lead across `at`, in steps from there, within [begin, end]; and the step.

    On both sides if there is room, else more of them on one.
    """
    count = len(OFFSETS)
    step = min(step, (end - begin) / (count + 3))
    first = max(-int((at - begin) / step), -count)
    last = min(int((end - at) / step), count)
    whole = np.array([k for k in range(first, last + 1) if k], float)
    return whole[np.sort(np.argsort(np.abs(whole), kind="stable")[:count])], step


def _last_turn(period: float) -> int:
    """The number of the last of the turns, of which the first is 0, that fill a path."""
    return math.ceil((1.0 - 1e-9 * period) / period) - 1


def _repeated(u: Array, pieces: Pieces, period: float) -> Samples:
    """Samples of the first turn, in the first and in the last two as well.

    What counts turns (a spring at a joint) grows from turn to turn, so its extremes are there.
    """
    last = _last_turn(period)
    turns = sorted({0, max(last - 1, 0), last})
    each = [np.minimum(u + turn * period, 1.0) for turn in turns]
    return np.concatenate(each), np.tile(pieces, len(turns))


def samples(edges: Array, pieces: Pieces, counts: NDArray[np.int_]) -> Samples:
    """count + 1 samples of each interval, both ends included, each with the interval's piece."""
    each = zip(edges[:-1], edges[1:], counts, strict=True)
    us = [np.append(a + (b - a) / count * np.arange(count), b) for a, b, count in each]
    return np.concatenate(us), np.repeat(pieces, counts + 1)


def least_along(columns: Columns, grid: Samples) -> tuple[float, float, int, int]:
    """The least value of any column along samples of a path, with its u, piece and column.

    Around each sample that may lead to it nine points are taken, then nine between the two next to
    the best of them, a quarter of the interval each time.
    """
    u, piece = grid
    blocks = range(0, len(u), BLOCK)
    values = np.concatenate([columns(u[k : k + BLOCK], piece[k : k + BLOCK]) for k in blocks])
    before, after = np.full_like(values, np.inf), np.full_like(values, np.inf)
    joined = (piece[1:] == piece[:-1])[:, None]
    before[1:] = np.where(joined, values[:-1], np.inf)
    after[:-1] = np.where(joined, values[1:], np.inf)
    lowest = (values <= before) & (values <= after) & np.isfinite(values)
    lowest &= (values != before) | (values != after)  # of a level stretch its ends will do
    if not lowest.any():
        return math.inf, 0.0, 0, 0
    # a parabola through three samples lies below the lowest by less than the rise from it
    with np.errstate(invalid="ignore"):  # infinite where x is
        floor = values - (np.maximum(before, after) - values)
    lowest &= floor <= values[lowest].min()
    each = [np.flatnonzero(column) for column in lowest.T]
    each = [at[np.argsort(values[at, j], kind="stable")[:MOST_PLACES]] for j, at in enumerate(each)]
    rows = np.concatenate(each)
    places = np.repeat(np.arange(len(each)), [len(at) for at in each])
    first = np.where((rows > 0) & (piece[np.maximum(rows - 1, 0)] == piece[rows]), rows - 1, rows)
    following = np.minimum(rows + 1, len(u) - 1)
    last = np.where(piece[following] == piece[rows], following, rows)
    low, high = u[first], u[last]
    best, at = values[rows, places], u[rows]
    part = np.linspace(0.0, 1.0, 9)
    index = np.arange(len(rows))
    for _ in range(ROUNDS):
        trial = low[:, None] + (high - low)[:, None] * part
        tried = columns(trial.reshape(-1), np.repeat(piece[rows], 9)).reshape(*trial.shape, -1)
        found = tried[index[:, None], np.arange(9), places[:, None]]
        k = np.argmin(found, axis=1)
        better = found[index, k] < best - 1e-14 * np.abs(best)
        best = np.where(better, found[index, k], best)
        at = np.where(better, trial[index, k], at)
        low, high = trial[index, np.maximum(k - 1, 0)], trial[index, np.minimum(k + 1, 8)]
    winner = int(np.argmin(best))
    return float(best[winner]), float(at[winner]), int(piece[rows[winner]]), int(places[winner])


def largest(columns: Columns, grid: Samples) -> float:
    """The largest absolute value of any column along samples of a path."""
    return -least_along(lambda u, piece: -np.abs(columns(u, piece)), grid)[0]
