"""The tree of a scene in symbols: the paths to its links, its bodies and its points.

A point is `constant + sum_k rho_k E_k` as in `mechanism.py`, but constant and rho are symbols.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from robodyn.equations.factoring import Key, Written, written
from robodyn.equations.force_parameters import SceneParameters
from robodyn.equations.symbolic import NOWHERE, ONE, ZERO, Planar, Sum
from robodyn.mechanics.mechanism import Mechanism, too_large
from robodyn.scene.scene import JointSpring, Load, Point


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

    def difference(
        self, first: tuple[Point, Planar], second: tuple[Point, Planar]
    ) -> tuple[Planar, dict[int, Planar]]:
        """The first of two such places less the second, without the terms that cancel."""
        constant, found = self.place(*first)
        other, terms = self.place(*second)
        for k, x in terms.items():
            found[k] = found.get(k, NOWHERE) - x
        return constant - other, {k: x for k, x in found.items() if x != NOWHERE}

    def spring(self, i: int) -> tuple[Planar, dict[int, Planar]]:
        """A spring between points, from its second end to its first."""
        spring = self.description.springs[i]
        assert not isinstance(spring, JointSpring)
        first, second = self.parameters.ends(i)
        return self.difference((spring.first, first), (spring.second, second))

    def load(self, i: int) -> dict[int, Planar]:
        """The coefficients of E of the point of load i, a force."""
        load = self.description.loads[i]
        assert isinstance(load, Load)
        assert load.point.link is not None
        return self.terms(load.point.link, self.parameters.load_point(i))

    def damping(self) -> list[Sum]:
        """Of the joints, by their own dampers and those of the springs at them."""
        damping = [self.parameters.damping(k) for k in range(self.n)]
        for i, spring in enumerate(self.description.springs):
            if isinstance(spring, JointSpring):
                damping[spring.joint] = damping[spring.joint] + self.parameters.spring_damping(i)
        return damping

    def closure_rows(self) -> Iterator[tuple[Sum, dict[int, Planar]]]:
        """offset and P_k of every row Re(sum_k P_k E_k) + offset = 0."""
        for c, closure in enumerate(self.description.closures):
            first = closure.first, self.parameters.side(c, "a")
            second = closure.second, self.parameters.side(c, "b")
            constant, R = self.difference(first, second)
            if closure.along is None:
                directions = [Planar(ONE, ZERO), Planar(ZERO, ONE)]
            else:
                directions = [self.parameters.normal(c)]
            for direction in directions:
                w = direction.conjugate
                yield (w * constant).x, {k: w * x for k, x in R.items()}

    def coupling_rows(self) -> Iterator[tuple[Sum, dict[int, Sum]]]:
        """offset and turns_k of every row sum_k turns_k q_k + offset = 0, k joints."""
        for c, coupling in enumerate(self.description.couplings):
            arm = self.parameters.arm(c)
            turns = {j: -(arm * self.parameters.ratio(c, j)) for j, _ in coupling.terms}
            yield -(arm * self.parameters.offset_angle(c)), {coupling.joint: arm, **turns}

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
