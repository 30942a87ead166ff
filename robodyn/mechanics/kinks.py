"""Times at which a torque bends or jumps, as an integrator meets them: it steps onto each."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence

NEAR = 4.0  # spacings of floats


def switch(k: int) -> str:
    """The name, in trees of torques, of what stands still between two times."""
    return f"_s[{k}]"


def switch_number(name: str) -> int | None:
    """The k of a name that is of a switch."""
    return int(name[3:-1]) if name.startswith("_s[") else None


class Pieces:
    """Which piece between increasing `kinks` holds at a time.

    From a kink that a run has come to until it comes to the next no further piece holds: so a step
    that ends on a kink does not see beyond it.
    """

    def __init__(self, kinks: Sequence[float]) -> None:
        self.kinks = kinks
        self.reset()

    def reset(self) -> None:
        """Let each piece hold in its time."""
        self.first, self.last, self.find = 0, len(self.kinks), bisect_right

    def piece(self, t: float) -> int:
        """The number of the piece, from 0."""
        k = self.find(self.kinks, t)
        return self.first if k < self.first else self.last if k > self.last else k

    def come_to(self, t: float, forward: bool) -> None:
        """A run has come to t: the piece ahead of it is the furthest."""
        self.reset()
        if forward:
            self.last = self.piece(t)
        else:
            self.find = bisect_left
            self.first = self.piece(t)


class Ahead:
    """The times of a piece between two of the increasing `jumps`, of what jumps at these alone.

    At a jump the value is that which follows it.  A step that ends there must not see that value,
    nor one backwards that begins there: the times of a piece end one float before its second jump.
    """

    def __init__(self, jumps: Sequence[float]) -> None:
        self.jumps = jumps
        self.low, self.high = -math.inf, math.inf

    def begin(self, t: float, forward: bool) -> None:
        """Keep to the piece that a step from t enters."""
        near = NEAR * math.ulp(t)
        jumps = self.jumps
        k = bisect_right(jumps, t + near) if forward else bisect_left(jumps, t - near)
        self.low = jumps[k - 1] if k else -math.inf
        self.high = math.nextafter(jumps[k], -math.inf) if k < len(jumps) else math.inf

    def __call__(self, t: float) -> float:
        """The time of the piece that is nearest to t."""
        return min(max(t, self.low), self.high)


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
