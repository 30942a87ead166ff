"""Rates and accelerations of closed loops, checks of given states, singular configurations.

    Psi qd = 0        Psi qdd + Psidot qd = 0

Given the rates of the actuated joints, the passive ones follow from the columns Psi_p of Psi.
Psi_p loses rank at a **dead centre**: the actuated joints cannot move the mechanism, or hold it.
Psi itself loses rank at a **change point**: the mechanism gains a freedom there.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from robodyn.engines.coupling_laws import check_laws, law_values
from robodyn.errors import InputError
from robodyn.loops.change_points import (
    NEAR,
    apart,
    nearest_singular,
    nearness,
    rank,
    rank_beside,
)
from robodyn.loops.closing import loop_size, singular_at
from robodyn.loops.closures import (
    absolute_jacobian,
    closure_bias,
    closure_drift,
    drift_at,
    gap_at,
    scaled_jacobian,
)
from robodyn.loops.projection import state_led_across
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import (
    Placed,
    absolute_rates,
    actuated_wide,
    as_states,
    matvec,
    placed,
)
from robodyn.tables.arrays import Array

SINGULAR = 1e-7  # a least singular value below this part of the loop's size is singular
LITTLE_HOLD = 0.05  # such a value of the passive joints: torques beside a dead centre grow large
REDUNDANT = 1e-10  # singular values below this part of the largest one are rounding
AT_SINGULAR = 1e-5  # rad, from a singular configuration within which rates are those at it
BENT = 100.0  # part of themselves that rates may change by in a rad along a branch
GAP_ALLOWED = 1e-6  # part of the loop's size (or of the terms of a rate) that input may miss


def loop_velocities(
    mechanism: Mechanism, q: ArrayLike, qd_actuated: ArrayLike, t: ArrayLike
) -> Array:
    """Return all joint rates (..., n) from those of the actuated joints (..., actuated).

    In rad/s or m/s. q (..., n) is a closed configuration.  Raises SingularError at a dead centre or
    change point.
    """
    q = as_states(mechanism, "q", q)
    given = actuated_wide(mechanism, "qd_actuated", qd_actuated)
    drift = closure_drift(mechanism, q, t) if mechanism.driven else 0.0
    return closing_rates(mechanism, q, given, drift, t)


def loop_accelerations(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd_actuated: ArrayLike, t: ArrayLike
) -> Array:
    """Return all joint accelerations (..., n) from those of the actuated joints.

    In rad/s^2 or m/s^2. q and qd (..., n) are closed.  Raises SingularError at a dead centre or
    change point.  Next to a change point, the accelerations belong to the motion that leads across
    it.
    """
    q, given = (
        as_states(mechanism, "q", q),
        actuated_wide(mechanism, "qdd_actuated", qdd_actuated),
    )
    found = closing_rates(mechanism, q, given, closure_bias(mechanism, q, qd, t), t)
    if not mechanism.rows or not found.size:
        return found
    q, rates = (np.broadcast_to(x, found.shape) for x in (q, np.asarray(qd, float)))
    near = nearness(mechanism, scaled_jacobian(mechanism, q, t)) < NEAR
    for state in map(tuple, np.argwhere(near)):
        chosen = found[state][list(mechanism.actuated)]

        def beside(q: Array, qd: Array, chosen: Array = chosen) -> Array:
            there = closing_rates(mechanism, q, chosen, closure_bias(mechanism, q, qd, 0.0), 0.0)
            return np.hstack([there, qd**2])  # what they are small against: they may all vanish

        led = state_led_across(mechanism, q[state], rates[state], beside)
        if led is not None:
            found[state] = led[: mechanism.n]
    return found


def nearest_velocities(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, t: ArrayLike) -> Array:
    """Return the rates (..., n) nearest to qd that keep the closures at a closed q."""
    Psi = scaled_jacobian(mechanism, q, t)
    rates = as_states(mechanism, "qd", qd)
    units = mechanism.arrays.units
    opening = matvec(Psi, rates / units)
    if mechanism.driven:
        opening = opening + closure_drift(mechanism, q, t)
    return np.asarray(rates - units * matvec(np.linalg.pinv(Psi, rcond=REDUNDANT), opening))


def singular_kind(mechanism: Mechanism, q: ArrayLike, t: float) -> str:
    """Return "dead centre", "change point", or "" for one closed configuration q (n,)."""
    if not mechanism.rows:
        return ""
    Psi, passive = scaled_jacobian(mechanism, q, t), list(mechanism.passive)
    least = float(_smallest(mechanism, Psi[:, passive])) if passive else 0.0
    if least > SINGULAR:
        return ""
    if _smallest(mechanism, Psi) <= SINGULAR:
        near = nearest_singular(mechanism, np.asarray(q, float))
        if near is None or not near.misses:
            return "change point"
        if least > REDUNDANT:
            return ""
    return "dead centre" if passive else ""


def near_dead_centre(mechanism: Mechanism, q: Array, t: float) -> bool:
    """Return whether the actuated joints hardly hold the others at q (n, or a state)."""
    passive = list(mechanism.passive)
    if not mechanism.rows or not passive:
        return False
    return bool(
        _smallest(mechanism, scaled_jacobian(mechanism, q[: mechanism.n], t)[:, passive])
        < LITTLE_HOLD
    )


def check_way_on(mechanism: Mechanism, q: Array, qd: Array) -> None:
    """Raise SingularError for the first of the states (T, n) at rest at a change point.

    From there the mechanism can move on in two ways; a moving one has chosen its way.  Closures
    that are dependent everywhere make no change point.
    """
    resting = q[~np.any(qd, axis=-1)]
    if not mechanism.rows or mechanism.driven or not len(resting):
        return
    ranks = rank(mechanism, scaled_jacobian(mechanism, resting, 0.0))
    for state, here in zip(resting, ranks, strict=True):
        if here < len(mechanism.rows) and rank_beside(mechanism, state, 1e-3, 4) > here:
            limit = "the mechanism can go on in two ways: its acceleration is not unique"
            raise singular_at(mechanism, "change point", state, limit)


def check_closed(
    mechanism: Mechanism,
    q: Array,
    qd: Array | None = None,
    qdd: Array | None = None,
    *,
    t: ArrayLike,
) -> tuple[int, InputError] | None:
    """Return index and error of the first state (..., n) that violates the closures, or None."""
    if not mechanism.rows or q.size == 0:
        return None
    if mechanism.laws:
        check_laws(mechanism, q, None, np.broadcast_to(np.asarray(t, float), q.shape[:-1]))
    sizes, at = _sizes(mechanism), placed(mechanism, q)
    opening = gap_at(mechanism, mechanism.arrays, at, t) + _turned_over(mechanism, at)
    fault = _first_open(mechanism, "position", "m", opening, loop_size(mechanism), q, q, t)
    if fault is not None or qd is None:
        return fault
    rates, Psi = absolute_rates(mechanism, qd), absolute_jacobian(mechanism, at, t)
    fastest = np.abs(rates).max(axis=-1, keepdims=True)
    opening, size = matvec(Psi, rates), sizes * fastest
    if mechanism.driven:
        drift = drift_at(mechanism, at, t)
        opening, size = opening + drift, size + np.abs(drift)
    fault = _first_open(mechanism, "velocity", "m/s", opening, size, q, qd, t)
    if not mechanism.driven:
        fault = fault or _first_impossible(mechanism, q, np.asarray(qd, float), Psi)
    if fault is not None or qdd is None:
        return fault
    turning = absolute_rates(mechanism, qdd)
    bias = closure_bias(mechanism, q, qd, t)
    size = sizes * (np.abs(turning).max(axis=-1, keepdims=True) + fastest**2)
    if mechanism.laws:
        size = size + np.abs(bias)
    bending = matvec(Psi, turning) + bias
    return _first_open(mechanism, "acceleration", "m/s^2", bending, size, q, qdd, t)


def _first_open(
    mechanism: Mechanism,
    what: str,
    unit: str,
    gap: Array,
    size: Array | float,
    q: Array,
    given: Array,
    t: ArrayLike,
) -> tuple[int, InputError] | None:
    """Return index and error of the first state with a gap (..., r) beyond tolerance.

    `given` (..., n) are the joint values that cause the gap.
    """
    wrong = np.abs(gap) > GAP_ALLOWED * size
    if not wrong.any():
        return None
    state = int(np.flatnonzero(wrong.any(axis=-1))[0])
    most = np.broadcast_to(GAP_ALLOWED * size, gap.shape).reshape(-1, gap.shape[-1])[state]
    open = gap.reshape(-1, gap.shape[-1])[state]
    each = np.broadcast_arrays(q, given, np.empty((*gap.shape[:-1], mechanism.n)))
    at, own = (x.reshape(-1, mechanism.n)[state] for x in each[:2])
    now = float(np.broadcast_to(np.asarray(t, float), gap.shape[:-1]).ravel()[state])
    return state, _open(mechanism, open, what, unit, float(most.min()), (at, own, now))


def _first_impossible(
    mechanism: Mechanism, q: Array, qd: Array, Psi: Array
) -> tuple[int, InputError] | None:
    """Return index and error of the first state with rates that no motion has.

    This is possible where Psi loses rank.  With u a left null vector of Psi there, no acceleration
    closes u . gapdd = u . (Psidot qd).
    """
    r, n = Psi.shape[-2:]
    units, size = mechanism.arrays.units, loop_size(mechanism)
    flat = (Psi * units / size).reshape(-1, r, n)
    squares = flat @ np.swapaxes(flat, -1, -2)
    # few states have so small a determinant: the others cost no singular values
    others = np.trace(squares, axis1=-2, axis2=-1) ** (r - 1)
    found = np.flatnonzero(np.linalg.det(squares) <= (10.0 * AT_SINGULAR) ** 2 * others)
    if not len(found):
        return None
    q, qd = (np.broadcast_to(x, (*Psi.shape[:-2], n)).reshape(-1, n) for x in (q, qd))
    close = nearness(mechanism, scaled_jacobian(mechanism, q[found], 0.0)) < 10.0 * AT_SINGULAR
    for state in found[close]:
        near = nearest_singular(mechanism, q[state])
        away = np.inf if near is None or near.misses else float(apart(mechanism, q[state], near.q))
        if near is None or away > AT_SINGULAR:
            continue
        U, s, _ = np.linalg.svd(scaled_jacobian(mechanism, near.q, 0.0))
        left = U[:, int(np.sum(s > SINGULAR * size)) :]
        gap = float(np.linalg.norm(closure_bias(mechanism, near.q, qd[state], 0.0) @ left))
        fastest = float(np.abs(absolute_rates(mechanism, qd[state]) / units).max())
        most = (GAP_ALLOWED + BENT * away) * size * fastest**2
        if gap > most:
            limit = f"{most:.3g} m/s^2 at most, whatever the accelerations: at this singular "
            limit += "configuration give the rates of a motion along one of its branches"
            what, value = "no motion has these rates: gap in acceleration", f"{gap:.6g} m/s^2"
            error = InputError(what, where=mechanism.source, value=value, limit=limit)
            return int(state), error
    return None


@lru_cache(maxsize=64)
def _sizes(mechanism: Mechanism) -> Array:
    """Return the sum of the sizes of each row's terms, (r,), m."""
    return np.array([row.size for row in mechanism.rows])


def _turned_over(mechanism: Mechanism, at: Placed) -> Array | float:
    """Return an addition to the gap (..., r), m, for fixed angles that are off by half a turn.

    Their gap is a sine, which vanishes there too.
    """
    kept = [r for r, row in enumerate(mechanism.rows) if row.closure is not None and row.arm]
    if not kept:
        return 0.0
    more = np.zeros((*at.x.shape[:-1], len(mechanism.rows)))
    for r in kept:
        row = mechanism.rows[r]
        line = 1.0 if row.line is None else at.E[..., row.line].conj()
        cosine = (1j * line * (row.ground + at.X @ mechanism.arrays.P[r])).real
        more[..., r] = np.where(cosine < 0.0, 2.0 * row.arm, 0.0)
    return more


def _open(
    mechanism: Mechanism,
    gap: Array,
    what: str,
    unit: str,
    most: float,
    state: tuple[Array, Array, float],
) -> InputError:
    """Return the error for a state whose closures or couplings are open by `gap` (r,).

    `state` is q (n,), the joint values (n,) that cause the gap, and t.
    """
    q, given, t = state
    limit = "give a closed motion of this mechanism, or the actuated joints only "
    limit += "(the rest is assembled)"
    pins = [k for k, row in enumerate(mechanism.rows) if row.closure is not None]
    apart = np.abs(gap[pins]).max(initial=0.0)
    if apart > GAP_ALLOWED * loop_size(mechanism) or not mechanism.description.couplings:
        value = f"{np.linalg.norm(gap[pins]):.6g} {unit}"
        told = f"the loops are open: gap in {what}"
        most_told = f"{most:.3g} {unit} at most: {limit}"
        return InputError(told, where=mechanism.source, value=value, limit=most_told)
    arms = np.array([row.arm if row.closure is None else np.inf for row in mechanism.rows])
    turns = np.abs(gap / arms)
    worst = int(np.argmax(turns)) - len(pins)
    joint = mechanism.description.couplings[worst].joint
    own = unit if joint in mechanism.slides else unit.replace("m", "rad", 1)
    law = mechanism.description.couplings[worst].law
    if law is not None:
        wanted = float(given[joint] - (gap / arms)[worst + len(pins)])
        if what == "position":  # but for what rounding takes of the difference
            wanted = float(law_values(mechanism, worst, q, t))
        by = "" if what == "position" else f"{what} by its "
        when = f" at t = {t:.9g} s" if "t" in law.names else ""
        limit = f"its {by}law {law.text} is {wanted:.9g} {own}{when}; {limit}"
    return InputError(
        f"coupling {worst + 1} does not hold: q{joint + 1} is off in {what}",
        value=f"{turns.max():.6g} {own}",
        limit=limit,
    )


def _smallest(mechanism: Mechanism, Psi: Array) -> Array:
    """Return the least singular value of Psi, or of some of its columns, over the loop's size."""
    s = np.linalg.svd(Psi, compute_uv=False)
    return np.asarray(s[..., -1] / loop_size(mechanism), dtype=float)


def closing_rates(
    mechanism: Mechanism, q: Array, actuated: Array, bias: Array | float, t: ArrayLike
) -> Array:
    """Return x with Psi x = -bias for given actuated components."""
    driven, passive = list(mechanism.actuated), list(mechanism.passive)
    values = np.zeros((*np.broadcast_shapes(q.shape[:-1], actuated.shape[:-1]), mechanism.n))
    values[..., driven] = actuated
    if not passive:
        return values
    if len(passive) > len(mechanism.rows) and (np.any(actuated) or np.any(bias)):
        limit = f"{len(driven)} actuated joints do not determine the {len(passive)} others: "
        limit += "name more in `actuated`, or give the values of all joints"
        raise InputError("rates", where=mechanism.source, limit=limit)
    q = np.broadcast_to(q, values.shape)
    Psi = scaled_jacobian(mechanism, q, t)
    units = mechanism.arrays.units
    right = -matvec(Psi[..., driven], values[..., driven] / units[driven]) - bias
    if not np.any(right):
        return values
    columns = Psi[..., passive]
    singular = (_smallest(mechanism, columns) <= SINGULAR) & np.any(right != 0.0, axis=-1)
    for state in map(tuple, np.argwhere(singular)):
        near = nearest_singular(mechanism, q[state])
        if near is not None and near.misses and _smallest(mechanism, columns[state]) > REDUNDANT:
            continue  # as near as the loops ever come, and right to eps/s
        limit = "the actuated joints do not determine the motion of the others here; "
        limit += "give the values of all joints, or another configuration"
        raise singular_at(
            mechanism,
            singular_kind(
                mechanism,
                q[state],
                float(np.broadcast_to(np.asarray(t, float), values.shape[:-1])[state]),
            ),
            q[state],
            limit,
        )
    values[..., passive] = units[passive] * matvec(np.linalg.pinv(columns), right)
    return values
