"""Points of a mechanism by name, and how they move at one state, in plain floats.

For one state a command needs no numpy, whose import takes longer than all else.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from robodyn.errors import InputError
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.scene.point_names import Places, places_of
from robodyn.scene.scene import Point
from robodyn.scene.yaml_values import nearest
from robodyn.tables.csv_fields import shown

WAYS = "a link (its tip), tip2, centre1, joint3, LINK@x,y or a point of the scene"


class NamedPoint(NamedTuple):
    """A point of a link by its name: in the frame of the link, and in terms of X."""

    name: str
    own: Point
    point: PlanarPoint


def named_points(
    mechanism: Mechanism, texts: str | Sequence[str] = (), where: str = "of"
) -> list[NamedPoint]:
    """The points that are written as POINT or NAME=POINT; the scene's, else all tips, for none.

    A text may have several, with commas between them.  A place LINK@x,y without a name is point1,
    ..., by its place in the list.  Raises InputError, naming `where`, for a point that is not there
    for two of one name and for what is no text.
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
        or list(places.points)
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
    """The one point that is written as POINT or NAME=POINT; InputError for none and for several."""
    found = named_points(mechanism, [text], where)
    if len(found) > 1:
        raise InputError(where, value=shown(text), limit=f"names {len(found)} points; give one")
    return found[0]


def _is_of_link(places: Places, text: str) -> bool:
    """Whether this is a link, or a place of one; names of links may have commas and = in them."""
    link, _, offset = text.rpartition("@")
    return text in places.links or (link in places.links and offset.count(",") == 1)


def _listed(places: Places, text: str) -> list[str]:
    """The points of a text, at commas but for those after an @ and those of names of links."""
    name, _, written = text.partition("=")
    whole = not text or _is_of_link(places, text)
    whole |= "," not in name and _is_of_link(places, written)
    return [text] if whole else re.findall(r"[^,@]*@[^,]*,[^,]*|[^,]+|(?<=,)$", text)


def _named(places: Places, text: str, k: int, where: str) -> tuple[str, Point]:
    """The name and the point of the k-th text."""
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


def point_columns(named: Sequence[NamedPoint]) -> list[str]:
    """Where each point is, its velocity and its acceleration."""
    return [f"{point.name}_{x}" for point in named for x in ("x", "y", "vx", "vy", "ax", "ay")]


def values_of_points(
    mechanism: Mechanism, points: Sequence[PlanarPoint], *motion: Sequence[float]
) -> list[float]:
    """Of each point x, y, their rates and accelerations, one after another, at q, qd, qdd (n).

    Raises ValueError for sums of angles that are not finite.
    """
    from robodyn.engines.frames import absolute, start
    from robodyn.engines.series import FLOATS, Series
    from robodyn.mechanics.link_rows import LinkRows
    from robodyn.mechanics.program import Derivative

    rows = LinkRows(mechanism)
    program, slots = rows.program, []
    for point in points:
        place = rows.point(point)
        rate = program.add(Derivative(place))
        slots += [place, rate, program.add(Derivative(rate))]
    q, qd, qdd = motion
    state = start(mechanism, FLOATS, (q, qd), accelerations=absolute(mechanism, qdd))
    series = Series(program, FLOATS, program.numbers, 1, state, slots=slots, grounded=True)
    series.residuals(0)
    return [x for slot in slots for x in series.ground(slot, 0)]
