"""Results to stdout or a file: as a rich table on a terminal, as CSV or JSON elsewhere."""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, NamedTuple

from robodyn.cli.options import Columns, Format, Out, OutputFormat
from robodyn.dynamics.columns import TURNING, declared, in_degrees, structure_in_degrees, with_unit
from robodyn.errors import InputError, printable, printable_lines
from robodyn.scene.yaml_values import nearest
from robodyn.tables.csv_fields import finite, shown, unquoted
from robodyn.tables.output_file import on_terminal, open_output
from robodyn.tables.table_writer import WRITERS, ScaledWriter, Writer

if TYPE_CHECKING:
    from robodyn.tables.arrays import Array

MakeWriter = Callable[..., Writer]
Summary = Callable[[MakeWriter, Sequence[str], Sequence[str]], Writer]
degrees: ContextVar[bool] = ContextVar("degrees", default=False)  # whether angles are told so
PAGE = 200  # rows of one table on the terminal; a longer result goes on in another
LEAST = 30  # characters of a sentence in a table, however narrow the terminal


def opened(name: str | None, kept: str, format: Format = "csv") -> AbstractContextManager[Any]:
    """The stream of an output that is named; a note, `kept`, names what a run that fails leaves."""
    if name is None:
        return nullcontext()
    return open_output(name, lambda partial: note(f"{kept} {partial}"), format == "table")


@contextmanager
def row_writer(
    format: Format | None,
    out: str | None,
    columns: Sequence[str],
    header: Sequence[str] = (),
    units: Mapping[str, str] = TURNING,
    summary: Summary | None = None,
    only: Sequence[str] | None = None,
) -> Iterator[Writer]:
    """A writer of rows: computed `columns` after (or in) the columns of the input's `header`.

    A table for people tells `units` of the scene (`columns.scene_units`).  A `summary` takes
    the place of the rows; `only` names the columns that are written, in their order.
    """
    format = default_format(format, out)
    with open_output(out, styled=format == "table") as stream:
        writer = told(maker(stream, format, out, units), columns, header, units, summary, only)
        try:
            yield writer
        except Exception:
            writer.cut()
            raise
        writer.close()


def maker(
    stream: BinaryIO, format: Format, out: str | None, units: Mapping[str, str] = TURNING
) -> MakeWriter:
    """Return a function that makes a writer from columns and an input's header."""

    def make(
        columns: Sequence[str], header: Sequence[str] = (), only: Sequence[str] | None = None
    ) -> Writer:
        writer = {**WRITERS, "table": TableView}[format](stream, columns, header, only)
        if isinstance(writer, TableView):
            writer.on_terminal, writer.units = on_terminal(out), units
        return writer

    return make


@dataclass(eq=False, repr=False)
class RowOptions:
    """Options for the output of rows."""

    columns: Columns = None
    format: OutputFormat = None
    out: Out = None

    def writer(
        self,
        columns: Sequence[str],
        header: Sequence[str] = (),
        units: Mapping[str, str] = TURNING,
        summary: Summary | None = None,
        only: Sequence[str] | None = None,
    ) -> AbstractContextManager[Writer]:
        """A writer of rows, or of a `summary` in their place: see `row_writer`.

        Where `only` is None, --columns chooses among these columns and those of the header.
        """
        if only is None and self.columns is not None:
            only = chosen_names(self.columns, [*header, *columns])
        return row_writer(self.format, self.out, columns, header, units, summary, only)


def chosen_names(text: str, among: Sequence[str]) -> list[str]:
    """The names of --columns, each among those that there are; InputError for another.

    The name of a family stands for those of its columns that are there.
    """
    chosen: list[str] = []
    for name in names_in(text):
        of_family = [x for x in among if (known := declared(x)) and known[0].name == name]
        if name not in among and not of_family:
            limit = f"is no column here{nearest(name, [*among])}"
            raise InputError("--columns", value=shown(name), limit=limit)
        chosen += [name] if name in among else of_family
    return list(dict.fromkeys(chosen))


def names_in(text: str, flag: str = "--columns") -> list[str]:
    """The names that an option has, each once; InputError if one is empty."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        limit = "needs names with commas between them, such as q1,tau1"
        raise InputError(flag, value=shown(text) or "''", limit=limit)
    return list(dict.fromkeys(names))


def told(
    make: MakeWriter,
    columns: Sequence[str],
    header: Sequence[str] = (),
    units: Mapping[str, str] = TURNING,
    summary: Summary | None = None,
    only: Sequence[str] | None = None,
) -> Writer:
    """A writer, or of a `summary`; with --degrees of angles in degrees, by the scene's units.

    `only` names the columns that are written.

    Raises InputError if the header has an angle both in radians and in degrees.
    """
    make = make if summary is None else functools.partial(summary, make)
    chosen: dict[str, Any] = {} if only is None else {"only": only}
    if not degrees.get():
        return make(columns, header, **chosen)
    there = set(header)
    for name in header:
        if (other := in_degrees(name, units)[0]) != name and other in there:
            limit = f"the table has {shown(other)} beside it: leave one of them out"
            raise InputError("--degrees", value=shown(name), limit=limit)
    return ScaledWriter(make, lambda name: in_degrees(name, units), columns, header, only)


def default_format(format: Format | None, out: str | None) -> Format:
    """The format asked for; else a table on a terminal and CSV elsewhere."""
    if format is not None:
        return format
    return "table" if out is None and on_terminal(out) else "csv"


class TableView(Writer):
    """Rows as rich tables; shows numbers to 6 digits, for people."""

    converts = True
    on_terminal = False
    units = TURNING

    def _begin(self) -> None:
        self._rows: list[Sequence[str]] = []
        self._tables = 0

    def close(self) -> None:
        """Write the rows that wait, or the empty table that there is."""
        if self._rows or not self._tables:
            table = Grid(list(map(self.title, self._header)), self._rows)
            self._write(render([table], self.on_terminal))
            self._rows, self._tables = [], self._tables + 1

    cut = close

    def title(self, name: str) -> str:
        return with_unit(name, self.units)

    def _texts(self, values: Array) -> Iterable[Sequence[str]]:
        return [[f"{x:.6g}" for x in row] for row in values.tolist()]

    def _text(self, value: float | str | None) -> str:
        if value is None:
            return ""
        return value if isinstance(value, str) else f"{value:.6g}"

    def _field(self, field: str) -> str:
        value = finite(text := unquoted(field))
        return text if value is None else f"{value:.6g}"

    def _write_rows(self, rows: Iterable[Sequence[str]]) -> None:
        for row in rows:
            self._rows.append(row)
            if len(self._rows) >= PAGE:
                self.close()


class Grid(NamedTuple):
    """A table for people: numbers to the right; every text stands as it is, brackets too."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str | float]]
    title: str = ""


def write_structure(
    format: Format | None,
    out: str | None,
    content: Mapping[str, object],
    tables: Callable[[], Sequence[Grid]],
) -> None:
    """Write a result with parts: as tables where they are wanted, else its `content` as JSON.

    Raises InputError for CSV.
    """
    if format == "csv":
        limit = "must be table or json: the result has parts, and no rows"
        raise InputError("--format", value=format, limit=limit)
    as_tables = default_format(format, out) == "table"
    with open_output(out, styled=as_tables) as stream:
        if as_tables:
            text = render(tables(), on_terminal(out))
        else:  # one key a line, matrices in one line each
            import json

            lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in content.items()]
            text = "{\n" + ",\n".join(lines) + "\n}\n"
        stream.write(text.encode())


def in_told_units(content: Mapping[str, Any], units: Mapping[str, str]) -> Mapping[str, Any]:
    """A result with parts, with --degrees its angles in degrees, under keys such as `q_deg`."""
    return structure_in_degrees(content, units) if degrees.get() else content


def render(tables: Sequence[Grid], terminal: bool) -> str:
    """Tables as text; for a terminal with styles, and with what it would obey written out."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    fit: Callable[[str], str] = printable if terminal else str
    # a terminal breaks a line that is too long; a table would hide digits
    console = Console(width=10_000, no_color=not terminal, force_terminal=terminal)
    with console.capture() as capture:
        for columns, rows, title in tables:
            if title:
                console.print(Text(fit(title), style="bold"))
            texts = [[x if isinstance(x, str) else f"{x:.6g}" for x in row] for row in rows]
            table = Table(box=box.SIMPLE_HEAD, show_header=any(columns))
            left = Console().width - 3 if terminal else console.width
            for k, name in enumerate(columns):
                numeric = all(finite(row[k]) is not None for row in texts)
                justify: Literal["right", "left"] = "right" if numeric else "left"
                last = k == len(columns) - 1 and not numeric  # sentences break between their words
                shape = {"max_width": max(left, LEAST)} if last else {"no_wrap": True}
                table.add_column(Text(fit(name)), justify=justify, **shape)
                left -= 3 + max(len(row[k]) for row in [columns, *texts])
            for row in texts:
                table.add_row(*(Text(fit(text)) for text in row))
            console.print(table)
    return "\n".join(line.rstrip() for line in capture.get().splitlines()) + "\n"


def note(text: str) -> None:
    """A remark for the person at the terminal: stderr."""
    print(printable_lines(text), file=sys.stderr)


def numbers_overflow_in_silence() -> None:
    """Leave numpy's warnings unshown: a result that is not finite is told by an error."""
    warnings.filterwarnings("ignore", ".* encountered in ", RuntimeWarning)
