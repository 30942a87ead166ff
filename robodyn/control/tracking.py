"""The reference of a controller: rows of q_ref, qd_ref, qdd_ref, and values between them.

Between its rows the reference is a polynomial in time, of the degree that the rows determine:

- q, qd, qdd given: quintic Hermite, so that q_ref is twice continuously differentiable; - q, qd
given: cubic Hermite; qdd_ref jumps at a row; - q given: the cubic spline (not-a-knot), twice
continuously differentiable.

Angles must continue past a full turn: apply `numpy.unwrap` to wrapped ones first.

qd_ref and qdd_ref are always the derivatives of q_ref.  Beyond its end a reference may be held:
q_ref stays, and qd_ref = qdd_ref = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import comb
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.errors import InputError
from robodyn.tables.arrays import Array
from robodyn.trajectories.joint_paths import hermite

if TYPE_CHECKING:
    from robodyn.trajectories.reference import ReferenceMotion

BEND = 1e-9  # part of the largest acceleration by which pieces that meet smoothly may differ
CUTS = 64  # of each piece of a motion that is no polynomial
EXACT = 1e-12  # part of the angles by which a polynomial may miss a motion that is one
ROUNDING = 1e3 * np.finfo(float).eps  # of q, which the accelerations between close rows magnify


class ReferenceTable:
    """A reference motion of m joints: rows at increasing times (T,), in SI units.

    q is (T, m), and so are qd and qdd if given; qdd needs qd.  Raises InputError, which names
    `where`, for rows that make no motion.
    """

    def __init__(
        self,
        times: ArrayLike,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        qdd: ArrayLike | None = None,
        where: str = "reference",
    ) -> None:
        stamps = np.asarray(times, float)
        given = [np.asarray(x, float) for x in (q, qd, qdd) if x is not None]
        if qd is None and qdd is not None:
            raise InputError("qdd", where=where, limit="needs qd beside it")
        _check(stamps, given, where)
        if len(given) == 1:
            from scipy.interpolate import CubicSpline

            pieces = np.moveaxis(CubicSpline(stamps, given[0]).c[::-1], 0, -1)
        else:
            pieces = np.moveaxis(hermite(stamps, *given), 1, -1)
        self._consist(where, stamps.tolist(), pieces.copy())

    def __repr__(self) -> str:
        span = f"t = {self.times[0]:.6g} to {self.times[-1]:.6g} s"
        return f"<ReferenceTable of {self.joints} joints: {len(self.times)} rows, {span}>"

    def _consist(self, where: str, times: list[float], coefficients: Array) -> ReferenceTable:
        self.where, self.times = where, times
        self.coefficients = coefficients  # (T - 1, m, degree + 1) of t - times[k]
        self.joints = coefficients.shape[1]
        bends, jumps, stops = _kinks(np.array(times), coefficients)
        self.jumps = bool(jumps.any())  # whether qdd_ref does at some row
        self.stops = bool(stops.any())  # whether qd_ref does, where the reference is held
        inner = np.array(times[1:-1])
        self.kinks: list[float] = inner[bends | stops].tolist()  # where a derivative jumps
        return self

    @classmethod
    def set_point(cls, q: ArrayLike, t: float) -> ReferenceTable:
        """Return a reference that stays at q (m,) from 0 to t (s; t may be negative)."""
        coefficients = np.asarray(q, float)[None, :, None] * np.array([1.0, 0.0, 0.0])
        return object.__new__(cls)._consist("set-point", [min(t, 0.0), max(t, 0.0)], coefficients)

    @classmethod
    def along(cls, motion: ReferenceMotion) -> ReferenceTable:
        """Return the reference of the actuated joints along a motion.

        Pieces that are polynomials in time are exact; others are off by about 1e-11 of their
        travel.
        """
        path, T = motion.path, motion.duration
        for cuts in (1, CUTS):
            u = np.linspace(path.breaks[:-1], path.breaks[1:], cuts, endpoint=False).T.ravel()
            u = np.append(u, path.breaks[-1])
            piece = np.arange(len(path.breaks) - 1).repeat(cuts)
            # each part has ends of its own: qdd may jump between parts
            ends = zip(path.driven(u[:-1], piece), path.driven(u[1:], piece), strict=True)
            rows = [np.stack(pair, axis=1) / T**d for d, pair in enumerate(ends)]
            times = motion.begin + u * T
            pieces = [
                hermite(times[k : k + 2], *(x[k] for x in rows)) for k in range(len(times) - 1)
            ]
            coefficients = np.moveaxis(np.concatenate(pieces), 1, -1)
            found = object.__new__(cls)._consist("reference", times.tolist(), coefficients)
            inside = u[:-1] + 0.3 * np.diff(u)  # halfway even another curve may meet by symmetry
            exact = path.driven(inside, piece)[0]
            miss = np.abs(found.at(motion.begin + inside * T)[0] - exact).max()
            if miss <= EXACT * np.abs(exact).max():
                break
        return found

    def until(self, t: float) -> ReferenceTable:
        """Return the reference, held at its end until t if that is later."""
        end = self.times[-1]
        if not t > end:
            return self
        held = np.zeros_like(self.coefficients[:1])
        held[0, :, 0] = self.at(end)[0]
        coefficients = np.concatenate([self.coefficients, held])
        return object.__new__(ReferenceTable)._consist(self.where, [*self.times, t], coefficients)

    def of(self, joints: Sequence[int]) -> ReferenceTable:
        """Return the reference of some of these joints (from 0)."""
        coefficients = self.coefficients[:, list(joints)]
        return object.__new__(ReferenceTable)._consist(self.where, self.times, coefficients)

    def at(self, t: ArrayLike, side: Literal["left", "right"] = "right") -> tuple[Array, Array]:
        """Return q_ref and qd_ref (..., m) at times t (...), on the given side of a row."""
        c, x = self._piece(t, side)
        q, qd = np.zeros(c.shape[:-1]), np.zeros(c.shape[:-1])
        for d in reversed(range(c.shape[-1])):
            qd = qd * x + q
            q = q * x + c[..., d]
        return q, qd

    def accelerations(self, t: ArrayLike) -> Array:
        """Return qdd_ref (..., m) at times t (...), after a row."""
        c, x = self._piece(t, "right")
        qdd = np.zeros(c.shape[:-1])
        for d in reversed(range(2, c.shape[-1])):
            qdd = qdd * x + d * (d - 1) * c[..., d]
        return qdd

    def _piece(self, t: ArrayLike, side: Literal["left", "right"]) -> tuple[Array, Array]:
        """Return the coefficients at times t (...), and the time (..., 1) within the piece."""
        t = np.asarray(t, float)
        k = np.searchsorted(self.times, t, side=side) - 1
        k = np.clip(k, 0, len(self.times) - 2)
        return self.coefficients[k], (t - np.asarray(self.times)[k])[..., None]


def _check(times: Array, given: list[Array], where: str) -> None:
    if times.ndim != 1 or len(times) < 2:
        rows = len(times) if times.ndim == 1 else times.shape
        raise InputError("rows", where=where, value=rows, limit="a reference needs two or more")
    for name, values in zip(("q", "qd", "qdd"), given, strict=False):
        if values.ndim != 2 or values.shape != (len(times), given[0].shape[-1]):
            limit = f"must be ({len(times)}, joints), and the same for q, qd and qdd"
            raise InputError(f"shape of {name}", where=where, value=values.shape, limit=limit)
    for name, values in zip(("t", "q", "qd", "qdd"), (times, *given), strict=False):
        if not np.isfinite(values).all():
            raise InputError(name, where=where, limit="must be finite")
    for before, after in pairwise(times.tolist()):
        if not after > before:
            limit = f"times must increase; the row before has {before:g}"
            raise InputError("t", where=where, value=f"{after:g}", limit=limit)


def _kinks(times: Array, c: Array) -> list[NDArray[np.bool_]]:
    """Return at which inner rows (T - 2,) a derivative of qd jumps, at which qdd, and at which qd.

    A smooth motion in closely spaced rows has no jumps: what differs is below every tolerance.
    """
    degree = c.shape[-1] - 1
    h = np.diff(times)[:, None]
    before, after = c[:-1], c[1:]
    jumps = [
        after[..., d]
        - sum(comb(j, d) * before[..., j] * h[:-1] ** (j - d) for j in range(d, degree + 1))
        for d in range(degree + 1)
    ]
    size = np.abs(2.0 * c[..., 2]).max(initial=0.0)
    closest = np.minimum(h[:-1], h[1:])
    rounding = ROUNDING * np.abs(c[..., 0]).max(initial=0.0) / closest
    small, slow = BEND * size + rounding / closest, BEND * np.abs(c[..., 1]).max() + rounding
    apart = sum(d * (d - 1) * np.abs(jumps[d]) * h[1:] ** (d - 2) for d in range(2, degree + 1))
    found = apart > small, 2.0 * np.abs(jumps[2]) > small, np.abs(jumps[1]) > slow
    return [each.any(axis=-1) for each in found]
