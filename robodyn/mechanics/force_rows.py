"""The rows of what acts on the links of a scene besides weights and closures.

A spring between points d = const + sum_k c_k X_k from end to end pulls its first end by

    f = (k L s^-1/2 - k - D (d.d')/s) d,        s = d.d,

and its second by -f.  A constant force F turns with its link as F E.  A force f at a point that has
the coefficients c_k gives F_k -= conj(c_k) f.  A joint's torque is

    T = tau - D qd - friction tanh(qd/speed) - k (q - angle),

and that of a joint which slips one way (way = 1 or -1) loses besides

    way (torque + (static - torque) exp(-(qd/stribeck)^2)),

the force along its axis where the joint slides.  A spring with a law F pulls by F(x, v) in the
place of k x, with its extension x = sqrt(s) - L or q - angle, and v = x'.  Loads that vary are
signals in place of numbers.

A new kind of force or of joint torque is a few more rows here: what it does, the energy that it
holds, or its power.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from robodyn.mechanics.link_rows import LinkRows
from robodyn.mechanics.planar_model import Force, Mechanism, PlanarPoint, PointSpring, conserves
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
    Slot,
    Sum,
)
from robodyn.scene.scene import JointSpring, Law, Signal, Table

PlanarTerm = tuple[PlanarCoefficient, Slot]
Term = tuple[Coefficient, Slot]


class NoDirection(ZeroDivisionError):
    """The ends of the spring between points of this place coincide at every state."""


class PointForce(NamedTuple):
    """A force at points, N: `unit` times the planar slot `force`, or `unit` itself."""

    unit: complex
    force: Slot | None
    first: int | None  # the link that feels it, and the one that feels the opposite
    second: int | None = None
    square: Slot | None = None  # of the distance that gives its direction


class ForceRows(LinkRows):
    """What acts, of each force once.

    `torques` (n) are all that acts at each joint, None where nothing does; `forces` the springs
    between points, then the loads, as forces on links.  F, constants and moments (n each) gather
    what acts on each link, `power` what changes the energy.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__(mechanism)
        self.torques: list[Slot | None] = [None] * mechanism.n
        self.forces: list[PointForce] = []
        self.varying_moments: list[Slot] = []
        self.tables: list[tuple[Table, Slot]] = []  # and what they are over
        self.laws: list[tuple[Law, Slot]] = []  # and what they are
        self.F: list[list[PlanarTerm]] = [[] for _ in self.x]
        self.constants = [-weight.conjugate() for weight in mechanism.weights]
        self.moments: list[list[Term]] = [[] for _ in self.x]
        self.power: list[Term] = []

    def _spring_energies(self) -> Iterator[Term]:
        """What the springs hold."""
        program, number = self.program, self.program.number
        for spring in self.mechanism.springs:
            d = self.point(spring.between)
            square = program.add(Inner(d, d))
            if spring.law is not None and conserves(spring.law):
                yield 1.0, self._stored(spring.law, self._longer(spring, square))
            if spring.stiffness:
                if spring.length:
                    longer = self._longer(spring, square)
                    square = program.add(Product(longer, longer))
                yield number(0.5 * spring.stiffness), square
        for turned in self.mechanism.joint_springs:
            if turned.law is not None and conserves(turned.law):
                yield 1.0, self._stored(turned.law, self._turned(turned))
            if turned.stiffness:
                way = self._turned(turned)
                yield number(0.5 * turned.stiffness), program.add(Product(way, way))

    def _longer(self, spring: PointSpring, square: Slot) -> Slot:
        """Its length, by the square of that, less the free one."""
        reach = self.program.add(Power(square, 0.5))
        return self.program.sum((1.0, reach), constant=self.program.number(-spring.length))

    def _turned(self, spring: JointSpring) -> Slot:
        """How far its joint is from where it is free."""
        free = self.program.number(-spring.angle)
        return self.program.sum((1.0, self.q(spring.joint)), constant=free)

    def _stored(self, law: Signal, x: Slot) -> Slot:
        """The energy of a spring at its extension x."""
        from robodyn.mechanics.signal_rows import stored_energy  # only scenes with laws import it

        return stored_energy(self, law, x)

    def _signal(self, signal: Signal, arm: float, x: Slot | None = None) -> Slot:
        """What a signal is, of a spring's extension x; `arm` makes a torque of it."""
        from robodyn.mechanics.signal_rows import signal_rows

        if isinstance(signal, Table):
            self.tables.append((signal, self.variable(signal.over) if x is None else x))
        own = {} if x is None else {"x": x, "v": self.program.add(Derivative(x))}
        slot, watched = signal_rows(self, signal, own)
        if isinstance(signal, Law):
            self.laws.append((signal, slot))
        for each, scale in watched:
            self._bends(each, arm * scale)
            if isinstance(signal, Table):
                self.program.named.setdefault("lines", []).append(each)
        return slot

    def _scene_forces(self, work: bool) -> None:
        program = self.program
        for place, spring in enumerate(self.mechanism.springs):
            if spring.directed and not (spring.between.terms or spring.between.constant):
                raise NoDirection(place)
            self._spring(spring, work)
        for moment in self.mechanism.varying_moments:
            d = self.mechanism.frames[moment.link]
            torque = self._signal(moment.signal, 1.0)
            self.varying_moments.append(torque)
            if d is not None:
                self.moments[d].append((-1.0, torque))
                if work:
                    self.power.append((1.0, program.add(Product(torque, self.w(d)))))
        for load in self.mechanism.forces:
            if load.signals is not None:
                self._varying_force(load, load.signals, work)
                continue
            frame = self.mechanism.frames[load.link] if load.turns else None
            E = None if frame is None else self.x[frame]  # without it it is among the weights
            self._act(load.point, PointForce(load.force, E, load.link))
            if work and E is not None:
                turned = program.planar_sum((program.planar_number(load.force), E))
                moving = program.add(Derivative(self.point(load.point)))
                self.power.append((1.0, program.add(Inner(turned, moving))))

    def _varying_force(
        self, load: Force, signals: tuple[Signal | float, Signal | float], work: bool
    ) -> None:
        program, number, point = self.program, self.program.planar_number, load.point
        frame = self.mechanism.frames[load.link] if load.turns else None
        force: list[PlanarTerm] = []
        for unit, signal in zip((load.turned, 1j * load.turned), signals, strict=True):
            if isinstance(signal, (Law, Table)):
                slot = self._signal(signal, _reach(point))
            else:
                slot = program.add(Sum(program.number(signal), ()))
            if frame is not None:
                slot = program.add(Scaled(slot, self.x[frame]))
            force.append((number(unit), slot))
        acting = program.planar_sum(*force)
        self._act(point, PointForce(1.0, acting, load.link))
        if work and point.terms:
            moving = program.add(Derivative(self.point(point)))
            self.power.append((1.0, program.add(Inner(acting, moving))))

    def _act(self, point: PlanarPoint, acting: PointForce) -> None:
        """A force at a point: F_k -= conj(c_k) f."""
        self.forces.append(acting)
        if acting.force is not None and acting.unit:
            for k, c in point.terms:
                number = self.program.planar_number(-c.conjugate() * acting.unit)
                self.F[k].append((number, acting.force))

    def _spring(self, spring: PointSpring, work: bool) -> None:
        program, number, place = self.program, self.program.number, spring.between
        d = self.point(place)
        pull: list[Term] = []
        if spring.law is not None:
            square = program.add(Inner(d, d))
            longer = self._longer(spring, square)
            tension = self._signal(spring.law, _reach(place), longer)
            distance = program.add(Power(square, 0.5))
            pull.append((-1.0, program.add(Quotient(tension, distance))))
            if work and place.terms and not conserves(spring.law):
                rate = program.add(Derivative(longer))
                self.power.append((-1.0, program.add(Product(tension, rate))))
        s = program.add(Inner(d, d)) if spring.directed else None
        if s is not None and spring.length and spring.stiffness:
            pull.append((number(spring.stiffness * spring.length), program.add(Power(s, -0.5))))
        if s is not None and spring.damping:
            half = program.sum((0.5, program.add(Derivative(s))))  # d.d'
            ratio = program.add(Quotient(half, s))
            pull.append((number(-spring.damping), ratio))
            if work and place.terms:
                squared = program.add(Product(half, ratio))
                self.power.append((number(-spring.damping), squared))
        unit, force = -spring.stiffness, d
        if pull:
            factor = program.sum(*pull, constant=number(-spring.stiffness))
            unit, force = 1.0, program.add(Scaled(factor, d))
        self._act(place, PointForce(unit, force, spring.first, spring.second, s))
        if pull and place.terms:
            for along in ((1.0, 0.0), (0.0, -1.0)):  # its parts stay finite where d passes 0
                part = program.add(RealPart(program.planar_sum((along, force))))
                self._bends(part, _reach(place))

    def _joints(self, torques: Sequence[Slot | None], work: bool, steady: bool) -> None:
        """Torques at the joints: what a link gets its parent gives."""
        program, number, mechanism = self.program, self.program.number, self.mechanism
        friction = dict(mechanism.friction)
        springs: dict[int, list[JointSpring]] = {}
        for spring in mechanism.joint_springs:
            springs.setdefault(spring.joint, []).append(spring)
        for j, tau in enumerate(torques):
            acting: list[Term] = []  # all of this changes the energy
            if tau is not None:
                acting.append((1.0, tau))
                if not isinstance(program.rows[tau], Given):
                    self._bends(tau, 1.0)
            if mechanism.damping[j]:
                acting.append((number(-mechanism.damping[j]), self.v(j)))
            if j in friction:
                slow = program.sum((number(1.0 / friction[j].speed), self.v(j)))
                smooth = program.add(Function("tanh", slow))
                acting.append((number(-friction[j].torque), smooth))
                self._bends(smooth, friction[j].torque)
            laws = ((spring, spring.law) for spring in springs.get(j, []))
            pulls = [
                ((-1.0, self._signal(law, 1.0, self._turned(spring))), conserves(law))
                for spring, law in laws
                if law is not None
            ]
            acting += [pull for pull, stored in pulls if not stored]
            if work:
                working = acting[1:] if steady and tau is not None else acting
                self.power += [(c, program.add(Product(x, self.v(j)))) for c, x in working]
            acting += [pull for pull, stored in pulls if stored]
            constant = self._slipping(j, acting, work)
            for spring in springs.get(j, []):
                if spring.stiffness:
                    acting.append((number(-spring.stiffness), self.q(j)))
                    constant += spring.stiffness * spring.angle
            if acting or constant:
                self.torques[j] = program.sum(*acting, constant=number(constant))

    def _slipping(self, j: int, acting: list[Term], work: bool) -> float:
        """The friction of a joint that slips, added to what acts; what of it is constant."""
        program, number, constant = self.program, self.program.number, 0.0
        for friction, way in ((x, way) for k, x, way in self.mechanism.slips if k == j):
            constant -= way * friction.torque
            if work:
                self.power.append((number(-way * friction.torque), self.v(j)))
            more = friction.static - friction.torque  # never below zero
            if friction.stribeck is not None and more:
                part = program.sum((number(1.0 / friction.stribeck), self.v(j)))
                square = program.sum((-1.0, program.add(Product(part, part))))
                bell = program.add(Function("exp", square))
                acting.append((number(-way * more), bell))
                self._bends(bell, more)
                if work:
                    self.power.append((number(-way * more), program.add(Product(bell, self.v(j)))))
        return constant

    def _bends(self, slot: Slot, arm: float) -> None:
        """A slot whose series may hold only in part of a step, and what makes a torque of it."""
        self.program.named["bends"].append(slot)
        self.program.arms[slot] = arm


def _reach(point: PlanarPoint) -> float:
    """How far a point may be from the origin at most, m: the arm of a force there."""
    return abs(point.constant) + sum(abs(c) for _, c in point.terms)
