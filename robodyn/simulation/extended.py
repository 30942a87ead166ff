"""Motions in extended precision: what errors are measured against.

Two computations of the program's rows run in numpy's longdouble (64 bits of mantissa where the
platform has them): Taylor series of two orders and steps, or, of torques without a series, two
extrapolations of the midpoint rule.  What the two differ by is the uncertainty of the reference: no
error below it can be claimed.  Rounding of the constants themselves, which every run shares, is no
part of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.closed_form import jacobian_at, scaled_jacobian
from robodyn.dynamics.placed import joint_ways, placed_at, relative_matrix
from robodyn.engines.expansion import Coefficients, MotionProgram, longest_step
from robodyn.engines.series import FLOATS, Arithmetic
from robodyn.engines.singular_values import svd
from robodyn.engines.strays import strays
from robodyn.errors import InputError, RobodynError
from robodyn.loops.closing import exact_gap, loop_size, newton
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import next_stop
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.planar_model import Arrays
from robodyn.mechanics.torque_rows import linear_piece
from robodyn.mechanics.torque_times import over_a_scene_run
from robodyn.tables.arrays import Array
from robodyn.taylor.run import reach

Long = NDArray[Any]  # longdouble

LONG, COMPLEX = np.longdouble, np.clongdouble
NUMPY = {"atan": "arctan", "asin": "arcsin", "acos": "arccos"}  # what numpy calls them
ORDER = 30
TOLERANCE = 0.1  # of the series, in units of rounding
SUBSTEPS = (2, 4, 6, 8, 10, 12, 14, 16)  # of the extrapolated midpoint rule
EXTRAPOLATED = 100.0  # what a step of it may miss, in units of rounding
SMALLEST_STEP = 1e-12  # s
LARGEST_STEP = 0.25  # s, of the extrapolation
ROUNDING = 100.0 * float(np.finfo(np.longdouble).eps)  # part of a rate
AGREE = 1e-9  # part of a torque's terms by which its series may miss it, where it does not bend
TOO_NEAR = 1e-8  # s/L below which nothing is closed
PASSES = 4  # of rates, each of which leaves a part of 1e-8 at most


class Reference(NamedTuple):
    """States (T, 2n) at the times asked for, and what two computations of them differ by."""

    y: Array
    uncertainty: float


def reference(mechanism: Mechanism, state: Array, times: Array, actuation: Actuation) -> Reference:
    """The motion from `state` (2n,) at t = 0, at increasing `times` > 0.

    Raises RobodynError where the motion cannot be followed.
    """
    if mechanism.switches:
        raise _lost(mechanism, "has joints that stick or end: the reference is of smooth motions")
    if actuation.states:
        raise _lost(mechanism, "has a controller that integrates: the reference is of q and qd")
    actuation = over_a_scene_run(mechanism, actuation, state.tolist(), float(times[-1]))
    with np.errstate(all="ignore"):
        try:
            first, second = _by_two(_Task(mechanism, state, times, actuation))
        except (ArithmeticError, ValueError) as error:  # of torques; a singular matrix
            raise _lost(mechanism, f"is not defined: {error}") from None
    apart = float(np.abs(first - second).max())
    eps = float(np.finfo(float).eps)
    return Reference(first.astype(float), max(apart, eps))


class _Task(NamedTuple):
    """See `reference`."""

    mechanism: Mechanism
    state: Array
    times: Array
    actuation: Actuation


def _by_two(task: _Task) -> tuple[Long, Long]:
    try:
        both: list[_Series | _Extrapolation] = [
            _Series(task, ORDER, TOLERANCE),
            _Series(task, ORDER - 9, 100.0 * TOLERANCE),
        ]
    except InputError:  # a torque without a series
        fewer = _Extrapolation(task, SUBSTEPS[:-1], 10.0 * EXTRAPOLATED)
        both = [_Extrapolation(task, SUBSTEPS, EXTRAPOLATED), fewer]
    first, second = (_followed(task, each) for each in both)
    return first, second


def _followed(task: _Task, step: Callable[[Any, Long, Any], tuple[Any, Long] | None]) -> Long:
    """The states at the times asked for; `step` from t and y at most to `stop` tells how far, and
    the new state, or 0 to be asked again, or nothing where it cannot go on.
    """
    mechanism, state, times, actuation = task
    closing = _Closing(mechanism)
    y, t, rows = closing(state.astype(LONG)), LONG(0.0), []
    if actuation.told is not None:
        actuation.told.begin(y.tolist(), float(times[-1]))
    for end in times.astype(LONG):
        while t < end:
            stop = LONG(next_stop(actuation.kinks, actuation.leaves, float(t), float(end)))
            stop = min(end, stop) if stop > t else end
            taken = step(t, y, stop)
            if taken is None:
                raise _lost(mechanism, f"cannot be followed beyond t = {float(t):.6g} s")
            h, new = taken
            if h:
                y = closing(new)
                t = stop if t + h >= stop else t + h
                reach(actuation, float(t), y)
        rows.append(y)
    return np.array(rows)


def _lost(mechanism: Mechanism, why: str) -> RobodynError:
    return RobodynError("the motion", where=mechanism.source, limit=why)


def _convolve(x: Long, y: Long, m: int, first: int, last: int) -> Any:
    """Sum of x_j y_{m-j} for j from first to last."""
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
    """The series of a motion in extended precision, by how the switches of its torques stand."""

    def __init__(self, task: _Task, order: int, tolerance: float) -> None:
        mechanism, _, _, actuation = task
        self.mechanism, self.actuation = mechanism, actuation
        self.order, self.tolerance = order, tolerance * float(np.finfo(LONG).eps)
        self.torques = actuation.function(mechanism.n)
        self.made: dict[tuple[float, ...] | None, MotionProgram] = {}
        MotionProgram(mechanism, actuation, False)  # every branch must have a series
        self.lightest = min(mechanism.inertias.values())

    def __call__(self, t: Any, y: Long, stop: Any) -> tuple[Any, Long] | None:
        """See `_followed`."""
        held = None if self.actuation.pieces is None else self.actuation.pieces.at(float(t))
        if held not in self.made:
            self.made[held] = MotionProgram(self.mechanism, self.actuation, False, held)
        series, w, arms = self.expanded(self.made[held], t, y, self.order)
        both, steady = (self.tolerance, self.tolerance), self.made[held].steady
        longest = longest_step(series, w, *both, slides=self.mechanism.slides, steady=steady)
        if not longest > SMALLEST_STEP:
            return None
        h = min(stop - t, LONG(longest))
        while h > SMALLEST_STEP:
            new = _along(self.mechanism, series, y, h)
            if not arms or self.agrees(series, held, h, t + h, new):
                return h, new
            h = h / 2
        return None

    def expanded(
        self, motion: MotionProgram, t: Any, y: Long, order: int
    ) -> tuple[Coefficients, list[Any], list[float]]:
        given: tuple[Sequence[float], Sequence[float]] = ((), ())
        if self.actuation.constants is None and self.actuation.linear:
            floats = y.astype(float).tolist()
            given = linear_piece(self.actuation, self.torques, float(t), floats, 1.0)
        start = motion.state(LONGS, t, list(y), given)
        numbers = [LONG(x) for x in motion.program.numbers]
        return motion.expand(LONGS, numbers, order, start), list(start.w), motion.arms

    def agrees(self, series: Coefficients, held: Any, x: Any, t: Any, y: Long) -> bool:
        """Whether what may bend, x after the series began, is at t and y what the series say.

        A difference that changes no rate by more than its rounding counts as none; and nothing
        strays on the way.
        """
        try:
            found, _, arms = self.expanded(self.made[held], t, y, 1)
        except (ArithmeticError, ValueError):  # outside the domain
            return False
        rates = y[self.mechanism.n : 2 * self.mechanism.n]
        small = ROUNDING * np.abs(rates).max() * self.lightest / x  # N m
        if strays(self.made[held].spans, arms, series.spanned, x, small, AGREE) > 0.0:
            return False
        for each, known, arm in zip(series.watched, found.watched, arms, strict=True):
            terms = np.array(each) * x ** np.arange(len(each))
            if not abs(terms.sum() - known[0]) <= AGREE * np.abs(terms).max() + small / arm:
                return False
        return True


def _along(mechanism: Mechanism, series: Coefficients, y: Long, h: Any) -> Long:
    """The state at h after y, where the series begin."""
    n = mechanism.n
    z = np.array(series.rho, LONG) + 1j * np.array(series.theta, LONG)
    orders = np.arange(z.shape[1]).astype(LONG)
    powers = h**orders
    turn = (z * powers).sum(axis=1)
    slope = (z[:, 1:] * (orders[1:] * powers[:-1])).sum(axis=1)
    way, rates = joint_ways(mechanism, y, turn, slope)
    return np.concatenate([y[:n] + way, rates])


class _Extrapolation:
    """Steps of the midpoint rule, each as long as the error of the one before allows."""

    def __init__(self, task: _Task, substeps: Sequence[int], tolerance: float) -> None:
        self.rates = _rates(task.mechanism, task.actuation)
        self.substeps, self.tolerance = substeps, tolerance * float(np.finfo(LONG).eps)
        self.h = LONG(LARGEST_STEP / 8)

    def __call__(self, t: Any, y: Long, stop: Any) -> tuple[Any, Long] | None:
        """See `_followed`."""
        step = min(self.h, stop - t)
        new, error = _extrapolated(self.rates, t, y, step, self.substeps)
        scale = self.tolerance * (1.0 + float(np.abs(y).max()))
        factor = 0.9 * (scale / max(error, 1e-25)) ** (1.0 / (2 * len(self.substeps) - 1))
        least = step <= SMALLEST_STEP  # where a torque jumps or bends, no step is small enough
        if error <= scale or (least and np.isfinite(error)):
            # a step that was cut says nothing against longer ones
            longer = max(float(step) * min(2.0, factor), float(self.h) if step < self.h else 0.0)
            self.h = LONG(min(LARGEST_STEP, max(longer, SMALLEST_STEP)))
            return step, new
        self.h = LONG(max(SMALLEST_STEP, float(step) * max(0.3, factor)))
        return None if least else (LONG(0.0), y)


def _extrapolated(
    rates: Any, t: Any, y: Long, step: Any, substeps: Sequence[int]
) -> tuple[Long, float]:
    """Gragg's midpoint rule with more and more substeps, extrapolated to none; its error."""
    table: list[Long] = []
    for k, count in enumerate(substeps):
        h = step / count
        before, now = y, y + h * rates(t, y)
        for i in range(1, count):
            before, now = now, before + 2 * h * rates(t + i * h, now)
        row = [(before + now + h * rates(t + step, now)) / 2]
        for j in range(1, k + 1):
            ratio = LONG(count) / substeps[k - j]
            row.append(row[-1] + (row[-1] - table[j - 1]) / (ratio * ratio - 1))
        table = row
    return table[-1], float(np.abs(table[-1] - table[-2]).max())


def _rates(mechanism: Mechanism, actuation: Actuation) -> Callable[[Any, Long], Long]:
    """dy/dt by the first orders of the series, the torques held."""
    n, torques = mechanism.n, actuation.function(mechanism.n)
    motion = MotionProgram(mechanism, Actuation(None, linear=True), False)
    numbers, relative = [LONG(x) for x in motion.program.numbers], relative_matrix(mechanism)

    def rates(t: Any, y: Long) -> Long:
        try:
            tau = [LONG(x) for x in torques(float(t), y.astype(float).tolist())]
        except (ArithmeticError, ValueError):  # outside the domain: a shorter step may not leave it
            return np.full(2 * n, LONG(np.nan))
        start = motion.state(LONGS, t, list(y), (tau, [0.0] * n))
        theta = motion.expand(LONGS, numbers, 1, start).theta
        return np.concatenate([y[n:], relative @ np.array([2 * each[2] for each in theta])])

    return rates


def _constants(mechanism: Mechanism) -> Any:
    """The arrays of the mechanism in extended precision."""
    given: Iterable[Any] = mechanism.arrays
    return Arrays(*(x.astype(COMPLEX if np.iscomplexobj(x) else LONG) for x in given))


class _Closing:
    """The nearest closed state, by Newton steps: what a step in floats leaves, the next removes."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism, self.n, self.x = mechanism, mechanism.n, _constants(mechanism)

    def __call__(self, y: Long) -> Long:
        if not len(self.x.P):
            return y
        n = self.n
        try:
            q = newton(y[:n], self._step)
            inverse = self._inverse(q)
        except _TooNear:
            return y  # next to a change point: the two computations will tell
        at = placed_at(self.mechanism, self.x.J @ q)
        Psi = jacobian_at(self.mechanism, self.x, at) @ self.x.J * self.x.units
        rates = y[n:] / self.x.units
        for _ in range(PASSES):
            rates = rates - inverse @ (Psi @ rates)
        return np.concatenate([q, rates * self.x.units])

    def _inverse(self, q: Long) -> Array:
        """That of Psi, in floats."""
        U, s, Vt = svd(scaled_jacobian(self.mechanism, q.astype(float)))
        if s[-1] < TOO_NEAR * loop_size(self.mechanism):
            raise _TooNear
        return np.asarray((Vt.T / s) @ U.T)

    def _step(self, q: Long) -> tuple[bool, Long]:
        gap = exact_gap(self.mechanism, q)
        step: Long = self.x.units * (self._inverse(q) @ gap)
        return bool(np.abs(step).max() < 10.0 * np.finfo(LONG).eps), step


class _TooNear(Exception):
    """Psi is singular."""
