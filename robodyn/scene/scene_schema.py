"""The scene format as a JSON Schema (draft 2020-12), for editors that complete and check.

It says what a schema can say of the rules in `description.py`: keys, types, ranges.  Names that
must exist, links that hang from themselves and the like are found by robodyn alone.
"""

from __future__ import annotations

import re
from typing import Any

from robodyn.scene.quantities import ANGLE_PATTERN
from robodyn.scene.scene import BRANCHES, FRAMES

Schema = dict[str, Any]

_ANY_NAME = ["string", "number", "boolean"]  # what YAML makes of a name such as 3


def scene_schema() -> Schema:
    """The schema of a scene file, as JSON has it."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "robodyn scene",
        "description": "A planar mechanism: rigid links, pins and sliders. SI units.",
        **_mapping(
            {"links": {"description": "The links, at least one.", **_list("link", minItems=1)}},
            {
                "name": _described("name", "Text for titles. Default: the file's name."),
                "gravity": {
                    "description": "m/s²: a number acts along -Y; or [gx, gy]. Default: 0.",
                    "anyOf": [{"type": "number"}, _ref("vector")],
                },
                "closures": {
                    "description": "Pins and sliders that close loops.",
                    **_list("closure"),
                },
                "actuated": {
                    "description": "Links whose joints carry torque. Default: each joint outside "
                    "of loops, and the first of each loop.",
                    **_list("name", uniqueItems=True),
                },
                "assembly": {
                    "description": "Which of the two ways a loop closes in: one word, or one for "
                    "each closure. Default: open.",
                    "anyOf": [_ref("branch"), _list("branch")],
                },
                "couplings": {
                    "description": "Gears and belts: equations between joint angles, rad, such as "
                    "q3 = -2 q1 + 0.1.",
                    "anyOf": [_ref("coupling"), _list("coupling")],
                },
                "springs": {
                    "description": "Springs and dampers, between points or at joints.",
                    **_list("spring"),
                },
                "loads": {
                    "description": "Constant forces and torques on links.",
                    **_list("load"),
                },
                "start": {
                    "description": "Angles to assemble larger loops from, by link: {crank: 30deg}.",
                    "type": "object",
                    "additionalProperties": _ref("angle"),
                },
            },
        ),
        "$defs": _definitions() | _force_definitions(),
    }


def _definitions() -> dict[str, Schema]:
    return {
        "name": {"type": _ANY_NAME, "pattern": r"\S"},
        "amount": {"type": "number", "minimum": 0},
        "vector": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
        "angle": {
            "description": "rad, or 30deg, pi/2",
            "anyOf": [{"type": "number"}, {"type": "string", "pattern": f"^(?:{_ecma_angle()})$"}],
        },
        "branch": {"enum": list(BRANCHES)},
        "link": {
            "description": "A rigid link; its frame has x from its own joint to its tip.",
            **_mapping(
                {
                    "name": _described("name", "Any text; no two links share one."),
                    "m": _described("amount", "Mass, kg."),
                    "l": _described("amount", "Length from the link's own joint to its tip, m."),
                    "r": {
                        "description": "Centre of gravity, m: its distance along the link, or "
                        "[x, y] in the link's frame.",
                        "anyOf": [_ref("amount"), _ref("vector")],
                    },
                    "I": _described("amount", "Moment of inertia about the centre, kg m²."),
                },
                {
                    "from": _described(
                        "point",
                        "The point that it hangs from: [x, y] of the ground, NAME for a link's "
                        "tip, or {link: NAME, at: [x, y]}. Default: the tip of the link before.",
                    ),
                    "payload": _described("amount", "Point mass at the tip, kg. Default: 0."),
                    "damping": _described(
                        "amount", "Viscous damping at its own joint, N m s/rad. Default: 0."
                    ),
                    "friction": _described(
                        "friction", "Coulomb friction at its own joint. Default: none."
                    ),
                },
            ),
        },
        "link_point": {
            "description": "A point of a link: x, y in its frame, m.",
            **_mapping(
                {
                    "link": _described("name", "The link's name."),
                    "at": _described("vector", "x, y in the link's frame, m."),
                },
                {},
            ),
        },
        "moving_point": {"anyOf": [_ref("name"), _ref("link_point")]},
        "point": {
            "anyOf": [_ref("name"), _ref("link_point"), _described("vector", "Of the ground, m.")]
        },
        "closure": {"anyOf": [_ref("pin"), _ref("slider")]},
        "pin": _described("pair", "Two points that coincide."),
        "pair": {
            "description": "Two points, of which one at least is a link's.",
            "type": "array",
            "items": _ref("point"),
            "minItems": 2,
            "maxItems": 2,
            "contains": {"type": [*_ANY_NAME, "object"]},
        },
        "slider": {
            "description": "A point of a link that stays on a line of the ground.",
            **_mapping(
                {
                    "point": _described("moving_point", "NAME for a link's tip, or {link, at}."),
                    "on": _mapping(
                        {
                            "through": _described("vector", "A point of the line, m."),
                            "along": {
                                "description": "The line's direction, not [0, 0].",
                                "$ref": "#/$defs/vector",
                                "contains": {"not": {"const": 0}},
                            },
                        },
                        {},
                    ),
                },
                {},
            ),
        },
    }


def _force_definitions() -> dict[str, Schema]:
    return {
        "friction": {
            "description": "-torque tanh(qd/speed)",
            **_mapping(
                {
                    "torque": _described("amount", "N m, far above that speed."),
                    "speed": {
                        "description": "rad/s, > 0, that smooths it through rest.",
                        "type": "number",
                        "exclusiveMinimum": 0,
                    },
                },
                {},
            ),
        },
        "coupling": {"type": "string", "pattern": r"^\s*q\s*[0-9][0-9\s]*=\s*\S"},
        "spring": {"anyOf": [_ref("point_spring"), _ref("joint_spring")]},
        "point_spring": {
            "description": "A spring and damper between two points.",
            **_mapping(
                {
                    "between": _described("pair", "Its ends, [POINT, POINT]."),
                    "stiffness": _described("amount", "N/m; 0 for a damper alone."),
                    "length": _described("amount", "Free length, m."),
                },
                {"damping": _described("amount", "N s/m. Default: 0.")},
            ),
        },
        "joint_spring": {
            "description": "A spring and damper at a joint.",
            **_mapping(
                {
                    "joint": _described("name", "The link whose own joint it is."),
                    "stiffness": _described("amount", "N m/rad; 0 for a damper alone."),
                    "angle": _described("angle", "Free angle of the joint, rad or 30deg."),
                },
                {"damping": _described("amount", "N m s/rad. Default: 0.")},
            ),
        },
        "load": {"anyOf": [_ref("force"), _ref("torque")]},
        "force": {
            "description": "A constant force at a point of a link.",
            **_mapping(
                {
                    "link": _described("name", "The link's name."),
                    "at": _described("vector", "x, y in the link's frame, m."),
                    "force": _described("vector", "[Fx, Fy], N."),
                },
                {
                    "frame": {
                        "description": "ground: it keeps its direction; link: it turns with the "
                        "link. Default: ground.",
                        "enum": list(FRAMES),
                    }
                },
            ),
        },
        "torque": {
            "description": "A constant torque on a link.",
            **_mapping(
                {
                    "link": _described("name", "The link's name."),
                    "torque": {"description": "N m, from the ground.", "type": "number"},
                },
                {},
            ),
        },
    }


def _mapping(needed: dict[str, Schema], optional: dict[str, Schema]) -> Schema:
    return {
        "type": "object",
        "properties": needed | optional,
        "required": list(needed),
        "additionalProperties": False,
    }


def _list(kind: str, **limits: object) -> Schema:
    return {"type": "array", "items": _ref(kind), **limits}


def _ref(kind: str) -> Schema:
    return {"$ref": f"#/$defs/{kind}"}


def _described(kind: str, text: str) -> Schema:
    return {"description": text, **_ref(kind)}


def _ecma_angle() -> str:
    """The pattern of angles in the dialect of JSON Schema, which has no (?P<name>...)."""
    return re.sub(r"\?P<\w+>", "?:", ANGLE_PATTERN)
