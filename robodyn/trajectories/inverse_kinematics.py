"""Inverse kinematics: the joints that bring a point to given places, along one branch."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.placed import numbers
from robodyn.errors import AssemblyError, InputError, SingularError
from robodyn.kinematics.named_points import named_point
from robodyn.loops.assembly import all_branches, assembly_plan, attempt, scene_branches
from robodyn.loops.closing import wrapped
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array
from robodyn.trajectories.joint_paths import Legs, spread
from robodyn.trajectories.profiles import profile
from robodyn.trajectories.reference import all_joints
from robodyn.trajectories.task_space import Task, TaskPath, pose_of, task_of

MOST_WAYS = 8  # of dyads with two branches each, of which the nearest is looked for


def inverse_kinematics(
    mechanism: Mechanism,
    xy: ArrayLike,
    of: str,
    angle: ArrayLike | None = None,
    near: ArrayLike | None = None,
) -> Array:
    """The joints q (..., n), rad, that bring the point `of` to places xy (..., 2), m.

    `angle` (...) asks for the absolute angle of the point's link too, rad.  The places follow one
    another along one branch: the one nearest to the pose `near` (n, or actuated) at the first, or
    that of the scene's `assembly` (`open` for the point itself).  Chains of dyads are solved in
    closed form; else, and where the mechanism is redundant (then by least motion), Newton's method
    follows straight lines from `near` and from place to place.

    Raises InputError for arguments that do not fit, AssemblyError where a place is out of reach,
    SingularError where links that lead to it may have any direction.
    """
    named = named_point(mechanism, of, "of")
    places = numbers("xy", xy)
    if places.ndim == 0 or places.shape[-1] != 2 or not np.isfinite(places).all():
        raise InputError("xy", value=places.shape, limit="must be (..., 2), finite: x and y, m")
    shape = places.shape[:-1]
    if angle is not None:
        try:
            turned = np.broadcast_to(numbers("angle", angle), shape)[..., None]
        except ValueError:
            turned = np.array([np.nan])
        if not np.isfinite(turned).all():
            raise InputError("angle", limit=f"must be {shape}, one a place, and finite")
        places = np.concatenate([places, turned], axis=-1)
    task = task_of(mechanism, named, angle is not None)
    pose = None
    if near is not None:
        pose = pose_of(task, all_joints(mechanism, numbers("near", near)[None])[0])
    q = along_branch(task, places.reshape(-1, places.shape[-1]), pose)
    return q.reshape(*shape, mechanism.n)


def along_branch(task: Task, places: Array, pose: Array | None) -> Array:
    """q (K, n) at places (K, c), from the branch that is nearest to a closed pose (n,) on."""
    n = task.mechanism.n
    if not len(places):
        return np.zeros((0, n))
    if not is_dyads(task):
        if pose is None:
            raise InputError("near", limit="missing: give the pose that it begins from")
        return _followed(task, places, pose)
    branches = _nearest_branches(task, places[0], pose)
    whole, missing = attempt(task.guided, places, branches)
    if not (missing <= 0.0).all():
        k = int(np.argmin(missing <= 0.0))
        at = f"({places[k, 0]:.9g}, {places[k, 1]:.9g})"
        if np.isnan(missing[k]):
            what = f"singular configuration: {task.of.name} at {at}"
            limit = "any direction of the links leads there: choose a place beside it"
            raise SingularError(what, where=task.mechanism.source, limit=limit)
        what = f"{task.of.name} does not reach {at}"
        limit = f"place {k + 1} is {missing[k]:.9g} m out of reach"
        raise AssemblyError(what, where=task.mechanism.source, limit=limit)
    q: Array = whole[:, :n]
    turning = [k for k in range(n) if k not in task.mechanism.slides]
    first = q[:1, turning].copy()
    if pose is not None:
        first -= 2 * np.pi * np.round((first - pose[turning]) / (2 * np.pi))
    q[:, turning] = np.unwrap(np.concatenate([first, q[:, turning]]), axis=0)[1:]
    return q


def is_dyads(task: Task) -> bool:
    """Whether there is a closed form."""
    if task.redundant or task.mechanism.description.couplings:  # couplings count turns
        return False
    try:
        plan = assembly_plan(task.guided)
    except InputError:
        return False
    return not plan.rest and len(plan.two_way) <= MOST_WAYS


def _nearest_branches(task: Task, place: Array, pose: Array | None) -> tuple[str, ...]:
    """The words of the branch that is nearest to a pose at a place, among those that close."""
    words = scene_branches(task.guided)
    if pose is None:
        return words
    best, n = np.inf, task.mechanism.n
    for trial in all_branches(task.guided):
        q, missing = attempt(task.guided, place, trial)
        away = float(np.linalg.norm(wrapped(task.mechanism, q[:n] - pose)))
        if missing <= 0.0 and away < best:
            best, words = away, trial
    return words


def _followed(task: Task, places: Array, pose: Array) -> Array:
    """By Newton's method along straight lines from the pose and from place to place."""
    points = np.concatenate([task.place(pose)[None], places])
    points[0, 2:] -= 2 * np.pi * np.round((points[0, 2:] - places[0, 2:]) / (2 * np.pi))
    moved = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 0.0)
    stations = points[moved]
    if len(stations) == 1:
        return np.repeat(pose[None], len(places), axis=0)
    knots = spread(stations)
    path = TaskPath(task, Legs(stations, knots, profile("constant")), pose)
    q: Array = path.evaluate(knots)[0][np.cumsum(moved)[1:] - 1]
    return q
