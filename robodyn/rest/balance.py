"""The forces on a mechanism at one state, along the motions that its closures leave.

With N a basis of the null space of Psi, and h = M qdd + C qd + D qd + G - Q what torques and pin
forces must balance (`required_load`), a mechanism rests where gap(q) = 0 and

    r = N^T (tau - h) = 0

At rest Psi^T lambda = h - tau gives the pin forces, and along closed motions r changes by -K:

    K = N^T (dh/dq - d(Psi^T lambda)/dq) N,      dr = -K dz,     dq = N dz

The derivatives of h are tangents of the program.  The gap's own bend is the symmetric B in
d(Psi u)/dq v = B(u, v), of which `closure_bias` is B(u, u).  Displacements are told in units of
a length, so that they compare with angles: N is orthonormal in these.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.dense_dynamics import decompose, joint_loads, required_load
from robodyn.dynamics.derivatives import InverseDerivatives, inverse_dynamics_derivatives
from robodyn.elements.contacts import STICKS
from robodyn.errors import InputError
from robodyn.loops.closures import closure_bias, scaled_jacobian
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import as_states
from robodyn.tables.arrays import Array

ROUNDING = 1e-14  # part of what acts below which a force that is left over is rounding


class Balance(NamedTuple):
    """Forces and stiffness at a pose at rest; f freedoms, r rows of closures."""

    N: Array  # (n, f)
    force: Array  # (f,) N^T (tau - h)
    stiffness: Array  # (f, f) K
    load: InverseDerivatives  # h (n,) as `tau`, and its derivatives (n, n)
    multipliers: Array  # (r,) lambda, N


def single(mechanism: Mechanism, name: str, values: ArrayLike | None) -> Array:
    """The values of one state, (n,), zeros for None; InputError where they are not so many."""
    if values is None:
        return np.zeros(mechanism.n)
    state = as_states(mechanism, name, values)
    if state.ndim != 1:
        raise InputError(f"{name}.shape", value=state.shape, limit=f"must be ({mechanism.n},)")
    return state.copy()


@lru_cache(maxsize=64)
def unclosed(mechanism: Mechanism) -> Mechanism:
    """The tree alone, every joint driven: its torques are h."""
    return replace(mechanism, rows=(), actuated=tuple(range(mechanism.n)))


def free_motions(mechanism: Mechanism, q: Array) -> Array:
    """N (n, f) at q (n,)."""
    found = decompose(mechanism, scaled_jacobian(mechanism, q, 0.0))
    return np.asarray(mechanism.arrays.units[:, None] * found.V[:, int(found.rank) :])


def rests(mechanism: Mechanism, q: Array, qd: Array, tau: Array) -> NDArray[np.bool_]:
    """Return which closed states q, qd (k, n) are rests under tau (k, n), but for rounding.

    What is left over there is rounding of what acts, and no push.  A mechanism that friction holds,
    or whose loads vary with time, has none.
    """
    still = ~qd.any(axis=-1)
    if STICKS in mechanism.contacts or mechanism.timed or not still.any():
        return np.zeros(len(q), bool)
    zero, units, arrays = np.zeros_like(q), mechanism.arrays.units, mechanism.arrays
    load = joint_loads(mechanism, q, zero, 0.0)
    left = units * (tau - required_load(mechanism, q, zero, zero))
    acts = np.abs(load).max(axis=-1) + np.abs(tau).max(axis=-1)
    acts += np.abs(arrays.weights).sum() + np.abs(arrays.moments).sum()
    if mechanism.rows:
        found = decompose(mechanism, scaled_jacobian(mechanism, q, 0.0))
        free = np.arange(mechanism.n) >= np.asarray(found.rank)[:, None]
        left = np.where(free, (left[:, None, :] @ found.V)[:, 0], 0.0)
    return np.asarray(still & (np.abs(left).max(axis=-1) <= ROUNDING * acts * units.max()))


def bend(mechanism: Mechanism, q: Array, u: Array, v: Array) -> Array:
    """B(u, v) (..., r) at q of rates u, v, (..., n) that broadcast."""
    sums = [closure_bias(mechanism, q, x, 0.0) for x in (u + v, u - v)]
    return np.asarray((sums[0] - sums[1]) / 4.0)


def balance(mechanism: Mechanism, q: Array, tau: Array) -> Balance:
    """The balance at rest at q (n,) under the joint torques tau (n,), loads those of t = 0.

    Raises SingularError where the ends of a spring with a free length coincide.
    """
    return balances(mechanism, q[None], tau)[0]


def balances(mechanism: Mechanism, q: Array, tau: Array) -> list[Balance]:
    """The balance at each of q (k, n); see `balance`."""
    units = mechanism.arrays.units[:, None]
    load = inverse_dynamics_derivatives(unclosed(mechanism), q, np.zeros_like(q), np.zeros_like(q))
    closures = decompose(mechanism, scaled_jacobian(mechanism, q, 0.0))
    missing = tau - load.tau
    multipliers = np.zeros((len(q), len(mechanism.rows)))
    if mechanism.rows:
        turned = np.swapaxes(closures.inverse, -1, -2)
        multipliers = -(turned @ (units * missing[..., None]))[..., 0]
    found: dict[int, Balance] = {}
    for rank in sorted(set(closures.rank.tolist())):  # so many columns of V are free motions
        which = np.flatnonzero(closures.rank == rank)
        N = units * closures.V[which][..., rank:]
        Nt = np.swapaxes(N, -1, -2)
        K, force = Nt @ load.by_q[which] @ N, (Nt @ missing[which][..., None])[..., 0]
        if mechanism.rows:
            bends = bend(mechanism, q[which][:, None, None], Nt[:, :, None], Nt[:, None])
            K = K - (bends * multipliers[which][:, None, None]).sum(axis=-1)
        for place, k in enumerate(which.tolist()):
            one = InverseDerivatives(*(x[k] for x in load))
            found[k] = Balance(N[place], force[place], K[place], one, multipliers[k])
    return [found[k] for k in range(len(q))]
