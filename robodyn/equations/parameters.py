"""The parameters of a scene as symbols with the usual names.

Letters and meanings of plain numbers are declared by keys: m1, l1, I1, r1 (or r1x, r1y), k1, ...

    x3, y3             ground pivot of link 3
    p4x, p4y           where link 4 hangs from its link, if not from the tip
    a1x, b1x, ..       points that closure 1 joins; ends e1x, h1x of spring 1; c1x of load 1
    n1x, n1y           normal of the line of closure 1
    u2x, u2y           axis of joint 2, which slides; where it is zero, on a turned weld
    N1, J1, b1         ratio of the motor at joint 1, inertia and damping of its rotor
    i1 (or i1_2, ..)   ratio of coupling 1 (to joint 2, of several); its angle psi1, its length R1
    beta1x, beta1y     cosine and sine of the angle that closure 1 keeps; its length L1

Numbers at the end of a name count links, closures, springs and loads from 1.  A parameter that is
zero in the scene is no symbol; `zero` has its name.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

from robodyn.elements.base import Element
from robodyn.elements.joints import DryFriction, Stops
from robodyn.elements.keys import BY_DIRECTION, WAYS, Declared, Key
from robodyn.equations.law_terms import LawTerms, law_terms
from robodyn.equations.named_laws import Definition, symbol_of, with_symbols
from robodyn.equations.symbolic import ONE, ZERO, Atom, Planar, Role, Sum, of
from robodyn.errors import InputError, printable
from robodyn.mechanics.planar_model import ClosureRow, Mechanism
from robodyn.scene.expressions import names_of
from robodyn.scene.grammar import NUMBERS
from robodyn.scene.scene import (
    MASS,
    Closure,
    Coupling,
    Curve,
    Description,
    Law,
    Link,
    Point,
    Table,
    signals_of,
    told,
)

ROLES = {  # by unit
    "kg": Role.mass,
    "kg m²": Role.inertia,
    "N m s/rad": Role.damping,
    "N s/m": Role.damping,
    "m": Role.length,
    "rad": Role.length,
    "": Role.length,  # ratios
    "rad/m": Role.length,
    "m/s²": Role.gravity,
}


@dataclass(frozen=True, slots=True)
class Parameter:
    """A symbol of the equations: its value in the scene, unit and meaning."""

    name: str
    value: float
    unit: str
    meaning: str


class Parameters:
    """The symbols of a scene, one for each number of the file.

    `known` has the nonzero ones, `zero` the names of the others, in the order of the legend.
    `scene` is the description with symbols (Sum or Planar) for numbers.  `couplings` are rows sum_k
    turns_k q_k + offset = 0 in symbols: offset, turns by joint, and law.  `kept` has the parts of
    rows of kept angles, by closure.  `dry` and `stops` have dry friction and compliant stops by
    joint; they are not in `scene`.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        mechanism.check_rubbing("equations")
        description = self.description = mechanism.description
        for x in mechanism.added:
            limit = "equations have no symbols for it"
            raise InputError(x.word, where=description.source, limit=limit)
        for place, signal in signals_of(description):
            if isinstance(signal, Table):
                limit = "equations have expressions, no tables"
                raise InputError(place, where=description.source, value=told(signal), limit=limit)
        self.known: dict[str, Parameter] = {}
        self._constants(description)
        self.zero: dict[str, None] = {}
        self.has_masses = all(link.has_mass for link in description.links)
        self.dry: dict[int, DryFriction] = {}
        self.stops: dict[int, Stops] = {}
        self._points: dict[Point, Planar] = {}
        links = [self._link(k, link) for k, link in enumerate(description.links)]
        closures = [self._closure(c, closure) for c, closure in enumerate(description.closures)]
        arms = [row.arm for row in mechanism.rows if row.closure is None]
        coupled = zip(description.couplings, arms, strict=True)
        self.laws: list[Definition] = []  # names of laws of couplings, and of their derivatives
        self.couplings = [self._coupling(c, *x) for c, x in enumerate(coupled)]
        angles = ((row.closure, row) for row in mechanism.rows if row.arm)
        self.kept = {c: self._kept(c, row) for c, row in angles if c is not None}
        gravity: Any = self._gravity(description)
        for k, link in enumerate(description.links):
            for field in ("friction", "limits"):
                element = getattr(link, field)
                acting = [] if element is None else [*element.placed(mechanism.tree)]
                if isinstance(element, Stops):
                    if element.stiffness is not None:
                        self.stops[k] = self._at_joint(k, element)
                elif isinstance(element, DryFriction) and acting:
                    self.dry[k] = self._at_joint(k, element)
                elif acting:
                    links[k] = links[k]._replace(**{field: self._at_joint(k, element)})
            if link.motor is not None:
                links[k] = links[k]._replace(motor=self._at_joint(k, link.motor))
        self.scene: Any = description._replace(
            gravity=gravity,
            links=tuple(links),
            closures=tuple(closures),
            springs=tuple(
                self._element(i, x, f"spring {i + 1}", len(links) + i)  # ends after lengths
                for i, x in enumerate(description.springs)
            ),
            loads=tuple(
                self._element(i, x, f"load {i + 1}", i) for i, x in enumerate(description.loads)
            ),
        )

    def _constants(self, description: Description) -> None:
        """Take the constants of the scene that occur in its laws."""
        laws = [x.law for x in description.couplings] + [x for _, x in signals_of(description)]
        trees = (with_symbols(law.node) for law in laws if isinstance(law, Law))
        within = frozenset().union(*map(names_of, trees))
        for name, constant in description.constants:
            if (symbol := symbol_of(name)) in within:
                unit = "" if constant.unit == "1" else constant.unit
                told = printable(f"constant {name}")
                self.known[symbol] = Parameter(symbol, constant.value, unit, told)

    @cached_property
    def values(self) -> dict[str, Fraction]:
        """Return the values of the symbols, exact for the decimal numbers in the file."""
        return {name: Fraction(repr(entry.value)) for name, entry in self.known.items()}

    # -- parts of a scene ----------------------------------------------------------------------

    def _link(self, k: int, link: Link) -> Link:
        numbers = self._numbers(link, k, link.name, link.slides)
        above = link.hangs_from.link
        name, place, meaning = f"{{}}{k + 1}", (k, "x"), f"ground pivot of {link.name}"
        if above is not None:
            name, place = f"p{k + 1}{{}}", (above, "p")
            meaning = f"pivot of {link.name} {self._on(link.hangs_from)}"
        numbers["hangs_from"] = self._point(link.hangs_from, name, place, meaning)
        if link.axis is not None:
            meaning = f"axis that {link.name} slides on, its cosine with {{}}"
            u = f"u{k + 1}"
            numbers["axis"] = self._direction(u, k, link.axis, meaning, above, Role.direction)
        elif link.turn != 1.0:
            meaning = f"direction of {link.name} at q{k + 1} = 0, its cosine with {{}}"
            turn = complex(*(_whole(x) for x in (link.turn.real, link.turn.imag)))
            numbers["turn"] = self._direction(f"u{k + 1}", k, turn, meaning, above, Role.direction)
        return link._replace(**numbers, friction=None, limits=None)

    def _at_joint(self, k: int, item: Any) -> Any:
        link = self.description.links[k]
        return item._replace(**self._numbers(item, k, link.name, link.slides))

    def _closure(self, c: int, closure: Closure) -> Closure:
        along: Any = closure.along
        told = f"point of closure {c + 1} {self._on(closure.second)}"
        if along is not None:
            told = f"point of the line of closure {c + 1}"
            told += "" if closure.second.link is None else f" {self._on(closure.second)}"
        meaning = f"point of closure {c + 1} {self._on(closure.first)}"
        first = self._point(closure.first, f"a{c + 1}{{}}", (c, "a"), meaning)
        second = self._point(closure.second, f"b{c + 1}{{}}", (c, "b"), told)
        if along is not None:
            meaning = f"normal of the line of closure {c + 1}, its cosine with {{}}"
            carrier = closure.second.link
            along = -1j * self._direction(f"n{c + 1}", c, 1j * along, meaning, carrier)
        return Closure(first, second, along)

    def _kept(self, c: int, row: ClosureRow) -> ClosureRow:
        """Return the row of an angle that closure c keeps: arm sin(angle - kept angle)."""
        told = f"angle that closure {c + 1} keeps"
        meaning = f"length that turns the {told} into a gap"
        size = self._symbol(f"L{c + 1}", (c, "L"), row.arm, "m", meaning, Role.normal)
        (off,) = (p for p in (row.ground, *(p for _, p in row.P)) if p)
        angle = (1j * off / row.arm).conjugate()  # exp(i angle)
        cosines = []
        for axis, value, of_it in (("x", angle.real, "cosine"), ("y", angle.imag, "sine")):
            name, place, meaning = f"beta{c + 1}{axis}", (c, f"b{axis}"), f"{told}, its {of_it}"
            cosines.append(self._cosine(name, place, _whole(value), meaning, Role.direction))
        x, y = cosines
        turned: Any = -1j * (size * Planar(x, -y))
        P = tuple((k, turned) for k, _ in row.P)
        return row._replace(ground=turned if row.ground else 0j, P=P, arm=row.arm)

    def _direction(
        self, name: str, k: int, unit: complex, told: str, link: int | None, role: int = Role.normal
    ) -> Planar:
        """Return a unit vector by its cosines in a link's frame; 0 and 1 stay numbers."""
        x, y = "x", "y"
        if link is None:
            x, y = "X", "Y"
        else:
            told += f" of {self.description.links[link].name}"
        return Planar(
            self._cosine(f"{name}x", (k, "x"), unit.real, told.replace("{}", x), role),
            self._cosine(f"{name}y", (k, "y"), unit.imag, told.replace("{}", y), role),
        )

    def _cosine(
        self, name: str, place: tuple[int, str], value: float, meaning: str, role: int
    ) -> Sum:
        if abs(value) in (0.0, 1.0):
            return ONE.times(value)
        return self._symbol(name, place, value, "", meaning, role)

    def _coupling(
        self, c: int, coupling: Coupling, arm: float
    ) -> tuple[Sum, dict[int, Sum], LawTerms | None]:
        """Return offset, turns and law of a coupling's row, scaled by its arm."""
        size, unit, kind = ONE, "m", "displacement"
        if not self._slides(coupling.joint):
            meaning = f"length that turns the angle of coupling {c + 1} into a gap"
            size = self._symbol(f"R{c + 1}", (c, "R"), arm, "m", meaning, Role.normal)
            unit, kind = "rad", "angle"
        angle = ZERO
        if coupling.angle:
            told = f"{kind} of coupling {c + 1}"
            angle = self._symbol(f"psi{c + 1}", (c, "psi"), coupling.angle, unit, told)
        turns = {coupling.joint: size}
        for joint, ratio in coupling.terms:
            if abs(ratio) == 1.0:  # 1 and -1 stand as numbers
                turns[joint] = size.times(-ratio)
                continue
            name = f"i{c + 1}" if len(coupling.terms) == 1 else f"i{c + 1}_{joint + 1}"
            link = self.description.links[joint].name
            meaning = f"ratio of coupling {c + 1} to the joint of {link}"
            place, other = (c, f"i{joint}"), "m" if self._slides(joint) else "rad"
            per = "" if unit == other else f"{unit}/{other}"
            turns[joint] = -size * self._symbol(name, place, ratio, per, meaning, Role.length)
        law = None
        if isinstance(coupling.law, Curve):
            limit, file = "equations have expressions, no tables", coupling.law.file
            source = self.description.source
            raise InputError(f"couplings[{c}]", where=source, value=file, limit=limit)
        if coupling.law is not None:
            law, names = law_terms(c, coupling, size, lambda k: "m" if self._slides(k) else "rad")
            self.laws += names
        return -size * angle, turns, law

    def _gravity(self, description: Description) -> Planar:
        """Return gx + i gy, or -i g if it acts along -Y; varying parts are no symbols."""
        gamma, field = description.gravity, description.field
        if field is not None:
            parts = zip(field.varying, "xy", (gamma.real, gamma.imag), strict=True)
            x, y = (self._component(axis, z) if one is None else ZERO for one, axis, z in parts)
            return Planar(x, y)
        if gamma.real == 0.0 and gamma.imag <= 0.0:
            g = self._symbol("g", (0, ""), -gamma.imag, "m/s²", "gravity, along -Y")
            return Planar(ZERO, -g)
        return Planar(self._component("x", gamma.real), self._component("y", gamma.imag))

    def _component(self, axis: str, value: float) -> Sum:
        told = f"gravity along {axis.upper()}"
        return self._symbol(f"g{axis}", (0, axis), value, "m/s²", told)

    def _element(self, i: int, element: Element, told: str, place: int) -> Element:
        """Return an element with symbols; `place` orders its points among lengths."""
        slides = element.at is not None and self._slides(element.at)
        names = [link.name for link in self.description.links]
        symbols = self._numbers(element, i, told + element.called(names), slides)
        for field, symbol in element.points.items():
            letter, _, meaning = symbol.partition(": ")
            point = getattr(element, field)
            meaning = f"{meaning.replace('{}', told)} {self._on(point)}"
            symbols[field] = self._point(point, f"{letter}{i + 1}{{}}", (place, letter), meaning)
        return element._replace(**symbols)

    # -- numbers and points --------------------------------------------------------------------

    def _numbers(self, item: Declared, k: int, told: str, slides: bool) -> dict[str, Any]:
        """Return the symbols of the numbers of the k-th entry of a list, by field."""
        place = getattr(item, "link", k)
        return {
            field: self._number(key.of(slides), k, getattr(item, field), told, place)
            for field, key in item.keys.items()
            if key.symbol
            and getattr(item, field) is not None
            and not (key.instead and getattr(item, key.instead))
        }

    def _number(self, key: Key, k: int, value: Any, told: str, place: int) -> Any:
        letters, _, meaning = key.symbol.partition(": ")
        named, where = f"{letters}{k + 1}", (place, letters)
        meaning = meaning.replace("{}", told)
        if isinstance(value, tuple):  # by direction
            each = zip(WAYS, value, ("positive", "negative"), strict=True)
            return tuple(
                self._symbol(
                    f"{letters}{way}{k + 1}",
                    (place, letters + way),
                    x,
                    key.unit,
                    f"{meaning}, at {told} rates",
                )
                for way, x, told in each
            )
        if key.kind in NUMBERS or key.kind == BY_DIRECTION or key.kind == "varying":
            optional = key.optional and not value
            return ZERO if optional else self._symbol(named, where, value, key.unit, meaning)
        if key.kind == "centre" and value.imag == 0.0:
            meaning += ", from its joint"
            return Planar(self._symbol(named, where, value.real, key.unit, meaning), ZERO)
        if key.kind == "centre":
            meaning += ", in its frame"
        return self._pair(f"{named}{{}}", where, value, meaning, key.unit)

    def _symbol(
        self,
        name: str,
        place: tuple[int, str],
        value: float,
        unit: str,
        meaning: str,
        role: int | None = None,
    ) -> Sum:
        if value == 0.0:
            if name.rstrip("0123456789") not in MASS or self.has_masses:
                self.zero[name] = None
            return ZERO
        self.known[name] = Parameter(name, value, unit, printable(meaning))
        role = ROLES.get(unit, Role.force) if role is None else role
        return of(Atom(role, place, name))

    def _slides(self, joint: int) -> bool:
        return self.description.links[joint].slides

    def _on(self, point: Point) -> str:
        if point.link is None:
            return "on the ground"
        return f"on {self.description.links[point.link].name}, in its frame"

    def _point(self, point: Point, name: str, place: tuple[int, str], meaning: str) -> Point:
        """Return a point in symbols; the same point has the same symbols everywhere."""
        if point.link is not None and point.at == self.description.links[point.link].l != 0.0:
            link = self.description.links[point.link]
            length: Any = self._number(Link.keys["l"], point.link, link.l, link.name, point.link)
            return Point(point.link, length * Planar(ONE, ZERO))
        if point not in self._points:
            self._points[point] = self._pair(name, place, point.at, meaning, "m")
        at: Any = self._points[point]
        return Point(point.link, at)

    def _pair(
        self, name: str, place: tuple[int, str], value: complex, told: str, unit: str
    ) -> Planar:
        """Return two symbols, with x and y in the name's braces; a zero coordinate has none."""
        k, letters = place
        parts = [
            self._symbol(name.format(axis), (k, letters + axis), amount, unit, f"{told}, {axis}")
            if amount
            else ZERO
            for axis, amount in (("x", value.real), ("y", value.imag))
        ]
        return Planar(*parts)


def _whole(value: float) -> float:
    """Return a cosine as 0, 1 or -1 if it is that within rounding."""
    return float(round(value)) if abs(value - round(value)) < 1e-15 else value
