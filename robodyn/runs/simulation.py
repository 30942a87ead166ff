"""`simulate`: forward simulation, and the `Motion` that it returns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics import dynamics
from robodyn.dynamics.joint_vectors import full, vectors
from robodyn.errors import InputError, printable
from robodyn.mechanics import placed
from robodyn.mechanics.actuation import Actuation, CallerError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.differences import Numbers, columns, sensitivities, tell
from robodyn.runs.event_functions import event_function, event_functions, must_be_text
from robodyn.runs.march import Run, run
from robodyn.runs.motion_columns import (
    applied_torques,
    as_actuation,
    motion_columns,
    motion_values,
)
from robodyn.runs.readers import joined
from robodyn.runs.report import Outcome, Report
from robodyn.runs.segments import Segment
from robodyn.runs.settings import (
    BAUMGARTE,
    MAX_EVALUATIONS,
    NO_ENGINE,
    Settings,
)
from robodyn.runs.state_columns import StateColumns
from robodyn.runs.torques_over_time import over_run
from robodyn.runs.watch import Event, EventWatch
from robodyn.scene.constants import check_apart
from robodyn.tables.arrays import Array
from robodyn.tables.named_columns import Columns

UNTIL = "until"  # the name of the event that ends a run


@dataclass(eq=False, repr=False)
class Motion:
    """A simulated motion: t (T,) in s and q, qd, tau (T, n), with outcome, events and report.

    `sensitivity` (T, 2n, k) are derivatives of (q, qd) by k named numbers.  `errors` (T, m) are
    q_ref - q of the actuated joints under a controller.
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
    _again: Callable[[], Run] | None  # makes the same run once more
    sensitivity: Array | None = None
    errors: Array | None = None
    _further: Columns = field(default_factory=Columns)

    @cached_property
    def report(self) -> Report:
        """The report of the run; its statistics are computed at the first access."""
        return self._settle()

    def __getstate__(self) -> dict[str, object]:
        made = {"report": self.report, "events": list(self.events)}
        kept = {name: value for name, value in vars(self).items() if name != "_segments"}
        return {**kept, **made, "_settle": None, "_again": None}

    def at(self, t: ArrayLike) -> tuple[Array, Array]:
        """Return q and qd (..., n) at any times t (...) within the run (s).

        The first call integrates the run again and keeps all its steps.  At an impact the rates are
        those before it.  Raises InputError if a time is outside the run or not a number, and for a
        motion that was pickled.
        """
        times = placed.numbers("t", t)
        first, last = self._segments[0].t[0], self._segments[-1].t[-1]
        low, high = min(first, last), max(first, last)
        inside = (times >= low) & (times <= high)
        if not inside.all():
            outside = float(times[~inside].flat[0])
            limit = f"must be within the run, {low:.9g} to {high:.9g} s"
            raise InputError("t", value=outside, limit=limit)
        forward, n = self._segments[0].forward, self.mechanism.n
        ends = np.array([segment.end for segment in self._segments]) * forward
        place = np.minimum(np.searchsorted(ends, times.ravel() * forward), len(ends) - 1)
        states = np.empty((times.size, 2 * n))
        for k in np.unique(place).tolist():
            here = place == k
            states[here] = self._segments[k].at(times.ravel()[here])[:, : 2 * n]
        states = states.reshape(*times.shape, 2 * n)
        return states[..., :n], states[..., n:]

    @cached_property
    def _segments(self) -> list[Segment]:
        """The segments of the run, integrated again, with states between steps."""
        if self._again is None:
            raise InputError("at", limit="a motion that was pickled has its rows alone")
        run = self._again()
        segments: list[Segment] = []
        begun = Segment(np.array([0.0, 0.0]), np.stack([run.y, run.y]))
        try:
            for segment in run.segments(keeps=True):
                if not len(segment):  # of a leg that takes no time
                    continue
                middle = segment.t[:1] + 0.5 * (segment.t[1] - segment.t[0])
                segment.at(middle)  # by the torques of now, which legs after it may change
                segments.append(segment)
        except CallerError as failed:
            raise failed.error from None
        return segments or [begun]

    @cached_property
    def qdd(self) -> Array:
        """The accelerations (T, n) in rad/s^2 or m/s^2, computed at the first access."""
        states = self.in_phases(self.q, self.qd, self.tau, self.t)
        return np.concatenate([dynamics.motion_dynamics(moving, *x).qdd for moving, *x in states])

    def in_phases(self, *values: Array) -> Iterator[tuple[Any, ...]]:
        """Yield the moving mode of each phase and the rows of `values` in it."""
        if not self.mechanism.switches or not self.phases:
            yield self.mechanism, *values
            return
        ends = np.cumsum([count for count, _ in self.phases])[:-1]
        parts = (np.split(x, ends) for x in values)
        yield from zip((moving for _, moving in self.phases), *parts, strict=True)

    def to_dict(self) -> Columns:
        """Return the columns (T,) by name, as `robodyn simulate` writes them.

        The dict is accepted by pandas.DataFrame and polars.DataFrame.
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
    """Simulate the motion from the state q, qd (n,) at t = 0 to t_end (s; negative: backwards).

    q and qd may be of the actuated joints alone: the others are assembled.

    `tau` is constants, an expression such as "2*sin(3*t)", a function tau(t, q, qd), or None.  It
    gives torques (N m, or N) of all joints or of the actuated ones.  An exception of the function
    ends the run and is raised unchanged; if the function returns nan, a shorter step is tried.
    Rows are at `t_eval`, or at the accepted steps if it is None.

    `method` is one of scipy's, or "taylor": machine code, with the extra `fast`.  Its `order`
    follows from the tolerance unless given.  `events` are expressions by name, {"apex": "qd1",
    "high": "q1 > 90deg"}. `motion.events` tells when each crosses zero or becomes true.  The run
    ends when `until` does.  `sensitivity` names numbers of the scene and start values,
    ["links.forearm.m", "q1"].  `motion.sensitivity` has the derivatives by them (nan where
    withheld), `motion.report` their errors.

    A run that does not finish raises nothing: `motion.outcome` tells why, and the motion holds what
    was computed.  Raises InputError for wrong arguments, including a state that does not close.
    """
    if engine is not None:
        raise InputError("engine", value=engine, limit=NO_ENGINE)
    given = vectors(mechanism, q=q, qd=qd)
    for name, (values, _) in given.items():
        if values.ndim != 1:
            raise InputError(f"{name}.shape", value=values.shape, limit="must be of one state")
    state = np.concatenate(list(full(mechanism, given, t=0.0).values()))
    t_end = float(t_end)
    actuation = over_run(mechanism, as_actuation(mechanism, tau), state, t_end, atol)
    times = None if t_eval is None else np.asarray(t_eval, float)
    watch = watched_events(mechanism, events or {}, until, t_end)
    numbers = None
    if sensitivity:
        texts = {"until": until or "", "events": ", ".join((events or {}).values())}
        texts["tau"] = tau if isinstance(tau, str) else ""
        check_apart(mechanism.description.constants, sensitivity, texts)
        numbers = Numbers(mechanism, sensitivity, state)
    most: Any = max_evals  # which settings make whole
    settings = Settings(method, rtol, atol, stabilize, BAUMGARTE, most, order, max_step)
    of, n = (mechanism, state, t_end, actuation, settings), mechanism.n

    def again() -> Run:
        return Run(*of, watched_events(mechanism, {}, until, t_end))

    rows: list[tuple[Array, Array, Mechanism]] = []
    try:
        outcome, record = run(*of, lambda *row: rows.append(row), times, events=watch)
        happened: Sequence[Event] = [] if watch is None else watch.events
        if record.contacts:
            happened = sorted([*happened, *record.contacts], key=lambda event: abs(event.t))
        none = np.zeros(0), np.zeros((0, len(state)))
        t, y = joined([(t, y) for t, y, _ in rows] or [none])
        torques = applied_torques(mechanism, actuation, t, y)
        errors = None if actuation.control is None else actuation.control.errors(t, y)
        phases = [(len(t), moving) for t, _, moving in rows]
        motion = Motion(
            t,
            y[:, :n],
            y[:, n : 2 * n],
            torques,
            outcome,
            mechanism,
            phases,
            happened,
            record.settle,
            again,
            errors=errors,
        )
        if numbers is not None:
            report = motion.report  # of a controller before it leads other runs
            derivatives = sensitivities(numbers, actuation, settings, t)
            motion.sensitivity = derivatives.values
            names_of = columns(n, derivatives.names)
            motion._further.update(zip(names_of, derivatives.flat.T, strict=True))
            moving = motion.phases[-1][1] if motion.phases else mechanism
            tell(report, derivatives, watch, moving, t, y, torques)
        return motion
    except CallerError as failed:
        error = failed.error
    raise error


def watched_events(
    mechanism: Mechanism, events: Mapping[str, str], until: str | None, t_end: float
) -> EventWatch | None:
    """Return the watch for events and for `until`; None if there are neither.

    Raises InputError for a text that is no event.
    """
    if not events and until is None:
        return None
    own = StateColumns(mechanism)
    functions = event_functions(mechanism, events, own)
    if until is not None:
        must_be_text(UNTIL, until)
        functions = *functions, event_function(mechanism, UNTIL, until, UNTIL, own)
    computed = own if any(x.computed for x in functions) else None
    return EventWatch(functions, t_end, until is not None, 2 * mechanism.n, computed)
