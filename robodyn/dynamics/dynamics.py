"""Inverse and forward dynamics of open and closed mechanisms, and the forces in the loops.

Equation (1) of `closed_form.py` is solved, with its closures differentiated twice:

    M qdd + C qd + D qd + G = S^T tau_act + Q + Psi^T lambda,     Psi qdd + Psidot qd = 0

(S selects the actuated joints).  Eliminating lambda from it gives the textbook's equation (33).
Large batches run through the generated code of `straightline.py`; small ones, and the few states
that are near singular, through `dense_dynamics.py`, which also works where M alone is singular but
the constrained system is not, and where closures depend on one another.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import lru_cache, partial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics import closed_form, dense_dynamics
from robodyn.dynamics.closed_form import finite, n_wide
from robodyn.dynamics.dense_dynamics import (
    MASS_CUT,
    RANK_CUT,
    Accelerations,
    Torques,
    check_actuators,
    elimination_is_safe,
    required_load,
)
from robodyn.engines import formulas
from robodyn.engines.formula_rows import FormulaRows
from robodyn.engines.formulas import Formula
from robodyn.errors import InputError, SingularError
from robodyn.loops import change_points, projection
from robodyn.loops.closing import NEAR_SINGULAR, close_positions
from robodyn.mechanics.mechanism import Mechanism

Array = NDArray[np.float64]

PIVOT_CUT = 1e-3  # generated code is trusted while the closures' relative pivots exceed this
BATCH = 200  # from so many states on generated array code wins, its generation included


class RobodynWarning(UserWarning):
    """A result that is right but not the only one, or near a limit."""


Solution = TypeVar("Solution", Torques, Accelerations)


def inverse_dynamics(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """The joint torques tau of equation (1) that the motion needs, (..., n), N m.

    q, qd, qdd are (..., n) and broadcast; a closed mechanism's must keep its closures (see
    `assembly`).  Passive joints get zero.  With more actuators than freedoms tau is the one of
    least norm, with a RobodynWarning.  Raises InputError for arrays that do not fit, RobodynError
    where the mechanism has fewer actuators than freedoms, SingularError where no torque at the
    actuated joints can make the motion.
    """
    return _inverse_batch(mechanism, q, qd, qdd, arrays=1).tau


def inverse_dynamics_and_forces(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
) -> Torques:
    """`inverse_dynamics` and the multipliers of the closures; see there."""
    return _inverse_batch(mechanism, q, qd, qdd, arrays=2)


def _inverse_batch(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, arrays: int
) -> Torques:
    states = _states(mechanism, q=q, qd=qd, qdd=qdd)
    check_actuators(mechanism, states["q"])
    rows = _generated("inverse", mechanism) if _worth(mechanism, states["q"]) else None
    if rows is None:
        return _warned(_inverse(mechanism, *_finite(states)))
    return _warned(Torques(*_run(mechanism, rows, _inverse, states, arrays)))


def forward_dynamics(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> Array:
    """The accelerations qdd of equation (1) that the joint torques tau cause, (..., n), rad/s^2.

    q, qd, tau are (..., n) and broadcast; a closed mechanism's q and qd must keep its closures.
    Raises InputError for arrays that do not fit, SingularError where a freedom has no inertia.
    """
    return _forward_batch(mechanism, q, qd, tau, arrays=1).qdd


def forward_dynamics_and_forces(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, tau: ArrayLike
) -> Accelerations:
    """`forward_dynamics` and the multipliers of the closures; see there."""
    return _forward_batch(mechanism, q, qd, tau, arrays=2)


def _forward_batch(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, tau: ArrayLike, arrays: int
) -> Accelerations:
    states = _states(mechanism, q=q, qd=qd, tau=tau)
    rows = None
    if _worth(mechanism, states["q"]) and _regular_everywhere(mechanism):
        rows = _generated("forward", mechanism)
    if rows is None:
        return _warned(_forward(mechanism, *_finite(states)))
    return _warned(Accelerations(*_run(mechanism, rows, _forward, states, arrays)))


def _forward(mechanism: Mechanism, q: Array, qd: Array, tau: Array) -> Accelerations:
    """`dense_dynamics.forward`; next to a change point that of the motion which leads across."""
    if not mechanism.rows or not q.size:
        return dense_dynamics.forward(mechanism, q, qd, tau)
    Psi = closed_form.closure_jacobian(mechanism, q)
    near = change_points.nearness(mechanism, Psi)
    close = near < NEAR_SINGULAR
    if close.any():  # there a state must keep the closures to its last digit
        q = q.copy()
        q[close] = close_positions(mechanism, q[close])
    found = dense_dynamics.forward(mechanism, q, qd, tau)
    qdd, multipliers, quality = found.qdd, found.multipliers, near**2
    for state in map(tuple, np.argwhere(quality < change_points.SUSPECT)):
        beside = partial(_accelerations_beside, mechanism, tau[state])
        led = _lead_across(mechanism, (q[state], qd[state]), beside)
        if led is not None:
            qdd[state] = led
            load = required_load(mechanism, q[state], qd[state], qdd[state]) - tau[state]
            multipliers[state] = np.linalg.pinv(Psi[state].T, rcond=RANK_CUT) @ load
    missed = change_points.miss_remark(mechanism, q[quality < change_points.SUSPECT])
    return found._replace(remark="; ".join(filter(None, (found.remark, missed))))


def _inverse(mechanism: Mechanism, q: Array, qd: Array, qdd: Array) -> Torques:
    """`dense_dynamics.inverse`; at a change point the limit along the motion that leads across."""
    try:
        found = dense_dynamics.inverse(mechanism, q, qd, qdd)
        if not mechanism.rows or not q.size:
            return found
        near = change_points.nearness(mechanism, closed_form.closure_jacobian(mechanism, q))
        missed = change_points.miss_remark(mechanism, q[near < change_points.NEAR])
        return found._replace(remark="; ".join(filter(None, (found.remark, missed))))
    except SingularError:
        if not mechanism.rows:
            raise
        if mechanism.springs:  # one without a direction is no change point: it raises here again
            required_load(mechanism, q, qd, qdd)
        if q.ndim > 1:
            states = [x.reshape(-1, mechanism.n) for x in (q, qd, qdd)]
            each = [_inverse(mechanism, *state) for state in zip(*states, strict=True)]
            tau = np.reshape([x.tau for x in each], q.shape)
            multipliers = np.reshape([x.multipliers for x in each], (*q.shape[:-1], -1))
            return Torques(tau, multipliers, max((x.remark for x in each), key=len))
        beside = partial(_torques_beside, mechanism, qdd)
        led = _lead_across(mechanism, (q, qd), beside)
        if led is None:
            raise
        tau = led
    load = required_load(mechanism, q, qd, qdd) - tau
    Psi_T = closed_form.closure_jacobian(mechanism, q).T
    multipliers = np.linalg.pinv(Psi_T, rcond=RANK_CUT) @ load
    remark = "change point: torques of the motion straight across; pin forces are not unique there"
    return Torques(tau, multipliers, remark)


def _accelerations_beside(mechanism: Mechanism, tau: Array, q: Array, qd: Array) -> Array:
    return dense_dynamics.forward(mechanism, q, qd, tau).qdd


def _torques_beside(mechanism: Mechanism, qdd: Array, q: Array, qd: Array) -> Array:
    """The torques of closed states (k, n) for the accelerations nearest to qdd (n,) that close."""
    Psi = closed_form.closure_jacobian(mechanism, q)
    opening = np.einsum("kij,j->ki", Psi, qdd) + closed_form.closure_bias(mechanism, q, qd)
    closing = np.einsum("kij,kj->ki", np.linalg.pinv(Psi, rcond=RANK_CUT), opening)
    return dense_dynamics.inverse(mechanism, q, qd, qdd - closing).tau


def _lead_across(
    mechanism: Mechanism,
    state: tuple[Array, Array],
    evaluate: Callable[[Array, Array], Array],
) -> Array | None:
    """`change_points.lead_across` of a function of q and qd."""
    n = mechanism.n
    near = change_points.nearest_singular(mechanism, state[0])
    if near is None or not near.crosses:
        return None
    closing = projection.dense_closing(mechanism)
    return change_points.lead_across(
        mechanism,
        closing,
        np.concatenate(state),
        near,
        lambda states: evaluate(states[:, :n], states[:, n:]),
    )


def pin_forces(mechanism: Mechanism, multipliers: ArrayLike) -> Array:
    """The force on the side of each closure that is named first, (..., closures, 2), N.

    `multipliers` (..., r) are those of `inverse_dynamics_and_forces` and the like.
    """
    lam = np.asarray(multipliers, float)
    forces = np.zeros((*lam.shape[:-1], len(mechanism.description.closures), 2))
    for row, entry in enumerate(mechanism.rows):
        if entry.closure is None:
            continue
        forces[..., entry.closure, 0] += lam[..., row] * entry.direction.real
        forces[..., entry.closure, 1] += lam[..., row] * entry.direction.imag
    return forces


def coupling_torques(mechanism: Mechanism, multipliers: ArrayLike) -> Array:
    """What each coupling puts on the joint that its equation gives, (..., couplings), N m.

    `multipliers` (..., r) are those of `inverse_dynamics_and_forces` and the like.  The joints on
    the other side feel the opposite, times their ratios.
    """
    lam = np.asarray(multipliers, float)
    first = len(mechanism.rows) - len(mechanism.description.couplings)
    torques: Array = lam[..., first:] * np.array([row.arm for row in mechanism.rows[first:]])
    return torques


def loop_forces(mechanism: Mechanism, multipliers: ArrayLike) -> Array:
    """Pin forces and torques of couplings side by side, (..., 2 closures + couplings)."""
    pins = pin_forces(mechanism, multipliers)
    torques = coupling_torques(mechanism, multipliers)
    return np.concatenate([pins.reshape(*pins.shape[:-2], -1), torques], axis=-1)


def _warned(solution: Solution) -> Solution:
    if solution.remark:
        warnings.warn(solution.remark, RobodynWarning, stacklevel=4)
    return solution


# -- generated code over batches -----------------------------------------------------------------


def _states(mechanism: Mechanism, **values: ArrayLike) -> dict[str, Array]:
    """Arrays (..., n) of one shape by their names; whether they are finite is not asked yet."""
    arrays = [n_wide(mechanism, name, value) for name, value in values.items()]
    try:
        return dict(zip(values, np.broadcast_arrays(*arrays), strict=True))
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise InputError("shapes", value=shapes, limit="must broadcast to one another") from None


def _finite(states: dict[str, Array]) -> list[Array]:
    return [finite(name, array) for name, array in states.items()]


def _worth(mechanism: Mechanism, q: Array) -> bool:
    return q.size >= BATCH * mechanism.n and mechanism.n <= formulas.MAX_GENERATED


@lru_cache(maxsize=64)
def _regular_everywhere(mechanism: Mechanism) -> bool:
    """Whether M can be eliminated at every configuration: no state of a batch need be asked.

    x^T M x = Re((E x)^H A (E x)) in absolute angles: M has no eigenvalue below A's least, whatever
    the angles.
    """
    if not elimination_is_safe(mechanism):
        return False
    A = mechanism.arrays.A
    scale = np.sqrt(A.diagonal().real)
    return bool(np.linalg.eigvalsh(A / (scale[:, None] * scale))[0] > MASS_CUT)


@lru_cache(maxsize=64)
def _generated(kind: str, mechanism: Mechanism) -> FormulaRows | None:
    """The formula over batches; None where there is none."""

    def record(parameters: bool) -> Formula | None:
        if kind == "inverse":
            return formulas.inverse_formula(mechanism, parameters)
        return formulas.forward_formula(mechanism, parameters=parameters)

    formula = record(False)
    if formula is None:
        return None
    return FormulaRows(formula, record, (mechanism.n, len(mechanism.rows)), PIVOT_CUT)


def _run(
    mechanism: Mechanism,
    rows: FormulaRows,
    dense: Callable[[Mechanism, Array, Array, Array], Torques | Accelerations],
    states: dict[str, Array],
    arrays: int,
) -> tuple[Array, Array, str]:
    """Joint values (..., n), multipliers (..., r) where two `arrays` are wanted, and a remark."""
    shape, remark = states["q"].shape[:-1], ""
    flat = [state.reshape(-1, mechanism.n) for state in states.values()]
    found, doubtful = rows.run(flat, arrays, check=lambda: _finite(states))
    if doubtful.size:
        solution = dense(mechanism, *(state[doubtful] for state in flat))
        for array, values in zip(found, solution[:2], strict=False):
            array[doubtful] = values
        remark = solution.remark
    joints, forces, *_ = (*found, np.zeros((0, 0)))
    if arrays > 1:
        forces = forces.reshape(*shape, -1) if forces.size else np.zeros((*shape, forces.shape[1]))
    return joints.reshape(*shape, -1), forces, remark
