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

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.errors import AssemblyError, InputError, SingularPoseError
from robodyn.loops.assembly_plan import assembly_plan as assembly_plan
from robodyn.loops.branches import all_branches as all_branches
from robodyn.loops.branches import scene_branches as scene_branches
from robodyn.loops.branches import scene_start
from robodyn.loops.closing import NEAR_SINGULAR, singular_size
from robodyn.loops.closing import close_positions as close_positions
from robodyn.loops.closing import loop_size as loop_size
from robodyn.loops.closures import closure_gap, scaled_jacobian
from robodyn.loops.dyads import CLOSED as CLOSED
from robodyn.loops.dyads import known_joints
from robodyn.loops.loop_rates import check_closed
from robodyn.loops.path_from_start import (
    closed_near,
    farthest,
    from_start,
    reachable_from_start,
)
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import actuated_wide
from robodyn.scene.scene import BRANCHES
from robodyn.tables.arrays import Array

MOST_TRIED = 6  # closures whose branches are tried for another way to close
ROUNDING = 1e-15  # part of the loop's size, of a gap
FLAT = 0.1  # sine between the links of a dyad below which the loop may be nearly singular


def assemble(
    mechanism: Mechanism,
    q_actuated: ArrayLike,
    branches: Sequence[str] | None = None,
    *,
    t: ArrayLike,
) -> Array:
    """Return all joint positions (..., n) from those of the actuated joints (..., actuated).

    Positions are in rad, or m for joints that slide.  Joints driven by laws of time take their
    values at t (...), s.  `branches` has "open" or "crossed" for each closure; None takes the
    scene's.  Raises InputError if a joint is neither actuated nor in a loop, SingularError if the
    loops close with a joint at any value, and AssemblyError if they cannot close; its message has
    the missing distance and the range in which the actuated joints can move.
    """
    given, closures = _as_actuated(mechanism, q_actuated), mechanism.description.closures
    given_all = branches is None or len(branches) == len(closures)
    if not given_all or not set(branches or ()) <= set(BRANCHES):
        limit = f"must be {len(closures)}, one a closure, each {' or '.join(BRANCHES)}"
        raise InputError("branches", value=", ".join(branches or ()), limit=limit)
    q, missing = attempt(mechanism, given, branches, t=t)
    flat = missing.reshape(-1)
    if flat.size and not (flat <= 0.0).all():
        worst = int(np.argmax(np.where(np.isnan(flat), np.inf, flat)))
        state = given.reshape(len(flat), given.shape[-1])[worst]
        if np.isnan(flat[worst]):
            raise _undetermined(mechanism, state, q.reshape(-1, mechanism.n)[worst])
        now = float(np.broadcast_to(np.asarray(t, float), missing.shape).ravel()[worst])
        raise _cannot_close(mechanism, state, float(flat[worst]), branches, now)
    return q


def attempt(
    mechanism: Mechanism,
    q_actuated: ArrayLike,
    branches: Sequence[str] | None = None,
    watch: Callable[[float], object] | None = None,
    *,
    t: ArrayLike,
) -> tuple[Array, Array]:
    """Like `assemble`, but return also the distance (...) by which each state fails to close, m.

    The distance is 0 if the loops close, and nan if they close with a joint at any value.  `watch`
    is called with the finished part of a path from the scene's start.
    """
    given = _as_actuated(mechanism, q_actuated)
    if branches is None:
        branches = scene_branches(mechanism)
    plan = assembly_plan(mechanism)
    if plan.rest:
        q, missing, sines = from_start(mechanism, plan, given, branches, watch, t=t)
    else:
        q = np.zeros((*given.shape[:-1], mechanism.n))
        q[..., list(mechanism.actuated)] = given
        q, missing, sines = closed_near(mechanism, plan, q, branches, t=t)
    flat = np.zeros(given.shape[:-1], bool)
    for sine in sines:
        flat = flat | (sine < FLAT)
    flat = np.array(flat & (missing <= 0.0))
    times = np.broadcast_to(np.asarray(t, float), flat.shape)
    if flat.any():  # to the last digit where Psi itself is nearly singular
        s = np.linalg.svd(scaled_jacobian(mechanism, q[flat], times[flat]), compute_uv=False)
        flat[flat] = s[:, -1] < NEAR_SINGULAR * singular_size(mechanism)
        now = times[flat]
        found = close_positions(mechanism, q[flat], mechanism.actuated, t=now)
        both = (closure_gap(mechanism, x, now) for x in (q[flat], found))
        before, after = (np.abs(gap).max(axis=-1) for gap in both)
        # where a loop is too short by rounding nothing closes, and Newton's method wanders off
        closed = after <= np.maximum(0.1 * before, ROUNDING * loop_size(mechanism))
        q[flat] = np.where(closed[..., None], found, q[flat])
    return q, missing


def first_pose(mechanism: Mechanism, *, t: float) -> Array:
    """Return a closed configuration (n,) at t to begin in.

    It is the scene's start, zeros, or the first pose tried that closes.  A start that does not
    close with its own actuated joints is closed with all joints free.  Poses tried are turns of all
    actuated joints by multiples of 30 deg, and displacements by quarters of the mechanism's length.
    Raises AssemblyError if none closes, and InputError if the actuated joints do not determine the
    others and the start is not closed.
    """
    start = mechanism.description.start or (None,) * mechanism.n
    whole = np.array([value or 0.0 for value in start])
    if not mechanism.rows:
        return whole
    try:
        assembly_plan(mechanism)
    except InputError:
        if check_closed(mechanism, whole, t=t) is None:
            return whole
        raise
    slides = np.isin(mechanism.actuated, mechanism.slides)
    turns = np.arange(12) * np.pi / 6 if not slides.all() else np.zeros(1)
    ways = np.array([0.0, *(sign * k for k in range(1, 13) for sign in (1, -1))])
    ways = 0.25 * mechanism.unit * ways if slides.any() else np.zeros(1)
    given = np.array([start[k] or 0.0 for k in mechanism.actuated])
    if not len(given):
        return assemble(mechanism, given, t=t)
    steps = np.where(slides, ways[:, None, None], turns[:, None])
    with np.errstate(all="ignore"):  # a link without length has no direction
        q, missing = attempt(mechanism, given + steps.reshape(-1, len(given)), t=t)
    closes = np.flatnonzero(missing <= 0.0)
    begin = scene_start(mechanism)
    if begin is not None and begin.closed and missing[0] > 0.0:
        return begin.q
    if not closes.size:
        limit = "no pose found that closes: give --q"
        raise AssemblyError("cannot be closed", where=mechanism.source, limit=limit)
    pose: Array = q[closes[0]]
    return pose


def reachable(
    mechanism: Mechanism,
    q_actuated: ArrayLike,
    joint: int,
    branches: Sequence[str] | None = None,
    *,
    t: float,
) -> list[tuple[float, float]]:
    """Return the intervals of one actuated joint in which the loops close, rad or m.

    `joint` is its index among the actuated joints; the others keep their values.  If the full
    circle can be reached, the result is `[(-pi, pi)]`.
    """
    slides = mechanism.actuated[joint] in mechanism.slides
    plan = assembly_plan(mechanism)
    if plan.rest:
        words = scene_branches(mechanism) if branches is None else branches
        given = np.asarray(q_actuated, float)
        return reachable_from_start(mechanism, plan, given, joint, words, t)
    span = farthest(mechanism) if slides else np.pi
    edges = np.linspace(-span, span, 1441)

    def closes(values: Array) -> NDArray[np.bool_]:
        states = np.repeat(np.asarray(q_actuated, float)[None, :], len(values), axis=0)
        states[:, joint] = values
        return np.asarray(~(attempt(mechanism, states, branches, t=t)[1] > 0.0))

    good = closes(edges)
    if good.all():
        return [(-span, span)]
    changes = np.flatnonzero(good[1:] != good[:-1])
    low, high = edges[changes], edges[changes + 1]
    for _ in range(45):  # bisection of all changes at once
        middle = 0.5 * (low + high)
        same = closes(middle) == good[changes]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    ends = list(0.5 * (low + high))
    if slides:
        ends = [*([-span] if good[0] else []), *ends, *([span] if good[-1] else [])]
    elif good[0]:  # the interval that runs through pi
        ends = [*ends[1:], ends[0] + 2 * np.pi]
    return list(zip(ends[::2], ends[1::2], strict=True))


# -- input and faults ----------------------------------------------------------------------------


def _within(mechanism: Mechanism, joint: int, value: float, side: int) -> str:
    """Format an end of a range in degrees, or m, rounded towards the inside of the range."""
    scaled = (value if joint in mechanism.slides else float(np.degrees(value))) * 1e4
    return f"{(np.ceil(scaled) if side > 0 else np.floor(scaled)) / 1e4:.8g}"


def _as_actuated(mechanism: Mechanism, values: ArrayLike) -> Array:
    array = actuated_wide(mechanism, "q_actuated", values)
    if not np.isfinite(array).all():
        raise InputError("q_actuated", limit="must be finite")
    return array


def _told(mechanism: Mechanism, given: Array) -> str:
    """Format the actuated joints of a state with names, in degrees or m."""
    return ", ".join(
        f"q{k + 1} = " + (f"{x:.6g} m" if k in mechanism.slides else f"{np.degrees(x):.6g} deg")
        for k, x in zip(mechanism.actuated, given, strict=True)
    )


def _undetermined(mechanism: Mechanism, given: Array, q: Array) -> SingularPoseError:
    """Return the error for a state whose joints with nan in q (n,) are undetermined."""
    names = [f"q{k + 1} ({mechanism.link_names[k]})" for k in np.flatnonzero(np.isnan(q))]
    limit = f"the actuated joints do not determine {', '.join(names) or 'the others'} here: "
    limit += f"give all {mechanism.n} joint angles, or another configuration"
    what = f"singular configuration at {_told(mechanism, given)}"
    return SingularPoseError(what, where=mechanism.source, limit=limit)


def _cannot_close(
    mechanism: Mechanism, given: Array, missing: float, branches: Sequence[str] | None, t: float
) -> AssemblyError:
    at = _told(mechanism, given)
    if mechanism.driven:
        at = ", ".join(filter(None, (at, f"t = {t:.9g} s")))
    off = [float(x) for x in known_joints(mechanism, assembly_plan(mechanism), given, t)[1]]
    if any(off):
        worst = int(np.argmax(off))
        joint = mechanism.description.couplings[worst].joint
        unit = "m" if joint in mechanism.slides else "rad"
        limit = f"q{joint + 1} would have to be {off[worst]:.6g} {unit} elsewhere"
        what = f"coupling {worst + 1} cannot be kept at {at}"
        return AssemblyError(what, where=mechanism.source, limit=limit)
    what = f"cannot be closed at {at}: {missing:.6g} m are missing"
    freedoms = mechanism.n - len(mechanism.rows)
    spans = [reachable(mechanism, given, j, branches, t=t) for j in range(len(mechanism.actuated))]
    if len(spans) > freedoms and not any(spans):
        limit = f"{len(spans)} joints are actuated, more than the freedoms "
        limit += f"({freedoms}), so their angles depend on one another: "
        limit += f"give all {mechanism.n} angles"
        return AssemblyError(what, where=mechanism.source, limit=limit)
    ranges = []
    for k, intervals in zip(mechanism.actuated, spans, strict=True):
        unit = "m" if k in mechanism.slides else "deg"
        shown = " or ".join(
            f"[{_within(mechanism, k, low, 1)}, {_within(mechanism, k, high, -1)}] {unit}"
            for low, high in intervals
        )
        label = f"q{k + 1} ({mechanism.link_names[k]})"
        nothing = "no displacement" if k in mechanism.slides else "no angle"
        ranges.append(f"{label} can reach {shown or nothing}")
    others = " with the other actuated joints as given" if len(ranges) > 1 else ""
    if words := _closing(mechanism, given, t):
        others += f"; with assembly [{', '.join(words)}] it closes"
    return AssemblyError(what, where=mechanism.source, limit="; ".join(ranges) + others)


def _closing(mechanism: Mechanism, given: Array, t: float) -> tuple[str, ...]:
    """Return branches with which the loops close, if the scene's branches do not; else ()."""
    few = len(assembly_plan(mechanism).two_way) <= MOST_TRIED
    ways = all_branches(mechanism) if few else ()
    return next((way for way in ways if attempt(mechanism, given, way, t=t)[1] <= 0.0), ())
