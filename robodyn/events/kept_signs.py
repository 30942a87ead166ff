"""The sign that an event's function keeps along each of many steps, as far as a look at all tells.

Three looks, from the cheapest on: by boxes that the states stay in, by states at Chebyshev's points
of each step, and, of explicit methods, by what a step's stages tell.  None of them finds where a
function passes zero; a sign of 0 says that it may.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.events.explicit_steps import two_guesses
from robodyn.events.functions import EventFunction
from robodyn.events.signs import certain, node_times
from robodyn.events.single_zeros import MARGIN
from robodyn.tables.arrays import Array

Signs = NDArray[np.int64]


def by_boxes(function: EventFunction, *box: Array) -> Signs:
    """The signs (m,) along m steps from begin (m,) to end, the states within dy (m, N) of y."""
    found: Signs | None = None
    for part in (*function.switches, function):
        if part.around is None:
            return np.zeros(len(box[0]), np.int64)
        value, reach = part.around(*box)
        signs = np.subtract(value > reach, value < -reach, dtype=np.int64)
        found = signs if found is None else signs * np.abs(found)
    assert found is not None
    return found


def by_stages(functions: Sequence[EventFunction], steps: Sequence[Any]) -> list[Signs]:
    """The signs (m,) of each function along m steps of an explicit method."""
    both, m = two_guesses(steps), len(steps)
    begin = np.array([step.t_old for step in steps])
    at = node_times(begin, begin + np.array([step.h_previous for step in steps]))
    at, y = np.concatenate([at, at]), both.reshape(-1, both.shape[-1])
    found = []
    for function in functions:
        known = np.ones(m, np.int64)
        with np.errstate(all="ignore"):
            for part in (*function.switches, function):
                better, worse = part.values(at, y).reshape(2, m, -1)
                noise = np.abs(better - worse).max(axis=1)
                noise += MARGIN * np.abs(better).max(axis=1)
                known = np.where(known, certain(better, noise), 0)
        found.append(known)
    return found
