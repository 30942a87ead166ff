"""Switching times of torques given by expressions, and their finest features in time.

Parts of an expression that depend on time alone are sampled over the run.  A sample is added at
each zero and extreme of a part, so that the narrowest pulse shows at its middle.

- A part that jumps or bends (a comparison, abs, min, max, sign, floor, %) is a *switch*: its times
are found to the spacing of floats, steps land on them, and between two of them it is constant. -
Between switching times the torque is divided into *leaves*, on each of which a polynomial of degree
16 meets all samples.  No step may be longer than a leaf that it enters.

Loads of a scene by expressions in t are treated in the same way.  Rows of a table over t are kinks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from robodyn.errors import InputError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import Pieces, switch
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.time_samples import (
    holes,
    leaf_ends,
    samples_of,
    switching_times,
    values_of,
)
from robodyn.mechanics.torque_edges import cut, lines_at_edges, with_lines
from robodyn.scene.expressions import COMPARISONS, fold
from robodyn.scene.scene import Curve, Law, Table, signal_place
from robodyn.scene.syntax import Node

NEAR_END = 1e-15  # of the run: a switch nearer to its ends is none


class Held(Pieces):
    """Values of the switches over time; at a switching time that is reached, the later values."""

    restarts = True  # a torque may jump there

    def __init__(self, kinks: Sequence[float], values: Sequence[tuple[float, ...]]) -> None:
        super().__init__(kinks)
        self.values = values
        self.begin((), 1.0)

    def begin(self, y: Sequence[float], t_end: float) -> None:
        """Start a run; see `Steps`."""
        self.forward = t_end >= 0.0
        self.reach(0.0, y)

    def reach(self, t: float, y: Sequence[float]) -> None:
        """Reach a kink; see `Steps`."""
        self.come_to(t, self.forward)

    def at(self, t: float) -> tuple[float, ...]:
        """Return the values of all switches at t, not beyond a switching time not yet reached."""
        return self.values[self.piece(t)]


def harmless_torque(mechanism: Mechanism, atol: float, t_end: float) -> float:
    """Return a torque (N m) that moves the lightest link by less than `atol` in a run."""
    lightest = min(mechanism.inertias.values(), default=0.0)
    return float(atol * lightest / (abs(t_end) or 1.0))


def over_a_run(
    actuation: Actuation, state: Sequence[float], t_end: float, small: float = 0.0
) -> Actuation:
    """Return the torques with switching times and leaves from 0 to `t_end`.

    `state` (2n,) is that at the start; parts that depend on time and state are sampled with it
    fixed.  A torque below `small` (N m) may be missed.  Torques that are no expressions of time are
    returned unchanged.
    """
    if actuation.pieces is not None or actuation.leaves or not math.isfinite(t_end) or not t_end:
        return actuation
    try:
        found = _found(actuation.torques, tuple(map(float, state)), float(t_end), small)
    except (RecursionError, MemoryError):  # too deep an expression: as it is
        return actuation
    if found is None:
        return actuation
    given = actuation
    actuation = replace(given, leaves=found.leaves, told_by_leaves=found.enough, given=given)
    if not found.values[0]:  # no switch
        return actuation
    pieces = Held(found.kinks, found.values)
    held = Actuation.of(found.torques)
    return replace(
        actuation,
        lines=("_s = _piece(t)", *held.lines),
        torques=held.torques,
        scope={**held.scope, "_piece": pieces.at, "_int": int, "_pick": _pick},
        kinks=found.kinks,
        pieces=pieces,
    )


def over_a_scene_run(
    mechanism: Mechanism,
    actuation: Actuation,
    state: Sequence[float],
    t_end: float,
    small: float = 0.0,
) -> Actuation:
    """Apply `over_a_run` to the torques, and to loads that depend on time.

    Raises InputError if the rows of a table do not cover the run.
    """
    if actuation.lines:
        actuation = over_a_run(actuation, state, t_end, small)
    if not mechanism.timed or not t_end:
        return actuation
    first, last = min(0.0, t_end), max(0.0, t_end)
    times: set[float] = set()
    jumps = set(actuation.jumps)
    torques: list[Node] = []
    laws = (mechanism.rows[r].law for r in mechanism.driven)
    for signal in (*mechanism.signals, *filter(None, laws)):
        if isinstance(signal, Law) and "t" in signal.names:
            torques.append(signal.node)
        elif isinstance(signal, Curve) and signal.repeats and signal.over == "t":
            times.update(_repeated(signal.x, first, last))
        elif isinstance(signal, (Table, Curve)) and signal.over == "t":
            if signal.x[0] > first or signal.x[-1] < last:
                span = f"{signal.x[0]:g} to {signal.x[-1]:g} s"
                limit = f"the rows of {signal.file} must cover the simulation, {first:g} to "
                place = _place_of(mechanism, signal)
                raise InputError(
                    place, where=mechanism.source, value=span, limit=f"{limit}{last:g} s"
                )
            times.update(t for t in signal.x if first < t < last)
            if isinstance(signal, Table):
                jumps.update(t for t in signal.lines.jumps if first < t < last)
    found = over_a_run(Actuation.of(torques), state, t_end, small)
    leaves = {*actuation.leaves, *found.leaves}
    if actuation.control is not None:  # it takes kinks for samples
        leaves.update({abs(t) for t in times} | {0.0, abs(t_end)} if times else set())
    else:
        times.update(found.kinks)
    kinks = actuation.kinks
    if actuation.control is None and not times <= set(kinks):
        kinks = tuple(sorted({*kinks, *times}))
    enough = actuation.told_by_leaves and found.told_by_leaves
    return replace(
        actuation,
        kinks=kinks,
        jumps=tuple(sorted(jumps)),
        leaves=tuple(sorted(leaves)),
        told_by_leaves=enough,
    )


def _place_of(mechanism: Mechanism, signal: Table | Curve) -> str:
    """Return the place of a table in the scene."""
    if isinstance(signal, Table):
        return signal_place(mechanism.description, signal)
    laws = [x.law for x in mechanism.description.couplings]
    return f"couplings[{next(c for c, law in enumerate(laws) if law is signal)}]"


def _repeated(x: Sequence[float], first: float, last: float) -> Iterator[float]:
    """Yield the times of a repeating table's rows within a run."""
    span = x[-1] - x[0]
    for k in range(math.floor((first - x[0]) / span), math.ceil((last - x[0]) / span) + 1):
        yield from (t for row in x[:-1] if first < (t := row + k * span) < last)


def _pick(k: float, *values: float) -> float:
    return values[int(k)]


class _Found(NamedTuple):
    """Torques with switches held, switching times, switch values per piece, and leaves."""

    torques: tuple[Node, ...]
    kinks: tuple[float, ...]
    values: list[tuple[float, ...]]
    leaves: tuple[float, ...]
    enough: bool  # leaves to resolve the torque


@lru_cache(maxsize=16)
def _found(
    torques: tuple[Node, ...], state: tuple[float, ...], t_end: float, small: float
) -> _Found | None:
    """Return switches and leaves of torques from 0 to `t_end`; None if they do not depend on time.

    Raises InputError for torques that switch too fast.
    """
    parts = _TimeParts()
    written = [parts.write(torque) for torque in torques]
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
        switches = {held: len(table) + 3 * k for k, held in enumerate(beside)}
        edges, table = cut(edges, table, list(beside.values()))
        leaves, enough = leaf_ends(parts.functions, names, edges, samples, small)
    made = tuple(with_lines(torque, switches) for torque in written)
    values = [tuple(row) for row in table.T.tolist()] or [()] * (len(edges) - 1)
    ends = tuple(np.sort(np.abs(leaves)).tolist())
    return _Found(made, tuple(edges[1:-1].tolist()), values, ends, enough)


class _TimeParts:
    """Collects parts that depend on time alone; writes them with switches held (`_s[k]`)."""

    def __init__(self) -> None:
        self.size = 0  # how many parts
        self.timely: list[Node] = []  # whose zeros and extremes are sampled
        self.guards: list[Node] = []  # the same of those that decide switches
        self.switches: list[Node] = []  # whose values are whole numbers
        self.functions: list[Node] = []  # that must be resolved: torques, and of time alone
        self.held: list[Node] = []  # the largest parts of time alone, as they are written

    def write(self, torque: Node) -> Node:
        """Return the torque with its switches held."""
        written, kind = fold(torque, _kind, self._write)
        if kind:
            self.functions.append(torque)
        if kind == 1:
            self.held.append(written)
        return written

    def _write(self, node: tuple[Any, ...], found: list[tuple[Node, int]]) -> tuple[Node, int]:
        """Return the written operation, and what it depends on (`_kind`)."""
        operation, *parts = node
        written, kinds = [x for x, _ in found], [kind for _, kind in found]
        kind = max(kinds)
        if operation == "if" and kinds[0] + _compares(parts[0]) < 2:
            written[0] = self._flag(("true", parts[0]))
        if kind == 1:
            self.size += 1
            if not _linear(operation, kinds):
                bends = operation in ("%", "sign", "floor", "abs")
                (self.guards if bends else self.timely).extend(parts)
            return self._held(node, written), 1
        if kind == 2:
            for part, held, each in zip(parts, written, kinds, strict=True):
                if each == 1 and type(part) is tuple:
                    self.functions.append(part)
                    self.held.append(held)
        return (operation, *written), kind

    def _held(self, node: tuple[Any, ...], x: list[Node]) -> Node:
        """Return a node of time alone, from its written parts, between switching times."""
        operation, *parts = node
        match operation:
            case "<" | "<=" | ">" | ">=":
                self.guards.append(("-", *parts))
                return self._flag(node)
            case "%":
                return "-", x[0], ("*", x[1], self._switch(("turns", *parts)))
            case "sign" | "floor":
                return self._switch(node)
            case "abs":
                return "*", x[0], self._switch(("sign", *parts))
            case "min" | "max":
                self.guards += [("-", one, other) for one, other in pairwise(parts)]
                return "pick", self._switch((f"{operation}_at", *parts)), *x
        return operation, *x

    def _flag(self, node: Node) -> Node:
        return "int", self._switch(node)  # an error where it is undefined

    def _switch(self, node: Node) -> str:
        self.switches.append(node)
        return switch(len(self.switches) - 1)


def _kind(leaf: float | str) -> tuple[Node, int]:
    """Return a leaf, and what it depends on: 0 nothing, 1 time alone, 2 the state."""
    return leaf, 0 if not isinstance(leaf, str) else 1 if leaf == "t" else 2


def _compares(node: Node) -> bool:
    return type(node) is tuple and node[0] in COMPARISONS


def _linear(operation: str, kinds: list[int]) -> bool:
    """Return whether an operation makes no feature narrower than those of its parts."""
    match operation:
        case "neg" | "+" | "-":
            return True
        case "*":
            return 0 in kinds
        case "/":
            return kinds[1] == 0
    return False
