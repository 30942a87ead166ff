"""What every kind of element has: how it acts, what it holds, which part of the equations it is."""

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
    """One thing that acts; its numbers may be floats or formulas.

    A kind that files have declares its keys, and in `ways` how it is written.
    `acts` is STORED for what has a potential (part of G and of PE), SPENT for what is part of Q,
    and empty for what is constants of the mechanism (D, M) or acts in no mode of its own.  `at` is
    the joint at which it acts; None where it acts on links.  `rank` orders sums.
    """

    # fields that are points of the scene, with their letters and meaning in equations
    points: ClassVar[dict[str, str]] = {}

    @property
    def acts(self) -> str:
        """STORED, SPENT, or nothing."""
        return ""

    @property
    def rank(self) -> int:
        """Its place among those that act at the same joint, or on links."""
        return 0

    @property
    def at(self) -> int | None:
        """The joint at which it acts."""
        return None

    @property
    def is_load(self) -> bool:
        """Whether it comes from without: nothing inside of the mechanism feels the opposite."""
        return False

    @property
    def steady(self) -> bool:
        """Whether it is among the constant weights and moments of the mechanism."""
        return False

    @property
    def steady_force(self) -> tuple[Point, complex] | None:
        """A constant force that is among the weights, N in the ground's frame, and its point."""
        return None

    @property
    def steady_moment(self) -> tuple[int, float] | None:
        """A link, and the constant torque on it that is among the moments, N m."""
        return None

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Its laws, expressions and tables."""
        return tuple(signal for _, signal in self.varies())

    @property
    def changes_energy(self) -> bool:
        """Whether the energy of the mechanism changes by it."""
        return self.acts == SPENT and not self.steady

    def placed(self, tree: Tree) -> Iterator[Element]:
        """The elements that act in a mechanism of these links, of one that a scene has."""
        yield self

    def moved(
        self, point: Callable[[Point], Point], turn: Callable[[int | None], complex]
    ) -> Element | None:
        """It on other links: `point` takes its points there, whose frames have a `turn` there.

        None if it then acts on the ground alone.
        """
        return self

    def varies(self) -> Iterator[tuple[str, Signal]]:
        """Its signals, each with the place in its mapping."""
        yield from ()

    def called(self, names: Sequence[str]) -> str:
        """What a legend adds to its number, of links with these names."""
        return ""

    def rows(self, b: Builder) -> None:
        """Write what it does."""

    def energy(self, b: Builder) -> Iterator[Term]:
        """What it holds, J."""
        yield from ()

    def kinetic(self, b: Builder) -> Iterator[Term]:
        """What moves in it, J."""
        yield from ()

    def also(self) -> Iterable[Element]:
        """Further elements that stand for it: a damper beside a spring, a rotor."""
        return ()

    def stored(self) -> Element | None:
        """The part of it that has a potential."""
        return self if self.acts == STORED else None

    def spent(self) -> Element | None:
        """The part of it that is in Q."""
        return self if self.acts == SPENT else None

    def untimed(self) -> Element | None:
        """What remains of it where nothing knows the time."""
        return self

    # -- in modes ----------------------------------------------------------------------------------

    @property
    def contact(self) -> str:
        """STICKS, HARD or COMPLIANT where it is a contact, which acts in modes alone."""
        return ""

    def in_mode(self, mode: Mode) -> Iterable[Element]:
        """What stands for it where the mechanism is in a mode."""
        return (self,)

    def guards(self, mode: Mode, touches: Collection[End]) -> Iterator[Guard]:
        """What ends a mode, where joints rest on the hard ends `touches`."""
        yield from ()

    # -- what others ask of it ---------------------------------------------------------------------

    @property
    def word(self) -> str:
        """What its kind is called."""
        return re.sub("(?<!^)(?=[A-Z])", " ", type(self).__name__).lower()

    def parted(self, tree: Tree) -> PlanarPoint | None:
        """The way between its ends, m, if its force has no limit where that vanishes."""
        return None

    @property
    def free(self) -> float | None:
        """Where its joint, whose turns count by it, is free of it, rad or m; None: they do not."""
        return None

    def gradual(self, rate: float) -> Element:
        """It, if what it gives falls by that rate of its joint, rad/s or m/s, and not at once."""
        return self

    @property
    def bend_rate(self) -> float | None:
        """The rate of its joint, rad/s or m/s, about which it bends; None: it does not so."""
        return None

    @property
    def bell(self) -> tuple[float, float] | None:
        """The width of a bell over its joint's rate, and the rate beyond which it vanishes.

        Both are rad/s or m/s.
        """
        return None


def whole(elements: Iterable[Element]) -> Iterator[Element]:
    """The elements, each followed by those that stand for it as well."""
    for x in elements:
        yield x
        yield from whole(x.also())


def conserves(law: Signal | None) -> bool:
    """Whether what a spring gives depends on its extension alone, and has a potential."""
    return law is None or law.names <= {"x"}
