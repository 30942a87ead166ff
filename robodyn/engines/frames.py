"""The coefficients of slots, real and planar, and the frames that planar ones are told in.

A planar coefficient is a sum over frames: a link's direction at the start, or the ground's.  A
coefficient of the program that stands before a part is multiplied when a frame is asked for, and
once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from robodyn.engines.arithmetic import (
    ZERO,
    Arithmetic,
    Planar,
    Value,
    conjugate_times,
    difference,
    over,
    planar_plus,
    planar_times,
    plus,
    times,
)
from robodyn.mechanics.planar_model import Mechanism
from robodyn.mechanics.program import Coefficient, PlanarCoefficient, Program, Row, Slot
from robodyn.tables.records import Record


class State(Record):
    """Where a series starts: directions E (n), rates w of x = J q, and the values of `Given`s.

    A joint that slides has no E; its displacement is given like other values.
    `given` maps a name to its first coefficients, or to a function of the order that returns one.
    `turn` (j, k) gives conj(E_j) E_k where there is a cheaper way than to multiply.  Where the
    links' `accelerations` (n) are given, the residuals of order 0 are what they leave open.
    """

    E: Sequence[Planar]
    w: Sequence[Value]
    given: dict[str, Sequence[Value] | Callable[[int], Value]]
    turn: Callable[[int, int], Planar] | None = None
    accelerations: Sequence[Value] | None = None


def absolute(mechanism: Mechanism, relative: Sequence[Any]) -> list[Any]:
    """J times values of the joints, of any kind."""
    values = list(relative)
    for k in mechanism.order:
        above = mechanism.above[k]
        if above is not None:
            values[k] = values[above] + values[k]
    return values


def relative(mechanism: Mechanism, absolute: Sequence[Any]) -> list[Any]:
    """J^-1 times values of the links."""
    above = [None if k is None else absolute[k] for k in mechanism.above]
    return [x if y is None else x - y for x, y in zip(absolute, above, strict=True)]


def start(
    mechanism: Mechanism,
    arithmetic: Arithmetic,
    joints: tuple[Sequence[Value], Sequence[Value]],
    links: tuple[Sequence[Value], Sequence[Value]] | None = None,
    turn: Callable[[int, int], Planar] | None = None,
    accelerations: Sequence[Value] | None = None,
) -> State:
    """Where series start, by q and qd (n), and x = J q and its rates if they are known already.

    `given` may be added to.
    """
    x, rates = links or (absolute(mechanism, joints[0]), absolute(mechanism, joints[1]))
    named = {"q": joints[0], "qd": joints[1], "alpha": x}
    given: dict[str, Any] = {
        f"{name}{k}": (value,) for name, values in named.items() for k, value in enumerate(values)
    }
    slides, cos, sin = set(mechanism.slides), arithmetic.cos, arithmetic.sin
    E = [(1.0, 0.0) if k in slides else (cos(a), sin(a)) for k, a in enumerate(x)]
    return State(E, rates, given, turn, accelerations)


# frame (a link, or None: the ground's), coefficient that is not yet multiplied, value
Framed = tuple[tuple[int | None, PlanarCoefficient | None, Planar], ...]


@dataclass(eq=False, repr=False)
class Frames:
    """The coefficients of a program's slots, in an arithmetic."""

    program: Program
    arithmetic: Arithmetic
    numbers: Sequence[Value]
    orders: int
    state: State
    slots: Sequence[Slot] = ()
    grounded: bool = False

    def __post_init__(self) -> None:
        order, self.ahead, self.live = self.program.schedule(self.slots)
        self.rows: list[tuple[Slot, Row]] = [(x, self.program.rows[x]) for x in order]
        self.real: dict[Slot, Any] = {}  # coefficients of real slots
        self.planar: dict[Slot, list[Framed]] = {}
        self.unknown_values: dict[Slot, Value] = {}
        self._factor: dict[tuple[int | None, int | None, PlanarCoefficient | None], Planar] = {}
        # series of planar slots in one frame
        self._kept: dict[Slot, dict[int | None, tuple[Any, Any]]] = {}
        # rho, theta of directions; F of moments in their frame
        self._moment: dict[Slot, tuple[Any, Any]] = {}
        self._extra: dict[Slot, Any] = {}  # series that functions take besides their own

    # -- planar coefficients -----------------------------------------------------------------------

    def coefficient(self, c: Coefficient) -> Value:
        """The number that a coefficient is."""
        if isinstance(c, float):
            return c
        return times(c.sign, self.numbers[c.place])

    def _pair(self, c: PlanarCoefficient) -> Planar:
        return self.coefficient(c[0]), self.coefficient(c[1])

    def factor(self, to: int | None, frame: int | None, c: PlanarCoefficient | None) -> Planar:
        """c E_frame in the frame `to`: conj(E_to) c E_frame."""
        key = (to, frame, c)
        found = self._factor.get(key)
        if found is None:
            if c is not None:
                found = planar_times(self._pair(c), self.factor(to, frame, None))
                found = self.arithmetic.keep(found[0]), self.arithmetic.keep(found[1])
            elif to == frame:
                found = (1.0, 0.0)
            elif to is None:
                assert frame is not None
                found = self.state.E[frame]
            elif frame is None:
                E = self.state.E[to]
                found = E[0], -E[1]
            elif self.state.turn is not None:
                found = self.state.turn(to, frame)
            else:
                found = conjugate_times(self.state.E[to], self.state.E[frame])
            self._factor[key] = found
        return found

    def into(self, to: int | None, framed: Framed) -> Planar:
        """The value of a planar coefficient in one frame."""
        total = ZERO
        for frame, c, value in framed:
            total = planar_plus(total, planar_times(self.factor(to, frame, c), value))
        return total

    def real_part(self, framed: Framed) -> Value:
        """Re of a planar coefficient."""
        total: Value = 0.0
        for frame, c, value in framed:
            by = self.factor(None, frame, c)
            total = plus(total, times(by[0], value[0]))
            total = difference(total, times(by[1], value[1]))
        return total

    def ground(self, z: Slot, m: int) -> Planar:
        """Coefficient m of a planar slot in the ground's frame."""
        return self.into(None, self.planar[z][m])

    # -- rows --------------------------------------------------------------------------------------

    def put(self, slot: Slot, m: int, value: Any) -> None:
        if slot in self.planar:
            self.planar[slot][m] = value
            for frame in self._kept.get(slot, ()):
                self._remember(slot, frame, m)
        else:
            self.real[slot][m] = value

    def columns(self, z: Slot, last: int, frame: int | None = None) -> tuple[Any, Any]:
        """The series of a planar slot in one frame, kept as it grows."""
        kept = self._kept.setdefault(z, {})
        if frame not in kept:
            room = self.arithmetic.room
            kept[frame] = (room(self.orders + 3), room(self.orders + 3))
            for m in range(max(last + 1, self.ahead[z])):
                self._remember(z, frame, m)
        return kept[frame]

    def _remember(self, z: Slot, frame: int | None, m: int) -> None:
        x, y = self._kept[z][frame]
        x[m], y[m] = self.into(frame, self.planar[z][m])

    def convolve(self, x: Any, y: Any, m: Any, first: int = 0, last: Any = None) -> Value:
        """Sum of x_j y_{m-j} for j from `first` to `last` (m, unless given)."""
        last = m if last is None else last
        if last < first:
            return 0.0
        return self.arithmetic.convolve(x, y, m, first, last)

    def slope(self, x: Any, y: Any, m: int) -> Value:
        """Coefficient m of the integral of x' y: 1/m sum j x_j y_{m-j}."""
        return over(self.arithmetic.weigh(x, y, m, 1, m, 1.0, 0.0), m)
