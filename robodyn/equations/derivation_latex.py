"""The derivation of the equations of motion as a LaTeX document."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import groupby

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
from robodyn.equations.derivation_text import NOWHERE, added_up
from robodyn.equations.latex import (
    LATEX,
    WIDTH,
    content,
    display,
    document,
    escaped,
    measure,
    subscripted,
)
from robodyn.equations.notation import Notation, broken
from robodyn.equations.symbolic import Number


def derivation_latex(derivation: Derivation) -> str:
    """Return a LaTeX document: a subsection for each section, then the result."""
    lines = _lines(derivation, _notation(derivation))
    return document(derivation.equations, "equations of motion, step by step", lines)


def _notation(derivation: Derivation) -> Notation:
    """Return the notation of the equations, with the names of the derivation."""
    names = derivation.names

    def symbol(name: str) -> str:
        return names[name].latex or subscripted(name) if name in names else subscripted(name)

    def number(value: Number) -> str:
        if isinstance(value, int) or value.denominator == 1 or derivation.equations.numeric:
            return LATEX.number(value)
        return rf"\tfrac{{{value.numerator}}}{{{value.denominator}}}"

    return replace(LATEX, symbol=symbol, number=number)


def _lines(derivation: Derivation, notation: Notation) -> Iterator[str]:
    for section in derivation.sections:
        yield rf"\subsection*{{{section.title}}}"
        for block in section.blocks:
            for is_math, lines in groupby(block, lambda x: bool(x.right or x.latex)):
                if is_math:
                    yield from display(x for line in lines for x in _equation(notation, line))
                    continue
                for line in lines:
                    yield _sentence(notation, line) + r"\par"
    if more := derivation.further_symbols:
        yield r"\begin{longtable}{@{}lllp{0.6\textwidth}@{}}"
        for x in more:
            value, unit = LATEX.number(Fraction(x.value)), escaped(x.unit)
            yield rf"${subscripted(x.name)}$ & ${value}$ & {unit} & {escaped(x.meaning)} \\"
        yield r"\end{longtable}"
    yield r"\subsection*{Result}"
    yield from content(derivation.equations)


def _sentence(notation: Notation, line: Line) -> str:
    """Return the words of a line that is no equation, with vectors as rows."""
    return "".join(
        escaped(x) if isinstance(x, str) else f"(${notation.text(x.x)},\\; {notation.text(x.y)}$)"
        for x in line.told
    )


def _equation(notation: Notation, line: Line) -> Iterator[str]:
    """Yield the lines of an equation, with equal expressions below one another."""
    if not line.right:
        yield f"& {line.latex}"
        return
    assert line.left is not None
    left = _named(line.left) if isinstance(line.left, Name) else notation.text(line.left)
    size = measure(left)
    for n, right in enumerate(line.right):
        begin = left if n == 0 else ""
        if isinstance(right, Vector | Carried | Turned | Offset):
            yield f"{begin} &= {_vector(notation, right)}"
            continue
        text = _sum(notation, right)
        text = "{}" + text if text.startswith("[") else text
        first, *more = broken(text, WIDTH - round(size) - 6, measure)
        yield f"{begin} &= {first}"
        yield from (rf"&\quad {part.strip()}" for part in more)


def _named(name: Name) -> str:
    return name.latex or subscripted(name.plain)


def _sum(notation: Notation, right: Right) -> str:
    if isinstance(right, Groups):
        return " ".join(added_up([notation.text(x) for group in right.parts for x in group]))
    return notation.text(right)  # type: ignore[arg-type]


def _vector(notation: Notation, right: Right) -> str:
    """Return a vector as a column, or as operations on vectors."""
    match right:
        case Vector(x, y):
            rows = " \\\\ ".join(_row(notation.text(each)) for each in (x, y))
            return rf"\begin{{pmatrix}} {rows} \end{{pmatrix}}"
        case Offset(k, arm):
            found = _of(k + 1, f"v_{{{k + 1}}}")
            if arm != NOWHERE:
                found += rf" + {_of(k + 1, rf'{chr(92)}omega_{{{k + 1}}}')}\times"
                found += _vector(notation, arm)
            return found
        case Turned(k, vector, along):
            return _turn(notation, k, along) + _vector(notation, vector)
        case Carried(k, above, arm, slides, along, turning):
            omega = _of(above + 1, rf"\omega_{{{above + 1}}}") + r"\times"
            found = _of(above + 1, f"v_{{{above + 1}}}")
            several = turning and arm != NOWHERE
            if several:
                found += f" + {omega}{_vector(notation, arm)}"
            if not slides or along is not None:
                found = rf"\left({found}\right)" if several else found
                found = _turn(notation, None if slides else k, along) + found
            if slides:
                q = rf"\begin{{pmatrix}} q_{{{k + 1}}} \\ 0 \end{{pmatrix}}"
                found += f" + {omega}{q}" if turning else ""
                found += rf" + \begin{{pmatrix}} \dot{{q}}_{{{k + 1}}} \\ 0 \end{{pmatrix}}"
            return found
    raise AssertionError(right)


def _row(text: str) -> str:
    """Return a component, on several lines if it is wider than the page."""
    first, *more = broken(text, WIDTH - 20, measure)
    if not more:
        return first
    lines = " \\\\ ".join([f"& {first}", *(rf"& \quad {part.strip()}" for part in more)])
    return rf"\begin{{aligned}} {lines} \end{{aligned}}"


def _turn(notation: Notation, k: int | None, along: Vector | None) -> str:
    turned = "" if k is None else rf"R(q_{{{k + 1}}})^{{T}}"
    if along is None:
        return turned
    return turned + rf"R({notation.text(along.x)}, {notation.text(along.y)})^{{T}}"


def _of(frame: int, what: str) -> str:
    """Return a quantity with the number of the frame in which it is expressed."""
    return rf"{{}}^{{{frame}}}{what}"
