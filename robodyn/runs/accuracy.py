"""The global error of a simulation: its estimate, and runs that keep it below a bound.

A tolerance bounds the error of one step.  How errors grow over a run depends on the motion (in a
chaotic one, exponentially).  So the error is measured: two runs of different tolerances differ by
the error of the looser one.  For an accuracy A, the tolerance starts at A/100 and is divided by 100
until two successive runs differ by at most A. The last run is taken; its own error is smaller
still.

At a hard stop rates jump, and two runs jump at slightly different times.  Their rates are compared
at times more than A (s) away from an impact of either run; their angles are compared at all times.
(As motions with jumps are compared: Goebel, Sanfelice, Teel, "Hybrid Dynamical Systems", 2012,
4.4.)
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from robodyn.elements.contacts import HARD
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.march import Record, run
from robodyn.runs.report import Outcome
from robodyn.runs.series_engine import check_served
from robodyn.runs.settings import Settings
from robodyn.runs.torques_over_time import over_a_run
from robodyn.tables.arrays import Array

AUTO = "auto"
SAMPLES = 200  # times at which runs are compared, besides those of the steps
MARGIN = 4.0 / 3.0  # by which the tighter run may err as well
CUTS = 4  # times of each step
MOST = 4_000_000  # numbers of a run that are kept
TIGHTER = 100.0  # factor between the tolerances of two runs


class AccuracyError(RobodynError):
    """The requested accuracy is beyond double precision for this motion."""


def error_estimate(
    mechanism: Mechanism, state: Array, t_end: float, actuation: Actuation, settings: Settings
) -> float:
    """Estimate the largest error of q (rad) and qd (rad/s), by a run 100 times as tight.

    Runs are compared at the ends of steps and between them.  The tighter run has an error too, at
    most a quarter of the difference (Radau), so a third is added.  Returns nan if no tighter
    tolerance exists, or if one of the runs does not finish.
    """
    if tighter(settings) is None:
        return np.nan
    motion = _Motion((mechanism, state, t_end, actuation), settings)
    tight = motion.tighter(settings)
    assert tight is not None
    return MARGIN * difference(*map(motion.sampled, (settings, tight)))


def settings_for(
    mechanism: Mechanism,
    state: Array,
    t_end: float,
    actuation: Actuation,
    settings: Settings,
    accuracy: float,
) -> tuple[Settings, float]:
    """Return settings whose run keeps the error below `accuracy` (rad, rad/s), and the estimate.

    Raises AccuracyError if no tolerance suffices, and InputError for an accuracy outside (0, 1).
    """
    if not (0.0 < accuracy < 1.0):
        raise InputError("accuracy", value=accuracy, limit="must be in (0, 1)")
    chooses = settings.method == AUTO
    if chooses:
        over = over_a_run(actuation, state.tolist(), float(t_end))
        stabilizes = settings.stabilize != "baumgarte"
        method = best_method(mechanism, over) if stabilizes else "DOP853"
        settings = replace(settings, method=method)
    first = max(accuracy / TIGHTER, TIGHTER * settings.smallest_rtol)
    loose = replace(settings, rtol=first, atol=first)
    motion = _Motion((mechanism, state, t_end, actuation), loose)
    before = motion.sampled(loose)
    if before is None and chooses and settings.method == "taylor":  # a root begins: no series
        others = replace(settings, method="DOP853")
        return settings_for(mechanism, state, t_end, actuation, others, accuracy)
    if before is None:  # the run itself tells why
        return loose, np.nan
    best = np.inf
    while (tight := motion.tighter(loose)) is not None:
        after = motion.sampled(tight)
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
    """Return "taylor", the cheapest at every accuracy, or DOP853 if no machine code serves."""
    try:
        check_served(mechanism, actuation)
    except InputError:
        return "DOP853"
    return "taylor"


def tighter(settings: Settings) -> Settings | None:
    """Return settings 100 times as tight; None if the method cannot be 3 times as tight."""
    least = settings.smallest_rtol
    rtol, atol = (max(x / TIGHTER, least) for x in (settings.rtol, settings.atol))
    if rtol * 3.0 > settings.rtol and atol * 3.0 > settings.atol:
        return None
    return replace(settings, rtol=rtol, atol=atol)


class Sampled(NamedTuple):
    """States y (T, 2n) of a run, and the work that its steps missed over the energy in motion.

    `apart` (T,) is the time between each state and the nearest impact, s.
    """

    y: Array
    missed: float
    apart: Array


class _Motion:
    """A motion with the times at which its runs are compared: `CUTS` times per step.

    Errors peak while the motion is fast, and there steps are short.
    """

    def __init__(self, of: tuple[Mechanism, Array, float, Actuation], settings: Settings) -> None:
        self._of, (_, state, t_end, _) = of, of
        ends: list[Array] = []
        outcome, _ = run(*self._of, settings, lambda t, y, _: ends.append(t))
        self.outcome = outcome
        steps = np.concatenate(ends)
        self.longest = float(np.abs(np.diff(steps)).max(initial=0.0)) or np.inf
        apart = max(1.0 / CUTS, len(steps) * len(state) / MOST)
        cuts = np.interp(np.arange(0, len(steps) - 1, apart), np.arange(len(steps)), steps)
        even = np.linspace(0.0, steps[-1], SAMPLES)
        self.times = np.unique(np.concatenate([cuts, steps[-1:], even]))
        if t_end < 0.0:
            self.times = self.times[::-1]
        if outcome is Outcome.LIMIT:  # which each run meets at a time of its own
            self.times = self.times[:-1]

    def tighter(self, settings: Settings) -> Settings | None:
        """Return tighter settings; their steps are also shorter if no tolerance limits them.

        The series needs no shorter steps: its order rises with the tolerance.
        """
        tight = tighter(settings)
        if tight is None or settings.method == "taylor":
            return tight
        return replace(tight, max_step=0.5 * min(settings.max_step, self.longest))

    def sampled(self, settings: Settings) -> Sampled | None:
        """Return a run's states at the times; None if it ends otherwise than the first run."""
        if self.outcome not in (Outcome.FINISHED, Outcome.LIMIT):
            return None
        rows: list[Array] = []
        outcome, record = run(*self._of, settings, lambda t, y, _: rows.append(y), self.times)
        if outcome is not self.outcome:
            return None
        y = np.concatenate(rows)[: len(self.times), : len(self._of[1])]
        if len(y) < len(self.times):
            return None
        return Sampled(y, record.settle().work_missed, self._apart(record))

    def _apart(self, record: Record) -> Array:
        """Return the distance in time (T,) from the nearest hard impact of a run, s."""
        jumps = HARD in self._of[0].contacts
        hits = np.array([event.t for event in record.contacts if jumps])
        if not len(hits):
            return np.full(len(self.times), np.inf)
        after = np.searchsorted(hits, self.times)
        near = hits[np.clip([after - 1, after], 0, len(hits) - 1)]
        return np.asarray(np.abs(near - self.times).min(axis=0))


def difference(first: Sampled | None, second: Sampled | None) -> float:
    """Estimate the error of the first run, including the work that both runs missed."""
    if first is None or second is None:
        return np.nan
    n = first.y.shape[1] // 2
    off = np.abs(first.y - second.y)
    rates = np.minimum(off[:, n:].max(axis=1), np.minimum(first.apart, second.apart))
    return max(float(off[:, :n].max()), float(rates.max()), second.missed)
