"""The series of a step in machine code, with the order as a loop: `expand` and `evaluate`.

Columns of coefficients that are summed alike stand side by side, so that one call sums many, eight
numbers or more at a time: of many columns or many lanes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.expansion import Coefficients, ends, integral, longest_formula
from robodyn.engines.expression import Graph, Value
from robodyn.engines.order_loop import LoopExpansion, Sum
from robodyn.engines.segment import Segment

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene

WIDE = 8  # most items that a sum takes at a time: what stands beside a run may be read


class Run(NamedTuple):
    """Sums of columns x, x + stride, ... with y, y + stride, ...: where they begin and end."""

    sum: Sum
    x: int
    y: int
    wide: int  # columns
    place: int  # of its results, after what is left by the runs before it


def runs(loop: LoopExpansion) -> tuple[list[Run], dict[str, int], int]:
    """The sums as runs, where the result of each stands, and how much room they take."""
    column = {x.index: i for i, x in enumerate(loop.columns)}
    alike: dict[tuple[object, ...], dict[tuple[int, int], tuple[str, Sum]]] = {}
    for name, one in loop.sums:
        key = (*one[2:6], getattr(one.level, "index", one.level))
        pair = column[one.x.index], column[one.y.index]
        alike.setdefault(key, {})[pair] = name, one
    found: list[Run] = []
    places: dict[str, int] = {}
    room = 0
    for group in alike.values():
        left = sorted(group)
        while left:
            x, y = left[0]
            for stride in (1, 2):
                count = 1
                while (x + count * stride, y + count * stride) in group:
                    count += 1
                if count > 1:
                    break
            members = [(x + i * stride, y + i * stride) for i in range(count)]
            places |= {group[pair][0]: room + pair[0] - x for pair in members}
            wide = members[-1][0] - x + 1
            found.append(Run(group[x, y][1], x, y, wide, room))
            room += wide + WIDE
            left = [pair for pair in left if pair not in members]
    return found, places, room


# -- loops over columns ----------------------------------------------------------------------------


def _wide(module: Module) -> Module:
    """The same of so many numbers at a time: of several columns, as each waits for its terms."""
    wide = Module(max(8, 4 * module.lanes))
    wide.functions = module.functions
    return wide


def _write_sums(module: Module, columns: int) -> None:
    """convolve(x, y, out, terms, wide) and weigh(x, y, out, terms, wide, level, slope).

    Over so many numbers side by side: the sum of (slope j + level) x_j y_j, the rows of x going
    up and those of y down.
    """
    step = columns * module.lanes
    for name, weights in (("convolve", 0), ("weigh", 2)):
        arguments = [*[ADDRESS] * 3, WHOLE, WHOLE, *[SCALAR] * weights]
        k = Kernel(_wide(module), name, arguments, "void")
        x, y, out, terms, wide, *weight = k.arguments
        with k.loop(wide, step=k.lanes) as i:
            begin = k.at(x, i), k.at(y, i)
            with k.loop(terms):
                total = k.carried(k.number(0.0))
                xj, yj = map(k.carried, begin)
                a = k.load(xj)
                if weights:
                    level = k.carried(weight[0])
                    a = k.multiply(a, k.spread(level))
                    k.becomes(level, k.add(level, weight[1]))
                k.becomes(total, k.add(total, k.multiply(a, k.load(yj))))
                k.becomes(xj, k.at(xj, step))
                k.becomes(yj, k.at(yj, -step))
            k.store(total, k.at(out, i))
        k.done()


def _sum_rows(
    k: Kernel, rows: tuple[Word, Word, Word], terms: Word, wide: int, weight: tuple[Word, float]
) -> None:
    """Of so many columns, into the last of three rows; the weight begins at a level."""
    level, slope = weight
    rest = f"{', '.join(map(str, rows))}, {terms}, i64 {wide * k.lanes}"
    if slope:
        rest += f", {k.lane(level, 0)}, {k.scalar(slope)}"
    k.line(f"call void @{'weigh' if slope else 'convolve'}({rest})")


def _write_polynomials(module: Module, columns: int) -> None:
    """polynomials(series, values, slopes, rows, wide, x): of so many columns, side by side."""
    k = Kernel(_wide(module), "polynomials", (*[ADDRESS] * 3, WHOLE, WHOLE, ADDRESS), "void")
    series, values, slopes, rows, wide, place = k.arguments
    lanes = f"<{module.lanes} x double>"
    again = ", ".join(f"i32 {i % module.lanes}" for i in range(k.lanes))
    own = k.load(place, lanes)
    x = k.op(k.numbers, f"shufflevector {own}, {lanes} poison, <{k.lanes} x i32> <{again}>")
    with k.loop(wide, step=k.lanes) as i:
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
    """`expand(block)`: the series at the state, the longest step, and the rates that are wanted."""
    loop = scene.loop
    all_runs, places, _ = scene.runs
    _write_sums(module, len(loop.columns))
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
        for run in all_runs:
            one = run.sum
            x = scene.row(k, block, one.first, run.x)
            y = scene.row(k, block, k.add(p, k.whole(one.m - one.first)), run.y)
            terms = k.add(p, k.whole(one.last - one.first + 1))
            level = segment.write([one.level])[0]
            if one.slope:
                level = k.add(level, k.number(one.slope * one.first))
            out = scene.at(k, block, "sums", run.place)
            _sum_rows(k, (x, y, out), terms, run.wide, (level, one.slope))
        words = segment.write([value for *_, value in grown])
        for (column, offset, _), word in zip(grown, words, strict=True):
            k.store(word, k.at(rows[offset], column, k.numbers))
    _longest(scene, k, block)
    if scene.rate_series or scene.link >= 0:
        _rates(scene, k, block)
    k.done()


def _coefficients(graph: Graph, column: int, orders: range) -> list[Value]:
    """As variables of a graph that `_segment` reads."""
    return [graph.variable(f"{column}_{m}") for m in orders]


def _segment(scene: Scene, k: Kernel, block: Word) -> Segment:
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
    zeros: list[Value] = [0.0] * scene.order
    last = range(scene.order, scene.order + 2)
    rho = [zeros + _coefficients(graph, i, last) for i in turns]
    theta = [zeros + _coefficients(graph, i + 1, last) for i in turns]
    w = [graph.variable(f"{i + 1}_1") for i in turns]
    slides = scene.mechanism.slides
    h = longest_formula(graph, Coefficients(rho, theta, [], []), w, True, slides)
    scene.put(k, block, "longest", _segment(scene, k, block).write([h])[0])


def _rates(scene: Scene, k: Kernel, block: Word) -> None:
    """The series of rates: sum of (2 j - m - 1) theta_j rho_{m+1-j} for each link."""
    n, orders = scene.mechanism.n, scene.order + 1
    wanted: list[tuple[str, int, int, int | None]]
    wanted = [("link0_0", 0, scene.link, None)] if scene.link >= 0 else []
    if scene.rate_series:
        parents = enumerate(scene.mechanism.above)
        wanted += [("rate0_0", j * orders, j, above) for j, above in parents]
    x, out = scene.row(k, block, 0, 1), scene.at(k, block, "value")
    with k.loop(k.whole(orders)) as m:
        above = k.add(m, k.whole(1))
        level = k.negate(k.spread(k.convert("sitofp", above, SCALAR)))
        y, terms = scene.row(k, block, above), k.add(m, k.whole(2))
        _sum_rows(k, (x, y, out), terms, 2 * n - 1, (level, 2.0))
        for name, place, j, below in wanted:
            rate = k.load(k.at(out, 2 * j, k.numbers))
            if below is not None:
                rate = k.subtract(rate, k.load(k.at(out, 2 * below, k.numbers)))
            k.store(rate, k.at(scene.at(k, block, name, place), m, k.numbers))


def write_evaluate(scene: Scene, module: Module) -> None:
    """`evaluate(block)`: the state at x after the start."""
    _write_polynomials(module, len(scene.loop.columns))
    k, block = scene.kernel(module, "evaluate")
    n, graph = scene.mechanism.n, Graph()
    places = [scene.at(k, block, name) for name in ("rows", "value", "slope")]
    rest = k.whole(scene.order + 2), k.whole(2 * n * k.lanes), scene.at(k, block, "x")
    k.line(f"call void @polynomials({', '.join(map(str, (*places, *rest)))})")
    value, slope = (
        [
            (graph.variable(f"{name} {i}"), graph.variable(f"{name} {i + 1}"))
            for i in range(0, 2 * n, 2)
        ]
        for name in ("value", "slope")
    )
    turns = list(zip(value, slope, strict=True))
    power: Value = 0.0
    if scene.loop.power:
        column = 2 * n + scene.loop.watched
        series = _coefficients(graph, column, range(scene.order + 1))
        power = integral(series, graph.variable("x"))
    steady = [graph.variable(f"u{j}") if x else 0.0 for j, x in enumerate(scene.loop.start.steady)]
    outputs = ends(scene.mechanism, turns, power, steady, scene.work, graph.variable)
    for name, word in zip(scene.state, _segment(scene, k, block).write(outputs), strict=True):
        scene.put(k, block, f"to_{name}", word)
    k.done()
