"""CSV files that a scene names: two columns, x and a value at each, linear between the rows.

Fields end at commas, or at semicolons (with decimal commas) or tabs where the first line says so.
They are read without numpy: a command that evaluates one state starts without it.
"""

from __future__ import annotations

import io
import math
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

from robodyn.scene.scene import Table
from robodyn.tables.csv_fields import IN_DEGREES, finite, shown, split_fields, unquoted
from robodyn.tables.delimited import DELIMITERS, Delimited

MOST_ROWS = 2000  # every engine writes the rows into its code
MOST_BYTES = 2**20
PERIODS = (2.0 * math.pi, 4.0 * math.pi)  # of a joint's angle, after which a table repeats
PERIOD_OFF = 1e-6  # rad that the digits of a file may miss them by
ENDS_AGREE = 1e-9  # of the largest value


def read_table(source: str, file: str, over: str, x: str, column: str, turns: bool) -> Table:
    """The table over the variable `over`, whose column is `x`, in a file beside the scene's.

    Where x is an angle that `turns`, the column may be that in degrees, x_deg; and a span of one or
    two turns whose ends agree repeats.  Raises ValueError with the reason for what is no table.
    """
    path = Path(source).parent / file
    try:
        stat = path.stat()
        if stat.st_size > MOST_BYTES:
            raise ValueError(f"is larger than {MOST_BYTES} bytes")
        places, values = _columns(str(path), (stat.st_mtime_ns, stat.st_size), x, column, turns)
    except OSError as error:
        raise ValueError(f"cannot be read: {(error.strerror or str(error)).lower()}") from None
    repeats = False
    if turns:
        period = min(PERIODS, key=lambda p: abs(places[-1] - places[0] - p))
        apart = abs(values[-1] - values[0])
        off = abs(places[-1] - places[0] - period)
        repeats = off <= PERIOD_OFF and apart <= ENDS_AGREE * max(map(abs, values))
        if repeats:
            places = (*places[:-1], places[0] + period)
    return Table(file, column, over, places, values, repeats)


def _text(data: bytes, column: str) -> str:
    """A file as text, whose fields end at commas; at what else tells its first line."""
    first = data.partition(b"\n")[0].decode("utf-8-sig")
    for mark in DELIMITERS.values():
        fields = [unquoted(field.strip()) for field in first.split(mark)]
        if mark != "," and column in fields and "," not in first:
            data = b"".join(iter(Delimited(io.BytesIO(data), mark).read, b""))
    return data.decode("utf-8-sig")


@lru_cache(maxsize=32)
def _columns(
    path: str, version: tuple[int, int], x: str, column: str, turns: bool
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Both columns; `version` tells the file from what it was."""
    try:
        lines = _text(Path(path).read_bytes(), column).splitlines()
    except UnicodeDecodeError:
        raise ValueError("is no UTF-8 text") from None
    scale = 1.0
    rows = [(i, line) for i, line in enumerate(lines, start=1) if line.strip()]
    header = [unquoted(field.strip()) for field in split_fields(rows[0][1])] if rows else []
    if turns and x not in header and x + IN_DEGREES in header:
        header[header.index(x + IN_DEGREES)], scale = x, math.pi / 180.0
    for name in (x, column):
        if header.count(name) != 1:
            known = ", ".join(map(shown, header)) or "nothing"
            raise ValueError(f"must have a column {name}; its first line has {shown(known)}")
    if x == column:
        raise ValueError(f"has {x} on both axes")
    found: tuple[list[float], list[float]] = ([], [])
    for i, line in rows[1:]:
        fields = [unquoted(field.strip()) for field in split_fields(line)]
        if len(fields) != len(header):
            raise ValueError(f"line {i} has {len(fields)} fields, the first line {len(header)}")
        for name, values in zip((x, column), found, strict=True):
            field = fields[header.index(name)]
            value = finite(field)
            if value is None:
                raise ValueError(f"line {i}: {name} must be a finite number, not {shown(field)!r}")
            values.append(value)
    places, values = [scale * x for x in found[0]], found[1]
    if not 2 <= len(places) <= MOST_ROWS:
        raise ValueError(f"has {len(places)} rows below its header; it needs 2 to {MOST_ROWS}")
    for before, after in pairwise(places):
        if not after > before:
            raise ValueError(f"{x} must increase from row to row: {after:g} follows {before:g}")
    slopes = [
        (b - a) / (d - c) for (a, b), (c, d) in zip(pairwise(values), pairwise(places), strict=True)
    ]
    if not all(map(math.isfinite, slopes)):
        raise ValueError(f"{column} rises too steeply: its slopes overflow")
    return tuple(places), tuple(values)
