"""Many motions of one structure at once, in numpy: each lane with its own time and step.

Lanes that have ended leave the arrays, so that the last ones cost little more than their own.  What
a lane leaves behind is gathered along the way, from the states at the steps' ends and from the
series between them (`step_extremes.py`).  `lanes_compiled.py` does the same in compiled loops.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.lane_series import LaneSeries
from robodyn.step_extremes import crossings, extremes, values
from robodyn.taylor import PARTS, Status
from robodyn.taylor_layout import Layout

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class Aims(NamedTuple):
    """How lanes are integrated, and what is wanted of them besides their ends."""

    rtol: float
    atol: float
    most: int = 100_000  # steps
    suspect: float = 0.0  # quality of a closing below which no step starts
    extremes: bool = True
    link: int = -1  # whose flip is wanted; -1: none's
    work: bool = False  # whether torques or dampers change the energy


@dataclass(slots=True)
class Ends:
    """What L lanes leave behind: SI units; nan where a lane has none.

    `low` and `high` (L, 2n) are the extremes of q, then of qd; `energy` (L, 2) its extremes at the
    ends of steps, less the mechanism's constant; `drift` the largest |E - E(0) - work| there
    against the energy in motion, as `recording.Report` has it; `flip` when the link passed upright.
    """

    t: Array
    y: Array  # (L, 2n)
    low: Array
    high: Array
    energy: Array
    drift: Array
    flip: Array
    status: Integers  # a Status
    steps: Integers

    @classmethod
    def room(cls, L: int, n: int) -> Ends:
        """For L lanes of n links."""
        wide = (np.full((L, 2 * n), math.nan) for _ in range(3))
        whole = (np.zeros(L, np.int64) for _ in range(2))
        long = (np.full(L, math.nan) for _ in range(2))
        return cls(np.zeros(L), *wide, np.full((L, 2), math.nan), *long, *whole)


def integrate(
    whole: Integers, reals: Array, at: Layout, y: Array, t_end: float, angle: Array, aims: Aims
) -> Ends:
    """The motions from y (L, 2n) at t = 0 to t_end.

    `reals` (L, R), or (1, R) where all lanes share it, as `taylor_layout.numbers` makes them.
    `angle` (L,) is that of the link whose flip is wanted, from hanging: it flips where |angle|
    exceeds pi.  A lane that cannot go on stops; its status tells why.
    """
    L, n = y.shape[0], at.n
    ends = Ends.room(L, n)
    shared = len(reals) == 1
    series = LaneSeries(whole, reals[0] if shared else np.ascontiguousarray(reals.T), at)
    lanes = np.arange(L)
    q, qd = np.ascontiguousarray(y[:, :n].T), np.ascontiguousarray(y[:, n:].T)
    quality = series.close(q, qd)
    t, work, steps = np.zeros(L), np.zeros(L), np.zeros(L, np.int64)
    angle = angle - series.absolute(q)[aims.link] if aims.link >= 0 else np.zeros(L)
    KE, PE = series.energies(q, qd)
    start, off, moving = KE + PE, np.zeros(L), KE.copy()
    lowest_PE, highest_PE, energy = PE.copy(), PE.copy(), np.stack([start, start])
    low, high = np.concatenate([q, qd]), np.concatenate([q, qd])
    flip = np.full(L, math.nan)
    direction = math.copysign(1.0, t_end)
    status = np.full(L, -1)
    while True:
        # those that end here leave
        status[~(quality >= aims.suspect)] = Status.SINGULAR
        status[steps >= aims.most] = Status.FULL
        status[t == t_end] = Status.REACHED
        out = status >= 0
        if out.any():
            gone = lanes[out]
            ends.t[gone], ends.status[gone], ends.steps[gone] = t[out], status[out], steps[out]
            ends.y[gone] = np.concatenate([q[:, out], qd[:, out]]).T
            ends.low[gone], ends.high[gone] = low[:, out].T, high[:, out].T
            ends.energy[gone] = energy[:, out].T
            energy_in_motion = np.maximum(moving, highest_PE - lowest_PE)[out]
            with np.errstate(all="ignore"):
                ends.drift[gone] = np.where(energy_in_motion > 0, off[out] / energy_in_motion, 0.0)
            ends.flip[gone] = flip[out]
            stay = ~out
            if not stay.any():
                return ends
            lanes, t, work, steps, status = (x[stay] for x in (lanes, t, work, steps, status))
            q, qd, low, high, energy = (x[:, stay] for x in (q, qd, low, high, energy))
            angle, start, off, moving = (x[stay] for x in (angle, start, off, moving))
            lowest_PE, highest_PE, flip = (x[stay] for x in (lowest_PE, highest_PE, flip))
            series.kept(stay)

        W = series.expand(q, qd)
        longest = series.longest(W, aims.rtol, aims.atol)
        status[np.isnan(longest)] = Status.NOT_FINITE
        longest = np.nan_to_num(longest, nan=0.0)
        left = np.abs(t_end - t)
        own = series.relative(W)
        h, new_q, new_qd, quality = _landed(series, own, q, qd, t, longest, left, direction, aims)
        end = np.where(np.abs(h) >= left, t_end, t + h)
        status[(end == t) & (status < 0)] = Status.STUCK
        h = end - t
        if aims.extremes:
            turn_low, turn_high, rate_low, rate_high = extremes(own, h)
            np.minimum(low, np.concatenate([q + turn_low, rate_low]), out=low)
            np.maximum(high, np.concatenate([q + turn_high, rate_high]), out=high)
        if aims.link >= 0:
            (open_,) = np.nonzero(np.isnan(flip))
            if len(open_):
                now = angle[open_] + series.absolute(q[:, open_])[aims.link]
                x = crossings(now, W[:, aims.link, open_], h[open_], math.pi)
                flip[open_] = t[open_] + x
        if aims.work:
            work = work + values(series.power(W)[:, None], h)[0][0]
        t, q, qd, steps = end, new_q, new_qd, steps + 1
        KE, PE = series.energies(q, qd)
        off = np.fmax(off, np.abs(KE + PE - work - start))
        moving = np.fmax(moving, KE)
        lowest_PE, highest_PE = np.fmin(lowest_PE, PE), np.fmax(highest_PE, PE)
        energy = np.stack([np.fmin(energy[0], KE + PE), np.fmax(energy[1], KE + PE)])
        if aims.extremes:  # the states at the ends are closed, the series are so to the tolerance
            np.fmin(low, np.concatenate([q, qd]), out=low)
            np.fmax(high, np.concatenate([q, qd]), out=high)


def _landed(
    series: LaneSeries,
    own: Array,
    q: Array,
    qd: Array,
    t: Array,
    longest: Array,
    left: Array,
    direction: float,
    aims: Aims,
) -> tuple[Array, Array, Array, Array]:
    """Steps h (B,), closed states there, and their qualities: where the next step starts well."""
    h = np.minimum(longest, left) * direction
    # the bound is met exactly
    x = np.where(longest >= left, left * direction, (t + h) - t)
    new_q, new_qd, quality = _closed(series, own, q, qd, x)
    poor = ~(quality >= aims.suspect)
    for part in PARTS[1:]:
        if not poor.any():
            break
        (b,) = np.nonzero(poor)
        shorter = np.minimum(part * longest[b], left[b]) * direction
        attempt = LaneSeries.__new__(LaneSeries)
        attempt.__dict__.update(series.__dict__)
        attempt.kept(b)
        there_q, there_qd, there = _closed(attempt, own[:, :, b], q[:, b], qd[:, b], shorter)
        better = there > quality[b]
        to = b[better]
        x[to], quality[to] = shorter[better], there[better]
        new_q[:, to], new_qd[:, to] = there_q[:, better], there_qd[:, better]
        poor = ~(quality >= aims.suspect)
    return x, new_q, new_qd, quality


def _closed(
    series: LaneSeries, own: Array, q: Array, qd: Array, x: Array
) -> tuple[Array, Array, Array]:
    """The closed states at x (B,) after q, qd, and their qualities."""
    turn, rate, _ = values(own, x)
    new_q, new_qd = q + turn, rate
    return new_q, new_qd, series.close(new_q, new_qd)
