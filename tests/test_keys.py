"""A key that a class declares is in the reader, the schema, `--set`, equations and tables."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest
import yaml
from jsonschema import Draft202012Validator

from robodyn.elements import kinds
from robodyn.elements.keys import Way, key
from robodyn.elements.springs import JointSpring
from robodyn.equations.parameters import Parameters
from robodyn.errors import DescriptionError
from robodyn.mechanics.mechanism import build
from robodyn.scene import grammar
from robodyn.scene.description import _Reader, from_text
from robodyn.scene.drawn_keys import DrawnLink, DrawnScene, DrawnWeld, GroundLine, Slot
from robodyn.scene.plain_scene import _Writer, plain_scene
from robodyn.scene.rewrite import rewritten
from robodyn.scene.scene_schema import scene_schema
from robodyn.scene.scene_values import SceneValues

DRAWN = DrawnScene, DrawnLink, DrawnWeld, GroundLine, Slot
TEXT = """\
links:
  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1}
springs:
  - {joint: a, stiffness: 5, angle: 0.2, preload: 300 N mm}  # a comment
"""


class Preloaded(JointSpring):
    """A spring at a joint with a key more."""

    preload: float = key(
        "amount",
        "torque where it is free",
        unit=("N m", "N"),
        default=0.0,
        symbol="tp: preload of {}",
    )
    least: float | None = key("positive", "least torque", unit=("N m", "N"), default=None)

    ways: ClassVar[tuple[Way, ...]] = JointSpring.ways


@pytest.fixture(autouse=True)
def declared() -> Iterator[None]:
    """Scenes whose springs at joints have the key."""
    others = [Preloaded if kind is JointSpring else kind for kind in kinds.KINDS]
    grammar.declare((*grammar.OTHERS, *others))
    yield
    grammar.declare((*grammar.OTHERS, *kinds.KINDS))


def spring(text: str = TEXT) -> Preloaded:
    (found,) = from_text(text, "my.yaml").springs
    assert isinstance(found, Preloaded)
    return found


def test_the_reader_reads_it() -> None:
    assert spring() == Preloaded(0, 5.0, 0.2, preload=0.3)
    assert spring(TEXT.replace(", preload: 300 N mm", "")).preload == 0.0
    assert spring().least is None


@pytest.mark.parametrize(
    ("new", "fault"),
    [
        ("preload: -1", "4: springs[0].preload = -1: must be >= 0"),
        ("preload: 3 kg", "4: springs[0].preload = 3 kg: must be in N m, not in kg"),
        ("preload: yes", "4: springs[0].preload = yes: must be a number"),
        ("preload: [1]", "4: springs[0].preload = a list: must be a number"),
        ("prelaod: 1", "4: springs[0].prelaod: is an unknown key; did you mean preload?"),
        ("preload: 1, preload: 2", "4: springs[0].preload: is given twice"),
        ("least: 0", "4: springs[0].least = 0: must be > 0"),
    ],
)
def test_the_reader_tells_its_faults(new: str, fault: str) -> None:
    with pytest.raises(DescriptionError) as error:
        from_text(TEXT.replace("preload: 300 N mm", new), "my.yaml")
    assert f"my.yaml:{fault}" in str(error.value)


def test_all_faults_are_told_at_once() -> None:
    text = TEXT.replace("stiffness: 5", "stiffness: x").replace("300 N mm", "-2, least: -1")
    with pytest.raises(DescriptionError) as error:
        from_text(text, "my.yaml")
    assert [x.place for x in error.value.faults] == [
        f"springs[0].{name}" for name in ("stiffness", "preload", "least")
    ]


def test_the_schema_has_it() -> None:
    schema = scene_schema()
    for form, unit in ("joint_spring", "N m"), ("slide_spring", "N"):
        told = schema["$defs"][form]["properties"]["preload"]["description"]
        assert told == f"Torque where it is free, {unit}. Default: 0."
    validator = Draft202012Validator(schema)
    assert validator.is_valid(yaml.safe_load(TEXT))
    assert not validator.is_valid(yaml.safe_load(TEXT.replace("300 N mm", "-1")))
    assert not validator.is_valid(yaml.safe_load(TEXT.replace("300 N mm", "3 kgs")))


@pytest.mark.parametrize("text", [TEXT, TEXT.replace(", preload: 300 N mm", "")])
def test_it_is_a_number_of_the_scene(text: str) -> None:
    values, name = SceneValues(text, "my.yaml"), "springs[0].preload"
    assert name in values.names
    assert values.unit(name) == "N m"
    assert values.number(name) == spring(text).preload
    (new,) = values.replaced({name: 0.7}).springs
    assert new == spring(text)._replace(preload=0.7)


@pytest.mark.parametrize("text", [TEXT, TEXT.replace(", preload: 300 N mm", "")])
def test_it_is_replaced_in_the_text(text: str) -> None:
    new = rewritten(text, "my.yaml", {"springs[0].preload": 0.7})
    assert new == TEXT.replace("300 N mm", "0.7")


def test_it_is_written_and_shown() -> None:
    written = plain_scene(from_text(TEXT, "my.yaml"))
    assert written["springs"] == [{"joint": "a", "stiffness": 5.0, "angle": 0.2, "preload": 0.3}]
    assert from_text(yaml.safe_dump(written), "my.yaml") == from_text(TEXT, "my.yaml")
    assert "preload=0.3" in repr(spring())


def test_it_is_a_symbol_of_equations() -> None:
    symbol = Parameters(build(from_text(TEXT, "my.yaml"))).known["tp1"]
    assert (symbol.value, symbol.unit) == (0.3, "N m")
    assert symbol.meaning == "preload of spring 1, at the joint of a"


def test_it_is_in_the_table_of_the_guide() -> None:
    row = "| `preload` | N m | torque where it is free, >= 0 | 0 |"
    assert row in grammar.key_table("joint_spring")


def kinds_of_values() -> list[str]:
    """The kinds of the values of all keys of scenes that are not drawn."""
    forms = (form for form in grammar.FORMS.values() if form.made not in DRAWN)
    return sorted({str(key.kind) for form in forms for key in form.keys.values()})


@pytest.mark.parametrize("kind", kinds_of_values())
def test_each_kind_of_value_is_read_written_and_described(kind: str) -> None:
    """A table of the grammar has it, or a method of its name; and the schema defines it."""
    known = {**grammar.NUMBERS, **grammar.WORDS, **grammar.OR_VECTOR, **grammar.MAPPINGS}
    known |= grammar.OR_PAIR
    assert kind in known or hasattr(_Reader, kind)
    assert kind in known or hasattr(_Writer, kind) or kind == "name"
    assert kind in scene_schema()["$defs"]


def test_no_key_is_named_twice_in_a_mapping() -> None:
    """Neither in one form, nor are two forms of a mapping told by the same keys."""
    for forms in grammar.MAPPINGS.values():
        assert len({form.way.marks for form in forms}) == len(forms)
    for form in grammar.FORMS.values():
        assert len(form.names) == len(form.keys)
