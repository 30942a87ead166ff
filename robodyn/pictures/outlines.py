"""Shapes that pictures of mechanisms are made of: polygons and lines of the plane, m.

Where links slide: guides on the ground, rails and slots on links, as long as the way there.
Lengths along a way are m, those across it half widths of a link.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.placed import Placed
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.tables.arrays import Complex

ARC = 15  # points of half a circle
PIN, BLOCK = 0.75, 1.5  # half the height of a slot that holds a pin, and of a block
WALL = 0.6  # of a slot or a rail on a link
ROD = 0.55  # of a rod
ROOM = 2.4  # for half a block, else a link that slides in another is a rod in a cylinder
FURTHER = 3.6  # of a slot or a rail, beyond the way of what slides there
CORNERS = np.array([-2.4 - 1.5j, 2.4 - 1.5j, 2.4 + 1.5j, -2.4 + 1.5j])  # of a block


class Shape(NamedTuple):
    """A polygon, or a line that stays open, in the frame of its body, m.

    Kinds: link, joint, tip, centre, quarter, payload, block, spring, support, hatch, guide, axis,
    wheel; on links that slide, or on which something slides, rail, slot, line, slider and rod.
    """

    kind: str
    points: Complex  # (p,)
    closed: bool = True

    def moved(self, place: complex, turn: complex) -> Shape:
        return Shape(self.kind, place + turn * self.points, self.closed)


def hatched(begin: complex, end: complex, count: int) -> Iterator[Shape]:
    """A line with `count` strokes on its right side; half widths."""
    yield Shape("guide", np.array([begin, end]), False)
    stroke = (end - begin) / abs(end - begin) * (-0.8 - 0.9j)
    for part in (np.arange(count) + 0.8) / count:
        z = begin + part * (end - begin)
        yield Shape("hatch", np.array([z, z + stroke]), False)


def circle(radius: float, count: int = 2 * ARC) -> Complex:
    """So many points of a circle about 0."""
    return np.asarray(radius * np.exp(2j * np.pi * np.arange(count) / count))


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


class Way(NamedTuple):
    """A stretch of a line of a link (None: of the ground) on which something slides."""

    link: int | None
    place: complex  # m, in the frame of the link
    along: complex
    low: float  # m from the place
    high: float
    across: float = BLOCK  # half the height of what slides
    joint: int | None = None  # that slides; None: a point does, in a slot
    out: float | None = None  # m from the place, where a link leaves the one that it slides in

    def foot(self) -> complex:
        """The point of the stretch that is nearest to the link's joint."""
        nearest = -(self.place * self.along.conjugate()).real
        return self.place + self.along * float(np.clip(nearest, self.low, self.high))

    @property
    def side(self) -> float:
        """1 where it goes ahead more than behind, else -1."""
        return 1.0 if self.high >= -self.low else -1.0

    def leaving(self, points: Complex, w: float) -> Way:
        """The same, with where it leaves a link that has these `points`, if it goes farther.

        Or if that link has no room for a block on it.
        """
        apart = (points - self.place) * self.along.conjugate()
        on_line = self.side * apart.real[np.abs(apart.imag) < w]
        end = float(on_line.max(initial=0.0))
        far = max(self.high, -self.low)
        leaves = far > end + ROOM * w or end < ROOM * w
        return self._replace(out=self.side * end) if leaves else self


def at(point: PlanarPoint, X: Complex) -> Complex:
    """Where a point of the mechanism is, (...), m, at X (..., n)."""
    z = np.full(X.shape[:-1], point.constant, complex)
    for k, coefficient in point.terms:
        z = z + coefficient * X[..., k]
    return z


def direction(tree: Tree, k: int, E: Complex) -> Complex:
    """That of link k's x axis, (...), with E (..., n)."""
    return E[..., k] if tree.phases[k] == 1.0 else tree.phases[k] * E[..., k]


def rails(mechanism: Mechanism, travelled: Placed) -> Iterator[Way]:
    """Of each joint that slides, from where it is zero to where it goes."""
    for k in mechanism.slides:
        link, s = mechanism.description.links[k], travelled.x[..., k]
        low, high = float(s.min(initial=0.0)), float(s.max(initial=0.0))
        assert link.axis is not None
        hung = link.hangs_from
        yield Way(hung.link, hung.at, link.axis, low, high, joint=k)


def slots(mechanism: Mechanism, tree: Tree, travelled: Placed) -> Iterator[Way]:
    """Of each line on a link, with the points that closures hold there; once for one line."""
    found: dict[tuple[int, complex, complex], Way] = {}
    for closure in mechanism.description.closures:
        carrier, along = closure.second.link, closure.along
        if carrier is None or along is None:
            continue
        apart = at(tree.difference(closure.first, closure.second), travelled.X)
        way = (apart * (direction(tree, carrier, travelled.E) * along).conj()).real
        low, high = float(way.min()), float(way.max())
        across = PIN if closure.aligned is None else BLOCK
        key = carrier, closure.second.at, along
        if key in found:
            old = found[key]
            low, high, across = min(low, old.low), max(high, old.high), max(across, old.across)
        found[key] = Way(*key, low, high, across)
    yield from found.values()


def on_ground(way: Way, w: float) -> tuple[Shape, ...]:
    """The walls on both sides of a way on the ground, and the line along it, m."""
    low, high = way.low / w, way.high / w
    strokes = max(4, round((high - low + 8.0) / 1.1))
    guide = [
        *hatched(low - 4.0 - 1.7j, high + 4.0 - 1.7j, strokes),
        *hatched(high + 4.0 + 1.7j, low - 4.0 + 1.7j, strokes),
        Shape("axis", np.array([low - 5.5 + 0j, high + 5.5]), False),
    ]
    return tuple(shape.moved(way.place, w * way.along) for shape in guide)


def on_link(way: Way, w: float) -> Iterator[Shape]:
    """A slot with round ends, a rail, or the end of a cylinder, in the link's frame, m."""
    if way.out is not None:
        x = way.out / w + way.side * np.array([-3.0, 1.4, 1.4, -3.0])
        outline = x + 1j * BLOCK * np.array([-1, -1, 1, 1])
        yield Shape("rail", outline).moved(way.place, w * way.along)
        return
    ends = np.array([way.low / w - FURTHER, way.high / w + FURTHER], complex)
    for kind, across in (("rail", way.across + WALL), ("slot", way.across)):
        if way.across == PIN:
            outline = rounded_hull(ends, across)
        else:
            (low, high), end = ends.real, across - way.across
            x = np.array([low - end, high + end, high + end, low - end])
            outline = x + 1j * across * np.array([-1, -1, 1, 1])
        yield Shape(kind, outline).moved(way.place, w * way.along)
    line = ends + np.array([-1.5, 1.5])
    yield Shape("line", line, False).moved(way.place, w * way.along)


def rod(way: Way, w: float) -> Shape:
    """What of a link stays in the cylinder that it slides in, in the frame of that link, m."""
    assert way.out is not None
    far = way.high if way.side > 0.0 else way.low
    back = way.out - far - 2.0 * w * way.side
    return Shape("rod", np.array([back, 0.0, 0.0, back]) + 1j * ROD * w * np.array([-1, -1, 1, 1]))
