"""Arithmetic recorded as a graph, and written out again as straight-line Python or numpy code.

A formula evaluated on `Expression`s instead of floats leaves a graph behind: constants folded,
zero terms gone, equal subexpressions shared.  `float_source` writes it as Python statements on
floats, `array_source` as in-place numpy calls on blocks of states with as few buffers as can be.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from types import MappingProxyType
from typing import Union

Value = Union["Expression", float]

# Cost of an operation in additions, for choosing between two ways to write a formula.
COST = {"+": 1.0, "-": 1.0, "*": 1.0, "/": 1.5, "neg": 0.5}
FUNCTIONS = ("sin", "cos", "sqrt", "tanh")
COST |= dict.fromkeys(FUNCTIONS, 4.0)
_PRECEDENCE = {"+": 1, "-": 1, "*": 2, "/": 2, "neg": 3}


class Graph:
    """The shared nodes of one formula."""

    def __init__(self) -> None:
        self.nodes: list[Expression] = []
        self._known: dict[tuple[object, ...], Expression] = {}

    def variable(self, name: str) -> Expression:
        """The input called `name`."""
        return self.node("var", (name,))

    def node(self, op: str, args: tuple[Value | str, ...]) -> Expression:
        """The one node of this operation on these arguments."""
        key = (op, *(a.index if isinstance(a, Expression) else (type(a), a) for a in args))
        found = self._known.get(key)
        if found is None:
            found = self._known[key] = Expression(self, op, args, len(self.nodes))
            self.nodes.append(found)
        return found


class Expression:
    """One node: an operation on earlier nodes and constants.  Operators fold and simplify."""

    __slots__ = ("args", "graph", "index", "op")

    def __init__(self, graph: Graph, op: str, args: tuple[Value | str, ...], index: int) -> None:
        self.graph, self.op, self.args, self.index = graph, op, args, index

    def __add__(self, other: Value) -> Value:
        return add(self, other)

    def __radd__(self, other: float) -> Value:
        return add(other, self)

    def __sub__(self, other: Value) -> Value:
        return add(self, negate(other))

    def __rsub__(self, other: float) -> Value:
        return add(other, negate(self))

    def __mul__(self, other: Value) -> Value:
        return multiply(self, other)

    def __rmul__(self, other: float) -> Value:
        return multiply(other, self)

    def __truediv__(self, other: Value) -> Value:
        return divide(self, other)

    def __rtruediv__(self, other: float) -> Value:
        return divide(other, self)

    def __neg__(self) -> Value:
        return negate(self)


def negate(a: Value) -> Value:
    """-a, the sign moved inward where that is free."""
    if not isinstance(a, Expression):
        return -a
    x = a.args
    if a.op == "neg":
        return _value(x[0])
    if a.op == "-":
        return a.graph.node("-", (x[1], x[0]))
    if a.op == "*" and isinstance(x[0], float):
        return a.graph.node("*", (-x[0], x[1]))
    return a.graph.node("neg", (a,))


def add(a: Value, b: Value) -> Value:
    """a + b; a sum with a negated term becomes a difference."""
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
            return 0.0 if positive is x else x.graph.node("-", (x, positive))
    first, second = sorted((a, b), key=lambda x: x.index)
    return a.graph.node("+", (first, second))


def multiply(a: Value, b: Value) -> Value:
    """a b; zeros, ones and constant factors fold, signs move out."""
    if not isinstance(a, Expression):
        if not isinstance(b, Expression):
            return a * b
        if a == 0.0:
            return 0.0
        if a == 1.0:
            return b
        if a == -1.0:
            return negate(b)
        if b.op == "*" and isinstance(b.args[0], float):
            return multiply(a * b.args[0], _value(b.args[1]))
        if b.op == "neg":
            return multiply(-a, _value(b.args[0]))
        return b.graph.node("*", (float(a), b))
    if not isinstance(b, Expression):
        return multiply(b, a)
    if a.op == "neg":
        return negate(multiply(_value(a.args[0]), b))
    if b.op == "neg":
        return negate(multiply(a, _value(b.args[0])))
    for x, y in ((a, b), (b, a)):  # constant factors gather in front
        if x.op == "*" and isinstance(x.args[0], float):
            return multiply(x.args[0], multiply(_value(x.args[1]), y))
    first, second = sorted((a, b), key=lambda x: x.index)
    return a.graph.node("*", (first, second))


def divide(a: Value, b: Value) -> Value:
    """a / b; division by a constant is a multiplication."""
    if not isinstance(b, Expression):
        return a * (1.0 / b)
    if not isinstance(a, Expression) and a == 0.0:
        return 0.0
    if isinstance(a, Expression) and a.op == "neg":
        return negate(divide(_value(a.args[0]), b))
    return b.graph.node("/", (a, b))


def cos(a: Value) -> Value:
    """cos(a)."""
    if not isinstance(a, Expression):
        return math.cos(a)
    return a.graph.node("cos", (_value(a.args[0]) if a.op == "neg" else a,))


def sin(a: Value) -> Value:
    """sin(a)."""
    if not isinstance(a, Expression):
        return math.sin(a)
    if a.op == "neg":
        return negate(sin(_value(a.args[0])))
    return a.graph.node("sin", (a,))


def sqrt(a: Value) -> Value:
    """The square root of a."""
    return a.graph.node("sqrt", (a,)) if isinstance(a, Expression) else math.sqrt(a)


def tanh(a: Value) -> Value:
    """tanh(a)."""
    return a.graph.node("tanh", (a,)) if isinstance(a, Expression) else math.tanh(a)


def cost(outputs: Sequence[Value]) -> float:
    """Cost of evaluating the outputs, in additions."""
    return sum(COST.get(node.op, 0.0) for node in needed(outputs))


def float_source(
    outputs: Sequence[Value],
    names: Mapping[int, str] = MappingProxyType({}),
    symbol: Callable[[str], str] = str,
    longest: float = math.inf,
    ordered: bool = True,
) -> tuple[list[str], list[str]]:
    """Python statements on floats, and the expression of each output.

    A node used once stands where it is used; one used more often gets a local name.  `names` has
    those of nodes by their index: such a node always gets its own, or with "" none.  Statements
    keep to `longest` characters where names do; variables are called as `symbol` says.  Unless
    `ordered`, brackets that do no more than order a sum or a product are left out.
    """
    uses = _uses(outputs)
    text: dict[int, tuple[str, int]] = {}  # node -> its text and precedence
    lines: list[str] = []
    numbers = count(1)

    def written(a: Value | str, least: int) -> str:
        if isinstance(a, Expression):
            shown, precedence = text[a.index]
        else:
            shown, precedence = (
                (a, 9) if isinstance(a, str) else (repr(float(a)), 9 if a >= 0 else 3)
            )
        return shown if precedence >= least else f"({shown})"

    def composed(node: Expression) -> tuple[str, int]:
        op, args = node.op, node.args
        if op == "var":
            return symbol(str(args[0])), 9
        if op in FUNCTIONS:
            return f"{op}({written(args[0], 0)})", 9
        if op == "neg":
            return f"-{written(args[0], 2)}", 2
        precedence = _PRECEDENCE[op]
        left = written(args[0], precedence)
        right = written(args[1], precedence + (ordered or op in "-/"))
        return f"{left} {op} {right}" if precedence == 1 else f"{left}{op}{right}", precedence

    def named(node: Expression) -> None:
        name = names.get(node.index) or f"t{next(numbers)}"
        lines.append(f"{name} = {text[node.index][0]}")
        text[node.index] = (name, 9)

    for node in needed(outputs):
        text[node.index] = composed(node)
        while len(text[node.index][0]) > longest:
            parts = [a for a in node.args if isinstance(a, Expression)]
            parts = [a for a in parts if not text[a.index][0].isidentifier()]
            if not parts:
                break
            named(max(parts, key=lambda a: len(text[a.index][0])))
            text[node.index] = composed(node)
        if node.op != "var" and names.get(node.index, uses[node.index] > 1):
            named(node)
    return lines, [written(output, 0) for output in outputs]


def array_source(outputs: Sequence[Value], names: Sequence[str]) -> tuple[list[str], int]:
    """In-place numpy calls on blocks, and the number of work buffers `w0, w1, ...` they use.

    Output number i is left in the array called `names[i]`, which may be strided.
    """
    calls = {"+": "add", "-": "subtract", "*": "multiply", "/": "divide", "neg": "negative"}
    used = needed(outputs)
    last: dict[int, int] = {}  # node -> the last node that reads it
    for node in used:
        for a in node.args:
            if isinstance(a, Expression):
                last[a.index] = node.index
    named = list(zip(outputs, names, strict=True))
    target = {out.index: name for out, name in named if isinstance(out, Expression)}
    free: list[str] = []
    buffers = 0
    place: dict[int, str] = {}
    lines: list[str] = []
    for node in used:
        if node.op == "var":
            place[node.index] = str(node.args[0])
            continue
        args = [place[a.index] if isinstance(a, Expression) else repr(a) for a in node.args]
        for a in {x.index: x for x in node.args if isinstance(x, Expression)}.values():
            dead = last[a.index] == node.index and a.op != "var"
            if dead and place[a.index].startswith("w"):
                free.append(place[a.index])
        if node.index not in last:  # read by nothing: an output, computed in place
            place[node.index] = target[node.index]
        elif free:
            place[node.index] = free.pop()
        else:
            place[node.index] = f"w{buffers}"
            buffers += 1
        lines.append(f"{calls.get(node.op, node.op)}({', '.join(args)}, {place[node.index]})")
        if node.index in target and place[node.index] != target[node.index]:
            lines.append(f"{target[node.index]}[...] = {place[node.index]}")
    for out, name in named:
        if not isinstance(out, Expression):
            lines.append(f"{name}[...] = {out!r}")
        elif out.op == "var":
            lines.append(f"{name}[...] = {place[out.index]}")
        elif target[out.index] != name:  # the same node is two outputs
            lines.append(f"{name}[...] = {target[out.index]}")
    return lines, buffers


def _value(a: Value | str) -> Value:
    assert not isinstance(a, str)
    return a


def _negative(a: Expression) -> bool:
    return a.op == "neg" or (a.op == "*" and isinstance(a.args[0], float) and a.args[0] < 0.0)


def _uses(outputs: Sequence[Value]) -> dict[int, int]:
    uses: dict[int, int] = {}
    for node in needed(outputs):
        for a in node.args:
            if isinstance(a, Expression):
                uses[a.index] = uses.get(a.index, 0) + 1
    for out in outputs:
        if isinstance(out, Expression):
            uses[out.index] = uses.get(out.index, 0) + 1
    return uses


def needed(outputs: Sequence[Value]) -> list[Expression]:
    """The nodes that the outputs need, each after its arguments."""
    found: dict[int, Expression] = {}
    stack = [out for out in outputs if isinstance(out, Expression)]
    while stack:
        node = stack.pop()
        if node.index not in found:
            found[node.index] = node
            stack += [a for a in node.args if isinstance(a, Expression)]
    return [found[index] for index in sorted(found)]
