"""YAML -> description: strict keys, numbers, physics; the faults of a file named at once.

What a description holds is in `scene.py`, what the format allows in `grammar.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

from robodyn.errors import DescriptionError, Fault
from robodyn.scene import yaml_tree
from robodyn.scene.grammar import Key
from robodyn.scene.point_values import PointReader
from robodyn.scene.quantities import in_unit, parse_coupling
from robodyn.scene.scene import (
    BRANCHES,
    FRAMES,
    JOINTS,
    Closure,
    Coupling,
    Description,
    DryFriction,
    Friction,
    JointSpring,
    Law,
    Limits,
    Link,
    Load,
    Moment,
    Motor,
    Point,
    Spring,
    Tables,
    Written,
)
from robodyn.scene.varying import SignalReader
from robodyn.scene.yaml_tree import Mapping, Node, Scalar, Sequence
from robodyn.scene.yaml_values import TooManyFaults

ROUNDING = 4e-16  # part of J that m r^2 may miss it by in a point mass


def read(path: str | Path) -> Description:
    """The description in the scene file at `path`; DescriptionError with all of its faults."""
    return from_text(yaml_tree.read_text(Path(path)), str(path))


def from_text(text: str, source: str) -> Description:
    """The description that `text` writes; DescriptionError with all of its faults."""
    return from_tree(yaml_tree.parse(text, source), source, text)


def from_tree(
    root: Node | None, source: str, text: str = "", tables: Tables | None = None
) -> Description:
    """The description that a parsed scene holds, and its text, if it has one.

    Files of tables are read unless `tables` has them.  Raises DescriptionError with all faults.
    """
    if root is None:
        raise DescriptionError(source, [Fault("", "is empty: a scene needs at least `links`")])
    if not isinstance(root, Mapping):
        fault = Fault("", "must be a mapping of keys (links, gravity, ...)", line=root.line)
        raise DescriptionError(source, [fault])
    reader = _Reader(tables)
    with suppress(TooManyFaults):
        drawing = None
        if any(key.text == "pins" for key, _ in root.pairs):
            from robodyn.scene.drawn import Drawing  # other scenes start without it

            drawing = Drawing(root, reader)
        description = reader.scene(drawing.explicit() if drawing else root, source)
        if drawing and not reader.faults:
            drawing.check(description)
        if not reader.faults:
            return description._replace(written=Written(root, (), text, reader.tables))
    raise DescriptionError(source, sorted(reader.faults, key=lambda fault: fault.line or 0))


class _Reader(PointReader, SignalReader):
    """Walks the tree of a scene; a method each for the kinds of the grammar that need one."""

    missing: ClassVar[dict[str, Any]] = {
        **PointReader.missing,
        "varying": 0.0,
        "varying_vector": (0.0, 0.0),
    }

    def __init__(self, tables: Tables | None) -> None:
        super().__init__()
        self.tables = dict(tables or {})
        self.closures = 0  # how many were read

    # -- the scene ---------------------------------------------------------------------------

    def scene(self, root: Mapping, source: str) -> Description:
        listed = next((node for key, node in root.pairs if key.text == "links"), None)
        entries = listed.items if isinstance(listed, Sequence) else []
        if isinstance(listed, Sequence) and not entries:
            self.fault("links", listed, "must name at least one link", "[]")
        self.count, self.source = len(entries), source
        self.survey(entries)
        named = next((node for key, node in root.pairs if key.text == "points"), None)
        if named is not None:
            self.name_points(named, "points")
        values = self.form("scene", root, "")
        links = tuple(self.linked(k, value) for k, value in enumerate(values["links"] or ()))
        self.cycles(links, entries)
        gravity, words = values["gravity"], values["assembly"]
        if words is None or isinstance(words, str):
            words = (words or BRANCHES[0],) * self.closures if words or not values["start"] else ()
        return Description(
            source=source,
            name=Path(source).stem if values["name"] is None else values["name"],
            gravity=gravity if isinstance(gravity, complex) else -1j * gravity,
            links=links,
            closures=values["closures"] or (),
            branches=words,
            actuated=values["actuated"],
            start=values["start"],
            springs=values["springs"] or (),
            loads=values["loads"] or (),
            couplings=values["couplings"] or (),
            points=tuple(self.places.points.items()),
        )

    def assembly(self, node: Node, place: str) -> str | tuple[str, ...]:
        if not isinstance(node, Sequence):
            return self.word(node, place, BRANCHES)
        if not 0 < len(node.items) <= self.closures:  # a closure may close in one way alone
            limit = f"must be one word, or one for each of the {self.closures} closures"
            self.fault(place, node, limit, f"{len(node.items)} words")
        return tuple(
            self.word(item, f"{place}[{c}]", BRANCHES) for c, item in enumerate(node.items)
        )

    def start(self, node: Node, place: str) -> tuple[float | None, ...] | None:
        if not isinstance(node, Mapping):
            limit = "must map link names to angles, {crank: 30deg}"
            self.fault(place, node, limit, self.shown(node))
            return None
        angles: list[float | None] = [None] * self.count
        for name, value in self.keys(node, place, [], list(self.index), "link").items():
            if name in self.index:
                unit = "m" if self.index[name] in self.slides else "rad"
                key = Key("number", "", unit)
                angles[self.index[name]] = self.number(value, f"{place}.{name}", key)
        return tuple(angles)

    # -- links -------------------------------------------------------------------------------

    def survey(self, entries: list[Node]) -> None:
        """Names and lengths first: `from` may name a point of a link further down the file."""
        for i, entry in enumerate(entries):
            given = dict(_scalars(entry))
            if "joint" in given and given["joint"].text == JOINTS[1]:
                self.slides.add(i)
            if isinstance(entry, Mapping):
                self.survey_link(i, {key.text: value for key, value in reversed(entry.pairs)})
            name = given.get("name")
            if name and (earlier := self.index.setdefault(name.text, i)) != i:
                limit = f"is the name of links[{earlier}] too; names must differ"
                self.fault(f"links[{i}].name", name, limit, name.text)

    def link(self, node: Node, place: str) -> dict[str, Any]:
        given = dict(_scalars(node))
        name = given.get("name")
        place = place if name is None else f"{place} ({name.text})"
        values = self.form("link", node, place)
        slides = "joint" in given and given["joint"].text == JOINTS[1]
        if slides and "axis" not in values:
            limit = "is missing: the direction [dx, dy] that a prismatic joint slides along"
            self.fault(f"{place}.axis", node, limit)
        elif "axis" in values and "joint" in given and not slides:
            limit = "is of prismatic joints alone: write `joint: prismatic` with it"
            self.fault(f"{place}.axis", node, limit)
        values["I"] = self.central(values, node, place)
        return values

    def central(self, values: dict[str, Any], node: Node, place: str) -> float:
        """I = J - m |r|^2 of a link that tells J, the moment of inertia about its own joint."""
        J: float | None = values.pop("J")
        if J is None:
            return values["I"] or 0.0
        r = complex(values["r"])
        least = values["m"] * (r.real * r.real + r.imag * r.imag)
        if abs(J - least) <= ROUNDING * J:
            return 0.0  # a point mass
        if least > J:
            limit = f"must be at least m r^2 = {least:.6g} kg m^2: it is about the link's own joint"
            self.fault(f"{place}.J", node, limit, f"{J:g}")
        return float(J - least)

    def linked(self, i: int, values: dict[str, Any]) -> Link:
        """Link i of what its keys hold."""
        above = values.pop("from") or (self.tip(i - 1) if i else Point(None, 0j))
        values.pop("joint")
        return Link(**values | {"r": complex(values["r"]), "hangs_from": above})

    def motor(self, node: Node, place: str, kind: str) -> Motor:
        motor = Motor(**self.form(kind, node, place))
        pair = {"torque_constant": motor.torque_constant, "resistance": motor.resistance}
        missing = [name for name, value in pair.items() if value is None]
        if len(missing) == 1:
            other = next(name for name in pair if name not in missing)
            self.fault(f"{place}.{missing[0]}", node, f"is missing: {other} needs it beside itself")
        return motor

    def friction(self, node: Node, place: str, kind: str) -> Friction | DryFriction:
        faults = len(self.faults)
        values = list(self.form(kind, node, place).items())
        if len(values) == 2:
            return Friction(*(value for _, value in values))
        (name, moving), (_, static), (_, stribeck) = values
        if static < moving and len(self.faults) == faults:
            limit = f"must be at least the {name} in motion, {moving:g}"
            self.fault(f"{place}.static", node, limit, f"{static:g}")
        return DryFriction(moving, static, stribeck)

    def limits(self, node: Node, place: str, kind: str) -> Limits:
        faults = len(self.faults)
        values: dict[str, Any] = self.form(kind, node, place)
        low, high = values.pop("min"), values.pop("max")
        if len(self.faults) > faults:
            pass  # it is told what is wrong
        elif low is None and high is None:
            self.fault(place, node, "needs a min, a max, or both")
        elif low is not None and high is not None and not low < high:
            self.fault(f"{place}.max", node, f"must be above min, {low:g}", f"{high:g}")
        return Limits(low, high, **values)

    def cycles(self, links: tuple[Link, ...], entries: list[Node]) -> None:
        """Every link must hang from the ground in the end; each cycle is told once."""
        grounded: set[int] = set()
        for start in range(len(links)):
            path: dict[int, None] = {}
            link: int | None = start
            while link is not None and link not in grounded and link not in path:
                path[link] = None
                link = links[link].hangs_from.link
            if link in path:
                cycle = list(path)
                names = [links[k].name for k in [*cycle[cycle.index(link) :], link]]
                place = f"links[{link}] ({links[link].name}).from"
                self.fault(place, entries[link], f"hangs from itself: {' -> '.join(names)}")
            grounded.update(path)

    # -- closures, springs, loads ------------------------------------------------------------

    def closure(self, node: Node, place: str) -> Closure:
        self.closures += 1
        if not isinstance(node, Mapping):
            return Closure(*self.pair(node, place, "sides"))
        values = self.form("closure", node, place)
        line = values["on"] or {"link": None, "through": 0j, "along": 1 + 0j}
        first, carrier = values["point"], line["link"]
        if carrier is not None and first.link == carrier:
            limit = "is a line of the point's own link; they must move apart"
            self.fault(f"{place}.on", node, limit)
        return Closure(first, Point(carrier, line["through"]), line["along"], values["aligned"])

    def line(self, node: Node, place: str) -> dict[str, Any]:
        return self.form("line", node, place)

    def direction(self, node: Node, place: str) -> complex:
        """The unit vector."""
        faults, vector = len(self.faults), self.vector(node, place)
        if vector == 0 and len(self.faults) == faults:
            self.fault(place, node, "must point somewhere", "[0, 0]")
        vector /= max(abs(vector.real), abs(vector.imag)) or 1.0  # no square overflows
        return vector / (abs(vector) or 1.0)

    def spring(self, node: Node, place: str) -> Spring | JointSpring:
        values = self.form("spring", node, place)
        law = values.pop("law") or values.pop("table", None)
        values.pop("table", None)
        stiffness, damping = values["stiffness"] or 0.0, values["damping"]
        if isinstance(law, Law) and damping:
            limit = "stands beside law; damping is in the law, by its v"
            self.fault(f"{place}.damping", node, limit, damping)
        if "joint" in values:
            slides, lengths = values["joint"] in self.slides, "length" in values
            if slides != lengths:
                limit = f"is missing: the joint is {JOINTS[slides]}"
                self.fault(f"{place}.{('angle', 'length')[slides]}", node, limit)
            free = values["length" if lengths else "angle"]
            return JointSpring(values["joint"], stiffness, free, damping, law)
        first, second = values["between"]
        return Spring(first, second, stiffness, values["length"], damping, law)

    def load(self, node: Node, place: str) -> Load | Moment:
        values = self.form("load", node, place)
        if "torque" in values:
            link, torque = values["link"], values["torque"]
            plain = isinstance(torque, float)
            return Moment(link, torque) if plain else Moment(link, 0.0, torque)
        point = values["point"] if "point" in values else Point(values["link"], values["at"])
        parts = values["force"]
        constant = [x if isinstance(x, float) else 0.0 for x in parts]
        x, y = (None if isinstance(part, float) else part for part in parts)
        return Load(point, complex(*constant), values["frame"] == FRAMES[1], (x, y))

    # -- couplings ---------------------------------------------------------------------------

    def couplings(self, node: Node, place: str) -> tuple[Coupling, ...]:
        """A list of equations, or a single one, `q3 = -2 q1 + 0.1`."""
        single = isinstance(node, Scalar)
        found: dict[int, Coupling] = {}  # by the joint that they give
        for c, entry in enumerate([node] if single else self.items(node, place)):
            where = place if single else f"{place}[{c}]"
            coupling = self.coupling(entry, where, self.count)
            if coupling is None:
                continue
            if coupling.joint in found:
                limit = f"gives q{coupling.joint + 1} a second time"
                self.fault(where, entry, limit, self.shown(entry))
            found[coupling.joint] = coupling
        return tuple(found.values())

    def coupling(self, node: Node, place: str, count: int) -> Coupling | None:
        text = self.name(node, place)
        try:
            joint, value = parse_coupling(text)
            named = joint, *value.joints
            if unknown := [k for k in named if not 1 <= k <= count]:
                raise ValueError(f"names q{unknown[0]}; the joints are q1 to q{count}")
            if joint in value.joints:
                raise ValueError(f"has q{joint} on both sides")
            units = {k: "m" if k - 1 in self.slides else "rad" for k in named}
            own = units[joint]
            ratios = {k: in_unit(x, f"{own}/{units[k]}") for k, x in value.joints.items()}
            constant = in_unit(value._replace(joints={}), own)
        except ValueError as error:
            if text:  # else it is told that it is no name
                self.fault(place, node, str(error), self.shown(node))
            return None
        return Coupling(joint - 1, tuple((k - 1, x) for k, x in ratios.items() if x), constant)


def _scalars(node: Node) -> Iterator[tuple[str, Scalar]]:
    """The first of each key of a mapping whose value is a scalar."""
    if isinstance(node, Mapping):
        for key, value in reversed(node.pairs):
            if isinstance(value, Scalar):
                yield key.text, value
