"""Welds: links without a joint, as parts of what they hang from.

With z a vector of a weld's frame, E its turn and p its joint's place on the link that carries it,
p + E z is the point of that link.  Mass, first moment and moment of inertia about one origin add.
"""

from __future__ import annotations

import cmath
from typing import NamedTuple

from robodyn.elements.base import Element
from robodyn.errors import InputError
from robodyn.scene.scene import Closure, Description, Link, Point, Weld


class Frame(NamedTuple):
    """Origin and turn of a body's frame in the frame of the link that it is part of."""

    origin: Point
    turn: complex


class Welded:
    """The frames of a scene's bodies in those of its links."""

    def __init__(self, description: Description) -> None:
        self.welds, self.count = description.welds, len(description.links)
        self._frames: dict[int, Frame] = {}

    def frame(self, k: int | None) -> Frame:
        """The frame of body k; that of a link, or of the ground, is its own."""
        if k is None or k < self.count:
            return Frame(Point(k, 0j), 1.0 + 0j)
        if k not in self._frames:
            weld = self.welds[k - self.count]
            above = self.frame(weld.hangs_from.link)
            own = cmath.rect(1.0, weld.angle) if weld.angle else 1.0 + 0j
            self._frames[k] = Frame(self.point(weld.hangs_from), _times(above.turn, own))
        return self._frames[k]

    def point(self, point: Point) -> Point:
        """A point as one of a link, or of the ground."""
        if point.link is None or point.link < self.count:
            return point
        origin, turn = self.frame(point.link)
        return Point(origin.link, origin.at + _times(turn, point.at))

    def link(self, k: int | None) -> int | None:
        """The link that body k is part of; None for the ground."""
        return self.frame(k).origin.link

    def turn(self, k: int | None) -> complex:
        return self.frame(k).turn


def without_welds(description: Description) -> Description:
    """The scene with each weld as a part of what it hangs from; `apart` is the scene as it was.

    Its welds remain, without masses, for their names.  Raises InputError for a closure that joins
    two points of one link so.
    """
    if not description.welds:
        return description
    welded = Welded(description)
    carried: dict[int, list[Weld]] = {}
    for w in range(len(description.welds)):
        k = welded.link(welded.count + w)
        if k is not None:
            carried.setdefault(k, []).append(description.welds[w])
    links = [_hung(link, welded) for link in description.links]
    for k, parts in carried.items():
        links[k] = _composite(links[k], parts, description, welded)
    found = description._replace(
        apart=description.apart or description,
        links=tuple(links),
        closures=tuple(_closed(closure, welded) for closure in description.closures),
        springs=tuple(_acting(description.springs, welded)),
        loads=tuple(_acting(description.loads, welded)),
        points=tuple((name, welded.point(point)) for name, point in description.points),
        pins=tuple((name, welded.point(point)) for name, point in description.pins),
        welds=tuple(weld._replace(m=0.0, I=0.0, payload=0.0) for weld in description.welds),
    )
    for c, closure in enumerate(found.closures):
        if closure.first.link == closure.second.link:
            name = "the ground" if closure.first.link is None else links[closure.first.link].name
            limit = f"joins two points of {name}, which welds make one; they must move apart"
            raise InputError(f"closures[{c}]", where=description.source, limit=limit)
    return found


def _times(turn: complex, z: complex) -> complex:
    return z if turn == 1.0 else turn * z


def _hung(link: Link, welded: Welded) -> Link:
    """A link on the link that carries it, its own zero as it was."""
    turn, hangs_from = welded.turn(link.hangs_from.link), welded.point(link.hangs_from)
    if link.axis is not None:
        return link._replace(hangs_from=hangs_from, axis=_times(turn, link.axis))
    return link._replace(hangs_from=hangs_from, turn=_times(turn, link.turn))


def _composite(link: Link, parts: list[Weld], scene: Description, welded: Welded) -> Link:
    """A link with the masses of its welds: their sum, its centre, and I about that."""
    names = {body.name: k for k, body in enumerate(scene.bodies)}
    mass, first = link.m, link.r * link.m
    about = link.I + link.m * _square(link.r)  # its own joint
    for part in parts:
        k = names[part.name]
        centre = welded.point(Point(k, part.r)).at
        mass = mass + part.m
        first = first + centre * part.m
        about = about + part.I + part.m * _square(centre)
        if part.payload:
            tip = welded.point(Point(k, part.l + 0j)).at
            mass = mass + part.payload
            first = first + tip * part.payload
            about = about + part.payload * _square(tip)
    centre = first * (1.0 / mass) if mass else link.r
    known = link.has_mass and all(part.has_mass for part in parts)
    return link._replace(m=mass, r=centre, I=about - mass * _square(centre), has_mass=known)


def _square(z: complex) -> float:
    return z.real * z.real + z.imag * z.imag


def _closed(closure: Closure, welded: Welded) -> Closure:
    along, aligned = closure.along, closure.aligned
    one, other = (welded.turn(point.link) for point in (closure.first, closure.second))
    if along is not None:
        along = _times(other, along)
    if aligned is not None:
        aligned = aligned + cmath.phase(other) - cmath.phase(one)
    first, second = welded.point(closure.first), welded.point(closure.second)
    return closure._replace(first=first, second=second, along=along, aligned=aligned)


def _acting(elements: tuple[Element, ...], welded: Welded) -> list[Element]:
    """Return the elements that act on links; those on the ground alone have no effect."""
    found = (element.moved(welded.point, welded.turn) for element in elements)
    return [element for element in found if element is not None]
