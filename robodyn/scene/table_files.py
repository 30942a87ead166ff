"""CSV files that a scene names: two columns, x and a value at each, linear between the rows.

Fields end at commas, or at semicolons (with decimal commas) or tabs where the first line says so.
"""

from __future__ import annotations

import io
import math
from itertools import islice, pairwise
from pathlib import Path
from typing import BinaryIO, Literal, cast

from robodyn.errors import InputError
from robodyn.scene.scene import Curve, Table, Tables
from robodyn.tables.csv_fields import Delimited
from robodyn.tables.input_file import read_regular
from robodyn.tables.table import Reader

MOST_ROWS = 2000  # every engine writes the rows into its code
PERIODS = (2.0 * math.pi, 4.0 * math.pi)  # of a joint's angle, after which a table repeats
PERIOD_OFF = 1e-6  # rad that the digits of a file may miss them by
LEAST_ROWS = 4  # of a law, whose ends are not-a-knot
ENDS_AGREE = 1e-9  # of the largest value


def read_table(
    source: str,
    file: str,
    over: str,
    x: str,
    column: str,
    turns: bool,
    known: Tables,
    hold: bool = False,
) -> Table:
    """The table over the variable `over`, whose column is `x`, in a file beside the scene's.

    A file that is not yet in `known` is read, and added to it.

    Where x is an angle that `turns`, the column may be that in degrees, x_deg; and a span of one or
    two turns whose ends agree repeats.  Raises ValueError with the reason for what is no table.
    """
    key = file, x, column, turns
    if key not in known:
        known[key] = _columns(Path(source).parent / file, x, column, turns)
    places, values = known[key]
    repeats = False
    if turns:
        period = min(PERIODS, key=lambda p: abs(places[-1] - places[0] - p))
        apart = abs(values[-1] - values[0])
        off = abs(places[-1] - places[0] - period)
        repeats = off <= PERIOD_OFF and apart <= ENDS_AGREE * max(map(abs, values))
        if repeats:
            places = (*places[:-1], places[0] + period)
    return Table(file, over, column, hold, places, values, repeats)


def read_curve(
    source: str,
    file: str,
    over: str,
    x: str,
    column: str,
    turns: bool,
    period: float | None,
    known: Tables,
) -> Curve:
    """The cubic spline over the variable `over` through the rows of a file: see `read_table`.

    With a `period`, which is the span of x, it repeats after that, and keeps its rise; else it is
    not-a-knot at its ends.  Raises ValueError with the reason for what is no such table.
    """
    from scipy.interpolate import CubicSpline  # only scenes with such tables import it

    key = file, x, column, turns
    if key not in known:
        known[key] = _columns(Path(source).parent / file, x, column, turns)
    places, values = known[key]
    if len(places) < LEAST_ROWS:
        raise ValueError(f"has {len(places)} rows below its header; a law needs {LEAST_ROWS}")
    if any(a == b for a, b in pairwise(places)):
        raise ValueError(f"has two rows at one {x}: a law does not jump")
    rise, slope, above = 0.0, 0.0, list(values)
    if period is not None:
        span = places[-1] - places[0]
        if not abs(span - period) <= PERIOD_OFF * max(1.0, abs(period)):
            raise ValueError(f"goes from {places[0]:g} to {places[-1]:g}, not over {period:g}")
        places = (*places[:-1], places[0] + period)
        rise = values[-1] - values[0]
        slope = rise / period
        above = [y - slope * (at - places[0]) for at, y in zip(places, values, strict=True)]
        above[-1] = above[0]
    ends: Literal["not-a-knot", "periodic"] = "not-a-knot" if period is None else "periodic"
    coefficients = CubicSpline(places, above, bc_type=ends).c[::-1].T
    pieces = [[float(c) for c in piece] for piece in coefficients]
    if period is not None:
        for piece, at in zip(pieces, places, strict=False):
            piece[0] += slope * (at - places[0])
            piece[1] += slope
    each = tuple((a, b, c, d) for a, b, c, d in pieces)
    return Curve(file, over, column, places, each, rise, period is not None)


def _columns(
    path: Path, x: str, column: str, turns: bool
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Both columns of a file; ValueError with the reason if it has no such columns."""
    if x == column:
        raise ValueError(f"has {x} on both axes")
    try:
        stream = cast(BinaryIO, Delimited(io.BytesIO(read_regular(path))))
        reader = Reader(stream, "", (column,) if turns else (x, column))
        chunks = reader.chunks([x, column])
        rows = list(islice((row for c in chunks for row in c.values.tolist()), MOST_ROWS + 1))
    except InputError as error:
        raise ValueError(str(error).lstrip(": ")) from None
    except OSError as error:
        raise ValueError(f"cannot be read: {(error.strerror or str(error)).lower()}") from None
    if not 2 <= len(rows) <= MOST_ROWS:
        count = f"more than {MOST_ROWS}" if len(rows) > MOST_ROWS else len(rows)
        raise ValueError(f"has {count} rows below its header; it needs 2 to {MOST_ROWS}")
    several = 0  # rows before one at the same place: over t one more makes a step
    for (before, low), (after, high) in pairwise(rows):
        several = several + 1 if after == before else 0
        if after < before or several > (x == "t"):
            limit = "must increase from row to row"
            limit += "; two at one time are a step" if several and x == "t" else ""
            raise ValueError(f"{x} {limit}: {after:g} follows {before:g}")
        if after > before and not math.isfinite((high - low) / (after - before)):
            raise ValueError(f"{column} rises too steeply: its slopes overflow")
    places, values = zip(*rows, strict=True)
    if places[0] == places[-1]:
        raise ValueError(f"has one time, {places[0]:g}: it needs two")
    return places, values
