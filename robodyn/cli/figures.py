"""How pictures are asked for and written: as characters, or by matplotlib (the extra `plot`)."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from robodyn.cli.options import PictureFormat
from robodyn.errors import InputError
from robodyn.pictures.chart_figure import check_matplotlib
from robodyn.tables.csv_fields import finite
from robodyn.tables.output_file import on_terminal, open_output

KINDS: dict[str, PictureFormat] = {".png": "png", ".svg": "svg", ".pdf": "pdf"}
MOST_DOTS = 1200
LEAST_SIZE, MOST_SIZE = 1.0, 50.0  # inches
WIDTH, HEIGHT = 80, 24  # characters, where there is no terminal
WIDEST, HIGHEST = 2_000, 1_000  # whatever a terminal, or the environment, tells


def check_plot(path: str) -> None:
    """Raise before the work where the figure could not be made."""
    if Path(path).suffix.lower() not in KINDS:
        raise InputError("--plot", value=path, limit=f"must end in {', '.join(KINDS)}")
    check_directory(path)
    check_matplotlib("--plot")


def check_directory(path: str) -> None:
    if not Path(path).resolve().parent.is_dir():
        raise InputError("cannot be written", where=path, limit="no such directory")


def picture_format(format: PictureFormat | None, out: str | None) -> PictureFormat:
    """The form that the options ask for: by --format, by the suffix, or text on a terminal.

    Raises before the work where it could not be made.
    """
    file = "" if out in (None, "-") else str(out)
    if format is None:
        suffix = Path(file).suffix.lower()
        if file and suffix not in (*KINDS, ".txt"):
            limit = f"must end in {', '.join(KINDS)} or .txt; or give --format"
            raise InputError("--out", value=out, limit=limit)
        if not file and not sys.stdout.isatty():
            limit = "give a file (.png, .svg, .pdf), or --format text for a picture of characters"
            raise InputError("--out", limit=limit)
        format = KINDS.get(suffix, "text")
    if file:
        check_directory(file)
    elif format != "text" and on_terminal(out):
        raise InputError("--format", value=format, limit="is not for a terminal: give --out")
    if format != "text":
        check_matplotlib(f"a picture ({format})")
    return format


def check_dpi(dpi: int) -> int:
    """Dots an inch; InputError where they are too few or too many."""
    if not 10 <= dpi <= MOST_DOTS:
        raise InputError("--dpi", value=dpi, limit=f"must be from 10 to {MOST_DOTS}")
    return dpi


def parse_size(size: str | None) -> tuple[float, float] | None:
    """Width and height of `8x5`, inches."""
    if size is None:
        return None
    sides = [finite(side) or 0.0 for side in size.lower().split("x")]
    if len(sides) != 2 or not all(LEAST_SIZE <= side <= MOST_SIZE for side in sides):
        limit = f"must be two numbers from {LEAST_SIZE:g} to {MOST_SIZE:g}, inches, such as 8x5"
        raise InputError("--size", value=size, limit=limit)
    return sides[0], sides[1]


def write_characters(
    lines: Callable[[int, int, bool, str], list[str]], ascii: bool, out: str | None
) -> None:
    """The `lines` of a width and height, plain or not, and in colours: "", "palette" or "deep".

    As wide as the terminal.  Files are UTF-8; plain is also what a terminal without braille gets.
    """
    size = shutil.get_terminal_size((WIDTH, HEIGHT))
    width, height = max(30, min(size.columns, WIDEST)), max(10, min(size.lines, HIGHEST))
    encoding = "utf-8" if out not in (None, "-") else sys.stdout.encoding or "ascii"
    deep = os.environ.get("COLORTERM") in ("truecolor", "24bit")
    colours = ("deep" if deep else "palette") if _colour(out) else ""
    drawn = lines(width - 1, height, ascii or not _has_dots(encoding), colours)
    with open_output(out, styled=True) as stream:
        stream.write(("\n".join(drawn) + "\n").encode(encoding, "replace"))


def _has_dots(encoding: str) -> bool:
    try:
        return bool("\u2801┤".encode(encoding))
    except UnicodeEncodeError:
        return False


def _colour(out: str | None) -> bool:
    return on_terminal(out) and not os.environ.get("NO_COLOR")
