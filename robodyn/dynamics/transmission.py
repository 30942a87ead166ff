"""Transmission angles of loops, and ratios of rates.

A loop is closed by three pairs in a row, each with a centre of rotation; that of a line is far
away, across the line.  The transmission angle lies at the middle one, between the directions to
the outer two: 90 degrees where a force is handed on best, 0 or 180 where nothing is.  Of a
four-bar it is the angle between coupler and rocker, of a slider-crank that between the rod and
the normal of the slider's way.  Between a turning slot and its pin it lies between the line of the
outer centres and the slot's normal.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.closed_form import points_of
from robodyn.dynamics.named_points import unit_rates
from robodyn.errors import InputError
from robodyn.loops.assembly_plan import assembly_plan, with_independent
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint, joint_index
from robodyn.mechanics.placed import Placed, absolute_rates, frame_rates, placed
from robodyn.scene.scene import Closure
from robodyn.scene.yaml_values import nearest
from robodyn.tables.arrays import Array, Complex
from robodyn.tables.csv_fields import shown

STANDS = 1e-14  # part of the joint rates that a link's rate is the sum of, below which it stands


class Pair(NamedTuple):
    """What joins two links: a pin, or a line along a unit vector of a frame (None: ground)."""

    pin: PlanarPoint | None
    along: complex = 1.0 + 0j
    frame: int | None = None

    def direction(self, at: Placed) -> Complex:
        """Across the line, (...): where its centre lies."""
        across: Complex = np.full(at.X.shape[:-1], 1j * self.along)
        return across if self.frame is None else across * at.E[..., self.frame]


def transmission_loops(mechanism: Mechanism) -> dict[int, tuple[Pair, Pair, Pair]]:
    """The three pairs that close each loop, by its closure; those of other loops are left out."""
    try:
        steps = {
            step.closure: step.unknown for step in assembly_plan(mechanism).dyads if step.unknown
        }
    except InputError:  # joints are left free: no plan, but each pin has the joints beside it
        steps = {}
    found = {}
    for c, closure in enumerate(mechanism.description.closures):
        sides = [mechanism.path(point.link) for point in (closure.first, closure.second)]
        joints = steps.get(c, tuple(path[-1] for path in sides if path))
        chain = _chain(mechanism, closure, sides, joints)
        if len(chain) == 3:
            found[c] = chain[0], chain[1], chain[2]
    return found


def _chain(
    mechanism: Mechanism, closure: Closure, sides: list[list[int]], joints: Sequence[int]
) -> list[Pair]:
    """The pairs at these joints and the closure, along the loop from its first side."""
    tree = Tree(mechanism.description.links)

    def pair(k: int) -> Pair:
        if k not in mechanism.slides:
            return Pair(mechanism.pivots[k])
        return Pair(None, tree.phases[k], tree.frames[k])

    first = [pair(k) for k in sides[0] if k in joints and k not in sides[1]]
    second = [pair(k) for k in reversed(sides[1]) if k in joints and k not in sides[0]]
    closing = [Pair(tree.point(closure.first))]
    if closure.along is not None:
        k = closure.second.link
        along = closure.along if k is None else tree.turned(k, closure.along)
        line = Pair(None, along, None if k is None else tree.frames[k])
        closing = [line] if closure.aligned is not None else [*closing, line]
    return [*first, *closing, *second]


def transmission_angles(
    mechanism: Mechanism, loops: Sequence[tuple[Pair, Pair, Pair]], q: ArrayLike
) -> Array:
    """The transmission angle of each of some loops (l of them) at q (..., n), (..., l) rad."""
    at = placed(mechanism, q)
    turns = [turn_between(mechanism, at, *loop) for loop in loops]
    return np.stack([np.abs(np.angle(turn)) for turn in turns], axis=-1)


def turn_between(mechanism: Mechanism, at: Placed, first: Pair, middle: Pair, last: Pair) -> Any:
    """A complex number whose angle is that from `last` to `first`, seen from the middle pair.

    Of numbers (...), or of formulas where these are in `at`.
    """

    def to(pair: Pair, origin: Pair) -> Any:
        if pair.pin is None or origin.pin is None:
            return (pair if pair.pin is None else origin).direction(at)
        ends = points_of(mechanism, [pair.pin, origin.pin]).place(at)
        return ends[..., 0] - ends[..., 1]

    if middle.pin is None:
        outer = (last, first) if first.pin is not None else (first, last)
        one, two = to(*outer), middle.direction(at)
    else:
        one, two = to(first, middle), to(last, middle)
    return np.multiply(one, two.conjugate())


class Ratio(NamedTuple):
    """The rate of one link over that of another: of its turn, or along its axis."""

    name: str
    of: int
    over: int


def ratio_named(mechanism: Mechanism, text: str) -> Ratio:
    """The ratio of two links, `rocker/crank`; InputError where they are none."""
    links = joint_index(mechanism)
    for k, letter in enumerate(text):
        if letter == "/" and text[:k] in links and text[k + 1 :] in links:
            return Ratio(text, links[text[:k]], links[text[k + 1 :]])
    words = text.split("/")
    if len(words) != 2:
        raise InputError("ratio", value=shown(text), limit="must be two links, rocker/crank")
    wrong = next(word for word in words if word not in links)
    limit = f"{shown(wrong)} names no link{nearest(wrong, list(links))}"
    raise InputError("ratio", value=shown(text), limit=limit)


def rate_ratios(
    mechanism: Mechanism, ratios: Sequence[Ratio], q: ArrayLike, qd: ArrayLike, t: ArrayLike
) -> Array:
    """Each of some ratios (r of them) at q, qd (..., n), (..., r); of one freedom, at any rate.

    A ratio is NaN if the link that is divided by does not move, but for rounding.
    """
    driver, rates = with_independent(mechanism), np.asarray(qd, float)
    if len(driver.actuated) == 1:
        rates = unit_rates(driver, q, t)[..., 0]
    turns, sums = (
        frame_rates(mechanism, absolute_rates(mechanism, x)) for x in (rates, np.abs(rates))
    )
    for k in mechanism.slides:
        turns[..., k], sums[..., k] = rates[..., k], np.abs(rates[..., k])
    found = []
    for ratio in ratios:
        below, parts = turns[..., ratio.over], sums[..., ratio.over]
        stands = np.abs(below) <= STANDS * parts
        found.append(np.where(stands, np.nan, turns[..., ratio.of] / np.where(stands, 1.0, below)))
    return np.stack(found, axis=-1)
