"""A natural mode as a motion to look at."""

from __future__ import annotations

import numpy as np

from robodyn.errors import AssemblyError, InputError, RobodynError
from robodyn.loops.closing import close_positions
from robodyn.loops.loop_rates import check_closed
from robodyn.mechanics.mechanism import Mechanism
from robodyn.rest.linear_model import LinearModel
from robodyn.tables.arrays import Array

VISIBLE = 0.3  # rad, or lengths, that the joint which moves most goes each way
SMALLEST = 1e-3  # of these, where loops do not close farther out
ROWS = 64  # a period


def mode_motion(
    mechanism: Mechanism, model: LinearModel, mode: int, seconds: float
) -> tuple[Array, Array]:
    """Times (T,), s, and closed poses (T, n) of one mode, counted from 1, without its damping.

    Whole periods 1/frequency, as many as `seconds` take; a mode that does not swing has one of 1 s.
    Raises RobodynError away from rest and where loops close nowhere near, InputError for a mode
    that is not there.
    """
    if model.modes is None:
        raise RobodynError("no modes", where=mechanism.source, limit=model.remark)
    if not 1 <= mode <= len(model.modes):
        raise InputError("mode", value=mode, limit=f"there are modes 1 to {len(model.modes)}")
    chosen = model.modes[mode - 1]
    period = 1.0 / chosen.frequency if chosen.eigenvalue.imag else 1.0
    periods = max(1, int(np.ceil(seconds / period)))
    turns = np.arange(ROWS * periods + 1) / ROWS
    way = (np.exp(2j * np.pi * turns)[:, None] * (model.N @ chosen.shape)).imag
    size = VISIBLE / np.abs(way / mechanism.arrays.units).max()
    part = 1.0
    while part > SMALLEST:
        q = close_positions(mechanism, model.q + part * size * way)
        if check_closed(mechanism, q) is None:
            return turns * period, q
        part /= 2.0
    raise AssemblyError("the mode's poses do not close", where=mechanism.source)
