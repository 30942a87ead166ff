"""Points as people write them, in scenes and in options.

`rocker` is the tip of a link, `tip2`, `centre1` and `joint3` are those of the links 2, 1 and 3,
`coupler@0.5,0.2` is a place in the frame of a link, and a scene may name points of its own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from robodyn.errors import InputError
from robodyn.scene.constants import numbers_of
from robodyn.scene.quantities import NOTHING, parse_vector
from robodyn.scene.scene import Description, Point
from robodyn.scene.welds import Welded
from robodyn.tables.csv_fields import shown

PARTS = ("joint", "tip", "centre")
_PART = rf"({'|'.join(PARTS)})([0-9]{{1,6}})"
_NAME = r"[A-Za-z][\w-]{0,63}"


class Places:
    """The links by their names, where their tips and centres are in their frames, m, and points.

    `count` is that of the links with numbers, which welds have not; `whole` makes a point of a weld
    one of the link that it is part of; `named` are the constants of the scene.
    """

    def __init__(
        self,
        links: Mapping[str, int],
        tip: Callable[[int], complex],
        centre: Callable[[int], complex],
        count: Callable[[], int] | None = None,
        points: dict[str, Point] | None = None,
        whole: Callable[[Point], Point] = lambda point: point,
        has_mass: Callable[[int], bool] = lambda k: True,
        named: Mapping[str, Any] = NOTHING,
    ) -> None:
        self.has_mass, self.named = has_mass, named
        self.links, self.tip, self.centre = links, tip, centre
        self.count = count or (lambda: len(links))
        self.points, self.whole = points or {}, whole

    def point(self, text: str) -> Point | None:
        """The point that is written, None for a name that is not known.

        Raises ValueError where what follows an @ is no place.
        """
        if text in self.links:
            return self.whole(Point(self.links[text], self.tip(self.links[text])))
        if text in self.points:
            return self.points[text]
        link, at, offset = text.rpartition("@")
        if at and link in self.links:
            return self.whole(Point(self.links[link], _vector(offset, link, self.named)))
        part = re.fullmatch(_PART, text)
        if part is None or not 1 <= int(part[2]) <= self.count():
            return None
        k = int(part[2]) - 1
        if part[1] == "centre" and not self.has_mass(k):
            raise ValueError(
                f"is a centre of gravity, which link {k + 1} has not: it has no mass m"
            )
        return Point(k, {"joint": lambda _: 0j, "tip": self.tip, "centre": self.centre}[part[1]](k))

    def not_free(self, name: str) -> str:
        """Why a point must not have this name; empty where it may."""
        if not re.fullmatch(_NAME, name, re.ASCII):
            return "must be a letter, then letters, digits, _ or -"
        if name in self.links:
            return "is the name of a link: take another"
        return "is the name of a part of a link: take another" if re.fullmatch(_PART, name) else ""


def places_of(description: Description) -> Places:
    """The places of a scene."""
    bodies = description.bodies
    return Places(
        {body.name: k for k, body in enumerate(bodies)},
        lambda k: bodies[k].l + 0j,
        lambda k: bodies[k].r,
        lambda: len(description.links),
        dict(description.pins + description.points),
        Welded(description).point,
        lambda k: bodies[k].has_mass,
        numbers_of(description.constants),
    )


def _vector(offset: str, link: str, named: Mapping[str, Any]) -> complex:
    try:
        values = parse_vector(offset, where="", unit="m", named=named)
    except InputError:
        values = []
    if len(values) != 2:
        raise ValueError(f"must have x,y (m) after the @, as in {shown(link)}@0.5,0.2")
    return complex(*values)
