"""Sensitivities from mode to mode: where joints start and stop, and meet compliant ends.

A phase ends where its guard g is zero, at a time that depends on p by

    T = -(dg/dp)/(dg/dt)    along the motion,      s+ = s- + (f- - f+) T

with the rates f of (q, qd) before and after; (q, qd) themselves go on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.dynamics import forward_dynamics
from robodyn.errors import RobodynError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import Mode
from robodyn.simulation.phases import Phases

Array = NDArray[np.float64]

SAME = 1e-9  # part of accelerations by which they do not jump


class Modes:
    """The slopes of a run, as `make` has them for a mode, and how s jumps between two.

    `ends(joint, side)` (k,) is how far an end moves with each name; s begin at `first` in a state.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        make: Callable[[Mode], Callable[..., Any]],
        ends: Callable[[int, int], Array],
        count: int,
        first: int,
    ) -> None:
        self.mechanism, self.make, self.ends = mechanism, make, ends
        self.count, self.first = count, first
        self.known: dict[Mode, Callable[..., Any]] = {}
        self.enter(Mode())
        self.time, self.shift = -1.0, np.zeros(count)

    def enter(self, mode: Mode) -> None:
        """The run goes on in a mode."""
        if mode not in self.known:
            self.known[mode] = self.make(mode)
        self.now = self.known[mode]

    def __call__(self, *values: float) -> Sequence[float]:
        found: Sequence[float] = self.now(*values)
        return found

    def next(self, phases: Phases, t: float, y: Array, place: int) -> Array:
        """`phases.next`, with s."""
        n, guard = self.mechanism.n, phases.guards[place]
        if guard.kind == "inside":
            where = f"t = {t:.6g} s"
            limit = "is not known across impacts at hard stops"
            raise RobodynError("sensitivity", value=where, limit=limit)
        wide = 2 * n
        part = slice(self.first, self.first + wide * self.count)
        s = y[part].reshape(self.count, wide).copy()

        def rates() -> Array:
            q, qd = y[:n], y[n:wide]
            tau = phases._torque(t, y)
            qdd = forward_dynamics(phases.moving, q, qd, tau, t)
            return np.concatenate([qd, qdd])

        before = rates()
        after_y = phases.next(t, y, place)
        self.enter(phases.mode)
        after = rates()
        jump = before - after
        if np.abs(jump).max() > SAME * max(np.abs(before).max(), np.abs(after).max()):
            if not phases.idle:
                self.shift = self._shift(guard, before, s, t)
            s += self.shift[:, None] * jump
        after_y[part] = s.ravel()
        return after_y

    def _shift(self, guard: Any, rates: Array, s: Array, t: float) -> Array:
        """T (k,)."""
        n, joint = self.mechanism.n, guard.joint
        if guard.kind == "slips":
            return np.asarray(-s[:, n + joint] / rates[n + joint])
        if guard.kind == "apart":
            moved = s[:, joint] - self.ends(joint, guard.side)
            return np.asarray(-moved / rates[joint])
        limit = (
            "is not known where what holds a joint jumps: static friction above that of slipping"
        )
        raise RobodynError("sensitivity", value=f"t = {t:.6g} s", limit=limit)
