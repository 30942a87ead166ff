"""Circuits: whether closed poses connect the pose of a scene's `start` with another pose.

Poses of one circuit can be reached from one another without taking the mechanism apart.  For each
choice of words of the dyads (`branches.py`), poses form a sheet over the actuated joints.  Two
sheets of a dyad meet where its links are in line.  So circuits are connected components of a graph:
its nodes are poses on a grid of the actuated joints; its edges join neighbours on a sheet, and the
two sheets of a dyad at the border of the region where it closes.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import InputError
from robodyn.loops.assembly_plan import Plan, assembly_plan
from robodyn.loops.branches import all_branches, scene_branches, scene_start
from robodyn.loops.closing import half_turn
from robodyn.loops.dyads import by_dyads, known_joints
from robodyn.loops.path_from_start import farthest
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

CELLS = {1: 3600, 2: 120}  # of the grid along each actuated joint, by their number
MOST_SHEETS = {1: 64, 2: 8}
STRAIGHT = 400  # poses on the straight way, which is tried first

Mask = NDArray[np.bool_]
Scalar = TypeVar("Scalar", bound=np.generic)


def leads_there(mechanism: Mechanism, q: Array) -> bool | None:
    """Return whether closed poses connect the start's pose with the assembled pose q (n,).

    None if unknown: the scene has no start that closes, more than two joints are actuated,
    couplings count turns, or loops are no dyads. (Such loops are closed along a path of closed
    poses anyway.)
    """
    found = _way(mechanism, q)
    if found is None:
        return None
    plan, begin, way = found
    words, count = scene_branches(mechanism), len(begin)
    if _closes_straight(mechanism, q):
        return True
    known = count == mechanism.n - len(mechanism.rows) and count in CELLS
    if not known or mechanism.description.couplings or 2 ** len(plan.two_way) > MOST_SHEETS[count]:
        return None
    return _one_circuit(mechanism, plan, begin, begin + way, words)


def blocked(mechanism: Mechanism, q: Array) -> str:
    """Return why closed poses may not connect the start's pose with q (n,), or ""."""
    leads = leads_there(mechanism, q)
    if leads is False:
        told = "no path of closed poses leads from the scene's `start` to this pose: "
        return told + "the mechanism must be taken apart on the way"
    if leads is None and _way(mechanism, q) is not None:
        told = "the straight way of the actuated joints from the scene's `start` does not close: "
        return told + "perhaps no path of closed poses leads to this pose"
    return ""


def _way(mechanism: Mechanism, q: Array) -> tuple[Plan, Array, Array] | None:
    """Return the plan, the actuated joints at the start's pose, and their change up to q.

    None if the start or the plan is unknown.
    """
    start = scene_start(mechanism)
    if start is None or not start.closed:
        return None
    try:
        plan = assembly_plan(mechanism)
    except InputError:
        return None
    if plan.rest:
        return None
    actuated = list(mechanism.actuated)
    begin = start.q[actuated]
    way = np.asarray(q, float)[actuated] - begin
    for place, k in enumerate(actuated):
        if k not in mechanism.slides and not mechanism.description.couplings:
            way[place] = half_turn(way[place])
    return plan, begin, way


def _closes_straight(mechanism: Mechanism, q: Array) -> bool:
    """Return whether all poses on a straight line of the actuated joints to q (n,) close."""
    found = _way(mechanism, q)
    assert found is not None  # the caller asked
    plan, begin, way = found
    straight = begin + np.linspace(0.0, 1.0, STRAIGHT)[:, None] * way
    return bool(_closed(mechanism, plan, straight, scene_branches(mechanism)).all())


def _shorts(mechanism: Mechanism, plan: Plan, given: Array, words: tuple[str, ...]) -> list[Array]:
    """Return the distance (...) by which each dyad fails to close, m; `given` is (..., a)."""
    with np.errstate(all="ignore"):
        q, _ = known_joints(mechanism, plan, given, 0.0)
        return by_dyads(mechanism, plan, q, words)[1]


def _closed(mechanism: Mechanism, plan: Plan, given: Array, words: tuple[str, ...]) -> Mask:
    found: Mask = np.all([short <= 0.0 for short in _shorts(mechanism, plan, given, words)], axis=0)
    return found


def _one_circuit(
    mechanism: Mechanism, plan: Plan, begin: Array, target: Array, words: tuple[str, ...]
) -> bool:
    """Return whether two poses on the sheet of `words` are on one circuit."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    axes, ends = [], []
    for place, k in enumerate(mechanism.actuated):
        cells = CELLS[len(begin)]
        if k in mechanism.slides:
            span = farthest(mechanism)
            values = np.linspace(-span, span, cells + 1)
        else:
            values = begin[place] + np.linspace(-np.pi, np.pi, cells, endpoint=False)
        two = np.array([begin[place], target[place]])
        axis = np.unique(np.append(values, two))
        axes.append(axis)
        ends.append(np.searchsorted(axis, two))
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    shape = grid.shape[:-1]
    every = list(all_branches(mechanism))
    numbers = np.arange(int(np.prod(shape))).reshape(shape)
    sheets = {each: s * numbers.size for s, each in enumerate(every)}
    edges: list[NDArray[np.int_]] = []
    closes: dict[tuple[str, ...], Mask] = {}
    opens: dict[tuple[str, ...], list[tuple[int, Mask]]] = {}  # where a dyad is the first to miss
    for each in every:
        before: Mask = np.ones(shape, bool)
        opens[each] = []
        for step, short in zip(plan.steps, _shorts(mechanism, plan, grid, each), strict=True):
            kept = np.broadcast_to(short <= 0.0, shape)
            opens[each].append((step.closure, before & ~kept))
            before = before & kept
        closes[each] = before
    for each in every:
        for place, k in enumerate(mechanism.actuated):
            turns = k not in mechanism.slides
            here, there = _neighbours(numbers, place, turns)
            one, other = _neighbours(closes[each], place, turns)
            both = one & other
            edges.append(sheets[each] + np.stack([here[both], there[both]]))
            for closure, missed in opens[each]:
                if closure not in plan.two_way:
                    continue
                flipped = _flipped(each, closure)
                a, b = _neighbours(missed, place, turns)
                at = np.concatenate([here[one & b], there[other & a]])
                at = at[closes[flipped].reshape(-1)[at]]
                edges.append(np.stack([sheets[each] + at, sheets[flipped] + at]))
    pairs = np.concatenate(edges, axis=1)
    size = numbers.size * len(every)
    graph = coo_array((np.ones(pairs.shape[1], np.int8), tuple(pairs)), shape=(size, size))
    labels = connected_components(graph, directed=False)[1]
    first, last = (
        labels[sheets[words] + numbers[tuple(end[side] for end in ends)]] for side in (0, 1)
    )
    return bool(first == last)


def _neighbours(
    x: NDArray[Scalar], axis: int, turns: bool
) -> tuple[NDArray[Scalar], NDArray[Scalar]]:
    """Return entries of a grid and their neighbours along an axis, which may be periodic."""
    if turns:
        return x, np.roll(x, -1, axis)
    count = x.shape[axis]
    return np.take(x, range(count - 1), axis), np.take(x, range(1, count), axis)


def _flipped(words: tuple[str, ...], closure: int) -> tuple[str, ...]:
    other = {"open": "crossed", "crossed": "open"}
    return tuple(other[word] if c == closure else word for c, word in enumerate(words))
