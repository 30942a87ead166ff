"""Figures of the command line, by matplotlib (the extra `plot`)."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from robodyn.cli.options import PictureFormat
from robodyn.errors import InputError, RobodynError
from robodyn.pictures.chart import Chart, Panel, limits, spread
from robodyn.pictures.colour_scale import COLOURS, Rgb
from robodyn.tables.csv_fields import finite, shown
from robodyn.tables.output_file import on_terminal, open_output

if TYPE_CHECKING:
    from robodyn.simulation.benchmark import Benchmark

SUFFIXES = (".png", ".svg", ".pdf")
MARKS = "osD^vP*X"
LINE_STYLES = ("-", "--", ":", "-.")
DOTS = 150  # an inch
LEAST_SIZE, MOST_SIZE = 1.0, 50.0  # inches


def check_plot(path: str) -> None:
    """Raise before the work where the figure could not be made."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError("--plot", value=path, limit=f"must end in {', '.join(SUFFIXES)}")
    check_directory(path)
    check_matplotlib("--plot")


def check_matplotlib(what: str) -> None:
    """Raise where the extra is missing."""
    if find_spec("matplotlib") is None:
        raise RobodynError(what, limit="needs the extra `plot`: pip install 'robodyn[plot]'")


def picture_format(format: PictureFormat | None, out: str | None) -> PictureFormat:
    """The form that the options ask for: by --format, by the suffix, or text on a terminal.

    Raises before the work where it could not be made.
    """
    if format is None and out not in (None, "-"):
        suffix = Path(out or "").suffix.lower()
        if suffix not in (*SUFFIXES, ".txt"):
            limit = f"must end in {', '.join(SUFFIXES)} or .txt; or give --format"
            raise InputError("--out", value=out, limit=limit)
        of_suffix: dict[str, PictureFormat] = {f".{x}": x for x in get_args(PictureFormat)}
        format = of_suffix.get(suffix, "text")
    elif format is None:
        if not sys.stdout.isatty():
            limit = "give a file (.png, .svg, .pdf), or --format text for a picture of characters"
            raise InputError("--out", limit=limit)
        format = "text"
    if out not in (None, "-"):
        check_directory(out or "")
    elif format != "text" and on_terminal(out):
        raise InputError("--format", value=format, limit="is not for a terminal: give --out")
    if format != "text":
        check_matplotlib(f"a picture ({format})")
    return format


def parse_size(size: str | None) -> tuple[float, float] | None:
    """Width and height of `8x5`, inches."""
    if size is None:
        return None
    sides = [finite(side) or 0.0 for side in size.lower().split("x")]
    if len(sides) != 2 or not all(LEAST_SIZE <= side <= MOST_SIZE for side in sides):
        limit = f"must be two numbers from {LEAST_SIZE:g} to {MOST_SIZE:g}, inches, such as 8x5"
        raise InputError("--size", value=size, limit=limit)
    return sides[0], sides[1]


def check_directory(path: str) -> None:
    """Raise before the work where a file's directory does not exist."""
    if not Path(path).resolve().parent.is_dir():
        raise InputError("cannot be written", where=path, limit="no such directory")


def work_precision(result: Benchmark, title: str, path: str) -> None:
    """Milliseconds against error, log-log, each method's line labelled at its end."""
    import numpy as np

    figure = new_figure((8.0, 5.5), formulas=True, layout="constrained")
    axes = figure.add_subplot()
    labelled: list[tuple[float, float]] = []
    names = list(dict.fromkeys(x.method for x in result.measurements))
    for i, name in enumerate(names):
        runs = [x for x in result.measurements if x.method == name and np.isfinite(x.least)]
        if not runs:
            continue
        error = [x.error for x in runs]
        least = [1e3 * x.least for x in runs]
        shade = 0.0 if name.startswith("taylor") else 0.25 + 0.4 * i / len(names)
        width = 2.0 if name.startswith("taylor") else 1.2
        axes.plot(
            error, least, color=str(shade), lw=width, marker=MARKS[i % len(MARKS)], ms=5, label=name
        )
        best = int(np.argmin(error))
        place = float(np.log10(error[best])), float(np.log10(least[best]))
        close = any(abs(place[0] - x) < 2.0 and abs(place[1] - y) < 0.15 for x, y in labelled)
        labelled.append(place)
        axes.annotate(
            name,
            (error[best], least[best]),
            xytext=(-6, 14 if close else 3),
            textcoords="offset points",
            ha="right",
            color=str(shade),
        )
    axes.axvline(result.reference.uncertainty, color="0.8", lw=1.0, ls=":")
    axes.margins(y=0.1)
    if labelled:  # matplotlib has no logarithms of nothing
        axes.set_xscale("log")
        axes.set_yscale("log")
    axes.set_xlabel("largest error of q (rad) and qd (rad/s)")
    axes.set_ylabel("time of a run, ms")
    axes.set_title(shown(title), parse_math=False)
    axes.grid(True, which="major", color="0.9")
    low, high = axes.get_xlim()
    axes.set_xlim(low / 30.0, min(high, 10.0))
    save(figure, path, Path(path).suffix[1:].lower())


def chart_figure(content: Chart, size: tuple[float, float] | None) -> Any:
    """A chart's panels, stacked; each curve has its name at its end, or in a box if they are many.

    Columns have colours and files line styles; where there is one column files have both.
    """
    panels = content.panels
    height = 4.5 if len(panels) == 1 else 1.0 + 2.0 * len(panels)
    figure = new_figure(size or (8.0, height), layout="constrained")
    figure.get_layout_engine().set(h_pad=0.06, w_pad=0.06)
    stacked = figure.subplots(len(panels), sharex=True, squeeze=False)[:, 0]
    x_limits = limits([curve.x for curve in content.curves])
    for axes, panel in zip(stacked, panels, strict=True):
        columns = list(dict.fromkeys(curve.column for curve in panel.curves))
        for curve in panel.curves:
            shade = columns.index(curve.column) if len(columns) > 1 else curve.file
            colour = COLOURS[shade % len(COLOURS)]
            style = LINE_STYLES[curve.file % len(LINE_STYLES)]
            single = {"marker": "o", "ms": 4} if len(curve.x) == 1 else {}
            axes.plot(curve.x, curve.y, color=colour, ls=style, lw=1.4, label=curve.label, **single)
        if panel is panels[0] or not content.to_scale:
            axes.margins(x=0.0 if _rises(panel) else 0.04, y=0.06)
        axes.set_ylabel(panel.label)
        axes.grid(True, color="0.9", lw=0.7)
        axes.spines[["top", "right"]].set_visible(False)
        if content.to_scale:
            axes.set_aspect("equal", adjustable="datalim")
        elif _rises(panel):
            axes.set_xlim(*x_limits)
        y_limits = limits([curve.y for curve in panel.curves])
        margin = 0.06 * (y_limits[1] - y_limits[0])
        if not content.to_scale:
            axes.set_ylim(y_limits[0] - margin, y_limits[1] + margin)
    stacked[-1].set_xlabel(content.x_label)
    figure.align_ylabels(stacked)
    inches = figure.get_size_inches()[1] / len(panels) - 0.5
    for axes, panel in zip(stacked, panels, strict=True):
        _name_curves(axes, panel, inches)
    return figure


def _name_curves(axes: Any, panel: Panel, inches: float) -> None:
    """Names at the curves' ends, one below another where they would overlap."""
    lines = axes.get_lines()
    ends = [int(curve.x.argmax()) if _rises(panel) else -1 for curve in panel.curves]
    low, high = axes.get_ylim()
    gap = 0.17 / max(inches, 0.3) * (high - low)
    heights = [float(curve.y[end]) for curve, end in zip(panel.curves, ends, strict=True)]
    places = spread(heights, gap, low, high)
    if places is None:
        columns = 1 + len(lines) * gap // (high - low)
        axes.legend(
            *(lines, [curve.label for curve in panel.curves]),
            loc="center left",
            bbox_to_anchor=(1.0, 0.5),
            ncols=int(columns),
            frameon=False,
        )
        return
    for line, curve, end, place in zip(lines, panel.curves, ends, places, strict=True):
        if not _rises(panel):
            axes.plot(curve.x[-1], curve.y[-1], "o", ms=4, color=line.get_color())
        axes.annotate(
            *(curve.label, (curve.x[end], place)),
            xytext=(5, 0),
            textcoords="offset points",
            ha="left",
            va="center",
            color=line.get_color(),
            fontsize=9,
            annotation_clip=False,
        )


def _rises(panel: Panel) -> bool:
    """Whether all curves go to the right, as those against time do."""
    return all((curve.x[1:] >= curve.x[:-1]).all() for curve in panel.curves)


def new_figure(size: tuple[float, float], formulas: bool = False, **options: Any) -> Any:
    """A figure of this size, inches, that draws without a screen.

    Unless it has `formulas`, a dollar in a text stands for itself: names may hold any.
    """
    logging.getLogger("matplotlib").setLevel(logging.CRITICAL)  # where it may keep its files
    from matplotlib import rcParams
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rcParams["text.parse_math"] = formulas
    # a font without the letters of a name draws boxes
    warnings.filterwarnings("ignore", "Glyph", UserWarning)
    figure = Figure(figsize=size, **options)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Any, path: str | None, format: str, palette: Sequence[Rgb] = ()) -> None:
    """Write the figure, all or nothing; the same figure makes the same bytes.

    A .png, or an image inside of an .svg, has the colours of the `palette`, 256 at most; without
    one a .png has those that suit it best.
    """
    from io import BytesIO

    from matplotlib import rc_context

    from robodyn.cli.fewer_colours import in_palette, with_images_in_palette

    dates = {"png": "Software", "svg": "Date", "pdf": "CreationDate"}
    drawn = BytesIO()
    with rc_context({"svg.hashsalt": "robodyn"}), open_output(path) as stream:
        with warnings.catch_warnings():  # long names may leave little room
            warnings.simplefilter("ignore", UserWarning)
            figure.savefig(drawn, format=format, dpi=DOTS, metadata={dates[format]: None})
        if format == "png":
            stream.write(in_palette(drawn.getvalue(), palette))
        elif format == "svg" and palette:
            stream.write(with_images_in_palette(drawn.getvalue(), palette))
        else:
            stream.write(drawn.getvalue())
