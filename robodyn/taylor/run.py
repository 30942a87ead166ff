"""Runs the Taylor integrator: chooses the engine, steps onto kinks, crosses what is singular.

A series that starts close to a singular configuration drowns in rounding.  Engines land elsewhere
where they can; where they cannot, or a run starts there, a few steps of DOP853, whose stages
`change_points.py` serves, lead across.  So they do from where a torque has no series, sqrt(t) at 0.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn.dynamics import dense_dynamics
from robodyn.errors import InputError, RobodynError
from robodyn.loops.closing import loop_terms
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import kink_at, next_stop
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.recording import Recorder
from robodyn.simulation.report import Outcome
from robodyn.simulation.run_torques import check_start
from robodyn.tables.arrays import Array
from robodyn.taylor import STEPS, Chunk, Engine, NoCodeError, Status, default_order
from robodyn.taylor.held_steps import held_by_stability
from robodyn.taylor.python_series import InterpretedEngine, StraightEngine
from robodyn.taylor.steps import SteppingEngine

if TYPE_CHECKING:
    from robodyn.events.told import Stop
    from robodyn.simulation.right_hand_side import RightHandSide
    from robodyn.taylor.variations import Variations


# entries of A and P times the order, and links, up to which straight-line code serves: beyond, it
# takes seconds to make and is more than Python compiles
STRAIGHT, MOST_LINKS = 6000, 120
LEAST_CLOSED = 10  # the order from which on steps are worth their closing
COMPILED_STEPS = 4096
TOGETHER = 8 * STEPS  # of those in Python: looks for events or leaps cost as many calls
KEPT = 32768  # steps whose series are kept at a time, of one link
AHEAD = 4  # where an event ends the run, or a phase of it, at first
CALL = 0.1  # s that a call of compiled code may take
WORTH = 1500  # steps of a scene in Python that cost what making machine code does
ROW_BY_ROW = 5  # of those that the rows make one by one: a hundred times as long
ROWS_A_STEP = 4  # rows at times that cost what a step does
MOST_IDLE = 8  # rounds without a step, after which there is none
LEAD = 8  # steps of DOP853 away from where a torque has no series
PATIENCE = 1.0  # s in Python after which a run is worth a hint
HINT = "pip install 'robodyn[fast]' compiles the Taylor series: long runs take a tenth of the time"
SMALLEST_RTOL = 3e-14  # of scipy's methods
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
    closes = bool(mechanism.rows) and project
    if order is None:
        order = max(default_order(max(rtol, atol)), LEAST_CLOSED if closes else 0)
    closing = None
    if closes:
        from robodyn.loops.projection import float_closing

        closing = float_closing(mechanism)
    kind = StraightEngine if _straight(mechanism, order) else InterpretedEngine
    return kind(mechanism, closing, order, rtol, atol, actuation, work)


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


def taylor_run(
    mechanism: Mechanism,
    actuation: Actuation,
    y: Array,
    t_end: float,
    recorder: Recorder,
    *,
    rtol: float,
    atol: float,
    order: int | None,
    engine: str,
    project: bool,
    max_step: float,
    side: Callable[[], RightHandSide],
    begin: float = 0.0,
    engines: dict[tuple[Mechanism, str], Any],
) -> Outcome:
    """Integrate from (begin, y) to t_end; `side` makes what DOP853 needs, where it is needed.

    `engine` is python, compiled, or auto: compiled where as many steps of the mechanism as WORTH
    were made in this process, or are to be expected.  `engines` keeps them for the next phase.
    """
    variations: Variations | None = None
    carried = actuation
    if actuation.by and actuation.alone is not None:
        from robodyn.taylor.variations import variations_of

        variations, y = variations_of(mechanism, actuation, y, max(rtol, atol), order)
        actuation = actuation.alone
    work = len(y) > 2 * mechanism.n
    projects = project and bool(mechanism.rows)
    closing, misses, suspect = None, None, 0.0
    if projects:
        from robodyn.loops.change_points import suspect_quality
        from robodyn.loops.misses import FAR, Misses
        from robodyn.loops.projection import float_closing

        closing, misses = float_closing(mechanism), Misses(mechanism)
        suspect = suspect_quality(mechanism)

    def at_change_point() -> bool:
        return misses is not None and misses.crosses(y[: mechanism.n])

    def careful() -> SteppingEngine:
        if (mechanism, "python") not in engines:
            engines[mechanism, "python"] = stepping_engine(
                mechanism, actuation, rtol, atol, order=order, project=project, work=work
            )
        made: SteppingEngine = engines[mechanism, "python"]
        made.halts = recorder.watch
        return made

    key = mechanism, actuation.constants, rtol, atol, order, project, work

    def fast() -> Engine | None:
        if (mechanism, "compiled") not in engines:
            engines[mechanism, "compiled"] = _spare.pop(key, None) or compiled_engine(
                mechanism, actuation, rtol, atol, order, project=project, work=work
            )
        made: Engine | None = engines[mechanism, "compiled"]
        return made

    stepping: Engine | None = None
    slow: SteppingEngine | None = None
    seen, worth = _seen(mechanism), math.inf
    if engine == "auto":
        straight = _straight(mechanism, order or default_order(max(rtol, atol)))
        worth = WORTH if straight else ROW_BY_ROW
    if engine == "compiled" or (engine == "auto" and seen[0] >= worth):
        stepping = fast()
        if stepping is None and engine == "compiled":
            limit = "needs the extra `fast` (pip install 'robodyn[fast]'), a torque that has a "
            limit += "series, and a mechanism of some hundred loops at most whose closures do not "
            limit += "depend on one another: take auto or python"
            raise InputError("engine", value=engine, limit=limit)
    waits = engine == "auto" and stepping is None and seen[0] < worth
    stepping = stepping or careful()
    check_start(mechanism, actuation, begin, y)
    t, begun = begin, time.perf_counter()
    recent: list[Chunk] = []  # steps in a row that are not yet known to be held by stability
    crosses = False  # whether only the motion that leads across a change point leads on
    if closing is not None and isinstance(stepping, SteppingEngine):  # machine code tells itself
        crosses = closing(y.tolist())[1] < suspect and at_change_point()
    stuck = False  # whether no series leads on: a torque bends without end, or rounding hides it
    idle = 0  # times in a row that nothing led on
    held = False  # whether steps may leap, or start too near: the engine in Python holds them
    watched = recorder.events is not None
    most_ahead = max(1, min(COMPILED_STEPS, KEPT // mechanism.n))
    may_end = recorder.events is not None and recorder.events.may_end
    ahead = AHEAD if may_end else most_ahead  # steps at a time: those beyond the end are lost
    while True:
        bound = next_stop(actuation.kinks, actuation.leaves, t, t_end)
        if abs(bound - t) > max_step:
            bound = t + math.copysign(max_step, t_end)
        recorder.report.evaluator = type(stepping).__name__.removesuffix("Engine").lower()
        before, made = t, 0.0
        if crosses or stuck:
            if variations is not None:
                limit = "is of motions that pass no change point"
                if stuck:
                    limit = "no Taylor series leads on there: take --method DOP853"
                raise RobodynError("sensitivity", value=f"t = {t:.6g} s", limit=limit)
            regular, least = 2.0 * suspect, LEAD if stuck else 1
            t, y = _lead(
                side(), t, y, bound, recorder, closing, regular, least, rtol, atol, actuation
            )
            if t == before:
                singular = closing is not None and closing(y.tolist())[1] < regular
                return Outcome.SINGULAR if singular else Outcome.STEP_TOO_SMALL
            status = Status.FULL
        else:
            runner: Engine = stepping
            if not isinstance(stepping, SteppingEngine):
                near = held or (misses is not None and misses.distance(y[: mechanism.n]) < FAR)
                if near:
                    runner = slow = slow or careful()
            left = recorder.max_evaluations - recorder.report.evaluations
            most = runner.most if waits or not isinstance(runner, SteppingEngine) else TOGETHER
            steps = 1 if max_step < math.inf else max(1, min(most, left + 1))
            called = time.perf_counter()
            if runner.keeps is not watched:
                runner.keeps = watched
            steps = min(steps, ahead) if watched else steps
            if not isinstance(runner, SteppingEngine):
                runner.forms = recorder.events.forms() if recorder.events else None
            try:
                chunk = runner.advance(t, y, bound, recorder.times_until(bound), steps)
            except NoCodeError:  # of other torques than those at the start
                stepping, waits = careful(), False
                continue
            if not isinstance(runner, SteppingEngine):  # nothing halts it within a call
                took = max(1e-9, time.perf_counter() - called)
                runner.most = max(1, min(COMPILED_STEPS, int(CALL / took * len(chunk.t))))
            leaps: list[int] = []
            if misses is not None and isinstance(runner, SteppingEngine):  # machine code looks too
                times, ends = np.append(t, chunk.t), np.concatenate([y[None], chunk.y])
                leaps = misses.leaps(times, ends)
            if leaps:
                chunk = chunk.first(leaps[0], 1.0 if bound > t else -1.0)
            held = bool(leaps)
            within: Callable[[Array], Array] = runner.within
            stop: Stop | None = None
            if recorder.events is not None and len(chunk.t):
                from robodyn.taylor.watched_steps import with_events

                chunk, within, stop = with_events(recorder.events, mechanism, chunk, t, y, runner)
            told = chunk
            if variations is not None:
                told, within = variations.along(t, y, chunk, type(runner).__name__, within)
            if len(chunk.t):
                t, y = float(chunk.t[-1]), chunk.y[-1]
                reach(carried, t, told.y[-1])
            recorder.chunk(told, t_end, within)
            if stop is not None:
                if variations is not None:
                    stop = stop._replace(y=variations.both(stop.y))
                recorder.stop(stop)
            ahead = min(2 * ahead, most_ahead)
            status = chunk.status
            recent.append(chunk)
            if status is not Status.FULL:
                recent.clear()
            elif sum(len(some.t) for some in recent) >= STEPS:
                if held_by_stability(recent, t_end, recorder, rtol, atol):
                    return Outcome.STIFF
                recent.clear()
            made = len(chunk.t) + len(chunk.row_t) / ROWS_A_STEP
        if t == t_end:
            if actuation.constants is not None and not isinstance(stepping, SteppingEngine):
                if len(_spare) >= SPARE:
                    _spare.clear()
                _spare[key] = stepping
            return Outcome.FINISHED
        idle = idle + 1 if t == before else 0
        if idle == MOST_IDLE:
            return Outcome.STEP_TOO_SMALL
        stuck = status in (Status.STUCK, Status.NOT_FINITE)
        if stuck and closing is None and actuation.constants is not None:
            return Outcome.STEP_TOO_SMALL
        crosses = status is Status.SINGULAR and at_change_point()
        if status is Status.SINGULAR:
            held = not crosses
        if isinstance(stepping, SteppingEngine):
            seen[0] += made
            expected = seen[0] + made * abs((t_end - t) / ((t - before) or math.inf))
            if waits and expected >= worth:
                stepping, waits = fast() or stepping, False
            if time.perf_counter() - begun > PATIENCE and find_spec("llvmlite") is None:
                recorder.report.hint = HINT


def reach(actuation: Actuation, t: float, y: Array) -> None:
    """Tell a torque that depends on the run's steps that one of them ended on a kink."""
    if actuation.told is not None and (kink := kink_at(actuation.kinks, t)) is not None:
        actuation.told.reach(kink, y.tolist())


@np.errstate(all="ignore")  # as of a run by it alone
def _lead(
    side: RightHandSide,
    t: float,
    y: Array,
    bound: float,
    recorder: Recorder,
    closing: Callable[[list[float]], tuple[list[float], float]] | None,
    regular: float,
    least: int,
    rtol: float,
    atol: float,
    actuation: Actuation,
) -> tuple[float, Array]:
    """DOP853 from (t, y), `least` steps and until the closures are regular, or the bound."""
    from robodyn.simulation.solvers import solver_of

    tolerances = max(rtol, SMALLEST_RTOL), atol
    solver = solver_of("DOP853", side, (t, y, bound), tolerances, recorder, actuation)
    # where a rate is not finite at its start scipy has no first step, and would look for ever
    while solver.status == "running" and math.isfinite(getattr(solver, "h_abs", 0.0)):
        if solver.step() is not None:
            break
        least -= 1
        if least <= 0 and (closing is None or closing(solver.y.tolist())[1] >= regular):
            break
    recorder.end_solver(solver)
    return float(solver.t), np.array(solver.y)
