"""The rates and accelerations that a table of states lacks: zero, or by splines through t."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from robodyn.cli.output import note
from robodyn.cli.states import Source
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array
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


class Lack(NamedTuple):
    """What a table lacks of the rates, and the columns that they are found from."""

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
    """What is lacking; of a closed mechanism for the actuated joints, which tell the others."""
    known = {x.quantity.name: x for x in sources}
    absent = [name for name in ("qd", "qdd") if name in known and not known[name].given]
    base = known["q"] if "qd" in absent else known["qd"]
    whole = base.whole and not mechanism.rows
    names = base.columns if whole else base.quantity.columns(mechanism.actuated)
    return Lack(absent, base, names, whole)


def whole_table(reader: Reader, names: Sequence[str]) -> tuple[dict[str, Array], list[Chunk]]:
    """The columns `names` (T,) of all rows by name, and the rows."""
    chunks = list(reader.chunks(names))
    values = np.concatenate([np.zeros((0, len(names))), *(x.values for x in chunks)])
    return dict(zip(names, values.T, strict=True)), chunks


def found_rates(
    mechanism: Mechanism, reader: Reader, sources: Sequence[Source], timed: bool
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
