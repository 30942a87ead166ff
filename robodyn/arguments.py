"""Check arguments of the public functions against their annotations before each call."""

from __future__ import annotations

import inspect
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from types import FunctionType
from typing import Any

import numpy as np

from robodyn.errors import InputError
from robodyn.tables.csv_fields import shown

Test = Callable[[Any], bool]
STATE = ("q", "qd", "qdd", "tau")
_LARGEST = sys.float_info.max
_FEW = 32  # numbers: Python tests these faster than numpy


def argument_check(function: FunctionType) -> Callable[[Sequence[Any], Mapping[str, Any]], None]:
    """Return a function of positional and named arguments that raises InputError for wrong ones.

    An argument is wrong if it is not what its annotation says, or an array that is not finite.
    Where functions take states, these must broadcast to one another, and times `t` to the states;
    that they are finite the functions see themselves: of a million states a look takes longer than
    all of their torques.
    """
    code, where = function.__code__, function.__name__
    names = code.co_varnames[: code.co_argcount]
    kinds = {
        name: (*_kind(str(annotation)), "ArrayLike" in str(annotation))
        for name, annotation in function.__annotations__.items()
    }
    # types by which a value is known to be right, whatever it is: found as they come
    right: set[tuple[str, type]] = {
        (name, type(None))
        for name, (test, _, is_array) in kinds.items()
        if not is_array and test(None)
    }
    of_states = function.__module__.split(".")[1] in ("dynamics", "loops")

    def check(given: Sequence[Any], named: Mapping[str, Any]) -> None:
        shapes: dict[str, tuple[int, ...]] = {}
        for name, value in (*zip(names, given, strict=False), *named.items()):
            if (name, type(value)) in right or name not in kinds:
                continue  # Python says that there is no such argument
            test, words, is_array = kinds[name]
            if is_array and type(value) is list and _plain(value):
                shapes[name] = (len(value),)
                continue
            array: np.ndarray | None = None
            if is_array and type(value) is np.ndarray and value.dtype == float:
                array = value  # an array of floats needs no test
            else:
                if is_array and value is not None:
                    array = _as_array(value)
                if not test(value if array is None else array):
                    told = shown(repr(value)) if isinstance(value, _PLAIN) else type(value).__name__
                    raise InputError(name, where=where, value=told, limit=f"must be {words}")
                own = type(value) in _WHOLE or type(value).__module__.startswith("robodyn.")
                if own and not is_array:
                    right.add((name, type(value)))  # what it is tells all
            if array is not None:
                if not (of_states and name in STATE):  # which such functions look at themselves
                    _check_finite(name, array)
                shapes[name] = array.shape
        if of_states and any(len(x) > (name != "t") for name, x in shapes.items()):
            _check_shapes(shapes)

    return check


def _check_shapes(shapes: dict[str, tuple[int, ...]]) -> None:
    times = shapes.pop("t", ())
    try:
        lead = np.broadcast_shapes(*(shape[:-1] for shape in shapes.values()))
    except ValueError:
        told = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise InputError("shapes", value=told, limit="must broadcast to one another") from None
    try:
        fits = np.broadcast_shapes(lead, times) == lead
    except ValueError:
        fits = False
    if not fits:
        raise InputError("t.shape", value=times, limit=f"must broadcast to {lead}, one a state")


def _as_array(value: Any) -> np.ndarray[Any, Any] | None:
    """None if the value makes no array."""
    try:
        array = np.asarray(value)
        if array.dtype == object and not any(x is None for x in array.flat):
            array = array.astype(float)
    except (TypeError, ValueError, OverflowError):
        return None
    return array


_WHOLE = (float, bool)


def _plain(values: list[Any]) -> bool:
    """Return whether a list holds a few finite numbers; this fast check covers most calls."""
    if len(values) >= _FEW:
        return False
    for x in values:
        if type(x) is not float and type(x) is not int:
            return False
        if not -_LARGEST <= x <= _LARGEST:
            return False
    return True


_PLAIN = (str, bytes, int, float, complex, list, tuple, dict, np.ndarray, type(None))


def _check_finite(name: str, array: np.ndarray[Any, Any]) -> None:
    few = array.ndim == 1 and len(array) < _FEW
    if not (all(map(math.isfinite, array.tolist())) if few else np.isfinite(array).all()):
        from robodyn.mechanics.placed import finite

        finite(name, array)


def _kind(annotation: str) -> tuple[Test, str]:
    """The test of a value by an annotation, and words for what it must be."""
    found = [_one_kind(each) for each in _split(annotation, " | ")]
    tests = [test for test, _ in found]
    words = " or ".join(word for _, word in found if word)
    return (tests[0] if len(tests) == 1 else lambda value: any(x(value) for x in tests)), words


def _one_kind(annotation: str) -> tuple[Test, str]:
    """`_kind` of an annotation that is no union."""
    head = annotation.partition("[")[0]
    inside = annotation[len(head) + 1 : -1]
    if annotation in _KINDS:
        return _KINDS[annotation]
    if head == "Literal":
        texts = re.findall(r"\w+", inside)
        return lambda value: isinstance(value, str) and value in texts, " or ".join(texts)
    if head == "tuple":
        count = len(_split(inside, ", "))
        return lambda value: _row(value) and len(value) == count, f"{count} numbers"
    if head == "Mapping":
        test, words = _kind(_split(inside, ", ")[1])
        return (
            lambda value: (
                isinstance(value, Mapping)
                and all(isinstance(name, str) and test(x) for name, x in value.items())
            )
        ), f"a mapping of names to {words}" if words else "a mapping by names"
    if head == "Callable":
        count = len(_split(_split(inside, ", ")[0][1:-1], ", "))
        many = "1 argument" if count == 1 else f"{count} arguments"
        return lambda value: callable(value) and _takes(value, count), f"a function of {many}"
    if re.fullmatch(r"[A-Z]\w+", annotation) and annotation != "Any":
        # by the name of the class, which is not imported for it
        return lambda value: any(x.__name__ == head for x in type(value).__mro__), f"a {head}"
    return lambda value: True, ""


def _split(text: str, at: str) -> list[str]:
    """The parts of a text between separators that stand in no brackets."""
    parts, depth = [""], 0
    for piece in re.split(f"({re.escape(at)}|[][])", text):
        depth += {"[": 1, "]": -1}.get(piece, 0)
        if piece == at and not depth:
            parts.append("")
        else:
            parts[-1] += piece
    return parts


def _takes(function: Callable[..., Any], count: int) -> bool:
    try:
        inspect.signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:  # of what is built in no signature is known
        pass
    return True


def _numbers(value: Any) -> bool:
    array = _as_array(value)
    return array is not None and array.dtype.kind in "fiub"


def _row(value: Any) -> bool:
    return _numbers(value) and np.ndim(value) == 1


def _number(value: Any) -> bool:
    if isinstance(value, (float, int)):  # functions refuse nan themselves, and say what they take
        return isinstance(value, float) or abs(value) <= _LARGEST
    return isinstance(value, (Real, np.ndarray)) and not np.asarray(value).ndim and _numbers(value)


def _texts(value: Any) -> bool:
    listed = isinstance(value, Sequence) and not isinstance(value, (str, bytes))
    return listed and all(isinstance(x, str) for x in value)


def _size(value: Any) -> bool:
    return value is None or (
        _row(value) and len(value) == 2 and all(0.0 < x < math.inf for x in value)
    )


_KINDS: dict[str, tuple[Test, str]] = {
    "None": (lambda value: value is None, ""),
    "ArrayLike": (_numbers, "numbers"),
    "Sequence[float]": (_row, "a row of numbers"),
    "Sequence[str]": (_texts, "a list of texts"),
    "str": (lambda value: isinstance(value, str), "a text"),
    "float": (_number, "a number"),
    "int": (lambda x: isinstance(x, Integral) and not isinstance(x, bool), "a whole number"),
    "bool": (lambda value: isinstance(value, (bool, np.bool_)), "True or False"),
    "Size": (_size, "width and height > 0, inches"),
}
