"""Single fields of a CSV row: splitting, quoting, reading numbers, showing text in errors."""

from __future__ import annotations

import math
import re

from robodyn.errors import printable

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
