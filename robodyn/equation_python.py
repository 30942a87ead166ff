"""The equations of motion as a Python module of functions that needs nothing but `math`."""

from __future__ import annotations

from collections.abc import Iterator

from robodyn import equation_legend as legend
from robodyn.equation_code import (
    CODE,
    TAB,
    calls,
    definitions,
    entries,
    head,
    joints,
    result,
    shown,
    summed,
)
from robodyn.equations import Block, Equations


def python(equations: Equations) -> str:
    """The module; its matrices are lists of rows, and states are sequences of n numbers."""
    lines = [f"# {line}".rstrip() for line in head(equations)]
    functions = sorted({call.function for block in equations.blocks for call in calls(block)})
    if functions:
        lines += ["", f"from math import {', '.join(functions)}"]
    if equations.parameters:
        lines.append("")
    for parameter in equations.parameters:
        told = legend.unit_and_meaning(parameter)
        lines.append(f"{parameter.name} = {parameter.value!r}  # {told}")
    for block in equations.blocks:
        lines += ["", "", *_function(block, equations.mechanism.n)]
    lines += ["", "", *_left_side(equations)]
    return "\n".join(lines) + "\n"


def _function(block: Block, n: int) -> Iterator[str]:
    yield f"def {block.name}({', '.join(block.inputs)}):"
    yield f'{TAB}"""{block.meaning[0].upper()}{block.meaning[1:]}, {block.unit}."""'
    for name in block.inputs:
        if joints(block, name):
            names = ", ".join(f"{name}{k + 1}" for k in range(n))
            yield f"{TAB}{names} = {name}" if n > 1 else f"{TAB}({names},) = {name}"
    yield from (f"{TAB}{line}" for line in definitions(block))
    for name, lines in entries(block, CODE):
        if len(lines) == 1:
            yield f"{TAB}{name} = {lines[0]}"
        else:
            yield from [f"{TAB}{name} = (", *(f"{TAB}{TAB}{x}" for x in lines), f"{TAB})"]
    rows = [
        ", ".join(shown(block, i, j) for j in range(len(row))) for i, row in enumerate(block.rows)
    ]
    if block.shape == "vector":
        yield f"{TAB}return [{', '.join(rows)}]"
    elif len(rows) == 1:
        yield f"{TAB}return [[{rows[0]}]]"
    else:
        yield from [f"{TAB}return [", *(f"{TAB}{TAB}[{row}]," for row in rows), f"{TAB}]"]


def _left_side(equations: Equations) -> Iterator[str]:
    """The sum of the left side's terms, entry by entry."""
    blocks = summed(equations)
    terms = [
        f"sum(a*b for a, b in zip({x.name}_i, {x.rate}))" if x.rate else f"{x.name}_i"
        for x in blocks
    ]
    values = [f"{x.name}({', '.join(x.inputs)})" for x in blocks]
    rows = ", ".join(f"{x.name}_i" for x in blocks)
    source = f"zip({', '.join(values)})" if len(blocks) > 1 else values[0]
    yield f"def {result(equations)}(q, qd, qdd):"
    yield f'{TAB}"""{legend.equation_of_motion(equations)[0]}: the left side, N m."""'
    yield from [f"{TAB}return [", f"{TAB}{TAB}{' + '.join(terms)}"]
    yield from [f"{TAB}{TAB}for {rows} in {source}", f"{TAB}]"]
