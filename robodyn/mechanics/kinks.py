"""Times at which a torque bends or jumps; an integrator steps onto each."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence

NEAR = 4.0  # spacings of floats


def switch(k: int) -> str:
    """Return the name of switch k in trees of torques."""
    return f"_s[{k}]"


def switch_number(name: str) -> int | None:
    """Return the k of a switch's name; None for other names."""
    return int(name[3:-1]) if name.startswith("_s[") else None


class Pieces:
    """Finds the piece between increasing `kinks` that holds at a time.

    From a kink that a run has reached until it reaches the next, no later piece holds.  So a step
    that ends on a kink does not see beyond it.
    """

    def __init__(self, kinks: Sequence[float]) -> None:
        self.kinks = kinks
        self.reset()

    def reset(self) -> None:
        """Let each piece hold in its own time."""
        self.first, self.last, self.find = 0, len(self.kinks), bisect_right

    def piece(self, t: float) -> int:
        """Return the index of the piece."""
        k = self.find(self.kinks, t)
        return self.first if k < self.first else self.last if k > self.last else k

    def come_to(self, t: float, forward: bool) -> None:
        """Tell that a run has reached t: the piece ahead is the last one allowed."""
        self.reset()
        if forward:
            self.last = self.piece(t)
        else:
            self.find = bisect_left
            self.first = self.piece(t)


class Held(Pieces):
    """Values of the switches of torques over time, constant in each piece.

    At a kink that is reached, the later values hold.
    """

    restarts = True  # a torque may jump there

    def __init__(self, kinks: Sequence[float], values: Sequence[tuple[float, ...]]) -> None:
        super().__init__(kinks)
        self.values = values
        self.begin((), 1.0)

    def begin(self, y: Sequence[float], t_end: float) -> None:
        """Start a run; see `Steps`."""
        self.forward = t_end >= 0.0
        self.reach(0.0, y)

    def reach(self, t: float, y: Sequence[float]) -> None:
        """Reach a kink; see `Steps`."""
        self.come_to(t, self.forward)

    def at(self, t: float) -> tuple[float, ...]:
        """Return the values of all switches at t, not beyond a kink not yet reached."""
        return self.values[self.piece(t)]


class Ahead:
    """The times of the piece between two of the increasing `jumps`.

    At a jump the value is the later one.  A forward step that ends there must not see it, nor a
    backward step that begins there; so the piece ends one float before its second jump.
    """

    def __init__(self, jumps: Sequence[float]) -> None:
        self.jumps = jumps
        self.low, self.high = -math.inf, math.inf

    def begin(self, t: float, forward: bool) -> None:
        """Select the piece that a step from t enters."""
        near = NEAR * math.ulp(t)
        jumps = self.jumps
        k = bisect_right(jumps, t + near) if forward else bisect_left(jumps, t - near)
        self.low = jumps[k - 1] if k else -math.inf
        self.high = math.nextafter(jumps[k], -math.inf) if k < len(jumps) else math.inf

    def __call__(self, t: float) -> float:
        """Return t, clipped to the piece."""
        return min(max(t, self.low), self.high)


def next_kink(kinks: Sequence[float], t: float, end: float, spacings: float = 0.0) -> float:
    """Return the next of the increasing `kinks` from t towards `end`, or the end.

    A kink less than `spacings` floats ahead is skipped.
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
    """Return the latest end of a step from t towards `end`: a kink, or a leaf's length.

    `leaves` are the increasing ends, in |t|, of intervals that no longer step may enter.
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
    """Return the kink at t, up to rounding, or None."""
    near = NEAR * math.ulp(t)
    k = bisect_left(kinks, t - near)
    return kinks[k] if k < len(kinks) and kinks[k] <= t + near else None
