"""A mechanism whose numbers are parameters of a graph: code of its formulas serves every value.

Formulas are recorded of it as of any mechanism.  Its zeros, ones and its shape stay what they are.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

from robodyn import expression
from robodyn.expression import Graph, Value
from robodyn.mechanism import ClosureRow, Mechanism

_NUMERIC = ["A", "B", "gamma", "damping", "weights", "moments"]
_NUMERIC += ["springs", "joint_springs", "forces", "friction"]


class Complex(NamedTuple):
    """A complex number of recorded parts, with the arithmetic that formulas ask of constants."""

    real: Value
    imag: Value

    def conjugate(self) -> Complex:
        return Complex(self.real, -self.imag)

    def __neg__(self) -> Complex:
        return Complex(-self.real, -self.imag)

    def __sub__(self, other: Complex | complex) -> Complex:
        return Complex(self.real - other.real, self.imag - other.imag)

    def __mul__(self, other: Complex | complex) -> Complex:  # type: ignore[override]
        return Complex(
            self.real * other.real - self.imag * other.imag,
            self.real * other.imag + self.imag * other.real,
        )

    def __abs__(self) -> Value:
        if self.imag == 0.0 or self.real == 0.0:
            return abs(self.real if self.imag == 0.0 else self.imag)
        return expression.sqrt(self.real * self.real + self.imag * self.imag)


def parametrised(mechanism: Mechanism, graph: Graph) -> Mechanism:
    """The mechanism with every number of its model a parameter of the graph."""
    lifted = {name: _lifted(getattr(mechanism, name), name, graph) for name in _NUMERIC}
    links = tuple(
        replace(link, hangs_from=_lifted(link.hangs_from, f"hangs_{k}", graph))
        for k, link in enumerate(mechanism.description.links)
    )
    rows = tuple(_row(row, f"row_{r}", graph) for r, row in enumerate(mechanism.rows))
    description = replace(mechanism.description, links=links)
    return replace(mechanism, **lifted, rows=rows, description=description)


class _Numbers(Graph):
    """What collects numbers in place of parameters."""

    def parameter(self, name: str, number: float) -> float:
        self.parameters[name] = float(number)
        return number


def numbers(mechanism: Mechanism) -> dict[str, float]:
    """Every number of the model by the name that `parametrised` gives it, zeros and ones too."""
    found = _Numbers()
    parametrised(mechanism, found)
    return found.parameters


def _row(row: ClosureRow, name: str, graph: Graph) -> ClosureRow:
    """The two rows of a pin have the same numbers, the second one turned by a right angle."""
    lifted: ClosureRow = _lifted(row, name, graph)
    if row.direction not in (1, 1j):
        return lifted
    terms = []
    for k, weight in row.P:
        own = _lifted(weight * row.direction, f"closure_{row.closure}_{k}", graph)
        terms.append((k, own * row.direction.conjugate()))
    return replace(lifted, P=tuple(terms))


def _lifted(value: Any, name: str, graph: Graph) -> Any:
    """The numbers within tuples and dataclasses as parameters, named by their place."""
    if isinstance(value, float):
        return graph.parameter(name, value)
    if isinstance(value, complex):
        parts = (("re", value.real), ("im", value.imag))
        return Complex(*(graph.parameter(f"{name}_{part}", number) for part, number in parts))
    if isinstance(value, tuple):
        items = [_lifted(item, f"{name}_{i}", graph) for i, item in enumerate(value)]
        return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
    if is_dataclass(value) and not isinstance(value, type):
        found = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
        return replace(
            value, **{key: _lifted(item, f"{name}_{key}", graph) for key, item in found.items()}
        )
    return value
