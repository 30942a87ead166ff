"""The grammar of scene files: the forms of mappings that the records of a scene declare.

From it come the reader's checks (`description.py`), the JSON Schema (`scene_schema.py`), the names
of numbers that sweeps vary (`scene_values.py`), the text of a scene (`plain_scene.py`) and the
guide's tables of keys.

A kind is that of a value: one of those below, one of `MAPPINGS`, or one that the reader has a
method for and the schema a definition.
"""

from __future__ import annotations

from collections.abc import Container, Iterable

from robodyn.elements import kinds
from robodyn.elements.keys import Declared, Key, Way
from robodyn.elements.values import FRAMES, Point, Table
from robodyn.scene.scene import BRANCHES, JOINTS, Closure, Description, Line, Link, Motor
from robodyn.tables.records import Record


class Form(Record):
    """A way to write a record as a mapping, with its keys by their names."""

    way: Way
    made: type[Declared]  # the record
    keys: dict[str, Key]

    @property
    def one(self) -> tuple[str, ...]:
        """The keys of which a file must have exactly one."""
        return tuple(name for name, key in self.keys.items() if key.one)

    @property
    def names(self) -> dict[str, str]:
        """The names of the keys, by fields."""
        return {key.field: name for name, key in self.keys.items()}

    def named(self, needed: bool) -> list[str]:
        """The keys that a file must have, or the others."""
        return [name for name, key in self.keys.items() if key.needed == needed]


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
OTHERS: tuple[type[Declared], ...] = (Description, Link, Motor, Point, Closure, Line, Table)

FORMS: dict[str, Form] = {}
# The forms of a mapping of this kind, by the keys that tell them; the last has none.
MAPPINGS: dict[str, list[Form]] = {}


def declare(records: Iterable[type[Declared]]) -> None:
    """Take the forms of these records, and of no others, as those of scenes."""
    FORMS.clear()
    MAPPINGS.clear()
    for record in records:
        for way in record.ways:
            form = FORMS[way.name] = Form(way, record, record.keys_of(way))
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
