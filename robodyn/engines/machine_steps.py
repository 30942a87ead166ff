"""Steps of the Taylor series in machine code: one motion in each of W lanes.

All that belongs to the motions of one vector lies in a block of items of W doubles each, which
`Scene.place` names: the state (q0, ..., qd0, ..., work), that at a step's end (to_q0, ...), the
time, what is given, the scene's numbers and how things stand.  Behind them stands the series: a
matrix of coefficients, a row an order and a column a series.  The kernels

    expand(block)      the series at the state, and the longest step
    evaluate(block)    the state at x after the start, from the series
    close(block)       that state moved to the nearest that closes, and its quality
    leaps(block)       none is left where the step between them may have leapt to another branch
    compare(block)     whether the series gives the torques there (0 or 1)

do so; `advance` (`machine_motion.py`) drives them.  Numbers are no part of the code: it serves all
scenes of one shape.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

from robodyn.engines.assembler import ADDRESS, Kernel, Module, Word
from robodyn.engines.expansion import KINK, MotionProgram
from robodyn.engines.expression import Graph, Value
from robodyn.engines.formulas import Formula, projection_formula
from robodyn.engines.machine_series import (
    coefficients,
    read_segment,
    write_evaluate,
    write_expand,
)
from robodyn.engines.machine_sums import WIDE, Run, runs
from robodyn.engines.order_loop import LoopExpansion, loop_expansion
from robodyn.engines.segment import Segment
from robodyn.engines.strays import strays
from robodyn.loops.assembly import loop_size
from robodyn.loops.change_points import suspect_quality
from robodyn.loops.closing import CLOSED
from robodyn.loops.projection import CONVERGED
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.planar_model import Mechanism
from robodyn.tables.arrays import Array

ALIGNED = 8  # items, on which a vector of one lane and 8 numbers crosses no line of the cache
# of a block, besides what its scene asks for
COMMON = (
    "t", "bound", "direction", "status", "steps", "most_steps", "x", "t_there", "h", "longest",
    "quality", "agrees", "miss", "relative", "rtol", "atol", "suspect", "lightest", "rounding",
    "converged", "base_t",
)  # fmt: skip


class Scene:
    """A mechanism and its torques as a block's layout, code and numbers.

    Without `closes` closures are not kept by projection.  With `rate_series` the series of the
    joints' rates are among the items, from rate0_0 on, joint by joint, and that of `link` from
    link0_0 on.
    `kept` are items of an observer's own, with what they are at first; `motion` has the rows, where
    these are not those of the mechanism.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        actuation: Actuation,
        order: int,
        *,
        work: bool = False,
        closes: bool = True,
        held: Sequence[float] | None = None,
        rate_series: bool = False,
        link: int = -1,
        kept: Mapping[str, float] | None = None,
        motion: MotionProgram | None = None,
    ) -> None:
        self.mechanism, self.actuation, self.order = mechanism, actuation, order
        self.work, self.closes = work, closes and bool(mechanism.rows)
        self.rate_series, self.link = rate_series, link
        self.motion = motion or MotionProgram(mechanism, actuation, work, held)
        program = self.motion.program
        self.linear = actuation.constants is None and actuation.linear
        self.bends = program.named["bends"]
        self.values = {f"c{i}": x for i, x in enumerate(program.numbers)}
        self.values |= {f"u{j}": x for j, x in enumerate(actuation.constants or ())}
        self.values |= {f"arm{i}": program.arms[slot] for i, slot in enumerate(self.bends)}
        self.values |= kept or {}
        shapes = [program.shape, mechanism.above, mechanism.order, order, work, self.closes]
        shapes += [self.linear, rate_series, link]
        shapes += [list(kept or ()), [bool(x) for x in actuation.constants or ()]]
        if self.closes:
            closing = EquationsOfMotion(mechanism)
            closing.write([None] * mechanism.n)
            self.values |= {f"closing.c{i}": x for i, x in enumerate(closing.program.numbers)}
            self.values |= {f"closing.size{r}": x.size**2 for r, x in enumerate(mechanism.rows)}
            shapes.append(closing.program.shape)
        self.key = repr(shapes)

    # -- formulas ----------------------------------------------------------------------------------

    @cached_property
    def loop(self) -> LoopExpansion:
        """The formulas of a step; raises ZeroDivisionError where no state has a series."""
        return loop_expansion(self.motion, self.order)

    @cached_property
    def closing(self) -> Formula | None:
        """One Newton step."""
        formula = projection_formula(self.mechanism, generic=True) if self.closes else None
        if self.closes and formula is None:
            raise ZeroDivisionError("closures that no state can keep")
        return formula

    @property
    def closing_names(self) -> dict[str, str]:
        """The items of the numbers that it takes."""
        return {name[8:]: name for name in self.values if name.startswith("closing.")}

    # -- the block ---------------------------------------------------------------------------------

    @property
    def state(self) -> list[str]:
        """The items of the state."""
        names = [f"{name}{j}" for name in ("q", "qd") for j in range(self.mechanism.n)]
        return [*names, "work"] if self.work else names

    @cached_property
    def place(self) -> dict[str, int]:
        """Where each item stands; what Python writes or reads comes first."""
        n = self.mechanism.n
        names = [*self.state, *(f"to_{name}" for name in self.state), *COMMON]
        if self.linear:
            names += [f"{name}{j}" for name in ("base", "dtau", "tau") for j in range(n)]
        return {name: i for i, name in enumerate([*names, *self.values])}

    @cached_property
    def runs(self) -> tuple[list[Run], dict[str, int], int]:
        """See `machine_sums.runs`."""
        return runs(self.loop)

    @cached_property
    def whole(self) -> dict[str, int]:
        """Where all items stand, and where the tables of the code's own begin."""
        whole = dict(self.place)
        place = len(whole)
        for name, size in {**self.tables, "end": 0}.items():
            place += -place % ALIGNED
            whole[name] = place
            place += size
        return whole

    @property
    def tables(self) -> dict[str, int]:
        """The sizes of the code's own tables."""
        turns, orders = 2 * self.mechanism.n + WIDE, self.order + 1
        return {
            "rows": (orders + 2) * len(self.loop.columns) + WIDE,
            "sums": self.runs[2] + WIDE,
            "value": turns,
            "slope": turns,
            "rate0_0": self.mechanism.n * orders if self.rate_series else 0,
            "link0_0": orders if self.link >= 0 else 0,
        }

    @property
    def items(self) -> int:
        """How many a block has."""
        return self.whole["end"]

    def fill(self, block: Array, rtol: float, atol: float, project: float = 1.0) -> None:
        """The scene's numbers and limits into a block (items, ...)."""
        place, mechanism = self.place, self.mechanism
        size = loop_size(mechanism) if self.closes else 0.0
        lightest = min(mechanism.inertias.values())
        limits = {
            "rtol": rtol,
            "atol": atol,
            "relative": max(math.sqrt(rtol), KINK),
            "lightest": (self.order + 1) * lightest,
            "suspect": suspect_quality(mechanism) * project if self.closes else 0.0,
            "rounding": CLOSED * size,
            "converged": CONVERGED * size,
            "most_steps": math.inf,
        }
        for name, value in (self.values | limits).items():
            block[place[name]] = value

    # -- code --------------------------------------------------------------------------------------

    def kernel(self, module: Module, name: str) -> tuple[Kernel, Word]:
        """A kernel of one argument, the block."""
        k = Kernel(module, name, (ADDRESS,), "void")
        return k, k.arguments[0]

    def at(self, k: Kernel, block: Word, name: str, place: int = 0) -> Word:
        """The address of an item, or of one in a table."""
        return k.at(block, self.whole[name] + place, k.numbers)

    def row(self, k: Kernel, block: Word, m: Word | int, column: int = 0) -> Word:
        """The address of coefficient m of a series."""
        width = len(self.loop.columns)
        if isinstance(m, int):
            return self.at(k, block, "rows", m * width + column)
        row = k.at(block, k.multiply(m, k.whole(width)), k.numbers)
        return self.at(k, row, "rows", column)

    def get(self, k: Kernel, block: Word, name: str) -> Word:
        """An item."""
        return k.load(self.at(k, block, name))

    def put(self, k: Kernel, block: Word, name: str, value: Word) -> None:
        """Write an item."""
        k.store(value, self.at(k, block, name))

    def segment(
        self,
        k: Kernel,
        block: Word,
        outputs: Sequence[Value],
        read: Callable[[str], Word] | Mapping[str, str] | None = None,
    ) -> Segment:
        """For outputs whose inputs are items, or what `read` says: their names, or their words.

        What follows from numbers alone is written here, before any loop.
        """
        if not callable(read):
            names = read or {}

            def read(name: str) -> Word:
                return self.get(k, block, names.get(name, name))

        segment = Segment(k, read)
        segment.constants(outputs)
        return segment

    def write(self, module: Module) -> None:
        """The kernels into a module; `size` tells how many items a block has."""
        k = Kernel(module, "size", ())
        k.done(k.whole(self.items))
        write_expand(self, module)
        write_evaluate(self, module)
        if self.bends:
            self._compare(module)

    def there(self, names: Sequence[str]) -> dict[str, str]:
        """Inputs of a graph, taken from the state at a step's end."""
        return {name: f"to_{name}" for name in names} | {"t": "t_there"}

    def torques(self, k: Kernel, block: Word) -> None:
        """Those that are linear in time, at the time of the state."""
        if not self.linear:
            return
        past = k.subtract(self.get(k, block, "t"), self.get(k, block, "base_t"))
        for j in range(self.mechanism.n):
            change = k.multiply(self.get(k, block, f"dtau{j}"), past)
            self.put(k, block, f"tau{j}", k.add(self.get(k, block, f"base{j}"), change))

    def _terms(self, k: Kernel, block: Word, i: int, x: Word) -> tuple[Word, Word]:
        """The sum of a watched series at x, and its largest term."""
        with k.loop(k.whole(self.order)) as m:
            total, most, power = (k.carried(k.number(i)) for i in (0.0, 0.0, 1.0))
            c = k.load(self.row(k, block, m, 2 * self.mechanism.n + i))
            term = k.multiply(c, power)
            size = k.intrinsic("fabs", term)
            k.becomes(total, k.add(total, term))
            k.becomes(most, k.select(k.less(most, size), size, most))
            k.becomes(power, k.multiply(power, x))
        return total, most

    def _compare(self, module: Module) -> None:
        """Whether what may bend is, at the state there, what its series gives at x.

        And nothing strays on the way.
        """
        k, block = self.kernel(module, "compare")
        names = self.there([f"{name}{j}" for name in ("q", "qd") for j in range(self.mechanism.n)])
        watched = self.loop.columns[2 * self.mechanism.n :][: self.loop.watched]
        starts = [series.first[0] for series in watched]
        values = self.segment(k, block, starts, names).write(starts)
        x, small, relative = (self.get(k, block, name) for name in ("x", "miss", "relative"))
        agrees = k.all_lanes(True)
        for i in range(len(self.bends)):
            total, most = self._terms(k, block, i, x)
            missed = k.intrinsic("fabs", k.subtract(total, values[i]))
            allowed = k.divide(small, self.get(k, block, f"arm{i}"))
            part = k.multiply(relative, most)
            within = k.either(k.compare("ole", missed, allowed), k.compare("ole", missed, part))
            agrees = k.both(agrees, within)
        if spans := self.motion.spans:
            graph, orders = Graph(), range(self.order)
            series = [coefficients(graph, column, orders) for column in self.loop.spanned]
            arms = [graph.variable(f"arm{i}") for i in range(len(self.bends))]
            given = map(graph.variable, ("x", "miss", "relative"))
            way = read_segment(self, k, block).write([strays(spans, arms, series, *given)])[0]
            agrees = k.both(agrees, k.invert(k.less(k.number(0.0), way)))
        self.put(k, block, "agrees", k.select(agrees, k.number(1.0), k.number(0.0)))
        k.done()


class Items:
    """The items of a scene's block, in a kernel."""

    def __init__(self, scene: Scene, k: Kernel, block: Word) -> None:
        self.scene, self.k, self.block = scene, k, block

    def get(self, name: str) -> Word:
        """An item."""
        return self.scene.get(self.k, self.block, name)

    def put(self, name: str, value: Word) -> None:
        """Write an item."""
        self.scene.put(self.k, self.block, name, value)
