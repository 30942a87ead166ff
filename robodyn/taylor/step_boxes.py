"""A box that the state stays in along a step, from the step's series.

z = rho + i theta turns a direction at the rate w = Im(z'/z).  With the rate w0 at the start and
D = z' - i w0 z, which is zero there, z = exp(i w0 x) (1 + integral of exp(-i w0 x) D), so that

    |D| <= far = sum_{k>0} |(k + 1) z_{k+1} - i w0 z_k| h^k,      |z| >= 1 - h far,
    |w - w0| = |Im(D/z)| <= far / (1 - h far),

and the angle goes away from alpha_0 + w0 x by h times that at most.  Of a displacement z' - z'(0)
is D, and far is all.  Sizes |z| are |rho| + |theta|, and a joint's box is that of its own
coordinate and the one below.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.placed import states_along
from robodyn.engines.assembler import ADDRESS, SCALAR, Kernel, Module, Word
from robodyn.events.signs import MISSED
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array, Complex

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene


SLACK = 1e-12  # of the sizes of what is added: more than rounding adds


class Kept(NamedTuple):
    """What an engine keeps of m steps, until it advances again.

    `boxes` (m, 2, 2n) are the middles of q and qd, and how far they go from there; `series(places)`
    (k, order + 2, n) is rho + i theta of steps.
    """

    boxes: Array
    series: Callable[[NDArray[np.int64]], Complex]


def boxes_along(mechanism: Mechanism, y: Array, ends: Array, parts: Array, h: Array) -> Array:
    """The boxes (m, 2, 2n) of steps h (m) from y (m, 2n or more) to `ends`, by their series.

    Those are rho and theta, in `parts` (m, 2, n, order + 2).
    """
    n, last, length = mechanism.n, parts.shape[-1] - 1, np.abs(h)
    terms = np.empty((2, n, last, len(h)))  # z_k h^k, k > 0: all steps side by side, that is fast
    np.multiply(parts[..., 1:].transpose(1, 2, 3, 0), _powers(length, last), out=terms)
    turned = terms[1, :, 0].copy()  # w0 h
    slides = list(mechanism.slides) or slice(0)
    turned[slides] = 0.0
    stray = np.empty_like(terms)
    np.multiply(terms[1], turned[:, None], out=stray[0])
    np.multiply(terms[0], -turned[:, None], out=stray[1])
    terms *= np.arange(1.0, last + 1)[:, None]
    stray[:, :, :-1] += terms[:, :, 1:]
    far = np.abs(stray, out=stray).sum(axis=(0, 2)) * (1.0 + SLACK)
    left = np.maximum(1.0 - far, 0.0)
    left[slides] = 1.0
    with np.errstate(all="ignore"):
        apart = far / left + SLACK * np.abs(turned)
    own = apart.copy()
    for k, above in enumerate(mechanism.above):
        if above is not None:
            own[k] += apart[above]
    start = y[:, : 2 * n].T
    box = np.empty((2, 2 * n, len(h)))
    (middle, reach), half = box, 0.5 * h * start[n:]
    middle[:] = start
    middle[:n] += half
    np.multiply(np.abs(start), SLACK, out=reach)
    reach[:n] += np.abs(half) + own
    reach[n:] += own / length
    if mechanism.rows:
        there = states_along(mechanism, y, as_complex(parts), h, np.ones(1))[:, 0]
        reach += MISSED * np.abs(there - ends[:, : 2 * n]).T
    return box.transpose(2, 0, 1)


def _powers(h: Array, most: int) -> Array:
    """h^k (most, m) of h (m,), k > 0."""
    powers, k = np.empty((most, len(h))), 1
    powers[0] = h
    while k < most:
        upto = min(2 * k, most)
        np.multiply(powers[: upto - k], powers[k - 1], out=powers[k:upto])
        k = upto
    return powers


def as_complex(parts: Array) -> Complex:
    """rho + i theta (m, order + 2, n) of parts (m, 2, n, order + 2)."""
    series: Complex = (parts[:, 0] + 1j * parts[:, 1]).swapaxes(1, 2)
    return series


def _write_sums(scene: Scene, module: Module) -> None:
    """box_sums(row, h, about, out): of the series from the row of order 1 on, all side by side.

    The sums of |(m + 1) z_{m+1} - i w z_m| h^m; `about` are w and -w in turns.  Last of all comes
    the power of h that follows.
    """
    n, width = scene.mechanism.n, len(scene.loop.columns)
    wide = Module(2 * n)
    wide.functions = module.functions
    k = Kernel(wide, "box_sums", (ADDRESS, SCALAR, ADDRESS, ADDRESS), "void")
    first, h, about, out = k.arguments
    w, step = k.load(about), k.spread(h)
    other = ", ".join(f"i32 {i ^ 1}" for i in range(2 * n))
    start = k.load(first)
    with k.loop(k.whole(scene.order)):
        row, now, power = k.carried(first), k.carried(start), k.carried(step)
        level = k.carried(k.number(2.0))
        far = k.carried(k.number(0.0))
        after = k.at(row, width)
        later = k.load(after)
        turned = k.op(
            k.numbers, f"shufflevector {now}, {k.numbers} poison, <{2 * n} x i32> <{other}>"
        )
        stray = k.add(k.multiply(level, later), k.multiply(w, turned))
        k.becomes(far, k.add(far, k.multiply(k.intrinsic("fabs", stray), power)))
        for carried, new in (
            (row, after),
            (now, later),
            (power, k.multiply(power, step)),
            (level, k.add(level, k.number(1.0))),
        ):
            k.becomes(carried, new)
    k.store(far, out)
    k.store(k.lane(power, 0), k.at(out, 2 * n))
    k.done()


def write_box(scene: Scene, k: Kernel, block: Word, end: Word, there: Word, box: Word) -> None:
    """The same of the step from the block's state to the time `end` and the state `there`."""
    mechanism, n = scene.mechanism, scene.mechanism.n
    x = k.subtract(end, scene.get(k, block, "t"))
    h, zero, one, last = k.intrinsic("fabs", x), k.number(0.0), k.number(1.0), scene.order + 1
    slack = k.number(SLACK)

    def size(*parts: Word) -> Word:
        return k.add(*(k.intrinsic("fabs", part) for part in parts))

    def pairs(row: Word) -> list[tuple[Word, Word]]:
        return [(k.load(k.at(row, 2 * j)), k.load(k.at(row, 2 * j + 1))) for j in range(n)]

    turns = [j not in mechanism.slides for j in range(n)]
    rates = [
        theta if turn else zero
        for (_, theta), turn in zip(pairs(scene.row(k, block, 1)), turns, strict=True)
    ]
    if "box_sums" not in k.module.functions:
        _write_sums(scene, k.module)
    about, sums = k.room(k.numbers, 2 * n), k.room(k.numbers, 2 * n + 1)
    for j, w in enumerate(rates):
        k.store(w, k.at(about, 2 * j))
        k.store(k.negate(w), k.at(about, 2 * j + 1))
    k.line(f"call void @box_sums({scene.row(k, block, 1)}, {h}, {about}, {sums})")
    far = [k.add(*pair) for pair in pairs(sums)]
    power = k.load(k.at(sums, 2 * n))
    apart = []
    for j, pair in enumerate(pairs(scene.row(k, block, last))):
        tail, w = k.multiply(size(*pair), power), k.intrinsic("fabs", rates[j])
        total = k.multiply(k.add(far[j], k.multiply(w, tail)), k.number(1.0 + SLACK))
        if turns[j]:
            left = k.subtract(one, k.multiply(h, total))
            total = k.divide(total, k.select(k.less(zero, left), left, zero))
        apart.append(k.add(total, k.multiply(slack, w)))
    if scene.closes:
        scene.put(k, block, "x", x)
        k.line(f"call void @evaluate({block})")
    for j, above in enumerate(mechanism.above):
        own = apart[j] if above is None else k.add(apart[j], apart[above])
        q, qd = (scene.get(k, block, f"{name}{j}") for name in ("q", "qd"))
        half = k.multiply(k.multiply(k.number(0.5), x), qd)
        turned = k.add(k.intrinsic("fabs", half), k.multiply(h, own))
        for place, start, middle, reach in ((j, q, k.add(q, half), turned), (n + j, qd, qd, own)):
            reach = k.add(reach, k.multiply(slack, k.intrinsic("fabs", start)))
            if scene.closes:
                series = scene.get(k, block, f"to_{'q' if place < n else 'qd'}{j}")
                missed = k.intrinsic("fabs", k.subtract(series, k.load(k.at(there, place))))
                reach = k.add(reach, k.multiply(k.number(MISSED), missed))
            k.store(middle, k.at(box, place))
            k.store(reach, k.at(box, 2 * n + place))
