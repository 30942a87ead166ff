"""Watches a run for events: finds each within its step, in order, and ends the run where one does.

Steps of a series are looked at together, by boxes; those where a sign may change one by one.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.events.explicit_steps import as_steps, by_stages
from robodyn.events.functions import EventFunction
from robodyn.events.pieces import Remembered, States, Step, along, signs_along
from robodyn.events.signs import Budget, Stretch, bracket
from robodyn.events.single_zeros import Places, Single, Steps, by_boxes, followed
from robodyn.events.told import EventRecord, Found, Stop
from robodyn.tables.arrays import Array

LONG = 1e-3  # of the time of a run: what rounding hides for longer is told
LESS = 7  # times at most that the work on a function is halved which cannot be followed
LEAST = 1e-17  # of a step: no times within it are told apart further


class EventWatch(EventRecord):
    """Watches functions; those of the places `stops` end the run.

    `signs` are those that functions have had; 0 where that is not yet known: what holds at the
    start is no event.
    """

    _single: Sequence[Single] = ()  # those in the step looked at
    _along: Sequence[int] = ()  # of that one of them which is looked at by itself

    def __post_init__(self) -> None:
        super().__post_init__()
        self.watched = self.functions
        self.may_end = bool(self.stops)  # whether an event may end the run, or a phase of it
        self._touched: list[tuple[float, float] | None] = [None] * len(self.signs)

    def guard(self, guards: Sequence[EventFunction]) -> None:
        """Watch these besides, which are positive now: what changes their signs ends the run."""
        own = len(self.functions)
        self.watched = [*self.functions, *guards]
        self.may_end = bool(self.stops or guards)
        self.signs = [*self.signs[:own], *(1 for _ in guards)]
        self._touched = [*self._touched[:own], *(None for _ in guards)]

    def remarks(self) -> list[str]:
        for i, touched in enumerate(self._touched):
            self._hidden_until(i, touched[1] if touched else 0.0)
        return super().remarks()

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
            told = self._hidden_until(i, stretch.begin) or function.has_one_sign
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
