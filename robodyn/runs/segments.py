"""Segments of a run: accepted steps and the states between them.

Rows, events and statistics of a run all read segments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.runs.roots import NODES, node_times
from robodyn.tables.arrays import Array

Places = NDArray[np.int64]
Inside = Callable[[Places, Array], Array]  # states (k, N) at a time of each of some steps


class Segment:
    """Steps from t[j] to t[j + 1] with states y (m + 1, N) at the times t (m + 1,).

    `inside(places, times)` returns closed states (k, N) at one time (k,) in each of the steps
    `places` (k,).  `sampled()` returns states (m, nodes, N) at Chebyshev points of all steps.
    These states need not close; at the end of a step they show by how much the polynomial misses.
    Without it, `inside` serves.  `width` is the number of state components that `inside` returns.
    `whole(j, times)` returns complete states (k, N) within step j.  `rows` holds requested output
    times with their states.
    """

    def __init__(
        self,
        t: Array,
        y: Array,
        inside: Inside | None = None,
        sampled: Callable[[], Array] | None = None,
        width: int | None = None,
        whole: Callable[[int, Array], Array] | None = None,
        rows: tuple[Array, Array] | None = None,
    ) -> None:
        self.t, self.y, self.width, self._whole = t, y, width or y.shape[1], whole
        self.rows = rows
        self.forward = 1.0 if t[-1] >= t[0] else -1.0
        self._inside, self._sampled = inside, sampled

    def __len__(self) -> int:
        return len(self.t) - 1

    @property
    def begin(self) -> float:
        return float(self.t[0])

    @property
    def end(self) -> float:
        return float(self.t[-1])

    def within(self, places: Places, times: Array) -> Array:
        """Return states (k, N), one at a time (k,) within each of the steps `places` (k,)."""
        states = np.empty((len(times), self.width))
        at_begin, at_end = times == self.t[places], times == self.t[places + 1]
        between = ~(at_begin | at_end)
        if between.any():
            assert self._inside is not None
            states[between] = self._inside(places[between], times[between])
        states[at_begin] = self.y[places[at_begin], : self.width]
        states[at_end] = self.y[places[at_end] + 1, : self.width]
        return states

    def places(self, times: Array) -> Places:
        """Return the indices (k,) of the steps that contain times (k,)."""
        steps = np.searchsorted(self.t * self.forward, times * self.forward) - 1
        return np.minimum(np.maximum(steps, 0), len(self) - 1)

    def at(self, times: Array) -> Array:
        """Return states (k, N) at times (k,) within the segment, in any order."""
        return self.within(self.places(times), times)

    def largest(self, places: Places) -> Array:
        """Return the larger size (k, N) of each state component at both ends of steps."""
        sizes = np.abs(self.y[:, : self.width])
        return np.maximum(sizes[places], sizes[places + 1])

    def states(self, times: Array) -> Array:
        """Return complete states (k, N) at times (k,), ordered along the motion."""
        if self._whole is None:
            return self.at(times)
        places, states = self.places(times), np.empty((len(times), self.y.shape[1]))
        for j in np.unique(places).tolist():
            here = places == j
            states[here] = self._whole(j, times[here])
            states[here & (times == self.t[j + 1])] = self.y[j + 1]
        states[times == self.t[0]] = self.y[0]
        return states

    def until(self, t: float) -> Segment:
        """Return the part of the segment up to time t."""
        y = self.states(np.array([t]))
        count = int(np.searchsorted(self.t * self.forward, t * self.forward))
        times, states = np.append(self.t[:count], t), np.concatenate([self.y[:count], y])
        rows = self.rows
        if rows is not None:
            kept = rows[0] * self.forward <= t * self.forward
            rows = rows[0][kept], rows[1][kept]
        return Segment(times, states, self._inside, None, self.width, self._whole, rows)

    @cached_property
    def nodes(self) -> tuple[Array, Array]:
        """States (m, nodes, N) at Chebyshev points of the steps, and their times (m, nodes)."""
        times = node_times(self.t[:-1], self.t[1:])
        if self._sampled is not None:
            return self._sampled(), times
        places = np.repeat(np.arange(len(self)), len(NODES))
        return self.within(places, times.ravel()).reshape(*times.shape, -1), times


def kept_step(solver: Any) -> Any:
    """Return a copy of a scipy solver after a step, whose dense output can be asked for later."""
    step = object.__new__(type(solver))
    vars(step).update(vars(solver))  # each step makes all of these anew, but for its stages
    for stages in ("K", "K_extended"):
        if hasattr(solver, stages):
            setattr(step, stages, getattr(solver, stages).copy())
    step.fun = lambda t, y: solver.fun(t, y)  # by its present way past a singularity
    return step


def solver_segment(begun: Array, steps: Sequence[Any]) -> Segment:
    """Return the segment of kept steps of a solver that start from the state `begun` (N,)."""
    close = steps[0].projection
    t = np.array([steps[0].t_old, *(step.t for step in steps)])
    y = np.array([begun, *(step.y for step in steps)])

    @cache
    def dense(j: int) -> Any:
        """Return the polynomial of step j, not projected onto closures."""
        return steps[j].dense_output()

    def plain(places: Places, times: Array) -> Array:
        """Return states of the method's polynomial, not projected onto closures."""
        asked, which = np.unique(places, return_inverse=True)
        each = [dense(j) for j in asked.tolist()]
        if type(each[0]).__name__ != "Dop853DenseOutput":
            pairs = zip(which.tolist(), times.tolist(), strict=True)
            return np.array([each[k](at) for k, at in pairs])
        F, begun = (np.array([getattr(one, name) for one in each]) for name in ("F", "y_old"))
        some, x = F[which], ((times - t[places]) / (t[places + 1] - t[places]))[:, None]
        sums = some[:, -1] * x
        for i in range(1, some.shape[1]):  # as each of them does by itself
            sums = (sums + some[:, -1 - i]) * (1.0 - x if i % 2 else x)
        return np.asarray(sums + begun[which])

    def inside(places: Places, times: Array) -> Array:
        states = plain(places, times)
        if close is None:
            return states
        return np.stack([close(at, row) for at, row in zip(times.tolist(), states, strict=True)])

    def sampled() -> Array:
        times = node_times(t[:-1], t[1:])
        places = np.repeat(np.arange(len(steps)), len(NODES))
        return plain(places, times.ravel()).reshape(*times.shape, -1)

    return Segment(t, y, inside, sampled)
