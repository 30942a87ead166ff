"""Inverse and forward dynamics by dense algebra in the freedoms left by the closures.

With N a basis of the null space of Psi (N^T Psi^T = 0) and x any solution of Psi x = -Psidot qd,

    forward:   N^T M N z = N^T (tau + Q - C qd - D qd - G - M x),      qdd = x + N z
    inverse:   N^T S^T tau_act = N^T (M qdd + C qd + D qd + G - Q)

and lambda follows from the remaining equations, with least norm if closures are dependent.  M alone
is never inverted, so massless links in a loop cause no problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.closed_form import absolute_inertia, mass_matrix, rotor_inertia
from robodyn.engines.factors import svd
from robodyn.engines.row_values import rows_of
from robodyn.errors import RobodynError, SingularError
from robodyn.loops.closing import loop_size, singular_at
from robodyn.loops.closures import absolute_jacobian, bias_at, drift_at, gap_at, scaled_jacobian
from robodyn.mechanics import parts
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import (
    Placed,
    absolute_rates,
    as_states,
    columns,
    matvec,
    placed,
    placed_at,
    relative_matrix,
)
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr

RANK_CUT = 1e-10  # singular values of Psi below this part of the loop's size count as zero
MASS_CUT = 1e-13  # a mass matrix, its diagonal scaled to 1, with a smaller eigenvalue is singular
GOLDEN = 0.5 * (5.0**0.5 - 1.0)
SURE = 1e-6  # such a matrix whose pivots are larger is none
LIGHTEST = 1e-15  # an inertia below this part of the inertias that it is summed of is none
SPREAD = 1e5  # ratio of link inertias up to which eliminating M before Psi keeps its digits
DEPENDENT = "the closures depend on one another: the pin forces are not unique (least norm given)"
BALANCE = 1e-7  # part of the load that torques may miss by before the motion is impossible


@short_repr
class Torques(NamedTuple):
    """tau (..., n) N m, zero at passive joints, and the multipliers lambda (..., r) N.

    `remark` tells if they are right but not unique.
    """

    tau: Array
    multipliers: Array
    remark: str = ""


@short_repr
class Accelerations(NamedTuple):
    """qdd (..., n) rad/s^2 and the multipliers lambda (..., r) N; `remark` as for Torques."""

    qdd: Array
    multipliers: Array
    remark: str = ""


def required_load(
    mechanism: Mechanism, q: Array, qd: Array, qdd: Array, t: ArrayLike = 0.0
) -> Array:
    """Return M qdd + C qd + D qd + G - Q, (..., n), N m.

    Torques and pin forces must balance it.
    """
    rates, accelerations = (absolute_rates(mechanism, qd), absolute_rates(mechanism, qdd, "qdd"))
    at = placed(mechanism, q)
    if rates.shape != accelerations.shape:
        rates, accelerations = np.broadcast_arrays(rates, accelerations)
    bent = at.accelerations(mechanism, rates, accelerations)
    load = matvec(mechanism.arrays.J.T, _loads(mechanism, at, bent))
    if mechanism.spins:
        load = load + matvec(rotor_inertia(mechanism), as_states(mechanism, "qdd", qdd))
    return load + joint_loads(mechanism, q, qd, t)


def _loads(mechanism: Mechanism, at: Placed, bent: Placed) -> Array:
    """Return the inertial and weight terms of `required_load` in x, with X'' = `bent`."""
    mechanism.check_masses()
    arrays = mechanism.arrays
    felt = matvec(arrays.A, bent.X).conj() - arrays.weights
    loads: Array = columns(mechanism, felt, at.X, at.E).real - arrays.moments
    return loads


def joint_loads(mechanism: Mechanism, q: Array, qd: Array, t: ArrayLike) -> Array:
    """Return the loads that act at joints: damping, springs, loads and friction."""
    loads: Array = mechanism.arrays.damping * qd
    if mechanism.has_state_forces:
        loads = loads + rows_of(parts.acting, mechanism)("torques", q, qd, t)
    return loads


def _whole_inertia(mechanism: Mechanism, at: Placed) -> Array:
    """Return M in x, rotors included."""
    M = absolute_inertia(mechanism, at)
    if mechanism.spins:
        turned = relative_matrix(mechanism)
        M = M + turned.T @ rotor_inertia(mechanism) @ turned
    return M


def inverse(mechanism: Mechanism, q: Array, qd: Array, qdd: Array, t: ArrayLike = 0.0) -> Torques:
    """Return torques and multipliers for states (..., n); see `dynamics.inverse_dynamics`."""
    return balanced(mechanism, q, required_load(mechanism, q, qd, qdd, t), t)


def balanced(mechanism: Mechanism, q: Array, load: Array, t: ArrayLike) -> Torques:
    """Return torques and multipliers that balance loads (..., n) at q (..., n).

    q broadcasts to the loads.  Raises SingularError if no torques balance them.
    """
    if not mechanism.rows and not mechanism.passive:
        return Torques(load, np.zeros((*load.shape[:-1], 0)))
    n, actuated, units = mechanism.n, list(mechanism.actuated), mechanism.arrays.units
    load = load * units  # as Psi here, what acts on displacements is told by a length
    s = decompose(mechanism, scaled_jacobian(mechanism, q, t))
    # a projector serves as N here: states of different rank go together
    kept = s.V * (np.arange(n) < s.rank[..., None])[..., None, :]
    freedoms = np.eye(n) - kept @ np.swapaxes(kept, -1, -2)
    driven = freedoms[..., :, actuated]
    wanted = matvec(freedoms, load)
    tau = np.zeros_like(load)
    # cut against 1, the projector's size: at a dead centre nothing but rounding is driven
    U, drive, Vt = svd(driven)
    tau[..., actuated] = matvec(_pseudo_inverse(U, drive, Vt, RANK_CUT), wanted)
    missing = np.abs(wanted - matvec(driven, tau[..., actuated])).max(axis=-1)
    excess = missing - BALANCE * np.abs(load).max(axis=-1)
    if (excess > 0.0).any():
        state = np.unravel_index(np.argmax(excess), load.shape[:-1])
        q = np.broadcast_to(q, load.shape)
        full = np.broadcast_to(s.rank, load.shape[:-1])[state] == len(mechanism.rows)
        kind = "dead centre" if full else "change point or dependent closures"
        limit = "no torque of the actuated joints makes this motion: "
        now = float(np.broadcast_to(np.asarray(t, float), load.shape[:-1])[state])
        limit += f"joint {_free_joint(mechanism, q[state], now)} is free here"
        raise singular_at(mechanism, kind, q[state], limit)
    remarks = _dependence(mechanism, s.rank)
    if (len(actuated) > n - s.rank).any():
        least = int((n - s.rank).min())
        freedom = "1 freedom" if least == 1 else f"{least} freedoms"
        remarks.insert(0, f"{len(actuated)} actuators on {freedom}: torques of least norm")
    if ((drive > RANK_CUT).sum(axis=-1) < np.minimum(len(actuated), n - s.rank)).any():
        at = "dead centre: the actuators cannot drive every freedom here"
        remarks.insert(0, f"{at}: torques of least norm")
    multipliers = matvec(np.swapaxes(s.inverse, -1, -2), load - tau)
    return Torques(tau / units, multipliers, "; ".join(remarks))


def forward(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    tau: Array,
    baumgarte: float = 0.0,
    t: ArrayLike = 0.0,
) -> Accelerations:
    """Return accelerations and multipliers for states (..., n); see `dynamics.forward_dynamics`.

    With the rate b = `baumgarte` (1/s), the closures obey gap'' + 2 b gap' + b^2 gap = 0.
    """
    return _solved(mechanism, q, qd, tau, baumgarte, t)[0]


def forward_and_caused(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    tau: Array,
    loads: Array,
    baumgarte: float,
    t: ArrayLike,
) -> tuple[Accelerations, Accelerations]:
    """Return `forward` of states (T, n), and what joint loads (T, c, n) add to it."""
    found, M, s = _solved(mechanism, q, qd, tau, baumgarte, t)
    return found, _caused(mechanism, M, s, loads)


def _solved(
    mechanism: Mechanism, q: Array, qd: Array, tau: Array, baumgarte: float, t: ArrayLike
) -> tuple[Accelerations, Array, Decomposition]:
    """Do the work of `forward`; return also M in x and the decomposition of Psi."""
    at, rates = placed(mechanism, q), absolute_rates(mechanism, qd)
    loads = joint_loads(mechanism, q, qd, t)
    acceleration, M, force, s = _moved(mechanism, at, rates, tau - loads, baumgarte, t)
    unbalanced = matvec(M, acceleration) - force
    multipliers = matvec(np.swapaxes(s.inverse, -1, -2), unbalanced)
    qdd = _of_joints(mechanism, acceleration)
    remark = "; ".join(_dependence(mechanism, s.rank))
    return Accelerations(qdd, multipliers, remark), M, s


def accelerations(
    mechanism: Mechanism, q: Array, qd: Array, tau: Array, baumgarte: float, t: float
) -> Array:
    """Return qdd (n,) of one finite state, as `forward`, without multipliers."""
    J = mechanism.arrays.J
    at, rates = placed_at(mechanism, matvec(J, q)), matvec(J, qd)
    loads = joint_loads(mechanism, q, qd, t)
    return _of_joints(mechanism, _moved(mechanism, at, rates, tau - loads, baumgarte, t)[0])


def _moved(
    mechanism: Mechanism,
    at: Placed,
    rates: Array,
    torques: Array,
    baumgarte: float,
    t: ArrayLike,
) -> tuple[Array, Array, Array, Decomposition]:
    """Return xdd (..., n) under joint torques, M, the force on x, and Psi decomposed.

    All in x, with displacements in units of a length.
    """
    units = mechanism.arrays.units
    M = _whole_inertia(mechanism, at)
    bent = at.accelerations(mechanism, rates, np.zeros_like(rates))
    force = matvec(relative_matrix(mechanism).T, torques) - _loads(mechanism, at, bent)
    Psi = absolute_jacobian(mechanism, at, t)
    bend = bias_at(mechanism, at, rates, bent, t)
    if baumgarte:
        gap = gap_at(mechanism, mechanism.arrays, at, t)
        opening = matvec(Psi, rates) + drift_at(mechanism, at, t)
        bend = bend + 2 * baumgarte * opening + baumgarte**2 * gap
    if mechanism.slides:
        M, force, Psi = M * units[:, None] * units, force * units, Psi * units
    s = decompose(mechanism, Psi)
    particular = -matvec(s.inverse, bend)
    right = force - matvec(M, particular)
    n, ranks = mechanism.n, s.rank.ravel().tolist()
    states = s.V.reshape(-1, n, n), M.reshape(-1, n, n), right.reshape(-1, n)
    if len(set(ranks)) == 1:  # as a rule
        V, inertia, force_left = states
        free = _along_freedoms(mechanism, V[..., ranks[0] :], inertia, force_left)
    else:
        free = np.zeros_like(states[2])
        for rank in set(ranks):
            which = s.rank.ravel() == rank
            V, inertia, force_left = (x[which] for x in states)
            free[which] = _along_freedoms(mechanism, V[..., rank:], inertia, force_left)
    return particular + free.reshape(right.shape), M, force, s


def _of_joints(mechanism: Mechanism, acceleration: Array) -> Array:
    """Return qdd (..., n) from xdd (..., n) with displacements in units of a length."""
    acceleration = acceleration * mechanism.arrays.units
    qdd = acceleration.copy()
    for k, above in enumerate(mechanism.above):
        if above is not None:
            qdd[..., k] -= acceleration[..., above]
    return qdd


def caused(mechanism: Mechanism, q: Array, loads: Array, t: ArrayLike) -> Accelerations:
    """Return accelerations and multipliers caused by joint loads (T, c, n) alone at q (T, n).

    `forward` is linear in loads: this is what further loads add to it.
    """
    at, units = placed(mechanism, q), mechanism.arrays.units
    M, Psi = _whole_inertia(mechanism, at), absolute_jacobian(mechanism, at, t)
    s = decompose(mechanism, Psi * units)
    return _caused(mechanism, M * units[:, None] * units, s, loads)


def _caused(mechanism: Mechanism, M: Array, s: Decomposition, loads: Array) -> Accelerations:
    """Do the work of `caused`, with M (T, n, n) in x and the decomposition of Psi."""
    count, c, n = loads.shape
    right = matvec(relative_matrix(mechanism).T, loads) * mechanism.arrays.units
    free = np.zeros_like(loads)
    for rank in set(s.rank.ravel().tolist()):
        which = s.rank == rank
        N, inertia = (np.repeat(x[which], c, axis=0) for x in (s.V[..., rank:], M))
        moved = _along_freedoms(mechanism, N, inertia, right[which].reshape(-1, n))
        free[which] = moved.reshape(-1, c, n)
    unbalanced = matvec(M[:, None], free) - right
    multipliers = matvec(np.swapaxes(s.inverse, -1, -2)[:, None], unbalanced)
    lam = multipliers.reshape(count, c, len(mechanism.rows))
    return Accelerations(_of_joints(mechanism, free), lam)


def responses(mechanism: Mechanism, q: Array, joints: Sequence[int], t: float) -> Array:
    """Return qdd (k, n) for a unit of torque at each of these joints at q (n,)."""
    units = mechanism.arrays.units
    M = mass_matrix(mechanism, q) * units[:, None] * units
    s = decompose(mechanism, scaled_jacobian(mechanism, q, t))
    right = np.eye(mechanism.n)[list(joints)] * units
    return _along_freedoms(mechanism, s.V[None, :, int(s.rank) :], M[None], right) * units


@lru_cache(maxsize=64)
def elimination_is_safe(mechanism: Mechanism) -> bool:
    """Return whether M can be eliminated before Psi, as generated code does.

    M alone must be positive definite (over sampled configurations).  With closures, the links'
    inertias must not differ so much that the multipliers lose their digits.
    """
    if len(mechanism.inertias) < mechanism.n:
        return False
    diagonal = np.array([mechanism.inertias[k] for k in range(mechanism.n)])
    scale = np.sqrt(diagonal)
    diagonal = diagonal * mechanism.arrays.units**2
    # the parts of squares of a golden ratio are spread evenly; numpy.random takes 6 ms to import
    turns = np.arange(8.0 * mechanism.n) ** 2 * GOLDEN % 1.0
    sample = np.pi * (2.0 * turns.reshape(8, -1) - 1.0)
    sample[:, list(mechanism.slides)] *= mechanism.unit
    M = _whole_inertia(mechanism, placed(mechanism, sample)) / (scale[:, None] * scale)
    regular = bool(np.linalg.eigvalsh(M)[:, 0].min() > MASS_CUT)
    return regular and (not mechanism.rows or diagonal.max() <= SPREAD * diagonal.min())


def check_actuators(mechanism: Mechanism, q: Array) -> None:
    """Raise RobodynError if there are fewer actuators than freedoms."""
    freedoms = mechanism.n - len(mechanism.rows)
    if len(mechanism.actuated) < freedoms and q.size:
        joint = _free_joint(mechanism, q.reshape(-1, mechanism.n)[0], 0.0)
        raise RobodynError(
            "torque",
            where=mechanism.source,
            limit=f"fewer actuators ({len(mechanism.actuated)}) than freedoms ({freedoms}): joint "
            f"{joint} is free; name it in `actuated`",
        )


class Decomposition(NamedTuple):
    """Psi = U diag(s) V^T: square U and V, the rank (...), and Psi's pseudoinverse."""

    U: Array
    V: Array
    rank: NDArray[np.int64]
    inverse: Array


def decompose(mechanism: Mechanism, Psi: Array) -> Decomposition:
    """Return the decomposition of Psi (..., r, n), displacements in units of a length."""
    U, s, Vt = svd(Psi, full=True)
    k, cut = s.shape[-1], RANK_CUT * loop_size(mechanism)
    inverse = _pseudo_inverse(U[..., :, :k], s, Vt[..., :k, :], cut)
    return Decomposition(U, Vt.swapaxes(-1, -2), (s > cut).sum(axis=-1), inverse)


def _pseudo_inverse(U: Array, s: Array, Vt: Array, cut: float) -> Array:
    """Return V diag(1/s) U^T, without the singular values up to `cut`."""
    counts = s > cut
    inverse = 1.0 / s if counts.all() else np.divide(1.0, s, out=np.zeros_like(s), where=counts)
    found: Array = (Vt.swapaxes(-1, -2) * inverse[..., None, :]) @ U.swapaxes(-1, -2)
    return found


def _along_freedoms(
    mechanism: Mechanism, N: Array, M: Array, right: Array, apart: bool = False
) -> Array:
    """Return N z with N^T M N z = N^T right, for states (T, n).

    Raises SingularError if N^T M N is singular.  `apart` tells that N is already as `_parted`
    returns it.
    """
    if not N.shape[-1]:
        return np.zeros_like(right)
    Nt, whole = N.swapaxes(-1, -2), N.shape[-1] == N.shape[-2]  # without closures N is 1
    one = N.shape[-1] == 1  # whose inertia is scaled to 1
    reduced = M if whole else Nt @ M @ N
    if one and not whole:
        inertia = reduced[..., 0]
        if (inertia > LIGHTEST * (np.abs(Nt) @ np.abs(M) @ np.abs(N))[..., 0]).all():
            scale = np.sqrt(inertia)
            return matvec(N, matvec(Nt, right) / scale / scale)
    diagonal = np.diagonal(reduced, axis1=-2, axis2=-1)
    # the rounding of an inertia is a part of what its own freedom moves, of no other link
    moved = 0.0 if whole else LIGHTEST * (np.abs(N) * (np.abs(M) @ np.abs(N))).sum(axis=-2)
    scale = np.sqrt(np.where(diagonal > moved, diagonal, np.inf))
    scaled = reduced / (scale[:, :, None] * scale[:, None, :])
    least = np.where(np.isinf(scale[:, 0]), 0.0, 1.0) if one else np.zeros(len(scaled))
    if not (one or np.isinf(scale).any()):
        try:  # no pivot is below the least eigenvalue, and few are near it
            pivots = np.diagonal(np.linalg.cholesky(scaled), axis1=-2, axis2=-1) ** 2
            least = pivots.min(axis=-1)
        except np.linalg.LinAlgError:
            pass
    if (least < SURE).any():
        least = np.where(np.isinf(scale).any(axis=-1), 0.0, np.linalg.eigvalsh(scaled)[:, 0])
    light = least < MASS_CUT
    if light.any() and not (whole or apart):  # N may mix light freedoms with heavy ones
        found = np.empty_like(right)
        parted = np.stack([_parted(each) for each in N[light]])
        found[light] = _along_freedoms(mechanism, parted, M[light], right[light], apart=True)
        if not light.all():
            found[~light] = _along_freedoms(mechanism, N[~light], M[~light], right[~light])
        return found
    if light.any():
        worst = int(np.argmin(least))
        _, vectors = np.linalg.eigh(reduced[worst])
        link = int(np.argmax(np.abs(N[worst] @ vectors[:, 0])))
        raise SingularError(
            f"link {mechanism.link_names[link]} can move without any inertia",
            where=mechanism.source,
            limit="its acceleration is undefined; give it, or what it carries, a mass or an "
            "inertia",
        )
    z = matvec(Nt, right) / scale
    z = (z if one else np.linalg.solve(scaled, z[..., None])[..., 0]) / scale
    return matvec(N, z)


def _parted(N: Array) -> Array:
    """Return a basis of the columns of N (n, f), each with a row 1 where all others are 0."""
    N, rows = N.copy(), list[int]()
    for c in range(N.shape[1]):
        left = np.abs(N[:, c:])
        left[rows] = 0.0
        row, column = divmod(int(left.argmax()), left.shape[1])
        N[:, [c, c + column]] = N[:, [c + column, c]]
        N[:, c] /= N[row, c]
        others = np.arange(N.shape[1]) != c
        N[:, others] -= N[:, c : c + 1] * N[row, others]
        rows.append(row)
    return N


def _dependence(mechanism: Mechanism, rank: NDArray[np.int64]) -> list[str]:
    if np.all(rank == len(mechanism.rows)):
        return []
    return [DEPENDENT]


def _free_joint(mechanism: Mechanism, q: Array, t: float) -> str:
    """Return the name of the joint that moves most with every actuated joint held."""
    held = np.eye(mechanism.n)[list(mechanism.actuated)]
    s = decompose(mechanism, np.vstack([scaled_jacobian(mechanism, q, t), held]))
    joint = int(np.argmax((s.V[:, int(s.rank) :] ** 2).sum(axis=-1)))
    return f"q{joint + 1} ({mechanism.link_names[joint]})"
