"""Motion of named points of a mechanism, and turns of its links.

A point is p = const + c X (`placed.py`), so p' = c X' and dp/dq = c dX/dx J. In the minimal
coordinates, the actuated joints, dp = dp/dq N with N the joints' rates for each of these at rate 1.
"""

from __future__ import annotations

import cmath
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.closed_form import point_motion, points_of
from robodyn.errors import InputError
from robodyn.loops.loop_rates import closing_rates
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.mechanics.placed import absolute_rates, as_states, columns, frame_rates, placed
from robodyn.scene.point_names import Places, places_of
from robodyn.scene.scene import Point
from robodyn.scene.yaml_values import nearest
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown
from robodyn.tables.short_repr import short_repr

WAYS = "a link (its tip), tip2, centre1, joint3, LINK@x,y or a point of the scene"


class NamedPoint(NamedTuple):
    """A named point of a link: in the frame of the link, and in terms of X."""

    name: str
    own: Point
    point: PlanarPoint


def named_points(
    mechanism: Mechanism, texts: str | Sequence[str] = (), where: str = "of"
) -> list[NamedPoint]:
    """Return the points written as POINT or NAME=POINT; default: the scene's, else all tips.

    A text may list several, separated by commas.  A place LINK@x,y without a name is called point1,
    ..., by its position in the list.  Raises InputError, which names `where`, for an unknown point,
    for two points with one name, and for a value that is no text.
    """
    try:
        texts = [texts] if isinstance(texts, str) else list(texts)
        of_text = all(isinstance(text, str) for text in texts)
    except TypeError:
        of_text = False
    if not of_text:
        limit = "must be the name of a point, or several"
        raise InputError(where, value=shown(repr(texts)), limit=limit)
    places = places_of(mechanism.description)
    texts = (
        [x for text in texts for x in _listed(places, text)]
        or [name for name, _ in mechanism.description.points]
        or [f"tip{k + 1}" for k in range(mechanism.n)]
    )
    found: dict[str, Point] = {}
    for k, text in enumerate(texts, start=1):
        name, point = _named(places, text, k, where)
        if name in found:
            given, equals, written = text.partition("=")
            place = written.strip() if equals and given.strip() == name else text
            limit = f"{name} is named twice: name one anew, NAME={shown(place)}"
            raise InputError(where, value=shown(text), limit=limit)
        found[name] = point
    tree = Tree(mechanism.description.links)
    return [NamedPoint(name, point, tree.point(point)) for name, point in found.items()]


def named_point(mechanism: Mechanism, text: str, where: str = "of") -> NamedPoint:
    """Return the single point written as POINT or NAME=POINT; InputError for none or several."""
    found = named_points(mechanism, [text], where)
    if len(found) > 1:
        raise InputError(where, value=shown(text), limit=f"names {len(found)} points; give one")
    return found[0]


def _is_of_link(places: Places, text: str) -> bool:
    """Return whether a text is a link or a place on one; names may contain commas and =."""
    link, _, offset = text.rpartition("@")
    return text in places.links or (link in places.links and offset.count(",") == 1)


def _listed(places: Places, text: str) -> list[str]:
    """Return the points in a text, split at commas outside places and names."""
    name, _, written = text.partition("=")
    whole = not text or _is_of_link(places, text)
    whole |= "," not in name and _is_of_link(places, written)
    return [text] if whole else re.findall(r"[^,@]*@[^,]*,[^,]*|[^,]+|(?<=,)$", text)


def _named(places: Places, text: str, k: int, where: str) -> tuple[str, Point]:
    """Return the name and the point of the k-th text."""
    given, equals, written = text.partition("=")
    known = _is_of_link(places, text) or not equals
    name, written = ("", text) if known else (given.strip(), written)
    if not _is_of_link(places, written):  # of which the spaces around it may be a part
        written = written.strip()
    try:
        point = places.point(written)
    except ValueError as error:
        raise InputError(where, value=shown(text), limit=str(error)) from None
    if point is None:
        word = written.rpartition("@")[0] or written
        limit = f"names no point{nearest(word, [*places.points, *places.links])} ({WAYS})"
        raise InputError(where, value=shown(text), limit=limit)
    if name and (limit := places.not_free(name)):
        raise InputError(where, value=shown(text), limit=f"{name} {limit}")
    return name or (f"point{k}" if "@" in written else written), point


@short_repr
class PointMotion(NamedTuple):
    """Motion of p points: position m, velocity m/s, acceleration m/s^2, (..., p, 2) each."""

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
    """Return the motion of points at closed states q, qd, qdd (..., n); missing rates are zero.

    `of` has names of points, `coupler@0.5,0.2` or `P=coupler@0.5,0.2`; if empty, the scene's
    points, else all tips.  Raises InputError for an unknown point, and for shapes that do not fit.
    """
    named = named_points(mechanism, of)
    moved = point_motion(mechanism, [point for *_, point in named], q, qd, qdd)
    return PointMotion(tuple(name for name, *_ in named), *moved)


def point_jacobian(mechanism: Mechanism, points: Sequence[PlanarPoint], q: ArrayLike) -> Array:
    """Return dp/dq of points, (..., p, 2, n), m/rad or 1."""
    at = placed(mechanism, q)
    moved = columns(
        mechanism, points_of(mechanism, points).c, at.X[..., None, :], at.E[..., None, :]
    )
    moved = moved @ mechanism.arrays.J
    return np.stack([moved.real, moved.imag], axis=-2)


def unit_rates(mechanism: Mechanism, q: ArrayLike, t: ArrayLike) -> Array:
    """Return N (..., n, a): the rates of all joints for rate 1 of each actuated joint.

    Motion by laws of time is not included.  Raises SingularError at a dead centre or change point.
    """
    q = as_states(mechanism, "q", q)
    each = np.eye(len(mechanism.actuated))
    given = np.broadcast_to(each, (*q.shape[:-1], *each.shape))
    found = closing_rates(mechanism, q[..., None, :], given, 0.0, np.asarray(t)[..., None])
    return np.swapaxes(found, -1, -2)


def link_turns(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
) -> tuple[Array, Array, Array]:
    """Return angle rad, rate rad/s and acceleration rad/s^2 of each link's frame, (..., n) each."""
    alpha = frame_rates(mechanism, placed(mechanism, q).x)  # as rates go, so go the angles
    phases = [cmath.phase(phase) for phase in Tree(mechanism.description.links).phases]
    rates = (absolute_rates(mechanism, x, name) for x, name in ((qd, "qd"), (qdd, "qdd")))
    w, wd = (frame_rates(mechanism, x) for x in rates)
    return alpha + np.array(phases), w, wd
