"""Sensitivities from mode to mode: where joints start and stop, and meet compliant ends.

A phase ends where its guard g is zero, at a time that depends on p by

    T = -(dg/dp)/(dg/dt)    along the motion,      s+ = dY/dp + dY/dy (s- + f- T) - f+ T

with the rates f of y = (q, qd) before and after, and Y the state after an impact, by that before:

    qd+ = qd - (1 + e) qd_j r/r_j,      r = dqdd/dtau_j

Elsewhere Y = y.
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
from robodyn.simulation.phases import Guard, Phases

Array = NDArray[np.float64]

SAME = 1e-9  # part of accelerations by which they do not jump


class Modes:
    """The slopes of a run, as `make` has them for a mode, and how s jumps between two.

    `ends(joint, side)` (k,) is how far an end moves with each name; `thrown(joint, e)` a function
    of (q, qd) and s (k 2n) to Y and what becomes of s; s begin at `first` in a state.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        make: Callable[[Mode], Callable[..., Any]],
        ends: Callable[[int, int], Array],
        thrown: Callable[[int, float], Callable[..., Sequence[float]]],
        count: int,
        first: int,
    ) -> None:
        self.mechanism, self.make, self.ends, self.thrown = mechanism, make, ends, thrown
        self.count, self.first = count, first
        self.known: dict[Mode, Callable[..., Any]] = {}
        self.enter(Mode())
        self.time, self.shift = -1.0, np.zeros(count)

    def enter(self, mode: Mode) -> None:
        """The run goes on in a mode."""
        if mode not in self.known:
            self.known[mode] = self.make(mode)
        self.mode = mode
        self.now = self.known[mode]

    def __call__(self, *values: float) -> Sequence[float]:
        found: Sequence[float] = self.now(*values)
        return found

    def next(self, phases: Phases, t: float, y: Array, place: int) -> Array:
        """`phases.next`, with s."""
        n, guard = self.mechanism.n, phases.guards[place]
        wide = 2 * n
        part = slice(self.first, self.first + wide * self.count)
        s = y[part].reshape(self.count, wide).copy()

        def rates(y: Array) -> Array:
            q, qd = y[:n], y[n:wide]
            qdd = forward_dynamics(phases.moving, q, qd, phases._torque(t, y), t)
            return np.concatenate([qd, qdd])

        before = rates(y)
        found = phases.next(t, y, place)
        self.enter(phases.mode)
        after = rates(found)
        size = max(np.abs(before).max(), np.abs(after).max())
        if np.abs(before - after).max() > SAME * size:
            if not phases.idle:
                self.shift = self._shift(guard, before, s, t)
            s += self.shift[:, None] * before
            if guard.kind == "inside":
                s = self._impact(guard, y[:wide], found[:wide], s, t)
            s -= self.shift[:, None] * after
        found[part] = s.ravel()
        return found

    def _impact(self, guard: Guard, y: Array, after: Array, s: Array, t: float) -> Array:
        """What becomes of s, where one joint alone is thrown back, or comes to rest."""
        n, joint = self.mechanism.n, guard.joint
        e = round(float(-after[n + joint] / y[n + joint]), 12)
        values = self.thrown(joint, e)(*y.tolist(), *s.ravel().tolist())
        if np.abs(values[: 2 * n] - after).max() > SAME * np.abs(after).max():
            limit = "is not known where several joints are thrown back at once"
            raise RobodynError("sensitivity", value=f"t = {t:.6g} s", limit=limit)
        return np.reshape(values[2 * n :], s.shape)

    def _shift(self, guard: Guard, rates: Array, s: Array, t: float) -> Array:
        """T (k,)."""
        n, joint = self.mechanism.n, guard.joint
        if guard.kind == "slips":
            return np.asarray(-s[:, n + joint] / rates[n + joint])
        if guard.kind in ("apart", "inside"):
            moved = s[:, joint] - self.ends(joint, guard.side)
            return np.asarray(-moved / rates[joint])
        limit = (
            "is not known where what holds a joint jumps: static friction above that of slipping"
        )
        raise RobodynError("sensitivity", value=f"t = {t:.6g} s", limit=limit)
