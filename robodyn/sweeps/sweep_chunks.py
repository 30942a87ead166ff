"""A sweep: the same simulation or torque at every point of a variation, chunk by chunk.

A chunk has as many points wherever it is computed: its rows depend on the plan and its number
alone, so that any number of workers on any machine of the same kind writes the same digits.  A
point without a result is a row with its outcome, not an error.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn import __version__
from robodyn.dynamics.dynamics import RobodynWarning, inverse_dynamics_and_forces, loop_forces
from robodyn.errors import DescriptionError, InputError, RobodynError, SingularError
from robodyn.loops import assembly, loop_rates
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.simulation.recording import Outcome
from robodyn.sweeps.scene_values import SceneValues
from robodyn.sweeps.sweep_motions import Group, motions
from robodyn.sweeps.sweep_plan import Plan, base_mechanism
from robodyn.sweeps.variation import Axis

Array = NDArray[np.float64]

CANNOT_ASSEMBLE = "cannot assemble"
FINISHED = Outcome.FINISHED.label


class Rows(NamedTuple):
    """The rows of a chunk: numbers (k, columns - 1), nan where there is none, and outcomes (k,)."""

    values: Array
    outcomes: list[str]


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
            for group in groups:
                _torques(plan, group, points, values, outcomes)
        else:
            motions(plan, groups, values, outcomes)
    return Rows(values, outcomes)


def _groups(plan: Plan, points: Array, outcomes: list[str]) -> Iterator[Group]:
    """The points, a group for each mechanism, less those that cannot be assembled."""
    axes = plan.variation.axes
    changed = list(plan.scene_axes)
    scene = SceneValues(plan.scene, plan.source)
    members: dict[tuple[float, ...], list[int]] = {}
    for k, key in enumerate(map(tuple, points[:, changed].tolist())):
        members.setdefault(key, []).append(k)
    for key, indices in members.items():
        mechanism = base_mechanism(plan.scene, plan.source)
        if changed:
            names = [axes[k].name for k in changed]
            try:
                mechanism = build(scene.replaced(dict(zip(names, key, strict=True))))
            except DescriptionError as error:  # which no process can hand to another
                raise InputError("the scene with these values", limit=str(error)) from None
        chosen = np.array(indices)
        q, qd, tau = (
            _given(mechanism, name, base, axes, points[chosen])
            for name, base in (("q", plan.q), ("qd", plan.qd), ("tau", plan.tau))
        )
        full_q, missing = assembly.attempt(mechanism, q)
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


def _velocities(mechanism: Mechanism, q: Array, qd: Array) -> tuple[Array, NDArray[np.bool_]]:
    """All rates (k, n) from the actuated joints', and which states have them."""
    kept = np.ones(len(q), bool)
    try:
        return loop_rates.loop_velocities(mechanism, q, qd), kept
    except SingularError:
        full = np.zeros_like(q)
        for k in range(len(q)):
            try:
                full[k] = loop_rates.loop_velocities(mechanism, q[k], qd[k])
            except SingularError:
                kept[k] = False
        return full, kept


def _torques(plan: Plan, group: Group, points: Array, values: Array, outcomes: list[str]) -> None:
    """The torques and loop forces of a group, or of each of its points where one has none."""
    mechanism = group.mechanism
    given = _given(mechanism, "qdd", plan.qdd, plan.variation.axes, points[group.points])

    def compute(chosen: slice) -> Array:
        q, qd = group.q[chosen], group.qd[chosen]
        qdd = loop_rates.loop_accelerations(mechanism, q, qd, given[chosen])
        found = inverse_dynamics_and_forces(mechanism, q, qd, qdd)
        forces = loop_forces(mechanism, found.multipliers)
        return np.concatenate([found.tau[:, list(mechanism.actuated)], forces], axis=1)

    first = points.shape[1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobodynWarning)
        try:
            values[group.points, first:] = compute(slice(None))
            for k in group.points:
                outcomes[k] = FINISHED
        except SingularError:
            for i, k in enumerate(group.points):
                outcomes[k] = Outcome.SINGULAR.label
                try:
                    values[k, first:] = compute(slice(i, i + 1))[0]
                    outcomes[k] = FINISHED
                except SingularError:
                    pass
