"""Decides which joints stick and which stops hold at a state: the mode in which it goes on.

A joint at rest is held by a force between bounds: dry friction by up to `static` in both
directions, a hard stop by any push.  It is held as long as the needed force lies between them;
otherwise it starts in the direction in which nothing holds it.  If closures tie joints together,
only some can be held independently; the others contribute their bounds (`margins`).

The forces f of the joints at rest cause accelerations a = a0 + W f, with symmetric W. Each joint is
held (a = 0, f between its bounds) or starts (f at the bound against which it moves): f minimises f
. (W f / 2 + a0) between the bounds, one problem for all joints together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics import dynamics
from robodyn.dynamics.closed_form import energies
from robodyn.dynamics.dense_dynamics import joint_loads, responses
from robodyn.elements.contacts import NEAR, Mode
from robodyn.elements.joints import HardStop, of_way
from robodyn.loops.closures import closure_drift, scaled_jacobian
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode, moving_mode, pressed, resting_friction
from robodyn.mechanics.placed import finite
from robodyn.tables.arrays import Array

AT_REST = 1e-12  # part of the fastest joint's rate below which a joint stands still
TOGETHER = 1e-9  # relative singular value below which joints are not held independently
SLACK = 1e-14  # part of what accelerates a joint at rest that may be left over
STOPPED = 1e-6  # part of its rate that is left to a joint which stops together with others
STARTED = 1e-9  # part of the fastest rate with which a joint starts together with others
PASSES = 20  # a joint at rest, in which its force is found


class Standing(NamedTuple):
    """A mode, and all joints at rest in it: held ones, and those tied to them."""

    mode: Mode
    still: tuple[int, ...]


class Bounds(NamedTuple):
    """The bounds of the force that holds a joint at rest, N m or N."""

    low: float
    high: float


def bounds(mechanism: Mechanism, joint: int, sides: Sequence[int]) -> Bounds:
    """Return the bounds of a joint that touches the hard stops of these sides."""
    friction = mechanism.dry.get(joint)
    static = 0.0 if friction is None else friction.static
    low = -math.inf if 1 in sides else -of_way(static, 1)
    high = math.inf if -1 in sides else of_way(static, -1)
    return Bounds(low, high)


def resting(mechanism: Mechanism, qd: ArrayLike) -> list[int]:
    """Return the joints with dry friction that are at rest at rates qd (n)."""
    rates = np.abs(np.asarray(qd, float))
    least = AT_REST * float(rates.max(initial=0.0))
    return [joint for joint in mechanism.dry if rates[joint] <= least]


def touching(mechanism: Mechanism, q: Array, qd: Array, t: float) -> list[tuple[int, int]]:
    """Return the hard stops (joint, side) that a state at t touches without leaving them.

    Joints led by laws of time are left out.
    """
    least = AT_REST * float(np.abs(qd).max(initial=0.0))
    found = [
        (joint, side)
        for joint, side, end, _ in mechanism.of(HardStop)
        if abs(q[joint] - end) <= NEAR * max(1.0, abs(end)) and side * qd[joint] >= -least
    ]
    led = led_joints(mechanism, q, t) if found else ()
    return [end for end in found if end[0] not in led]


def led_joints(mechanism: Mechanism, q: Array, t: float) -> tuple[int, ...]:
    """Return the joints whose rates follow from laws of time and closures alone, at q (n) and t.

    No force between bounds holds them, and no impulse changes their rates.
    """
    if not mechanism.driven:
        return ()
    _, s, Vt = np.linalg.svd(scaled_jacobian(mechanism, q, t))
    free = Vt[int((s > TOGETHER * s[0]).sum()) :]
    return tuple(k for k in range(mechanism.n) if np.abs(free[:, k]).max(initial=0.0) <= TOGETHER)


def modes_of(
    mechanism: Mechanism, kind: str, states: Mapping[str, Array], times: Array
) -> dict[Mode, list[int]]:
    """Return the modes of states (k, n) at times (k,), and the indices of states in each."""
    found: dict[Mode, list[int]] = {}
    for k, (q, qd, third, t) in enumerate(zip(*states.values(), times.tolist(), strict=True)):
        if kind == "inverse":
            mode = moving_mode(mechanism, q.tolist(), qd.tolist(), third.tolist())
        else:
            rests, least = resting(mechanism, qd), AT_REST * float(np.abs(qd).max(initial=0.0))
            touches = [x for x in touching(mechanism, q, qd, t) if abs(qd[x[0]]) <= least]
            mode = mode_at(mechanism, q, qd, third, rests, touches, t=t).mode
        found.setdefault(mode, []).append(k)
    return found


def mode_at(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    tau: Array,
    rests: Sequence[int],
    touches: Sequence[tuple[int, int]] = (),
    pushing: tuple[tuple[int, int], ...] | None = None,
    starting: Mapping[int, int] = MappingProxyType({}),
    paused: Sequence[int] = (),
    *,
    t: float,
) -> Standing:
    """Return the mode in which a state goes on under torques tau (n) at t, and joints at rest.

    The joints of `rests` are at rest so far.  `touches` are hard stops (joint, side) on which
    joints rest too.  `pushing` are compliant stops that push; None decides by the state.
    `starting` are joints no longer held, with the direction in which they start.  `paused` are
    joints led by laws of time that slip in no direction.
    """
    sides: dict[int, list[int]] = {}
    for joint, side in touches:
        sides.setdefault(joint, []).append(side)
    still = sorted({*rests, *sides})
    slips = {j: int(math.copysign(1.0, qd[j])) for j in mechanism.dry if j not in {*still, *paused}}
    if pushing is None:
        pushing = pressed(mechanism, q.tolist(), qd.tolist())
    starts = dict(starting)
    if len(starts) < len(still):
        limits = {joint: bounds(mechanism, joint, sides.get(joint, ())) for joint in still}
        free = in_mode(mechanism, Mode((), tuple(sorted(slips.items())), pushing))
        qdd = dynamics.motion_dynamics(free, q, qd, tau, t).qdd[still]
        by = responses(mechanism, q, still, t)
        slack = SLACK * np.abs(by) @ load_sizes(free, q, qd, tau, t)
        starts = _starts(mechanism, qdd, slack, by[:, still], limits, starts)
    slips |= {joint: way for joint, way in starts.items() if joint in mechanism.dry}
    own = tuple(joint for joint in still if joint not in starts)
    mode = Mode(own, tuple(sorted(slips.items())), pushing)
    return Standing(mode._replace(held=independent(mechanism, own, q, t)), own)


def load_sizes(moving: Mechanism, q: Array, qd: Array, tau: Array, t: ArrayLike = 0.0) -> Array:
    """Return the sums of the sizes of what acts in states (..., n), (..., n), N m or N.

    Rounding leaves that much, times a few eps, of a force or torque that is zero.
    """
    units, arrays = moving.arrays.units, moving.arrays
    KE, PE = energies(moving, q, qd)
    loads = np.abs(tau) + np.abs(joint_loads(moving, q, qd, t))
    loads = (loads + np.abs(arrays.weights) + np.abs(arrays.moments)) @ units
    total = loads + 2.0 * KE + np.abs(PE - moving.energy_offset)
    return np.asarray(total[..., None] / units)


def _starts(
    mechanism: Mechanism,
    qdd: Array,
    slack: Array,
    W: Array,
    limits: dict[int, Bounds],
    starting: dict[int, int],
) -> dict[int, int]:
    """Return the joints of `limits` that start, and which way.

    qdd (k) are their accelerations if nothing holds them, right but for `slack` (k).
    Friction that falls at once from what holds to what slips may let others start too.
    """
    still, dry, starts = list(limits), mechanism.dry, dict(starting)
    low, high = (np.array([getattr(limits[j], x) for j in still]) for x in ("low", "high"))
    while True:
        for k, joint in enumerate(still):
            if joint in starts:
                friction = dry.get(joint)
                falls = friction is not None and friction.stribeck is None
                bound = high[k] if starts[joint] < 0 else low[k]
                if friction is not None and falls:
                    bound = -starts[joint] * of_way(friction.torque, starts[joint])
                low[k] = high[k] = bound
        f = forces_between(qdd, W, low, high)
        a = qdd + W @ f
        least = slack + SLACK * (np.abs(qdd) + np.abs(W) @ np.abs(f))
        found = {
            joint: 1 if a[k] > 0.0 else -1
            for k, joint in enumerate(still)
            if joint not in starts and abs(a[k]) > least[k]
        }
        starts |= found
        if not any(dry[j].stribeck is None for j in found if j in dry):
            return starts


def forces_between(a0: Array, W: Array, low: Array, high: Array) -> Array:
    """Return f (k) from `low` to `high` with a0 + W f >= 0 at low, <= 0 at high, else 0.

    W is symmetric positive semidefinite.  Starting from 0, free forces move to where nothing
    accelerates, up to the first bound, which then holds one more; a force that would pull is freed.
    """
    scale = np.sqrt(np.diagonal(W))
    scale = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 1.0)
    ends = low, high
    a0, W, low, high = scale * a0, scale[:, None] * W * scale, low / scale, high / scale
    f = np.clip(np.zeros_like(a0), low, high)
    free = low < high
    for _ in range(PASSES * len(f)):
        while free.any():
            step = np.zeros_like(f)
            rest, own = -(a0 + W @ f)[free], W[np.ix_(free, free)]
            step[free] = np.linalg.lstsq(own, rest, rcond=TOGETHER)[0]
            there, left = f + step, rest - own @ step[free]
            passes = (there < low) | (there > high)
            most = TOGETHER * float((np.abs(a0) + np.abs(W) @ np.abs(f)).max())
            endless = np.abs(left).max() > most  # no forces stop it: more and more, to a bound
            if endless:
                step[free] = np.where(np.abs(left) > most, left, 0.0)
            bound = np.where(step > 0.0, high, low)
            if endless:
                passes = (step != 0.0) & np.isfinite(bound)
            beyond = np.flatnonzero(free & passes)
            if not len(beyond):
                f = there
                break
            parts = (bound - f)[beyond] / step[beyond]
            first = int(beyond[np.argmin(parts)])
            f = f + float(parts.min()) * step
            f[first], free[first] = bound[first], False
        a = a0 + W @ f
        pulls = np.where(f == low, -a, a)
        pulls[free | (low == high)] = 0.0
        worst = int(np.argmax(pulls))
        if pulls[worst] <= SLACK * (abs(a0[worst]) + float(np.abs(W[worst]) @ np.abs(f))):
            break
        free[worst] = True
    return np.where(f == low, ends[0], np.where(f == high, ends[1], f * scale))


def stopped(
    mechanism: Mechanism, q: Array, qd: Array, joints: Sequence[int], t: float
) -> tuple[Array, list[int]]:
    """Return the rates (n) nearest to qd with these joints at rest, and all joints then at rest.

    Laws of time are kept: Psi qd + d gap/dt = 0.  The list includes joints with dry friction that
    the closures stop together with the others.
    """
    after = qd.copy()
    if mechanism.rows:
        units, n = mechanism.arrays.units, mechanism.n
        rows = np.concatenate([scaled_jacobian(mechanism, q, t), np.eye(n)[list(joints)]])
        U, s, Vt = np.linalg.svd(rows, full_matrices=False)
        r, held = len(mechanism.rows), s > TOGETHER * s[0]
        along = Vt[held] @ (qd / units)
        if mechanism.driven:
            along += U[:r, held].T @ closure_drift(mechanism, q, t) / s[held]
        after -= units * (Vt[held].T @ along)
    after[list(joints)] = 0.0
    none = AT_REST * np.abs(qd).max(initial=0.0)
    after[np.abs(after) <= none] = 0.0  # what rounding leaves
    least = np.maximum(STOPPED * np.abs(qd), none)
    also = [j for j in mechanism.dry if j not in joints and abs(after[j]) <= least[j]]
    after[also] = 0.0
    return after, also


def held_forces(moving: Mechanism, multipliers: Array) -> Array:
    """Return the force on each held joint, (..., k), N m or N, from multipliers (..., r)."""
    arms = [moving.rows[r].arm for r in moving.held]
    return np.asarray(multipliers[..., list(moving.held)] * np.array(arms))


def independent(mechanism: Mechanism, joints: Sequence[int], q: Array, t: float) -> tuple[int, ...]:
    """Return as many of these joints as the closures let be held independently at q (n) and t."""
    if not mechanism.rows or not joints:
        return tuple(joints)
    kept: list[int] = []
    rows = scaled_jacobian(mechanism, q, t)
    each = float(np.abs(rows).max()) * np.eye(mechanism.n)  # the rows of what is held
    rank = _rank(rows)
    for joint in joints:
        tried = np.concatenate([rows, each[joint : joint + 1]])
        if (more := _rank(tried)) > rank:
            kept, rows, rank = [*kept, joint], tried, more
    return tuple(kept)


def stands(moving: Mechanism, q: Array, t: float) -> bool:
    """Return whether the held joints of a mode leave nothing that can move."""
    least = len(moving.rows) >= moving.n and bool(moving.held)
    return least and _rank(scaled_jacobian(moving, q, t)) == moving.n


def _rank(rows: Array) -> int:
    s = np.linalg.svd(rows, compute_uv=False)
    return int((s > TOGETHER * s[0]).sum())


def margins(
    mechanism: Mechanism,
    mode: Mode,
    still: Sequence[int],
    q: Array,
    forces: Array,
    limits: Mapping[int, Bounds],
    t: Array,
) -> Array:
    """Return how far holding forces are from their bounds, (k, m); negative if one fails.

    q is (k, n), t (k,).  `forces` (k, held) hold the joints of the mode; the other joints of
    `still` are at rest with them, and contribute their bounds.  N m, or N.
    """
    helpers = [joint for joint in still if joint not in mode.held]
    if not mode.held:
        return np.full((len(q), 1), math.inf)
    low, high = (np.array([getattr(limits[j], x) for j in mode.held]) for x in ("low", "high"))
    if helpers:
        bounded = [limits[joint] for joint in helpers]
        states = zip(q, t.tolist(), strict=True)
        shares = [_shares(mechanism, mode, helpers, *each) for each in states]
        if len(mode.held) > 1:
            left = [_shared(x, low, high, s, bounded) for x, s in zip(forces, shares, strict=True)]
            return -np.array([missed for missed, _ in left])[:, None]
        ends = np.array([[x.low, x.high] for x in bounded])
        pairs = np.array(shares) * ends  # (k, helpers, 2)
        low = low + pairs.min(axis=-1).sum(axis=-1, keepdims=True)
        high = high + pairs.max(axis=-1).sum(axis=-1, keepdims=True)
    return np.concatenate([forces - low, high - forces], axis=1)


def _shares(mechanism: Mechanism, mode: Mode, helpers: Sequence[int], q: Array, t: float) -> Array:
    """Return the rate of each helper per unit rate of held joints, (helpers, held)."""
    rows = scaled_jacobian(mechanism, q, t) / mechanism.arrays.units
    held = list(mode.held)
    others = [k for k in range(mechanism.n) if k not in mode.held]
    rates = -np.linalg.lstsq(rows[:, others], rows[:, held], rcond=TOGETHER)[0]
    return np.asarray(rates[[others.index(k) for k in helpers]])


def _shared(
    force: Array, low: Array, high: Array, shares: Array, bounded: Sequence[Bounds]
) -> tuple[float, Array]:
    """Return the margin where several joints are held, by a linear program.

    The second result are the rates (held) with which joints start if it fails: the dual solution.
    """
    from scipy.optimize import linprog

    count = len(shares)
    # least x: low - x <= force - shares^T f <= high + x, f within bounds
    A = np.concatenate(
        [np.c_[shares.T, -np.ones(len(force))], np.c_[-shares.T, -np.ones(len(force))]]
    )
    b = np.concatenate([force - low, high - force])
    kept = np.isfinite(b)
    ranges = [*((x.low, x.high) for x in bounded), (None, None)]
    found = linprog(np.r_[np.zeros(count), 1.0], A[kept], b[kept], bounds=ranges)
    rates = np.zeros(2 * len(force))
    if found.fun is None:
        return -math.inf, rates[: len(force)]
    rates[kept] = -found.ineqlin.marginals
    return float(found.fun), rates[: len(force)] - rates[len(force) :]


def starting_at(
    mechanism: Mechanism,
    standing: Standing,
    q: Array,
    forces: Array,
    limits: Mapping[int, Bounds],
    place: int,
    t: float,
) -> dict[int, float]:
    """The joints that are held no longer where a margin passes zero, and how fast they start.

    But for a common factor.
    """
    mode, still = standing
    helpers = [joint for joint in still if joint not in mode.held]
    count = len(mode.held)
    rates = np.zeros(count)
    rates[place % count] = 1.0 if place < count else -1.0  # it needs less than low, or more
    shares = _shares(mechanism, mode, helpers, q, t) if helpers else np.zeros((0, count))
    if helpers and count > 1:
        low, high = (np.array([getattr(limits[j], x) for j in mode.held]) for x in ("low", "high"))
        _, rates = _shared(forces, low, high, shares, [limits[joint] for joint in helpers])
    each = dict(zip([*mode.held, *helpers], [*rates, *(shares @ rates)], strict=True))
    least = STARTED * max(map(abs, each.values()))
    return {joint: rate for joint, rate in each.items() if abs(rate) > least}


Solved = tuple[Array, Array, str]  # of joints, multipliers, and a remark
Smooth = Callable[[Mechanism, str, int, dict[str, Array], Array], Solved]

AT_REST_REMARK = (
    "a joint with dry friction is at rest: any torque within its static friction of this holds it"
)


def by_modes(
    mechanism: Mechanism, kind: str, states: dict[str, Array], times: Array, smooth: Smooth
) -> Solved:
    """Accelerations or torques of states (..., n) that go on in modes of their own, by `smooth`."""
    for name, array in states.items():
        finite(name, array)
    shape, n, r = states["q"].shape, mechanism.n, len(mechanism.rows)
    flat = {name: array.reshape(-1, n) for name, array in states.items()}
    joints, forces = np.empty((len(flat["q"]), n)), np.empty((len(flat["q"]), r))
    every = np.broadcast_to(times.ravel(), len(joints))
    remarks: dict[str, None] = {}
    for mode, which in modes_of(mechanism, kind, flat, every).items():
        part = {name: array[which] for name, array in flat.items()}
        moving = in_mode(mechanism, mode)
        joints[which], found, remark = smooth(moving, kind, 2, part, every[which])
        if kind == "forward":
            joints[np.ix_(which, mode.held)] = 0.0  # but for rounding
        forces[which] = found[:, :r]
        remarks |= {remark: None}
    if kind == "inverse" and resting_friction(mechanism, flat["qd"], flat["qdd"]):
        remarks |= {AT_REST_REMARK: None}
    told = "; ".join(filter(None, remarks))
    return joints.reshape(shape), forces.reshape(*shape[:-1], r), told
