"""Paths p(u) of the actuated joints, u from 0 to 1: motions without their duration.

For a duration T, a path gives q = p(t/T), qd = p'/T, qdd = p''/T^2.  A path is smooth between its
`breaks`.  At a break, values belong to the piece after it, unless `piece` says otherwise.

Profiles s(u) of a motion from rest to rest:

    cubic         s = 3 u^2 - 2 u^3                    peak s' = 3/2     peak s'' = 6
    quintic       s = 10 u^3 - 15 u^4 + 6 u^5          peak s' = 15/8    peak s'' = 10/sqrt(3)
    cycloidal     s = u - sin(2 pi u) / (2 pi)         peak s' = 2       peak s'' = 2 pi
    trapezoidal   s'' = +a, 0, -a over the parts        peak s' = 1/(1-alpha)
                  alpha, 1 - 2 alpha, alpha             peak s'' = a = 1/(alpha (1-alpha))
    constant      s = u, a motion at constant speed    peak s' = 1       peak s'' = 0

A joint that goes from q0 to q1 in the time T moves by q = q0 + (q1 - q0) s(t/T), so that qd = (q1 -
q0) s'/T and qdd = (q1 - q0) s''/T^2. (Craig, Introduction to Robotics, chapter 7; Biagiotti and
Melchiorri, Trajectory Planning for Automatic Machines and Robots, chapters 2 and 3.)

Each profile is symmetric, s(1 - u) = 1 - s(u), and is computed from its nearer end, so that its end
is as exact as its start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import factorial, isfinite, perm, pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.errors import InputError, RobodynError
from robodyn.tables.arrays import Array, Truth

Pieces = NDArray[np.int64]
# w = the way in u from the nearer end, and whether it lies on a ramp: s, s', s'' there
Half = Callable[[Array, Truth], tuple[Array, Array, Array]]

NAMES = ("cubic", "quintic", "trapezoidal", "cycloidal", "constant")
ACCELERATION = 1 / 3  # part of the time in which a trapezoidal profile speeds up


@dataclass(frozen=True, slots=True)
class Profile:
    """A profile; it is smooth between its `breaks`."""

    name: str
    breaks: tuple[float, ...]
    half: Half

    def evaluate(self, u: Array, left: Array, piece: Pieces) -> tuple[Truth, Array, Array, Array]:
        """Return whether u (T,) is late, s from the nearer end, s' and s''.

        `left` is 1 - u.  If late, the returned s is 1 - s(u).  `piece` selects the side of a break.
        """
        late = u > 0.5
        last = len(self.breaks) - 2
        if last:
            late = np.where(piece == 0, False, np.where(piece == last, True, late))
        ramp = (piece == 0) | (piece == last)
        s, rate, acceleration = self.half(np.where(late, left, u), ramp)
        return late, s, rate, np.where(late, -acceleration, acceleration)


def profile(name: str, acceleration: float = ACCELERATION) -> Profile:
    """Return the profile of this name; `acceleration` is the fraction alpha of a trapezoidal one.

    Raises InputError for an unknown name, or for alpha outside 0 < alpha <= 1/2.
    """
    alpha = acceleration
    if not (isfinite(alpha) and 0.0 < alpha <= 0.5):
        limit = "must be > 0 and <= 0.5, a part of the duration"
        raise InputError("acceleration", value=alpha, limit=limit)
    if name in SMOOTH:
        return Profile(name, (0.0, 1.0), SMOOTH[name])
    if name != "trapezoidal":
        raise InputError("profile", value=name, limit=f"must be one of {', '.join(NAMES)}")
    speed = 1 / (1 - alpha)
    a = speed / alpha

    def half(w: Array, ramp: Truth) -> tuple[Array, Array, Array]:
        s = np.where(ramp, 0.5 * a * w * w, speed * (w - 0.5 * alpha))
        return s, np.where(ramp, a * w, speed), np.where(ramp, a, 0.0)

    breaks = (0.0, 0.5, 1.0) if alpha == 0.5 else (0.0, alpha, 1 - alpha, 1.0)
    return Profile(name, breaks, half)


def _quintic(w: Array, _: Truth) -> tuple[Array, Array, Array]:
    s = w**3 * (10 + w * (6 * w - 15))
    return s, 30 * (w * (1 - w)) ** 2, 60 * w * (1 - w) * (1 - 2 * w)


def _cycloidal(w: Array, _: Truth) -> tuple[Array, Array, Array]:
    angle = 2 * pi * w
    return w - np.sin(angle) / (2 * pi), 2 * np.sin(pi * w) ** 2, 2 * pi * np.sin(angle)


# those that are smooth in all of the time
SMOOTH: dict[str, Half] = {
    "cubic": lambda w, _: (w * w * (3 - 2 * w), 6 * w * (1 - w), 6 - 12 * w),
    "quintic": _quintic,
    "cycloidal": _cycloidal,
    "constant": lambda w, _: (w, np.ones_like(w), np.zeros_like(w)),
}


FEWEST_ROWS = 6  # that determine the quintic of `derivative`


def spline(
    knots: Array, points: Array, kind: str, natural: bool = False
) -> Callable[[Array, int], Array]:
    """Return a function of places (T,) and order that gives derivatives (T, m) of a spline.

    knots (K,) increase, points are (K, m), `kind` is cubic (C2) or quintic (C4).  At the ends q' =
    0 (and q'' = 0 for a quintic); with `natural`, q'' = 0 for a cubic.
    """
    from scipy.interpolate import CubicSpline, make_interp_spline

    if kind == "cubic":
        return CubicSpline(knots, points, bc_type="natural" if natural else "clamped")
    rest: Any = [(order, np.zeros(points.shape[1])) for order in (1, 2)]
    return make_interp_spline(knots, points, k=5, bc_type=(rest, rest))


def hermite(knots: Array, *given: Array) -> Array:
    """Return Hermite polynomials through q, q' and, if p = 3, q'' at knots, each (K, m).

    Coefficients are (pieces, 2p, m), lowest power of x - knot first.
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
    """Return the coefficients of Hermite polynomials on [0, 1] from derivatives at both ends."""
    places = range(2 * p)
    ends = [[[perm(i, k) * x ** abs(i - k) for i in places] for k in range(p)] for x in (0, 1)]
    return np.round(2.0 * np.linalg.inv(np.concatenate(ends))) / 2.0  # whole numbers or halves


def turns_between(q: Array, t: Array | None = None, qd: Array | None = None) -> Array:
    """Return by how many full turns (T - 1,) an angle q (T,), rad, jumps between rows.

    A jump is a step of more than half a turn.  If rates qd (T,), rad/s, at times t (T,) are given,
    it is a step that differs by more than half a turn from the trapezoidal integral of qd.
    """
    steps = np.diff(q)
    if t is not None and qd is not None:
        steps -= 0.5 * np.diff(t) * (qd[1:] + qd[:-1])
    found: Array = np.rint(steps / (2.0 * np.pi))
    return found


def derivative(t: Array, x: Array, order: int, at: Array | None = None) -> Array:
    """Return a derivative of x (T, m) at increasing times t (T,), or at times `at` (S,).

    It is taken from the quintic not-a-knot spline through x, which assumes nothing about the ends.
    For a smooth motion the error of the first derivative is of the order of the step to the power
    5, of the second to the power 4.  T >= FEWEST_ROWS. Raises RobodynError if the times are too
    unequal for floats.
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
    """Return x (T, m), given at increasing times t (T,), at times `at` (S,) between these.

    Uses Akima splines, which are robust to noise in closely spaced rows.  Raises RobodynError if
    the times are too unequal for floats.
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
        """Return p, p', p'' at u (T,) in [0, 1]."""
        return self.within(u, piece_at(self.breaks, u) if piece is None else piece)

    def within(self, u: Array, piece: Pieces) -> Values:
        """Return p, p', p'' at u (T,), each from the given piece."""
        raise NotImplementedError

    def returns(self) -> Array:
        """Return values of u, ordered, at which the joints stand and move as at the start."""
        return np.zeros(0)


def piece_at(breaks: Array, u: Array) -> Pieces:
    """Return the piece that contains each u; at a break, the one after it."""
    return np.searchsorted(breaks[1:-1], u, side="right").astype(np.int64)


def travels(path: JointPath, edges: Array) -> Array:
    """Return the approximate travel of the fastest joint in each part of a path (parts,), rad.

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
    """Straight legs in joint space from point to point, at rest at each point.

    points are (K, m); `times` (K,) increase from 0 to 1.
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
    """A spline through points (K, m) at increasing `times` (K,) from 0 to 1."""

    def __init__(self, points: Array, times: Array, kind: str, natural: bool = False) -> None:
        self.breaks = self.knots = times
        self._ends = points[0], points[-1]
        self._zero = [1] * (not natural) + [2] * (natural or kind == "quintic")  # at the ends
        self.travel = _way(points)
        self._curve = spline(times, points, kind, natural)

    def within(self, u: Array, piece: Pieces) -> Values:
        p, p1, p2 = values = [self._curve(u, order) for order in range(3)]  # which do not jump
        for at, point in zip((u == 0.0, u == 1.0), self._ends, strict=True):  # without rounding
            p[at] = point
            for order in self._zero:
                values[order][at] = 0.0
        return p, p1, p2


class Sweep(JointPath):
    """A chirp around a pose: p = pose + amplitude sin(phi), with frequencies first to last, Hz.

    phi = 2 pi T (f0 u + (f1 - f0) u^2 / 2): the frequency f0 + (f1 - f0) u grows linearly in time,
    so the path depends on the duration T.
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
    """Return the path of a profile through points (K, m), at rest at both ends.

    `times` (K,) increase (any unit); without them, time is proportional to the distance in joint
    space.  With more than two points, cubic and quintic are splines of continuity C2 and C4; other
    profiles stop at each point.  Raises InputError.
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
    """Return the length of the path through points (K, m) for the joint with the longest one."""
    return float(np.abs(np.diff(points, axis=0)).sum(axis=0).max(initial=0.0))


class ConstantSpeed(Legs):
    """The path from `begin` (m,) by `way` (m,) at constant speed."""

    def __init__(self, begin: Array, way: Array) -> None:
        super().__init__(np.stack([begin, begin + way]), np.array([0.0, 1.0]), profile("constant"))

    def returns(self) -> Array:
        """Return values of u after which all joints have made whole turns."""
        turns = np.abs(np.diff(self.points, axis=0)[0]) / (2 * np.pi)
        fastest = float(turns.max(initial=0.0))
        if fastest <= 1.0:
            return np.zeros(0)
        u = np.arange(1, min(MOST_TURNS, int(fastest)) + 1) / fastest
        each = u[:, None] * turns
        off = 2 * np.pi * np.abs(each - np.round(each)).max(axis=1) / u  # at the end of the path
        return np.asarray(u[(off < WHOLE) & (u < 1.0)])


def spread(points: Array) -> Array:
    """Return times from 0 to 1 proportional to distances between points (K, m) in joint space."""
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
