"""Whether a reference motion stays within the ends of joints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import RobodynError
from robodyn.mechanics.modes import NEAR, end_word
from robodyn.trajectories.joint_paths import Pieces
from robodyn.trajectories.reference import ReferenceMotion
from robodyn.trajectories.time_scaling import least_along

Array = NDArray[np.float64]


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

    least, u, piece, column = least_along(left, motion.path)
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
