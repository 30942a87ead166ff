"""Cubic and quintic splines through points, at rest at their ends.

A spline of degree 2p - 1 makes the integral of (q^(p))^2 least, which makes it C2 (cubic, p = 2) or
C4 (quintic, p = 3).  Between two knots it is the Hermite polynomial of what is known there: with x
from 0 to 1 over the step h its coefficients are H d, with the value, h q' (and h^2 q'') at both
ends in d, and the integral is h^(1-2p) d^T E d with E = H^T diag(p-th powers' integrals) H.  That
its gradient in the q' (and q'') of the knots is zero is a block tridiagonal system, symmetric and
positive definite, and is eliminated without pivoting.
"""

from __future__ import annotations

from math import factorial, perm

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import RobodynError
from robodyn.tables.arrays import Array

FEWEST_ROWS = 6  # that determine the quintic of `derivative`


def spline(knots: Array, points: Array, degree: int, natural: bool = False) -> Array:
    """Coefficients (pieces, degree + 1, m), lowest power of x - knot first, of a spline.

    knots (K,) increase, points are (K, m), degree is 3 or 5.  At the ends q' = 0 (and q'' = 0 of a
    quintic), or with `natural` q'' = 0 of a cubic.
    """
    p = (degree + 1) // 2
    H = _basis(p)
    bent = np.array([perm(i, p) for i in range(2 * p)], float)
    powers = np.arange(2 * p)
    integrals = np.outer(bent, bent) / np.maximum(powers[:, None] + powers - 2 * p + 1, 1)
    E = H.T @ integrals @ H

    h, D = np.diff(knots)[:, None, None], np.diff(points, axis=0)
    scale = h ** np.arange(1, p)[:, None]  # of q', q'', as they stand in d
    inner, outer = slice(1, p), slice(p + 1, 2 * p)
    weight = scale * np.swapaxes(scale, -1, -2) * h ** (1 - 2 * p)
    diagonal = np.zeros((len(knots), p - 1, p - 1))
    diagonal[:-1] += weight * E[inner, inner]
    diagonal[1:] += weight * E[outer, outer]
    right = np.zeros((len(knots), p - 1, points.shape[1]))
    pull = scale * h ** (1 - 2 * p) * D[:, None]  # as each piece begins at 0 and ends at D
    right[:-1] -= E[inner, p, None] * pull
    right[1:] -= E[outer, p, None] * pull
    slopes = _solve(diagonal, weight * E[inner, outer], right, ends_at_rest=not natural)
    return hermite(knots, points, *np.moveaxis(slopes, 1, 0))


def hermite(knots: Array, *given: Array) -> Array:
    """Coefficients (pieces, 2p, m), as above, from q, q' and, if p = 3, q'' at knots, (K, m)."""
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


def evaluate(coefficients: Array, piece: NDArray[np.int64], x: Array, order: int) -> Array:
    """The derivative of this order of piecewise polynomials at x (T,) past each piece's knot."""
    c = coefficients[piece]
    value = np.zeros((len(x), c.shape[2]))
    for power in range(c.shape[1] - 1, order - 1, -1):
        value = value * x[:, None] + perm(power, order) * c[:, power]
    return value


def largest(coefficients: Array, lengths: Array, order: int) -> Array:
    """The largest absolute value of the derivative of this order over all pieces, (m,).

    It is at a knot, or where the next derivative is zero.
    """
    pieces, terms, m = coefficients.shape
    index = np.arange(pieces)
    ends = [evaluate(coefficients, index, at, order) for at in (np.zeros(pieces), lengths)]
    best: Array = np.abs(np.concatenate(ends)).max(axis=0)
    powers = np.arange(order + 1, terms)
    factors = np.array([perm(power, order + 1) for power in powers.tolist()])
    for k, j in np.ndindex(pieces, m):
        # in units of the piece's length, so that no power of it overflows
        slope = factors * coefficients[k, order + 1 :, j] * lengths[k] ** (powers - order - 1)
        roots = np.roots(slope[::-1]).real  # complex ones do no harm
        x = lengths[k] * roots[(roots > 0) & (roots < 1)]
        values = evaluate(coefficients[:, :, j : j + 1], np.full(x.size, k), x, order)
        best[j] = max(best[j], np.abs(values).max(initial=0.0))
    return best


def _solve(diagonal: Array, beside: Array, right: Array, ends_at_rest: bool) -> Array:
    """x (K, b, m) of a symmetric block tridiagonal system; zero at both ends if at rest."""
    x = np.zeros_like(right)
    begin, end = (1, len(right) - 1) if ends_at_rest else (0, len(right))
    diagonal, right = diagonal.copy(), right.copy()
    for k in range(begin + 1, end):
        factor = np.linalg.solve(diagonal[k - 1], beside[k - 1]).T  # beside^T pivot^-1
        diagonal[k] -= factor @ beside[k - 1]
        right[k] -= factor @ right[k - 1]
    for k in range(end - 1, begin - 1, -1):
        known = beside[k] @ x[k + 1] if k < end - 1 else 0.0
        x[k] = np.linalg.solve(diagonal[k], right[k] - known)
    return x


def derivative(t: Array, x: Array, order: int) -> Array:
    """The derivative of this order, at times t (T,) that rise, of x (T, m), T >= FEWEST_ROWS.

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
