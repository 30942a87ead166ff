"""The closed form of one mechanism, recorded as formulas: inverse and forward dynamics, projection.

The formula runs once on `expression` nodes, with the mechanism's constants folded and its zero
terms left out; `straightline.py` writes it out as code.

The dynamics can be written in two ways: with the cosines of angle differences, as textbooks do,
or with the links' directions (c_k, s_k) alone.  Both are recorded; the cheaper one is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from robodyn import expression
from robodyn.expression import Value
from robodyn.force_formulas import other_torques, potential_torques
from robodyn.formula_state import (
    Planar,
    State,
    imaginary,
    planar,
    plus,
    real,
    times,
    to_joints,
)
from robodyn.mechanism import Mechanism

MAX_GENERATED = 12  # links; beyond, dense algebra costs less than recording and running code


class Formula(NamedTuple):
    """Inputs by name, outputs (n joint values, r multipliers, ...), and the closures' pivots.

    A pivot is relative to its size in a good configuration.  Where one is near zero the
    configuration is near singular and the result must be computed another way.
    """

    inputs: tuple[str, ...]
    outputs: tuple[Value, ...]
    pivots: tuple[Value, ...]


def cheapest(
    write: Callable[[bool], Formula], by_direction: Sequence[bool] = (False, True)
) -> Formula | None:
    """The way to write a formula that costs least.

    None where it divides by what is zero at every state: the numpy evaluators say what that means.
    """
    try:
        ways = [write(way) for way in by_direction]
    except ZeroDivisionError:
        return None
    return min(ways, key=lambda f: expression.cost(f.outputs + f.pivots))


# -- inverse dynamics ----------------------------------------------------------------------------


def inverse_formula(mechanism: Mechanism) -> Formula | None:
    """tau (n, zero at passive joints) and lambda (r) from q, qd, qdd; equation (1).

    None where the solve for lambda is no 1x1 or 2x2 system, as where `cheapest` gives none.
    """
    rows, passive = len(mechanism.rows), mechanism.passive
    if len(passive) != rows or rows > 2:
        return None
    return cheapest(lambda way: inverse_of(State(mechanism, ("qd", "qdd"), way)))


def inverse_of(state: State) -> Formula:
    """The same of a state whose rates and accelerations may be formulas themselves."""
    mechanism = state.mechanism
    load = _recursive_load(state) if state.by_direction else _pairwise_load(state)
    load = to_joints(mechanism, load)
    for k, damping in enumerate(mechanism.damping):
        load[k] = load[k] + damping * state.relative["qd"][k]
    if mechanism.has_state_forces:
        acting = zip(potential_torques(state), other_torques(state), strict=True)
        load = [x - (a + b) for x, (a, b) in zip(load, acting, strict=True)]
    if not mechanism.rows:
        return Formula(state.inputs, tuple(load), ())

    # passive joints: load_p = Psi_p^T lambda; then tau_a = load_a - Psi_a^T lambda
    n = mechanism.n
    Psi = joint_jacobian(state)
    columns = [[row[p] for row in Psi] for p in mechanism.passive]
    right = [load[p] for p in mechanism.passive]
    if len(Psi) == 1:
        det = columns[0][0]
        multipliers = [right[0] / det]
        pivot = det / mechanism.rows[0].size
        pivots: tuple[Value, ...] = (pivot * pivot,)
    else:
        (a, b), (c, d) = columns
        det = a * d - b * c
        multipliers = [(right[0] * d - right[1] * b) / det, (a * right[1] - c * right[0]) / det]
        pivots = ((det * det) / ((a * a + b * b) * (c * c + d * d)),)
    tau: list[Value] = [0.0] * n
    for k in mechanism.actuated:
        tau[k] = load[k]
        for row, multiplier in zip(Psi, multipliers, strict=True):
            tau[k] = tau[k] - row[k] * multiplier
    return Formula(state.inputs, (*tau, *multipliers), pivots)


def _pairwise_load(state: State) -> list[Value]:
    """M alphadd + C alphad + G in alpha, by the entries of A."""
    rates, accelerations = state.absolute("qd"), state.absolute("qdd")
    load = [state.gravity(k) for k in range(state.mechanism.n)]
    for j, k, value in state.mechanism.A:
        if j == k:
            load[k] = load[k] + value.real * accelerations[k]
            continue
        w = times((value.real, value.imag), state.turn(j, k))
        load[j] = load[j] + (w[0] * accelerations[k] - w[1] * (rates[k] * rates[k]))
        load[k] = load[k] + (w[0] * accelerations[j] + w[1] * (rates[j] * rates[j]))
    return load


def _recursive_load(state: State) -> list[Value]:
    """The same in O(links): accelerations outward, inertial forces inward.

    A_jk = conj(p_jk) B_k for j above k, so the links above act through the acceleration of the
    joint, and the links below through the sum of their B_k Edd_k.  Gravity is an upward
    acceleration of the ground.
    """
    mechanism = state.mechanism
    rates, accelerations = state.absolute("qd"), state.absolute("qdd")
    ground: Planar = (-mechanism.gamma.real, -mechanism.gamma.imag)
    joint: list[Planar] = [ground] * mechanism.n  # acceleration of each link's own joint
    bend: list[Planar] = [ground] * mechanism.n  # Edd_k = E_k (i alphadd - alphad^2)
    load: list[Value] = [0.0] * mechanism.n
    diagonal = {j: value.real for j, k, value in mechanism.A if j == k}
    links = mechanism.description.links

    def moment(k: int, point: complex, force: Planar) -> Value:
        """Re(conj(i point E_k) force), the force's moment about link k's joint."""
        arm = times(planar(point), state.direction(k))
        return arm[0] * force[1] - arm[1] * force[0]

    for k in mechanism.order:
        bend[k] = times(state.direction(k), (-(rates[k] * rates[k]), accelerations[k]))
        above = mechanism.parent[k]
        if above is not None:
            joint[k] = plus(joint[above], times(planar(links[k].hangs_from.at), bend[above]))
        load[k] = diagonal[k] * accelerations[k] + moment(k, mechanism.B[k], joint[k])
        load[k] = load[k] + state.constant_load(k)
    below: list[Planar] = [(0.0, 0.0)] * mechanism.n
    for k in reversed(mechanism.order):
        above = mechanism.parent[k]
        if above is not None:
            force = plus(below[k], times(planar(mechanism.B[k]), bend[k]))
            load[above] = load[above] + moment(above, links[k].hangs_from.at, force)
            below[above] = plus(below[above], force)
    return load


# -- forward dynamics ----------------------------------------------------------------------------


def forward_formula(
    mechanism: Mechanism,
    torques: Sequence[float] | None = None,
    baumgarte: float = 0.0,
    power: bool = False,
) -> Formula | None:
    """qdd (n) and lambda (r) from q, qd, tau; equation (1) with gap = 0 differentiated twice.

    With `power` that of the scene's forces without potential follows, Q . qd.

    The symmetric system [M Psi^T; Psi 0] is solved by L D L^T without pivoting, M first: its
    Schur complement -Psi M^-1 Psi^T is the matrix that the textbook's elimination inverts.
    Constant `torques` (n) are folded in.  A `baumgarte` rate b (1/s) makes the closures obey
    gapdd + 2 b gapd + b^2 gap = 0 instead of gapdd = 0.
    """
    return cheapest(lambda way: _forward(mechanism, torques, baumgarte, power, way))


def _forward(
    mechanism: Mechanism,
    torques: Sequence[float] | None,
    baumgarte: float,
    power: bool,
    by_direction: bool,
) -> Formula:
    rates_and_torques = ("qd", "tau") if torques is None else ("qd",)
    state = State(mechanism, rates_and_torques, by_direction)
    n, rows = mechanism.n, len(mechanism.rows)
    rates = state.absolute("qd")
    squares = [rate * rate for rate in rates]

    # torques in alpha: J^-T tau, what a joint puts on its link it takes from the link above
    given: Sequence[Value] = state.relative["tau"] if torques is None else torques
    joint = [
        tau - damping * qd
        for tau, qd, damping in zip(given, state.relative["qd"], mechanism.damping, strict=True)
    ]
    own_power: list[Value] = [0.0] * power
    if mechanism.has_state_forces:
        other = other_torques(state)
        if power:
            own_power = [_dot(other, state.relative["qd"])]
        acting = zip(potential_torques(state), other, strict=True)
        joint = [tau + (a + b) for tau, (a, b) in zip(joint, acting, strict=True)]
    force = list(joint)
    for k, above in enumerate(mechanism.parent):
        if above is not None:
            force[above] = force[above] - joint[k]

    matrix: list[dict[int, Value]] = [{} for _ in range(n + rows)]  # upper triangle by rows
    for j, k, value in mechanism.A:
        if j == k:
            matrix[k][k] = value.real
            force[k] = force[k] - state.gravity(k)
            continue
        w = times((value.real, value.imag), state.turn(j, k))
        matrix[min(j, k)][max(j, k)] = w[0]
        force[j] = force[j] + w[1] * squares[k]
        force[k] = force[k] - w[1] * squares[j]
    bends = closure_bends(state)
    for row, entries in enumerate(_jacobian(state)):
        gap, gapd = _gap(state, row), _product(entries, rates)
        force.append(bends[row] - 2.0 * baumgarte * gapd - baumgarte**2 * gap)
        for k, slope in entries.items():
            matrix[k][n + row] = slope

    solution, negative_pivots = _solve_symmetric(matrix, force, n)
    qdd = [
        solution[k] if above is None else solution[k] - solution[above]
        for k, above in enumerate(mechanism.parent)
    ]
    diagonal = {j: value.real for j, k, value in mechanism.A if j == k}
    pivots = tuple(
        pivot / -sum(abs(weight) ** 2 / diagonal[k] for k, weight in (*row.P, *row.angles))
        for pivot, row in zip(negative_pivots, mechanism.rows, strict=True)
    )
    return Formula(state.inputs, (*qdd, *(-x for x in solution[n:]), *own_power), pivots)


def projection_formula(mechanism: Mechanism) -> Formula | None:
    """q and qd (2n) brought nearer to closing by one Newton step of least norm; gap (r).

    q - Psi^T (Psi Psi^T)^-1 gap(q)    and    qd - Psi^T (Psi Psi^T)^-1 Psi qd

    None as by `cheapest`.
    """
    return cheapest(lambda way: _projection(State(mechanism, ("qd",), way)), (True,))


def _projection(state: State) -> Formula:
    mechanism = state.mechanism
    n, rows = mechanism.n, len(mechanism.rows)
    Psi = joint_jacobian(state)
    normal = [{c: _dot(Psi[r], Psi[c]) for c in range(r, rows)} for r in range(rows)]
    outputs: list[Value] = []
    pivots: list[Value] = []
    rates: list[Value] = list(state.relative["qd"])
    gap = [_gap(state, r) for r in range(rows)]
    speed = [_dot(Psi[r], rates) for r in range(rows)]
    for name, right in (("q", gap), ("qd", speed)):
        multipliers, pivots = _solve_symmetric(normal, right, 0)
        for k in range(n):
            column = [row[k] for row in Psi]
            outputs.append(state.relative[name][k] - _dot(column, multipliers))
    sizes = [row.size**2 for row in mechanism.rows]
    relative = tuple(pivot / size for pivot, size in zip(pivots, sizes, strict=True))
    return Formula(state.inputs, (*outputs, *gap), relative)


def _gap(state: State, row: int) -> Value:
    """Re(P E) + angles alpha + offset."""
    entry = state.mechanism.rows[row]
    gap: Value = entry.offset
    for k, weight in entry.P:
        gap = gap + real(weight, state, k)
    for k, turn in entry.angles:
        gap = gap + turn * state.alpha[k]
    return gap


def _dot(a: Sequence[Value], b: Sequence[Value]) -> Value:
    total: Value = 0.0
    for x, y in zip(a, b, strict=True):
        total = total + x * y
    return total


def _product(entries: dict[int, Value], values: Sequence[Value]) -> Value:
    return _dot(list(entries.values()), [values[k] for k in entries])


def _jacobian(state: State) -> list[dict[int, Value]]:
    """The rows of Psi in alpha, angles_k - Im(P_k E_k): a row has one of the two."""
    return [
        {k: imaginary(-weight, state, k) for k, weight in row.P} | dict(row.angles)
        for row in state.mechanism.rows
    ]


def joint_jacobian(state: State) -> list[list[Value]]:
    """Psi, row by row."""
    joints = range(state.mechanism.n)
    dense = ([entries.get(k, 0.0) for k in joints] for entries in _jacobian(state))
    return [to_joints(state.mechanism, row) for row in dense]


def closure_bends(state: State) -> list[Value]:
    """-Psidot qd, row by row: Re(P E alphad^2)."""
    rates = state.absolute("qd")
    bends: list[Value] = []
    for row in state.mechanism.rows:
        bend: Value = 0.0
        for k, weight in row.P:
            bend = bend + real(weight, state, k) * (rates[k] * rates[k])
        bends.append(bend)
    return bends


def _solve_symmetric(
    matrix: list[dict[int, Value]], right: list[Value], positive: int
) -> tuple[list[Value], list[Value]]:
    """L D L^T without pivoting on the upper triangle; the first `positive` pivots are positive.

    Returns the solution and the other pivots, those of the closures.
    """
    size = len(right)
    rows = [dict(row) for row in matrix]
    right = list(right)
    pivots: list[Value] = []
    inverse: list[Value] = []
    for i in range(size):
        pivot = rows[i].pop(i, 0.0)
        pivots.append(pivot)
        inverse.append(1.0 / pivot)
        columns = sorted(rows[i])
        for a, j in enumerate(columns):
            factor = rows[i][j] * inverse[i]
            for k in columns[a:]:
                rows[j][k] = rows[j].get(k, 0.0) - factor * rows[i][k]
            right[j] = right[j] - factor * right[i]
    for i in reversed(range(size)):
        total = right[i]
        for j, value in rows[i].items():
            total = total - value * right[j]
        right[i] = total * inverse[i]
    return right, pivots[positive:]
