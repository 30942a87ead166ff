"""The order in which loops are closed: couplings first, then dyads one by one (`dyads.py`).

Other loops are closed by Newton's method, followed by the dyads that depend on them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from robodyn.errors import InputError
from robodyn.mechanics.planar_model import ClosureRow, Mechanism


@dataclass(frozen=True, slots=True)
class Step:
    """A closure condition to be solved for its unknown joints, in the order of the loop.

    The order starts at the closure's first side.  Its rows are those of a pin (two), of a line, or
    of a fixed angle.
    """

    closure: int
    rows: tuple[ClosureRow, ...]
    unknown: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """The steps to assemble a mechanism: dyads in order, Newton's method, dependent dyads."""

    coupled: tuple[tuple[int, int], ...]  # joints that follow from couplings: joint, coupling
    known: frozenset[int]  # the joints that are known before the steps
    turns_with: tuple[int | None, ...]  # the unknown link that each link turns with; None: known
    steps: tuple[Step, ...]
    two_way: tuple[int, ...]  # the closures that can close in two ways, as the scene lists them
    rest: tuple[int, ...] = ()  # joints that Newton's method finds
    rows: tuple[int, ...] = ()  # the rows of Psi by which it does
    behind: Plan | None = None  # the dyads for which the joints in `rest` must be known

    @property
    def later(self) -> tuple[int, ...]:
        """Joints found by Newton's method or by the dyads that follow it."""
        more = [k for step in (self.behind.steps if self.behind else ()) for k in step.unknown]
        return *self.rest, *more

    @property
    def dyads(self) -> tuple[Step, ...]:
        """All steps, including those that follow Newton's method."""
        return self.steps + (self.behind.steps if self.behind else ())


@lru_cache(maxsize=64)
def with_independent(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism with a set of actuated joints that determines all others.

    It is the mechanism itself if its actuated joints do.  Otherwise joints that no loop or coupling
    determines are added, such as the pole of a cart-pole.
    """
    plan, free = _order(mechanism)
    few = len(mechanism.actuated) < mechanism.n - len(mechanism.rows)
    if not (free or (few and plan.rest)):
        return mechanism
    followers = {coupling.joint for coupling in mechanism.description.couplings}
    more = free or sorted(plan.rest, key=lambda k: k in followers)[:1]
    return with_independent(
        replace(mechanism, actuated=tuple(sorted((*mechanism.actuated, *more))))
    )


@lru_cache(maxsize=64)
def assembly_plan(mechanism: Mechanism) -> Plan:
    """Return the order in which to solve the closures; InputError if joints are left free."""
    plan, free = _order(mechanism)
    freedoms = mechanism.n - len(mechanism.rows)
    if len(mechanism.actuated) < freedoms and not free:
        limit = f"{freedoms} freedoms need as many actuated joints, {len(mechanism.actuated)} are "
        limit += f"named: name more in `actuated`, or give all {mechanism.n} joint angles"
        passive = ", ".join(f"q{k + 1} ({mechanism.link_names[k]})" for k in mechanism.passive)
        raise InputError(f"cannot assemble {passive}", where=mechanism.source, limit=limit)
    if free or (plan.rest and mechanism.description.start is None):
        names = ", ".join(f"q{k + 1} ({mechanism.link_names[k]})" for k in free or plan.rest)
        limit = (
            f"neither actuated nor held by a loop: give all {mechanism.n} joint angles"
            if free
            else _dependent_couplings(mechanism)
            or "in loops that are no chain of two-link closures: add a `start` configuration to "
            f"the scene, or give all {mechanism.n} joint angles"
        )
        raise InputError(f"cannot assemble {names}", where=mechanism.source, limit=limit)
    return plan


def _order(mechanism: Mechanism) -> tuple[Plan, list[int]]:
    """Return the plan, and the joints that no loop or coupling determines."""
    coupled, open_couplings = _resolve_couplings(mechanism)
    given = {*mechanism.actuated, *(joint for joint, _ in coupled)}
    turns_with = _turns_with(mechanism, given)
    conditions = list(_conditions(mechanism))
    loops = [_unknown_in_loop(mechanism, turns_with, given, c, rows) for c, rows in conditions]
    known: set[int] = set()
    steps: list[Step] = []
    two_way = []
    waiting = set(range(len(loops)))
    while waiting:
        for i in sorted(waiting):
            step = Step(*conditions[i], tuple(k for k in loops[i] if k not in known))
            if open_couplings.isdisjoint(step.unknown) and (
                ways := _ways(mechanism, turns_with, step, known)
            ):
                steps.append(step)
                two_way += [step.closure] if ways == 2 else []
                known.update(step.unknown)
                waiting.remove(i)
                break
        else:
            break
    rest = {k for k in mechanism.passive if k not in known and k not in given}
    held = set(open_couplings).union(*(loops[i] for i in waiting))
    free = sorted(rest - held)
    unknown = {i: [k for k in loops[i] if k not in known] for i in waiting}
    behind = _behind(mechanism, {i: (conditions[i], unknown[i]) for i in waiting}, open_couplings)
    if behind is not None:
        two_way += behind.two_way
        rest -= {k for step in behind.steps for k in step.unknown}
        waiting = {i for i in waiting if not any(s.rows == conditions[i][1] for s in behind.steps)}
    rows = {id(row) for i in waiting for row in conditions[i][1]}
    first, follows = len(mechanism.rows), {c for _, c in coupled}
    first -= len(mechanism.description.couplings)
    closed_by_newton = tuple(
        r
        for r, row in enumerate(mechanism.rows)
        if id(row) in rows or (r >= first and r - first not in follows)
    )
    plan = Plan(
        coupled,
        frozenset(given),
        turns_with,
        tuple(steps),
        tuple(sorted(two_way)),
        tuple(sorted(rest)),
        closed_by_newton if rest else (),
        behind if rest else None,
    )
    return plan, free


def _turns_with(mechanism: Mechanism, given: Collection[int]) -> tuple[int | None, ...]:
    """Return the unknown joint that each link turns with; None if its direction is known."""
    found: list[int | None] = [None] * mechanism.n
    for k in mechanism.order:
        above = mechanism.above[k]
        found[k] = k if k not in given else None if above is None else found[above]
    for k in mechanism.slides:
        found[k] = None  # it goes along with its frame
    return tuple(found)


def _behind(
    mechanism: Mechanism,
    waiting: dict[int, tuple[tuple[int, tuple[ClosureRow, ...]], list[int]]],
    open_couplings: set[int],
) -> Plan | None:
    """Return the plan of dyads whose unknown joints appear in no other waiting condition."""
    left: dict[int, tuple[tuple[int, tuple[ClosureRow, ...]], list[int]]] = dict(waiting)
    found: list[tuple[int, list[int]]] = []
    while True:
        for i, (condition, loop) in left.items():
            others = open_couplings.union(*(joints for j, (_, joints) in left.items() if j != i))
            own = [k for k in loop if k not in others]
            if own and len(own) == len(condition[1]) < len(loop):
                found.insert(0, (i, own))
                del left[i]
                break
        else:
            break
    while found:
        unknown = {k for _, own in found for k in own}
        known = frozenset(range(mechanism.n)) - unknown
        turns_with, solved = _turns_with(mechanism, known), set[int]()
        steps, two_way = [], []
        for place, (i, own) in enumerate(found):
            step = Step(*waiting[i][0], tuple(own))
            ways = _ways(mechanism, turns_with, step, solved)
            if not ways:
                found = found[place + 1 :]  # a dyad on it has Newton's method before it as well
                break
            steps.append(step)
            two_way += [step.closure] if ways == 2 else []
            solved.update(own)
        else:
            return Plan((), known, turns_with, tuple(steps), tuple(sorted(two_way)))
    return None


def _resolve_couplings(mechanism: Mechanism) -> tuple[tuple[tuple[int, int], ...], set[int]]:
    """Return joints that follow from actuated ones, each with its coupling, in order.

    The second result is the set of joints in couplings that do not follow.
    """
    known = set(mechanism.actuated)
    found: list[tuple[int, int]] = []
    waiting = dict(enumerate(mechanism.description.couplings))
    while True:
        unknown = {c: set(coupling.joints - known) for c, coupling in waiting.items()}
        # a law tells its own joint alone
        sure = (c for c, joints in unknown.items() if len(joints) <= 1)
        follows = next(
            (c for c in sure if waiting[c].law is None or unknown[c] <= {waiting[c].joint}), None
        )
        if follows is None:
            return tuple(found), set().union(*(x.joints for x in waiting.values()))
        del waiting[follows]
        found += [(joint, follows) for joint in unknown[follows]]
        known |= unknown[follows]


def _dependent_couplings(mechanism: Mechanism) -> str:
    """Return why couplings leave their passive joints undetermined, or ""."""
    import numpy as np  # only an error pays for the import

    couplings = mechanism.description.couplings
    rows = np.zeros((len(couplings), mechanism.n))
    for row, coupling in zip(rows, couplings, strict=True):
        row[coupling.joint] = 1.0
        for k, ratio in coupling.ratios:
            row[k] -= ratio
    for last in range(1, len(rows) + 1):
        some = rows[:last]
        U, s, _ = np.linalg.svd(some[:, list(mechanism.passive)])
        rank = int((s > 1e-9 * max(1.0, *s)).sum())
        if rank == last:
            continue
        weights = U[:, -1]
        used = np.flatnonzero(np.abs(weights) > 1e-9)
        told = " and ".join(f"couplings[{k}]" for k in used)
        fixed = np.flatnonzero(np.abs(weights @ some) > 1e-9)
        if not len(fixed):
            return f"{told} repeat one another, or contradict: leave out one of them"
        joints = ", ".join(f"q{k + 1} ({mechanism.link_names[k]})" for k in fixed)
        return f"{told} fix {joints}, which is actuated: leave out one of them"
    return ""


def _conditions(mechanism: Mechanism) -> list[tuple[int, tuple[ClosureRow, ...]]]:
    """Return each pin, line and fixed angle of the closures, with its closure."""
    found: list[tuple[int, tuple[ClosureRow, ...]]] = []
    for row in mechanism.rows:
        if row.closure is None:
            continue
        if row.direction == 1j and found and found[-1][0] == row.closure:  # the pin's other row
            found[-1] = row.closure, (*found[-1][1], row)
        else:
            found.append((row.closure, (row,)))
    return found


def _unknown_in_loop(
    mechanism: Mechanism,
    turns_with: Sequence[int | None],
    given: set[int],
    closure: int,
    rows: Sequence[ClosureRow],
) -> list[int]:
    """Return a condition's unknown joints along its loop: first side out, second in."""
    moved = {k for k, _ in (*rows[0].P, *rows[0].angles)} | {rows[0].line}
    sides = mechanism.description.closures[closure]
    found: dict[int, None] = {}
    for joint in (*mechanism.path(sides.first.link), *reversed(mechanism.path(sides.second.link))):
        for k in (mechanism.frames[joint], joint):
            if k is None or k not in moved:
                continue
            if (root := root_of(mechanism, turns_with, k)) is not None:
                found[root] = None
            if k in mechanism.slides and k not in given:
                found[k] = None
    return list(found)


def root_of(mechanism: Mechanism, turns_with: Sequence[int | None], k: int) -> int | None:
    """Return the unknown joint with which the direction of X_k turns; see `Plan.turns_with`."""
    turned = mechanism.frames[k]
    return None if turned is None else turns_with[turned]


def _ways(
    mechanism: Mechanism, turns_with: Sequence[int | None], step: Step, known: set[int]
) -> int:
    """Return in how many ways `solve_dyad` can close a condition; 0 if it cannot."""
    row, slides = step.rows[0], mechanism.slides
    turning = [k for k in step.unknown if k not in slides]
    roots = {root_of(mechanism, turns_with, k) for k, _ in row.P} - known
    if len(step.rows) == 2:
        if len(step.unknown) > 2:
            return 0
        return 2 if turning and len(step.unknown) == 2 else 1
    if len(step.unknown) > 1:
        return 0
    if not turning or row.arm:
        return 1
    line = None if row.line is None else root_of(mechanism, turns_with, row.line)
    return 0 if line is not None and line in roots else 2
