"""The states of many motions at once, as numpy over lanes: energies, and closures kept.

The numbers are those of `taylor/layout.py`: lanes share `whole`, and each has its own `real` where
they differ.  Every quantity is an array whose last axis runs over the lanes, B of them.
"""

from __future__ import annotations

import copy
import math
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from robodyn.sweeps.lane_forces import LaneForces
from robodyn.taylor import HOPELESS, PASSES
from robodyn.taylor.layout import Layout

Array = NDArray[np.float64]
Number = Any  # a float that all lanes share, or an array (B,)


class Skyline:
    """Symmetric matrices in the layout of `taylor/layout.py`, one a lane, as rows of entries."""

    def __init__(self, whole: list[int], first: int, start: int, size: int) -> None:
        self.first = whole[first : first + size]
        self.start = whole[start : start + size]
        self.size = size
        self.numbers = self.start[-1] + size if size else 0

    def factorise(self, L: Array) -> Array:
        """L D L^T of (numbers, B), in place; the inverse of D (size, B)."""
        inverse = np.empty((self.size, L.shape[1]))
        for i, (fi, si) in enumerate(zip(self.first, self.start, strict=True)):
            for j in range(fi + 1, i):
                low, sj = max(fi, self.first[j]), self.start[j]
                for m in range(low, j):
                    L[si + j] -= L[si + m] * L[sj + m]
            d = L[si + i]
            for j in range(fi, i):
                value = L[si + j].copy()
                L[si + j] *= inverse[j]
                d -= value * L[si + j]
            np.divide(1.0, d, out=inverse[i])
        return inverse

    def solve(self, L: Array, inverse: Array, x: Array) -> None:
        """x (size, B) := (L D L^T)^-1 x, in place."""
        for i, (fi, si) in enumerate(zip(self.first, self.start, strict=True)):
            for j in range(fi, i):
                x[i] -= L[si + j] * x[j]
        x *= inverse
        for i in range(self.size - 1, 0, -1):
            for j in range(self.first[i], i):
                x[j] -= L[self.start[i] + j] * x[i]


class LaneModel:
    """The numbers of lanes: their kinematics, energies, and the closing of their states.

    `real` (R,) is what all lanes share, or (R, B) what each has; `forces` act besides.
    """

    def __init__(
        self, whole: NDArray[np.int64], real: Array, at: Layout, forces: LaneForces | None = None
    ) -> None:
        self.at, self.real, self.forces = at, real, forces
        w = whole.tolist()
        n, r = at.n, at.rows
        self.n, self.r, self.order = n, r, at.order
        self.parent = [None if k < 0 else k for k in w[at.parent : at.parent + n]]
        self.outward = w[at.outward : at.outward + n]
        self.place = w[at.place : at.place + n + r]
        self.A = [
            (j, w[at.A_link + e], e, w[at.A_spot + e])
            for j in range(n)
            for e in range(w[at.A_start + j], w[at.A_start + j + 1])
        ]
        self.P = [
            (row, w[at.P_link + e], e, w[at.P_spot + e])
            for row in range(r)
            for e in range(w[at.P_start + row], w[at.P_start + row + 1])
        ]
        self.system = Skyline(w, at.first, at.start, n + r)
        self.normal = Skyline(w, at.normal_first, at.normal_start, r)
        self.normal_place = w[at.normal_place : at.normal_place + r]
        self.normal_row = w[at.normal_row : at.normal_row + r]
        self._room: dict[str, Array] = {}
        self._free: Array = np.zeros(0)  # torques without a potential, of the forces

    def kept(self, lanes: NDArray[Any]) -> None:
        """Go on with these lanes alone."""
        if self.real.ndim == 2:
            self.real = np.ascontiguousarray(self.real[:, lanes])
        if self.forces is not None:
            self.forces = self.forces.some(lanes)

    def some(self, lanes: NDArray[Any]) -> Self:
        """Another of these lanes alone."""
        other = copy.copy(self)
        other.kept(lanes)
        return other

    def number(self, begin: int, k: int = 0) -> Number:
        """Number k of those that begin there in `real`."""
        return self.real[begin + k]

    def any(self, begin: int) -> bool:
        """Whether any of the n numbers there is not zero."""
        return bool(self.real[begin : begin + self.n].any())

    # -- kinematics --------------------------------------------------------------------------------

    def absolute(self, joint: Array) -> Array:
        """Sums along the paths from the ground (n, B), as alpha = J q."""
        total = joint.copy()
        for k in self.outward:
            above = self.parent[k]
            if above is not None:
                total[k] += total[above]
        return total

    def relative(self, absolute: Array) -> Array:
        """Joint values of absolute ones, along the axis before the last."""
        own = absolute.copy()
        for k, above in enumerate(self.parent):
            if above is not None:
                own[..., k, :] -= absolute[..., above, :]
        return own

    def energies(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """KE and PE less its constant (B,), J."""
        at, alpha, w = self.at, self.absolute(q), self.absolute(qd)
        c, s = np.cos(alpha), np.sin(alpha)
        KE, PE = np.zeros(q.shape[1]), np.zeros(q.shape[1])
        for j in range(self.n):
            KE += self.number(at.inertia, j) * w[j] * w[j]
            PE -= self.number(at.weight_re, j) * c[j] + self.number(at.weight_im, j) * s[j]
            PE -= self.number(at.moment, j) * alpha[j]
        for j, l, e, _ in self.A:
            x = c[j] * c[l] + s[j] * s[l]
            y = c[j] * s[l] - s[j] * c[l]
            KE += (self.number(at.A_re, e) * x - self.number(at.A_im, e) * y) * w[j] * w[l]
        if self.forces is not None:
            PE += self.forces.potential(q, c, s)
        return 0.5 * KE, PE

    # -- closures ----------------------------------------------------------------------------------

    def close(self, q: Array, qd: Array) -> Array:
        """Move states (n, B) in place to the nearest that close; their qualities (B,)."""
        at, B = self.at, q.shape[1]
        if not self.r:
            return np.full(B, math.inf)
        before, moving = np.full(B, math.inf), np.ones(B, bool)
        quality = np.full(B, math.inf)
        for trial in range(PASSES + 1):
            alpha = self.absolute(q)
            c, s = np.cos(alpha), np.sin(alpha)
            x = np.empty((self.r, B))
            for row in range(self.r):
                x[self.normal_place[row]] = self.number(at.offset, row)
            for row, l, e, _ in self.P:
                gap = self.number(at.P_re, e) * c[l] - self.number(at.P_im, e) * s[l]
                x[self.normal_place[row]] += gap
            largest = np.abs(x).max(axis=0)
            Psi, L, inverse, quality = self._normal(c, s)
            # what is closed to rounding stays: moving it would add noise
            done = (largest <= self.number(at.closed)) | (largest > 0.5 * before)
            moving &= ~done & (quality > HOPELESS)
            if trial == PASSES or not moving.any():
                break
            before = np.where(moving, largest, before)
            q -= np.where(moving, self._least(Psi, L, inverse, x), 0.0)
        x = np.empty((self.r, B))
        for row in range(self.r):
            x[self.normal_place[row]] = (Psi[row] * qd).sum(axis=0)
        qd -= np.where(quality > HOPELESS, self._least(Psi, L, inverse, x), 0.0)
        return quality

    def _normal(self, c: Array, s: Array) -> tuple[Array, Array, Array, Array]:
        """Psi (r, n, B), Psi Psi^T factorised, and its least relative pivot (B,)."""
        at, B = self.at, c.shape[1]
        Psi = self._jacobian(c, s)
        L = np.zeros((self.normal.numbers, B))
        for i, row in enumerate(self.normal_row):
            for j in range(self.normal.first[i], i + 1):
                other = Psi[self.normal_row[j]]
                L[self.normal.start[i] + j] = (Psi[row] * other).sum(axis=0)
        inverse = self.normal.factorise(L)
        pivots = [
            L[self.normal.start[i] + i] / self.number(at.size, row)
            for i, row in enumerate(self.normal_row)
        ]
        return Psi, L, inverse, np.nan_to_num(np.min(pivots, axis=0), nan=-math.inf)

    def leaps(self, q: Array, new_q: Array) -> NDArray[np.bool_]:
        """Which steps (B,) cross a singular configuration, as `change_points.Misses` tells it."""
        if not self.r:
            return np.zeros(q.shape[1], bool)
        alpha, new = self.absolute(q), self.absolute(new_q)
        Psi = self._jacobian(np.cos(alpha), np.sin(alpha))
        other = self._jacobian(np.cos(new), np.sin(new))
        product = np.einsum("rnb,snb->brs", Psi, other)
        return np.asarray(np.linalg.slogdet(product)[0] < 0.0)

    def _jacobian(self, c: Array, s: Array) -> Array:
        """Psi (r, n, B)."""
        Psi = np.zeros((self.r, self.n, c.shape[1]))
        for row, l, e, _ in self.P:
            Psi[row, l] = -(
                self.number(self.at.P_re, e) * s[l] + self.number(self.at.P_im, e) * c[l]
            )
        for k in reversed(self.outward):
            above = self.parent[k]
            if above is not None:
                Psi[:, above] += Psi[:, k]
        return Psi

    def _least(self, Psi: Array, L: Array, inverse: Array, x: Array) -> Array:
        """Psi^T (Psi Psi^T)^-1 x, (n, B)."""
        self.normal.solve(L, inverse, x)
        ordered = x[self.normal_place]
        return np.asarray(np.einsum("rnb,rb->nb", Psi, ordered))
