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
from robodyn.tables.arrays import Array, Complex

Size = tuple[float, float] | None  # of a picture, inches; None: as what it shows

MARGIN = 0.05  # of the larger extent, on each side
FLATTEST = 0.42  # the least ratio of a picture's sides that follows from what it shows
OBSTACLES = ("link", "joint", "block", "support", "guide", "hatch", "payload", "spring", "rail")
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


def frame(box: Sequence[float], longest: float, size: Size = None, below: float = 0.0) -> Frame:
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
    across, up = 0.5 * width * scale, 0.5 * height * scale
    return Frame(x - across, y - up, x + across, y + up, width, height)


def scale_bar(shown: Frame) -> tuple[float, str]:
    """The length of a scale bar, m, 1, 2 or 5 times a power of ten, and its label."""
    wanted = 0.22 * (shown.right - shown.left)
    power = 10.0 ** math.floor(math.log10(wanted))
    length = max(f * power for f in (1.0, 2.0, 5.0) if f * power <= wanted)
    units = {"m": 1.0, "mm": 1e-3, "µm": 1e-6}
    unit = next((unit for unit, factor in units.items() if length >= 0.0999 * factor), "m")
    return length, f"{length / units[unit]:g} {unit}"


def scale_bar_line(shown: Frame) -> Complex:
    """A scale bar, with its ticks, in the lower left corner, m."""
    begin = complex(shown.left, shown.bottom) + (0.14 + 0.14j) * shown.scale
    end, tick = begin + scale_bar(shown)[0], 0.04j * shown.scale
    return np.array([begin + tick, begin - tick, end - tick, end + tick])


def obstacles(drawn: Drawing, pose: int) -> tuple[Complex, NDArray[np.int64]]:
    """Points on the outlines at most half a link's width apart, m, and the link of each or -1."""
    points, links = [], []
    for b, shape, z in drawn.placed(pose):
        if shape.kind in OBSTACLES:
            points.append(_dense(np.append(z, z[0]) if shape.closed else z, drawn.half_width))
            link = drawn.bodies[b].link
            links.append(np.full(len(points[-1]), -1 if link is None else link))
    return np.concatenate(points), np.concatenate(links)


def _dense(z: Complex, step: float) -> Complex:
    counts = np.ceil(np.abs(np.diff(z)) / step).astype(int).clip(1, 200).tolist()
    places = [k + np.arange(count) / count for k, count in enumerate(counts)]
    return np.asarray(np.interp(np.append(np.concatenate(places), len(counts)), range(len(z)), z))


def label_places(
    drawn: Drawing, pose: int, boxes: Sequence[complex], shown: Frame, further: Complex
) -> list[complex]:
    """The centre of the label of each link, m; `boxes` are widths + i heights, m.

    A label stands beside its link, where the distance to other links, to labels before it, and to
    the `further` points (arrows) is largest.
    """
    points, owners = obstacles(drawn, pose)
    taken: list[tuple[complex, complex]] = []
    for k, box in enumerate(boxes):
        others = np.concatenate([points[owners != k], further])
        candidates = list(_beside(drawn, pose, k, box))
        taken.append((free_place(candidates, box, others, taken, shown), box))
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
    turns = [sign * part for part in np.linspace(0.0, np.pi, 13) for sign in (1, -1)][1:]
    for (tail, head), box in zip(arrows, boxes, strict=True):
        along = (head - tail) / (abs(head - tail) or 1.0)  # 0 where it is far off, and short
        out = along * np.exp(1j * np.array(turns))
        reach = 0.5 * np.minimum(
            box.real / np.maximum(np.abs(out.real), 1e-9),
            box.imag / np.maximum(np.abs(out.imag), 1e-9),
        )
        candidates = [head + out * (reach + gap * box.imag) for gap in (0.4, 1.5, 2.6)]
        place = free_place(np.concatenate(candidates).tolist(), box, points, taken, shown)
        taken.append((place, box))
    return [place for place, _ in taken[len(labels) :]]


def free_place(
    candidates: Sequence[complex],
    box: complex,
    points: Complex,
    taken: Sequence[tuple[complex, complex]],
    shown: Frame,
) -> complex:
    """The candidate whose box has most room; earlier ones are better where room is enough."""
    centres = np.array(candidates)
    clear = _gap(centres[:, None] - points, box).min(axis=1, initial=math.inf)
    for place, other in taken:
        clear = np.minimum(clear, _gap(centres - place, box + other))
    score = np.minimum(clear / box.imag, 1.0) - 0.03 * np.arange(len(centres))
    score -= 2.0 * (clear <= 0.0)
    low, high = complex(shown.left, shown.bottom), complex(shown.right, shown.top)
    room = high - low - box - 0.6 * box.imag * (1 + 1j)  # some to the edges
    score -= 10.0 * (_gap(centres - 0.5 * (low + high), room) > 0.0)
    return candidates[int(score.round(9).argmax())]


def _gap(apart: Complex, box: complex) -> Array:
    """From a box to points that are so far `apart` from its centre, m."""
    across, up = np.abs(apart.real) - 0.5 * box.real, np.abs(apart.imag) - 0.5 * box.imag
    return np.asarray(np.hypot(np.maximum(across, 0.0), np.maximum(up, 0.0)))


def _beside(drawn: Drawing, pose: int, k: int, box: complex) -> Iterator[complex]:
    """Centres of a label on both sides of link k, from its middle outward."""
    b = drawn.body_of(k)
    place, direction = complex(drawn.place[pose, b]), complex(drawn.turn[pose, b])
    shapes = [s for s in drawn.bodies[b].shapes if s.kind in ("link", "rail", "slider")]
    rounds = (np.append(s.points, s.points[0]) for s in shapes)
    outline = np.concatenate([_dense(z, 0.2 * box.imag) for z in rounds])
    slides = [s for x in drawn.bodies if x.link == k for s in x.shapes if s.kind == "slider"]
    further = (0.0, 1.0, 2.0) if slides or len(shapes) > 1 else (0.0, 1.0)  # out of where it slides
    along = 0.5 * (abs(direction.real) * box.real + abs(direction.imag) * box.imag)
    half = 0.5 * (abs(direction.imag) * box.real + abs(direction.real) * box.imag)
    for part in ALONG:
        foot = part * drawn.mechanism.description.links[k].l
        near = outline[np.abs(outline.real - foot) <= along].imag
        for more, side in product(further, (1, -1)):
            reach = float((side * near).max(initial=0.0)) + half + (0.2 + more) * box.imag
            yield place + direction * (foot + 1j * side * reach)
