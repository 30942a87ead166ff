"""Friction and stops at joints, and the rotors of their motors.

A joint's smooth friction is -torque tanh(qd/speed).  A joint that slips in one direction (way = 1
or -1) loses

    way (torque + (static - torque) exp(-(qd/stribeck)^2)),

or exp(-|qd|/stribeck) in place of that bell; a force along its axis if the joint slides.  If
friction differs by direction, its amount is a pair, for positive and for negative rates.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from robodyn.elements.base import FRICTION, SLIPPING, SPENT, Element
from robodyn.elements.builder import Builder, Term
from robodyn.elements.contacts import COMPLIANT, HARD, STICKS, End, Guard, Mode
from robodyn.elements.keys import BY_DIRECTION, Way, at_joints, key
from robodyn.elements.link_rows import Tree
from robodyn.elements.springs import JointDamper, JointSpring
from robodyn.tables.records import Record

if TYPE_CHECKING:
    from robodyn.tables.arrays import Array

TORQUE, TORQUES, RATES = ("torque", "force"), ("N m", "N"), ("rad/s", "m/s")
GAUSSIAN, EXPONENTIAL = CURVES = ("gaussian", "exponential")
ROUNDED = 36.0  # exp(-ROUNDED) is nothing beside 1
ByWay = float | tuple[float, float]  # one amount, or that of positive and that of negative rates


def of_way(amount: ByWay, way: int) -> float:
    """Return the amount for the direction 1 or -1."""
    return amount[way < 0] if isinstance(amount, tuple) else amount


def acts_at_all(amount: ByWay) -> bool:
    """Return whether the amount is nonzero in any direction."""
    return bool(of_way(amount, 1)) or bool(of_way(amount, -1))


class SmoothFriction(Element):
    """Coulomb friction of a joint, smoothed around zero rate."""

    joint: int
    torque: ByWay = key(
        BY_DIRECTION,
        "far above that speed; or two",
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
        if acts_at_all(self.torque):
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

    @property
    def bend_rate(self) -> float:
        return self.speed

    def rows(self, b: Builder) -> None:
        slow = b.sum((b.number(1.0 / self.speed), b.v(self.joint)))
        smooth = b.function("tanh", slow)
        if not isinstance(self.torque, tuple):
            b.torque(self.joint, b.number(-self.torque), smooth)
            return
        square = b.product(smooth, smooth)
        for torque, half in zip(self.torque, (0.5, -0.5), strict=True):
            part = b.sum((0.5, smooth), (half, square))  # tanh (1 + tanh)/2, and (1 - tanh)/2
            b.torque(self.joint, b.number(-torque), part)


class DryFriction(Element):
    """Coulomb friction with sticking; it acts in modes, as `Slipping` or by a held row.

    A joint at rest is held up to `static`; a moving one is braked by `Slipping`.
    """

    joint: int
    torque: ByWay = key(
        BY_DIRECTION,
        "in motion, far above the rate stribeck; or two",
        unit=TORQUES,
        symbol=(
            "tf: friction in motion at the joint of {}",
            "ff: friction in motion at the joint of {}",
        ),
        linear="f",
        name=TORQUE,
    )
    static: ByWay = key(
        BY_DIRECTION,
        (
            "most that it holds at rest, not below torque; or two",
            "most that it holds at rest, not below force; or two",
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
    curve: str = key(
        "curve",
        "how it falls: gaussian or exponential",
        default=GAUSSIAN,
        told=GAUSSIAN,
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
        for way, told in ((1, "positive"), (-1, "negative")):
            static, torque = of_way(self.static, way), of_way(self.torque, way)
            if static < torque:
                limit = f"must be at least the {names['torque']} in motion, {torque:g}"
                one = not (isinstance(self.static, tuple) or isinstance(self.torque, tuple))
                yield "static", limit if one else f"{limit}, at {told} rates", f"{static:g}"
                return
        if self.curve != GAUSSIAN and self.stribeck is None:
            yield "curve", "needs the rate stribeck over which friction falls", self.curve

    def placed(self, tree: Tree) -> Iterator[Element]:
        if acts_at_all(self.static):
            yield self

    @property
    def at(self) -> int:
        return self.joint

    @property
    def contact(self) -> str:
        return STICKS

    @property
    def bend_rate(self) -> float | None:
        return self.stribeck

    def in_mode(self, mode: Mode) -> Iterator[Slipping]:
        for joint, way in mode.slips:
            if joint == self.joint:
                torque, static = of_way(self.torque, way), of_way(self.static, way)
                yield Slipping(joint, torque, static, self.stribeck, way, self.curve)

    def gradual(self, rate: float) -> DryFriction:
        return self._replace(stribeck=self.stribeck or rate)

    def guards(self, mode: Mode, touches: Collection[End]) -> Iterator[Guard]:
        for joint, way in mode.slips:
            if joint == self.joint:
                yield Guard("slips", joint, way, partial(self._onward, way), self._rates)

    def _onward(self, way: int, q: Array, qd: Array) -> Array:
        """Return the rate of its joint in this direction."""
        return way * qd[:, self.joint]

    def _rates(self, q: Array, qd: Array) -> Array:
        total: Array = abs(qd).sum(axis=1)
        return total


class Slipping(Element):
    """Dry friction of a joint that slips in one direction, 1 or -1."""

    joint: int
    torque: float
    static: float
    stribeck: float | None
    way: int
    curve: str

    @property
    def acts(self) -> str:
        return SPENT

    @property
    def rank(self) -> int:
        return SLIPPING

    @property
    def at(self) -> int:
        return self.joint

    @property
    def bend_rate(self) -> float | None:
        return self.stribeck

    @property
    def bell(self) -> tuple[float, float] | None:
        if self.stribeck is None:
            return None
        reach = ROUNDED if self.curve == EXPONENTIAL else math.sqrt(ROUNDED)
        return self.stribeck, reach * self.stribeck

    def rows(self, b: Builder) -> None:
        j, way, number = self.joint, self.way, b.number
        b.constant_torque(j, -way * self.torque)
        if b.work:
            b.works(number(-way * self.torque), b.v(j))
        more = self.static - self.torque  # never below zero
        if self.stribeck is not None and more:
            part = b.sum((number(1.0 / self.stribeck), b.v(j)))
            if self.curve == EXPONENTIAL:
                bell = b.function("exp", b.sum((-1.0 * way, part)))  # way qd is |qd|
            else:
                bell = b.function("exp", b.sum((-1.0, b.product(part, part))))
            b.torque(j, number(-way * more), bell)


class Range(Record):
    """The range of a joint, rad or m; None for no end."""

    joint: int
    low: float | None
    high: float | None
    firm: bool = True  # whether nothing passes its ends: there is no compliant stop

    @property
    def ends(self) -> list[tuple[int, float]]:
        """The sides, -1 and 1, that have an end, with its position."""
        sides = ((-1, self.low), (1, self.high))
        return [(side, end) for side, end in sides if end is not None]

    def guards(self, touches: Collection[End]) -> Iterator[Guard]:
        """Yield a guard for each firm end on which the joint does not rest."""
        for side, end in self.ends if self.firm else ():
            if (self.joint, side) not in touches:
                inside, reach = partial(self._inside, side, end), partial(self._reach, end)
                yield Guard("inside", self.joint, side, inside, reach)

    def _inside(self, side: int, end: float, q: Array, qd: Array) -> Array:
        return -side * (q[:, self.joint] - end)

    def _reach(self, end: float, q: Array, qd: Array) -> Array:
        return abs(q[:, self.joint]) + abs(end)


class Stops(Element):
    """The ends of a joint: compliant stops, hard stops, or limits only.

    In a mechanism it becomes a `Range` with a stop at each end.
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

    def placed(self, tree: Tree) -> Iterator[Element]:
        for side, end in Range(self.joint, self.low, self.high).ends:
            if self.stiffness is not None:
                yield CompliantStop(self.joint, side, end, self.stiffness, self.damping)
            elif self.restitution is not None:
                yield HardStop(self.joint, side, end, self.restitution)


class HardStop(Element):
    """A stop that throws a joint back at an end; it acts in impacts, and as a held row."""

    joint: int
    side: int  # -1: at the low end, 1: at the high one
    end: float  # rad, or m
    restitution: float

    @property
    def at(self) -> int:
        return self.joint

    @property
    def contact(self) -> str:
        return HARD

    def in_mode(self, mode: Mode) -> Iterator[Element]:
        yield from ()


class CompliantStop(Element):
    """A spring and a damper beyond an end of a joint's range; they push and never pull."""

    joint: int
    side: int  # -1: at the low end, 1: at the high one
    end: float  # rad, or m
    stiffness: float  # N m/rad, or N/m
    damping: float  # N m s/rad, or N s/m

    @property
    def at(self) -> int:
        return self.joint

    @property
    def contact(self) -> str:
        return COMPLIANT

    def in_mode(self, mode: Mode) -> Iterator[Element]:
        if (self.joint, self.side) in mode.pressed:
            yield JointSpring(self.joint, self.stiffness, self.end)
            yield JointDamper(self.joint, self.damping)

    def push(self, q: Any, qd: Any) -> Any:
        """Return its force over its stiffness (rad or m), away from its side.

        q and qd are those of its joint.  It does not act if the value is negative, where it would
        pull.
        """
        return self.side * (q - self.end + self.damping / self.stiffness * qd)

    def pushes(self, q: float, qd: float) -> bool:
        """Return whether its joint is beyond it, and not leaving faster than it follows."""
        return self.side * (q - self.end) > 0.0 and self.push(q, qd) > 0.0

    def guards(self, mode: Mode, touches: Collection[End]) -> Iterator[Guard]:
        if (self.joint, self.side) in touches:
            return
        if (self.joint, self.side) in mode.pressed:
            yield Guard("presses", self.joint, self.side, self._presses, self._reach)
        else:
            yield Guard("apart", self.joint, self.side, self._apart, self._reach)

    def _presses(self, q: Array, qd: Array) -> Array:
        push: Array = self.push(q[:, self.joint], qd[:, self.joint])
        return push

    def _apart(self, q: Array, qd: Array) -> Array:
        """Return a guard value that is positive while the joint is not pressed."""
        import numpy as np  # of a run, which has it

        inside = -self.side * (q[:, self.joint] - self.end)
        return np.asarray(np.maximum(-self._presses(q, qd), inside))

    def _reach(self, q: Array, qd: Array) -> Array:
        reach = abs(q[:, self.joint]) + abs(self.end)
        return reach + self.damping / self.stiffness * abs(qd[:, self.joint])


class Rotor(Element):
    """The rotor of the motor at a joint; it sits on the link that carries the joint.

    It spins with w_carrier + ratio qd, w_carrier the rate of the carrying link if it can turn.  So
    KE has another inertia/2 (w_carrier + ratio qd)^2, and M the constant inertia r r^T.
    """

    joint: int
    inertia: float  # kg m^2
    ratio: float  # rad/m where the joint slides
    carrier: int | None  # the link whose E the carrying link has; None: the ground
    slides: bool  # whether the joint does

    @property
    def spin(self) -> tuple[tuple[int, float], ...]:
        """r in coordinates x: its rate is the sum of coefficients times x'."""
        own = self.joint, self.ratio
        if self.carrier is None:
            return (own,)
        return own, (self.carrier, 1.0 if self.slides else 1.0 - self.ratio)

    @property
    def at(self) -> int:
        return self.joint

    def rows(self, b: Builder) -> None:
        b.rotor(self.joint, self.inertia, self.ratio, self.carrier)

    def kinetic(self, b: Builder) -> Iterator[Term]:
        half, spin = b.number(0.5 * self.inertia), b.spin(self.joint, self.ratio, self.carrier)
        yield half, b.product(spin, spin)
