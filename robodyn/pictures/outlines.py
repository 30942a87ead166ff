"""Shapes that pictures of mechanisms are made of: polygons and lines of the plane, m."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Complex = NDArray[np.complex128]

ARC = 15  # points of half a circle


class Shape(NamedTuple):
    """A polygon, or a line that stays open, in the frame of its body, m.

    Kinds: link, joint, tip, centre, quarter, payload, block, spring, support, hatch, guide, axis;
    on links that slide, or on which something slides, rail, slot, line, slider and rod.
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
