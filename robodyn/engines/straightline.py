"""Straight-line Python code of formulas, generated and compiled once per mechanism.

An integrator evaluates one state at a time, ten thousand times.  There numpy's call overhead is
twenty times the arithmetic.  So the formulas of `engines/formulas.py` are written out as Python on
floats.  Blocks of many states are evaluated by `array_blocks.py`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn.engines import expression, formulas
from robodyn.engines.arithmetic import Planar, some
from robodyn.engines.expression import INPUTS, Expression, Value, needed
from robodyn.engines.formulas import Formula
from robodyn.engines.rounds import FEW_ROUNDS, SETTLED, Rounds, by_newton
from robodyn.mechanics.mechanism import Mechanism

if TYPE_CHECKING:
    from robodyn.mechanics.actuation import Actuation

_BINARY = {"+": 1, "-": 1, "*": 2, "/": 2}  # their precedence
_NAMES = {"rough": "pow"}  # of Python's functions of floats
DEEPEST = 50  # operations within one another; Python compiles no more than 200 brackets


def float_source(
    outputs: Sequence[Value],
    names: Mapping[int, str] = MappingProxyType({}),
    symbol: Callable[[str], str] = str,
    longest: float = math.inf,
    readable: bool = False,
    conditional: str = "{2} if {0} < {1} else {3}",
) -> tuple[list[str], list[str]]:
    """Return Python statements on floats, and the expression of each output.

    A node used once is written where it is used.  A node used more often, or nested deeper than
    DEEPEST, gets a local name.  `names` gives nodes, by index, a fixed name; "" gives none.
    Statements keep to `longest` characters if names do.  `symbol` translates input names.  With
    `readable`, local names count from 1, needless brackets are left out, and x (1/y) is written
    x/y.
    """
    uses, text = _uses(outputs), _Statements(names, symbol, readable, conditional)
    for node in needed(outputs):
        while len(text.write(node)) > longest:
            parts = [a for a in node.args if isinstance(a, Expression)]
            parts = [a for a in parts if not text.of(a).isidentifier()]
            if not parts:
                break
            text.name(max(parts, key=lambda a: len(text.of(a))))
        wanted = uses[node.index] > 1 or text.depths[node.index] > DEEPEST
        if node.op not in INPUTS and names.get(node.index, wanted):
            text.name(node)
    return text.lines, [text.shown(output, 0) for output in outputs]


@dataclass
class _Statements:
    """Text of nodes as `float_source` writes them, and the statements for named nodes."""

    names: Mapping[int, str]
    symbol: Callable[[str], str]
    readable: bool
    conditional: str
    lines: list[str] = field(default_factory=list)
    depths: dict[int, int] = field(default_factory=dict)  # operations that a node's text nests
    _text: dict[int, tuple[str, int]] = field(default_factory=dict)  # and its precedence
    _numbers: Iterator[int] = field(default_factory=lambda: count(1))

    def of(self, node: Expression) -> str:
        """Return the text of a node."""
        return self._text[node.index][0]

    def shown(self, a: Value | str, least: int) -> str:
        """Return the text of an argument, in brackets if its precedence is below `least`."""
        if isinstance(a, Expression):
            shown, precedence = self._text[a.index]
        elif isinstance(a, str):
            shown, precedence = a, 9
        else:
            shown, precedence = repr(float(a)), 9 if a >= 0 else 3
        return shown if precedence >= least else f"({shown})"

    def name(self, node: Expression) -> None:
        """Add a statement that gives the node a name."""
        number = next(self._numbers) if self.readable else node.index
        name = self.names.get(node.index) or f"t{number}"
        self.lines.append(f"{name} = {self.of(node)}")
        self._text[node.index], self.depths[node.index] = (name, 9), 0

    def write(self, node: Expression) -> str:
        """Return the text of a node from its arguments' text."""
        op, args = node.op, node.args
        if (precedence := _BINARY.get(op)) is not None:
            left = self.shown(args[0], precedence)
            right = self.shown(args[1], precedence + (not self.readable or op in "-/"))
            if precedence == 1:
                found = f"{left} {op} {right}", 1
            else:
                found = _readable(left, op, right) if self.readable else f"{left}{op}{right}", 2
        elif op in INPUTS:
            found = self.symbol(str(args[0])), 9
        elif op == "choose":
            found = self.conditional.format(*(self.shown(arg, 1) for arg in args)), 0
        elif op == "keep":
            assert isinstance(args[0], Expression)
            found = self._text[args[0].index]
        elif op == "neg":
            found = f"-{self.shown(args[0], 2)}", 2
        else:
            found = f"{_NAMES.get(op, op)}({', '.join(self.shown(arg, 0) for arg in args)})", 9
        self._text[node.index] = found
        parts = (self.depths[arg.index] for arg in args if isinstance(arg, Expression))
        self.depths[node.index] = 1 + max(parts, default=-1)
        return found[0]


def _readable(left: str, op: str, right: str) -> str:
    """Return a product or quotient as text; x (1/y) is x/y."""
    if op == "*" and left.startswith("1.0/"):
        left, right = right, left
    if op == "*" and right.startswith("1.0/"):
        return left + right[3:]
    return f"{left}{op}{right}"


def _uses(outputs: Sequence[Value]) -> Counter[int]:
    """Return how often each node is read, including as an output."""
    read = [a for node in needed(outputs) for a in node.args]
    return Counter(a.index for a in (*read, *outputs) if isinstance(a, Expression))


FloatFunction = Callable[..., tuple[float, ...]]
RateFunction = Callable[[float, Any], Any]


def compile_floats(
    formula: Formula, name: str, scope: Mapping[str, object] | None = None
) -> FloatFunction:
    """Compile a formula to a function of floats that returns a tuple.

    Arguments are in the order of the formula's inputs.  `scope` replaces functions of `math` for
    other kinds of numbers.
    """
    lines, outputs = float_source(formula.outputs + formula.pivots)
    body = "\n    ".join([*lines, f"return ({', '.join(outputs)},)"])
    return define(f"def {name}({', '.join(formula.inputs)}):\n    {body}\n", name, scope)


def compile_rates(
    mechanism: Mechanism,
    actuation: Actuation,
    *,
    work: bool,
    baumgarte: float,
    least_pivot: float,
    otherwise: RateFunction,
    write: Callable[..., Formula | None] = formulas.forward_formula,
) -> RateFunction:
    """Return a function that computes dy/dt for y = (q, qd, torque states[, work]).

    `write` returns the formula; constant torques are folded.  `otherwise` is called for states in
    which the relative pivot of a closure is below `least_pivot` or friction rounds do not settle,
    and for all states if there is no formula.
    """
    torques = actuation.constants
    formula = write(mechanism, torques, baumgarte, work)
    if formula is None:
        return otherwise
    n = mechanism.n
    needed = formula.outputs[:n] + formula.pivots + formula.outputs[n + len(mechanism.rows) :]
    rounds = [] if formula.rounds is None else formula.rounds.values
    body, outputs = float_source(needed + tuple(rounds))
    outputs, settling = outputs[: len(needed)], outputs[len(needed) :]
    # what tells the pivots, what rounds take, and what follows from them
    stages = [
        {f"t{node.index}" for node in expression.needed(values)}
        for values in (formula.pivots, rounds)
    ]
    parts: list[list[str]] = [[], [], []]
    for line in body:
        name = line.split()[0]
        parts[next((k for k, names in enumerate(stages) if name in names), 2)].append(line)
    rates = [f"qd{k}" for k in range(n)]
    names = [f"q{k}" for k in range(n)] + rates + actuation.own("z")
    power = ""
    if work:
        power = f", {outputs[-1]}"
        names.append("_")
    pivots = outputs[n : n + len(formula.pivots)]
    checks = [f"not {pivot} > {least_pivot!r}" for pivot in pivots]
    guard = [f"if {' or '.join(checks)}: return otherwise(t, y)"] if checks else []
    statements = [
        f"{', '.join(names)}, = y.tolist()",
        *actuation.lines,
        *parts[0],
        *guard,
        *parts[1],
        *([] if formula.rounds is None else _rounds(formula.rounds, settling)),
        *parts[2],
        f"return [{', '.join(rates + outputs[:n] + actuation.own('zd'))}{power}]",
    ]
    # an integrator's trial step may overflow, or leave a torque's domain: it must try a shorter one
    source = "\n        ".join(["def rates(t, y):\n    try:", *statements])
    source += "\n    except ZeroDivisionError: return otherwise(t, y)"
    source += f"\n    except (ArithmeticError, ValueError): return [nan] * {len(names)}\n"
    function: RateFunction = define(
        source, "rates", scope={**actuation.scope, "otherwise": otherwise, "settled": _settled}
    )
    return function


def _rounds(rounds: Rounds, values: list[str]) -> list[str]:
    """Return statements that solve for f0, f1, ... from the sources of `rounds.values`.

    States in which they do not settle are passed to `otherwise`.
    """
    c, parts, given = len(rounds.part), iter(values), []

    def name(text: str, called: str) -> str:
        """Return the name of a value; add a statement unless it is a name or number."""
        if text.isidentifier():
            return text
        given.append(f"{called} = {text}")
        return called

    def planar(z: Planar, called: str) -> str:
        """Return the name of a planar value, real if its y is zero; "" if it is zero."""
        x, y = next(parts), next(parts)
        if not some(*z[1:]):
            return name(x, called) if some(z[0]) else ""
        return name(f"complex({x}, {y})", called)

    part = [name(next(parts), f"f_part{i}") for i in range(c)]
    N = [planar(z, f"f_N{i}") for i, z in enumerate(rounds.N)]
    B = [[planar(z, f"f_B{j}_{i}") for i, z in enumerate(row)] for j, row in enumerate(rounds.B)]
    again = []
    for i in range(c):
        terms = [N[i], *(f"f{j}*{B[j][i]}" for j in range(c) if B[j][i])]
        again.append(f"{part[i]}*abs({' + '.join(filter(None, terms)) or '0.0'})")
    all_f, before = (", ".join(f"{x}{i}" for i in range(c)) for x in ("f", "f_old"))
    largest = f"max({', '.join(f'abs(f{i})' for i in range(c))}, 0.0)"
    moved = " or ".join(f"abs(f{i} - f_old{i}) > f_least" for i in range(c))
    rows = ", ".join(f"[{', '.join(x or '0.0' for x in row)}]" for row in B)
    return [
        *given,
        f"{all_f}, = {', '.join(f'{part[i]}*abs({N[i] or 0.0})' for i in range(c))},",
        f"for _ in range({FEW_ROUNDS}):",
        f"    {before}, = {all_f},",
        f"    {all_f}, = {', '.join(again)},",
        f"    f_least = {SETTLED!r}*{largest}",
        f"    if f_least < inf and not ({moved}): break",
        "else:",
        f"    f_found = settled([{', '.join(part)}], [{', '.join(x or '0.0' for x in N)}], "
        f"[{rows}], [{before}])",
        "    if f_found is None: return otherwise(t, y)",
        f"    {all_f}, = f_found",
    ]


def _settled(*given: list[Any]) -> list[float] | None:
    """Apply `by_newton` to lists."""
    found = by_newton(*map(np.array, given))
    return None if found is None else found.tolist()


def compile_closing(
    formula: Formula, passes: int, least_pivot: float, rounding: float, next_to_it: float
) -> Callable[[float, list[float]], tuple[list[float], float] | None]:
    """Return a function of t, y = (q, qd, ...) that returns the closed y and least pivot.

    It takes Newton steps by `formulas.projection_formula`.  A gap below `rounding` (m) is left
    alone; one below `next_to_it` needs only one more step.  The function returns None if a pivot is
    below `least_pivot`.
    """
    lines, outputs = float_source(formula.outputs + formula.pivots)
    inputs = tuple(name for name in formula.inputs if name != "t")
    n = len(inputs) // 2
    gaps = len(formula.pivots)
    again = formula.outputs[:n] + formula.outputs[2 * n :] + formula.pivots
    names = {f"t{node.index}" for node in expression.needed(again)}
    once = [line for line in lines if line.split()[0] not in names]  # for the rates alone
    q, qd = inputs[:n], outputs[n : 2 * n]
    gap, pivots = outputs[2 * n : 2 * n + gaps], outputs[2 * n + gaps :]

    def within(limit: float) -> str:
        return " and ".join(f"{-limit!r} <= {name} <= {limit!r}" for name in gap)

    least = f"min({', '.join(pivots)})" if gaps > 1 else pivots[0]
    body = [
        *(line for line in lines if line not in once),
        f"quality = {least}",
        f"if not quality > {least_pivot!r}: return None",
        f"if {within(rounding)}: break",
        f"last = {within(next_to_it)}",
        f"{', '.join(q)}, = {', '.join(outputs[:n])},",
        "if last: break",
    ]
    head = f"def close(t, y):\n  {', '.join(inputs)}, = y[:{2 * n}]\n"
    loop = f"  for _ in range({passes}):\n    " + "\n    ".join(body)
    found = f"return [{', '.join([*q, *qd])}, *y[{2 * n}:]], quality\n"
    return define("\n  ".join([head + loop, *once, found]), "close")


def define(source: str, name: str, scope: Mapping[str, object] | None = None) -> Callable[..., Any]:
    """Return the function `name` of a source, which may use names in `scope`."""
    known = (*expression.FUNCTIONS, "pow", "atan2", "nan", "inf")
    names: dict[str, object] = {name: getattr(math, name) for name in known} | dict(scope or {})
    exec(compile(source, f"<robodyn straight-line {name}>", "exec"), names)
    function = names[name]
    assert callable(function)
    return function
