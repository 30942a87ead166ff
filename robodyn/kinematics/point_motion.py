"""How points of a mechanism move, and how its links turn.

A point is p = const + c X (`placed.py`), so p' = c X' and dp/dq = c dX/dx J; in the minimal
coordinates, the actuated joints, dp = dp/dq N with N the joints' rates for each of these at 1.
"""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.closed_form import point_motion, points_of
from robodyn.dynamics.placed import absolute_rates, as_states, columns, frame_rates, placed
from robodyn.kinematics.named_points import named_points
from robodyn.loops.loop_rates import loop_velocities
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr


@short_repr
class PointMotion(NamedTuple):
    """How points (p of them) move: position m, velocity m/s, acceleration m/s^2, (..., p, 2)."""

    names: tuple[str, ...]
    position: Array
    velocity: Array
    acceleration: Array


def points(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike | None = None,
    qdd: ArrayLike | None = None,
    of: str | Sequence[str] = (),
) -> PointMotion:
    """How points move along states q, qd, qdd (..., n), closed; rates not given are zero.

    `of` has names of points, `coupler@0.5,0.2` or `P=coupler@0.5,0.2`; the scene's, else all tips,
    where it is empty.  Raises InputError for a point that is not there, and for shapes.
    """
    named = named_points(mechanism, of)
    moved = point_motion(mechanism, [point for *_, point in named], q, qd, qdd)
    return PointMotion(tuple(name for name, *_ in named), *moved)


def point_jacobian(mechanism: Mechanism, points: Sequence[PlanarPoint], q: ArrayLike) -> Array:
    """dp/dq of points, (..., p, 2, n), m/rad or 1."""
    at = placed(mechanism, q)
    moved = columns(
        mechanism, points_of(mechanism, points).c, at.X[..., None, :], at.E[..., None, :]
    )
    moved = moved @ mechanism.arrays.J
    return np.stack([moved.real, moved.imag], axis=-2)


def unit_rates(mechanism: Mechanism, q: ArrayLike) -> Array:
    """N (..., n, a): the rates of all joints where one of the a actuated joints moves at 1.

    Raises SingularError at a dead centre or change point.
    """
    q = as_states(mechanism, "q", q)
    each = np.eye(len(mechanism.actuated))
    found = loop_velocities(
        mechanism, q[..., None, :], np.broadcast_to(each, (*q.shape[:-1], *each.shape))
    )
    return np.swapaxes(found, -1, -2)


def link_turns(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
) -> tuple[Array, Array, Array]:
    """The angle rad, rate rad/s and acceleration rad/s^2 of each link's frame, each (..., n)."""
    alpha = frame_rates(mechanism, placed(mechanism, q).x)  # as rates go, so go the angles
    phases = [cmath.phase(phase) for phase in Tree(mechanism.description.links).phases]
    rates = (absolute_rates(mechanism, x, name) for x, name in ((qd, "qd"), (qdd, "qdd")))
    w, wd = (frame_rates(mechanism, x) for x in rates)
    return alpha + np.array(phases), w, wd
