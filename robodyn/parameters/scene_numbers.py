"""The numbers of a scene that the torques depend on linearly, or through the centre of gravity.

`links.forearm.m`, `.r` (`.r[0]`, `.r[1]`), `.I`, `.payload`, `.damping`, `.friction.torque`,
`.motor.inertia`, .., `springs[0].stiffness`: what data of torques tell.  Each has a place in the
description: names and indices that lead to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from robodyn.engines.expression import Graph
from robodyn.engines.planar_numbers import Planar
from robodyn.engines.tangents import slopes_by, substituted
from robodyn.errors import InputError
from robodyn.parameters.linear_parameters import INERTIAL, linear_parameters, with_formulas
from robodyn.scene.scene import Description, JointSpring, Spring
from robodyn.scene.scene_values import SceneValues
from robodyn.scene.yaml_values import nearest
from robodyn.tables.arrays import Array

Place = tuple[str | int, ...]

ROUNDED = 1e-12  # that numbers without noise are off by
LEAST = 1e-9  # of a mass or an inertia, beside the scene's largest, that counts as positive


class Number(NamedTuple):
    """A number of a scene: where it stands, its unit, and the least that a body can have there.

    Those that are `alone` make up pi: they are fitted where no names are given.  One that adds to
    a `parameter`, as it is, names that.
    """

    place: Place
    unit: str
    least: float = 0.0
    alone: bool = True
    parameter: str = ""


def numbers(description: Description) -> dict[str, Number]:
    """All of them by name."""
    found: dict[str, Number] = {}
    most = {key: max(getattr(x, key) for x in description.links) or 1.0 for key in ("m", "I")}
    for k, link in enumerate(description.links):
        at: Place = ("links", k)
        i = k + 1
        force, damping = ("N", "N s/m") if link.slides else ("N m", "N m s/rad")
        own = {
            "m": Number((*at, "m"), "kg", LEAST * most["m"]),
            "I": Number((*at, "I"), "kg m²", LEAST * most["I"]),
            "payload": Number((*at, "payload"), "kg", alone=False),
            "damping": Number((*at, "damping"), damping, parameter=f"d{i}"),
            "r": Number((*at, "r", "real"), "m", -np.inf, alone=False),
            "r[0]": Number((*at, "r", "real"), "m", -np.inf),
            "r[1]": Number((*at, "r", "imag"), "m", -np.inf),
        }
        if link.friction is not None:
            key = "friction.force" if link.slides else "friction.torque"
            own[key] = Number((*at, "friction", "torque"), force, parameter=f"f{i}")
        if hasattr(link.friction, "static"):
            static = (*at, "friction", "static")
            own["friction.static"] = Number(static, force, parameter=f"fs{i}")
        if link.motor is not None:
            rotor = (*at, "motor", "inertia")
            own["motor.inertia"] = Number(rotor, "kg m²", parameter=f"Jr{i}")
            own["motor.damping"] = Number((*at, "motor", "damping"), "N m s/rad", alone=False)
        for prefix in (f"links.{link.name}", f"links[{k}]"):
            found |= {f"{prefix}.{key}": number for key, number in own.items()}
    for i, spring in enumerate(description.springs):
        turns = not isinstance(spring, Spring)
        where, metre = ("springs", i), "m"
        if isinstance(spring, JointSpring) and not description.links[spring.joint].slides:
            metre = "rad"
        force = "N m" if metre == "rad" else "N"
        if spring.law is None:
            pull = (*where, "stiffness")
            name = f"springs[{i}].stiffness"
            found[name] = Number(pull, f"{force}/{metre}", parameter=f"k{i + 1}")
        if spring.damping or (spring.law is None and turns):
            unit, name = f"{force} s/{metre}", "" if turns else f"ds{i + 1}"
            damper = Number((*where, "damping"), unit, alone=not turns, parameter=name)
            found[f"springs[{i}].damping"] = damper
    return found


def number_called(description: Description, name: str) -> Number:
    """The number of this name; InputError for one that torques do not tell."""
    known = numbers(description)
    if name not in known:
        named = [x for x in known if not x.startswith("links[")]
        limit = "is no mass, moment, damping, friction or stiffness of the scene"
        raise InputError(name, where=description.source, limit=limit + nearest(name, named))
    return known[name]


def number_at(value: Any, place: Place) -> float:
    """What stands there."""
    for step in place:
        value = value[step] if isinstance(step, int) else getattr(value, step)
    return float(value)


def replaced(value: Any, place: Place, number: Any) -> Any:
    """The same with another number, or entry, there."""
    if not place:
        return number
    step, rest = place[0], place[1:]
    if isinstance(value, complex | Planar):
        both = (number, value.imag) if step == "real" else (value.real, number)
        return type(value)(*both)
    if isinstance(step, int):
        return (*value[:step], replaced(value[step], rest, number), *value[step + 1 :])
    return value._replace(**{step: replaced(getattr(value, step), rest, number)})


def with_numbers(description: Description, where: Sequence[Place], numbers: Array) -> Description:
    """The description with these numbers there."""
    for place, number in zip(where, numbers.tolist(), strict=True):
        description = replaced(description, place, number)
    return description


def values_of(description: Description) -> Array:
    """pi of a description."""
    return np.array([x.value for x in linear_parameters(description)])


def slopes(description: Description, where: Sequence[Place]) -> Array:
    """d pi by the numbers there, (p, k)."""
    graph, scene = Graph(), with_formulas(description)
    names = [f"p{k}" for k in range(len(where))]
    for place, name in zip(where, names, strict=True):
        scene = replaced(scene, place, number_at(description, place) + graph.variable(name))
    pi: list[Any] = [x.value for x in linear_parameters(scene)]
    found = substituted(slopes_by(pi, names), dict.fromkeys(names, 0.0))
    return np.array(found, float).reshape(len(pi), len(where))


def own_numbers(description: Description) -> dict[str, Number]:
    """Those that make up pi, each once: what is fitted where no names are given."""
    known = numbers(description).items()
    return {name: x for name, x in known if x.alone and not name.startswith("links[")}


def from_parameters(description: Description, names: Sequence[str], pi: Array) -> Description:
    """The description whose parameters are pi: payloads, and dampers beside joints, stay.

    The names are those of `linear_parameters`.
    """
    now = dict(zip(names, pi.tolist(), strict=True))
    before = {x.name: x.value for x in linear_parameters(description)}
    made = description
    for number in own_numbers(description).values():
        if (name := number.parameter) in now:
            value = number_at(description, number.place) + (now[name] - before[name])
            made = replaced(made, number.place, value)
    for k, link in enumerate(made.links):
        parts = [f"{x}{k + 1}" for x in INERTIAL]
        if any(now[name] != before[name] for name in parts):
            mass, x, y, J = (now[name] for name in parts)
            m = mass - link.payload
            r = (complex(x, y) - link.l * link.payload) / m if m else link.r
            inertia = J - link.payload * link.l**2 - m * abs(r) ** 2
            made = replaced(made, ("links", k), link._replace(m=m, r=r, I=inertia))
    return made


def checked(description: Description) -> tuple[Description, tuple[str, ...]]:
    """The description without what rounding made negative; why it is no scene, if it is none."""
    faults = []
    for name, (place, *_) in own_numbers(description).items():
        number = number_at(description, place)
        if place[-1] in ("real", "imag") or number >= 0.0:
            continue
        if number > -ROUNDED:
            description = replaced(description, place, 0.0)
        else:
            faults.append(f"{name} = {number:.6g}")
    return description, tuple(faults)


def changes(
    before: Description, after: Description, known: SceneValues
) -> dict[str, float | Sequence[float]]:
    """What must be written in the file, whose numbers are `known`, to make `after` of `before`."""
    found: dict[str, float | Sequence[float]] = {}
    for name, (place, *_) in numbers(before).items():
        if name.startswith("links[") or name.endswith("]"):
            continue
        number = number_at(after, place)
        if not name.endswith(".r"):
            if number != number_at(before, place):
                found[name] = number
            continue
        r = after.links[int(place[1])].r
        if r == before.links[int(place[1])].r:
            continue
        if f"{name}[0]" in known:
            found |= {f"{name}[0]": r.real, f"{name}[1]": r.imag}
        else:
            alone = abs(r.imag) <= ROUNDED * abs(r) and r.real >= 0.0
            found[name] = r.real if alone else (r.real, r.imag)
    return found
