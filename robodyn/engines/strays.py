"""Where a step of a series may go beyond what its series know, and come back.

What is flat where a step begins, or a line of a table, tells nothing of what lies beyond.
"""

from __future__ import annotations

from collections.abc import Sequence

from robodyn.engines import expression
from robodyn.engines.arithmetic import Value
from robodyn.mechanics.program import COORDINATES, Function, Program, Slot, arguments
from robodyn.tables.records import Record

FLAT = 45.0  # exp(-FLAT) is nothing beside 1
_STEEP = {"exp": 1.0, "sinh": 1.0, "cosh": 1.0, "tanh": 2.0}  # as exp(-steep |x|) where x is large


class Span(Record):
    """A slot whose way in a step must not go where its series know nothing: see `strays`.

    It stands in a function that is flat, but for exp(-`steep` |x|), where x is large; or `line` is
    its place among those of `bends`, and it goes from 1 to 2 on a line of a table.
    """

    slot: Slot
    steep: float
    line: int = -1


def spans(program: Program, wanted: Sequence[Slot]) -> list[Span]:
    """What the motion changes of what is wanted, where that may be flat, or a line of a table."""
    rows, bends = program.rows, program.named["bends"]
    steep: dict[Slot, float] = {}
    moving: set[Slot] = set()
    for slot in program.schedule(wanted).slots:
        row = rows[slot]
        if isinstance(row, COORDINATES) or not moving.isdisjoint(arguments(row)):
            moving.add(slot)
            if isinstance(row, Function) and row.name in _STEEP:
                steep[row.x] = max(steep.get(row.x, 0.0), _STEEP[row.name])
    lines = [Span(x, 0.0, bends.index(x)) for x in program.named.get("lines", ())]
    return [*(Span(*each) for each in steep.items()), *lines]


def strays(
    spanned: Sequence[Span],
    arms: Sequence[Value],
    series: Sequence[Sequence[Value]],
    x: Value,
    small: Value,
    relative: Value,
) -> Value:
    """Above zero where a step x may go where its series do not hold, and come back.

    What is spanned stays within the hull of the control points of its first three terms, widened by
    the sizes of the other terms.  In the series of exp(-steep |x|) the term of the order steep
    |change of x| is the largest: the steps' own control sees it where the series has so many
    terms.  A line of a table may be left by what moves a torque by `small`, N m, or by the part
    `relative`.
    """
    found: Value = -1.0
    for span, each in zip(spanned, series, strict=True):
        h, rest = abs(x), 0.0
        for coefficient in reversed(each[3:]):
            rest = rest * h + abs(coefficient)
        rest = rest * (h * h * h)
        first, second, third = (*each[:3], 0.0, 0.0)[:3]
        middle, end = first + 0.5 * second * x, first + (second + third * x) * x
        low = expression.least(expression.least(first, middle), end) - rest
        high = expression.greatest(expression.greatest(first, middle), end) + rest
        if span.line >= 0:
            beyond = 2.0 * expression.greatest(1.0 - low, high - 2.0)
            passed = beyond - expression.greatest(small / arms[span.line], relative)
        else:
            near = span.steep * expression.greatest(expression.greatest(low, -high), 0.0)
            nearer = span.steep * abs(first) - near - len(each)
            passed = expression.choose(near, FLAT, nearer, -1.0)
        found = expression.greatest(found, passed)
    return found
