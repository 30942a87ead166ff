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
from collections.abc import Callable, Sequence
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


class Stretches(NamedTuple):
    """Spans of time, in order, on which a function has one sign; 0 if rounding hides it.

    `sure` (k,) is a time at which the sign is certain, `blur` (k,) the uncertainty of `begin` in s.
    With sign 0, the function `stays` at zero, or has no value if it is not `defined`.
    """

    begin: Array
    end: Array
    sign: NDArray[np.int64]
    sure: Array
    blur: Array
    stays: NDArray[np.bool_]
    defined: NDArray[np.bool_]


@dataclass
class Budget:
    """Number of boxes that may still be examined, none shorter than `least` (s).

    `spent` is set if they did not suffice.
    """

    least: float
    left: int = MOST_BOXES
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

    def some(self, which: Any) -> Boxes:
        return Boxes(*(x[which] for x in self))

    def place(self, t: Array) -> Array:
        """Map times (m,) to x in [-1, 1]."""
        x = 2.0 * (t - self.begin) / (self.end - self.begin) - 1.0
        return np.minimum(1.0, np.maximum(-1.0, x))

    def signs(self, t: Array) -> NDArray[np.int64]:
        """Return the sign at one time (m,) in each box; 0 if the error hides it."""
        value = evaluated(self.c, self.place(t))
        return np.where(np.abs(value) <= self.error, 0.0, np.sign(value)).astype(np.int64)

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


def certain(values: Array, off: Array) -> NDArray[np.int64]:
    """Return the sign (...) of functions that cannot change it on their box; 0 if they may.

    `values` (..., DEGREE + 1) are taken at the nodes; each may be wrong by `off` (...).
    """
    size = np.abs(c := values @ TO_COEFFICIENTS)
    total, tail = size.sum(axis=-1), size[..., -3:].sum(axis=-1)
    sure = 2.0 * size[..., 0] > total + off + ROUNDING * total + 2.0 * tail
    return np.where(sure, np.sign(c[..., 0]), 0.0).astype(np.int64)


class _Found:
    """Collects stretches and sorts them by time."""

    def __init__(self) -> None:
        self.blocks: list[Array] = []

    def take(
        self,
        begin: Array,
        end: Array,
        sign: Any,
        sure: Array | None = None,
        blur: Any = 0.0,
        stays: bool = False,
        defined: bool = True,
    ) -> None:
        if len(begin):
            block = np.empty((7, len(begin)))
            block[0], block[1], block[2], block[4], block[5], block[6] = (
                begin, end, sign, blur, stays, defined,
            )  # fmt: skip
            block[3] = begin + 0.5 * (end - begin) if sure is None else sure
            self.blocks.append(block)

    def ordered(self, forward: float) -> Stretches:
        if not self.blocks:
            self.blocks.append(np.zeros((7, 0)))
        columns = np.concatenate(self.blocks, axis=1)
        columns = columns[:, np.argsort(columns[0] * forward, kind="stable")]
        begin, end, sign, sure, blur, stays, defined = columns
        known = stays != 0.0, defined != 0.0
        return Stretches(begin, end, sign.astype(np.int64), sure, blur, *known)


def stretches(
    sampled: Sampled,
    begin: Array,
    end: Array,
    budget: Budget,
    known: NDArray[np.int64] | None = None,
) -> Stretches:
    """Return stretches of equal sign of a function over consecutive boxes.

    Boxes go from begin (m,) to end (m,).  Boxes whose sign is `known` (m,), not 0, are not
    examined.
    """
    found, forward = _Found(), -1.0 if len(end) and end[0] < begin[0] else 1.0
    if known is not None:
        sure = known != 0
        found.take(begin[sure], end[sure], known[sure])
        begin, end = begin[~sure], end[~sure]
    todo = [(begin, end)] if len(begin) else []
    while todo:
        begin, end = todo.pop()
        if len(begin) > AT_ONCE:
            todo.append((begin[AT_ONCE:], end[AT_ONCE:]))
            begin, end = begin[:AT_ONCE], end[:AT_ONCE]
        budget.left -= len(begin)
        again = _look(sampled, begin, end, budget, found)
        if len(again[0]):
            todo.append(again)
    return found.ordered(forward)


@np.errstate(all="ignore")
def _look(
    sampled: Sampled, begin: Array, end: Array, budget: Budget, found: _Found
) -> tuple[Array, Array]:
    """Examine boxes once; return begin and end of the narrower boxes to examine next."""
    values, noises = sampled(node_times(begin, end))
    open_: NDArray[np.bool_] = np.ones(len(begin), bool)

    def tell(those: Any, sign: Any, **how: Any) -> None:
        which: NDArray[np.bool_] = those & open_
        if which.any():
            sign = sign[which] if isinstance(sign, np.ndarray) else sign
            found.take(begin[which], end[which], sign, **how)
            open_[which] = False

    tell(~values.any(axis=1), 0, stays=True)
    finite = np.asarray(np.isfinite(values).all(axis=1))
    if not finite.all():
        tell(np.isnan(values).all(axis=1), 0, stays=True, defined=False)
        endless = np.isinf(values).all(axis=1)
        tell(endless & (np.abs(np.sign(values).sum(axis=1)) == DEGREE + 1), np.sign(values[:, 0]))
    c = np.where(finite[:, None], values, 0.0) @ TO_COEFFICIENTS
    size, noise = np.abs(c), noises.max(axis=1)
    total = size.sum(axis=1)
    error = noise + ROUNDING * total + 2.0 * size[:, -3:].sum(axis=1)
    tell(finite & (2.0 * size[:, 0] > total + error), np.sign(c[:, 0]))
    if not open_.any():
        return begin[:0], end[:0]
    boxes = Boxes(begin, end, c, error, noise + ROUNDING * total)
    steady = size[:, 1] > size[:, 2:] @ SLOPES[2:] + SLOPES[-1] * error
    which = np.asarray(finite & open_ & steady)
    if which.any():
        _monotone(boxes.some(which), begin[which], end[which], found)
        open_[which] = False
    # halves would tell no more of it; states brought onto closures scatter by more than rounding
    scatters = size[:, 9:].max(axis=1) > FLAT * size[:, 1:9].max(axis=1)
    scatters &= np.abs(values).max(axis=1) <= SCATTER * noises.min(axis=1)
    hidden = scatters | (size[:, 1:].sum(axis=1) <= noises.min(axis=1))
    tell(finite & (hidden | (np.abs(values) <= noises).all(axis=1)), 0)
    near = np.where(size[:, 2] > 0.0, 2.0 * np.sqrt(error / size[:, 2]), 1.0)
    bent = 4.0 * size[:, 2] > size[:, 3:] @ BENDS[3:] + BENDS[-1] * error
    narrow: Sequence[Array] = (begin[:0], end[:0])
    which = np.asarray(finite & open_ & bent & (near < 0.5))
    if which.any():
        narrow = _bent(boxes.some(which), near[which], found)
        open_[which] = False
    units = 8.0 * np.spacing(np.maximum(np.abs(begin), np.abs(end)))
    tell(np.abs(end - begin) <= np.maximum(budget.least, units), 0)
    if open_.any() and budget.left <= 0:
        budget.spent = True
        tell(open_, 0)
    begin, end = begin[open_], end[open_]
    middle = begin + 0.5 * (end - begin)
    first, last = [narrow[0], begin, middle], [narrow[1], middle, end]
    return np.concatenate(first), np.concatenate(last)


def _monotone(boxes: Boxes, begin: Array, end: Array, found: _Found) -> None:
    """Find the roots in parts of boxes in which f is monotone."""
    if not len(begin):
        return
    first, last = boxes.signs(begin), boxes.signs(end)
    passes = first * last < 0
    if passes.any():
        some, low, high = boxes.some(passes), begin[passes], end[passes]
        middle = some.roots(low, high)
        found.take(low, middle, first[passes], low)
        found.take(middle, high, last[passes], high, some.blurs(middle))
    # one that is hidden at an end has the sign of the other until there
    kept = ~passes & (first != 0)
    found.take(begin[kept], end[kept], first[kept], begin[kept])
    rest = ~passes & (first == 0)
    if rest.any():
        blurs = boxes.some(rest).blurs(begin[rest])
        found.take(begin[rest], end[rest], last[rest], end[rest], blurs)


def _bent(boxes: Boxes, near: Array, found: _Found) -> tuple[Array, Array]:
    """Find the roots in boxes with at most one extremum, which rounding may hide nearby.

    Returns the narrow boxes around extrema that need a closer look.
    """
    slopes = boxes._replace(c=boxes.c @ DERIVATIVE)
    ends = [evaluated(slopes.c, np.full(len(near), x)) for x in (-1.0, 1.0)]
    turns = ends[0] * ends[1] < 0.0
    if not turns.all():
        plain = boxes.some(~turns)
        _monotone(plain, plain.begin, plain.end, found)
        boxes, slopes, near = boxes.some(turns), slopes.some(turns), near[turns]
    if not len(near):
        return near, near
    top = slopes.roots(boxes.begin, boxes.end)
    seen = boxes.signs(top) != 0
    if seen.any():
        clear = boxes.some(seen)
        _monotone(clear, clear.begin, top[seen], found)
        _monotone(clear, top[seen], clear.end, found)
    hidden, top, near = boxes.some(~seen), top[~seen], near[~seen]
    half = 0.5 * (hidden.end - hidden.begin) * near
    forward = np.sign(half)
    low = np.maximum(hidden.begin * forward, (top - half) * forward) * forward
    high = np.minimum(hidden.end * forward, (top + half) * forward) * forward
    before, after = low != hidden.begin, high != hidden.end
    _monotone(hidden.some(before), hidden.begin[before], low[before], found)
    _monotone(hidden.some(after), high[after], hidden.end[after], found)
    return low, high


@np.errstate(all="ignore")
def brackets(
    f: Function,
    met: Callable[[Array, NDArray[np.int64]], Array],
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
        inside = (points - low[left, None]) * (high[left, None] - points) > 0.0
        values = np.full(points.shape, np.nan)
        if inside.any():
            values[inside] = f(points[inside])
            times = np.concatenate([low[left, None], points, high[left, None]], axis=1)
            sizes = np.concatenate([first[left, None], values, last[left, None]], axis=1)
            there = np.zeros(times.shape, bool)
            there[:, 1:-1] = met(values, left[:, None]) & inside
            there[:, -1] = True
            after = there.argmax(axis=1)
            kept = np.ones(times.shape, bool)
            kept[:, 1:-1] = inside
            # the last of those before it that is inside
            before = np.where(kept & (np.arange(times.shape[1]) < after[:, None]), 1, 0)
            before = times.shape[1] - 1 - before[:, ::-1].argmax(axis=1)
            row = np.arange(len(left))
            low[left], first[left] = times[row, before], sizes[row, before]
            high[left], last[left] = times[row, after], sizes[row, after]
        a, b = low[left], high[left]
        width, known = b - a, ~(np.isnan(first[left]) | np.isnan(last[left]))
        unknown = left[~known]
        if len(unknown):
            ends = f(np.concatenate([low[unknown], high[unknown]])).reshape(2, -1)
            first[unknown], last[unknown] = ends
        unit = np.spacing(np.maximum(np.abs(a), np.abs(b)))
        done = (np.abs(width) <= 4.0 * unit) | (known & ~inside.any(axis=1))
        left, a, width = left[~done], a[~done], width[~done]
        if not len(left):
            break
        fa, fb = first[left], last[left]
        part = np.where(np.isfinite(fa - fb) & (fa != fb), fa / (fa - fb), 0.5)
        guess = a + np.minimum(1.0, np.maximum(0.0, part)) * width
        points = guess[:, None] + width[:, None] * SPREAD
        points = np.concatenate([points, (a + 0.5 * width)[:, None]], axis=1)
        forward = np.sign(width)[:, None]
        points = np.sort(points * forward, axis=1) * forward
    return low, high, np.where(np.abs(first) < np.abs(last), low, high)
