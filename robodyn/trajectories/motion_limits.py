"""Limits of speeds, accelerations and torques: those asked for, and those of motors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.actuation import for_each_actuated
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.motors import rate_limits, torque_limits

Array = NDArray[np.float64]

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
    """A motion exceeds a limit, perhaps one `of_motor`; `quantity` is qd, qdd or tau."""

    def __init__(
        self,
        what: str,
        quantity: str,
        *,
        value: object = None,
        limit: str = "",
        of_motor: bool = False,
    ) -> None:
        self.quantity, self.of_motor = quantity, of_motor
        super().__init__(what, value=value, limit=limit)


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


def is_of_motor(mechanism: Mechanism, name: str, place: int, bound: float) -> bool:
    """Whether a limit of an actuated joint is that of its motor."""
    motors = {"qd": rate_limits, "tau": torque_limits}
    return name in motors and bool(bound == motors[name](mechanism)[place])


def limit_unit(mechanism: Mechanism, name: str, place: int) -> str:
    """That of a limit of an actuated joint, by its place among them."""
    return UNITS[name][mechanism.actuated[place] in mechanism.slides]


def limited_joint(mechanism: Mechanism, name: str, joint: int) -> str:
    k = mechanism.actuated[joint]
    return f"{name}{k + 1} ({mechanism.link_names[k]})"
