"""Where a function of time changes sign within a step, with proof that it does so nowhere else.

On a box of times f is the polynomial of degree 16 through its values at Chebyshev's points, but for
an error that its last coefficients and rounding tell.  With f = sum c_k T_k and |T_k| <= 1,
|T_k'| <= k^2, |T_k''| <= k^2 (k^2 - 1)/3 on the box,

    |c_0| > sum_{k>0} |c_k|                              f has one sign,
    |c_1| > sum_{k>1} k^2 |c_k|                          f is monotone,
    4 |c_2| > sum_{k>2} k^2 (k^2 - 1)/3 |c_k|            f has one extremum at most,

each with the error added.  A box where none of them holds is halved.  So a pair of roots, however
close, costs one box, and a double root is told from two roots as far as rounding permits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.tables.arrays import Array

Function = Callable[[Array], Array]  # of times (k,), (k,)
Sampled = Callable[[Array], tuple[Array, Array]]  # the same, and bounds of its rounding

DEGREE = 16
ROUNDING = 16.0 * float(np.finfo(float).eps)  # of the sum of |c_k|
SPREAD = np.array([0.0, 1e-14, 1e-12, 1e-9, 1e-5])  # of a bracket, about a guess of the root
CLOSE = np.array([-1.0, 0.0, 1.0])  # mostly a guess is right to rounding
MISSED = 4.0  # of what a step misses at its end, where it is brought back onto closures
FLAT = 0.05  # of the first coefficients, the last ones of what no polynomial follows
SCATTER = 1e6  # of rounding: that of states near a change point
MOST_BOXES = 20_000  # of one look at a function along a step

_k = np.arange(DEGREE + 1.0)
NODES: Array = 0.5 - 0.5 * np.cos(math.pi * _k / DEGREE)  # on [0, 1], upwards
SLOPES, BENDS = _k**2, _k**2 * (_k**2 - 1.0) / 3.0  # most of |T_k'| and |T_k''|


def _coefficients() -> Array:
    """What makes the c_k (rows) of the values at the nodes (columns)."""
    values = np.cos(math.pi * np.outer(_k, DEGREE - _k) / DEGREE) * (2.0 / DEGREE)
    values[:, [0, -1]] *= 0.5
    values[[0, -1]] *= 0.5
    return values


FROM_VALUES: Array = _coefficients()
TO_COEFFICIENTS: Array = np.ascontiguousarray(FROM_VALUES.T)


class Stretch(NamedTuple):
    """Times over which a function has one sign: 1 or -1; 0 where rounding hides it.

    `sure` is a time at which it has the sign for certain, `blur` how far its begin may be off, s.
    Where it `stays` it is zero, or not defined.
    """

    begin: float
    end: float
    sign: int
    sure: float
    blur: float = 0.0
    stays: bool = False
    defined: bool = True


class Box(NamedTuple):
    """A function on a box of times: its coefficients, how far they may be off, and rounding's."""

    begin: float
    end: float
    c: list[float]
    error: float
    noise: float


@dataclass
class Budget:
    """How many boxes may still be looked at, none shorter than `least` (s).

    `spent` where they did not suffice.
    """

    least: float
    left: int = MOST_BOXES
    spent: bool = False


def node_times(begin: Array, end: Array) -> Array:
    """The times (m, nodes) of Chebyshev's points of m steps."""
    at: Array = begin[:, None] + (end - begin)[:, None] * NODES
    return at


def certain(values: Array, noise: Array) -> NDArray[np.int64]:
    """The signs of functions (...) that do not change on their box; 0 where they may.

    `values` (..., DEGREE + 1) are those at the nodes, each right but for `noise` (...).
    """
    c = values @ TO_COEFFICIENTS
    size = np.abs(c)
    total, tail = size.sum(axis=-1), size[..., -3:].sum(axis=-1)
    sure = 2.0 * size[..., 0] > total + noise + ROUNDING * total + 2.0 * tail
    return np.where(sure, np.sign(c[..., 0]), 0.0).astype(np.int64)


def stretches(f: Sampled, begin: float, end: float, budget: Budget) -> Iterator[Stretch]:
    """The signs of f from `begin` to `end`, in order."""
    budget.left -= 1
    times = begin + (end - begin) * NODES
    times[-1] = end
    middle = begin + 0.5 * (end - begin)
    values, noises = f(times)
    if not values.any():
        yield Stretch(begin, end, 0, middle, stays=True)
        return
    if np.isfinite(values).all():
        noise = float(noises.max())
        c = FROM_VALUES @ values
        size = np.abs(c)
        total = float(size.sum())
        error = noise + ROUNDING * total + 2.0 * float(size[-3:].sum())
        box = Box(begin, end, c.tolist(), error, noise + ROUNDING * total)
        if 2.0 * size[0] > total + error:
            yield Stretch(begin, end, int(np.sign(c[0])), middle)
            return
        if size[1] > SLOPES[2:] @ size[2:] + SLOPES[-1] * error:
            yield from _monotone(box, begin, end)
            return
        # its halves would tell no more; states brought onto closures scatter by more than rounding
        scatters = size[9:].max() > FLAT * size[1:9].max()
        scatters = scatters and float(np.abs(values).max()) <= SCATTER * float(noises.min())
        steady = scatters or size[1:].sum() <= noises.min()
        if steady or (np.abs(values) <= noises).all():
            yield Stretch(begin, end, 0, middle)
            return
        near = 2.0 * math.sqrt(error / size[2]) if size[2] else 1.0
        if near < 0.5 and 4.0 * size[2] > BENDS[3:] @ size[3:] + BENDS[-1] * error:
            yield from _bent(f, box, budget, near)
            return
    elif np.isnan(values).all():
        yield Stretch(begin, end, 0, middle, stays=True, defined=False)
        return
    elif np.isinf(values).all() and abs(np.sign(values).sum()) == len(values):
        yield Stretch(begin, end, int(np.sign(values[0])), middle)
        return
    if abs(end - begin) <= max(budget.least, 8.0 * math.ulp(max(abs(begin), abs(end)))):
        yield Stretch(begin, end, 0, middle)
    elif budget.left <= 0:
        budget.spent = True
        yield Stretch(begin, end, 0, middle)
    else:
        yield from stretches(f, begin, middle, budget)
        yield from stretches(f, middle, end, budget)


def _value(c: list[float], x: float) -> float:
    """At x in [-1, 1], by Clenshaw's recurrence."""
    last = before = 0.0
    for each in c[:0:-1]:
        last, before = each + 2.0 * x * last - before, last
    return c[0] + x * last - before


def _at(box: Box, t: float) -> float:
    return min(1.0, max(-1.0, 2.0 * (t - box.begin) / (box.end - box.begin) - 1.0))


def _slope(c: list[float]) -> list[float]:
    """The coefficients of the derivative by x in [-1, 1]."""
    found = [0.0] * (len(c) + 1)
    for k in range(len(c) - 1, 0, -1):
        found[k - 1] = found[k + 1] + 2.0 * k * c[k]
    found[0] *= 0.5
    return found[:-2]


def _sign(box: Box, t: float) -> int:
    value = _value(box.c, _at(box, t))
    return 0 if abs(value) <= box.error else int(math.copysign(1.0, value))


def _blur(box: Box, t: float) -> float:
    """How far the time of a root may be off by rounding: twice what its slope there tells."""
    slope = abs(_value(_slope(box.c), _at(box, t)))
    length = 0.5 * abs(box.end - box.begin)
    return min(2.0 * box.noise / slope, 1.0) * length if slope > 0.0 else length


def _monotone(box: Box, begin: float, end: float) -> Iterator[Stretch]:
    """Of a part of a box in which f is monotone."""
    first, last = _sign(box, begin), _sign(box, end)
    if first and last and first != last:
        middle = _root(box.c, box, begin, end)
        yield Stretch(begin, middle, first, begin)
        yield Stretch(middle, end, last, end, _blur(box, middle))
    elif first:  # one that is hidden at an end has the sign of the other until there
        yield Stretch(begin, end, first, begin)
    else:
        yield Stretch(begin, end, last, end, _blur(box, begin))


def _bent(f: Sampled, box: Box, budget: Budget, near: float) -> Iterator[Stretch]:
    """Of a box in which f bends one way alone; rounding may hide it `near` its extremum."""
    slope = _slope(box.c)
    if _value(slope, -1.0) * _value(slope, 1.0) >= 0.0:
        yield from _monotone(box, box.begin, box.end)
        return
    top = _root(slope, box, box.begin, box.end)
    if _sign(box, top):
        yield from _monotone(box, box.begin, top)
        yield from _monotone(box, top, box.end)
        return
    # rounding along the box hides it: a narrow one sees more
    half = 0.5 * (box.end - box.begin) * near
    forward = 1.0 if half > 0.0 else -1.0
    low = max(box.begin * forward, (top - half) * forward) * forward
    high = min(box.end * forward, (top + half) * forward) * forward
    if low != box.begin:
        yield from _monotone(box, box.begin, low)
    yield from stretches(f, low, high, budget)
    if high != box.end:
        yield from _monotone(box, high, box.end)


def _root(c: list[float], box: Box, begin: float, end: float) -> float:
    """Of a polynomial that changes sign once between two times: Newton's, kept in the bracket."""
    low, high = _at(box, begin), _at(box, end)
    rising = _value(c, high) > 0.0
    slope = _slope(c)
    x, moved = 0.5 * (low + high), high - low
    for _ in range(80):
        value, rate = _value(c, x), _value(slope, x)
        if value == 0.0:
            break
        if (value > 0.0) == rising:
            high = x
        else:
            low = x
        before, last = x, moved
        x = before - value / rate if rate else low
        if abs(x - before) < 2e-16:
            break
        if not low <= x <= high or abs(x - before) > 0.5 * abs(last):
            x = 0.5 * (low + high)
        moved = x - before
    return box.begin + 0.5 * (box.end - box.begin) * (1.0 + x)


def bracket(
    f: Function, met: Callable[[Array], Any], low: float, high: float, guess: float
) -> tuple[float, float, float]:
    """Neighbours, to rounding, between which f comes to meet a condition: `met` of its values.

    It is not met at `low` and is at `high`, and comes to be once between.  The third is that of the
    two where f is nearer to zero.
    """
    first = last = math.nan  # values at the ends, where they are known
    points = guess + math.copysign(2.0 * _unit(low, high), high - low) * CLOSE
    for _ in range(80):
        t = points[(points - low) * (high - points) > 0.0]
        if len(t):
            values = f(t)
            there = np.append(met(values), True)
            after = int(np.argmax(there))
            ends, sizes = [low, *t.tolist(), high], [first, *values.tolist(), last]
            low, high, first, last = *ends[after : after + 2], *sizes[after : after + 2]
        width, known = high - low, not (math.isnan(first) or math.isnan(last))
        if not known:
            first, last = f(np.array([low, high])).tolist()
        if abs(width) <= 4.0 * _unit(low, high) or (known and not len(t)):
            break
        part = first / (first - last) if math.isfinite(first - last) and first != last else 0.5
        guess = low + min(1.0, max(0.0, part)) * width
        points = np.concatenate([guess - width * SPREAD, guess + width * SPREAD])
        points = np.sort(np.append(points, low + 0.5 * width))
        points = points if width > 0.0 else points[::-1]
    return low, high, low if abs(first) < abs(last) else high


def _unit(low: float, high: float) -> float:
    return math.ulp(max(abs(low), abs(high)))
