"""Motions in tables of states: what a table lacks of its rates is zero, or found by splines.

Of a whole motion what lacks is found, and what is wrong is named.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from robodyn.cli.output import note
from robodyn.cli.row_files import open_rows
from robodyn.cli.states import Quantity, Source, complete, table_source
from robodyn.dynamics.columns import scene_units
from robodyn.dynamics.free_joints import balanced_mechanism
from robodyn.dynamics.joint_vectors import driver_of
from robodyn.errors import InputError, RobodynError, at_place
from robodyn.mechanics.driven import check_times
from robodyn.mechanics.mechanism import Mechanism
from robodyn.parameters.zero_phase import how, rates
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import finite, shown, split_fields, unquoted
from robodyn.tables.table import Chunk, Reader
from robodyn.trajectories.joint_paths import FEWEST_ROWS, derivative, turns_between

GAP = 5.0  # times the usual step: where t leaps by more, rows are missing


def taken_at_rest(
    reader: Reader, sources: Sequence[Source], chunks: Iterator[Chunk]
) -> Iterator[Chunk]:
    """The chunks, with a warning where times run on, and no rates are given."""
    rates = [x for x in sources if x.quantity.name in ("qd", "qdd")]
    at_rest = sources[0].columns and not any(x.given for x in rates)
    place = reader.header.index("t") if at_rest and "t" in reader.header else None
    begin: float | None = None
    for chunk in chunks:
        if place is not None:
            first, last = (finite(unquoted(split_fields(chunk.lines[k])[place])) for k in (0, -1))
            begin = first if begin is None else begin
            if begin is not None and last is not None and last != begin:
                names = [x.quantity.name for x in rates]
                tell_at_rest(reader.source, names, "; --differentiate finds them")
                place = None
        yield chunk


def tell_at_rest(source: str, names: Sequence[str], more: str = "") -> None:
    """Warn that a table with times has none of these rates."""
    text = f"t runs on, but no {' and '.join(names)} given: taken as zero{more}"
    note(f"Warning: {source}: {text}")


class Lack(NamedTuple):
    """Rates that a table lacks, and the columns from which they are computed."""

    absent: Sequence[str]  # qd and qdd, where they are not given
    base: Source  # q, or qd where that is given
    names: list[str]
    whole: bool  # whether these are of all joints

    def filled(
        self,
        sources: Sequence[Source],
        column: Mapping[str, Array],
        rates: Callable[[Array, Array, int], Array],
    ) -> tuple[list[Source], list[Array]]:
        """The sources as if the table had all columns, and their values (T, k).

        `rates` finds the derivative of an order at times (T,) of values (T, m).
        """
        found, values, rows = [], [], len(next(iter(column.values())))
        for source in sources:
            lacks = source.quantity.name in self.absent
            names = self.names if lacks else source.columns
            x = np.array([column[name] for name in names]).reshape(len(names), rows).T
            if lacks:
                order = len(source.quantity.name) - len(self.base.quantity.name)  # by the d's
                x = rates(column["t"], x, order)
                source = source._replace(columns=names, whole=self.whole)
            found.append(source)
            values.append(x)
        return found, values


def lack_of(mechanism: Mechanism, sources: Sequence[Source]) -> Lack:
    """Return which rates are lacking; in a closed mechanism, of the independent joints."""
    known = {x.quantity.name: x for x in sources}
    absent = [name for name in ("qd", "qdd") if name in known and not known[name].given]
    base = known["q"] if "qd" in absent else known["qd"]
    whole = base.whole and not mechanism.rows
    names = base.columns if whole else base.quantity.columns(driver_of(mechanism).actuated)
    return Lack(absent, base, names, whole)


def whole_table(reader: Reader, names: Sequence[str]) -> tuple[dict[str, Array], list[Chunk]]:
    """The columns `names` (T,) of all rows by name, and the rows."""
    chunks = list(reader.chunks(names))
    values = np.concatenate([np.zeros((0, len(names))), *(x.values for x in chunks)])
    return dict(zip(names, values.T, strict=True)), chunks


def unwrapped(
    what: str,
    angle: Array,
    lines: Sequence[int],
    source: str,
    t: Array | None = None,
    qd: Array | None = None,
) -> tuple[Array, InputError | None]:
    """Return an angle (T,), rad, without jumps by whole turns, and an InputError for the first.

    `lines` (T,) are those of the rows in the file `source`. The error is None if nothing jumps; see
    `turns_between` for t and qd (T,).
    """
    turns = turns_between(angle, t, qd)
    if not turns.any():
        return angle, None
    k = int(np.flatnonzero(turns)[0])
    beyond = "" if t is None or qd is None else " beyond what its rates tell"
    limit = f"more than half a turn{beyond}: --unwrap takes whole turns off"
    value = f"{angle[k]:.6g} to {angle[k + 1]:.6g} rad"
    where = f"{source}: line {lines[k + 1]}"
    fault = InputError(f"jump of {what}", where=where, value=value, limit=limit)
    return angle - 2.0 * np.pi * np.append(0.0, np.cumsum(turns)), fault


def without_jumps(
    mechanism: Mechanism,
    column: Mapping[str, Array],
    lines: Sequence[int],
    source: str,
    unwrap: bool,
    names: Container[str],
    refuse: bool = True,
) -> dict[str, Array]:
    """Return columns (T,) by name, such as t, q1, qd1; joint angles `unwrapped` if `unwrap`.

    Else a jump in one of the columns `names` is an InputError, or a note unless `refuse`.
    """
    found = dict(column)
    for k, link in enumerate(mechanism.link_names):
        name = f"q{k + 1}"
        if name not in column or k in mechanism.slides:
            continue
        rates = column.get("t"), column.get(f"qd{k + 1}")
        smooth, fault = unwrapped(f"{name} ({link})", column[name], lines, source, *rates)
        if fault and unwrap:
            found[name] = smooth
        elif fault and name in names:
            if not refuse:
                note(f"Note: {fault}")
                continue
            more = "" if rates[1] is not None else f"qd{k + 1} or "
            fault.limit += f"; if it is meant, give {more}closer rows"
            raise fault
    return found


def found_rates(
    mechanism: Mechanism,
    reader: Reader,
    sources: Sequence[Source],
    timed: bool,
    unwrap: bool,
) -> tuple[list[Source], Iterator[Chunk]]:
    """The sources as if the table had columns qd and qdd, and its chunks, of their columns.

    The last column is t where it is `timed`.  Raises InputError where there is nothing to find or
    to find it from.
    """

    def refused(limit: str) -> InputError:
        return InputError("--differentiate", where=reader.source, limit=limit)

    lack = lack_of(mechanism, sources)
    kind = lack.base.quantity.name
    if not lack.absent:
        raise refused("the rates are given: there is nothing to find")
    if not lack.base.columns:
        raise refused(f"needs columns {kind}1.. in place of --{kind}")
    if not lack.names:
        raise refused("no joint is actuated, from whose motion that of the loops would follow")
    names = list(dict.fromkeys(["t", *(name for x in sources for name in x.columns)]))
    column, chunks = whole_table(reader, names)
    t = column["t"]
    if len(t) < FEWEST_ROWS:
        raise refused(f"needs {FEWEST_ROWS} rows or more; there are {len(t)}")
    numbers = list(chain(*(x.line_numbers for x in chunks)))
    check_rising(t, numbers, reader.source, ", to differentiate")
    column = without_jumps(mechanism, column, numbers, reader.source, unwrap, lack.names)
    found, parts = lack.filled(sources, column, derivative)
    table = np.column_stack([*parts, *([t] if timed else [])])
    pieces = np.split(table, np.cumsum([len(chunk.lines) for chunk in chunks])[:-1])
    pairs = zip(chunks, pieces, strict=True)
    return found, (chunk._replace(values=piece) for chunk, piece in pairs)


def check_rising(t: np.ndarray, lines: Sequence[int], source: str, why: str = "") -> None:
    """Raise InputError, with the line, where a time is not greater than that before."""
    if len(wrong := np.flatnonzero(~(np.diff(t) > 0.0))):
        k = int(wrong[0]) + 1
        limit = f"must be greater than that before ({t[k - 1]:.9g}){why}"
        raise InputError("t", where=f"{source}: line {lines[k]}", value=f"{t[k]:.9g}", limit=limit)


class MotionFile(NamedTuple):
    """q, qd, qdd (T, n), tau (T, a) where it was asked for, t (T,), and the rows as they came."""

    states: list[Array]
    tau: Array
    t: Array
    lines: list[str]
    header: Sequence[str]
    source: str
    noisy: bool  # whether rates were found without a low-pass, which magnifies noise


def read_motion(
    mechanism: Mechanism,
    file: str,
    torques: bool,
    cutoff: float | None = None,
    unwrap: bool = False,
    read: str | None = None,
) -> MotionFile:
    """The motion in a file, `read` as by --read; rates that it lacks are found, which is told.

    Raises InputError for gaps, for columns of another mechanism, for times that do not rise, for
    angles that jump unless `unwrap`, and for a cutoff where no rates are to be found.
    """
    moving = balanced_mechanism(mechanism) if mechanism.rows else mechanism
    wanted = [Quantity("q", None, True), Quantity("qd", None), Quantity("qdd", None)]
    wanted += [Quantity("tau", None, True)] if torques else []
    with open_rows(file, scene_units(mechanism), read) as reader:
        name = reader.source
        _check_joints(mechanism, reader.names, name)
        sources = [table_source(moving, x, reader.names, name) for x in wanted[:3]]
        sources += [table_source(mechanism, x, reader.names, name) for x in wanted[3:]]
        lack = lack_of(moving, sources)
        timed = "t" in reader.header
        check_times(mechanism, timed, name)
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
    differentiated = lack.names if lack.absent else ()
    column = without_jumps(mechanism, column, numbers, name, unwrap, differentiated)
    if lack.absent:
        told = f"{' and '.join(lack.absent)} of {', '.join(lack.names)}"
        note(f"Note: {told}: by {how(cutoff, t)}")
    with at_place(name, "t", "rows"):
        found, arrays = lack.filled(sources, column, partial(rates, cutoff=cutoff))
    if torques:
        source, tau = found.pop(), arrays.pop()
        tau = tau[:, list(mechanism.actuated)] if source.whole else tau
    else:
        tau = np.zeros((len(t), 0))
    try:
        states = complete(moving, found, arrays, t=t)
    except RobodynError:
        for k, number in enumerate(numbers):  # which of the rows it is
            with at_place(f"{name}: line {number}"):
                complete(moving, found, [x[k : k + 1] for x in arrays], t=t[k : k + 1])
        raise
    lines, noisy = list(chain(*(x.lines for x in chunks))), bool(lack.absent) and cutoff is None
    return MotionFile(states, tau, t, lines, reader.header, name, noisy)


def _check_gap(t: Array, numbers: Sequence[int], source: str) -> None:
    """InputError for rows that lack among the others, where rates are found through them."""
    steps = np.diff(t)
    k = int(np.argmax(steps)) if len(steps) else 0
    if len(steps) and steps[k] > GAP * (usual := float(np.median(steps))):
        limit = f"{GAP:g} steps of {usual:.6g} s at most, for rates to be found across: "
        limit += "give qd and qdd, or the parts on their own"
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
