"""M, C, G, Psi, energies and points of a mechanism, vectorised over leading axes.

With x = J q the angles alpha of directions E = exp(i alpha), and displacements s, X = E for what
turns and s E_d for what slides on link d (E_d = 1 on the ground), T = dX/dx (`columns`),

    M = J^T Re(T^H A T) J      C = J^T Re(T^H A T') J      G = -J^T (Re(w T) + moments)
    KE = 1/2 X'^H A X'      PE = -Re(w X) - moments . x + const
    M += S^T diag(rotors) S      KE += 1/2 (S qd)^T diag(rotors) S qd
    gap = Re(conj(E_line) P X) + angles x + offset      Psi = d gap/dq
    Psidot qd = gap'' without accelerations

where A, J, P, the weights w (conj(gamma) B, plus constant forces), the moments, and the rotors of
motors, which spin with S qd, are the constants of `mechanism.py`.  If nothing slides T = diag(i E),
and these are the textbook's sums over conj(E_j) A_jk E_k.  This C is the Christoffel one: Mdot - 2C
is skew-symmetric.  The equation of motion is

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0

with D the diagonal matrix of joint damping.  Springs of a scene are in G and PE; other forces are
in Q, from the rows of the program (`row_values.py`, imported only for scenes that have some).
States are arrays (..., n); radians, SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.placed import (
    Placed,
    absolute_rates,
    as_states,
    check_directions,
    columns,
    matvec,
    placed,
)
from robodyn.elements.contacts import COMPLIANT, Mode
from robodyn.engines.coupling_laws import laws_of
from robodyn.engines.row_values import rows_of
from robodyn.mechanics import parts
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.mechanics.modes import in_mode, moving_mode, pressed, pushes
from robodyn.mechanics.planar_model import Arrays
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


def closure_gap(mechanism: Mechanism, q: ArrayLike, t: ArrayLike) -> Array:
    """Return the closure gap, first side minus second, (..., r), m.

    A pin has two components (x, y), a slider one (normal to its line), and a coupling one: the lead
    of its joint (rad) times a length of the mechanism.
    """
    return gap_at(mechanism, mechanism.arrays, placed(mechanism, q), t)


def closure_jacobian(mechanism: Mechanism, q: ArrayLike, t: ArrayLike) -> Array:
    """Return Psi = d gap/dq, (..., r, n), in m/rad, or 1 for joints that slide."""
    Psi: Array = absolute_jacobian(mechanism, placed(mechanism, q), t) @ mechanism.arrays.J
    return Psi


def scaled_jacobian(mechanism: Mechanism, q: ArrayLike, t: ArrayLike) -> Array:
    """Return Psi with displacements in units of a length, (..., r, n), m.

    So its columns are comparable.
    """
    Psi = closure_jacobian(mechanism, q, t)
    return Psi * mechanism.arrays.units if mechanism.slides else Psi


def absolute_jacobian(mechanism: Mechanism, at: Placed, t: ArrayLike) -> Array:
    """Return Psi in x, (..., r, n)."""
    return jacobian_at(mechanism, mechanism.arrays, at, t)


def closure_drift(mechanism: Mechanism, q: ArrayLike, t: ArrayLike) -> Array:
    """Return d gap/dt with joints held, (..., r), m/s; the gap's rate is Psi qd plus this."""
    return drift_at(mechanism, placed(mechanism, q), t)


def drift_at(mechanism: Mechanism, at: Placed, t: ArrayLike) -> Array:
    """Return d gap/dt of coupling laws with joints held, for a placed mechanism, (..., r)."""
    found = np.zeros((*at.x.shape[:-1], len(mechanism.rows)), at.x.dtype)
    if mechanism.driven and (laws := laws_of(mechanism)) is not None:
        laws.add_drift(at.x, t, found)
    return found


def closure_bias(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, t: ArrayLike) -> Array:
    """Return the gap's acceleration for qdd = 0, Psidot qd, (..., r), m/s^2.

    For laws of time it includes their own acceleration.
    """
    at, rates = placed(mechanism, q), absolute_rates(mechanism, qd)
    bent = at.accelerations(mechanism, rates, np.zeros_like(rates))
    return bias_at(mechanism, at, rates, bent, t)


def bias_at(mechanism: Mechanism, at: Placed, rates: Array, bent: Placed, t: ArrayLike) -> Array:
    """Return Psidot qd, where X'' is `bent` for zero accelerations."""
    P, ground = mechanism.arrays.P, mechanism.arrays.ground
    bias: Complex = matvec(P, bent.X)
    if mechanism.lines:
        moved = at.rates(mechanism, rates)
        bias = lines(mechanism, at.E).conj() * bias
        bias = bias + 2.0 * lines(mechanism, moved.E, 0.0).conj() * matvec(P, moved.X)
        bias = bias + lines(mechanism, bent.E, 0.0).conj() * (ground + matvec(P, at.X))
    found = np.array(bias.real)
    if (laws := laws_of(mechanism)) is not None:
        laws.add_bias(at.x, rates, t, found)
    return found


# -- the gap, in any precision ---------------------------------------------------------------------


def lines(mechanism: Mechanism, E: Complex, otherwise: float = 1.0) -> Complex:
    """Return E of the link that carries the line of each row, (..., r), or `otherwise`."""
    found = np.full((*E.shape[:-1], len(mechanism.rows)), otherwise, E.dtype)
    for r, line in mechanism.lines:
        found[..., r] = E[..., line]
    return found


def gap_at(mechanism: Mechanism, arrays: Arrays, at: Placed, t: ArrayLike) -> Array:
    """Return the gap (..., r), m, of a placed mechanism."""
    across: Complex = matvec(arrays.P, at.X)
    if mechanism.lines:
        across = lines(mechanism, at.E).conj() * (across + arrays.ground)
    gap: Array = across.real + arrays.offset
    if mechanism.has_angles:
        gap = gap + matvec(arrays.angles, at.x)
    if (laws := laws_of(mechanism)) is not None:
        laws.add_gap(at.x, t, gap)
    if mechanism.held:
        gap[..., list(mechanism.held)] = 0.0
    return gap


def jacobian_at(mechanism: Mechanism, arrays: Arrays, at: Placed, t: ArrayLike) -> Array:
    """Return d gap/dx, (..., r, n), of a placed mechanism."""
    P = arrays.P
    if mechanism.lines:
        P = lines(mechanism, at.E).conj()[..., None] * P
    Psi: Array = columns(mechanism, P, at.X[..., None, :], at.E[..., None, :]).real + arrays.angles
    for r, line in mechanism.lines:
        across = arrays.ground[r] + (at.X * arrays.P[r]).sum(axis=-1)
        Psi[..., r, line] += (at.E[..., line].conj() * across).imag
    if (laws := laws_of(mechanism)) is not None:
        laws.add_jacobian(at.x, t, Psi)
    return Psi


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
