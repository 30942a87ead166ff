"""Results to stdout or a file: as a rich table on a terminal, as CSV or JSON elsewhere."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, Protocol

from robodyn.cli.options import Format, StructuredFormat
from robodyn.errors import printable, printable_lines
from robodyn.pictures.column_units import with_unit
from robodyn.tables.csv_fields import finite
from robodyn.tables.output_file import on_terminal, open_output
from robodyn.tables.table_writer import WRITERS

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.table import Table

PAGE = 200  # rows of one table on the terminal; a longer result goes on in another


class RowWriter(Protocol):
    """What the writers of all formats offer."""

    def write_row(self, values: Sequence[float | str]) -> None: ...
    def write_rows(self, lines: Sequence[str], values: NDArray[np.float64]) -> None: ...
    def write_columns(self, values: NDArray[np.float64]) -> None: ...
    def close(self) -> None: ...


@contextmanager
def row_writer(
    format: Format | None, out: str | None, columns: Sequence[str], header: Sequence[str] = ()
) -> Iterator[RowWriter]:
    """A writer of rows: computed `columns` after (or in) the columns of the input's `header`."""
    format = default_format(format, out)
    if format == "table":
        with open_output(out, styled=True) as stream:
            table = TableView(stream, on_terminal(out), columns, header)
            try:
                yield table
            except Exception:
                table.close()
                raise
            table.close()
        return
    with open_output(out) as stream:
        writer = WRITERS[format](stream, columns, header)
        try:
            yield writer
        except Exception:
            writer.cut()
            raise
        writer.close()


def default_format(format: Format | None, out: str | None) -> Format:
    """The format asked for; else a table on a terminal and CSV elsewhere."""
    if format is not None:
        return format
    return "table" if out is None and on_terminal(out) else "csv"


class TableView:
    """Rows as rich tables; shows numbers to 6 digits, for people."""

    def __init__(
        self,
        stream: BinaryIO,
        on_terminal: bool,
        columns: Sequence[str],
        header: Sequence[str] = (),
    ) -> None:
        self._stream, self._on_terminal = stream, on_terminal
        self._names = [*header, *(name for name in columns if name not in header)]
        self._places = [self._names.index(name) for name in columns]
        self._rows: list[list[str]] = []
        self._tables = 0

    def write_row(self, values: Sequence[float | str]) -> None:
        self._rows.append([x if isinstance(x, str) else f"{x:.6g}" for x in values])
        self._full()

    def write_columns(self, values: NDArray[np.float64]) -> None:
        for row in values.tolist():
            self.write_row(row)

    def write_rows(self, lines: Sequence[str], values: NDArray[np.float64]) -> None:
        import csv

        for fields, computed in zip(csv.reader(lines), values.tolist(), strict=True):
            row = [_short(field) for field in fields]
            row += [""] * (len(self._names) - len(row))
            for place, value in zip(self._places, computed, strict=True):
                row[place] = f"{value:.6g}"
            self._rows.append(row)
            self._full()

    def close(self) -> None:
        """Write the rows that wait, or the empty table that there is."""
        if self._rows or not self._tables:
            table = Grid([with_unit(name) for name in self._names], self._rows)
            self._stream.write(render([table], self._on_terminal).encode())
            self._stream.flush()
            self._rows, self._tables = [], self._tables + 1

    def _full(self) -> None:
        if len(self._rows) >= PAGE:
            self.close()


class Grid(NamedTuple):
    """A table for people: numbers to the right; every text stands as it is, brackets too."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""


def write_structure(
    out: str | None, content: Mapping[str, object], tables: Sequence[Grid] | None
) -> None:
    """Write a result with parts: its `tables` where there are any, else `content` as JSON."""
    with open_output(out, styled=tables is not None) as stream:
        if tables is None:
            stream.write(_json(content).encode())
        else:
            stream.write(render(tables, on_terminal(out)).encode())


def wants_tables(format: StructuredFormat | None, out: str | None) -> bool:
    """Whether a structured result is to be written as tables."""
    if format is None:
        return out is None and on_terminal(out)
    return format == "table"


def matrix_table(title: str, matrix: Sequence[Sequence[float]], unit: str = "") -> Grid:
    """A matrix, or a vector as one row, as a table."""
    width = len(matrix[0]) if matrix else 0
    rows = [[f"{value:.6g}" for value in row] for row in matrix]
    title = f"{title} [{unit}]" if unit else title
    return Grid([str(k + 1) for k in range(width)], rows, title)


def render(tables: Sequence[Grid], terminal: bool) -> str:
    """Tables as text; for a terminal with styles, and with what it would obey written out."""
    from rich.console import Console
    from rich.text import Text

    fit: Callable[[str], str] = printable if terminal else str
    console = Console(
        width=10_000,  # a terminal breaks a line that is too long; a table would hide digits
        no_color=not terminal,
        force_terminal=terminal,
    )
    with console.capture() as capture:
        for table in tables:
            if table.title:
                console.print(Text(fit(table.title), style="bold"))
            console.print(_rich_table(table, fit))
    return "\n".join(line.rstrip() for line in capture.get().splitlines()) + "\n"


def _rich_table(grid: Grid, fit: Callable[[str], str]) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, show_header=any(grid.columns))
    for k, name in enumerate(grid.columns):
        numeric = all(finite(row[k]) is not None for row in grid.rows)
        table.add_column(Text(fit(name)), justify="right" if numeric else "left", no_wrap=True)
    for row in grid.rows:
        table.add_row(*(Text(fit(text)) for text in row))
    return table


def note(text: str) -> None:
    """A remark for the person at the terminal: stderr."""
    print(printable_lines(text), file=sys.stderr)


def numbers_overflow_in_silence() -> None:
    """Leave numpy's warnings unshown: a result that is not finite is told by an error."""
    warnings.filterwarnings("ignore", ".* encountered in ", RuntimeWarning)


def _short(field: str) -> str:
    return f"{float(field):.6g}" if finite(field) is not None else field


def _json(content: Mapping[str, object]) -> str:
    """One key a line, matrices in one line each."""
    lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"
