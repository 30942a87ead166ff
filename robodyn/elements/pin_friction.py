"""Friction in pins and on slides, by the force that they carry.

With N the force in the pin, or the force normal to the line of a slide, it is

    -coefficient radius |N| tanh(rate/speed)        a torque, at pins
    -coefficient |N| tanh(rate/speed)               a force, along slides

against the relative rate.  N depends on the whole mechanism, this friction included.  So no rows of
a program have it, and `dynamics/friction_rounds.py` solves for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

from robodyn.elements.base import FRICTION, Element
from robodyn.elements.joints import RATES
from robodyn.elements.keys import Way, key
from robodyn.elements.link_rows import Tree

PINS = ("pin_friction", "closure_pin_friction")
TORQUE, FORCE = "coefficient radius |pin force|", "coefficient |normal force|"


class PinFriction(Element):
    """Friction at a joint, or at the closure with a number, by the force there."""

    joint: int | None
    coefficient: float = key("amount", ("of the force in the pin", "of the force across the slide"))
    radius: float | None = key("positive", "of the pin", unit="m", ways=PINS)
    speed: float = key("positive", "what smooths it through rest", unit=RATES)
    closure: int | None = None

    ways: ClassVar[tuple[Way, ...]] = (
        Way("pin_friction", "friction", f"Friction in a pin: {TORQUE}.", ("coefficient",)),
        Way(
            "track_friction",
            "slide_friction",
            f"Friction of a slide: {FORCE}.",
            ("coefficient",),
            True,
        ),
        Way(
            "closure_pin_friction",
            "closure_friction",
            f"Friction in the pin of a closure: {TORQUE}.",
        ),
        Way(
            "line_friction",
            "slide_closure_friction",
            f"Friction along the line of a closure: {FORCE}.",
            (),
            True,
        ),
    )

    @classmethod
    def from_keys(cls, values: dict[str, Any]) -> PinFriction:
        return cls(**{"radius": None, **values})

    def placed(self, tree: Tree) -> Iterator[Element]:
        if self.coefficient:
            yield self

    @property
    def at(self) -> int | None:
        return self.joint

    @property
    def rank(self) -> int:
        return FRICTION

    @property
    def changes_energy(self) -> bool:
        return True

    @property
    def bend_rate(self) -> float:
        return self.speed

    def untimed(self) -> None:
        """Return None: a controller's model does not include it."""
