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

import numpy as np

from robodyn.dynamics import closed_form
from robodyn.loops import closures
from robodyn.loops.change_points import miss_remark
from robodyn.loops.closing import loop_size
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import matvec
from robodyn.runs.report import Report
from robodyn.runs.segments import Segment
from robodyn.runs.settings import EvenTimes
from robodyn.tables.arrays import Array

Torques = Callable[[float, Sequence[float]], Sequence[float]]
Sink = Callable[[Array, Array, Mechanism], None]  # rows t (k,), y (k, 2n or more)

SAMPLES = 1000  # of a run, at least
POINTS = 8  # of a Gauss-Legendre rule
SHORT = 1e-4  # of a run: in shorter steps the way may be what moves a joint onto its end
FEW = 100  # steps: more tell by their ends alone how fast the joints are on the way
LONG = 2  # samples that a step must span to be looked at: shorter ones are samples themselves
STEPS_AT_ONCE = 256  # accepted steps that the statistics take in one go
ROWS_AT_ONCE = 512
WORK_AT_ONCE = 1 << 22  # of n^3 a row: of large mechanisms fewer rows go at once
NO_TIMES: Array = np.zeros(0)


def joined(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Concatenate parts of times and states."""
    if len(parts) == 1:
        return parts[0]
    t, y = zip(*parts, strict=True)
    return np.concatenate(t), np.concatenate(y)


class Batches:
    """Collects states of a run, and passes `most` of them on together, or all of one mode."""

    _count = 0  # states that wait
    _moving: Mechanism | None = None  # the mode that moves in them

    def __init__(self, most: int) -> None:
        self._most = most
        self._waiting: list[tuple[Array, Array]] = []

    def add(self, t: Array, y: Array, moving: Mechanism) -> None:
        """Add states y (k, 2n or more) at times t (k,), with the mode that moves."""
        if moving is not self._moving:
            self.flush()
            self._moving = moving
        self._waiting.append((t, y))
        self._count += len(t)
        if self._count >= self._most:
            self.flush()

    def flush(self) -> None:
        """Pass on what waits."""
        if self._waiting and self._moving is not None:
            t, y = joined(self._waiting)
            self._waiting, self._count = [], 0
            self._pass(t, y, self._moving)

    def _pass(self, t: Array, y: Array, moving: Mechanism) -> None:
        raise NotImplementedError


class RunStatistics(Batches):
    """Computes the statistics of a run's report from its steps."""

    ranked: tuple[Mechanism, int] | None = None  # a mode, and the rank of its closures
    before: tuple[Array, ...] | None = None  # t (1,), q and qd (1, n) of the last step
    unseen, missed = 0.0, 0.0  # work that steps missed, and the largest of it, J
    last_singular: float | None = None

    def __init__(self, report: Report, actuation: Actuation, n: int, closes: bool) -> None:
        super().__init__(STEPS_AT_ONCE)
        self.report, self.actuation, self.closes = report, actuation, closes
        self._torques: Torques | None = None  # of which steps may miss work
        if actuation.constants is None and not actuation.linear and actuation.control is None:
            self._torques = actuation.function(n)

    @np.errstate(all="ignore")  # what leaves the floats is told by the outcome
    def _pass(self, t: Array, y: Array, moving: Mechanism) -> None:
        finite = np.isfinite(y).all(axis=1)
        t, y = t[finite], y[finite]
        if not len(t):
            return
        if self.actuation.control is not None:
            self.actuation.control.observe(t, y)
        report, n = self.report, moving.n
        q, qd = y[:, :n], y[:, n : 2 * n]
        KE, PE = closed_form.energies(moving, q, qd)
        if self.before is None:
            report.energy_start, self.before = float(KE[0] + PE[0]), (t[:1], q[:1], qd[:1])
        steps = [np.concatenate(x) for x in zip(self.before, (t, q, qd), strict=True)]
        self.before = t[-1:], q[-1:], qd[-1:]
        work = y[:, -1] if y.shape[1] > 2 * n + self.actuation.states else np.zeros(len(t))
        if self._torques is not None:
            unseen = missed_work(self._torques, abs(report.t_end) / SAMPLES, *steps)
            unseen = self.unseen + np.cumsum(unseen)
            self.unseen = float(unseen[-1])
            work, self.missed = work + unseen, max(self.missed, float(np.abs(unseen).max()))
        fastest = float(KE.max())
        if len(t) < FEW:  # they may all end at rest
            width, way = (np.diff(x, axis=0) for x in steps[:2])
            width[np.abs(width) <= SHORT * abs(report.t_end)] = np.inf
            mean = way / width[:, None]
            fastest = max(fastest, float(closed_form.energies(moving, q, mean)[0].max()))
        error = float(np.abs(KE + PE - work - report.energy_start).max())
        error = max(error, report.energy_drift * report.energy_in_motion)
        most = max(fastest, float(np.ptp(PE)), report.energy_in_motion)
        report.energy_in_motion = most
        report.energy_drift = error / most if most > 0.0 else 0.0
        report.work_missed = self.missed / most if most > 0.0 else 0.0
        report.work = float(work[-1])
        if self.closes:
            self._take_loops(moving, t, q, qd)

    def _take_loops(self, mechanism: Mechanism, t: Array, q: Array, qd: Array) -> None:
        report = self.report
        gap = closures.closure_gap(mechanism, q, t)
        report.largest_gap = max(report.largest_gap, float(np.abs(gap).max()))
        stride = 1 + mechanism.n * len(mechanism.rows) // 2000
        t, q, qd = t[::stride], q[::stride], qd[::stride]
        Psi = closures.scaled_jacobian(mechanism, q, t)
        rate = matvec(Psi, qd / mechanism.arrays.units)
        if mechanism.driven:
            rate = rate + closures.closure_drift(mechanism, q, t)
        report.largest_gap_rate = max(report.largest_gap_rate, float(np.abs(rate).max()))
        least = self.least_singular(mechanism, Psi)
        worst = int(np.argmin(least))
        self.last_singular = float(least[-1])
        if report.nearest_singular is None or least[worst] < report.nearest_singular:
            report.nearest_singular = float(least[worst])
            report.nearest_singular_time = float(t[worst])
            report.missed = miss_remark(mechanism, q[worst])

    def least_singular(self, mechanism: Mechanism, Psi: Array) -> Array:
        """Return the smallest nonzero singular value of Psi over loop size, (k,).

        Psi is (k, r, n).  Singular values beyond the rank of dependent closures are left out.
        """
        s = np.linalg.svd(Psi, compute_uv=False) / loop_size(mechanism)
        if self.ranked is None or self.ranked[0] is not mechanism:
            some = s[:: max(1, len(s) // 8)]
            self.ranked = mechanism, max(1, int((some > 1e-9).sum(axis=-1).max()))
        return np.asarray(s[:, self.ranked[1] - 1])


def missed_work(torques: Torques, apart: float, t: Array, q: Array, qd: Array) -> Array:
    """Return the work (k,) that steps between states q, qd (k + 1, n) at t (k + 1,) missed, J.

    Of a step longer than two samples, `apart` (s) each, it is the work by many samples less that by
    a single rule.
    """
    missed = np.zeros(len(t) - 1)
    u, weights = np.polynomial.legendre.leggauss(POINTS)
    u, weights = 0.5 * (u + 1.0), 0.5 * weights
    for k in np.flatnonzero(np.abs(np.diff(t)) > LONG * apart).tolist():
        (q0, q1), (qd0, qd1), h = q[k : k + 2], qd[k : k + 2], float(t[k + 1] - t[k])
        panels = max(2, int(abs(h) / (POINTS * apart)) + 1)
        part = ((np.arange(panels)[:, None] + u) / panels).ravel()
        x = np.concatenate([u, part])[:, None]
        rise, bend = (q1 - q0) / h, x * (1.0 - x)
        states = q0 + h * (x * rise + bend * ((1.0 - x) * (qd0 - rise) - x * (qd1 - rise)))
        rates = qd0 + x * (qd1 - qd0) + 6.0 * bend * (rise - 0.5 * (qd0 + qd1))
        times, y = t[k] + h * x[:, 0], np.concatenate([states, rates], axis=1)
        try:
            at = zip(times.tolist(), y.tolist(), strict=True)
            power = (np.array([torques(*each) for each in at]) * rates).sum(axis=1)
        except (ArithmeticError, ValueError):  # beside the motion the torque may be undefined
            continue
        close = weights @ power[POINTS:].reshape(panels, POINTS).sum(axis=0) / panels
        work = h * (close - weights @ power[:POINTS])
        missed[k] = work if np.isfinite(work) else 0.0
    return missed


class Rows(Batches):
    """Passes the rows of a run to a sink, at given times or at the accepted steps.

    Rows have the first `width` numbers of states of n joints.  `look` is called with the time of
    each batch.
    """

    next = 0  # of the times

    def __init__(
        self,
        sink: Sink,
        times: Array | EvenTimes | None,
        n: int,
        width: int,
        look: Callable[[float], None],
    ) -> None:
        super().__init__(max(1, min(ROWS_AT_ONCE, WORK_AT_ONCE // n**3)))
        self.sink, self.times, self.width, self.look = sink, times, width, look

    def begin(self, moving: Mechanism, y: Array) -> None:
        """Start at t = 0 in state y (N,)."""
        if self.times is None or (len(self.times) and self.times[0] == 0.0):
            self.add(np.zeros(1), y[None, :], moving)
            self.next = 1

    def due(self, bound: float) -> Array:
        """Return the next output times up to `bound`, at most one batch of them."""
        if self.times is None or self.next == len(self.times):
            return NO_TIMES
        sign = -1.0 if self.times[-1] < 0.0 else 1.0
        last = min(len(self.times), self.next + self._most)
        end = bisect_right(self.times, bound * sign, self.next, last, key=lambda t: t * sign)
        return self.times[self.next : end]

    def take(self, moving: Mechanism, segment: Segment) -> None:
        """Collect the rows along a segment; `moving` is the mode of the segment."""
        if self.times is None:
            first = 2 if len(segment) and segment.t[0] == segment.t[1] else 1  # it takes no time
            if len(segment.t) > first:
                self.add(segment.t[first:], segment.y[first:], moving)
            return
        if segment.rows is not None and len(segment.rows[0]):
            self.next += len(segment.rows[0])
            self.add(*segment.rows, moving)
        while len(due := self.due(segment.end)):
            self.next += len(due)
            self.add(due, segment.states(due), moving)
            if due[-1] != segment.end:
                self.look(float(due[-1]))

    def end(self, moving: Mechanism, t: float, y: Array) -> None:
        """Add the row at which the run was stopped, state y (N,) at t."""
        if self.times is not None and (not self.next or self.times[self.next - 1] != t):
            self.add(np.array([t]), y[None], moving)

    def _pass(self, t: Array, y: Array, moving: Mechanism) -> None:
        self.sink(t, y[:, : self.width], moving)
