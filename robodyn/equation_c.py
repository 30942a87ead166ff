"""The equations of motion as C99: functions that fill arrays, with nothing but math.h."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from robodyn import equation_legend as legend
from robodyn.equation_code import (
    CODE,
    TAB,
    definitions,
    entries,
    head,
    joints,
    result,
    shown,
    summed,
)
from robodyn.equations import Block, Equations

BESSEL = ("y0", "y1", "yn", "j0", "j1", "jn")  # functions that compilers know from math.h


def c99(equations: Equations) -> str:
    """The text of the file; matrices are arrays of rows."""
    n = equations.mechanism.n
    lines = ["/*", *(f" * {_comment(line)}".rstrip() for line in head(equations)), " */"]
    lines += ["", "#include <math.h>"]
    if equations.parameters:
        lines.append("")
    for parameter in equations.parameters:
        told = _comment(legend.unit_and_meaning(parameter))
        value = f"{_symbol(parameter.name)} = {parameter.value!r}"
        lines.append(f"static const double {value}; /* {told} */")
    for block in equations.blocks:
        lines += ["", *_function(block, n)]
    lines += ["", *_left_side(equations)]
    return "\n".join(lines) + "\n"


def _comment(text: str) -> str:
    """Text that neither ends a comment nor begins another."""
    return text.replace("*/", "* /").replace("/*", "/ *")


def _symbol(name: str) -> str:
    return f"{name}_" if name in BESSEL else name


NOTATION = replace(CODE, symbol=_symbol, power=lambda base, power: "*".join([base] * power))


def _size(block: Block) -> str:
    rows, columns = len(block.rows), len(block.rows[0])
    return f"[{rows}]" if block.shape == "vector" else f"[{rows}][{columns}]"


def _function(block: Block, n: int) -> Iterator[str]:
    arguments = [f"const double {name}[{n}]" for name in block.inputs]
    yield f"/* {block.meaning}, {block.unit} */"
    yield f"void {block.name}({', '.join([*arguments, f'double out{_size(block)}'])})"
    yield "{"
    for name in block.inputs:
        used = joints(block, name)
        values = ", ".join(f"{name}{k + 1} = {name}[{k}]" for k in used)
        yield f"{TAB}const double {values};" if used else f"{TAB}(void){name};"
    yield from (f"{TAB}const double {line};" for line in definitions(block))
    for name, lines in entries(block, NOTATION):
        start = f"{TAB}const double {name} ="
        if len(lines) == 1:
            yield f"{start} {lines[0]};"
        else:
            yield from [start, *(f"{TAB}{TAB}{line}" for line in lines[:-1])]
            yield f"{TAB}{TAB}{lines[-1]};"
    for i, row in enumerate(block.rows):
        places = [
            f"out[{i}]" + ("" if block.shape == "vector" else f"[{j}]") for j in range(len(row))
        ]
        for j, place in enumerate(places):
            yield f"{TAB}{place} = {shown(block, i, j)};"
    yield "}"


def _left_side(equations: Equations) -> Iterator[str]:
    """The sum of the left side's terms, entry by entry."""
    n, blocks = equations.mechanism.n, summed(equations)
    rates = {block.rate for block in blocks} | {name for block in blocks for name in block.inputs}
    yield f"/* {legend.equation_of_motion(equations)[0]}: the left side, N m */"
    arguments = ", ".join(f"const double {name}[{n}]" for name in ("q", "qd", "qdd"))
    yield f"void {result(equations)}({arguments}, double out[{n}])"
    yield "{"
    yield from (f"{TAB}(void){name};" for name in ("q", "qd", "qdd") if name not in rates)
    yield from (f"{TAB}double {block.name}_{_size(block)};" for block in blocks)
    for block in blocks:
        yield f"{TAB}{block.name}({', '.join([*block.inputs, f'{block.name}_'])});"
    yield f"{TAB}for (int i = 0; i < {n}; i++) {{"
    vectors = [f"{block.name}_[i]" for block in blocks if not block.rate]
    yield f"{TAB}{TAB}out[i] = {' + '.join(vectors) or '0.0'};"
    products = [f"{block.name}_[i][j]*{block.rate}[j]" for block in blocks if block.rate]
    if products:
        yield f"{TAB}{TAB}for (int j = 0; j < {n}; j++)"
        yield f"{TAB}{TAB}{TAB}out[i] += {' + '.join(products)};"
    yield from [f"{TAB}}}", "}"]
