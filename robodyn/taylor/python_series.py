"""The steps of the Taylor series in Python, of one mechanism and its torques.

As straight-line text; or the rows one by one, where text would be long or M is singular alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import Any

from robodyn.dynamics.dense_dynamics import elimination_is_safe
from robodyn.engines import source_text, straightline
from robodyn.engines.expansion import (
    Coefficients,
    MotionProgram,
    end_of_step,
    horner,
    longest_step,
)
from robodyn.engines.expression import Expression, Graph, Value, greatest, least
from robodyn.engines.formulas import RECORDED
from robodyn.engines.series import FLOATS, State
from robodyn.engines.strays import strays
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.taylor.steps import Expanded, SteppingEngine, Steps


def _parts(found: Coefficients) -> list[list[Any]]:
    """The series as `Steps` has them."""
    power = [found.power] if found.power else []
    return [*found.rho, *found.theta, *power, *found.watched, *found.spanned]


def _turning(mechanism: Mechanism, rates: Sequence[Any], longest: Any) -> Any:
    """A step in which no joint turns so far that a loop's way is not told (see `loops.misses`)."""
    if not mechanism.rows:
        return longest
    from robodyn.loops.misses import SLOWEST, TURN

    fastest: Value = SLOWEST
    for rate in rates:
        fastest = greatest(fastest, abs(rate))
    return least(longest, TURN / fastest)


def step_text(
    mechanism: Mechanism,
    actuation: Actuation,
    order: int,
    work: bool,
    held: Sequence[float] | None = None,
) -> Steps:
    """As text; raises InputError where a torque has no series (for `held` see `torque_slots`)."""
    motion, n = MotionProgram(mechanism, actuation, work, held), mechanism.n
    start = motion.start()
    found = motion.expand(RECORDED, start.numbers, order, start.state)
    variable, w = start.graph.variable, start.state.w
    both, slides = (variable("rtol"), variable("atol")), mechanism.slides
    longest = longest_step(found, w, *both, slides=slides, steady=motion.steady)
    longest = _turning(mechanism, [variable(f"qd{k}") for k in range(n)], longest)
    state = end_of_step(mechanism, found, start.steady, work, variable)
    series = _parts(found)
    lines, shown = source_text.float_source(
        [longest, *state, *(x for each in series for x in each)]
    )
    last = longest.index if isinstance(longest, Expression) else -1
    before = [line for line in lines if int(line[1 : line.index(" ")]) <= last]
    end, written = shown[1 : 1 + len(state)], shown[1 + len(state) :]
    bounds = [0, *accumulate(map(len, series))]
    tuples = [f"({', '.join(written[a:b])},)" for a, b in pairwise(bounds)]
    names = [f"{name}{k}" for name in ("q", "qd") for k in range(n)]
    torques = [
        f"{', '.join(f'{name}{k}' for k in range(n))}, = {name}"
        for name in ("tau", "dtau")
        if actuation.constants is None and actuation.linear
    ]
    expand = [
        _taken(names + ["work"] * work, "y"),
        *torques,
        *before,
        f"h = {shown[0]}",
        "if h != h: return 0.0, y, ()",
        "if h > most: h = most",
        "x = h*direction",
        *lines[len(before) :],
        f"return h, [{', '.join(end)}], ({', '.join(tuples)},)",
    ]
    lines, shown = source_text.float_source([each[0] for each in found.watched])
    watched = [_taken(names, "y"), *torques, *lines]
    watched.append(f"return ({''.join(f'{x}, ' for x in shown)})")
    return Steps(
        _defined("expand", "t, y, tau, dtau, most, direction, rtol, atol", expand),
        _defined("watched", "t, y, tau, dtau", watched),
        motion.arms,
        bool(found.power),
        None if torques or not motion.arms else _gap(motion, order, names),
        _strays(motion, order) if motion.spans else None,
    )


def _strays(motion: MotionProgram, order: int) -> Callable[..., float]:
    """`strays.strays` of what is spanned, the step, and what may be missed."""
    variable = Graph().variable
    names = [[f"s{i}_{k}" for k in range(order)] for i in range(len(motion.spans))]
    series = [list(map(variable, each)) for each in names]
    given = map(variable, ("x", "small", "relative"))
    lines, shown = source_text.float_source([strays(motion.spans, motion.arms, series, *given)])
    taken = "".join(f"({', '.join(each)},), " for each in names)
    body = [f"*_, {taken}= series", *lines, f"return {shown[0]}"]
    return _defined("strays", "series, x, small, relative", body)


def _gap(motion: MotionProgram, order: int, names: Sequence[str]) -> Callable[..., float]:
    """What the torques miss their series by at a step's end.

    In all, N m; a function of t and the series where it starts, the step x, and y at its end.
    """
    start = motion.start()
    variable = start.graph.variable
    called = [[f"b{j}_{k}" for k in range(order)] for j in range(len(motion.bends))]
    x, y = variable("x"), list(map(variable, names))
    total: Value = 0.0
    state = motion.state(RECORDED, variable("t") + x, y, ((), ()), start.steady)
    values = motion.expand(RECORDED, start.numbers, 1, state).watched
    for arm, each, value in zip(motion.arms, called, values, strict=True):
        total = total + arm * abs(horner(list(map(variable, each)), x)[0] - value[0])
    lines, shown = source_text.float_source([total])
    used = set(re.findall(r"\w+", " ".join([*lines, *shown])))

    def needed(each: Sequence[str]) -> list[str]:
        return [name if name in used else "_" for name in each]

    bends = [f"({', '.join(needed(each))},)" for each in called]
    before = 2 * motion.mechanism.n + len(motion.power)
    body = [_taken(needed(names), "y"), _taken(bends, "series", before), *lines]
    return _defined("gap", "t, y, series, x", [*body, f"return {shown[0]}"])


def _taken(names: Sequence[str], values: str, first: int = 0) -> str:
    """A statement that names `values` from number `first` on; a starred name takes only 255."""
    return f"{', '.join(names)}, = {values}[{first}:{first + len(names)}]"


def _defined(name: str, arguments: str, body: Sequence[str]) -> Callable[..., Any]:
    text = "\n    ".join(body)
    return straightline.define(f"def {name}({arguments}):\n    {text}\n", name)


def step_rows(
    mechanism: Mechanism,
    actuation: Actuation,
    order: int,
    work: bool,
    held: Sequence[float] | None = None,
) -> Steps:
    """The same by the rows of the program, one by one."""
    motion = MotionProgram(mechanism, actuation, work, held)
    numbers, pivoted = motion.program.numbers, not elimination_is_safe(mechanism)
    names = [f"{name}{k}" for name in ("q", "qd") for k in range(mechanism.n)] + ["work"]

    def expanded(order: int, t: float, y: list[float], *torques: Any) -> tuple[Coefficients, State]:
        start = motion.state(FLOATS, t, y, torques)
        return motion.expand(FLOATS, numbers, order, start, pivoted=pivoted), start

    def expand(
        t: float,
        y: list[float],
        tau: Sequence[float],
        dtau: Sequence[float],
        most: float,
        direction: float,
        rtol: float,
        atol: float,
    ) -> Expanded:
        found, start = expanded(order, t, y, tau, dtau)
        both, slides = (rtol, atol), mechanism.slides
        longest = longest_step(found, start.w, *both, slides=slides, steady=motion.steady)
        longest = _turning(mechanism, y[mechanism.n : 2 * mechanism.n], longest)
        if math.isnan(longest):
            return 0.0, y, ()
        h = min(most, longest)
        given = dict(zip(names, y, strict=False)) | {"x": h * direction}
        steady = actuation.constants or ()
        return (
            h,
            end_of_step(mechanism, found, steady, work, given.__getitem__),
            tuple(_parts(found)),
        )

    def watched(t: float, y: list[float], *torques: Any) -> tuple[float, ...]:
        return tuple(each[0] for each in expanded(1, t, y, *torques)[0].watched)

    def strayed(series: Sequence[Sequence[float]], *given: float) -> Any:
        found = series[len(series) - len(motion.spans) :]
        return strays(motion.spans, motion.arms, found, *given)

    power = bool(motion.power)
    return Steps(expand, watched, motion.arms, power, None, strayed if motion.spans else None)


class StraightEngine(SteppingEngine):
    """Straight-line floats, generated for one mechanism and one order."""

    def make(self, held: tuple[float, ...] | None) -> Steps:
        given = self.actuation
        if given.control is not None and not given.linear:
            return step_text(self.mechanism, given, self.order, self.work, held)
        lines = () if given.linear else given.lines
        return _kept(self.mechanism, self.order, given.constants, lines, self.work, held)


class InterpretedEngine(SteppingEngine):
    """The rows of the program one by one: for mechanisms whose straight-line code would be long."""

    def make(self, held: tuple[float, ...] | None) -> Steps:
        return step_rows(self.mechanism, self.actuation, self.order, self.work, held)


@lru_cache(maxsize=64)
def _kept(
    mechanism: Mechanism,
    order: int,
    constants: tuple[float, ...] | None,
    lines: tuple[str, ...],
    work: bool,
    held: tuple[float, ...] | None,
) -> Steps:
    """Code of constant torques, of expressions, or else of torques that are linear."""
    actuation = Actuation(constants, lines, linear=constants is None and not lines)
    return step_text(mechanism, actuation, order, work, held)
