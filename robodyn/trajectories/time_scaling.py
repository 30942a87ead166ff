"""Limits of a reference motion, and the shortest duration that keeps them.

A path q(u) run through in the time T has, with x = 1/T,

    qd = x q'(u)        qdd = x^2 q''(u)        tau = a(u) x^2 + b(u) x + g(u)

for open and for closed mechanisms (Hollerbach, Dynamic scaling of manipulator trajectories, 1984).
So rates and accelerations bound T directly, by the peaks of the path.  For torques, a, b and g
follow from inverse dynamics at three values of x, and each u has the least x > 0 at which |tau|
reaches its limit; the least of all these bounds T.  A slower motion keeps the limits too.  Coulomb
friction is no such polynomial: with it the three values of x are taken about the bound that the
ones before gave, from a slow motion on, until it stays.

A joint that starts from rest needs what its static friction holds, however slow the motion.

Limits hold between the rows too: extremes are found between the samples that follow a path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.dynamics import inverse_dynamics
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr
from robodyn.trajectories.continuation import Watch
from robodyn.trajectories.joint_paths import JointPath, Legs, Pieces, path_through
from robodyn.trajectories.loop_path import Columns, WholePath, least_along
from robodyn.trajectories.motion_limits import (
    ROUNDING,
    LimitError,
    Limits,
    check_starts,
    limited_joint,
    limits_of,
    with_motors,
)
from robodyn.trajectories.profiles import ACCELERATION
from robodyn.trajectories.profiles import profile as profile_of
from robodyn.trajectories.reference import ReferenceMotion, all_joints, motion_along, whole_path

MARGIN = 1e-9  # part by which a duration that torques bound is longer than what was found
MOST_FITS = 200  # of a, b and g, each about the x that the one before gave
SETTLED = 1e-11  # part of x by which the last two differ
CREEP = 1e-3  # part of a friction's speed at which it is still no more than a damper


@short_repr
@dataclass(frozen=True, slots=True)
class Shortest:
    """The shortest motion within limits, and which limit bounds it (of which joint, at which t)."""

    motion: ReferenceMotion
    bound: str


def check_limits(motion: ReferenceMotion, limits: Limits) -> None:
    """Raise LimitError, for the value that exceeds its limit most, if one does anywhere."""
    if not limits.given:
        return
    mechanism, T = motion.mechanism, motion.duration
    driven = list(mechanism.actuated)

    def values(u: Array, piece: Pieces) -> Array:
        q, q1, q2 = motion.path.evaluate(u, piece)
        known = {"qd": q1[:, driven] / T, "qdd": q2[:, driven] / T**2}
        if limits.tau is not None:
            now = motion.begin + u * T
            known["tau"] = inverse_dynamics(mechanism, q, q1 / T, q2 / T**2, now)[:, driven]
        return np.concatenate([known[name] for name, _ in limits.given], axis=1)

    bounds = np.concatenate([bound for _, bound in limits.given])
    least, u, piece, column = least_along(
        lambda u, of: -np.abs(values(u, of)) / bounds, motion.path.grid()
    )
    if -least <= 1.0 + ROUNDING:
        check_starts(motion, limits)
        return
    place, joint = divmod(column, len(driven))
    name, bound = limits.given[place]
    value = float(values(np.array([u]), np.array([piece]))[0, column])
    at = f"t = {motion.begin + u * T:.6g} s"
    raise LimitError(mechanism, name, joint, at, value, float(bound[joint]))


def shortest_motion(
    mechanism: Mechanism,
    points: ArrayLike,
    *,
    max_qd: ArrayLike | None = None,
    max_qdd: ArrayLike | None = None,
    max_tau: ArrayLike | None = None,
    times: ArrayLike | None = None,
    profile: str = "quintic",
    acceleration: float = ACCELERATION,
    natural: bool = False,
) -> ReferenceMotion:
    """The shortest `reference_motion` of which no slower one exceeds a limit either.

    Each limit is one value, or one an actuated joint; those of the scene's motors hold too.
    `times` give proportions only.  A profile that stops at each point takes the shortest time for
    each leg, unless there are `times`.  Raises what `reference_motion` does, InputError where
    nothing bounds the duration, and LimitError where a torque is too large however slow the motion.
    """
    full = all_joints(mechanism, points)
    limits = limits_of(mechanism, max_qd, max_qdd, max_tau)
    return shortest_through(mechanism, full, limits, times, profile, acceleration, natural).motion


def shortest_through(
    mechanism: Mechanism,
    points: Array,
    limits: Limits,
    times: ArrayLike | None,
    profile: str,
    acceleration: float,
    natural: bool,
    watch: Watch = lambda u: None,
) -> Shortest:
    """`shortest_motion` through points (K, n), of which passive angles may be NaN."""
    driven = points[:, list(mechanism.actuated)]
    path = path_through(driven, times, profile, acceleration, natural)
    begin = 0.0 if times is None else float(np.asarray(times, float)[0])
    if times is not None or not isinstance(path, Legs) or len(points) == 2:
        return shortest_along(mechanism, path, points, limits, begin, watch)
    whole = whole_path(mechanism, path, points, watch)
    durations: list[float] = []
    bounds: list[str] = []
    for k in range(len(points) - 1):
        leg = Legs(driven[k : k + 2], np.array([0.0, 1.0]), profile_of(profile, acceleration))
        ends = points[k : k + 2].copy()
        if mechanism.passive:
            ends[0] = whole.evaluate(path.knots[k : k + 1])[0][0]
        found = shortest_along(mechanism, leg, ends, limits, begin + sum(durations))
        durations.append(found.motion.duration)
        bounds.append(f"leg {k + 1}: {found.bound}")
    stamps = np.concatenate([[0.0], np.cumsum(durations)])
    path = path_through(driven, stamps, profile, acceleration)
    motion = motion_along(mechanism, path, points, float(stamps[-1]), begin)
    return Shortest(motion, "; ".join(bounds))


def shortest_along(
    mechanism: Mechanism,
    path: JointPath,
    points: Array,
    limits: Limits,
    begin: float = 0.0,
    watch: Watch = lambda u: None,
) -> Shortest:
    """The shortest motion along a path; `points` as for `reference.motion_along`."""
    if not path.scalable:
        raise InputError("duration", value="min", limit="a sweep is another path in another time")
    limits = with_motors(mechanism, limits)
    if not limits.given:
        raise InputError("duration", value="min", limit="needs a limit: a largest qd, qdd or tau")
    return shortest_of(whole_path(mechanism, path, points, watch), limits, begin)


def shortest_of(
    whole: WholePath, limits: Limits, begin: float = 0.0, least: tuple[float, str] = (0.0, "")
) -> Shortest:
    """The shortest motion along the path of all joints; `least`: a duration, what bounds it."""
    mechanism, found = whole.mechanism, [least]
    rates, accelerations = whole.peaks()
    for name, most in limits.given:
        if name == "tau":
            found.append(_shortest_by_torque(mechanism, whole, most, begin))
        else:
            each = rates / most if name == "qd" else np.sqrt(accelerations / most)
            joint = int(np.argmax(each))
            found.append((float(each[joint]), limited_joint(mechanism, name, joint)))
    duration, bound = max(found)
    if not (math.isfinite(duration) and duration > 0.0 and rates.any()):
        limit = "is not bounded: nothing moves, or no limit is reached however fast"
        raise InputError("duration", value="min", limit=limit)
    motion = ReferenceMotion(mechanism, whole, duration, begin)
    check_starts(motion, limits)
    return Shortest(motion, bound)


def _shortest_by_torque(
    mechanism: Mechanism, whole: WholePath, limit: Array, begin: float
) -> tuple[float, str]:
    bounded = np.flatnonzero(np.isfinite(limit)).tolist()  # places among the actuated joints
    driven, limit = [mechanism.actuated[j] for j in bounded], limit[bounded]
    if mechanism.timed:
        reason = "has loads that depend on the time: give the time of the motion"
        raise InputError("duration", where=mechanism.source, value="min", limit=reason)

    def parts(u: Array, piece: Pieces, scale: float) -> tuple[Array, Array, Array]:
        """a, b, g (T, actuated) of tau = a x^2 + b x + g, from x = 1/2, 1 and 3/2 times scale."""
        q, q1, q2 = whole.evaluate(u, piece)
        one, two, three = (
            inverse_dynamics(mechanism, q, x * q1, x * x * q2)[:, driven]
            for x in (0.5 * scale, scale, 1.5 * scale)
        )
        second, first = one - 2 * two + three, two - one
        a = 2 * second / scale**2
        b = (2 * first - 3 * second) / scale
        return a, b, one - 0.5 * b * scale - 0.25 * a * scale**2

    def reached(scale: float) -> Columns:
        """The least x > 0 at which +tau and -tau reach their limits, (T, 2 actuated)."""

        def least_x(u: Array, piece: Pieces) -> Array:
            a, b, g = (np.concatenate([v, -v], axis=1) for v in parts(u, piece, scale))
            c = np.minimum(g - np.tile(limit, 2), 0.0)
            root = b * b - 4 * a * c
            below = b + np.sqrt(np.maximum(root, 0.0))
            open_ = (root < 0.0) | (below <= 0.0)
            return np.where(open_, np.inf, -2 * c / np.where(open_, 1.0, below))

        return least_x

    scale, grid = _natural_scale(mechanism, whole), whole.grid()
    slow, *place, joint = least_along(lambda u, of: -np.abs(parts(u, of, scale)[2]) / limit, grid)
    if -slow >= 1.0:
        there, of = (np.array([x]) for x in place)
        value = float(parts(there, of, scale)[2][0, joint])
        at = ", ".join(f"{x:.6g}" for x in whole.evaluate(there, of)[0][0])
        told = "holding this pose takes that, more than the limit of {}, however slow the motion"
        most = float(limit[joint])
        raise LimitError(mechanism, "tau", bounded[joint], f"q = {at}", value, most, told)
    x, column = scale, 0
    for _ in range(MOST_FITS):
        before = x
        x, u, _, column = least_along(reached(before), grid)
        if mechanism.rated or _friction_speeds(mechanism):
            # beyond that the parabola is not its torque
            x = min(max(x, 0.5 * before), 2.0 * before)
        if abs(x - before) <= SETTLED * x or math.isinf(x):
            break
    duration = (1.0 + MARGIN) / x
    at = f" at t = {begin + u * duration:.6g} s"
    return duration, limited_joint(mechanism, "tau", bounded[column % len(driven)]) + at


def _natural_scale(mechanism: Mechanism, whole: WholePath) -> float:
    """x that makes the fastest acceleration or rate of the path about 1; low in any friction."""
    _, q1, q2 = whole.evaluate(*whole.grid())
    fastest = max(float(np.abs(q1).max()), math.sqrt(float(np.abs(q2).max())))
    for joint, speed in _friction_speeds(mechanism):
        fastest = max(fastest, float(np.abs(q1[:, joint]).max()) / (CREEP * speed))
    return 1.0 / fastest if fastest > 0.0 else 1.0


def _friction_speeds(mechanism: Mechanism) -> list[tuple[int, float]]:
    """The joints whose friction changes with the rate, and about which rate it does."""
    smooth = [(joint, friction.speed) for joint, friction in mechanism.friction]
    falling = [(joint, friction.stribeck) for joint, friction in mechanism.dry]
    return smooth + [(joint, speed) for joint, speed in falling if speed is not None]
