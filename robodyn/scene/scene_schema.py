"""The scene format as a JSON Schema (draft 2020-12), for editors that complete and check.

It says what a schema can say of the grammar (`grammar.py`): keys, types, ranges.  Names that must
exist, links that hang from themselves and the like are found by robodyn alone.
"""

from __future__ import annotations

from typing import Any

from robodyn.elements.keys import Key
from robodyn.scene.expressions import SMOOTH
from robodyn.scene.grammar import (
    FORMS,
    MAPPINGS,
    NUMBERS,
    OR_PAIR,
    OR_VECTOR,
    WORDS,
    Form,
)
from robodyn.scene.syntax import CONSTANTS, FUNCTIONS, VALUE_CONSTANTS
from robodyn.scene.units import UNITS

Schema = dict[str, Any]
_ANY_NAME = "[A-Za-z][A-Za-z0-9_]*"

# of units and signs, as values may have them
LETTERS = "\u03c0\u00b0\u00b2\u00b3\u00b7\u03a9\u2126\u00b5\u03bc\u2212\u00d7"


def scene_schema() -> Schema:
    """The schema of a scene file, as JSON has it."""
    keyword: dict[str, Schema] = {"": {}, ">= 0": {"minimum": 0}, "> 0": {"exclusiveMinimum": 0}}
    keyword |= {"not 0": {"not": {"const": 0}}, "in [0, 1]": {"minimum": 0, "maximum": 1}}
    written = _ref("quantity")
    kinds: dict[str, Schema] = {
        x: {"anyOf": [{"type": "number", **keyword[y]}, written]} for x, y in NUMBERS.items()
    }
    kinds |= {kind: {"enum": list(words)} for kind, words in WORDS.items()}
    kinds |= {kind: _any(plain, "vector") for kind, plain in OR_VECTOR.items()}
    pair = {"type": "array", "minItems": 2, "maxItems": 2}
    kinds |= {x: {"anyOf": [_ref(y), {**pair, "items": _ref(y)}]} for x, y in OR_PAIR.items()}
    kinds |= {
        kind: _any(*(_place(form.way.name) for form in forms))
        for kind, forms in MAPPINGS.items()
        if kind not in FORMS or len(forms) > 1
    }
    kinds |= {_place(name): _mapping(form) for name, form in FORMS.items()}
    del kinds["scene"]  # it is the whole
    some = {"required": ["closures"], "properties": {"closures": {"minItems": 1}}}
    kinds["plain_scene"]["dependentSchemas"] = {"assembly": some}
    kinds |= _other_kinds()
    named = kinds | {
        "quantity": {"type": "string", "pattern": _quantity(True)},
        "law": {"type": ["string", "number"], "pattern": _expression(_ANY_NAME)},
        "expression": {"type": "string", "pattern": _expression(_ANY_NAME)},
        "timed": {"type": "string", "pattern": "^(?=.*t)" + _expression(_ANY_NAME)[1:]},
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "robodyn scene",
        "type": "object",
        "required": FORMS["scene"].needed,
        "if": {"required": ["constants"]},
        "then": _whole("named_"),
        "else": _whole(""),
        "$defs": kinds | {f"named_{kind}": _of_named(own) for kind, own in named.items()},
    }


def _whole(prefix: str) -> Schema:
    return {
        "if": {"required": ["pins"]},
        "then": _ref(f"{prefix}drawn_scene"),
        "else": _ref(f"{prefix}plain_scene"),
    }


def _of_named(schema: Any) -> Any:
    """The schema of a kind in scenes with constants, whose names any value may have."""
    if isinstance(schema, list):
        return [_of_named(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    each = {key: _of_named(part) for key, part in schema.items()}
    if "$ref" in each:
        each["$ref"] = each["$ref"].replace("/$defs/", "/$defs/named_")
    return each


def _place(form: str) -> str:
    """Return the name of a form in the schema, distinct from that of all forms of its kind."""
    return f"plain_{form}" if len(MAPPINGS.get(form, ())) > 1 else form


def _other_kinds() -> dict[str, Schema]:
    any_name = ["string", "number", "boolean"]  # what YAML makes of a name such as 3
    pair = {"type": "array", "minItems": 2, "maxItems": 2}
    return {
        "name": {"type": any_name, "pattern": r"\S"},
        "link_name": _ref("name"),
        "joint_name": _ref("name"),
        "link": _any("prismatic_link", "revolute_link", "weld"),
        "joints": {**_list("name"), "uniqueItems": True},
        "quantity": {"type": "string", "pattern": _quantity()},
        "vector": {**pair, "items": _ref("number")},
        "truth": {"type": "boolean"},
        "direction": {**_ref("vector"), "contains": {"not": {"const": 0}}},
        "points": {"type": "object", "additionalProperties": _ref("moving_point")},
        "pins": {"type": "object", "additionalProperties": _ref("vector"), "minProperties": 1},
        "pin_names": {**_list("name"), "minItems": 1, "uniqueItems": True},
        "two_pins": {**_list("name"), "minItems": 2, "uniqueItems": True},
        "ground_pin": _any("name", "ground_line"),
        "start": {"type": "object", "additionalProperties": _ref("angle")},
        "constants": {
            "type": "object",
            "propertyNames": {"pattern": f"^{_ANY_NAME}$"},
            "additionalProperties": _ref("number"),
        },
        "assembly": {"anyOf": [_ref("branch"), {**_list("branch"), "minItems": 1}]},
        "equation": {"type": "string", "pattern": r"^\s*q\s*[0-9][0-9\s]*=\s*\S"},
        "coupling": _any("equation", "law_coupling", "table_coupling"),
        "table_coupling": {
            "description": "A coupling by a table, a cubic spline through its rows.",
            "type": "object",
            "properties": {
                "joint": {"description": "The link whose joint it gives.", **_ref("name")},
                "table": {"description": "The CSV file.", **_ref("name")},
                "over": {"description": "t, or a joint: q1.", **_ref("name")},
                "column": {"description": "The column of the joint's values.", **_ref("name")},
                "period": {"description": "After which it repeats.", **_ref("number")},
                "cam": {"description": "The cam that drives the joint.", **_ref("cam")},
            },
            "required": ["joint", "table", "over", "column"],
            "additionalProperties": False,
        },
        "law_coupling": {
            "description": "A coupling by its law.",
            "type": "object",
            "properties": {
                "law": {"description": "An equation.", **_ref("equation")},
                "cam": {"description": "The cam that drives the joint.", **_ref("cam")},
            },
            "required": ["law"],
            "additionalProperties": False,
        },
        "couplings": {"anyOf": [_ref("coupling"), _list("coupling")]},
        "moving_point": _any("name", "link_point"),
        "point": _any("moving_point", "vector"),
        "pair": {**pair, "items": _ref("point"), "contains": {"type": [*any_name, "object"]}},
        "closure": _any("pair", "joined", "slider"),
        "law": {"type": ["string", "number"], "pattern": _expression("x|v")},
        "spring_table": _ref("name"),
        "gravity": _any("number", "timed", "load_table", "varying_vector"),
        "timed": {"type": "string", "pattern": "^(?=.*t)" + _expression("t")[1:]},
        "varying": _any("number", "expression", "load_table"),
        "expression": {"type": "string", "pattern": _expression("t|qd?[0-9]+")},
        "varying_place": _ref("varying_vector"),
        "varying_vector": {**pair, "items": _ref("varying")},
    }


def _expression(variables: str) -> str:
    """The pattern of smooth expressions: which words they have, in the dialect of JSON Schema."""
    words = "|".join((*_longest_first({*SMOOTH, *CONSTANTS, *UNITS}), variables))
    return rf"^(?:[\s0-9.+*/(),^{LETTERS}-]|[0-9.][eE][0-9]|(?:{words})(?![A-Za-z0-9_]))+$"


def _quantity(named: bool = False) -> str:
    """The pattern of arithmetic with units: which letters and words it has.

    With `named` it may have constants of the scene, which are words of any kind.
    """
    words = "|".join(_longest_first({*FUNCTIONS, *VALUE_CONSTANTS, *UNITS, "if", "else"}))
    words = _ANY_NAME if named else words
    plain = r"\s*[+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?\s*$"  # quoted, it is none
    signs = rf"[\s0-9.+*/%<>=(),^{LETTERS}-]"
    return rf"^(?!{plain})(?:{signs}|[0-9.][eE][0-9+-]|(?:{words})(?![A-Za-z_]))+$"


def _longest_first(words: set[str]) -> list[str]:
    return sorted(words, key=lambda word: (-len(word), word))


def _mapping(form: Form) -> Schema:
    schema = {
        "description": form.way.help,
        "type": "object",
        "properties": {name: _described(key) for name, key in form.keys.items()},
        "required": form.needed,
        "additionalProperties": False,
    }
    ones: list[Schema] = [{"oneOf": [{"required": [name]} for name in one]} for one in form.one]
    if form.together:
        none = [{"required": [name]} for group in form.together for name in group]
        all_of = [{"oneOf": [{"required": [name]} for name in one]} for one in form.together]
        ones.append({"anyOf": [{"not": {"anyOf": none}}, {"allOf": all_of}]})
    if ones:
        schema["allOf"] = ones
    return schema


def _described(key: Key) -> Schema:
    told = f"{key.help[0].upper()}{key.help[1:]}{', ' * bool(key.unit)}{key.unit}."
    if not key.needed:
        told += f" Default: {key.shown_default}."
    if key.only:
        return {"description": told, "const": key.only}
    if not key.listed:
        return {"description": told, **_ref(key.kind)}
    least = {"minItems": 1} if key.needed else {}
    return {"description": told, **_list(key.kind), **least}


def _list(kind: str) -> Schema:
    return {"type": "array", "items": _ref(kind)}


def _any(*kinds: str) -> Schema:
    return {"anyOf": [_ref(kind) for kind in kinds]}


def _ref(kind: str) -> Schema:
    return {"$ref": f"#/$defs/{kind}"}
