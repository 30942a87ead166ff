"""The equations of motion as a LaTeX document, for amsmath, geometry and longtable."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import chain

from robodyn.equations.named_laws import Formula
from robodyn.equations.notation import GLUE, Notation, added, broken, six_digits
from robodyn.equations.outline import Block, Equations
from robodyn.equations.symbolic import Number, Sum

WIDTH = 92  # of a formula on a page, in letters of an average width
MATRIX_WIDTH = 84  # the same of a whole matrix; a wider one is given entry by entry
ZEROS = 9  # names of entries that are zero, in one line

PREAMBLE = r"""\documentclass[a4paper]{article}
\usepackage[margin=2cm]{geometry}
\usepackage{amsmath}
\usepackage{longtable}
\allowdisplaybreaks
\setlength{\parindent}{0pt}
"""
SPECIAL = {
    "\\": r"$\backslash$",
    "~": r"\~{}",
    "^": r"\^{}",
    "²": "$^2$",
    "<": "$<$",
    ">": "$>$",
    "|": "$|$",
    **{character: f"\\{character}" for character in "{}#$%&_"},
}
GREEK = "alpha beta gamma delta epsilon zeta eta theta kappa mu nu xi rho sigma phi chi psi omega"
NAMES = {
    "qd": r"\dot{q}",
    "qdd": r"\ddot{q}",
    "tau": r"\tau",
    "lambda": r"\lambda",
    "Psi": r"\Psi",
    "Psidot_qd": r"\dot{\Psi}\dot{q}",
    "gap": r"\mathrm{gap}",
    "gap_t": r"\mathrm{gap}_{t}",
}


def latex(equations: Equations[Sum]) -> str:
    """Return the equations as a LaTeX document."""
    return document(equations, "equations of motion", content(equations))


def document(equations: Equations[Sum], title: str, lines: Iterable[str]) -> str:
    """Return a document with the scene's name and `title` as its heading."""
    columns = max(len(block.rows[0]) for block in equations.blocks)
    wide = rf"\setcounter{{MaxMatrixCols}}{{{columns}}}" + "\n" if columns > 10 else ""
    heading = rf"\section*{{{escaped(equations.title)}: {title}}}"
    begin = [PREAMBLE + wide, r"\begin{document}", heading]
    return "\n".join([*begin, *lines, r"\end{document}"]) + "\n"


def content(equations: Equations[Sum]) -> Iterator[str]:
    """Yield the equations and the legend of their symbols."""
    yield from display(_head(equations))
    for definitions, block in equations.defined():
        yield from display(_block(block))
        if definitions:
            named = ((subscripted(name.name), name.value) for name in definitions)
            yield from display(chain.from_iterable(equation(*x) for x in named))
    yield from _legend(equations)


def escaped(text: str) -> str:
    """Return text with LaTeX's special characters escaped."""
    return "".join(SPECIAL.get(character, character) for character in text)


def subscripted(name: str) -> str:
    r"""Return a parameter's name in LaTeX: r1x -> r_{1x}, phi1 -> \varphi_{1}."""
    if len(name) > 1 and not re.search("[0-9]", name) and name not in ("gx", "gy"):
        return f"\\{name}" if name in GREEK.split() else rf"\mathit{{{escaped(name)}}}"
    for letters, greek in (("phi", r"\varphi"), ("psi", r"\psi"), ("beta", r"\beta")):
        if name.startswith(letters):
            return f"{greek}_{{{name[len(letters) :]}}}"
    name = name.replace("_", ",")
    return name if len(name) == 1 else f"{name[0]}_{{{name[1:]}}}"


def _number(number: Number | float) -> str:
    mantissa, _, exponent = six_digits(number).partition("e")
    return rf"{mantissa}\cdot 10^{{{int(exponent)}}}" if exponent else mantissa


def _bracketed(text: str) -> str:
    """Return text in round brackets; square and curly ones around inner brackets."""
    if "(" not in text or r"\{" in text:
        return f"({text})"
    return rf"\{{{text}\}}" if "[" in text else f"[{text}]"


FUNCTIONS = {name: rf"\operatorname{{{name}}}" for name in ("sign", "step", "hypot", "abs")}
FUNCTIONS |= {"asin": r"\arcsin", "acos": r"\arccos", "atan": r"\arctan", "log": r"\ln"}
LATEX = Notation(
    number=_number,
    decimal=_number,
    symbol=subscripted,
    call=lambda function, angles: (
        rf"\{function}" + (f"({added(angles)})" if len(angles) > 1 else GLUE + angles[0])
    ),
    power="{}^{{{}}}".format,
    times=GLUE,
    rate=r"\dot{{q}}_{{{}}}",
    angle="q_{{{}}}",
    root=r"\sqrt{{{}}}".format,
    applied=lambda name, inner: f"{FUNCTIONS.get(name, chr(92) + name)}({inner})",
    raised="{}^{{{}}}".format,
    bracketed=_bracketed,
)


def measure(formula: str) -> float:
    """Return the approximate width of a formula in letters; indices are small."""
    shown = re.sub(r"\\(cos|sin)\b", r"'\1", formula)  # ' is a thin space
    shown = re.sub(r"\\(dot|ddot|mathrm)\b", "", shown)
    small = "".join(re.findall(r"[_^]\{([^}]*)\}", shown))
    normal = re.sub(r"[_^]\{[^}]*\}|[{}\s\\" + GLUE + "]", "", shown)
    operators = sum(normal.count(sign) for sign in "+-=")
    return 0.7 * len(small) + len(normal) - 0.6 * normal.count("'") + 1.6 * operators


def display(lines: Iterable[str]) -> list[str]:
    """Return formulas below one another."""
    return [r"\begin{align*}", *(" \\\\\n".join(lines)).split("\n"), r"\end{align*}"]


def _head(equations: Equations[Sum]) -> Iterator[str]:
    """Yield the equation of motion in matrices, and the meaning of its right side."""
    terms = [name + NAMES[rate] if rate else name for name, rate in equations.terms]
    right = " + ".join([r"\tau", *(block.name for block in equations.others)])
    right += r" + \Psi^{T}\lambda" if equations.side("closures") else ""
    yield f"{' + '.join(terms) or '0'} &= {right}"
    if equations.side("closures"):
        drift = r" + \mathrm{gap}_{t}" if equations.mechanism.driven else ""
        more = [rf"\Psi\dot{{q}}{drift} = 0", r"\Psi\ddot{q} + \dot{\Psi}\dot{q} = 0"]
        yield r", \quad ".join([r"\mathrm{gap} &= 0", *more])
    if equations.mechanism.passive:
        driven = ", ".join(equations.driven(r"\tau_{{{}}}"))
        yield rf"\tau &= ({driven})^{{T}}"


def _entry(entry: Sum | Formula) -> str:
    """Return an entry's formula, protected if it begins with a bracket."""
    text = LATEX.text(entry)
    return "{}" + text if text.startswith("[") else text


def _block(block: Block[Sum]) -> Iterator[str]:
    """Yield a whole matrix or vector if the page is wide enough, else its entries."""
    name = NAMES.get(block.name, block.name)
    if block.zero:
        yield f"{name} &= 0"
        return
    texts = [[_entry(entry) for entry in row] for row in block.rows]
    if block.head.shape == "diagonal":
        entries = r",\; ".join(texts[k][k] for k in range(len(texts)))
        yield rf"{name} &= \operatorname{{diag}}({entries})".replace(GLUE, " ")
        return
    widths = [max(map(measure, column)) for column in zip(*texts, strict=True)]
    if sum(widths) + 2 * len(widths) <= MATRIX_WIDTH:
        rows = " \\\\\n".join(" & ".join(row) for row in texts).replace(GLUE, " ")
        yield f"{name} &= \\begin{{bmatrix}}\n{rows}\n\\end{{bmatrix}}"
        return

    def label(i: int, j: int) -> str:
        bare = f"({name})" if block.name == "Psidot_qd" else name
        return f"{bare}_{{{block.numbers(i, j, ',')}}}"

    for places, entry in block.listed():
        yield from equation(" = ".join(label(*place) for place in places), entry)
    zeros = [label(*place) for place in block.zeros]
    for k in range(0, len(zeros), ZEROS):
        first, *others = zeros[k : k + ZEROS]
        yield f"{first} &= {' = '.join([*others, '0'])}"


def equation(left: str, entry: Sum | Formula) -> Iterator[str]:
    """Yield the lines of `left = entry`."""
    first, *more = broken(_entry(entry), WIDTH - round(measure(left)) - 6, measure)
    yield f"{left} &= {first}"
    yield from (rf"&\quad {part.strip()}" for part in more)


def _legend(equations: Equations[Sum]) -> Iterator[str]:
    """Yield tables of variables and parameters, and remarks."""
    variables = [
        (f"${NAMES.get(x.name, x.name)}_{{{x.numbers.replace('_', ',')}}}$", "", x.unit, x.meaning)
        for x in equations.variables()
    ]
    parameters = [
        (f"${subscripted(x.name)}$", f"${_number(x.value)}$", x.unit, x.meaning)
        for x in equations.parameters
    ]
    yield r"\begin{longtable}{@{}lllp{0.6\textwidth}@{}}"
    for name, value, unit, meaning in [*variables, *parameters]:
        yield rf"{name} & {value} & {escaped(unit)} & {escaped(meaning)} \\"
    yield r"\end{longtable}"
    names = [(NAMES.get(block.name, block.name), block.head.unit) for block in equations.blocks]
    units = ", ".join(f"${name}$ in {escaped(unit)}" for name, unit in names)
    yield f"SI units and radians: {units}."
    christoffel = r"$C$ is the Christoffel one: $\dot{M} - 2C$ is skew-symmetric."
    yield from equations.remarks(lambda name: f"${subscripted(name)}$", christoffel)
