"""A self-test: the identities that every mechanism must keep, with their residuals.

Evaluated at random closed states with central differences of eighth order, which share nothing
with the closed form that they check.  Residuals are relative to the size of the terms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics import closed_form, dynamics
from robodyn.dynamics.differences import along
from robodyn.errors import SingularError
from robodyn.loops import assembly, loop_rates
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene_bodies import (
    gap as gap_of_bodies,
)
from robodyn.scene.scene_bodies import (
    joint_damping,
    other_power,
    potential_energy,
    sharpness,
    spins,
)
from robodyn.scene.scene_bodies import (
    kinetic_energy as kinetic_energy_of_bodies,
)

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

BOUND = 1e-9  # differences of eighth order reach about 1e-12
ROUNDING = 1e-13  # gap of a closed state, relative; near a change point Newton's method ends above

STILL = 1e-9  # rad/s, of rates drawn near 1: below it they are rounding
BALANCE = "M qdd + C qd + D qd + G = tau + Q + Psi^T lambda"
FORCES = "Q qd = power of its forces"
POWER = "power in = dE/dt"


@dataclass(frozen=True, slots=True)
class Identity:
    """One identity and the largest relative residual over the sampled states.

    Where it cannot be evaluated the residual is None, and `reason` says why.
    """

    name: str
    residual: float | None
    reason: str = ""

    @property
    def holds(self) -> bool:
        return self.residual is not None and self.residual <= BOUND


@dataclass(frozen=True, slots=True)
class Sample:
    """Random states (T, n) that keep the closures, away from singular configurations."""

    q: Array
    qd: Array
    closing: float  # the part of the drawn positions at which the loops close


def sample_states(mechanism: Mechanism, count: int, seed: int = 1) -> Sample:
    """Up to `count` closed states with random actuated angles and rates.

    Raises InputError where the mechanism cannot be assembled from its actuated joints.
    """
    rng = np.random.default_rng(seed)
    driven = len(mechanism.actuated)
    if not mechanism.rows:
        q, qd = (
            rng.uniform(-np.pi, np.pi, (count, mechanism.n)),
            rng.normal(size=(count, mechanism.n)),
        )
        return Sample(q, qd, 1.0)
    if driven > mechanism.n - len(mechanism.rows):  # their angles depend on one another
        q = assembly.close_positions(
            mechanism, rng.uniform(-np.pi, np.pi, (4 * count, mechanism.n))
        )
        missing = np.abs(closed_form.closure_gap(mechanism, q)).max(axis=-1)
        closes = np.flatnonzero(missing <= ROUNDING * assembly.loop_size(mechanism))
    else:
        q, missing = assembly.attempt(mechanism, rng.uniform(-np.pi, np.pi, (4 * count, driven)))
        closes = np.flatnonzero(missing <= 0.0)
    keep: list[int] = []
    for k in closes:
        if len(keep) < count and not loop_rates.singular_kind(mechanism, q[k]):
            keep.append(int(k))
    closed = q[keep]
    qd = loop_rates.nearest_velocities(mechanism, closed, rng.normal(size=closed.shape))
    qd[np.abs(qd).max(axis=-1, initial=0.0) < STILL] = 0.0  # what cannot move
    return Sample(closed, qd, len(closes) / len(q))


def identities(mechanism: Mechanism, sample: Sample) -> list[Identity]:
    """Every identity at the sampled states.

    Energies, gaps and dampers are those of the bodies as the scene describes them, found link by
    link: a wrong constant of the numeric model shows.
    """
    q, qd = sample.q, sample.qd
    M = closed_form.mass_matrix(mechanism, q)
    found = [
        Identity("M = M^T", _relative(M - np.swapaxes(M, -1, -2), M)),
        Identity("M positive (least eigenvalue >= 0)", _negative_part(M)),
    ]
    found += _energy_identities(mechanism, q, qd, M)
    if mechanism.rows:
        found += _closure_identities(mechanism, q, qd)
    return found + _motion_identities(mechanism, q, qd)


def _energy_identities(mechanism: Mechanism, q: Array, qd: Array, M: Array) -> list[Identity]:
    description = mechanism.description
    turning = spins(description, qd)
    KE = closed_form.kinetic_energy(mechanism, q, qd)
    half = 0.5 * _form(qd, M, qd)
    bodies = kinetic_energy_of_bodies(description, q, qd)
    C = closed_form.coriolis_matrix(mechanism, q, qd)
    Mdot = along(lambda s: closed_form.mass_matrix(mechanism, q + s * qd), turning)
    skew = Mdot - 2 * C
    directions = np.random.default_rng(2).normal(size=q.shape)
    ways = spins(description, directions)
    # C qd = Mdot qd - d(1/2 qd^T M qd)/dq holds for the right C alone
    convective = _form(directions, C, qd)
    shown = _form(directions, Mdot, qd)
    bend = along(lambda s: closed_form.kinetic_energy(mechanism, q + s * directions, qd), ways)
    sharp = sharpness(description, q)
    slope = along(lambda s: potential_energy(description, q + s * directions), ways * sharp)
    G = closed_form.gravity_vector(mechanism, q)
    PE = closed_form.potential_energy(mechanism, q)
    work = np.einsum("...i,...i->...", G, directions)
    heights = potential_energy(description, q)
    return [
        Identity("KE = 1/2 qd^T M qd", max(_relative(KE - half, KE), _relative(KE - bodies, KE))),
        Identity(
            "Mdot - 2C skew-symmetric",
            _relative(skew + np.swapaxes(skew, -1, -2), _top(M) * _top(qd)),
        ),
        Identity(
            "C qd = Mdot qd - dKE/dq",
            _relative(convective - (shown - bend), max(_top(M) * _top(qd) ** 2, _top(bend))),
        ),
        Identity("PE = sum of m g h", _relative(PE - heights, heights)),
        Identity(
            "G = dPE/dq", _relative(slope - work, max(_top(slope), _largest_term(mechanism, G)))
        ),
        *_force_identities(mechanism, q, qd, directions),
    ]


def _largest_term(mechanism: Mechanism, G: Array) -> float:
    """Of G, in which weights and springs may balance."""
    return max(_top(G), max(map(abs, mechanism.weights)))


def _force_identities(
    mechanism: Mechanism, q: Array, qd: Array, directions: Array
) -> list[Identity]:
    """The power of what has no potential, along any velocities, of a scene that names such."""
    if not mechanism.has_state_forces:
        return []
    Q = closed_form.other_forces(mechanism, q, qd)
    power = np.einsum("...i,...i->...", Q, directions)
    bodies = other_power(mechanism.description, q, qd, directions)
    return [Identity(FORCES, _relative(power - bodies, max(_top(Q), _top(power))))]


def _closure_identities(mechanism: Mechanism, q: Array, qd: Array) -> list[Identity]:
    directions = np.random.default_rng(3).normal(size=q.shape)
    size = assembly.loop_size(mechanism)
    gap = closed_form.closure_gap(mechanism, q)
    arms = [row.arm for row in mechanism.rows if row.closure is None]
    opened = partial(gap_of_bodies, mechanism.description, arms)
    bodies = opened(q)
    Psi = closed_form.closure_jacobian(mechanism, q)
    slope = along(lambda s: opened(q + s * directions), spins(mechanism.description, directions))
    moved = np.einsum("...ij,...j->...i", Psi, directions)
    bias = closed_form.closure_bias(mechanism, q, qd)
    turned = along(
        lambda s: np.einsum(
            "...ij,...j->...i", closed_form.closure_jacobian(mechanism, q + s * qd), qd
        ),
        spins(mechanism.description, qd),
    )
    speed = np.einsum("...ij,...j->...i", Psi, qd)
    return [
        Identity("gap = 0", max(_relative(gap, size), _relative(bodies, size))),
        Identity("Psi = dgap/dq", _relative(slope - moved, size)),
        Identity("Psi qd = 0", _relative(speed, size * _top(qd))),
        Identity("Psidot qd", _relative(turned - bias, size * _top(qd) ** 2)),
    ]


def _motion_identities(mechanism: Mechanism, q: Array, qd: Array) -> list[Identity]:
    """Forward dynamics against inverse dynamics, and power against the growth of energy."""
    description = mechanism.description
    driven = list(mechanism.actuated)
    rng = np.random.default_rng(4)
    G = closed_form.gravity_vector(mechanism, q)
    tau = np.zeros(q.shape)
    tau[:, driven] = rng.normal(size=(len(q), len(driven))) * (_top(G) + 1.0)
    try:
        motion = dynamics.forward_dynamics_and_forces(mechanism, q, qd, tau)
    except SingularError as error:
        return [Identity(name, None, str(error)) for name in (BALANCE, POWER)]
    qdd = motion.qdd
    damping = joint_damping(description)
    Q = (
        closed_form.other_forces(mechanism, q, qd)
        if mechanism.has_state_forces
        else np.zeros(q.shape)
    )
    M = closed_form.mass_matrix(mechanism, q)
    terms = [
        np.einsum("...ij,...j->...i", M, qdd),
        np.einsum("...ij,...j->...i", closed_form.coriolis_matrix(mechanism, q, qd), qd),
        damping * qd,
        G,
        -tau,
        -Q,
    ]
    found = []
    if mechanism.rows:
        Psi = closed_form.closure_jacobian(mechanism, q)
        terms.append(-np.einsum("...ji,...j->...i", Psi, motion.multipliers))
        opening = np.einsum("...ij,...j->...i", Psi, qdd)
        opening = opening + closed_form.closure_bias(mechanism, q, qd)
        free = max(map(_top, terms)) / _top(M)  # an acceleration that nothing holds
        size = assembly.loop_size(mechanism) * (max(_top(qdd), free) + _top(qd) ** 2)
        found.append(Identity("Psi qdd + Psidot qd = 0", _relative(opening, size)))
    # the parts of M qdd are what rounds: in a long chain they are far larger than their sum
    scale = max(*map(_top, terms), _top((np.abs(M) @ np.abs(qdd)[..., None])[..., 0]))
    found.insert(0, Identity(BALANCE, _relative(np.sum(terms, axis=0), scale)))

    # a path with this q, qd, qdd: its energy grows by the power of torques less dampers
    def energy(s: Array) -> Array:
        path, rate = q + s * qd + 0.5 * s**2 * qdd, qd + s * qdd
        KE = closed_form.kinetic_energy(mechanism, path, rate)
        return KE + potential_energy(description, path)

    sharp = sharpness(description, q)
    turning, bending = spins(description, qd), spins(description, qdd)
    speed = sharp * np.maximum(np.abs(turning), np.sqrt(np.abs(bending)))
    growth = along(energy, speed)
    power = np.einsum("...i,...i->...", tau + Q, qd) - (damping * qd**2).sum(axis=-1)
    rounding = 1e-3 * _top(energy(np.zeros((len(q), 1)))) * _top(speed)  # of such a difference
    size = max(scale * _top(qd), rounding)
    return [*found, Identity(POWER, _relative(growth - power, size))]


def _negative_part(M: Array) -> float:
    """How far M's eigenvalues reach below zero, its diagonal scaled to 1."""
    scale = np.sqrt(np.maximum(np.abs(np.diagonal(M, axis1=-2, axis2=-1)), 1e-300))
    least = np.linalg.eigvalsh(M / (scale[..., :, None] * scale[..., None, :]))[..., 0]
    return float(max(0.0, -least.min(initial=0.0)))


def _form(left: Array, matrix: Array, right: Array) -> Array:
    """left^T matrix right, (...)."""
    form: Array = ((matrix @ right[..., None])[..., 0] * left).sum(axis=-1)
    return form


def _top(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0))


def _relative(residual: Array, size: Array | float) -> float:
    scale = float(np.max(np.abs(size), initial=0.0))
    worst = _top(residual)
    return worst / scale if scale > 0.0 else worst
