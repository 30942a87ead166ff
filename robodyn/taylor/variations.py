"""Sensitivities along the steps of the Taylor series: the series of the variational equations.

A step's series are functions of the state that it begins in, and of the numbers of the scene.
Their tangents by these are the series of d(q, qd)/dp, by the same recurrences.  The motion comes
first, and its steps are those of a run without them; then each step is gone once more, with its
tangents: as straight-line text, in machine code, or, where text would be long, by the rows on
numbers x + dx i with dx so small that its products vanish.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from functools import partial
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
from robodyn.errors import RobodynError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.program import Program
from robodyn.mechanics.torque_rows import linear_piece
from robodyn.taylor import Chunk, default_order

Array = NDArray[np.float64]

SMALL = 1e-100  # of what stands before i
TOGETHER = 4  # names in one text


class Number(NamedTuple):
    """What a motion is differentiated by: the mechanism with that number as a formula.

    `numbers` gives what its rows take, and their slopes by it.
    """

    mechanism: Mechanism
    numbers: Callable[[Program], tuple[list[float], list[float]]]


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
# first begin; s (k, 2n) there: s at the ends (m, k, 2n) and at the rows (r, k, 2n)
Steps = tuple[Array, Array, Array, Array]
Along = Callable[[Steps, Any, Array], tuple[Array, Array]]


class Variations:
    """d(q, qd)/d(names) along the steps of one run, under torques that have a series.

    s (k, 2n) are those where the last steps ended.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        actuation: Actuation,
        order: int,
        numbers: Sequence[Number],
        s: Array,
    ) -> None:
        self.mechanism, self.actuation, self.order = mechanism, actuation, order
        self.numbers, self.s = numbers, s
        self._torques = actuation.function(mechanism.n)
        self._made: dict[object, Any] = {}

    def along(
        self, t: float, y: Array, chunk: Chunk, kind: str, within: Callable[[Array], Array]
    ) -> tuple[Chunk, Callable[[Array], Array]]:
        """The chunk from (t, y) with s in its states, and what has so `within` its last step.

        `kind` is the name of the engine that made it.
        """
        if not len(chunk.t):
            return chunk, within
        n = self.mechanism.n
        begins = np.append(t, chunk.t[:-1])
        states = np.concatenate([y[None], chunk.y[:-1]])[:, : 2 * n]
        direction = 1.0 if chunk.t[-1] > t else -1.0
        torques: Any = ((), ())
        if self.actuation.constants is None and self.actuation.linear:
            torques = linear_piece(self.actuation, self._torques, t, y.tolist(), direction)
        held = None if self.actuation.pieces is None else self.actuation.pieces.at(t)
        if ("groups", held) not in self._made:
            self._made["groups", held] = self._groups(held)
        s = self.s.copy()
        at_ends = np.empty((len(chunk.t), *s.shape))
        at_rows = np.empty((len(chunk.row_t), *s.shape))
        last: list[Callable[[Array], Array]] = []
        steps = begins, chunk.t, states, chunk.row_t
        for i, group in enumerate(self._made["groups", held]):
            key = i, held, kind
            if key not in self._made:
                make = MAKERS.get(kind, _compiled)
                self._made[key] = make(self.mechanism, self.actuation, self.order, group, held)
            go = self._made[key]
            where = group.places
            at_ends[:, where], at_rows[:, where] = go(steps, torques, s[where])
            before = s[where] if len(chunk.t) == 1 else at_ends[-2, where]
            only = tuple(x[-1:] for x in steps[:3])

            last.append(partial(self._last, go, only, torques, before))
        self.s = at_ends[-1]
        if not np.isfinite(self.s).all():
            raise RobodynError(
                "sensitivity", value=f"at t = {chunk.t[-1]:.6g} s", limit="not finite"
            )

        def both(times: Array) -> Array:
            found = np.empty((len(times), *s.shape))
            for group, each in zip(self._made["groups", held], last, strict=True):
                found[:, group.places] = each(times)
            return self.joined(within(times), found)

        y, rows = self.joined(chunk.y, at_ends), self.joined(chunk.row_y, at_rows)
        return chunk._replace(y=y, row_y=rows), both

    def _last(self, go: Along, step: Any, torques: Any, s: Array, times: Array) -> Array:
        return go((*step, times), torques, s)[1]

    def joined(self, y: Array, s: Array) -> Array:
        """States (m, 2n or 2n + 1) with s (m, k, 2n) before the work done."""
        middle = 2 * self.mechanism.n
        return np.concatenate(
            [y[:, :middle], s.reshape(len(y), self.s.size), y[:, middle:]], axis=1
        )

    def _groups(self, held: Sequence[float] | None) -> list[Group]:
        found: dict[object, Group] = {}
        for place, (mechanism, numbers) in enumerate(self.numbers):
            motion = MotionProgram(mechanism, self.actuation, False, held)
            values, slopes = numbers(motion.program)
            motion.mechanism, motion.program.numbers = self.mechanism, values
            motion.program.arms = dict.fromkeys(motion.program.arms, 1.0)  # no step is chosen
            key = motion.program.shape, tuple(values)
            group = found.setdefault(key, Group([], motion, values, []))
            group.places.append(place)
            group.slopes.append(slopes)
        return [
            Group(x.places[i : i + TOGETHER], x.motion, x.numbers, x.slopes[i : i + TOGETHER])
            for x in found.values()
            for i in range(0, len(x.places), TOGETHER)
        ]


def variations_of(
    mechanism: Mechanism, actuation: Actuation, y: Array, tolerance: float, order: int | None
) -> tuple[Variations, Array]:
    """Those that torques carry in the state y, and the state without them."""
    assert actuation.alone is not None
    first, last = 2 * mechanism.n, 2 * mechanism.n + actuation.states
    s = y[first:last].reshape(-1, first).copy()
    order = order or default_order(tolerance)
    found = Variations(mechanism, actuation.alone, order, actuation.by, s)
    return found, np.concatenate([y[:first], y[last:]])


# of a step from t over x, at y (2n) and numbers with what goes beside them: the end (2n), or None
# where the series tells it, and rho and theta (2n, orders)
Expand = Callable[[float, list[complex], list[complex], Any, float], tuple[Any, Any]]


def _one_by_one(mechanism: Mechanism, group: Group, varied: Sequence[int], expand: Expand) -> Along:
    """By steps of numbers x + dx i, a name after the other."""
    n = mechanism.n
    numbers = [
        [complex(group.numbers[i], SMALL * slopes[i]) for i in varied] for slopes in group.slopes
    ]

    def along(steps: Steps, torques: Any, s: Array, numbers: list[complex]) -> tuple[Any, Any]:
        begins, ends, states, times = steps
        direction = 1.0 if ends[-1] > begins[0] else -1.0
        at_ends: list[list[float]] = []
        at_rows = [np.zeros((0, 2 * n))]
        row, first, last = 0, float(begins[0]), times.tolist()
        beside = (SMALL * s).tolist()
        for t, end, y in zip(begins.tolist(), ends.tolist(), states.tolist(), strict=True):
            now = [x + (t - first) * slope for x, slope in zip(*torques, strict=True)], torques[1]
            there, series = expand(t, list(map(complex, y, beside)), numbers, now, end - t)
            due = row
            while due < len(last) and (last[due] - end) * direction <= 0.0:
                due += 1
            if due > row or there is None:
                x = np.append(times[row:due], end) - t
                found = _moved(mechanism, np.array(series, complex), np.array(beside), x)
                at_rows.append(found[:-1])
                row = due
            beside = found[-1].tolist() if there is None else [x.imag for x in there]
            at_ends.append(beside)
        return np.array(at_ends) / SMALL, np.concatenate(at_rows) / SMALL

    def go(steps: Steps, torques: Any, s: Array) -> tuple[Array, Array]:
        pairs = zip(s, numbers, strict=True)
        found = zip(*(along(steps, torques, *pair) for pair in pairs), strict=True)
        at_ends, at_rows = (np.stack(each, axis=1) for each in found)
        return at_ends, at_rows

    return go


def _moved(mechanism: Mechanism, series: NDArray[Any], s: Array, x: Array) -> Array:
    """What goes beside q and qd (r, 2n) at x (r,) after the start, s (2n), by the series."""
    n = mechanism.n
    rho, theta = series.reshape(2, n, -1).swapaxes(-1, -2)
    orders = np.arange(len(rho))
    powers = x[:, None] ** orders
    slopes = powers[:, :-1] * orders[1:]
    z, dz = rho.real + 1j * theta.real, rho.imag + 1j * theta.imag
    (a, b), (da, db) = ((powers @ each, slopes @ each[1:]) for each in (z, dz))
    square = np.abs(a) ** 2
    w = (a.conj() * b).imag / square
    way = (a.conj() * da).imag / square
    rate = ((da.conj() * b + a.conj() * db).imag - 2.0 * w * (a.conj() * da).real) / square
    for k in mechanism.slides:
        way[:, k], rate[:, k] = da[:, k].imag - s[k], db[:, k].imag
    turned = relative_matrix(mechanism).T
    return np.concatenate([s[:n] + way @ turned, rate @ turned], axis=-1)


def _straight(
    mechanism: Mechanism,
    actuation: Actuation,
    order: int,
    group: Group,
    held: Sequence[float] | None,
) -> Along:
    """As text, which is kept for runs to come."""
    varied = group.varied
    steady = tuple(0.0 if i in varied else x for i, x in enumerate(group.numbers))
    given = mechanism, actuation.constants, actuation.lines, order, held
    key = given, tuple(varied), steady, group.motion.program.shape
    if key not in _texts:
        while len(_texts) >= KEPT:
            _texts.pop(next(iter(_texts)))
        _texts[key] = _text(mechanism, actuation, order, group)
    return _one_by_one(mechanism, group, varied, _texts[key])


KEPT = 64
_texts: dict[object, Expand] = {}


def _text(mechanism: Mechanism, actuation: Actuation, order: int, group: Group) -> Expand:
    n, motion, start = mechanism.n, group.motion, group.motion.start()
    variable, numbers = start.graph.variable, list(start.numbers)
    for i in group.varied:
        numbers[i] = variable(f"c{i}")
    found = motion.expand(RECORDED, numbers, order, start.state)
    ends = end_of_step(mechanism, found, (), False, variable)
    series = [*found.rho, *found.theta]
    every = [*ends, *(x for each in series for x in each)]
    lines, shown = source_text.float_source(every, beside=True)
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
    function: Expand = straightline.define(code, "vary", scope=scope)
    return function


def _rows(
    mechanism: Mechanism,
    actuation: Actuation,
    order: int,
    group: Group,
    held: Sequence[float] | None,
) -> Along:
    """By the rows."""
    motion = group.motion

    def expand(
        t: float, y: list[complex], numbers: list[complex], torques: Any, x: float
    ) -> tuple[Any, Any]:
        start = motion.state(BESIDE, t, y, torques)
        series = motion.expand(BESIDE, numbers, order, start)
        return None, [*series.rho, *series.theta]

    return _one_by_one(mechanism, group, range(len(group.numbers)), expand)


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
    beside = (y.imag * x.real - y.real * x.imag) / (x.real**2 + y.real**2)
    return complex(math.atan2(y.real, x.real), beside)


_FUNCTIONS = FLOATS.functions | {"tan": math.tan, "sqrt": math.sqrt, "abs": abs}
BESIDE = Arithmetic(
    cos=cmath.cos,
    sin=cmath.sin,
    power=_power,
    functions={name: _beside(name, function) for name, function in _FUNCTIONS.items()}
    | {"cos": cmath.cos, "sin": cmath.sin},
    chosen=lambda x, knots, values: chosen(x.real, knots, values),
)


def _compiled(
    mechanism: Mechanism,
    actuation: Actuation,
    order: int,
    group: Group,
    held: Sequence[float] | None,
) -> Along:
    """In machine code, a name in each lane; as text where there is none."""
    from robodyn.engines.machine_motion import aligned
    from robodyn.engines.machine_variation import TABLE, VariedScene, compile

    lanes = 1 if len(group.places) == 1 else 2 if len(group.places) == 2 else TOGETHER
    scene = VariedScene(mechanism, actuation, order, group.motion, group.varied, held)
    code = compile(scene, lanes)
    if code is None:
        return _straight(mechanism, actuation, order, group, held)
    block = aligned(code.items * lanes)
    items = block.reshape(-1, lanes)
    scene.fill(items, 1.0, 1.0)
    place, n, count = scene.place, mechanism.n, len(group.places)
    for i in group.varied:
        items[place[f"dc{i}"], :count] = [slopes[i] for slopes in group.slopes]

    def go(steps: Steps, torques: Any, s: Array) -> tuple[Array, Array]:
        begins, ends, states, times = (np.ascontiguousarray(x) for x in steps)
        at_ends, at_rows = (np.empty((len(x), 2 * n, lanes)) for x in (ends, times))
        items[place["dq0"] : place["dq0"] + 2 * n] = 0.0
        items[place["dq0"] : place["dq0"] + 2 * n, :count] = s.T
        if scene.linear:
            base = place["base0"]
            items[place["base_t"]] = begins[0]
            items[base : base + 2 * n] = np.concatenate(torques)[:, None]
        found = {"begins": begins, "ends": ends, "states": states, "times": times}
        found |= {"at_ends": at_ends, "at_rows": at_rows}
        told = [found[name].ctypes.data for name in TABLE[:-1]]
        table = np.array([*told, len(times)], np.int64)
        code.vary(block.ctypes.data, len(ends), table.ctypes.data)
        return tuple(np.swapaxes(x[..., :count], -1, -2) for x in (at_ends, at_rows))  # type: ignore[return-value]

    return go


MAKERS = {"StraightEngine": _straight, "InterpretedEngine": _rows}
