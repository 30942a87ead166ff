"""One step of a motion's Taylor series as a formula: the series, the step's length, its end.

Every engine that takes steps runs this formula or writes it out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from robodyn.engines import expression
from robodyn.engines.expression import Graph
from robodyn.engines.formulas import RECORDED, Recorded
from robodyn.engines.frames import start
from robodyn.engines.series import Arithmetic, Planar, Series, State, Value
from robodyn.engines.strays import spans
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.planar_model import Mechanism
from robodyn.mechanics.torque_rows import torque_slots
from robodyn.tables.records import Record

KINK = 1e-7  # a torque that misses its series by a smaller part does not bend
TINY = 1e-290  # in place of a coefficient that vanishes
TURN = 2.0  # rad: a link that turns farther in a step may not have its turns counted


class Coefficients(Record):
    """The series of one motion: `rho`, `theta` (n, order + 2) are the links' turns from its start.

    `power` (order + 1) is that of what changes the energy, but for constant torques, whose work is
    tau times the way (empty where nothing does); `watched` (k, order) are values that may bend
    where the series do not tell, `spanned` (order each) those whose whole way in a step says so.
    """

    rho: list[list[Value]]
    theta: list[list[Value]]
    power: list[Value]
    watched: list[list[Value]]
    spanned: Sequence[list[Value]] = ()


class Start(Record):
    """The state of a motion as formulas, and the numbers that its rows take."""

    graph: Graph
    numbers: list[Value]
    steady: list[Value]  # constant torques
    state: State


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
        self.mechanism, self.actuation, self.held = mechanism, actuation, held
        equations = EquationsOfMotion(mechanism)
        self.program = equations.program
        slots = torque_slots(equations, actuation, held)
        equations.write(slots, work, steady=actuation.constants is not None)
        self.turns = equations.x
        self.power = self.program.named.get("power", [])
        self.bends = self.program.named["bends"]
        self.arms = [self.program.arms[slot] for slot in self.bends]
        self.spans = spans(self.program, [*self.power, *self.bends])
        self.steady = actuation.constants is not None and not mechanism.timed

    def start(self, generic: bool = False) -> Start:
        """Where the formulas of a step begin, and what they take.

        With `generic` the numbers of the rows are parameters c0, c1, ..., constant torques u0, ...
        """
        names = ("qd", "tau", "dtau")
        recorded = Recorded(self.mechanism, names, by_direction=True, generic=generic)
        numbers, relative = recorded.numbers(self.program), recorded.relative
        steady = [
            recorded.parameter(f"u{j}", tau) if tau else 0.0
            for j, tau in enumerate(self.actuation.constants or ())
        ]
        y, torques = [*relative["q"], *relative["qd"]], (relative["tau"], relative["dtau"])
        state = self.state(RECORDED, recorded.graph.variable("t"), y, torques, steady)
        return Start(recorded.graph, numbers, steady, state)

    def state(
        self,
        arithmetic: Arithmetic,
        t: Value,
        y: Sequence[Value],
        torques: tuple[Sequence[Value], Sequence[Value]],
        steady: Sequence[Value] = (),
    ) -> State:
        """Where the series start at the state y = (q, qd, ...) and the time t.

        `torques` are values and slopes of what is linear; `steady` (n) are in place of constant
        torques, where they are formulas.
        """
        n, constants = self.mechanism.n, steady or self.actuation.constants
        state = start(self.mechanism, arithmetic, (y[:n], y[n : 2 * n]))
        state.given["t"] = t, 1.0
        for j in range(n):
            if constants is not None:
                state.given[f"tau{j}"] = (constants[j],)
            elif torques[0]:
                state.given[f"tau{j}"] = torques[0][j], torques[1][j]
        return state

    def expand(
        self,
        arithmetic: Arithmetic,
        numbers: Sequence[Value],
        order: int,
        state: State,
    ) -> Coefficients:
        """The series to an order; raises ZeroDivisionError where there are none."""
        series = Series(
            self.program,
            arithmetic,
            numbers,
            order,
            state,
            slots=[*self.power, *self.bends],
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
            [[series.real[x.slot][m] for m in range(order)] for x in self.spans],
        )


def longest_step(
    series: Coefficients,
    w: Sequence[Value],
    rtol: Value,
    atol: Value,
    power: Callable[[Value, float], Value] = expression.power,
    slides: Sequence[int] = (),
    steady: bool = True,
) -> Value:
    """The step at which the last coefficients are as large as the tolerance.

    Of two orders, as every other coefficient may vanish; a rate errs by atol + rtol |w|, an angle
    by atol + rtol, and no link turns so far that its turns cannot be counted.  The displacements of
    `slides` (m) and their rates count as these.

    Where what acts is not `steady` most coefficients may vanish, as of E = exp(i c t^m), and the
    last ones tell nothing.  What is left out begins with the order p + 2 there: after a last term x
    of an order k, with less than x^((p + 2)/k)/2, and its rate with p + 2 times that.

    Work may need shorter steps than a displacement does: if the rate of a slide is exp(-a t), the
    power of its damper has terms 2^k times as large.  So where something slides, the last terms of
    the work are no larger than atol + rtol of h times the sizes of the power's terms at h/2.
    """
    rho, theta = series.rho, series.theta
    p = len(rho[0]) - 2

    def largest(k: int) -> Value:  # without squares: past a near miss they are beyond the floats
        return _largest([abs(each[k]) for each in (*rho, *theta)])

    fast = _largest([abs(x) for x in w])
    tol = atol + rtol * fast
    h = power(tol / ((p + 1.0) * largest(p + 1) + TINY), 1.0 / p)
    before = power(tol / (float(p) * largest(p) + TINY), 1.0 / (p - 1))
    h = expression.least(h, before)
    turning = [abs(x) for k, x in enumerate(w) if k not in slides]
    if turning:
        h = expression.least(h, TURN / (_largest(turning) + TINY))
    angle = (p + 1.0) * (atol + rtol)
    shorter = h * power(angle / (h * tol), 1.0 / (p + 1))
    h = expression.choose(angle, h * tol, shorter, h)
    turns = [] if steady else [k for k in range(len(w)) if k not in slides]
    radius = power(2.0 * (atol + rtol) / (p + 2.0), 1.0 / (p + 2)) if turns else 0.0
    for k in range((p + 1) // 2 + 1, p) if turns else ():
        sizes = _largest([abs(each[j][k]) for each in (rho, theta) for j in turns])
        h = expression.least(h, radius * power(sizes + TINY, -1.0 / k))
    if slides and len(series.power):
        terms = [abs(x) for x in series.power]
        allowed = (atol + rtol) * horner(terms, 0.5 * h)[0]
        for k in (p, p - 1):
            shorter = power((k + 1.0) * allowed / (terms[k] + TINY), 1.0 / k)
            shorter = expression.choose(TINY, terms[k], shorter, math.inf)
            h = expression.choose(shorter, h, shorter, h)  # not where terms are beyond the floats
    tails: Value = 0.0  # comparisons may pass over what is not finite
    for each in theta:
        tails = tails + each[p + 1]
    return expression.choose(abs(tails), math.inf, h, math.nan)


def rough(a: Value, exponent: float) -> Value:
    """A power that errs by some percent, rather below than above."""
    return 0.96 * expression.rough_power(a, exponent)


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


def turning(z: Planar, slope: Planar) -> Value:
    """Im(conj(z) z')/|z|^2."""
    (r, t), (dr, dt) = z, slope
    return (r * dt - t * dr) / (r * r + t * t)


def ends(
    mechanism: Mechanism,
    turns: Sequence[tuple[Planar, Planar]],
    power: Value,
    steady: Sequence[Value],
    work: bool,
    given: Callable[[str], Value],
) -> list[Value]:
    """q, qd (n each) and, if `work`, the work done, at the end of a step.

    They follow from rho + i theta of the coordinates, their slopes, and the work of a power.
    """
    slides = set(mechanism.slides)
    ways: list[Value] = []
    rates: list[Value] = []
    for j, (z, slope) in enumerate(turns):
        ways.append(z[1] if j in slides else expression.arctangent(z[1], z[0]))
        rates.append(slope[1] if j in slides else turning(z, slope))
    q, qd, own = [], [], []
    for j, above in enumerate(mechanism.above):
        way, rate = ways[j], rates[j]
        if above is not None:
            way, rate = way - ways[above], rate - rates[above]
        q.append(way if j in slides else given(f"q{j}") + way)
        own.append(way - given(f"q{j}") if j in slides else way)
        qd.append(rate)
    if not work:
        return [*q, *qd]
    total: Value = given("work") + power
    for tau, way in zip(steady, own, strict=False):
        total = total + tau * way
    return [*q, *qd, total]


def integral(coefficients: Sequence[Value], x: Value) -> Value:
    """The integral of a series from 0 to x."""
    total: Value = coefficients[-1] * (1.0 / len(coefficients))
    for k in reversed(range(len(coefficients) - 1)):
        total = total * x + coefficients[k] * (1.0 / (k + 1))
    return total * x
