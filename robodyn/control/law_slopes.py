"""How what a law gives changes with the state: its own code, run on numbers that carry slopes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial

import numpy as np

from robodyn.control.controlled_run import Law, Slopes
from robodyn.control.driven_torques import Floats
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
    limits: Sequence[float],
    fades: bool,
    torques: Floats | None,
    torque_slopes: Floats | None,
) -> Slopes:
    """The slopes of a law compiled for what its scope has more.

    It cuts torques off at `limits`, each; where no motor `fades`, it is linear but for that and for
    the `torques` of its model, if it asks for them.
    """
    limited = min(limits) < math.inf
    noted: list[float] = []  # what the law asked its model last
    known: dict[tuple[bool, ...], tuple[Array, Array]] = {}  # by which torques are cut off

    def noting(*asked: float) -> Sequence[float]:
        assert torques is not None
        noted[:] = asked
        return torques(*asked)

    plain = cache(lambda: compile_law({"model": noting} if torques else {}))  # when first asked for
    seeds, rows = np.zeros((0, 0)), np.zeros((0, 0))  # by the state, t, then the model's torques

    def told(*asked: Sloped) -> list[Sloped]:
        nonlocal rows
        assert torques is not None
        rows = np.array([x.slopes for x in asked])
        return list(map(Sloped, torques(*(x.value for x in asked)), seeds[-len(limits) :]))

    scope = {"remainder": remainder} | ({"model": told} if torques else {})
    sloped = cache(partial(compile_law, scope))

    def slopes(t: float, y: Sequence[float], timed: bool = False) -> Array:
        nonlocal seeds
        cut: tuple[bool, ...] = ()
        if torques or limited:
            given = plain()(t, *y)
        if limited:
            cut = tuple(abs(u) >= most for u, most in zip(given, limits, strict=False))
        if timed or fades or cut not in known:
            seeds = np.eye(len(y) + 1 + len(limits))
            unmoved = np.zeros(len(seeds))
            given = sloped()(Sloped(t, seeds[len(y)]), *map(Sloped, y, seeds))
            found = np.array([getattr(x, "slopes", unmoved) for x in given]) + 0.0  # no -0.0
            known[cut] = found, rows
        found, asked = known[cut]
        if torque_slopes is not None:
            by = np.array(torque_slopes(*noted)).reshape(len(limits), -1)
            found = found + found[:, -len(limits) :] @ (by @ asked)
        return found[:, : len(y) + 1]

    return slopes
