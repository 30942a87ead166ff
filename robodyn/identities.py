"""A self-test: the identities that every mechanism must keep, with their residuals.

Evaluated at random closed states with central differences of eighth order, which share nothing
with the closed form that they check.  Residuals are relative to the size of the terms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robodyn import assembly, closed_form, dynamics, loop_rates
from robodyn.errors import RobodynError
from robodyn.mechanism import Mechanism

Array = NDArray[np.float64]

BOUND = 1e-9  # differences of eighth order reach about 1e-12
STEP = 2e-2  # rad
# f'(0) h = sum_k w_k (f(k h) - f(-k h)) + O(h^9)
WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)


@dataclass(frozen=True, slots=True)
class Identity:
    """One identity and the largest relative residual over the sampled states."""

    name: str
    residual: float

    @property
    def holds(self) -> bool:
        return self.residual <= BOUND


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
        closes = np.flatnonzero(missing <= assembly.CLOSED * assembly.loop_size(mechanism))
    else:
        q, missing = assembly.attempt(mechanism, rng.uniform(-np.pi, np.pi, (4 * count, driven)))
        closes = np.flatnonzero(missing <= 0.0)
    keep: list[int] = []
    for k in closes:
        if len(keep) < count and not loop_rates.singular_kind(mechanism, q[k]):
            keep.append(int(k))
    closed = q[keep]
    qd = loop_rates.nearest_velocities(mechanism, closed, rng.normal(size=closed.shape))
    return Sample(closed, qd, len(closes) / len(q))


def identities(mechanism: Mechanism, sample: Sample) -> list[Identity]:
    """Every identity at the sampled states."""
    q, qd = sample.q, sample.qd
    rng = np.random.default_rng(2)
    n = mechanism.n
    M = closed_form.mass_matrix(mechanism, q)
    C = closed_form.coriolis_matrix(mechanism, q, qd)
    G = closed_form.gravity_vector(mechanism, q)
    KE = closed_form.kinetic_energy(mechanism, q, qd)
    found = [Identity("M = M^T", _relative(M - np.swapaxes(M, -1, -2), M))]

    half = 0.5 * np.einsum("...i,...ij,...j->...", qd, M, qd)
    found.append(Identity("KE = 1/2 qd^T M qd", _relative(KE - half, KE)))

    Mdot = _along(lambda s: closed_form.mass_matrix(mechanism, q + s * qd), qd)
    skew = Mdot - 2 * C
    residual = _relative(skew + np.swapaxes(skew, -1, -2), _top(M) * _top(qd))
    found.append(Identity("Mdot - 2C skew-symmetric", residual))

    directions = rng.normal(size=q.shape)
    slope = _along(
        lambda s: closed_form.potential_energy(mechanism, q + s * directions), directions
    )
    work = np.einsum("...i,...i->...", G, directions)
    found.append(Identity("G = dPE/dq", _relative(slope - work, np.abs(G).max(initial=0.0))))

    if mechanism.rows:
        Psi = closed_form.closure_jacobian(mechanism, q)
        size = assembly.loop_size(mechanism)
        gap = closed_form.closure_gap(mechanism, q)
        slope = _along(lambda s: closed_form.closure_gap(mechanism, q + s * directions), directions)
        moved = np.einsum("...ij,...j->...i", Psi, directions)
        bias = closed_form.closure_bias(mechanism, q, qd)
        turned = _along(
            lambda s: np.einsum(
                "...ij,...j->...i", closed_form.closure_jacobian(mechanism, q + s * qd), qd
            ),
            qd,
        )
        found += [
            Identity("gap = 0", _relative(gap, size)),
            Identity("Psi = dgap/dq", _relative(slope - moved, size)),
            Identity(
                "Psi qd = 0", _relative(np.einsum("...ij,...j->...i", Psi, qd), size * _top(qd))
            ),
            Identity("Psidot qd", _relative(turned - bias, size * _top(qd) ** 2)),
        ]

    driven = list(mechanism.actuated)
    tau = np.zeros((len(q), n))
    tau[:, driven] = rng.normal(size=(len(q), len(driven))) * (np.abs(G).max(initial=0.0) + 1.0)
    try:
        motion = dynamics.forward_dynamics_and_forces(mechanism, q, qd, tau)
        back = dynamics.required_load(mechanism, q, qd, motion.qdd)
    except RobodynError:
        return [*found, Identity("forward dynamics", np.inf)]
    balance = back - tau
    if mechanism.rows:
        forces = np.einsum("...ji,...j->...i", Psi, motion.multipliers)
        balance = balance - forces
        size_of_forces = np.abs(forces).max(initial=0.0)
    else:
        size_of_forces = 0.0
    scale = max(_top(back), _top(tau), float(size_of_forces))
    found.append(
        Identity("M qdd + C qd + D qd + G = tau + Psi^T lambda", _relative(balance, scale))
    )

    # a path with this q, qd, qdd: its energy grows by the power of torques less dampers
    def energy(s: Array) -> Array:
        path = q + s * qd + 0.5 * s**2 * motion.qdd
        return closed_form.kinetic_energy(
            mechanism, path, qd + s * motion.qdd
        ) + closed_form.potential_energy(mechanism, path)

    growth = _along(energy, np.maximum(np.abs(qd), np.sqrt(np.abs(motion.qdd))))
    dissipated = np.asarray(mechanism.arrays.damping) * qd**2
    power = np.einsum("...i,...i->...", tau, qd) - dissipated.sum(axis=-1)
    found.append(Identity("power in = dE/dt", _relative(growth - power, scale * _top(qd))))
    return found


def _along(function: Callable[[Array], Array], speed: Array) -> Array:
    """d function(s)/ds at s = 0 for each state; steps shrink with the largest speed."""
    step = STEP / np.maximum(np.abs(speed).max(axis=-1, keepdims=True), 1e-300)
    total: Array | float = 0.0
    for k, weight in enumerate(WEIGHTS, start=1):
        total = total + weight * (function(k * step) - function(-k * step))
    shaped = step.reshape(step.shape[:1] + (1,) * (np.ndim(total) - 1))
    result: Array = total / shaped
    return result


def _top(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0))


def _relative(residual: Array, size: Array | float) -> float:
    scale = float(np.max(np.abs(size), initial=0.0))
    worst = _top(residual)
    return worst / scale if scale > 0.0 else worst
