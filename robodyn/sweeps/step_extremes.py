"""Extremes and crossings of polynomials over one step each, many steps at a time.

A rate is v(x) = sum_k v_k x^k over 0 <= x/h <= 1 (h may be negative), its angle the integral.
A step is looked at in QUARTERS parts: where v or its derivative changes sign between two of them,
the root is found by Newton's method within its bracket, and the value there counts besides those
at the parts' ends.  What turns twice within one part may be missed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

QUARTERS = 4
NEWTON = 40  # steps at most: a bracket shrinks by each, and the last few double the digits
NEAR = 1e-9  # part of a bracket: a Newton step below it leaves an error of its square


def extremes(rates: Array, h: Array) -> tuple[Array, Array, Array, Array]:
    """Least and largest of the turn (from 0) and of the rate over steps h (B,), each (n, B).

    `rates` (K, n, B), K > 1, are the coefficients v_k.
    """
    edges = h * (np.arange(QUARTERS + 1)[:, None] / QUARTERS)
    turn, rate, slope = np.zeros((3, QUARTERS + 1, *rates.shape[1:]))
    rate[0], slope[0] = rates[0], rates[1]
    scaled = rates * powers(h, len(rates))[:, None]
    orders = np.arange(len(rates), dtype=float)
    for p in range(1, QUARTERS + 1):
        u = (p / QUARTERS) ** orders
        turn[p] = edges[p] * sums((u / (orders + 1.0))[:, None, None], scaled)
        rate[p] = sums(u[:, None, None], scaled)
        slope[p] = sums((u[1:] * orders[1:])[:, None, None], scaled[1:])
        slope[p] /= edges[p]
    turn_low, turn_high = turn.min(axis=0), turn.max(axis=0)
    rate_low, rate_high = rate.min(axis=0), rate.max(axis=0)
    found = []
    for first, series in ((rate, rates), (slope, derivative(rates))):
        part, i, b = np.nonzero(first[:-1] * first[1:] < 0.0)
        gathered = series[:, i, b]
        if len(gathered) < len(rates):  # both kinds in one array: what is missing is zero
            gathered = np.concatenate([gathered, np.zeros((1, len(b)))])
        found.append((i, b, gathered, edges[part, b], edges[part + 1, b], first[part, i, b]))
    turns, bends = found
    if not len(turns[0]) + len(bends[0]):
        return turn_low, turn_high, rate_low, rate_high
    x = roots(*(np.concatenate(pair, axis=-1) for pair in zip(turns[2:], bends[2:], strict=True)))
    for (i, b, *_), x_there, low, high, which in (
        (turns, x[: len(turns[0])], turn_low, turn_high, 0),
        (bends, x[len(turns[0]) :], rate_low, rate_high, 1),
    ):
        there = values(rates[:, None, i, b], x_there)[which][0]
        np.minimum.at(low, (i, b), there)
        np.maximum.at(high, (i, b), there)
    return turn_low, turn_high, rate_low, rate_high


def crossings(angle: Array, rates: Array, h: Array, limit: float) -> Array:
    """Where |angle + turn| first exceeds `limit` within steps h, (B,); nan where it does not.

    `angle` (B,) is that at the steps' begin, `rates` (K, B) the coefficients of its rate.
    """
    # a bound of the turn tells most steps that they cannot reach so far
    most = (np.abs(rates) * powers(np.abs(h), len(rates))).sum(axis=0) * np.abs(h)
    (near,) = np.nonzero(~(np.abs(angle) + most <= limit))
    found = np.full(len(h), np.nan)
    if len(near):
        found[near] = _crossings(angle[near], rates[:, near], h[near], limit)
    return found


def _crossings(angle: Array, rates: Array, h: Array, limit: float) -> Array:
    B = len(h)
    found = np.full(B, np.nan)
    begin, before = np.zeros(B), rates[0]
    found[np.abs(angle) > limit] = 0.0
    for part in range(1, QUARTERS + 1):
        end = h * (part / QUARTERS)
        turn, rate, _ = (value[0] for value in values(rates[:, None], end))
        outside = np.abs(angle + turn) > limit
        reach, side = np.where(outside, end, np.nan), np.sign(angle + turn)
        (b,) = np.nonzero((before * rate < 0.0) & np.isnan(found))
        if len(b):  # it may go beyond and come back within the part
            x = roots(rates[:, b], begin[b], end[b], before[b])
            there = angle[b] + values(rates[:, None, b], x)[0][0]
            over = np.abs(there) > limit
            reach[b[over]], side[b[over]] = x[over], np.sign(there[over])
        (b,) = np.nonzero(~np.isnan(reach) & np.isnan(found))
        if len(b):
            goal = side[b] * limit - angle[b]
            series = np.concatenate([-goal[None], integral(rates[:, b])])
            at_begin = values(rates[:, None, b], begin[b])[0][0] - goal
            found[b] = roots(series, begin[b], reach[b], at_begin)
        begin, before = end, rate
    return found


def values(rates: Array, x: Array) -> tuple[Array, Array, Array]:
    """The turn, the rate and its derivative at x (B,) of rates (K, n, B), each (n, B)."""
    K = len(rates)
    power = powers(x, K)
    orders = np.arange(K, dtype=float)[:, None]
    turn = sums((power * x / (orders + 1.0))[:, None], rates)
    rate = sums(power[:, None], rates)
    slope = sums((power[:-1] * orders[1:])[:, None], rates[1:])
    return turn, rate, slope


def sums(a: Array, b: Array) -> Array:
    """The sums of a b (K, ..., B) over the first axis, the same however many lanes there are."""
    if b.shape[-1] == 1:  # numpy would add them up in another order
        return np.asarray(sums(a, b.repeat(2, axis=-1))[..., :1])
    return np.asarray(np.einsum("k...,k...->...", a, b))


def powers(x: Array, K: int) -> Array:
    """x^k (K, B) of x (B,)."""
    power = np.empty((K, len(x)))
    power[0] = 1.0
    for k in range(1, K):
        np.multiply(power[k - 1], x, out=power[k])
    return power


def derivative(series: Array) -> Array:
    """Coefficients of the derivative, along the first axis."""
    K = len(series)
    return series[1:] * np.arange(1.0, K).reshape(-1, *[1] * (series.ndim - 1))


def integral(series: Array) -> Array:
    """Coefficients of the integral less its constant, along the first axis."""
    K = len(series)
    return series / np.arange(1.0, K + 1.0).reshape(-1, *[1] * (series.ndim - 1))


def roots(series: Array, begin: Array, end: Array, at_begin: Array) -> Array:
    """A root of each polynomial (K, B) between `begin` and `end`, where its sign changes, (B,).

    `at_begin` (B,) are its values there.
    """
    low, high = begin.copy(), end.copy()
    sign = np.sign(at_begin)
    x = 0.5 * (low + high)
    found = np.zeros(len(x), bool)  # each by itself: what is found does not depend on the others
    with np.errstate(all="ignore"):
        for _ in range(NEWTON):
            value, steep = horner(series, x)
            same = value * sign > 0.0
            low, high = np.where(same, x, low), np.where(same, high, x)
            newton = x - value / steep
            inside = (newton - low) * (newton - high) <= 0.0
            new = np.where(inside, newton, 0.5 * (low + high))
            last, x = x, np.where(found, x, new)
            found |= np.abs(x - last) <= NEAR * np.abs(end - begin)
            if found.all():
                break
    return x


def horner(series: Array, x: Array) -> tuple[Array, Array]:
    """The values of polynomials (K, B) at x (B,), and their derivatives."""
    total, slope = series[-1].copy(), np.zeros_like(x)
    for coefficient in series[-2::-1]:
        slope *= x
        slope += total
        total *= x
        total += coefficient
    return total, slope
