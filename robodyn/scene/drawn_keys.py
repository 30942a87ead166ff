"""The keys of scenes as drawn, of which `drawn.py` makes the explicit form."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn.elements.keys import Declared, Way, key
from robodyn.scene.scene import Description, Link, Weld


class DrawnScene(Declared):
    """A scene by the places of its pins in one pose."""

    pins: ClassVar[Any] = key(
        "pins", "where the pins are in one pose, {A: [0.1, 0.2], B: [0.4, 0.3]}", unit="m"
    )
    links: ClassVar[Any] = key("drawn_link", "list of links, at least one", listed=True)
    ground: ClassVar[Any] = key(
        "ground_pin",
        "list of the pins that the ground has, or that run on a line of it",
        listed=True,
        absent=(),
    )
    slots: ClassVar[Any] = key(
        "slot", "list of pins that run on a line of a link", listed=True, absent=()
    )

    like = Description, frozenset(("links", "closures", "branches", "start"))
    ways: ClassVar[tuple[Way, ...]] = (
        Way(
            "drawn_scene",
            "scene",
            "A planar mechanism as drawn: where its pins are in one pose, "
            "and which links have them.",
            ("pins",),
        ),
    )


class DrawnLink(Declared):
    """A link by its pins."""

    pins: ClassVar[Any] = key(
        ("two_pins", "pin_names"),
        (
            "its pins: the first is its own joint",
            "its pins: the first is its own joint; it may be the only one",
        ),
    )
    r: ClassVar[Any] = Link.keys["r"]._replace(
        help="centre of gravity: [x, y] of the link, or its distance along it",
        told="r or centre",
        absent=None,
    )
    centre: ClassVar[Any] = key(
        "vector",
        "centre of gravity, [x, y] in the drawing",
        unit="m",
        told="r or centre",
        absent=None,
    )
    along: ClassVar[Any] = key(
        "direction",
        "which way it slides, [dx, dy] in the drawing",
        ways=("drawn_prismatic_link",),
    )

    like = Link, frozenset(("l", "hangs_from", "joint", "axis"))
    ways: ClassVar[tuple[Way, ...]] = (
        Way(
            "drawn_prismatic_link",
            "drawn_link",
            "A link on a prismatic joint: its frame has x along the line that it slides on.",
            ("along",),
            True,
        ),
        Way(
            "drawn_revolute_link",
            "drawn_link",
            "A rigid link; its frame has x from its first pin to its second.",
        ),
    )


class DrawnWeld(Declared):
    """A link by its pins that is part of what has its first pin."""

    pins: ClassVar[Any] = key(
        "two_pins", "its pins: the first is one of what it is welded to, to the second its x goes"
    )
    r: ClassVar[Any] = DrawnLink.keys["r"]
    centre: ClassVar[Any] = DrawnLink.keys["centre"]
    joint: ClassVar[Any] = Weld.keys["joint"]

    like = Weld, frozenset(("l", "hangs_from", "angle"))
    ways: ClassVar[tuple[Way, ...]] = (
        Way(
            "drawn_weld",
            "drawn_link",
            "A link without a joint, part of the nearest link above that has its first pin.",
            ("joint",),
        ),
    )


class GroundLine(Declared):
    """A line of the ground in a drawing."""

    pin: ClassVar[Any] = key("name", "a pin of a link")
    along: ClassVar[Any] = key("direction", "the line's direction in the drawing, not [0, 0]")

    ways: ClassVar[tuple[Way, ...]] = (
        Way("ground_line", "ground_pin", "A pin that stays on a line of the ground."),
    )


class Slot(Declared):
    """A line of a link in a drawing."""

    pin: ClassVar[Any] = key("name", "a pin of another link, or of the ground")
    on: ClassVar[Any] = key("name", "the link that has the slot")
    along: ClassVar[Any] = key("direction", "the slot's direction in the drawing, not [0, 0]")

    ways: ClassVar[tuple[Way, ...]] = (
        Way("slot", "slot", "A pin that stays on a line of a link."),
    )
