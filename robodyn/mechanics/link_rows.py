"""The rows of where the links of a mechanism are, and of how they move."""

from __future__ import annotations

from robodyn.mechanics.planar_model import Mechanism, PlanarPoint
from robodyn.mechanics.program import (
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


class LinkRows:
    """X, and P = X'', of the coordinates of a mechanism, and what follows from them.

    `x` are the coordinates' own slots: E of a link that turns, s of one that slides.
    """

    def __init__(self, mechanism: Mechanism) -> None:
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
        """The angular velocity of link k, which turns."""
        return self.program.add(Rate(self.x[k]))

    def coordinate(self, k: int) -> Slot:
        """Its angle, or displacement."""
        if k in self.mechanism.slides:
            return self.x[k]
        return self.program.add(Integral(self.w(k), f"alpha{k}"))

    def v(self, j: int) -> Slot:
        """The rate qd of joint j."""
        if j in self.mechanism.slides:
            return self.program.add(Derivative(self.x[j]))
        above = self.mechanism.above[j]
        if above is None:
            return self.w(j)
        relative = self.program.sum((1.0, self.w(j)), (-1.0, self.w(above)))
        return self.program.add(Anchored(relative, f"qd{j}"))

    def q(self, j: int) -> Slot:
        """The angle, or displacement, of joint j."""
        if j in self.mechanism.slides:
            return self.x[j]
        return self.program.add(Integral(self.v(j), f"q{j}"))

    def variable(self, name: str) -> Slot:
        """The slot of t, q0.. or qd0..."""
        if name == "t":
            return self.program.add(Given("t"))
        return self.v(int(name[2:])) if name.startswith("qd") else self.q(int(name[1:]))

    def direction(self, link: int) -> Slot | None:
        """E of a link; None: it is that of the ground, 1."""
        frame = self.mechanism.frames[link]
        return None if frame is None else self.x[frame]

    def point(self, point: PlanarPoint) -> Slot:
        """A point of the mechanism."""
        number = self.program.planar_number
        terms = tuple((number(c), self.X[k]) for k, c in point.terms)
        return self.program.add(PlanarSum(number(point.constant), terms))
