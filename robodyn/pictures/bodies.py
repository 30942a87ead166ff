"""The bodies that a picture of a mechanism consists of, each with its shapes in its own frame.

Points of the plane are complex numbers, m.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from robodyn.dynamics.placed import Placed
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.pictures.outlines import (
    CORNERS,
    Shape,
    Way,
    at,
    circle,
    hatched,
    on_ground,
    on_link,
    rails,
    rod,
    rounded_hull,
    slots,
)
from robodyn.scene.scene import Point, Spring
from robodyn.tables.arrays import Complex

SUPPORT = 2.6  # depth of a ground support, half widths
SMALL = 0.6  # of a support that holds a spring alone
TOOTH = 0.9  # of a spring's zigzag in the pose that is drawn, half widths; of 8 teeth or more
MOST_TEETH = 80
WHEEL = 120  # points of a pitch circle
LARGEST_WHEEL = 42.0  # its radius, half widths: the span of the mechanism
LEAD = 0.15  # of a spring, straight on either side, but no longer than this many half widths
LONGEST_LEAD = 2.5
# lines of a damper, a piston in a cylinder: x from end to end, y in half widths
CYLINDER = [0.36 + 1j, 0.64 + 1j, 0.64 - 1j, 0.36 - 1j]
DASHPOT = (CYLINDER, [0.5 + 0.7j, 0.5 - 0.7j], [0j, 0.5], [0.64 + 0j, 1.0])


class Body(NamedTuple):
    """Shapes that move together: with a link, along a slider's line (no turning), or not at all.

    Those of a spring have x = 0 at its `origin` and x = 1 at its `end`.
    """

    link: int | None  # None: the ground, or a spring
    origin: PlanarPoint
    turns: bool
    shapes: tuple[Shape, ...]
    end: PlanarPoint | None = None


def bodies(
    mechanism: Mechanism,
    poses: Placed,
    travelled: Placed,
    w: float,
    marked: Sequence[Point] = (),
) -> Iterator[Body]:
    """The ground first, then guides, links from the ground outward, and blocks and pins that slide.

    `poses` (T, n) are where the mechanism is drawn, `travelled` (S, n) where it goes besides: rails
    and slots are as long as that.  w is half the width of a link.  Outlines of links hold points
    that are `marked`.
    """
    origin = PlanarPoint(0j, ())
    tree = Tree(mechanism.description.links)
    if supports := tuple(_supports(mechanism, poses.E, w)):
        yield Body(None, origin, False, supports)
    if wheels := tuple(_wheels(mechanism, w)):
        yield Body(None, origin, False, wheels)
    closures = mechanism.description.closures
    sliders = [(c, c.along, tree.point(c.first)) for c in closures if c.along is not None]
    for closure, along, sliding in sliders:
        if closure.second.link is None:
            place = closure.second.at
            travel = ((at(sliding, poses.X) - place) * along.conjugate()).real
            way = Way(None, place, along, float(travel.min()), float(travel.max()))
            shapes = on_ground(way, w)
            if closure.first in _spring_ends(mechanism):  # the spring lies where the line would
                shapes = tuple(shape for shape in shapes if shape.kind != "axis")
            yield Body(None, origin, False, shapes)
    ways = list(slots(mechanism, tree, travelled))
    for way in rails(mechanism, travelled):
        if way.link is None:
            yield Body(None, origin, False, on_ground(way, w))
        else:
            way = way.leaving(link_points(mechanism, way.link, marked), w)
        ways.append(way)
    for spring in mechanism.springs:
        yield _spring(bool(spring.stiffness or spring.law), *spring.ends, poses, w)
    for coil in mechanism.joint_springs:
        if (k := coil.joint) in mechanism.slides:
            slid = tree.point(Point(k, 0j))
            yield _spring(bool(coil.stiffness or coil.law), mechanism.pivots[k], slid, poses, w)
    for k in mechanism.order:
        begin = tree.point(Point(k, 0j)) if k in mechanism.slides else mechanism.pivots[k]
        yield Body(k, begin, True, tuple(_link(mechanism, k, ways, w, marked)))
    for closure, along, sliding in sliders:
        link, pin = closure.first.link, Shape("joint", circle(0.55 * w))
        if closure.second.link is None:
            yield Body(link, sliding, False, (Shape("block", CORNERS).moved(0j, w * along), pin))
        elif closure.aligned is None:
            yield Body(link, sliding, False, (pin,))
        else:
            turned = along * cmath.exp(-1j * closure.aligned)
            yield Body(link, sliding, True, (Shape("slider", CORNERS).moved(0j, w * turned), pin))


def _wheels(mechanism: Mechanism, w: float) -> Iterator[Shape]:
    """Gears, pulleys and pinions of couplings between two joints on the ground: pitch circles.

    Of joints that turn against each other these touch; pulleys, which turn alike, are half as large
    together.  A pinion is as large as its rack's way tells, but none that would dwarf the rest.
    """
    links = mechanism.description.links
    for coupling in mechanism.description.couplings:
        pair = [coupling.joint, *(k for k, _ in coupling.terms)]
        if len(pair) != 2 or any(links[k].hangs_from.link is not None for k in pair):
            continue
        ratio = abs(coupling.terms[0][1])
        if not ratio:
            continue
        radii = {pair[0]: 1.0 / ratio, pair[1]: ratio}
        turning = [k for k in pair if not links[k].slides]
        if len(turning) == 2:
            apart = abs(links[pair[0]].hangs_from.at - links[pair[1]].hangs_from.at)
            whole = apart if coupling.terms[0][1] < 0.0 else 0.5 * apart
            radii = {pair[0]: whole / (1.0 + ratio), pair[1]: whole * ratio / (1.0 + ratio)}
        for k in turning:
            if 0.0 < radii[k] <= LARGEST_WHEEL * w:
                yield Shape("wheel", links[k].hangs_from.at + circle(radii[k], WHEEL))


def _spring(pulls: bool, first: PlanarPoint, second: PlanarPoint, poses: Placed, w: float) -> Body:
    """A coil, or a damper, between two points."""
    length = abs(at(second, poses.X)[-1] - at(first, poses.X)[-1])
    lines = [np.array(z, complex) for z in ((_coil(length / w),) if pulls else DASHPOT)]
    shapes = tuple(Shape("spring", z.real + 1j * w * z.imag, False) for z in lines)
    return Body(None, first, True, shapes, second)


def _coil(length: float) -> list[complex]:
    """The zigzag of a spring so long, half widths; x from end to end, y in half widths."""
    lead = min(LEAD, LONGEST_LEAD / max(length, 1.0))
    teeth = int(np.clip((1.0 - 2.0 * lead) * length / TOOTH, 8, MOST_TEETH))
    part = lead + (1.0 - 2.0 * lead) * (np.arange(teeth) + 0.5) / teeth
    zigzag = (part + 1j * (-1.0) ** np.arange(teeth)).tolist()
    return [0j, complex(lead), *zigzag, complex(1.0 - lead), 1.0 + 0j]


def link_points(mechanism: Mechanism, k: int, marked: Sequence[Point] = ()) -> Complex:
    """The points of link k in its frame, m: joint, tip, what hangs, closes, or has a name there.

    Those of it that are `marked` besides.
    """
    found = [0j, complex(mechanism.description.links[k].l), *_attached(mechanism, k)]
    found += [point.at for _, point in mechanism.description.points if point.link == k]
    found += [point.at for point in marked if point.link == k]
    return np.array(list(dict.fromkeys(found)))


def _attached(mechanism: Mechanism, k: int) -> list[complex]:
    """Where on link k other links hang, closures join and springs end."""
    hanging = [link.hangs_from for link in mechanism.description.links]
    points = [*hanging, *_joined(mechanism), *_spring_ends(mechanism)]
    return [point.at for point in points if point.link == k]


def _joined(mechanism: Mechanism) -> list[Point]:
    """The points that closures join; of a slider the one that slides."""
    closures = mechanism.description.closures
    return [c.first for c in closures] + [c.second for c in closures if c.along is None]


def _spring_ends(mechanism: Mechanism) -> list[Point]:
    springs = [s for s in mechanism.description.springs if isinstance(s, Spring)]
    return [end for spring in springs for end in (spring.first, spring.second)]


def _link(
    mechanism: Mechanism, k: int, ways: Sequence[Way], w: float, marked: Sequence[Point]
) -> Iterator[Shape]:
    """Link k with the rails and slots on it, and its own block or rod if it slides."""
    link, closures = mechanism.description.links[k], mechanism.description.closures
    sliding = [c.first.at for c in closures if c.along is not None and c.first.link == k]
    feet = [way.foot() for way in ways if way.link == k and way.joint is None]
    yield Shape("link", rounded_hull([*link_points(mechanism, k, marked), *feet], w))
    for way in ways:
        if way.joint == k:
            yield Shape("slider", CORNERS).moved(0j, w) if way.out is None else rod(way, w)
        if way.link == k:
            yield from on_link(way, w)
    if link.payload and link.l not in sliding:
        yield Shape("payload", link.l + circle(1.5 * w))
    yield Shape("centre", link.r + circle(0.8 * w))
    for begin in (0.0, np.pi):  # two dark quarters
        arc: Complex = 0.8 * w * np.exp(1j * np.linspace(begin, begin + np.pi / 2, 9))
        yield Shape("quarter", link.r + np.append(0j, arc))
    for end in _spring_ends(mechanism):
        if end.link == k:
            yield Shape("tip", end.at + circle(0.3 * w))
    if not link.slides and any(spring.joint == k for spring in mechanism.joint_springs):
        angle = np.linspace(0.0, 4.5 * np.pi, 60)
        spiral: Complex = w * (1.15 + 0.07 * angle) * np.exp(1j * angle)
        yield Shape("spring", spiral, False)
    if link.motor is not None:
        ring = circle(1.3 * w)
        yield Shape("spring", np.append(ring, ring[:2]), False)
    # each pin is drawn once: by the link that hangs there, and by the first side of a closure
    pins = [] if link.slides else [0j]
    for closure in closures:
        one, two = closure.first, closure.second
        own = one if one.link == k else two if two.link == k and one.link is None else None
        if closure.along is None and own is not None:
            pins.append(own.at)
    for pin in pins:
        yield Shape("joint", pin + circle(0.55 * w))
    if link.slides and not any(z == 0 for z in _attached(mechanism, k)):
        yield Shape("tip", circle(0.22 * w))
    if link.l not in (0j, *_attached(mechanism, k)):
        yield Shape("tip", link.l + circle(0.22 * w))


def _supports(mechanism: Mechanism, E: Complex, w: float) -> Iterator[Shape]:
    """A triangle on a hatched line below each ground pivot, or above it if its links hang down."""
    pinned = [(k, x) for k, x in enumerate(mechanism.description.links) if not x.slides]
    joined = [link.hangs_from for _, link in pinned] + _joined(mechanism)
    pivots = [point.at for point in joined if point.link is None]
    springs = [point.at for point in _spring_ends(mechanism) if point.link is None]
    triangle = Shape("support", np.array([0j, -1.7 - 1j * SUPPORT, 1.7 - 1j * SUPPORT]))
    shapes = [triangle, *hatched(-2.7 - 1j * SUPPORT, 2.7 - 1j * SUPPORT, 5)]
    for pivot in dict.fromkeys([*pivots, *springs]):
        size = w * (1.0 if pivot in pivots else SMALL)
        up = [E[:, k].imag.mean() for k, x in pinned if x.hangs_from == Point(None, pivot)]
        if up and np.mean(up) < -0.5:
            yield from (Shape(s.kind, pivot + size * s.points.conj(), s.closed) for s in shapes)
        else:
            yield from (shape.moved(pivot, size) for shape in shapes)
