"""A run: legs one after another, each a smooth motion in one mode, and their segments.

Steps come from one of scipy's solvers, made to project after every step (`solvers.py`), or from the
Taylor series (`series_steps.py`), which needs no scipy.  What is told of a run reads its segments:
events and the guards of modes, which cut them (`watch.py`), rows and statistics (`readers.py`).
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Generator, Iterator
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robodyn.dynamics import dense_dynamics
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.dynamics.friction_rounds import NotSettledError
from robodyn.engines.coupling_laws import check_laws
from robodyn.engines.row_values import near_table_end, rows_of
from robodyn.errors import LawError, RobodynError, SingularError
from robodyn.loops import loop_rates
from robodyn.loops.projection import Projection, best_closing
from robodyn.mechanics import parts
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode
from robodyn.runs.legs import Leg, System
from robodyn.runs.motion_columns import (
    TOO_FAST,
    applied_torques,
    check_span,
    check_start,
    no_hold,
)
from robodyn.runs.phases import Phases
from robodyn.runs.readers import NO_TIMES, STEPS_AT_ONCE, Rows, RunStatistics, Sink
from robodyn.runs.report import InterruptedRun, Outcome, Report
from robodyn.runs.right_hand_side import RightHandSide
from robodyn.runs.segments import Segment
from robodyn.runs.series_engine import check_served
from robodyn.runs.series_steps import SeriesSteps
from robodyn.runs.settings import EvenTimes, Settings, check_run
from robodyn.runs.torques_over_time import over_run
from robodyn.runs.watch import Event, EventWatch, Passing
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.runs.solvers import SolverSteps

NEARLY_SINGULAR = 1e-4  # least singular value of Psi, relative, that explains a step too small
BEYOND = 1e-9  # s, or of the time: a state so near the end of a run is why it ended
MOST_AT_ONCE = 100  # legs in a row that take no time, after which none will
MOST_STEPS = 1e13  # that take months
FAR_END = 1e9  # s; where the end is nearer it is a force that makes the steps too short
NEVER = 1e4  # times the steps that a run may take: even if they grew as much it would not end

LED = "a law of the time leads the joint there, and no stop throws it back"

Due = Callable[[float], Array]  # of a time: output times still to come up to it


def _nothing_due(bound: float) -> Array:
    return NO_TIMES


class Run:
    """A motion from `state` (2n,) at t = 0 to t_end, as segments, with its report.

    A state y is (q, qd), followed by the states that torques have of their own, and by the work
    done if anything does work.  `events` finds events and may end the run.  Raises RobodynError if
    no motion is defined at the start.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        state: Array,
        t_end: float,
        actuation: Actuation,
        settings: Settings,
        events: EventWatch | None = None,
    ) -> None:
        actuation = over_run(mechanism, actuation, state, t_end, settings.atol)
        report = Report(method=settings.method, rtol=settings.rtol, atol=settings.atol, t_end=t_end)
        if not actuation.resolved:
            report.hint = TOO_FAST
            warnings.warn(TOO_FAST, RobodynWarning, stacklevel=3)
        report.stabilize = settings.stabilize if mechanism.rows else "none"
        self.mechanism, self.actuation, self.settings = mechanism, actuation, settings
        self.t_end, self.report, self.outcome = t_end, report, Outcome.FINISHED
        work = actuation.active or mechanism.changes_energy or mechanism.switches
        self.work = bool(work or mechanism.driven)
        self.t, self.y = 0.0, self._start(state)
        self.events, self.phases = events, None
        if mechanism.switches:
            self.events = events or EventWatch([], t_end, width=2 * mechanism.n)
            self.phases = Phases(mechanism, actuation, self.y, t_end, settings.atol)
            self.y = self.phases.y
        self._systems: dict[Mechanism, System] = {}  # by what moves
        self._recent = NO_TIMES  # times of steps not yet looked at for an end
        self._longest = 0.0  # of the steps before them, s
        self._check_start()

    def _start(self, state: Array) -> Array:
        """Return y at the start, projected onto the closures; start torques that have a memory."""
        mechanism, n = self.mechanism, self.mechanism.n
        y = np.array([*state.tolist(), *[0.0] * (self.actuation.states + self.work)])
        check_laws(mechanism, y[:n], y[n : 2 * n], 0.0)
        if self.t_end != 0.0 and mechanism.rows:
            loop_rates.check_way_on(mechanism, y[None, :n], y[None, n : 2 * n])
        if self.report.stabilize == "projection":
            y = Projection(mechanism, best_closing(mechanism))(0.0, y)
        if self.actuation.listener is not None:
            self.actuation.listener.begin(y.tolist(), float(self.t_end))
        if mechanism.signals:
            rows_of(parts.acting, mechanism).check_signals(y[:n], y[n : 2 * n])
        return y

    def _check_start(self) -> None:
        """Raise RobodynError if the acceleration at the start is undefined or not served."""
        mechanism, y, n = self.moving, self.y, self.mechanism.n
        if self.settings.method == "taylor":
            self.report.evaluator = "compiled"
            if mechanism.parted or not dense_dynamics.elimination_is_safe(mechanism):
                with np.errstate(all="ignore"):
                    dense_dynamics.forward(mechanism, y[:n], y[n : 2 * n], np.zeros(n))
            check_served(self.mechanism, self.actuation)
            return
        with np.errstate(all="ignore"):  # rates that leave the floats end the run
            side = self._system(mechanism).side
            self.report.evaluator = side.kind
            if not np.isfinite(side.rates(0.0, y)).all():
                check_start(mechanism, self.actuation, 0.0, y)
                if side.refused is not None:
                    raise side.refused[1]
                limit = "the acceleration is not finite there"
                raise RobodynError("cannot start", where=mechanism.source, limit=limit)

    @property
    def moving(self) -> Mechanism:
        """What moves now: the mechanism, or one of its modes."""
        return self.mechanism if self.phases is None else self.phases.moving

    def _system(self, mechanism: Mechanism) -> System:
        """Return the equations of motion of a mode, made once per run."""
        if mechanism not in self._systems:
            self._systems[mechanism] = System(mechanism, self.actuation, self.settings, self.work)
        return self._systems[mechanism]

    def _steps(self, system: System, due: Due, keeps: bool) -> SeriesSteps | SolverSteps:
        """Return a stepper for a leg that begins at the current state."""
        events = self.events
        ends = events is not None and events.may_end
        leg = Leg(system, self.t, self.y, self.t_end, keeps or events is not None, ends)
        if self.settings.method == "taylor":
            return SeriesSteps(leg, due)
        from robodyn.runs.solvers import SolverSteps

        return SolverSteps(leg)

    # -- legs and segments -------------------------------------------------------------------------

    def segments(self, due: Due = _nothing_due, keeps: bool = False) -> Iterator[Segment]:
        """Yield the segments of the run; `moving` is the mode of the current segment.

        `due` returns the output times up to a bound.  A stepper that can do so cheaply puts the
        rows at these times into `Segment.rows`.  With `keeps`, states between steps are available
        in each segment.  At the end `outcome` tells why there are no more.
        """
        if self.t_end == 0.0:
            return
        try:
            while True:  # leg by leg
                cut = yield from self._leg(due, keeps)
                if cut is None or not self._goes_on(cut):
                    break
        except SingularError:
            self.outcome = Outcome.SINGULAR
        except (LawError, NotSettledError) as error:
            self._end_by(error)
        if self.mechanism.laws and self.outcome in (Outcome.STEP_TOO_SMALL, Outcome.SINGULAR):
            n = self.mechanism.n
            try:
                for t, y in [(self.t, self.y), *self._ahead()]:
                    check_laws(self.mechanism, y[:n], y[n : 2 * n], t)
            except LawError as error:
                self._end_by(error)

    def _end_by(self, error: LawError | NotSettledError) -> None:
        """Set the outcome from an error, and the advice that names the law or the friction."""
        self.outcome = Outcome.LAW if isinstance(error, LawError) else Outcome.FRICTION
        self.report.advice = f"{error.what} = {error.value}: {error.limit}"

    def _leg(self, due: Due, keeps: bool) -> Generator[Segment, None, Passing | None]:
        """Yield the segments of one leg; return the cut that ended it, or None at the run's end."""
        events, mechanism = self.events, self.mechanism
        if self.phases is not None and events is not None:
            mechanism = in_mode(mechanism, self.phases.integrated)
            events.guard(self.phases.functions)
        if events is not None and events.columns is not None:
            torques = partial(applied_torques, self.mechanism, self.actuation)
            events.columns.enter(self.moving, torques)
        system = self._system(mechanism)
        steps, report = self._steps(system, due, keeps), self.report
        before = report.evaluations
        while True:
            segment = steps.advance(self.settings.max_evaluations - report.evaluations)
            report.evaluations = before + steps.evaluations
            if segment is None:
                assert steps.outcome is not None
                self.outcome = steps.outcome
                if self.outcome is Outcome.STEP_TOO_SMALL and mechanism.rubbing:
                    self._check_friction(system.side)
                return None
            cut = None if events is None else events.look(segment)
            if cut is not None:
                segment = segment.until(cut.t)
            report.steps += len(segment)
            self.t, self.y = segment.end, segment.y[-1]
            report.t_reached = self.t
            yield segment
            if cut is not None:
                steps.leave(self.t, self.y)
                return cut
            if self.t != self.t_end and self._hopeless(segment):
                return None

    def _goes_on(self, cut: Passing) -> bool:
        """Enter the leg that follows a cut; return False if the cut ends the run."""
        assert self.events is not None
        place = cut.place - len(self.events.functions)
        if place < 0 or self.phases is None:
            self.outcome = Outcome.EVENT
            self.report.ended_by = self.events.functions[cut.place].name
            return False
        if why := self.phases.ends_run(place):
            self.outcome, self.report.ended_by = Outcome.LIMIT, why
            return False
        self.y = self.phases.next(self.t, self.y, place)
        if self.phases.idle == MOST_AT_ONCE:
            self.outcome = Outcome.CHATTERING
            return False
        return self.t != self.t_end

    # -- why there is no way on --------------------------------------------------------------------

    def _ahead(self) -> Iterator[tuple[float, Array]]:
        """Yield times just beyond the end of the run, with the states that its rates lead to."""
        n, whole = self.mechanism.n, max(1.0, abs(self.t))
        for k in range(-12, -4):
            t, y = self.t + math.copysign(10.0**k * whole, self.t_end), self.y.copy()
            y[:n] += (t - self.t) * self.y[n : 2 * n]
            yield t, y

    def _check_friction(self, side: RightHandSide) -> None:
        """Raise NotSettledError if friction by forces has no solution just ahead."""
        # as steps shrink before a state without a solution none may have met it
        for t, y in self._ahead():
            if side.refused is not None:
                at, error = side.refused
                if abs(at - self.t) <= BEYOND * max(1.0, abs(self.t)):
                    raise error
            side.rates(t, y)
            if side.refused is not None and side.refused[0] == t:
                raise side.refused[1]

    def _hopeless(self, segment: Segment) -> bool:
        """Return whether the run has used up its evaluations, or its steps are far too short.

        Short steps that still grow may reach the end.
        """
        self._recent = np.concatenate([self._recent, segment.t[1:]])
        if len(self._recent) >= STEPS_AT_ONCE:
            widths = np.abs(np.diff(self._recent))
            left = abs(self.t_end - float(self._recent[-1]))
            self._recent = NO_TIMES
            early, late = (float(x.max()) for x in np.array_split(widths, 2))
            before = max(self._longest, early)
            self._longest = max(before, late)
            most = max(MOST_STEPS, NEVER * self.settings.max_evaluations)
            most = min(most, 1.0 / np.finfo(float).eps)  # floats tell no more apart
            if abs(self.t_end) <= FAR_END:
                outcome, ends = Outcome.STEP_TOO_SMALL, left > most * late and late <= 2.0 * early
            else:
                outcome = Outcome.ENDLESS
                ends = left > most * self._longest <= 2.0 * most * before
            if ends:
                self.outcome = outcome
                return True
        if self.report.evaluations > self.settings.max_evaluations:
            self.outcome = Outcome.TOO_MANY_EVALUATIONS
            return True
        return False

    def advice(self) -> str:
        """Return what to do about the outcome."""
        mechanism, control = self.mechanism, self.actuation.control
        advice = ""
        if self.phases is not None and self.phases.led_on:
            advice = LED
        elif control is not None and self.outcome not in (Outcome.FINISHED, Outcome.EVENT):
            advice = no_hold(mechanism, control)
        if not advice and mechanism.has_tables and self.outcome is Outcome.STEP_TOO_SMALL:
            advice = near_table_end(mechanism, self.t, self.y)
        return advice or self.report.advice or self.outcome.advice


class Record(NamedTuple):
    """The report and the contacts of a run that has ended."""

    run: Run
    statistics: RunStatistics

    @property
    def contacts(self) -> list[Event]:
        """Stops that joints met or left, joints that stuck or started, in the order of time."""
        return [] if self.run.phases is None else self.run.phases.events

    def settle(self) -> Report:
        """Return the report with the statistics of all steps."""
        run, report = self.run, self.run.report
        self.statistics.flush()
        if run.actuation.control is not None:
            report.tracking = run.actuation.control.tracking()
        if run.events is not None:
            report.events = run.events.counts(self.contacts)
            report.remarks = run.events.remarks()
        return report


def run(
    mechanism: Mechanism,
    state: Array,
    t_end: float,
    actuation: Actuation,
    settings: Settings,
    sink: Sink,
    times: Array | EvenTimes | None = None,
    watch: Callable[[float], bool] | None = None,
    events: EventWatch | None = None,
    read: Callable[[Segment], None] | None = None,
) -> tuple[Outcome, Record]:
    """Integrate from `state` (2n,) and pass rows t (k,), y (k, 2n or more) to `sink` in batches.

    Rows are at `times`, or at the accepted steps if `times` is None.  `watch` is called with t
    after some steps; if it returns True, the run ends as interrupted.  `events` finds events and
    may end the run.  `read` is called with each segment, which then has states between its steps.
    """
    check_run(settings, t_end, times)
    check_span(actuation, t_end)
    run = Run(mechanism, state, t_end, actuation, settings, events)
    report, actuation = run.report, run.actuation

    def look(t: float) -> None:
        report.t_reached = t
        if watch is not None and watch(t):
            raise InterruptedRun

    statistics = RunStatistics(report, actuation, mechanism.n, bool(mechanism.rows))
    rows = Rows(sink, times, mechanism.n, 2 * mechanism.n + actuation.states, look)
    moving = run.moving
    rows.begin(moving, run.y)
    statistics.add(np.zeros(1), run.y[None], moving)
    begun = time.perf_counter()
    try:
        for segment in run.segments(rows.due, keeps=read is not None):
            if read is not None:
                read(segment)
            moving = run.moving
            rows.take(moving, segment)
            statistics.add(segment.t[1:], segment.y[1:], moving)
            look(segment.end)
    except InterruptedRun:
        run.outcome = Outcome.INTERRUPTED
    if run.outcome in (Outcome.EVENT, Outcome.LIMIT):
        rows.end(moving, run.t, run.y)
    rows.flush()
    if run.outcome is Outcome.STEP_TOO_SMALL and settings.method != "taylor":
        statistics.flush()
        near = statistics.last_singular
        if near is not None and near < NEARLY_SINGULAR:
            run.outcome = Outcome.SINGULAR
    record = Record(run, statistics)
    if actuation.control is not None:  # it may follow another run before it is asked
        record.settle()
    report.seconds = time.perf_counter() - begun
    report.outcome, report.advice = run.outcome.label, run.advice()
    return run.outcome, record
