"""Machine code that finds where linear functions of the state pass zero, step by step.

What holds, and of what.  The motion along a step is that of the polynomials z (degree order + 1)
which a run keeps: the angles of z, the rates Im(z'/z).  On these, whatever the series leaves out of
the true motion, the following holds to rounding, of open chains:

- along a step, or a piece of it, a function's slope stays within bounds that the products of the
  series tell (`coordinate_code.py`).  Where they have one sign it is monotone, and its signs at the
  ends, those of the states themselves, tell whether it passes zero.  Where it has one sign at both
  ends it keeps it if the lines of these slopes from the ends meet before zero;
- what neither holds of is halved, and each part looked at likewise, to 1/1024 of a step.  What is
  not known then is `unsure`, and so is the whole call: the steps are made once more, and looked at
  from Python;
- a time at which it passes zero is found on the states, to rounding.

States of closed chains are brought back onto the closures, by a miss known at the step's end.  Of
these it is assumed, not proved, that the miss within a step, or a part of it, is at most 4 times
that, and its slope what a polynomial of degree 16 of that size may have.
"""

from __future__ import annotations

from functools import lru_cache

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.machine import Code, Processor, extend
from robodyn.engines.machine_steps import Scene
from robodyn.events.rounding import EPS, STATE
from robodyn.events.signs import DEGREE, MISSED, ROUNDING, SLOPES
from robodyn.taylor import NoCodeError
from robodyn.taylor.box_code import write_box
from robodyn.taylor.function_code import wide, write_function
from robodyn.taylor.zero_code import tell_unsure, told, value_of, write_zero

PIECES = 1024  # of a step, those that it is looked at by at most


@lru_cache(maxsize=64)
def looks(scene: Scene, code: Code) -> tuple[int, int]:
    """Where step_box and event_step begin; they join the code when they are first wanted.

    Raises NoCodeError where they cannot.
    """
    if not extend(code, Watch(scene).text, f"watch {scene.key}"):
        raise NoCodeError("no machine code can be made")
    return code.address("step_box"), code.address("event_step")


class Watch:
    """Writes the functions that an observer calls; `told` has the address of WATCH's table."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.n = scene, scene.mechanism.n
        self.sign = 2 + 4 * self.n  # its place in a form

    def text(self, processor: Processor) -> str:
        """All of them, which call those of the scene's own code."""
        module = Module(processor.lanes)
        for name in ("evaluate", "close")[: 1 + self.scene.closes]:
            module.declare(name, "void", ADDRESS)
        write_box(self.scene, module)
        write_function(self.scene, module)
        write_zero(self.scene, module)
        self._write_pieces(module)
        self._write_look(module)
        self._write_step(module)
        return module.text

    def _write_look(self, module: Module) -> None:
        """event_look(block, watch, f, form, there, end, parts): one function along a step.

        `parts` are what is known of the coordinates along it.
        """
        types = (ADDRESS, ADDRESS, WHOLE, ADDRESS, ADDRESS, SCALAR, ADDRESS)
        k = Kernel(module, "event_look", types, "void")
        block, watch, f, form, there, end, parts = k.arguments
        scene, zero, one = self.scene, k.number(0.0), k.number(1.0)
        begin, here = scene.get(k, block, "t"), scene.at(k, block, "q0")
        x, slope = k.subtract(end, begin), k.room(SCALAR, 2)
        first, last = value_of(k, form, here, begin), value_of(k, form, there, end)
        noise = self._noise(k, form, here, there, begin, end)
        size = k.add(k.intrinsic("fabs", first), k.intrinsic("fabs", last))
        noise = k.add(noise, k.multiply(k.number(ROUNDING), size))
        missed = zero
        if scene.closes:
            scene.put(k, block, "x", x)
            k.call("evaluate", block)
            miss = value_of(k, form, scene.at(k, block, "to_q0"), end)
            missed = k.intrinsic("fabs", k.subtract(miss, last))
            missed = k.multiply(k.number(MISSED), missed)
        k.call("event_slope", form, parts, x, one, slope)
        goes_on, passes, ends = self._seen(k, slope, form, first, last, noise, missed)
        with k.when(k.either(goes_on, passes)):
            k.store(ends, k.at(form, self.sign))
        with k.when(passes):
            given = block, watch, f, form, parts, zero, x, zero, first, last, noise
            k.call("event_locate", *given)
        with k.when(k.invert(k.either(goes_on, passes))):
            k.call("event_pieces", block, watch, f, form, x, first, last, noise, missed)
        k.done()

    def _write_pieces(self, module: Module) -> None:
        """event_pieces(block, watch, f, form, x, first, last, noise, missed): it by pieces of x."""
        types = (ADDRESS, ADDRESS, WHOLE, ADDRESS, *(SCALAR,) * 5)
        k = Kernel(module, "event_pieces", types, "void")
        block, watch, f, form, x, first, last, noise, missed = k.arguments
        minus, table = k.number(-1.0), told(k, watch, "binomials")
        used = k.multiply(k.add(f, k.whole(1)), k.whole(self.n))
        used = k.at(told(k, watch, "used"), used)
        parts, slope = k.room(SCALAR, wide(self.scene.order) * self.n), k.room(SCALAR, 2)
        unit = k.multiply(x, k.number(1.0 / PIECES))
        place, pieces, value = k.slot(k.whole(0)), k.slot(k.whole(PIECES // 2)), k.slot(first)
        with k.forever() as done:
            at, many, now = k.get(place, WHOLE), k.get(pieces, WHOLE), k.get(value, SCALAR)
            to = k.add(at, many)
            start, long = (k.multiply(unit, k.convert("sitofp", w, SCALAR)) for w in (at, many))
            reaches = k.slot(last)
            with k.when(k.compare("slt", to, k.whole(PIECES))):
                there_x = k.add(start, long)
                then = k.result_of(SCALAR, "event_at", block, form, there_x)
                k.set(reaches, then)
            then, half = k.get(reaches, SCALAR), k.multiply(k.number(0.5), long)
            middle = k.add(start, half)
            k.call("event_about", block, middle, half, table, used, parts)
            k.call("event_slope", form, parts, half, k.number(2.0), slope)
            goes_on, passes, ends = self._seen(k, slope, form, now, then, noise, missed)
            sure = k.either(goes_on, passes)
            with k.when(sure):
                k.store(ends, k.at(form, self.sign))
                with k.when(passes):
                    given = block, watch, f, form, parts, middle, half, minus, now, then, noise
                    k.call("event_locate", *given)
                k.leave(k.compare("sge", to, k.whole(PIECES)), done)
                k.set(place, to)
                k.set(value, then)
                odd = k.both(to, many)  # where it is even the next part may be twice as long
                more = k.select(k.compare("eq", odd, k.whole(0)), many, k.whole(0))
                k.set(pieces, k.add(many, more))
            with k.when(k.invert(sure)):
                tell_unsure(k, watch, k.compare("sle", many, k.whole(1)))
                k.leave(k.compare("sle", many, k.whole(1)), done)
                k.set(pieces, k.op(WHOLE, f"lshr {many}, 1"))
        k.done()

    def _seen(
        self,
        k: Kernel,
        slope: Word,
        form: Word,
        first: Word,
        last: Word,
        noise: Word,
        missed: Word,
    ) -> tuple[Word, Word, Word]:
        """Along a piece: whether it goes on with a sign, or passes once; and that sign."""
        zero = k.number(0.0)
        change, reach = (k.load(k.at(slope, i)) for i in (0, 1))
        wide = k.add(reach, k.multiply(k.number(2.0 * SLOPES[DEGREE]), missed))
        old = k.load(k.at(form, self.sign))

        def sign(word: Word) -> Word:
            up = k.select(k.less(noise, word), k.number(1.0), zero)
            return k.select(k.less(word, k.negate(noise)), k.number(-1.0), up)

        begins, ends = sign(first), sign(last)
        product = k.multiply(begins, ends)
        steady = k.less(wide, k.intrinsic("fabs", change))
        # what has one sign at both ends falls from them no steeper than its slopes permit
        low, high, change = (k.multiply(begins, each) for each in (first, last, change))
        part = k.add(k.subtract(low, high), k.add(change, wide))
        part = k.divide(part, k.multiply(k.number(2.0), wide))
        least = k.add(low, k.multiply(part, k.subtract(change, wide)))
        stays = k.either(steady, k.less(k.add(noise, missed), least))
        stays = k.both(stays, k.less(zero, product))
        fits = k.either(k.compare("oeq", old, zero), k.compare("oeq", old, ends))
        hidden = k.both(k.compare("oeq", begins, zero), k.compare("oeq", old, zero))
        goes_on = k.either(stays, k.both(steady, hidden))
        goes_on = k.both(k.both(goes_on, fits), k.compare("une", ends, zero))
        fits = k.either(k.compare("oeq", old, zero), k.compare("oeq", old, begins))
        passes = k.both(k.both(steady, fits), k.less(product, zero))
        return goes_on, passes, ends

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
        scene = self.scene
        parts = k.room(SCALAR, wide(scene.order) * self.n)
        x = k.subtract(end, scene.get(k, block, "t"))
        k.call("event_begin", block, x, told(k, watch, "used"), parts)
        forms = told(k, watch, "forms")
        with k.loop(told(k, watch, "functions")) as f:
            form = k.at(forms, k.multiply(f, k.whole(self.sign + 1)))
            k.call("event_look", block, watch, f, form, there, end, parts)
        k.done()
