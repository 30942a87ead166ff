"""Rows of varying quantities: spring laws, and loads by expressions and tables.

A table, linear on each piece from x_k on, is with values F_k and slopes s_k

    F = F_k + s_k xi      U = U_k + F_k xi + s_k xi^2/2      xi = x - x_k

A zigzag between 1 and 2 from row to row shows the interval: its line at the start of a series step
meets no other part of it, so a step that passes a row shows.  The energy of an expression is x
times the integral of F(x u) over u from 0 to 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Any

from robodyn.elements.link_rows import LinkRows
from robodyn.elements.program import Product, Slot, Step
from robodyn.errors import InputError
from robodyn.mechanics.expression_rows import ExpressionRows
from robodyn.scene.expressions import fold
from robodyn.scene.scene import Law, Signal, Table
from robodyn.scene.syntax import Node

NODES = 40  # of the energy's rule, where F is no polynomial
FLATTENED = 3  # u = s^3: what is not smooth where the spring is free is smooth in s


def signal_rows(
    rows: LinkRows, signal: Signal, own: Mapping[str, Slot]
) -> tuple[Slot, list[tuple[Slot, float]]]:
    """Return the slot of a signal, and slots that may bend within a step, with their arms.

    `own` has a spring's x and v.
    """
    if isinstance(signal, Table):
        lines = _Lines(rows, signal, own)
        return lines.value(), [(lines.zigzag(), lines.bend)]
    slot = _read(rows, signal, own)
    smooth = not signal.names or degree(signal.node) is not None
    return slot, [] if smooth else [(slot, 1.0)]


def stored_energy(rows: LinkRows, signal: Signal, x: Slot) -> Slot:
    """Return the integral of a spring's force from its free length to extension x."""
    if isinstance(signal, Table):
        return _Lines(rows, signal, {"x": x}).energy()
    program = rows.program
    terms = [
        (weight, _read(rows, signal, {"x": program.sum((u, x))}))
        for u, weight in _rule(degree(signal.node))
    ]
    return program.add(Product(x, program.sum(*terms)))


def _read(rows: LinkRows, law: Law, own: Mapping[str, Slot]) -> Slot:
    def named(name: str) -> Slot:
        return own[name] if name in own else rows.variable(name)

    reader = ExpressionRows(rows.program, named, lambda what: InputError(f"{law.text}: {what}"))
    return reader.slot(reader.read(law.node))


def degree(tree: Node) -> int | None:
    """Return the degree of a polynomial in its variables; None if it is none."""
    return fold(tree, lambda x: int(isinstance(x, str)), _degree)


def _degree(node: tuple[Any, ...], parts: list[int | None]) -> int | None:
    operation, a, b = node[0], parts[0], parts[-1]
    if a is None or b is None:
        return None
    match operation:
        case "neg":
            return a
        case "+" | "-":
            return max(a, b)
        case "*":
            return a + b
        case "/" if b == 0:
            return a
        case "**" if isinstance(node[2], float):
            return int(a * node[2]) if node[2] >= 0.0 else None
    return None


def _rule(degree: int | None) -> list[tuple[float, float]]:
    """Return nodes u and weights on 0 < u < 1 of a quadrature exact up to a degree."""
    import numpy as np  # energies are evaluated by those who have it

    nodes, weights = np.polynomial.legendre.leggauss(NODES if degree is None else degree // 2 + 1)
    s, w = 0.5 * (1.0 + nodes), 0.5 * weights
    if degree is None:
        s, w = s**FLATTENED, w * FLATTENED * s ** (FLATTENED - 1)
    return list(zip(s.tolist(), w.tolist(), strict=True))


class _Lines:
    """The rows of a table at the slot of its variable."""

    def __init__(self, rows: LinkRows, table: Table, own: Mapping[str, Slot]) -> None:
        self.program, self.table = rows.program, table
        self.at = own[table.over] if table.over in own else rows.variable(table.over)
        self.lines = table.lines
        self.x, self.F, self.slopes = self.lines.x, self.lines.first, self.lines.slopes
        self.xi = self._beyond(self.x)

    @property
    def bend(self) -> float:
        """The error of F next to a row if the zigzag is off by 1."""
        bends = [abs(b - a) for a, b in pairwise(self.slopes)]
        if self.table.repeats:
            bends.append(abs(self.slopes[0] - self.slopes[-1]))
        wide = max(b - a for a, b in pairwise(self.x))
        ends = zip(self.lines.last, self.F[1:], strict=False)
        jump = max((abs(b - a) for a, b in ends), default=0.0)
        return 0.5 * wide * max(bends, default=0.0) + jump or 1.0

    def value(self) -> Slot:
        """Return F."""
        return self._line(self.x, self.F, self.slopes, self.xi)

    def zigzag(self) -> Slot:
        """Return a zigzag between 1 and 2 from row to row."""
        x = self.x
        if self.table.repeats and len(x) % 2 == 0:  # it must meet its own beginning
            k = max(range(len(x) - 1), key=lambda k: x[k + 1] - x[k])
            x = (*x[: k + 1], 0.5 * (x[k] + x[k + 1]), *x[k + 1 :])
        values = [1.0 + k % 2 for k in range(len(x))]
        return self._line(x, values, self._slopes(x, values), self._beyond(x))

    def energy(self) -> Slot:
        """Return U, zero at x = 0, or at the first row if the table does not contain 0."""
        widths = [b - a for a, b in pairwise(self.x)]
        each = zip(widths, self.F, self.lines.last, strict=True)
        parts = [0.5 * h * (a + b) for h, a, b in each]
        U = list(accumulate(parts, initial=0.0))
        free = 0.0
        for k, (a, b) in enumerate(pairwise(self.x)):
            if a <= 0.0 <= b:
                free = U[k] - a * (self.F[k] - 0.5 * self.slopes[k] * a)
        square = self.program.add(Product(self.xi, self.xi))
        return self.program.sum(
            (1.0, self._step(self.x, [u - free for u in U[:-1]])),
            (1.0, self.program.add(Product(self._step(self.x, self.F), self.xi))),
            (0.5, self.program.add(Product(self._step(self.x, self.slopes), square))),
        )

    @staticmethod
    def _slopes(x: Sequence[float], y: Sequence[float]) -> list[float]:
        rises = zip(pairwise(y), pairwise(x), strict=True)
        return [(d - c) / (b - a) for (c, d), (a, b) in rises]

    def _line(
        self, x: Sequence[float], y: Sequence[float], slopes: Sequence[float], xi: Slot
    ) -> Slot:
        """Return y_k + slope_k xi."""
        program = self.program
        rising = program.add(Product(self._step(x, slopes), xi))
        return program.sum((1.0, self._step(x, y[: len(slopes)])), (1.0, rising))

    def _beyond(self, x: Sequence[float]) -> Slot:
        """Return the distance of the variable from the row below it."""
        rise = self.x[-1] - self.x[0] if self.table.repeats else 0.0
        return self.program.sum((1.0, self.at), (-1.0, self._step(x, x[:-1], rise)))

    def _step(self, x: Sequence[float], values: Sequence[float], rise: float = 0.0) -> Slot:
        """Return one value per interval; nan beyond a table that does not repeat."""
        inner = tuple(x[1:-1])
        if self.table.repeats:
            first, period = x[0], x[-1] - x[0]
            return self.program.add(Step(self.at, inner, tuple(values), first, period, rise))
        end = math.nextafter(x[-1], math.inf)
        around = (math.nan, *values, math.nan)
        return self.program.add(Step(self.at, (x[0], *inner, end), around))
