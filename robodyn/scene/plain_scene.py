"""A scene as the mapping that a file of it would hold: numbers in SI units and radians, and names.

Read again it gives an equal description.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from robodyn.elements.base import Element
from robodyn.elements.keys import Declared, Key
from robodyn.elements.values import FRAMES, Curve, Law, Point, Signal, Table, told
from robodyn.scene.constants import Constants
from robodyn.scene.grammar import FORMS, NUMBERS, Form
from robodyn.scene.quantities import is_plain
from robodyn.scene.scene import Closure, Coupling, Description


def plain_scene(description: Description) -> dict[str, Any]:
    """The mapping of a scene file, as JSON has it."""
    scene = description.apart or description
    return _Writer(scene).mapping(scene)


class _Writer:
    """Writes the values of a scene; a method each for the kinds of values that need one."""

    def __init__(self, description: Description) -> None:
        self.links = description.links
        self.bodies = description.bodies

    def mapping(self, record: Declared, joint: int | None = None) -> dict[str, Any]:
        """The mapping of a record; of what stands at a joint, that joint's keys."""
        if isinstance(record, Element) and joint is None:
            joint = record.at
        slides = joint is not None and self.links[joint].slides
        if isinstance(record, Closure):
            slides = record.along is not None
        values = record.to_keys()
        form = _form_of(record, values, slides)
        return {
            name: self.value(key, values[key.field], joint)
            for name, key in form.keys.items()
            if _stands(key, values.get(key.field))
        }

    def value(self, key: Key, value: Any, joint: int | None = None) -> Any:
        """The value of a key."""
        if key.listed:
            one, each = key._replace(listed=False), enumerate(value)
            if key.kind == "link":
                joints = {link.name: k for k, link in enumerate(self.links)}
                return [self.mapping(link, joints.get(link.name)) for _, link in each]
            return [self.value(one, x) for _, x in each]
        if key.kind in NUMBERS:
            return value
        write = getattr(self, key.kind, None)
        if write is not None:
            return write(value)
        return self.mapping(value, joint) if isinstance(value, Declared) else value

    # -- numbers -------------------------------------------------------------------------------

    def vector(self, z: complex) -> list[float]:
        return [z.real, z.imag]

    direction = vector

    def gravity(self, z: complex | tuple[float | Signal, ...]) -> float | list[Any]:
        if isinstance(z, tuple):
            return [self.varying(part) for part in z]
        return self.vector(z) if z.real else -z.imag

    def centre(self, z: complex) -> float | list[float]:
        return self.vector(z) if z.imag or z.real < 0.0 else z.real

    def truth(self, value: bool) -> bool:
        return value

    def by_direction(self, amount: float | tuple[float, float]) -> float | list[float]:
        return list(amount) if isinstance(amount, tuple) else amount

    def frame(self, turns: bool) -> str:
        return FRAMES[turns]

    def constants(self, constants: Constants) -> dict[str, str | float]:
        return {name: x.value if is_plain(x.text) else x.text for name, x in constants}

    # -- names and points ----------------------------------------------------------------------

    def link_name(self, link: int) -> str:
        return self.bodies[link].name

    joint_name = link_name

    def joints(self, joints: tuple[int, ...]) -> list[str]:
        return [self.links[k].name for k in joints]

    def assembly(self, words: tuple[str, ...]) -> list[str]:
        return list(words)

    def start(self, angles: tuple[float | None, ...]) -> dict[str, float]:
        names = (link.name for link in self.links)
        return {name: x for name, x in zip(names, angles, strict=True) if x is not None}

    def point(self, point: Point) -> str | dict[str, Any] | list[float]:
        if point.link is None:
            return self.vector(point.at)
        link = self.bodies[point.link]
        return link.name if point.at == link.l else self.mapping(point)

    moving_point = point

    def points(self, points: tuple[tuple[str, Point], ...]) -> dict[str, Any]:
        return {name: self.point(point) for name, point in points}

    def pair(self, points: tuple[Point, Point]) -> list[Any]:
        return [self.point(point) for point in points]

    def closure(self, closure: Closure) -> list[Any] | dict[str, Any]:
        if closure.along is None and closure.friction is None:
            return self.pair((closure.first, closure.second))
        return self.mapping(closure)

    def couplings(self, couplings: tuple[Coupling, ...]) -> list[str | dict[str, Any]]:
        return [self._coupling(x) for x in couplings]

    def _coupling(self, coupling: Coupling) -> str | dict[str, Any]:
        law = coupling.law
        if isinstance(law, Curve):
            over = law.over if law.over == "t" else f"q{int(law.over[1:]) + 1}"
            joint = self.links[coupling.joint].name
            found: dict[str, Any] = {
                "joint": joint,
                "table": law.file,
                "over": over,
                "column": law.column,
            }
            found |= {"period": law.x[-1] - law.x[0]} if law.repeats else {}
            return found if coupling.cam is None else found | {"cam": self.mapping(coupling.cam)}
        text = f"q{coupling.joint + 1} = {_right_side(coupling)}"
        if coupling.cam is None:
            return text
        return {"law": text, "cam": self.mapping(coupling.cam)}

    # -- what varies ---------------------------------------------------------------------------

    def law(self, law: Law) -> str:
        return told(law)

    def spring_table(self, table: Table) -> str:
        return told(table)

    def varying(self, value: float | Signal) -> Any:
        if isinstance(value, Table):
            over = value.over if value.over == "t" else f"q{int(value.over[1:]) + 1}"
            return self.mapping(value._replace(over=over))
        return told(value) if isinstance(value, Law) else value

    def varying_place(self, parts: list[float | Signal]) -> list[Any]:
        return self.varying_vector(parts)

    def varying_vector(self, parts: list[float | Signal]) -> list[Any]:
        return [self.varying(part) for part in parts]


def _right_side(coupling: Coupling) -> str:
    return " + ".join(_terms(coupling)) if coupling.law is None else coupling.law.text


def _terms(coupling: Coupling) -> Iterator[str]:
    yield from (f"{ratio!r}*q{k + 1}" for k, ratio in coupling.terms)
    if coupling.angle or not coupling.terms:
        yield repr(coupling.angle)


def _stands(key: Key, value: Any) -> bool:
    """Whether a file must say this value."""
    return value not in (None, ()) and (key.one or value not in (key.value, key.told))


def _form_of(record: Declared, values: dict[str, Any], slides: bool) -> Form:
    """The form that has all values, and whose marks all have one."""
    given = {field for field, value in values.items() if value is not None}
    forms = (FORMS[way.name] for way in record.ways)
    fits = (
        form
        for form in forms
        if form.way.slides == slides and {form.keys[x].field for x in form.way.marks} <= given
    )
    return next(fits)
