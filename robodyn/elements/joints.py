"""What rubs and ends at joints, and the rotors of their motors.

A joint's friction is -torque tanh(qd/speed); one that slips one way (way = 1 or -1) loses

    way (torque + (static - torque) exp(-(qd/stribeck)^2)),

the force along its axis where the joint slides.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, ClassVar

from robodyn.elements.base import FRICTION, SLIPPING, SPENT, Element
from robodyn.elements.keys import Way, at_joints, key
from robodyn.elements.springs import JointDamper, JointSpring

if TYPE_CHECKING:
    from robodyn.mechanics.force_rows import Builder
    from robodyn.mechanics.link_tree import Tree

TORQUE, TORQUES, RATES = ("torque", "force"), ("N m", "N"), ("rad/s", "m/s")


class SmoothFriction(Element):
    """Coulomb friction of a joint, smoothed through rest."""

    joint: int
    torque: float = key(
        "amount",
        "far above that speed",
        unit=TORQUES,
        symbol=("tf: friction at the joint of {}", "ff: friction at the joint of {}"),
        linear="f",
        name=TORQUE,
    )
    speed: float = key(
        "positive",
        "what smooths it through rest",
        unit=RATES,
        hint=(
            ": the friction is -torque tanh(qd/speed)",
            ": the friction is -force tanh(qd/speed)",
        ),
        symbol="wf: rate that smooths the friction at the joint of {}",
    )

    ways: ClassVar[tuple[Way, ...]] = at_joints(
        "friction", "friction", ("-torque tanh(qd/speed)", "-force tanh(qd/speed)")
    )

    def placed(self, tree: Tree) -> Iterator[Element]:
        if self.torque:
            yield self

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
    """Coulomb friction with true sticking: it acts in a mode alone, as `Slipping` or by a row.

    A joint at rest holds up to `static`; one that moves is held back as `Slipping` has it.
    """

    joint: int
    torque: float = key(
        "amount",
        "in motion, far above the rate stribeck",
        unit=TORQUES,
        symbol=(
            "tf: friction in motion at the joint of {}",
            "ff: friction in motion at the joint of {}",
        ),
        linear="f",
        name=TORQUE,
    )
    static: float = key(
        "amount",
        (
            "most that it holds at rest, not below torque",
            "most that it holds at rest, not below force",
        ),
        unit=TORQUES,
        symbol=(
            "ts: friction at rest at the joint of {}",
            "fs: friction at rest at the joint of {}",
        ),
        linear="fs",
        only_with="stribeck",
    )
    stribeck: float | None = key(
        "positive",
        "rate over which it falls from static",
        unit=RATES,
        default=None,
        symbol="ws: rate over which friction falls at the joint of {}",
    )

    ways: ClassVar[tuple[Way, ...]] = at_joints(
        "dry_friction",
        "friction",
        (
            "Friction that sticks: torque + (static - torque) exp(-(qd/stribeck)^2) against the "
            "motion; at rest it holds up to static.",
            "Friction that sticks: force + (static - force) exp(-(qd/stribeck)^2) against the "
            "motion; at rest it holds up to static.",
        ),
        ("static",),
    )

    def misfits(self, names: Mapping[str, str]) -> Iterator[tuple[str, str, object]]:
        if self.static < self.torque:
            limit = f"must be at least the {names['torque']} in motion, {self.torque:g}"
            yield "static", limit, f"{self.static:g}"

    def placed(self, tree: Tree) -> Iterator[Element]:
        if self.static:
            yield self

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
    low: float | None = key(
        ("angle", "number"),
        "where the joint ends below",
        unit=("rad", "m"),
        default=None,
        symbol="qmin: where the joint of {} ends below",
        name="min",
    )
    high: float | None = key(
        ("angle", "number"),
        "where it ends above; one of the two may be missing",
        unit=("rad", "m"),
        default=None,
        symbol="qmax: where the joint of {} ends above",
        name="max",
    )
    stiffness: float | None = key(
        "positive",
        "of the stop, which pushes and never pulls",
        unit=("N m/rad", "N/m"),
        default=None,
        symbol="ke: stiffness of the stops of {}",
        ways=("stops",),
    )
    damping: float = key(
        "amount",
        "of the stop, while it pushes",
        unit=("N m s/rad", "N s/m"),
        default=0.0,
        symbol="de: damping of the stops of {}",
        ways=("stops",),
    )
    restitution: float | None = key(
        "part",
        "speed after an impact over that before, from 0 to 1",
        default=None,
        ways=("hard_stops",),
    )

    ways: ClassVar[tuple[Way, ...]] = (
        *at_joints("stops", "limits", "Compliant stops of a joint.", ("stiffness",)),
        *at_joints(
            "hard_stops", "limits", "Hard stops of a joint, which throw it back.", ("restitution",)
        ),
        *at_joints("limits", "limits", "Limits of a joint, which end a simulation."),
    )

    def misfits(self, names: Mapping[str, str]) -> Iterator[tuple[str, str, object]]:
        if self.low is None and self.high is None:
            yield "", "needs a min, a max, or both", None
        elif self.low is not None and self.high is not None and not self.low < self.high:
            limit = f"must be above min, {self.low:g}"
            if self.low == self.high:
                limit += "; a joint that cannot move is `joint: fixed`"
            yield "high", limit, f"{self.high:g}"

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
