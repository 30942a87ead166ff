"""Extremes and crossings of polynomials over one step each, many steps at a time.

A rate is v(x) = sum_k v_k x^k over 0 <= x/h <= 1 (h may be negative), its angle the integral.
A step is looked at in QUARTERS parts: where v or its derivative changes sign between two of them,
the root is found by Newton's method within its bracket, and the value there counts besides those
at the parts' ends.  What turns twice within one part may be missed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn.tables.arrays import Array

QUARTERS = 4
NEWTON = 40  # steps at most: a bracket shrinks by each, and the last few double the digits
NEAR = 1e-9  # part of a bracket: a Newton step below it leaves an error of its square
FLAT = 1e-5  # the same where the value is wanted: an extreme's has the square of the place's error


def extremes(rates: Array, h: Array) -> tuple[Array, Array, Array, Array]:
    """Least and largest of the turn (from 0) and of the rate over steps h (B,), each (n, B).

    `rates` (K, n, B), K > 1, are the coefficients v_k.
    """
    begin, before = np.zeros(len(h)), (rates[0], rates[1])
    changes: list[list[Any]] = [[], []]  # of turns, of rates
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
            changes[k].append((i, b, begin[b], end[b]))
        begin, before = end, (rate, slope)
    for k, parts in enumerate(changes):
        i, b, begin, end = (np.concatenate(x) for x in zip(*parts, strict=True))
        value = turning_values(rates[:, i, b], begin, end, of_rate=k == 1)
        np.minimum.at(found[2 * k], (i, b), value)
        np.maximum.at(found[2 * k + 1], (i, b), value)
    return found[0], found[1], found[2], found[3]


def turning_values(rates: Array, begin: Array, end: Array, of_rate: bool) -> Array:
    """The turn or the rate where it has an extreme between `begin` and `end`, each (B,).

    `rates` (K, B); the derivative of what is meant has another sign at `end` than at `begin`.
    """
    if of_rate:
        return horner(rates, roots(derivative(rates), begin, end, FLAT))
    x = roots(rates, begin, end, FLAT)
    return x * horner(integral(rates), x)


def crossings(angle: Array, rates: Array, h: Array, limit: float) -> Array:
    """Where |angle + turn| first exceeds `limit` within steps h, (B,); nan where it does not.

    `angle` (B,) is that at the steps' begin, `rates` (K, B) the coefficients of its rate.
    """
    x = h * (np.arange(QUARTERS + 1.0) / QUARTERS)[:, None]
    turns = integral(rates)
    there, rate = angle + x * horner(turns, x), horner(rates, x)
    reach, there = x[1:].copy(), there[1:]
    part, b = np.nonzero(rate[:-1] * rate[1:] < 0.0)  # it may go beyond and come back within
    within = roots(rates[:, b], x[part, b], x[part + 1, b])
    furthest = angle[b] + within * horner(turns[:, b], within)
    over = np.abs(furthest) > limit
    part, b = part[over], b[over]
    reach[part, b], there[part, b] = within[over], furthest[over]
    beyond, found = np.abs(there) > limit, np.full(len(h), np.nan)
    (b,) = np.nonzero(beyond.any(axis=0))
    part = beyond[:, b].argmax(axis=0)  # the first
    goal = np.sign(there[part, b]) * limit - angle[b]
    found[b] = roots(np.concatenate([-goal[None], turns[:, b]]), x[part, b], reach[part, b])
    found[np.abs(angle) > limit] = 0.0
    return found


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


def roots(series: Array, begin: Array, end: Array, near: float = NEAR) -> Array:
    """A root of each polynomial (K, B) between `begin` and `end`, where its sign changes, (B,).

    Newton's method ends with a step below `near` of the bracket.
    """
    found = np.empty_like(begin)
    with np.errstate(all="ignore"):
        low, high, least = begin, end, near * np.abs(end - begin)
        first, last = horner(series, begin), horner(series, end)
        sign, x = np.sign(first), begin - first * (end - begin) / (last - first)
        x = np.where((x - begin) * (x - end) <= 0.0, x, 0.5 * (begin + end))
        left = np.arange(len(begin))  # each by itself: no root depends on the others
        for _ in range(NEWTON):
            value, steep = with_slope(series, x)
            same = value * sign > 0.0
            low, high = np.where(same, x, low), np.where(same, high, x)
            newton = x - value / steep
            inside = (newton - low) * (newton - high) <= 0.0
            x, before = np.where(inside, newton, 0.5 * (low + high)), x
            found[left] = x
            (far,) = np.nonzero(~(np.abs(x - before) <= least))
            if not len(far):
                break
            if len(far) < len(x):
                series, left = series.take(far, axis=1), left[far]
                x, low, high, sign, least = (each[far] for each in (x, low, high, sign, least))
    return found


def horner(series: Array, x: Array) -> Array:
    """The values of polynomials (K, B) at x (..., B)."""
    total: Array = np.zeros_like(x) + series[-1]
    for coefficient in series[-2::-1]:
        total *= x
        total += coefficient
    return total


def with_slope(series: Array, x: Array) -> tuple[Array, Array]:
    """The values of polynomials (K, B) at x (B,), and their derivatives."""
    total, slope = series[-1].copy(), np.zeros_like(x)
    for coefficient in series[-2::-1]:
        slope *= x
        slope += total
        total *= x
        total += coefficient
    return total, slope
