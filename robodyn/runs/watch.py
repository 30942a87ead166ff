"""Watches a run for events: finds each one along a segment, and ends the run if it must.

An event function is first evaluated at Chebyshev points of all steps of a segment.  Mostly these
values prove that its sign does not change.  Otherwise `roots.py` looks closer, on closed states.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.runs.event_functions import EventFunction, Part
from robodyn.runs.roots import (
    MORE_BOXES,
    MOST_BOXES,
    Budget,
    Stretches,
    brackets,
    certain,
    stretches,
)
from robodyn.runs.segments import Places, Segment
from robodyn.runs.state_columns import StateColumns
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr

APART = 1e-12  # of the time of a run: what is nearer in time happens at one instant
MOST = 1_000_000  # events that are kept
TOLD = 5  # times that a remark names
LONG = 1e-3  # of the time of a run: what rounding hides for longer is told
LESS = 7  # times at most that the work on a function is halved which cannot be followed
LEAST = 1e-17  # of a segment: no times within it are told apart further
MISSED = 4.0  # of what a step misses at its end, where it is brought back onto closures
FAR = 2.0  # rad: over more of a turn the nodes of one box may miss what a function does
MOST_PARTS = 4096  # into which a step is cut for that


@short_repr
class Event(NamedTuple):
    """An event: its time t (s), uncertain by `apart`, and the state y = (q, qd) there."""

    name: str
    t: float
    y: Array
    apart: float = 0.0


class Cut(NamedTuple):
    """The index of the function that cuts a segment, and the time of the cut."""

    place: int
    t: float


class Passing(NamedTuple):
    """A zero of function `place` at time t, uncertain by `apart`; `sign` is the sign after it."""

    place: int
    t: float
    apart: float
    sign: int


class Change(NamedTuple):
    """A stretch from `begin` to `end` on which a function has a sign, or 0 if rounding hides it.

    If the function `passes` zero at its begin, t is the time of the zero and `blur` its
    uncertainty.  With sign 0 the function `stays` at zero, or has no value there unless it is
    `defined`.
    """

    begin: float
    end: float
    sign: int
    passes: bool = False
    t: float = 0.0
    blur: float = 0.0
    stays: bool = False
    defined: bool = True


@dataclass
class EventWatch:
    """Watches event functions and keeps their events; functions in `stops` end the run.

    `found` has the first events in the order of time.  `happened` counts all events of each
    function.  `grazes` has, by name, times at which a function touches zero without crossing it, as
    far as rounding shows.  `hidden` has spans in which rounding hides its sign for long.  `lost`
    has times from which it changes sign too often to follow.  `signs` has the last known sign of
    each function, 0 if unknown; a condition that holds at the start is no event.  Events keep the
    first `width` numbers of a state (None: all).  `columns` computes columns of states that
    functions name.
    """

    functions: Sequence[EventFunction]
    t_end: float
    stops: frozenset[int] = frozenset()
    width: int | None = None
    columns: StateColumns | None = None

    def __post_init__(self) -> None:
        self.found: list[Event] = []  # in their order, the first MOST of them
        self.grazes: dict[str, list[float]] = {}
        self.hidden: dict[str, list[tuple[float, float]]] = {}
        self.lost: dict[str, list[float]] = {}
        self.happened = [0] * len(self.functions)
        self.signs = self.happened.copy()
        self.cut: dict[int, float] = {}  # when a function's event came with the end of a phase
        self.length = abs(self.t_end)
        self.instant = APART * self.length
        self.watched = self.functions
        self.may_end = bool(self.stops)  # whether an event may end the run, or a phase of it
        self._touched: list[tuple[float, float] | None] = [None] * len(self.signs)

    def counts(self, others: Sequence[Event] = ()) -> dict[str, int]:
        """Return how often each event happened, including the events in `others`."""
        pairs = zip(self.functions, self.happened, strict=True)
        counts = {function.name: count for function, count in pairs}
        for event in others:
            counts[event.name] = counts.get(event.name, 0) + 1
        return counts

    def remarks(self) -> list[str]:
        """Return remarks on events that rounding hides, or whose times are uncertain."""
        for i, touched in enumerate(self._touched):
            self._hidden_until(i, touched[1] if touched else 0.0)
        found = []
        for name, times in self.grazes.items():
            limit = "rounding hides whether it passes"
            found.append(f"{name} touches zero at t = {_listed(times)} s: {limit}")
        for name, spans in self.hidden.items():
            told = [f"{begin:.9g} to {end:.9g}" for begin, end in spans]
            found.append(f"{name} is zero to rounding from t = {_listed(told)} s")
        for name, times in self.lost.items():
            found.append(f"{name} passes zero too often to be followed, from t = {_listed(times)}")
        blurred = [event for event in self.found if event.apart > self.instant]
        if blurred:
            worst = max(blurred, key=lambda event: event.apart)
            found.append(
                f"{worst.name} at t = {worst.t:.9g} s passes zero so slowly that rounding leaves "
                f"{worst.apart:.1g} s open"
                + (f", and {len(blurred) - 1} more" * (len(blurred) > 1))
            )
        if sum(self.happened) > MOST:
            found.append(f"the first {MOST} events are kept")
        return found

    def guard(self, guards: Sequence[EventFunction]) -> None:
        """Also watch `guards`, positive now; a change of their sign ends the leg."""
        own = len(self.functions)
        self.watched = [*self.functions, *guards]
        self.may_end = bool(self.stops or guards)
        self.signs = [*self.signs[:own], *(1 for _ in guards)]
        self._touched = [*self._touched[:own], *(None for _ in guards)]

    # -- along a segment ---------------------------------------------------------------------------

    @np.errstate(all="ignore")  # values may be huge, or none
    def look(self, segment: Segment) -> Cut | None:
        """Record the events along a segment; return the cut if one of them ends it."""
        if not self.watched or not len(segment):
            return None
        parts = _parts(segment, (self.width or segment.y.shape[1]) // 2)
        changes = [self._changes(i, segment, parts) for i in range(len(self.watched))]
        forward, own, cut = segment.forward, len(self.functions), None
        if self.may_end:
            ending = [i for i in range(len(self.watched)) if i in self.stops or i >= own]
            each = [x for i in ending for x in self._passings(i, changes[i], None)]
            first = min(each, key=lambda x: x.t * forward, default=None)
            if first is not None:
                cut = self._ends(first.t, each, forward)
        until = None if cut is None else cut.t
        passed = [x for i in range(own) for x in self._passings(i, changes[i], until, take=True)]
        passed.sort(key=lambda x: x.t * forward)
        told = [x for x in passed if self._counts(x, cut)]
        if cut is not None and cut.place >= own:
            self._end_phase(cut, passed)
        states = segment.at(np.array([x.t for x in told])) if told else ()
        for one, y in zip(told, states, strict=True):
            self._tell(one, y)
        if cut is None:
            return None
        return Cut(cut.place, cut.t)

    def _ends(self, t: float, each: Sequence[Passing], forward: float) -> Passing:
        """Choose what ends the segment at the instant t: an event before a guard."""
        now = [x._replace(t=t) for x in each if (x.t - t) * forward <= self.instant]
        guard = next((x for x in now if x.place >= len(self.functions)), None)
        stops = (x for x in now if x.place in self.stops)
        found = next((x for x in stops if self._passes(x, guard)), guard)
        assert found is not None
        return found

    def _passes(self, one: Passing, cut: Passing | None) -> bool:
        """Return whether a zero counts although a guard may `cut` the segment there.

        At that instant the motion may turn back or stay, which only the next segment shows.  Only a
        comparison with equality holds already at zero.
        """
        function = self.watched[one.place]
        holds = one.sign == function.way and not function.strict
        at_end = cut is not None and cut.place >= len(self.functions) and one.t == cut.t
        return not at_end or holds

    def _counts(self, one: Passing, cut: Passing | None) -> bool:
        known = abs(one.t - self.cut.get(one.place, np.inf)) <= self.instant
        return self._passes(one, cut) and not known

    def _tell(self, one: Passing, y: Array) -> None:
        i = one.place
        self.happened[i] += 1
        if len(self.found) < MOST:
            name = self.functions[i].name
            self.found.append(Event(name, one.t, y[: self.width], one.apart))

    def _end_phase(self, cut: Passing, passed: Sequence[Passing]) -> None:
        """Reset the signs of functions that pass zero at the instant of a cut.

        The motion goes on in another mode there.
        """
        for i in range(len(self.functions)):
            self._hidden_until(i, cut.t)
        for each in passed:
            if each.t == cut.t and self._passes(each, cut):
                self.signs[each.place], self.cut[each.place] = 0, cut.t

    def _passings(
        self, i: int, changes: Sequence[Change], until: float | None, take: bool = False
    ) -> list[Passing]:
        """Return the zeros of a function that count as events, up to time `until`.

        With `take`, its last sign is stored, and spans hidden by rounding are recorded.
        """
        function, sign, touched = self.watched[i], self.signs[i], self._touched[i]
        found: list[Passing] = []
        for change in changes:
            now = change.sign or self._kept_sign(function, change)
            begin = change.t if change.passes else change.begin
            if until is not None and (begin - until) * self._forward > self.instant:
                break
            if not now:
                if not change.defined and self._lasts(change):
                    sign, touched = 0, None
                elif sign or not change.stays:
                    first = touched or (change.begin, change.end)
                    touched = first[0], change.end
                if take:
                    self._touched[i] = touched
                continue
            told = function.has_one_sign or function.computed
            if take:
                self._touched[i] = touched
                told = self._hidden_until(i, change.begin) or told
            if sign not in (0, now):
                near = until is not None and abs(begin - until) <= self.instant
                if function.way in (0, now):
                    width = abs(touched[1] - touched[0]) if touched else 0.0
                    t = until if near and until is not None else begin
                    found.append(Passing(i, t, max(change.blur, width), now))
                if near:  # whether it goes on beyond the cut the next segment tells
                    break
            elif touched and sign and i < len(self.functions) and not told and take:
                self._graze(function.name, 0.5 * (touched[0] + touched[1]))
            sign, touched = now, None
        if take:
            self.signs[i] = sign
        return found

    def _kept_sign(self, function: EventFunction, change: Change) -> int:
        """Return the sign of a comparison that stays at zero or is undefined.

        It is `way` if the comparison holds there and -`way` if not; 0 if the function is no
        comparison.
        """
        if not function.way or not self._lasts(change):
            return 0
        return -function.way if function.strict or not change.defined else function.way

    def _lasts(self, change: Change) -> bool:
        return change.stays and abs(change.end - change.begin) > self.instant

    @property
    def _forward(self) -> float:
        return -1.0 if self.t_end < 0.0 else 1.0

    def _graze(self, name: str, t: float) -> None:
        """Record that a function touches zero at t."""
        times = self.grazes.setdefault(name, [])
        if not times or abs(t - times[-1]) > self.instant:
            times.append(t)

    def _hidden_until(self, i: int, t: float) -> bool:
        """End a span hidden by rounding; return whether it was recorded as long."""
        touched, self._touched[i] = self._touched[i], None
        if not touched or i >= len(self.functions):
            return False
        spans = self.hidden.get(self.functions[i].name, [])
        if spans and abs(touched[0] - spans[-1][1]) <= self.instant:
            touched = spans.pop()  # which it goes on, as where a joint starts that was held
        elif abs(t - touched[0]) <= LONG * self.length:
            return False
        self.hidden[self.functions[i].name] = [*spans, (touched[0], t)]
        return True

    # -- signs of one function ---------------------------------------------------------------------

    def _changes(self, i: int, segment: Segment, parts: Places) -> list[Change]:
        """Return the stretches of equal sign of a function along a segment.

        Chebyshev points decide for steps whose entry in `parts` (m,) is 1.
        """
        function, (nodes, times) = self.watched[i], segment.nodes
        known = (parts == 1).astype(np.int64)
        for part in (*function.switches, function):
            known = np.where(known != 0, _seen(part, segment, nodes, times), 0)
        first = int(known[0])
        goes_on = self.signs[i] in (0, first) and self._touched[i] is None
        if first and goes_on and (known == first).all():
            return [Change(segment.begin, segment.end, first)]
        budget = Budget(LEAST * abs(segment.end - segment.begin))
        most = MOST_BOXES + MORE_BOXES * len(segment)
        budget.left = most >> min(len(self.lost.get(function.name, ())), LESS)
        found = signs_along(function, segment, _pieces(segment, known, parts), budget)
        if budget.spent:
            if function.name not in self.lost:  # a run may take long to tell it at its end
                remark = f"{function.name} passes zero too often to be followed, as at "
                warnings.warn(f"{remark}t = {segment.begin:.9g} s", RobodynWarning, stacklevel=2)
            self.lost.setdefault(function.name, []).append(segment.begin)
        return self._sharp(i, segment, found)

    def _sharp(self, i: int, segment: Segment, found: Stretches) -> list[Change]:
        """Return stretches with each zero located on the closed states."""
        function, last, before = self.watched[i], self.signs[i], -1
        sign, goes_on = found.sign, np.zeros(len(found.sign), bool)
        goes_on[1:] = (sign[1:] == sign[:-1]) & (sign[1:] != 0)
        which = (~goes_on).nonzero()[0]
        ends = np.append(which[1:], len(sign)) - 1
        changes: list[Change] = []
        passing: list[tuple[int, int, int]] = []  # place among changes, stretches before and after
        for k, end in zip(which.tolist(), ends.tolist(), strict=True):
            blur, stays = float(found.blur[k]), bool(found.stays[k])
            change = Change(
                float(found.begin[k]), float(found.end[end]), int(sign[k]), blur=blur, stays=stays,
                defined=bool(found.defined[k]),
            )  # fmt: skip
            now = change.sign or self._kept_sign(function, change)
            if now:
                if last not in (0, now):
                    if before < 0:
                        change = change._replace(passes=True, t=segment.begin)
                    else:
                        passing.append((len(changes), before, k))
                        change = change._replace(passes=True)
                last, before = now, end
            changes.append(change)
        if passing:
            at, before_, after = np.array(passing).T
            to = np.array([changes[j].sign or self._kept_sign(function, changes[j]) for j in at])
            equal = bool(function.way) and not function.strict

            def met(values: Array, k: NDArray[np.int64]) -> Array:
                met: Array = values * to[k] >= 0.0 if equal else values * to[k] > 0.0
                return met

            sure = found.sure[before_], found.sure[after]
            _, _, times = brackets(_along(function, segment), met, *sure, found.begin[after])
            for j, t in zip(at.tolist(), times.tolist(), strict=True):
                changes[j] = changes[j]._replace(t=t)
        return changes


def _along(part: Part, segment: Segment) -> Any:
    """Return a function of times that gives the values of `part` along a segment."""
    return lambda t: part.values(t, segment.at(t))


def _seen(part: Part, segment: Segment, nodes: Array, times: Array) -> NDArray[np.int64]:
    """Return the sign (m,) that `part` has for certain on each whole step; 0 if uncertain."""
    m, k, width = nodes.shape
    values = part.values(times.ravel(), nodes.reshape(-1, width)).reshape(m, k)
    off = np.maximum.reduce(part.noise(times, nodes, segment.largest(np.arange(m))), axis=1)
    ends = nodes[:, -1] != segment.y[1:, :width]
    if ends.any():
        there = part.values(segment.t[1:], segment.y[1:, :width])
        off += MISSED * np.abs(values[:, -1] - there)
    return certain(values, off)


def _parts(segment: Segment, n: int) -> Places:
    """Return into how many parts (m,) each step is cut so that no coordinate moves far in one."""
    nodes, _ = segment.nodes
    ways = np.abs(np.diff(nodes[..., :n], axis=1)).sum(axis=1).max(axis=1, initial=0.0)
    ways = np.where(np.isfinite(ways), ways, 0.0)
    return np.minimum(MOST_PARTS, 1 + ways // FAR).astype(np.int64)


def _pieces(
    segment: Segment, known: NDArray[np.int64], parts: Places
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return begin, end (k,) of the parts of steps, and their known signs (k,), 0 if unknown."""
    begin, end = segment.t[:-1], segment.t[1:]
    if not (parts > 1).any():
        return begin, end, known
    step = np.repeat(np.arange(len(begin)), parts)
    k, width = np.arange(len(step)) - np.repeat(np.cumsum(parts) - parts, parts), end - begin
    ends = begin[step] + width[step] * ((k + 1) / parts[step])
    ends = np.where(k + 1 == parts[step], end[step], ends)
    begins = np.where(k == 0, begin[step], np.concatenate([begin[:1], ends[:-1]]))
    return begins, ends, known[step]


def signs_along(
    function: EventFunction,
    segment: Segment,
    pieces: tuple[Array, Array, NDArray[np.int64]],
    budget: Budget,
) -> Stretches:
    """Return stretches of equal sign of a function along a segment.

    They are cut where the function bends or jumps.  `pieces` is (begin (k,), end (k,), known signs
    (k,) or 0).
    """
    begin, end, known = pieces
    if function.switches:
        cut = begin[known == 0], end[known == 0]
        for switch in function.switches:
            cut = _cut(switch, segment, *cut, budget)
        kept, (low, high) = known != 0, cut
        begin, end = np.concatenate([begin[kept], low]), np.concatenate([end[kept], high])
        known = np.concatenate([known[kept], np.zeros(len(low), np.int64)])
    return stretches(_sampled(function, segment), begin, end, budget, known)


def _sampled(part: Part, segment: Segment) -> Any:
    def sampled(times: Array) -> tuple[Array, Array]:
        y = segment.at(times.ravel())
        values = part.values(times.ravel(), y).reshape(times.shape)
        large = segment.largest(segment.places(times[:, -1]))
        return values, part.noise(times, y.reshape(*times.shape, -1), large)

    return sampled


def _cut(
    switch: Part, segment: Segment, begin: Array, end: Array, budget: Budget
) -> tuple[Array, Array]:
    """Cut pieces at the zeros of a switch; each cut lies between two neighbouring floats."""
    found = stretches(_sampled(switch, segment), begin, end, budget)
    shown = (found.sign != 0) | found.stays  # what rounding hides is passed over
    sign, sure, at = found.sign[shown], found.sure[shown], found.begin[shown]
    turns = (sign[1:] != sign[:-1]).nonzero()[0]
    if not len(turns):
        return begin, end
    to = sign[turns + 1]

    def met(values: Array, k: NDArray[np.int64]) -> Array:
        met: Array = np.sign(values) == to[k]
        return met

    ends = sure[turns], sure[turns + 1], at[turns + 1]
    low, high, _ = brackets(_along(switch, segment), met, *ends)
    forward = segment.forward
    at = np.searchsorted(begin * forward, low * forward, side="right") - 1
    inside = (at >= 0) & (high * forward <= (end * forward)[at])
    first, final = np.concatenate([begin, high[inside]]), np.concatenate([end, low[inside]])
    first, final = np.sort(first * forward) * forward, np.sort(final * forward) * forward
    kept = first != final
    return first[kept], final[kept]


def _listed(times: Sequence[float | str]) -> str:
    told = [t if isinstance(t, str) else f"{t:.9g}" for t in times[:TOLD]]
    return ", ".join(told) + (", ..." if times[TOLD:] else "")
