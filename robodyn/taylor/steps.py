"""Engines of the Taylor integrator in Python: one expansion and one step at a time."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from contextlib import suppress
from struct import Struct
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robodyn.dynamics.placed import joint_ways
from robodyn.engines.expansion import KINK
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.torque_rows import linear_piece
from robodyn.tables.arrays import Array
from robodyn.taylor import PARTS, STEPS, Chunk, Forms, Status

if TYPE_CHECKING:
    from robodyn.loops.misses import Misses
    from robodyn.loops.projection import FloatClosing
    from robodyn.taylor.step_boxes import Kept

Expanded = tuple[float, list[float], tuple[Sequence[float], ...]]  # h, the end, the series
Pieces = tuple[Sequence[float], Sequence[float]]  # torques and their slopes, of a table
NONE: Pieces = ((), ())


class Steps(NamedTuple):
    """What makes the steps of a mechanism under its torques, tau and their slopes where in a table.

    `expand(t, y, tau, slope, most, direction, rtol, atol)` gives a step of at most `most`, the
    state at its end, and its series: rho (n), theta (n), the power where something `works` that is
    no steady torque, then those of what may bend, and of what is spanned.  Of a step that cannot be
    made there are none.  `watched(t, y, tau, slope)` has the values of what may bend; `arms` make
    torques of these; `gap(t, y, series, x)`, if any, is no less than what these miss at the end y
    of a step x from t; `strays(series, x, small, relative)`, if any, is that of `strays.py`.
    """

    expand: Callable[..., Expanded]
    watched: Callable[..., tuple[float, ...]]
    arms: list[float]
    works: bool
    gap: Callable[..., float] | None = None
    strays: Callable[..., float] | None = None


class _Asked(NamedTuple):
    """Times x after a state, within the step of its series; the state at the last, if known."""

    state: list[float]
    series: Any
    works: bool  # whether a power is among the series
    x: Array
    end: list[float] | None = None


class SteppingEngine:
    """Advances by the steps that `make` has, and lands them where the next series is good."""

    def __init__(
        self,
        mechanism: Mechanism,
        closing: FloatClosing | None,
        order: int,
        rtol: float,
        atol: float,
        actuation: Actuation,
        work: bool,
        misses: Misses | None = None,
    ) -> None:
        self.mechanism, self.closing, self.actuation = mechanism, closing, actuation
        self.suspect, self.misses = 0.0, misses
        self._met: Sequence[object] = ()  # change points, or misses of one, that hold steps
        if closing is not None:
            from robodyn.loops.change_points import suspect_quality
            from robodyn.loops.misses import Misses

            self.suspect, self.misses = suspect_quality(mechanism), misses or Misses(mechanism)
            self._met = self.misses.met
        self.order, self.work = order, work
        self.tolerances = float(rtol), float(atol)  # numpy scalars would be ten times slower
        self._given = self.tolerances  # near a missed change point they are tighter
        self.lightest = min(mechanism.inertias.values())
        self.last: tuple[float, list[float], Any] = (0.0, [], ())  # t, y and series of a step
        self.halts: Callable[[float], bool] | None = None  # asked after each step
        self.keeps, self.most = False, 8 * STEPS  # looks for events or leaps cost as many calls
        self.forms: Forms | None = None  # not looked at
        self._made: dict[tuple[float, ...] | None, Steps] = {}
        self._torques = actuation.function(mechanism.n)
        if actuation.pieces is not None:
            with suppress(ZeroDivisionError):  # of numbers that no switch holds
                self.make(None)  # every branch must have a series
        self._now = self._at(0.0)  # what expanded the motion last

    def make(self, held: tuple[float, ...] | None) -> Steps:
        """What expands the motion while the switches of an expression are held so."""
        raise NotImplementedError

    def _at(self, t: float) -> Steps:
        """What expands the motion from t on."""
        held = None if self.actuation.pieces is None else self.actuation.pieces.at(t)
        if held not in self._made:
            self._made[held] = self.make(held)
        return self._made[held]

    def _table(self, t: float, y: list[float], direction: float) -> Pieces:
        """The torques at t, and their slopes, of a table; else nothing."""
        if self.actuation.constants is not None or not self.actuation.linear:
            return NONE
        return linear_piece(self.actuation, self._torques, t, y, direction)

    def expand(self, t: float, y: list[float], most: float, direction: float) -> Expanded:
        """The series at y, a step h of at most `most`, and the state at its end."""
        (rtol, atol), actuation = self.tolerances, self.actuation
        tau, slope = NONE if actuation.constants is not None else self._table(t, y, direction)
        try:
            if actuation.pieces is not None:
                self._now = self._at(t)
            return self._now.expand(t, y, tau, slope, most, direction, rtol, atol)
        except (ArithmeticError, ValueError):  # outside a torque's domain, or beyond the floats
            return 0.0, y, ()

    def _agrees(
        self, series: Any, x: float, t: float, y: list[float], relative: float, small: float
    ) -> bool:
        """Whether the series, x after where it began, gives the torques at the state y at t.

        It does not where a torque ends or bends on the way (sqrt(1 - t), sqrt(t**2)), or is flat
        where it began (tanh(1e5*t), friction), or where a spring's ends pass one another.  What it
        misses by may be `small`, N m, or that part of its terms.
        """
        arms, first = self._now.arms, 2 * self.mechanism.n + self._now.works
        try:
            values = self._now.watched(t, y, *self._table(t, y, 1.0))
        except (ArithmeticError, ValueError):  # outside the domain
            return False
        return all(
            _agree(each, x, value, relative, small / arm)
            for each, value, arm in zip(series[first:], values, arms, strict=False)
        )

    def advance(self, t: float, y: Array, bound: float, times: Array, steps: int) -> Chunk:
        """See `Engine`."""
        state: list[float] = y.tolist()
        direction = 1.0 if bound > t else -1.0
        ends, states = [t], [state]
        asked: list[_Asked] = []
        kept: list[bytes] = []
        packed, both = Struct(f"{self.order + 2}d").pack, 2 * self.mechanism.n
        whens = (times * direction).tolist() or [math.inf]
        due, status, closing, halts = 0, Status.FULL, self.closing, self.halts
        for _ in range(steps):
            most = left = (bound - t) * direction
            if self._met:
                most = self._held(state, left)
            h, new, series = self.expand(t, state, most, direction)
            if not series:
                status = Status.NOT_FINITE
                break
            if self._now.arms:
                h, new = self._shorten(t, state, h, new, series, direction)
            end = t + h * direction
            if h == left:
                end = bound
            elif h < 4.0 * math.ulp(t):
                status = Status.STUCK
                break
            if closing is not None:
                new, quality = closing(new)
                if quality < self.suspect:
                    h, new, status = self._land(state, h, new, quality, series, direction)
                    end = bound if h == left else t + h * direction
            if whens[due] <= end * direction:
                last = bisect_right(whens, end * direction, due)
                ended = new if times[last - 1] == end else None
                asked.append(_Asked(state, series, self._now.works, times[due:last] - t, ended))
                due = last
            self.last = t, state, series
            if self.keeps:
                for row in series[:both]:  # faster than extending by a starmap
                    kept.append(packed(*row))
            t, state = end, new
            ends.append(t)
            states.append(state)
            if t == bound:
                status = Status.REACHED
            if status is not Status.FULL or due == len(whens) or (halts is not None and halts(t)):
                break
        every, made = np.array(ends), np.array(states)
        along = self._kept(every, made, kept) if kept else None
        return Chunk(every[1:], made[1:], times[:due], self._rows(asked), status, along)

    def _held(self, state: list[float], left: float) -> float:
        """How long a step may be; near a missed change point its tolerances are tighter."""
        assert self.misses is not None
        longest, fine, _ = self.misses.holds(state)
        self.tolerances = min(self._given[0], fine), min(self._given[1], fine)
        return min(left, longest)

    def _kept(self, t: Array, y: Array, kept: list[bytes]) -> Kept:
        """Of steps between these states, by their series."""
        from robodyn.taylor.step_boxes import Kept, boxes_along, terms_of

        h = t[1:] - t[:-1]
        parts = np.frombuffer(b"".join(kept)).reshape(len(h), 2, self.mechanism.n, -1)
        terms = terms_of(parts.transpose(1, 2, 3, 0), h)
        boxes = boxes_along(self.mechanism, y, terms, h)
        return Kept(boxes, lambda places, _: terms[..., places])

    def within(self, times: Array) -> Array:
        """See `Engine`."""
        t, state, series = self.last
        return self.states(state, series, times - t)

    def dense(self, t: float, y: Array, end: float) -> Callable[[Array], Array]:
        """See `Engine`."""
        state = y.tolist()
        series = self.expand(t, state, abs(end - t), 1.0 if end > t else -1.0)[2]
        return lambda times: self.states(state, series, times - t)

    def _shorten(
        self,
        t: float,
        state: list[float],
        h: float,
        new: list[float],
        series: Any,
        direction: float,
    ) -> tuple[float, list[float]]:
        """The step halved until the torque at its end is that of the series.

        And until nothing within it strays from where the series hold.
        """
        n, (rtol, atol) = self.mechanism.n, self.tolerances
        relative = max(math.sqrt(rtol), KINK)
        miss = atol + rtol * max(map(abs, state[n : 2 * n]))  # of a rate
        miss *= (self.order + 1) * self.lightest
        gap, strays, whole = self._now.gap, self._now.strays, h
        while h >= 4.0 * math.ulp(t):
            x, small = h * direction, miss / h
            if strays is None or not strays(series, x, small, relative) > 0.0:
                if h != whole:
                    new = self.states(state, series, np.array([x]))[0].tolist()
                if gap is not None:
                    with suppress(ArithmeticError, ValueError):  # outside a torque's domain
                        if gap(t, new, series, x) <= small:
                            break
                if self._agrees(series, x, t + x, new, relative, small):
                    break
            h *= 0.5
        return h, new

    def _land(
        self,
        state: list[float],
        h: float,
        new: list[float],
        quality: float,
        series: Any,
        direction: float,
    ) -> tuple[float, list[float], Status]:
        """The step's end moved along the series, to where a next one starts well, if that is known.

        SINGULAR where there is none near a change point.
        """
        assert self.closing is not None
        assert self.misses is not None
        if not self.misses.crosses(np.array(new[: self.mechanism.n])):
            return h, new, Status.FULL
        best = h, new, quality
        for part in PARTS[1:]:
            there = self.states(state, series, np.array([part * h * direction]))[0]
            quality = self.closing(there.tolist())[1]
            if quality > best[2]:
                best = part * h, there.tolist(), quality
            if quality >= self.suspect:
                break
        h, new, quality = best
        return h, new, Status.SINGULAR if quality < self.suspect else Status.FULL

    def states(self, state: list[float], series: Any, x: Array) -> Array:
        """The states (k, N), closed, at times x (k,) after `state`, where the series begins."""
        return self._rows([_Asked(state, series, self._now.works, x)])

    def _rows(self, asked: Sequence[_Asked]) -> Array:
        """The same within many steps, one after another."""
        n, counts = self.mechanism.n, [len(some.x) for some in asked]
        if not counts:
            return np.zeros((0, 2 * n + self.work))
        if counts == [1] and asked[0].end is not None:
            return np.array([asked[0].end])
        step = np.repeat(np.arange(len(asked)), counts)
        x = np.concatenate([some.x for some in asked])
        y = np.array([some.state for some in asked])[step]
        parts = np.array([some.series[: 2 * n] for some in asked])
        z = (parts[:, :n] + 1j * parts[:, n:]).swapaxes(1, 2)[step]  # rho + i theta (k, p, n)
        orders = np.arange(z.shape[1])
        powers = x[:, None] ** orders
        turn = (powers[:, None] @ z)[:, 0]
        slope = ((powers[:, :-1] * orders[1:])[:, None] @ z[:, 1:])[:, 0]
        rows = np.empty(y.shape)
        way, rows[:, n : 2 * n] = joint_ways(self.mechanism, y, turn, slope)
        rows[:, :n] = y[:, :n] + way
        if self.work:
            rows[:, 2 * n] = y[:, 2 * n]
            if any(some.works for some in asked):
                none = (0.0,) * (self.order + 1)
                power = np.array([some.series[2 * n] if some.works else none for some in asked])
                power = power[step]
                terms = orders[: power.shape[1]]
                works = powers[:, terms] * x[:, None] / (terms + 1.0) * power
                rows[:, 2 * n] += works.sum(axis=1)
            if self.actuation.constants is not None:
                rows[:, 2 * n] += way @ np.array(self.actuation.constants)
        rows = self.closed(rows)
        for row, some in zip(np.cumsum(counts) - 1, asked, strict=True):
            if some.end is not None:
                rows[row] = some.end
        return rows

    def closed(self, rows: Array) -> Array:
        """See `Engine`."""
        if self.closing is not None:
            for k, row in enumerate(rows):
                rows[k] = self.closing(row.tolist())[0]
        return rows


def _agree(series: Sequence[float], x: float, value: float, relative: float, small: float) -> bool:
    """Whether a series gives a value at x; it may miss by `small`, or that part of its terms."""
    total = 0.0
    for coefficient in reversed(series):
        total = total * x + coefficient
    miss = abs(total - value)
    if miss <= small or not miss < math.inf:
        return miss <= small
    most = max(abs(coefficient * x**k) for k, coefficient in enumerate(series))
    return miss <= relative * most
