"""Cubic and quintic splines through points, at rest at their ends.

Between two knots a spline is the Hermite polynomial of the rates (and, quintic, accelerations) at
both.  With h the step and D the difference between the points,

    cubic:    q''(0)   = ( 6 D - 4 v0 h - 2 v1 h) / h^2
              q''(h)   = (-6 D + 2 v0 h + 4 v1 h) / h^2
    quintic:  q'''(0)  = (60 D - 36 v0 h - 24 v1 h - 9 a0 h^2 + 3 a1 h^2) / h^3
              q'''(h)  = (60 D - 24 v0 h - 36 v1 h - 3 a0 h^2 + 9 a1 h^2) / h^3
              q''''(0) = (-360 D + 192 v0 h + 168 v1 h + 36 a0 h^2 - 24 a1 h^2) / h^4
              q''''(h) = ( 360 D - 168 v0 h - 192 v1 h - 24 a0 h^2 + 36 a1 h^2) / h^4

That these agree on both sides of each inner knot makes the spline C2 (cubic) or C4 (quintic), and
is a block tridiagonal system for the v (and a).  It is the one that makes the integral of q''^2
(q'''^2) least, so it is symmetric and positive definite, and is eliminated without pivoting.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cubic_spline(knots: Array, points: Array, natural: bool = False) -> Array:
    """Coefficients (pieces, 4, m), lowest power of x - knot first, of the C2 spline.

    knots (K,) increase, points are (K, m).  At the ends q' = 0, or with `natural` q'' = 0.
    """
    h = np.diff(knots)[:, None]
    D = np.diff(points, axis=0)
    m = points.shape[1]
    diagonal = np.zeros((len(knots), 1, 1))
    diagonal[:-1, 0] += 4 / h
    diagonal[1:, 0] += 4 / h
    beside = np.broadcast_to((2 / h)[:, :, None], (len(h), 1, 1)).copy()
    right = np.zeros((len(knots), 1, m))
    right[:-1, 0] += 6 * D / h**2
    right[1:, 0] += 6 * D / h**2
    v = _solve(diagonal, beside, right, ends_at_rest=not natural)[:, 0]
    return hermite(knots, points, v)


def quintic_spline(knots: Array, points: Array) -> Array:
    """Coefficients (pieces, 6, m), as above, of the C4 spline with q' = q'' = 0 at its ends."""
    h = np.diff(knots)
    D = np.diff(points, axis=0)

    # unknowns (v, a) of a knot; rows: the jump of q'''' and that of q''', symmetric together
    def blocks(vv: float, va: float, av: float, aa: float) -> Array:
        rows = [[vv / h**3, va / h**2], [av / h**2, aa / h]]
        return np.moveaxis(np.array(rows), -1, 0)

    diagonal = np.zeros((len(knots), 2, 2))
    diagonal[:-1] += blocks(192, 36, 36, 9)
    diagonal[1:] += blocks(192, -36, -36, 9)
    beside = blocks(168, -24, 24, -3)
    right = np.zeros((len(knots), 2, points.shape[1]))
    quartics, cubics = D / h[:, None] ** 4, D / h[:, None] ** 3
    right[:-1] += np.stack([360 * quartics, 60 * cubics], axis=1)
    right[1:] += np.stack([360 * quartics, -60 * cubics], axis=1)
    solution = _solve(diagonal, beside, right, ends_at_rest=True)
    return hermite(knots, points, solution[:, 0], solution[:, 1])


def hermite(knots: Array, q: Array, v: Array, a: Array | None = None) -> Array:
    """Coefficients (pieces, 4 or 6, m), as above, from q, q' and, where given, q'' (K, m)."""
    h = np.diff(knots)[:, None]
    if a is None:
        D, V = np.diff(q, axis=0) - v[:-1] * h, np.diff(v, axis=0) * h
        powers = [q[:-1], v[:-1], (3 * D - V) / h**2, (V - 2 * D) / h**3]
    else:
        bend = a[:-1] * h**2
        D = np.diff(q, axis=0) - v[:-1] * h - bend / 2
        V, A = np.diff(v, axis=0) * h - bend, a[1:] * h**2 - bend
        powers = [q[:-1], v[:-1], a[:-1] / 2, (10 * D - 4 * V + A / 2) / h**3]
        powers += [(7 * V - 15 * D - A) / h**4, (6 * D - 3 * V + A / 2) / h**5]
    return np.stack(powers, axis=1)


def evaluate(coefficients: Array, piece: NDArray[np.int64], x: Array, order: int) -> Array:
    """The derivative of this order of piecewise polynomials at x (T,) past each piece's knot."""
    c = coefficients[piece]
    degree = c.shape[1] - 1
    value = np.zeros((len(x), c.shape[2]))
    for power in range(degree, order - 1, -1):
        factor = 1.0
        for k in range(order):
            factor *= power - k
        value = value * x[:, None] + factor * c[:, power]
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
    factors = np.array([np.prod(np.arange(power - order, power + 1)) for power in powers])
    for k in range(pieces):
        for j in range(m):
            # in units of the piece's length, so that no power of it overflows
            slope = factors * coefficients[k, order + 1 :, j] * lengths[k] ** (powers - order - 1)
            if not slope.any():
                continue
            roots = np.roots(slope[::-1])
            inside = roots.real[(roots.real > 0) & (roots.real < 1)]  # complex ones do no harm
            if inside.size:
                at = np.full(inside.size, k)
                values = evaluate(coefficients[:, :, j : j + 1], at, inside * lengths[k], order)
                best[j] = max(best[j], np.abs(values).max())
    return best


def _solve(diagonal: Array, beside: Array, right: Array, ends_at_rest: bool) -> Array:
    """x (K, b, m) of the symmetric block tridiagonal system; zero at both ends if at rest.

    diagonal is (K, b, b), beside (K-1, b, b) the blocks above the diagonal, right (K, b, m).
    """
    x = np.zeros_like(right)
    begin, end = (1, len(right) - 1) if ends_at_rest else (0, len(right))
    pivots: list[Array] = []
    sides: list[Array] = []
    for k in range(begin, end):
        pivot, side = diagonal[k], right[k]
        if pivots:
            factor = np.linalg.solve(pivots[-1], beside[k - 1]).T  # beside^T pivot^-1
            pivot, side = pivot - factor @ beside[k - 1], side - factor @ sides[-1]
        pivots.append(pivot)
        sides.append(side)
    for k in range(end - 1, begin - 1, -1):
        side = sides[k - begin]
        if k < end - 1:
            side = side - beside[k] @ x[k + 1]
        x[k] = np.linalg.solve(pivots[k - begin], side)
    return x
