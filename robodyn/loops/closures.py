"""Closures: the gap of each loop, Psi = d gap/dq, and their rates, in any precision.

With x = J q the links' angles and displacements, X = exp(i x) for what turns and x times its
direction for what slides (`placed.py`),

    gap = Re(conj(E_line) P X) + angles x + offset      Psi = d gap/dq
    Psidot qd = gap'' without accelerations

P, angles and offset are constants of `mechanism.py`; E_line is the direction of the link that
carries the line of a slider, 1 on the ground.  Laws of couplings are added by
`coupling_laws.py`.  Arrays are vectorised over leading axes; radians, SI units.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from robodyn.engines.coupling_laws import laws_of
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import Placed, absolute_rates, columns, matvec, placed
from robodyn.mechanics.planar_model import Arrays
from robodyn.tables.arrays import Array, Complex


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
