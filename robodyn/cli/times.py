"""Options that are times: those of a motion's rows, --time, --every, --points."""

from __future__ import annotations

import math
from typing import Annotated

from typer import Option

from robodyn.errors import InputError
from robodyn.runs.settings import DEFAULT_POINTS, EvenTimes

MOST_ROWS = 100_000_000
_POINTS = f"Number of rows. Default: {DEFAULT_POINTS}."
Points = Annotated[int | None, Option("--points", metavar="N", help=_POINTS)]


def output_times(duration: float, every: float | None, points: int | None) -> EvenTimes:
    """Times of the rows: from 0 on, the end included; InputError naming the option."""
    if not math.isfinite(duration):
        raise InputError("--time", value=duration, limit="must be finite")
    if every is not None and points is not None:
        raise InputError("--every and --points", limit="exclude each other")
    if every is not None:
        if not (math.isfinite(every) and every > 0.0):
            raise InputError("--every", value=every, limit="must be > 0 and finite")
        parts = abs(duration) / every
        _check_number("--every", every, parts)
        count, step = math.ceil(parts), math.copysign(every, duration)
        # a row so near the end would double it
        nearly = max(1e-9 * min(every, abs(duration)), 4 * math.ulp(duration))
        while count and abs((count - 1) * step - duration) <= nearly:
            count -= 1
        return EvenTimes(step, count + 1, duration)
    wanted = DEFAULT_POINTS if points is None else points
    if wanted < 1:
        raise InputError("--points", value=wanted, limit="must be >= 1")
    _check_number("--points", wanted, wanted)
    if duration == 0.0 or wanted == 1:
        return EvenTimes(0.0, 1, duration)
    step = duration / (wanted - 1)
    if wanted > 2 and not abs(step) > math.ulp(duration):
        limit = f"makes rows too close to one another in {duration:g} s"
        raise InputError("--points", value=wanted, limit=limit)
    return EvenTimes(step, wanted, duration)


def _check_number(option: str, value: float, rows: float) -> None:
    if rows > MOST_ROWS:
        limit = f"makes {rows:.6g} rows, too many: at most {MOST_ROWS}"
        raise InputError(option, value=value, limit=limit)
