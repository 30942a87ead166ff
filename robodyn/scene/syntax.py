"""The syntax of values and expressions: a text as Python's tree, in which units are names.

`350 mm`, `2 N m*sin(3 rad/s*t)`, `10 x + 5 x^3` and `20 mm (1 - cos(q1))` become Python by a pass
over their tokens, which writes the products that people leave out:

    350 mm  is  350@__mm        10 x  is  10*x        mm (1 - x)  is  __mm*(1 - x)

@ binds as * does, and tells that a unit stands behind a number.  A unit is a name that begins with
`__`.  Nothing is run: `unit_arithmetic`, `expression_units` and `expressions` fold the tree.
"""

from __future__ import annotations

import ast
import math
import re
import warnings
from collections.abc import Callable, Container, Sequence
from typing import NamedTuple

from robodyn.scene.units import ALIASES, UNITS

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
_WORDS = {"if", "else", "and", "or", "not", "is", "lambda", "for"}  # of Python
MARK = "__"  # begins the name of a unit in the tree
MISSING = "an expression is missing at the end"
_BETWEEN = re.compile(r"[<>]=?(?!>)|[*/%]+|[,)]")  # what stands behind an expression
CONSTANTS = {"pi": math.pi, "e": math.e}
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


class Tree(NamedTuple):
    """Expressions, the line that Python reads, and the place in the text of each of its letters."""

    nodes: Sequence[ast.expr]
    line: str
    places: list[int]


def plain_text(text: str) -> str:
    """The same in letters that all keyboards have."""
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
    variable: Callable[[str], bool],
    functions: Container[str],
    tokens: list[Token] | None = None,
) -> Tree:
    """The comma-separated expressions in a text; SyntaxError, with the place, where it has none.

    `variable` tells the names that are variables, and no units where no number is before them.
    """
    tokens = tokens_of(text) if tokens is None else tokens
    line, places = _python(tokens, variable, functions)
    places.append(len(text))
    if not line or line.endswith(","):
        raise SyntaxError(MISSING)
    if not line.isascii():  # Python would take other scripts' letters for our own
        raise SyntaxError("a character is not ASCII")
    try:
        if any(x.kind == "other" or x.text in _WORDS for x in tokens):
            with warnings.catch_warnings():  # what Python warns of it will not take one day
                warnings.simplefilter("error")
                tree = ast.parse(line, mode="eval").body
        else:
            tree = ast.parse(line, mode="eval").body
    except SyntaxError as error:
        at = (error.offset or 0) - 1
        if not 0 <= at < len(line):
            raise SyntaxError(MISSING) from None
        sign = _BETWEEN.match(line, at) if error.msg == "invalid syntax" else None
        what = f"an expression is missing before {sign[0]}" if sign else error.msg
        raise SyntaxError(f"{what} at character {places[at] + 1}") from None
    return Tree(tree.elts if isinstance(tree, ast.Tuple) else [tree], line, places)


def unit_of(node: ast.expr) -> str:
    """The unit that a node of the tree names; nothing where it names none."""
    if isinstance(node, ast.Name) and node.id.startswith(MARK):
        return node.id[len(MARK) :]
    return ""


def _python(
    tokens: list[Token], variable: Callable[[str], bool], functions: Container[str]
) -> tuple[str, list[int]]:
    """The tokens as Python with all products written, and the place of each letter."""
    pieces: list[str] = []
    places: list[int] = []
    ended = False  # whether a value ends before the token
    before = Token("", "", 0, False)
    in_unit = joined = False  # whether a unit is before the token, with * or / behind it
    count = len(tokens)
    for k, token in enumerate(tokens):
        kind, word, at, apart = token
        glue, begun, unit = "", ended, False
        opens = k + 1 < count and tokens[k + 1].text == "("
        if kind == "name":
            if word.startswith(MARK):
                raise SyntaxError(f"no name begins with {MARK}, at character {at + 1}")
            unit = word in UNITS and not (opens and word in functions)
            unit = unit and (ended or joined or not variable(word))
            if word == "in" and ended and before.kind == "name" and not in_unit:
                unit = before.text in CONSTANTS  # else it is the word of Python
            if word in _WORDS:
                ended = False
            elif ended:
                if word in functions and not unit:
                    raise _missing(token)
                # what is in parentheses, and a power, are no number that a unit belongs to
                glue = "@" if unit and before.text != ")" else "*"
            if word not in _WORDS:
                ended = unit or not opens
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
                if not in_unit:
                    raise _missing(token)
                glue = "*"
            ended = False
        elif word == "@":
            raise SyntaxError(f"invalid syntax at character {at + 1}")
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
