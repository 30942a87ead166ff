"""Loops that are no chain of dyads: closed along a path from the pose of the scene's `start`.

The start of a scene need not be closed.  Its pose is the closed one for which all joints, actuated
ones included, change least.  From there the actuated joints are moved to their targets in steps.
In each step, dyads before the other loops are closed by their words, and Newton's method closes the
other loops from the previous step.  Dyads that depend on these follow at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.loops.assembly_plan import Plan
from robodyn.loops.closing import close_positions, half_turn, loop_size, wrapped
from robodyn.loops.closures import closure_gap
from robodyn.loops.dyads import CLOSED, by_dyads, known_joints
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

Mask = NDArray[np.bool_]  # which of some states

PATH_STEP = 0.02  # rad, step of the actuated joints on the path from `start`
LEAP = 0.5  # rad; a passive joint that moves more in such a step has left its branch
AROUND = 400  # places about a start from which Newton's method is tried where the start fails
SAME = 1e-6  # rad, or lengths of the mechanism: poses that differ by less are one


class Closed(NamedTuple):
    """Poses q (..., n), the distance (...) by which each fails to close (m), and dyads' sines."""

    q: Array
    missing: Array
    sines: list[Array]


def closed_near(
    mechanism: Mechanism,
    plan: Plan,
    near: Array,
    words: Sequence[str],
    exact: bool = True,
    behind: bool = True,
    *,
    t: ArrayLike,
) -> Closed:
    """Close all loops for the actuated joints of `near` (..., n) at times t (...).

    Dyads are closed by their words, other loops by Newton's method from `near`.  With `behind`,
    dyads that depend on these loops are closed too.  `exact` is passed to `close_positions`.
    """
    q, off = known_joints(mechanism, plan, near[..., list(mechanism.actuated)], t)
    q[..., list(plan.later)] = near[..., list(plan.later)]
    q, shorts, sines = by_dyads(mechanism, plan, q, words)
    first = len(mechanism.rows) - len(off)
    shorts += [row.arm * x for row, x in zip(mechanism.rows[first:], off, strict=True)]
    if plan.rest:
        fixed = sorted(set(range(mechanism.n)) - set(plan.rest))
        q = close_positions(mechanism, q, fixed, exact, plan.rows, t=t)
        gap = open_by(mechanism, q, plan.rows, t=t)
        shorts.append(np.where(gap > CLOSED, gap, 0.0) * loop_size(mechanism))
        if plan.behind and behind:
            q, more, flat = by_dyads(mechanism, plan.behind, q, words)
            shorts, sines = shorts + more, sines + flat
    missing = np.zeros(q.shape[:-1])
    for short in shorts:
        missing = np.maximum(missing, short)
    return Closed(q, missing, sines)


def start_pose(mechanism: Mechanism, plan: Plan, words: Sequence[str], near: Array) -> Closed:
    """Return the closed poses nearest to `near` (..., n) with dyads closed by their words.

    All joints may change, except actuated ones that the scene's `start` leaves out.  Laws of time
    are taken at t = 0.
    """
    start = mechanism.description.start or ()
    unsaid = [k for k in mechanism.actuated if start[k] is None]
    q = close_positions(mechanism, near, unsaid, t=0.0)
    held = closed_near(mechanism, plan, near, words, t=0.0)
    free = closed_near(mechanism, plan, q, words, t=0.0)  # it is q, where q is on that branch
    same = np.abs(wrapped(mechanism, free.q - q)).max(axis=-1, initial=0.0) < SAME
    fits = (free.missing <= 0.0) & same
    if not fits.all() and plan.rest:  # the dyads by their words, all else from there
        again = close_positions(mechanism, held.q, unsaid, t=0.0)
        more = closed_near(mechanism, plan, again, words, t=0.0)
        free = _each(~fits, more, free)
    away = [_changed(mechanism, x.q - near, start) for x in (free, held)]
    other = (free.missing > 0.0) | ((held.missing <= 0.0) & (away[1] < away[0]))
    found = _each(other, held, free)
    if plan.rest and near.ndim == 1 and found.missing > 0.0:
        return _searched(mechanism, plan, words, near) or found
    return found


def _searched(mechanism: Mechanism, plan: Plan, words: Sequence[str], near: Array) -> Closed | None:
    """Return the nearest pose (n,) that Newton's method finds from random poses around `near`.

    It is on the branch of `words`, with the actuated joints of `near`.  None if no pose closes.
    """
    turns = np.random.default_rng(0).uniform(-np.pi, np.pi, (AROUND, len(plan.rest)))
    rest = list(plan.rest)
    each = np.tile(near, (AROUND, 1))
    each[:, rest] += turns * mechanism.arrays.units[rest] * np.linspace(0.1, 1.0, AROUND)[:, None]
    with np.errstate(all="ignore"):
        found = closed_near(mechanism, plan, each, words, t=0.0)
    away = _changed(mechanism, found.q - near, mechanism.description.start or ())
    away = np.where(found.missing <= 0.0, away, np.inf)
    best = int(np.argmin(away))
    if not np.isfinite(away[best]):
        return None
    return closed_near(mechanism, plan, found.q[best], words, t=0.0)  # the last of Newton's steps


def _each(chosen: Mask, one: Closed, other: Closed) -> Closed:
    """Return the poses of `one` where `chosen` is true, else those of `other`."""
    sines = [np.where(chosen, a, b) for a, b in zip(one.sines, other.sines, strict=True)]
    q = np.where(chosen[..., None], one.q, other.q)
    return Closed(q, np.where(chosen, one.missing, other.missing), sines)


def _changed(mechanism: Mechanism, way: Array, start: Sequence[float | None]) -> Array:
    """Return the change (...) of the joints that a start names; displacements in lengths."""
    told = [k for k, value in enumerate(start) if value is not None]
    found: Array = np.linalg.norm(wrapped(mechanism, way)[..., told], axis=-1)
    return found


def from_start(
    mechanism: Mechanism,
    plan: Plan,
    target: Array,
    words: Sequence[str],
    watch: Callable[[float], object] | None = None,
    *,
    t: ArrayLike,
) -> Closed:
    """Close loops along a path of the actuated joints from the start's pose to `target`.

    `target` is (..., a).  Time goes from 0 to t (...) along the path.  If the short way of a single
    turning joint does not close, the other way round is tried.  `watch` is called with the finished
    part of the path.
    """
    actuated = list(mechanism.actuated)
    begin = _begin(mechanism, plan, target, words)
    size = loop_size(mechanism)
    here = begin.q.reshape(-1, mechanism.n)
    going = (begin.missing <= 0.0).reshape(-1)
    way = target.reshape(here.shape[0], len(actuated)) - here[:, actuated]
    times = np.broadcast_to(np.asarray(t, float), target.shape[:-1]).ravel()
    geared = mechanism.description.couplings
    for place, k in enumerate(actuated):
        if not geared and k not in mechanism.slides:  # turns count where joints are coupled
            way[:, place] = half_turn(way[:, place])
    here, arrived = _led(mechanism, plan, words, here, way, times, going, watch)
    again = going & ~arrived
    if len(actuated) == 1 and not geared and not mechanism.slides and again.any():
        round_about = way - np.copysign(2 * np.pi, way)
        first = begin.q.reshape(here.shape)
        there, came = _led(mechanism, plan, words, first, round_about, times, again, watch)
        here[came] = there[came]
        arrived = arrived | came
    here[:, actuated] = target.reshape(len(here), len(actuated))
    missing = np.maximum(open_by(mechanism, here, plan.rows, t=times), CLOSED) * size
    missing = np.where(arrived, 0.0, missing)
    counting = set().union(*(x.joints for x in geared))
    turning = [k for k in plan.rest if k not in counting and k not in mechanism.slides]
    here[:, turning] = half_turn(here[:, turning])
    q, _ = known_joints(mechanism, plan, here[:, actuated], times)
    q[:, list(plan.later)] = here[:, list(plan.later)]
    q, _, sines = by_dyads(mechanism, plan, q, words)
    if plan.behind:
        q, shorts, flat = by_dyads(mechanism, plan.behind, q, words)
        sines = sines + flat
        for short in shorts:
            missing = np.maximum(missing, short)
    shape = target.shape[:-1]
    sines = [np.broadcast_to(x, missing.shape).reshape(shape) for x in sines]
    return Closed(q.reshape(*shape, mechanism.n), missing.reshape(shape), sines)


def _begin(mechanism: Mechanism, plan: Plan, target: Array, words: Sequence[str]) -> Closed:
    """Return the start's pose for each target (..., a), with joints left out as in the target."""
    start = mechanism.description.start
    assert start is not None  # the plan checks it
    near = np.array([value or 0.0 for value in start])
    unsaid = [place for place, k in enumerate(mechanism.actuated) if start[k] is None]
    shape = (*target.shape[:-1], mechanism.n)
    if not unsaid:
        one = start_pose(mechanism, plan, words, near)
        return Closed(np.broadcast_to(one.q, shape), np.broadcast_to(one.missing, shape[:-1]), [])
    each = np.broadcast_to(near, shape).copy()
    each[..., [mechanism.actuated[place] for place in unsaid]] = target[..., unsaid]
    return start_pose(mechanism, plan, words, each)


def _led(
    mechanism: Mechanism,
    plan: Plan,
    words: Sequence[str],
    begin: Array,
    way: Array,
    times: Array,
    goes: Mask,
    watch: Callable[[float], object] | None,
) -> tuple[Array, Mask]:
    """Move poses (k, n) from `begin` (k, n) by `way` (k, a) of the actuated joints, to times (k,).

    Returns the poses, and which of the states `goes` (k,) arrived.  A path ends where nothing
    closes, or where a joint leaps to another branch.
    """
    actuated, rest = list(mechanism.actuated), list(plan.rest)
    units = mechanism.arrays.units
    here, going = begin.copy(), np.flatnonzero(goes)
    first = begin[:, actuated]
    longest = np.abs(way[going] / units[actuated]).max(initial=0.0)
    if mechanism.driven:  # what laws of the time give goes along
        ends = (known_joints(mechanism, plan, first, x * times)[0] for x in np.linspace(0, 1, 65))
        ways = np.abs(np.diff([x / units for x in ends], axis=0)).sum(axis=0)
        longest = max(longest, float(ways.max(initial=0.0)))
    steps = int(np.ceil(longest / PATH_STEP))
    for s in range(1, steps + 1):
        if not len(going):
            break
        if watch is not None:
            watch(s / steps)
        there = here[going]
        there[:, actuated] = first[going] + way[going] * (s / steps)
        now, last = times[going] * (s / steps), s == steps
        closed = closed_near(mechanism, plan, there, words, exact=last, behind=False, t=now)
        moved = np.abs(closed.q[:, rest] - here[going][:, rest]) / units[rest]
        kept = (moved.max(axis=-1, initial=0.0) <= LEAP) & (closed.missing <= 0.0)
        going = going[kept]
        here[going] = closed.q[kept]
    arrived = np.zeros(len(here), bool)
    arrived[going] = True
    return here, arrived


def reachable_from_start(
    mechanism: Mechanism, plan: Plan, q_actuated: Array, joint: int, words: Sequence[str], t: float
) -> list[tuple[float, float]]:
    """Return the interval of one actuated joint that a path from its start reaches.

    In rad or m, at time t.
    """
    start = mechanism.description.start
    assert start is not None  # the plan checks it
    moved = mechanism.actuated[joint]
    middle = start[moved] or 0.0
    given = np.array(q_actuated, float)
    given[joint] = middle
    begin = from_start(mechanism, plan, given, words, t=t)
    if begin.missing > 0.0:
        return []
    ends = []
    slides, units = moved in mechanism.slides, mechanism.arrays.units
    unit = float(units[moved])
    most = farthest(mechanism) if slides else np.pi
    for direction in (-1.0, 1.0):
        at, step = begin.q.copy(), PATH_STEP * unit
        while step > 1e-7 * unit and abs(at[moved] - middle) < most - 1e-9 * unit:
            there = at.copy()
            left = most - abs(at[moved] - middle)  # the way round is no shorter
            there[moved] += direction * min(step, left * (1 - 1e-12))
            found, missing, _ = closed_near(mechanism, plan, there, words, t=t)
            way = np.abs(wrapped(mechanism, found - at)).max()
            if way > LEAP * step / (PATH_STEP * unit) or missing > 0.0:
                step /= 4.0  # the limit is nearer than this
            else:
                at = found
        ends.append(float(at[moved]))
    return [(ends[0], ends[1])]


def open_by(
    mechanism: Mechanism, q: Array, rows: Sequence[int] | None = None, *, t: ArrayLike
) -> Array:
    """Return the gap of states (..., n) in `rows`, or all rows, over the loop's size, (...)."""
    gap = closure_gap(mechanism, q, t)
    gap = gap if rows is None else gap[..., list(rows)]
    return np.asarray(np.linalg.norm(gap, axis=-1) / loop_size(mechanism))


def farthest(mechanism: Mechanism) -> float:
    """Return a displacement beyond the reach of all loops, m."""
    links = mechanism.description.links
    sides = [x for c in mechanism.description.closures for x in (c.first.at, c.second.at)]
    return sum(abs(x.l) + abs(x.hangs_from.at) for x in links) + sum(map(abs, sides)) or 1.0
