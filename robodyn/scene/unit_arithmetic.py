"""Arithmetic with units: what `-pi/2 + 0.6`, `350 mm` or `-20/37 q1 + 30 deg` are.

The tree that `syntax` makes of a text, folded over numbers with dimensions.
"""

from __future__ import annotations

import ast
import math
import re
from typing import NamedTuple

from robodyn.scene.syntax import ARGUMENTS, FUNCTIONS, MARK, MISSING, Token, parsed, tokens_of
from robodyn.scene.units import PLAIN, UNITS, Dimension, shown_dimension, times

LONGEST, DEEPEST = 300, 30  # characters of one value, parentheses within one another
CONSTANTS = {"pi": math.pi}
ANGULAR = ("sin", "cos", "tan")  # of an angle
ALIKE = ("abs", "min", "max", "hypot", "floor")  # of what they are of
_JOINT = re.compile(r"q\d{1,18}", re.ASCII)


class Value(NamedTuple):
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


def read_value(text: str, joints: bool = False) -> Value:
    """What `text` writes, perhaps with joints q1..; ValueError with the reason if it is nothing."""
    if text.strip().lstrip("+-.").lower() in ("nan", "inf", "infinity"):
        raise ValueError("must be a finite number")
    if len(text) > LONGEST:
        raise ValueError(f"is not a number: it has more than {LONGEST} characters")
    tokens = tokens_of(text)
    if not tokens:
        raise ValueError("is not a number")
    _check(tokens)
    try:
        tree = parsed(text, _is_joint if joints else _none, FUNCTIONS, tokens)
        if len(tree.nodes) != 1:
            raise SyntaxError("a comma")
        value = _Folding(tree.places, joints).of(tree.nodes[0])
        sizes = [x.total for x in (value, *value.joints.values())]
    except (OverflowError, RecursionError, MemoryError):
        raise ValueError("is too large for a number") from None
    except ZeroDivisionError:
        raise ValueError("divides by zero") from None
    except SyntaxError as error:
        missing = error.msg == MISSING
        told = "something is missing at its end" if missing else error.msg
        raise ValueError(f"is not a number: {told}") from None
    if not all(map(math.isfinite, sizes)):
        raise ValueError("is too large for a number")
    return value


def _none(name: str) -> bool:
    return False


def _is_joint(name: str) -> bool:
    return _JOINT.fullmatch(name) is not None


def _check(tokens: list[Token]) -> None:
    """Raise ValueError for signs that no value has, and for parentheses that are too deep."""
    depth = 0
    for kind, text, at, _ in tokens:
        if kind == "other" or text in _REFUSED or (kind == "number" and _OCTAL.match(text)):
            raise ValueError(f"is not a number: {text!r} at character {at + 1}")
        depth += (text == "(") - (text == ")")
        if depth >= DEEPEST:
            raise ValueError(f"is not a number: parentheses within {DEEPEST} others")


_REFUSED = ("%", "<", "<=", ">", ">=")
_OCTAL = re.compile("0[0-9]")  # 2026-11-23 is no arithmetic


class _Folding:
    """What expressions are as numbers with dimensions."""

    def __init__(self, places: list[int], joints: bool) -> None:
        self.places, self.joints = places, joints

    def of(self, node: ast.expr) -> Value:
        """What an expression is; ValueError with the reason where it is nothing."""
        match node:
            case ast.Constant(value=value):
                return Value(_float(value))
            case ast.Name(id=name):
                return self.name(name, node.col_offset)
            case ast.BinOp(left=left, op=op, right=right) if isinstance(op, _OPERATIONS):
                a, b = self.of(left), self.of(right)
                if isinstance(op, ast.Mult | ast.MatMult):
                    return product(a, b, 1)
                if isinstance(op, ast.Div):
                    return product(a, b, -1)
                if isinstance(op, ast.Pow):
                    return power(a, b)
                return _sum(a, b, 1.0 if isinstance(op, ast.Add) else -1.0)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
                signed = self.of(operand)
                return product(Value(-1.0), signed, 1) if isinstance(sign, ast.USub) else signed
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
                return _called(name, [self.of(x) for x in args])
            case ast.Call(func=ast.Name(id=name)):
                raise ValueError(f"is not a number: {_unknown(name)}{self.at(node.col_offset)}")
        raise ValueError("is not a number: it is no arithmetic")

    def name(self, name: str, at: int) -> Value:
        if name.startswith(MARK):
            return unit_value(name[len(MARK) :])
        if name in CONSTANTS:
            return Value(CONSTANTS[name])
        if name in FUNCTIONS:
            raise ValueError(f"is not a number: {name} needs parentheses{self.at(at)}")
        if self.joints and _is_joint(name):
            return Value(0.0, joints={int(name[1:]): Value(1.0)})
        raise ValueError(f"is not a number: {_unknown(name)}{self.at(at)}")

    def at(self, column: int) -> str:
        place = self.places[column]
        return f" at character {place + 1}" if place else ""


_OPERATIONS = (ast.Add, ast.Sub, ast.Mult, ast.MatMult, ast.Div, ast.Pow)


def unit_value(name: str) -> Value:
    """A unit of the table."""
    size, ten, of = UNITS[name]
    return Value(size, of, ten)


def _float(value: object) -> float:
    if type(value) not in (int, float):
        raise ValueError(f"is not a number: {value!r:.60}")
    try:
        return float(value)  # type: ignore[arg-type]
    except OverflowError:
        return math.inf


def power(base: Value, exponent: Value) -> Value:
    if exponent.of or exponent.joints or base.joints:
        raise ValueError("has a power that is not a plain number")
    k = exponent.total
    if base.ten == 0 or k.is_integer():
        return Value(_real(base.number, k), times(PLAIN, base.of, k), int(base.ten * k))
    return Value(_real(base.total, k), times(PLAIN, base.of, k))


def _called(name: str, given: list[Value]) -> Value:
    if not given:
        raise ValueError(f"is not a number: nothing is in the parentheses of {name}")
    least, most = ARGUMENTS.get(name, (1, 1))
    if not least <= len(given) <= most:
        wanted = f"{least}" if least == most else f"{least} to {most}"
        raise ValueError(f"has {len(given)} arguments of {name}, which takes {wanted}")
    angle = {"rad": 1.0} if name in ANGULAR else None
    for x in given:
        odd = x.of and x.of != angle and name not in (*ALIKE, "sqrt", "atan2", "sign")
        if x.joints or odd:
            raise ValueError(f"has {name} of what is {shown_dimension(x.of) or 'a joint'}")
    for other in given[1:]:
        if other.of != given[0].of:
            raise ValueError(f"has {name} of {_told(given[0])} and {_told(other)}")
    try:
        number = FUNCTIONS[name](*(x.total for x in given))
    except ValueError:
        raise ValueError(f"has {name} of a number that has none") from None
    power = 0.5 if name == "sqrt" else float(name in ALIKE)
    return Value(number, times(PLAIN, given[0].of, power))


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
    angles = all(x.of in (PLAIN, {"rad": 1.0}) for x in (a, b))
    if a.of != b.of and not any(empty) and not angles:
        raise ValueError(f"adds {_told(a)} and {_told(b)}")
    joints = dict(a.joints)
    for k, ratio in b.joints.items():
        more = product(Value(sign), ratio, 1)
        joints[k] = _sum(joints[k], more, 1.0) if k in joints else more
    same = a.ten == b.ten
    number = a.number + sign * b.number if same else a.total + sign * b.total
    return Value(number, one, a.ten if same else 0, joints)


def product(a: Value, b: Value, power: int) -> Value:
    """a b, or a/b."""
    if b.joints and (a.joints or power < 0):
        raise ValueError("is no sum of multiples of joints")
    number = a.number * b.number if power > 0 else a.number / b.number
    joints = {k: product(ratio, b._replace(joints={}), power) for k, ratio in a.joints.items()}
    joints |= {k: product(a._replace(joints={}), ratio, 1) for k, ratio in b.joints.items()}
    if joints and not number:  # nothing but joints: its ratios have the dimensions
        return Value(0.0, joints=joints)
    return Value(number, times(a.of, b.of, power), a.ten + power * b.ten, joints)


def _unknown(name: str) -> str:
    from robodyn.scene.yaml_values import nearest  # only a fault pays for it

    close = nearest(name, [*UNITS, *FUNCTIONS, *CONSTANTS]).partition("; known")[0]
    return f"{name} is no unit or function{close}"
