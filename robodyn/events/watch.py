"""Watches a run for events: finds each within its step, in order, and ends the run where one does.

Of the steps of a series all are looked at together: where a function has one certain sign along a
step, and the sign that it had before, nothing happened.  The others are looked at one by one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.events.functions import EventFunction
from robodyn.events.signs import NODES, ROUNDING, Stretch, certain, root, stretches

Array = NDArray[np.float64]
States = Callable[[Array], Array]  # those (k, N) at times (k,) within a step

APART = 1e-12  # of the time of a run: what is nearer in time happens at one instant
TOLD = 5  # times that a remark names
MOST = 1_000_000  # events that are kept
FAR = 0.3  # part of its change along a step that a function may be off by its ends' cubic
CUTS: Array = np.linspace(0.0, 1.0, 7)  # of a step
HERMITE: Array = np.stack(
    [
        (1.0 + 2.0 * CUTS) * (1.0 - CUTS) ** 2,
        CUTS**2 * (3.0 - 2.0 * CUTS),
        CUTS * (1.0 - CUTS) ** 2,
        CUTS**2 * (CUTS - 1.0),
    ],
    axis=1,
)


class Event(NamedTuple):
    """What happened when, and the state y = (q, qd) there; its time may be off by `apart`, s."""

    name: str
    t: float
    y: Array
    apart: float = 0.0


class Step(NamedTuple):
    """A step: its ends, the state at its end, and the states within it."""

    begin: float
    end: float
    y: Array
    states: States


class Stop(NamedTuple):
    """The event that ends a run, of which function, and the whole state (N,) there."""

    place: int
    t: float
    y: Array


@dataclass
class EventWatch:
    """Watches functions; those of the places `stops` end the run.

    `signs` are those that functions have had; 0 where that is not yet known: what holds at the
    start is no event.  `grazes` has, by name, the times at which a function touches zero as far as
    rounding tells, without passing it.
    """

    functions: Sequence[EventFunction]
    t_end: float
    stops: frozenset[int] = frozenset()
    found: list[Event] = field(default_factory=list)
    grazes: dict[str, list[float]] = field(default_factory=dict)
    signs: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.signs = self.signs or [0] * len(self.functions)
        self.watched = list(self.functions)

    def guard(self, guards: Sequence[EventFunction]) -> None:
        """Watch these besides, which are positive now: what changes their signs ends the run."""
        own = len(self.functions)
        self.watched = [*self.functions, *guards]
        self.signs = [*self.signs[:own], *(1 for _ in guards)]

    def counts(self, others: Sequence[Event] = ()) -> dict[str, int]:
        """How often each event happened, and each of some others."""
        counts = dict.fromkeys((function.name for function in self.functions), 0)
        for event in (*self.found, *others):
            counts[event.name] = counts.get(event.name, 0) + 1
        return counts

    def remarks(self) -> list[str]:
        """What is to be said of events that rounding hides, or whose times are not sharp."""
        found = []
        for name, times in self.grazes.items():
            at = ", ".join(f"{t:.9g}" for t in times[:TOLD]) + (", ..." if times[TOLD:] else "")
            found.append(f"{name} touches zero at t = {at} s: rounding hides whether it passes")
        least = APART * abs(self.t_end)
        blurred = [event for event in self.found if event.apart > least]
        if blurred:
            worst = max(blurred, key=lambda event: event.apart)
            found.append(
                f"{worst.name} at t = {worst.t:.9g} s passes zero so slowly that rounding leaves "
                f"{worst.apart:.1g} s open"
                + (f", and {len(blurred) - 1} more" * (len(blurred) > 1))
            )
        return found

    def series(
        self, times: Array, sampled: Array, step: Callable[[int], Step]
    ) -> tuple[int, Stop] | None:
        """Steps from times[j] to times[j + 1], with states (m, nodes, N) at Chebyshev's points.

        `step(j)` has one whole.  Tells in which of them the run ends, and how.
        """
        h = np.diff(times)
        at = (times[:-1, None] + h[:, None] * NODES).ravel()
        flat, shape = sampled.reshape(len(at), -1), sampled.shape[:2]
        doubtful: dict[int, list[int]] = {}
        known = []
        for i, function in enumerate(self.watched):
            noise = ROUNDING * function.sizes(at, flat).reshape(shape).max(axis=1)
            signs = certain(function.values(at, flat).reshape(shape), noise)
            known.append(signs)
            before = np.append(self.signs[i], signs[:-1])
            for j in np.flatnonzero((signs != before) | (signs == 0)).tolist():
                doubtful.setdefault(j, []).append(i)
        for j in sorted(doubtful):
            for i in doubtful[j]:
                if j and known[i][j - 1]:
                    self.signs[i] = int(known[i][j - 1])
            stop = self.step(step(j), doubtful[j])
            if stop is not None:
                return j, stop
        for i, signs in enumerate(known):
            if len(signs) and signs[-1]:
                self.signs[i] = int(signs[-1])
        return None

    def near(self, begin: float, end: float, ends: Array, slopes: Array) -> list[int]:
        """The functions that may pass zero from `begin` to `end`, as far as these tell.

        `ends` and `slopes` (2, N) are y and dy/dt there: between them y is about the cubic that has
        both, and a function stays where it is FAR from zero against how much it changes.
        """
        h = end - begin
        between, at = HERMITE @ np.concatenate([ends, h * slopes]), begin + h * CUTS
        doubtful = []
        for i, function in enumerate(self.watched):
            values = function.values(at, between)
            least, most = float(values.min()), float(values.max())
            nearest = least if self.signs[i] > 0 else -most
            if not (self.signs[i] and nearest > FAR * (most - least)):
                doubtful.append(i)
        return doubtful

    def step(self, step: Step, places: Sequence[int] | None = None) -> Stop | None:
        """Look at one step, for the functions at `places`."""
        passed: list[tuple[float, float, int]] = []
        for i in range(len(self.watched)) if places is None else places:
            passed += [(t, apart, i) for t, apart in self._crossings(i, step)]
        forward = 1.0 if step.end > step.begin else -1.0
        passed.sort(key=lambda each: each[0] * forward)
        instant = APART * abs(self.t_end)
        own = len(self.functions)
        ends = next((each for each in passed if each[2] in self.stops or each[2] >= own), None)
        for t, apart, i in passed:
            if ends is not None and (t - ends[0]) * forward > instant:
                break
            if i < own and len(self.found) < MOST:
                self.found.append(Event(self.functions[i].name, t, self._state(step, t), apart))
        return None if ends is None else Stop(ends[2], ends[0], self._state(step, ends[0]))

    def _state(self, step: Step, t: float) -> Array:
        return step.y if t == step.end else step.states(np.array([t]))[0]

    def _crossings(self, i: int, step: Step) -> list[tuple[float, float]]:
        """When a function passes zero in the way that counts, and how far that may be off."""
        function = self.watched[i]
        found: list[tuple[float, float]] = []

        def values(t: Array) -> Array:
            return function.values(t, step.states(t))

        def sized(t: Array) -> tuple[Array, Array]:
            y = step.states(t)
            return function.values(t, y), function.sizes(t, y)

        before: Stretch | None = None
        for stretch in stretches(sized, step.begin, step.end):
            if not stretch.sign:
                if stretch.begin == stretch.end and i < len(self.functions):
                    self._graze(function.name, stretch.begin)
                continue
            if self.signs[i] not in (0, stretch.sign) and function.way in (0, stretch.sign):
                t, apart = step.begin, 0.0
                if before is not None:
                    low, high = (x.begin + 0.5 * (x.end - x.begin) for x in (before, stretch))
                    ends, sizes = sized(np.array([low, high]))
                    noise = ROUNDING * float(sizes.max())
                    first, last = ends.tolist()
                    t = root(values, low, high, stretch.begin)
                    apart = noise * abs((high - low) / ((last - first) or math.inf))
                found.append((t, apart))
            self.signs[i], before = stretch.sign, stretch
        return found

    def _graze(self, name: str, t: float) -> None:
        times = self.grazes.setdefault(name, [])
        if not times or abs(t - times[-1]) > APART * abs(self.t_end):
            times.append(t)
