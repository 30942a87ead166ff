"""`robodyn plot`: columns of CSV files as a chart."""

from __future__ import annotations

from typing import Annotated, Optional

import numpy as np
import typer

from robodyn.chart import Array, Chart, chart, choose_columns, choose_x
from robodyn.cli.figures import parse_size, picture_format
from robodyn.cli.options import Ascii, OutputPicture, PictureFormat, PictureOut, Size
from robodyn.cli.states import open_input
from robodyn.errors import InputError
from robodyn.table import Reader


def plot(
    files: Annotated[
        list[str],
        typer.Argument(metavar="CSV...", help="Files of rows; - is stdin.", show_default=False),
    ],
    x: Annotated[
        Optional[str],  # noqa: UP045 (typer reads the annotation at run time)
        typer.Option(
            "--x", metavar="COLUMN", help="Along x. Default: t, else the row.", show_default=False
        ),
    ] = None,
    y: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--y",
            metavar="COLUMNS",
            help="Separated by commas; q* is q1, q2, ... Default: q*,tau*, else all.",
            show_default=False,
        ),
    ] = None,
    size: Size = None,
    format: OutputPicture = None,
    ascii: Ascii = False,
    out: PictureOut = None,
) -> None:
    """Columns of CSV files against time, or against each other.

    Columns of one unit share a panel, panels are stacked over one x, and each curve has its name at
    its end.  Several files are overlaid: a colour for each column, a line style for each file.

    Without --out a terminal gets a chart of characters, as wide as it is; in a pipe it takes
    --format text.

    \b
    Examples:
      robodyn plot motion.csv --y "q*,energy"
      robodyn simulate robots/2r.yaml --q 0,0 --time 3 | robodyn plot - -o motion.svg
      robodyn plot one.csv two.csv --x q1 --y qd1 -o phase.png
    """
    extent = parse_size(size)
    if "" in files:
        raise InputError("CSV", value="''", limit="is empty: name a file")
    if files.count("-") > 1:
        raise InputError("CSV", value="-", limit="is given twice: stdin can be read once")
    patterns = None if y is None else [word for word in map(str.strip, y.split(",")) if word]
    if patterns == []:
        raise InputError("--y", value=repr(y), limit="names no column")
    chosen = picture_format(format, out)
    content = _read(files, x, patterns)
    if chosen is PictureFormat.text:
        from robodyn.cli.characters import write_chart

        write_chart(content, ascii, out)
        return
    from robodyn.cli.figures import chart_figure, save

    save(chart_figure(content, extent), out, chosen.value)


def _read(files: list[str], x: str | None, patterns: list[str] | None) -> Chart:
    names, along, tables = [], [], []
    for file in files:
        with open_input(file) as (stream, name):
            reader = Reader(stream, name)
            own = choose_x(reader.header, x, name)
            columns = choose_columns(reader.header, patterns, own, name)
            columns = list(dict.fromkeys([*columns, *([own] if own else [])]))
            blocks = [chunk.values for chunk in reader.chunks(columns)]
        values = np.concatenate(blocks) if blocks else np.zeros((0, len(columns)))
        table: dict[str, Array] = dict(zip(columns, values.T, strict=True))
        names.append(name)
        along.append(own)
        tables.append(table)
    return chart(names, along, tables)
