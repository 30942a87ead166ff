"""Watches a run for events: finds each within its step, in order, and ends the run where one does.

Steps of a series are looked at together, by boxes; those where a sign may change one by one.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, overload

import numpy as np

from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.events.functions import EventFunction
from robodyn.events.pieces import Remembered, States, Step, along, as_steps, by_stages, signs_along
from robodyn.events.single_zeros import (
    Budget,
    Places,
    Single,
    Steps,
    Stretch,
    bracket,
    by_boxes,
    followed,
)
from robodyn.events.state_columns import StateColumns
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr

APART = 1e-12  # of the time of a run: what is nearer in time happens at one instant
MOST = 1_000_000  # events that are kept
TOLD = 5  # times that a remark names
LONG = 1e-3  # of the time of a run: what rounding hides for longer is told
LESS = 7  # times at most that the work on a function is halved which cannot be followed
LEAST = 1e-17  # of a step: no times within it are told apart further


@short_repr
class Event(NamedTuple):
    """What happened when, and the state y = (q, qd) there; its time may be off by `apart`, s."""

    name: str
    t: float
    y: Array
    apart: float = 0.0


_event = partial(tuple.__new__, Event)  # of its parts: faster than Event._make, which is Python


class Events(Sequence[Event]):
    """The events of a run in their order, the first MOST of them; made when one is asked for."""

    def __init__(self, record: EventWatch) -> None:
        self._record = record

    def __len__(self) -> int:
        return min(sum(self._record.happened), MOST)

    @overload
    def __getitem__(self, i: int) -> Event: ...

    @overload
    def __getitem__(self, i: slice) -> list[Event]: ...

    def __getitem__(self, i: int | slice) -> Event | list[Event]:
        return self._record.made()[i]

    def __iter__(self) -> Iterator[Event]:
        return iter(self._record.made())

    def __eq__(self, other: object) -> bool:
        return self._record.made() == (list(other) if isinstance(other, Events) else other)

    def __repr__(self) -> str:
        return repr(self._record.made())


class Stop(NamedTuple):
    """The event that ends a run, of which function, and the whole state (N,) there."""

    place: int
    t: float
    y: Array


class Found(NamedTuple):
    """What is found along steps: rows of function, time, apart, sign, state; signs at the end."""

    zeros: Array
    signs: list[int]


@dataclass
class EventWatch:
    """Watches functions and keeps their events; those of the places `stops` end the run.

    `grazes` has, by name, the times at which a function touches zero as far as rounding tells,
    without passing it; `hidden` from when to when it is zero so for long; `lost` where it changes
    sign too often to be followed.  Events keep the first `width` numbers of a state; None: all.
    `columns` are those of states that functions name.
    `signs` are those that functions have had; 0 where that is not yet known: what holds at the
    start is no event.
    """

    functions: Sequence[EventFunction]
    t_end: float
    stops: frozenset[int] = frozenset()
    width: int | None = None
    columns: StateColumns | None = None

    def __post_init__(self) -> None:
        self.kept: list[Event] = []
        self.grazes: dict[str, list[float]] = {}
        self.hidden: dict[str, list[tuple[float, float]]] = {}
        self.lost: dict[str, list[float]] = {}
        self.happened = [0] * len(self.functions)
        self.signs = self.happened.copy()
        self.packed: list[Array] = []  # zeros, as in `Found`, not yet among those kept
        self.cut: dict[int, float] = {}  # when a function's event came with the end of a phase
        self.length = abs(self.t_end)
        self.instant = APART * self.length
        self.watched = self.functions
        self.may_end = bool(self.stops)  # whether an event may end the run, or a phase of it
        self._touched: list[tuple[float, float] | None] = [None] * len(self.signs)
        self._single: Sequence[Single] = ()  # those in the step looked at
        self._along: Sequence[int] = ()  # of that one of them which is looked at by itself

    def take(self, found: Found) -> None:
        """Take what was found along some steps."""
        zeros, functions = found.zeros, self.functions
        self.signs = found.signs
        if not len(zeros):
            return
        if len(functions) > 1 or functions[0].way:
            places = zeros[:, 0].astype(np.int64)
            counts = np.array([function.way for function in functions])[places] * zeros[:, 3] >= 0.0
            zeros = zeros[counts]
            zeros = zeros[np.argsort(np.abs(zeros[:, 1]), kind="stable")]
            for i in places[counts].tolist():
                self.happened[i] += 1
        else:
            self.happened[0] += len(zeros)
        if sum(self.happened) - len(zeros) < MOST:
            self.packed.append(zeros)

    @property
    def found(self) -> Events:
        """The events in their order, the first MOST of them."""
        return Events(self)

    def made(self) -> list[Event]:
        """The events; those found together become some now: that takes as long as finding them."""
        if self.packed:
            packed, self.packed = self.packed, []
            for zeros in packed:
                names = [self.functions[i].name for i in zeros[:, 0].astype(np.int64).tolist()]
                parts = names, zeros[:, 1].tolist(), zeros[:, 4:], zeros[:, 2].tolist()
                self.kept.extend(map(_event, zip(*parts, strict=True)))
            del self.kept[MOST:]
        return self.kept

    def tell(self, one: Single) -> None:
        """A function passes zero: an event, where this way counts and it is not known."""
        kept, i, t = self.made(), one.place, one.t
        if self.functions[i].way in (0, one.sign) and (
            abs(t - self.cut.get(i, np.inf)) > self.instant
        ):
            self.happened[i] += 1
            if len(kept) < MOST:
                kept.append(Event(self.functions[i].name, t, one.y[: self.width], one.apart))

    def graze(self, name: str, t: float) -> None:
        """A function touches zero."""
        times = self.grazes.setdefault(name, [])
        if not times or abs(t - times[-1]) > self.instant:
            times.append(t)

    def counts(self, others: Sequence[Event] = ()) -> dict[str, int]:
        """How often each event happened, and each of some others."""
        pairs = zip(self.functions, self.happened, strict=True)
        counts = {function.name: count for function, count in pairs}
        for event in others:
            counts[event.name] = counts.get(event.name, 0) + 1
        return counts

    def remarks(self) -> list[str]:
        """What is to be said of events that rounding hides, or whose times are not sharp."""
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
        blurred = [event for event in self.made() if event.apart > self.instant]
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
        """Watch these besides, which are positive now: what changes their signs ends the run."""
        own = len(self.functions)
        self.watched = [*self.functions, *guards]
        self.may_end = bool(self.stops or guards)
        self.signs = [*self.signs[:own], *(1 for _ in guards)]
        self._touched = [*self._touched[:own], *(None for _ in guards)]

    @np.errstate(all="ignore")  # values may be huge, or none
    def series(
        self,
        times: Array,
        boxes: Array,
        sampled: Callable[[Places], Array],
        ends: Array,
        step: Callable[[int], Step],
        exact: bool,
        within: Callable[[Places, Array], Array],
    ) -> tuple[int, Stop] | None:
        """Steps from times[j] to times[j + 1], in which the state stays in boxes (m, 2, N).

        Those are their middles and how far they reach.  `sampled` has, of steps by their places,
        the states (k, nodes, N) at Chebyshev's points, `ends` (m, N) are those at their ends,
        brought back onto closures; `step(j)` has one whole, which has the same states where they
        are `exact`; `within` are the states (k, 2n or more) at a time within each of some steps.
        Tells in which of them the run ends, and how.
        """
        box = times[:-1], times[1:], boxes[:, 0], boxes[:, 1]
        known = [by_boxes(function, *box) for function in self.watched]
        unknown = np.zeros(len(boxes), bool)
        for signs in known:
            unknown |= signs == 0.0
        left = unknown.nonzero()[0]
        nodes = sampled(left) if len(left) else np.zeros(0)

        def steps(at: Places) -> Steps:
            there = nodes if len(at) == len(left) else nodes[np.searchsorted(left, at)]
            last = None if exact else ends[at, None]
            return Steps(times[at], times[at + 1], there, last, lambda i, t: within(at[i], t))

        doubtful = self._doubtful(known, steps)
        for j in sorted({*doubtful, *self._found_in}):
            places = self.begin(j, doubtful.get(j, ()))
            if not places:
                continue
            whole = step(j)
            if exact and unknown[j]:
                whole = whole._replace(nodes=nodes[np.searchsorted(left, j)])
            stop = self.step(whole, places)
            if stop is not None:
                return j, stop
        self.seen()
        return None

    def _doubtful(
        self, known: Sequence[Array], steps: Callable[[Places], Steps]
    ) -> dict[int, list[int]]:
        """Which functions are to be looked at by themselves, by step.

        `known` are their signs (m,) along steps, 0 where they may change.  What passes zero once is
        found here, but for what ends the run.
        """
        self._ahead, self._after = list(known), list(known)  # at the begin of steps, and their ends
        self._found_in: dict[int, list[Single]] = {}  # by step, what needs no look at it by itself
        doubtful: dict[int, list[int]] = {}
        found: list[tuple[Places, Array]] = []
        for i, signs in enumerate(known):
            before, touched = self.signs[i], self._touched[i] is not None
            one = before or int(signs[0])  # sign all along
            if not touched and one and np.count_nonzero(signs == one) == len(signs):
                continue
            tells = i < len(self.functions) and i not in self.stops
            way = followed(i, self.watched[i], signs, before, steps, tells)
            self._ahead[i], self._after[i] = way.first, way.last
            slow, places, rows = way.slow.tolist(), way.places, way.rows
            if touched:
                slow = [0, *(j for j in slow if j)]
                places, rows = places[places > 0], rows[places > 0]
            if len(places):
                found.append((places, rows))
            for j in slow:
                doubtful.setdefault(j, []).append(i)
        if found and not doubtful and not self.cut:
            last = [int(signs[-1]) for signs in self._after]
            self.take(Found(np.concatenate([rows for _, rows in found]), last))
            return doubtful
        for places, rows in found:
            for j, (place, t, apart, sign, *_), row in zip(
                places.tolist(), rows.tolist(), rows, strict=True
            ):
                single = Single(int(place), t, apart, int(sign), row[4:])
                self._found_in.setdefault(j, []).append(single)
        return doubtful

    @np.errstate(all="ignore")
    def near(self, steps: Sequence[Any]) -> dict[int, list[int]]:
        """For steps of an explicit method, which functions are to be looked at in each of them.

        Those that hold zeros found already are among them.
        """
        known = by_stages(self.watched, steps)
        doubtful = self._doubtful(known, lambda at: as_steps([steps[j] for j in at]))
        return {j: [] for j in self._found_in} | doubtful

    def begin(self, j: int, places: Sequence[int]) -> list[int]:
        """Know the signs at the start of step j of those looked at together.

        Tells at which places the step itself is to be looked at: where a sign is not known, or not
        that of before.
        """
        for i in places:
            if j and self._after[i][j - 1]:
                self.signs[i] = int(self._after[i][j - 1])
        places = [i for i in places if not self._goes_on(i, self._all_along(i, j))]
        self._single = self._found_in.pop(j, ())
        if places:
            self._along = [int(after[j]) for after in self._after]
            return places
        for single in sorted(self._single, key=lambda each: abs(each.t)):
            self.tell(single)
        return places

    def _all_along(self, i: int, j: int) -> int:
        """The sign that a function keeps in step j, 0 where that is not known."""
        sign = int(self._after[i][j])
        return sign if sign == self._ahead[i][j] else 0

    def _goes_on(self, i: int, sign: int) -> bool:
        """Whether nothing happens where a function has a sign for certain."""
        return sign != 0 and self.signs[i] in (0, sign) and self._touched[i] is None

    def seen(self) -> None:
        """Know the signs at the end of the steps looked at together."""
        for i, signs in enumerate(self._after):
            if signs[-1]:
                self.signs[i] = int(signs[-1])

    @np.errstate(all="ignore")
    def step(self, step: Step, places: Sequence[int] | None = None) -> Stop | None:
        """Look at one step, for the functions at `places`."""
        passed: list[Single] = []
        states = Remembered(step)
        self._signs_from: dict[int, list[tuple[float, int]]] = {}  # along the step
        for one in self._single:
            self._signs_from[one.place] = [(step.begin, -one.sign), (one.t, one.sign)]
            passed.append(one)
        self._single = ()
        for i in range(len(self.watched)) if places is None else places:
            passed += self._crossings(i, step, states)
        if not passed:
            return None
        forward = 1.0 if step.end > step.begin else -1.0
        passed.sort(key=lambda each: each.t * forward)
        own, cut = len(self.functions), None
        may = (each for each in passed if each.place in self.stops or each.place >= own)
        ends = next(may, None)
        if ends is not None:
            passed = [
                each if (ends.t - each.t) * forward > self.instant else each._replace(t=ends.t)
                for each in passed
                if (each.t - ends.t) * forward <= self.instant
            ]
            cut = next((each for each in passed if each.place >= own), None)
            # of what happens at one instant the end of the run comes first
            stops = (each for each in passed if each.place in self.stops)
            ends = next((each for each in stops if self._passes(each, cut)), cut)
        for each in passed:
            if each.place < own and self._passes(each, cut):
                self.tell(each if each.y is not None else each._replace(y=states.at(each.t)))
        if ends is None:
            return None
        if ends.place >= own:
            self._end_phase(ends.t, passed, forward)
        return Stop(ends.place, ends.t, states.at(ends.t))

    def _end_phase(self, t: float, passed: Sequence[Single], forward: float) -> None:
        """Know the signs at t, where the motion goes on in another way than the step has it.

        What passes zero at this instant has its sign before, or, where that is told, any.
        """
        for i, sign in enumerate(self._along):
            self.signs[i] = sign or self.signs[i]
        for i, signs in self._signs_from.items():
            before = [x for at, x in signs if (t - at) * forward > self.instant]
            self.signs[i] = before[-1] if before else signs[0][1]
            self._hidden_until(i, t)
        for each in passed:
            if each.t == t and self._passes(each, each):
                self.signs[each.place], self.cut[each.place] = 0, t

    def _passes(self, one: Single, cut: Single | None) -> bool:
        """Whether a function passes zero where it does so along a step that a phase may `cut`.

        At that instant the motion may turn back, or stay: the next step tells, but where `>=`
        holds at zero.
        """
        function = self.watched[one.place]
        holds = one.sign == function.way and not function.strict
        return cut is None or one.t != cut.t or holds

    def _crossings(self, i: int, step: Step, states: States) -> list[Single]:
        """Where a function passes zero in the way that counts, the states not yet known."""
        function, budget = self.watched[i], Budget(LEAST * abs(step.end - step.begin))
        budget.left >>= min(len(self.lost.get(function.name, ())), LESS)
        found: list[Single] = []
        before: Stretch | None = None
        known = self._signs_from[i] = [(step.begin, self.signs[i])]
        for stretch in signs_along(function, step.begin, step.end, states, budget):
            sign = self._sign(function, stretch)
            if not sign:
                self._hidden(i, stretch)
                continue
            touched = self._touched[i]
            told = (
                self._hidden_until(i, stretch.begin) or function.has_one_sign or function.computed
            )
            if self.signs[i] not in (0, sign):
                if function.way in (0, sign):
                    t = step.begin
                    if before is not None:
                        t = self._passed(function, sign, before, stretch, states)
                    width = abs(touched[1] - touched[0]) if touched else 0.0
                    found.append(Single(i, t, max(stretch.blur, width), sign))
            elif touched and self.signs[i] and i < len(self.functions) and not told:
                self.graze(function.name, touched[0])
            self.signs[i], before = sign, stretch
            known.append((stretch.begin, sign))
        if budget.spent:
            if function.name not in self.lost:  # a run may take long to tell it at its end
                remark = f"{function.name} passes zero too often to be followed, as at "
                warnings.warn(f"{remark}t = {step.begin:.9g} s", RobodynWarning, stacklevel=2)
            self.lost.setdefault(function.name, []).append(step.begin)
        return found

    def _sign(self, function: EventFunction, stretch: Stretch) -> int:
        """Its sign; where a comparison stays at zero, or is not defined, whether it holds."""
        if stretch.sign or not function.way or not self._lasts(stretch):
            return stretch.sign
        return -function.way if function.strict or not stretch.defined else function.way

    def _lasts(self, stretch: Stretch) -> bool:
        return stretch.stays and abs(stretch.end - stretch.begin) > self.instant

    def _hidden(self, i: int, stretch: Stretch) -> None:
        if not stretch.defined and self._lasts(stretch):
            self.signs[i], self._touched[i] = 0, None
        elif self.signs[i] or not stretch.stays:
            begin = self._touched[i] or (stretch.begin, stretch.end)
            self._touched[i] = begin[0], stretch.end

    def _hidden_until(self, i: int, t: float) -> bool:
        """Rounding hides a function no longer; tells whether that was long enough to be told."""
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

    def _passed(
        self, function: EventFunction, sign: int, before: Stretch, after: Stretch, states: States
    ) -> float:
        """The time between two stretches from which a function has the sign of the later one."""
        f = along(function, states)

        def met(values: Array) -> Any:
            if function.way and not function.strict:
                return values * sign >= 0.0
            return values * sign > 0.0

        return bracket(f, met, before.sure, after.sure, after.begin)[2]


def _listed(times: Sequence[float | str]) -> str:
    told = [t if isinstance(t, str) else f"{t:.9g}" for t in times[:TOLD]]
    return ", ".join(told) + (", ..." if times[TOLD:] else "")
