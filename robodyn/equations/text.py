"""The equations of motion as plain text, for reading: formulas, then a legend of their symbols."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence

from robodyn.equations import legend
from robodyn.equations.factoring import Written
from robodyn.equations.notation import PLAIN, broken
from robodyn.equations.outline import Block, Equations

MARGIN = "  "
LEAST_WIDTH = 40
WIDTH = 100


def text(equations: Equations[Written], width: int = WIDTH) -> str:
    """The equations in lines of `width` at most, where they can be broken."""
    width = max(width, LEAST_WIDTH)
    lines = [f"{legend.title(equations)}: equations of motion", "", *_head(equations, width)]
    for definitions, block in legend.new_definitions(equations):
        lines += ["", *_block(block, width)]
        lines += [""] if definitions else []
        for name in definitions:
            lines += _equation(name.name, PLAIN.text(name.value), width)
    lines += ["", "where", "", *_legend(equations, width)]
    return "\n".join(lines) + "\n"


def _head(equations: Equations[Written], width: int) -> Iterator[str]:
    """The equation of motion in matrices, and what its right side is."""
    mechanism = equations.mechanism
    yield from (f"{MARGIN}{line}" for line in legend.equation_of_motion(equations))
    if mechanism.passive:
        driven = [f"tau{k + 1}" if k in mechanism.actuated else "0" for k in range(mechanism.n)]
        yield ""
        yield from _equation("tau", f"({', '.join(driven)})", width)


def _block(block: Block[Written], width: int) -> Iterator[str]:
    """The entries of a matrix or vector, one below the other; zeros together at the end."""
    name = legend.plain_name(block)
    if block.zero:
        yield f"{MARGIN}{name} = 0"
        return
    if block.shape == "diagonal":
        entries = (PLAIN.text(row[k]) for k, row in enumerate(block.rows))
        yield from _equation(name, f"diag({', '.join(entries)})", width)
        return
    entries_of = legend.listed(block)
    labels = [" = ".join(_label(block, *place) for place in places) for places, _ in entries_of]
    wide = max(map(len, labels))
    for label, (_, entry) in zip(labels, entries_of, strict=True):
        yield from _equation(label.ljust(wide), PLAIN.text(entry), width)
    yield from _zeros([_label(block, *place) for place in legend.zeros(block)], width)


def _equation(label: str, line: str, width: int) -> list[str]:
    """`label = line`, broken lines below the first."""
    start = f"{MARGIN}{label} = "
    first, *more = broken(line, width - len(start))
    return [start + first, *(f"{' ' * len(start)}{part}" for part in more)]


def _zeros(labels: Sequence[str], width: int) -> Iterator[str]:
    """Entries that are zero, as many in a line as fit."""
    line = ""
    for label in labels:
        longer = f"{line} = {label}" if line else MARGIN + label
        if line and len(longer) + len(" = 0") > width:
            yield f"{line} = 0"
            longer = MARGIN + label
        line = longer
    if line:
        yield f"{line} = 0"


def _label(block: Block[Written], i: int, j: int) -> str:
    """M12, G1, (Psidot qd)1."""
    name = legend.plain_name(block)
    return (f"({name})" if " " in name else name) + legend.numbers(block, i, j, ",")


def _legend(equations: Equations[Written], width: int) -> Iterator[str]:
    """Tables of the variables and of the parameters, and remarks."""
    variables = legend.variables(equations)
    yield from _table([x.name + x.numbers, x.unit, x.meaning] for x in variables)
    yield ""
    if equations.parameters:
        rows = ([x.name, f"{x.value:.6g}", x.unit, x.meaning] for x in equations.parameters)
        yield from _table(rows)
        yield ""
    for told in _remarks(equations):
        yield from textwrap.wrap(told, width, initial_indent=MARGIN, subsequent_indent=2 * MARGIN)


def _remarks(equations: Equations[Written]) -> Iterator[str]:
    units = [f"{legend.plain_name(block)} in {block.head.unit}" for block in equations.blocks]
    yield f"SI units and radians: {', '.join(units)}."
    if legend.is_coriolis(equations):
        yield "C is the Christoffel one: Mdot - 2C is skew-symmetric."
    yield from legend.left_out(equations)


def _table(rows: Iterable[Sequence[str]]) -> Iterator[str]:
    lines = list(rows)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        cells = [cell.ljust(wide) for cell, wide in zip(line, widths, strict=True)]
        yield (MARGIN + "  ".join(cells)).rstrip()
