"""Contacts with friction by the forces in pins and slides, and the size of this friction.

Each of c contacts has a slip rate D qd, D (c, n), and a friction f = part |N| along it, so D^T f at
the joints.  N is the force in the pin, or normal to the line of a slide, and

    part = -coefficient radius tanh(slip/speed),

without the radius for slides.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.closed_form import points_of
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import Placed, as_states, columns, matvec, placed
from robodyn.scene.scene import Closure
from robodyn.tables.arrays import Array, Complex


class Rubbing(NamedTuple):
    """The contacts at states: D (..., c, n), `part` (..., c), and the direction of each slide.

    `along` (..., c) is a unit vector; zero for pins.
    """

    D: Array
    part: Array
    along: Complex


def rubbing_at(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike) -> Rubbing:
    """Return the contacts at states q, qd (..., n), which broadcast."""
    q, qd = np.broadcast_arrays(as_states(mechanism, "q", q), as_states(mechanism, "qd", qd))
    D, along = slips(mechanism, placed(mechanism, q))
    speeds = np.array([x.speed for x in mechanism.rubbing])
    return Rubbing(D, -np.array(sizes(mechanism)) * np.tanh(matvec(D, qd) / speeds), along)


def sizes(mechanism: Mechanism) -> list[float]:
    """Return the coefficient of each contact, times the radius for pins."""
    return [x.coefficient * (x.radius or 1.0) for x in mechanism.rubbing]


def slips(mechanism: Mechanism, at: Placed) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return D (..., c, n) and `along` (..., c) of `Rubbing`, in numbers or formulas."""
    contacts, kind = mechanism.rubbing, at.x.dtype  # float, or object
    D = np.zeros((*at.x.shape[:-1], len(contacts), mechanism.n), kind)
    along = np.zeros(D.shape[:-1], np.result_type(kind, complex))
    for i, contact in enumerate(contacts):
        if contact.joint is not None:
            D[..., i, contact.joint] = 1.0
            if contact.joint in mechanism.slides:
                along[..., i] = _axis(mechanism, contact.joint, at)
        else:
            assert contact.closure is not None
            closure = mechanism.description.closures[contact.closure]
            if closure.along is None:
                D[..., i, :] = _turning(mechanism, closure)
            else:
                along[..., i] = _line(mechanism, contact.closure, at)
                D[..., i, :] = _sliding(mechanism, closure, at, along[..., i])
    return D, along


def _axis(mechanism: Mechanism, joint: int, at: Placed) -> NDArray[Any]:
    """Return the direction (...) in which a link slides."""
    turned, frame = mechanism.tree.turned(joint, 1.0 + 0j), mechanism.frames[joint]
    return np.asarray(turned * (1.0 + 0j if frame is None else at.E[..., frame]))


def _line(mechanism: Mechanism, closure: int, at: Placed) -> NDArray[Any]:
    """Return the direction (...) of a closure's line."""
    row = next(x for x in mechanism.rows if x.closure == closure and not x.arm)
    turned = 1.0 + 0j if row.line is None else at.E[..., row.line]
    return np.asarray(-1j * row.direction * turned)


def _turning(mechanism: Mechanism, closure: Closure) -> Array:
    """Return the rate (n,) of a closure's first link relative to its second, per joint rate."""
    found = np.zeros(mechanism.n)
    for side, sign in ((closure.first, 1.0), (closure.second, -1.0)):
        frame = None if side.link is None else mechanism.frames[side.link]
        if frame is not None:
            found += sign * mechanism.arrays.J[frame]
    return found


def _sliding(
    mechanism: Mechanism, closure: Closure, at: Placed, along: NDArray[Any]
) -> NDArray[Any]:
    """Return the rate (..., n) of the point along the line, per joint rate.

    The line's turning moves a point on it only across the line.
    """
    points = [mechanism.tree.point(x) for x in (closure.first, closure.second)]
    c = points_of(mechanism, points).c
    moved = columns(mechanism, c, at.X[..., None, :], at.E[..., None, :]) @ mechanism.arrays.J
    between = np.asarray(along)[..., None].conj() * (moved[..., 0, :] - moved[..., 1, :])
    return np.array([z.real for z in between]) if between.dtype == object else between.real


def at_closures(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, pins: Complex
) -> tuple[Complex, Array]:
    """Return friction on the first sides of closures: forces N and moments N m, (..., closures).

    `pins` (..., closures) are the forces of the closures, N.
    """
    at = rubbing_at(mechanism, q, qd)
    forces, moments = np.zeros_like(pins), np.zeros(pins.shape)
    for i, contact in enumerate(mechanism.rubbing):
        if contact.closure is not None:
            f = at.part[..., i] * np.abs(pins[..., contact.closure])
            if contact.radius is None:
                forces[..., contact.closure] += f * at.along[..., i]
            else:
                moments[..., contact.closure] += f
    return forces, moments
