"""The builder through which elements write their rows.

A force f at a point with coefficients c_k gives F_k -= conj(c_k) f.  `equations_of_motion.py`
collects what elements write.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

from robodyn.elements.link_rows import LinkRows, Links, PlanarPoint
from robodyn.elements.program import (
    Coefficient,
    Derivative,
    Function,
    Inner,
    PlanarCoefficient,
    Power,
    Product,
    Quotient,
    Scaled,
    Sum,
)
from robodyn.elements.program import Slot as Slot
from robodyn.elements.values import Signal
from robodyn.tables.records import Record

PlanarTerm = tuple[PlanarCoefficient, Slot]
Term = tuple[Coefficient, Slot]


Grip = tuple[PlanarPoint, int | None]  # a point, and the link (None: the ground) that it is of


class Name(Record):
    """The name of an element's slot in written equations: letters before its number, and after.

    `meaning` has {} for the element; `link` orders names that belong to a link.
    """

    letter: str
    unit: str
    meaning: str
    axis: str = ""
    link: int | None = None


class PointForce(NamedTuple):
    """A force of an element at a point, N: `unit` times the planar slot `force`, or `unit`.

    `back` is the point that feels the opposite, if any.
    """

    element: Any  # whose force it is
    unit: complex
    force: Slot | None
    at: Grip
    back: Grip | None = None
    square: Slot | None = None  # of the distance that gives its direction


class LinkMoment(NamedTuple):
    """A torque of an element on a link (None: the ground), N m."""

    link: int | None
    torque: Slot


class NoDirection(ZeroDivisionError):
    """The ends of the element of this name coincide at every state."""


class Builder(LinkRows, ABC):
    """Collects forces and torques, each written once.

    `torques` (n) are the sums at joints, None for no torque.  `forces` and `couples` act on links.
    F, constants and moments (n each) are sums per link.  `power` changes the energy; it is
    collected only with `work`.
    """

    def __init__(self, mechanism: Links) -> None:
        super().__init__(mechanism)
        self.work = False
        self.torques: list[Slot | None] = [None] * mechanism.n
        self.forces: list[PointForce] = []
        self.couples: list[LinkMoment] = []
        self.F: list[list[PlanarTerm]] = [[] for _ in self.x]
        self.constants = [-weight.conjugate() for weight in mechanism.weights]
        self.moments: list[list[Term]] = [[] for _ in self.x]
        self.power: list[Term] = []
        self._acting: list[list[Term]] = [[] for _ in self.x]
        self._rotors: list[tuple[int, int | None, float, float, Slot]] = []
        self._constant = [0.0] * mechanism.n

    # what elements write rows with

    def number(self, value: float) -> Coefficient:
        """Return a number of the scene as a coefficient."""
        return self.program.number(value)

    def planar_number(self, value: complex) -> PlanarCoefficient:
        """Return a complex number of the scene as a coefficient."""
        return self.program.planar_number(value)

    def number_slot(self, value: float) -> Slot:
        """Return a slot with a number of the scene."""
        return self.program.add(Sum(self.program.number(value), ()))

    def sum(self, *terms: Term, constant: Coefficient = 0.0) -> Slot:
        """Return constant + sum of c x."""
        return self.program.sum(*terms, constant=constant)

    def planar_sum(self, *terms: PlanarTerm) -> Slot:
        """Return the planar sum of c x."""
        return self.program.planar_sum(*terms)

    def product(self, x: Slot, y: Slot) -> Slot:
        """Return x y."""
        return self.program.add(Product(x, y))

    def quotient(self, x: Slot, y: Slot) -> Slot:
        """Return x/y."""
        return self.program.add(Quotient(x, y))

    def power_of(self, x: Slot, exponent: float) -> Slot:
        """Return x to a power."""
        return self.program.add(Power(x, exponent))

    def function(self, name: str, x: Slot) -> Slot:
        """Return a function of x."""
        return self.program.add(Function(name, x))

    def inner(self, x: Slot, y: Slot) -> Slot:
        """Return the dot product of two planar slots."""
        return self.program.add(Inner(x, y))

    def scaled(self, x: Slot, y: Slot) -> Slot:
        """Return x times the planar y."""
        return self.program.add(Scaled(x, y))

    def rate(self, x: Slot) -> Slot:
        """Return dx/dt."""
        return self.program.add(Derivative(x))

    @abstractmethod
    def signal(self, signal: Signal, name: Name, x: Slot | None = None) -> Slot:
        """Return the value of a signal, at a spring's extension x."""

    @abstractmethod
    def stored(self, law: Signal, x: Slot) -> Slot:
        """Return the energy of a spring at its extension x."""

    # what equations call it

    def named(self, name: Name, slot: Slot, sign: float = 1.0) -> Slot:
        """Return the slot; in written equations, the name stands for `sign` times it."""
        return slot

    def span(self, name: Name, place: PlanarPoint, always: bool) -> Slot:
        """Return a difference of points, planar.

        In written equations two names stand for it, `always` or only if it joins two branches of
        links.
        """
        return self.point(place)

    def root(self, name: Name, square: Slot) -> None:
        """In written equations, let the name stand for the square root of a slot."""

    # what elements do

    def write_rows(self, element: Any) -> None:
        """Write the rows of an element."""
        element.rows(self)

    def force(self, acting: PointForce, between: PlanarPoint | None = None) -> None:
        """Add a force at a point, N; `between` is its vector from where the opposite acts."""
        self.forces.append(acting)
        if acting.force is not None and acting.unit:
            for k, c in (between or acting.at[0]).terms:
                self.F[k].append((self.planar_number(-c.conjugate() * acting.unit), acting.force))

    def moment(self, link: int | None, torque: Slot, spends: bool = True) -> None:
        """Add a torque on a link, N m; `spends` if it changes the energy."""
        self.couples.append(LinkMoment(link, torque))
        d = None if link is None else self.mechanism.frames[link]
        if d is not None:
            self.moments[d].append((-1.0, torque))
            if spends and self.work:
                self.works(1.0, self.product(torque, self.w(d)))

    def spin(self, joint: int, ratio: float, carrier: int | None) -> Slot:
        """Return w_carrier + ratio qd, the rate of a rotor at a joint, rad/s."""
        terms: list[Term] = [(self.number(ratio), self.v(joint))]
        if carrier is not None:
            terms.append((1.0, self.w(carrier)))
        return self.sum(*terms)

    def rotor(self, joint: int, inertia: float, ratio: float, carrier: int | None) -> None:
        """Add a rotor, which acts on the joint that drives it and the link that carries it."""
        bend = self.rate(self.spin(joint, ratio, carrier))
        self._rotors.append((joint, carrier, inertia, ratio, bend))

    def torque(self, joint: int, c: Coefficient, slot: Slot, spends: bool = True) -> None:
        """Add a torque c times `slot` at a joint, N m or N; `spends` if it changes the energy."""
        self._acting[joint].append((c, slot))
        if spends and self.work:
            self.works(c, self.product(slot, self.v(joint)))

    def constant_torque(self, joint: int, torque: float) -> None:
        """Add a constant torque at a joint, N m or N."""
        self._constant[joint] += torque

    def works(self, c: Coefficient, slot: Slot) -> None:
        """Add c times `slot` to the power that changes the energy, W."""
        self.power.append((c, slot))
