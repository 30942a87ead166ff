"""How a notebook shows a mechanism and a motion: html with a drawing, or with a small chart.

Figures leave a notebook's own settings as they are, and errors name arguments.
"""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from html import escape
from importlib.util import find_spec
from io import BytesIO
from typing import TYPE_CHECKING, Any

from robodyn.dynamics.columns import scene_units
from robodyn.errors import RobodynError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.chart import read_chart
from robodyn.tables.named_columns import Columns

if TYPE_CHECKING:
    from robodyn.runs.simulation import Motion

WIDTH = 420  # pixels
SIZE = 6.0, 3.2  # inches
LINES = 70, 12  # characters and rows of a chart where there is no matplotlib


def mechanism_html(mechanism: Mechanism) -> str:
    """Return a mechanism's summary line, and a drawing in the pose with which `draw` begins."""
    from robodyn.loops.assembly import first_pose
    from robodyn.pictures.animation_files import svg
    from robodyn.pictures.drawing import drawing

    try:
        picture = svg(drawing(mechanism, first_pose(mechanism, t=0.0)), WIDTH)
    except RobodynError as error:
        picture = f"<pre>{escape(str(error))}</pre>"
    return f"<div>{escape(repr(mechanism))}</div>{picture}"


def motion_html(motion: Motion) -> str:
    """Return a motion's summary line, and a chart of q and tau, plain without matplotlib."""
    from robodyn.pictures.chart import chart_lines

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


@contextmanager
def own_settings() -> Iterator[None]:
    """Within it figures have robodyn's settings, after it all are what they were.

    Raises RobodynError where matplotlib (the extra `plot`) is not there.
    """
    from robodyn.pictures.chart_figure import check_matplotlib

    check_matplotlib("a figure")
    from matplotlib import rc_context

    logger, backend = logging.getLogger("matplotlib"), os.environ.get("MPLBACKEND")
    level = logger.level
    with rc_context(), warnings.catch_warnings():
        try:
            yield
        finally:
            logger.setLevel(level)
            if backend is None:
                os.environ.pop("MPLBACKEND", None)
            else:
                os.environ["MPLBACKEND"] = backend


@contextmanager
def named_as_arguments() -> Iterator[None]:
    """`--max-steps` is max_steps where a function is called."""
    try:
        yield
    except RobodynError as error:
        if error.what.startswith("--"):
            error.what = error.what[2:].replace("-", "_")
        raise
