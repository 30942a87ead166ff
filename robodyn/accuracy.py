"""The global error of a simulation: estimated, and kept below what is asked for.

A tolerance bounds what one step may miss; how that grows over a run is the motion's own affair
(of a chaotic one, exponentially).  So the error is measured: two runs of different tolerance differ
by the error of the looser one.  For an accuracy A the tolerance starts at A/100 and is divided by
100 until two runs in a row differ by A at most; the last of them is taken, whose own error is
smaller still.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robodyn.actuation import Actuation
from robodyn.errors import InputError, RobodynError
from robodyn.mechanism import Mechanism
from robodyn.recording import Outcome
from robodyn.simulation import SCIPY_RTOL, SMALLEST_RTOL, Settings, run
from robodyn.taylor.run import stepping_engine

Array = NDArray[np.float64]

AUTO = "auto"
SAMPLES = 200  # times at which runs are compared
TIGHTER = 100.0  # factor between the tolerances of two runs


class AccuracyError(RobodynError):
    """The accuracy that was asked for is beyond what double precision keeps of this motion."""


def error_estimate(
    mechanism: Mechanism, state: Array, t_end: float, actuation: Actuation, settings: Settings
) -> float:
    """The largest error of q (rad) and qd (rad/s) along a run, by a run 100 times as tight.

    nan where there is no tighter run, or one of the two does not finish.
    """
    tight = tighter(settings)
    if tight is None:
        return np.nan
    runs = [sampled(mechanism, state, t_end, actuation, each) for each in (settings, tight)]
    return difference(*runs)


def settings_for(
    mechanism: Mechanism,
    state: Array,
    t_end: float,
    actuation: Actuation,
    settings: Settings,
    accuracy: float,
) -> tuple[Settings, float]:
    """Settings whose run errs by `accuracy` (rad, rad/s) at most, and the estimate that says so.

    Raises AccuracyError where no tolerance keeps it, InputError for an accuracy that is none.
    """
    if not (0.0 < accuracy < 1.0):
        raise InputError("accuracy", value=accuracy, limit="must be in (0, 1)")
    if settings.method == AUTO:
        stabilizes = settings.stabilize != "baumgarte"
        method = best_method(mechanism, actuation) if stabilizes else "DOP853"
        settings = replace(settings, method=method)
    first = max(accuracy / TIGHTER, TIGHTER * _smallest(settings))
    loose = replace(settings, rtol=first, atol=first)
    before = sampled(mechanism, state, t_end, actuation, loose)
    if before is None:  # the run itself tells why
        return loose, np.nan
    best = np.inf
    while (tight := tighter(loose)) is not None:
        after = sampled(mechanism, state, t_end, actuation, tight)
        if after is None:
            break
        estimate = difference(before, after)
        if estimate <= accuracy:
            return tight, estimate
        best = min(best, estimate)
        loose, before = tight, after
    limit = "is not kept at the tightest tolerances"
    if tight is not None:
        limit = f"is not kept, and a run of rtol {tight.rtol:g} does not finish"
    if np.isfinite(best):
        limit += f"; runs differ by {best:.2g}: this motion forgets its start"
    limit += "; ask for less, or for a shorter time"
    raise AccuracyError("accuracy", where=mechanism.source, value=f"{accuracy:g}", limit=limit)


def best_method(mechanism: Mechanism, actuation: Actuation) -> str:
    """The Taylor series, the cheapest at every accuracy; DOP853 where torques have none."""
    try:
        stepping_engine(mechanism, actuation, 1e-9, 1e-9)
    except InputError:
        return "DOP853"
    return "taylor"


def tighter(settings: Settings) -> Settings | None:
    """Settings a hundred times as tight; None where the method takes none three times as tight."""
    least = _smallest(settings)
    rtol, atol = (max(x / TIGHTER, least) for x in (settings.rtol, settings.atol))
    if rtol * 3.0 > settings.rtol and atol * 3.0 > settings.atol:
        return None
    return replace(settings, rtol=rtol, atol=atol)


def sampled(
    mechanism: Mechanism, state: Array, t_end: float, actuation: Actuation, settings: Settings
) -> Array | None:
    """The states (SAMPLES, 2n) of a run, or None where it does not finish."""
    rows: list[Array] = []
    times = np.linspace(0.0, t_end, SAMPLES) if t_end else np.zeros(1)
    outcome, _ = run(
        mechanism, state, t_end, actuation, settings, lambda t, y: rows.append(y), times
    )
    return np.concatenate(rows) if outcome is Outcome.FINISHED else None


def difference(first: Array | None, second: Array | None) -> float:
    if first is None or second is None:
        return np.nan
    return float(np.abs(first - second).max())


def _smallest(settings: Settings) -> float:
    return SMALLEST_RTOL.get(settings.method, SCIPY_RTOL)
