"""Figures of the command line, by matplotlib (the extra `plot`)."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from robodyn.benchmark import Benchmark
from robodyn.errors import InputError, RobodynError
from robodyn.output_file import open_output

SUFFIXES = (".png", ".svg", ".pdf")
MARKS = "osD^vP*X"


def check_plot(path: str) -> None:
    """Raise before the work where the figure could not be made."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError("--plot", value=path, limit=f"must end in {', '.join(SUFFIXES)}")
    check_directory(path)
    if find_spec("matplotlib") is None:
        raise RobodynError("--plot", limit="needs the extra `plot`: pip install 'robodyn[plot]'")


def check_directory(path: str) -> None:
    """Raise before the work where a file's directory does not exist."""
    if not Path(path).resolve().parent.is_dir():
        raise InputError("cannot be written", where=path, limit="no such directory")


def work_precision(result: Benchmark, title: str, path: str) -> None:
    """Milliseconds against error, log-log, each method's line labelled at its end."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
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
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("largest error of q (rad) and qd (rad/s)")
    axes.set_ylabel("time of a run, ms")
    axes.set_title(title)
    axes.grid(True, which="major", color="0.9")
    low, high = axes.get_xlim()
    axes.set_xlim(low / 30.0, min(high, 10.0))
    _save(figure, path)


def _save(figure: Any, path: str) -> None:
    with open_output(path) as stream:
        figure.savefig(stream, format=Path(path).suffix[1:].lower(), dpi=150)
