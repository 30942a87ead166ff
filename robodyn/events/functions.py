"""Events as people write them: `q1 > 90deg`, or `qd1`, a function whose changes of sign count.

An expression knows the time t, the joints' q1.. and qd1.., and takes what torques take.

Between the zeros of its switches an expression is smooth: `abs(x)` bends where x passes zero,
`floor(x)` jumps where sin(pi x) does, `a if b > c else d` may jump where b - c does, `sqrt(x)` ends
there.

How far an expression is from its value at a point, by rounding or in a box: each operation hands on
how far its operands may be off by its largest slopes in that reach, and adds a rounding of its
own.  None of the expression's switches may pass zero in the reach: what jumps stays as it is at the
point.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np

from robodyn.errors import InputError
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


def switches(tree: ast.expr) -> list[ast.expr]:
    """Functions between whose zeros the expression is smooth, each once, what they hold first."""
    found: dict[str, ast.expr] = {}
    for switch in _all(tree):
        found.setdefault(ast.unparse(ast.fix_missing_locations(switch)), switch)
    return list(found.values())


def has_one_sign(node: ast.expr) -> bool:
    """Whether an expression says that it is nowhere below zero: abs(x), sqrt(x), their powers."""
    match node:
        case ast.Call(func=ast.Name(id="_abs" | "_sqrt" | "_hypot")):
            return True
        case ast.BinOp(left=left, op=ast.Sub(), right=ast.Constant(value=0)):
            return has_one_sign(left)
        case (
            ast.BinOp(left=left, op=ast.Pow()) | ast.Call(func=ast.Name(id="_pow"), args=[left, _])
        ):
            return has_one_sign(left)
    return False


def _all(node: ast.expr) -> Iterator[ast.expr]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            yield from _all(child)
    for switch in _own(node):
        if any(isinstance(x, ast.Name) and not x.id.startswith("_") for x in ast.walk(switch)):
            yield switch


def _own(node: ast.expr) -> list[ast.expr]:
    """The switches of a node, less those of its parts."""
    match node:
        case ast.Compare(left=left, comparators=[right]):
            return [_less(left, right)]
        case ast.IfExp(test=test) if not isinstance(test, ast.Compare):
            return [test]
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return [right]
        case ast.BinOp(left=left, op=ast.Mod(), right=right):
            return [right, _whole(ast.BinOp(left, ast.Div(), right))]
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            try:
                positive = float(ast.literal_eval(right)) >= 0.0
            except ValueError:
                positive = False
            return [] if positive else [left]
        case ast.Call(func=ast.Name(id=name), args=args):
            return _of_call(name, args)
    return []


def _of_call(name: str, args: list[ast.expr]) -> list[ast.expr]:
    match name:
        case "_abs" | "_sign" | "_sqrt" | "_atan2" | "_pow":
            return args[:1]
        case "_log":
            return [*args, *(_less(base, ast.Constant(1.0)) for base in args[1:])]
        case "_hypot" if len(args) == 1:
            return args
        case "_floor":
            return [_whole(args[0])]
        case "_tan":
            return [ast.Call(ast.Name("_cos", ast.Load()), args, [])]
        case "_asin" | "_acos":
            return [_less(args[0], ast.Constant(x)) for x in (1.0, -1.0)]
        case "_min" | "_max":
            return [_less(a, b) for a, b in combinations(args, 2)]
    return []


def _less(left: ast.expr, right: ast.expr) -> ast.expr:
    return ast.BinOp(left, ast.Sub(), right)


def _whole(x: ast.expr) -> ast.expr:
    """What passes zero where x is a whole number."""
    turned = ast.BinOp(ast.Constant(math.pi), ast.Mult(), x)
    return ast.Call(ast.Name("_sin", ast.Load()), [turned], [])


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
ARRAYS: dict[str, Callable[..., Any]] = {"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan}


def _positive(x: Any) -> Any:
    return np.maximum(x, 0.0)


def bound_of(tree: ast.expr, n: int) -> Callable[[Array, Array], Array]:
    """The bound (..., k or 1) on the rounding of an expression's values along a step.

    Those are at its times (..., k), of its states (..., k, 2n or more).
    """

    def bound(t: Array, y: Array) -> Array:
        off = np.maximum.reduce(np.abs(y[..., : 2 * n]), axis=-2, keepdims=True)
        for part in (off[..., :n], off[..., n:]) if n > 1 else ():
            part[:] = np.maximum.reduce(part, axis=-1, keepdims=True)
        off *= STATE
        return np.atleast_1d(_bounded(tree, _known(t, t, y, off, n))[1])

    return bound


def around_of(tree: ast.expr, n: int) -> Callable[[Array, Array, Array, Array], Bounded]:
    """An expression's values (k,) in the middle of boxes, and how far they go from there.

    Those are times from begin (k,) to end, and states as far as dy (k, 2n..) from y.
    """

    def around(begin: Array, end: Array, y: Array, dy: Array) -> Bounded:
        return _bounded(tree, _known(begin, end, y, dy, n))

    return around


def _known(begin: Array, end: Array, y: Array, dy: Array, n: int) -> Callable[[str], Bounded]:
    def known(name: str) -> Bounded:
        if name == "t":
            half = 0.5 * (end - begin)
            t = begin + half
            return t, np.abs(half) + EPS * np.abs(t)
        column = int(name.lstrip("qd")) + n * name.startswith("qd")
        return y[..., column], dy[..., column]

    return known


def _bounded(node: ast.expr, known: Callable[[str], Bounded]) -> Bounded:
    match node:
        case ast.Constant(value=value):
            return float(value), 0.0  # type: ignore[arg-type]
        case ast.Name(id=name):
            return known(name)
        case ast.UnaryOp(op=op, operand=operand):
            value, error = _bounded(operand, known)
            return (-value if isinstance(op, ast.USub) else value), error
        case ast.BinOp(left=left, op=op, right=right):
            return _operated(op, _bounded(left, known), _bounded(right, known))
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            a, b = _bounded(left, known)[0], _bounded(right, known)[0]
            above = isinstance(op, ast.Gt | ast.GtE)
            return (a > b if above else a < b) * 1.0, 0.0
        case ast.IfExp(test=test, body=body, orelse=orelse):
            chosen = np.asarray(_bounded(test, known)[0]) != 0.0
            (a, da), (b, db) = _bounded(body, known), _bounded(orelse, known)
            return np.where(chosen, a, b), np.where(chosen, da, db)
        case ast.Call(func=ast.Name(id=name), args=args):
            return _called(name[1:], [_bounded(x, known) for x in args])
    raise TypeError(ast.dump(node))


def _operated(op: ast.operator, left: Bounded, right: Bounded) -> Bounded:
    (a, da), (b, db) = left, right
    match op:
        case ast.Add() | ast.Sub():
            value = a + b if isinstance(op, ast.Add) else a - b
            # of a plain number there is none: a sum less, at many small calls
            error = da if isinstance(db, float) and db == 0.0 else da + db
        case ast.Mult():
            value, error = a * b, abs(a) * db + abs(b) * da + da * db
        case ast.Div():
            value = np.divide(a, b)
            error = np.divide(da + abs(value) * db, _positive(abs(b) - db))
        case ast.Mod():
            value, error = np.mod(a, b), da + np.abs(np.floor(np.divide(a, b))) * db
        case _:
            return _power(left, right)
    return value, error + EPS * abs(value)


def _power(base: Bounded, exponent: Bounded) -> Bounded:
    (a, da), (b, db) = base, exponent
    value = np.power(a, b)
    ends = _positive(abs(a) - da), abs(a) + da
    varies = bool(np.any(db))

    def largest(p: Any) -> Any:
        """Of the powers of a in its reach."""
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
        case "pow":
            return _power(args[0], args[1])
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
                return _operated(ast.Div(), (value, error + 2.0 * EPS * np.abs(value)), base)
        case _:
            value = (ARRAYS.get(name) or getattr(np, name))(x)
            error = SLOPES[name](x, dx, value) * dx
    return value, error + 2.0 * EPS * np.abs(value)
