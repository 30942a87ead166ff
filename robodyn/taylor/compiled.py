"""The Taylor-series engine in machine code: many steps of one motion in one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from itertools import accumulate
from operator import is_not
from typing import Any, NamedTuple

import numpy as np

from robodyn.dynamics.dense_dynamics import elimination_is_safe
from robodyn.engines import machine, machine_motion
from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Word
from robodyn.engines.machine_motion import RUNNING, Loaded, Observer
from robodyn.engines.machine_steps import Scene
from robodyn.errors import InputError
from robodyn.events.told import Found
from robodyn.loops.closing import loop_terms, regular_rank
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.torque_rows import linear_piece
from robodyn.tables.arrays import Array
from robodyn.taylor import STEPS, Chunk, Forms, NoCodeError, Status, best_order
from robodyn.taylor.step_boxes import Kept, terms_of
from robodyn.taylor.watched_code import FOUND, ROOM, WATCH, ZERO, looks

LARGEST = 1500  # entries of A and P up to which the code is made in some s
ROWS = 16384  # of one call: no step begins when there are more
# what the observer is told: addresses, of the functions `box` and `look` too, how many times, rows
# so far, whether boxes and series are kept, whether functions are watched
TABLE = (
    "times", "rows", "ends", "states", "boxes", "series", "watch", "box", "look",
    "count", "given", "keeps", "watches",
)  # fmt: skip
LOOKS = slice(TABLE.index("box"), TABLE.index("count"))


class Rows(Observer):
    """Keeps every step's end, its series where asked to, and rows at given times; of one lane."""

    key = "rows " + " ".join(TABLE)

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def begin(self, k: Kernel, block: Word, own: Word, leave: Callable[[Word], None]) -> None:
        watch = self._told(k, own, "watch")
        leave(k.compare("sge", k.load(k.at(watch, WATCH.index("unsure")), WHOLE), k.whole(1)))
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
            box = k.at(self._told(k, own, "boxes"), k.multiply(taken, k.whole(2 * turns)))
            k.line(f"call void {self._told(k, own, 'box').text}({block}, {end}, {there}, {box})")
            self._again(k, there, to)
        with k.when(k.compare("sge", self._told(k, own, "watches"), k.whole(1))):
            watch = self._told(k, own, "watch")
            k.line(f"call void {self._told(k, own, 'look').text}({block}, {watch}, {there}, {end})")
            self._again(k, there, to)
        with k.forever() as done:
            given = self._told(k, own, "given")
            k.leave(k.compare("sge", given, self._told(k, own, "count")), done)
            time = k.load(k.at(self._told(k, own, "times"), given), SCALAR)
            ahead = k.multiply(k.subtract(time, end), direction)
            k.leave(k.less(k.number(0.0), ahead), done)
            scene.put(k, block, "x", k.subtract(time, begin))
            k.line(f"call void @evaluate({block})")
            if scene.closes:
                k.line(f"call void @close({block})")
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


class _Ready(NamedTuple):
    """A scene, its code, and a block with its numbers, at an address."""

    scene: Scene
    code: Loaded
    block: Array
    address: int = 0


def _ready(
    mechanism: Mechanism,
    actuation: Actuation,
    order: int,
    held: tuple[float, ...] | None,
    options: tuple[bool, bool, str],
    tolerances: tuple[float, float],
) -> _Ready:
    work, project, family = options
    scene = Scene(mechanism, actuation, order, work=work, closes=project, held=held)
    code = machine_motion.compile(scene, Rows(scene), 1, family)
    if code is None:
        raise NoCodeError("no machine code can be made")
    block = code.block()
    scene.fill(block, *tolerances)
    return _Ready(scene, code, block)


@lru_cache(maxsize=64)
def _kept(mechanism: Mechanism, constants: tuple[float, ...] | None, *rest: Any) -> _Ready:
    """The same of constant torques, or of those that are linear between kinks."""
    return _ready(mechanism, Actuation(constants, linear=constants is None), *rest)


class CompiledEngine:
    """Steps of the Taylor series in machine code (`taylor.Engine`), of any torques that have one.

    Tolerances are those of angles (rad) and rates (rad/s) over one step.  With `work` states have
    the work done appended; without `project` closures are left to drift.  Raises NoCodeError where
    there is no machine code or a torque has no series, and so does `advance`.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        actuation: Actuation,
        *,
        rtol: float = 1e-9,
        atol: float = 1e-9,
        order: int | None = None,
        project: bool = True,
        work: bool = False,
        family: str = "",
    ) -> None:
        self.mechanism, self.actuation = mechanism, actuation
        self.order = best_order(max(rtol, atol)) if order is None else order
        self._options, self._tolerances = (work, project, family), (float(rtol), float(atol))
        self._blocks: dict[tuple[float, ...] | None, _Ready] = {}
        self._room = np.empty(0)  # where machine code finds times, and leaves what it makes
        self._views: tuple[Any, ...] = ((),)
        self._last = 0.0, np.zeros(0), 0.0  # t and y where the last step began, and its end
        self.keeps, self.most = False, STEPS
        self.forms: Forms | None = None
        self._linear, self._forms = list[Array](), np.empty((0, 0))  # forms, and with signs
        self._watch = np.zeros(len(WATCH), np.int64)
        self._at_watch = self._watch.ctypes.data
        if not serves(mechanism):
            raise NoCodeError("the mechanism is too large, or its M or Psi singular everywhere")
        if not machine.available():
            raise NoCodeError("needs the extra `fast`")
        self._made(None if actuation.pieces is None else actuation.pieces.at(0.0))

    def _made(self, held: tuple[float, ...] | None) -> _Ready:
        """What is ready for the torques as the switches of an expression stand; its block is own.

        Raises NoCodeError where there can be no code.
        """
        found = self._blocks.get(held)
        if found is None:
            given = self.actuation
            rest = self.order, held, self._options, self._tolerances
            try:
                if given.constants is not None or given.linear:  # numbers tell all of it
                    found = _kept(self.mechanism, given.constants, *rest)
                else:
                    found = _ready(self.mechanism, given, *rest)
            except (ZeroDivisionError, InputError) as error:
                raise NoCodeError("no state has a series") from error
            block = found.code.block()
            block[:] = found.block
            found = self._blocks[held] = _Ready(found.scene, found.code, block, block.ctypes.data)
        return found

    @cached_property
    def _zeros(self) -> Array:
        """Where machine code leaves zeros."""
        return np.empty((ROOM, len(ZERO) + 2 * self.mechanism.n))

    @cached_property
    def _torques(self) -> Callable[[float, Sequence[float]], Sequence[float]]:
        return self.actuation.function(self.mechanism.n)

    def advance(self, t: float, y: Array, bound: float, times: Array, steps: int) -> Chunk:
        """Up to `steps` steps from (t, y) towards `bound`; rows at `times` on the way.

        y is (q, qd) in joint coordinates, with the work done (J) appended where it is wanted.
        `times` lie strictly after t in the direction of `bound`, in that order, up to `bound`.
        The step in which they run out is the last.
        """
        chunk = None
        if self.keeps and self.forms is not None:
            chunk = self._watched(self.forms, t, y, bound, times, steps)
        if chunk is None:
            chunk = self._advance(t, y, bound, times, steps, self.keeps)
        if count := len(chunk.t):
            begun = (float(chunk.t[-2]), chunk.y[-2]) if count > 1 else (t, y)
            self._last = *begun, float(chunk.t[-1])
        return chunk

    def _watched(
        self, forms: Forms, t: float, y: Array, bound: float, times: Array, steps: int
    ) -> Chunk | None:
        """The same, in which the code finds events itself; None where it is unsure of one."""
        watch, (linear, signs) = self._watch, forms
        if len(linear) != len(self._linear) or any(map(is_not, linear, self._linear)):
            self._linear = linear
            self._forms = np.pad(linear, ((0, 0), (0, 1)))
            watch[:FOUND] = self._forms.ctypes.data, self._zeros.ctypes.data, len(linear)
        self._forms[:, -1] = signs
        watch[FOUND] = 0
        made = self._advance(t, y, bound, times, steps, watches=True)
        return made if made.kept is not None else None

    def _found(self) -> Found | None:
        count, unsure = self._watch[FOUND:].tolist()
        self._watch[-1] = 0  # or no later call takes a step
        after = list(map(int, self._forms[:, -1].tolist()))
        return None if unsure else Found(self._zeros[:count].copy(), after)

    def within(self, times: Array) -> Array:
        """The states (k, N) at times (k,) in the last step, made once more for them."""
        t, y, end = self._last
        return self._advance(t, y, end, times, 1).row_y

    def dense(self, t: float, y: Array, end: float) -> Callable[[Array], Array]:
        """See `Engine`: the step is made once more for each call."""
        forward = 1.0 if end > t else -1.0

        def states(times: Array) -> Array:
            after = (times - t) * forward > 0.0
            rows = np.broadcast_to(y, (len(times), len(y))).copy()
            rows[after] = self._advance(t, y, end, times[after], 1).row_y
            return rows

        return states

    def closed(self, rows: Array) -> Array:
        """See `Engine`."""
        scene, code, block, address = next(iter(self._blocks.values()))  # they close alike
        if code.close is not None:
            first = scene.place["to_q0"]
            there = block[first : first + rows.shape[1]]
            for row in rows:
                there[:] = row
                code.close(address)
                row[:] = there
        return rows

    def _advance(
        self,
        t: float,
        y: Array,
        bound: float,
        times: Array,
        steps: int,
        keeps: bool = False,
        watches: bool = False,
    ) -> Chunk:
        pieces = self.actuation.pieces
        scene, code, block, address = self._made(None if pieces is None else pieces.at(t))
        N, place = len(y), scene.place
        block[:N] = y
        block[N : 2 * N] = y
        direction = 1.0 if bound >= t else -1.0
        status = Status.REACHED if t == bound else RUNNING
        begin = place["t"]
        block[begin : begin + 5] = t, bound, direction, status, 0.0
        if scene.linear:
            n, base = self.mechanism.n, place["base0"]
            values, slopes = linear_piece(self.actuation, self._torques, t, y.tolist(), direction)
            block[place["base_t"]] = t
            block[base : base + 2 * n] = [*values, *slopes]
        if code.close is not None and status == RUNNING:  # where another engine leads across
            code.close(address)
            if not block[place["quality"]] >= block[place["suspect"]]:
                block[place["status"]] = Status.SINGULAR
        layout = len(times), N, steps, keeps, watches
        _, at, table, asked, rows, ends, states, boxes, series = self._laid(layout)
        table[TABLE.index("given")] = 0
        if keeps or watches:
            table[LOOKS] = looks(scene, code.code)
        asked[:] = times
        code.advance(address, steps, at)
        taken, given = int(block[place["steps"]]), int(table[TABLE.index("given")])
        status = block[place["status"]]
        found = Status.FULL if status == RUNNING else Status(int(status))
        kept: Kept | Found | None = self._found() if watches else None
        if keeps:
            kept = Kept(boxes[:taken], lambda at, h: terms_of(series[at].T, h))
        made = ends[:taken].copy(), states[:taken].copy(), times[:given], rows[:given].copy()
        return Chunk(*made, found, kept)

    def _laid(self, layout: tuple[int, int, int, bool, bool]) -> tuple[Any, ...]:
        """Where the observer's table is, it, and the times, rows, ends, states, and series."""
        if layout == self._views[0]:
            return self._views
        wanted, N, steps, keeps, _ = layout
        wide, orders = 2 * self.mechanism.n, self.order + 2
        turns = steps * wide * keeps
        sizes = len(TABLE), wanted, wanted * N, steps, steps * N, 2 * turns, turns * orders
        a, b, c, d, e, f, end = accumulate(sizes)
        if len(self._room) < end:
            self._room = np.empty(end)
        room, at = self._room, self._room.ctypes.data
        table = room[:a].view(np.int64)
        table[:6] = [at + 8 * x for x in (a, b, c, d, e, f)]
        table[6:] = self._at_watch, 0, 0, wanted, 0, *layout[3:]
        boxes, series = room[e:f].reshape(-1, 2, wide), room[f:end]
        parts = room[a:b], room[b:c].reshape(wanted, N), room[c:d], room[d:e].reshape(steps, N)
        self._views = layout, at, table, *parts, boxes, series.reshape(-1, orders, wide // 2, 2)
        return self._views


@lru_cache(maxsize=64)
def serves(mechanism: Mechanism) -> bool:
    """Whether code of this length is worth it, and M and Psi are regular but at single states."""
    if mechanism.switches:  # each of its modes is served for itself
        return False
    if loop_terms(mechanism) > LARGEST or not elimination_is_safe(mechanism):
        return False
    return not mechanism.rows or regular_rank(mechanism) == len(mechanism.rows)
