"""Forward simulation: solve_ivp with constraint projection; outcomes, statistics, motions.

A run goes through one of scipy's solvers, made to project after every step (`solvers.py`).  Rows
of output and the statistics leave the run in batches, so its memory does not grow with its length.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn import actuation as torque_sources
from robodyn import closed_form, dynamics, loop_rates
from robodyn.actuation import Actuation
from robodyn.errors import InputError, RobodynError, SingularError
from robodyn.mechanism import Mechanism
from robodyn.right_hand_side import right_hand_side

if TYPE_CHECKING:
    from scipy.integrate import OdeSolver

Array = NDArray[np.float64]
Sink = Callable[[Array, Array], None]

STEPS_AT_ONCE = 256  # accepted steps that the statistics take in one go
ROWS_AT_ONCE = 512
MAX_EVALUATIONS = 2_000_000
NEARLY_SINGULAR = 1e-4  # least singular value of Psi, relative, that explains a step too small
STABILIZERS = ("projection", "baumgarte", "none")
SMALLEST_RTOL = 3e-14  # scipy takes nothing smaller


class Outcome(Enum):
    """How a run ended, and what to do about it."""

    FINISHED = ("finished", "")
    STEP_TOO_SMALL = (
        "step too small",
        "the tolerance asks for more digits than the motion keeps here: loosen rtol and atol, or "
        "see whether a torque is undefined or the motion is singular at this time",
    )
    SINGULAR = (
        "singular",
        "the motion ran into a singular configuration: start beside it, or loosen rtol and atol",
    )
    TOO_MANY_EVALUATIONS = (
        "too many evaluations",
        "raise the limit (--max-evals), loosen rtol and atol, or try another method",
    )
    STIFF = (
        "stiff",
        "the explicit method is held to tiny steps by its stability: take --method Radau "
        "(or BDF, LSODA)",
    )
    INTERRUPTED = ("interrupted", "what was computed until then is kept")

    @property
    def label(self) -> str:
        return self.value[0]

    @property
    def advice(self) -> str:
        return self.value[1]


@dataclass(slots=True)
class Report:
    """What a run did: SI units; drift is relative to the largest energy in motion."""

    outcome: str = Outcome.FINISHED.label
    advice: str = ""
    method: str = ""
    rtol: float = 0.0
    atol: float = 0.0
    stabilize: str = ""
    evaluator: str = ""
    t_end: float = 0.0
    t_reached: float = 0.0
    steps: int = 0
    evaluations: int = 0
    seconds: float = 0.0
    energy_start: float = 0.0
    energy_drift: float = 0.0  # largest |E(t) - E(0) - work done| / energy in motion
    energy_in_motion: float = 0.0  # largest KE, or change of PE, J
    work: float = 0.0  # of torques less dampers, J
    largest_gap: float = 0.0  # m
    largest_gap_rate: float = 0.0  # m/s
    nearest_singular: float | None = None  # least singular value of Psi against its largest
    nearest_singular_time: float | None = None


@dataclass(slots=True)
class Motion:
    """A simulated motion: t (T,) s, q, qd, qdd (T, n), tau (T, n); how it ended, and the report."""

    t: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    outcome: Outcome
    report: Report


@dataclass(slots=True)
class Settings:
    """How to integrate."""

    method: str = "DOP853"
    rtol: float = 1e-9
    atol: float = 1e-9
    stabilize: str = "projection"
    baumgarte: float = 20.0  # 1/s
    max_evaluations: int = MAX_EVALUATIONS

    def check(self) -> None:
        """Raise InputError for a setting that is none."""
        from robodyn.solvers import METHODS

        if self.method not in METHODS:
            raise InputError("method", value=self.method, limit=f"must be of {', '.join(METHODS)}")
        if self.stabilize not in STABILIZERS:
            limit = f"must be of {', '.join(STABILIZERS)}"
            raise InputError("stabilize", value=self.stabilize, limit=limit)
        if not SMALLEST_RTOL <= self.rtol < 1.0:
            raise InputError("rtol", value=self.rtol, limit=f"must be in [{SMALLEST_RTOL:g}, 1)")
        if not 0.0 < self.atol < np.inf:
            raise InputError("atol", value=self.atol, limit="must be > 0 and finite")
        if not 0.0 < self.baumgarte < np.inf:
            raise InputError("baumgarte rate", value=self.baumgarte, limit="must be > 0 and finite")
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
) -> Motion:
    """The motion from the state q, qd (n,) at t = 0 to t_end (s; negative: backwards).

    tau: constants, an expression such as "2*sin(3*t)", a function tau(t, q, qd), or None.  The
    motion is given at `t_eval`, or at the accepted steps where that is None.  A run that does not
    finish is no exception: `motion.outcome` tells, and the motion holds what was computed.
    Raises InputError for arguments that do not fit, a state that does not close among them.
    """
    q = closed_form.as_states(mechanism, "q", q)
    qd = closed_form.as_states(mechanism, "qd", qd)
    fault = loop_rates.check_closed(mechanism, q, qd)
    if fault is not None:
        raise fault[1]
    actuation = _as_actuation(mechanism, tau)
    rows: list[tuple[Array, Array]] = []
    times = None if t_eval is None else np.asarray(t_eval, float)
    outcome, report = run(
        mechanism,
        np.concatenate([q, qd]),
        float(t_end),
        actuation,
        Settings(method, rtol, atol, stabilize, max_evaluations=max_evals),
        lambda t, y: rows.append((t, y)),
        times,
    )
    n = mechanism.n
    t = np.concatenate([t for t, _ in rows]) if rows else np.zeros(0)
    y = np.concatenate([y for _, y in rows]) if rows else np.zeros((0, 2 * n))
    torques = applied_torques(mechanism, actuation, t, y)
    q_, qd_ = y[:, :n], y[:, n : 2 * n]
    qdd = dynamics.forward_dynamics(mechanism, q_, qd_, torques)
    return Motion(t, q_, qd_, qdd, torques, outcome, report)


def applied_torques(mechanism: Mechanism, actuation: Actuation, t: Array, y: Array) -> Array:
    """The joint torques (T, n) of an actuation at times (T,) and states (T, 2n or more)."""
    if actuation.constants is not None:
        return np.broadcast_to(np.array(actuation.constants), (len(t), mechanism.n))
    torques = actuation.function(mechanism.n)
    rows = [torques(*row) for row in zip(t.tolist(), y.tolist(), strict=True)]
    return np.array(rows, float).reshape(len(t), mechanism.n)


def run(
    mechanism: Mechanism,
    state: Array,
    t_end: float,
    actuation: Actuation,
    settings: Settings,
    sink: Sink,
    times: Array | None = None,
    watch: Callable[[float], bool] | None = None,
) -> tuple[Outcome, Report]:
    """Integrate from `state` (2n,) and hand rows (t (k,), y (k, 2n)) to `sink` as they come.

    Rows are at `times`, or at the accepted steps.  `watch`, called with t after every step, ends
    the run as interrupted when it returns True.
    """
    settings.check()
    if not np.isfinite(t_end):
        raise InputError("time", value=t_end, limit="must be finite")
    times = None if times is None else _checked_times(times, t_end)
    work = actuation.active or any(mechanism.damping)
    report = Report(
        method=settings.method,
        rtol=settings.rtol,
        atol=settings.atol,
        stabilize=settings.stabilize if mechanism.rows else "none",
        t_end=t_end,
    )
    projects = settings.stabilize == "projection" and bool(mechanism.rows)
    baumgarte = settings.baumgarte if settings.stabilize == "baumgarte" and mechanism.rows else 0.0
    side = right_hand_side(mechanism, actuation, work=work, baumgarte=baumgarte)
    report.evaluator = side.kind
    y0 = np.concatenate([state, [0.0]]) if work else np.array(state, float)
    if projects and side.projection is not None:
        y0 = side.projection(y0)
    if not np.isfinite(np.asarray(side.rates(0.0, y0), float)).all():
        limit = "the torque or the acceleration is not finite there"
        raise RobodynError("cannot start", where=mechanism.source, limit=limit)

    recorder = _Recorder(mechanism, report, sink, times, settings.max_evaluations, watch)
    recorder.begin(y0)
    begun = time.perf_counter()
    outcome = Outcome.FINISHED
    if t_end != 0.0:
        outcome = _integrate(mechanism, side, y0, t_end, actuation, settings, recorder, projects)
    recorder.finish()
    report.seconds = time.perf_counter() - begun
    report.outcome, report.advice = outcome.label, outcome.advice
    return outcome, report


def _integrate(
    mechanism: Mechanism,
    side: Any,
    y0: Array,
    t_end: float,
    actuation: Actuation,
    settings: Settings,
    recorder: _Recorder,
    projects: bool,
) -> Outcome:
    from scipy.integrate import solve_ivp

    from robodyn.solvers import StiffError, projected

    atol = np.full(len(y0), settings.atol)
    atol[2 * mechanism.n :] = 1e100  # the work is a by-product: it does not choose the step
    options: dict[str, Any] = {
        "method": projected(settings.method),
        "t_eval": [t_end],  # the observer takes the rows; solve_ivp need not keep them
        "rtol": settings.rtol,
        "atol": atol,
        "projection": side.projection if projects else None,
        "observer": recorder.step,
        "kinks": actuation.kinks,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # LSODA's; the outcome says it
        try:
            solution = solve_ivp(side.rates, (0.0, t_end), y0, **options)
        except StiffError:
            return Outcome.STIFF
        except SingularError:
            return Outcome.SINGULAR
        except _Stop as stop:
            return stop.outcome
    if solution.success:
        return Outcome.FINISHED
    recorder.flush_steps()
    near = recorder.last_singular
    return (
        Outcome.SINGULAR if near is not None and near < NEARLY_SINGULAR else Outcome.STEP_TOO_SMALL
    )


class _Stop(Exception):
    """Ends a run from within the observer."""

    def __init__(self, outcome: Outcome) -> None:
        self.outcome = outcome


@dataclass(slots=True)
class _Recorder:
    """Sees every accepted step: makes the rows, keeps the statistics."""

    mechanism: Mechanism
    report: Report
    sink: Sink
    times: Array | None
    max_evaluations: int
    watch: Callable[[float], bool] | None
    next_row: int = 0
    rows: list[tuple[Array, Array]] = field(default_factory=list)
    waiting: int = 0
    steps: list[tuple[float, Array]] = field(default_factory=list)
    last_singular: float | None = None
    rank: int = 0

    def begin(self, y: Array) -> None:
        zero = np.zeros(1)
        if self.times is None or (len(self.times) and self.times[0] == 0.0):
            self._row(zero, y[None, :])
            self.next_row = 1
        self.steps.append((0.0, y))
        n = self.mechanism.n
        state = y[None, :n], y[None, n : 2 * n]
        self.report.energy_start = float(
            closed_form.kinetic_energy(self.mechanism, *state)[0]
            + closed_form.potential_energy(self.mechanism, state[0])[0]
        )

    def step(self, solver: OdeSolver) -> None:
        t = float(solver.t)
        self.report.steps += 1
        self.report.evaluations = solver.nfev
        self.report.t_reached = t
        if self.times is None:
            self._row(np.array([t]), solver.y[None, :].copy())
        else:
            ahead = self.times[self.next_row :]
            count = int(np.searchsorted(ahead * solver.direction, t * solver.direction, "right"))
            if count:
                due = ahead[:count]
                y = solver.y[None, :].copy() if due[0] == t else solver.dense_output()(due).T
                if due[-1] == t:
                    y[-1] = solver.y
                self.next_row += count
                self._row(due, y)
        self.steps.append((t, solver.y.copy()))
        if len(self.steps) >= STEPS_AT_ONCE:
            self.flush_steps()
        if solver.nfev > self.max_evaluations:
            raise _Stop(Outcome.TOO_MANY_EVALUATIONS)
        if self.watch is not None and self.watch(t):
            raise _Stop(Outcome.INTERRUPTED)

    def finish(self) -> None:
        self.flush_steps()
        self._flush_rows()

    def _row(self, t: Array, y: Array) -> None:
        self.rows.append((t, y))
        self.waiting += len(t)
        if self.waiting >= ROWS_AT_ONCE:
            self._flush_rows()

    def _flush_rows(self) -> None:
        if self.rows:
            t = np.concatenate([t for t, _ in self.rows])
            y = np.concatenate([y for _, y in self.rows])
            self.rows, self.waiting = [], 0
            self.sink(t, y[:, : 2 * self.mechanism.n])

    def flush_steps(self) -> None:
        """Take the waiting steps into the statistics."""
        if not self.steps:
            return
        report, mechanism, n = self.report, self.mechanism, self.mechanism.n
        t = np.array([t for t, _ in self.steps])
        y = np.array([y for _, y in self.steps])
        self.steps = []
        finite = np.isfinite(y).all(axis=1)
        t, y = t[finite], y[finite]
        if not len(t):
            return
        q, qd = y[:, :n], y[:, n : 2 * n]
        KE = closed_form.kinetic_energy(mechanism, q, qd)
        PE = closed_form.potential_energy(mechanism, q)
        work = y[:, 2 * n] if y.shape[1] > 2 * n else np.zeros(len(t))
        error = float(np.abs(KE + PE - work - report.energy_start).max())
        before = report.energy_drift * report.energy_in_motion
        moving = max(float(KE.max()), float(np.ptp(PE)), report.energy_in_motion)
        report.energy_in_motion = moving
        report.energy_drift = max(error, before) / moving if moving > 0.0 else 0.0
        report.work = float(work[-1])
        if mechanism.rows:
            self._flush_loops(t, q, qd)

    def _flush_loops(self, t: Array, q: Array, qd: Array) -> None:
        report, mechanism = self.report, self.mechanism
        gap = closed_form.closure_gap(mechanism, q)
        report.largest_gap = max(report.largest_gap, float(np.abs(gap).max()))
        stride = 1 + mechanism.n * len(mechanism.rows) // 2000
        Psi = closed_form.closure_jacobian(mechanism, q[::stride])
        rate = np.einsum("...ij,...j->...i", Psi, qd[::stride])
        report.largest_gap_rate = max(report.largest_gap_rate, float(np.abs(rate).max()))
        s = np.linalg.svd(Psi, compute_uv=False)
        if not self.rank:  # of closures that depend on one another not all count
            self.rank = int((s > 1e-9 * s[:, :1]).sum(axis=-1).max())
        ratio = s[:, self.rank - 1] / s[:, 0]
        worst = int(np.argmin(ratio))
        self.last_singular = float(ratio[-1])
        if report.nearest_singular is None or ratio[worst] < report.nearest_singular:
            report.nearest_singular = float(ratio[worst])
            report.nearest_singular_time = float(t[::stride][worst])


def _checked_times(times: Array, t_end: float) -> Array:
    direction = -1.0 if t_end < 0.0 else 1.0
    if times.ndim != 1 or not np.isfinite(times).all():
        raise InputError("t_eval", limit="must be a list of finite times")
    ordered = (np.diff(times) * direction > 0.0).all()
    within = len(times) == 0 or (
        times[0] * direction >= 0.0 and times[-1] * direction <= t_end * direction
    )
    if not (ordered and within):
        raise InputError("t_eval", limit=f"must go from 0 towards {t_end:g} and not beyond")
    return times


def _as_actuation(
    mechanism: Mechanism,
    tau: Sequence[float] | str | Callable[..., Sequence[float]] | Actuation | None,
) -> Actuation:
    if tau is None:
        return Actuation((0.0,) * mechanism.n)
    if isinstance(tau, Actuation):
        return tau
    if isinstance(tau, str):
        return torque_sources.expressions(mechanism, tau, "tau")
    if callable(tau):
        return torque_sources.callback(mechanism, tau)
    return torque_sources.constant(mechanism, [float(x) for x in np.asarray(tau, float)])
