"""What a model says of its actuated joints' torques: to rest, and to be accelerated.

With the accelerations v of the actuated joints given, those of the others follow from the closures,

    Psi_p qdd_p = -Psidot qd - Psi_a v,

and the torques from the inverse dynamics.  A controller asks at every evaluation of a simulation,
so both are written out as code on floats wherever the closures' system is no larger than 2 x 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from robodyn.dynamics import dynamics
from robodyn.dynamics.dense_dynamics import check_actuators, required_load
from robodyn.engines import formulas, straightline
from robodyn.engines.expression import Value
from robodyn.engines.factors import small_system
from robodyn.engines.formulas import Formula, Recorded
from robodyn.errors import InputError
from robodyn.loops import loop_rates
from robodyn.loops.closing import regular_rank
from robodyn.mechanics import parts
from robodyn.mechanics.mechanism import Mechanism

Floats = Callable[..., Sequence[float]]


def rest_torques(mechanism: Mechanism) -> Floats:
    """A function of q (n floats) to the torques (actuated) that hold the mechanism at rest, N m.

    Of an open chain with passive joints, those of the actuated joints alone.  Raises RobodynError
    where a closed mechanism has fewer actuators than freedoms; the function, SingularError.
    """
    mechanism = parts.untimed(mechanism)
    if mechanism.rows:
        check_actuators(mechanism, np.zeros(mechanism.n))
    n, driven = mechanism.n, list(mechanism.actuated)
    zero = np.zeros(n)

    def otherwise(*values: float) -> Sequence[float]:
        q = np.array(values)
        if not mechanism.rows:
            load = required_load(mechanism, q, zero, zero)
        else:
            load = dynamics.inverse_dynamics(mechanism, q, zero, zero)
        torques: list[float] = load[driven].tolist()
        return torques

    return _compiled(mechanism, True, otherwise)


def driving_torques(mechanism: Mechanism) -> Floats:
    """A function of q, qd (n floats each), v (actuated) to the torques (actuated), N m.

    v are the accelerations that the actuated joints get, rad/s^2.  Raises RobodynError where the
    mechanism has fewer actuators than freedoms, InputError where it has more, as then v would
    contradict the closures; the function raises SingularError at a dead centre.
    """
    mechanism = parts.untimed(mechanism)
    check_actuators(mechanism, np.zeros(mechanism.n))
    n, driven = mechanism.n, list(mechanism.actuated)
    freedoms = n - (regular_rank(mechanism) if mechanism.rows else 0)
    if len(driven) > freedoms:
        limit = "needs as many actuators as freedoms: their accelerations follow from one another"
        raise InputError(
            "computed torque",
            where=mechanism.source,
            value=f"{len(driven)} actuators for a mobility of {freedoms}",
            limit=limit,
        )

    def otherwise(*values: float) -> Sequence[float]:
        q, qd, v = (np.array(x) for x in (values[:n], values[n : 2 * n], values[2 * n :]))
        if not all(np.isfinite(x).all() for x in (q, qd, v)):
            return [np.nan] * len(driven)
        qdd = loop_rates.loop_accelerations(mechanism, q, qd, v)
        torques: list[float] = dynamics.inverse_dynamics(mechanism, q, qd, qdd)[driven].tolist()
        return torques

    return _compiled(mechanism, False, otherwise)


def _compiled(mechanism: Mechanism, rests: bool, otherwise: Floats) -> Floats:
    """The formula as code; `otherwise` where there is none, or a closure's pivot is small."""
    rows = len(mechanism.rows)
    determined = not rows or (rows <= 2 and len(mechanism.passive) == rows)
    if mechanism.n > formulas.MAX_GENERATED or not determined:
        return otherwise

    formula = formulas.written(mechanism, partial(_formula, mechanism, rests))
    if formula is None:
        return otherwise
    code = straightline.compile_floats(formula, "torques")
    if not rows:
        return code
    count = len(formula.outputs)

    def guarded(*values: float) -> Sequence[float]:
        try:
            found = code(*values)
        except ZeroDivisionError:
            return otherwise(*values)
        if min(found[count:]) > dynamics.PIVOT_CUT:
            return found[:count]
        return otherwise(*values)

    return guarded


def _formula(mechanism: Mechanism, rests: bool, by_direction: bool) -> Formula:
    """Torques of the actuated joints from q, or from q, qd and the actuated joints' qdd."""
    n, driven = mechanism.n, mechanism.actuated
    state = Recorded(mechanism, ("qd", "qdd"), by_direction)
    inputs = state.inputs[:n]
    if rests:
        state.relative["qd"] = state.relative["qdd"] = [0.0] * n
    else:
        inputs = state.inputs[: 2 * n] + tuple(f"qdd{k}" for k in driven)
        if mechanism.rows:
            _complete(state)
    whole = formulas.inverse_of(state)
    return Formula(inputs, tuple(whole.outputs[k] for k in driven), whole.pivots)


def _complete(state: Recorded) -> None:
    """Let the passive joints' qdd follow from the others'."""
    mechanism = state.mechanism
    qdd = state.relative["qdd"]
    series = state.series([0.0] * mechanism.n)
    opening = series.residuals(0)[mechanism.n :]  # Psidot qd
    Psi = formulas.joint_jacobian(state, series)
    right: list[Value] = []
    for x, row in zip(opening, Psi, strict=True):
        total = -x
        for k in mechanism.actuated:
            total = total - row[k] * qdd[k]
        right.append(total)
    columns = [[row[p] for p in mechanism.passive] for row in Psi]
    found, _ = small_system(columns, right)
    for p, value in zip(mechanism.passive, found, strict=True):
        qdd[p] = value
