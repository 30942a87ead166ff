"""The series of a step in machine code, with the order as a loop: `expand` and `evaluate`.

Columns of coefficients that are summed alike stand side by side, so that a vector of eight numbers
sums many: of columns or of lanes.  One loop runs over the terms of several vectors: none of them
waits for its last term then.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from robodyn.engines.arithmetic import Planar
from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.expansion import Coefficients, ends, integral, longest_step, rough
from robodyn.engines.expression import Graph, Value, choose
from robodyn.engines.machine_sums import WIDE, Run, read_together, repeated, write_sums
from robodyn.engines.order_loop import Sum
from robodyn.engines.segment import Segment

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene


def write_polynomials(module: Module, columns: int) -> None:
    """polynomials(series, values, slopes, rows, numbers, x): of so many columns, side by side."""
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


def write_expand(scene: Scene, module: Module, chooses: bool = True) -> None:
    """`expand(block)`: the series at the state, and the rates that are wanted.

    Where it `chooses` the longest step, too.
    """
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
        found = {(offset, i): word for (i, offset, _), word in zip(grown, words, strict=True)}
        if k.lanes == 1 and module.together:  # a vector is had at once only where it is stored so
            for offset, begin, wide in read_together(all_runs, found):
                together = k.gathered([found.pop((offset, begin + i)) for i in range(wide)])
                k.store(together, k.at(rows[offset], begin))
        for (offset, column), word in found.items():
            k.store(word, k.at(rows[offset], column, k.numbers))
    if chooses:
        _longest(scene, k, block)
    if scene.rate_series or scene.link >= 0:
        _rates(scene, k, block)
    k.done()


def coefficients(graph: Graph, column: int, orders: range) -> list[Value]:
    """As variables of a graph that `read_segment` reads."""
    return [graph.variable(f"{column}_{m}") for m in orders]


def read_segment(scene: Scene, k: Kernel, block: Word) -> Segment:
    """For graphs of coefficients, of items, and of what stands in tables, as in "value 3"."""

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
        power = coefficients(graph, 2 * len(rho) + scene.loop.watched, range(scene.order + 1))
    series = Coefficients(rho, theta, power, [])
    h = longest_step(series, w, *tolerances, rough, scene.mechanism.slides, steady)
    if power:  # it may be beyond the floats where the motion is not
        h = choose(abs(power[-1]), math.inf, h, math.nan)
    scene.put(k, block, "longest", read_segment(scene, k, block).write([h])[0])


def _rates(scene: Scene, k: Kernel, block: Word) -> None:
    """The series of rates: sum of (2 j - m - 1) theta_j rho_{m+1-j} for each link."""
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
            found = k.load(k.at(out, 2 * j, k.numbers))
            if below is not None:
                found = k.subtract(found, k.load(k.at(out, 2 * below, k.numbers)))
            k.store(found, k.at(scene.at(k, block, name, place), m, k.numbers))


def value_and_slope(graph: Graph, n: int) -> list[tuple[Planar, Planar]]:
    """What `polynomials` leaves of the turns of n coordinates, as `ends` takes it."""

    def pair(name: str, i: int) -> Planar:
        return graph.variable(f"{name} {i}"), graph.variable(f"{name} {i + 1}")

    return [(pair("value", i), pair("slope", i)) for i in range(0, 2 * n, 2)]


def write_evaluate(scene: Scene, module: Module) -> None:
    """`evaluate(block)`: the state at x after the start."""
    write_polynomials(module, len(scene.loop.columns))
    k, block = scene.kernel(module, "evaluate")
    n, graph = scene.mechanism.n, Graph()
    places = [scene.at(k, block, name) for name in ("rows", "value", "slope")]
    rest = k.whole(scene.order + 2), k.whole(2 * n * k.lanes), scene.at(k, block, "x")
    k.call("polynomials", *places, *rest)
    turns = value_and_slope(graph, n)
    power: Value = 0.0
    if scene.loop.power:
        column = 2 * n + scene.loop.watched
        series = coefficients(graph, column, range(scene.order + 1))
        power = integral(series, graph.variable("x"))
    steady = [graph.variable(f"u{j}") if x else 0.0 for j, x in enumerate(scene.loop.start.steady)]
    outputs = ends(scene.mechanism, turns, power, steady, scene.work, graph.variable)
    for name, word in zip(scene.state, read_segment(scene, k, block).write(outputs), strict=True):
        scene.put(k, block, f"to_{name}", word)
    k.done()
