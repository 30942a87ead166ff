"""Columns of simulated motions, and their derivatives by numbers of the scene and start values.

One run gives (q, qd) and d(q, qd)/dp, from variational equations; columns
that are functions of q, qd and numbers follow by their tangents.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from robodyn.engines.tangents import slopes_by
from robodyn.errors import InputError, RobodynError
from robodyn.loops.assembly import assemble
from robodyn.loops.closing import close_positions
from robodyn.loops.loop_rates import check_closed, loop_velocities
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.parameters.fit_problem import Problem
from robodyn.parameters.fitting import Fit, Wanted, as_target, solved
from robodyn.parameters.lane_runs import LaneRuns, freedoms, serves
from robodyn.parameters.lane_states import compiled
from robodyn.simulation.run_torques import as_actuation, over_run
from robodyn.simulation.simulation import simulate
from robodyn.tables.arrays import Array

STARTS = 4  # runs take longer than states
TOLERANCE = 1e-10
FEW = 4  # runs that numpy steps side by side no sooner than each alone
_TIME = re.compile(r"\bt\b")
_START = re.compile(r"(qd?)([1-9][0-9]*)", re.ASCII)


def fit_motion(
    mechanism: Mechanism,
    vary: Mapping[str, tuple[float, float]],
    columns: Sequence[str],
    t: ArrayLike,
    q: ArrayLike,
    qd: ArrayLike | None = None,
    tau: Sequence[float] | str | Actuation | None = None,
    *,
    target: ArrayLike | None = None,
    of: Sequence[str] = (),
    subject_to: Sequence[str] = (),
    starts: int = STARTS,
    seed: int = 0,
    tell: Callable[[float], object] = lambda part: None,
) -> Fit:
    """As `fit`, of columns of the motion that begins at t[0] with q, qd (a,) of actuated joints.

    Or q, qd (n,) of all joints, as those that are neither actuated nor in loops need.  Columns are
    q1.., qd1.. and those of `points`, but accelerations; names of `vary` may be start values q1,
    qd1 of joints that do not follow others; tau is as of `simulate`.
    """
    times = np.asarray(t, float)
    if times.ndim != 1 or len(times) < 2 or not (np.diff(times) > 0.0).all():
        raise InputError("t", limit="must be two times or more that increase")
    actuation = as_actuation(mechanism, tau)
    if times[0] and (mechanism.timed or any(_TIME.search(line) for line in actuation.lines)):
        limit = "must begin at 0: torques or loads depend on the time"
        raise InputError("t", value=times[0], limit=limit)
    begin = _Begin(mechanism, vary, q, qd)
    numbers = {name: ends for name, ends in vary.items() if name not in begin.places}
    wanted = Wanted(mechanism, numbers, columns, of, subject_to)
    for name in begin.places:
        low, high = vary[name]
        if not low < high:
            raise InputError("--vary", value=f"{name}={low:g}:{high:g}", limit="needs LOW < HIGH")
    own = [begin.value(x) if x in begin.places else wanted.numbers[x] for x in vary]
    motions = _Motions(wanted, begin, list(vary), np.array(own), actuation, times)
    to, turning = as_target(target, len(times), len(columns)), [False] * len(columns)
    alone = wanted.alone(motions.known[: 2 * mechanism.n])
    problem = Problem(
        motions, motions.own, vary, to, turning, wanted.equal, alone, TOLERANCE, finished=1
    )
    return solved(wanted, problem, starts, seed, tell)


class _Begin:
    """Where motions begin: q and qd of all joints (`whole`), or of the actuated ones.

    `places` are start values among the names of `vary`, each with its kind, q or qd, and its joint.
    The rows `kept` of closures have the others' meaning; joints `held` tell all others at `first`.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        vary: Iterable[str],
        q: ArrayLike,
        qd: ArrayLike | None,
    ) -> None:
        n, joints = mechanism.n, np.array(q, float)
        rates = np.zeros(len(joints)) if qd is None else np.array(qd, float)
        self.whole = len(joints) == n
        if self.whole and (fault := check_closed(mechanism, joints)):
            raise fault[1]
        self.first = (close_positions if self.whole else assemble)(mechanism, joints)
        if self.whole and len(rates) < n:
            rates = loop_velocities(mechanism, self.first, rates)
        self.mechanism, self.given = mechanism, {"q": joints, "qd": rates}
        self.kept, self.held = freedoms(mechanism, self.first)
        self.joints = list(range(n) if self.whole else mechanism.actuated)  # of what is given
        self.places: dict[str, tuple[str, int]] = {}
        for name in vary:
            match = _START.fullmatch(name)
            if match and int(match[2]) - 1 in {*self.held} & {*self.joints}:
                self.places[name] = match[1], int(match[2]) - 1

    def value(self, name: str) -> float:
        """A start value as it is given."""
        kind, joint = self.places[name]
        return float(self.given[kind][self.joints.index(joint)])

    def at(self, moved: Mechanism, values: Mapping[str, float]) -> tuple[Array, Array]:
        """q and qd (n,) of a mechanism with other numbers, and with these start values."""
        start = {kind: array.copy() for kind, array in self.given.items()}
        for name, (kind, joint) in self.places.items():
            start[kind][self.joints.index(joint)] = values[name]
        if not self.whole:
            q = assemble(moved, start["q"])
            return q, loop_velocities(moved, q, start["qd"])
        q = close_positions(moved, start["q"], self.held)
        if fault := check_closed(moved, q):
            raise fault[1]
        moving = replace(moved, actuated=tuple(self.held))
        return q, loop_velocities(moving, q, start["qd"][self.held])


class _Motions:
    """Columns at the times (T,) of motions, by changes of what varies, whose own values are `own`.

    All motions advance as lanes where these serve, else each is a run of its own.
    """

    def __init__(
        self,
        wanted: Wanted,
        begin: _Begin,
        names: list[str],
        own: Array,
        actuation: Actuation,
        times: Array,
    ) -> None:
        self.wanted, self.begin, self.names, self.own = wanted, begin, names, own
        self.actuation, self.times = actuation, times
        formulas, self.mechanism, n = wanted.formulas, begin.mechanism, begin.mechanism.n
        self.order = [names.index(x) for x in formulas.names]  # of numbers, among all names
        p = (f"p{i}" for i in range(len(self.order)))
        self.known = [*formulas.state.inputs[: 2 * n], *p]
        for i, (name, by) in enumerate(zip(wanted.names, wanted.by, strict=True)):
            if by - set(self.known):
                limit = "is no column of a motion here: q, qd, and positions and rates of points"
                condition = i >= len(wanted.names) - len(wanted.equal)
                what = "--subject-to" if condition else "column"
                raise InputError(what, value=name, limit=limit + " are")
        nodes, count = wanted.nodes, len(wanted.nodes)
        slopes = ((count, len(self.known)), slopes_by(nodes, self.known))
        self._code = compiled(formulas.inputs, [((count,), nodes), slopes])
        self._lanes = self._as_lanes() if serves(self.mechanism, actuation) else None

    @property
    def duration(self) -> float:
        """How long a motion is, s."""
        return float(self.times[-1] - self.times[0])

    def _as_lanes(self) -> LaneRuns:
        begin, state = self.begin, np.concatenate([self.begin.first, np.zeros(self.mechanism.n)])
        over = over_run(self.mechanism, self.actuation, state, self.duration, TOLERANCE)
        places = (begin.places.get(name) for name in self.names)
        varied = [(x[0], begin.held.index(x[1])) if x else None for x in places]
        sizes = np.where(self.own == 0.0, 1.0, np.abs(self.own))
        torques = replace(self.actuation, leaves=over.leaves)
        given = sizes, torques, self.times, TOLERANCE, begin.kept, begin.held
        return LaneRuns(self.wanted.formulas, varied, *given)

    def __call__(self, changes: Array) -> tuple[Array, Array, Array, Array]:
        """Columns (S, T, c), their slopes (S, T, c, k); and that nothing is missing (S, T, 0)."""
        S, T, n = len(changes), len(self.times), self.mechanism.n
        y, s = self._states(changes)
        x = np.zeros((S, T, len(self.wanted.formulas.inputs)))
        x[..., : 2 * n] = y
        x[..., x.shape[-1] - len(self.order) :] = changes[:, None, self.order]
        found, by = self._code(x.reshape(S * T, -1))
        slopes = by[..., : 2 * n] @ s.reshape(S * T, 2 * n, -1)
        slopes[..., self.order] += by[..., 2 * n :]
        shape, none = (S, T, found.shape[-1]), np.zeros((S, T, 0, len(self.own)))
        return found.reshape(shape), slopes.reshape(*shape, -1), none[..., 0], none

    def _states(self, changes: Array) -> tuple[Array, Array]:
        """(q, qd) (S, T, 2n) and their derivatives (S, T, 2n, k); nan where there are none."""
        S, T, n = len(changes), len(self.times), self.mechanism.n
        scene_itself = S == 1 and not np.any(changes)  # whose faults are told
        y, s = np.full((S, T, 2 * n), np.nan), np.full((S, T, 2 * n, len(self.own)), np.nan)
        starts = np.full((2, S, n), np.nan)
        for i, each in enumerate(changes):
            try:
                _, *starts[:, i] = self._begun(each)
            except RobodynError:  # does not close
                if scene_itself:
                    raise
        alone = np.isfinite(starts).all(axis=(0, 2))
        dependent = len(self.begin.kept) < len(self.mechanism.rows)
        if self._lanes is not None and (self._lanes.fast or S >= FEW or dependent):
            y, s = self._lanes(changes[:, self.order], *starts)
            alone &= ~np.isfinite(y[:, -1]).all(axis=1)
        if dependent:  # no run alone has derivatives
            if alone.any() and not np.any(changes):
                limit = "closures depend on one another: no stop, no dry friction, no torque or"
                limit += " load that switches, and no change point may be on the way"
                raise InputError("a fit of motions", where=self.mechanism.source, limit=limit)
            return y, s
        for i in np.flatnonzero(alone).tolist():
            try:
                y[i], s[i] = self._alone(changes[i])
            except RobodynError:  # cannot be differentiated there
                if scene_itself:
                    raise
        return y, s

    def _begun(self, changes: Array) -> tuple[Mechanism, Array, Array]:
        """The mechanism, q and qd where it starts."""
        values, moved = dict(zip(self.names, self.own + changes, strict=True)), self.mechanism
        if self.order:
            numbers = {name: values[name] for name in self.wanted.formulas.names}
            moved = build(self.wanted.values.replaced(numbers))
        return moved, *self.begin.at(moved, values)

    def _alone(self, changes: Array) -> tuple[Array, Array]:
        """(q, qd) (T, 2n) and their derivatives (T, 2n, k) of one run."""
        run = simulate(
            *self._begun(changes),
            self.duration,
            self.actuation,
            rtol=TOLERANCE,
            atol=TOLERANCE,
            t_eval=self.times - self.times[0],
            sensitivity=self.names,
        )
        if len(run.t) < len(self.times) or run.sensitivity is None:
            return np.array(np.nan), np.array(np.nan)
        return np.hstack([run.q, run.qd]), run.sensitivity
