"""How the start of a motion changes with a number of its scene, or with a start value."""

from __future__ import annotations

import re
from functools import lru_cache

import numpy as np

from robodyn.dynamics.named_numbers import with_variable
from robodyn.engines.expression import Graph
from robodyn.engines.formulas import Formula, Recorded
from robodyn.engines.straightline import FloatFunction, compile_floats
from robodyn.engines.tangents import slopes_by, substituted
from robodyn.errors import InputError
from robodyn.loops.loop_rates import closing_rates, loop_accelerations
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

CHANGE = "p"  # the variable that a number changes by
_START = re.compile(r"(q|qd)([1-9][0-9]*)", re.ASCII)


def is_start(mechanism: Mechanism, name: str) -> bool:
    match = _START.fullmatch(name)
    if match and int(match[2]) > mechanism.n:
        limit = f"must be one of {match[1]}1..{match[1]}{mechanism.n}"
        raise InputError(name, where=mechanism.source, limit=limit)
    if name.startswith("start."):
        limit = "is where assembly begins; name a start value, q1 or qd1"
        raise InputError(name, where=mechanism.source, limit=limit)
    return match is not None


def start_slopes(mechanism: Mechanism, name: str, q: Array, qd: Array) -> Array:
    """d(q, qd)/d(name) (2n) at the start: the actuated joints' values are what is given."""
    n, driven = mechanism.n, list(mechanism.actuated)
    moved, turned = np.zeros(n), np.zeros(n)
    match = _START.fullmatch(name)
    joint = None if match is None else int(match[2]) - 1
    if match is not None and joint is not None:
        unit = np.eye(n)[joint]
        if mechanism.rows:
            if joint not in driven:
                limit = f"joint {mechanism.link_names[joint]} follows the actuated ones"
                raise InputError(name, where=mechanism.source, limit=limit)
            unit = closing_rates(mechanism, q, unit[driven], 0.0)
        if match[1] == "qd":
            return np.concatenate([moved, unit])
        moved = unit
    elif mechanism.rows:
        none = np.zeros((2, len(driven)))
        moved, turned = closing_rates(mechanism, q, none, _gap_slopes(mechanism, name, q, qd))
    if mechanism.rows and np.any(moved) and np.any(qd):
        # the bias is a quadratic form in the rates: this is its part between qd and the change
        both = np.stack([qd + moved, qd - moved])
        ahead, behind = loop_accelerations(mechanism, q, both, np.zeros((2, len(driven))))
        turned = turned + 0.25 * (ahead - behind)
    return np.concatenate([moved, turned])


def _gap_slopes(mechanism: Mechanism, name: str, q: Array, qd: Array) -> Array:
    """The derivatives of the gap and of its rate (2, r) by a number, with q and qd held."""
    found = np.array(_gap_function(mechanism, name)(*q.tolist(), *qd.tolist(), 0.0))
    return found.reshape(2, -1)


@lru_cache(maxsize=256)
def _gap_function(mechanism: Mechanism, name: str) -> FloatFunction:
    graph = Graph()
    named = with_variable(mechanism, name, graph.variable(CHANGE))
    state = Recorded(named, ("qd",), True, graph=graph)
    series = state.series([0.0] * mechanism.n)
    series.residuals(0)
    rows = [series.real[slot] for slot in series.program.named["gap"]]
    slopes = slopes_by([row[p] for p in (0, 1) for row in rows], [CHANGE])
    outputs = tuple(substituted(slopes, {CHANGE: 0.0}))
    return compile_floats(Formula((*state.inputs, "t"), outputs, ()), "gaps")
