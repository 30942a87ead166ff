"""The columns of a simulated motion, as `robodyn simulate` writes them."""

from __future__ import annotations

import numpy as np

from robodyn.dynamics import closed_form
from robodyn.dynamics.dynamics import loop_forces, motion_dynamics
from robodyn.mechanics.loop_rows import loop_columns
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array


def motion_columns(mechanism: Mechanism, tracked: bool) -> list[str]:
    """Their names; those of a motion that a controller leads have its errors."""
    joints = range(1, mechanism.n + 1)
    names = ["t", *(f"{name}{k}" for name in ("q", "qd", "qdd") for k in joints)]
    names += [f"tau{k + 1}" for k in mechanism.actuated]
    names += loop_columns(mechanism)
    names += ["energy", *(["gap"] if mechanism.rows else [])]
    return names + [f"e{k + 1}" for k in mechanism.actuated if tracked]


def motion_values(
    mechanism: Mechanism, moving: Mechanism, t: Array, q: Array, qd: Array, tau: Array
) -> Array:
    """Their values (T, columns) but the errors, at times (T,), states and torques (T, n).

    `moving` is what moves there: the mechanism, or one of its modes.
    """
    solution = motion_dynamics(moving, q, qd, tau, t)
    forces = loop_forces(mechanism, solution.multipliers[..., : len(mechanism.rows)], q)
    energy = np.sum(closed_form.energies(moving, q, qd), axis=0)
    driven = tau[:, list(mechanism.actuated)]
    parts = [t[:, None], q, qd, solution.qdd, driven, forces, energy[:, None]]
    if mechanism.rows:
        gap = np.linalg.norm(closed_form.closure_gap(mechanism, q), axis=-1)
        parts.append(gap[:, None])
    return np.concatenate(parts, axis=-1)
