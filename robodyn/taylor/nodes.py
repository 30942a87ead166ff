"""Series that build one another up order by order: sums, products, and functions of series.

Each appends its next coefficient from those of its parts: products are convolutions, functions
obey first-order differential equations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence


class Node:
    """A series, known up to the order of its last coefficient."""

    def __init__(self) -> None:
        self.values: list[float] = []

    def coefficient(self, k: int) -> float:
        """The coefficient of order k, from those of the parts up to k and its own before."""
        raise NotImplementedError


class Given(Node):
    """A constant, or what is given from outside order by order."""

    def __init__(self) -> None:
        super().__init__()
        self.first = 0.0
        self.coming: list[float] = []

    def coefficient(self, k: int) -> float:
        if self.coming:
            return self.coming.pop(0)
        return self.first if k == 0 else 0.0


class Sum(Node):
    def __init__(self, a: Node, b: Node | None, u: float, v: float) -> None:
        super().__init__()
        self.a, self.b, self.u, self.v = a, b, u, v

    def coefficient(self, k: int) -> float:
        first = self.u * self.a.values[k]
        return first if self.b is None else first + self.v * self.b.values[k]


class Product(Node):
    def __init__(self, a: Node, b: Node) -> None:
        super().__init__()
        self.a, self.b = a, b

    def coefficient(self, k: int) -> float:
        return convolve(self.a.values[: k + 1], self.b.values[: k + 1])


class Quotient(Node):
    """y b = a."""

    def __init__(self, a: Node, b: Node) -> None:
        super().__init__()
        self.a, self.b = a, b

    def coefficient(self, k: int) -> float:
        known = convolve(self.values[:k], self.b.values[1 : k + 1])
        return (self.a.values[k] - known) / self.b.values[0]


class Power(Node):
    """x y' = exponent x' y."""

    def __init__(self, x: Node, exponent: float) -> None:
        super().__init__()
        self.x, self.exponent = x, exponent

    def coefficient(self, k: int) -> float:
        x, y = self.x.values, self.values
        if k == 0:
            return math.pow(x[0], self.exponent)
        terms = (((self.exponent + 1.0) * m - k) * x[m] * y[k - m] for m in range(1, k + 1))
        return sum(terms) / (k * x[0])


class Exponential(Node):
    """y' = x' y."""

    def __init__(self, x: Node) -> None:
        super().__init__()
        self.x = x

    def coefficient(self, k: int) -> float:
        return math.exp(self.x.values[0]) if k == 0 else slope(self.x.values, self.values, k)


class Sine(Node):
    """s' = x' c; c' = -x' s, or + for the hyperbolic ones.  `Cosine` shows the other half."""

    def __init__(self, x: Node, hyperbolic: bool) -> None:
        super().__init__()
        self.x, self.hyperbolic = x, hyperbolic
        self.cosines: list[float] = []

    def coefficient(self, k: int) -> float:
        x = self.x.values
        if k == 0:
            sine, cosine = (math.sinh, math.cosh) if self.hyperbolic else (math.sin, math.cos)
            self.cosines = [cosine(x[0])]
            return sine(x[0])
        other = slope(x, self.values, k)
        result = slope(x, self.cosines, k)
        self.cosines.append(other if self.hyperbolic else -other)
        return result


class Cosine(Node):
    def __init__(self, sine: Sine) -> None:
        super().__init__()
        self.sine = sine

    def coefficient(self, k: int) -> float:
        return self.sine.cosines[k]


class HyperbolicTangent(Node):
    """y' = x' (1 - y^2): where sinh and cosh would overflow it is flat."""

    def __init__(self, x: Node) -> None:
        super().__init__()
        self.x = x
        self.rest: list[float] = []  # 1 - y^2

    def coefficient(self, k: int) -> float:
        if k == 0:
            self.rest = []
            return math.tanh(self.x.values[0])
        y = self.values
        self.rest.append((1.0 if k == 1 else 0.0) - convolve(y, y))
        return slope(self.x.values, self.rest, k)


class Primitive(Node):
    """density y' = x'."""

    def __init__(self, x: Node, density: Node, start: Callable[[float], float]) -> None:
        super().__init__()
        self.x, self.density, self.start = x, density, start

    def coefficient(self, k: int) -> float:
        x, density, y = self.x.values, self.density.values, self.values
        if k == 0:
            return self.start(x[0])
        known = sum(m * y[m] * density[k - m] for m in range(1, k))
        return (k * x[k] - known) / (k * density[0])


def convolve(a: Sequence[float], b: Sequence[float]) -> float:
    """sum of a_m b_{k-m}; both of one length."""
    return sum(x * y for x, y in zip(a, reversed(b), strict=True))


def slope(x: Sequence[float], y: Sequence[float], k: int) -> float:
    """Coefficient k of the integral of x' y."""
    return sum(m * x[m] * y[k - m] for m in range(1, k + 1)) / k
