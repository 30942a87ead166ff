"""Chebyshev's coefficients of a series, and the sums that bound them, in machine code."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from robodyn.engines.assembler import ADDRESS, SCALAR, Kernel, Module
from robodyn.tables.arrays import Array


def wide(order: int) -> int:
    """How many coefficients stand side by side, of order + 2."""
    return 8 * -(-(order + 2) // 8)


@lru_cache(maxsize=16)
def matrix(order: int) -> Array:
    """Chebyshev's coefficients of the powers on [0, 1] (rows); then weights that bound them.

    Those of all but the first, and of what the slope and the bend have besides their own.
    """
    size = wide(order)
    found = np.zeros((order + 5, size))
    found[0, 0] = 1.0
    for m in range(order + 1):  # x T_k = T_k / 2 + (T_{k-1} + T_{k+1}) / 4 on [0, 1]
        row = found[m]
        found[m + 1] = 0.5 * row
        found[m + 1, 1:] += 0.25 * row[:-1]
        found[m + 1, :-1] += 0.25 * row[1:]
        found[m + 1, 1] += 0.25 * row[0]
    k = np.arange(size, dtype=float)
    weights = (k > 0) * 1.0, (k > 1) * k**2, (k > 2) * k**2 * (k**2 - 1.0) / 3.0
    found[order + 2 :] = weights
    return found


def write_bounds(module: Module, most: int) -> None:
    """event_bounds(series, matrix, out): c_0, c_1, c_2, then the sums of |c_k| by its weights."""
    size, orders = wide(most), most + 2
    inner = Module(size)
    inner.functions = module.functions
    k = Kernel(inner, "event_bounds", (ADDRESS, ADDRESS, ADDRESS), "void")
    series, table, out = k.arguments
    with k.loop(k.whole(orders)) as m:
        total = k.carried(k.number(0.0))
        row = k.load(k.at(table, k.multiply(m, k.whole(size))))
        power = k.spread(k.load(k.at(series, m), SCALAR))
        k.becomes(total, k.add(total, k.multiply(power, row)))
    for i in range(3):
        k.store(k.lane(total, i), k.at(out, i))
    sizes = k.intrinsic("fabs", total)
    name = f"llvm.vector.reduce.fadd.v{size}f64"
    module.declare(name, SCALAR, SCALAR, k.numbers)
    for i in range(3):
        row = k.load(k.at(table, (orders + i) * size))
        weighed = k.multiply(sizes, row)
        total = k.op(SCALAR, f"call reassoc double @{name}({k.scalar(0.0)}, {weighed})")
        k.store(total, k.at(out, 3 + i))
    k.done()
