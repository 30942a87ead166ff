"""Rates of measured joint values, without shifting them in time."""

from __future__ import annotations

import numpy as np

from robodyn.errors import InputError
from robodyn.tables.arrays import Array
from robodyn.trajectories.joint_paths import FEWEST_ROWS, derivative, resampled

ORDER = 4  # of the Butterworth low-pass, which runs forward and backward
EVEN = 1e-3  # part of the step by which times may be uneven where a filter runs over them


def rates(t: Array, x: Array, order: int, cutoff: float | None = None) -> Array:
    """The derivative of this order of x (T, m), at times t (T,) that rise.

    By the quintic spline through x; with `cutoff` (Hz) x goes first through a Butterworth low-pass,
    forward and backward, so that no phase is shifted.  A filter takes even steps: uneven ones are
    resampled (Akima).  Raises InputError for too few rows, and for a cutoff that is none.
    """
    if len(t) < FEWEST_ROWS:
        raise InputError("rows", value=len(t), limit=f"rates need {FEWEST_ROWS} or more")
    if cutoff is None:
        return derivative(t, x, order)
    if uneven(t):
        even = np.linspace(t[0], t[-1], len(t))
        return derivative(even, _filtered(even, resampled(t, x, even), cutoff), order, at=t)
    return derivative(t, _filtered(t, x, cutoff), order)


def uneven(t: Array) -> bool:
    """Whether steps of times t (T,) differ too much for a filter to run over them."""
    if len(t) < 3:
        return False
    steps = np.diff(t)
    return bool(np.abs(steps - steps.mean()).max() / steps.mean() > EVEN)


def _filtered(t: Array, x: Array, cutoff: float) -> Array:
    from scipy.signal import butter, sosfiltfilt

    step = float(np.diff(t).mean())
    if not 0.0 < cutoff < 0.5 / step:
        limit = f"must be between 0 and half the sampling rate, {0.5 / step:.6g} Hz"
        raise InputError("cutoff", value=cutoff, limit=limit)
    sections = butter(ORDER, cutoff, fs=1.0 / step, output="sos")
    length = min(len(t) - 1, int(3.0 / (cutoff * step)) + 1)
    found: Array = sosfiltfilt(sections, x, axis=0, padlen=length)
    return found


def how(cutoff: float | None, t: Array) -> str:
    """Return what `rates` does at times t (T,), in words."""
    spline = "quintic splines through t"
    if cutoff is None:
        return spline
    even = f"even steps of {np.ptp(t) / (len(t) - 1):.6g} s, " if uneven(t) else ""
    low_pass = f"a Butterworth low-pass (order {ORDER}, {cutoff:g} Hz) forward and backward"
    return f"{even}{low_pass}, then {spline}"
