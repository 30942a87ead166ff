"""Forward simulation: solve_ivp with constraint projection, or the Taylor series.

A run goes through one of scipy's solvers, made to project after every step (`solvers.py`), or
through the Taylor integrator (`taylor/run.py`), which needs no scipy.  Rows of output and the
statistics leave the run in batches, so its memory does not grow with its length.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics import dense_dynamics, dynamics
from robodyn.dynamics.placed import as_states
from robodyn.engines.coupling_laws import check_laws
from robodyn.engines.row_values import near_table_end, rows_of
from robodyn.errors import InputError, LawError, RobodynError, SingularError, printable
from robodyn.events.functions import event_function, event_functions, must_be_text
from robodyn.events.state_columns import StateColumns
from robodyn.events.watch import Event, EventWatch
from robodyn.loops import loop_rates
from robodyn.loops.misses import Misses
from robodyn.loops.projection import Projection, best_closing
from robodyn.mechanics import parts
from robodyn.mechanics.actuation import Actuation, CallerError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode
from robodyn.simulation.differences import Numbers, columns, sensitivities, tell
from robodyn.simulation.motion_columns import (
    TOO_FAST,
    applied_torques,
    as_actuation,
    check_span,
    check_start,
    motion_columns,
    motion_values,
    no_hold,
    over_run,
)
from robodyn.simulation.phases import Phases
from robodyn.simulation.recording import Recorder, RunStatistics, Sink, joined
from robodyn.simulation.report import Outcome, Report, StopRun
from robodyn.simulation.right_hand_side import RightHandSide, right_hand_side
from robodyn.simulation.settings import (
    BAUMGARTE,
    MAX_EVALUATIONS,
    NO_ENGINE,
    EvenTimes,
    Settings,
    check_run,
)
from robodyn.tables.arrays import Array
from robodyn.tables.named_columns import Columns
from robodyn.taylor.compiled import check_served
from robodyn.taylor.run import TaylorRun

if TYPE_CHECKING:
    from robodyn.simulation.phases import Phases
    from robodyn.taylor.compiled import CompiledEngine

NEARLY_SINGULAR = 1e-4  # least singular value of Psi, relative, that explains a step too small
MOST_AT_ONCE = 100  # phases in a row that take no time, after which none will


class SmoothMotions:
    """Integrates smooth motions of mechanisms, one after the other; what it makes it keeps."""

    def __init__(self, actuation: Actuation, settings: Settings, t_end: float, work: bool) -> None:
        self.actuation, self.settings, self.t_end, self.work = actuation, settings, t_end, work
        self._sides: dict[Mechanism, RightHandSide] = {}
        self._engines: dict[Mechanism, CompiledEngine | None] = {}  # of the Taylor series
        self._misses: dict[Mechanism, Misses] = {}  # the change points that the run has met

    def misses(self, mechanism: Mechanism) -> Misses | None:
        """The change points of the mechanism that the run has met; None: it has no closures."""
        if mechanism.rows and mechanism not in self._misses:
            self._misses[mechanism] = Misses(mechanism)
        return self._misses.get(mechanism)

    def side(self, mechanism: Mechanism) -> RightHandSide:
        """The rates of the mechanism."""
        if mechanism not in self._sides:
            baumgarte = self.settings.stabilize == "baumgarte" and mechanism.rows
            self._sides[mechanism] = right_hand_side(
                mechanism,
                self.actuation,
                work=self.work,
                baumgarte=self.settings.baumgarte if baumgarte else 0.0,
                misses=self.misses(mechanism),
            )
        return self._sides[mechanism]

    def check_start(self, mechanism: Mechanism, y: Array, report: Report) -> None:
        """Raise RobodynError, now, where no motion is defined."""
        n, by_series = mechanism.n, self.settings.method == "taylor"
        if by_series:
            report.evaluator = "compiled"
        if by_series and not mechanism.parted and dense_dynamics.elimination_is_safe(mechanism):
            return
        with np.errstate(all="ignore"):  # rates that leave the floats end the run
            if by_series:
                dense_dynamics.forward(mechanism, y[:n], y[n : 2 * n], np.zeros(n))
                return
            side = self.side(mechanism)
            report.evaluator = side.kind
            if not np.isfinite(side.rates(0.0, y)).all():
                check_start(mechanism, self.actuation, 0.0, y)
                limit = "the acceleration is not finite there"
                raise RobodynError("cannot start", where=mechanism.source, limit=limit)

    def run(self, mechanism: Mechanism, t: float, y: Array, recorder: Recorder) -> Outcome:
        """From (t, y) to the end, or to an event."""
        settings = self.settings
        projects = settings.stabilize == "projection" and bool(mechanism.rows)
        try:
            if settings.method != "taylor":
                return self._by_scipy(mechanism, t, y, recorder, projects)
            return TaylorRun(
                mechanism,
                self.actuation,
                y,
                self.t_end,
                recorder,
                rtol=float(settings.rtol),
                atol=float(settings.atol),
                order=settings.order,
                project=projects,
                max_step=float(settings.max_step),
                side=lambda: self.side(mechanism),
                engines=self._engines,
                met=self.misses(mechanism),
                t=t,
            ).run()
        except StopRun as stop:
            if stop.outcome is not Outcome.EVENT:
                raise
            return stop.outcome

    def _by_scipy(
        self, mechanism: Mechanism, t: float, y: Array, recorder: Recorder, projects: bool
    ) -> Outcome:
        from robodyn.simulation.solvers import StiffError, solver_of

        tolerances = self.settings.rtol, self.settings.atol
        with warnings.catch_warnings():
            # what scipy and numpy warn of, the outcome says
            warnings.simplefilter("ignore", RuntimeWarning)
            warnings.filterwarnings("ignore", module="scipy")
            solver = solver_of(
                self.settings.method,
                self.side(mechanism),
                (t, y, self.t_end),
                tolerances,
                recorder,
                self.actuation,
                projects,
                self.settings.max_step,
            )
            try:
                while solver.status == "running":
                    solver.step()
            except StiffError:
                return Outcome.STIFF
            finally:
                recorder.end_solver(solver)
        if solver.status == "finished":
            return Outcome.FINISHED
        recorder.flush_steps()
        near = recorder.statistics.last_singular
        singular = near is not None and near < NEARLY_SINGULAR
        return Outcome.SINGULAR if singular else Outcome.STEP_TOO_SMALL


def in_phases(phases: Phases, smooth: SmoothMotions, y: Array, recorder: Recorder) -> Outcome:
    """From the state y at t = 0, phase by phase."""
    t = 0.0
    while True:
        recorder.begin_phase(phases.moving, phases.functions)
        outcome = smooth.run(in_mode(phases.mechanism, phases.integrated), t, y, recorder)
        place, stopped = recorder.guard, recorder.stopped
        if outcome is not Outcome.EVENT or place is None or stopped is None:
            return outcome
        if why := phases.ends_run(place):
            recorder.report.ended_by = why
            recorder.end_row()
            return Outcome.LIMIT
        t = stopped.t
        y = phases.next(t, stopped.y, place)
        if phases.idle == MOST_AT_ONCE:
            return Outcome.CHATTERING
        if t == smooth.t_end:
            return Outcome.FINISHED


LED = "a law of the time leads the joint there, and no stop throws it back"
UNTIL = "until"  # the name of the event that ends a run
NONE: frozenset[int] = frozenset()


@dataclass(eq=False, repr=False)
class Motion:
    """A simulated motion: t (T,) s, q, qd, tau (T, n); how it ended, its events, and the report.

    With sensitivities d(q, qd) by each of k names, (T, 2n, k).  `errors` are those of a controller,
    q_ref - q of the actuated joints (T, m).
    """

    t: Array
    q: Array
    qd: Array
    tau: Array
    outcome: Outcome
    mechanism: Mechanism
    phases: list[tuple[int, Mechanism]]  # rows, and what moves
    events: Sequence[Event]  # in the order of time
    _settle: Callable[[], Report]
    sensitivity: Array | None = None
    errors: Array | None = None
    _further: Columns = field(default_factory=Columns)

    @cached_property
    def report(self) -> Report:
        """What the run did; its statistics are taken when they are asked for."""
        return self._settle()

    def __getstate__(self) -> dict[str, object]:
        made = {"report": self.report, "events": list(self.events), "_settle": None}
        return {**vars(self), **made}

    @cached_property
    def qdd(self) -> Array:
        """The accelerations (T, n), rad/s^2, computed when they are asked for."""
        states = self.in_phases(self.q, self.qd, self.tau, self.t)
        return np.concatenate([dynamics.motion_dynamics(moving, *x).qdd for moving, *x in states])

    def in_phases(self, *values: Array) -> Iterator[tuple[Any, ...]]:
        """What moves in each phase, and these values there."""
        if not self.mechanism.switches or not self.phases:
            yield self.mechanism, *values
            return
        ends = np.cumsum([count for count, _ in self.phases])[:-1]
        parts = (np.split(x, ends) for x in values)
        yield from zip((moving for _, moving in self.phases), *parts, strict=True)

    def to_dict(self) -> Columns:
        """The columns (T,) by their names, as `robodyn simulate` writes them.

        A dict that pandas.DataFrame and polars.DataFrame take as it is.
        """
        states = self.in_phases(self.t, self.q, self.qd, self.tau)
        with np.errstate(all="ignore"):
            parts = [motion_values(self.mechanism, moving, *x) for moving, *x in states]
        values = [*np.concatenate(parts).T, *(() if self.errors is None else self.errors.T)]
        names = motion_columns(self.mechanism, self.errors is not None)
        return Columns({**dict(zip(names, values, strict=True)), **self._further})

    def __repr__(self) -> str:
        span = f", t = {self.t[0]:.6g} to {self.t[-1]:.6g} s" if len(self.t) else ""
        events = f", {len(self.events)} events" if self.events else ""
        what = f"{printable(self.mechanism.name)}: {len(self.t)} rows{span}, {self.outcome.label}"
        return f"<Motion of {what}{events}>"

    def _repr_html_(self) -> str:
        from robodyn.notebook.inline import motion_html

        return motion_html(self)


def simulate(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    t_end: float,
    tau: Sequence[float]
    | str
    | Callable[[float, list[float], list[float]], Sequence[float]]
    | Actuation
    | None = None,
    method: str = "DOP853",
    rtol: float = 1e-9,
    atol: float = 1e-9,
    t_eval: ArrayLike | None = None,
    stabilize: str = "projection",
    max_evals: float = MAX_EVALUATIONS,
    order: int | None = None,
    max_step: float = np.inf,
    events: Mapping[str, str] | None = None,
    until: str | None = None,
    sensitivity: Sequence[str] | None = None,
    engine: object = None,
) -> Motion:
    """The motion from the state q, qd (n,) at t = 0 to t_end (s; negative: backwards).

    tau: constants, an expression such as "2*sin(3*t)", a function tau(t, q, qd), or None; values
    are those of all joints or of the actuated ones.  An exception of the function ends the run and
    is raised as it is; where it returns nan a shorter step is tried.  The motion is given at
    `t_eval`, or at the accepted steps where that is None.  Otherwise a run that does not finish is
    no exception: `motion.outcome` tells, and the motion holds what was computed.
    `method` is one of scipy's, or "taylor", machine code with the extra `fast`, whose `order`
    follows from the tolerance unless given.
    `events` are expressions by name, {"apex": "qd1", "high": "q1 > 90deg"}: `motion.events` tells
    when each passes zero, or becomes true; the run ends where `until` does.  `sensitivity` names
    numbers of the scene and start values, ["links.forearm.m", "q1"]: `motion.sensitivity` has the
    derivatives by them, nan where they are withheld, `motion.report` their errors.
    Raises InputError for arguments that do not fit, a state that does not close among them.
    """
    if engine is not None:
        raise InputError("engine", value=engine, limit=NO_ENGINE)
    q = as_states(mechanism, "q", q)
    qd = as_states(mechanism, "qd", qd)
    if q.ndim != 1 or qd.ndim != 1:
        shapes = f"{q.shape} and {qd.shape}"
        raise InputError("shapes of q and qd", value=shapes, limit="must be those of one state")
    if mechanism.rows:
        fault = loop_rates.check_closed(mechanism, q, qd, t=0.0)
        if fault is not None:
            raise fault[1]
    state = np.concatenate([q, qd])
    actuation = over_run(mechanism, as_actuation(mechanism, tau), state, t_end, atol)
    times = None if t_eval is None else np.asarray(t_eval, float)
    watch = watched_events(mechanism, events or {}, until, float(t_end))
    numbers = None
    if sensitivity:
        numbers = Numbers(mechanism, sensitivity, state)
    most: Any = max_evals  # which settings make whole
    settings = Settings(method, rtol, atol, stabilize, BAUMGARTE, most, order, max_step)
    try:
        motion = _motion(mechanism, state, float(t_end), actuation, settings, times, watch)
        if numbers is not None:
            _differentiate(motion, numbers, actuation, settings, watch)
        return motion
    except CallerError as failed:
        error = failed.error
    raise error


def _motion(
    mechanism: Mechanism,
    state: Array,
    t_end: float,
    actuation: Actuation,
    settings: Settings,
    times: Array | None,
    watch: EventWatch | None,
) -> Motion:
    """Run from `state` (2n,) to t_end and gather the rows."""
    rows: list[tuple[Array, Array, Mechanism]] = []
    outcome, recorder = run(
        mechanism,
        state,
        t_end,
        actuation,
        settings,
        lambda *row: rows.append(row),
        times,
        events=watch,
    )
    n = mechanism.n
    happened: Sequence[Event] = [] if watch is None else watch.found
    if recorder.contacts:
        happened = sorted([*happened, *recorder.contacts], key=lambda event: abs(event.t))
    phases = [(len(t), moving) for t, _, moving in rows]
    none = np.zeros(0), np.zeros((0, len(state)))
    t, y = joined([(t, y) for t, y, _ in rows] or [none])
    torques = applied_torques(mechanism, actuation, t, y)
    q, qd = y[:, :n], y[:, n : 2 * n]
    errors = None if actuation.control is None else actuation.control.errors(t, y)
    facts = outcome, mechanism, phases, happened, recorder.settle, None, errors
    return Motion(t, q, qd, torques, *facts)


def _differentiate(
    motion: Motion,
    numbers: Numbers,
    actuation: Actuation,
    settings: Settings,
    watch: EventWatch | None,
) -> None:
    """Give a motion its derivatives by the numbers, and its report what is told of them."""
    report = motion.report  # of a controller before it leads other runs
    found = sensitivities(numbers, actuation, settings, motion.t)
    motion.sensitivity = found.values
    names_of = columns(motion.mechanism.n, found.names)
    motion._further.update(zip(names_of, found.flat.T, strict=True))
    moving = motion.phases[-1][1] if motion.phases else motion.mechanism
    y = np.hstack([motion.q, motion.qd])
    tell(report, found, watch, moving, motion.t, y, motion.tau)


def watched_events(
    mechanism: Mechanism, events: Mapping[str, str], until: str | None, t_end: float
) -> EventWatch | None:
    """What watches a run for events, and ends it at that of `until`; None where there are none.

    Raises InputError for what is no event.
    """
    if not events and until is None:
        return None
    own = StateColumns(mechanism)
    functions, stops = event_functions(mechanism, events, own), NONE
    if until is not None:
        must_be_text(UNTIL, until)
        stops = frozenset([len(functions)])
        functions = *functions, event_function(mechanism, UNTIL, until, UNTIL, own)
    computed = own if any(x.computed for x in functions) else None
    return EventWatch(functions, t_end, stops, 2 * mechanism.n, computed)


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
) -> tuple[Outcome, Recorder]:
    """Integrate from `state` (2n,); rows (t (k,), y (k, 2n or more)) go to `sink` as they come.

    Rows are at `times`, or at the accepted steps.  `watch`, called with t after every step, ends
    the run as interrupted when it returns True; `events` finds events, and may end it as well.
    The recorder has the report, and its statistics once it is settled.
    """
    check_run(settings, t_end, times)
    check_span(actuation, t_end)
    actuation = over_run(mechanism, actuation, state, t_end, settings.atol)
    report = Report(method=settings.method, rtol=settings.rtol, atol=settings.atol, t_end=t_end)
    if not actuation.told_by_leaves:
        report.hint = TOO_FAST
        warnings.warn(TOO_FAST, dynamics.RobodynWarning, stacklevel=2)
    report.stabilize = settings.stabilize if mechanism.rows else "none"
    work = actuation.active or mechanism.changes_energy or mechanism.switches
    work = work or bool(mechanism.driven)
    y = np.array([*state.tolist(), *[0.0] * (actuation.states + work)])
    y = _begun(mechanism, actuation, y, t_end, report.stabilize == "projection")
    phases, moving = None, mechanism
    if mechanism.switches:
        events = events or EventWatch([], t_end)
        phases = Phases(mechanism, actuation, y, t_end, settings.atol)
        y, moving = phases.y, phases.moving
    smooth = SmoothMotions(actuation, settings, t_end, work)
    smooth.check_start(moving, y, report)
    if settings.method == "taylor":
        check_served(mechanism, actuation)
    statistics = RunStatistics(report, actuation, mechanism.n, bool(mechanism.rows))
    most = settings.max_evaluations
    recorder = Recorder(moving, report, sink, times, most, watch, actuation, statistics)
    recorder.events = events
    if events is not None and events.columns is not None:
        events.columns.enter(moving, partial(applied_torques, mechanism, actuation))
    recorder.begin(y)
    begun = time.perf_counter()
    outcome, law = Outcome.FINISHED, None
    try:
        if t_end != 0.0 and phases is not None:
            outcome = in_phases(phases, smooth, y, recorder)
        elif t_end != 0.0:
            outcome = smooth.run(mechanism, 0.0, y, recorder)
    except SingularError:
        outcome = Outcome.SINGULAR
    except LawError as error:
        outcome, law = Outcome.LAW, error
    except StopRun as stop:
        outcome = stop.outcome
    recorder.flush_rows()
    if phases is not None:
        recorder.contacts = phases.found
    if actuation.control is not None:  # it may follow another run before it is asked
        recorder.settle()
    report.seconds = time.perf_counter() - begun
    report.outcome, report.advice = outcome.label, outcome.advice
    if phases is not None and phases.led_on:
        report.advice = LED
    if mechanism.laws and outcome in (Outcome.STEP_TOO_SMALL, Outcome.SINGULAR):
        law = undefined_beyond(mechanism, recorder.last, t_end)
    if law is not None:
        report.advice = f"{law.what} = {law.value}: {law.limit}"
    if mechanism.has_tables and outcome is Outcome.STEP_TOO_SMALL and recorder.last is not None:
        report.advice = near_table_end(mechanism, *recorder.last) or report.advice
    if actuation.control is not None and outcome not in (Outcome.FINISHED, Outcome.EVENT):
        report.advice = no_hold(mechanism, actuation.control) or report.advice
    return outcome, recorder


def undefined_beyond(
    mechanism: Mechanism, last: tuple[float, Array] | None, t_end: float
) -> LawError | None:
    """The error of a law that has no value, or no derivative, just beyond the last state."""
    if last is None:
        return None
    (t, y), n = last, mechanism.n
    for ahead in (0.0, *(10.0**k for k in range(-12, -4))):
        now = t + math.copysign(ahead * max(1.0, abs(t)), t_end)
        q, qd = y[:n] + (now - t) * y[n : 2 * n], y[n : 2 * n]
        try:
            check_laws(mechanism, q, qd, now)
        except LawError as error:
            return error
    return None


def _begun(
    mechanism: Mechanism, actuation: Actuation, y: Array, t_end: float, projects: bool
) -> Array:
    """The state y from which a run starts, closed where it `projects`; torques are told of it."""
    n = mechanism.n
    check_laws(mechanism, y[:n], y[n : 2 * n], 0.0)
    if t_end != 0.0 and mechanism.rows:
        loop_rates.check_way_on(mechanism, y[None, :n], y[None, n : 2 * n])
    if projects:
        y = Projection(mechanism, best_closing(mechanism))(0.0, y)
    if actuation.told is not None:
        actuation.told.begin(y.tolist(), float(t_end))
    if mechanism.signals:
        rows_of(parts.acting, mechanism).check_signals(y[:n], y[n : 2 * n])
    return y
