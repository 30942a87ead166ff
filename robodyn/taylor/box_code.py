"""Machine code of boxes that the state stays in along a step, from its coordinates' sums.

A coordinate's rate stays as near to that at the step's start as `off`, the third of them, tells.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.events.signs import MISSED
from robodyn.taylor.coordinate_code import SUMS
from robodyn.taylor.function_code import wide
from robodyn.taylor.step_boxes import SLACK

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene

FEW = 8  # coordinates whose text is written one by one; that of more is a loop


def write_box(scene: Scene, module: Module) -> None:
    """step_box(block, end, there, box): of the step from the block's state to that at `end`."""
    k = Kernel(module, "step_box", (ADDRESS, SCALAR, ADDRESS, ADDRESS), "void")
    block, end, there, box = k.arguments
    n, count = scene.mechanism.n, 2 * scene.mechanism.n
    x = k.subtract(end, scene.get(k, block, "t"))
    h, slack = k.intrinsic("fabs", x), k.number(SLACK)
    used, parts, aparts, owns = (k.room(SCALAR, i * n) for i in (1, wide(scene.order), 1, 1))
    k.each(n, lambda j: k.store(k.whole(1), k.at(used, j, WHOLE)))
    k.call("event_begin", block, x, used, parts)

    def keep(j: Word) -> None:
        place = k.at(parts, k.multiply(j, k.whole(wide(scene.order))))
        first, off = (k.load(k.at(place, SUMS.index(name))) for name in ("first", "off"))
        rounding = k.multiply(slack, k.add(k.intrinsic("fabs", first), off))
        for room in (aparts, owns):
            k.store(k.divide(k.add(off, rounding), h), k.at(room, j))

    _each(k, n, keep)
    for j, above in enumerate(scene.mechanism.above):
        if above is not None:
            both = (k.load(k.at(aparts, i)) for i in (j, above))
            k.store(k.add(*both), k.at(owns, j))
    if scene.closes:
        scene.put(k, block, "x", x)
        k.call("evaluate", block)
    begin, ends = (scene.at(k, block, name) for name in ("q0", "to_q0"))

    def put(j: Word) -> None:
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

    _each(k, n, put)
    k.done()


def _each(k: Kernel, count: int, write: Callable[[Word], None]) -> None:
    """Write something for 0 .. count - 1, one by one where these are FEW."""
    if count > FEW:
        k.each(count, write)
    else:
        for j in range(count):
            write(k.whole(j))
