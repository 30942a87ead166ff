"""Many motions of one structure at once, in numpy: each lane with its own time and step.

Lanes that have ended leave the arrays, so that the last ones cost little more than their own.  What
a lane leaves behind is gathered along the way, from the states at the steps' ends and from the
series between them (`step_extremes.py`).  `lanes_compiled.py` does the same in machine code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.loops.misses import SLOWEST, TURN
from robodyn.sweeps.lane_motion import Expanded, LaneMotion
from robodyn.sweeps.step_extremes import crossings, extremes, values
from robodyn.taylor import PARTS, Status

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SMALLEST_TIME = 1e-6  # s, whose spacing steps at the start may have


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
        wide, long = np.full((3, L, 2 * n), math.nan), np.full((2, L), math.nan)
        energy, whole = np.full((L, 2), math.nan), np.zeros((2, L), np.int64)
        return cls(np.zeros(L), wide[0], wide[1], wide[2], energy, *long, *whole)


def integrate(series: LaneMotion, y: Array, t_end: float, angle: Array, aims: Aims) -> Ends:
    """The motions from y (L, 2n) at t = 0 to t_end.

    `angle` (L,) is that of the link whose flip is wanted, from hanging: it flips where |angle|
    exceeds pi.  A lane that cannot go on stops; its status tells why.
    """
    with np.errstate(all="ignore"):  # what leaves the floats is told by its status
        return _integrate(series, y, t_end, angle, aims)


def _integrate(series: LaneMotion, y: Array, t_end: float, angle: Array, aims: Aims) -> Ends:
    L, n = len(y), series.n
    ends = Ends.room(L, n)
    q, qd = np.ascontiguousarray(y[:, :n].T), np.ascontiguousarray(y[:, n:].T)
    quality = series.close(q, qd)
    if aims.link >= 0:
        angle = angle - series.absolute(q)[aims.link]
    now = _Running.begin(q, qd, quality, angle, *series.energies(q, qd))
    direction = math.copysign(1.0, t_end)
    while True:
        now.status[~(now.quality >= aims.suspect)] = Status.SINGULAR
        now.status[now.steps >= aims.most] = Status.FULL
        now.status[now.t == t_end] = Status.REACHED
        stay = now.status < 0
        if not stay.all():
            now.leave(~stay, ends)
            if not stay.any():
                return ends
            now.keep(stay)
            series = series.kept(stay)
        expanded = series.expand(now.q, now.qd)
        W = expanded.rates
        own = series.relative(W)
        longest = series.longest(W, aims.rtol, aims.atol)
        if series.r:
            longest = np.minimum(longest, TURN / np.maximum(np.abs(now.qd).max(axis=0), SLOWEST))
        now.status[np.isnan(longest)] = Status.NOT_FINITE
        longest = np.nan_to_num(longest, nan=0.0)
        left = np.abs(t_end - now.t)
        h, q, qd, now.quality = _landed(series, expanded, own, now, longest, left, direction, aims)
        end = np.where(np.abs(h) >= left, t_end, now.t + h)
        now.status[(end == now.t) & (now.status < 0)] = Status.STUCK
        h = end - now.t
        if aims.extremes:
            low, high, rate_low, rate_high = extremes(own, h)
            now.widen(np.concatenate([now.q + low, rate_low]))
            now.widen(np.concatenate([now.q + high, rate_high]))
        if aims.link >= 0:
            (b,) = np.nonzero(np.isnan(now.flip))
            if len(b):
                begun = now.angle[b] + series.absolute(now.q[:, b])[aims.link]
                now.flip[b] = now.t[b] + crossings(begun, W[:, aims.link, b], h[b], math.pi)
        if expanded.power is not None:
            now.work = now.work + values(expanded.power[:, None], h)[0][0]
        now.t, now.q, now.qd, now.steps = end, q, qd, now.steps + 1
        now.weigh(*series.energies(q, qd))
        if aims.extremes:  # the states at the ends are closed, the series are so to the tolerance
            now.widen(np.concatenate([q, qd]))


@dataclass(slots=True)
class _Running:
    """The lanes under way, B of them, along the last axis of each array."""

    lanes: Integers
    t: Array
    q: Array  # (n, B)
    qd: Array
    quality: Array
    status: Integers  # -1: goes on
    steps: Integers
    angle: Array  # what the flipping link's angle is from hanging, less alpha
    flip: Array
    low: Array  # (2n, B)
    high: Array
    work: Array
    start: Array  # the energy there, J
    off: Array  # how far the energy less work was from that, J
    KE: Array  # the largest
    PE: Array  # (2, B) least and largest
    energy: Array  # (2, B)

    @classmethod
    def begin(
        cls, q: Array, qd: Array, quality: Array, angle: Array, KE: Array, PE: Array
    ) -> _Running:
        B = q.shape[1]
        state, energy = np.concatenate([q, qd]), KE + PE
        return cls(
            lanes=np.arange(B),
            t=np.zeros(B),
            q=q,
            qd=qd,
            quality=quality,
            status=np.full(B, -1),
            steps=np.zeros(B, np.int64),
            angle=angle,
            flip=np.full(B, math.nan),
            low=state,
            high=state.copy(),
            work=np.zeros(B),
            start=energy,
            off=np.zeros(B),
            KE=KE,
            PE=np.stack([PE, PE]),
            energy=np.stack([energy, energy]),
        )

    def widen(self, state: Array) -> None:
        """Take q and qd (2n, B) into the extremes."""
        np.fmin(self.low, state, out=self.low)
        np.fmax(self.high, state, out=self.high)

    def weigh(self, KE: Array, PE: Array) -> None:
        """Take energies (B,) into what is known of them."""
        energy = KE + PE
        self.off = np.fmax(self.off, np.abs(energy - self.work - self.start))
        self.KE = np.fmax(self.KE, KE)
        self.PE = np.stack([np.fmin(self.PE[0], PE), np.fmax(self.PE[1], PE)])
        self.energy = np.stack([np.fmin(self.energy[0], energy), np.fmax(self.energy[1], energy)])

    def leave(self, out: NDArray[np.bool_], ends: Ends) -> None:
        """Hand over the lanes that have ended."""
        gone = self.lanes[out]
        ends.t[gone], ends.status[gone], ends.steps[gone] = (
            x[out] for x in (self.t, self.status, self.steps)
        )
        ends.y[gone] = np.concatenate([self.q[:, out], self.qd[:, out]]).T
        ends.low[gone], ends.high[gone] = self.low[:, out].T, self.high[:, out].T
        ends.energy[gone], ends.flip[gone] = self.energy[:, out].T, self.flip[out]
        moving = np.maximum(self.KE, self.PE[1] - self.PE[0])[out]
        ends.drift[gone] = np.divide(self.off[out], moving, out=moving * 0.0, where=moving > 0.0)

    def keep(self, stay: NDArray[np.bool_]) -> None:
        """Go on with these lanes alone."""
        for name in _Running.__slots__:
            setattr(self, name, getattr(self, name)[..., stay])


def _landed(
    series: LaneMotion,
    expanded: Expanded,
    own: Array,
    now: _Running,
    longest: Array,
    left: Array,
    direction: float,
    aims: Aims,
) -> tuple[Array, Array, Array, Array]:
    """Steps h (B,), closed states there, and their qualities: where the next step starts well."""
    q, qd, t = now.q, now.qd, now.t
    if expanded.watched.shape[1]:
        longest = _held(series, expanded, own, now, np.minimum(longest, left), direction, aims)
    h = np.minimum(longest, left) * direction
    x = np.where(longest >= left, left * direction, (t + h) - t)  # the bound is met exactly
    new_q, new_qd, quality = _closed(series, own, q, qd, x)
    poor = ~(quality >= aims.suspect)
    for part in PARTS[1:]:
        if not poor.any():
            break
        (b,) = np.nonzero(poor)
        shorter = np.minimum(part * longest[b], left[b]) * direction
        there_q, there_qd, there = _closed(series.kept(b), own[:, :, b], q[:, b], qd[:, b], shorter)
        better = there > quality[b]
        to = b[better]
        x[to], quality[to] = shorter[better], there[better]
        new_q[:, to], new_qd[:, to] = there_q[:, better], there_qd[:, better]
        poor = ~(quality >= aims.suspect)
    return x, new_q, new_qd, quality


def _held(
    series: LaneMotion,
    expanded: Expanded,
    own: Array,
    now: _Running,
    h: Array,
    direction: float,
    aims: Aims,
) -> Array:
    """Steps (B,) halved until the torques at their ends are those of the series.

    And in their middles, where friction may turn over and back.  Zero where no step serves.
    """
    h = h.copy()
    (b,) = np.nonzero(h > 0.0)
    while len(b):
        some, part = series.kept(b), expanded.some(b)
        agrees = np.ones(len(b), bool)
        for where in (1.0, 0.5) if series.rubs else (1.0,):
            x = where * h[b] * direction
            turn, rate, _ = values(own[:, :, b], x)
            agrees &= some.agrees(part, x, now.q[:, b] + turn, rate, aims.rtol, aims.atol)
        b = b[~agrees]
        h[b] *= 0.5
        lost = h[b] < 4.0 * np.spacing(np.maximum(np.abs(now.t[b]), SMALLEST_TIME))
        h[b[lost]] = 0.0
        b = b[~lost]
    return h


def _closed(
    series: LaneMotion, own: Array, q: Array, qd: Array, x: Array
) -> tuple[Array, Array, Array]:
    """The closed states at x (B,) after q, qd, and their qualities."""
    turn, rate, _ = values(own, x)
    new_q, new_qd = q + turn, rate
    quality = series.close(new_q, new_qd)
    return new_q, new_qd, np.where(series.leaps(q, new_q), -1.0, quality)
