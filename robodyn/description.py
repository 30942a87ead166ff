"""YAML -> description: strict keys, numbers, physics; every fault of a file named at once.

A description says what the scene file says, with names resolved to indices and points of the
plane as complex numbers.  What the format allows is in `robots/` and the README.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from robodyn import yaml_tree
from robodyn.errors import DescriptionError, Fault
from robodyn.quantities import parse_angle, parse_number
from robodyn.yaml_tree import Mapping, Node, Scalar, Sequence
from robodyn.yaml_values import ValueReader, nearest

BRANCHES = ("open", "crossed")
FRAMES = ("ground", "link")  # in which a load's force stays


@dataclass(frozen=True, slots=True)
class Point:
    """A point of a link (its index; `at` in the link's frame) or of the ground (link None), m."""

    link: int | None
    at: complex


@dataclass(frozen=True, slots=True)
class Friction:
    """Coulomb friction of a joint, -torque tanh(qd/speed): N m, and rad/s that smooth it."""

    torque: float
    speed: float


@dataclass(frozen=True, slots=True)
class Link:
    """One link: mass kg, length m, centre of gravity m, inertia kg m^2 about it, where it hangs."""

    name: str
    m: float
    l: float
    r: complex
    I: float
    hangs_from: Point
    payload: float = 0.0
    damping: float = 0.0
    friction: Friction | None = None


@dataclass(frozen=True, slots=True)
class Spring:
    """A spring (N/m, free length m) and damper (N s/m) between two points."""

    first: Point
    second: Point
    stiffness: float
    length: float
    damping: float = 0.0


@dataclass(frozen=True, slots=True)
class JointSpring:
    """A spring (N m/rad, free angle rad) and damper (N m s/rad) at a joint."""

    joint: int
    stiffness: float
    angle: float
    damping: float = 0.0


@dataclass(frozen=True, slots=True)
class Load:
    """A constant force, N, at a point of a link, in the ground's frame or turning with the link."""

    point: Point
    force: complex
    turns: bool = False


@dataclass(frozen=True, slots=True)
class Moment:
    """A constant torque on a link, N m."""

    link: int
    torque: float


@dataclass(frozen=True, slots=True)
class Closure:
    """Two points that coincide, or, with `along`, a point held on the line through `second`."""

    first: Point
    second: Point
    along: complex | None = None


@dataclass(frozen=True, slots=True)
class Description:
    """What a scene file says; `source` is the file's name for messages."""

    source: str
    name: str
    gravity: complex
    links: tuple[Link, ...]
    closures: tuple[Closure, ...]
    branches: tuple[str, ...]
    actuated: tuple[int, ...] | None
    start: tuple[float | None, ...] | None
    springs: tuple[Spring | JointSpring, ...] = ()
    loads: tuple[Load | Moment, ...] = ()


def read(path: str | Path) -> Description:
    """The description in the scene file at `path`; DescriptionError with all of its faults."""
    return from_text(yaml_tree.read_text(Path(path)), str(path))


def from_text(text: str, source: str) -> Description:
    """The description that `text` writes; DescriptionError with all of its faults."""
    root = yaml_tree.parse(text, source)
    if root is None:
        raise DescriptionError(source, [Fault("", "is empty: a scene needs at least `links`")])
    if not isinstance(root, Mapping):
        fault = Fault("", "must be a mapping of keys (links, gravity, ...)", line=root.line)
        raise DescriptionError(source, [fault])
    reader = _Reader()
    description = reader.scene(root, source)
    if reader.faults:
        faults = sorted(reader.faults, key=lambda fault: fault.line or 0)
        raise DescriptionError(source, faults)
    return description


class _Reader(ValueReader):
    """Walks the tree of a scene."""

    def __init__(self) -> None:
        super().__init__()
        self.index: dict[str, int] = {}  # link name -> index
        self.lengths: dict[int, float] = {}

    # -- the scene ---------------------------------------------------------------------------

    def scene(self, root: Mapping, source: str) -> Description:
        keys = self.keys(
            root,
            "",
            ["links"],
            ["name", "gravity", "closures", "actuated", "assembly", "start", "springs", "loads"],
        )
        entries = self.items(keys.get("links"), "links")
        if "links" in keys and isinstance(keys["links"], Sequence) and not entries:
            self.fault("links", keys["links"], "must name at least one link", "[]")
        self.survey(entries)
        links = tuple(self.link(i, entry) for i, entry in enumerate(entries))
        self.cycles(links, entries)
        closures = tuple(
            self.closure(f"closures[{c}]", entry)
            for c, entry in enumerate(self.items(keys.get("closures"), "closures"))
        )
        name = keys.get("name")
        return Description(
            source=source,
            name=Path(source).stem if name is None else self.text(name, "name"),
            gravity=self.gravity(keys.get("gravity")),
            links=links,
            closures=closures,
            branches=self.branches(keys.get("assembly"), len(closures)),
            actuated=self.actuated(keys.get("actuated")),
            start=self.start(keys.get("start"), len(links)),
            springs=tuple(
                self.spring(f"springs[{k}]", entry)
                for k, entry in enumerate(self.items(keys.get("springs"), "springs"))
            ),
            loads=tuple(
                self.load(f"loads[{k}]", entry)
                for k, entry in enumerate(self.items(keys.get("loads"), "loads"))
            ),
        )

    def gravity(self, node: Node | None) -> complex:
        if node is None:
            return 0j
        if isinstance(node, Sequence):
            return self.vector(node, "gravity")
        return -1j * self.number(node, "gravity")

    def branches(self, node: Node | None, count: int) -> tuple[str, ...]:
        if isinstance(node, Sequence):
            given = [self.branch(item, f"assembly[{c}]") for c, item in enumerate(node.items)]
            if len(given) != count:
                limit = f"must be one word, or one for each of the {count} closures"
                self.fault("assembly", node, limit, f"{len(given)} words")
            return tuple(given)
        return (BRANCHES[0] if node is None else self.branch(node, "assembly"),) * count

    def branch(self, node: Node, place: str) -> str:
        word = self.text(node, place)
        if word not in BRANCHES:
            self.fault(place, node, "must be open or crossed", word)
        return word

    def actuated(self, node: Node | None) -> tuple[int, ...] | None:
        if node is None:
            return None
        found: list[int] = []
        for i, item in enumerate(self.items(node, "actuated")):
            link = self.link_name(item, f"actuated[{i}]")
            if link in found:
                self.fault(f"actuated[{i}]", item, "is named twice", self.shown(item))
            elif link is not None:
                found.append(link)
        return tuple(sorted(found))

    def start(self, node: Node | None, count: int) -> tuple[float | None, ...] | None:
        if node is None:
            return None
        if not isinstance(node, Mapping):
            self.fault(
                "start", node, "must map link names to angles, {crank: 30deg}", self.shown(node)
            )
            return None
        angles: list[float | None] = [None] * count
        for name, value in self.keys(node, "start", [], list(self.index), "link").items():
            if name in self.index:
                angles[self.index[name]] = self.number(value, f"start.{name}", parse_angle)
        return tuple(angles)

    # -- links -------------------------------------------------------------------------------

    def survey(self, entries: list[Node]) -> None:
        """Names and lengths first: `from` may name the tip of a link further down the file."""
        for i, entry in enumerate(entries):
            given = dict(_scalars(entry))
            with suppress(ValueError):
                self.lengths[i] = parse_number(given["l"].text if "l" in given else "")
            if "name" not in given:
                continue
            name = given["name"]
            earlier = self.index.setdefault(name.text, i)
            if earlier != i:
                limit = f"is the name of links[{earlier}] too; names must differ"
                self.fault(f"links[{i}].name", name, limit, name.text)

    def link(self, i: int, node: Node) -> Link:
        name = dict(_scalars(node)).get("name")
        place = f"links[{i}]" if name is None else f"links[{i}] ({name.text})"
        if not isinstance(node, Mapping):
            self.fault(place, node, "must be a mapping {name, m, l, r, I}", self.shown(node))
            return Link("", 0.0, 0.0, 0j, 0.0, Point(None, 0j))
        keys = self.keys(
            node,
            place,
            ["name", "m", "l", "r", "I"],
            ["from", "payload", "damping", "friction"],
        )

        def amount(key: str) -> float:
            return self.amount(keys[key], f"{place}.{key}") if key in keys else 0.0

        r = keys.get("r")
        if "from" in keys:
            hangs_from = self.point(keys["from"], f"{place}.from")
        else:
            hangs_from = self.tip(i - 1) if i else Point(None, 0j)
        return Link(
            name=self.text(keys["name"], f"{place}.name") if "name" in keys else "",
            m=amount("m"),
            l=amount("l"),
            r=self.vector(r, f"{place}.r") if isinstance(r, Sequence) else complex(amount("r")),
            I=amount("I"),
            hangs_from=hangs_from,
            payload=amount("payload"),
            damping=amount("damping"),
            friction=self.friction(keys.get("friction"), f"{place}.friction"),
        )

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

    def cycles(self, links: tuple[Link, ...], entries: list[Node]) -> None:
        """Every link must hang from the ground in the end; each cycle is told once."""
        grounded: set[int] = set()
        for start in range(len(links)):
            path: list[int] = []
            link: int | None = start
            while link is not None and link not in grounded and link not in path:
                path.append(link)
                link = links[link].hangs_from.link
            if link in path:
                names = [links[k].name for k in [*path[path.index(link) :], link]]
                place = f"links[{link}] ({links[link].name}).from"
                self.fault(place, entries[link], f"hangs from itself: {' -> '.join(names)}")
            grounded.update(path)

    # -- points and closures -----------------------------------------------------------------

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

    def closure(self, place: str, node: Node) -> Closure:
        if isinstance(node, Mapping):
            return self.slider(place, node)
        sides = self.items(node, place)
        if isinstance(node, Sequence) and len(sides) != 2:
            self.fault(place, node, "must name two sides, [NAME, NAME]", f"{len(sides)} sides")
        if len(sides) != 2:
            return Closure(Point(None, 0j), Point(None, 0j))
        first, second = (self.point(side, f"{place}[{k}]") for k, side in enumerate(sides))
        if first.link == second.link:
            whole = "the ground" if first.link is None else "one link"
            self.fault(place, node, f"joins two points of {whole}; sides must move apart")
        return Closure(first, second)

    def slider(self, place: str, node: Mapping) -> Closure:
        keys = self.keys(node, place, ["point", "on"], [])
        first = self.point(keys["point"], f"{place}.point") if "point" in keys else Point(0, 0j)
        if first.link is None and isinstance(keys["point"], Sequence):
            self.fault(f"{place}.point", keys["point"], "must be a point of a link")
        through, along = 0j, 1 + 0j
        if "on" in keys:
            line = self.keys(keys["on"], f"{place}.on", ["through", "along"], [])
            if "through" in line:
                through = self.vector(line["through"], f"{place}.on.through")
            if "along" in line:
                along = self.vector(line["along"], f"{place}.on.along")
                if along == 0:
                    limit = "must point somewhere"
                    self.fault(f"{place}.on.along", line["along"], limit, "[0, 0]")
                    along = 1 + 0j
        along /= max(abs(along.real), abs(along.imag))  # first, so that no square overflows
        return Closure(first, Point(None, through), along / abs(along))

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

    def link_name(self, node: Node, place: str) -> int | None:
        name = self.text(node, place)
        if name and name not in self.index:
            self.fault(place, node, f"names no link{nearest(name, list(self.index))}", name)
        return self.index.get(name)


def _scalars(node: Node) -> Iterator[tuple[str, Scalar]]:
    """The first of each key of a mapping whose value is a scalar."""
    if isinstance(node, Mapping):
        for key, value in reversed(node.pairs):
            if isinstance(value, Scalar):
                yield key.text, value
