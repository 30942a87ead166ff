"""dy/dt of a mechanism for an integrator, and the projection back onto states that close.

The state is y = (q, qd), with the work done by torques less dampers appended where it is wanted.
Three evaluators serve three sizes (`make bench` shows where they cross):

- few links: generated straight-line floats;
- more: a sparse factorisation of the symmetric system [M Psi^T; Psi 0] in absolute angles;
- where M alone is singular or nearly so, and for states nearly singular: `dense_dynamics.py`,
  which keeps to the freedoms that the closures leave.

Near a singular configuration, at a distance d from it, a gap of delta in position or velocity
makes an error of delta/d in the accelerations.  A stage of an integrator strays from the closures
by more than the step's error, and such errors would stall it; so a state whose closures' pivots
are small is projected before it is evaluated.  On closed states that changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn import closed_form, dense_dynamics, straightline
from robodyn.actuation import Actuation
from robodyn.formulas import projection_formula
from robodyn.mechanism import Mechanism

Array = NDArray[np.float64]
Rates = Callable[[float, Array], Any]
Projection = Callable[[Array], Array]

STRAIGHT_OPEN = 300  # entries of A up to which straight-line code is the fastest
STRAIGHT_CLOSED = 800  # entries of A and P, where the sparse way also projects every stage
NEAR = 0.1  # relative pivot of a closure below which a state is projected before evaluation
SINGULAR = 1e-6  # relative pivot below which the written-out solve is not trusted
PROJECTION_CUT = 1e-10  # singular values of Psi below this part of the largest are left alone
CONVERGED = 1e-14  # rad; a Newton step of less changes nothing
PASSES = 4


@dataclass(frozen=True, slots=True)
class RightHandSide:
    """The rates dy/dt as a function of t and y, and the projection (None without closures)."""

    rates: Rates
    projection: Projection | None
    kind: str  # straight-line, sparse or dense


def right_hand_side(
    mechanism: Mechanism,
    actuation: Actuation,
    *,
    work: bool = False,
    baumgarte: float = 0.0,
    kind: str | None = None,
) -> RightHandSide:
    """The evaluator of the given kind, or of the kind that is fastest for this mechanism."""
    if kind is None:
        kind = _best_kind(mechanism)
    dense = _dense_rates(mechanism, actuation, work, baumgarte)
    if kind == "dense":
        projection = _dense_projection(mechanism) if mechanism.rows else None
        return RightHandSide(dense, projection, kind)
    if kind == "sparse":
        from robodyn import sparse

        system = sparse.SparseMechanism(mechanism)
        projection = None
        if mechanism.rows:
            projection = sparse.projection(system, _dense_projection(mechanism))
        rates = sparse.rates(system, actuation, work, baumgarte, projection, dense)
        return RightHandSide(rates, projection, kind)
    projection = _straight_projection(mechanism) if mechanism.rows else None

    def compiled(least_pivot: float, otherwise: Rates) -> Rates:
        return straightline.compile_rates(
            mechanism,
            actuation,
            work=work,
            baumgarte=baumgarte,
            least_pivot=least_pivot,
            otherwise=otherwise,
        )

    if projection is None:
        return RightHandSide(compiled(0.0, dense), None, kind)
    if baumgarte:  # its restoring terms need the gap: no state is projected
        return RightHandSide(compiled(SINGULAR, dense), projection, kind)
    near = compiled(SINGULAR, dense)
    project = projection
    rates = compiled(NEAR, lambda t, y: near(t, project(y)))
    return RightHandSide(rates, projection, kind)


def _best_kind(mechanism: Mechanism) -> str:
    if not dense_dynamics.elimination_is_safe(mechanism):
        return "dense"
    terms = len(mechanism.A) + sum(len(row.P) for row in mechanism.rows)
    most = STRAIGHT_CLOSED if mechanism.rows else STRAIGHT_OPEN
    return "straight-line" if terms <= most else "sparse"


def _dense_rates(mechanism: Mechanism, actuation: Actuation, work: bool, baumgarte: float) -> Rates:
    n = mechanism.n
    torques = actuation.function(n)
    damping = np.array(mechanism.damping)

    def rates(t: float, y: Array) -> Array:
        q, qd = y[:n], y[n : 2 * n]
        try:
            tau = np.array(torques(t, y.tolist()))
        except (ArithmeticError, ValueError):  # outside the torque's domain
            return np.full(len(y), np.nan)
        if not np.isfinite(y).all():
            return np.full(len(y), np.nan)
        qdd = dense_dynamics.forward(mechanism, q, qd, tau, baumgarte).qdd
        power = [tau @ qd - damping @ qd**2] if work else []
        return np.concatenate([qd, qdd, power])

    return rates


def _dense_projection(mechanism: Mechanism) -> Projection:
    """The nearest state that closes; directions that the closures hardly hold are left alone."""
    n = mechanism.n

    def project(y: Array) -> Array:
        closed = y.copy()
        q, qd = closed[:n], closed[n : 2 * n]
        for _ in range(PASSES):
            Psi = closed_form.closure_jacobian(mechanism, q)
            step = np.linalg.pinv(Psi, rcond=PROJECTION_CUT) @ closed_form.closure_gap(mechanism, q)
            q -= step
            if np.abs(step).max() <= CONVERGED:
                break
        Psi = closed_form.closure_jacobian(mechanism, q)
        qd -= np.linalg.pinv(Psi, rcond=PROJECTION_CUT) @ (Psi @ qd)
        return closed

    return project


def _straight_projection(mechanism: Mechanism) -> Projection:
    n = mechanism.n
    newton_step = straightline.compile_floats(projection_formula(mechanism), "newton_step")
    dense = _dense_projection(mechanism)

    def project(y: Array) -> Array:
        values: list[float] = y.tolist()
        state = tuple(values[: 2 * n])
        for _ in range(PASSES):
            try:
                out = newton_step(*state)
            except ZeroDivisionError:
                return dense(y)
            if not all(pivot > SINGULAR for pivot in out[2 * n :]):  # nan is no pivot
                return dense(y)
            change = max(abs(new - old) for new, old in zip(out[:n], state, strict=False))
            state = out[: 2 * n]
            if change <= CONVERGED:
                break
        values[: 2 * n] = state
        return np.array(values)

    return project
