"""The equations of motion as C99: functions that fill arrays, with nothing but math.h."""

from __future__ import annotations

from collections.abc import Iterator

from robodyn.equations import legend
from robodyn.equations.code import (
    TAB,
    CodeBlock,
    CodeEquations,
    body,
    head,
    result,
    summed,
    taken_off,
    told,
    wrapped,
)

BESSEL = ("y0", "y1", "yn", "j0", "j1", "jn")  # functions that compilers know from math.h


def c99(equations: CodeEquations) -> str:
    """The text of the file; matrices are arrays of rows."""
    n = equations.mechanism.n
    lines = ["/*", *(f" * {_comment(line)}".rstrip() for line in head(equations)), " */"]
    lines += ["", "#include <math.h>"]
    if equations.parameters:
        lines.append("")
    for parameter in equations.parameters:
        comment = _comment(legend.unit_and_meaning(parameter))
        value = f"{_symbol(parameter.name)} = {parameter.value!r}"
        lines.append(f"static const double {value}; /* {comment} */")
    for block in equations.blocks:
        lines += ["", *_function(block, n)]
    lines += ["", *_joint_torques(equations)]
    return "\n".join(lines) + "\n"


def _comment(text: str) -> str:
    """Text that neither ends a comment nor begins another."""
    return text.replace("*/", "* /").replace("/*", "/ *")


def _symbol(name: str) -> str:
    return f"{name}_" if name in BESSEL else name


def _size(block: CodeBlock) -> str:
    rows, columns = len(block.rows), len(block.rows[0])
    return f"[{rows}]" if block.shape == "vector" else f"[{rows}][{columns}]"


def _function(block: CodeBlock, n: int) -> Iterator[str]:
    given = block.head
    lines, entries, used = body(block, _symbol)
    arguments = [f"const double {name}[{n}]" for name in given.inputs]
    yield f"/* {given.meaning}, {given.unit} */"
    yield f"void {block.name}({', '.join([*arguments, f'double out{_size(block)}'])})"
    yield "{"
    for name in given.inputs:
        values = [f"{name}{k + 1} = {name}[{k}]" for k in range(n) if f"{name}{k + 1}" in used]
        if values:
            yield from wrapped(values, f"{TAB}const double ", ";")
        else:
            yield f"{TAB}(void){name};"
    yield from (f"{TAB}const double {line};" for line in lines)
    for i, row in enumerate(entries):
        for j, entry in enumerate(row):
            place = f"[{i}]" if block.shape == "vector" else f"[{i}][{j}]"
            yield f"{TAB}out{place} = {entry};"
    yield "}"


def _joint_torques(equations: CodeEquations) -> Iterator[str]:
    """The left side less what stands beside tau, entry by entry."""
    n, terms, others = equations.mechanism.n, summed(equations), taken_off(equations)
    blocks = terms + others
    used = {name for block in blocks for name in (block.head.rate, *block.head.inputs)}
    yield f"/* {told(equations)} */"
    arguments = ", ".join(f"const double {name}[{n}]" for name in ("q", "qd", "qdd"))
    yield f"void {result(equations)}({arguments}, double out[{n}])"
    yield "{"
    yield from (f"{TAB}(void){name};" for name in ("q", "qd", "qdd") if name not in used)
    yield from (f"{TAB}double {block.name}_{_size(block)};" for block in blocks)
    for block in blocks:
        yield f"{TAB}{block.name}({', '.join([*block.head.inputs, f'{block.name}_'])});"
    yield f"{TAB}for (int i = 0; i < {n}; i++) {{"
    vectors = [f"{block.name}_[i]" for block in terms if not block.head.rate]
    less = "".join(f" - {block.name}_[i]" for block in others)
    yield f"{TAB}{TAB}out[i] = {' + '.join(vectors) or '0.0'}{less};"
    products = [f"{block.name}_[i][j]*{block.head.rate}[j]" for block in terms if block.head.rate]
    if products:
        yield f"{TAB}{TAB}for (int j = 0; j < {n}; j++)"
        yield f"{TAB}{TAB}{TAB}out[i] += {' + '.join(products)};"
    yield from [f"{TAB}}}", "}"]
