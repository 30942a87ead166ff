"""Extremes and crossings of polynomials over one step each, many steps at a time.

A rate is v(x) = sum_k v_k x^k over 0 <= x/h <= 1 (h may be negative), its angle the integral.
A step is looked at in QUARTERS parts: where v or its derivative changes sign between two of them,
the root is found by Newton's method within its bracket, and the value there counts besides those
at the parts' ends.  What turns twice within one part may be missed.
"""

from __future__ import annotations

import numpy as np

from robodyn.tables.arrays import Array

QUARTERS = 4
NEWTON = 40  # steps at most: a bracket shrinks by each, and the last few double the digits
NEAR = 1e-9  # part of a bracket: a Newton step below it leaves an error of its square


def extremes(rates: Array, h: Array) -> tuple[Array, Array, Array, Array]:
    """Least and largest of the turn (from 0) and of the rate over steps h (B,), each (n, B).

    `rates` (K, n, B), K > 1, are the coefficients v_k.
    """
    begin, before, changes = np.zeros(len(h)), (rates[0], rates[1]), []
    found = [np.zeros_like(rates[0])] * 2 + [rates[0]] * 2
    scaled, orders = rates * powers(h, len(rates))[:, None], np.arange(float(len(rates)))
    for part in range(1, QUARTERS + 1):
        end, u = h * (part / QUARTERS), ((part / QUARTERS) ** orders)[:, None, None]
        turn = end * sums(u / (orders + 1.0)[:, None, None], scaled)
        rate, slope = sums(u, scaled), sums(u * orders[:, None, None], scaled) / end
        for k, value in ((0, turn), (2, rate)):
            found[k : k + 2] = np.minimum(found[k], value), np.maximum(found[k + 1], value)
        for k, (first, last) in enumerate(zip(before, (rate, slope), strict=True)):
            i, b = np.nonzero(first * last < 0.0)
            changes.append((np.full(len(b), k), i, b, begin[b], end[b], first[i, b]))
        begin, before = end, (rate, slope)
    kind, i, b, begin, end, first = (np.concatenate(x) for x in zip(*changes, strict=True))
    series = rates[:, i, b]
    bends = np.concatenate([derivative(series), np.zeros((1, len(b)))])
    x = roots(np.where(kind, bends, series), begin, end, first)
    there = values(series[:, None], x)
    for k in range(2):
        place, value = (i[kind == k], b[kind == k]), there[k][0, kind == k]
        np.minimum.at(found[2 * k], place, value)
        np.maximum.at(found[2 * k + 1], place, value)
    return found[0], found[1], found[2], found[3]


def crossings(angle: Array, rates: Array, h: Array, limit: float) -> Array:
    """Where |angle + turn| first exceeds `limit` within steps h, (B,); nan where it does not.

    `angle` (B,) is that at the steps' begin, `rates` (K, B) the coefficients of its rate.
    """
    # a bound of the turn tells most steps that they cannot reach so far
    most = (np.abs(rates) * powers(np.abs(h), len(rates))).sum(axis=0) * np.abs(h)
    found, left = np.full(len(h), np.nan), ~(np.abs(angle) + most <= limit)
    found[left & (np.abs(angle) > limit)] = 0.0
    begin, before = np.zeros(len(h)), rates[0]
    for part in range(1, QUARTERS + 1):
        (here,) = np.nonzero(left & np.isnan(found))
        if not len(here):
            break
        end, series, from_here = h * (part / QUARTERS), rates[:, here], angle[here]
        turn, rate, _ = (value[0] for value in values(series[:, None], end[here]))
        reach, there = end[here], from_here + turn
        (b,) = np.nonzero(before[here] * rate < 0.0)
        if len(b):  # it may go beyond and come back within the part
            x = roots(series[:, b], begin[here[b]], end[here[b]], before[here[b]])
            furthest = from_here[b] + values(series[:, None, b], x)[0][0]
            over = np.abs(furthest) > limit
            reach[b[over]], there[b[over]] = x[over], furthest[over]
        (b,) = np.nonzero(np.abs(there) > limit)
        if len(b):
            goal, place = np.sign(there[b]) * limit - from_here[b], begin[here[b]]
            ahead = np.concatenate([-goal[None], integral(series[:, b])])
            at_begin = values(series[:, None, b], place)[0][0] - goal
            found[here[b]] = roots(ahead, place, reach[b], at_begin)
        begin, before = end, before.copy()
        before[here] = rate
    return found


def values(rates: Array, x: Array) -> tuple[Array, Array, Array]:
    """The turn, the rate and its derivative at x (B,) of rates (K, n, B), each (n, B)."""
    power, orders = powers(x, len(rates)), np.arange(1.0, len(rates) + 1.0)[:, None]
    turn = sums((power * x / orders)[:, None], rates)
    rate = sums(power[:, None], rates)
    return turn, rate, sums((power[:-1] * orders[:-1])[:, None], rates[1:])


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
    low, high, x = begin, end, 0.5 * (begin + end)
    found = np.zeros(len(x), bool)  # each by itself: what is found does not depend on the others
    with np.errstate(all="ignore"):
        for _ in range(NEWTON):
            value, steep = horner(series, x)
            same = value * np.sign(at_begin) > 0.0
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
    total, slope = series[-1], np.zeros_like(x)
    for coefficient in series[-2::-1]:
        total, slope = total * x + coefficient, slope * x + total
    return total, slope
