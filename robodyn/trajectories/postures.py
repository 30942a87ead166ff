"""Postures: the poses in which a point of a mechanism is at a given place.

The point is led by the guide of `task_space.py`.  If the guided mechanism is a chain of dyads, each
choice of branches is a posture in closed form.  Otherwise Newton's method starts from the given
pose and from poses around it; the nearest result is taken, for a redundant mechanism that of least
change.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.closed_form import point_motion
from robodyn.dynamics.joint_vectors import full, vectors
from robodyn.dynamics.named_points import named_point
from robodyn.errors import AssemblyError, InputError, SingularError
from robodyn.loops import assembly
from robodyn.loops.closing import close_positions, loop_size, wrapped
from robodyn.loops.closures import closure_gap, scaled_jacobian
from robodyn.mechanics.driven import refuse_driven
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import numbers
from robodyn.tables.arrays import Array
from robodyn.trajectories.task_space import Task, is_dyads, out_of_reach, task_of

ALIKE = 1e-6  # rad, or of a length: postures that are one
BEGUN = 64  # poses around the given one from which Newton's method begins
CLOSES = 1e-10  # part of the loop's size
NEARER = 80  # steps towards the least change


class Posture(NamedTuple):
    """A pose q (n,), rad and m, with the `branch` that tells it from other postures."""

    branch: str
    q: Array


def postures(
    mechanism: Mechanism,
    xy: ArrayLike,
    of: str,
    angle: float | None = None,
    near: ArrayLike | None = None,
) -> list[Posture]:
    """Return the postures in which the point `of` is at xy (2,), m.

    `angle` (rad) also asks for the absolute angle of the point's link, from the ground's X axis.

    For an arm of two joints all postures are returned, the nearest to `near` first.  `branch` is
    then `left` or `right`: the side of the line from the first joint to the point on which the
    second joint lies; `stretched` or `folded` if it lies on the line; with a sliding joint, `ahead`
    or `behind`.  For other mechanisms the one nearest to `near` is returned.

    `near` has all joints (n,), which need not close, or the actuated ones; by default it is the
    scene's start, or the first pose that closes.  Unless `near` has all joints, loops that are
    chains of dyads keep the scene's branch, which `branch` tells.  Raises InputError for wrong
    arguments, AssemblyError for a place out of reach or on another branch, and SingularError if
    links on the way may have any direction.
    """
    refuse_driven(mechanism, "inverse kinematics")
    named = named_point(mechanism, of, "of")
    place = numbers("xy", xy)
    if place.shape != (2,) or not np.isfinite(place).all():
        raise InputError("xy", value=place.shape, limit="must be (2,), finite: x and y, m")
    if angle is not None:
        turned = numbers("angle", angle)
        if turned.shape or not np.isfinite(turned):
            raise InputError("angle", limit="must be one finite number, rad")
        place = np.append(place, turned)
    task = task_of(mechanism, named, angle is not None)
    if near is None:
        return postures_at(task, place, _first(mechanism), False)
    given, whole = vectors(mechanism, near=near)["near"]
    if given.ndim > 1:
        raise InputError("near.shape", value=given.shape, limit="must be that of one pose")
    if not whole:
        given = full(mechanism, {"q": (given, False)}, t=0.0)["q"]
    return postures_at(task, place, given, whole)


def _first(mechanism: Mechanism) -> Array:
    """Return the pose near which to search if none is given; it need not be closed."""
    start = mechanism.description.start
    if start is None:
        try:
            return assembly.first_pose(mechanism, t=0.0)
        except (AssemblyError, InputError, SingularError):
            start = ()
    return np.array([x or 0.0 for x in start or (None,) * mechanism.n])


def postures_at(task: Task, place: Array, near: Array, whole: bool) -> list[Posture]:
    """Return the postures of a task at a place (c,), nearest to the pose `near` (n,) first."""
    mechanism = task.mechanism
    dyads = is_dyads(task)
    q = _by_dyads(task, place, near) if dyads else _by_newton(task, place, near)
    turning = [k for k in range(mechanism.n) if k not in mechanism.slides]
    if not mechanism.description.couplings:  # couplings count turns
        q[:, turning] -= 2 * np.pi * np.round((q - near)[:, turning] / (2 * np.pi))
    away = np.linalg.norm(wrapped(mechanism, q - near), axis=-1)
    q = q[np.argsort(away, kind="stable")]
    if not mechanism.rows and mechanism.n == 2 and dyads:
        return _of_arm(mechanism, task, q)
    if not mechanism.rows or not _has_words(mechanism):
        return [Posture("nearest", q[0])]
    own = assembly.scene_branches(mechanism)
    for pose in q:
        words = _words(mechanism, pose)
        if whole or words is None or words == own:
            return [Posture(_told(mechanism, words), pose)]
    x, y = place[:2]
    there = _told(mechanism, _words(mechanism, q[0]))
    raise AssemblyError(
        f"{task.of.name} does not reach ({x:.9g}, {y:.9g})",
        where=mechanism.source,
        limit=f"as {_told(mechanism, own)}; as {there} it does: say so in `assembly`, or give "
        "all joints of a pose near to it",
    )


def _has_words(mechanism: Mechanism) -> bool:
    """Return whether words determine the branch of every loop."""
    try:
        return not assembly.assembly_plan(mechanism).rest
    except InputError:
        return False


def _told(mechanism: Mechanism, words: tuple[str, ...] | None) -> str:
    two_way = assembly.assembly_plan(mechanism).two_way
    return " ".join(words[k] for k in two_way) if words and two_way else "nearest"


def _words(mechanism: Mechanism, q: Array) -> tuple[str, ...] | None:
    """Return the branch words of a closed pose q (n,); the scene's where branches meet."""
    own = assembly.scene_branches(mechanism)
    for words in (own, *assembly.all_branches(mechanism)):
        found, missing = assembly.attempt(mechanism, q[list(mechanism.actuated)], words, t=0.0)
        if missing <= 0.0 and np.abs(wrapped(mechanism, found - q)).max() < ALIKE:
            return words
    return None


def _of_arm(mechanism: Mechanism, task: Task, q: Array) -> list[Posture]:
    """Return the distinct postures among q (k, 2) of an arm of two joints."""
    apart: list[Array] = []
    for pose in q:
        if all(np.abs(wrapped(mechanism, pose - x)).max() >= ALIKE for x in apart):
            apart.append(pose)
    if not mechanism.slides:
        return [Posture(_side(mechanism, task, pose), pose) for pose in apart]
    if len(apart) == 1:
        return [Posture("only", apart[0])]
    slide = mechanism.slides[0]
    middle = np.mean(apart, axis=0)[slide]
    return [Posture("ahead" if x[slide] > middle else "behind", x) for x in apart]


def _side(mechanism: Mechanism, task: Task, q: Array) -> str:
    """Return on which side of the line from the first joint to the point the second joint lies."""
    along, over = _lengths(mechanism, task, q)
    bend = (along.conjugate() * (along + over)).imag
    if abs(bend) <= ALIKE * abs(along) * abs(over):
        return "stretched" if (along.conjugate() * over).real > 0.0 else "folded"
    return "right" if bend > 0.0 else "left"


def _lengths(mechanism: Mechanism, task: Task, q: Array) -> tuple[complex, complex]:
    """Return the plane vectors from first to second joint, and from there to the point."""
    first, second = mechanism.path(task.of.own.link)[:2]
    points = [mechanism.pivots[first], mechanism.pivots[second], task.of.point]
    a, b, c = point_motion(mechanism, points, q)[0]
    return complex(*(b - a)), complex(*(c - b))


def _by_dyads(task: Task, place: Array, near: Array) -> Array:
    """Return q (k, n) for each choice of branches that closes."""
    mechanism, found, short = task.mechanism, [], []
    for words in assembly.all_branches(task.guided):
        q, missing = assembly.attempt(task.guided, place, words, t=0.0)
        short.append(float(missing))
        if missing <= 0.0:
            found.append(q[: mechanism.n])
    if found:
        return np.array(found)
    x, y = place[:2]
    if np.isnan(short).any():
        what = f"singular configuration: {task.of.name} at ({x:.9g}, {y:.9g})"
        limit = "any direction of the links leads there: choose a place beside it"
        raise SingularError(what, where=mechanism.source, limit=limit)
    reached = f"at least {min(short):.9g} m are missing"
    if not mechanism.rows and mechanism.n == 2 and not mechanism.slides:
        a, b = (abs(z) for z in _lengths(mechanism, task, near))
        reached = f"{abs(a - b):.9g} to {a + b:.9g} m are reached"
    raise _beyond(task, place, near, reached)


def _beyond(task: Task, place: Array, near: Array, reached: str) -> AssemblyError:
    """Return the error for a place out of reach, with its distance and what can be reached."""
    mechanism, (x, y) = task.mechanism, place[:2]
    first = mechanism.path(task.of.own.link)[0]
    base = point_motion(mechanism, [mechanism.pivots[first]], near)[0][0]
    far, turned = float(np.linalg.norm(place[:2] - base)), ""
    if len(place) > 2:
        turned = f" at an angle of {np.degrees(place[2]):.9g} deg"
    what = f"{task.of.name} does not reach ({x:.9g}, {y:.9g}){turned}"
    limit = f"it is {far:.9g} m from the joint of {mechanism.link_names[first]}; {reached}"
    return AssemblyError(what, where=mechanism.source, limit=limit)


def _by_newton(task: Task, place: Array, near: Array) -> Array:
    """Return q (k, n) found by Newton's method from `near` (n,) and from poses around it."""
    guided, n = task.guided, task.mechanism.n
    begins = np.tile(np.append(near, np.zeros(task.coordinates)), (1 + BEGUN, 1))
    far = np.pi * np.arange(1 + BEGUN)[:, None] / BEGUN
    random = np.random.default_rng(0).uniform(-1.0, 1.0, (1 + BEGUN, n))
    begins[:, :n] += far * random * guided.arrays.units[:n]
    begins[:, list(guided.actuated)] = place
    with np.errstate(all="ignore"):
        found = close_positions(guided, begins, guided.actuated, t=0.0)
    found = found[_closes(guided, found)]
    if not len(found):
        start = close_positions(task.mechanism, near, t=0.0)
        reached = "no pose was found that closes there"
        closed = task.mechanism.rows == () or _closes(task.mechanism, start)
        if closed:
            whole = task.with_guide(start, task.place(start))
            missed = out_of_reach(task, whole, place[None])
            if missed > CLOSES * loop_size(guided):
                reached = f"it comes as near as {missed:.6g} m"
        raise _beyond(task, place, near, reached)
    return _least_change(task, found, near) if task.redundant else found[:, :n]


def _closes(mechanism: Mechanism, q: Array) -> Array:
    gap = np.abs(closure_gap(mechanism, q, 0.0)).max(axis=-1)
    closed: Array = np.isfinite(q).all(axis=-1) & (gap <= CLOSES * loop_size(mechanism))
    return closed


def _least_change(task: Task, whole: Array, near: Array) -> Array:
    """Move closed states (k, n + guide) along their free directions towards `near`.

    Returns q (k, n).
    """
    guided, n = task.guided, task.mechanism.n
    units = guided.arrays.units[:n]
    turning = [k for k in range(n) if k not in task.mechanism.slides]
    if not task.mechanism.description.couplings:
        away = (whole[:, :n] - near)[:, turning]
        whole[:, turning] -= 2 * np.pi * np.round(away / (2 * np.pi))
    part = np.ones(len(whole))
    for _ in range(NEARER):
        way = (near - whole[:, :n]) / units
        Psi = scaled_jacobian(guided, whole, 0.0)[..., :n]
        across = np.einsum("kij,kj->ki", np.linalg.pinv(Psi) @ Psi, way)
        trial = whole.copy()
        trial[:, :n] += part[:, None] * (way - across) * units
        trial = close_positions(guided, trial, guided.actuated, t=0.0)
        nearer = np.linalg.norm((near - trial[:, :n]) / units, axis=1) < np.linalg.norm(way, axis=1)
        nearer &= _closes(guided, trial)
        whole = np.where(nearer[:, None], trial, whole)
        part = np.where(nearer, np.minimum(1.0, 2.0 * part), 0.5 * part)
    q: Array = whole[:, :n]
    return q
