"""What a motion of a sweep leaves behind, kept in machine code along the way.

Energies are weighed at the steps' ends, angles and rates at the steps' quarters as well.  Where an
extreme or a flip may lie between these, the step's series is noted: no root is found in machine
code.

Numpy finds the roots of many notes at a time.  A rate is v(x) = sum_k v_k x^k over 0 <= x/h <= 1 (h
may be negative), its angle the integral. A step is looked at in QUARTERS parts: where v or its
derivative changes sign between two of them, the root is found by Newton's method within its
bracket, and the value there counts besides those at the parts' ends.  What turns twice within one
part may be missed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.expression import Graph, Value
from robodyn.engines.formulas import anything, energies
from robodyn.engines.machine_motion import RUNNING, Observer, Status, aligned
from robodyn.engines.machine_steps import Items, Scene
from robodyn.mechanics.planar_model import Mechanism
from robodyn.tables.arrays import Array

Indices = NDArray[np.intp]
KEPT = ("start", "off", "KE", "PE_low", "PE_high", "E_low", "E_high", "angle", "flip", "begun")
Values = tuple[Word, Word, Word, Word]  # integral, value, slope and bend of a series
# Steps that are noted, for numpy to find their roots.  The whole numbers at the beginning: how many
# there are, up to how many another step may begin, and the first lane of the vector under way.
ROOM, LANE, FIRST = 1, 2, 8
LARGEST = 2**17  # numbers noted before roots are found: 1 MB, which caches hold
# From item FIRST on stand the notes: these items, then the coefficients of the rate.  `what` is of
# a joint bits, first those of quarters where its angle has an extreme, then of its rate; `start` is
# the angle as the step begins; `joint` is n for the link that may flip.
HEAD = ("what", "t", "x", "start", "lane", "joint")


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
            self._extremes(module)
        if scene.link >= 0:
            self._flips(module)

    def begin(self, k: Kernel, block: Word, own: Word, leave: Callable[[Word], None]) -> None:
        leave(k.compare("slt", k.load(k.at(own, ROOM), WHOLE), k.load(own, WHOLE)))

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

    def _values(self, k: Kernel, series: Word, x: Word, sizes: bool = False) -> Values:
        """Of the series whose items begin there; `sizes`: of the sizes of its coefficients."""
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
        """How far an extreme within a quarter may be beyond the ends of that.

        One of them is nearer than an eighth of the step; `bound` is one of the second derivative.
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
        what = k.number(0.0)
        for kind, bound in enumerate(bounds):
            values = [part[1] if kind else k.add(q, part[0]) for part in parts]
            low, high = (
                k.at(scene.at(k, block, f"{name}{kind * n}"), j, k.numbers)
                for name in ("low", "high")
            )
            for value in values[1:]:
                _widened(k, low, value, always, "olt")
                _widened(k, high, value, always, "ogt")
            beyond = self._beyond(k, bound, x)
            least, most = k.add(k.load(low), beyond), k.subtract(k.load(high), beyond)
            for part in range(QUARTERS):
                before, now = parts[part][kind + 1], parts[part + 1][kind + 1]
                turns = k.both(always, k.less(k.multiply(before, now), k.number(0.0)))
                may = k.all_lanes(False)
                for value in values[part : part + 2]:
                    outside = k.either(k.less(value, least), k.less(most, value))
                    may = k.either(may, outside)
                bit = k.number(2.0 ** (QUARTERS * kind + part))
                what = k.add(what, k.select(k.both(turns, may), bit, k.number(0.0)))
        self._note(k, block, notes, what, q, j, series)
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
            what = k.select(k.both(wanted, may), k.number(1.0), zero)
            self._note(k, block, notes, what, angle, k.whole(scene.mechanism.n), series)
            put("flip", k.select(k.both(wanted, surely), k.add(get("t"), x), flip))
        k.done()

    def _note(
        self, k: Kernel, block: Word, notes: Word, what: Word, start: Word, of: Word, series: Word
    ) -> None:
        """Note the step of each lane where `what` is not 0; see `HEAD`."""
        none, orders = k.scalar(0.0), self.scene.order + 1
        with k.when(k.any(k.compare("une", what, k.number(0.0)))):
            given = [k.slot(what), *(self.scene.at(k, block, name) for name in ("t", "x"))]
            given.append(k.slot(start))
            first = k.load(k.at(notes, LANE), WHOLE)
            with k.loop(k.whole(k.lanes)) as i:
                values = [k.load(k.at(vector, i), SCALAR) for vector in given]
                with k.when(k.compare("une", values[0], none)):
                    count = k.load(notes, WHOLE)
                    size = k.whole(len(HEAD) + orders)
                    place = k.at(notes, k.add(k.multiply(count, size), k.whole(FIRST)))
                    whole = (k.convert("sitofp", x, SCALAR) for x in (k.add(first, i), of))
                    for item, value in enumerate((*values, *whole)):
                        k.store(value, k.at(place, item))
                    place, column = k.at(place, len(HEAD)), k.at(series, i)
                    with k.loop(k.whole(orders)) as m:
                        coefficient = k.load(k.at(column, m, k.numbers), SCALAR)
                        k.store(coefficient, k.at(place, m))
                    k.store(k.add(count, k.whole(1)), notes)


def _widened(k: Kernel, place: Word, value: Word, mask: Word, how: str) -> None:
    """The item at a place, or the value where that is beyond it."""
    now = k.load(place)
    beyond = k.both(mask, k.compare(how, value, now))
    k.store(k.select(beyond, value, now), place)


class Notes:
    """Steps of L lanes that are noted, and what is found in them: what lies between the quarters.

    It is kept apart, so that what is noted of a lane does not depend on when notes are taken.
    """

    def __init__(self, scene: Scene, lanes: int, L: int) -> None:
        self.n, self.most = scene.mechanism.n, (scene.mechanism.n + 1) * lanes
        n, items = self.n, len(HEAD) + scene.order + 1
        room = max(LARGEST // items, self.most)
        self.whole = aligned(FIRST + room * items)
        self.noted = self.whole[FIRST:].reshape(room, items)
        self.counts = self.whole[:FIRST].view(np.int64)
        self.counts[ROOM] = room - self.most
        self.low, self.high = np.full((2 * n, L), math.inf), np.full((2 * n, L), -math.inf)
        self.flip = np.full(L, math.nan)  # its size

    @property
    def full(self) -> bool:
        """Whether no lane can take a step before they are taken."""
        return bool(self.counts[0] > self.counts[ROOM])

    def take(self) -> None:
        """Find what is in them, for all at once, and make room."""
        noted = self.noted[: self.counts[0]]
        self.counts[0] = 0
        what, *_, joint = noted[:, : len(HEAD)].T
        bits, of_link = what.astype(np.uint8), joint == self.n
        if of_link.any():
            head, rates = self._columns(noted, np.flatnonzero(of_link))
            flips = head["t"] + crossings(head["start"], rates, head["x"], math.pi)
            np.fmin.at(self.flip, head["lane"].astype(int), np.abs(flips))
            bits[of_link] = 0
        for kind in range(2):
            masks = (1 << np.arange(QUARTERS) << (QUARTERS * kind)).astype(np.uint8)
            part, note = np.nonzero(bits & masks[:, None])
            head, rates = self._columns(noted, note)
            quarter = head["x"] / QUARTERS
            values = turning_values(rates, quarter * part, quarter * (part + 1), kind == 1)
            if kind == 0:
                values += head["start"]
            row = head["joint"].astype(int) + self.n * kind
            place = row * self.low.shape[1] + head["lane"].astype(int)
            np.fmin.at(self.low.reshape(-1), place, values)  # quick with one index
            np.fmax.at(self.high.reshape(-1), place, values)

    def _columns(self, noted: Array, note: Indices) -> tuple[dict[str, Array], Array]:
        """The items of these notes, and their series (K, notes)."""
        chosen = noted.take(note, axis=0).T
        head = dict(zip(HEAD, chosen[: len(HEAD)].copy(), strict=True))
        return head, np.ascontiguousarray(chosen[len(HEAD) :])

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
FLAT = 1e-5  # the same where the value is wanted: an extreme's has the square of the place's error


def extremes(rates: Array, h: Array) -> tuple[Array, Array, Array, Array]:
    """Least and largest of the turn (from 0) and of the rate over steps h (B,), each (n, B).

    `rates` (K, n, B), K > 1, are the coefficients v_k.
    """
    begin, before = np.zeros(len(h)), (rates[0], rates[1])
    changes: list[list[Any]] = [[], []]  # of turns, of rates
    found = [np.zeros_like(rates[0])] * 2 + [rates[0]] * 2
    scaled, orders = rates * powers(h, len(rates))[:, None], np.arange(float(len(rates)))
    for part in range(1, QUARTERS + 1):
        end, u = h * (part / QUARTERS), ((part / QUARTERS) ** orders)[:, None, None]
        turn = end * sums(u / (orders + 1.0)[:, None, None], scaled)
        rate, slope = sums(u, scaled), sums(u * orders[:, None, None], scaled) / end
        for k, value in ((0, turn), (2, rate)):
            found[k : k + 2] = np.minimum(found[k], value), np.maximum(found[k + 1], value)
        for k, (first, last) in enumerate(zip(before, (rate, slope), strict=True)):
            i, b = np.nonzero(first * last < 0.0)
            changes[k].append((i, b, begin[b], end[b]))
        begin, before = end, (rate, slope)
    for k, parts in enumerate(changes):
        i, b, begin, end = (np.concatenate(x) for x in zip(*parts, strict=True))
        value = turning_values(rates[:, i, b], begin, end, of_rate=k == 1)
        np.minimum.at(found[2 * k], (i, b), value)
        np.maximum.at(found[2 * k + 1], (i, b), value)
    return found[0], found[1], found[2], found[3]


def turning_values(rates: Array, begin: Array, end: Array, of_rate: bool) -> Array:
    """The turn or the rate where it has an extreme between `begin` and `end`, each (B,).

    `rates` (K, B); the derivative of what is meant has another sign at `end` than at `begin`.
    """
    if of_rate:
        return horner(rates, roots(derivative(rates), begin, end, FLAT))
    x = roots(rates, begin, end, FLAT)
    return x * horner(integral(rates), x)


def crossings(angle: Array, rates: Array, h: Array, limit: float) -> Array:
    """Where |angle + turn| first exceeds `limit` within steps h, (B,); nan where it does not.

    `angle` (B,) is that at the steps' begin, `rates` (K, B) the coefficients of its rate.
    """
    x = h * (np.arange(QUARTERS + 1.0) / QUARTERS)[:, None]
    turns = integral(rates)
    there, rate = angle + x * horner(turns, x), horner(rates, x)
    reach, there = x[1:].copy(), there[1:]
    part, b = np.nonzero(rate[:-1] * rate[1:] < 0.0)  # it may go beyond and come back within
    within = roots(rates[:, b], x[part, b], x[part + 1, b])
    furthest = angle[b] + within * horner(turns[:, b], within)
    over = np.abs(furthest) > limit
    part, b = part[over], b[over]
    reach[part, b], there[part, b] = within[over], furthest[over]
    beyond, found = np.abs(there) > limit, np.full(len(h), np.nan)
    (b,) = np.nonzero(beyond.any(axis=0))
    part = beyond[:, b].argmax(axis=0)  # the first
    goal = np.sign(there[part, b]) * limit - angle[b]
    found[b] = roots(np.concatenate([-goal[None], turns[:, b]]), x[part, b], reach[part, b])
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


def integral(series: Array) -> Array:
    """Coefficients of the integral less its constant, along the first axis."""
    K = len(series)
    return series / np.arange(1.0, K + 1.0).reshape(-1, *[1] * (series.ndim - 1))


def roots(series: Array, begin: Array, end: Array, near: float = NEAR) -> Array:
    """A root of each polynomial (K, B) between `begin` and `end`, where its sign changes, (B,).

    Newton's method ends with a step below `near` of the bracket.
    """
    found = np.empty_like(begin)
    with np.errstate(all="ignore"):
        low, high, least = begin, end, near * np.abs(end - begin)
        first, last = horner(series, begin), horner(series, end)
        sign, x = np.sign(first), begin - first * (end - begin) / (last - first)
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
