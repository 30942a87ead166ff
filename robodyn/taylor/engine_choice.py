"""The engine that steps a Taylor run: in machine code where there is some, else in Python.

The scene, its torques and the packages that are installed decide which, never what the process did
before, nor the clock: the two engines take different steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from robodyn.dynamics import dense_dynamics
from robodyn.errors import InputError
from robodyn.loops.closing import loop_terms
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.recording import Recorder
from robodyn.taylor import Engine, NoCodeError, order_where_series_cost
from robodyn.taylor.python_series import InterpretedEngine, StraightEngine
from robodyn.taylor.steps import SteppingEngine

if TYPE_CHECKING:
    from robodyn.loops.misses import Misses

# entries of A and P times the order, and links, up to which straight-line code serves: beyond, it
# takes seconds to make and is more than Python compiles
STRAIGHT, MOST_LINKS = 6000, 120
LEAST_CLOSED = 10  # the order from which on steps are worth their closing
MANY = 1000  # steps in Python from which on a run is worth a hint
HINT = "pip install '.[fast]' compiles the Taylor series: long runs take a tenth of the time"


def stepping_engine(
    mechanism: Mechanism,
    actuation: Actuation,
    rtol: float,
    atol: float,
    *,
    order: int | None = None,
    project: bool = True,
    work: bool = False,
    misses: Misses | None = None,
) -> SteppingEngine:
    """The engine in Python for a mechanism and its torques.

    `misses` are the change points that its run has met so far; None: none.  Raises InputError where
    a torque has no series, SingularError where a freedom has no inertia.
    """
    if order is None:
        closes = bool(mechanism.rows) and project
        order = max(order_where_series_cost(max(rtol, atol)), LEAST_CLOSED if closes else 0)
    closing = None
    if mechanism.rows and project:
        from robodyn.loops.projection import float_closing

        closing = float_closing(mechanism)
    kind = StraightEngine if _straight(mechanism, order) else InterpretedEngine
    return kind(mechanism, closing, order, rtol, atol, actuation, work, misses)


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


@dataclass(eq=False)
class EngineChoice:
    """The engines of one run; `wanted` is python, compiled, or auto: compiled if it can be made.

    `kept` has them for the next phase.
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
    misses: Misses | None

    def __post_init__(self) -> None:
        fast = None if self.wanted == "python" else self.fast()
        if fast is None and self.wanted == "compiled":
            limit = "needs the extra `fast` (pip install '.[fast]'), a torque that has a "
            limit += "series, and a mechanism of some hundred loops at most whose closures do "
            limit += "not depend on one another: take auto or python"
            raise InputError("engine", value=self.wanted, limit=limit)
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
                *given,
                order=self.order,
                project=self.project,
                work=self.work,
                misses=self.misses,
            )
        engine: SteppingEngine = self.kept[self.mechanism, "python"]
        engine.halts = self.recorder.watch
        return engine

    def fast(self) -> Engine | None:
        """The engine in machine code, if there is one."""
        if (self.mechanism, "compiled") not in self.kept:
            given = self.mechanism, self.actuation, self.rtol, self.atol, self.order
            made = compiled_engine(*given, project=self.project, work=self.work)
            self.kept[self.mechanism, "compiled"] = made
        engine: Engine | None = self.kept[self.mechanism, "compiled"]
        return engine

    def give_up(self) -> None:
        """Go on in Python: there is no machine code for the torques as they are now."""
        self.now = self.careful()

    def tell(self) -> None:
        """Tell a long run in Python, in its report, what would make it faster."""
        long = self.in_python and self.recorder.report.evaluations > MANY
        if long and self.wanted == "auto" and find_spec("llvmlite") is None:
            self.recorder.report.hint = HINT
