"""Numbers of a scene such that columns follow a table, or have a least sum of squares.

Columns are those of states, or of simulated motions, whose derivatives are differences of runs.

Residual vectors and their exact derivatives go from many starts, as lanes, through Levenberg and
Marquardt's method; the best are finished by scipy's `least_squares`.
Where loops do not close, ten times what is missing is among the residuals (positions alone; rates
have no values there, and such steps are refused), and results that do not close are thrown away.

Conditions c(p) <= 0 (or = 0) keep the residual vectors, too: by multipliers l,

    residuals and sqrt(m) max(0, c + l/m)     then     l = max(0, l + m c)

until nothing is violated (the augmented Lagrangian; J. Nocedal, S. Wright, Numerical Optimization,
chapter 17).

Unknowns u are
within [0, 1].  A step solves (J^T J + mu D) s = -J^T r over the unknowns that are free, D the
largest squares of J's columns so far; those at a bound that the slope pushes outward stay there.
mu follows the ratio of what a step gains to what it promised (H. B. Nielsen, IMM, DTU, 1999).  A
step to where residuals are not finite is refused like one that gains nothing.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.columns import column_names, of_joints
from robodyn.dynamics.joint_vectors import driver_of, full, reclosed, vectors
from robodyn.dynamics.named_numbers import named_values
from robodyn.engines.expression import Value, tangents
from robodyn.errors import DescriptionError, InputError, RobodynError
from robodyn.loops.closing import close_positions, half_turn
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.driven import check_times
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.mechanics.placed import matvec
from robodyn.parameters.base_parameters import EXCITED, dependence
from robodyn.parameters.column_formulas import ColumnFormulas, LaneStates, Rows, compiled
from robodyn.runs.motion_columns import as_actuation
from robodyn.runs.simulation import simulate
from robodyn.scene.scene_values import SceneValues
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown
from robodyn.tables.short_repr import short_repr

Places = NDArray[np.int64]
# residuals (m, R) and their derivatives (m, R, k) at u (m, k) of these lanes (m,)
Evaluate = Callable[[Array, Places], tuple[Array, Array]]

PENALTY = 10.0  # what is missing counts so often
KEPT = 1e-12  # of a condition's size: it holds
ROUNDS = 15  # of multipliers
STIFF = 10.0  # the first m
EXACT = 1e-15  # to which columns are known
FINISHED = 3  # starts that scipy goes on from
FIRST, LAST = 1e-3, 1e20  # mu
SMALL = 1e-10  # a step that no unknown moves by more: what is left is for one start alone
GAIN = 1e-13  # of the sum of squares, likewise


class Problem:
    """Residuals by unknowns u in [0, 1], which stand for numbers between their bounds.

    `states` gives columns, those of conditions last, at changes of the numbers from `own` (k,).
    Columns are known `exact` to a part of them; scipy goes on from so many starts as `finished`.
    """

    def __init__(
        self,
        states: Callable[[Array], tuple[Array, Array, Array, Array]],
        own: Array,
        vary: Mapping[str, tuple[float, float]],
        target: Array,
        turning: Sequence[bool],
        equal: Sequence[bool],
        alone: Sequence[bool],
        exact: float = EXACT,
        finished: int = FINISHED,
    ) -> None:
        if not vary:
            raise InputError("--vary", limit="names no number")
        self.exact, self.finished = exact, finished
        self.states, self.own, self.names = states, own, tuple(vary)
        self.low, self.high = np.array(list(vary.values()), float).T
        self.target, self.turning = target, np.array(turning, bool)
        self.equal, self.alone = list(equal), list(alone)
        self.size = 1.0  # of the residuals: their norm where starts are
        self.sizes = np.ones(len(self.equal))  # of the conditions

    def numbers(self, u: Array) -> Array:
        """The numbers (S, k), bounds as they were given."""
        found = self.low + u * (self.high - self.low)
        return np.asarray(np.where(u <= 0.0, self.low, np.where(u >= 1.0, self.high, found)))

    def at(self, numbers: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Residuals (S, T, c), conditions (S, C), what is missing (S, G), each with slopes by u."""
        found, slopes, missing, missing_by = self.states(numbers - self.own)
        slopes, missing_by = (x * (self.high - self.low) for x in (slopes, missing_by))
        S, T, c = len(numbers), len(self.target), self.target.shape[1]
        left = found[..., :c] - self.target
        left[..., self.turning] = half_turn(left[..., self.turning])
        parts, by = [np.zeros((S, 0))], [np.zeros((S, 0, slopes.shape[-1]))]
        for i, alone in enumerate(self.alone):
            rows = slice(0, 1) if alone else slice(None)
            parts.append(found[:, rows, c + i])
            by.append(slopes[:, rows, c + i])
        count = T * missing.shape[-1]
        return (
            left,
            slopes[..., :c, :],
            np.concatenate(parts, axis=1),
            np.concatenate(by, axis=1),
            missing.reshape(S, count),
            missing_by.reshape(S, count, slopes.shape[-1]),
        )

    @property
    def places(self) -> tuple[NDArray[np.bool_], Places]:
        """Of each entry of the conditions whether it is an equation, and its condition."""
        T = len(self.target)
        counts = [1 if alone else T for alone in self.alone]
        which = np.repeat(np.arange(len(counts)), counts)
        return np.array(self.equal, bool)[which], which


class Search:
    """The starts of a problem, with their multipliers."""

    def __init__(self, problem: Problem, count: int) -> None:
        self.problem = problem
        self.equal, which = problem.places
        self.scale = problem.sizes[which]
        self.l = np.zeros((count, len(which)))
        self.m = np.full(count, STIFF)

    def evaluate(self, u: Array, lanes: Places) -> tuple[Array, Array]:
        """Residuals (m, R) and slopes (m, R, k), penalties and conditions among them."""
        problem = self.problem
        left, by, c, c_by, missing, missing_by = problem.at(problem.numbers(u))
        S, k = u.shape
        m = np.sqrt(self.m[lanes])[:, None]
        pushed = c / self.scale + self.l[lanes] / m**2
        active = self.equal | (pushed > 0.0)
        parts = [left.reshape(S, -1) / problem.size, PENALTY * missing / problem.size]
        slopes = [by.reshape(S, -1, k) / problem.size, PENALTY * missing_by / problem.size]
        parts.append(np.where(active, m * pushed, 0.0))
        slopes.append(np.where(active, m / self.scale, 0.0)[..., None] * c_by)
        J = np.concatenate(slopes, axis=1)
        r = np.concatenate(parts, axis=1)
        r[~np.isfinite(J).all(axis=(1, 2))] = np.nan
        return r, J

    def violated(self, u: Array) -> tuple[Array, Array]:
        """By how much each start breaks conditions, of their sizes, and the conditions."""
        if not len(self.equal):
            return np.zeros(len(u)), np.zeros((len(u), 0))
        c = self.problem.at(self.problem.numbers(u))[2] / self.scale
        off = np.where(self.equal, np.abs(c), np.maximum(c, 0.0))
        return off.max(axis=1, initial=0.0), c

    def run(self, u: Array, inner: Callable[[Array], tuple[Array, Array]]) -> tuple[Array, Array]:
        """u and costs after `inner`, which is called again with other multipliers."""
        before = np.full(len(u), np.inf)
        for _ in range(ROUNDS if len(self.equal) else 1):
            u, cost = inner(u)
            off, c = self.violated(u)
            if not (off[np.isfinite(cost)] > KEPT).any():
                break
            pushed = self.l + self.m[:, None] * c
            self.l = np.nan_to_num(np.where(self.equal, pushed, np.maximum(pushed, 0.0)))
            self.m = np.where(off > 0.25 * before, np.minimum(self.m * 10.0, 1e8), self.m)
            before = off
        return u, cost


def finished(
    problem: Problem, search: Search, u: Array, lane: int
) -> tuple[float, float, Array, Array]:
    """Refine a start by scipy: return violation, norm of residuals, u and conditions."""
    from scipy.optimize import least_squares

    alone = Search(problem, 1)
    alone.l, alone.m = search.l[lane : lane + 1], search.m[lane : lane + 1]
    first = np.zeros(1, int)

    def inner(start: Array) -> tuple[Array, Array]:
        r, J = alone.evaluate(start, first)
        cost, slope, at = 0.5 * float(r[0] @ r[0]), J[0].T @ r[0], start[0].copy()
        free = ~(((at <= 0.0) & (slope >= 0.0)) | ((at >= 1.0) & (slope <= 0.0)))
        if not free.any() or cost == 0.0:
            return start, np.array([cost])

        seen: dict[bytes, tuple[Array, Array]] = {}

        def there(x: Array) -> tuple[Array, Array]:
            key = x.tobytes()
            if key not in seen:
                full = at.copy()
                full[free] = x
                r, J = alone.evaluate(full[None], first)
                seen.clear()
                seen[key] = r[0], np.ascontiguousarray(J[0][:, free])
            return seen[key]

        def residuals(x: Array) -> Array:
            return there(x)[0]

        how: dict[str, Any] = {"jac": lambda x: there(x)[1], "bounds": (0.0, 1.0), "x_scale": "jac"}
        how |= dict.fromkeys(("ftol", "xtol", "gtol"), problem.exact)
        try:
            done = least_squares(residuals, at[free], max_nfev=100, **how)
        except ValueError:  # it begins a little within the bounds, where there may be no values
            return start, np.array([cost])
        if done.cost < cost:
            at[free] = done.x
            return at[None], np.array([float(done.cost)])
        return start, np.array([cost])

    best, cost = alone.run(u[None].copy(), inner)
    off, c = alone.violated(best)
    missing = problem.at(problem.numbers(best))[4].max(initial=0.0)
    broken = max(float(off[0]) if off[0] > 1e-6 else 0.0, float(missing))
    return broken, float(np.sqrt(2.0 * cost[0])), best[0], c[0]


def lane_least_squares(
    evaluate: Evaluate, start: Array, steps: int, tell: Callable[[float], object]
) -> tuple[Array, Array]:
    """u (S, k) where the sum of squares is least near each start, and half that sum (S,)."""
    u, (S, k) = start.copy(), start.shape
    lanes = np.arange(S)
    r, J = evaluate(u, lanes)
    cost = _cost(r)
    H, g = _normal(r, J)
    mu, factor = np.full(S, FIRST), np.full(S, 2.0)
    scale = np.zeros((S, k))
    lanes = np.flatnonzero(np.isfinite(cost))
    for done in range(steps):
        if not lanes.size:
            break
        tell(done / steps)
        scale[lanes] = np.maximum(scale[lanes], np.einsum("nii->ni", H[lanes]))
        step = _step(H[lanes], g[lanes], u[lanes], scale[lanes], mu[lanes])
        there = np.clip(u[lanes] + step, 0.0, 1.0)
        step = there - u[lanes]
        r, J = evaluate(there, lanes)
        new = _cost(r)
        slope = g[lanes] + 0.5 * matvec(H[lanes], step)
        promised = -np.einsum("ni,ni->n", slope, step)
        gained = cost[lanes] - new
        good = np.isfinite(new) & (gained > 0.0)
        size = np.abs(step).max(axis=-1)
        over = (size <= SMALL) | (promised <= GAIN * cost[lanes]) | (cost[lanes] == 0.0)
        ratio = np.where(good, gained / np.where(promised > 0.0, promised, 1.0), 0.0)
        shrink = np.maximum(1.0 / 3.0, 1.0 - (2.0 * np.minimum(ratio, 1.0) - 1.0) ** 3)
        mu[lanes] = np.where(good, mu[lanes] * shrink, mu[lanes] * factor[lanes])
        factor[lanes] = np.where(good, 2.0, np.minimum(2.0 * factor[lanes], 1e6))
        moved = lanes[good]
        u[moved], cost[moved] = there[good], new[good]
        H[moved], g[moved] = _normal(r[good], J[good])
        lanes = lanes[~over & (mu[lanes] < LAST)]
    return u, cost


def _cost(r: Array) -> Array:
    with np.errstate(all="ignore"):
        cost = 0.5 * np.einsum("nr,nr->n", r, r)
    return np.where(np.isfinite(cost), cost, np.inf)


def _normal(r: Array, J: Array) -> tuple[Array, Array]:
    """J^T J and J^T r."""
    with np.errstate(all="ignore"):
        return np.swapaxes(J, 1, 2) @ J, np.einsum("nrk,nr->nk", J, r)


def _step(H: Array, g: Array, u: Array, scale: Array, mu: Array) -> Array:
    held = ((u <= 0.0) & (g > 0.0)) | ((u >= 1.0) & (g < 0.0))
    least = 1e-16 * scale.max(axis=-1, keepdims=True) + 1e-300
    D = np.where(scale > least, scale, 1.0 * least)
    free = ~held
    A = H * (free[:, :, None] & free[:, None, :])
    k = np.arange(u.shape[-1])
    A[:, k, k] = np.where(free, A[:, k, k] + mu[:, None] * D, 1.0)
    d = 1.0 / np.sqrt(A[:, k, k])  # scaled: what is added decides how regular it is
    A = A * d[:, :, None] * d[:, None, :]
    A[:, k, k] += 1e-15
    right = np.where(free, -g, 0.0) * d
    return np.asarray(np.linalg.solve(A, right[..., None])[..., 0] * d)


STARTS = 30
MOST_STARTS = 1_000_000
STEPS = 200  # of each start
LARGEST = 1e30  # of bounds and targets: columns have squares of it, and their squares are summed
DRAWN = 200  # times as many starts are drawn where most have no values
SAME = 1e-3  # of the residuals' rms, by which starts that reached the best are told


@short_repr
@dataclass(frozen=True)
class Fit:
    """The result of a fit: numbers by name, residuals (T, c) of the columns, and their rms (c,).

    `before` values belong to the scene's own numbers, nan if it has none.  `bounds` tells which
    numbers are at a bound, `reached` how many of the `starts` led to the best result, `conditions`
    the distance of each from its limit (> 0: holds with room; 0: active).  `untold` are numbers
    that the columns do not determine.
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
    actuated joints, rad and s, t (T,) the times; what is not given is zero, but laws of the time
    need t.  Columns are named as
    those of `points` (with `of`), `torque` and `reactions`, or q3, qd3, qdd3 of what follows.
    `subject_to` has conditions such as "links.crank.l + links.coupler.l <= 1", which hold at every
    row where columns are in them.  Raises InputError for what does not fit, for forces of dry
    friction and stops, and for bounds within which the loops never close.
    """
    check_times(mechanism, t is not None)
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
    slides = of_joints("q", mechanism.slides)
    turns = {*column_names(mechanism, ["q"]), *of_joints("links", range(mechanism.n))} - {*slides}
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
    """Return starting points (count, k), first the scene's own numbers if within bounds."""
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


RUNS_BEGUN = 4  # starts of a fit to motions: runs take longer than states
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
    starts: int = RUNS_BEGUN,
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
    """Starts of motions: q and qd of all joints (`whole`), or of the actuated ones.

    `places` are start values among the names of `vary`, each with its kind, q or qd, and its joint.
    Joints `held` determine all others at `first`.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        vary: Iterable[str],
        q: ArrayLike,
        qd: ArrayLike | None,
    ) -> None:
        given = vectors(mechanism, q=q, qd=np.zeros(np.shape(q)) if qd is None else qd)
        for name, (values, _) in given.items():
            if values.ndim != 1:
                raise InputError(f"{name}.shape", value=values.shape, limit="must be of one state")
        (joints, self.whole), (rates, whole_rates) = given.values()
        self.first = full(mechanism, {"q": (joints, self.whole)}, t=0.0)["q"]
        self.held = list(driver_of(mechanism).actuated)
        if self.whole:
            self.first = close_positions(mechanism, self.first, t=0.0)
            if not whole_rates:
                start = {"q": (self.first, True), "qd": (rates, False)}
                rates = full(mechanism, start, t=0.0)["qd"]
        elif whole_rates:
            rates = rates[self.held]
        self.mechanism, self.given = mechanism, {"q": joints, "qd": rates}
        self.joints = list(range(mechanism.n)) if self.whole else self.held  # of what is given
        self.places: dict[str, tuple[str, int]] = {}
        for name in vary:
            match = _START.fullmatch(name)
            if match and int(match[2]) - 1 in self.held:
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
            few = {kind: (values, False) for kind, values in start.items()}
            q, qd = full(moved, few, t=0.0).values()
            return q, qd
        return reclosed(moved, start["q"], start["qd"], t=0.0)


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
        self._how: dict[str, Any] = {"method": "taylor", "rtol": 1e-15, "atol": 1e-15}

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
