"""Expressions as trees of numbers and names, and their folds: over numbers, and over text.

Every reader of an expression folds its tree (see `syntax.py`) over what it makes of one: numbers,
arrays, rows, text, dimensions.  There is one walk, and nothing but arithmetic in a tree.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from typing import Any, TypeVar

from robodyn.scene.syntax import FUNCTIONS, Node, NotAllowedError
from robodyn.scene.units import Quantity, scaled

T = TypeVar("T")

COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
OPERATIONS: dict[str, Callable[..., Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": operator.mod,
    "**": operator.pow,
    "pow": math.pow,  # a root of a negative number is outside its domain, not complex
    "neg": operator.neg,
    "if": lambda test, body, other: body if test else other,
    **COMPARISONS,
}


def _pow(x: float, exponent: float) -> float:
    try:
        return math.pow(x, exponent)
    except OverflowError:  # so that 1/cosh(x)^2 goes on to 0
        return math.copysign(math.inf, x) if exponent % 2.0 == 1.0 else math.inf


# what code of a tree needs
SCOPE: dict[str, object] = {f"_{name}": function for name, function in FUNCTIONS.items()}
SCOPE["_pow"] = _pow
# what no power series in time expands where it bends or jumps
BENDS = ("abs", "min", "max", "sign", "floor", "atan2")
_BENDING = {**dict.fromkeys(COMPARISONS, "a comparison"), "if": "`if`", "%": "%"}
_BENDING |= {name: f"{name}()" for name in BENDS}
NO_BENDS = "which bends or jumps: expressions of a scene are smooth; write a table"
TOO_LARGE = "a number that is too large"
SMOOTH = tuple(name for name in FUNCTIONS if name not in BENDS)


class ExpressionError(ValueError):
    """A fault in an operation of a tree, with that operation."""

    def __init__(self, what: str, node: Node) -> None:
        super().__init__(what)
        self.node = node


class NotLinearError(ValueError):
    """A tree is no sum of multiples of names."""


def fold(
    node: Node,
    leaf: Callable[[Any], T],
    apply: Callable[[tuple[Any, ...], list[T]], T],
    known: MutableMapping[int, T] | None = None,
) -> T:
    """Evaluate a tree: `leaf` for numbers, quantities and names, `apply` for operations.

    `apply` takes an operation (a node) and the results of its parts.  `known` stores results of
    operations by id from one fold to the next: a part shared by two trees is evaluated once.
    """
    if type(node) is not tuple:
        return leaf(node)
    if known is not None and id(node) in known:
        return known[id(node)]
    parts = []
    for part in node[1:]:
        parts.append(fold(part, leaf, apply, known))
    found = apply(node, parts)
    if known is not None:
        known[id(node)] = found
    return found


def walk(node: Node) -> Iterator[Node]:
    """Yield every node of a tree."""
    waiting = [node]
    while waiting:
        yield (found := waiting.pop())
        if type(found) is tuple:
            waiting += reversed(found[1:])


def names_of(node: Node) -> frozenset[str]:
    """The variables of a tree."""
    return frozenset(x for x in walk(node) if isinstance(x, str))


def changed(
    node: Node,
    change: Callable[[tuple[Any, ...]], Node],
    leaf: Callable[[Any], Node] = lambda leaf: leaf,
) -> Node:
    """The tree with its leaves changed, and its operations after their parts."""
    return fold(node, leaf, lambda old, parts: change((old[0], *parts)))


def without_units(node: Node) -> Node:
    """The tree with numbers in SI units for quantities."""
    return changed(node, lambda x: x, lambda x: x.total if isinstance(x, Quantity) else x)


def value_in(
    node: Node,
    values: Mapping[str, Any],
    operations: Mapping[str, Callable[..., Any]] = OPERATIONS,
) -> Any:
    """Evaluate a tree without units; KeyError for an unknown operation."""
    return fold(
        node,
        lambda x: values[x] if isinstance(x, str) else x,
        lambda old, parts: operations[old[0]](*parts),
    )


def check_smooth(nodes: Sequence[Node]) -> None:
    """Raise NotAllowedError unless this is one expression, which neither bends nor jumps."""
    if len(nodes) != 1:
        raise NotAllowedError("a comma: it is one expression")
    for node in walk(nodes[0]):
        if type(node) is tuple and node[0] in _BENDING:
            raise NotAllowedError(f"{_BENDING[node[0]]}, {NO_BENDS}")


# -- numbers -----------------------------------------------------------------------------------

_Scaled = tuple[float, int]  # a number, and a power of ten: `(200 + 150) mm` is the float 0.35


def number_of(node: Node) -> float | None:
    """The number that a tree is, in SI units; None for one with variables.

    Raises ExpressionError for a part without variables that has no number, and for a division by 0.
    """
    found = fold(node, _number, _calculated)
    if found is None:
        return None
    try:
        return float(scaled(*found))
    except OverflowError:
        raise ExpressionError(TOO_LARGE, node) from None


def _number(leaf: float | str | Quantity) -> _Scaled | None:
    if isinstance(leaf, Quantity):
        if math.isinf(leaf.total):
            raise ExpressionError(TOO_LARGE, leaf)
        return leaf.number, leaf.ten
    return None if isinstance(leaf, str) else (leaf, 0)


def _calculated(node: tuple[Any, ...], parts: list[_Scaled | None]) -> _Scaled | None:
    numbers = [x for x in parts if x is not None]
    operation = node[0]
    try:
        if len(numbers) == len(parts):
            return _operated(operation, numbers)
        if operation in "/%" and parts[1] and not parts[1][0]:
            raise ZeroDivisionError
    except ZeroDivisionError:
        raise ExpressionError("a division by zero", node) from None
    except OverflowError:
        raise ExpressionError(TOO_LARGE, node) from None
    except ValueError:
        what = "a root of a negative number" if operation == "pow" else ""
        told = what or f"{operation} of a number that has none"
        raise ExpressionError(told, node) from None
    return None


def _operated(operation: str, parts: list[_Scaled]) -> _Scaled:
    (a, i), (b, j) = parts[0], parts[-1]
    match operation:
        case "*":
            return a * b, i + j
        case "/":
            return a / b, i - j
        case "neg":
            return -a, i
        case "+" | "-" if i == j:
            return OPERATIONS[operation](a, b), i
        case "**" if i:
            k = scaled(b, j)
            return a**k, int(i * k)
    totals = [scaled(*part) for part in parts]
    return (OPERATIONS.get(operation) or FUNCTIONS[operation])(*totals), 0


def linear(node: Node) -> dict[str, float]:
    """The sum of multiples of names that a tree is: their coefficients, that of "" the constant.

    Raises NotLinearError for what is none, ArithmeticError where a coefficient is none.
    """
    return fold(node, lambda x: {x: 1.0} if isinstance(x, str) else {"": x}, _linear)


def _linear(node: tuple[Any, ...], parts: list[dict[str, float]]) -> dict[str, float]:
    operation, a, b = node[0], parts[0], parts[-1]
    numbers = [part.get("", 0.0) for part in parts]
    plain = [set(part) <= {""} for part in parts]
    if all(plain):
        return {"": value_in((operation, *numbers), {}, {**OPERATIONS, **FUNCTIONS})}
    match operation:
        case "+":
            return {name: a.get(name, 0.0) + b.get(name, 0.0) for name in {**a, **b}}
        case "-":
            return {name: a.get(name, 0.0) - b.get(name, 0.0) for name in {**a, **b}}
        case "neg":
            return {name: -x for name, x in a.items()}
        case "*" if any(plain):
            factor, other = (numbers[0], b) if plain[0] else (numbers[1], a)
            return {name: factor * x for name, x in other.items()}
        case "/" if plain[1]:
            return {name: x / numbers[1] for name, x in a.items()}
    raise NotLinearError("is no sum of multiples of joints")


# -- code --------------------------------------------------------------------------------------

# What binds the operations of Python: from a choice to what needs no parentheses.
_CHOICE, _COMPARED, _SUM, _PRODUCT, _SIGNED, _ATOM = range(6)
_BINDS = {**dict.fromkeys(COMPARISONS, _COMPARED), "+": _SUM, "-": _SUM}
_BINDS |= {"*": _PRODUCT, "/": _PRODUCT, "%": _PRODUCT}
_Bound = tuple[str, int]


def code_of(node: Node) -> str:
    """A tree without units as Python, its functions by names that begin with _ (`SCOPE`)."""
    return fold(node, _leaf_code, _code)[0]


def _leaf_code(leaf: float | str) -> _Bound:
    if isinstance(leaf, str):
        return leaf, _ATOM
    text = repr(float(leaf))
    return text, _ATOM if text[0].isdigit() else _SIGNED


def _code(node: tuple[Any, ...], parts: list[_Bound]) -> _Bound:
    def within(part: _Bound, least: int) -> str:
        return part[0] if part[1] >= least else f"({part[0]})"

    operation = node[0]
    if operation in _BINDS:
        binds = _BINDS[operation]
        first = binds + (binds == _COMPARED)  # a < b < c is another thing
        text = f"{within(parts[0], first)} {operation} {within(parts[1], binds + 1)}"
        return text, binds
    match operation:
        case "neg":
            return f"-{within(parts[0], _SIGNED)}", _SIGNED
        case "**":
            operation = "pow"
        case "if":
            test, body, other = (within(part, _COMPARED) for part in parts)
            return f"{body} if {test} else {other}", _CHOICE
    return f"_{operation}({', '.join(text for text, _ in parts)})", _ATOM
