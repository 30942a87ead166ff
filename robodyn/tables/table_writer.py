"""Tables written as CSV or JSON, row by row, with computed columns after those of an input.

See `table.py` for the use of both.  Floats are written as `repr` writes them, so they round-trip.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from robodyn.tables.csv_fields import finite, quoted, split_fields, unquoted
from robodyn.tables.numbers import written

if TYPE_CHECKING:
    from robodyn.tables.arrays import Array

HELD = 1 << 21  # bytes; more than what is read or written at once takes in any one piece
Told = Callable[[str], tuple[str, float]]  # of a column: its name there, and what its values are


class Writer:
    """A table written to a binary stream as CSV, flushed after every call.

    Made from the stream, the names of k computed columns, and the header of the input where
    there is one.  A computed column that the input has already is replaced in its place; the
    others follow the input's columns.  `only` names those that are written, in their order, in
    place of all.  LF line ends; the input's text stays as it is.
    """

    converts = False  # whether the input's fields are written in another way than they came
    needs_rows = False  # whether it makes nothing of a table without rows

    def __init__(
        self,
        stream: BinaryIO,
        columns: Sequence[str],
        input_header: Sequence[str] = (),
        only: Sequence[str] | None = None,
    ) -> None:
        self._stream = stream
        bytes(HELD)  # once so much was freed, glibc keeps what is freed for the rows to come
        new = [name for name in columns if name not in input_header]
        every = [*input_header, *new]
        self._header = every if only is None else list(only)
        self._places = [every.index(name) for name in columns]
        self._order = None if only is None else [every.index(name) for name in only]
        self._own: list[int] | None = None  # of the computed columns, where these alone are written
        if self._order is not None and set(self._order) <= set(self._places):
            self._own = [self._places.index(place) for place in self._order]
        appends = not self.converts and self._order is None
        self._appends_only = appends and 0 < len(new) == len(columns)
        self._begin()

    def write_row(self, values: Sequence[float | str | None]) -> None:
        """Write one row of computed columns alone, (k,), without a need for numpy.

        None is an empty field.
        """
        if self._own is not None:
            values = [values[k] for k in self._own]
        self._write_rows([tuple(map(self._text, values))])

    def write_ended(self, values: Array, ends: Sequence[str]) -> None:
        """Write n rows of numbers (n, k - 1), empty where they are NaN, each with a text after."""
        rows = zip(self._repr(values), map(quoted, ends), strict=True)
        if self._own is None:
            self._write_rows(rows)
            return
        fields = [[*line.split(","), end] for line, end in rows]
        self._write_rows([[row[k] for k in self._own] for row in fields])

    def write_columns(self, values: Array) -> None:
        """Write n rows that are computed columns alone, (n, k)."""
        if self._own is not None:
            values = values[:, self._own]
        if self.converts:
            self._write_rows(self._texts(values))
        else:
            self._write_rows(zip(self._lines(values), strict=True))

    def write_rows(self, lines: Sequence[str], values: Array) -> None:
        """Write n rows of the input, each with its computed columns, (n, k), empty if NaN."""
        if self._own is not None:
            self.write_columns(values)
        elif self._appends_only:  # then nobody needs to know the line's fields
            self._write_rows(zip(lines, self._lines(values), strict=True))
        else:
            self._write_rows(self._merged(lines, self._texts(values)))

    def write_empty(self, line: str) -> None:
        """Write one row of the input, its computed columns empty."""
        self._write_rows(self._merged([line], [[self._text(None)] * len(self._places)]))

    def close(self) -> None:
        """End the table; the stream stays open."""
        self._stream.flush()

    def cut(self) -> None:
        """Leave the table where it is, at the end of a line, after an error."""
        self._stream.flush()

    def title(self, name: str) -> str:
        """Return the title of a column."""
        return name

    def _merged(
        self, lines: Sequence[str], texts: Iterable[Sequence[str]]
    ) -> Iterator[tuple[str, ...]]:
        for line, computed in zip(lines, texts, strict=True):
            fields = [self._field(field) for field in split_fields(line)]
            for place, text in zip(self._places, computed, strict=True):
                fields[place : place + 1] = [text]  # the new ones' places are past the end
            yield tuple(fields if self._order is None else [fields[k] for k in self._order])

    def _lines(self, values: Array) -> list[str]:
        """The computed values (n, k) as text, row by row, with commas between them."""
        width = len(self._places if self._own is None else self._own)
        if values.ndim != 2 or values.shape[1] != width:
            raise ValueError(f"values: shape (n, {width}), not {values.shape}")
        return self._repr(values)

    def _repr(self, values: Array) -> list[str]:
        """Return the values (n, k) as text, a row each, with nothing in place of NaN."""
        known = values == values
        if not known.all():
            lines = self._repr(np.where(known, values, 0.0))
            rows = np.flatnonzero(~known.all(axis=1))
            for k, each in zip(rows.tolist(), known[rows].tolist(), strict=True):
                fields = zip(lines[k].split(","), each, strict=True)
                lines[k] = ",".join([field if there else "" for field, there in fields])
            return lines
        return written(values)

    def _texts(self, values: Array) -> Iterable[Sequence[str]]:
        """Yield the fields of each row."""
        return [line.split(",") if self._places else () for line in self._lines(values)]

    def _text(self, value: float | str | None) -> str:
        """Return the text of a computed value."""
        if value is None:
            return ""
        # Not repr(value): that of a numpy float names its type.
        if isinstance(value, float):
            return float.__repr__(value)
        return self._field(quoted(str(value)))

    def _field(self, field: str) -> str:
        """Return the text of an input field."""
        return field

    def _begin(self) -> None:
        self._write_rows([tuple(map(quoted, self._header))])

    def _write_rows(self, rows: Iterable[Sequence[str]]) -> None:
        if text := "\n".join(map(",".join, rows)):
            self._write(text + "\n")

    def _write(self, text: str) -> None:
        self._stream.write(text.encode())
        self._stream.flush()


class JsonWriter(Writer):
    """A table as a JSON array, one object a line.

    A field of the input that reads as a finite number is one, any other is a string; a
    computed value that is not finite, or not there, is null.
    """

    converts = True

    def close(self) -> None:
        self._write("\n]\n" if self._separator else "]\n")

    def cut(self) -> None:
        if self._separator:
            self._write("\n")

    def _texts(self, values: Array) -> Iterable[Sequence[str]]:
        return [[_NULL.get(text, text) for text in row] for row in super()._texts(values)]

    def _text(self, value: float | str | None) -> str:
        text = super()._text(value)
        return _NULL.get(text, text)

    def _field(self, field: str) -> str:
        text = unquoted(field)
        value = finite(text)
        if value is None:
            return _quoted(text)
        return text if re.fullmatch(_JSON_NUMBER, text) else repr(value)

    def _begin(self) -> None:
        names = [_quoted(name).replace("%", "%%") for name in self._header]
        self._template = "{" + ", ".join(f"{name}: %s" for name in names) + "}"
        self._separator = ""
        self._write("[\n")

    def _write_rows(self, rows: Iterable[Sequence[str]]) -> None:
        if text := ",\n".join([self._template % tuple(row) for row in rows]):
            self._write(self._separator + text)
            self._separator = ",\n"


class ScaledWriter(Writer):
    """Hands rows on to the writer that `make` makes, each column as `told` says.

    Fields of the input are scaled too, where they are numbers and pass through.
    """

    def __init__(
        self,
        make: Callable[..., Writer],
        told: Told,
        columns: Sequence[str],
        input_header: Sequence[str] = (),
        only: Sequence[str] | None = None,
    ) -> None:
        own, passing = [told(name) for name in columns], [told(name) for name in input_header]
        self._factors = [factor for _, factor in own]
        self._places = [k for k, (_, factor) in enumerate(passing) if factor != 1.0]
        self._passing = [factor for _, factor in passing]
        names = [[name for name, _ in pairs] for pairs in (own, passing)]
        chosen = None if only is None else [told(name)[0] for name in only]
        self._writer = make(*names) if chosen is None else make(*names, only=chosen)
        self.needs_rows = self._writer.needs_rows

    def write_row(self, values: Sequence[float | str | None]) -> None:
        pairs = zip(values, self._factors, strict=True)
        self._writer.write_row([f * x if isinstance(x, float) else x for x, f in pairs])

    def write_ended(self, values: Array, ends: Sequence[str]) -> None:
        self._writer.write_ended(values * self._factors[:-1], ends)

    def write_columns(self, values: Array) -> None:
        self._writer.write_columns(values * self._factors)

    def write_rows(self, lines: Sequence[str], values: Array) -> None:
        if self._places:
            lines = list(map(self._scaled, lines))
        self._writer.write_rows(lines, values * self._factors)

    def write_empty(self, line: str) -> None:
        self._writer.write_empty(self._scaled(line))

    def _scaled(self, line: str) -> str:
        fields = split_fields(line)
        for k in self._places:
            if (value := finite(unquoted(fields[k]))) is not None:
                fields[k] = repr(self._passing[k] * value)
        return ",".join(fields)

    def close(self) -> None:
        self._writer.close()

    def cut(self) -> None:
        self._writer.cut()

    def title(self, name: str) -> str:
        return self._writer.title(name)


def _quoted(text: str) -> str:
    import json  # as few tables are

    return json.dumps(text, ensure_ascii=False)


_NULL = dict.fromkeys(("nan", "inf", "-inf", ""), "null")
_JSON_NUMBER = r"-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?"

WRITERS = {"csv": Writer, "json": JsonWriter}
