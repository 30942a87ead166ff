"""The poses of a motion at the times of an animation's frames."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robodyn.control.tracking import ReferenceTable
from robodyn.errors import InputError
from robodyn.loops.closing import close_positions
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

MOST_FRAMES = 20_000
FINER = 4  # points of a trace from frame to frame


class Frames(NamedTuple):
    """Times of the motion (T,), s, the closed configurations there (T, n), and frames a second.

    `fine` (FINER (T - 1) + 1, n) are those and configurations between them, for smooth traces.
    """

    t: Array
    q: Array
    rate: float
    fine: Array


def frames(
    mechanism: Mechanism, t: Array, q: Array, qd: Array | None, rate: float, speed: float
) -> Frames:
    """The motion of the rows t (R,), q and qd (R, n) at `rate` frames a second of watching.

    `speed` seconds of the motion pass in one of watching.  Between rows q is a cubic where qd is
    given, else linear, and is closed again.  Rows that run backwards are shown forwards.  Raises
    InputError where the times do not rise or fall throughout, and for too many frames.
    """
    if len(t) < 2:
        raise InputError("rows", value=len(t), limit="a motion needs two or more")
    if t[-1] < t[0]:
        t, q, qd = t[::-1], q[::-1], None if qd is None else qd[::-1]
    steps = np.diff(t)
    if not (steps > 0.0).all():
        row = int(np.argmax(steps <= 0.0))
        limit = f"must differ from {t[row]:.9g} before it, and all must rise, or all fall"
        raise InputError("t", value=f"{t[row + 1]:.9g}", limit=limit)
    count = (t[-1] - t[0]) / speed * rate
    if not count < MOST_FRAMES:
        raise InputError("frames", value=f"{count:.6g}", limit=f"must be at most {MOST_FRAMES}")
    shown = int(count + 1e-9) + 1
    times = t[0] + np.arange(FINER * (shown - 1) + 1) * (speed / rate / FINER)
    inside = np.minimum(times, t[-1])
    if qd is None:
        between = np.stack([np.interp(inside, t, angle) for angle in q.T], axis=-1)
    else:
        between = ReferenceTable(t, q, qd).at(inside)[0]
    fine = close_positions(mechanism, between)
    return Frames(times[::FINER], fine[::FINER], rate, fine)


def time_decimals(t: Array) -> int:
    """Decimals of a second that tell two hundred times of t apart."""
    return max(0, min(4, math.ceil(-math.log10((t[-1] - t[0]) / 200.0)))) if t[-1] > t[0] else 2
