"""The equations of motion as code: a Python module or C99, which needs nothing but `math`.

Each matrix and vector becomes a function of its name, with arguments q and qd as needed.  It
computes sines and cosines, c12 = cos(q1 + q2), and from them the entries that are not zero.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain

from robodyn.engines.expression import FUNCTIONS, Expression, Value, needed
from robodyn.engines.straightline import float_source
from robodyn.equations.outline import Block, Equations
from robodyn.equations.parameters import Parameter
from robodyn.equations.text import table

WIDTH = 100
TAB = "    "
STATEMENT = 64  # characters; what is longer is computed in steps
SHORT = 3  # joints whose numbers stand side by side
BESSEL = ("y0", "y1", "yn", "j0", "j1", "jn")  # functions that C compilers know from math.h

CodeEquations = Equations[Value]
CodeBlock = Block[Value]


def python(equations: CodeEquations) -> str:
    """Return a Python module; matrices are lists of rows, states sequences of n numbers."""
    lines = [f"# {line}".rstrip() for line in _head(equations)]
    rows = chain.from_iterable(block.rows for block in equations.blocks)
    used = {node.op for node in needed(list(chain.from_iterable(rows)))} & set(FUNCTIONS)
    if used:
        lines += ["", f"from math import {', '.join(sorted(used))}"]
    if equations.parameters:
        lines.append("")
    for parameter in equations.parameters:
        lines.append(f"{parameter.name} = {parameter.value!r}  # {_meaning(parameter)}")
    for block in equations.blocks:
        lines += ["", "", *_python_function(block, equations.mechanism.n)]
    return "\n".join(lines) + "\n"


def _python_function(block: CodeBlock, n: int) -> Iterator[str]:
    given, meaning = block.head, block.head.meaning
    statements, entries, used = _body(block, str)
    yield f"def {block.name}({', '.join(given.inputs)}):"
    yield f'{TAB}"""{meaning[0].upper()}{meaning[1:]}, {given.unit}."""'
    for name in given.inputs:
        names = [f"{name}{k + 1}" for k in range(n)]
        if name != "t" and used & set(names):
            lines = _wrapped(names, f"{TAB}(", f"{',' if n == 1 else ''}) = {name}")
            yield from lines if n == 1 or len(lines) > 1 else [f"{TAB}{', '.join(names)} = {name}"]
    yield from (f"{TAB}{line}" for line in statements)
    if block.vector:
        yield from _wrapped([row[0] for row in entries], f"{TAB}return [", "]")
    elif len(entries) == 1:
        yield from _wrapped(entries[0], f"{TAB}return [[", "]]")
    else:
        yield f"{TAB}return ["
        for row in entries:
            yield from _wrapped(row, f"{TAB}{TAB}[", "],")
        yield f"{TAB}]"


def c99(equations: CodeEquations) -> str:
    """Return C99 text with functions that fill arrays; matrices are arrays of rows."""
    n = equations.mechanism.n
    lines = ["/*", *(f" * {_comment(line)}".rstrip() for line in _head(equations)), " */"]
    lines += ["", "#include <math.h>"]
    if equations.parameters:
        lines.append("")
    for parameter in equations.parameters:
        value = f"{_symbol(parameter.name)} = {parameter.value!r}"
        lines.append(f"static const double {value}; /* {_comment(_meaning(parameter))} */")
    for block in equations.blocks:
        lines += ["", *_c_function(block, n)]
    return "\n".join(lines) + "\n"


def _comment(text: str) -> str:
    """Return text that neither ends a comment nor begins one."""
    return text.replace("*/", "* /").replace("/*", "/ *")


def _symbol(name: str) -> str:
    return f"{name}_" if name in BESSEL else name


def _c_function(block: CodeBlock, n: int) -> Iterator[str]:
    given = block.head
    lines, entries, used = _body(block, _symbol, "{0} < {1} ? {2} : {3}")
    arguments = ["double t" if x == "t" else f"const double {x}[{n}]" for x in given.inputs]
    size = f"[{len(block.rows)}]" + ("" if block.vector else f"[{len(block.rows[0])}]")
    yield f"/* {given.meaning}, {given.unit} */"
    yield f"void {block.name}({', '.join([*arguments, f'double out{size}'])})"
    yield "{"
    for name in given.inputs:
        if name == "t" and name in used:
            continue
        values = [f"{name}{k + 1} = {name}[{k}]" for k in range(n) if f"{name}{k + 1}" in used]
        yield from (
            _wrapped(values, f"{TAB}const double ", ";") if values else [f"{TAB}(void){name};"]
        )
    yield from (f"{TAB}const double {line};" for line in lines)
    for i, row in enumerate(entries):
        for j, entry in enumerate(row):
            yield f"{TAB}out[{i}]{'' if block.vector else f'[{j}]'} = {entry};"
    yield "}"


def _head(equations: CodeEquations) -> Iterator[str]:
    """Yield the lines of the first comment."""
    yield f"{equations.title}: equations of motion, written by robodyn."
    yield ""
    yield from (f"  {line}" for line in equations.told())
    yield ""
    yield from table([x.name + x.numbers, x.unit, x.meaning] for x in equations.variables())
    remarks = list(equations.remarks(christoffel=""))
    yield from ["", *remarks] if remarks else []


def _meaning(parameter: Parameter) -> str:
    """Return unit and meaning of a parameter, for a comment."""
    return ", ".join(part for part in (parameter.unit, parameter.meaning) if part)


def _body(
    block: CodeBlock, symbol: Callable[[str], str], conditional: str = "{2} if {0} < {1} else {3}"
) -> tuple[list[str], list[list[str]], set[str]]:
    """Return the statements of a block's function, its entries, and the inputs that it uses."""
    listed = block.listed()
    outputs = [entry for _, entry in listed]
    names = _names(outputs)
    for places, entry in listed:
        if isinstance(entry, Expression) and entry.op != "var":
            own = "tau" if block.head.side == "sum" else block.name
            names.setdefault(entry.index, own + block.numbers(*places[0], "_"))
    used: set[str] = set()

    def shown(name: str) -> str:
        letters, joint = _parted(name)
        if name == "t":
            used.add(name)
        if letters not in ("q", "qd", "qdd"):
            return symbol(name)
        used.add(f"{letters}{joint}")
        return f"{letters}{joint}"

    lines, texts = float_source(outputs, names, shown, STATEMENT, True, conditional)
    entries = [["0.0" for _ in row] for row in block.rows]
    for (places, _), text in zip(listed, texts, strict=True):
        for i, j in places:
            entries[i][j] = text.replace(" + -", " - ")
    return [line.replace(" + -", " - ") for line in lines], entries, used


def _parted(variable: str) -> tuple[str, int]:
    """Return the letters of an input and its joint counted from 1: q0 -> q, 1."""
    letters = variable.rstrip("0123456789")
    return letters, int("0" + variable[len(letters) :]) + 1


def _names(outputs: Sequence[Value]) -> dict[int, str]:
    """Return names such as c12, s12 and w12 for cos(q1 + q2), sin(q1 + q2) and qd1 + qd2.

    A long angle gets a name too, a_1to5; a short one is written out.
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
    """Return joint numbers as text: 123, or _1to4_12 if that is shorter or unambiguous."""
    if len(joints) <= SHORT and max(joints) <= 9:
        return "".join(map(str, joints))
    runs: list[tuple[int, int]] = []
    for joint in joints:
        if runs and runs[-1][1] == joint - 1:
            runs[-1] = runs[-1][0], joint
        else:
            runs.append((joint, joint))
    return "".join(f"_{a}" if a == b else f"_{a}to{b}" for a, b in runs)


def _wrapped(parts: Iterable[str], opening: str, closing: str) -> list[str]:
    """Return comma-separated parts between `opening` and `closing`, on as many lines as needed."""
    line = f"{opening}{', '.join(parts)}{closing}"
    if len(line) <= WIDTH:
        return [line]
    inner = " " * (len(opening) - len(opening.lstrip())) + TAB
    wrapper = textwrap.TextWrapper(
        WIDTH, subsequent_indent=inner, break_long_words=False, break_on_hyphens=False
    )
    return wrapper.wrap(line)
