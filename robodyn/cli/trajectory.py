"""`robodyn trajectory`: reference motions as CSV."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np

from robodyn.cli.files import input_file
from robodyn.cli.motion_files import unwrapped, without_jumps
from robodyn.cli.options import EACH, Model, Number, Read, Text, Unwrap, option, refuse
from robodyn.cli.output import RowOptions, note
from robodyn.cli.progress import progress
from robodyn.cli.row_files import read_columns
from robodyn.cli.states import (
    Quantity,
    chosen_columns,
    option_source,
    remarks,
    table_source,
)
from robodyn.cli.times import Points, output_times
from robodyn.dynamics.columns import column_names, of_joints, scene_units
from robodyn.dynamics.joint_vectors import driver_of, joint_values
from robodyn.dynamics.named_points import named_point, named_points
from robodyn.dynamics.state import State, find
from robodyn.dynamics.sticking import AT_REST_REMARK
from robodyn.errors import InputError, RobodynError, at_place, named_options, overflow
from robodyn.mechanics.actuation import for_each_actuated
from robodyn.mechanics.driven import check_torques, refuse_driven
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.settings import EvenTimes
from robodyn.scene.quantities import parse_vector, value_from
from robodyn.tables.csv_fields import shown
from robodyn.tables.output_file import on_terminal
from robodyn.trajectories.joint_paths import (
    ACCELERATION,
    ConstantSpeed,
    JointPath,
    Legs,
    Sweep,
    path_through,
    profile,
)
from robodyn.trajectories.loop_path import FURTHEST, TravelError, Watch
from robodyn.trajectories.reference import ReferenceMotion, check_duration, motion_along
from robodyn.trajectories.task_space import (
    AlongCurve,
    Task,
    TaskPath,
    along_branch,
    arc,
    pose_of,
    spline_curve,
    task_of,
)
from robodyn.trajectories.time_scaling import (
    LimitError,
    Limits,
    Shortest,
    check_ends,
    check_limits,
    limits_of,
    shortest_along,
    shortest_of,
    shortest_through,
    with_motors,
)

MOST_CYCLES = 100_000  # of a sweep
ProfileName = Literal["cubic", "quintic", "trapezoidal", "cycloidal", "sweep"]
Ends = Literal["rest", "natural"]  # what a cubic spline does at its ends

_WHICH = "all joints, or the actuated ones"
_VIA = (
    "CSV of points q1.. (rad) to go through, - for stdin; with a column t (s) at these times. "
    "Without t, --from and --to may add the ends."
)
_TURNS = "Turns of the fastest joint at --speed; without it, of each actuated joint in --time."
_OF = "The point that is led in the plane: a link (its tip), tip2, LINK@x,y, a scene's point."
_ARC = "On a circle about CENTRE (x,y, m) from where the point is at --from."
_PATH = (
    "CSV of points x,y (m) to lead it through, perhaps with t (s), angle (rad) of its link; "
    "- for stdin. It begins at the first, on the branch of --from."
)
_POSTURE = "Of a redundant arm: stay as near to it as the point lets. Default: least motion."


@dataclass(frozen=True)
class TrajectoryOptions:
    """The way, the time that it takes, and what must not be exceeded on it."""

    from_: Text = option(f"Angles at the start, rad, or 30deg, pi/2: {_WHICH}.", "VECTOR")
    to: Text = option(f"Angles at the end: {_WHICH}.", "VECTOR")
    via: Annotated[Text, input_file("--via", _VIA)] = None
    unwrap: Unwrap = False
    read: Read = None
    time: Text = option("Duration, s, 2s or 500ms; min: the shortest within the limits.", "S|min")
    profile: ProfileName | None = option("Default: quintic.")
    acceleration: Number = option(
        "Part of the time in which a trapezoidal profile speeds up, and in which it slows down, "
        "> 0, <= 0.5. Default: 1/3.",
        "PART",
    )
    ends: Ends | None = option("Of a cubic spline: at rest, or qdd = 0. Default: rest.")
    speed: Text = option(
        "Constant speed of the actuated joints, rad/s, or 60rpm, 360deg/s; begins at --from "
        "(default: 0), ends after --turns or --time.",
        "VECTOR",
    )
    turns: Text = option(_TURNS, "VECTOR")
    amplitude: Text = option(f"Of a sweep about --from, rad or 10deg: {EACH}.", "VECTOR")
    frequencies: Text = option("Of a sweep: at its start and at its end, Hz.", "F0,F1")
    max_qd: Text = option(f"Largest speed, rad/s, or 60rpm, 90deg/s: {EACH}.", "VECTOR")
    max_qdd: Text = option(f"Largest acceleration, rad/s^2, or 90deg/s^2: {EACH}.", "VECTOR")
    max_tau: Text = option(f"Largest torque, N m: {EACH}.", "VECTOR")
    of: Text = option(_OF, "POINT")
    to_xy: Text = option("Straight from where the point is at --from to here, m.", "X,Y")
    arc: Text = option(_ARC, "CENTRE:ANGLE")
    path: Annotated[Text, input_file("--path", _PATH)] = None
    posture: Text = option(_POSTURE, "VECTOR")
    max_speed: Text = option("Largest speed of the point, m/s.", "V")

    @property
    def task(self) -> dict[str, str]:
        """The options of task space that are given."""
        names = ("of", "to_xy", "arc", "path", "posture", "max_speed")
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    def duration(self) -> float | None:
        """Seconds; NaN for the shortest."""
        if self.time in (None, "min"):
            return None if self.time is None else math.nan
        return value_from(self.time, "s", "--time", "2, 0.5s, 20ms or min")

    def limits(self, mechanism: Mechanism) -> Limits:
        given = {"qd": self.max_qd, "qdd": self.max_qdd, "tau": self.max_tau}
        most = (
            None if text is None else joint_values(mechanism, text, kind, f"--max-{kind}")
            for kind, text in given.items()
        )
        return limits_of(mechanism, *most)


class _Through(NamedTuple):
    """Points (K, n), angles or coordinates, to go through, and their times, of a CSV file.

    NaN stands where a passive joint is not given.
    """

    points: Array
    times: Array | None
    source: str


def _points_from(mechanism: Mechanism, given: TrajectoryOptions) -> _Through:
    def columns(header: Sequence[str], name: str) -> list[str]:
        source = table_source(mechanism, Quantity("q", None, True), header, name)
        return [*source.columns, *(["t"] if "t" in header else [])]

    rows, times, source = np.zeros((0, mechanism.n)), None, ""
    ends = {"from": given.from_, "to": given.to}
    if given.via is None:
        for name, text in ends.items():
            if text is None:
                limit = "missing: give --from and --to, or --via, --speed, --of, --profile sweep"
                raise InputError(f"--{name}", limit=limit)
    else:
        values, names, source, lines = read_columns(
            given.via, columns, scene_units(mechanism), given.read
        )
        timed = names[-1] == "t"
        column = dict(zip(names, values.T, strict=True))
        driven = of_joints("q", mechanism.actuated)
        known = mechanism, column, lines, source, given.unwrap, driven
        column = without_jumps(*known, refuse=False)
        rows = np.full((len(values), mechanism.n), np.nan)
        whole = len(names) - timed == mechanism.n
        for joint in range(mechanism.n) if whole else mechanism.actuated:
            rows[:, joint] = column[of_joints("q", [joint])[0]]
        if timed:
            refuse(f"does not go with the times (t) in {source}", **ends)
            times = values[:, -1]
    first, last = (
        np.zeros((0, mechanism.n)) if text is None else given_angles(mechanism, text, name)[None]
        for name, text in ends.items()
    )
    return _Through(np.concatenate([first, rows, last]), times, source)


def when(times: Array | None, source: str, duration: float | None) -> tuple[float, float]:
    """Return begin and duration of a motion, s (NaN: the shortest), from --time or its points."""
    if times is None:
        if duration is None:
            raise InputError("--time", limit="missing: give seconds, or min and a limit")
        return 0.0, duration
    if duration is not None and not math.isnan(duration):
        limit = f"{source} has the times (t): leave one of them out, or take min"
        raise InputError("--time", value=f"{duration:g}", limit=limit)
    return float(times[0]), float(np.ptp(times)) if duration is None else duration


def given_angles(mechanism: Mechanism, text: str | None, name: str, default: bool = False) -> Array:
    """The angles (n,) of an option, NaN where it holds the actuated joints only."""
    if text is None and not default:
        raise InputError(f"--{name}", limit="missing: give the pose that the sweep is about")
    q = np.full(mechanism.n, np.nan)
    source = option_source(mechanism, Quantity(name, text))
    driven = list(driver_of(mechanism, name).actuated)
    q[slice(None) if source.whole else driven] = source.values
    return q


def sweep_from(
    mechanism: Mechanism, pose: Array, given: TrajectoryOptions, duration: float | None
) -> tuple[JointPath, float]:
    """The sine sweep about a pose (n,), and its duration."""
    if given.amplitude is None or given.frequencies is None:
        raise InputError("--profile sweep", limit="needs --amplitude and --frequencies F0,F1")
    sizes = joint_values(mechanism, given.amplitude, "q", "--amplitude")
    band = parse_vector(given.frequencies, where="--frequencies", unit="Hz", example="0.2,5 (Hz)")
    if duration is None or not (math.isfinite(duration) and duration > 0.0):
        raise InputError("--time", limit="of a sweep must be seconds, > 0 and finite")
    sizes = for_each_actuated(mechanism, sizes, "--amplitude")
    if len(band) != 2 or min(band) < 0.0 or max(band) == 0.0:
        limit = "must be two frequencies, at the start and at the end, Hz, >= 0 and not both 0"
        raise InputError("--frequencies", value=given.frequencies, limit=limit)
    cycles = 0.5 * (band[0] + band[1]) * duration
    if cycles > MOST_CYCLES:
        limit = f"makes {cycles:.6g} cycles, too many: at most {MOST_CYCLES}"
        raise InputError("--frequencies", value=given.frequencies, limit=limit)
    start = pose[list(mechanism.actuated)]
    return Sweep(start, np.array(sizes), band[0], band[1], duration), duration


def turning_from(
    mechanism: Mechanism, begin: Array, given: TrajectoryOptions, duration: float | None
) -> tuple[JointPath, float]:
    """The path at constant speed, and its duration (NaN: the shortest)."""
    start = begin[list(mechanism.actuated)]
    counts = None
    if given.turns is not None:
        counts = parse_vector(given.turns, where="--turns", example="1 or 0.5")
    if given.speed is None:
        assert counts is not None
        if duration is None:
            raise InputError("--turns", limit="needs --speed or --time")
        if slides := [k for k in mechanism.actuated if k in mechanism.slides]:
            limit = f"counts turns, and q{slides[0] + 1} slides: give --from and --to"
            raise InputError("--turns", value=given.turns, limit=limit)
        way = 2 * np.pi * np.array(for_each_actuated(mechanism, counts, "--turns"))
        return ConstantSpeed(start, way), duration
    rates = joint_values(mechanism, given.speed, "qd", "--speed")
    rate = np.array(for_each_actuated(mechanism, rates, "--speed"))
    fastest = float(np.abs(rate).max())
    if counts is not None:
        if duration is not None:
            raise InputError("--speed, --turns and --time", limit="exclude one another: give two")
        if len(counts) != 1 or counts[0] <= 0.0:
            limit = "with --speed it must be one number > 0, of the fastest joint"
            raise InputError("--turns", value=given.turns, limit=limit)
        if fastest == 0.0:
            limit = "must not be 0 where --turns are given"
            raise InputError("--speed", value=given.speed, limit=limit)
        duration = 2 * math.pi * counts[0] / fastest
    if duration is None or math.isnan(duration):
        raise InputError("--speed", limit="needs --turns, or --time in seconds")
    return ConstantSpeed(start, rate * duration), duration


@contextmanager
def named(given: TrajectoryOptions) -> Iterator[None]:
    """An argument that is refused, or a limit that is exceeded, is named as its option.

    A path that is too long is named as the option that makes it so.
    """
    names = ("profile", "acceleration", "ends", "max_qd", "max_qdd", "max_tau", "of", "posture")
    with named_options(names, duration="time"):
        try:
            yield
        except TravelError as error:
            long = ("turns", "via", "to", "amplitude", "to_xy", "arc", "path", "time")
            name = next(name for name in long if getattr(given, name) is not None)
            limit = f"makes a path of {error.value}: {error.limit}"
            value = shown(getattr(given, name))
            flag = "--" + name.replace("_", "-")
            raise InputError(flag, value=value, limit=limit) from None
        except LimitError as error:
            if not error.of_motor:
                error.add_place(f"--max-{error.quantity}")
            raise


Array = np.ndarray
ALIKE = 1e-12  # part of coordinates by which two points must differ
WAYS = ("to_xy", "arc", "path")


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
    refuse_driven(mechanism, flag)
    for name in ("of", "from_"):
        if getattr(given, name) is None:
            which = "the point that is led" if name == "of" else "the pose that it begins from"
            raise InputError(f"--{name.strip('_')}", limit=f"missing: give {which}")
    point = named_point(mechanism, given.of or "", "--of")
    file = None if given.path is None else _read(given.path, given.read, given.unwrap)
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
    most = None
    if given.max_speed is not None:
        most = value_from(given.max_speed, "m/s", "--max-speed", "0.5 (m/s)")
        if not (math.isfinite(most) and most > 0.0):
            value = shown(given.max_speed)
            raise InputError("--max-speed", value=value, limit="must be > 0 and finite")
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


def _path(task: Task, given: TrajectoryOptions, file: _Through | None, pose: Array) -> JointPath:
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
    values = parse_vector(text, where=flag, unit="m") if text else []
    if len(values) != 2 or not np.isfinite(values).all():
        raise InputError(flag, value=shown(whole), limit=f"must be {form}")
    return np.array(values)


def _read(file: str, read: str | None, unwrap: bool) -> _Through:
    def columns(header: Sequence[str], _: str) -> list[str]:
        return ["x", "y", *(x for x in ("angle", "t") if x in header)]

    values, names, source, lines = read_columns(file, columns, read=read)
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
    return _Through(points, values[:, -1] if timed else None, source)


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
      robodyn trajectory four-bar --speed 60rpm --turns 1 --columns t,q1,tau1
      robodyn trajectory 2r --from 0,90deg --of tip2 --to-xy 0.4,0.9 --time 2
      robodyn trajectory 2r --profile sweep --from 30deg,45deg --amplitude 5deg \\
        --frequencies 0.2,5 --time 20 | robodyn torque 2r -
    """
    mechanism = model.load()
    check_torques(mechanism)
    duration = given.duration()
    with named(given):
        limits = given.limits(mechanism)
    if given.profile != "trapezoidal":
        refuse("is for --profile trapezoidal", acceleration=given.acceleration)
    if given.unwrap and given.via is None and given.path is None:
        raise InputError("--unwrap", limit="goes with --via or --path")
    if given.via is None and given.path is None:
        refuse("goes with --via or --path", read=given.read)
    if given.profile == "sweep":
        others = {"to": given.to, "via": given.via, "speed": given.speed, "turns": given.turns}
        refuse("does not go with a sweep", **others, ends=given.ends, **given.task)
    elif given.amplitude is not None or given.frequencies is not None:
        raise InputError("--amplitude and --frequencies", limit="are for --profile sweep")
    step = None if every is None else value_from(every, "s", "--every")
    with remarks(), named(given), warnings.catch_warnings():
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
    if minimal and not given.task:
        refuse_driven(mechanism, "--time min")

    def along(path: JointPath, q: Array, duration: float, begin: float = 0.0) -> ReferenceMotion:
        if minimal:
            return _told(shortest_along(mechanism, path, q, limits, watch=watch))
        return _checked(motion_along(mechanism, path, q, duration, begin, watch), limits)

    if given.task:
        found = task_motion(mechanism, given, duration, limits, watch)
        return _told(found) if isinstance(found, Shortest) else _checked(found, limits)
    if given.profile == "sweep":
        pose = given_angles(mechanism, given.from_, "from")
        path, seconds = sweep_from(mechanism, pose, given, duration)
        return along(path, pose[None], seconds)
    if given.speed is not None or given.turns is not None:
        others = {"to": given.to, "via": given.via, "profile": given.profile, "ends": given.ends}
        refuse("does not go with --speed and --turns", **others)
        pose = given_angles(mechanism, given.from_, "from", default=True)
        path, seconds = turning_from(mechanism, pose, given, duration)
        return along(path, pose[None], seconds)

    q, times, source = _points_from(mechanism, given)
    begin, seconds = when(times, source, duration)
    alpha = ACCELERATION if given.acceleration is None else given.acceleration
    how = given.profile or "quintic", alpha, given.ends == "natural"
    with at_place(source, "times", "point") if source else nullcontext():
        if minimal:
            return _told(shortest_through(mechanism, q, limits, times, *how, watch))
        path = path_through(q[:, list(mechanism.actuated)], times, *how)
    return along(path, q, seconds, begin)


def _checked(motion: ReferenceMotion, limits: Limits) -> ReferenceMotion:
    """The motion, within its limits; a note where it asks too much of a motor."""
    check_limits(motion, limits)
    try:
        check_limits(motion, with_motors(motion.mechanism))
    except LimitError as error:
        note(f"Note: {error}")
    except RobodynError:  # no torque is told
        pass
    return motion


def _told(found: Shortest) -> ReferenceMotion:
    note(f"shortest duration: {found.motion.duration!r} s, bounded by {found.bound}")
    return found.motion


def _write(motion: ReferenceMotion, times: EvenTimes, rows: RowOptions) -> None:
    mechanism, points = motion.mechanism, named_points(motion.mechanism)
    columns = column_names(mechanism, ["t", "q", "qd", "qdd"])
    own = columns
    if rows.columns is not None:
        own, _ = chosen_columns(mechanism, rows.columns, columns, [], points)
    block = max(1, min(BLOCK, WORK // mechanism.n**3))
    told = rows.writer(own, units=scene_units(mechanism), only=own)
    gaps = [family.gaps for name in own if (family := find(mechanism, name, points))]
    with told as writer, progress("writing", on_terminal(rows.out)) as show:
        for k in range(0, len(times), block):
            show(k / len(times))
            t = motion.begin + times[k : k + block]
            if k + block >= len(times):
                t[-1] = motion.end
            with np.errstate(all="ignore"):
                states = motion.states(t)
                if own == columns:
                    values = np.concatenate([t[:, None], *states], axis=1)
                else:
                    values = State(mechanism, *states, t=t, of=points).columns(own)
            if not np.isfinite(values[:, np.logical_not(gaps)]).all() or np.isinf(values).any():
                raise overflow()
            writer.write_columns(values)
