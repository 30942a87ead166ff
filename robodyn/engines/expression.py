"""Arithmetic recorded as a graph.

A formula evaluated on `Expression`s instead of floats leaves a graph: constants are folded, zero
terms dropped, equal subexpressions shared.  `engines/straightline.py` writes it out as
straight-line Python, `engines/segment.py` as machine code; `engines/array_blocks.py` evaluates it
on arrays.

A number that code takes as an argument is a parameter.  Values computed from parameters alone count
as constants: they move to the front of products, and code evaluates them once per call.

Derivatives are exact: tangents are propagated forward along the graph, from inputs to outputs.  A
node that does not depend on an input has no tangent in it, so structural zeros cost nothing.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Container, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, Union

Value = Union["Expression", float]

# Cost of an operation in additions, for judging from how many states on machine code pays.
COST = {"+": 1.0, "-": 1.0, "*": 1.0, "/": 1.5, "neg": 0.5}
FUNCTIONS: tuple[str, ...] = ("sin", "cos", "tan", "sqrt", "exp", "log", "tanh", "sinh", "cosh")
FUNCTIONS += ("atan", "asin", "acos", "floor")
COST |= dict.fromkeys((*FUNCTIONS, "pow"), 4.0)
COST |= {"abs": 0.5, "choose": 1.0, "atan2": 8.0, "rough": 2.0}
INPUTS = ("var", "par")
_NUMBER: dict[str, Callable[..., float]] = {name: getattr(math, name) for name in FUNCTIONS}
_NUMBER |= {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}
_NUMBER |= {"neg": operator.neg, "abs": abs, "pow": math.pow, "rough": math.pow}
_NUMBER |= {"atan2": math.atan2, "keep": lambda a: a}
_NUMBER["choose"] = lambda x, y, a, b: a if x < y else b


class Graph:
    """The shared nodes of one formula.

    A parameter equal to 0, 1 or -1 is folded, and belongs to the shape of the code.
    """

    def __init__(self) -> None:
        self.nodes: list[Expression] = []
        self.parameters: dict[str, float] = {}  # what `parameter` was told
        self.zeros: list[Expression] = []  # of parameters alone; taken for 0, as they are now
        self._known: dict[tuple[object, ...], Expression] = {}

    def variable(self, name: str) -> Expression:
        """Return the input called `name`."""
        return self.node("var", (name,))

    def parameter(self, name: str, number: float) -> Value:
        """Return a parameter: a number that may differ in the next call."""
        if number in (0.0, 1.0, -1.0):
            return float(number)
        self.parameters[name] = float(number)
        return self.node("par", (name,))

    def node(self, op: str, args: tuple[Value | str, ...]) -> Expression:
        """Return the only node with this operation and these arguments."""
        found = self._known.get((op, args))
        if found is None:
            found = self._known[op, args] = Expression(self, op, args, len(self.nodes))
            self.nodes.append(found)
        return found


def negate(a: Value) -> Value:
    """Return -a; the sign moves inward if that costs nothing."""
    if not isinstance(a, Expression):
        return -a
    x = a.args
    if a.op == "neg":
        return _value(x[0])
    if a.op == "-":
        return a.graph.node("-", (x[1], x[0]))
    if a.op == "*" and _constant(x[0]):
        return a.graph.node("*", (negate(_value(x[0])), x[1]))
    return a.graph.node("neg", (a,))


def add(a: Value, b: Value) -> Value:
    """Return a + b; a sum with a negated term becomes a difference."""
    if not isinstance(a, Expression):
        if not isinstance(b, Expression):
            return a + b
        a, b = b, a
    if not isinstance(b, Expression):
        if b == 0.0:
            return a
        return a.graph.node("+", (a, float(b)))
    if a is b:
        return multiply(2.0, a)
    for x, y in ((a, b), (b, a)):
        if _negative(y):
            positive = negate(y)
            return 0.0 if positive is x else _unless_zero(x.graph.node("-", (x, positive)))
    first, second = (a, b) if a.index < b.index else (b, a)
    return _unless_zero(a.graph.node("+", (first, second)))


def _unless_zero(a: Expression) -> Value:
    """Return a sum, or 0 if its parameters cancel, which belongs to the code's shape."""
    if a.number != 0.0:
        return a
    a.graph.zeros.append(a)
    return 0.0


def multiply(a: Value, b: Value) -> Value:
    """Return a b; zeros, ones and constant factors are folded, signs move out."""
    if not isinstance(a, Expression):
        if not isinstance(b, Expression):
            return a * b
        if a == 0.0:
            return 0.0
        if a == 1.0:
            return b
        if a == -1.0:
            return negate(b)
        return _scaled(float(a), b)
    if not isinstance(b, Expression):
        return multiply(b, a)
    if a.constant != b.constant:
        return _scaled(a, b) if a.constant else _scaled(b, a)
    if a.op == "neg":
        return negate(multiply(_value(a.args[0]), b))
    if b.op == "neg":
        return negate(multiply(a, _value(b.args[0])))
    for x, y in ((a, b), (b, a)):  # constant factors gather in front
        if _has_factor(x):
            return multiply(_value(x.args[0]), multiply(_value(x.args[1]), y))
    first, second = (a, b) if a.index < b.index else (b, a)
    return a.graph.node("*", (first, second))


def _scaled(a: Value, b: Expression) -> Value:
    """Return a b for a constant a."""
    if _has_factor(b):
        return multiply(multiply(a, _value(b.args[0])), _value(b.args[1]))
    if b.op == "neg":
        return multiply(negate(a), _value(b.args[0]))
    if a in (0.5, 2.0) and _factored(b):  # exact
        x, y = (multiply(a, _value(term)) for term in b.args)
        return x + y if b.op == "+" else x - y
    return b.graph.node("*", (a, b))


def _factored(a: Value | str, depth: int = 8) -> bool:
    """Return whether a, or each term of a short sum, has a constant factor."""
    if not isinstance(a, Expression) or not depth:
        return False
    if a.op == "*":
        return _has_factor(a)
    return a.op in ("+", "-") and all(_factored(x, depth - 1) for x in a.args)


def divide(a: Value, b: Value) -> Value:
    """Return a / b; division by a constant becomes a multiplication."""
    if not isinstance(b, Expression):
        return a * (1.0 / b)
    if not isinstance(a, Expression) and a == 0.0:
        return 0.0
    if isinstance(a, Expression) and a.op == "neg":
        return negate(divide(_value(a.args[0]), b))
    if b.constant and a != 1.0:
        return multiply(a, divide(1.0, b))
    return b.graph.node("/", (a, b))


class Expression:
    """A node: an operation on earlier nodes and constants.  Operators fold and simplify."""

    __slots__ = ("args", "graph", "index", "number", "op")
    imag = 0.0

    def __init__(self, graph: Graph, op: str, args: tuple[Value | str, ...], index: int) -> None:
        self.graph, self.op, self.args, self.index = graph, op, args, index
        self.number = self._number()  # of parameters alone: its value now

    @property
    def real(self) -> Expression:
        """The node itself: all expressions are real numbers."""
        return self

    @property
    def constant(self) -> bool:
        """Whether it is computed from parameters alone."""
        return self.number is not None

    def _number(self) -> float | None:
        if self.op in INPUTS:
            return self.graph.parameters[str(self.args[0])] if self.op == "par" else None
        for a in self.args:
            if isinstance(a, Expression) and a.number is None:
                return None
        values = [a.number if isinstance(a, Expression) else a for a in self.args]
        try:
            return float(_NUMBER[self.op](*values))
        except (ArithmeticError, ValueError):
            return math.nan

    __add__ = __radd__ = add
    __mul__ = __rmul__ = multiply
    __truediv__ = divide
    __neg__ = negate

    def __sub__(self, other: Value) -> Value:
        return add(self, negate(other))

    def __rsub__(self, other: float) -> Value:
        return add(other, negate(self))

    def __rtruediv__(self, other: float) -> Value:
        return divide(other, self)

    def __abs__(self) -> Value:
        return self.graph.node("abs", (self,))

    def __pow__(self, exponent: float) -> Value:
        return multiply(self, self) if exponent == 2 else power(self, exponent)


def power(a: Value, exponent: float) -> Value:
    """Return a to a constant exponent."""
    if isinstance(a, Expression):
        return a.graph.node("pow", (a, exponent))
    return math.pow(a, exponent)


def call(name: str, a: Value) -> Value:
    """Return the function `name` of a."""
    if not isinstance(a, Expression):
        return float(getattr(math, name)(a))
    if a.op != "neg" or name not in ("cos", "sin"):
        return a.graph.node(name, (a,))
    found = call(name, _value(a.args[0]))
    return negate(found) if name == "sin" else found


cos, sin = partial(call, "cos"), partial(call, "sin")


def rough_power(a: Value, exponent: float) -> Value:
    """Return a power of a >= 0 within 7 %, finite at 0, for step lengths."""
    a = greatest(a, 1e-300)
    return a.graph.node("rough", (a, exponent)) if isinstance(a, Expression) else a**exponent


def arctangent(y: Value, x: Value) -> Value:
    """Return the angle of (x, y), atan2(y, x)."""
    node = y if isinstance(y, Expression) else x
    if isinstance(node, Expression):
        return node.graph.node("atan2", (y, x))
    return math.atan2(y, node)  # type: ignore[arg-type]


def keep(a: Value) -> Value:
    """Return a as an opaque node: its factors do not move into later products."""
    if not isinstance(a, Expression) or a.op in (*INPUTS, "keep"):
        return a
    return a.graph.node("keep", (a,))


def choose(x: Value, y: Value, a: Value, b: Value) -> Value:
    """Return a if x < y, else b (also if x or y is nan).  Both are evaluated."""
    for known in (x, y, a, b):
        if isinstance(known, Expression):
            return a if a is b else known.graph.node("choose", (x, y, a, b))
    return a if x < y else b  # type: ignore[operator]


def least(a: Value, b: Value) -> Value:
    """Return the smaller number, as `min(a, b)`."""
    return choose(b, a, b, a)


def greatest(a: Value, b: Value) -> Value:
    """Return the larger number, as `max(a, b)`."""
    return choose(a, b, b, a)


def cost(outputs: Sequence[Value]) -> float:
    """Return the cost of evaluating the outputs, in additions."""
    return sum(COST.get(node.op, 0.0) for node in needed(outputs) if not node.constant)


def _has_factor(a: Expression) -> bool:
    """Return whether a product has a leading constant, or a number before parameters."""
    if a.op != "*":
        return False
    return _constant(a.args[0]) and not (a.constant and isinstance(a.args[0], Expression))


def _constant(a: Value | str) -> bool:
    return a.number is not None if isinstance(a, Expression) else True


def _value(a: Value | str) -> Value:
    assert not isinstance(a, str)
    return a


def _negative(a: Expression) -> bool:
    if a.op != "*":
        return a.op == "neg"
    first = _value(a.args[0])
    if not isinstance(first, Expression):
        return first < 0.0
    indices = [x.index for x in first.args if isinstance(x, Expression)]
    if first.op == "-" and len(indices) == 2:  # of a - b and b - a of constants one is used
        return indices[0] > indices[1]
    return first.op == "neg"


def rewritten(
    outputs: Sequence[Value], rule: Callable[[Expression, tuple[Any, ...]], Value]
) -> list[Value]:
    """Return the outputs with every node replaced by `rule(node, new arguments)`."""
    found: dict[int, Value] = {}

    def now(a: Any) -> Any:
        return found[a.index] if isinstance(a, Expression) else a

    for node in needed(outputs):
        found[node.index] = rule(node, tuple(map(now, node.args)))
    return list(map(now, outputs))


def needed(outputs: Sequence[Value], there: Container[int] = ()) -> list[Expression]:
    """Return the nodes that the outputs need, each after its arguments, except those in `there`."""
    found: dict[int, Expression] = {}
    stack = [out for out in outputs if isinstance(out, Expression)]
    while stack:
        node = stack.pop()
        if node.index not in found and node.index not in there:
            found[node.index] = node
            for a in node.args:
                if isinstance(a, Expression) and a.index not in found:
                    stack.append(a)
    return [found[index] for index in sorted(found)]


Tangents = dict[str, Value]  # the derivatives of one value by inputs, by name; zeros left out

# of functions of x: f'(x), by x and f(x)
SLOPES: dict[str, Callable[[Any, Any], Value]] = {
    "sin": lambda x, f: cos(x),
    "cos": lambda x, f: -sin(x),
    "tan": lambda x, f: 1.0 + f * f,
    "sqrt": lambda x, f: 0.5 / f,
    "exp": lambda x, f: f,
    "log": lambda x, f: 1.0 / x,
    "tanh": lambda x, f: 1.0 - f * f,
    "sinh": lambda x, f: call("cosh", x),
    "cosh": lambda x, f: call("sinh", x),
    "atan": lambda x, f: 1.0 / (1.0 + x * x),
    "asin": lambda x, f: 1.0 / call("sqrt", 1.0 - x * x),
    "acos": lambda x, f: -1.0 / call("sqrt", 1.0 - x * x),
    "floor": lambda x, f: 0.0,
    "abs": lambda x, f: choose(x, 0.0, -1.0, 1.0),
}


def tangents(
    outputs: Sequence[Value],
    inputs: Sequence[str] | Mapping[str, Tangents],
    nodes: Mapping[int, Tangents] = MappingProxyType({}),
) -> list[Tangents]:
    """Return the derivatives of each output by the inputs (variables or parameters).

    Inputs that depend on others are given with their own derivatives; so may be `nodes`, by index.
    """
    if not isinstance(inputs, Mapping):
        return tangents(outputs, {name: {name: 1.0} for name in inputs})
    known = dict(nodes)

    def of(a: Any) -> Tangents:
        return known[a.index] if isinstance(a, Expression) else {}

    for node in needed(outputs):
        if node.index in nodes:
            continue
        x: tuple[Any, ...] = node.args
        found: Tangents
        match node.op:
            case "var" | "par":
                found = inputs.get(str(x[0]), {})
            case "keep" | "+" | "-" | "neg":
                signs = {"-": (1.0, -1.0), "neg": (-1.0,)}.get(node.op, (1.0, 1.0))
                found = _combined(zip(signs, map(of, x), strict=False))
            case "*":
                found = _combined(((x[1], of(x[0])), (x[0], of(x[1]))))
            case "/":
                found = _combined(((1.0 / x[1], of(x[0])), (-node / x[1], of(x[1]))))
            case "pow":
                slope = multiply(x[1], power(x[0], x[1] - 1.0))
                found = _combined(((slope, of(x[0])),))
            case "choose":
                found = _chosen(x, of(x[2]), of(x[3]))
            case "atan2":
                square = x[0] * x[0] + x[1] * x[1]
                found = _combined(((x[1] / square, of(x[0])), (-x[0] / square, of(x[1]))))
            case op if of(x[0]):
                found = _combined(((SLOPES[op](x[0], node), of(x[0])),))
            case _:
                found = {}
        known[node.index] = found
    return [of(out) for out in outputs]


def slopes_by(
    outputs: Sequence[Value],
    inputs: Sequence[str] | Mapping[str, Tangents],
    names: Sequence[str] | None = None,
) -> list[Value]:
    """Return the derivatives of each output by each of `names` (default: all inputs)."""
    wanted = list(inputs) if names is None else names
    return [slope.get(name, 0.0) for slope in tangents(outputs, inputs) for name in wanted]


def _combined(parts: Any) -> Tangents:
    """Return the sum of factors times tangents."""
    found: Tangents = {}
    for factor, tangent in parts:
        for name, value in tangent.items():
            term = value if factor == 1.0 else factor * value
            found[name] = found[name] + term if name in found else term
    return {name: value for name, value in found.items() if isinstance(value, Expression) or value}


def _chosen(x: Sequence[Any], one: Tangents, other: Tangents) -> Tangents:
    names = dict.fromkeys((*one, *other))
    return {name: choose(x[0], x[1], one.get(name, 0.0), other.get(name, 0.0)) for name in names}


def substituted(outputs: Sequence[Value], values: Mapping[str, Value]) -> list[Value]:
    """Return the outputs with values in place of variables."""

    def rule(node: Expression, args: tuple[Any, ...]) -> Value:
        if node.op == "var":
            return values.get(str(node.args[0]), node)
        if node.op == "par" or all(map(operator.is_, args, node.args)):
            return node
        return (_AGAIN.get(node.op) or partial(call, node.op))(*args)

    return rewritten(outputs, rule)


# operations on other arguments, folded as operators fold; functions are called by name
_AGAIN: dict[str, Callable[..., Value]] = {
    "+": add,
    "-": lambda a, b: add(a, negate(b)),
    "*": multiply,
    "/": divide,
    "neg": negate,
    "keep": keep,
    "pow": power,
    "choose": choose,
    "atan2": arctangent,
}
