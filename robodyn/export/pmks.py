"""PMKS+ mechanism, as its addresses hold it -> a scene as drawn.

    https://pmksplus.com/?0P.TY.K,0.101.MA,A,0mv,0VU,0...

What stands after the question mark is the whole mechanism: parts that end at points, settings
(flags, decimals, integers, units), joints, links and forces, then what is selected, locked or
coloured.  Integers have digits of base 64, and a leading 0 where they are negative; decimals are
integers of thousandths.  The last character is the length of the text before it, modulo 62.  The
oldest texts, which end at a point, have no such character.
"""

from __future__ import annotations

import cmath
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import count
from pathlib import Path
from urllib.parse import unquote

from robodyn.errors import InputError
from robodyn.scene.point_names import Places
from robodyn.tables.csv_fields import shown

DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_-"
CHECKS = DIGITS[:62]
GRAVITY, CLOCKWISE = 1, 0  # places of flags among the settings
# of each unit of length: m, kg of its unit of mass, kg m^2 of its unit of inertia, and the three
UNITS = (
    (Decimal("0.0254"), Decimal("0.45359237"), Decimal("0.00029263965343"), "in, lb, lb in^2"),
    (Decimal("0.01"), Decimal("0.001"), Decimal("0.0001"), "cm, g, kg cm^2"),
    (Decimal(1), Decimal(1), Decimal(1), "m, kg, kg m^2"),
)
POUND_FORCE = Decimal("4.4482216152605")  # N
ROOTS = "YAMG0123"  # first characters of links; the others are parts of a welded one
PARTS = "Namg4567"
LONGEST = 100_000  # characters
MOST_LINKS = 500


@dataclass
class Joint:
    """A pin, or a block that slides where a pin is; in units of the text."""

    id: str
    name: str
    x: Decimal
    y: Decimal
    slides: bool
    driven: bool
    grounded: bool
    welded: bool
    angle: float  # rad, of its slide on the ground
    carrier: str = ""  # the link that it slides on
    way: tuple[str, str] = ("", "")  # the joints of the carrier that its line runs along


@dataclass
class Body:
    """A link: kg, kg m^2 about its centre (m), and the joints that it has."""

    name: str
    mass: Decimal
    inertia: Decimal
    centre: tuple[Decimal, Decimal]
    joints: list[str]
    ids: list[str]  # of the links that are welded into it
    block: bool = False  # of a slide, whose mass is at its pin
    along: complex | None = None  # unit vector of its slide, if it has one
    above: str = ""  # the link that it slides on


@dataclass
class Text:
    """Contents of a text, with lengths in its own units and masses in SI."""

    flags: int
    units: str
    joints: dict[str, Joint]
    links: list[Body]
    forces: list[tuple[list[str], str, str, bool]]  # numbers, link, name, whether it turns with it
    speed: int  # of the input, rpm
    notes: list[str] = field(default_factory=list)


def text_from(given: str) -> str:
    """The mechanism's text in an address, after a question mark, or in a file that has either.

    Raises InputError where there is none.
    """
    path = Path(given)
    try:
        is_file = len(given) < 4096 and path.is_file()
    except (OSError, ValueError):
        is_file = False
    if is_file:
        if path.stat().st_size > 10 * LONGEST:
            raise InputError("--from-pmks", value=given, limit="is too large a file for an address")
        given = path.read_text(encoding="utf-8", errors="replace")
    words = [word.strip("\"'<>,;") for word in given.split()]
    texts = [unquote(word.rpartition("?")[2].partition("#")[0]) for word in words]
    found = [x for x in texts if re.match(r"[0-9A-Za-z_-]+\.[0-9A-Za-z_-]+\.[0-9A-Za-z_,-]+\.", x)]
    if not found:
        limit = "is no address of a PMKS+ mechanism: write what its Share button gives, "
        raise InputError("--from-pmks", value=shown(given), limit=f"{limit}https://...?0P.TY...")
    if len(found[0]) > LONGEST:
        raise InputError("--from-pmks", limit=f"has more than {LONGEST} characters")
    return found[0]


def scene_from(text: str) -> tuple[str, list[str]]:
    """The scene as drawn, as YAML, of a mechanism's text, and notes of what it leaves out.

    Raises InputError for what is no such text, and for what scenes do not have.
    """
    held = _decoded(text)
    if not 1 <= len(held.links) <= MOST_LINKS:
        raise _refused(
            f"has {len(held.links) or 'no'} links; scenes are made of up to {MOST_LINKS}"
        )
    return _Drawing(held).written(), held.notes


# -- the text ------------------------------------------------------------------------------------


def _refused(limit: str, value: object = None) -> InputError:
    return InputError("the PMKS+ text", value=value, limit=limit)


def _integer(token: str, signed: bool = True) -> int:
    if len(token) > 12:
        raise _refused("has too long a number", shown(token))
    sign = -1 if signed and token[:1] == "0" else 1
    value = 0
    for letter in token:
        if letter not in DIGITS:
            raise _refused(f"has {letter!r} in a number", shown(token))
        value = 64 * value + DIGITS.index(letter)
    return sign * value


def _decimal(token: str) -> Decimal:
    return Decimal(_integer(token)).scaleb(-3)


def _decoded(text: str) -> Text:
    """Contents of a text.  A text without a check has the older records."""
    old = text.endswith(".")  # no check has that
    if not old:
        text, check = text[:-1], text[-1]
        if CHECKS[len(text) % 62] != check:
            limit = f"ends in {check!r} where its length asks for {CHECKS[len(text) % 62]!r}: a "
            raise _refused(f"{limit}part of it is missing, or was changed")
    settings, rest = text.split(".")[:4], text.split(".")[4:]
    if len(settings) < 4 or len(rest) < 2:
        raise _refused("ends before its joints and links")
    sections: list[list[str]] = [[]]
    while rest and len(sections) < 4:  # each record ends at a point, each section at one more
        record = rest.pop(0)
        if record:
            sections[-1].append(record)
        else:
            sections.append([])
    joints, links, forces = [*sections, [], []][:3]
    notes = list(_unknown(rest, len(settings[0])))
    named = old is False or any(record.count(",") >= 4 for record in joints)
    found = {joint.id: joint for joint in (_joint(x, named, notes) for x in joints)}
    if len(found) < len(joints):
        raise _refused("has two joints of one name")
    for joint in found.values():
        if joint.slides and joint.carrier and not set(joint.way) <= found.keys():
            raise _refused("runs along joints that are not there", f"joint {joint.name}")
    units = settings[3] if settings[3] else "1"
    speed = _integer(settings[2].split(",")[0])
    made = Text(_integer(settings[0], False), units, found, [], [], speed, notes)
    scale = UNITS[_unit(units, 0, len(UNITS))]
    for record in links:
        link = _link(record, named, scale)
        if link is not None:
            if not set(link.joints) <= found.keys():
                raise _refused("has joints that are not there", f"link {link.name}")
            made.links.append(link)
    for record in forces:
        flags, tokens = _integer(record[:1], False), record[1:].split(",")
        if len(tokens) < 7 + named:
            raise _refused("has too few parts", f"force {shown(record)}")
        name = tokens.pop(2) if named else tokens[0]
        made.forces.append((tokens[2:7], tokens[1], name or tokens[0], bool(flags & 1)))
    return made


def _unit(units: str, place: int, count: int) -> int:
    value = _integer(units[place : place + 1], False)
    if value >= count:
        raise _refused("has a unit that is not known", shown(units))
    return value


def _unknown(rest: Sequence[str], flags: int) -> Iterator[str]:
    """Parts after the forces that are neither selected, locked, anchored nor coloured."""
    if flags > 2:
        yield "settings that are not known"
    entries = rest[1].split(",") if len(rest) > 1 else []
    yield from (f"the entry {x}" for x in entries if x and x[0] not in "JLFCSK")
    yield from (f"the part {x}" for x in rest[2:] if x)


def _joint(record: str, named: bool, notes: list[str]) -> Joint:
    flags, tokens = _integer(record[:1], False), record[1:].split(",")
    if not named:
        tokens.insert(1, tokens[0])
    if len(tokens) < 5 or not tokens[0]:
        raise _refused("has too few parts", f"joint {shown(record)}")
    id, name, x, y, angle, *more = tokens
    carrier, first, second = [*more, "", "", ""][:3]
    notes += [f"part {token} of joint {name or id}" for token in more[4:] if token]
    if flags >> 6:
        notes.append(f"flags of joint {name or id}")
    slides, driven, grounded, welded = (bool(flags >> k & 1) for k in range(4))
    place = _decimal(x), _decimal(y)
    way = float(_decimal(angle))
    return Joint(
        id, name or id, *place, slides, driven, grounded, welded, way, carrier, (first, second)
    )


def _link(record: str, named: bool, scale: tuple[Decimal, Decimal, Decimal, str]) -> Body | None:
    """A link; None for a part of a welded one."""
    if record[0] in "RP" and record[:1] not in ROOTS + PARTS:
        record = f"Y{record}"  # the oldest have no parts
    if record[0] not in ROOTS + PARTS or record[1:2] not in ("R", "P"):
        raise _refused("is of a kind that is not known", f"link {shown(record)}")
    tokens = record[2:].split(",")
    if not named:
        tokens[1:1] = [tokens[0]]
        tokens[6:6] = [""]
    if len(tokens) < 8:
        raise _refused("has too few parts", f"link {shown(record)}")
    id, name, mass, inertia, x, y, _, *rest = tokens
    end = rest.index("") if "" in rest else len(rest)
    joints, parts = rest[:end], [x for x in rest[end:] if x]
    if record[0] in PARTS:
        return None
    metre, kilogram, moment, _ = scale
    centre = _decimal(x) * metre, _decimal(y) * metre
    own = abs(_decimal(mass)) * kilogram, abs(_decimal(inertia)) * moment
    return Body(name or id, *own, centre, joints, [id, *parts], block=record[1] == "P")


# -- the scene -----------------------------------------------------------------------------------


class _Drawing:
    """Links, pins and ground of a scene as drawn."""

    def __init__(self, held: Text) -> None:
        self.held, self.notes = held, held.notes
        self.metre = UNITS[_unit(held.units, 0, len(UNITS))][0]
        self.z = {x.id: (x.x * self.metre, x.y * self.metre) for x in held.joints.values()}
        self.names: dict[str, str] = {}  # of pins, by the joints' ids
        self.driven: list[Body] = []  # the links that inputs turn or push
        self.ground: list[str] = []  # joints
        self.on_line: dict[str, complex] = {}  # joints that run on a line of the ground
        self.slots: list[tuple[str, Body, complex]] = []  # a pin, what it runs on, and the way
        self.bodies = [body for body in held.links if not body.block]
        self._weld()
        for joint in held.joints.values():
            if joint.slides:
                self._slide(joint)
        self._order()

    def _at(self, joint: str) -> complex:
        return complex(*map(float, self.z[joint]))

    def _having(self, joint: str) -> list[Body]:
        return [body for body in self.bodies if joint in body.joints]

    def _weld(self) -> None:
        """Make one body of the links at a welded joint, as far as they are not one already."""
        sliding = {y for x in self.held.links if x.block for y in x.joints}
        for joint in self.held.joints.values():
            own = self._having(joint.id)
            if joint.welded and joint.id not in sliding and len(own) > 1:
                for other in own[1:]:
                    self._join(own[0], other)
                    own[0].joints += [x for x in other.joints if x not in own[0].joints]
                    own[0].ids += other.ids
                    self.bodies.remove(other)

    @staticmethod
    def _join(body: Body, other: Body) -> None:
        """Add a mass to a body: their centre, and the moment of inertia about it."""
        mass = body.mass + other.mass
        if mass:
            parts = zip(body.centre, other.centre, strict=True)
            x, y = ((body.mass * a + other.mass * b) / mass for a, b in parts)
            apart = zip(body.centre, other.centre, strict=True)
            square = sum((a - b) ** 2 for a, b in apart)
            body.inertia += other.inertia + body.mass * other.mass / mass * square
            body.centre = x, y
        body.mass = mass

    def _slide(self, slide: Joint) -> None:
        """Make a link, a rod in a barrel, or a slot, of a joint that slides."""
        block = next((x for x in self.held.links if x.block and slide.id in x.joints), None)
        pins = [x for x in block.joints if x != slide.id] if block else []
        if len(pins) != 1 or block is None:
            raise _refused("slides without a block at one pin", f"joint {slide.name}")
        (pin,) = pins
        own = self._having(pin)
        carrier = next((x for x in self.bodies if slide.carrier in x.ids), None)
        if slide.carrier and carrier is None:
            raise _refused("slides on a link that is not there", f"joint {slide.name}")
        way = cmath.rect(1.0, slide.angle)
        if slide.carrier:
            first, second = map(self._at, slide.way)
            if first == second:
                raise _refused("slides along two joints at one place", f"joint {slide.name}")
            way = (second - first) / abs(second - first)
        weight = Body("", block.mass, Decimal(0), self.z[pin], [], [])
        if self.held.joints[pin].welded and own:  # a rod that does not turn to what it slides on
            rod = own[0]
            if len(own) > 1 or rod.along is not None or rod is carrier:
                raise _refused("welds more than one link to a slide", f"joint {slide.name}")
            self._join(rod, weight)
            rod.joints = [pin, *(x for x in rod.joints if x != pin)]
            rod.along, rod.above = way, slide.carrier
        elif not (slide.carrier or block.mass or slide.driven) and own:
            self.on_line[pin] = way
            return
        elif not slide.carrier:
            self.bodies.append(
                Body(block.name, block.mass, Decimal(0), self.z[pin], [pin], block.ids, along=way)
            )
            rod = self.bodies[-1]
        else:
            if slide.driven or not own:
                what = "drives" if slide.driven else "slides without a link that has its pin"
                limit = f"{what} a block in a slot of {carrier.name if carrier else ''}"
                raise _refused(limit, f"joint {slide.name}")
            assert carrier is not None
            self._join(own[0], weight)
            self.slots.append((pin, carrier, way))
            return
        if carrier is not None:
            carrier.joints.append(pin)
        if slide.driven:
            self.driven.append(rod)

    def _order(self) -> None:
        """Put each link below what it hangs from, and begin its pins with that of its joint."""
        sliding = {body.joints[0]: body for body in self.bodies if body.along is not None}
        carriers = {
            pin: next((x for x in self.bodies if slide.above in x.ids), None)
            for pin, slide in sliding.items()
        }
        joints = self.held.joints
        fixed = [x.id for x in joints.values() if x.grounded and not x.slides]
        inputs = [x.id for x in joints.values() if x.driven and not x.slides]
        placed: list[Body] = []

        def held(pin: str) -> bool:
            """Return whether a link may hang by this pin from the ground or a placed link."""
            if pin in fixed and pin not in sliding:
                return True
            return any(pin in x.joints and x is not carriers.get(pin) for x in placed)

        def may(body: Body) -> list[str]:
            """The pins that a link may begin with; none where it must wait."""
            waits = (carriers.get(x) for x in body.joints if x in sliding and sliding[x].above)
            if any(x is not body and x not in placed for x in waits):
                return []
            if body.along is not None:
                return body.joints[:1]
            return sorted(
                filter(held, body.joints), key=lambda x: (x not in inputs, x not in fixed)
            )

        waiting = list(self.bodies)
        while waiting:
            ready = [(body, pins[0]) for body in waiting if (pins := may(body))]
            if not ready:
                names = ", ".join(body.name for body in waiting)
                limit = "hang on nothing that leads to the ground by pins and slides"
                raise _refused(limit, f"links {names}")
            body, pin = min(ready, key=lambda pair: pair[1] not in inputs)
            body.joints = [pin, *(x for x in body.joints if x != pin)]
            if pin in inputs:
                inputs.remove(pin)
                self.driven.append(body)
            waiting.remove(body)
            placed.append(body)
        self.bodies = placed
        used = {x for body in placed for x in body.joints}
        self.ground = [x for x in fixed if x in used]
        self.ground += [x for x, body in sliding.items() if not body.above and x not in fixed]

    def _named(self) -> None:
        """Names that scenes may have: links apart from one another, pins from links too."""
        taken: set[str] = set()
        for k, body in enumerate(self.bodies, start=1):
            plain = "".join(x for x in body.name.strip() if x.isprintable()) or f"link {k}"
            body.name = next(x for x in _tries(plain, " ") if x not in taken)
            taken.add(body.name)
        free = Places(dict.fromkeys(taken, 0), lambda _: 0j, lambda _: 0j)
        for body in self.bodies:
            for id in body.joints:
                if id not in self.names:
                    plain = re.sub(r"[^A-Za-z0-9_-]", "_", self.held.joints[id].name)[:50]
                    plain = plain if plain[:1].isalpha() else f"P{plain}"
                    known = {*self.names.values()}
                    names = (x for x in _tries(plain, "_") if x not in known)
                    self.names[id] = next(x for x in names if not free.not_free(x))

    def _turn(self, body: Body) -> complex:
        """The unit vector along a link's x axis."""
        if body.along is not None:
            return body.along
        axis = self._at(body.joints[1]) - self._at(body.joints[0])
        return axis / (abs(axis) or 1.0)

    def written(self) -> str:
        """The scene, as YAML."""
        for body in self.bodies:
            if body.along is None and len(body.joints) == 1:
                self._second_pin(body)
        self._named()
        unit = UNITS[_unit(self.held.units, 0, len(UNITS))][3]
        spins = self.held.flags >> CLOCKWISE & 1
        lines = ["# A mechanism of PMKS+, as drawn there."]
        lines += ["#", f"# Units: m kg, I kg m^2; there {unit}."]
        if self.driven:
            way = "clockwise" if spins else "counter-clockwise"
            lines.append(f"# Its input runs at {abs(self.held.speed)} rpm, {way}.")
        lines += [f"# Left out: {note}." for note in self.notes]
        lines += ["name: PMKS+ mechanism", f"gravity: {9.81 if self._weighs else 0}", "pins:"]
        for id, name in self.names.items():
            lines.append(f"  {name}: {_vector(self.z[id])}")
        lines.append("links:")
        for body in self.bodies:
            along = ""
            if body.along is not None:
                along = f", along: {_vector((body.along.real, body.along.imag))}"
            pins = ", ".join(self.names[x] for x in body.joints)
            lines.append(
                f"  - {{name: {_text(body.name)}, pins: [{pins}]{along}, m: {_number(body.mass)}, "
                f"centre: {_vector(body.centre)}, I: {_number(body.inertia)}}}"
            )
        ground = [self.names[x] for x in self.ground]
        for pin, line in self.on_line.items():
            along = _vector((line.real, line.imag))
            ground.append(f"{{pin: {self.names[pin]}, along: {along}}}")
        if ground:
            lines.append(f"ground: [{', '.join(ground)}]")
        if self.slots:
            lines.append("slots:")
        for pin, carrier, line in self.slots:
            on, along = _text(carrier.name), _vector((line.real, line.imag))
            lines.append(f"  - {{pin: {self.names[pin]}, on: {on}, along: {along}}}")
        if self.driven:
            lines.append(f"actuated: [{', '.join(_text(body.name) for body in self.driven)}]")
        loads = list(self._loads())
        lines += ["loads:", *loads] if loads else []
        return "\n".join(lines) + "\n"

    @property
    def _weighs(self) -> bool:
        return bool(self.held.flags >> GRAVITY & 1)

    def _second_pin(self, body: Body) -> None:
        """Give a link of one pin another, at its centre or beside it: its x axis goes there."""
        place = body.centre
        if place == self.z[body.joints[0]]:
            place = place[0] + self.metre, place[1]
        id = f"{body.joints[0]} x"
        first = self.held.joints[body.joints[0]]
        self.held.joints[id] = Joint(id, f"{first.name}_x", *place, False, False, False, False, 0.0)
        self.z[id] = place
        body.joints.append(id)

    def _loads(self) -> Iterator[str]:
        for numbers, id, name, turns in self.held.forces:
            body = next((x for x in self.bodies if id in x.ids), None)
            if body is None:
                raise _refused("acts on a link that is not there", f"force {name}")
            x, y, to_x, to_y, size = (_decimal(token) for token in numbers)
            begin = complex(float(x * self.metre), float(y * self.metre))
            way = complex(float(to_x - x), float(to_y - y))
            if not way:
                raise _refused("has no direction", f"force {name}")
            newton = size * POUND_FORCE if self.metre == UNITS[0][0] else size
            force = float(newton) * way / abs(way)
            turn = self._turn(body).conjugate()
            at = (begin - self._at(body.joints[0])) * turn
            force = force * turn if turns else force
            frame = ", frame: link" if turns else ""
            yield (
                f"  - {{link: {_text(body.name)}, at: {_vector((at.real, at.imag))}, "
                f"force: {_vector((force.real, force.imag))}{frame}}}  # {_comment(name)}"
            )


def _tries(name: str, between: str) -> Iterator[str]:
    yield name
    yield from (f"{name}{between}{k}" for k in count(2))


def _comment(text: str) -> str:
    return "".join(x if x.isprintable() else " " for x in text)


def _text(name: str) -> str:
    """A name in YAML: as it is, or quoted."""
    return name if re.fullmatch(r"[A-Za-z][\w-]*( [\w-]+)*", name) else json.dumps(name)


def _number(x: Decimal | float) -> str:
    """A number, decimals as they are unless they have more digits than a float."""
    if isinstance(x, Decimal) and len(x.normalize().as_tuple().digits) <= 15:
        plain = format(x.normalize(), "f")
        return plain if len(plain) <= 20 else repr(float(x))
    return repr(float(x) + 0.0)


def _vector(z: Sequence[Decimal | float]) -> str:
    return f"[{', '.join(map(_number, z))}]"
