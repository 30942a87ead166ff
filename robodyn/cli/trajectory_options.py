"""What the options of `robodyn trajectory` say: points to go through, durations, limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from robodyn.cli.states import Quantity, open_input, option_source, table_source
from robodyn.errors import InputError
from robodyn.mechanism import Mechanism
from robodyn.quantities import parse_angle, parse_entries, parse_number, parse_time
from robodyn.table import Reader
from robodyn.trajectories.time_scaling import (
    LimitError,
)

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


def rates_from(
    text: str | None, option: str, parse: Callable[[str], float], example: str
) -> list[float] | None:
    return None if text is None else parse_entries(text, parse, where=option, example=example)


def refuse(what: str, **options: object) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name}", limit=f"does not go with {what}")


@contextmanager
def named_options() -> Iterator[None]:
    """An argument that is refused, or a limit that is exceeded, is named as its option."""
    try:
        yield
    except LimitError as error:
        error.add_place(f"--max-{error.quantity}")
        raise
    except InputError as error:
        error.what = OPTION_OF.get(error.what, error.what)
        raise


# -- rows ----------------------------------------------------------------------------------------
