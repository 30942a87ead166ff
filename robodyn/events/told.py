"""Events of a run, and what is to be said of those that rounding hides or blurs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.tables.short_repr import short_repr

if TYPE_CHECKING:
    from robodyn.events.watch import EventWatch

Array = NDArray[np.float64]

TOLD = 5  # times that a remark names


@short_repr
class Event(NamedTuple):
    """What happened when, and the state y = (q, qd) there; its time may be off by `apart`, s."""

    name: str
    t: float
    y: Array
    apart: float = 0.0


class Stop(NamedTuple):
    """The event that ends a run, of which function, and the whole state (N,) there."""

    place: int
    t: float
    y: Array


def remarks(watch: EventWatch) -> list[str]:
    """Of a run's events, a sentence each."""
    found = []
    for name, times in watch.grazes.items():
        limit = "rounding hides whether it passes"
        found.append(f"{name} touches zero at t = {_listed(times)} s: {limit}")
    for name, spans in watch.hidden.items():
        told = [f"{begin:.9g} to {end:.9g}" for begin, end in spans]
        found.append(f"{name} is zero to rounding from t = {_listed(told)} s")
    for name, times in watch.lost.items():
        found.append(f"{name} passes zero too often to be followed, from t = {_listed(times)}")
    blurred = [event for event in watch.found if event.apart > watch.instant]
    if blurred:
        worst = max(blurred, key=lambda event: event.apart)
        found.append(
            f"{worst.name} at t = {worst.t:.9g} s passes zero so slowly that rounding leaves "
            f"{worst.apart:.1g} s open" + (f", and {len(blurred) - 1} more" * (len(blurred) > 1))
        )
    if sum(watch.happened) > len(watch.found):
        found.append(f"the first {len(watch.found)} events are kept")
    return found


def _listed(times: Sequence[float | str]) -> str:
    told = [t if isinstance(t, str) else f"{t:.9g}" for t in times[:TOLD]]
    return ", ".join(told) + (", ..." if times[TOLD:] else "")
