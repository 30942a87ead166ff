"""A recorded graph written out as straight-line Python: statements on floats, calls on blocks."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from types import MappingProxyType

from robodyn.engines.expression import FUNCTIONS, INPUTS, Expression, Value, needed

_BINARY = {"+": 1, "-": 1, "*": 2, "/": 2}  # their precedence
_CALLS = {"+": "add", "-": "subtract", "*": "multiply", "/": "divide", "neg": "negative"}
_CALLS |= {"pow": "power", "rough": "power", "abs": "absolute", "atan2": "arctan2"}
_CALLS |= {"atan": "arctan", "asin": "arcsin", "acos": "arccos"}
_NAMES = {"rough": "pow"}  # of Python's functions of floats
DEEPEST = 50  # operations within one another; Python compiles no more than 200 brackets
# what numpy code calls
ARRAY_CALLS = {*_CALLS.values(), *(_CALLS.get(x, x) for x in FUNCTIONS), "where", "less", "copyto"}


def float_source(
    outputs: Sequence[Value],
    names: Mapping[int, str] = MappingProxyType({}),
    symbol: Callable[[str], str] = str,
    longest: float = math.inf,
    readable: bool = False,
    conditional: str = "{2} if {0} < {1} else {3}",
) -> tuple[list[str], list[str]]:
    """Python statements on floats, and the expression of each output.

    A node used once stands where it is used; one used more often, or that nests more than DEEPEST
    operations, gets a local name.  `names` has those of nodes by their index: such a node always
    gets its own, or with "" none.  Statements keep to `longest` characters where names do; inputs
    are called as `symbol` says.  Where it is to be `readable`, local names count from 1, brackets
    that do no more than order a sum or a product are left out, and x (1/y) is x/y.
    """
    uses, text = _uses(outputs), _Statements(names, symbol, readable, conditional)
    for node in needed(outputs):
        while len(text.write(node)) > longest:
            parts = [a for a in node.args if isinstance(a, Expression)]
            parts = [a for a in parts if not text.of(a).isidentifier()]
            if not parts:
                break
            text.name(max(parts, key=lambda a: len(text.of(a))))
        wanted = uses[node.index] > 1 or text.depths[node.index] > DEEPEST
        if node.op not in INPUTS and names.get(node.index, wanted):
            text.name(node)
    return text.lines, [text.shown(output, 0) for output in outputs]


@dataclass
class _Statements:
    """The text of nodes as `float_source` writes them, and the statements that name some."""

    names: Mapping[int, str]
    symbol: Callable[[str], str]
    readable: bool
    conditional: str
    lines: list[str] = field(default_factory=list)
    depths: dict[int, int] = field(default_factory=dict)  # operations that a node's text nests
    _text: dict[int, tuple[str, int]] = field(default_factory=dict)  # and its precedence
    _numbers: Iterator[int] = field(default_factory=lambda: count(1))

    def of(self, node: Expression) -> str:
        """What is written for a node."""
        return self._text[node.index][0]

    def shown(self, a: Value | str, least: int) -> str:
        """An argument, in brackets where its precedence is below the least."""
        if isinstance(a, Expression):
            shown, precedence = self._text[a.index]
        elif isinstance(a, str):
            shown, precedence = a, 9
        else:
            shown, precedence = repr(float(a)), 9 if a >= 0 else 3
        return shown if precedence >= least else f"({shown})"

    def name(self, node: Expression) -> None:
        """A statement that gives the node a name of its own."""
        number = next(self._numbers) if self.readable else node.index
        name = self.names.get(node.index) or f"t{number}"
        self.lines.append(f"{name} = {self.of(node)}")
        self._text[node.index], self.depths[node.index] = (name, 9), 0

    def write(self, node: Expression) -> str:
        """A node by the text of its arguments."""
        op, args = node.op, node.args
        if (precedence := _BINARY.get(op)) is not None:
            left = self.shown(args[0], precedence)
            right = self.shown(args[1], precedence + (not self.readable or op in "-/"))
            if precedence == 1:
                found = f"{left} {op} {right}", 1
            else:
                found = _readable(left, op, right) if self.readable else f"{left}{op}{right}", 2
        elif op in INPUTS:
            found = self.symbol(str(args[0])), 9
        elif op == "choose":
            found = self.conditional.format(*(self.shown(arg, 1) for arg in args)), 0
        elif op == "keep":
            assert isinstance(args[0], Expression)
            found = self._text[args[0].index]
        elif op == "neg":
            found = f"-{self.shown(args[0], 2)}", 2
        else:
            found = f"{_NAMES.get(op, op)}({', '.join(self.shown(arg, 0) for arg in args)})", 9
        self._text[node.index] = found
        parts = (self.depths[arg.index] for arg in args if isinstance(arg, Expression))
        self.depths[node.index] = 1 + max(parts, default=-1)
        return found[0]


def _readable(left: str, op: str, right: str) -> str:
    """A product or quotient; x (1/y) is x/y."""
    if op == "*" and left.startswith("1.0/"):
        left, right = right, left
    if op == "*" and right.startswith("1.0/"):
        return left + right[3:]
    return f"{left}{op}{right}"


def array_source(outputs: Sequence[Value], names: Sequence[str]) -> tuple[list[str], int]:
    """In-place numpy calls on blocks, and the number of work buffers `w0, w1, ...` they use.

    Output number i is left in the array called `names[i]`, which may be strided.
    """
    named = list(zip(outputs, names, strict=True))
    target = {out.index: name for out, name in named if isinstance(out, Expression)}
    lines: list[str] = []
    nodes = needed(outputs)
    place, buffers = _places(nodes, target)
    for node in nodes:
        if node.op in INPUTS:
            continue
        args = [place[a.index] if isinstance(a, Expression) else repr(a) for a in node.args]
        to = place[node.index]
        if node.op == "choose":
            lines.append("copyto({4}, where(less({0}, {1}), {2}, {3}))".format(*args, to))
        else:
            lines.append(f"{_CALLS.get(node.op, node.op)}({', '.join(args)}, {to})")
        if target.get(node.index, to) != to:
            lines.append(f"{target[node.index]}[...] = {to}")
    for out, name in named:
        if not isinstance(out, Expression):
            lines.append(f"{name}[...] = {out!r}")
        elif out.op in INPUTS:
            lines.append(f"{name}[...] = {place[out.index]}")
        elif target[out.index] != name:  # the same node is two outputs
            lines.append(f"{name}[...] = {target[out.index]}")
    return lines, buffers


def _places(nodes: Sequence[Expression], target: Mapping[int, str]) -> tuple[dict[int, str], int]:
    """Where each node is computed, and how many buffers that takes.

    A buffer is free again with the last node that reads it; outputs read by none are in place.
    """
    last: dict[int, int] = {}
    for node in nodes:
        for a in node.args:
            if isinstance(a, Expression):
                last[a.index] = node.index
    place: dict[int, str] = {}
    free: list[str] = []
    buffers = 0
    for node in nodes:
        if node.op in INPUTS:
            place[node.index] = str(node.args[0])
            continue
        for a in {x.index: x for x in node.args if isinstance(x, Expression)}.values():
            dead = last[a.index] == node.index and a.op not in INPUTS
            if dead and place[a.index].startswith("w"):
                free.append(place[a.index])
        if node.index not in last:
            place[node.index] = target[node.index]
        elif free:
            place[node.index] = free.pop()
        else:
            place[node.index] = f"w{buffers}"
            buffers += 1
    return place, buffers


def _uses(outputs: Sequence[Value]) -> Counter[int]:
    """How often each node is read, as an output too."""
    read = [a for node in needed(outputs) for a in node.args]
    return Counter(a.index for a in (*read, *outputs) if isinstance(a, Expression))
