"""What a motion of a sweep leaves behind, kept in machine code along the way.

Extremes and crossings within a step are those of its series, as `step_extremes.py` has them;
energies are weighed at the steps' ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from robodyn.engines.assembler import ADDRESS, WHOLE, Kernel, Module, Word
from robodyn.engines.expression import Graph, Value
from robodyn.engines.formulas import anything, energies
from robodyn.engines.machine_motion import RUNNING, Observer
from robodyn.engines.machine_steps import Items, Scene
from robodyn.mechanics.planar_model import Mechanism
from robodyn.sweeps.step_extremes import NEAR, NEWTON, QUARTERS
from robodyn.taylor import Status

KEPT = ("start", "off", "KE", "PE_low", "PE_high", "E_low", "E_high", "angle", "flip", "begun")
Values = tuple[Word, Word, Word, Word]  # integral, value, slope and bend of a series


def kept(mechanism: Mechanism) -> dict[str, float]:
    """The observer's items of a scene, with the numbers of its energies."""
    n, found = mechanism.n, dict.fromkeys(KEPT, 0.0)
    for name in ("low", "high"):
        found |= {f"{name}{m}": 0.0 for m in range(2 * n)}
    numbers: list[float] = []

    def number(value: float) -> Value:
        numbers.append(value)
        return value

    zero = [0.0] * n
    energies(mechanism, number, zero, zero)
    return found | {f"e{i}": value for i, value in enumerate(numbers) if value}


class _Kept(Items):
    """Those that a motion leaves behind."""

    def widen(self, low: str, high: str, value: Word, mask: Word) -> None:
        """Take a value into its extremes."""
        for name, how in ((low, "olt"), (high, "ogt")):
            _widened(self.k, self.scene.at(self.k, self.block, name), value, mask, how)


class LaneObserver(Observer):
    """Its kernels `begin` and `run` are what Python calls."""

    def __init__(self, scene: Scene, extremes: bool) -> None:
        self.scene, self.extremes = scene, extremes
        self.key = f"lanes {extremes}"

    def declare(self, scene: Scene, module: Module) -> None:
        self._weigh(module)
        self._begin(module)
        if self.extremes:
            self._widen(module)
        if scene.link >= 0:
            self._cross(module)

    def step(self, k: Kernel, block: Word, own: Word, taken: Word, take: Word, end: Word) -> None:
        items = _Kept(self.scene, k, block)
        get, length = items.get, k.subtract(end, items.get("t"))
        items.put("x", k.select(take, length, k.number(0.0)))
        n = self.scene.mechanism.n
        if self.extremes:
            with k.loop(k.whole(n)) as j:
                k.call("widen", block, j)
        if self.scene.link >= 0:
            k.call("cross", block)
        k.call("energies", block)
        KE, PE = get("longest"), get("miss")
        E = k.add(KE, PE)
        items.widen("PE_low", "PE_high", PE, take)
        items.widen("E_low", "E_high", E, take)
        work = get("to_work") if self.scene.work else k.number(0.0)
        off = k.intrinsic("fabs", k.subtract(k.subtract(E, work), get("start")))
        for name, value in (("KE", KE), ("off", off)):
            _widened(k, self.scene.at(k, block, name), value, take, "ogt")
        if self.extremes:  # the states at the ends are closed, the series so to the tolerance
            for m, name in enumerate(self.scene.state[: 2 * n]):
                items.widen(f"low{m}", f"high{m}", get(f"to_{name}"), take)

    def finish(self, scene: Scene, module: Module) -> None:
        """run(block, columns, stride, first, stop, budget): steps of lanes first to stop.

        The columns are those items that Python fills, stride doubles apart; it returns how many
        lanes could take more steps.  A lane that has taken none is begun.
        """
        k = Kernel(module, "run", (ADDRESS, ADDRESS, WHOLE, WHOLE, WHOLE, WHOLE))
        block, columns, stride, first, stop, budget = k.arguments
        waiting, count = k.slot(k.whole(0)), k.whole(len(scene.place))
        with k.loop(stop, first, k.lanes) as lane:
            with k.loop(count) as i:
                item = k.load(k.at(columns, k.add(k.multiply(i, stride), lane)))
                k.store(item, k.at(block, i, k.numbers))
            fresh = k.compare("oeq", scene.get(k, block, "begun"), k.number(0.0))
            with k.when(k.any(fresh)):
                k.call("begin", block)
                scene.put(k, block, "begun", k.number(1.0))
            k.result_of(WHOLE, "advance", block, budget, block)
            running = k.compare("oeq", scene.get(k, block, "status"), k.number(RUNNING))
            k.set(waiting, k.add(k.get(waiting, WHOLE), k.count(running)))
            with k.loop(count) as i:
                item = k.load(k.at(block, i, k.numbers))
                k.store(item, k.at(columns, k.add(k.multiply(i, stride), lane)))
        k.done(k.get(waiting, WHOLE))

    # -- energies ----------------------------------------------------------------------------------

    def _weigh(self, module: Module) -> None:
        """KE and PE of the state there, into items that a step has done with."""
        k, block = self.scene.kernel(module, "energies")
        mechanism, graph, count = self.scene.mechanism, Graph(), [0]

        def number(value: float) -> Value:
            count[0] += 1
            name = f"e{count[0] - 1}"
            return graph.parameter(name, anything(count[0])) if value else 0.0

        names = [f"{x}{j}" for x in ("q", "qd") for j in range(mechanism.n)]
        state = [graph.variable(name) for name in names]
        found = energies(mechanism, number, state[: mechanism.n], state[mechanism.n :])
        segment = self.scene.segment(k, block, found, {name: f"to_{name}" for name in names})
        for name, word in zip(("longest", "miss"), segment.write(found), strict=True):
            self.scene.put(k, block, name, word)
        k.done()

    def _begin(self, module: Module) -> None:
        """From the state at to_q0, ..., closed here: what is kept of the start."""
        scene, n = self.scene, self.scene.mechanism.n
        k, block = scene.kernel(module, "begin")
        items = _Kept(scene, k, block)
        get, put = items.get, items.put
        if scene.closes:
            k.call("close", block)
            running = k.compare("oeq", get("status"), k.number(RUNNING))
            poor = k.both(running, k.compare("ult", get("quality"), get("suspect")))
            put("status", k.select(poor, k.number(float(Status.SINGULAR)), get("status")))
        for name in scene.state:
            put(name, get(f"to_{name}"))
        for m, name in enumerate(scene.state[: 2 * n]):
            for side in ("low", "high"):
                put(f"{side}{m}", get(name))
        k.call("energies", block)
        KE, PE = get("longest"), get("miss")
        E = k.add(KE, PE)
        for name in ("start", "E_low", "E_high"):
            put(name, E)
        put("KE", KE)
        put("PE_low", PE)
        put("PE_high", PE)
        put("off", k.number(0.0))
        put("flip", k.number(math.nan))
        if scene.link >= 0:
            put("angle", k.subtract(get("angle"), self._alpha(k, block)))
        k.done()

    def _alpha(self, k: Kernel, block: Word) -> Word:
        """The angle of the link whose flip is wanted."""
        total = k.number(0.0)
        for j in self.scene.mechanism.turns_by(self.scene.link):
            total = k.add(total, self.scene.get(k, block, f"q{j}"))
        return total

    # -- within a step -----------------------------------------------------------------------------

    def _values(self, k: Kernel, series: Word, x: Word) -> Values:
        """Of the series whose items begin there."""
        count = self.scene.order + 1
        turn, value, slope, bend = (k.number(0.0) for _ in range(4))
        for m in reversed(range(count)):
            c = k.load(k.at(series, m, k.numbers))
            bend = k.add(k.multiply(bend, x), slope)
            slope = k.add(k.multiply(slope, x), value)
            value = k.add(k.multiply(value, x), c)
            turn = k.add(k.multiply(turn, x), k.multiply(c, k.number(1.0 / (m + 1))))
        return k.multiply(turn, x), value, slope, k.multiply(bend, k.number(2.0))

    def _root(
        self,
        k: Kernel,
        function: Callable[[Word], tuple[Word, Word]],
        begin: Word,
        end: Word,
        sign: Word,
        mask: Word,
    ) -> Word:
        """Where a function is zero between two places, by Newton in a bracket."""
        low, high, waiting = k.slot(begin), k.slot(end), k.slot(mask)
        middle = k.multiply(k.add(begin, end), k.number(0.5))
        place, passes = k.slot(middle), k.slot(k.whole(0))
        near = k.multiply(k.intrinsic("fabs", k.subtract(end, begin)), k.number(NEAR))
        with k.forever() as found:
            x, now = k.get(place), k.get(waiting, k.mask)
            f, g = function(x)
            same = k.less(k.number(0.0), k.multiply(f, sign))
            k.set(low, k.select(same, x, k.get(low)))
            k.set(high, k.select(same, k.get(high), x))
            newton = k.subtract(x, k.divide(f, g))
            below, above = k.subtract(newton, k.get(low)), k.subtract(newton, k.get(high))
            inside = k.compare("ole", k.multiply(below, above), k.number(0.0))
            half = k.multiply(k.add(k.get(low), k.get(high)), k.number(0.5))
            following = k.select(now, k.select(inside, newton, half), x)
            k.set(place, following)
            far = k.less(near, k.intrinsic("fabs", k.subtract(following, x)))
            k.set(waiting, k.both(now, far))
            count = k.add(k.get(passes, WHOLE), k.whole(1))
            k.set(passes, count)
            k.leave(k.invert(k.any(k.get(waiting, k.mask))), found)
            k.leave(k.compare("sge", count, k.whole(NEWTON)), found)
        return k.get(place)

    def _changes(self, k: Kernel, before: Word, now: Word) -> Word:
        return k.less(k.multiply(before, now), k.number(0.0))

    def _widen(self, module: Module) -> None:
        """Extremes of joint j's angle and rate within the step x; a step of no length adds none."""
        scene, n = self.scene, self.scene.mechanism.n
        k = Kernel(module, "widen", (ADDRESS, WHOLE), "void")
        block, j = k.arguments
        x = scene.get(k, block, "x")
        width = k.whole(scene.order + 1)
        series = k.at(scene.at(k, block, "rate0_0"), k.multiply(j, width), k.numbers)
        q = k.load(k.at(scene.at(k, block, "q0"), j, k.numbers))
        always = k.compare("une", x, k.number(0.0))

        def widen(first: int, value: Word, mask: Word) -> None:
            for name, how in ((f"low{first}", "olt"), (f"high{first}", "ogt")):
                _widened(k, k.at(scene.at(k, block, name), j, k.numbers), value, mask, how)

        begin = k.number(0.0)
        before = k.load(series)
        before_slope = k.load(k.at(series, 1, k.numbers))
        for part in range(1, QUARTERS + 1):
            end = k.multiply(x, k.number(part / QUARTERS))
            turn, rate, slope, _ = self._values(k, series, end)
            widen(0, k.add(q, turn), always)
            widen(n, rate, always)
            turns = k.both(always, self._changes(k, before, rate))
            with k.when(k.any(turns)):
                place = self._root(
                    k, lambda x: self._values(k, series, x)[1:3], begin, end, before, turns
                )
                widen(0, k.add(q, self._values(k, series, place)[0]), turns)
            bends = k.both(always, self._changes(k, before_slope, slope))
            with k.when(k.any(bends)):
                place = self._root(
                    k, lambda x: self._values(k, series, x)[2:4], begin, end, before_slope, bends
                )
                widen(n, self._values(k, series, place)[1], bends)
            begin, before, before_slope = end, rate, slope
        k.done()

    def _cross(self, module: Module) -> None:
        """When |angle| of the link first exceeds pi, within the step x, where it has not yet."""
        scene = self.scene
        k, block = scene.kernel(module, "cross")
        items = _Kept(scene, k, block)
        get, put = items.get, items.put
        x, flip, pi, zero = get("x"), get("flip"), k.number(math.pi), k.number(0.0)
        series = scene.at(k, block, "link0_0")
        angle = k.add(get("angle"), self._alpha(k, block))
        moves = k.compare("une", x, zero)
        wanted = k.both(moves, k.compare("uno", flip, flip))
        most, power = k.intrinsic("fabs", angle), k.intrinsic("fabs", x)
        size = power
        for m in range(scene.order + 1):  # most steps cannot reach so far
            c = k.intrinsic("fabs", k.load(k.at(series, m, k.numbers)))
            most = k.add(most, k.multiply(c, power))
            power = k.multiply(power, size)
        wanted = k.both(wanted, k.invert(k.compare("ole", most, pi)))
        with k.when(k.any(wanted)):
            at_once = k.less(pi, k.intrinsic("fabs", angle))
            found = k.slot(k.select(at_once, zero, k.number(math.nan)))
            begin, before, turned = zero, k.load(series), zero
            for part in range(1, QUARTERS + 1):
                end = k.multiply(x, k.number(part / QUARTERS))
                turn, rate, *_ = self._values(k, series, end)
                reach, there = k.slot(end), k.slot(k.add(angle, turn))
                open = k.both(wanted, k.compare("uno", k.get(found), k.get(found)))
                turns = k.both(open, self._changes(k, before, rate))
                with k.when(k.any(turns)):  # it may go beyond and come back within the part
                    place = self._root(
                        k, lambda x: self._values(k, series, x)[1:3], begin, end, before, turns
                    )
                    furthest = k.add(angle, self._values(k, series, place)[0])
                    over = k.both(turns, k.less(pi, k.intrinsic("fabs", furthest)))
                    k.set(reach, k.select(over, place, k.get(reach)))
                    k.set(there, k.select(over, furthest, k.get(there)))
                hits = k.both(open, k.less(pi, k.intrinsic("fabs", k.get(there))))
                with k.when(k.any(hits)):
                    goal = k.subtract(k.intrinsic("copysign", pi, k.get(there)), angle)
                    sign = k.subtract(turned, goal)

                    def ahead(x: Word, goal: Word = goal) -> tuple[Word, Word]:
                        turn, rate, *_ = self._values(k, series, x)
                        return k.subtract(turn, goal), rate

                    place = self._root(k, ahead, begin, k.get(reach), sign, hits)
                    k.set(found, k.select(hits, place, k.get(found)))
                begin, before, turned = end, rate, turn
            when = k.add(get("t"), k.get(found))
            put("flip", k.select(wanted, when, flip))
        k.done()


def _widened(k: Kernel, place: Word, value: Word, mask: Word, how: str) -> None:
    """The item at a place, or the value where that is beyond it."""
    now = k.load(place)
    beyond = k.both(mask, k.compare(how, value, now))
    k.store(k.select(beyond, value, now), place)
