"""A mechanism whose numbers are named: variables m1, l2, ... of a graph, or exact fractions.

The formulas of robodyn, run on it, record the equations of motion in the scene's parameters.  Its
constants are those of `mechanism.py`; with fractions, what cancels on paper cancels in them.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

from robodyn.engines import expression
from robodyn.engines.expression import Expression, Graph, Value
from robodyn.equations.scene_symbols import SymbolicScene
from robodyn.equations.symbolic import Planar, Sum, Symbol
from robodyn.mechanics.mechanism import constants
from robodyn.mechanics.planar_model import Mechanism


class Pair:
    """A complex number of two values; it can what formulas do with complex constants."""

    __slots__ = ("imag", "real")

    def __init__(self, real: Value, imag: Value) -> None:
        self.real, self.imag = real, imag

    def __bool__(self) -> bool:
        return not (self.real == 0.0 and self.imag == 0.0)

    def __add__(self, other: Pair | complex | Value) -> Pair:
        return Pair(self.real + other.real, self.imag + other.imag)

    __radd__ = __add__

    def __sub__(self, other: Pair) -> Pair:
        return self + -other

    def __rsub__(self, zero: complex) -> Pair:
        return -self

    def __mul__(self, other: Pair | complex | Expression) -> Pair:
        x, y = other.real, other.imag
        return Pair(self.real * x - self.imag * y, self.real * y + self.imag * x)

    __rmul__ = __mul__

    def __neg__(self) -> Pair:
        return Pair(-self.real, -self.imag)

    def __abs__(self) -> Value:
        return expression.call("sqrt", self.real * self.real + self.imag * self.imag)

    def conjugate(self) -> Pair:
        return Pair(self.real, -self.imag)


class Numbers:
    """Sums of products of parameters: in variables of the graph, fractions if the scene is numeric.

    What takes floats and complex numbers takes these too.
    """

    def __init__(self, scene: SymbolicScene, graph: Graph) -> None:
        self.scene, self.graph = scene, graph

    def mechanism(self) -> Mechanism:
        """That of the scene, its couplings left out."""
        return constants(self(self.scene.symbols))

    def __call__(self, item: Any) -> Any:
        """An entry of the scene with these numbers for its sums and planar sums."""
        if isinstance(item, Sum):
            return self._real(item)
        if isinstance(item, Planar):
            return Pair(self._real(item.real), self._real(item.imag))
        if isinstance(item, tuple):
            return tuple(map(self, item))
        if is_dataclass(item) and not isinstance(item, type):
            return replace(item, **{x.name: self(getattr(item, x.name)) for x in fields(item)})
        return item

    def _real(self, sum_: Sum) -> Value:
        if self.scene.numeric:
            sum_ = sum_.substituted(self.scene.parameters.values)
        total: Value = 0
        for monomial, number in sum_.terms.items():
            term: Any = number
            for atom, power in monomial:
                assert isinstance(atom, Symbol)
                for _ in range(power):
                    term = term * self.graph.variable(atom.name)
            total = total + term
        return total
