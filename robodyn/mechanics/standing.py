"""Joints that cannot move, and what holds each: constant couplings, and loops that are trusses.

A link whose path has such joints alone stands still.  Its mass acts on nothing but what holds it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from robodyn.mechanics.link_tree import Tree
from robodyn.scene.scene import Closure, Description

APART = 1e-9  # part of the lengths of a loop that is not rounding


class Holds(NamedTuple):
    """Couplings and closures, by their numbers."""

    couplings: frozenset[int] = frozenset()
    closures: frozenset[int] = frozenset()

    def and_those_of(self, others: list[Holds]) -> Holds:
        """These and others."""
        return Holds(
            self.couplings.union(*(x.couplings for x in others)),
            self.closures.union(*(x.closures for x in others)),
        )


def held_joints(description: Description) -> dict[int, Holds]:
    """Return the joints that cannot move, each with what holds it.

    Those are joints that couplings without the time give by joints that cannot move, and loops of
    one or two joints that turn, unless both could turn about one point.  Joints that larger loops
    hold are not found.
    """
    tree = Tree(description.links)
    held: dict[int, Holds] = {}
    loops = [_joints(tree, closure) for closure in description.closures]
    grown = -1
    while grown < len(held):
        grown = len(held)
        for c, coupling in enumerate(description.couplings):
            new = [k for k in coupling.joints if k not in held]
            given = new == [coupling.joint] or (len(new) == 1 and coupling.law is None)
            if given and not coupling.timed and coupling.cam is None:
                others = [held[k] for k in coupling.joints if k in held]
                held[new[0]] = Holds(couplings=frozenset([c])).and_those_of(others)
        for c, closure in enumerate(description.closures):
            new = [k for k in loops[c] if k not in held]
            if new and _is_truss(tree, closure, new):
                others = [held[k] for k in loops[c] if k in held]
                made = Holds(closures=frozenset([c])).and_those_of(others)
                held |= dict.fromkeys(new, made)
    return held


def standing(description: Description) -> dict[int, Holds]:
    """Return the links that stand still, each with what holds it."""
    tree, held = Tree(description.links), held_joints(description)
    found: dict[int, Holds] = {}
    for k in tree.order:
        above = tree.parent[k]
        if k in held and (above is None or above in found):
            found[k] = held[k].and_those_of([] if above is None else [found[above]])
    return found


def _joints(tree: Tree, closure: Closure) -> set[int]:
    """The joints on the path to one side of a closure only."""
    common = tree.common(closure.first, closure.second)
    return {
        x.link
        for point in (closure.first, closure.second)
        for x in tree.leaves(point, common)
        if x.link is not None and x.link != common
    }


def _is_truss(tree: Tree, closure: Closure, new: list[int]) -> bool:
    """Whether a closure leaves its joints `new`, all others of its loop being held, no motion."""
    if closure.aligned is not None or any(tree.links[k].slides for k in new):
        return False
    if closure.along is not None and (closure.second.link is not None or len(new) > 1):
        return False
    gap = tree.difference(closure.first, closure.second)
    own = {k: abs(c) for k, c in gap.terms if k in new}
    rest = [abs(gap.constant), *(abs(c) for k, c in gap.terms if k not in new)]
    least = APART * (sum(own.values()) + sum(rest))
    if len(own) != len(new) or min(own.values()) <= least:
        return False
    if len(new) == 1:
        return closure.along is None or tree.common(closure.first, closure.second) is None
    return len(new) == 2 and sum(x > least for x in rest) == 1


def unknown_holds(
    description: Description, massless: tuple[int, ...], found: Mapping[int, Holds]
) -> Holds:
    """What holds links without masses against gravity, whose forces nobody knows."""
    if description.gravity == 0 and description.field is None:
        return Holds()
    return Holds().and_those_of([found[k] for k in massless if k in found])
