"""Loads: forces at points and torques on links.

A constant force F turns with its link as F E.  A force f at a point that has the coefficients c_k
gives F_k -= conj(c_k) f.  Loads that vary are signals in place of numbers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from robodyn.elements.base import FORCES, MOMENTS, SPENT, Element, PlanarPoint, PointForce
from robodyn.scene.scene import Law, Signal, Table

if TYPE_CHECKING:
    from robodyn.mechanics.force_rows import Builder, PlanarTerm


class Force(Element):
    """A force at a point of a link, N; one that turns with the link, or varies, has no potential.

    Where it varies it is `turned` times the signals `parts` of its x and y (a number: that for
    ever).
    """

    link: int
    point: PlanarPoint
    force: complex
    turns: bool
    parts: tuple[Signal | float, Signal | float] | None = None
    turned: complex = 1.0

    @property
    def acts(self) -> str:
        return SPENT

    @property
    def rank(self) -> int:
        return FORCES

    @property
    def is_load(self) -> bool:
        return True

    @property
    def steady(self) -> bool:
        return not self.turns and self.parts is None

    @property
    def signals(self) -> tuple[Signal, ...]:
        return tuple(x for x in self.parts or () if isinstance(x, (Law, Table)))

    def untimed(self) -> Force:
        if self.parts is None:
            return self
        x, y = (0.0 if isinstance(x, Signal) and "t" in x.names else x for x in self.parts)
        return self._replace(parts=(x, y))

    def rows(self, b: Builder) -> None:
        E = b.direction(self.link) if self.turns else None  # without it it is among the weights
        if self.parts is None:
            b.force(PointForce(self, self.force, E, (self.point, self.link)))
            if b.work and E is not None:
                turned = b.planar_sum((b.planar_number(self.force), E))
                b.works(1.0, b.inner(turned, b.rate(b.point(self.point))))
            return
        force: list[PlanarTerm] = []
        for unit, signal in zip((self.turned, 1j * self.turned), self.parts, strict=True):
            if isinstance(signal, (Law, Table)):
                slot = b.signal(signal, self.point.reach)
            else:
                slot = b.number_slot(signal)
            if E is not None:
                slot = b.scaled(slot, E)
            force.append((b.planar_number(unit), slot))
        acting = b.planar_sum(*force)
        b.force(PointForce(self, 1.0, acting, (self.point, self.link)))
        if b.work and self.point.terms:
            b.works(1.0, b.inner(acting, b.rate(b.point(self.point))))


class VaryingMoment(Element):
    """A torque on a link, N m, that varies."""

    link: int
    signal: Signal

    @property
    def acts(self) -> str:
        return SPENT

    @property
    def rank(self) -> int:
        return MOMENTS

    @property
    def is_load(self) -> bool:
        return True

    @property
    def signals(self) -> tuple[Signal, ...]:
        return (self.signal,)

    def untimed(self) -> VaryingMoment | None:
        return None if "t" in self.signal.names else self

    def rows(self, b: Builder) -> None:
        b.moment(self.link, b.signal(self.signal, 1.0))
