"""The bodies that a picture of a mechanism consists of, each with its shapes in its own frame.

Points of the plane are complex numbers, m.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.scene.scene import Point, Spring

Complex = NDArray[np.complex128]

ARC = 15  # points of half a circle
SUPPORT = 2.6  # depth of a ground support, half widths
SMALL = 0.6  # of a support that holds a spring alone
# lines of a spring and of a damper, a piston in a cylinder: x from end to end, y in half widths
COIL = ([0j, 0.15, *(0.15 + 0.7 * (k + 0.5) / 8 + 1j * (-1) ** k for k in range(8)), 0.85, 1.0],)
CYLINDER = [0.36 + 1j, 0.64 + 1j, 0.64 - 1j, 0.36 - 1j]
DASHPOT = (CYLINDER, [0.5 + 0.7j, 0.5 - 0.7j], [0j, 0.5], [0.64 + 0j, 1.0])


class Shape(NamedTuple):
    """A polygon, or a line that stays open, in the frame of its body, m.

    Kinds: link, joint, tip, centre, quarter, payload, block, spring, support, hatch, guide, axis.
    """

    kind: str
    points: Complex  # (p,)
    closed: bool = True

    def moved(self, place: complex, turn: complex) -> Shape:
        return Shape(self.kind, place + turn * self.points, self.closed)


class Body(NamedTuple):
    """Shapes that move together: with a link, along a slider's line (no turning), or not at all.

    Those of a spring have x = 0 at its `origin` and x = 1 at its `end`.
    """

    link: int | None  # None: the ground, or a spring
    origin: PlanarPoint
    turns: bool
    shapes: tuple[Shape, ...]
    end: PlanarPoint | None = None


def bodies(mechanism: Mechanism, E: Complex, w: float) -> Iterator[Body]:
    """The ground first, then guides, links from the ground outward, and the sliders' blocks.

    E (T, n) are the links' directions at all poses, w is half the width of a link.
    """
    origin = PlanarPoint(0j, ())
    yield Body(None, origin, False, tuple(_supports(mechanism, E, w)))
    closures, point = mechanism.description.closures, Tree(mechanism.description.links).point
    sliders = [(c, c.along, point(c.first)) for c in closures if c.along is not None]
    for closure, along, sliding in sliders:
        travel = ((at(sliding, E) - closure.second.at) * along.conjugate()).real / w
        guide = _guide(float(travel.min()), float(travel.max()))
        shapes = tuple(shape.moved(closure.second.at, w * along) for shape in guide)
        yield Body(None, origin, False, shapes)
    for spring in mechanism.springs:
        lines = [np.array(z, complex) for z in (COIL if spring.stiffness else DASHPOT)]
        shapes = tuple(Shape("spring", z.real + 1j * w * z.imag, False) for z in lines)
        yield Body(None, spring.ends[0], True, shapes, spring.ends[1])
    for k in mechanism.order:
        yield Body(k, mechanism.pivots[k], True, tuple(_link(mechanism, k, w)))
    corners = np.array([-2.4 - 1.5j, 2.4 - 1.5j, 2.4 + 1.5j, -2.4 + 1.5j])
    for closure, along, sliding in sliders:
        shapes = (Shape("block", w * along * corners), Shape("joint", circle(0.55 * w)))
        yield Body(closure.first.link, sliding, False, shapes)


def at(point: PlanarPoint, E: Complex) -> Complex:
    """Where a point of the mechanism is, (...), m, with the links' directions E (..., n)."""
    z = np.full(E.shape[:-1], point.constant, complex)
    for k, coefficient in point.terms:
        z = z + coefficient * E[..., k]
    return z


def link_points(mechanism: Mechanism, k: int) -> Complex:
    """The points of link k in its frame: its joint, its tip, and what hangs or closes there, m."""
    found = [0j, complex(mechanism.description.links[k].l), *_attached(mechanism, k)]
    return np.array(list(dict.fromkeys(found)))


def _attached(mechanism: Mechanism, k: int | None) -> list[complex]:
    """Where on link k, or on the ground, other links hang, closures join and springs end."""
    hanging = [link.hangs_from for link in mechanism.description.links]
    points = [*hanging, *_joined(mechanism), *_spring_ends(mechanism)]
    return [point.at for point in points if point.link == k]


def _joined(mechanism: Mechanism) -> list[Point]:
    """The points that closures join; of a slider the one that slides."""
    closures = mechanism.description.closures
    pairs = [(c.first, c.second) if c.along is None else (c.first,) for c in closures]
    return [point for pair in pairs for point in pair]


def _spring_ends(mechanism: Mechanism) -> list[Point]:
    springs = [s for s in mechanism.description.springs if isinstance(s, Spring)]
    return [end for spring in springs for end in (spring.first, spring.second)]


def _link(mechanism: Mechanism, k: int, w: float) -> Iterator[Shape]:
    link, closures = mechanism.description.links[k], mechanism.description.closures
    sliding = [c.first.at for c in closures if c.along is not None and c.first.link == k]
    yield Shape("link", rounded_hull(link_points(mechanism, k), w))
    if link.payload and link.l not in sliding:
        yield Shape("payload", link.l + circle(1.5 * w))
    yield Shape("centre", link.r + circle(0.8 * w))
    for begin in (0.0, np.pi):  # two dark quarters
        arc: Complex = 0.8 * w * np.exp(1j * np.linspace(begin, begin + np.pi / 2, 9))
        yield Shape("quarter", link.r + np.append(0j, arc))
    for end in _spring_ends(mechanism):
        if end.link == k:
            yield Shape("tip", end.at + circle(0.3 * w))
    if any(spring.joint == k for spring in mechanism.joint_springs):
        angle = np.linspace(0.0, 4.5 * np.pi, 60)
        spiral: Complex = w * (1.15 + 0.07 * angle) * np.exp(1j * angle)
        yield Shape("spring", spiral, False)
    # each pin is drawn once: by the link that hangs there, and by the first side of a closure
    pins = [0j]
    for closure in closures:
        one, two = closure.first, closure.second
        own = one if one.link == k else two if two.link == k and one.link is None else None
        if closure.along is None and own is not None:
            pins.append(own.at)
    for pin in pins:
        yield Shape("joint", pin + circle(0.55 * w))
    if link.l not in (0j, *_attached(mechanism, k)):
        yield Shape("tip", link.l + circle(0.22 * w))


def _supports(mechanism: Mechanism, E: Complex, w: float) -> Iterator[Shape]:
    """A triangle on a hatched line below each ground pivot, or above it if its links hang down."""
    hanging = [link.hangs_from for link in mechanism.description.links]
    pivots = {point.at for point in (*hanging, *_joined(mechanism)) if point.link is None}
    triangle = Shape("support", np.array([0j, -1.7 - 1j * SUPPORT, 1.7 - 1j * SUPPORT]))
    shapes = [triangle, *_hatched(-2.7 - 1j * SUPPORT, 2.7 - 1j * SUPPORT, 5)]
    for pivot in dict.fromkeys(_attached(mechanism, None)):
        size = w * (1.0 if pivot in pivots else SMALL)
        up = [E[:, k].imag.mean() for k, p in enumerate(hanging) if p == Point(None, pivot)]
        if up and np.mean(up) < -0.5:
            yield from (Shape(s.kind, pivot + size * s.points.conj(), s.closed) for s in shapes)
        else:
            yield from (shape.moved(pivot, size) for shape in shapes)


def _guide(low: float, high: float) -> Iterator[Shape]:
    """The walls on both sides of a slider's way, and the line that its point keeps; half widths."""
    strokes = max(4, round((high - low + 8.0) / 1.1))
    yield from _hatched(low - 4.0 - 1.7j, high + 4.0 - 1.7j, strokes)
    yield from _hatched(high + 4.0 + 1.7j, low - 4.0 + 1.7j, strokes)
    yield Shape("axis", np.array([low - 5.5 + 0j, high + 5.5]), False)


def _hatched(begin: complex, end: complex, count: int) -> Iterator[Shape]:
    """A line with `count` strokes on its right side; half widths."""
    yield Shape("guide", np.array([begin, end]), False)
    stroke = (end - begin) / abs(end - begin) * (-0.8 - 0.9j)
    for part in (np.arange(count) + 0.8) / count:
        z = begin + part * (end - begin)
        yield Shape("hatch", np.array([z, z + stroke]), False)


def circle(radius: float) -> Complex:
    """The points of a circle about 0."""
    return np.asarray(radius * np.exp(2j * np.pi * np.arange(2 * ARC) / (2 * ARC)))


def rounded_hull(points: ArrayLike, radius: float) -> Complex:
    """The outline, counter-clockwise, of all that is within `radius` of the hull of points (p,).

    A disc about one point, a bar with round ends about two, a polygon with round corners about
    more: in each direction `radius` beyond the point that is farthest there.
    """
    z = np.asarray(points, complex)
    sides = (z[:, None] - z).ravel()
    across = np.angle(1j * sides[sides != 0])  # where one farthest point follows another
    around = np.linspace(-np.pi, np.pi, 2 * ARC - 2, endpoint=False)
    angles = np.unique([*around, *(across - 1e-9), *(across + 1e-9)])
    outward = np.exp(1j * angles)
    farthest = (z * outward[:, None].conj()).real.argmax(axis=1)
    return np.asarray(z[farthest] + radius * outward)
