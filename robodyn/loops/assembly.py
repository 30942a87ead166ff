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
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.closed_form import closure_gap, scaled_jacobian
from robodyn.errors import AssemblyError, InputError
from robodyn.loops.assembly_plan import Plan, joints_of
from robodyn.loops.assembly_plan import assembly_plan as assembly_plan
from robodyn.loops.closing import NEAR_SINGULAR, half_turn, singular_size, wrapped
from robodyn.loops.closing import close_positions as close_positions
from robodyn.loops.closing import loop_size as loop_size
from robodyn.loops.dyads import CLOSED as CLOSED
from robodyn.loops.dyads import coupled_angle, solve_dyad
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import BRANCHES

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
        branches = scene_branches(mechanism)
    plan = assembly_plan(mechanism)
    q, shorts, sines = by_dyads(mechanism, plan, given, branches)
    missing, flat = np.zeros(given.shape[:-1]), np.zeros(given.shape[:-1], bool)
    for short in shorts:
        missing = np.maximum(missing, short)
    for sine in sines:
        flat = flat | (sine < FLAT)
    if plan.rest:
        q, short = _from_start(mechanism, q)
        missing = np.maximum(missing, short)
    flat = np.array(flat & (missing <= 0.0))
    if flat.any():  # to the last digit where Psi itself is nearly singular
        s = np.linalg.svd(scaled_jacobian(mechanism, q[flat]), compute_uv=False)
        flat[flat] = s[:, -1] < NEAR_SINGULAR * singular_size(mechanism)
        q[flat] = close_positions(mechanism, q[flat], mechanism.actuated)
    return q, missing


def by_dyads(
    mechanism: Mechanism, plan: Plan, given: Array, branches: Sequence[str]
) -> tuple[Array, list[Array], list[Array]]:
    """q (..., n) by the steps of a plan, what each misses (...), m, and their sines.

    What couplings miss comes after the steps.  The numbers of the plan's rows may be arrays that
    broadcast to (...), of a mechanism in each lane.
    """
    q, off = _known(mechanism, plan, given)
    shorts, sines = [], []
    known = {*mechanism.actuated, *(joint for joint, _ in plan.coupled)}
    alpha = np.zeros_like(q)  # of unknown links, what they turn ahead of the first of them
    for k in mechanism.order:
        if k in known:
            above = mechanism.above[k]
            alpha[..., k] = q[..., k] + (0.0 if above is None else alpha[..., above])
    for step in plan.steps:
        side = 1.0 if branches[step.closure] == "open" else -1.0
        angles, short, sine = solve_dyad(mechanism, plan, step, alpha, side)
        shorts.append(short)
        sines.append(sine)
        for link, angle in zip(step.unknown, angles, strict=True):
            if link in mechanism.slides:
                alpha[..., link] = angle
            for k, root in enumerate(plan.turns_with):
                if root == link:
                    alpha[..., k] += angle
    free = {spring.joint: spring.angle for spring in mechanism.joint_springs}
    for k in set(mechanism.passive) - known:
        above, middle = mechanism.above[k], free.get(k, 0.0)
        relative = alpha[..., k] - (0.0 if above is None else alpha[..., above])
        slides = k in mechanism.slides
        q[..., k] = relative if slides else half_turn(relative - middle) + middle
    first = len(mechanism.rows) - len(off)
    shorts += [row.arm * x for row, x in zip(mechanism.rows[first:], off, strict=True)]
    return q, shorts, sines


@lru_cache(maxsize=64)
def scene_branches(mechanism: Mechanism) -> tuple[str, ...]:
    """ "open" or "crossed" for each closure: the scene's words, or what is nearest to its start."""
    start, closures = mechanism.description.start, mechanism.description.closures
    if start is None or len(mechanism.description.branches) == len(closures):
        return mechanism.description.branches
    words = [BRANCHES[0]] * len(closures)
    driven = [start[k] for k in mechanism.actuated]
    plan = assembly_plan(mechanism)
    if any(x is None for x in driven):
        return tuple(words)
    for step in plan.steps:  # each follows from those before it alone
        told = [k for k in step.unknown if start[k] is not None]
        if step.closure not in plan.two_way or not told:
            continue
        away = []
        for word in BRANCHES:
            words[step.closure] = word
            q = attempt(mechanism, np.array(driven, float), words)[0]
            way = wrapped(mechanism, q - np.array([x or 0.0 for x in start]))
            away.append(float(np.abs(way[told]).max()))
        words[step.closure] = BRANCHES[int(np.argmin(away))]
    return tuple(words)


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
    slides = mechanism.actuated[joint] in mechanism.slides
    if assembly_plan(mechanism).rest:
        return _reachable_from_start(mechanism, np.asarray(q_actuated, float), joint)
    span = farthest(mechanism) if slides else np.pi
    edges = np.linspace(-span, span, 1441)

    def closes(values: Array) -> NDArray[np.bool_]:
        states = np.repeat(np.asarray(q_actuated, float)[None, :], len(values), axis=0)
        states[:, joint] = values
        return np.asarray(attempt(mechanism, states, branches)[1] <= 0.0)

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


def farthest(mechanism: Mechanism) -> float:
    """A displacement that no loop of the mechanism reaches, m."""
    links = mechanism.description.links
    sides = [x for c in mechanism.description.closures for x in (c.first.at, c.second.at)]
    return sum(abs(x.l) + abs(x.hangs_from.at) for x in links) + sum(map(abs, sides)) or 1.0


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
    geared, units = mechanism.description.couplings, mechanism.arrays.units
    for place, k in enumerate(actuated):
        if not geared and k not in mechanism.slides:  # turns count where joints are coupled
            way[..., place] = half_turn(way[..., place])
    steps = int(np.ceil(np.abs(way / units[actuated]).max(initial=0.0) / PATH_STEP))
    here = close_positions(mechanism, begin, actuated)
    lost = _gap(mechanism, here) > CLOSED
    first = here[..., actuated].copy()
    for s in range(1, steps + 1):
        there = here.copy()
        there[..., actuated] = first + way * (s / steps)
        there = close_positions(mechanism, there, actuated)
        # beyond a limit nothing closes, or only after a leap to another branch: the path ends
        moved = np.abs(there[..., passive] - here[..., passive]) / units[passive]
        leap = moved.max(axis=-1, initial=0.0) > LEAP
        lost |= leap | (_gap(mechanism, there) > CLOSED)
        here = np.where(lost[..., None], here, there)
    here[..., actuated] = target
    missing = np.maximum(_gap(mechanism, here), CLOSED) * loop_size(mechanism)
    counting = set().union(*map(joints_of, geared))
    turning = [k for k in passive if k not in counting and k not in mechanism.slides]
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
    slides, units = moved in mechanism.slides, mechanism.arrays.units
    unit = float(units[moved])
    most = farthest(mechanism) if slides else np.pi
    for direction in (-1.0, 1.0):
        at, step = here.copy(), PATH_STEP * unit
        while step > 1e-7 * unit and abs(at[moved] - middle) < most - 1e-9 * unit:
            there = at.copy()
            left = most - abs(at[moved] - middle)  # the way round is no shorter
            there[moved] += direction * min(step, left * (1 - 1e-12))
            there = close_positions(mechanism, there, actuated)
            leap = np.abs((there - at) / units).max() > LEAP * step / (PATH_STEP * unit)
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


def _within(mechanism: Mechanism, joint: int, value: float, side: int) -> str:
    """An end of a range in degrees, or in m, rounded into the range."""
    scaled = (value if joint in mechanism.slides else float(np.degrees(value))) * 1e4
    return f"{(np.ceil(scaled) if side > 0 else np.floor(scaled)) / 1e4:.8g}"


def _shown(mechanism: Mechanism, joint: int, value: float) -> str:
    if joint in mechanism.slides:
        return f"q{joint + 1} = {value:.6g} m"
    return f"q{joint + 1} = {np.degrees(value):.6g} deg"


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
    pairs = zip(mechanism.actuated, given, strict=True)
    at = ", ".join(_shown(mechanism, k, value) for k, value in pairs)
    off = [float(x) for x in _known(mechanism, assembly_plan(mechanism), given)[1]]
    if any(off):
        worst = int(np.argmax(off))
        joint = mechanism.description.couplings[worst].joint
        unit = "m" if joint in mechanism.slides else "rad"
        limit = f"q{joint + 1} would have to be {off[worst]:.6g} {unit} elsewhere"
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
        unit = "m" if k in mechanism.slides else "deg"
        shown = " or ".join(
            f"[{_within(mechanism, k, low, 1)}, {_within(mechanism, k, high, -1)}] {unit}"
            for low, high in intervals
        )
        label = f"q{k + 1} ({mechanism.link_names[k]})"
        nothing = "no displacement" if k in mechanism.slides else "no angle"
        ranges.append(f"{label} can reach {shown or nothing}")
    others = " with the other actuated joints as given" if len(ranges) > 1 else ""
    return AssemblyError(what, where=mechanism.source, limit="; ".join(ranges) + others)
