"""Rates of what is known at times, by a spline through it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import RobodynError

Array = NDArray[np.float64]

FEWEST = 6  # rows that determine a quintic


def derivative(t: Array, x: Array, order: int) -> Array:
    """The derivative of this order, at times t (T,) that rise, of x (T, m), T >= FEWEST.

    That of the quintic spline through x whose third derivative's pieces run on at the ends (not a
    knot): nothing is assumed of the motion there.  Of a smooth motion the first derivative is right
    to the power 5 of the step, the second to the power 4.  Raises RobodynError where the times are
    too unequal for floats.
    """
    from scipy.interpolate import make_interp_spline

    step = (t[-1] - t[0]) / (len(t) - 1)
    try:
        with np.errstate(all="ignore"):
            places = (t - t[0]) / step
            spline = make_interp_spline(places, x, k=5)
            found: Array = spline.derivative(order)(places) / step**order
    except (ValueError, np.linalg.LinAlgError):
        raise RobodynError("no spline goes through the times t", limit="too unequal") from None
    return found
