"""A mechanism's dynamics as formulas: its program evaluated on recorded arithmetic.

Products of directions are written with cosines of angle differences, as in textbooks, or with the
links' directions (c_k, s_k).  `by_directions` decides by the tree and its loops.

Derivatives are tangents of the program's residuals R = r(q, qd, tau) + K(q) u.  R vanishes at the
unknowns u: the accelerations a of x, and mu = -lambda.  With u held,

    du = -K^-1 dR

so one factorisation serves all directions.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from functools import lru_cache, partial
from typing import Any, NamedTuple

from robodyn.elements.program import Given, Program
from robodyn.engines import expression
from robodyn.engines.arithmetic import (
    Arithmetic,
    Planar,
    conjugate_times,
    dot,
    entries,
    some,
    weighted,
)
from robodyn.engines.expression import FUNCTIONS, Expression, Graph, Value, slopes_by, substituted
from robodyn.engines.factors import Factors, small_system
from robodyn.engines.rounds import Rounds
from robodyn.engines.series import Series, relative, start
from robodyn.engines.series import absolute as absolute
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.parts import without_rubbing
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.expressions import OPERATIONS, value_in
from robodyn.scene.syntax import Node


def _power(a: Value, exponent: float) -> Value:
    """Return a to a constant exponent, by a square root for exponents of +-1/2."""
    if abs(exponent) != 0.5:
        return expression.power(a, exponent)
    root = expression.call("sqrt", a)
    return root if exponent > 0.0 else 1.0 / root


def _or_nan(function: Callable[..., Value], *values: Value) -> Value:
    """Return the function of constants, or nan if it is undefined at every state."""
    try:
        return function(*values)
    except (ArithmeticError, ValueError):
        return math.nan


def _chosen(x: Value, knots: Sequence[float], values: Sequence[float]) -> Value:
    """Return the value for the interval between increasing `knots` that contains x, as a tree."""
    if len(values) == 1:
        return values[0]
    k = len(knots) // 2
    below = _chosen(x, knots[:k], values[: k + 1])
    above = _chosen(x, knots[k + 1 :], values[k + 1 :])
    if not isinstance(below, Expression) and below == above:
        return below
    return expression.choose(x, knots[k], below, above)


RECORDED = Arithmetic(
    cos=expression.cos,
    sin=expression.sin,
    power=partial(_or_nan, _power),
    divide=partial(_or_nan, operator.truediv),
    weigh=partial(weighted, keep=expression.keep),
    keep=expression.keep,
    chosen=_chosen,
    functions={name: partial(_or_nan, partial(expression.call, name)) for name in FUNCTIONS},
)

# what operations of an expression are of recorded numbers
WRITTEN: dict[str, Callable[..., Any]] = {
    **OPERATIONS,
    **{name: partial(expression.call, name) for name in (*FUNCTIONS, "abs")},
    "pow": expression.power,
    "atan2": expression.arctangent,
}


def evaluated(node: Node, variables: Mapping[str, Value]) -> Any:
    """Evaluate an expression's tree on recorded numbers.

    Raises KeyError, TypeError, ValueError or AttributeError if it uses what they do not have.
    """
    return value_in(node, variables, WRITTEN)


# Links in a chain from which on the torques of a state take fewer operations by directions: a chain
# of 3 takes 99 additions by angles and 101 by directions, of 4 177 and 142, of 12 1593 and 470.
LONG = 4
MAX_GENERATED = 12  # links; beyond, dense algebra costs less than recording and running code

# Whether calls are parts of a stream of states.  Nobody knows how many there will be, and a pipe
# may cut it anywhere: parts of any size are evaluated in one way, by the formula and numpy.
streams: ContextVar[bool] = ContextVar("streams", default=False)


def anything(i: int) -> float:
    """Return a generic number: neither it nor sums of products of such numbers are 0, 1 or -1."""
    return 1.5 + 0.4 * math.sin(37.0 * (i + 1) ** 2)


class Formula(NamedTuple):
    """Inputs by name, outputs (n joint values, r multipliers, ...), and the closures' pivots.

    A pivot is relative to its size in a good configuration.  If one is near zero, the configuration
    is nearly singular and another method must be used.
    """

    inputs: tuple[str, ...]
    outputs: tuple[Value, ...]
    pivots: tuple[Value, ...]
    Psi: tuple[dict[int, Value], ...] = ()  # its rows in alpha, where they are wanted
    rounds: Rounds | None = None


class Recorded:
    """The program of a mechanism at one recorded state: q, qd, and other inputs by name.

    With `parameters`, the mechanism's numbers are parameters of the graph; otherwise they are
    folded.  With `generic` they are parameters too, and their values are not used: the formula
    serves all mechanisms of one shape.  A mechanism whose numbers are formulas has them on the
    `graph` given.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        rates: Sequence[str],
        by_direction: bool,
        parameters: bool = False,
        generic: bool = False,
        graph: Graph | None = None,
        arithmetic: Arithmetic = RECORDED,
    ) -> None:
        self.mechanism, self.by_direction, self.generic = mechanism, by_direction, generic
        self.parameters = parameters or generic
        self.graph, self.arithmetic = graph or Graph(), arithmetic
        n = mechanism.n
        names = ("q", *rates)
        self.inputs = tuple(f"{name}{k}" for name in names for k in range(n))
        self.timed = ("t",) if mechanism.timed else ()  # an input more, where loads ask for it
        self.relative: dict[str, list[Value]] = {
            name: [self.graph.variable(f"{name}{k}") for k in range(n)] for name in names
        }

    def builder(self) -> EquationsOfMotion:
        """Return the writer of the rows."""
        return EquationsOfMotion(self.mechanism)

    def more(self, equations: EquationsOfMotion) -> Mapping[str, Any]:
        """Return further inputs of the rows that were written."""
        return {}

    def absolute(self, name: str) -> list[Value]:
        """Return J times the relative values called `name`."""
        return absolute(self.mechanism, self.relative[name])

    def to_joints(self, values: Sequence[Value]) -> list[Value]:
        """Return J^T times values in alpha."""
        sums = list(values)
        for k in reversed(self.mechanism.order):
            above = self.mechanism.above[k]
            if above is not None:
                sums[above] = sums[above] + sums[k]
        return sums

    def half_slopes(self, values: Sequence[Value]) -> list[list[Value]]:
        """Return half of the derivatives of values by each absolute rate (n), row by row."""
        from robodyn.engines.expression import Tangents, tangents  # a state's torques start without

        rates = self.absolute("qd")
        own: list[Tangents] = [{str(k): 0.5} for k in range(len(rates))]
        seeds = {x.index: y for x, y in zip(rates, own, strict=True) if isinstance(x, Expression)}
        found = tangents(values, {}, seeds)
        return [[slope.get(str(k), 0.0) for k in range(len(rates))] for slope in found]

    def series(
        self,
        torques: Sequence[float] | None,
        power: bool = False,
        orders: int = 1,
        chained: bool = False,
        accelerated: bool = False,
    ) -> Series:
        """Return the series from this state.

        `torques` (n) are constant; None takes the inputs called tau.
        """
        mechanism = self.mechanism
        self.equations = equations = self.builder()
        program = equations.program
        turn = None if self.by_direction else self._turn
        accelerations = self.absolute("qdd") if accelerated else None
        joints = self.relative["q"], self.relative["qd"]
        links = self.absolute("q"), self.absolute("qd")
        state = start(mechanism, self.arithmetic, joints, links, turn, accelerations)
        self.E, driven = state.E, []
        if self.timed:
            state.given["t"] = self.graph.variable("t"), 1.0
        for j in range(mechanism.n):
            tau = self.relative["tau"][j] if torques is None else torques[j]
            state.given[f"tau{j}"] = (tau,)
            driven.append(program.add(Given(f"tau{j}")) if some(tau) else None)
        equations.write(driven, power, chained=chained)
        state.given.update(self.more(equations))
        wanted = ("gap", "drift", "load", "power", "names")
        slots = [x for name in wanted for x in program.named.get(name, [])]
        signals = [*equations.tables, *equations.laws]
        slots += [*(x.torque for x in equations.couples), *(x for _, x in signals)]
        return Series(
            program,
            self.arithmetic,
            self.numbers(program),
            orders,
            state,
            slots=[*slots, *(x.force for x in equations.forces if x.force is not None)],
            grounded=self.by_direction,
        )

    def numbers(self, program: Program) -> list[Value]:
        """Return the numbers of the program, folded or as parameters."""
        if not self.parameters:
            return list(program.numbers)
        return [self.parameter(f"c{i}", x) for i, x in enumerate(program.numbers)]

    def parameter(self, name: str, number: float) -> Value:
        """Return a number as a parameter if `parameters` or `generic` is set."""
        if self.generic:
            return self.graph.parameter(name, anything(len(self.graph.parameters)))
        return self.graph.parameter(name, number) if self.parameters else number

    def _turn(self, j: int, k: int) -> Planar:
        """Return conj(E_j) E_k from the angles between the two links."""
        above, q = self.mechanism.above, self.relative["q"]
        for first, last, sign in ((j, k, 1.0), (k, j, -1.0)):
            angle: Value = 0.0
            link: int | None = last
            while link is not None and link != first:
                angle = angle + q[link]
                link = above[link]
            if link == first:
                return self.arithmetic.cos(angle), sign * self.arithmetic.sin(angle)
        E = self.E
        return conjugate_times(E[j], E[k])  # on different branches


def by_directions(mechanism: Mechanism) -> bool:
    """Return whether formulas are written with the links' directions.

    They are if there are loops, or chains of at least LONG links.
    """
    depths = [1] * mechanism.n
    for k in mechanism.order:
        above = mechanism.above[k]
        if above is not None:
            depths[k] = depths[above] + 1
    return bool(mechanism.rows) or max(depths, default=0) >= LONG


def written(mechanism: Mechanism, write: Callable[[bool], Formula]) -> Formula | None:
    """Return the formula by `write(by_direction)`.

    None if it divides by a structural zero; dense algebra then explains the fault.
    """
    try:
        return write(by_directions(mechanism))
    except ZeroDivisionError:
        return None


def inverse_formula(mechanism: Mechanism, parameters: bool = False) -> Formula | None:
    """Return the formula of tau (n, 0 at passive joints) and lambda (r) from q, qd, qdd.

    None if the system for lambda is larger than 2x2, or if `written` returns None.  With
    `parameters` the mechanism's numbers are parameters.
    """
    rows, passive = len(mechanism.rows), mechanism.passive
    if len(passive) != rows or rows > 2:
        return None
    return written(
        mechanism, lambda way: inverse_of(Recorded(mechanism, ("qd", "qdd"), way, parameters))
    )


def inverse_of(state: Recorded) -> Formula:
    """Return `inverse_formula` of a state whose rates and accelerations may be formulas."""
    mechanism, n = state.mechanism, state.mechanism.n
    deep = len(mechanism.A) > 2 * n
    series = state.series([0.0] * n, chained=state.by_direction and deep, accelerated=True)
    series.residuals(0)
    load, Psi = balance(state, series), joint_jacobian(state, series)
    if not mechanism.rows:
        return Formula(state.inputs + state.timed, tuple(load), ())
    # passive joints: load_p = Psi_p^T lambda; then tau_a = load_a - Psi_a^T lambda
    columns = [[row[p] for row in Psi] for p in mechanism.passive]
    right = [load[p] for p in mechanism.passive]
    multipliers, det = small_system(columns, right)
    if len(Psi) == 1:
        pivot = det / state.parameter("size0", mechanism.rows[0].size)
        pivots: tuple[Value, ...] = (pivot * pivot,)
    else:
        (a, b), (c, d) = columns
        pivots = ((det * det) / ((a * a + b * b) * (c * c + d * d)),)
    tau: list[Value] = [0.0] * n
    for k in mechanism.actuated:
        tau[k] = load[k]
        for row, multiplier in zip(Psi, multipliers, strict=True):
            tau[k] = tau[k] - row[k] * multiplier
    return Formula(state.inputs + state.timed, (*tau, *multipliers), pivots)


def balance(state: Recorded, series: Series) -> list[Value]:
    """Return M qdd + C qd + D qd + G - Q (n,), after `series.residuals(0)`."""
    load = state.to_joints([series.real[slot][0] for slot in series.program.named["load"]])
    for j, slot in enumerate(state.equations.torques):
        if slot is not None:  # not summed and taken off again: no rounding of what is large
            load[j] = load[j] - series.real[slot][0]
    return load


def joint_jacobian(state: Recorded, series: Series) -> list[list[Value]]:
    """Return Psi row by row, after `series.residuals(0)`."""
    n = state.mechanism.n
    rows = series.matrix()[n:]
    return [state.to_joints([row.get(k, 0.0) for k in range(n)]) for row in rows]


@lru_cache(maxsize=64)
def forward_formula(
    mechanism: Mechanism,
    torques: tuple[float, ...] | None = None,
    baumgarte: float = 0.0,
    power: bool = False,
    parameters: bool = False,
) -> Formula | None:
    """Return the formula of qdd (n) and lambda (r) from q, qd, tau.

    Closures satisfy gap'' = 0, or gap'' + 2 b gap' + b^2 gap = 0 with the rate b = `baumgarte`
    (1/s).  Time t is another input if loads depend on it.  With `power`, the power of torques and
    of forces without a potential follows.  Constant `torques` (n) are folded.
    """

    def write(by_direction: bool) -> Formula:
        rates = ("qd", "tau") if torques is None else ("qd",)
        return _forward(
            Recorded(mechanism, rates, by_direction, parameters), torques, baumgarte, power
        )

    return written(mechanism, write)


def _forward(
    state: Recorded, torques: Sequence[float] | None, baumgarte: float, power: bool
) -> Formula:
    mechanism, n = state.mechanism, state.mechanism.n
    series, factors, right = forward_system(state, torques, baumgarte, power)
    solution = factors.solve(right)
    series.complete(solution)
    qdd = relative(mechanism, solution[:n])
    pivots = closure_pivots(state, factors)
    own_power = series_power(series, power)
    inputs = state.inputs + state.timed
    return Formula(inputs, (*qdd, *(-x for x in solution[n:]), *own_power), pivots)


def forward_system(
    state: Recorded, torques: Sequence[float] | None, baumgarte: float, power: bool
) -> tuple[Series, Factors, list[Value]]:
    """Return the series of a state, the factors of its equations, and their right side."""
    n = state.mechanism.n
    series = state.series(torques, power)
    right = [-x for x in series.residuals(0)]
    if baumgarte:
        for r, gap in enumerate(series.program.named["gap"]):
            x = series.real[gap]
            right[n + r] = right[n + r] - 2.0 * baumgarte * x[1] - baumgarte**2 * x[0]
    factors = series.factorise()
    assert isinstance(factors, Factors)
    return series, factors, right


def series_power(series: Series, power: bool) -> list[Value]:
    """Return the power from a completed series, if it was requested."""
    found = [series.real[slot][0] for slot in series.program.named.get("power", [])]
    return found or ([0.0] if power else [])


def closure_pivots(state: Recorded, factors: Factors) -> tuple[Value, ...]:
    """Return the pivots of the closures, relative to their size in a good configuration."""
    mechanism = state.mechanism
    diagonal, pivots = mechanism.inertias, factors.pivots[mechanism.n :]
    sizes = [
        -sum(abs(weight) ** 2 / diagonal[k] for k, weight in (*row.P, *row.angles))
        for row in mechanism.rows
    ]
    return tuple(
        pivot / state.parameter(f"size{r}", size)
        for r, (pivot, size) in enumerate(zip(pivots, sizes, strict=True))
    )


def projection_formula(mechanism: Mechanism, generic: bool = False) -> Formula | None:
    """Return the formula of one Newton step of least norm on q, qd (2n), and gap (r).

    The step is q - Psi^T (Psi Psi^T)^-1 gap(q) and qd - Psi^T (Psi Psi^T)^-1 Psi qd.  None if it
    divides by a structural zero.
    """
    try:
        moving = without_rubbing(mechanism)  # of which the closures alone are asked for
        return _projection(Recorded(moving, ("qd",), True, generic=generic))
    except ZeroDivisionError:
        return None


def _projection(state: Recorded) -> Formula:
    mechanism = state.mechanism
    n, rows = mechanism.n, len(mechanism.rows)
    series = state.series([0.0] * n)
    series.residuals(0)
    absolute = [{k: x for k, x in row.items() if k < n} for row in series.matrix()[n:]]
    Psi = [entries(state.to_joints([row.get(k, 0.0) for k in range(n)])) for row in absolute]
    columns: list[dict[int, Value]] = [{} for _ in range(n)]
    for r, row in enumerate(Psi):
        for k, value in row.items():
            columns[k][r] = value
    gaps = [series.real[slot][0] for slot in series.program.named["gap"]]
    speeds = [dot(row, state.relative["qd"]) for row in Psi]
    if mechanism.driven:
        drift = (series.real[slot][0] for slot in series.program.named["drift"])
        speeds = [x + y for x, y in zip(speeds, drift, strict=True)]
    near = [sorted({c for k in row for c in columns[k]}) for row in Psi]
    normal = [entries({c: dot(row, Psi[c]) for c in near[r]}) for r, row in enumerate(Psi)]
    factors = Factors(normal, rows)
    outputs: list[Value] = []
    for name, right in (("q", gaps), ("qd", speeds)):
        multipliers = factors.solve(right)
        before = state.relative[name]
        outputs += [before[k] - dot(column, multipliers) for k, column in enumerate(columns)]
    relative = tuple(
        pivot / state.parameter(f"size{r}", row.size**2)
        for r, (pivot, row) in enumerate(zip(factors.pivots, mechanism.rows, strict=True))
    )
    inputs = state.inputs + state.timed
    return Formula(inputs, (*outputs, *gaps), relative, tuple(absolute))


def energies(
    mechanism: Mechanism, number: Callable[[float], Value], q: Sequence[Value], qd: Sequence[Value]
) -> tuple[Value, Value]:
    """Return KE and PE, J, at q, qd (n), without the mechanism's constant energy.

    `number` maps a number of the scene to its value in the formula.
    """
    equations = EquationsOfMotion(mechanism)
    wanted = [equations.kinetic(), equations.potential()]
    state = start(mechanism, RECORDED, (q, qd))
    numbers = [number(x) for x in equations.program.numbers]
    series = Series(equations.program, RECORDED, numbers, 1, state, slots=wanted, grounded=True)
    series.residuals(0)
    KE, PE = (series.real[slot][0] for slot in wanted)
    return KE, PE


KINDS = ("q", "qd", "tau")


def residuals(state: Recorded) -> tuple[Series, list[Value], list[dict[int, Value]], list[Value]]:
    """Return series, r, K and R of a state with the unknowns as inputs u0, u1, ..."""
    series = state.series(None)
    r = series.residuals(0)
    K = series.matrix()
    u = [state.graph.variable(f"u{i}") for i in range(len(r))]
    R = [x + sum((k * u[i] for i, k in row.items()), 0.0) for x, row in zip(r, K, strict=True)]
    return series, r, K, R


def _directions(mechanism: Mechanism) -> list[str]:
    return [f"{kind}{k}" for kind in KINDS for k in range(mechanism.n)]


def forward_derivatives_formula(mechanism: Mechanism) -> Formula | None:
    """Return the formula of qdd (n) and its derivatives by q, qd and tau.

    Each derivative is (n, n), row by row.  None if `forward_formula` is None.
    """
    return written(mechanism, lambda way: _qdd_tangents(Recorded(mechanism, KINDS[1:], way, True)))


def _qdd_tangents(state: Recorded) -> Formula:
    mechanism, n = state.mechanism, state.mechanism.n
    names, (series, r, _, R) = _directions(mechanism), residuals(state)
    factors = series.factorise()
    assert isinstance(factors, Factors)
    u = factors.solve([-x for x in r])
    slopes = substituted(slopes_by(R, names), {f"u{i}": x for i, x in enumerate(u)})
    every = (factors.solve([-x for x in slopes[j :: len(names)]]) for j in range(len(names)))
    found = [relative(mechanism, du[:n]) for du in every]
    outputs = relative(mechanism, u[:n])
    for kind in range(len(KINDS)):
        outputs += [found[kind * n + j][i] for i in range(n) for j in range(n)]
    pivots = closure_pivots(state, factors)
    return Formula(state.inputs + state.timed, tuple(outputs), pivots)


def residual_derivatives_formula(mechanism: Mechanism) -> Formula:
    """Return the formula of K (N, N) and of dR by q, qd and tau (N, 3n).

    Row by row, at given unknowns u (N).
    """
    state = Recorded(mechanism, KINDS[1:], True)
    _, r, K, R = residuals(state)
    size = len(r)
    names = _directions(mechanism)
    outputs = [row.get(j, 0.0) for row in K for j in range(size)]
    outputs += slopes_by(R, names)
    inputs = (*state.inputs, *(f"u{i}" for i in range(size)), *state.timed)
    return Formula(inputs, tuple(outputs), ())
