"""`robodyn summary`: what rows have in common, in place of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Annotated

import numpy as np

from robodyn.cli.files import load_scene, model_file, rows_argument
from robodyn.cli.options import Out, OutputFormat, Read, Text, option
from robodyn.cli.output import default_format, maker, names_in, note
from robodyn.cli.row_files import open_rows
from robodyn.dynamics.columns import ANY_SCENE, declared, result_names, scene_units
from robodyn.dynamics.flywheel import harmonics as orders_of
from robodyn.errors import InputError, at_place, named_options
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import IN_DEGREES, columns_told, shown
from robodyn.tables.output_file import open_output
from robodyn.tables.summaries import Extremes, KeptRows, Rows, SummaryWriter
from robodyn.tables.summaries import correlations as rank_correlations

_ROWS = "CSV file, or - for stdin, which is the default."
_MODEL = "Scene that the rows are of: tells the units of joints that slide."
_HARMONICS = "The orders 0 to N, or 10, of the columns over one turn of --by."
_BY = "With --harmonics the column of the angle that turns. Default: q1."
_CORRELATIONS = "Spearman's rank correlation of each other column with these."
MOST = 10_000  # orders
OF_STATES = ("t", "q", "qd", "qdd")  # families that stand behind the computed ones


def summary(
    rows: Annotated[str, rows_argument("TABLE", _ROWS)] = "-",
    harmonics: int | None = option(_HARMONICS, "[N]"),
    by: Text = option(_BY, "NAME"),
    correlations: Text = option(_CORRELATIONS, "NAMES"),
    read: Read = None,
    model: Annotated[Text, model_file("--model", _MODEL)] = None,
    format: OutputFormat = None,
    out: Out = None,
) -> None:
    """What the columns of a table come to, one a row: extremes, means; or orders, correlations.

    Columns: column, min, min_t, min_q1, max, max_t, max_q1, mean, rms: of each column of numbers
    but t the least and the greatest value, the t and q1 of their rows, the mean and the root mean
    square.  Both are over t where t is there and never falls, else rows count equally.  Rows in
    which a column has no value do not count in it.  Columns that robodyn computes come first,
    then those of states and all others.

    --harmonics takes one turn, rows at equal steps of the angle theta, the last a step before the
    first or as it, and tells for each order k amplitude and phase (rad) of the computed columns:
    shake_fx is the sum of shake_fx_amp cos(k theta + shake_fx_phase) over all orders.

    --correlations tells how each column goes with those named: 1 where the one never falls as the
    other grows, -1 where it never grows, empty where one is constant.

    \b
    Examples:
      robodyn summary motion.csv
      robodyn torque 2r states.csv | robodyn summary
      robodyn simulate 2r --q 0,0 --time 2 | robodyn summary --format table
      robodyn trajectory slider-crank --speed 300rpm --turns 1 --points 361 | \\
        robodyn reactions slider-crank - --columns q1,shaking | \\
        robodyn summary --harmonics 4
      robodyn sweep 2r --vary links.forearm.m=0.5:1.5 --sample 100 --kind torque \\
        --q 0,0 | robodyn summary --correlations links.forearm.m
    """
    if harmonics is not None and correlations is not None:
        raise InputError("--harmonics and --correlations", limit="exclude each other")
    if by is not None and harmonics is None:
        raise InputError("--by", value=shown(by), limit="goes with --harmonics")
    if harmonics is not None and not 0 <= harmonics <= MOST:
        raise InputError("--harmonics", value=harmonics, limit=f"must be in [0, {MOST}]")
    units = ANY_SCENE if model is None else scene_units(load_scene(model))
    chosen = default_format(format, out)
    with open_rows(rows, read=read) as reader:
        name, header = reader.source, reader.header
        kept = None
        if harmonics is not None:
            angle = by or ("q1" if "q1" in header else "q1" + IN_DEGREES)
            kept = partial(_orders, angle=_there(angle, "--by", header, name), most=harmonics)
        elif correlations is not None:
            named = names_in(correlations, "--correlations")
            varied = [_there(x, "--correlations", header, name) for x in named]
            kept = partial(_correlated, varied=varied)
        with open_output(out, styled=chosen == "table") as target:
            make = maker(target, chosen, out, units)
            writer: SummaryWriter
            if kept is None:
                writer = Extremes(make, [], header)
                writer.rank = _rank
            else:
                writer = KeptRows(make, [], header, of=kept)
            writer.note = note
            count = 0
            for chunk in reader.chunks([]):
                count += len(chunk.lines)
                writer.write_rows(chunk.lines, np.zeros((len(chunk.lines), 0)))
            if not count:
                raise InputError("no rows", where=name, limit="the header is followed by no row")
            writer.close()


def _there(name: str, flag: str, header: Sequence[str], source: str) -> str:
    """The name of a column; InputError if the table has none of it."""
    if name not in header:
        limit = f"is no column; there are {columns_told(header, name)}"
        raise InputError(flag, where=source, value=shown(name), limit=limit)
    return name


def _rank(name: str) -> int:
    """0 for a column that robodyn computes, 1 for others, which are told behind these."""
    found = declared(name.removesuffix(IN_DEGREES))
    return 0 if "/" in name or (found and found[0].name not in OF_STATES) else 1


def _numeric(header: Sequence[str], rows: Array, but: Sequence[str]) -> list[int]:
    """The places of the computed columns of numbers; of all others, where there is none."""
    whole = [not np.isnan(x).all() for x in rows.T]
    there = [k for k, name in enumerate(header) if whole[k] and name not in but]
    return [k for k in there if not _rank(header[k])] or there


def _orders(
    header: Sequence[str], rows: Array, _: Array, angle: str, most: int
) -> tuple[Sequence[str], Rows]:
    theta = rows[:, header.index(angle)]
    in_degrees = angle.endswith(IN_DEGREES)
    places = _numeric(header, rows, ["t", angle])
    for k in [header.index(angle), *places]:
        if np.isnan(rows[:, k]).any():
            limit = "must have a number in each row"
            raise InputError(f"column {shown(header[k])}", limit=limit)
    with named_options((), orders="harmonics"), at_place("--harmonics", "the "):
        turned = np.radians(theta) if in_degrees else theta
        amplitudes, phases = orders_of(turned, rows[:, places], most)
    pairs = [amplitudes, np.degrees(phases) if in_degrees else phases]
    each = np.stack(pairs, axis=-1).reshape(len(amplitudes), -1)
    columns = result_names("orders", [header[k] for k in places])
    if in_degrees:
        columns[1::2] = [x + IN_DEGREES for x in columns[1::2]]
    return [*result_names("order"), *columns], [
        [str(order), *row] for order, row in enumerate(each.tolist())
    ]


def _correlated(
    header: Sequence[str], rows: Array, _: Array, varied: Sequence[str]
) -> tuple[Sequence[str], Rows]:
    worded = [bool(np.isnan(x).all()) for x in rows.T]
    first = [header.index(name) for name in varied]
    others = [k for k, x in enumerate(header) if k not in first and x != "t" and not worded[k]]
    others.sort(key=lambda k: _rank(header[k]))
    for k in first:
        if worded[k]:
            raise InputError("--correlations", value=shown(header[k]), limit="has no numbers")
    chosen = [*first, *others]
    names = [header[k] for k in chosen]
    found = rank_correlations(names, len(first), [rows[:, chosen]])
    return ["column", *varied], [[name, *row] for name, row in found.items()]
