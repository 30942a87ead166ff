"""The figure of a map, by matplotlib (the extra `plot`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robodyn.pictures.chart_figure import DOTS, new_figure
from robodyn.pictures.colour_scale import (
    LEVELS,
    NONE,
    angle_ticks,
    painted,
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
LEAST = 0.2  # inches of a side
MOST_POINTS = 50_000  # drawn as discs; more become the dots of a raster
RASTER = 500  # dots across and up
MOST_SHAPES = 2_000  # points that an .svg or .pdf holds as shapes


def map_figure(content: ValueMap, size: tuple[float, float] | None, title: str = "") -> Any:
    """A map with its colour bar, or its words, at the right."""
    figure = new_figure(size or (LONGEST, LONGEST))
    axes = figure.add_subplot()
    axes.set_title(title)
    if content.grid is None and len(content.x) <= MOST_POINTS:
        _points(axes, content)
    else:
        left, right, bottom, top = content.box
        edges = np.linspace((left, bottom), (right, top), RASTER + 1).T
        x_edges, y_edges, row, _ = content.grid or (*edges, content.rows_at(RASTER, RASTER), 0)
        shades = painted(content.values[row], content.scale, content.words)
        shades[row < 0] = 255
        axes.pcolorfast(x_edges, y_edges, shades)
    for axis, name in ((axes.xaxis, content.x_name), (axes.yaxis, content.y_name)):
        axis.set_label_text(with_unit(shown(name), content.units))
        if unit_of(name, content.units) == "rad":
            low, high = axis.get_view_interval()
            values, texts = angle_ticks(low, high, 9)
            axis.set_ticks(values, _with_minus(texts))
    if content.words:
        _name_words(axes, content)
    else:
        _colour_bar(axes, content)
    for _ in range(2):  # what stands beside the map depends on its size, a little
        _place(figure, axes, content, size)
    return figure


def _points(axes: Any, content: ValueMap) -> None:
    none = np.isnan(content.values)
    area = float(np.clip(20_000.0 / len(none), 3.0, 36.0))
    axes.set_axisbelow(True)
    axes.grid(True, color="0.92", lw=0.7)
    for some in (none, ~none):  # a point without a value hides no other
        colours = painted(content.values[some], content.scale, content.words) / 255.0
        style = {"s": area, "linewidths": 0.0, "rasterized": len(none) > MOST_SHAPES}
        axes.scatter(content.x[some], content.y[some], c=colours, **style)
    axes.margins(0.03)


def _place(figure: Any, axes: Any, content: ValueMap, size: tuple[float, float] | None) -> None:
    """Give the map the room that the texts around it leave; without a size, fit the figure."""
    (x_low, x_high), (y_low, y_high) = axes.get_xlim(), axes.get_ylim()
    flat = (x_high - x_low) / (y_high - y_low) if content.to_scale else None
    outer, own = figure.get_tightbbox(figure.canvas.get_renderer()), axes.bbox
    low, high = own.min / figure.dpi - outer.min + PAD, outer.max - own.max / figure.dpi + PAD
    low = np.ceil(low * DOTS) / DOTS
    if size is None:
        inside = _inside(content, flat)
        figure.set_size_inches(*(np.ceil((low + inside + high) * DOTS) / DOTS))
    else:
        inside = np.maximum(LEAST, np.array(size) - low - high)
        if flat is not None:
            inside = np.minimum(inside, [inside[1] * flat, inside[0] / flat])
    whole = figure.get_size_inches()
    axes.set_position((*(low / whole), *(inside / whole)))


def _inside(content: ValueMap, flat: float | None) -> Any:
    """Width and height of the map, inches; a cell is a whole number of dots where it can be."""
    wide = flat or WIDE
    sides = LONGEST * np.array([min(1.0, wide), min(1.0, 1.0 / wide)])
    if content.grid is None:
        return sides
    counts = content.grid.row.shape[::-1]
    even = np.array([_even(count, side) for count, side in zip(counts, sides, strict=True)])
    if flat is None:
        return even
    return (
        even[0] / np.array([1, wide]) if counts[0] >= counts[1] else even[1] * np.array([wide, 1])
    )


def _even(count: int, inches: float) -> float:
    """About `inches`, so that each of `count` cells has as many dots."""
    least = LEAST_DOTS * inches / LONGEST
    return inches if count > 2 * least else math.ceil(least / count) * count / DOTS


def _colour_bar(axes: Any, content: ValueMap) -> None:
    """The scale beside the map, as high as it; below it the colour of points without a value."""
    foot = 0.1 if content.has_none and content.scale else 0.0
    if content.scale:
        bar = axes.inset_axes((1.03, foot, 0.045, 1.0 - foot), xticks=[])
        shades = viridis(np.linspace(0.0, 1.0, LEVELS))[:, None]
        bar.imshow(shades, origin="lower", extent=(0, 1, 0, 1), aspect="auto")
        bar.yaxis.tick_right()
        bar.yaxis.set_label_position("right")
        values, texts = content.scale.ticks(9)
        bar.set_yticks(content.scale.fraction(np.array(values)), _with_minus(texts))
        bar.set_ylabel(with_unit(shown(content.name), content.units))
    if content.has_none:
        box = axes.inset_axes((1.03, 0.0, 0.045, 0.05), facecolor=NONE, xticks=[], yticks=[])
        text = "none" if content.scale else f"{shown(content.name)}: none"
        box.text(1.2, 0.5, text, ha="left", va="center", transform=box.transAxes)


def _with_minus(texts: list[str]) -> list[str]:
    return [text.replace("-", "−") for text in texts]


def _name_words(axes: Any, content: ValueMap) -> None:
    from matplotlib.patches import Patch

    colours = ["#{:02x}{:02x}{:02x}".format(*c) for c in word_colours(len(content.words))]
    told = list(zip(colours, map(shown, content.words), strict=True))
    told += [(NONE, "none")] if content.has_none else []
    axes.legend(
        handles=[Patch(color=colour, label=word) for colour, word in told],
        title=with_unit(shown(content.name), content.units),
        loc="upper left",
        bbox_to_anchor=(1.01, 1.015),
        alignment="left",
        frameon=False,
    )
