"""Sums of products of coefficients in machine code: of many columns side by side.

Columns that are summed alike stand side by side, so that a vector of eight numbers sums many: of
columns or of lanes.  One loop runs over the terms of several vectors: none of them waits for its
last term then.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import groupby, product
from typing import NamedTuple

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.expression import Value
from robodyn.engines.order_loop import LoopExpansion, Sum

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


def alike(slides: Collection[int], n: int) -> Iterator[tuple[bool, Sequence[int]]]:
    """The joints one after the other, those together that slide, or do not."""
    for slide, joints in groupby(range(n), lambda j: j in slides):
        yield slide, list(joints)


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


class _Batch:
    """name(x, y, out, p, levels): sums of (slope j + level) x_j y_j to their places in `out`.

    The rows of x go up from order 0, those of y down from order p; a level for each weight.  What
    the order before has found stands in the first term and the last: they come last, so that the
    processor adds up the others while it is found.
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
        """Each vector by a function that serves them all."""
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
        """All in one loop, and what has more terms behind it; where they may be `fewest`, none."""
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
        """Add one to the totals."""
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
        """The rows and levels of the next term."""
        k = self.k
        slopes = (k.scalar(slope) for slope, _ in self.weights)
        new = [k.add(level, slope) for level, slope in zip(levels, slopes, strict=True)]
        return (k.at(rows[0], self.step), k.at(rows[1], -self.step)), new


def write_sums(
    module: Module, name: str, runs: Sequence[Run], columns: int, least: int
) -> list[tuple[str, list[Weight]]]:
    """The functions that sum all of these runs, and the weights of each."""
    vectors = [vector for run in runs for vector in _vectors(run, module, columns)]
    found = []
    for i, batch in enumerate(_batches(vectors, least, module.together or len(vectors))):
        weights = list(dict.fromkeys(v.weight for v in batch if v.weight is not None))
        written = _Batch(module, f"{name}{i}", batch, weights)
        if module.together:
            written.write(columns, least)
        else:
            written.call()
        found.append((f"{name}{i}", weights))
    return found


def repeated(k: Kernel, place: Word, lanes: int, wide: int) -> Word:
    """So many numbers, again and again."""
    if wide == 1:
        return k.load(place, SCALAR)
    return k.shuffled(k.load(place, f"<{lanes} x double>"), [i % lanes for i in range(wide)])


def read_together(
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


def _zeros(wide: int) -> Word:
    """So many zeros."""
    zero = "0x0000000000000000"
    return Word("zeroinitializer", f"<{wide} x double>") if wide > 1 else Word(zero, SCALAR)
