"""Columns of simulated motions, and their derivatives by numbers of the scene and start values.

One run gives (q, qd) and d(q, qd)/dp, from the variational equations of `sensitivity.py`; columns
that are functions of q, qd and numbers follow by their tangents.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.named_numbers import named_values
from robodyn.engines.tangents import slopes_by, tangents
from robodyn.errors import InputError, RobodynError
from robodyn.loops.assembly import assemble
from robodyn.loops.closing import close_positions
from robodyn.loops.loop_rates import check_closed, loop_velocities
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.parameters.column_formulas import ColumnFormulas
from robodyn.parameters.fit_problem import Problem
from robodyn.parameters.fitting import Fit, as_target, checked, solved
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
    actuation, n = as_actuation(mechanism, tau), mechanism.n
    if times[0] and (mechanism.timed or any(_TIME.search(line) for line in actuation.lines)):
        limit = "must begin at 0: torques or loads depend on the time"
        raise InputError("t", value=times[0], limit=limit)
    begin = {"q": np.array(q, float)}
    begin["qd"] = np.zeros(len(begin["q"])) if qd is None else np.array(qd, float)
    whole = len(begin["q"]) == n
    if whole and (fault := check_closed(mechanism, begin["q"])):
        raise fault[1]
    first = close_positions(mechanism, begin["q"]) if whole else assemble(mechanism, begin["q"])
    if whole and len(begin["qd"]) < n:
        begin["qd"] = loop_velocities(mechanism, first, begin["qd"])
    kept, held = freedoms(mechanism, first)
    told = range(n) if whole else mechanism.actuated
    places = {}
    for name in vary:
        match = _START.fullmatch(name)
        if match and int(match[2]) - 1 in {*held} & {*told}:
            places[name] = match[1], int(match[2]) - 1
    numbers = {name: ends for name, ends in vary.items() if name not in places}
    values = checked(mechanism, numbers) if numbers else named_values(mechanism)
    for name in places:
        low, high = vary[name]
        if not low < high:
            raise InputError("--vary", value=f"{name}={low:g}:{high:g}", limit="needs LOW < HIGH")
    formulas = ColumnFormulas(mechanism, list(numbers), of)
    k = len(numbers)
    every = {name: values.number(name) for name in (*values.names, *numbers)}
    conditions = [formulas.condition(text, every) for text in subject_to]
    nodes = [*(formulas.column(name) for name in columns), *(node for node, _ in conditions)]
    known = [*formulas.state.inputs[: 2 * n], *(f"p{i}" for i in range(k))]
    slopes_of = tangents(nodes, list(formulas.inputs))
    for name, slope in zip([*columns, *subject_to], slopes_of, strict=True):
        if set(slope) - set(known):
            limit = "is no column of a motion here: q, qd, and positions and rates of points are"
            where = "--subject-to" if name in subject_to else "column"
            raise InputError(where, value=name, limit=limit)
    count = len(nodes)
    parts = [((count,), nodes), ((count, len(known)), slopes_by(nodes, known))]
    code = compiled(formulas.inputs, parts)
    own = np.array(
        [begin[places[x][0]][told.index(places[x][1])] if x in places else every[x] for x in vary]
    )
    order = [list(vary).index(name) for name in numbers]
    T, lanes = len(times), None
    if serves(mechanism, actuation):
        state = np.concatenate([first, np.zeros(n)])
        over = over_run(mechanism, actuation, state, float(times[-1] - times[0]), TOLERANCE)
        varied = [(x[0], held.index(x[1])) if (x := places.get(name)) else None for name in vary]
        sizes = np.where(own == 0.0, 1.0, np.abs(own))
        given = sizes, replace(actuation, leaves=over.leaves), times, TOLERANCE, kept, held
        lanes = LaneRuns(formulas, varied, *given)

    def begun(changes: Array) -> tuple[Mechanism, Array, Array]:
        """The mechanism, q and qd where it starts."""
        at = dict(zip(vary, own + changes, strict=True))
        moved = mechanism
        if numbers:
            moved = build(values.replaced({name: at[name] for name in numbers}))
        start = {kind: array.copy() for kind, array in begin.items()}
        for name, (kind, joint) in places.items():
            start[kind][told.index(joint)] = at[name]
        if not whole:
            joints = assemble(moved, start["q"])
            return moved, joints, loop_velocities(moved, joints, start["qd"])
        joints = close_positions(moved, start["q"], held)
        if fault := check_closed(moved, joints):
            raise fault[1]
        moving = replace(moved, actuated=tuple(held))
        return moved, joints, loop_velocities(moving, joints, start["qd"][held])

    def of_one(changes: Array) -> tuple[Array, Array]:
        """(q, qd) (T, 2n) and their derivatives (T, 2n, all of vary) of one run alone."""
        moved, joints, rates = begun(changes)
        run = simulate(
            moved,
            joints,
            rates,
            float(times[-1] - times[0]),
            tau,
            rtol=TOLERANCE,
            atol=TOLERANCE,
            t_eval=times - times[0],
            sensitivity=list(vary),
        )
        if len(run.t) < T or run.sensitivity is None:
            return np.full((T, 2 * n), np.nan), np.full((T, 2 * n, len(vary)), np.nan)
        return np.hstack([run.q, run.qd]), run.sensitivity

    def states(changes: Array) -> tuple[Array, Array, Array, Array]:
        S = len(changes)
        y, s = np.full((S, T, 2 * n), np.nan), np.full((S, T, 2 * n, len(vary)), np.nan)
        starts = np.full((2, S, n), np.nan)
        for i, each in enumerate(changes):
            try:
                _, *starts[:, i] = begun(each)
            except RobodynError:  # does not close
                if S == 1 and not np.any(each):
                    raise
        alone = np.isfinite(starts).all(axis=(0, 2))
        if lanes is not None and (lanes.fast or S >= FEW or len(kept) < len(mechanism.rows)):
            y, s = lanes(changes[:, order], *starts)
            alone &= ~np.isfinite(y[:, -1]).all(axis=1)
        if len(kept) < len(mechanism.rows):  # no run alone has derivatives
            if alone.any() and not np.any(changes):
                limit = "closures depend on one another: no stop, no dry friction, no torque or"
                limit += " load that switches, and no change point may be on the way"
                raise InputError("a fit of motions", where=mechanism.source, limit=limit)
            alone[:] = False
        for i in np.flatnonzero(alone).tolist():
            try:
                y[i], s[i] = of_one(changes[i])
            except RobodynError:  # cannot be differentiated there
                if S == 1 and not np.any(changes):
                    raise
        x = np.zeros((S, T, len(formulas.inputs)))
        x[..., : 2 * n] = y
        x[..., x.shape[-1] - k :] = changes[:, None, order]
        found, by = code(x.reshape(S * T, -1))
        slopes = by[..., : 2 * n] @ s.reshape(S * T, 2 * n, -1)
        slopes[..., order] += by[..., 2 * n :]
        none = np.zeros((S, T, 0))
        shape = (S, T, count)
        by_none = np.zeros((S, T, 0, len(vary)))
        return found.reshape(shape), slopes.reshape(*shape, -1), none, by_none

    wanted, first_of = as_target(target, T, len(columns)), set(known[: 2 * n])
    fixed = [not first_of & set(slope) for slope in slopes_of[len(columns) :]]
    turning, equal = [False] * len(columns), [x for _, x in conditions]
    problem = Problem(states, own, vary, wanted, turning, equal, fixed, TOLERANCE, 1)
    return solved(mechanism, values, problem, columns, subject_to, starts, seed, tell)
