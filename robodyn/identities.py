"""A self-test: the identities that every mechanism must keep, with their residuals.

Evaluated at random closed states with central differences of eighth order, which share nothing
with the closed form that they check.  Residuals are relative to the size of the terms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn import assembly, closed_form, dynamics, loop_rates
from robodyn.errors import SingularError
from robodyn.mechanism import Mechanism
from robodyn.scene import Description, JointSpring, Load, Moment, Point, Spring

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

BOUND = 1e-9  # differences of eighth order reach about 1e-12
STEP = 2e-2  # rad
ROUNDING = 1e-13  # gap of a closed state, relative; near a change point Newton's method ends above
# f'(0) h = sum_k w_k (f(k h) - f(-k h)) + O(h^9)
WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)

BALANCE = "M qdd + C qd + D qd + G = tau + Psi^T lambda"
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
    KE = closed_form.kinetic_energy(mechanism, q, qd)
    half = 0.5 * np.einsum("...i,...ij,...j->...", qd, M, qd)
    bodies = _kinetic_energy(mechanism.description, q, qd)
    C = closed_form.coriolis_matrix(mechanism, q, qd)
    Mdot = _along(lambda s: closed_form.mass_matrix(mechanism, q + s * qd), qd)
    skew = Mdot - 2 * C
    convective = np.einsum("...ij,...j->...i", C, qd)
    # C qd = Mdot qd - d(1/2 qd^T M qd)/dq holds for the right C alone
    slopes = [
        _along(partial(_shifted_energy, mechanism, q, qd, joint), _ones(q))
        for joint in np.eye(mechanism.n)
    ]
    christoffel = np.einsum("...ij,...j->...i", Mdot, qd) - np.stack(slopes, axis=-1)
    directions = np.random.default_rng(2).normal(size=q.shape)
    description = mechanism.description
    sharp = _sharpness(description, q)
    slope = _along(lambda s: _potential_energy(description, q + s * directions), directions * sharp)
    G = closed_form.gravity_vector(mechanism, q)
    PE = closed_form.potential_energy(mechanism, q)
    work = np.einsum("...i,...i->...", G, directions)
    heights = _potential_energy(description, q)
    return [
        Identity("KE = 1/2 qd^T M qd", max(_relative(KE - half, KE), _relative(KE - bodies, KE))),
        Identity(
            "Mdot - 2C skew-symmetric",
            _relative(skew + np.swapaxes(skew, -1, -2), _top(M) * _top(qd)),
        ),
        Identity(
            "C qd = Mdot qd - dKE/dq",
            _relative(convective - christoffel, _top(M) * _top(qd) ** 2),
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
    if not mechanism.has_forces:
        return []
    Q = closed_form.other_forces(mechanism, q, qd)
    power = np.einsum("...i,...i->...", Q, directions)
    bodies = _other_power(mechanism.description, q, qd, directions)
    return [Identity(FORCES, _relative(power - bodies, max(_top(Q), _top(power))))]


def _shifted_energy(mechanism: Mechanism, q: Array, qd: Array, joint: Array, s: Array) -> Array:
    return closed_form.kinetic_energy(mechanism, q + s * joint, qd)


def _closure_identities(mechanism: Mechanism, q: Array, qd: Array) -> list[Identity]:
    directions = np.random.default_rng(3).normal(size=q.shape)
    size = assembly.loop_size(mechanism)
    gap = closed_form.closure_gap(mechanism, q)
    arms = [row.arm for row in mechanism.rows if row.closure is None]
    opened = partial(_gap, mechanism.description, arms)
    bodies = opened(q)
    Psi = closed_form.closure_jacobian(mechanism, q)
    slope = _along(lambda s: opened(q + s * directions), directions)
    moved = np.einsum("...ij,...j->...i", Psi, directions)
    bias = closed_form.closure_bias(mechanism, q, qd)
    turned = _along(
        lambda s: np.einsum(
            "...ij,...j->...i", closed_form.closure_jacobian(mechanism, q + s * qd), qd
        ),
        qd,
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
    damping = _joint_damping(description)
    Q = closed_form.other_forces(mechanism, q, qd) if mechanism.has_forces else np.zeros(q.shape)
    terms = [
        np.einsum("...ij,...j->...i", closed_form.mass_matrix(mechanism, q), qdd),
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
        size = assembly.loop_size(mechanism) * (_top(qdd) + _top(qd) ** 2)
        found.append(Identity("Psi qdd + Psidot qd = 0", _relative(opening, size)))
    scale = max(map(_top, terms))
    found.insert(
        0,
        Identity(BALANCE, _relative(np.sum(terms, axis=0), scale)),
    )

    # a path with this q, qd, qdd: its energy grows by the power of torques less dampers
    def energy(s: Array) -> Array:
        path, rate = q + s * qd + 0.5 * s**2 * qdd, qd + s * qdd
        KE = closed_form.kinetic_energy(mechanism, path, rate)
        return KE + _potential_energy(description, path)

    sharp = _sharpness(description, q)
    growth = _along(energy, sharp * np.maximum(np.abs(qd), np.sqrt(np.abs(qdd))))
    power = np.einsum("...i,...i->...", tau + Q, qd) - (damping * qd**2).sum(axis=-1)
    return [*found, Identity(POWER, _relative(growth - power, scale * _top(qd)))]


# -- the bodies as the scene describes them ------------------------------------------------------


def _places(description: Description, q: Array) -> tuple[list[Complex], list[Complex]]:
    """Each link's joint and its direction, found by walking from the ground outward."""
    joints: dict[int, Complex] = {}
    directions: dict[int, Complex] = {}
    links = description.links
    while len(joints) < len(links):
        for k, link in enumerate(links):
            point = link.hangs_from
            if k in joints or (point.link is not None and point.link not in joints):
                continue
            turn = np.exp(1j * q[..., k])
            if point.link is None:
                joints[k], directions[k] = np.full(turn.shape, point.at), turn
            else:
                above = directions[point.link]
                joints[k] = joints[point.link] + point.at * above
                directions[k] = above * turn
    order = range(len(links))
    return [joints[k] for k in order], [directions[k] for k in order]


def _masses(description: Description, q: Array) -> list[tuple[float, Complex]]:
    """Every mass and where it is: centres of gravity and payloads."""
    joints, directions = _places(description, q)
    found: list[tuple[float, Complex]] = []
    for link, joint, direction in zip(description.links, joints, directions, strict=True):
        found += [(link.m, joint + link.r * direction), (link.payload, joint + link.l * direction)]
    return found


def _potential_energy(description: Description, q: Array) -> Array:
    """Of masses, springs, and constant forces and torques."""
    g = description.gravity.conjugate()
    PE = np.asarray(-sum(m * (g * place).real for m, place in _masses(description, q)))
    for load in description.loads:
        if isinstance(load, Moment):
            PE = PE - load.torque * _angle(description, q, load.link)
        elif not load.turns:
            PE = PE - (load.force.conjugate() * _place(description, q, load.point)).real
    for spring in description.springs:
        stretched = (
            q[..., spring.joint] - spring.angle
            if isinstance(spring, JointSpring)
            else _length(description, q, spring) - spring.length
        )
        PE = PE + 0.5 * spring.stiffness * stretched**2
    return PE


def _other_power(description: Description, q: Array, qd: Array, directions: Array) -> Array:
    """The power along `directions` of dampers of springs, forces that turn, and friction."""
    power = np.zeros(q.shape[:-1])
    sharp = _sharpness(description, q)
    for spring in description.springs:
        if isinstance(spring, Spring) and spring.damping:
            length = partial(_length, description, spring=spring)
            speed, way = (_rate(length, q, v, sharp) for v in (qd, directions))
            power = power - spring.damping * speed * way
    for load in description.loads:
        if isinstance(load, Load) and load.turns:
            way = _rate(partial(_place, description, point=load.point), q, directions, sharp)
            assert load.point.link is not None
            turn = np.exp(1j * _angle(description, q, load.point.link))
            power = power + ((load.force * turn).conjugate() * way).real
    for k, link in enumerate(description.links):
        if link.friction is not None:
            smooth = np.tanh(qd[..., k] / link.friction.speed)
            power = power - link.friction.torque * smooth * directions[..., k]
    return power


def _joint_damping(description: Description) -> Array:
    damping = np.array([link.damping for link in description.links])
    for spring in description.springs:
        if isinstance(spring, JointSpring):
            damping[spring.joint] += spring.damping
    return damping


def _angle(description: Description, q: Array, link: int) -> Array:
    """The link's angle from +X."""
    angle, above = np.zeros(q.shape[:-1]), link
    while True:
        angle = angle + q[..., above]
        further = description.links[above].hangs_from.link
        if further is None:
            return angle
        above = further


def _length(description: Description, q: Array, spring: Spring) -> Array:
    first, second = (_place(description, q, point) for point in (spring.first, spring.second))
    return np.asarray(np.abs(first - second))


def _kinetic_energy(description: Description, q: Array, qd: Array) -> Array:
    velocities = _along(
        lambda s: np.stack([z for _, z in _masses(description, q + s * qd)], axis=-1), qd
    )
    masses = np.array([m for m, _ in _masses(description, q[:1])])
    spin: dict[int, Array] = {}
    while len(spin) < len(description.links):
        for k, link in enumerate(description.links):
            above = link.hangs_from.link
            if k not in spin and (above is None or above in spin):
                spin[k] = qd[..., k] + (0.0 if above is None else spin[above])
    turning = sum(link.I * spin[k] ** 2 for k, link in enumerate(description.links))
    return np.asarray(0.5 * (np.abs(velocities) ** 2 @ masses + turning))


def _place(description: Description, q: Array, point: Point) -> Complex:
    if point.link is None:
        return np.full(q.shape[:-1], point.at)
    joints, directions = _places(description, q)
    return joints[point.link] + point.at * directions[point.link]


def _gap(description: Description, arms: list[float], q: Array) -> Array:
    rows: list[Array] = []
    for closure in description.closures:
        apart = _place(description, q, closure.first) - _place(description, q, closure.second)
        if closure.along is None:
            rows += [apart.real, apart.imag]
        else:
            rows.append((apart * closure.along.conjugate()).imag)
    for coupling, arm in zip(description.couplings, arms, strict=True):
        others = sum(ratio * q[..., k] for k, ratio in coupling.terms) + coupling.angle
        rows.append(arm * (q[..., coupling.joint] - others))
    return np.stack(rows, axis=-1)


# -- differences and sizes -----------------------------------------------------------------------


def _negative_part(M: Array) -> float:
    """How far M's eigenvalues reach below zero, its diagonal scaled to 1."""
    scale = np.sqrt(np.maximum(np.abs(np.diagonal(M, axis1=-2, axis2=-1)), 1e-300))
    least = np.linalg.eigvalsh(M / (scale[..., :, None] * scale[..., None, :]))[..., 0]
    return float(max(0.0, -least.min(initial=0.0)))


def _ones(q: Array) -> Array:
    return np.ones((*q.shape[:-1], 1))


def _along(function: Callable[[Array], Any], speed: Array) -> Any:
    """d function(s)/ds at s = 0 for each state; steps shrink with the largest speed."""
    step = STEP / np.maximum(np.abs(speed).max(axis=-1, keepdims=True), 1e-300)
    total: Any = 0.0
    for k, weight in enumerate(WEIGHTS, start=1):
        total = total + weight * (function(k * step) - function(-k * step))
    shaped = step.reshape(step.shape[:1] + (1,) * (np.ndim(total) - 1))
    return total / shaped


def _rate(function: Callable[[Array], Any], q: Array, speed: Array, sharp: Array) -> Any:
    """d function(q)/dt at the velocities `speed`."""
    return _along(lambda s: function(q + s * speed), speed * sharp)


def _sharpness(description: Description, q: Array) -> Array:
    """How much shorter steps must be where the ends of a spring are near, (T, 1)."""
    sharp = np.ones(len(q))
    reach = sum(link.l for link in description.links)
    for spring in description.springs:
        if isinstance(spring, Spring):
            length = _length(description, q, spring)
            sharp = np.maximum(sharp, 2.0 * reach / np.maximum(length, 1e-300))
    return sharp[:, None]


def _top(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0))


def _relative(residual: Array, size: Array | float) -> float:
    scale = float(np.max(np.abs(size), initial=0.0))
    worst = _top(residual)
    return worst / scale if scale > 0.0 else worst
