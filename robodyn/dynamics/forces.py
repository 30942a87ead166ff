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
from robodyn.mechanics.planar_model import Force, Mechanism, coefficient_matrix

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

COINCIDE = 1e-300  # m; ends of a spring nearer than this have no direction


class _Springs(NamedTuple):
    """The numbers of p springs between points, n links."""

    constant: Complex  # (p,) m
    c: Complex  # (p, n) m
    stiffness: Array  # (p,)
    length: Array
    damping: Array
    directed: NDArray[np.bool_]  # (p,) whether it needs a direction


def potential_torques(mechanism: Mechanism, q: Array, E: Complex) -> Array:
    """-dPE/dq of the springs, (..., n), N m.

    Raises SingularError where the ends of a spring with a free length coincide.
    """
    Q = np.zeros(q.shape)
    if mechanism.springs:
        c = _springs(mechanism).c
        Q = _torques(c, E, spring_forces(mechanism, E)) @ mechanism.arrays.J
    for spring in mechanism.joint_springs:
        Q[..., spring.joint] -= spring.stiffness * (q[..., spring.joint] - spring.angle)
    return Q


def other_torques(mechanism: Mechanism, qd: Array, E: Complex, rates: Array) -> Array:
    """The joint torques (..., n), N m, of what has no potential, but for dampers of joints.

    Dampers of springs, forces that turn with a link, friction; `rates` is alphad.
    """
    springs = _springs(mechanism)
    turning = [force for force in mechanism.forces if force.turns]
    Q = np.zeros(np.broadcast_shapes(qd.shape, E.shape))
    if springs.damping.any():
        Q = Q + _torques(springs.c, E, spring_forces(mechanism, E, rates, elastic=False))
    if turning:
        c = coefficient_matrix([force.point for force in turning], mechanism.n)
        F = np.stack([load_force(force, E) for force in turning], axis=-1)
        Q = Q + _torques(c, E, F)
    if springs.damping.any() or turning:
        Q = Q @ mechanism.arrays.J
    for joint, friction in mechanism.friction:
        Q[..., joint] -= friction.torque * np.tanh(qd[..., joint] / friction.speed)
    return Q


def spring_energy(mechanism: Mechanism, q: Array, E: Complex) -> Array:
    """1/2 stiffness (s - length)^2 and the like, of all springs, (...), J."""
    x = _springs(mechanism)
    s = np.abs(x.constant + E @ x.c.T)
    PE: Array = 0.5 * (s - x.length) ** 2 @ x.stiffness
    for spring in mechanism.joint_springs:
        PE = PE + 0.5 * spring.stiffness * (q[..., spring.joint] - spring.angle) ** 2
    return PE


def spring_forces(
    mechanism: Mechanism, E: Complex, rates: Array | None = None, elastic: bool = True
) -> Complex:
    """F of each spring between points on its first end, (..., p), N.

    Of the damper too where alphad is given as `rates`, and without `elastic` of that alone.
    """
    x = _springs(mechanism)
    d = x.constant + E @ x.c.T
    s = np.abs(d)
    lost = (s < COINCIDE) & x.directed
    if lost.any():
        raise no_direction(mechanism, int(np.argwhere(lost)[0][-1]))
    s = np.where(x.directed, s, 1.0)
    pull = elastic * x.stiffness * (1.0 - x.length / s)
    if rates is not None and x.damping.any():
        ddot = (1j * E * rates) @ x.c.T
        pull = pull + x.damping * ((d.conj() * ddot).real / s**2)
    F: Complex = -pull * d
    return F


def no_direction(mechanism: Mechanism, spring: int) -> SingularError:
    """The error of a spring between points whose ends coincide."""
    return SingularError(
        f"the ends of spring {spring + 1} between two points coincide",
        where=mechanism.source,
        limit="its force has no direction there; only length 0 without damping allows that",
    )


def load_force(load: Force, E: Complex) -> Complex:
    """The force of a load, (...), N, as Fx + i Fy."""
    return np.asarray(load.force * (E[..., load.link] if load.turns else np.ones(E.shape[:-1])))


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
        total[..., load.link] += load_force(load, E)
    return total


def _torques(c: Complex, E: Complex, F: Complex) -> Array:
    """Im(conj(c_k E_k) F) in absolute angles, (..., n), summed over the forces F (..., p)."""
    Q: Array = (E.conj() * (F @ c.conj())).imag
    return Q


@lru_cache(maxsize=64)
def _springs(mechanism: Mechanism) -> _Springs:
    springs = mechanism.springs
    return _Springs(
        constant=np.array([spring.between.constant for spring in springs], complex),
        c=coefficient_matrix([spring.between for spring in springs], mechanism.n),
        stiffness=np.array([spring.stiffness for spring in springs], float),
        length=np.array([spring.length for spring in springs], float),
        damping=np.array([spring.damping for spring in springs], float),
        directed=np.array([bool(x.stiffness * x.length or x.damping) for x in springs], bool),
    )
