"""Steps of the Taylor series in machine code whose order is a loop: for large mechanisms.

Besides its items a block has a matrix of coefficients, a row an order and a column a series, and
room for what is summed over it.  Columns that are summed alike stand side by side, so that one
call sums many, eight numbers at a time: of many columns or many lanes.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

from robodyn.engines.assembler import SCALAR, Kernel, Module, Word, scalar
from robodyn.engines.expansion import Coefficients, ends, integral, longest_formula, turning
from robodyn.engines.expression import Graph, Value
from robodyn.engines.machine_steps import Scene
from robodyn.engines.order_loop import LoopExpansion, Sum, loop_expansion
from robodyn.engines.segment import Segment

WIDE = 8  # numbers that a sum takes at a time
_WIDE = f"<{WIDE} x double>"


class _Run(NamedTuple):
    """Sums of columns x, x + stride, ... with y, y + stride, ...: where they begin and end."""

    sum: Sum
    x: int
    y: int
    wide: int  # columns
    place: int  # of its results, after what is left by the runs before it


class LoopScene(Scene):
    """A `Scene` whose code does not grow with the order."""

    short = True

    @cached_property
    def loop(self) -> LoopExpansion:
        """The formulas of a step; raises ZeroDivisionError where no state has a series."""
        return loop_expansion(self.motion, self.order)

    @property
    def _formulas(self) -> tuple[Graph, list[Value]]:
        return self.loop.start.recorded.graph, self.loop.outputs

    @cached_property
    def series(self) -> dict[str, Value]:
        """The items of rates, which an observer reads side by side."""
        names = [f"rate{j}" for j in range(self.mechanism.n) if self.rate_series]
        names += ["link0"] if self.link >= 0 else []
        return {f"{name}_{m}": 0.0 for name in names for m in range(self.order + 1)}

    # -- memory ------------------------------------------------------------------------------------

    @cached_property
    def _runs(self) -> tuple[list[_Run], dict[str, int], int]:
        """The sums as runs, where the result of each stands, and how much room they take."""
        column = {x.index: i for i, x in enumerate(self.loop.columns)}
        alike: dict[tuple[object, ...], dict[tuple[int, int], tuple[str, Sum]]] = {}
        for name, one in self.loop.sums:
            key = (*one[2:6], getattr(one.level, "index", one.level))
            pair = column[one.x.index], column[one.y.index]
            alike.setdefault(key, {})[pair] = name, one
        runs: list[_Run] = []
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
                runs.append(_Run(group[x, y][1], x, y, wide, room))
                room += wide + WIDE
                taken = set(members)
                left = [pair for pair in left if pair not in taken]
        return runs, places, room

    @cached_property
    def _memory(self) -> dict[str, int]:
        """Where the parts of the memory begin: rows of coefficients, sums, values, slopes."""
        width, turns = len(self.loop.columns), 2 * self.mechanism.n + WIDE
        rows = (self.order + 3) * width + WIDE
        sizes = {"rows": rows, "sums": self._runs[2] + WIDE, "value": turns, "slope": turns}
        places, place = {}, len(self.whole)
        for name, size in sizes.items():
            places[name] = place
            place += size
        return places | {"end": place}

    @property
    def items(self) -> int:
        """How many a block has."""
        return self._memory["end"]

    def _row(self, k: Kernel, block: Word, m: Word | int, column: int = 0) -> Word:
        """The address of coefficient m of a series."""
        width = len(self.loop.columns)
        if isinstance(m, int):
            return k.at(block, self._memory["rows"] + m * width + column, k.numbers)
        row = k.multiply(m, k.whole(width))
        return k.at(k.at(block, row, k.numbers), self._memory["rows"] + column, k.numbers)

    def _part(self, k: Kernel, block: Word, name: str, place: int) -> Word:
        return k.at(block, self._memory[name] + place, k.numbers)

    # -- code --------------------------------------------------------------------------------------

    def _expand(self, module: Module) -> None:
        write_sums(module, len(self.loop.columns))
        k, block = self.kernel(module, "expand")
        loop, graph = self.loop, self.loop.start.recorded.graph
        columns = {x.index: i for i, x in enumerate(loop.columns)}
        now: dict[str, Word] = {}  # of the order p

        def read(name: str) -> Word:
            if name in now:
                return now[name]
            if name in self._runs[1]:
                return k.load(self._part(k, block, "sums", self._runs[1][name]))
            column, earlier, offset = name.partition("@")
            if earlier:
                return k.load(k.at(rows[int(offset)], columns[int(column)], k.numbers))
            return self.get(k, block, name)

        segment = Segment(k, read, self.held_words(k, block, graph))
        known, grown = list(loop.known()), list(loop.grown())
        rows: dict[int, Word] = {}  # by the offset from p
        offsets = {m for _, m, _ in grown} | loop.offsets
        words = segment.write([value for *_, value in known])
        for (column, m, _), word in zip(known, words, strict=True):
            k.store(word, self._row(k, block, m, column))
        segment.write(loop.steady())
        with k.loop(k.whole(loop.last + 1), k.whole(loop.first)) as p:
            now["p"] = k.spread(k.convert("sitofp", p, SCALAR))
            rows = {m: self._row(k, block, k.add(p, k.whole(m))) for m in offsets}
            for run in self._runs[0]:
                one = run.sum
                x = self._row(k, block, one.first, run.x)
                y = self._row(k, block, k.add(p, k.whole(one.m - one.first)), run.y)
                terms = k.add(p, k.whole(one.last - one.first + 1))
                level = segment.write([one.level])[0]
                out = self._part(k, block, "sums", run.place)
                sum_rows(k, x, y, out, terms, run.wide, one.first, one.slope, level)
            words = segment.write([value for *_, value in grown])
            for (column, offset, _), word in zip(grown, words, strict=True):
                k.store(word, k.at(rows[offset], column, k.numbers))
        self._longest(k, block)
        if self.series:
            self._rates(k, block)
        k.done()

    def _series(self, graph: Graph, column: int, orders: range) -> list[Value]:
        """Coefficients as variables of another graph."""
        return [graph.variable(f"{column}_{m}") for m in orders]

    def _reader(self, k: Kernel, block: Word) -> Segment:
        """For graphs of `_series`, of items, and of what `polynomials` left."""

        def read(name: str) -> Word:
            column, is_series, m = name.partition("_")
            if is_series and column.isdecimal():
                return k.load(self._row(k, block, int(m), int(column)))
            part, is_part, place = name.partition(" ")
            if is_part:
                return k.load(self._part(k, block, part, int(place)))
            return self.get(k, block, name)

        return Segment(k, read, {})

    def _longest(self, k: Kernel, block: Word) -> None:
        graph, turns = Graph(), range(0, 2 * self.mechanism.n, 2)
        zeros: list[Value] = [0.0] * self.order
        last = range(self.order, self.order + 2)
        rho = [zeros + self._series(graph, i, last) for i in turns]
        theta = [zeros + self._series(graph, i + 1, last) for i in turns]
        w = [graph.variable(f"{i + 1}_1") for i in turns]
        h = longest_formula(graph, Coefficients(rho, theta, [], []), w, True)
        self.put(k, block, "longest", self._reader(k, block).write([h])[0])

    def _evaluate(self, module: Module) -> None:
        write_polynomials(module, len(self.loop.columns))
        k, block = self.kernel(module, "evaluate")
        n, graph = self.mechanism.n, Graph()
        x = self.get(k, block, "x")
        wide = k.room(SCALAR, WIDE)
        for i in range(0, WIDE, k.lanes):
            k.store(x, k.at(wide, i))
        out = [self._part(k, block, name, 0) for name in ("value", "slope")]
        rows, doubles = k.whole(self.order + 2), k.whole(2 * n * k.lanes)
        row = self._row(k, block, 0)
        k.line(f"call void @polynomials({row}, {out[0]}, {out[1]}, {rows}, {doubles}, {wide})")
        found = [
            [graph.variable(f"{name} {i}") for i in range(2 * n)] for name in ("value", "slope")
        ]
        turns = []
        for i in range(0, 2 * n, 2):
            z, slope = ((each[i], each[i + 1]) for each in found)
            turns.append((z, turning(z, slope)))
        power: Value = 0.0
        if self.loop.power:
            series = self._series(graph, 2 * n + self.loop.watched, range(self.order + 1))
            power = integral(series, graph.variable("x"))
        steady = [
            graph.variable(f"u{j}") if x else 0.0 for j, x in enumerate(self.loop.start.steady)
        ]
        outputs = ends(self.mechanism, turns, power, steady, self.work, graph)
        words = self._reader(k, block).write(outputs)
        for name, word in zip(self.state, words, strict=True):
            self.put(k, block, f"to_{name}", word)
        k.done()

    @property
    def _bending(self) -> tuple[Graph, list[Value]]:
        watched = range(2 * self.mechanism.n, 2 * self.mechanism.n + self.loop.watched)
        return self.loop.start.recorded.graph, [self.loop.columns[i].first[0] for i in watched]

    def _terms(self, k: Kernel, block: Word, i: int, x: Word) -> tuple[Word, Word]:
        total, most = k.slot(k.number(0.0)), k.slot(k.number(0.0))
        power = k.slot(k.number(1.0))
        with k.loop(k.whole(self.order)) as m:
            c = k.load(self._row(k, block, m, 2 * self.mechanism.n + i))
            term = k.multiply(c, k.get(power))
            size, largest = k.intrinsic("fabs", term), k.get(most)
            k.set(total, k.add(k.get(total), term))
            k.set(most, k.select(k.less(largest, size), size, largest))
            k.set(power, k.multiply(k.get(power), x))
        return k.get(total), k.get(most)

    def _rates(self, k: Kernel, block: Word) -> None:
        """The series of rates: sum of (2 j - m - 1) theta_j rho_{m+1-j} for each link."""
        n = self.mechanism.n
        names = {f"rate{j}": (j, above) for j, above in enumerate(self.mechanism.parent)}
        names = names if self.rate_series else {}
        names |= {"link0": (self.link, None)} if self.link >= 0 else {}
        x, out = self._row(k, block, 0, 1), self._part(k, block, "value", 0)
        with k.loop(k.whole(self.order + 1)) as m:
            above = k.add(m, k.whole(1))
            level = k.negate(k.spread(k.convert("sitofp", above, SCALAR)))
            terms = k.add(m, k.whole(2))
            sum_rows(k, x, self._row(k, block, above), out, terms, 2 * n - 1, 0, 2.0, level)
            for name, (j, below) in names.items():
                rate = k.load(k.at(out, 2 * j, k.numbers))
                if below is not None:
                    rate = k.subtract(rate, k.load(k.at(out, 2 * below, k.numbers)))
                k.store(rate, k.at(self.at(k, block, f"{name}_0"), m, k.numbers))


def sum_rows(
    k: Kernel,
    x: Word,
    y: Word,
    out: Word,
    terms: Word,
    wide: int,
    first: int,
    slope: float,
    level: Word,
) -> None:
    """Of so many columns: the sum of (slope j + level) x_j y_j from `first` on, y downward."""
    rest = f"{terms}, i64 {wide * k.lanes}"
    if slope:
        level = k.lane(k.add(level, k.number(slope * first)), 0)
        rest += f", {level}, double {scalar(slope)}"
    k.line(f"call void @{'weigh' if slope else 'convolve'}({x}, {y}, {out}, {rest})")


def write_sums(module: Module, width: int) -> None:
    """The functions that `sum_rows` calls, of rows of so many columns."""
    step = width * module.lanes
    for name in ("convolve", "weigh"):
        weighs = name == "weigh"
        weights = ", double %level, double %slope" * weighs
        weight = "  %w = phi double [ %level, %begin ], [ %w1, %term ]\n" * weighs
        weighed = (
            f"""  %first = insertelement {_WIDE} poison, double %w, i64 0
  %all = shufflevector {_WIDE} %first, {_WIDE} poison, <{WIDE} x i32> zeroinitializer
  %a = fmul {_WIDE} %a0, %all
  %w1 = fadd double %w, %slope
"""
            if weighs
            else ""
        )
        module.functions[name] = f"""\
define void @{name}(ptr %x, ptr %y, ptr %out, i64 %terms, i64 %wide{weights}) nounwind {{
entry:
  br label %columns
columns:
  %i = phi i64 [ 0, %entry ], [ %next, %done ]
  %more = icmp slt i64 %i, %wide
  br i1 %more, label %begin, label %end
begin:
  %xi = getelementptr double, ptr %x, i64 %i
  %yi = getelementptr double, ptr %y, i64 %i
  br label %sum
sum:
  %j = phi i64 [ 0, %begin ], [ %j1, %term ]
  %xj = phi ptr [ %xi, %begin ], [ %x1, %term ]
  %yj = phi ptr [ %yi, %begin ], [ %y1, %term ]
  %total = phi {_WIDE} [ zeroinitializer, %begin ], [ %t1, %term ]
{weight}  %again = icmp slt i64 %j, %terms
  br i1 %again, label %term, label %done
term:
  {"%a0" if weighs else "%a"} = load {_WIDE}, ptr %xj, align 8
  %b = load {_WIDE}, ptr %yj, align 8
{weighed}  %ab = fmul contract {_WIDE} %a, %b
  %t1 = fadd contract {_WIDE} %total, %ab
  %j1 = add i64 %j, 1
  %x1 = getelementptr double, ptr %xj, i64 {step}
  %y1 = getelementptr double, ptr %yj, i64 {-step}
  br label %sum
done:
  %o = getelementptr double, ptr %out, i64 %i
  store {_WIDE} %total, ptr %o, align 8
  %next = add i64 %i, {WIDE}
  br label %columns
end:
  ret void
}}"""


def write_polynomials(module: Module, width: int) -> None:
    """polynomials(series, values, slopes, rows, wide, x): of so many columns, side by side."""
    module.functions["polynomials"] = f"""\
define void @polynomials(ptr %c, ptr %v, ptr %s, i64 %rows, i64 %wide, ptr %xs) nounwind {{
entry:
  %x = load {_WIDE}, ptr %xs, align 8
  br label %columns
columns:
  %i = phi i64 [ 0, %entry ], [ %next, %done ]
  %more = icmp slt i64 %i, %wide
  br i1 %more, label %sum, label %end
sum:
  %m = phi i64 [ %rows, %columns ], [ %m1, %term ]
  %value = phi {_WIDE} [ zeroinitializer, %columns ], [ %v1, %term ]
  %slope = phi {_WIDE} [ zeroinitializer, %columns ], [ %s1, %term ]
  %again = icmp sgt i64 %m, 0
  br i1 %again, label %term, label %done
term:
  %m1 = sub i64 %m, 1
  %row = mul i64 %m1, {width * module.lanes}
  %place = add i64 %row, %i
  %at = getelementptr double, ptr %c, i64 %place
  %one = load {_WIDE}, ptr %at, align 8
  %sx = fmul contract {_WIDE} %slope, %x
  %s1 = fadd contract {_WIDE} %sx, %value
  %vx = fmul contract {_WIDE} %value, %x
  %v1 = fadd contract {_WIDE} %vx, %one
  br label %sum
done:
  %vo = getelementptr double, ptr %v, i64 %i
  store {_WIDE} %value, ptr %vo, align 8
  %so = getelementptr double, ptr %s, i64 %i
  store {_WIDE} %slope, ptr %so, align 8
  %next = add i64 %i, {WIDE}
  br label %columns
end:
  ret void
}}"""
