"""Springs, forces that turn with a link, and friction: what acts besides weights and dampers.

A spring between two points with d = first - second = const + sum_k c_k E_k and s = |d| pulls its
first end by F and its second by -F,

    F = -(stiffness (1 - length/s) + damping sdot/s) d,     sdot = Re(conj(d) ddot)/s

A force F at a point that link angles move by c_k gives the torques Q_k = Im(conj(c_k E_k) F) in
absolute angles.  A joint's spring gives -stiffness (q - angle), its Coulomb friction
-torque tanh(qd/speed).  Torques of springs are -dPE/dq; the others have no potential.

`closed_form.py` calls this where a scene names such forces, with E and alphad at hand.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import SingularError
from robodyn.mechanics.planar_model import Mechanism, coefficient_matrix

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MANY = 200  # links, from which a walk over the tree costs less than a product with J
COINCIDE = 1e-300  # m; ends of a spring nearer than this have no direction


class _Constants(NamedTuple):
    """The numbers of p springs and f forces that turn, n links."""

    constant: Complex  # (p,) m
    c: Complex  # (p, n) m
    stiffness: Array  # (p,)
    length: Array
    damping: Array
    directed: NDArray[np.bool_]  # (p,) whether it needs a direction
    force: Complex  # (f,) N
    turning_with: NDArray[np.int64]  # (f,)
    arm: Complex  # (f, n) m


def potential_torques(mechanism: Mechanism, q: Array, E: Complex) -> Array:
    """-dPE/dq of the springs, (..., n), N m.

    Raises SingularError where the ends of a spring with a free length coincide.
    """
    Q = np.zeros(q.shape)
    if mechanism.springs:
        x = _constants(mechanism)
        d, s = _stretched(mechanism, x, E)
        absolute = _torques(x.c, E, -(x.stiffness * (1.0 - x.length / s)) * d)
        Q = _to_joints(mechanism, absolute)
    for spring in mechanism.joint_springs:
        Q[..., spring.joint] -= spring.stiffness * (q[..., spring.joint] - spring.angle)
    return Q


def other_torques(mechanism: Mechanism, qd: Array, E: Complex, rates: Array) -> Array:
    """The joint torques (..., n), N m, of what has no potential, but for dampers of joints.

    Dampers of springs, forces that turn with a link, friction; `rates` is alphad.
    """
    x = _constants(mechanism)
    Q = np.zeros(np.broadcast_shapes(qd.shape, E.shape))
    if x.damping.any():
        d, s = _stretched(mechanism, x, E)
        Q = Q + _torques(x.c, E, -x.damping * _stretching(x, E, rates, d, s) * d)
    if len(x.force):
        Q = Q + _torques(x.arm, E, x.force * E[..., x.turning_with])
    if x.damping.any() or len(x.force):
        Q = _to_joints(mechanism, Q)
    for joint, friction in mechanism.friction:
        Q[..., joint] -= friction.torque * np.tanh(qd[..., joint] / friction.speed)
    return Q


def spring_energy(mechanism: Mechanism, q: Array, E: Complex) -> Array:
    """1/2 stiffness (s - length)^2 and the like, of all springs, (...), J."""
    x = _constants(mechanism)
    s = np.abs(x.constant + E @ x.c.T)
    PE: Array = 0.5 * (s - x.length) ** 2 @ x.stiffness
    for spring in mechanism.joint_springs:
        PE = PE + 0.5 * spring.stiffness * (q[..., spring.joint] - spring.angle) ** 2
    return PE


def forces_on_links(mechanism: Mechanism, E: Complex, rates: Array) -> Complex:
    """What springs and loads put on each link, (..., n), N, as Fx + i Fy."""
    total = np.zeros(E.shape, complex)
    if mechanism.springs:
        F = spring_forces(mechanism, E, rates)
        for p, spring in enumerate(mechanism.springs):
            for link, sign in ((spring.first, 1.0), (spring.second, -1.0)):
                if link is not None:
                    total[..., link] += sign * F[..., p]
    for load in mechanism.forces:
        total[..., load.link] += load.force * (E[..., load.link] if load.turns else 1.0)
    return total


def spring_forces(mechanism: Mechanism, E: Complex, rates: Array) -> Complex:
    """F of each spring between points, damper included, on its first end, (..., p), N."""
    x = _constants(mechanism)
    d, s = _stretched(mechanism, x, E)
    pull = x.stiffness * (1.0 - x.length / s)
    if x.damping.any():
        pull = pull + x.damping * _stretching(x, E, rates, d, s)
    F: Complex = -pull * d
    return F


def load_wrench(mechanism: Mechanism, E: Complex) -> tuple[Complex, Array]:
    """The loads of a scene in all, (...): force Fx + i Fy, N, and moment about the origin, N m."""
    force = np.zeros(E.shape[:-1], complex)
    moment = np.full(E.shape[:-1], float(sum(mechanism.moments)))
    for load in mechanism.forces:
        F = load.force * (E[..., load.link] if load.turns else np.ones(E.shape[:-1]))
        place = load.point.constant + sum(c * E[..., k] for k, c in load.point.terms)
        force = force + F
        moment = moment + (np.conj(place) * F).imag
    return force, moment


def _torques(c: Complex, E: Complex, F: Complex) -> Array:
    """Im(conj(c_k E_k) F) in absolute angles, (..., n), summed over the forces F (..., p)."""
    Q: Array = (E.conj() * (F @ c.conj())).imag
    return Q


def _to_joints(mechanism: Mechanism, absolute: Array) -> Array:
    """J^T times torques in absolute angles, (..., n)."""
    if mechanism.n > MANY:
        torques = absolute.copy()
        for k in reversed(mechanism.order):
            above = mechanism.parent[k]
            if above is not None:
                torques[..., above] += torques[..., k]
        return torques
    result: Array = absolute @ mechanism.arrays.J
    return result


def _stretched(mechanism: Mechanism, x: _Constants, E: Complex) -> tuple[Complex, Array]:
    """d and s of all springs; s is 1 where nothing asks for a direction."""
    d = x.constant + E @ x.c.T
    s = np.abs(d)
    lost = (s < COINCIDE) & x.directed
    if lost.any():
        raise no_direction(mechanism, int(np.argwhere(lost)[0][-1]))
    return d, np.where(x.directed, s, 1.0)


def no_direction(mechanism: Mechanism, spring: int) -> SingularError:
    """The error of a spring between points whose ends coincide."""
    return SingularError(
        f"the ends of spring {spring + 1} between two points coincide",
        where=mechanism.source,
        limit="its force has no direction there; only length 0 without damping allows that",
    )


def _stretching(x: _Constants, E: Complex, rates: Array, d: Complex, s: Array) -> Array:
    """sdot/s of all springs, 1/s."""
    ddot = (1j * E * rates) @ x.c.T
    result: Array = (d.conj() * ddot).real / s**2
    return result


@lru_cache(maxsize=64)
def _constants(mechanism: Mechanism) -> _Constants:
    springs = mechanism.springs
    turning = [force for force in mechanism.forces if force.turns]
    return _Constants(
        constant=np.array([spring.between.constant for spring in springs], complex),
        c=coefficient_matrix([spring.between for spring in springs], mechanism.n),
        stiffness=np.array([spring.stiffness for spring in springs], float),
        length=np.array([spring.length for spring in springs], float),
        damping=np.array([spring.damping for spring in springs], float),
        directed=np.array([bool(x.stiffness * x.length or x.damping) for x in springs], bool),
        force=np.array([force.force for force in turning], complex),
        turning_with=np.array([force.link for force in turning], int),
        arm=coefficient_matrix([force.point for force in turning], mechanism.n),
    )
