"""Machine code of what `step_boxes.py` derives: boxes of steps."""

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


def _strays(scene: Scene, k: Kernel, first: Word, width: Word, h: Word, out: Word) -> None:
    """Sums of |D_m| h^m, by a series' rows from the order 1 on, side by side."""
    for begin in _begins(2 * scene.mechanism.n):
        name = _write_strays(scene, k.module, begin)
        row, to = k.at(first, begin), k.at(out, begin)
        k.line(f"call void @{name}({', '.join(map(str, (row, width, h, to)))})")


def _write_strays(scene: Scene, module: Module, begin: int) -> str:
    """strays(first, width, h, out): the same of a piece of the rows.

    D_m = (m + 1) z_{m+1} - i w0 z_m, of each order m > 0.
    """
    all_columns = 2 * scene.mechanism.n
    count = min(COLUMNS, all_columns)
    ways = [j in scene.mechanism.slides for j in range(begin // 2, (begin + count) // 2)]
    name = f"strays_{''.join('ts'[slides] for slides in ways)}"
    if name in module.functions:
        return name
    wide = Module(count)
    wide.functions = module.functions
    k = Kernel(wide, name, (ADDRESS, WHOLE, SCALAR, ADDRESS), "void")
    first, width, h, out = k.arguments
    step = k.spread(h)
    # less i times what turns: theta and -rho
    turns = (0.0 if ways[i // 2] else 1.0 - 2.0 * (i % 2) for i in range(count))
    factors = Word(f"<{', '.join(str(k.scalar(turn)) for turn in turns)}>", k.numbers)

    def moved(row: Word, places: Iterable[int]) -> Word:
        other = ", ".join(f"i32 {i}" for i in places)
        text = f"shufflevector {row}, {k.numbers} poison, <{count} x i32> <{other}>"
        return k.op(k.numbers, text)

    last = scene.order + 1
    powers, sums = [k.number(1.0), step], [k.number(0.0)] * SUMS
    row, z = first, k.load(first)
    w = k.multiply(factors, moved(z, (i | 1 for i in range(count))))
    for m in range(1, last + 1):  # one after the other in text: a loop would wait for its sums
        if m > 1:
            powers.append(k.multiply(powers[m // 2], powers[m - m // 2]))
        found = k.multiply(w, moved(z, (i ^ 1 for i in range(count))))
        if m < last:
            row = k.at(row, width)
            z = k.load(row)
            found = k.add(found, k.multiply(k.number(m + 1.0), z))
        size = k.multiply(k.intrinsic("fabs", found), powers[m])
        sums[m % SUMS] = k.add(sums[m % SUMS], size)
    while len(sums) > 1:
        sums = [k.add(*pair) for pair in zip(sums[::2], sums[1::2], strict=True)]
    k.store(sums[0], out)
    k.done()
    return name


def _pair(k: Kernel, row: Word, j: Word) -> tuple[Word, Word]:
    place = k.at(row, k.add(j, j))
    return k.load(place), k.load(k.at(place, 1))


def _size(k: Kernel, *parts: Word) -> Word:
    return k.add(*(k.intrinsic("fabs", part) for part in parts))


def _apart(k: Kernel, slide: bool, j: Word, first: Word, strays: Word, h: Word) -> Word:
    """How far the rate of coordinate j goes at most from what it is at the start, |w - w0|.

    `first` are the coefficients of the order 1 of its series.
    """
    total, (stray, rate) = _size(k, *_pair(k, strays, j)), _pair(k, first, j)
    most = k.number(1.0 + SLACK)
    if slide:
        return k.multiply(total, most)
    total = k.multiply(k.add(total, k.intrinsic("fabs", stray)), most)
    left = k.subtract(k.number(1.0), k.multiply(h, total))
    left = k.select(k.less(k.number(0.0), left), left, k.number(0.0))
    slack = k.multiply(k.number(SLACK), k.intrinsic("fabs", rate))
    return k.add(k.divide(total, left), slack)


def write_box(scene: Scene, module: Module) -> None:
    """step_box(block, end, there, box): of the step from the block's state to that at `end`."""
    k = Kernel(module, "step_box", (ADDRESS, SCALAR, ADDRESS, ADDRESS), "void")
    block, end, there, box = k.arguments
    n, count = scene.mechanism.n, 2 * scene.mechanism.n
    x = k.subtract(end, scene.get(k, block, "t"))
    h, slack = k.intrinsic("fabs", x), k.number(SLACK)
    first, width = scene.row(k, block, 1), k.whole(len(scene.loop.columns))
    strays, aparts, owns = (k.room(SCALAR, i) for i in (count, n, n))
    _strays(scene, k, first, width, h, strays)
    for slide, joints in alike(scene.mechanism.slides, scene.mechanism.n):

        def keep(j: Word, _: Sequence[Word], slide: bool = slide) -> Sequence[Word]:
            apart = _apart(k, slide, j, first, strays, h)
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
