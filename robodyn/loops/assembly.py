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
after another, each with what the earlier ones fixed, in the order of `assembly_plan.py`.  (Where
both unknown links belong to one side, P is the joint between them.)  Loops that are no chain of
dyads are closed by Newton's method along a path from the scene's `start` configuration.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.closed_form import closure_gap, closure_jacobian
from robodyn.errors import AssemblyError, InputError
from robodyn.loops.assembly_plan import Plan, joints_of
from robodyn.loops.assembly_plan import assembly_plan as assembly_plan
from robodyn.loops.closing import NEAR_SINGULAR, singular_size
from robodyn.loops.closing import close_positions as close_positions
from robodyn.loops.closing import loop_size as loop_size
from robodyn.loops.dyads import CLOSED as CLOSED
from robodyn.loops.dyads import coupled_angle, known_angles, solve_dyad
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
    q = np.zeros((*given.shape[:-1], mechanism.n))
    q[..., list(mechanism.actuated)] = given
    for joint, c in plan.coupled:
        q[..., joint] = coupled_angle(mechanism.description.couplings[c], joint, q)
    missing, flat = np.zeros(given.shape[:-1]), np.zeros(given.shape[:-1], bool)
    for arm, off in _couplings_off(mechanism, q, plan):
        missing = np.maximum(missing, arm * off)
    known = {*mechanism.actuated, *(joint for joint, _ in plan.coupled)}
    alpha = known_angles(mechanism, known, q)
    for step in plan.steps:
        side = 1.0 if branches[step.closure] == "open" else -1.0
        angles, short, sine = solve_dyad(mechanism, plan, step, alpha, side)
        missing, flat = np.maximum(missing, short), flat | (sine < FLAT)
        for link, angle in zip(step.unknown, angles, strict=True):
            for k, root in enumerate(plan.turns_with):
                if root == link:
                    alpha[..., k] += angle
    free = {spring.joint: spring.angle for spring in mechanism.joint_springs}
    for k in mechanism.passive:
        if k in known:
            continue
        above = mechanism.parent[k]
        relative = alpha[..., k] - (0.0 if above is None else alpha[..., above])
        middle = free.get(k, 0.0)
        q[..., k] = np.remainder(relative - middle + np.pi, 2 * np.pi) - np.pi + middle
    if plan.rest:
        q, short = _from_start(mechanism, q)
        missing = np.maximum(missing, short)
    flat &= missing <= 0.0
    if flat.any():
        q[flat] = _sharpened(mechanism, q[flat])
    return q, missing


def _sharpened(mechanism: Mechanism, q: Array) -> Array:
    """States (k, n) closed to the last digit where Psi itself is nearly singular."""
    s = np.linalg.svd(closure_jacobian(mechanism, q), compute_uv=False)
    near = s[:, -1] < NEAR_SINGULAR * singular_size(mechanism)
    q[near] = close_positions(mechanism, q[near], mechanism.actuated)
    return q


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
    begins_inside = bool(good[0])
    if begins_inside:  # the interval that runs through pi
        ends = [*ends[1:], ends[0] + 2 * np.pi]
    return list(zip(ends[::2], ends[1::2], strict=True))


# -- larger loops --------------------------------------------------------------------------------


def _from_start(mechanism: Mechanism, q: Array) -> tuple[Array, Array]:
    """Close what is left along a path of the actuated joints from the scene's start."""
    given = mechanism.description.start
    assert given is not None  # the plan checks it
    actuated = list(mechanism.actuated)
    target = q[..., actuated]
    start = np.array([0.0 if angle is None else angle for angle in given])
    begin = np.broadcast_to(start, q.shape).copy()
    for place, k in enumerate(actuated):
        if given[k] is None:
            begin[..., k] = target[..., place]
    held = actuated
    way = target - begin[..., actuated]
    geared = mechanism.description.couplings
    if not geared:  # turns count where joints are coupled
        way = np.remainder(way + np.pi, 2 * np.pi) - np.pi
    steps = int(np.ceil(np.abs(way).max(initial=0.0) / PATH_STEP))
    here = close_positions(mechanism, begin, held)
    lost = _open(mechanism, here)
    first = here[..., actuated].copy()
    passive = list(mechanism.passive)
    for s in range(1, steps + 1):
        there = here.copy()
        there[..., actuated] = first + way * (s / steps)
        there = close_positions(mechanism, there, held)
        # beyond a limit nothing closes, or only after a leap to another branch: the path ends
        leap = np.abs(there[..., passive] - here[..., passive]).max(axis=-1, initial=0.0) > LEAP
        lost |= leap | _open(mechanism, there)
        here = np.where(lost[..., None], here, there)
    here[..., actuated] = target
    gap = np.linalg.norm(closure_gap(mechanism, here), axis=-1)
    counting = set().union(*map(joints_of, geared))
    turning = [k for k in passive if k not in counting]
    here[..., turning] = np.remainder(here[..., turning] + np.pi, 2 * np.pi) - np.pi
    return here, np.where(lost, np.maximum(gap, CLOSED * loop_size(mechanism)), 0.0)


def _reachable_from_start(
    mechanism: Mechanism, q_actuated: Array, joint: int
) -> list[tuple[float, float]]:
    """The interval of one actuated joint about its start that a path can reach, rad."""
    start = mechanism.description.start
    assert start is not None  # the plan checks it
    actuated = list(mechanism.actuated)
    target = np.array(q_actuated)
    given = start[actuated[joint]]
    target[joint] = 0.0 if given is None else given
    here = np.zeros(mechanism.n)
    here[actuated] = target
    here, missing = _from_start(mechanism, here)
    if missing > 0.0:
        return []
    ends = []
    for direction in (-1.0, 1.0):
        at, step = here.copy(), PATH_STEP
        while step > 1e-7 and abs(at[actuated[joint]] - target[joint]) < np.pi - 1e-9:
            there = at.copy()
            left = np.pi - abs(at[actuated[joint]] - target[joint])  # the way round is no shorter
            there[actuated[joint]] += direction * min(step, left * (1 - 1e-12))
            there = close_positions(mechanism, there, actuated)
            if np.abs(there - at).max() > LEAP * step / PATH_STEP or _open(mechanism, there):
                step /= 4.0  # the limit is nearer than this
            else:
                at = there
        ends.append(float(at[actuated[joint]]))
    return [(ends[0], ends[1])]


def _open(mechanism: Mechanism, q: Array) -> NDArray[np.bool_]:
    """Which states (..., n) do not close."""
    gap: Array = np.linalg.norm(closure_gap(mechanism, q), axis=-1)
    return np.asarray(gap > CLOSED * loop_size(mechanism))


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


def _couplings_off(mechanism: Mechanism, q: Array, plan: Plan) -> list[tuple[float, Array]]:
    """Of each coupling between known joints its arm, m, and by how much it is not kept, rad."""
    known = {*mechanism.actuated, *(joint for joint, _ in plan.coupled)}
    found: list[tuple[float, Array]] = []
    arms = [row.arm for row in mechanism.rows if row.closure is None]
    for arm, coupling in zip(arms, mechanism.description.couplings, strict=True):
        if not joints_of(coupling) <= known:
            found.append((arm, np.zeros(q.shape[:-1])))
            continue
        wanted = coupled_angle(coupling, coupling.joint, q)
        off = np.abs(q[..., coupling.joint] - wanted)
        size = 1.0 + np.abs(wanted)
        found.append((arm, np.where(off > CLOSED * size, off, 0.0)))
    return found


def _cannot_close(
    mechanism: Mechanism, given: Array, missing: float, branches: Sequence[str] | None
) -> AssemblyError:
    at = ", ".join(
        f"q{k + 1} = {np.degrees(angle):.6g} deg"
        for k, angle in zip(mechanism.actuated, given, strict=True)
    )
    plan = assembly_plan(mechanism)
    q = np.zeros(mechanism.n)
    q[list(mechanism.actuated)] = given
    for joint, c in plan.coupled:
        q[joint] = coupled_angle(mechanism.description.couplings[c], joint, q)
    off = [float(x) for _, x in _couplings_off(mechanism, q, plan)]
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
        limit += (
            f"({freedoms}), so their angles depend on one another: give all {mechanism.n} angles"
        )
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
