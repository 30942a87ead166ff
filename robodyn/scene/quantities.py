"""Values as people write them, everywhere in one grammar: arithmetic with units.

`1e-3`, `30deg`, `30 °`, `-pi/2+0.6`, `sqrt(2)/2`, `350 mm`, `1/12`, `9.81 m/s^2`, `60rpm`; a
blank between a number and a unit is a product.  A number without a unit is in that of its place.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import lru_cache

from robodyn.errors import InputError
from robodyn.scene.syntax import FUNCTIONS, PLAIN_NUMBER, plain_text, tokens_of
from robodyn.scene.unit_arithmetic import CONSTANTS, Value, finite, read_value
from robodyn.scene.units import PLAIN, UNITS, Dimension, fits, shown_dimension
from robodyn.tables.csv_fields import shown

# of values, by the unit of their place
EXAMPLES = {
    "": "1.5 or -2e-3",
    "rad": "-0.5, 30deg or pi/2",
    "rad/s": "6.28, 60rpm or 90deg/s",
    "rad/s²": "20 or 90deg/s^2",
    "m": "0.25 or 250mm",
    "s": "2, 0.5s or 20ms",
    "Hz": "100 or 100Hz",
}


def parse_quantity(text: str, unit: str = "") -> float:
    """The finite number that `text` writes, in the unit of its place; ValueError with the reason.

    `unit` is such as `kg m²` or `N m s/rad`; of plain numbers, which may have none, it is empty.
    """
    if PLAIN_NUMBER.fullmatch(text):
        return finite(float(text))
    return in_unit(read_value(text), unit)


def value_from(text: str, unit: str, option: str, example: str = "") -> float:
    """The number that an option's text writes; InputError, naming the option, if it is none."""
    try:
        return parse_quantity(text.strip(), unit)
    except ValueError as error:
        limit = f"{error}; write {example or EXAMPLES.get(unit) or EXAMPLES['']}"
        raise InputError(option, value=shown(text), limit=limit) from None


def is_plain(text: str) -> bool:
    """Whether it is a number without arithmetic and unit."""
    return PLAIN_NUMBER.fullmatch(text) is not None


def in_unit(value: Value, unit: str) -> float:
    """A value in the unit of its place; ValueError if it has another dimension."""
    if value.joints:
        raise ValueError("is not a number: it has a joint")
    place = dimension_of(unit)
    if not fits(value.of, place):
        wanted = f"in {unit}" if unit else "a plain number"
        raise ValueError(f"must be {wanted}, not in {shown_dimension(value.of)}")
    return finite(value.total)


@lru_cache
def dimension_of(unit: str) -> Dimension:
    """The dimension of a unit in words."""
    return read_value(unit).of if unit else PLAIN


def parse_coupling(text: str) -> tuple[int, Value]:
    """`q3 = -2 q1 + 0.1` as 3 and -2 q1 + 0.1; ValueError with the reason if it is no equation."""
    left, equals, right = text.partition("=")
    match = re.fullmatch(r"\s*q(\d{1,18})\s*", left, re.ASCII)
    if match is None or not equals or "=" in right:
        raise ValueError("must be an equation such as q3 = -2 q1 + 0.1")
    try:
        return int(match[1]), read_value(right, joints=True)
    except ValueError as error:
        raise ValueError(f"must be such as q3 = -2 q1 + 0.1: {right.strip()} {error}") from None


def parse_vector(
    text: str,
    *,
    where: str,
    unit: str | Callable[[int], Sequence[str]] = "",
    example: str = "",
) -> list[float]:
    """The numbers of a comma- or space-separated vector; InputError naming `where` if none.

    `unit`: that of all entries, or what tells those of so many.
    """
    parts = entries(plain_text(text), where, example or EXAMPLES[""])
    units = [unit] * len(parts) if isinstance(unit, str) else unit(len(parts))
    values = []
    for k, (entry, own) in enumerate(zip(parts, units, strict=True), start=1):
        try:
            values.append(parse_quantity(entry, own))
        except ValueError as error:
            limit = f"{error}; write {example or EXAMPLES.get(own) or EXAMPLES['']}"
            raise InputError(f"entry {k}", where=where, value=shown(entry), limit=limit) from None
    return values


def entries(text: str, where: str, example: str) -> list[str]:
    """What stands between commas, or between blanks that cannot be within one value."""
    found: list[str] = []
    parts = _at_commas(text)
    for part in parts:
        if not part.strip():
            if len(parts) == 1:
                raise InputError("the vector is empty", where=where, limit=f"write {example}")
            limit = "an entry is missing at a comma"
            raise InputError(repr(shown(text)), where=where, limit=limit)
        words = part.split()
        if len(words) == 1 or all(map(PLAIN_NUMBER.fullmatch, words)):
            found += words
            continue
        try:
            found += _at_blanks(part)
        except ValueError as error:
            entry, value = f"entry {len(found) + 1}", shown(part.strip())
            raise InputError(entry, where=where, value=value, limit=str(error)) from None
    return found


def _at_commas(text: str) -> list[str]:
    parts, begin, depth = [], 0, 0
    for k, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if letter == "," and depth <= 0:
            parts.append(text[begin:k])
            begin = k + 1
    return [*parts, text[begin:]]


def _at_blanks(part: str) -> list[str]:
    """The values of a part without commas: a new one begins where none can go on."""
    tokens, begins, depth = tokens_of(part), [0], 0
    for before, token, after in zip(tokens, tokens[1:], [*tokens[2:], None], strict=False):
        depth += (before.text == "(") - (before.text == ")")
        ended = before.kind != "sign" or before.text == ")"
        if depth or not token.apart or not ended:
            continue
        sign = token.text in ("+", "-") and after is not None and not after.apart
        name = token.kind == "name" and token.text not in UNITS
        if name and before.kind == "number" and token.text in (*CONSTANTS, *FUNCTIONS):
            both = f"{before.text}*{token.text} or {before.text},{token.text}"
            raise ValueError(f"is one value or two: write {both}")
        opens = token.text == "(" and before.text not in FUNCTIONS
        if token.kind == "number" or sign or name or opens:
            begins.append(token.at)
    return [part[a:b].strip() for a, b in zip(begins, [*begins[1:], len(part)], strict=True)]
