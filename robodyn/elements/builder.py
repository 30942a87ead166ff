"""The builder: what elements write their rows with.

A force f at a point that has the coefficients c_k gives F_k -= conj(c_k) f.
`equations_of_motion.py` gathers what they write.
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
    RealPart,
    Scaled,
    Sum,
)
from robodyn.elements.program import Slot as Slot
from robodyn.elements.values import Signal

PlanarTerm = tuple[PlanarCoefficient, Slot]
Term = tuple[Coefficient, Slot]


Grip = tuple[PlanarPoint, int | None]  # a point, and the link (None: the ground) that it is of


class PointForce(NamedTuple):
    """A force of an element at a point, N: `unit` times the planar slot `force`, or `unit` itself.

    What feels the opposite, if anything does, is `back`.
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
    """What acts, of each force once.

    `torques` (n) are all that acts at each joint, None where nothing does; `forces` and `couples`
    what elements do to links.  F, constants and moments (n each) gather what acts on each link,
    `power` what changes the energy, with `work` alone.
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
        """A number of the scene as a coefficient."""
        return self.program.number(value)

    def planar_number(self, value: complex) -> PlanarCoefficient:
        """The same, planar."""
        return self.program.planar_number(value)

    def number_slot(self, value: float) -> Slot:
        """The slot of a number of the scene."""
        return self.program.add(Sum(self.program.number(value), ()))

    def sum(self, *terms: Term, constant: Coefficient = 0.0) -> Slot:
        """constant + sum of c x."""
        return self.program.sum(*terms, constant=constant)

    def planar_sum(self, *terms: PlanarTerm) -> Slot:
        """The sum of c x, planar."""
        return self.program.planar_sum(*terms)

    def product(self, x: Slot, y: Slot) -> Slot:
        """x y."""
        return self.program.add(Product(x, y))

    def quotient(self, x: Slot, y: Slot) -> Slot:
        """x/y."""
        return self.program.add(Quotient(x, y))

    def power_of(self, x: Slot, exponent: float) -> Slot:
        """x to a power."""
        return self.program.add(Power(x, exponent))

    def function(self, name: str, x: Slot) -> Slot:
        """A function of x."""
        return self.program.add(Function(name, x))

    def inner(self, x: Slot, y: Slot) -> Slot:
        """The dot product of two planar slots."""
        return self.program.add(Inner(x, y))

    def scaled(self, x: Slot, y: Slot) -> Slot:
        """x times the planar y."""
        return self.program.add(Scaled(x, y))

    def rate(self, x: Slot) -> Slot:
        """x'."""
        return self.program.add(Derivative(x))

    @abstractmethod
    def signal(self, signal: Signal, arm: float, x: Slot | None = None) -> Slot:
        """What a signal is, of a spring's extension x; `arm` makes a torque of it."""

    @abstractmethod
    def stored(self, law: Signal, x: Slot) -> Slot:
        """The energy of a spring at its extension x."""

    # what elements do

    def force(self, acting: PointForce, between: PlanarPoint | None = None) -> None:
        """A force at a point, N; `between` is the way to there from what feels the opposite."""
        self.forces.append(acting)
        if acting.force is not None and acting.unit:
            for k, c in (between or acting.at[0]).terms:
                self.F[k].append((self.planar_number(-c.conjugate() * acting.unit), acting.force))

    def moment(self, link: int | None, torque: Slot, spends: bool = True) -> None:
        """A torque on a link, N m; whether the energy changes by it."""
        self.couples.append(LinkMoment(link, torque))
        d = None if link is None else self.mechanism.frames[link]
        if d is not None:
            self.moments[d].append((-1.0, torque))
            if spends and self.work:
                self.works(1.0, self.product(torque, self.w(d)))

    def spin(self, joint: int, ratio: float, carrier: int | None) -> Slot:
        """w_carrier + ratio qd, the rate of a rotor at a joint, rad/s."""
        terms: list[Term] = [(self.number(ratio), self.v(joint))]
        if carrier is not None:
            terms.append((1.0, self.w(carrier)))
        return self.sum(*terms)

    def rotor(self, joint: int, inertia: float, ratio: float, carrier: int | None) -> None:
        """What a rotor does to the joint that drives it, and to the link that carries it."""
        bend = self.rate(self.spin(joint, ratio, carrier))
        self._rotors.append((joint, carrier, inertia, ratio, bend))

    def torque(self, joint: int, c: Coefficient, slot: Slot, spends: bool = True) -> None:
        """A torque c times `slot` at a joint, N m, or N; whether the energy changes by it."""
        self._acting[joint].append((c, slot))
        if spends and self.work:
            self.works(c, self.product(slot, self.v(joint)))

    def constant_torque(self, joint: int, torque: float) -> None:
        """A constant torque at a joint, N m, or N."""
        self._constant[joint] += torque

    def works(self, c: Coefficient, slot: Slot) -> None:
        """Power by which the energy changes, W: c times `slot`."""
        self.power.append((c, slot))

    def bends(self, slot: Slot, arm: float) -> None:
        """A slot whose series may hold only in part of a step, and what makes a torque of it."""
        self.program.named["bends"].append(slot)
        self.program.arms[slot] = arm

    def bends_planar(self, slot: Slot, arm: float) -> None:
        """The same of both parts of a planar slot."""
        for along in ((1.0, 0.0), (0.0, -1.0)):
            part = self.program.add(RealPart(self.planar_sum((along, slot))))
            self.bends(part, arm)
