"""Derivatives of inverse and forward dynamics, exact: by tangents of the program, no differences.

Of a closed mechanism q and qd are varied one by one, as if each joint were free, with the solution
of equation (1) for what follows: along directions that keep the closures that is what the mechanism
does (see `linear_model.py`); across them it is a matter of how equation (1) is written.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics import dynamics
from robodyn.dynamics.dense_dynamics import RANK_CUT, elimination_is_safe
from robodyn.dynamics.dynamics import PIVOT_CUT
from robodyn.dynamics.placed import absolute_rates, finite, n_wide
from robodyn.dynamics.sticking import modes_of
from robodyn.engines import formulas, straightline
from robodyn.engines.derivative_formulas import (
    forward_derivatives_formula,
    residual_derivatives_formula,
)
from robodyn.engines.formula_rows import FormulaRows
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode

Array = NDArray[np.float64]


class ForwardDerivatives(NamedTuple):
    """qdd (..., n), and d qdd_i / d q_j, d qd_j, d tau_j, each (..., n, n)."""

    qdd: Array
    by_q: Array
    by_qd: Array
    by_tau: Array


class InverseDerivatives(NamedTuple):
    """tau (..., n), and d tau_i / d q_j, d qd_j, d qdd_j, each (..., n, n)."""

    tau: Array
    by_q: Array
    by_qd: Array
    by_qdd: Array


def forward_dynamics_derivatives(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, tau: ArrayLike, t: ArrayLike = 0.0
) -> ForwardDerivatives:
    """The accelerations of `forward_dynamics`, and their derivatives.

    q, qd, tau are (..., n) and broadcast.  Where joints stick or rest at their ends they are those
    of the others.  Raises as `forward_dynamics` does.
    """
    return ForwardDerivatives(*_each(mechanism, "forward", t, q=q, qd=qd, tau=tau))


def inverse_dynamics_derivatives(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, t: ArrayLike = 0.0
) -> InverseDerivatives:
    """The torques of `inverse_dynamics`, and their derivatives, zero at passive joints.

    q, qd, qdd are (..., n) and broadcast.  Raises as `inverse_dynamics` does.
    """
    return InverseDerivatives(*_each(mechanism, "inverse", t, q=q, qd=qd, qdd=qdd))


def _each(mechanism: Mechanism, kind: str, t: ArrayLike, **given: ArrayLike) -> list[Array]:
    """The result and its three derivatives."""
    arrays = [n_wide(mechanism, name, value) for name, value in given.items()]
    try:
        states = dict(zip(given, np.broadcast_arrays(*arrays), strict=True))
        shape = states["q"].shape
        times = np.broadcast_to(finite("t", np.asarray(t, float)), shape[:-1]).ravel()
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise InputError("shapes", value=shapes, limit="must broadcast to one another") from None
    n = mechanism.n
    flat = {name: finite(name, array).reshape(-1, n) for name, array in states.items()}
    solve = _forward if kind == "forward" else _inverse
    if not mechanism.switches:
        found = solve(mechanism, list(flat.values()), times)
    else:
        found = [np.empty((len(times), n * m)) for m in (1, n, n, n)]
        for mode, which in modes_of(mechanism, kind, flat, times).items():
            moving = in_mode(mechanism, mode)
            part = solve(moving, [x[which] for x in flat.values()], times[which])
            for array, values in zip(found, part, strict=True):
                array[which] = values
    return [x.reshape(*shape[:-1], *((n,) if k == 0 else (n, n))) for k, x in enumerate(found)]


def _forward(mechanism: Mechanism, states: list[Array], t: Array) -> list[Array]:
    """qdd (T, n) at q, qd, tau, and its derivatives, each (T, n n)."""
    rows, n = _generated(mechanism), mechanism.n
    q, qd, tau = states
    found, doubtful = [np.empty((len(q), n * m)) for m in (1, n, n, n)], np.arange(len(q))
    if rows is not None:
        every = [*states, t[:, None]] if mechanism.timed else states
        found, doubtful = rows.run(every, 4, lambda: None)
    if doubtful.size:
        state = q[doubtful], qd[doubtful], tau[doubtful]
        qdd, multipliers, _ = dynamics.forward_dynamics_and_forces(mechanism, *state, t[doubtful])
        K, dR = _residuals(mechanism, *state, qdd, multipliers, t[doubtful])
        units = np.append(mechanism.arrays.units, np.ones(len(mechanism.rows)))
        du = -units[:, None] * (
            np.linalg.pinv(K * units[:, None] * units, rcond=RANK_CUT) @ (dR * units[:, None])
        )
        slopes = np.linalg.solve(mechanism.arrays.J, du[:, :n])
        for array, values in zip(found, (qdd, *np.split(slopes, 3, axis=-1)), strict=True):
            array[doubtful] = values.reshape(len(doubtful), -1)
    return found


def _inverse(mechanism: Mechanism, states: list[Array], t: Array) -> list[Array]:
    """tau (T, n) at q, qd, qdd, and its derivatives, each (T, n n)."""
    n, driven = mechanism.n, list(mechanism.actuated)
    q, qd, qdd = states
    tau, multipliers, _ = dynamics.inverse_dynamics_and_forces(mechanism, q, qd, qdd, t)
    K, dR = _residuals(mechanism, q, qd, tau, qdd, multipliers, t)
    J = mechanism.arrays.J
    dR[..., 2 * n :] = K[..., :n] @ J  # by qdd in place of tau
    slopes = J.T @ dR[:, :n]  # of what torques and pin forces must balance, at the joints
    if mechanism.rows or mechanism.passive:
        units = mechanism.arrays.units[:, None]
        held = np.concatenate(
            [
                np.broadcast_to(np.eye(n)[:, driven], (len(q), n, len(driven))),
                -(J.T @ K[:, :n, n:]),
            ],
            axis=-1,
        )
        shares = np.linalg.pinv(held * units, rcond=RANK_CUT) @ (slopes * units)
        slopes = np.zeros_like(slopes)
        slopes[:, driven] = shares[:, : len(driven)]
    return [tau, *(x.reshape(len(q), -1) for x in np.split(slopes, 3, axis=-1))]


@lru_cache(maxsize=64)
def _generated(mechanism: Mechanism) -> FormulaRows | None:
    """The formula over batches; None where there is none."""
    n = mechanism.n
    if n > formulas.MAX_GENERATED or not elimination_is_safe(mechanism):
        return None
    formula = forward_derivatives_formula(mechanism)
    if formula is None:
        return None

    def record(parameters: bool) -> formulas.Formula | None:
        return forward_derivatives_formula(mechanism, parameters)

    return FormulaRows(formula, record, (n, n * n, n * n, n * n), PIVOT_CUT)


@lru_cache(maxsize=64)
def _compiled(mechanism: Mechanism) -> straightline.FloatFunction:
    return straightline.compile_floats(residual_derivatives_formula(mechanism), "residuals")


def _residuals(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    tau: Array,
    qdd: Array,
    multipliers: Array,
    t: Array,
) -> tuple[Array, Array]:
    """K (T, N, N) and dR by q, qd, tau (T, N, 3n) of states (T, n)."""
    n, size = mechanism.n, mechanism.n + len(mechanism.rows)
    u = np.concatenate([absolute_rates(mechanism, qdd, "qdd"), -multipliers], axis=-1)
    inputs = [q, qd, tau, u] + ([t[:, None]] if mechanism.timed else [])
    function = _compiled(mechanism)
    found = np.array([function(*row) for row in np.concatenate(inputs, axis=-1).tolist()])
    K, dR = found[:, : size * size], found[:, size * size :]
    return K.reshape(-1, size, size), dR.reshape(-1, size, 3 * n)
