"""Forward and inverse dynamics with friction by the forces in pins and slides.

Friction f (c,) is a load D^T f at the joints.  The forces N of the contacts depend on it:
accelerations, torques and multipliers are linear in a load, and N in these, so

    f = part |N0 + B f|

with N0 of the mechanism without this friction, and B from loads alone.  Fixed-point rounds from f =
part |N0| solve this to 1e-13 of f.  If they do not settle, friction is too large: it locks the
mechanism, or no motion or torque satisfies the equations.
"""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics import dense_dynamics
from robodyn.dynamics.cam_contacts import contacts_on_links
from robodyn.dynamics.dynamics import pins_at
from robodyn.dynamics.friction_formula import contacts_at
from robodyn.dynamics.pin_friction import Rubbing, rubbing_at
from robodyn.dynamics.reaction_forces import bodies_of, reactions, sides_of
from robodyn.dynamics.sticking import Smooth
from robodyn.engines import rounds
from robodyn.engines.formulas import MAX_GENERATED
from robodyn.errors import RobodynError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.parts import without_rubbing
from robodyn.mechanics.placed import absolute_rates, finite, matvec, placed
from robodyn.tables.arrays import Array, Complex


class NotSettledError(RobodynError):
    """Friction that depends on the forces in pins has no solution that rounds reach."""


class Friction(NamedTuple):
    """Accelerations or torques (T, n) and multipliers (T, r) with friction, and its load (T, n)."""

    joints: Array
    multipliers: Array
    load: Array


def by_rounds(
    mechanism: Mechanism, kind: str, states: dict[str, Array], times: Array, smooth: Smooth
) -> tuple[Array, Array, str]:
    """Return accelerations or torques of states (..., n), multipliers (..., r), and a remark.

    `smooth` solves for a mechanism without this friction.  Raises NotSettledError for the first
    state at which rounds do not settle.
    """
    for name, array in states.items():
        finite(name, array)
    plain, shape, n = without_rubbing(mechanism), states["q"].shape, mechanism.n
    flat = {name: array.reshape(-1, n) for name, array in states.items()}
    at = np.broadcast_to(times.ravel(), len(flat["q"])) if mechanism.timed else times
    joints, forces, remark = smooth(plain, kind, 2, flat, at)
    if dense_dynamics.DEPENDENT in remark:
        remark += "; friction by them is not either, nor the motion under it"
    found = settled(mechanism, kind, tuple(flat.values()), at, joints, forces)
    return found.joints.reshape(shape), found.multipliers.reshape(*shape[:-1], -1), remark


def settled(
    mechanism: Mechanism,
    kind: str,
    states: tuple[Array, ...],
    times: Array | float,
    joints: Array,
    multipliers: Array,
) -> Friction:
    """Add friction to a solution without it, for states q, qd and qdd or tau, (T, n) each.

    `joints` (T, n) are torques or accelerations, `multipliers` (T, r).
    """
    at, answer, lam, N, B = _system(mechanism, kind, states, times, joints, multipliers)
    f, left = rounds.by_rounds(at.part, N, B)
    if left.any():
        raise _not_settled(mechanism, at.part, B, states[0], int(np.argmax(left)))
    return Friction(
        joints + (f[..., None] * answer).sum(axis=-2),
        multipliers + (f[..., None] * lam).sum(axis=-2),
        (f[..., None] * at.D).sum(axis=-2),
    )


def forward_of_one(
    mechanism: Mechanism, q: Array, qd: Array, tau: Array, baumgarte: float, t: float
) -> Friction:
    """Return forward dynamics with friction of one state (n,); see `settled`."""
    plain, state, at = without_rubbing(mechanism), (q[None], qd[None], tau[None]), None
    if mechanism.n <= MAX_GENERATED:
        with suppress(ArithmeticError, ValueError):  # arrays say where a spring has no direction
            at = contacts_at(mechanism)(t, q, qd)
    if at is None:
        start = dense_dynamics.forward(plain, *state, baumgarte, t)
        found = settled(mechanism, "forward", state, t, start.qdd, start.multipliers)
        return Friction(*(x[0] for x in found))
    first, caused = dense_dynamics.forward_and_caused(plain, *state, at.D[None], baumgarte, t)
    n = mechanism.n
    N = at.N + at.slopes[:, :n] @ first.qdd[0] + at.slopes[:, n:] @ first.multipliers[0]
    qdd, lam = caused.qdd[0], caused.multipliers[0]
    B = qdd @ at.slopes[:, :n].T + lam @ at.slopes[:, n:].T + at.push
    f = rounds.of_one(at.part, N, B)
    if f is None:
        raise _not_settled(mechanism, at.part[None], B[None], q[None], 0)
    return Friction(first.qdd[0] + f @ qdd, first.multipliers[0] + f @ lam, f @ at.D)


def solvable(
    mechanism: Mechanism, q: Array, qd: Array, tau: Array, times: Array
) -> NDArray[np.bool_]:
    """Return which states (T, n) have accelerations under torques tau with friction, (T,)."""
    plain = without_rubbing(mechanism)
    first = dense_dynamics.forward(plain, q, qd, tau, t=times)
    at, _, _, N, B = _system(
        mechanism, "forward", (q, qd, tau), times, first.qdd, first.multipliers
    )
    return ~rounds.by_rounds(at.part, N, B)[1]


def _system(
    mechanism: Mechanism,
    kind: str,
    states: tuple[Array, ...],
    times: Array | float,
    joints: Array,
    multipliers: Array,
) -> tuple[Rubbing, Array, Array, Complex, Complex]:
    """Return the contacts, the effects of a unit of friction on joints and multipliers, N and B."""
    plain, (q, qd, third) = without_rubbing(mechanism), states
    at = rubbing_at(mechanism, q, qd)
    if kind == "inverse":
        by_torque = dense_dynamics.balanced(
            plain, q[:, None], -at.D, np.broadcast_to(times, q.shape[:-1])[:, None]
        )
        answer, lam, moved = by_torque.tau, by_torque.multipliers, np.zeros_like(at.D)
        qdd = third
    else:
        caused = dense_dynamics.caused(plain, q, at.D, times)
        answer, lam = caused.qdd, caused.multipliers
        qdd, moved = joints, answer
    N = _first_forces(mechanism, at, q, qd, qdd, multipliers, times)
    return at, answer, lam, N, _responses(mechanism, at, q, moved, lam)


def load_of(
    mechanism: Mechanism, q: Array, qd: Array, qdd: Array, multipliers: Array, times: Array
) -> Array:
    """Return the load of friction at the joints (T, n) along a motion, from its contact forces."""
    at = rubbing_at(mechanism, q, qd)
    pins = pins_at(mechanism, multipliers, placed(mechanism, q).E)
    R = np.zeros((*pins.shape[:-1], mechanism.n), complex)
    if any(x.joint is not None for x in mechanism.rubbing):
        R = reactions(mechanism, q, qd, qdd, multipliers, times) @ np.array([1.0, 1j])
    f = at.part * np.abs(_felt(mechanism, at.along, R, pins))
    return np.asarray((f[..., None] * at.D).sum(axis=-2))


def _first_forces(
    mechanism: Mechanism,
    at: Rubbing,
    q: Array,
    qd: Array,
    qdd: Array,
    multipliers: Array,
    times: Array | float,
) -> Complex:
    """Return the forces (T, c) in the contacts without friction."""
    plain = without_rubbing(mechanism)
    pins = pins_at(plain, multipliers, placed(plain, q).E)
    R = np.zeros((*pins.shape[:-1], mechanism.n), complex)
    if any(x.joint is not None for x in mechanism.rubbing):
        R = reactions(plain, q, qd, qdd, multipliers, times) @ np.array([1.0, 1j])
    return _felt(mechanism, at.along, R, pins)


def _responses(mechanism: Mechanism, at: Rubbing, q: Array, qdd: Array, lam: Array) -> Complex:
    """Return the force in each contact (last axis) per unit of friction at each, (T, c, c).

    Accelerations qdd (T, c, n) and multipliers (T, c, r) are those that the units cause.
    """
    plain, here = without_rubbing(mechanism), q[:, None]
    place = placed(plain, here)
    pins = pins_at(plain, lam, place.E)
    R = np.zeros((*pins.shape[:-1], mechanism.n), complex)
    if any(x.joint is not None for x in mechanism.rubbing):
        bodies, sides = bodies_of(plain), sides_of(plain)
        bent = place.accelerations(plain, np.zeros_like(qdd), absolute_rates(plain, qdd, "qdd"))
        R = matvec(bodies.below.T, bodies.points.moved(bent) * bodies.mass)
        pushed = pins.copy()
        for i, contact in enumerate(mechanism.rubbing):  # along its line each pushes its sides
            if contact.closure is not None and contact.radius is None:
                pushed[..., i, contact.closure] += at.along[..., i]
        R = R - matvec(sides.T, pushed)
        for cam, _, force, _ in contacts_on_links(plain, here, place, lam):
            apart = bodies.carried[cam.link] - bodies.carried[cam.driver]
            R = R - np.multiply.outer(force, apart)
    return _felt(mechanism, at.along[:, None], R, pins)


def _felt(mechanism: Mechanism, along: Complex, R: Complex, pins: Complex) -> Complex:
    """Return the force (..., c) in each contact, from those of joints (..., n) and closures."""
    found = []
    for i, contact in enumerate(mechanism.rubbing):
        if contact.closure is not None:
            found.append(pins[..., contact.closure])
        elif contact.radius is None:
            across = (along[..., i].conj() * R[..., contact.joint]).imag
            found.append(across.astype(complex))
        else:
            found.append(R[..., contact.joint])
    return np.stack(found, axis=-1)


def _not_settled(
    mechanism: Mechanism, part: Array, B: Complex, q: Array, state: int
) -> NotSettledError:
    """Return the error for a state; it names the friction with the largest own effect."""
    own = np.abs(part[state] * np.abs(np.diagonal(B[state])))
    friction = mechanism.rubbing[int(np.argmax(own))]
    at = ", ".join(f"{x:.6g}" for x in q[state])
    limit = f"friction has no solution that rounds come to, at q = {at}: it locks the mechanism"
    limit += " there, or is too large"
    place = f"{mechanism.rubbing_place(friction)}.coefficient"
    value = f"{friction.coefficient:g}"
    return NotSettledError(place, where=mechanism.source, value=value, limit=limit)
