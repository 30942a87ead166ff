"""A whole motion from a CSV file of states: what lacks of it is found, what is wrong is named."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from robodyn.cli.found_rates import check_rising
from robodyn.cli.output import note
from robodyn.cli.row_files import open_input
from robodyn.cli.states import Quantity, Source, complete, table_source
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.parameters.regression_matrix import balanced_mechanism
from robodyn.pictures.column_units import scene_units
from robodyn.tables.csv_fields import shown
from robodyn.tables.table import Reader

Array = np.ndarray
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
        absent = [x for x in sources if not x.given]
        timed = "t" in reader.header
        if cutoff is not None and not absent:
            raise InputError(
                "cutoff", value=cutoff, limit=f"is for rates that lack: {name} has qd, qdd"
            )
        if absent and not timed:
            limit = f"no column t, to find {absent[0].quantity.name} by"
            raise InputError("t", where=name, limit=limit)
        columns = [x for source in sources for x in source.columns]
        chunks = list(reader.chunks([*columns, *(["t"] if timed else [])]))
    if not chunks:
        raise InputError("no rows", where=name, limit="the header is followed by no state")
    values = np.concatenate([x.values for x in chunks])
    numbers = list(chain(*(x.line_numbers for x in chunks)))
    t = values[:, -1] if timed else np.zeros(len(values))
    if timed:
        check_rising(t, numbers, name)
        _check_gap(t, numbers, name) if absent else None
    column = dict(zip(columns, values.T, strict=False))
    given = {x.quantity.name: _columns(column, x.columns) for x in sources if x.columns}
    found = []
    for source in sources:
        kind = source.quantity.name
        if source.given:
            found.append(source)
            continue
        base = next(x for x in reversed(sources[:2]) if x.given)
        names = base.columns if base.whole and not mechanism.rows else None
        names = names or base.quantity.columns(moving.actuated)
        _tell(absent, names, base, cutoff) if source is absent[0] else None
        order = len(kind) - len(base.quantity.name)
        try:
            given[kind] = _rates(t, _columns(column, names), order, cutoff)
        except InputError as error:
            if error.what in ("t", "rows"):
                error.add_place(name)
            raise
        whole = len(names) == mechanism.n
        found.append(Source(source.quantity, [], list(names), whole))
    arrays = [given[source.quantity.name] for source in found]
    if torques:
        source, tau = found.pop(), arrays.pop()
        tau = tau[:, list(mechanism.actuated)] if source.whole else tau
    else:
        tau = np.zeros((len(values), 0))
    try:
        states = complete(moving, found, arrays)
    except RobodynError:
        for k, number in enumerate(numbers):  # which of the rows it is
            try:
                complete(moving, found, [x[k : k + 1] for x in arrays])
            except RobodynError as error:
                error.add_place(f"{name}: line {number}")
                raise
        raise
    return MotionFile(states, tau, t, list(chain(*(x.lines for x in chunks))), reader.header, name)


def _columns(column: dict[str, Array], names: Sequence[str]) -> Array:
    return np.stack([column[name] for name in names], axis=-1)


def _rates(t: Array, x: Array, order: int, cutoff: float | None) -> Array:
    from robodyn.parameters.zero_phase import rates

    return rates(t, x, order, cutoff)


def _tell(
    absent: Sequence[Source], names: Sequence[str], base: Source, cutoff: float | None
) -> None:
    from robodyn.parameters.zero_phase import how

    missing = " and ".join(x.quantity.name for x in absent)
    note(f"Note: {missing} of {', '.join(names)}: by {how(cutoff)}")


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
