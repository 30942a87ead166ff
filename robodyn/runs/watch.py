"""Watches a run for events: finds each one along a segment, and ends the run if it must.

An event function is first evaluated at Chebyshev points of all steps of a segment.  Mostly these
values prove that its sign does not change.  Otherwise `roots.py` looks closer, on closed states.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.runs.event_functions import EventFunction, Part
from robodyn.runs.roots import (
    HIDDEN,
    MORE_BOXES,
    MOST_BOXES,
    UNDEFINED,
    ZERO,
    Boxes,
    Budget,
    SignSearch,
    Stretches,
    brackets,
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


class Passing(NamedTuple):
    """A zero of function `place` at time t, uncertain by `apart`; `sign` is the sign after it."""

    place: int
    t: float
    apart: float
    sign: float


class Change(NamedTuple):
    """A stretch from `begin` to `end` of a kind (see `Stretches`), on which a function has a sign.

    A comparison that stays at zero or is undefined for a while has a sign too: that of whether it
    holds.  Otherwise the sign is 0 there.  t is the time of the zero with which the stretch begins,
    if any, and `blur` its uncertainty.
    """

    begin: float
    end: float
    kind: float
    sign: float
    t: float
    blur: float = 0.0


@dataclass
class Watched:
    """A watched function: its last known sign, 0 if unknown, and how often its event `happened`.

    Rounding has hidden its sign over the span `touched` up to now.  `known` is the time of an event
    that came with the end of a phase.
    """

    function: EventFunction
    sign: float = 0.0
    touched: tuple[float, float] | None = None
    known: float = np.inf
    happened: int = 0


@dataclass
class EventWatch:
    """Watches event functions and keeps their events.

    If it `ends`, the event of the last function ends the run.  `events` has the first events in the
    order of time.  `grazes` has, by name, times at which a function touches zero without crossing
    it, as far as rounding shows.  `hidden` has spans in which rounding hides its sign for long.
    `lost` has times from which it changes sign too often to follow.  A condition that holds at the
    start is no event.  Events keep the first `width` numbers of a state (None: all).  `columns`
    computes columns of states that functions name.
    """

    functions: Sequence[EventFunction]
    t_end: float
    ends: bool = False
    width: int | None = None
    columns: StateColumns | None = None

    def __post_init__(self) -> None:
        self.events: list[Event] = []  # in their order, the first MOST of them
        self.grazes: dict[str, list[float]] = {}
        self.hidden: dict[str, list[tuple[float, float]]] = {}
        self.lost: dict[str, list[float]] = {}
        self.watched = [Watched(function) for function in self.functions]  # guards follow them
        self.instant = APART * abs(self.t_end)
        self.forward = -1.0 if self.t_end < 0.0 else 1.0

    @property
    def own(self) -> list[Watched]:
        """The functions that are no guards."""
        return self.watched[: len(self.functions)]

    @property
    def may_end(self) -> bool:
        """Whether an event may end the run, or a guard a phase of it."""
        return self.ends or len(self.watched) > len(self.functions)

    def counts(self, others: Sequence[Event] = ()) -> dict[str, int]:
        """Return how often each event happened, including the events in `others`."""
        counts = {each.function.name: each.happened for each in self.own}
        for event in others:
            counts[event.name] = counts.get(event.name, 0) + 1
        return counts

    def remarks(self) -> list[str]:
        """Return remarks on events that rounding hides, or whose times are uncertain."""
        for each in self.own:
            if each.touched is not None:
                self._end_touch(each, each.touched[1])
        remarks, computed = [], {x.function.name for x in self.own if x.function.computed}
        for name, times in self.grazes.items():
            limit = "rounding hides whether it passes"
            remarks.append(f"{name} touches zero at t = {_listed(times)} s: {limit}")
        for name, spans in self.hidden.items():
            texts = [f"{begin:.9g} to {end:.9g}" for begin, end in spans]
            zero = "zero or undefined" if name in computed else "zero"
            remarks.append(f"{name} is {zero} to rounding from t = {_listed(texts)} s")
        for name, times in self.lost.items():
            remarks.append(
                f"{name} passes zero too often to be followed, from t = {_listed(times)}"
            )
        blurred = [event for event in self.events if event.apart > self.instant]
        if blurred:
            worst = max(blurred, key=lambda event: event.apart)
            remarks.append(
                f"{worst.name} at t = {worst.t:.9g} s passes zero so slowly that rounding leaves "
                f"{worst.apart:.1g} s open"
                + (f", and {len(blurred) - 1} more" * (len(blurred) > 1))
            )
        if sum(each.happened for each in self.own) > MOST:
            remarks.append(f"the first {MOST} events are kept")
        return remarks

    def guard(self, guards: Sequence[EventFunction]) -> None:
        """Also watch `guards`, positive now; a change of their sign ends the leg."""
        self.watched = [*self.own, *(Watched(guard, 1.0) for guard in guards)]

    # -- along a segment ---------------------------------------------------------------------------

    @np.errstate(all="ignore")  # values may be huge, or none
    def look(self, segment: Segment) -> Passing | None:
        """Record the events along a segment; return the zero that ends it, if one does."""
        if not self.watched or not len(segment):
            return None
        parts = _parts(segment, (self.width or segment.y.shape[1]) // 2)
        changes = [self._changes(each, segment, parts) for each in self.watched]
        cut = self._cut(changes) if self.may_end else None
        until, own = None if cut is None else cut.t, range(len(self.functions))
        passed = [x for i in own for x in self._passings(i, changes[i], until, take=True)]
        passed.sort(key=lambda x: x.t * self.forward)
        passed = [x for x in passed if self._counts(x, cut)]
        counted = [x for x in passed if abs(x.t - self.watched[x.place].known) > self.instant]
        if cut is not None and cut.place >= len(self.functions):
            # the motion goes on in another mode there
            for each in self.own:
                self._end_touch(each, cut.t)
            for x in passed:
                if x.t == cut.t:
                    self.watched[x.place].sign, self.watched[x.place].known = 0.0, cut.t
        states = segment.at(np.array([x.t for x in counted])) if counted else ()
        for x, y in zip(counted, states, strict=True):
            each = self.watched[x.place]
            each.happened += 1
            if len(self.events) < MOST:
                self.events.append(Event(each.function.name, x.t, y[: self.width], x.apart))
        return cut

    def _cut(self, changes: Sequence[Sequence[Change]]) -> Passing | None:
        """Return the first zero that ends the segment; at one instant, an event before a guard."""
        own = len(self.functions)
        ending = range(own - self.ends, len(self.watched))
        each = [x for i in ending for x in self._passings(i, changes[i], None)]
        if not each:
            return None
        t = min((x.t for x in each), key=lambda t: t * self.forward)
        now = [x._replace(t=t) for x in each if (x.t - t) * self.forward <= self.instant]
        guard = next((x for x in now if x.place >= own), None)
        return next((x for x in now if x.place < own and self._counts(x, guard)), guard)

    def _counts(self, one: Passing, cut: Passing | None) -> bool:
        """Return whether a zero counts although a guard may `cut` the segment there.

        At that instant the motion may turn back or stay, which only the next segment shows.  Only a
        comparison with equality holds already at zero.
        """
        function = self.watched[one.place].function
        holds = one.sign == function.way and not function.strict
        at_end = cut is not None and cut.place >= len(self.functions) and one.t == cut.t
        return not at_end or holds

    def _passings(
        self, i: int, changes: Sequence[Change], until: float | None, take: bool = False
    ) -> list[Passing]:
        """Return the zeros of a function that count as events, up to time `until`.

        With `take`, its last sign is stored, and spans hidden by rounding are recorded.
        """
        each, passings = self.watched[i] if take else replace(self.watched[i]), list[Passing]()
        for change in changes:
            if until is not None and (change.t - until) * self.forward > self.instant:
                break
            sign, touched = change.sign, each.touched
            if not sign:
                if change.kind == UNDEFINED and self._lasts(change.begin, change.end):
                    each.sign, each.touched = 0.0, None
                elif each.sign or change.kind == HIDDEN:
                    each.touched = (touched or change)[0], change.end
                continue
            if take:
                self._end_touch(each, change.begin, grazes=sign == each.sign)
            each.touched = None
            if each.sign not in (0.0, sign):
                near = until is not None and abs(change.t - until) <= self.instant
                if each.function.way in (0, sign):
                    width = abs(touched[1] - touched[0]) if touched else 0.0
                    t = until if near and until is not None else change.t
                    passings.append(Passing(i, t, max(change.blur, width), sign))
                if near:  # whether it goes on beyond the cut the next segment tells
                    break
            each.sign = sign
        return passings

    def _end_touch(self, each: Watched, t: float, grazes: bool = False) -> None:
        """End at t the span on which rounding hides the sign of a function.

        It is recorded if it is long.  Otherwise the function may touch zero there, if it `grazes`.
        """
        span, each.touched, name = each.touched, None, each.function.name
        if span is None:
            return
        spans = self.hidden.get(name, [])
        if spans and abs(span[0] - spans[-1][1]) <= self.instant:
            spans[-1] = spans[-1][0], t  # which it goes on, as where a joint starts that was held
        elif abs(t - span[0]) > LONG * abs(self.t_end):
            self.hidden.setdefault(name, []).append((span[0], t))
        elif grazes and not (each.function.has_one_sign or each.function.computed):
            times, middle = self.grazes.setdefault(name, []), 0.5 * (span[0] + span[1])
            if not times or abs(middle - times[-1]) > self.instant:
                times.append(middle)

    def _lasts(self, begin: Any, end: Any) -> Any:
        return abs(end - begin) > self.instant

    # -- signs of one function ---------------------------------------------------------------------

    def _changes(self, each: Watched, segment: Segment, parts: Places) -> list[Change]:
        """Return the stretches of equal sign of a function, with each zero on the closed states.

        Chebyshev points decide for steps whose entry in `parts` (m,) is 1.
        """
        function = each.function
        known = (parts == 1) * 1.0
        for part in (*function.switches, function):
            known = np.where(known != 0.0, _seen(part, segment), 0.0)
        first = float(known[0])
        if first and each.sign in (0.0, first) and not each.touched and (known == first).all():
            return [Change(segment.begin, segment.end, first, first, segment.begin)]
        lost, most = self.lost.get(function.name, []), MOST_BOXES + MORE_BOXES * len(segment)
        budget = Budget(LEAST * abs(segment.end - segment.begin), most >> min(len(lost), LESS))
        stretches = signs_along(function, segment, known, parts, budget)
        if budget.spent:
            if not lost:  # a run may take long to tell it at its end
                remark = f"{function.name} passes zero too often to be followed, as at "
                warnings.warn(f"{remark}t = {segment.begin:.9g} s", RobodynWarning, stacklevel=2)
            self.lost.setdefault(function.name, []).append(segment.begin)
        # stretches of one sign in a row are one
        kind, one = stretches.kind, np.abs(stretches.kind) == 1.0
        begins = np.ones(len(kind), bool)
        begins[1:] = (kind[1:] != kind[:-1]) | ~one[1:]
        which = begins.nonzero()[0]
        ends = np.append(which[1:], len(kind))[: len(which)] - 1
        begin, end, kind = stretches.begin[which], stretches.end[ends], kind[which]
        holds = np.where((kind == UNDEFINED) | function.strict, -function.way, function.way)
        kept = (kind >= ZERO) & self._lasts(begin, end)
        sign = np.where(one[which], kind, np.where(kept, holds, 0.0))
        signed, t = sign.nonzero()[0], begin.copy()
        before = np.append(each.sign, sign[signed])[:-1]
        passes = (before != 0.0) & (before != sign[signed])
        t[signed[:1][passes[:1]]] = segment.begin
        if (turns := passes[1:].nonzero()[0]).size:
            after, to = signed[1:][turns], sign[signed[1:][turns]]
            equal = bool(function.way) and not function.strict

            def met(values: Array, k: Places) -> NDArray[np.bool_]:
                towards = values * to[k]
                return np.asarray(towards >= 0.0 if equal else towards > 0.0)

            sure = stretches.sure[ends[signed[:-1][turns]]], stretches.sure[which[after]]
            _, _, t[after] = brackets(_along(function, segment), met, *sure, begin[after])
        columns = begin, end, kind, sign, t, stretches.blur[which]
        changes = [Change(*row) for row in np.transpose(columns).tolist()]
        if segment.end == self.t_end and function.way and not function.strict:
            (last,) = function.values(segment.t[-1:], segment.at(segment.t[-1:]))
            if last == 0.0:  # it holds at the end of the run, and nothing follows
                way = float(function.way)
                changes.append(Change(segment.end, segment.end, way, way, segment.end))
        return changes


def signs_along(
    function: EventFunction,
    segment: Segment,
    known: Array,
    parts: Places,
    budget: Budget,
) -> Stretches:
    """Return stretches of equal sign of a function along a segment.

    They are cut where the function bends or jumps.  `known` (m,) has the signs that are certain on
    each whole step, or 0.  Other steps are cut into `parts` (m,) first.
    """
    begin, end = segment.t[:-1], segment.t[1:]
    if (parts > 1).any():
        step = np.repeat(np.arange(len(parts)), parts)
        part = np.arange(len(step)) + 1 - np.repeat(np.cumsum(parts) - parts, parts)
        within = begin[step] + (end - begin)[step] * (part / parts[step])
        end = np.where(part == parts[step], end[step], within)
        begin, known = np.append(begin[0], end[:-1]), known[step]
    search, sure = SignSearch(_sampled(function, segment), budget), known != 0.0
    search.take(begin[sure], end[sure], known[sure])
    begin, end = begin[~sure], end[~sure]
    for switch in function.switches:
        begin, end = _split(switch, segment, begin, end, budget)
    return search.stretches(begin, end)


def _along(part: Part, segment: Segment) -> Callable[[Array], Array]:
    """Return a function of times that gives the values of `part` along a segment."""
    return lambda t: part.values(t, segment.at(t))


def _sampled(part: Part, segment: Segment) -> Callable[[Array], tuple[Array, Array]]:
    """Return a function of times (m, nodes): the values of `part`, and bounds of their rounding."""

    def sampled(times: Array) -> tuple[Array, Array]:
        y = segment.at(times.ravel())
        values = part.values(times.ravel(), y).reshape(times.shape)
        large = segment.largest(segment.places(times[:, -1]))
        return values, part.noise(times, y.reshape(*times.shape, -1), large)

    return sampled


def _seen(part: Part, segment: Segment) -> Array:
    """Return the sign (m,) that `part` has for certain on each whole step; 0 if uncertain."""
    nodes, times = segment.nodes
    m, k, width = nodes.shape
    values = part.values(times.ravel(), nodes.reshape(-1, width)).reshape(m, k)
    off = np.maximum.reduce(part.noise(times, nodes, segment.largest(np.arange(m))), axis=1)
    ends = nodes[:, -1] != segment.y[1:, :width]
    if ends.any():
        there = part.values(segment.t[1:], segment.y[1:, :width])
        off += MISSED * np.abs(values[:, -1] - there)
    return Boxes.through(times[:, 0], times[:, -1], values, off).certain()


def _parts(segment: Segment, n: int) -> Places:
    """Return into how many parts (m,) each step is cut so that no coordinate moves far in one."""
    nodes, _ = segment.nodes
    ways = np.abs(np.diff(nodes[..., :n], axis=1)).sum(axis=1).max(axis=1, initial=0.0)
    ways = np.where(np.isfinite(ways), ways, 0.0)
    return np.minimum(MOST_PARTS, 1 + ways // FAR).astype(np.int64)


def _split(
    switch: Part, segment: Segment, begin: Array, end: Array, budget: Budget
) -> tuple[Array, Array]:
    """Cut boxes at the zeros of a switch; each cut lies between two neighbouring floats."""
    stretches = SignSearch(_sampled(switch, segment), budget).stretches(begin, end)
    shown = stretches.kind != HIDDEN  # what rounding hides is passed over
    sign, sure, at = stretches.sign[shown], stretches.sure[shown], stretches.begin[shown]
    turns = (sign[1:] != sign[:-1]).nonzero()[0]
    if not len(turns):
        return begin, end
    to = sign[turns + 1]

    def met(values: Array, k: Places) -> NDArray[np.bool_]:
        return np.asarray(np.sign(values) == to[k])

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
    texts = [t if isinstance(t, str) else f"{t:.9g}" for t in times[:TOLD]]
    return ", ".join(texts) + (", ..." if times[TOLD:] else "")
