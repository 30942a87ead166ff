"""The Taylor integrator as a solver class for scipy's solve_ivp.

    solve_ivp(None, (0, 10), y0, method=TaylorSolver, mechanism=mechanism, rtol=1e-12)

takes the steps that `simulate(..., method="taylor", engine="python")` takes.  The series come from
the mechanism; the function that solve_ivp is given serves nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DenseOutput, OdeSolver

from robodyn.mechanics import actuation as torque_sources
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import next_stop
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.torque_times import over_a_scene_run
from robodyn.tables.arrays import Array
from robodyn.taylor import Chunk, Status
from robodyn.taylor.engine_choice import stepping_engine
from robodyn.taylor.run import reach
from robodyn.taylor.steps import SteppingEngine


class TaylorSolver(OdeSolver):
    """y = (q, qd) of `mechanism` under the torques `tau`, as `robodyn.simulate` takes them.

    rtol and atol bound what a step may miss; `order` follows from them unless given.  A step stops
    at kinks of a table of torques.  Next to a change point the run fails: `simulate` crosses it.
    """

    def __init__(
        self,
        fun: Any,
        t0: float,
        y0: ArrayLike,
        t_bound: float,
        *,
        mechanism: Mechanism,
        tau: Sequence[float] | str | Actuation | None = None,
        rtol: float = 1e-9,
        atol: float = 1e-9,
        order: int | None = None,
        vectorized: bool = False,
    ) -> None:
        super().__init__(fun or _nothing, t0, np.asarray(y0, float), t_bound, vectorized)
        self.t: float
        self.y: Array
        if tau is None:
            tau = Actuation((0.0,) * mechanism.n)
        elif isinstance(tau, str):
            tau = torque_sources.expressions(mechanism, tau, "tau")
        elif not isinstance(tau, Actuation):
            tau = torque_sources.constant(mechanism, tau)
        if t0 == 0.0:
            tau = over_a_scene_run(mechanism, tau, self.y.tolist(), float(t_bound))
        self.engine = stepping_engine(mechanism, tau, rtol, atol, order=order)
        self.actuation = tau
        if tau.told is not None:
            tau.told.begin(self.y.tolist(), float(t_bound))

    def _step_impl(self) -> tuple[bool, str | None]:
        bound = next_stop(self.actuation.kinks, self.actuation.leaves, self.t, float(self.t_bound))
        chunk = self._advance(bound)
        misses = self.engine.misses
        if misses is not None and len(chunk.t):
            t, y = np.append(self.t, chunk.t), np.concatenate([self.y[None], chunk.y])
            if misses.leaps(t, y):  # what was met is known now, and holds the step
                chunk = self._advance(bound)
        if not len(chunk.t):
            words = {Status.STUCK: self.TOO_SMALL_STEP}
            return False, words.get(chunk.status, "an acceleration or a torque is not finite")
        self.t, self.y = float(chunk.t[0]), chunk.y[0]
        reach(self.actuation, self.t, self.y)
        return True, None

    def _advance(self, bound: float) -> Chunk:
        self.nfev += 1
        return self.engine.advance(self.t, self.y, bound, np.zeros(0), 1)

    def _dense_output_impl(self) -> DenseOutput:
        return _SeriesOutput(self.engine, float(self.t_old or 0.0), self.t)


class _SeriesOutput(DenseOutput):
    """The series itself, closed."""

    def __init__(self, engine: SteppingEngine, t_old: float, t: float) -> None:
        super().__init__(t_old, t)
        self._engine = engine
        self._start, self._state, self._series = engine.last

    def _call_impl(self, t: Array) -> Array:
        x = np.atleast_1d(t) - self._start
        states = self._engine.states(self._state, self._series, x)
        return states[0] if np.ndim(t) == 0 else states.T


def _nothing(t: float, y: Array) -> Array:
    return np.zeros_like(y)
