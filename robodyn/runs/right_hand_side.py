"""dy/dt of a mechanism for an integrator, and the projection back onto states that close.

The state is y = (q, qd), followed by the states that torques have of their own (the integrals of a
controller), and last by the work done by torques less dampers where it is wanted.
Two evaluators serve (`make bench` shows where they cross):

- generated straight-line floats: the sparse factorisation of [M Psi^T; Psi 0] written out, whose
  cost is linear in the number of loops;
- where links act on many others, M alone is singular or nearly so, and for states nearly singular:
  `dense_dynamics.py`, which keeps to the freedoms that the closures leave.

Near a singular configuration, at a distance d from it, a gap of delta in position or velocity
makes an error of delta/d in the accelerations.  A stage of an integrator strays from the closures
by more than the step's error, and such errors would stall it; so a state whose closures' pivots
are small is projected before it is evaluated, and one nearer still is not solved at all
(`change_points.py`).  On closed states that changes nothing.  A step of an explicit method that
meets such a state is taken again with every stage projected: stages of one step must not belong
to two different extensions of the vector field.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from robodyn.dynamics import dense_dynamics
from robodyn.dynamics.closed_form import other_forces
from robodyn.dynamics.friction_formula import rubbed_formula
from robodyn.dynamics.friction_rounds import NotSettledError, forward_of_one
from robodyn.engines import straightline
from robodyn.errors import SignalError
from robodyn.loops.change_points import SUSPECT, Singular, lead_across
from robodyn.loops.closing import regular_rank
from robodyn.loops.closures import closure_drift
from robodyn.loops.misses import Misses
from robodyn.loops.projection import Projection, best_closing, dense_closing, written_out
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

Rates = Callable[[float, Array], Any]

SINGULAR = 1e-4  # relative pivot below which the written-out solve loses digits to the dense one
NEAR = 0.1  # relative pivot of a closure below which a state is projected before evaluation


@dataclass(eq=False, slots=True)
class RightHandSide:
    """The rates dy/dt as a function of t and y, and the projection (None without closures).

    If `rates` project near-singular states only, `careful` are rates that project every state, and
    `met` tells whether a near-singular state occurred.  `refused` is the time and error of the last
    state at which friction by forces had no solution.
    """

    kind: str  # straight-line or dense
    rates: Rates = field(init=False)
    projection: Projection | None = None
    careful: Rates | None = None
    met: bool = False
    refused: tuple[float, NotSettledError] | None = None


def right_hand_side(
    mechanism: Mechanism,
    actuation: Actuation,
    *,
    work: bool = False,
    baumgarte: float = 0.0,
    kind: str | None = None,
    misses: Misses | None = None,
) -> RightHandSide:
    """Return the evaluator of the given `kind`, or the fastest one for this mechanism.

    `misses` holds the change points met so far by the run.
    """
    side = RightHandSide(kind or _best_kind(mechanism))
    dense = side.kind == "dense"
    straight = partial(straightline.compile_rates, mechanism, work=work, baumgarte=baumgarte)
    if mechanism.rubbing:
        straight = partial(straight, write=rubbed_formula)

    def solving(torques: Actuation) -> Rates:
        """Return the rates of a state as it is, without projection."""
        fallback = _dense_rates(mechanism, torques, work, baumgarte, side)
        return fallback if dense else straight(torques, least_pivot=SINGULAR, otherwise=fallback)

    side.rates = solving(actuation)
    if not mechanism.rows:
        return side
    closing = (dense_closing if dense else best_closing)(mechanism)
    side.projection = Projection(mechanism, closing, misses)
    if baumgarte:  # its restoring terms need the gap: no state is projected
        return side
    careful = _projecting(side.projection, actuation, solving, side.rates, dense)
    if dense:  # a projection costs little beside them
        side.rates = careful
        return side

    def watched(t: float, y: Array) -> Any:
        side.met = True
        return careful(t, y)

    side.careful, side.rates = watched, straight(actuation, least_pivot=NEAR, otherwise=watched)
    return side


def _projecting(
    project: Projection,
    actuation: Actuation,
    solving: Callable[[Actuation], Rates],
    solved: Rates,
    dense: bool,
) -> Rates:
    """Return rates that project a state first, and lead across nearby change points.

    They are nan beyond the range of a coupling's law.
    """
    mechanism, closing, misses = project.mechanism, project.closing, project.misses
    # across a change point the state's own torque is kept: beside it it may bend
    held = [0.0] * (mechanism.n + actuation.states)
    beside, torques = solved, None
    if actuation.constants is None:
        names = ", ".join([*(f"tau{k}" for k in range(mechanism.n)), *actuation.own("zd")])
        steady = Actuation(
            None, (f"{names}, = _held",), (), {"_held": held}, states=actuation.states
        )
        beside = solving(steady)
        torques = actuation.function(mechanism.n)

    def across(t: float, y: Array, near: Singular) -> Any:
        """Return the rates at a state next to a change point, led across it."""

        def evaluate(states: Array) -> Array:
            if torques is not None:
                held[:] = torques(t, closing(t, y)[0].tolist())
            return np.array([beside(t, state) for state in states])

        try:
            return lead_across(mechanism, closing, y, near, evaluate)
        except (ArithmeticError, ValueError):  # outside the torque's domain
            return np.full(len(y), np.nan)

    def careful(t: float, y: Array) -> Any:
        q = y[: mechanism.n]
        if not np.isfinite(q).all():  # after a stage whose rates are not
            return np.full(len(y), np.nan)
        try:
            if misses.near(q):  # a stage that were closed here would bend the step
                return solved(t, y)
            if dense:  # whose closing is the cheapest test
                closed, quality = closing(t, y)
                if quality > SUSPECT:
                    return solved(t, closed)
            near = misses.nearest(q)
            led = None
            if near is not None:
                led = across(t, y, near) if near.crosses else solved(t, y)
            return solved(t, closing(t, y)[0]) if led is None else led
        except ValueError:
            if not mechanism.laws:
                raise
            return np.full(len(y), np.nan)

    return careful


def _best_kind(mechanism: Mechanism) -> str:
    if not dense_dynamics.elimination_is_safe(mechanism):
        return "dense"
    if mechanism.rows and regular_rank(mechanism) < len(mechanism.rows):
        return "dense"  # closures that depend on one another leave no pivot
    return "straight-line" if written_out(mechanism) else "dense"


def _dense_rates(
    mechanism: Mechanism, actuation: Actuation, work: bool, baumgarte: float, side: RightHandSide
) -> Rates:
    """Return dy/dt by dense algebra; `side` is told of states where friction has no solution."""
    drives = bool(work and mechanism.driven)
    n = mechanism.n
    torques = actuation.function(n)
    damping = np.array(mechanism.damping)
    forced = mechanism.has_state_forces

    def rates(t: float, y: Array) -> Any:
        try:
            values = y.tolist()
            outputs = torques(t, values)
        except (ArithmeticError, ValueError):  # outside the torque's domain
            return np.full(len(y), np.nan)
        if not (all(map(math.isfinite, values)) and all(map(math.isfinite, outputs[:n]))):
            return np.full(len(y), np.nan)
        q, qd, tau = y[:n], y[n : 2 * n], np.array(outputs[:n])
        given = mechanism, q, qd, tau, baumgarte, t
        rubbed: Array | float = 0.0  # load of friction by forces
        try:
            if mechanism.rubbing:
                qdd, multipliers, rubbed = forward_of_one(*given)
            elif drives:
                qdd, multipliers = dense_dynamics.forward(*given)[:2]
            else:
                qdd = dense_dynamics.accelerations(*given)
            driving = 0.0  # of laws of the time, W
            if drives:
                driving = -float(closure_drift(mechanism, q, t) @ multipliers)
            if work and forced:
                tau = tau + other_forces(mechanism, q, qd, t)
            tau = tau + rubbed
        except SignalError:  # a shorter step may not
            return np.full(len(y), np.nan)
        except NotSettledError as error:
            side.refused = t, error
            return np.full(len(y), np.nan)
        power = [float(tau @ qd - damping @ qd**2) + driving] if work else []
        return [*values[n : 2 * n], *qdd.tolist(), *outputs[n:], *power]

    return rates
