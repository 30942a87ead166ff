"""Charts and maps of the columns of tables: files, stdin, or what was computed here."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import InputError
from robodyn.pictures.chart import Chart, chart, choose_columns, choose_x, place_of
from robodyn.pictures.column_units import in_degrees
from robodyn.pictures.value_map import ColourColumn, ValueMap, value_map
from robodyn.tables.csv_fields import shown
from robodyn.tables.table import Reader

Array = NDArray[np.float64]
Opened = AbstractContextManager[tuple[BinaryIO, str]]  # a table of CSV, and its name
ONE_Y = "a map has one column along y"


def read_chart(
    tables: Iterable[Opened],
    x: str | None,
    patterns: Sequence[str] | None,
    units: Mapping[str, str],
    degrees: bool,
) -> Chart:
    """The chart of the tables: the column x, else t or the row, and those that patterns name."""
    names: list[str] = []
    along: list[str | None] = []
    read: list[dict[str, Array]] = []
    for table in tables:
        with table as (stream, name):
            reader = Reader(stream, name)
            own = choose_x(reader.header, x, name)
            columns = choose_columns(reader.header, patterns, own, name)
            columns = list(dict.fromkeys([*columns, *([own] if own else [])]))
            blocks = [chunk.values for chunk in reader.chunks(columns)]
        names.append(name)
        along.append(own)
        values = np.concatenate([np.zeros((0, len(columns))), *blocks])
        read.append(dict(zip(columns, values.T, strict=True)))
    if degrees:
        along = [name and in_degrees(name, units)[0] for name in along]
        for k, columns_of in enumerate(read):
            told = {name: in_degrees(name, units) for name in columns_of}
            read[k] = {told[x][0]: told[x][1] * values for x, values in columns_of.items()}
    return chart(names, along, read, units)


def _map_in_degrees(mapped: ValueMap, units: Mapping[str, str]) -> ValueMap:
    """The map with its angles in degrees."""
    names = mapped.x_name, mapped.y_name, mapped.name
    told = [in_degrees(name, units) for name in names]
    values = told[2][1] * mapped.values if mapped.scale else mapped.values
    log = mapped.scale is not None and mapped.scale.log
    x, y = told[0][1] * mapped.x, told[1][1] * mapped.y
    new = value_map((told[0][0], told[1][0], told[2][0]), x, y, values, mapped.words, log)
    return new._replace(units=units)


def read_map(
    tables: Iterable[Opened],
    x: str,
    patterns: Sequence[str],
    colour: str,
    log: bool,
    units: Mapping[str, str],
    degrees: bool,
    tell: Callable[[str], object],
) -> ValueMap:
    """The map of the column `colour` over x and the one that the patterns name.

    Points that others hide are told.
    """
    column = ColourColumn(colour, positive=log)
    blocks, ys = [np.zeros((0, 2))], []
    for table in tables:
        with table as (stream, source):
            reader = Reader(stream, source)
            choose_x(reader.header, x, source)
            ys += choose_columns(reader.header, patterns, x, source)
            if len(set(ys)) > 1:
                raise InputError("--y", value=", ".join(dict.fromkeys(ys)), limit=ONE_Y)
            place = place_of(colour, "--colour", reader.header, source)
            for chunk in reader.chunks([x, ys[0]]):
                column.add(chunk, place, source)
                blocks.append(chunk.values)
    if log and column.words:
        limit = "needs a column of numbers; this one holds words"
        raise InputError("--log", value=shown(colour), limit=limit)
    along, up = np.concatenate(blocks).T
    mapped = value_map((x, ys[0], colour), along, up, column.values, column.words, log)
    if mapped.grid is not None and mapped.grid.hidden:
        tell(f"Note: {mapped.grid.hidden} rows are hidden by later ones with the same {x}, {ys[0]}")
    return _map_in_degrees(mapped, units) if degrees else mapped._replace(units=units)
