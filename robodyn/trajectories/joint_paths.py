"""Paths p(u) of the actuated joints, u from 0 to 1: what is left of a motion without its duration.

In the time T a path is run through as q = p(t/T), qd = p'/T, qdd = p''/T^2.  A path is smooth
between its `breaks`; at a break a value is that of the piece after it, unless `piece` says which.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.errors import InputError
from robodyn.tables.arrays import Array
from robodyn.trajectories import splines
from robodyn.trajectories.profiles import ACCELERATION, Profile, profile

Pieces = NDArray[np.int64]
Values = tuple[Array, Array, Array]  # p, p', p'', each (T, m)

MOST_TURNS = 32  # after which a path at constant speed may repeat itself
BLOCK = 1000  # pieces of a path that are looked at together
WHOLE = 1e-3  # rad, by which turns that count as whole may miss that in the end
SPLINES = ("cubic", "quintic")  # through points in one sweep; the others stop at each


class JointPath:
    """A path of m joints."""

    breaks: Array  # the ends of its pieces, (K + 1,), from 0 to 1
    travel: float  # how far the joint that moves most does, rad: that far at least
    scalable = True  # it is the same path in any duration

    def evaluate(self, u: Array, piece: Pieces | None = None) -> Values:
        """p, p', p'' at u (T,) in [0, 1]."""
        return self.within(u, piece_at(self.breaks, u) if piece is None else piece)

    def within(self, u: Array, piece: Pieces) -> Values:
        """The same, as these pieces have it."""
        raise NotImplementedError

    def returns(self) -> Array:
        """Parts u, in order, after which all joints stand as at the start and go on as there."""
        return np.zeros(0)


def piece_at(breaks: Array, u: Array) -> Pieces:
    """The piece in which each u lies; at a break the one after it."""
    return np.searchsorted(breaks[1:-1], u, side="right").astype(np.int64)


def travels(path: JointPath, edges: Array) -> Array:
    """About how far the joint that moves most does in each part of a path, (parts,), rad.

    `edges` (parts + 1,) are breaks, or parts of the first piece.
    """
    part, found = np.linspace(0.0, 1.0, 9), np.zeros(len(edges) - 1)
    for begin in range(0, len(found), BLOCK):
        ends = edges[begin : begin + BLOCK + 1]
        u = ends[:-1, None] + np.diff(ends)[:, None] * part
        piece = np.arange(begin, begin + len(u)).repeat(len(part))
        p = path.evaluate(u.reshape(-1), piece)[0].reshape(*u.shape, -1)
        moved = np.abs(np.diff(p, axis=1)).sum(axis=1)
        found[begin : begin + BLOCK] = moved.max(axis=1, initial=0.0)
    return found


class Legs(JointPath):
    """Straight legs (in joint space) from point to point, at rest at each point.

    points (K, m); `times` (K,) increase from 0 to 1.
    """

    def __init__(self, points: Array, times: Array, profile: Profile) -> None:
        self.points, self.knots, self.profile = points, times, profile
        self._lengths = np.diff(times)
        inner = np.array(profile.breaks[:-1])
        starts = times[:-1, None] + self._lengths[:, None] * inner
        self.breaks = np.append(starts.reshape(-1), 1.0)
        self.travel = _way(points)

    def within(self, u: Array, piece: Pieces) -> Values:
        leg, part = np.divmod(piece, len(self.profile.breaks) - 1)
        h = self._lengths[leg]
        v = np.clip((u - self.knots[leg]) / h, 0.0, 1.0)
        left = np.clip((self.knots[leg + 1] - u) / h, 0.0, 1.0)
        late, s, s1, s2 = self.profile.evaluate(v, left, part)
        begin, end = self.points[leg], self.points[leg + 1]
        D = end - begin
        p = np.where(late[:, None], end - D * s[:, None], begin + D * s[:, None])
        return p, D * (s1 / h)[:, None], D * (s2 / h**2)[:, None]


class Spline(JointPath):
    """A spline through points (K, m) at `times` (K,) that increase from 0 to 1."""

    def __init__(self, points: Array, times: Array, kind: str, natural: bool = False) -> None:
        self.breaks = self.knots = times
        self._ends = points[0], points[-1]
        self._zero = [1] * (not natural) + [2] * (natural or kind == "quintic")  # at the ends
        self.travel = _way(points)
        self._curve = splines.spline(times, points, kind, natural)

    def within(self, u: Array, piece: Pieces) -> Values:
        p, p1, p2 = values = [self._curve(u, order) for order in range(3)]  # which do not jump
        for at, point in zip((u == 0.0, u == 1.0), self._ends, strict=True):  # without rounding
            p[at] = point
            for order in self._zero:
                values[order][at] = 0.0
        return p, p1, p2


class Sweep(JointPath):
    """A chirp about a pose: p = pose + amplitude sin(phi), the frequency from first to last, Hz.

    phi = 2 pi T (f0 u + (f1 - f0) u^2 / 2): the frequency f0 + (f1 - f0) u grows in proportion
    to the time, so that the path depends on the duration T.
    """

    scalable = False

    def __init__(
        self, pose: Array, amplitude: Array, first: float, last: float, duration: float
    ) -> None:
        self.pose, self.amplitude = pose, amplitude
        self._start, self._slope = 2 * np.pi * duration * np.array([first, last - first])
        halves = np.pi * np.arange(1.0, np.ceil(duration * (first + last)))  # of a turn of phi
        # phi = start u + slope u^2 / 2 at each, solved without cancellation
        root = np.sqrt(np.maximum(self._start**2 + 2 * self._slope * halves, 0.0))
        inner = 2 * halves / (self._start + root)
        inner = inner[(inner > 1e-9) & (inner < 1 - 1e-9)]
        self.breaks = np.concatenate([[0.0], inner, [1.0]])
        self.travel = 2.0 * len(inner) * float(np.abs(amplitude).max(initial=0.0))

    def within(self, u: Array, piece: Pieces) -> Values:
        phase = (u * (self._start + 0.5 * self._slope * u))[:, None]
        rate = (self._start + self._slope * u)[:, None]
        sine, cosine = np.sin(phase), np.cos(phase)
        return (
            self.pose + self.amplitude * sine,
            self.amplitude * cosine * rate,
            self.amplitude * (cosine * self._slope - sine * rate**2),
        )


def path_through(
    points: Array,
    times: ArrayLike | None,
    name: str,
    acceleration: float = ACCELERATION,
    natural: bool = False,
) -> Legs | Spline:
    """The path of a profile through points (K, m), at rest at its ends.

    `times` (K,) increase (any unit); None spreads them in proportion to the distances between the
    points in joint space.  Cubic and quintic are splines of continuity C2 and C4 where there are
    more than two points; the other profiles stop at each point.  Raises InputError.
    """
    shape = profile(name, acceleration)
    if len(points) < 2:
        raise InputError("points", value=len(points), limit="a motion needs two points or more")
    if times is None:
        u = spread(points)
    else:
        stamps = np.asarray(times, float)
        if stamps.shape != (len(points),):
            limit = f"must be ({len(points)},), one time a point"
            raise InputError("times.shape", value=stamps.shape, limit=limit)
        u = _scaled(stamps)
    if natural and not (name == "cubic" and len(points) > 2):
        raise InputError("ends", value="natural", limit="is for a cubic spline through points")
    if name in SPLINES and len(points) > 2:
        return Spline(points, u, name, natural)
    return Legs(points, u, shape)


def _way(points: Array) -> float:
    """The way from point to point of points (K, m), of the joint whose is the longest."""
    return float(np.abs(np.diff(points, axis=0)).sum(axis=0).max(initial=0.0))


class ConstantSpeed(Legs):
    """The path from `begin` (m,) on by `way` (m,) at constant speed."""

    def __init__(self, begin: Array, way: Array) -> None:
        super().__init__(np.stack([begin, begin + way]), np.array([0.0, 1.0]), profile("constant"))

    def returns(self) -> Array:
        """After so many turns of the fastest joint that those of the others are whole, too."""
        turns = np.abs(np.diff(self.points, axis=0)[0]) / (2 * np.pi)
        fastest = float(turns.max(initial=0.0))
        if fastest <= 1.0:
            return np.zeros(0)
        u = np.arange(1, min(MOST_TURNS, int(fastest)) + 1) / fastest
        each = u[:, None] * turns
        off = 2 * np.pi * np.abs(each - np.round(each)).max(axis=1) / u  # at the end of the path
        return np.asarray(u[(off < WHOLE) & (u < 1.0)])


def spread(points: Array) -> Array:
    """Times from 0 to 1 in proportion to the distances between points (K, m) in joint space."""
    distances = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if len(points) == 2:
        return np.array([0.0, 1.0])
    if not (distances > 0.0).all():
        k = int(np.argmin(distances)) + 1
        limit = "are the same, so that no time passes between them: give times"
        raise InputError(f"points {k} and {k + 1}", limit=limit)
    return _scaled(np.concatenate([[0.0], np.cumsum(distances)]))


def _scaled(times: Array) -> Array:
    shown = ", ".join(f"{t:g}" for t in times[:10]) + (", ..." if len(times) > 10 else "")
    if not (np.isfinite(times).all() and (np.diff(times) > 0.0).all()):
        raise InputError("times", value=shown, limit="must be finite and increase")
    u: Array = (times - times[0]) / (times[-1] - times[0])
    u[-1] = 1.0
    if not (np.diff(u) > 0.0).all():
        raise InputError("times", value=shown, limit="are too close to one another")
    return u
