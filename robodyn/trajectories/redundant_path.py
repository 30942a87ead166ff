"""The path of a mechanism that has more freedoms than its path asks for, by least motion.

With A the columns of Psi of the passive joints y (displacements in units of a length), D those of
the actuated ones, which follow p(u), the closures keep A y' = -D p', and

    y' = -A^+ D p' + (1 - A^+ A) w         w = k s'(u) (posture - y)

is of least length (w = 0), or pulled toward a posture as far as the path leaves it free: what is
free goes there by exp(-k s), s(u) the quintic profile.  Its rate, with y' = w + A^T mu, is

    y'' = -A^+ (D p'' + Psidot q') + (1 - A^+ A) (w' + Adot^T mu)

(Adot^T mu by polarisation: Psidot q' is a quadratic form in q'.)  y is integrated by DOP853 far
more closely than it is told, then closed by Newton's method.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from robodyn.dynamics.closed_form import closure_bias, scaled_jacobian
from robodyn.dynamics.placed import matvec
from robodyn.engines.singular_values import svd
from robodyn.loops.closing import loop_size
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array, Truth
from robodyn.trajectories.continuation import (
    DEAD,
    MOST_NODES,
    PathEndError,
    TravelError,
    Watch,
    corrected,
)
from robodyn.trajectories.joint_paths import JointPath, Pieces, Values
from robodyn.trajectories.loop_path import FEWEST, Samples, WholePath, samples
from robodyn.trajectories.profiles import profile

PULL = 10.0  # toward a posture, over the whole path
TOLERANCE = 1e-13  # of the integration, relative and in rad
LEAST_STEPS = 4  # of a piece
PROGRESS = profile("quintic")
REASON = "that is as far as they can be closed on this branch"


class RedundantPath(WholePath):
    """The path from the closed state `start` (n,) on; perhaps toward `posture` (n,).

    Raises PathEndError where the loops cannot be closed all the way.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        path: JointPath,
        start: Array,
        posture: Array | None,
        watch: Watch = lambda u: None,
    ) -> None:
        from scipy.integrate import OdeSolution

        super().__init__(mechanism, path)
        self._driven, self._passive = list(mechanism.actuated), list(mechanism.passive)
        self._units = mechanism.arrays.units[self._passive]
        self._posture = None
        if posture is not None:
            turns = np.round((start - posture) / (2 * np.pi))
            turns[list(mechanism.slides)] = 0.0
            self._posture = (posture + 2 * np.pi * turns)[self._passive]
        if not self._regular(start):
            raise PathEndError(mechanism, 0.0, start, REASON)
        self._u, self._pieces = [0.0], list[int]()
        self._between = OdeSolution(*self._integrated(start, watch))

    def within(self, u: Array, piece: Pieces) -> Values:
        q, closed = self._closed(u, piece, self._between(u).T)
        if not closed.all():
            worst = int(np.argmin(closed))
            raise PathEndError(self.mechanism, float(u[worst]), q[worst], REASON)
        q1, q2 = self._rates(q, u, piece)
        return q, q1, q2

    def grid(self) -> Samples:
        pieces = np.array(self._pieces)
        share = max(4, -(-FEWEST // len(pieces)))
        return samples(np.array(self._u), pieces, np.full(len(pieces), share))

    def _integrated(self, here: Array, watch: Watch) -> tuple[list[float], list[Any]]:
        from scipy.integrate import DOP853

        between: list[Any] = []
        breaks = self.path.breaks.tolist()
        for piece, (u, end) in enumerate(pairwise(breaks)):
            of = np.array([piece])

            def rates(u: float, y: Array, of: Pieces = of) -> Array:
                at = np.array([u])
                q = self._whole(at, of, y[None])
                return np.asarray(self._rates(q, at, of, False)[0][0, self._passive])

            longest = (end - u) / LEAST_STEPS
            y, least = here[self._passive], TOLERANCE * float(self._units.min())
            solver: Any = DOP853(rates, u, y, end, longest, TOLERANCE, least)
            while solver.status == "running":
                solver.step()
                (q,), closed = self._closed(np.array([solver.t]), of, solver.y[None])
                if solver.status == "failed" or not closed[0] or not self._regular(q):
                    raise PathEndError(self.mechanism, self._u[-1], here, REASON)
                if len(self._u) > MOST_NODES:
                    limit = f"takes more than {MOST_NODES:,} steps"
                    raise TravelError(self.mechanism, f"{self.path.travel:.6g} rad", limit)
                self._u.append(solver.t)
                self._pieces.append(piece)
                between.append(solver.dense_output())
                watch(solver.t)
                here = q
        return self._u, between

    def _regular(self, q: Array) -> bool:
        s = np.linalg.svd(scaled_jacobian(self.mechanism, q)[:, self._passive], compute_uv=False)
        return bool(s[-1] > DEAD * loop_size(self.mechanism))

    def _whole(self, u: Array, piece: Pieces, y: Array) -> Array:
        q = np.empty((len(u), self.mechanism.n))
        q[:, self._driven], q[:, self._passive] = self.path.evaluate(u, piece)[0], y
        return q

    def _closed(self, u: Array, piece: Pieces, y: Array) -> tuple[Array, Truth]:
        return corrected(self.mechanism, self._whole(u, piece, y))

    def _rates(self, q: Array, u: Array, piece: Pieces, second: bool = True) -> tuple[Array, Array]:
        """q' and, if it is wanted, q'' at states q (T, n)."""
        mechanism, units = self.mechanism, self._units
        _, p1, p2 = self.path.evaluate(u, piece)
        Psi = scaled_jacobian(mechanism, q)
        D = Psi[..., self._driven] / mechanism.arrays.units[self._driven]
        U, s, Vt = svd(Psi[..., self._passive])
        up, rows = np.swapaxes(U, -1, -2), np.swapaxes(Vt, -1, -2)

        def onto(right: Array) -> Array:
            return matvec(rows, matvec(up, right) / s)

        def free(x: Array) -> Array:
            return np.asarray(x - matvec(rows, matvec(Vt, x)))

        pull = pull1 = np.zeros_like(q[:, self._passive])
        if self._posture is not None:
            _, s1, s2 = (x[:, None] for x in PROGRESS.half(u, u < 0.0))
            away = (self._posture - q[:, self._passive]) / units
            pull = PULL * s1 * away
        q1, q2 = np.zeros_like(q), np.zeros_like(q)
        y1 = onto(-matvec(D, p1)) + free(pull)
        q1[:, self._driven], q1[:, self._passive] = p1, units * y1
        if second:
            if self._posture is not None:
                pull1 = PULL * (s2 * away - s1 * y1)
            mu = matvec(U, matvec(Vt, y1 - pull) / s)
            size = np.abs(q1).max(axis=1)[:, None, None]
            way = np.where(size > 0.0, size, 1.0) * (
                units[:, None] * np.eye(mechanism.n)[self._passive]
            )
            two = [closure_bias(mechanism, q[:, None], q1[:, None] + x) for x in (way, -way)]
            bent = matvec((two[0] - two[1]) / (4.0 * np.where(size > 0.0, size, 1.0)), mu)
            y2 = onto(-matvec(D, p2) - closure_bias(mechanism, q, q1)) + free(pull1 + bent)
            q2[:, self._driven], q2[:, self._passive] = p2, units * y2
        return q1, q2
