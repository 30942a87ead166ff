"""The engine that steps a Taylor run: in Python, or in machine code where that pays."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import Any

from robodyn.dynamics import dense_dynamics
from robodyn.errors import InputError
from robodyn.loops.closing import loop_terms
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.recording import Recorder
from robodyn.taylor import Engine, NoCodeError, order_where_series_cost
from robodyn.taylor.python_series import InterpretedEngine, StraightEngine
from robodyn.taylor.steps import SteppingEngine

# entries of A and P times the order, and links, up to which straight-line code serves: beyond, it
# takes seconds to make and is more than Python compiles
STRAIGHT, MOST_LINKS = 6000, 120
LEAST_CLOSED = 10  # the order from which on steps are worth their closing
WORTH = 1500  # steps of a scene in Python that cost what making machine code does
ROW_BY_ROW = 5  # of those that the rows make one by one: a hundred times as long
PATIENCE = 1.0  # s in Python after which a run is worth a hint
HINT = "pip install '.[fast]' compiles the Taylor series: long runs take a tenth of the time"
SPARE = 32  # engines in machine code of runs that are over


def stepping_engine(
    mechanism: Mechanism,
    actuation: Actuation,
    rtol: float,
    atol: float,
    *,
    order: int | None = None,
    project: bool = True,
    work: bool = False,
) -> SteppingEngine:
    """The engine in Python for a mechanism and its torques.

    Raises InputError where a torque has no series, SingularError where a freedom has no inertia.
    """
    order = order or order_in_python(mechanism, max(rtol, atol), project)
    closing = None
    if mechanism.rows and project:
        from robodyn.loops.projection import float_closing

        closing = float_closing(mechanism)
    kind = StraightEngine if _straight(mechanism, order) else InterpretedEngine
    return kind(mechanism, closing, order, rtol, atol, actuation, work)


def order_in_python(mechanism: Mechanism, tolerance: float, project: bool) -> int:
    """The order of steps in Python where none is asked for."""
    closes = bool(mechanism.rows) and project
    return max(order_where_series_cost(tolerance), LEAST_CLOSED if closes else 0)


def _straight(mechanism: Mechanism, order: int) -> bool:
    """Whether straight-line code serves."""
    small = mechanism.n <= MOST_LINKS and loop_terms(mechanism) * order <= STRAIGHT
    return small and dense_dynamics.elimination_is_safe(mechanism)


def compiled_engine(
    mechanism: Mechanism,
    actuation: Actuation,
    rtol: float,
    atol: float,
    order: int | None,
    *,
    project: bool = True,
    work: bool = False,
) -> Engine | None:
    """The engine in machine code, or None where there is none, or it does not serve."""
    if find_spec("llvmlite") is None:
        return None
    from robodyn.taylor.compiled import CompiledEngine

    try:
        return CompiledEngine(
            mechanism, actuation, rtol=rtol, atol=atol, order=order, project=project, work=work
        )
    except NoCodeError:
        return None


_spare: dict[tuple[object, ...], Engine] = {}  # under constant torques; no run uses them now


@lru_cache(maxsize=64)
def _seen(mechanism: Mechanism) -> list[float]:
    """How many steps of a mechanism were made in Python, as the only item."""
    return [0.0]


@dataclass(eq=False)
class EngineChoice:
    """The engines of one run; `wanted` is python, compiled, or auto.

    That is compiled where as many steps of the mechanism as WORTH were made in this process, or are
    to be expected.  `kept` has them for the next phase.
    """

    wanted: str
    mechanism: Mechanism
    actuation: Actuation
    rtol: float
    atol: float
    order: int | None
    project: bool
    work: bool
    recorder: Recorder
    kept: dict[tuple[Mechanism, str], Any]

    def __post_init__(self) -> None:
        self.begun, self.seen, self.worth = time.perf_counter(), _seen(self.mechanism), math.inf
        if self.wanted == "auto":
            tolerance = max(self.rtol, self.atol)
            order = self.order or order_in_python(self.mechanism, tolerance, self.project)
            self.worth = WORTH if _straight(self.mechanism, order) else ROW_BY_ROW
        fast: Engine | None = None
        if self.wanted == "compiled" or self.seen[0] >= self.worth:
            fast = self.fast()
            if fast is None and self.wanted == "compiled":
                limit = "needs the extra `fast` (pip install '.[fast]'), a torque that has a "
                limit += "series, and a mechanism of some hundred loops at most whose closures do "
                limit += "not depend on one another: take auto or python"
                raise InputError("engine", value=self.wanted, limit=limit)
        self.waits = self.wanted == "auto" and self.seen[0] < self.worth
        self.now: Engine = fast or self.careful()

    @property
    def in_python(self) -> bool:
        """Whether steps are made in Python now."""
        return isinstance(self.now, SteppingEngine)

    def careful(self) -> SteppingEngine:
        """The engine in Python."""
        if (self.mechanism, "python") not in self.kept:
            given = self.mechanism, self.actuation, self.rtol, self.atol
            self.kept[self.mechanism, "python"] = stepping_engine(
                *given, order=self.order, project=self.project, work=self.work
            )
        made: SteppingEngine = self.kept[self.mechanism, "python"]
        made.halts = self.recorder.watch
        return made

    def fast(self) -> Engine | None:
        """The engine in machine code, if there is one."""
        if (self.mechanism, "compiled") not in self.kept:
            given = self.mechanism, self.actuation, self.rtol, self.atol, self.order
            self.kept[self.mechanism, "compiled"] = _spare.pop(self._key, None) or (
                compiled_engine(*given, project=self.project, work=self.work)
            )
        made: Engine | None = self.kept[self.mechanism, "compiled"]
        return made

    @property
    def _key(self) -> tuple[object, ...]:
        given = self.mechanism, self.actuation.constants, self.rtol, self.atol
        return *given, self.order, self.project, self.work

    def give_up(self) -> None:
        """Go on in Python: there is no machine code for the torques as they are now."""
        self.now, self.waits = self.careful(), False

    def spare(self) -> None:
        """The run is over: machine code under constant torques serves the next one."""
        if self.actuation.constants is not None and not self.in_python:
            if len(_spare) >= SPARE:
                _spare.clear()
            _spare[self._key] = self.now

    def count(self, made: float, more: float) -> None:
        """So many steps were made in Python, and so many more are expected."""
        self.seen[0] += made
        if self.waits and self.seen[0] + more >= self.worth:
            self.now, self.waits = self.fast() or self.now, False
        if time.perf_counter() - self.begun > PATIENCE and find_spec("llvmlite") is None:
            self.recorder.report.hint = HINT
