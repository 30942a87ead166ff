"""Sensitivities along the steps of the Taylor series: the series of the variational equations.

A step's series are functions of the state that it begins in, and of the numbers of the scene.
Their tangents by these are the series of d(q, qd)/dp, by the same recurrences.  The motion comes
first, and its steps are those of a run without them; then each step is gone once more, with its
tangents: in machine code (`engines/machine_variation.py`) or in Python (`varied_steps.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
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
from robodyn.taylor import Chunk, default_order
from robodyn.taylor.varied_steps import Along, Group, Steps, row_steps, straight_steps

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
        order: int,
        numbers: Sequence[Number],
        s: Array,
        control: Any = None,
    ) -> None:
        self.mechanism, self.actuation, self.order = mechanism, actuation, order
        self.numbers, self.s, self.control = numbers, s, control
        self._torques = actuation.function(mechanism.n)
        self._made: dict[object, Any] = {}
        if actuation.constants is not None:
            self._made = _kept(mechanism, actuation.constants, order, tuple(numbers))

    def along(
        self, t: float, y: Array, chunk: Chunk, kind: str, within: Callable[[Array], Array]
    ) -> tuple[Chunk, Callable[[Array], Array]]:
        """The chunk from (t, y) with s in its states, and what has so `within` its last step.

        `kind` is the name of the engine that made it.
        """
        if not len(chunk.t):
            return chunk, within
        n = self.mechanism.n
        begins = np.append(t, chunk.t[:-1])
        states = np.concatenate([y[None], chunk.y[:-1]])[:, : 2 * n]
        direction = 1.0 if chunk.t[-1] > t else -1.0
        torques: Any = ((), ())
        if self.actuation.constants is None and self.actuation.linear:
            torques = linear_piece(self.actuation, self._torques, t, y.tolist(), direction)
        fed = np.zeros((len(self.s), n if torques[0] else 0))
        if self.control is not None:  # its torques are held, and so is what they change by
            held_at = 0.5 * (t + float(chunk.t[-1]))
            changes = np.reshape(self.control.slopes_at(held_at), (len(fed), -1))
            fed[:, list(self.mechanism.actuated)] = changes
        held = None if self.actuation.pieces is None else self.actuation.pieces.at(t)
        if ("groups", held) not in self._made:
            self._made["groups", held] = self._groups(held)
        s = self.s.copy()
        at_ends = np.empty((len(chunk.t), *s.shape))
        at_rows = np.empty((len(chunk.row_t), *s.shape))
        last: list[Callable[[Array], Array]] = []
        steps = begins, chunk.t, states, chunk.row_t
        for i, group in enumerate(self._made["groups", held]):
            key = i, held, kind
            if key not in self._made:
                make = MAKERS.get(kind, _compiled)
                self._made[key] = make(self.order, group)
            go = self._made[key]
            where = group.places
            acting = *torques, fed[where]
            at_ends[:, where], at_rows[:, where] = go(steps, acting, s[where])
            before = s[where] if len(chunk.t) == 1 else at_ends[-2, where]
            only = tuple(x[-1:] for x in steps[:3])

            last.append(partial(self._last, go, only, acting, before))
        self.s = at_ends[-1]
        if not np.isfinite(self.s).all():
            raise RobodynError(
                "sensitivity", value=f"at t = {chunk.t[-1]:.6g} s", limit="not finite"
            )

        def both(times: Array) -> Array:
            found = np.empty((len(times), *s.shape))
            for group, each in zip(self._made["groups", held], last, strict=True):
                found[:, group.places] = each(times)
            return self.joined(within(times), found)

        y, rows = self.joined(chunk.y, at_ends), self.joined(chunk.row_y, at_rows)
        return chunk._replace(y=y, row_y=rows), both

    def _last(self, go: Along, step: Any, torques: Any, s: Array, times: Array) -> Array:
        return go((*step, times), torques, s)[1]

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


@lru_cache(maxsize=64)
def _kept(*given: object) -> dict[object, Any]:
    """What is made for runs under constant torques, for runs to come."""
    return {}


def variations_of(
    mechanism: Mechanism, actuation: Actuation, y: Array, tolerance: float, order: int | None
) -> tuple[Variations, Array]:
    """Those that torques carry in the state y, and the state without them."""
    assert actuation.alone is not None
    first, last = 2 * mechanism.n, 2 * mechanism.n + actuation.states
    s = y[first:last].reshape(-1, first).copy()
    order = order or default_order(tolerance)
    numbers = actuation.by(actuation.modes.mode if actuation.modes else None)
    found = Variations(mechanism, actuation.alone, order, numbers, s, actuation.control)
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
    fed = [j for j in range(n) if f"fed{j}" in place]

    def go(steps: Steps, torques: Any, s: Array) -> tuple[Array, Array]:
        begins, ends, states, times = (np.ascontiguousarray(x) for x in steps)
        at_ends, at_rows = (np.empty((len(x), 2 * n, lanes)) for x in (ends, times))
        found = {"begins": begins, "ends": ends, "states": states, "times": times}
        found |= {"at_ends": at_ends, "at_rows": at_rows}
        told = [found[name].ctypes.data for name in TABLE[:-1]]
        table = np.array([*told, len(times)], np.int64)
        with lock:  # another thread may have a run of the same
            items[place["dq0"] : place["dq0"] + 2 * n] = 0.0
            items[place["dq0"] : place["dq0"] + 2 * n, :count] = s.T
            if scene.linear:
                base = place["base0"]
                items[place["base_t"]] = begins[0]
                items[base : base + 2 * n] = np.concatenate(torques[:2])[:, None]
            for j in fed:
                items[place[f"fed{j}"], :count] = torques[2][:, j]
            code.vary(block.ctypes.data, len(ends), table.ctypes.data)
        return tuple(np.swapaxes(x[..., :count], -1, -2) for x in (at_ends, at_rows))  # type: ignore[return-value]

    return go


MAKERS = {"StraightEngine": straight_steps, "InterpretedEngine": row_steps}
