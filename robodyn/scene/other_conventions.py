"""Keys of other conventions (URDF, Denavit-Hartenberg, other programs), and the way it is here.

By the kind of mapping that they stand in; the reader's message of an unknown key tells it.
"""

from __future__ import annotations

import re
from collections.abc import Collection

_DH = "Denavit-Hartenberg rows are not read: l is the length, from the pin, q its angle"
_PINNED = "the link that it hangs from is from: NAME, or {link: NAME, at: [x, y]}, or [x, y]"
_CENTRE = "the centre of gravity is r: along the link, or [x, y]"
_INERTIA = "the moment of inertia is I about the centre of gravity, or J about the own joint"
_KIND = "a joint is revolute unless joint: prismatic and axis: [dx, dy] stand in its link"
_LIMITS = "the ends of a joint are limits: {min: -1, max: 1}"
_ACTUATED = "the list `actuated` of the scene names the joints that carry torque"
_LINK = {
    **dict.fromkeys(("mass", "M", "weight"), "the mass is m"),
    **dict.fromkeys(("length", "L"), "the length is l"),
    **dict.fromkeys(("com", "cog", "cg", "lc", "rc", "center", "centre"), _CENTRE),
    **dict.fromkeys(
        (f"cent{x}_of_{y}" for x in ("er", "re") for y in ("mass", "gravity")), _CENTRE
    ),
    **dict.fromkeys(("inertia", "Izz", "izz", "moment_of_inertia", "inertial"), _INERTIA),
    **dict.fromkeys(("type", "joint_type", "kind", "sigma", "prismatic", "slider"), _KIND),
    **dict.fromkeys(("a", "alpha", "d", "theta", "dh", "offset"), _DH),
    **dict.fromkeys(("parent", "origin", "base", "xyz", "rpy", "pivot", "attached_to"), _PINNED),
    **dict.fromkeys(("limit", "qlim", "lower", "upper", "min", "max", "range"), _LIMITS),
    **dict.fromkeys(("viscous", "B", "b"), "viscous friction is damping"),
    **dict.fromkeys(("coulomb", "Tc"), "Coulomb friction is friction: {torque: 0.5, speed: 0.01}"),
    **dict.fromkeys(("gear", "gear_ratio", "G", "Jm"), "a gear is motor: {ratio: 50, ...}"),
    **dict.fromkeys(("actuated", "active", "driven"), _ACTUATED),
    **dict.fromkeys(("id", "label"), "the name is name"),
    **dict.fromkeys(("stiffness", "k"), "a spring at a joint is springs: [{joint: NAME, ...}]"),
    **dict.fromkeys(("q0", "initial", "angle"), "where it starts is start: {NAME: 30deg}, or --q"),
}
_SPRING = {
    **dict.fromkeys(("k", "K", "rate", "constant"), "the stiffness is stiffness"),
    **dict.fromkeys(("c", "b", "damper"), "the damping is damping"),
    **dict.fromkeys(
        ("l0", "L0", "rest_length", "free_length", "rest"),
        "the free length is length (of a spring at a joint angle)",
    ),
    **dict.fromkeys(("from", "to", "points", "ends", "links"), "its ends are between: [A, B]"),
}
_ENDS = {
    **dict.fromkeys(("lower", "low", "from"), "the lower end is min"),
    **dict.fromkeys(("upper", "high", "to"), "the upper end is max"),
    "velocity": "speeds have no limit here: trajectory --max-qd keeps one",
    "effort": "torques have no limit here: motor: {torque_max: 5, ...} tells one",
}
KEYS = {
    "scene": {
        "g": "gravity is gravity",
        **dict.fromkeys(("bodies", "segments", "robot"), "bodies are the list `links`"),
        "joints": "each link has its own joint: its keys stand in the link",
        **dict.fromkeys(("dh", "DH"), _DH),
        **dict.fromkeys(("loops", "constraints", "closure"), "loops are the list `closures`"),
        **dict.fromkeys(("actuators", "actuator", "motors", "inputs"), _ACTUATED),
        **dict.fromkeys(("forces", "torques", "load"), "they are the list `loads`"),
        **dict.fromkeys(("initial", "q0", "home", "configuration"), "it is start: {NAME: 30deg}"),
        "gears": "gears are couplings: ['q2 = -2 q1']",
        "units": "all is SI; a number may have a unit: 350 mm",
        "dampers": "they are springs with damping, and stiffness: 0",
    },
    "link": _LINK,
    "spring": _SPRING,
    "load": {
        **dict.fromkeys(("on", "body"), "the link is link"),
        **dict.fromkeys(("position", "location", "r"), "the place is at: [x, y]"),
        **dict.fromkeys(("moment", "tau"), "a torque is torque"),
        **dict.fromkeys(("F", "f", "vector"), "the force is force: [Fx, Fy]"),
        "direction": "the force is force: [Fx, Fy], and frame: link turns it with the link",
    },
    "limits": _ENDS,
    "slide_limits": _ENDS,
}
LISTS = dict.fromkeys(("limits", "slide_limits"), "; [lower, upper] is {min: lower, max: upper}")
LISTS["link"] = f"; {_DH}"
_IN_UNITS = re.compile("_(m|mm|kg|g|rad|deg|kgm2)$")


def way_here(form: str, key: str, known: Collection[str]) -> str:
    """What is written here for a key, in whatever case, with - or _; nothing where that is open."""
    ways, plain = KEYS.get(form, {}), key.replace("-", "_")
    own = [x for x in known if x.lower() == plain.lower()]
    lower = plain.lower()
    found = ways.get(key) or (f"did you mean {own[0]}?" if own else ways.get(lower))
    return found or ways.get(_IN_UNITS.sub("", lower), "")
