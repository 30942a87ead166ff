"""A recorded formula over many states: by machine code where that is the faster, else by numpy.

Which of the two is decided by the formula and the size of the call alone: their last digits differ,
and the same call must give the same bytes whatever the process did before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robodyn.engines import array_blocks, expression, straightline
from robodyn.engines.formulas import Formula, streams
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.engines.machine_rows import Evaluate

Found = tuple[list[Array], NDArray[np.int64]]

# States times additions of a formula from which on machine code pays within one call: loading
# llvmlite and making the code take as long as numpy needs for these.
WORTH = 1e8


class FormulaRows:
    """One kind of formula of one mechanism, for batches.

    `record(parameters=True)` records it again.  The outputs are split into `widths`, such as joint
    values and multipliers; states are doubtful where a pivot does not exceed `least`, or the first
    outputs are not finite.
    """

    def __init__(
        self,
        formula: Formula,
        record: Callable[..., Formula | None],
        widths: Sequence[int],
        least: float,
    ) -> None:
        self.formula = formula
        self.record, self.widths, self.least = record, widths, least
        self.cost = expression.cost(self.formula.outputs + self.formula.pivots)
        self._array: tuple[straightline.ArrayFunction, int] | None = None
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
        return self.by_numpy(states, wanted)

    def machine(self, wanted: int) -> Evaluate | None:
        """Machine code for the first `wanted` arrays of outputs; None where there is none."""
        if wanted not in self._machine:
            formula = self.record(parameters=True)
            assert formula is not None
            wide = len(formula.inputs) // 3  # q, qd, and accelerations or torques; and the time
            inputs = [list(formula.inputs[i : i + wide]) for i in range(0, 3 * wide, wide)]
            inputs += [[name] for name in formula.inputs[3 * wide :]]
            ends = np.cumsum((0, *self.widths[:wanted]))
            pairs = pairwise(ends)
            outputs = [formula.outputs[a:b] for a, b in pairs]
            from robodyn.engines.machine_rows import Rows

            rows = Rows(inputs, outputs, formula.pivots, self.least)
            self._machine[wanted] = rows.compile()
        return self._machine[wanted]

    def by_numpy(self, states: Sequence[Array], wanted: int) -> Found:
        """The same by blocks of numpy calls."""
        if self._array is None:
            self._array = straightline.compile_arrays(self.formula, "formula")
        function, buffers = self._array
        total, pivots = len(states[0]), len(self.formula.pivots)
        outputs = [np.empty((total, width)) for width in (*self.widths, pivots)]
        array_blocks.evaluate(function, buffers, states, outputs)
        first, quality = outputs[0], outputs[-1]
        with np.errstate(all="ignore"):
            sure = np.isfinite(first.sum()) and (quality > self.least).all()
        if sure:  # one pass over a large batch, not four
            return outputs[:wanted], np.zeros(0, np.int64)
        sound = (quality > self.least).all(axis=-1) & np.isfinite(first).all(axis=-1)
        return outputs[:wanted], np.flatnonzero(~sound)


def _side_by_side(total: int, widths: Sequence[int]) -> list[Array]:
    """Arrays (total, width) in one piece of memory: the system gives a large one in large pages."""
    room = np.empty(total * sum(widths))
    ends = [total * x for x in accumulate(widths, initial=0)]
    return [room[a:b].reshape(total, -1) for a, b in pairwise(ends)]
