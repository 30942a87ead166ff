"""Many motions at once, one in a lane: a recorded step in a loop until every lane has arrived.

The step is a graph of the state, of `left` (the time that is left) and of numbers; it gives the
state after the step and the step's length.  A lane that has arrived, or whose step has no
positive length, idles: masks are selects.  The kernel

    drive(first, stop, motions, columns, numbers, budget, work)

keeps the motions' numbers in columns (rows of an array (k, motions)): the state, what is fixed,
what is left, the count of steps, and what an observer keeps.  It returns how many lanes have not
arrived after `budget` steps of each; called again it goes on where it was, so that a caller can
stop it in time.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn.engines import machine
from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.expression import Expression, Value
from robodyn.engines.machine import Processor
from robodyn.engines.segment import Segment

LEFT = "left"

# observe(kernel, words, places): instructions of its own after each step.  Words are those of the
# columns before the step, `after_` and a name for the new ones, `h`, the mask `active` of lanes
# that took the step, the whole numbers `motion` (the first lane's) and `step` (of this call), and
# the address `work` of an array of the caller's; `places` are addresses of columns.
Observer = Callable[[Kernel, Mapping[str, Word], Mapping[str, Word]], None]


class LaneDriver:
    """The driver of one step.

    `state` are the names of what a step renews and `after` their new values, `length` is the
    step's; `fixed` are numbers of each motion, as those that a sweep varies.  `kept` are columns of
    the observer's own, `shown` are values of the step for it, such as coefficients, by name.
    """

    def __init__(
        self,
        state: Sequence[str],
        after: Sequence[Value],
        length: Value,
        fixed: Sequence[str] = (),
        kept: Sequence[str] = (),
        observe: Observer | None = None,
        shown: Mapping[str, Value] | None = None,
    ) -> None:
        self.state, self.fixed, self.observe = tuple(state), tuple(fixed), observe
        self.shown = dict(shown or {})
        self.outputs = [*after, length, *self.shown.values()]
        graph = next(x.graph for x in self.outputs if isinstance(x, Expression))
        self.parameters = {k: v for k, v in graph.parameters.items() if k not in self.fixed}
        self.columns = (*self.state, *self.fixed, LEFT, "steps", *kept)

    def compile(
        self, level: int | None = None, family: str = "", lanes: int = 0
    ) -> Callable[..., int] | None:
        """`run(columns, budget, work)` for columns (k, motions); None without machine code.

        It changes the columns in place, and returns how many lanes have not arrived.  `work` is
        an array for the observer; its motions are padded to `run.lanes` times a whole number.
        """
        code = machine.make(self.text, level=level, family=family, lanes=lanes)
        if code is None:
            return None
        types = [ctypes.c_int64] * 3 + [ctypes.c_void_p] * 2 + [ctypes.c_int64, ctypes.c_void_p]
        function, lanes = code.function("drive", *types), code.processor.lanes
        numbers = np.array([*self.parameters.values(), 0.0])

        def run(
            columns: NDArray[np.float64], budget: int, work: NDArray[np.float64] | None = None
        ) -> int:
            motions = columns.shape[1]
            room = -(-motions // lanes) * lanes
            held = np.zeros((len(self.columns), room))  # what pads the last lanes has no time left
            held[:, :motions] = columns
            place, values = held.ctypes.data, numbers.ctypes.data
            own = None if work is None else work.ctypes.data
            waiting: int = function(0, room, room, place, values, budget, own)
            columns[:] = held[:, :motions]
            return waiting

        run.lanes = lanes  # type: ignore[attr-defined]
        return run

    def text(self, processor: Processor) -> str:
        """The kernel as text."""
        module = Module(processor.lanes)
        k = Kernel(module, "drive", (WHOLE, WHOLE, WHOLE, ADDRESS, ADDRESS, WHOLE, ADDRESS))
        first, stop, motions, columns, numbers, budget, work = k.arguments
        names = list(self.parameters)
        words: dict[str, Word] = {}

        def read(name: str) -> Word:
            if name in words:
                return words[name]
            return k.spread(k.load(k.at(numbers, names.index(name)), SCALAR))

        waiting = k.slot(k.whole(0))
        shared = Segment(k, read)
        if not self.fixed:
            shared.constants(self.outputs)
        with k.loop(stop, first, k.lanes) as motion:
            places = {
                name: k.at(columns, k.add(k.multiply(k.whole(c), motions), motion))
                for c, name in enumerate(self.columns)
            }
            words |= {name: k.load(places[name]) for name in self.fixed}
            segment = Segment(k, read)
            segment.words |= shared.words
            segment.constants(self.outputs)
            done = k.slot(k.whole(0))
            with k.forever() as arrived:
                changing = (*self.state, LEFT, "steps")
                words |= {name: k.load(places[name]) for name in changing}
                words |= {"motion": motion, "step": k.get(done, WHOLE), "work": work}
                active = k.less(k.number(0.0), words[LEFT])
                spent = k.compare("sge", words["step"], budget)
                k.leave(k.either(k.invert(k.any(active)), spent), arrived)
                self._step(k, segment, words, places, active)
                k.set(done, k.add(words["step"], k.whole(1)))
            late = k.count(k.less(k.number(0.0), k.load(places[LEFT])))
            k.set(waiting, k.add(k.get(waiting, WHOLE), late))
        k.done(k.get(waiting, WHOLE))
        return module.text

    def _step(
        self,
        k: Kernel,
        segment: Segment,
        words: dict[str, Word],
        places: Mapping[str, Word],
        active: Word,
    ) -> None:
        found = segment.write(self.outputs)
        after, length = found[: len(self.state)], found[len(self.state)]
        forward = k.both(active, k.less(k.number(0.0), length))
        step = k.select(forward, length, k.number(0.0))
        left = k.subtract(words[LEFT], step)
        # a step of no length ends its lane: what is left is then told with its sign changed
        left = k.select(k.both(active, k.invert(forward)), k.negate(words[LEFT]), left)
        steps = k.add(words["steps"], k.select(forward, k.number(1.0), k.number(0.0)))
        for name, word in zip(self.state, after, strict=True):
            k.store(k.select(forward, word, words[name]), places[name])
        k.store(left, places[LEFT])
        k.store(steps, places["steps"])
        if self.observe is not None:
            renewed = {f"after_{x}": word for x, word in zip(self.state, after, strict=True)}
            renewed |= zip(self.shown, found[len(self.state) + 1 :], strict=True)
            renewed[f"after_{LEFT}"] = left
            self.observe(k, {**words, **renewed, "h": step, "active": forward}, places)
