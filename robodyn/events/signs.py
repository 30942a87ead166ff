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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Function = Callable[[Array], Array]  # of times (k,), (k,)
Sized = Callable[[Array], tuple[Array, Array]]  # the same, and what its rounding is a part of

DEGREE = 16
ROUNDING = 16.0 * float(np.finfo(float).eps)  # of the sum of |c_k|
FLAT = 1e3  # times its rounding: a function that changes by less is looked at no closer
DEEPEST = 60  # halvings
SPREAD = np.append(0.0, 10.0 ** -np.arange(1.0, 15.0))  # of a bracket, about a guess of the root

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


class Stretch(NamedTuple):
    """Times over which a function has one sign: 1 or -1; 0 where rounding hides it."""

    begin: float
    end: float
    sign: int


class Box(NamedTuple):
    """A function on a box of times: its coefficients, and how far they may be off."""

    begin: float
    end: float
    c: Array
    error: float


def errors(c: Array, noise: Any) -> Array:
    """How far functions (...) of coefficients c (..., DEGREE + 1) may be off."""
    size = np.abs(c)
    return np.asarray(noise + ROUNDING * size.sum(axis=-1) + 2.0 * size[..., -3:].sum(axis=-1))


def certain(values: Array, noise: Array) -> NDArray[np.int64]:
    """The signs of functions (...) that do not change on their box; 0 where they may.

    `values` (..., DEGREE + 1) are those at the nodes, each right but for `noise` (...).
    """
    c = values @ FROM_VALUES.T
    size = np.abs(c)
    sure = size[..., 0] > size[..., 1:].sum(axis=-1) + errors(c, noise)
    return np.where(sure, np.sign(c[..., 0]), 0.0).astype(np.int64)


def stretches(f: Sized, begin: float, end: float, depth: int = 0) -> Iterator[Stretch]:
    """The signs of f from `begin` to `end`, in order."""
    values, sizes = f(begin + (end - begin) * NODES)
    noise = ROUNDING * float(sizes.max())
    c = FROM_VALUES @ np.where(np.isfinite(values), values, 0.0)
    box = Box(begin, end, c, float(errors(c, noise)))
    size = np.abs(c)
    if not np.isfinite(values).all():
        box = box._replace(error=math.inf)
    if size[0] > size[1:].sum() + box.error:
        yield Stretch(begin, end, int(np.sign(c[0])))
    elif size[1] > (SLOPES * size)[2:].sum() + SLOPES[-1] * box.error:
        yield from _monotone(box, begin, end)
    elif 4.0 * size[2] > (BENDS * size)[3:].sum() + BENDS[-1] * box.error and (
        (found := _bent(box)) or size.sum() < FLAT * noise or depth == DEEPEST
    ):
        yield from found or _grazing(box)
    elif (
        depth == DEEPEST
        or abs(end - begin) <= 8.0 * math.ulp(max(abs(begin), abs(end)))
        or size.sum() <= noise  # no sign is left to find
    ):
        yield Stretch(begin, end, 0)
    else:
        middle = begin + 0.5 * (end - begin)
        yield from stretches(f, begin, middle, depth + 1)
        yield from stretches(f, middle, end, depth + 1)


def _value(box: Box, t: float) -> float:
    """By Clenshaw's recurrence."""
    x = min(1.0, max(-1.0, 2.0 * (t - box.begin) / (box.end - box.begin) - 1.0))
    last = before = 0.0
    for c in box.c[:0:-1]:
        last, before = c + 2.0 * x * last - before, last
    return float(box.c[0] + x * last - before)


def _slope(c: Array) -> Array:
    """The coefficients of the derivative, but for the length of the box."""
    found = np.zeros(len(c) + 1)
    for k in range(len(c) - 1, 0, -1):
        found[k - 1] = found[k + 1] + 2.0 * k * c[k]
    found[0] *= 0.5
    return found[:-2]


def _sign(box: Box, t: float) -> int:
    value = _value(box, t)
    return 0 if abs(value) <= box.error else int(math.copysign(1.0, value))


def _monotone(box: Box, begin: float, end: float) -> Iterator[Stretch]:
    """Of a part of a box in which f is monotone."""
    first, last = _sign(box, begin), _sign(box, end)
    if first and last and first != last:
        middle = _root(box, begin, end)
        yield Stretch(begin, middle, first)
        yield Stretch(middle, end, last)
    else:  # one that is hidden at an end has the sign of the other until there
        yield Stretch(begin, end, first or last)


def _top(box: Box) -> float | None:
    """Where f, which bends one way alone, has its extremum."""
    slope = Box(box.begin, box.end, _slope(box.c), 0.0)
    if _value(slope, box.begin) * _value(slope, box.end) >= 0.0:
        return None
    return _root(slope, box.begin, box.end)


def _bent(box: Box) -> list[Stretch]:
    """Of a box in which f bends one way alone; nothing where its extremum hides its sign."""
    top = _top(box)
    if top is None:
        return list(_monotone(box, box.begin, box.end))
    if not _sign(box, top):
        return []
    return [*_monotone(box, box.begin, top), *_monotone(box, top, box.end)]


def _grazing(box: Box) -> list[Stretch]:
    """Of a box in which rounding hides whether f passes zero at its extremum."""
    top = _top(box)
    assert top is not None
    first, last = Stretch(box.begin, top, _sign(box, box.begin)), _sign(box, box.end)
    return [first, Stretch(top, top, 0), Stretch(top, box.end, last)]


def _root(box: Box, low: float, high: float) -> float:
    """Of a polynomial that changes sign once between two times."""
    first = _value(box, low)
    for _ in range(100):
        middle = low + 0.5 * (high - low)
        if middle in (low, high):
            break
        if _value(box, middle) * first > 0.0:
            low = middle
        else:
            high = middle
    return low


def root(f: Function, low: float, high: float, guess: float) -> float:
    """The time at which f, of other signs at `low` and `high`, passes zero, to rounding."""
    ends = f(np.array([low, high]))
    first, last = (float(x) for x in ends)
    for _ in range(30):
        width = high - low
        if first == 0.0 or last == 0.0 or abs(width) <= 4.0 * math.ulp(max(abs(low), abs(high))):
            break
        near = np.concatenate([guess - width * SPREAD, guess + width * SPREAD, [low + 0.5 * width]])
        inside = (near - low) * (high - near) > 0.0
        t = np.unique(near[inside])
        if not len(t):
            break
        t = t if width > 0.0 else t[::-1]
        t = np.concatenate([[low], t, [high]])
        values: Any = np.concatenate([[first], f(t[1:-1]), [last]])
        values = np.where(np.isnan(values), first, values)
        after = int(np.argmax(values * first <= 0.0))  # the first of the other sign
        low, high = float(t[after - 1]), float(t[after])
        first, last = float(values[after - 1]), float(values[after])
        part = first / (first - last) if math.isfinite(first - last) else 0.5
        guess = low + part * (high - low)
    return low if abs(first) < abs(last) else high
