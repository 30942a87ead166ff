"""The mechanics of lanes: the program of their scene, with numpy arrays over the lanes as numbers.

Mechanisms whose programs have one shape differ in numbers alone, and go together.  Joint and link
values are arrays (n, B), B lanes along the last axis; series have their orders along the first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.loops.misses import orientation
from robodyn.sweeps.lane_program import (
    Code,
    LaneProgram,
    Quantity,
    Start,
    code_of,
    over_lanes,
    state_of,
)
from robodyn.sweeps.step_extremes import powers, sums
from robodyn.taylor import HOPELESS, PASSES

Array = NDArray[np.float64]
Lanes = NDArray[Any]
Number = Any  # a float that all lanes share, or an array (B,)

KINK = 1e-7  # a torque that misses its series by a smaller part does not bend


class Expanded(NamedTuple):
    """Series of B lanes: the links' rates, the power, and what may bend; orders first."""

    rates: Array  # (order + 1, n, B)
    power: Array | None  # (order + 1, B); None where there is none besides steady torques
    watched: Array  # (order, k, B)

    def some(self, lanes: Lanes) -> Expanded:
        """The series of these lanes alone."""
        return Expanded(self.rates[:, :, lanes], None, self.watched[:, :, lanes])


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
        self._codes: dict[str, Code] = {}
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
            state = state_of(program, *lists)
            values = what(program, Start(over_lanes(B), numbers, sizes, list(q), list(qd), state))
            return np.array([np.broadcast_to(x, B) for x in values])
        name = what.__name__
        if name not in self._codes:
            self._codes[name] = code_of(what, program)
        code = self._codes[name]
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
        rates = turning.copy()
        for m in range(2, order + 1):  # Im(conj(z) z'); rho_0 = 1, rho_1 = theta_0 = 0
            rates[m] += sums(rho[m:1:-1], turning[: m - 1])
            rates[m] -= sums(theta[m - 1 : 0 : -1], rising[1:m])
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
        """Which steps (B,) may cross a singular configuration, as `misses.py` tells it."""
        if not self.r:
            return np.zeros(q.shape[1], bool)
        still, mechanism = np.zeros_like(q), self.program.mechanism
        Psi = (
            self.program.rows(self._evaluate(LaneProgram.jacobian, x, still)) for x in (q, new_q)
        )
        found: NDArray[np.bool_] = np.any(
            [~(x > 0.0) for x in orientation(mechanism, *Psi)], axis=0
        )
        return found
