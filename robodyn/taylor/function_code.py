"""Machine code that has a linear function of the state as a polynomial, and bounds of its slope.

About the middle of a piece of a step, whose half is H, a direction is z(s) = sum z_m s^m, s from -1
to 1, of degree p + 1.  Its two products are polynomials as well, of twice that degree, and exact:

    conj(z) dz/ds = ... + i N,   N = sum n_m s^(m-1),   n_m = sum_j (2j - m) theta_j rho_{m-j},
    |z|^2 = 1 + E,               E = sum e_m s^m.

The angle of z has the slope v = H w = N / (1 + E), for which, with E0 = sum |e_m|, E1 = sum m |e_m|
and N0 = sum |n_m|, N1 = sum (m - 1) |n_m|,

    |v - n_1|      <=  N0 - |n_1| + N0 E0 / (1 - E0),
    |dv/ds - n_2|  <=  N1 - |n_2| + N1 E0 / (1 - E0) + N0 E1 / (1 - E0)^2.

E is what a series leaves out, and small; a displacement is a polynomial itself.  So the slope of a
function is told to stay near that in the middle, and the function is, but for E, the polynomial of
the n_m, from which a search for its zero begins.  Of the products the orders of z are computed, and
those beyond are bounded by sums of sizes (`_tail`), which all four sums have added.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, reduce
from typing import TYPE_CHECKING

import numpy as np

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.machine_sums import WIDE, alike
from robodyn.events.rounding import EPS
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene

SUMS = ("n0", "n1", "e0", "e1", "noise")  # of a coordinate; noise is what rounding adds to N0


def terms(order: int) -> int:
    """How many a polynomial of a series has, in whole vectors."""
    return order + 2 + -(order + 2) % WIDE


@lru_cache
def binomials(order: int) -> Array:
    """Pascal's triangle, a row for each order of a series."""
    rows = np.zeros((order + 2, terms(order)))
    rows[:, 0] = 1.0
    for k in range(1, order + 2):
        rows[k, 1 : k + 1] = rows[k - 1, :k] + rows[k - 1, 1 : k + 1]
    return rows


def write_function(scene: Scene, module: Module) -> None:
    """event_along(block, form, x, half, binomials, rows, slope): a function about x in a step.

    `rows` gets the coefficients of the orders from 1 on in s = (t - x) / half, `slope` its slope by
    s in the middle, and how far it goes from there at most.
    """
    wide = Module(WIDE)
    wide.functions = module.functions
    n, count, room = scene.mechanism.n, scene.order + 2, terms(scene.order)
    kinds = list(alike(scene.mechanism.slides, n))
    for slides in sorted({slides for slides, _ in kinds}):
        _Turn(scene, wide, slides).write()
    k = Kernel(wide, "event_along", (ADDRESS, ADDRESS, SCALAR, SCALAR, *[ADDRESS] * 3), "void")
    block, form, x, half, table, rows, slope = k.arguments
    first, width = k.at(block, scene.whole["rows"]), k.whole(len(scene.loop.columns))
    found, sums = k.room(SCALAR, room + WIDE), k.room(SCALAR, len(SUMS))
    zero, one, reach = k.scalar(0.0), k.scalar(1.0), k.at(slope, 1)
    by_time = k.multiply(k.load(k.at(form, 1), SCALAR), half)
    for i in range(0, room, WIDE):
        k.store(k.number(0.0), k.at(rows, i))
    for word, place in ((by_time, slope), (by_time, k.at(rows, 1)), (zero, reach)):
        k.store(word, place)
    for slides, joints in kinds:
        with k.loop(k.whole(joints[-1] + 1), k.whole(joints[0])) as j:
            by, by_rate = (k.load(k.at(k.at(form, 2 + i * n), j), SCALAR) for i in (2, 3))
            used = (k.compare("une", weight, zero) for weight in (by, by_rate))
            with k.when(k.either(*used)):
                given = k.at(first, k.add(j, j)), width, x, half, table, found, sums
                k.line(f"call void @{_Turn.name(slides)}({', '.join(map(str, given))})")
                by_rate = k.divide(by_rate, half)
                n0, n1, e0, e1, noise = (k.load(k.at(sums, i), SCALAR) for i in range(len(SUMS)))
                value, change = (k.load(k.at(found, i), SCALAR) for i in (1, 2))
                left = k.subtract(one, e0)
                left = k.select(k.less(zero, left), left, zero)
                part = k.divide(e0, left)
                off = k.subtract(n0, k.intrinsic("fabs", value))
                off = k.add(k.add(off, noise), k.multiply(n0, part))
                bend = k.subtract(n1, k.intrinsic("fabs", change))
                bend = k.add(bend, k.multiply(noise, k.scalar(2.0 * count)))
                bend = k.add(bend, k.multiply(n1, part))
                bend = k.add(bend, k.divide(k.multiply(n0, e1), k.multiply(left, left)))
                for place, weight, other in ((slope, (value, change), 0), (reach, (off, bend), 1)):
                    factors = (k.intrinsic("fabs", w) if other else w for w in (by, by_rate))
                    more = (k.multiply(*pair) for pair in zip(factors, weight, strict=True))
                    k.store(k.add(k.load(place, SCALAR), k.add(*more)), place)
                for i in range(0, room, WIDE):
                    parts = _lanes(k, [1.0 / max(m, 1) for m in range(i, i + WIDE)])
                    own = k.multiply(k.multiply(k.load(k.at(found, i)), parts), k.spread(by))
                    rates = k.multiply(k.load(k.at(found, i + 1)), k.spread(by_rate))
                    place = k.at(rows, i)
                    k.store(k.add(k.load(place), k.add(own, rates)), place)
    k.done()


def _lanes(k: Kernel, values: Sequence[float]) -> Word:
    return Word(f"<{', '.join(str(k.scalar(value)) for value in values)}>", k.numbers)


class _Turn:
    """Writes turn(first, width, x, half, binomials, products, sums): a coordinate about x.

    `first` is its pair of the order 0; `products` gets the n_m, `sums` what SUMS names.
    """

    def __init__(self, scene: Scene, module: Module, slides: bool) -> None:
        self.slides, self.count, self.room = slides, scene.order + 2, terms(scene.order)
        types = ADDRESS, WHOLE, SCALAR, SCALAR, *[ADDRESS] * 3
        self.k = k = Kernel(module, self.name(slides), types, "void")
        self.zero, self.begins = k.number(0.0), range(0, self.room, WIDE)

    @staticmethod
    def name(slides: bool) -> str:
        return "event_slide" if slides else "event_turn"

    def orders(self, begin: int, less: float = 0.0) -> Word:
        """The orders from one on, in the lanes."""
        return _lanes(self.k, [begin + i - less for i in range(WIDE)])

    def write(self) -> None:
        k = self.k
        *_, found, sums = k.arguments
        series, size = self._about(*k.arguments[:5])
        k.store(self.zero, k.at(found, self.room))
        noise = size if self.slides else k.multiply(size, size)
        noise = k.multiply(noise, k.scalar(16.0 * EPS * self.count**2))
        if self.slides:
            (theta,) = series
            values = [
                k.multiply(self.orders(i), z) for i, z in zip(self.begins, theta, strict=True)
            ]
            words = [*self._sizes(values, 1.0), k.scalar(0.0), k.scalar(0.0)]
        else:
            values, squares = self._multiplied(*series)
            words = [*self._sizes(values, 1.0), *self._sizes(squares, 0.0)]
            tail, most = self._tail(*series), float(self.count)
            for i, factor in enumerate((most, 2.0 * most**2, 1.0, 2.0 * most)):
                words[i] = k.add(words[i], k.multiply(tail, k.scalar(factor)))
            for i, factor in ((2, 1.0), (3, 2.0 * most)):
                words[i] = k.add(words[i], k.multiply(noise, k.scalar(factor)))
        for i, value in zip(self.begins, values, strict=True):
            k.store(value, k.at(found, i))
        for i, word in enumerate((*words, noise)):
            k.store(word, k.at(sums, i))
        k.done()

    def _about(
        self, first: Word, width: Word, x: Word, half: Word, table: Word
    ) -> tuple[list[list[Word]], Word]:
        """The series about x, times powers of half, and the sum of sizes at the piece's end.

        They are sums of z_k x^k by binomials.
        """
        k = self.k
        far = k.add(k.intrinsic("fabs", x), k.intrinsic("fabs", half))
        with k.loop(k.whole(self.count)) as m:
            row, power, reach, size = map(k.carried, (first, *map(k.scalar, (1.0, 1.0, 0.0))))
            k.becomes(row, k.at(row, width))
            k.becomes(power, k.multiply(power, x))
            k.becomes(reach, k.multiply(reach, far))
            place = k.at(table, k.multiply(m, k.whole(self.room)))
            weights = [k.load(k.at(place, i)) for i in self.begins]
            sizes, series = size, []
            for i in (1,) if self.slides else (0, 1):
                z = k.load(k.at(row, i), SCALAR)
                sizes = k.add(sizes, k.multiply(k.intrinsic("fabs", z), reach))
                term = k.spread(k.multiply(z, power))
                series.append([k.carried(self.zero) for _ in self.begins])
                for total, weight in zip(series[-1], weights, strict=True):
                    k.becomes(total, k.add(total, k.multiply(weight, term)))
            k.becomes(size, sizes)
        powers = [k.scalar(1.0), k.divide(half, x)]
        for i in range(2, WIDE + 1):
            powers.append(k.multiply(powers[i // 2], powers[i - i // 2]))
        scale, step = k.gathered(powers[:WIDE]), k.spread(powers[WIDE])
        for i in range(len(self.begins)):
            for part in series:
                part[i] = k.multiply(part[i], scale)
            scale = k.multiply(scale, step)
        return series, size

    def _multiplied(self, *series: list[Word]) -> tuple[list[Word], list[Word]]:
        """n_m and e_m of a direction, but for those beyond the room."""
        k = self.k
        rho, theta = (k.room(SCALAR, 2 * self.room) for _ in series)
        for place, part in zip((rho, theta), series, strict=True):
            for i, word in zip(self.begins, part, strict=True):
                k.store(self.zero, k.at(place, i))
                k.store(word, k.at(place, self.room + i))
        minus = _lanes(k, [-1.0, *[0.0] * (WIDE - 1)])
        with k.loop(k.whole(self.count)) as j:
            values, both = ([k.carried(self.zero) for _ in self.begins] for _ in range(2))
            squares = [k.carried(self.zero if i else minus) for i in self.begins]
            at = k.add(j, k.whole(self.room))
            a, b = (k.spread(k.load(k.at(part, at), SCALAR)) for part in (rho, theta))
            twice = k.multiply(b, k.spread(k.convert("sitofp", k.add(j, j), SCALAR)))
            begin = k.subtract(k.whole(self.room), j)
            for i, value, one, square in zip(self.begins, values, both, squares, strict=True):
                c, d = (k.load(k.at(k.at(part, begin), i)) for part in (rho, theta))
                k.becomes(value, k.add(value, k.multiply(twice, c)))
                k.becomes(one, k.add(one, k.multiply(b, c)))
                k.becomes(square, k.add(square, k.add(k.multiply(a, c), k.multiply(b, d))))
        orders = (k.multiply(self.orders(i), one) for i, one in zip(self.begins, both, strict=True))
        return [k.subtract(*pair) for pair in zip(values, orders, strict=True)], squares

    def _tail(self, rho: list[Word], theta: list[Word]) -> Word:
        """Sizes of the products of so high orders that there is no room for them."""
        k, sizes = self.k, list[Word]()
        for pair in zip(rho, theta, strict=True):
            sizes.append(k.add(*(k.intrinsic("fabs", each) for each in pair)))
        high = sizes[len(sizes) // 2 :]  # one of two is among these, and the other not the lowest
        least = self.room - self.count + 1
        sizes[0] = k.multiply(sizes[0], _lanes(k, [float(i >= least) for i in range(WIDE)]))
        return k.multiply(k.scalar(2.0), k.multiply(self._total(high), self._total(sizes)))

    def _sizes(self, values: Sequence[Word], less: float) -> list[Word]:
        """The sum of the sizes, and of those times m - less."""
        k = self.k
        sizes = [k.intrinsic("fabs", value) for value in values]
        orders = (self.orders(i, less) for i in self.begins)
        weighted = [k.multiply(*pair) for pair in zip(orders, sizes, strict=True)]
        return [self._total(sizes), self._total(weighted)]

    def _total(self, vectors: Sequence[Word]) -> Word:
        k, total = self.k, reduce(self.k.add, vectors)
        lanes = [k.lane(total, i) for i in range(WIDE)]
        while len(lanes) > 1:
            lanes = [k.add(*pair) for pair in zip(lanes[::2], lanes[1::2], strict=True)]
        return lanes[0]
