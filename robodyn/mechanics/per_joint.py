"""Arguments that are one value for all actuated joints, or one for each."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from robodyn.errors import InputError
from robodyn.mechanics.planar_model import Mechanism


def for_each_actuated(mechanism: Mechanism, given: ArrayLike, name: str) -> list[float]:
    """One value for each actuated joint; InputError, naming the argument, for another number."""
    count = len(mechanism.actuated)
    values = np.atleast_1d(np.asarray(given, float))
    if values.shape not in ((1,), (count,)):
        joints = ", ".join(mechanism.link_names[k] for k in mechanism.actuated)
        limit = f"needs 1 value, or {count}, one an actuated joint ({joints})"
        shown = "1 value" if values.size == 1 else f"{values.size} values"
        raise InputError(name, value=shown, limit=limit)
    each: list[float] = np.broadcast_to(values, count).tolist()
    return each
