"""Figures by matplotlib (the extra `plot`): charts, maps, how any figure is begun, and files."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn.dynamics.columns import unit_of, with_unit
from robodyn.errors import InputError, RobodynError
from robodyn.pictures.chart import Chart, Panel, limits, spread
from robodyn.pictures.value_map import (
    COLOURS,
    LEVELS,
    NONE,
    ValueMap,
    angle_ticks,
    painted,
    viridis,
    word_colours,
)
from robodyn.tables.csv_fields import shown
from robodyn.tables.output_file import open_output

if TYPE_CHECKING:
    from robodyn.runs.benchmark import Benchmark

MARKS = "osD^vP*X"
LINE_STYLES = ("-", "--", ":", "-.")
DOTS = 150  # an inch
# of maps
LONGEST = 5.6  # inches of the longer side of the map, where no size is given
LEAST_DOTS = 640  # of a side whose cells are whole dots
WIDE = 1.4  # width to height of a map that is not to scale
PAD = 0.12  # inches around all
LEAST = 0.2  # inches of a side
MOST_POINTS = 50_000  # drawn as discs; more become the dots of a raster
RASTER = 500  # dots across and up
MOST_SHAPES = 2_000  # points that an .svg or .pdf holds as shapes


def check_matplotlib(what: str) -> None:
    if find_spec("matplotlib") is None:
        raise RobodynError(what, limit="needs the extra `plot`: pip install '.[plot]'")


def work_precision(result: Benchmark, title: str, path: str, slides: bool = False) -> None:
    """Milliseconds against error, log-log, each method's line labelled at its end."""
    figure = new_figure((8.0, 5.5), formulas=True, layout="constrained")
    units = ("rad, m", "rad/s, m/s") if slides else ("rad", "rad/s")
    label = "largest error of q ({}) and qd ({})".format(*units)
    axes = figure.add_subplot(xlabel=label, ylabel="time of a run, ms")
    labelled: list[tuple[float, float]] = []
    names = list(dict.fromkeys(x.method for x in result.measurements))
    for i, name in enumerate(names):
        runs = [x for x in result.measurements if x.method == name and np.isfinite(x.least)]
        if not runs:
            continue
        error, least = [x.error for x in runs], [1e3 * x.least for x in runs]
        own = name.startswith("taylor")
        colour = str(0.0 if own else 0.25 + 0.4 * i / len(names))
        style = {"color": colour, "lw": 2.0 if own else 1.2, "marker": MARKS[i % len(MARKS)]}
        axes.plot(error, least, ms=5, label=name, **style)
        end = min(zip(error, least, strict=True))
        place = float(np.log10(end[0])), float(np.log10(end[1]))
        close = any(abs(place[0] - x) < 2.0 and abs(place[1] - y) < 0.15 for x, y in labelled)
        labelled.append(place)
        offset = {"xytext": (-6, 14 if close else 3), "textcoords": "offset points"}
        axes.annotate(name, end, ha="right", color=colour, **offset)
    axes.axvline(result.reference.uncertainty, color="0.8", lw=1.0, ls=":")
    axes.margins(y=0.1)
    if labelled:  # matplotlib has no logarithms of nothing
        axes.set(xscale="log", yscale="log")
    axes.set_title(shown(title), parse_math=False)
    axes.grid(True, which="major", color="0.9")
    low, high = axes.get_xlim()
    axes.set_xlim(low / 30.0, min(high, 10.0))
    save(figure, path, Path(path).suffix[1:].lower(), 2 * DOTS)


def chart_figure(content: Chart, size: tuple[float, float] | None, title: str = "") -> Any:
    """A chart's panels, stacked; each curve has its name at its end, or in a box if they are many.

    Columns have colours and files line styles; where there is one column files have both.  A legend
    above tells the line styles of several files.
    """
    panels = content.panels
    height = 4.5 if len(panels) == 1 else 1.0 + 2.0 * len(panels)
    figure = new_figure(size or (8.0, height), layout="constrained")
    figure.get_layout_engine().set(h_pad=0.06, w_pad=0.06)
    stacked = figure.subplots(len(panels), sharex=True, squeeze=False)[:, 0]
    x_limits = limits([curve.x for curve in content.curves])
    inches = figure.get_size_inches()[1] / len(panels) - 0.5
    for axes, panel in zip(stacked, panels, strict=True):
        columns = list(dict.fromkeys(curve.column for curve in panel.curves))
        rises = all(curve.rises for curve in panel.curves)
        for curve in panel.curves:
            shade = columns.index(curve.column) if len(columns) > 1 else curve.file
            alone = [int(run[0]) for run in curve.runs if len(run) == 1]
            style = {
                "color": COLOURS[shade % len(COLOURS)],
                "ls": LINE_STYLES[curve.file % len(LINE_STYLES)] if curve.joined else "",
                "marker": "o" if alone else "",
                "markevery": alone,
                "ms": 4 if curve.joined else 3,
                "rasterized": len(alone) > MOST_SHAPES,
            }
            axes.plot(curve.x, curve.y, lw=1.4, label=curve.label, **style)
        axes.set_ylabel(panel.label)
        axes.grid(True, color="0.9", lw=0.7)
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0.0 if rises else 0.04, y=0.06)
        if content.to_scale:
            axes.set_aspect("equal", adjustable="datalim")
        else:
            low, high = limits([curve.y for curve in panel.curves])
            margin = 0.06 * (high - low)
            axes.set_ylim(low - margin, high + margin)
            if rises:
                axes.set_xlim(*x_limits)
        _name_curves(axes, panel, rises, inches)
    stacked[-1].set_xlabel(content.x_label)
    stacked[0].set_title(title)
    if content.files and any(curve.joined for curve in content.curves):
        _tell_files(figure, content)
    figure.align_ylabels(stacked)
    return figure


def _tell_files(figure: Any, content: Chart) -> None:
    """Which line style is which file's, above all panels."""
    from matplotlib.lines import Line2D

    styles = [LINE_STYLES[k % len(LINE_STYLES)] for k in range(len(content.files))]
    files = zip(content.files, styles, strict=True)
    handles = [Line2D([], [], color="0.2", lw=1.4, ls=style, label=x) for x, style in files]
    figure.legend(handles=handles, loc="outside upper right", ncols=4, frameon=False)


def _name_curves(axes: Any, panel: Panel, rises: bool, inches: float) -> None:
    """Names at the curves' ends, one below another where they would overlap."""
    lines = axes.get_lines()
    ends = [curve.end for curve in panel.curves]
    low, high = axes.get_ylim()
    gap = 0.17 / max(inches, 0.3) * (high - low)
    heights = [float(curve.y[end]) for curve, end in zip(panel.curves, ends, strict=True)]
    places = spread(heights, gap, low, high) if all(x.joined for x in panel.curves) else None
    if places is None:
        columns = int(1 + len(lines) * gap // (high - low))
        beside = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "ncols": columns}
        axes.legend(lines, [curve.label for curve in panel.curves], frameon=False, **beside)
        return
    beside = {"xytext": (5, 0), "textcoords": "offset points", "ha": "left", "va": "center"}
    for line, curve, end, place in zip(lines, panel.curves, ends, places, strict=True):
        style = {"color": line.get_color(), "fontsize": 9, "annotation_clip": False}
        axes.annotate(curve.label, (curve.x[end], place), **beside, **style)
        if not rises:
            axes.plot(curve.x[end], curve.y[end], "o", ms=4, color=line.get_color())


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
    # about as long, so that each cell has as many dots
    counts, least = np.array(content.grid.row.shape[::-1]), LEAST_DOTS * sides / LONGEST
    even = np.where(counts > 2 * least, sides, np.ceil(least / counts) * counts / DOTS)
    if flat is None:
        return even
    return even[0] / np.array([1, wide]) if counts[0] >= counts[1] else even[1] * [wide, 1]


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


# of a user's settings of matplotlib: the fonts that have the letters of names, and a program
USERS = ("font.family", "font.sans-serif", "font.serif", "font.monospace", "animation.ffmpeg_path")


def new_figure(size: tuple[float, float], formulas: bool = False, **options: Any) -> Any:
    """A figure of this size, inches, that draws without a screen.

    Unless it has `formulas`, a dollar in a text stands for itself: names may hold any.
    """
    logging.getLogger("matplotlib").setLevel(logging.CRITICAL)  # where it may keep its files
    os.environ["MPLBACKEND"] = "agg"
    try:
        import matplotlib
    except ValueError:  # settings that are no text: without any
        os.environ["MATPLOTLIBRC"] = os.devnull
        for name in [name for name in sys.modules if name.startswith("matplotlib")]:
            del sys.modules[name]
        try:
            import matplotlib  # noqa: F401
        except ValueError:  # one in the working directory goes before all others
            limit = "is no text in UTF-8: write it anew, or work in another directory"
            raise InputError("matplotlibrc", where=os.getcwd(), limit=limit) from None
    from matplotlib import rcdefaults, rcParams
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        """A figure that a notebook shows by itself, pyplot or not, as a picture of dots."""

        def _repr_png_(self) -> bytes:
            drawn = BytesIO()
            self.savefig(drawn, format="png")
            return drawn.getvalue()

    settings: Any = rcParams
    kept = {name: settings[name] for name in USERS}
    rcdefaults()  # what else a user has set may need programs that are not there
    settings.update({**kept, "text.parse_math": formulas})
    # a font without the letters of a name draws boxes
    warnings.filterwarnings("ignore", "Glyph", UserWarning)
    figure = ShownFigure(figsize=size, **options)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Any, path: str | None, format: str, dpi: int = DOTS) -> None:
    """Write the figure, all or nothing; the same figure makes the same bytes."""
    from matplotlib import rc_context

    dates, drawn = {"png": "Software", "svg": "Date", "pdf": "CreationDate"}, BytesIO()
    with rc_context({"svg.hashsalt": "robodyn"}), open_output(path) as stream:
        with warnings.catch_warnings():  # long names may leave little room
            warnings.simplefilter("ignore", UserWarning)
            figure.savefig(drawn, format=format, dpi=dpi, metadata={dates[format]: None})
        stream.write(drawn.getvalue())
