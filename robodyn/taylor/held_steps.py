"""Whether steps of the Taylor integrator are held by stability, not by accuracy."""

from __future__ import annotations

import numpy as np

from robodyn.simulation.recording import Recorder
from robodyn.taylor import STEPS, Chunk


def held_by_stability(
    recent: list[Chunk], t_end: float, recorder: Recorder, rtol: float, atol: float
) -> bool:
    """Whether a run that would take too many steps takes them along what one cubic describes."""
    t, y = np.concatenate([x.t for x in recent]), np.concatenate([x.y for x in recent])
    t, y, n = t[-STEPS:], y[-STEPS:], recorder.mechanism.n
    x = (t - t[0])[:, None]
    span = float(x[-1, 0])
    left = recorder.max_evaluations - recorder.report.evaluations
    if (t_end - t[-1]) / span * STEPS <= left:
        return False
    q, qd = y[:, :n], y[:, n : 2 * n]
    fast = float(np.abs(qd).max())
    if abs(span) * fast > 0.1 * STEPS:  # turns of links hold it as well
        return False
    slope = (q[-1] - q[0]) / span
    a, b = qd[0] - slope, qd[-1] - slope
    u = x / span
    cubic = q[0] + x * slope + span * u * (1.0 - u) * (a * (1.0 - u) - b * u)
    return bool(np.abs(cubic - q).max() <= (atol + rtol * fast) * abs(span))
