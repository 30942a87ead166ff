"""Event functions: `q1 > 90deg`, or `qd1`, whose changes of sign are events.

An expression may use the time t, joint positions q1.. and rates qd1.., and columns of states by
their names (`state_columns.py`), with the functions that torques may use.

An expression is smooth between the zeros of its switches: `abs(x)` bends at the zeros of x,
`floor(x)` jumps at those of sin(pi x), `a if b > c else d` may jump at those of b - c, and
`sqrt(x)` ends at those of x.

Rounding errors are bounded operation by operation: each passes on the errors of its operands,
multiplied by its largest slopes within reach, and adds a rounding of its own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np

from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.state_columns import PREFIX, StateColumns, variables
from robodyn.scene.constants import numbers_of
from robodyn.scene.expressions import COMPARISONS, fold, names_of, value_in, walk
from robodyn.scene.expressions import OPERATIONS as NUMBER_OPERATIONS
from robodyn.scene.quantities import expressions
from robodyn.scene.syntax import CONSTANTS, Node, NotAllowedError
from robodyn.tables.arrays import Array

Values = Callable[[Array, Array], Array]

_NAME = re.compile(r"[A-Za-z][\w-]{0,63}", re.ASCII)
LARGEST = 1e300  # of numbers in an event: sums of what they make stay among the floats
WAYS = {">": 1, ">=": 1, "<": -1, "<=": -1}


@dataclass(frozen=True)
class Part:
    """A function of time and state: `values(t (k,), y (k, 2n or more))`; nan if undefined.

    `noise(t, y, large)` bounds the rounding error of its values on boxes with times t (m, k) and
    states y (m, k, 2n or more), as (m, k or 1).  `large` (m, 2n or more) is the largest size of
    each state component over the step of each box, which sets how states are rounded.
    """

    values: Values
    noise: Callable[[Array, Array, Array], Array]


_EQUAL = "for the time when a and b are equal write a - b"
_INSTEAD = re.compile(r"\b(?:and|or|not)\b|[=!]=")
_WRITE = {
    "and": "for `a and b` write min(x, y) > 0, x and y positive where a and b are true",
    "or": "for `a or b` write max(x, y) > 0, x and y positive where a and b are true",
    "not": "for `not a < b` write a >= b",
    "==": _EQUAL,
    "!=": _EQUAL,
}


@dataclass(frozen=True)
class EventFunction(Part):
    """A function whose changes of sign are events.

    `way` is 1 if it must become positive, -1 if negative, 0 for both.  A comparison that stays at
    zero holds unless it is `strict`.  The function is smooth between the zeros of its `switches`;
    each switch is smooth between the zeros of those before it.  A function that `has_one_sign` may
    touch zero but not cross it.  `computed` tells whether it uses columns of states.
    """

    name: str
    way: int
    strict: bool
    switches: tuple[Part, ...]
    has_one_sign: bool = False
    computed: bool = False


def event_function(
    mechanism: Mechanism, name: str, text: str, where: str, columns: StateColumns | None = None
) -> EventFunction:
    """Return the event function of an expression or a comparison.

    Columns of states are taken from `columns`, which belong to a run; without them the function is
    checked only.  Raises InputError that names `where` if the text is neither.
    """
    (tree, *cuts), way, strict = _read(mechanism, text, where)
    own, *parts = (part_of(node, mechanism.n, columns) for node in (tree, *cuts))
    return EventFunction(
        own.values,
        own.noise,
        name=name,
        way=way,
        strict=strict,
        switches=tuple(parts),
        has_one_sign=has_one_sign(tree),
        computed=any(x.startswith(PREFIX) for x in names_of(tree)),
    )


@lru_cache(maxsize=256)
def _read(mechanism: Mechanism, text: str, where: str) -> tuple[list[Node], int, bool]:
    """Return the trees of a function and its switches, its way, and whether it is strict."""
    try:
        constants = {**CONSTANTS, **numbers_of(mechanism.description.constants)}
        parsed = expressions(text, variables(mechanism), constants)
    except NotAllowedError as error:
        what = _INSTEAD.search(text)
        instead = f"; {_WRITE[what[0]]}" if what else ""
        raise InputError(f"an event does not allow {error}{instead}", where=where) from None
    except ValueError as error:
        equal = f"; {_WRITE['==']}" if re.search(r"[^<>]=", text) else ""
        raise InputError(
            repr(text), where=where, limit=f"is no expression: {error}{equal}"
        ) from None
    if len(parsed) != 1:
        raise InputError(repr(text), where=where, limit="must be one expression, without a comma")
    if not parsed[0].names:
        limit = "never changes: it names no t, q or qd, and no column"
        raise InputError(repr(text), where=where, limit=limit)
    tree, way, strict = parsed[0].node, 0, True
    if any(isinstance(x, float) and abs(x) > LARGEST for x in walk(tree)):
        limit = f"has a number above {LARGEST:g}: what it makes leaves the floats"
        raise InputError(repr(text), where=where, limit=limit)
    if type(tree) is tuple and tree[0] in WAYS:
        operation, left, right = tree
        if any(type(side) is tuple and side[0] in WAYS for side in (left, right)):
            raise InputError(repr(text), where=where, limit="compares a comparison")
        way, strict = WAYS[operation], operation in "<>"
        tree = "-", left, right
    return [tree, *switches(tree)], way, strict


def event_functions(
    mechanism: Mechanism, given: Mapping[str, str], columns: StateColumns | None = None
) -> tuple[EventFunction, ...]:
    """Return event functions by name; raise InputError for a bad name or expression."""
    if type(given) is not dict and not isinstance(given, Mapping):
        kind = type(given).__name__
        raise InputError("events", value=kind, limit="must be a mapping of names to expressions")
    functions = []
    for name, text in given.items():
        must_be_text("name of an event", name)
        must_be_text(f"event {name}", text)
        if not _NAME.fullmatch(name):
            limit = "must be a letter, then letters, digits, _ or -"
            raise InputError("name of an event", value=name, limit=limit)
        functions.append(event_function(mechanism, name, text, f"event {name}", columns))
    return tuple(functions)


def must_be_text(what: str, value: object) -> None:
    """Raise InputError if a value is not text."""
    if not isinstance(value, str):
        raise InputError(what, value=repr(value), limit="must be text, such as 'q1 > 90deg'")


def named_events(mechanism: Mechanism, texts: Iterable[str], taken: str) -> dict[str, str]:
    """Parse options NAME=EXPR into expressions by name; InputError names --event.

    No event may have the name `taken`.
    """
    given: dict[str, str] = {}
    for text in texts:
        name, sign, expression = (part.strip() for part in text.partition("="))
        if not (sign and name and expression) or expression.startswith("="):
            limit = "must be NAME=EXPR, such as apex=qd1 or high='q1 > 90deg'"
            raise InputError("--event", value=text, limit=limit)
        if name in given or name == taken:
            limit = "each event needs a name of its own"
            raise InputError("--event", value=name, limit=limit)
        given[name] = expression
    try:
        event_functions(mechanism, given)
    except InputError as error:
        error.where = f"--{error.where}" if error.where else "--event"
        raise
    return given


def switches(tree: Node) -> list[Node]:
    """Return the functions between whose zeros an expression is smooth, innermost first."""
    nested = fold(tree, lambda x: {}, _switches)
    return [switch for switch in nested if names_of(switch)]


def _switches(node: tuple[Any, ...], parts: list[dict[Node, None]]) -> dict[Node, None]:
    inner = {switch: None for part in parts for switch in part}
    return inner | dict.fromkeys(switches_of(*node))


def has_one_sign(node: Node) -> bool:
    """Return whether an expression is never negative by its form: abs(x), sqrt(x), powers."""
    while type(node) is tuple:
        operation, *parts = node
        if operation in ("abs", "sqrt", "hypot"):
            return True
        if operation not in ("**", "pow") and (operation, *parts[1:]) != ("-", 0.0):
            return False
        node = parts[0]
    return False


def switches_of(operation: str, *x: Node) -> list[Node]:
    """Return the switches of an operation itself, without those of its operands."""
    match operation:
        case "<" | "<=" | ">" | ">=":
            return [("-", *x)]
        case "if" if not (type(x[0]) is tuple and x[0][0] in WAYS):
            return [x[0]]
        case "/":
            return [x[1]]
        case "%":
            return [x[1], _whole(("/", *x))]
        case "**" if isinstance(x[1], tuple):  # a power below zero
            return [x[0]]
        case "abs" | "sign" | "sqrt" | "atan2" | "pow":
            return [x[0]]
        case "log":
            return [*x, *(("-", base, 1.0) for base in x[1:])]
        case "hypot" if len(x) == 1:
            return [*x]
        case "floor":
            return [_whole(x[0])]
        case "tan":
            return [("cos", x[0])]
        case "asin" | "acos":
            return [("-", x[0], end) for end in (1.0, -1.0)]
        case "min" | "max":
            return [("-", *pair) for pair in combinations(x, 2)]
    return []


def _whole(x: Node) -> Node:
    """Return a tree that is zero if x is a whole number."""
    return "sin", ("*", math.pi, x)


EPS = float(np.finfo(float).eps)
STATE = 8.0 * EPS  # of the largest of the angles, or rates, that a series or an interpolant adds
_SAME = ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "sqrt", "sign", "floor")
OPERATIONS: dict[str, Callable[..., Any]] = {  # on arrays
    **NUMBER_OPERATIONS,
    **{name: getattr(np, name) for name in _SAME},
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "abs": np.abs,
    "min": lambda *x: np.minimum.reduce(np.broadcast_arrays(*x)),
    "max": lambda *x: np.maximum.reduce(np.broadcast_arrays(*x)),
    "hypot": lambda *x: np.sqrt(sum(each**2 for each in x)),
    "log": lambda x, *base: np.log(x) / np.log(*base) if base else np.log(x),
    "pow": np.power,
    "if": np.where,
    **{name: lambda a, b, holds=holds: holds(a, b) * 1.0 for name, holds in COMPARISONS.items()},
}


def _positive(x: Any) -> Any:
    return np.maximum(x, 0.0)


# slopes of functions, by their argument, how far it may be off, and the value
SLOPES: dict[str, Callable[[Any, Any, Any], Any]] = {
    "sin": lambda x, dx, value: np.minimum(np.abs(np.cos(x)) + dx, 1.0),
    "cos": lambda x, dx, value: np.minimum(np.abs(np.sin(x)) + dx, 1.0),
    "tan": lambda x, dx, value: 1.0 + np.maximum(np.tan(x - dx) ** 2, np.tan(x + dx) ** 2),
    "asin": lambda x, dx, value: 1.0 / np.sqrt(_positive(1.0 - (np.abs(x) + dx) ** 2)),
    "acos": lambda x, dx, value: 1.0 / np.sqrt(_positive(1.0 - (np.abs(x) + dx) ** 2)),
    "atan": lambda x, dx, value: 1.0 / (1.0 + _positive(np.abs(x) - dx) ** 2),
    "sinh": lambda x, dx, value: np.cosh(np.abs(x) + dx),
    "cosh": lambda x, dx, value: np.sinh(np.abs(x) + dx),
    "tanh": lambda x, dx, value: 1.0 - np.tanh(_positive(np.abs(x) - dx)) ** 2,
    "exp": lambda x, dx, value: np.exp(x + dx),
    "sqrt": lambda x, dx, value: 1.0 / np.maximum(value + np.sqrt(_positive(x - dx)), np.sqrt(dx)),
    "abs": lambda x, dx, value: 1.0,
    "sign": lambda x, dx, value: 0.0,
    "floor": lambda x, dx, value: 0.0,
}


def values_of(tree: Node, n: int, columns: StateColumns | None = None) -> Values:
    """Return an expression as a function of times t (k,) and states y (k, 2n or more)."""
    names = names_of(tree)

    def values(t: Array, y: Array) -> Array:
        known = {name: _variable(name, t, y, n, columns) for name in names}
        result = np.asarray(value_in(tree, known, OPERATIONS), float)
        return result if result.shape == t.shape else np.broadcast_to(result, t.shape)

    return values


def _variable(name: str, t: Array, y: Array, n: int, columns: StateColumns | None) -> Array:
    """Return the values of a variable at times t and states y."""
    if name == "t":
        return t
    if name.startswith(PREFIX):
        assert columns is not None
        return columns.values(name.removeprefix(PREFIX), t, y)
    return np.asarray(y[..., _place(name, n)])


def part_of(tree: Node, n: int, columns: StateColumns | None = None) -> Part:
    """Return an expression as a part of an event, for a mechanism of n joints."""

    def noise(t: Array, y: Array, large: Array) -> Array:
        off = np.maximum.reduce(np.abs(y[..., : 2 * n]), axis=-2, keepdims=True)
        np.maximum(off, large[:, None, : 2 * n], out=off)
        for part in (off[..., :n], off[..., n:]) if n > 1 else ():
            part[:] = np.maximum.reduce(part, axis=-1, keepdims=True)
        off *= STATE

        def leaf(x: float | str) -> tuple[Any, Any]:
            if not isinstance(x, str):
                return x, 0.0
            value = _variable(x, t, y, n, columns)
            if x == "t":
                return value, EPS * np.abs(t)
            if x.startswith(PREFIX):
                assert columns is not None
                return value, columns.noise(x.removeprefix(PREFIX), t, y, off)
            return value, off[..., _place(x, n)]

        return np.atleast_1d(fold(tree, leaf, _bounded)[1])

    return Part(values_of(tree, n, columns), noise)


def _place(name: str, n: int) -> int:
    """Return the place of q1.. or qd1.. in a state (q, qd) of n joints, here named from 0."""
    return int(name.lstrip("qd")) + n * name.startswith("qd")


def _bounded(node: tuple[Any, ...], parts: list[tuple[Any, Any]]) -> tuple[Any, Any]:
    """Return the value of an operation and the bound of its error, from those of its parts."""
    operation, (a, da), (b, db) = node[0], parts[0], parts[-1]
    if operation == "log" and len(parts) > 1:
        return _bounded(("/",), [_bounded(("log",), [part]) for part in parts])
    value = OPERATIONS[operation](*(x for x, _ in parts))
    match operation:
        case "neg":
            return value, da
        case "<" | "<=" | ">" | ">=":
            return value, 0.0
        case "if":
            return value, np.where(np.asarray(a) != 0.0, parts[1][1], db)
        case "min" | "max":
            return value, np.maximum.reduce(np.broadcast_arrays(*(error for _, error in parts)))
        case "+" | "-":
            # of a plain number there is none: a sum less, at many small calls
            error = da if isinstance(db, float) and db == 0.0 else da + db
        case "*":
            error = abs(a) * db + abs(b) * da + da * db
        case "/":
            error = np.divide(da + abs(value) * db, _positive(abs(b) - db))
        case "%":
            error = da + np.abs(np.floor(np.divide(a, b))) * db
        case "**" | "pow":
            error = _power(a, da, b, db)
        case "hypot":
            error = sum(error for _, error in parts)
        case "atan2":
            nearest = _positive(np.abs(a) - da) ** 2 + _positive(np.abs(b) - db) ** 2
            error = ((np.abs(b) + db) * da + (np.abs(a) + da) * db) / nearest
        case "log":
            error = np.divide(da, _positive(np.abs(a) - da))
        case _:
            error = SLOPES[operation](a, da, value) * da
    rounding = EPS if operation in ("+", "-", "*", "/", "%") else 2.0 * EPS
    return value, error + rounding * abs(value)


def _power(a: Any, da: Any, b: Any, db: Any) -> Any:
    """Return by how much a^b may be off where a and b are by da and db."""
    ends = _positive(abs(a) - da), abs(a) + da
    varies = bool(np.any(db))

    def largest(p: Any) -> Any:
        """Return the largest power |a|^p within the reach of the base."""
        powers = [np.power(x, y) for x in ends for y in ((p - db, p + db) if varies else (p,))]
        return np.maximum.reduce(np.broadcast_arrays(*powers))

    error = (abs(b) + db) * largest(b - 1.0) * da
    if varies:
        steepest = np.maximum(*(np.abs(np.log(x)) for x in ends))
        error = error + largest(b) * steepest * db
    return error
