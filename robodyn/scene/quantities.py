"""Numbers as people write them: `1e-3`, `-0.5`, `30deg`, `pi/2`, `2*pi/3`, `1/3`."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from robodyn.errors import InputError
from robodyn.tables.csv_fields import shown

# Digits can be told in one way only: a pattern with two takes time by the square of their number.
_NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_PLAIN = re.compile(rf"[+-]?{_NUMBER}", re.ASCII)
ANGLE_PATTERN = (
    rf"(?P<sign>[+-]?)(?:(?P<number>{_NUMBER})?(?P<pi>\*?pi)|(?P<value>{_NUMBER}))"
    rf"(?:/(?P<divisor>{_NUMBER}))?(?P<unit>deg|rad)?"
)
_ANGLE = re.compile(ANGLE_PATTERN, re.ASCII)

_JOINT = re.compile(
    rf"(?P<sign>[+-]?)(?:(?P<ratio>{_NUMBER}(?:/{_NUMBER})?)\*?)?q(?P<joint>\d{{1,18}})", re.ASCII
)
_APART = re.compile(r"[\w.]\s+(?!q)[\w.]|q\d+\s+q")  # a blank within what is no product
_SIGNED = re.compile(r"(?<=[^eE])(?=[+-])")  # before every sign but that of an exponent


def parse_number(text: str) -> float:
    """The finite number that `text` writes; ValueError with the reason if it is none."""
    if _PLAIN.fullmatch(text) is None:
        if text.lstrip("+-.").lower() in ("nan", "inf", "infinity"):
            raise ValueError("must be a finite number")
        raise ValueError("is not a number")
    value = float(text)
    if math.isinf(value):
        raise ValueError("is too large for a number")
    return value


def parse_angle(text: str) -> float:
    """The angle (or angular rate) in radians that `text` writes; ValueError with the reason.

    `0.5`, `30deg`, `1.2rad`, `pi`, `-pi/4`, `2*pi/3`, `3pi/2`, `1/3`.
    """
    match = _ANGLE.fullmatch(text)
    if match is None or ((match["pi"] or "").startswith("*") and not match["number"]):
        parse_number(text)  # tells nan and inf from what is no number at all
        raise ValueError("is not an angle")
    value = parse_number(match["value"] or match["number"] or "1")
    if match["pi"]:
        if match["unit"] == "deg":
            raise ValueError("mixes pi with deg")
        value *= math.pi
    if match["divisor"]:
        divisor = parse_number(match["divisor"])
        if divisor == 0.0:
            raise ValueError("divides by zero")
        value /= divisor
    if match["unit"] == "deg":
        value = math.radians(value)
    if math.isinf(value):
        raise ValueError("is too large for a number")
    return -value if match["sign"] == "-" else value


def parse_coupling(text: str) -> tuple[int, dict[int, float], float]:
    """`q3 = -2 q1 + 0.1` as 3, {1: -2.0} and 0.1 (rad); ValueError with the reason if it is none.

    Ratios are numbers or fractions (`-20/37 q1`, `2*q1`, `-q1`), the constant an angle (`30deg`).
    """
    if _APART.search(text):
        raise ValueError("must be such as q3 = -2 q1 + 0.1: a sign is missing between terms")
    sides = "".join(text.split()).split("=")
    left = _JOINT.fullmatch(sides[0])
    if len(sides) != 2 or left is None or left["ratio"] or left["sign"]:
        raise ValueError("must be an equation such as q3 = -2 q1 + 0.1")
    terms: dict[int, float] = {}
    angle = 0.0
    for part in _SIGNED.split(sides[1]):
        joint = _JOINT.fullmatch(part)
        if joint is None:
            try:
                angle += parse_angle(part)
            except ValueError as error:
                missing = part in ("", "+", "-")
                reason = "a term is missing" if missing else f"{part} {error}"
                raise ValueError(f"must be such as q3 = -2 q1 + 0.1: {reason}") from None
            continue
        ratio, number = 1.0, int(joint["joint"])
        if joint["ratio"]:
            above, _, below = joint["ratio"].partition("/")
            divisor = parse_number(below or "1")
            if divisor == 0.0:
                raise ValueError(f"must be such as q3 = -2 q1 + 0.1: {part} divides by zero")
            ratio = parse_number(above) / divisor
        terms[number] = terms.get(number, 0.0) + (-ratio if joint["sign"] == "-" else ratio)
    return int(left["joint"]), terms, angle


def parse_rate(text: str) -> float:
    """The rate in rad/s that `text` writes; ValueError with the reason.

    `6.28`, `2*pi`, `360deg/s`, `360deg`, `6.28rad/s`, `60rpm`.
    """
    if text.endswith("rpm"):
        return parse_number(text.removesuffix("rpm")) * (math.pi / 30)
    return parse_angle(text.removesuffix("/s"))


def parse_time(text: str) -> float:
    """The time in seconds that `text` writes, `2`, `0.5s`, `20ms`; ValueError with the reason."""
    if text.endswith("ms"):
        return parse_number(text.removesuffix("ms")) / 1000
    return parse_number(text.removesuffix("s"))


def parse_vector(text: str, *, where: str, angles: bool) -> list[float]:
    """The numbers of a comma- or space-separated vector; InputError naming `where` if none."""
    if angles:
        return parse_entries(text, parse_angle, where=where, example="-0.5, 30deg or pi/2")
    return parse_entries(text, parse_number, where=where, example="1.5 or -2e-3")


def parse_entries(
    text: str, parse: Callable[[str], float], *, where: str, example: str
) -> list[float]:
    """What `parse` makes of each entry of a vector; InputError naming `where` if it is none."""
    entries = text.replace(",", " , ").split()
    values: list[float] = []
    comma = True  # a comma needs an entry before it; one may stand between two entries
    for entry in entries:
        if entry == ",":
            if comma:
                raise InputError(
                    repr(shown(text)), where=where, limit="an entry is missing at a comma"
                )
            comma = True
            continue
        try:
            values.append(parse(entry))
        except ValueError as error:
            raise InputError(
                f"entry {len(values) + 1}",
                where=where,
                value=shown(entry),
                limit=f"{error}; write {example}",
            ) from None
        comma = False
    if not values:
        raise InputError("the vector is empty", where=where, limit=f"write {example}")
    if comma:
        raise InputError(repr(shown(text)), where=where, limit="an entry is missing at a comma")
    return values
