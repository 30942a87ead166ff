"""How pictures are asked for and written: as characters, or by matplotlib (the extra `plot`)."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from robodyn.cli.files import output_file
from robodyn.cli.options import Size, Text, option, switch
from robodyn.errors import InputError
from robodyn.pictures.chart_figure import DOTS, check_matplotlib, save
from robodyn.tables.csv_fields import finite
from robodyn.tables.output_file import on_terminal, open_output

PictureFormat = Literal["text", "png", "svg", "pdf"]  # how a picture is written
Lines = Callable[[int, int, bool, str], list[str]]  # of a width and height, plain, in colours
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


_OUT = "Write here, all or nothing: .png, .svg, .pdf, or .txt."
_SUFFIX = "Default: by the suffix of --out; on a terminal text, made of characters."


@dataclass(frozen=True)
class PictureOptions:
    """What a picture is like, and where it goes."""

    size: Size = None
    dpi: int = option("Dots an inch of a .png: 300 is twice as sharp.", "N", default=DOTS)
    format: PictureFormat | None = option(_SUFFIX)
    ascii: bool = switch("Text of plain characters, not of braille dots.")
    out: Annotated[Text, output_file("--out", "-o", help=_OUT)] = None

    @property
    def extent(self) -> tuple[float, float] | None:
        """Width and height, inches; InputError naming the option."""
        return parse_size(self.size)

    def checked(self) -> PictureFormat:
        """The form, by --format, by the suffix, or text on a terminal.

        Raises before the work where it could not be made.
        """
        parse_size(self.size)
        if not 10 <= self.dpi <= MOST_DOTS:
            raise InputError("--dpi", value=self.dpi, limit=f"must be from 10 to {MOST_DOTS}")
        format, file = self.format, "" if self.out in (None, "-") else str(self.out)
        if format is None:
            suffix = Path(file).suffix.lower()
            if file and suffix not in (*KINDS, ".txt"):
                limit = f"must end in {', '.join(KINDS)} or .txt; or give --format"
                raise InputError("--out", value=self.out, limit=limit)
            if not file and not sys.stdout.isatty():
                limit = "give a file (.png, .svg, .pdf), or --format text for characters"
                raise InputError("--out", limit=limit)
            format = KINDS.get(suffix, "text")
        if file:
            check_directory(file)
        elif format != "text" and on_terminal(self.out):
            raise InputError("--format", value=format, limit="is not for a terminal: give --out")
        if format != "text":
            check_matplotlib(f"a picture ({format})")
        return format

    def show(self, lines: Lines, figure: Callable[[], Any]) -> None:
        """Write the picture, of characters or by matplotlib."""
        if (format := self.checked()) == "text":
            write_characters(lines, self.ascii, self.out)
        else:
            save(figure(), self.out, format, self.dpi)


def parse_size(size: str | None) -> tuple[float, float] | None:
    """Width and height of `8x5`, inches."""
    if size is None:
        return None
    sides = [finite(side) or 0.0 for side in size.lower().split("x")]
    if len(sides) != 2 or not all(LEAST_SIZE <= side <= MOST_SIZE for side in sides):
        limit = f"must be two numbers from {LEAST_SIZE:g} to {MOST_SIZE:g}, inches, such as 8x5"
        raise InputError("--size", value=size, limit=limit)
    return sides[0], sides[1]


def write_characters(lines: Lines, ascii: bool, out: str | None) -> None:
    """The `lines` of a width and height, plain or not, and in colours: "", "palette" or "deep".

    As wide as the terminal.  Files are UTF-8; plain is also what a terminal without braille gets.
    """
    size = shutil.get_terminal_size((WIDTH, HEIGHT))
    width, height = max(30, min(size.columns, WIDEST)), max(10, min(size.lines, HIGHEST))
    encoding = "utf-8" if out not in (None, "-") else sys.stdout.encoding or "ascii"
    deep = os.environ.get("COLORTERM") in ("truecolor", "24bit")
    coloured = on_terminal(out) and not os.environ.get("NO_COLOR")
    colours = ("deep" if deep else "palette") if coloured else ""
    drawn = lines(width - 1, height, ascii or not _has_dots(encoding), colours)
    with open_output(out, styled=True) as stream:
        stream.write(("\n".join(drawn) + "\n").encode(encoding, "replace"))


def _has_dots(encoding: str) -> bool:
    try:
        return bool("\u2801┤".encode(encoding))
    except UnicodeEncodeError:
        return False
