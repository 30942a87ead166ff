"""The builder: what elements write their rows with, and what gathers what they do.

A force f at a point that has the coefficients c_k gives F_k -= conj(c_k) f.  A joint's torque is
tau - D qd and what the elements there give.  A new kind of either is a class in `elements`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from robodyn.elements.base import Element, PlanarPoint, PointForce
from robodyn.mechanics.link_rows import LinkRows
from robodyn.mechanics.planar_model import Mechanism
from robodyn.mechanics.program import (
    Coefficient,
    Derivative,
    Function,
    Given,
    Inner,
    PlanarCoefficient,
    Power,
    Product,
    Quotient,
    RealPart,
    Scaled,
    Sum,
)
from robodyn.mechanics.program import Slot as Slot
from robodyn.scene.scene import Law, Signal, Table

PlanarTerm = tuple[PlanarCoefficient, Slot]
Term = tuple[Coefficient, Slot]


class LinkMoment(NamedTuple):
    """A torque of an element on a link (None: the ground), N m."""

    link: int | None
    torque: Slot


class Builder(LinkRows):
    """What acts, of each force once.

    `torques` (n) are all that acts at each joint, None where nothing does; `forces` and `couples`
    what elements do to links.  F, constants and moments (n each) gather what acts on each link,
    `power` what changes the energy, with `work` alone.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__(mechanism)
        self.work = False
        self.torques: list[Slot | None] = [None] * mechanism.n
        self.forces: list[PointForce] = []
        self.couples: list[LinkMoment] = []
        self.tables: list[tuple[Table, Slot]] = []  # and what they are over
        self.laws: list[tuple[Law, Slot]] = []  # and what they are
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

    def stored(self, law: Signal, x: Slot) -> Slot:
        """The energy of a spring at its extension x."""
        from robodyn.mechanics.signal_rows import stored_energy  # only scenes with laws import it

        return stored_energy(self, law, x)

    def signal(self, signal: Signal, arm: float, x: Slot | None = None) -> Slot:
        """What a signal is, of a spring's extension x; `arm` makes a torque of it."""
        from robodyn.mechanics.signal_rows import signal_rows

        if isinstance(signal, Table):
            self.tables.append((signal, self.variable(signal.over) if x is None else x))
        own = {} if x is None else {"x": x, "v": self.rate(x)}
        slot, watched = signal_rows(self, signal, own)
        if isinstance(signal, Law):
            self.laws.append((signal, slot))
        for each, scale in watched:
            self.bends(each, arm * scale)
            if isinstance(signal, Table):
                self.program.named.setdefault("lines", []).append(each)
        return slot

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

    # what gathers them

    def energies(self) -> Iterator[Term]:
        """What the elements hold."""
        for element in self.mechanism.elements:
            yield from element.energy(self)

    def kinetic_energies(self) -> Iterator[Term]:
        """What moves in them."""
        for element in self.mechanism.elements:
            yield from element.kinetic(self)

    def _scene_forces(self) -> None:
        on_links = (x for x in self.mechanism.elements if x.at is None and x.acts)
        for element in sorted(on_links, key=lambda x: x.rank):
            element.rows(self)

    def _joints(self, torques: Sequence[Slot | None], steady: bool) -> None:
        """Torques at the joints: what a link gets its parent gives."""
        here: list[list[Element]] = [[] for _ in torques]
        for element in self.mechanism.elements:
            if element.at is not None:
                here[element.at].append(element)
        for j, tau in enumerate(torques):
            if tau is not None:
                self.torque(j, 1.0, tau, spends=not steady)
                if not isinstance(self.program.rows[tau], Given):
                    self.bends(tau, 1.0)
            if self.mechanism.damping[j]:
                self.torque(j, self.number(-self.mechanism.damping[j]), self.v(j))
            for element in sorted(here[j], key=lambda x: x.rank):
                element.rows(self)
            acting, constant = self._acting[j], self._constant[j]
            if acting or constant:
                self.torques[j] = self.sum(*acting, constant=self.number(constant))

    def _spun(self) -> None:
        """What rotors do, beside all that acts at their joints."""
        for k, d, inertia, ratio, bend in self._rotors:
            before = self.torques[k]
            own: list[Term] = [] if before is None else [(1.0, before)]
            self.torques[k] = self.sum(*own, (self.number(-inertia * ratio), bend))
            if d is not None:
                self.moments[d].append((self.number(inertia), bend))
