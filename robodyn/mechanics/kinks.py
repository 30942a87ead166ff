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


def next_stop(
    kinks: Sequence[float], leaves: Sequence[float], t: float, end: float, spacings: float = 0.0
) -> float:
    """Where a step from t towards `end` must end at the latest: at a kink, or by a leaf's length.

    `leaves` are the increasing ends, in |t|, of what no step may enter that is longer.
    """
    stop = next_kink(kinks, t, end, spacings)
    if not leaves:
        return stop
    begun = abs(t)
    k = max(bisect_right(leaves, begun), 1)
    longest = begun + leaves[k] - leaves[k - 1] if k < len(leaves) else math.inf
    while k + 1 < len(leaves) and leaves[k] < longest:
        longest = min(longest, max(leaves[k], begun + leaves[k + 1] - leaves[k]))
        k += 1
    return stop if longest >= abs(stop) else math.copysign(longest, end)


def kink_at(kinks: Sequence[float], t: float) -> float | None:
    """The one of the increasing `kinks` that is at t, but for rounding."""
    near = NEAR * math.ulp(t)
    k = bisect_left(kinks, t - near)
    return kinks[k] if k < len(kinks) and kinks[k] <= t + near else None
