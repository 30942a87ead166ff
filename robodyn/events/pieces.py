"""The signs of an event's function along a step, cut where it bends or jumps.

The states within a step of an explicit Runge-Kutta method come from its stages alone.  RK45
interpolates by these itself.  DOP853 needs further stages, a quarter of a step's cost; the
polynomial here, of degree 5, has the slopes of five of its stages and is right to some digits less.
Each comes with a second one that is further off, so that the difference of the two tells how far a
function of the states may be off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from robodyn.events.functions import EventFunction, Part
from robodyn.events.single_zeros import (
    MARGIN,
    NODES,
    Budget,
    Function,
    Places,
    Sampled,
    Steps,
    Stretch,
    bracket,
    certain,
    node_times,
    stretches,
)
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


MOVED = ("t", "t_old", "y", "y_old", "f", "h_previous")  # of a solver, by a step
STAGES = [0, 7, 8, 10, 12]  # of DOP853, those of high order; 12 is the end
AT = (0.0, 0.3076923076923077, 0.6512820512820513, 0.8571428571428571, 1.0)
HERMITE: Array = np.stack(
    [
        (1.0 + 2.0 * NODES) * (1.0 - NODES) ** 2,
        NODES**2 * (3.0 - 2.0 * NODES),
        NODES * (1.0 - NODES) ** 2,
        NODES**2 * (NODES - 1.0),
    ],
    axis=1,
)
BLEND: Array = NODES**2 * (3.0 - 2.0 * NODES)


def _by_stages() -> Array:
    """What makes y - y_0 (rows: nodes), less h, of the slopes of the stages (columns)."""
    powers = np.arange(len(AT))
    basis = np.linalg.inv(np.array(AT)[:, None] ** powers)  # coefficients (rows) of each slope
    return np.asarray((NODES[:, None] ** (powers + 1.0) / (powers + 1.0)) @ basis)


BY_STAGES: Array = _by_stages()


@lru_cache(maxsize=8)
def _powers(order: int) -> Array:
    """Powers of the nodes, that a method's own interpolation has the coefficients of."""
    return np.asarray(NODES[:, None] ** np.arange(1.0, order + 1.0))


class KeptStep:
    """What a step of an explicit solver leaves, kept while the solver goes on."""

    __slots__ = ("K", "f", "h_previous", "nfev", "solver", "status", "t", "t_old", "y", "y_old")

    def __init__(self, solver: Any) -> None:
        # one by one: there are as many of these as steps
        self.solver, self.K = solver, solver.K.copy()
        self.t, self.t_old, self.h_previous = solver.t, solver.t_old, solver.h_previous
        self.y, self.y_old, self.f = solver.y, solver.y_old, solver.f
        self.nfev, self.status = solver.nfev, solver.status

    def dense_output(self) -> Any:
        """The solver's own, of this step: the solver goes back to it for that."""
        solver: Any = self.solver
        now = {name: getattr(solver, name) for name in MOVED}
        stages = solver.K.copy()
        try:
            for name in MOVED:
                setattr(solver, name, getattr(self, name))
            solver.K[:] = self.K
            return solver.dense_output()
        finally:
            for name, value in now.items():
                setattr(solver, name, value)
            solver.K[:] = stages


def as_steps(steps: Sequence[Any]) -> Steps:
    """Steps as they are looked at together: by guesses, and then by the solver's own states."""
    nodes, other = two_guesses(steps)
    begin, end = (np.array([getattr(step, name) for step in steps]) for name in ("t_old", "t"))
    made: dict[int, Any] = {}

    def states(places: Places, t: Array) -> Array:
        for j in places.tolist():
            if j not in made:
                made[j] = steps[j].dense_output()
        dense = [made[j] for j in places.tolist()]
        if any(type(each).__name__ != "Dop853DenseOutput" for each in dense):
            return np.array([each(at) for each, at in zip(dense, t, strict=True)])
        x = ((t - begin[places]) / (end - begin)[places])[:, None]
        powers = np.array([each.F for each in dense])
        found = powers[:, -1] * x
        for i in range(1, powers.shape[1]):  # as each of them does by itself
            found = (found + powers[:, -1 - i]) * (1.0 - x if i % 2 else x)
        return np.asarray(found + np.array([each.y_old for each in dense]))

    return Steps(begin, end, nodes, other, states)


def two_guesses(steps: Sequence[Any]) -> Array:
    """The states (2, m, nodes, N) at Chebyshev's points of steps, twice; the first is better."""
    h = np.array([step.h_previous for step in steps])[:, None, None]
    first, last = (np.array([getattr(step, name) for step in steps]) for name in ("y_old", "y"))
    K = np.array([step.K for step in steps])
    both = np.empty((2, len(steps), len(NODES), first.shape[1]))
    P = getattr(steps[0], "solver", steps[0]).P
    if isinstance(P, np.ndarray):
        both[1] = first[:, None] + h * (_powers(P.shape[1]) @ (P.T @ K))
        both[0] = both[1]
    else:
        f = np.array([step.f for step in steps])
        ends = np.stack([first, last, h[:, 0] * K[:, 0], h[:, 0] * f], axis=1)
        both[1] = HERMITE @ ends
        both[0] = first[:, None] + h * (BY_STAGES @ K[:, STAGES])
    both[0] += BLEND[:, None] * (last - both[0, :, -1])[:, None]
    return both


def by_stages(functions: Sequence[EventFunction], steps: Sequence[Any]) -> list[Array]:
    """The signs (m,) of each function along m steps of an explicit method."""
    both, m = two_guesses(steps), len(steps)
    begin = np.array([step.t_old for step in steps])
    at = node_times(begin, begin + np.array([step.h_previous for step in steps])).ravel()
    at, y = np.concatenate([at, at]), both.reshape(-1, both.shape[-1])
    found = []
    for function in functions:
        known = np.ones(m)
        for part in (*function.switches, function):
            better, worse = part.values(at, y).reshape(2, m, -1)
            noise = np.abs(better - worse).max(axis=1)
            noise += MARGIN * np.abs(better).max(axis=1)
            known = np.where(known, certain(better, noise), 0)
        found.append(known)
    return found
