"""Readers of the segments of a run: its rows, as they come, and its statistics.

Rows and steps are collected in batches, so that numpy works on many at once and memory does not
grow with the length of a run.

The energy balance also counts work that a torque does between steps unseen.  Along each long step
the torque is sampled on the cubic polynomials through the ends of the step.  Its work is integrated
twice: by one 8-point Gauss-Legendre rule over the step, and by many shorter ones.  The difference
is the missed work; it vanishes for smooth torques.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from robodyn.dynamics import closed_form
from robodyn.dynamics.placed import matvec
from robodyn.loops.change_points import miss_remark
from robodyn.loops.closing import loop_size
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.report import Report
from robodyn.runs.segments import Segment
from robodyn.runs.settings import EvenTimes
from robodyn.tables.arrays import Array

Torques = Callable[[float, Sequence[float]], Sequence[float]]

SAMPLES = 1000  # of a run, at least
POINTS = 8  # of a Gauss-Legendre rule
SHORT = 1e-4  # of a run: in shorter steps the way may be what moves a joint onto its end
FEW = 100  # steps: more tell by their ends alone how fast the joints are on the way
LONG = 2  # samples that a step must span to be looked at: shorter ones are samples themselves


class RunStatistics:
    """Computes the statistics of a run's report from its steps, in batches."""

    def __init__(self, report: Report, actuation: Actuation, n: int, closes: bool) -> None:
        self.report, self.actuation, self.closes = report, actuation, closes
        self.mechanism: Mechanism | None = None  # of the steps before
        self.rank = 0  # of its closures, where it is known
        self.last: tuple[Array, Array] | None = None  # t (1,) and q (1, n) of the last step
        self.missed = 0.0  # J
        self.last_singular: float | None = None
        self._waiting: list[tuple[Array, Array]] = []  # steps of it that wait
        self._count = 0
        self.unseen: UnseenWork | None = None
        if actuation.constants is None and not actuation.linear and actuation.control is None:
            self.unseen = UnseenWork(actuation.function(n), report.t_end)

    def take(self, mechanism: Mechanism, t: Array, y: Array) -> None:
        """Collect steps that end in states y (k, 2n or more) at times t (k,).

        `mechanism` is the mechanism, or its mode, that moves in these steps.
        """
        if mechanism is not self.mechanism:
            self.flush()
            self.mechanism, self.rank = mechanism, 0
        self._waiting.append((t, y))
        self._count += len(t)
        if self._count >= STEPS_AT_ONCE:
            self.flush()

    def flush(self) -> None:
        """Compute the statistics of the collected steps."""
        if self._waiting and self.mechanism is not None:
            t, y = joined(self._waiting)
            self._waiting, self._count = [], 0
            self._take(self.mechanism, t, y)

    @np.errstate(all="ignore")  # what leaves the floats is told by the outcome
    def _take(self, mechanism: Mechanism, t: Array, y: Array) -> None:
        finite = np.isfinite(y).all(axis=1)
        t, y = t[finite], y[finite]
        if not len(t):
            return
        if self.actuation.control is not None:
            self.actuation.control.observe(t, y)
        report, n = self.report, mechanism.n
        q, qd = y[:, :n], y[:, n : 2 * n]
        KE, PE = closed_form.energies(mechanism, q, qd)
        work = y[:, -1] if y.shape[1] > 2 * n + self.actuation.states else np.zeros(len(t))
        if self.unseen is not None:
            unseen = self.unseen(t, q, qd)
            work, self.missed = work + unseen, max(self.missed, float(np.abs(unseen).max()))
        if self.last is None:
            report.energy_start, self.last = float(KE[0] + PE[0]), (t[:1], q[:1])
        fastest = float(KE.max())
        if len(t) < FEW:  # they may all end at rest
            width = t - np.concatenate([self.last[0], t[:-1]])
            way = q - np.concatenate([self.last[1], q[:-1]])
            width[np.abs(width) <= SHORT * abs(report.t_end)] = np.inf
            mean = way / width[:, None]
            fastest = max(fastest, float(closed_form.energies(mechanism, q, mean)[0].max()))
        self.last = t[-1:], q[-1:]
        error = float(np.abs(KE + PE - work - report.energy_start).max())
        before = report.energy_drift * report.energy_in_motion
        moving = max(fastest, float(np.ptp(PE)), report.energy_in_motion)
        report.energy_in_motion = moving
        report.energy_drift = max(error, before) / moving if moving > 0.0 else 0.0
        report.work_missed = self.missed / moving if moving > 0.0 else 0.0
        report.work = float(work[-1])
        if self.closes:
            self._take_loops(mechanism, t, q, qd)

    def _take_loops(self, mechanism: Mechanism, t: Array, q: Array, qd: Array) -> None:
        report = self.report
        gap = closed_form.closure_gap(mechanism, q, t)
        report.largest_gap = max(report.largest_gap, float(np.abs(gap).max()))
        stride = 1 + mechanism.n * len(mechanism.rows) // 2000
        Psi = closed_form.scaled_jacobian(mechanism, q[::stride], t[::stride])
        rate = matvec(Psi, qd[::stride] / mechanism.arrays.units)
        if mechanism.driven:
            rate = rate + closed_form.closure_drift(mechanism, q[::stride], t[::stride])
        report.largest_gap_rate = max(report.largest_gap_rate, float(np.abs(rate).max()))
        least = self.least_singular(mechanism, Psi)
        worst = int(np.argmin(least))
        self.last_singular = float(least[-1])
        if report.nearest_singular is None or least[worst] < report.nearest_singular:
            report.nearest_singular = float(least[worst])
            report.nearest_singular_time = float(t[::stride][worst])
            report.missed = miss_remark(mechanism, q[::stride][worst])

    def least_singular(self, mechanism: Mechanism, Psi: Array) -> Array:
        """Return the smallest nonzero singular value of Psi over loop size, (k,).

        Psi is (k, r, n).  Singular values beyond the rank of dependent closures are left out.
        """
        size = loop_size(mechanism)
        if not self.rank:  # of closures that depend on one another not all count
            s = np.linalg.svd(Psi[:: max(1, len(Psi) // 8)], compute_uv=False)
            self.rank = max(1, int((s > 1e-9 * size).sum(axis=-1).max()))
        s = np.linalg.svd(Psi, compute_uv=False)
        return np.asarray(s[:, self.rank - 1] / size)


class UnseenWork:
    """Sums the work (J) of torques that the steps of a run have missed."""

    def __init__(self, torques: Torques, t_end: float) -> None:
        self._torques, self._apart = torques, abs(t_end) / SAMPLES
        self._before: tuple[Array, Array, Array] | None = None
        self._sum = 0.0

    def __call__(self, t: Array, q: Array, qd: Array) -> Array:
        """Return the work missed from the start up to times t (k,); q, qd are (k, n)."""
        if self._before is not None:
            t, q, qd = (
                np.concatenate([a, b]) for a, b in zip(self._before, (t, q, qd), strict=True)
            )
        missed = [
            self._missed(t[k : k + 2], q[k : k + 2], qd[k : k + 2]) for k in range(len(t) - 1)
        ]
        sums = self._sum + np.concatenate([[0.0], np.cumsum(missed)])
        result = sums if self._before is None else sums[1:]
        self._before, self._sum = (t[-1:], q[-1:], qd[-1:]), float(sums[-1])
        return np.asarray(result)

    def _missed(self, t: Array, q: Array, qd: Array) -> float:
        """Return the work over one step by many samples, less that by a single rule (J)."""
        h = float(t[1] - t[0])
        if not abs(h) > LONG * self._apart:
            return 0.0
        panels = max(2, int(abs(h) / (POINTS * self._apart)) + 1)
        u, weights = np.polynomial.legendre.leggauss(POINTS)
        u, weights = 0.5 * (u + 1.0), 0.5 * weights
        part = ((np.arange(panels)[:, None] + u) / panels).ravel()
        x = np.concatenate([u, part])[:, None]
        rise = (q[1] - q[0]) / h
        bend = x * (1.0 - x)
        states = q[0] + h * (x * rise + bend * ((1.0 - x) * (qd[0] - rise) - x * (qd[1] - rise)))
        rates = qd[0] + x * (qd[1] - qd[0]) + 6.0 * bend * (rise - 0.5 * (qd[0] + qd[1]))
        times = t[0] + h * x[:, 0]
        y = np.concatenate([states, rates], axis=1)
        try:
            torques = [
                self._torques(*each) for each in zip(times.tolist(), y.tolist(), strict=True)
            ]
        except (ArithmeticError, ValueError):  # beside the motion the torque may be undefined
            return 0.0
        power = (np.array(torques) * rates).sum(axis=1)
        close = weights @ power[POINTS:].reshape(panels, POINTS).sum(axis=0) / panels
        missed = float(h * (close - weights @ power[:POINTS]))
        return missed if np.isfinite(missed) else 0.0


Sink = Callable[[Array, Array, Mechanism], None]  # rows t (k,), y (k, 2n or more)

STEPS_AT_ONCE = 256  # accepted steps that the statistics take in one go
ROWS_AT_ONCE = 512
WORK_AT_ONCE = 1 << 22  # of n^3 a row: of large mechanisms fewer rows go at once


def joined(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Concatenate parts of times and states."""
    if len(parts) == 1:
        return parts[0]
    t, y = zip(*parts, strict=True)
    return np.concatenate(t), np.concatenate(y)


@cache
def rows_at_once(n: int) -> int:
    """Return how many rows of n joints are passed to a sink together."""
    return max(1, min(ROWS_AT_ONCE, WORK_AT_ONCE // n**3))


class Rows:
    """Passes the rows of a run to a sink, at given times or at the accepted steps.

    Rows have the first `width` numbers of states.  `look` is called with the time of each batch.
    """

    def __init__(
        self, sink: Sink, times: Array | EvenTimes | None, width: int, look: Callable[[float], None]
    ) -> None:
        self.sink, self.times, self.width, self.look = sink, times, width, look
        self.next = 0  # of the times
        self.last: float | None = None  # time of a row
        self._waiting: list[tuple[Array, Array]] = []
        self._count = 0
        self._moving: Mechanism | None = None

    def begin(self, moving: Mechanism, y: Array) -> None:
        """Start at t = 0 in state y (N,)."""
        self._moving = moving
        if self.times is None or (len(self.times) and self.times[0] == 0.0):
            self._row(np.zeros(1), y[None, :])
            self.next = 1

    def due(self, bound: float) -> Array:
        """Return the next output times up to `bound`, at most one batch of them."""
        if self.times is None or self.next == len(self.times):
            return np.zeros(0)
        sign = -1.0 if self.times[-1] < 0.0 else 1.0
        last = min(len(self.times), self.next + self._most)
        end = bisect_right(self.times, bound * sign, self.next, last, key=lambda t: t * sign)
        return self.times[self.next : end]

    def take(self, moving: Mechanism, segment: Segment) -> None:
        """Collect the rows along a segment; `moving` is the mode of the segment."""
        self.turn(moving)
        if self.times is None:
            t, y = segment.t[1:], segment.y[1:]
            first = int(len(t) > 0 and t[0] == self.last)  # a leg that takes no time
            if len(t) > first:
                self._row(t[first:], y[first:])
            return
        if segment.rows is not None and len(segment.rows[0]):
            self.next += len(segment.rows[0])
            self._row(*segment.rows)
        while len(due := self.due(segment.end)):
            self.next += len(due)
            self._row(due, segment.states(due))
            if due[-1] != segment.end:
                self.look(float(due[-1]))

    def turn(self, moving: Mechanism) -> None:
        """Pass waiting rows on before the motion enters another mode."""
        if moving is not self._moving:
            self.flush()
            self._moving = moving

    def end(self, t: float, y: Array) -> None:
        """Add the row at which the run was stopped, state y (N,) at t."""
        if self.last != t:
            self._row(np.array([t]), y[None])

    @property
    def _most(self) -> int:
        assert self._moving is not None
        return rows_at_once(self._moving.n)

    def _row(self, t: Array, y: Array) -> None:
        self._waiting.append((t, y))
        self.last = float(t[-1])
        self._count += len(t)
        if self._count >= self._most:
            self.flush()

    def flush(self) -> None:
        """Pass the waiting rows to the sink."""
        if self._waiting:
            assert self._moving is not None
            t, y = joined(self._waiting)
            self._waiting, self._count = [], 0
            self.sink(t, y[:, : self.width], self._moving)
