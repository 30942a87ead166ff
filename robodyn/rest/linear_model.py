"""The linear model of small motions about a state, in minimal coordinates.

Minimal coordinates z are joints, z = S q: the actuated ones where they tell all others, else those
that closed motions move most.  Next to a closed state (q, qd), with the equations of motion solved
for qdd,

    [Psi; S] N = [0; I]      [Psi; S] R = [-d(Psi qd)/dq N; 0]     dq = N dz     dqd = R dz + N dz'
    A21 = S (qdd_q N + qdd_qd R)     A22 = S qdd_qd N     B2 = S qdd_tau

and (dz, dz')' = A (dz, dz') + B dtau, A = [[0, I], [A21, A22]], B = [0; B2].  The derivatives are
tangents of the program.  Two choices of z agree about eigenvalues at rest alone, where qdd = 0.

Natural modes: an eigenvalue s, |s| = w, has the frequency w/(2 pi) and the
damping ratio -Re(s)/w, its eigenvector is (shape, s shape).  Where A22 = 0, s^2 are the eigenvalues
of A21, and nothing is damped by rounding.

The gain that keeps a mechanism at a pose at the least cost (LQR),

    tau = tau0 - K [z - z0; z']      K = U^-1 B^T P      A^T P + P A - P B U^-1 B^T P + X = 0

makes the integral of x^T X x + u^T U u the least, x = (dz, dz') and u = tau - tau0.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.closed_form import mass_matrix
from robodyn.dynamics.dense_dynamics import required_load
from robodyn.dynamics.derivatives import forward_dynamics_derivatives
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.errors import AssemblyError, InputError, RobodynError
from robodyn.loops.closing import close_positions
from robodyn.loops.closures import closure_bias, scaled_jacobian
from robodyn.loops.loop_rates import check_closed, check_way_on
from robodyn.mechanics.driven import refuse_driven
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import beyond, end_word, in_mode, moving_mode
from robodyn.mechanics.parts import check_lasting_gravity
from robodyn.rest.balance import bend, free_motions, single
from robodyn.tables.arrays import Array, Complex
from robodyn.tables.short_repr import short_repr

ZERO = 1e-7  # part of the largest eigenvalue below which one is zero: a double zero errs by this
GROWS = 1e-10  # part of the largest eigenvalue above which a real part grows
UNREACHED = 1e-9  # of [A - s I, B], scaled: a singular value below it is zero


@short_repr
class NaturalMode(NamedTuple):
    """One pair of conjugate eigenvalues, by that with Im >= 0, or one real eigenvalue.

    `frequency` |s|/(2 pi), Hz; `damping` -Re(s)/|s|, 1 for what dies away, -1 for what grows
    without a swing, 0 where s = 0; `shape` (f,) how coordinates move, the largest at 1: where some
    lag behind it is complex.
    """

    eigenvalue: complex
    frequency: float
    damping: float
    shape: Complex


def eigenvalues(A21: Array, A22: Array, rate: float = 0.0) -> tuple[Complex, Complex]:
    """All 2f of A, and the shapes (f, 2f) of their eigenvectors; rounding of zeros is taken away.

    It is a small part of the largest, or of a `rate` that what acts would have uncancelled, 1/s.
    """
    f = len(A21)
    if not A22.any():
        squares, V = np.linalg.eig(A21)
        largest = max(float(np.abs(squares).max()), rate**2)
        squares = np.where(np.abs(squares) <= ZERO**2 * largest, 0.0, squares)
        roots = np.sqrt(squares.astype(complex))
        return np.concatenate([roots, 0.0 - roots]), np.concatenate([V, V], axis=1).astype(complex)
    A = np.block([[np.zeros((f, f)), np.eye(f)], [A21, A22]])
    values, vectors = np.linalg.eig(A)
    largest = max(float(np.abs(values).max()), rate)
    values = np.where(np.abs(values) <= ZERO * largest, 0.0, values)
    return values.astype(complex), vectors[:f].astype(complex)


def natural_modes(values: Complex, shapes: Complex, units: Array) -> list[NaturalMode]:
    """The modes of `eigenvalues`, the slowest first; displacements are told in units (f,)."""
    found = []
    for s, shape in zip(values, shapes.T, strict=True):
        if s.imag < 0.0:
            continue
        w = abs(s)
        most = int(np.argmax(np.abs(shape) / units))
        shape = shape / shape[most] + 0.0  # no -0.0
        shape[most] = 1.0
        damping = float(-s.real / w) + 0.0 if w else 0.0
        found.append(NaturalMode(complex(s), float(w) / (2.0 * np.pi), damping, shape))
    return sorted(found, key=lambda mode: (mode.frequency, mode.eigenvalue.real))


def stable_by(values: Complex) -> bool | None:
    """Whether no motion grows; None where one neither grows nor returns: an eigenvalue is zero."""
    if (values.real > GROWS * np.abs(values).max()).any():
        return False
    return None if (values == 0.0).any() else True


def controllable(A: Array, B: Array) -> bool:
    """Whether [A - s I, B] has full rank at each eigenvalue s (Popov, Belevitch and Hautus)."""
    f = len(A) // 2
    rate = float(np.sqrt(np.abs(A[f:, :f]).max())) or 1.0  # rates in units of it
    scale = np.repeat([1.0, rate], f)
    scaled = A * scale / scale[:, None] / rate
    inputs = B / (np.abs(B).max(initial=0.0) or 1.0)
    return all(
        np.linalg.svd(np.hstack([scaled - s * np.eye(2 * f), inputs]), compute_uv=False)[-1]
        > UNREACHED * max(1.0, abs(s))
        for s in np.linalg.eigvals(scaled)
    )


TOLD = 1e-6  # of a joint's row in N, orthonormal: below it the joint tells no coordinate
ASIDE = 1e-9  # rad, or lengths, to either side, where slopes are compared
BENDS = 1e-6  # part of the slopes by which those of two sides differ at a bend
RESTS = 1e-6  # rad that a pose may be from rest, by its accelerations
# of a mode as a motion to look at
VISIBLE = 0.3  # rad, or lengths, that the joint which moves most goes each way
SMALLEST = 1e-3  # of these, where loops do not close farther out
ROWS = 64  # a period


@short_repr
class LinearModel(NamedTuple):
    """A (2f, 2f) and B (2f, m) of f coordinates and m actuated joints, at q, qd, tau (n,).

    `coordinates` are columns, such as q1; N (n, f) has the rates of all joints for each at 1.
    Away from rest `remark` says why, and `modes`, `stable` and `controllable` are None; at rest
    `stable` is None where an eigenvalue is zero and none grows.
    """

    coordinates: tuple[str, ...]
    q: Array
    qd: Array
    tau: Array
    N: Array
    A: Array
    B: Array
    modes: list[NaturalMode] | None
    stable: bool | None
    controllable: bool | None
    remark: str = ""


def linearize(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike | None = None, tau: ArrayLike | None = None
) -> LinearModel:
    """The linear model at the closed state q, qd (n,) under torques tau, loads those of t = 0.

    tau is that of all joints or of the actuated ones.  qd is zero by default, tau what holds the
    mechanism there (z'' = 0), as far as the actuated joints can.  Dry friction of joints at rest,
    and hard stops, are left out.  Raises InputError for a state that does not fit, is open, or is
    beyond an end of a joint that no compliant stop makes, RobodynError where nothing moves,
    SingularError at a change point and where a freedom has no inertia.
    """
    mechanism.check_rubbing("linear models")
    refuse_driven(mechanism, "linearize")
    check_lasting_gravity(mechanism, "a linear model")
    pose, rates, torques = (
        single(mechanism, name, x) for name, x in (("q", q), ("qd", qd), ("tau", tau))
    )
    if (fault := check_closed(mechanism, pose, rates, t=0.0)) is not None:
        raise fault[1]
    check_way_on(mechanism, pose[None], np.zeros((1, mechanism.n)))
    for joint, side, end in beyond(mechanism, pose.tolist(), turns=True):
        where = f"q{joint + 1} ({mechanism.link_names[joint]})"
        limit = f"is beyond the joint's {end_word(side)}, {end:.9g}: take a pose within it"
        raise InputError(where, where=mechanism.source, value=f"{pose[joint]:.9g}", limit=limit)
    whole = mechanism
    mechanism = _moving(whole, pose, rates)
    free = free_motions(mechanism, pose)
    if not free.shape[1]:
        raise RobodynError("no freedom", where=mechanism.source, limit="nothing moves here")
    joints, driven = _coordinates(mechanism, free), list(mechanism.actuated)
    U, s, Vt = np.linalg.svd(free[driven].T, full_matrices=False)
    holds = s > TOLD * s.max(initial=1.0)
    N = free @ np.linalg.inv(free[joints])
    N[joints] = np.eye(len(joints))
    if tau is None:
        qdd = _completed(mechanism, pose, joints, -closure_bias(mechanism, pose, rates, 0.0))
        load = required_load(mechanism, pose, rates, qdd)
        torques[driven] = Vt[holds].T @ ((U[:, holds].T @ (free.T @ load)) / s[holds])
    R = np.zeros_like(N)
    if mechanism.rows and rates.any():
        bent = bend(mechanism, pose, rates, N.T)  # (f, r)
        R = np.transpose([_completed(mechanism, pose, joints, -each) for each in bent])
    slopes = forward_dynamics_derivatives(mechanism, pose, rates, torques)
    _tell_bends(whole, pose, rates, torques, N, joints, slopes[1:4])
    qdd, by_q, by_qd, by_tau = (x[joints] for x in slopes[:4])
    A21, A22, B2 = by_q @ N + by_qd @ R, by_qd @ N, by_tau[:, driven]
    f, m = B2.shape
    A = np.block([[np.zeros((f, f)), np.eye(f)], [A21, A22]])
    B = np.concatenate([np.zeros((f, m)), B2])
    names = tuple(f"q{k + 1}" for k in joints)
    model = LinearModel(names, pose, rates, torques, N, A, B, None, None, None)
    units = mechanism.arrays.units[joints]
    M = N.T @ mass_matrix(mechanism, pose) @ N * units * units[:, None]
    weight = np.abs(mechanism.arrays.weights).max() * mechanism.arrays.units.max()
    square = float(weight / np.linalg.eigvalsh(M).min())  # of a rate that weight may make, 1/s^2
    size = np.abs(A21 * units / units[:, None]).max() + np.abs(B2 @ torques[driven] / units).max()
    fastest = int(np.argmax(np.abs(qdd / units)))
    if rates.any() or abs(qdd[fastest] / units[fastest]) > RESTS * max(size, square):
        what = "it moves" if rates.any() else f"{names[fastest]}'' = {qdd[fastest]:.6g}"
        return model._replace(remark=f"this is no equilibrium ({what}): modes belong to those")
    values, shapes = eigenvalues(A21, A22, math.sqrt(square))
    return model._replace(
        modes=natural_modes(values, shapes, units),
        stable=stable_by(values),
        controllable=controllable(A, B),
    )


def _moving(mechanism: Mechanism, pose: Array, rates: Array) -> Mechanism:
    """The mechanism in the mode of a state q, qd (n,): joints slip as they move, stops push."""
    if not mechanism.switches:
        return mechanism
    still = [0.0] * mechanism.n
    return in_mode(mechanism, moving_mode(mechanism, pose.tolist(), rates.tolist(), still))


def _tell_bends(
    mechanism: Mechanism,
    pose: Array,
    rates: Array,
    torques: Array,
    N: Array,
    joints: Sequence[int],
    slopes: Sequence[Array],
) -> None:
    """Warn (RobodynWarning) of coordinates along which what acts bends at the pose.

    `slopes` are those of qdd by q, qd and tau there, of which the first two belong to one side.
    """
    if not (mechanism.signals or mechanism.ranges):
        return
    units = mechanism.arrays.units
    weight = np.abs(mechanism.arrays.weights).sum() * np.abs(slopes[2]).max()
    least = BENDS * max(weight, *(np.abs(slope).max() for slope in slopes[:2]))
    for column, joint in zip(N.T, joints, strict=True):
        differs = {}
        for side in (-1, 1):
            there = pose + side * ASIDE * units[joint] * column
            try:
                moving = _moving(mechanism, there, rates)
                found = forward_dynamics_derivatives(moving, there, rates, torques)[1:3]
            except RobodynError:  # beyond the last row of a table nothing is known
                differs[side] = True
                continue
            pairs = zip(found, slopes[:2], strict=True)
            differs[side] = any(np.abs(a - b).max() > least for a, b in pairs)
        if any(differs.values()):
            towards = "larger" if not differs[1] else "smaller" if not differs[-1] else "neither"
            name = f"q{joint + 1} ({mechanism.link_names[joint]})"
            remark = (
                f"a force bends at {name} = {pose[joint]:.9g} (a row of a table, or the end of a "
                f"stop): its slope is that towards {towards} {name}"
            )
            warnings.warn(remark, RobodynWarning, stacklevel=3)


def _coordinates(mechanism: Mechanism, N: Array) -> list[int]:
    """Joints whose rates tell all others': actuated ones, as far as they do, then by pivots."""
    units = mechanism.arrays.units
    left = N / units[:, None]  # rows less what the joints that are chosen tell of them
    chosen: list[int] = []
    for pool in (mechanism.actuated, mechanism.passive):
        while len(chosen) < N.shape[1]:
            sizes = {k: float(np.linalg.norm(left[k])) for k in pool if k not in chosen}
            best = max(sizes, key=lambda k: round(sizes[k], 9), default=None)
            if best is None or sizes[best] < TOLD:
                break
            way = left[best] / sizes[best]
            left = left - np.outer(left @ way, way)
            chosen.append(best)
    return sorted(chosen)


def _completed(mechanism: Mechanism, q: Array, joints: list[int], right: Array) -> Array:
    """x (n,) with Psi x = right (r,), zero at the coordinates."""
    others = [k for k in range(mechanism.n) if k not in joints]
    found = np.zeros(mechanism.n)
    columns = scaled_jacobian(mechanism, q, 0.0)[:, others]
    found[others] = mechanism.arrays.units[others] * np.linalg.lstsq(columns, right, rcond=1e-10)[0]
    return found


def mode_motion(
    mechanism: Mechanism, model: LinearModel, mode: int, seconds: float
) -> tuple[Array, Array]:
    """Times (T,), s, and closed poses (T, n) of one mode, counted from 1, without its damping.

    Whole periods 1/frequency, as many as `seconds` take; a mode that does not swing has one of 1 s.
    Raises RobodynError away from rest and where loops close nowhere near, InputError for a mode
    that is not there.
    """
    if model.modes is None:
        raise RobodynError("no modes", where=mechanism.source, limit=model.remark)
    if not 1 <= mode <= len(model.modes):
        raise InputError("mode", value=mode, limit=f"there are modes 1 to {len(model.modes)}")
    chosen = model.modes[mode - 1]
    period = 1.0 / chosen.frequency if chosen.eigenvalue.imag else 1.0
    periods = max(1, int(np.ceil(seconds / period)))
    turns = np.arange(ROWS * periods + 1) / ROWS
    way = (np.exp(2j * np.pi * turns)[:, None] * (model.N @ chosen.shape)).imag
    size = VISIBLE / np.abs(way / mechanism.arrays.units).max()
    part = 1.0
    while part > SMALLEST:
        q = close_positions(mechanism, model.q + part * size * way, t=0.0)
        if check_closed(mechanism, q, t=0.0) is None:
            return turns * period, q
        part /= 2.0
    raise AssemblyError("the mode's poses do not close", where=mechanism.source)


ROUNDING = 1e-12  # part of the largest weight that an eigenvalue may be below zero


STANDS = 1e-9  # part of the fastest eigenvalue below which one is zero but for rounding


def lqr(model: LinearModel, weights_x: ArrayLike = 1.0, weights_u: ArrayLike = 1.0) -> Array:
    """K (m, 2f) of a linear model at rest.

    Weights are one value, one a state or an actuated joint, or all of a symmetric matrix, row by
    row; X must be positive semidefinite, U positive definite.  Raises InputError where they are
    not, RobodynError away from rest and where no gain makes the pose stable.
    """
    if not model.B.shape[1]:
        raise RobodynError("no gain", limit="no joint is actuated")
    X = _weights("weights_x", weights_x, len(model.A), definite=False)
    U = _weights("weights_u", weights_u, model.B.shape[1], definite=True)
    if model.modes is None:
        raise RobodynError("no gain", limit=model.remark)
    from scipy.linalg import solve_continuous_are

    try:
        P = solve_continuous_are(model.A, model.B, X, U)
        K = np.asarray(np.linalg.solve(U, model.B.T @ P), float)
        ways = np.linalg.eigvals(model.A - model.B @ K)
        settles = bool((ways.real < -STANDS * np.abs(ways).max()).all())
    except (np.linalg.LinAlgError, ValueError):
        settles = False
    if not settles:
        none = "no gain brings it to rest there"
        if not model.controllable:
            raise RobodynError(none, limit="it is not controllable")
        limit = f"{none}: weigh all that moves by itself"
        raise RobodynError("weights_x", value=_shown(np.ravel(weights_x)), limit=limit)
    return K


def _weights(name: str, given: ArrayLike, size: int, definite: bool) -> Array:
    values = np.asarray(given, float)
    if values.size not in (1, size, size * size):
        limit = f"needs 1, {size} or, for a matrix, {size * size} values"
        limit = limit if size > 1 else "needs 1 value"
        raise InputError(name, value=f"{values.size} values", limit=limit)
    flat = values.ravel()
    weights = (
        flat.reshape(size, size) if flat.size == size * size else np.diag(flat * np.ones(size))
    )
    if not np.isfinite(weights).all():
        raise InputError(name, limit="must be finite")
    largest = float(np.abs(weights).max(initial=0.0))
    if np.abs(weights - weights.T).max(initial=0.0) > ROUNDING * largest:
        raise InputError(name, value=_shown(flat), limit="must be a symmetric matrix")
    least = float(np.linalg.eigvalsh(weights).min(initial=np.inf))
    if least < -ROUNDING * largest or (definite and least <= ROUNDING * largest):
        word = "definite" if definite else "semidefinite"
        limit = f"must be positive {word}; its least eigenvalue is {least:.6g}"
        raise InputError(name, value=_shown(flat), limit=limit)
    return weights


def _shown(values: Array) -> str:
    return ", ".join(f"{x:g}" for x in values)
