"""The syntax of values and expressions: a text as a tree, in which units are quantities.

`350 mm`, `2 N m*sin(3 rad/s*t)`, `10 x + 5 x^3` and `20 mm (1 - cos(q1))` become Python by a pass
over their tokens, which writes the products that people leave out:

    350 mm  is  350@__mm        10 x  is  10*x        mm (1 - x)  is  __mm*(1 - x)

@ binds as * does, and tells that a unit stands behind a number.  A unit is a name that begins with
`__`.  Python parses that; from a white list of what it finds the tree is made, and nothing is run.

A node of the tree is a number, a `Quantity`, the name of a variable, or (operation, node, ...).
Operations are + - * / % < <= > >= neg, the functions below, `if` (condition, node, other), and two
powers: ** to a whole number, pow to any, which is no complex number.
"""

from __future__ import annotations

import ast
import math
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from robodyn.scene.units import ALIASES, PLAIN, UNITS, Named, Quantity, joined, raised

Node = float | str | Quantity | tuple[Any, ...]
Variable = Callable[[str], str | None]  # a variable as the tree has it; None: it is none

# Digits can be told in one way only: a pattern with two takes time by the square of their number.
NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
PLAIN_NUMBER = re.compile(rf"[+-]?{NUMBER}", re.ASCII)
_TOKEN = re.compile(
    rf"(?P<number>{NUMBER})|(?P<name>[A-Za-z_]\w*|°)|(?P<sign>\*\*|[<>]=?|[-+*/^%(),])"
    r"|(?P<blank>\s+|#[^\n]*)|(?P<other>.)",
    re.ASCII,
)
_LETTERS = {"π": "pi", "²": "^2", "³": "^3", "·": "*", "−": "-", "×": "*", **ALIASES}
_TRANSLATED = str.maketrans(_LETTERS)
_WORDS = ("if", "else")  # of Python
_REFUSED = ("and", "or", "not", "is", "lambda", "for")
MARK = "__"  # begins the name of a unit in Python
MISSING = "an expression is missing at the end"
_BETWEEN = re.compile(r"[<>]=?(?!>)|[*/%]+|[,)]")  # what stands behind an expression
LONGEST, DEEPEST = 2000, 300  # characters of a text, operations within one another
LARGEST = sys.float_info.max
MAX_POWER = 64.0  # a constant exponent beyond this is a slip, or an attempt to stall
VALUE_CONSTANTS = {"pi": math.pi}  # without e, which a slip such as e-4 would be
CONSTANTS = {**VALUE_CONSTANTS, "e": math.e}
_NAMES = "sin cos tan asin acos atan atan2 sinh cosh tanh exp log sqrt hypot"


def _sign(x: float) -> float:
    return math.copysign(1.0, x) if x else 0.0


def _exp(x: float) -> float:
    try:
        return math.exp(x)
    except OverflowError:  # so that 1/(1 + exp(x)) goes on to 0
        return math.inf


def _cosh(x: float) -> float:
    return 0.5 * (_exp(x) + _exp(-x)) if abs(x) > 700.0 else math.cosh(x)


def _sinh(x: float) -> float:
    return 0.5 * (_exp(x) - _exp(-x)) if abs(x) > 700.0 else math.sinh(x)


def _floor(x: float) -> float:
    return float(math.floor(x))


FUNCTIONS: dict[str, Callable[..., float]] = {name: getattr(math, name) for name in _NAMES.split()}
FUNCTIONS |= {"abs": abs, "min": min, "max": max, "sign": _sign, "floor": _floor, "exp": _exp}
FUNCTIONS |= {"cosh": _cosh, "sinh": _sinh}

# how many they take, where not one
ARGUMENTS = {"atan2": (2, 2), "hypot": (1, 9), "log": (1, 2), "min": (2, 99), "max": (2, 99)}


class Token(NamedTuple):
    """A part of a text: `at` is the place of its first character, `apart` tells of a blank."""

    kind: str  # number, name, sign, other
    text: str
    at: int
    apart: bool


class NotAllowedError(ValueError):
    """An expression contains something that is not allowed."""


class Parsed(NamedTuple):
    """The comma-separated expressions of a text, and how each is written.

    `measured` tells whether any of them has a unit; `places` has, by the id of an operation, the
    number of its first character in the text.
    """

    nodes: tuple[Node, ...]
    texts: tuple[str, ...]
    measured: bool
    places: dict[int, int]


def plain_text(text: str) -> str:
    """Return the text in characters that all keyboards have."""
    return text if text.isascii() else text.translate(_TRANSLATED)


def tokens_of(text: str) -> list[Token]:
    """Numbers, names, signs and other letters, without blanks and comments."""
    found, places = [], None
    if not text.isascii():
        letters = [(one, k) for k, x in enumerate(text) for one in _LETTERS.get(x, x)]
        text, places = "".join(one for one, _ in letters), [k for _, k in letters]
    apart = False
    for match in _TOKEN.finditer(text):
        kind = match.lastgroup
        if kind == "blank":
            apart = True
            continue
        at = match.start() if places is None else places[match.start()]
        found.append(Token(str(kind), match[0], at, apart))
        apart = False
    return found


def parsed(
    text: str,
    variable: Variable = lambda name: None,
    known: str = "",
    constants: Mapping[str, Node] = VALUE_CONSTANTS,
) -> Parsed:
    """The comma-separated expressions of a text, their variables renamed by `variable`.

    `known` tells people which variables there are.  A constant that is named as a unit is never
    that unit.  Raises NotAllowedError for what is no arithmetic or beyond its limits, SyntaxError,
    with the place, for what is no expression.
    """
    if len(text) > LONGEST:
        raise NotAllowedError(f"more than {LONGEST} characters")
    tokens = tokens_of(text)
    line, places = _python(tokens, variable, constants)
    places.append(len(text))
    if not line or line.endswith(","):
        raise SyntaxError(MISSING)
    try:
        tree = ast.parse(line, mode="eval").body
    except SyntaxError as error:
        at = (error.offset or 0) - 1
        if not 0 <= at < len(line):
            raise SyntaxError(MISSING) from None
        sign = _BETWEEN.match(line, at) if error.msg == "invalid syntax" else None
        what = f"an expression is missing before {sign[0]}" if sign else error.msg
        raise SyntaxError(f"{what} at character {places[at] + 1}") from None
    except (RecursionError, MemoryError, ValueError):
        raise SyntaxError("expressions are too deep within one another") from None
    making = _Making(text, line, places, variable, known, constants, MARK in line)
    each = tree.elts if isinstance(tree, ast.Tuple) else [tree]
    nodes = tuple(making.of(x, DEEPEST) for x in each)
    return Parsed(nodes, tuple(map(making.segment, each)), making.measured, making.found)


@dataclass
class _Making:
    """Makes the tree; each unit goes to the number before it: in 2 x*3 mm/s to the 3."""

    text: str
    line: str
    places: list[int]
    variable: Variable
    known: str
    constants: Mapping[str, Node]
    measured: bool  # whether it has a unit
    found: dict[int, int] = field(default_factory=dict)

    def of(self, node: ast.expr, depth: int) -> Node:
        """An expression that may have so many operations within one another."""
        if not depth:
            raise NotAllowedError(f"more than {DEEPEST} operations within one another")
        match node:
            case ast.Constant(value=float() | int() as x) if type(x) is not bool:
                if x > LARGEST:
                    raise self.no(node, f"`{self.segment(node)[:80]}`, too large for a number")
                return float(x)
            case ast.Name(id=name):
                return self.name(name, node)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self.made(node, "neg", self.of(operand, depth - 1))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.of(operand, depth - 1)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return self.operated(node, self.of(left, depth - 1), self.of(right, depth - 1))
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _OPERATORS:
                sides = self.of(left, depth - 1), self.of(right, depth - 1)
                return self.made(node, _OPERATORS[type(op)], *sides)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return self.made(node, "if", *(self.of(x, depth - 1) for x in (test, body, orelse)))
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
                least, most = ARGUMENTS.get(name, (1, 1))
                if not least <= len(args) <= most:
                    wanted = f"{least}" if least == most else f"{least} to {most}"
                    raise self.no(node, f"{len(args)} arguments of {name}, which takes {wanted}")
                return self.made(node, name, *(self.of(x, depth - 1) for x in args))
            case ast.Call(func=ast.Name(id=name)):
                raise self.unknown(name, "function", ", ".join(FUNCTIONS), node)
        raise self.no(node, f"`{self.segment(node)[:80]}`")

    def name(self, name: str, node: ast.expr) -> Node:
        if name.startswith(MARK):
            return UNITS[name[len(MARK) :]]
        if name in self.constants:
            found = self.constants[name]
            self.measured |= isinstance(found, Quantity)
            return found
        if name in FUNCTIONS:
            raise self.no(node, f"{name} without parentheses")
        own = self.variable(name)
        if own is None:
            raise self.unknown(name, "name", f"{self.known}, {', '.join(self.constants)}", node)
        return own

    def operated(self, node: ast.BinOp, left: Node, right: Node) -> Node:
        """An operation on two nodes; a unit behind a number, or a unit, belongs to that."""
        operation = _OPERATORS[type(node.op)]
        if operation == "**":
            power = _constant(right)
            if abs(power) > MAX_POWER:
                raise self.no(node.right, f"an exponent above {MAX_POWER:g}")
            if isinstance(left, Quantity) and left.unit and power.is_integer():
                return raised(left, power)
            return self.made(node, "**" if power.is_integer() else "pow", left, right)
        joins = operation == "@"
        if isinstance(right, Quantity) and right.unit and operation in "@*/":
            end = node.left.end_col_offset or 0
            apart = ")" in self.line[end - 1 : node.right.col_offset]
            number = joins or type(left) is float
            sign = -1 if operation == "/" else 1
            found = None if apart else self.joined(left, right, sign, number)
            if found is not None:
                return found
        return self.made(node, "*" if joins else operation, left, right)

    def joined(self, node: Node, unit: Quantity, sign: int, number: bool) -> Node | None:
        """A node with a unit at its last factor, if this has one already, or is a `number`."""
        if isinstance(node, Named) or (isinstance(node, Quantity) and node.name):
            return None  # a factor of its own, by which the constant keeps its name
        if isinstance(node, Quantity):
            return joined(node, unit, sign)
        if isinstance(node, float):
            return joined(Quantity(node, 0, PLAIN), unit, sign) if number else None
        if isinstance(node, str) or node[0] not in ("neg", "*", "%"):
            return None
        last = self.joined(node[-1], unit, sign, number)
        if last is None:
            return None
        found = (*node[:-1], last)
        self.found[id(found)] = self.found[id(node)]
        return found

    def made(self, node: ast.expr, *parts: Node) -> Node:
        self.found[id(parts)] = self.places[node.col_offset]
        return parts

    def segment(self, node: ast.expr) -> str:
        """An expression as it is written."""
        begin, end = (self.places[x] for x in (node.col_offset, node.end_col_offset or -1))
        return self.text[begin:end].strip()

    def no(self, node: ast.expr, what: str) -> NotAllowedError:
        """Return the error for something not allowed, with its position."""
        at = self.places[node.col_offset]
        return NotAllowedError(f"{what}, at character {at + 1}" if at else what)

    def unknown(self, name: str, what: str, known: str, node: ast.expr) -> NotAllowedError:
        if self.known:
            return self.no(node, f"{what} {name}; known: {known}")
        from robodyn.scene.yaml_values import nearest  # only a fault pays for it

        close = nearest(name, [*UNITS, *FUNCTIONS, *self.constants]).partition("; known")[0]
        at = self.places[node.col_offset]
        place = f" at character {at + 1}" if at else ""
        return NotAllowedError(f"{name} is no unit or function{close}{place}")


_OPERATORS: dict[type, str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.MatMult: "@",
    ast.Div: "/",
    ast.Mod: "%",
    ast.Pow: "**",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
}


def _constant(exponent: Node) -> float:
    """The number that an exponent is; else 0.5, as it may be any: no whole number."""
    if type(exponent) is tuple and exponent[0] == "neg":
        return -_constant(exponent[1])
    return exponent if isinstance(exponent, float) else 0.5


def _python(
    tokens: list[Token], variable: Variable, constants: Iterable[str] = ()
) -> tuple[str, list[int]]:
    """The tokens as Python with all products written, and the place of each letter."""
    pieces: list[str] = []
    places: list[int] = []
    own = {name for name in constants if name not in CONSTANTS}  # of the scene: no functions
    ended = False  # whether a value ends before the token
    before = Token("", "", 0, False)
    in_unit = joined = False  # whether a unit is before the token, with * or / behind it
    count = len(tokens)
    for k, token in enumerate(tokens):
        kind, word, at, apart = token
        glue, begun, unit = "", ended, False
        opens = k + 1 < count and tokens[k + 1].text == "("
        if kind == "name":
            if word in _REFUSED:
                raise NotAllowedError(f"`{word}`, at character {at + 1}")
            if word.startswith(MARK):
                raise SyntaxError(f"no name begins with {MARK}, at character {at + 1}")
            unit = word in UNITS and word not in own and not (opens and word in FUNCTIONS)
            unit = unit and (ended or joined or variable(word) is None)
            if word == "in" and ended and before.kind == "name" and not in_unit:
                # else it is the word of Python
                unit = before.text in CONSTANTS or before.text in own
            if word in _WORDS:
                ended = False
            elif ended:
                # what is in parentheses, and a power, are no number that a unit belongs to
                glue = "@" if unit and before.text != ")" else "*"
            if word not in _WORDS:
                ended = unit or not opens or word in own
            if unit:
                word = MARK + ("deg" if word == "°" else word)
        elif kind == "number":
            if ended:
                raise _missing(token)
            after = tokens[k + 1] if k + 1 < count else before
            if after.text in _WORDS and not after.apart:  # what Python will not take one day
                raise SyntaxError(
                    f"a blank is missing in the expression at character {after.at + 1}"
                )
            ended = True
        elif word == "(":
            if ended:
                if not (in_unit or before.text in own):
                    raise _missing(token)
                glue = "*"
            ended = False
        elif kind == "other":
            raise SyntaxError(f"{word!r} at character {at + 1}")
        else:
            ended = word == ")"
            word = "**" if word == "^" else word
        # the whole power of a unit is a part of it
        power = in_unit and (
            word == "**"
            or (before.text in ("^", "**", "-") and kind == "number")
            or (word == "-" and before.text in ("^", "**"))
        )
        joined = in_unit and begun and word in ("*", "/")
        in_unit = unit or power
        if apart or (pieces and kind in ("name", "number") and not glue):
            pieces.append(" ")
            places.append(at)
        pieces += [glue, word] if glue else [word]
        places += [at] * (len(glue) + len(word))
        before = token
    text = "".join(pieces)
    begin = len(text) - len(text.lstrip())
    return text[begin:], places[begin:]


def _missing(token: Token) -> SyntaxError:
    return SyntaxError(f"an operator is missing before {token.text} at character {token.at + 1}")
