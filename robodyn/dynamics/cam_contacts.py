"""The cams of a mechanism: contacts with their followers, contact forces, and whole profiles.

`cams.py` has the geometry; laws and their derivatives are those of the couplings.  The contact
force does the work of the law: N (nu . V) = tc, with nu the normal away from the cam, and V the
velocity of the follower's point per rate of its joint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.cams import Contact, Follower, contact, convex_radius
from robodyn.dynamics.closed_form import points_of
from robodyn.dynamics.dynamics import coupling_torques
from robodyn.elements.joints import Range
from robodyn.engines.coupling_laws import law_derivatives
from robodyn.errors import InputError
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import Placed
from robodyn.scene.scene import Curve, Point
from robodyn.scene.yaml_values import nearest
from robodyn.tables.arrays import Array

TURN = 2.0 * math.pi
SAMPLES = 3600  # of a turn
ZOOMS, NODES = 6, 41  # by which an extreme is narrowed down
STEADY = 0.0  # s, of a cam's law, which is none of the time
CLOSED = 1e-9  # part of a profile's size by which its ends may miss one another


class Cam(NamedTuple):
    """A cam: its coupling, its link `driver`, its follower's link, and the follower's geometry."""

    coupling: int
    driver: int
    link: int
    follower: Follower


@lru_cache(maxsize=64)
def cams_of(mechanism: Mechanism) -> tuple[Cam, ...]:
    """Return the cams of a mechanism, in the order of its couplings."""
    found = []
    links = mechanism.description.links
    for c, coupling in enumerate(mechanism.description.couplings):
        if coupling.cam is None:
            continue
        (driver,), own = coupling.others, coupling.cam
        cam, follower = links[driver], links[coupling.joint]
        made = Follower(
            pivot=cam.hangs_from.at,
            joint=follower.hangs_from.at,
            axis=follower.axis,
            at=own.at if own.face is None else own.face.through,
            face=None if own.face is None else own.face.along,
            radius=own.roller,
            turn=follower.turn if follower.axis is None else follower.axis,
            cam_turn=cam.turn,
        )
        found.append(Cam(c, driver, coupling.joint, made))
    return tuple(found)


def cam_named(mechanism: Mechanism, name: str, where: str) -> Cam:
    """Return the cam whose follower is the link `name`.

    Raises InputError, with the names of followers, if no cam drives it.
    """
    names = {mechanism.link_names[cam.link]: cam for cam in cams_of(mechanism)}
    if name not in names:
        limit = f"no cam drives it{nearest(name, list(names))}"
        if not names:
            limit = "this scene has no cam: write {law: ..., cam: {...}} in `couplings`"
        raise InputError(where, where=mechanism.source, value=name, limit=limit)
    return names[name]


def contact_at(mechanism: Mechanism, cam: Cam, q: Array) -> Contact:
    """Return the contact of a cam with its follower at q (..., n).

    The follower stands at its joint's position; derivatives come from the law.
    """
    _, f1, f2 = law_derivatives(mechanism, cam.coupling, cam.driver, q, STEADY)
    return contact(cam.follower, q[..., cam.driver], q[..., cam.link], f1, f2)


def contact_along(mechanism: Mechanism, cam: Cam, theta: ArrayLike) -> Contact:
    """Return the contacts at angles theta (k,) of the cam's joint, rad."""
    theta = np.asarray(theta, float)
    q = np.zeros((len(theta), mechanism.n))
    q[:, cam.driver] = theta
    law = law_derivatives(mechanism, cam.coupling, cam.driver, q, STEADY)
    return contact(cam.follower, theta, *law)


class ContactForce(NamedTuple):
    """The force on a follower, N, and a point on its line of action, m, ground axes, (...).

    `pressed` is its component along the contact's normal, away from the cam: the contact force.
    """

    cam: Cam
    place: Any
    force: Any
    pressed: Any


def forces_on_links(
    mechanism: Mechanism, at: Placed, slopes: Sequence[Any], torques: Sequence[Any]
) -> list[ContactForce]:
    """Return the forces of all cams for a placed mechanism, in numbers (...) or formulas.

    `slopes` are f' of the laws by the cams' angles, `torques` those of their couplings, in the
    order of the cams.  With n any vector along the normal, and V the velocity of the follower's
    point per rate of its joint, the force is n tc / (n . V); length and sign of n do not matter.
    """
    tree, found = Tree(mechanism.description.links), []

    def vector(first: Point, second: Point) -> Any:
        apart = points_of(mechanism, [tree.difference(first, second)])
        return np.moveaxis(apart.place(at), -1, 0)[0]

    for cam, f1, torque in zip(cams_of(mechanism), slopes, torques, strict=True):
        follower = cam.follower
        joint, touch = Point(cam.link, 0j), Point(cam.link, follower.at)
        apart = vector(touch, Point(cam.driver, 0j))
        place, arm = vector(touch, Point(None, 0j)), vector(touch, joint)
        slides = follower.axis is not None
        way = vector(Point(cam.link, 1.0 + 0j), joint) if slides else 1j * arm
        normal = 1j * (way * f1) + apart
        if follower.face is not None:
            D = vector(Point(cam.link, follower.face), joint)
            along = -(normal.conjugate() * D).real / (1.0 if slides else 1.0 - f1)
            place, apart = place + D * along, apart + D * along
            way = way if slides else 1j * (arm + D * along)
            normal = 1j * D
        force = normal * (torque / (normal.conjugate() * way).real)
        side = (normal.conjugate() * apart).real
        pressed = (normal.conjugate() * force).real * side / (abs(normal) * abs(side))
        found.append(ContactForce(cam, place, force, pressed))
    return found


def contacts_on_links(
    mechanism: Mechanism, q: Array, at: Placed, multipliers: ArrayLike
) -> list[ContactForce]:
    """Return the forces of all cams at q (..., n)."""
    if not (cams := cams_of(mechanism)):
        return []
    torques = coupling_torques(mechanism, multipliers)
    slopes = [law_derivatives(mechanism, cam.coupling, cam.driver, q, STEADY)[1] for cam in cams]
    own = [torques[..., cam.coupling] for cam in cams]
    with np.errstate(all="ignore"):
        return forces_on_links(mechanism, at, slopes, own)


class Profile(NamedTuple):
    """A cam over the turn, or the range, of its joint; m and rad.

    `base_circle` is a radius.  `offset` is the distance by which the path of a sliding follower
    passes the cam's joint on the right; None for a turning follower.  `pressure` is the largest
    pressure angle.  `least_radius` is the least radius of curvature of a convex part, negative if
    the profile is undercut, infinite if nothing is convex.  `undercut` is the cam's angle there if
    it is undercut, else None.  `face` has the ends of the contact on a flat face, from its point.
    `closed` tells whether the profile ends where it begins, `one_side` whether no tangent passes
    through the cam's joint.
    """

    base_circle: float
    offset: float | None
    pressure: float
    least_radius: float
    undercut: float | None
    face: tuple[float, float] | None
    closed: bool
    one_side: bool


def span(mechanism: Mechanism, cam: Cam) -> tuple[float, float]:
    """Return the angles of the cam between which its profile lies.

    They are its joint's limits, or the rows of a table that does not repeat; else a full turn.
    """
    low, high = 0.0, TURN
    law = mechanism.description.couplings[cam.coupling].law
    if isinstance(law, Curve) and not law.repeats:
        return law.x[0], min(law.x[-1], law.x[0] + TURN)
    own: Range | None = next((x for x in mechanism.ranges if x.joint == cam.driver), None)
    if own is not None:
        ends = dict(own.ends)
        low = ends.get(-1, max(low, ends.get(1, TURN) - TURN))
        high = min(ends.get(1, low + TURN), low + TURN)
    return low, high


def profile_of(mechanism: Mechanism, cam: Cam) -> Profile:
    """Return base circle, pressure angle, curvature and other properties of a cam."""
    low, high = span(mechanism, cam)
    follower = cam.follower

    def touch(theta: Array) -> Contact:
        return contact_along(mechanism, cam, theta)

    base, _ = _least(lambda x: np.abs(touch(x).profile), low, high)
    most, _ = _least(lambda x: -np.abs(touch(x).pressure), low, high)
    least, where = _least(lambda x: convex_radius(follower, touch(x)), low, high)
    offset, face = None, None
    if follower.axis is not None:
        at = follower.at if follower.face is None else 0j
        way = (follower.turn * at + follower.joint - follower.pivot) / follower.axis
        offset = -way.imag
    if follower.face is not None:
        first, _ = _least(lambda x: touch(x).along, low, high)
        last, _ = _least(lambda x: -touch(x).along, low, high)
        face = first, -last
    whole = touch(np.linspace(low, high, SAMPLES + 1))
    apart = abs(whole.profile[-1] - whole.profile[0])
    turned = (whole.normal[1:] * whole.normal[:-1].conj()).real
    return Profile(
        base_circle=base,
        offset=offset,
        pressure=-most,
        least_radius=least,
        undercut=where if least < 0.0 else None,
        face=face,
        closed=bool(apart <= CLOSED * np.abs(whole.profile).max()),
        one_side=bool((turned > 0.0).all()),
    )


def _least(f: Callable[[Array], Array], low: float, high: float) -> tuple[float, float]:
    """Return the least value of a function of angles, and its place; infinite if there is none."""
    first, last = low, high
    count, value, where = SAMPLES, math.inf, low
    for _ in range(ZOOMS):
        theta = np.linspace(first, last, count + 1)
        values = f(theta)
        values = np.where(np.isnan(values), np.inf, values)
        k = int(np.argmin(values))
        if values[k] < value:
            value, where = float(values[k]), float(theta[k])
        apart = (last - first) / count
        first, last, count = max(low, where - apart), min(high, where + apart), NODES
    return value, where


def outline(mechanism: Mechanism, cam: Cam, count: int) -> tuple[Array, Contact]:
    """Return the cam's angles (count + 1,) over its profile, and the contacts."""
    theta = np.linspace(*span(mechanism, cam), count + 1)
    return theta, contact_along(mechanism, cam, theta)
