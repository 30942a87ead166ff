"""Machine code of the values of linear functions of the state, and of where one passes zero."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.events.rounding import EPS
from robodyn.taylor.coordinate_code import computed

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene

ROUNDS = 8  # of secants on the states
GUESSES = 20  # steps of Newton's on the polynomial before, at most
NEAR = 1e-6  # in s: a step as short is their last
ROOM = 4096  # zeros that a call may find
# of the table of a watch: addresses, of which coordinates are used too, then how many functions,
# zeros found, whether it is unsure
WATCH = ("forms", "zeros", "binomials", "used", "functions", "found", "unsure")
FOUND = WATCH.index("found")
ZERO = ("function", "t", "apart", "sign")  # what `Found` has of each, before the state


def told(k: Kernel, watch: Word, name: str) -> Word:
    """What the table of a watch says."""
    place = WATCH.index(name)
    return k.load(k.at(watch, place), ADDRESS if place < WATCH.index("functions") else WHOLE)


def tell(k: Kernel, watch: Word, name: str, value: Word) -> None:
    """Say something in it."""
    k.store(value, k.at(watch, WATCH.index(name)))


def tell_unsure(k: Kernel, watch: Word, where: Word) -> None:
    """Say in it that the call is unsure, where that holds."""
    with k.when(where):
        tell(k, watch, "unsure", k.whole(1))


def value_of(k: Kernel, form: Word, state: Word, t: Word) -> Word:
    """A function's value at a state and a time."""
    return k.result_of(SCALAR, "event_value", form, state, t)


def write_zero(scene: Scene, module: Module) -> None:
    """Functions that tell values (event_value, event_at), and find a zero (event_locate)."""
    _write_value(scene, module)
    _write_state(scene, module)
    _write_locate(scene, module)


def _write_value(scene: Scene, module: Module) -> None:
    """event_value(form, state, t): of a function."""
    k = Kernel(module, "event_value", (ADDRESS, ADDRESS, SCALAR), SCALAR)
    form, state, t = k.arguments
    first = k.add(k.load(form), k.multiply(k.load(k.at(form, 1)), t))
    with k.loop(k.whole(2 * scene.mechanism.n)) as i:
        value = k.carried(first)
        term = k.multiply(k.load(k.at(form, k.add(i, k.whole(2)))), k.load(k.at(state, i)))
        k.becomes(value, k.add(value, term))
    k.done(value)


def _write_state(scene: Scene, module: Module) -> None:
    """event_at(block, form, x): a function's value at x after the step's start."""
    k = Kernel(module, "event_at", (ADDRESS, ADDRESS, SCALAR), SCALAR)
    block, form, x = k.arguments
    scene.put(k, block, "x", x)
    k.call("evaluate", block)
    if scene.closes:
        k.call("close", block)
    t = k.add(scene.get(k, block, "t"), x)
    k.done(value_of(k, form, scene.at(k, block, "to_q0"), t))


def _write_locate(scene: Scene, module: Module) -> None:
    """event_locate(block, watch, f, form, parts, x, h, low, first, last, noise): of a piece.

    Where it passes zero: by secants, from the zero of its polynomial in s on, from low to 1.
    """
    types = (ADDRESS, ADDRESS, WHOLE, ADDRESS, ADDRESS, *(SCALAR,) * 6)
    k = Kernel(module, "event_locate", types, "void")
    block, watch, f, form, parts, x, h, low, first, last, noise = k.arguments
    count, zero, one = 2 * scene.mechanism.n, k.number(0.0), k.number(1.0)
    begin, rows = scene.get(k, block, "t"), k.room(SCALAR, computed(scene.order))
    k.call("event_rows", form, parts, h, rows)
    k.store(zero, rows)
    k.store(k.subtract(first, _polynomial(scene, k, rows, low)[0]), rows)
    part = k.divide(first, k.subtract(first, last))
    place = k.slot(k.add(low, k.multiply(part, k.subtract(one, low))))
    rate, tries = k.slot(zero), k.slot(k.whole(GUESSES))
    lower, upper = k.slot(low), k.slot(one)
    with k.forever() as done:  # it is monotone: halved where Newton's step leads out
        now, left = k.get(place), k.get(tries, WHOLE)
        value, change = _polynomial(scene, k, rows, now)
        k.set(rate, change)
        before = k.less(k.number(0.0), k.multiply(value, first))
        k.set(lower, k.select(before, now, k.get(lower)))
        k.set(upper, k.select(before, k.get(upper), now))
        moved = k.subtract(now, k.divide(value, change))
        within = k.both(k.less(k.get(lower), moved), k.less(moved, k.get(upper)))
        middle = k.multiply(k.number(0.5), k.add(k.get(lower), k.get(upper)))
        moved = k.select(within, moved, middle)
        k.set(place, moved)
        k.set(tries, k.subtract(left, k.whole(1)))
        off = k.intrinsic("fabs", k.subtract(moved, now))
        k.leave(k.less(off, k.number(NEAR)), done)
        k.leave(k.compare("sle", left, k.whole(1)), done)
    at = k.slot(k.add(x, k.multiply(k.get(place), h)))
    speed = k.slot(k.divide(k.get(rate), h))
    before, missed = k.slot(zero), k.slot(zero)
    sure, tries = k.slot(k.all_lanes(False)), k.slot(k.whole(0))
    with k.forever() as done:
        now, tried = k.get(at, SCALAR), k.get(tries, WHOLE)
        miss = k.result_of(SCALAR, "event_at", block, form, now)
        moved = k.subtract(now, k.get(before, SCALAR))
        secant = k.divide(k.subtract(miss, k.get(missed, SCALAR)), moved)
        fast = k.get(speed, SCALAR)
        fast = k.select(k.compare("slt", k.whole(0), tried), secant, fast)
        rest = k.intrinsic("fabs", k.multiply(k.add(begin, now), fast))
        limit = k.add(noise, k.multiply(k.number(4.0 * EPS), rest))
        known = k.compare("ole", k.intrinsic("fabs", miss), limit)
        k.set(speed, fast)
        k.set(sure, known)
        k.leave(known, done)
        k.set(before, now)
        k.set(missed, miss)
        k.set(at, k.subtract(now, k.divide(miss, fast)))
        k.set(tries, k.add(tried, k.whole(1)))
        k.leave(k.compare("sge", tried, k.whole(ROUNDS)), done)
    now, found = k.get(at, SCALAR), told(k, watch, "found")
    part = k.divide(k.subtract(now, x), h)
    good = k.both(k.less(low, part), k.compare("ole", part, one))
    good = k.both(good, k.compare("slt", found, k.whole(ROOM)))
    good = k.both(good, k.get(sure, k.mask))
    tell_unsure(k, watch, k.invert(good))
    with k.when(good):
        place = k.multiply(found, k.whole(len(ZERO) + count))
        row = k.at(told(k, watch, "zeros"), place)
        blur = k.divide(k.multiply(k.number(2.0), noise), k.get(speed, SCALAR))
        after = k.load(k.at(form, 2 + 2 * count))
        blur = k.intrinsic("fabs", blur)
        words = k.convert("sitofp", f, SCALAR), k.add(begin, now), blur, after
        for i, word in enumerate(words):
            k.store(word, k.at(row, i))
        state, states = scene.at(k, block, "to_q0"), k.at(row, len(ZERO))
        k.each(count, lambda i: k.store(k.load(k.at(state, i)), k.at(states, i)))
        tell(k, watch, "found", k.add(found, k.whole(1)))
    k.done()


def _polynomial(scene: Scene, k: Kernel, rows: Word, s: Word) -> tuple[Word, Word]:
    """Its value at s, and its slope there."""
    last = computed(scene.order) - 1
    with k.loop(k.whole(last + 1)) as i:
        value, slope = k.carried(k.number(0.0)), k.carried(k.number(0.0))
        k.becomes(slope, k.add(k.multiply(slope, s), value))
        c = k.load(k.at(rows, k.subtract(k.whole(last), i)))
        k.becomes(value, k.add(k.multiply(value, s), c))
    return value, slope
