"""A recorded formula over many states: by machine code for large batches, else by numpy.

The choice depends only on the formula and the size of the call: their last digits differ, and the
same call must give the same bytes whatever the process did before.

Machine code takes W rows at a time, on several threads.  The kernel `rows(first, stop, table,
numbers)` reads inputs in place, with any stride from row to row.  It marks doubtful rows: those
with an input or output that is not finite, or with a pivot that is too small.  The last W rows are
done together, some of them twice, so that no other code is needed.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from robodyn.engines import expression, machine
from robodyn.engines.array_blocks import ArrayFormula, shared
from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.expression import Expression, Graph, Value
from robodyn.engines.formulas import Formula, streams
from robodyn.engines.machine import Processor
from robodyn.engines.segment import Segment
from robodyn.tables.arrays import Array

SHARE = 50_000  # rows that are worth a thread
PIECE = 200_000  # rows of one call, which Ctrl-C does not end: some ms

# fills outputs (T, k), C-contiguous, from inputs (T, n): the doubtful rows
Evaluate = Callable[[Sequence[Array], Sequence[Array]], NDArray[np.int64]]


class Rows:
    """Machine code of one formula over rows.

    `inputs` are the names of the columns of each input array, `outputs` the columns of each output
    array.  A row is doubtful unless each of `pivots` exceeds `least` and all numbers are finite.
    """

    def __init__(
        self,
        inputs: Sequence[Sequence[str]],
        outputs: Sequence[Sequence[Value]],
        pivots: Sequence[Value] = (),
        least: float = 0.0,
    ) -> None:
        self.inputs, self.pivots, self.least = inputs, pivots, least
        self.outputs = outputs
        values = [value for columns in outputs for value in columns]
        graphs = [x.graph for x in (*values, *pivots) if isinstance(x, Expression)]
        self.parameters = dict((graphs[0] if graphs else Graph()).parameters)

    def compile(self, level: int | None = None, family: str = "") -> Evaluate | None:
        """Return a function that evaluates rows, or None if machine code is not available."""
        code = machine.make(self.text, level=level, family=family)
        if code is None:
            return None
        types = [ctypes.c_int64] * 2 + [ctypes.c_void_p] * 2
        function, lanes = code.function("rows", *types), code.processor.lanes

        def evaluate(inputs: Sequence[Array], outputs: Sequence[Array]) -> NDArray[np.int64]:
            return self._evaluate(function, lanes, inputs, outputs)

        return evaluate

    def _evaluate(
        self,
        function: Callable[..., int],
        lanes: int,
        inputs: Sequence[Array],
        outputs: Sequence[Array],
    ) -> NDArray[np.int64]:
        total = len(inputs[0])
        if 0 < total < lanes:
            longer = [array[np.minimum(np.arange(lanes), total - 1)] for array in inputs]
            results = [np.empty((lanes, array.shape[1])) for array in outputs]
            found = self._evaluate(function, lanes, longer, results)
            for array, result in zip(outputs, results, strict=True):
                array[:] = result[:total]
            return found[found < total]
        held = [_readable(array) for array in inputs]
        doubtful = np.zeros(total, np.uint8)
        places = [a.ctypes.data for a in (*held, *outputs)]
        apart = [a.strides[0] // 8 for a in held]  # from row to row, in doubles
        table = np.array([*places, doubtful.ctypes.data, *apart], np.int64)
        numbers = np.array([*self.parameters.values(), 0.0])
        place = (table.ctypes.data, numbers.ctypes.data)
        met: list[int] = []
        shared(total, SHARE, PIECE, lambda _, *rows: met.append(function(*rows, *place)))
        return np.flatnonzero(doubtful) if any(met) else np.zeros(0, np.int64)

    def text(self, processor: Processor) -> str:
        """Return the kernel as text."""
        module = Module(processor.lanes)
        k = Kernel(module, "rows", (WHOLE, WHOLE, ADDRESS, ADDRESS))
        first, stop, table, numbers = k.arguments
        count = len(self.inputs) + len(self.outputs) + 1
        places = [k.load(k.at(table, i), ADDRESS) for i in range(count)]
        apart = [k.load(k.at(table, count + i), WHOLE) for i in range(len(self.inputs))]
        names = list(self.parameters)
        columns: dict[str, Word] = {}

        def read(name: str) -> Word:
            if name in columns:
                return columns[name]
            return k.spread(k.load(k.at(numbers, names.index(name)), SCALAR))

        values = [value for array in self.outputs for value in array]
        segment = Segment(k, read)
        segment.constants([*values, *self.pivots])
        worst = k.slot(k.whole(0))
        last = k.subtract(stop, k.whole(k.lanes))
        with k.loop(stop, first, k.lanes) as row:
            i = k.select(k.compare("slt", row, last), row, last)
            for array, place, step in zip(self.inputs, places, apart, strict=False):
                lanes = [k.at(place, k.multiply(i, step))]
                while len(lanes) < k.lanes:
                    lanes.append(k.at(lanes[-1], step))
                for j, name in enumerate(array):
                    columns[name] = k.gathered([k.load(k.at(x, j), SCALAR) for x in lanes])
            words = segment.write(values)
            pivots = segment.write(list(self.pivots))
            flags = k.at(places[-1], i, "i8")
            self._mark(k, [*columns.values(), *words], pivots, flags, worst)
            written = iter(words)
            for output, place in zip(self.outputs, places[len(self.inputs) :], strict=False):
                wide = len(output)
                begin = k.at(place, k.multiply(i, k.whole(wide)))
                for j in range(wide):
                    word = next(written)
                    for lane in range(k.lanes):
                        k.store(k.lane(word, lane), k.at(begin, lane * wide + j))
        k.done(k.get(worst, WHOLE))
        return module.text

    def _mark(
        self, k: Kernel, words: Sequence[Word], pivots: Sequence[Word], flags: Word, worst: Word
    ) -> None:
        """Set the flags of doubtful rows, and `worst` if there are any."""
        zero = k.number(0.0)
        total = zero
        for word in words:  # 0 x is nan of what is not finite
            total = k.add(k.multiply(zero, word), total)
        sound = k.compare("oeq", total, zero)
        for pivot in pivots:
            sound = k.both(sound, k.less(k.number(self.least), pivot))
        doubtful = k.invert(sound)
        with k.when(k.any(doubtful)):
            marks = k.convert("zext", doubtful, doubtful.type.replace("i1", "i8"))
            k.line(f"store {marks}, {flags}, align 1")
            k.set(worst, k.whole(1))


def _readable(array: Array) -> Array:
    """Return the array, copied only if machine code cannot read its strides."""
    beside = array.shape[1] == 1 or array.strides[1] == 8
    if beside and array.strides[0] % 8 == 0 and array.ctypes.data % 8 == 0:
        return array
    return np.ascontiguousarray(array)


Found = tuple[list[Array], NDArray[np.int64]]

# States times additions of a formula from which on machine code pays within one call: loading
# llvmlite and making the code take as long as numpy needs for these.
WORTH = 1e8


class FormulaBatches:
    """A recorded formula of one mechanism, for batches.

    Outputs are split into arrays of `widths`, such as joint values and multipliers.  States are
    doubtful if a pivot does not exceed `least`, or if the first outputs are not finite.  Machine
    code takes the graph's parameters as arguments.
    """

    def __init__(self, formula: Formula, widths: Sequence[int], least: float) -> None:
        self.formula, self.widths, self.least = formula, widths, least
        self.cost = expression.cost(formula.outputs + formula.pivots)
        self._machine: dict[int, Evaluate | None] = {}

    def run(self, states: Sequence[Array], wanted: int, check: Callable[[], object]) -> Found:
        """Return the first `wanted` output arrays, and the indices of doubtful states.

        `states` are (T, n).  `check` raises an error if a state is not finite.
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
        """Return machine code for the first `wanted` output arrays, or None."""
        if wanted not in self._machine:
            names = self.formula.inputs
            wide = len(names) // 3  # q, qd, and accelerations or torques; and the time
            inputs = [list(names[i : i + wide]) for i in range(0, 3 * wide, wide)]
            inputs += [[name] for name in names[3 * wide :]]
            ends = np.cumsum((0, *self.widths[:wanted]))
            outputs = [self.formula.outputs[a:b] for a, b in pairwise(ends)]

            self._machine[wanted] = Rows(inputs, outputs, self.formula.pivots, self.least).compile()
        return self._machine[wanted]

    def by_arrays(self, states: Sequence[Array], wanted: int) -> Found:
        """Do the work of `run` by numpy, on blocks of states."""
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
    """Return arrays (total, width) in one piece of memory, which gets large pages."""
    room = np.empty(total * sum(widths))
    ends = [total * x for x in accumulate(widths, initial=0)]
    return [room[a:b].reshape(total, -1) for a, b in pairwise(ends)]
