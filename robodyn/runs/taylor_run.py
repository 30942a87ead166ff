"""Runs the Taylor integrator: steps onto kinks, crosses what is singular.

A series that starts close to a singular configuration drowns in rounding.  Steps land elsewhere if
they can; if they cannot, or a run starts there, DOP853, whose stages `change_points.py` serves,
leads across.  So it does past a change point that the loops miss, from where a torque has no
series, sqrt(t) at 0, and through a phase of contacts that machine code does not serve.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robodyn.loops.change_points import suspect_quality
from robodyn.loops.misses import FAR, Misses
from robodyn.loops.projection import float_closing
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import kink_at, next_stop
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.machine_motion import Status
from robodyn.runs.motion_columns import check_start
from robodyn.runs.recording import Recorder
from robodyn.runs.report import Outcome
from robodyn.runs.roots import NODES
from robodyn.runs.segments import Places, Segment
from robodyn.runs.settings import SCIPY_RTOL
from robodyn.runs.taylor_engine import Chunk, CompiledEngine, NoCodeError, states_along, states_at
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.runs.right_hand_side import RightHandSide
    from robodyn.runs.watch import Cut

KEPT = 32768  # steps whose series are kept at a time, of one link
MOST_LOOKED_AT = (
    1024  # steps that events are looked for in at a time: a run can be interrupted between
)
AHEAD = 4  # where an event ends the run, or a phase of it, at first
MOST_IDLE = 8  # rounds without a step, after which there is none
LEAD = 8  # steps of DOP853 away from where a torque has no series


@dataclass(eq=False)
class TaylorRun:
    """A run from (t, y) to t_end; `side` makes what DOP853 needs, where it is needed.

    `engines` keeps the engines of phases (None: machine code does not serve the phase) for the next
    one.  `met` are the change points that the run has met so far.
    """

    mechanism: Mechanism
    actuation: Actuation
    y: Array
    t_end: float
    recorder: Recorder
    rtol: float
    atol: float
    order: int | None
    project: bool
    max_step: float
    side: Callable[[], RightHandSide]
    engines: dict[Mechanism, CompiledEngine | None]
    met: Misses | None
    t: float = 0.0

    def __post_init__(self) -> None:
        mechanism = self.mechanism
        self.closing, self.misses, self.regular, self.far = None, None, 0.0, 0.0
        if self.project and mechanism.rows:
            self.closing, self.misses = float_closing(mechanism), self.met
            self.regular, self.far = 2.0 * suspect_quality(mechanism), FAR
        self.idle = 0  # times in a row that nothing led on
        events = self.recorder.events
        self.most_ahead = max(1, min(MOST_LOOKED_AT, KEPT // mechanism.n))
        # of steps at a time, those beyond the end are lost
        self.ahead = AHEAD if events is not None and events.may_end else self.most_ahead
        self.engine = self._engine()
        self.lead = 0.0 if self.engine else math.inf  # steps of DOP853 that come next, at least

    def _engine(self) -> CompiledEngine | None:
        mechanism = self.mechanism
        if mechanism not in self.engines:
            try:
                self.engines[mechanism] = CompiledEngine(
                    mechanism,
                    self.actuation,
                    rtol=self.rtol,
                    atol=self.atol,
                    order=self.order,
                    project=self.project,
                    work=len(self.y) > 2 * mechanism.n,
                )
            except NoCodeError:
                self.engines[mechanism] = None
        return self.engines[mechanism]

    def run(self) -> Outcome:
        """To the end; an event raises StopRun."""
        check_start(self.mechanism, self.actuation, self.t, self.y)
        while True:
            before, bound = self.t, self._bound()
            status, outcome = Status.FULL, None
            if self.lead or self.engine is None:
                outcome = self._by_dop853(bound)
            else:
                try:
                    status = self._advance(self.engine, bound).status
                except NoCodeError:  # of other torques than those at the start
                    status = Status.STUCK
            if outcome is None:
                outcome = self._way_on(before, status)
            if outcome is not None:
                return outcome

    def _bound(self) -> float:
        """Where the next steps end at the latest."""
        actuation = self.actuation
        if self.t_end < 0.0 and kink_at(actuation.jumps, self.t) is not None:
            self.t = math.nextafter(self.t, -math.inf)  # what is at a jump is what follows it
        bound = next_stop(actuation.stops, actuation.leaves, self.t, self.t_end)
        if abs(bound - self.t) > self.max_step:
            bound = self.t + math.copysign(self.max_step, self.t_end)
        return bound

    def _leads_on(self, t: float, y: Array) -> bool:
        """Whether the Taylor series may go on from t, y: closures are regular, no miss is near."""
        if self.closing is None:
            return True
        if self.closing(t, y.tolist())[1] < self.regular:
            return False
        return self.misses is None or self.misses.distance(y[: self.mechanism.n]) >= self.far

    @np.errstate(all="ignore")  # as of a run by it alone
    def _by_dop853(self, bound: float) -> Outcome | None:
        """Go on by DOP853 to where a series leads on, or the bound; the outcome if that fails."""
        from robodyn.runs.solvers import StiffError, solver_of

        before, least = self.t, self.lead
        tolerances = max(self.rtol, SCIPY_RTOL), self.atol
        way = self.t, self.y, bound
        solver = solver_of("DOP853", self.side(), way, tolerances, self.recorder, self.actuation)
        try:
            # where a rate is not finite at its start scipy has no first step, and looks for ever
            while solver.status == "running" and math.isfinite(getattr(solver, "h_abs", 0.0)):
                if solver.step() is not None:
                    break
                least -= 1
                if least <= 0 and self._leads_on(float(solver.t), solver.y):
                    break
        except StiffError:
            return Outcome.STIFF
        finally:
            self.recorder.end_solver(solver)
        self.t, self.y = float(solver.t), np.array(solver.y)
        if self.t != before:
            return None
        singular = (
            self.closing is not None and self.closing(self.t, self.y.tolist())[1] < self.regular
        )
        return Outcome.SINGULAR if singular else Outcome.STEP_TOO_SMALL

    def _advance(self, engine: CompiledEngine, bound: float) -> Chunk:
        """Some steps, less those beyond an event, which the recorder takes."""
        recorder, events = self.recorder, self.recorder.events
        left = recorder.max_evaluations - recorder.report.evaluations
        steps = max(1, min(engine.most, left + 1)) if self.max_step == math.inf else 1
        engine.keeps = events is not None
        steps = min(steps, self.ahead) if events is not None else steps
        chunk = engine.advance(self.t, self.y, bound, recorder.times_until(bound), steps)
        within: Callable[[Array], Array] = engine.within
        stop: Cut | None = None
        if events is not None and len(chunk.t):
            segment = series_segment(self.mechanism, engine, self.t, self.y, chunk)
            stop = events.look(segment)
            if stop is not None:
                chunk, within = up_to(chunk, segment, engine, stop)
        if len(chunk.t):
            self.t, self.y = float(chunk.t[-1]), chunk.y[-1]
            reach(self.actuation, self.t, self.y)
        recorder.chunk(chunk, self.t_end, within)
        if stop is not None:
            recorder.stop(stop)
        self.ahead = min(2 * self.ahead, self.most_ahead)
        return chunk

    def _way_on(self, before: float, status: Status) -> Outcome | None:
        """How it goes on after steps from `before`; the outcome where it does not."""
        if self.t == self.t_end:
            return Outcome.FINISHED
        self.idle = self.idle + 1 if self.t == before else 0
        stuck = status in (Status.STUCK, Status.NOT_FINITE)
        # a spring whose ends meet has no series there, and a motion that leads across
        steady = self.actuation.constants is not None and not self.mechanism.parted
        if self.idle == MOST_IDLE or (stuck and self.closing is None and steady):
            return Outcome.STEP_TOO_SMALL
        self.lead = LEAD if stuck else 0.0
        if status is Status.SINGULAR:
            self.lead = 1.0
            if self.misses is not None:
                self.misses.nearest(self.y[: self.mechanism.n])  # from here on it is known
        elif self.engine is None:
            self.lead = math.inf
        return None


def reach(actuation: Actuation, t: float, y: Array) -> None:
    """Tell a torque that depends on the run's steps that one of them ended on a kink."""
    if actuation.told is not None and (kink := kink_at(actuation.kinks, t)) is not None:
        actuation.told.reach(kink, y.tolist())


def series_segment(
    mechanism: Mechanism, engine: CompiledEngine, t: float, y: Array, chunk: Chunk
) -> Segment:
    """The steps of a chunk from the state y at t, with the states that their series have."""
    assert chunk.terms is not None
    terms, times = chunk.terms, np.concatenate([[t], chunk.t])
    states = np.concatenate([y[None], chunk.y])
    before, h = states[:-1], np.diff(times)

    def inside(places: Places, at: Array) -> Array:
        x = at - times[places]
        some = before[places], terms[..., places], x, x / h[places]
        return engine.closed(states_at(mechanism, *some), at)

    def sampled() -> Array:
        return states_along(mechanism, before, terms, h, NODES)

    def whole(j: int, at: float) -> Array:
        again = engine.dense(float(times[j]), states[j], float(times[j + 1]))
        return np.asarray(again(np.array([at]))[0])

    return Segment(times, states, inside, sampled, 2 * mechanism.n, whole)


def up_to(
    chunk: Chunk, segment: Segment, engine: CompiledEngine, stop: Cut
) -> tuple[Chunk, Callable[[Array], Array]]:
    """A chunk up to the event that ends it, and the states in its last step."""
    j, forward = int(segment.places(np.array([stop.t]))[0]), segment.forward
    states = engine.dense(float(segment.t[j]), segment.y[j], float(segment.t[j + 1]))
    before = chunk.row_t * forward <= stop.t * forward
    ends, y = np.append(chunk.t[:j], stop.t), np.concatenate([chunk.y[:j], stop.y[None]])
    return Chunk(ends, y, chunk.row_t[before], chunk.row_y[before], Status.FULL), states
