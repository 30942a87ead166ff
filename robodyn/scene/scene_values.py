"""The numbers of a scene file, by name, and the scene read again with some of them replaced.

A number's name is its place in the file: `gravity`, `links.forearm.m` (or `links[1].m`),
`springs[0].stiffness`, `links.rocker.from[0]`, `start.crank`.  What a key may leave out
(`payload`, `damping`, `gravity`) has a name too.  The whole file is read again each time, so a
new length moves what hangs from the tip, and limits are checked as for any file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from robodyn.elements.keys import Key
from robodyn.errors import InputError
from robodyn.scene import description, yaml_tree
from robodyn.scene.constants import nodes_of
from robodyn.scene.grammar import BY_JOINT, NUMBERS, OR_PAIR, OR_VECTOR, form_of
from robodyn.scene.quantities import parse_quantity, read_value
from robodyn.scene.scene import JOINTS, Description, Tables, Written
from robodyn.scene.yaml_tree import Node, Scalar, Sequence
from robodyn.scene.yaml_values import nearest

_OF_LINK = re.compile(r"links\[(\d+)\]\.")
CONSTANT = "constants."  # before the names of constants
# Of what a list of this kind consists, where not of numbers.
_INNER: dict[str, str | None] = {
    "closure": "point",
    "pair": "point",
    "varying_vector": "varying",
    "couplings": "coupling",
    "varying_place": "varying",
    "gravity": "varying",
} | dict.fromkeys(("joints", "assembly", "pin_names", "two_pins"))
# What [x, y] alone may take the place of, as a whole.
_PAIRS = ("pin", "vector", "direction", "point", "moving_point", "varying_vector", "varying_place")
# mappings by names, and what they hold
_BY_NAME = {
    "start": Key("angle", "", BY_JOINT),
    "points": Key("moving_point", ""),
    "constants": Key("number", ""),
    "pins": Key("pin", "", "m"),
}


@dataclass(slots=True)
class _Place:
    """The place of a number: its collection, and its key or index there."""

    around: yaml_tree.Mapping | Sequence
    at: str | int
    unit: str = ""
    pair: bool = False  # whether [x, y] alone may stand there, as where a place is

    @property
    def held(self) -> list[Any]:
        """The contents of the collection."""
        return self.around.items if isinstance(self.around, Sequence) else self.around.pairs

    @property
    def index(self) -> int | None:
        """Which of these it is; None for a key that is left out."""
        if isinstance(self.at, int):
            return self.at
        return next((k for k, (key, _) in enumerate(self.held) if key.text == self.at), None)

    @property
    def node(self) -> Node | None:
        """The node at the place, or None."""
        if self.index is None:
            return None
        found: Any = self.held[self.index]
        return found if isinstance(self.at, int) else found[1]  # type: ignore[no-any-return]

    def put(self, value: float | Node, unit: str = "") -> None:
        """Put a node there, or a number, in a unit that its place does not tell."""
        line, k = self.around.line, self.index
        text = "" if isinstance(value, Node) else with_unit(value, unit)
        new = value if isinstance(value, Node) else Scalar(text, False, line)
        if isinstance(self.at, int):
            self.held[self.at] = new
        elif k is None:
            self.held.append((Scalar(self.at, False, line), new))
        else:
            self.held[k] = self.held[k][0], new


class SceneValues:
    """The numbers of a scene by name, of its text or of what it was read from.

    Files of tables are read once, here, unless `tables` or the scene has their rows already.
    Raises DescriptionError for a faulty scene, InputError for an unknown name of what was put.
    """

    def __init__(self, scene: str | Written, source: str, tables: Tables | None = None) -> None:
        self.source = source
        root = yaml_tree.parse(scene, source) if isinstance(scene, str) else scene.tree
        text = scene if isinstance(scene, str) else scene.text
        known = tables if isinstance(scene, str) else scene.tables
        self.base = description.from_tree(root, source, text, known)
        self.tables = self.base.written.tables
        assert root is not None
        self.root = _unshared(root)
        self._places = self._found()
        if isinstance(scene, Written) and scene.put:
            for values in scene.put:
                self._put(values)
                self._places = self._found()
            again = description.from_tree(self.root, source, "", self.tables)
            self.base = again._replace(written=scene)

    def _found(self) -> dict[str, _Place]:
        """Return the places of the numbers by all of their names."""
        assert isinstance(self.root, yaml_tree.Mapping)
        named = nodes_of(self.base.constants)
        places = dict(_numbers(_Place(self.root, ""), self.root, "", "scene", named))
        for name, place in list(places.items()):
            if match := _OF_LINK.match(name):
                own = f"links.{self.base.listed[int(match[1])].name}.{name[match.end() :]}"
                places.setdefault(own, place)
        return places

    @property
    def names(self) -> list[str]:
        """The names of all numbers, links by their names."""
        places = self._places.items()
        return sorted(x for x, place in places if not (x.startswith("links[") or place.pair))

    def __contains__(self, name: str) -> bool:
        return name in self._places and not self._places[name].pair

    def place(self, name: str) -> tuple[yaml_tree.Mapping | Sequence, Node | None, str | int]:
        """The collection that holds the number, what stands there, if anything, and where."""
        place = self._places[name]
        return place.around, place.node, place.at

    def own_name(self, name: str) -> str:
        """The name among `names` of the same number, as `links.forearm.m` is of `links[1].m`."""
        place = self._places[name]
        return next((x for x in self.names if self._places[x] is place), name)

    def number(self, name: str) -> float:
        """The number of this name, as the file has it, or 0 where it is left out."""
        return parse_quantity(self.text(name), self.unit(name), nodes_of(self.base.constants))

    def text(self, name: str) -> str:
        """The number of this name as it is written."""
        node = self._places[name].node
        return node.text if isinstance(node, Scalar) else "0"

    def unit(self, name: str) -> str:
        """The unit of the number of this name; empty for plain ones."""
        unit = self._places[name].unit
        if name.startswith(CONSTANT):
            return dict(self.base.constants)[name.removeprefix(CONSTANT)].unit
        if unit != BY_JOINT:
            return unit
        slides = {link.name for link in self.base.links if link.slides}
        return "m" if name.removeprefix("start.") in slides else "rad"

    def untold_unit(self, name: str) -> str:
        """The unit that must stand behind a number of this name: that of a constant."""
        return self.unit(name) if name.startswith(CONSTANT) else ""

    def clash(self, names: Iterable[str]) -> tuple[str, str] | None:
        """Two of the names that stand for one number, or for a point and one of its entries."""
        given = list(names)
        for k, first in enumerate(given):
            for second in given[k + 1 :]:
                a, b = self._places[first], self._places[second]
                inner = {id(a.node), id(b.node)} & {id(a.around), id(b.around)}
                if inner or (a.around is b.around and a.at == b.at):
                    return first, second
        return None

    def check(self, names: Iterable[str], *, pairs: bool = False) -> None:
        """Raise InputError for a name that is none, or that of a pair unless `pairs` may stand."""
        for name in names:
            if name in self or (pairs and name in self._places):
                continue
            limit = f"is no number of the scene{nearest(name, self.names)}"
            if name in self._places:
                limit = f"is a pair, [x, y]: name one of its numbers, {name}[0] or {name}[1]"
            raise InputError(name, where=self.source, limit=limit)

    def replaced(self, values: Mapping[str, float | Node]) -> Description:
        """The scene with these numbers in place of its own; not for two threads at once.

        A node is read as if the file had it there.  Raises InputError for an unknown name,
        DescriptionError for values that no scene may have.
        """
        self.check(values, pairs=True)
        undo = [(held, list(held)) for held in (self._places[name].held for name in values)]
        try:
            self._put(values)
            found = description.from_tree(self.root, self.source, "", self.tables)
        finally:
            for held, own in undo:
                held[:] = own
        now, tables = self.base.written, found.written.tables
        written = Written(now.tree, (*now.put, dict(values)), now.text, tables)
        return found._replace(written=written)

    def _put(self, values: Mapping[str, float | Node]) -> None:
        self.check(values, pairs=True)
        for name, value in values.items():
            new = _unshared(value) if isinstance(value, Node) else value
            self._places[name].put(new, self.untold_unit(name))


def read_numbers(
    text: str,
    source: str,
    given: tuple[tuple[str, str], ...] = (),
    tables: Tables | None = None,
) -> SceneValues:
    """The numbers of a scene's text, with those `given`, NAME and VALUE as a scene has it.

    Files of tables are read unless `tables` has their rows.
    Raises InputError for names that are none, and DescriptionError for what no scene may have.
    """
    values = SceneValues(text, source, tables)
    if not given:
        return values
    nothing = Scalar("", False, 1)
    put = {name: yaml_tree.parse(value, source) or nothing for name, value in given}
    return SceneValues(values.replaced(put).written, source)


def _unshared(node: Node) -> Node:
    """A copy in which no two places hold the same node, as aliases do."""
    if isinstance(node, Scalar):
        return node
    if isinstance(node, Sequence):
        return Sequence([_unshared(item) for item in node.items], node.line, node.size)
    pairs = [(key, _unshared(value)) for key, value in node.pairs]
    return yaml_tree.Mapping(pairs, node.line, node.size)


def with_unit(value: float, unit: str) -> str:
    """The text of a number, and a unit behind it if it has one."""
    return f"{float(value)!r} {unit}" if unit else repr(float(value))


def _varies(kind: str | None, node: Node, named: Mapping[str, Any]) -> bool:
    """Whether it may vary, and is a number all the same."""
    if kind != "varying" or not isinstance(node, Scalar):
        return False
    with suppress(ValueError):
        read_value(node.text, named)
        return True
    return False


def _numbers(
    place: _Place, node: Node, name: str, kind: str | None, named: Mapping[str, Any]
) -> Iterator[tuple[str, _Place]]:
    """The places of all numbers that a value of this kind holds, or may hold in place of 0.

    `named` are the constants of the scene.
    """
    wide = kind in OR_VECTOR or kind in OR_PAIR
    wide |= kind == "gravity" and (isinstance(node, Sequence) or _varies("varying", node, named))
    if wide or (kind in NUMBERS and isinstance(node, Scalar)) or _varies(kind, node, named):
        yield name, place
    if kind in _PAIRS and isinstance(node, Sequence):
        yield name, replace(place, pair=True)
    if kind in ("coupling", "couplings") and not isinstance(node, Sequence):
        if not isinstance(node, yaml_tree.Mapping):
            return
        for own, value in node.pairs:
            if own.text == "cam":  # a law is no number
                yield from _numbers(_Place(node, "cam"), value, f"{name}.cam", "cam", named)
        return
    if isinstance(node, Sequence):
        inner = _INNER.get(kind or "", "number")
        for k, item in enumerate(node.items):
            unit = "m" if kind in ("point", "moving_point") else place.unit
            yield from _numbers(_Place(node, k, unit), item, f"{name}[{k}]", inner, named)
    elif isinstance(node, yaml_tree.Mapping) and kind is not None:
        given = {key.text: value for key, value in node.pairs}
        if kind == "link" and getattr(given.get("joint"), "text", "") == JOINTS[2]:
            kind = "weld"
        prefix = f"{name}." if name else ""
        keys = {} if kind in _BY_NAME else form_of(str(kind), given).keys
        other = _BY_NAME.get(str(kind), Key("number", ""))
        for text, value in given.items():
            key = keys.get(text, other)
            if key.listed and isinstance(value, Sequence):
                for k, item in enumerate(value.items):
                    yield from _numbers(
                        _Place(value, k, key.unit), item, f"{prefix}{text}[{k}]", key.kind, named
                    )
            else:
                yield from _numbers(
                    _Place(node, text, key.unit), value, prefix + text, key.kind, named
                )
        for text, key in keys.items():
            if key.optional and text not in given:
                yield prefix + text, _Place(node, text, key.unit)
