"""Forward and inverse dynamics of states of which each goes on in a mode of its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robodyn.dynamics.placed import finite
from robodyn.dynamics.sticking import modes_of
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode, resting_friction
from robodyn.tables.arrays import Array

Solved = tuple[Array, Array, str]  # of joints, multipliers, and a remark
Smooth = Callable[[Mechanism, str, int, dict[str, Array], Array], Solved]

AT_REST_REMARK = (
    "a joint with dry friction is at rest: any torque within its static friction of this holds it"
)


def by_modes(
    mechanism: Mechanism, kind: str, states: dict[str, Array], times: Array, smooth: Smooth
) -> Solved:
    """Accelerations or torques of states (..., n) that go on in modes of their own, by `smooth`."""
    for name, array in states.items():
        finite(name, array)
    shape, n, r = states["q"].shape, mechanism.n, len(mechanism.rows)
    flat = {name: array.reshape(-1, n) for name, array in states.items()}
    joints, forces = np.empty((len(flat["q"]), n)), np.empty((len(flat["q"]), r))
    every = np.broadcast_to(times.ravel(), len(joints))
    remarks: dict[str, None] = {}
    for mode, which in modes_of(mechanism, kind, flat, every).items():
        part = {name: array[which] for name, array in flat.items()}
        moving = in_mode(mechanism, mode)
        joints[which], found, remark = smooth(moving, kind, 2, part, every[which])
        if kind == "forward":
            joints[np.ix_(which, mode.held)] = 0.0  # but for rounding
        forces[which] = found[:, :r]
        remarks |= {remark: None}
    if kind == "inverse" and resting_friction(mechanism, flat["qd"], flat["qdd"]):
        remarks |= {AT_REST_REMARK: None}
    told = "; ".join(filter(None, remarks))
    return joints.reshape(shape), forces.reshape(*shape[:-1], r), told
