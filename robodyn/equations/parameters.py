"""The parameters of a scene as symbols with the names that a person would give them.

    m1, l1, I1         mass, length, moment of inertia about the centre of gravity
    r1 (or r1x, r1y)   centre of gravity from the link's own joint
    mp1, d1            payload at the tip, damping of the joint
    x3, y3             ground pivot of link 3
    p4x, p4y           where link 4 hangs from its link, if not from the tip
    a1x, a1y, b1x, ..  points that closure 1 joins, if no tips
    n1x, n1y           normal of the line of closure 1
    i1 (or i1_2, ..)   ratio of coupling 1 (to joint 2, of several); its angle psi1, its length R1
    g (or gx, gy)      gravity

Numbers at the end of a name count links and closures from 1.  What is zero in the scene is no
symbol: it drops out, and `zero` tells its name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from robodyn.equations.symbolic import NOWHERE, ONE, ZERO, Planar, Role, Sum, Symbol, of
from robodyn.errors import printable
from robodyn.scene.scene import Description, Point

if TYPE_CHECKING:
    from fractions import Fraction


@dataclass(frozen=True, slots=True)
class Parameter:
    """A symbol of the equations: its value in the scene, unit and meaning."""

    name: str
    value: float
    unit: str
    meaning: str


class Parameters:
    """The symbols of a scene's links; each stands for one number of the file.

    `known` holds those that are not zero, `zero` the names of those that are, in the order of a
    legend: link by link, then closures, then gravity.
    """

    def __init__(self, description: Description, arms: Sequence[float] = ()) -> None:
        self.description = description
        self.arms = arms
        self.known: dict[str, Parameter] = {}
        self.zero: dict[str, None] = {}
        self._points: dict[Point, Planar] = {}
        for k in range(len(description.links)):
            self.mass(k)
            self.tip(k)
            self.centre(k)
            self.inertia(k)
            self.payload(k)
            self.damping(k)
            self.hanging(k)
        for c, closure in enumerate(description.closures):
            self.side(c, "a")
            self.side(c, "b")
            if closure.along is not None:
                self.normal(c)
        for c, coupling in enumerate(description.couplings):
            self.arm(c)
            self.offset_angle(c)
            for j, _ in coupling.terms:
                self.ratio(c, j)
        self.gravity()

    @cached_property
    def values(self) -> dict[str, Fraction]:
        """The numbers of the symbols, exactly as the decimal numbers that they are written as."""
        from fractions import Fraction

        return {name: Fraction(repr(entry.value)) for name, entry in self.known.items()}

    def gravity(self) -> Planar:
        """gx + i gy; -i g where it acts along -Y."""
        gamma = self.description.gravity
        if gamma.real == 0.0 and gamma.imag <= 0.0:
            g = self.symbol("g", Role.gravity, (0, ""), -gamma.imag, "m/s²", "gravity, along -Y")
            return Planar(ZERO, -g)
        return Planar(
            self.symbol("gx", Role.gravity, (0, "x"), gamma.real, "m/s²", "gravity along X"),
            self.symbol("gy", Role.gravity, (0, "y"), gamma.imag, "m/s²", "gravity along Y"),
        )

    # -- of a link -----------------------------------------------------------------------------

    def mass(self, k: int) -> Sum:
        link = self.description.links[k]
        meaning = f"mass of {link.name}"
        return self.symbol(f"m{k + 1}", Role.mass, (k, "m"), link.m, "kg", meaning)

    def payload(self, k: int) -> Sum:
        link = self.description.links[k]
        meaning = f"payload at the tip of {link.name}"
        named = f"mp{k + 1}", Role.mass, (k, "mp")
        return self.symbol(*named, link.payload, "kg", meaning) if link.payload else ZERO

    def inertia(self, k: int) -> Sum:
        link = self.description.links[k]
        meaning = f"moment of inertia of {link.name} about its centre of gravity"
        return self.symbol(f"I{k + 1}", Role.inertia, (k, "I"), link.I, "kg m²", meaning)

    def damping(self, k: int) -> Sum:
        link = self.description.links[k]
        meaning = f"damping at the joint of {link.name}"
        named = f"d{k + 1}", Role.damping, (k, "d")
        return self.symbol(*named, link.damping, "N m s/rad", meaning) if link.damping else ZERO

    def centre(self, k: int) -> Planar:
        """The centre of gravity in the frame of link k: r, or rx + i ry off its axis."""
        link = self.description.links[k]
        meaning = f"centre of gravity of {link.name}"
        if link.r.imag == 0.0:
            told = f"{meaning}, from its joint"
            named = f"r{k + 1}", Role.length, (k, "r")
            return Planar(self.symbol(*named, link.r.real, "m", told), ZERO)
        names = f"r{k + 1}x", f"r{k + 1}y"
        return self.pair(names, (k, "r"), link.r, f"{meaning}, in its frame")

    def tip(self, k: int) -> Planar:
        link = self.description.links[k]
        meaning = f"length of {link.name}"
        named = f"l{k + 1}", Role.length, (k, "l")
        return Planar(self.symbol(*named, link.l, "m", meaning), ZERO)

    def hanging(self, k: int) -> Planar:
        """The point that link k hangs from, in the frame of the link or the ground there."""
        point, name = self.description.links[k].hangs_from, self.description.links[k].name
        if point.link is None:
            meaning = f"ground pivot of {name}"
            return self.point(point, (f"x{k + 1}", f"y{k + 1}"), (k, "x"), meaning)
        carrier = self.description.links[point.link].name
        meaning = f"pivot of {name} on {carrier}, in its frame"
        return self.point(point, (f"p{k + 1}x", f"p{k + 1}y"), (point.link, "p"), meaning)

    # -- of a closure --------------------------------------------------------------------------

    def side(self, c: int, letter: str) -> Planar:
        """The point of closure c that is named first ("a") or second ("b"), in its own frame."""
        closure = self.description.closures[c]
        point = closure.first if letter == "a" else closure.second
        meaning = f"point of closure {c + 1} {self.on(point)}"
        if closure.along is not None and letter == "b":
            meaning = f"point of the line of closure {c + 1}"
        name = f"{letter}{c + 1}"
        return self.point(point, (f"{name}x", f"{name}y"), (c, letter), meaning)

    def normal(self, c: int) -> Planar:
        """The unit vector along which the gap of slider c is measured; 0 and 1 stand as numbers."""
        along = self.description.closures[c].along
        assert along is not None
        normal = 1j * along
        meaning = f"normal of the line of closure {c + 1}, its cosine with"

        def cosine(axis: str, value: float) -> Sum:
            if abs(value) in (0.0, 1.0):
                return ONE.times(int(value)) if value else ZERO
            named = f"n{c + 1}{axis}", Role.normal, (c, axis)
            return self.symbol(*named, value, "", f"{meaning} {axis.upper()}")

        return Planar(cosine("x", normal.real), cosine("y", normal.imag))

    def on(self, point: Point) -> str:
        if point.link is None:
            return "on the ground"
        return f"on {self.description.links[point.link].name}, in its frame"

    # -- of a coupling -------------------------------------------------------------------------

    def arm(self, c: int) -> Sum:
        """The length (m) that the angle by which a coupling is open is multiplied by."""
        named = f"R{c + 1}", Role.normal, (c, "R")
        meaning = f"length that turns the angle of coupling {c + 1} into a gap"
        return self.symbol(*named, self.arms[c], "m", meaning)

    def ratio(self, c: int, joint: int) -> Sum:
        """The ratio of a joint in coupling c; 1 and -1 stand as numbers."""
        terms = dict(self.description.couplings[c].terms)
        if abs(terms[joint]) == 1.0:
            return ONE.times(int(terms[joint]))
        name = f"i{c + 1}" if len(terms) == 1 else f"i{c + 1}_{joint + 1}"
        link = self.description.links[joint].name
        meaning = f"ratio of coupling {c + 1} to the joint of {link}"
        return self.symbol(name, Role.length, (c, f"i{joint}"), terms[joint], "", meaning)

    def offset_angle(self, c: int) -> Sum:
        angle = self.description.couplings[c].angle
        named = f"psi{c + 1}", Role.length, (c, "psi")
        return self.symbol(*named, angle, "rad", f"angle of coupling {c + 1}") if angle else ZERO

    # -- symbols -------------------------------------------------------------------------------

    def symbol(
        self, name: str, role: Role, place: tuple[int, str], value: float, unit: str, meaning: str
    ) -> Sum:
        if value == 0.0:
            self.zero[name] = None
            return ZERO
        self.known[name] = Parameter(name, value, unit, printable(meaning))
        return of(Symbol(name, role, place))

    def point(
        self, point: Point, names: tuple[str, str], place: tuple[int, str], meaning: str
    ) -> Planar:
        """A point of a link or of the ground; the same point has the same symbols everywhere."""
        if point.at == 0.0:
            return NOWHERE
        if point.link is not None and point.at == self.description.links[point.link].l:
            return self.tip(point.link)
        if point not in self._points:
            self._points[point] = self.pair(names, place, point.at, meaning)
        return self._points[point]

    def pair(
        self,
        names: tuple[str, str],
        place: tuple[int, str],
        value: complex,
        meaning: str,
        role: Role = Role.length,
        unit: str = "m",
    ) -> Planar:
        parts = []
        for name, axis, amount in zip(names, "xy", (value.real, value.imag), strict=True):
            named = name, role, (place[0], place[1] + axis)
            known = self.symbol(*named, amount, unit, f"{meaning}, {axis}") if amount else ZERO
            parts.append(known)
        return Planar(*parts)
