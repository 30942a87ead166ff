"""A self-test: identities that every mechanism must satisfy, with their residuals.

They are evaluated at random closed states with central differences of eighth order, which share
nothing with the closed form under test.  The potential energy's rate is a tangent of its rows.
Residuals are relative to the size of the terms.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics import closed_form, dynamics
from robodyn.dynamics.friction_rounds import load_of, solvable
from robodyn.dynamics.reaction_forces import bodies_of
from robodyn.elements.contacts import Mode
from robodyn.engines.row_values import RowValues, rows_of
from robodyn.errors import InputError, SingularError
from robodyn.loops import assembly, closures, loop_rates
from robodyn.loops.assembly_plan import assembly_plan, with_independent
from robodyn.loops.closing import SAMPLED, random_states
from robodyn.mechanics import parts
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.mechanics.modes import in_mode, moving_mode
from robodyn.mechanics.parts import without_rubbing
from robodyn.mechanics.placed import absolute_rates, frame_rates, matvec, placed
from robodyn.tables.arrays import Array

BOUND = 1e-9  # differences of eighth order reach about 1e-12
ROUNDING = 1e-13  # gap of a closed state, relative; near a change point Newton's method ends above

# of closing a state from random angles, in entries of Psi times its rank
SEARCH, MOST_WORK = 2_000_000, 4_000_000
STILL = 1e-9  # rad/s, of rates drawn near 1: below it they are rounding
STEP = 3e-2  # rad, of the fastest link
FINER = (1.0, 0.1, 0.01, 0.001)  # parts of it that are tried where couplings have laws
# f'(0) h = sum_k w_k (f(k h) - f(-k h)) + O(h^9)
WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
BALANCE = "M qdd + C qd + D qd + G = tau + Q + Psi^T lambda"
FORCES = "Q qd = power of its forces"
POWER = "power in = dE/dt"


@dataclass(frozen=True, slots=True)
class Identity:
    """An identity and its largest relative residual over the sampled states.

    If it cannot be evaluated, the residual is None and `reason` says why.
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
    t: Array  # times (T,) of laws and loads


def sample_states(
    mechanism: Mechanism,
    count: int,
    watch: Callable[[float], object] | None = None,
    seed: int = 1,
) -> Sample:
    """Return up to `count` closed states with random rates.

    The actuated joints and those that no loop or coupling determines are drawn at random, and the
    others assembled.  If these do not determine the others, all joints are drawn and Newton's
    method closes the loops.  Raises InputError if that takes too long.  `watch` is called with the
    finished part of paths to closed states.
    """
    rng, n = np.random.default_rng(seed), mechanism.n
    independent = with_independent(mechanism)
    if not mechanism.rows:
        q = random_states(mechanism, rng, count)
        q = q[within_tables(mechanism, q)]
        return Sample(q, rng.normal(size=(len(q), n)), 1.0, np.zeros(len(q)))
    if _follows(independent):
        drawn = random_states(mechanism, rng, 4 * count, independent.actuated)
        t = _times(mechanism, rng, len(drawn))
        q, missing = assembly.attempt(independent, drawn, watch=watch, t=t)
        closes = np.flatnonzero(missing <= 0.0)
    else:
        work = n * len(mechanism.rows) * min(n, len(mechanism.rows))
        if work > MOST_WORK:
            limit = f"closing {len(mechanism.rows)} equations of closures from random angles takes "
            limit += f"too long, and {len(independent.actuated)} independent joints do not tell "
            limit += "the others: change `actuated`, or add a `start`"
            raise InputError("actuated", where=mechanism.source, limit=limit)
        tries = max(2, min(4 * count, SEARCH // work))
        drawn = random_states(mechanism, rng, tries)
        t = _times(mechanism, rng, tries)
        q = assembly.close_positions(mechanism, drawn, t=t)
        missing = np.abs(closures.closure_gap(mechanism, q, t)).max(axis=-1)
        closes = np.flatnonzero(missing <= ROUNDING * assembly.loop_size(mechanism))
    keep: list[int] = []
    for k in closes:
        if len(keep) < count and not loop_rates.singular_kind(mechanism, q[k], float(t[k])):
            keep.append(int(k))
    closed, t = q[keep], t[keep]
    inside = within_tables(mechanism, closed)
    closed, t = closed[inside], t[inside]
    qd = loop_rates.nearest_velocities(mechanism, closed, rng.normal(size=closed.shape), t)
    qd[np.abs(qd).max(axis=-1, initial=0.0) < STILL] = 0.0  # what cannot move
    return Sample(closed, qd, len(closes) / len(q), t)


def _times(mechanism: Mechanism, rng: np.random.Generator, count: int) -> Array:
    """Return times (count,) at which laws of time are evaluated; 0 if there is none."""
    if not mechanism.driven:
        return np.zeros(count)
    drawn: Array = rng.uniform(0.0, SAMPLED, count)
    return drawn


def _follows(mechanism: Mechanism) -> bool:
    """Return whether the joints can be assembled from any positions of the actuated ones."""
    if len(mechanism.actuated) > mechanism.n - len(mechanism.rows):
        return False  # their angles depend on one another
    with suppress(InputError):
        return bool(assembly_plan(mechanism))
    return False


def identities(mechanism: Mechanism, sample: Sample) -> list[Identity]:
    """Return every identity at the sampled states; only those of closures without masses.

    The closed forms are compared with a program of rows built anew from the scene, so a wrong
    constant of the numeric model shows.  States with different contact modes are compared each in
    its own mode, and the worst residual is returned.
    """
    if not mechanism.switches:
        return _of_one_mode(mechanism, sample)
    modes: dict[Mode, list[int]] = {}
    for k, (q, qd) in enumerate(zip(sample.q.tolist(), sample.qd.tolist(), strict=True)):
        mode = moving_mode(mechanism, q, qd, [0.0] * mechanism.n)
        modes.setdefault(mode, []).append(k)
    found: dict[str, Identity] = {}
    for mode, which in (modes or {Mode(): []}).items():
        part = replace(sample, q=sample.q[which], qd=sample.qd[which], t=sample.t[which])
        for each in _of_one_mode(in_mode(mechanism, mode), part):
            found[each.name] = _worse(found.get(each.name), each)
    return list(found.values())


def _worse(one: Identity | None, other: Identity) -> Identity:
    if one is None or other.residual is None:
        return other
    return one if one.residual is None or one.residual >= other.residual else other


def _of_one_mode(mechanism: Mechanism, sample: Sample) -> list[Identity]:
    rubbed, mechanism = mechanism, without_rubbing(mechanism)  # which no row has
    q, qd, t, scene = sample.q, sample.qd, sample.t, without_rubbing(build(mechanism.description))
    scene = replace(scene, elements=(*scene.elements, *mechanism.added))
    if mechanism.mode is not None:
        scene = in_mode(scene, mechanism.mode)
    rows = RowValues(replace(scene, A=()))  # which none reads, and which is large
    if mechanism.massless:
        return _closure_identities(mechanism, rows, q, qd, t) if mechanism.rows else []
    M, C = closed_form.mass_matrix(mechanism, q), closed_form.coriolis_matrix(mechanism, q, qd)
    found = [
        Identity("M = M^T", _relative(M - np.swapaxes(M, -1, -2), M)),
        Identity("M positive (least eigenvalue >= 0)", _below_zero(M)),
    ]
    found += _energy_identities(mechanism, rows, q, qd, M, C)
    if mechanism.rows:
        found += _closure_identities(mechanism, rows, q, qd, t)
    return found + _motion_identities(rubbed, rows, q, qd, t, M, C)


def _below_zero(M: Array) -> float:
    """Return how far the least eigenvalue of M (T, n, n), scaled to unit diagonal, is negative."""
    scale = np.sqrt(np.maximum(np.abs(np.diagonal(M, axis1=-2, axis2=-1)), 1e-300))
    scaled = M / (scale[..., :, None] * scale[..., None, :])
    try:  # which only positive ones have, and sooner than eigenvalues
        np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError:
        return float(max(0.0, -np.linalg.eigvalsh(scaled)[..., 0].min(initial=0.0)))
    return 0.0


def condition_numbers(M: Array) -> Array:
    """Return condition numbers (T,) of positive semidefinite M (T, n, n).

    Infinite if singular.  Large matrices use Lanczos's method on M and its inverse, accurate to
    about 3 digits.
    """
    if M.shape[-1] >= closed_form.LONG:
        with suppress(np.linalg.LinAlgError):
            return np.array([_span_by_iterations(each) for each in M])
    sizes = np.abs(np.linalg.eigvalsh(M))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(sizes.max(axis=-1) / sizes.min(axis=-1))


def _span_by_iterations(M: Array) -> float:
    from scipy.linalg import cho_solve
    from scipy.sparse.linalg import LinearOperator, eigsh

    factor, begin = np.linalg.cholesky(M).T, np.ones(len(M))  # turned, as LAPACK stores matrices
    inverse = LinearOperator(M.shape, lambda b: cho_solve((factor, False), b), dtype=float)
    ends = [eigsh(A, 1, v0=begin, tol=1e-4, return_eigenvectors=False) for A in (M, inverse)]
    return float(ends[0][0] * ends[1][0])


def _energy_identities(
    mechanism: Mechanism, rows: RowValues, q: Array, qd: Array, M: Array, C: Array
) -> list[Identity]:
    KE = closed_form.kinetic_energy(mechanism, q, qd)
    half = 0.5 * _dot(qd, matvec(M, qd))
    bodies = _kinetic_energy(rows.mechanism, q, qd)
    turning = absolute_rates(mechanism, qd)
    Mdot = along(lambda s: closed_form.mass_matrix(mechanism, q + s * qd), turning)
    skew = Mdot - 2 * C
    directions = np.random.default_rng(2).normal(size=q.shape)
    ways = absolute_rates(mechanism, directions)
    # C qd = Mdot qd - d(1/2 qd^T M qd)/dq holds for the right C alone
    convective = _dot(directions, matvec(C, qd))
    shown = _dot(directions, matvec(Mdot, qd))
    bend = along(lambda s: closed_form.kinetic_energy(mechanism, q + s * directions, qd), ways)
    heights = rows("PE", q)[..., 0]
    slope = rows("PE rate", q, directions)[..., 0]
    G = closed_form.gravity_vector(mechanism, q)
    largest = max(_top(slope), _top(G), *map(abs, mechanism.weights))  # G's terms may balance
    PE = closed_form.potential_energy(mechanism, q)
    found = [
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
        Identity("G = dPE/dq", _relative(slope - _dot(G, directions), largest)),
    ]
    if rows.mechanism.has_state_forces:  # of what has no potential, at any velocities
        Q = closed_form.other_forces(mechanism, q, directions)
        power = _dot(Q, directions)
        dampers = _dot(np.array(rows.mechanism.damping) * directions, directions)
        off = power - dampers - rows("power", q, directions)[..., 0]
        found.append(Identity(FORCES, _relative(off, max(_top(Q), _top(power)))))
    return found


def _closure_identities(
    mechanism: Mechanism, rows: RowValues, q: Array, qd: Array, t: Array
) -> list[Identity]:
    directions = np.random.default_rng(3).normal(size=q.shape)
    size = assembly.loop_size(mechanism)
    gap = closures.closure_gap(mechanism, q, t)
    Psi = closures.closure_jacobian(mechanism, q, t)
    bias = closures.closure_bias(mechanism, q, qd, t)
    ways, speed = absolute_rates(mechanism, directions), absolute_rates(mechanism, qd)
    slopes, turns = [], []
    most = _top(bias) if mechanism.laws else 0.0

    def closing_rate(q: Array, t: Array) -> Array:
        rate = matvec(closures.closure_jacobian(mechanism, q, t), qd)
        return rate + closures.closure_drift(mechanism, q, t) if mechanism.driven else rate

    # a law may bend faster than any link turns: the step that misses least tells
    for part in FINER if mechanism.laws else (1.0,):
        slope = along(lambda s: rows("gap", q + s * directions, t=t), ways / part)
        turned = along(lambda s: closing_rate(q + s * qd, t + s[..., 0]), speed / part)
        slopes.append(_relative(slope - matvec(Psi, directions), size))
        turns.append(_relative(turned - bias, max(size * _top(qd) ** 2, most)))
    return [
        Identity("gap = 0", max(_relative(gap, size), _relative(rows("gap", q, t=t), size))),
        Identity("Psi = dgap/dq", min(slopes)),
        Identity("Psi qd = 0", _relative(closing_rate(q, t), size * _top(qd))),
        Identity("Psidot qd", min(turns)),
    ]


def _motion_identities(
    mechanism: Mechanism, rows: RowValues, q: Array, qd: Array, t: Array, M: Array, C: Array
) -> list[Identity]:
    """Compare forward with inverse dynamics, and power with the growth of energy.

    Q includes friction by the forces in pins, at states that have a solution.
    """
    driven = list(mechanism.actuated)
    rng = np.random.default_rng(4)
    G = closed_form.gravity_vector(mechanism, q)
    tau = np.zeros(q.shape)
    tau[:, driven] = rng.normal(size=(len(q), len(driven))) * (_top(G) + 1.0)
    try:
        if mechanism.rubbing:
            moves = solvable(mechanism, q, qd, tau, t)
            if lost := int((~moves).sum()):
                told = f"friction has no solution at {lost} of {len(q)} random states: balances of "
                warnings.warn(f"{told}motion leave these out", dynamics.RobodynWarning, 2)
            q, qd, t, M, C, G, tau = (x[moves] for x in (q, qd, t, M, C, G, tau))
            if not len(q):
                return []
        motion = dynamics.forward_dynamics_and_forces(mechanism, q, qd, tau, t)
    except SingularError as error:
        return [Identity(name, None, str(error)) for name in (BALANCE, POWER)]
    qdd = motion.qdd
    damping = np.array(rows.mechanism.damping)
    Q = closed_form.other_forces(mechanism, q, qd, t)
    if mechanism.rubbing:
        Q = Q + load_of(mechanism, q, qd, qdd, motion.multipliers, t)
    terms = [matvec(M, qdd), matvec(C, qd), damping * qd, G, -tau, -Q]
    found, work = [], np.zeros(len(q))
    if mechanism.rows:
        Psi = closures.closure_jacobian(mechanism, q, t)
        terms.append(-matvec(np.swapaxes(Psi, -1, -2), motion.multipliers))
        drift = closures.closure_drift(mechanism, q, t)
        work = -_dot(drift, motion.multipliers)  # of laws of the time
        opening = matvec(Psi, qdd) + closures.closure_bias(mechanism, q, qd, t)
        free = max(map(_top, terms)) / _top(M)  # an acceleration that nothing holds
        size = assembly.loop_size(mechanism) * (max(_top(qdd), free) + _top(qd) ** 2)
        found.append(Identity("Psi qdd + Psidot qd = 0", _relative(opening, size)))
    # the parts of M qdd are what rounds: in a long chain they are far larger than their sum
    scale = max(*map(_top, terms), _top(matvec(np.abs(M), np.abs(qdd))))
    found.insert(0, Identity(BALANCE, _relative(np.sum(terms, axis=0), scale)))

    # on a path with this q, qd, qdd the energy grows by the power of torques less dampers
    def kinetic(s: Array) -> Array:
        there = q + s * qd + 0.5 * s**2 * qdd
        return closed_form.kinetic_energy(mechanism, there, qd + s * qdd)

    turning, bending = (np.abs(absolute_rates(mechanism, x)) for x in (qd, qdd))
    speed = np.maximum(turning, np.sqrt(bending))
    growth = along(kinetic, speed) + rows("PE rate", q, qd)[..., 0]
    power = _dot(tau + Q - damping * qd, qd) + work
    rounding = 1e-3 * _top(kinetic(np.zeros((len(q), 1)))) * _top(speed)  # of such a difference
    size = max(scale * _top(qd), rounding)
    return [*found, Identity(POWER, _relative(growth - power, size))]


def _kinetic_energy(scene: Mechanism, q: Array, qd: Array) -> Array:
    """Return KE of the bodies, each at its own point."""
    bodies, rates = bodies_of(scene), absolute_rates(scene, qd)
    speeds = np.abs(bodies.points.moved(placed(scene, q).rates(scene, rates)))
    spinning = frame_rates(scene, rates)
    KE = 0.5 * (speeds**2 @ bodies.mass + spinning**2 @ bodies.inertia)
    for k, link in enumerate(scene.description.links):
        if link.motor is not None:
            above = link.hangs_from.link
            carried = 0.0 if above is None else spinning[:, above]
            KE = KE + 0.5 * link.motor.inertia * (carried + link.motor.ratio * qd[:, k]) ** 2
    own = sum(bool(x.motor and x.motor.inertia) for x in scene.description.links)
    for spin in scene.spins[own:]:  # of elements that no description has
        KE = KE + 0.5 * spin.inertia * sum(c * rates[:, k] for k, c in spin.terms) ** 2
    return np.asarray(KE)


def within_tables(mechanism: Mechanism, q: Array) -> NDArray[np.bool_]:
    """Return which of the states q (T, n) are within all tables of the scene."""
    found = np.ones(len(q), bool)
    if mechanism.has_tables:
        rows = rows_of(parts.acting, mechanism)
        places = rows("tables", q)
        for k, (table, _) in enumerate(rows.tables):
            inside = (table.x[0] <= places[:, k]) & (places[:, k] <= table.x[-1])
            found &= inside | table.repeats
    return found


def along(function: Callable[[Array], Any], speed: Array) -> Any:
    """Return d function(s)/ds at s = 0 for each state; steps shrink with the largest speed."""
    fastest = np.abs(speed).max(axis=-1, keepdims=True)
    step = np.asarray(STEP / np.where(fastest > 0.0, fastest, 1.0))  # (T, 1)
    total: Any = None
    for k, weight in enumerate(WEIGHTS, start=1):
        change = function(k * step) - function(-k * step)
        change *= weight  # in place, as matrices of long chains are large
        total = change if total is None else np.add(total, change, out=total)
    total /= step.reshape(step.shape[:1] + (1,) * (np.ndim(total) - 1))
    return total


def _dot(left: Array, right: Array) -> Array:
    return np.asarray((left * right).sum(axis=-1))


def _top(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0))


def _relative(residual: Array, size: Array | float) -> float:
    scale = float(np.max(np.abs(size), initial=0.0))
    worst = _top(residual)
    return worst / scale if scale > 0.0 else worst
