"""The grammar of scene files: the forms of mappings that the records of a scene declare.

From it come the reader's checks (`description.py`), the JSON Schema (`scene_schema.py`), the names
of numbers that sweeps vary (`scene_values.py`), the text of a scene (`plain_scene.py`) and the
guide's tables of keys.

A kind is that of a value: one of those below, one of `MAPPINGS`, or one that the reader has a
method for and the schema a definition.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable

from robodyn.elements import kinds
from robodyn.elements.joints import CURVES
from robodyn.elements.keys import BY_DIRECTION, NEEDED, ONES, TOGETHER, Declared, Key, Way
from robodyn.elements.values import FRAMES, Point, Table
from robodyn.scene.drawn_keys import DrawnLink, DrawnScene, DrawnWeld, GroundLine, Slot
from robodyn.scene.scene import (
    BRANCHES,
    JOINTS,
    Cam,
    Closure,
    Description,
    Face,
    Line,
    Link,
    Motor,
    Weld,
)


class Form:
    """A way to write a record as a mapping.

    `names` are those of its keys, by fields; a file must have exactly one key of each group `one`,
    and of the groups `together` one of each, or none of all.
    """

    def __init__(self, made: type[Declared], way: Way) -> None:
        self.made, self.way = made, way
        self.keys: dict[str, Key] = made.keys_of(way)  # by their names
        self.names = {key.field: name for name, key in self.keys.items()}
        self.needed = [name for name, key in self.keys.items() if key.needed]
        self.optional = [name for name, key in self.keys.items() if not key.needed]
        self.absent = {  # what stands where a file leaves them out, by fields
            key.field: None if key.value is NEEDED else key.value
            for key in self.keys.values()
            if not key.needed
        }
        groups = [tuple(name for name, key in self.keys.items() if key.told == one) for one in ONES]
        self.one = tuple(filter(None, groups[:1]))
        alone = [(name,) for name, key in self.keys.items() if key.told == TOGETHER]
        self.together = (*alone, *filter(None, groups[1:])) if alone else ()
        self.has_joint = "joint" in made._fields and "joint" not in self.names
        self.sided = [x.name for x in made.keys.values() if isinstance(x.name, tuple)]


NUMBERS = {  # and their limits
    "number": "",
    "angle": "",
    "amount": ">= 0",
    "positive": "> 0",
    "nonzero": "not 0",
    "part": "in [0, 1]",
}
KEEPS: dict[str, Callable[[float], bool]] = {
    ">= 0": lambda x: x >= 0.0,
    "> 0": lambda x: x > 0.0,
    "not 0": lambda x: x != 0.0,
    "in [0, 1]": lambda x: 0.0 <= x <= 1.0,
}
WORDS = {"branch": BRANCHES, "frame": FRAMES, "joint_kind": JOINTS, "curve": CURVES}
BY_JOINT = "rad or m"  # as the joint turns or slides
WITH_UNIT = (
    "vector",
    "varying",
    "varying_vector",
    "varying_place",
    "law",
    "gravity",
)  # beside numbers
OR_VECTOR = {"centre": "amount"}  # a number of this kind, or [x, y]
OR_PAIR = {BY_DIRECTION: "amount"}  # a number of this kind, or two
OTHERS: tuple[type[Declared], ...] = (
    Description,
    Link,
    Weld,
    Motor,
    Point,
    Closure,
    Line,
    Cam,
    Face,
    Table,
    DrawnScene,
    DrawnWeld,
    DrawnLink,
    GroundLine,
    Slot,
)

FORMS: dict[str, Form] = {}
# The forms of a mapping of this kind: that is meant all of whose marks stand there, of several the
# one with the most marks; the last has none.
MAPPINGS: dict[str, list[Form]] = {}


def declare(records: Iterable[type[Declared]]) -> None:
    """Take the forms of these records, and of no others, as those of scenes."""
    FORMS.clear()
    MAPPINGS.clear()
    for record in records:
        for way in record.ways:
            form = FORMS[way.name] = Form(record, way)
            MAPPINGS.setdefault(way.among, []).append(form)
    for forms in MAPPINGS.values():
        forms.sort(key=lambda form: -len(form.way.marks))


declare((*OTHERS, *kinds.KINDS))


def form_of(kind: str, keys: Container[str]) -> Form:
    """The form of a mapping of this kind that has these keys."""
    return next(form for form in MAPPINGS[kind] if all(x in keys for x in form.way.marks))


def excluded(kind: str, keys: Container[str]) -> dict[str, str]:
    """The keys that tell other forms of this kind, each with that which tells the form of these."""
    own = form_of(kind, keys)
    others = (form.way.marks for form in MAPPINGS[kind] if form is not own)
    return {x: y for marks in others for x in marks for y in own.way.marks[:1]}


def key_table(form: str) -> str:
    """The rows of the guide's table of a form: key, unit, value and default."""
    rows = []
    for name, key in FORMS[form].keys.items():
        limit = NUMBERS.get(str((OR_VECTOR | OR_PAIR).get(key.kind, key.kind)), "")
        told = f"{key.help}, {limit}" if limit else key.help
        rows.append(f"| `{name}` | {key.unit} | {told} | {key.shown_default} |")
    return "\n".join(rows).replace("|  |", "| |")
