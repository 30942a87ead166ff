"""The forms of what acts at joints; a joint that slides has the same, in other units."""

from __future__ import annotations

from robodyn.scene.forms import ONE, Form, Key
from robodyn.scene.scene import JOINTS

DAMPER = "of a damper beside it"
PULLS = ("stiffness", "law", "table")
STIFFNESS, DAMPING = "k: stiffness of {}", "ds: damping of {}"


def damping_key(unit: str) -> Key:
    told = "d: damping at the joint of {}"
    return Key("amount", "viscous damping at its own joint", unit, "0", symbol=told)


def friction_form(name: str, unit: str, speed: str) -> Form:
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


def dry_friction_form(name: str, unit: str, speed: str) -> Form:
    return Form(
        f"Friction that sticks: {name} + (static - {name}) exp(-(qd/stribeck)^2) against the "
        "motion; at rest it holds up to static.",
        {
            name: Key(
                "amount",
                "in motion, far above the rate stribeck",
                unit,
                symbol=f"{name[0]}f: friction in motion at the joint of {{}}",
            ),
            "static": Key(
                "amount",
                f"most that it holds at rest, not below {name}",
                unit,
                symbol=f"{name[0]}s: friction at rest at the joint of {{}}",
            ),
            "stribeck": Key(
                "positive",
                "rate over which it falls from static",
                speed,
                "none",
                symbol="ws: rate over which friction falls at the joint of {}",
            ),
        },
    )


def motor_form(ratio: str, joint: str) -> Form:
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


def limit_forms(kind: str, unit: str, load: str) -> dict[str, Form]:
    """Compliant stops, hard ones, and limits alone."""
    ends = {
        "min": Key(
            kind,
            "where the joint ends below",
            unit,
            "none",
            symbol="qmin: where the joint of {} ends below",
        ),
        "max": Key(
            kind,
            "where it ends above; one of the two may be missing",
            unit,
            "none",
            symbol="qmax: where the joint of {} ends above",
        ),
    }
    stiffness = Key(
        "positive",
        "of the stop, which pushes and never pulls",
        f"{load}/{unit}",
        symbol="ke: stiffness of the stops of {}",
    )
    damping = Key(
        "amount",
        "of the stop, while it pushes",
        f"{load} s/{unit}",
        "0",
        symbol="de: damping of the stops of {}",
    )
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


def pull_keys(stiffness: str, load: str, way: str, unit: str) -> dict[str, Key]:
    """What tells the pull of a spring, one of three."""
    return {
        "stiffness": Key("amount", "0 for a damper alone", stiffness, ONE, symbol=STIFFNESS),
        "law": Key(
            "law",
            f"its pull in x, {way} ({unit}), and its rate v",
            load,
            ONE,
        ),
        "table": Key(
            "spring_table",
            "a CSV file of its pull: columns x and F, linear between rows",
            load,
            ONE,
        ),
    }


def joint_spring_form(free: str, kind: str, unit: str, load: str) -> Form:
    turns = f"; its {free} counts from turn to turn" if kind == "angle" else ""
    place = "angle" if kind == "angle" else "displacement"
    return Form(
        f"A spring and damper at a {JOINTS[kind != 'angle']} joint.",
        {
            "joint": Key("link_name", f"the link whose own joint it is{turns}"),
            **pull_keys(f"{load}/{unit}", load, "q less its free " + place, unit),
            "damping": Key("amount", DAMPER, f"{load} s/{unit}", "0", symbol=DAMPING),
            free: Key(
                kind, f"free {place} of the joint", unit, symbol=f"phi: free {place} of {{}}"
            ),
        },
        PULLS,
    )
