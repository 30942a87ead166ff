"""The global error of a simulation: its estimate, and runs that keep it below a bound.

A tolerance bounds the error of one step.  How errors grow over a run depends on the motion (in a
chaotic one, exponentially).  So the error is measured: two runs of different tolerances differ by
the error of the looser one.  For an accuracy A, the tolerance starts at A/100 and is divided by 100
until two successive runs differ by at most A. The last run is taken; its own error is smaller
still.

Rounding of q and t grows with the number of steps, often with one sign, and two runs that take the
same steps round alike.  Half of its bound is added: eps/8 (|q| + |qd t|) a step.

At a hard stop rates jump, and two runs jump at slightly different times.  Their rates are compared
at times more than A (s) away from an impact of either run; their angles are compared at all times.
(As motions with jumps are compared: Goebel, Sanfelice, Teel, "Hybrid Dynamical Systems", 2012,
4.4.)
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from robodyn.elements.contacts import HARD
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.march import Record, run
from robodyn.runs.readers import joined
from robodyn.runs.report import Outcome
from robodyn.runs.segments import Segment
from robodyn.runs.series_engine import check_served
from robodyn.runs.settings import Settings
from robodyn.runs.torques_over_time import over_a_run
from robodyn.tables.arrays import Array

AUTO = "auto"
SAMPLES = 200  # times at which runs are compared, besides those of the steps
MARGIN = 4.0 / 3.0  # by which the tighter run may err as well
CUTS = 4  # times of each step
MOST = 4_000_000  # numbers in the states of a run that are kept
ROUNDING = 0.125 * float(np.finfo(float).eps)  # part of a way, a step
DIGITS = 1e-11  # of a state: runs that agree to it have forgotten nothing
TIGHTER = 100.0  # factor between the tolerances of two runs

Task = tuple[Mechanism, Array, float, Actuation]  # what runs, its start, t_end and torques


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
    of = mechanism, state, t_end, actuation
    first, longest = first_run(of, settings)
    tight = tighter(settings, longest)
    if first is None or tight is None or (after := run_beside(first, of, tight)) is None:
        return np.nan
    return MARGIN * difference(first, after)


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
    of = mechanism, state, t_end, actuation
    before, longest = first_run(of, loose)
    if before is None and chooses and settings.method == "taylor":  # a root begins: no series
        others = replace(settings, method="DOP853")
        return settings_for(mechanism, state, t_end, actuation, others, accuracy)
    if before is None:  # the run itself tells why
        return loose, np.nan
    best, rounded = np.inf, 0.0
    while (tight := tighter(loose, longest)) is not None:
        after = run_beside(before, of, tight)
        if after is None:
            break
        estimate = difference(before, after)
        if estimate <= accuracy:
            return tight, estimate
        if estimate < best:
            best, rounded = estimate, after.rounding
        loose, before = tight, after
    if chooses and settings.method == "taylor" and rounded > 0.5 * best:  # other steps are longer
        others = replace(settings, method="DOP853")
        with suppress(AccuracyError):
            return settings_for(mechanism, state, t_end, actuation, others, accuracy)
    limit = "is not kept at the tightest tolerances"
    if tight is not None:
        limit = f"is not kept, and a run of rtol {tight.rtol:g} does not finish"
    if rounded > 0.5 * best:
        limit += f"; rounding of its steps alone makes {rounded:.2g}"
    elif np.isfinite(best):
        size = float(np.abs(before.y).max(initial=0.0))
        why = "this motion forgets its start"
        if best < DIGITS * size:
            why = f"its states are up to {size:.2g}, of which doubles keep 16 digits"
        limit += f"; runs differ by {best:.2g}: {why}"
    limit += "; ask for less, or for a shorter time"
    raise AccuracyError("accuracy", where=mechanism.source, value=f"{accuracy:g}", limit=limit)


def best_method(mechanism: Mechanism, actuation: Actuation) -> str:
    """Return "taylor", the cheapest at every accuracy, or DOP853 if no machine code serves."""
    try:
        check_served(mechanism, actuation)
    except InputError:
        return "DOP853"
    return "taylor"


def tighter(settings: Settings, longest: float = np.inf) -> Settings | None:
    """Return settings 100 times as tight; None if the method cannot be 3 times as tight.

    Steps become half as long as `longest` (s), the longest step of a run, or shorter: a tolerance
    may not limit them.  The series needs no shorter steps: its order rises with the tolerance.
    """
    least = settings.smallest_rtol
    rtol, atol = (max(x / TIGHTER, least) for x in (settings.rtol, settings.atol))
    if rtol * 3.0 > settings.rtol and atol * 3.0 > settings.atol:
        return None
    tight = replace(settings, rtol=rtol, atol=atol)
    if settings.method == "taylor":
        return tight
    return replace(tight, max_step=0.5 * min(settings.max_step, longest))


class Sampled(NamedTuple):
    """States y (T, 2n) of a run at times t (T,), and how the run ended.

    `missed` is the work that its steps missed, over the energy in motion.  `apart` (T,) is the time
    between each state and the nearest hard impact, s.  `rounding` estimates what rounding of its
    steps adds up to, rad.
    """

    t: Array
    y: Array
    outcome: Outcome
    missed: float
    apart: Array
    rounding: float


class _Samples:
    """States y (k, 2n) of a run at times t (k,): `CUTS` per step, and `SAMPLES` even ones.

    Errors peak while the motion is fast, and there steps are short.  Each time that more than
    `MOST` numbers are kept, every second state is dropped, and later steps have half as many.
    `longest` is the longest step, s.
    """

    def __init__(self, width: int, t_end: float) -> None:
        self.kept = [(np.zeros(0), np.zeros((0, width)))]
        self.longest = 0.0
        self._even = np.linspace(0.0, t_end, SAMPLES)
        self._count, self._cuts = 0, 0  # states kept; cuts of all steps so far
        self._stride = 1  # every so many cuts are kept

    def take(self, segment: Segment) -> None:
        """Keep states along a segment."""
        steps, forward, width = len(segment), segment.forward, self.kept[0][1].shape[1]
        if not steps:  # a leg that takes no time
            return
        self.longest = max(self.longest, float(np.abs(np.diff(segment.t)).max()))
        if self._count * width > MOST:
            t, y = joined(self.kept)
            self.kept = [(t[::2].copy(), y[::2].copy())]
            self._count, self._stride = len(self.kept[0][0]), 2 * self._stride
        cuts = np.arange(1, CUTS * steps + 1)
        cuts = cuts[(self._cuts + cuts) % self._stride == 0] / CUTS
        times = np.append(np.interp(cuts, np.arange(steps + 1), segment.t), self._even) * forward
        within = (times > segment.begin * forward) & (times <= segment.end * forward)
        times = np.unique(times[within]) * forward
        self.kept.append((times, segment.at(times)[:, :width]))
        self._count += len(times)
        self._cuts += CUTS * steps


def first_run(of: Task, settings: Settings) -> tuple[Sampled | None, float]:
    """Run, and return the states of `_Samples` and the longest step (s); None if the run fails."""
    _, state, t_end, _ = of
    samples = _Samples(len(state), t_end)
    outcome, record = run(*of, settings, lambda *_: None, np.zeros(0), read=samples.take)
    t, y = joined(samples.kept)
    if outcome is Outcome.LIMIT:  # which each run meets at a time of its own
        t, y = t[:-1], y[:-1]
    ended = outcome in (Outcome.FINISHED, Outcome.LIMIT)
    sampled = _sampled(of, t, y, outcome, record) if ended else None
    return sampled, samples.longest or np.inf


def run_beside(first: Sampled, of: Task, settings: Settings) -> Sampled | None:
    """Run, and return the states at the times of the first run; None if it ends otherwise."""
    rows, count, width = [(first.t[:0], first.y[:0])], *first.y.shape
    outcome, record = run(*of, settings, lambda t, y, _: rows.append((t, y[:, :width])), first.t)
    t, y = joined(rows)
    if outcome is not first.outcome or not np.array_equal(t[:count], first.t):
        return None
    return _sampled(of, first.t, y[:count], outcome, record)


def _sampled(of: Task, t: Array, y: Array, outcome: Outcome, record: Record) -> Sampled:
    """Return states of a run, with the times of its impacts and the work that it missed."""
    hits = [event.t for event in record.contacts if HARD in of[0].contacts]
    report, n = record.settle(), of[0].n
    way = np.abs(y[:, :n]) + np.abs(y[:, n : 2 * n] * t[:, None])
    rounding = report.steps * ROUNDING * float(way.max(initial=0.0))
    return Sampled(t, y, outcome, report.work_missed, apart(t, np.array(hits)), rounding)


def apart(times: Array, hits: Array) -> Array:
    """Return the time (T,) between each of `times` (T,) and the nearest of the ordered `hits`."""
    if not len(hits):
        return np.full(len(times), np.inf)
    after = np.searchsorted(hits, times)
    near = hits[np.clip([after - 1, after], 0, len(hits) - 1)]
    return np.asarray(np.abs(near - times).min(axis=0))


def difference(first: Sampled, second: Sampled) -> float:
    """Estimate the error of the first run, with the work that both missed, and their rounding."""
    n = first.y.shape[1] // 2
    off = np.abs(first.y - second.y)
    near = np.minimum(first.apart, second.apart)
    rates = np.minimum(off[:, n:].max(axis=1, initial=0.0), near)
    seen = max(off[:, :n].max(initial=0.0), rates.max(initial=0.0), second.missed)
    return float(seen + max(first.rounding, second.rounding))
