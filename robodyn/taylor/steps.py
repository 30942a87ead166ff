"""Engines of the Taylor integrator in Python: one expansion and one step at a time."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.actuation import Actuation
from robodyn.mechanism import Mechanism
from robodyn.projection import FloatClosing, suspect_quality
from robodyn.taylor import Chunk, Status, step_size
from robodyn.taylor.arrays import ArraySeries, link_rates
from robodyn.taylor.code import Expansion, compile_expansion
from robodyn.taylor.torques import TorqueSeries

Array = NDArray[np.float64]
Expanded = tuple[float, list[float], Any]  # h, the state at its end, the series

KINK = 1e-7  # a torque that misses its series by a smaller part does not bend
LANDINGS = (0.85, 0.7, 0.55, 0.4)  # parts of a step to try where it ends near a change point


class SteppingEngine:
    """Advances by the steps that `expand` makes, and lands them where the next series is good."""

    order: int

    def __init__(
        self,
        mechanism: Mechanism,
        closing: FloatClosing | None,
        order: int,
        rtol: float,
        atol: float,
        torques: tuple[float, ...] | TorqueSeries,
        work: bool,
    ) -> None:
        if mechanism.has_state_forces and not isinstance(torques, TorqueSeries):
            torques = TorqueSeries(Actuation(tuple(torques)), mechanism)
        self.mechanism, self.closing, self.torques = mechanism, closing, torques
        self.suspect = suspect_quality(mechanism) if closing is not None else 0.0
        self.order, self.work = order, work
        self.tolerances = float(rtol), float(atol)  # numpy scalars would be ten times slower
        self.constants: tuple[float, ...] | None = None
        if not isinstance(torques, TorqueSeries):
            self.constants = tuple(map(float, torques))
        # what no accuracy of the series excludes: torques that end, or bend, within a step
        self.bends = torques if isinstance(torques, TorqueSeries) and torques.bends else None
        self.lightest = min((a.real for j, k, a in mechanism.A if j == k and a.real > 0.0))
        self.last: tuple[float, list[float], Any] = (0.0, [], ())  # t, y and series of a step
        self.halts: Callable[[float], bool] | None = None  # asked after each step
        self.prepare()

    def prepare(self) -> None:
        """Make what `expand` needs."""
        raise NotImplementedError

    def expand(self, t: float, y: list[float], most: float, direction: float) -> Expanded:
        """The series at y, a step h of at most `most`, and the state at its end."""
        raise NotImplementedError

    def advance(self, t: float, y: Array, bound: float, times: Array, steps: int) -> Chunk:
        """See `Engine`."""
        state: list[float] = y.tolist()
        direction = 1.0 if bound > t else -1.0
        ends: list[float] = []
        states: list[list[float]] = []
        rows: list[Array] = []
        due = 0
        status = Status.FULL
        while len(ends) < steps:
            most = (bound - t) * direction
            h, new, series = self.expand(t, state, most, direction)
            if not len(series):
                status = Status.NOT_FINITE
                break
            if self.bends is not None:
                h, new = self._shorten(self.bends, t, state, h, new, series, direction)
            if h < 4.0 * math.ulp(t) and h != most:
                status = Status.STUCK
                break
            quality = 1.0
            if self.closing is not None:
                new, quality = self.closing(new)
                if quality < self.suspect:
                    h, new, quality = self._land(state, h, new, quality, series, direction)
            end = bound if h == most else t + h * direction
            if due < len(times) and (times[due] - end) * direction <= 0.0:
                last = due + int(np.searchsorted((times[due:] - end) * direction, 0.0, "right"))
                rows.append(self.states(state, series, times[due:last] - t))
                if times[last - 1] == end:
                    rows[-1][-1] = new
                due = last
            self.last = t, state, series
            t, state = end, new
            ends.append(t)
            states.append(state)
            if t == bound:
                status = Status.REACHED
                break
            if quality < self.suspect:
                status = Status.SINGULAR
                break
            if (due and due == len(times)) or (self.halts is not None and self.halts(t)):
                break
        made = np.array(states).reshape(len(states), len(y))
        row_y = np.concatenate(rows) if rows else np.zeros((0, len(y)))
        return Chunk(np.array(ends), made, times[:due], row_y, status)

    def within(self, times: Array) -> Array:
        """See `Engine`."""
        t, state, series = self.last
        return self.states(state, series, times - t)

    def _shorten(
        self,
        torques: TorqueSeries,
        t: float,
        state: list[float],
        h: float,
        new: list[float],
        series: Any,
        direction: float,
    ) -> tuple[float, list[float]]:
        """The step halved until the torque at its end is that of the series.

        And in its middle, where friction may turn over and back.
        """
        n, (rtol, atol) = self.mechanism.n, self.tolerances
        relative = max(math.sqrt(rtol), KINK)
        miss = atol + rtol * max(map(abs, state[n : 2 * n]))  # of a rate
        miss *= (self.order + 1) * self.lightest
        while h >= 4.0 * math.ulp(t):
            x = h * direction
            if torques.agrees(x, t + x, new, relative, miss / h):
                if not torques.flat:
                    break
                middle = self.states(state, series, np.array([0.5 * x]))[0].tolist()
                if torques.agrees(0.5 * x, t + 0.5 * x, middle, relative, miss / h):
                    break
            h *= 0.5
            new = self.states(state, series, np.array([h * direction]))[0].tolist()
        return h, new

    def _land(
        self,
        state: list[float],
        h: float,
        new: list[float],
        quality: float,
        series: Any,
        direction: float,
    ) -> tuple[float, list[float], float]:
        """The step's end moved along the series, to where a next one starts well."""
        assert self.closing is not None
        best = h, new, quality
        for part in LANDINGS:
            there = self.states(state, series, np.array([part * h * direction]))[0]
            quality = self.closing(there.tolist())[1]
            if quality > best[2]:
                best = part * h, there.tolist(), quality
            if quality >= self.suspect:
                break
        return best

    def states(self, state: list[float], series: Any, x: Array) -> Array:
        """The states (k, N), closed, at times x (k,) after `state`, where the series begins."""
        n = self.mechanism.n
        y = np.array(state)
        coefficients = np.array(series).T  # (order + 2, 2n[+1])
        orders = np.arange(len(coefficients))
        powers = x[:, None] ** orders
        z = coefficients[:, :n] + 1j * coefficients[:, n : 2 * n]
        turn = powers @ z
        slope = (powers[:, :-1] * orders[1:]) @ z[1:]
        relative = relative_matrix(self.mechanism)
        way = np.angle(turn) @ relative.T
        rows = np.empty((len(x), len(y)))
        rows[:, :n] = y[:n] + way
        rows[:, n : 2 * n] = ((turn.conj() * slope).imag / np.abs(turn) ** 2) @ relative.T
        if coefficients.shape[1] > 2 * n:  # the power
            done = (powers * x[:, None] / (orders + 1.0)) @ coefficients[:, 2 * n]
            rows[:, 2 * n] = y[2 * n] + done
        elif len(y) > 2 * n:
            rows[:, 2 * n] = y[2 * n] + way @ np.array(self.torques)
        if self.closing is not None:
            for k, row in enumerate(rows):
                rows[k] = self.closing(row.tolist())[0]
        return rows


class StraightEngine(SteppingEngine):
    """Straight-line floats, generated for one mechanism and one order."""

    def prepare(self) -> None:
        self._expand = _expansion(self.mechanism, self.order, self.constants, self.work)

    def expand(self, t: float, y: list[float], most: float, direction: float) -> Expanded:
        torques = self.torques
        push = torques.begin(t, y, direction) if isinstance(torques, TorqueSeries) else None
        try:
            return self._expand(y, most, direction, *self.tolerances, push)
        except (ArithmeticError, ValueError):  # outside a torque's domain, or beyond the floats
            return 0.0, y, ()


class ArrayEngine(SteppingEngine):
    """numpy over the links: for mechanisms whose straight-line code would be long."""

    def prepare(self) -> None:
        constants = None if self.constants is None else np.array(self.constants)
        self._series = ArraySeries(self.mechanism, self.order, constants)

    def expand(self, t: float, y: list[float], most: float, direction: float) -> Expanded:
        n, p = self.mechanism.n, self.order
        torques = self.torques
        push = torques.begin(t, y, direction) if isinstance(torques, TorqueSeries) else None
        try:
            with np.errstate(all="ignore"):
                z, working = self._series.expand(np.array(y[:n]), np.array(y[n : 2 * n]), push)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):
            return 0.0, y, ()
        if not np.isfinite(z).all():
            return 0.0, y, ()
        h = min(most, step_size(z, *self.tolerances))
        series = [z.real, z.imag]
        if self.work and working is not None:
            rates = np.stack([link_rates(z, k) for k in range(p + 1)], axis=-1)
            relative = relative_matrix(self.mechanism) @ rates
            power = [(working[:, : k + 1] * relative[:, k::-1]).sum() for k in range(p + 1)]
            series.append(np.array([[*power, 0.0]]))
        rows = np.concatenate(series)
        closing, self.closing = self.closing, None
        new = self.states(y, rows, np.array([h * direction]))[0].tolist()
        self.closing = closing
        return h, new, rows


@lru_cache(maxsize=64)
def _expansion(
    mechanism: Mechanism, order: int, torques: tuple[float, ...] | None, work: bool
) -> Expansion:
    return compile_expansion(mechanism, order, torques, work)


@lru_cache(maxsize=64)
def relative_matrix(mechanism: Mechanism) -> Array:
    """J^-1 (n, n): joint rates from absolute ones."""
    inverse = np.eye(mechanism.n)
    for k, above in enumerate(mechanism.parent):
        if above is not None:
            inverse[k, above] = -1.0
    return inverse
