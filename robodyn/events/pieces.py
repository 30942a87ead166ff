"""The signs of an event's function along a step, cut where it bends or jumps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.events.functions import EventFunction, Part
from robodyn.events.signs import Budget, Function, Sampled, Stretch, bracket, stretches

Array = NDArray[np.float64]
States = Callable[[Array], Array]  # those (k, N) at times (k,) within a step


def along(part: Part, states: States) -> Function:
    """The values of a function at times within a step."""
    return lambda t: part.values(t, states(t))


def remembered(states: States) -> States:
    """The same, which keeps the last answers: functions of an event are asked at the same times."""
    kept: dict[bytes, Array] = {}

    def found(t: Array) -> Array:
        key = t.tobytes()
        if key not in kept:
            if len(kept) > 64:
                kept.clear()
            kept[key] = states(t)
        return kept[key]

    return found


def signs_along(
    function: EventFunction, begin: float, end: float, states: States, budget: Budget
) -> Iterator[Stretch]:
    """The signs of a function from `begin` to `end`, in order."""
    pieces = [(begin, end)]
    for switch in function.switches:
        pieces = [cut for piece in pieces for cut in _cut(switch, *piece, states, budget)]
    for piece in pieces:
        yield from stretches(_sampled(function, states), *piece, budget)


def _sampled(part: Part, states: States) -> Sampled:
    def sampled(t: Array) -> tuple[Array, Array]:
        y = states(t)
        return part.values(t, y), part.noise(t, y)

    return sampled


def _cut(
    switch: Part, begin: float, end: float, states: States, budget: Budget
) -> Iterator[tuple[float, float]]:
    """A piece, cut where a switch passes zero: each cut lies between two neighbours."""
    before: Stretch | None = None
    for stretch in stretches(_sampled(switch, states), begin, end, budget):
        if not (stretch.sign or stretch.stays):  # hidden by rounding
            continue
        if before is not None and stretch.sign != before.sign:
            sign = stretch.sign

            def met(values: Array, sign: int = sign) -> Any:
                return np.sign(values) == sign

            ends = before.sure, stretch.sure
            low, high, _ = bracket(along(switch, states), met, *ends, stretch.begin)
            if low != begin:
                yield begin, low
            begin = high
        before = stretch
    if begin != end:
        yield begin, end
