"""`robodyn plot`: columns of CSV files as a chart."""

from __future__ import annotations

from typing import Annotated

from typer import Option

from robodyn.cli.figures import ChartOptions, write_characters
from robodyn.cli.files import load_scene, model_file, rows_argument
from robodyn.cli.options import Degrees, Text, option, switch
from robodyn.cli.output import note
from robodyn.cli.row_files import open_input
from robodyn.dynamics.columns import ANY_SCENE, scene_units
from robodyn.errors import InputError
from robodyn.pictures import chart_figure
from robodyn.pictures.chart import chart_lines, read_chart
from robodyn.pictures.value_map import read_map
from robodyn.tables.csv_fields import shown

_Y = "Separated by commas; q* is q1, q2, ... Default: q*,tau*, else all."
_MODEL = "Scene of the rows, which tells whether a joint turns or slides."
_COLOUR = "Draw a map: this column as colours over --x and --y."
Colour = Annotated[Text, Option("--colour", "--color", metavar="COLUMN", help=_COLOUR)]


def plot(
    files: Annotated[list[str], rows_argument("CSV...", "Files of rows; - is stdin.")],
    x: Text = option("Along x. Default: t, else the row.", "COLUMN"),
    y: Text = option(_Y, "COLUMNS"),
    colour: Colour = None,
    model: Annotated[Text, model_file("--model", _MODEL)] = None,
    log: bool = switch("Logarithmic --colour."),
    points: bool = switch("Points in place of lines."),
    degrees: Degrees = False,
    title: Text = option("Above it.", "TEXT"),
    picture: ChartOptions = ChartOptions(),
) -> None:
    """Columns of CSV files against time, or against each other; a map of one over two others.

    Columns of one unit share a panel, panels are stacked over one x, and each curve has its name at
    its end.  Several files are overlaid: a colour for each column, a line style for each file.
    Rows of a sweep in no order of x, as those of a random sample, are points, as all are with
    --points.  Where a row has no value a curve has a gap.

    With --colour points over --x and --y have the colour of that column: cells where they fill a
    grid, as rows of a sweep do.  It may hold numbers or words; where it is empty they are grey.

    --model tells which joints slide, whose columns have m and N in place of rad and N m; without
    it they are labelled `rad or m`.  --degrees draws angles, their rates and accelerations in
    degrees; those of joints need --model.

    Without --out a terminal gets a chart of characters, as wide as it is; in a pipe it takes
    --format text.  A map needs --out.

    \b
    Examples:
      robodyn plot motion.csv --y "q*,energy"
      robodyn simulate 2r --q 0,0 | robodyn plot - --model 2r -o motion.svg
      robodyn plot one.csv two.csv --model 2r --x q1 --y qd1 -o phase.png
      robodyn simulate rp-arm --q 0,0.2 --time 1 | \\
        robodyn plot - --model rp-arm -o motion.svg
      robodyn plot sweep.csv --model 2r --x q1 --y q2 --colour flip -o x.png
    """
    in_characters = colour is None and picture.text
    picture.check() if in_characters else picture.checked()
    if files.count("-") > 1:
        raise InputError("CSV", value="-", limit="is given twice: stdin can be read once")
    patterns = None if y is None else [word for word in map(str.strip, y.split(",")) if word]
    if patterns == []:
        raise InputError("--y", value=repr(y), limit="names no column")
    if colour is not None and (x is None or patterns is None):
        raise InputError("--colour", value=shown(colour), limit="needs --x and --y")
    if log and colour is None:
        raise InputError("--log", limit="is a scale of colours: give --colour")
    if points and colour is not None:
        raise InputError("--points", limit="is for charts: leave it out with --colour")
    units = ANY_SCENE if model is None else scene_units(load_scene(model))
    opened = map(open_input, files)
    if colour is not None:
        mapped = read_map(opened, x or "", patterns or [], colour, log, units, degrees, note)
        picture.save(chart_figure.map_figure(mapped, picture.extent, shown(title or "")))
        return
    content = read_chart(opened, x, patterns, units, degrees, note, points)
    if not in_characters:
        picture.save(chart_figure.chart_figure(content, picture.extent, shown(title or "")))
        return

    def lines(width: int, height: int, plain: bool, coloured: bool) -> list[str]:
        panels = len(content.panels)
        rows = max(5, min(12 + 6 // panels, (height - 4) // panels - 1))
        above = [f"  {shown(title)}"] if title else []
        return above + chart_lines(content, width, rows, plain, coloured)

    write_characters(lines, picture.out)
