"""Machine code that finds where linear functions of the state pass zero, step by step.

A function's series along a step follows from that of the rates, sum (2 j - m - 1) theta_j
rho_{m+1-j} of a coordinate that turns.  As a sum of Chebyshev's polynomials it tells what
`events/signs.py` does: that the function has one sign, or passes zero once.  What neither holds of
is `unsure`, and so is the whole call: the steps are made once more, and looked at from Python.

What is proved, and what is assumed.  A run returns, of a step's polynomials z of degree order + 1,
the angles of z and the rates Im(z'/z).  Of these the following holds to rounding, of open chains:

- a sign by a box (`step_boxes.py`) holds on the whole step;
- the signs at a step's ends, and a zero, are those of the states themselves.

That there is no other zero in a step rests on the series above, which has the orders of
Im(z' conj(z)) up to `order`; it leaves out those beyond, and |z|^2 - 1.  Assumed, not proved, is
that these stay below an E, their slope below 256 E and their bend below 21760 E, as a polynomial of
degree 16 would on [-1, 1].  E is twice the sum of the last three terms kept, 1e-9 of the sum of
|c_k|, k > 0, and rounding.  They are no larger where the terms from the last one kept on fall at
least as fast as 1, 1/2, 1/4; steps are chosen so by their last terms.  States of closed chains are
brought back onto the closures, by a miss known at the step's end: it is assumed to be at most
4 times that, in a box as well, within the step.
"""

from __future__ import annotations

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.machine_steps import Scene
from robodyn.events.rounding import EPS, STATE
from robodyn.events.signs import BENDS, DEGREE, MISSED, ROUNDING, SLOPES
from robodyn.taylor.chebyshev_code import write_bounds
from robodyn.taylor.step_boxes import write_box

PASSES = 60  # of Newton's method on a series, kept in the bracket
ROUNDS = 5  # of Newton's method on the states
ENDED = 1e-9  # of a step: after so small a move of Newton's method the next is below rounding
MARGIN = 1e-9  # of a function's change along a step, that its sign must exceed
ROOM = 4096  # zeros that a call may find
# of the table of a watch: addresses, then how many functions, zeros found, whether it is unsure
WATCH = ("forms", "zeros", "matrix", "functions", "found", "unsure")
ZERO = ("function", "t", "apart", "sign")  # what `Found` has of each, before the state


class Watch:
    """Writes the functions that an observer calls; `told` has the address of WATCH's table."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.n = scene, scene.mechanism.n
        self.count = 2 * self.n
        self.sign = 2 + 4 * self.n  # its place in a form

    def declare(self, module: Module) -> None:
        """All of them."""
        write_bounds(module, self.scene.order)
        self._write_value(module)
        self._write_series(module)
        self._write_nearest(module)
        self._write_look(module)
        self._write_step(module)

    # -- one function ------------------------------------------------------------------------------

    def _write_value(self, module: Module) -> None:
        """event_value(form, state, t): of a function."""
        k = Kernel(module, "event_value", (ADDRESS, ADDRESS, SCALAR), SCALAR)
        form, state, t = k.arguments
        first = k.add(k.load(form), k.multiply(k.load(k.at(form, 1)), t))
        with k.loop(k.whole(self.count)) as i:
            value = k.carried(first)
            term = k.multiply(k.load(k.at(form, k.add(i, k.whole(2)))), k.load(k.at(state, i)))
            k.becomes(value, k.add(value, term))
        k.done(value)

    def _write_series(self, module: Module) -> None:
        """event_series(block, form, x, out): a function's terms at x but the first."""
        k = Kernel(module, "event_series", (ADDRESS, ADDRESS, SCALAR, ADDRESS), "void")
        block, form, x, out = k.arguments
        scene, n, orders = self.scene, self.n, self.scene.order + 1
        width, one = len(scene.loop.columns), k.number(1.0)
        with k.loop(k.whole(orders)) as m:
            k.store(k.number(0.0), k.at(out, k.add(m, k.whole(1))))
        for j in range(n):
            angle, rate = (k.load(k.at(form, 2 + 2 * n + i * n + j)) for i in (0, 1))
            none = k.both(*(k.compare("oeq", each, k.number(0.0)) for each in (angle, rate)))
            with k.when(k.invert(none)), k.loop(k.whole(orders)) as m:
                power, level = k.carried(one), k.carried(one)
                if j in scene.mechanism.slides:
                    theta = k.load(k.at(scene.row(k, block, k.add(m, k.whole(1))), 2 * j + 1))
                    found = k.multiply(level, theta)
                else:
                    low = scene.row(k, block, 0, 2 * j)
                    high = scene.row(k, block, k.add(m, k.whole(1)), 2 * j)
                    lowest = k.negate(level)
                    with k.loop(k.add(m, k.whole(2))):
                        up, down, total = k.carried(low), k.carried(high), k.carried(k.number(0.0))
                        weight = k.carried(lowest)
                        term = k.multiply(k.load(k.at(up, 1)), k.load(down))
                        k.becomes(total, k.add(total, k.multiply(weight, term)))
                        k.becomes(weight, k.add(weight, k.number(2.0)))
                        k.becomes(up, k.at(up, width))
                        k.becomes(down, k.at(down, -width))
                    found = total
                # of order m + 1: the rate's own, and its integral
                here = k.multiply(found, power)
                place = k.at(out, m)
                k.store(k.add(k.load(place), k.multiply(rate, here)), place)
                whole = k.divide(k.multiply(k.multiply(angle, here), x), level)
                place = k.at(out, k.add(m, k.whole(1)))
                k.store(k.add(k.load(place), whole), place)
                k.becomes(power, k.multiply(power, x))
                k.becomes(level, k.add(level, one))
        first = k.at(out, 1)
        linear = k.multiply(k.load(k.at(form, 1)), x)
        k.store(k.add(k.load(first), linear), first)
        k.store(k.number(0.0), out)
        k.done()

    def _write_nearest(self, module: Module) -> None:
        """event_nearest(series, sign, start, out): where in [0, 1] it takes a sign; the slope."""
        k = Kernel(module, "event_nearest", (ADDRESS, SCALAR, SCALAR, ADDRESS), "void")
        series, sign, start, out = k.arguments
        orders = self.scene.order + 2
        low, high = k.slot(k.number(0.0)), k.slot(k.number(1.0))
        y, slope = k.slot(start), k.slot(k.number(0.0))
        passes = k.slot(k.whole(0))
        with k.forever() as out_label:
            now = k.get(y, SCALAR)
            with k.loop(k.whole(orders)) as m:
                value, rate = k.carried(k.number(0.0)), k.carried(k.number(0.0))
                place = k.subtract(k.whole(orders - 1), m)
                k.becomes(rate, k.add(k.multiply(rate, now), value))
                k.becomes(value, k.add(k.multiply(value, now), k.load(k.at(series, place))))
            k.set(slope, rate)
            after = k.less(k.number(0.0), k.multiply(value, sign))
            below = k.select(after, k.get(low, SCALAR), now)
            above = k.select(after, now, k.get(high, SCALAR))
            k.set(low, below)
            k.set(high, above)
            new = k.subtract(now, k.divide(value, rate))
            within = k.both(k.compare("oge", new, below), k.compare("ole", new, above))
            middle = k.multiply(k.number(0.5), k.add(below, above))
            new = k.select(within, new, middle)
            k.set(y, new)
            moved = k.intrinsic("fabs", k.subtract(new, now))
            k.leave(k.compare("ole", moved, k.number(ENDED)), out_label)
            count = k.add(k.get(passes, WHOLE), k.whole(1))
            k.set(passes, count)
            k.leave(k.compare("sge", count, k.whole(PASSES)), out_label)
        k.store(k.get(y, SCALAR), out)
        k.store(k.get(slope, SCALAR), k.at(out, 1))
        k.done()

    # -- one step ----------------------------------------------------------------------------------

    def _told(self, k: Kernel, watch: Word, name: str) -> Word:
        place = WATCH.index(name)
        return k.load(k.at(watch, place), ADDRESS if place < WATCH.index("functions") else WHOLE)

    def _tell(self, k: Kernel, watch: Word, name: str, value: Word) -> None:
        k.store(value, k.at(watch, WATCH.index(name)))

    def _write_look(self, module: Module) -> None:
        """event_look(block, watch, f, form, there, end): one that may pass zero in a step."""
        types = (ADDRESS, ADDRESS, WHOLE, ADDRESS, ADDRESS, SCALAR)
        k = Kernel(module, "event_look", types, "void")
        block, watch, f, form, there, end = k.arguments
        scene, zero = self.scene, k.number(0.0)
        begin, here = scene.get(k, block, "t"), scene.at(k, block, "q0")
        x = k.subtract(end, begin)
        series, bounds = k.room(SCALAR, scene.order + 3), k.room(SCALAR, 6)
        nearest = k.room(SCALAR, 2)
        state = scene.at(k, block, "to_q0")

        def value(state: Word, t: Word) -> Word:
            return k.op(SCALAR, f"call double @event_value({form}, {state}, {t})")

        first, last = value(here, begin), value(there, end)
        k.line(f"call void @event_series({block}, {form}, {x}, {series})")
        k.store(first, series)
        table = self._told(k, watch, "matrix")
        k.line(f"call void @event_bounds({series}, {table}, {bounds})")
        own = [k.load(k.at(bounds, i)) for i in range(3)]
        changes, slopes, bends = (k.load(k.at(bounds, 3 + i)) for i in range(3))
        with k.loop(k.whole(scene.order + 2)) as m:
            total = k.carried(zero)
            k.becomes(total, k.add(total, k.load(k.at(series, m))))
        noise = self._noise(k, form, here, there, begin, end)
        size = k.add(k.intrinsic("fabs", own[0]), changes)
        noise = k.add(noise, k.multiply(k.number(ROUNDING), size))
        missed = k.multiply(k.number(MISSED), k.intrinsic("fabs", k.subtract(total, last)))
        error = k.add(k.add(noise, missed), k.multiply(k.number(MARGIN), changes))
        for order in range(scene.order - 1, scene.order + 2):  # what the series leaves out
            tail = k.intrinsic("fabs", k.load(k.at(series, order)))
            error = k.add(error, k.multiply(k.number(2.0), tail))
        old_place = k.at(form, self.sign)
        old = k.load(old_place)

        def sign(word: Word, beyond: Word) -> Word:
            up = k.select(k.less(beyond, word), k.number(1.0), zero)
            return k.select(k.less(word, k.negate(beyond)), k.number(-1.0), up)

        def above(word: Word, times: float, rest: Word, most: float) -> Word:
            left = k.multiply(k.number(times), k.intrinsic("fabs", word))
            return k.less(k.add(rest, k.multiply(k.number(most), error)), left)

        one_sign = above(own[0], 1.0, changes, 1.0)
        steady = above(own[1], 1.0, slopes, float(SLOPES[DEGREE]))
        once = k.either(steady, above(own[2], 4.0, bends, float(BENDS[DEGREE])))
        begins, ends = sign(first, noise), sign(last, noise)
        product = k.multiply(begins, ends)
        stays = k.either(one_sign, k.both(steady, k.less(zero, product)))
        fits = k.either(k.compare("oeq", old, zero), k.compare("oeq", old, ends))
        hidden = k.both(k.compare("oeq", begins, zero), k.compare("oeq", old, zero))
        goes_on = k.either(stays, k.both(steady, hidden))
        goes_on = k.both(k.both(goes_on, fits), k.compare("une", ends, zero))
        fits = k.either(k.compare("oeq", old, zero), k.compare("oeq", old, begins))
        passes = k.both(k.both(once, fits), k.less(product, zero))
        self._tell_where(k, watch, k.invert(k.either(goes_on, passes)))
        with k.when(k.either(goes_on, passes)):
            k.store(ends, old_place)
        with k.when(k.both(passes, k.invert(goes_on))):
            start = k.divide(first, k.subtract(first, last))
            k.line(f"call void @event_nearest({series}, {ends}, {start}, {nearest})")
            part, slope = k.load(nearest), k.load(k.at(nearest, 1))
            speed = k.divide(slope, x)
            rest = k.multiply(k.number(4.0 * EPS), k.intrinsic("fabs", k.multiply(end, speed)))
            limit = k.add(noise, rest)
            at, sure = k.slot(k.multiply(part, x)), k.slot(k.all_lanes(False))
            count = k.slot(k.whole(0))
            with k.forever() as done:
                now = k.get(at, SCALAR)
                scene.put(k, block, "x", now)
                k.line(f"call void @evaluate({block})")
                if scene.closes:
                    k.line(f"call void @close({block})")
                miss = value(state, k.add(begin, now))
                known = k.compare("ole", k.intrinsic("fabs", miss), limit)
                k.set(sure, known)
                k.leave(known, done)
                k.set(at, k.subtract(now, k.divide(miss, speed)))
                tried = k.add(k.get(count, WHOLE), k.whole(1))
                k.set(count, tried)
                k.leave(k.compare("sge", tried, k.whole(ROUNDS)), done)
            now = k.get(at, SCALAR)
            inside = k.both(
                k.less(zero, k.divide(now, x)), k.compare("ole", k.divide(now, x), k.number(1.0))
            )
            found = self._told(k, watch, "found")
            good = k.both(
                k.get(sure, k.mask), k.both(inside, k.compare("slt", found, k.whole(ROOM)))
            )
            self._tell_where(k, watch, k.invert(good))
            with k.when(good):
                row = k.at(
                    self._told(k, watch, "zeros"),
                    k.multiply(found, k.whole(len(ZERO) + self.count)),
                )
                blur = k.intrinsic("fabs", k.divide(k.multiply(k.number(2.0), noise), speed))
                name = k.convert("sitofp", f, SCALAR)
                for i, word in enumerate((name, k.add(begin, now), blur, ends)):
                    k.store(word, k.at(row, i))
                states = k.at(row, len(ZERO))
                k.each(self.count, lambda i: k.store(k.load(k.at(state, i)), k.at(states, i)))
                self._tell(k, watch, "found", k.add(found, k.whole(1)))
        k.done()

    def _tell_where(self, k: Kernel, watch: Word, unsure: Word) -> None:
        with k.when(unsure):
            self._tell(k, watch, "unsure", k.whole(1))

    def _noise(
        self, k: Kernel, form: Word, here: Word, there: Word, begin: Word, end: Word
    ) -> Word:
        """What rounding may add to a function along a step (`rounding.bound_of`)."""
        total = k.intrinsic("fabs", k.load(form))
        t = k.intrinsic("fabs", k.multiply(k.load(k.at(form, 1)), self._larger(k, begin, end)))
        noise = k.multiply(k.number(2.0 * EPS), k.add(total, t))
        for i in (0, 1):
            first, count = i * self.n, k.whole(self.n)
            with k.loop(count) as j:
                largest, weights = k.carried(k.number(0.0)), k.carried(k.number(0.0))
                place = k.add(j, k.whole(first))
                both = self._larger(k, k.load(k.at(here, place)), k.load(k.at(there, place)))
                k.becomes(largest, self._larger(k, largest, both))
                weight = k.load(k.at(form, k.add(place, k.whole(2))))
                k.becomes(weights, k.add(weights, k.intrinsic("fabs", weight)))
            most = k.multiply(k.number(STATE + 4.0 * EPS), k.multiply(largest, weights))
            noise = k.add(noise, most)
        return noise

    def _larger(self, k: Kernel, a: Word, b: Word) -> Word:
        a, b = k.intrinsic("fabs", a), k.intrinsic("fabs", b)
        return k.select(k.less(a, b), b, a)

    def _write_step(self, module: Module) -> None:
        """event_step(block, watch, there, end): all functions along a step."""
        k = Kernel(module, "event_step", (ADDRESS, ADDRESS, ADDRESS, SCALAR), "void")
        block, watch, there, end = k.arguments
        scene, zero = self.scene, k.number(0.0)
        begin = scene.get(k, block, "t")
        box = k.room(SCALAR, 2 * self.count)
        write_box(scene, k, block, end, there, box)
        half = k.multiply(k.number(0.5), k.subtract(end, begin))
        middle = k.add(begin, half)
        forms = self._told(k, watch, "forms")
        with k.loop(self._told(k, watch, "functions")) as f:
            form = k.at(forms, k.multiply(f, k.whole(self.sign + 1)))
            level, speed = k.load(form), k.load(k.at(form, 1))
            timed = k.multiply(speed, middle)
            start = k.add(level, timed)
            size = k.add(k.intrinsic("fabs", level), k.intrinsic("fabs", timed))
            far = k.intrinsic("fabs", k.multiply(speed, half))
            with k.loop(k.whole(self.count)) as i:
                value, sizes, reach = k.carried(start), k.carried(size), k.carried(far)
                weight = k.load(k.at(form, k.add(i, k.whole(2))))
                term = k.multiply(weight, k.load(k.at(box, i)))
                off = k.load(k.at(box, k.add(i, k.whole(self.count))))
                off = k.intrinsic("fabs", k.multiply(weight, off))
                k.becomes(value, k.add(value, term))
                k.becomes(sizes, k.add(sizes, k.intrinsic("fabs", term)))
                k.becomes(reach, k.add(reach, off))
            limit = k.add(reach, k.multiply(k.number(4.0 * EPS), sizes))
            sure = k.less(limit, k.intrinsic("fabs", value))
            sign = k.select(k.less(zero, value), k.number(1.0), k.number(-1.0))
            place = k.at(form, self.sign)
            other = k.compare("oeq", k.load(place), k.negate(sign))
            self._tell_where(k, watch, k.both(sure, other))
            with k.when(sure):
                k.store(sign, place)
            with k.when(k.invert(sure)):
                arguments = block, watch, f, form, there, end
                k.line(f"call void @event_look({', '.join(map(str, arguments))})")
        k.done()
