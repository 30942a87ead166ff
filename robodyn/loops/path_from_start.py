"""Loops that are no chain of dyads: closed along a path from the scene's `start`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robodyn.dynamics.closed_form import closure_gap
from robodyn.loops.assembly_plan import joints_of
from robodyn.loops.closing import close_positions, half_turn, loop_size
from robodyn.loops.dyads import CLOSED
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

PATH_STEP = 0.02  # rad, step of the actuated joints on the path from `start`
LEAP = 0.5  # rad; a passive joint that moves more in such a step has left its branch


def from_start(
    mechanism: Mechanism, q: Array, watch: Callable[[float], object] | None = None
) -> tuple[Array, Array]:
    """Close what is left along a path of the actuated joints from the scene's start.

    `watch` is told what part of the path is gone.
    """
    start = mechanism.description.start
    assert start is not None  # the plan checks it
    actuated, passive = list(mechanism.actuated), list(mechanism.passive)
    target = q[..., actuated]
    unsaid = [k for k in actuated if start[k] is None]
    begin = np.broadcast_to([angle or 0.0 for angle in start], q.shape).copy()
    begin[..., unsaid] = q[..., unsaid]
    way = target - begin[..., actuated]
    geared, units = mechanism.description.couplings, mechanism.arrays.units
    for place, k in enumerate(actuated):
        if not geared and k not in mechanism.slides:  # turns count where joints are coupled
            way[..., place] = half_turn(way[..., place])
    steps = int(np.ceil(np.abs(way / units[actuated]).max(initial=0.0) / PATH_STEP))
    here = close_positions(mechanism, begin, actuated).reshape(-1, mechanism.n)
    going = np.flatnonzero(_gap(mechanism, here) <= CLOSED)  # states whose path has not ended
    first, way = here[:, actuated].copy(), way.reshape(-1, len(actuated))
    for s in range(1, steps + 1):
        if not len(going):
            break
        if watch is not None:
            watch(s / steps)
        there = here[going]
        there[:, actuated] = first[going] + way[going] * (s / steps)
        there = close_positions(mechanism, there, actuated, exact=s == steps)
        # beyond a limit nothing closes, or only after a leap to another branch: the path ends
        moved = np.abs(there[:, passive] - here[going][:, passive]) / units[passive]
        kept = (moved.max(axis=-1, initial=0.0) <= LEAP) & (_gap(mechanism, there) <= CLOSED)
        going = going[kept]
        here[going] = there[kept]
    lost = np.ones(len(here), bool)
    lost[going] = False
    here[:, actuated] = target.reshape(first.shape)
    missing = np.maximum(_gap(mechanism, here), CLOSED) * loop_size(mechanism)
    missing = np.where(lost, missing, 0.0)
    counting = set().union(*map(joints_of, geared))
    turning = [k for k in passive if k not in counting and k not in mechanism.slides]
    here[:, turning] = half_turn(here[:, turning])
    return here.reshape(q.shape), missing.reshape(q.shape[:-1])


def reachable_from_start(
    mechanism: Mechanism, q_actuated: Array, joint: int
) -> list[tuple[float, float]]:
    """The interval of one actuated joint about its start that a path can reach, rad."""
    start = mechanism.description.start
    assert start is not None  # the plan checks it
    actuated, moved = list(mechanism.actuated), mechanism.actuated[joint]
    here, middle = np.zeros(mechanism.n), start[moved] or 0.0
    here[actuated] = q_actuated
    here[moved] = middle
    here, missing = from_start(mechanism, here)
    if missing > 0.0:
        return []
    ends = []
    slides, units = moved in mechanism.slides, mechanism.arrays.units
    unit = float(units[moved])
    most = farthest(mechanism) if slides else np.pi
    for direction in (-1.0, 1.0):
        at, step = here.copy(), PATH_STEP * unit
        while step > 1e-7 * unit and abs(at[moved] - middle) < most - 1e-9 * unit:
            there = at.copy()
            left = most - abs(at[moved] - middle)  # the way round is no shorter
            there[moved] += direction * min(step, left * (1 - 1e-12))
            there = close_positions(mechanism, there, actuated)
            leap = np.abs((there - at) / units).max() > LEAP * step / (PATH_STEP * unit)
            if leap or _gap(mechanism, there) > CLOSED:
                step /= 4.0  # the limit is nearer than this
            else:
                at = there
        ends.append(float(at[moved]))
    return [(ends[0], ends[1])]


def _gap(mechanism: Mechanism, q: Array) -> Array:
    """How far states (..., n) are open, as a part of the loop's size."""
    gap = np.linalg.norm(closure_gap(mechanism, q), axis=-1)
    return np.asarray(gap / loop_size(mechanism))


def farthest(mechanism: Mechanism) -> float:
    """A displacement that no loop of the mechanism reaches, m."""
    links = mechanism.description.links
    sides = [x for c in mechanism.description.closures for x in (c.first.at, c.second.at)]
    return sum(abs(x.l) + abs(x.hangs_from.at) for x in links) + sum(map(abs, sides)) or 1.0
