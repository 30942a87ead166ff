"""A recorded graph written out as straight-line Python: statements on floats, calls on blocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from types import MappingProxyType

from robodyn.engines.expression import FUNCTIONS, INPUTS, Expression, Value, needed

_PRECEDENCE = {"+": 1, "-": 1, "*": 2, "/": 2, "neg": 3}
_CALLS = {"+": "add", "-": "subtract", "*": "multiply", "/": "divide", "neg": "negative"}
_CALLS |= {"pow": "power", "rough": "power", "abs": "absolute", "atan2": "arctan2"}
_CALLS |= {"atan": "arctan", "asin": "arcsin", "acos": "arccos"}
_NAMES = {"rough": "pow"}  # of Python's functions of floats
# what numpy code calls
ARRAY_CALLS = {*_CALLS.values(), *(_CALLS.get(x, x) for x in FUNCTIONS), "where", "less", "copyto"}


def float_source(
    outputs: Sequence[Value],
    names: Mapping[int, str] = MappingProxyType({}),
    symbol: Callable[[str], str] = str,
    longest: float = math.inf,
    readable: bool = False,
    conditional: str = "{2} if {0} < {1} else {3}",
    beside: bool = False,
) -> tuple[list[str], list[str]]:
    """Python statements on floats, and the expression of each output.

    A node used once stands where it is used; one used more often gets a local name.  `names` has
    those of nodes by their index: such a node always gets its own, or with "" none.  Statements
    keep to `longest` characters where names do; inputs are called as `symbol` says.  Where it is to
    be `readable`, local names count from 1, brackets that do no more than order a sum or a product
    are left out, and x (1/y) is x/y.  `beside`: numbers are x + dx i, and the x compare.
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
        if op in INPUTS:
            return symbol(str(args[0])), 9
        if op == "choose":
            x, y, *values = (written(arg, 1) for arg in args)
            if beside:
                x, y = (f"({each}).real" for each in (x, y))
            return conditional.format(x, y, *values), 0
        if op == "keep":
            kept = args[0]
            assert isinstance(kept, Expression)
            return text[kept.index]
        if op not in _PRECEDENCE:
            return f"{_NAMES.get(op, op)}({', '.join(written(arg, 0) for arg in args)})", 9
        if op == "neg":
            return f"-{written(args[0], 2)}", 2
        precedence = _PRECEDENCE[op]
        left = written(args[0], precedence)
        right = written(args[1], precedence + (not readable or op in "-/"))
        if readable and op == "*":
            left, right = (right, left) if left.startswith("1.0/") else (left, right)
            if right.startswith("1.0/"):
                return left + right[3:], precedence
        return f"{left} {op} {right}" if precedence == 1 else f"{left}{op}{right}", precedence

    def named(node: Expression) -> None:
        name = names.get(node.index) or f"t{next(numbers) if readable else node.index}"
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
        if node.op not in INPUTS and names.get(node.index, uses[node.index] > 1):
            named(node)
    return lines, [written(output, 0) for output in outputs]


def array_source(outputs: Sequence[Value], names: Sequence[str]) -> tuple[list[str], int]:
    """In-place numpy calls on blocks, and the number of work buffers `w0, w1, ...` they use.

    Output number i is left in the array called `names[i]`, which may be strided.
    """
    order = needed(outputs)
    last: dict[int, int] = {}  # node -> the last node that reads it
    for node in order:
        for a in node.args:
            if isinstance(a, Expression):
                last[a.index] = node.index
    named = list(zip(outputs, names, strict=True))
    target = {out.index: name for out, name in named if isinstance(out, Expression)}
    free: list[str] = []
    buffers = 0
    place: dict[int, str] = {}
    lines: list[str] = []
    for node in order:
        if node.op in INPUTS:
            place[node.index] = str(node.args[0])
            continue
        args = [place[a.index] if isinstance(a, Expression) else repr(a) for a in node.args]
        for a in {x.index: x for x in node.args if isinstance(x, Expression)}.values():
            dead = last[a.index] == node.index and a.op not in INPUTS
            if dead and place[a.index].startswith("w"):
                free.append(place[a.index])
        if node.index not in last:  # read by nothing: an output, computed in place
            place[node.index] = target[node.index]
        elif free:
            place[node.index] = free.pop()
        else:
            place[node.index] = f"w{buffers}"
            buffers += 1
        to = place[node.index]
        if node.op == "choose":
            lines.append(f"copyto({to}, where(less({args[0]}, {args[1]}), {args[2]}, {args[3]}))")
        else:
            lines.append(f"{_CALLS.get(node.op, node.op)}({', '.join(args)}, {to})")
        if node.index in target and place[node.index] != target[node.index]:
            lines.append(f"{target[node.index]}[...] = {place[node.index]}")
    for out, name in named:
        if not isinstance(out, Expression):
            lines.append(f"{name}[...] = {out!r}")
        elif out.op in INPUTS:
            lines.append(f"{name}[...] = {place[out.index]}")
        elif target[out.index] != name:  # the same node is two outputs
            lines.append(f"{name}[...] = {target[out.index]}")
    return lines, buffers


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
