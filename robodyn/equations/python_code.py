"""The equations of motion as a Python module of functions that needs nothing but `math`."""

from __future__ import annotations

from collections.abc import Iterator

from robodyn.equations import Equations, legend
from robodyn.equations.blocks import Block
from robodyn.equations.code import (
    CODE,
    TAB,
    definitions,
    functions,
    head,
    joints,
    result,
    shown,
    statements,
    summed,
    taken_off,
    told,
)


def python(equations: Equations) -> str:
    """The module; its matrices are lists of rows, and states are sequences of n numbers."""
    lines = [f"# {line}".rstrip() for line in head(equations)]
    used = functions(equations)
    if used:
        lines += ["", f"from math import {', '.join(used)}"]
    if equations.parameters:
        lines.append("")
    for parameter in equations.parameters:
        comment = legend.unit_and_meaning(parameter)
        lines.append(f"{parameter.name} = {parameter.value!r}  # {comment}")
    for block in equations.blocks:
        lines += ["", "", *_function(block, equations.mechanism.n)]
    lines += ["", "", *_joint_torques(equations)]
    return "\n".join(lines) + "\n"


def _function(block: Block, n: int) -> Iterator[str]:
    yield f"def {block.name}({', '.join(block.inputs)}):"
    yield f'{TAB}"""{block.meaning[0].upper()}{block.meaning[1:]}, {block.unit}."""'
    for name in block.inputs:
        if joints(block, name):
            names = ", ".join(f"{name}{k + 1}" for k in range(n))
            yield f"{TAB}{names} = {name}" if n > 1 else f"{TAB}({names},) = {name}"
    yield from (f"{TAB}{line}" for line in definitions(block))
    yield from statements(block, CODE, "", ("(", ")"))
    rows = [
        ", ".join(shown(block, i, j) for j in range(len(row))) for i, row in enumerate(block.rows)
    ]
    if block.shape == "vector":
        yield f"{TAB}return [{', '.join(rows)}]"
    elif len(rows) == 1:
        yield f"{TAB}return [[{rows[0]}]]"
    else:
        yield from [f"{TAB}return [", *(f"{TAB}{TAB}[{row}]," for row in rows), f"{TAB}]"]


def _joint_torques(equations: Equations) -> Iterator[str]:
    """The left side less what stands beside tau, entry by entry."""
    blocks, others = summed(equations), taken_off(equations)
    terms = [
        f"sum(a*b for a, b in zip({x.name}_i, {x.rate}))" if x.rate else f"{x.name}_i"
        for x in blocks
    ]
    values = [f"{x.name}({', '.join(x.inputs)})" for x in blocks + others]
    rows = ", ".join(f"{x.name}_i" for x in blocks + others)
    source = f"zip({', '.join(values)})" if len(values) > 1 else values[0]
    yield f"def {result(equations)}(q, qd, qdd):"
    yield f'{TAB}"""{told(equations)}."""'
    yield from [f"{TAB}return [", f"{TAB}{TAB}{terms[0]}"]
    yield from (f"{TAB}{TAB}+ {term}" for term in terms[1:])
    yield from (f"{TAB}{TAB}- {block.name}_i" for block in others)
    yield from [f"{TAB}{TAB}for {rows} in {source}", f"{TAB}]"]
