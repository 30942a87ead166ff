"""The grammar of scene files, written once: every key with its kind, unit, default and help.

From it come the reader's checks (`description.py`), the JSON Schema (`scene_schema.py`), the names
of numbers that sweeps vary (`scene_values.py`) and the symbols of equations (`parameters.py`); the
tables of the guide's page on scenes are held against it.

A kind is that of a value: one of those below, or one that the reader has a method for and the
schema a definition.
"""

from __future__ import annotations

from collections.abc import Container

from robodyn.scene.forms import ONE as ONE
from robodyn.scene.forms import Form as Form
from robodyn.scene.forms import Key as Key
from robodyn.scene.joint_forms import (
    DAMPER,
    DAMPING,
    PULLS,
    damping_key,
    dry_friction_form,
    friction_form,
    joint_spring_form,
    limit_forms,
    motor_form,
    pull_keys,
)
from robodyn.scene.scene import BRANCHES, FRAMES, JOINTS

NUMBERS = {  # and their limits
    "number": "",
    "angle": "",
    "amount": ">= 0",
    "positive": "> 0",
    "nonzero": "not 0",
    "part": "in [0, 1]",
}
WORDS = {"branch": BRANCHES, "frame": FRAMES, "joint_kind": JOINTS}
BY_JOINT = "rad or m"  # as the joint turns or slides
WITH_UNIT = ("vector", "varying", "varying_vector", "law")  # beside numbers
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
    "load": {"torque": ("torque",), "point_force": ("point",), "force": ()},
    "closure": {"slider": ()},
    "point": {"link_point": ()},
    "moving_point": {"link_point": ()},
    "varying": {"load_table": ()},
}
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

FORCE = {
    "force": Key(
        "varying_vector",
        "[Fx, Fy], each a number, an expression or a table",
        "N",
        symbol="F: force of {}",
    ),
    "frame": Key(
        "frame",
        "ground: it keeps its direction; link: it turns with the link",
        default="ground",
    ),
}
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
                BY_JOINT,
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
            "loads": Key("load", "list of forces and torques on links", "", "none", True),
            "points": Key(
                "points",
                "names of points of links, {P: {link: coupler, at: [0.5, 0.2]}, Q: rocker}",
                default="none",
            ),
        },
    ),
    "revolute_link": Form(
        "A rigid link; its frame has x from its own joint to its tip.",
        _LINK
        | {
            "joint": Key("joint_kind", "of its own joint", default=JOINTS[0]),
            "damping": damping_key("N m s/rad"),
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
            "damping": damping_key("N s/m"),
            "friction": Key("slide_friction", "Coulomb friction at its own joint", default="none"),
            "limits": Key("slide_limits", "where its own joint ends", default="none"),
            "motor": Key("slide_motor", "motor and gear at its own joint", default="none"),
        },
    ),
    "friction": friction_form("torque", "N m", "rad/s"),
    "slide_friction": friction_form("force", "N", "m/s"),
    "dry_friction": dry_friction_form("torque", "N m", "rad/s"),
    "slide_dry_friction": dry_friction_form("force", "N", "m/s"),
    **limit_forms("angle", "rad", "N m"),
    **limit_forms("number", "m", "N"),
    "motor": motor_form("", JOINTS[0]),
    "slide_motor": motor_form("rad/m", JOINTS[1]),
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
            "point": Key("moving_point", "a point of a link: its name, or {link, at}"),
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
            **pull_keys("N/m", "N", "its length less the free one", "m"),
            "damping": Key("amount", DAMPER, "N s/m", "0", symbol=DAMPING),
            "length": Key("amount", "free length", "m", symbol="S0: free length of {}"),
        },
        PULLS,
    ),
    "joint_spring": joint_spring_form("angle", "angle", "rad", "N m"),
    "slide_spring": joint_spring_form("length", "number", "m", "N"),
    "force": Form(
        "A force at a place of a link.",
        {
            "link": Key("link_name", "the link that it acts on"),
            "at": Key("vector", "where, [x, y] in the link's frame", "m"),
            **FORCE,
        },
    ),
    "point_force": Form(
        "A force at a point.",
        {"point": Key("moving_point", "a point of a link: its name, or {link, at}"), **FORCE},
    ),
    "torque": Form(
        "A torque on a link.",
        {
            "link": Key("link_name", "the link that it acts on"),
            "torque": Key(
                "varying",
                "from the ground, counter-clockwise: a number, an expression or a table",
                "N m",
                symbol="T: torque of {}",
            ),
        },
    ),
    "load_table": Form(
        "A force or torque by a table, linear between its rows.",
        {
            "table": Key("name", "the CSV file, from the scene file's folder"),
            "over": Key("name", "t, or a joint q1, ..: its column tells where the rows are"),
            "column": Key("name", "the column of the force or torque"),
        },
    ),
}


def _form_name(kind: str, keys: Container[str]) -> str:
    forms = MAPPINGS.get(kind, {kind: ()})
    return next(form for form, marks in forms.items() if all(x in keys for x in marks))


def form_of(kind: str, keys: Container[str]) -> Form:
    """The form of a mapping of this kind that has these keys."""
    return FORMS[_form_name(kind, keys)]


def excluded(kind: str, keys: Container[str]) -> dict[str, str]:
    """The keys that tell other forms of this kind, each with that which tells the form of these."""
    forms, own = MAPPINGS.get(kind, {kind: ()}), _form_name(kind, keys)
    return {x: y for form in forms if form != own for x in forms[form] for y in forms[own][:1]}
