"""Machine code that keeps what steps of one motion leave: ends, series, and rows at given times."""

from __future__ import annotations

from collections.abc import Callable

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Word
from robodyn.engines.machine_motion import Observer
from robodyn.engines.machine_steps import Scene

ROWS = 16384  # of one call: no step begins when there are more
# what the observer is told: addresses, how many times, rows so far, whether series are kept
TABLE = ("times", "rows", "ends", "states", "series", "count", "given", "keeps")
ASKED, GIVEN = TABLE.index("count"), TABLE.index("given")  # what each call tells anew begins there


class Rows(Observer):
    """Keeps every step's end, its series where asked to, and rows at given times; of one lane."""

    key = "rows " + " ".join(TABLE)

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def begin(self, k: Kernel, block: Word, own: Word, leave: Callable[[Word], None]) -> None:
        given, count = self._told(k, own, "given"), self._told(k, own, "count")
        leave(k.compare("sge", given, k.whole(ROWS)))
        wanted = k.compare("sge", count, k.whole(1))
        leave(k.both(wanted, k.compare("sge", given, count)))

    def step(self, k: Kernel, block: Word, own: Word, taken: Word, take: Word, end: Word) -> None:
        with k.when(take):
            self._keep(k, block, own, taken, end)

    def _told(self, k: Kernel, own: Word, name: str) -> Word:
        place = TABLE.index(name)
        return k.load(k.at(own, place), ADDRESS if place < TABLE.index("count") else WHOLE)

    def _keep(self, k: Kernel, block: Word, own: Word, taken: Word, end: Word) -> None:
        scene, count = self.scene, len(self.scene.state)
        wide, to = k.whole(count), scene.at(k, block, "to_q0")
        begin, direction = scene.get(k, block, "t"), scene.get(k, block, "direction")
        there = k.at(self._told(k, own, "states"), k.multiply(taken, wide))
        k.each(count, lambda i: k.store(k.load(k.at(to, i)), k.at(there, i)))
        k.store(end, k.at(self._told(k, own, "ends"), taken))
        with k.when(k.compare("sge", self._told(k, own, "keeps"), k.whole(1))):
            turns, orders = 2 * scene.mechanism.n, scene.order + 2
            with k.loop(k.whole(orders)) as m:
                place = k.multiply(k.add(k.multiply(taken, k.whole(orders)), m), k.whole(turns))
                source = scene.row(k, block, m)
                target = k.at(self._told(k, own, "series"), place)
                k.each(turns, lambda i: k.store(k.load(k.at(source, i)), k.at(target, i)))
        with k.forever() as done:
            given = self._told(k, own, "given")
            k.leave(k.compare("sge", given, self._told(k, own, "count")), done)
            time = k.load(k.at(self._told(k, own, "times"), given), SCALAR)
            ahead = k.multiply(k.subtract(time, end), direction)
            k.leave(k.less(k.number(0.0), ahead), done)
            scene.put(k, block, "x", k.subtract(time, begin))
            k.call("evaluate", block)
            if scene.closes:
                k.call("close", block)
            row = k.at(self._told(k, own, "rows"), k.multiply(given, wide))
            at_end = k.compare("oeq", time, end)

            def keep(i: Word | int) -> None:
                value = k.select(at_end, k.load(k.at(there, i)), k.load(k.at(to, i)))
                k.store(value, k.at(row, i))

            k.each(count, keep)
            k.store(k.add(given, k.whole(1)), k.at(own, TABLE.index("given")))
            self._again(k, there, to)

    def _again(self, k: Kernel, there: Word, to: Word) -> None:
        """The state at the step's end, where another one was made."""
        k.each(len(self.scene.state), lambda i: k.store(k.load(k.at(there, i)), k.at(to, i)))
