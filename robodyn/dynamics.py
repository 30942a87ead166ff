"""Inverse and forward dynamics of open and closed mechanisms, and the forces in the loops.

The equation of motion, with the joints' damping D and the closures' multipliers lambda, is

    M qdd + C qd + D qd + G = S^T tau_act + Psi^T lambda,     Psi qdd + Psidot qd = 0          (1)

(S selects the actuated joints).  Eliminating lambda from it gives the textbook's equation (33).
Here the elimination goes through the freedoms that the closures leave (the null space of Psi), so
that it also works where M alone is singular but the constrained system is not, and where closures
depend on one another.  Large batches run through the generated code of `straightline.py`; the few
states of them that are near singular, and small batches, run through the dense algebra below.
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn import blocks, formulas, straightline
from robodyn.closed_form import (
    absolute_gravity,
    absolute_inertia,
    absolute_rates,
    as_states,
    closure_bias,
    closure_gap,
    closure_jacobian,
    phases,
)
from robodyn.errors import RobodynError, SingularError
from robodyn.mechanism import Mechanism
from robodyn.straightline import ArrayFunction

Array = NDArray[np.float64]

RANK_CUT = 1e-10  # singular values of Psi below this part of the largest count as zero
PIVOT_CUT = 1e-8  # generated code is trusted while the closures' relative pivots exceed this
MASS_CUT = 1e-13  # a scaled mass matrix with a smaller eigenvalue counts as singular
BATCH = 200  # from so many states on generated array code wins, its generation included
MAX_GENERATED = 12  # links; beyond, dense algebra costs less than generating and running code


class RobodynWarning(UserWarning):
    """A result that is right but not the only one, or near a limit."""


class Torques(NamedTuple):
    """tau (..., n) N m, zero at passive joints, and the multipliers lambda (..., r) N.

    `remark` says where they are right but not the only ones.
    """

    tau: Array
    multipliers: Array
    remark: str = ""


class Accelerations(NamedTuple):
    """qdd (..., n) rad/s^2 and the multipliers lambda (..., r) N; `remark` as for Torques."""

    qdd: Array
    multipliers: Array
    remark: str = ""


Solution = TypeVar("Solution", Torques, Accelerations)


def inverse_dynamics(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """The joint torques tau of equation (1) that the motion needs, (..., n), N m.

    q, qd, qdd are (..., n) and broadcast; a closed mechanism's must keep its closures (see
    `assembly`).  Passive joints get zero.  With more actuators than freedoms tau is the one of
    least norm, with a RobodynWarning.  Raises InputError for arrays that do not fit, RobodynError
    where the mechanism has fewer actuators than freedoms, SingularError where no torque at the
    actuated joints can make the motion.
    """
    return inverse_dynamics_and_forces(mechanism, q, qd, qdd).tau


def inverse_dynamics_and_forces(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
) -> Torques:
    """`inverse_dynamics` and the multipliers of the closures; see there."""
    q, qd, qdd = _broadcast(
        as_states(mechanism, "q", q),
        as_states(mechanism, "qd", qd),
        as_states(mechanism, "qdd", qdd),
    )
    _check_actuators(mechanism, q)
    generated = _generated("inverse", mechanism) if _worth(mechanism, q) else None
    if generated is None:
        return _warned(_dense_inverse(mechanism, q, qd, qdd))
    solution, forces, doubtful = _run(mechanism, generated, q, qd, qdd)
    if doubtful.size:
        pieces = [np.reshape(x, (-1, mechanism.n))[doubtful] for x in (q, qd, qdd)]
        dense = _dense_inverse(mechanism, *pieces)
        solution.reshape(-1, mechanism.n)[doubtful] = dense.tau
        forces.reshape(-1, len(mechanism.rows))[doubtful] = dense.multipliers
        _warned(dense)
    return Torques(solution, forces)


def forward_dynamics(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> Array:
    """The accelerations qdd of equation (1) that the joint torques tau cause, (..., n), rad/s^2.

    q, qd, tau are (..., n) and broadcast; a closed mechanism's q and qd must keep its closures.
    Raises InputError for arrays that do not fit, SingularError where a freedom has no inertia.
    """
    return forward_dynamics_and_forces(mechanism, q, qd, tau).qdd


def forward_dynamics_and_forces(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, tau: ArrayLike
) -> Accelerations:
    """`forward_dynamics` and the multipliers of the closures; see there."""
    q, qd, tau = _broadcast(
        as_states(mechanism, "q", q),
        as_states(mechanism, "qd", qd),
        as_states(mechanism, "tau", tau),
    )
    generated = None
    if _worth(mechanism, q) and mass_is_regular(mechanism):
        generated = _generated("forward", mechanism)
    if generated is None:
        return _warned(dense_forward(mechanism, q, qd, tau))
    solution, forces, doubtful = _run(mechanism, generated, q, qd, tau)
    if doubtful.size:
        pieces = [np.reshape(x, (-1, mechanism.n))[doubtful] for x in (q, qd, tau)]
        dense = dense_forward(mechanism, pieces[0], pieces[1], pieces[2])
        solution.reshape(-1, mechanism.n)[doubtful] = dense.qdd
        forces.reshape(-1, len(mechanism.rows))[doubtful] = dense.multipliers
        _warned(dense)
    return Accelerations(solution, forces)


def pin_forces(mechanism: Mechanism, multipliers: ArrayLike) -> Array:
    """The force on the side of each closure that is named first, (..., closures, 2), N.

    `multipliers` (..., r) are those of `inverse_dynamics_and_forces` and the like.
    """
    lam = np.asarray(multipliers, float)
    forces = np.zeros((*lam.shape[:-1], len(mechanism.description.closures), 2))
    for row, entry in enumerate(mechanism.rows):
        forces[..., entry.closure, 0] += lam[..., row] * entry.direction.real
        forces[..., entry.closure, 1] += lam[..., row] * entry.direction.imag
    return forces


def required_load(mechanism: Mechanism, q: Array, qd: Array, qdd: Array) -> Array:
    """M qdd + C qd + D qd + G, (..., n): what torques and pin forces must balance, N m.

    In absolute angles it is Re(conj(E) (A (E (alphadd + i alphad^2)))) + G.
    """
    arrays = mechanism.arrays
    E = phases(mechanism, q)
    rates = absolute_rates(mechanism, qd)
    inner = E * (absolute_rates(mechanism, qdd, "qdd") + 1j * rates**2)
    load = (E.conj() * (inner @ arrays.A.T)).real + absolute_gravity(mechanism, E)
    result: Array = load @ arrays.J + arrays.damping * qd
    return result


@lru_cache(maxsize=64)
def mass_is_regular(mechanism: Mechanism) -> bool:
    """Whether M alone is positive definite, over a sample of configurations."""
    return mechanism.n > 0 and _least_inertia(mechanism)[0] > MASS_CUT


# -- dense algebra -------------------------------------------------------------------------------


def _dense_inverse(mechanism: Mechanism, q: Array, qd: Array, qdd: Array) -> Torques:
    load = required_load(mechanism, q, qd, qdd)
    if not mechanism.rows and not mechanism.passive:
        return Torques(load, np.zeros((*load.shape[:-1], 0)))
    n, actuated = mechanism.n, list(mechanism.actuated)
    Psi = closure_jacobian(mechanism, q)
    pseudo_inverse, freedoms, rank = _split(Psi)
    # along the freedoms the pin forces do no work: freedoms S^T tau = freedoms load
    driven = freedoms[..., :, actuated]
    wanted = np.einsum("...ij,...j->...i", freedoms, load)
    drives = np.linalg.pinv(driven, rcond=RANK_CUT)
    tau = np.zeros_like(load)
    tau[..., actuated] = np.einsum("...ij,...j->...i", drives, wanted)
    missing = wanted - np.einsum("...ij,...j->...i", driven, tau[..., actuated])
    size = np.abs(load).max(axis=-1, keepdims=True)
    if (np.abs(missing) > 1e-7 * size).any():
        state = np.unravel_index(np.argmax((np.abs(missing) - 1e-7 * size).max(-1)), q.shape[:-1])
        raise _cannot_drive(mechanism, q[state], int(rank[state]))
    remarks = _dependence(mechanism, rank)
    if (len(actuated) > n - rank).any():
        least = int((n - rank).min())
        freedoms_text = "1 freedom" if least == 1 else f"{least} freedoms"
        remarks.insert(0, f"{len(actuated)} actuators on {freedoms_text}: torques of least norm")
    multipliers = np.einsum("...ji,...j->...i", pseudo_inverse, load - tau)
    return Torques(tau, multipliers, "; ".join(remarks))


def dense_forward(
    mechanism: Mechanism, q: Array, qd: Array, tau: Array, baumgarte: float = 0.0
) -> Accelerations:
    """Forward dynamics along the freedoms that the closures leave, for states (..., n).

    A `baumgarte` rate b (1/s) makes the closures obey gapdd + 2 b gapd + b^2 gap = 0.
    """
    arrays = mechanism.arrays
    E = phases(mechanism, q)
    rates = absolute_rates(mechanism, qd)
    W = absolute_inertia(mechanism, E)
    # absolute coordinates, scaled so that the links' own inertias become 1
    scale = _inertia_scale(mechanism)
    joint = tau - arrays.damping * qd
    force = joint @ np.linalg.inv(arrays.J)  # J^-1 is a 0, 1, -1 matrix: exact
    force = (force + np.einsum("...jk,...k->...j", W.imag, rates**2)) / scale
    force = force - absolute_gravity(mechanism, E) / scale
    M = W.real / (scale[:, None] * scale)
    Psi = -(arrays.P * E[..., None, :]).imag / scale
    pseudo_inverse, freedoms, rank = _split(Psi)
    bend = closure_bias(mechanism, q, qd)
    if baumgarte:
        gapd = np.einsum("...ij,...j->...i", Psi, rates * scale)
        bend = bend + 2 * baumgarte * gapd + baumgarte**2 * closure_gap(mechanism, q)
    particular = -np.einsum("...ij,...j->...i", pseudo_inverse, bend)
    right = force - np.einsum("...ij,...j->...i", M, particular)
    right = np.einsum("...ij,...j->...i", freedoms, right)
    reduced = freedoms @ M @ freedoms + (np.eye(mechanism.n) - freedoms)
    least = np.linalg.eigvalsh(reduced)[..., 0]
    if (least < MASS_CUT).any():
        state = np.unravel_index(np.argmin(least), q.shape[:-1])
        raise _no_inertia(mechanism, reduced[state], scale)
    free = np.linalg.solve(reduced, right[..., None])[..., 0]
    acceleration = particular + free
    residual = np.einsum("...ij,...j->...i", M, acceleration) - force
    multipliers = np.einsum("...ji,...j->...i", pseudo_inverse, residual)
    absolute = acceleration / scale
    qdd = absolute.copy()
    for k, above in enumerate(mechanism.parent):
        if above is not None:
            qdd[..., k] -= absolute[..., above]
    return Accelerations(qdd, multipliers, "; ".join(_dependence(mechanism, rank)))


def _dependence(mechanism: Mechanism, rank: NDArray[np.int64]) -> list[str]:
    if np.all(rank == len(mechanism.rows)):
        return []
    return ["the closures depend on one another: the pin forces are not unique (least norm given)"]


def _split(Psi: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Pseudo-inverse of Psi (..., n, r), projector onto its null space (..., n, n), its rank."""
    U, s, Vt = np.linalg.svd(Psi, full_matrices=False)
    keep = s > RANK_CUT * s.max(axis=-1, keepdims=True, initial=0.0)
    inverse = np.where(keep, 1.0 / np.where(keep, s, 1.0), 0.0)
    V = np.swapaxes(Vt, -1, -2)
    pseudo_inverse = (V * inverse[..., None, :]) @ np.swapaxes(U, -1, -2)
    kept = V * keep[..., None, :]
    freedoms = np.eye(Psi.shape[-1]) - kept @ np.swapaxes(kept, -1, -2)
    return pseudo_inverse, freedoms, keep.sum(axis=-1)


def _inertia_scale(mechanism: Mechanism) -> Array:
    """Square roots of the diagonal of A; a massless link takes part with a trifle of the rest."""
    diagonal = mechanism.arrays.A.diagonal().real
    floor = 1e-12 * diagonal.max(initial=0.0)
    scale: Array = np.sqrt(np.where(diagonal > floor, diagonal, floor or 1.0))
    return scale


def _warned(solution: Solution) -> Solution:
    if solution.remark:
        warnings.warn(solution.remark, RobodynWarning, stacklevel=3)
    return solution


# -- faults --------------------------------------------------------------------------------------


def _check_actuators(mechanism: Mechanism, q: Array) -> None:
    freedoms = mechanism.n - len(mechanism.rows)
    if len(mechanism.actuated) < freedoms and q.size:
        state = q.reshape(-1, mechanism.n)[0]
        joint = _free_joint(mechanism, state)
        raise RobodynError(
            "torque",
            where=mechanism.source,
            limit=f"{len(mechanism.actuated)} actuators for {freedoms} freedoms: joint {joint} "
            "is free; name it in `actuated`",
        )


def _free_joint(mechanism: Mechanism, q: Array) -> str:
    """The joint that moves most when every actuated joint is held."""
    held = np.eye(mechanism.n)[list(mechanism.actuated)]
    _, freedoms, _ = _split(np.vstack([closure_jacobian(mechanism, q), held]))
    joint = int(np.argmax(np.diagonal(freedoms)))
    return f"q{joint + 1} ({mechanism.link_names[joint]})"


def _cannot_drive(mechanism: Mechanism, q: Array, rank: int) -> SingularError:
    kind = "dead centre" if rank == len(mechanism.rows) else "change point or dependent closures"
    joint = _free_joint(mechanism, q)
    at = ", ".join(f"{x:.9g}" for x in q)
    return SingularError(
        f"singular configuration ({kind}) at q = {at}",
        limit=f"no torque of the actuated joints makes this motion: joint {joint} is free here",
    )


def _least_inertia(mechanism: Mechanism) -> tuple[float, NDArray[np.float64]]:
    """The least eigenvalue of the scaled mass matrix over a sample, and its eigenvector."""
    scale = _inertia_scale(mechanism)
    sample = np.random.default_rng(0).uniform(-np.pi, np.pi, (8, mechanism.n))
    W = absolute_inertia(mechanism, phases(mechanism, sample)).real / (scale[:, None] * scale)
    values, vectors = np.linalg.eigh(W)
    worst = int(np.argmin(values[:, 0]))
    return float(values[worst, 0]), vectors[worst, :, 0]


def _no_inertia(mechanism: Mechanism, reduced: Array, scale: Array) -> SingularError:
    vector = np.linalg.eigh(reduced)[1][:, 0] / scale
    link = int(np.argmax(np.abs(vector)))
    return SingularError(
        f"link {mechanism.link_names[link]} can move without any inertia",
        where=mechanism.source,
        limit="its acceleration is undefined; give it, or what it carries, a mass or an inertia",
    )


# -- generated code over batches -----------------------------------------------------------------


def _broadcast(*arrays: Array) -> list[Array]:
    return list(np.broadcast_arrays(*arrays))


def _worth(mechanism: Mechanism, q: Array) -> bool:
    return q.size >= BATCH * mechanism.n and mechanism.n <= MAX_GENERATED


@lru_cache(maxsize=64)
def _generated(kind: str, mechanism: Mechanism) -> tuple[ArrayFunction, int, int] | None:
    """The compiled array function, its buffers and pivots; None where there is none."""
    if kind == "inverse":
        formula = formulas.inverse_formula(mechanism)
    else:
        formula = formulas.forward_formula(mechanism)
    if formula is None:
        return None
    function, buffers = straightline.compile_arrays(formula, kind)
    return function, buffers, len(formula.pivots)


def _run(
    mechanism: Mechanism, generated: tuple[ArrayFunction, int, int], *states: Array
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Joint values (..., n), multipliers (..., r), and the flat indices of doubtful states."""
    function, buffers, pivots = generated
    shape, n, r = states[0].shape[:-1], mechanism.n, len(mechanism.rows)
    inputs = [state.reshape(-1, n) for state in states]
    total = inputs[0].shape[0]
    joints, forces, quality = (np.empty((total, k)) for k in (n, r, pivots))
    blocks.evaluate(function, buffers, inputs, (joints, forces, quality))
    doubtful = np.flatnonzero(~(quality > PIVOT_CUT).all(axis=-1))
    return joints.reshape(*shape, n), forces.reshape(*shape, r), doubtful
