"""What a motion of a sweep leaves behind, kept in machine code along the way.

Energies are weighed at the steps' ends, angles and rates at the steps' quarters as well.  Where an
extreme or a flip may lie between these, the step's series is noted: no root is found in machine
code.

Numpy finds the roots of many notes at a time.  A rate is v(x) = sum_k v_k x^k over 0 <= x/h <= 1 (h
may be negative), its angle the integral. A step is looked at in QUARTERS parts: where v or its
derivative changes sign between two of them, the root is found by Newton's method within its
bracket, and the value there counts besides those at the parts' ends.  What turns twice within one
part may be missed.  A note has what is known at its part's ends: with it the first guess is so
near that one step of Newton's does for most.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.expression import Graph, Value
from robodyn.engines.formulas import anything, energies
from robodyn.mechanics.planar_model import Mechanism
from robodyn.runs.machine_motion import RUNNING, Observer, Status, aligned
from robodyn.runs.machine_steps import Items, Scene
from robodyn.tables.arrays import Array

KEPT = ("start", "off", "KE", "PE_low", "PE_high", "E_low", "E_high", "angle", "flip", "begun")
Values = tuple[Word, Word, Word, Word]  # integral, value, slope and bend of a series
# Steps that are noted, for numpy to find their roots: where an angle has an extreme, where a rate
# has one, and where the link may flip.  The whole numbers at the beginning: how many there are of
# each kind, up to how many another step may begin, the first lane of the vector under way, and how
# many there is room for.
ANGLE, RATE, LINK = KINDS = range(3)
MOST, LANE, ROOM, FIRST = 3, 4, 5, 8
LARGEST = 2**17  # numbers of a kind noted before roots are found: 1 MB, which caches hold
# From FIRST on stand the notes of each kind, item after item, each of all notes: these, then the
# coefficients of the rate.  `part` is that of QUARTERS, from 1; the value rises by `rise` from its
# begin to its end, and its slopes there are `first` and `last`; `start` is the angle as the step
# begins; `row` is that of the extremes.
HEAD = ("part", "start", "first", "last", "rise", "t", "x", "lane", "row")
GIVEN = 5  # of these, which the block has not


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
    """Results that a motion leaves behind."""

    def widen(self, low: str, high: str, value: Word, mask: Word) -> None:
        """Take a value into its extremes."""
        for name, how in ((low, "olt"), (high, "ogt")):
            _widened(self.k, self.scene.at(self.k, self.block, name), [value], mask, how)


class LaneObserver(Observer):
    """Observer of lanes; Python calls its kernels `begin` and `run`."""

    def __init__(self, scene: Scene, extremes: bool) -> None:
        self.scene, self.extremes = scene, extremes
        self.key = f"lanes {extremes}"

    def declare(self, scene: Scene, module: Module) -> None:
        self._weigh(module)
        self._begin(module)
        if self.extremes or scene.link >= 0:
            self._note(module)
        if self.extremes:
            self._extremes(module)
        if scene.link >= 0:
            self._flips(module)

    def begin(self, k: Kernel, block: Word, own: Word, leave: Callable[[Word], None]) -> None:
        most = k.load(k.at(own, MOST), WHOLE)
        for kind in KINDS:
            leave(k.compare("slt", most, k.load(k.at(own, kind), WHOLE)))

    def step(self, k: Kernel, block: Word, own: Word, taken: Word, take: Word, end: Word) -> None:
        items = _Kept(self.scene, k, block)
        get, length = items.get, k.subtract(end, items.get("t"))
        items.put("x", k.select(take, length, k.number(0.0)))
        n = self.scene.mechanism.n
        if self.extremes:
            with k.loop(k.whole(n)) as j:
                k.call("extremes", block, own, j)
        if self.scene.link >= 0:
            k.call("flips", block, own)
        k.call("energies", block)
        KE, PE = get("longest"), get("part")
        E = k.add(KE, PE)
        items.widen("PE_low", "PE_high", PE, take)
        items.widen("E_low", "E_high", E, take)
        work = get("to_work") if self.scene.work else k.number(0.0)
        off = k.intrinsic("fabs", k.subtract(k.subtract(E, work), get("start")))
        for name, value in (("KE", KE), ("off", off)):
            _widened(k, self.scene.at(k, block, name), [value], take, "ogt")
        if self.extremes:  # the states at the ends are closed, the series so to the tolerance
            for m, name in enumerate(self.scene.state[: 2 * n]):
                items.widen(f"low{m}", f"high{m}", get(f"to_{name}"), take)

    def finish(self, scene: Scene, module: Module) -> None:
        """run(block, notes, columns, stride, first, stop, budget): steps of lanes first to stop.

        The columns are those items that Python fills, stride doubles apart; it returns how many
        lanes could take more steps.  A lane that has taken none is begun.
        """
        k = Kernel(module, "run", (ADDRESS, ADDRESS, ADDRESS, WHOLE, WHOLE, WHOLE, WHOLE))
        block, notes, columns, stride, first, stop, budget = k.arguments
        waiting, count = k.slot(k.whole(0)), k.whole(len(scene.place))
        with k.loop(stop, first, k.lanes) as lane:
            with k.loop(count) as i:
                item = k.load(k.at(columns, k.add(k.multiply(i, stride), lane)))
                k.store(item, k.at(block, i, k.numbers))
            fresh = k.compare("oeq", scene.get(k, block, "begun"), k.number(0.0))
            with k.when(k.any(fresh)):
                k.call("begin", block)
                scene.put(k, block, "begun", k.number(1.0))
            k.store(lane, k.at(notes, LANE))
            k.result_of(WHOLE, "advance", block, budget, notes)
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
        for name, word in zip(("longest", "part"), segment.write(found), strict=True):
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
        KE, PE = get("longest"), get("part")
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

    def _values(self, k: Kernel, series: Word, x: Word, sizes: bool = False) -> Values:
        """Return turn, value, slope and bend of the series whose items begin at `series`.

        With `sizes`, of the sizes of its coefficients.
        """
        turn, value, slope, bend = (k.number(0.0) for _ in range(4))
        for m in reversed(range(self.scene.order + 1)):
            c = k.load(k.at(series, m, k.numbers))
            c = k.intrinsic("fabs", c) if sizes else c
            bend = k.add(k.multiply(bend, x), slope)
            slope = k.add(k.multiply(slope, x), value)
            value = k.add(k.multiply(value, x), c)
            turn = k.add(k.multiply(turn, x), k.multiply(c, k.number(1.0 / (m + 1))))
        return k.multiply(turn, x), value, slope, k.multiply(bend, k.number(2.0))

    def _parts(self, k: Kernel, series: Word, x: Word) -> list[Values]:
        """At the quarters of a step x, first at its beginning, there without the bend."""
        nothing = k.number(0.0)
        rate, slope = (k.load(k.at(series, m, k.numbers)) for m in range(2))
        begin = nothing, rate, slope, nothing
        ends = (k.multiply(x, k.number(part / QUARTERS)) for part in range(1, QUARTERS + 1))
        return [begin, *(self._values(k, series, end) for end in ends)]

    def _beyond(self, k: Kernel, bound: Word, x: Word) -> Word:
        """Return how far an extreme within a quarter may exceed the values at its ends.

        One end is nearer than an eighth of the step; `bound` bounds the second derivative.
        """
        return k.multiply(k.multiply(bound, k.number(1.0 / (8 * QUARTERS**2))), k.multiply(x, x))

    def _extremes(self, module: Module) -> None:
        """extremes(block, notes, j): of joint j's angle and rate within the step x.

        Its quarters' values are taken; a step is noted where more than these may be within one.  A
        step of no length adds none.
        """
        scene, n = self.scene, self.scene.mechanism.n
        k = Kernel(module, "extremes", (ADDRESS, ADDRESS, WHOLE), "void")
        block, notes, j = k.arguments
        x = scene.get(k, block, "x")
        width = k.whole(scene.order + 1)
        series = k.at(scene.at(k, block, "rate0_0"), k.multiply(j, width), k.numbers)
        q = k.load(k.at(scene.at(k, block, "q0"), j, k.numbers))
        always = k.compare("une", x, k.number(0.0))
        parts = self._parts(k, series, x)
        bounds = self._values(k, series, k.intrinsic("fabs", x), sizes=True)[2:]
        given, zero = k.room(k.numbers, GIVEN), k.number(0.0)
        k.store(q, k.at(given, HEAD.index("start"), k.numbers))
        for kind, bound in zip((ANGLE, RATE), bounds, strict=True):
            values = [part[1] if kind else k.add(q, part[0]) for part in parts]
            beyond = self._beyond(k, bound, x)
            low, high = (
                k.at(scene.at(k, block, f"{name}{kind * n}"), j, k.numbers)
                for name in ("low", "high")
            )
            _widened(k, low, values[1:], always, "olt")
            _widened(k, high, values[1:], always, "ogt")
            least, most = k.add(k.load(low), beyond), k.subtract(k.load(high), beyond)
            for part in range(QUARTERS):
                before, now = parts[part][kind + 1], parts[part + 1][kind + 1]
                turns = k.both(always, k.less(k.multiply(before, now), zero))
                may = k.all_lanes(False)
                for value in values[part : part + 2]:
                    outside = k.either(k.less(value, least), k.less(most, value))
                    may = k.either(may, outside)
                noted = k.both(turns, may)
                with k.when(k.any(noted)):
                    which = k.select(noted, k.number(1.0 + part), zero)
                    rise = k.subtract(values[part + 1], values[part])
                    told = {"part": which, "first": before, "last": now, "rise": rise}
                    for name, value in told.items():
                        k.store(value, k.at(given, HEAD.index(name), k.numbers))
                    row = k.add(j, k.whole(kind * n))
                    k.call("note", block, notes, k.whole(kind), given, row, series)
        k.done()

    def _flips(self, module: Module) -> None:
        """flips(block, notes): whether |angle| of the link first exceeds pi within the step x.

        A step is noted where it does or may do so.  Where it does for sure, its end stands for the
        time, and later ones do not matter.
        """
        scene = self.scene
        k = Kernel(module, "flips", (ADDRESS, ADDRESS), "void")
        block, notes = k.arguments
        items = _Kept(scene, k, block)
        get, put = items.get, items.put
        x, flip, pi, zero = get("x"), get("flip"), k.number(math.pi), k.number(0.0)
        series = scene.at(k, block, "link0_0")
        angle = k.add(get("angle"), self._alpha(k, block))
        size = k.intrinsic("fabs", x)
        wanted = k.both(k.compare("une", x, zero), k.compare("uno", flip, flip))
        reach = self._values(k, series, size, sizes=True)[0]  # most steps cannot go so far
        most = k.add(k.intrinsic("fabs", angle), reach)
        wanted = k.both(wanted, k.invert(k.compare("ole", most, pi)))
        with k.when(k.any(wanted)):
            parts = self._parts(k, series, x)
            values = [k.intrinsic("fabs", k.add(angle, part[0])) for part in parts]
            surely = k.less(pi, values[0])
            for value in values[1:]:
                surely = k.either(surely, k.less(pi, value))
            bound = self._values(k, series, size, sizes=True)[2]
            may, least = surely, k.subtract(pi, self._beyond(k, bound, x))
            for part in range(QUARTERS):  # it may go beyond and come back within one
                turns = k.less(k.multiply(parts[part][1], parts[part + 1][1]), zero)
                near = k.either(*(k.less(least, value) for value in values[part : part + 2]))
                may = k.either(may, k.both(turns, near))
            noted = k.both(wanted, may)
            with k.when(k.any(noted)):
                given = k.room(k.numbers, GIVEN)
                which = k.select(noted, k.number(1.0), zero)
                for name in HEAD[:GIVEN]:
                    value = {"part": which, "start": angle}.get(name, zero)
                    k.store(value, k.at(given, HEAD.index(name), k.numbers))
                k.call("note", block, notes, k.whole(LINK), given, k.whole(0), series)
            put("flip", k.select(k.both(wanted, surely), k.add(get("t"), x), flip))
        k.done()

    def _note(self, module: Module) -> None:
        """note(block, notes, kind, given, row, series): note the step of lanes whose part is not 0.

        See `HEAD`, whose first items are `given`.
        """
        scene, orders = self.scene, self.scene.order + 1
        k = Kernel(module, "note", (ADDRESS, ADDRESS, WHOLE, ADDRESS, WHOLE, ADDRESS), "void")
        block, notes, kind, given, row, series = k.arguments
        vectors = [k.at(given, i, k.numbers) for i in range(GIVEN)]
        vectors += [scene.at(k, block, name) for name in HEAD[GIVEN:-2]]
        lane, room = (k.load(k.at(notes, i), WHOLE) for i in (LANE, ROOM))
        all_items = k.multiply(room, k.whole(len(HEAD) + orders))
        begin = k.at(notes, k.add(k.multiply(kind, all_items), k.whole(FIRST)))
        with k.loop(k.whole(k.lanes)) as i:
            part = k.load(k.at(given, i), SCALAR)
            with k.when(k.compare("une", part, k.scalar(0.0))):
                count = k.load(k.at(notes, kind), WHOLE)
                values = [k.load(k.at(vector, i), SCALAR) for vector in vectors]
                values += [k.convert("sitofp", x, SCALAR) for x in (k.add(lane, i), row)]
                place, column = k.at(begin, count), k.at(series, i)
                for item, value in enumerate(values):
                    k.store(value, k.at(place, k.multiply(room, k.whole(item))))
                place = k.at(place, k.multiply(room, k.whole(len(HEAD))))
                with k.loop(k.whole(orders)) as m:
                    coefficient = k.load(k.at(column, m, k.numbers), SCALAR)
                    k.store(coefficient, k.at(place, k.multiply(room, m)))
                k.store(k.add(count, k.whole(1)), k.at(notes, kind))
        k.done()


def _widened(k: Kernel, place: Word, values: Sequence[Word], mask: Word, how: str) -> None:
    """The item at a place, or what of the values is most beyond it."""
    before = now = k.load(place)
    for value in values:
        now = k.select(k.compare(how, value, now), value, now)
    k.store(k.select(mask, now, before), place)


class Notes:
    """Steps of L lanes that are noted, and what is found in them: what lies between the quarters.

    It is kept apart, so that what is noted of a lane does not depend on when notes are taken.
    """

    def __init__(self, scene: Scene, lanes: int, L: int) -> None:
        n = self.n = scene.mechanism.n
        most, items = QUARTERS * n * lanes, len(HEAD) + scene.order + 1  # notes of a step
        room = LARGEST // items + most
        self.whole = aligned(FIRST + len(KINDS) * items * room)
        self.noted = self.whole[FIRST:].reshape(len(KINDS), items, room)
        self.counts = self.whole[:FIRST].view(np.int64)
        self.counts[MOST], self.counts[ROOM] = room - most, room
        self.low, self.high = np.full((2 * n, L), math.inf), np.full((2 * n, L), -math.inf)
        self.flip = np.full(L, math.nan)  # its size

    @property
    def full(self) -> bool:
        """Whether no lane can take a step before they are taken."""
        return bool(self.counts[: len(KINDS)].max() > self.counts[MOST])

    def take(self) -> None:
        """Find what is in them, for all at once, and make room."""
        for kind in KINDS:
            noted = self.noted[kind, :, : self.counts[kind]]
            self.counts[kind] = 0
            if noted.size:
                self._take(kind, dict(zip(HEAD, noted, strict=False)), noted[len(HEAD) :])

    def _take(self, kind: int, head: dict[str, Array], rates: Array) -> None:
        """Take the notes of a kind, with their items and coefficients (K, notes)."""
        lane = head["lane"].astype(int)
        if kind == LINK:
            flips = head["t"] + crossings(head["start"], rates, head["x"], math.pi)
            np.fmin.at(self.flip, lane, np.abs(flips))
            return
        quarter = head["x"] / QUARTERS
        begin, end = quarter * (head["part"] - 1.0), quarter * head["part"]
        series = integral(rates, head["start"]) if kind == ANGLE else rates
        _, values = turns(series, begin, end, head["first"], head["last"], head["rise"])
        place = head["row"].astype(int) * self.low.shape[1] + lane
        np.fmin.at(self.low.reshape(-1), place, values)  # quick with one index
        np.fmax.at(self.high.reshape(-1), place, values)

    def merge(self, columns: Array, place: Mapping[str, int]) -> None:
        """Take what was found into the items (items, L) of the lanes."""
        for name, choose, values in (
            ("low0", np.minimum, self.low),
            ("high0", np.maximum, self.high),
        ):
            rows = columns[place[name] : place[name] + 2 * self.n]
            choose(rows, values, out=rows)
        flip = columns[place["flip"]]
        flip[:] = np.fmin(np.abs(flip), self.flip) * columns[place["direction"]]


QUARTERS = 4
NEWTON = 40  # steps at most: a bracket shrinks by each, and the last few double the digits
NEAR = 1e-9  # part of a bracket: a Newton step below it leaves an error of its square
FLAT = 2e-4  # the same where the value is wanted, which errs by the cube of the step


def extremes(rates: Array, h: Array) -> tuple[Array, Array, Array, Array]:
    """Least and largest of the turn (from 0) and of the rate over steps h (B,), each (n, B).

    `rates` (K, n, B), K > 1, are the coefficients v_k.
    """
    begin, before = np.zeros(len(h)), (np.zeros_like(rates[0]), rates[0], rates[1])
    changes: list[list[Any]] = [[], []]  # of turns, of rates
    found = [np.zeros_like(rates[0])] * 2 + [rates[0]] * 2
    scaled, orders = rates * powers(h, len(rates))[:, None], np.arange(float(len(rates)))
    for part in range(1, QUARTERS + 1):
        end, u = h * (part / QUARTERS), ((part / QUARTERS) ** orders)[:, None, None]
        turn = end * sums(u / (orders + 1.0)[:, None, None], scaled)
        rate, slope = sums(u, scaled), sums(u * orders[:, None, None], scaled) / end
        for k, value in ((0, turn), (2, rate)):
            found[k : k + 2] = np.minimum(found[k], value), np.maximum(found[k + 1], value)
        now = turn, rate, slope
        for k in range(2):
            first, last = before[k + 1], now[k + 1]
            i, b = np.nonzero(first * last < 0.0)
            rise = now[k][i, b] - before[k][i, b]
            changes[k].append((i, b, begin[b], end[b], first[i, b], last[i, b], rise))
        begin, before = end, now
    for k, parts in enumerate(changes):
        i, b, *known = (np.concatenate(x) for x in zip(*parts, strict=True))
        series = rates[:, i, b]
        _, value = turns(series if k else integral(series, 0.0), *known)
        np.minimum.at(found[2 * k], (i, b), value)
        np.maximum.at(found[2 * k + 1], (i, b), value)
    return found[0], found[1], found[2], found[3]


def turns(
    series: Array, begin: Array, end: Array, first: Array, last: Array, rise: Array
) -> tuple[Array, Array]:
    """Return place and value of the extreme of each polynomial (K, B) between `begin` and `end`.

    Its slopes there, `first` and `last` (B,), differ in sign; its value rises by `rise`.  The
    quadratic slope with these data has a root near the extreme.
    """
    place, found, left = np.empty_like(begin), np.empty_like(begin), np.arange(len(begin))
    with np.errstate(all="ignore"):
        low, high, width, sign = begin, end, end - begin, np.sign(first)
        bow, least = 6.0 * rise / width - 3.0 * (first + last), FLAT * np.abs(width)
        steep = last - first + bow
        part = -2.0 * first / (steep - sign * np.sqrt(steep * steep + 4.0 * bow * first))
        x = begin + np.where((part >= 0.0) & (part <= 1.0), part, 0.5) * width
        for _ in range(NEWTON):
            value, slope, bend = with_bend(series, x)
            step = -slope / bend
            place[left], found[left] = x + step, value + 0.5 * slope * step
            (far,) = np.nonzero(~(np.abs(step) <= least))
            if not len(far):
                break
            series, left = series.take(far, axis=1), left[far]
            kept = x, low, high, sign, least, value, slope, step
            x, low, high, sign, least, value, slope, step = (each[far] for each in kept)
            place[left], found[left] = x, value  # where the steps should never end
            same, newton = slope * sign > 0.0, x + step
            low, high = np.where(same, x, low), np.where(same, high, x)
            inside = (newton - low) * (newton - high) <= 0.0
            x = np.where(inside, newton, 0.5 * (low + high))
    return place, found


def crossings(angle: Array, rates: Array, h: Array, limit: float) -> Array:
    """Return when |angle + turn| first exceeds `limit` within steps h, (B,); nan if never.

    `angle` (B,) is that at the begin of the steps, `rates` (K, B) the coefficients of its rate.
    """
    x = h * (np.arange(QUARTERS + 1.0) / QUARTERS)[:, None]
    series = integral(rates, angle)
    values, slopes = horner(series, x), horner(rates, x)
    reach, there, steep = (each[1:].copy() for each in (x, values, slopes))
    part, b = np.nonzero(slopes[:-1] * slopes[1:] < 0.0)  # it may go beyond and come back within
    ends = [each[at, b] for each in (x, slopes) for at in (part, part + 1)]
    ends.append(values[part + 1, b] - values[part, b])
    place, furthest = turns(series[:, b], *ends)
    over = np.abs(furthest) > limit
    part, b = part[over], b[over]
    reach[part, b], there[part, b], steep[part, b] = place[over], furthest[over], 0.0
    beyond, found = np.abs(there) > limit, np.full(len(h), np.nan)
    (b,) = np.nonzero(beyond.any(axis=0))
    part = beyond[:, b].argmax(axis=0)  # the first
    goal, series = np.sign(there[part, b]) * limit, series[:, b]
    series[0] -= goal
    ends = [each[part, b] for each in (x, reach, values, there, slopes, steep)]
    found[b] = roots(series, *ends[:2], *(value - goal for value in ends[2:4]), *ends[4:])
    found[np.abs(angle) > limit] = 0.0
    return found


def sums(a: Array, b: Array) -> Array:
    """The sums of a b (K, ..., B) over the first axis, the same however many lanes there are."""
    if b.shape[-1] == 1:  # numpy would add them up in another order
        return np.asarray(sums(a, b.repeat(2, axis=-1))[..., :1])
    return np.asarray(np.einsum("k...,k...->...", a, b))


def powers(x: Array, K: int) -> Array:
    """x^k (K, B) of x (B,)."""
    power = np.empty((K, len(x)))
    power[0] = 1.0
    for k in range(1, K):
        np.multiply(power[k - 1], x, out=power[k])
    return power


def derivative(series: Array) -> Array:
    """Coefficients of the derivative, along the first axis."""
    K = len(series)
    return series[1:] * np.arange(1.0, K).reshape(-1, *[1] * (series.ndim - 1))


def integral(series: Array, start: Array | float) -> Array:
    """Coefficients (K + 1, B) of the integral that begins at `start`, of those (K, B)."""
    found = np.empty((len(series) + 1, *series.shape[1:]))
    found[0] = start
    orders = np.arange(1.0, len(series) + 1.0).reshape(-1, *[1] * (series.ndim - 1))
    np.divide(series, orders, out=found[1:])
    return found


def roots(
    series: Array, begin: Array, end: Array, first: Array, last: Array, steep: Array, at_end: Array
) -> Array:
    """A root of each polynomial (K, B) between `begin` and `end`, (B,).

    There its values are `first` and `last`, which differ in sign, its slopes `steep` and `at_end`.
    Newton's method ends with a step below NEAR of the bracket.
    """
    found = np.empty_like(begin)
    with np.errstate(all="ignore"):
        low, high, least, sign = begin, end, NEAR * np.abs(end - begin), np.sign(first)
        x = begin + cubic_root(first, last, steep, at_end, end - begin)
        x = np.where((x - begin) * (x - end) <= 0.0, x, 0.5 * (begin + end))
        left = np.arange(len(begin))  # each by itself: no root depends on the others
        for _ in range(NEWTON):
            value, steep = with_slope(series, x)
            same = value * sign > 0.0
            low, high = np.where(same, x, low), np.where(same, high, x)
            newton = x - value / steep
            inside = (newton - low) * (newton - high) <= 0.0
            x, before = np.where(inside, newton, 0.5 * (low + high)), x
            found[left] = x
            (far,) = np.nonzero(~(np.abs(x - before) <= least))
            if not len(far):
                break
            if len(far) < len(x):
                series, left = series.take(far, axis=1), left[far]
                x, low, high, sign, least = (each[far] for each in (x, low, high, sign, least))
    return found


def cubic_root(first: Array, last: Array, steep: Array, at_end: Array, width: Array) -> Array:
    """About where the cubic with values `first` and `last` and such slopes vanishes in a width."""
    c, rise = steep * width, last - first
    a, b = c + at_end * width - 2.0 * rise, 3.0 * rise - 2.0 * c - at_end * width
    s = -first / rise
    for _ in range(2):
        s = s - (((a * s + b) * s + c) * s + first) / ((3.0 * a * s + 2.0 * b) * s + c)
    return s * width


def horner(series: Array, x: Array) -> Array:
    """The values of polynomials (K, B) at x (..., B)."""
    total: Array = np.zeros_like(x) + series[-1]
    for coefficient in series[-2::-1]:
        total *= x
        total += coefficient
    return total


def with_slope(series: Array, x: Array) -> tuple[Array, Array]:
    """The values of polynomials (K, B) at x (B,), and their derivatives."""
    total, slope = series[-1].copy(), np.zeros_like(x)
    for coefficient in series[-2::-1]:
        slope *= x
        slope += total
        total *= x
        total += coefficient
    return total, slope


def with_bend(series: Array, x: Array) -> tuple[Array, Array, Array]:
    """The values of polynomials (K, B) at x (B,), and their first two derivatives."""
    total, slope, bend = series[-1].copy(), np.zeros_like(x), np.zeros_like(x)
    for coefficient in series[-2::-1]:
        bend *= x
        bend += slope
        slope *= x
        slope += total
        total *= x
        total += coefficient
    return total, slope, 2.0 * bend
