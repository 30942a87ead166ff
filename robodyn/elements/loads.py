"""Loads: forces at points and torques on links.

A constant force F that turns with its link is F E. A force f at a point with coefficients c_k gives
F_k -= conj(c_k) f.  Loads that vary have signals in place of numbers.

A force at a varying place of its link acts on the material point there: as at a fixed place of the
link, with the added moment Im(conj(z E) f) of the vector z between the two, in the link's frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar

from robodyn.elements.base import FORCES, MOMENTS, SPENT, Element
from robodyn.elements.builder import Builder, Name, PlanarTerm, PointForce
from robodyn.elements.keys import Way, key
from robodyn.elements.link_rows import Tree
from robodyn.elements.values import Point, Signal

PLACES = tuple(Name("c", "m", f"place of {{}} along {axis} of its link", axis) for axis in "xy")
AXES = tuple(Name("F", "N", f"force of {{}}, {axis}", axis) for axis in "xy")


class Force(Element):
    """A force at a point of a link; one that turns with the link, or varies, has no potential.

    If x or y is a signal it is in `varying`, and zero in `force`.  Likewise coordinates of a
    varying place are in `moving`, and zero in `point`.
    """

    link: ClassVar[Any] = key("link_name", "the link that it acts on", ways=("force",))
    at: ClassVar[Any] = key(
        "varying_place",
        "where, [x, y] in the link's frame; each may be an expression in t, q1..",
        unit="m",
        ways=("force",),
    )
    point: Point = key(
        "moving_point",
        "a point of a link: its name, or {link, at}",
        ways=("point_force",),
    )
    force: complex = key(
        "varying_vector",
        "[Fx, Fy], each a number, an expression or a table",
        unit="N",
        symbol="F: force of {}",
    )
    turns: bool = key(
        "frame",
        "ground: it keeps its direction; link: it turns with the link",
        default=False,
        told="ground",
        name="frame",
    )
    varying: tuple[Signal | None, Signal | None] = (None, None)
    moving: tuple[Signal | None, Signal | None] = (None, None)
    turn: complex = 1.0 + 0j  # from the link's frame to that which a turning force is told in

    points: ClassVar[dict[str, str]] = {"point": "c: point of {}"}
    ways: ClassVar[tuple[Way, ...]] = (
        Way("point_force", "load", "A force at a point.", ("point",)),
        Way("force", "load", "A force at a place of a link."),
    )

    @classmethod
    def from_keys(cls, values: dict[str, Any]) -> Force:
        if "at" in values:
            x, y = values.pop("at")
            at = complex(*(part if isinstance(part, float) else 0.0 for part in (x, y)))
            values["point"] = Point(values.pop("link"), at)
            moves = [None if isinstance(part, float) else part for part in (x, y)]
            values["moving"] = moves[0], moves[1]
        parts = values.pop("force")
        constant = [x if isinstance(x, float) else 0.0 for x in parts]
        x, y = (None if isinstance(part, float) else part for part in parts)
        return cls(**values, force=complex(*constant), varying=(x, y))

    def to_keys(self) -> dict[str, Any]:
        numbers = self.force.real, self.force.imag
        parts = [x if y is None else y for x, y in zip(numbers, self.varying, strict=True)]
        at = self.point.at.real, self.point.at.imag
        places = [x if y is None else y for x, y in zip(at, self.moving, strict=True)]
        place = {"link": self.point.link, "at": places}
        return place | {"force": parts, "turns": self.turns}

    def moved(
        self, point: Callable[[Point], Point], turn: Callable[[int | None], complex]
    ) -> Force | None:
        there, turned = point(self.point), self.turn * turn(self.point.link)
        return None if there.link is None else self._replace(point=there, turn=turned)

    @property
    def varied(self) -> bool:
        """Whether the force is not constant."""
        return self.varying != (None, None)

    @property
    def places(self) -> list[Name]:
        """Names of the coordinates that vary: z1x if c1x names the point that they begin at.

        The point has coordinates on a weld away from its link's joint.
        """
        still = self.point.at.real, self.point.at.imag
        each = zip(PLACES, still, strict=True)
        return [name._replace(letter="z") if beside else name for name, beside in each]

    @property
    def moves(self) -> bool:
        """Whether its place along the link varies."""
        return self.moving != (None, None)

    def varies(self) -> Iterator[tuple[str, Signal]]:
        for name, signals in (("force", self.varying), ("at", self.moving)):
            for k, signal in enumerate(signals):
                if signal is not None:
                    yield f"{name}[{k}]", signal

    def called(self, names: Sequence[str]) -> str:
        return f", in {'its link' if self.turns else 'the ground'}'s frame"

    def placed(self, tree: Tree) -> Iterator[Force]:
        """Yield the force, in the ground's frame if its link cannot turn."""
        k = self.point.link
        if not self.turns or k is None or tree.frames[k] is not None or self.varied:
            yield self
        else:
            yield self._replace(force=tree.turned(k, self.turn * self.force), turns=False)

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
        return not self.turns and not self.varied and not self.moves

    @property
    def steady_force(self) -> tuple[Point, complex] | None:
        return (self.point, self.force) if self.steady else None

    def untimed(self) -> Force | None:
        if any(signal is not None and "t" in signal.names for signal in self.moving):
            return None
        if not self.varied:
            return self
        x, y = (None if x is None or "t" in x.names else x for x in self.varying)
        return self._replace(varying=(x, y))

    def rows(self, b: Builder) -> None:
        tree, link = b.mechanism.tree, self.point.link
        assert link is not None
        point, whole, turned = tree.point(self.point), self.force, 1.0 + 0j
        E = b.direction(link) if self.turns else None  # without it it is among the weights
        if self.turns:
            turned = tree.turned(link, self.turn)
            whole = tree.turned(link, whole if self.turn == 1.0 else self.turn * whole)
        if not self.varied and not self.moves:
            b.force(PointForce(self, whole, E, (point, link)))
            if b.work and E is not None:
                acting = b.planar_sum((b.planar_number(whole), E))
                b.works(1.0, b.inner(acting, b.rate(b.point(point))))
            return
        force: list[PlanarTerm] = []
        numbers = self.force.real, self.force.imag
        units = turned, 1j * turned
        each = zip(units, numbers, self.varying, AXES, strict=True)
        for unit, number, signal, name in each:
            slot = b.number_slot(number) if signal is None else b.signal(signal, name)
            if E is not None:
                slot = b.scaled(slot, E)
            force.append((b.planar_number(unit), slot))
        acting = b.planar_sum(*force)
        b.force(PointForce(self, 1.0, acting, (point, link)))
        if b.work and point.terms:
            b.works(1.0, b.inner(acting, b.rate(b.point(point))))
        if self.moves:
            unit, across = tree.turned(link, self.turn), []
            E = b.direction(link)
            each_place = zip((1j * unit, -unit), self.moving, self.places, strict=True)
            for unit, signal, name in each_place:  # of i z E
                if signal is not None:
                    slot = b.signal(signal, name)
                    slot = slot if E is None else b.scaled(slot, E)
                    across.append((b.planar_number(unit), slot))
            b.moment(link, b.inner(b.planar_sum(*across), acting))


class Moment(Element):
    """A torque on a link; a varying one is zero, and in `varying`."""

    link: int = key("link_name", "the link that it acts on")
    torque: float = key(
        "varying",
        "from the ground, counter-clockwise: a number, an expression or a table",
        unit="N m",
        symbol="T: torque of {}",
        instead="varying",
    )
    varying: Signal | None = None

    ways: ClassVar[tuple[Way, ...]] = (Way("torque", "load", "A torque on a link.", ("torque",)),)

    @classmethod
    def from_keys(cls, values: dict[str, Any]) -> Moment:
        torque = values["torque"]
        if isinstance(torque, float):
            return cls(**values)
        return cls(values["link"], 0.0, torque)

    def to_keys(self) -> dict[str, Any]:
        return {"link": self.link, "torque": self.varying or self.torque}

    def varies(self) -> Iterator[tuple[str, Signal]]:
        if self.varying is not None:
            yield "torque", self.varying

    def moved(
        self, point: Callable[[Point], Point], turn: Callable[[int | None], complex]
    ) -> Moment | None:
        link = point(Point(self.link, 0j)).link
        return None if link is None else self._replace(link=link)

    def called(self, names: Sequence[str]) -> str:
        return f" on {names[self.link]}"

    @property
    def steady_moment(self) -> tuple[int, float] | None:
        return (self.link, self.torque) if self.varying is None else None

    def placed(self, tree: Tree) -> Iterator[Moment]:
        """Yield it if it varies; a constant one is in the mechanism's constant moments."""
        if self.varying is not None:
            yield self

    @property
    def acts(self) -> str:
        return SPENT

    @property
    def rank(self) -> int:
        return MOMENTS

    @property
    def is_load(self) -> bool:
        return True

    def untimed(self) -> Moment | None:
        return None if self.varying is None or "t" in self.varying.names else self

    def rows(self, b: Builder) -> None:
        if self.varying is not None:
            name = Name("T", "N m", "torque of {}", link=self.link)
            b.moment(self.link, b.signal(self.varying, name))
