"""Steps of the Taylor series in machine code: one motion in each of W lanes.

A block holds the motions of one vector in items of W doubles: the state (q0, ..., qd0, ..., work),
the state at a step's end (to_q0, ...), the time, the torques, the scene's numbers, and the status.
`Scene.place` has the index of each.  The series follow: a matrix with a row for each order and a
column for each series.  The kernels compute

    expand(block)      the series at the state, and the longest step
    evaluate(block)    the state at x after the start, from the series
    close(block)       that state moved to the nearest that closes, and its quality
    leaps(block)       quality -1 if the step may have leapt to another branch
    strays(block)      the part of the step within which no argument of a function strays
    agrees(block)      half of the step, if there the accelerations are not those of the series

`advance` (`machine_motion.py`) calls them.  The code has no numbers in it: it serves all scenes of
one shape.

The order of the series is a loop.  Columns of coefficients that are summed alike stand side by
side, so that a vector of eight numbers sums several columns or lanes.  One loop runs over the terms
of several vectors, so that none of them waits for its last term.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import groupby, product
from typing import NamedTuple

from robodyn.engines.arithmetic import Planar
from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.expansion import (
    Coefficients,
    LoopExpansion,
    MotionProgram,
    Sum,
    ends,
    integral,
    longest_step,
    loop_expansion,
    rough,
    strays,
)
from robodyn.engines.expression import Graph, Value, choose
from robodyn.engines.formulas import Formula, projection_formula
from robodyn.engines.segment import Segment
from robodyn.loops.assembly import loop_size
from robodyn.loops.change_points import suspect_quality
from robodyn.loops.closing import CLOSED
from robodyn.loops.projection import CONVERGED
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.planar_model import Mechanism
from robodyn.tables.arrays import Array

BENT = 1e-10  # part of an acceleration by which its series may miss it, at any tolerance
ALIGNED = 8  # items, on which a vector of one lane and 8 numbers crosses no line of the cache
# of a block, besides what its scene asks for
COMMON = (
    "t", "bound", "direction", "status", "steps", "most_steps", "x", "t_there", "h", "longest",
    "quality", "part", "relative", "rtol", "atol", "suspect", "rounding", "converged", "base_t",
)  # fmt: skip


class Scene:
    """A mechanism and its torques as layout, code and numbers of a block.

    Without `closes`, closures drift.  With `rate_series`, the series of joint rates are stored in
    the block, from rate0_0 on, joint by joint; with `link`, also the series of that link's rate,
    from link0_0 on.  `kept` are items of an observer with their initial values.  `motion` has the
    rows of the program, if these are not those of the mechanism.
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
        self.values = {f"c{i}": x for i, x in enumerate(program.numbers)}
        self.values |= {f"u{j}": x for j, x in enumerate(actuation.constants or ())}
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
        """Formulas of one step; raises ZeroDivisionError if no state has a series."""
        return loop_expansion(self.motion, self.order)

    @cached_property
    def closing(self) -> Formula | None:
        """Formula of one Newton step of the projection; None if closures are not kept."""
        formula = projection_formula(self.mechanism, generic=True) if self.closes else None
        if self.closes and formula is None:
            raise ZeroDivisionError("closures that no state can keep")
        return formula

    @property
    def closing_names(self) -> dict[str, str]:
        """Names in the block of the numbers that the Newton step takes."""
        return {name[8:]: name for name in self.values if name.startswith("closing.")}

    # -- the block ---------------------------------------------------------------------------------

    @property
    def state(self) -> list[str]:
        """Names of the state's items."""
        names = [f"{name}{j}" for name in ("q", "qd") for j in range(self.mechanism.n)]
        return [*names, "work"] if self.work else names

    @cached_property
    def place(self) -> dict[str, int]:
        """Index of each item that Python reads or writes; these come first in the block."""
        n = self.mechanism.n
        names = [*self.state, *(f"to_{name}" for name in self.state), *COMMON]
        if self.linear:
            names += [f"{name}{j}" for name in ("base", "dtau", "tau") for j in range(n)]
        return {name: i for i, name in enumerate([*names, *self.values])}

    @cached_property
    def runs(self) -> tuple[list[Run], dict[str, int], int]:
        """The result of `runs` for the step's formulas."""
        return runs(self.loop)

    @cached_property
    def whole(self) -> dict[str, int]:
        """Index of each item, and of the first number of each internal table."""
        whole = dict(self.place)
        place = len(whole)
        for name, size in {**self.tables, "end": 0}.items():
            place += -place % ALIGNED
            whole[name] = place
            place += size
        return whole

    @property
    def tables(self) -> dict[str, int]:
        """Sizes of the internal tables."""
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
        """Number of items in a block."""
        return self.whole["end"]

    def fill(self, block: Array, rtol: float, atol: float, project: float = 1.0) -> None:
        """Write the scene's numbers and tolerances into a block (items, ...)."""
        place, mechanism = self.place, self.mechanism
        size = loop_size(mechanism) if self.closes else 0.0
        limits = {
            "rtol": rtol,
            "atol": atol,
            "relative": max(10.0 * rtol, BENT),
            "suspect": suspect_quality(mechanism) * project if self.closes else 0.0,
            "rounding": CLOSED * size,
            "converged": CONVERGED * size,
            "most_steps": math.inf,
        }
        for name, value in (self.values | limits).items():
            block[place[name]] = value

    # -- code --------------------------------------------------------------------------------------

    def kernel(self, module: Module, name: str) -> tuple[Kernel, Word]:
        """Begin a kernel with the block as its only argument; return kernel and argument."""
        k = Kernel(module, name, (ADDRESS,), "void")
        return k, k.arguments[0]

    def at(self, k: Kernel, block: Word, name: str, place: int = 0) -> Word:
        """Return the address of an item, or of number `place` of a table."""
        return k.at(block, self.whole[name] + place, k.numbers)

    def row(self, k: Kernel, block: Word, m: Word | int, column: int = 0) -> Word:
        """Return the address of coefficient m of series `column`."""
        width = len(self.loop.columns)
        if isinstance(m, int):
            return self.at(k, block, "rows", m * width + column)
        row = k.at(block, k.multiply(m, k.whole(width)), k.numbers)
        return self.at(k, row, "rows", column)

    def get(self, k: Kernel, block: Word, name: str) -> Word:
        """Load an item."""
        return k.load(self.at(k, block, name))

    def put(self, k: Kernel, block: Word, name: str, value: Word) -> None:
        """Store an item."""
        k.store(value, self.at(k, block, name))

    def segment(
        self,
        k: Kernel,
        block: Word,
        outputs: Sequence[Value],
        read: Callable[[str], Word] | Mapping[str, str] | None = None,
    ) -> Segment:
        """Return a code segment for outputs; `read` maps their inputs to items or words.

        Values that depend on the scene's numbers alone are computed here, before any loop.
        """
        if not callable(read):
            names = read or {}

            def read(name: str) -> Word:
                return self.get(k, block, names.get(name, name))

        segment = Segment(k, read)
        segment.constants(outputs)
        return segment

    def write(self, module: Module) -> None:
        """Write all kernels into a module; `size()` returns the number of items of a block."""
        k = Kernel(module, "size", ())
        k.done(k.whole(self.items))
        write_expand(self, module)
        write_evaluate(self, module)
        if self.motion.checked:
            self._strays(module)
            self._agrees(module)

    def there(self, names: Sequence[str]) -> dict[str, str]:
        """Map input names to the items of the state at a step's end."""
        return {name: f"to_{name}" for name in names} | {"t": "t_there"}

    def torques(self, k: Kernel, block: Word) -> None:
        """Write the torques that are linear in time, at the time of the state."""
        if not self.linear:
            return
        past = k.subtract(self.get(k, block, "t"), self.get(k, block, "base_t"))
        for j in range(self.mechanism.n):
            change = k.multiply(self.get(k, block, f"dtau{j}"), past)
            self.put(k, block, f"tau{j}", k.add(self.get(k, block, f"base{j}"), change))

    def fastest(self, k: Kernel, block: Word, least: float) -> Word:
        """Return the largest of the joints' rates at the start of the step, or `least`."""
        fast = k.number(least)
        for j in range(self.mechanism.n):
            size = k.intrinsic("fabs", self.get(k, block, f"qd{j}"))
            fast = k.select(k.less(fast, size), size, fast)
        return fast

    def _strays(self, module: Module) -> None:
        """Write `strays(block)`: the part of the step, 1 or less, in which no argument strays."""
        k, block = self.kernel(module, "strays")
        graph, orders = Graph(), range(self.order)
        series = [coefficients(graph, column, orders) for column in self.loop.spanned]
        part = strays(self.motion.spans, series, graph.variable("x"))
        self.put(k, block, "part", read_segment(self, k, block).write([part])[0])
        k.done()

    def _agrees(self, module: Module) -> None:
        """Write `agrees(block)`: the part becomes one half at most if accelerations differ at x.

        They are those of the series and of the state there, times the square of x: angles, or m.
        """
        k, block = self.kernel(module, "agrees")
        n, x = self.mechanism.n, self.get(k, block, "x")
        there = self.there([f"{z}{j}" for z in ("q", "qd") for j in range(n)])

        def read(name: str) -> Word:
            if name.startswith("tau"):  # linear in time
                change = k.multiply(self.get(k, block, f"d{name}"), x)
                return k.add(self.get(k, block, name), change)
            return self.get(k, block, there.get(name, name))

        halves = [self.loop.columns[2 * j + 1].first[2] for j in range(n)]
        exact = self.segment(k, block, halves, read).write(halves)
        square, fast = k.multiply(k.number(2.0), k.multiply(x, x)), self.fastest(k, block, 0.0)
        small = k.add(self.get(k, block, "atol"), k.multiply(self.get(k, block, "rtol"), fast))
        small = k.multiply(small, k.multiply(k.number(self.order + 1.0), k.intrinsic("fabs", x)))
        part = self.get(k, block, "part")
        half = k.select(k.less(part, k.number(0.5)), part, k.number(0.5))
        for j in range(n):
            theta, bend, largest = self._bent(k, block, 2 * j + 1, x)
            if j not in self.mechanism.slides:
                rho, inward, most = self._bent(k, block, 2 * j, x)
                largest = k.select(k.less(largest, most), most, largest)
                bend = k.subtract(k.multiply(rho, bend), k.multiply(theta, inward))
                radius = k.add(k.multiply(rho, rho), k.multiply(theta, theta))
                bend = k.divide(bend, radius)
            missed = k.intrinsic("fabs", k.subtract(bend, k.multiply(square, exact[j])))
            allowed = k.add(small, k.multiply(self.get(k, block, "relative"), largest))
            part = k.select(k.compare("ole", missed, allowed), part, half)
        self.put(k, block, "part", part)
        k.done()

    def _bent(self, k: Kernel, block: Word, column: int, x: Word) -> tuple[Word, Word, Word]:
        """Return a series at x, x^2 times its second derivative, and the largest term of that."""
        with k.loop(k.whole(self.order + 2)) as m:
            zero, one = k.number(0.0), k.number(1.0)
            value, bend, largest, power, order = map(k.carried, (zero, zero, zero, one, zero))
            term = k.multiply(k.load(self.row(k, block, m, column)), power)
            second = k.multiply(term, k.multiply(order, k.subtract(order, one)))
            size = k.intrinsic("fabs", second)
            k.becomes(value, k.add(value, term))
            k.becomes(bend, k.add(bend, second))
            k.becomes(largest, k.select(k.less(largest, size), size, largest))
            k.becomes(power, k.multiply(power, x))
            k.becomes(order, k.add(order, one))
        return value, bend, largest


class Items:
    """Access to the items of a scene's block within a kernel."""

    def __init__(self, scene: Scene, k: Kernel, block: Word) -> None:
        self.scene, self.k, self.block = scene, k, block

    def get(self, name: str) -> Word:
        """Load an item."""
        return self.scene.get(self.k, self.block, name)

    def put(self, name: str, value: Word) -> None:
        """Store an item."""
        self.scene.put(self.k, self.block, name, value)


def write_polynomials(module: Module, columns: int) -> None:
    """Write polynomials(series, values, slopes, rows, numbers, x) for `columns` series."""
    wide = Module(max(WIDE, 4 * module.lanes))  # several columns, as each waits for its terms
    wide.functions = module.functions
    k = Kernel(wide, "polynomials", (*[ADDRESS] * 3, WHOLE, WHOLE, ADDRESS), "void")
    series, values, slopes, rows, numbers, place = k.arguments
    x = repeated(k, place, module.lanes, k.lanes)
    with k.loop(numbers, step=k.lanes) as i:
        last = k.at(k.at(series, i), k.multiply(rows, k.whole(columns * module.lanes)))
        with k.loop(rows):
            place, value, slope = map(k.carried, (last, k.number(0.0), k.number(0.0)))
            above = k.at(place, -columns * module.lanes)
            k.becomes(place, above)
            k.becomes(slope, k.add(k.multiply(slope, x), value))
            k.becomes(value, k.add(k.multiply(value, x), k.load(above)))
        k.store(value, k.at(values, i))
        k.store(slope, k.at(slopes, i))
    k.done()


# -- the series ------------------------------------------------------------------------------------


def write_expand(scene: Scene, module: Module) -> None:
    """Write `expand(block)`: the series at the state, the longest step, and rates if wanted."""
    loop = scene.loop
    all_runs, places, _ = scene.runs
    sums = write_sums(module, "sums", all_runs, len(loop.columns), -loop.first)
    k, block = scene.kernel(module, "expand")
    columns = {x.index: i for i, x in enumerate(loop.columns)}
    rows: dict[int, Word] = {}  # by the offset from p
    now: dict[str, Word] = {}  # of the order p

    def read(name: str) -> Word:
        if name in now:
            return now[name]
        if name in places:
            return k.load(scene.at(k, block, "sums", places[name]))
        column, earlier, offset = name.partition("@")
        if earlier:
            return k.load(k.at(rows[int(offset)], columns[int(column)], k.numbers))
        return scene.get(k, block, name)

    segment = scene.segment(k, block, loop.outputs, read)
    known, grown = list(loop.known()), list(loop.grown())
    offsets = {m for _, m, _ in grown} | loop.offsets
    words = segment.write([value for *_, value in known])
    for (column, m, _), word in zip(known, words, strict=True):
        k.store(word, scene.row(k, block, m, column))
    segment.write(loop.steady())
    with k.loop(k.whole(loop.last + 1), k.whole(loop.first)) as p:
        now["p"] = k.spread(k.convert("sitofp", p, SCALAR))
        rows |= {m: scene.row(k, block, k.add(p, k.whole(m))) for m in offsets}
        for name, weights in sums:
            levels = [k.lane(segment.write([level])[0], 0) for _, level in weights]
            rest = scene.row(k, block, 0), scene.row(k, block, p), scene.at(k, block, "sums"), p
            k.call(name, *rest, *levels)
        words = segment.write([value for *_, value in grown])
        newest = {(offset, i): word for (i, offset, _), word in zip(grown, words, strict=True)}
        if k.lanes == 1 and module.together:  # a vector is had at once only where it is stored so
            for offset, begin, wide in read_together(all_runs, newest):
                together = k.gathered([newest.pop((offset, begin + i)) for i in range(wide)])
                k.store(together, k.at(rows[offset], begin))
        for (offset, column), word in newest.items():
            k.store(word, k.at(rows[offset], column, k.numbers))
    _longest(scene, k, block)
    if scene.rate_series or scene.link >= 0:
        _rates(scene, k, block)
    k.done()


def coefficients(graph: Graph, column: int, orders: range) -> list[Value]:
    """Return variables of a graph for the coefficients of a series, which `read_segment` loads."""
    return [graph.variable(f"{column}_{m}") for m in orders]


def read_segment(scene: Scene, k: Kernel, block: Word) -> Segment:
    """Return a segment that loads coefficients, items, and table entries such as "value 3"."""

    def read(name: str) -> Word:
        column, is_series, m = name.partition("_")
        if is_series and column.isdecimal():
            return k.load(scene.row(k, block, int(m), int(column)))
        table, _, place = name.partition(" ")
        return k.load(scene.at(k, block, table, int(place or 0)))

    return Segment(k, read)


def _longest(scene: Scene, k: Kernel, block: Word) -> None:
    graph, turns = Graph(), range(0, 2 * scene.mechanism.n, 2)
    steady = scene.motion.steady
    first = scene.order if steady else scene.order // 2  # of the orders that it reads
    zeros: list[Value] = [0.0] * first
    last = range(first, scene.order + 2)
    rho = [zeros + coefficients(graph, i, last) for i in turns]
    theta = [zeros + coefficients(graph, i + 1, last) for i in turns]
    w = [graph.variable(f"{i + 1}_1") for i in turns]
    tolerances = graph.variable("rtol"), graph.variable("atol")
    power: list[Value] = []
    if scene.loop.power:
        power = coefficients(graph, 2 * len(rho), range(scene.order + 1))
    series = Coefficients(rho, theta, power, [])
    h = longest_step(series, w, *tolerances, rough, scene.mechanism.slides, steady)
    if power:  # it may be beyond the floats where the motion is not
        h = choose(abs(power[-1]), math.inf, h, math.nan)
    scene.put(k, block, "longest", read_segment(scene, k, block).write([h])[0])


def _rates(scene: Scene, k: Kernel, block: Word) -> None:
    """Write the series of rates: sum of (2 j - m - 1) theta_j rho_{m+1-j} for each link."""
    n, orders, columns = scene.mechanism.n, scene.order + 1, scene.loop.columns
    wanted: list[tuple[str, int, int, int | None]]
    wanted = [("link0_0", 0, scene.link, None)] if scene.link >= 0 else []
    if scene.rate_series:
        parents = enumerate(scene.mechanism.above)
        wanted += [("rate0_0", j * orders, j, above) for j, above in parents]
    rate = Sum(columns[1], columns[0], 1, 0, 1, 2.0, 0.0)  # its level changes with m
    run = Run(rate, 1, 0, 2 * n - 1, (2, 2), 0)
    functions = write_sums(k.module, "rates", [run], len(columns), 0)
    x, out = scene.row(k, block, 0), scene.at(k, block, "value")
    with k.loop(k.whole(orders)) as m:
        above = k.add(m, k.whole(1))
        level = k.negate(k.convert("sitofp", above, SCALAR))
        for function, _ in functions:
            rest = x, scene.row(k, block, m), out, m, level
            k.call(function, *rest)
        for name, place, j, below in wanted:
            value = k.load(k.at(out, 2 * j, k.numbers))
            if below is not None:
                value = k.subtract(value, k.load(k.at(out, 2 * below, k.numbers)))
            k.store(value, k.at(scene.at(k, block, name, place), m, k.numbers))


def value_and_slope(graph: Graph, n: int) -> list[tuple[Planar, Planar]]:
    """Return values and slopes of n coordinates' turns, as written by `polynomials`."""

    def pair(name: str, i: int) -> Planar:
        return graph.variable(f"{name} {i}"), graph.variable(f"{name} {i + 1}")

    return [(pair("value", i), pair("slope", i)) for i in range(0, 2 * n, 2)]


def write_evaluate(scene: Scene, module: Module) -> None:
    """Write `evaluate(block)`: the state at x after the start."""
    write_polynomials(module, len(scene.loop.columns))
    k, block = scene.kernel(module, "evaluate")
    n, graph = scene.mechanism.n, Graph()
    places = [scene.at(k, block, name) for name in ("rows", "value", "slope")]
    rest = k.whole(scene.order + 2), k.whole(2 * n * k.lanes), scene.at(k, block, "x")
    k.call("polynomials", *places, *rest)
    turns = value_and_slope(graph, n)
    power: Value = 0.0
    if scene.loop.power:
        series = coefficients(graph, 2 * n, range(scene.order + 1))
        power = integral(series, graph.variable("x"))
    steady = [graph.variable(f"u{j}") if x else 0.0 for j, x in enumerate(scene.loop.start.steady)]
    outputs = ends(scene.mechanism, turns, power, steady, scene.work, graph.variable)
    for name, word in zip(scene.state, read_segment(scene, k, block).write(outputs), strict=True):
        scene.put(k, block, f"to_{name}", word)
    k.done()


WIDE = 8  # items that a sum takes at a time: what stands beside a run may be read


class Run(NamedTuple):
    """Products x, x + strides[0], ... by y, y + strides[1], ...: columns of a run of sums."""

    sum: Sum
    x: int
    y: int
    wide: int  # columns of y
    strides: tuple[int, int]
    place: int  # of its results, after what is left by the runs before it


Weight = tuple[float, Value]  # slope, and level at the first term


class Vector(NamedTuple):
    """Some of the sums of x_j y_{p-j}, side by side in one vector."""

    x: int  # columns after the first one of order 0
    y: int  # after the first one of order p
    place: int  # of its results
    wide: int  # columns
    terms: int  # how many more than p
    same: bool  # one column x serves them all
    weight: Weight | None


def runs(loop: LoopExpansion) -> tuple[list[Run], dict[str, int], int]:
    """Return the sums of a step as runs, the column of each result, and the room that they take."""
    column = {x.index: i for i, x in enumerate(loop.columns)}
    alike: dict[tuple[object, ...], dict[tuple[int, int], tuple[str, Sum]]] = {}
    for name, one in loop.sums:
        key = (*one[2:6], getattr(one.level, "index", one.level))
        pair = column[one.x.index], column[one.y.index]
        alike.setdefault(key, {})[pair] = name, one
    result: list[Run] = []
    places: dict[str, int] = {}
    room = 0
    for group in alike.values():
        left = sorted(group)
        while left:
            x, y = left[0]
            for strides in ((1, 1), (2, 2), (0, 1)):
                count = 1
                while (x + count * strides[0], y + count * strides[1]) in group:
                    count += 1
                if count > 1:
                    break
            members = [(x + i * strides[0], y + i * strides[1]) for i in range(count)]
            places |= {group[pair][0]: room + pair[1] - y for pair in members}
            wide = members[-1][1] - y + 1
            result.append(Run(group[x, y][1], x, y, wide, strides, room))
            room += wide + WIDE
            left = [pair for pair in left if pair not in members]
    return result, places, room


def alike(slides: Collection[int], n: int) -> Iterator[tuple[bool, Sequence[int]]]:
    """Yield joints in order, those in a row that all slide, or all turn, together."""
    for slide, joints in groupby(range(n), lambda j: j in slides):
        yield slide, list(joints)


# -- loops over columns ----------------------------------------------------------------------------


def _pieces(count: int) -> Iterator[tuple[int, int]]:
    """Yield start and width of vectors that cover `count` items."""
    begin, wide = 0, WIDE
    while begin < count:
        while wide > count - begin:
            wide //= 2
        yield begin, wide
        begin += wide


def _vectors(run: Run, module: Module, columns: int) -> Iterator[Vector]:
    """Yield the vectors of a run; gaps between columns are skipped if a column fills a vector."""
    each = max(1, WIDE // module.lanes) if module.together else run.wide
    if each == WIDE:  # of one lane
        pieces = list(_pieces(run.wide))
    else:
        pieces = [(i, each) for i in range(0, run.wide, run.strides[1] if each == 1 else each)]
    one = run.sum
    weight = (one.slope, one.level + one.slope * one.first) if one.slope else None
    x, y = one.first * columns + run.x, (one.m - one.first) * columns + run.y
    same, terms = run.strides[0] == 0, one.last - one.first + 1
    for i, wide in pieces:
        yield Vector(x if same else x + i, y + i, run.place + i, wide, terms, same, weight)


def _batches(vectors: Sequence[Vector], least: int, most: int) -> Iterator[Sequence[Vector]]:
    """Yield batches of up to `most` vectors with about equally many terms.

    If the fewest terms, `least`, may be zero, the first term is added separately.
    """
    left = sorted(vectors, key=lambda vector: vector.terms)
    while left:
        few = left[0].terms
        alike = [x for x in left if x.terms == few or least < few >= x.terms - 2]
        size = -(-len(alike) // -(-len(alike) // most))
        yield alike[:size]
        left = left[size:]


class _Batch:
    """Writes name(x, y, out, p, levels): sums of (slope j + level) x_j y_j into `out`.

    Rows of x go up from order 0, rows of y down from order p; each weight has its level.  The
    newest coefficients occur in the first and last term.  These are added at the end, so that the
    processor does not wait for them.
    """

    def __init__(
        self, module: Module, name: str, vectors: Sequence[Vector], weights: Sequence[Weight]
    ) -> None:
        self.vectors, self.weights, self.lanes = vectors, weights, module.lanes
        wide = Module(max(WIDE, module.lanes)) if module.together else module
        wide.functions = module.functions
        arguments = [*[ADDRESS] * 3, WHOLE, *[SCALAR] * len(weights)]
        self.k = Kernel(wide, name, arguments, "void")

    def call(self) -> None:
        """Sum each vector by one shared function."""
        k = self.k
        x, y, out, p, *levels = k.arguments
        for v in self.vectors:
            places = (k.at(base, i, k.numbers) for base, i in zip((x, y, out), v[:3], strict=True))
            rest = [*places, k.add(p, k.whole(v.terms)), k.whole(v.wide), k.whole(v.same)]
            if v.weight is not None:
                rest += [levels[self.weights.index(v.weight)], k.scalar(v.weight[0])]
            k.call("sum_rows", *rest)
        k.done()

    def write(self, columns: int, fewest: int) -> None:
        """Write one loop over the common terms, then the terms of longer sums."""
        k, vectors = self.k, self.vectors
        x, y, out, p, *levels = k.arguments
        self.step = columns * self.lanes
        least = min(v.terms for v in vectors)
        held = least > fewest
        newest, at_first = (x, y), levels
        if held:
            (x, y), levels = self._after(newest, levels)
        with k.loop(k.add(p, k.whole(least - held))):
            zeros = [_zeros(v.wide * self.lanes) for v in vectors]
            carried = [k.carried(word) for word in (x, y, *levels, *zeros)]
            totals = carried[2 + len(levels) :]
            rows, levels = (carried[0], carried[1]), carried[2 : 2 + len(levels)]
            self.totals = totals.copy()
            self._term(range(len(vectors)), rows, levels)
            above, new = self._after(rows, levels)
            for word, now in zip(carried, (*above, *new, *self.totals), strict=True):
                k.becomes(word, now)
        self.totals = totals
        for more in range(max(v.terms for v in vectors) - least):
            self._term([i for i, v in enumerate(vectors) if v.terms - least > more], rows, levels)
            rows, levels = self._after(rows, levels)
        if held:
            self._term(range(len(vectors)), newest, at_first)
        for total, vector in zip(self.totals, vectors, strict=True):
            k.store(total, k.at(out, vector.place * self.lanes))
        k.done()

    def _term(self, among: Sequence[int], rows: tuple[Word, Word], levels: Sequence[Word]) -> None:
        """Add one term to the totals of the vectors `among`."""
        k, known = self.k, dict[tuple[Word, int, int, bool], Word]()

        def read(row: Word, column: int, wide: int, same: bool = False) -> Word:
            key = row, column, wide, same
            if key not in known:
                place = k.at(row, column * self.lanes)
                type = f"<{wide} x double>" if wide > 1 else SCALAR
                known[key] = repeated(k, place, self.lanes, wide) if same else k.load(place, type)
            return known[key]

        for i in among:
            v = self.vectors[i]
            wide = v.wide * self.lanes
            a = read(rows[0], v.x, wide, v.same)
            if v.weight is not None:
                a = k.multiply(a, k.spread(levels[self.weights.index(v.weight)], wide))
            self.totals[i] = k.add(self.totals[i], k.multiply(a, read(rows[1], v.y, wide)))

    def _after(
        self, rows: tuple[Word, Word], levels: Sequence[Word]
    ) -> tuple[tuple[Word, Word], list[Word]]:
        """Return the rows and levels of the next term."""
        k = self.k
        slopes = (k.scalar(slope) for slope, _ in self.weights)
        new = [k.add(level, slope) for level, slope in zip(levels, slopes, strict=True)]
        return (k.at(rows[0], self.step), k.at(rows[1], -self.step)), new


def write_sums(
    module: Module, name: str, runs: Sequence[Run], columns: int, least: int
) -> list[tuple[str, list[Weight]]]:
    """Write functions that compute all runs; return their names and weights."""
    vectors = [vector for run in runs for vector in _vectors(run, module, columns)]
    functions = []
    for i, batch in enumerate(_batches(vectors, least, module.together or len(vectors))):
        weights = list(dict.fromkeys(v.weight for v in batch if v.weight is not None))
        written = _Batch(module, f"{name}{i}", batch, weights)
        if module.together:
            written.write(columns, least)
        else:
            written.call()
        functions.append((f"{name}{i}", weights))
    return functions


def repeated(k: Kernel, place: Word, lanes: int, wide: int) -> Word:
    """Return a vector of `wide` copies of the numbers at `place`."""
    if wide == 1:
        return k.load(place, SCALAR)
    return k.shuffled(k.load(place, f"<{lanes} x double>"), [i % lanes for i in range(wide)])


def read_together(
    runs: Sequence[Run], words: Mapping[tuple[int, int], Word]
) -> Iterator[tuple[int, int, int]]:
    """Yield (offset from p, first column, count) of columns that can be loaded as one vector."""
    taken: set[tuple[int, int]] = set()
    for run in (x for x in runs if x.strides == (1, 1)):
        for first, (begin, wide) in product((run.x, run.y), _pieces(run.wide)):
            columns = range(first + begin, first + begin + wide)
            for offset in sorted({offset for offset, _ in words}):
                places = {(offset, i) for i in columns}
                if wide > 1 and places <= words.keys() - taken:
                    taken |= places
                    yield offset, columns[0], wide


def _zeros(wide: int) -> Word:
    """Return a vector of zeros."""
    zero = "0x0000000000000000"
    return Word("zeroinitializer", f"<{wide} x double>") if wide > 1 else Word(zero, SCALAR)
