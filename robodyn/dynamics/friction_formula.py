"""Forward dynamics with friction by the forces in pins and slides, as a formula.

The formula of `friction_rounds.py`: what is eliminated once serves the mechanism without this
friction and a unit of friction at each contact.  The forces in contacts are linear in the
accelerations and multipliers, so their slopes give B.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from robodyn.dynamics.pin_friction import sizes, slips
from robodyn.dynamics.reaction_forces import sides_of
from robodyn.dynamics.reaction_formulas import felt_formulas, placed_formulas, planar_values
from robodyn.engines import expression
from robodyn.engines.arithmetic import Planar
from robodyn.engines.expression import Value, substituted, tangents
from robodyn.engines.formulas import (
    Formula,
    Recorded,
    closure_pivots,
    forward_system,
    joint_jacobian,
    series_power,
    written,
)
from robodyn.engines.rounds import Rounds
from robodyn.engines.series import relative
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.parts import without_rubbing


@lru_cache(maxsize=64)
def rubbed_formula(
    mechanism: Mechanism,
    torques: tuple[float, ...] | None = None,
    baumgarte: float = 0.0,
    power: bool = False,
) -> Formula | None:
    """`formulas.forward_formula` with friction, by variables f0, f1, ... that `rounds` settle."""
    plain = without_rubbing(mechanism)

    def write(by_direction: bool) -> Formula:
        rates = ("qd", "tau") if torques is None else ("qd",)
        state = Recorded(plain, rates, by_direction)
        return _rubbed(mechanism, state, torques, baumgarte, power)

    return written(plain, write)


def _rubbed(
    mechanism: Mechanism,
    state: Recorded,
    torques: Sequence[float] | None,
    baumgarte: float,
    power: bool,
) -> Formula:
    plain, n, graph = state.mechanism, mechanism.n, state.graph
    contacts, rows = mechanism.rubbing, range(len(mechanism.rows))
    series, factors, right = forward_system(state, torques, baumgarte, power)
    at = placed_formulas(state)
    D, along = slips(mechanism, at)
    first = factors.solve(right)
    caused = [factors.solve([*_absolute(plain, row), *(0.0 for _ in rows)]) for row in D]
    # the forces in contacts, and their slopes
    names = [f"a{k}" for k in range(n)] + [f"l{r}" for r in rows]
    unknown = [graph.variable(name) for name in names]
    a, lam = unknown[:n], unknown[n:]
    bent = at.accelerations(plain, planar_values(state.absolute("qd")), planar_values(a))
    joints = relative(plain, a)
    felt = felt_formulas(state, at, bent, (a, joints), lam, joint_jacobian(state, series))
    rubs = any(x.joint is not None for x in contacts)
    R, carried = felt.reactions() if rubs else (), sides_of(plain)

    def within(i: int, force: complex) -> Planar:
        """The part of a force on the link of a joint that makes friction there."""
        if contacts[i].radius is None:
            return (along[i].conjugate() * force).imag, 0.0
        return force.real, force.imag

    forces: list[Planar] = []
    for i, contact in enumerate(contacts):
        if contact.closure is not None:
            pin = felt.pins[contact.closure]
            forces.append((pin.real, pin.imag))
        else:
            assert contact.joint is not None
            forces.append(within(i, R[contact.joint]))
    parts = [x for force in forces for x in force]
    slopes = tangents(parts, names)
    moved = [
        dict(zip(names, [*x[:n], *(-m for m in x[n:])], strict=True)) for x in (first, *caused)
    ]
    flat = substituted(parts, moved[0])
    N = list(zip(flat[::2], flat[1::2], strict=True))
    B: list[list[Planar]] = []
    for j, pushing in enumerate(contacts):
        by = [sum((s * moved[j + 1][name] for name, s in each.items()), 0.0) for each in slopes]
        row = list(zip(by[::2], by[1::2], strict=True))
        if pushing.closure is not None and pushing.radius is None:  # it pushes its sides
            for i, contact in enumerate(contacts):
                if contact.joint is not None and (side := carried[pushing.closure, contact.joint]):
                    x, y = within(i, along[j] * -side)
                    row[i] = row[i][0] + x, row[i][1] + y
        B.append(row)
    rates = state.relative["qd"]
    speeds = [sum((d * qd for d, qd in zip(row, rates, strict=True)), 0.0) for row in D]
    each = zip(sizes(mechanism), speeds, contacts, strict=True)
    part = [-size * expression.call("tanh", v * (1.0 / x.speed)) for size, v, x in each]
    # with friction
    f = [graph.variable(f"f{i}") for i in range(len(contacts))]
    solution = [
        sum((fi * x[k] for fi, x in zip(f, caused, strict=True)), value)
        for k, value in enumerate(first)
    ]
    series.complete(solution)
    own_power = [
        sum((fi * v for fi, v in zip(f, speeds, strict=True)), x)
        for x in series_power(series, power)
    ]
    outputs = (*relative(plain, solution[:n]), *(-x for x in solution[n:]), *own_power)
    inputs, pivots = state.inputs + state.timed, closure_pivots(state, factors)
    return Formula(inputs, outputs, pivots, rounds=Rounds(part, N, B))


def _absolute(mechanism: Mechanism, load: Sequence[Value]) -> list[Value]:
    """J^-T times a load (n) at the joints: what acts on x."""
    found = list(load)
    for k, above in enumerate(mechanism.above):
        if above is not None:
            found[above] = found[above] - load[k]
    return found
