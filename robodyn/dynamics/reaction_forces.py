"""The force in every joint, and what a mechanism does to the ground that carries it.

Newton's equation of all bodies b that link k carries, itself and payloads included, has only one
unknown: the force R_k that acts on link k at its own joint, from the link (or the ground) that it
hangs from.  With the pin forces f_c on the side that closure c names first,

    R_k = sum_b m_b (a_b - gamma) - sum_c (+1 first side, -1 second side below k) f_c - F_k   (2)

F_k is what springs and loads put on all that link k carries.

The ground feels the momentum that changes and the weight, whichever way the forces take:

    F = sum_b m_b (gamma - a_b)      M = sum_b s_b x m_b (gamma - a_b) - sum_k I_k alphadd_k   (3)

and the loads besides.  A rotor that spins ever faster turns the link that carries it back, and so
the ground: - sum J (w_carrier + ratio qd)' is in M too.  Joint torques, dampers, pins and springs
between links are internal; those at the ground are in F and M.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.closed_form import Points, point_motion, points_of, scaled_jacobian
from robodyn.dynamics.dense_dynamics import RANK_CUT
from robodyn.dynamics.dynamics import coupling_torques, kept_moments, pin_forces
from robodyn.dynamics.placed import absolute_rates, as_states, frame_rates, placed
from robodyn.engines.row_values import rows_of
from robodyn.engines.singular_values import svd
from robodyn.errors import InputError
from robodyn.loops.closing import loop_size
from robodyn.mechanics import parts
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import Moment, Point

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FELT = 1e-9  # part of the largest force of a null vector that is more than rounding


class Bodies(NamedTuple):
    """The point masses (centres of gravity and payloads) of a mechanism: b of them, n links."""

    mass: Array  # (b,) kg
    points: Points
    below: Array  # (b, n), 1 where link k carries body b
    inertia: Array  # (n,) kg m^2


def reactions(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    multipliers: ArrayLike,
    t: ArrayLike = 0.0,
) -> Array:
    """The force on each link at its own joint, equation (2), (..., n, 2), N, ground axes.

    It comes from the link, or the ground, that the link hangs from.  q, qd, qdd (..., n) are a
    motion, rad and s, and multipliers (..., r) N those of `inverse_dynamics_and_forces` or
    `forward_dynamics_and_forces` for it, (..., 0) without closures.  Raises InputError for arrays
    that do not fit.
    """
    lam = np.asarray(multipliers, float)
    if lam.shape[-1:] != (len(mechanism.rows),):
        limit = f"must have {len(mechanism.rows)} values along the last axis, one a closure row"
        raise InputError("multipliers.shape", value=lam.shape, limit=limit)
    _, load = _motion(mechanism, q, qd, qdd)
    forces: Complex = -(load @ bodies_of(mechanism).below)
    if mechanism.springs or mechanism.forces:
        on_links = rows_of(parts.acting, mechanism).planar("on links", q, qd, t)
        forces = forces - on_links @ mechanism.arrays.carried
    if mechanism.description.closures:
        forces = forces - pin_forces(mechanism, lam, q) @ [1, 1j] @ _sides(mechanism)
    return np.stack([forces.real, forces.imag], axis=-1)


def slide_moments(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    multipliers: ArrayLike,
    t: ArrayLike = 0.0,
) -> Array:
    """The moment on each link that slides, about its origin, (..., slides), N m.

    It comes from what the link slides on, and keeps it from turning; arguments as of `reactions`.
    """
    lam = np.asarray(multipliers, float)
    place, load = _motion(mechanism, q, qd, qdd)
    bodies, at, carried = bodies_of(mechanism), placed(mechanism, q), mechanism.arrays.carried
    links = mechanism.description.links
    # forces and moments on what links carry, with their places
    forces: list[tuple[Complex, Complex, Array]] = [
        (place[..., b], load[..., b], bodies.below[b]) for b in range(len(bodies.mass))
    ]
    moments = -bodies.inertia * frame_rates(mechanism, absolute_rates(mechanism, qdd, "qdd"))
    for rotor, back in zip(mechanism.rotors, _spun(mechanism, qdd), strict=True):
        above = mechanism.parent[rotor.joint]
        if above is not None:
            moments[..., above] += back
    for entry in mechanism.description.loads:
        if isinstance(entry, Moment):
            moments[..., entry.link] += entry.torque
    if mechanism.varying_moments:
        values = rows_of(parts.loaded, mechanism)("moments", q, qd, t)
        for k, varying in enumerate(mechanism.varying_moments):
            moments[..., varying.link] += values[..., k]
    if mechanism.springs or mechanism.forces:
        acting = rows_of(parts.acting, mechanism).planar("forces", q, qd, t)
        for k, spring in enumerate(mechanism.springs):
            ends = zip(spring.ends, (spring.first, spring.second), (1.0, -1.0), strict=True)
            for point, link, sign in ends:
                if link is not None:
                    there = points_of(mechanism, [point]).place(at)[..., 0]
                    forces.append((there, sign * acting[..., k], carried[link]))
        for k, given in enumerate(mechanism.forces, start=len(mechanism.springs)):
            there = points_of(mechanism, [given.point]).place(at)[..., 0]
            forces.append((there, acting[..., k], carried[given.link]))
    kept = iter(np.moveaxis(kept_moments(mechanism, lam), -1, 0))
    pins: Complex = pin_forces(mechanism, lam, q) @ np.array([1, 1j])
    tree = Tree(links)
    for c, closure in enumerate(mechanism.description.closures):
        there = points_of(mechanism, [tree.point(closure.first)]).place(at)[..., 0]
        held = next(kept) if closure.aligned is not None else None
        for side, sign in ((closure.first, 1.0), (closure.second, -1.0)):
            if side.link is not None:
                forces.append((there, sign * pins[..., c], carried[side.link]))
                if held is not None:
                    moments[..., side.link] += sign * held
    found = []
    for k in mechanism.slides:
        origin = points_of(mechanism, [tree.point(Point(k, 0j))]).place(at)[..., 0]
        total = moments @ carried[:, k]
        for there, force, below in forces:
            total = total + below[k] * ((there - origin).conj() * force).imag
        found.append(-total)
    return np.stack(found, axis=-1) if found else np.zeros((*place.shape[:-1], 0))


def shaking_force(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, t: ArrayLike = 0.0
) -> Array:
    """What the mechanism does to the ground, equation (3), (..., 3): Fx, Fy N, M N m.

    M is about the origin, counter-clockwise.  All joints that hang from the ground, closures to
    ground points, sliders, springs to the ground, and torques and dampers of ground joints are in
    it.  q, qd, qdd (..., n) are a motion that obeys equation (1), rad and s, at times t.
    Raises InputError for arrays that do not fit.
    """
    place, load = _motion(mechanism, q, qd, qdd)
    force = load.sum(axis=-1)
    # those on links that cannot turn are no load of the mechanism's, but of the ground's
    torques = sum(x.torque for x in mechanism.description.loads if isinstance(x, Moment))
    moment = (place.conj() * load).imag.sum(axis=-1) + torques
    spinning = frame_rates(mechanism, absolute_rates(mechanism, qdd, "qdd"))
    moment = moment - spinning @ bodies_of(mechanism).inertia + sum(_spun(mechanism, qdd))
    if mechanism.varying_moments:
        moment = moment + rows_of(parts.loaded, mechanism)("moments", q, qd, t).sum(axis=-1)
    if mechanism.forces:
        F = rows_of(parts.loaded, mechanism).planar("forces", q, qd, t)
        arms = point_motion(mechanism, [x.point for x in mechanism.forces], q)[0] @ [1, 1j]
        force, moment = force + F.sum(axis=-1), moment + (arms.conj() * F).imag.sum(axis=-1)
    return np.stack([force.real, force.imag, moment], axis=-1)


def _spun(mechanism: Mechanism, qdd: ArrayLike) -> list[Array]:
    """The moment of each rotor's spin on what carries it, (...), N m."""
    arrays = mechanism.arrays
    spins = as_states(mechanism, "qdd", qdd) @ arrays.spins.T
    return list(np.moveaxis(-arrays.rotors * spins, -1, 0))


def dependent_rows(mechanism: Mechanism, q: ArrayLike) -> NDArray[np.int64]:
    """How many closure rows follow from the others at q (..., n): r less the rank of Psi, (...).

    Where it is not zero, the pin forces are not unique.
    """
    s = np.linalg.svd(scaled_jacobian(mechanism, q), compute_uv=False)
    rank = (s > RANK_CUT * loop_size(mechanism)).sum(axis=-1)
    return np.asarray(len(mechanism.rows) - rank)


def not_unique(mechanism: Mechanism, q: ArrayLike) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The closures and the links whose pin force and reaction are not unique at q (n,).

    lambda may change by any null vector of Psi^T, and equation (2) carries that change into the
    joints of the loops.  Both are empty where the closures are independent.
    """
    changes = pin_forces(mechanism, _free_multipliers(mechanism, q), q) @ [1, 1j]
    return _felt(changes, FELT), _felt(changes @ _sides(mechanism), FELT)


def dependent_couplings(mechanism: Mechanism, q: ArrayLike) -> tuple[int, ...]:
    """The couplings whose torque is not unique at q (n,)."""
    changes = coupling_torques(mechanism, _free_multipliers(mechanism, q))
    return _felt(changes, FELT * loop_size(mechanism))


def _free_multipliers(mechanism: Mechanism, q: ArrayLike) -> Array:
    """The null vectors of Psi^T at q (n,), (d, r)."""
    U, s, _ = svd(scaled_jacobian(mechanism, q), full=True)
    return U[:, int((s > RANK_CUT * loop_size(mechanism)).sum()) :].T


def _felt(changes: NDArray[np.inexact], least: float) -> tuple[int, ...]:
    return tuple(np.flatnonzero((np.abs(changes) > least).any(axis=0)).tolist())


def _motion(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
) -> tuple[Complex, Complex]:
    """Where the bodies are, (..., b) m, and the load m (gamma - a) of each, (..., b) N."""
    bodies, at = bodies_of(mechanism), placed(mechanism, q)
    rates, accelerations = (
        absolute_rates(mechanism, qd),
        absolute_rates(mechanism, qdd, "qdd"),
    )
    a = bodies.points.moved(at.accelerations(mechanism, rates, accelerations))
    return bodies.points.place(at), bodies.mass * (mechanism.gamma - a)


@lru_cache(maxsize=64)
def bodies_of(mechanism: Mechanism) -> Bodies:
    """The bodies of a mechanism, at points summed from the ground."""
    links = mechanism.description.links
    own = [(k, link.m, mechanism.centres[k]) for k, link in enumerate(links) if link.m]
    own += [(k, link.payload, mechanism.tips[k]) for k, link in enumerate(links) if link.payload]
    return Bodies(
        mass=np.array([mass for _, mass, _ in own], float),
        points=points_of(mechanism, [point for _, _, point in own]),
        below=mechanism.arrays.carried[[k for k, _, _ in own]],
        inertia=np.array([link.I for link in links], float),
    )


def _sides(mechanism: Mechanism) -> Array:
    """+1 and -1 where link k carries the first and the second side of a closure, (closures, n)."""
    sides = np.zeros((len(mechanism.description.closures), mechanism.n))
    for row, closure in zip(sides, mechanism.description.closures, strict=True):
        for side, sign in ((closure.first, 1.0), (closure.second, -1.0)):
            if side.link is not None:
                row += sign * mechanism.arrays.carried[side.link]
    return sides
