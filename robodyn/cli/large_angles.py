"""A note on angles beyond a turn that have no unit: 30 is in rad, and may be meant as degrees.

Options and the scene file are looked at, never the rows of tables, which may run over many turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

from robodyn.dynamics.joint_vectors import joint_units
from robodyn.elements.springs import JointSpring
from robodyn.errors import InputError
from robodyn.scene.constants import nodes_of
from robodyn.scene.expressions import COMPARISONS, names_of, number_of, walk
from robodyn.scene.quantities import NOTHING, entries, expressions, read_value, state_variables
from robodyn.scene.syntax import CONSTANTS, VALUE_CONSTANTS, Node, plain_text
from robodyn.scene.units import Quantity
from robodyn.tables.csv_fields import shown

if TYPE_CHECKING:
    from robodyn.mechanics.mechanism import Mechanism
    from robodyn.scene.scene_values import SceneValues

VECTORS = ("q", "from", "to", "hold", "at", "amplitude")  # options with angles of joints
# the command's options by the words of their flags; None with --quiet
options: ContextVar[Mapping[str, Any] | None] = ContextVar("options", default=None)
ALIKE = ("+", "-", "neg", "abs", "min", "max", "if", *COMPARISONS)  # of angles angles
MOST = 3  # places that are named


def tell_large_angles(mechanism: Mechanism, values: Callable[[], SceneValues]) -> None:
    """Write the note, one line, if an option or the scene has such an angle."""
    given = options.get()
    if given is None:
        return
    found = [*_in_options(mechanism, given, values), *_in_scene(mechanism, values)]
    if found:
        from robodyn.cli.output import note

        places = [shown(place) for place, _ in found[:MOST]] + ["..."] * (len(found) > MOST)
        text = found[0][1].strip()
        degrees = f"{text}deg" if text[-1:].isdigit() else f"({text}) deg"
        told = f"{', '.join(places)}: an angle without a unit is in rad"
        note(f"Note: {told}; write {degrees} for degrees")


def is_large(text: str, named: Mapping[str, Node] = NOTHING) -> bool:
    """Whether a value has no unit and no pi, and is beyond a turn in rad.

    `named` are constants of the scene; what is made of one is told where the constant is.
    """
    with suppress(ValueError):
        return _is_large(read_value(text, named).written)
    return False


def _is_large(number: Node) -> bool:
    """Return whether a tree is a plain number beyond a turn; False if it is no number."""
    plain = all(type(x) is tuple or (type(x) is float and x != math.pi) for x in walk(number))
    return plain and abs(number_of(number) or 0.0) > math.tau


def _in_options(
    mechanism: Mechanism, given: Mapping[str, Any], values: Callable[[], SceneValues]
) -> Iterator[tuple[str, str]]:
    """Yield options with large angles, and the angle's text."""
    for name in VECTORS:
        text = given.get(name)
        if not isinstance(text, str):  # --hold of `equilibrium` names links
            continue
        with suppress(InputError):  # which the command tells
            parts = entries(plain_text(text), "", "")
            units = joint_units(mechanism, len(parts), "q")
            large = [x for x, u in zip(parts, units, strict=True) if u == "rad" and is_large(x)]
            yield from ((f"--{name} {text}", x) for x in large[:1])
    for text in given.get("vary") or ():
        name, _, value = (part.strip() for part in text.partition("="))
        parts = value.split(":")[:2] if ":" in value else value.split(",")
        large = [x for x in parts if is_large(x)]
        if large and (name in _turning(mechanism) or _is_angle(values(), name)):
            yield f"--vary {text}", large[0]
    expressions = [("--until", given["until"])] if given.get("until") else []
    expressions += [("--event", text) for text in given.get("event") or ()]
    for flag, text in expressions:
        whole = text.partition("=")[2] if flag == "--event" else text
        yield from ((f"{flag} {text}", x) for x in _compared(mechanism, whole)[:1])


def _in_scene(mechanism: Mechanism, values: Callable[[], SceneValues]) -> Iterator[tuple[str, str]]:
    """Yield keys of the scene with large angles, and the angle's text."""
    scene = mechanism.description
    angles = [x.aligned for x in scene.closures]
    angles += [x.angle for x in scene.springs if isinstance(x, JointSpring)]
    angles += [end for x in scene.links if x.limits for end in (x.limits.low, x.limits.high)]
    angles += scene.start or ()
    if any(abs(x) > math.tau for x in angles if x is not None):
        numbers = values()
        named = nodes_of(scene.constants)
        for name in numbers.names:
            if _is_angle(numbers, name) and is_large(text := numbers.text(name), named):
                yield f"{mechanism.source}: {name} = {text}", text
    large = {x.joint for x in scene.couplings if abs(x.angle) > math.tau}
    if large - set(mechanism.slides):
        node = next(node for key, node in scene.written.tree.pairs if key.text == "couplings")
        for item, x in zip(getattr(node, "items", [node]), scene.couplings, strict=True):
            if x.law is not None:
                continue
            text = item.text.partition("=")[2]
            constants = {**VALUE_CONSTANTS, **nodes_of(scene.constants)}
            (found,) = expressions(text, state_variables(mechanism.n), constants)
            unit = any(isinstance(part, Quantity) for part in walk(found.written))
            if x.joint not in mechanism.slides and abs(x.angle) > math.tau and not unit:
                yield f"{mechanism.source}: {item.text}", f"{abs(x.angle):g}"


def _is_angle(values: SceneValues, name: str) -> bool:
    return name in values and values.unit(name) == "rad"


def _turning(mechanism: Mechanism) -> set[str]:
    """The angles among q1, q2, ..."""
    return {f"q{k + 1}" for k in range(mechanism.n) if k not in mechanism.slides}


def _compared(mechanism: Mechanism, text: str) -> list[str]:
    """Large numbers that an expression compares with, or takes from, angles of joints."""
    turning, found = {f"q{k}" for k in range(mechanism.n) if k not in mechanism.slides}, []

    def is_angle(side: Node) -> bool:
        names = names_of(side)
        alike = all(type(x) is not tuple or x[0] in ALIKE for x in walk(side))
        return bool(names) and names <= turning and alike

    with suppress(ValueError, ArithmeticError):  # which the command tells
        constants = {**CONSTANTS, **nodes_of(mechanism.description.constants)}
        for one in expressions(text, state_variables(mechanism.n, mechanism.slides), constants):
            for node in walk(one.written):
                if type(node) is tuple and node[0] in ("+", "-", *COMPARISONS):
                    _, left, right = node
                    for side, other in ((left, right), (right, left)):
                        if is_angle(side) and _is_large(other):
                            found.append(f"{abs(number_of(other) or 0.0):g}")
    return found
