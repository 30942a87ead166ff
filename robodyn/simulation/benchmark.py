"""Speed against error of every method on one motion, and of the evaluators on single states.

Errors are measured against `extended.py`; no error below its uncertainty is claimed.  Seconds are
those of whole runs, statistics included, taken in turn: the median and the least.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np

from robodyn.errors import RobodynError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.torque_times import over_a_scene_run
from robodyn.simulation.extended import Reference, reference
from robodyn.simulation.report import Outcome, Report
from robodyn.simulation.settings import METHODS, Settings
from robodyn.simulation.simulation import run
from robodyn.tables.arrays import Array
from robodyn.taylor.compiled import check_served

Watch = Callable[[float], object]  # the part that is done

TOLERANCES = tuple(10.0**-k for k in range(3, 14))
TIMES = 20  # output times at which errors are measured
PATIENCE = 1.0  # s: a method whose run took longer is not asked for more digits
MAX_EVALUATIONS = 1_000_000


@dataclass(slots=True)
class Measurement:
    """One method at one tolerance."""

    method: str
    tolerance: float
    outcome: str
    error: float = np.inf  # largest of q (rad) and qd (rad/s) over the output times
    error_end: float = np.inf
    drift: float = np.nan
    gap: float = np.nan
    evaluations: int = 0
    steps: int = 0
    median: float = np.nan  # s
    least: float = np.nan
    front: bool = False  # no other is both faster and better
    seconds: list[float] = field(default_factory=list)


@dataclass(slots=True)
class Benchmark:
    """Measurements of all methods, and how far the reference can be trusted."""

    reference: Reference
    measurements: list[Measurement]
    left_out: list[str]


def benchmark(
    mechanism: Mechanism,
    state: Array,
    t_end: float,
    actuation: Actuation,
    *,
    tolerances: Sequence[float] = TOLERANCES,
    repeats: int = 3,
    patience: float = PATIENCE,
    watch: Watch = lambda part: None,
) -> Benchmark:
    """Every method at every tolerance on the motion from `state` (2n,) at t = 0 to t_end > 0.

    Raises RobodynError if the reference cannot be computed, InputError if a torque has no series.
    """
    times = np.linspace(0.0, t_end, TIMES + 1)[1:]
    exact = reference(mechanism, state, times, actuation)
    if not np.isfinite(exact.y).all():
        raise RobodynError("bench", where=mechanism.source, limit="the motion is not finite")
    watch(0.1)

    def timed(settings: Settings, at: Array = times) -> tuple[float, Outcome, Report, Array]:
        rows: list[Array] = []
        begun = time.perf_counter()
        outcome, recorder = run(
            mechanism, state, at[-1], actuation, settings, lambda t, y, _: rows.append(y), at
        )
        took = time.perf_counter() - begun
        report = recorder.settle()
        return took, outcome, report, np.concatenate(rows or [np.zeros((0, len(state)))])

    over = over_a_scene_run(mechanism, actuation, state.tolist(), t_end)
    names, left_out = _methods(mechanism, over)
    found: list[Measurement] = []
    runs: list[tuple[Measurement, Settings]] = []
    for i, (name, settings) in enumerate(names):
        timed(settings, times[-1:] / 1000)  # what is loaded and made once is no part of a run
        for tolerance in tolerances:
            if tolerance < settings.smallest_rtol:
                continue
            each = replace(
                settings, rtol=tolerance, atol=tolerance, max_evaluations=MAX_EVALUATIONS
            )
            took, outcome, report, y = timed(each)
            measured = Measurement(
                name,
                tolerance,
                outcome.label,
                drift=report.energy_drift,
                gap=report.largest_gap,
                evaluations=report.evaluations,
                steps=report.steps,
            )
            found.append(measured)
            finished = outcome is Outcome.FINISHED
            if finished:
                off = np.maximum(np.abs(y - exact.y).max(axis=1), exact.uncertainty)
                measured.error, measured.error_end = float(off.max()), float(off[-1])
                runs.append((measured, each))
            if took > patience or not finished:
                if any(x < tolerance for x in tolerances):
                    why = measured.outcome if took <= patience else f"took {took:.2g} s"
                    left_out.append(f"{name} below {tolerance:g}: {why} there")
                break
        watch(0.1 + 0.4 * (i + 1) / len(names))
    for i in range(repeats):
        for measured, each in runs:
            measured.seconds.append(timed(each)[0])
        watch(0.5 + 0.5 * (i + 1) / repeats)
    for measured, _ in runs:
        measured.median, measured.least = median(measured.seconds), min(measured.seconds)
    _mark_front(found, exact.uncertainty)
    return Benchmark(exact, found, left_out)


def _methods(
    mechanism: Mechanism, actuation: Actuation
) -> tuple[list[tuple[str, Settings]], list[str]]:
    """Names and settings of the methods that serve this motion; which do not, and why."""
    names = [(method, Settings(method)) for method in METHODS if method != "taylor"]
    left_out = []
    try:
        check_served(mechanism, actuation)
        names.append(("taylor", Settings("taylor")))
    except RobodynError as error:
        left_out.append(f"taylor: {error.limit if error.what == 'method' else error}")
    return names, left_out


def _mark_front(found: list[Measurement], uncertainty: float) -> None:
    """Mark those that none is both faster and better than; errors in the noise are equal."""
    best = np.inf
    for each in sorted(found, key=lambda x: (x.least if x.least == x.least else np.inf, x.error)):
        if each.outcome == Outcome.FINISHED.label and each.error < best:
            each.front = True
            best = max(each.error, uncertainty)
