"""The mechanics of lanes: the program of their scene, with numpy arrays over the lanes as numbers.

Mechanisms whose programs have one shape differ in numbers alone, and go together.  Joint and link
values are arrays (n, B), B lanes along the last axis; series have their orders along the first.

What the program tells is evaluated as straight-line numpy code, written once for each shape; of
large mechanisms, whose code would be long, row by row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.expansion import MotionProgram
from robodyn.engines.expression import Graph
from robodyn.engines.factors import Factors
from robodyn.engines.formulas import RECORDED, Formula
from robodyn.engines.series import Arithmetic, Series, State, Value
from robodyn.engines.straightline import compile_arrays
from robodyn.loops.closing import CLOSED, loop_size
from robodyn.loops.projection import loop_terms
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.program import Slot
from robodyn.sweeps.step_extremes import powers
from robodyn.taylor import HOPELESS, PASSES

Array = NDArray[np.float64]
Lanes = NDArray[Any]
Number = Any  # a float that all lanes share, or an array (B,)

STRAIGHT = 1000  # entries of A and P, times the order, up to which straight-line code is written
KINK = 1e-7  # a torque that misses its series by a smaller part does not bend


def _convolve(x: Array, y: Array, m: int, first: int, last: int) -> Array:
    """Sum of x_j y_{m-j} for j from first to last."""
    a, b = x[first : last + 1], y[m - last : m - first + 1][::-1]
    if a.shape[1] == 1:  # of one lane numpy would add in another order
        return np.asarray(np.einsum("kb,kb->b", a.repeat(2, axis=1), b.repeat(2, axis=1))[:1])
    return np.asarray(np.einsum("kb,kb->b", a, b))


def _power(x: Number, exponent: float) -> Number:
    if exponent == -0.5:
        return 1.0 / np.sqrt(x)
    return np.sqrt(x) if exponent == 0.5 else np.power(x, exponent)


def over_lanes(B: int) -> Arithmetic:
    """Numbers are arrays (B,), series (K, B)."""
    return Arithmetic(
        cos=np.cos,
        sin=np.sin,
        power=_power,
        functions={"tanh": np.tanh},
        convolve=_convolve,
        room=lambda orders: np.zeros((orders, B)),
    )


class Expanded(NamedTuple):
    """Series of B lanes: the links' rates, the power, and what may bend; orders first."""

    rates: Array  # (order + 1, n, B)
    power: Array | None  # (order + 1, B); None where there is none besides steady torques
    watched: Array  # (order, k, B)

    def some(self, lanes: Lanes) -> Expanded:
        """The series of these lanes alone."""
        return Expanded(self.rates[:, :, lanes], None, self.watched[:, :, lanes])


class _Start(NamedTuple):
    """Where something is evaluated, over any kind of numbers; q and qd (n)."""

    arithmetic: Arithmetic
    numbers: Sequence[Value]
    sizes: Sequence[Value]  # of rows
    q: Sequence[Value]
    qd: Sequence[Value]
    state: State


class LaneProgram:
    """The program of one mechanism, for lanes; `driven` (n) tells where there are torques.

    Those of one `key` are equal: they differ in `numbers` alone.
    """

    def __init__(self, mechanism: Mechanism, driven: NDArray[np.bool_], order: int) -> None:
        self.mechanism, self.order = mechanism, order
        constants = tuple(1.0 if x else 0.0 for x in driven)
        self.motion = MotionProgram(mechanism, Actuation(constants), work=True)
        self.n, self.r = mechanism.n, len(mechanism.rows)
        program = self.program = self.motion.program
        self.closures = replace(program, residuals=program.residuals[self.n :])
        self.states = replace(program, residuals=[])
        lightest = min(a.real for j, k, a in mechanism.A if j == k and a.real > 0.0)
        self.sizes = [row.size**2 for row in mechanism.rows]
        self.others = [CLOSED * loop_size(mechanism), lightest, *self.motion.arms]
        self.straight = loop_terms(mechanism) * order <= STRAIGHT

    @property
    def numbers(self) -> list[float]:
        """All that may differ between those of one key."""
        return [*self.program.numbers, *self.sizes, *self.others]

    @cached_property
    def key(self) -> tuple[object, ...]:
        """What lanes of one `LaneMotion` share."""
        return self.program.shape, self.mechanism.parent, self.order

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LaneProgram) and self.key == other.key

    # -- what is evaluated, in one list ------------------------------------------------------------

    def series(self, at: _Start) -> list[Value]:
        """rho (order + 2, n), theta likewise, power (order + 1), what may bend (order, k)."""
        found = self.motion.expand(at.arithmetic, at.numbers, self.order, at.state)
        values = [*zip(*found.rho, strict=True), *zip(*found.theta, strict=True)]
        values += [*zip(found.power), *zip(*found.watched, strict=True)]
        return [x for each in values for x in each]

    def watched(self, at: _Start) -> list[Value]:
        """The values (k) of what may bend."""
        return self._values(at, self.motion.bends)

    def energies(self, at: _Start) -> list[Value]:
        """KE and PE less its constant, J."""
        return self._values(at, [*self.program.named["KE"], *self.program.named["PE"]])

    def _values(self, at: _Start, slots: Sequence[Slot]) -> list[Value]:
        series = Series(self.states, at.arithmetic, at.numbers, 0, at.state, slots=slots)
        series.residuals(0)
        return [series.real[slot][0] for slot in slots]

    def closing(self, at: _Start) -> list[Value]:
        """A Newton step of q (n), the rates' projection (n), gaps (r), relative pivots (r)."""
        gaps, Psi = self._closures(at)
        normal = [
            {s: total for s, other in enumerate(Psi) if (total := _dot(row, other)) is not None}
            for row in Psi
        ]
        factors = Factors(normal, self.r)
        speeds = [_dot(row, dict(enumerate(at.qd))) for row in Psi]
        values: list[Value] = []
        for right in (gaps, speeds):
            multipliers = dict(enumerate(factors.solve(right)))
            for k in range(self.n):
                step = _dot({r: row[k] for r, row in enumerate(Psi) if k in row}, multipliers)
                values.append(0.0 if step is None else step)
        pivots = zip(factors.pivots, at.sizes, strict=True)
        return [*values, *gaps, *(pivot / size for pivot, size in pivots)]

    def jacobian(self, at: _Start) -> list[Value]:
        """Psi (r, n)."""
        return [row.get(k, 0.0) for row in self._closures(at)[1] for k in range(self.n)]

    def _closures(self, at: _Start) -> tuple[list[Value], list[dict[int, Value]]]:
        """The gaps, and the rows of Psi by joint."""
        gaps = self.program.named["gap"]
        series = Series(self.closures, at.arithmetic, at.numbers, 1, at.state, slots=gaps)
        series.residuals(0)
        Psi = [{k: x for k, x in row.items() if k < self.n} for row in series.matrix()]
        for row in Psi:
            for k in reversed(self.mechanism.order):
                above = self.mechanism.parent[k]
                if above is not None and k in row:
                    row[above] = row[above] + row[k] if above in row else row[k]
        return [series.real[slot][0] for slot in gaps], Psi


def _dot(a: dict[int, Value], b: dict[int, Value]) -> Value | None:
    products = [a[k] * b[k] for k in a if k in b]
    return sum(products[1:], products[0]) if products else None


Quantity = Callable[[LaneProgram, _Start], list[Value]]


class _Code(NamedTuple):
    function: Callable[..., None]
    buffers: int
    outputs: int


@lru_cache(maxsize=64)
def _code(what: Quantity, program: LaneProgram) -> _Code:
    """Straight-line code of what programs of one key tell."""
    graph, n = Graph(), program.n

    def variables(name: str, count: int) -> list[Value]:
        return [graph.variable(f"{name}{k}") for k in range(count)]

    lists = {name: variables(name, n) for name in ("q", "qd", "alpha", "rate", "c", "s", "tau")}
    numbers, sizes = variables("number", len(program.program.numbers)), variables("size", program.r)
    state = _state(program, *lists.values())
    outputs = what(program, _Start(RECORDED, numbers, sizes, lists["q"], lists["qd"], state))
    names = [str(x.args[0]) for each in (*lists.values(), numbers, sizes) for x in each]
    function, buffers = compile_arrays(Formula(tuple(names), tuple(outputs), ()), what.__name__)
    return _Code(function, buffers, len(outputs))


def _state(
    program: LaneProgram, q: Any, qd: Any, alpha: Any, w: Any, c: Any, s: Any, tau: Any
) -> State:
    given = program.motion.given(0.0, q, qd, alpha, ((), ()))
    given |= {f"tau{j}": (x,) for j, x in enumerate(tau)}
    return State(list(zip(c, s, strict=True)), w, given)


class LaneMotion:
    """Series, energies and closings of lanes.

    Lane b is of `programs[which[b]]`, which are equal, under the torques tau[b] (n,).
    """

    def __init__(self, programs: Sequence[LaneProgram], which: Lanes, tau: Array) -> None:
        first = self.program = programs[0]
        self.n, self.r, self.order = first.n, first.r, first.order
        self.parent, self.outward = first.mechanism.parent, first.mechanism.order
        self.rubs = bool(first.mechanism.friction)
        self.driven = bool(tau.any())
        self.numbers: list[Number] = [
            x[0] if (np.array(x) == x[0]).all() else np.array(x)[which]
            for x in zip(*(each.numbers for each in programs), strict=True)
        ]
        self.tau: list[Number] = [
            float(x[0]) if (x == x[0]).all() else np.ascontiguousarray(x) for x in tau.T
        ]
        self._work = np.zeros(0)

    def kept(self, lanes: Lanes) -> LaneMotion:
        """Another of these lanes alone."""

        def of(values: list[Number]) -> list[Number]:
            return [x[lanes] if np.ndim(x) else x for x in values]

        other = object.__new__(LaneMotion)
        other.__dict__ |= self.__dict__
        other.numbers, other.tau = of(self.numbers), of(self.tau)
        return other

    # -- kinematics --------------------------------------------------------------------------------

    def absolute(self, joint: Array) -> Array:
        """Sums along the paths from the ground (n, B), as alpha = J q."""
        total = joint.copy()
        for k in self.outward:
            above = self.parent[k]
            if above is not None:
                total[k] += total[above]
        return total

    def relative(self, absolute: Array) -> Array:
        """Joint values of absolute ones, along the axis before the last."""
        own = absolute.copy()
        for k, above in enumerate(self.parent):
            if above is not None:
                own[..., k, :] -= absolute[..., above, :]
        return own

    # -- the program -------------------------------------------------------------------------------

    def _evaluate(self, what: Quantity, q: Array, qd: Array) -> Array:
        """What the program tells at states (n, B)."""
        program, B = self.program, q.shape[1]
        alpha, w = self.absolute(q), self.absolute(qd)
        lists: list[Any] = [q, qd, alpha, w, np.cos(alpha), np.sin(alpha), self.tau]
        count = len(program.program.numbers)
        numbers, sizes = self.numbers[:count], self.numbers[count : count + self.r]
        if not program.straight:
            state = _state(program, *lists)
            values = what(program, _Start(over_lanes(B), numbers, sizes, list(q), list(qd), state))
            return np.array([np.broadcast_to(x, B) for x in values])
        code = _code(what, program)
        if self._work.size < code.buffers * B:
            self._work = np.empty(code.buffers * B)
        work = self._work[: code.buffers * B].reshape(code.buffers, B)
        found = np.empty((code.outputs, B))
        code.function(*(x for each in lists for x in each), *numbers, *sizes, *found, *work)
        return found

    def expand(self, q: Array, qd: Array) -> Expanded:
        """The series of motions from states (n, B)."""
        order, n, B = self.order, self.n, q.shape[1]
        found = self._evaluate(LaneProgram.series, q, qd)
        size = (order + 2) * n
        rho, theta = (found[i * size : (i + 1) * size].reshape(order + 2, n, B) for i in (0, 1))
        rest = found[2 * size :]
        orders = np.arange(1.0, order + 2)[:, None, None]
        rising, turning = orders * rho[1:], orders * theta[1:]
        rates = np.empty_like(rising)
        for m in range(order + 1):  # Im(conj(z) z')
            rates[m] = turning[m]
            if m > 1:  # rho_0 = 1, rho_1 = theta_0 = 0
                rates[m] += _sums(rho[m:1:-1], turning[: m - 1])
                rates[m] -= _sums(theta[m - 1 : 0 : -1], rising[1:m])
        power = None
        if self.program.motion.power:
            power, rest = rest[: order + 1].copy(), rest[order + 1 :]
        if self.driven:
            power = np.zeros((order + 1, B)) if power is None else power
            own = self.relative(rates)
            for j, tau in enumerate(self.tau):
                power += tau * own[:, j]
        return Expanded(rates, power, rest.reshape(order, -1, B))

    def agrees(
        self, series: Expanded, x: Array, q: Array, qd: Array, rtol: float, atol: float
    ) -> NDArray[np.bool_]:
        """Whether what may bend, x (B,) after the series began, is at q and qd what they say.

        It is not where friction is flat, or springs' ends pass one another; what a series misses by
        may be rounding of its terms, or what moves no link by more than the tolerance.
        """
        there = self._evaluate(LaneProgram.watched, q, qd)
        lightest, *arms = self._others[1:]
        miss = (atol + rtol * np.abs(series.rates[0]).max(axis=0)) * (self.order + 1)
        miss = miss * lightest / np.abs(x)
        terms = series.watched * powers(x, self.order)[:, None]
        found = np.ones(len(x), bool)
        for k, arm in enumerate(arms):
            total, most = terms[:, k].sum(axis=0), np.abs(terms[:, k]).max(axis=0)
            allowed = np.maximum(miss / arm, max(math.sqrt(rtol), KINK) * most)
            found &= np.abs(total - there[k]) <= allowed
        return found

    @property
    def _others(self) -> list[Number]:
        return self.numbers[len(self.program.program.numbers) + self.r :]

    def longest(self, W: Array, rtol: float, atol: float) -> Array:
        """The steps whose last terms are within the tolerance (B,), s; nan if not finite."""
        order = len(W) - 1
        speed = np.abs(W[0]).max(axis=0)
        h = np.full(W.shape[2], math.inf)
        for k in range(order - 3, order + 1):
            largest = np.abs(W[k]).max(axis=0)
            h = np.minimum(h, ((atol + rtol * speed) / largest) ** (1.0 / k))
            h = np.minimum(h, ((atol + rtol) * (k + 1) / largest) ** (1.0 / (k + 1)))
        finite = np.isfinite(W[order - 3 :].sum(axis=(0, 1)))
        return np.where(finite, h, math.nan)

    def energies(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """KE and PE less its constant (B,), J."""
        KE, PE = self._evaluate(LaneProgram.energies, q, qd)
        return KE, PE

    # -- closures ----------------------------------------------------------------------------------

    def close(self, q: Array, qd: Array) -> Array:
        """Move states (n, B) in place to the nearest that close; their qualities (B,)."""
        B, n, r = q.shape[1], self.n, self.r
        if not r:
            return np.full(B, math.inf)
        closed = self._others[0]
        before, moving = np.full(B, math.inf), np.ones(B, bool)
        for trial in range(PASSES + 1):
            found = self._evaluate(LaneProgram.closing, q, qd)
            quality = np.nan_to_num(found[2 * n + r :].min(axis=0), nan=-math.inf)
            largest = np.abs(found[2 * n : 2 * n + r]).max(axis=0)
            # what is closed to rounding stays: moving it would add noise
            done = (largest <= closed) | (largest > 0.5 * before)
            moving &= ~done & (quality > HOPELESS)
            if trial == PASSES or not moving.any():
                break
            before = np.where(moving, largest, before)
            q -= np.where(moving, found[:n], 0.0)
        qd -= np.where(quality > HOPELESS, found[n : 2 * n], 0.0)
        return np.asarray(quality)

    def leaps(self, q: Array, new_q: Array) -> NDArray[np.bool_]:
        """Which steps (B,) cross a singular configuration, as `change_points.Misses` tells it."""
        B = q.shape[1]
        if not self.r:
            return np.zeros(B, bool)
        still = np.zeros_like(q)
        Psi, other = (
            self._evaluate(LaneProgram.jacobian, x, still).reshape(self.r, self.n, B)
            for x in (q, new_q)
        )
        product = np.einsum("rnb,snb->brs", Psi, other)
        return np.asarray(np.linalg.slogdet(product)[0] < 0.0)


def _sums(a: Array, b: Array) -> Array:
    """Sums of a_k b_k over the orders, (n, B)."""
    if a.shape[2] == 1:  # of one lane numpy would add in another order
        return np.asarray(np.einsum("knb,knb->nb", a.repeat(2, axis=2), b.repeat(2, axis=2))[:, :1])
    return np.asarray(np.einsum("knb,knb->nb", a, b))
