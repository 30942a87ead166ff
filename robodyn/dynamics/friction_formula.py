"""Forward dynamics with friction by the forces in pins and slides, as a formula.

This is the formula of `friction_rounds.py`: one factorisation serves the mechanism without this
friction and a unit of friction at each contact.  The forces in contacts are linear in accelerations
and multipliers, so their derivatives give B.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.pin_friction import sizes, slips
from robodyn.dynamics.reaction_forces import sides_of
from robodyn.dynamics.reaction_formulas import felt_formulas, placed_formulas, planar_values
from robodyn.engines import expression
from robodyn.engines.arithmetic import Planar
from robodyn.engines.expression import Tangents, Value, substituted, tangents
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
from robodyn.engines.straightline import compile_floats
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.parts import without_rubbing
from robodyn.tables.arrays import Array, Complex


@lru_cache(maxsize=64)
def rubbed_formula(
    mechanism: Mechanism,
    torques: tuple[float, ...] | None = None,
    baumgarte: float = 0.0,
    power: bool = False,
) -> Formula | None:
    """Return `formulas.forward_formula` with friction, in variables f0, f1, ... of `rounds`."""
    plain = without_rubbing(mechanism)

    def write(by_direction: bool) -> Formula:
        rates = ("qd", "tau") if torques is None else ("qd",)
        state = Recorded(plain, rates, by_direction)
        return _rubbed(mechanism, state, torques, baumgarte, power)

    return written(plain, write)


class Contacts(NamedTuple):
    """The c contacts of a state as formulas; forces are forces + slopes [xdd; lam] + push f.

    D (c, n) has rows of slip rates, `part` (c) factors of the forces.  `forces` (c) are planar,
    without accelerations, multipliers and friction; `slopes` (2 c) are derivatives of their x and y
    by these, by name; push[j][i] (c, c) is planar.
    """

    D: NDArray[Any]
    speeds: list[Value]
    part: list[Value]
    names: list[str]
    forces: list[Value]  # x and y side by side, by the named unknowns
    slopes: list[Tangents]
    push: list[list[Planar]]


def contacts_of(mechanism: Mechanism, state: Recorded, Psi: Sequence[Sequence[Value]]) -> Contacts:
    """Return the contacts of a recorded state without friction; Psi (r, n) in joints."""
    plain, n, graph = state.mechanism, mechanism.n, state.graph
    contacts, rows = mechanism.rubbing, range(len(mechanism.rows))
    at = placed_formulas(state)
    D, along = slips(mechanism, at)
    names = [f"a{k}" for k in range(n)] + [f"l{r}" for r in rows]
    unknown = [graph.variable(name) for name in names]
    a, lam = unknown[:n], unknown[n:]
    bent = at.accelerations(plain, planar_values(state.absolute("qd")), planar_values(a))
    felt = felt_formulas(state, at, bent, (a, relative(plain, a)), lam, Psi)
    rubs = any(x.joint is not None for x in contacts)
    R, carried = felt.reactions() if rubs else (), sides_of(plain)

    def within(i: int, force: complex) -> Planar:
        """Return the component of a force on a joint's link that causes friction there."""
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
    push = []
    for j, pushing in enumerate(contacts):
        row: list[Planar] = [(0.0, 0.0)] * len(contacts)
        if pushing.closure is not None and pushing.radius is None:  # it pushes its sides
            for i, contact in enumerate(contacts):
                if contact.joint is not None and (side := carried[pushing.closure, contact.joint]):
                    row[i] = within(i, along[j] * -side)
        push.append(row)
    rates = state.relative["qd"]
    speeds = [sum((d * qd for d, qd in zip(row, rates, strict=True)), 0.0) for row in D]
    each = zip(sizes(mechanism), speeds, contacts, strict=True)
    part = [-size * expression.call("tanh", v * (1.0 / x.speed)) for size, v, x in each]
    return Contacts(D, speeds, part, names, parts, tangents(parts, names), push)


def _rubbed(
    mechanism: Mechanism,
    state: Recorded,
    torques: Sequence[float] | None,
    baumgarte: float,
    power: bool,
) -> Formula:
    plain, n, graph = state.mechanism, mechanism.n, state.graph
    rows = range(len(mechanism.rows))
    series, factors, right = forward_system(state, torques, baumgarte, power)
    own = contacts_of(mechanism, state, joint_jacobian(state, series))
    first = factors.solve(right)
    caused = [factors.solve([*_absolute(plain, row), *(0.0 for _ in rows)]) for row in own.D]
    moved = [
        dict(zip(own.names, [*x[:n], *(-m for m in x[n:])], strict=True)) for x in (first, *caused)
    ]
    flat = substituted(own.forces, moved[0])
    N = list(zip(flat[::2], flat[1::2], strict=True))
    B: list[list[Planar]] = []
    for by, pushed in zip(moved[1:], own.push, strict=True):
        made = [sum((s * by[name] for name, s in each.items()), 0.0) for each in own.slopes]
        each = zip(made[::2], made[1::2], pushed, strict=True)
        B.append([(x + z[0], y + z[1]) for x, y, z in each])
    # with friction
    f = [graph.variable(f"f{i}") for i in range(len(caused))]
    solution = [
        sum((fi * x[k] for fi, x in zip(f, caused, strict=True)), value)
        for k, value in enumerate(first)
    ]
    series.complete(solution)
    own_power = [
        sum((fi * v for fi, v in zip(f, own.speeds, strict=True)), x)
        for x in series_power(series, power)
    ]
    outputs = (*relative(plain, solution[:n]), *(-x for x in solution[n:]), *own_power)
    inputs, pivots = state.inputs + state.timed, closure_pivots(state, factors)
    return Formula(inputs, outputs, pivots, rounds=Rounds(own.part, N, B))


class ContactsAt(NamedTuple):
    """`Contacts` at a state: D (c, n), part (c), N (c) at rest, slopes (c, n + r), push (c, c)."""

    D: Array
    part: Array
    N: Complex
    slopes: Complex
    push: Complex


@lru_cache(maxsize=64)
def contacts_at(mechanism: Mechanism) -> Callable[[float, Array, Array], ContactsAt]:
    """Return a function of t, q and qd (n,) of one state; slopes are by qdd and multipliers."""
    plain, n, c = without_rubbing(mechanism), mechanism.n, len(mechanism.rubbing)
    state = Recorded(plain, ("qd",), True)
    series = state.series([0.0] * n)
    series.residuals(0)
    own = contacts_of(mechanism, state, joint_jacobian(state, series))
    rest = substituted(own.forces, dict.fromkeys(own.names, 0.0))
    slopes = [each.get(name, 0.0) for each in own.slopes for name in own.names]
    push = [x for row in own.push for z in row for x in z]
    outputs = (*own.D.ravel().tolist(), *own.part, *rest, *slopes, *push)
    run = compile_floats(Formula(state.inputs + state.timed, outputs, ()), "contacts")
    width, timed = len(own.names), bool(state.timed)
    ends = np.cumsum([c * n, c, 2 * c, 2 * c * width])
    J = np.eye(width)
    J[:n, :n] = mechanism.arrays.J

    def at(t: float, q: Array, qd: Array) -> ContactsAt:
        values = np.array(run(*q.tolist(), *qd.tolist(), *([t] if timed else [])))
        D, part, N, slope, pushed = np.split(values, ends)
        sides = slope.reshape(c, 2, width)
        return ContactsAt(
            D.reshape(c, n),
            part,
            N[::2] + 1j * N[1::2],
            (sides[:, 0] + 1j * sides[:, 1]) @ J,
            (pushed[::2] + 1j * pushed[1::2]).reshape(c, c),
        )

    return at


def _absolute(mechanism: Mechanism, load: Sequence[Value]) -> list[Value]:
    """Return J^-T times a load (n) at the joints: the load on x."""
    found = list(load)
    for k, above in enumerate(mechanism.above):
        if above is not None:
            found[above] = found[above] - load[k]
    return found
