"""Least squares of columns with conditions: residuals, multipliers, and how a start is finished.

Conditions c(p) <= 0 (or = 0) keep the residual vectors, too: by multipliers l,

    residuals and sqrt(m) max(0, c + l/m)     then     l = max(0, l + m c)

until nothing is violated (the augmented Lagrangian; J. Nocedal, S. Wright, Numerical Optimization,
chapter 17).

Many starts go at once through Levenberg and Marquardt's method, each in a lane.  Unknowns u are
within [0, 1].  A step solves (J^T J + mu D) s = -J^T r over the unknowns that are free, D the
largest squares of J's columns so far; those at a bound that the slope pushes outward stay there.
mu follows the ratio of what a step gains to what it promised (H. B. Nielsen, IMM, DTU, 1999).  A
step to where residuals are not finite is refused like one that gains nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.placed import matvec
from robodyn.errors import InputError
from robodyn.loops.closing import half_turn
from robodyn.tables.arrays import Array

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
    """What scipy makes of a start: what is broken, the norm of residuals, u and conditions."""
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
