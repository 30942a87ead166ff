"""The tree of a scene in symbols: the paths to its links, its bodies and its points.

A point is `constant + sum_k rho_k E_k` as in `mechanism.py`, but constant and rho are symbols.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from robodyn.equations.factoring import Key, Written, written
from robodyn.equations.parameters import Parameters
from robodyn.equations.symbolic import ZERO, Planar, Sum
from robodyn.mechanics.mechanism import Mechanism, Tree, closure_rows, too_large
from robodyn.scene.scene import Point, Spring


class Body(NamedTuple):
    """A mass, and the coefficients of E of its centre, by link from the ground on."""

    mass: Sum
    rho: dict[int, Planar]


class SymbolicScene:
    """The tree of a scene in symbols: paths, bodies and points."""

    def __init__(
        self,
        mechanism: Mechanism,
        numeric: bool,
        watch: Callable[[], object] = lambda: None,
    ) -> None:
        """`watch` is called after each entry that is written."""
        self.mechanism = mechanism
        self.n = mechanism.n
        self.description = mechanism.description
        self.numeric = numeric
        self.watch = watch
        arms = [row.arm for row in mechanism.rows if row.closure is None]
        self.parameters = Parameters(mechanism.description, arms)
        self.path: list[tuple[int, ...]] = [()] * self.n  # the joints from the ground to each link
        for k in mechanism.order:
            above = mechanism.parent[k]
            self.path[k] = (*(() if above is None else self.path[above]), k)
        self.symbols: Any = self.parameters.scene  # Sum and Planar for numbers
        self.tree = Tree(self.symbols.links)
        self.bodies = [self._bodies(k) for k in range(self.n)]

    def _bodies(self, k: int) -> list[Body]:
        """The link itself and its payload."""
        link = self.symbols.links[k]
        parts = [(link.m, link.r), (link.payload, Planar(link.l, ZERO))]
        return [Body(mass, self.terms(Point(k, at))) for mass, at in parts if mass]

    def terms(self, point: Point) -> dict[int, Planar]:
        """The coefficients of E of a point of a link."""
        terms: Any = self.tree.point(point).terms
        return dict(terms)

    def spring(self, spring: Spring) -> tuple[Planar, dict[int, Planar]]:
        """A spring between points, from its second end to its first: constant, coefficients."""
        between: Any = self.tree.difference(spring.first, spring.second)
        return between.constant, dict(between.terms)

    def closure_rows(self) -> Iterator[tuple[Sum, dict[int, Planar]]]:
        """offset and P_k of every row Re(sum_k P_k E_k) + offset = 0."""
        row: Any
        for row in closure_rows(self.symbols, self.tree):
            yield row.offset, dict(row.P)

    def coupling_rows(self) -> Iterator[tuple[Sum, dict[int, Sum]]]:
        """offset and turns_k of every row sum_k turns_k q_k + offset = 0, k joints."""
        for arm, coupling in zip(self.parameters.arms, self.symbols.couplings, strict=True):
            turns = {j: -(arm * ratio) for j, ratio in coupling.terms}
            yield -(arm * coupling.angle), {coupling.joint: arm, **turns}

    def angle(self, j: int, k: int) -> tuple[int, ...]:
        """The joints whose angles make up that of link k against link j above it."""
        return tuple(sorted(self.path[k][len(self.path[j]) :]))

    def direction(self, k: int) -> tuple[int, ...]:
        """The joints whose angles make up alpha_k."""
        return tuple(sorted(self.path[k]))

    def written(self, entry: Sum, levels: Sequence[Key]) -> Written:
        """An entry as it is to be written."""
        if self.numeric:
            entry = entry.substituted(self.parameters.values)
            most = sys.float_info.max
            if any(not -most <= number <= most for number in entry.terms.values()):
                raise too_large(self.description)
        found = written(entry, levels)
        self.watch()
        return found
