"""Limits of speeds, accelerations and torques, asked for or of motors; and the ends of joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.dynamics import inverse_dynamics
from robodyn.elements.joints import DryFriction
from robodyn.errors import InputError, RobodynError
from robodyn.loops.loop_rates import loop_accelerations
from robodyn.mechanics.actuation import for_each_actuated
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import NEAR, end_word
from robodyn.mechanics.motors import rate_limits, torque_limits
from robodyn.tables.arrays import Array
from robodyn.trajectories.joint_paths import Pieces
from robodyn.trajectories.loop_path import least_along
from robodyn.trajectories.reference import ReferenceMotion

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

    `place` is that of the joint among the actuated ones; `told` says what is wrong, {} the limit.
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
    """Limits from one value for all actuated joints, or one for each; InputError if not > 0."""
    found = {}
    for name, given in zip(UNITS, (qd, qdd, tau), strict=True):
        if given is not None:
            values = np.array(for_each_actuated(mechanism, given, f"max_{name}"))
            for wrong in values[~(np.isfinite(values) & (values > 0.0))]:
                raise InputError(f"max_{name}", value=f"{wrong:g}", limit="must be > 0 and finite")
            found[name] = values
    return Limits(**found)


def with_motors(mechanism: Mechanism, limits: Limits = Limits()) -> Limits:
    """The limits, or those of the motors of the scene where these are smaller."""

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
    """Raise LimitError for a joint that static friction holds against the largest torque.

    A joint starts from rest where the motion begins, after a stop, and where it turns back. Its
    torque must reach there what static friction holds and what acts on the joint without an
    acceleration of its own.
    """
    mechanism, most, x = motion.mechanism, limits.tau, 1.0 / motion.duration
    dry, driven = mechanism.dry, list(mechanism.actuated)
    rubbing = {k for k, _ in dry}
    if most is None or not dry:
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
        q, q1, q2 = motion.path.evaluate(high, after)
        still = np.abs(q1) <= STILL * fastest
        still[:, joint] = True
        qd, qdd = np.where(still, FIRST * way, x * q1), x * x * q2
        qdd[:, joint] = 0.0
        if mechanism.rows:
            qdd = loop_accelerations(mechanism, q, qd, qdd[:, driven])
        falls = [friction._replace(stribeck=friction.stribeck or FALLS) for _, friction in dry]
        held = mechanism.exchanged({DryFriction: falls})
        t = motion.begin + high * motion.duration
        tau = inverse_dynamics(held, q, qd, qdd, t)[:, joint]
        worst = int(np.argmax(way[:, joint] * tau))
        if way[worst, joint] * tau[worst] > (1.0 + ROUNDING) * most[place]:
            told = "starts it against its static friction, more than the limit of {}"
            at, limit = f"t = {t[worst]:.6g} s", float(most[place])
            raise LimitError(mechanism, "tau", place, at, float(tau[worst]), limit, told)


def check_ends(motion: ReferenceMotion) -> None:
    """Raise RobodynError, for the joint that goes farthest beyond an end, if one does anywhere.

    Compliant stops give way, and are none.
    """
    mechanism = motion.mechanism
    ends = [
        (joint, side, end)
        for joint, stop in mechanism.limits
        for side, end in (stop.ends if stop.stiffness is None else [])
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
