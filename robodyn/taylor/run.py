"""Runs the Taylor integrator: steps onto kinks, crosses what is singular.

A series that starts close to a singular configuration drowns in rounding.  Engines land elsewhere
where they can; where they cannot, or a run starts there, a few steps of DOP853, whose stages
`change_points.py` serves, lead across.  So they do from where a torque has no series, sqrt(t) at 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import kink_at, next_stop
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.recording import Recorder
from robodyn.simulation.report import Outcome
from robodyn.simulation.run_torques import check_start
from robodyn.tables.arrays import Array
from robodyn.taylor import STEPS, Chunk, Engine, NoCodeError, Status
from robodyn.taylor.engine_choice import EngineChoice
from robodyn.taylor.held_steps import held_by_stability
from robodyn.taylor.steps import SteppingEngine

if TYPE_CHECKING:
    from robodyn.events.told import Stop
    from robodyn.loops.misses import Misses
    from robodyn.simulation.right_hand_side import RightHandSide

KEPT = 32768  # steps whose series are kept at a time, of one link
MOST_LOOKED_AT = (
    1024  # steps that events are looked for in at a time: a run can be interrupted between
)
AHEAD = 4  # where an event ends the run, or a phase of it, at first
MOST_IDLE = 8  # rounds without a step, after which there is none
LEAD = 8  # steps of DOP853 away from where a torque has no series
SMALLEST_RTOL = 3e-14  # of scipy's methods


@dataclass(eq=False)
class TaylorRun:
    """A run from (t, y) to t_end; `side` makes what DOP853 needs, where it is needed.

    `engine` is what `EngineChoice` takes; `engines` keeps those made for the next phase.  `met` are
    the change points that the run has met so far.
    """

    mechanism: Mechanism
    actuation: Actuation
    y: Array
    t_end: float
    recorder: Recorder
    rtol: float
    atol: float
    order: int | None
    engine: str
    project: bool
    max_step: float
    side: Callable[[], RightHandSide]
    engines: dict[tuple[Mechanism, str], Any]
    met: Misses | None
    t: float = 0.0

    def __post_init__(self) -> None:
        mechanism = self.mechanism
        self.closing, self.misses, self.suspect = None, None, 0.0
        if self.project and mechanism.rows:
            from robodyn.loops.change_points import suspect_quality
            from robodyn.loops.misses import FAR
            from robodyn.loops.projection import float_closing

            self.closing, self.misses = float_closing(mechanism), self.met
            self.suspect, self.far = suspect_quality(mechanism), FAR
        self.recent: list[Chunk] = []  # steps in a row not yet known to be held by stability
        self.crosses = False  # whether only the motion that leads across a change point leads on
        self.stuck = False  # whether none does: a torque bends without end, or rounding hides it
        self.idle = 0  # times in a row that nothing led on
        self.held = False  # whether steps may leap, or start too near: Python's engine holds them
        events = self.recorder.events
        self.most_ahead = max(1, min(MOST_LOOKED_AT, KEPT // mechanism.n))
        # of steps at a time, those beyond the end are lost
        self.ahead = AHEAD if events is not None and events.may_end else self.most_ahead
        chosen = self.engine, mechanism, self.actuation, self.rtol, self.atol, self.order
        work = len(self.y) > 2 * mechanism.n
        rest = self.project, work, self.recorder, self.engines, self.misses
        self.choice = EngineChoice(*chosen, *rest)

    def run(self) -> Outcome:
        """To the end; an event raises StopRun."""
        check_start(self.mechanism, self.actuation, self.t, self.y)
        if self.closing is not None and self.choice.in_python:
            near = self.closing(self.y.tolist())[1] < self.suspect  # machine code tells itself
            self.crosses = near and self._at_change_point()
        while True:
            before, bound = self.t, self._bound()
            kind = type(self.choice.now).__name__
            self.recorder.report.evaluator = kind.removesuffix("Engine").lower()
            status, outcome = Status.FULL, None
            if self.crosses or self.stuck:
                outcome = self._lead(bound)
            else:
                try:
                    chunk = self._advance(bound)
                except NoCodeError:  # of other torques than those at the start
                    self.choice.give_up()
                    continue
                status = chunk.status
                if self._held_by_stability(chunk):
                    outcome = Outcome.STIFF
            if outcome is None:
                outcome = self._way_on(before, status)
            if outcome is not None:
                self.choice.tell()
                return outcome

    def _at_change_point(self) -> bool:
        return self.misses is not None and self.misses.crosses(self.y[: self.mechanism.n])

    def _bound(self) -> float:
        """Where the next steps end at the latest."""
        actuation = self.actuation
        bound = next_stop(actuation.kinks, actuation.leaves, self.t, self.t_end)
        if abs(bound - self.t) > self.max_step:
            bound = self.t + math.copysign(self.max_step, self.t_end)
        return bound

    def _lead(self, bound: float) -> Outcome | None:
        """Go on by DOP853 to where a series leads on; the outcome where that fails."""
        before, regular = self.t, 2.0 * self.suspect
        self._by_dop853(bound, regular, LEAD if self.stuck else 1)
        if self.t != before:
            return None
        singular = self.closing is not None and self.closing(self.y.tolist())[1] < regular
        return Outcome.SINGULAR if singular else Outcome.STEP_TOO_SMALL

    @np.errstate(all="ignore")  # as of a run by it alone
    def _by_dop853(self, bound: float, regular: float, least: int) -> None:
        """At least so many steps and until the closures are regular, or the bound."""
        from robodyn.simulation.solvers import solver_of

        tolerances = max(self.rtol, SMALLEST_RTOL), self.atol
        way = self.t, self.y, bound
        solver = solver_of("DOP853", self.side(), way, tolerances, self.recorder, self.actuation)
        # where a rate is not finite at its start scipy has no first step, and would look for ever
        while solver.status == "running" and math.isfinite(getattr(solver, "h_abs", 0.0)):
            if solver.step() is not None:
                break
            least -= 1
            if least <= 0 and (
                self.closing is None or self.closing(solver.y.tolist())[1] >= regular
            ):
                break
        self.recorder.end_solver(solver)
        self.t, self.y = float(solver.t), np.array(solver.y)

    def _runner(self) -> Engine:
        """What makes the next steps: near a miss of a change point the engine in Python."""
        if self.choice.in_python:
            return self.choice.now
        n = self.mechanism.n
        near = self.misses is not None and self.misses.distance(self.y[:n]) < self.far
        return self.choice.careful() if self.held or near else self.choice.now

    def _advance(self, bound: float) -> Chunk:
        """Some steps, less those beyond a leap or an event, which the recorder takes."""
        recorder, runner = self.recorder, self._runner()
        python, events = isinstance(runner, SteppingEngine), recorder.events
        left = recorder.max_evaluations - recorder.report.evaluations
        steps = max(1, min(runner.most, left + 1)) if self.max_step == math.inf else 1
        runner.keeps = events is not None
        steps = min(steps, self.ahead) if events is not None else steps
        if not python:
            runner.forms = events.forms() if events else None
        chunk = runner.advance(self.t, self.y, bound, recorder.times_until(bound), steps)
        self.held = False
        if self.misses is not None and python:  # machine code looks too
            times, ends = np.append(self.t, chunk.t), np.concatenate([self.y[None], chunk.y])
            if leaps := self.misses.leaps(times, ends):
                chunk, self.held = chunk.first(leaps[0], 1.0 if bound > self.t else -1.0), True
        return self._told(chunk, runner)

    def _told(self, chunk: Chunk, runner: Engine) -> Chunk:
        """The steps up to an event, told to the recorder."""
        within: Callable[[Array], Array] = runner.within
        stop: Stop | None = None
        events = self.recorder.events
        if events is not None and len(chunk.t) and not events.took(chunk.kept):
            from robodyn.taylor.watched_steps import with_events

            given = events, self.mechanism, chunk, self.t, self.y, runner
            chunk, within, stop = with_events(*given)
        if len(chunk.t):
            self.t, self.y = float(chunk.t[-1]), chunk.y[-1]
            reach(self.actuation, self.t, self.y)
        self.recorder.chunk(chunk, self.t_end, within)
        if stop is not None:
            self.recorder.stop(stop)
        self.ahead = min(2 * self.ahead, self.most_ahead)
        return chunk

    def _held_by_stability(self, chunk: Chunk) -> bool:
        if chunk.status is not Status.FULL:
            self.recent.clear()
            return False
        self.recent.append(chunk)
        if sum(len(some.t) for some in self.recent) < STEPS:
            return False
        recent, self.recent = self.recent, []
        return held_by_stability(recent, self.t_end, self.recorder, self.rtol, self.atol)

    def _way_on(self, before: float, status: Status) -> Outcome | None:
        """How it goes on after steps from `before`; the outcome where it does not."""
        # a spring whose ends meet has no series there, and a motion that leads across
        steady = self.actuation.constants is not None and not self.mechanism.springs
        if self.t == self.t_end:
            return Outcome.FINISHED
        self.idle = self.idle + 1 if self.t == before else 0
        self.stuck = status in (Status.STUCK, Status.NOT_FINITE)
        if self.idle == MOST_IDLE or (self.stuck and self.closing is None and steady):
            return Outcome.STEP_TOO_SMALL
        self.crosses = status is Status.SINGULAR and self._at_change_point()
        if status is Status.SINGULAR:
            self.held = not self.crosses
        return None


def reach(actuation: Actuation, t: float, y: Array) -> None:
    """Tell a torque that depends on the run's steps that one of them ended on a kink."""
    if actuation.told is not None and (kink := kink_at(actuation.kinks, t)) is not None:
        actuation.told.reach(kink, y.tolist())
