"""The series of a step in machine code, with the order as a loop: `expand` and `evaluate`.

Columns of coefficients that are summed alike stand side by side, so that a vector of eight numbers
sums many: of columns or of lanes.  One loop runs over the terms of several vectors: none of them
waits for its last term then.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

from robodyn.engines.arithmetic import Planar
from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.expansion import Coefficients, ends, integral, longest_formula
from robodyn.engines.expression import Graph, Value
from robodyn.engines.order_loop import LoopExpansion, Sum
from robodyn.engines.segment import Segment

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene

WIDE = 8  # items that a sum takes at a time: what stands beside a run may be read


class Run(NamedTuple):
    """Sums of columns x, x + strides[0], ... with y, y + strides[1], ...: where they are."""

    sum: Sum
    x: int
    y: int
    wide: int  # columns of y
    strides: tuple[int, int]
    place: int  # of its results, after what is left by the runs before it


Weight = tuple[float, Value]  # slope, and level at the first term


class Vector(NamedTuple):
    """Some of the sums of x_j y_{p-j}, side by side."""

    x: int  # columns after the first one of order 0
    y: int  # after the first one of order p
    place: int  # of its results
    wide: int  # columns
    terms: int  # how many more than p
    same: bool  # one column x serves them all
    weight: Weight | None


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
            for strides in ((1, 1), (2, 2), (0, 1)):
                count = 1
                while (x + count * strides[0], y + count * strides[1]) in group:
                    count += 1
                if count > 1:
                    break
            members = [(x + i * strides[0], y + i * strides[1]) for i in range(count)]
            places |= {group[pair][0]: room + pair[1] - y for pair in members}
            wide = members[-1][1] - y + 1
            found.append(Run(group[x, y][1], x, y, wide, strides, room))
            room += wide + WIDE
            left = [pair for pair in left if pair not in members]
    return found, places, room


# -- loops over columns ----------------------------------------------------------------------------


def _pieces(count: int) -> Iterator[tuple[int, int]]:
    """So many items in pieces that are vectors: where each begins, and its width."""
    begin, wide = 0, WIDE
    while begin < count:
        while wide > count - begin:
            wide //= 2
        yield begin, wide
        begin += wide


def _vectors(run: Run, module: Module, columns: int) -> Iterator[Vector]:
    """Those of a run, the gaps between its columns left out where a column is a vector."""
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
    """Up to `most` that are summed together: of about as many terms.

    Where these may be `least`, there may be none, and the first term is added first.
    """
    left = sorted(vectors, key=lambda vector: vector.terms)
    while left:
        few = left[0].terms
        alike = [x for x in left if x.terms == few or least < few >= x.terms - 2]
        size = -(-len(alike) // -(-len(alike) // most))
        yield alike[:size]
        left = left[size:]


def _write_batch(
    module: Module,
    name: str,
    vectors: Sequence[Vector],
    weights: Sequence[Weight],
    columns: int,
    fewest: int,
) -> None:
    """name(x, y, out, p, levels): sums of (slope j + level) x_j y_j to their places in `out`.

    The rows of x go up from order 0, those of y down from order p; a level for each weight.  What
    the order before has found stands in the first term and the last: they come last, so that the
    processor adds up the others while it is found.  There may be no term where there are `fewest`.
    """
    wide = Module(max(WIDE, module.lanes)) if module.together else module
    wide.functions = module.functions
    k = Kernel(wide, name, [*[ADDRESS] * 3, WHOLE, *[SCALAR] * len(weights)], "void")
    x, y, out, p, *levels = k.arguments
    if not module.together:
        for v in vectors:
            places = (k.at(base, i, k.numbers) for base, i in zip((x, y, out), v[:3], strict=True))
            rest = [*places, k.add(p, k.whole(v.terms)), k.whole(v.wide), k.whole(v.same)]
            if v.weight is not None:
                rest += [levels[weights.index(v.weight)], k.scalar(v.weight[0])]
            k.line(f"call void @sum_rows({', '.join(map(str, rest))})")
        k.done()
        return
    least = min(v.terms for v in vectors)

    def term(among: Sequence[int], rows: tuple[Word, Word], levels: Sequence[Word]) -> None:
        """Add one to the totals."""
        known: dict[tuple[Word, int, int, bool], Word] = {}

        def read(row: Word, column: int, wide: int, same: bool = False) -> Word:
            key = row, column, wide, same
            if key not in known:
                place = k.at(row, column * module.lanes)
                if same:
                    known[key] = _repeated(k, place, module.lanes, wide)
                else:
                    known[key] = k.load(place, numbers(wide))
            return known[key]

        for i in among:
            wide = vectors[i].wide * module.lanes
            a = read(rows[0], vectors[i].x, wide, vectors[i].same)
            if (weight := vectors[i].weight) is not None:
                a = k.multiply(a, k.spread(levels[weights.index(weight)], wide))
            totals[i] = k.add(totals[i], k.multiply(a, read(rows[1], vectors[i].y, wide)))

    def numbers(wide: int) -> str:
        return f"<{wide} x double>" if wide > 1 else SCALAR

    def after(rows: tuple[Word, Word], levels: Sequence[Word]) -> tuple[Word, Word, list[Word]]:
        """The rows and levels of the next term."""
        slopes = (k.scalar(slope) for slope, _ in weights)
        new = [k.add(level, slope) for level, slope in zip(levels, slopes, strict=True)]
        step = columns * module.lanes
        return k.at(rows[0], step), k.at(rows[1], -step), new

    held = least > fewest
    newest, at_first = (x, y), levels
    if held:
        x, y, levels = after(newest, levels)
    with k.loop(k.add(p, k.whole(least - held))):
        zeros = [k.zero(numbers(v.wide * module.lanes)) for v in vectors]
        carried = [k.carried(word) for word in (x, y, *levels, *zeros)]
        totals = carried[2 + len(levels) :]
        begun, rows, levels = totals.copy(), (carried[0], carried[1]), carried[2 : 2 + len(levels)]
        term(range(len(vectors)), rows, levels)
        up, down, new = after(rows, levels)
        for word, now in zip(carried, (up, down, *new, *totals), strict=True):
            k.becomes(word, now)
    totals[:] = begun
    for more in range(max(v.terms for v in vectors) - least):  # of those with more terms
        term([i for i, v in enumerate(vectors) if v.terms - least > more], rows, levels)
        up, down, levels = after(rows, levels)
        rows = up, down
    if held:
        term(range(len(vectors)), newest, at_first)
    for total, vector in zip(totals, vectors, strict=True):
        k.store(total, k.at(out, vector.place * module.lanes))
    k.done()


def _write_sums(
    module: Module, name: str, runs: Sequence[Run], columns: int, least: int
) -> list[tuple[str, list[Weight]]]:
    """The functions that sum all of these runs, and the weights of each."""
    vectors = [vector for run in runs for vector in _vectors(run, module, columns)]
    found = []
    for i, batch in enumerate(_batches(vectors, least, module.together or len(vectors))):
        weights = list(dict.fromkeys(v.weight for v in batch if v.weight is not None))
        _write_batch(module, f"{name}{i}", batch, weights, columns, least)
        found.append((f"{name}{i}", weights))
    return found


def _repeated(k: Kernel, place: Word, lanes: int, wide: int) -> Word:
    """So many numbers, again and again."""
    if wide == 1:
        return k.load(place, SCALAR)
    type, again = f"<{lanes} x double>", ", ".join(f"i32 {i % lanes}" for i in range(wide))
    shuffled = f"shufflevector {k.load(place, type)}, {type} poison, <{wide} x i32> <{again}>"
    return k.op(f"<{wide} x double>", shuffled)


def write_polynomials(module: Module, columns: int) -> None:
    """polynomials(series, values, slopes, rows, numbers, x): of so many columns, side by side."""
    wide = Module(max(WIDE, 4 * module.lanes))  # several columns, as each waits for its terms
    wide.functions = module.functions
    k = Kernel(wide, "polynomials", (*[ADDRESS] * 3, WHOLE, WHOLE, ADDRESS), "void")
    series, values, slopes, rows, numbers, place = k.arguments
    x = _repeated(k, place, module.lanes, k.lanes)
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
    sums = _write_sums(module, "sums", all_runs, len(loop.columns), -loop.first)
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
            k.line(f"call void @{name}({', '.join(map(str, (*rest, *levels)))})")
        words = segment.write([value for *_, value in grown])
        found = {(offset, i): word for (i, offset, _), word in zip(grown, words, strict=True)}
        if k.lanes == 1 and module.together:  # a vector is had at once only where it is stored so
            for offset, begin, wide in _read_together(all_runs, found):
                together = k.gathered([found.pop((offset, begin + i)) for i in range(wide)])
                k.store(together, k.at(rows[offset], begin))
        for (offset, column), word in found.items():
            k.store(word, k.at(rows[offset], column, k.numbers))
    if chooses:
        _longest(scene, k, block)
    if scene.rate_series or scene.link >= 0:
        _rates(scene, k, block)
    k.done()


def _read_together(
    runs: Sequence[Run], found: Mapping[tuple[int, int], Word]
) -> Iterator[tuple[int, int, int]]:
    """What is found and sums read as one vector: offset from p, first column, and how many."""
    taken: set[tuple[int, int]] = set()
    for run in (x for x in runs if x.strides == (1, 1)):
        for first, (begin, wide) in product((run.x, run.y), _pieces(run.wide)):
            columns = range(first + begin, first + begin + wide)
            for offset in sorted({offset for offset, _ in found}):
                places = {(offset, i) for i in columns}
                if wide > 1 and places <= found.keys() - taken:
                    taken |= places
                    yield offset, columns[0], wide


def _coefficients(graph: Graph, column: int, orders: range) -> list[Value]:
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
    zeros: list[Value] = [0.0] * scene.order
    last = range(scene.order, scene.order + 2)
    rho = [zeros + _coefficients(graph, i, last) for i in turns]
    theta = [zeros + _coefficients(graph, i + 1, last) for i in turns]
    w = [graph.variable(f"{i + 1}_1") for i in turns]
    slides = scene.mechanism.slides
    h = longest_formula(graph, Coefficients(rho, theta, [], []), w, True, slides)
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
    functions = _write_sums(k.module, "rates", [run], len(columns), 0)
    x, out = scene.row(k, block, 0), scene.at(k, block, "value")
    with k.loop(k.whole(orders)) as m:
        above = k.add(m, k.whole(1))
        level = k.negate(k.convert("sitofp", above, SCALAR))
        for function, _ in functions:
            rest = x, scene.row(k, block, m), out, m, level
            k.line(f"call void @{function}({', '.join(map(str, rest))})")
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
    k.line(f"call void @polynomials({', '.join(map(str, (*places, *rest)))})")
    turns = value_and_slope(graph, n)
    power: Value = 0.0
    if scene.loop.power:
        column = 2 * n + scene.loop.watched
        series = _coefficients(graph, column, range(scene.order + 1))
        power = integral(series, graph.variable("x"))
    steady = [graph.variable(f"u{j}") if x else 0.0 for j, x in enumerate(scene.loop.start.steady)]
    outputs = ends(scene.mechanism, turns, power, steady, scene.work, graph.variable)
    for name, word in zip(scene.state, read_segment(scene, k, block).write(outputs), strict=True):
        scene.put(k, block, f"to_{name}", word)
    k.done()
