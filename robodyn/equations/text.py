"""The equations of motion as plain text with a legend, and as JSON."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterable, Iterator, Sequence

from robodyn.equations.named_laws import Formula
from robodyn.equations.notation import PLAIN, PYTHON, broken, one_line
from robodyn.equations.outline import Block, Equations
from robodyn.equations.symbolic import Sum

MARGIN = "  "
LEAST_WIDTH = 40
WIDTH = 100


def text(equations: Equations[Sum], width: int = WIDTH) -> str:
    """Return the equations as text, wrapped to `width` where possible."""
    width = max(width, LEAST_WIDTH)
    lines = [f"{equations.title}: equations of motion", ""]
    lines += [f"{MARGIN}{line}" for line in equations.told()]
    if equations.mechanism.passive:
        lines += ["", *_equation("tau", f"({', '.join(equations.driven('tau{}'))})", width)]
    for definitions, block in equations.defined():
        lines += ["", *_block(block, width)]
        lines += [""] if definitions else []
        for name in definitions:
            lines += _equation(name.name, PLAIN.text(name.value), width)
    lines += ["", "where", ""]
    lines += table([x.name + x.numbers, x.unit, x.meaning] for x in equations.variables())
    lines.append("")
    if equations.parameters:
        rows = ([x.name, f"{x.value:.6g}", x.unit, x.meaning] for x in equations.parameters)
        lines += [*table(rows), ""]
    units = [f"{block.plain_name} in {block.head.unit}" for block in equations.blocks]
    for told in (f"SI units and radians: {', '.join(units)}.", *equations.remarks()):
        lines += textwrap.wrap(told, width, initial_indent=MARGIN, subsequent_indent=2 * MARGIN)
    return "\n".join(lines) + "\n"


def _block(block: Block[Sum], width: int) -> Iterator[str]:
    """Yield the entries of a matrix or vector; zeros are listed together at the end."""
    if block.zero:
        yield f"{MARGIN}{block.plain_name} = 0"
        return
    if block.head.shape == "diagonal":
        entries = (PLAIN.text(row[k]) for k, row in enumerate(block.rows))
        yield from _equation(block.plain_name, f"diag({', '.join(entries)})", width)
        return
    labels = [" = ".join(_label(block, *place) for place in places) for places, _ in block.listed()]
    wide = max(map(len, labels))
    for label, (_, entry) in zip(labels, block.listed(), strict=True):
        yield from _equation(label.ljust(wide), PLAIN.text(entry), width)
    line = ""  # zeros, as many in a line as fit
    for label in (_label(block, *place) for place in block.zeros):
        longer = f"{line} = {label}" if line else MARGIN + label
        if line and len(longer) + len(" = 0") > width:
            yield f"{line} = 0"
            longer = MARGIN + label
        line = longer
    if line:
        yield f"{line} = 0"


def _equation(label: str, line: str, width: int) -> list[str]:
    """Return `label = line`, with continued lines below the first."""
    start = f"{MARGIN}{label} = "
    first, *more = broken(line, width - len(start))
    return [start + first, *(f"{' ' * len(start)}{part}" for part in more)]


def _label(block: Block[Sum], i: int, j: int) -> str:
    """Return an entry's label: M12, G1, (Psidot qd)1, (dgap/dt)1."""
    name = block.plain_name
    return (f"({name})" if {*" /"} & {*name} else name) + block.numbers(i, j, ",")


def table(rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Yield rows of cells as lines with aligned columns."""
    lines = list(rows)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        cells = [cell.ljust(wide) for cell, wide in zip(line, widths, strict=True)]
        yield (MARGIN + "  ".join(cells)).rstrip()


def as_json(equations: Equations[Sum]) -> str:
    """Return one JSON object, a key per line; entries in the syntax of Python and SymPy."""

    def shown(entry: Sum | Formula) -> str:
        return one_line(PYTHON.text(entry))

    content: dict[str, object] = {
        "name": equations.mechanism.name,
        "equation": equations.told()[0],
        "q": [f"q{k + 1}" for k in range(equations.mechanism.n)],
        "tau": equations.driven("tau{}"),
    }
    for block in equations.blocks:
        rows = [[shown(entry) for entry in row] for row in block.rows]
        content[block.name] = [row[0] for row in rows] if block.vector else rows
    named = {x.name: shown(x.value) for block in equations.blocks for x in block.where}
    content |= {"definitions": named} if named else {}
    content["symbols"] = {
        x.name: {"value": x.value, "unit": x.unit, "meaning": x.meaning}
        for x in equations.parameters
    }
    content |= {"zero": equations.zero, "unused": equations.unused}
    lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"
