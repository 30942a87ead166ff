"""Y(q, qd, qdd) with tau = Y pi + known: the regressor of inverse dynamics, open or closed.

The torques are linear in the parameters pi, so the columns of Y are the
tangents of the formula of inverse dynamics, exact; what is left at pi = 0 is known.  Where no
formula eliminates the pins' forces, the columns are loads that actuators and pins must balance.

Parameters are masses, moments, dampers, friction, springs.  Of link k, its payload included, with r
its centre of gravity in its own frame:

    m_k    mass                             mx_k, my_k    first moment m r
    J_k    inertia about its own joint      d_k           damping at its joint, all of it
    f_k    friction, fs_k its static one    Jr_k          inertia of the rotor at its joint
    fp_k, fn_k, fsp_k, fsn_k                friction that differs with the sign of the rate
    k_i    stiffness of spring i            ds_i          damping of spring i between points

Damping of a rotor and of springs at joints is part of d_k.  Loads, laws of springs and stops have
no parameter: what they do is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.dense_dynamics import balanced
from robodyn.dynamics.dynamics import PIVOT_CUT
from robodyn.dynamics.free_joints import balanced_joints, balanced_mechanism
from robodyn.dynamics.sticking import modes_of
from robodyn.elements.joints import DryFriction
from robodyn.elements.keys import WAYS, Declared
from robodyn.elements.springs import JointDamper
from robodyn.engines.batches import FormulaBatches
from robodyn.engines.expression import Graph, Value, slopes_by, substituted
from robodyn.engines.formulas import Formula, Recorded, balance, inverse_of, written
from robodyn.engines.planar_numbers import Planar
from robodyn.errors import SingularError
from robodyn.mechanics.driven import check_torques
from robodyn.mechanics.link_tree import Bodies, bodies
from robodyn.mechanics.mechanism import Mechanism, constants, joint_damping
from robodyn.mechanics.modes import in_mode
from robodyn.mechanics.placed import check_directions, finite, times_of, together
from robodyn.scene.scene import Description
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr

INERTIAL = ("m", "mx", "my", "J")
LISTS = ("springs", "loads")  # of elements


class Parameter(NamedTuple):
    """One of what the torques are linear in."""

    name: str  # m2, mx2, ..
    value: float
    unit: str


def linear_parameters(
    description: Description, damping: Sequence[float] | None = None
) -> tuple[Parameter, ...]:
    """Return the linear parameters of a scene with their values, by link, then by spring.

    `damping` (n) are joint dampers, if the mechanism has others than its scene.
    """
    found: list[Parameter] = []
    links = description.links
    damping = joint_damping(description) if damping is None else damping
    for k, (m, first, J) in enumerate(zip(*bodies(links), strict=True)):
        link, i = links[k], k + 1
        force, rate = ("N", "s/m") if link.slides else ("N m", "s/rad")
        found += [
            Parameter(f"m{i}", m, "kg"),
            Parameter(f"mx{i}", first.real, "kg m"),
            Parameter(f"my{i}", first.imag, "kg m"),
            Parameter(f"J{i}", J, "kg m²"),
            Parameter(f"d{i}", damping[k], f"{force} {rate}"),
        ]
        for x in link:
            if isinstance(x, Declared):
                found += _linear_numbers(x, i, link.slides)
    for name in LISTS:
        for i, element in enumerate(getattr(description, name), start=1):
            slides = element.at is not None and links[element.at].slides
            found += _linear_numbers(element, i, slides)
    return tuple(found)


def _linear_numbers(entry: Declared, i: int, slides: bool) -> Iterator[Parameter]:
    for field, key in entry.linear():
        value, unit = getattr(entry, field), key.of(slides).unit
        if isinstance(value, tuple):  # by direction
            each = zip(WAYS, value, strict=True)
            yield from (Parameter(f"{key.linear}{way}{i}", x, unit) for way, x in each)
        else:
            yield Parameter(f"{key.linear}{i}", value, unit)


def _with_linear(entry: Any, i: int, values: Mapping[str, Any]) -> Any:
    """The entry of the scene with these values; what is damped at its joint is among d_k."""
    letters = {field: key.linear for field, key in entry.keys.items() if key.linear}
    found: dict[str, Any] = {}
    for field, letter in letters.items():
        if isinstance(getattr(entry, field), tuple):
            found[field] = tuple(values.get(f"{letter}{way}{i}", 0.0) for way in WAYS)
        else:
            found[field] = values.get(f"{letter}{i}", 0.0)
    if "damping" in entry.keys and "damping" not in letters:
        found["damping"] = 0.0
    return entry._replace(**found)


def with_parameters(mechanism: Mechanism, values: Mapping[str, Any]) -> Mechanism:
    """The mechanism with these values, formulas or numbers, for all of its parameters.

    It serves for torques alone: its inertias and energies are not to be asked for.
    """
    base, links = mechanism.description, []
    for i, link in enumerate(base.links, start=1):
        friction, motor = link.friction, link.motor
        if friction is not None:
            friction = _with_linear(friction, i, values)
        if isinstance(friction, DryFriction) and friction.stribeck is None:
            friction = friction._replace(static=friction.torque)
        motor = motor and _with_linear(motor, i, values)
        links.append(link._replace(friction=friction, motor=motor))
    lists = {
        name: tuple(_with_linear(x, i, values) for i, x in enumerate(getattr(base, name), start=1))
        for name in LISTS
    }
    m, mx, my, J = ([values[f"{x}{k + 1}"] for k in range(len(links))] for x in INERTIAL)
    own = Bodies(m, [Planar(x, y) for x, y in zip(mx, my, strict=True)], J)  # type: ignore[misc]
    scene = base._replace(links=tuple(links), **lists)
    made = constants(with_formulas(scene), own)
    # d_k is all damping of a joint, also what other elements bring
    kept = [x for x in (*made.elements, *mechanism.added) if not isinstance(x, JointDamper)]
    kept += [JointDamper(k, values[f"d{k + 1}"]) for k in range(mechanism.n)]
    made = replace(made, elements=tuple(kept))
    if mechanism.mode is not None:
        made = in_mode(made, mechanism.mode)
    return replace(made, actuated=mechanism.actuated, rows=mechanism.rows, numeric=mechanism)


def with_formulas(value: Any) -> Any:
    """Return scene contents with complex numbers that accept formulas."""
    if isinstance(value, tuple):
        parts = map(with_formulas, value)
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return Planar(value.real, value.imag) if isinstance(value, complex) else value


RATES = ("qd", "qdd")
BLOCK = 4096  # states whose pins are balanced at once
RESTS = 1e-3  # of a joint's largest rate: below it the joint is at rest


@short_repr
class Regressor(NamedTuple):
    """Y (..., a, p) of a torques and p parameters, and what is `known` of these (..., a)."""

    Y: Array
    known: Array
    names: tuple[str, ...]  # (p,) of the parameters
    values: Array  # (p,) what they are in the scene


def regressor(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, t: ArrayLike = 0.0
) -> Regressor:
    """Y and what is known, so that the actuated joints' torques are Y @ values + known.

    Free joints count as actuated, see `free_joints.py`.  q, qd, qdd are (..., n) and broadcast.
    Raises as `inverse_dynamics` does, and InputError if laws of the time lead all joints.
    """
    mechanism.check_rubbing("regressors")
    mechanism = balanced_mechanism(mechanism)
    check_torques(mechanism)
    states = together(mechanism, {"q": q, "qd": qd, "qdd": qdd})
    for name, array in states.items():
        finite(name, array)
    shape, times = states["q"].shape[:-1], times_of(t, states["q"]).ravel()
    flat = {name: array.reshape(-1, mechanism.n) for name, array in states.items()}
    parameters = linear_parameters(mechanism.description, mechanism.damping)
    a, p = len(mechanism.actuated), len(parameters)
    if mechanism.switches:
        Y, known = np.empty((len(times), a * p)), np.empty((len(times), a))
        for mode, which in modes_of(mechanism, "inverse", flat, times).items():
            part = [x[which] for x in flat.values()]
            Y[which], known[which] = _smooth(in_mode(mechanism, mode), part, times[which])
    else:
        Y, known = _smooth(mechanism, list(flat.values()), times)
    names, values = (tuple(x.name for x in parameters), np.array([x.value for x in parameters]))
    return Regressor(Y.reshape(*shape, a, p), known.reshape(*shape, a), names, values)


def rows_at_rest(
    mechanism: Mechanism, states: Sequence[Array], rest: float | None
) -> NDArray[np.bool_]:
    """Return in which rows each torque's equation (T, a) has static friction of a joint at rest.

    A joint is at rest up to the rate `rest` (rad/s, m/s; None: RESTS of its largest). The friction
    of a joint that follows is in the equations of the joints that rest with it.
    """
    joints = balanced_joints(mechanism)
    named = dict(zip(("q", "qd", "qdd"), states, strict=True))
    rates = np.abs(together(mechanism, named)["qd"])
    slow = rates <= (RESTS * rates.max(axis=0, initial=0.0) if rest is None else rest)
    found = np.zeros((len(rates), len(joints)), bool)
    for k in mechanism.sticks:
        for i, joint in enumerate(joints):
            if joint == k or k not in joints:
                found[:, i] |= slow[:, k] & slow[:, joint]
    return found


def _smooth(mechanism: Mechanism, states: list[Array], times: Array) -> tuple[Array, Array]:
    """Y (T, a p) and what is known (T, a) of a mechanism whose equations are the same."""
    check_directions(mechanism, states[0])
    every = [*states, times[:, None]] if mechanism.timed else states
    solved = _rows(mechanism, True)
    if solved is None:
        return _shared_out(mechanism, every)
    (Y, known), doubtful = solved.run(every, 2, lambda: None)
    if doubtful.size:
        if not mechanism.rows:
            state = ", ".join(f"{x:.9g}" for x in states[0][doubtful[0]])
            limit = "the regressor is not finite: the ends of a spring coincide, or a table ends"
            raise SingularError(f"q = {state}", where=mechanism.source, limit=limit)
        Y[doubtful], known[doubtful] = _shared_out(mechanism, [x[doubtful] for x in every])
    return Y, known


def _shared_out(mechanism: Mechanism, every: list[Array]) -> tuple[Array, Array]:
    """The same from loads: what the actuators give of a unit of load at each joint."""
    rows, n = _rows(mechanism, False), mechanism.n
    assert rows is not None
    p, driven = len(linear_parameters(mechanism.description)), list(mechanism.actuated)
    found = np.empty((len(every[0]), len(driven), p + 1))
    for begin in range(0, len(found), BLOCK):
        part = [x[begin : begin + BLOCK] for x in every]
        (Y, known), _ = rows.run(part, 2, lambda: None)
        loads = np.concatenate([Y.reshape(-1, n, p), known[:, :, None]], axis=-1)
        unit = np.broadcast_to(np.eye(n), (len(part[0]), n, n))
        times = part[-1] if mechanism.timed else 0.0
        shares = balanced(mechanism, part[0][:, None], unit, times).tau[..., driven]
        found[begin : begin + BLOCK] = np.swapaxes(shares, -1, -2) @ loads
    return found[..., :p].reshape(len(found), -1), found[..., p]


@lru_cache(maxsize=64)
def _rows(mechanism: Mechanism, solved: bool) -> FormulaBatches | None:
    """Y and what is known of the actuated torques, where they are `solved` for, else of loads.

    None where there is no such formula.
    """
    if solved and (len(mechanism.passive) != len(mechanism.rows) or len(mechanism.rows) > 2):
        return None
    names = [x.name for x in linear_parameters(mechanism.description)]

    def write(by_direction: bool) -> Formula:
        graph = Graph()
        named = with_parameters(mechanism, {name: graph.variable(name) for name in names})
        state = Recorded(named, RATES, by_direction, graph=graph)
        pivots: tuple[Value, ...] = ()
        if solved:
            formula = inverse_of(state)
            tau, pivots = [formula.outputs[k] for k in mechanism.actuated], formula.pivots
        else:
            n = mechanism.n
            series = state.series([0.0] * n, accelerated=True)
            series.residuals(0)
            tau = balance(state, series)
        known = substituted(tau, dict.fromkeys(names, 0.0))
        return Formula(state.inputs + state.timed, (*slopes_by(tau, names), *known), pivots)

    formula = written(mechanism, write)
    if formula is None:
        return None
    count = len(mechanism.actuated) if solved else mechanism.n
    widths = (count * len(names), count)
    return FormulaBatches(formula, widths, PIVOT_CUT)
