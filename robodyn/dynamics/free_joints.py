"""The residual of a given motion at joints that no actuator drives.

A mechanism with fewer actuators than freedoms can only make some motions.  With z the actuated
joints and enough free ones to make up the freedoms, and N (n, f) with Psi N = 0 and N_z = I, the
torques at z are

    tau_z = N^T (M qdd + C qd + D qd + G - Q)

The torque at a free joint is its residual: zero for a possible motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from itertools import combinations, islice

import numpy as np

from robodyn.dynamics.closed_form import coriolis_matrix, gravity_vector, mass_matrix
from robodyn.dynamics.dense_dynamics import decompose
from robodyn.dynamics.derivatives import inverse_dynamics_derivatives
from robodyn.dynamics.sticking import bounds, resting, touching
from robodyn.errors import ResidualError
from robodyn.loops.closing import closed_jacobians, loop_size, regular_rank
from robodyn.loops.closures import scaled_jacobian
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.parts import without_rubbing
from robodyn.mechanics.placed import matvec
from robodyn.tables.arrays import Array

CHOICES = 1000  # of joints that count as free
TINY = 1e-12  # a singular value that is none
NONE = 1e-9  # a residual below this part of the largest term of its equation is zero
ROUNDING = 1e-12  # or one that changes of the state by this part of it balance


@lru_cache(maxsize=64)
def balanced_joints(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the joints whose torques are known: actuated ones, and free ones (0).

    With N (n, f) whose columns keep the loops closed, N^T Y pi = N^T tau.  In a closed mechanism,
    as many joints are free as rates are left open by actuated joints and loops: those that
    determine the other rates best, on average over some poses.
    """
    n, driven = mechanism.n, mechanism.actuated
    if not mechanism.rows:
        return tuple(range(n))
    free = n - regular_rank(mechanism) - len(driven)
    if free <= 0:
        return driven
    Psi = closed_jacobians(mechanism) / loop_size(mechanism)
    every = combinations([k for k in range(n) if k not in driven], free)

    def told(chosen: tuple[int, ...]) -> float:
        """Return how far Psi is from singular for the rates of the other joints."""
        others = [k for k in range(n) if k not in (*driven, *chosen)]
        least = np.linalg.svd(Psi[..., others], compute_uv=False).min(axis=-1, initial=1.0)
        return float(np.log(least + TINY).mean())

    return tuple(sorted((*driven, *max(islice(every, CHOICES), key=told))))


@lru_cache(maxsize=64)
def balanced_mechanism(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism with its balanced joints as actuated ones."""
    return replace(mechanism, actuated=balanced_joints(mechanism))


def free_joints(mechanism: Mechanism) -> list[int]:
    """Return the joints with residuals; [] if actuators are as many as freedoms."""
    if len(mechanism.actuated) >= mechanism.n - len(mechanism.rows):
        return []
    return [k for k in balanced_joints(mechanism) if k not in mechanism.actuated]


def without_residual(
    mechanism: Mechanism, states: Mapping[str, Array], times: Array, tau: Array
) -> Array:
    """Return the torques tau (..., n) of the balanced mechanism, zero at free joints.

    Raises ResidualError for the first of the states q, qd, qdd (..., n) whose residual exceeds 1e-9
    of the largest of M qdd, C qd, D qd, G and Q in its equation.  Rounding of the state, static
    friction, and stops of a joint at rest may account for it.
    """
    n, free = mechanism.n, free_joints(mechanism)
    q, qd, qdd = (x.reshape(-1, n) for x in states.values())
    at, left = np.broadcast_to(times.ravel(), len(q)), tau.reshape(-1, n)[:, free]
    terms = _terms(mechanism, q, qd, qdd, left, at)
    for row, place in np.argwhere(~(np.abs(left) <= NONE * terms)):
        joint, residual = free[place], float(left[row, place])
        state = q[row], qd[row], qdd[row], float(at[row])
        if not _held(mechanism, joint, residual, *state):
            unit, name = "N" if joint in mechanism.slides else "N m", mechanism.link_names[joint]
            raise ResidualError(
                f"residual{joint + 1}",
                where=mechanism.source,
                value=f"{residual:.6g} {unit}",
                limit=f"must be 0, as joint {name} is free; name it in `actuated`",
            )
    known = np.zeros_like(tau)
    known[..., list(mechanism.actuated)] = tau[..., list(mechanism.actuated)]
    return known


def _terms(mechanism: Mechanism, q: Array, qd: Array, qdd: Array, left: Array, t: Array) -> Array:
    """Return the largest term in the equation of each free joint, (T, free), with residual `left`.

    In loops it is at least what rounding of the multipliers makes visible.
    """
    inertial = matvec(mass_matrix(mechanism, q), qdd)
    bent = matvec(coriolis_matrix(mechanism, q, qd), qd)
    damped = mechanism.arrays.damping * qd
    terms = np.stack([inertial, bent, damped, gravity_vector(mechanism, q)])
    free = free_joints(mechanism)
    if mechanism.rows:
        units, z = mechanism.arrays.units, list(balanced_joints(mechanism))
        s = decompose(mechanism, scaled_jacobian(mechanism, q, t))
        kept = s.V * (np.arange(mechanism.n) < s.rank[..., None])[..., None, :]
        freedoms = np.eye(mechanism.n) - kept @ np.swapaxes(kept, -1, -2)
        N = units[:, None] * freedoms @ np.linalg.pinv(units[z, None] * freedoms[:, z])
        # what the multipliers are solved from, and may leave by rounding
        solved = np.abs(terms * units).max(axis=(0, -1), initial=0.0)[:, None] / units[free]
        terms = matvec(np.swapaxes(N[..., [z.index(k) for k in free]], -1, -2), terms)
        terms = np.concatenate([terms, ROUNDING / NONE * solved[None]])
    else:
        terms = terms[..., free]
    Q = terms[:4].sum(axis=0) - left
    return np.asarray(np.maximum(np.abs(terms).max(axis=0), np.abs(Q)))


def _held(
    mechanism: Mechanism, joint: int, residual: float, q: Array, qd: Array, qdd: Array, t: float
) -> bool:
    """Return whether friction, a stop at rest, or rounding of the state explains this residual.

    A pose of a mechanism at rest need only be within 1e-9 rad of one in which it rests.
    """
    known = without_rubbing(balanced_mechanism(mechanism))
    by = inverse_dynamics_derivatives(known, q, qd, qdd, t)
    size = np.maximum(np.abs(q), mechanism.arrays.units)
    parts = ((by.by_q, size), (by.by_qd, np.abs(qd)), (by.by_qdd, np.abs(qdd)))
    still = not (qd.any() or qdd.any())
    slack = (NONE if still else ROUNDING) * sum(np.abs(x[joint]) @ y for x, y in parts)
    low = high = 0.0
    if not (qd[joint] or qdd[joint]):
        sides = [side for k, side in touching(mechanism, q, qd, t) if k == joint]
        if sides or joint in resting(mechanism, qd):
            low, high = bounds(mechanism, joint, sides)
    return bool(low - slack <= residual <= high + slack)
