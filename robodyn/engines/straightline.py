"""The closed form of one mechanism as straight-line code, generated and compiled once.

An integrator evaluates one state ten thousand times, where numpy's call overhead is twenty times
the arithmetic.  So the formulas of `engines/formulas.py` are written out as Python on floats; on
blocks of many states `array_blocks.py` walks their nodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from robodyn.engines import expression, formulas, source_text
from robodyn.engines.formulas import Formula
from robodyn.mechanics.mechanism import Mechanism

if TYPE_CHECKING:
    from robodyn.mechanics.actuation import Actuation

FloatFunction = Callable[..., tuple[float, ...]]
RateFunction = Callable[[float, Any], Any]


def compile_floats(formula: Formula, name: str) -> FloatFunction:
    """A function of plain floats, in the order of the formula's inputs, to a tuple of floats."""
    lines, outputs = source_text.float_source(formula.outputs + formula.pivots)
    body = "\n    ".join([*lines, f"return ({', '.join(outputs)},)"])
    return define(f"def {name}({', '.join(formula.inputs)}):\n    {body}\n", name)


def compile_rates(
    mechanism: Mechanism,
    actuation: Actuation,
    *,
    work: bool,
    baumgarte: float,
    least_pivot: float,
    otherwise: RateFunction,
) -> RateFunction:
    """dy/dt for y = (q, qd, states of the torques' own), then the work done where it is wanted.

    Constant torques are folded in.  A state in which a closure's relative pivot does not exceed
    `least_pivot` is handed to `otherwise`; every state is, where there is no formula.
    """
    torques = actuation.constants
    formula = formulas.forward_formula(mechanism, torques, baumgarte, work)
    if formula is None:
        return otherwise
    n = mechanism.n
    needed = formula.outputs[:n] + formula.pivots + formula.outputs[n + len(mechanism.rows) :]
    body, outputs = source_text.float_source(needed)
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
        *body,
        *guard,
        f"return [{', '.join(rates + outputs[:n] + actuation.own('zd'))}{power}]",
    ]
    # an integrator's trial step may overflow, or leave a torque's domain: it must try a shorter one
    source = "\n        ".join(["def rates(t, y):\n    try:", *statements])
    source += "\n    except ZeroDivisionError: return otherwise(t, y)"
    source += f"\n    except (ArithmeticError, ValueError): return [nan] * {len(names)}\n"
    function: RateFunction = define(
        source, "rates", scope={**actuation.scope, "otherwise": otherwise}
    )
    return function


def compile_closing(
    formula: Formula, passes: int, least_pivot: float, rounding: float, next_to_it: float
) -> Callable[[list[float]], tuple[list[float], float] | None]:
    """Newton steps by `formulas.projection_formula` on y = (q, qd, ...): y closed, least pivot.

    What is open by `rounding` (m) at most stays where it is; from `next_to_it` one step closes it.
    None where a pivot does not exceed `least_pivot`.
    """
    lines, outputs = source_text.float_source(formula.outputs + formula.pivots)
    n = len(formula.inputs) // 2
    gaps = len(formula.pivots)
    again = formula.outputs[:n] + formula.outputs[2 * n :] + formula.pivots
    names = {f"t{node.index}" for node in expression.needed(again)}
    once = [line for line in lines if line.split()[0] not in names]  # for the rates alone
    q, qd = formula.inputs[:n], outputs[n : 2 * n]
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
    head = f"def close(y):\n  {', '.join(formula.inputs)}, = y[:{2 * n}]\n"
    loop = f"  for _ in range({passes}):\n    " + "\n    ".join(body)
    found = f"return [{', '.join([*q, *qd])}, *y[{2 * n}:]], quality\n"
    return define("\n  ".join([head + loop, *once, found]), "close")


def define(source: str, name: str, scope: Mapping[str, object] | None = None) -> Callable[..., Any]:
    """The function called `name` of a source that may name those of `scope`."""
    known = (*expression.FUNCTIONS, "pow", "atan2", "nan", "inf")
    names: dict[str, object] = {name: getattr(math, name) for name in known} | dict(scope or {})
    exec(compile(source, f"<robodyn straight-line {name}>", "exec"), names)
    function = names[name]
    assert callable(function)
    return function
