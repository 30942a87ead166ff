"""One step of a motion's Taylor series as a formula: the series, the step's length, its end.

Every engine that takes steps writes this formula out: as Python, or as machine code of many lanes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from robodyn.engines import expression
from robodyn.engines.expression import Graph
from robodyn.engines.formulas import RECORDED, Recorded
from robodyn.engines.series import Arithmetic, Planar, Series, State, Value
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.planar_model import Mechanism
from robodyn.mechanics.torque_rows import torque_slots

Given = dict[str, Sequence[Value] | Callable[[int], Value]]

TINY = 1e-290  # in place of a coefficient that vanishes
TURN = 2.0  # rad: a link that turns farther in a step may not have its turns counted


class Coefficients(NamedTuple):
    """The series of one motion: `rho`, `theta` (n, order + 2) are the links' turns from its start.

    `power` (order + 1) is that of what changes the energy, but for constant torques, whose work is
    tau times the way (empty where nothing does); `watched` (k, order) are values that may bend
    where the series do not tell.
    """

    rho: list[list[Value]]
    theta: list[list[Value]]
    power: list[Value]
    watched: list[list[Value]]


class MotionProgram:
    """The program of a mechanism under its torques, and how it is expanded.

    `arms` make torques of what is watched.  `held` tells how the switches of an expression stand.
    Raises InputError where a torque has no series.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        actuation: Actuation,
        work: bool,
        held: Sequence[float] | None = None,
    ) -> None:
        self.mechanism, self.actuation = mechanism, actuation
        equations = EquationsOfMotion(mechanism)
        self.program = equations.program
        slots = torque_slots(equations, actuation, held)
        equations.write(slots, work, steady=actuation.constants is not None)
        self.turns = equations.E
        self.power = self.program.named.get("power", [])
        self.bends = self.program.named["bends"]
        self.arms = [self.program.arms[slot] for slot in self.bends]

    def given(
        self,
        t: Value,
        q: Sequence[Value],
        qd: Sequence[Value],
        alpha: Sequence[Value],
        torques: tuple[Sequence[Value], Sequence[Value]],
    ) -> Given:
        """What the rows take from outside: `torques` are values and slopes of what is linear."""
        constants = self.actuation.constants
        given: Given = {"t": (t, 1.0)}
        for j in range(self.mechanism.n):
            given[f"q{j}"], given[f"alpha{j}"], given[f"qd{j}"] = (q[j],), (alpha[j],), (qd[j],)
            if constants is not None:
                given[f"tau{j}"] = (constants[j],)
            elif torques[0]:
                given[f"tau{j}"] = torques[0][j], torques[1][j]
        return given

    def state(
        self,
        arithmetic: Arithmetic,
        t: Value,
        y: Sequence[Value],
        torques: tuple[Sequence[Value], Sequence[Value]],
    ) -> State:
        """Where the series start at the state y = (q, qd, ...)."""
        n = self.mechanism.n
        q, qd = y[:n], y[n : 2 * n]
        alpha, w = list(q), list(qd)
        for k in self.mechanism.order:
            above = self.mechanism.parent[k]
            if above is not None:
                alpha[k], w[k] = alpha[above] + alpha[k], w[above] + w[k]
        E = [(arithmetic.cos(angle), arithmetic.sin(angle)) for angle in alpha]
        return State(E, w, self.given(t, q, qd, alpha, torques))

    def expand(
        self,
        arithmetic: Arithmetic,
        numbers: Sequence[Value],
        order: int,
        state: State,
        grounded: bool = False,
    ) -> Coefficients:
        """The series to an order; raises ZeroDivisionError where there are none."""
        series = Series(
            self.program,
            arithmetic,
            numbers,
            order,
            state,
            slots=[*self.power, *self.bends],
            grounded=grounded,
        )
        series.expand()
        if self.power:  # the residuals of the last order are not wanted, what works there is
            series.residuals(order)
        turns = [series.turn(slot) for slot in self.turns]
        return Coefficients(
            [list(rho[: order + 2]) for rho, _ in turns],
            [list(theta[: order + 2]) for _, theta in turns],
            [series.real[slot][m] for slot in self.power for m in range(order + 1)],
            [[series.real[slot][m] for m in range(order)] for slot in self.bends],
        )


class Expansion(NamedTuple):
    """Formulas of q, qd, t, tau and dtau (n each: what is linear, and its slope in time).

    `given` tells whether there are such torques; `longest` is the step that the tolerances `rtol`
    and `atol` allow, `steady` (n) are torques that are constant, `arms` (k) make torques of what is
    watched.
    """

    graph: Graph
    given: bool
    series: Coefficients
    longest: Value
    steady: tuple[float, ...] | None
    arms: list[float]


def expansion(
    mechanism: Mechanism,
    actuation: Actuation,
    order: int,
    work: bool,
    held: Sequence[float] | None = None,
) -> Expansion:
    """The formulas of one step; see `Expansion` and `MotionProgram`."""
    state = Recorded(mechanism, ("qd", "tau", "dtau"), by_direction=True)
    motion = MotionProgram(mechanism, actuation, work, held)
    alpha, w = state.absolute("q"), state.absolute("qd")
    relative = state.relative
    torques = relative["tau"], relative["dtau"]
    t = state.graph.variable("t")
    given = motion.given(t, relative["q"], relative["qd"], alpha, torques)
    E: list[Planar] = [(expression.cos(angle), expression.sin(angle)) for angle in alpha]
    series = motion.expand(RECORDED, motion.program.numbers, order, State(E, w, given))
    tolerances = state.graph.variable("rtol"), state.graph.variable("atol")
    return Expansion(
        state.graph,
        actuation.constants is None and actuation.linear,
        series,
        longest_step(series, w, *tolerances),
        actuation.constants,
        motion.arms,
    )


def longest_step(series: Coefficients, w: Sequence[Value], rtol: Value, atol: Value) -> Value:
    """The step at which the last coefficients are as large as the tolerance.

    Of two orders, as every other coefficient may vanish; a rate errs by atol + rtol |w|, an angle
    by atol + rtol, and no link turns so far that its turns cannot be counted.
    """
    rho, theta = series.rho, series.theta
    p = len(rho[0]) - 2

    def largest(k: int) -> Value:
        return _largest([a[k] * a[k] + b[k] * b[k] for a, b in zip(rho, theta, strict=True)])

    fast = _largest([expression.absolute(x) for x in w])
    tol = atol + rtol * fast
    square = tol * tol
    h = expression.power(square / ((p + 1.0) ** 2 * largest(p + 1) + TINY), 0.5 / p)
    before = expression.power(square / (float(p * p) * largest(p) + TINY), 0.5 / (p - 1))
    h = expression.least(h, before)
    h = expression.least(h, TURN / (fast + TINY))
    angle = (p + 1.0) * (atol + rtol)
    shorter = h * expression.power(angle / (h * tol), 1.0 / (p + 1))
    h = expression.choose(angle, h * tol, shorter, h)
    tails: Value = 0.0  # comparisons may pass over what is not finite
    for each in theta:
        tails = tails + each[p + 1]
    return expression.choose(expression.absolute(tails), math.inf, h, math.nan)


def _largest(values: Sequence[Value]) -> Value:
    found = values[0]
    for value in values[1:]:
        found = expression.greatest(found, value)
    return found


def horner(coefficients: Sequence[Value], x: Value) -> tuple[Value, Value]:
    """A polynomial's value at x, and its slope."""
    value: Value = coefficients[-1]
    slope: Value = 0.0
    for coefficient in reversed(coefficients[:-1]):
        slope = slope * x + value
        value = value * x + coefficient
    return value, slope


def turned(rho: Sequence[Value], theta: Sequence[Value], x: Value) -> tuple[Planar, Value]:
    """The turn r + i t of a link at x after the start, and its rate Im(conj(z) z')/|z|^2."""
    (r, dr), (t, dt) = horner(rho, x), horner(theta, x)
    return (r, t), (r * dt - t * dr) / (r * r + t * t)


def integral(coefficients: Sequence[Value], x: Value) -> Value:
    """The integral of a series from 0 to x."""
    total: Value = coefficients[-1] * (1.0 / len(coefficients))
    for k in reversed(range(len(coefficients) - 1)):
        total = total * x + coefficients[k] * (1.0 / (k + 1))
    return total * x
