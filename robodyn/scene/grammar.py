"""The grammar of scene files, written once: every key with its kind, unit, default and help.

From it come the reader's checks (`description.py`), the JSON Schema (`scene_schema.py`), the names
of numbers that sweeps vary (`scene_values.py`) and the symbols of equations (`parameters.py`); the
README's tables are held against it.

A kind is that of a value: one of those below, or one that the reader has a method for and the
schema a definition.
"""

from __future__ import annotations

from collections.abc import Container
from typing import NamedTuple

from robodyn.scene.scene import BRANCHES, FRAMES


class Key(NamedTuple):
    """A key of a mapping: the kind of its value, what it is, its unit, and what stands for it."""

    kind: str
    help: str
    unit: str = ""
    default: str = "needed"  # as it is told
    listed: bool = False  # whether the value is a list of this kind
    hint: str = ""  # what a message adds where a limit is not kept
    symbol: str = ""  # its letters in equations, and what a legend says of it

    @property
    def needed(self) -> bool:
        """Whether a file must have it."""
        return self.default == "needed"


class Form(NamedTuple):
    """A mapping with known keys."""

    help: str
    keys: dict[str, Key]

    def named(self, needed: bool) -> list[str]:
        """The keys that a file must have, or the others."""
        return [name for name, key in self.keys.items() if key.needed == needed]


NUMBERS = {"number": "", "angle": "", "amount": ">= 0", "positive": "> 0"}  # and their limits
WORDS = {"branch": BRANCHES, "frame": FRAMES}
OR_VECTOR = {"gravity": "number", "centre": "amount"}  # a number of this kind, or [x, y]
# The form of a mapping of this kind, and another where it has a key.
MAPPINGS = {
    "spring": ("point_spring", "joint_spring", "joint"),
    "load": ("force", "torque", "torque"),
    "closure": ("slider", "", ""),
    "point": ("link_point", "", ""),
    "moving_point": ("link_point", "", ""),
}
DAMPER = "of a damper beside it"
STIFFNESS, DAMPING = "k: stiffness of {}", "ds: damping of {}"

FORMS = {
    "scene": Form(
        "A planar mechanism: rigid links, pins and sliders. SI units.",
        {
            "name": Key("name", "text for titles", default="the file's name less .yaml"),
            "gravity": Key(
                "gravity", "a number g acts along -Y; or a vector [gx, gy]", "m/s²", "0"
            ),
            "links": Key("link", "list of links, at least one", listed=True),
            "closures": Key(
                "closure", "list of pins and sliders that close loops", "", "none", True
            ),
            "actuated": Key(
                "joints",
                "links whose joints carry torque",
                default="all outside of loops, the first of each loop",
            ),
            "assembly": Key(
                "assembly", "open or crossed; or a list of these, one for each closure", "", "open"
            ),
            "start": Key(
                "start", "angles to assemble larger loops from, {crank: 30deg}", "rad", "none"
            ),
            "couplings": Key(
                "couplings", "gears and belts: equations such as q3 = -2 q1 + 0.1", "", "none"
            ),
            "springs": Key(
                "spring",
                "list of springs and dampers, between points or at joints",
                default="none",
                listed=True,
            ),
            "loads": Key("load", "list of constant forces and torques on links", "", "none", True),
        },
    ),
    "link": Form(
        "A rigid link; its frame has x from its own joint to its tip.",
        {
            "name": Key("name", "any text; no two links share one"),
            "m": Key("amount", "mass", "kg", symbol="m: mass of {}"),
            "l": Key(
                "amount",
                "length from the link's own joint to its tip",
                "m",
                symbol="l: length of {}",
            ),
            "r": Key(
                "centre",
                "centre of gravity: a point [x, y] of the link, or its distance along it",
                "m",
                hint="; write [x, y] for a centre of gravity behind or beside the link",
                symbol="r: centre of gravity of {}",
            ),
            "I": Key(
                "amount",
                "moment of inertia about the centre of gravity",
                "kg m²",
                symbol="I: moment of inertia of {} about its centre of gravity",
            ),
            "from": Key(
                "point", "the point that it hangs from", default="the tip of the link before"
            ),
            "payload": Key(
                "amount", "point mass at the tip", "kg", "0", symbol="mp: payload at the tip of {}"
            ),
            "damping": Key(
                "amount",
                "viscous damping at its own joint",
                "N m s/rad",
                "0",
                symbol="d: damping at the joint of {}",
            ),
            "friction": Key("friction", "Coulomb friction at its own joint", default="none"),
        },
    ),
    "friction": Form(
        "-torque tanh(qd/speed)",
        {
            "torque": Key(
                "amount",
                "far above that speed",
                "N m",
                symbol="tf: friction at the joint of {}",
            ),
            "speed": Key(
                "positive",
                "what smooths it through rest",
                "rad/s",
                hint=": the friction is -torque tanh(qd/speed)",
                symbol="wf: rate that smooths the friction at the joint of {}",
            ),
        },
    ),
    "link_point": Form(
        "A point of a link.",
        {
            "link": Key("link_name", "the link's name"),
            "at": Key("vector", "where, [x, y] in the link's frame", "m"),
        },
    ),
    "slider": Form(
        "A point of a link that stays on a line of the ground.",
        {
            "point": Key("moving_point", "NAME for a link's tip, or {link, at}"),
            "on": Key("line", "the line"),
        },
    ),
    "line": Form(
        "A line of the ground.",
        {
            "through": Key("vector", "a point of the line", "m"),
            "along": Key("direction", "the line's direction, not [0, 0]"),
        },
    ),
    "point_spring": Form(
        "A spring and damper between two points.",
        {
            "between": Key("pair", "its ends, [POINT, POINT], not both of one link or the ground"),
            "stiffness": Key("amount", "0 for a damper alone", "N/m", symbol=STIFFNESS),
            "damping": Key("amount", DAMPER, "N s/m", "0", symbol=DAMPING),
            "length": Key("amount", "free length", "m", symbol="S0: free length of {}"),
        },
    ),
    "joint_spring": Form(
        "A spring and damper at a joint.",
        {
            "joint": Key(
                "link_name", "the link whose own joint it is; its angle counts from turn to turn"
            ),
            "stiffness": Key("amount", "0 for a damper alone", "N m/rad", symbol=STIFFNESS),
            "damping": Key("amount", DAMPER, "N m s/rad", "0", symbol=DAMPING),
            "angle": Key("angle", "free angle of the joint", "rad", symbol="phi: free angle of {}"),
        },
    ),
    "force": Form(
        "A constant force at a point of a link.",
        {
            "link": Key("link_name", "the link that it acts on"),
            "at": Key("vector", "where, [x, y] in the link's frame", "m"),
            "force": Key("vector", "[Fx, Fy]", "N", symbol="F: force of {}"),
            "frame": Key(
                "frame",
                "ground: it keeps its direction; link: it turns with the link",
                default="ground",
            ),
        },
    ),
    "torque": Form(
        "A constant torque on a link.",
        {
            "link": Key("link_name", "the link that it acts on"),
            "torque": Key(
                "number",
                "from the ground on the link, counter-clockwise",
                "N m",
                symbol="T: torque of {}",
            ),
        },
    ),
}


def form_of(kind: str, keys: Container[str]) -> Form:
    """The form of a mapping of this kind that has these keys."""
    plain, marked, mark = MAPPINGS.get(kind, (kind, "", ""))
    return FORMS[marked if mark and mark in keys else plain]
