"""Rows of varying quantities: spring laws, and loads by expressions and tables.

A table, linear on each piece from x_k on, is with values F_k and slopes s_k

    F = F_k + s_k xi      U = U_k + F_k xi + s_k xi^2/2      xi = x - x_k

The series of a step knows the piece on which it starts, and no row beyond: `edges` tell where it
ends.  The energy of an expression is x times the integral of F(x u) over u from 0 to 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Any

from robodyn.elements.link_rows import LinkRows
from robodyn.elements.program import Product, Program, Slot, Step
from robodyn.errors import InputError
from robodyn.mechanics.expression_rows import ExpressionRows
from robodyn.scene.expressions import fold
from robodyn.scene.scene import Law, Signal, Table
from robodyn.scene.syntax import Node

NODES = 40  # of the energy's rule, where F is no polynomial
RESOLVED = 1e-6  # of x: 1e-8 of that, by which steps pass a row, is some 50 roundings
FLATTENED = 3  # u = s^3: what is not smooth where the spring is free is smooth in s


def signal_rows(rows: LinkRows, signal: Signal, own: Mapping[str, Slot]) -> Slot:
    """Return the slot of a signal; add a table's edges to those of the program.

    `own` has a spring's x and v.
    """
    if not isinstance(signal, Table):
        return _read(rows, signal, own)
    lines = _Lines(rows, signal, own)
    value = lines.value()
    between = edges(rows.program, lines.at, lines.x, signal.repeats)
    rows.program.named.setdefault("edges", []).extend(between)
    return value


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


def step(
    at: Slot, x: Sequence[float], repeats: bool, values: Sequence[float], rise: float = 0.0
) -> Step:
    """Return one value per interval between rows x; nan beyond rows that do not repeat."""
    inner = tuple(x[1:-1])
    if repeats:
        return Step(at, inner, tuple(values), x[0], x[-1] - x[0], rise)
    end = math.nextafter(x[-1], math.inf)
    return Step(at, (x[0], *inner, end), (math.nan, *values, math.nan))


def distance_from_row(program: Program, at: Slot, x: Sequence[float], repeats: bool) -> Slot:
    """Return xi, the distance of a variable from the row below it."""
    rise = x[-1] - x[0] if repeats else 0.0
    return program.sum((1.0, at), (-1.0, program.add(step(at, x, repeats, x[:-1], rise))))


def edges(program: Program, at: Slot, x: Sequence[float], repeats: bool) -> list[Slot]:
    """Return the distances of a variable from the rows below and above it, both positive.

    They are in widths of the narrowest piece, or of RESOLVED of the largest x if that is wider.
    """
    widths = [b - a for a, b in pairwise(x)]
    scale = 1.0 / max(min(widths), RESOLVED * max(-x[0], x[-1]))
    xi = distance_from_row(program, at, x, repeats)
    wide = program.add(step(at, x, repeats, [width * scale for width in widths]))
    return [
        program.sum((program.number(scale), xi)),
        program.sum((1.0, wide), (program.number(-scale), xi)),
    ]


class _Lines:
    """The rows of a table at the slot of its variable."""

    def __init__(self, rows: LinkRows, table: Table, own: Mapping[str, Slot]) -> None:
        self.program, self.table = rows.program, table
        self.at = own[table.over] if table.over in own else rows.variable(table.over)
        self.lines = table.lines
        self.x, self.F, self.slopes = self.lines.x, self.lines.first, self.lines.slopes
        self.xi = distance_from_row(self.program, self.at, self.x, table.repeats)

    def value(self) -> Slot:
        """Return F."""
        rising = self.program.add(Product(self._step(self.slopes), self.xi))
        return self.program.sum((1.0, self._step(self.F)), (1.0, rising))

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
            (1.0, self._step([u - free for u in U[:-1]])),
            (1.0, self.program.add(Product(self._step(self.F), self.xi))),
            (0.5, self.program.add(Product(self._step(self.slopes), square))),
        )

    def _step(self, values: Sequence[float], rise: float = 0.0) -> Slot:
        return self.program.add(step(self.at, self.x, self.table.repeats, values, rise))
