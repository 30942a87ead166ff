"""Columns of motions of many mechanisms at once, and their derivatives by the numbers that differ.

Lanes are starts x rows.  Loops are closed by dyads, or by Newton's method from where the scene's
own are; rates, accelerations and forces follow from linear equations, and so do the derivatives of
all of them: with F(z, p) = 0 for what follows, dz/dp = -F_z^-1 F_p, exact.

Where a dyad does not reach, its links point at one another (the discriminant is clipped).  Then
|gap|^2 is least: F is its slope Psi^T gap, and what is missing, |gap|, has the derivative
gap . d gap/dp / |gap|.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from robodyn.dynamics.dense_dynamics import RANK_CUT
from robodyn.engines.array_blocks import ArrayFormula
from robodyn.engines.expression import Value
from robodyn.engines.tangents import slopes_by, tangents
from robodyn.loops.assembly import assemble, by_dyads, scene_branches
from robodyn.loops.assembly_plan import Plan, Step, assembly_plan
from robodyn.loops.closing import CLOSED as ROUNDING
from robodyn.loops.closing import PASSES, loop_size
from robodyn.mechanics.planar_model import ClosureRow
from robodyn.parameters.column_formulas import ColumnFormulas
from robodyn.tables.arrays import Array

Part = tuple[tuple[int, ...], Sequence[Value]]  # a shape, and what is in it
Parts = Sequence[Part]
Group = tuple[tuple[int, ...], tuple[int, ...]]  # rows of closures, and the joints they serve

LANES = 60_000  # states at once
MISSED = 1e-9  # of the loop's size: a gap that Newton's method leaves and that is no rounding


@dataclass(frozen=True)
class Rows:
    """What is known of each row: q, qd, qdd (T, a) of the actuated joints, and the time (T,)."""

    q: Array
    qd: Array
    qdd: Array
    t: Array


class LaneStates:
    """Columns at rows, by numbers of a scene."""

    def __init__(self, formulas: ColumnFormulas, columns: Sequence[Value], rows: Rows) -> None:
        self.formulas, self.columns, self.rows = formulas, list(columns), rows
        self.mechanism = mechanism = formulas.mechanism
        n, state = mechanism.n, formulas.state.inputs
        self.n, self.k = n, len(formulas.p)
        slopes = tangents(self.columns, formulas.inputs)
        needed = {name for slope in slopes for name in slope}
        self.moves = bool(needed & {*state[n:], *(f"f{i}" for i in range(len(formulas.forces)))})
        follows = mechanism.rows or mechanism.passive
        self.plan: Plan | None = assembly_plan(mechanism) if follows else None
        self._conditions = list(self._closings())
        self._codes: dict[str, Callable[[Array], list[Array]]] = {}

    # -- formulas ----------------------------------------------------------------------------------

    def _closings(self) -> list[Group]:
        """The rows of closures that serve to find joints, each group with these joints."""
        if self.plan is None:
            return []
        rows, couplings = self.mechanism.rows, self.mechanism.description.couplings
        first = len(rows) - len(couplings)
        found: list[Group] = [((first + c,), (joint,)) for joint, c in self.plan.coupled]
        for step in self.plan.steps:
            own = tuple(r for r, row in enumerate(rows) if any(row is x for x in step.rows))
            found.append((own, step.unknown))
        if self.plan.rest:
            used = {r for own, _ in found for r in own}
            left = tuple(r for r in range(len(rows)) if r not in used)
            found.append((left, self.plan.rest))
        return found

    def _code(self, name: str) -> Callable[[Array], list[Array]]:
        """A function of inputs (N, inputs) that returns what is called so."""
        if name not in self._codes:
            parts = self._parts(name)
            self._codes[name] = compiled(self.formulas.inputs, parts)
        return self._codes[name]

    def _parts(self, name: str) -> Parts:
        """What is called so: values, and their slopes by groups of inputs behind one another."""
        f, n, r = self.formulas, self.n, len(self.formulas.gap)
        q, qd, qdd = (f.state.inputs[i : i + n] for i in (0, n, 2 * n))
        p = [f"p{i}" for i in range(self.k)]
        forces = [f"f{i}" for i in range(len(f.forces))]
        if name == "rows":
            numbers = [x for row in f.named.rows for x in _numbers_of(row)]
            return [((len(numbers),), numbers)]
        Psi: Part = ((r, n), [x for row in f.Psi for x in row])
        # values that are given themselves, and values of which slopes are
        given: dict[str, list[Part]] = {
            "gap": [((r,), f.gap), Psi],
            "closing": [Psi],
            "bend": [((r,), f.gap_bend)],
            "load": [((n,), f.load)],
            "columns": [((len(self.columns),), self.columns)],
        }
        closed, least = self._least if name == "closing" else ([], [])
        sloped: dict[str, list[tuple[Sequence[Value], Sequence[Sequence[str]]]]] = {
            "closing": [(f.gap, [p]), (closed, [q, p]), (least, [q, p])],
            "rates": [(f.gap_rate, [q, p]), (f.gap_bend, [q, qd, p]), (f.balance, [q, qd, qdd, p])],
            "columns": [(self.columns, [q, qd, qdd, forces, p])],
        }
        slopes = [(nodes, by) for nodes, every in sloped.get(name, ()) for by in every]
        own = given.get(name, [])
        return own + [((len(x), len(by)), slopes_by(x, by)) for x, by in slopes]

    @cached_property
    def _least(self) -> tuple[list[Value], list[Value]]:
        """What is zero at closed loops, and Psi^T gap of each group; one a joint that follows."""
        f = self.formulas
        closed: list[Value] = []
        least: list[Value] = []
        for rows, joints in self._conditions:
            slopes = [sum((f.Psi[r][u] * f.gap[r] for r in rows), 0.0) for u in joints]
            closed += [f.gap[r] for r in rows] if len(rows) == len(joints) else slopes
            least += slopes
        return closed, least

    # -- lanes -------------------------------------------------------------------------------------

    def __call__(self, p: Array) -> tuple[Array, Array, Array, Array]:
        """Of changes p (S, k): columns (S, T, c), their derivatives (S, T, c, k), and what misses.

        What is missing is (S, T, g) m, zero where loops close, with its derivatives (S, T, g, k).
        Values are nan where there are none.
        """
        T = len(self.rows.t)
        size = max(1, LANES // T)
        parts = [self._lanes(p[s : s + size]) for s in range(0, len(p), size)]
        columns, slopes, missing, by = (np.concatenate(x) for x in zip(*parts, strict=True))
        return columns, slopes, missing, by

    def _lanes(self, p: Array) -> tuple[Array, Array, Array, Array]:
        mechanism, n, k, T = self.mechanism, self.n, self.k, len(self.rows.t)
        S = len(p)
        given = np.broadcast_to(self.rows.q, (S, *self.rows.q.shape))
        q, missed = self._closed(p, given)
        inputs = np.zeros((S, T, len(self.formulas.inputs)))
        inputs[..., :n] = q
        inputs[..., 3 * n] = self.rows.t
        inputs[..., inputs.shape[-1] - k :] = p[:, None]
        x = inputs.reshape(S * T, -1)
        N, groups = S * T, len(self._conditions)
        missing, by_missing = np.zeros((N, groups)), np.zeros((N, groups, k))
        dq = np.zeros((N, n, k))
        passive = [u for _, joints in self._conditions for u in joints]
        Psi = np.zeros((N, 0, n))
        with np.errstate(all="ignore"):
            if mechanism.rows:
                Psi, gap_p, closed_q, closed_p, least_q, least_p = self._code("closing")(x)
                gap = self._code("gap")(x)[0]
                lost = missed.reshape(N, groups)
                ends = np.cumsum([0, *(len(joints) for _, joints in self._conditions)])
                for g, (a, b) in enumerate(pairwise(ends)):
                    here = lost[:, g] > 0.0
                    closed_q[here, a:b] = least_q[here, a:b]
                    closed_p[here, a:b] = least_p[here, a:b]
                if passive:
                    dq[:, passive] = -solved_lanes(closed_q[..., passive], closed_p)
                moved = gap_p + Psi @ dq
                for g, (rows, _) in enumerate(self._conditions):
                    own = list(rows)
                    length = np.where(lost[:, g] > 0.0, np.linalg.norm(gap[:, own], axis=-1), 0.0)
                    missing[:, g] = length
                    along = gap[:, own] / np.where(length > 0.0, length, np.inf)[:, None]
                    by_missing[:, g] = np.einsum("ni,nik->nk", along, moved[:, own])
            dx = [dq]
            if self.moves:
                dx += self._moving(x, Psi, dq)
            found, *slopes = self._code("columns")(x)
            total = slopes[-1]
            for slope, step in zip(slopes, dx, strict=False):
                total = total + slope @ step
            if self.moves:
                found[missing.any(axis=-1)] = np.nan
        c = len(self.columns)
        return (
            found.reshape(S, T, c),
            total.reshape(S, T, c, k),
            missing.reshape(S, T, groups),
            by_missing.reshape(S, T, groups, k),
        )

    def _moving(self, x: Array, Psi: Array, dq: Array) -> list[Array]:
        """Writes rates, accelerations and forces into inputs x (N, inputs): their derivatives."""
        n, driven = self.n, list(self.mechanism.actuated)
        N, r, a = len(x), Psi.shape[1], len(driven)
        S = N // len(self.rows.t)
        chosen = np.broadcast_to(np.eye(n)[driven], (N, a, n))
        A = np.concatenate([Psi, chosen], axis=1)
        right = np.zeros((N, r + a, 1))
        right[:, r:, 0] = np.tile(self.rows.qd, (S, 1))
        x[:, n : 2 * n] = solved_lanes(A, right)[..., 0]
        right[:, :r, 0] = -self._code("bend")(x)[0]  # with qdd zero
        right[:, r:, 0] = np.tile(self.rows.qdd, (S, 1))
        x[:, 2 * n : 3 * n] = solved_lanes(A, right)[..., 0]
        (load,) = self._code("load")(x)
        torques = np.broadcast_to(np.eye(n)[:, driven], (N, n, a))
        shares = np.concatenate([torques, np.swapaxes(Psi, 1, 2)], axis=-1)
        x[:, 3 * n + 1 : 3 * n + 1 + a + r] = solved_lanes(shares, load[..., None])[..., 0]
        rates = self._code("rates")(x)
        rate_q, rate_p, bend_q, bend_qd, bend_p, load_q, load_qd, load_qdd, load_p = rates
        none = np.zeros((N, a, self.k))
        dqd = -solved_lanes(A, np.concatenate([rate_p + rate_q @ dq, none], axis=1))
        bent = bend_p + bend_q @ dq + bend_qd @ dqd
        dqdd = -solved_lanes(A, np.concatenate([bent, none], axis=1))
        df = solved_lanes(shares, load_p + load_q @ dq + load_qd @ dqd + load_qdd @ dqdd)
        return [dqd, dqdd, df]

    # -- loops -------------------------------------------------------------------------------------

    def _closed(self, p: Array, given: Array) -> tuple[Array, Array]:
        """q (S, T, n), and what each group of rows misses (S, T, groups), m."""
        mechanism, plan = self.mechanism, self.plan
        q = np.zeros((*given.shape[:2], self.n))
        q[..., list(mechanism.actuated)] = given
        if plan is None:
            return q, np.zeros((*given.shape[:2], 0))
        lanes = replace(plan, steps=tuple(self._lane_steps(plan, p)))
        with np.errstate(all="ignore"):
            q, shorts, _ = by_dyads(mechanism, lanes, given, scene_branches(mechanism))
        missed = np.zeros((*q.shape[:2], len(self._conditions)))
        first = len(plan.coupled)
        for g, short in enumerate(shorts[: len(plan.steps)]):
            missed[..., first + g] = short
        if plan.rest:
            rest = list(plan.rest)
            q[..., rest] = self._own[:, rest]
            missed[..., -1] = self._newton(q, p)
        return q, missed

    @cached_property
    def _own(self) -> Array:
        """q (T, n) of the scene as it is."""
        return assemble(self.mechanism, self.rows.q)

    def _lane_steps(self, plan: Plan, p: Array) -> list[Step]:
        """The steps with rows whose numbers are (S, 1)."""
        inputs = np.zeros((len(p), len(self.formulas.inputs)))
        inputs[:, inputs.shape[1] - self.k :] = p
        (numbers,) = self._code("rows")(inputs)
        columns = iter(numbers.T[..., None])
        made: list[ClosureRow] = []
        named = self.formulas.named.rows
        for row, own in zip(named, self.mechanism.rows, strict=True):
            P = tuple((k, next(columns) + 1j * next(columns)) for k, _ in row.P)
            ground, offset = next(columns) + 1j * next(columns), next(columns)
            angles = tuple((k, next(columns)) for k, _ in row.angles)
            made.append(own._replace(P=P, ground=ground, offset=offset, angles=angles))
        first = len(plan.coupled)
        return [
            replace(step, rows=tuple(made[r] for r in self._conditions[first + i][0]))
            for i, step in enumerate(plan.steps)
        ]

    def _newton(self, q: Array, p: Array) -> Array:
        """Closes what is left, in place, by steps of least squares; what is missing (S, T)."""
        rows, joints = (list(x) for x in self._conditions[-1])
        x = np.zeros((*q.shape[:2], len(self.formulas.inputs)))
        x[..., x.shape[-1] - self.k :] = p[:, None]
        size = loop_size(self.mechanism)
        for _ in range(3 * PASSES):
            x[..., : self.n] = q
            gap, Psi = self._code("gap")(x.reshape(-1, x.shape[-1]))
            gap, own = gap[:, rows, None], Psi[:, rows][..., joints]
            if np.abs(gap).max(initial=0.0) <= ROUNDING * size:
                break
            step = np.linalg.pinv(own, rcond=1e-6) @ gap
            longest = np.abs(step).max(axis=(1, 2), keepdims=True)
            step *= np.minimum(1.0, 0.5 / np.maximum(longest, 0.5))
            if longest.max() < 1e-15:
                break
            q[..., joints] -= step[..., 0].reshape(*q.shape[:2], -1)
        missing = np.linalg.norm(gap[..., 0], axis=-1)
        return np.where(missing > MISSED * size, missing, 0.0).reshape(q.shape[:2])


def _numbers_of(row: Any) -> Iterator[Value]:
    """The numbers of a row of closures, one after the other."""
    for c in (*(c for _, c in row.P), row.ground):
        yield from (c.real, c.imag)
    yield row.offset
    yield from (c for _, c in row.angles)


def solved_lanes(A: Array, b: Array) -> Array:
    """x (N, n, m) of least length with A x = b as near as it goes; nan where A is not finite."""
    if A.shape[1] == A.shape[2]:
        try:
            return np.asarray(np.linalg.solve(A, b))
        except np.linalg.LinAlgError:
            pass
    sound = np.isfinite(A).all(axis=(1, 2))
    found = np.full((len(A), A.shape[2], b.shape[2]), np.nan)
    found[sound] = np.linalg.pinv(A[sound], rcond=RANK_CUT) @ b[sound]
    return found


def compiled(inputs: tuple[str, ...], parts: Parts) -> Callable[[Array], list[Array]]:
    """A function of inputs (N, inputs) that returns arrays (N, *shape) of values, part by part."""
    formula = ArrayFormula(inputs, [x for _, values in parts for x in values])

    def run(x: Array) -> list[Array]:
        found = [np.empty((len(x), len(values))) for _, values in parts]
        formula.fill([x], found)
        return [y.reshape(len(x), *shape) for y, (shape, _) in zip(found, parts, strict=True)]

    return run
