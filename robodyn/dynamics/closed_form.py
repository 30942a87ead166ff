"""M, C, G, Psi, energies and points of a mechanism, vectorised over any leading axes.

With E = exp(i alpha), alpha = J q, and W = conj(E)[:, None] * A * E[None, :],

    M = J^T Re(W) J      C = -J^T (Im(W) * alphad[None, :]) J      G = J^T (Im(w E) - moments)
    KE = 1/2 alphad^T Re(W) alphad      PE = -Re(w . E) - moments . alpha + const
    gap = Re(P E) + angles alpha + offset      Psi = (angles - Im(P * E)) J
    Psidot qd = -Re(P (E * alphad^2))

where A, J, P, the weights w (conj(gamma) B, but for constant forces) and the moments are the
constants of `mechanism.py`.  This C is the Christoffel one: Mdot - 2C is skew-symmetric.  The
equation of motion, which every docstring refers to, is

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0                        (1)

with D the diagonal matrix of joint damping.  Springs of a scene are in G and PE, what else acts
is Q, from the rows of the program (`row_values.py`, which only scenes that have some import).
States are arrays (..., n); radians, SI units.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.errors import InputError
from robodyn.mechanics import parts
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def as_states(mechanism: Mechanism, name: str, values: ArrayLike) -> Array:
    """`values` as floats (..., n); InputError unless they are finite and n wide."""
    return finite(name, n_wide(mechanism, name, values))


def n_wide(mechanism: Mechanism, name: str, values: ArrayLike) -> Array:
    """`values` as floats (..., n); InputError unless they are n wide."""
    array = np.asarray(values, dtype=float)
    n = mechanism.n
    if array.ndim == 0 or array.shape[-1] != n:
        limit = f"must have {n} values along the last axis, one a joint"
        raise InputError(f"{name}.shape", value=array.shape, limit=limit)
    return array


def finite(name: str, array: Array) -> Array:
    """The array; InputError that names the first value which is not finite."""
    if not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0]
        place = f"{name}[{', '.join(map(str, where))}]"
        raise InputError(place, value=array[tuple(where)], limit="must be finite")
    return array


def matvec(matrix: NDArray[Any], vector: NDArray[Any]) -> Array:
    """Matrices (..., r, n) times vectors (..., n)."""
    return np.asarray((matrix @ vector[..., None])[..., 0])


def phases(mechanism: Mechanism, q: ArrayLike) -> Complex:
    """E = exp(i J q), the links' directions, (..., n)."""
    alpha = as_states(mechanism, "q", q) @ mechanism.arrays.J.T
    E = np.empty(alpha.shape, complex)
    np.cos(alpha, out=E.real)
    np.sin(alpha, out=E.imag)
    return E


def absolute_rates(mechanism: Mechanism, qd: ArrayLike, name: str = "qd") -> Array:
    """alphad = J qd, the links' angular velocities, (..., n)."""
    rates: Array = as_states(mechanism, name, qd) @ mechanism.arrays.J.T
    return rates


def absolute_inertia(mechanism: Mechanism, E: Complex) -> Complex:
    """W = conj(E)[:, None] * A * E[None, :], (..., n, n); its real part is M in alpha."""
    W: Complex = E.conj()[..., :, None] * mechanism.arrays.A * E[..., None, :]
    return W


def mass_matrix(mechanism: Mechanism, q: ArrayLike) -> Array:
    """M of equation (1), (..., n, n), kg m^2: symmetric, positive definite if all links have mass.

    Raises InputError where q is not finite or not n wide.
    """
    J = mechanism.arrays.J
    M: Array = J.T @ absolute_inertia(mechanism, phases(mechanism, q)).real @ J
    return M


def coriolis_matrix(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike) -> Array:
    """The Christoffel C of equation (1), (..., n, n), kg m^2/s: Mdot - 2C is skew-symmetric.

    Raises InputError where q or qd is not finite or not n wide.
    """
    J = mechanism.arrays.J
    W = absolute_inertia(mechanism, phases(mechanism, q))
    C: Array = J.T @ (-W.imag * absolute_rates(mechanism, qd)[..., None, :]) @ J
    return C


def gravity_vector(mechanism: Mechanism, q: ArrayLike) -> Array:
    """G = dPE/dq of equation (1), (..., n), N m: of gravity, springs, constant forces and torques.

    Raises InputError where q is not finite or not n wide, SingularError where the ends of a spring
    with a free length coincide.
    """
    E = phases(mechanism, q)
    arrays = mechanism.arrays
    G: Array = ((arrays.weights * E).imag - arrays.moments) @ arrays.J
    if mechanism.springs or mechanism.joint_springs:
        from robodyn.engines.row_values import rows_of

        G = G + rows_of(parts.stored, mechanism)("torques", q)
    return G


def other_forces(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike) -> Array:
    """Q of equation (1), (..., n), N m: of what has no potential, but for dampers of joints.

    Dampers of springs, forces that turn with a link, friction.  Raises InputError where q or qd is
    not finite or not n wide, SingularError where the ends of a damped spring coincide.
    """
    from robodyn.engines.row_values import rows_of

    states = as_states(mechanism, "q", q), as_states(mechanism, "qd", qd)
    return 0.0 - rows_of(parts.spent, mechanism)("torques", *states)  # of nothing no -0.0


def kinetic_energy(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike) -> Array:
    """KE = 1/2 qd^T M qd, (...), J."""
    return energies(mechanism, q, qd)[0]


def potential_energy(mechanism: Mechanism, q: ArrayLike) -> Array:
    """PE of gravity, springs, constant forces and torques, (...), J.

    That of gravity is zero at the origin's height, that of a force where its point is at the
    origin, that of a torque where its link points along +X.
    """
    return energies(mechanism, q, np.zeros(mechanism.n))[1]


def energies(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike) -> tuple[Array, Array]:
    """KE and PE, (...), J, of the same states: the links' directions are found once."""
    arrays, E = mechanism.arrays, phases(mechanism, q)
    v = E * absolute_rates(mechanism, qd)
    KE: Array = 0.5 * ((v @ arrays.A.T) * v.conj()).real.sum(axis=-1)
    PE: Array = mechanism.energy_offset - (E @ arrays.weights).real
    if any(mechanism.moments):
        PE = PE - absolute_rates(mechanism, q, "q") @ arrays.moments
    if mechanism.springs or mechanism.joint_springs:
        from robodyn.engines.row_values import rows_of

        PE = PE + rows_of(parts.stored, mechanism)("PE", q)[..., 0]
    return KE, PE


def closure_gap(mechanism: Mechanism, q: ArrayLike) -> Array:
    """How far the closures are from closing, first side minus second, (..., r), m.

    Two components (x, y) for a pin, one (normal to the line) for a slider, and one for a coupling:
    what its joint is ahead, rad, times a length of the mechanism.
    """
    arrays = mechanism.arrays
    gap: Array = (phases(mechanism, q) @ arrays.P.T).real + arrays.offset
    if mechanism.description.couplings:
        gap = gap + absolute_rates(mechanism, q, "q") @ arrays.angles.T
    return gap


def closure_jacobian(mechanism: Mechanism, q: ArrayLike) -> Array:
    """Psi = d gap/dq, (..., r, n), m/rad."""
    Psi: Array = absolute_jacobian(mechanism, phases(mechanism, q)) @ mechanism.arrays.J
    return Psi


def absolute_jacobian(mechanism: Mechanism, E: Complex) -> Array:
    """Psi in alpha, (..., r, n), m/rad."""
    Psi: Array = mechanism.arrays.angles - (mechanism.arrays.P * E[..., None, :]).imag
    return Psi


def closure_rate(mechanism: Mechanism, q: ArrayLike, rates: Array) -> Array:
    """Psi qd, how fast the gap opens at links' angular velocities `rates` (..., n), (..., r), m/s.

    Of angular accelerations the part of the gap's acceleration that `closure_bias` is not.
    """
    arrays = mechanism.arrays
    opening: Array = -((phases(mechanism, q) * rates) @ arrays.P.T).imag
    return opening + rates @ arrays.angles.T if mechanism.description.couplings else opening


def closure_bias(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike) -> Array:
    """Psidot qd, the part of the gap's acceleration that qdd does not make, (..., r), m/s^2."""
    rates = absolute_rates(mechanism, qd)
    bias: Array = -((phases(mechanism, q) * rates**2) @ mechanism.arrays.P.T).real
    return bias


class Points(NamedTuple):
    """Points const + c E of a mechanism, p of them; their motion by E, alphad and alphadd."""

    constant: Complex  # (p,) m
    c: Complex  # (p, n) m

    def place(self, E: Complex) -> Complex:
        """(..., p), m."""
        return E @ self.c.T + self.constant

    def velocity(self, E: Complex, rates: Array) -> Complex:
        """(..., p), m/s."""
        return (1j * E * rates) @ self.c.T

    def acceleration(self, E: Complex, rates: Array, turning: Array) -> Complex:
        """(..., p), m/s^2."""
        return (E * (1j * turning - rates**2)) @ self.c.T


def points_of(mechanism: Mechanism, points: Sequence[PlanarPoint]) -> Points:
    """Points of the mechanism as arrays."""
    constant = np.array([point.constant for point in points], complex)
    c = np.zeros((len(points), mechanism.n), complex)
    for row, point in zip(c, points, strict=True):
        for k, value in point.terms:
            row[k] = value
    return Points(constant, c)


def point_motion(
    mechanism: Mechanism,
    points: Sequence[PlanarPoint],
    q: ArrayLike,
    qd: ArrayLike | None = None,
    qdd: ArrayLike | None = None,
) -> tuple[Array, Array, Array]:
    """Position m, velocity m/s and acceleration m/s^2 of points, each (..., points, 2).

    Rates and accelerations not given are zero.
    """
    these, E, zero = points_of(mechanism, points), phases(mechanism, q), np.zeros(mechanism.n)
    rates = absolute_rates(mechanism, zero if qd is None else qd)
    turning = absolute_rates(mechanism, zero if qdd is None else qdd, "qdd")
    moved = these.place(E), these.velocity(E, rates), these.acceleration(E, rates, turning)
    x, v, a = (np.stack([z.real, z.imag], axis=-1) for z in moved)
    return x, v, a


@lru_cache(maxsize=64)
def relative_matrix(mechanism: Mechanism) -> Array:
    """J^-1 (n, n): joint rates from absolute ones."""
    inverse = np.eye(mechanism.n)
    for k, above in enumerate(mechanism.parent):
        if above is not None:
            inverse[k, above] = -1.0
    return inverse
