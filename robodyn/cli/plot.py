"""`robodyn plot`: columns of CSV files as a chart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from typer import Option

from robodyn.cli import figures
from robodyn.cli.figures import (
    DOTS,
    check_dpi,
    parse_size,
    picture_format,
    save,
    write_characters,
)
from robodyn.cli.files import model_file, rows_argument
from robodyn.cli.options import Ascii, Degrees, Dpi, OutputPicture, PictureOut, Size
from robodyn.cli.output import note
from robodyn.cli.row_files import open_input
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import load
from robodyn.pictures.chart import Chart, chart, choose_columns, choose_x, place_of
from robodyn.pictures.column_units import TURNING, in_degrees, scene_units
from robodyn.pictures.value_map import ColourColumn, ValueMap, value_map
from robodyn.tables.csv_fields import shown
from robodyn.tables.table import Reader

Array = NDArray[np.float64]
ONE_Y = "a map has one column along y"
_X = "Along x. Default: t, else the row."
_Y = "Separated by commas; q* is q1, q2, ... Default: q*,tau*, else all."
_MODEL = "Scene of the rows: units of joints that slide."
_COLOUR = "Draw a map: this column as colours over --x and --y."
X = Annotated[str | None, Option("--x", metavar="COLUMN", help=_X)]
Y = Annotated[str | None, Option("--y", metavar="COLUMNS", help=_Y)]
Colour = Annotated[str | None, Option("--colour", "--color", metavar="COLUMN", help=_COLOUR)]


def plot(
    files: Annotated[list[str], rows_argument("CSV...", "Files of rows; - is stdin.")],
    x: X = None,
    y: Y = None,
    colour: Colour = None,
    model: Annotated[str | None, model_file("--model", _MODEL)] = None,
    log: Annotated[bool, Option("--log", help="Logarithmic --colour.")] = False,
    degrees: Degrees = False,
    title: Annotated[str | None, Option("--title", metavar="TEXT", help="Above it.")] = None,
    size: Size = None,
    dpi: Dpi = DOTS,
    format: OutputPicture = None,
    ascii: Ascii = False,
    out: PictureOut = None,
) -> None:
    """Columns of CSV files against time, or against each other; a map of one over two others.

    Columns of one unit share a panel, panels are stacked over one x, and each curve has its name at
    its end.  Several files are overlaid: a colour for each column, a line style for each file.

    With --colour points over --x and --y have the colour of that column: cells where they fill a
    grid, as rows of a sweep do.  It may hold numbers or words; where it is empty they are grey.

    --model tells which joints slide, whose columns have m and N in place of rad and N m.
    --degrees draws angles, their rates and accelerations in degrees.

    Without --out a terminal gets a chart of characters, as wide as it is; in a pipe it takes
    --format text.

    \b
    Examples:
      robodyn plot motion.csv --y "q*,energy"
      robodyn simulate 2r --q 0,0 --time 3 | robodyn plot - -o motion.svg
      robodyn plot one.csv two.csv --x q1 --y qd1 -o phase.png
      robodyn simulate rp-arm --q 0,0.2 --time 1 | \\
        robodyn plot - --model rp-arm -o motion.svg
      robodyn plot sweep.csv --x q1 --y q2 --colour flip --log -o flips.png
    """
    extent, dpi = parse_size(size), check_dpi(dpi)
    if files.count("-") > 1:
        raise InputError("CSV", value="-", limit="is given twice: stdin can be read once")
    patterns = None if y is None else [word for word in map(str.strip, y.split(",")) if word]
    if patterns == []:
        raise InputError("--y", value=repr(y), limit="names no column")
    if colour is not None and (x is None or patterns is None):
        raise InputError("--colour", value=shown(colour), limit="needs --x and --y")
    if log and colour is None:
        raise InputError("--log", limit="is a scale of colours: give --colour")
    chosen = picture_format(format, out)
    units = TURNING if model is None else scene_units(load(model))
    if colour is not None:
        read = _read_map(files, x or "", patterns or [], colour, log)
        mapped = _map_in_degrees(read, units) if degrees else read._replace(units=units)
        if chosen == "text":
            from robodyn.pictures.characters import map_lines

            above = _above(title)

            def drawn(width: int, height: int, plain: bool, colours: str) -> list[str]:
                return above + map_lines(mapped, width, height - 1 - len(above), plain, colours)

            write_characters(drawn, ascii, out)
            return
        from robodyn.cli.map_figure import map_figure

        save(map_figure(mapped, extent, shown(title or "")), out, chosen, dpi)
        return
    content = _read(files, x, patterns, units, degrees)
    if chosen == "text":
        from robodyn.pictures.characters import chart_lines

        def lines(width: int, height: int, plain: bool, colours: str) -> list[str]:
            panels = len(content.panels)
            rows = max(5, min(12 + 6 // panels, (height - 4) // panels - 1))
            return _above(title) + chart_lines(content, width, rows, plain, bool(colours))

        write_characters(lines, ascii, out)
        return
    save(figures.chart_figure(content, extent, shown(title or "")), out, chosen, dpi)


def _read(
    files: list[str],
    x: str | None,
    patterns: list[str] | None,
    units: Mapping[str, str],
    degrees: bool,
) -> Chart:
    names: list[str] = []
    along: list[str | None] = []
    tables: list[dict[str, Array]] = []
    for file in files:
        with open_input(file) as (stream, name):
            reader = Reader(stream, name)
            own = choose_x(reader.header, x, name)
            columns = choose_columns(reader.header, patterns, own, name)
            columns = list(dict.fromkeys([*columns, *([own] if own else [])]))
            blocks = [chunk.values for chunk in reader.chunks(columns)]
        names.append(name)
        along.append(own)
        values = np.concatenate([np.zeros((0, len(columns))), *blocks])
        tables.append(dict(zip(columns, values.T, strict=True)))
    if degrees:
        along = [name and in_degrees(name, units)[0] for name in along]
        for k, table in enumerate(tables):
            told = {name: in_degrees(name, units) for name in table}
            tables[k] = {told[name][0]: told[name][1] * values for name, values in table.items()}
    return chart(names, along, tables, units)


def _map_in_degrees(mapped: ValueMap, units: Mapping[str, str]) -> ValueMap:
    """The map with its angles in degrees."""
    names = mapped.x_name, mapped.y_name, mapped.name
    told = [in_degrees(name, units) for name in names]
    values = told[2][1] * mapped.values if mapped.scale else mapped.values
    log = mapped.scale is not None and mapped.scale.log
    x, y = told[0][1] * mapped.x, told[1][1] * mapped.y
    new = value_map((told[0][0], told[1][0], told[2][0]), x, y, values, mapped.words, log)
    return new._replace(units=units)


def _above(title: str | None) -> list[str]:
    """The title as a line of characters."""
    return [f"  {shown(title)}"] if title else []


def _read_map(files: list[str], x: str, patterns: list[str], colour: str, log: bool) -> ValueMap:
    column = ColourColumn(colour, positive=log)
    blocks, ys = [np.zeros((0, 2))], []
    for file in files:
        with open_input(file) as (stream, source):
            reader = Reader(stream, source)
            choose_x(reader.header, x, source)
            ys += choose_columns(reader.header, patterns, x, source)
            if len(set(ys)) > 1:
                raise InputError("--y", value=", ".join(dict.fromkeys(ys)), limit=ONE_Y)
            place = place_of(colour, "--colour", reader.header, source)
            for chunk in reader.chunks([x, ys[0]]):
                column.add(chunk, place, source)
                blocks.append(chunk.values)
    if log and column.words:
        limit = "needs a column of numbers; this one holds words"
        raise InputError("--log", value=shown(colour), limit=limit)
    along, up = np.concatenate(blocks).T
    mapped = value_map((x, ys[0], colour), along, up, column.values, column.words, log)
    if mapped.grid is not None and mapped.grid.hidden:
        note(f"Note: {mapped.grid.hidden} rows are hidden by later ones with the same {x}, {ys[0]}")
    return mapped
