"""The Taylor-series engine in machine code: many steps of one motion in one call.

The series of a planar linkage costs a few convolutions per order and link; see `engines/series.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property, lru_cache
from itertools import accumulate
from struct import Struct
from typing import Any, NamedTuple

import numpy as np

from robodyn.dynamics.dense_dynamics import elimination_is_safe
from robodyn.elements.contacts import Mode
from robodyn.engines import machine
from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Word
from robodyn.engines.expansion import MotionProgram
from robodyn.errors import InputError, RobodynError
from robodyn.loops.closing import loop_terms, regular_rank
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode
from robodyn.mechanics.placed import relative_matrix
from robodyn.mechanics.torque_rows import linear_piece
from robodyn.runs import machine_motion
from robodyn.runs.machine_motion import RUNNING, Loaded, Observer, Status
from robodyn.runs.machine_steps import Scene
from robodyn.tables.arrays import Array, Complex

END: Array = np.ones(1)  # of a step, the part that is all


def terms_of(parts: Array, h: Array) -> Complex:
    """Return z_k h^k for k > 0, (n, p, m), from rho and theta in `parts` (2, n, p + 1, m).

    h (m,) are the steps.
    """
    most, k = parts.shape[2] - 1, 1
    powers = np.empty((most, len(h)))
    powers[0] = h
    while k < most:
        upto = min(2 * k, most)
        np.multiply(powers[: upto - k], powers[k - 1], out=powers[k:upto])
        k = upto
    terms = np.empty((len(parts[0]), *powers.shape), complex)  # steps side by side: that is fast
    np.multiply(parts[0, :, 1:], powers, out=terms.real)
    np.multiply(parts[1, :, 1:], powers, out=terms.imag)
    return terms


def states_along(mechanism: Mechanism, y: Array, terms: Complex, h: Array, parts: Array) -> Array:
    """Return q, qd (m, k, 2n) at fractions `parts` (k,) of steps h (m,) from states y.

    y is (m, 2n or more), `terms` as `terms_of` returns them.  States close only as far as the
    series do.  All steps share the same fractions, which makes this faster than `states_at`.
    """
    n, slides, k = mechanism.n, list(mechanism.slides), len(parts)
    sums = _weights(terms.shape[1], parts.tobytes()) @ terms
    turn, slope = sums[:, :k], sums[:, k:]
    states = np.empty((2 * n, k, len(h)))
    way, rates = states[:n], states[n:]
    if slides:
        moved = sums.imag[slides]
    turn += 1.0
    np.arctan2(turn.imag, turn.real, out=way)
    slope /= turn
    rates[:] = slope.imag
    if slides:
        way[slides], rates[slides] = moved[:, :k], moved[:, k:]
    rates /= h
    if n > 1:
        both = states.reshape(2, n, -1)
        np.matmul(relative_matrix(mechanism), both.copy(), out=both)
    way += y[:, None].T[:n]
    return states.T


def states_at(mechanism: Mechanism, y: Array, terms: Complex, x: Array, part: Array) -> Array:
    """Return q, qd (m, 2n) at one time x (m,) > 0 after each state y, from `terms`.

    `part` (m,) is x as a fraction of the step.  States close only as far as the series do.
    """
    powers = np.empty(terms.shape[1:])
    powers[:] = part
    np.multiply.accumulate(powers, out=powers)
    return states_along(mechanism, y, terms * powers, x, END)[:, 0]


@lru_cache(maxsize=64)
def _orders(count: int) -> Array:
    return np.arange(1.0, count + 1.0)[:, None]


@lru_cache(maxsize=64)
def _weights(count: int, parts: bytes) -> Complex:
    """Return weights that sum terms, and their slopes, at fractions `parts` of a step."""
    orders, at = _orders(count)[:, 0], np.frombuffer(parts)[:, None]
    return np.concatenate([at**orders, orders * at ** (orders - 1.0)]).astype(complex)


class Chunk(NamedTuple):
    """Steps that end at t (m,) in states y (m, N), and rows at output times (k,), (k, N).

    y = (q, qd) in joint coordinates, followed by the work of torques less dampers (J) if requested.
    `terms` (n, p, m) are z_k h^k for k > 0 of the steps h, if requested.
    """

    t: Array
    y: Array
    row_t: Array
    row_y: Array
    status: Status
    terms: Complex | None = None


STEPS = 128  # at a time, at first: between them the run can be watched and interrupted
ROWS = 16384  # of one call: no step begins when there are more
# what the observer is told: addresses, how many times, rows so far, whether series are kept
TABLE = ("times", "rows", "ends", "states", "series", "count", "given", "keeps")
ASKED, GIVEN = TABLE.index("count"), TABLE.index("given")  # what each call tells anew begins there
MOST_STEPS = 4096  # of a call
ROOMS = 4  # of one scene that are left for further runs
WORK = 200_000  # links times orders times steps of a call, which takes some 20 ms
LARGEST = 1500  # entries of A and P up to which the code is made in some s
_BEGUN, _ASKED = Struct("5d").pack_into, Struct("3q").pack_into  # faster than a slice of an array
_STATUS = {RUNNING: Status.FULL} | {float(status): status for status in Status}


class NoCodeError(RobodynError):
    """Machine code does not serve a scene or a contact mode; use DOP853."""


def order_where_steps_cost(tolerance: float) -> int:
    """Return the order measured as cheapest for a single run at a tolerance.

    A step of one motion has a large cost besides its series.
    """
    return max(8, math.ceil(6 - 0.7 * math.log(max(tolerance, 1e-16))))


class Rows(Observer):
    """Observer of one lane: stores ends of steps, rows at given times, and series if requested."""

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
            scene.put(k, block, "t_there", time)
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
        """Write code that evaluates the state at the step's end once more."""
        k.each(len(self.scene.state), lambda i: k.store(k.load(k.at(there, i)), k.at(to, i)))


class _Room:
    """Memory for one run of machine code: its block, output times and results.

    Two runs never share a room; a finished run leaves its room to the next.
    """

    __slots__ = ("address", "block", "layout", "room", "views")

    def __init__(self, block: Array) -> None:
        self.block, self.address = block, block.ctypes.data
        self.room, self.layout = np.empty(0), ()
        self.views: tuple[Any, ...] = ()

    def laid(self, wanted: int, N: int, most: int, turns: int) -> tuple[Any, ...]:
        """Return the address and views of the table, times, rows, ends, states and series.

        There is room for `wanted` times, and for `most` steps of N numbers and `turns`
        coefficients.
        """
        layout: Any = wanted, N, most, turns
        if layout == self.layout:
            return self.views
        sizes = len(TABLE), wanted, wanted * N, most, most * N, most * turns
        a, b, c, d, e, end = accumulate(sizes)
        if len(self.room) < end:
            self.room = np.empty(end)
        room, at = self.room, self.room.ctypes.data
        table = room[:a].view(np.int64)
        table[:5] = [at + 8 * x for x in (a, b, c, d, e)]
        parts = room[a:b], room[b:c].reshape(wanted, N), room[c:d], room[d:e].reshape(most, N)
        self.layout, self.views = layout, (at, table, *parts, room[e:end].reshape(-1, turns or 1))
        return self.views


class _Ready(NamedTuple):
    """A scene, its machine code, a block with its numbers, and free rooms of earlier runs."""

    scene: Scene
    code: Loaded
    block: Array
    rooms: list[_Room]

    def room(self) -> _Room:
        """Return a free room, or a new one, with the scene's numbers in its block."""
        try:
            room = self.rooms.pop()
        except IndexError:
            room = _Room(self.code.block())
        room.block[:] = self.block
        return room


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
    return _Ready(scene, code, block, [])


@lru_cache(maxsize=64)
def _kept(mechanism: Mechanism, constants: tuple[float, ...] | None, *rest: Any) -> _Ready:
    """Return a cached `_Ready` for constant torques, or for torques linear between kinks."""
    return _ready(mechanism, Actuation(constants, linear=constants is None), *rest)


class SeriesEngine:
    """Steps of the Taylor series in machine code, for torques that have a series.

    Tolerances apply to angles (rad) and rates (rad/s) per step.  With `work`, states end with the
    work done (J).  Without `project`, closures drift.  Raises NoCodeError if machine code does not
    serve the scene, and InputError if a torque has no series; `advance` raises the same errors.
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
        # by how the switches of an expression stand: what is ready, and the room of this run
        self._ready: dict[tuple[float, ...] | None, tuple[_Ready, _Room]] = {}
        self.mechanism, self.actuation = mechanism, actuation
        self.order = order_where_steps_cost(max(rtol, atol)) if order is None else order
        self._options, self._tolerances = (work, project, family), (float(rtol), float(atol))
        self.keeps = False
        self.most = max(STEPS, min(MOST_STEPS, WORK // (mechanism.n * self.order)))
        if why := refused(mechanism):
            raise NoCodeError(why)
        if not machine.available():
            raise NoCodeError("needs the extra `fast`")
        self._made(None if actuation.pieces is None else actuation.pieces.at(0.0))

    def __del__(self) -> None:
        for ready, room in self._ready.values():
            if len(ready.rooms) < ROOMS:
                ready.rooms.append(room)

    def _made(self, held: tuple[float, ...] | None) -> tuple[_Ready, _Room]:
        """Return code and room for the current switch values `held` of the torques.

        Raises NoCodeError if no code can be made.
        """
        kept = self._ready.get(held)
        if kept is None:
            given = self.actuation
            rest = self.order, held, self._options, self._tolerances
            try:
                if given.constants is not None or given.linear:  # numbers tell all of it
                    ready = _kept(self.mechanism, given.constants, *rest)
                else:
                    ready = _ready(self.mechanism, given, *rest)
            except ZeroDivisionError as error:
                raise NoCodeError("no state has a series") from error
            kept = self._ready[held] = ready, ready.room()
        return kept

    @cached_property
    def _torques(self) -> Callable[[float, Sequence[float]], Sequence[float]]:
        return self.actuation.function(self.mechanism.n)

    def dense(self, t: float, y: Array, end: float) -> Callable[[Array], Array]:
        """Return a function of times (k,) that gives states (k, N) between (t, y) and `end`.

        Each call of the function computes the step again.
        """
        forward = 1.0 if end > t else -1.0

        def states(times: Array) -> Array:
            after = (times - t) * forward > 0.0
            rows = np.broadcast_to(y, (len(times), len(y))).copy()
            rows[after] = self._again(t, y, end, times[after])
            return rows

        return states

    def _again(self, t: float, y: Array, end: float, times: Array) -> Array:
        """Return states at `times` in the step from (t, y), computed again.

        If rounding ends the step early, a second step covers the rest.
        """
        rows = self.advance(t, y, end, times, STEPS, lands=False).row_y
        assert len(rows) == len(times)
        return rows

    def closed(self, rows: Array, t: Array) -> Array:
        """Project states (k, 2n or more) at times t (k,) onto closures, in place; return them."""
        (scene, code, *_), room = next(iter(self._ready.values()))  # they close alike
        block, address = room.block, room.address
        if code.close is not None:
            first = scene.place["to_q0"]
            there = block[first : first + rows.shape[1]]
            for row, time in zip(rows, t, strict=True):
                block[scene.place["t_there"]] = time
                there[:] = row
                code.close(address)
                row[:] = there
        return rows

    def advance(
        self, t: float, y: Array, bound: float, times: Array, steps: int, lands: bool = True
    ) -> Chunk:
        """Take up to `steps` steps from (t, y) towards `bound`, with rows at `times`.

        y is (q, qd) in joint coordinates, followed by the work (J) if requested.  `times` are
        ordered, strictly after t and not beyond `bound`.  The step that reaches the last of them is
        the last step.  Unless it `lands`, a step may end in a state from which no series can start.
        """
        keeps = self.keeps and lands
        pieces = self.actuation.pieces
        (scene, code, *_), room = self._made(None if pieces is None else pieces.at(t))
        block, address = room.block, room.address
        N, place = len(y), scene.place
        block[:N] = y
        block[N : 2 * N] = y
        direction = 1.0 if bound >= t else -1.0
        status = Status.REACHED if t == bound else RUNNING
        begin, suspect = place["t"], block[place["suspect"]]
        if not lands:
            block[place["suspect"]] = -math.inf
        _BEGUN(block.data, 8 * begin, t, bound, direction, status, 0.0)
        if scene.linear:
            n, base = self.mechanism.n, place["base0"]
            values, slopes = linear_piece(self.actuation, self._torques, t, y.tolist(), direction)
            block[place["base_t"]] = t
            block[base : base + 2 * n] = [*values, *slopes]
        if code.close is not None and status == RUNNING:  # where another engine leads across
            block[place["t_there"]] = t
            code.close(address)
            if not block[place["quality"]] >= block[place["suspect"]]:
                block[place["status"]] = Status.SINGULAR
        # how many steps are asked for changes from call to call
        turns = 2 * self.mechanism.n * (self.order + 2) if keeps else 0
        laid = room.laid(len(times), N, 1 << steps.bit_length(), turns)
        at, table, asked, rows, ends, states, series = laid
        _ASKED(table.data, 8 * ASKED, len(times), 0, keeps)
        asked[:] = times
        code.advance(address, steps, at)
        block[place["suspect"]] = suspect
        taken, given = int(block[place["steps"]]), int(table[GIVEN])
        ended = _STATUS[block[place["status"]]]
        made = ends[:taken].copy(), states[:taken].copy(), times[:given], rows[:given].copy()
        terms = None
        if keeps and taken:
            kept = series[:taken].reshape(taken, self.order + 2, self.mechanism.n, 2)
            terms = terms_of(kept.T, np.diff(made[0], prepend=t))
        return Chunk(*made, ended, terms)


@lru_cache(maxsize=64)
def refused(mechanism: Mechanism) -> str:
    """Return why machine code does not serve a mechanism, or "" if it does.

    For a mechanism with contacts, ask for each mode by itself.
    """
    if mechanism.rubbing:
        place = mechanism.rubbing_place(mechanism.rubbing[0])
        return f"friction by the force in a pin or slide, as {place} is, has no series"
    if mechanism.switches:
        return "contacts change how it moves"
    if loop_terms(mechanism) > LARGEST:
        return "it has too many links and loops: some 160 loops are served"
    if not elimination_is_safe(mechanism):
        return "masses are missing, or differ too much, for it to be solved without pivots"
    if mechanism.rows and regular_rank(mechanism) < len(mechanism.rows):
        return "its closures depend on one another"
    return ""


def serves(mechanism: Mechanism) -> bool:
    """Return whether machine code serves a mechanism."""
    return not refused(mechanism)


def check_served(mechanism: Mechanism, actuation: Actuation) -> None:
    """Raise InputError with the reason if machine code does not serve a scene's motion."""
    if not machine.available():
        limit = "needs the extra `fast`: pip install '.[fast]'"
        raise InputError("method", value="taylor", limit=limit)
    free = in_mode(mechanism, Mode()) if mechanism.switches else mechanism
    if why := refused(free):
        limit = f"{why}: take DOP853"
        raise InputError("method", where=mechanism.source, value="taylor", limit=limit)
    if actuation.constants is None and not actuation.linear:
        with suppress(ZeroDivisionError):  # of numbers that no switch of an expression holds
            MotionProgram(free, actuation, False)  # raises InputError for a torque without a series
