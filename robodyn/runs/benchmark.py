"""Speed against error of every integration method on one motion.

Errors are measured against a reference in extended precision.  Two Taylor series of different order
and step size run over numpy's longdouble (64 bits of mantissa where the platform has them).  Their
difference is the uncertainty of the reference; no error below it is reported.  Rounding of the
scene's constants is shared by all runs and is not included.  Times are those of whole runs with
statistics, repeated in turn: the median and the least.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.arithmetic import FLOATS, Arithmetic
from robodyn.engines.expansion import Coefficients, MotionProgram, longest_step, strays
from robodyn.engines.factors import svd
from robodyn.errors import InputError, RobodynError
from robodyn.loops.closing import exact_gap, loop_size, newton
from robodyn.loops.closures import drift_at, jacobian_at, scaled_jacobian
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import next_stop
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import joint_ways, placed_at
from robodyn.mechanics.planar_model import Arrays
from robodyn.mechanics.torque_rows import linear_piece
from robodyn.runs.machine_motion import SEEN
from robodyn.runs.march import run
from robodyn.runs.report import Outcome, Report
from robodyn.runs.series_engine import check_served
from robodyn.runs.series_steps import reach
from robodyn.runs.settings import METHODS, Settings
from robodyn.runs.torques_over_time import over_run
from robodyn.tables.arrays import Array

Long = NDArray[Any]  # longdouble

LONG, COMPLEX = np.longdouble, np.clongdouble
NUMPY = {"atan": "arctan", "asin": "arcsin", "acos": "arccos"}  # what numpy calls them
ORDER = 30
TOLERANCE = 0.1  # of the series, in units of rounding
SMALLEST_STEP = 1e-12  # s
ROUNDING = 100.0 * float(np.finfo(np.longdouble).eps)  # part of a rate
AGREE = 1e-15  # part of an acceleration's terms by which its series may miss it
TOO_NEAR = 1e-8  # s/L below which nothing is closed
PASSES = 4  # of rates, each of which leaves a part of 1e-8 at most


class Reference(NamedTuple):
    """Reference states y (T, 2n) at output times, and their uncertainty."""

    y: Array
    uncertainty: float


def reference(mechanism: Mechanism, state: Array, times: Array, actuation: Actuation) -> Reference:
    """Return the motion from `state` (2n,) at increasing `times` > 0, in extended precision.

    Raises InputError if a torque has no series, and RobodynError if the motion cannot be followed.
    """
    mechanism.check_rubbing("series of many digits, which errors are measured against,")
    if mechanism.switches:
        raise _lost(mechanism, "has joints that stick or end: the reference is of smooth motions")
    if actuation.states:
        raise _lost(mechanism, "has a controller that integrates: the reference is of q and qd")
    actuation = over_run(mechanism, actuation, state, float(times[-1]))
    with np.errstate(all="ignore"):
        try:
            first = followed(mechanism, state, times, actuation, ORDER, TOLERANCE)
            second = followed(mechanism, state, times, actuation, ORDER - 9, 100.0 * TOLERANCE)
        except InputError as error:
            limit = "errors are measured against one: give arithmetic and smooth functions"
            raise InputError(error.what, limit=limit) from None
        except (ArithmeticError, ValueError) as error:  # of torques; a singular matrix
            raise _lost(mechanism, f"is not defined: {error}") from None
    apart = float(np.abs(first - second).max())
    eps = float(np.finfo(float).eps)
    return Reference(first.astype(float), max(apart, eps))


def followed(
    mechanism: Mechanism,
    state: Array,
    times: Array,
    actuation: Actuation,
    order: int,
    tolerance: float,
) -> Long:
    """Return the states (T, 2n) at increasing `times` > 0, by one series in extended precision.

    `order` and `tolerance` (in units of rounding) choose its steps.  The loop is not that of
    `march.py`, which keeps time and state in double precision.
    """
    step = _Series(mechanism, actuation, order, tolerance)
    closing = _Closing(mechanism)
    y, t, rows = closing(LONG(0.0), state.astype(LONG)), LONG(0.0), []
    if actuation.listener is not None:
        actuation.listener.begin(y.tolist(), float(times[-1]))
    for end in times.astype(LONG):
        while t < end:
            stop = LONG(next_stop(actuation.stops, actuation.leaves, float(t), float(end)))
            stop = stop if stop > t else end
            taken = step(t, y, stop)
            if taken is None:
                raise _lost(mechanism, f"cannot be followed beyond t = {float(t):.6g} s")
            h, new = taken
            t = stop if t + h >= stop else t + h
            y = closing(t, new)
            reach(actuation, float(t), y)
        rows.append(y)
    return np.array(rows)


def _lost(mechanism: Mechanism, why: str) -> RobodynError:
    return RobodynError("the motion", where=mechanism.source, limit=why)


def _convolve(x: Long, y: Long, m: int, first: int, last: int) -> Any:
    """Return the sum of x_j y_{m-j} for j from first to last."""
    return np.dot(x[first : last + 1], y[m - last : m - first + 1][::-1])


LONGS = Arithmetic(
    cos=np.cos,
    sin=np.sin,
    power=lambda x, exponent: x ** LONG(exponent),
    functions={name: getattr(np, NUMPY.get(name, name)) for name in FLOATS.functions},
    convolve=_convolve,
    room=lambda orders: np.zeros(orders, LONG),
)


class _Series:
    """The series of a motion in extended precision, one program per state of torque switches."""

    def __init__(
        self, mechanism: Mechanism, actuation: Actuation, order: int, tolerance: float
    ) -> None:
        self.mechanism, self.actuation = mechanism, actuation
        self.order, self.tolerance = order, tolerance * float(np.finfo(LONG).eps)
        self.torques = actuation.function(mechanism.n)
        self.made: dict[tuple[float, ...] | None, MotionProgram] = {}
        MotionProgram(mechanism, actuation, False)  # every branch must have a series

    def __call__(self, t: Any, y: Long, stop: Any) -> tuple[Any, Long] | None:
        """Take a step from (t, y), at most to `stop`; return its length and the state after it.

        Returns None if no step succeeds.
        """
        held = None if self.actuation.pieces is None else self.actuation.pieces.at(float(t))
        if held not in self.made:
            self.made[held] = MotionProgram(self.mechanism, self.actuation, False, held)
        series, w = self.expanded(self.made[held], t, y, self.order)
        both, steady = (self.tolerance, self.tolerance), self.made[held].steady
        longest = longest_step(series, w, *both, slides=self.mechanism.slides, steady=steady)
        if not longest > SMALLEST_STEP:
            return None
        h = min(stop - t, LONG(longest))
        while h > SMALLEST_STEP:
            part = self.part(self.made[held], series, t, y, h)
            if part == 1.0:
                return h, _along(self.mechanism, series, y, h)[0]
            h = h * part
        return None

    def part(self, motion: MotionProgram, series: Coefficients, t: Any, y: Long, h: Any) -> Any:
        """Return 1 if the series holds from (t, y) over a step h, else the part of h to try next.

        No argument may stray.  At the places `SEEN` the accelerations of the series must be those
        of the state there, but for what rounding makes.
        """
        if not motion.checked:
            return 1.0
        part = strays(motion.spans, series.spanned, h)
        for x in (place * h for place in SEEN):
            there, bends, largest = _along(self.mechanism, series, y, x)
            try:
                beside, _ = self.expanded(motion, t + x, there, 1)
            except (ArithmeticError, ValueError):  # outside the domain
                return min(part, 0.5)
            exact = np.array([2.0 * theta[2] for theta in beside.theta])
            small = ROUNDING * np.abs(there[self.mechanism.n :]).max() / x
            if not (np.abs(bends - exact) <= AGREE * largest + small).all():
                return min(part, 0.5)
        return part

    def expanded(
        self, motion: MotionProgram, t: Any, y: Long, order: int
    ) -> tuple[Coefficients, list[Any]]:
        """Return the series at (t, y) up to an order, and the links' rates there."""
        given: tuple[Sequence[float], Sequence[float]] = ((), ())
        if self.actuation.constants is None and self.actuation.linear:
            floats = y.astype(float).tolist()
            given = linear_piece(self.actuation, self.torques, float(t), floats, 1.0)
        start = motion.state(LONGS, t, list(y), given)
        numbers = [LONG(x) for x in motion.program.numbers]
        return motion.expand(LONGS, numbers, order, start), list(start.w)


def _along(mechanism: Mechanism, series: Coefficients, y: Long, h: Any) -> tuple[Long, Long, Long]:
    """Return the state at time h after y, the start of the series, and its accelerations (n).

    The accelerations are those of links and slides; the third result (n) is their largest terms.
    """
    n, slides = mechanism.n, list(mechanism.slides)
    z = np.array(series.rho, LONG) + 1j * np.array(series.theta, LONG)
    orders = np.arange(z.shape[1]).astype(LONG)
    powers = h**orders
    turn = (z * powers).sum(axis=1)
    slope = (z[:, 1:] * (orders[1:] * powers[:-1])).sum(axis=1)
    way, rates = joint_ways(mechanism, y, turn, slope)
    seconds = z[:, 2:] * (orders[2:] * orders[1:-1] * powers[:-2])
    second = seconds.sum(axis=1)
    bends = (turn.conj() * second).imag / np.abs(turn) ** 2
    bends[slides] = second.imag[slides]
    return np.concatenate([y[:n] + way, rates]), bends, np.abs(seconds).max(axis=1)


class _Closing:
    """Projects a state onto the closures by Newton steps whose matrix is in double precision."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism, self.n = mechanism, mechanism.n
        given: Iterable[Any] = mechanism.arrays
        self.x = Arrays(*(x.astype(COMPLEX if np.iscomplexobj(x) else LONG) for x in given))

    def __call__(self, t: Any, y: Long) -> Long:
        if not len(self.x.P):
            return y
        n = self.n
        try:
            q = newton(y[:n], partial(self._step, t))
            inverse = self._inverse(t, q)
        except _TooNear:
            return y  # next to a change point: the two computations will tell
        at = placed_at(self.mechanism, self.x.J @ q)
        Psi = jacobian_at(self.mechanism, self.x, at, t) @ self.x.J * self.x.units
        rates, drift = y[n:] / self.x.units, drift_at(self.mechanism, at, t)
        for _ in range(PASSES):
            rates = rates - inverse @ (Psi @ rates + drift)
        return np.concatenate([q, rates * self.x.units])

    def _inverse(self, t: Any, q: Long) -> Array:
        """Return the pseudoinverse of Psi in double precision."""
        U, s, Vt = svd(scaled_jacobian(self.mechanism, q.astype(float), float(t)))
        if s[-1] < TOO_NEAR * loop_size(self.mechanism):
            raise _TooNear
        return np.asarray((Vt.T / s) @ U.T)

    def _step(self, t: Any, states: Long, _: Any) -> tuple[Any, Long]:
        """Return whether the single state (1, n) is closed, and its Newton step."""
        (q,) = states
        step: Long = self.x.units * (self._inverse(t, q) @ exact_gap(self.mechanism, q, t))
        closed = np.abs(step).max() < 10.0 * np.finfo(LONG).eps
        return np.array([closed]), step[None]


class _TooNear(Exception):
    """Psi is singular."""


Watch = Callable[[float], object]  # the part that is done

TOLERANCES = tuple(10.0**-k for k in range(3, 14))
TIMES = 20  # output times at which errors are measured
PATIENCE = 1.0  # s: a method whose run took longer is not asked for more digits
MAX_EVALUATIONS = 1_000_000


@dataclass(slots=True)
class Measurement:
    """Speed and error of one method at one tolerance."""

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
    """Measurements of all methods, and the reference with its uncertainty."""

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
    """Measure every method at every tolerance on the motion from `state` (2n,) to t_end > 0.

    Raises RobodynError if no reference can be computed, and InputError if a torque has no series.
    """
    times = np.linspace(0.0, t_end, TIMES + 1)[1:]
    exact = reference(mechanism, state, times, actuation)
    if not np.isfinite(exact.y).all():
        raise RobodynError("bench", where=mechanism.source, limit="the motion is not finite")
    watch(0.1)

    def timed(
        method: str, tolerance: float, at: Array = times
    ) -> tuple[float, Outcome, Report, Array]:
        rows: list[Array] = []
        settings = Settings(method, tolerance, tolerance, max_evaluations=MAX_EVALUATIONS)
        begun = time.perf_counter()
        outcome, record = run(
            mechanism, state, at[-1], actuation, settings, lambda t, y, _: rows.append(y), at
        )
        took = time.perf_counter() - begun
        report = record.settle()
        return took, outcome, report, np.concatenate(rows or [np.zeros((0, len(state)))])

    over = over_run(mechanism, actuation, state, t_end)
    methods, left_out = list(METHODS), list[str]()
    try:
        check_served(mechanism, over)
    except RobodynError as error:
        methods.remove("taylor")
        left_out.append(f"taylor: {error.limit if error.what == 'method' else error}")
    measurements: list[Measurement] = []
    for i, method in enumerate(methods):
        timed(method, Settings.rtol, times[-1:] / 1000)  # loads and makes what is no part of a run
        for tolerance in tolerances:
            if tolerance < Settings(method).smallest_rtol:
                continue
            took, outcome, report, y = timed(method, tolerance)
            measured = Measurement(
                method,
                tolerance,
                outcome.label,
                drift=report.energy_drift,
                gap=report.largest_gap,
                evaluations=report.evaluations,
                steps=report.steps,
            )
            measurements.append(measured)
            finished = outcome is Outcome.FINISHED
            if finished:
                off = np.maximum(np.abs(y - exact.y).max(axis=1), exact.uncertainty)
                measured.error, measured.error_end = float(off.max()), float(off[-1])
            if took > patience or not finished:
                if any(x < tolerance for x in tolerances):
                    why = measured.outcome if took <= patience else f"took {took:.2g} s"
                    left_out.append(f"{method} below {tolerance:g}: {why} there")
                break
        watch(0.1 + 0.4 * (i + 1) / len(methods))
    runs = [x for x in measurements if x.outcome == Outcome.FINISHED.label]
    for i in range(repeats):
        for each in runs:
            each.seconds.append(timed(each.method, each.tolerance)[0])
        watch(0.5 + 0.5 * (i + 1) / repeats)
    for each in runs:
        each.median, each.least = median(each.seconds), min(each.seconds)
    _mark_front(measurements, exact.uncertainty)
    return Benchmark(exact, measurements, left_out)


def _mark_front(measurements: list[Measurement], uncertainty: float) -> None:
    """Mark measurements with no other both faster and more accurate.

    Errors below the uncertainty count as equal.
    """
    best = np.inf
    finished = (x for x in measurements if x.outcome == Outcome.FINISHED.label)
    for each in sorted(finished, key=lambda x: (x.least, x.error)):
        if each.error < best:
            each.front, best = True, max(each.error, uncertainty)
