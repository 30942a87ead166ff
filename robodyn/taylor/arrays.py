"""The Taylor series of a motion by numpy: for many links, and for extended precision.

The recurrences are those of `code.py`, on arrays over the links.  Plain floats serve large
mechanisms, where straight-line code would be long; numpy's longdouble serves as a reference.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.mechanism import Mechanism

Array = NDArray[Any]  # floats of the chosen precision


class ArraySeries:
    """Expands motions of one mechanism to one order, in one precision."""

    def __init__(
        self, mechanism: Mechanism, order: int, torques: Array | None, dtype: type = np.float64
    ) -> None:
        if torques is not None and mechanism.has_state_forces:
            raise ValueError("springs and the like are torques that change: they come by `push`")
        self.mechanism, self.order, self.dtype = mechanism, order, dtype
        self.complex = np.result_type(dtype, np.complex64)
        n = mechanism.n
        arrays = mechanism.arrays
        self.J: Array = arrays.J.astype(dtype)
        self.A = np.asarray(arrays.A, self.complex)
        self.P = np.asarray(arrays.P, self.complex)
        self.angles: Array = arrays.angles.astype(dtype)
        self.weight = -np.asarray(mechanism.weights, self.complex).conj()
        self.moments: Array = np.asarray(mechanism.moments, dtype)
        self.damping: Array = np.asarray(mechanism.damping, dtype)
        self.torques: Array | None = None if torques is None else np.asarray(torques, dtype)
        self.relative: Array = np.eye(n, dtype=dtype)  # J^-1
        for k, above in enumerate(mechanism.parent):
            if above is not None:
                self.relative[k, above] = -1.0
        self.moving = torques is None or bool(self.damping.any())

    def expand(self, q: Array, qd: Array, push: Any = None) -> tuple[Array, Array | None]:
        """z (n, order + 2), links' turns from the start as r + i t; the joints' working torques.

        The latter, those that change the energy, tau + Q - D qd (n, order + 1), is None where it
        does not change.
        """
        n, p, dtype = self.mechanism.n, self.order, self.dtype
        r = len(self.P)
        E = np.exp(1j * (self.J @ q)).astype(self.complex)
        w = self.J @ qd
        W = E.conj()[:, None] * self.A * E
        PE = self.P * E
        geared = bool(self.angles.any())
        system: Array = np.zeros((n + r, n + r), dtype)
        system[:n, :n] = W.real
        system[n:, :n] = self.angles - PE.imag
        system[:n, n:] = system[n:, :n].T
        inverse = _inverse(system)
        weight = E.conj() * self.weight
        z = np.zeros((n, p + 2), self.complex)
        z[:, 0], z[:, 1] = 1.0, 1j * w
        F = np.zeros((n, p), self.complex)
        working: Array = np.zeros((n, p + 1), dtype)
        constant: Array = np.zeros(n, dtype) if self.torques is None else self.torques
        for k in range(p):
            if self.moving:
                net, working[:, k] = self._net(z, k, push)
            else:
                net = constant if k == 0 else np.zeros(n, dtype)
            scale = dtype((k + 1) * (k + 2))
            inner = (z[:, 1 : k + 2].conj() * z[:, k + 1 : 0 : -1]).real.sum(axis=1)
            N = -scale / 2 * inner
            T = self.relative.T @ net
            if k:
                T = T - (z[:, 1 : k + 1].conj() * F[:, k - 1 :: -1]).imag.sum(axis=1)
            b = T - W.imag @ N
            if k == 0:
                b = b - weight.imag + self.moments
            held = -PE.real @ N
            if geared:  # what the rates of order k + 1 are without what is unknown of z
                held -= dtype(k + 1) * (self.angles @ link_rates(z, k + 1))
            solution = inverse @ np.concatenate([b, held])
            P = N + 1j * solution[:n]
            F[:, k] = W @ P + PE.conj().T @ solution[n:]
            if k == 0:
                F[:, 0] += weight
            z[:, k + 2] = P / scale
        if self.moving:
            _, working[:, p] = self._net(z, p, push)
        return z, working if self.moving else None

    def _net(self, z: Array, k: int, push: Any) -> tuple[Array, Array]:
        """tau + Q - D qd of order k, (n,), with springs and without."""
        rates = self.relative @ link_rates(z, k)
        if self.torques is not None:
            tau = self.torques if k == 0 else np.zeros_like(self.torques)
        else:
            tau = np.asarray(push(rates.tolist()), self.dtype)
        n = self.mechanism.n
        damped = self.damping * rates
        return tau[:n] - damped, tau[-n:] - damped


def link_rates(z: Array, k: int) -> Array:
    """Coefficient k of w = Im(conj(z) z'), (n,)."""
    factors = np.arange(1.0, k + 2.0, dtype=z.real.dtype)
    return np.asarray((z[:, k::-1].conj() * (factors * z[:, 1 : k + 2])).imag.sum(axis=1))


def _inverse(matrix: Array) -> Array:
    """By LAPACK in double precision, by elimination with pivots in any other."""
    if matrix.dtype == np.float64:
        return np.asarray(np.linalg.inv(matrix))
    return solve_columns(matrix, np.eye(len(matrix), dtype=matrix.dtype))


def solve_columns(matrix: Array, columns: Array) -> Array:
    """matrix^-1 columns in any precision, by elimination with partial pivoting."""
    size = len(matrix)
    work = np.concatenate([matrix, columns], axis=1)
    for i in range(size):
        pivot = i + int(np.argmax(np.abs(work[i:, i])))
        if pivot != i:
            work[[i, pivot]] = work[[pivot, i]]
        work[i] = work[i] / work[i, i]
        others = np.arange(size) != i
        work[others] -= work[others, i, None] * work[i]
    return work[:, size:]
