"""Single fields of a CSV row: splitting, quoting, reading numbers, showing text in errors.

Tables with other delimiters are read as if they had commas.  With semicolons a number may have a
decimal comma, as spreadsheets of many languages write it.  In quotes everything stands as it is,
but for such a number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import BinaryIO

from robodyn.errors import nearest_first, printable

IN_DEGREES = "_deg"  # ends the names of columns of angles in degrees
DELIMITERS = {";": ";", "tab": "\t", ",": ","}
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
    """A binary stream of rows with commas, of one whose fields end at `delimiter` (; or a tab)."""

    def __init__(self, stream: BinaryIO, delimiter: str) -> None:
        self._read: Callable[[int], bytes] = getattr(stream, "read1", stream.read)
        self._mark = delimiter.encode()
        self._numbers = _NUMBERS if delimiter == ";" else b""
        fields = rb'"(?:[^"]|"")*"|[^%b\r\n"]*,[^%b\r\n"]*|%b'
        self._fields = re.compile(fields % (self._mark, self._mark, self._mark))
        self._pending = b""
        self._at_header = True

    def read1(self, size: int = READ_BYTES) -> bytes:
        """What has arrived, in whole rows; empty at the end."""
        while data := self._read(size):
            self._pending += data
            if b"\n" not in data and len(self._pending) <= LONGEST_ROW:
                continue
            whole = self._pending.rfind(b"\n") + 1
            if self._pending.count(b'"', 0, whole) % 2 and len(self._pending) <= LONGEST_ROW:
                continue  # of a quoted field that goes on
            whole = whole or len(self._pending)
            block, self._pending = self._pending[:whole], self._pending[whole:]
            return self._with_commas(block)
        block, self._pending = self._pending, b""
        return self._with_commas(block)

    read = read1

    def _with_commas(self, block: bytes) -> bytes:
        head, end, rest = block.partition(b"\n")
        if self._at_header and head.count(b'"') % 2 == 0:
            self._at_header = False
            return self._fields.sub(self._field, head + end) + self._with_commas(rest)
        if self._numbers and not block.translate(None, self._numbers):
            return block.translate(bytes.maketrans(b",;", b".,"))
        return self._fields.sub(self._field, block)

    def _field(self, match: re.Match[bytes]) -> bytes:
        text = match[0]
        if text == self._mark:
            return b","
        number = _DECIMAL.fullmatch(text) if self._numbers else None
        if number:
            return number[2] + b"." + number[3]
        return text if text.startswith(b'"') else b'"' + text + b'"'


def columns_told(header: Sequence[str], wanted: str = "") -> str:
    """The columns that there are, in a long list those like the one wanted first.

    And the likely delimiter, where it seems to be another one.
    """
    text = ", ".join(header)
    if len(text) > LONGEST_SHOWN:
        text = ", ".join(nearest_first(wanted, header))
    return shown(text) + delimiter_hint(header)


def delimiter_hint(header: Sequence[str]) -> str:
    """What to do where a header seems to have another delimiter than it was read with."""
    for name, mark in DELIMITERS.items():
        if any(mark in column for column in header):
            advice = "leave --delimiter out" if mark == "," else f"give --delimiter {name!r}"
            return f"; its fields seem to end at {name!r}: {advice}"
    return ""
