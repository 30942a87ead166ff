"""Machine code that bounds the slope of a linear function of the state, and has its polynomial.

Along a piece of a step, of length H, a direction is z(s) = sum z_m s^m, of degree P = p + 1: s goes
from 0 to 1, and H is the whole step; or from -1 to 1 about the piece's middle, and H is its half.
Its product with its slope is a polynomial as well, and z has the size 1 but for what a series
leaves out:

    conj(z) dz/ds = ... + i N,   N = sum n_m s^(m-1),   n_m = sum_j (2j - m) theta_j rho_{m-j},
    |z|^2 = 1 + E,               E = sum e_m s^m,       e_m = 0 up to m = P, but for rounding.

The angle of z has the slope v = H w = N / (1 + E), for which, with E0 = sum |e_m|, E1 = sum m |e_m|
and N0 = sum |n_m|, N1 = sum (m - 1) |n_m|,

    |v - n_1|      <=  N0 - |n_1| + N0 E0 / (1 - E0),
    |dv/ds - n_2|  <=  N1 - |n_2| + N1 E0 / (1 - E0) + N0 E1 / (1 - E0)^2.

A displacement is a polynomial itself.  So the slope of a function is told to stay near a value, and
the function is, but for E, the polynomial of the n_m, from which a search for its zero begins.  The
n_m of the first orders are computed, to m = 2J - 1.  In a later order one of two factors is among
those from J on, in E among those from K = (P + 1) / 2 on: with u_j = |rho_j| + |theta_j|,
U = sum u_j and Hi(J) = sum_{j>=J} j^i u_j the sums over these orders are

    sum |n_m| <= H1(J) U,   sum (m - 1) |n_m| <= H2(J) U,   E0 <= 2 H0(K) U,   E1 <= 4 H1(K) U.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache, reduce
from typing import TYPE_CHECKING

import numpy as np

from robodyn.engines.assembler import ADDRESS, SCALAR, Kernel, Module, Word
from robodyn.engines.machine_sums import WIDE
from robodyn.events.rounding import EPS
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene

SUMS = ("first", "second", "off", "bend")  # n_1 and n_2 of a coordinate, how far v, dv/ds go
COMPUTED = 2  # vectors of n_m


def terms(order: int) -> int:
    """How many a polynomial of a series has, in whole vectors."""
    return order + 2 + -(order + 2) % WIDE


def computed(order: int) -> int:
    """How many of the n_m are computed, 2J."""
    return min(terms(order), WIDE * COMPUTED)


@lru_cache
def binomials(order: int) -> Array:
    """Pascal's triangle, a row for each order of a series."""
    rows = np.zeros((order + 2, terms(order)))
    rows[:, 0] = 1.0
    for k in range(1, order + 2):
        rows[k, 1 : k + 1] = rows[k - 1, :k] + rows[k - 1, 1 : k + 1]
    return rows


class CoordinateCode:
    """Writes what bounds the slope of a coordinate, which turns or `slides`.

    NAME_begin(series, h, found, sums) from the step's start to h after it, and
    NAME_about(series, x, half, binomials, found, sums) of the piece about x; `series` is its pair
    of the order 0, `found` gets the n_m.
    """

    def __init__(self, scene: Scene, module: Module, slides: bool) -> None:
        self.module, self.slides, self.count = module, slides, scene.order + 2
        self.room, self.width = terms(scene.order), len(scene.loop.columns)
        self.begins = range(0, self.room, WIDE)
        self.first = self.begins[: computed(scene.order) // WIDE]  # of the n_m
        self.later = computed(scene.order) // 2, (self.count + 1) // 2  # J and K

    @staticmethod
    def name(slides: bool) -> str:
        return "event_slide" if slides else "event_turn"

    def write(self) -> None:
        name, parts = self.name(self.slides), (1,) if self.slides else (0, 1)
        k = Kernel(self.module, f"{name}_begin", (ADDRESS, SCALAR, ADDRESS, ADDRESS), "void")
        series, h, found, sums = k.arguments
        self._bound(k, *self._begin(k, parts, series, h), found, sums)
        types = ADDRESS, SCALAR, SCALAR, ADDRESS, ADDRESS, ADDRESS
        k = Kernel(self.module, f"{name}_about", types, "void")
        *given, found, sums = k.arguments
        self._bound(k, *self._about(k, parts, *given), found, sums)
        if not self.slides:
            self._write_products()

    def _begin(
        self, k: Kernel, parts: Sequence[int], series: Word, h: Word
    ) -> tuple[list[list[Word]], tuple[Word, ...]]:
        """The series times powers of h, and U, H0(K) U, H1(K) U."""

        def vector(part: int, begin: int) -> Word:
            rows = range(begin, min(begin + WIDE, self.count))
            words = [k.load(k.at(series, m * self.width + part), SCALAR) for m in rows]
            return k.gathered([*words, *[k.scalar(0.0)] * (WIDE - len(words))])

        found = [[vector(part, begin) for begin in self.begins] for part in parts]
        self._scale(k, found, h)
        sizes = self._sizes(k, found)
        size = self._total(k, sizes)
        late = (self._late(k, sizes, power, self.later[1]) for power in (0, 1))
        return found, (size, *(k.multiply(each, size) for each in late))

    def _scale(self, k: Kernel, series: Sequence[list[Word]], by: Word) -> None:
        """Times powers of a number."""
        powers = [k.scalar(1.0), by]
        for i in range(2, WIDE + 1):
            powers.append(k.multiply(powers[i // 2], powers[i - i // 2]))
        scale, step = k.gathered(powers[:WIDE]), k.spread(powers[WIDE])
        for i in range(len(self.begins)):
            for part in series:
                part[i] = k.multiply(part[i], scale)
            scale = k.multiply(scale, step)

    def _about(
        self, k: Kernel, parts: Sequence[int], series: Word, x: Word, half: Word, table: Word
    ) -> tuple[list[list[Word]], tuple[Word, ...]]:
        """The series about x, times powers of half: sums of z_k x^k by binomials.

        U, H0(K) U are those from the step's start to the piece's end, which are no less, and
        H1(K) U is the part of that which E may change by along the piece.
        """
        far, zero = k.add(k.intrinsic("fabs", x), k.intrinsic("fabs", half)), k.number(0.0)
        with k.loop(k.whole(self.count)) as m:
            row, power, reach = map(k.carried, (series, *map(k.scalar, (1.0, 1.0))))
            sums = [k.carried(k.scalar(0.0)) for _ in range(3)]
            k.becomes(row, k.at(row, self.width))
            k.becomes(power, k.multiply(power, x))
            k.becomes(reach, k.multiply(reach, far))
            place = k.at(table, k.multiply(m, k.whole(self.room)))
            weights = [k.load(k.at(place, i)) for i in self.begins]
            size, found = k.scalar(0.0), []
            for i in parts:
                z = k.load(k.at(row, i), SCALAR)
                size = k.add(size, k.multiply(k.intrinsic("fabs", z), reach))
                term = k.spread(k.multiply(z, power))
                found.append([k.carried(zero) for _ in self.begins])
                for total, weight in zip(found[-1], weights, strict=True):
                    k.becomes(total, k.add(total, k.multiply(weight, term)))
            late = k.compare("sge", m, k.whole(self.later[1]))
            late = k.select(late, size, k.scalar(0.0))
            more = size, late, k.multiply(late, k.convert("sitofp", m, SCALAR))
            for total, each in zip(sums, more, strict=True):
                k.becomes(total, k.add(total, each))
        self._scale(k, found, k.divide(half, x))
        size, late, steep = sums
        steep = k.multiply(steep, k.divide(k.intrinsic("fabs", half), far))
        return found, (size, *(k.multiply(each, size) for each in (late, steep)))

    def _bound(
        self,
        k: Kernel,
        series: list[list[Word]],
        sizes: tuple[Word, ...],
        found: Word,
        sums: Word,
    ) -> None:
        """The n_m, and what SUMS names."""
        k.store(k.number(0.0), k.at(found, self.first[-1] + WIDE))
        if self.slides:
            values = [
                k.multiply(self._orders(k, 1.0, i), z)
                for i, z in zip(self.begins, *series, strict=True)
            ]
            tails = k.scalar(0.0), k.scalar(0.0)
            self._tell(k, values, tails, self._noise(k, sizes[0]), found, sums)
        else:
            room = k.room(SCALAR, WIDE + 3 * self.room)  # nothing, rho, theta, and 2 j theta_j
            k.store(k.number(0.0), room)
            twice = (
                k.multiply(self._orders(k, 2.0, i), z)
                for i, z in zip(self.begins, series[1], strict=True)
            )
            for first, part in enumerate((*series, twice)):
                for i, word in zip(self.begins, part, strict=True):
                    k.store(word, k.at(room, WIDE + first * self.room + i))
            k.call("event_products", room, *sizes, found, sums)
        k.done()

    def _write_products(self) -> None:
        """event_products(series, U, H0(K) U, H1(K) U, found, sums): of rho and theta."""
        types = ADDRESS, SCALAR, SCALAR, SCALAR, ADDRESS, ADDRESS
        k = Kernel(self.module, "event_products", types, "void")
        place, size, *late, found, sums = k.arguments
        rho, theta, twice = (k.at(place, WIDE + i * self.room) for i in range(3))
        sizes = self._sizes(k, [[k.load(k.at(x, i)) for i in self.begins] for x in (rho, theta)])
        late_sums = (self._late(k, sizes, power, self.later[0]) for power in (1, 2))
        tails = [k.multiply(each, size) for each in late_sums]
        values = []
        for begin in self.first:
            totals = [[k.number(0.0)] * 2 for _ in range(2)]
            for j in range(begin + WIDE):
                c = k.load(k.at(rho, begin - j))
                for total, part in zip(totals, (twice, theta), strict=True):
                    factor = k.spread(k.load(k.at(part, j), SCALAR))
                    total[j % 2] = k.add(total[j % 2], k.multiply(factor, c))
            value, both = (k.add(*total) for total in totals)
            values.append(k.subtract(value, k.multiply(self._orders(k, 1.0, begin), both)))
        noise = k.multiply(size, self._noise(k, size))
        self._tell(k, values, tails, noise, found, sums, late)
        k.done()

    def _tell(
        self,
        k: Kernel,
        values: list[Word],
        tails: Sequence[Word],
        noise: Word,
        found: Word,
        sums: Word,
        late: Sequence[Word] = (),
    ) -> None:
        """Bounds by the n_m, by the `tails` of others, and by E's, from `late`."""
        one, most = k.scalar(1.0), k.scalar(float(self.count))
        for i, value in zip(self.first, values, strict=False):
            k.store(value, k.at(found, i))
        sizes = [k.intrinsic("fabs", value) for value in values]
        later, change = [], []
        for i, each in zip(self.begins, sizes, strict=False):
            orders = range(i, i + WIDE)
            later.append(k.multiply(each, k.vector([float(m > 1) for m in orders])))
            change.append(k.multiply(each, k.vector([(m - 1.0) * (m > 2) for m in orders])))
        first, second = (k.lane(values[0], i) for i in (1, 2))
        off = k.add(k.add(self._total(k, later), tails[0]), noise)
        bend = k.add(k.add(self._total(k, change), tails[1]), k.multiply(most, noise))
        if late:
            n0, n1 = (k.add(k.intrinsic("fabs", x), y) for x, y in ((first, off), (second, bend)))
            e0 = k.add(k.add(late[0], late[0]), noise)
            e1 = k.add(k.multiply(k.scalar(4.0), late[1]), k.multiply(most, noise))
            small = k.compare("ole", e0, k.scalar(0.5))  # so that 1 / (1 - E0) <= 1 + 2 E0
            grows = k.select(small, k.add(one, k.add(e0, e0)), k.scalar(math.inf))
            part = k.multiply(e0, grows)
            off = k.add(off, k.multiply(n0, part))
            bend = k.add(bend, k.multiply(n1, part))
            bend = k.add(bend, k.multiply(k.multiply(n0, e1), k.multiply(grows, grows)))
        for i, word in enumerate((first, second, off, bend)):
            k.store(word, k.at(sums, i))

    def _noise(self, k: Kernel, size: Word) -> Word:
        """What rounding adds to sums of products of sizes, by one of them."""
        return k.multiply(size, k.scalar(16.0 * EPS * self.count**2))

    def _orders(self, k: Kernel, times: float, begin: int) -> Word:
        return k.vector([times * (begin + i) for i in range(WIDE)])

    def _sizes(self, k: Kernel, series: Sequence[Sequence[Word]]) -> list[Word]:
        """|rho| + |theta|, or |s|, of each order."""
        parts = [[k.intrinsic("fabs", word) for word in part] for part in series]
        return [reduce(k.add, each) for each in zip(*parts, strict=True)]

    def _late(self, k: Kernel, sizes: Sequence[Word], power: int, least: int) -> Word:
        """Those from an order on, times a power of it."""
        parts = []
        for i, size in zip(self.begins, sizes, strict=True):
            weights = [float(m**power * (m >= least)) for m in range(i, i + WIDE)]
            if any(weights):
                parts.append(k.multiply(size, k.vector(weights)))
        return self._total(k, parts)

    def _total(self, k: Kernel, vectors: Sequence[Word]) -> Word:
        total, wide = reduce(k.add, vectors), WIDE
        while wide > 1:
            wide //= 2
            halves = range(wide), range(wide, 2 * wide)
            total = k.add(*(k.shuffled(total, half) for half in halves))
        return k.op(SCALAR, f"extractelement {total}, i64 0")
