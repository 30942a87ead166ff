"""Numbers of a scene such that columns follow a table, or have a least sum of squares.

Residual vectors and their exact derivatives go from many starts, as lanes, through Levenberg and
Marquardt's method (`fit_problem.py`); the best are finished by scipy's `least_squares`.
Where loops do not close, ten times what is missing is among the residuals (positions alone; rates
have no values there, and such steps are refused), and results that do not close are thrown away.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.named_numbers import named_values
from robodyn.engines.expression import Value
from robodyn.engines.tangents import tangents
from robodyn.errors import DescriptionError, InputError
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.parameters.base_parameters import EXCITED, dependence
from robodyn.parameters.column_formulas import ColumnFormulas
from robodyn.parameters.fit_problem import Problem, Search, finished, lane_least_squares
from robodyn.parameters.lane_states import LaneStates, Rows
from robodyn.scene.scene_values import SceneValues
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown
from robodyn.tables.short_repr import short_repr

STARTS = 30
MOST_STARTS = 1_000_000
STEPS = 200  # of each start
LARGEST = 1e30  # of bounds and targets: columns have squares of it, and their squares are summed
DRAWN = 200  # times as many starts are drawn where most have no values
SAME = 1e-3  # of the residuals' rms, by which starts that reached the best are told


@short_repr
@dataclass(frozen=True)
class Fit:
    """What was found: numbers by name, residuals (T, c) of the columns, and their rms (c,).

    Before are those of the scene's own numbers, nan where it has none.  `bounds` tells which
    numbers are at one, `reached` how many of the `starts` led to the best, `conditions` how far
    each is from its limit (> 0: it holds with room; 0: it is active).
    `untold` are numbers that others, or any, serve for: without conditions, columns do not tell.
    """

    mechanism: Mechanism
    numbers: Mapping[str, float]
    before: Mapping[str, float]
    columns: tuple[str, ...]
    residuals: Array
    rms: Array
    rms_before: Array
    bounds: Mapping[str, str]
    conditions: Mapping[str, float]
    untold: tuple[str, ...]
    starts: int
    reached: int


def fit(
    mechanism: Mechanism,
    vary: Mapping[str, tuple[float, float]],
    columns: Sequence[str],
    q: ArrayLike,
    qd: ArrayLike | None = None,
    qdd: ArrayLike | None = None,
    t: ArrayLike | None = None,
    *,
    target: ArrayLike | None = None,
    of: Sequence[str] = (),
    subject_to: Sequence[str] = (),
    starts: int = STARTS,
    seed: int = 0,
    tell: Callable[[float], object] = lambda part: None,
) -> Fit:
    """The numbers within their bounds for which columns are nearest to `target` (T, c), or zero.

    `vary` has (low, high) by the names that sweeps have.  q, qd, qdd (T, a) are those of the a
    actuated joints, rad and s, t (T,) the times; what is not given is zero.  Columns are named as
    those of `points` (with `of`), `torque` and `reactions`, or q3, qd3, qdd3 of what follows.
    `subject_to` has conditions such as "links.crank.l + links.coupler.l <= 1", which hold at every
    row where columns are in them.  Raises InputError for what does not fit, for forces of dry
    friction and stops, and for bounds within which the loops never close.
    """
    wanted = Wanted(mechanism, vary, columns, of, subject_to)
    formulas, rows = wanted.formulas, _rows(mechanism, q, qd, qdd, t)
    if mechanism.switches:
        forces = {f"f{i}" for i in range(len(formulas.forces))}
        for name, by in zip(wanted.names, wanted.by, strict=True):
            if by & forces:
                limit = "jumps where dry friction or a stop switches: fit columns of points, of"
                limit += " links and of joints that follow, or motions (--simulate)"
                raise InputError("column", value=shown(name), where=mechanism.source, limit=limit)
    states = LaneStates(formulas, wanted.nodes, rows)
    turns = {f"q{k + 1}" for k in range(mechanism.n) if k not in mechanism.slides}
    turns |= {f"angle{k + 1}" for k in range(mechanism.n)}
    turning = [name in turns for name in columns]
    to = as_target(target, len(rows.t), len(columns))
    own = np.array([wanted.numbers[name] for name in vary])
    alone = wanted.alone(formulas.inputs[: -len(vary)])
    problem = Problem(states, own, vary, to, turning, wanted.equal, alone)
    return solved(wanted, problem, starts, seed, tell)


class Wanted:
    """Columns, and conditions behind them, as formulas of a state and of the numbers of `vary`.

    `by` are the inputs that each of `names` depends on; `equal` tells which conditions are
    equations.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        vary: Mapping[str, tuple[float, float]],
        columns: Sequence[str],
        of: Sequence[str],
        subject_to: Sequence[str],
    ) -> None:
        self.mechanism, self.values = mechanism, checked(mechanism, vary)
        self.columns, self.subject_to = tuple(columns), tuple(subject_to)
        self.names = [*columns, *subject_to]
        self.formulas = ColumnFormulas(mechanism, list(vary), of)
        nodes = [self.formulas.column(name) for name in columns]
        self.numbers = {name: self.values.number(name) for name in (*self.values.names, *vary)}
        conditions = [self.formulas.condition(text, self.numbers) for text in subject_to]
        self.nodes: list[Value] = [*nodes, *(node for node, _ in conditions)]
        self.equal = [equal for _, equal in conditions]
        self.by = [set(slope) for slope in tangents(self.nodes, self.formulas.inputs)]

    def alone(self, moving: Collection[str]) -> list[bool]:
        """Which of the conditions depend on none of the inputs that differ from row to row."""
        return [by.isdisjoint(moving) for by in self.by[len(self.nodes) - len(self.equal) :]]


def checked(mechanism: Mechanism, vary: Mapping[str, tuple[float, float]]) -> SceneValues:
    """The numbers of the scene; InputError for names that are none, and for bounds."""
    values = named_values(mechanism, *vary)
    if clash := values.clash(vary):
        raise InputError("--vary", value=" and ".join(clash), limit="are one number")
    for name, (low, high) in vary.items():
        text = f"{name}={low:g}:{high:g}"
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise InputError("--vary", value=shown(text), limit="must be LOW:HIGH, LOW < HIGH")
        if max(-low, high) > LARGEST:
            limit = f"must be within -{LARGEST:g} and {LARGEST:g}: squares are summed"
            raise InputError("--vary", value=shown(text), limit=limit)
        for bound in (low, high):
            try:
                values.replaced({name: bound})
            except DescriptionError as error:
                limit = f"no scene may have that: {error.faults[0].limit}"
                raise InputError("--vary", value=shown(text), limit=limit) from None
    return values


def as_target(target: ArrayLike | None, rows: int, columns: int) -> Array:
    """The target (T, c), zero where there is none; InputError where it does not fit."""
    if not columns:
        raise InputError("columns", limit="none is named")
    found = np.zeros((rows, columns)) if target is None else np.asarray(target, float)
    if found.shape != (rows, columns) or not np.isfinite(found).all():
        limit = f"must be finite, of shape ({rows}, {columns})"
        raise InputError("target", value=found.shape, limit=limit)
    if (most := float(np.abs(found).max(initial=0.0))) > LARGEST:
        raise InputError("target", value=most, limit=f"must be {LARGEST:g} at most, in size")
    return found


def _rows(mechanism: Mechanism, q: ArrayLike, *others: ArrayLike | None) -> Rows:
    width = len(mechanism.actuated)
    first = np.asarray(q, float)
    T = len(first) if first.ndim == 2 else 0
    found = []
    for name, given in zip(("q", "qd", "qdd", "t"), (q, *others), strict=True):
        shape = (T,) if name == "t" else (T, width)
        array = np.zeros(shape) if given is None else np.asarray(given, float)
        if not T or array.shape != shape or not np.isfinite(array).all():
            limit = f"must be finite, of shape {shape}: one row a state, and 1 at least"
            raise InputError(name, value=array.shape, limit=limit)
        found.append(array)
    return Rows(*found)


def solved(
    wanted: Wanted, problem: Problem, starts: int, seed: int, tell: Callable[[float], object]
) -> Fit:
    """The best of a problem from many starts."""
    mechanism, values, subject_to = wanted.mechanism, wanted.values, wanted.subject_to
    if starts < 1:
        raise InputError("--starts", value=starts, limit="must be >= 1")
    if starts > MOST_STARTS:
        raise InputError("--starts", value=shown(str(starts)), limit=f"must be <= {MOST_STARTS}")
    if seed < 0:
        raise InputError("--seed", value=seed, limit="must be >= 0")
    if problem.target.size < len(problem.own):
        limit = f"{problem.target.size} values are too few for {len(problem.own)} numbers"
        raise InputError("rows", value=len(problem.target), limit=limit)
    own = (problem.own - problem.low) / (problem.high - problem.low)
    with np.errstate(all="ignore"):
        begun = problem.at(problem.own[None])
        u = _starts(mechanism, problem, own, starts, np.random.default_rng(seed))
        search = Search(problem, len(u))
        u, cost = search.run(
            u, lambda v: lane_least_squares(search.evaluate, v, STEPS, lambda x: tell(0.9 * x))
        )
        off = search.violated(u)[0]
        missing = problem.at(problem.numbers(u))[4].max(axis=1, initial=0.0)
        sound = np.isfinite(cost) & (missing <= 0.0)
        if not sound.any():
            raise never_closes(mechanism, problem, float(np.nanmin(missing)))
        order = np.argsort(np.where(sound, cost + 1e3 * (off > 1e-4), np.inf))
        best = min(
            (finished(problem, search, u[s], s) for s in order[: problem.finished] if sound[s]),
            key=lambda found: found[:2],
        )
        tell(1.0)
        broken, rms, u_best, c = best
        if broken > 0.0:
            worst = int(problem.places[1][int(np.argmax(np.where(search.equal, np.abs(c), c)))])
            limit = "is kept by none of the starts within the bounds of --vary"
            raise InputError("--subject-to", value=shown(subject_to[worst]), limit=limit)
        near = sound & (off <= 1e-3) & (np.sqrt(2.0 * cost) <= rms * (1.0 + SAME) + 1e-6)
    residuals, slopes = problem.at(numbers := problem.numbers(u_best[None]))[:2]
    idle = ~slopes.any(axis=(0, 1, 2)) & (own >= 0.0) & (own <= 1.0)
    kept = np.where(idle, problem.own, numbers)  # what nothing depends on stays
    if idle.any() and not subject_to and np.array_equal(problem.at(kept)[0], residuals):
        numbers, u_best = kept, np.where(idle, own, u_best)
    left = residuals[0]
    held = {
        name: "low" if at <= 0.0 else "high"
        for name, at in zip(problem.names, u_best, strict=True)
        if at <= 0.0 or at >= 1.0
    }
    free = [k for k, name in enumerate(problem.names) if name not in held and not subject_to]
    J = slopes.reshape(-1, len(own))[:, free]
    alike = dependence(J, [problem.names[k] for k in free], EXCITED)
    room = {
        text: 0.0
        - float(problem.sizes[i]) * float(np.max(np.abs(c[here]) if problem.equal[i] else c[here]))
        for i, text in enumerate(subject_to)
        if (here := problem.places[1] == i).any()
    }
    found = dict(zip(problem.names, numbers[0].tolist(), strict=True))
    return Fit(
        mechanism=build(values.replaced({x: y for x, y in found.items() if x in values})),
        numbers=found,
        before=dict(zip(problem.names, problem.own.tolist(), strict=True)),
        columns=wanted.columns,
        residuals=left,
        rms=np.sqrt(np.mean(left**2, axis=0)),
        rms_before=np.where(
            begun[4].max(initial=0.0) > 0.0, np.nan, np.sqrt(np.mean(begun[0][0] ** 2, axis=0))
        ),
        bounds=held,
        conditions=room,
        untold=tuple(problem.names[free[k]] for k in alike.dropped),
        starts=len(u),
        reached=max(1, int(near.sum())),
    )


def _starts(
    mechanism: Mechanism, problem: Problem, own: Array, count: int, rng: np.random.Generator
) -> Array:
    """Where to start from (count, k): the scene's numbers, if they are within the bounds, first."""
    k = len(own)
    found = np.zeros((0, k))
    sizes: list[Array] = []
    norms: list[float] = []
    least = np.inf
    for round in range(DRAWN):
        drawn = rng.random((count, k))
        if round == 0 and ((own >= 0.0) & (own <= 1.0)).all():
            drawn[0] = own
        left, _, _, c_by, missing, _ = problem.at(problem.numbers(drawn))
        norm = np.sqrt(np.sum(left**2, axis=(1, 2)))
        least = min(least, float(np.nanmin(missing.max(axis=1, initial=0.0), initial=np.inf)))
        good = np.isfinite(norm)
        found = np.concatenate([found, drawn[good]])
        norms += norm[good].tolist()
        sizes += list(np.linalg.norm(c_by[good], axis=-1))
        if len(found) >= count:
            break
    if not len(found):
        raise never_closes(mechanism, problem, least)
    problem.size = float(np.median(norms)) or 1.0
    _, which = problem.places
    each = np.median(np.array(sizes), axis=0) if len(which) else np.zeros(0)
    for i in range(len(problem.sizes)):
        problem.sizes[i] = float(np.nanmax(each[which == i])) or 1.0
    return found[:count]


def never_closes(mechanism: Mechanism, problem: Problem, least: float) -> InputError:
    """The error of bounds within which there are no values at some row."""
    if not np.isfinite(least):
        least = 0.0
    limit = "within these bounds no start gives every row a value"
    if mechanism.rows:
        limit = "within these bounds the loops never close at every row"
        limit += f": {least:.3g} m are missing at best" if least else ""
    return InputError("--vary", value=", ".join(problem.names), limit=limit)
