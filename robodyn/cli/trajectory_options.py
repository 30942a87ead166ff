"""What the options of `robodyn trajectory` say: points to go through, durations, limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from robodyn.cli.states import Quantity, open_input, option_source, table_source
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.per_joint import for_each_actuated
from robodyn.scene.quantities import (
    parse_angle,
    parse_entries,
    parse_number,
    parse_rate,
    parse_time,
)
from robodyn.tables.csv_fields import shown
from robodyn.tables.table import Reader
from robodyn.trajectories.continuation import TravelError
from robodyn.trajectories.joint_paths import ConstantSpeed, JointPath, Sweep
from robodyn.trajectories.time_scaling import LimitError

MOST_CYCLES = 100_000  # of a sweep

OPTION_OF = {  # what the numerics call an argument
    "profile": "--profile",
    "acceleration": "--acceleration",
    "ends": "--ends",
    "duration": "--time",
    "max_qd": "--max-qd",
    "max_qdd": "--max-qdd",
    "max_tau": "--max-tau",
}


@dataclass(frozen=True, slots=True)
class Points:
    """Points (K, n) to go through, NaN where a passive joint is not given, and their times."""

    q: np.ndarray
    times: np.ndarray | None
    source: str


def points_from(mechanism: Mechanism, from_: str | None, to: str | None, via: str | None) -> Points:
    if via is None:
        for option, text in (("--from", from_), ("--to", to)):
            if text is None:
                limit = "missing: give --from and --to, or --via, --speed, --profile sweep"
                raise InputError(option, limit=limit)
        rows = [given_angles(mechanism, from_, "from"), given_angles(mechanism, to, "to")]
        return Points(np.array(rows), None, "")
    with open_input(via) as (stream, name):
        reader = Reader(stream, name)
        source = table_source(mechanism, Quantity("q", None, True), reader.header, name)
        timed = "t" in reader.header
        columns = [*source.columns, *(["t"] if timed else [])]
        blocks = [chunk.values for chunk in reader.chunks(columns)]
    values = np.concatenate(blocks) if blocks else np.zeros((0, len(columns)))
    given = values[:, : len(source.columns)]
    q = np.full((len(values), mechanism.n), np.nan)
    q[:, slice(None) if source.whole else list(mechanism.actuated)] = given
    if timed:
        refuse(f"the times (t) in {name}", **{"from": from_, "to": to})
        return Points(q, values[:, -1], name)
    if from_ is not None:
        q = np.concatenate([given_angles(mechanism, from_, "from")[None], q])
    if to is not None:
        q = np.concatenate([q, given_angles(mechanism, to, "to")[None]])
    return Points(q, None, name)


def given_angles(
    mechanism: Mechanism, text: str | None, name: str, default: bool = False
) -> np.ndarray:
    """The angles (n,) of an option, NaN where it holds the actuated joints only."""
    q = np.full(mechanism.n, np.nan)
    driven = list(mechanism.actuated)
    if text is None:
        if not default:
            raise InputError(f"--{name}", limit="missing: give the pose that the sweep is about")
        q[driven] = 0.0
        return q
    source = option_source(mechanism, Quantity(name, text, True))
    q[slice(None) if source.whole else driven] = source.values
    return q


def duration_from(text: str | None) -> float | None:
    """Seconds; NaN for the shortest."""
    if text is None:
        return None
    return math.nan if text == "min" else seconds_from(text, "--time", " or min")


def seconds_from(text: str, option: str, other: str = "") -> float:
    try:
        return parse_time(text)
    except ValueError as error:
        limit = f"{error}; write 2, 0.5s, 20ms{other}"
        raise InputError(option, value=text, limit=limit) from None


def frequency_from(text: str) -> float:
    return parse_number(text.removesuffix("Hz"))


def angular_acceleration_from(text: str) -> float:
    return parse_angle(text.removesuffix("/s^2"))


def sweep_from(
    mechanism: Mechanism,
    pose: np.ndarray,
    amplitude: str | None,
    frequencies: str | None,
    duration: float | None,
) -> Sweep:
    """The sine sweep about a pose (n,)."""
    if amplitude is None or frequencies is None:
        raise InputError("--profile sweep", limit="needs --amplitude and --frequencies F0,F1")
    if duration is None or not (math.isfinite(duration) and duration > 0.0):
        raise InputError("--time", limit="of a sweep must be seconds, > 0 and finite")
    driven = list(mechanism.actuated)
    sizes = parse_entries(amplitude, parse_angle, where="--amplitude", example="0.1 or 5deg")
    sizes = for_each_actuated(mechanism, sizes, "--amplitude")
    band = parse_entries(frequencies, frequency_from, where="--frequencies", example="0.2,5 (Hz)")
    if len(band) != 2 or min(band) < 0.0 or max(band) == 0.0:
        limit = "must be two frequencies, at the start and at the end, Hz, >= 0 and not both 0"
        raise InputError("--frequencies", value=frequencies, limit=limit)
    cycles = 0.5 * (band[0] + band[1]) * duration
    if cycles > MOST_CYCLES:
        limit = f"makes {cycles:.6g} cycles, too many: at most {MOST_CYCLES}"
        raise InputError("--frequencies", value=frequencies, limit=limit)
    return Sweep(pose[driven], np.array(sizes), band[0], band[1], duration)


def turning_from(
    mechanism: Mechanism,
    begin: np.ndarray,
    speed: str | None,
    turns: str | None,
    duration: float | None,
) -> tuple[JointPath, float]:
    """The path at constant speed, and its duration (NaN: the shortest)."""
    start = begin[list(mechanism.actuated)]
    counts = None
    if turns is not None:
        counts = parse_entries(turns, parse_number, where="--turns", example="1 or 0.5")
    if speed is None:
        assert counts is not None
        if duration is None:
            raise InputError("--turns", limit="needs --speed or --time")
        way = 2 * np.pi * np.array(for_each_actuated(mechanism, counts, "--turns"))
        return ConstantSpeed(start, way), duration
    rates = parse_entries(speed, parse_rate, where="--speed", example="6.28, 60rpm or 360deg/s")
    rate = np.array(for_each_actuated(mechanism, rates, "--speed"))
    fastest = float(np.abs(rate).max())
    if counts is not None:
        if duration is not None:
            raise InputError("--speed, --turns and --time", limit="exclude one another: give two")
        if len(counts) != 1 or counts[0] <= 0.0:
            limit = "with --speed it must be one number > 0, of the fastest joint"
            raise InputError("--turns", value=turns, limit=limit)
        if fastest == 0.0:
            raise InputError("--speed", value=speed, limit="must not be 0 where --turns are given")
        duration = 2 * math.pi * counts[0] / fastest
    if duration is None or math.isnan(duration):
        raise InputError("--speed", limit="needs --turns, or --time in seconds")
    return ConstantSpeed(start, rate * duration), duration


def rates_from(
    text: str | None, option: str, parse: Callable[[str], float], example: str
) -> list[float] | None:
    return None if text is None else parse_entries(text, parse, where=option, example=example)


def refuse(what: str, **options: object) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name}", limit=f"does not go with {what}")


@contextmanager
def named_options(**given: str | None) -> Iterator[None]:
    """An argument that is refused, or a limit that is exceeded, is named as its option.

    A path that is too long is named as the first of the options that are `given`.
    """
    try:
        yield
    except TravelError as error:
        name, value = next((name, value) for name, value in given.items() if value is not None)
        limit = f"makes a path of {error.value}: {error.limit}"
        raise InputError(f"--{name}", value=shown(value), limit=limit) from None
    except LimitError as error:
        error.add_place(f"--max-{error.quantity}")
        raise
    except InputError as error:
        error.what = OPTION_OF.get(error.what, error.what)
        raise


# -- rows ----------------------------------------------------------------------------------------
