"""Closing loops: from the angles of the actuated joints to the angles of all joints.

Passive joints are unknown; a link held to another by an actuated joint turns with it.  A pin that
two unknown links reach is a dyad, closed by intersecting two circles; a slider that one unknown
link reaches, by a circle and a line.  Each has two branches:

               P                     open:    the pin P lies to the left of the line from A to D
             /   \\                   crossed: to the right
           A ----- D                  A: joint of the side named first, D: of the other

               P---- line ---->       open:    P lies ahead of A along the slider's line
             /                        crossed: behind it
           A

Joints that couplings tie to actuated ones are known like these.  Dyads (`dyads.py`) are solved one
after another, each with what the earlier ones fixed.  (Where both unknown links belong to one side,
P is the joint between them.)  Loops that are no chain of dyads are closed by Newton's method along
a path from the scene's `start` configuration.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.closed_form import closure_gap, closure_jacobian
from robodyn.errors import AssemblyError, InputError
from robodyn.loops.closing import NEAR_SINGULAR, half_turn, singular_size
from robodyn.loops.closing import close_positions as close_positions
from robodyn.loops.closing import loop_size as loop_size
from robodyn.loops.dyads import CLOSED as CLOSED
from robodyn.loops.dyads import Plan, coupled_angle, joints_of, solve_dyad
from robodyn.loops.dyads import assembly_plan as assembly_plan
from robodyn.mechanics.mechanism import Mechanism

Array = NDArray[np.float64]

PATH_STEP = 0.02  # rad, step of the actuated joints on the path from `start`
FLAT = 0.1  # sine between the links of a dyad below which the loop may be nearly singular
LEAP = 0.5  # rad; a passive joint that moves more in such a step has left its branch


def assemble(
    mechanism: Mechanism, q_actuated: ArrayLike, branches: Sequence[str] | None = None
) -> Array:
    """All joint angles (..., n) from those of the actuated joints (..., actuated), radians.

    `branches` has "open" or "crossed" for each closure; None takes the scene's.  Raises InputError
    where a joint is neither actuated nor in a loop, and AssemblyError where the loops cannot
    close: it tells the distance missing and the range of the actuated joints that can be reached.
    """
    given = _as_actuated(mechanism, q_actuated)
    q, missing = attempt(mechanism, given, branches)
    flat = missing.reshape(-1)
    if flat.size and not (flat <= 0.0).all():
        worst = int(np.argmax(np.where(np.isnan(flat), np.inf, flat)))
        raise _cannot_close(
            mechanism, given.reshape(-1, given.shape[-1])[worst], float(flat[worst]), branches
        )
    return q


def attempt(
    mechanism: Mechanism, q_actuated: ArrayLike, branches: Sequence[str] | None = None
) -> tuple[Array, Array]:
    """Like `assemble`, but a state that cannot close is told by its missing distance (...), m.

    The distance is zero where the loops close.
    """
    given = _as_actuated(mechanism, q_actuated)
    if branches is None:
        branches = mechanism.description.branches
    plan = assembly_plan(mechanism)
    q, off = _known(mechanism, plan, given)
    missing, flat = np.zeros(given.shape[:-1]), np.zeros(given.shape[:-1], bool)
    for row, each in zip(mechanism.rows[len(mechanism.rows) - len(off) :], off, strict=True):
        missing = np.maximum(missing, row.arm * each)
    known = {*mechanism.actuated, *(joint for joint, _ in plan.coupled)}
    alpha = np.zeros_like(q)  # of unknown links, what they turn ahead of the first of them
    for k in mechanism.order:
        if k in known:
            above = mechanism.parent[k]
            alpha[..., k] = q[..., k] + (0.0 if above is None else alpha[..., above])
    for step in plan.steps:
        side = 1.0 if branches[step.closure] == "open" else -1.0
        angles, short, sine = solve_dyad(mechanism, plan, step, alpha, side)
        missing, flat = np.maximum(missing, short), flat | (sine < FLAT)
        for link, angle in zip(step.unknown, angles, strict=True):
            for k, root in enumerate(plan.turns_with):
                if root == link:
                    alpha[..., k] += angle
    free = {spring.joint: spring.angle for spring in mechanism.joint_springs}
    for k in set(mechanism.passive) - known:
        above, middle = mechanism.parent[k], free.get(k, 0.0)
        relative = alpha[..., k] - (0.0 if above is None else alpha[..., above])
        q[..., k] = half_turn(relative - middle) + middle
    if plan.rest:
        q, short = _from_start(mechanism, q)
        missing = np.maximum(missing, short)
    flat = np.array(flat & (missing <= 0.0))
    if flat.any():  # to the last digit where Psi itself is nearly singular
        s = np.linalg.svd(closure_jacobian(mechanism, q[flat]), compute_uv=False)
        flat[flat] = s[:, -1] < NEAR_SINGULAR * singular_size(mechanism)
        q[flat] = close_positions(mechanism, q[flat], mechanism.actuated)
    return q, missing


def _known(mechanism: Mechanism, plan: Plan, given: Array) -> tuple[Array, list[Array]]:
    """q (..., n) with what is given and follows from couplings, and how far each is off, rad."""
    q = np.zeros((*given.shape[:-1], mechanism.n))
    q[..., list(mechanism.actuated)] = given
    couplings, known = mechanism.description.couplings, set(mechanism.actuated)
    for joint, c in plan.coupled:
        q[..., joint] = coupled_angle(couplings[c], joint, q)
        known.add(joint)
    found = []
    for coupling in couplings:
        wanted = coupled_angle(coupling, coupling.joint, q)
        off = np.abs(q[..., coupling.joint] - wanted)
        kept = off <= CLOSED * (1.0 + np.abs(wanted))
        found.append(np.where(kept | (not joints_of(coupling) <= known), 0.0, off))
    return q, found


def reachable(
    mechanism: Mechanism, q_actuated: ArrayLike, joint: int, branches: Sequence[str] | None = None
) -> list[tuple[float, float]]:
    """Intervals of one actuated joint (by its place among them) in which the loops close, rad.

    The other actuated joints stay as given.  [(-pi, pi)] where all of the circle can be reached.
    """
    if assembly_plan(mechanism).rest:
        return _reachable_from_start(mechanism, np.asarray(q_actuated, float), joint)
    edges = np.linspace(-np.pi, np.pi, 1441)

    def closes(angles: Array) -> NDArray[np.bool_]:
        states = np.repeat(np.asarray(q_actuated, float)[None, :], len(angles), axis=0)
        states[:, joint] = angles
        return np.asarray(attempt(mechanism, states, branches)[1] <= 0.0)

    good = closes(edges)
    if good.all():
        return [(-np.pi, np.pi)]
    changes = np.flatnonzero(good[1:] != good[:-1])
    low, high = edges[changes], edges[changes + 1]
    for _ in range(45):  # bisection of all changes at once
        middle = 0.5 * (low + high)
        same = closes(middle) == good[changes]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    ends = list(0.5 * (low + high))
    if good[0]:  # the interval that runs through pi
        ends = [*ends[1:], ends[0] + 2 * np.pi]
    return list(zip(ends[::2], ends[1::2], strict=True))


# -- larger loops --------------------------------------------------------------------------------


def _from_start(mechanism: Mechanism, q: Array) -> tuple[Array, Array]:
    """Close what is left along a path of the actuated joints from the scene's start."""
    start = mechanism.description.start
    assert start is not None  # the plan checks it
    actuated, passive = list(mechanism.actuated), list(mechanism.passive)
    target = q[..., actuated]
    unsaid = [k for k in actuated if start[k] is None]
    begin = np.broadcast_to([angle or 0.0 for angle in start], q.shape).copy()
    begin[..., unsaid] = q[..., unsaid]
    way = target - begin[..., actuated]
    geared = mechanism.description.couplings
    if not geared:  # turns count where joints are coupled
        way = half_turn(way)
    steps = int(np.ceil(np.abs(way).max(initial=0.0) / PATH_STEP))
    here = close_positions(mechanism, begin, actuated)
    lost = _gap(mechanism, here) > CLOSED
    first = here[..., actuated].copy()
    for s in range(1, steps + 1):
        there = here.copy()
        there[..., actuated] = first + way * (s / steps)
        there = close_positions(mechanism, there, actuated)
        # beyond a limit nothing closes, or only after a leap to another branch: the path ends
        leap = np.abs(there[..., passive] - here[..., passive]).max(axis=-1, initial=0.0) > LEAP
        lost |= leap | (_gap(mechanism, there) > CLOSED)
        here = np.where(lost[..., None], here, there)
    here[..., actuated] = target
    missing = np.maximum(_gap(mechanism, here), CLOSED) * loop_size(mechanism)
    counting = set().union(*map(joints_of, geared))
    turning = [k for k in passive if k not in counting]
    here[..., turning] = half_turn(here[..., turning])
    return here, np.where(lost, missing, 0.0)


def _reachable_from_start(
    mechanism: Mechanism, q_actuated: Array, joint: int
) -> list[tuple[float, float]]:
    """The interval of one actuated joint about its start that a path can reach, rad."""
    start = mechanism.description.start
    assert start is not None  # the plan checks it
    actuated, moved = list(mechanism.actuated), mechanism.actuated[joint]
    here, middle = np.zeros(mechanism.n), start[moved] or 0.0
    here[actuated] = q_actuated
    here[moved] = middle
    here, missing = _from_start(mechanism, here)
    if missing > 0.0:
        return []
    ends = []
    for direction in (-1.0, 1.0):
        at, step = here.copy(), PATH_STEP
        while step > 1e-7 and abs(at[moved] - middle) < np.pi - 1e-9:
            there = at.copy()
            left = np.pi - abs(at[moved] - middle)  # the way round is no shorter
            there[moved] += direction * min(step, left * (1 - 1e-12))
            there = close_positions(mechanism, there, actuated)
            leap = np.abs(there - at).max() > LEAP * step / PATH_STEP
            if leap or _gap(mechanism, there) > CLOSED:
                step /= 4.0  # the limit is nearer than this
            else:
                at = there
        ends.append(float(at[moved]))
    return [(ends[0], ends[1])]


def _gap(mechanism: Mechanism, q: Array) -> Array:
    """How far states (..., n) are open, as a part of the loop's size."""
    gap = np.linalg.norm(closure_gap(mechanism, q), axis=-1)
    return np.asarray(gap / loop_size(mechanism))


# -- input and faults ----------------------------------------------------------------------------


def _within(angle: float, side: int) -> str:
    """An end of a range in degrees, rounded into the range."""
    degrees = float(np.degrees(angle)) * 1e4
    return f"{(np.ceil(degrees) if side > 0 else np.floor(degrees)) / 1e4:.8g}"


def _as_actuated(mechanism: Mechanism, values: ArrayLike) -> Array:
    array = np.asarray(values, float)
    wanted = len(mechanism.actuated)
    if array.ndim == 0 or array.shape[-1] != wanted:
        names = ", ".join(mechanism.link_names[k] for k in mechanism.actuated)
        limit = f"must have {wanted} values along the last axis, one an actuated joint ({names})"
        raise InputError("q_actuated.shape", value=array.shape, limit=limit)
    if not np.isfinite(array).all():
        raise InputError("q_actuated", limit="must be finite")
    return array


def _cannot_close(
    mechanism: Mechanism, given: Array, missing: float, branches: Sequence[str] | None
) -> AssemblyError:
    at = ", ".join(
        f"q{k + 1} = {np.degrees(angle):.6g} deg"
        for k, angle in zip(mechanism.actuated, given, strict=True)
    )
    off = [float(x) for x in _known(mechanism, assembly_plan(mechanism), given)[1]]
    if any(off):
        worst = int(np.argmax(off))
        joint = mechanism.description.couplings[worst].joint
        limit = f"q{joint + 1} would have to be {off[worst]:.6g} rad elsewhere"
        what = f"coupling {worst + 1} cannot be kept at {at}"
        return AssemblyError(what, where=mechanism.source, limit=limit)
    what = f"cannot be closed at {at}: {missing:.6g} m are missing"
    freedoms = mechanism.n - len(mechanism.rows)
    if len(mechanism.actuated) > freedoms:
        limit = f"{len(mechanism.actuated)} joints are actuated, more than the freedoms "
        limit += f"({freedoms}), so their angles depend on one another: "
        limit += f"give all {mechanism.n} angles"
        return AssemblyError(what, where=mechanism.source, limit=limit)
    ranges = []
    for place, k in enumerate(mechanism.actuated):
        intervals = reachable(mechanism, given, place, branches)
        shown = " or ".join(
            f"[{_within(low, 1)}, {_within(high, -1)}] deg" for low, high in intervals
        )
        label = f"q{k + 1} ({mechanism.link_names[k]})"
        ranges.append(f"{label} can reach {shown or 'no angle'}")
    others = " with the other actuated joints as given" if len(ranges) > 1 else ""
    return AssemblyError(what, where=mechanism.source, limit="; ".join(ranges) + others)
