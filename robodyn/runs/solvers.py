"""scipy's solvers with a projection after every accepted step.

`projected(method)` subclasses a solver of scipy.  After each accepted step

1. the state is projected onto closed positions and velocities, by the least change; 2. the stored
derivative is evaluated again at the projected state; 3. at a kink, a torque with a memory is told,
and the next step restarts the method.

Near a change point that the loops miss, steps are bounded.  A step that leapt across one is
rejected and taken again.

The projection changes the state by the order of the local error, so the order of the method stays.
Dense output is that of the method; `segments.py` projects states between steps.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
from scipy.integrate import DOP853, RK45, OdeSolver, Radau

from robodyn.dynamics.closed_form import energies, mass_matrix
from robodyn.loops.projection import Projection
from robodyn.mechanics.kinks import NEAR, Ahead, kink_at, next_stop
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import falls_over
from robodyn.mechanics.run_control import Steps
from robodyn.runs.legs import Leg
from robodyn.runs.report import Outcome
from robodyn.runs.right_hand_side import RightHandSide
from robodyn.runs.segments import Segment, kept_step, solver_segment
from robodyn.tables.arrays import Array

METHODS: dict[str, type[OdeSolver]] = {"DOP853": DOP853, "RK45": RK45, "Radau": Radau}
EXPLICIT = ("DOP853", "RK45")
COUNTS = ("nfev", "njev", "nlu")  # what scipy's solvers count
UNBOUNDED = 1e50  # a tolerance from which what it is for chooses no step
STIFF_STEPS = 1000  # so many steps in a row at the edge of stability are called stiff
STIFF_SAMPLE = 10  # every so many steps are looked at
STABILITY_EDGE = {"DOP853": 4.5, "RK45": 2.5}  # |h lambda| near the stable limit


class StiffError(Exception):
    """An explicit method takes tiny steps because of its stability, not its accuracy."""


_Solver: Any = OdeSolver  # one of its kinds, with what those have


class Projecting(_Solver):  # type: ignore[misc]
    """Mixin in front of a solver of scipy that adds projection, kinks and stability checks.

    `near` has rates for steps that meet near-singular states.  `mechanism` tells which peaks of
    friction a step may leap over, and which laws of the time do work.
    """

    explicit = True
    edge = np.inf  # |h lambda| near the limit of stability, where it is watched
    t: float
    t_bound: float
    y: Array
    f: Any
    h_abs: float
    nfev: int

    def __init__(
        self,
        fun: Callable[..., Any],
        t0: float,
        y0: Array,
        t_bound: float,
        *,
        projection: Callable[[float, Array], Array] | None = None,
        kinks: Sequence[float] = (),
        jumps: Sequence[float] = (),
        leaves: Sequence[float] = (),
        listener: Steps | None = None,
        near: RightHandSide | None = None,
        mechanism: Mechanism | None = None,
        **options: Any,
    ) -> None:
        self._ahead = Ahead(jumps)
        if jumps:
            self._ahead.begin(t0, t_bound >= t0)
            fun = self._within(fun)
        super().__init__(fun, t0, y0, t_bound, **options)
        self.projection = projection
        self.misses = projection.misses if isinstance(projection, Projection) else None
        self.kinks = sorted(kinks)
        self.stops = sorted({*kinks, *jumps})
        self.leaves = leaves
        self.listener = listener
        self._bells = mechanism if mechanism is not None and mechanism.bells else None
        self._driven = mechanism if mechanism is not None and mechanism.driven else None
        self._lowest, self._highest, self._fastest = math.inf, -math.inf, 0.0  # energies, J
        self._inertia = 0.0
        if self._driven is not None:
            self._inertia = float(np.trace(mass_matrix(self._driven, self.y[: self._driven.n])))
        self._jumped = False  # whether the torque may have, at self.t
        self._options = options
        self.steps = 0
        self._longest = math.inf  # s, of the next step
        self._held = False  # whether tolerances are others than were given
        self._stiff_steps = 0
        self._rates = fun  # not counted
        self.near = near if self.explicit else None
        if self.explicit:
            self._plain = self.fun = self._counted(fun)
        if self.near is not None:
            assert self.near.careful is not None
            careful = self._within(self.near.careful) if jumps else self.near.careful
            self._careful = self._counted(careful)
            self.near.met = False

    def _counted(self, fun: Callable[..., Any]) -> Callable[..., Any]:
        """Return `fun` with a counter, without scipy's conversion of lists to arrays."""

        def counted(t: float, y: Array) -> Any:
            self.nfev += 1
            return fun(t, y)

        return counted

    def _within(self, fun: Callable[..., Any]) -> Callable[..., Any]:
        """Return `fun` with its time clipped to the smooth piece of the current step."""
        ahead = self._ahead
        return lambda t, y: fun(ahead(t), y)

    def _step_impl(self) -> tuple[bool, str | None]:
        if self._ahead.jumps:
            self._ahead.begin(self.t, self.direction > 0.0)
        if self._jumped:
            self._restart()
        begun = self.t, self.y, self.f if self.explicit else None
        end = self.t_bound
        self.t_bound = next_stop(self.stops, self.leaves, self.t, end, NEAR)
        longest = min(self._longest, self._hold())
        if longest < abs(self.t_bound - self.t):
            self.t_bound = self.t + self.direction * longest
        self._weigh()
        try:
            success, message = self._take_step()
        except ValueError as error:  # an implicit method met a rate that is not finite
            success, message = False, str(error)
        self.t_bound = end
        if success and not self.explicit:  # those go on where a rate is not finite
            success = bool(np.isfinite(np.asarray(self._rates(self.t, self.y))).all())
        if not success:
            return success, message
        if self._leapt(*begun[:2]):
            self.t, self.y, self.f = begun
            self._restart()
            return self._step_impl()
        self.steps += 1
        if self.edge < np.inf:
            self._watch_stability()
        self._reach()
        return success, message

    def _leapt(self, t: float, y: Array) -> bool:
        """Project the step from (t, y); return whether it leapt over a turn of the motion.

        A turn is a missed change point, or the peak of dry friction near zero rate.
        """
        if self.projection is not None:
            closed = self.projection(self.t, self.y)
            times, ends = np.array([t, self.t]), np.stack([y, closed])
            if self.misses is not None and self.misses.leaps(times, ends):
                return True
            if closed is not self.y:
                self.y, self.f = closed, self.fun(self.t, closed)
        if self._bells is None:
            return False
        over = falls_over(self._bells, y.tolist(), self.y.tolist(), self.t - t)
        self._longest = 0.5 * abs(self.t - t) if over else math.inf
        return over

    def _hold(self) -> float:
        """Return how long the next step may be beside change points that loops miss (s).

        Its tolerances are tightened there.
        """
        if self.misses is None:
            return math.inf
        longest, fine, rounding = self.misses.holds(self.y)
        if self._held or fine != np.inf:
            self._held = True
            self.rtol = min(self._options["rtol"], fine)
            atol = self._options["atol"]
            self.atol = np.where(atol < UNBOUNDED, np.minimum(atol, fine), atol)
            n = self.misses.mechanism.n
            self.atol[n : 2 * n] = np.maximum(self.atol[n : 2 * n], rounding)
        return float(longest)

    def _weigh(self) -> None:
        """Let the work of laws err by what tolerances are of the energy in motion until now.

        A motion that laws lead may be exact in steps of any length, along which their work is not.
        An error of the rates by `atol` is one of the energy by that times the momentum.
        """
        if self._driven is None:
            return
        n = self._driven.n
        KE, PE = map(float, energies(self._driven, self.y[:n], self.y[n : 2 * n]))
        self._fastest = max(self._fastest, KE)
        self._lowest, self._highest = min(self._lowest, PE), max(self._highest, PE)
        moving = max(self._fastest, self._highest - self._lowest)
        if moving > 0.0:
            momentum = math.sqrt(2.0 * self._fastest * self._inertia)
            self.atol[-1] = self.rtol * moving + float(self.atol[n]) * momentum

    def _reach(self) -> None:
        """Tell a torque with a memory if the step ended on a kink.

        The dense output of the step stays as it is.
        """
        if self.listener is None and not self._ahead.jumps:
            return
        kink = kink_at(self.stops, self.t)
        if kink is None:
            return
        if self.t * self.direction < kink * self.direction <= self.t_bound * self.direction:
            self.t = kink  # missed by rounding
        if self.listener is not None and kink_at(self.kinks, kink) is not None:
            self.listener.reach(kink, self.y.tolist())
            self._jumped = self.listener.restarts
        if kink_at(self._ahead.jumps, kink) is not None:
            self._jumped = True

    def _restart(self) -> None:
        """Restart the method at the current time, where the rates jump."""
        self._jumped = False
        if self.explicit:
            self.f = self.fun(self.t, self.y)
            return
        before = {name: getattr(self, name) for name in COUNTS}
        super().__init__(self._rates, self.t, self.y, self.t_bound, **self._options)
        for name in COUNTS:
            setattr(self, name, before[name] + getattr(self, name))

    def _take_step(self) -> tuple[bool, str | None]:
        """Take one step; repeat it with projected stages if it met a singularity."""
        near, step = self.near, super()._step_impl
        if near is None:
            return step()  # type: ignore[no-any-return]
        self.fun = self._careful if near.met else self._plain
        begun = self.t, self.y, self.f, self.h_abs
        near.met = False
        success, message = step()
        if near.met and self.fun is self._plain:
            self.t, self.y, self.f, self.h_abs = begun
            self.fun = self._careful
            success, message = step()
        return success, message

    def _dense_output_impl(self) -> Any:
        if self._ahead.jumps:  # it may be asked for after later steps
            self._ahead.begin(self.t_old, self.direction > 0.0)
        return super()._dense_output_impl()

    def _watch_stability(self) -> None:
        """Raise StiffError if Hairer's test finds |h lambda| at the stability edge.

        The test compares the last stage with the new state, on every STIFF_SAMPLE-th step.
        """
        if self.steps % STIFF_SAMPLE:
            return
        last = self.n_stages - 1
        stage = self.y_old + self.h_previous * (self.A[last, :last] @ self.K[:last])
        moved = np.linalg.norm(self.y - stage)
        turned = np.linalg.norm(self.K[-1] - self.K[last])
        held = moved > 0.0 and abs(self.h_previous) * turned > self.edge * moved
        self._stiff_steps = self._stiff_steps + 1 if held else self._stiff_steps // 2
        if self._stiff_steps * STIFF_SAMPLE >= STIFF_STEPS:
            raise StiffError


@cache
def projected(method: str) -> type[OdeSolver]:
    """Return scipy's solver `method` with projection, kinks and stability checks."""
    kind = {"explicit": method in EXPLICIT, "edge": STABILITY_EDGE.get(method, np.inf)}
    return type(f"Projected{method}", (Projecting, METHODS[method]), kind)


AT_ONCE = 512  # joints of steps that make a segment
FEW, MANY = 16, 192  # steps of one; of one that is looked at between its steps


class SolverSteps:
    """Steps of a scipy solver along a leg, as segments.

    `method` and `rtol` take the place of those of its settings.  If torques have a memory, or the
    leg may end, each step is a segment by itself.
    """

    def __init__(self, leg: Leg, method: str = "", rtol: float | None = None) -> None:
        system, t, y, t_end, *_ = leg
        mechanism, actuation, settings = system.mechanism, system.actuation, system.settings
        side, single = system.side, leg.may_end or actuation.listener is not None
        each = np.full(len(y), settings.atol, float)
        # the work chooses no step, but that of laws, which `_weigh` bounds
        each[2 * mechanism.n + actuation.states :] = 1e100
        kind: Any = projected(method or settings.method)
        self.outcome: Outcome | None = None
        self.error: Exception | None = None  # raised once the steps before it are taken
        self.y = y  # where the last step ended
        most = max(1, min(MANY if leg.keeps else FEW, AT_ONCE // mechanism.n))
        self.most = 1 if single else most
        with _quiet():
            self.solver: Any = kind(
                side.rates,
                t,
                y,
                t_end,
                rtol=settings.rtol if rtol is None else rtol,
                atol=each,
                projection=side.projection if system.projects else None,
                near=side if side.careful is not None else None,
                mechanism=mechanism,
                kinks=actuation.kinks,
                jumps=actuation.jumps,
                leaves=actuation.leaves,
                listener=actuation.listener,
                max_step=settings.max_step,
            )

    def leave(self, t: float, y: Array) -> None:
        """Do nothing: the solver has already told the torques of kinks."""

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the rates so far."""
        return int(self.solver.nfev)

    def advance(
        self, left: float, enough: Callable[[OdeSolver], bool] = lambda solver: False
    ) -> Segment | None:
        """Return the next steps, or None if there are none; `outcome` then says why.

        The segment ends early after more than `left` evaluations, or once `enough(solver)` is True.
        """
        if self.error is not None:
            raise self.error
        if self.outcome is not None:
            return None
        solver, steps = self.solver, list[Any]()
        most = self.evaluations + left
        with _quiet():
            try:
                # where a rate is not finite at its start scipy has no first step, and never ends
                while (
                    solver.status == "running"
                    and len(steps) < self.most
                    and math.isfinite(getattr(solver, "h_abs", 0.0))
                ):
                    solver.step()
                    if solver.status == "failed":
                        break
                    steps.append(kept_step(solver))
                    if solver.nfev > most or enough(solver):
                        break
            except StiffError:
                self.outcome = Outcome.STIFF
            except Exception as error:
                if not steps:
                    raise
                self.error = error
        if steps:
            begun, self.y = self.y, steps[-1].y
            return solver_segment(begun, steps)
        if self.outcome is None:
            finished = solver.status == "finished"
            self.outcome = Outcome.FINISHED if finished else Outcome.STEP_TOO_SMALL
        return None


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence scipy and numpy: the outcome of the run reports what they would warn of."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        warnings.filterwarnings("ignore", module="scipy")
        yield
