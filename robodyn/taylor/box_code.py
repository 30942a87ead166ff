"""Machine code of what `step_boxes.py` derives: boxes of steps, and bounds of slopes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.machine_sums import alike, over
from robodyn.events.signs import MISSED
from robodyn.taylor.step_boxes import SLACK

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene

SUMS = 4  # that grow side by side
COLUMNS = 32  # of a series that one function serves: code of wider vectors takes long to make


def _begins(count: int) -> list[int]:
    """Where pieces of so many columns begin; the last may have some of the one before it."""
    return [*range(0, count - COLUMNS, COLUMNS), max(count - COLUMNS, 0)]


def _strays(
    scene: Scene, k: Kernel, first: Word, width: Word, h: Word, out: Word, *strays: Word
) -> None:
    """Of a series' rows from the order 1 on, side by side: see `_write_strays`."""
    for begin in _begins(2 * scene.mechanism.n):
        name = _write_strays(scene, k.module, begin, bool(strays))
        row, *rest = (k.at(base, begin) for base in (first, out, *strays))
        k.line(f"call void @{name}({', '.join(map(str, (row, width, h, *rest)))})")


def _write_strays(scene: Scene, module: Module, begin: int, twice: bool) -> str:
    """strays(first, width, h, out): of a piece of a series' rows.

    D_m = (m + 1) z_{m+1} - i w0 z_m of each order m > 0 into rows of `out`, and before them the
    sums of |D_m| h^m.  `twice`, of the D_m, which are given besides: the sums of
    |(m + 1) D_{m+1} - i w0 D_m - i a0 z_m| h^m alone.
    """
    all_columns = 2 * scene.mechanism.n
    count = min(COLUMNS, all_columns)
    ways = [j in scene.mechanism.slides for j in range(begin // 2, (begin + count) // 2)]
    name = f"strays{1 + twice}_{''.join('ts'[slides] for slides in ways)}"
    if name in module.functions:
        return name
    wide = Module(count)
    wide.functions = module.functions
    types = ADDRESS, WHOLE, SCALAR, *(ADDRESS,) * (2 if twice else 1)
    k = Kernel(wide, name, types, "void")
    first, width, h, out, *strays = k.arguments
    step = k.spread(h)
    # less i times what turns: theta and -rho
    turns = (0.0 if ways[i // 2] else 1.0 - 2.0 * (i % 2) for i in range(count))
    factors = Word(f"<{', '.join(str(k.scalar(turn)) for turn in turns)}>", k.numbers)

    def moved(row: Word, places: Iterable[int]) -> Word:
        other = ", ".join(f"i32 {i}" for i in places)
        text = f"shufflevector {row}, {k.numbers} poison, <{count} x i32> <{other}>"
        return k.op(k.numbers, text)

    def turned(row: Word) -> Word:
        return moved(row, (i ^ 1 for i in range(count)))

    def rates(row: Word) -> Word:
        return k.multiply(factors, moved(row, (i | 1 for i in range(count))))

    last = scene.order + 1
    powers, sums = [k.number(1.0), step], [k.number(0.0)] * SUMS
    row, z = first, k.load(first)
    own = k.load(strays[0]) if twice else z
    w, v = rates(z), rates(own)
    for m in range(1, last + 1):  # one after the other in text: a loop would wait for its sums
        if m > 1:
            powers.append(k.multiply(powers[m // 2], powers[m - m // 2]))
        found = k.multiply(w, turned(own))
        if twice:
            found = k.add(found, k.multiply(v, turned(z)))
        if m < last:
            row = k.at(row, width)
            z = k.load(row)
            own = k.load(k.at(strays[0], m * all_columns)) if twice else z
            found = k.add(found, k.multiply(k.number(m + 1.0), own))
        if not twice:
            k.store(found, k.at(out, m * all_columns))
        size = k.multiply(k.intrinsic("fabs", found), powers[m])
        sums[m % SUMS] = k.add(sums[m % SUMS], size)
    while len(sums) > 1:
        sums = [k.add(*pair) for pair in zip(sums[::2], sums[1::2], strict=True)]
    k.store(sums[0], out)
    k.done()
    return name


def shift(scene: Scene, k: Kernel, first: Word, width: Word, x: Word, rows: Word) -> None:
    """Into rows what a series of all coordinates is from x on."""
    for begin in _begins(2 * scene.mechanism.n):
        row, to = k.at(first, begin), k.at(rows, begin)
        k.line(f"call void @series_shift({row}, {width}, {x}, {to})")


def write_shift(scene: Scene, module: Module) -> None:
    """series_shift(first, width, x, rows): the same of a piece of the columns."""
    count = 2 * scene.mechanism.n
    wide = Module(min(COLUMNS, count))
    wide.functions = module.functions
    k = Kernel(wide, "series_shift", (ADDRESS, WHOLE, SCALAR, ADDRESS), "void")
    first, width, x, rows = k.arguments
    step, last = k.spread(x), k.whole(scene.order + 1)
    with k.loop(k.whole(scene.order + 2)) as m:
        row = k.load(k.at(first, k.multiply(m, width)))
        k.store(row, k.at(rows, k.multiply(m, k.whole(count))))
    top = k.load(k.at(rows, k.multiply(last, k.whole(count))))
    with k.loop(last) as i, k.loop(k.subtract(last, i)) as m:
        later = k.carried(top)
        place = k.subtract(k.subtract(last, m), k.whole(1))
        place = k.at(rows, k.multiply(place, k.whole(count)))
        new = k.add(k.load(place), k.multiply(step, later))
        k.store(new, place)
        k.becomes(later, new)
    k.done()


def _pair(k: Kernel, row: Word, j: Word) -> tuple[Word, Word]:
    place = k.at(row, k.add(j, j))
    return k.load(place), k.load(k.at(place, 1))


def _size(k: Kernel, *parts: Word) -> Word:
    return k.add(*(k.intrinsic("fabs", part) for part in parts))


def write_on(scene: Scene, module: Module) -> None:
    """event_on(block, x, rows): the series as it is from x on, turned back to how it begins."""
    k = Kernel(module, "event_on", (ADDRESS, SCALAR, ADDRESS), "void")
    block, x, rows = k.arguments
    count = 2 * scene.mechanism.n
    first, width = scene.row(k, block, 0), k.whole(len(scene.loop.columns))
    shift(scene, k, first, width, x, rows)

    def turn(j: Word, _: Sequence[Word]) -> Sequence[Word]:
        begin = k.add(j, j)
        rho, theta = _pair(k, rows, j)
        square = k.add(k.multiply(rho, rho), k.multiply(theta, theta))
        c, s = k.divide(rho, square), k.divide(theta, square)
        with k.loop(k.whole(scene.order + 2)) as m:
            place = k.at(k.at(rows, k.multiply(m, k.whole(count))), begin)
            other = k.at(place, 1)
            a, b = k.load(place), k.load(other)
            k.store(k.add(k.multiply(c, a), k.multiply(s, b)), place)
            k.store(k.subtract(k.multiply(c, b), k.multiply(s, a)), other)
        return ()

    for slide, joints in alike(scene.mechanism.slides, scene.mechanism.n):
        if not slide:
            over(k, joints, turn)
    k.done()


def _bounds(k: Kernel, slide: bool, j: Word, first: Word, strays: Word, h: Word) -> Sequence[Word]:
    """Of coordinate j its rate, and of that at most |D|, of |z| at least, and |w - w0| at most.

    `first` are the coefficients of the order 1 of its series, then come those that stray.
    """
    zero, one = k.number(0.0), k.number(1.0)
    total, left, slack = _size(k, *_pair(k, strays, j)), one, zero
    stray, rate = _pair(k, first, j)
    if not slide:
        total = k.add(total, k.intrinsic("fabs", stray))
        slack = k.multiply(k.number(SLACK), k.intrinsic("fabs", rate))
    total = k.multiply(total, k.number(1.0 + SLACK))
    if not slide:
        left = k.subtract(one, k.multiply(h, total))
        left = k.select(k.less(zero, left), left, zero)
    return rate, total, left, k.add(k.divide(total, left), slack)


def write_box(scene: Scene, module: Module) -> None:
    """step_box(block, end, there, box): of the step from the block's state to that at `end`."""
    k = Kernel(module, "step_box", (ADDRESS, SCALAR, ADDRESS, ADDRESS), "void")
    block, end, there, box = k.arguments
    n, count = scene.mechanism.n, 2 * scene.mechanism.n
    x = k.subtract(end, scene.get(k, block, "t"))
    h, slack = k.intrinsic("fabs", x), k.number(SLACK)
    first, width = scene.row(k, block, 1), k.whole(len(scene.loop.columns))
    strays, aparts, owns = (k.room(SCALAR, i) for i in (count * (scene.order + 2), n, n))
    _strays(scene, k, first, width, h, strays)
    for slide, joints in alike(scene.mechanism.slides, scene.mechanism.n):

        def keep(j: Word, _: Sequence[Word], slide: bool = slide) -> Sequence[Word]:
            apart = _bounds(k, slide, j, first, strays, h)[-1]
            for room in (aparts, owns):
                k.store(apart, k.at(room, j))
            return ()

        over(k, joints, keep)
    for j, above in enumerate(scene.mechanism.above):
        if above is not None:
            both = (k.load(k.at(aparts, i)) for i in (j, above))
            k.store(k.add(*both), k.at(owns, j))
    if scene.closes:
        scene.put(k, block, "x", x)
        k.line(f"call void @evaluate({block})")
    begin, ends = (scene.at(k, block, name) for name in ("q0", "to_q0"))

    def put(j: Word, _: Sequence[Word]) -> Sequence[Word]:
        own, places = k.load(k.at(owns, j)), (j, k.add(j, k.whole(n)))
        q, qd = (k.load(k.at(begin, place)) for place in places)
        half = k.multiply(k.multiply(k.number(0.5), x), qd)
        turned = k.add(k.intrinsic("fabs", half), k.multiply(h, own))
        found = (q, k.add(q, half), turned), (qd, qd, own)
        for place, (start, middle, reach) in zip(places, found, strict=True):
            reach = k.add(reach, k.multiply(slack, k.intrinsic("fabs", start)))
            if scene.closes:
                missed = k.subtract(k.load(k.at(ends, place)), k.load(k.at(there, place)))
                missed = k.multiply(k.number(MISSED), k.intrinsic("fabs", missed))
                reach = k.add(reach, missed)
            k.store(middle, k.at(box, place))
            k.store(reach, k.at(k.at(box, count), place))
        return ()

    over(k, range(n), put)
    k.done()


def write_slope(
    scene: Scene, k: Kernel, rows: Word, width: Word, h: Word, form: Word
) -> Sequence[Word]:
    """The slope of a linear function where a series begins, and how far it goes from there in h."""
    n, first = scene.mechanism.n, k.at(rows, width)
    room, sums = k.room(SCALAR, 2 * n * (scene.order + 2)), k.room(SCALAR, 2 * n)
    strays = k.at(room, 2 * n)
    _strays(scene, k, first, width, h, room)
    _strays(scene, k, first, width, h, sums, strays)
    totals: Sequence[Word] = k.load(k.at(form, 1)), k.number(0.0)
    for slide, joints in alike(scene.mechanism.slides, scene.mechanism.n):

        def add(j: Word, totals: Sequence[Word], slide: bool = slide) -> Sequence[Word]:
            rate, far, left, apart = _bounds(k, slide, j, first, room, h)
            stray, speedup = _pair(k, strays, j)
            further = _size(k, *_pair(k, sums, j))
            if not slide:
                missed = k.multiply(rate, _pair(k, first, j)[0])
                further = k.add(further, _size(k, stray, missed))
                further = k.add(further, k.multiply(apart, far))
            further = k.multiply(k.divide(further, left), k.number(1.0 + SLACK))
            slope, reach = totals
            for i, (value, off) in enumerate(((rate, apart), (speedup, further))):
                weight = k.load(k.at(k.at(form, 2 + (2 + i) * n), j))
                slope = k.add(slope, k.multiply(weight, value))
                reach = k.add(reach, k.multiply(k.intrinsic("fabs", weight), off))
            return slope, reach

        totals = over(k, joints, add, totals)
    return totals
