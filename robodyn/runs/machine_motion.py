"""Whole motions in machine code: steps until each lane has arrived or cannot go on.

The kernel `advance(block, budget, own)` takes up to `budget` steps of the lanes whose status is
RUNNING, and returns their number.  An observer stores what the steps produce; `own` is its
argument.  Lanes are masked by selects, so the numbers of a lane do not depend on its neighbours.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.engines import machine
from robodyn.engines.assembler import ADDRESS, WHOLE, Kernel, Module, Word
from robodyn.engines.expression import Expression, Graph
from robodyn.engines.formulas import Formula
from robodyn.engines.machine import Code, Processor
from robodyn.engines.segment import Segment
from robodyn.loops.misses import SLOWEST, TURN, orientation
from robodyn.loops.projection import PASSES
from robodyn.runs.machine_steps import ALIGNED, Items, Scene

SEEN = (0.29, 0.5, 1.0)  # of a step: at its middle, too, a motion may be back where it began
PARTS = (1.0, 0.85, 0.7, 0.55, 0.4)  # of a step, where it may land to avoid a suspect state
RUNNING = -1.0
KEPT = 128  # codes in a process
MISSED = 1e9  # times what a Newton step closes to rounding, of a gap that it does not close
SINGULAR = 1e-6  # relative pivot below which a Newton step is not trusted
ULPS = 2.0**-50  # of a time: a step below this part is none


class Status(IntEnum):
    """Why an engine stopped."""

    REACHED = 0  # the bound
    FULL = 1  # as many steps as were asked for
    SINGULAR = 2  # the next step would start too near a singular configuration
    STUCK = 3  # the step is below the spacing of floats
    NOT_FINITE = 4  # an acceleration or a torque is not finite


class Observer:
    """Stores results of steps: `begin` runs before each step, `step` after it."""

    key = ""

    def declare(self, scene: Scene, module: Module) -> None:
        """Write functions that the observer calls."""

    def finish(self, scene: Scene, module: Module) -> None:
        """Write functions that call those of the motion."""

    def begin(self, k: Kernel, block: Word, own: Word, leave: Callable[[Word], None]) -> None:
        """Write code before each step; `leave(condition)` ends the call."""

    def step(self, k: Kernel, block: Word, own: Word, taken: Word, take: Word, end: Word) -> None:
        """Write code after a step of the lanes `take` to `end`, before the state is replaced."""


class Loaded(NamedTuple):
    """Compiled kernels that take the address of a block."""

    close: Callable[[int], Any] | None  # where there are closures to keep
    advance: Callable[[int, int, int], int]
    items: int
    lanes: int
    code: Code

    def block(self) -> NDArray[np.float64]:
        """Return a zeroed block, aligned to cache lines."""
        return aligned(self.items * self.lanes)


def aligned(size: int) -> NDArray[np.float64]:
    """Return zeros, aligned to a cache line."""
    room = np.zeros(size + ALIGNED)
    return room[-(room.ctypes.data // 8) % ALIGNED :][:size]


_made: dict[tuple[str, int, str], Any] = {}
_making = threading.Lock()


def kept(
    key: str,
    text: Callable[[Processor], str],
    load: Callable[[Code], Any],
    lanes: int,
    family: str = "",
) -> Any:
    """Return the loaded kernels for `key`, compiling them the first time.

    Returns None if machine code cannot be made.
    """
    entry = key, lanes, family
    with _making:  # all threads get the same
        if entry not in _made:
            while len(_made) >= KEPT:
                _made.pop(next(iter(_made)))
            code = machine.make(text, key, None, family, lanes)
            _made[entry] = None if code is None else load(code)
        return _made[entry]


def compile(scene: Scene, observer: Observer, lanes: int, family: str = "") -> Loaded | None:
    """Return the machine code of a scene, shared by all scenes of its shape.

    Returns None if machine code cannot be made.  Raises ZeroDivisionError if no state has a series.
    """

    def load(code: Code) -> Loaded:
        close = code.function("close", ctypes.c_void_p, result=None) if scene.closes else None
        advance = code.function("advance", ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p)
        return Loaded(close, advance, code.function("size")(), code.processor.lanes, code)

    key = f"{observer.key} {scene.key}"
    loaded: Loaded | None = kept(key, partial(text, scene, observer), load, lanes, family)
    return loaded


def text(scene: Scene, observer: Observer, processor: Processor) -> str:
    """Return the LLVM text of all kernels of a scene."""
    module = Module(processor.lanes, short=True, together=processor.together)
    scene.write(module)
    if scene.closing is not None:
        _write_close(scene, module, scene.closing)
        _write_leaps(scene, module, scene.closing)
    observer.declare(scene, module)
    k = Kernel(module, "advance", (ADDRESS, WHOLE, ADDRESS))
    block, budget, own = k.arguments
    taken = k.slot(k.whole(0))
    with k.forever() as out:
        active = k.compare("oeq", scene.get(k, block, "status"), k.number(RUNNING))
        k.leave(k.invert(k.any(active)), out)
        count = k.get(taken, WHOLE)
        k.leave(k.compare("sge", count, budget), out)
        observer.begin(k, block, own, lambda condition: k.leave(condition, out))
        _Step(scene, k, block).write(
            active, lambda *args: observer.step(k, block, own, count, *args)
        )
        k.set(taken, k.add(count, k.whole(1)))
    k.done(k.get(taken, WHOLE))
    observer.finish(scene, module)
    return module.text


def _write_close(scene: Scene, module: Module, formula: Formula) -> None:
    """Write `close(block)`: Newton's method of `straightline.compile_closing`, lane by lane."""
    k, block = scene.kernel(module, "close")
    n, rows = scene.mechanism.n, len(formula.pivots)
    outputs = [*formula.outputs, *formula.pivots]
    names = scene.there([f"{name}{j}" for name in ("q", "qd") for j in range(n)])
    segment = scene.segment(k, block, outputs, scene.closing_names | names)
    moving, passes = k.slot(k.all_lanes(True)), k.slot(k.whole(0))
    quality = k.slot(k.number(0.0))
    speeds = [k.slot(scene.get(k, block, f"to_qd{j}")) for j in range(n)]
    missing = k.slot(k.number(0.0))
    with k.forever() as closed:
        words = segment.write(outputs)
        now = k.get(moving, k.mask)
        pivots = words[2 * n + rows :]
        least = pivots[0]
        for pivot in pivots[1:]:
            least = k.select(k.compare("ult", pivot, least), pivot, least)
        k.set(quality, k.select(now, least, k.get(quality)))
        now = k.both(now, k.less(k.number(SINGULAR), least))
        gap = k.number(0.0)
        for word in words[2 * n : 2 * n + rows]:
            size = k.intrinsic("fabs", word)
            gap = k.select(k.compare("ugt", size, gap), size, gap)
        k.set(missing, k.select(now, gap, k.get(missing)))
        for slot, word in zip(speeds, words[n : 2 * n], strict=True):
            k.set(slot, k.select(now, word, k.get(slot)))
        now = k.both(now, k.compare("ugt", gap, scene.get(k, block, "rounding")))
        for j in range(n):
            before = scene.get(k, block, f"to_q{j}")
            scene.put(k, block, f"to_q{j}", k.select(now, words[j], before))
        now = k.both(now, k.compare("ugt", gap, scene.get(k, block, "converged")))
        k.set(moving, now)
        count = k.add(k.get(passes, "i64"), k.whole(1))
        k.set(passes, count)
        k.leave(k.invert(k.any(now)), closed)
        k.leave(k.compare("sge", count, k.whole(PASSES)), closed)
    for j, slot in enumerate(speeds):
        scene.put(k, block, f"to_qd{j}", k.get(slot))
    result = k.get(quality)
    if scene.mechanism.driven:  # laws of the time may lead to where no state closes
        most = k.multiply(scene.get(k, block, "converged"), k.number(MISSED))
        result = k.select(k.compare("ugt", k.get(missing), most), k.number(-1.0), result)
    scene.put(k, block, "quality", result)
    k.done()


def _write_leaps(scene: Scene, module: Module, formula: Formula) -> None:
    """Write `leaps(block)`: set quality to -1 if a loop turns over within the step."""
    k, block = scene.kernel(module, "leaps")
    names = [f"{name}{j}" for name in ("q", "qd") for j in range(scene.mechanism.n)]
    entries = [(r, j, x) for r, row in enumerate(formula.Psi) for j, x in row.items()]
    words, products = {}, Graph()
    both: list[list[dict[int, Expression]]] = []
    for side, inputs in (("from", {}), ("to", scene.there(names))):
        both.append([{} for _ in formula.Psi])
        values = [x for *_, x in entries]
        entry_words = scene.segment(k, block, values, scene.closing_names | inputs).write(values)
        for (r, j, _), word in zip(entries, entry_words, strict=True):
            words[f"{side}{r}_{j}"] = word
            both[-1][r][j] = products.variable(f"{side}{r}_{j}")
    quality = scene.get(k, block, "quality")
    for value in Segment(k, words).write(orientation(scene.mechanism, *both)):
        quality = k.select(k.less(k.number(0.0), value), quality, k.number(-1.0))
    scene.put(k, block, "quality", quality)
    k.done()


class _Step(Items):
    """Writes one step of all lanes."""

    def call(self, name: str) -> None:
        self.k.call(name, self.block)

    def reach(self, h: Word) -> None:
        """Write the state at time h after the start."""
        k = self.k
        x = k.multiply(h, self.get("direction"))
        self.put("x", x)
        self.put("t_there", k.add(self.get("t"), x))
        self.call("evaluate")

    def _close(self) -> None:
        """Project that state; set its quality to -1 if the step leapt to another branch."""
        self.call("close")
        self.call("leaps")

    def write(self, active: Word, observe: Callable[[Word, Word], None]) -> None:
        k, scene = self.k, self.scene
        scene.torques(k, self.block)
        self.call("expand")
        longest, t = self.get("longest"), self.get("t")
        known = k.compare("ord", longest, longest)
        self._end(k.both(active, k.invert(known)), Status.NOT_FINITE)
        go = k.both(active, known)
        most = k.intrinsic("fabs", k.subtract(self.get("bound"), t))
        if scene.closes:
            turn = k.divide(k.number(TURN), scene.fastest(k, self.block, SLOWEST))
            longest = k.select(k.less(turn, longest), turn, longest)
        h = k.slot(k.select(go, k.select(k.less(longest, most), longest, most), k.number(0.0)))
        small = k.multiply(k.intrinsic("fabs", t), k.number(ULPS))
        small = k.select(k.less(k.number(1e-300), small), small, k.number(1e-300))
        if scene.motion.checked:
            self._shorten(go, h, small)
        else:
            self.reach(k.get(h))
        now = k.get(h)
        stuck = k.both(go, k.both(k.less(now, small), k.compare("une", now, most)))
        self._end(stuck, Status.STUCK)
        go = k.both(go, k.invert(stuck))
        if scene.closes:
            self._close()
            self._land(go, h)
            lost = k.both(go, k.compare("ule", self.get("quality"), k.number(SINGULAR)))
            self._end(lost, Status.SINGULAR)
            go = k.both(go, k.invert(lost))
        now = k.get(h)
        end = k.add(t, k.multiply(now, self.get("direction")))
        end = k.select(k.compare("oeq", now, most), self.get("bound"), end)
        quality = self.get("quality") if scene.closes else k.number(0.0)
        observe(go, end)
        here, there = (scene.at(k, self.block, name) for name in ("q0", "to_q0"))

        def renew(i: Word | int) -> None:
            place = k.at(here, i, k.numbers)
            after = k.load(k.at(there, i, k.numbers))
            k.store(k.select(go, after, k.load(place)), place)

        k.each(len(scene.state), renew)
        self.put("t", k.select(go, end, t))
        steps = k.add(self.get("steps"), k.select(go, k.number(1.0), k.number(0.0)))
        self.put("steps", steps)
        if scene.closes:
            poor = k.compare("ult", quality, self.get("suspect"))
            self._end(k.both(go, poor), Status.SINGULAR)
        full = k.compare("oge", steps, self.get("most_steps"))
        self._end(k.both(go, full), Status.FULL)
        self._end(k.both(go, k.compare("oeq", end, self.get("bound"))), Status.REACHED)

    def _end(self, mask: Word, status: Status) -> None:
        k = self.k
        self.put("status", k.select(mask, k.number(float(status)), self.get("status")))

    def _shorten(self, go: Word, h: Word, small: Word) -> None:
        """Shorten the step until its series holds, and write the state at its end.

        No argument may stray within the step.  At its middle, at its end, and at one place between
        them and its start the accelerations of the series must be those of the states.
        """
        k = self.k
        with k.forever() as good:
            now = k.get(h)
            self.put("x", k.multiply(now, self.get("direction")))
            self.call("strays")
            for place in SEEN:
                self.reach(k.multiply(now, k.number(place)))
                self.call("agrees")
            part = self.get("part")
            poor = k.both(k.both(go, k.less(part, k.number(1.0))), k.compare("oge", now, small))
            k.leave(k.invert(k.any(poor)), good)
            k.set(h, k.select(poor, k.multiply(now, part), now))

    def _land(self, go: Word, h: Word) -> None:
        """If the step's end is no good start, take the best of some shorter steps."""
        k = self.k
        suspect, whole = self.get("suspect"), k.get(h)
        poor = k.both(go, k.compare("ult", self.get("quality"), suspect))
        with k.when(k.any(poor)):
            left, best = k.slot(poor), k.slot(self.get("quality"))
            for part in PARTS[1:]:
                waiting = k.get(left, k.mask)
                shorter = k.multiply(whole, k.number(part))
                there = k.select(waiting, shorter, whole)
                self.reach(there)
                self._close()
                quality = self.get("quality")
                better = k.both(waiting, k.less(k.get(best), quality))
                k.set(h, k.select(better, there, k.get(h)))
                k.set(best, k.select(better, quality, k.get(best)))
                k.set(left, k.both(waiting, k.compare("ult", quality, suspect)))
            self.reach(k.get(h))
            self._close()
