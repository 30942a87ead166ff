"""Where things stand in a picture: the frame of the plane that it shows, labels, the scale bar.

The plane is to scale: a metre is as long across as up.  Labels are boxes of known size, put where
they hide least.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.pictures.drawing import Drawing

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MARGIN = 0.05  # of the larger extent, on each side
FLATTEST = 0.42  # the least ratio of a picture's sides that follows from what it shows
OBSTACLES = ("link", "joint", "block", "support", "guide", "hatch", "payload", "spring")
ALONG = (0.5, 0.38, 0.62, 0.26, 0.74)  # where on its link a label may stand


class Frame(NamedTuple):
    """The part of the plane that a picture shows, m, and its size, inches."""

    left: float
    bottom: float
    right: float
    top: float
    width: float
    height: float

    @property
    def scale(self) -> float:
        """Metres an inch."""
        return (self.right - self.left) / self.width


def frame(
    box: Sequence[float],
    longest: float,
    size: tuple[float, float] | None = None,
    below: float = 0.0,
) -> Frame:
    """The frame about a box (left, bottom, right, top), m, with a margin.

    A picture is as long as `longest` (inches) and as the box is shaped, or of the `size` given;
    `below` (inches) are kept free at its lower edge.
    """
    left, bottom, right, top = box
    extent = max(right - left, top - bottom)
    wide, high = right - left + 2 * MARGIN * extent, top - bottom + 2 * MARGIN * extent
    if size is None:
        wide, high = max(wide, FLATTEST * high), max(high, FLATTEST * wide)
        scale = max(wide, high) / longest
        width, height = wide / scale, high / scale + below
    else:
        width, height = size
        scale = max(wide / width, high / max(height - below, 0.2 * height))
    x, y = 0.5 * (left + right), 0.5 * (bottom + top) - 0.5 * below * scale
    return Frame(
        x - 0.5 * width * scale,
        y - 0.5 * height * scale,
        x + 0.5 * width * scale,
        y + 0.5 * height * scale,
        width,
        height,
    )


def scale_bar(shown: Frame) -> tuple[float, str]:
    """The length of a scale bar, m, 1, 2 or 5 times a power of ten, and its label."""
    wanted = 0.22 * (shown.right - shown.left)
    power = 10.0 ** math.floor(math.log10(wanted))
    length = max(f * power for f in (1.0, 2.0, 5.0) if f * power <= wanted)
    for unit, factor in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6)):
        if length >= 0.0999 * factor:
            return length, f"{length / factor:g} {unit}"
    return length, f"{length:g} m"


def obstacles(drawn: Drawing, pose: int, step: float) -> tuple[Complex, NDArray[np.int64]]:
    """Points on the outlines at most `step` apart, m, and the link of each (-1: ground)."""
    points, links = [], []
    for b, shape, z in drawn.placed(pose):
        if shape.kind in OBSTACLES:
            dense = _dense(np.append(z, z[0]) if shape.closed else z, step)
            link = drawn.bodies[b].link
            points.append(dense)
            links.append(np.full(len(dense), -1 if link is None else link))
    return np.concatenate(points), np.concatenate(links)


def _dense(z: Complex, step: float) -> Complex:
    pieces = []
    for a, b in zip(z[:-1].tolist(), z[1:].tolist(), strict=True):
        count = min(200, max(1, math.ceil(abs(b - a) / step)))
        pieces.append(a + (b - a) * np.arange(count) / count)
    return np.concatenate([*pieces, z[-1:]])


def label_places(
    drawn: Drawing, pose: int, boxes: Sequence[complex], shown: Frame, further: Complex
) -> list[complex]:
    """The centre of the label of each link, m; `boxes` are widths + i heights, m.

    A label stands beside its link, where the distance to other links, to labels before it, and to
    the `further` points (arrows) is largest.
    """
    points, owners = obstacles(drawn, pose, drawn.half_width)
    points = np.concatenate([points, further])
    owners = np.concatenate([owners, np.full(len(further), -1)])
    taken: list[tuple[complex, complex]] = []
    for k, box in enumerate(boxes):
        candidates = list(_beside(drawn, pose, k, box))
        taken.append((free_place(candidates, box, points[owners != k], taken, shown), box))
    return [place for place, _ in taken]


def head_places(
    arrows: Sequence[tuple[complex, complex]],
    boxes: Sequence[complex],
    points: Complex,
    shown: Frame,
    labels: Sequence[tuple[complex, complex]] = (),
) -> list[complex]:
    """The centre of the text of each arrow (tail, head), m, about its head, clear of `points`.

    `labels` (centre, box) are there already.
    """
    taken = list(labels)
    for (tail, head), box in zip(arrows, boxes, strict=True):
        along = (head - tail) / (abs(head - tail) or 1.0)  # 0 where it is far off, and short
        turns = [sign * part for part in np.linspace(0.0, np.pi, 13) for sign in (1, -1)]
        candidates = []
        for gap, turn in product((0.4, 1.5, 2.6), turns[1:]):
            direction = along * np.exp(1j * turn)
            reach = 0.5 * min(
                box.real / max(abs(direction.real), 1e-9),
                box.imag / max(abs(direction.imag), 1e-9),
            )
            candidates.append(complex(head + direction * (reach + gap * box.imag)))
        taken.append((free_place(candidates, box, points, taken, shown), box))
    return [place for place, _ in taken[len(labels) :]]


def free_place(
    candidates: Sequence[complex],
    box: complex,
    points: Complex,
    taken: Sequence[tuple[complex, complex]],
    shown: Frame,
) -> complex:
    """The candidate whose box has most room; earlier ones are better where room is enough."""
    best, most = candidates[0], -math.inf
    for order, centre in enumerate(candidates):
        clear = float(_distance(centre, box, points).min(initial=math.inf))
        for place, other in taken:
            clear = min(clear, float(_distance(centre, box + other, np.array([place]))[0]))
        score = min(clear / box.imag, 1.0) - 0.03 * order
        if clear <= 0.0:
            score -= 2.0
        if not _inside(centre, box, shown):
            score -= 10.0
        if score > most + 1e-9:
            best, most = centre, score
    return best


def _beside(drawn: Drawing, pose: int, k: int, box: complex) -> Iterator[complex]:
    """Centres of a label on both sides of link k, from its middle outward."""
    b = next(b for b, body in enumerate(drawn.bodies) if body.link == k and body.turns)
    place, direction = complex(drawn.place[pose, b]), complex(drawn.turn[pose, b])
    outline = next(s.points for s in drawn.bodies[b].shapes if s.kind == "link")
    outline = _dense(np.append(outline, outline[0]), 0.2 * box.imag)
    length = drawn.mechanism.description.links[k].l
    along = 0.5 * (abs(direction.real) * box.real + abs(direction.imag) * box.imag)
    for part in ALONG:
        foot = part * length
        for side in (1j, -1j):
            normal = side * direction
            near = outline[np.abs(outline.real - foot) <= along]
            reach = float((near * side.conjugate()).real.max(initial=0.0))
            half = 0.5 * (abs(normal.real) * box.real + abs(normal.imag) * box.imag)
            yield place + foot * direction + normal * (reach + half + 0.2 * box.imag)


def _distance(centre: complex, box: complex, points: Complex) -> Array:
    """From a box to points, m."""
    dx = np.maximum(np.abs(points.real - centre.real) - 0.5 * box.real, 0.0)
    dy = np.maximum(np.abs(points.imag - centre.imag) - 0.5 * box.imag, 0.0)
    distance: Array = np.hypot(dx, dy)
    return distance


def _inside(centre: complex, box: complex, shown: Frame) -> bool:
    box += 0.6 * box.imag * (1 + 1j)  # some room to the edges
    return (
        shown.left <= centre.real - 0.5 * box.real
        and centre.real + 0.5 * box.real <= shown.right
        and shown.bottom <= centre.imag - 0.5 * box.imag
        and centre.imag + 0.5 * box.imag <= shown.top
    )
