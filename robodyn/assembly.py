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

Joints that couplings tie to actuated ones are known like these.  Dyads are solved one after
another, each with what the earlier ones fixed.  (Where both unknown
links belong to one side, P is the joint between them.)  Loops that are no chain of dyads are
closed by Newton's method along a path from the scene's `start` configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.closed_form import closure_gap, closure_jacobian
from robodyn.errors import AssemblyError, InputError
from robodyn.mechanism import Mechanism
from robodyn.scene import Coupling

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

CLOSED = 1e-9  # a gap below this part of the loop's lengths counts as rounding
PATH_STEP = 0.02  # rad, step of the actuated joints on the path from `start`
LEAP = 0.5  # rad; a passive joint that moves more in such a step has left its branch
NEWTON_STEPS = 12


@dataclass(frozen=True, slots=True)
class Step:
    """One closure solved for its unknown links, in the order of the loop from its first side."""

    closure: int
    unknown: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """How a mechanism is assembled: dyads in order, then what only Newton's method closes."""

    coupled: tuple[tuple[int, int], ...]  # joints that follow from couplings: joint, coupling
    turns_with: tuple[int | None, ...]  # the unknown link that each link turns with; None: known
    steps: tuple[Step, ...]
    rest: tuple[int, ...]  # links left unknown

    @property
    def two_way(self) -> tuple[int, ...]:
        """The closures that can close in two ways."""
        return tuple(step.closure for step in self.steps if step.unknown)


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
        q[..., joint] = _coupled_angle(mechanism.description.couplings[c], joint, q)
    known = {*mechanism.actuated, *(joint for joint, _ in plan.coupled)}
    alpha = _known_angles(mechanism, known, q)
    missing = np.zeros(given.shape[:-1])
    for step in plan.steps:
        side = 1.0 if branches[step.closure] == "open" else -1.0
        angles, short = _solve(mechanism, plan, step, alpha, side)
        missing = np.maximum(missing, short)
        for link, angle in zip(step.unknown, angles, strict=True):
            for k, root in enumerate(plan.turns_with):
                if root == link:
                    alpha[..., k] += angle
    for k in mechanism.passive:
        if k in known:
            continue
        above = mechanism.parent[k]
        relative = alpha[..., k] - (0.0 if above is None else alpha[..., above])
        q[..., k] = np.remainder(relative + np.pi, 2 * np.pi) - np.pi
    if plan.rest:
        q, short = _from_start(mechanism, q)
        missing = np.maximum(missing, short)
    return q, missing


@lru_cache(maxsize=64)
def assembly_plan(mechanism: Mechanism) -> Plan:
    """The order in which the closures can be solved; InputError where joints are left free."""
    turns_with: list[int | None] = [None] * mechanism.n
    coupled, open_couplings = _resolve_couplings(mechanism)
    given = {*mechanism.actuated, *(joint for joint, _ in coupled)}
    for k in mechanism.order:
        above = mechanism.parent[k]
        turns_with[k] = k if k not in given else None if above is None else turns_with[above]
    loops = [_unknown_in_loop(mechanism, turns_with, c) for c in range(_closures(mechanism))]
    known: set[int] = set()
    steps: list[Step] = []
    waiting = set(range(len(loops)))
    while waiting and not open_couplings:
        for c in sorted(waiting):
            unknown = tuple(k for k in loops[c] if k not in known)
            slider = mechanism.description.closures[c].along is not None
            if len(unknown) <= (1 if slider else 2):
                steps.append(Step(c, unknown))
                known.update(unknown)
                waiting.remove(c)
                break
        else:
            break
    rest = tuple(k for k in mechanism.passive if k not in known and k not in given)
    held = set(open_couplings).union(*(loops[c] for c in waiting))
    free = [k for k in rest if k not in held]
    freedoms = mechanism.n - len(mechanism.rows)
    if len(mechanism.actuated) < freedoms and not free:
        limit = f"{freedoms} freedoms need as many actuated joints, {len(mechanism.actuated)} are "
        limit += f"named: name more in `actuated`, or give all {mechanism.n} joint angles"
        passive = ", ".join(f"q{k + 1} ({mechanism.link_names[k]})" for k in mechanism.passive)
        raise InputError(f"cannot assemble {passive}", where=mechanism.source, limit=limit)
    if free or (rest and mechanism.description.start is None):
        names = ", ".join(f"q{k + 1} ({mechanism.link_names[k]})" for k in free or rest)
        limit = (
            f"neither actuated nor held by a loop: give all {mechanism.n} joint angles"
            if free
            else "in loops that are no chain of two-link closures: add a `start` configuration to "
            f"the scene, or give all {mechanism.n} joint angles"
        )
        raise InputError(f"cannot assemble {names}", where=mechanism.source, limit=limit)
    return Plan(coupled, tuple(turns_with), tuple(steps), rest)


def _resolve_couplings(mechanism: Mechanism) -> tuple[tuple[tuple[int, int], ...], set[int]]:
    """The joints that follow one after another from actuated ones, each with its coupling.

    And the joints of couplings that do not follow so.
    """
    known = set(mechanism.actuated)
    found: list[tuple[int, int]] = []
    waiting = dict(enumerate(mechanism.description.couplings))
    while True:
        unknown = {c: _joints(coupling) - known for c, coupling in waiting.items()}
        follows = next((c for c, joints in unknown.items() if len(joints) <= 1), None)
        if follows is None:
            return tuple(found), set().union(*map(_joints, waiting.values()))
        del waiting[follows]
        found += [(joint, follows) for joint in unknown[follows]]
        known |= unknown[follows]


def _joints(coupling: Coupling) -> set[int]:
    return {coupling.joint, *(k for k, _ in coupling.terms)}


def _coupled_angle(coupling: Coupling, joint: int, q: Array) -> Array:
    """q_joint (...) by a coupling whose other joints are known."""
    ratios = {coupling.joint: -1.0, **dict(coupling.terms)}  # sum of ratio q = -angle
    total = np.full(q.shape[:-1], coupling.angle)
    for k, ratio in ratios.items():
        if k != joint:
            total = total + ratio * q[..., k]
    return -total / ratios[joint]


def close_positions(mechanism: Mechanism, q: ArrayLike, fixed: Sequence[int] = ()) -> Array:
    """The nearest closed configuration by Newton's method, the `fixed` joints held, (..., n).

    Where it does not converge the gap stays; the caller checks it.
    """
    closed = np.array(q, dtype=float)
    free = [k for k in range(mechanism.n) if k not in set(fixed)]
    for _ in range(NEWTON_STEPS):
        gap = closure_gap(mechanism, closed)
        if gap.size == 0 or np.abs(gap).max() <= 1e-16 * loop_size(mechanism):
            break
        inverse = np.linalg.pinv(closure_jacobian(mechanism, closed)[..., free], rcond=1e-12)
        step = np.einsum("...ij,...j->...i", inverse, gap)
        longest = np.abs(step).max(axis=-1, keepdims=True, initial=1e-300)
        closed[..., free] -= step * np.minimum(1.0, 0.5 / longest)
    return closed


def loop_size(mechanism: Mechanism) -> float:
    """The largest sum of lengths in a closure, m: what a gap is measured against."""
    sizes = [row.size + (abs(row.offset) if row.P else 0.0) for row in mechanism.rows]
    return max(sizes, default=0.0)


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


# -- dyads ---------------------------------------------------------------------------------------


def _solve(
    mechanism: Mechanism, plan: Plan, step: Step, alpha: Array, side: float
) -> tuple[list[Array], Array]:
    """The angles of the step's unknown links, and the distance missing (0 where it closes)."""
    rows = [row for row in mechanism.rows if row.closure == step.closure]
    slider = len(rows) == 1
    # gap = K + sum_u c_u E_u over the unknown links u; a slider's is turned onto its line
    turn = 1j if slider else 1.0
    offset = rows[0].offset * 1j if slider else complex(rows[0].offset, rows[1].offset)
    K: Complex = np.full(alpha.shape[:-1], offset, complex)
    c: dict[int, Complex] = {u: np.zeros(alpha.shape[:-1], complex) for u in step.unknown}
    size = sum(abs(p) for _, p in rows[0].P) + abs(offset)
    for k, p in rows[0].P:
        term = turn * p * np.exp(1j * alpha[..., k])
        root = plan.turns_with[k]
        if root in c:
            c[root] += term
        else:
            K = K + term
    tolerance = CLOSED * size
    if not step.unknown:
        gap = np.abs(K.imag) if slider else np.abs(K)
        return [], np.where(gap > tolerance, gap, 0.0)
    first = c[step.unknown[0]]
    if slider:
        across = -K.imag
        square = np.abs(first) ** 2 - across**2
        along = side * np.sqrt(np.maximum(square, 0.0))
        missing = np.abs(across) - np.abs(first)
        angle = np.angle((along + 1j * across) / first)
        return [angle], np.where(missing > tolerance, missing, 0.0)
    if len(step.unknown) == 1:
        missing = np.abs(np.abs(K) - np.abs(first))
        return [np.angle(-K / first)], np.where(missing > tolerance, missing, 0.0)
    second = c[step.unknown[1]]
    ra, rb, d = np.abs(first), np.abs(second), np.abs(K)
    missing = np.maximum(d - (ra + rb), np.abs(ra - rb) - d)
    # P - A = (x + i y) along the unit vector from A to D; Heron's product keeps y exact
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.where(d > 0.0, -K / np.where(d > 0.0, d, 1.0), 1.0)
        x = np.where(d > 0.0, ((ra - rb) * (ra + rb) / d + d) / 2.0, 0.0)
        heron = ((ra + rb) + d) * ((ra + rb) - d) * (d - (ra - rb)) * (d + (ra - rb))
        y = np.where(d > 0.0, np.sqrt(np.maximum(heron, 0.0)) / (2.0 * d), ra)
    arm = unit * (x + 1j * side * y)
    angles = [np.angle(arm / first), np.angle((-K - arm) / second)]
    return angles, np.where(missing > tolerance, missing, 0.0)


def _known_angles(mechanism: Mechanism, known: set[int], q: Array) -> Array:
    """Absolute angles of known links; of the others, what they turn ahead of their unknown."""
    alpha = np.zeros_like(q)
    for k in mechanism.order:
        above = mechanism.parent[k]
        if k in known:
            alpha[..., k] = q[..., k] + (0.0 if above is None else alpha[..., above])
    return alpha


def _unknown_in_loop(
    mechanism: Mechanism, turns_with: Sequence[int | None], closure: int
) -> list[int]:
    """Unknown links of a closure, along its loop: first side outward, second side inward."""
    row = next(row for row in mechanism.rows if row.closure == closure)
    moved = {k for k, _ in row.P}
    sides = mechanism.description.closures[closure]
    outward = [k for k in _path(mechanism, sides.first.link) if k in moved]
    inward = [k for k in reversed(_path(mechanism, sides.second.link)) if k in moved]
    unknown: list[int] = []
    for k in [*outward, *inward]:
        root = turns_with[k]
        if root is not None and root not in unknown:
            unknown.append(root)
    return unknown


def _path(mechanism: Mechanism, link: int | None) -> list[int]:
    """The links from the ground to `link`."""
    path: list[int] = []
    while link is not None:
        path.append(link)
        link = mechanism.parent[link]
    return path[::-1]


def _closures(mechanism: Mechanism) -> int:
    return len(mechanism.description.closures)


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
    counting = set().union(*map(_joints, geared))
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


def _cannot_close(
    mechanism: Mechanism, given: Array, missing: float, branches: Sequence[str] | None
) -> AssemblyError:
    at = ", ".join(
        f"q{k + 1} = {np.degrees(angle):.6g} deg"
        for k, angle in zip(mechanism.actuated, given, strict=True)
    )
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
