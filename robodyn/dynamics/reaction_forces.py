"""The force in every joint, and what a mechanism does to the ground that carries it.

Newton's equation of all bodies b that link k carries, itself and payloads included, has only one
unknown: the force R_k that acts on link k at its own joint, from the link (or the ground) that it
hangs from.  With the pin forces f_c on the side that closure c names first,

    R_k = sum_b m_b (a_b - gamma) - sum_c (+1 first side, -1 second side below k) f_c - F_k   (2)

F_k is what springs and loads put on all that link k carries.

The ground feels the momentum that changes and the weight, whichever way the forces take:

    F = sum_b m_b (gamma - a_b)      M = sum_b s_b x m_b (gamma - a_b) - sum_k I_k alphadd_k   (3)

and the loads besides.  Joint torques, dampers, pins and springs between links are internal; those
at the ground are in F and M.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.closed_form import absolute_rates, as_states, closure_jacobian, phases
from robodyn.dynamics.dense_dynamics import RANK_CUT
from robodyn.dynamics.dynamics import coupling_torques, pin_forces
from robodyn.dynamics.forces import forces_on_links, load_wrench
from robodyn.engines.singular_values import svd
from robodyn.errors import InputError
from robodyn.loops.closing import loop_size
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.planar_model import coefficient_matrix

Array = NDArray[np.float64]

FELT = 1e-9  # part of the largest force of a null vector that is more than rounding


class _Bodies(NamedTuple):
    """The point masses (centres of gravity and payloads) of a mechanism: b of them, n links."""

    mass: Array  # (b,) kg
    constant: NDArray[np.complex128]  # (b,) m
    rho: NDArray[np.complex128]  # (b, n) m: s = constant + rho E
    below: Array  # (b, n), 1 where link k carries body b
    sides: Array  # (closures, n), +1 and -1 where link k carries the first and the second side
    inertia: Array  # (n,) kg m^2


def reactions(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, multipliers: ArrayLike
) -> Array:
    """The force on each link at its own joint, equation (2), (..., n, 2), N, ground axes.

    It comes from the link, or the ground, that the link hangs from.  q, qd, qdd (..., n) are a
    motion, rad and s, and multipliers (..., r) N those of `inverse_dynamics_and_forces` or
    `forward_dynamics_and_forces` for it, (..., 0) without closures.  Raises InputError for arrays
    that do not fit.
    """
    bodies = _bodies(mechanism)
    lam = np.asarray(multipliers, float)
    if lam.shape[-1:] != (len(mechanism.rows),):
        limit = f"must have {len(mechanism.rows)} values along the last axis, one a closure row"
        raise InputError("multipliers.shape", value=lam.shape, limit=limit)
    _, load = _motion(mechanism, bodies, q, qd, qdd)
    forces = -(load @ bodies.below)
    if mechanism.springs or mechanism.forces:
        E, rates = phases(mechanism, q), absolute_rates(mechanism, qd)
        forces = forces - forces_on_links(mechanism, E, rates) @ mechanism.arrays.J
    if len(bodies.sides):
        pins = pin_forces(mechanism, lam)
        forces = forces - (pins[..., 0] + 1j * pins[..., 1]) @ bodies.sides
    return np.stack([forces.real, forces.imag], axis=-1)


def shaking_force(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """What the mechanism does to the ground, equation (3), (..., 3): Fx, Fy N, M N m.

    M is about the origin, counter-clockwise.  All joints that hang from the ground, closures to
    ground points, sliders, springs to the ground, and torques and dampers of ground joints are in
    it.  q, qd, qdd (..., n)
    are a motion that obeys equation (1), rad and s.  Raises InputError for arrays that do not fit.
    """
    bodies = _bodies(mechanism)
    place, load = _motion(mechanism, bodies, q, qd, qdd)
    force = load.sum(axis=-1)
    moment = (place.conj() * load).imag.sum(axis=-1)
    moment = moment - absolute_rates(mechanism, qdd, "qdd") @ bodies.inertia
    if mechanism.forces or any(mechanism.moments):
        of_loads = load_wrench(mechanism, phases(mechanism, q))
        force, moment = force + of_loads[0], moment + of_loads[1]
    return np.stack([force.real, force.imag, moment], axis=-1)


def dependent_rows(mechanism: Mechanism, q: ArrayLike) -> NDArray[np.int64]:
    """How many closure rows follow from the others at q (..., n): r less the rank of Psi, (...).

    Where it is not zero, the pin forces are not unique.
    """
    s = np.linalg.svd(closure_jacobian(mechanism, q), compute_uv=False)
    rank = (s > RANK_CUT * loop_size(mechanism)).sum(axis=-1)
    return np.asarray(len(mechanism.rows) - rank)


def not_unique(mechanism: Mechanism, q: ArrayLike) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The closures and the links whose pin force and reaction are not unique at q (n,).

    lambda may change by any null vector of Psi^T, and equation (2) carries that change into the
    joints of the loops.  Both are empty where the closures are independent.
    """
    if not mechanism.rows:
        return (), ()
    U, s, _ = svd(closure_jacobian(mechanism, q), full=True)
    rank = int((s > RANK_CUT * loop_size(mechanism)).sum())
    pins = pin_forces(mechanism, U[:, rank:].T)
    changes = pins[..., 0] + 1j * pins[..., 1]
    at_closures = (np.abs(changes) > FELT).any(axis=0)
    at_joints = (np.abs(changes @ _bodies(mechanism).sides) > FELT).any(axis=0)
    closures, joints = np.flatnonzero(at_closures), np.flatnonzero(at_joints)
    return tuple(closures.tolist()), tuple(joints.tolist())


def dependent_couplings(mechanism: Mechanism, q: ArrayLike) -> tuple[int, ...]:
    """The couplings whose torque is not unique at q (n,)."""
    if not mechanism.description.couplings:
        return ()
    U, s, _ = svd(closure_jacobian(mechanism, q), full=True)
    rank = int((s > RANK_CUT * loop_size(mechanism)).sum())
    changes = coupling_torques(mechanism, U[:, rank:].T)
    found = np.flatnonzero((np.abs(changes) > FELT * loop_size(mechanism)).any(axis=0))
    return tuple(found.tolist())


def _motion(
    mechanism: Mechanism, bodies: _Bodies, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Where the bodies are, (..., b) m, and the load m (gamma - a) of each, (..., b) N."""
    E = phases(mechanism, as_states(mechanism, "q", q))
    turning = 1j * absolute_rates(mechanism, qdd, "qdd") - absolute_rates(mechanism, qd) ** 2
    acceleration = (E * turning) @ bodies.rho.T
    return E @ bodies.rho.T + bodies.constant, bodies.mass * (mechanism.gamma - acceleration)


@lru_cache(maxsize=64)
def _bodies(mechanism: Mechanism) -> _Bodies:
    links, n = mechanism.description.links, mechanism.n
    own = [(k, link.m, mechanism.centres[k]) for k, link in enumerate(links) if link.m]
    own += [(k, link.payload, mechanism.tips[k]) for k, link in enumerate(links) if link.payload]
    rho = coefficient_matrix([point for _, _, point in own], n)
    carried = mechanism.arrays.J  # row k has ones at the links that carry link k
    closures = mechanism.description.closures
    sides = np.zeros((len(closures), n))
    for c, closure in enumerate(closures):
        if closure.first.link is not None:
            sides[c] += carried[closure.first.link]
        if closure.second.link is not None:
            sides[c] -= carried[closure.second.link]
    return _Bodies(
        mass=np.array([mass for _, mass, _ in own], float),
        constant=np.array([point.constant for _, _, point in own], complex),
        rho=rho,
        below=carried[[k for k, _, _ in own]],
        sides=sides,
        inertia=np.array([link.I for link in links], float),
    )
