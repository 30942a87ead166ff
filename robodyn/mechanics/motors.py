"""What motors do at their joints: torque, speed, voltage, current and power, and their limits.

With the ratio N, the torque constant kt and the resistance R, a motor that gives its joint tau has
the torque tau/N and the speed N qd (its gear is ideal), and

    amp = (tau/N)/kt      volt = R amp + kt N qd      watt = volt amp
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Motor


def motors_at(mechanism: Mechanism, joints: Iterable[int]) -> Iterator[tuple[int, Motor]]:
    """Return those of the joints that have motors, each with its motor."""
    links = mechanism.description.links
    return ((k, motor) for k in joints if (motor := links[k].motor) is not None)


def drives(mechanism: Mechanism) -> dict[int, int]:
    """The joints that laws of the time drive and no torque does: the coupling of each."""
    couplings = enumerate(mechanism.description.couplings)
    return {x.joint: c for c, x in couplings if x.timed and x.joint not in mechanism.actuated}


def powered_joints(mechanism: Mechanism) -> list[int]:
    """The joints whose motors work: the actuated ones, and those that a law of the time drives."""
    return sorted([*mechanism.actuated, *drives(mechanism)])


def motor_values(
    mechanism: Mechanism, joints: Iterable[int], tau: Sequence[Any], qd: Sequence[Any]
) -> list[list[Any]]:
    """Torque N m, speed rad/s, voltage V, current A and power W, each with a value a motor.

    tau and qd hold a value for each joint: a float, or an array.  tau of a driven joint is what its
    law puts on it.  Values are those of the motors at `joints`.
    """
    torques, speeds, volts, amps = [], [], [], []
    for k, motor in motors_at(mechanism, joints):
        torques.append(tau[k] / motor.ratio + 0.0)  # no -0.0
        speeds.append(motor.ratio * qd[k] + 0.0)
        if motor.torque_constant and motor.resistance:
            amps.append(torques[-1] / motor.torque_constant)
            volts.append(motor.resistance * amps[-1] + motor.torque_constant * speeds[-1])
    watts = [volt * amp + 0.0 for volt, amp in zip(volts, amps, strict=True)]
    return [torques, speeds, volts, amps, watts]


def torque_limits(mechanism: Mechanism) -> list[float]:
    """Return the largest torques of motors on the actuated joints, N m; infinite if unlimited."""
    return _limits(mechanism, lambda x: x.torque_max and x.torque_max * abs(x.ratio))


def rate_limits(mechanism: Mechanism) -> list[float]:
    """Return the largest rates of motors on the actuated joints, rad/s; infinite if unlimited."""
    return _limits(mechanism, lambda x: x.speed_max and x.speed_max / abs(x.ratio))


def _limits(mechanism: Mechanism, limit: Callable[[Motor], float | None]) -> list[float]:
    found = {k: limit(motor) for k, motor in motors_at(mechanism, mechanism.actuated)}
    return [found.get(k) or math.inf for k in mechanism.actuated]
