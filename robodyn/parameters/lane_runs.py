"""Runs from many starts at once, each a lane: (q, qd) and d(q, qd)/dp, at given times.

With the residuals R of `derivative_formulas.py` and s = d(q, qd)/dp times the size of p,

    qdd = -K^-1 r        s_q' = s_qd        s_qd' = -K^-1 (R_q s_q + R_qd s_qd + R_p)

One formula serves all lanes, as the varied numbers are its inputs.  Lanes have steps of their own,
of E. Hairer's DOP853 with its dense output; each accepted state is moved back onto the loops.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate._ivp import dop853_coefficients as dop

from robodyn.dynamics.closed_form import scaled_jacobian
from robodyn.dynamics.dense_dynamics import elimination_is_safe
from robodyn.dynamics.dynamics import PIVOT_CUT
from robodyn.engines.derivative_formulas import KINDS, residuals
from robodyn.engines.expression import Graph, Value
from robodyn.engines.factors import Factors
from robodyn.engines.formula_rows import FormulaRows
from robodyn.engines.formulas import Formula, Recorded, cheapest, closure_pivots
from robodyn.engines.frames import relative
from robodyn.engines.machine_rows import Rows
from robodyn.engines.recorded_numbers import evaluated
from robodyn.engines.tangents import Tangents, slopes_by, substituted
from robodyn.errors import InputError
from robodyn.loops.change_points import rank_beside
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.parameters.column_formulas import ColumnFormulas
from robodyn.parameters.lane_states import compiled, solved_lanes
from robodyn.scene.expressions import check_smooth
from robodyn.tables.arrays import Array, Truth

Places = NDArray[np.int64]
Start = tuple[str, int] | None  # what is varied: q or qd of a joint that is held, or a number

STEPS = 20_000  # of a lane, which then ends
BESIDE = 1e-3  # rad from a start, where it is no change point
FIRST = 1e3  # actuated joints go so far before others among those that tell all
WIDE = 8  # lanes of one call at least: fewer would be padded with more to do
WAY = "p"


def serves(mechanism: Mechanism, actuation: Actuation) -> bool:
    """Whether one smooth formula has all accelerations."""
    if mechanism.switches or mechanism.has_tables or actuation.linear or actuation.control:
        return False
    try:
        for line in actuation.lines:
            check_smooth([line.partition(" = ")[2]])
        torque_nodes(mechanism, torque_lines(actuation), Graph(), timed=True)
    except (ValueError, InputError):
        return False
    return elimination_is_safe(mechanism)


def freedoms(mechanism: Mechanism, q: Array) -> tuple[list[int], list[int]]:
    """Rows of closures that have no other's meaning at q (n,), and joints that tell all others.

    These are the actuated ones, with others where they do not suffice.
    """
    from scipy.linalg import null_space, qr

    n, driven, kept = mechanism.n, list(mechanism.actuated), list(range(len(mechanism.rows)))
    Psi = scaled_jacobian(mechanism, q)
    if kept:
        rank = rank_beside(mechanism, q, BESIDE, 4)
        kept = sorted(qr(Psi.T, mode="r", pivoting=True)[1][:rank].tolist())
    if len(driven) + len(kept) == n:
        return kept, driven
    free = null_space(Psi[kept]) if kept else np.eye(n)
    free[driven] *= FIRST
    return kept, sorted(qr(free.T, mode="r", pivoting=True)[1][: n - len(kept)].tolist())


class LaneRuns:
    """Runs of a mechanism under torques to times (T,).

    `varied` tells of each of the k names what it is, `sizes` (k,) their sizes.  The rows `kept` of
    closures have the others' meaning; joints `held` begin as they are given.
    """

    def __init__(
        self,
        formulas: ColumnFormulas,
        varied: Sequence[Start],
        sizes: Array,
        actuation: Actuation,
        times: Array,
        tolerance: float,
        kept: Sequence[int],
        held: Sequence[int],
    ) -> None:
        self.formulas, self.varied, self.sizes = formulas, list(varied), sizes
        self.times, self.tolerance, self.kept, self.held = times, tolerance, kept, list(held)
        ends = np.array(actuation.leaves)  # no step is longer than a leaf that it enters
        self.leaves = ends, np.append(np.diff(ends, prepend=0.0), np.inf)
        self.n, self.k = formulas.mechanism.n, len(sizes)
        self.numbers = [j for j, x in enumerate(varied) if x is None]
        self._rates = self._code(actuation)
        f, n = formulas, self.n
        q, p, r = f.state.inputs[:n], [f"p{i}" for i in range(len(f.p))], len(kept)
        Psi = [x for i in kept for x in f.Psi[i]]
        gap, rate = ([x[i] for i in kept] for x in (f.gap, f.gap_rate))
        parts = ((gap, p), (rate, q), (rate, p))
        slopes = [((r, len(by)), slopes_by(nodes, by)) for nodes, by in parts]
        self._begin = compiled(f.inputs, [((r, n), Psi), *slopes])
        self._loops = compiled(f.inputs, [((r,), gap), ((r, n), Psi)])

    def _code(self, actuation: Actuation) -> Callable[..., Any]:
        """Accelerations of the motion and of each s (1 + k, n), and the lanes without any."""
        n, k, graph = self.n, self.k, self.formulas.graph
        mechanism, named = (
            replace(x, rows=tuple(x.rows[i] for i in self.kept))
            for x in (self.formulas.mechanism, self.formulas.named)
        )
        p = [f"p{i}" for i in range(len(self.numbers))]
        states = [f"z{i}" for i in range(2 * n * k)]
        lines = torque_lines(actuation)
        tau = actuation.constants or torque_nodes(mechanism, lines, graph, timed=True)
        acting: dict[str, Value] = {f"tau{j}": x for j, x in enumerate(tau)}

        def write(way: bool) -> Formula:
            state = Recorded(named, KINDS[1:], way, graph=graph)
            series, r, _, R = residuals(state)
            r, R = substituted(r, acting), substituted(R, acting)
            factors = series.factorise()
            assert isinstance(factors, Factors)
            unknown = factors.solve([-x for x in r])
            held = {f"u{i}": x for i, x in enumerate(unknown)}
            outputs = relative(mechanism, unknown[:n])
            for j, size in enumerate(self.sizes.tolist()):
                own = states[2 * n * j : 2 * n * (j + 1)]
                by: dict[str, Tangents] = {
                    x: {WAY: graph.variable(s)}
                    for x, s in zip(state.inputs[: 2 * n], own, strict=True)
                }
                if j in self.numbers:
                    by[p[self.numbers.index(j)]] = {WAY: size}
                right = [-x for x in substituted(slopes_by(R, by, [WAY]), held)]
                outputs += relative(mechanism, factors.solve(right)[:n])
            own_sizes = Recorded(mechanism, KINDS[1:], way, graph=graph)
            inputs = (*state.inputs[: 2 * n], *states, "t", *p)
            return Formula(inputs, tuple(outputs), closure_pivots(own_sizes, factors))

        formula = cheapest(write)
        assert formula is not None
        machine = Rows([formula.inputs], [formula.outputs], formula.pivots, PIVOT_CUT).compile()
        self.fast = machine is not None
        rows = FormulaRows(formula, lambda _: formula, (n * (1 + k),), PIVOT_CUT)

        def run(x: Array) -> tuple[Array, Places]:
            if machine is None:
                (found,), doubtful = rows.by_numpy([x], 1)
                return found, doubtful
            found = np.empty((len(x), n * (1 + k)))
            return found, machine([x], [found])

        return run

    def __call__(self, changes: Array, q: Array, qd: Array) -> tuple[Array, Array]:
        """(q, qd) (S, T, 2n) from q, qd (S, n), and their derivatives (S, T, 2n, k).

        The numbers of the scene differ by `changes` (S, numbers).  Lanes that end are nan.
        """
        n, k, T = self.n, self.k, len(self.times)
        sound = np.isfinite(q).all(axis=1) & np.isfinite(qd).all(axis=1)
        rows = np.full((len(q), T, 2 * n * (1 + k)), np.nan)
        if sound.any():
            changes = changes[sound]
            with np.errstate(all="ignore"):
                s = self._start(changes, q[sound], qd[sound]) * self.sizes
                y = np.concatenate([q[sound], qd[sound]], axis=1)
                begin = np.concatenate([y[:, None], np.swapaxes(s, 1, 2)], axis=1)
                found = self._run(changes, begin.reshape(len(y), -1))
                flat = np.repeat(changes, T, axis=0), found.reshape(-1, rows.shape[-1])
                rows[sound] = self._closed(*flat, passes=2)[0].reshape(found.shape)
        parts = rows.reshape(len(q), T, 1 + k, 2 * n)
        return parts[:, :, 0], np.moveaxis(parts[:, :, 1:], 2, 3) / self.sizes

    def _x(self, changes: Array, y: Array) -> Array:
        """Inputs of the formulas of columns."""
        x = np.zeros((len(y), len(self.formulas.inputs)))
        x[:, : 2 * self.n] = y[:, : 2 * self.n]
        x[:, x.shape[1] - changes.shape[1] :] = changes
        return x

    def _start(self, changes: Array, q: Array, qd: Array) -> Array:
        """d(q, qd)/dp (S, 2n, k): loops stay closed, and held joints as they are given."""
        n = self.n
        Psi, gap_p, rate_q, rate_p = self._begin(self._x(changes, np.hstack([q, qd])))
        r = Psi.shape[1]
        A = np.concatenate([Psi, np.broadcast_to(np.eye(n)[self.held], (len(q), n - r, n))], axis=1)
        right = np.zeros((2, len(q), n, self.k))
        for j, start in enumerate(self.varied):
            if start is not None:
                right[int(start[0] == "qd"), :, r + start[1], j] = 1.0
        right[0, :, :r, self.numbers] = -np.moveaxis(gap_p, 2, 0)
        right[1, :, :r, self.numbers] = -np.moveaxis(rate_p, 2, 0)
        dq = solved_lanes(A, right[0])
        right[1, :, :r] -= rate_q @ dq
        return np.concatenate([dq, solved_lanes(A, right[1])], axis=1)

    def _closed(self, changes: Array, y: Array, passes: int = 1) -> tuple[Array, Array]:
        """States moved to the nearest that close, and Psi."""
        y, n = y.copy(), self.n
        Psi = np.zeros((len(y), 0, n))
        for _ in range(passes if self.kept else 0):
            gap, Psi = self._loops(self._x(changes, y))
            opening = np.stack([gap, (Psi @ y[:, n : 2 * n, None])[..., 0]], axis=-1)
            back = np.swapaxes(Psi, 1, 2)
            moved = back @ solved_lanes(Psi @ back, opening)
            y[:, : 2 * n] -= np.swapaxes(moved, 1, 2).reshape(len(y), -1)
        return y, Psi

    def _slopes(self, t: Array, y: Array, changes: Array) -> Array:
        """y' (S, 2n (1 + k)); nan where there is none."""
        S, N = y.shape
        x = np.empty((max(S, WIDE), N + 1 + changes.shape[1]))
        x[:S, :N], x[:S, N], x[:S, N + 1 :] = y, t, changes
        x[S:] = x[0]
        bend, doubtful = self._rates(x)
        bend[doubtful] = np.nan
        found = np.empty((S, 1 + self.k, 2, self.n))
        found[:, :, 0] = y.reshape(found.shape)[:, :, 1]
        found[:, :, 1] = bend[:S].reshape(S, 1 + self.k, self.n)
        return found.reshape(S, N)

    def _run(self, changes: Array, y: Array) -> Array:
        """y (S, T, N) at the times, from y (S, N) at the first."""
        times, (S, N) = self.times, y.shape
        rows = np.full((S, len(times), N), np.nan)
        rows[:, 0] = y
        t = np.full(S, times[0])
        f, Psi = self._slopes(t, y, changes), self._closed(changes, y)[1]
        now = _Lanes(np.arange(S), t, np.ones(S, int), _first_steps(y, f), y, f, Psi)
        for _ in range(STEPS):
            ahead = (now.due < len(times)) & (now.h > 1e-14 * (1.0 + np.abs(now.t)))
            ahead &= np.isfinite(now.f).all(axis=1)
            if not ahead.all():
                now = now.chosen(ahead)
            if not len(now.lanes):
                break
            now = self._stepped(now, changes[now.lanes], rows)
        rows[~np.isfinite(rows[:, -1]).all(axis=1)] = np.nan
        return rows

    def _stepped(self, now: _Lanes, changes: Array, rows: Array) -> _Lanes:
        """The lanes after a step of each, or a try; what is due is written into `rows`."""
        last = self.times[-1]
        widest = self.leaves[1][np.searchsorted(self.leaves[0], now.t, "right")]
        step = np.minimum(np.minimum(now.h, widest), last - now.t)
        K = np.empty((len(dop.C), *now.y.shape))
        K[0] = now.f
        self._stages(now, step, changes, K, range(1, dop.N_STAGES))
        new = now.y + step[:, None] * _along(dop.B, K)
        end = np.where(step < last - now.t, now.t + step, last)
        K[dop.N_STAGES] = self._slopes(end, new, changes)
        error = self._error(now.y, new, step, K)
        good = error < 1.0
        factor = 0.9 * np.maximum(error, 1e-12) ** (-1.0 / 8.0)
        reached = np.where(good, np.searchsorted(self.times, end, "right"), now.due)
        if (reached > now.due).any():
            self._stages(now, step, changes, K, range(dop.N_STAGES + 1, len(dop.C)))
            self._tell(now, new, step, K, reached, rows)
        moved, there = self._closed(changes, new)
        leapt = np.linalg.det(there @ np.swapaxes(now.Psi, 1, 2)) <= 0.0
        f = np.where(good[:, None], K[dop.N_STAGES], now.f)
        f[good & leapt] = np.nan  # a loop turned over, or may have: for one run alone
        return _Lanes(
            now.lanes,
            t=np.where(good, end, now.t),
            due=reached,
            h=step * np.clip(factor, 0.2, np.where(good, 10.0, 1.0)),
            y=np.where(good[:, None], moved, now.y),
            f=f,
            Psi=np.where(good[:, None, None], there, now.Psi),
        )

    def _stages(self, now: _Lanes, step: Array, changes: Array, K: Array, which: range) -> None:
        """Write the slopes at these stages of a step into K (stages, S, N)."""
        for s in which:
            there = now.y + step[:, None] * _along(dop.A[s, :s], K)
            K[s] = self._slopes(now.t + dop.C[s] * step, there, changes)

    def _error(self, y: Array, new: Array, step: Array, K: Array) -> Array:
        """The error of each lane's step, in tolerances."""
        scale = self.tolerance * (1.0 + np.maximum(np.abs(y), np.abs(new)))
        five, three = (np.sum((_along(E, K) / scale) ** 2, axis=1) for E in (dop.E5, dop.E3))
        size = np.sqrt(np.maximum((five + 0.01 * three) * y.shape[1], 1e-300))
        error = step * five / size
        return np.where(np.isfinite(error), error, np.inf)

    def _tell(
        self, now: _Lanes, new: Array, step: Array, K: Array, reached: Places, rows: Array
    ) -> None:
        """Write what is due within a step, by its dense output."""
        told = np.flatnonzero(reached > now.due)
        width, change = step[:, None], new - now.y
        F = [change, width * now.f - change, 2.0 * change - width * (K[dop.N_STAGES] + now.f)]
        F += [width * _along(weights, K) for weights in dop.D]
        which = np.repeat(told, (reached - now.due)[told])
        place = np.concatenate([np.arange(now.due[i], reached[i]) for i in told])
        x = ((self.times[place] - now.t[which]) / step[which])[:, None]
        value = np.zeros((len(x), now.y.shape[1]))
        for i, part in enumerate(reversed(F)):
            value = (value + part[which]) * (x if i % 2 == 0 else 1.0 - x)
        rows[now.lanes[which], place] = value + now.y[which]


class _Lanes(NamedTuple):
    """The lanes that still run: which of all they are, times, and which time is due next.

    With the steps h to try, y and its slopes f (S, N), and Psi (S, r, n).
    """

    lanes: Places
    t: Array
    due: Places
    h: Array
    y: Array
    f: Array
    Psi: Array

    def chosen(self, which: Truth) -> _Lanes:
        """Some of them."""
        chosen: list[Any] = [x[which] for x in self]
        return _Lanes(*chosen)


def _first_steps(y: Array, f: Array) -> Array:
    size = 1.0 + np.abs(y)
    h = 0.01 * np.linalg.norm(y / size, axis=1) / (np.linalg.norm(f / size, axis=1) + 1e-10)
    return np.asarray(np.maximum(h, 1e-6))


def _along(weights: Array, K: Array) -> Array:
    """The sum of weights K, over the first stages."""
    return np.asarray(np.tensordot(weights, K[: len(weights)], 1))


def torque_lines(actuation: Actuation) -> tuple[str, ...]:
    """Those of torques that may depend on the state, as they were given."""
    if actuation.constants is not None or actuation.linear or actuation.control is not None:
        return ()
    return (actuation.given or actuation).lines


def torque_nodes(
    mechanism: Mechanism, lines: Sequence[str], graph: Graph, timed: bool = False
) -> list[Value]:
    """Those of the torques (n) that depend on the state as nodes, 0 for others; or all, `timed`."""
    found: list[Value] = [0.0] * mechanism.n
    for line in lines:
        names = {x.id for x in ast.walk(ast.parse(line)) if isinstance(x, ast.Name)}
        state = {x for x in names if re.fullmatch("qd?[0-9]+", x)}
        if not state and not timed:
            continue
        target, _, code = line.partition(" = ")
        variables = {x: graph.variable(x) for x in (*state, "t")}
        try:
            found[int(target.removeprefix("tau"))] = evaluated(code, variables)
        except (TypeError, NameError, ValueError, AttributeError):
            joint = target.removeprefix("tau")
            what, limit = (
                "tau",
                "a function of Python has no derivative: give an expression as text",
            )
            if joint.isdigit():
                what = f"tau{int(joint) + 1}"
                limit = "has no derivative: of q and qd take arithmetic and smooth functions"
            raise InputError(what, where=mechanism.source, limit=limit) from None
    return found
