"""In which order loops are closed: what couplings give first, then dyads by turns (`dyads.py`).

What is left is closed by Newton's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from robodyn.errors import InputError
from robodyn.mechanics.planar_model import ClosureRow, Mechanism
from robodyn.scene.scene import Coupling


@dataclass(frozen=True, slots=True)
class Step:
    """A condition of a closure solved for its unknown joints, in the order of the loop.

    The order begins at the closure's first side.  Its rows are those of a pin, that of a line, or
    that of an angle which is kept.
    """

    closure: int
    rows: tuple[ClosureRow, ...]
    unknown: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """How a mechanism is assembled: dyads in order, then what only Newton's method closes."""

    coupled: tuple[tuple[int, int], ...]  # joints that follow from couplings: joint, coupling
    turns_with: tuple[int | None, ...]  # the unknown link that each link turns with; None: known
    steps: tuple[Step, ...]
    rest: tuple[int, ...]  # links left unknown
    two_way: tuple[int, ...]  # the closures that can close in two ways, as the scene lists them


@lru_cache(maxsize=64)
def with_independent(mechanism: Mechanism) -> Mechanism:
    """The mechanism as if the joints that determine all others were its actuated ones.

    If the actuated joints determine all others, it is the mechanism itself.  Else the joints that
    no loop or coupling determines are added, such as the pole of a cart-pole.
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
    """The order in which the closures can be solved; InputError where joints are left free."""
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
    """The plan as far as dyads lead, and the joints that no loop or coupling holds."""
    turns_with: list[int | None] = [None] * mechanism.n
    coupled, open_couplings = _resolve_couplings(mechanism)
    given = {*mechanism.actuated, *(joint for joint, _ in coupled)}
    for k in mechanism.order:
        above = mechanism.above[k]
        turns_with[k] = k if k not in given else None if above is None else turns_with[above]
    for k in mechanism.slides:
        turns_with[k] = None  # it goes along with its frame
    conditions = list(_conditions(mechanism))
    loops = [_unknown_in_loop(mechanism, turns_with, given, c, rows) for c, rows in conditions]
    known: set[int] = set()
    steps: list[Step] = []
    two_way = []
    waiting = set(range(len(loops)))
    while waiting and not open_couplings:
        for i in sorted(waiting):
            step = Step(*conditions[i], tuple(k for k in loops[i] if k not in known))
            if ways := _ways(mechanism, turns_with, step, known):
                steps.append(step)
                two_way += [step.closure] if ways == 2 else []
                known.update(step.unknown)
                waiting.remove(i)
                break
        else:
            break
    rest = tuple(k for k in mechanism.passive if k not in known and k not in given)
    held = set(open_couplings).union(*(loops[i] for i in waiting))
    free = [k for k in rest if k not in held]
    return Plan(coupled, tuple(turns_with), tuple(steps), rest, tuple(sorted(two_way))), free


def _resolve_couplings(mechanism: Mechanism) -> tuple[tuple[tuple[int, int], ...], set[int]]:
    """The joints that follow one after another from actuated ones, each with its coupling.

    And the joints of couplings that do not follow so.
    """
    known = set(mechanism.actuated)
    found: list[tuple[int, int]] = []
    waiting = dict(enumerate(mechanism.description.couplings))
    while True:
        unknown = {c: joints_of(coupling) - known for c, coupling in waiting.items()}
        follows = next((c for c, joints in unknown.items() if len(joints) <= 1), None)
        if follows is None:
            return tuple(found), set().union(*map(joints_of, waiting.values()))
        del waiting[follows]
        found += [(joint, follows) for joint in unknown[follows]]
        known |= unknown[follows]


def _dependent_couplings(mechanism: Mechanism) -> str:
    """Return why couplings alone leave their passive joints open; empty if they do not."""
    import numpy as np  # only an error pays for the import

    couplings = mechanism.description.couplings
    rows = np.zeros((len(couplings), mechanism.n))
    for row, coupling in zip(rows, couplings, strict=True):
        row[coupling.joint] = 1.0
        for k, ratio in coupling.terms:
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


def joints_of(coupling: Coupling) -> set[int]:
    return {coupling.joint, *(k for k, _ in coupling.terms)}


def _conditions(mechanism: Mechanism) -> list[tuple[int, tuple[ClosureRow, ...]]]:
    """Each pin, line and angle that closures ask for, with its closure."""
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
    """The unknown joints of a condition along its loop: the first side outward, then inward."""
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
    """The unknown joint that the direction of X_k turns with, see `Plan`."""
    turned = mechanism.frames[k]
    return None if turned is None else turns_with[turned]


def _ways(
    mechanism: Mechanism, turns_with: Sequence[int | None], step: Step, known: set[int]
) -> int:
    """In how many ways `solve_dyad` closes a condition; 0 where it does not serve."""
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
