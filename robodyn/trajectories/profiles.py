"""Profiles s(u) of a motion from rest to rest, u from 0 to 1 as the time goes from 0 to T.

    cubic         s = 3 u^2 - 2 u^3                    peak s' = 3/2     peak s'' = 6
    quintic       s = 10 u^3 - 15 u^4 + 6 u^5          peak s' = 15/8    peak s'' = 10/sqrt(3)
    cycloidal     s = u - sin(2 pi u) / (2 pi)         peak s' = 2       peak s'' = 2 pi
    trapezoidal   s'' = +a, 0, -a over the parts        peak s' = 1/(1-alpha)
                  alpha, 1 - 2 alpha, alpha             peak s'' = a = 1/(alpha (1-alpha))
    constant      s = u, a motion at constant speed    peak s' = 1       peak s'' = 0

A joint that goes from q0 to q1 in the time T moves by q = q0 + (q1 - q0) s(t/T), so that
qd = (q1 - q0) s'/T and qdd = (q1 - q0) s''/T^2.  (Craig, Introduction to Robotics, chapter 7;
Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines and Robots, chapters 2 and 3.)

Each profile is symmetric, s(1 - u) = 1 - s(u), and is computed from its nearer end: so it ends
exactly, at rest, as it begins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, pi

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import InputError
from robodyn.tables.arrays import Array, Truth

Pieces = NDArray[np.int64]
# w = the way in u from the nearer end, and whether it lies on a ramp: s, s', s'' there
Half = Callable[[Array, Truth], tuple[Array, Array, Array]]

NAMES = ("cubic", "quintic", "trapezoidal", "cycloidal", "constant")
ACCELERATION = 1 / 3  # part of the time in which a trapezoidal profile speeds up


@dataclass(frozen=True, slots=True)
class Profile:
    """One profile; `breaks` are the ends of its pieces, between which it is smooth."""

    name: str
    breaks: tuple[float, ...]
    half: Half

    def evaluate(self, u: Array, left: Array, piece: Pieces) -> tuple[Truth, Array, Array, Array]:
        """At u and left = 1 - u, (T,): whether it is late, s from the nearer end, s' and s''.

        Where it is late the first of the numbers is 1 - s.  `piece` tells on which side of a
        break a value is wanted.
        """
        late = u > 0.5
        last = len(self.breaks) - 2
        if last:
            late = np.where(piece == 0, False, np.where(piece == last, True, late))
        ramp = (piece == 0) | (piece == last)
        s, rate, acceleration = self.half(np.where(late, left, u), ramp)
        return late, s, rate, np.where(late, -acceleration, acceleration)


def profile(name: str, acceleration: float = ACCELERATION) -> Profile:
    """The profile of this name; `acceleration` is the part alpha of a trapezoidal one.

    Raises InputError for a name that is none, or alpha outside of 0 < alpha <= 1/2.
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
