"""Recorded numbers as an arithmetic: what series of them are made of."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from robodyn.engines import expression
from robodyn.engines.arithmetic import Arithmetic, weighted
from robodyn.engines.expression import FUNCTIONS, Expression, Value


def _power(a: Value, exponent: float) -> Value:
    """a to a constant exponent, by a square root where that serves."""
    if abs(exponent) != 0.5:
        return expression.power(a, exponent)
    root = expression.call("sqrt", a)
    return root if exponent > 0.0 else 1.0 / root


def _or_nan(function: Callable[..., Value], *values: Value) -> Value:
    """The function of the values; nan of constants where it is undefined, as at every state."""
    try:
        return function(*values)
    except (ArithmeticError, ValueError):
        return math.nan


def _chosen(x: Value, knots: Sequence[float], values: Sequence[float]) -> Value:
    """One of the values, by the interval between increasing knots in which x is: a tree."""
    if len(values) == 1:
        return values[0]
    k = len(knots) // 2
    below = _chosen(x, knots[:k], values[: k + 1])
    above = _chosen(x, knots[k + 1 :], values[k + 1 :])
    if not isinstance(below, Expression) and below == above:
        return below
    return expression.choose(x, knots[k], below, above)


RECORDED = Arithmetic(
    cos=expression.cos,
    sin=expression.sin,
    power=partial(_or_nan, _power),
    divide=partial(_or_nan, operator.truediv),
    weigh=partial(weighted, keep=expression.keep),
    keep=expression.keep,
    chosen=_chosen,
    functions={name: partial(_or_nan, partial(expression.call, name)) for name in FUNCTIONS},
)

_WRITTEN: dict[str, object] = {
    f"_{name}": partial(expression.call, name) for name in (*FUNCTIONS, "abs")
}
_WRITTEN |= {"_pow": expression.power, "_atan2": expression.arctangent, "__builtins__": {}}


def evaluated(code: str, variables: Mapping[str, Value]) -> Any:
    """What code of `scene.expressions.Written` is of recorded numbers.

    NameError, TypeError, ValueError or AttributeError where it has what they have not.
    """
    return eval(code, {**_WRITTEN, **variables})
