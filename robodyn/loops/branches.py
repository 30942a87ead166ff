"""Which branch of closed poses a scene means, and whether a path leads there.

The words of `assembly` decide.  Without them it is the branch of the closed pose nearest to the
scene's `start`, with all joints free to change.  Without a start it is `open`.  Words are listed in
the order of the closures; each closure of a dyad has one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from robodyn.errors import InputError
from robodyn.loops.assembly_plan import Plan, assembly_plan
from robodyn.loops.closing import close_positions, loop_size, wrapped
from robodyn.loops.dyads import CLOSED, by_dyads, known_joints
from robodyn.loops.path_from_start import closed_near, farthest, open_by, start_pose
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import BRANCHES
from robodyn.tables.arrays import Array

OPEN = 1e3  # rad; what does not close is farther than all that does
CLEAR = 0.05  # rad; branches that come as near to a start are not told apart by it
SEARCHED = 1441  # values of an actuated joint that a start leaves out


class Start(NamedTuple):
    """The pose of a scene's `start`: the given values, and the closed pose that they mean."""

    gap: float  # m, by which the start is open; nan where it leaves joints out
    q: Array  # (n,), the closed pose for which all joints change least
    joint: int  # the joint that changes most
    change: float  # by how much, rad or m
    closed: bool  # whether there is such a pose


@lru_cache(maxsize=64)
def scene_branches(mechanism: Mechanism) -> tuple[str, ...]:
    """Return "open" or "crossed" for each closure of a scene.

    They are the scene's words, or the branches nearest to its start.  Raises InputError if a word
    is given for a closure that closes in one way only, and if a start leaves out joints so that
    both words are equally near.
    """
    description = mechanism.description
    start, closures, said = description.start, description.closures, description.branches
    if said and (BRANCHES[1] in said or len(said) != len(closures)):
        return _words_said(mechanism)
    if start is None or not closures or said:
        return said
    plan, words = assembly_plan(mechanism), [BRANCHES[0]] * len(closures)
    told = [k for k in mechanism.passive if start[k] is not None]
    if not told or not plan.two_way:
        return tuple(words)
    near = np.array([value or 0.0 for value in start])
    unsaid = [k for k in mechanism.actuated if start[k] is None]
    if unsaid:
        words = list(_nearest(mechanism, plan, told, unsaid))
        if plan.behind is not None:
            near[unsaid[0]] = _reach(mechanism, plan, told, unsaid, words)[1]
            held = closed_near(mechanism, plan, near, words, t=0.0).q
            _nearest_words(mechanism, plan.behind, held, near, told, words)
        return tuple(words)
    held, _ = known_joints(mechanism, plan, near[list(mechanism.actuated)], 0.0)
    held[list(plan.later)] = near[list(plan.later)]
    held, away = _nearest_words(mechanism, plan, held, near, told, words)
    if plan.behind is not None:
        held, more = _nearest_words(mechanism, plan.behind, held, near, told, words)
        away = max(away, more)
    # least change of all joints: the start need not close at its own actuated joints
    begin = np.where([value is None for value in start], held, near)
    free = close_positions(mechanism, begin, t=0.0)
    closes = bool(open_by(mechanism, free, t=0.0) <= CLOSED)
    if closes and (away >= OPEN or _far(mechanism, free, start) < _far(mechanism, held, start)):
        for part in (plan, plan.behind):
            if part is not None:
                _nearest_words(mechanism, part, free, free, range(mechanism.n), words)
    return tuple(words)


def all_branches(mechanism: Mechanism) -> Iterator[tuple[str, ...]]:
    """Yield each way to assemble: "open" or "crossed" for every closure with a choice."""
    usual, two_way = dict(enumerate(scene_branches(mechanism))), assembly_plan(mechanism).two_way
    for words in product(BRANCHES, repeat=len(two_way)):
        yield tuple((usual | dict(zip(two_way, words, strict=True))).values())


@lru_cache(maxsize=64)
def scene_start(mechanism: Mechanism) -> Start | None:
    """Return the pose of the scene's `start`; None if there is no start or no loop."""
    start = mechanism.description.start
    if start is None or not mechanism.rows:
        return None
    near = np.array([value or 0.0 for value in start])
    whole = all(value is not None for value in start)
    gap = float(open_by(mechanism, near, t=0.0)) * loop_size(mechanism) if whole else float("nan")
    try:
        plan = assembly_plan(mechanism)
        words = scene_branches(mechanism)
    except InputError:  # the actuated joints do not tell the others, or the start no branch
        q = close_positions(mechanism, near, t=0.0)
        closed = bool(open_by(mechanism, q, t=0.0) <= CLOSED)
    else:
        q, missing, _ = start_pose(mechanism, plan, words, near)
        closed = bool(missing <= 0.0)
    told = [k for k, value in enumerate(start) if value is not None]
    way = np.abs(wrapped(mechanism, q - near))[told]
    joint = told[int(np.argmax(way))] if told else 0
    change = float(way.max(initial=0.0)) * (mechanism.unit if joint in mechanism.slides else 1.0)
    return Start(gap, q, joint, change, closed)


def _words_said(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the scene's words, one for each closure; InputError for a needless word."""
    description = mechanism.description
    said, closures = description.branches, description.closures
    two_way = assembly_plan(mechanism).two_way
    if len(said) not in (len(closures), len(two_way)):
        limit = f"must be one word, or one for each of the {len(closures)} closures, or of the "
        limit += f"{len(two_way)} that close in two ways"
        value = f"{len(said)} words"
        raise InputError("assembly", where=mechanism.source, value=value, limit=limit)
    if len(said) != len(closures):
        words = dict.fromkeys(range(len(closures)), BRANCHES[0])
        return tuple((words | dict(zip(two_way, said, strict=True))).values())
    one = len(set(said)) == 1  # one word stands for all closures that have the choice
    for c, word in enumerate(said):
        if word != BRANCHES[0] and c not in two_way and not (one and two_way):
            place = "assembly" if one else f"assembly[{c}]"
            limit = f"closures[{c}] is no dyad with two ways to close: "
            limit += "its pose follows from the others, or from `start`; leave the word out"
            raise InputError(place, where=mechanism.source, value=word, limit=limit)
    return said


def _nearest_words(
    mechanism: Mechanism,
    plan: Plan,
    q: Array,
    reference: Array,
    told: Sequence[int] | range,
    words: list[str],
) -> tuple[Array, float]:
    """Set the words of a plan's dyads, one by one, to those nearest to `reference` (n,).

    Each dyad depends only on those before it.  Returns the closed q (n,), and the largest distance
    of the dyads' joints in `told` from the reference, rad or lengths of the mechanism.
    """
    farthest_off = 0.0
    for place, step in enumerate(plan.steps):
        own = [k for k in step.unknown if k in told]
        if step.closure not in plan.two_way or not own:
            continue
        away = []
        for word in BRANCHES:
            words[step.closure] = word
            found, shorts, _ = by_dyads(mechanism, plan, q, words)
            missing = np.max(shorts[: place + 1], axis=0)
            away.append(_off(mechanism, found, reference, own, missing))
        words[step.closure] = BRANCHES[int(np.argmin(away))]
        farthest_off = max(farthest_off, min(away))
    return by_dyads(mechanism, plan, q, words)[0], farthest_off


def _nearest(
    mechanism: Mechanism, plan: Plan, told: Sequence[int], unsaid: Sequence[int]
) -> tuple[str, ...]:
    """Return the words nearest to the joints `told`, over all values of the one left out."""
    words = [BRANCHES[0]] * len(mechanism.description.closures)
    decided = [step.closure for step in plan.steps if step.closure in plan.two_way]
    if not decided:
        return tuple(words)
    found = []
    for each in product(BRANCHES, repeat=len(decided)) if len(unsaid) == 1 else ():
        for closure, word in zip(decided, each, strict=True):
            words[closure] = word
        away, _ = _reach(mechanism, plan, told, unsaid, words)
        found.append((away, tuple(words)))
    found.sort(key=lambda pair: pair[0])
    if len(unsaid) > 1 or found[1][0] - found[0][0] < CLEAR:
        limit = "does not tell the branch: name " + ", ".join(
            mechanism.link_names[k] for k in unsaid
        )
        raise InputError("start", where=mechanism.source, limit=limit + " too, or give `assembly`")
    return found[0][1]


def _reach(
    mechanism: Mechanism,
    plan: Plan,
    told: Sequence[int],
    unsaid: Sequence[int],
    words: Sequence[str],
) -> tuple[float, float]:
    """Return the least distance to a start's told joints, and the left-out joint's value."""
    start = mechanism.description.start or ()
    near = np.tile([value or 0.0 for value in start], (SEARCHED, 1))
    span = farthest(mechanism) if unsaid[0] in mechanism.slides else np.pi
    near[:, unsaid[0]] = np.linspace(-span, span, SEARCHED)
    q, missing, _ = closed_near(mechanism, plan, near, words, t=0.0)
    off = _each_off(mechanism, q, near, told, missing)
    best = int(np.argmin(off))
    return float(off[best]), float(near[best, unsaid[0]])


def _off(
    mechanism: Mechanism, q: Array, reference: Array, told: Sequence[int], missing: Array
) -> float:
    """Return the distance of the joints `told` of q (n,) from a reference; large if not closed."""
    return float(_each_off(mechanism, q, reference, told, missing))


def _each_off(
    mechanism: Mechanism, q: Array, reference: Array, told: Sequence[int], missing: Array
) -> Array:
    way = wrapped(mechanism, q - reference)[..., list(told)]
    off = np.abs(way).max(axis=-1)
    off = np.where(missing <= 0.0, off, off + OPEN)
    return np.where(np.isnan(off), np.inf, off)  # a pose of nothing is near to none


def _far(mechanism: Mechanism, q: Array, start: Sequence[float | None]) -> float:
    """Return the distance of all joints that a start names from it, as one length."""
    told = [k for k, value in enumerate(start) if value is not None]
    near = np.array([value or 0.0 for value in start])
    return float(np.linalg.norm(wrapped(mechanism, q - near)[told]))
