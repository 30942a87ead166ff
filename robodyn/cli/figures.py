"""Options and output of pictures: as characters, or by matplotlib (the extra `plot`)."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from robodyn.cli.files import output_file
from robodyn.cli.options import Size, Text, option
from robodyn.errors import InputError
from robodyn.pictures.chart_figure import DOTS, check_matplotlib, save
from robodyn.tables.csv_fields import finite
from robodyn.tables.output_file import on_terminal, open_output

FigureFormat = Literal["png", "svg", "pdf"]
ChartFormat = Literal["text", "png", "svg", "pdf"]
Lines = Callable[[int, int, bool, bool], list[str]]  # of a width and height, plain, in colours
KINDS: dict[str, FigureFormat] = {".png": "png", ".svg": "svg", ".pdf": "pdf"}
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


_OUT = "Write here, all or nothing: .png, .svg or .pdf."
_SUFFIX = "Default: by the suffix of --out."
_CHART_OUT = "Write here, all or nothing: .png, .svg, .pdf, or .txt."
_CHART_SUFFIX = "Default: by the suffix of --out; on a terminal text, made of characters."


@dataclass(frozen=True)
class PictureOptions:
    """Options for the look of a picture, and its output file."""

    size: Size = None
    dpi: int = option("Dots an inch of a .png: 300 is twice as sharp.", "N", default=DOTS)
    format: FigureFormat | None = option(_SUFFIX)
    out: Annotated[Text, output_file("--out", "-o", help=_OUT)] = None

    @property
    def extent(self) -> tuple[float, float] | None:
        """Width and height, inches; InputError naming the option."""
        return parse_size(self.size)

    @property
    def file(self) -> str:
        """The file of --out, "" if it is stdout."""
        return "" if self.out in (None, "-") else str(self.out)

    def check(self) -> None:
        """Raise InputError for a number that no picture has, or a file in no directory."""
        parse_size(self.size)
        if not 10 <= self.dpi <= MOST_DOTS:
            raise InputError("--dpi", value=self.dpi, limit=f"must be from 10 to {MOST_DOTS}")
        if self.file:
            check_directory(self.file)

    def checked(self) -> FigureFormat:
        """The form of the figure, by --format or the suffix.

        Raises before the work if it could not be made.
        """
        self.check()
        form: Any = self.format or KINDS.get(Path(self.file).suffix.lower())
        if form == "text":
            limit = "is for charts alone: give a file, as -o x.svg"
            raise InputError("--format", value=form, limit=limit)
        if form is None and not self.file:
            raise InputError("--out", limit="missing: give a file (.png, .svg, .pdf), as -o x.svg")
        if form is None:
            limit = f"must end in {', '.join(KINDS)}; or give --format"
            raise InputError("--out", value=self.out, limit=limit)
        if not self.file and on_terminal(self.out):
            raise InputError("--format", value=form, limit="is not for a terminal: give --out")
        check_matplotlib(f"a picture ({form})")
        return form  # type: ignore[no-any-return]

    def save(self, figure: Any) -> None:
        """Write the figure."""
        save(figure, self.out, self.checked(), self.dpi)


@dataclass(frozen=True)
class ChartOptions(PictureOptions):
    """Options of a chart, which may be drawn in characters."""

    format: ChartFormat | None = option(_CHART_SUFFIX)  # type: ignore[assignment]
    out: Annotated[Text, output_file("--out", "-o", help=_CHART_OUT)] = None

    @property
    def text(self) -> bool:
        """Whether the chart is made of characters."""
        if self.format is None:
            return self.file.lower().endswith(".txt") if self.file else sys.stdout.isatty()
        return self.format == "text"


def parse_size(size: str | None) -> tuple[float, float] | None:
    """Width and height of `8x5`, inches."""
    if size is None:
        return None
    sides = [finite(side) or 0.0 for side in size.lower().split("x")]
    if len(sides) != 2 or not all(LEAST_SIZE <= side <= MOST_SIZE for side in sides):
        limit = f"must be two numbers from {LEAST_SIZE:g} to {MOST_SIZE:g}, inches, such as 8x5"
        raise InputError("--size", value=size, limit=limit)
    return sides[0], sides[1]


def write_characters(lines: Lines, out: str | None) -> None:
    """Write the `lines` of a width and height, plain or not, and in colours or not.

    As wide as the terminal.  Files are UTF-8; an output without braille gets plain characters.
    """
    size = shutil.get_terminal_size((WIDTH, HEIGHT))
    width, height = max(30, min(size.columns, WIDEST)), max(10, min(size.lines, HIGHEST))
    encoding = "utf-8" if out not in (None, "-") else sys.stdout.encoding or "ascii"
    coloured = on_terminal(out) and not os.environ.get("NO_COLOR")
    drawn = lines(width - 1, height, not _has_dots(encoding), coloured)
    with open_output(out, styled=True) as stream:
        stream.write(("\n".join(drawn) + "\n").encode(encoding, "replace"))


def _has_dots(encoding: str) -> bool:
    try:
        return bool("\u2801┤".encode(encoding))
    except UnicodeEncodeError:
        return False
