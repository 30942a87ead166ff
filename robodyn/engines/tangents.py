"""Derivatives of recorded formulas, exact: each node's rule by those of its arguments.

Forward along the graph, from the inputs to the outputs; what does not depend on an input has no
tangent in it, so that zeros which the structure of a mechanism makes cost nothing.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

from robodyn.engines import expression
from robodyn.engines.expression import Expression, Value

Tangents = dict[str, Value]  # the derivatives of one value by inputs, by name; zeros left out

# of functions of x: f'(x), by x and f(x)
SLOPES: dict[str, Callable[[Any, Any], Value]] = {
    "sin": lambda x, f: expression.cos(x),
    "cos": lambda x, f: -expression.sin(x),
    "tan": lambda x, f: 1.0 + f * f,
    "sqrt": lambda x, f: 0.5 / f,
    "exp": lambda x, f: f,
    "log": lambda x, f: 1.0 / x,
    "tanh": lambda x, f: 1.0 - f * f,
    "sinh": lambda x, f: expression.call("cosh", x),
    "cosh": lambda x, f: expression.call("sinh", x),
    "atan": lambda x, f: 1.0 / (1.0 + x * x),
    "asin": lambda x, f: 1.0 / expression.call("sqrt", 1.0 - x * x),
    "acos": lambda x, f: -1.0 / expression.call("sqrt", 1.0 - x * x),
    "floor": lambda x, f: 0.0,
    "abs": lambda x, f: expression.choose(x, 0.0, -1.0, 1.0),
}


def tangents(
    outputs: Sequence[Value],
    inputs: Sequence[str] | Mapping[str, Tangents],
    nodes: Mapping[int, Tangents] = MappingProxyType({}),
) -> list[Tangents]:
    """The derivatives of each output by the inputs, which are variables or parameters.

    Inputs that depend on others are given with their own derivatives, and so may be `nodes`, by
    their places in the graph.
    """
    if not isinstance(inputs, Mapping):
        return tangents(outputs, {name: {name: 1.0} for name in inputs})
    known = dict(nodes)

    def of(a: Any) -> Tangents:
        return known[a.index] if isinstance(a, Expression) else {}

    for node in expression.needed(outputs):
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
                slope = expression.multiply(x[1], expression.power(x[0], x[1] - 1.0))
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
    """The derivatives of each output by each of the names, those of all inputs unless given."""
    wanted = list(inputs) if names is None else names
    return [slope.get(name, 0.0) for slope in tangents(outputs, inputs) for name in wanted]


def _combined(parts: Any) -> Tangents:
    """The sum of factors times tangents."""
    found: Tangents = {}
    for factor, tangent in parts:
        for name, value in tangent.items():
            term = value if factor == 1.0 else factor * value
            found[name] = found[name] + term if name in found else term
    return {name: value for name, value in found.items() if isinstance(value, Expression) or value}


def _chosen(x: Sequence[Any], one: Tangents, other: Tangents) -> Tangents:
    names = dict.fromkeys((*one, *other))
    return {
        name: expression.choose(x[0], x[1], one.get(name, 0.0), other.get(name, 0.0))
        for name in names
    }


def substituted(outputs: Sequence[Value], values: Mapping[str, Value]) -> list[Value]:
    """The outputs with values in place of variables; what does not depend on them stays."""

    def rule(node: Expression, args: tuple[Any, ...]) -> Value:
        if node.op == "var":
            return values.get(str(node.args[0]), node)
        if node.op == "par" or all(map(operator.is_, args, node.args)):
            return node
        return (_AGAIN.get(node.op) or partial(expression.call, node.op))(*args)

    return expression.rewritten(outputs, rule)


# operations on other arguments, folded as operators fold; functions are called by name
_AGAIN: dict[str, Callable[..., Value]] = {
    "+": expression.add,
    "-": lambda a, b: expression.add(a, expression.negate(b)),
    "*": expression.multiply,
    "/": expression.divide,
    "neg": expression.negate,
    "keep": expression.keep,
    "pow": expression.power,
    "choose": expression.choose,
    "atan2": expression.arctangent,
}
