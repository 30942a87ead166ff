"""Columns of simulated motions, and their derivatives by numbers of the scene and start values."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robodyn.errors import InputError, RobodynError
from robodyn.loops.assembly import assemble
from robodyn.loops.assembly_plan import with_independent
from robodyn.loops.closing import close_positions
from robodyn.loops.loop_rates import check_closed, loop_velocities
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.parameters.fit_problem import Problem
from robodyn.parameters.fitting import Fit, Wanted, as_target, solved
from robodyn.parameters.lane_states import compiled
from robodyn.simulation.run_torques import as_actuation
from robodyn.simulation.simulation import simulate
from robodyn.tables.arrays import Array

STARTS = 4  # runs take longer than states
TOLERANCE = 1e-10
STEP = 2.0**-15  # of differences, of a number's size
DOP853: dict[str, Any] = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-13}
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
    Joints `held` tell all others at `first`.
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
        self.held = list(with_independent(mechanism).actuated)
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

    Slopes are central differences of runs, of the series in machine code if that serves.
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
        self._code = compiled(formulas.inputs, [((len(wanted.nodes),), wanted.nodes)])
        self._how: dict[str, Any] = {
            "method": "taylor",
            "engine": "compiled",
            "rtol": 1e-15,
            "atol": 1e-15,
        }

    def __call__(self, changes: Array) -> tuple[Array, Array, Array, Array]:
        """Columns (S, T, c), their slopes (S, T, c, k); and that nothing is missing (S, T, 0)."""
        S, T, k = len(changes), len(self.times), len(self.own)
        found = np.full((S, T, len(self.wanted.nodes)), np.nan)
        slopes = np.full((*found.shape, k), np.nan)
        steps = STEP * np.where(self.own == 0.0, 1.0, np.abs(self.own))
        scene_itself = S == 1 and not np.any(changes)  # whose faults are told
        for i, each in enumerate(changes):
            try:
                found[i] = self._columns(each)
            except RobodynError:  # does not close, or is no scene
                if scene_itself:
                    raise
            if np.isfinite(found[i]).all():
                for j, h in enumerate(np.diag(steps)):
                    slopes[i, ..., j] = self._slope(each, found[i], h, steps[j])
        none = np.zeros((S, T, 0, k))
        return found, slopes, none[..., 0], none

    def _slope(self, changes: Array, here: Array, step: Array, h: float) -> Array:
        """The slope (T, c) along a step of size h: to one side at a bound of the number."""

        def at(times: float) -> Array | None:
            try:
                return self._columns(changes + times * step)
            except RobodynError:
                return None

        ahead, behind = at(1.0), at(-1.0)
        if ahead is not None and behind is not None:
            return (ahead - behind) / (2.0 * h)
        for side, one in ((1.0, ahead), (-1.0, behind)):
            if one is not None and (two := at(2.0 * side)) is not None:
                return side * (4.0 * one - 3.0 * here - two) / (2.0 * h)
        return np.full(here.shape, np.nan)

    def _columns(self, changes: Array) -> Array:
        """The columns (T, c) of one motion, nan beyond its end."""
        begun, times = self._begun(changes), self.times - self.times[0]
        torques = self.actuation
        if torques.remade is not None:
            torques = torques.remade(begun[0])
        given = (*begun, float(times[-1]), torques)
        try:
            run = simulate(*given, t_eval=times, **self._how)
        except InputError:  # machine code does not serve
            if self._how is DOP853:
                raise
            self._how = DOP853
            run = simulate(*given, t_eval=times, **self._how)
        x = np.full((len(times), len(self.wanted.formulas.inputs)), np.nan)
        x[: len(run.t), : 2 * self.mechanism.n] = np.hstack([run.q, run.qd])
        x[:, 2 * self.mechanism.n : x.shape[1] - len(self.order)] = 0.0
        x[:, x.shape[1] - len(self.order) :] = changes[self.order]
        return self._code(x)[0]

    def _begun(self, changes: Array) -> tuple[Mechanism, Array, Array]:
        """The mechanism, q and qd where it starts."""
        values, moved = dict(zip(self.names, self.own + changes, strict=True)), self.mechanism
        if self.order:
            numbers = {name: values[name] for name in self.wanted.formulas.names}
            moved = build(self.wanted.values.replaced(numbers))
        return moved, *self.begin.at(moved, values)
