"""What rubs and ends at joints, and the rotors of their motors.

A joint's friction is -torque tanh(qd/speed); one that slips one way (way = 1 or -1) loses

    way (torque + (static - torque) exp(-(qd/stribeck)^2)),

the force along its axis where the joint slides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from robodyn.elements.base import FRICTION, SLIPPING, SPENT, Element
from robodyn.elements.springs import JointDamper, JointSpring

if TYPE_CHECKING:
    from robodyn.mechanics.force_rows import Builder


class SmoothFriction(Element):
    """Coulomb friction of a joint, N m, and rad/s that smooth it; N and m/s where it slides."""

    joint: int
    torque: float
    speed: float

    @property
    def acts(self) -> str:
        return SPENT

    @property
    def rank(self) -> int:
        return FRICTION

    @property
    def at(self) -> int:
        return self.joint

    def rows(self, b: Builder) -> None:
        slow = b.sum((b.number(1.0 / self.speed), b.v(self.joint)))
        smooth = b.function("tanh", slow)
        b.torque(self.joint, b.number(-self.torque), smooth)
        b.bends(smooth, self.torque)


class DryFriction(Element):
    """Coulomb friction with true sticking: it acts in a mode alone, as `Slipping` or by a row."""

    joint: int
    torque: float  # N m, or N
    static: float
    stribeck: float | None = None  # rad/s, or m/s

    def slipping(self, way: int) -> Slipping:
        """What it is where its joint slips this way, 1 or -1."""
        return Slipping(self.joint, self.torque, self.static, self.stribeck, way)


class Slipping(Element):
    """Dry friction of a joint that slips one way, 1 or -1."""

    joint: int
    torque: float
    static: float
    stribeck: float | None
    way: int

    @property
    def acts(self) -> str:
        return SPENT

    @property
    def rank(self) -> int:
        return SLIPPING

    @property
    def at(self) -> int:
        return self.joint

    def rows(self, b: Builder) -> None:
        j, way, number = self.joint, self.way, b.number
        b.constant_torque(j, -way * self.torque)
        if b.work:
            b.works(number(-way * self.torque), b.v(j))
        more = self.static - self.torque  # never below zero
        if self.stribeck is not None and more:
            part = b.sum((number(1.0 / self.stribeck), b.v(j)))
            bell = b.function("exp", b.sum((-1.0, b.product(part, part))))
            b.torque(j, number(-way * more), bell)
            b.bends(bell, more)


class Stops(Element):
    """Where a joint ends, rad or m: at compliant stops, at hard ones, or at no more than a limit.

    They act in a mode alone: a compliant one that is pressed is a spring and a damper.
    """

    joint: int
    low: float | None
    high: float | None
    stiffness: float | None = None  # N m/rad, or N/m
    damping: float = 0.0  # N m s/rad, or N s/m
    restitution: float | None = None

    @property
    def ends(self) -> list[tuple[int, float]]:
        """The sides, -1 and 1, that have an end, and where."""
        sides = ((-1, self.low), (1, self.high))
        return [(side, end) for side, end in sides if end is not None]

    def pressed(self, side: int) -> tuple[JointSpring, JointDamper]:
        """What a compliant stop is where its joint presses it."""
        assert self.stiffness is not None
        spring = JointSpring(self.joint, self.stiffness, dict(self.ends)[side])
        return spring, JointDamper(self.joint, self.damping)


class Rotor(Element):
    """The rotor of the motor at a joint; it sits on the link that carries the joint.

    It spins with w_carrier + ratio qd, w_carrier the rate of what turns that link, if anything
    does.  So KE has inertia/2 (w_carrier + ratio qd)^2 more, and M the constant inertia r r^T.
    """

    joint: int
    inertia: float  # kg m^2
    ratio: float  # rad/m where the joint slides
    carrier: int | None  # the link whose E the carrying link has; None: the ground
    slides: bool  # whether the joint does

    @property
    def spin(self) -> tuple[tuple[int, float], ...]:
        """r in x: its rate is the sum of coefficients times x'."""
        own = self.joint, self.ratio
        if self.carrier is None:
            return (own,)
        return own, (self.carrier, 1.0 if self.slides else 1.0 - self.ratio)
