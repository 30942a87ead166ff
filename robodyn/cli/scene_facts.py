"""What was read from a scene, for `robodyn check`: links, springs, loads in words and numbers."""

from __future__ import annotations

from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import FRAMES, Coupling, JointSpring, Moment, Point


def _place(mechanism: Mechanism, point: Point) -> str:
    at = f"({point.at.real:g}, {point.at.imag:g})"
    return f"ground {at}" if point.link is None else f"{mechanism.link_names[point.link]} {at}"


def links(mechanism: Mechanism) -> list[dict[str, object]]:
    """Every link, key by key."""
    return [
        {
            "name": link.name,
            "m": link.m,
            "l": link.l,
            "r": [link.r.real, link.r.imag],
            "I": link.I,
            "from": _place(mechanism, link.hangs_from),
            "payload": link.payload,
            "damping": link.damping,
            "friction": None
            if link.friction is None
            else {"torque": link.friction.torque, "speed": link.friction.speed},
        }
        for link in mechanism.description.links
    ]


def springs_and_loads(mechanism: Mechanism) -> dict[str, object]:
    """Springs, loads and couplings as the scene writes them; nothing where it has none."""
    names, found = mechanism.link_names, mechanism.description
    springs: list[dict[str, object]] = []
    for spring in found.springs:
        values = {"stiffness": spring.stiffness, "damping": spring.damping}
        if isinstance(spring, JointSpring):
            springs.append({"joint": names[spring.joint], "angle": spring.angle} | values)
        else:
            ends = [_place(mechanism, point) for point in (spring.first, spring.second)]
            springs.append({"between": ends, "length": spring.length} | values)
    loads: list[dict[str, object]] = []
    for item in found.loads:
        if isinstance(item, Moment):
            loads.append({"link": names[item.link], "torque": item.torque})
        else:
            place, force = _place(mechanism, item.point), [item.force.real, item.force.imag]
            frame = FRAMES[1] if item.turns else FRAMES[0]
            loads.append({"at": place, "force": force, "frame": frame})
    lists: dict[str, object] = {
        "springs": springs,
        "loads": loads,
        "couplings": [_equation(coupling) for coupling in found.couplings],
    }
    return {key: entries for key, entries in lists.items() if entries}


def force_facts(mechanism: Mechanism) -> list[list[str]]:
    """A label and a text for each spring, load and coupling."""
    found, names = mechanism.description, mechanism.link_names
    facts = []
    for k, spring in enumerate(found.springs, start=1):
        damped = f", damping {spring.damping:g}" if spring.damping else ""
        if isinstance(spring, JointSpring):
            text = f"joint {names[spring.joint]}: {spring.stiffness:g} N m/rad from "
            text += f"{spring.angle:g} rad{damped}{' N m s/rad' if damped else ''}"
        else:
            ends = [_place(mechanism, point) for point in (spring.first, spring.second)]
            text = f"{ends[0]} to {ends[1]}: {spring.stiffness:g} N/m, "
            text += f"length {spring.length:g} m{damped}{' N s/m' if damped else ''}"
        facts.append([f"spring {k}", text])
    for k, item in enumerate(found.loads, start=1):
        if isinstance(item, Moment):
            text = f"{item.torque:g} N m on {names[item.link]}"
        else:
            text = f"({item.force.real:g}, {item.force.imag:g}) N at "
            text += _place(mechanism, item.point) + (", turning with it" if item.turns else "")
        facts.append([f"load {k}", text])
    for k, coupling in enumerate(found.couplings, start=1):
        facts.append([f"coupling {k}", _equation(coupling, 6)])
    return facts


def _equation(coupling: Coupling, digits: int = 17) -> str:
    """q3 = -2 q1 + 0.1"""
    parts = [f"{ratio:+.{digits}g} q{k + 1}" for k, ratio in coupling.terms]
    if coupling.angle or not parts:
        parts.append(f"{coupling.angle:+.{digits}g}")
    later = "".join(f" {part[0]} {part[1:]}" for part in parts[1:])
    return f"q{coupling.joint + 1} = {parts[0].removeprefix('+')}{later}"
