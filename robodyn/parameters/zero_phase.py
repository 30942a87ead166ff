"""Rates of measured joint values, without shifting them in time."""

from __future__ import annotations

import numpy as np

from robodyn.errors import InputError
from robodyn.tables.arrays import Array
from robodyn.trajectories.splines import FEWEST_ROWS, derivative

ORDER = 4  # of the Butterworth low-pass, which runs forward and backward
EVEN = 1e-3  # part of the step by which times may be uneven where a filter runs over them


def rates(t: Array, x: Array, order: int, cutoff: float | None = None) -> Array:
    """The derivative of this order of x (T, m), at times t (T,) that rise.

    By the quintic spline through x; with `cutoff` (Hz) x goes first through a Butterworth low-pass,
    forward and backward, so that no phase is shifted.  Raises InputError for too few rows, and for
    times that a filter cannot run over.
    """
    if len(t) < FEWEST_ROWS:
        raise InputError("rows", value=len(t), limit=f"rates need {FEWEST_ROWS} or more")
    if cutoff is not None:
        x = _filtered(t, x, cutoff)
    return derivative(t, x, order)


def _filtered(t: Array, x: Array, cutoff: float) -> Array:
    from scipy.signal import butter, sosfiltfilt

    steps = np.diff(t)
    step = float(steps.mean())
    if (off := float(np.abs(steps - step).max() / step)) > EVEN:
        value = f"steps from {steps.min():.6g} to {steps.max():.6g} s"
        limit = f"must be even to {EVEN:g} of them for a filter to run over; they are to {off:.3g}"
        raise InputError("t", value=value, limit=limit)
    if not 0.0 < cutoff < 0.5 / step:
        limit = f"must be between 0 and half the sampling rate, {0.5 / step:.6g} Hz"
        raise InputError("cutoff", value=cutoff, limit=limit)
    sections = butter(ORDER, cutoff, fs=1.0 / step, output="sos")
    length = min(len(t) - 1, int(3.0 / (cutoff * step)) + 1)
    found: Array = sosfiltfilt(sections, x, axis=0, padlen=length)
    return found


def how(cutoff: float | None) -> str:
    """What `rates` does, in words."""
    spline = "quintic splines through t"
    if cutoff is None:
        return spline
    return (
        f"a Butterworth low-pass (order {ORDER}, {cutoff:g} Hz) forward and backward, then {spline}"
    )
