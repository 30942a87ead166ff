"""The work of a torque that the steps of a run may have passed over.

Along each long step the torque is sampled, on the cubics that meet the step's ends, and its work
taken twice: at the eight times of a Gauss-Legendre rule, as a step of its length sees it, and at
many more.  Where the torque is smooth the two agree; their difference is work that was missed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from robodyn.tables.arrays import Array

Torques = Callable[[float, Sequence[float]], Sequence[float]]

SAMPLES = 1000  # of a run, at least
POINTS = 8  # of a Gauss-Legendre rule
LONG = 2  # samples that a step must span to be looked at: shorter ones are samples themselves


class UnseenWork:
    """Sums up what the steps of a run have missed, J."""

    def __init__(self, torques: Torques, t_end: float) -> None:
        self._torques, self._apart = torques, abs(t_end) / SAMPLES
        self._before: tuple[Array, Array, Array] | None = None
        self._sum = 0.0

    def __call__(self, t: Array, q: Array, qd: Array) -> Array:
        """What was missed from the start until each of the times t (k,), in states q, qd (k, n)."""
        if self._before is not None:
            t, q, qd = (
                np.concatenate([a, b]) for a, b in zip(self._before, (t, q, qd), strict=True)
            )
        missed = [
            self._missed(t[k : k + 2], q[k : k + 2], qd[k : k + 2]) for k in range(len(t) - 1)
        ]
        sums = self._sum + np.concatenate([[0.0], np.cumsum(missed)])
        result = sums if self._before is None else sums[1:]
        self._before, self._sum = (t[-1:], q[-1:], qd[-1:]), float(sums[-1])
        return np.asarray(result)

    def _missed(self, t: Array, q: Array, qd: Array) -> float:
        """The work over one step, closely sampled, less that by one rule."""
        h = float(t[1] - t[0])
        if not abs(h) > LONG * self._apart:
            return 0.0
        panels = max(2, int(abs(h) / (POINTS * self._apart)) + 1)
        u, weights = np.polynomial.legendre.leggauss(POINTS)
        u, weights = 0.5 * (u + 1.0), 0.5 * weights
        part = ((np.arange(panels)[:, None] + u) / panels).ravel()
        x = np.concatenate([u, part])[:, None]
        rise = (q[1] - q[0]) / h
        bend = x * (1.0 - x)
        states = q[0] + h * (x * rise + bend * ((1.0 - x) * (qd[0] - rise) - x * (qd[1] - rise)))
        rates = qd[0] + x * (qd[1] - qd[0]) + 6.0 * bend * (rise - 0.5 * (qd[0] + qd[1]))
        times = t[0] + h * x[:, 0]
        y = np.concatenate([states, rates], axis=1)
        try:
            torques = [
                self._torques(*each) for each in zip(times.tolist(), y.tolist(), strict=True)
            ]
        except (ArithmeticError, ValueError):  # beside the motion the torque may be undefined
            return 0.0
        power = (np.array(torques) * rates).sum(axis=1)
        close = weights @ power[POINTS:].reshape(panels, POINTS).sum(axis=0) / panels
        missed = float(h * (close - weights @ power[:POINTS]))
        return missed if np.isfinite(missed) else 0.0
