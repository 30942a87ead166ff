"""Times at which a torque bends or jumps, as an integrator meets them: it steps onto each."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence

NEAR = 4.0  # spacings of floats


def next_kink(kinks: Sequence[float], t: float, end: float, spacings: float = 0.0) -> float:
    """The next of the increasing `kinks` from t towards `end`, or the end.

    One that is only so many spacings of floats ahead is passed over.
    """
    near = spacings * math.ulp(t)
    if end >= t:
        k = bisect_right(kinks, t + near)
        return min(end, kinks[k]) if k < len(kinks) else end
    k = bisect_left(kinks, t - near) - 1
    return max(end, kinks[k]) if k >= 0 else end


def kink_at(kinks: Sequence[float], t: float) -> float | None:
    """The one of the increasing `kinks` that is at t, but for rounding."""
    near = NEAR * math.ulp(t)
    k = bisect_left(kinks, t - near)
    return kinks[k] if k < len(kinks) and kinks[k] <= t + near else None
