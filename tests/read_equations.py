"""Written equations, read again."""

from __future__ import annotations

import math

import numpy as np

from robodyn.equations.code import python
from robodyn.equations.recorded import recorded
from robodyn.mechanics.mechanism import Mechanism


def module(mech: Mechanism, numeric: bool = False) -> dict:
    """The names that the written Python module defines."""
    names: dict = {}
    exec(compile(python(recorded(mech, numeric)), "equations.py", "exec"), names)
    return names


def evaluated(content: dict, q: np.ndarray, qd: np.ndarray, t: float = 0.0) -> dict:
    """The blocks of equations as JSON, by Python; those that are left out are zero."""
    scope = {name: getattr(math, name) for name in ("sin", "cos", "tanh", "exp", "sqrt")}
    scope |= {"max": max, "sign": np.sign, "step": lambda x: float(x > 0), "t": t}
    scope |= {name: entry["value"] for name, entry in content["symbols"].items()}
    for k, (x, v) in enumerate(zip(q, qd, strict=True)):
        scope |= {f"q{k + 1}": x, f"qd{k + 1}": v}
    for name, formula in content.get("definitions", {}).items():
        scope[name] = eval(formula, scope)
    found = {}
    for name in ("M", "C", "D", "G", "Q"):
        rows = content.get(name, [["0"] * (1 if name in "GQ" else len(q))] * len(q))
        found[name] = np.array([[eval(x, scope) for x in np.atleast_1d(row)] for row in rows])
    return found


def lines(text_of: str) -> list[str]:
    """The formulas of a text, broken ones joined."""
    joined: list[str] = []
    for line in text_of.split("\nwhere\n")[0].splitlines():
        if line.startswith("     ") and joined:
            joined[-1] += " " + line.strip()
        else:
            joined.append(" ".join(line.split()))
    return joined
