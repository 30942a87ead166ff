"""Which joints stick, and which stops hold, at a state: the mode in which it goes on.

A joint at rest is held by a force between bounds: dry friction by up to `static` either way, a hard
stop by any push.  It is held as long as what is needed lies between them; where it does not, the
joint starts the way that nothing holds it back from.  Of joints that the closures tie together
only some can be held independently; the others help by what they hold (`margins`).

Of the joints at rest each is held, or starts one of its ways: the first of these choices that
agrees with itself is taken, that which holds most first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics import dynamics
from robodyn.dynamics.closed_form import scaled_jacobian
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import NEAR, Mode, in_mode, moving_mode, pressed

Array = NDArray[np.float64]

AT_REST = 1e-12  # part of the fastest joint's rate below which a joint stands still
TOGETHER = 1e-9  # relative singular value below which joints are not held independently
SLACK = 1e-12  # part of the forces by which a bound may be missed
MOST = 6  # joints at rest of which all choices are tried


class Standing(NamedTuple):
    """A mode, and all joints that stand still in it: those it holds, and those tied to them."""

    mode: Mode
    still: tuple[int, ...]


class Bounds(NamedTuple):
    """Between what a joint at rest is held, N m or N, and which ways it may start."""

    low: float
    high: float
    ways: tuple[int, ...]


def bounds(mechanism: Mechanism, joint: int, sides: Sequence[int]) -> Bounds:
    """Of a joint that touches the hard stops of these sides."""
    friction = dict(mechanism.dry).get(joint)
    most = 0.0 if friction is None else friction.static
    low = -math.inf if 1 in sides else -most
    high = math.inf if -1 in sides else most
    return Bounds(low, high, tuple(way for way in (1, -1) if way not in sides))


def resting(mechanism: Mechanism, qd: ArrayLike) -> list[int]:
    """The joints with dry friction that stand still at the rates qd (n)."""
    rates = np.abs(np.asarray(qd, float))
    least = AT_REST * float(rates.max(initial=0.0))
    return [joint for joint, _ in mechanism.dry if rates[joint] <= least]


def touching(mechanism: Mechanism, q: Array, qd: Array) -> list[tuple[int, int]]:
    """The hard stops, joints and sides, that a state touches without leaving them."""
    least = AT_REST * float(np.abs(qd).max(initial=0.0))
    return [
        (joint, side)
        for joint, stop in mechanism.limits
        for side, end in (stop.ends if stop.restitution is not None else [])
        if abs(q[joint] - end) <= NEAR * max(1.0, abs(end)) and side * qd[joint] >= -least
    ]


def modes_of(
    mechanism: Mechanism, kind: str, states: Mapping[str, Array], times: Array
) -> dict[Mode, list[int]]:
    """The modes of states (k, n) at times (k,), and which of them have each."""
    found: dict[Mode, list[int]] = {}
    for k, (q, qd, third, t) in enumerate(zip(*states.values(), times.tolist(), strict=True)):
        if kind == "inverse":
            mode = moving_mode(mechanism, q.tolist(), qd.tolist(), third.tolist())
        else:
            rests, least = resting(mechanism, qd), AT_REST * float(np.abs(qd).max(initial=0.0))
            touches = [x for x in touching(mechanism, q, qd) if abs(qd[x[0]]) <= least]
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
    starting: tuple[int, int] | None = None,
    t: float = 0.0,
) -> Standing:
    """The mode in which a state goes on under the torques tau (n) at t, and what stands still.

    The joints of `rests` stand still so far; `touches` are hard stops, joints and sides, at which
    joints stand still as well; `pushing` compliant ones that push, None: as the state tells.
    `starting` is a joint that is held no longer, and which way it starts.
    """
    sides: dict[int, list[int]] = {}
    for joint, side in touches:
        sides.setdefault(joint, []).append(side)
    still = sorted({*rests, *sides})
    slips = {j: int(math.copysign(1.0, qd[j])) for j, _ in mechanism.dry if j not in still}
    if pushing is None:
        pushing = pressed(mechanism, q.tolist(), qd.tolist())
    limits = {joint: bounds(mechanism, joint, sides.get(joint, ())) for joint in still}
    dry = dict(mechanism.dry)
    best: tuple[float, Standing] | None = None
    for starts in _choices(still, limits, starting):
        ways = slips | {j: way for j, way in starts.items() if j in dry}
        own = tuple(j for j in still if j not in starts)
        mode = Mode(own, tuple(sorted(ways.items())), pushing)
        missed = _missed(mechanism, mode, (q, qd, tau, t), limits, starts)
        if best is None or missed < best[0]:
            best = missed, Standing(_independent(mechanism, mode, q), own)
        if missed <= 0.0:
            break
    assert best is not None
    return best[1]


def _choices(
    still: Sequence[int], limits: dict[int, Bounds], starting: tuple[int, int] | None
) -> Iterator[dict[int, int]]:
    """Which joints start, and which way: few of them first."""
    begun = {} if starting is None else dict([starting])
    if len(still) > MOST:  # as it is, or one more starting: where more do, they follow at once
        yield begun
        for joint in still:
            yield from (begun | {joint: way} for way in limits[joint].ways)
        return
    ways = [(begun[j],) if j in begun else (0, *limits[j].ways) for j in still]
    for choice in sorted(product(*ways), key=lambda each: sum(map(abs, each))):
        yield {joint: way for joint, way in zip(still, choice, strict=True) if way}


def _missed(
    mechanism: Mechanism,
    mode: Mode,
    state: tuple[Array, Array, Array, float],
    limits: dict[int, Bounds],
    starts: dict[int, int],
) -> float:
    """By how much a choice contradicts itself, as a part of the forces; 0 where it does not.

    `state` is q, qd, tau (n each) and t.
    """
    q, _, tau, _ = state
    choice = _independent(mechanism, mode, q)
    moving = in_mode(mechanism, choice)
    solution = dynamics.forward_dynamics_and_forces(moving, *state)
    scale = float(np.abs(solution.qdd).max(initial=0.0))
    worst = max(
        (-way * float(solution.qdd[j]) / (scale or 1.0) for j, way in starts.items()), default=0.0
    )
    forces = held_forces(moving, solution.multipliers)
    lacks = -float(margins(mechanism, choice, mode.held, q[None], forces[None], limits).min())
    size = max(float(np.abs(forces).max(initial=0.0)), float(np.abs(tau).max(initial=0.0)))
    return max(worst - SLACK, lacks / (size or 1.0) - SLACK, 0.0)


def held_forces(moving: Mechanism, multipliers: Array) -> Array:
    """What holds each joint that a mode holds, (..., k), N m or N, by the multipliers (..., r)."""
    arms = [moving.rows[r].arm for r in moving.held]
    return np.asarray(multipliers[..., list(moving.held)] * np.array(arms))


def _independent(mechanism: Mechanism, mode: Mode, q: Array) -> Mode:
    """The mode with as many of its held joints as the closures let be held independently."""
    if not mechanism.rows or not mode.held:
        return mode
    kept: list[int] = []
    rank = _rank(mechanism, q, kept)
    for joint in mode.held:
        if (more := _rank(mechanism, q, [*kept, joint])) > rank:
            kept, rank = [*kept, joint], more
    return mode._replace(held=tuple(kept))


def _rank(mechanism: Mechanism, q: Array, held: Sequence[int]) -> int:
    rows = scaled_jacobian(in_mode(mechanism, Mode(tuple(held))), q)
    s = np.linalg.svd(rows, compute_uv=False)
    return int((s > TOGETHER * s[0]).sum()) if len(s) else 0


def margins(
    mechanism: Mechanism,
    mode: Mode,
    still: Sequence[int],
    q: Array,
    forces: Array,
    limits: Mapping[int, Bounds],
) -> Array:
    """How far what holds is from its bounds, (k, m) at q (k, n); below zero it does not hold.

    `forces` (k, held) hold the joints that the mode holds; the joints of `still` that it does not
    hold stand still with them, and help.  N m, or N.
    """
    helpers = [joint for joint in still if joint not in mode.held]
    if not mode.held:
        return np.full((len(q), 1), math.inf)
    low, high = (np.array([getattr(limits[j], x) for j in mode.held]) for x in ("low", "high"))
    if helpers:
        bounded = [limits[joint] for joint in helpers]
        shares = [_shares(mechanism, mode, helpers, each) for each in q]
        if len(mode.held) > 1:
            left = [_shared(x, low, high, s, bounded) for x, s in zip(forces, shares, strict=True)]
            return -np.array(left)[:, None]
        ends = np.array([[x.low, x.high] for x in bounded])
        pairs = np.array(shares) * ends  # (k, helpers, 2)
        low = low + pairs.min(axis=-1).sum(axis=-1, keepdims=True)
        high = high + pairs.max(axis=-1).sum(axis=-1, keepdims=True)
    return np.concatenate([forces - low, high - forces], axis=1)


def _shares(mechanism: Mechanism, mode: Mode, helpers: Sequence[int], q: Array) -> Array:
    """The rate of each helper as those of held joints are 1, (helpers, held)."""
    rows = scaled_jacobian(mechanism, q) / mechanism.arrays.units
    held = list(mode.held)
    others = [k for k in range(mechanism.n) if k not in mode.held]
    rates = -np.linalg.lstsq(rows[:, others], rows[:, held], rcond=TOGETHER)[0]
    return np.asarray(rates[[others.index(k) for k in helpers]])


def _shared(
    force: Array, low: Array, high: Array, shares: Array, bounded: Sequence[Bounds]
) -> float:
    """The same of one state where several joints are held: by a linear program."""
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
    return math.inf if found.fun is None else float(found.fun)
