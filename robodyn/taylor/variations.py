"""Sensitivities along the steps of the Taylor series: the series of the variational equations.

A step's series are functions of the state that it begins in, and of the numbers of the scene.
Their tangents by these are the series of d(q, qd)/dp, by the same recurrences.  The motion comes
first, and its steps are those of a run without them; then each step is gone once more, with its
tangents: in machine code (`engines/machine_variation.py`) or in Python (`varied_steps.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import accumulate
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from robodyn.engines.expansion import MotionProgram
from robodyn.errors import RobodynError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.program import Program
from robodyn.mechanics.torque_rows import linear_piece
from robodyn.tables.arrays import Array
from robodyn.taylor import Chunk
from robodyn.taylor.compiled import CompiledEngine
from robodyn.taylor.varied_steps import Along, Group, Steps, straight_steps

# orders of their series more than those of a closed chain's steps: next to where the chain is
# singular their errors fall by 14
MORE = 4
TOGETHER = 4  # names of which one call of machine code makes the tangents


class Number(NamedTuple):
    """What a motion is differentiated by: the mechanism with that number as a formula.

    `numbers` gives what its rows take, and their slopes by it.
    """

    mechanism: Mechanism
    numbers: Callable[[Program], tuple[list[float], list[float]]]


class Variations:
    """d(q, qd)/d(names) along the steps of one run, under torques that have a series.

    s (k, 2n) are those where the last steps ended.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        actuation: Actuation,
        numbers: Sequence[Number],
        s: Array,
        control: Any = None,
    ) -> None:
        self.mechanism, self.actuation = mechanism, actuation
        self.numbers, self.s, self.control = numbers, s, control
        self._torques = actuation.function(mechanism.n)
        self._driven = np.array(mechanism.actuated, int)
        self._made: dict[object, Any] = {}
        if actuation.constants is not None:
            self._made = _kept(mechanism, actuation.constants, tuple(numbers))

    def along(
        self,
        t: float,
        y: Array,
        chunk: Chunk,
        engine: CompiledEngine,
        within: Callable[[Array], Array],
    ) -> tuple[Chunk, Callable[[Array], Array]]:
        """The chunk from (t, y) with s in its states, and what has so `within` its last step.

        `engine` made it.  Their series fall more slowly than its own, and have more orders.
        """
        count, wide, s = len(chunk.t), 2 * self.mechanism.n, self.s
        if not count:
            return chunk, within
        begins, states = np.empty(count), np.empty((count, wide))
        begins[0], begins[1:] = t, chunk.t[:-1]
        states[0], states[1:] = y[:wide], chunk.y[:-1, :wide]
        torques = self._acting(t, y, float(chunk.t[-1]))
        held = None if self.actuation.pieces is None else self.actuation.pieces.at(t)
        order = engine.order + (MORE if self.mechanism.rows else 0)
        key = held, order
        if key not in self._made:
            groups = self._groups(held)
            self._made[key] = [(group.places, _compiled(order, group)) for group in groups]
        parts = self._made[key]
        at_ends, at_rows = _every(parts, (begins, chunk.t, states, chunk.row_t), torques, s)
        self.s = at_ends[-1]
        if not np.isfinite(self.s).all():
            raise RobodynError(
                "sensitivity", value=f"at t = {chunk.t[-1]:.6g} s", limit="not finite"
            )

        def both(times: Array) -> Array:
            only = begins[-1:], chunk.t[-1:], states[-1:], times
            before = s if count == 1 else at_ends[-2]
            return self.joined(within(times), _every(parts, only, torques, before)[1])

        y, rows = self.joined(chunk.y, at_ends), self.joined(chunk.row_y, at_rows)
        return chunk._replace(y=y, row_y=rows), both

    def _acting(self, t: float, y: Array, end: float) -> tuple[Any, Any, Array]:
        """The torques at t, their slopes up to `end`, and what a controller changes them by."""
        n, given, state = self.mechanism.n, self.actuation, y.tolist()
        if given.constants is not None or not given.linear:
            return (), (), np.zeros((len(self.s), 0))
        fed = np.zeros((len(self.s), n))  # for each name
        if self.control is None:
            return *linear_piece(given, self._torques, t, state, end - t), fed
        at = 0.5 * (t + end)  # the torques are held, and so is what they change by
        fed[:, self._driven] = np.array(self.control.slopes_at(at)).reshape(len(fed), -1)
        return self._torques(at, state), [0.0] * n, fed

    def joined(self, y: Array, s: Array) -> Array:
        """States (m, 2n or 2n + 1) with s (m, k, 2n) before the work done."""
        middle = 2 * self.mechanism.n
        return np.concatenate(
            [y[:, :middle], s.reshape(len(y), self.s.size), y[:, middle:]], axis=1
        )

    def both(self, y: Array) -> Array:
        """The state (2n or 2n + 1) where the last steps ended, with s."""
        found: Array = self.joined(y[None], self.s[None])[0]
        return found

    def _groups(self, held: Sequence[float] | None) -> list[Group]:
        found: dict[object, Group] = {}
        for place, (mechanism, numbers) in enumerate(self.numbers):
            motion = MotionProgram(mechanism, self.actuation, False, held)
            values, slopes = numbers(motion.program)
            motion.mechanism, motion.program.numbers = self.mechanism, values
            motion.program.arms = dict.fromkeys(motion.program.arms, 1.0)  # no step is chosen
            key = motion.program.shape, tuple(values)
            group = found.setdefault(key, Group([], motion, values, []))
            group.places.append(place)
            group.slopes.append(slopes)
        return [
            Group(x.places[i : i + TOGETHER], x.motion, x.numbers, x.slopes[i : i + TOGETHER])
            for x in found.values()
            for i in range(0, len(x.places), TOGETHER)
        ]


def _every(
    parts: Sequence[tuple[list[int], Along]], steps: Steps, torques: Any, s: Array
) -> tuple[Array, Array]:
    """s of all groups at the ends of steps (m, k, 2n), and at their rows."""
    if len(parts) == 1:
        return parts[0][1](steps, torques, s)
    found = [np.empty((len(times), *s.shape)) for times in (steps[1], steps[3])]
    values, slopes, fed = torques
    for where, go in parts:
        found[0][:, where], found[1][:, where] = go(steps, (values, slopes, fed[where]), s[where])
    return found[0], found[1]


@lru_cache(maxsize=64)
def _kept(*given: object) -> dict[object, Any]:
    """What is made for runs under constant torques, for runs to come."""
    return {}


def variations_of(mechanism: Mechanism, actuation: Actuation, y: Array) -> tuple[Variations, Array]:
    """Those that torques carry in the state y, and the state without."""
    assert actuation.alone is not None
    first, last = 2 * mechanism.n, 2 * mechanism.n + actuation.states
    s = y[first:last].reshape(-1, first).copy()
    numbers = actuation.by(actuation.modes.mode if actuation.modes else None)
    found = Variations(mechanism, actuation.alone, numbers, s, actuation.control)
    return found, np.concatenate([y[:first], y[last:]])


def _compiled(order: int, group: Group) -> Along:
    """In machine code, a name in each lane; as text where there is none."""
    from robodyn.engines.machine_motion import aligned
    from robodyn.engines.machine_variation import TABLE, VariedScene, compile

    lanes = 1 if len(group.places) == 1 else 2 if len(group.places) == 2 else TOGETHER
    scene = VariedScene(order, group.motion, group.varied)
    code = compile(scene, lanes)
    if code is None:
        return straight_steps(order, group)
    block = aligned(code.items * lanes)
    items = block.reshape(-1, lanes)
    scene.fill(items, 1.0, 1.0)
    place, n, count, lock = scene.place, scene.mechanism.n, len(group.places), Lock()
    for i in group.varied:
        items[place[f"dc{i}"], :count] = [slopes[i] for slopes in group.slopes]
    held = [j for j in range(n) if f"fed{j}" in place]

    first, base = place["dq0"], place.get("base0", 0)
    table, room = np.zeros(len(TABLE), np.int64), np.empty(0)
    told = table.ctypes.data

    def go(steps: Steps, torques: Any, s: Array) -> tuple[Array, Array]:
        nonlocal room
        values, slopes, fed = torques
        given, taken = len(steps[3]), len(steps[0])
        sizes = [x.size for x in steps] + [2 * n * lanes * x for x in (taken, given)]
        bounds = list(accumulate(sizes, initial=0))
        with lock:  # another thread may have a run of the same
            if len(room) < bounds[-1]:
                room = np.empty(2 * bounds[-1])
            for x, begin, end in zip(steps, bounds, bounds[1:], strict=False):
                room[begin:end] = x.ravel()
            at = room.ctypes.data
            table[:] = [*(at + 8 * x for x in bounds[:-1]), given]
            items[first : first + 2 * n, :count] = s.T
            if scene.linear:
                items[place["base_t"]] = steps[0][0]
                items[base : base + 2 * n].T[:] = [*values, *slopes]
            for j in held:
                items[place[f"fed{j}"], :count] = fed[:, j]
            code.vary(block.ctypes.data, taken, told)
            found = room[bounds[-3] : bounds[-1]].reshape(-1, 2 * n, lanes)
            found = np.swapaxes(found[..., :count], -1, -2).copy()
        return found[:taken], found[taken:]

    return go
