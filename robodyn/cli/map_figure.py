"""The figure of a map, by matplotlib (the extra `plot`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robodyn.cli.figures import DOTS, new_figure
from robodyn.pictures.colour_scale import (
    COLOURS,
    LEVELS,
    NONE,
    ColourScale,
    Rgb,
    angle_ticks,
    painted,
    rgb,
    viridis,
    word_colours,
)
from robodyn.pictures.column_units import unit_of, with_unit
from robodyn.pictures.value_map import ValueMap
from robodyn.tables.csv_fields import shown

LONGEST = 5.6  # inches of the longer side of the map, where no size is given
LEAST_DOTS = 640  # of a side whose cells are whole dots
WIDE = 1.4  # width to height of a map that is not to scale
PAD = 0.12  # inches around all
MOST_POINTS = 50_000  # drawn as discs; more become the dots of a raster
RASTER = 500  # dots across and up
MOST_SHAPES = 2_000  # points that an .svg or .pdf holds as shapes
INK = "#333333"


def map_figure(content: ValueMap, size: tuple[float, float] | None) -> Any:
    """A map with its colour bar, or its words, at the right."""
    figure = new_figure(size or (LONGEST, LONGEST))
    axes = figure.add_subplot()
    if content.grid is not None:
        _cells(axes, content.grid.x_edges, content.grid.y_edges, content.grid.row, content)
    elif len(content.x) > MOST_POINTS:
        left, right, bottom, top = content.box
        edges = np.linspace(left, right, RASTER + 1), np.linspace(bottom, top, RASTER + 1)
        _cells(axes, *edges, content.rows_at(RASTER, RASTER), content)
    else:
        _points(axes, content)
    axes.tick_params(color=INK, labelcolor=INK)
    axes.spines[:].set(color=INK, linewidth=0.8)
    for axis, name in ((axes.xaxis, content.x_name), (axes.yaxis, content.y_name)):
        axis.set_label_text(with_unit(shown(name)), color=INK)
        if unit_of(name) == "rad":
            low, high = axis.get_view_interval()
            values, texts = angle_ticks(low, high, 9)
            axis.set_ticks(values, [text.replace("-", "−") for text in texts])
    if content.words:
        _name_words(axes, content)
    else:
        _colour_bar(axes, content)
    _place(figure, axes, content, size)
    return figure


def map_palette() -> list[Rgb]:
    """The colours of a map: at most 256, of which a .png need hold no others."""
    shades = viridis(np.linspace(0.0, 1.0, LEVELS)).tolist()
    words = [rgb(colour) for colour in (*COLOURS, NONE, INK)]
    greys = [(k, k, k) for k in range(51, 256, 4)]
    return [*((r, g, b) for r, g, b in shades), *words, *greys]


def _place(figure: Any, axes: Any, content: ValueMap, size: tuple[float, float] | None) -> None:
    """Give the map the room that the texts around it leave; without a size, fit the figure."""
    (x_low, x_high), (y_low, y_high) = axes.get_xlim(), axes.get_ylim()
    flat = (x_high - x_low) / (y_high - y_low) if content.to_scale else None
    for _ in range(2):  # what stands beside the map depends on its size, a little
        renderer = figure.canvas.get_renderer()
        outer, own = figure.get_tightbbox(renderer), axes.bbox
        dots = figure.dpi
        left, below = own.x0 / dots - outer.x0 + PAD, own.y0 / dots - outer.y0 + PAD
        right, above = outer.x1 - own.x1 / dots + PAD, outer.y1 - own.y1 / dots + PAD
        left, below = _whole(left), _whole(below)
        if size is None:
            width, height = _inside(content, flat)
            figure.set_size_inches(_whole(left + width + right), _whole(below + height + above))
        whole_width, whole_height = figure.get_size_inches()
        width = max(0.2, whole_width - left - right)
        height = max(0.2, whole_height - below - above)
        if size is None:
            width, height = _inside(content, flat)
        elif flat is not None:
            width, height = min(width, height * flat), min(height, width / flat)
        axes.set_position(
            (left / whole_width, below / whole_height, width / whole_width, height / whole_height)
        )


def _inside(content: ValueMap, flat: float | None) -> tuple[float, float]:
    """Width and height of the map, inches; a cell is a whole number of dots where it can be."""
    wide = flat or WIDE
    width, height = LONGEST * min(1.0, wide), LONGEST * min(1.0, 1.0 / wide)
    if content.grid is None:
        return width, height
    ny, nx = content.grid.row.shape
    if flat is None:
        return _dots_of(nx, width), _dots_of(ny, height)
    if nx >= ny:
        width = _dots_of(nx, width)
        return width, width / wide
    height = _dots_of(ny, height)
    return height * wide, height


def _dots_of(count: int, inches: float) -> float:
    """About `inches`, so that each of `count` cells has as many dots."""
    least = LEAST_DOTS * inches / LONGEST
    return inches if count > 2 * least else math.ceil(least / count) * count / DOTS


def _whole(inches: float) -> float:
    return math.ceil(inches * DOTS) / DOTS


def _cells(axes: Any, x_edges: Any, y_edges: Any, row: Any, content: ValueMap) -> None:
    image = np.full((*row.shape, 3), 255, np.uint8)
    there = row >= 0
    image[there] = painted(content.values[row[there]], content.scale, content.words)
    axes.pcolorfast(x_edges, y_edges, image)


def _points(axes: Any, content: ValueMap) -> None:
    none = np.isnan(content.values)
    area = float(np.clip(20_000.0 / len(none), 3.0, 36.0))
    axes.set_axisbelow(True)
    axes.grid(True, color="0.92", lw=0.7)
    for some in (none, ~none):  # a point without a value hides no other
        colours = painted(content.values[some], content.scale, content.words) / 255.0
        axes.scatter(
            *(content.x[some], content.y[some]),
            c=colours,
            s=area,
            linewidths=0.0,
            rasterized=len(none) > MOST_SHAPES,
        )
    axes.margins(0.03)


def _colour_bar(axes: Any, content: ValueMap) -> None:
    """The scale beside the map, as high as it; below it the colour of points without a value."""
    foot = 0.1 if content.has_none and content.scale else 0.0
    if content.scale:
        bar = axes.inset_axes((1.03, foot, 0.045, 1.0 - foot))
        fractions = np.linspace(0.0, 1.0, LEVELS)
        bar.imshow(viridis(fractions)[:, None], origin="lower", extent=(0, 1, 0, 1), aspect="auto")
        _bar_ticks(bar, content.scale)
        bar.set_ylabel(with_unit(shown(content.name)), color=INK)
    if content.has_none:
        box = axes.inset_axes((1.03, 0.0, 0.045, 0.05))
        box.set_facecolor(NONE)
        box.set(xticks=[], yticks=[], xlim=(0, 1), ylim=(0, 1))
        text = "none" if content.scale else f"{shown(content.name)}: none"
        box.text(1.2, 0.5, text, ha="left", va="center", color=INK)
        box.spines[:].set(color=INK, linewidth=0.8)


def _bar_ticks(bar: Any, scale: ColourScale) -> None:
    values, texts = scale.ticks(9)
    bar.yaxis.tick_right()
    bar.yaxis.set_label_position("right")
    bar.set_xticks([])
    bar.set_yticks(scale.fraction(np.array(values)), [text.replace("-", "−") for text in texts])
    bar.tick_params(color=INK, labelcolor=INK)
    bar.spines[:].set(color=INK, linewidth=0.8)


def _name_words(axes: Any, content: ValueMap) -> None:
    from matplotlib.patches import Patch

    colours = [*("#{:02x}{:02x}{:02x}".format(*c) for c in word_colours(len(content.words)))]
    words = list(map(shown, content.words))
    if content.has_none:
        colours, words = [*colours, NONE], [*words, "none"]
    legend = axes.legend(
        [Patch(color=colour) for colour in colours],
        words,
        title=with_unit(shown(content.name)),
        loc="upper left",
        bbox_to_anchor=(1.01, 1.015),
        alignment="left",
        frameon=False,
    )
    for text in (legend.get_title(), *legend.get_texts()):
        text.set(color=INK)
