"""Complex numbers with formulas as parts, in place of points in a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from robodyn.engines.expression import call


@dataclass(frozen=True, slots=True)
class Planar:
    """A complex number x + i y of two recorded or symbolic numbers."""

    real: Any
    imag: Any

    def __bool__(self) -> bool:
        return bool(self.real or self.imag)

    def __add__(self, other: Any) -> Planar:
        return Planar(self.real + other.real, self.imag + other.imag)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Planar:
        return Planar(self.real - other.real, self.imag - other.imag)

    def __rsub__(self, zero: complex) -> Planar:
        return -self

    def __neg__(self) -> Planar:
        return Planar(-self.real, -self.imag)

    def __mul__(self, other: Any) -> Planar:
        x, y = other.real, other.imag
        return Planar(self.real * x - self.imag * y, self.real * y + self.imag * x)

    __rmul__ = __mul__

    def __abs__(self) -> Any:
        return call("sqrt", self.real * self.real + self.imag * self.imag)

    def conjugate(self) -> Planar:
        """Return x - i y."""
        return Planar(self.real, -self.imag)
