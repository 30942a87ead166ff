"""Springs, between points and at joints, and dampers.

A spring between points d = const + sum_k c_k X_k from end to end pulls its first end by

    f = (k L s^-1/2 - k - D (d.d')/s) d,        s = d.d,

and its second by -f; one at a joint gives -k (q - angle), a damper there -D qd.  A spring with a
law F pulls by F(x, v) in the place of k x, with its extension x = sqrt(s) - L or q - angle, v = x'.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from robodyn.elements.base import (
    LINEAR,
    SPENT,
    SPENT_LAW,
    SPRINGS,
    STORED,
    STORED_LAW,
    Element,
    NoDirection,
    PlanarPoint,
    PointForce,
    conserves,
)
from robodyn.scene.scene import Signal

if TYPE_CHECKING:
    from robodyn.mechanics.force_rows import Builder, Slot, Term


class PointSpring(Element):
    """A spring between points of two links (None: the ground): `between`, first less second."""

    first: int | None
    second: int | None
    ends: tuple[PlanarPoint, PlanarPoint]
    between: PlanarPoint
    stiffness: float  # N/m
    length: float  # free length, m
    damping: float  # N s/m
    law: Signal | None = None  # its pull, N, in place of the stiffness

    @property
    def word(self) -> str:
        return "spring"

    @property
    def parted(self) -> PlanarPoint | None:
        directed = (self.stiffness and self.length) or self.damping or self.law
        return self.between if directed else None

    @property
    def acts(self) -> str:
        return STORED if conserves(self.law) else SPENT

    @property
    def rank(self) -> int:
        return SPRINGS

    @property
    def signals(self) -> tuple[Signal, ...]:
        return () if self.law is None else (self.law,)

    @property
    def changes_energy(self) -> bool:
        return bool(self.damping) or not conserves(self.law)

    def stored(self) -> PointSpring | None:
        return self._replace(damping=0.0) if conserves(self.law) else None

    def spent(self) -> PointSpring:
        return self._replace(stiffness=0.0, law=None) if conserves(self.law) else self

    def energy(self, b: Builder) -> Iterator[Term]:
        d = b.point(self.between)
        square = b.inner(d, d)
        if self.law is not None and conserves(self.law):
            yield 1.0, b.stored(self.law, self._longer(b, square))
        if self.stiffness:
            if self.length:
                longer = self._longer(b, square)
                square = b.product(longer, longer)
            yield b.number(0.5 * self.stiffness), square

    def _longer(self, b: Builder, square: Slot) -> Slot:
        """Its length, by the square of that, less the free one."""
        return b.sum((1.0, b.power_of(square, 0.5)), constant=b.number(-self.length))

    def rows(self, b: Builder) -> None:
        place, number = self.between, b.number
        directed = self.parted is not None
        if directed and not (place.terms or place.constant):
            raise NoDirection(b.mechanism.name_of(self))
        d = b.point(place)
        pull: list[Term] = []
        if self.law is not None:
            square = b.inner(d, d)
            longer = self._longer(b, square)
            tension = b.signal(self.law, place.reach, longer)
            pull.append((-1.0, b.quotient(tension, b.power_of(square, 0.5))))
            if b.work and place.terms and not conserves(self.law):
                b.works(-1.0, b.product(tension, b.rate(longer)))
        s = b.inner(d, d) if directed else None
        if s is not None and self.length and self.stiffness:
            pull.append((number(self.stiffness * self.length), b.power_of(s, -0.5)))
        if s is not None and self.damping:
            half = b.sum((0.5, b.rate(s)))  # d.d'
            ratio = b.quotient(half, s)
            pull.append((number(-self.damping), ratio))
            if b.work and place.terms:
                b.works(number(-self.damping), b.product(half, ratio))
        unit, force = -self.stiffness, d
        if pull:
            factor = b.sum(*pull, constant=number(-self.stiffness))
            unit, force = 1.0, b.scaled(factor, d)
        first, second = zip(self.ends, (self.first, self.second), strict=True)
        b.force(PointForce(self, unit, force, first, second, s), place)
        if pull and place.terms:
            b.bends_planar(force, place.reach)  # its parts stay finite where d passes 0


class JointSpring(Element):
    """A spring at a joint: N m/rad and its free angle, or N/m and its free displacement."""

    joint: int
    stiffness: float
    angle: float
    law: Signal | None = None  # what it gives, N m or N, in place of the stiffness

    @property
    def acts(self) -> str:
        return STORED if conserves(self.law) else SPENT

    @property
    def rank(self) -> int:
        if self.law is None:
            return LINEAR
        return STORED_LAW if conserves(self.law) else SPENT_LAW

    @property
    def at(self) -> int:
        return self.joint

    @property
    def free(self) -> float:
        return self.angle

    @property
    def signals(self) -> tuple[Signal, ...]:
        return () if self.law is None else (self.law,)

    def _turned(self, b: Builder) -> Slot:
        """How far its joint is from where it is free."""
        return b.sum((1.0, b.q(self.joint)), constant=b.number(-self.angle))

    def energy(self, b: Builder) -> Iterator[Term]:
        if self.law is not None and conserves(self.law):
            yield 1.0, b.stored(self.law, self._turned(b))
        if self.stiffness:
            way = self._turned(b)
            yield b.number(0.5 * self.stiffness), b.product(way, way)

    def rows(self, b: Builder) -> None:
        if self.law is not None:
            spends = not conserves(self.law)
            b.torque(self.joint, -1.0, b.signal(self.law, 1.0, self._turned(b)), spends)
        elif self.stiffness:
            b.torque(self.joint, b.number(-self.stiffness), b.q(self.joint), spends=False)
            b.constant_torque(self.joint, self.stiffness * self.angle)


class JointDamper(Element):
    """A damper at a joint, N m s/rad, or N s/m; the sum of those at a joint is its entry of D."""

    joint: int
    damping: float

    @property
    def at(self) -> int:
        return self.joint

    @property
    def changes_energy(self) -> bool:
        return bool(self.damping)
