"""The interface of all elements: how they act, what energy they hold, where they enter."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import ClassVar

from robodyn.elements.builder import Builder, Term
from robodyn.elements.contacts import End, Guard, Mode
from robodyn.elements.keys import Declared
from robodyn.elements.link_rows import PlanarPoint, Tree
from robodyn.elements.values import Point, Signal

STORED, SPENT = "stored", "spent"

# Places in the sum at one joint, and in that of forces on links: points first, then joints, in this
# order; a change of it changes the last bits of every result.
SPRINGS, MOMENTS, FORCES = 0, 1, 2
FRICTION, SPENT_LAW, STORED_LAW, SLIPPING, LINEAR = 0, 1, 2, 3, 4


class Element(Declared):
    """Something that acts on links or joints; its numbers may be floats or formulas.

    A kind that occurs in files declares its keys, and in `ways` how it is written.  `acts` is
    STORED if it has a potential (part of G and PE), SPENT if it is part of Q, and empty if it only
    contributes constants (D, M) or acts in modes alone.  `at` is the joint at which it acts, None
    if it acts on links.  `rank` orders sums.
    """

    # fields that are points of the scene, with their letters and meaning in equations
    points: ClassVar[dict[str, str]] = {}

    @property
    def acts(self) -> str:
        """STORED, SPENT, or ""."""
        return ""

    @property
    def rank(self) -> int:
        """Its order among elements at the same joint, or on links."""
        return 0

    @property
    def at(self) -> int | None:
        """The joint at which it acts, or None."""
        return None

    @property
    def is_load(self) -> bool:
        """Whether it comes from outside: nothing inside the mechanism feels the opposite."""
        return False

    @property
    def steady(self) -> bool:
        """Whether it is included in the constant weights and moments of the mechanism."""
        return False

    @property
    def steady_force(self) -> tuple[Point, complex] | None:
        """A constant force (N, ground's frame) among the weights, and its point; or None."""
        return None

    @property
    def steady_moment(self) -> tuple[int, float] | None:
        """A link, and a constant torque on it (N m) among the moments; or None."""
        return None

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Its laws, expressions and tables."""
        return tuple(signal for _, signal in self.varies())

    @property
    def changes_energy(self) -> bool:
        """Whether it changes the energy of the mechanism."""
        return self.acts == SPENT and not self.steady

    def placed(self, tree: Tree) -> Iterator[Element]:
        """Yield the elements that act in a mechanism with these links."""
        yield self

    def moved(
        self, point: Callable[[Point], Point], turn: Callable[[int | None], complex]
    ) -> Element | None:
        """Return the element moved to other links; None if it then acts on the ground alone.

        `point` maps its points, and `turn` gives the turn of the new frame of a link.
        """
        return self

    def varies(self) -> Iterator[tuple[str, Signal]]:
        """Yield its signals, each with its place in the mapping."""
        yield from ()

    def called(self, names: Sequence[str]) -> str:
        """Return what a legend adds to its number; `names` are those of the links."""
        return ""

    def rows(self, b: Builder) -> None:
        """Write its rows."""

    def energy(self, b: Builder) -> Iterator[Term]:
        """Yield the terms of its potential energy, J."""
        yield from ()

    def kinetic(self, b: Builder) -> Iterator[Term]:
        """Yield the terms of its kinetic energy, J."""
        yield from ()

    def also(self) -> Iterable[Element]:
        """Return further elements that stand for it: a damper of a spring, a rotor."""
        return ()

    def stored(self) -> Element | None:
        """Return the part of it that has a potential, or None."""
        return self if self.acts == STORED else None

    def spent(self) -> Element | None:
        """Return the part of it that is in Q, or None."""
        return self if self.acts == SPENT else None

    def untimed(self) -> Element | None:
        """Return the part of it that does not depend on time, or None."""
        return self

    # -- in modes ----------------------------------------------------------------------------------

    @property
    def contact(self) -> str:
        """STICKS, HARD or COMPLIANT for a contact, which acts in modes alone; else ""."""
        return ""

    def in_mode(self, mode: Mode) -> Iterable[Element]:
        """Return the elements that stand for it in a mode."""
        return (self,)

    def guards(self, mode: Mode, touches: Collection[End]) -> Iterator[Guard]:
        """Yield the guards of a mode in which joints rest on the hard ends `touches`."""
        yield from ()

    # -- what others ask of it ---------------------------------------------------------------------

    @property
    def word(self) -> str:
        """The name of its kind."""
        return re.sub("(?<!^)(?=[A-Z])", " ", type(self).__name__).lower()

    def parted(self, tree: Tree) -> PlanarPoint | None:
        """Return the vector between its ends (m) if it must not vanish, else None."""
        return None

    @property
    def free(self) -> float | None:
        """The position (rad, m) at which it is free, if it counts its joint's turns; or None."""
        return None

    def gradual(self, rate: float) -> Element:
        """Return it with a force that vanishes gradually below `rate` (rad/s or m/s)."""
        return self

    @property
    def bend_rate(self) -> float | None:
        """The rate of its joint (rad/s or m/s) around which its force bends; or None."""
        return None

    @property
    def bell(self) -> tuple[float, float] | None:
        """The width of a peak over its joint's rate, and the rate beyond which it vanishes.

        Both in rad/s or m/s.  None if there is no peak.
        """
        return None


def whole(elements: Iterable[Element]) -> Iterator[Element]:
    """Yield the elements, each followed by those that stand for it."""
    for x in elements:
        yield x
        yield from whole(x.also())


def conserves(law: Signal | None) -> bool:
    """Return whether a spring's force depends on its extension alone: it has a potential."""
    return law is None or law.names <= {"x"}
