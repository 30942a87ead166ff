"""Figures by matplotlib (the extra `plot`): charts, how any figure is begun, and files of them."""

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

from robodyn.errors import RobodynError
from robodyn.pictures.chart import Chart, Panel, limits, spread
from robodyn.pictures.colour_scale import COLOURS
from robodyn.tables.csv_fields import shown
from robodyn.tables.output_file import open_output

if TYPE_CHECKING:
    from robodyn.simulation.benchmark import Benchmark

MARKS = "osD^vP*X"
LINE_STYLES = ("-", "--", ":", "-.")
DOTS = 150  # an inch


def check_matplotlib(what: str) -> None:
    if find_spec("matplotlib") is None:
        raise RobodynError(what, limit="needs the extra `plot`: pip install 'robodyn[plot]'")


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

    Columns have colours and files line styles; where there is one column files have both.
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
        rises = all((np.diff(curve.x) >= 0.0).all() for curve in panel.curves)  # as against time
        for curve in panel.curves:
            shade = columns.index(curve.column) if len(columns) > 1 else curve.file
            style = {
                "color": COLOURS[shade % len(COLOURS)],
                "ls": LINE_STYLES[curve.file % len(LINE_STYLES)],
                "marker": "o" if len(curve.x) == 1 else "",
            }
            axes.plot(curve.x, curve.y, lw=1.4, ms=4, label=curve.label, **style)
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
    figure.align_ylabels(stacked)
    return figure


def _name_curves(axes: Any, panel: Panel, rises: bool, inches: float) -> None:
    """Names at the curves' ends, one below another where they would overlap."""
    lines = axes.get_lines()
    ends = [int(curve.x.argmax()) if rises else -1 for curve in panel.curves]
    low, high = axes.get_ylim()
    gap = 0.17 / max(inches, 0.3) * (high - low)
    heights = [float(curve.y[end]) for curve, end in zip(panel.curves, ends, strict=True)]
    places = spread(heights, gap, low, high)
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
            axes.plot(curve.x[-1], curve.y[-1], "o", ms=4, color=line.get_color())


# of a user's settings of matplotlib: the fonts that have the letters of names, and a program
USERS = ("font.family", "font.sans-serif", "font.serif", "font.monospace", "animation.ffmpeg_path")


def new_figure(size: tuple[float, float], formulas: bool = False, **options: Any) -> Any:
    """A figure of this size, inches, that draws without a screen.

    Unless it has `formulas`, a dollar in a text stands for itself: names may hold any.
    """
    logging.getLogger("matplotlib").setLevel(logging.CRITICAL)  # where it may keep its files
    os.environ["MPLBACKEND"] = "agg"
    try:
        import matplotlib  # noqa: F401
    except ValueError:  # settings that are no text: without any
        os.environ["MATPLOTLIBRC"] = os.devnull
        for name in [name for name in sys.modules if name.startswith("matplotlib")]:
            del sys.modules[name]
    from matplotlib import rcdefaults, rcParams
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from robodyn.pictures.shown_figure import ShownFigure

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
    """Write the figure, all or nothing; the same figure makes the same bytes.

    A .png has `dpi` dots an inch, and the 256 colours that suit it best, in a third of the bytes.
    """
    from matplotlib import rc_context
    from PIL import Image

    dates = {"png": "Software", "svg": "Date", "pdf": "CreationDate"}
    drawn, written = BytesIO(), BytesIO()
    with rc_context({"svg.hashsalt": "robodyn"}), open_output(path) as stream:
        with warnings.catch_warnings():  # long names may leave little room
            warnings.simplefilter("ignore", UserWarning)
            figure.savefig(drawn, format=format, dpi=dpi, metadata={dates[format]: None})
        if format == "png":
            with Image.open(drawn) as image:
                small = image.convert("RGB").quantize(256, dither=Image.Dither.NONE)
                small.save(written, format="PNG", optimize=True, dpi=image.info["dpi"])
        stream.write((written if format == "png" else drawn).getvalue())
