"""How a notebook shows a mechanism and a motion: html with a drawing, or with a small chart."""

from __future__ import annotations

from contextlib import nullcontext
from html import escape
from importlib.util import find_spec
from io import BytesIO
from typing import TYPE_CHECKING, Any

from robodyn.errors import RobodynError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.notebook.own_settings import own_settings
from robodyn.pictures.chart import read_chart
from robodyn.pictures.column_units import scene_units
from robodyn.tables.columns import Columns

if TYPE_CHECKING:
    from robodyn.simulation.simulation import Motion

WIDTH = 420  # pixels
SIZE = 6.0, 3.2  # inches
LINES = 70, 12  # characters and rows of a chart where there is no matplotlib


def mechanism_html(mechanism: Mechanism) -> str:
    """Its one line, and below it a drawing to scale in the pose that `draw` begins with."""
    from robodyn.pictures.animation_files import svg
    from robodyn.pictures.drawing import drawing, first_pose

    try:
        picture = svg(drawing(mechanism, first_pose(mechanism)), WIDTH)
    except RobodynError as error:
        picture = f"<pre>{escape(str(error))}</pre>"
    return f"<div>{escape(repr(mechanism))}</div>{picture}"


def motion_html(motion: Motion) -> str:
    """Its one line, and below it q and tau over time; of characters without matplotlib."""
    from robodyn.pictures.characters import chart_lines

    states = {"t": motion.t, **{f"q{k + 1}": q for k, q in enumerate(motion.q.T)}}
    driven = {f"tau{k + 1}": motion.tau[:, k] for k in motion.mechanism.actuated}
    told = f"<div>{escape(repr(motion))}</div>"
    columns = Columns(states | {name: x for name, x in driven.items() if x.any()})
    try:
        units = scene_units(motion.mechanism)
        content = read_chart([opened(columns, "motion")], None, None, units, False)
    except RobodynError as error:  # no row, or a number beyond all drawing
        return f"{told}<pre>{escape(str(error))}</pre>"
    if find_spec("matplotlib") is None:
        lines = chart_lines(content, *LINES, False, False)
        return f"{told}<pre>{escape(chr(10).join(lines))}</pre>"
    from robodyn.pictures.chart_figure import chart_figure

    with own_settings():
        from matplotlib import rc_context

        figure, drawn = chart_figure(content, SIZE), BytesIO()
        with rc_context({"svg.hashsalt": "robodyn"}):  # the same motion has the same bytes
            figure.savefig(drawn, format="svg", metadata={"Date": None})
    text = drawn.getvalue().decode()
    return told + text[text.index("<svg") :]


def opened(columns: Columns, name: str) -> Any:
    """The table as a file of CSV would be opened."""
    from robodyn.tables.csv_fields import quoted
    from robodyn.tables.table_writer import Writer

    stream = BytesIO()
    writer = Writer(stream, list(map(quoted, columns)))
    for row in zip(*columns.values(), strict=True):
        fields = [x if isinstance(x, str) else float(x) for x in row]
        writer.write_row([None if x != x else x for x in fields])  # nan is an empty field
    writer.close()
    stream.seek(0)
    return nullcontext((stream, name))
