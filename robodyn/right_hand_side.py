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
are small is projected before it is evaluated.  On closed states that changes nothing.  A step of
an explicit method that meets such a state is taken again with every stage projected: stages of
one step must not belong to two different extensions of the vector field.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn import closed_form, dense_dynamics, straightline
from robodyn.actuation import Actuation
from robodyn.assembly import loop_size
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
CLOSED = 1.5e-16  # a gap below this part of the loop's size is rounding
PASSES = 4


@dataclass(frozen=True, slots=True)
class RightHandSide:
    """The rates dy/dt as a function of t and y, and the projection (None without closures)."""

    rates: Rates
    projection: Projection | None
    kind: str  # straight-line, sparse or dense
    near: NearSingular | None = None


@dataclass(slots=True)
class NearSingular:
    """Rates that project every state first, and whether a state near a singularity was met.

    `quality` tells the least relative pivot of the closures at a state, about d^2 at a distance d.
    """

    rates: Rates
    quality: Callable[[Array], float]
    met: bool = False


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
    quality = _straight_quality(mechanism)
    trusted = compiled(SINGULAR, dense)
    return _watched(trusted, projection, quality, lambda other: compiled(NEAR, other))


def _watched(
    trusted: Rates,
    project: Projection,
    quality: Callable[[Array], float],
    compiled_near: Callable[[Rates], Rates],
) -> RightHandSide:
    """Rates that project states near a singularity, and tell the solver that they met one."""

    def projected(t: float, y: Array) -> Any:
        near.met = True
        return trusted(t, project(y))

    rates = compiled_near(projected)
    near = NearSingular(lambda t, y: rates(t, project(y)), quality)
    return RightHandSide(rates, project, "straight-line", near)


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
    n, size = mechanism.n, loop_size(mechanism)

    def project(y: Array) -> Array:
        closed = y.copy()
        q, qd = closed[:n], closed[n : 2 * n]
        for _ in range(PASSES):
            gap = closed_form.closure_gap(mechanism, q)
            if np.abs(gap).max() <= CLOSED * size:
                break
            Psi = closed_form.closure_jacobian(mechanism, q)
            q -= np.linalg.pinv(Psi, rcond=PROJECTION_CUT) @ gap
        Psi = closed_form.closure_jacobian(mechanism, q)
        qd -= np.linalg.pinv(Psi, rcond=PROJECTION_CUT) @ (Psi @ qd)
        return closed

    return project


@lru_cache(maxsize=64)
def _newton_step(mechanism: Mechanism) -> straightline.FloatFunction:
    return straightline.compile_floats(projection_formula(mechanism), "newton_step")


def _straight_quality(mechanism: Mechanism) -> Callable[[Array], float]:
    n, r, newton_step = mechanism.n, len(mechanism.rows), _newton_step(mechanism)

    def quality(y: Array) -> float:
        try:
            pivots = newton_step(*y[: 2 * n].tolist())[2 * n + r :]
        except ZeroDivisionError:
            return 0.0
        return min(pivots) if all(pivot > 0.0 for pivot in pivots) else 0.0

    return quality


def _straight_projection(mechanism: Mechanism) -> Projection:
    n, newton_step = mechanism.n, _newton_step(mechanism)
    dense = _dense_projection(mechanism)
    r, rounding = len(mechanism.rows), CLOSED * loop_size(mechanism)

    def project(y: Array) -> Array:
        values: list[float] = y.tolist()
        q, qd = values[:n], values[n : 2 * n]
        for _ in range(PASSES):
            try:
                out = newton_step(*q, *qd)
            except ZeroDivisionError:
                return dense(y)
            gap, pivots = out[2 * n : 2 * n + r], out[2 * n + r :]
            if not all(pivot > SINGULAR for pivot in pivots):  # nan is no pivot
                return dense(y)
            if max(gap) <= rounding and min(gap) >= -rounding:
                break  # what is closed to rounding stays: moving it would add noise
            q = list(out[:n])
        qd = list(out[n : 2 * n])
        return np.array([*q, *qd, *values[2 * n :]])

    return project
