"""What the motors of a scene do at many states at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.placed import n_wide
from robodyn.mechanics.motors import motor_columns, motor_values
from robodyn.mechanics.planar_model import Mechanism


def motor_loads(
    mechanism: Mechanism, tau: ArrayLike, qd: ArrayLike
) -> dict[str, NDArray[np.float64]]:
    """Torque N m, speed rad/s, voltage V, current A and power W of motors, by columns' names.

    Each is (...), of joint torques and rates (..., n), which broadcast.  There are those of the
    actuated joints: `motor1`, `motor_speed1`, and `volt1`, `amp1`, `watt1` of a motor with its
    constants.  Raises InputError for arrays that are not n wide.
    """
    given = [n_wide(mechanism, name, x) for name, x in (("tau", tau), ("qd", qd))]
    torques, rates = (list(np.moveaxis(x, -1, 0)) for x in np.broadcast_arrays(*given))
    return dict(zip(motor_columns(mechanism), motor_values(mechanism, torques, rates), strict=True))
