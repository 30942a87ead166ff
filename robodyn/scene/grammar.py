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

from robodyn.scene.scene import BRANCHES, FRAMES, JOINTS


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

    @property
    def absent(self) -> bool:
        """Whether there is nothing where a file leaves it out."""
        return self.default in ("none", "the ground")


class Form(NamedTuple):
    """A mapping with known keys."""

    help: str
    keys: dict[str, Key]

    def named(self, needed: bool) -> list[str]:
        """The keys that a file must have, or the others."""
        return [name for name, key in self.keys.items() if key.needed == needed]


NUMBERS = {  # and their limits
    "number": "",
    "angle": "",
    "amount": ">= 0",
    "positive": "> 0",
    "nonzero": "not 0",
    "part": "in [0, 1]",
}
WORDS = {"branch": BRANCHES, "frame": FRAMES, "joint_kind": JOINTS}
OR_VECTOR = {"gravity": "number", "centre": "amount"}  # a number of this kind, or [x, y]
# The forms of a mapping of this kind, each with the keys that tell it; the last has none.
MAPPINGS: dict[str, dict[str, tuple[str, ...]]] = {
    "friction": {"dry_friction": ("static",), "friction": ()},
    "slide_friction": {"slide_dry_friction": ("static",), "slide_friction": ()},
    "limits": {"stops": ("stiffness",), "hard_stops": ("restitution",), "limits": ()},
    "slide_limits": {
        "slide_stops": ("stiffness",),
        "slide_hard_stops": ("restitution",),
        "slide_limits": (),
    },
    "link": {"prismatic_link": ("axis",), "revolute_link": ()},
    "spring": {"slide_spring": ("joint", "length"), "joint_spring": ("joint",), "point_spring": ()},
    "load": {"torque": ("torque",), "force": ()},
    "closure": {"slider": ()},
    "point": {"link_point": ()},
    "moving_point": {"link_point": ()},
}
DAMPER = "of a damper beside it"
STIFFNESS, DAMPING = "k: stiffness of {}", "ds: damping of {}"

_LINK = {
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
    "from": Key("point", "the point that it hangs from", default="the tip of the link before"),
    "payload": Key(
        "amount", "point mass at the tip", "kg", "0", symbol="mp: payload at the tip of {}"
    ),
}


def _damping(unit: str) -> Key:
    told = "d: damping at the joint of {}"
    return Key("amount", "viscous damping at its own joint", unit, "0", symbol=told)


def _friction(name: str, unit: str, speed: str) -> Form:
    told = f"-{name} tanh(qd/speed)"
    letters = name[0]
    return Form(
        told,
        {
            name: Key(
                "amount",
                "far above that speed",
                unit,
                symbol=f"{letters}f: friction at the joint of {{}}",
            ),
            "speed": Key(
                "positive",
                "what smooths it through rest",
                speed,
                hint=f": the friction is {told}",
                symbol="wf: rate that smooths the friction at the joint of {}",
            ),
        },
    )


def _dry_friction(name: str, unit: str, speed: str) -> Form:
    return Form(
        f"Friction that sticks: {name} + (static - {name}) exp(-(qd/stribeck)^2) against the "
        "motion; at rest it holds up to static.",
        {
            name: Key("amount", "in motion, far above the rate stribeck", unit),
            "static": Key("amount", f"most that it holds at rest, not below {name}", unit),
            "stribeck": Key("positive", "rate over which it falls from static", speed, "none"),
        },
    )


def _motor(ratio: str, joint: str) -> Form:
    told = f"A motor and its gear at a {joint} joint, with a rotor on the link that carries it."
    return Form(
        told,
        {
            "ratio": Key(
                "nonzero",
                "the rotor's turn over the joint's, seen from the carrying link",
                ratio,
                symbol="N: ratio of the gear at the joint of {}",
            ),
            "inertia": Key(
                "amount",
                "of the rotor; it is not in the I of the carrying link",
                "kg m²",
                symbol="J: inertia of the rotor of {}",
            ),
            "damping": Key(
                "amount",
                "viscous damping of the rotor",
                "N m s/rad",
                "0",
                symbol="b: damping of the rotor of {}",
            ),
            "torque_max": Key("positive", "largest torque of the motor", "N m", "none"),
            "speed_max": Key("positive", "largest speed of the rotor", "rad/s", "none"),
            "torque_constant": Key(
                "positive", "torque per current; resistance beside it", "N m/A", "none"
            ),
            "resistance": Key(
                "positive", "of the winding; torque_constant beside it", "ohm", "none"
            ),
        },
    )


def _limits(kind: str, unit: str, load: str) -> dict[str, Form]:
    """Compliant stops, hard ones, and limits alone."""
    ends = {
        "min": Key(kind, "where the joint ends below", unit, "none"),
        "max": Key(kind, "where it ends above; one of the two may be missing", unit, "none"),
    }
    stiffness = Key("positive", "of the stop, which pushes and never pulls", f"{load}/{unit}")
    damping = Key("amount", "of the stop, while it pushes", f"{load} s/{unit}", "0")
    restitution = Key("part", "speed after an impact over that before, from 0 to 1")
    prefix = "slide_" if kind == "number" else ""
    return {
        f"{prefix}stops": Form(
            "Compliant stops of a joint.", ends | {"stiffness": stiffness, "damping": damping}
        ),
        f"{prefix}hard_stops": Form(
            "Hard stops of a joint, which throw it back.", ends | {"restitution": restitution}
        ),
        f"{prefix}limits": Form("Limits of a joint, which end a simulation.", ends),
    }


def _joint_spring(free: str, kind: str, unit: str, load: str) -> Form:
    turns = f"; its {free} counts from turn to turn" if kind == "angle" else ""
    place = "angle" if kind == "angle" else "displacement"
    return Form(
        f"A spring and damper at a {JOINTS[kind != 'angle']} joint.",
        {
            "joint": Key("link_name", f"the link whose own joint it is{turns}"),
            "stiffness": Key("amount", "0 for a damper alone", f"{load}/{unit}", symbol=STIFFNESS),
            "damping": Key("amount", DAMPER, f"{load} s/{unit}", "0", symbol=DAMPING),
            free: Key(
                kind, f"free {place} of the joint", unit, symbol=f"phi: free {place} of {{}}"
            ),
        },
    )


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
                "start",
                "where joints begin when larger loops are assembled, {crank: 30deg}",
                "rad or m",
                "none",
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
    "revolute_link": Form(
        "A rigid link; its frame has x from its own joint to its tip.",
        _LINK
        | {
            "joint": Key("joint_kind", "of its own joint", default=JOINTS[0]),
            "damping": _damping("N m s/rad"),
            "friction": Key("friction", "Coulomb friction at its own joint", default="none"),
            "limits": Key("limits", "where its own joint ends", default="none"),
            "motor": Key("motor", "motor and gear at its own joint", default="none"),
        },
    ),
    "prismatic_link": Form(
        "A link on a prismatic joint: its frame has x along the axis that it slides on.",
        _LINK
        | {
            "joint": Key("joint_kind", "prismatic"),
            "axis": Key(
                "direction", "which way it slides, [dx, dy] in the frame of what it hangs from"
            ),
            "damping": _damping("N s/m"),
            "friction": Key("slide_friction", "Coulomb friction at its own joint", default="none"),
            "limits": Key("slide_limits", "where its own joint ends", default="none"),
            "motor": Key("slide_motor", "motor and gear at its own joint", default="none"),
        },
    ),
    "friction": _friction("torque", "N m", "rad/s"),
    "slide_friction": _friction("force", "N", "m/s"),
    "dry_friction": _dry_friction("torque", "N m", "rad/s"),
    "slide_dry_friction": _dry_friction("force", "N", "m/s"),
    **_limits("angle", "rad", "N m"),
    **_limits("number", "m", "N"),
    "motor": _motor("", JOINTS[0]),
    "slide_motor": _motor("rad/m", JOINTS[1]),
    "link_point": Form(
        "A point of a link.",
        {
            "link": Key("link_name", "the link's name"),
            "at": Key("vector", "where, [x, y] in the link's frame", "m"),
        },
    ),
    "slider": Form(
        "A point of a link that stays on a line: a slider, or a pin in a slot.",
        {
            "point": Key("moving_point", "NAME for a link's tip, or {link, at}"),
            "on": Key("line", "the line"),
            "aligned": Key(
                "angle",
                "angle that the point's link keeps to the line's link (or to +X): a block that "
                "does not turn",
                "rad",
                "none",
                symbol="beta: angle kept by closure {}",
            ),
        },
    ),
    "line": Form(
        "A line of the ground or of a link.",
        {
            "link": Key("link_name", "the link that has the slot", default="the ground"),
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
    "joint_spring": _joint_spring("angle", "angle", "rad", "N m"),
    "slide_spring": _joint_spring("length", "number", "m", "N"),
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
    forms = MAPPINGS.get(kind, {kind: ()})
    return FORMS[next(form for form, marks in forms.items() if all(x in keys for x in marks))]
