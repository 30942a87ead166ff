"""The rows of a scene's motion: directions, angles and points of its links."""

from __future__ import annotations

from dataclasses import dataclass, field

from robodyn.mechanics.planar_model import Mechanism, PlanarPoint
from robodyn.mechanics.program import (
    Anchored,
    Derivative,
    Given,
    Integral,
    PlanarSum,
    Program,
    Rate,
    Slot,
    Turn,
)


@dataclass
class LinkRows:
    """E, and P = E'', of the links of a mechanism, and what follows from them."""

    mechanism: Mechanism
    program: Program = field(default_factory=Program)

    def __post_init__(self) -> None:
        program = self.program
        self.E = [program.add(Turn(k)) for k in range(self.mechanism.n)]
        self.P = [program.add(Derivative(program.add(Derivative(E)))) for E in self.E]
        self.children: list[list[int]] = [[] for _ in self.E]
        for k, above in enumerate(self.mechanism.parent):
            if above is not None:
                self.children[above].append(k)

    def w(self, k: int) -> Slot:
        """The angular velocity of link k."""
        return self.program.add(Rate(self.E[k]))

    def alpha(self, k: int) -> Slot:
        """The angle of link k."""
        return self.program.add(Integral(self.w(k), f"alpha{k}"))

    def v(self, j: int) -> Slot:
        """The rate qd of joint j."""
        above = self.mechanism.parent[j]
        if above is None:
            return self.w(j)
        relative = self.program.sum((1.0, self.w(j)), (-1.0, self.w(above)))
        return self.program.add(Anchored(relative, f"qd{j}"))

    def q(self, j: int) -> Slot:
        """The angle of joint j."""
        return self.program.add(Integral(self.v(j), f"q{j}"))

    def t(self) -> Slot:
        """The time."""
        return self.program.add(Given("t"))

    def point(self, point: PlanarPoint) -> Slot:
        """A point of the mechanism."""
        number = self.program.planar_number
        terms = tuple((number(c), self.E[k]) for k, c in point.terms)
        return self.program.add(PlanarSum(number(point.constant), terms))
