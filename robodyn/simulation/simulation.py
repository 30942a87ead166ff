"""Forward simulation: solve_ivp with constraint projection, or the Taylor series.

A run goes through one of scipy's solvers, made to project after every step (`solvers.py`), or
through the Taylor integrator (`taylor/run.py`), which needs no scipy.  Rows of output and the
statistics leave the run in batches, so its memory does not grow with its length.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics import dense_dynamics, dynamics
from robodyn.dynamics.placed import as_states
from robodyn.engines.row_values import near_table_end, rows_of
from robodyn.errors import InputError, RobodynError, SingularError
from robodyn.loops import loop_rates
from robodyn.loops.projection import Projection, best_closing
from robodyn.mechanics import parts
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.even_times import EvenTimes
from robodyn.simulation.recording import Outcome, Recorder, Report, Sink, StopRun
from robodyn.simulation.right_hand_side import RightHandSide, right_hand_side
from robodyn.simulation.run_torques import applied_torques, as_actuation, over_run

Array = NDArray[np.float64]

MAX_EVALUATIONS = 2_000_000
BAUMGARTE = 20.0  # 1/s
NEARLY_SINGULAR = 1e-4  # least singular value of Psi, relative, that explains a step too small
Method = Literal["DOP853", "RK45", "RK23", "Radau", "BDF", "LSODA", "taylor"]
Engine = Literal["auto", "python", "compiled"]  # of the Taylor series
Stabilize = Literal["projection", "baumgarte", "none"]
METHODS: tuple[str, ...] = get_args(Method)
ORDERS = (4, 60)  # of the Taylor series
CHOICES = {"method": METHODS, "stabilize": get_args(Stabilize), "engine": get_args(Engine)}
TOO_FAST = "the torque changes too fast to be sampled: steps go by their errors alone (--max-step)"
SCIPY_RTOL = 3e-14  # scipy's methods take nothing smaller


@dataclass
class Motion:
    """A simulated motion: t (T,) s, q, qd, tau (T, n); how it ended, and the report."""

    t: Array
    q: Array
    qd: Array
    tau: Array
    outcome: Outcome
    mechanism: Mechanism
    _settle: Callable[[], Report] = field(repr=False, compare=False)

    @cached_property
    def report(self) -> Report:
        """What the run did; its statistics are taken when they are asked for."""
        return self._settle()

    def __getstate__(self) -> dict[str, object]:
        return {**vars(self), "report": self.report, "_settle": None}

    @cached_property
    def qdd(self) -> Array:
        """The accelerations (T, n), rad/s^2, computed when they are asked for."""
        return dynamics.forward_dynamics(self.mechanism, self.q, self.qd, self.tau, self.t)


@dataclass(slots=True)
class Settings:
    """How to integrate."""

    method: str = "DOP853"
    rtol: float = 1e-9
    atol: float = 1e-9
    stabilize: str = "projection"
    baumgarte: float = BAUMGARTE
    max_evaluations: int = MAX_EVALUATIONS
    order: int | None = None  # of the Taylor series; None: by the tolerance
    engine: str = "auto"  # of the Taylor series; see `taylor/run.py`
    max_step: float = np.inf  # s

    @property
    def smallest_rtol(self) -> float:
        """That the method takes."""
        return 1e-16 if self.method == "taylor" else SCIPY_RTOL

    def check(self) -> None:
        """Raise InputError for a setting that is none."""
        for name, words in CHOICES.items():
            if (value := getattr(self, name)) not in words:
                raise InputError(name, value=value, limit=f"must be of {', '.join(words)}")
        if not self.smallest_rtol <= self.rtol < 1.0:
            limit = f"must be in [{self.smallest_rtol:g}, 1)"
            raise InputError("rtol", value=self.rtol, limit=limit)
        for name, value in (("atol", self.atol), ("baumgarte_rate", self.baumgarte)):
            if not 0.0 < value < np.inf:
                raise InputError(name, value=value, limit="must be > 0 and finite")
        if not self.max_step > 0.0:
            raise InputError("max_step", value=self.max_step, limit="must be > 0")
        if self.order is not None and not ORDERS[0] <= self.order <= ORDERS[1]:
            limit = f"must be in [{ORDERS[0]}, {ORDERS[1]}]"
            raise InputError("order", value=self.order, limit=limit)
        taylor = self.method == "taylor"
        if not taylor and (self.order is not None or self.engine != "auto"):
            what = "order" if self.order is not None else "engine"
            raise InputError(what, limit="is for the method taylor alone")
        if taylor and self.stabilize == "baumgarte":
            limit = "the Taylor series goes with projection or none"
            raise InputError("stabilize", value=self.stabilize, limit=limit)
        if self.max_evaluations < 1:
            raise InputError("max_evals", value=self.max_evaluations, limit="must be >= 1")


def simulate(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    t_end: float,
    tau: Sequence[float] | str | Callable[..., Sequence[float]] | Actuation | None = None,
    method: str = "DOP853",
    rtol: float = 1e-9,
    atol: float = 1e-9,
    t_eval: ArrayLike | None = None,
    stabilize: str = "projection",
    max_evals: int = MAX_EVALUATIONS,
    order: int | None = None,
    engine: str = "auto",
    max_step: float = np.inf,
) -> Motion:
    """The motion from the state q, qd (n,) at t = 0 to t_end (s; negative: backwards).

    tau: constants, an expression such as "2*sin(3*t)", a function tau(t, q, qd), or None.  The
    motion is given at `t_eval`, or at the accepted steps where that is None.  A run that does not
    finish is no exception: `motion.outcome` tells, and the motion holds what was computed.
    `method` is one of scipy's, or "taylor", whose `order` follows from the tolerance unless given,
    and whose `engine` is "python", "compiled" (machine code, with the extra `fast`), or "auto":
    compiled where a run takes, or this process took, many steps of the mechanism.
    Raises InputError for arguments that do not fit, a state that does not close among them.
    """
    q = as_states(mechanism, "q", q)
    qd = as_states(mechanism, "qd", qd)
    if q.ndim != 1 or qd.ndim != 1:
        shapes = f"{q.shape} and {qd.shape}"
        raise InputError("shapes of q and qd", value=shapes, limit="must be those of one state")
    fault = loop_rates.check_closed(mechanism, q, qd)
    if fault is not None:
        raise fault[1]
    state = np.concatenate([q, qd])
    actuation = over_run(mechanism, as_actuation(mechanism, tau), state, t_end, atol)
    rows: list[tuple[Array, Array]] = []
    times = None if t_eval is None else np.asarray(t_eval, float)
    outcome, recorder = run(
        mechanism,
        state,
        float(t_end),
        actuation,
        Settings(method, rtol, atol, stabilize, BAUMGARTE, max_evals, order, engine, max_step),
        lambda t, y: rows.append((t, y)),
        times,
    )
    n = mechanism.n
    rows = rows or [(np.zeros(0), np.zeros((0, 2 * n)))]
    t, y = rows[0] if len(rows) == 1 else map(np.concatenate, zip(*rows, strict=True))
    torques = applied_torques(mechanism, actuation, t, y)
    return Motion(t, y[:, :n], y[:, n : 2 * n], torques, outcome, mechanism, recorder.settle)


def run(
    mechanism: Mechanism,
    state: Array,
    t_end: float,
    actuation: Actuation,
    settings: Settings,
    sink: Sink,
    times: Array | EvenTimes | None = None,
    watch: Callable[[float], bool] | None = None,
) -> tuple[Outcome, Recorder]:
    """Integrate from `state` (2n,) and hand rows (t (k,), y (k, 2n)) to `sink` as they come.

    Rows are at `times`, or at the accepted steps.  `watch`, called with t after every step, ends
    the run as interrupted when it returns True.  The recorder has the report, and its statistics
    once it is settled.
    """
    settings.check()
    if not np.isfinite(t_end):
        raise InputError("time", value=t_end, limit="must be finite")
    if abs(t_end) > settings.max_step * settings.max_evaluations:
        limit = f"{t_end:g} s would take more steps than max_evals, {settings.max_evaluations}"
        raise InputError("max_step", value=settings.max_step, limit=limit)
    if isinstance(times, np.ndarray):
        _check_times(times, t_end)
    if actuation.span is not None:
        what, first, last = actuation.span
        if not (first <= min(0.0, t_end) and last >= max(0.0, t_end)):
            span = f"{first:g} to {last:g} s"
            raise InputError(what, value=span, limit=f"must cover 0 to {t_end:g} s")
    actuation = over_run(mechanism, actuation, state, t_end, settings.atol)
    work = actuation.active or mechanism.changes_energy
    report = Report(method=settings.method, rtol=settings.rtol, atol=settings.atol, t_end=t_end)
    report.hint = "" if actuation.told_by_leaves else TOO_FAST
    report.stabilize = stabilize = settings.stabilize if mechanism.rows else "none"
    projects = stabilize == "projection"
    baumgarte = settings.baumgarte if stabilize == "baumgarte" else 0.0
    y0 = np.concatenate([state, [0.0]]) if work else np.array(state, float)
    taylor = settings.method == "taylor"

    sides: list[RightHandSide] = []

    def side() -> RightHandSide:
        if not sides:
            sides.append(right_hand_side(mechanism, actuation, work=work, baumgarte=baumgarte))
        return sides[0]

    n = mechanism.n
    if t_end != 0.0 and mechanism.rows:
        loop_rates.check_way_on(mechanism, y0[None, :n], y0[None, n : 2 * n])
    if projects:
        y0 = Projection(mechanism, best_closing(mechanism))(y0)
    if actuation.told is not None:
        actuation.told.begin(y0.tolist(), float(t_end))
    if mechanism.has_tables:
        rows_of(parts.acting, mechanism).check_tables(y0[:n], y0[n : 2 * n])
    if taylor:  # tell now where no motion is defined
        if mechanism.springs or not dense_dynamics.elimination_is_safe(mechanism):
            dense_dynamics.forward(mechanism, y0[:n], y0[n : 2 * n], np.zeros(n))
    else:
        report.evaluator = side().kind
        if not np.isfinite(side().rates(0.0, y0)).all():
            limit = "the torque or the acceleration is not finite there"
            raise RobodynError("cannot start", where=mechanism.source, limit=limit)
    recorder = Recorder(mechanism, report, sink, times, settings.max_evaluations, watch, actuation)
    recorder.begin(y0)
    begun = time.perf_counter()
    outcome = Outcome.FINISHED
    if t_end != 0.0:
        try:
            if taylor:
                from robodyn.taylor.run import taylor_run

                outcome = taylor_run(
                    mechanism,
                    actuation,
                    y0,
                    t_end,
                    recorder,
                    rtol=float(settings.rtol),
                    atol=float(settings.atol),
                    order=settings.order,
                    engine=settings.engine,
                    project=projects,
                    max_step=float(settings.max_step),
                    side=side,
                )
            else:
                outcome = _by_scipy(side(), y0, t_end, actuation, settings, recorder, projects)
        except SingularError:
            outcome = Outcome.SINGULAR
        except StopRun as stop:
            outcome = stop.outcome
    recorder.flush_rows()
    if actuation.control is not None:  # it may follow another run before it is asked
        recorder.settle()
    report.seconds = time.perf_counter() - begun
    report.outcome, report.advice = outcome.label, outcome.advice
    if mechanism.has_tables and outcome is Outcome.STEP_TOO_SMALL and recorder.last is not None:
        t, y = recorder.last
        report.advice = near_table_end(mechanism, y[:n], y[n : 2 * n], t) or report.advice
    return outcome, recorder


def _by_scipy(
    side: RightHandSide,
    y: Array,
    t_end: float,
    actuation: Actuation,
    settings: Settings,
    recorder: Recorder,
    projects: bool,
) -> Outcome:
    from robodyn.simulation.solvers import StiffError, solver_of

    tolerances = settings.rtol, settings.atol
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # LSODA's; the outcome says it
        solver = solver_of(
            settings.method,
            side,
            (0.0, y, t_end),
            tolerances,
            recorder,
            actuation,
            projects,
            settings.max_step,
        )
        try:
            while solver.status == "running":
                solver.step()
        except StiffError:
            return Outcome.STIFF
    if solver.status == "finished":
        return Outcome.FINISHED
    recorder.flush_steps()
    near = recorder.last_singular
    singular = near is not None and near < NEARLY_SINGULAR
    return Outcome.SINGULAR if singular else Outcome.STEP_TOO_SMALL


def _check_times(times: Array, t_end: float) -> None:
    direction = -1.0 if t_end < 0.0 else 1.0
    if times.ndim != 1 or not np.isfinite(times).all():
        raise InputError("t_eval", limit="must be a list of finite times")
    ordered = len(times) < 2 or (np.diff(times) * direction > 0.0).all()
    within = len(times) == 0 or (
        times[0] * direction >= 0.0 and times[-1] * direction <= t_end * direction
    )
    if not (ordered and within):
        raise InputError("t_eval", limit=f"must go from 0 towards {t_end:g} and not beyond")
