"""Integrates smooth motions of a run: by scipy's solvers or the Taylor series, phase by phase."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from robodyn.dynamics import dense_dynamics
from robodyn.errors import RobodynError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode
from robodyn.simulation.recording import Recorder
from robodyn.simulation.report import Outcome, Report, StopRun
from robodyn.simulation.run_torques import check_start
from robodyn.simulation.settings import Settings
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.loops.misses import Misses
    from robodyn.simulation.phases import Phases
    from robodyn.simulation.right_hand_side import RightHandSide
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
            from robodyn.loops.misses import Misses

            self._misses[mechanism] = Misses(mechanism)
        return self._misses.get(mechanism)

    def side(self, mechanism: Mechanism) -> RightHandSide:
        """The rates of the mechanism."""
        if mechanism not in self._sides:
            baumgarte = self.settings.stabilize == "baumgarte" and mechanism.rows
            from robodyn.simulation.right_hand_side import right_hand_side

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
        if by_series and not mechanism.springs and dense_dynamics.elimination_is_safe(mechanism):
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
            from robodyn.taylor.run import TaylorRun

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
