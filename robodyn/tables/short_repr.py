"""Short texts of results: their fields, arrays by their shapes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from robodyn.errors import printable

MOST = 6  # entries that are shown
LONGEST = 60  # characters of a text, or of a list
Result = TypeVar("Result")


def short_repr(result: type[Result]) -> type[Result]:
    """Give a NamedTuple or a dataclass a `repr` of one short line, for notebooks and prompts."""
    result.__repr__ = _fields  # type: ignore[method-assign]
    return result


def named(names: Iterable[str]) -> str:
    """The names, the first few if they are many."""
    known = list(names)
    more = f", ... ({len(known)})" if len(known) > MOST else ""
    return printable(", ".join(known[:MOST])) + more


def _fields(result: object) -> str:
    kind = type(result)
    names = getattr(kind, "_fields", None)
    if names is None:
        fields = getattr(kind, "__dataclass_fields__", {}).values()
        names = [field.name for field in fields if field.repr]
    values = {name: getattr(result, name) for name in names}
    says = {name: x for name, x in values.items() if not isinstance(x, (str, list, dict)) or x}
    return f"{kind.__name__}({', '.join(f'{name}={_short(x)}' for name, x in says.items())})"


def _short(value: object) -> str:
    kind = type(value).__name__
    if type(value).__repr__ is _fields:
        return repr(value)
    shape = getattr(value, "shape", None)
    if shape:
        size: int = getattr(value, "size", 0)
        return _short(getattr(value, "tolist", list)()) if size <= MOST else f"<array {shape}>"
    if isinstance(value, str):
        return repr(value if len(value) <= LONGEST else value[:LONGEST] + "...")
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, dict)) or type(value) is tuple:
        if len(value) <= MOST:
            text = f"[{', '.join(map(_short, value))}]"
            if isinstance(value, dict):
                text = "{" + ", ".join(f"{k!r}: {_short(x)}" for k, x in value.items()) + "}"
            if len(text) <= LONGEST:
                return text
        return f"<{len(value)} value{'s' * (len(value) > 1)}>"
    if value is None or isinstance(value, (bool, int, complex)) or kind == "Mechanism":
        return repr(value)
    return f"<{kind}>"
