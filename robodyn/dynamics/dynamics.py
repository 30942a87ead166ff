"""Inverse and forward dynamics of open and closed mechanisms, and the forces in the loops.

The equation of motion of `closed_form.py` is solved with its closures differentiated twice:

    M qdd + C qd + D qd + G = S^T tau_act + Q + Psi^T lambda,     Psi qdd + Psidot qd = 0

(S selects the actuated joints).  Large batches use the generated code of `straightline.py`.  Small
ones, and states that are nearly singular, use `dense_dynamics.py`, which also works if M alone is
singular but the constrained system is not, and if closures are dependent.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics import dense_dynamics
from robodyn.dynamics.dense_dynamics import (
    MASS_CUT,
    Accelerations,
    Torques,
    decompose,
    elimination_is_safe,
    required_load,
)
from robodyn.engines import formulas
from robodyn.errors import InputError, SingularError
from robodyn.loops import closures
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import (
    check_directions,
    finite,
    matvec,
    numbers,
    placed,
    times_of,
    together,
)
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.engines.batches import FormulaBatches

PIVOT_CUT = 1e-3  # generated code is trusted while the closures' relative pivots exceed this
BATCH = 200  # from so many states on generated array code wins, its generation included


Solution = TypeVar("Solution", Torques, Accelerations)


class RobodynWarning(UserWarning):
    """A result is right but not unique, or near a limit."""


def inverse_dynamics(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    t: ArrayLike = 0.0,
    *,
    residual: bool = False,
) -> Array:
    """Return the joint torques tau that the motion needs, (..., n), N m.

    tau = M qdd + C qd + D qd + G - Q - Psi^T lambda, zero at passive joints. q, qd, qdd are (...,
    n) and broadcast; those of a closed mechanism must keep its closures (see `assembly`).  Loads
    that vary are taken at times t (...), s.  With more actuators than freedoms, tau is the one of
    least norm, with a RobodynWarning.  With fewer, the motion must be possible: a torque that
    remains at a free joint is its residual, and raises ResidualError; with `residual` it is
    returned in tau at that joint.  Raises InputError for arrays that do not fit, and SingularError
    if no torque at these joints can make the motion.
    """
    return _batch(mechanism, "inverse", 1, t, residual, q=q, qd=qd, qdd=qdd)[0]


def inverse_dynamics_and_forces(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    t: ArrayLike = 0.0,
    *,
    residual: bool = False,
) -> Torques:
    """Return `inverse_dynamics` and the multipliers of the closures."""
    return Torques(*_batch(mechanism, "inverse", 2, t, residual, q=q, qd=qd, qdd=qdd))


def forward_dynamics(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, tau: ArrayLike, t: ArrayLike = 0.0
) -> Array:
    """Return the accelerations qdd that the joint torques tau cause, (..., n), rad/s^2.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda, with the closures Psi qdd + Psidot qd = 0. q,
    qd, tau are (..., n) and broadcast; tau may be of the actuated joints alone; q and qd of a
    closed mechanism must keep its closures.  Loads that vary are taken at times t (...), s.  Raises
    InputError for arrays that do not fit, and SingularError if a freedom has no inertia.
    """
    return _batch(mechanism, "forward", 1, t, q=q, qd=qd, tau=tau)[0]


def forward_dynamics_and_forces(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, tau: ArrayLike, t: ArrayLike = 0.0
) -> Accelerations:
    """Return `forward_dynamics` and the multipliers of the closures."""
    return Accelerations(*_batch(mechanism, "forward", 2, t, q=q, qd=qd, tau=tau))


def motion_dynamics(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, tau: ArrayLike, t: ArrayLike = 0.0
) -> Accelerations:
    """As `forward_dynamics_and_forces`, also where the ends of a spring coincide."""
    return Accelerations(*_batch(mechanism, "motion", 2, t, q=q, qd=qd, tau=tau))


def _batch(
    mechanism: Mechanism,
    kind: str,
    wanted: int,
    t: ArrayLike,
    residual: bool = True,
    **given: ArrayLike,
) -> tuple[Array, Array, str]:
    """Return joint values (..., n), multipliers (..., r) if `wanted` is 2, and a remark."""
    states = together(mechanism, given)
    if kind == "motion":  # which steps across places where a spring's ends meet
        kind = "forward"
    else:
        check_directions(mechanism, states["q"])
    times = times_of(t, states["q"]) if mechanism.timed else np.zeros(())
    solved = mechanism
    if kind == "inverse" and len(mechanism.actuated) < mechanism.n - len(mechanism.rows):
        from robodyn.dynamics import free_joints  # which asks for torques itself

        solved = free_joints.balanced_mechanism(mechanism)
    if mechanism.switches:
        from robodyn.dynamics.sticking import by_modes  # which asks for accelerations itself

        joints, forces, remark = by_modes(solved, kind, states, times, _smooth)
    else:
        joints, forces, remark = _smooth(solved, kind, wanted, states, times)
    if solved is not mechanism and not residual:
        joints = free_joints.without_residual(mechanism, states, times, joints)
    if remark:
        warnings.warn(remark, RobodynWarning, stacklevel=3)
    return joints, forces, remark


def _smooth(
    mechanism: Mechanism, kind: str, wanted: int, states: dict[str, Array], times: Array
) -> tuple[Array, Array, str]:
    """Do the work of `_batch` for a mechanism with the same equations at all states."""
    if mechanism.rubbing:
        from robodyn.dynamics.friction_rounds import by_rounds  # which asks for these itself

        return by_rounds(mechanism, kind, states, times, _smooth)

    def check() -> None:
        for name, array in states.items():
            finite(name, array)

    dense = partial(_dense, _inverse if kind == "inverse" else _forward)
    q = states["q"]
    rows: FormulaBatches | None = None
    many = formulas.streams.get() or q.size >= BATCH * mechanism.n
    if many and mechanism.n <= formulas.MAX_GENERATED:
        rows = _generated(kind, mechanism)
    if rows is None:
        check()
        motion = states["q"], states["qd"], list(states.values())[2]
        joints, forces, remark = dense(mechanism, *motion, times)
    else:
        flat, remark = [state.reshape(-1, mechanism.n) for state in states.values()], ""
        every = [*flat, np.reshape(times, (-1, 1))] if mechanism.timed else flat
        found, doubtful = rows.run(every, wanted, check)
        if doubtful.size:
            at = np.ravel(times)[doubtful] if mechanism.timed else np.zeros(())
            some = flat[0][doubtful], flat[1][doubtful], flat[2][doubtful]
            *solution, remark = dense(mechanism, *some, at)
            for array, values in zip(found, solution, strict=False):
                array[doubtful] = values
        joints, forces, *_ = (*found, np.zeros((0, 0)))
        joints = joints.reshape(*q.shape[:-1], -1)
        if wanted > 1:
            forces = forces.reshape(*q.shape[:-1], forces.shape[1])
    return joints, forces, remark


def _dense(
    solve: Callable[..., Torques | Accelerations], mechanism: Mechanism, *motion: Array
) -> tuple[Array, Array, str]:
    """Solve for states (..., n) by dense algebra: joint values, multipliers, remark.

    BLAS adds up a single state in a different order.  In a stream, which may bring any number of
    states at a time, a single one is therefore solved twice at once.
    """
    *states, t = motion
    if not (formulas.streams.get() and len(states[0]) == 1):
        return solve(mechanism, *motion)
    twice = [np.repeat(x, 2, axis=0) for x in states]
    joints, forces, remark = solve(mechanism, *twice, np.resize(t, 2))
    return joints[:1], forces[:1], remark


@lru_cache(maxsize=64)
def _generated(kind: str, mechanism: Mechanism) -> FormulaBatches | None:
    """Return the formula for batches; None if there is none.

    M must be safe to eliminate in every configuration, so that no state needs a check.  As x^T M x
    = Re((E x)^H A (E x)) in absolute angles, M has no eigenvalue below the least of A; rotors add
    to it.
    """
    if kind == "forward":
        if not elimination_is_safe(mechanism):
            return None
        A = mechanism.arrays.A
        scale = np.sqrt(A.diagonal().real)
        if not scale.all() or not np.linalg.eigvalsh(A / (scale[:, None] * scale))[0] > MASS_CUT:
            return None
    write = formulas.inverse_formula if kind == "inverse" else formulas.forward_formula
    formula = write(mechanism, parameters=True)
    if formula is None:
        return None
    from robodyn.engines.batches import FormulaBatches

    return FormulaBatches(formula, (mechanism.n, len(mechanism.rows)), PIVOT_CUT)


# -- few states, or near singular ones -------------------------------------------------------------


def _forward(mechanism: Mechanism, q: Array, qd: Array, tau: Array, t: ArrayLike) -> Accelerations:
    """Apply `dense_dynamics.forward`; next to a change point, follow the motion across it."""
    if not mechanism.rows or not q.size:
        return dense_dynamics.forward(mechanism, q, qd, tau, t=t)
    from robodyn.loops import change_points, projection
    from robodyn.loops.closing import NEAR_SINGULAR, close_positions

    near = change_points.nearness(mechanism, closures.scaled_jacobian(mechanism, q, t))
    close = near < NEAR_SINGULAR
    if close.any():  # there a state must keep the closures to its last digit
        q = q.copy()
        q[close] = close_positions(mechanism, q[close], t=_at(t, q)[close])
    found = dense_dynamics.forward(mechanism, q, qd, tau, t=t)
    suspect = near**2 < change_points.SUSPECT
    for state in map(tuple, np.argwhere(suspect)):
        now = np.broadcast_to(np.asarray(t, float), q.shape[:-1])[state]

        def beside(q: Array, qd: Array, tau: Array = tau[state], now: Array = now) -> Array:
            return dense_dynamics.forward(mechanism, q, qd, tau, t=now).qdd

        led = projection.state_led_across(mechanism, q[state], qd[state], beside)
        if led is not None:
            found.qdd[state] = led
            load = required_load(mechanism, q[state], qd[state], led, now) - tau[state]
            found.multipliers[state] = _multipliers(mechanism, q[state], load, now)
    return _missed(mechanism, found, q[suspect])


def _inverse(mechanism: Mechanism, q: Array, qd: Array, qdd: Array, t: ArrayLike) -> Torques:
    """Apply `dense_dynamics.inverse`; at a change point, take the limit along the motion across."""
    if not mechanism.rows or not q.size:
        return dense_dynamics.inverse(mechanism, q, qd, qdd, t)
    from robodyn.loops import change_points, projection

    try:
        found = dense_dynamics.inverse(mechanism, q, qd, qdd, t)
        near = change_points.nearness(mechanism, closures.scaled_jacobian(mechanism, q, t))
        return _missed(mechanism, found, q[near < change_points.NEAR])
    except SingularError:
        if q.ndim > 1:
            states = [x.reshape(-1, mechanism.n) for x in (q, qd, qdd)]
            now = np.broadcast_to(np.asarray(t, float), q.shape[:-1]).ravel()
            each = [_inverse(mechanism, *state) for state in zip(*states, now, strict=True)]
            tau = np.reshape([x.tau for x in each], q.shape)
            multipliers = np.reshape([x.multipliers for x in each], (*q.shape[:-1], -1))
            return Torques(tau, multipliers, max((x.remark for x in each), key=len))

        def beside(q: Array, qd: Array) -> Array:
            """Return the torques of closed states (k, n) for the nearest qdd that closes."""
            Psi = closures.scaled_jacobian(mechanism, q, t)
            units = mechanism.arrays.units
            opening = Psi @ (qdd / units) + closures.closure_bias(mechanism, q, qd, t)
            closing = units * matvec(decompose(mechanism, Psi).inverse, opening)
            return dense_dynamics.inverse(mechanism, q, qd, qdd - closing, t).tau

        led = projection.state_led_across(mechanism, q, qd, beside)
        if led is None:
            raise
    load = required_load(mechanism, q, qd, qdd, t) - led
    multipliers = _multipliers(mechanism, q, load, t)
    remark = "change point: torques of the motion straight across; pin forces are not unique there"
    return Torques(led, multipliers, remark)


def _missed(mechanism: Mechanism, found: Solution, states: Array) -> Solution:
    """Add a remark if one of the states is near a missed change point."""
    from robodyn.loops import change_points

    remarks = (found.remark, change_points.miss_remark(mechanism, states))
    return found._replace(remark="; ".join(filter(None, remarks)))


def _at(t: ArrayLike, q: Array) -> Array:
    """Return times t broadcast to states q (..., n), (...)."""
    return np.broadcast_to(np.asarray(t, float), q.shape[:-1])


def _multipliers(mechanism: Mechanism, q: Array, load: Array, t: ArrayLike) -> Array:
    """Return the multipliers of least norm that balance a load at q (n,)."""
    Psi = closures.scaled_jacobian(mechanism, q, t)
    found: Array = decompose(mechanism, Psi).inverse.T @ (load * mechanism.arrays.units)
    return found


# -- what the multipliers are ----------------------------------------------------------------------


def as_multipliers(mechanism: Mechanism, multipliers: ArrayLike) -> Array:
    """Return `multipliers` as floats (..., r); InputError for another width."""
    lam = numbers("multipliers", multipliers)
    if lam.shape[-1:] != (len(mechanism.rows),):
        limit = f"must have {len(mechanism.rows)} values along the last axis, one a closure row"
        raise InputError("multipliers.shape", value=lam.shape, limit=limit)
    return lam


def pin_forces(mechanism: Mechanism, multipliers: ArrayLike, q: ArrayLike | None = None) -> Array:
    """Return the force on the first side of each closure, (..., closures, 2), N.

    `multipliers` (..., r) come from `inverse_dynamics_and_forces` and similar functions.  Raises
    InputError without q (..., n) if a moving link has a slot: its force turns with it.
    """
    E = None if q is None else placed(mechanism, q).E
    forces = pins_at(mechanism, as_multipliers(mechanism, multipliers), E)
    return np.stack([forces.real, forces.imag], axis=-1)


def pins_at(mechanism: Mechanism, lam: NDArray[Any], E: NDArray[Any] | None) -> NDArray[Any]:
    """Return pin forces as complex numbers (..., closures), of numbers or `Planar` formulas."""
    count = len(mechanism.description.closures)
    forces = np.zeros((*lam.shape[:-1], count), complex).astype(np.result_type(lam, complex))
    for row, entry in enumerate(mechanism.rows):
        if entry.closure is None or entry.arm:
            continue
        force = lam[..., row] * entry.direction
        if entry.line is not None:
            if E is None:
                limit = "is needed: the force of a slot turns with its link"
                raise InputError("q", where=mechanism.source, limit=limit)
            force = np.multiply(force, E[..., entry.line])
        forces[..., entry.closure] += force
    return forces


def kept_moments(mechanism: Mechanism, multipliers: ArrayLike) -> Array:
    """Return the moment on the first link of each closure with a fixed angle, (..., k), N m.

    `multipliers` (..., r) come from `inverse_dynamics_and_forces` and similar functions.
    """
    kept = [r for r, row in enumerate(mechanism.rows) if row.closure is not None and row.arm]
    arms = np.array([mechanism.rows[r].arm for r in kept])
    moments: Array = as_multipliers(mechanism, multipliers)[..., kept] * arms
    return moments


def coupling_torques(mechanism: Mechanism, multipliers: ArrayLike) -> Array:
    """Return the torque of each coupling on its joint, (..., couplings), N m.

    `multipliers` (..., r) come from `inverse_dynamics_and_forces` and similar functions.  The other
    joints feel the opposite, times their ratios.
    """
    lam = as_multipliers(mechanism, multipliers)
    first = len(mechanism.rows) - len(mechanism.description.couplings)
    torques: Array = lam[..., first:] * np.array([row.arm for row in mechanism.rows[first:]])
    return torques


def loop_forces(mechanism: Mechanism, multipliers: ArrayLike, q: ArrayLike) -> Array:
    """Return pin forces, moments of fixed angles, and torques of couplings, side by side.

    (..., 2 closures + kept + couplings), at q (..., n).
    """
    pins = pin_forces(mechanism, multipliers, q)
    moments, torques = (f(mechanism, multipliers) for f in (kept_moments, coupling_torques))
    flat = pins.reshape(*pins.shape[:-2], 2 * pins.shape[-2])  # of no state too
    return np.concatenate([flat, moments, torques], axis=-1)
