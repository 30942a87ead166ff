"""The times of a motion's rows, from the options --time, --every and --points."""

from __future__ import annotations

import math

import numpy as np

from robodyn.errors import InputError

DEFAULT_POINTS = 1001
MOST_ROWS = 100_000_000


def output_times(duration: float, every: float | None, points: int | None) -> np.ndarray:
    """Times of the rows: from 0 on, the end included; InputError naming the option."""
    if not math.isfinite(duration):
        raise InputError("--time", value=duration, limit="must be finite")
    if every is not None and points is not None:
        raise InputError("--every and --points", limit="exclude each other")
    if every is not None:
        if not (math.isfinite(every) and every > 0.0):
            raise InputError("--every", value=every, limit="must be > 0 and finite")
        count = abs(duration) / every
        _check_number("--every", every, count)
        times = np.arange(math.ceil(count)) * math.copysign(every, duration)
        # a row so near the end would double it
        nearly = max(1e-9 * min(every, abs(duration)), 4 * math.ulp(duration))
        return np.append(times[np.abs(times - duration) > nearly], duration)
    wanted = DEFAULT_POINTS if points is None else points
    if wanted < 1:
        raise InputError("--points", value=wanted, limit="must be >= 1")
    _check_number("--points", wanted, wanted)
    if duration == 0.0 or wanted == 1:
        return np.array([duration])
    return np.linspace(0.0, duration, wanted)


def _check_number(option: str, value: float, rows: float) -> None:
    if rows > MOST_ROWS:
        limit = f"makes {rows:.6g} rows, too many: at most {MOST_ROWS}"
        raise InputError(option, value=value, limit=limit)
