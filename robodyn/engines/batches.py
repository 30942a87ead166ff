"""A recorded formula over many states: by machine code where that is the faster, else by numpy.

Which of the two is decided by the formula and the size of the call alone: their last digits differ,
and the same call must give the same bytes whatever the process did before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robodyn.engines import expression
from robodyn.engines.array_blocks import ArrayFormula
from robodyn.engines.formulas import Formula, streams
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.engines.machine_rows import Evaluate

Found = tuple[list[Array], NDArray[np.int64]]

# States times additions of a formula from which on machine code pays within one call: loading
# llvmlite and making the code take as long as numpy needs for these.
WORTH = 1e8


class FormulaBatches:
    """A recorded formula of one mechanism, for batches.

    The outputs are split into `widths`, such as joint values and multipliers; states are doubtful
    where a pivot does not exceed `least`, or the first outputs are not finite.  Machine code takes
    the graph's parameters as arguments.
    """

    def __init__(self, formula: Formula, widths: Sequence[int], least: float) -> None:
        self.formula, self.widths, self.least = formula, widths, least
        self.cost = expression.cost(formula.outputs + formula.pivots)
        self._machine: dict[int, Evaluate | None] = {}

    def run(self, states: Sequence[Array], wanted: int, check: Callable[[], object]) -> Found:
        """The first `wanted` arrays of outputs, and the indices of doubtful states.

        States are (T, n).  `check` raises where one is not finite; machine code sees that itself.
        """
        total = len(states[0])
        if total * self.cost >= WORTH and not streams.get():
            function = self.machine(wanted)
            if function is not None:
                outputs = _side_by_side(total, self.widths[:wanted])
                doubtful = function(states, outputs)
                if doubtful.size:
                    check()
                return outputs, doubtful
        check()
        return self.by_arrays(states, wanted)

    def machine(self, wanted: int) -> Evaluate | None:
        """Machine code for the first `wanted` arrays of outputs; None where there is none."""
        if wanted not in self._machine:
            names = self.formula.inputs
            wide = len(names) // 3  # q, qd, and accelerations or torques; and the time
            inputs = [list(names[i : i + wide]) for i in range(0, 3 * wide, wide)]
            inputs += [[name] for name in names[3 * wide :]]
            ends = np.cumsum((0, *self.widths[:wanted]))
            outputs = [self.formula.outputs[a:b] for a, b in pairwise(ends)]
            from robodyn.engines.machine_rows import Rows

            self._machine[wanted] = Rows(inputs, outputs, self.formula.pivots, self.least).compile()
        return self._machine[wanted]

    def by_arrays(self, states: Sequence[Array], wanted: int) -> Found:
        """The same by numpy calls on blocks of states."""
        total, pivots = len(states[0]), len(self.formula.pivots)
        outputs = [np.empty((total, width)) for width in (*self.widths, pivots)]
        self._arrays.fill(states, outputs)
        first, quality = outputs[0], outputs[-1]
        with np.errstate(all="ignore"):
            sure = np.isfinite(first.sum()) and (quality > self.least).all()
        if sure:  # one pass over a large batch, not four
            return outputs[:wanted], np.zeros(0, np.int64)
        sound = (quality > self.least).all(axis=-1) & np.isfinite(first).all(axis=-1)
        return outputs[:wanted], np.flatnonzero(~sound)

    @cached_property
    def _arrays(self) -> ArrayFormula:
        return ArrayFormula(self.formula.inputs, self.formula.outputs + self.formula.pivots)


def _side_by_side(total: int, widths: Sequence[int]) -> list[Array]:
    """Arrays (total, width) in one piece of memory: the system gives a large one in large pages."""
    room = np.empty(total * sum(widths))
    ends = [total * x for x in accumulate(widths, initial=0)]
    return [room[a:b].reshape(total, -1) for a, b in pairwise(ends)]
