"""Motions in extended precision: what errors are measured against.

Two computations that share the mechanism's constants and nothing else run in numpy's longdouble
(64 bits of mantissa where the platform has them): the Taylor series, and extrapolation of the
midpoint rule on (33).  What they differ by is the uncertainty of the reference: no error below it
can be claimed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.actuation import Actuation
from robodyn.mechanism import Mechanism
from robodyn.projection import CUT
from robodyn.taylor import step_size
from robodyn.taylor_arrays import ArraySeries, solve_columns
from robodyn.torque_series import TorqueSeries

Array = NDArray[np.float64]
Long = NDArray[Any]  # longdouble

ORDER = 30
TOLERANCE = 1e-20
SUBSTEPS = (2, 4, 6, 8, 10, 12, 14, 16)  # of the extrapolated midpoint rule
EXTRAPOLATED = 1e-17  # what a step of it may miss
LARGEST_STEP = 0.25  # s, of the extrapolation
LARGE = 12  # links, up to which the second computation is worth its time


class Reference(NamedTuple):
    """States (T, 2n) at the times asked for, and what two computations of them differ by."""

    y: Array
    uncertainty: float


def reference(
    mechanism: Mechanism, state: Array, times: Array, actuation: Actuation, project: bool = True
) -> Reference:
    """The motion from `state` (2n,) at t = 0, at increasing `times` > 0.

    For mechanisms of many links the second computation is another series, of other order and step.
    """
    first = _by_series(mechanism, state, times, actuation, ORDER, TOLERANCE)
    if mechanism.n <= LARGE:
        second = _by_extrapolation(mechanism, state, times, actuation)
    else:
        second = _by_series(mechanism, state, times, actuation, ORDER - 9, 100 * TOLERANCE)
    apart = float(np.abs(first - second).max())
    eps = float(np.finfo(float).eps)
    return Reference(first.astype(float), max(apart, eps))


# -- the Taylor series ---------------------------------------------------------------------------


def _by_series(
    mechanism: Mechanism,
    state: Array,
    times: Array,
    actuation: Actuation,
    order: int,
    tolerance: float,
) -> Long:
    n = mechanism.n
    constants = None if actuation.constants is None else np.array(actuation.constants)
    series = ArraySeries(mechanism, order, constants, np.longdouble)
    torques = TorqueSeries(actuation, n) if constants is None else None
    closing = _Closing(mechanism)
    y = closing(state.astype(np.longdouble))
    rows, t = [], np.longdouble(0.0)
    orders = np.arange(order + 2).astype(np.longdouble)
    for end in times.astype(np.longdouble):
        while t < end:
            push = torques.begin(float(t), y.astype(float).tolist(), 1.0) if torques else None
            z, _ = series.expand(y[:n], y[n:], push)
            h = min(end - t, np.longdouble(step_size(z, tolerance, tolerance)))
            for kink in actuation.kinks:
                if t < kink < t + h:
                    h = kink - t
            powers = h**orders
            turn = (z * powers).sum(axis=1)
            slope = (z[:, 1:] * (orders[1:] * powers[:-1])).sum(axis=1)
            rate = (turn.conj() * slope).imag / np.abs(turn) ** 2
            way = np.arctan2(turn.imag, turn.real)
            y = closing(np.concatenate([y[:n] + series.relative @ way, series.relative @ rate]))
            t = end if t + h >= end else t + h
        rows.append(y)
    return np.array(rows)


# -- extrapolation of the midpoint rule ----------------------------------------------------------


def _by_extrapolation(
    mechanism: Mechanism, state: Array, times: Array, actuation: Actuation
) -> Long:
    rates = _rates(mechanism, actuation)
    closing = _Closing(mechanism)
    y = closing(state.astype(np.longdouble))
    t, h = np.longdouble(0.0), np.longdouble(LARGEST_STEP / 8)
    rows = []
    for end in times.astype(np.longdouble):
        while t < end:
            step = min(h, end - t)
            for kink in actuation.kinks:
                if t < kink < t + step:
                    step = kink - t
            new, error = _extrapolated(rates, t, y, step)
            scale = EXTRAPOLATED * (1.0 + float(np.abs(y).max()))
            factor = 0.9 * (scale / max(error, 1e-25)) ** (1.0 / (2 * len(SUBSTEPS) - 1))
            if error <= scale:
                y = closing(new)
                t = end if t + step >= end else t + step
                h = np.longdouble(min(LARGEST_STEP, float(step) * min(2.0, factor)))
            else:
                h = np.longdouble(float(step) * max(0.3, factor))
        rows.append(y)
    return np.array(rows)


def _extrapolated(rates: Any, t: Any, y: Long, step: Any) -> tuple[Long, float]:
    """Gragg's midpoint rule with more and more substeps, extrapolated to none; its error."""
    table: list[Long] = []
    for k, count in enumerate(SUBSTEPS):
        h = step / count
        before, now = y, y + h * rates(t, y)
        for i in range(1, count):
            before, now = now, before + 2 * h * rates(t + i * h, now)
        row = [(before + now + h * rates(t + step, now)) / 2]
        for j in range(1, k + 1):
            ratio = np.longdouble(count) / SUBSTEPS[k - j]
            row.append(row[-1] + (row[-1] - table[j - 1]) / (ratio * ratio - 1))
        table = row
    return table[-1], float(np.abs(table[-1] - table[-2]).max())


def _rates(mechanism: Mechanism, actuation: Actuation) -> Any:
    """dy/dt by (33), from the closed forms of M, C, G and Psi in joint coordinates."""
    n, arrays = mechanism.n, mechanism.arrays
    J = arrays.J.astype(np.longdouble)
    A = arrays.A.astype(np.clongdouble)
    P = arrays.P.astype(np.clongdouble)
    weight = np.conj(mechanism.gamma) * np.asarray(mechanism.B, np.clongdouble)
    damping = np.asarray(mechanism.damping, np.longdouble)
    torques = actuation.function(n)

    def rates(t: Any, y: Long) -> Long:
        q, qd = y[:n], y[n:]
        E, w = np.exp(1j * (J @ q)), J @ qd
        W = E.conj()[:, None] * A * E
        tau = np.asarray(torques(float(t), y.astype(float).tolist()), np.longdouble)
        force = tau - damping * qd + J.T @ (W.imag @ w**2 - (weight * E).imag)
        M = J.T @ W.real @ J
        if not len(P):
            return np.concatenate([qd, solve_columns(M, force[:, None])[:, 0]])
        Psi = -(P * E).imag @ J
        bend = (P * E).real @ w**2  # -Psidot qd
        inverse = solve_columns(M, np.concatenate([force[:, None], Psi.T], axis=1))
        free, X = inverse[:, 0], inverse[:, 1:]
        multipliers = solve_columns(Psi @ X, (bend - Psi @ free)[:, None])[:, 0]
        return np.concatenate([qd, free + X @ multipliers])

    return rates


class _Closing:
    """The nearest closed state, by Newton steps in extended precision."""

    def __init__(self, mechanism: Mechanism) -> None:
        arrays = mechanism.arrays
        self.n = mechanism.n
        self.J = arrays.J.astype(np.longdouble)
        self.P = arrays.P.astype(np.clongdouble)
        self.offset = np.asarray(arrays.offset, np.longdouble)

    def __call__(self, y: Long) -> Long:
        if not len(self.P):
            return y
        n = self.n
        q, qd = y[:n], y[n:]
        for _ in range(4):
            PE = self.P * np.exp(1j * (self.J @ q))
            Psi = -PE.imag @ self.J
            gap = PE.real.sum(axis=1) + self.offset
            right = np.stack([gap, Psi @ qd], axis=1)
            normal = Psi @ Psi.T
            if float(np.abs(np.linalg.eigvalsh(normal.astype(float))).min()) < CUT:
                return y  # next to a change point: the two computations will tell
            change = Psi.T @ solve_columns(normal, right)
            q, projected = q - change[:, 0], qd - change[:, 1]
            if float(np.abs(gap).max()) < 1e-17:
                break
        return np.concatenate([q, projected])
