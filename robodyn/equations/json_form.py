"""The equations of motion as JSON: every entry as a string in the syntax of Python and SymPy."""

from __future__ import annotations

import json

from robodyn.equations import legend
from robodyn.equations.factoring import Written
from robodyn.equations.notation import PYTHON, one_line
from robodyn.equations.outline import Block, Equations


def as_json(equations: Equations[Written]) -> str:
    """One JSON object, a key in each line."""
    n, actuated = equations.mechanism.n, equations.mechanism.actuated
    content: dict[str, object] = {
        "name": equations.mechanism.name,
        "equation": legend.equation_of_motion(equations)[0],
        "q": [f"q{k + 1}" for k in range(n)],
        "tau": [f"tau{k + 1}" if k in actuated else "0" for k in range(n)],
        **{block.name: _entries(block) for block in equations.blocks},
        **_definitions(equations),
        "symbols": {
            x.name: {"value": x.value, "unit": x.unit, "meaning": x.meaning}
            for x in equations.parameters
        },
        "zero": equations.zero,
        "unused": equations.unused,
    }
    lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _definitions(equations: Equations[Written]) -> dict[str, object]:
    """The names that entries use beside symbols, where there are any."""
    named = {x.name: _text(x.value) for block in equations.blocks for x in block.where}
    return {"definitions": named} if named else {}


def _entries(block: Block[Written]) -> object:
    if block.shape == "vector":
        return [_text(row[0]) for row in block.rows]
    return [[_text(entry) for entry in row] for row in block.rows]


def _text(entry: Written) -> str:
    return one_line(PYTHON.text(entry))
