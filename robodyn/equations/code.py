"""What the equations of motion have in common as code, in Python and in C.

There is one function for each matrix and vector, under its name, of q and qd as it needs them: it
computes sines and cosines, c12 = cos(q1 + q2), and from them the entries that are not zero.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import NamedTuple

from robodyn.engines.expression import FUNCTIONS, Expression, Value, needed
from robodyn.engines.source_text import float_source
from robodyn.equations import legend
from robodyn.equations.outline import Block, Equations

WIDTH = 100
TAB = "    "
STATEMENT = 64  # characters; what is longer is computed in steps
SHORT = 3  # joints whose numbers stand side by side

CodeEquations = Equations[Value]
CodeBlock = Block[Value]


class Body(NamedTuple):
    """A function's statements, the entries as they are put together, and the inputs it uses."""

    lines: list[str]
    entries: list[list[str]]
    used: set[str]


def head(equations: CodeEquations) -> Iterator[str]:
    """The lines of the first comment."""
    yield f"{legend.title(equations)}: equations of motion, written by robodyn."
    yield ""
    yield from (f"  {line}" for line in legend.equation_of_motion(equations))
    yield ""
    variables = legend.variables(equations)
    names = [x.name + x.numbers for x in variables]
    widths = max(map(len, names)), max(len(x.unit) for x in variables)
    for name, x in zip(names, variables, strict=True):
        yield f"  {name.ljust(widths[0])}  {x.unit.ljust(widths[1])}  {x.meaning}"
    remarks = legend.left_out(equations)
    yield from ["", *remarks] if remarks else []


def functions(equations: CodeEquations) -> list[str]:
    """The names of the functions that all blocks use."""
    rows = chain.from_iterable(block.rows for block in equations.blocks)
    return sorted({node.op for node in needed(list(chain.from_iterable(rows)))} & set(FUNCTIONS))


def body(block: CodeBlock, symbol: Callable[[str], str]) -> Body:
    """What a block's function does; `symbol` tells what parameters are called."""
    listed = legend.listed(block)
    outputs = [entry for _, entry in listed]
    names = _names(outputs)
    for places, entry in listed:
        if isinstance(entry, Expression) and entry.op != "var":
            names.setdefault(entry.index, block.name + legend.numbers(block, *places[0], "_"))
    used: set[str] = set()

    def shown(name: str) -> str:
        letters, joint = _parted(name)
        if letters not in ("q", "qd"):
            return symbol(name)
        used.add(f"{letters}{joint}")
        return f"{letters}{joint}"

    lines, texts = float_source(outputs, names, shown, STATEMENT, readable=True)
    entries = [["0.0" for _ in row] for row in block.rows]
    for (places, _), text in zip(listed, texts, strict=True):
        for i, j in places:
            entries[i][j] = text.replace(" + -", " - ")
    return Body([line.replace(" + -", " - ") for line in lines], entries, used)


def _parted(variable: str) -> tuple[str, int]:
    """The letters of an input, and its joint counted from 1: q0 -> q, 1."""
    letters = variable.rstrip("0123456789")
    return letters, int("0" + variable[len(letters) :]) + 1


def _names(outputs: Sequence[Value]) -> dict[int, str]:
    """c12, s12 and w12 for cos(q1 + q2), sin(q1 + q2) and qd1 + qd2.

    A long angle has a name as well, a_1to5; a short one is written out.
    """
    sums: dict[int, tuple[str, tuple[int, ...]]] = {}  # of angles or rates: letters, joints
    names: dict[int, str] = {}
    for node in needed(outputs):
        terms = [sums.get(a.index) for a in node.args if isinstance(a, Expression)]
        known = [term for term in terms if term is not None]
        if node.op == "var":
            letters, joint = _parted(str(node.args[0]))
            if letters in ("q", "qd"):
                sums[node.index] = letters, (joint,)
        elif node.op in ("cos", "sin") and known:
            names[node.index] = node.op[0] + _joints(known[0][1])
        elif node.op == "+" and len(known) == 2 and known[0][0] == known[1][0]:
            letters, joints = known[0][0], tuple(sorted(known[0][1] + known[1][1]))
            sums[node.index] = letters, joints
            short = letters == "q" and len(joints) <= SHORT
            names[node.index] = "" if short else ("a" if letters == "q" else "w") + _joints(joints)
    return names


def _joints(joints: Sequence[int]) -> str:
    """123, or _1to4_12 where that is shorter or the other could be read otherwise."""
    if len(joints) <= SHORT and max(joints) <= 9:
        return "".join(map(str, joints))
    runs: list[tuple[int, int]] = []
    for joint in joints:
        if runs and runs[-1][1] == joint - 1:
            runs[-1] = runs[-1][0], joint
        else:
            runs.append((joint, joint))
    return "".join(f"_{a}" if a == b else f"_{a}to{b}" for a, b in runs)


def summed(equations: CodeEquations) -> list[CodeBlock]:
    """The blocks that the joint torques are the sum of."""
    left = equations.side("left")
    return [block for block in left if not block.zero] or [left[0]]


def taken_off(equations: CodeEquations) -> list[CodeBlock]:
    """The blocks that are taken off this sum."""
    return [block for block in equations.side("right") if not block.zero]


def result(equations: CodeEquations) -> str:
    """The name of the function that computes tau, or tau + Psi^T lambda."""
    return "joint_torques" if equations.side("closures") else "inverse_dynamics"


def told(equations: CodeEquations) -> str:
    """What that function computes."""
    left = legend.equation_of_motion(equations)[0].split(" = ")[0]
    right = "".join(f" - {block.name}" for block in taken_off(equations))
    what = "tau + Psi^T lambda" if equations.side("closures") else "tau"
    return f"{what} = {left}{right}, N m"


def wrapped(parts: Iterable[str], opening: str, closing: str) -> list[str]:
    """Parts in a row between `opening` and `closing`, on as many lines as they need."""
    line = f"{opening}{', '.join(parts)}{closing}"
    if len(line) <= WIDTH:
        return [line]
    inner = " " * (len(opening) - len(opening.lstrip())) + TAB
    wrapper = textwrap.TextWrapper(
        WIDTH, subsequent_indent=inner, break_long_words=False, break_on_hyphens=False
    )
    return wrapper.wrap(line)
