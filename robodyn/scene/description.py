"""YAML -> description: strict keys, numbers, physics; the faults of a file named at once.

What a description holds is in `scene.py`, what the format allows in `grammar.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

from robodyn.elements.keys import Key
from robodyn.elements.values import FRAMES
from robodyn.errors import DescriptionError, Fault
from robodyn.scene import yaml_tree
from robodyn.scene.constants import (
    Constant,
    Constants,
    constant_of,
    cycle,
    in_order,
    node_of,
    not_free,
)
from robodyn.scene.expressions import names_of
from robodyn.scene.point_values import PointReader
from robodyn.scene.quantities import is_plain, parse_coupling, state_variables
from robodyn.scene.scene import (
    BRANCHES,
    JOINTS,
    Body,
    Cam,
    Closure,
    Coupling,
    Description,
    Law,
    Line,
    Link,
    Point,
    Tables,
    Written,
)
from robodyn.scene.units import Named
from robodyn.scene.varying import SignalReader
from robodyn.scene.yaml_tree import Mapping, Node, Scalar, Sequence
from robodyn.scene.yaml_values import TooManyFaults

LAW_KEYS = ("law", "table")  # of a mapping that is a coupling
UNIT = 4e-16  # by which rounding may leave a unit vector longer or shorter than 1


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
        reader.name_constants(root)
        drawing = None
        if any(key.text == "pins" for key, _ in root.pairs):
            from robodyn.scene.drawn import Drawing  # other scenes start without it

            drawing = Drawing(root, reader)
        description = reader.scene(drawing.explicit() if drawing else root, source)
        if drawing and not reader.faults:
            description = description._replace(pins=tuple(drawing.shared()))
            drawing.check(description)
        if not reader.faults:
            return description._replace(written=Written(root, (), text, reader.tables))
    raise DescriptionError(source, sorted(reader.faults, key=lambda fault: fault.line or 0))


class _Reader(PointReader, SignalReader):
    """Walks the tree of a scene; a method each for the kinds of values that need one."""

    missing: ClassVar[dict[str, Any]] = {
        **PointReader.missing,
        "frame": False,
        "line": Line(None, 0j, 1.0 + 0j),
        "gravity": 0j,
        "varying": 0.0,
        "varying_vector": (0.0, 0.0),
        "varying_place": (0.0, 0.0),
    }

    def __init__(self, tables: Tables | None) -> None:
        super().__init__()
        self.tables = dict(tables or {})
        self.known_constants: dict[str, Constant] = {}
        self.closures = 0  # how many were read
        self.order: list[int] = []  # places in the file, of links and then of welds
        self.entry = -1  # of the links, the one that is read

    # -- the scene ---------------------------------------------------------------------------

    def scene(self, root: Mapping, source: str) -> Description:
        listed = next((node for key, node in root.pairs if key.text == "links"), None)
        entries = listed.items if isinstance(listed, Sequence) else []
        if isinstance(listed, Sequence) and not entries:
            self.fault("links", listed, "must name at least one link", "[]")
        self.source = source
        self.survey(entries)
        named = next((node for key, node in root.pairs if key.text == "points"), None)
        if named is not None:
            self.name_points(named, "points")
        own = {"source": source, "name": Path(source).stem}
        described: Description = self.record("scene", root, "", **own)
        self.cycles(described, entries)
        words: Any = described.branches
        if words is None or isinstance(words, str):
            free = words is None and described.start
            words = () if free else (words or BRANCHES[0],) * self.closures
        return described._replace(branches=words, points=tuple(self.places.points.items()))

    def name_constants(self, root: Mapping) -> None:
        """Read the constants, which all else may use, each after those that it is made of."""
        node = next((node for key, node in root.pairs if key.text == "constants"), None)
        if node is None:
            return
        if not isinstance(node, Mapping):
            limit = "must map names to numbers, {A: 20 mm, w: 300 rad/s}"
            self.fault("constants", node, limit, self.shown(node))
            return
        given: dict[str, Scalar] = {}
        for key, value in node.pairs:
            place = f"constants.{key.text}"
            if key.text in given:
                self.fault(place, key, "is given twice")
            elif limit := not_free(key.text):
                self.fault(place, key, limit)
            elif not isinstance(value, Scalar) or (value.quoted and is_plain(value.text)):
                self.fault(place, value, "must be a number", self.shown(value))
            else:
                given[key.text] = value
        texts = {name: value.text for name, value in given.items()}
        while ring := cycle(texts):
            limit = f"is made of itself: {' -> '.join(ring)}"
            self.fault(f"constants.{ring[0]}", given[ring[0]], limit)
            texts = {name: text for name, text in texts.items() if name not in ring}
        for name in in_order(texts):
            try:
                made = constant_of(texts[name], self.named)
            except ValueError as error:
                limit = str(error).replace("is not", "must be")
                self.fault(f"constants.{name}", given[name], limit, self.shown(given[name]))
                made = Constant(texts[name], 1.0)
            self.known_constants[name] = made
            self.named[name] = node_of(name, made)
        left = {key.text for key, _ in node.pairs if key.text not in self.named}
        self.named |= {name: Named(1.0, name) for name in left if not not_free(name)}

    def constants(self, node: Node, place: str) -> Constants:
        """The constants that `name_constants` read before the rest, in the order of the file."""
        keys = [key.text for key, _ in node.pairs] if isinstance(node, Mapping) else []
        return tuple((x, self.known_constants[x]) for x in keys if x in self.known_constants)

    def assembly(self, node: Node, place: str) -> str | tuple[str, ...]:
        if not (self.closures or self.faults):
            limit = "tells how closures are assembled, and the scene has none: leave it out"
            self.fault(place, node, limit, self.shown(node))
            return ()
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
            if self.has_no_joint(name, value, f"{place}.{name}"):
                continue
            if name in self.index:
                unit = "m" if self.index[name] in self.slides else "rad"
                key = Key("number", "", unit)
                angles[self.index[name]] = self.number(value, f"{place}.{name}", key)
        return tuple(angles)

    # -- links -------------------------------------------------------------------------------

    def survey(self, entries: list[Node]) -> None:
        """Names and lengths first: `from` may name a point of a link further down the file."""
        given = [dict(_scalars(entry)) for entry in entries]
        joints = [x["joint"].text if "joint" in x else JOINTS[0] for x in given]
        moving = [i for i, joint in enumerate(joints) if joint != JOINTS[2]]
        welds = [i for i, joint in enumerate(joints) if joint == JOINTS[2]]
        self.count, self.order = len(moving), [*moving, *welds]
        if welds and not moving:
            limit = "must name at least one link that moves: all are fixed to the ground"
            self.fault("links", entries[0], limit)
        for k, i in enumerate(self.order):
            if joints[i] == JOINTS[1]:
                self.slides.add(k)
            entry = entries[i]
            if isinstance(entry, Mapping):
                self.survey_link(k, {key.text: value for key, value in reversed(entry.pairs)})
        for i, k in sorted((i, k) for k, i in enumerate(self.order)):
            name = given[i].get("name")
            if name and (earlier := self.index.setdefault(name.text, k)) != k:
                limit = f"is the name of links[{self.order[earlier]}] too; names must differ"
                self.fault(f"links[{i}].name", name, limit, name.text)

    def link(self, node: Node, place: str) -> Body:
        given = dict(_scalars(node))
        name = given.get("name")
        place = place if name is None else f"{place} ({name.text})"
        self.entry += 1
        k, before = (self.order.index(i) for i in (self.entry, max(0, self.entry - 1)))
        above = self.tip(before) if self.entry else Point(None, 0j)
        if k >= self.count:
            return self.record("weld", node, place, hangs_from=above)  # type: ignore[no-any-return]
        self.joint = k
        link: Link = self.record("link", node, place, hangs_from=above)
        slides = "joint" in given and given["joint"].text == JOINTS[1]
        if slides and link.axis is None:
            limit = "is missing: the direction [dx, dy] that a prismatic joint slides along"
            self.fault(f"{place}.axis", node, limit)
        elif link.axis is not None and "joint" in given and not slides:
            limit = "is of prismatic joints alone: write `joint: prismatic` with it"
            self.fault(f"{place}.axis", node, limit)
        return link

    def cycles(self, described: Description, entries: list[Node]) -> None:
        """Every link must hang from the ground in the end; each cycle is told once."""
        grounded: set[int] = set()
        bodies = described.bodies
        for start in range(len(bodies)):
            path: dict[int, None] = {}
            link: int | None = start
            while link is not None and link not in grounded and link not in path:
                path[link] = None
                link = bodies[link].hangs_from.link
            if link in path:
                cycle = list(path)
                names = [bodies[k].name for k in [*cycle[cycle.index(link) :], link]]
                i = self.order[link]
                place = f"links[{i}] ({bodies[link].name}).from"
                self.fault(place, entries[i], f"hangs from itself: {' -> '.join(names)}")
            grounded.update(path)

    # -- closures and directions -------------------------------------------------------------

    def closure(self, node: Node, place: str) -> Closure:
        self.closures += 1
        if not isinstance(node, Mapping):
            return Closure(*self.pair(node, place, "sides"))
        made: Closure = self.record("closure", node, place)
        if made.friction is None:
            return made
        friction = made.friction._replace(joint=None, closure=self.closures - 1)
        return made._replace(friction=friction)

    def frame(self, node: Node, place: str) -> bool:
        """Whether a force turns with its link."""
        return self.word(node, place, FRAMES) == FRAMES[1]

    def direction(self, node: Node, place: str) -> complex:
        """The unit vector."""
        faults, vector = len(self.faults), self.vector(node, place)
        if vector == 0 and len(self.faults) == faults:
            self.fault(place, node, "must point somewhere", "[0, 0]")
        largest = max(abs(vector.real), abs(vector.imag))
        if largest <= 1.0 and abs(abs(vector) - 1.0) <= UNIT:
            return vector
        vector /= largest or 1.0  # no square overflows
        return vector / (abs(vector) or 1.0)

    # -- couplings ---------------------------------------------------------------------------

    def couplings(self, node: Node, place: str) -> tuple[Coupling, ...]:
        """A list of couplings, or a single one, `q3 = -2 q1 + 0.1`."""
        keys = node.pairs if isinstance(node, Mapping) else []
        single = isinstance(node, Scalar) or any(key.text in LAW_KEYS for key, _ in keys)
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
        """An equation, or a mapping of one, {law: "q2 = ...", cam: {...}}."""
        cam: Cam | None = None
        if isinstance(node, Mapping):
            if any(key.text in ("joint", "table") for key, _ in node.pairs):
                return self.tabled(node, place)
            found = self.keys(node, place, ["law"], ["cam"], "key")
            if "cam" in found:
                cam = self.cam(found["cam"], f"{place}.cam")
            if "law" not in found:
                return None
            node, place = found["law"], f"{place}.law"
        text = self.name(node, place)
        units = ["m" if k in self.slides else "rad" for k in range(count)]
        try:
            said = parse_coupling(text, units, self.named)
        except ValueError as error:
            if text:  # else it is told that it is no name
                self.fault(place, node, str(error), self.shown(node))
            return None
        if said.text:
            made = Coupling(said.joint, law=Law(said.text, said.law, names_of(said.law)), cam=cam)
        else:
            terms = tuple((k, x) for k, x in said.ratios.items() if x)
            made = Coupling(said.joint, terms, said.constant, cam=cam)
        if cam is not None:
            self.cam_drives(node, place, made)
        return made

    def cam(self, node: Node, place: str) -> Cam | None:
        """The roller or the flat face of a cam's follower."""
        given = {key.text: key for key, _ in node.pairs} if isinstance(node, Mapping) else {}
        if "face" in given and "roller" in given:
            limit = "and face exclude each other: give one"
            self.fault(f"{place}.roller", given["roller"], limit)
            return None
        return self.record("cam", node, place)  # type: ignore[no-any-return]

    def cam_drives(self, node: Node, place: str, coupling: Coupling) -> None:
        """A fault if the law of a cam does not depend on one joint alone, which turns."""
        drivers = sorted(coupling.others)
        if coupling.timed:
            limit = "names t: the law of a cam is one of its angle alone"
            self.fault(place, node, limit, self.shown(node))
            return
        if len(drivers) != 1:
            named = ", ".join(f"q{k + 1}" for k in drivers) or "none"
            limit = f"must name one joint on the right side, that of the cam: it names {named}"
            self.fault(place, node, limit, self.shown(node))
        elif drivers[0] in self.slides:
            limit = f"q{drivers[0] + 1} slides: a cam turns"
            self.fault(place, node, limit, self.shown(node))

    def tabled(self, node: Node, place: str) -> Coupling | None:
        """A coupling whose law is a table, {joint: lift, table: lift.csv, over: q1, column: s}."""
        from robodyn.scene.table_files import read_curve

        before = len(self.faults)
        needed = ["joint", "table", "over", "column"]
        found = self.keys(node, place, needed, ["period", "cam"], "key")
        texts = {x: self.name(found[x], f"{place}.{x}") for x in needed if x in found}
        cam = self.cam(found["cam"], f"{place}.cam") if "cam" in found else None
        joint, over = self.index.get(texts.get("joint", "")), texts.get("over", "")
        if len(self.faults) > before:
            return None
        if joint is None or joint >= self.count:
            limit = "names no link that has a joint"
            self.fault(f"{place}.joint", found["joint"], limit, texts["joint"])
            return None
        own = state_variables(self.count).named(over)
        if own is None or own.startswith("qd") or own == f"q{joint}":
            limit = f"must be t, or another joint: q1 to q{self.count}"
            self.fault(f"{place}.over", found["over"], limit, over)
            return None
        turns = own != "t" and int(own[1:]) not in self.slides
        period = None
        if "period" in found:
            unit = "s" if own == "t" else "rad" if turns else "m"
            period = self.number(found["period"], f"{place}.period", Key("number", "", unit))
        if len(self.faults) > before:
            return None
        where, file, column = f"{place}.table", texts["table"], texts["column"]
        try:
            curve = read_curve(self.source, file, own, over, column, turns, period, self.tables)
        except ValueError as error:
            self.fault(where, found["table"], str(error), file)
            return None
        made = Coupling(joint, law=curve, cam=cam)
        if cam is not None:
            self.cam_drives(found["over"], f"{place}.over", made)
        return made


def _scalars(node: Node) -> Iterator[tuple[str, Scalar]]:
    """The first of each key of a mapping whose value is a scalar."""
    if isinstance(node, Mapping):
        for key, value in reversed(node.pairs):
            if isinstance(value, Scalar):
                yield key.text, value
