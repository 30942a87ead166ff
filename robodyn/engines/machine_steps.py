"""Steps of the Taylor series in machine code: one motion in each of W lanes.

All that belongs to the motions of one vector lies in a block of items of W doubles each, which
`Scene.place` names: the state (q0, ..., qd0, ..., work), that at a step's end (to_q0, ...), the
time, what is given, the scene's numbers, what follows from these alone, the series, and how things
stand.  The kernels

    prepare(block)     what follows from the numbers alone
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
from functools import cache, cached_property, partial
from itertools import count, takewhile

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.assembler import ADDRESS, Kernel, Module, Word
from robodyn.engines.expansion import Expansion, MotionProgram, end_of_step, expansion, rates
from robodyn.engines.expression import INPUTS, Expression, Graph, Value, needed
from robodyn.engines.formulas import Formula, projection_formula
from robodyn.engines.machine_closing import write_close, write_leaps
from robodyn.engines.segment import Segment
from robodyn.loops.assembly import loop_size
from robodyn.loops.change_points import suspect_quality
from robodyn.loops.closing import CLOSED
from robodyn.loops.projection import CONVERGED
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.planar_model import Mechanism

Array = NDArray[np.float64]

KINK = 1e-7  # a torque that misses its series by a smaller part does not bend
# of a block, besides what its scene asks for
COMMON = (
    "t", "bound", "direction", "status", "steps", "most_steps", "x", "t_there", "h", "longest",
    "quality", "agrees", "miss", "relative", "rtol", "atol", "suspect", "lightest", "rounding",
    "converged", "base_t",
)  # fmt: skip


class Scene:
    """A mechanism and its torques as a block's layout, code and numbers.

    Without `closes` closures are not kept by projection.  With `rate_series` the series of the
    joints' rates are among the items, as rate0_0, rate0_1, ..., and that of `link` as link0_0, ...
    `kept` are items of an observer's own, with what they are at first.
    """

    short = False  # whether text is kept short, at some cost of speed

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
    ) -> None:
        self.mechanism, self.actuation, self.order = mechanism, actuation, order
        self.work, self.closes = work, closes and bool(mechanism.rows)
        self.rate_series, self.link = rate_series, link
        self.motion = MotionProgram(mechanism, actuation, work, held)
        program = self.motion.program
        self.linear = actuation.constants is None and actuation.linear
        self.bends = program.named["bends"]
        self.values = {f"c{i}": x for i, x in enumerate(program.numbers)}
        self.values |= {f"u{j}": x for j, x in enumerate(actuation.constants or ())}
        self.values |= {f"arm{i}": program.arms[slot] for i, slot in enumerate(self.bends)}
        self.values |= kept or {}
        shapes = [program.shape, mechanism.parent, mechanism.order, order, work, self.closes]
        shapes += [bool(mechanism.friction), self.linear, rate_series, link, list(kept or ())]
        shapes.append([bool(x) for x in actuation.constants or ()])
        if self.closes:
            closing = EquationsOfMotion(mechanism)
            closing.write([None] * mechanism.n)
            self.values |= {f"closing.c{i}": x for i, x in enumerate(closing.program.numbers)}
            self.values |= {f"closing.size{r}": x.size**2 for r, x in enumerate(mechanism.rows)}
            shapes.append(closing.program.shape)
        self.key = f"{type(self).__name__} {shapes!r}"

    # -- formulas ----------------------------------------------------------------------------------

    @cached_property
    def found(self) -> Expansion:
        """The formulas of a step; raises ZeroDivisionError where no state has a series."""
        return expansion(self.motion, self.order, generic=True)

    @cached_property
    def closing(self) -> Formula | None:
        """One Newton step."""
        formula = projection_formula(self.mechanism, generic=True) if self.closes else None
        if self.closes and formula is None:
            raise ZeroDivisionError("closures that no state can keep")
        return formula

    @cached_property
    def series(self) -> dict[str, Value]:
        """What `expand` finds, by name."""
        found = self.found
        named: dict[str, Value] = {}
        parts = {"rho": found.rho, "theta": found.theta, "watched": found.watched}
        parts["power"] = [found.power] if found.power else []
        w = [rates(*z, self.order) for z in zip(found.rho, found.theta, strict=True)]
        if self.rate_series:
            parts["rate"] = [
                each if above is None else [a - b for a, b in zip(each, w[above], strict=True)]
                for each, above in zip(w, self.mechanism.parent, strict=True)
            ]
        if self.link >= 0:
            parts["link"] = [w[self.link]]
        for name, rows in parts.items():
            for k, row in enumerate(rows):
                named |= {f"{name}{k}_{m}": value for m, value in enumerate(row)}
        return named

    def _stored(self, name: str, value: Value) -> bool:
        """Whether a coefficient is an item; those of rates are so that they stand side by side."""
        return isinstance(value, Expression) or name.startswith(("rate", "link"))

    def coefficients(self, graph: Graph, name: str) -> list[Value]:
        """A series as variables of another graph; what is no variable stays a number."""
        keys = takewhile(self.series.__contains__, (f"{name}_{m}" for m in count()))
        found = ((key, self.series[key]) for key in keys)
        return [graph.variable(k) if isinstance(x, Expression) else x for k, x in found]

    @cached_property
    def _held(self) -> dict[int, dict[int, str]]:
        """By graph: what follows from numbers alone and is wanted by the rest, and its item."""
        held: dict[int, dict[int, str]] = {}
        for graph, outputs, prefix in self._graphs():
            nodes = needed(outputs)
            wanted = {
                a.index: a
                for node in nodes
                for a in node.args
                if not node.constant and isinstance(a, Expression) and a.constant
            }
            wanted |= {x.index: x for x in outputs if isinstance(x, Expression) and x.constant}
            held[id(graph)] = {
                index: f"{prefix}{node.args[0]}" if node.op in INPUTS else f"{prefix}k{index}"
                for index, node in wanted.items()
            }
        return held

    @property
    def _formulas(self) -> tuple[Graph, list[Value]]:
        """Of `expand`."""
        return self.found.graph, [self.found.longest, *self.series.values()]

    def _graphs(self) -> list[tuple[Graph, list[Value], str]]:
        parts = [(*self._formulas, "")]
        if self.closing is not None:
            outputs = [*self.closing.outputs, *self.closing.pivots]
            outputs += [x for row in self.closing.Psi for x in row.values()]
            graph = next(x.graph for x in outputs if isinstance(x, Expression))
            parts.append((graph, outputs, "closing."))
        return parts

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
    def whole(self) -> dict[str, int]:
        """All items, those of the code's own included."""
        names = list(self.place)
        names += [k for held in self._held.values() for k in held.values() if k not in self.place]
        names += [k for k, x in self.series.items() if self._stored(k, x)]
        return {name: i for i, name in enumerate(names)}

    @property
    def items(self) -> int:
        """How many a block has."""
        return len(self.whole)

    def fill(self, block: Array, rtol: float, atol: float, project: float = 1.0) -> None:
        """The scene's numbers and limits into a block (items, ...)."""
        place, mechanism = self.place, self.mechanism
        size = loop_size(mechanism) if self.closes else 0.0
        lightest = min(a.real for j, k, a in mechanism.A if j == k and a.real > 0.0)
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

    def at(self, k: Kernel, block: Word, name: str) -> Word:
        """The address of an item."""
        return k.at(block, self.whole[name], k.numbers)

    def get(self, k: Kernel, block: Word, name: str) -> Word:
        """An item."""
        return k.load(self.at(k, block, name))

    def put(self, k: Kernel, block: Word, name: str, value: Word) -> None:
        """Write an item."""
        k.store(value, self.at(k, block, name))

    def segment(
        self, k: Kernel, block: Word, graph: Graph, names: Mapping[str, str] | None = None
    ) -> Segment:
        """For a graph whose inputs are items; `names` gives those of other names."""
        renamed = names or {}
        return Segment(
            k,
            lambda name: self.get(k, block, renamed.get(name, name)),
            self.held_words(k, block, graph),
        )

    def held_words(self, k: Kernel, block: Word, graph: Graph) -> dict[int, Callable[[], Word]]:
        """What reads the nodes of a graph that `prepare` computes."""

        def reader(item: str) -> Callable[[], Word]:
            read = partial(self.get, k, block, item)
            return cache(read) if self.short else read

        return {index: reader(item) for index, item in self._held.get(id(graph), {}).items()}

    def write(self, module: Module) -> None:
        """The kernels into a module; `size` tells how many items a block has."""
        k = Kernel(module, "size", ())
        k.done(k.whole(self.items))
        self._prepare(module)
        self._expand(module)
        self._evaluate(module)
        if self.closing is not None:
            write_close(self, module, self.closing)
            write_leaps(self, module, self.closing)
        if self.bends:
            self._compare(module)

    def _prepare(self, module: Module) -> None:
        k, block = self.kernel(module, "prepare")
        for graph, outputs, prefix in self._graphs():
            held = self._held[id(graph)]
            nodes = [x for x in needed(outputs) if x.index in held and x.op not in INPUTS]
            names = {name: self.get(k, block, f"{prefix}{name}") for name in graph.parameters}
            segment = Segment(k, names)
            for node, word in zip(nodes, segment.write(nodes), strict=True):
                self.put(k, block, held[node.index], word)
        k.done()

    def _expand(self, module: Module) -> None:
        k, block = self.kernel(module, "expand")
        segment = self.segment(k, block, self.found.graph)
        own = {name: x for name, x in self.series.items() if self._stored(name, x)}
        words = segment.write([self.found.longest, *own.values()])
        for name, word in zip(("longest", *own), words, strict=True):
            self.put(k, block, name, word)
        k.done()

    def _evaluate(self, module: Module) -> None:
        k, block = self.kernel(module, "evaluate")
        graph, n = Graph(), self.mechanism.n
        found = self.found._replace(
            rho=[self.coefficients(graph, f"rho{j}") for j in range(n)],
            theta=[self.coefficients(graph, f"theta{j}") for j in range(n)],
            power=self.coefficients(graph, "power0"),
            steady=[graph.variable(f"u{j}") if x else 0.0 for j, x in enumerate(self.found.steady)],
        )
        outputs = end_of_step(self.mechanism, found, self.work, graph)
        words = self.segment(k, block, graph).write(outputs)
        for name, word in zip(self.state, words, strict=True):
            self.put(k, block, f"to_{name}", word)
        k.done()

    def there(self, names: Sequence[str]) -> dict[str, str]:
        """Inputs of a graph, taken from the state at a step's end."""
        return {name: f"to_{name}" for name in names} | {"t": "t_there"}

    @property
    def _bending(self) -> tuple[Graph, list[Value]]:
        """Where what is watched starts."""
        return self.found.graph, [x[0] for x in self.found.watched]

    def _terms(self, k: Kernel, block: Word, i: int, x: Word) -> tuple[Word, Word]:
        """The sum of a watched series at x, and its largest term."""
        total = most = k.number(0.0)
        power = k.number(1.0)
        for m, value in enumerate(self.found.watched[i]):
            stored, name = isinstance(value, Expression), f"watched{i}_{m}"
            coefficient = self.get(k, block, name) if stored else k.number(float(value))
            term = k.multiply(coefficient, power)
            total, size = k.add(total, term), k.intrinsic("fabs", term)
            most = k.select(k.less(most, size), size, most)
            power = k.multiply(power, x)
        return total, most

    def _compare(self, module: Module) -> None:
        """Whether what may bend is, at the state there, what its series gives at x."""
        k, block = self.kernel(module, "compare")
        names = self.there([f"{name}{j}" for name in ("q", "qd") for j in range(self.mechanism.n)])
        graph, wanted = self._bending
        values = self.segment(k, block, graph, names).write(wanted)
        x, small, relative = (self.get(k, block, name) for name in ("x", "miss", "relative"))
        agrees = k.all_lanes(True)
        for i in range(len(self.bends)):
            total, most = self._terms(k, block, i, x)
            missed = k.intrinsic("fabs", k.subtract(total, values[i]))
            allowed = k.divide(small, self.get(k, block, f"arm{i}"))
            part = k.multiply(relative, most)
            within = k.either(k.compare("ole", missed, allowed), k.compare("ole", missed, part))
            agrees = k.both(agrees, within)
        self.put(k, block, "agrees", k.select(agrees, k.number(1.0), k.number(0.0)))
        k.done()
