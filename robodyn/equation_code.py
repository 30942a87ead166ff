"""What the equations of motion have in common as code, in Python and in C.

There is one function for each matrix and vector, under its name, of q and qd as it needs them.
The sines and cosines that a function uses stand in front, as c12 = cos(q1 + q2); then come the
entries that are not zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from robodyn import equation_legend as legend
from robodyn.equations import Block, Equations
from robodyn.notation import PYTHON, Notation, added, broken, one_line
from robodyn.symbolic import Call, Rates

WIDTH = 100
TAB = "    "


def local(function: str, joints: Sequence[int]) -> str:
    """The variable that holds a sine or cosine: c12 for cos(q1 + q2)."""
    numbers = [str(k + 1) for k in joints]
    return function[0] + ("".join(numbers) if max(joints) < 9 else "_" + "_".join(numbers))


CODE = replace(PYTHON, call=local)


def head(equations: Equations) -> Iterator[str]:
    """The lines of the first comment."""
    yield f"{equations.mechanism.name}: equations of motion, written by robodyn."
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


def calls(block: Block) -> list[Call]:
    """The sines and cosines of a block, in order."""
    found = {a for row in block.rows for x in row for a in x.atoms() if isinstance(a, Call)}
    return sorted(found, key=lambda call: call.key)


def joints(block: Block, name: str) -> list[int]:
    """The joints whose angles ("q") or rates ("qd") a block's entries hold."""
    if name == "q":
        return sorted({k for call in calls(block) for k in call.joints})
    atoms = (a for row in block.rows for x in row for a in x.atoms())
    return sorted({k for a in atoms if isinstance(a, Rates) for k in a.joints})


def definitions(block: Block) -> Iterator[str]:
    """The local names of the sines and cosines: `c12 = cos(q1 + q2)`."""
    for call in calls(block):
        angle = one_line(added([f"q{k + 1}" for k in call.joints]))
        yield f"{local(call.function, call.joints)} = {call.function}({angle})"


def label(block: Block, i: int, j: int) -> str:
    """The local name of an entry: M12."""
    return block.name + legend.numbers(block, i, j, "_")


def entries(block: Block, notation: Notation) -> Iterator[tuple[str, list[str]]]:
    """The local names of the entries that are not zero, and the lines of what they are."""
    for (place, *_), entry in legend.listed(block):
        name = label(block, *place)
        text = notation.text(entry)
        width = WIDTH - len(TAB) - len(f"{name} = ;")
        short = len(text) <= width
        yield name, [one_line(text)] if short else broken(text, WIDTH - 2 * len(TAB))


def shown(block: Block, i: int, j: int) -> str:
    """An entry where the whole matrix is put together: its local name, or 0.0."""
    if not block.rows[i][j].terms:
        return "0.0"
    return label(block, *((j, i) if block.shape == "symmetric" and j < i else (i, j)))


def summed(equations: Equations) -> list[Block]:
    """The blocks that the left side is the sum of."""
    return [block for block in equations.left if not block.zero] or [equations.left[0]]


def result(equations: Equations) -> str:
    """The name of the function that computes the left side."""
    return "left_side" if equations.closures else "inverse_dynamics"
