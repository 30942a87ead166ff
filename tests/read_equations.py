"""Written equations, read again."""

from __future__ import annotations

from robodyn.equations.code import python
from robodyn.equations.recorded import recorded
from robodyn.mechanics.mechanism import Mechanism


def module(mech: Mechanism, numeric: bool = False) -> dict:
    """The names that the written Python module defines."""
    names: dict = {}
    exec(compile(python(recorded(mech, numeric)), "equations.py", "exec"), names)
    return names


def lines(text_of: str) -> list[str]:
    """The formulas of a text, broken ones joined."""
    joined: list[str] = []
    for line in text_of.split("\nwhere\n")[0].splitlines():
        if line.startswith("     ") and joined:
            joined[-1] += " " + line.strip()
        else:
            joined.append(" ".join(line.split()))
    return joined
