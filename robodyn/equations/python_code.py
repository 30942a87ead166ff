"""The equations of motion as a Python module of functions that needs nothing but `math`."""

from __future__ import annotations

from collections.abc import Iterator

from robodyn.equations import legend
from robodyn.equations.code import (
    TAB,
    CodeBlock,
    CodeEquations,
    body,
    functions,
    head,
    result,
    summed,
    taken_off,
    told,
    wrapped,
)


def python(equations: CodeEquations) -> str:
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


def _function(block: CodeBlock, n: int) -> Iterator[str]:
    given, meaning = block.head, block.head.meaning
    statements, entries, used = body(block, str)
    yield f"def {block.name}({', '.join(given.inputs)}):"
    yield f'{TAB}"""{meaning[0].upper()}{meaning[1:]}, {given.unit}."""'
    for name in given.inputs:
        names = [f"{name}{k + 1}" for k in range(n)]
        if used & set(names):
            lines = wrapped(names, f"{TAB}(", f"{',' if n == 1 else ''}) = {name}")
            yield from lines if n == 1 or len(lines) > 1 else [f"{TAB}{', '.join(names)} = {name}"]
    yield from (f"{TAB}{line}" for line in statements)
    if block.shape == "vector":
        yield from wrapped([row[0] for row in entries], f"{TAB}return [", "]")
    elif len(entries) == 1:
        yield from wrapped(entries[0], f"{TAB}return [[", "]]")
    else:
        yield f"{TAB}return ["
        for row in entries:
            yield from wrapped(row, f"{TAB}{TAB}[", "],")
        yield f"{TAB}]"


def _joint_torques(equations: CodeEquations) -> Iterator[str]:
    """The left side less what stands beside tau, entry by entry."""
    blocks, others = summed(equations), taken_off(equations)
    terms = [
        f"sum(a*b for a, b in zip({x.name}_i, {x.head.rate}))" if x.head.rate else f"{x.name}_i"
        for x in blocks
    ]
    values = [f"{x.name}({', '.join(x.head.inputs)})" for x in blocks + others]
    rows = ", ".join(f"{x.name}_i" for x in blocks + others)
    source = f"zip({', '.join(values)})" if len(values) > 1 else values[0]
    yield f"def {result(equations)}(q, qd, qdd):"
    yield f'{TAB}"""{told(equations)}."""'
    yield from [f"{TAB}return [", f"{TAB}{TAB}{terms[0]}"]
    yield from (f"{TAB}{TAB}+ {term}" for term in terms[1:])
    yield from (f"{TAB}{TAB}- {block.name}_i" for block in others)
    yield from [f"{TAB}{TAB}for {rows} in {source}", f"{TAB}]"]
