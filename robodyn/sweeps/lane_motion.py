"""The mechanics of lanes: the program of their scene, with numpy arrays over the lanes as numbers.

Mechanisms whose programs have one shape differ in numbers alone, and go together.  Joint and link
values are arrays (n, B), B lanes along the last axis; series have their orders along the first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.expansion import MotionProgram
from robodyn.engines.factors import Factors
from robodyn.engines.series import Arithmetic, Series
from robodyn.loops.closing import CLOSED, loop_size
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.program import Program, Slot
from robodyn.sweeps.step_extremes import powers
from robodyn.taylor import HOPELESS, PASSES

Array = NDArray[np.float64]
Lanes = NDArray[Any]
Number = Any  # a float that all lanes share, or an array (B,)
Row = dict[int, Number]

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


class LaneProgram:
    """The program of one mechanism, for lanes; `driven` (n) tells where there are torques."""

    def __init__(self, mechanism: Mechanism, driven: Sequence[bool]) -> None:
        self.mechanism = mechanism
        constants = tuple(1.0 if x else 0.0 for x in driven)
        self.motion = MotionProgram(mechanism, Actuation(constants), work=True)
        rows, size = mechanism.rows, loop_size(mechanism)
        inertias = [a.real for j, k, a in mechanism.A if j == k and a.real > 0.0]
        # besides the numbers of the program: sizes of rows, and of the loops; the lightest link
        self.sizes = [*(row.size**2 for row in rows), CLOSED * size, min(inertias)]

    @property
    def numbers(self) -> list[float]:
        """All that may differ between mechanisms of one key."""
        return [*self.motion.program.numbers, *self.motion.arms, *self.sizes]

    @property
    def key(self) -> tuple[object, ...]:
        """What lanes of one `LaneMotion` share."""
        return self.motion.program.shape, self.mechanism.parent


class LaneMotion:
    """Series, energies and closings of lanes.

    Lane b is of `programs[which[b]]`, which have one key, under the torques tau[b] (n,).
    """

    def __init__(
        self, programs: Sequence[LaneProgram], which: Lanes, tau: Array, order: int
    ) -> None:
        first = programs[0]
        mechanism, self.motion = first.mechanism, first.motion
        self.n, self.r, self.order = mechanism.n, len(mechanism.rows), order
        self.parent, self.outward = mechanism.parent, mechanism.order
        self.rubs = bool(mechanism.friction)
        program = self.program = self.motion.program
        self.closures = replace(program, residuals=program.residuals[self.n :])
        self.states = replace(program, residuals=[])
        self.numbers: list[Number] = [
            x[0] if (np.array(x) == x[0]).all() else np.array(x)[which]
            for x in zip(*(each.numbers for each in programs), strict=True)
        ]
        self.tau: list[Number] = [
            float(x[0]) if (x == x[0]).all() else np.ascontiguousarray(x) for x in tau.T
        ]

    def kept(self, lanes: Lanes) -> LaneMotion:
        """Another of these lanes alone."""

        def of(values: list[Number]) -> list[Number]:
            return [x[lanes] if np.ndim(x) else x for x in values]

        other = object.__new__(LaneMotion)
        other.__dict__ |= self.__dict__
        other.numbers, other.tau = of(self.numbers), of(self.tau)
        return other

    def _rest(self, begin: int, count: int) -> list[Number]:
        """Numbers behind those of the program."""
        begin += len(self.program.numbers)
        return self.numbers[begin : begin + count]

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

    def _series(
        self, program: Program, q: Array, qd: Array, orders: int, slots: Sequence[Slot] = ()
    ) -> Series:
        arithmetic = over_lanes(q.shape[1])
        start = self.motion.state(arithmetic, 0.0, [*q, *qd], ((), ()))
        start.given.update((f"tau{j}", (tau,)) for j, tau in enumerate(self.tau))
        return Series(program, arithmetic, self.numbers, orders, start, slots=slots)

    def expand(self, q: Array, qd: Array) -> Expanded:
        """The series of motions from states (n, B)."""
        order, motion = self.order, self.motion
        series = self._series(self.program, q, qd, order, [*motion.power, *motion.bends])
        series.expand()
        if motion.power:
            series.residuals(order)
        turns = [series.turn(slot) for slot in motion.turns]
        rho, theta = (np.stack([turn[i][: order + 2] for turn in turns], 1) for i in (0, 1))
        orders = np.arange(1.0, order + 2)[:, None, None]
        rising, turning = orders * rho[1:], orders * theta[1:]
        rates = np.empty_like(rising)
        for m in range(order + 1):  # Im(conj(z) z')
            rates[m] = turning[m]
            if m > 1:  # rho_0 = 1, rho_1 = theta_0 = 0
                rates[m] += _sums(rho[m:1:-1], turning[: m - 1])
                rates[m] -= _sums(theta[m - 1 : 0 : -1], rising[1:m])
        power = np.array(series.real[motion.power[0]][: order + 1]) if motion.power else None
        if any(np.any(tau) for tau in self.tau):
            power = np.zeros((order + 1, q.shape[1])) if power is None else power
            own = self.relative(rates)
            for j, tau in enumerate(self.tau):
                power += tau * own[:, j]
        watched = [series.real[slot][:order] for slot in motion.bends]
        empty = np.zeros((order, 0, q.shape[1]))
        return Expanded(rates, power, np.stack(watched, 1) if watched else empty)

    def agrees(
        self, series: Expanded, x: Array, q: Array, qd: Array, rtol: float, atol: float
    ) -> NDArray[np.bool_]:
        """Whether what may bend, x (B,) after the series began, is at q and qd what they say.

        It is not where friction is flat, or springs' ends pass one another; what a series misses by
        may be rounding of its terms, or what moves no link by more than the tolerance.
        """
        bends = self.motion.bends
        there = self._series(self.states, q, qd, 0, bends)
        there.residuals(0)
        miss = (atol + rtol * np.abs(series.rates[0]).max(axis=0)) * (self.order + 1)
        miss = miss * self._rest(len(bends) + self.r + 1, 1)[0] / np.abs(x)
        terms = series.watched * powers(x, len(series.watched))[:, None]
        found = np.ones(len(x), bool)
        for k, (slot, arm) in enumerate(zip(bends, self._rest(0, len(bends)), strict=True)):
            total, most = terms[:, k].sum(axis=0), np.abs(terms[:, k]).max(axis=0)
            allowed = np.maximum(miss / arm, max(math.sqrt(rtol), KINK) * most)
            found &= np.abs(total - there.real[slot][0]) <= allowed
        return found

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
        slots = [slot for name in ("KE", "PE") for slot in self.program.named[name]]
        series = self._series(self.states, q, qd, 0, slots)
        series.residuals(0)
        KE, PE = (series.real[slot][0] for slot in slots)
        return KE, PE

    # -- closures ----------------------------------------------------------------------------------

    def close(self, q: Array, qd: Array) -> Array:
        """Move states (n, B) in place to the nearest that close; their qualities (B,)."""
        B = q.shape[1]
        if not self.r:
            return np.full(B, math.inf)
        *sizes, closed = self._rest(len(self.motion.bends), self.r + 1)
        before, moving = np.full(B, math.inf), np.ones(B, bool)
        for trial in range(PASSES + 1):
            gap, Psi = self._closures(q, qd)
            factors = Factors(_products(Psi), self.r)
            pivots = [pivot / size for pivot, size in zip(factors.pivots, sizes, strict=True)]
            least = np.min([np.broadcast_to(pivot, B) for pivot in pivots], axis=0)
            quality = np.nan_to_num(least, nan=-math.inf)
            largest = np.max(np.abs(gap), axis=0)
            # what is closed to rounding stays: moving it would add noise
            done = (largest <= closed) | (largest > 0.5 * before)
            moving &= ~done & (quality > HOPELESS)
            if trial == PASSES or not moving.any():
                break
            before = np.where(moving, largest, before)
            _step(q, Psi, factors.solve(gap), moving)
        speeds = [_sum_of({k: x * qd[k] for k, x in row.items()}, B) for row in Psi]
        _step(qd, Psi, factors.solve(speeds), quality > HOPELESS)
        return quality

    def leaps(self, q: Array, new_q: Array) -> NDArray[np.bool_]:
        """Which steps (B,) cross a singular configuration, as `change_points.Misses` tells it."""
        if not self.r:
            return np.zeros(q.shape[1], bool)
        rates = np.zeros_like(q)
        Psi, other = (self._dense(self._closures(x, rates)[1], q.shape) for x in (q, new_q))
        product = np.einsum("rnb,snb->brs", Psi, other)
        return np.asarray(np.linalg.slogdet(product)[0] < 0.0)

    def _dense(self, Psi: list[Row], shape: tuple[int, ...]) -> Array:
        dense = np.zeros((self.r, *shape))
        for r, row in enumerate(Psi):
            for k, x in row.items():
                dense[r, k] = x
        return dense

    def _closures(self, q: Array, qd: Array) -> tuple[list[Number], list[Row]]:
        """The gaps, and the rows of Psi by joint."""
        gaps = self.program.named["gap"]
        series = self._series(self.closures, q, qd, 1, gaps)
        series.residuals(0)
        Psi = [{k: x for k, x in row.items() if k < self.n} for row in series.matrix()]
        for row in Psi:
            for k in reversed(self.outward):
                above = self.parent[k]
                if above is not None and k in row:
                    row[above] = row[above] + row[k] if above in row else row[k]
        return [series.real[slot][0] for slot in gaps], Psi


def _sums(a: Array, b: Array) -> Array:
    """Sums of a_k b_k over the orders, (n, B)."""
    if a.shape[2] == 1:  # of one lane numpy would add in another order
        return np.asarray(np.einsum("knb,knb->nb", a.repeat(2, axis=2), b.repeat(2, axis=2))[:, :1])
    return np.asarray(np.einsum("knb,knb->nb", a, b))


def _sum_of(terms: Row, B: int) -> Array:
    total = np.zeros(B)
    for value in terms.values():
        total += value
    return total


def _products(Psi: list[Row]) -> list[Row]:
    """Psi Psi^T."""
    products: list[Row] = []
    for row in Psi:
        products.append({})
        for s, other in enumerate(Psi):
            common = [row[k] * other[k] for k in row if k in other]
            if common:
                products[-1][s] = sum(common[1:], common[0])
    return products


def _step(values: Array, Psi: list[Row], multipliers: list[Number], where: Lanes) -> None:
    """Subtract Psi^T multipliers in place, in some of the lanes."""
    steps: Row = {}
    for row, multiplier in zip(Psi, multipliers, strict=True):
        for k, x in row.items():
            steps[k] = steps[k] + x * multiplier if k in steps else x * multiplier
    for k, step in steps.items():
        values[k] -= np.where(where, step, 0.0)


