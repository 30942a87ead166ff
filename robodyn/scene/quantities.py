"""Values and expressions as people write them, everywhere in one language: arithmetic with units.

`1e-3`, `30deg`, `30 °`, `-pi/2+0.6`, `sqrt(2)/2`, `350 mm`, `1/12`, `9.81 m/s^2`, `60rpm`; a
blank between a number and a unit is a product.  A value is an expression without variables; a
number without a unit is in that of its place.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Container, Mapping, Sequence
from typing import NamedTuple

from robodyn.errors import InputError
from robodyn.scene.dimensions import (
    Dimensions,
    Measured,
    dimension_of,
    measured,
    misfit,
)
from robodyn.scene.expressions import (
    TOO_LARGE,
    ExpressionError,
    NotLinearError,
    changed,
    check_smooth,
    linear,
    names_of,
    number_of,
    without_units,
)
from robodyn.scene.syntax import (
    CONSTANTS,
    FUNCTIONS,
    MISSING,
    PLAIN_NUMBER,
    VALUE_CONSTANTS,
    Node,
    NotAllowedError,
    Variable,
    parsed,
    plain_text,
    tokens_of,
)
from robodyn.scene.units import UNITS, Dimension
from robodyn.tables.csv_fields import shown

_JOINT = re.compile(r"q(\d{1,18})", re.ASCII)
NOTHING: Mapping[str, Node] = {}
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


class Variables(NamedTuple):
    """The variables of an expression: as a tree has them, as they are told, what they are in."""

    named: Variable = lambda name: None
    known: str = ""
    of: Dimensions = lambda name: None


class Expression(NamedTuple):
    """An expression: its text, its tree as it is written, and what it is in, if a unit tells."""

    text: str
    written: Node
    measure: Measured = None
    value: float = math.nan  # in SI units, of one without variables

    @property
    def plain(self) -> bool:
        """Whether no unit gives it a dimension."""
        return self.measure is None or not self.measure.of

    @property
    def node(self) -> Node:
        """The tree, with numbers in SI units."""
        return without_units(self.written)

    @property
    def names(self) -> frozenset[str]:
        """The variables that it has, as its tree names them."""
        return names_of(self.written)


def state_variables(n: int, slides: Container[int] = ()) -> Variables:
    """t, q1.., qd1.. of n joints as t, q0.., qd0..; some of them slide."""

    def named(name: str) -> str | None:
        kind = name.rstrip("0123456789")
        number = name[len(kind) :]
        if name == "t":
            return name
        known = kind in ("q", "qd") and number.isdigit() and 1 <= int(number) <= n
        return f"{kind}{int(number) - 1}" if known else None

    def of(name: str) -> Dimension:
        kind = name.rstrip("0123456789")
        length = kind != name and int(name[len(kind) :]) in slides
        units = {"t": "s", "q": "m" if length else "rad", "qd": "m/s" if length else "rad/s"}
        return dimension_of(units[kind])

    return Variables(named, f"t, q1..q{n}, qd1..qd{n}", of)


def expressions(
    text: str, variables: Variables, constants: Mapping[str, Node] = CONSTANTS
) -> list[Expression]:
    """The comma-separated expressions of a text.

    Raises NotAllowedError for anything but arithmetic with units that fit, comparisons,
    `a if b else c`, functions and constants, and for numbers that are none, such as 1/0;
    ValueError for what is no expression.
    """
    try:
        found = parsed(text, variables.named, variables.known, constants)
        made = []
        for own, node in zip(found.texts, found.nodes, strict=True):
            measure = measured(node, variables.of) if found.measured else None
            value = number_of(node)
            made.append(Expression(own, node, measure, math.nan if value is None else value))
        return made
    except ExpressionError as error:
        at = found.places[id(error.node)] if type(error.node) is tuple else 0
        raise NotAllowedError(f"{error}, at character {at + 1}" if at else str(error)) from None
    except SyntaxError as error:
        raise ValueError(str(error)) from None
    except ArithmeticError:
        raise ValueError(TOO_LARGE) from None


def parse_quantity(text: str, unit: str = "", named: Mapping[str, Node] = NOTHING) -> float:
    """The finite number that `text` writes, in the unit of its place; ValueError with the reason.

    `unit` is such as `kg m²` or `N m s/rad`; of plain numbers, which may have none, it is empty.
    `named` are constants of the scene.
    """
    if PLAIN_NUMBER.fullmatch(text):
        return _finite(float(text))
    found = read_value(text, named)
    if limit := misfit(found.measure, unit):
        raise ValueError(limit)
    return found.value


def read_value(text: str, named: Mapping[str, Node] = NOTHING) -> Expression:
    """The expression whose value is finite; ValueError with the reason where it is none."""
    found = _one(text, Variables(), named)
    _finite(found.value)
    return found


def _one(text: str, variables: Variables, named: Mapping[str, Node] = NOTHING) -> Expression:
    """The one expression of a value's text."""
    if text.strip().lstrip("+-.").lower() in ("nan", "inf", "infinity"):
        raise ValueError("must be a finite number")
    if not text.strip():
        raise ValueError("is not a number")
    try:
        found = expressions(text, variables, {**VALUE_CONSTANTS, **named})
    except ValueError as error:
        reason = str(error)
        told = "something is missing at its end" if reason == MISSING else reason
        raise ValueError(f"is not a number: {told}") from None
    if len(found) != 1:
        raise ValueError("is not a number: a comma")
    return found[0]


def _finite(value: float) -> float:
    """The value; ValueError where a number was too large for a float."""
    if not math.isfinite(value):
        raise ValueError("is too large for a number")
    return value


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


class Equation(NamedTuple):
    """q_joint = sum of ratio q_k plus a constant, or a law (text, and tree with t, q0, q1, ..)."""

    joint: int
    ratios: dict[int, float]
    constant: float
    text: str = ""
    law: Node = 0.0


def parse_coupling(
    text: str, units: Sequence[str], named: Mapping[str, Node] = NOTHING
) -> Equation:
    """`q3 = -2 q1 + 0.1` as joint 2, {0: -2.0} and 0.1; or with a law, as of `q3 = 0.1 cos(q1)`.

    `units` are those of the joints, rad or m, `named` constants of the scene.  Raises ValueError
    with the reason if it is none.
    """
    left, equals, right = text.partition("=")
    match = _JOINT.fullmatch(left.strip())
    if match is None or not equals or "=" in right:
        raise ValueError("must be an equation such as q3 = -2 q1 + 0.1")
    joint, n = int(match[1]) - 1, len(units)

    def of(name: str) -> Dimension | None:
        if name == "t":
            return dimension_of("s")
        k = int(name[1:])
        return dimension_of(units[k - 1]) if 1 <= k <= n else None

    known = Variables(lambda x: x if x == "t" or _JOINT.fullmatch(x) else None, "", of)
    ratios: dict[int, float] = {}
    constant, law, own = 0.0, False, right.strip()
    try:
        found = _one(right, known, named)
        names = {int(name[1:]) - 1 for name in found.names - {"t"}}
        law = "t" in found.names
        if unknown := [k + 1 for k in (joint, *sorted(names)) if not 0 <= k < n]:
            raise _JointError(f"names q{unknown[0]}; the joints are q1 to q{n}")
        try:
            parts = {name: _finite(x) for name, x in linear(found.node).items()}
            constant = parts.pop("", 0.0)
            if not law:
                ratios = {int(name[1:]) - 1: ratio for name, ratio in parts.items()}
        except NotLinearError:
            law = True
    except _JointError:
        raise
    except (ValueError, ArithmeticError) as error:
        raise ValueError(f"must be such as q3 = -2 q1 + 0.1: {own} {error}") from None
    if law:
        try:
            check_smooth([found.node])
        except NotAllowedError as error:
            raise ValueError(f"has {error}") from None
    if joint in names:
        raise ValueError(f"has q{joint + 1} on both sides")
    if limit := misfit(found.measure, units[joint]):
        raise ValueError(limit)
    if not law:
        return Equation(joint, ratios, constant)

    def counted(leaf: float | str) -> float | str:
        return f"q{int(leaf[1:]) - 1}" if isinstance(leaf, str) and leaf != "t" else leaf

    node = changed(found.node, lambda x: x, counted)
    return Equation(joint, {}, 0.0, own, node)


class _JointError(ValueError):
    """An equation names a joint that is none."""


def parse_vector(
    text: str,
    *,
    where: str,
    unit: str | Callable[[int], Sequence[str]] = "",
    example: str = "",
    named: Mapping[str, Node] = NOTHING,
) -> list[float]:
    """The numbers of a comma- or space-separated vector; InputError naming `where` if none.

    `unit`: that of all entries, or what tells those of so many.  `named` are constants of a scene.
    """
    parts = entries(plain_text(text), where, example or EXAMPLES[""])
    units = [unit] * len(parts) if isinstance(unit, str) else unit(len(parts))
    values = []
    for k, (entry, own) in enumerate(zip(parts, units, strict=True), start=1):
        try:
            values.append(parse_quantity(entry, own, named))
        except ValueError as error:
            limit = f"{error}; write {example or EXAMPLES.get(own) or EXAMPLES['']}"
            raise InputError(f"entry {k}", where=where, value=shown(entry), limit=limit) from None
    return values


def entries(text: str, where: str, example: str) -> list[str]:
    """Return the parts of a text between commas, or between blanks outside values."""
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
        if name and before.kind == "number" and token.text in (*VALUE_CONSTANTS, *FUNCTIONS):
            both = f"{before.text}*{token.text} or {before.text},{token.text}"
            raise ValueError(f"is one value or two: write {both}")
        opens = token.text == "(" and before.text not in FUNCTIONS
        if token.kind == "number" or sign or name or opens:
            begins.append(token.at)
    return [part[a:b].strip() for a, b in zip(begins, [*begins[1:], len(part)], strict=True)]
