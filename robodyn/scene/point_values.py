"""Reads points of links and of the ground, by coordinates or by names."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, ClassVar

from robodyn.scene.point_names import Places
from robodyn.scene.quantities import parse_quantity
from robodyn.scene.scene import Point
from robodyn.scene.yaml_tree import Mapping, Node, Scalar, Sequence
from robodyn.scene.yaml_values import ValueReader


class PointReader(ValueReader):
    """The kinds of the grammar that are points, or name links.

    Names, lengths and centres of links are known before the links are read.
    """

    missing: ClassVar[dict[str, Any]] = {
        **ValueReader.missing,
        "link_name": 0,
        "joint_name": 0,
        "moving_point": Point(0, 0j),
        "pair": (Point(None, 0j),) * 2,
    }

    def __init__(self) -> None:
        super().__init__()
        self.index: dict[str, int] = {}  # link name -> index
        self.lengths: dict[int, float] = {}
        self.centres: dict[int, complex] = {}
        self.places = Places(
            self.index,
            lambda k: self.tip(k).at,
            lambda k: self.centres.get(k, 0j),
            lambda: self.count,
            named=self.named,
        )

    def survey_link(self, i: int, given: dict[str, Node]) -> None:
        """Collect what points need to know of link i, as far as its keys are valid."""
        with suppress(ValueError):
            self.lengths[i] = self._number(given.get("l"))
        with suppress(ValueError):
            r = given.get("r")
            x, y = r.items if isinstance(r, Sequence) else (r, None)
            self.centres[i] = complex(self._number(x), 0.0 if y is None else self._number(y))

    def _number(self, node: Node | None) -> float:
        """A length that a scalar has, m; ValueError if it has none."""
        return parse_quantity(node.text if isinstance(node, Scalar) else "", "m", self.named)

    def tip(self, link: int) -> Point:
        return Point(link, complex(self.lengths.get(link, 0.0)))

    def point(self, node: Node, place: str) -> Point:
        """A ground point [x, y], a name of a point, or {link: NAME, at: [x, y]}."""
        if isinstance(node, Sequence):
            return Point(None, self.vector(node, place, "m"))
        if isinstance(node, Scalar):
            return self.named_point(node, place) or Point(None, 0j)
        return self.record("point", node, place)  # type: ignore[no-any-return]

    def named_point(self, node: Scalar, place: str) -> Point | None:
        name = self.name(node, place)
        try:
            point = self.places.point(name)
        except ValueError as error:
            self.fault(place, node, str(error), self.shown(node))
            return None
        if name and point is None:
            known = [*self.places.points, *self.index]
            what = "link or point" if self.places.points else "link"
            self.fault(place, node, f"names no {what}{self.nearest(name, known)}", name)
        return point

    def points(self, node: Node, place: str) -> tuple[tuple[str, Point], ...]:
        """The points that `name_points` found before the rest was read."""
        return tuple(self.places.points.items())

    def name_points(self, node: Node, place: str) -> None:
        """Points by names, {P: {link: coupler, at: [0.5, 0.2]}, Q: rocker}."""
        if not isinstance(node, Mapping):
            limit = "must map names to points of links, {P: {link: coupler, at: [0.5, 0.2]}}"
            self.fault(place, node, limit, self.shown(node))
            return
        for key, value in node.pairs:
            name, where = key.text, f"{place}.{key.text}"
            if name in self.places.points:
                self.fault(where, key, "is given twice")
            elif limit := self.places.not_free(name):
                self.fault(where, key, limit)
            else:
                self.places.points[name] = self.moving_point(value, where)

    def moving_point(self, node: Node, place: str) -> Point:
        if isinstance(node, Sequence):
            self.fault(place, node, "must be a point of a link")
        return self.point(node, place)

    def link_name(self, node: Node, place: str) -> int | None:
        name = self.name(node, place)
        if name and name not in self.index:
            self.fault(place, node, f"names no link{self.nearest(name, list(self.index))}", name)
        return self.index.get(name)

    def joint_name(self, node: Node, place: str) -> int | None:
        """The joint of the link of this name."""
        link = self.link_name(node, place)
        return None if self.has_no_joint(self.shown(node), node, place) else link

    def has_no_joint(self, name: str, node: Node, place: str) -> bool:
        """Whether a link is a weld, which is a fault where its joint is named."""
        welded = self.index.get(name, 0) >= self.count > 0
        if welded:
            self.fault(place, node, "is fixed to what it hangs from: it has no joint", name)
        return welded

    def joints(self, node: Node, place: str) -> tuple[int, ...]:
        found: set[int] = set()
        for i, item in enumerate(self.items(node, place)):
            link = self.joint_name(item, f"{place}[{i}]")
            if link in found:
                self.fault(f"{place}[{i}]", item, "is named twice", self.shown(item))
            elif link is not None:
                found.add(link)
        return tuple(sorted(found))

    def pair(self, node: Node, place: str, sides: str = "points") -> tuple[Point, Point]:
        """Two points that can move apart."""
        nodes = self.items(node, place)
        if len(nodes) != 2:
            if isinstance(node, Sequence):
                limit = f"must name two {sides}, [POINT, POINT]"
                self.fault(place, node, limit, f"{len(nodes)} {sides}")
            return Point(None, 0j), Point(None, 0j)
        first, second = (self.point(item, f"{place}[{k}]") for k, item in enumerate(nodes))
        if first.link == second.link:
            whole = "the ground" if first.link is None else "one link"
            self.fault(place, node, f"joins two points of {whole}; {sides} must move apart")
        return first, second
