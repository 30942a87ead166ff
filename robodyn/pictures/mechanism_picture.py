"""Pictures of mechanisms, by matplotlib (the extra `plot`).

The plane is to scale: a metre is as long across as up.  Labels are boxes of known size, put where
they hide least.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.pictures.chart_figure import new_figure
from robodyn.pictures.drawing import Drawing, Trace, span
from robodyn.pictures.force_arrows import Force, arc, arrows, metres_a_newton, with_prefix
from robodyn.pictures.value_map import COLOURS
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


# Okabe and Ito's colours, which colour-blind people tell apart, in pale, one a link
LINK_COLOURS = ("#9ad0f3", "#f5c86e", "#7fd1b4", "#e3b4cf", "#f3ec9a", "#8fb8dd", "#efaa80")
INK = "#222222"
FORCE_COLOURS = {"gravity": "#0072b2", "pin": "#d55e00", "load": "#007a5a", "drive": "#a3357e"}
TURN = 3.0  # radius of the arc of a torque, half widths of a link
DASHED = {"edgecolor": "#777777", "linewidth": 0.7, "linestyle": (0, (8, 3, 1, 3))}
STYLES: dict[str, dict[str, Any]] = {
    "support": {"facecolor": "#e6e6e6", "edgecolor": INK, "linewidth": 0.8, "zorder": 1},
    "hatch": {"edgecolor": "#555555", "linewidth": 0.7, "zorder": 1},
    "guide": {"edgecolor": INK, "linewidth": 1.0, "zorder": 1},
    "axis": {**DASHED, "zorder": 1},
    "wheel": {"facecolor": "none", "edgecolor": "#777777", "linewidth": 1.0, "zorder": 1.5},
    "cam": {"edgecolor": INK, "linewidth": 0.9, "zorder": 0.9},
    "roller": {"facecolor": "white", "edgecolor": INK, "linewidth": 0.9, "zorder": 3.05},
    "face": {"edgecolor": INK, "linewidth": 2.0, "zorder": 3.05},
    "block": {"edgecolor": INK, "linewidth": 0.9, "zorder": 2},
    # a rod lies below the link that it slides in, a block above slots and rails of its link
    "rod": {"edgecolor": INK, "linewidth": 0.9, "zorder": 2.5},
    "slider": {"edgecolor": INK, "linewidth": 0.9, "zorder": 2.999},
    "link": {"edgecolor": INK, "linewidth": 0.9, "zorder": 3},
    "rail": {"edgecolor": INK, "linewidth": 0.9, "zorder": 3.003},
    "slot": {"facecolor": "white", "edgecolor": INK, "linewidth": 0.7, "zorder": 3.004},
    "line": {**DASHED, "zorder": 3.005},
    "payload": {"facecolor": "#888888", "edgecolor": INK, "linewidth": 0.9, "zorder": 3.1},
    "centre": {"facecolor": "white", "edgecolor": INK, "linewidth": 0.7, "zorder": 5},
    "quarter": {"facecolor": INK, "edgecolor": INK, "linewidth": 0.3, "zorder": 5.1},
    "spring": {"edgecolor": "#0b5a8a", "linewidth": 1.1, "zorder": 4},
    "tip": {"facecolor": INK, "edgecolor": INK, "linewidth": 0.3, "zorder": 5},
    "joint": {"facecolor": "white", "edgecolor": INK, "linewidth": 0.9, "zorder": 6},
    "scale bar": {"edgecolor": "#555555", "linewidth": 1.0, "zorder": 9},
}
ARROW = {"arrowstyle": "-|>", "lw": 1.5, "shrinkA": 0, "shrinkB": 0}
COLOURED = ("link", "cam", "block", "rail", "slider", "rod")
GHOSTS = ("link", "cam", "block", "joint", "rail", "slot", "slider", "rod")
LONGEST = 6.0  # inches of the longer side, where no size is given
FOOT = 0.3  # inches kept free for the scale bar
FONT = 9.0  # points
PANEL = 3.6  # inches of the longer side of one of several pictures, where no size is given
ABREAST = 4  # of several pictures, the most in a row
HEAD = 0.3  # inches of a title


def style_of(kind: str, closed: bool, link: int | None) -> dict[str, Any]:
    """Return the style of a shape, as arguments of matplotlib."""
    style = {"facecolor": "none"} | STYLES[kind]
    if kind in COLOURED:
        style["facecolor"] = LINK_COLOURS[(link or 0) % len(LINK_COLOURS)]
    return style if closed else style | {"facecolor": "none"}


def mechanism_figure(
    drawn: Drawing,
    texts: Sequence[str] = (),
    traces: Sequence[Trace] = (),
    found: Sequence[Force] = (),
    size: Size = None,
) -> Any:
    """The last pose of a drawing in full, the others pale behind it.

    With the links' texts, if any, the paths of points, and forces as arrows.
    """
    placed: list[tuple[complex, complex]] = []
    turning: list[Complex] = []
    if found:
        torques = [item for item in found if item.torque]
        pulls = [item for item in found if not item.torque]
        found = pulls + torques
        placed = arrows(pulls, metres_a_newton(pulls, span(drawn.mechanism, drawn.q)))
        turning = [arc(item, TURN * drawn.half_width) for item in torques]
    room = (6.0 + 2.5j) * drawn.half_width  # for the texts at the arrows' heads
    ends = [z for pair in placed for z in pair] + [complex(z[-1]) for z in turning]
    around = [z + d for z in ends for d in (room, -room)]
    around += [z for points in turning for z in points.tolist()]
    around += [z for trace in traces for z in trace.path.tolist()]
    picture = Picture(drawn, size, around)
    last = len(drawn.q) - 1
    for k in range(last):
        picture.ghost(k, 0.15 + 0.35 * (k + 1) / (last + 1))
    picture.show(last)
    picture.trace(traces)
    picture.annotate(last, texts, found, placed, turning)
    return picture.figure


def poses_figure(
    drawn: Drawing,
    titles: Sequence[str],
    texts: Sequence[str] = (),
    traces: Sequence[Sequence[Trace]] = (),
    size: Size = None,
) -> Any:
    """All poses of a drawing side by side, to one scale, each under its title.

    With the links' texts, if any, and of each pose the paths of points.
    """
    count = len(titles)
    rows = -(-count // ABREAST)
    columns = -(-count // rows)
    if size is not None:
        size = size[0] / columns, max(size[1] / rows - HEAD, 0.5 * size[1] / rows)
    around = [z for each in traces for trace in each for z in trace.path.tolist()]
    shown = frame(drawn.box(around), PANEL, size, FOOT)
    width, height = columns * shown.width, rows * (shown.height + HEAD)
    figure = new_figure((width, height), facecolor="white")
    for k, title in enumerate(titles):
        row, column = divmod(k, columns)
        top = 1.0 - row / rows
        across, up = 1.0 / columns, shown.height / height
        place = column / columns, top - HEAD / height - up, across, up
        picture = Picture(drawn, (shown.width, shown.height), around, (figure, place))
        picture.show(k)
        picture.trace(traces[k])
        picture.annotate(k, texts)
        middle = (column + 0.5) / columns
        style = {"ha": "center", "va": "center", "fontsize": FONT + 1.0, "color": INK}
        figure.text(middle, top - 0.5 * HEAD / height, title, **style)
    return figure


class Picture:
    """A figure of a drawing, with room for `further` points; what moves is moved by `show`.

    It may be a part of another figure: with the place (left, bottom, width, height) there.
    """

    def __init__(
        self,
        drawn: Drawing,
        size: Size = None,
        further: Sequence[complex] = (),
        part: tuple[Any, tuple[float, float, float, float]] | None = None,
    ) -> None:
        self.drawn = drawn
        self.frame = frame(drawn.box(further), LONGEST, size, FOOT)
        if part is None:
            whole = new_figure((self.frame.width, self.frame.height), facecolor="white")
            part = whole, (0.0, 0.0, 1.0, 1.0)
        self.figure, place = part
        self.axes = self.figure.add_axes(place)
        self.axes.set_axis_off()
        self.axes.set_xlim(self.frame.left, self.frame.right)
        self.axes.set_ylim(self.frame.bottom, self.frame.top)
        self._patches: list[Any] = []
        for b, shape, z in drawn.placed(0):
            patch = self._polygon(shape.kind, z, shape.closed, drawn.bodies[b].link)
            patch.set_zorder(patch.get_zorder() + 0.01 * b)
            self._patches.append(patch)
        bar = scale_bar_line(self.frame)
        self._polygon("scale bar", bar, False, None)
        z = bar[2] + (0.06 - 0.005j) * self.frame.scale
        style = {"ha": "left", "va": "baseline", "zorder": 9}
        text = scale_bar(self.frame)[1]
        self.axes.text(z.real, z.imag, text, color="#555555", fontsize=FONT - 1.5, **style)

    def show(self, pose: int) -> None:
        """Move all bodies to a pose."""
        for patch, (_, _, z) in zip(self._patches, self.drawn.placed(pose), strict=True):
            patch.set_xy(np.column_stack([z.real, z.imag]))

    def ghost(self, pose: int, strength: float) -> None:
        """The outlines of the links at another pose, pale, behind the picture."""
        for b, shape, z in self.drawn.placed(pose):
            body = self.drawn.bodies[b]
            if shape.kind in GHOSTS and body.link is not None:
                patch = self._polygon(shape.kind, z, shape.closed, body.link)
                patch.set(alpha=strength, zorder=0.5 + 0.001 * pose + 1e-5 * b, linewidth=0.6)

    def trace(self, traces: Sequence[Trace]) -> None:
        """The paths of points, with a cross and the name at the end of each."""
        for k, (name, z) in enumerate(traces):
            colour = COLOURS[(k + 1) % len(COLOURS)]
            self.axes.plot(z.real, z.imag, color=colour, lw=1.3, zorder=2.5)
            self.axes.plot(z[-1].real, z[-1].imag, "+", color=colour, ms=9.0, mew=1.8, zorder=9)
            self._text(self._beside(z[-1], name), name, colour, 9)

    def _beside(self, z: complex, text: str) -> complex:
        """Return the position of a text beside a point: at its upper right, within the frame."""
        far = self.extent(text) * 1.2  # the text's other end
        right = 1.0 if z.real + far.real <= self.frame.right else -1.0
        up = 1.0 if z.imag + far.imag <= self.frame.top else -1.0
        return z + complex(right * far.real, up * far.imag) * (0.7 / 1.2)

    def annotate(
        self,
        pose: int,
        names: Sequence[str],
        found: Sequence[Force] = (),
        arrows: Sequence[tuple[complex, complex]] = (),
        arcs: Sequence[Complex] = (),
    ) -> None:
        """The links' names beside them, and arrows of forces with their sizes at their heads.

        Those of torques, which come last, are `arcs`.
        """
        lines = [a + (b - a) * np.linspace(0, 1, 12) for a, b in arrows] + list(arcs)
        shafts = np.concatenate([np.zeros(0, complex), *lines])
        heads = [*arrows, *((complex(z.mean()), complex(z[-1])) for z in arcs)]
        boxes = [self.extent(text) for text in names]
        places = label_places(self.drawn, pose, boxes, self.frame, shafts)
        for text, z in zip(names, places, strict=True):
            self._text(z, text, INK, 8)
        texts = [
            f"{x.name} = "
            + (with_prefix(abs(x.torque), "N m") if x.torque else with_prefix(abs(x.force), "N"))
            for x in found
        ]
        points = np.append(obstacles(self.drawn, pose)[0], shafts)
        sizes = [self.extent(text) for text in texts]
        labels = list(zip(places, boxes, strict=True))
        around = head_places(heads, sizes, points, self.frame, labels)
        for item, text, z, line in zip(found, texts, around, lines, strict=True):
            colour = FORCE_COLOURS[item.kind]
            self._text(z, text, colour, 9)
            tail, head = line[0], line[-1]
            if item.torque:
                self.axes.plot(line[:-1].real, line[:-1].imag, color=colour, lw=1.5, zorder=7)
                tail = line[-2]
            ends = (head.real, head.imag), (tail.real, tail.imag)
            self.axes.annotate("", *ends, arrowprops=ARROW | {"color": colour}, zorder=7)

    def extent(self, text: str) -> complex:
        """The size of a text: width + i height, m."""
        from matplotlib.font_manager import FontProperties
        from matplotlib.textpath import TextPath

        ends = TextPath((0.0, 0.0), text, size=FONT, prop=FontProperties()).get_extents()
        return complex(ends.width + 2.0, FONT) / 72.0 * self.frame.scale

    def _text(self, z: complex, text: str, colour: str, zorder: float) -> None:
        from matplotlib.patheffects import withStroke

        style = {"color": colour, "fontsize": FONT, "zorder": zorder}
        rim = [withStroke(linewidth=2.0, foreground="white")]
        self.axes.text(z.real, z.imag, text, ha="center", va="center", path_effects=rim, **style)

    def _polygon(self, kind: str, z: Any, closed: bool, link: int | None) -> Any:
        from matplotlib.patches import Polygon

        style = style_of(kind, closed, link) | {"joinstyle": "round", "capstyle": "round"}
        corners = np.column_stack([z.real, z.imag])
        return self.axes.add_patch(Polygon(corners, closed=closed, **style))
