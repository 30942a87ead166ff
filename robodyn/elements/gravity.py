"""Gravity that varies in time: forces on all masses, without a potential.

A link of mass m and first moment s about its own origin, in its frame, feels m g there and the
moment Im(conj(s E) g).
"""

from __future__ import annotations

from collections.abc import Iterator

from robodyn.elements.base import FORCES, SPENT, Element
from robodyn.elements.builder import Builder, Name, PlanarTerm, PointForce
from robodyn.elements.values import Point, Signal

AXES = tuple(Name("g", "m/s²", f"gravity along {axis.upper()}", axis) for axis in "xy")
UNITS = ((1.0, 0.0), (0.0, 1.0))


class GravityField(Element):
    """The varying components of gravity; None for a constant one, which is in the weights.

    `masses` (n), kg, and `first` (n), kg m, are those of the links, payloads included.
    """

    varying: tuple[Signal | None, Signal | None]
    masses: tuple[float, ...] = ()
    first: tuple[complex, ...] = ()

    def varies(self) -> Iterator[tuple[str, Signal]]:
        for k, signal in enumerate(self.varying):
            if signal is not None:
                yield f"[{k}]", signal

    @property
    def acts(self) -> str:
        return SPENT

    @property
    def rank(self) -> int:
        return FORCES

    @property
    def is_load(self) -> bool:
        return True

    def untimed(self) -> None:
        return None

    def rows(self, b: Builder) -> None:
        tree = b.mechanism.tree
        origins = [tree.point(Point(k, 0j)) for k in range(len(self.masses))]
        arms = [tree.turned(k, s) for k, s in enumerate(self.first)]
        parts: list[PlanarTerm] = []
        field = {}
        for axis, (unit, signal, name) in enumerate(zip(UNITS, self.varying, AXES, strict=True)):
            if signal is not None:
                field[axis] = b.signal(signal, name)
                parts.append((unit, field[axis]))
        g = b.planar_sum(*parts)
        for k, (m, origin, arm) in enumerate(zip(self.masses, origins, arms, strict=True)):
            if m:
                b.force(PointForce(self, m, g, (origin, k)))
                if b.work and origin.terms:
                    b.works(b.number(m), b.inner(g, b.rate(b.point(origin))))
            if not (arm.real or arm.imag):
                continue
            E = b.direction(k)
            if E is None:
                across = {0: b.number(-arm.imag), 1: b.number(arm.real)}
                b.moment(k, b.sum(*((across[axis], slot) for axis, slot in field.items())))
            else:
                b.moment(k, b.inner(b.planar_sum((b.planar_number(1j * arm), E)), g))
