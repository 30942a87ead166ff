"""The motions of a chunk of a sweep: together where lanes serve them, one by one elsewhere."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.dense_dynamics import elimination_is_safe
from robodyn.loops.change_points import suspect_quality
from robodyn.loops.closing import regular_rank
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.recording import Outcome
from robodyn.sweeps import lanes
from robodyn.sweeps.lane_motion import LaneMotion
from robodyn.sweeps.lane_program import LaneProgram
from robodyn.sweeps.lane_single import single
from robodyn.sweeps.lanes import Aims, Ends
from robodyn.sweeps.sweep_plan import Plan, base_mechanism
from robodyn.taylor import Status, best_order

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
    link = -1
    if "flip" in plan.results:
        link = plan.link % n
    regular = not base.rows or regular_rank(base) == len(base.rows)
    aims = Aims(
        rtol=plan.rtol,
        atol=plan.atol,
        most=plan.most,
        suspect=suspect_quality(base) if base.rows else 0.0,
        extremes="extremes" in plan.results,
        link=link,
        work=any(g.mechanism.changes_energy or g.tau.any() for g in groups),
    )
    ends = Ends.room(P, n)
    offset = np.zeros(P)
    angle = np.zeros(P)
    alone: list[tuple[Group, int]] = []
    together: list[Group] = []
    for group in groups:
        offset[group.points] = group.mechanism.energy_offset
        if link >= 0:
            angle[group.points] = _from_hanging(group.mechanism, group.q, link)
    fast, rest = _compiled(plan, base, groups, angle, aims)
    for group in rest:
        if regular and _served(group.mechanism):
            together.append(group)
        else:
            alone += [(group, i) for i in range(len(group.points))]
    quick = [(group.points, found) for group, found in fast]
    for chosen, found in [*quick, *_integrated(plan, together, angle, aims)]:
        for name in Ends.__slots__:
            getattr(ends, name)[chosen] = getattr(found, name)
        for lane, status in zip(chosen, found.status.tolist(), strict=True):
            outcomes[lane] = _OUTCOMES[Status(status)].label
    for group in [*(group for group, _ in fast), *together]:
        poor = {Status.SINGULAR, Status.STUCK} if base.rows else set()
        if group.mechanism.has_state_forces:  # a series may not get beyond where they bend
            poor.add(Status.STUCK)
        alone += [(group, i) for i, k in enumerate(group.points) if ends.status[k] in poor]
    for group, i in alone:
        k = int(group.points[i])
        y = np.concatenate([group.q[i], group.qd[i]])
        outcomes[k] = single(
            group.mechanism, y, group.tau[i], plan.t_end, float(angle[k]), aims, ends, k
        )
    _columns(plan, ends, offset, values)


def _compiled(
    plan: Plan, base: Mechanism, groups: list[Group], angle: Array, aims: Aims
) -> tuple[list[tuple[Group, Ends]], list[Group]]:
    """What machine code finds, and the groups that are left to the others."""
    if plan.engine != "compiled":
        return [], groups
    from robodyn.sweeps.lanes_compiled import Motions, integrate

    # the plan alone decides what the code computes, so that digits do not depend on the chunk
    named = {axis.name for axis in plan.variation.axes}
    given = dict(zip(base.actuated, plan.tau, strict=False))
    driven = [f"tau{j + 1}" in named or bool(given.get(j)) for j in range(base.n)]
    work = any(driven) or base.changes_energy or bool(plan.scene_axes)
    members = [Motions(x.mechanism, np.hstack([x.q, x.qd]), x.tau, angle[x.points]) for x in groups]
    found = integrate(members, plan.t_end, aims._replace(work=work), driven)
    both = list(zip(groups, found, strict=True))
    return [(x, ends) for x, ends in both if ends is not None], [x for x, e in both if e is None]


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


def _served(mechanism: Mechanism) -> bool:
    """Whether lanes serve it: M is regular, and every spring has a direction somewhere."""
    nowhere = any(
        (x.length or x.damping) and not x.between.terms and not x.between.constant
        for x in mechanism.springs
    )
    return not nowhere and elimination_is_safe(mechanism)


def _from_hanging(mechanism: Mechanism, q: Array, link: int) -> Array:
    """The angle of a link at q (k, n) from where it hangs along gravity, in [-pi, pi).

    Without gravity it counts from the start.
    """
    if mechanism.gamma == 0:
        return np.zeros(len(q))
    hanging = math.atan2(mechanism.gamma.imag, mechanism.gamma.real)
    alpha: Array = q @ mechanism.arrays.J[link]
    return np.asarray(np.remainder(alpha - hanging + math.pi, 2.0 * math.pi) - math.pi)


def _integrated(
    plan: Plan, groups: list[Group], angle: Array, aims: Aims
) -> Iterator[tuple[Indices, Ends]]:
    """Points whose mechanisms have the same structure, and what their motions leave behind."""
    order = best_order(plan.rtol)
    alike: dict[LaneProgram, list[tuple[Group, LaneProgram]]] = {}
    for group in groups:
        if len(group.points):
            program = LaneProgram(group.mechanism, np.any(group.tau, axis=0), order)
            alike.setdefault(program, []).append((group, program))
    for members in alike.values():
        chosen, tau, y = _gathered([group for group, _ in members])
        which = np.repeat(np.arange(len(members)), [len(group.points) for group, _ in members])
        series = LaneMotion([program for _, program in members], which, tau)
        yield chosen, lanes.integrate(series, y, plan.t_end, angle[chosen], aims)


def _gathered(groups: list[Group]) -> tuple[Indices, Array, Array]:
    """The points of groups, their torques, and their states at the start."""
    chosen = np.concatenate([group.points for group in groups])
    tau = np.concatenate([group.tau for group in groups])
    return chosen, tau, np.concatenate([np.concatenate([g.q, g.qd], axis=1) for g in groups])
