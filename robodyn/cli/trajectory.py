"""`robodyn trajectory`: reference motions as CSV."""

from __future__ import annotations

import math
import sys
from typing import Annotated, Literal, Optional

import numpy as np
import typer

from robodyn.cli.files import input_file
from robodyn.cli.options import Format, Model, Out, OutputFormat
from robodyn.cli.output import note, row_writer
from robodyn.cli.progress import progress
from robodyn.cli.states import overflow, remarks
from robodyn.cli.times import output_times
from robodyn.cli.trajectory_options import (
    Points,
    angular_acceleration_from,
    duration_from,
    given_angles,
    named_options,
    points_from,
    rates_from,
    refuse,
    seconds_from,
    sweep_from,
    turning_from,
)
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.scene.quantities import parse_number, parse_rate
from robodyn.simulation.even_times import EvenTimes
from robodyn.trajectories.continuation import Watch
from robodyn.trajectories.joint_paths import JointPath, path_through
from robodyn.trajectories.profiles import ACCELERATION
from robodyn.trajectories.reference import ReferenceMotion, motion_along
from robodyn.trajectories.time_scaling import (
    Limits,
    check_limits,
    limits_of,
    shortest_along,
    shortest_through,
)

BLOCK = 5000  # rows computed at once
WORK = 1 << 24  # of n^3 a row: of large mechanisms fewer rows
ProfileName = Literal["cubic", "quintic", "trapezoidal", "cycloidal", "sweep"]
Ends = Literal["rest", "natural"]  # what a cubic spline does at its ends


def _text(flag: str, metavar: str, text: str) -> object:
    return typer.Option(flag, metavar=metavar, help=text, show_default=False)


_WHICH = "all joints, or the actuated ones"
_EACH = "one value, or one an actuated joint"


def trajectory(
    model: Model,
    from_: Annotated[
        Optional[str],  # noqa: UP045 (typer reads the annotation at run time)
        _text("--from", "VECTOR", f"Angles at the start, rad, or 30deg, pi/2: {_WHICH}."),
    ] = None,
    to: Annotated[
        Optional[str],  # noqa: UP045
        _text("--to", "VECTOR", f"Angles at the end: {_WHICH}."),
    ] = None,
    via: Annotated[
        Optional[str],  # noqa: UP045
        input_file(
            "--via",
            "CSV of points q1.. (rad) to go through, - for stdin; with a column t (s) at "
            "these times. Without t, --from and --to may add the ends.",
        ),
    ] = None,
    time: Annotated[
        Optional[str],  # noqa: UP045
        _text("--time", "S|min", "Duration, s, 2s or 500ms; min: the shortest within the limits."),
    ] = None,
    profile: Annotated[
        Optional[ProfileName],  # noqa: UP045
        typer.Option("--profile", help="Default: quintic.", show_default=False),
    ] = None,
    acceleration: Annotated[
        Optional[float],  # noqa: UP045
        _text(
            "--acceleration",
            "PART",
            "Part of the time in which a trapezoidal profile speeds "
            "up, and in which it slows down, > 0, <= 0.5. Default: 1/3.",
        ),
    ] = None,
    ends: Annotated[
        Optional[Ends],  # noqa: UP045
        typer.Option(
            "--ends",
            help="Of a cubic spline: at rest, or qdd = 0. Default: rest.",
            show_default=False,
        ),
    ] = None,
    speed: Annotated[
        Optional[str],  # noqa: UP045
        _text(
            "--speed",
            "VECTOR",
            "Constant speed of the actuated joints, rad/s, or 60rpm, "
            "360deg/s; begins at --from (default: 0), ends after --turns or --time.",
        ),
    ] = None,
    turns: Annotated[
        Optional[str],  # noqa: UP045
        _text(
            "--turns",
            "VECTOR",
            "Turns of the fastest joint at --speed; without it, of each actuated joint in --time.",
        ),
    ] = None,
    amplitude: Annotated[
        Optional[str],  # noqa: UP045
        _text("--amplitude", "VECTOR", f"Of a sweep about --from, rad or 10deg: {_EACH}."),
    ] = None,
    frequencies: Annotated[
        Optional[str],  # noqa: UP045
        _text("--frequencies", "F0,F1", "Of a sweep: at its start and at its end, Hz."),
    ] = None,
    max_qd: Annotated[
        Optional[str],  # noqa: UP045
        _text("--max-qd", "VECTOR", f"Largest speed, rad/s, or 60rpm, 90deg/s: {_EACH}."),
    ] = None,
    max_qdd: Annotated[
        Optional[str],  # noqa: UP045
        _text("--max-qdd", "VECTOR", f"Largest acceleration, rad/s^2, or 90deg/s^2: {_EACH}."),
    ] = None,
    max_tau: Annotated[
        Optional[str],  # noqa: UP045
        _text("--max-tau", "VECTOR", f"Largest torque, N m: {_EACH}."),
    ] = None,
    every: Annotated[
        Optional[str],  # noqa: UP045
        _text("--every", "S", "Time between rows, s, or 10ms."),
    ] = None,
    points: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--points", metavar="N", help="Number of rows. Default: 1001."),
    ] = None,
    format: OutputFormat = None,
    out: Out = None,
) -> None:
    """A reference motion of the joints, as CSV for `torque`.

    Columns: t, q1.., qd1.., qdd1.. of all joints, at the start, every so often, and always at the
    end.  The motion is that of the actuated joints; in a closed mechanism the others follow along
    one branch: that of --from if it holds all joints, else the scene's `assembly`.

    From rest to rest (--from, --to), through points (--via), at constant speed (--speed), or a
    sine sweep about a pose (--profile sweep).  Through points cubic and quintic profiles are
    splines (of continuity C2 and C4) at rest at their ends; trapezoidal and cycloidal ones stop
    at each point.  Points without times get them in proportion to the distances in joint space.

    A limit (--max-qd, --max-qdd, --max-tau) that is exceeded anywhere, between the rows too, is an
    error; --time min takes the shortest duration that keeps the limits, and tells it on stderr.

    \b
    Examples:
      robodyn trajectory robots/2r.yaml --from 0,0 --to 90deg,45deg --time 2 --every 0.01
      robodyn trajectory robots/2r.yaml --from 0,0 --to 90deg,45deg --time min --max-tau 25,8
      robodyn trajectory robots/2r.yaml --via motion.csv --profile cubic --max-qd 90deg/s
      robodyn trajectory robots/four-bar.yaml --speed 60rpm --turns 1 --points 361
      robodyn trajectory robots/2r.yaml --profile sweep --from 30deg,45deg --amplitude 5deg \\
        --frequencies 0.2,5 --time 20 | robodyn torque robots/2r.yaml -
    """
    mechanism = load(model)
    duration = duration_from(time)
    with named_options():
        limits = limits_of(
            mechanism,
            rates_from(max_qd, "--max-qd", parse_rate, "6.28, 60rpm or 90deg/s"),
            rates_from(max_qdd, "--max-qdd", angular_acceleration_from, "20 or 90deg/s^2"),
            rates_from(max_tau, "--max-tau", parse_number, "25"),
        )
    if acceleration is not None and profile != "trapezoidal":
        raise InputError("--acceleration", limit="is for --profile trapezoidal")
    is_sweep = profile == "sweep"
    if is_sweep:
        refuse("a sweep", to=to, via=via, speed=speed, turns=turns, ends=ends)
    elif amplitude is not None or frequencies is not None:
        raise InputError("--amplitude and --frequencies", limit="are for --profile sweep")
    step = None if every is None else seconds_from(every, "--every")

    with remarks(), named_options(turns=turns, via=via, to=to, amplitude=amplitude, time=time):
        with progress("following the loops") as watch:
            if is_sweep:
                begin = given_angles(mechanism, from_, "from")
                chirp = sweep_from(mechanism, begin, amplitude, frequencies, duration)
                motion = _along(mechanism, chirp, begin, duration, limits, watch)
            elif speed is not None or turns is not None:
                refuse("--speed and --turns", to=to, via=via, profile=profile, ends=ends)
                begin = given_angles(mechanism, from_, "from", default=True)
                path, seconds = turning_from(mechanism, begin, speed, turns, duration)
                motion = _along(mechanism, path, begin, seconds, limits, watch)
            else:
                wanted = points_from(mechanism, from_, to, via)
                name = profile or "quintic"
                alpha = ACCELERATION if acceleration is None else acceleration
                natural = ends == "natural"
                motion = _through(mechanism, wanted, duration, limits, name, alpha, natural, watch)
        _write(motion, output_times(motion.duration, step, points), format, out)


# -- motions -------------------------------------------------------------------------------------


def _through(
    mechanism: Mechanism,
    points: Points,
    duration: float | None,
    limits: Limits,
    profile: str,
    acceleration: float,
    natural: bool,
    watch: Watch,
) -> ReferenceMotion:
    minimal = duration is not None and math.isnan(duration)
    if points.times is not None and duration is not None and not minimal:
        limit = f"{points.source} has the times (t): leave one of them out, or take min"
        raise InputError("--time", value=f"{duration:g}", limit=limit)
    if points.times is None and duration is None:
        raise InputError("--time", limit="missing: give seconds, or min and a limit")
    try:
        if minimal:
            found = shortest_through(
                mechanism, points.q, limits, points.times, profile, acceleration, natural, watch
            )
            _tell(found.motion, found.bound)
            return found.motion
        actuated = points.q[:, list(mechanism.actuated)]
        path = path_through(actuated, points.times, profile, acceleration, natural)
    except InputError as error:
        if points.source and error.what.startswith(("times", "point")):
            error.add_place(points.source)
        raise
    begin = 0.0
    if points.times is not None:
        begin, duration = float(points.times[0]), float(np.ptp(points.times))
    assert duration is not None
    motion = motion_along(mechanism, path, points.q, duration, begin, watch)
    check_limits(motion, limits)
    return motion


def _along(
    mechanism: Mechanism,
    path: JointPath,
    begin: np.ndarray,
    duration: float | None,
    limits: Limits,
    watch: Watch,
) -> ReferenceMotion:
    assert duration is not None
    if math.isnan(duration):
        found = shortest_along(mechanism, path, begin[None], limits, watch=watch)
        _tell(found.motion, found.bound)
        return found.motion
    motion = motion_along(mechanism, path, begin[None], duration, watch=watch)
    check_limits(motion, limits)
    return motion


def _tell(motion: ReferenceMotion, bound: str) -> None:
    note(f"shortest duration: {motion.duration!r} s, bounded by {bound}")


# -- options -------------------------------------------------------------------------------------


def _write(
    motion: ReferenceMotion, times: EvenTimes, format: Format | None, out: str | None
) -> None:
    n = motion.mechanism.n
    columns = ["t", *(f"{name}{k + 1}" for name in ("q", "qd", "qdd") for k in range(n))]
    block = max(1, min(BLOCK, WORK // n**3))
    hidden = out is None and sys.stdout.isatty()  # the rows themselves show how far they are
    with row_writer(format, out, columns) as writer, progress("writing", hidden) as show:
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
