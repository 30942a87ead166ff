"""How what a law gives changes with the state: its own code, run on numbers that carry slopes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial

import numpy as np

from robodyn.control.controlled_run import Law, Slopes
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import Mode, in_mode
from robodyn.mechanics.parts import untimed
from robodyn.tables.arrays import Array


class Sloped:
    """A number with its slopes (N,) by the state and time; compared as the number is."""

    __slots__ = ("slopes", "value")

    def __init__(self, value: float, slopes: Array) -> None:
        self.value, self.slopes = value, slopes

    def __add__(self, other: Sloped | float) -> Sloped:
        if isinstance(other, Sloped):
            return Sloped(self.value + other.value, self.slopes + other.slopes)
        return Sloped(self.value + other, self.slopes)

    __radd__ = __add__

    def __sub__(self, other: Sloped | float) -> Sloped:
        if isinstance(other, Sloped):
            return Sloped(self.value - other.value, self.slopes - other.slopes)
        return Sloped(self.value - other, self.slopes)

    def __rsub__(self, other: float) -> Sloped:
        return Sloped(other - self.value, -self.slopes)

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


def remainder(x: Sloped, turn: float) -> Sloped:
    """As `math.remainder`."""
    return Sloped(math.remainder(x.value, turn), x.slopes)


def slopes_of(
    compile_law: Callable[[Mapping[str, object]], Law],
    model: Mechanism,
    rest: Callable[..., Sequence[float]] | None,
) -> Slopes:
    """d(what a law gives)/d(what it asks, t last), of a law compiled for what its scope has more.

    `rest` are the torques at rest of the model, where the law asks for them.
    """
    n, driven = model.n, list(model.actuated)
    untold = in_mode(untimed(model), Mode())  # no controller balances what a stop pushes
    seeds: Array = np.zeros((0, 0))  # of what the law asks, then of the torques at rest

    def at_rest(*q: Sloped) -> list[Sloped]:
        assert rest is not None
        return list(map(Sloped, rest(*(x.value for x in q)), seeds[-len(driven) :]))

    scope = {"remainder": remainder} | ({"model": at_rest} if rest else {})
    law = cache(partial(compile_law, scope))  # when it is first asked for

    def slopes(t: float, y: Sequence[float]) -> Array:
        nonlocal seeds
        asked = len(y) + 1
        seeds = np.eye(asked + len(driven))
        unmoved = np.zeros(len(seeds))
        given = law()(Sloped(t, seeds[len(y)]), *map(Sloped, y, seeds))
        found = np.array([getattr(x, "slopes", unmoved) for x in given]) + 0.0  # no -0.0
        if rest is not None:
            from robodyn.dynamics.derivatives import inverse_dynamics_derivatives

            still = np.zeros(n)
            by_q = inverse_dynamics_derivatives(untold, y[:n], still, still).by_q
            found[:, :n] += found[:, asked:] @ by_q[driven]
        return found[:, :asked]

    return slopes
