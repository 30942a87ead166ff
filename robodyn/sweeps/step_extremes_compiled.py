"""Extremes and crossings of one step's series in compiled loops; see `step_extremes.py`.

A series (2, K) is that of a rate, and below it that of its integral over x.
"""

# compiled functions are not annotated: types are numba's to infer
# mypy: disable-error-code="no-untyped-def, no-untyped-call"

from __future__ import annotations

import math

from robodyn.sweeps.step_extremes import NEAR, NEWTON, QUARTERS
from robodyn.taylor.kernel import compiled


@compiled()
def _keep_series(whole, work, at, j, joint, series):
    """The series of a joint's rate, or of its link's."""
    above = whole[at.parent + j]
    for k in range(at.order + 1):
        rate = work[at.W + j * at.K + k]
        if joint and above >= 0:
            rate -= work[at.W + above * at.K + k]
        series[0, k], series[1, k] = rate, rate / (k + 1)


@compiled()
def _values(series, K, x):
    """The integral, the value and the derivative at x of a series."""
    value, slope, turn = series[0, K - 1], 0.0, series[1, K - 1]
    for k in range(K - 2, -1, -1):
        slope = slope * x + value
        value = value * x + series[0, k]
        turn = turn * x + series[1, k]
    return turn * x, value, slope


@compiled()
def _bend(series, K, x):
    """Its second derivative."""
    bend = 0.0
    for k in range(K - 1, 1, -1):
        bend = bend * x + k * (k - 1.0) * series[0, k]
    return bend


@compiled()
def _root(series, K, kind, goal, begin, end, sign):
    """Where the integral (0), the value (1) or the slope (2) is `goal`, by Newton in a bracket."""
    low, high = begin, end
    x = 0.5 * (low + high)
    for _ in range(NEWTON):
        turn, value, slope = _values(series, K, x)
        if kind == 0:
            f, g = turn - goal, value
        elif kind == 1:
            f, g = value - goal, slope
        else:
            f, g = slope - goal, _bend(series, K, x)
        if f * sign > 0.0:
            low = x
        else:
            high = x
        newton = x - f / g
        last = x
        x = newton if (newton - low) * (newton - high) <= 0.0 else 0.5 * (low + high)
        if abs(x - last) <= NEAR * abs(end - begin):
            break
    return x


@compiled()
def widen(whole, work, at, y, j, h, low, high, rates):
    """Widen low and high of q_j and qd_j by what they are within a step h from y."""
    n, K = at.n, at.order + 1
    _keep_series(whole, work, at, j, True, rates)
    begin, before, before_slope = 0.0, rates[0, 0], rates[0, 1]
    for part in range(1, QUARTERS + 1):
        end = h * (part / QUARTERS)
        turn, rate, slope = _values(rates, K, end)
        low[j], high[j] = min(low[j], y[j] + turn), max(high[j], y[j] + turn)
        low[n + j], high[n + j] = min(low[n + j], rate), max(high[n + j], rate)
        if before * rate < 0.0:
            x = _root(rates, K, 1, 0.0, begin, end, before)
            value = y[j] + _values(rates, K, x)[0]
            low[j], high[j] = min(low[j], value), max(high[j], value)
        if before_slope * slope < 0.0:
            x = _root(rates, K, 2, 0.0, begin, end, before_slope)
            value = _values(rates, K, x)[1]
            low[n + j], high[n + j] = min(low[n + j], value), max(high[n + j], value)
        begin, before, before_slope = end, rate, slope


@compiled()
def crossing(whole, work, at, link, angle, h, rates):
    """Where |angle + turn of the link| first exceeds pi within a step h; nan if it does not."""
    if abs(angle) > math.pi:
        return 0.0
    K = at.order + 1
    _keep_series(whole, work, at, link, False, rates)
    begin, before = 0.0, rates[0, 0]
    for part in range(1, QUARTERS + 1):
        end = h * (part / QUARTERS)
        turn, rate, _ = _values(rates, K, end)
        reach, there = end, angle + turn
        if before * rate < 0.0:  # it may go beyond and come back within the part
            x = _root(rates, K, 1, 0.0, begin, end, before)
            furthest = angle + _values(rates, K, x)[0]
            if abs(furthest) > math.pi:
                reach, there = x, furthest
        if abs(there) > math.pi:
            goal = math.copysign(math.pi, there) - angle
            sign = _values(rates, K, begin)[0] - goal
            return _root(rates, K, 0, goal, begin, reach, sign)
        begin, before = end, rate
    return math.nan
