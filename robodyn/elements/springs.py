"""Springs and dampers, between points and at joints.

A spring between points, d = const + sum_k c_k X_k from end to end, pulls its first end by

    f = (k L s^-1/2 - k - D (d.d')/s) d,        s = d.d,

and its second by -f.  One at a joint gives -k (q - angle), a damper there -D qd.  A spring with a
law F has F(x, v) in place of k x, with its extension x = sqrt(s) - L or q - angle, v = x'.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

from robodyn.elements.base import (
    LINEAR,
    SPENT,
    SPENT_LAW,
    SPRINGS,
    STORED,
    STORED_LAW,
    Element,
    conserves,
)
from robodyn.elements.builder import Builder, Name, NoDirection, PointForce, Slot, Term
from robodyn.elements.keys import ONE, Way, key
from robodyn.elements.link_rows import PlanarPoint, Tree
from robodyn.elements.values import Law, Point, Signal, Table

TABLE = "a CSV file of its pull: columns x and F, linear between rows"
SPAN = Name("S", "m", "{} from its second end to its first")
LENGTH = Name("S", "m", "length of {}")
PULL = Name("H", "N", "pull of {}")
PER_LENGTH = Name("K", "N/m", "pull of {} per length")
DAMPER = Name("P", "N/m", "pull of the damper of {} per length")
DAMPED = "stands beside law; damping is in the law, by its v"


def _one_law(values: dict[str, Any]) -> dict[str, Any]:
    """Return values by field from keys that exclude one another."""
    table = values.pop("table", None)
    return values | {"law": values["law"] or table}


def _as_written(values: dict[str, Any], law: Signal | None) -> dict[str, Any]:
    """Return values by key; only one key describes the spring."""
    if law is None:
        return values | {"law": None}
    given = {"law": None, "table": law} if isinstance(law, Table) else {"law": law}
    return {x: y for x, y in values.items() if x != "stiffness"} | given


def _law_of(spring: Any) -> Iterator[tuple[str, Signal]]:
    if spring.law is not None:
        yield ("table" if isinstance(spring.law, Table) else "law"), spring.law


class PointSpring(Element):
    """A spring and damper between points of two links, or of a link and the ground."""

    between: ClassVar[Any] = key(
        "pair",
        "its ends, [POINT, POINT], not both of one link or the ground",
    )
    first: Point
    second: Point
    stiffness: float = key(
        "amount",
        "0 for a damper alone",
        unit="N/m",
        absent=0.0,
        told=ONE,
        symbol="k: stiffness of {}",
        linear="k",
        instead="law",
    )
    length: float = key("amount", "free length", unit="m", symbol="S0: free length of {}")
    damping: float = key(
        "amount",
        "of a damper beside it",
        unit="N s/m",
        default=0.0,
        symbol="ds: damping of {}",
        linear="ds",
    )
    law: Signal | None = key(
        "law",
        "its pull in x, its length less the free one (m), and its rate v",
        unit="N",
        default=None,
        told=ONE,
    )

    table: ClassVar[Any] = key("spring_table", TABLE, unit="N", default=None, told=ONE)
    points: ClassVar[dict[str, str]] = {"first": "e: end of {}", "second": "h: end of {}"}
    ways: ClassVar[tuple[Way, ...]] = (
        Way("point_spring", "spring", "A spring and damper between two points."),
    )

    @classmethod
    def from_keys(cls, values: dict[str, Any]) -> PointSpring:
        first, second = values.pop("between")
        return cls(**_one_law(values), first=first, second=second)

    def to_keys(self) -> dict[str, Any]:
        values = {"between": (self.first, self.second)} | super().to_keys()
        return _as_written(values, self.law)

    def misfits(self, names: Mapping[str, str]) -> Iterator[tuple[str, str, object]]:
        if isinstance(self.law, Law) and self.damping:
            yield "damping", DAMPED, self.damping

    def moved(
        self, point: Callable[[Point], Point], turn: Callable[[int | None], complex]
    ) -> PointSpring:
        return self._replace(first=point(self.first), second=point(self.second))

    def varies(self) -> Iterator[tuple[str, Signal]]:
        yield from _law_of(self)

    @property
    def word(self) -> str:
        return "spring"

    def parted(self, tree: Tree) -> PlanarPoint | None:
        directed = (self.stiffness and self.length) or self.damping or self.law
        return self.reach(tree) if directed else None

    @property
    def acts(self) -> str:
        return STORED if conserves(self.law) else SPENT

    @property
    def rank(self) -> int:
        return SPRINGS

    @property
    def changes_energy(self) -> bool:
        return bool(self.damping) or not conserves(self.law)

    def stored(self) -> PointSpring | None:
        holds = conserves(self.law) and (self.stiffness or self.law)
        return self._replace(damping=0.0) if holds else None

    def spent(self) -> PointSpring:
        return self._replace(stiffness=0.0, law=None) if conserves(self.law) else self

    def energy(self, b: Builder) -> Iterator[Term]:
        d = b.point(self.reach(b.mechanism.tree))
        square = b.inner(d, d)
        if self.law is not None and conserves(self.law):
            yield 1.0, b.stored(self.law, self._longer(b, square))
        if self.stiffness:
            if self.length:
                longer = self._longer(b, square)
                square = b.product(longer, longer)
            yield b.number(0.5 * self.stiffness), square

    def reach(self, tree: Tree) -> PlanarPoint:
        """Return its first end less its second."""
        return tree.difference(self.first, self.second)

    def _longer(self, b: Builder, square: Slot) -> Slot:
        """Return its extension from the square of its length."""
        return b.sum((1.0, b.power_of(square, 0.5)), constant=b.number(-self.length))

    def rows(self, b: Builder) -> None:
        tree, number = b.mechanism.tree, b.number
        place, directed = self.reach(tree), self.parted(tree) is not None
        if directed and not (place.terms or place.constant):
            raise NoDirection(b.mechanism.name_of(self))
        d = b.span(SPAN, place, directed)
        if directed:
            b.root(LENGTH, b.inner(d, d))
        pull: list[Term] = []
        if self.law is not None:
            square = b.inner(d, d)
            longer = self._longer(b, square)
            tension = b.signal(self.law, PULL, longer)
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
            damper = not (self.stiffness or self.law)
            factor = b.named(DAMPER if damper else PER_LENGTH, factor, sign=-1.0)
            unit, force = 1.0, b.scaled(factor, d)
        first, second = ((tree.point(end), end.link) for end in (self.first, self.second))
        b.force(PointForce(self, unit, force, first, second, s), place)


class JointSpring(Element):
    """A spring and damper at a joint; in a mechanism its damper is a separate element."""

    joint: int = key(
        "joint_name",
        (
            "the link whose own joint it is; its angle counts from turn to turn",
            "the link whose own joint it is",
        ),
    )
    stiffness: float = key(
        "amount",
        "0 for a damper alone",
        unit=("N m/rad", "N/m"),
        absent=0.0,
        told=ONE,
        symbol="k: stiffness of {}",
        linear="k",
        instead="law",
    )
    angle: float = key(
        ("angle", "number"),
        ("free angle of the joint", "free displacement of the joint"),
        unit=("rad", "m"),
        symbol=("phi: free angle of {}", "phi: free displacement of {}"),
        name=("angle", "length"),
    )
    damping: float = key(
        "amount",
        "of a damper beside it",
        unit=("N m s/rad", "N s/m"),
        default=0.0,
        symbol="ds: damping of {}",
    )
    law: Signal | None = key(
        "law",
        (
            "its pull in x, q less its free angle (rad), and its rate v",
            "its pull in x, q less its free displacement (m), and its rate v",
        ),
        unit=("N m", "N"),
        default=None,
        told=ONE,
    )
    table: ClassVar[Any] = key("spring_table", TABLE, unit=("N m", "N"), default=None, told=ONE)

    ways: ClassVar[tuple[Way, ...]] = (
        Way("joint_spring", "spring", "A spring and damper at a revolute joint.", ("joint",)),
        Way(
            "slide_spring",
            "spring",
            "A spring and damper at a prismatic joint.",
            ("joint", "length"),
            True,
        ),
    )

    @classmethod
    def from_keys(cls, values: dict[str, Any]) -> JointSpring:
        return cls(**_one_law(values))

    def to_keys(self) -> dict[str, Any]:
        return _as_written(super().to_keys(), self.law)

    def misfits(self, names: Mapping[str, str]) -> Iterator[tuple[str, str, object]]:
        if isinstance(self.law, Law) and self.damping:
            yield "damping", DAMPED, self.damping

    def varies(self) -> Iterator[tuple[str, Signal]]:
        yield from _law_of(self)

    def called(self, names: Sequence[str]) -> str:
        return f", at the joint of {names[self.joint]}"

    def placed(self, tree: Tree) -> Iterator[Element]:
        if self.stiffness or self.law:
            yield self._replace(damping=0.0)

    def also(self) -> Iterator[JointDamper]:
        if self.damping:
            yield JointDamper(self.joint, self.damping)

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

    def _turned(self, b: Builder) -> Slot:
        """Return the displacement of its joint from where it is free."""
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
            unit = self.keys["law"].of(self.joint in b.mechanism.slides).unit
            told = f"pull of {{}}{self.called(b.mechanism.link_names)}"
            pull = b.signal(self.law, Name("H", unit, told), self._turned(b))
            b.torque(self.joint, -1.0, pull, spends)
        elif self.stiffness:
            b.torque(self.joint, b.number(-self.stiffness), b.q(self.joint), spends=False)
            b.constant_torque(self.joint, self.stiffness * self.angle)


class JointDamper(Element):
    """A damper at a joint, N m s/rad or N s/m; D has the sum of those at a joint."""

    joint: int
    damping: float

    @property
    def at(self) -> int:
        return self.joint

    @property
    def changes_energy(self) -> bool:
        return bool(self.damping)
