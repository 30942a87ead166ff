"""A recorded graph written out as straight-line Python: statements on floats."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from types import MappingProxyType

from robodyn.engines.expression import INPUTS, Expression, Value, needed

_BINARY = {"+": 1, "-": 1, "*": 2, "/": 2}  # their precedence
_NAMES = {"rough": "pow"}  # of Python's functions of floats
DEEPEST = 50  # operations within one another; Python compiles no more than 200 brackets


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


def _uses(outputs: Sequence[Value]) -> Counter[int]:
    """How often each node is read, as an output too."""
    read = [a for node in needed(outputs) for a in node.args]
    return Counter(a.index for a in (*read, *outputs) if isinstance(a, Expression))
