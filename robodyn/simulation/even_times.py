"""Times at even distances, made where they are asked for: their number costs no memory."""

from __future__ import annotations

from typing import overload

import numpy as np

from robodyn.tables.arrays import Array

DEFAULT_DURATION = 10.0  # s, of a motion that no other is told of
DEFAULT_POINTS = 1001  # rows of one


class EvenTimes:
    """`count` times 0, step, 2 step, ..., the last of them `end`; a sequence, sliced as arrays."""

    def __init__(self, step: float, count: int, end: float) -> None:
        self.step, self.count, self.end = step, count, end

    def __len__(self) -> int:
        return self.count

    @overload
    def __getitem__(self, k: int) -> float: ...
    @overload
    def __getitem__(self, k: slice) -> Array: ...
    def __getitem__(self, k: int | slice) -> float | Array:
        if isinstance(k, slice):
            begin, end, _ = k.indices(self.count)
            times = np.arange(begin, end, dtype=float) * self.step
            if end == self.count and len(times):
                times[-1] = self.end
            return times
        if not -self.count <= k < self.count:
            raise IndexError(k)
        k %= self.count
        return self.end if k == self.count - 1 else k * self.step
