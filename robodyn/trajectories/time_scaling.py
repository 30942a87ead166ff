"""Limits of a reference motion, and the shortest duration that keeps them.

A path q(u) followed in the time T has, with x = 1/T,

    qd = x q'(u)        qdd = x^2 q''(u)        tau = a(u) x^2 + b(u) x + g(u)

for open and closed mechanisms (Hollerbach, Dynamic scaling of manipulator trajectories, 1984).  So
rates and accelerations bound T directly, by the peaks of the path.  For torques, a, b and g follow
from inverse dynamics at three values of x, and each u has a least x > 0 at which |tau| reaches its
limit; the least of all bounds T. A slower motion keeps the limits too.  With Coulomb friction tau
is no such polynomial: then the three values of x are taken around the previous bound, starting from
a slow motion, until it converges.

A joint that starts from rest needs the torque of its static friction, however slow the motion.

Limits also hold between rows: extremes are searched between the samples that follow a path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.dynamics import inverse_dynamics
from robodyn.elements.contacts import NEAR
from robodyn.errors import InputError, RobodynError
from robodyn.loops.loop_rates import loop_accelerations
from robodyn.mechanics.actuation import for_each_actuated
from robodyn.mechanics.driven import refuse_driven
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import end_word
from robodyn.mechanics.motors import rate_limits, torque_limits
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr
from robodyn.trajectories.joint_paths import ACCELERATION, JointPath, Legs, Pieces, path_through
from robodyn.trajectories.joint_paths import profile as profile_of
from robodyn.trajectories.loop_path import Columns, Watch, WholePath, least_along
from robodyn.trajectories.reference import ReferenceMotion, all_joints, motion_along, whole_path

STILL = 1e-9  # part of a joint's largest rate that is none
BISECTIONS = 50  # of the interval in which a rate changes its sign
FIRST = 1e-300  # a rate that tells a direction, and no more
FALLS = 1e-100  # a rate beyond which friction has fallen from static, as it does at once
ROUNDING = 1e-12  # part of a limit by which it may be exceeded
UNITS = {"qd": ("rad/s", "m/s"), "qdd": ("rad/s^2", "m/s^2"), "tau": ("N m", "N")}


@dataclass(frozen=True, slots=True)
class Limits:
    """Largest absolute values of the actuated joints, (actuated,) each; None: no limit."""

    qd: Array | None = None  # rad/s
    qdd: Array | None = None  # rad/s^2
    tau: Array | None = None  # N m

    @property
    def given(self) -> list[tuple[str, Array]]:
        pairs = zip(UNITS, (self.qd, self.qdd, self.tau), strict=True)
        return [(name, values) for name, values in pairs if values is not None]


class LimitError(RobodynError):
    """A motion exceeds a limit, perhaps one `of_motor`; `quantity` is qd, qdd or tau.

    `place` is the index of the joint among the actuated ones.  `told` is the message, with {} for
    the limit.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        quantity: str,
        place: int,
        at: str,
        value: float,
        limit: float,
        told: str = "exceeds the limit of {}",
    ) -> None:
        motors = {"qd": rate_limits, "tau": torque_limits}
        own = motors[quantity](mechanism)[place] if quantity in motors else None
        self.quantity, self.of_motor = quantity, bool(limit == own)
        unit = UNITS[quantity][mechanism.actuated[place] in mechanism.slides]
        bound = f"{limit:.9g} {unit}" + self.of_motor * " of its motor"
        what = f"{limited_joint(mechanism, quantity, place)} at {at}"
        super().__init__(what, value=f"{value:.9g} {unit}", limit=told.format(bound))


def limits_of(
    mechanism: Mechanism,
    qd: ArrayLike | None = None,
    qdd: ArrayLike | None = None,
    tau: ArrayLike | None = None,
) -> Limits:
    """Return limits from one value for all actuated joints, or one each; InputError if not > 0."""
    found = {}
    for name, given in zip(UNITS, (qd, qdd, tau), strict=True):
        if given is not None:
            values = np.array(for_each_actuated(mechanism, given, f"max_{name}"))
            for wrong in values[~(np.isfinite(values) & (values > 0.0))]:
                raise InputError(f"max_{name}", value=f"{wrong:g}", limit="must be > 0 and finite")
            found[name] = values
    return Limits(**found)


def with_motors(mechanism: Mechanism, limits: Limits = Limits()) -> Limits:
    """Return the limits, reduced to those of the scene's motors."""

    def least(given: Array | None, own: list[float]) -> Array | None:
        if not np.isfinite(own).any():
            return given
        return np.array(own) if given is None else np.minimum(given, own)

    tau = least(limits.tau, torque_limits(mechanism))
    return Limits(least(limits.qd, rate_limits(mechanism)), limits.qdd, tau)


def limited_joint(mechanism: Mechanism, name: str, place: int) -> str:
    k = mechanism.actuated[place]
    return f"{name}{k + 1} ({mechanism.link_names[k]})"


def check_starts(motion: ReferenceMotion, limits: Limits) -> None:
    """Raise LimitError if static friction holds a joint against its largest torque.

    A joint starts from rest at the beginning, after a stop, and where it turns back.  Its torque
    must then overcome static friction and the other loads for zero acceleration of the joint.
    """
    mechanism, most, x = motion.mechanism, limits.tau, 1.0 / motion.duration
    rubbing, driven = set(mechanism.sticks), list(mechanism.actuated)
    if most is None or not rubbing:
        return
    u, piece = motion.path.grid()
    rates = motion.path.evaluate(u, piece)[1]
    fastest = np.abs(rates).max(axis=0)
    ways = np.where(np.abs(rates) > STILL * fastest, np.sign(rates), 0.0)
    for place, joint in enumerate(driven):
        starts = np.flatnonzero((ways[1:, joint] != 0.0) & (ways[1:, joint] != ways[:-1, joint]))
        felt = joint in rubbing or not rubbing <= set(driven)  # friction that loops bring here
        if not (felt and len(starts) and np.isfinite(most[place])):
            continue
        after, way = piece[starts + 1], ways[starts + 1]
        low, high = u[starts], u[starts + 1]
        high = np.where(ways[starts, joint] == 0.0, low, high)
        for _ in range(BISECTIONS if (high > low).any() else 0):
            middle = 0.5 * (low + high)
            past = motion.path.evaluate(middle, after)[1][:, joint] * way[:, joint] > 0.0
            low, high = np.where(past, low, middle), np.where(past, middle, high)
        t = motion.begin + high * motion.duration
        q, q1, q2 = motion.path.evaluate(high, after)
        still = np.abs(q1) <= STILL * fastest
        still[:, joint] = True
        qd, qdd = np.where(still, FIRST * way, x * q1), x * x * q2
        qdd[:, joint] = 0.0
        if mechanism.rows:
            qdd = loop_accelerations(mechanism, q, qd, qdd[:, driven], t)
        held = replace(mechanism, elements=tuple(x.gradual(FALLS) for x in mechanism.elements))
        tau = inverse_dynamics(held, q, qd, qdd, t)[:, joint]
        worst = int(np.argmax(way[:, joint] * tau))
        if way[worst, joint] * tau[worst] > (1.0 + ROUNDING) * most[place]:
            told = "starts it against its static friction, more than the limit of {}"
            at, limit = f"t = {t[worst]:.6g} s", float(most[place])
            raise LimitError(mechanism, "tau", place, at, float(tau[worst]), limit, told)


def check_ends(motion: ReferenceMotion) -> None:
    """Raise RobodynError for the joint that goes farthest beyond an end, if any does.

    Compliant stops yield, and are no ends.
    """
    mechanism = motion.mechanism
    ends = [
        (joint, side, end)
        for joint, ends in ((x.joint, x.ends) for x in mechanism.ranges if x.firm)
        for side, end in ends
    ]
    if not ends:
        return
    joints = [joint for joint, _, _ in ends]
    sides, places = (np.array(x, float) for x in list(zip(*ends, strict=True))[1:])

    def left(u: Array, piece: Pieces) -> Array:
        return np.asarray(sides * (places - motion.path.evaluate(u, piece)[0][:, joints]))

    least, u, piece, column = least_along(left, motion.path.grid())
    joint, side, end = ends[column]
    if least >= -NEAR * max(1.0, abs(end)):
        return
    q = float(motion.path.evaluate(np.array([u]), np.array([piece]))[0][0, joint])
    unit = "m" if joint in mechanism.slides else "rad"
    raise RobodynError(
        f"q{joint + 1} ({mechanism.link_names[joint]}) at t = "
        f"{motion.begin + u * motion.duration:.6g} s",
        value=f"{q:.9g} {unit}",
        limit=f"is beyond the joint's {end_word(side)}, {end:.9g} {unit}",
    )


MARGIN = 1e-9  # part by which a duration that torques bound is longer than what was found
MOST_FITS = 200  # of a, b and g, each about the x that the one before gave
SETTLED = 1e-11  # part of x by which the last two differ
CREEP = 1e-3  # part of a friction's speed at which it is still no more than a damper


@short_repr
@dataclass(frozen=True, slots=True)
class Shortest:
    """The shortest motion within limits, and which limit, joint and time determine it."""

    motion: ReferenceMotion
    bound: str


def check_limits(motion: ReferenceMotion, limits: Limits) -> None:
    """Raise LimitError for the value that exceeds its limit most, if any does."""
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
    """Return the shortest `reference_motion` that, like all slower ones, keeps the limits.

    Each limit is one value, or one per actuated joint; limits of the scene's motors hold too.
    `times` give proportions only.  A profile that stops at each point takes the shortest time for
    each leg, unless there are `times`.  Raises the errors of `reference_motion`, InputError if
    nothing bounds the duration, and LimitError if a torque is too large however slow the motion.
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
    """Return `shortest_motion` through points (K, n); passive joints may be NaN."""
    refuse_driven(mechanism, "a shortest time")
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
    """Return the shortest motion along a path; `points` as for `reference.motion_along`."""
    refuse_driven(mechanism, "a shortest time")
    if not path.scalable:
        raise InputError("duration", value="min", limit="a sweep is another path in another time")
    limits = with_motors(mechanism, limits)
    if not limits.given:
        raise InputError("duration", value="min", limit="needs a limit: a largest qd, qdd or tau")
    return shortest_of(whole_path(mechanism, path, points, watch), limits, begin)


def shortest_of(
    whole: WholePath, limits: Limits, begin: float = 0.0, least: tuple[float, str] = (0.0, "")
) -> Shortest:
    """Return the shortest motion along the path of all joints.

    `least` is a lower bound of the duration, and its reason.
    """
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
    mechanism.check_rubbing("shortest times by torque limits")

    def parts(u: Array, piece: Pieces, scale: float) -> tuple[Array, Array, Array]:
        """Return a, b, g (T, actuated) of tau = a x^2 + b x + g.

        They come from x = 1/2, 1 and 3/2 times `scale`.
        """
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
        """Return a function that gives the least x > 0 at a limit, (T, 2 actuated).

        Columns are for +tau, then for -tau.
        """

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
    """Return the x at which the path's largest acceleration or rate is about 1.

    It is smaller if friction must be entered slowly.
    """
    _, q1, q2 = whole.evaluate(*whole.grid())
    fastest = max(float(np.abs(q1).max()), math.sqrt(float(np.abs(q2).max())))
    for joint, speed in _friction_speeds(mechanism):
        fastest = max(fastest, float(np.abs(q1[:, joint]).max()) / (CREEP * speed))
    return 1.0 / fastest if fastest > 0.0 else 1.0


def _friction_speeds(mechanism: Mechanism) -> list[tuple[int, float]]:
    """Return joints with a force that bends with the rate, and the rate at which it does."""
    bending = ((x.at, x.bend_rate) for x in mechanism.elements)
    return [(k, rate) for k, rate in bending if k is not None and rate is not None]
