"""Events of a run, and what is to be said of those that rounding hides or blurs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, overload

import numpy as np

from robodyn.events.functions import EventFunction
from robodyn.events.single_zeros import Single
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr

APART = 1e-12  # of the time of a run: what is nearer in time happens at one instant
MOST = 1_000_000  # events that are kept
TOLD = 5  # times that a remark names


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

    def __init__(self, record: EventRecord) -> None:
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
class EventRecord:
    """The events of functions; those of the places `stops` end the run.

    `grazes` has, by name, the times at which a function touches zero as far as rounding tells,
    without passing it; `hidden` from when to when it is zero so for long; `lost` where it changes
    sign too often to be followed.  Events keep the first `width` numbers of a state; None: all.
    """

    functions: Sequence[EventFunction]
    t_end: float
    stops: frozenset[int] = frozenset()
    width: int | None = None

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


def _listed(times: Sequence[float | str]) -> str:
    told = [t if isinstance(t, str) else f"{t:.9g}" for t in times[:TOLD]]
    return ", ".join(told) + (", ..." if times[TOLD:] else "")
