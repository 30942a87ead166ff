"""The bodies that a picture of a mechanism consists of, each with its shapes in its own frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.pictures.outlines import (
    Shape,
    centre_mark,
    circle,
    coil_shapes,
    dashpot_shapes,
    hatched,
    rounded_hull,
    spiral,
)
from robodyn.scene.scene import Closure, Point, Spring

Complex = NDArray[np.complex128]

SUPPORT = 2.6  # depth of a ground support, half widths
SMALL = 0.6  # of a support that holds a spring alone


class Body(NamedTuple):
    """Shapes that move together: with a link, along a slider's line (no turning), or not at all.

    Those of a spring have x = 0 at its `origin` and x = 1 at its `end`.
    """

    link: int | None  # None: the ground, or a spring
    origin: PlanarPoint
    turns: bool
    shapes: tuple[Shape, ...]
    end: PlanarPoint | None = None

    @property
    def moves(self) -> bool:
        """Whether it has not the same place at all poses."""
        return self.link is not None or self.end is not None


def bodies(mechanism: Mechanism, E: Complex, w: float) -> Iterator[Body]:
    """The ground first, then guides, links from the ground outward, and the sliders' blocks."""
    origin = PlanarPoint(0j, ())
    yield Body(None, origin, False, tuple(_supports(mechanism, E, w)))
    closures = mechanism.description.closures
    sliding: dict[int, list[complex]] = {}
    for closure in closures:
        if closure.along is not None and closure.first.link is not None:
            z = at(planar(mechanism, closure.first), E)
            guide = _guide(closure.second.at, closure.along, z, w)
            yield Body(None, origin, False, guide)
            sliding.setdefault(closure.first.link, []).append(closure.first.at)
    for spring in mechanism.springs:
        coil = coil_shapes(w) if spring.stiffness else dashpot_shapes(w)
        yield Body(None, spring.ends[0], True, tuple(coil), spring.ends[1])
    for k in mechanism.order:
        shapes = tuple(_link(mechanism, k, sliding.get(k, []), w))
        yield Body(k, mechanism.pivots[k], True, shapes)
    for closure in closures:
        if closure.along is not None and closure.first.link is not None:
            block = np.array([-2.4 - 1.5j, 2.4 - 1.5j, 2.4 + 1.5j, -2.4 + 1.5j], complex)
            block *= w * closure.along
            shapes = (Shape("block", block), Shape("joint", circle(0.55 * w)))
            yield Body(closure.first.link, planar(mechanism, closure.first), False, shapes)


def planar(mechanism: Mechanism, point: Point) -> PlanarPoint:
    """A point of a link, or of the ground, in terms of the links' directions."""
    if point.link is None:
        return PlanarPoint(point.at, ())
    pivot = mechanism.pivots[point.link]
    return PlanarPoint(pivot.constant, (*pivot.terms, (point.link, point.at)))


def at(point: PlanarPoint, E: Complex) -> Complex:
    """Where a point of the mechanism is, (...), m, with the links' directions E (..., n)."""
    z = np.full(E.shape[:-1], point.constant, complex)
    for k, coefficient in point.terms:
        z = z + coefficient * E[..., k]
    return z


def link_points(mechanism: Mechanism, k: int) -> Complex:
    """The points of link k in its frame: its joint, its tip, and what hangs or closes there, m."""
    found = [0j, complex(mechanism.description.links[k].l)]
    found += [link.hangs_from.at for link in mechanism.description.links if _on(link.hangs_from, k)]
    for closure in mechanism.description.closures:
        found += [side.at for side in _sides(closure) if _on(side, k)]
    found += [end.at for end in _spring_ends(mechanism) if _on(end, k)]
    return np.array(list(dict.fromkeys(found)))


def _on(point: Point, link: int | None) -> bool:
    return point.link == link


def _spring_ends(mechanism: Mechanism) -> list[Point]:
    springs = [s for s in mechanism.description.springs if isinstance(s, Spring)]
    return [end for spring in springs for end in (spring.first, spring.second)]


def _sides(closure: Closure) -> tuple[Point, ...]:
    """The points that a closure joins; of a slider the one that slides."""
    return (closure.first, closure.second) if closure.along is None else (closure.first,)


def _link(mechanism: Mechanism, k: int, sliding: list[complex], w: float) -> Iterator[Shape]:
    link, points = mechanism.description.links[k], link_points(mechanism, k)
    yield Shape("link", rounded_hull(points, w))
    if link.payload and link.l not in sliding:
        yield Shape("payload", link.l + circle(1.5 * w))
    yield from centre_mark(link.r, 0.8 * w)
    # each pin is drawn once: by the link that hangs there, and by the first side of a closure
    pins = [0j]
    joined = [0j, *sliding]
    for closure in mechanism.description.closures:
        ends = [side.at for side in _sides(closure) if _on(side, k)]
        joined += ends
        other_is_ground = any(_on(side, None) for side in _sides(closure))
        if closure.along is None and (_on(closure.first, k) or other_is_ground):
            pins += ends
    hanging = [child.hangs_from for child in mechanism.description.links]
    joined += [point.at for point in hanging if _on(point, k)]
    ends = [end.at for end in _spring_ends(mechanism) if _on(end, k)]
    joined += ends
    for end in ends:
        yield Shape("tip", end + circle(0.3 * w))
    if any(spring.joint == k for spring in mechanism.joint_springs):
        yield Shape("spring", spiral(w), False)
    for pin in pins:
        yield Shape("joint", pin + circle(0.55 * w))
    if link.l not in joined:
        yield Shape("tip", link.l + circle(0.22 * w))


def _supports(mechanism: Mechanism, E: Complex, w: float) -> Iterator[Shape]:
    """A triangle on a hatched line below each ground pivot, or above it if its links hang down."""
    lean: dict[complex, list[float]] = {}
    for k, link in enumerate(mechanism.description.links):
        if link.hangs_from.link is None:
            lean.setdefault(link.hangs_from.at, []).append(float(E[:, k].imag.mean()))
    for closure in mechanism.description.closures:
        if closure.along is None:
            for side in _sides(closure):
                if side.link is None:
                    lean.setdefault(side.at, [])
    pivots = set(lean)
    for end in _spring_ends(mechanism):
        if end.link is None:
            lean.setdefault(end.at, [])
    for pivot, leans in lean.items():
        size = 1.0 if pivot in pivots else SMALL
        hangs = bool(leans) and np.mean(leans) < -0.5
        triangle = np.array([0j, -1.7 - 1j * SUPPORT, 1.7 - 1j * SUPPORT]) * complex(w)
        base = np.array([-2.7 - 1j * SUPPORT, 2.7 - 1j * SUPPORT]) * complex(w)
        for shape in (Shape("support", triangle), *hatched(base, w, 5)):
            points = shape.points.conj() if hangs else shape.points
            yield Shape(shape.kind, pivot + size * points, shape.closed)


def _guide(through: complex, along: complex, z: Complex, w: float) -> tuple[Shape, ...]:
    """The walls on both sides of a slider's way, and the line that its point keeps."""
    travel = ((z - through) * along.conjugate()).real
    low, high = float(travel.min()) - 4.0 * w, float(travel.max()) + 4.0 * w
    strokes = max(4, round((high - low) / (1.1 * w)))
    walls = [
        *hatched(np.array([low - 1.7j * w, high - 1.7j * w], complex), w, strokes),
        *hatched(np.array([high + 1.7j * w, low + 1.7j * w], complex), w, strokes),
        Shape("axis", np.array([low - 1.5 * w, high + 1.5 * w], complex), False),
    ]
    return tuple(Shape(s.kind, through + along * s.points, s.closed) for s in walls)
