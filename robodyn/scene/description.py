"""YAML -> description: strict keys, numbers, physics; the faults of a file named at once.

What a description holds is in `scene.py`; what the format allows is in `robots/` and the README.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from robodyn.errors import DescriptionError, Fault
from robodyn.scene import yaml_tree
from robodyn.scene.quantities import parse_angle, parse_number
from robodyn.scene.scene import BRANCHES, Closure, Description, Link, Point
from robodyn.scene.yaml_forces import ForceReader
from robodyn.scene.yaml_tree import Mapping, Node, Scalar, Sequence
from robodyn.scene.yaml_values import TooManyFaults


def read(path: str | Path) -> Description:
    """The description in the scene file at `path`; DescriptionError with all of its faults."""
    return from_text(yaml_tree.read_text(Path(path)), str(path))


def from_text(text: str, source: str) -> Description:
    """The description that `text` writes; DescriptionError with all of its faults."""
    return from_tree(yaml_tree.parse(text, source), source)


def from_tree(root: Node | None, source: str) -> Description:
    """The description that a parsed scene holds; DescriptionError with all of its faults."""
    if root is None:
        raise DescriptionError(source, [Fault("", "is empty: a scene needs at least `links`")])
    if not isinstance(root, Mapping):
        fault = Fault("", "must be a mapping of keys (links, gravity, ...)", line=root.line)
        raise DescriptionError(source, [fault])
    reader = _Reader()
    with suppress(TooManyFaults):
        description = reader.scene(root, source)
        if not reader.faults:
            return description
    raise DescriptionError(source, sorted(reader.faults, key=lambda fault: fault.line or 0))


class _Reader(ForceReader):
    """Walks the tree of a scene."""

    # -- the scene ---------------------------------------------------------------------------

    def scene(self, root: Mapping, source: str) -> Description:
        keys = self.keys(
            root,
            "",
            ["links"],
            [
                "name",
                "gravity",
                "closures",
                "couplings",
                "actuated",
                "assembly",
                "start",
                "springs",
                "loads",
            ],
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
            couplings=self.couplings(keys.get("couplings"), len(links)),
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
        found: set[int] = set()
        for i, item in enumerate(self.items(node, "actuated")):
            link = self.link_name(item, f"actuated[{i}]")
            if link in found:
                self.fault(f"actuated[{i}]", item, "is named twice", self.shown(item))
            elif link is not None:
                found.add(link)
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

    # -- closures ----------------------------------------------------------------------------

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


def _scalars(node: Node) -> Iterator[tuple[str, Scalar]]:
    """The first of each key of a mapping whose value is a scalar."""
    if isinstance(node, Mapping):
        for key, value in reversed(node.pairs):
            if isinstance(value, Scalar):
                yield key.text, value
