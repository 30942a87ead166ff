"""The part of JSON Schema (draft 2020-12) that the scene's schema uses, checked independently."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

TYPES: dict[str, Callable[[Any], bool]] = {
    "object": lambda x: isinstance(x, dict),
    "array": lambda x: isinstance(x, list),
    "string": lambda x: isinstance(x, str),
    "number": lambda x: isinstance(x, (int, float)) and not isinstance(x, bool),
    "boolean": lambda x: isinstance(x, bool),
}
IGNORED = {"$schema", "$defs", "title", "description"}


def accepts(schema: Any, value: Any, root: Any = None) -> bool:
    """Whether the value obeys the schema; KeyError for a keyword that is not known here."""
    root = schema if root is None else root
    for keyword in schema.keys() - IGNORED:
        if not KEYWORDS[keyword](schema[keyword], value, root, schema):
            return False
    return True


def _type(wanted: Any, value: Any, *_: Any) -> bool:
    return any(TYPES[name](value) for name in ([wanted] if isinstance(wanted, str) else wanted))


def _ref(path: str, value: Any, root: Any, *_: Any) -> bool:
    return accepts(root["$defs"][path.removeprefix("#/$defs/")], value, root)


def _additional(rest: Any, value: Any, root: Any, schema: Any) -> bool:
    if not isinstance(value, dict):
        return True
    others = [value[key] for key in value.keys() - schema.get("properties", {}).keys()]
    return not others if rest is False else all(accepts(rest, x, root) for x in others)


KEYWORDS: dict[str, Callable[..., bool]] = {
    "type": _type,
    "$ref": _ref,
    "const": lambda c, x, *_: x == c and isinstance(x, bool) == isinstance(c, bool),
    "enum": lambda choices, x, *_: x in choices,
    "not": lambda s, x, root, _: not accepts(s, x, root),
    "anyOf": lambda each, x, root, _: any(accepts(s, x, root) for s in each),
    "minimum": lambda low, x, *_: not TYPES["number"](x) or x >= low,
    "exclusiveMinimum": lambda low, x, *_: not TYPES["number"](x) or x > low,
    "pattern": lambda p, x, *_: not isinstance(x, str) or re.search(p, x) is not None,
    "required": lambda names, x, *_: not isinstance(x, dict) or set(names) <= set(x),
    "properties": lambda each, x, root, _: (
        not isinstance(x, dict)
        or all(accepts(s, x[name], root) for name, s in each.items() if name in x)
    ),
    "additionalProperties": _additional,
    "items": lambda s, x, root, _: (
        not isinstance(x, list) or all(accepts(s, item, root) for item in x)
    ),
    "contains": lambda s, x, root, _: (
        not isinstance(x, list) or any(accepts(s, item, root) for item in x)
    ),
    "minItems": lambda n, x, *_: not isinstance(x, list) or len(x) >= n,
    "maxItems": lambda n, x, *_: not isinstance(x, list) or len(x) <= n,
    "uniqueItems": lambda yes, x, *_: (
        not yes or not isinstance(x, list) or len({repr(item) for item in x}) == len(x)
    ),
}
