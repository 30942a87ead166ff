"""`robodyn trajectory`: reference motions as CSV."""

from __future__ import annotations

import math
import warnings
from contextlib import nullcontext

import numpy as np

from robodyn.cli import trajectory_options as ways
from robodyn.cli.options import Model, Text, option, refuse
from robodyn.cli.output import RowOptions, note
from robodyn.cli.progress import progress
from robodyn.cli.states import overflow, remarks
from robodyn.cli.times import Points, output_times
from robodyn.cli.trajectory_options import TrajectoryOptions
from robodyn.dynamics.switching import AT_REST_REMARK
from robodyn.errors import InputError, RobodynError, at_place
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.column_units import scene_units
from robodyn.scene.quantities import value_from
from robodyn.simulation.even_times import EvenTimes
from robodyn.tables.output_file import on_terminal
from robodyn.trajectories import time_scaling
from robodyn.trajectories.continuation import Watch
from robodyn.trajectories.joint_paths import JointPath, path_through
from robodyn.trajectories.motion_limits import LimitError, Limits, check_ends, with_motors
from robodyn.trajectories.profiles import ACCELERATION
from robodyn.trajectories.reference import ReferenceMotion, motion_along

BLOCK = 5000  # rows computed at once
WORK = 1 << 24  # of n^3 a row: of large mechanisms fewer rows


def trajectory(
    model: Model,
    given: TrajectoryOptions = TrajectoryOptions(),
    every: Text = option("Time between rows, s, or 10ms.", "S"),
    points: Points = None,
    rows: RowOptions = RowOptions(),
) -> None:
    """A reference motion of the joints, as CSV for `torque`.

    Columns: t, q1.., qd1.., qdd1.. of all joints, at the start, every so often, and always at the
    end.  The motion is that of the actuated joints; in a closed mechanism the others follow along
    one branch: that of --from if it holds all joints, else the scene's `assembly`.

    From rest to rest (--from, --to), through points (--via), at constant speed (--speed), or a
    sine sweep about a pose (--profile sweep).  Through points cubic and quintic profiles are
    splines (of continuity C2 and C4) at rest at their ends; trapezoidal and cycloidal ones stop
    at each point.  Points without times get them in proportion to the distances in joint space.

    A point (--of) goes along a line (--to-xy), an arc (--arc) or through points of the plane
    (--path): the profile is that of the length behind it, and the joints follow on one branch.

    A limit (--max-qd, --max-qdd, --max-tau) that is exceeded anywhere, between the rows too, is an
    error; --time min takes the shortest duration that keeps the limits, and tells it on stderr.
    It keeps those of the scene's motors too; in a given time a note says where they are exceeded.
    Limits of joints that the scene has, and hard stops, are ends that no motion passes.

    \b
    Examples:
      robodyn trajectory 2r --from 0,0 --to 90deg,45deg --time 2 --every 0.01
      robodyn trajectory 2r --from 0,0 --to 90deg,45deg --time min --max-tau 25,8
      robodyn trajectory 2r --via motion.csv --profile cubic --max-qd 90deg/s
      robodyn trajectory four-bar --speed 60rpm --turns 1 --points 361
      robodyn trajectory four-bar --speed 60rpm --turns 1 --extremes
      robodyn trajectory 2r --from 0,90deg --of tip2 --to-xy 0.4,0.9 --time 2
      robodyn trajectory 2r --profile sweep --from 30deg,45deg --amplitude 5deg \\
        --frequencies 0.2,5 --time 20 | robodyn torque 2r -
    """
    mechanism = model.load()
    duration = given.duration()
    with ways.named(given):
        limits = given.limits(mechanism)
    if given.profile != "trapezoidal":
        refuse("is for --profile trapezoidal", acceleration=given.acceleration)
    if given.unwrap and given.via is None and given.path is None:
        raise InputError("--unwrap", limit="goes with --via or --path")
    if given.profile == "sweep":
        others = {"to": given.to, "via": given.via, "speed": given.speed, "turns": given.turns}
        refuse("does not go with a sweep", **others, ends=given.ends, **given.task)
    elif given.amplitude is not None or given.frequencies is not None:
        raise InputError("--amplitude and --frequencies", limit="are for --profile sweep")
    step = None if every is None else value_from(every, "s", "--every")
    with remarks(), ways.named(given), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=AT_REST_REMARK)  # it starts and ends so
        with progress("following the loops") as watch:
            motion = _motion(mechanism, given, duration, limits, watch)
        check_ends(motion)
        _write(motion, output_times(motion.duration, step, points), rows)


def _motion(
    mechanism: Mechanism,
    given: TrajectoryOptions,
    duration: float | None,
    limits: Limits,
    watch: Watch,
) -> ReferenceMotion:
    """The motion that the options describe, in `duration` (s; NaN: in the shortest)."""
    minimal = duration is not None and math.isnan(duration)

    def along(
        path: JointPath, q: np.ndarray, duration: float, begin: float = 0.0
    ) -> ReferenceMotion:
        if minimal:
            return _told(time_scaling.shortest_along(mechanism, path, q, limits, watch=watch))
        return _checked(motion_along(mechanism, path, q, duration, begin, watch), limits)

    if given.task:
        from robodyn.cli.trajectory_tasks import task_motion  # no other motion needs its rooms

        found = task_motion(mechanism, given, duration, limits, watch)
        return _told(found) if isinstance(found, time_scaling.Shortest) else _checked(found, limits)
    if given.profile == "sweep":
        pose = ways.given_angles(mechanism, given.from_, "from")
        path, seconds = ways.sweep_from(mechanism, pose, given, duration)
        return along(path, pose[None], seconds)
    if given.speed is not None or given.turns is not None:
        others = {"to": given.to, "via": given.via, "profile": given.profile, "ends": given.ends}
        refuse("does not go with --speed and --turns", **others)
        pose = ways.given_angles(mechanism, given.from_, "from", default=True)
        path, seconds = ways.turning_from(mechanism, pose, given, duration)
        return along(path, pose[None], seconds)

    points = ways.points_from(mechanism, given)
    begin, seconds = ways.when(points.times, points.source, duration)
    alpha = ACCELERATION if given.acceleration is None else given.acceleration
    how = given.profile or "quintic", alpha, given.ends == "natural"
    with at_place(points.source, "times", "point") if points.source else nullcontext():
        if minimal:
            q, times = points.q, points.times
            return _told(time_scaling.shortest_through(mechanism, q, limits, times, *how, watch))
        path = path_through(points.q[:, list(mechanism.actuated)], points.times, *how)
    return along(path, points.q, seconds, begin)


def _checked(motion: ReferenceMotion, limits: Limits) -> ReferenceMotion:
    """The motion, within its limits; a note where it asks too much of a motor."""
    time_scaling.check_limits(motion, limits)
    try:
        time_scaling.check_limits(motion, with_motors(motion.mechanism))
    except LimitError as error:
        note(f"Note: {error}")
    except RobodynError:  # no torque is told
        pass
    return motion


def _told(found: time_scaling.Shortest) -> ReferenceMotion:
    note(f"shortest duration: {found.motion.duration!r} s, bounded by {found.bound}")
    return found.motion


def _write(motion: ReferenceMotion, times: EvenTimes, rows: RowOptions) -> None:
    n = motion.mechanism.n
    columns = ["t", *(f"{name}{k + 1}" for name in ("q", "qd", "qdd") for k in range(n))]
    block = max(1, min(BLOCK, WORK // n**3))
    hidden = on_terminal(rows.out) and not rows.extremes  # the rows show how far they are
    told = rows.writer(columns, units=scene_units(motion.mechanism))
    with told as writer, progress("writing", hidden) as show:
        for k in range(0, len(times), block):
            show(k / len(times))
            t = motion.begin + times[k : k + block]
            if k + block >= len(times):
                t[-1] = motion.end
            with np.errstate(all="ignore"):
                values = np.concatenate([t[:, None], *motion.states(t)], axis=1)
            if not np.isfinite(values).all():
                raise overflow()
            writer.write_columns(values)
