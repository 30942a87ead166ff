"""Finds all sign changes of a function of time along a run, with proof that none is missed.

On a box of times, f is the polynomial of degree 16 through its values at Chebyshev points, with an
error bounded by its last coefficients and by rounding.  With f = sum c_k T_k and |T_k| <= 1, |T_k'|
<= k^2, |T_k''| <= k^2 (k^2 - 1)/3 on the box,

    |c_0| > sum_{k>0} |c_k|                              f has one sign,
    |c_1| > sum_{k>1} k^2 |c_k|                          f is monotone,
    4 |c_2| > sum_{k>2} k^2 (k^2 - 1)/3 |c_k|            f has one extremum at most,

each with the error added.  If none of these holds, the box is halved.  So a pair of roots costs one
box, however close they are, and a double root is told from two roots as far as rounding permits.
All boxes of a function are examined together, round by round.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.tables.arrays import Array

Function = Callable[[Array], Array]  # of times (k,), (k,)
Sampled = Callable[[Array], tuple[Array, Array]]  # of times (k, nodes); the same, and its rounding

DEGREE = 16
ROUNDING = 16.0 * float(np.finfo(float).eps)  # of the sum of |c_k|
SPREAD = np.array([0.0, 1e-14, 1e-12, 1e-9, 1e-5])  # of a bracket, about a guess of the root
SPREAD = np.concatenate([-SPREAD[:0:-1], SPREAD])
CLOSE = np.array([-1.0, 0.0, 1.0])  # mostly a guess is right to rounding
FLAT = 0.05  # of the first coefficients, the last ones of what no polynomial follows
SCATTER = 1e6  # of rounding: that of states near a change point
MOST_BOXES, MORE_BOXES = 20_000, 500  # of one look at a function, and for each step of it
AT_ONCE = 1024  # boxes whose values are computed together
NEWTON = 80  # rounds at most; mostly some 4 will do
CONVERGED = 1e-15  # of half a box: no places nearer are told apart

_k = np.arange(DEGREE + 1.0)
NODES: Array = 0.5 - 0.5 * np.cos(math.pi * _k / DEGREE)  # on [0, 1], upwards
SLOPES, BENDS = _k**2, _k**2 * (_k**2 - 1.0) / 3.0  # most of |T_k'| and |T_k''|


def _coefficients() -> Array:
    """Return the matrix that takes values at the nodes (rows) to coefficients c_k (columns)."""
    values = np.cos(math.pi * np.outer(_k, DEGREE - _k) / DEGREE) * (2.0 / DEGREE)
    values[:, [0, -1]] *= 0.5
    values[[0, -1]] *= 0.5
    return np.ascontiguousarray(values.T)


def _derivative() -> Array:
    """Return the matrix that takes c_k (rows) to coefficients of df/dx (columns), x in [-1, 1]."""
    slopes = 2.0 * _k[:, None] * ((_k[:, None] > _k) & ((_k[:, None] - _k) % 2.0 == 1.0))
    slopes[:, 0] *= 0.5
    return np.asarray(slopes)


TO_COEFFICIENTS: Array = _coefficients()
DERIVATIVE: Array = _derivative()


HIDDEN, ZERO, UNDEFINED = 0, 2, 3  # kinds of stretches beside the signs -1 and 1


class Stretches(NamedTuple):
    """Spans of time, in order, on which a function is of one kind (k,).

    The kind is its sign, HIDDEN if rounding hides that, ZERO if the function stays at zero, or
    UNDEFINED.  `sure` (k,) is a time at which the sign is certain, `blur` (k,) the uncertainty of
    `begin` in s.
    """

    begin: Array
    end: Array
    kind: Array
    sure: Array
    blur: Array

    @property
    def sign(self) -> Array:
        """The sign (k,), 0 if it is none."""
        return np.where(np.abs(self.kind) == 1.0, self.kind, 0.0)


@dataclass
class Budget:
    """Number of boxes that may still be examined, none shorter than `least` (s).

    `spent` is set if they did not suffice.
    """

    least: float
    left: int
    spent: bool = False


def node_times(begin: Array, end: Array) -> Array:
    """Return the times (m, nodes) of Chebyshev points in m boxes; the last is the box's end."""
    at: Array = begin[:, None] + (end - begin)[:, None] * NODES
    at[:, -1] = end
    return at


class Boxes(NamedTuple):
    """Boxes of times on which a function is a polynomial with coefficients c (m, DEGREE + 1).

    `error` (m,) bounds its deviation, `noise` (m,) the part of it that comes from rounding.
    """

    begin: Array
    end: Array
    c: Array
    error: Array
    noise: Array

    @classmethod
    def through(cls, begin: Array, end: Array, values: Array, off: Array) -> Boxes:
        """Return boxes from begin to end (m,) with values (m, nodes), which err by `off` (m,)."""
        size = np.abs(c := values @ TO_COEFFICIENTS)
        noise = off + ROUNDING * size.sum(axis=1)
        return cls(begin, end, c, noise + 2.0 * size[:, -3:].sum(axis=1), noise)

    def some(self, which: Any) -> Boxes:
        return Boxes(*(x[which] for x in self))

    def certain(self) -> Array:
        """Return the sign (m,) of functions that cannot change it; 0 if they may."""
        size = np.abs(self.c)
        sure = 2.0 * size[:, 0] > size.sum(axis=1) + self.error
        return np.where(sure, np.sign(self.c[:, 0]), 0.0)

    def place(self, t: Array) -> Array:
        """Map times (m,) to x in [-1, 1]."""
        x = 2.0 * (t - self.begin) / (self.end - self.begin) - 1.0
        return np.minimum(1.0, np.maximum(-1.0, x))

    def signs(self, t: Array) -> Array:
        """Return the sign at one time (m,) in each box; 0 if the error hides it."""
        value = evaluated(self.c, self.place(t))
        return np.where(np.abs(value) <= self.error, 0.0, np.sign(value))

    def blurs(self, t: Array) -> Array:
        """Return how far rounding may move roots at t (m,): twice the noise over the slope, s."""
        slope = np.abs(evaluated(self.c @ DERIVATIVE, self.place(t)))
        length = 0.5 * np.abs(self.end - self.begin)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(slope > 0.0, np.minimum(2.0 * self.noise / slope, 1.0), 1.0) * length

    def roots(self, begin: Array, end: Array) -> Array:
        """Return the root (m,) in each box, where f changes sign once between begin and end.

        Newton's method, kept within a bracket.
        """
        low, high = self.place(begin), self.place(end)
        both = np.stack([self.c, self.c @ DERIVATIVE])
        first, last = evaluated(self.c, low), evaluated(self.c, high)
        rising, part = last > 0.0, first / (first - last)
        x, moved = low + np.where(np.isfinite(part), part, 0.5) * (high - low), high - low
        for _ in range(NEWTON):
            value, rate = evaluated(both, x)
            above = (value > 0.0) == rising
            low, high = np.where(above, low, x), np.where(above, x, high)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = np.where(value == 0.0, 0.0, value / rate)
            after = x - step
            outside = ~((after >= low) & (after <= high)) | (np.abs(step) > 0.5 * np.abs(moved))
            done = np.abs(step) < CONVERGED
            after = np.where(outside & ~done, 0.5 * (low + high), after)
            moved, x = after - x, np.where(done, x, after)
            if done.all():
                break
        return np.asarray(self.begin + 0.5 * (self.end - self.begin) * (1.0 + x))


def evaluated(c: Array, x: Array) -> Array:
    """Evaluate Chebyshev series with coefficients c (..., m, k) at x (m,) in [-1, 1]."""
    return np.asarray((c * np.cos(np.arccos(x)[:, None] * _k)).sum(axis=-1))


class SignSearch:
    """Search for the stretches of equal sign of a function over boxes of times.

    `sampled(times)` takes times (m, nodes) and returns values of the function and bounds of their
    rounding, each (m, nodes).
    """

    def __init__(self, sampled: Sampled, budget: Budget) -> None:
        self.sampled, self.budget = sampled, budget
        self._blocks = [np.empty((5, 0))]

    def take(
        self, begin: Array, end: Array, kind: Any, sure: Array | None = None, blur: Any = 0.0
    ) -> None:
        """Add stretches (k,); without `sure` their sign is certain in the middle."""
        block = np.empty((5, len(begin)))
        middle = begin + 0.5 * (end - begin) if sure is None else sure
        block[0], block[1], block[2], block[3], block[4] = begin, end, kind, middle, blur
        self._blocks.append(block)

    def stretches(self, begin: Array, end: Array) -> Stretches:
        """Return the stretches of boxes from begin (m,) to end (m,), and all taken before."""
        todo = [(begin, end)] if len(begin) else []
        while todo:
            begin, end = todo.pop()
            if len(begin) > AT_ONCE:
                todo.append((begin[AT_ONCE:], end[AT_ONCE:]))
                begin, end = begin[:AT_ONCE], end[:AT_ONCE]
            self.budget.left -= len(begin)
            again = self._look(begin, end)
            if len(again[0]):
                todo.append(again)
        columns = np.concatenate(self._blocks, axis=1)
        backwards = bool((columns[1] < columns[0]).any())
        order = np.argsort(-columns[0] if backwards else columns[0], kind="stable")
        return Stretches(*columns[:, order])

    @np.errstate(all="ignore")
    def _look(self, begin: Array, end: Array) -> tuple[Array, Array]:
        """Examine boxes once; return begin and end of the narrower boxes to examine next."""
        values, noises = self.sampled(node_times(begin, end))
        open_: NDArray[np.bool_] = np.ones(len(begin), bool)

        def tell(which: Any, kind: Any) -> None:
            which = which & open_
            if which.any():
                self.take(begin[which], end[which], np.broadcast_to(kind, which.shape)[which])
                open_[which] = False

        tell(~values.any(axis=1), ZERO)
        finite = np.asarray(np.isfinite(values).all(axis=1))
        if not finite.all():
            tell(np.isnan(values).all(axis=1), UNDEFINED)
            tell(np.isinf(noises).all(axis=1), HIDDEN)
            endless = np.where(np.isinf(values), np.sign(values), 0.0).sum(axis=1)
            tell(np.abs(endless) == DEGREE + 1, np.sign(endless))
            values = np.where(finite[:, None], values, 0.0)
        boxes = Boxes.through(begin, end, values, noises.max(axis=1))
        sure = boxes.certain()
        tell(sure != 0.0, sure)
        if not open_.any():
            return begin[:0], end[:0]
        size, error = np.abs(boxes.c), boxes.error
        steady = size[:, 1] > size[:, 2:] @ SLOPES[2:] + SLOPES[-1] * error
        if (which := finite & open_ & steady).any():
            self._monotone(boxes.some(which), begin[which], end[which])
            open_[which] = False
        # halves would tell no more; states brought onto closures scatter by more than rounding
        scatters = size[:, 9:].max(axis=1) > FLAT * size[:, 1:9].max(axis=1)
        scatters &= np.abs(values).max(axis=1) <= SCATTER * noises.min(axis=1)
        hidden = scatters | (size[:, 1:].sum(axis=1) <= noises.min(axis=1))
        tell(finite & (hidden | (np.abs(values) <= noises).all(axis=1)), HIDDEN)
        near = np.where(size[:, 2] > 0.0, 2.0 * np.sqrt(error / size[:, 2]), 1.0)
        bent = 4.0 * size[:, 2] > size[:, 3:] @ BENDS[3:] + BENDS[-1] * error
        narrow = begin[:0], end[:0]
        if (which := finite & open_ & bent & (near < 0.5)).any():
            narrow = self._bent(boxes.some(which), near[which])
            open_[which] = False
        units = 8.0 * np.spacing(np.maximum(np.abs(begin), np.abs(end)))
        tell(np.abs(end - begin) <= np.maximum(self.budget.least, units), HIDDEN)
        if open_.any() and self.budget.left <= 0:
            self.budget.spent = True
            tell(open_, HIDDEN)
        begin, end = begin[open_], end[open_]
        middle = begin + 0.5 * (end - begin)
        first, last = (narrow[0], begin, middle), (narrow[1], middle, end)
        return np.concatenate(first), np.concatenate(last)

    def _monotone(self, boxes: Boxes, begin: Array, end: Array) -> None:
        """Find the roots in parts of boxes in which f is monotone."""
        first, last = boxes.signs(begin), boxes.signs(end)
        passes = first * last < 0.0
        if passes.any():
            some, low, high = boxes.some(passes), begin[passes], end[passes]
            middle = some.roots(low, high)
            self.take(low, middle, first[passes], low)
            self.take(middle, high, last[passes], high, some.blurs(middle))
        # one that is hidden at an end has the sign of the other until there
        kept = ~passes & (first != 0.0)
        self.take(begin[kept], end[kept], first[kept], begin[kept])
        rest = ~passes & (first == 0.0)
        if rest.any():
            blurs = boxes.some(rest).blurs(begin[rest])
            self.take(begin[rest], end[rest], last[rest], end[rest], blurs)

    def _bent(self, boxes: Boxes, near: Array) -> tuple[Array, Array]:
        """Find the roots in boxes with at most one extremum, which rounding may hide nearby.

        Returns the narrow boxes around extrema that need a closer look.
        """
        slopes = boxes._replace(c=boxes.c @ DERIVATIVE)
        ends = [evaluated(slopes.c, np.full(len(near), x)) for x in (-1.0, 1.0)]
        turns = ends[0] * ends[1] < 0.0
        plain = boxes.some(~turns)
        self._monotone(plain, plain.begin, plain.end)
        boxes, slopes, near = boxes.some(turns), slopes.some(turns), near[turns]
        top = slopes.roots(boxes.begin, boxes.end)
        seen = boxes.signs(top) != 0.0
        clear = boxes.some(seen)
        self._monotone(clear, clear.begin, top[seen])
        self._monotone(clear, top[seen], clear.end)
        hidden, top, near = boxes.some(~seen), top[~seen], near[~seen]
        half = 0.5 * (hidden.end - hidden.begin) * near
        forward = np.sign(half)
        low = np.maximum(hidden.begin * forward, (top - half) * forward) * forward
        high = np.minimum(hidden.end * forward, (top + half) * forward) * forward
        before, after = low != hidden.begin, high != hidden.end
        self._monotone(hidden.some(before), hidden.begin[before], low[before])
        self._monotone(hidden.some(after), high[after], hidden.end[after])
        return low, high


@np.errstate(all="ignore")
def brackets(
    f: Function,
    met: Callable[[Array, NDArray[np.int64]], NDArray[np.bool_]],
    low: Array,
    high: Array,
    guess: Array,
) -> tuple[Array, Array, Array]:
    """Return neighbouring floats low, high (k,) between which f comes to meet a condition.

    `met(values, k)` tells whether values of function number k meet it.  The condition fails at
    `low`, holds at `high`, and changes once between.  The third result is the end at which |f| is
    smaller.
    """
    low, high = low.copy(), high.copy()
    first, last = np.full(len(low), np.nan), np.full(len(low), np.nan)  # where they are known
    left = np.arange(len(low))
    unit = np.spacing(np.maximum(np.abs(low), np.abs(high)))
    points = guess[:, None] + (2.0 * unit * np.sign(high - low))[:, None] * CLOSE
    for _ in range(NEWTON):
        a, b = low[left, None], high[left, None]
        points = np.minimum(np.maximum(points, np.minimum(a, b)), np.maximum(a, b))
        points = np.concatenate([a, points, b], axis=1)
        values = np.where(points == a, first[left, None], last[left, None])
        inside = (points != a) & (points != b)
        if inside.any():
            values[inside] = f(points[inside])
        there = (points == b) | (met(values, left[:, None]) & (points != a))
        row, after = np.arange(len(left)), there.argmax(axis=1)
        low[left], first[left] = points[row, after - 1], values[row, after - 1]
        high[left], last[left] = points[row, after], values[row, after]
        unknown = left[np.isnan(first[left]) | np.isnan(last[left])]
        if len(unknown):
            ends = f(np.concatenate([low[unknown], high[unknown]]))
            first[unknown], last[unknown] = ends.reshape(2, -1)
        far = np.maximum(np.abs(low[left]), np.abs(high[left]))
        left = left[np.abs(high[left] - low[left]) > 4.0 * np.spacing(far)]
        if not len(left):
            break
        a, width, fa, fb = low[left], high[left] - low[left], first[left], last[left]
        part = np.where(np.isfinite(fa - fb) & (fa != fb), fa / (fa - fb), 0.5)
        guess = a + np.minimum(1.0, np.maximum(0.0, part)) * width
        points = guess[:, None] + width[:, None] * SPREAD
        points = np.concatenate([points, (a + 0.5 * width)[:, None]], axis=1)
        forward = np.sign(width)[:, None]
        points = np.sort(points * forward, axis=1) * forward
    return low, high, np.where(np.abs(first) < np.abs(last), low, high)
