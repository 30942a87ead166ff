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
from robodyn.runs.state_columns import PREFIX, ROUGH, StateColumns, variables
from robodyn.scene.constants import numbers_of
from robodyn.scene.expressions import changed, code_of, fold, names_of, walk
from robodyn.scene.quantities import expressions
from robodyn.scene.syntax import CONSTANTS, Node, NotAllowedError
from robodyn.tables.arrays import Array

Values = Callable[[Array, Array], Array]

_NAME = re.compile(r"[A-Za-z][\w-]{0,63}", re.ASCII)
LARGEST = 1e300  # of numbers in an event: sums of what they make stay among the floats
WAYS = {">": 1, ">=": 1, "<": -1, "<=": -1}
_SAME = ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "sqrt", "sign", "floor")
FUNCTIONS: dict[str, Callable[..., Any]] = {  # of expressions, on arrays
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
}
_SCOPE = {"__builtins__": {}, **{f"_{name}": each for name, each in FUNCTIONS.items()}}
_SCOPE |= {"_pow": np.power, "_where": np.where}


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

    Columns of states are taken from `columns`, which belong to a run.  Raises InputError that names
    `where` if the text is neither.
    """
    tree, way, strict = _read(mechanism, text, where)
    if columns is not None and any(x.startswith(PREFIX) for x in names_of(tree)):
        return _made(mechanism.n, name, tree, way, strict, columns)
    return _kept(mechanism.n, name, tree, way, strict)


@lru_cache(maxsize=256)
def _read(mechanism: Mechanism, text: str, where: str) -> tuple[Node, int, bool]:
    """Return the tree of an event's function, its way, and whether the comparison is strict."""
    try:
        constants = {**CONSTANTS, **numbers_of(mechanism.description.constants)}
        found = expressions(text, variables(mechanism), constants)
    except NotAllowedError as error:
        what = _INSTEAD.search(text)
        instead = f"; {_WRITE[what[0]]}" if what else ""
        raise InputError(f"an event does not allow {error}{instead}", where=where) from None
    except ValueError as error:
        equal = f"; {_WRITE['==']}" if re.search(r"[^<>]=", text) else ""
        raise InputError(
            repr(text), where=where, limit=f"is no expression: {error}{equal}"
        ) from None
    if len(found) != 1:
        raise InputError(repr(text), where=where, limit="must be one expression, without a comma")
    if not found[0].names:
        limit = "never changes: it names no t, q or qd, and no column"
        raise InputError(repr(text), where=where, limit=limit)
    tree, way, strict = found[0].node, 0, True
    if any(isinstance(x, float) and abs(x) > LARGEST for x in walk(tree)):
        limit = f"has a number above {LARGEST:g}: what it makes leaves the floats"
        raise InputError(repr(text), where=where, limit=limit)
    if type(tree) is tuple and tree[0] in WAYS:
        operation, left, right = tree
        if any(type(side) is tuple and side[0] in WAYS for side in (left, right)):
            raise InputError(repr(text), where=where, limit="compares a comparison")
        way, strict = WAYS[operation], operation in "<>"
        tree = "-", left, right
    return tree, way, strict


@lru_cache(maxsize=256)
def _kept(n: int, name: str, tree: Node, way: int, strict: bool) -> EventFunction:
    return _made(n, name, tree, way, strict, None)


def _made(
    n: int, name: str, tree: Node, way: int, strict: bool, columns: StateColumns | None
) -> EventFunction:
    def parts(node: Node) -> dict[str, Any]:
        return {"values": vectorised(node, n, columns), "noise": bound_of(node, n, columns)}

    cuts = tuple(Part(**parts(x)) for x in switches(tree))
    return EventFunction(
        **parts(tree),
        name=name,
        way=way,
        strict=strict,
        switches=cuts,
        has_one_sign=has_one_sign(tree),
        computed=bool(_computed(tree)),
    )


def _computed(tree: Node) -> list[str]:
    """Return the variables of an expression that are columns of states, sorted."""
    return sorted(x for x in names_of(tree) if x.startswith(PREFIX))


def event_functions(
    mechanism: Mechanism, given: Mapping[str, str], columns: StateColumns | None = None
) -> tuple[EventFunction, ...]:
    """Return event functions by name; raise InputError for a bad name or expression."""
    if type(given) is not dict and not isinstance(given, Mapping):
        kind = type(given).__name__
        raise InputError("events", value=kind, limit="must be a mapping of names to expressions")
    found = []
    for name, text in given.items():
        _check(name, text)
        if not _NAME.fullmatch(name):
            limit = "must be a letter, then letters, digits, _ or -"
            raise InputError("name of an event", value=name, limit=limit)
        found.append(event_function(mechanism, name, text, f"event {name}", columns))
    return tuple(found)


def must_be_text(what: str, value: object) -> None:
    """Raise InputError if a value is not text."""
    if not isinstance(value, str):
        raise InputError(what, value=repr(value), limit="must be text, such as 'q1 > 90deg'")


def _check(name: object, text: object) -> None:
    must_be_text("name of an event", name)
    must_be_text(f"event {name}", text)


def _for_arrays(node: tuple[Any, ...]) -> Node:
    """Rewrite `a if b else c` and comparisons for numpy arrays."""
    if node[0] in WAYS:
        return "*", node, 1.0
    return ("where", *node[1:]) if node[0] == "if" else node


def vectorised(tree: Node, n: int, columns: StateColumns | None = None) -> Values:
    """Return an expression as a function of arrays t (k,), y (k, 2n or more); nan if undefined."""
    lines = [
        f"{name}{k} = y[:, {k + first}]"
        for name, first in (("q", 0), ("qd", n))
        for k in range(n)
        if f"{name}{k}" in names_of(tree)
    ]
    lines += [f"{x} = columns({x.removeprefix(PREFIX)!r}, t, y)" for x in _computed(tree)]
    body = "\n    ".join([*lines, f"return {code_of(changed(tree, _for_arrays))}"])
    scope: dict[str, Any] = {**_SCOPE, "columns": None if columns is None else columns.values}
    exec(compile(f"def values(t, y):\n    {body}\n", "<robodyn event>", "exec"), scope)
    function = scope["values"]

    def values(t: Array, y: Array) -> Array:
        found = np.asarray(function(t, y), float)
        return found if found.shape == t.shape else np.broadcast_to(found, t.shape)

    return values


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
    found = fold(tree, lambda x: {}, _switches)
    return [switch for switch in found if names_of(switch)]


def _switches(node: tuple[Any, ...], parts: list[dict[Node, None]]) -> dict[Node, None]:
    found = {switch: None for part in parts for switch in part}
    return found | dict.fromkeys(switches_of(*node))


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


Bounded = tuple[Any, Any]  # values, and bounds of their errors

EPS = float(np.finfo(float).eps)
STATE = 8.0 * EPS  # of the largest of the angles, or rates, that a series or an interpolant adds
# of functions, by their argument, how far it may be off, and the value
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


def _positive(x: Any) -> Any:
    return np.maximum(x, 0.0)


def bound_of(
    tree: Node, n: int, columns: StateColumns | None = None
) -> Callable[[Array, Array, Array], Array]:
    """Return a function that bounds the rounding error of an expression: see `Part.noise`."""

    def bound(t: Array, y: Array, large: Array) -> Array:
        off = np.maximum.reduce(np.abs(y[..., : 2 * n]), axis=-2, keepdims=True)
        np.maximum(off, large[:, None, : 2 * n], out=off)
        for part in (off[..., :n], off[..., n:]) if n > 1 else ():
            part[:] = np.maximum.reduce(part, axis=-1, keepdims=True)
        off *= STATE
        known = _known(t, y, off, n)

        def each(name: str) -> Bounded:
            if columns is None or not name.startswith(PREFIX):
                return known(name)
            values = columns.values(name.removeprefix(PREFIX), t, y)
            return values, ROUGH * np.abs(values).max(axis=-1, keepdims=True)

        return np.atleast_1d(_bounded(tree, each)[1])

    return bound


def _known(t: Array, y: Array, off: Array, n: int) -> Callable[[str], Bounded]:
    def known(name: str) -> Bounded:
        if name == "t":
            return t, EPS * np.abs(t)
        column = int(name.lstrip("qd")) + n * name.startswith("qd")
        return y[..., column], off[..., column]

    return known


def _bounded(tree: Node, known: Callable[[str], Bounded]) -> Bounded:
    return fold(tree, lambda x: known(x) if isinstance(x, str) else (x, 0.0), _operated)


def _operated(node: tuple[Any, ...], parts: list[Bounded]) -> Bounded:
    operation, (a, da), (b, db) = node[0], parts[0], parts[-1]
    match operation:
        case "neg":
            return -a, da
        case "<" | "<=" | ">" | ">=":
            return (a > b if operation[0] == ">" else a < b) * 1.0, 0.0
        case "if":
            _, (x, dx), _ = parts
            chosen = np.asarray(a) != 0.0
            return np.where(chosen, x, b), np.where(chosen, dx, db)
        case "**" | "pow":
            return _power(parts[0], parts[1])
        case "+" | "-":
            value = a + b if operation == "+" else a - b
            # of a plain number there is none: a sum less, at many small calls
            error = da if isinstance(db, float) and db == 0.0 else da + db
        case "*":
            value, error = a * b, abs(a) * db + abs(b) * da + da * db
        case "/":
            value = np.divide(a, b)
            error = np.divide(da + abs(value) * db, _positive(abs(b) - db))
        case "%":
            value, error = np.mod(a, b), da + np.abs(np.floor(np.divide(a, b))) * db
        case _:
            return _called(operation, parts)
    return value, error + EPS * abs(value)


def _power(base: Bounded, exponent: Bounded) -> Bounded:
    (a, da), (b, db) = base, exponent
    value = np.power(a, b)
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
    return value, error + 2.0 * EPS * abs(value)


def _called(name: str, args: list[Bounded]) -> Bounded:
    (x, dx), *others = args
    match name:
        case "min" | "max":
            reduce = np.minimum.reduce if name == "min" else np.maximum.reduce
            values = np.broadcast_arrays(*(a for a, _ in args))
            errors = np.broadcast_arrays(*(da for _, da in args))
            return reduce(values), np.maximum.reduce(errors)
        case "hypot":
            value = np.sqrt(sum(a**2 for a, _ in args))
            error = sum(da for _, da in args)
        case "atan2":
            b, db = others[0]
            value = np.arctan2(x, b)
            nearest = _positive(np.abs(x) - dx) ** 2 + _positive(np.abs(b) - db) ** 2
            error = ((np.abs(b) + db) * dx + (np.abs(x) + dx) * db) / nearest
        case "log":
            value, error = np.log(x), np.divide(dx, _positive(np.abs(x) - dx))
            if others:
                base = _called("log", others)
                return _operated(("/",), [(value, error + 2.0 * EPS * np.abs(value)), base])
        case _:
            value = FUNCTIONS[name](x)
            error = SLOPES[name](x, dx, value) * dx
    return value, error + 2.0 * EPS * np.abs(value)
