"""Writes a sum as one line of text, in plain, LaTeX or programming notation.

A blank stands where a long line may be broken, before + and -. Other blanks are GLUE until `broken`
has laid out the line.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robodyn.equations.named_laws import Formula
from robodyn.equations.symbolic import Atom, Monomial, Number, Role, Sum
from robodyn.scene.expressions import fold

GLUE = "\u00a0"  # a blank that is not broken at
OPENING, CLOSING = ("(", "[", r"\{"), (")", "]", r"\}")
INDENT = "  "  # of what goes on within brackets


@dataclass(frozen=True, slots=True)
class Notation:
    """How numbers, atoms and products are written; joints are counted from 0.

    `decimal` writes the numbers of laws, which are no fractions.
    """

    number: Callable[[Number], str]
    decimal: Callable[[float], str]
    symbol: Callable[[str], str]
    call: Callable[[str, list[str]], str]  # a function of the sum of these angles
    power: Callable[[str, int], str]
    times: str
    rate: str = "qd{}"  # of one joint
    angle: str = "q{}"
    root: Callable[[str], str] = "sqrt({})".format
    applied: Callable[[str, str], str] = "{}({})".format
    bracketed: Callable[[str], str] = "({})".format

    raised: Callable[[str, str], str] = "{}^({})".format

    def text(self, entry: Sum | Formula) -> str:
        """Return an entry as one line."""
        if isinstance(entry, Formula):
            return formula_text(self, entry)[0]
        text = ""
        for factors, number in entry.terms.items():
            if text:
                text += f" {'-' if number < 0 else '+'}{GLUE}"
            elif number < 0:
                text = "-"
            text += self._product(factors, max(number, -number))
        return text or self.number(0)

    def _product(self, factors: Monomial, number: Number) -> str:
        """Return a product; negative powers stand below a line, a/b."""
        above = [self._power(factor, power) for factor, power in factors if power > 0]
        parts = above if number == 1 and above else [self.number(number), *above]
        text = self.times.join(parts)
        for factor, power in factors:
            if power < 0:
                divisor = self._power(factor, -power)
                text += f"/({divisor})" if "*" in divisor else f"/{divisor}"
        return text

    def _power(self, factor: Atom | Sum, power: float) -> str:
        if isinstance(factor, Sum):
            if power == 0.5:
                return self.root(self.text(factor))
            text = self.bracketed(self.text(factor))
        else:
            text = self.atom(factor)
        return text if power == 1 else self.power(text, int(power))

    def atom(self, atom: Atom) -> str:
        if atom.role < Role.angle or (atom.role == Role.rate and atom.name):
            return self.symbol(atom.name)
        angles = [self._signed(self.angle, k) for k in atom.place]
        rates = [self._signed(self.rate, k) for k in atom.place]
        if atom.role == Role.angle:
            return angles[0]
        if atom.role == Role.rate:
            return rates[0] if len(rates) == 1 else f"({added(rates)})"
        speed = atom.speed
        if speed is None:
            return self.call(atom.name, angles)
        limit = self.symbol(speed.name) if isinstance(speed, Atom) else self.number(speed)
        return self.applied(atom.name, f"{rates[0]}/{limit}")

    def _signed(self, name: str, joint: int) -> str:
        return name.format(joint + 1) if joint >= 0 else "-" + name.format(-joint)


def added(names: Sequence[str]) -> str:
    """Return a sum of names that stays on one line; names that begin with - are subtracted."""
    first, *others = names
    parts = (f"{GLUE}-{GLUE}{x[1:]}" if x[0] == "-" else f"{GLUE}+{GLUE}{x}" for x in others)
    return first + "".join(parts)


def formula_text(notation: Notation, formula: Formula) -> tuple[str, int]:
    """Return a formula as one line, and its binding: 1 sum, 2 product, 3 power, 4 atom."""

    def bound(part: tuple[str, int], least: int) -> str:
        text, binds = part
        return text if binds >= least else notation.bracketed(text)

    def leaf(x: float | str) -> tuple[str, int]:
        if isinstance(x, str):
            entry = formula.names[x]
            one = len(entry.terms) == 1 and sum(map(len, entry.terms)) <= 1
            return notation.text(entry), 4 if one or not entry else 1
        whole = abs(x) < WHOLE and x == int(x)
        text = notation.number(int(x)) if whole else notation.decimal(x)
        return text, 4 if x >= 0.0 and "e" not in text and "cdot" not in text else 2

    def apply(node: tuple[Any, ...], parts: list[tuple[str, int]]) -> tuple[str, int]:
        operation, first, last = node[0], parts[0], parts[-1]
        match operation:
            case "neg":
                return "-" + bound(first, 2), 1
            case "+" | "-":
                other = bound(last, 1 if operation == "+" else 2)
                other = notation.bracketed(other) if other.startswith("-") else other
                return f"{bound(first, 1)} {operation}{GLUE}{other}", 1
            case "*" if type(node[1]) is tuple and node[1][0] == "neg":
                return first[0] + notation.times + bound(last, 2), 1
            case "*":
                return bound(first, 2) + notation.times + bound(last, 2), 2
            case "/":
                return f"{bound(first, 2)}/{bound(last, 3)}", 2
            case "**":
                if node[2] in range(1, 100):
                    return notation.power(bound(first, 4), int(node[2])), 3
                return notation.raised(bound(first, 4), last[0]), 3
            case "sqrt":
                return notation.root(first[0]), 4
        return notation.applied(operation, ", ".join(text for text, _ in parts)), 4

    return fold(formula.tree, leaf, apply)


WHOLE = 1e15  # numbers below it are written as whole ones if they are
SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def six_digits(number: Number | float) -> str:
    """Return a number with six digits; whole numbers of formulas stay as they are."""
    return str(number) if isinstance(number, int) else f"{float(number):.6g}"


def in_full(number: Number) -> str:
    """Return a number that reads back exactly."""
    return str(number) if isinstance(number, int) else repr(float(number))


PLAIN = Notation(
    number=six_digits,
    decimal=six_digits,
    symbol=str,
    call=lambda function, angles: f"{function}({added(angles)})",
    power=lambda base, power: base + str(power).translate(SUPERSCRIPTS),
    times=GLUE,
)
PYTHON = replace(
    PLAIN, number=in_full, decimal=repr, power="{}**{}".format, times="*", raised="{}**({})".format
)


def one_line(text: str) -> str:
    """Return the line with plain blanks."""
    return text.replace(GLUE, " ")


def broken(text: str, width: int, measure: Callable[[str], float] = len) -> list[str]:
    """Break a line into lines of at most `width`, before + and -, outside brackets if possible.

    Continued lines within brackets are indented by depth.  A part without blanks may be longer.
    """
    parts = text.split(" ")
    sizes = [measure(part) for part in parts]
    depths = [0]  # of brackets, before each part
    for part in parts:
        opened, closed = (sum(map(part.count, marks)) for marks in (OPENING, CLOSING))
        depths.append(depths[-1] + opened - closed)
    lines, start = [], 0
    while start < len(parts):
        end, used = start + 1, sizes[start] + len(INDENT) * depths[start]
        best = None
        while end < len(parts) and used <= width:
            if 4 * used > width and (best is None or depths[end] <= depths[best]):
                best = end
            used += 1 + sizes[end]
            end += 1
        if used > width:
            end = best or start + 1
        lines.append(INDENT * depths[start] + one_line(" ".join(parts[start:end])))
        start = end
    return lines
