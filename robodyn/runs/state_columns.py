"""Columns of states (`fx1`, `power1`, `tip2_y`) as variables of event functions.

They depend on the torques that act along the run and on the mode that moves, which only the run
knows; it calls `StateColumns.enter` with both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from robodyn.dynamics.columns import scene_units, unit_of
from robodyn.dynamics.state import State, find
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.dimensions import dimension_of
from robodyn.scene.quantities import Variables, state_variables
from robodyn.tables.arrays import Array

PREFIX = "column_"  # of a column's name as a variable
ROUGH = 1e-12  # of the largest value: what solving for forces and accelerations may add to each

Torques = Callable[[Array, Array], Array]  # at times (k,) and states (k, 2n or more), (k, n)


def variables(mechanism: Mechanism) -> Variables:
    """Return the variables of events: t, q1.., qd1.., and columns of states with `PREFIX`."""
    plain = state_variables(mechanism.n, mechanism.slides)
    units = scene_units(mechanism)

    constants = dict(mechanism.description.constants)

    def named(name: str) -> str | None:
        if name in constants:  # before a column of the name
            return None
        return plain.named(name) or (PREFIX + name if find(mechanism, name, []) else None)

    def of(name: str) -> Mapping[str, float] | None:
        column = name.removeprefix(PREFIX)
        return plain.of(name) if column == name else dimension_of(unit_of(column, units))

    return Variables(named, f"{plain.known}, and columns of states", of)


class StateColumns:
    """Computes columns of states along a run; `enter` sets the mode and the torques."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = self.moving = mechanism
        self._torques: Torques | None = None
        self._last: tuple[Array, Array, State] | None = None

    def enter(self, moving: Mechanism, torques: Torques) -> None:
        """Set the mode that moves from now on, and the torques."""
        self.moving, self._torques, self._last = moving, torques, None

    def values(self, name: str, t: Array, y: Array) -> Array:
        """Return column `name` (...) of states y (..., 2n or more) at times t (...)."""
        if self._last is None or self._last[0] is not t or self._last[1] is not y:
            self._last = t, y, self._state(t, y)
        return self._last[2].columns([name])[..., 0]

    def noise(self, name: str, t: Array, y: Array, off: Array) -> Array:
        """Return the rounding (m, 1) of column `name` on boxes of states y (m, k, 2n or more).

        States may be `off` (m, 1, 2n).  The rounding is inf if it leaves nothing of a column that
        is undefined somewhere, as the curvature of the path of a point that stands.
        """
        values = self.values(name, t, y)
        noise: Array = ROUGH * np.abs(values).max(axis=-1, keepdims=True)
        family = find(self.mechanism, name, [])
        if family is None or not family.gaps:
            return noise
        moved = y.copy()
        moved[..., : off.shape[-1]] += off
        scatter = np.abs(self._state(t, moved).columns([name])[..., 0] - values)
        tells = (scatter < np.abs(values)).any(axis=-1, keepdims=True)
        return np.where(tells, noise, np.inf)

    def _state(self, t: Array, y: Array) -> State:
        assert self._torques is not None
        n, times = self.mechanism.n, np.broadcast_to(t, y.shape[:-1])
        tau = self._torques(times.ravel(), y.reshape(-1, y.shape[-1])).reshape(*times.shape, n)
        q, qd = y[..., :n], y[..., n : 2 * n]
        return State(self.mechanism, q, qd, tau=tau, t=times, moving=self.moving)
