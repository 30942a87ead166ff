"""The columns that commands compute of states: those of `torque`, `reactions` and `points`.

Each has its names, and a function of the states (T, n) that gives the values (T, columns).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics import dynamics, reaction_forces
from robodyn.dynamics.closed_form import energies, point_motion
from robodyn.dynamics.named_points import (
    NamedPoint,
    link_turns,
    point_columns,
    point_jacobian,
    unit_rates,
)
from robodyn.dynamics.placed import n_wide
from robodyn.dynamics.transmission import (
    rate_ratios,
    ratio_named,
    transmission_angles,
    transmission_loops,
)
from robodyn.mechanics.loop_rows import loop_columns
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.motors import motor_columns, motor_values
from robodyn.tables.arrays import Array


class Solved(NamedTuple):
    """States of a motion with what acts in them: t (T,), the multipliers (T, r), others (T, n)."""

    t: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    multipliers: Array


def torque_columns(mechanism: Mechanism) -> list[str]:
    """tau1.., of closures forces and moments, of couplings and of motors."""
    driven = [f"tau{k + 1}" for k in mechanism.actuated]
    return [*driven, *loop_columns(mechanism), *motor_columns(mechanism)]


def torque_values(mechanism: Mechanism, q: Array, qd: Array, tau: Array, forces: Array) -> Array:
    """The values of `torque_columns`; the multipliers are `forces`."""
    loops = dynamics.loop_forces(mechanism, forces, q)
    motors = motor_values(mechanism, list(tau.T), list(qd.T))
    parts = [tau[:, list(mechanism.actuated)], loops, *(x[:, None] for x in motors)]
    return np.concatenate(parts, axis=1)


def motor_loads(mechanism: Mechanism, tau: ArrayLike, qd: ArrayLike) -> dict[str, Array]:
    """Torque N m, speed rad/s, voltage V, current A and power W of motors, by columns' names.

    Each is (...), of rates (..., n) and torques of all joints or of the actuated ones, which
    broadcast.  There are those of the actuated joints: `motor1`, `motor_speed1`, and `volt1`,
    `amp1`, `watt1` of a motor with its constants.  Raises InputError for arrays that are not so
    wide.
    """
    given = [n_wide(mechanism, name, x) for name, x in (("tau", tau), ("qd", qd))]
    torques, rates = (list(np.moveaxis(x, -1, 0)) for x in np.broadcast_arrays(*given))
    return dict(zip(motor_columns(mechanism), motor_values(mechanism, torques, rates), strict=True))


def reaction_columns(mechanism: Mechanism) -> list[str]:
    """The forces on links, moments on those that slide, of closures, and on the ground."""
    names = [f"r{axis}{k + 1}" for k in range(mechanism.n) for axis in "xy"]
    names += [f"rm{k + 1}" for k in mechanism.slides]
    return [*names, *loop_columns(mechanism), "shake_fx", "shake_fy", "shake_m"]


def reaction_values(
    mechanism: Mechanism, q: Array, qd: Array, qdd: Array, forces: Array, t: Array | float = 0.0
) -> Array:
    """The values of `reaction_columns`; the multipliers are `forces`."""
    joints = reaction_forces.reactions(mechanism, q, qd, qdd, forces, t)
    held = reaction_forces.slide_moments(mechanism, q, qd, qdd, forces, t)
    loops = dynamics.loop_forces(mechanism, forces, q)
    shake = reaction_forces.shaking_force(mechanism, q, qd, qdd, t)
    return np.concatenate([joints.reshape(len(shake), -1), held, loops, shake], axis=-1)


def point_values(
    mechanism: Mechanism, named: Sequence[NamedPoint], q: Array, qd: Array, qdd: Array
) -> Array:
    """The values of `point_columns`."""
    motion = point_motion(mechanism, [point.point for point in named], q, qd, qdd)
    return np.concatenate(motion, axis=-1).reshape(len(q), -1)


def power_values(mechanism: Mechanism, qd: Array, tau: Array) -> Array:
    """The powers of the actuated joints' torques."""
    driven = list(mechanism.actuated)
    return np.asarray(tau[:, driven] * qd[:, driven])


def link_columns(mechanism: Mechanism) -> list[str]:
    """The angle of each link, its rate and its acceleration."""
    return [f"{x}{k + 1}" for k in range(mechanism.n) for x in ("angle", "w", "wd")]


def link_values(mechanism: Mechanism, q: Array, qd: Array, qdd: Array) -> Array:
    """The values of `link_columns`."""
    return np.stack(link_turns(mechanism, q, qd, qdd), axis=-1).reshape(len(q), -1)


def transmission_columns(mechanism: Mechanism) -> list[str]:
    """The transmission angle of each loop that has one."""
    return [f"transmission{c + 1}" for c in transmission_loops(mechanism)]


def transmission_values(mechanism: Mechanism, q: Array) -> Array:
    """The values of `transmission_columns`."""
    return transmission_angles(mechanism, list(transmission_loops(mechanism).values()), q)


def jacobian_columns(mechanism: Mechanism, named: Sequence[NamedPoint]) -> list[str]:
    """How far each point goes with each actuated joint."""
    driven = [k + 1 for k in mechanism.actuated]
    return [f"{point.name}_J{x}{k}" for point in named for x in "xy" for k in driven]


def jacobian_values(mechanism: Mechanism, named: Sequence[NamedPoint], q: Array) -> Array:
    """The values of `jacobian_columns`."""
    places = [point.point for point in named]
    moved = point_jacobian(mechanism, places, q) @ unit_rates(mechanism, q)[:, None]
    return np.asarray(moved.reshape(len(q), -1))


Group = tuple[list[str], Callable[[Solved], Array]]


def _groups(mechanism: Mechanism, named: Sequence[NamedPoint]) -> list[Group]:
    """The columns that are computed together, by names, and their values (T, columns)."""
    mech, powers = mechanism, [f"power{k + 1}" for k in mechanism.actuated]
    return [
        (["energy"], lambda x: np.sum(energies(mech, x.q, x.qd), axis=0)[:, None]),
        (torque_columns(mech), lambda x: torque_values(mech, x.q, x.qd, x.tau, x.multipliers)),
        (powers, lambda x: power_values(mech, x.qd, x.tau)),
        (
            reaction_columns(mech),
            lambda x: reaction_values(mech, x.q, x.qd, x.qdd, x.multipliers, x.t),
        ),
        (link_columns(mech), lambda x: link_values(mech, x.q, x.qd, x.qdd)),
        (transmission_columns(mech), lambda x: transmission_values(mech, x.q)),
        (point_columns(named), lambda x: point_values(mech, named, x.q, x.qd, x.qdd)),
        (jacobian_columns(mech, named), lambda x: jacobian_values(mech, named, x.q)),
    ]


def column_names(mechanism: Mechanism, named: Sequence[NamedPoint]) -> list[str]:
    """All of them, those of the state before."""
    state = [f"{x}{k + 1}" for x in ("q", "qd", "qdd") for k in range(mechanism.n)]
    others = (name for names, _ in _groups(mechanism, named) for name in names)
    links = mechanism.link_names
    ratios = (f"{a}/{b}" for a in links for b in links if a != b)
    return list(dict.fromkeys(["t", *state, *others, *ratios]))


def columns_of(
    mechanism: Mechanism, named: Sequence[NamedPoint], solved: Solved, wanted: Sequence[str]
) -> dict[str, Array]:
    """The columns (T,) of these names; none is computed that belongs to no command of theirs."""
    found = {"t": solved.t}
    for name in ("q", "qd", "qdd"):
        found |= {f"{name}{k + 1}": x for k, x in enumerate(getattr(solved, name).T)}
    for names, compute in _groups(mechanism, named):
        if not found.keys() >= set(names) & set(wanted):
            found |= dict(zip(names, compute(solved).T, strict=True))
    ratios = [ratio_named(mechanism, name) for name in wanted if name not in found]
    if ratios:
        each = rate_ratios(mechanism, ratios, solved.q, solved.qd)
        found |= {ratio.name: x for ratio, x in zip(ratios, each.T, strict=True)}
    return {name: found[name] for name in wanted}
