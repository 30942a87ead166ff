"""Single fields of a CSV row: splitting, quoting, reading numbers, showing text in errors.

Tables with other delimiters are read as if they had commas.  With semicolons and tabs a number may
have a decimal comma, as spreadsheets of many languages write it.  In quotes everything stands as it
is, but for such a number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import BinaryIO

from robodyn.errors import nearest_first, printable

IN_DEGREES = "_deg"  # ends the names of columns of angles in degrees
LONGEST_SHOWN = 200  # characters of the input that an error repeats

# Patterns are compiled where they are first used: `re` keeps them, and most commands need none.
# A quoted field takes all that it can (*+): giving back half of a doubled quote would close it.
_TO_ITS_END = r'[^"]*+(?:""[^"]*+)*+"'
_FIELD = rf'(?:^|,)("{_TO_ITS_END}|[^,]*)'
_START = rf'(?:"{_TO_ITS_END}|(?!"))'
_REST = rf"[^,]*+(?:,{_START}[^,]*+)*+\Z"
_WHOLE = _START + _REST, _TO_ITS_END + _REST


def split_fields(line: str) -> list[str]:
    """The fields of a row as they are written, quotes included."""
    return re.findall(_FIELD, line) if '"' in line else line.split(",")


def ends_open(line: str, inside: bool) -> bool:
    """Whether a quoted field is open where a line ends that began `inside` of one, or not."""
    return re.match(_WHOLE[inside], line) is None


def unquoted(field: str) -> str:
    return field[1:-1].replace('""', '"') if field[:1] == '"' else field


def quoted(name: str) -> str:
    plain = set(',"\r\n').isdisjoint(name)
    return name if plain else '"' + name.replace('"', '""') + '"'


def shown(text: str) -> str:
    """Text of the input as an error or a picture repeats it, fit for a terminal."""
    text = text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + "..."
    return printable(text)


def plain_digits(text: str) -> bool:
    """Whether a number in this text can be written with 0 to 9 alone, as everywhere in robodyn."""
    return "_" not in text and text.strip().isascii()


def finite(text: str) -> float | None:
    """The finite number that a field is, in ASCII, None where it is none."""
    try:
        value = float(text) if plain_digits(text) else math.nan
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def is_missing(text: str) -> bool:
    """Whether a field has no value: it is empty, or nan."""
    return text.strip().lower() in ("", "nan", "-nan")


READ_BYTES = 1 << 17  # asked of the stream at once; more is no faster
LONGEST_ROW = 1 << 20  # bytes: a longer one is refused, so that memory is bounded
_NUMBERS = b"0123456789+-.,;eE \r\n"
_DECIMAL = re.compile(rb'("?)(\s*[-+]?[0-9]*),([0-9]*(?:[eE][-+]?[0-9]+)?\s*)\1')


class Delimited:
    """A binary stream of rows with commas, of one whose fields end at commas, semicolons or tabs.

    Its header tells which: it has most of them outside of quotes.  Where they are semicolons or
    tabs, a comma in a number is a decimal comma.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._read: Callable[[int], bytes] = getattr(stream, "read1", stream.read)
        self._mark = b""  # unknown; commas pass as they are
        self._pending = b""
        self._at_header = True

    def read1(self, size: int = READ_BYTES) -> bytes:
        """Return arrived data in whole rows, unchanged if it has commas; b"" at the end."""
        if self._mark == b",":
            return self._read(size)
        while data := self._read(size):
            self._pending += data
            if b"\n" not in data and len(self._pending) <= LONGEST_ROW:
                continue
            whole = self._pending.rfind(b"\n") + 1
            if self._pending.count(b'"', 0, whole) % 2 and len(self._pending) <= LONGEST_ROW:
                continue  # of a quoted field that goes on
            whole = whole or len(self._pending)
            if self._ends_at() == b",":
                whole = len(self._pending)
            block, self._pending = self._pending[:whole], self._pending[whole:]
            return self._with_commas(block)
        block, self._pending = self._pending, b""
        return self._with_commas(block) if block and self._ends_at(block) != b"," else block

    def _ends_at(self, block: bytes = b"") -> bytes:
        """Return the delimiter, found in the header, the first line read."""
        if not self._mark:
            head = (block or self._pending).partition(b"\n")[0]
            plain = re.sub(rb'"[^"]*"?', b"", head)
            self._mark = max(b",", b";", b"\t", key=plain.count)
            fields = rb'"(?:[^"]|"")*"|[^%b\r\n"]*,[^%b\r\n"]*|%b'
            self._fields = re.compile(fields % (self._mark, self._mark, self._mark))
            self._numbers = _NUMBERS.replace(b";", self._mark)
        return self._mark

    read = read1

    def _with_commas(self, block: bytes) -> bytes:
        if self._mark == b",":
            return block
        head, end, rest = block.partition(b"\n")
        if self._at_header and head.count(b'"') % 2 == 0:
            self._at_header = False
            return self._fields.sub(self._field, head + end) + self._with_commas(rest)
        if not block.translate(None, self._numbers):
            return block.translate(bytes.maketrans(b"," + self._mark, b".,"))
        return self._fields.sub(self._field, block)

    def _field(self, match: re.Match[bytes]) -> bytes:
        text = match[0]
        if text == self._mark:
            return b","
        number = _DECIMAL.fullmatch(text)
        if number:
            return number[2] + b"." + number[3]
        return text if text.startswith(b'"') else b'"' + text + b'"'


def columns_told(header: Sequence[str], wanted: str = "") -> str:
    """The columns that there are, in a long list those like the one wanted first."""
    text = ", ".join(header)
    if len(text) > LONGEST_SHOWN:
        text = ", ".join(nearest_first(wanted, header))
    return shown(text)
