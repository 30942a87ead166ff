"""Strict reading of points, springs, loads, friction and couplings from a YAML tree."""

from __future__ import annotations

from robodyn.scene.quantities import parse_angle, parse_coupling
from robodyn.scene.scene import (
    FRAMES,
    Coupling,
    Friction,
    JointSpring,
    Load,
    Moment,
    Point,
    Spring,
)
from robodyn.scene.yaml_tree import Mapping, Node, Scalar, Sequence
from robodyn.scene.yaml_values import ValueReader


class ForceReader(ValueReader):
    """Reads what names points of links; the names and lengths of all links must be known."""

    def __init__(self) -> None:
        super().__init__()
        self.index: dict[str, int] = {}  # link name -> index
        self.lengths: dict[int, float] = {}

    # -- points ------------------------------------------------------------------------------

    def tip(self, link: int) -> Point:
        return Point(link, complex(self.lengths.get(link, 0.0)))

    def point(self, node: Node, place: str) -> Point:
        """A ground point [x, y], a link's tip NAME, or {link: NAME, at: [x, y]}."""
        if isinstance(node, Sequence):
            return Point(None, self.vector(node, place))
        if isinstance(node, Scalar):
            link = self.link_name(node, place)
            return Point(None, 0j) if link is None else self.tip(link)
        keys = self.keys(node, place, ["link", "at"], [])
        link = self.link_name(keys["link"], f"{place}.link") if "link" in keys else None
        return Point(link, self.vector(keys["at"], f"{place}.at") if "at" in keys else 0j)

    def link_name(self, node: Node, place: str) -> int | None:
        name = self.text(node, place)
        if name and name not in self.index:
            self.fault(place, node, f"names no link{self.nearest(name, list(self.index))}", name)
        return self.index.get(name)

    # -- springs and loads -------------------------------------------------------------------

    def spring(self, place: str, node: Node) -> Spring | JointSpring:
        if isinstance(node, Mapping) and any(key.text == "joint" for key, _ in node.pairs):
            keys = self.keys(node, place, ["joint", "stiffness", "angle"], ["damping"])
            joint = self.link_name(keys["joint"], f"{place}.joint") if "joint" in keys else None
            angle = 0.0
            if "angle" in keys:
                angle = self.number(keys["angle"], f"{place}.angle", parse_angle)
            stiffness, damping = self.amounts(keys, place, "stiffness", "damping")
            return JointSpring(joint or 0, stiffness, angle, damping)
        keys = self.keys(node, place, ["between", "stiffness", "length"], ["damping"])
        ends = [Point(None, 0j)] * 2
        if "between" in keys:
            between = keys["between"]
            sides = self.items(between, f"{place}.between")
            if isinstance(between, Sequence) and len(sides) != 2:
                limit = "must name two points, [POINT, POINT]"
                self.fault(f"{place}.between", between, limit, f"{len(sides)} points")
            elif sides:
                ends = [self.point(side, f"{place}.between[{k}]") for k, side in enumerate(sides)]
                if ends[0].link == ends[1].link:
                    whole = "the ground" if ends[0].link is None else "one link"
                    limit = f"joins two points of {whole}; its ends must move apart"
                    self.fault(f"{place}.between", between, limit)
        return Spring(
            ends[0], ends[1], *self.amounts(keys, place, "stiffness", "length", "damping")
        )

    def amounts(self, keys: dict[str, Node], place: str, *names: str) -> list[float]:
        return [
            self.amount(keys[name], f"{place}.{name}") if name in keys else 0.0 for name in names
        ]

    def load(self, place: str, node: Node) -> Load | Moment:
        turning = isinstance(node, Mapping) and any(key.text == "torque" for key, _ in node.pairs)
        if turning:
            keys = self.keys(node, place, ["link", "torque"], [])
        else:
            keys = self.keys(node, place, ["link", "at", "force"], ["frame"])
        link = self.link_name(keys["link"], f"{place}.link") if "link" in keys else None
        if turning:
            return Moment(link or 0, self.number(keys["torque"], f"{place}.torque"))
        at = self.vector(keys["at"], f"{place}.at") if "at" in keys else 0j
        force = self.vector(keys["force"], f"{place}.force") if "force" in keys else 0j
        frame = self.text(keys["frame"], f"{place}.frame") if "frame" in keys else FRAMES[0]
        if frame not in FRAMES:
            self.fault(f"{place}.frame", keys["frame"], "must be ground or link", frame)
        return Load(Point(link or 0, at), force, frame == FRAMES[1])

    def friction(self, node: Node | None, place: str) -> Friction | None:
        if node is None:
            return None
        keys = self.keys(node, place, ["torque", "speed"], [])
        torque = self.amount(keys["torque"], f"{place}.torque") if "torque" in keys else 0.0
        speed = self.number(keys["speed"], f"{place}.speed") if "speed" in keys else 1.0
        if not speed > 0.0:
            limit = "must be > 0: the friction is -torque tanh(qd/speed)"
            self.fault(f"{place}.speed", keys["speed"], limit, self.shown(keys["speed"]))
            return None
        return Friction(torque, speed)

    # -- couplings ---------------------------------------------------------------------------

    def couplings(self, node: Node | None, count: int) -> tuple[Coupling, ...]:
        """A list of equations, or a single one, `q3 = -2 q1 + 0.1`."""
        if node is None:
            return ()
        entries = [node] if isinstance(node, Scalar) else self.items(node, "couplings")
        found: dict[int, Coupling] = {}  # by the joint that they give
        for c, entry in enumerate(entries):
            place = "couplings" if isinstance(node, Scalar) else f"couplings[{c}]"
            coupling = self.coupling(entry, place, count)
            if coupling is None:
                continue
            if coupling.joint in found:
                limit = f"gives q{coupling.joint + 1} a second time"
                self.fault(place, entry, limit, self.shown(entry))
            found[coupling.joint] = coupling
        return tuple(found.values())

    def coupling(self, node: Node, place: str, count: int) -> Coupling | None:
        text = self.text(node, place)
        try:
            joint, terms, angle = parse_coupling(text)
        except ValueError as error:
            if text:
                self.fault(place, node, str(error), self.shown(node))
            return None
        unknown = [k for k in (joint, *terms) if not 1 <= k <= count]
        if unknown:
            limit = f"names q{unknown[0]}; the joints are q1 to q{count}"
            self.fault(place, node, limit, self.shown(node))
            return None
        if joint in terms:
            self.fault(place, node, f"has q{joint} on both sides", self.shown(node))
            return None
        ratios = tuple((k - 1, ratio) for k, ratio in terms.items() if ratio != 0.0)
        return Coupling(joint - 1, ratios, angle)
