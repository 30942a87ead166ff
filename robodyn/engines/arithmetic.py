"""Arithmetic over which series are computed, and products of planar numbers.

The plain floats 0.0 and 1.0 are structural: they do not depend on the scene's numbers, and products
and sums with them cost nothing.
"""

from __future__ import annotations

import math
import operator
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

Value = Any
Planar = tuple[Value, Value]

ZERO: Planar = (0.0, 0.0)


def chosen(x: Value, knots: Sequence[float], values: Sequence[float]) -> Value:
    """Return the value for the interval between increasing `knots` that contains x."""
    return values[bisect_right(knots, x)]


def times(a: Value, b: Value) -> Value:
    """Return a b; a structural zero or one costs no product."""
    if type(a) is float:
        if a == 0.0:
            return 0.0
        if a == 1.0:
            return b
    if type(b) is float:
        if b == 0.0:
            return 0.0
        if b == 1.0:
            return a
    return a * b


def plus(a: Value, b: Value) -> Value:
    """Return a + b; a structural zero costs no sum."""
    if type(a) is float and a == 0.0:
        return b
    if type(b) is float and b == 0.0:
        return a
    return a + b


def over(a: Value, k: Value) -> Value:
    """Return a / k; recorded numbers are multiplied by 1/k."""
    if type(a) is float and a == 0.0:
        return 0.0
    return a / float(k) if type(k) is int else a * (1.0 / (1.0 * k))


def convolution(x: Any, y: Any, m: int, first: int, last: int) -> Value:
    """Return the sum of x_j y_{m-j} for j from `first` to `last`."""
    total: Value = 0.0
    if x is y and first + last == m:  # a square: equal terms once
        for j in range(first, (m + 1) // 2):
            total = plus(total, times(x[j], x[m - j]))
        total = times(2.0, total)
        return plus(total, times(x[m // 2], x[m // 2])) if m % 2 == 0 else total
    for j in range(first, last + 1):
        total = plus(total, times(x[j], y[m - j]))
    return total


def weighted(
    x: Any,
    y: Any,
    m: int,
    first: int,
    last: int,
    slope: float,
    level: Value = 0.0,
    keep: Callable[[Value], Value] = lambda value: value,
) -> Value:
    """Return the sum of (slope j + level) x_j y_{m-j} for j from `first` to `last`."""
    total: Value = 0.0
    for j in range(first, last + 1):
        total = plus(total, times(keep(times(slope * j + level, x[j])), y[m - j]))
    return total


@dataclass(eq=False, repr=False)
class Arithmetic:
    """Functions of one kind of numbers; +, -, *, / are operators of the numbers themselves."""

    cos: Callable[[Value], Value]
    sin: Callable[[Value], Value]
    power: Callable[[Value, float], Value]
    functions: dict[str, Callable[[Value], Value]] = field(default_factory=dict)
    # sum of x_j y_{m-j} for j from first to last, and of (slope j + level) x_j y_{m-j}
    convolve: Callable[[Any, Any, int, int, int], Value] = convolution
    weigh: Callable[[Any, Any, int, int, int, float, Value], Value] = weighted
    room: Callable[[int], Any] = lambda orders: [0.0] * orders
    chosen: Callable[[Value, Sequence[float], Sequence[float]], Value] = chosen
    divide: Callable[[Value, Value], Value] = operator.truediv
    keep: Callable[[Value], Value] = lambda value: value  # marks what is used again and again


_FUNCTIONS = ("exp", "tanh", "sin", "cos", "sinh", "cosh", "log", "atan", "asin", "acos", "floor")
FLOATS = Arithmetic(
    cos=math.cos,
    sin=math.sin,
    power=math.pow,
    functions={name: getattr(math, name) for name in _FUNCTIONS},
)


def planar_times(a: Planar, b: Planar) -> Planar:
    """Return the complex product a b."""
    return (
        plus(times(a[0], b[0]), times(-1.0, times(a[1], b[1])) if some(a[1], b[1]) else 0.0),
        plus(times(a[0], b[1]), times(a[1], b[0])),
    )


def some(*values: Value) -> bool:
    return not any(type(x) is float and x == 0.0 for x in values)


def difference(a: Value, b: Value) -> Value:
    """Return a - b; a structural zero costs nothing."""
    if type(b) is float and b == 0.0:
        return a
    return a - b


def conjugate_times(a: Planar, b: Planar) -> Planar:
    """Return conj(a) b."""
    return (
        plus(times(a[0], b[0]), times(a[1], b[1])),
        difference(times(a[0], b[1]), times(a[1], b[0])),
    )


def planar_plus(a: Planar, b: Planar) -> Planar:
    """Return the complex sum a + b."""
    return plus(a[0], b[0]), plus(a[1], b[1])


def entries(values: Sequence[Value] | Mapping[int, Value]) -> dict[int, Value]:
    """Return the entries that are not structurally zero, by index."""
    items = values.items() if isinstance(values, Mapping) else enumerate(values)
    return {k: value for k, value in items if some(value)}


def dot(a: Mapping[int, Value], b: Mapping[int, Value] | Sequence[Value]) -> Value:
    """Return the dot product of two vectors; a mapping lists its nonzero entries."""
    total: Value = 0.0
    for k, x in a.items():
        if not isinstance(b, Mapping) or k in b:
            total = total + x * b[k]
    return total
