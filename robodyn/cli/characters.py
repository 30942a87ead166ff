"""Pictures of characters to a terminal, a pipe or a file."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Sequence

from robodyn.pictures.character_drawing import drawing_lines
from robodyn.pictures.character_map import DEEP, PALETTE, map_lines
from robodyn.pictures.character_plot import chart_lines
from robodyn.pictures.chart import Chart
from robodyn.pictures.drawing import Drawing
from robodyn.pictures.value_map import ValueMap
from robodyn.tables.output_file import on_terminal, open_output

WIDTH, HEIGHT = 80, 24  # where there is no terminal
WIDEST, HIGHEST = 2_000, 1_000  # whatever a terminal, or the environment, tells
ROWS = 12  # of a panel


def write_chart(chart: Chart, ascii: bool, out: str | None) -> None:
    """The chart, as wide as the terminal."""
    width, height = _size()
    panels = len(chart.panels)
    rows = max(5, min(ROWS + 6 // panels, (height - 4) // panels - 1))
    ascii = ascii or not _has_dots(out)
    _write(chart_lines(chart, width - 1, rows, ascii, _colour(out)), out)


def write_map(content: ValueMap, ascii: bool, out: str | None) -> None:
    """The map as large as the terminal allows."""
    width, height = _size()
    deep = os.environ.get("COLORTERM") in ("truecolor", "24bit")
    colours = (DEEP if deep else PALETTE) if _colour(out) else ""
    ascii = ascii or not _has_dots(out)
    _write(map_lines(content, width - 1, height - 1, ascii, colours), out)


def write_drawing(drawn: Drawing, names: Sequence[str], ascii: bool, out: str | None) -> None:
    """The mechanism to scale, as large as the terminal allows."""
    width, height = _size()
    ascii = ascii or not _has_dots(out)
    _write(drawing_lines(drawn, names, width - 1, height - 2, ascii, _colour(out)), out)


def _size() -> tuple[int, int]:
    size = shutil.get_terminal_size((WIDTH, HEIGHT))
    return max(30, min(size.columns, WIDEST)), max(10, min(size.lines, HIGHEST))


def _has_dots(out: str | None) -> bool:
    """Whether the output can hold braille; files are UTF-8."""
    if out not in (None, "-"):
        return True
    try:
        "\u2801┤".encode(sys.stdout.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _colour(out: str | None) -> bool:
    return on_terminal(out) and not os.environ.get("NO_COLOR")


def _write(lines: Sequence[str], out: str | None) -> None:
    encoding = "utf-8" if out not in (None, "-") else sys.stdout.encoding or "utf-8"
    with open_output(out, styled=True) as stream:
        stream.write(("\n".join(lines) + "\n").encode(encoding, "replace"))
