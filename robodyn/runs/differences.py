"""Derivatives of a motion by numbers of its scene and by start values: differences of runs.

Up to six runs with x + h in place of the number x give the derivative of (q, qd) by x: the slope at
x of the polynomial through these runs and the run itself.  With h = +-s, +-s/2, +-s/4 this is the
central difference, extrapolated twice.  A number at its bound is moved to one side only.  The first
runs determine s.

Each row takes the polynomial with the least error, through some of the runs, on both sides or on
one.  Its error is its change when the outermost runs are left out, plus the effect of the runs'
tolerance.  Runs with other contacts up to a row are left out, so rows next to an impact are right.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.columns import of_joints, result_names
from robodyn.dynamics.dynamics import motion_dynamics
from robodyn.dynamics.joint_vectors import reclosed
from robodyn.errors import InputError, RobodynError
from robodyn.loops.assembly_plan import with_independent
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.runs.report import Outcome, Report
from robodyn.runs.settings import Settings
from robodyn.scene.dimensions import dimension_of
from robodyn.scene.scene import Description
from robodyn.scene.scene_values import SceneValues
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.runs.watch import EventWatch

Build = Callable[[Description], Mechanism]
TIGHT = {"DOP853": 1e-13, "taylor": 1e-15}  # tolerances of the runs; of other methods 1 % of theirs
SEEN = 1e-9  # by which runs differ at least, to tell how far they bend
ROUNDING = 1e-14  # relative, of any run
STEP = 2.0**-6  # the first, of the number's size
STRAIGHT, BENT, LOST = 0.002, 0.05, 0.25  # bends, of a slope: steps get longer, shorter, by far so
EVEN = 1e-4  # by which slopes of two steps differ, of themselves: a longer one will do
APART = 0.1  # of the motion, and of a slope: runs so far apart and bent tell nothing any more
CAUTION = 10.0  # times as large is told what is left of errors that become smaller
FAR = 1e-3  # times as long are far shorter steps
ALONG = 1e-5  # of a state, by which the function of an event is moved
SETTLED = 1e-3  # of the largest derivative up to a row: a larger error withholds it
_START = re.compile(r"(q|qd)([1-9][0-9]*)", re.ASCII)


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives (T, 2n, k) of (q, qd) at rows by each of k names; nan where withheld.

    `errors` has the largest error of each name's derivatives, relative to the largest derivative.
    """

    names: tuple[str, ...]
    values: Array
    errors: dict[str, float]
    withheld: tuple[str, ...]  # a line a name: from when on, and why
    interrupted: bool

    @property
    def flat(self) -> Array:
        """The values of `columns`, (T, 2n k)."""
        return self.values.swapaxes(1, 2).reshape(len(self.values), -1)


def columns(n: int, names: Sequence[str]) -> list[str]:
    """Return column names: dq1/NAME is d(q1)/d(NAME)."""
    state = [x for family in ("q", "qd") for x in of_joints(family, range(n))]
    return [x for name in names for x in result_names("slopes", state, name)]


class Numbers:
    """Builds a mechanism and its start (q, qd) (2n,) from numbers of a scene and start values.

    `make` builds a mechanism from a scene.  Raises InputError if a name is no number of the scene.
    """

    def __init__(
        self, mechanism: Mechanism, names: Sequence[str], state: Array, make: Build = build
    ) -> None:
        where, self.mechanism, self.state, self.make = mechanism.source, mechanism, state, make
        self.names = tuple(names)
        if isinstance(names, str) or not all(isinstance(name, str) for name in names):
            limit = 'must be a list of names, such as ["q1"]'
            raise InputError("sensitivity", where=where, value=repr(names), limit=limit)
        if not names or len(set(names)) < len(names):
            raise InputError("sensitivity", where=where, limit="needs names, each once")
        self.starts = {x: place for x in names if (place := self._start_place(x)) is not None}
        self.values = None
        if others := [name for name in names if name not in self.starts]:
            self.values = SceneValues(mechanism.description.written, where)
            self.values.check(others)
            made = make(self.values.base).description
            if made != mechanism.description or mechanism.added:
                limit = "cannot differentiate by it: the mechanism is not that of its scene file"
                raise InputError(", ".join(others), where=where, limit=limit)

    def _start_place(self, name: str) -> int | None:
        """Return the index in (q, qd) of a start value; None for other names."""
        mechanism, match = self.mechanism, _START.fullmatch(name)
        if name.startswith("start."):
            limit = "is where assembly begins; name a start value, q1 or qd1"
            raise InputError(name, where=mechanism.source, limit=limit)
        if match is None:
            return None
        joint, n = int(match[2]) - 1, mechanism.n
        if joint >= n:
            limit = f"must be one of {match[1]}1..{match[1]}{n}"
            raise InputError(name, where=mechanism.source, limit=limit)
        if mechanism.rows and joint not in with_independent(mechanism).actuated:
            limit = f"joint {mechanism.link_names[joint]} follows the actuated ones"
            raise InputError(name, where=mechanism.source, limit=limit)
        return joint + n * (match[1] == "qd")

    def value(self, name: str) -> float:
        """Return the number or start value of this name."""
        if name in self.starts:
            return float(self.state[self.starts[name]])
        assert self.values is not None
        return self.values.number(name)

    def size(self, name: str, t_end: float) -> float:
        """Return the magnitude of a number, to scale its step.

        For a number that is 0 it follows from its unit and the scene's lengths, mass and duration.
        """
        links = self.mechanism.description.links
        length = max((abs(x) for link in links for x in (link.l, link.r) if x), default=1.0)
        if name in self.starts:
            return length if self.starts[name] % self.mechanism.n in self.mechanism.slides else 1.0
        assert self.values is not None
        if value := self.values.number(name):
            return abs(value)
        mass = sum(link.m for link in links) or 1.0
        scales = {"m": length, "kg": mass, "s": abs(t_end) or 1.0}
        powers = dimension_of(self.values.unit(name)).items()
        return float(np.prod([scales.get(base, 1.0) ** power for base, power in powers]))

    def at(self, values: Mapping[str, float]) -> tuple[Mechanism, Array]:
        """Return the mechanism with some numbers replaced, and its start.

        Dependent joints are assembled.  Raises InputError if a value is not allowed in a scene, or
        if the loops do not close.
        """
        moved, start, n = self.mechanism, self.state.copy(), self.mechanism.n
        if numbers := {x: value for x, value in values.items() if x not in self.starts}:
            assert self.values is not None
            moved = self.make(self.values.replaced(numbers))
        for name, place in self.starts.items():
            start[place] = values.get(name, start[place])
        if moved.rows:
            start = np.concatenate(reclosed(moved, start[:n], start[n:], t=0.0))
        return moved, start


@dataclass
class _Run:
    """A run with one number changed: states y (T, 2n), nan beyond its end.

    `contacts` are the names of its events of contacts, `contact_times` the sizes of their times.
    """

    change: float
    y: Array
    contacts: list[str]
    contact_times: Array
    outcome: Outcome

    def as_at(self, other: _Run, times: Array) -> Array:
        """Return the states, with nan in rows before which the two runs had different contacts."""
        if not self.contacts and not other.contacts:
            return self.y
        counts = [np.searchsorted(x.contact_times, np.abs(times), "right") for x in (self, other)]
        pairs = list(zip(*(x.tolist() for x in counts), strict=True))
        alike = {
            (a, b): sorted(self.contacts[:a]) == sorted(other.contacts[:b]) for a, b in set(pairs)
        }
        same = np.array([alike[pair] for pair in pairs], bool)
        return np.where(same[:, None], self.y, np.nan)


def sensitivities(
    numbers: Numbers,
    actuation: Actuation,
    settings: Settings,
    rows: Array,
    watch: Callable[[float], bool] | None = None,
) -> Sensitivities:
    """Return the derivatives at times `rows` (T,) of the motion that starts at t = 0.

    Raises RobodynError if the motion exists for no other value of a number.
    """
    state, names = numbers.state, numbers.names
    times, place = np.unique(np.abs(rows), return_inverse=True)
    times = -times if (rows < 0.0).any() else times
    t_end = float(times[-1]) if len(times) else 0.0
    tolerance = TIGHT.get(settings.method, 0.01 * min(settings.rtol, settings.atol))
    tolerance = max(tolerance, settings.smallest_rtol)
    tight = replace(
        settings,
        rtol=min(settings.rtol, tolerance),
        atol=min(settings.atol, tolerance),
        max_evaluations=100 * settings.max_evaluations,
    )
    torques = actuation.original or actuation

    def moved(name: str, change: float) -> _Run:
        from robodyn.runs.march import run

        machine, start = numbers.at({name: numbers.value(name) + change} if change else {})
        acting = torques.remade(machine) if torques.remade is not None else torques
        y = np.full((len(times), len(state)), np.nan)
        parts: list[Array] = []
        outcome, record = run(
            machine, start, t_end, acting, tight, lambda t, x, _: parts.append(x), times, watch
        )
        states = np.concatenate(parts or [y[:0]])[: len(times), : len(state)]
        y[: len(states)] = states
        names, at = [x.name for x in record.contacts], [abs(x.t) for x in record.contacts]
        return _Run(change, y, names, np.array(at), outcome)

    base = moved(names[0], 0.0)
    jumps = np.isin(np.abs(times), base.contact_times)  # rows that have no derivative alone
    values = np.full((len(times), len(state), len(names)), np.nan)
    errors: dict[str, float] = {}
    withheld, outcomes = [], [base.outcome]
    for k, name in enumerate(names):
        size = numbers.size(name, t_end)
        runs = _runs_of(partial(moved, name), size, base, times)
        outcomes += [run.outcome for run in runs]
        slope, error, differ = _slopes(base, runs, times, size, max(tight.rtol, ROUNDING))
        largest = np.maximum.accumulate(np.nan_to_num(np.abs(slope)).max(axis=1))
        off, noise = error.T
        lacks = ~(off <= SETTLED * largest + 10.0 * noise) | ~np.isfinite(noise)
        lost = np.flatnonzero(lacks & ~jumps)
        end = int(lost[0]) if len(lost) else len(times)
        values[:end, :, k] = np.where(lacks[:end, None], np.nan, slope[:end])
        errors[name] = 0.0
        if end and largest[end - 1]:
            kept = error[:end][~lacks[:end]].sum(axis=1)
            errors[name] = float(kept.max(initial=0.0) / largest[end - 1])
        if end < len(times):
            why = "the runs differ in their events" if differ[end] else "differences do not settle"
            withheld.append(f"columns dq1/{name}.. are empty from t = {times[end]:.6g} s on: {why}")
    stopped = Outcome.INTERRUPTED in outcomes
    return Sensitivities(names, values[place], errors, tuple(withheld), stopped)


def _runs_of(moved: Callable[[float], _Run], size: float, base: _Run, times: Array) -> list[_Run]:
    """Return up to six runs, with steps chosen by how nonlinear the runs are."""
    faults: list[RobodynError] = []

    def tried(*changes: float) -> list[_Run]:
        """Return the runs with these changes, but those in which no motion is defined."""
        runs: list[_Run] = []
        for change in changes:
            try:
                runs.append(moved(change))
            except RobodynError as error:
                faults.append(error)
        return runs

    h = STEP * size
    pair = tried(h, -h)
    if not pair:
        raise faults[-1]
    if len(pair) == 1:
        return pair + _to_one_side(tried, pair[0], base, times)
    runs, bent = list(pair), _bent(base, pair, times)
    for _ in range(2):
        if bent > LOST:
            h *= FAR
        elif bent > BENT:
            h *= 0.1 * BENT / bent
        elif len(runs) > 2 and _apart(base, runs, times) <= EVEN:
            h *= 4.0  # twice the first
        else:
            h *= 0.5
        pair = tried(h, -h)
        runs += pair
        if bent > BENT and len(pair) == 2:
            bent = _bent(base, pair, times)
    return runs


def _to_one_side(
    tried: Callable[..., list[_Run]], first: _Run, base: _Run, times: Array
) -> list[_Run]:
    """Return more runs on the side of the first."""
    h = first.change
    half = tried(0.5 * h)
    if not half:
        return []
    bent = 2.0 * _bent(base, [*half, first], times)
    parts: tuple[float, ...] = (0.25, 0.75, 0.125, 0.375)
    if bent <= STRAIGHT:
        parts = (2.0, 3.0, 4.0, 1.5)
    elif bent > BENT:
        h *= 0.1 * BENT / bent if bent <= LOST else FAR
        parts = (1.0, 0.75, 0.5, 0.25)
    return half + tried(*(part * h for part in parts))


@np.errstate(all="ignore")
def _bent(base: _Run, pair: Sequence[_Run], times: Array) -> float:
    """Return the relative difference of slopes between two runs, over the last quarter of rows."""
    away = [run.as_at(base, times) - base.y for run in pair]
    a, b = (y / run.change for y, run in zip(away, pair, strict=True))
    bend, slope = (np.abs(x).max(axis=1) for x in (a - b, a + b))
    parts = np.where(np.abs(away).max(axis=(0, 2)) < SEEN, 0.0, bend / np.fmax.accumulate(slope))
    return float(np.nan_to_num(np.median(parts[-max(1, len(bend) // 4) :]), nan=np.inf))


@np.errstate(all="ignore")
def _apart(base: _Run, runs: Sequence[_Run], times: Array) -> float:
    """Return the relative difference between the slopes of the first two pairs of runs."""
    a, b, c, d = (run.as_at(base, times) for run in runs)
    first, then = (a - b) / (2.0 * runs[0].change), (c - d) / (2.0 * runs[2].change)
    size = np.fmax.accumulate(np.abs(then).max(axis=1))
    parts = np.abs(first - then).max(axis=1) / size
    return float(np.nan_to_num(parts[size > 0.0], nan=np.inf).max(initial=0.0))


@np.errstate(all="ignore")
def _slopes(
    base: _Run, runs: Sequence[_Run], times: Array, size: float, tolerance: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return slopes (T, 2n), their errors (T, 2), and rows where all runs differ in events (T,).

    The first error is the change if the outermost runs are left out, the second the effect of the
    runs' tolerance.
    """
    away = {run.change: run.as_at(base, times) - base.y for run in runs}
    differ = np.array(np.isnan([*away.values()]).any(axis=2).all(axis=0))
    scale = np.maximum.accumulate(np.maximum(1.0, np.nan_to_num(np.abs(base.y)).max(axis=1)))
    moved = np.fmax.accumulate(np.abs(base.y - base.y[:1]), axis=0)
    best: Array = np.full(base.y.shape, np.nan)
    error = np.full((len(times), 2), np.inf)
    least = np.full(len(times), np.inf)
    sizes = sorted({abs(h) for h in away}, reverse=True)
    both = [[h, -h] for h in sizes if h in away and -h in away]
    bends: dict[float, Array] = {}  # of the slope, relative
    for h, _ in both:
        slope = np.fmax.accumulate(np.abs(away[h] - away[-h]).max(axis=1))
        bend = np.abs(away[h] + away[-h]).max(axis=1)
        bends[h] = np.where(bend <= 10.0 * tolerance * scale, 0.0, bend / slope)
        far = (np.abs(away[h]) > APART * np.minimum(moved, 1.0)).any(axis=1)
        lost = np.logical_or.accumulate(far & (bends[h] > APART))  # nor does it find back
        away[h], away[-h] = (np.where(lost[:, None], np.nan, away[x]) for x in (h, -h))
    valid = {h: np.isfinite(away[h] + away[-h]).all(axis=1) for h, _ in both}
    others = {h: np.any([x for k, x in valid.items() if k != h], axis=0) for h in valid}
    sides = [[[h] for h in sorted(away, key=abs, reverse=True) if h * s > 0.0] for s in (1.0, -1.0)]
    for levels in (both, *sides):
        for i in range(len(levels)):
            used: list[float] = []
            slopes: list[Array] = []  # of level i, then with one more level before it each
            for level in levels[i::-1]:
                used += level
                weights = _weights(used)
                slope = np.asarray(sum(w * away[h] for w, h in zip(weights, used, strict=True)))
                slopes.append(slope)
                largest = np.fmax.accumulate(np.abs(slope).max(axis=1))
                off = np.full(len(times), np.inf)
                if len(slopes) == 1 and levels is both:  # of no other order than its square
                    off = np.fmax.accumulate(bends[level[0]]) ** 2 * largest
                    off[others[level[0]]] = np.inf
                elif len(slopes) > 1:
                    off = np.abs(slope - slopes[-2]).max(axis=1)
                    before = np.abs(slopes[-2] - (slopes[-3] if slopes[2:] else 0.0)).max(axis=1)
                    part = np.where(before > 0.0, off / before, 0.0)
                    off *= np.minimum(1.0, CAUTION * (part if slopes[2:] else np.sqrt(part)))
                noise = tolerance * (scale + size * largest) * np.abs(weights).sum()
                part = np.where(largest > 0.0, (off + noise) / largest, off + noise)
                better = np.isfinite(slope).all(axis=1) & (part < least)
                best[better], least[better] = slope[better], part[better]
                error[better] = np.stack([off, noise], axis=1)[better]
    return best, error, differ


def _weights(h: Sequence[float]) -> Array:
    """Weights of f(h) - f(0) in the slope at 0 of the polynomial through f(0) and all f(h)."""
    x = np.array(h)
    apart = x[:, None] - x
    np.fill_diagonal(apart, 1.0)
    parts = -x / apart
    np.fill_diagonal(parts, 1.0)
    return np.asarray(parts.prod(axis=1) / x)


def tell(
    report: Report,
    derivatives: Sensitivities,
    events: EventWatch | None,
    moving: Mechanism,
    t: Array,
    y: Array,
    tau: Array,
) -> None:
    """Add to a report the errors of derivatives, and the derivatives of the run's end time.

    The last of times t (T,), states y (T, 2n or more) and torques tau (T, n) belong to the end, in
    the mode `moving`.  With g the event function and s = d(q, qd)/dp there, dt/dp = -g_y s/g', g'
    its rate along the motion.
    """
    report.sensitivity_errors = derivatives.errors
    report.remarks = [*report.remarks, *derivatives.withheld]
    if events is None or not events.ends or report.ended_by != events.functions[-1].name:
        return
    g = events.functions[-1]
    if g.computed:  # its columns may depend on the numbers by themselves too
        return
    t, (q, qd) = t[-1:], np.split(y[-1:, : 2 * moving.n], 2, axis=1)
    y, along = np.hstack([q, qd]), np.hstack([qd, motion_dynamics(moving, q, qd, tau[-1:], t).qdd])

    def slope(rate: float, way: Array) -> float:
        h = ALONG / max(1.0, float(np.abs(way).max()))
        ahead, behind = (g.values(t + x * rate, y + x * way)[0] for x in (h, -h))
        return float(ahead - behind) / (2.0 * h)

    by = derivatives.values[-1].T
    with np.errstate(all="ignore"):
        times = [-slope(0.0, s[None]) / (slope(1.0, along) or np.nan) for s in by]
    pairs = zip(derivatives.names, times, strict=True)
    report.until_sensitivity = {x: dt for x, dt in pairs if np.isfinite(dt)}
