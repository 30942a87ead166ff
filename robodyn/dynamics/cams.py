"""Disc cams: pitch curve, profile, pressure angle and curvature from a follower's law.

Points of the plane are complex numbers, m.  The cam turns by theta about its joint; the follower
turns or slides by f(theta).  Both joints are on one carrier, in whose frame they are placed.  With
P the roller's centre in that frame, A the cam's joint and V = dP/df, the pitch curve is

    w = e^(-i theta) (P - A)        w' = e^(-i theta) (f' V - i (P - A))

in the frame of the cam.  The profile is its parallel curve at the roller's radius, on the side of
the cam's joint.  A flat face is a line w + s D along D = e^(i (f - theta)) d (for a turning
follower).  The profile is its envelope: the line moves along itself at the contact, so that

    s = (w' . i D) / b      b = 1 - f' (turning), 1 (sliding)      D' = -i b D

and since the profile runs along D, its radius of curvature is -(w' . D + s') / b, counted along D.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.tables.arrays import Array, Complex


class Follower(NamedTuple):
    """How a follower is mounted, and the roller or face with which it touches the cam.

    `pivot` is the cam's joint and `joint` the follower's, in the frame of the carrier, m.  `axis`
    is the unit vector along which the follower slides; None if it turns.  `at` is the roller's
    centre, or a point of the face, in the follower's frame, m.  `face` is the face's unit vector
    there; None for a roller of `radius`, m.  `turn` and `cam_turn` are the unit vectors of the x
    axes of follower and cam at zero of their joints, in the carrier's frame.
    """

    pivot: complex
    joint: complex
    axis: complex | None
    at: complex
    face: complex | None = None
    radius: float = 0.0
    turn: complex = 1.0 + 0j
    cam_turn: complex = 1.0 + 0j


class Contact(NamedTuple):
    """The contact of a cam with its follower; each value is (...).

    In the frame of the cam, m: the `pitch` curve (roller's centre, or foot of the face's point),
    the `profile`, and the unit vector `normal` from cam to follower.  `pressure` is the angle
    between the velocity of the follower's point and the normal, rad; NaN if that point does not
    move.  `curvature` is that of the profile, 1/m, positive if convex; `pitch_curvature` that of
    the pitch curve (for a flat face, of the profile).  `along` is the place of the contact on the
    face, m from its point (0 for a roller).  `side` is 1 if the normal is on the left of the face,
    or of the pitch curve, else -1.
    """

    pitch: Complex
    profile: Complex
    normal: Complex
    pressure: Array
    curvature: Array
    pitch_curvature: Array
    along: Array
    side: Array


def contact(
    follower: Follower, theta: ArrayLike, f: ArrayLike, f1: ArrayLike, f2: ArrayLike
) -> Contact:
    """Return the contact at the cam's angle theta, rad, with the law f and f', f''.

    All are (...) and broadcast.  Undefined values are NaN or infinite: the curvature at a point or
    tip.
    """
    theta, f, f1, f2 = np.broadcast_arrays(*(np.asarray(x, float) for x in (theta, f, f1, f2)))
    with np.errstate(all="ignore"):
        return _contact(follower, theta, f, f1, f2)


def _contact(follower: Follower, theta: Array, f: Array, f1: Array, f2: Array) -> Contact:
    turns = follower.axis is None
    back = np.exp(-1j * theta) * follower.cam_turn.conjugate()  # into the frame of the cam
    own = follower.turn * np.exp(1j * f) if turns else np.full(f.shape, follower.turn)
    arm = own * follower.at
    slid = 0.0 if follower.axis is None else follower.axis * f
    from_pivot = arm + slid + (follower.joint - follower.pivot)
    way = 1j * arm if follower.axis is None else np.full(f.shape, follower.axis)  # dP/df
    bend = -arm if turns else np.zeros_like(arm)  # d2P/df2
    w = back * from_pivot
    w1 = back * (way * f1 - 1j * from_pivot)
    w2 = back * (way * f2 + bend * f1 * f1 - 2j * way * f1 - from_pivot)
    if follower.face is None:
        speed = np.abs(w1)
        side = np.where(_dot(1j * w1, w) >= 0.0, 1.0, -1.0)  # of the normal that leads outward
        normal = side * 1j * w1 / speed
        # of the pitch curve, positive where its centre is on the side of the cam
        bent = -side * _dot(1j * w1, w2) / speed**3
        curvature = bent / (1.0 - follower.radius * bent)
        profile, along = w - follower.radius * normal, np.zeros(f.shape)
    else:
        D = back * own * follower.face
        b = 1.0 - f1 if turns else np.ones(f.shape)
        b1 = -f2 if turns else np.zeros(f.shape)
        across = _dot(1j * D, w1)
        along = across / b
        across1 = _dot(b * D, w1) + _dot(1j * D, w2)
        speed = _dot(D, w1) + (across1 * b - across * b1) / (b * b)  # along D
        profile = w + along * D
        side = np.where(_dot(1j * D, w) >= 0.0, 1.0, -1.0)
        normal = side * 1j * D
        curvature = bent = side * b / speed
        contact_arm = arm + along * own * follower.face
        way = 1j * contact_arm if turns else way
    outward = np.where(_dot(way, normal / back) < 0.0, -way, way)
    pressure = np.where(way == 0.0, np.nan, np.angle(normal / back * outward.conj()))
    return Contact(w, profile, normal, pressure, curvature, bent, along, side)


def convex_radius(follower: Follower, touch: Contact) -> Array:
    """Return the radius of curvature of convex parts, (...), m; negative if undercut.

    Then a roller is larger than the radius of the pitch curve, or a flat face meets a hollow.
    Infinite where a roller's pitch curve is hollow or straight.
    """
    with np.errstate(divide="ignore"):
        if follower.face is not None:
            return np.asarray(1.0 / touch.curvature)
        bent = touch.pitch_curvature
        return np.where(bent > 0.0, 1.0 / bent - follower.radius, np.inf)


def _dot(a: Complex, b: Complex) -> Array:
    """Return the products a . b of plane vectors."""
    return np.asarray((np.conj(a) * b).real)
