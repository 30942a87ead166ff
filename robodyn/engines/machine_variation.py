"""Sensitivities along the steps of a motion in machine code: a direction in each of W lanes.

The series of a step are those of the motion; beside each column of coefficients stands one of its
tangents, by the directions dq, dqd in the state and dc in the numbers of the scene.  Every sum of
products of two columns has two tangents, sums of one column with the tangents of the other.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.expansion import MotionProgram, ends
from robodyn.engines.expression import Graph, Value
from robodyn.engines.machine import Code, Processor
from robodyn.engines.machine_motion import kept
from robodyn.engines.machine_series import (
    read_segment,
    value_and_slope,
    write_expand,
    write_polynomials,
)
from robodyn.engines.machine_steps import Scene
from robodyn.engines.order_loop import LoopExpansion, Stored
from robodyn.engines.tangents import Tangents, slopes_by, tangents

WAY = "d"  # the one direction of a lane
# what `vary` is told: addresses of the steps' begins, ends and states, of the rows' times, and of
# what it finds there; how many rows
TABLE = ("begins", "ends", "states", "times", "at_ends", "at_rows", "rows")


def with_tangents(loop: LoopExpansion, inputs: Mapping[str, str]) -> LoopExpansion:
    """The formulas with those of the tangents: of columns i behind them, from as many on.

    `inputs` are what changes, with the names of how they do.
    """
    graph, count = loop.start.graph, 1 + max(x.index for x in loop.columns)
    known: dict[str, Tangents] = {x: {WAY: graph.variable(y)} for x, y in inputs.items()}
    for x in loop.columns:
        for m in loop.offsets:
            known[f"{x.index}@{m}"] = {WAY: graph.variable(f"{x.index + count}@{m}")}
    moved = {x.index: Stored(x.loop, x.index + count) for x in loop.columns}
    sums = list(loop.sums)
    for name, one in loop.sums:
        dx, dy = moved[one.x.index], moved[one.y.index]
        square = one.x is one.y and one.slope == 0.0 and one.first + one.last == one.m
        parts = [one._replace(x=dx)] if square else [one._replace(x=dx), one._replace(y=dy)]
        sums += [(f"{name}_{i}", part) for i, part in enumerate(parts)]
        slope: Value = 0.0
        for i in range(len(parts)):
            slope = slope + graph.variable(f"{name}_{i}")
        known[name] = {WAY: 2.0 * slope if square else slope}
    pairs = [(moved[x.index], x) for x in loop.columns]
    places = [(dx.first, m, value) for dx, x in pairs for m, value in x.first.items()]
    places += [(dx.now, m, value) for dx, x in pairs for m, value in x.now.items()]
    slopes = tangents([value for *_, value in places], known)
    for (where, m, _), found in zip(places, slopes, strict=True):
        where[m] = found.get(WAY, 0.0)
    return loop._replace(sums=sums, columns=[*loop.columns, *moved.values()])


class VariedScene(Scene):
    """A scene's block, with directions and tangents; `motion` has the rows, whose numbers vary.

    `varied` are the places of those that do.  Torques that a controller holds change by fed0, ...
    """

    def __init__(self, order: int, motion: MotionProgram, varied: Sequence[int]) -> None:
        super().__init__(motion.mechanism, motion.actuation, order, closes=False, motion=motion)
        self.varied = {f"c{i}": f"dc{i}" for i in varied}
        if self.linear and self.actuation.control is not None:
            self.varied |= {f"tau{j}": f"fed{j}" for j in self.mechanism.actuated}
        self.values |= dict.fromkeys(self.varied.values(), 0.0)
        self.key = f"varied {[*self.varied]} {self.key}"

    @cached_property
    def loop(self) -> LoopExpansion:
        """With those of the tangents."""
        return with_tangents(super().loop, {x: f"d{x}" for x in self.state} | self.varied)

    @cached_property
    def place(self) -> dict[str, int]:
        """Where each item stands; first the state, where it goes, and both directions."""
        names = [*self.state, *(f"to_{x}" for x in self.state)]
        names += [*(f"d{x}" for x in self.state), *(f"to_d{x}" for x in self.state)]
        return {name: i for i, name in enumerate(dict.fromkeys([*names, *super().place]))}

    @property
    def tables(self) -> dict[str, int]:
        """Those of the code's own, with the tangents of the turns and of their slopes."""
        found = super().tables
        return {**found, "dvalue": found["value"], "dslope": found["slope"]}

    def write(self, module: Module) -> None:
        """`size()`, and `vary(block, steps, told)`."""
        k = Kernel(module, "size", ())
        k.done(k.whole(self.items))
        write_expand(self, module, chooses=False)
        self._evaluate(module)
        self._vary(module)

    def _evaluate(self, module: Module) -> None:
        """`evaluate(block)`: the directions at x after the start."""
        write_polynomials(module, len(self.loop.columns))
        k, block = self.kernel(module, "evaluate")
        n, graph, half = self.mechanism.n, Graph(), len(self.loop.columns) // 2
        known: dict[str, Tangents] = {x: {WAY: graph.variable(f"d{x}")} for x in self.state}
        rest = k.whole(self.order + 2), k.whole(2 * n * k.lanes), self.at(k, block, "x")
        for column, names in ((0, ("value", "slope")), (half, ("dvalue", "dslope"))):
            found = [self.at(k, block, name) for name in names]
            places = self.at(k, block, "rows", column), *found
            k.call("polynomials", *places, *rest)
        turns = value_and_slope(graph, n)
        for x in ("value", "slope"):
            known |= {f"{x} {j}": {WAY: graph.variable(f"d{x} {j}")} for j in range(2 * n)}
        states = ends(self.mechanism, turns, 0.0, (), False, graph.variable)
        slopes = slopes_by(states, known, [WAY])
        for name, word in zip(self.state, read_segment(self, k, block).write(slopes), strict=True):
            self.put(k, block, f"to_d{name}", word)
        k.done()

    def _vary(self, module: Module) -> None:
        """The directions at the ends of steps, and at rows; those at the start are in the block."""
        k = Kernel(module, "vary", (ADDRESS, WHOLE, ADDRESS), "void")
        block, steps, told = k.arguments
        wide, row = len(self.state), k.slot(k.whole(0))
        items = {
            name: k.load(k.at(told, i), WHOLE if name == "rows" else ADDRESS)
            for i, name in enumerate(TABLE)
        }
        state, way, to = (self.at(k, block, name) for name in ("q0", "dq0", "to_dq0"))

        def reach(time: Word, begin: Word, target: Word, place: Word) -> None:
            self.put(k, block, "x", k.spread(k.subtract(time, begin)))
            k.call("evaluate", block)
            there = k.at(target, k.multiply(place, k.whole(wide)), k.numbers)
            self._copy(k, to, there, wide)

        with k.loop(steps) as j:
            begin, end = (k.load(k.at(items[name], j), SCALAR) for name in ("begins", "ends"))
            given = k.at(items["states"], k.multiply(j, k.whole(wide)))
            with k.loop(k.whole(wide)) as i:
                value = k.spread(k.load(k.at(given, i), SCALAR))
                k.store(value, k.at(state, i, k.numbers))
            self.put(k, block, "t", k.spread(begin))
            self.torques(k, block)
            k.call("expand", block)
            direction = k.subtract(end, begin)
            with k.forever() as done:
                due = k.get(row, WHOLE)
                k.leave(k.compare("sge", due, items["rows"]), done)
                time = k.load(k.at(items["times"], due), SCALAR)
                ahead = k.multiply(k.subtract(time, end), direction)
                k.leave(k.less(k.scalar(0.0), ahead), done)
                reach(time, begin, items["at_rows"], due)
                k.set(row, k.add(due, k.whole(1)))
            reach(end, begin, items["at_ends"], j)
            self._copy(k, to, way, wide)
        k.done()

    def _copy(self, k: Kernel, source: Word, target: Word, count: int) -> None:
        with k.loop(k.whole(count)) as i:
            k.store(k.load(k.at(source, i, k.numbers)), k.at(target, i, k.numbers))


class Varying(NamedTuple):
    """The kernel that Python calls, of blocks at an address."""

    vary: Callable[[int, int, int], None]
    items: int


def compile(scene: VariedScene, lanes: int) -> Varying | None:
    """The machine code of a scene, for all of its shape; None: there is none.

    Raises ZeroDivisionError where no state has a series.
    """

    def text(processor: Processor) -> str:
        module = Module(processor.lanes, short=True, together=processor.together)
        scene.write(module)
        return module.text

    def load(code: Code) -> Varying:
        kinds = ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p
        return Varying(code.function("vary", *kinds, result=None), code.function("size")())

    found: Varying | None = kept(scene.key, text, load, lanes)
    return found
