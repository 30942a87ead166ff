"""The numbers of a scene that the torques depend on linearly, or through the centre of gravity.

`links.forearm.m`, `.r` (`.r[0]`, `.r[1]`), `.I`, `.payload`, `.damping`, `.friction.torque`,
`.motor.inertia`, .., `springs[0].stiffness`: what data of torques tell.  Each has a place in the
description: names and indices that lead to it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from robodyn.engines.expression import Graph
from robodyn.engines.planar_numbers import Planar
from robodyn.engines.tangents import slopes_by, substituted
from robodyn.errors import InputError
from robodyn.parameters.linear_parameters import linear_parameters, with_formulas
from robodyn.scene.scene import Description, Spring
from robodyn.scene.scene_values import SceneValues
from robodyn.scene.yaml_values import nearest
from robodyn.tables.arrays import Array

Place = tuple[str | int, ...]

POSITIVE = ("m", "I")  # of a body; all others but r are not negative
ROUNDED = 1e-12  # that numbers without noise are off by
LEAST = 1e-9  # of a mass or an inertia, beside the scene's largest, that counts as positive


def places(description: Description) -> dict[str, Place]:
    """All of them by name."""
    return dict(_places(description))


def _places(description: Description) -> Iterator[tuple[str, Place]]:
    for k, link in enumerate(description.links):
        for prefix in (f"links.{link.name}", f"links[{k}]"):
            at: Place = ("links", k)
            for key in ("m", "I", "payload", "damping"):
                yield f"{prefix}.{key}", (*at, key)
            yield f"{prefix}.r", (*at, "r", "real")
            yield f"{prefix}.r[0]", (*at, "r", "real")
            yield f"{prefix}.r[1]", (*at, "r", "imag")
            if link.friction is not None:
                key = "force" if link.slides else "torque"
                yield f"{prefix}.friction.{key}", (*at, "friction", "torque")
                if hasattr(link.friction, "static"):
                    yield f"{prefix}.friction.static", (*at, "friction", "static")
            if link.motor is not None:
                yield f"{prefix}.motor.inertia", (*at, "motor", "inertia")
                yield f"{prefix}.motor.damping", (*at, "motor", "damping")
    for i, spring in enumerate(description.springs):
        if spring.law is None:
            yield f"springs[{i}].stiffness", ("springs", i, "stiffness")
        if spring.damping or (spring.law is None and not isinstance(spring, Spring)):
            yield f"springs[{i}].damping", ("springs", i, "damping")


def place_of(description: Description, name: str) -> Place:
    """The place of the number of this name; InputError for one that torques do not tell."""
    known = places(description)
    if name not in known:
        named = [x for x in known if not x.startswith("links[")]
        limit = "is no mass, moment, damping, friction or stiffness of the scene"
        raise InputError(name, where=description.source, limit=limit + nearest(name, named))
    return known[name]


def unit_of(description: Description, place: Place) -> str:
    """The unit of the number there."""
    key, units = place[-1], {x.name: x.unit for x in linear_parameters(description)}
    if key in ("real", "imag"):
        return "m"
    i = int(place[1]) + 1
    if place[0] == "springs":
        letter = "k" if key == "stiffness" else "ds"
        return units.get(f"{letter}{i}", "N m s/rad")
    if place[-2:] == ("motor", "damping"):
        return "N m s/rad"
    names = {"I": "J", "payload": "m", "inertia": "Jr", "damping": "d"}
    names |= dict.fromkeys(("torque", "static"), "f")
    return units[f"{names.get(str(key), str(key))}{i}"]


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


def least_of(description: Description, place: Place) -> float:
    """The least that a body can have there: more than nothing of mass and inertia."""
    if place[-1] in ("real", "imag"):
        return -np.inf
    if place[-1] not in POSITIVE or len(place) > 3:
        return 0.0
    most = max(number_at(link, place[2:]) for link in description.links)
    return LEAST * (most or 1.0)


def all_places(description: Description) -> dict[str, Place]:
    """Those that make up pi, each once: what is fitted where no names are given."""
    found: dict[Place, str] = {}
    for name, place in _places(description):
        doubled = place[-1] == "payload" or place[-2:] == ("motor", "damping")
        turned = place[0] == "springs" and place[-1] == "damping"
        if turned and not isinstance(description.springs[int(place[1])], Spring):
            doubled = True
        if not doubled and not name.startswith("links[") and not name.endswith(".r"):
            found.setdefault(place, name)
    return {name: place for place, name in found.items()}


def from_parameters(description: Description, names: Sequence[str], pi: Array) -> Description:
    """The description whose parameters are pi: payloads, and dampers beside joints, stay.

    The names are those of `linear_parameters`.
    """
    now = dict(zip(names, pi.tolist(), strict=True))
    before = {x.name: x.value for x in linear_parameters(description)}
    made = description
    for k, link in enumerate(description.links):
        i = k + 1
        m = now[f"m{i}"] - link.payload
        first = complex(now[f"mx{i}"], now[f"my{i}"]) - link.l * link.payload
        r = first / m if m else link.r
        changed = {
            "m": m,
            "r": r,
            "I": now[f"J{i}"] - link.payload * link.l**2 - m * abs(r) ** 2,
            "damping": link.damping + now[f"d{i}"] - before[f"d{i}"],
        }
        same = all(now[f"{x}{i}"] == before[f"{x}{i}"] for x in ("m", "mx", "my", "J"))
        if same:
            changed = {"damping": changed["damping"]}
        if link.friction is not None:
            changed["friction"] = link.friction._replace(torque=now[f"f{i}"])
            if f"fs{i}" in now:
                changed["friction"] = changed["friction"]._replace(static=now[f"fs{i}"])
        if link.motor is not None:
            changed["motor"] = link.motor._replace(inertia=now[f"Jr{i}"])
        made = replaced(made, ("links", k), link._replace(**changed))
    for i, spring in enumerate(description.springs, start=1):
        keys = (("stiffness", f"k{i}"), ("damping", f"ds{i}"))
        changed = {key: now[name] for key, name in keys if name in now}
        made = replaced(made, ("springs", i - 1), spring._replace(**changed))
    return made


def checked(description: Description) -> tuple[Description, tuple[str, ...]]:
    """The description without what rounding made negative; why it is no scene, if it is none."""
    faults = []
    for name, place in all_places(description).items():
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
    for name, place in _places(before):
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
