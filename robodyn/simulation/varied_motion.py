"""How a motion's start, accelerations, what holds its joints, and impacts change with what varies.

That is numbers of the scene, called by name and times their sizes, and the state itself.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from robodyn.dynamics.named_numbers import with_variable
from robodyn.engines.derivative_formulas import KINDS, Solved, residuals
from robodyn.engines.expression import Graph, Value
from robodyn.engines.factors import Factors
from robodyn.engines.formulas import Formula, Recorded
from robodyn.engines.frames import relative
from robodyn.engines.recorded_numbers import evaluated
from robodyn.engines.straightline import FloatFunction, compile_floats
from robodyn.engines.tangents import Tangents, slopes_by, substituted
from robodyn.errors import InputError
from robodyn.loops.loop_rates import closing_rates, loop_accelerations
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import Mode, in_mode
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


class Varied(Solved):
    """The unknowns of a state in a mode, and how they change with numbers too."""

    def __init__(self, mechanism: Mechanism, mode: Mode | None, way: bool, graph: Graph) -> None:
        self.mechanism, self.mode = mechanism, mode
        moving = mechanism if mode is None else in_mode(mechanism, mode)
        super().__init__(Recorded(moving, KINDS[1:], way, graph=graph))

    def by(self, name: str | None, size: float, by: dict[str, Tangents]) -> list[Value]:
        """du where the inputs change as `by` says, and the number of that name by its size."""
        graph, R = self.state.graph, self.R
        if name is not None and not is_start(self.mechanism, name):
            named = with_variable(self.mechanism, name, graph.variable(CHANGE), self.mode)
            R = residuals(Recorded(named, KINDS[1:], self.state.by_direction, graph=graph))[3]
            by = {**by, CHANGE: {CHANGE: size}}
        (du,) = self.along([CHANGE], by, R, **{CHANGE: 0.0})
        return du


def changes(graph: Graph, inputs: Sequence[str], by: Sequence[str]) -> dict[str, Tangents]:
    """That inputs change as variables of these names."""
    return {x: {CHANGE: graph.variable(s)} for x, s in zip(inputs, by, strict=True)}


def unchanged(outputs: Sequence[Value]) -> list[Value]:
    """The slopes of the outputs by the change of a number, where it is none yet."""
    return substituted(slopes_by(outputs, [CHANGE]), {CHANGE: 0.0})


def by_numbers(
    mechanism: Mechanism,
    names: Sequence[str],
    sizes: Sequence[float],
    of: Callable[[Any], Value],
) -> Array:
    """How something `of` the mechanism's description changes with each number (k,)."""
    slopes: list[Value] = []
    for name in names:
        if is_start(mechanism, name):
            slopes.append(0.0)
        else:
            named = with_variable(mechanism, name, Graph().variable(CHANGE))
            slopes += unchanged([of(named.description)])
    return np.asarray(np.array(slopes, float) * sizes)


@lru_cache(maxsize=64)
def holding(
    mechanism: Mechanism, names: tuple[str, ...], sizes: tuple[float, ...], mode: Mode
) -> FloatFunction:
    """How what holds each held joint changes, for each name and then along the motion itself.

    Of q, qd, tau, t, and for each of these d(q, qd) (2n) and d tau (n).
    """
    varied = Varied(mechanism, mode, True, Graph())
    state, n, moving = varied.state, mechanism.n, varied.state.mechanism
    inputs, outputs = [*state.inputs, "t"], []
    for k, (name, size) in enumerate(zip((*names, None), (*sizes, 0.0), strict=True)):
        own = [f"s{k}_{i}" for i in range(3 * n)]
        inputs += own
        by = changes(state.graph, state.inputs, own)
        if name is None:
            by["t"] = {CHANGE: 1.0}
        du = varied.by(name, size, by)
        outputs += [moving.rows[r].arm * du[n + r] for r in moving.held]
    return compile_floats(Formula(tuple(inputs), tuple(outputs), ()), "holding")


@lru_cache(maxsize=64)
def thrown_back(
    mechanism: Mechanism,
    names: tuple[str, ...],
    sizes: tuple[float, ...],
    impulses: tuple[tuple[int, float], ...],
) -> FloatFunction:
    """(q, qd) after an impact, and what becomes of all s, from both; see `sensitivity_jumps`.

    `impulses` are the joints that are pushed, and how much of its rate each keeps.
    """
    graph, n = Graph(), mechanism.n
    joints = [joint for joint, _ in impulses]
    limits = dict(mechanism.limits)

    def after(moving: Mechanism) -> list[Value]:
        state = Recorded(moving, KINDS[1:], True, graph=graph)
        solved = Solved(state)
        columns = [relative(moving, du[:n]) for du in solved.along([f"tau{j}" for j in joints])]
        q, qd = state.relative["q"], state.relative["qd"]
        v = []
        for joint, e in impulses:
            stop: Any = moving.description.links[joint].limits
            given = limits[joint].restitution or 0.0
            keeps = abs(given - e) < 1e-9 and given > 0.0  # else it comes to rest at once
            v.append((1.0 + (stop.restitution if keeps else e)) * qd[joint])
        W = [{i: column[joint] for i, joint in enumerate(joints)} for column in columns]
        p = Factors(W, len(W)).solve(v)
        for impulse, column in zip(p, columns, strict=True):
            qd = [x - impulse * r for x, r in zip(qd, column, strict=True)]
        return [*q, *qd]

    state = [f"{name}{i}" for name in ("q", "qd") for i in range(n)]
    outputs, inputs = after(in_mode(mechanism, Mode())), list(state)
    for k, (name, size) in enumerate(zip(names, sizes, strict=True)):
        own = [f"s{k}_{i}" for i in range(2 * n)]
        inputs += own
        by = changes(graph, state, own)
        named = in_mode(mechanism, Mode())
        if not is_start(mechanism, name):
            named = with_variable(mechanism, name, graph.variable(CHANGE), Mode())
            by[CHANGE] = {CHANGE: size}
        outputs += substituted(slopes_by(after(named), by, [CHANGE]), {CHANGE: 0.0})
    return compile_floats(Formula(tuple(inputs), tuple(outputs), ()), "thrown")


def torque_lines(actuation: Actuation) -> tuple[str, ...]:
    """Those of torques that may depend on the state, as they were given."""
    if actuation.constants is not None or actuation.linear or actuation.control is not None:
        return ()
    return (actuation.given or actuation).lines


def torque_nodes(
    mechanism: Mechanism, lines: Sequence[str], graph: Graph, timed: bool = False
) -> list[Value]:
    """Those of the torques (n) that depend on the state as nodes, 0 for others; or all, `timed`."""
    found: list[Value] = [0.0] * mechanism.n
    for line in lines:
        names = {x.id for x in ast.walk(ast.parse(line)) if isinstance(x, ast.Name)}
        state = {x for x in names if re.fullmatch("qd?[0-9]+", x)}
        if not state and not timed:
            continue
        target, _, code = line.partition(" = ")
        variables = {x: graph.variable(x) for x in (*state, "t")}
        try:
            found[int(target.removeprefix("tau"))] = evaluated(code, variables)
        except (TypeError, NameError, ValueError, AttributeError):
            joint = target.removeprefix("tau")
            what, limit = (
                "tau",
                "a function of Python has no derivative: give an expression as text",
            )
            if joint.isdigit():
                what = f"tau{int(joint) + 1}"
                limit = "has no derivative: of q and qd take arithmetic and smooth functions"
            raise InputError(what, where=mechanism.source, limit=limit) from None
    return found


def torque_slopes(mechanism: Mechanism, actuation: Actuation) -> FloatFunction:
    """The torques' derivatives by q, qd and t (n (2n + 1)), of q, qd and t."""
    names = [f"{x}{i}" for x in ("q", "qd") for i in range(mechanism.n)] + ["t"]
    nodes = torque_nodes(mechanism, torque_lines(actuation), Graph(), timed=True)
    return compile_floats(Formula(tuple(names), tuple(slopes_by(nodes, names)), ()), "slopes")


@np.errstate(all="ignore")  # of rates that leave the floats the run tells
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
    outputs = unchanged([row[p] for p in (0, 1) for row in rows])
    return compile_floats(Formula((*state.inputs, "t"), tuple(outputs), ()), "gaps")
