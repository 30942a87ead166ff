"""Columns of simulated motions, and their derivatives by numbers of the scene and start values.

One run gives (q, qd) and d(q, qd)/dp, from the variational equations of `sensitivity.py`; columns
that are functions of q, qd and numbers follow by their tangents.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.named_numbers import named_values
from robodyn.engines.tangents import slopes_by, tangents
from robodyn.errors import InputError, RobodynError
from robodyn.loops.assembly import assemble
from robodyn.loops.loop_rates import loop_velocities
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.parameters.column_formulas import ColumnFormulas
from robodyn.parameters.fit_problem import Problem
from robodyn.parameters.fitting import Fit, as_target, checked, solved
from robodyn.parameters.lane_states import compiled
from robodyn.simulation.simulation import simulate

Array = NDArray[np.float64]

STARTS = 4  # runs take longer than states
TOLERANCE = 1e-10
_START = re.compile(r"(qd?)([1-9][0-9]*)", re.ASCII)


def fit_motion(
    mechanism: Mechanism,
    vary: Mapping[str, tuple[float, float]],
    columns: Sequence[str],
    t: ArrayLike,
    q: ArrayLike,
    qd: ArrayLike | None = None,
    tau: Sequence[float] | str | None = None,
    *,
    target: ArrayLike | None = None,
    of: Sequence[str] = (),
    starts: int = STARTS,
    seed: int = 0,
    tell: Callable[[float], object] = lambda part: None,
) -> Fit:
    """As `fit`, of columns of the motion that begins at t[0] with q, qd (a,) of actuated joints.

    Columns are q1.., qd1.. and those of `points`, but accelerations; names of `vary` may be start
    values q1, qd1 of actuated joints too; tau is as of `simulate`.
    """
    times = np.asarray(t, float)
    if times.ndim != 1 or len(times) < 2 or not (np.diff(times) > 0.0).all():
        raise InputError("t", limit="must be two times or more that increase")
    places = {}
    for name in vary:
        match = _START.fullmatch(name)
        if match and int(match[2]) - 1 in mechanism.actuated:
            places[name] = match[1], mechanism.actuated.index(int(match[2]) - 1)
    numbers = {name: ends for name, ends in vary.items() if name not in places}
    values = checked(mechanism, numbers) if numbers else named_values(mechanism)
    for name in places:
        low, high = vary[name]
        if not low < high:
            raise InputError("--vary", value=f"{name}={low:g}:{high:g}", limit="needs LOW < HIGH")
    width = len(mechanism.actuated)
    begin = {
        name: np.zeros(width) if given is None else np.array(given, float)
        for name, given in (("q", q), ("qd", qd))
    }
    formulas = ColumnFormulas(mechanism, list(numbers), of)
    n, k = mechanism.n, len(numbers)
    nodes = [formulas.column(name) for name in columns]
    known = [*formulas.state.inputs[: 2 * n], *(f"p{i}" for i in range(k))]
    for name, slope in zip(columns, tangents(nodes, list(formulas.inputs)), strict=True):
        if set(slope) - set(known):
            limit = "is no column of a motion here: q, qd, and positions and rates of points are"
            raise InputError("column", value=name, limit=limit)
    count = len(nodes)
    parts = [((count,), nodes), ((count, len(known)), slopes_by(nodes, known))]
    code = compiled(formulas.inputs, parts)
    own = np.array(
        [begin[places[x][0]][places[x][1]] if x in places else values.number(x) for x in vary]
    )
    order = [list(vary).index(name) for name in numbers]

    def of_one(changes: Array) -> tuple[Array, Array]:
        """The columns (T, c) and their derivatives (T, c, all of vary)."""
        at = dict(zip(vary, own + changes, strict=True))
        moved = mechanism
        if numbers:
            moved = build(values.replaced({name: at[name] for name in numbers}))
        start = {kind: array.copy() for kind, array in begin.items()}
        for name, (kind, joint) in places.items():
            start[kind][joint] = at[name]
        joints = assemble(moved, start["q"])
        rates = loop_velocities(moved, joints, start["qd"])
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
        T = len(times)
        found, slopes = np.full((T, count), np.nan), np.full((T, count, len(vary)), np.nan)
        if len(run.t) == T and run.sensitivity is not None:
            x = np.zeros((T, len(formulas.inputs)))
            x[:, : 2 * n] = np.hstack([run.q, run.qd])
            x[:, x.shape[1] - k :] = changes[order]
            found, by = code(x)
            slopes = by[..., : 2 * n] @ run.sensitivity
            slopes[..., order] += by[..., 2 * n :]
        return found, slopes

    def states(changes: Array) -> tuple[Array, Array, Array, Array]:
        found: list[Array] = []
        slopes: list[Array] = []
        for each in changes:
            try:
                one, by = of_one(each)
            except RobodynError:  # does not close, or cannot be differentiated there
                if not found and len(changes) == 1 and not np.any(each):
                    raise
                one = np.full((len(times), count), np.nan)
                by = np.full((len(times), count, len(vary)), np.nan)
            found.append(one)
            slopes.append(by)
        none = np.zeros((len(changes), len(times), 0))
        return np.array(found), np.array(slopes), none, none[..., None] * np.ones(len(vary))

    wanted = as_target(target, len(times), count)
    problem = Problem(states, own, vary, wanted, [False] * count, [], [], TOLERANCE, 1)
    return solved(mechanism, values, problem, columns, (), starts, seed, tell)
