"""The state of a mechanism as expressions: what the formulas of its closed form are written in.

Angles, rates and directions of the links are nodes of one graph, made as they are asked for.
"""

from __future__ import annotations

from robodyn import expression
from robodyn.expression import Graph, Value
from robodyn.mechanism import Mechanism

Planar = tuple[Value, Value]  # a complex number: real and imaginary part


class State:
    """Angles, rates and directions of the links as expressions, made as they are asked for."""

    def __init__(
        self,
        mechanism: Mechanism,
        rates: tuple[str, ...],
        by_direction: bool,
        graph: Graph | None = None,
    ) -> None:
        """On a graph of its own, or on that of a mechanism whose numbers are expressions."""
        self.mechanism = mechanism
        self.by_direction = by_direction
        self.graph = graph or Graph()
        n = mechanism.n
        self.inputs = tuple(f"{name}{k}" for name in ("q", *rates) for k in range(n))
        self.relative: dict[str, list[Value]] = {
            name: [self.graph.variable(f"{name}{k}") for k in range(n)] for name in ("q", *rates)
        }
        self.alpha = self.absolute("q")

    def absolute(self, name: str) -> list[Value]:
        """J times the relative values called `name`."""
        values: list[Value] = list(self.relative[name])
        for k in self.mechanism.order:
            above = self.mechanism.parent[k]
            if above is not None:
                values[k] = values[above] + values[k]
        return values

    def direction(self, k: int) -> Planar:
        """E_k."""
        return expression.cos(self.alpha[k]), expression.sin(self.alpha[k])

    def turn(self, j: int, k: int) -> Planar:
        """conj(E_j) E_k for j above k."""
        if j == k:
            return 1.0, 0.0
        if self.by_direction:
            (cj, sj), (ck, sk) = self.direction(j), self.direction(k)
            return cj * ck + sj * sk, cj * sk - sj * ck
        angle: Value = 0.0
        link: int | None = k
        while link != j:
            assert link is not None
            angle = angle + self.relative["q"][link]
            link = self.mechanism.parent[link]
        return expression.cos(angle), expression.sin(angle)

    def gravity(self, k: int) -> Value:
        """G_k in alpha of weights and constant forces and torques, Im(w_k E_k) - moment_k."""
        return imaginary(self.mechanism.weights[k], self, k) - self.mechanism.moments[k]

    def constant_load(self, k: int) -> Value:
        """The part of `gravity` that no mass makes."""
        mechanism = self.mechanism
        weight = mechanism.weights[k] - mechanism.gamma.conjugate() * mechanism.B[k]
        return imaginary(weight, self, k) - mechanism.moments[k]


def planar(z: complex) -> Planar:
    """A constant."""
    return z.real, z.imag


def imaginary(weight: complex, state: State, k: int) -> Value:
    """Im(weight E_k), without the sine or cosine that it does not need."""
    value: Value = 0.0
    if weight.imag != 0.0:
        value = weight.imag * expression.cos(state.alpha[k])
    if weight.real != 0.0:
        value = value + weight.real * expression.sin(state.alpha[k])
    return value


def real(weight: complex, state: State, k: int) -> Value:
    """Re(weight E_k)."""
    return imaginary(weight * 1j, state, k)


def times(a: Planar, b: Planar) -> Planar:
    """a b."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def plus(a: Planar, b: Planar) -> Planar:
    """a + b."""
    return a[0] + b[0], a[1] + b[1]


def to_joints(mechanism: Mechanism, values: list[Value]) -> list[Value]:
    """J^T times values in alpha."""
    sums = list(values)
    for k in reversed(mechanism.order):
        above = mechanism.parent[k]
        if above is not None:
            sums[above] = sums[above] + sums[k]
    return sums
