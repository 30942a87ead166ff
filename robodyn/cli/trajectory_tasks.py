"""`robodyn trajectory` in task space: where the options lead a point to, and the joints' motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from robodyn.cli.motion_files import unwrapped
from robodyn.cli.options import refuse
from robodyn.cli.output import note
from robodyn.cli.row_files import read_columns
from robodyn.cli.trajectory_options import TrajectoryOptions, given_angles, when
from robodyn.errors import InputError, RobodynError, at_place
from robodyn.kinematics.named_points import named_point
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene import quantities
from robodyn.scene.quantities import value_from
from robodyn.tables.csv_fields import shown
from robodyn.trajectories.continuation import FURTHEST, Watch
from robodyn.trajectories.inverse_kinematics import along_branch
from robodyn.trajectories.joint_paths import JointPath, Legs, path_through
from robodyn.trajectories.motion_limits import Limits, with_motors
from robodyn.trajectories.plane_paths import AlongCurve, arc, spline_curve
from robodyn.trajectories.profiles import ACCELERATION, profile
from robodyn.trajectories.reference import ReferenceMotion, check_duration
from robodyn.trajectories.task_space import Task, TaskPath, pose_of, task_of
from robodyn.trajectories.time_scaling import Shortest, shortest_of

Array = np.ndarray
ALIKE = 1e-12  # part of coordinates by which two points must differ
WAYS = ("to_xy", "arc", "path")


class _File(NamedTuple):
    """Points (K, 2, or 3 with the angle), and their times, of a CSV file."""

    points: Array
    times: Array | None
    source: str


def task_motion(
    mechanism: Mechanism,
    given: TrajectoryOptions,
    duration: float | None,
    limits: Limits,
    watch: Watch,
) -> ReferenceMotion | Shortest:
    """The motion whose point goes where the options say; of --time min the shortest."""
    named = [name for name in WAYS if name in given.task]
    if not named:
        flag = "--" + next(iter(given.task)).replace("_", "-")
        raise InputError(flag, limit="goes with --to-xy, --arc or --path")
    others = (*named[1:], "to", "via", "speed", "turns")
    flag = "--" + named[0].replace("_", "-")
    refuse(f"does not go with {flag}", **{x: getattr(given, x) for x in others})
    for name in ("of", "from_"):
        if getattr(given, name) is None:
            which = "the point that is led" if name == "of" else "the pose that it begins from"
            raise InputError(f"--{name.strip('_')}", limit=f"missing: give {which}")
    point = named_point(mechanism, given.of or "", "--of")
    file = None if given.path is None else _read(given.path, given.unwrap)
    if file is None or file.times is None:
        refuse("does not go with paths without times", ends=given.ends)
    task = task_of(mechanism, point, file is not None and file.points.shape[1] == 3)
    if given.posture is not None and not task.redundant:
        limit = f"is for redundant arms: all freedoms are taken to lead {point.name}"
        raise InputError("--posture", where=mechanism.source, limit=limit)
    pose = pose_of(task, given_angles(mechanism, given.from_, "from"))
    path = _path(task, given, file, pose)

    times, source = (None, "") if file is None else (file.times, file.source)
    begin, seconds = when(times, source, duration)
    shortest = math.isnan(seconds)
    if not shortest:
        check_duration(seconds)
    most = _speed(given.max_speed)
    limits = with_motors(mechanism, limits) if shortest else limits
    if shortest and most is None and not limits.given:
        limit = "needs a limit: --max-speed, --max-qd, --max-qdd or --max-tau"
        raise InputError("--time", value="min", limit=limit)
    posture = None
    if given.posture is not None:
        posture = pose_of(task, given_angles(mechanism, given.posture, "posture"))
    if file is not None:
        with at_place("--path, from --from to its first point"):
            pose = along_branch(task, file.points[:1], pose)[0]
    whole = TaskPath(task, path, pose, posture, watch)
    least = 0.0 if most is None else whole.fastest() / most
    if shortest:
        return shortest_of(whole, limits, begin, (least, f"the speed of {point.name}"))
    if seconds < least * (1.0 - ALIKE):
        raise RobodynError(
            f"--max-speed: {point.name}",
            value=f"{whole.fastest() / seconds:.9g} m/s",
            limit=f"exceeds the limit of {most:.9g} m/s: it takes {least:.9g} s or more",
        )
    return ReferenceMotion(mechanism, whole, seconds, begin)


def _path(task: Task, given: TrajectoryOptions, file: _File | None, pose: Array) -> JointPath:
    """The path of the point's coordinates."""
    alpha = ACCELERATION if given.acceleration is None else given.acceleration
    how = profile(given.profile or "quintic", alpha)
    ends = np.array([0.0, 1.0])
    begin = task.place(pose)[:2]
    if file is not None and file.times is not None:
        options = file.times, how.name, alpha, given.ends == "natural"
        with at_place(file.source, "times"):
            return path_through(file.points, *options)
    if file is not None:
        with at_place(file.source):
            return AlongCurve(*spline_curve(file.points), how)
    if given.arc is not None:
        text, colon, turn = given.arc.partition(":")
        centre = _vector(text if colon else "", "--arc", given.arc, "CENTRE:ANGLE, 0.3,0.2:90deg")
        angle = value_from(turn, "rad", "--arc", "0.3,0.2:90deg")
        if not (math.isfinite(angle) and angle != 0.0):
            raise InputError("--arc", value=shown(given.arc), limit="the angle must not be 0")
        if abs(angle) > FURTHEST:
            limit = f"the angle must be at most {FURTHEST:g} rad"
            raise InputError("--arc", value=shown(given.arc), limit=limit)
        if np.linalg.norm(begin - centre) <= ALIKE * (1.0 + np.linalg.norm(begin)):
            limit = f"the centre is where {task.of.name} begins"
            raise InputError("--arc", value=shown(given.arc), limit=limit)
        return AlongCurve(*arc(begin, centre, angle), how)
    assert given.to_xy is not None
    end = _vector(given.to_xy, "--to-xy", given.to_xy, "x,y (m), 0.4,0.6")
    if np.linalg.norm(end - begin) <= ALIKE * (1.0 + np.linalg.norm(begin)):
        limit = f"is where {task.of.name} begins"
        raise InputError("--to-xy", value=shown(given.to_xy), limit=limit)
    return Legs(np.stack([begin, end]), ends, how)


def _vector(text: str, flag: str, whole: str, form: str) -> Array:
    values = quantities.parse_vector(text, where=flag, unit="m") if text else []
    if len(values) != 2 or not np.isfinite(values).all():
        raise InputError(flag, value=shown(whole), limit=f"must be {form}")
    return np.array(values)


def _speed(text: str | None) -> float | None:
    if text is None:
        return None
    most = value_from(text, "m/s", "--max-speed", "0.5 (m/s)")
    if not (math.isfinite(most) and most > 0.0):
        raise InputError("--max-speed", value=shown(text), limit="must be > 0 and finite")
    return most


def _read(file: str, unwrap: bool) -> _File:
    def columns(header: Sequence[str], _: str) -> list[str]:
        return ["x", "y", *(x for x in ("angle", "t") if x in header)]

    values, names, source, lines = read_columns(file, columns)
    if "angle" in names:
        smooth, fault = unwrapped("angle", values[:, 2], lines, source)
        if fault and not unwrap:
            note(f"Note: {fault}")
        values[:, 2] = smooth if unwrap else values[:, 2]
    if len(values) < 2:
        limit = "a path needs two points or more"
        raise InputError("points", where=source, value=len(values), limit=limit)
    timed = names[-1] == "t"
    points = values[:, :-1] if timed else values
    same = np.flatnonzero(~np.diff(points[:, :2], axis=0).any(axis=1))
    if len(same) and not timed:
        limit = "are the same: leave one out, or give times (t)"
        if np.diff(points, axis=0)[same[0]].any():
            limit = "are at one place, with other angles: such a turn needs times (t)"
        raise InputError(f"points {same[0] + 1} and {same[0] + 2}", where=source, limit=limit)
    return _File(points, values[:, -1] if timed else None, source)
