"""The tree of a scene in symbols: the paths to its links, its bodies and its points.

A point is `constant + sum_k rho_k E_k` as in `mechanism.py`, but constant and rho are symbols.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import NamedTuple

from robodyn.equations.factoring import Key, Written, written
from robodyn.equations.force_parameters import SceneParameters
from robodyn.equations.symbolic import NOWHERE, Planar, Sum
from robodyn.errors import InputError
from robodyn.mechanism import Mechanism
from robodyn.scene import Point


class Body(NamedTuple):
    """A mass, and the coefficients of E of its centre, by link from the ground on."""

    mass: Sum
    rho: dict[int, Planar]


class SymbolicScene:
    """The tree of a scene in symbols: paths, bodies and points."""

    def __init__(self, mechanism: Mechanism, numeric: bool) -> None:
        self.mechanism = mechanism
        self.n = mechanism.n
        self.description = mechanism.description
        self.numeric = numeric
        arms = [row.arm for row in mechanism.rows if row.closure is None]
        self.parameters = SceneParameters(mechanism.description, arms)
        self.path: list[tuple[int, ...]] = [()] * self.n  # the joints from the ground to each link
        for k in mechanism.order:
            above = mechanism.parent[k]
            self.path[k] = (*(() if above is None else self.path[above]), k)
        self.bodies = [self._bodies(k) for k in range(self.n)]

    def _bodies(self, k: int) -> list[Body]:
        """The link itself and its payload."""
        parts = [
            (self.parameters.mass(k), self.parameters.centre(k)),
            (self.parameters.payload(k), self.parameters.tip(k)),
        ]
        return [Body(mass, self.terms(k, at)) for mass, at in parts if mass]

    def terms(self, k: int, at: Planar) -> dict[int, Planar]:
        """The coefficients of E of a point of link k, `at` in its frame."""
        path = self.path[k]
        leaving = [*(self.parameters.hanging(j) for j in path[1:]), at]
        return {j: x for j, x in zip(path, leaving, strict=True) if x != NOWHERE}

    def place(self, point: Point, at: Planar) -> tuple[Planar, dict[int, Planar]]:
        """The constant and the coefficients of E of a point of a link or of the ground."""
        if point.link is None:
            return at, {}
        return self.parameters.hanging(self.path[point.link][0]), self.terms(point.link, at)

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
                limit = "masses, lengths or gravity are too large: their products overflow"
                raise InputError("links", where=self.description.source, limit=limit)
        return written(entry, levels)
