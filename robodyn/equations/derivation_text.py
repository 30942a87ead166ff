"""The derivation of the equations of motion as plain text, and as the steps of a JSON object."""

from __future__ import annotations

import json
import textwrap
from dataclasses import replace
from fractions import Fraction
from functools import partial

from robodyn.equations.derivation import (
    Carried,
    Derivation,
    Groups,
    Line,
    Name,
    Offset,
    Right,
    Turned,
    Vector,
)
from robodyn.equations.notation import GLUE, PLAIN, PYTHON, Notation, broken, one_line, six_digits
from robodyn.equations.symbolic import ZERO, Number
from robodyn.equations.text import LEAST_WIDTH, MARGIN, WIDTH, as_json, table, text

NOWHERE = Vector(ZERO, ZERO)


def derivation_text(derivation: Derivation, width: int = WIDTH) -> str:
    """Return the derivation and its result as text, wrapped to `width` where possible."""
    equations, width = derivation.equations, max(width, LEAST_WIDTH)
    lines = [f"{equations.title}: equations of motion, step by step"]
    notation = plain_notation(derivation)
    for section in derivation.sections:
        lines += ["", section.title]
        for block in section.blocks:
            lines.append("")
            for line in block:
                lines += _laid_out(notation, line, width)
    if more := derivation.further_symbols:
        rows = ([x.name, f"{x.value:.6g}", x.unit, x.meaning] for x in more)
        lines += ["", "where, beside the symbols of the result,", "", *table(rows)]
    lines += ["", "Result", "", *text(equations, width).split("\n")[2:]]
    return "\n".join(lines)


def derivation_json(derivation: Derivation) -> str:
    """Return the JSON object of the equations with another key, `steps`.

    Each step has a title and lines: a `text`, or the `left` side and a list of `right` sides, in
    the syntax of Python and SymPy.  A vector is a list of two.
    """
    notation = replace(PYTHON, symbol=str)
    steps = [
        {
            "title": section.title,
            "lines": [_entry(derivation, notation, line) for b in section.blocks for line in b],
        }
        for section in derivation.sections
    ]
    whole = as_json(derivation.equations)
    return f'{whole[: whole.rindex("}")].rstrip()},\n  "steps": {json.dumps(steps)}\n}}\n'


def plain_notation(derivation: Derivation) -> Notation:
    """Return the notation of the equations, with the names of the derivation."""
    names = derivation.names

    def symbol(name: str) -> str:
        return names[name].plain if name in names else name

    number = six_digits if derivation.equations.numeric else exact
    return replace(PLAIN, symbol=symbol, number=number)


def exact(number: Number) -> str:
    """Return a number of a formula in symbols, halves as 1/2."""
    return str(Fraction(number)) if isinstance(number, Fraction) else six_digits(number)


def added_up(texts: list[str]) -> list[str]:
    """Return the parts of a sum, all but the first with their signs before them."""
    signed = [f"-{GLUE}{x[1:]}" if x[0] == "-" else f"+{GLUE}{x}" for x in texts[1:]]
    return [*texts[:1], *signed]


def _in_groups(notation: Notation, groups: Groups, room: int) -> list[str]:
    """Return a sum as the parts that begin lines."""
    texts = iter(added_up([notation.text(x) for group in groups.parts for x in group]))
    found = []
    for group in groups.parts:
        parts = [next(texts) for _ in group]
        joined = " ".join(parts)
        found += [joined] if len(joined) <= room else parts
    return found


def _text(notation: Notation, right: Right) -> str:
    """Return the text of a right side."""
    pair = partial(_pair, notation)
    match right:
        case Groups():
            return " ".join(_in_groups(notation, right, 0))
        case Vector():
            return pair(right)
        case Offset(k, arm):
            moved = "" if arm == NOWHERE else f" +{GLUE}omega{k + 1} x {pair(arm)}"
            return f"v{k + 1}{moved}".replace(" x ", f"{GLUE}x{GLUE}")
        case Turned(k, vector, along):
            return f"{_turn(notation, k, along)}{GLUE}{pair(vector)}"
        case Carried(k, above, arm, slides, along, turning):
            inner = [f"v{above + 1}"]
            inner += [f"omega{above + 1} x {pair(arm)}"] if turning and arm != NOWHERE else []
            found = " + ".join(inner)
            if not slides or along is not None:
                found = f"({found})" if len(inner) > 1 else found
                found = f"{_turn(notation, None if slides else k, along)} {found}"
            if slides:
                found += f" + omega{above + 1} x (q{k + 1}, 0)" if turning else ""
                found += f" + (qd{k + 1}, 0)"
            return found.replace(" ", GLUE)
    return notation.text(right)


def _turn(notation: Notation, k: int | None, along: Vector | None) -> str:
    """Return the text of R^T of joint k's angle, and of the direction from which it is measured."""
    turns = [] if k is None else [f"R(q{k + 1})^T"]
    return GLUE.join(turns + ([] if along is None else [f"R{_pair(notation, along)}^T"]))


def _pair(notation: Notation, vector: Vector) -> str:
    return f"({notation.text(vector.x)},{GLUE}{notation.text(vector.y)})"


def _sentence(notation: Notation, line: Line) -> str:
    """Return the words of a line that is no equation."""
    parts = (x if isinstance(x, str) else one_line(_pair(notation, x)) for x in line.told)
    return "".join(parts)


def _laid_out(notation: Notation, line: Line, width: int) -> list[str]:
    """Return a line of the derivation as lines of text."""
    if not line.right:
        told = _sentence(notation, line)
        if line.latex:
            return [MARGIN + told]
        return textwrap.wrap(told, width, initial_indent=MARGIN, subsequent_indent=2 * MARGIN)
    assert line.left is not None
    left = line.left.plain if isinstance(line.left, Name) else notation.text(line.left)
    rights = [_text(notation, right) for right in line.right]
    whole = one_line(f"{MARGIN}{left} = {' = '.join(rights)}")
    if len(whole) <= width:
        return [whole]
    if isinstance(line.left, Name):
        found, start = [], f"{MARGIN}{left} "
    else:  # a long sum: what it equals begins the next line
        found, start = [MARGIN + x for x in broken(left, width - len(MARGIN))], 2 * MARGIN
    room = width - len(start) - 2
    for right, joined in zip(line.right, rights, strict=True):
        parts = [joined]
        if isinstance(right, Groups) and len(joined) > room:
            parts = _in_groups(notation, right, room)
        first, *more = (part for x in parts for part in broken(x, room))
        found.append(f"{start}= {first}")
        start = " " * len(start)
        found += [f"{start}  {part}" for part in more]
    return found


def _entry(derivation: Derivation, notation: Notation, line: Line) -> dict[str, object]:
    """Return a line for JSON; operations on vectors are left out."""
    if not line.right:
        plain = plain_notation(derivation)
        return {"text": _sentence(plain, line)}
    left = line.left
    assert left is not None
    right: list[object] = []
    for each in line.right:
        if isinstance(each, Vector):
            right.append([one_line(notation.text(x)) for x in each])
        elif not isinstance(each, Carried | Turned | Offset):
            right.append(one_line(_text(notation, each)))
    told = left.identifier if isinstance(left, Name) else one_line(notation.text(left))
    return {"left": told, "right": right}
