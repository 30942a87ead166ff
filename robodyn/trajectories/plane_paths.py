"""Paths of a point in the plane: lines, arcs, and splines run through by their length.

A curve is c(s), s from 0 to 1 the part of its length behind the point, so that |dc/ds| is its
length L; in the time T a profile s(u) leads along it with the speed L s'(u)/T.  More coordinates
(an angle) go along with the two of the plane, and count for nothing in the length.

A spline in tau, natural and cubic, has the length int |c_tau| dtau (Gauss-Legendre, on intervals
short enough to be right to rounding), from which tau follows by Newton's method, and by the length

    dc/ds = L c_tau / |c_tau|       d2c/ds2 = L^2 (c_tautau - c_tau (c_tau . c_tautau) / |c_tau|^2)
                                              / |c_tau|^2
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from robodyn.errors import InputError
from robodyn.tables.arrays import Array
from robodyn.trajectories import splines
from robodyn.trajectories.joint_paths import JointPath, Pieces, Values, spread
from robodyn.trajectories.profiles import Profile

Curve = Callable[[Array], Values]  # c, dc/ds, d2c/ds2, each (T, m), at parts s (T,)

PARTS = 16  # of each piece of a spline, in which its length is integrated
CUSP = 1e-6  # part of the length a unit of tau, below which a spline stands still
HALVINGS = 60
PASSES = 8  # of Newton's method for the place at a length
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)


class AlongCurve(JointPath):
    """The path along a curve of this length (m) by a profile."""

    def __init__(self, curve: Curve, length: float, profile: Profile) -> None:
        self.curve, self.profile = curve, profile
        self.breaks, self.travel = np.array(profile.breaks), length

    def within(self, u: Array, piece: Pieces) -> Values:
        late, s, s1, s2 = self.profile.evaluate(u, 1.0 - u, piece)
        c, c1, c2 = self.curve(np.where(late, 1.0 - s, s))
        return c, c1 * s1[:, None], c1 * s2[:, None] + c2 * (s1 * s1)[:, None]


def arc(begin: Array, centre: Array, angle: float) -> tuple[Curve, float]:
    """The arc from `begin` (2,) about a centre (2,) by an angle, rad, and its length."""
    radius = complex(*(begin - centre))

    def curve(s: Array) -> Values:
        turned = radius * np.exp(1j * angle * s)
        first, second = 1j * angle * turned, -(angle**2) * turned
        c, c1, c2 = (np.stack([z.real, z.imag], axis=-1) for z in (turned, first, second))
        return c + centre, c1, c2

    return curve, abs(radius * angle)


def spline_curve(points: Array) -> tuple[Curve, float]:
    """The natural cubic spline through points (K, 2 or more), and its length.

    Of two points it is the line; no two that follow one another coincide.  Raises InputError where
    it turns back on itself: at a speed along it, the point's velocity would jump there.
    """
    knots = spread(points[:, :2])
    of = splines.spline(knots, points, "cubic", natural=True)
    edges = _finer(knots)

    def bent(tau: Array) -> list[Array]:
        return [of(tau, order) for order in range(3)]

    behind = np.append(0.0, np.cumsum(_lengths(bent, edges[:-1], edges[1:])))
    length = float(behind[-1])
    low, high = edges[:-2], edges[2:]
    turned = (bent(low)[1][:, :2] * bent(high)[1][:, :2]).sum(axis=1) < 0.0
    low, high = low[turned], high[turned]
    for _ in range(HALVINGS):  # to where the speed is least
        middle = 0.5 * (low + high)
        _, c1, c2 = (x[:, :2] for x in bent(middle))
        falls = (c1 * c2).sum(axis=1) < 0.0
        low, high = np.where(falls, middle, low), np.where(falls, high, middle)
    c, c1, _ = (x[:, :2] for x in bent(low))
    for x, y in c[np.linalg.norm(c1, axis=1) < CUSP * length]:
        limit = "without times (t) a path must not turn back on itself; split it there, or give t"
        raise InputError(f"the path turns back at ({x:.6g}, {y:.6g})", limit=limit)

    def curve(s: Array) -> Values:
        k = np.clip(np.searchsorted(behind, s * length, side="right") - 1, 0, len(edges) - 2)
        low, high = edges[k], edges[k + 1]
        wanted = s * length - behind[k]
        tau = low + (high - low) * wanted / (behind[k + 1] - behind[k])
        for _ in range(PASSES):
            speed = np.linalg.norm(bent(tau)[1][:, :2], axis=1)
            tau = np.clip(tau - (_lengths(bent, low, tau) - wanted) / speed, low, high)
        tau = np.where(s == 1.0, 1.0, tau)
        c, c1, c2 = bent(tau)
        square = (c1[:, :2] ** 2).sum(axis=1)[:, None]
        along = (c1[:, :2] * c2[:, :2]).sum(axis=1)[:, None]
        return c, length / np.sqrt(square) * c1, length**2 / square * (c2 - c1 * along / square)

    return curve, length


def length_until(path: JointPath, u: float = 1.0) -> float:
    """How far (m) the point of a path has gone at u."""
    edges = _finer(np.unique(np.append(np.clip(path.breaks, 0.0, u), u)))
    return float(_lengths(path.evaluate, edges[:-1], edges[1:]).sum())


def _finer(knots: Array) -> Array:
    whole = np.arange(len(knots))
    return np.interp(np.arange(PARTS * whole[-1] + 1) / PARTS, whole, knots)


def _lengths(curve: Callable[[Array], Sequence[Array]], begin: Array, end: Array) -> Array:
    """Of smooth parts of a curve in the plane, whose rates are the second of its values."""
    half = 0.5 * (end - begin)
    at = begin[:, None] + half[:, None] * (1.0 + NODES)
    speed = np.linalg.norm(curve(at.reshape(-1))[1][:, :2], axis=1).reshape(at.shape)
    return np.asarray(half * (speed @ WEIGHTS))
