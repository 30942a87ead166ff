"""What the equations of motion have in common as code, in Python and in C.

There is one function for each matrix and vector, under its name, of q and qd as it needs them.
The sines and cosines that a function uses stand in front, as c12 = cos(q1 + q2); then come the
entries that are not zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from robodyn.equations import Equations, legend
from robodyn.equations.blocks import Block
from robodyn.equations.factoring import Root
from robodyn.equations.notation import PYTHON, Notation, added, broken, one_line
from robodyn.equations.symbolic import Angle, Call, Rates, Smooth

WIDTH = 100
TAB = "    "


def local(function: str, joints: Sequence[int]) -> str:
    """The variable that holds a sine or cosine: c12 for cos(q1 + q2)."""
    numbers = [str(k + 1) for k in joints]
    return function[0] + ("".join(numbers) if max(joints) < 9 else "_" + "_".join(numbers))


CODE = replace(PYTHON, call=local)


def head(equations: Equations) -> Iterator[str]:
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


def calls(block: Block) -> list[Call]:
    """The sines and cosines of a block, in order."""
    found = {atom for atom in block.atoms() if isinstance(atom, Call)}
    return sorted(found, key=lambda call: call.key)


def functions(equations: Equations) -> list[str]:
    """The names of the functions that all blocks use."""
    atoms = [atom for block in equations.blocks for atom in block.atoms()]
    found = {atom.function for atom in atoms if isinstance(atom, (Call, Smooth))}
    named = [name.value for block in equations.blocks for name in block.where]
    factors = [
        factor for value in named for product in value.terms for factor, _ in product.factors
    ]
    if any(isinstance(factor, Root) for factor in factors):
        found.add("sqrt")
    return sorted(found)


def joints(block: Block, name: str) -> list[int]:
    """The joints whose angles ("q") or rates ("qd") a block's entries hold."""
    found: set[int] = set()
    for atom in block.atoms():
        if isinstance(atom, Call if name == "q" else Rates):
            found.update(atom.joints)
        elif isinstance(atom, Angle if name == "q" else Smooth):
            found.add(atom.joint)
    return sorted(found)


def definitions(block: Block) -> Iterator[str]:
    """The local names of the sines and cosines: `c12 = cos(q1 + q2)`."""
    for call in calls(block):
        angle = one_line(added([f"q{k + 1}" for k in call.joints]))
        yield f"{local(call.function, call.joints)} = {call.function}({angle})"


def label(block: Block, i: int, j: int) -> str:
    """The local name of an entry: M12."""
    return block.name + legend.numbers(block, i, j, "_")


def statements(
    block: Block, notation: Notation, bare: str, brackets: tuple[str, str]
) -> Iterator[str]:
    """Definitions of the names that entries use, then of the entries that are not zero.

    `bare` stands before a name; what takes several lines stands within `brackets`.
    """
    listed = [(label(block, *places[0]), entry) for places, entry in legend.listed(block)]
    for name, value in [*((x.name, x.value) for x in block.where), *listed]:
        text = notation.text(value)
        opening, closing = brackets
        line = f"{TAB}{bare}{name} = {one_line(text)}{closing.strip(')')}"
        if len(line) <= WIDTH:
            yield line
            continue
        yield f"{TAB}{bare}{name} = {opening}".rstrip()
        *parts, last = broken(text, WIDTH - 2 * len(TAB) - 1)
        yield from (f"{TAB}{TAB}{part}" for part in parts)
        if closing == ")":
            yield from [f"{TAB}{TAB}{last}", f"{TAB})"]
        else:
            yield f"{TAB}{TAB}{last}{closing}"


def shown(block: Block, i: int, j: int) -> str:
    """An entry where the whole matrix is put together: its local name, or 0.0."""
    if not block.rows[i][j].terms:
        return "0.0"
    return label(block, *((j, i) if block.shape == "symmetric" and j < i else (i, j)))


def summed(equations: Equations) -> list[Block]:
    """The blocks that the joint torques are the sum of."""
    return [block for block in equations.left if not block.zero] or [equations.left[0]]


def taken_off(equations: Equations) -> list[Block]:
    """The blocks that are taken off this sum."""
    return [block for block in equations.right if not block.zero]


def result(equations: Equations) -> str:
    """The name of the function that computes tau, or tau + Psi^T lambda."""
    return "joint_torques" if equations.closures else "inverse_dynamics"


def told(equations: Equations) -> str:
    """What that function computes."""
    left = legend.equation_of_motion(equations)[0].split(" = ")[0]
    right = "".join(f" - {block.name}" for block in equations.right if not block.zero)
    what = "tau + Psi^T lambda" if equations.closures else "tau"
    return f"{what} = {left}{right}, N m"
