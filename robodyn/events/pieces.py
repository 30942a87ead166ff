"""The signs of an event's function along a step, cut where it bends or jumps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from robodyn.events.functions import EventFunction, Part
from robodyn.events.signs import NODES, Budget, Function, Sampled, Stretch, bracket, stretches
from robodyn.tables.arrays import Array

States = Callable[[Array], Array]  # those (k, N) at times (k,) within a step


def along(part: Part, states: States) -> Function:
    """The values of a function at times within a step."""
    return lambda t: part.values(t, states(t))


class Step(NamedTuple):
    """A step: its ends, the state at its end, and the states within it.

    `nodes` (k, 2n or more) are those at Chebyshev's points, where they are known.
    """

    begin: float
    end: float
    y: Array
    states: States
    nodes: Array | None = None


class Remembered:
    """States within a step, kept: functions of an event are asked at the same times."""

    def __init__(self, step: Step) -> None:
        self.step, self.asked = step, dict[bytes, tuple[Array, Array]]()
        if step.nodes is not None:
            times = step.begin + (step.end - step.begin) * NODES
            times[-1] = step.end
            self.asked[times.tobytes()] = times[:0], step.nodes  # not whole states

    def __call__(self, t: Array) -> Array:
        key = t.tobytes()
        if key not in self.asked:
            if len(self.asked) > 64:
                self.asked.clear()
            self.asked[key] = t, self.step.states(t)
        return self.asked[key][1]

    def at(self, t: float) -> Array:
        """The state (N,) at one time, mostly one that was asked for."""
        if t == self.step.end:
            return self.step.y
        for times, rows in reversed(self.asked.values()):
            there = (times == t).nonzero()[0]
            if len(there):
                return np.asarray(rows[there[0]])
        return np.asarray(self(np.array([t]))[0])


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
