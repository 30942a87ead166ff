"""Steps of the Taylor series, with DOP853 across states that have no usable series.

A series that starts close to a singular configuration loses its digits to rounding.  Steps avoid
such starts if they can.  If they cannot, or if a run starts there, DOP853 leads across, with stages
served by `change_points.py`.  DOP853 also leads past change points that the loops miss, away from
times without a series of the torque (sqrt(t) at 0), and through contact modes that machine code
does not serve.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn.loops.change_points import suspect_quality
from robodyn.loops.misses import FAR
from robodyn.loops.projection import float_closing
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import kink_at, next_stop
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.legs import Leg
from robodyn.runs.machine_motion import Status
from robodyn.runs.motion_columns import check_start
from robodyn.runs.report import Outcome
from robodyn.runs.roots import NODES
from robodyn.runs.segments import Places, Segment
from robodyn.runs.series_engine import Chunk, NoCodeError, SeriesEngine, states_along, states_at
from robodyn.runs.settings import SCIPY_RTOL
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.runs.solvers import SolverSteps

KEPT = 32768  # steps whose series are kept at a time, of one link
MOST_LOOKED_AT = (
    1024  # steps that events are looked for in at a time: a run can be interrupted between
)
AHEAD = 4  # where an event ends the run, or a phase of it, at first
MOST_IDLE = 8  # rounds without a step, after which there is none
LEAD = 8  # steps of DOP853 away from where a torque has no series


class SeriesSteps:
    """Steps of the Taylor series along a leg, as segments.

    `due(bound)` returns the output times up to a bound.
    """

    def __init__(self, leg: Leg, due: Callable[[float], Array]) -> None:
        self.leg, self.due, self.system = leg, due, leg.system
        self.t, self.y, self.t_end = leg.t, leg.y, leg.t_end
        self.mechanism, self.actuation = self.system.mechanism, self.system.actuation
        self.longest = float(self.system.settings.max_step)
        self.closing, self.misses, self.regular, self.far = None, None, 0.0, 0.0
        if self.system.projects:
            self.closing, self.misses = float_closing(self.mechanism), self.system.misses
            self.regular, self.far = 2.0 * suspect_quality(self.mechanism), FAR
        self.outcome: Outcome | None = None
        self.evaluations = 0
        self.reached: tuple[float, Array] | None = None  # of which listeners do not know yet
        self.idle = 0  # times in a row that nothing led on
        self.bound = self.t  # until where the next steps may go
        self.most_ahead = max(1, min(MOST_LOOKED_AT, KEPT // self.mechanism.n))
        # of steps at a time, those beyond the end are lost
        self.ahead = AHEAD if leg.may_end else self.most_ahead
        self.leading: SolverSteps | None = None  # across what has no series
        # steps of DOP853 that come next, at least
        self.lead = 0.0 if self.system.engine else math.inf
        check_start(self.mechanism, self.actuation, self.t, self.y)

    def advance(self, left: float) -> Segment | None:
        """Return the next steps, or None if there are none; `outcome` then says why.

        The segment ends soon after more than `left` evaluations.
        """
        if self.reached is not None:
            self.leave(*self.reached)
        segment: Segment | None = None
        while segment is None and self.outcome is None:
            before, bound, status = self.t, self._bound(), Status.FULL
            if self.leading or self.lead or self.system.engine is None:
                segment = self._by_dop853(bound, left)
            else:
                try:
                    segment, status = self._by_series(self.system.engine, bound, left)
                except NoCodeError:  # of other torques than those at the start
                    status = Status.STUCK
            if self.outcome is None and self.leading is None:
                self.outcome = self._way_on(before, status)
        return segment

    def leave(self, t: float, y: Array) -> None:
        """Continue from state y at t; tell torques with a memory if t is a kink."""
        self.reached = None
        reach(self.actuation, t, y)

    def _bound(self) -> float:
        """Return the latest time at which the next steps must end.

        It stands until it is reached: where rows are asked for is no part of the motion.
        """
        actuation = self.actuation
        if self.t_end < 0.0 and kink_at(actuation.jumps, self.t) is not None:
            self.t = math.nextafter(self.t, -math.inf)  # what is at a jump is what follows it
        longest = self.longest
        ahead = (self.bound - self.t) * math.copysign(1.0, self.t_end)
        if ahead <= 0.0 or longest < math.inf:
            self.bound = next_stop(actuation.stops, actuation.leaves, self.t, self.t_end)
            if abs(self.bound - self.t) > longest:
                self.bound = self.t + math.copysign(longest, self.t_end)
        return self.bound

    def _leads_on(self, t: float, y: Array) -> bool:
        """Return whether a series may start at (t, y).

        The closures must be regular, and no missed change point may be near.
        """
        if self.closing is None:
            return True
        if self.closing(t, y.tolist())[1] < self.regular:
            return False
        return self.misses is None or self.misses.distance(y[: self.mechanism.n]) >= self.far

    @np.errstate(all="ignore")  # as of a run by it alone
    def _by_dop853(self, bound: float, left: float) -> Segment | None:
        """Return steps of DOP853, up to a state from which a series may start.

        Sets the outcome if DOP853 fails.
        """
        from robodyn.runs.solvers import SolverSteps

        if self.leading is None:
            leg = self.leg._replace(t=self.t, y=self.y, t_end=bound, keeps=False)
            self.leading = SolverSteps(leg, "DOP853", max(self.system.settings.rtol, SCIPY_RTOL))
        leading, done = self.leading, self.leading.evaluations

        def enough(solver: Any) -> bool:
            self.lead -= 1
            return self.lead <= 0 and self._leads_on(float(solver.t), solver.y)

        segment = leading.advance(left, enough)
        self.evaluations += leading.evaluations - done
        solver = leading.solver
        self.t, self.y = float(solver.t), np.array(solver.y)
        led = self.lead <= 0 and self._leads_on(self.t, self.y)
        if segment is not None and solver.status == "running" and not led:
            return segment
        self.leading = None
        if leading.outcome is Outcome.STIFF:
            self.outcome = leading.outcome
        elif segment is None:
            lost = self.closing and self.closing(self.t, self.y.tolist())[1] < self.regular
            self.outcome = Outcome.SINGULAR if lost else Outcome.STEP_TOO_SMALL
        return segment

    def _by_series(
        self, engine: SeriesEngine, bound: float, left: float
    ) -> tuple[Segment | None, Status]:
        """Return some steps of the series (None if none succeeded) and their status."""
        free = self.longest == math.inf
        steps = int(max(1, min(engine.most, left + 1))) if free else 1
        engine.keeps = self.leg.keeps
        steps = min(steps, self.ahead) if self.leg.keeps else steps
        t, y = self.t, self.y
        chunk = engine.advance(t, y, bound, self.due(bound), steps)
        self.evaluations += len(chunk.t)
        self.ahead = min(2 * self.ahead, self.most_ahead)
        if not len(chunk.t):
            return None, chunk.status
        self.t, self.y = self.reached = float(chunk.t[-1]), chunk.y[-1]
        return series_segment(self.mechanism, engine, t, y, chunk), chunk.status

    def _way_on(self, before: float, status: Status) -> Outcome | None:
        """Choose the next stepper after steps from time `before`; return a final outcome.

        Returns None if the run goes on.
        """
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
        elif self.system.engine is None:
            self.lead = math.inf
        return None


def reach(actuation: Actuation, t: float, y: Array) -> None:
    """Tell a torque with a memory that a step ended on a kink."""
    if actuation.listener is not None and (kink := kink_at(actuation.kinks, t)) is not None:
        actuation.listener.reach(kink, y.tolist())


def series_segment(
    mechanism: Mechanism, engine: SeriesEngine, t: float, y: Array, chunk: Chunk
) -> Segment:
    """Return the segment of a chunk of steps from state y at t.

    If the chunk has the terms of its series, states between steps come from these.
    """
    terms, count = chunk.terms, len(chunk.t)
    times, states = np.empty(count + 1), np.empty((count + 1, len(y)))
    times[0], times[1:], states[0], states[1:] = t, chunk.t, y, chunk.y

    def whole(j: int, at: Array) -> Array:
        return engine.dense(float(times[j]), states[j], float(times[j + 1]))(at)

    rows = chunk.row_t, chunk.row_y
    if terms is None:
        return Segment(times, states, whole=whole, rows=rows)
    before, h = states[:-1], np.diff(times)

    def inside(places: Places, at: Array) -> Array:
        x = at - times[places]
        some = before[places], terms[..., places], x, x / h[places]
        return engine.closed(states_at(mechanism, *some), at)

    def sampled() -> Array:
        return states_along(mechanism, before, terms, h, NODES)

    return Segment(times, states, inside, sampled, 2 * mechanism.n, whole, rows)
