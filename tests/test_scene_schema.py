"""The scene's JSON Schema: it accepts what robodyn accepts, and knows the same keys."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import yaml
from documents import PAGES, ROOT
from good_scenes import ARM, EVERYTHING, LOOP
from jsonschema import Draft202012Validator
from named_case import case
from test_drawn import Linkage

from random_mechanisms import LOOPS, forced, seeded_scene, seeded_tree
from robodyn.errors import DescriptionError
from robodyn.scene.description import from_text
from robodyn.scene.grammar import FORMS, MAPPINGS, key_table
from robodyn.scene.scene_schema import scene_schema

SCHEMA = scene_schema()
VALIDATOR = Draft202012Validator(SCHEMA)


class Loader(yaml.SafeLoader):
    """YAML 1.2, as editors read it: 1e-3 is a number, and `on` a word."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012


NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$")
Loader.add_implicit_resolver("tag:yaml.org,2002:float", NUMBER, list("-+.0123456789"))
Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile("true$|false$"), list("tf"))
Loader.add_implicit_resolver("tag:yaml.org,2002:null", re.compile("$|~$|null$"), ["~", "n", ""])


def obeys(text: str) -> bool:
    """Whether the scene obeys the schema."""
    return bool(VALIDATOR.is_valid(yaml.load(text, Loader)))


def test_it_is_a_schema() -> None:
    """Every keyword is one that validators know; others they would pass over."""
    Draft202012Validator.check_schema(SCHEMA)
    known = {*Draft202012Validator.VALIDATORS, "$schema", "$defs", "title", "description"}
    known |= {"then", "else"}

    def check(schema: Any) -> None:
        if not isinstance(schema, dict):  # false: nothing more
            return
        assert schema.keys() <= known
        parts = [x for key in ("$defs", "properties") for x in schema.get(key, {}).values()]
        parts += [x for key in ("anyOf", "allOf", "oneOf") for x in schema.get(key, [])]
        parts += schema.get("dependentSchemas", {}).values()
        single = {"not", "items", "contains", "additionalProperties", "if", "then", "else"}
        for part in (*parts, *(schema[key] for key in schema.keys() & single)):
            check(part)

    check(SCHEMA)


FORCES = (
    LOOP.replace("I: 0.008", "I: 0.008, friction: {torque: 0.5, speed: 0.01}")
    + """\
couplings: ["q3 = -2 q1 + 30deg"]
springs:
  - {between: [coupler, [0.5, 0.9]], stiffness: 400, length: 0.3, damping: 2}
  - {joint: crank, stiffness: 5, angle: 30deg}
loads:
  - {link: coupler, at: [0.5, 0], force: [10, 0], frame: link}
  - {link: crank, torque: -1.5}
"""
)
MOTOR = "{ratio: -50, inertia: 2e-5, torque_constant: 0.03, resistance: 1.2, speed_max: 500}"
DRIVEN = ARM.replace("I: 0.082", f"I: 0.082, motor: {MOTOR}")
SHIPPED = [*ROOT.glob("robots/*.yaml"), *ROOT.glob("tests/hard_cases/*.yaml")]


def test_every_process_writes_the_same() -> None:
    line = "from robodyn.scene.scene_schema import scene_schema as s; print(s())"
    texts = {
        subprocess.run(
            [sys.executable, "-c", line],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(texts) == 1


def test_shipped_scenes_obey() -> None:
    for path in SHIPPED:
        with case(path):
            assert obeys(path.read_text())


@pytest.mark.parametrize(
    "text", [ARM, LOOP, EVERYTHING, FORCES, DRIVEN, "links: [{name: a, m: 1, l: 2, r: 0, I: 0}]"]
)
def test_good_scenes_obey(text: str) -> None:
    from_text(text, "my.yaml")
    assert obeys(text)


def test_drawn_scenes_obey() -> None:
    for seed in range(12):
        with case(seed):
            text = Linkage(seed, slides=True).drawn()
            assert obeys(text)
            assert not obeys(text + "\nclosures: []")
            assert not obeys(text.replace(", m: ", ", mass: ", 1))


def test_one_moment_of_inertia() -> None:
    link = "links: [{name: a, m: 1, l: 2, r: 0%s}]"
    assert obeys(link % ", J: 1")
    assert not obeys(link % "")
    assert not obeys(link % ", I: 1, J: 1")


def test_random_scenes_obey() -> None:
    for seed in range(12):
        with case(seed):
            assert obeys(seeded_tree(seed, 4).text)
            loop = seeded_scene(seed, list(LOOPS.values())[seed % len(LOOPS)])
            assert obeys(loop.text)
            assert obeys(forced(seed, loop).text)


ODD = [
    (ARM, "name: upper", "name: 3"),
    (ARM, "name: upper", "name: true"),
    (ARM, "I: 0.031", "I: 1e-3"),
    (ARM, "gravity: 9.81", "gravity: -9.81"),
    (ARM, "gravity: 9.81", "gravity: [0, 0]"),
    (EVERYTHING, "plate: 30deg", "plate: 3pi/2"),
    (EVERYTHING, "plate: 30deg", "plate: 1/3"),
    (EVERYTHING, "along: [3, 4]", "along: [0, -2]"),
    (FORCES, 'couplings: ["q3 = -2 q1 + 30deg"]', "couplings: q2 = 20/37 q1"),
    (FORCES, "stiffness: 400", "stiffness: 0"),
    (FORCES, ", frame: link", ""),
    (FORCES, "frame: link", "frame: ground"),
]


def test_odd_but_good_scenes_obey() -> None:
    for text, old, new in ODD:
        with case(text, old, new):
            assert text.count(old) == 1
            from_text(text.replace(old, new), "my.yaml")
            assert obeys(text.replace(old, new))


OF_JOINTS = [
    "limits: {min: 0}",
    "limits: {min: 0, stiffness: 9}",
    "limits: {max: 0.5, stiffness: 9, damping: 2}",
    "limits: {min: 0, max: 0.5, restitution: 0.5}",
    "limits: {min: 0, restitution: 0}",
    "friction: {TORQUE: 1, speed: 0.1}",
    "friction: {TORQUE: 1, static: 2}",
    "friction: {TORQUE: 1, static: 2, stribeck: 0.1}",
    "friction: {TORQUE: 0, static: 0}",
]
AT_JOINTS = [
    "limits: {min: 0, stiffness: 9, restitution: 0.5}",
    "limits: {min: 0, restitution: 2}",
    "limits: {min: 0, stiffness: 0}",
    "friction: {TORQUE: 1}",
    "friction: {TORQUE: 1, static: 2, speed: 0.1}",
    "friction: {TORQUE: 1, static: -2}",
    "friction: {static: 2}",
]


def test_every_way_to_write_friction_and_limits() -> None:
    """Each excludes the keys of the others, at joints that turn and at those that slide."""
    for joint, torque in ("", "torque"), ("joint: prismatic, axis: [1, 0], ", "force"):
        for text in OF_JOINTS + AT_JOINTS:
            part = text.replace("TORQUE", torque)
            text_of = f"links: [{{name: a, {joint}m: 1, l: 1, r: 0, I: 1, {part}}}]"
            with case(text_of):
                if text in OF_JOINTS:
                    from_text(text_of, "my.yaml")
                else:
                    with pytest.raises(DescriptionError):
                        from_text(text_of, "my.yaml")
                assert obeys(text_of) == (text in OF_JOINTS)


FAULTS = [
    (ARM, "name: arm\n", "nmae: arm\n"),
    (ARM, "links:", "limbs:"),
    (ARM, "gravity: 9.81", "gravity: heavy"),
    (ARM, "gravity: 9.81", 'gravity: "9.81"'),
    (ARM, "gravity: 9.81", "gravity: [0, 9.81, 0]"),
    (ARM, "gravity: 9.81", "gravity: true"),
    (ARM, "gravity: 9.81", "gravity: {y: -9.81}"),
    (ARM, "name: upper, ", ""),
    (ARM, "name: upper", "name: ''"),
    (ARM, "name: upper", "name: [a]"),
    (ARM, "m: 1.5, ", ""),
    (ARM, "m: 1.5", "m: -1.5"),
    (ARM, "m: 1.5", "m: 1.5 kgs"),
    (ARM, "l: 0.8", "l: -0.8"),
    (ARM, "r: 0.36", "r: -0.36"),
    (ARM, "r: 0.36", "r: [0.36]"),
    (ARM, "r: 0.36", "r: [0.36, x]"),
    (ARM, "I: 0.082", "I: [0, 0, 0.082]"),
    (ARM, "I: 0.082", "I: 0.082, mass: 2"),
    (ARM, "I: 0.082", "I: 0.082, payload: -1"),
    (ARM, "I: 0.082", "I: 0.082, damping: none"),
    (ARM, "I: 0.082", "I: 0.082, from: [1, 2, 3]"),
    (ARM, "I: 0.082", "I: 0.082, from: {at: [1, 2]}"),
    (ARM, "I: 0.082", "I: 0.082, from: {link: lower, at: 1}"),
    (LOOP, "- [coupler, rocker]", "- [coupler]"),
    (LOOP, "- [coupler, rocker]", "- [coupler, rocker, crank]"),
    (LOOP, "- [coupler, rocker]", "- [[0, 0], [1, 1]]"),
    (LOOP, "- [coupler, rocker]", "- coupler"),
    (LOOP, "- [coupler, rocker]", "- {point: coupler}"),
    (LOOP, "- [coupler, rocker]", "- {point: coupler, on: {through: [0, 0]}}"),
    (LOOP, "- [coupler, rocker]", "- {point: coupler, on: {through: [0, 0], along: [0, 0]}}"),
    (LOOP, "- [coupler, rocker]", "- {point: coupler, on: {through: 0, along: [1, 0]}}"),
    (LOOP, "actuated: [crank]", "actuated: crank"),
    (LOOP, "actuated: [crank]", "actuated: [crank, crank]"),
    (LOOP, "assembly: open", "assembly: closed"),
    (LOOP, "assembly: open", "assembly: [closed]"),
    (FORCES, "q3 = -2 q1 + 30deg", "q3 + 2 q1 = 0"),
    (FORCES, '["q3 = -2 q1 + 30deg"]', "3"),
    (FORCES, "torque: 0.5, speed: 0.01", "torque: 0.5"),
    (FORCES, "torque: 0.5, speed: 0.01", "torque: 0.5, speed: 0"),
    (FORCES, "torque: 0.5, speed: 0.01", "torque: -0.5, speed: 1"),
    (FORCES, "between: [coupler, [0.5, 0.9]]", "between: [[0, 0], [0.5, 0.9]]"),
    (FORCES, "between: [coupler, [0.5, 0.9]], ", ""),
    (FORCES, "stiffness: 400", "stiffness: -400"),
    (FORCES, "length: 0.3, ", ""),
    (FORCES, "damping: 2", "damper: 2"),
    (FORCES, "angle: 30deg", "angle: steep"),
    (FORCES, "joint: crank, ", "joint: crank, length: 1, "),
    (FORCES, "force: [10, 0]", "force: 10"),
    (FORCES, "at: [0.5, 0], ", ""),
    (FORCES, "frame: link", "frame: world"),
    (FORCES, "torque: -1.5", "torque: -1.5, at: [0, 0]"),
    (FORCES, "torque: -1.5", "torque: strong"),
    (DRIVEN, "ratio: -50", "ratio: 0"),
    (DRIVEN, "ratio: -50, ", ""),
    (DRIVEN, "inertia: 2e-5", "inertia: -2e-5"),
    (DRIVEN, "resistance: 1.2", "resistance: 0"),
    (DRIVEN, "speed_max: 500", "speed_max: fast"),
    (DRIVEN, "speed_max: 500", "speed: 500"),
    (LOOP, "closures:\n  - [coupler, rocker]\n", ""),
    (LOOP, "assembly: open", "assembly: []"),
    (EVERYTHING, "plate: 30deg", "plate: 30degrees"),
    (EVERYTHING, "plate: 30deg", "plate: [1]"),
    (EVERYTHING, "start: {plate: 30deg, right: -pi/4, slide: 0.5}", "start: 30deg"),
]


def test_faulty_scenes_do_not() -> None:
    for text, old, new in FAULTS:
        with case(text, old, new):
            assert text.count(old) == 1
            with pytest.raises(DescriptionError):
                from_text(text.replace(old, new), "my.yaml")
            assert not obeys(text.replace(old, new))


@pytest.mark.parametrize("text", ["links: []", "[1, 2]", "hello"])
def test_what_is_no_scene_does_not(text: str) -> None:
    assert not obeys(text)


DRAWN = """
gravity: 9.81
pins: {O: [0, 0], A: [0.1, 0.1], B: [0.6, 0.3], Q: [0.6, 0], C: [0.9, 0], D: [0.9, -0.5],
  E: [0.3, 0.21], F: [0.2, 0.05]}
links:
  - {name: crank, pins: [O, A, F], m: 0.4, r: 0.05, I: 0.001}
  - {name: rod, pins: [A, B], m: 0.5, centre: [0.3, 0.2], I: 0.012}
  - {name: lever, pins: [Q, B], m: 0.6, r: 0.15, J: 0.02}
  - {name: arm, pins: [Q, C], joint: fixed, m: 0.5, r: 0.15, I: 0.005}
  - {name: push rod, pins: [C, D], m: 0.3, r: 0.25, I: 0.006}
  - {name: block, pins: [E], along: [1, 0.3]}
ground: [O, Q, E, {pin: D, along: [0, 1]}]
actuated: [crank]
"""
SLOTTED = """
pins: {O: [0, 0], A: [0.1, 0.1], Q: [0.3, -0.2], B: [0.3, 0.5]}
links: [{name: crank, pins: [O, A]}, {name: lever, pins: [Q, B]}]
slots: [{pin: A, on: lever, along: [-2, 3]}]
ground: [O, Q]
"""
PLAIN = """
links:
  - {name: crank, l: 0.2}
  - {name: rod, l: 0.4, m: 0.5, r: [0.3, 0.2], I: 0.012}
  - {name: lever, l: 0.3, from: [0.4, 0], m: 0.6, r: 0.15, J: 0.02}
  - {name: arm, l: 0.1, joint: fixed, angle: 0.2, from: lever, m: 0.5, r: 0.15, I: 0.005}
  - {name: block, joint: prismatic, axis: [1, 0.3], l: 0, m: 0.1, r: 0, I: 0.01, from: [1, 0]}
closures: [[rod, lever], {point: crank, on: {link: block, through: [0, 0], along: [1, 0]}}]
assembly: open
"""
ADDED = {
    "joint": ("revolute", "prismatic", "fixed", "welded"),
    "pins": (["O", "A"], ["O"], [], {"O": [0, 0]}),
    "along": ([1, 0.2],),
    "axis": ([1, 0],),
    "centre": ([0.1, 0.1],),
    "from": ([0, 0], "crank"),
    "on": ("rod",),
    "ground": (["O", "Q"],),
    "assembly": ("open",),
    "friction": ({"torque": 0.1, "speed": 0.1}, {"coefficient": 0.1, "radius": 0.1, "speed": 1}),
    "limits": ({"min": -1},),
    "name": ("other",),
    **dict.fromkeys(("closures", "slots", "springs", "loads", "couplings", "points"), ([],)),
    **dict.fromkeys(("start", "constants"), ({},)),
}


def mappings(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The places of the mappings of a scene, less those of names."""
    if isinstance(node, dict):
        yield path
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        if isinstance(value, (dict, list)) and key != "pins":
            yield from mappings(value, (*path, key))


@pytest.mark.parametrize("text", [DRAWN, SLOTTED, PLAIN], ids=["drawn", "slotted", "plain"])
def test_it_refuses_the_keys_that_the_reader_refuses(text: str) -> None:
    """Each key of the grammar at each place: both refuse it, unless it is what a name is of."""
    names = sorted({name for form in FORMS.values() for name in form.keys})
    told = re.compile(
        "names no|drawn in line|goes along|nothing (holds|above)|is on no link|as drawn|has O"
    )
    for path in mappings(yaml.safe_load(text)):
        for name in names:
            for value in ADDED.get(name, (0.1,)):
                scene = yaml.safe_load(text)
                place = scene
                for key in path:
                    place = place[key]
                if name in place and name not in ("joint", "pins"):
                    continue
                place[name] = value
                with case(path, name, value):
                    faults = []
                    try:
                        from_text(json.dumps(scene), "my.yaml")
                    except DescriptionError as error:
                        faults = [x for x in error.faults if not told.search(x.limit)]
                        if not faults:
                            continue  # no schema knows where pins are, or what has a name
                    assert VALIDATOR.is_valid(scene) is not bool(faults), faults


# The same keys


def test_the_schema_knows_the_keys_of_the_grammar() -> None:
    for kind, form in FORMS.items():
        place = f"plain_{kind}" if len(MAPPINGS.get(kind, ())) > 1 else kind
        mapping = SCHEMA["$defs"][place]
        assert set(mapping["properties"]) == set(form.keys)
        assert mapping["required"] == form.needed


@pytest.mark.parametrize(
    "form",
    [
        "scene",
        "revolute_link",
        "point_spring",
        "joint_spring",
        "force",
        "torque",
        "load_table",
        "dry_friction",
        "stops",
        "hard_stops",
        "motor",
        "drawn_scene",
        "drawn_revolute_link",
        "slot",
    ],
)
def test_the_tables_of_the_guide_are_the_grammar(form: str) -> None:
    named = {
        "scene": "scene key",
        "revolute_link": "link key",
        "dry_friction": "key of a friction that sticks",
        "stops": "key of limits with stops",
        "hard_stops": "key of limits with hard stops",
        "drawn_scene": "key of a drawn scene",
        "drawn_revolute_link": "key of a drawn link",
    }
    header = f"| {named.get(form, f'key of a {form}'.replace('_', ' '))} | unit | value | default |"
    header = header.replace("a joint spring", "a spring at a joint")
    header = header.replace("a point spring", "a spring between points")
    table = f"{header}\n|---|---|---|---|\n{key_table(form)}"
    page = "drawn" if form in ("drawn_scene", "drawn_revolute_link", "slot") else "scene"
    assert table in PAGES[page], f"the grammar says\n{table}"


def properties(part: Any) -> list[tuple[str, Any]]:
    """Every key of the format with its schema."""
    found = []
    if isinstance(part, dict):
        if part.get("type") == "object":
            found += part.get("properties", {}).items()
        for value in part.values():
            found += properties(value)
    return found


def test_every_key_is_described() -> None:
    for key, schema in properties(SCHEMA):
        assert "description" in schema, key


@pytest.mark.parametrize(
    ("key", "unit"), [("m", "kg"), ("l", "m"), ("I", "kg m²"), ("damping", "N m s/rad"), ("r", "m")]
)
def test_amounts_tell_their_units(key: str, unit: str) -> None:
    schema = SCHEMA["$defs"]["revolute_link"]["properties"][key]
    assert re.search(rf"\b{re.escape(unit)}(\b|\.|:)", schema["description"])
