"""Exact derivatives of inverse and forward dynamics, by tangents of the program.

In a closed mechanism q and qd are varied one by one, as if each joint were free, and the solution
of the equation of motion is differentiated.  Along directions that keep the closures this is what
the mechanism does; across them it depends on how the equation is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics import dynamics
from robodyn.dynamics.dense_dynamics import RANK_CUT, elimination_is_safe
from robodyn.dynamics.dynamics import PIVOT_CUT
from robodyn.dynamics.sticking import modes_of
from robodyn.elements.contacts import Mode
from robodyn.engines import formulas, straightline
from robodyn.engines.batches import FormulaBatches
from robodyn.engines.formulas import (
    forward_derivatives_formula,
    residual_derivatives_formula,
)
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode
from robodyn.mechanics.placed import absolute_rates, check_directions, finite, times_of, together
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr

Numbers = Sequence[straightline.FloatFunction]  # the residuals' slopes by each


@short_repr
class ForwardDerivatives(NamedTuple):
    """qdd (..., n), and d qdd_i / d q_j, d qd_j, d tau_j, each (..., n, n).

    `by_numbers` (..., n, k) are derivatives by k numbers of the scene.
    """

    qdd: Array
    by_q: Array
    by_qd: Array
    by_tau: Array
    by_numbers: Array


@short_repr
class InverseDerivatives(NamedTuple):
    """tau (..., n), and d tau_i / d q_j, d qd_j, d qdd_j, each (..., n, n).

    `by_numbers` (..., n, k) are derivatives by k numbers of the scene.
    """

    tau: Array
    by_q: Array
    by_qd: Array
    by_qdd: Array
    by_numbers: Array


def forward_dynamics_derivatives(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    t: ArrayLike = 0.0,
    numbers: Sequence[str] = (),
) -> ForwardDerivatives:
    """Return the accelerations of `forward_dynamics`, and their derivatives.

    q, qd, tau are (..., n) and broadcast; tau may be of the actuated joints alone.  Where joints
    stick or rest on stops, derivatives are those of the others.  `numbers` are names such as
    `links.forearm.m`, as sweeps vary them, of the file that the mechanism was loaded from; q and qd
    are held.  Raises the errors of `forward_dynamics`, and InputError for an unknown name.
    """
    return ForwardDerivatives(*_each(mechanism, "forward", t, numbers, q=q, qd=qd, tau=tau))


def inverse_dynamics_derivatives(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    t: ArrayLike = 0.0,
    numbers: Sequence[str] = (),
) -> InverseDerivatives:
    """Return the torques of `inverse_dynamics`, and their derivatives.

    They are zero at passive joints. q, qd, qdd are (..., n) and broadcast; for `numbers` see
    `forward_dynamics_derivatives`.  Raises the errors of `inverse_dynamics`.
    """
    solved = mechanism
    if len(mechanism.actuated) < mechanism.n - len(mechanism.rows):
        from robodyn.dynamics.free_joints import balanced_mechanism  # which asks for slopes itself

        solved = balanced_mechanism(mechanism)
    found = InverseDerivatives(*_each(solved, "inverse", t, numbers, q=q, qd=qd, qdd=qdd))
    if solved is mechanism:
        return found
    for each in found[1:]:
        each[..., list(mechanism.passive), :] = 0.0
    return found._replace(tau=dynamics.inverse_dynamics(mechanism, q, qd, qdd, t))


def _each(
    mechanism: Mechanism, kind: str, t: ArrayLike, numbers: Sequence[str], **given: ArrayLike
) -> list[Array]:
    """Return the result and its derivatives."""
    mechanism.check_rubbing("derivatives")
    states = together(mechanism, given)
    check_directions(mechanism, states["q"])
    shape, times = states["q"].shape, times_of(t, states["q"]).ravel()
    n = mechanism.n
    flat = {name: finite(name, array).reshape(-1, n) for name, array in states.items()}
    solve = _forward if kind == "forward" else _inverse
    if not mechanism.switches:
        by = [_by_number(mechanism, name) for name in numbers]
        found = solve(mechanism, list(flat.values()), times, by)
    else:
        found = [np.empty((len(times), n * m)) for m in (1, n, n, n, len(numbers))]
        for mode, which in modes_of(mechanism, kind, flat, times).items():
            moving = in_mode(mechanism, mode)
            by = [_by_number(mechanism, name, mode) for name in numbers]
            part = solve(moving, [x[which] for x in flat.values()], times[which], by)
            for array, values in zip(found, part, strict=True):
                array[which] = values
    widths = [(n,), *((n, n),) * 3, (n, len(numbers))]
    return [x.reshape(*shape[:-1], *width) for x, width in zip(found, widths, strict=True)]


def _forward(
    mechanism: Mechanism, states: list[Array], t: Array, numbers: Numbers = ()
) -> list[Array]:
    """Return qdd (T, n) at q, qd, tau, and its derivatives, each (T, n m) by m variables."""
    rows, n = _generated(mechanism), mechanism.n
    found, left = [np.empty((len(t), n * m)) for m in (1, n, n, n)], np.arange(len(t))
    if rows is not None:
        every = [*states, t[:, None]] if mechanism.timed else states
        found, left = rows.run(every, 4, lambda: None)
    by_numbers = np.zeros((len(t), n * len(numbers)))
    if numbers:
        left = np.arange(len(t))
    if left.size:
        q, qd, tau = (x[left] for x in states)
        qdd, multipliers, _ = dynamics.forward_dynamics_and_forces(mechanism, q, qd, tau, t[left])
        K, dR = _residuals(mechanism, q, qd, tau, qdd, multipliers, t[left], numbers)
        units = np.append(mechanism.arrays.units, np.ones(len(mechanism.rows)))[:, None]
        inverse = np.linalg.pinv(K * units * units.T, rcond=RANK_CUT)
        slopes = np.linalg.solve(mechanism.arrays.J, -(units * (inverse @ (dR * units)))[:, :n])
        by_numbers[left] = slopes[..., 3 * n :].reshape(len(left), -1)
        parts = np.split(slopes[..., : 3 * n], 3, axis=-1)
        for array, values in zip(found, (qdd, *parts), strict=True):
            array[left] = values.reshape(len(left), -1)
    return [*found, by_numbers]


def _inverse(
    mechanism: Mechanism, states: list[Array], t: Array, numbers: Numbers = ()
) -> list[Array]:
    """Return tau (T, n) at q, qd, qdd, and its derivatives, each (T, n m) by m variables."""
    n, driven = mechanism.n, list(mechanism.actuated)
    q, qd, qdd = states
    tau, multipliers, _ = dynamics.inverse_dynamics_and_forces(mechanism, q, qd, qdd, t)
    K, dR = _residuals(mechanism, q, qd, tau, qdd, multipliers, t, numbers)
    J = mechanism.arrays.J
    dR[..., 2 * n : 3 * n] = K[..., :n] @ J  # by qdd in place of tau
    slopes = J.T @ dR[:, :n]  # of what torques and pin forces must balance, at the joints
    if mechanism.rows or mechanism.passive:
        units = mechanism.arrays.units[:, None]
        torques = np.broadcast_to(np.eye(n)[:, driven], (len(q), n, len(driven)))
        shares = np.concatenate([torques, -(J.T @ K[:, :n, n:])], axis=-1)
        found = np.linalg.pinv(shares * units, rcond=RANK_CUT) @ (slopes * units)
        slopes = np.zeros_like(slopes)
        slopes[:, driven] = found[:, : len(driven)]
    parts = np.split(slopes, (n, 2 * n, 3 * n), axis=-1)
    return [tau, *(x.reshape(len(q), -1) for x in parts)]


@lru_cache(maxsize=64)
def _generated(mechanism: Mechanism) -> FormulaBatches | None:
    """Return the formula for batches; None if there is none."""
    n = mechanism.n
    if n > formulas.MAX_GENERATED or not elimination_is_safe(mechanism):
        return None
    formula = forward_derivatives_formula(mechanism)
    if formula is None:
        return None
    return FormulaBatches(formula, (n, n * n, n * n, n * n), PIVOT_CUT)


@lru_cache(maxsize=64)
def _compiled(mechanism: Mechanism) -> straightline.FloatFunction:
    return straightline.compile_floats(residual_derivatives_formula(mechanism), "residuals")


@lru_cache(maxsize=256)
def _by_number(
    mechanism: Mechanism, name: str, mode: Mode | None = None
) -> straightline.FloatFunction:
    from robodyn.dynamics.named_numbers import number_formula

    return straightline.compile_floats(number_formula(mechanism, name, mode), "residuals")


def _residuals(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    tau: Array,
    qdd: Array,
    multipliers: Array,
    t: Array,
    numbers: Numbers,
) -> tuple[Array, Array]:
    """Return K (T, N, N), and dR by q, qd, tau and numbers (T, N, 3n + k), of states (T, n)."""
    n, size = mechanism.n, mechanism.n + len(mechanism.rows)
    u = np.concatenate([absolute_rates(mechanism, qdd, "qdd"), -multipliers], axis=-1)
    inputs = [q, qd, tau, u] + ([t[:, None]] if mechanism.timed else [])
    states = np.concatenate(inputs, axis=-1).tolist()
    function = _compiled(mechanism)
    found = np.array([function(*row) for row in states])
    K, dR = found[:, : size * size], found[:, size * size :].reshape(-1, size, 3 * n)
    more = [[function(*row) for row in states] for function in numbers]
    parts = [np.reshape(x, (-1, size, 1)) for x in more]
    return K.reshape(-1, size, size), np.concatenate([dR, *parts], axis=-1)
