"""The rates and accelerations that a table of states lacks: zero, or by splines through t."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from robodyn.cli.output import note
from robodyn.cli.states import Source
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.csv_fields import finite, split_fields, unquoted
from robodyn.tables.table import Chunk, Reader
from robodyn.trajectories.splines import FEWEST_ROWS, derivative


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


def found_rates(
    mechanism: Mechanism, reader: Reader, sources: Sequence[Source], timed: bool
) -> tuple[list[Source], Iterator[Chunk]]:
    """The sources as if the table had columns qd and qdd, and its chunks, of their columns.

    Of a closed mechanism the actuated joints' are found, which the loops complete.  The last column
    is t where it is `timed`.  Raises InputError where there is nothing to find or to find it from.
    """
    known = {x.quantity.name: x for x in sources}
    absent = [name for name in ("qd", "qdd") if name in known and not known[name].given]
    base = known["q"] if "qd" in absent else known["qd"]
    if not absent:
        limit = "the rates are given: there is nothing to find"
        raise InputError("--differentiate", where=reader.source, limit=limit)
    if not base.columns:
        limit = f"needs columns {base.quantity.name}1.. in place of --{base.quantity.name}"
        raise InputError("--differentiate", where=reader.source, limit=limit)
    whole = base.whole and not mechanism.rows
    names = base.columns if whole else base.quantity.columns(mechanism.actuated)
    if not names:
        limit = "no joint is actuated, from whose motion that of the loops would follow"
        raise InputError("--differentiate", where=reader.source, limit=limit)
    columns = list(dict.fromkeys(["t", *(name for x in sources for name in x.columns)]))
    chunks = list(reader.chunks(columns))
    values = np.concatenate([np.zeros((0, len(columns))), *(x.values for x in chunks)])
    column = dict(zip(columns, values.T, strict=True))
    if len(column["t"]) < FEWEST_ROWS:
        limit = f"needs {FEWEST_ROWS} rows or more; there are {len(column['t'])}"
        raise InputError("--differentiate", where=reader.source, limit=limit)
    check_rising(
        column["t"],
        list(chain(*(x.line_numbers for x in chunks))),
        reader.source,
        ", to differentiate",
    )

    x = np.stack([column[name] for name in names], axis=-1)
    found: list[Source] = []
    parts: list[np.ndarray] = []
    for source in sources:
        if source.quantity.name in absent:
            order = len(source.quantity.name) - len(base.quantity.name)  # as names have d's
            found.append(replace(source, columns=names, whole=whole))
            parts.extend(derivative(column["t"], x, order).T)
        else:
            found.append(source)
            parts += [column[name] for name in source.columns]
    table = np.stack([*parts, *([column["t"]] if timed else [])], axis=-1)
    pieces = np.split(table, np.cumsum([len(chunk.lines) for chunk in chunks])[:-1])
    pairs = zip(chunks, pieces, strict=True)
    return found, (chunk._replace(values=piece) for chunk, piece in pairs)


def check_rising(t: np.ndarray, lines: Sequence[int], source: str, why: str = "") -> None:
    """Raise InputError, with the line, where a time is not greater than that before."""
    if len(wrong := np.flatnonzero(~(np.diff(t) > 0.0))):
        k = int(wrong[0]) + 1
        limit = f"must be greater than that before ({t[k - 1]:.9g}){why}"
        raise InputError("t", where=f"{source}: line {lines[k]}", value=f"{t[k]:.9g}", limit=limit)
