"""Numbers that series are made of: what an engine must tell of them, and their planar products.

Plain floats 0.0 and 1.0 are structural: they are there whatever the scene's numbers are, and
products and sums with them cost nothing.
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
    """One of the values, by the interval between increasing knots in which a number x is."""
    return values[bisect_right(knots, x)]


def times(a: Value, b: Value) -> Value:
    """a b, without the products of a structural zero or one."""
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
    """a + b, without adding a structural zero."""
    if type(a) is float and a == 0.0:
        return b
    if type(b) is float and b == 0.0:
        return a
    return a + b


def over(a: Value, k: Value) -> Value:
    """a / k; of recorded numbers a product with 1/k, of longer ones to their last digit."""
    if type(a) is float and a == 0.0:
        return 0.0
    return a / float(k) if type(k) is int else a * (1.0 / (1.0 * k))


def convolution(x: Any, y: Any, m: int, first: int, last: int) -> Value:
    """Sum of x_j y_{m-j} for j from `first` to `last`."""
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
    """Sum of (slope j + level) x_j y_{m-j} for j from `first` to `last`."""
    total: Value = 0.0
    for j in range(first, last + 1):
        total = plus(total, times(keep(times(slope * j + level, x[j])), y[m - j]))
    return total


@dataclass(eq=False, repr=False)
class Arithmetic:
    """The functions of one kind of numbers; +, -, *, / are the numbers' own."""

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
    """a b of complex numbers."""
    return (
        plus(times(a[0], b[0]), times(-1.0, times(a[1], b[1])) if some(a[1], b[1]) else 0.0),
        plus(times(a[0], b[1]), times(a[1], b[0])),
    )


def some(*values: Value) -> bool:
    return not any(type(x) is float and x == 0.0 for x in values)


def difference(a: Value, b: Value) -> Value:
    """a - b, without a structural zero."""
    if type(b) is float and b == 0.0:
        return a
    return a - b


def conjugate_times(a: Planar, b: Planar) -> Planar:
    """conj(a) b."""
    return (
        plus(times(a[0], b[0]), times(a[1], b[1])),
        difference(times(a[0], b[1]), times(a[1], b[0])),
    )


def planar_plus(a: Planar, b: Planar) -> Planar:
    """a + b of complex numbers."""
    return plus(a[0], b[0]), plus(a[1], b[1])


def entries(values: Sequence[Value] | Mapping[int, Value]) -> dict[int, Value]:
    """Those that are not zero at every state, by their places."""
    items = values.items() if isinstance(values, Mapping) else enumerate(values)
    return {k: value for k, value in items if some(value)}


def dot(a: Mapping[int, Value], b: Mapping[int, Value] | Sequence[Value]) -> Value:
    """The sum of products of what stands in the same places; a sequence has all of them."""
    total: Value = 0.0
    for k, x in a.items():
        if not isinstance(b, Mapping) or k in b:
            total = total + x * b[k]
    return total
