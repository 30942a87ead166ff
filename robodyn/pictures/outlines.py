"""The shapes that pictures of mechanisms are made of: points of the plane as complex numbers, m."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]

ARC = 15  # points of half a circle, odd: one lies at the far end of a link


class Shape(NamedTuple):
    """A polygon, or a line that stays open, in the frame of its body, m.

    Kinds: link, joint, tip, centre, quarter, payload, block, spring, support, hatch, guide, axis.
    """

    kind: str
    points: Complex  # (p,)
    closed: bool = True


def rounded_hull(points: Complex, radius: float) -> Complex:
    """The outline, counter-clockwise, of all that is within `radius` of the hull of points (p,).

    A disc about one point, a bar with round ends about two, a polygon with round corners about
    more.
    """
    corners = _hull(points)
    if len(corners) == 1:
        disc: Complex = corners[0] + circle(radius)
        return disc
    sides = np.roll(corners, -1) - corners
    outward = -1j * sides / np.abs(sides)
    pieces = []
    for k, corner in enumerate(corners):
        before, after = outward[k - 1], outward[k]
        angle = np.angle(after / before) % (2 * np.pi)
        count = max(2, round(ARC * angle / np.pi))
        pieces.append(corner + radius * before * np.exp(1j * np.linspace(0.0, angle, count)))
    return np.concatenate(pieces)


def circle(radius: float, begin: float = 0.0, end: float = 2 * np.pi) -> Complex:
    """The points of a circle about 0, or of an arc of it, rad."""
    count = max(3, round(ARC * (end - begin) / np.pi) + 1)
    points: Complex = radius * np.exp(1j * np.linspace(begin, end, count))
    return points[:-1] if end - begin >= 2 * np.pi else points


def _hull(points: Complex) -> Complex:
    """The corners of the convex hull, counter-clockwise (Andrew's monotone chain)."""
    ordered = sorted(set(points.tolist()), key=lambda z: (z.real, z.imag))
    if len(ordered) < 3:
        return np.array(ordered)

    def chain(walk: Iterable[complex]) -> list[complex]:
        kept: list[complex] = []
        for z in walk:
            while len(kept) > 1 and _turn(kept[-2], kept[-1], z) <= 0.0:
                kept.pop()
            kept.append(z)
        return kept[:-1]

    return np.array(chain(ordered) + chain(reversed(ordered)))


def _turn(a: complex, b: complex, c: complex) -> float:
    return ((b - a).conjugate() * (c - b)).imag


def centre_mark(place: complex, radius: float) -> Iterator[Shape]:
    """The sign of a centre of gravity: a circle in quarters, two of them dark."""
    yield Shape("centre", place + circle(radius))
    for begin in (0.0, np.pi):
        arc = circle(radius, begin, begin + np.pi / 2)
        yield Shape("quarter", place + np.concatenate([[0j], arc]))


def hatched(line: Complex, w: float, count: int) -> Iterator[Shape]:
    """A line of two points with `count` strokes on its right side."""
    begin, end = line
    along = (end - begin) / abs(end - begin)
    yield Shape("guide", line, False)
    for part in (np.arange(count) + 0.8) / count:
        z = begin + part * (end - begin)
        yield Shape("hatch", np.array([z, z + along * w * (-0.8 - 0.9j)]), False)


def coil_shapes(w: float) -> Iterator[Shape]:
    """A spring from x = 0 to x = 1, in zigzag."""
    turns = 8
    x = 0.15 + 0.7 * (np.arange(turns) + 0.5) / turns
    peaks = x + 1j * w * np.where(np.arange(turns) % 2, -1.0, 1.0)
    yield Shape("spring", np.concatenate([[0j, 0.15], peaks, [0.85, 1.0]]), False)


def dashpot_shapes(w: float) -> Iterator[Shape]:
    """A damper from x = 0 to x = 1: a piston in a cylinder."""
    side = 1j * w
    cylinder = np.array([0.36 + side, 0.64 + side, 0.64 - side, 0.36 - side], complex)
    piston = np.array([0.5 + 0.7 * side, 0.5 - 0.7 * side], complex)
    for points in (cylinder, piston, np.array([0j, 0.5]), np.array([0.64, 1.0 + 0j])):
        yield Shape("spring", points, False)


def spiral(w: float) -> Complex:
    """The spring of a joint, around it."""
    angle = np.linspace(0.0, 4.5 * np.pi, 60)
    points: Complex = w * (1.15 + 0.07 * angle) * np.exp(1j * angle)
    return points
