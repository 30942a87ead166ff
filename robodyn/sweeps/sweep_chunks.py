"""A sweep: the same simulation or torque at every point of a variation, chunk by chunk.

A chunk has as many points wherever it is computed: its rows depend on the plan and its number
alone, so that any number of workers on any machine of the same kind writes the same digits.  A
point without a result is a row with its outcome, not an error.
"""

from __future__ import annotations

import cmath
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn import __version__
from robodyn.control.tracking import ReferenceTable
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.dynamics.state_columns import torque_columns
from robodyn.engines import machine
from robodyn.errors import DescriptionError, InputError, RobodynError, SingularError
from robodyn.loops import assembly, loop_rates
from robodyn.loops.assembly_plan import with_independent
from robodyn.loops.change_points import MISSES, suspect_quality
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.rest.balance import rests
from robodyn.scene.scene_values import read_numbers
from robodyn.simulation.report import Outcome
from robodyn.sweeps.lane_single import single
from robodyn.sweeps.lanes import Aims, Ends, Motions, integrate
from robodyn.sweeps.row_results import at_states, of_rows, of_states
from robodyn.sweeps.sweep_plan import Plan
from robodyn.sweeps.variation import Axis
from robodyn.tables.arrays import Array
from robodyn.taylor import Status

Indices = NDArray[np.intp]
Kept = NDArray[np.bool_]

CANNOT_ASSEMBLE = "cannot assemble"
NO_SCENE = "not a scene"  # with what was drawn
FINISHED = Outcome.FINISHED.label


_OUTCOMES = {
    int(Status.REACHED): Outcome.FINISHED.label,
    int(Status.FULL): Outcome.TOO_MANY_EVALUATIONS.label,
    int(Status.SINGULAR): Outcome.SINGULAR.label,
    int(Status.STUCK): Outcome.STEP_TOO_SMALL.label,
    int(Status.NOT_FINITE): Outcome.STEP_TOO_SMALL.label,
}


class Rows(NamedTuple):
    """The rows of a chunk: numbers (k, columns - 1), nan where there is none, and outcomes (k,).

    And what is said of a change point that one of them just misses.
    """

    values: Array
    outcomes: list[str]
    remark: str = ""


class Group(NamedTuple):
    """Points of a chunk that share a mechanism, and their start."""

    mechanism: Mechanism
    points: Indices
    q: Array  # (k, n)
    qd: Array
    tau: Array  # (k, n)


def run_chunk(plan: Plan, number: int) -> Rows:
    """The rows of chunk `number`, from 0."""
    if plan.version != __version__:
        limit = f"the sweep is of version {plan.version}: a worker must have the same"
        raise RobodynError("robodyn", value=__version__, limit=limit)
    begin = number * plan.chunk
    points = plan.variation.points(begin, min(begin + plan.chunk, plan.variation.size))
    outcomes = [CANNOT_ASSEMBLE] * len(points)
    values = np.full((len(points), len(plan.columns()) - 1), math.nan)
    values[:, : points.shape[1]] = points
    with np.errstate(all="ignore"):
        groups = list(_groups(plan, points, outcomes))
        if plan.kind == "torque":
            said = [_torques(plan, group, points, values, outcomes) for group in groups]
        else:
            said = _motions(plan, groups, values, outcomes)
    return Rows(values, outcomes, next(filter(None, said), ""))


def _groups(plan: Plan, points: Array, outcomes: list[str]) -> Iterator[Group]:
    """The points, a group for each mechanism, less those that cannot be assembled."""
    axes = plan.variation.axes
    changed = list(plan.scene_axes)
    scene = None
    if changed:
        scene = read_numbers(plan.scene, plan.source, plan.numbers, plan.tables)
    members: dict[tuple[float, ...], list[int]] = {}
    for k, key in enumerate(map(tuple, points[:, changed].tolist())):
        members.setdefault(key, []).append(k)
    for key, indices in members.items():
        mechanism = plan.mechanism
        if scene is not None:
            names = [axes[k].name for k in changed]
            try:
                mechanism = build(scene.replaced(dict(zip(names, key, strict=True))))
            except DescriptionError as error:
                if any(axis.deviation for axis in axes):  # one may be drawn that is out of limits
                    for k in indices:
                        outcomes[k] = NO_SCENE
                    continue
                raise InputError("the scene with these values", limit=str(error)) from None
        chosen, driver = np.array(indices), with_independent(mechanism)
        q, qd, tau = (
            _given(given_by, name, base, axes, points[chosen])
            for given_by, name, base in (
                (driver, "q", plan.q),
                (driver, "qd", plan.qd),
                (mechanism, "tau", plan.tau),
            )
        )
        full_q, missing = assembly.attempt(driver, q)
        for k in chosen[np.isnan(missing)]:
            outcomes[k] = Outcome.SINGULAR.label
        closes = np.isfinite(full_q).all(axis=1) & (missing <= 0.0)
        chosen, full_q, qd, tau = chosen[closes], full_q[closes], qd[closes], tau[closes]
        full_qd, kept = _velocities(mechanism, full_q, qd)
        for k in chosen[~kept]:
            outcomes[k] = Outcome.SINGULAR.label
        torques = np.zeros((len(chosen), mechanism.n))
        torques[:, list(mechanism.actuated)] = tau
        if not kept.any():
            continue
        yield Group(mechanism, chosen[kept], full_q[kept], full_qd[kept], torques[kept])


def _given(
    mechanism: Mechanism, name: str, base: Sequence[float], axes: Sequence[Axis], points: Array
) -> Array:
    """A quantity of the actuated joints at points, (k, actuated)."""
    actuated = mechanism.actuated
    values = np.tile(np.array(base or [0.0] * len(actuated)), (len(points), 1))
    names = [f"{name}{k + 1}" for k in actuated]
    for k, axis in enumerate(axes):
        if axis.name in names:
            values[:, names.index(axis.name)] = points[:, k]
    return values


def _regular(compute: Callable[[slice], Array], shape: tuple[int, int]) -> tuple[Array, Kept]:
    """The rows that it computes, all at once or, where one is singular, each; which are there."""
    kept = np.ones(shape[0], bool)
    try:
        return compute(slice(None)), kept
    except SingularError:
        found = np.zeros(shape)
        for k in range(len(found)):
            try:
                found[k] = compute(slice(k, k + 1))[0]
            except SingularError:
                kept[k] = False
        return found, kept


def _velocities(mechanism: Mechanism, q: Array, qd: Array) -> tuple[Array, Kept]:
    """All rates (k, n) from the independent joints', and which states have them."""
    driver = with_independent(mechanism)
    return _regular(lambda k: loop_rates.loop_velocities(driver, q[k], qd[k]), q.shape)


def _torques(plan: Plan, group: Group, points: Array, values: Array, outcomes: list[str]) -> str:
    """The columns of a group, or of each of its points where one has none; the remark."""
    mechanism, first = group.mechanism, points.shape[1]
    texts = plan.told or torque_columns(mechanism)
    driver = with_independent(mechanism)
    given = _given(driver, "qdd", plan.qdd, plan.variation.axes, points[group.points])

    def compute(chosen: slice) -> Array:
        q, qd = group.q[chosen], group.qd[chosen]
        solved = at_states(mechanism, np.zeros(len(q)), q, qd, given[chosen])
        return of_states(mechanism, texts, plan.of, solved)

    if plan.track is not None:  # which all points of a mechanism share
        with _misses() as said:
            found, outcome = _along(plan, mechanism, plan.track)
        values[group.points, first:] = found
        for k in group.points:
            outcomes[k] = outcome
        return next(iter(said), "")
    with _misses() as said:
        found, kept = _regular(compute, (len(group.points), len(texts)))
    values[group.points[kept], first:] = found[kept]
    for k, regular in zip(group.points, kept, strict=True):
        outcomes[k] = FINISHED if regular else Outcome.SINGULAR.label
    return next(iter(said), "")


@contextmanager
def _misses() -> Iterator[list[str]]:
    """What is said of change points that are just missed; other remarks are of single states."""
    said: list[str] = []
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("always", RobodynWarning)
        yield said
    for x in remarks:
        if not issubclass(x.category, RobodynWarning):
            warnings.warn_explicit(x.message, x.category, x.filename, x.lineno)
    parts = "; ".join(str(x.message) for x in remarks).split("; ")
    said += [part for part in parts if part.startswith(MISSES)]


def _along(plan: Plan, mechanism: Mechanism, track: ReferenceTable) -> tuple[Array, str]:
    """The results of torques along a reference, nan where there are none, and the outcome."""
    nothing, t = np.full(len(plan.told), math.nan), np.array(track.times)
    driven, rates = track.at(t)
    q, missing = assembly.attempt(mechanism, driven)
    if np.isnan(missing).any():
        return nothing, Outcome.SINGULAR.label
    if not np.isfinite(q).all() or (missing > 0.0).any():
        return nothing, CANNOT_ASSEMBLE
    qd, kept = _velocities(mechanism, q, rates)
    if not kept.all():
        return nothing, Outcome.SINGULAR.label
    try:
        solved = at_states(mechanism, t, q, qd, track.accelerations(t))
        columns = of_states(mechanism, plan.told, plan.of, solved)
    except SingularError:
        return nothing, Outcome.SINGULAR.label
    return of_rows(plan.told, t, columns), FINISHED


def _motions(plan: Plan, groups: list[Group], values: Array, outcomes: list[str]) -> list[str]:
    """The motions of all groups: together where lanes serve them, one by one elsewhere.

    Returns the remarks; near a change point motions go one by one.
    """
    base = plan.mechanism
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
        link=_turning(base, plan.link % n) if "flip" in plan.results else -1,
        work=any(driven) or base.changes_energy or bool(plan.scene_axes),
    )
    ends, offset = Ends.room(P, n), np.zeros(P)
    members, said = [], []
    for group in groups:
        offset[group.points] = group.mechanism.energy_offset
        angle = _from_hanging(group.mechanism, group.q, aims.link)
        y = np.hstack([group.q, group.qd])
        members.append(Motions(group.mechanism, y, group.tau, angle))
    told = np.full((P, 2 * len(plan.events) + len(plan.told)), math.nan)
    together: list[Ends | None] = [None] * len(members)
    if plan.method == "taylor":
        if not machine.available():
            limit = "the sweep goes by machine code: a worker must have the extra `fast`, too"
            raise RobodynError("llvmlite", limit=limit)
        together = integrate(members, plan.t_end, aims, driven)
    for group, member, found in zip(groups, members, together, strict=True):
        alone = list(_OUTCOMES)
        if found is not None:
            for name in Ends.__slots__:
                getattr(ends, name)[group.points] = getattr(found, name)
            for k, status in zip(group.points.tolist(), found.status.tolist(), strict=True):
                outcomes[k] = _OUTCOMES[status]
            alone = [Status.SINGULAR, Status.STUCK] if base.rows else []
            if group.mechanism.has_state_forces:  # a series may not get beyond where they bend
                alone.append(Status.STUCK)
        for i in np.flatnonzero(np.isin(ends.status[group.points], alone)).tolist():
            k = int(group.points[i])
            outcomes[k], remark = single(plan, member, i, aims, ends, k, told[k])
            said.append(remark)
    if "flip" in plan.results and not plan.control:
        for group in groups:
            with suppress(RobodynError):  # beyond a table nothing rests
                at_rest = rests(group.mechanism, group.q, group.qd, group.tau)
                ends.flip[group.points[at_rest]] = math.nan  # only rounding moves it
    _fill(plan, ends, offset, told, values)
    return said


def _fill(plan: Plan, ends: Ends, offset: Array, told: Array, values: Array) -> None:
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
    parts.append(told)
    values[:, len(plan.variation.axes) :] = np.concatenate(parts, axis=1)


def _turning(mechanism: Mechanism, link: int) -> int:
    """The link whose direction a link has; -1 where it is the ground's."""
    frame = mechanism.frames[link]
    return -1 if frame is None else frame


def _from_hanging(mechanism: Mechanism, q: Array, link: int) -> Array:
    """The angle of a link at q (k, n) from where it hangs along gravity, in [-pi, pi).

    Without gravity it counts from the start; of no link (-1) it is 0.
    """
    if link < 0 or mechanism.gamma == 0:
        return np.zeros(len(q))
    hanging = math.atan2(mechanism.gamma.imag, mechanism.gamma.real)
    alpha: Array = q @ mechanism.arrays.J[link]
    alpha = alpha + cmath.phase(Tree(mechanism.description.links).phases[link])
    return np.asarray(np.remainder(alpha - hanging + math.pi, 2.0 * math.pi) - math.pi)
