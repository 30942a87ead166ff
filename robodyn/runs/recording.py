"""What a simulation leaves behind: its outcome, its statistics, and its rows as they come.

The recorder sees every accepted step; rows and steps are taken in batches, so that numpy works on
many at once and memory does not grow with the length of a run.

The work of a torque that the steps may have passed over counts too.  Along each long step the
torque is sampled, on the cubics that meet the step's ends, and its work taken twice: at the eight
times of a Gauss-Legendre rule, as a step of its length sees it, and at many more.  Where the torque
is smooth the two agree; their difference is work that was missed.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from robodyn.dynamics import closed_form
from robodyn.dynamics.placed import matvec
from robodyn.loops.change_points import miss_remark
from robodyn.loops.closing import loop_size
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.report import Outcome, Report, StopRun
from robodyn.runs.segments import KeptStep, solver_segment
from robodyn.runs.settings import EvenTimes
from robodyn.runs.taylor_engine import Chunk
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from scipy.integrate import OdeSolver

    from robodyn.runs.event_functions import EventFunction
    from robodyn.runs.watch import Cut, Event, EventWatch

Torques = Callable[[float, Sequence[float]], Sequence[float]]

SAMPLES = 1000  # of a run, at least
POINTS = 8  # of a Gauss-Legendre rule
SHORT = 1e-4  # of a run: in shorter steps the way may be what moves a joint onto its end
FEW = 100  # steps: more tell by their ends alone how fast the joints are on the way
LONG = 2  # samples that a step must span to be looked at: shorter ones are samples themselves


class RunStatistics:
    """Takes steps in batches, and keeps the report's statistics."""

    def __init__(self, report: Report, actuation: Actuation, n: int, closes: bool) -> None:
        self.report, self.actuation, self.closes = report, actuation, closes
        self.mechanism: Mechanism | None = None  # of the steps before
        self.rank = 0  # of its closures, where it is known
        self.last: tuple[Array, Array] | None = None  # t (1,) and q (1, n) of the last step
        self.missed = 0.0  # J
        self.last_singular: float | None = None
        self.unseen: UnseenWork | None = None
        if actuation.constants is None and not actuation.linear and actuation.control is None:
            self.unseen = UnseenWork(actuation.function(n), report.t_end)

    @np.errstate(all="ignore")  # what leaves the floats is told by the outcome
    def take(self, mechanism: Mechanism, t: Array, y: Array) -> None:
        """Steps to the states y (k, 2n or more) at times t (k,), of what moves there."""
        if mechanism is not self.mechanism:
            self.mechanism, self.rank = mechanism, 0
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
        """The least singular values (k,) of Psi (k, r, n), of those that can be other than 0."""
        size = loop_size(mechanism)
        if not self.rank:  # of closures that depend on one another not all count
            s = np.linalg.svd(Psi[:: max(1, len(Psi) // 8)], compute_uv=False)
            self.rank = max(1, int((s > 1e-9 * size).sum(axis=-1).max()))
        s = np.linalg.svd(Psi, compute_uv=False)
        return np.asarray(s[:, self.rank - 1] / size)


class UnseenWork:
    """Sums up what the steps of a run have missed, J."""

    def __init__(self, torques: Torques, t_end: float) -> None:
        self._torques, self._apart = torques, abs(t_end) / SAMPLES
        self._before: tuple[Array, Array, Array] | None = None
        self._sum = 0.0

    def __call__(self, t: Array, q: Array, qd: Array) -> Array:
        """What was missed from the start until each of the times t (k,), in states q, qd (k, n)."""
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
        """The work over one step, closely sampled, less that by one rule."""
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
KEPT, MOST_KEPT = 512, 192  # joints of steps, and steps, looked at together for events
KEPT_AT_FIRST = 8  # steps, where an event ends the run: those beyond the end are lost
MOST_STEPS = 1e13  # that take months
FAR_END = 1e9  # s; where the end is nearer it is a force that makes the steps too short
NEVER = 1e4  # times the steps that a run may take: even if they grew as much it would not end
WORK_AT_ONCE = 1 << 22  # of n^3 a row: of large mechanisms fewer rows go at once


def joined(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Times and states one after another."""
    if len(parts) == 1:
        return parts[0]
    t, y = zip(*parts, strict=True)
    return np.concatenate(t), np.concatenate(y)


@cache
def rows_at_once(n: int) -> int:
    """How many rows of n joints are handed on together."""
    return max(1, min(ROWS_AT_ONCE, WORK_AT_ONCE // n**3))


@dataclass(eq=False, repr=False)
class Recorder:
    """Sees every accepted step: makes the rows, keeps the statistics."""

    mechanism: Mechanism
    report: Report
    sink: Sink
    times: Array | EvenTimes | None
    max_evaluations: int
    watch: Callable[[float], bool] | None
    actuation: Actuation
    statistics: RunStatistics
    next_row: int = 0
    rows: list[tuple[Array, Array]] = field(default_factory=list)
    waiting: int = 0
    steps: list[tuple[Array, Array]] = field(default_factory=list)
    held: int = 0  # steps not yet in the statistics
    longest: float = 0.0  # of the steps in the statistics, s
    last: tuple[float, Array] | None = None  # t and y of the last step
    ended: int = 0  # evaluations of solvers that have ended, and expansions of series
    events: EventWatch | None = None
    stopped: Cut | None = None  # by what event
    last_row: float | None = None  # its time
    contacts: list[Event] = field(default_factory=list)  # what joints met, and left
    kept: list[KeptStep] = field(default_factory=list)  # not yet looked at for events

    def begin(self, y: Array) -> None:
        zero = np.zeros(1)
        if self.times is None or (len(self.times) and self.times[0] == 0.0):
            self._row(zero, y[None, :])
            self.next_row = 1
        self.steps.append((zero, y[None, :]))

    def step(self, solver: OdeSolver) -> None:
        """Take a step of a solver, or keep it, to be looked at for events with others."""
        if self.events is None:
            between = cache(solver.dense_output)  # made where a row asks for it
            self._step(solver, solver.y.copy(), lambda times: between()(times).T)
            return
        self.kept.append(KeptStep(solver))
        most = max(1, min(MOST_KEPT, KEPT // self.mechanism.n))
        if self.events.stops:
            most = min(most, max(KEPT_AT_FIRST, self.report.steps))
        if self.actuation.told is not None or len(self.events.watched) > len(self.events.functions):
            most = 1  # what goes on with the run, or a phase of it that may end
        if len(self.kept) >= most or solver.status != "running":
            self.catch_up()

    def catch_up(self) -> None:
        """Take the steps that were kept to be looked at together for events."""
        steps, self.kept = self.kept, []
        if not steps:
            return
        assert self.events is not None
        segment = solver_segment(steps)
        cut, forward = self.events.look(segment), segment.forward
        for step in steps:
            if cut is not None and cut.t * forward <= step.t * forward:
                self._step(step, cut.y, segment.at, cut)
                self.stop(cut)
            self._step(step, step.y, segment.at)

    def _step(
        self, solver: Any, y: Array, states: Callable[[Array], Array], stop: Cut | None = None
    ) -> None:
        """Take a step to the state y, of `states` within, or up to what stops the run."""
        t = float(solver.t) if stop is None else stop.t
        self.report.steps += 1
        self.report.evaluations = self.ended + solver.nfev
        running = solver.status == "running"
        self._take(np.array([t]), y[None], states, running, stop)

    def stop(self, stop: Cut) -> NoReturn:
        """End the run, or the phase, at an event."""
        self.stopped = stop
        if self.guard is None:
            self.end_row()
        raise StopRun(Outcome.EVENT)

    def end_row(self) -> None:
        """A row where the run was stopped."""
        if self.stopped is not None and self.last_row != self.stopped.t:
            self._row(np.array([self.stopped.t]), self.stopped.y[None])

    @property
    def guard(self) -> int | None:
        """The place of the guard that ended the phase; None: something else ended the run."""
        if self.stopped is None or self.events is None:
            return None
        place = self.stopped.place - len(self.events.functions)
        return place if place >= 0 else None

    def begin_phase(self, moving: Mechanism, guards: Sequence[EventFunction]) -> None:
        """The motion goes on in another mode, which lasts as long as the guards are positive."""
        if moving is not self.mechanism:
            self.flush_rows()
            self.flush_steps()
            self.mechanism = moving
        self.stopped = None
        assert self.events is not None
        if self.events.columns is not None:
            self.events.columns.enter(moving)
        self.events.guard(guards)

    def end_solver(self, solver: OdeSolver) -> None:
        """Count what a solver did that another one follows."""
        try:
            self.catch_up()
        finally:
            self.ended += solver.nfev

    def times_until(self, bound: float) -> Array:
        """The output times still to come, up to `bound`; of many the first."""
        if self.times is None or self.next_row == len(self.times):
            return np.zeros(0)
        sign = -1.0 if self.times[-1] < 0.0 else 1.0
        last = min(len(self.times), self.next_row + rows_at_once(self.mechanism.n))
        end = bisect_right(self.times, bound * sign, self.next_row, last, key=lambda t: t * sign)
        return self.times[self.next_row : end]

    def chunk(self, chunk: Chunk, t_end: float, within: Callable[[Array], Array]) -> None:
        """Take steps of the Taylor integrator; `within` gives the states (k, N) at times (k,).

        It does so for the times of the last step that the chunk has no rows for.
        """
        count = len(chunk.t)
        self.ended += count
        self.report.evaluations = self.ended
        self.report.steps += count
        if not count:
            return
        if self.times is not None and len(chunk.row_t):
            self.next_row += len(chunk.row_t)
            self._row(chunk.row_t, chunk.row_y)
        self._take(chunk.t, chunk.y, within, chunk.t[-1] != t_end)

    def _due(self, t: float, y: Array, states: Callable[[Array], Array]) -> None:
        """The rows still to come up to t, where the state is y; `states` gives those before."""
        while len(due := self.times_until(t)):
            rows = y[None] if due[0] == t else states(due)
            if due[-1] == t:
                rows[-1] = y
            self.next_row += len(due)
            self._row(due, rows)
            if due[-1] != t:
                self._look(float(due[-1]))

    def _look(self, t: float) -> None:
        """The run is at t: end it there where that is wanted."""
        self.report.t_reached = t
        if self.watch is not None and self.watch(t):
            raise StopRun(Outcome.INTERRUPTED)

    def _take(
        self,
        times: Array,
        y: Array,
        states: Callable[[Array], Array],
        running: bool,
        stop: Cut | None = None,
    ) -> None:
        """Steps to `times` (k,); `states` gives those within the last one."""
        t = float(times[-1])
        if self.times is not None:
            self._due(t, y[-1], states)
        elif t != self.last_row:
            self._row(times, y)
        self.steps.append((times, y))
        self.last = t, y[-1]
        self.held += len(times)
        if stop is not None:
            self.stopped = stop
            running = self.guard is not None
        self.report.t_reached = t
        if self.held >= STEPS_AT_ONCE:
            outcome = self._endless() if running else None
            self.flush_steps()
            if outcome is not None:
                raise StopRun(outcome)
        if self.report.evaluations > self.max_evaluations and running:
            raise StopRun(Outcome.TOO_MANY_EVALUATIONS)
        self._look(t)

    def _endless(self) -> Outcome | None:
        """How a run ends that by much longer steps would not; steps that grow may do so."""
        t = np.concatenate([t for t, _ in self.steps])
        early, late = (float(x.max()) for x in np.array_split(np.abs(np.diff(t)), 2))
        before = max(self.longest, early)
        self.longest = max(before, late)
        left = abs(self.report.t_end - float(t[-1]))
        most = max(MOST_STEPS, NEVER * self.max_evaluations)
        most = min(most, 1.0 / np.finfo(float).eps)  # floats tell no more apart
        if abs(self.report.t_end) <= FAR_END:
            return Outcome.STEP_TOO_SMALL if left > most * late and late <= 2.0 * early else None
        return Outcome.ENDLESS if left > most * self.longest <= 2.0 * most * before else None

    def settle(self) -> Report:
        """The report, with the statistics of all steps."""
        self.flush_steps()
        if self.actuation.control is not None:
            self.report.tracking = self.actuation.control.tracking()
        if self.events is not None:
            self.report.events = self.events.counts(self.contacts)
            self.report.remarks = self.events.remarks()
            if self.stopped is not None and self.guard is None:
                self.report.ended_by = self.events.functions[self.stopped.place].name
        return self.report

    def _row(self, t: Array, y: Array) -> None:
        self.rows.append((t, y))
        self.last_row = float(t[-1]) if len(t) else self.last_row
        self.waiting += len(t)
        if self.waiting >= rows_at_once(self.mechanism.n):
            self.flush_rows()

    def flush_rows(self) -> None:
        """Hand the waiting rows on."""
        if self.rows:
            t, y = joined(self.rows)
            self.rows, self.waiting = [], 0
            self.sink(t, y[:, : 2 * self.mechanism.n + self.actuation.states], self.mechanism)

    def flush_steps(self) -> None:
        """Take the waiting steps into the statistics."""
        if not self.steps:
            return
        t, y = joined(self.steps)
        self.steps, self.held = [], 0
        self.statistics.take(self.mechanism, t, y)
