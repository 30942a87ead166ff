"""When the torques of expressions switch, and how fine their features are in time.

What an expression makes of time alone is sampled over the run, part by part: where a part has a
zero or an extreme, there a sample is added, so that the narrowest pulse shows at its middle.

- A part that jumps or bends (a comparison, abs, min, max, sign, floor, %) is a *switch*: its times
  are found to the spacing of floats, steps land on them, and between two of them it stands still.
- Between those, the torque is cut into *leaves*, on each of which a polynomial of degree 16 meets
  all samples.  No step may be longer than a leaf that it enters.

Loads of a scene by expressions in t are looked at in the same way; rows of a table over t are
kinks, as those of a table of torques are.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from robodyn.errors import InputError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import Pieces
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.time_samples import (
    call,
    holes,
    leaf_ends,
    parts_of,
    samples_of,
    switching_times,
    values_of,
)
from robodyn.mechanics.torque_edges import WithLines, cut, lines_at_edges
from robodyn.scene.expressions import SCOPE
from robodyn.scene.scene import Law, Table, signal_place

NEAR_END = 1e-15  # of the run: a switch nearer to its ends is none


class Held(Pieces):
    """How the switches stand, by time; at a switching time as ahead of it once it is reached."""

    restarts = True  # a torque may jump there

    def __init__(self, kinks: Sequence[float], values: Sequence[tuple[float, ...]]) -> None:
        super().__init__(kinks)
        self.values = values
        self.begin((), 1.0)

    def begin(self, y: Sequence[float], t_end: float) -> None:
        """See `Steps`."""
        self.forward = t_end >= 0.0
        self.reach(0.0, y)

    def reach(self, t: float, y: Sequence[float]) -> None:
        """See `Steps`."""
        self.come_to(t, self.forward)

    def at(self, t: float) -> tuple[float, ...]:
        """The values of all switches at t; beyond a switching time not reached, those before it."""
        return self.values[self.piece(t)]


def harmless_torque(mechanism: Mechanism, atol: float, t_end: float) -> float:
    """A torque, N m, that moves the lightest link by less than `atol` in the time of a run."""
    lightest = min(mechanism.inertias.values(), default=0.0)
    return float(atol * lightest / (abs(t_end) or 1.0))


def over_a_run(
    actuation: Actuation, state: Sequence[float], t_end: float, small: float = 0.0
) -> Actuation:
    """The torques with their switching times and leaves from 0 to `t_end`.

    `state` (2n) is that at the start: what depends on time and state is sampled as if it stayed.
    A torque below `small`, N m, may be missed.
    Torques that are no expressions of time are returned as they are.
    """
    if actuation.pieces is not None or actuation.leaves or not math.isfinite(t_end) or not t_end:
        return actuation
    try:
        found = _found(actuation.lines, tuple(map(float, state)), float(t_end), small)
    except (RecursionError, MemoryError):  # too deep an expression: as it is
        return actuation
    if found is None:
        return actuation
    given = actuation
    actuation = replace(given, leaves=found.leaves, told_by_leaves=found.enough, given=given)
    if not found.values[0]:  # no switch
        return actuation
    pieces = Held(found.kinks, found.values)
    scope = {**actuation.scope, "_piece": pieces.at, "_int": int, "_pick": _pick}
    lines = ("_s = _piece(t)", *found.lines)
    return replace(actuation, lines=lines, scope=scope, kinks=found.kinks, pieces=pieces)


def over_a_scene_run(
    mechanism: Mechanism,
    actuation: Actuation,
    state: Sequence[float],
    t_end: float,
    small: float = 0.0,
) -> Actuation:
    """`over_a_run` of the torques, and of loads that depend on the time.

    Raises InputError where the rows of a table do not cover the run.
    """
    if actuation.lines:
        actuation = over_a_run(actuation, state, t_end, small)
    if not mechanism.timed or not t_end:
        return actuation
    first, last = min(0.0, t_end), max(0.0, t_end)
    times: set[float] = set()
    lines: list[str] = []
    for signal in mechanism.signals:
        if isinstance(signal, Law) and "t" in signal.names:
            lines.append(f"tau{len(lines)} = {signal.code}")
        elif isinstance(signal, Table) and signal.over == "t":
            if signal.x[0] > first or signal.x[-1] < last:
                span = f"{signal.x[0]:g} to {signal.x[-1]:g} s"
                limit = f"the rows of {signal.file} must cover the simulation, {first:g} to "
                place = signal_place(mechanism.description, signal)
                raise InputError(
                    place, where=mechanism.source, value=span, limit=f"{limit}{last:g} s"
                )
            times.update(t for t in signal.x if first < t < last)
    found = over_a_run(Actuation(None, tuple(lines), dict(SCOPE)), state, t_end, small)
    leaves = {*actuation.leaves, *found.leaves}
    if actuation.control is not None:  # it takes kinks for samples
        leaves.update({abs(t) for t in times} | {0.0, abs(t_end)} if times else set())
    else:
        times.update(found.kinks)
    kinks = actuation.kinks
    if actuation.control is None and not times <= set(kinks):
        kinks = tuple(sorted({*kinks, *times}))
    enough = actuation.told_by_leaves and found.told_by_leaves
    return replace(actuation, kinks=kinks, leaves=tuple(sorted(leaves)), told_by_leaves=enough)


def _pick(k: float, *values: float) -> float:
    return values[int(k)]


class _Found(NamedTuple):
    """Lines with switches held, when they switch and how they stand between, and the leaves."""

    lines: tuple[str, ...]
    kinks: tuple[float, ...]
    values: list[tuple[float, ...]]
    leaves: tuple[float, ...]
    enough: bool  # leaves to resolve the torque


@lru_cache(maxsize=16)
def _found(
    lines: tuple[str, ...], state: tuple[float, ...], t_end: float, small: float
) -> _Found | None:
    """What torques make of time from 0 to `t_end`.

    None for lines that are no expressions, or do not depend on time.  Raises InputError for those
    that switch too fast.
    """
    parts = _TimeParts()
    torques: list[tuple[str, ast.expr]] = []
    for line in lines:
        match ast.parse(line).body:
            case [ast.Assign(targets=[ast.Name(id=target)], value=value)]:
                torques.append((target, parts.write(value)))
            case _:
                return None
    if not parts.size:
        return None
    n, span = len(state) // 2, abs(t_end)
    names: dict[str, Any] = {f"q{k}": x for k, x in enumerate(state[:n])}
    names |= {f"qd{k}": x for k, x in enumerate(state[n:])}
    with np.errstate(all="ignore"):
        samples = samples_of(parts, t_end)
        if samples is None:
            limit = f"switches faster than samples from 0 to {t_end:g} s tell"
            raise InputError("tau", limit=f"{limit}; take a slower torque or a shorter time")
        times = switching_times(parts.switches, samples)
        times += holes(parts.functions, {**names, "t": samples})
        inner = [t for t in times if NEAR_END * span < abs(t) < (1.0 - NEAR_END) * span]
        edges = np.array(sorted({0.0, *inner, t_end}))
        middles = 0.5 * (edges[1:] + edges[:-1])
        table = np.array([values_of(switch, {"t": middles}) for switch in parts.switches])
        table = table.reshape(-1, len(middles))
        beside = {id(x): lines_at_edges(x, edges, table, samples) for x in parts.held}
        beside = {held: each for held, each in beside.items() if each}
        rewrite = WithLines({held: len(table) + 3 * k for k, held in enumerate(beside)})
        edges, table = cut(edges, table, list(beside.values()))
        leaves, enough = leaf_ends(parts.functions, names, edges, samples, small)
    written = [f"{target} = {ast.unparse(rewrite.visit(torque))}" for target, torque in torques]
    values = [tuple(row) for row in table.T.tolist()] or [()] * (len(edges) - 1)
    ends = tuple(np.sort(np.abs(leaves)).tolist())
    return _Found(tuple(written), tuple(edges[1:-1].tolist()), values, ends, enough)


class _TimeParts:
    """What expressions make of time alone; writes them with their switches held (`_s[k]`)."""

    def __init__(self) -> None:
        self.size = 0  # how many parts
        self.timely: list[ast.expr] = []  # whose zeros and extremes are sampled
        self.guards: list[ast.expr] = []  # the same of those that decide switches
        self.switches: list[ast.expr] = []  # whose values are whole numbers
        self.functions: list[ast.expr] = []  # that must be resolved: torques, and of time alone
        self.held: list[ast.expr] = []  # the largest parts of time alone, as they are written

    def write(self, torque: ast.expr) -> ast.expr:
        written, kind = self._write(torque)
        if kind:
            self.functions.append(torque)
        if kind == 1:
            self.held.append(written)
        return written

    def _write(self, node: ast.expr) -> tuple[ast.expr, int]:
        """The node written, and what it depends on: 0 nothing, 1 time alone, 2 the state."""
        if isinstance(node, ast.Name):
            return node, 1 if node.id == "t" else 2
        parts = parts_of(node)
        found = [self._write(part) for part in parts]
        written, kinds = [x for x, _ in found], [kind for _, kind in found]
        kind = max(kinds, default=0)
        if isinstance(node, ast.IfExp) and kinds[0] + isinstance(parts[0], ast.Compare) < 2:
            written[0] = self._flag(call("_true", parts[0]))
        if kind == 1:
            self.size += 1
            if not _linear(node, kinds):
                (self.guards if _switches(node) else self.timely).extend(parts)
            return self._held(node, parts, written), 1
        if kind == 2:
            for part, held, each in zip(parts, written, kinds, strict=True):
                if each == 1 and not isinstance(part, ast.Name):
                    self.functions.append(part)
                    self.held.append(held)
        return _rebuilt(node, written), kind

    def _held(self, node: ast.expr, parts: list[ast.expr], x: list[ast.expr]) -> ast.expr:
        """A node of time alone from its written parts, as it is between two switching times."""
        match node:
            case ast.Compare():
                self.guards.append(ast.BinOp(parts[0], ast.Sub(), parts[1]))
                return self._flag(node)
            case ast.BinOp(op=ast.Mod()):
                turns = self._switch(call("_turns", *parts))
                return ast.BinOp(x[0], ast.Sub(), ast.BinOp(x[1], ast.Mult(), turns))
            case ast.Call(func=ast.Name(id="_sign" | "_floor")):
                return self._switch(node)
            case ast.Call(func=ast.Name(id="_abs")):
                return ast.BinOp(x[0], ast.Mult(), self._switch(call("_sign", *parts)))
            case ast.Call(func=ast.Name(id="_min" | "_max" as name)):
                for one, other in pairwise(parts):
                    self.guards.append(ast.BinOp(one, ast.Sub(), other))
                return call("_pick", self._switch(call(f"{name}_at", *parts)), *x)
        return _rebuilt(node, x)

    def _flag(self, node: ast.expr) -> ast.expr:
        return call("_int", self._switch(node))  # an error where it is undefined

    def _switch(self, node: ast.expr) -> ast.expr:
        self.switches.append(node)
        return ast.Subscript(ast.Name("_s"), ast.Constant(len(self.switches) - 1))


def _switches(node: ast.expr) -> bool:
    """Whether a node jumps or bends where its parts pass some value."""
    match node:
        case ast.BinOp(op=ast.Mod()) | ast.Call(func=ast.Name(id="_sign" | "_floor" | "_abs")):
            return True
    return False


def _linear(node: ast.expr, kinds: list[int]) -> bool:
    """Whether a node makes nothing narrower than its parts are."""
    match node:
        case ast.UnaryOp() | ast.BinOp(op=ast.Add() | ast.Sub()):
            return True
        case ast.BinOp(op=ast.Mult()):
            return 0 in kinds
        case ast.BinOp(op=ast.Div()):
            return kinds[1] == 0
    return False


def _rebuilt(node: ast.expr, x: list[ast.expr]) -> ast.expr:
    """The node with these for its parts."""
    new = dict(zip(map(id, parts_of(node)), x, strict=True))
    fields: dict[str, Any] = {
        name: [new.get(id(part), part) for part in value]
        if isinstance(value, list)
        else new.get(id(value), value)
        for name, value in ast.iter_fields(node)
    }
    return type(node)(**fields)
