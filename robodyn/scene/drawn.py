"""Mechanisms as drawn: where pins are in one pose, and which links have them -> links and closures.

One rule makes the tree.  A link hangs by its first pin from the ground, or else from the first link
above it in the list that has this pin; its x axis goes to its second pin.  Every further pin that
it shares with the ground or a link above closes a loop.  The first pin of a link that slides is its
origin, and goes along with it; what has the pin above it is what it slides on.  A link that is
welded is part of the nearest link above it that has its first pin, or else of the ground.

What comes out is the tree of the explicit form (`links` with `l` and `from`, `closures`, `start`),
which the same reader reads: numbers keep the lines of the file.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from collections.abc import Mapping as Mapped
from collections.abc import Sequence as Listed
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robodyn.scene.grammar import FORMS
from robodyn.scene.point_names import Places
from robodyn.scene.scene import JOINTS, Description, Point
from robodyn.scene.yaml_tree import Mapping, Node, Scalar, Sequence
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.scene.description import _Reader

FOLLOWS = "follows from the pins: leave it out"
SAME = 1e-9  # part of the drawing's extent within which pins are at one place
ROUNDING = 8e-16  # part of the coordinates that a difference of two of them is rounded by
SINGULAR = 1e-7  # part of the largest singular value of Psi below which another is zero
APART = 0.01  # part of the extent that pins are moved by to see what holds wherever they are


@dataclass
class Bar:
    """A link of a drawing: its pins by name, and what it hangs from."""

    name: str
    place: str
    node: Node
    given: dict[str, Node]
    pins: list[str]
    along: complex | None  # unit vector, of a link that slides
    welded: bool = False  # whether it is part of what it hangs from
    above: int | None = None  # the link that it hangs from, or the ground
    origin: complex = 0j  # where its first pin is, m
    tip: complex | None = None  # where its second pin is, m, of a link that turns
    turn: complex = 1 + 0j  # unit vector along its x axis

    @property
    def length(self) -> float:
        """The length of the link, m; a link that slides has none."""
        return 0.0 if self.tip is None else abs(self.tip - self.origin)

    def at(self, z: complex) -> complex:
        """A point of the drawing in the link's frame, m; what is rounding is zero."""
        if z == self.tip:
            return complex(self.length)
        apart, rounding = z - self.origin, ROUNDING * (abs(z) + abs(self.origin))
        own = apart * self.turn.conjugate()
        x, y = (0.0 if abs(part) <= rounding else part for part in (own.real, own.imag))
        return complex(x, y)

    def way(self, along: complex) -> complex:
        """A unit vector of the drawing in the link's frame; what is rounding is zero."""
        far = 0.0 if self.tip is None else (abs(self.tip) + abs(self.origin)) / self.length
        own, rounding = along * self.turn.conjugate(), ROUNDING * (1.0 + far)
        if abs(own.imag) <= rounding:
            return complex(math.copysign(1.0, own.real))
        return 1j * math.copysign(1.0, own.imag) if abs(own.real) <= rounding else own


class Joined(NamedTuple):
    """A loop: a pin of link `first` is one of `second`, or on a line of it; None is the ground."""

    first: int | None
    second: int | None
    pin: str
    along: complex | None = None


@dataclass
class Line:
    """A pin on a line of the ground, or of the link `on`; `along` is a unit vector."""

    pin: str
    along: complex
    on: int | None = None


class Drawing:
    """A drawn scene: its pins, links and ground, and the loops that they close.

    Faults go to the `reader`.
    """

    def __init__(self, root: Mapping, reader: _Reader) -> None:
        self.root, self.reader = root, reader
        self.z: dict[str, complex] = {}  # where pins are, m
        self.lines: dict[str, int] = {}  # of the file, of pins
        self.fixed: dict[str, Node] = {}  # pins that the ground has
        self.on_line: dict[str, Line] = {}  # pins on lines of the ground
        self.slots: list[Line] = []
        self.joined: list[Joined] = []
        before = len(reader.faults)
        self.given = self._known(root, "", "drawn_scene", ("closures", "start", "assembly"))
        self.bars = list(self._bars())
        self.extent = 0.0
        self._read_pins()
        self.holders: dict[str, list[int]] = {name: [] for name in self.z}
        for k, bar in enumerate(self.bars):
            for name in bar.pins:
                self.holders.setdefault(name, []).append(k)
        self.slide_of: dict[str, int] = {}  # of pins that go along with a link
        self.carrier: dict[str, int | None] = {}  # of these: what the link slides on
        self._read_ground()
        self._read_slots()
        names = [bar.name for bar in self.bars]
        self.sound = len(reader.faults) == before and all(names) and len({*names}) == len(names)
        if self.sound:
            self._hang()
            self._close()
            self._frames()
            self.sound = len(reader.faults) == before

    # -- the keys of the file ------------------------------------------------------------------

    def _known(
        self, node: Node, place: str, form: str, follows: tuple[str, ...]
    ) -> dict[str, Node]:
        """The known keys of a mapping; a fault for each that follows from the pins."""
        if isinstance(node, Mapping):
            kept = []
            for key, value in node.pairs:
                if key.text in follows and key.text not in FORMS[form].keys:
                    self.reader.fault(f"{place}.{key.text}".lstrip("."), key, FOLLOWS)
                else:
                    kept.append((key, value))
            node = Mapping(kept, node.line, node.size)
        names = list(FORMS[form].keys)
        return self.reader.keys(node, place, [], names)

    def _bars(self) -> Iterator[Bar]:
        listed = self.given.get("links")
        for k, node in enumerate(listed.items if isinstance(listed, Sequence) else []):
            keys = {key.text for key, _ in node.pairs} if isinstance(node, Mapping) else set()
            joint = _scalar(node, "joint")
            welded = joint is not None and joint.text == JOINTS[2]
            form = "drawn_prismatic_link" if "along" in keys else "drawn_revolute_link"
            form = "drawn_weld" if welded else form
            name, place = "", f"links[{k}]"
            if isinstance(node, Mapping):
                named = _scalar(node, "name")
                name = "" if named is None else named.text
                place += f" ({name})" if name else ""
            given = self._known(node, place, form, ("l", "from", "joint", "axis", "at", "angle"))
            for two in ("r", "centre"), ("I", "J"):
                if all(key in given for key in two):
                    where = f"{place}.{two[1]}"
                    self.reader.fault(where, given[two[1]], f"stands beside {two[0]}; give one")
                    del given[two[1]]
            if isinstance(node, Mapping) and "pins" not in given:
                self.reader.fault(f"{place}.pins", node, "is missing")
            along = given.pop("along", None)
            way = None if along is None else self.reader.direction(along, f"{place}.along")
            pins = [x.text for x in self._names(given.get("pins"), f"{place}.pins")]
            yield Bar(name, place, node, given, pins, way, welded)

    def _names(self, node: Node | None, place: str) -> Iterator[Scalar]:
        """The names of a list, each once; a single name is a list of one."""
        listed = [] if node is None else self.reader.items(node, place)
        seen: set[str] = set()
        for k, item in enumerate(listed):
            if not self.reader.name(item, f"{place}[{k}]"):
                continue
            assert isinstance(item, Scalar)
            if item.text in seen:
                self.reader.fault(f"{place}[{k}]", item, "is named twice", item.text)
            else:
                seen.add(item.text)
                yield item

    def _read_pins(self) -> None:
        node, reader = self.given["pins"], self.reader
        if not isinstance(node, Mapping):
            limit = "must map names of pins to places, {A: [0.1, 0.2], B: [0.4, 0.3]}"
            reader.fault("pins", node, limit, reader.shown(node))
            return
        index = {bar.name: k for k, bar in enumerate(self.bars)}
        names, faulty = Places(index, lambda _: 0j, lambda _: 0j), set[str]()
        for key, value in node.pairs:
            place = f"pins.{key.text}"
            if key.text in self.z:
                reader.fault(place, key, "is given twice")
            elif limit := names.not_free(key.text):
                reader.fault(place, key, limit)
            self.lines[key.text] = key.line
            faults = len(reader.faults)
            self.z[key.text] = reader.vector(value, place, "m")
            if len(reader.faults) > faults:
                faulty.add(key.text)
        x, y = (
            [z.real for z in self.z.values()] or [0.0],
            [z.imag for z in self.z.values()] or [0.0],
        )
        self.extent = math.hypot(max(x) - min(x), max(y) - min(y))
        if not math.isfinite(self.extent):
            reader.fault("pins", node, "are too far apart: their distances overflow")
            self.extent = 0.0
        for bar in self.bars:
            self._check_pins(bar, faulty)

    def _check_pins(self, bar: Bar, faulty: set[str]) -> None:
        """Add the faults of the pins of one link; the places of those in `faulty` are not known."""
        node, place, reader = bar.given.get("pins", bar.node), f"{bar.place}.pins", self.reader
        count = len(bar.pins)
        bar.pins = [name for name in bar.pins if self._is_pin(name, node, place)]
        if bar.along is None and count == 1:
            limit = "needs two pins: its joint, and one that its x axis goes to"
            reader.fault(place, node, f"{limit}; one alone is for a link that slides (`along`)")
        elif isinstance(bar.given.get("pins"), Sequence) and not count:
            reader.fault(place, node, "needs at least one pin")
        across = sorted((x for x in bar.pins if x not in faulty), key=lambda x: self.z[x].real)
        for k, first in enumerate(across):
            for second in across[k + 1 :]:
                apart = self.z[second] - self.z[first]
                if apart.real > SAME * self.extent:
                    break
                if abs(apart) <= SAME * self.extent:
                    one, other = sorted((first, second), key=bar.pins.index)
                    limit = f"has {one} and {other} at one place: leave one of them out"
                    reader.fault(place, node, limit)

    def _is_pin(self, name: str, node: Node, place: str) -> bool:
        if name in self.z:
            return True
        if not isinstance(self.given["pins"], Mapping):
            return False  # it is told that they are none
        near = self.reader.nearest(name, list(self.z))
        self.reader.fault(place, node, f"names no pin{near}", name)
        return False

    def _read_ground(self) -> None:
        node = self.given.get("ground")
        for k, item in enumerate([] if node is None else self.reader.items(node, "ground")):
            place, line = f"ground[{k}]", None
            if isinstance(item, Mapping):
                line = self._line(item, place, "ground_line")
                name = "" if line is None else line.pin
            else:
                name = self.reader.name(item, place)
                name = name if name and self._is_pin(name, item, place) else ""
            if name and (name in self.fixed or name in self.on_line):
                self.reader.fault(place, item, "is named twice", name)
            elif line is not None:
                self.on_line[name] = line
            elif name:
                self.fixed[name] = item

    def _read_slots(self) -> None:
        node = self.given.get("slots")
        for k, item in enumerate([] if node is None else self.reader.items(node, "slots")):
            line = self._line(item, f"slots[{k}]", "slot")
            if line is not None:
                self.slots.append(line)

    def _line(self, node: Node, place: str, form: str) -> Line | None:
        """A line that a pin stays on; None, and faults, if it is none."""
        reader, faults = self.reader, len(self.reader.faults)
        found = reader.keys(node, place, list(FORMS[form].keys), [])
        if len(reader.faults) > faults:
            return None
        name, link = reader.name(found["pin"], f"{place}.pin"), None
        if name:
            self._is_pin(name, found["pin"], f"{place}.pin")
        along = reader.direction(found["along"], f"{place}.along")
        if form == "slot":
            index = {bar.name: k for k, bar in reversed([*enumerate(self.bars)])}
            on = reader.name(found["on"], f"{place}.on")
            link = index.get(on)
            if on and link is None:
                limit = f"names no link{reader.nearest(on, list(index))}"
                reader.fault(f"{place}.on", found["on"], limit, on)
            elif link is not None and name in self.bars[link].pins:
                limit = f"is a pin of {on} itself: a slot holds a pin of another link"
                reader.fault(f"{place}.pin", found["pin"], limit, name)
            elif name in self.z and not (self.holders[name] or name in self.fixed):
                limit = "must be a pin of a link, or of the ground"
                reader.fault(f"{place}.pin", found["pin"], limit, name)
        return Line(name, along, link) if len(reader.faults) == faults else None

    # -- the tree and the loops ----------------------------------------------------------------

    def _hang(self) -> None:
        """Find the parent of each link, by its first pin."""
        for k, bar in enumerate(self.bars):
            if bar.along is None:
                continue
            pin = bar.pins[0]
            where, node = f"{bar.place}.pins", bar.given["pins"]
            if pin in self.slide_of:
                other = self.bars[self.slide_of[pin]].name
                limit = f"begins with {pin}, which goes along with {other}: give it another pin"
                self.reader.fault(where, node, limit)
                continue
            if pin in self.on_line:
                limit = f"begins with {pin}, which runs on a line of the ground: write it as a pin "
                self.reader.fault(where, node, f"{limit}of the ground, as {bar.name} slides there")
            self.slide_of[pin] = k
            above = next((i for i in self.holders[pin] if i < k), None)
            if pin in self.fixed:
                self.carrier[pin] = bar.above = None
            elif above is not None:
                self.carrier[pin] = bar.above = above
            else:
                self._unheld(k, pin)
        for k, bar in enumerate(self.bars):
            if bar.along is None:
                partner = self._partner(bar.pins[0], k)
                if bar.welded:
                    partner = max((i for i in self._pinned(bar.pins[0]) if i < k), default=partner)
                if partner == -1:
                    self._unheld(k, bar.pins[0])
                else:
                    bar.above = partner

    def _pinned(self, pin: str) -> list[int]:
        """Links that a pin joins, without the one that it slides along."""
        carrier = self.carrier.get(pin)
        return [k for k in self.holders[pin] if pin not in self.carrier or k != carrier]

    def _moves(self, pin: str) -> bool:
        """Return whether a pin is not on the ground, or goes along with a link that slides."""
        slides = (bar for bar in self.bars if bar.along is not None)
        return pin not in self.fixed or any(bar.pins[:1] == [pin] for bar in slides)

    def _is_fixed(self, pin: str) -> bool:
        """Return whether a pin is on the ground, and is not the origin of a link that slides."""
        return pin in self.fixed and pin not in self.slide_of

    def _partner(self, pin: str, k: int) -> int | None:
        """Return what this pin joins link k to: the ground (None), a link above, nothing (-1)."""
        if self._is_fixed(pin):
            return None
        return next((i for i in self._pinned(pin) if i < k), -1)

    def _body(self, k: int | None) -> int | None:
        """Return the link that link k is a part of by welds, itself or one above; or the ground."""
        while k is not None and self.bars[k].welded:
            k = self.bars[k].above
        return k

    def _meets(self, pin: str, k: int) -> int | None:
        """Return `_partner` without what link k is one body with."""
        own = self._body(k)
        if self._is_fixed(pin):
            return -1 if own is None else None
        return next((i for i in self._pinned(pin) if i < k and self._body(i) != own), -1)

    def _unheld(self, k: int, pin: str) -> None:
        """Add the fault of link k, whose first pin is on nothing above."""
        bar = self.bars[k]
        below = [self.bars[i].name for i in self.holders[pin] if i > k]
        begins = f"begins with {pin}, "
        if pin in self.on_line:
            limit = f"{begins}which runs on a line of the ground: write one slide as a link, "
            limit += f"{{name: block, pins: [{pin}], along: [dx, dy], ...}}, above it, and "
            limit += f"{pin} as a pin of the ground"
        elif any(line.pin == pin for line in self.slots):
            limit = f"{begins}which runs in a slot: write the block as a link, "
            limit += f"{{name: block, pins: [{pin}], along: [dx, dy], ...}}, above it"
        elif pin in self.fixed and pin in self.slide_of:
            slide = self.bars[self.slide_of[pin]].name
            limit = f"{begins}which goes along with {slide}, though the ground has it: put it "
            limit += f"below {slide}, or give {slide} another pin"
        elif below:
            limit = f"{begins}which is on nothing above it, but on {', '.join(below)} below: "
            limit += "put it further down, or begin with another of its pins"
        else:
            limit = f"{begins}which nothing holds: name it in `ground`, or begin with a pin of a "
            limit += "link above"
        self.reader.fault(f"{bar.place}.pins", bar.given["pins"], limit)

    def _close(self) -> None:
        """List the loops; add a fault for each pin that is on no link."""
        for k, bar in enumerate(self.bars):
            # a link that slides meets what has its first pin, but for what it slides on
            further = bar.pins if bar.along is not None else bar.pins[1:]
            for pin in further:
                if pin in self.slide_of and k not in self._pinned(pin):
                    continue
                partner = self._meets(pin, k)
                if partner is None:
                    self.joined.append(Joined(k, None, pin))
                elif partner >= 0:
                    self.joined.append(Joined(partner, k, pin))
                elif pin in self.on_line:
                    line = self.on_line[pin]
                    self.joined.append(Joined(k, None, pin, line.along))
        for line in self.slots:
            own = self._pinned(line.pin)[0] if self._moves(line.pin) else None
            self.joined.append(Joined(own, line.on, line.pin, line.along))
        anchors = {*self._ends(), *(line.pin for line in self.slots)}
        for pin in self.z:
            if not self.holders[pin] and not (pin in self.fixed and pin in anchors):
                limit = "is on no link: name it in the pins of one, or leave it out"
                self.reader.fault(f"pins.{pin}", Scalar(pin, False, self.lines[pin]), limit)

    def _frames(self) -> None:
        """Find the frames of the links in the drawing."""
        for bar in self.bars:
            bar.origin = self.z[bar.pins[0]]
            if bar.along is not None:
                bar.turn = bar.along
            else:
                bar.tip = self.z[bar.pins[1]]
                bar.turn = (bar.tip - bar.origin) / bar.length

    # -- springs, loads and points by pins -----------------------------------------------------

    def _ends(self) -> Iterator[str]:
        """Names of the ends of springs."""
        springs = self.given.get("springs")
        for entry in springs.items if isinstance(springs, Sequence) else []:
            for key, ends in entry.pairs if isinstance(entry, Mapping) else []:
                if key.text == "between" and isinstance(ends, Sequence):
                    yield from (end.text for end in ends.items if isinstance(end, Scalar))

    def _named(self, node: Node, moving: bool = False) -> Node:
        """A point, with a pin as a place of its link, or of the ground.

        Where the drawing has faults a pin that moves is any place of a link, others are the ground.
        """
        if not isinstance(node, Scalar) or node.text not in self.z:
            return node
        pin, line = node.text, node.line
        if not self.sound:
            return _place(self.bars[0], 0j, line) if moving else _vector(0j, line)
        if self._is_fixed(pin):
            return _vector(self.z[pin], line)
        return _place(self.bars[self._pinned(pin)[0]], self.z[pin], line)

    def _entries(self, key: str, inner: str) -> Node | None:
        """Springs or loads, with their points explicit."""
        listed = self.given.get(key)
        if not isinstance(listed, Sequence):
            return listed
        items: list[Node] = []
        for entry in listed.items:
            if isinstance(entry, Mapping):
                pairs: list[tuple[Scalar, Node]] = []
                for name, value in entry.pairs:
                    if name.text == inner and isinstance(value, Sequence):
                        ends = [self._named(x, k == 0) for k, x in enumerate(value.items)]
                        value = Sequence(ends, value.line)
                    elif name.text == inner:
                        value = self._named(value, moving=True)
                    pairs.append((name, value))
                entry = Mapping(pairs, entry.line)
            items.append(entry)
        return Sequence(items, listed.line)

    def _points(self) -> Node | None:
        """Pins of one link alone, and the points that the file names."""
        given = self.given.get("points")
        if given is not None and not isinstance(given, Mapping):
            return given
        pairs: list[tuple[Scalar, Node]] = []
        for pin, links in self.holders.items():
            if self.sound and len(links) == 1 and not self._is_fixed(pin):
                line = self.lines[pin]
                place = _place(self.bars[links[0]], self.z[pin], line)
                pairs.append((Scalar(pin, False, line), place))
        for key, value in given.pairs if given is not None else []:
            if key.text in self.z:
                self.reader.fault(f"points.{key.text}", key, "is the name of a pin: take another")
            else:
                pairs.append((key, self._named(value, moving=True)))
        return Mapping(pairs, 1) if pairs else None

    def shared(self) -> Iterator[tuple[str, Point]]:
        """The pins that move and are on several links, each on the first that has it."""
        for pin, links in self.holders.items():
            if len(links) > 1 and not self._is_fixed(pin):
                k = self._pinned(pin)[0]
                yield pin, Point(self._number_of(k), self.bars[k].at(self.z[pin]))

    @property
    def moving(self) -> list[Bar]:
        """The links that have joints, in the order of their numbers."""
        return [bar for bar in self.bars if not bar.welded]

    def _number_of(self, k: int) -> int:
        """The number of link k in a description, where welds come behind the others."""
        before = sum(bar.welded == self.bars[k].welded for bar in self.bars[:k])
        return before + (len(self.moving) if self.bars[k].welded else 0)

    # -- the explicit form ---------------------------------------------------------------------

    def explicit(self) -> Mapping:
        """The scene with lengths, closures and start; without them where the drawing has faults.

        Then what else there is can be read all the same, and its faults told with the drawing's.
        """
        passed = ("name", "constants", "gravity", "links", "actuated", "couplings")
        found = {key: self.given[key] for key in passed if key in self.given}
        if self.bars:
            found["links"] = Sequence(
                [self._link(k, bar) for k, bar in enumerate(self.bars)], self.given["links"].line
            )
        parts: dict[str, Node | None] = {}
        if self.sound:
            parts |= {"closures": self._closures(), "start": self._start()}
        if self.bars and all(bar.name for bar in self.bars):
            parts["points"] = self._points()
            parts["springs"] = self._entries("springs", "between")
            parts["loads"] = self._entries("loads", "point")
        found |= {key: node for key, node in parts.items() if node is not None}
        return _mapping(found, self.root.line)

    def _link(self, k: int, bar: Bar) -> Node:
        if not isinstance(bar.node, Mapping):
            return bar.node
        line = bar.node.line
        found = {x: y for x, y in bar.given.items() if x not in ("pins", "centre")}
        if not self.sound:
            if "centre" in bar.given:
                found["r"] = bar.given["centre"]
            return _mapping(found | {"l": _number(0.0, line), "from": _vector(0j, line)}, line)
        above = None if bar.above is None else self.bars[bar.above]
        found["l"] = _number(bar.length, line)
        found["from"] = (
            _vector(bar.origin, line) if above is None else _place(above, bar.origin, line)
        )
        if bar.welded:
            found["angle"] = _number(cmath.phase(above.way(bar.turn) if above else bar.turn), line)
        elif bar.along is not None:
            found["joint"] = Scalar("prismatic", False, line)
            found["axis"] = _vector(above.way(bar.along) if above else bar.along, line)
        if "centre" in bar.given:
            node = bar.given["centre"]
            centre = self.reader.vector(node, f"{bar.place}.centre", "m")
            found["r"] = _vector(bar.at(centre), node.line)
        return _mapping(found, line)

    def _closures(self) -> Node | None:
        items: list[Node] = []
        for first, second, pin, along in self.joined:
            z, line = self.z[pin], self.bars[max(first or 0, second or 0)].node.line
            own, side = (self._side(k, z, line) for k in (first, second))
            other = None if second is None else self.bars[second]
            if along is None:
                items.append(Sequence([own, side], line))
                continue
            on: dict[str, Node] = {}
            if other is not None:
                on["link"] = Scalar(other.name, True, line)
                z, along = other.at(z), other.way(along)
            on |= {"through": _vector(z, line), "along": _vector(along, line)}
            items.append(_mapping({"point": own, "on": _mapping(on, line)}, line))
        return Sequence(items, self.root.line) if items else None

    def _side(self, k: int | None, z: complex, line: int) -> Node:
        """A place of the drawing on a link, or on the ground."""
        return _vector(z, line) if k is None else _place(self.bars[k], z, line)

    def _start(self) -> Node:
        """The pose of the drawing: an angle, rad, or a displacement, m, of each joint."""
        found: dict[str, Node] = {}
        for bar in (x for x in self.bars if not x.welded):
            above = None if bar.above is None else self.bars[bar.above]
            q = 0.0 if bar.along else cmath.phase(above.way(bar.turn) if above else bar.turn)
            found[bar.name] = _number(q, bar.node.line)
        return _mapping(found, self.root.line)

    # -- whether it moves, and in one way ------------------------------------------------------

    def check(self, description: Description) -> None:
        """Add a fault if the drawing cannot move, or if its branch cannot be read.

        `description` is that of the explicit form.
        """
        if not self.joined or not self.sound:
            return
        moving = self.moving
        n, couplings = len(moving), np.zeros((len(description.couplings), len(moving)))
        for row, coupling in zip(couplings, description.couplings, strict=True):
            row[coupling.joint] = 1.0
            for k, ratio in coupling.ratios:
                row[k] -= ratio
        drawn, moved = self._psi(self.z), self._psi(self._elsewhere())
        rank = _rank(np.vstack([*drawn, couplings]))
        node = self.given["links"]
        if rank >= n:
            limit = f"cannot move as drawn: {n} joints, and closures with {rank} independent "
            limit += "conditions; what moves only by its proportions, as a parallelogram with a "
            limit += f"third crank does, must have them to {SINGULAR:g}"
            self.reader.fault("links", node, limit)
            return
        actuated = self.actuated(description)
        passive = [k for k in range(n) if k not in actuated]
        generic = _rank(np.vstack([*moved, couplings]))  # above that of a drawing all in line
        rank = rank if generic >= n else generic
        most = n - rank - len(actuated)  # freedoms that no actuated joint decides

        def free(rows: Listed[Array]) -> int:
            return len(passive) - _rank(np.vstack([*rows, couplings])[:, passive])

        if not passive or free(drawn) <= max(most, free(moved)):
            return
        for c in range(1, len(drawn) + 1):  # the first loop that is singular
            if free(drawn[:c]) > free(moved[:c]):
                rows = np.vstack([*drawn[:c], couplings])[:, passive]
                break
        else:
            rows = np.vstack([*drawn, couplings])[:, passive]
        used = np.abs(rows).max(axis=0) > SINGULAR * np.abs(rows).max()
        way = np.abs(np.linalg.svd(rows[:, used])[2][-1])
        own = [k for k, moves in zip(passive, used, strict=True) if moves]
        links = [k for k, part in zip(own, way.tolist(), strict=True) if part > 1e-3 * way.max()]
        names = " and ".join(moving[k].name for k in links)
        driven = ", ".join(moving[k].name for k in actuated)
        limit = f"{names} are drawn in line, at a dead centre of {driven}: their branch cannot be "
        limit += "read; draw another pose"
        bar = moving[links[-1]]
        self.reader.fault(bar.place, bar.node, limit)

    def _elsewhere(self) -> dict[str, complex]:
        """Pins moved a little, in no proportion to one another: a generic drawing of this kind."""
        way = cmath.rect(APART * self.extent, 1.0)
        return {pin: z + way * cmath.rect(1.0, k * k) for k, (pin, z) in enumerate(self.z.items())}

    def _path(self, k: int | None) -> Iterator[int]:
        """Link k and the links that carry it, down to the ground."""
        while k is not None:
            yield k
            k = self.bars[k].above

    def _psi(self, z: Mapped[str, complex]) -> list[Array]:
        """Psi of each closure with pins at z: rows (1 or 2, n), lengths divided by the extent."""
        found = []
        for first, second, pin, along in self.joined:
            row = np.zeros(len(self.moving), complex)
            for sign, link in ((1.0, first), (-1.0, second)):
                for k in self._path(link):
                    bar = self.bars[k]
                    if bar.welded:
                        continue
                    arm = bar.along or 1j * (z[pin] - z[bar.pins[0]]) / self.extent
                    row[self._number_of(k)] += sign * arm
            if along is None:
                found.append(np.array([row.real, row.imag]))
            else:
                found.append((row * along.conjugate()).imag[None])
        return found

    def actuated(self, description: Description) -> Listed[int]:
        """The joints that the scene names as actuated, or else that are so by default.

        By default they are those outside of loops, and the first of each group of loops that share
        joints; a joint that a coupling gives is none, and a group with one outside of loops is
        driven there.
        """
        if description.actuated is not None:
            return description.actuated
        rows = self._psi(self._elsewhere())
        loops = [{*np.flatnonzero(np.abs(x).max(axis=0) > SINGULAR).tolist()} for x in rows]
        in_loops = set().union(*loops)
        groups: list[set[int]] = []
        for joints in [*loops, *(set(x.joints) for x in description.couplings)]:
            apart = [group for group in groups if not group & joints]
            groups = [*apart, joints.union(*(group for group in groups if group & joints))]
        followers = {coupling.joint for coupling in description.couplings}
        driven = set(range(len(self.moving))) - in_loops - followers
        for group in groups:
            if group & in_loops and not group & driven:
                driven |= set(sorted(group - followers)[:1])
        return sorted(driven)


def _scalar(node: Node, key: str) -> Scalar | None:
    """The scalar that a mapping has for a key."""
    pairs = node.pairs if isinstance(node, Mapping) else []
    found = next((x for name, x in pairs if name.text == key), None)
    return found if isinstance(found, Scalar) else None


def _rank(rows: Array) -> int:
    """The rank, with singular values below a part of the largest taken as zero."""
    values = np.linalg.svd(rows, compute_uv=False)
    return int((values > SINGULAR * values.max(initial=0.0)).sum())


def _number(x: float, line: int) -> Scalar:
    return Scalar(repr(float(x)), False, line)


def _vector(z: complex, line: int) -> Sequence:
    return Sequence([_number(z.real, line), _number(z.imag, line)], line)


def _mapping(pairs: Mapped[str, Node], line: int) -> Mapping:
    return Mapping([(Scalar(key, False, line), value) for key, value in pairs.items()], line)


def _place(bar: Bar, z: complex, line: int) -> Mapping:
    """A place of the drawing as {link, at}."""
    at = _vector(bar.at(z), line)
    return _mapping({"link": Scalar(bar.name, True, line), "at": at}, line)
