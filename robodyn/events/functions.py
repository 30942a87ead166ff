"""Events as people write them: `q1 > 90deg`, or `qd1`, a function whose changes of sign count.

An expression knows the time t, the joints' q1.. and qd1.., and takes what torques take.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from robodyn.errors import InputError
from robodyn.events.rounding import Bounded, around_of, bound_of
from robodyn.events.smooth_parts import has_one_sign, switches
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.expression_units import state_dimension
from robodyn.scene.expressions import NotAllowedError, Written, state_names
from robodyn.scene.syntax import FUNCTIONS
from robodyn.tables.arrays import Array

Values = Callable[[Array, Array], Array]

_NAME = re.compile(r"[A-Za-z][\w-]{0,63}", re.ASCII)
LARGEST = 1e300  # of numbers in an event: sums of what they make stay among the floats
WAYS = {ast.Gt: 1, ast.GtE: 1, ast.Lt: -1, ast.LtE: -1}
_ARRAYS: dict[str, Callable[..., Any]] = {
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "abs": np.abs,
    "min": lambda *x: np.minimum.reduce(np.broadcast_arrays(*x)),
    "max": lambda *x: np.maximum.reduce(np.broadcast_arrays(*x)),
    "hypot": lambda *x: np.sqrt(sum(each**2 for each in x)),
    "log": lambda x, base=math.e: np.log(x) / np.log(base),
}


@dataclass(frozen=True)
class Part:
    """A function of time and state: `values(t (k,), y (k, 2n or more))`, nan where undefined.

    `noise` (k,), of the same, bounds what rounding may have added to them.  `around` has them
    in the middle of boxes, and how far they go from there (`rounding.around_of`); or is not known.
    """

    values: Values
    noise: Values
    around: Callable[[Array, Array, Array, Array], Bounded] | None = field(
        default=None, kw_only=True
    )


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

    `way` 1: where it becomes positive, -1: negative, 0: both.  Where it stays at zero a comparison
    holds if it has an equality (not `strict`).  It is smooth where none of its `switches`, which
    are smooth between zeros of those before them, passes zero.  Where it is seen to have one sign,
    it may touch zero, but not pass.
    """

    name: str
    way: int
    strict: bool
    switches: tuple[Part, ...]
    has_one_sign: bool = False


@lru_cache(maxsize=256)
def event_function(mechanism: Mechanism, name: str, text: str, where: str) -> EventFunction:
    """The event at which a comparison becomes true, or at which a function passes zero.

    Raises InputError, naming `where`, for what is neither.
    """
    names, known = state_names(mechanism.n)
    try:
        written = Written(text, names, known, dimensions=state_dimension(mechanism.slides))
    except NotAllowedError as error:
        what = _INSTEAD.search(text)
        instead = f"; {_WRITE[what[0]]}" if what else ""
        raise InputError(f"an event does not allow {error}{instead}", where=where) from None
    except ValueError as error:
        equal = f"; {_WRITE['==']}" if re.search(r"[^=<>!]=[^=]", text) else ""
        raise InputError(
            repr(text), where=where, limit=f"is no expression: {error}{equal}"
        ) from None
    if len(written.codes) != 1:
        raise InputError(repr(text), where=where, limit="must be one expression, without a comma")
    if not written.names:
        raise InputError(repr(text), where=where, limit="never changes: it names no t, q or qd")
    tree, way, strict = ast.parse(written.codes[0], mode="eval").body, 0, True
    numbers = [x.value for x in ast.walk(tree) if isinstance(x, ast.Constant)]
    if any(isinstance(x, int | float) and abs(x) > LARGEST for x in numbers):
        limit = f"has a number above {LARGEST:g}: what it makes leaves the floats"
        raise InputError(repr(text), where=where, limit=limit)
    if isinstance(tree, ast.Compare):
        if any(isinstance(side, ast.Compare) for side in (tree.left, *tree.comparators)):
            raise InputError(repr(text), where=where, limit="compares a comparison")
        way, strict = WAYS[type(tree.ops[0])], isinstance(tree.ops[0], ast.Gt | ast.Lt)
        tree = ast.BinOp(tree.left, ast.Sub(), *tree.comparators)
    n = mechanism.n
    cuts = tuple(
        Part(_vectorised(x, n), bound_of(x, n), around=around_of(x, n)) for x in switches(tree)
    )
    made: tuple[Any, ...] = _vectorised(tree, n), bound_of(tree, n)
    made += name, way, strict, cuts, has_one_sign(tree)
    return EventFunction(*made, around=around_of(tree, n))


def event_functions(mechanism: Mechanism, given: Mapping[str, str]) -> tuple[EventFunction, ...]:
    """Events by their names; InputError for a name or an expression that is none."""
    if type(given) is not dict and not isinstance(given, Mapping):
        kind = type(given).__name__
        raise InputError("events", value=kind, limit="must be a mapping of names to expressions")
    try:
        return _functions(mechanism, tuple(given.items()))
    except TypeError:  # what cannot be remembered is no text
        for name, text in given.items():
            _check(name, text)
        raise


def must_be_text(what: str, value: object) -> None:
    """Raise InputError where a value is no text."""
    if not isinstance(value, str):
        raise InputError(what, value=repr(value), limit="must be text, such as 'q1 > 90deg'")


def _check(name: object, text: object) -> None:
    must_be_text("name of an event", name)
    must_be_text(f"event {name}", text)


@lru_cache(maxsize=64)
def _functions(
    mechanism: Mechanism, given: tuple[tuple[str, str], ...]
) -> tuple[EventFunction, ...]:
    for name, text in given:
        _check(name, text)
        if not _NAME.fullmatch(name):
            limit = "must be a letter, then letters, digits, _ or -"
            raise InputError("name of an event", value=name, limit=limit)
    return tuple(event_function(mechanism, name, text, f"event {name}") for name, text in given)


class _Chosen(ast.NodeTransformer):
    """`a if b else c` of arrays, and comparisons as 0.0 and 1.0."""

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        return ast.BinOp(self.generic_visit(node), ast.Mult(), ast.Constant(1.0))  # type: ignore[arg-type]

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        parts = [self.visit(part) for part in (node.test, node.body, node.orelse)]
        return ast.Call(ast.Name("_where", ast.Load()), parts, [])


def _vectorised(tree: ast.expr, n: int) -> Values:
    scope: dict[str, Any] = {"__builtins__": {}, "_where": np.where, "_pow": np.power}
    for name in FUNCTIONS:
        scope[f"_{name}"] = _ARRAYS.get(name) or getattr(np, name)
    copied = ast.parse(ast.unparse(ast.fix_missing_locations(tree)), mode="eval").body
    text = ast.unparse(ast.fix_missing_locations(_Chosen().visit(copied)))
    used = set(re.findall(r"\bqd?\d+\b", text))
    columns = [
        f"{name}{k} = y[:, {k + first}]"
        for name, first in (("q", 0), ("qd", n))
        for k in range(n)
        if f"{name}{k}" in used
    ]
    body = "\n    ".join([*columns, f"return {text}"])
    exec(compile(f"def values(t, y):\n    {body}\n", "<robodyn event>", "exec"), scope)
    function = scope["values"]

    def values(t: Array, y: Array) -> Array:
        found = np.asarray(function(t, y), float)
        return found if found.shape == t.shape else np.broadcast_to(found, t.shape)

    return values


def named_events(mechanism: Mechanism, texts: Iterable[str], taken: str) -> dict[str, str]:
    """The expressions of NAME=EXPR by their names; InputError, naming --event, for what is none.

    None may have the name that is `taken`.
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
