"""In which order loops are closed: what follows from couplings, dyads by turns, the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from robodyn.errors import InputError
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Coupling


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


@lru_cache(maxsize=64)
def assembly_plan(mechanism: Mechanism) -> Plan:
    """The order in which the closures can be solved; InputError where joints are left free."""
    turns_with: list[int | None] = [None] * mechanism.n
    coupled, open_couplings = _resolve_couplings(mechanism)
    given = {*mechanism.actuated, *(joint for joint, _ in coupled)}
    for k in mechanism.order:
        above = mechanism.parent[k]
        turns_with[k] = k if k not in given else None if above is None else turns_with[above]
    loops = [
        _unknown_in_loop(mechanism, turns_with, c)
        for c in range(len(mechanism.description.closures))
    ]
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
        unknown = {c: joints_of(coupling) - known for c, coupling in waiting.items()}
        follows = next((c for c, joints in unknown.items() if len(joints) <= 1), None)
        if follows is None:
            return tuple(found), set().union(*map(joints_of, waiting.values()))
        del waiting[follows]
        found += [(joint, follows) for joint in unknown[follows]]
        known |= unknown[follows]


def joints_of(coupling: Coupling) -> set[int]:
    return {coupling.joint, *(k for k, _ in coupling.terms)}


def _unknown_in_loop(
    mechanism: Mechanism, turns_with: Sequence[int | None], closure: int
) -> list[int]:
    """Unknown links of a closure, along its loop: first side outward, second side inward."""
    row = next(row for row in mechanism.rows if row.closure == closure)
    moved = {k for k, _ in row.P}
    sides = mechanism.description.closures[closure]
    outward = [k for k in mechanism.path(sides.first.link) if k in moved]
    inward = [k for k in reversed(mechanism.path(sides.second.link)) if k in moved]
    unknown: list[int] = []
    for k in [*outward, *inward]:
        root = turns_with[k]
        if root is not None and root not in unknown:
            unknown.append(root)
    return unknown
