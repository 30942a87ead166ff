"""Pictures of characters to a terminal, a pipe or a file."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable

from robodyn.tables.output_file import on_terminal, open_output

WIDTH, HEIGHT = 80, 24  # where there is no terminal
WIDEST, HIGHEST = 2_000, 1_000  # whatever a terminal, or the environment, tells


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
