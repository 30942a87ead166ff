"""What a picture of a mechanism shows, to scale: links, joints, centres of gravity, supports.

Points of the plane are complex numbers, m.  Each shape is a polygon or a line in the frame of a
body; a pose says where each body is, `place + turn * points`, where |turn| = 1 but for springs:
these are stretched along their x axis alone.  So a figure and an animation draw the same
things.  Symbols are as large as a part of the mechanism's span.

Where links slide: guides on the ground, rails and slots on links, as long as the way there.
Lengths along a way are m, those across it half widths of a link.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.cam_contacts import Cam, cams_of, outline
from robodyn.dynamics.joint_vectors import driver_of, full
from robodyn.dynamics.named_points import NamedPoint
from robodyn.elements.springs import JointSpring, PointSpring
from robodyn.errors import RobodynError
from robodyn.loops.assembly import assembly_plan
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.mechanics.placed import Placed, placed
from robodyn.scene.scene import Point
from robodyn.scene.welds import Welded
from robodyn.tables.arrays import Array, Complex

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
    wheel, cam, roller, face; on links that slide, or on which something slides, rail, slot, line,
    slider and rod.
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
        """Return the way with the point at which it leaves a link with these `points`.

        It leaves the link if it extends farther, or if the link has no room for a block.
        """
        apart = (points - self.place) * self.along.conjugate()
        on_line = self.side * apart.real[np.abs(apart.imag) < w]
        end = float(on_line.max(initial=0.0))
        far = max(self.high, -self.low)
        leaves = far > end + ROOM * w or end < ROOM * w
        return self._replace(out=self.side * end) if leaves else self


def at(point: PlanarPoint, X: Complex) -> Complex:
    """Return the position (...), m, of a point of the mechanism at X (..., n)."""
    z = np.full(X.shape[:-1], point.constant, complex)
    for k, coefficient in point.terms:
        z = z + coefficient * X[..., k]
    return z


def direction(tree: Tree, k: int, E: Complex) -> Complex:
    """Return the direction of link k's x axis, (...), with E (..., n)."""
    return E[..., k] if tree.phases[k] == 1.0 else tree.phases[k] * E[..., k]


def rails(mechanism: Mechanism, travelled: Placed) -> Iterator[Way]:
    """Yield the way of each sliding joint, from zero to where it goes."""
    for k in mechanism.slides:
        link, s = mechanism.description.links[k], travelled.x[..., k]
        low, high = float(s.min(initial=0.0)), float(s.max(initial=0.0))
        assert link.axis is not None
        hung = link.hangs_from
        yield Way(hung.link, hung.at, link.axis, low, high, joint=k)


def slots(mechanism: Mechanism, tree: Tree, travelled: Placed) -> Iterator[Way]:
    """Yield each slot on a link, with the points that closures hold there; once per line."""
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
    """Return the part of a link that stays in its cylinder, in the frame of that link, m."""
    assert way.out is not None
    far = way.high if way.side > 0.0 else way.low
    back = way.out - far - 2.0 * w * way.side
    return Shape("rod", np.array([back, 0.0, 0.0, back]) + 1j * ROD * w * np.array([-1, -1, 1, 1]))


SUPPORT = 2.6  # depth of a ground support, half widths
SMALL = 0.6  # of a support that holds a spring alone
TOOTH = 0.9  # of a spring's zigzag in the pose that is drawn, half widths; of 8 teeth or more
MOST_TEETH = 80
WHEEL = 120  # points of a pitch circle
PROFILE = 360  # stretches of a cam's profile
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
    for spring in mechanism.of(PointSpring):
        ends = tree.point(spring.first), tree.point(spring.second)
        yield _spring(bool(spring.stiffness or spring.law), *ends, poses, w)
    for coil in mechanism.of(JointSpring):
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
        pair = [coupling.joint, *(k for k, _ in coupling.terms)]  # a law has no pitch circle
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
    touching = [cam for cam in cams_of(mechanism) if cam.link == k]
    found += [cam.follower.at for cam in touching if cam.follower.face is None]
    found += [point.at for point in _welded(mechanism) if point.link == k]
    return np.array(list(dict.fromkeys(found)))


def _welded(mechanism: Mechanism) -> list[Point]:
    """Joints and tips of welds, on the links that they are part of."""
    welded = Welded(mechanism.description)
    ends = enumerate(mechanism.description.welds, start=mechanism.n)
    return [welded.point(Point(k, at)) for k, weld in ends for at in (0j, weld.l + 0j)]


def _attached(mechanism: Mechanism, k: int) -> list[complex]:
    """Return the points of link k at which other links hang, closures join and springs end."""
    hanging = [link.hangs_from for link in mechanism.description.links]
    points = [*hanging, *_joined(mechanism), *_spring_ends(mechanism)]
    return [point.at for point in points if point.link == k]


def _joined(mechanism: Mechanism) -> list[Point]:
    """The points that closures join; of a slider the one that slides."""
    closures = mechanism.description.closures
    return [c.first for c in closures] + [c.second for c in closures if c.along is None]


def _spring_ends(mechanism: Mechanism) -> list[Point]:
    return [end for spring in mechanism.of(PointSpring) for end in (spring.first, spring.second)]


def _link(
    mechanism: Mechanism, k: int, ways: Sequence[Way], w: float, marked: Sequence[Point]
) -> Iterator[Shape]:
    """Link k with the rails and slots on it, and its own block or rod if it slides."""
    link, closures = mechanism.description.links[k], mechanism.description.closures
    yield from _cams(mechanism, k, w)
    sliding = [c.first.at for c in closures if c.along is not None and c.first.link == k]
    feet = [way.foot() for way in ways if way.link == k and way.joint is None]
    for cam in cams_of(mechanism):
        if cam.link == k and cam.follower.face is not None:
            ends, normal = _face(mechanism, cam)
            feet += (ends + w * normal).tolist()
    yield Shape("link", rounded_hull([*link_points(mechanism, k, marked), *feet], w))
    for way in ways:
        if way.joint == k:
            yield Shape("slider", CORNERS).moved(0j, w) if way.out is None else rod(way, w)
        if way.link == k:
            yield from on_link(way, w)
    if link.payload and link.l not in sliding:
        yield Shape("payload", link.l + circle(1.5 * w))
    if link.has_mass:
        yield Shape("centre", link.r + circle(0.8 * w))
        for begin in (0.0, np.pi):  # two dark quarters
            arc: Complex = 0.8 * w * np.exp(1j * np.linspace(begin, begin + np.pi / 2, 9))
            yield Shape("quarter", link.r + np.append(0j, arc))
    for end in _spring_ends(mechanism):
        if end.link == k:
            yield Shape("tip", end.at + circle(0.3 * w))
    if not link.slides and any(spring.joint == k for spring in mechanism.of(JointSpring)):
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


def _cams(mechanism: Mechanism, k: int, w: float) -> Iterator[Shape]:
    """The profiles of the cams that turn with link k, and its own roller or flat face."""
    for cam in cams_of(mechanism):
        if k not in (cam.driver, cam.link):
            continue
        if k == cam.driver:
            points = outline(mechanism, cam, PROFILE)[1].profile
            points = points[np.isfinite(points)]
            yield Shape("cam", points, bool(abs(points[-1] - points[0]) < w))
        elif cam.follower.face is not None:
            beyond = w * cam.follower.face
            yield Shape("face", _face(mechanism, cam)[0] + np.array([-beyond, beyond]), False)
        elif cam.follower.radius:
            yield Shape("roller", cam.follower.at + circle(cam.follower.radius, 4 * ARC))


@lru_cache(maxsize=64)
def _face(mechanism: Mechanism, cam: Cam) -> tuple[Complex, complex]:
    """The ends of the contact on a flat face, m, and its normal, in the frame of the follower."""
    touch, face = outline(mechanism, cam, PROFILE)[1], cam.follower.face
    assert face is not None
    along = touch.along[np.isfinite(touch.along)]
    ends = np.array([along.min(), along.max()] if len(along) else [0.0, 0.0])
    return np.asarray(cam.follower.at + ends * face), float(np.median(touch.side)) * 1j * face


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


HALF_WIDTH = 0.024  # of a link, as a part of the span
LARGEST = 1e100  # m, of a half width
TURNS = 48  # poses of a turn that tell how long a slot is
SHORTEST = 1e-12  # m, of a spring whose ends coincide


class Drawing(NamedTuple):
    """The bodies of a mechanism at poses q (T, n), and the half width of its links, m."""

    mechanism: Mechanism
    q: Array
    half_width: float
    bodies: tuple[Body, ...]
    place: Complex  # (T, bodies)
    turn: Complex  # (T, bodies)

    def placed(self, pose: int) -> Iterator[tuple[int, Shape, Complex]]:
        """Each shape at a pose, with the index of its body and its points in the plane."""
        for b, body in enumerate(self.bodies):
            for shape in body.shapes:
                yield b, shape, _moved(shape.points, self.place[pose, b], self.turn[pose, b])

    def body_of(self, link: int) -> int:
        """Which of the bodies a link is."""
        return next(b for b, body in enumerate(self.bodies) if body.link == link and body.turns)

    def box(self, further: Sequence[complex] = ()) -> tuple[float, float, float, float]:
        """x and y of the least, x and y of the largest of all points at all poses, m.

        `further` points are within it too.
        """
        corners = [(z.real, z.imag) for z in further]
        for b, body in enumerate(self.bodies):
            points = np.concatenate([shape.points for shape in body.shapes])
            z = _moved(points, self.place[:, b, None], self.turn[:, b, None])
            corners += [(z.real.min(), z.imag.min()), (z.real.max(), z.imag.max())]
        (left, bottom), (right, top) = np.min(corners, axis=0), np.max(corners, axis=0)
        return float(left), float(bottom), float(right), float(top)


class Trace(NamedTuple):
    """A point by its name, and where it is at some poses, (T,) m."""

    name: str
    path: Complex


def traced(mechanism: Mechanism, points: Sequence[NamedPoint], q: Array) -> list[Trace]:
    """The paths of points through the poses q (T, n)."""
    X = placed(mechanism, q).X
    return [Trace(point.name, at(point.point, X)) for point in points]


def even_rows(count: int, most: int) -> NDArray[np.int64]:
    """At most so many of `count` rows, evenly chosen, the last among them."""
    return np.unique(np.linspace(count - 1, 0, min(most, count)).round().astype(int))


def _moved(points: Complex, place: Complex, turn: Complex) -> Complex:
    moved: Complex = place + turn * points.real + 1j * turn / np.abs(turn) * points.imag
    return moved


def drawing(mechanism: Mechanism, q: ArrayLike, marked: Sequence[NamedPoint] = ()) -> Drawing:
    """Return the drawing of the mechanism at closed poses q, (n,) or (T, n).

    Points that are `marked` are joined to their links.  Raises RobodynError if it is too large or
    too small for numbers.
    """
    poses = np.atleast_2d(np.asarray(q, float))
    with np.errstate(all="ignore"), suppress(ValueError, OverflowError):  # whole numbers of nan
        half_width = HALF_WIDTH * span(mechanism, poses)
        if 1.0 / LARGEST <= half_width <= LARGEST:
            here = placed(mechanism, poses)
            travelled = placed(mechanism, _travelled(mechanism, poses))
            own = [point.own for point in marked]
            found = tuple(bodies(mechanism, here, travelled, half_width, own))
            moves = _moves(mechanism, found, here)
            place, turn = (np.stack(each, axis=-1) for each in zip(*moves, strict=True))
            drawn = Drawing(mechanism, poses, half_width, found, place, turn)
            if all(abs(side) <= LARGEST for side in drawn.box()):
                return drawn
    limit = "the angles are too large, or the scene too large or too small"
    raise RobodynError("cannot be drawn", where=mechanism.source, limit=limit)


def _moves(
    mechanism: Mechanism, found: Sequence[Body], here: Placed
) -> Iterator[tuple[Complex, Complex]]:
    """The place and the turn of each body, (T,) each."""
    tree = Tree(mechanism.description.links)
    for body in found:
        place, turn = at(body.origin, here.X), np.ones(len(here.X), complex)
        if body.end is not None:
            along = at(body.end, here.X) - place
            turn = np.where(along == 0, SHORTEST, along)
        elif body.turns and body.link is not None:
            turn = direction(tree, body.link, here.E)
        yield place, turn


def _travelled(mechanism: Mechanism, poses: Array) -> Array:
    """The poses (T, n); those of a turn too where one pose alone would tell no slot's length."""
    closures = mechanism.description.closures
    slotted = any(c.along is not None and c.second.link is not None for c in closures)
    turning = [k for k in mechanism.actuated if k not in mechanism.slides]
    if len(poses) > 1 or not slotted or not turning or mechanism.driven:
        return poses
    if assembly_plan(mechanism).rest:
        return poses
    given = np.repeat(poses, TURNS, axis=0)
    given[:, turning] += np.arange(TURNS)[:, None] * (2 * np.pi / TURNS)
    few, missing = given[:, list(driver_of(mechanism).actuated)], np.zeros(TURNS)
    q = full(mechanism, {"q": (few, False)}, t=0.0, missing=missing)["q"]
    return np.concatenate([poses, q[missing == 0.0]])


def span(mechanism: Mechanism, q: Array) -> float:
    """The largest extent of joints, tips and centres of gravity over the poses q (T, n), m.

    1 where they all are one point.
    """
    X, tree = placed(mechanism, q).X, Tree(mechanism.description.links)
    points = [*mechanism.pivots, *mechanism.tips, *mechanism.centres]
    points += [tree.point(Point(k, 0j)) for k in mechanism.slides]
    z = np.concatenate([at(point, X) for point in points])
    return float(max(np.ptp(z.real), np.ptp(z.imag))) or 1.0
