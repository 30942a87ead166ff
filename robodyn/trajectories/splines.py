"""Splines through points and times."""

from __future__ import annotations

from collections.abc import Callable
from math import factorial, perm
from typing import Any

import numpy as np

from robodyn.errors import RobodynError
from robodyn.tables.arrays import Array

FEWEST_ROWS = 6  # that determine the quintic of `derivative`


def spline(
    knots: Array, points: Array, kind: str, natural: bool = False
) -> Callable[[Array, int], Array]:
    """A spline by scipy: its derivative of an order at places (T,), (T, m).

    knots (K,) increase, points are (K, m), `kind` is cubic (C2) or quintic (C4).  At the ends
    q' = 0 (and q'' = 0 of a quintic), or with `natural` q'' = 0 of a cubic.
    """
    from scipy.interpolate import CubicSpline, make_interp_spline

    if kind == "cubic":
        return CubicSpline(knots, points, bc_type="natural" if natural else "clamped")
    rest: Any = [(order, np.zeros(points.shape[1])) for order in (1, 2)]
    return make_interp_spline(knots, points, k=5, bc_type=(rest, rest))


def hermite(knots: Array, *given: Array) -> Array:
    """Hermite polynomials from q, q' and, if p = 3, q'' at knots, (K, m).

    Coefficients (pieces, 2p, m), lowest power of x - knot first.
    """
    p, h = len(given), np.diff(knots)[:, None, None]
    known, scale = np.stack(given, axis=1), h ** np.arange(p)[:, None]
    way = known[:-1] * scale  # from 0 on, along the Taylor polynomial of what is known first
    way[:, 0] = 0.0
    taylor = np.array([[perm(i, k) / factorial(i) for i in range(p)] for k in range(p)])
    end = known[1:].copy()
    end[:, 0] -= known[:-1, 0]
    upper = _basis(p)[p:, p:] @ (end * scale - taylor @ way)
    lower = known[:-1] * taylor[0][:, None]
    return np.concatenate([lower, upper / h ** np.arange(p, 2 * p)[:, None]], axis=1)


def _basis(p: int) -> Array:
    """H: the coefficients of a Hermite polynomial from 0 to 1 by its derivatives at both ends."""
    places = range(2 * p)
    ends = [[[perm(i, k) * x ** abs(i - k) for i in places] for k in range(p)] for x in (0, 1)]
    return np.round(2.0 * np.linalg.inv(np.concatenate(ends))) / 2.0  # whole numbers or halves


def turns_between(q: Array, t: Array | None = None, qd: Array | None = None) -> Array:
    """Return by how many whole turns (T - 1,) an angle q (T,), rad, jumps from row to row.

    A jump is a step of more than half a turn. If rates qd (T,), rad/s, at times t (T,) are given,
    it is a step that differs by more than half a turn from the integral of qd (trapezoidal).
    """
    steps = np.diff(q)
    if t is not None and qd is not None:
        steps -= 0.5 * np.diff(t) * (qd[1:] + qd[:-1])
    found: Array = np.rint(steps / (2.0 * np.pi))
    return found


def derivative(t: Array, x: Array, order: int, at: Array | None = None) -> Array:
    """The derivative of this order of x (T, m), at times t (T,) that rise, T >= FEWEST_ROWS.

    `at` are other times (S,), from t[0] to t[-1], to take it at.

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
            wanted = places if at is None else (at - t[0]) / step
            found: Array = spline.derivative(order)(wanted) / step**order
    except (ValueError, np.linalg.LinAlgError):
        raise _too_unequal() from None
    return found


def resampled(t: Array, x: Array, at: Array) -> Array:
    """Return x (T, m), known at times t (T,) that rise, at the times `at` (S,) between these.

    By Akima's splines, which noise in rows that are close together does not upset.  Raises
    RobodynError where the times are too unequal for floats.
    """
    from scipy.interpolate import Akima1DInterpolator

    try:
        with np.errstate(all="ignore"):
            found: Array = Akima1DInterpolator(t, x)(at)
    except ValueError:
        raise _too_unequal() from None
    return found


def _too_unequal() -> RobodynError:
    return RobodynError("no spline goes through the times t", limit="too unequal")
