"""Arguments of the public functions, held against their annotations before the call."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from numbers import Integral, Real
from types import FunctionType
from typing import Any

import numpy as np

from robodyn.errors import InputError
from robodyn.tables.csv_fields import shown


def check_arguments(function: FunctionType, given: tuple[Any, ...], named: dict[str, Any]) -> None:
    """Raise InputError for an argument that is not what the function's annotation says."""
    code = function.__code__
    arguments = dict(zip(code.co_varnames[: code.co_argcount], given, strict=False)) | named
    for name, value in arguments.items():
        kinds = _alternatives(str(function.__annotations__.get(name, "Any")))
        tests = [_KINDS[kind] if kind in _KINDS else _of_class(kind) for kind in kinds]
        if not any(test(value) for test, _ in tests):
            words = " or ".join(word for _, word in tests if word)
            told = shown(repr(value)) if isinstance(value, _PLAIN) else type(value).__name__
            raise InputError(name, where=function.__name__, value=told, limit=f"must be {words}")


_PLAIN = (str, bytes, int, float, list, tuple, dict, np.ndarray, type(None))


def _alternatives(annotation: str) -> list[str]:
    """The kinds of a union; what stands in brackets belongs to its kind if it is of text."""
    while (plain := re.sub(r"\[(?!str\])[^\[\]]*\]", "", annotation)) != annotation:
        annotation = plain
    return annotation.split(" | ")


def _numbers(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fiub"
    try:
        return value is not None and np.asarray(value, float).dtype == float
    except (TypeError, ValueError):
        return False


def _texts(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and all(isinstance(x, str) for x in value)


def _row(value: Any) -> bool:
    return _numbers(value) and np.ndim(value) == 1


def _of_class(kind: str) -> tuple[Callable[[Any], bool], str]:
    """The test of a class by its name, which is not imported for it."""
    if not re.fullmatch(r"[A-Z]\w+", kind) or kind in ("Any", "Size", "Literal"):
        return lambda value: True, ""
    return lambda value: any(x.__name__ == kind for x in type(value).__mro__), f"a {kind}"


_KINDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "None": (lambda value: value is None, ""),
    "ArrayLike": (_numbers, "numbers"),
    "Sequence": (_row, "a row of numbers"),
    "Sequence[str]": (_texts, "a list of texts"),
    "str": (lambda value: isinstance(value, str), "a text"),
    "float": (lambda value: isinstance(value, (Real, np.ndarray)) and _numbers(value) and not np.ndim(value), "a number"),
    "int": (lambda value: isinstance(value, (Integral, np.integer)), "a whole number"),
    "bool": (lambda value: isinstance(value, (bool, np.bool_)), "True or False"),
    "Mapping": (lambda value: isinstance(value, Mapping), "a mapping by names"),
    "Callable": (callable, "a function"),
}
