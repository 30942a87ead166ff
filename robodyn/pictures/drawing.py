"""What a picture of a mechanism shows, to scale: links, joints, centres of gravity, supports.

Points of the plane are complex numbers, m.  Each shape is a polygon or a line in the frame of a
body; a pose says where each body is, `place + turn * points`, where |turn| = 1 but for springs:
these are stretched along their x axis alone.  So a figure and an animation draw the same
things.  Symbols are as large as a part of the mechanism's span.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.placed import Placed, placed
from robodyn.errors import RobodynError
from robodyn.kinematics.named_points import NamedPoint
from robodyn.loops.assembly import assembly_plan, attempt
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.bodies import Body, bodies
from robodyn.pictures.outlines import Shape, at, direction
from robodyn.scene.scene import Point
from robodyn.tables.arrays import Array, Complex

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
    """What is to be drawn of the mechanism at the closed poses q, (n,) or (T, n).

    Points that are `marked` are joined to their links.
    Raises RobodynError where it is too large or too small for numbers.
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
    closures, actuated = mechanism.description.closures, list(mechanism.actuated)
    slotted = any(c.along is not None and c.second.link is not None for c in closures)
    turning = [k for k in actuated if k not in mechanism.slides]
    if len(poses) > 1 or not slotted or not turning or assembly_plan(mechanism).rest:
        return poses
    given = np.repeat(poses, TURNS, axis=0)
    given[:, turning] += np.arange(TURNS)[:, None] * (2 * np.pi / TURNS)
    q, missing = attempt(mechanism, given[:, actuated])
    return np.concatenate([poses, q[missing <= 0.0]])


def span(mechanism: Mechanism, q: Array) -> float:
    """The largest extent of joints, tips and centres of gravity over the poses q (T, n), m.

    1 where they all are one point.
    """
    X, tree = placed(mechanism, q).X, Tree(mechanism.description.links)
    points = [*mechanism.pivots, *mechanism.tips, *mechanism.centres]
    points += [tree.point(Point(k, 0j)) for k in mechanism.slides]
    z = np.concatenate([at(point, X) for point in points])
    return float(max(np.ptp(z.real), np.ptp(z.imag))) or 1.0
