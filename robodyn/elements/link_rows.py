"""Points of a mechanism, and rows for positions and motions of its links."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from robodyn.elements.program import (
    Anchored,
    Derivative,
    Given,
    Integral,
    PlanarSum,
    Program,
    Rate,
    Scaled,
    Slide,
    Slot,
    Turn,
)
from robodyn.elements.values import Point
from robodyn.tables.records import Record


class PlanarPoint(Record):
    """A point `constant + sum_k coefficient_k X_k` of the mechanism, m."""

    constant: complex
    terms: Sequence[tuple[int, complex]]  # (k, coefficient of X_k), nonzero ones only


class Tree(Protocol):
    """What elements need to know of the links of a scene; see `link_tree.Tree`."""

    @property
    def frames(self) -> Sequence[int | None]: ...
    def turned(self, k: int, at: complex) -> complex: ...
    def point(self, point: Point) -> PlanarPoint: ...
    def difference(self, first: Point, second: Point) -> PlanarPoint: ...


class Links(Protocol):
    """What rows read of a mechanism; see `planar_model.Mechanism`."""

    @property
    def n(self) -> int: ...
    @property
    def link_names(self) -> tuple[str, ...]: ...
    @property
    def parent(self) -> tuple[int | None, ...]: ...
    @property
    def above(self) -> tuple[int | None, ...]: ...
    @property
    def slides(self) -> tuple[int, ...]: ...
    @property
    def frames(self) -> tuple[int | None, ...]: ...
    @property
    def tree(self) -> Tree: ...
    @property
    def weights(self) -> tuple[complex, ...]: ...
    def name_of(self, element: Any) -> str: ...


class LinkRows:
    """X and P = X'' of the coordinates of a mechanism, and slots that follow from them.

    `x` are the coordinates' own slots: E of a link that turns, s of one that slides.
    """

    mechanism: Links

    def __init__(self, mechanism: Links) -> None:
        self.mechanism, self.program = mechanism, Program()
        program = self.program
        slides = set(mechanism.slides)
        self.x = [program.add(Slide(k) if k in slides else Turn(k)) for k in range(mechanism.n)]
        self.X = list(self.x)
        for k in mechanism.slides:
            if (d := mechanism.frames[k]) is not None:
                self.X[k] = program.add(Scaled(self.x[k], self.x[d]))
        self.P = [program.add(Derivative(program.add(Derivative(X)))) for X in self.X]
        self.children: list[list[int]] = [[] for _ in self.x]
        for k, above in enumerate(mechanism.parent):
            if above is not None:
                self.children[above].append(k)

    def w(self, k: int) -> Slot:
        """Return the angular velocity of link k, which turns."""
        return self.program.add(Rate(self.x[k]))

    def coordinate(self, k: int) -> Slot:
        """Return coordinate k: an angle, or displacement."""
        if k in self.mechanism.slides:
            return self.x[k]
        return self.program.add(Integral(self.w(k), f"alpha{k}"))

    def v(self, j: int) -> Slot:
        """Return the rate qd of joint j."""
        if j in self.mechanism.slides:
            return self.program.add(Derivative(self.x[j]))
        above = self.mechanism.above[j]
        if above is None:
            return self.w(j)
        relative = self.program.sum((1.0, self.w(j)), (-1.0, self.w(above)))
        return self.program.add(Anchored(relative, f"qd{j}"))

    def q(self, j: int) -> Slot:
        """Return the angle, or displacement, of joint j."""
        if j in self.mechanism.slides:
            return self.x[j]
        return self.program.add(Integral(self.v(j), f"q{j}"))

    def variable(self, name: str) -> Slot:
        """Return the slot of t, q0.. or qd0..."""
        if name == "t":
            return self.program.add(Given("t"))
        return self.v(int(name[2:])) if name.startswith("qd") else self.q(int(name[1:]))

    def direction(self, link: int) -> Slot | None:
        """Return E of a link; None if it is that of the ground, 1."""
        frame = self.mechanism.frames[link]
        return None if frame is None else self.x[frame]

    def point(self, point: PlanarPoint) -> Slot:
        """Return a point of the mechanism."""
        number = self.program.planar_number
        terms = tuple((number(c), self.X[k]) for k, c in point.terms)
        return self.program.add(PlanarSum(number(point.constant), terms))
