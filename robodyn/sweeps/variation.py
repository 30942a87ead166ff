"""The points of a sweep: a grid, or a random sample, of several quantities.

A grid is the product of its axes' values, the last axis varying fastest.  A sample draws an
interval [low, high) by low + u (high - low), a list of values by its entry floor(u count), and a
normal distribution by its quantile at u, with u from numpy's Generator(PCG64(seed)).random, one u
an axis and point, point by point.  The generator is set forward to where a block of points begins,
so that a block depends on nothing but its place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robodyn.tables.arrays import Array

LEAST = 2.0**-54  # in place of a draw of 0, whose quantile is infinite


@dataclass(frozen=True, slots=True)
class Axis:
    """One quantity that varies: over `values`, or (in samples alone) from `low` to `high`."""

    name: str
    values: tuple[float, ...] = ()
    low: float = 0.0
    high: float = 0.0
    deviation: float = 0.0  # of a normal distribution about `low`

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the largest value; of a normal distribution, which has none, its mean."""
        if self.deviation:
            return self.low, self.low
        return (min(self.values), max(self.values)) if self.values else (self.low, self.high)

    def drawn(self, u: Array) -> Array:
        """The values for u in [0, 1)."""
        if self.deviation:
            from statistics import NormalDist  # which takes longer than all that a grid needs

            quantile = NormalDist(self.low, self.deviation).inv_cdf
            return np.array([quantile(x) for x in np.maximum(u, LEAST).tolist()])
        if not self.values:
            return self.low + u * (self.high - self.low)
        place = np.minimum((u * len(self.values)).astype(int), len(self.values) - 1)
        values: Array = np.array(self.values)
        return np.asarray(values[place])


@dataclass(frozen=True, slots=True)
class Variation:
    """All points: of a grid, or `sample` drawn ones."""

    axes: tuple[Axis, ...]
    sample: int | None = None
    seed: int = 0

    @property
    def size(self) -> int:
        """How many points there are."""
        if self.sample is not None:
            return self.sample
        return math.prod(len(axis.values) for axis in self.axes)

    def points(self, begin: int, end: int) -> Array:
        """The points of these numbers, (end - begin, axes)."""
        count = len(self.axes)
        if self.sample is not None:
            stream = np.random.PCG64(self.seed)
            stream.advance(begin * count)  # a draw each
            u = np.random.Generator(stream).random((end - begin, count))
            columns = [axis.drawn(u[:, k]) for k, axis in enumerate(self.axes)]
        else:
            columns, number = [], np.arange(begin, end)
            for axis in reversed(self.axes):
                number, place = np.divmod(number, len(axis.values))
                columns.append(np.array(axis.values)[place])
            columns.reverse()
        return np.stack(columns, axis=-1) if columns else np.zeros((end - begin, 0))


def stepped(first: float, last: float, step: float) -> tuple[float, ...]:
    """first, first + step, ... to last, which is met exactly where the steps lead there.

    Raises ValueError where they lead away from it.
    """
    if step == 0.0 or (last - first) * step < 0.0:
        raise ValueError("the step leads nowhere")
    steps = (last - first) / step
    count = math.floor(steps + 1e-9)
    values = [first + k * step for k in range(count + 1)]
    if abs(steps - count) <= 1e-9:
        values[-1] = last
    return tuple(values)


def spaced(first: float, last: float, count: int) -> tuple[float, ...]:
    """`count` values from first to last, both included."""
    values: Sequence[float] = np.linspace(first, last, count).tolist()
    return tuple(values)
