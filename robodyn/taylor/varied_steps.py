"""The tangents of steps of the Taylor series in Python, by numbers x + dx i.

With dx so small that its products vanish they go through a step as x does, and dx comes out as its
tangent: as straight-line text, or, where text would be long, by the rows of the program.  A call
of numpy costs what some tens of such numbers do, and has those of many steps, by all directions in
the state: where steps are many, the text has all of them at once, and what it finds is chained.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.placed import relative_matrix
from robodyn.engines import source_text, straightline
from robodyn.engines.arithmetic import Arithmetic, chosen
from robodyn.engines.expansion import MotionProgram, end_of_step
from robodyn.engines.formulas import RECORDED
from robodyn.engines.series import FLOATS
from robodyn.engines.tangents import SLOPES
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

SMALL = 1e-100  # of what stands before i
KEPT = 64  # texts
COMPARED = "{2} if ({0}).real < ({1}).real else {3}"  # numbers are x + dx i, and the x compare
# numbers that pass through numpy while one goes through Python; and that a call there costs besides
PER_NUMBER, CALL = 15, 300
BLOCK = 4096  # numbers, or rows, at once


class Group(NamedTuple):
    """Names whose rows have one shape: their places, a program, its numbers and their slopes."""

    places: list[int]
    motion: MotionProgram
    numbers: list[float]
    slopes: list[list[float]]

    @property
    def varied(self) -> list[int]:
        """The numbers that vary with any of the names."""
        return [i for i, each in enumerate(zip(*self.slopes, strict=True)) if any(each)]


# steps: begins (m,), ends (m,), states (m, 2n), times of rows (r,); torques and their slopes at the
# first begin, and what goes beside the torques (k, n); s (k, 2n) there: s at the ends (m, k, 2n),
# and at the rows (r, k, 2n)
Steps = tuple[Array, Array, Array, Array]
Along = Callable[[Steps, Any, Array], tuple[Array, Array]]


# of a step from t over x, at y (2n) and numbers with what goes beside them: the end (2n), or None
# where the series tells it, and rho and theta (2n, orders)
Expand = Callable[[Any, list[Any], list[Any], Any, Any], tuple[Any, Any]]


def _one_by_one(group: Group, varied: Sequence[int], expand: Expand) -> Along:
    """By steps of numbers x + dx i, a name after the other."""
    mechanism = group.motion.mechanism
    numbers = [
        [complex(group.numbers[i], SMALL * slopes[i]) for i in varied] for slopes in group.slopes
    ]

    def along(
        k: int, steps: Steps, torques: Any, beside: list[float], at_ends: Array, at_rows: Array
    ) -> None:
        begins, ends, states, times = steps
        direction = 1.0 if ends[-1] > begins[0] else -1.0
        row, first, last = 0, float(begins[0]), times.tolist()
        values, slopes, fed = torques
        values = [
            complex(x, SMALL * each) if each else x
            for x, each in zip(values, fed[k].tolist(), strict=True)
        ]
        now, rises = (values, slopes), any(slopes)
        each = zip(begins.tolist(), ends.tolist(), states.tolist(), strict=True)
        for j, (t, end, y) in enumerate(each):
            if rises:
                acting = [x + (t - first) * slope for x, slope in zip(values, slopes, strict=True)]
                now = acting, slopes
            there, series = expand(t, list(map(complex, y, beside)), numbers[k], now, end - t)
            due = row
            while due < len(last) and (last[due] - end) * direction <= 0.0:
                due += 1
            if due > row or there is None:
                x = np.append(times[row:due], end) - t
                moved = _moved(mechanism, np.array(series, complex), np.array(beside), x)
                at_rows[row:due], row = moved[:-1], due
            beside = moved[-1].tolist() if there is None else [x.imag for x in there]
            at_ends[j] = beside

    def go(steps: Steps, torques: Any, s: Array) -> tuple[Array, Array]:
        at_ends, at_rows = (np.empty((len(steps[i]), *s.shape)) for i in (1, 3))
        for k, beside in enumerate((SMALL * s).tolist()):
            along(k, steps, torques, beside, at_ends[:, k], at_rows[:, k])
        return at_ends / SMALL, at_rows / SMALL

    return go


def _moved(mechanism: Mechanism, series: NDArray[Any], s: Array, x: Array) -> Array:
    """What goes beside q and qd (r, 2n) at x (r,) after the start, s (2n), by the series.

    One for all, (2n, orders), or one each, (r, 2n, orders) with s (r, 2n).
    """
    n = mechanism.n
    orders = np.arange(series.shape[-1])
    powers = x[:, None] ** orders
    slopes = (powers[:, :-1] * orders[1:])[:, None]
    powers = powers[:, None]
    rho, theta = np.split(series.reshape(-1, *series.shape[-2:]).swapaxes(-1, -2), 2, axis=-1)
    z, dz = rho.real + 1j * theta.real, rho.imag + 1j * theta.imag
    a, da = ((powers @ each)[:, 0] for each in (z, dz))
    b, db = ((slopes @ each[:, 1:])[:, 0] for each in (z, dz))
    square = np.abs(a) ** 2
    w = (a.conj() * b).imag / square
    way = (a.conj() * da).imag / square
    rate = ((da.conj() * b + a.conj() * db).imag - 2.0 * w * (a.conj() * da).real) / square
    for k in mechanism.slides:
        way[:, k], rate[:, k] = da[:, k].imag - s[..., k], db[:, k].imag
    turned = relative_matrix(mechanism).T
    return np.concatenate([s[..., :n] + way @ turned, rate @ turned], axis=-1)


def _side_by_side(group: Group, varied: Sequence[int], expand: Expand) -> Along:
    """All steps at once: their tangents by each of q and qd, and by what each name changes."""
    mechanism, wide, count = group.motion.mechanism, 2 * group.motion.mechanism.n, len(group.slopes)
    every = wide + count
    unit = SMALL * 1j * np.eye(every)[:, None]  # each (1, directions)
    numbers = [
        group.numbers[i] + sum(x[i] * unit[wide + k] for k, x in enumerate(group.slopes))
        for i in varied
    ]

    def tangents(values: Sequence[Any], steps: int) -> NDArray[Any]:
        return np.stack([np.broadcast_to(x, (steps, every)) for x in values], axis=1)

    def some(steps: Steps, torques: Any, s: Array, first: float) -> tuple[Array, Array]:
        begins, ends, states, times = steps
        t, x = begins[:, None], (ends - begins)[:, None]
        y = [states[:, i, None] + unit[i] for i in range(wide)]
        values, slopes, fed = torques
        acting = [v + (t - first) * d for v, d in zip(values, slopes, strict=True)]
        acting = [v + fed[:, j] @ unit[wide:, 0] for j, v in enumerate(acting)]
        found, series = expand(t, y, numbers, (acting, slopes), x)
        J = tangents(found, len(t)).imag.swapaxes(1, 2) / SMALL  # (m, directions, 2n)
        A, P = J[:, :wide], J[:, wide:]
        before = np.empty((len(t) + 1, *s.shape))
        before[0] = s
        for j in range(len(t)):
            before[j + 1] = before[j] @ A[j] + P[j]
        at_rows = np.empty((len(times), *s.shape))
        if len(times):
            way = 1.0 if ends[-1] > begins[0] else -1.0
            terms = np.stack([tangents(each, len(t)) for each in series], axis=1)
            ways = np.zeros((len(t), every, count))  # each name's in the directions
            ways[:, :wide], ways[:, wide:] = before[:-1].swapaxes(1, 2), np.eye(count)
            moved = terms[..., :1].real + 1j * (terms.imag @ ways[:, None])
        for i in range(0, len(times), BLOCK):
            due = times[i : i + BLOCK]
            place = np.searchsorted(way * ends, way * due)
            for k in range(count):
                beside, past = SMALL * before[place, k], due - begins[place]
                at_rows[i : i + BLOCK, k] = _moved(mechanism, moved[place, ..., k], beside, past)
        return before[1:], at_rows / SMALL

    def go(steps: Steps, torques: Any, s: Array) -> tuple[Array, Array]:
        begins, ends, states, times = steps
        way, most = 1.0 if ends[-1] > begins[0] else -1.0, max(1, BLOCK // every)
        at_ends, at_rows, row = [], [], 0
        for i in range(0, len(ends), most):
            part = slice(i, i + most)
            due = row + int(np.searchsorted(way * times[row:], way * ends[part][-1], "right"))
            only = begins[part], ends[part], states[part], times[row:due]
            found = some(only, torques, s, float(begins[0]))
            s, row = found[0][-1], due
            at_ends.append(found[0])
            at_rows.append(found[1])
        return np.concatenate(at_ends), np.concatenate(at_rows)

    return go


def straight_steps(order: int, group: Group) -> Along:
    """As text, which is kept for runs to come."""
    varied, motion = group.varied, group.motion
    actuation = motion.actuation
    steady = tuple(0.0 if i in varied else x for i, x in enumerate(group.numbers))
    given = motion.mechanism, actuation.constants, actuation.lines, order, motion.held
    key = given, tuple(varied), steady, motion.program.shape
    if key not in _texts:
        while len(_texts) >= KEPT:
            _texts.pop(next(iter(_texts)))
        _texts[key] = _text(order, group)
    one, every = _texts[key]
    singly = _one_by_one(group, varied, one)
    if every is None:
        return singly
    at_once = _side_by_side(group, varied, every)
    names = len(group.slopes)
    saved = (PER_NUMBER - 1) * names - 2 * group.motion.mechanism.n  # by each step

    def go(steps: Steps, torques: Any, s: Array) -> tuple[Array, Array]:
        return (at_once if saved * len(steps[0]) > CALL else singly)(steps, torques, s)

    return go


_texts: dict[object, tuple[Expand, Expand | None]] = {}


def _text(order: int, group: Group) -> tuple[Expand, Expand | None]:
    """Of one number each, and of arrays, where numpy has all functions in it."""
    motion, start = group.motion, group.motion.start()
    mechanism, actuation, n = motion.mechanism, motion.actuation, motion.mechanism.n
    variable, numbers = start.graph.variable, list(start.numbers)
    for i in group.varied:
        numbers[i] = variable(f"c{i}")
    found = motion.expand(RECORDED, numbers, order, start.state)
    ends = end_of_step(mechanism, found, (), False, variable)
    series = [*found.rho, *found.theta]
    every = [*ends, *(x for each in series for x in each)]
    lines, shown = source_text.float_source(every, conditional=COMPARED)
    bounds = [2 * n, *accumulate((len(each) for each in series), initial=2 * n)][1:]
    tuples = [f"({', '.join(shown[a:b])},)" for a, b in pairwise(bounds)]
    body = [f"{', '.join(f'{name}{j}' for name in ('q', 'qd') for j in range(n))}, = y"]
    body += [f"{''.join(f'c{i}, ' for i in group.varied)}= c"] if group.varied else []
    if actuation.constants is None and actuation.linear:
        names = (", ".join(f"{x}{j}" for j in range(n)) for x in ("tau", "dtau"))
        body.append(f"({next(names)},), ({next(names)},) = torques")
    result = f"return ({', '.join(shown[: 2 * n])},), ({', '.join(tuples)},)"
    text = "\n    ".join([*body, *lines, result])
    scope = {**BESIDE.functions, "pow": _power, "atan2": _arctangent}
    code = f"def vary(t, y, c, torques, x):\n    {text}\n"
    function = straightline.define(code, "vary", scope=scope)
    if scope.keys() & set(function.__code__.co_names) - ARRAYS.keys():
        return function, None
    return function, straightline.define(code, "vary", scope=ARRAYS)


def row_steps(order: int, group: Group) -> Along:
    """By the rows."""
    motion = group.motion

    def expand(
        t: float, y: list[complex], numbers: list[complex], torques: Any, x: float
    ) -> tuple[Any, Any]:
        start = motion.state(BESIDE, t, y, torques)
        series = motion.expand(BESIDE, numbers, order, start)
        return None, [*series.rho, *series.theta]

    return _one_by_one(group, range(len(group.numbers)), expand)


def _beside(name: str, function: Callable[[float], float]) -> Callable[[Any], Any]:
    """A function of x + dx i, as if dx^2 were zero."""

    def of(x: Any) -> Any:
        if type(x) is not complex:
            return function(x)
        value = function(x.real)
        slope: Any = SLOPES[name](x.real, value)
        return complex(value, slope * x.imag)

    return of


def _power(x: Any, exponent: float) -> Any:
    if type(x) is not complex:
        return math.pow(x, exponent)
    slope = exponent * math.pow(x.real, exponent - 1.0)
    return complex(math.pow(x.real, exponent), slope * x.imag)


def _arctangent(y: Any, x: Any) -> complex:
    return complex(math.atan2(y.real, x.real), _turn(y, x))


def _turn(y: Any, x: Any) -> Any:
    return (y.imag * x.real - y.real * x.imag) / (x.real**2 + y.real**2)


# of arrays of such numbers
ARRAYS: dict[str, Any] = {
    name: getattr(np, name) for name in ("cos", "sin", "exp", "tanh", "sinh", "cosh", "sqrt")
} | {
    "atan2": lambda y, x: np.arctan2(y.real, x.real) + 1j * _turn(y, x),
    "pow": lambda x, e: x.real**e + 1j * (e * x.real ** (e - 1.0) * x.imag),
}


_FUNCTIONS = FLOATS.functions | {"tan": math.tan, "sqrt": math.sqrt, "abs": abs}
BESIDE = Arithmetic(
    cos=cmath.cos,
    sin=cmath.sin,
    power=_power,
    functions={name: _beside(name, function) for name, function in _FUNCTIONS.items()}
    | {"cos": cmath.cos, "sin": cmath.sin},
    chosen=lambda x, knots, values: chosen(x.real, knots, values),
)
