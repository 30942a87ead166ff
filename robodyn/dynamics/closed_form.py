"""M, C, G, energies and points of a mechanism, vectorised over leading axes.

With x = J q the angles alpha of directions E = exp(i alpha), and displacements s, X = E for what
turns and s E_d for what slides on link d (E_d = 1 on the ground), T = dX/dx (`columns`),

    M = J^T Re(T^H A T) J      C = J^T Re(T^H A T') J      G = -J^T (Re(w T) + moments)
    KE = 1/2 X'^H A X'      PE = -Re(w X) - moments . x + const
    M += S^T diag(rotors) S      KE += 1/2 (S qd)^T diag(rotors) S qd

where A, J, the weights w (conj(gamma) B, plus constant forces), the moments, and the rotors of
motors, which spin with S qd, are the constants of `mechanism.py`.  If nothing slides T = diag(i E),
and these are the textbook's sums over conj(E_j) A_jk E_k.  This C is the Christoffel one: Mdot - 2C
is skew-symmetric.  The equation of motion is

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0

with D the diagonal matrix of joint damping, and gap and Psi of `closures.py`.  Springs of a scene
are in G and PE; other forces are in Q, from the rows of the program (`row_values.py`, imported only
for scenes that have some).  States are arrays (..., n); radians, SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.elements.contacts import COMPLIANT, Mode
from robodyn.engines.row_values import rows_of
from robodyn.mechanics import parts
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.mechanics.modes import in_mode, moving_mode, pressed, pushes
from robodyn.mechanics.placed import (
    Placed,
    absolute_rates,
    as_states,
    check_directions,
    columns,
    matvec,
    placed,
)
from robodyn.tables.arrays import Array, Complex

BLOCK = 4  # rows, whose products need no new memory
LONG = 100  # links, from which on products of whole matrices cost more than sums along the tree


def absolute_inertia(mechanism: Mechanism, at: Placed, rates: Placed | None = None) -> Array:
    """Return Re(T^H A T), M in x without rotors, (..., n, n).

    With `rates`, return Re(T^H A T'), C in x.
    """
    mechanism.check_masses()
    moved = rates or at
    if mechanism.n >= LONG and not mechanism.slides:
        return _by_blocks(mechanism.arrays.A, 1j * at.X, 1j * moved.X)
    right = columns(mechanism, mechanism.arrays.A, moved.X[..., None, :], moved.E[..., None, :])
    adjoint = right.conj().swapaxes(-1, -2)
    W = columns(mechanism, adjoint, at.X[..., None, :], at.E[..., None, :]).real
    return W if rates is None else np.swapaxes(W, -1, -2)


def _by_blocks(A: Complex, left: Complex, right: Complex) -> Array:
    """Return Re(conj(left_i) A_ij right_j), (..., n, n), in cache-sized blocks of rows."""
    W = np.empty((*right.shape, right.shape[-1]))
    for begin in range(0, len(A), BLOCK):
        rows = slice(begin, begin + BLOCK)
        W[..., rows, :] = (left[..., rows, None].conj() * (A[rows] * right[..., None, :])).real
    return W


def mass_matrix(mechanism: Mechanism, q: ArrayLike) -> Array:
    """Return M (..., n, n), kg m^2: symmetric, positive definite if all links have mass.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda, with D the joint damping.  Raises InputError
    if q is not finite or not n wide.
    """
    M = _of_joints(mechanism, absolute_inertia(mechanism, placed(mechanism, q)))
    return M + rotor_inertia(mechanism) if mechanism.spins else M


def rotor_inertia(mechanism: Mechanism) -> Array:
    """Return what rotors add to M, (n, n)."""
    arrays = mechanism.arrays
    added: Array = (arrays.spins.T * arrays.rotors) @ arrays.spins
    return added


def coriolis_matrix(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike) -> Array:
    """Return the Christoffel C (..., n, n), kg m^2/s: Mdot - 2C is skew-symmetric.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda, with D the joint damping.  Raises InputError
    if q or qd is not finite or not n wide.
    """
    at = placed(mechanism, q)
    moved = at.rates(mechanism, absolute_rates(mechanism, qd))
    return _of_joints(mechanism, absolute_inertia(mechanism, at, moved))


def _of_joints(mechanism: Mechanism, W: Array) -> Array:
    """Return J^T W J for matrices W (..., n, n) in x; for long chains by sums along the tree."""
    J = mechanism.arrays.J
    if mechanism.n < LONG:
        return np.asarray(J.T @ W @ J)
    for _ in range(2):  # J^T W, then (J^T W)^T: rows are sooner added up than columns
        for k in reversed(mechanism.order):
            above = mechanism.above[k]
            if above is not None:
                W[..., above, :] += W[..., k, :]
        W = np.array(np.swapaxes(W, -1, -2))
    return W


def gravity_vector(mechanism: Mechanism, q: ArrayLike) -> Array:
    """Return G = dPE/dq (..., n), N m: gravity, springs, constant forces and torques.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda, with D the joint damping.  Raises InputError
    if q is not finite or not n wide, and SingularError if the ends of a spring with a free length
    coincide.
    """
    mechanism.check_masses()
    arrays, at = mechanism.arrays, placed(mechanism, q)
    loads = -columns(mechanism, arrays.weights, at.X, at.E).real - arrays.moments
    G: Array = matvec(arrays.J.T, loads)
    if mechanism.stores:
        rows = rows_of(parts.stored, mechanism)
        check_directions(rows.mechanism, np.asarray(q, float))
        G = G + rows("torques", q)
    return G


def other_forces(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, t: ArrayLike = 0.0) -> Array:
    """Return Q (..., n), N m: forces without a potential, except joint damping.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda, with D the joint damping.  Q has dampers of
    springs, forces that turn with a link, loads that vary (at times t (...), s), friction in
    motion, and forces of compliant stops.  A joint with dry friction at rest (qd = 0) adds nothing:
    it holds any torque up to its static friction.  Raises InputError if q or qd is not finite or
    not n wide, and SingularError if the ends of a damped spring coincide.
    """
    states = as_states(mechanism, "q", q), as_states(mechanism, "qd", qd)
    if mechanism.switches:
        return _forces_by_modes(mechanism, *states, t)
    if not mechanism.has_state_forces:
        return np.zeros(np.broadcast_shapes(*(x.shape for x in states)))
    rows = rows_of(parts.spent, mechanism)
    check_directions(rows.mechanism, states[0])
    return 0.0 - rows("torques", *states, t)  # of nothing no -0.0


def _forces_by_modes(mechanism: Mechanism, q: Array, qd: Array, t: ArrayLike) -> Array:
    """Compute `other_forces` of states that may differ in the joints that slip or press a stop."""
    shape = np.broadcast_shapes(q.shape, qd.shape, (*np.shape(t), mechanism.n))
    q, qd = (np.broadcast_to(x, shape).reshape(-1, mechanism.n) for x in (q, qd))
    times = np.broadcast_to(np.asarray(t, float), shape[:-1]).ravel()
    Q = np.empty(q.shape)

    def mode_of(at: list[float], rates: list[float]) -> Mode:
        return moving_mode(mechanism, at, rates, [0.0] * mechanism.n)

    for mode, which in _by_mode(q, qd, mode_of).items():
        found = other_forces(in_mode(mechanism, mode), q[which], qd[which], times[which])
        for joint, push in pushes(mechanism, mode, q[which], qd[which]):
            found[:, joint] += push
        Q[which] = found
    return Q.reshape(shape)


def _by_mode(
    q: Array, qd: Array, mode_of: Callable[[list[float], list[float]], Mode]
) -> dict[Mode, list[int]]:
    """Return the places of states q, qd (T, n) that have the same mode, by mode."""
    modes: dict[Mode, list[int]] = {}
    for k, (at, rates) in enumerate(zip(q.tolist(), qd.tolist(), strict=True)):
        modes.setdefault(mode_of(at, rates), []).append(k)
    return modes


def kinetic_energy(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike) -> Array:
    """Return KE = 1/2 qd^T M qd, (...), J."""
    return _kinetic(mechanism, placed(mechanism, q), qd)


def _kinetic(mechanism: Mechanism, at: Placed, qd: ArrayLike) -> Array:
    mechanism.check_masses()
    arrays = mechanism.arrays
    v = at.rates(mechanism, absolute_rates(mechanism, qd)).X
    KE: Array = 0.5 * (matvec(arrays.A, v) * v.conj()).real.sum(axis=-1)
    if mechanism.spins:
        spins = matvec(arrays.spins, as_states(mechanism, "qd", qd))
        KE = KE + 0.5 * (spins**2 * arrays.rotors).sum(axis=-1)
    return KE


def potential_energy(mechanism: Mechanism, q: ArrayLike) -> Array:
    """Return PE of gravity, springs, constant forces and torques, (...), J.

    It is zero for gravity at the origin's height, for a force with its point at the origin, and for
    a torque whose link points along +X.
    """
    return energies(mechanism, q, np.zeros(mechanism.n))[1]


def energies(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike) -> tuple[Array, Array]:
    """Return KE and PE, (...), J, of the same states; link directions are computed once."""
    if COMPLIANT in mechanism.contacts:
        return _energies_by_stops(mechanism, q, qd)
    arrays, at = mechanism.arrays, placed(mechanism, q)
    KE = _kinetic(mechanism, at, qd)
    PE: Array = mechanism.energy_offset - (at.X * arrays.weights).real.sum(axis=-1)
    if any(mechanism.moments):
        PE = PE - (at.x * arrays.moments).sum(axis=-1)
    if mechanism.stores:
        PE = PE + rows_of(parts.stored, mechanism)("PE", q)[..., 0]
    return KE, PE


def _energies_by_stops(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike) -> tuple[Array, Array]:
    """Return energies of states with different active compliant stops."""
    states = np.broadcast_arrays(as_states(mechanism, "q", q), as_states(mechanism, "qd", qd))
    flat = [x.reshape(-1, mechanism.n) for x in states]
    found = np.empty((2, len(flat[0])))

    def mode_of(at: list[float], rates: list[float]) -> Mode:
        return Mode(pressed=pressed(mechanism, at, rates))

    for mode, which in _by_mode(flat[0], flat[1], mode_of).items():
        found[:, which] = energies(in_mode(mechanism, mode), *(x[which] for x in flat))
    KE, PE = found.reshape(2, *states[0].shape[:-1])
    return KE, PE


class Points(NamedTuple):
    """p points const + c X of a mechanism."""

    constant: Complex  # (p,) m
    c: Complex  # (p, n) m

    def place(self, at: Placed) -> Complex:
        """Return their positions (..., p), m."""
        return self.moved(at) + self.constant

    def moved(self, rates: Placed) -> Complex:
        """Return velocities (m/s) or accelerations (m/s^2), (..., p), from those of X."""
        moved: Complex = (rates.X[..., None, :] @ self.c.T)[..., 0, :]  # each state by itself
        return moved


def points_of(mechanism: Mechanism, points: Sequence[PlanarPoint]) -> Points:
    """Return points of the mechanism as arrays."""
    constant = dense([point.constant for point in points], complex)
    each = dense([value for point in points for _, value in point.terms], complex)
    c = np.zeros((len(points), mechanism.n), each.dtype)
    values = iter(each)
    for row, point in zip(c, points, strict=True):
        for k, _ in point.terms:
            row[k] = next(values)
    return Points(constant, c)


def dense(values: Sequence[Any], kind: type) -> NDArray[Any]:
    """Return an array of `kind`, or of objects if a value is a formula."""
    plain = all(isinstance(x, complex | float | int) for x in values)
    return np.array(values, kind if plain else object)


def point_motion(
    mechanism: Mechanism,
    points: Sequence[PlanarPoint],
    q: ArrayLike,
    qd: ArrayLike | None = None,
    qdd: ArrayLike | None = None,
) -> tuple[Array, Array, Array]:
    """Return position m, velocity m/s and acceleration m/s^2 of points, (..., points, 2) each.

    Rates and accelerations not given are zero.
    """
    these, at, zero = points_of(mechanism, points), placed(mechanism, q), np.zeros(mechanism.n)
    rates = absolute_rates(mechanism, zero if qd is None else qd)
    accelerations = absolute_rates(mechanism, zero if qdd is None else qdd, "qdd")
    shape = np.broadcast_shapes(at.x.shape, rates.shape, accelerations.shape)
    rates, accelerations = np.broadcast_to(rates, shape), np.broadcast_to(accelerations, shape)
    v = these.moved(at.rates(mechanism, rates))
    a = these.moved(at.accelerations(mechanism, rates, accelerations))
    x, xd, xdd = (np.stack([z.real, z.imag], axis=-1) for z in (these.place(at), v, a))
    return x, xd, xdd
