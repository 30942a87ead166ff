"""The Taylor-series engine in compiled code: one function for all mechanisms, cached on disk.

The mechanism enters as numbers only (`layout.py`), so nothing is ever compiled for another
one; the loops are those of `kernel.py`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.dense_dynamics import elimination_is_safe
from robodyn.loops.change_points import regular_rank, suspect_quality
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.taylor import Chunk, Status, best_order
from robodyn.taylor.kernel import advance
from robodyn.taylor.layout import numbers

Array = NDArray[np.float64]
Limits = tuple[float, float, float, float]  # atol, rtol, a fixed step, the quality of a suspect


class CompiledEngine:
    """Steps of the Taylor series for constant torques and dampers, compiled (`taylor.Engine`).

    Tolerances are those of angles (rad) and rates (rad/s) over one step.  `order` is the last
    coefficient of the rates that is kept; a `step` (s) replaces what the tolerance would choose.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        actuation: Actuation,
        *,
        rtol: float = 1e-9,
        atol: float = 1e-9,
        order: int | None = None,
        step: float | None = None,
    ) -> None:
        if not self.serves(mechanism, actuation):
            raise ValueError("the compiled series are for constant torques and a regular M and Psi")
        self.order = best_order(rtol) if order is None else order
        self._numbers = numbers(mechanism, actuation, self.order)
        suspect = suspect_quality(mechanism) if mechanism.rows else 0.0
        self._last = 0.0, np.zeros(0), 0.0  # t and y where the last step began, and its end
        self._limits: Limits = (float(atol), float(rtol), float(step or 0.0), suspect)

    @classmethod
    def serves(cls, mechanism: Mechanism, actuation: Actuation) -> bool:
        """Whether this engine can: constant torques, M and Psi regular but at single states."""
        if actuation.constants is None or mechanism.has_state_forces:
            return False
        if mechanism.description.couplings:
            return False
        if not elimination_is_safe(mechanism):
            return False
        return not mechanism.rows or regular_rank(mechanism) == len(mechanism.rows)

    def advance(self, t: float, y: Array, bound: float, times: Array, steps: int) -> Chunk:
        """Up to `steps` steps from (t, y) towards `bound`; rows at `times` on the way.

        y is (q, qd) in joint coordinates, with the work done (J) appended where it is wanted.
        `times` lie strictly after t in the direction of `bound`, in that order, up to `bound`.
        The step in which they run out is the last.
        """
        chunk = self._advance(self._limits, t, y, bound, times, steps)
        if count := len(chunk.t):
            begun = (chunk.t[-2], chunk.y[-2]) if count > 1 else (t, y)
            self._last = *begun, float(chunk.t[-1])
        return chunk

    def within(self, times: Array) -> Array:
        """The states (k, N) at times (k,) in the last step, made once more for them."""
        atol, rtol, _, suspect = self._limits
        t, y, end = self._last
        longer = 10.0 * abs(end - t)  # than any landing leaves: so that it ends there again
        return self._advance((atol, rtol, longer, suspect), t, y, end, times, 1).row_y

    def _advance(
        self, limits: Limits, t: float, y: Array, bound: float, times: Array, steps: int
    ) -> Chunk:
        y, times = (np.require(array, float, ["C", "A", "W"]) for array in (y, times))
        ends, states, taken, rows, given, status = advance(  # type: ignore[no-untyped-call]
            *self._numbers, *limits, float(t), y, float(bound), times, steps
        )
        N = len(y)
        states = states[N : (taken + 1) * N].reshape(taken, N)
        rows = rows[: given * N].reshape(given, N)
        return Chunk(ends[:taken], states, times[:given], rows, Status(status))
