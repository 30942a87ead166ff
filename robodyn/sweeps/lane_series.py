"""The Taylor series of many motions at once, as numpy over lanes.

Series (K, n, B) have their orders along the first
axis, the links along the second, the lanes along the last.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robodyn.sweeps.lane_states import LaneModel

Array = NDArray[np.float64]


class LaneSeries(LaneModel):
    """Expands the motions of lanes."""

    def expand(self, q: Array, qd: Array) -> Array:
        """The coefficients of w, the links' absolute rates, to the layout's order (K - 1, n, B)."""
        at, n, B = self.at, self.n, q.shape[1]
        alpha = self.absolute(q)
        c0, s0 = np.cos(alpha), np.sin(alpha)
        L, inverse, Z = self._system(c0, s0)
        W, C, S, FX, FY = (self._series(name, B) for name in ("W", "C", "S", "FX", "FY"))
        W[0], C[0], S[0] = self.absolute(qd), c0, s0
        C[1], S[1] = -W[0] * s0, W[0] * c0
        if self.forces is not None:
            self.forces.begin(self.order + 1, q)
            self._free = self._series("free", B)
        damped, driven = self.any(at.damping), self.any(at.torque)
        x = np.empty((n + self.r, B))
        for k in range(self.order):
            # what is known of P_k
            X = np.einsum("mnb,mnb->nb", W[: k + 1], S[k + 1 : 0 : -1])
            Y = np.einsum("mnb,mnb->nb", W[: k + 1], C[k + 1 : 0 : -1])
            X *= -(k + 1.0)
            Y *= k + 1.0
            FX[k], FY[k] = 0.0, 0.0
            if k == 0:
                for j in range(n):
                    FX[0, j] = -self.number(at.weight_re, j)
                    FY[0, j] = -self.number(at.weight_im, j)
            for j, l, e, _ in self.A:
                re, im = self.number(at.A_re, e), self.number(at.A_im, e)
                FX[k, j] += re * X[l] - im * Y[l]
                FY[k, j] += re * Y[l] + im * X[l]
            load = np.einsum("mnb,mnb->nb", S[k::-1], FX[: k + 1])
            load -= np.einsum("mnb,mnb->nb", C[k::-1], FY[: k + 1])
            if self.forces is not None:
                held, self._free[k] = self.forces.torques(k, W, C, S)
                load += held + self._free[k]
            if damped or (driven and k == 0):
                self._joint_torques(load, W[k], k)
            if k == 0:
                for j in range(n):
                    load[j] += self.number(at.moment, j)
            x[self.place[:n]] = load
            for row in range(self.r):
                x[self.place[n + row]] = 0.0
            for row, l, e, _ in self.P:
                re, im = self.number(at.P_re, e), self.number(at.P_im, e)
                x[self.place[n + row]] -= re * X[l] - im * Y[l]
            self.system.solve(L, inverse, x)
            a = x[self.place[:n]]
            np.divide(a, k + 1.0, out=W[k + 1])
            C[k + 2] = (X / (k + 1.0) - W[k + 1] * s0) / (k + 2.0)
            S[k + 2] = (Y / (k + 1.0) + W[k + 1] * c0) / (k + 2.0)
            for j, l, e, _ in self.A:  # F_k in full
                FX[k, j] += Z[e][0] * a[l]
                FY[k, j] += Z[e][1] * a[l]
            for row, l, e, _ in self.P:
                minus_lambda = x[self.place[n + row]]
                FX[k, l] += self.number(at.P_re, e) * minus_lambda
                FY[k, l] -= self.number(at.P_im, e) * minus_lambda
        if self.forces is not None:
            self._free[self.order] = self.forces.torques(self.order, W, C, S)[1]
        return W[: self.order + 1]

    def power(self, W: Array) -> Array:
        """The coefficients of the power of torques, dampers and turning forces, (order + 1, B)."""
        at, own = self.at, self.relative(W)
        total = np.zeros((len(W), W.shape[2]))
        for j in range(self.n):
            total += self.number(at.torque, j) * own[:, j]
            damping = self.number(at.damping, j)
            if np.any(damping):
                for k in range(len(W)):
                    square = np.einsum("mb,mb->b", own[: k + 1, j], own[k::-1, j])
                    total[k] -= damping * square
        if self.forces is not None:
            for k in range(len(W)):
                total[k] += np.einsum("mnb,mnb->b", self._free[: k + 1], W[k::-1])
        return total

    def longest(self, W: Array, rtol: float, atol: float) -> Array:
        """The steps whose last terms are within the tolerance (B,), s; nan if not finite."""
        order = len(W) - 1
        speed = np.abs(W[0]).max(axis=0)
        h = np.full(W.shape[2], math.inf)
        for k in range(order - 3, order + 1):
            largest = np.abs(W[k]).max(axis=0)
            h = np.minimum(h, ((atol + rtol * speed) / largest) ** (1.0 / k))
            h = np.minimum(h, ((atol + rtol) * (k + 1) / largest) ** (1.0 / (k + 1)))
        finite = np.isfinite(W[order - 3 :].sum(axis=(0, 1)))
        return np.where(finite, h, math.nan)

    def _series(self, name: str, B: int) -> Array:
        """Room for a series, (order + 2, n, B)."""
        size = (self.order + 2) * self.n * B
        if name not in self._room or len(self._room[name]) < size:
            self._room[name] = np.empty(size)
        return self._room[name][:size].reshape(self.order + 2, self.n, B)

    def _joint_torques(self, load: Array, w: Array, k: int) -> None:
        """Add J^-T (tau - D qd) of order k; a joint takes from the parent what its link gets."""
        at = self.at
        for j, above in enumerate(self.parent):
            rate = w[j] if above is None else w[j] - w[above]
            torque = -self.number(at.damping, j) * rate
            if k == 0:
                torque = torque + self.number(at.torque, j)
            load[j] += torque
            if above is not None:
                load[above] -= torque

    def _system(self, c: Array, s: Array) -> tuple[Array, Array, list[tuple[Array, Array]]]:
        """[M Psi^T; Psi 0] factorised, and Z = i A E beside the diagonal."""
        at = self.at
        L = np.zeros((self.system.numbers, c.shape[1]))
        for j in range(self.n):
            i = self.place[j]
            L[self.system.start[i] + i] = self.number(at.inertia, j)
        Z = []
        for j, l, e, spot in self.A:
            re, im = self.number(at.A_re, e), self.number(at.A_im, e)
            Z.append((-(re * s[l] + im * c[l]), re * c[l] - im * s[l]))
            if spot >= 0:
                L[spot] = c[j] * Z[e][1] - s[j] * Z[e][0]
        for _, l, e, spot in self.P:
            L[spot] = -(self.number(at.P_re, e) * s[l] + self.number(at.P_im, e) * c[l])
        inverse = self.system.factorise(L)
        return L, inverse, Z
