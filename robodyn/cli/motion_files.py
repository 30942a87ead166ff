"""A whole motion from a CSV file of states: what lacks of it is found, what is wrong is named."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from robodyn.cli.found_rates import check_rising, lack_of, whole_table
from robodyn.cli.output import note
from robodyn.cli.row_files import open_input
from robodyn.cli.states import Quantity, complete, table_source
from robodyn.errors import InputError, RobodynError, at_place
from robodyn.mechanics.mechanism import Mechanism
from robodyn.parameters.regression_matrix import balanced_mechanism
from robodyn.parameters.zero_phase import how, rates
from robodyn.pictures.column_units import scene_units
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown
from robodyn.tables.table import Reader

GAP = 5.0  # times the usual step: where t leaps by more, rows are missing


class MotionFile(NamedTuple):
    """q, qd, qdd (T, n), tau (T, a) where it was asked for, t (T,), and the rows as they came."""

    states: list[Array]
    tau: Array
    t: Array
    lines: list[str]
    header: Sequence[str]
    source: str


def read_motion(
    mechanism: Mechanism, file: str, torques: bool, cutoff: float | None = None
) -> MotionFile:
    """The motion in a file; rates that it lacks are found, which is told.

    Raises InputError for gaps, for columns of another mechanism, for times that do not rise, and
    for a cutoff where no rates are to be found.
    """
    moving = balanced_mechanism(mechanism) if mechanism.rows else mechanism
    wanted = [Quantity("q", None, True), Quantity("qd", None), Quantity("qdd", None)]
    wanted += [Quantity("tau", None, True)] if torques else []
    with open_input(file) as (stream, name):
        reader = Reader(stream, name, scene_units(mechanism))
        _check_joints(mechanism, reader.names, name)
        sources = [table_source(moving, x, reader.names, name) for x in wanted[:3]]
        sources += [table_source(mechanism, x, reader.names, name) for x in wanted[3:]]
        lack = lack_of(moving, sources)
        timed = "t" in reader.header
        if cutoff is not None and not lack.absent:
            limit = f"is for rates that lack: {name} has qd, qdd"
            raise InputError("cutoff", value=cutoff, limit=limit)
        if lack.absent and not timed:
            raise InputError("t", where=name, limit=f"no column t, to find {lack.absent[0]} by")
        columns = [x for source in sources for x in source.columns]
        column, chunks = whole_table(reader, [*columns, *(["t"] if timed else [])])
    if not chunks:
        raise InputError("no rows", where=name, limit="the header is followed by no state")
    numbers = list(chain(*(x.line_numbers for x in chunks)))
    t = column.get("t", np.zeros(len(numbers)))
    if timed:
        check_rising(t, numbers, name)
    if lack.absent:
        _check_gap(t, numbers, name)
        told = f"{' and '.join(lack.absent)} of {', '.join(lack.names)}"
        note(f"Note: {told}: by {how(cutoff)}")
    with at_place(name, "t", "rows"):
        found, arrays = lack.filled(sources, column, partial(rates, cutoff=cutoff))
    if torques:
        source, tau = found.pop(), arrays.pop()
        tau = tau[:, list(mechanism.actuated)] if source.whole else tau
    else:
        tau = np.zeros((len(t), 0))
    try:
        states = complete(moving, found, arrays)
    except RobodynError:
        for k, number in enumerate(numbers):  # which of the rows it is
            with at_place(f"{name}: line {number}"):
                complete(moving, found, [x[k : k + 1] for x in arrays])
        raise
    return MotionFile(states, tau, t, list(chain(*(x.lines for x in chunks))), reader.header, name)


def _check_gap(t: Array, numbers: Sequence[int], source: str) -> None:
    """InputError for rows that lack among the others, where rates are found through them."""
    steps = np.diff(t)
    k = int(np.argmax(steps)) if len(steps) else 0
    if len(steps) and steps[k] > GAP * (usual := float(np.median(steps))):
        limit = (
            f"{GAP:g} steps of {usual:.6g} s at most, for rates to be found across: give qd and "
        )
        limit += "qdd, or the parts on their own"
        where = f"{source}: line {numbers[k + 1]}"
        raise InputError("t leaps by", value=f"{steps[k]:.6g} s", where=where, limit=limit)


def _check_joints(mechanism: Mechanism, header: Sequence[str], source: str) -> None:
    """Raise InputError where a column is of a joint that there is not."""
    for column in header:
        match = re.fullmatch(r"(?:q|qd|qdd|tau)([0-9]{1,9})", column, re.ASCII)
        if match and not 1 <= int(match[1]) <= mechanism.n:
            joints = "1 joint" if mechanism.n == 1 else f"{mechanism.n} joints"
            limit = f"the mechanism has {joints}: these are data of another one"
            raise InputError(f"column {shown(column)}", where=source, limit=limit)
