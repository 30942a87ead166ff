"""CSV read for batch commands, streamed.

A batch command takes numbers from some columns of a table and writes each row as it came,
with its own columns appended:

    reader = Reader(sys.stdin.buffer, "stdin")
    chunks = reader.chunks(["q1", "q2"])
    with open_output("-") as stream:
        writer = Writer(stream, ["tau1", "tau2"], reader.header)
        for chunk in chunks:
            writer.write_rows(chunk.lines, torques(chunk.values))
        writer.close()

Rows go out as rows come in, memory holds one chunk however long the file is, and fields that
nobody needs as numbers pass through byte for byte.  Numbers are read as `float` reads them
(less its underscores, nan and inf) and written as `repr` writes them, so they round-trip.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import BinaryIO, NamedTuple

import numpy as np

from robodyn.errors import InputError
from robodyn.tables import numbers
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import (
    IN_DEGREES,
    LONGEST_ROW,
    READ_BYTES,
    columns_told,
    ends_open,
    finite,
    is_missing,
    shown,
    split_fields,
    unquoted,
)


class Chunk(NamedTuple):
    """Some successive rows of a table: n lines as they came, k of their columns as numbers."""

    lines: list[str]  # (n,) without line ends
    line_numbers: Sequence[int]  # (n,) where each row begins in the file, whose header is line 1
    values: Array  # (n, k)


class _Rows(NamedTuple):
    """Rows as they arrive, whole but not checked."""

    lines: list[str]
    numbers: Sequence[int]
    quoted: bool  # whether any has a quote, so that not every comma ends a field


class Reader:
    """A CSV table (RFC 4180, UTF-8) read from a binary stream; `source` names it in errors.

    The header is read at once: `header` holds the names, less the spaces around them.  In
    `names` a column q1_deg is q1, and is read as that, unless there is another q1, or q1 is among
    the `lengths`, which are no angles.  With `gaps` an empty field, or nan, is read as nan.
    `renamed` has the names that columns get, by the names that they have.  Raises InputError where
    the input is empty, a name occurs twice, or one that is `renamed` does not occur.
    """

    def __init__(
        self,
        stream: BinaryIO,
        source: str,
        lengths: Container[str] = (),
        gaps: bool = False,
        renamed: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.source, self.gaps = source, gaps
        arrivals = self._arrivals(stream)
        lines, numbers, quoted = next(arrivals, _Rows([], [], False))
        if not lines:
            limit = "it must begin with a line of column names, such as t,q1,q2"
            raise InputError("the input is empty", where=source, limit=limit)
        names = self._split(lines[0], numbers[0])
        header = [unquoted(name).strip() for name in names]
        if (lost := next((name for name in renamed if name not in header), None)) is not None:
            limit = f"is no column; there are {columns_told(header, lost)}"
            raise InputError("read", where=source, value=shown(lost), limit=limit)
        self.header = tuple(renamed.get(name, name) for name in header)
        self._place = {name: place for place, name in enumerate(self.header)}
        for place, name in enumerate(self.header):
            if self._place[name] != place:
                limit = "the name occurs twice in the header"
                raise self._fault(numbers[0], "column", shown(name) or "''", limit)
        turned = {name: name.removesuffix(IN_DEGREES) for name in self.header}
        angles = {name: x for name, x in turned.items() if x != name and x not in lengths}
        self._twice = {x: name for name, x in angles.items() if x in self._place}
        own = {name: x for name, x in angles.items() if x not in self._twice}
        self.names = tuple(own.get(name, name) for name in self.header)
        self._place |= {name: place for place, name in enumerate(self.names)}
        self._rows = chain([_Rows(lines[1:], numbers[1:], quoted)], arrivals)

    def chunks(self, names: Sequence[str]) -> Iterator[Chunk]:
        """The rows that are left, the columns `names` as numbers, each as soon as it arrives.

        Raises InputError at once if a column is missing, with those that are there, or if it is
        there twice, as q1 and q1_deg.  The rows before a faulty one (not UTF-8, bad quoting, a
        wrong number of fields, a named column that is not a finite number) come first; the next
        step raises InputError with its line, column and text.
        """
        missing = [name for name in names if name not in self._place]
        if missing:
            what = f"column {shown(', '.join(missing))} is missing"
            limit = f"the header has {columns_told(self.header, missing[0])}"
            raise InputError(what, where=self.source, limit=limit)
        if twice := next((name for name in names if name in self._twice), None):
            limit = f"is there again as {shown(self._twice[twice])}: leave one of them out"
            raise InputError(f"column {shown(twice)}", where=self.source, limit=limit)
        return self._checked(names, [self._place[name] for name in names])

    def _checked(self, names: Sequence[str], places: list[int]) -> Iterator[Chunk]:
        turned = [k for k, x in enumerate(places) if self.header[x] != names[k]]
        for rows in self._rows:
            values, fault = None, None
            if places and not rows.quoted:
                values = numbers.read(rows.lines, len(self.header), places)
            if values is None:  # there is more to them, or a fault
                values, fault = self._parsed(rows, [self.header[x] for x in places], places)
            if turned:
                values[:, turned] *= math.pi / 180.0
            if n := len(values):
                yield Chunk(rows.lines[:n], rows.numbers[:n], values)
            if fault:
                raise fault

    def _parsed(
        self, rows: _Rows, names: Sequence[str], places: list[int]
    ) -> tuple[Array, InputError | None]:
        """The values (n, k) of the rows before the first faulty one, and its fault."""
        values: list[list[float | None]] = []
        fault = None
        try:
            for line, number in zip(rows.lines, rows.numbers, strict=True):
                fields = self._split(line, number)
                if len(fields) != len(self.header):
                    limit = f"the header has {len(self.header)}"
                    raise self._fault(number, "number of fields", len(fields), limit)
                texts = [unquoted(fields[place]) for place in places]
                found = [math.nan if self.gaps and is_missing(x) else finite(x) for x in texts]
                for name, text, value in zip(names, texts, found, strict=True):
                    if value is None:
                        empty = not text.strip()
                        limit = "the field is empty, not" if empty else "must be"
                        told = None if empty else shown(text)
                        limit += " a finite number"
                        raise self._fault(number, name, told, limit)
                values.append(found)
        except InputError as error:
            fault = error
        return np.array(values, dtype=float).reshape(len(values), len(places)), fault

    def _split(self, line: str, line_number: int) -> list[str]:
        fields = split_fields(line)
        if ",".join(fields) != line:
            limit = "a closing quote must end its field"
            raise self._fault(line_number, "bad quoting", None, limit)
        return fields

    def _fault(self, line_number: int, what: str, value: object, limit: str) -> InputError:
        where = f"{self.source}: line {line_number}"
        return InputError(what, where=where, value=value, limit=limit)

    def _arrivals(self, stream: BinaryIO) -> Iterator[_Rows]:
        """The rows, header included, as reads complete them; raises after the last good one."""
        # read would wait until it has all that it was asked for; read1 takes what is there.
        read: Callable[[int], bytes] = getattr(stream, "read1", stream.read)
        pending = bytearray()  # of a line whose end has not come
        number = 1  # the line of the file that `pending` begins with
        row: list[str] = []  # the lines so far of a row in which a quoted field is open
        begin = size = 0  # the line of the file on which it begins, and its bytes
        at_end = False
        while not at_end:
            data = read(READ_BYTES)
            at_end = not data
            if at_end and pending:
                data = b"\n"  # the last line may lack its end
            pending += data
            if b"\n" in data:
                block = bytes(pending[: pending.rfind(b"\n") + 1])
                del pending[: len(block)]
                text, fault = self._decode(block, number)
                quoted = bool(row) or '"' in text
                if "\r" in text and not quoted:
                    text = text.replace("\r\n", "\n")
                lines = text.split("\n")[:-1]
                numbers: Sequence[int] = range(number, number + len(lines))
                if quoted:
                    pieces, lines, numbers = lines, [], []
                    for at, piece in enumerate(pieces, number):
                        begin, size = (begin, size) if row else (at, 0)
                        still_open = ends_open(piece, bool(row))
                        row.append(piece)
                        size += len(piece.encode()) + 1
                        if not still_open:
                            lines.append("\n".join(row).removesuffix("\r"))
                            numbers.append(begin)
                            row = []
                if not all(map(str.strip, lines)):
                    numbers = [n for n, line in zip(numbers, lines, strict=True) if line.strip()]
                    lines = [line for line in lines if line.strip()]
                if lines:
                    yield _Rows(lines, numbers, quoted)
                if fault:
                    raise fault
                number += block.count(b"\n")
            if (size if row else 0) + len(pending) > LONGEST_ROW or (at_end and row):
                limit = f"a row ends within {LONGEST_ROW} bytes; is a quote left open?"
                raise self._fault(begin if row else number, "the row does not end", None, limit)

    def _decode(self, block: bytes, number: int) -> tuple[str, InputError | None]:
        """The text of whole lines, up to the first that is not UTF-8, and the fault of that."""
        try:
            return block.decode("utf-8-sig" if number == 1 else "utf-8"), None
        except UnicodeDecodeError as error:
            good = error.object[: error.object.rfind(b"\n", 0, error.start) + 1]
            value = f"0x{error.object[error.start]:02x}"
            fault = self._fault(number + good.count(b"\n"), "byte", value, "text must be UTF-8")
            return good.decode(), fault
