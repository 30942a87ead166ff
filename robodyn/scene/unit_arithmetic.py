"""Arithmetic with units: what `-pi/2 + 0.6`, `350 mm` or `-20/37 q1 + 30 deg` are.

sum = product (+ or - product)*; product = power (* or / power, or a unit, constant or joint after a
blank)*; power = atom (^ power); atom = number, name, function(sum, ..), (sum).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from robodyn.scene.units import ALIASES, PLAIN, UNITS, Dimension, shown_dimension, times
from robodyn.tables.records import Record

# Digits can be told in one way only: a pattern with two takes time by the square of their number.
NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
PLAIN_NUMBER = re.compile(rf"[+-]?{NUMBER}", re.ASCII)
_TOKEN = rf"(?P<number>{NUMBER})|(?P<name>[^\W\d_][^\W\d_]*\d*|°)|(?P<sign>\*\*|[-+*/^(),])"
_LETTERS = str.maketrans({"π": "pi", "²": "^2", "³": "^3", "·": "*", "−": "-", "×": "*"})
LONGEST, DEEPEST = 300, 30  # characters of one value, parentheses within one another
CONSTANTS = {"pi": math.pi}
_ONE = ["sin", "cos", "tan", "asin", "acos", "atan", "exp", "log"]
FUNCTIONS: dict[str, Callable[..., float]] = {name: getattr(math, name) for name in _ONE}
FUNCTIONS |= {"sqrt": math.sqrt, "atan2": math.atan2, "hypot": math.hypot}
PAIRS = ("atan2", "hypot")
ANGULAR = ("sin", "cos", "tan")  # of an angle
SCALING = ("sqrt", "hypot", "atan2")  # of any unit


class _Token(Record):
    kind: str  # number, name, sign
    text: str
    at: int  # place of its first character
    apart: bool  # whether a blank is before it


class Value(Record):
    """number 10^ten of a dimension, and the multiples of q1.. that an equation adds to it."""

    number: float
    of: Dimension = PLAIN
    ten: int = 0
    joints: dict[int, Value] = {}  # noqa: RUF012 (nobody changes it)

    @property
    def total(self) -> float:
        return self.number * 10.0**self.ten if self.ten >= 0 else self.number / 10.0**-self.ten


def finite(value: float) -> float:
    """The value; ValueError where a number was too large for a float."""
    if math.isinf(value):
        raise ValueError("is too large for a number")
    return value


def plain_text(text: str) -> str:
    """The same in letters that all keyboards have."""
    for letters, name in ALIASES.items():
        text = text.replace(letters, name)
    return text.translate(_LETTERS)


def tokens_of(text: str) -> list[_Token]:
    """Numbers, names and signs; ValueError where there is none of these."""
    if text.strip().lstrip("+-.").lower() in ("nan", "inf", "infinity"):
        raise ValueError("must be a finite number")
    if len(text) > LONGEST:
        raise ValueError(f"is not a number: it has more than {LONGEST} characters")
    if not text.strip():
        raise ValueError("is not a number")
    found: list[_Token] = []
    token, at = re.compile(_TOKEN, re.ASCII), 0  # `re` keeps it; plain numbers need none
    for piece in re.finditer(r"\S+", text):
        begin = piece.start()
        while begin < piece.end():
            match = token.match(text, begin, piece.end())
            if match is None:
                raise ValueError(f"is not a number: {text[begin]!r} at character {begin + 1}")
            found.append(_Token(str(match.lastgroup), match[0], begin, begin > at or not found))
            begin = at = match.end()
    return found


def read_value(text: str, joints: bool = False) -> Value:
    """What `text` writes, perhaps with joints q1..; ValueError with the reason if it is nothing."""
    return _Reader(plain_text(text), joints).read()


class _Reader:
    """Reads the tokens of one value from the left to the right."""

    def __init__(self, text: str, joints: bool) -> None:
        self.tokens, self.next, self.depth, self.joints = tokens_of(text), 0, 0, joints

    def read(self) -> Value:
        try:
            value = self.sum()
        except (OverflowError, RecursionError):
            raise ValueError("is too large for a number") from None
        except ZeroDivisionError:
            raise ValueError("divides by zero") from None
        if self.next < len(self.tokens):
            raise self.wrong("an operator is missing before")
        if not all(math.isfinite(x.number) for x in (value, *value.joints.values())):
            raise ValueError("is too large for a number")
        return value

    def wrong(self, what: str) -> ValueError:
        """A fault at the next token."""
        if self.next >= len(self.tokens):
            return ValueError("is not a number: something is missing at its end")
        token = self.tokens[self.next]
        return ValueError(f"is not a number: {what} {token.text} at character {token.at + 1}")

    def took(self, *signs: str) -> str | None:
        """The next sign, if it is one of these."""
        if self.next < len(self.tokens) and self.tokens[self.next].text in signs:
            self.next += 1
            return self.tokens[self.next - 1].text
        return None

    def sum(self) -> Value:
        self.depth += 1
        if self.depth > DEEPEST:
            raise ValueError(f"is not a number: parentheses within {DEEPEST} others")
        value = self.product()
        while sign := self.took("+", "-"):
            value = _sum(value, self.product(), -1.0 if sign == "-" else 1.0)
        self.depth -= 1
        return value

    def product(self) -> Value:
        value = self.signed()
        while True:
            if sign := self.took("*", "/"):
                value = _product(value, self.signed(), -1 if sign == "/" else 1)
            elif self.next < len(self.tokens) and self.tokens[self.next].kind == "name":
                value = _product(value, self.power(), 1)
            else:
                return value

    def signed(self) -> Value:
        if sign := self.took("+", "-"):
            value = self.signed()
            return _product(Value(-1.0), value, 1) if sign == "-" else value
        return self.power()

    def power(self) -> Value:
        base = self.atom()
        if not self.took("^", "**"):
            return base
        exponent = self.signed()
        if exponent.of or exponent.joints or base.joints:
            raise ValueError("has a power that is not a plain number")
        k = exponent.total
        if base.ten == 0 or k.is_integer():
            return Value(_real(base.number, k), times(PLAIN, base.of, k), int(base.ten * k))
        return Value(_real(base.total, k), times(PLAIN, base.of, k))

    def atom(self) -> Value:
        if self.took("("):
            value = self.sum()
            if not self.took(")"):
                raise self.wrong("a parenthesis is open before")
            return value
        if self.next >= len(self.tokens) or self.tokens[self.next].kind == "sign":
            raise self.wrong("a value is missing before")
        kind, text, at, _ = self.tokens[self.next]
        self.next += 1
        if kind == "number":
            if re.match("0[0-9]", text):  # 2026-11-23 is no arithmetic
                raise ValueError(f"is not a number: {text} at character {at + 1}")
            return Value(float(text))
        if text in CONSTANTS:
            return Value(CONSTANTS[text])
        if text in UNITS:
            size, ten, of = UNITS[text]
            return Value(size, of, ten)
        if text in FUNCTIONS:
            return self.function(text)
        if self.joints and re.fullmatch(r"q\d{1,18}", text, re.ASCII):
            return Value(0.0, joints={int(text[1:]): Value(1.0)})
        place = f" at character {at + 1}" if at else ""
        raise ValueError(f"is not a number: {_unknown(text)}{place}")

    def function(self, name: str) -> Value:
        if not self.took("("):
            raise self.wrong(f"{name} needs parentheses before")
        given = [self.sum()]
        while self.took(","):
            given.append(self.sum())
        if not self.took(")"):
            raise self.wrong("a parenthesis is open before")
        wanted = 2 if name in PAIRS else 1
        if len(given) != wanted:
            raise ValueError(f"has {len(given)} arguments of {name}, which takes {wanted}")
        angle = {"rad": 1.0} if name in ANGULAR else None
        for x in given:
            if x.joints or (x.of and x.of != angle and name not in SCALING):
                raise ValueError(f"has {name} of what is {shown_dimension(x.of) or 'a joint'}")
        if name in PAIRS and given[0].of != given[1].of:
            raise ValueError(f"has {name} of {_told(given[0])} and {_told(given[1])}")
        try:
            number = FUNCTIONS[name](*(x.total for x in given))
        except ValueError:
            raise ValueError(f"has {name} of a number that has none") from None
        power = {"sqrt": 0.5, "hypot": 1.0}.get(name)
        return Value(number, PLAIN if power is None else times(PLAIN, given[0].of, power))


def _told(value: Value) -> str:
    return f"what is in {shown_dimension(value.of)}" if value.of else "a plain number"


def _real(base: float, exponent: float) -> float:
    if base == 0.0 and exponent < 0.0:
        raise ZeroDivisionError
    if base < 0.0 and not exponent.is_integer():
        raise ValueError("has a root of a negative number")
    return math.pow(base, exponent)


def _sum(a: Value, b: Value, sign: float) -> Value:
    """a + sign b; a plain number goes with an angle, which is one."""
    one = {**a.of, **b.of}
    empty = [not x.of and not x.number and bool(x.joints) for x in (a, b)]
    if a.of != b.of and not any(empty) and (one != {"rad": 1.0}):
        raise ValueError(f"adds {_told(a)} and {_told(b)}")
    joints = dict(a.joints)
    for k, ratio in b.joints.items():
        more = _product(Value(sign), ratio, 1)
        joints[k] = _sum(joints[k], more, 1.0) if k in joints else more
    same = a.ten == b.ten
    number = a.number + sign * b.number if same else a.total + sign * b.total
    return Value(number, one, a.ten if same else 0, joints)


def _product(a: Value, b: Value, power: int) -> Value:
    """a b, or a/b."""
    if b.joints and (a.joints or power < 0):
        raise ValueError("is no sum of multiples of joints")
    number = a.number * b.number if power > 0 else a.number / b.number
    joints = {k: _product(ratio, b._replace(joints={}), power) for k, ratio in a.joints.items()}
    joints |= {k: _product(a._replace(joints={}), ratio, 1) for k, ratio in b.joints.items()}
    if joints and not number:  # nothing but joints: its ratios have the dimensions
        return Value(0.0, joints=joints)
    return Value(number, times(a.of, b.of, power), a.ten + power * b.ten, joints)


def _unknown(name: str) -> str:
    from robodyn.scene.yaml_values import nearest  # only a fault pays for it

    close = nearest(name, [*UNITS, *FUNCTIONS, *CONSTANTS]).partition("; known")[0]
    return f"{name} is no unit or function{close}"
