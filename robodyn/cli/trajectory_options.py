"""What the options of `robodyn trajectory` say: points to go through, durations, limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from robodyn.cli.files import rows_file
from robodyn.cli.motion_files import without_jumps
from robodyn.cli.options import EACH, Number, Text, Unwrap, option, refuse
from robodyn.cli.row_files import read_columns
from robodyn.cli.states import Quantity, driver_of, option_source, table_source
from robodyn.errors import InputError, named_options
from robodyn.mechanics.actuation import for_each_actuated
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.column_units import joint_values, scene_units
from robodyn.scene.quantities import parse_vector, value_from
from robodyn.tables.csv_fields import shown
from robodyn.trajectories.continuation import TravelError
from robodyn.trajectories.joint_paths import ConstantSpeed, JointPath, Sweep
from robodyn.trajectories.motion_limits import LimitError, Limits, limits_of

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
    via: Annotated[Text, rows_file("--via", _VIA)] = None
    unwrap: Unwrap = False
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
    path: Annotated[Text, rows_file("--path", _PATH)] = None
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


@dataclass(frozen=True, slots=True)
class Points:
    """Points (K, n) to go through, NaN where a passive joint is not given, and their times."""

    q: np.ndarray
    times: np.ndarray | None
    source: str


def points_from(mechanism: Mechanism, given: TrajectoryOptions) -> Points:
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
        values, names, source, lines = read_columns(given.via, columns, scene_units(mechanism))
        timed = names[-1] == "t"
        column = dict(zip(names, values.T, strict=True))
        driven = [f"q{k + 1}" for k in mechanism.actuated]
        known = mechanism, column, lines, source, given.unwrap, driven
        column = without_jumps(*known, refuse=False)
        rows = np.full((len(values), mechanism.n), np.nan)
        for joint in _joints(mechanism, len(names) - timed == mechanism.n):
            rows[:, joint] = column[f"q{joint + 1}"]
        if timed:
            refuse(f"does not go with the times (t) in {source}", **ends)
            times = values[:, -1]
    first, last = (
        np.zeros((0, mechanism.n)) if text is None else given_angles(mechanism, text, name)[None]
        for name, text in ends.items()
    )
    return Points(np.concatenate([first, rows, last]), times, source)


def when(times: np.ndarray | None, source: str, duration: float | None) -> tuple[float, float]:
    """Where a motion begins and its duration, s (NaN: the shortest), by --time or its points'."""
    if times is None:
        if duration is None:
            raise InputError("--time", limit="missing: give seconds, or min and a limit")
        return 0.0, duration
    if duration is not None and not math.isnan(duration):
        limit = f"{source} has the times (t): leave one of them out, or take min"
        raise InputError("--time", value=f"{duration:g}", limit=limit)
    return float(times[0]), float(np.ptp(times)) if duration is None else duration


def _joints(mechanism: Mechanism, whole: bool) -> list[int]:
    return list(range(mechanism.n) if whole else mechanism.actuated)


def given_angles(
    mechanism: Mechanism, text: str | None, name: str, default: bool = False
) -> np.ndarray:
    """The angles (n,) of an option, NaN where it holds the actuated joints only."""
    if text is None and not default:
        raise InputError(f"--{name}", limit="missing: give the pose that the sweep is about")
    q = np.full(mechanism.n, np.nan)
    source = option_source(mechanism, Quantity(name, text))
    q[_joints(driver_of(mechanism, name), source.whole)] = source.values
    return q


def sweep_from(
    mechanism: Mechanism, pose: np.ndarray, given: TrajectoryOptions, duration: float | None
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
    mechanism: Mechanism, begin: np.ndarray, given: TrajectoryOptions, duration: float | None
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
