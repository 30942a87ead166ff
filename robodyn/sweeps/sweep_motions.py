"""The motions of a chunk of a sweep: together where lanes serve them, one by one elsewhere."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.loops.change_points import suspect_quality
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.recording import Outcome
from robodyn.sweeps.lane_single import single
from robodyn.sweeps.lanes import Aims, Ends, Motions, integrate
from robodyn.sweeps.sweep_plan import Plan, base_mechanism
from robodyn.taylor import Status

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_OUTCOMES = {
    Status.REACHED: Outcome.FINISHED,
    Status.FULL: Outcome.TOO_MANY_EVALUATIONS,
    Status.SINGULAR: Outcome.SINGULAR,
    Status.STUCK: Outcome.STEP_TOO_SMALL,
    Status.NOT_FINITE: Outcome.STEP_TOO_SMALL,
}


class Group(NamedTuple):
    """Points of a chunk that share a mechanism, and their start."""

    mechanism: Mechanism
    points: Indices
    q: Array  # (k, n)
    qd: Array
    tau: Array  # (k, n)


def motions(plan: Plan, groups: list[Group], values: Array, outcomes: list[str]) -> None:
    """The motions of all groups: together where lanes serve them, one by one elsewhere."""
    base = base_mechanism(plan.scene, plan.source)
    n, P = base.n, len(outcomes)
    # the plan alone decides what is computed, so that digits do not depend on the chunk
    named = {axis.name for axis in plan.variation.axes}
    given = dict(zip(base.actuated, plan.tau, strict=False))
    driven = [f"tau{j + 1}" in named or bool(given.get(j)) for j in range(n)]
    aims = Aims(
        rtol=plan.rtol,
        atol=plan.atol,
        most=plan.most,
        suspect=suspect_quality(base) if base.rows else 0.0,
        extremes="extremes" in plan.results,
        link=plan.link % n if "flip" in plan.results else -1,
        work=any(driven) or base.changes_energy or bool(plan.scene_axes),
    )
    ends, offset = Ends.room(P, n), np.zeros(P)
    members = []
    for group in groups:
        offset[group.points] = group.mechanism.energy_offset
        angle = _from_hanging(group.mechanism, group.q, aims.link)
        y = np.hstack([group.q, group.qd])
        members.append(Motions(group.mechanism, y, group.tau, angle))
    compiled = plan.engine == "compiled"
    together = integrate(members, plan.t_end, aims, driven, compiled)
    if compiled and None in together:  # no code could be made
        again = integrate(members, plan.t_end, aims, driven, compiled=False)
        together = [a or b for a, b in zip(together, again, strict=True)]
    for group, member, found in zip(groups, members, together, strict=True):
        statuses: list[Status | None] = [None] * len(group.points)
        alone: set[Status | None] = {None}
        if base.rows:
            alone |= {Status.SINGULAR, Status.STUCK}
        if group.mechanism.has_state_forces:  # a series may not get beyond where they bend
            alone.add(Status.STUCK)
        if found is not None:
            statuses = [Status(x) for x in found.status.tolist()]
            for name in Ends.__slots__:
                getattr(ends, name)[group.points] = getattr(found, name)
        for i, (k, status) in enumerate(zip(group.points.tolist(), statuses, strict=True)):
            if status is None or status in alone:
                outcomes[k] = single(member, i, plan.t_end, aims, ends, k)
            else:
                outcomes[k] = _OUTCOMES[status].label
    _columns(plan, ends, offset, values)


def _columns(plan: Plan, ends: Ends, offset: Array, values: Array) -> None:
    """The results into their columns."""
    parts = []
    if "final" in plan.results:
        parts += [np.where(np.isnan(ends.y[:, 0]), math.nan, ends.t)[:, None], ends.y]
    if "extremes" in plan.results:
        both = np.stack([ends.low, ends.high], axis=-1)
        parts += [both.reshape(len(both), -1), ends.energy + offset[:, None]]
    if "drift" in plan.results:
        parts.append(ends.drift[:, None])
    if "flip" in plan.results:
        parts.append(ends.flip[:, None])
    if parts:
        values[:, len(plan.variation.axes) :] = np.concatenate(parts, axis=1)


def _from_hanging(mechanism: Mechanism, q: Array, link: int) -> Array:
    """The angle of a link at q (k, n) from where it hangs along gravity, in [-pi, pi).

    Without gravity it counts from the start; of no link (-1) it is 0.
    """
    if link < 0 or mechanism.gamma == 0:
        return np.zeros(len(q))
    hanging = math.atan2(mechanism.gamma.imag, mechanism.gamma.real)
    alpha: Array = q @ mechanism.arrays.J[link]
    return np.asarray(np.remainder(alpha - hanging + math.pi, 2.0 * math.pi) - math.pi)
