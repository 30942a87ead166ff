"""How far each actuated joint can move from a pose, with the other actuated joints held."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from robodyn.elements.joints import Range
from robodyn.errors import AssemblyError, SingularError
from robodyn.loops.assembly import assemble
from robodyn.loops.closing import loop_size
from robodyn.loops.closures import closure_gap, scaled_jacobian
from robodyn.mechanics.driven import refuse_driven
from robodyn.mechanics.mechanism import Mechanism
from robodyn.rest.balance import bend
from robodyn.tables.arrays import Array
from robodyn.trajectories.joint_paths import ConstantSpeed
from robodyn.trajectories.loop_path import LoopPath, PathEndError, WholePath

FARTHEST = 4.0  # sides of all loops, beyond which nothing ends a displacement
BESIDE = 1e-3  # rad, or lengths, from the last state that could be closed to where a joint turns
FAR = 0.1  # rad, or lengths: a longer step of Newton's method leads to no end beside a state
PASSES = 30  # of Newton's method
SETTLED = 1e-13  # rad, or lengths: the last of its steps
CROSSING = 1e-7  # least singular value of Psi, as part of the loops' size, of a change point
NUDGE = 1e-6  # rad, or of a length of the mechanism, aside of a dead centre at the start
SHORT = 1e-9  # part of a way by which one that ends is cut, to be followed again


class JointRange(NamedTuple):
    """The least and largest q of a joint (rad or m), and what ends the range on each side.

    That is `full turn`, `dead centre`, `change point`, `limit of q2`, or `nothing`: the search went
    as far as q.
    """

    joint: int
    low: float
    high: float
    low_end: str
    high_end: str


def joint_ranges(
    mechanism: Mechanism, q: Array, branches: Sequence[str] | None = None
) -> list[JointRange]:
    """Return the range of each actuated joint from the closed configuration q (n,).

    It stays on the branch of q.  At a dead centre, where branches meet, `branches` select one (see
    `assembly.assemble`).  A joint without ends has the range of a full turn about q.  Compliant
    stops yield, and are no ends.
    """
    refuse_driven(mechanism, "a range of joints")
    found = []
    for place, joint in enumerate(mechanism.actuated):
        (low, low_end), (high, high_end) = (
            _way(mechanism, q, place, way, branches) for way in (-1.0, 1.0)
        )
        if low_end == high_end == "full turn":
            low, high = q[joint] - np.pi, q[joint] + np.pi
        found.append(JointRange(joint, low, high, low_end, high_end))
    return found


def _way(
    mechanism: Mechanism, q: Array, place: int, sign: float, branches: Sequence[str] | None
) -> tuple[float, str]:
    """Return how far an actuated joint can move in one direction, and what ends it."""
    joint, moved = mechanism.actuated[place], list(mechanism.actuated)
    if not mechanism.rows:  # no other joint follows
        place, moved = joint, list(range(mechanism.n))

    def path(ahead: Array) -> WholePath:
        way = ConstantSpeed(q[moved], ahead)
        return LoopPath(mechanism, way, q) if mechanism.rows else WholePath(mechanism, way)

    slides = joint in mechanism.slides
    ended, ahead = "nothing" if slides else "full turn", np.zeros(len(moved))
    sides = sum(row.size for row in mechanism.rows) + mechanism.unit
    ahead[place] = sign * (FARTHEST * sides if slides else 2.0 * np.pi)
    try:
        followed = path(ahead)
    except PathEndError as error:
        if not error.u and branches is not None:
            beside = q[moved]
            beside[place] += sign * NUDGE * mechanism.arrays.units[joint]
            with suppress(AssemblyError, SingularError):  # it ends there
                return _way(
                    mechanism, assemble(mechanism, beside, branches, t=0.0), place, sign, None
                )
        ended, ahead = error.kind, ahead * error.u
        if error.u and (fold := _fold(mechanism, error.q, joint)) is not None:
            ended = "dead centre"
            ahead[place] += fold - error.q[joint]
        if not (mechanism.ranges and error.u > SHORT):
            return float(q[joint] + ahead[place]), ended
        followed = path(ahead * (1.0 - SHORT))
    for limit in (x for x in mechanism.ranges if x.firm):
        k = limit.joint
        for side, end in limit.ends:
            u = _first_beyond(followed, k, side, end + _turns(q, k, limit, mechanism))
            if u is not None:
                ended, ahead = f"limit of q{k + 1}", ahead * u
                if u == 0.0:
                    return float(q[joint]), ended
                followed = path(ahead)
    return float(q[joint] + ahead[place]), ended


def _fold(mechanism: Mechanism, q: Array, joint: int) -> float | None:
    """Return the value at which a joint turns back near the closed state q (n,); None if nowhere.

    There Psi_p v = 0 for rates v of the passive joints p, and the gap is zero; Newton's method
    solves both for q and v.  At a change point it has no regular solution.
    """
    passive, units = list(mechanism.passive), mechanism.arrays.units
    if len(passive) != len(mechanism.rows):
        return None
    p, moved = len(passive), [*passive, joint]
    start, q, size = q[joint], q.copy(), loop_size(mechanism)
    first = np.linalg.svd(scaled_jacobian(mechanism, q, 0.0)[:, passive])[2][-1]
    v = first.copy()
    for _ in range(PASSES):
        Psi, u = scaled_jacobian(mechanism, q, 0.0), np.zeros(mechanism.n)
        u[passive] = v * units[passive]
        bent = bend(mechanism, q, u, np.diag(units)[moved]).T
        system = np.zeros((2 * p + 1, 2 * p + 1))
        system[:p, : p + 1], system[p : 2 * p, : p + 1] = Psi[:, moved], bent
        system[p : 2 * p, p + 1 :], system[-1, p + 1 :] = Psi[:, passive], first
        left = [*closure_gap(mechanism, q, 0.0), *(Psi[:, passive] @ v), first @ v - 1.0]
        try:
            step = np.linalg.solve(system, -np.array(left))
        except np.linalg.LinAlgError:
            return None
        if not np.abs(step).max() < FAR:
            return None
        q[moved] += step[: p + 1] * units[moved]
        v = v + step[p + 1 :]
        if np.abs(step[: p + 1]).max() <= SETTLED:
            least = np.linalg.svd(scaled_jacobian(mechanism, q, 0.0), compute_uv=False)[-1]
            turned = abs(q[joint] - start) <= BESIDE * units[joint] and least > CROSSING * size
            return float(q[joint]) if turned else None
    return None


def _turns(q: Array, joint: int, limit: Range, mechanism: Mechanism) -> float:
    """Return the full turns (rad) between a joint's value and the middle of its limits."""
    if joint in mechanism.slides or limit.low is None or limit.high is None:
        return 0.0
    return math.tau * round(float(q[joint] - 0.5 * (limit.low + limit.high)) / math.tau)


def _first_beyond(path: WholePath, joint: int, side: int, end: float) -> float | None:
    """Return the first u of a path at which a joint passes an end; None if never."""

    def past(u: Array) -> Array:
        return np.asarray(side * (path.evaluate(u)[0][:, joint] - end))

    u = path.grid()[0]
    after = np.flatnonzero(past(u) > 0.0)
    if not after.size:
        return None
    if not after[0]:
        return float(u[0])
    low, high = u[after[0] - 1], u[after[0]]
    while high - low > 4 * math.ulp(high):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if past(np.array([middle]))[0] > 0.0 else (middle, high)
    return float(low)
