"""How what a law gives changes with the state: its own code, run on numbers that carry slopes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from robodyn.control.controlled_run import Law, Slopes
from robodyn.mechanics.array_types import Array
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.parts import untimed


class Sloped:
    """A number with its slopes (N,) by the state; compared as the number is."""

    def __init__(self, value: float, slopes: Array) -> None:
        self.value, self.slopes = value, slopes

    def __add__(self, other: Sloped | float) -> Sloped:
        if isinstance(other, Sloped):
            return Sloped(self.value + other.value, self.slopes + other.slopes)
        return Sloped(self.value + other, self.slopes)

    __radd__ = __add__

    def __sub__(self, other: Sloped | float) -> Sloped:
        return self + -1.0 * other

    def __rsub__(self, other: float) -> Sloped:
        return -1.0 * self + other

    def __mul__(self, other: Sloped | float) -> Sloped:
        if isinstance(other, Sloped):
            slopes = self.slopes * other.value + self.value * other.slopes
            return Sloped(self.value * other.value, slopes)
        return Sloped(self.value * other, self.slopes * other)

    __rmul__ = __mul__

    def __truediv__(self, other: float) -> Sloped:
        return Sloped(self.value / other, self.slopes / other)

    def __abs__(self) -> Sloped:
        return self * math.copysign(1.0, self.value)

    def __lt__(self, other: float) -> bool:
        return self.value < other

    def __gt__(self, other: float) -> bool:
        return self.value > other


def slopes_of(law: Law) -> Slopes:
    """d(what a law gives)/d(what it asks but t), of a law whose scope takes `Sloped` numbers."""

    def slopes(t: float, y: Sequence[float]) -> Array:
        still = np.zeros(len(y))
        given = map(Sloped, y, np.eye(len(y)))
        return np.array([getattr(x, "slopes", still) for x in law(t, *given)])

    return slopes


def remainder(x: Sloped, turn: float) -> Sloped:
    """As `math.remainder`."""
    return Sloped(math.remainder(x.value, turn), x.slopes)


def sloped_torques(
    model: Mechanism, torques: Callable[..., Sequence[float]]
) -> Callable[..., list[Sloped]]:
    """`rest_torques` of a model, which it gives as `torques`."""
    untold, driven, zero = untimed(model), list(model.actuated), np.zeros(model.n)

    def sloped(*q: Sloped) -> list[Sloped]:
        from robodyn.dynamics.derivatives import inverse_dynamics_derivatives

        values = [x.value for x in q]
        by_q = inverse_dynamics_derivatives(untold, values, zero, zero).by_q[driven]
        return list(map(Sloped, torques(*values), by_q @ [x.slopes for x in q]))

    return sloped
