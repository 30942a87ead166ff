"""The series that the Taylor integrator's steps in Python are made of.

Straight-line floats for most mechanisms; the rows one by one for those whose code would be long.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any

import numpy as np

from robodyn.dynamics.dense_dynamics import elimination_is_safe
from robodyn.engines.expansion import MotionProgram, longest_step
from robodyn.engines.series import FLOATS
from robodyn.engines.step_text import StepText, step_text
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.torque_rows import linear_piece
from robodyn.taylor.steps import Expanded, SteppingEngine

Pieces = tuple[Sequence[float], Sequence[float]]  # torques and their slopes, of a table


class _SeriesEngine(SteppingEngine):
    """Series of the program, made anew where the switches of an expression stand otherwise."""

    def prepare(self) -> None:
        self._held: tuple[float, ...] | None = None
        self._made: dict[tuple[float, ...] | None, Any] = {}
        self._function = self.actuation.function(self.mechanism.n)
        if self.actuation.pieces is not None:
            with suppress(ZeroDivisionError):  # of numbers that no switch holds
                self.make(None)  # every branch must have a series
        self.at(0.0)

    def make(self, held: tuple[float, ...] | None) -> Any:
        """What expands the motion while switches are held so."""
        raise NotImplementedError

    def reads(self, made: Any) -> tuple[bool, list[float]]:
        """Whether its series hold a power, and the arms of what is watched."""
        raise NotImplementedError

    def watched(self, made: Any, t: float, y: list[float], given: Pieces) -> Sequence[float]:
        """The values of what is watched, at a state."""
        raise NotImplementedError

    @property
    def works(self) -> bool:  # type: ignore[override]  # by how the switches stand
        """Whether the series hold a power besides that of constant torques."""
        return self.reads(self.now)[0]

    @property
    def bends(self) -> bool:  # type: ignore[override]
        """Whether anything is watched."""
        return bool(self.arms)

    @property
    def arms(self) -> list[float]:
        """What make torques of what is watched."""
        return self.reads(self.now)[1]

    def at(self, t: float) -> Any:
        """What expands the motion from t on."""
        if self.actuation.pieces is not None:
            self._held = self.actuation.pieces.at(t)
        return self.now

    @property
    def now(self) -> Any:
        """What expanded the motion last."""
        if self._held not in self._made:
            self._made[self._held] = self.make(self._held)
        return self._made[self._held]

    def given(self, t: float, y: list[float], direction: float) -> Pieces:
        """The torques at t, and their slopes, of a table; else nothing."""
        if self.actuation.constants is not None or not self.actuation.linear:
            return (), ()
        return linear_piece(self.actuation, self._function, t, y, direction)

    def agrees(
        self, series: Any, x: float, t: float, y: list[float], relative: float, small: float
    ) -> bool:
        try:
            values = self.watched(self.now, t, y, self.given(t, y, 1.0))
        except (ArithmeticError, ValueError):  # outside the domain
            return False
        return all(
            _agree(each, x, value, relative, small / arm)
            for each, value, arm in zip(
                series[len(series) - len(self.arms) :], values, self.arms, strict=True
            )
        )


class StraightEngine(_SeriesEngine):
    """Straight-line floats, generated for one mechanism and one order."""

    def make(self, held: tuple[float, ...] | None) -> StepText:
        return _step_text(self.mechanism, self.actuation, self.order, self.work, held)

    def reads(self, made: StepText) -> tuple[bool, list[float]]:
        return made.works, made.arms

    def watched(self, made: StepText, t: float, y: list[float], given: Pieces) -> Sequence[float]:
        return made.watched(t, y, *given)

    def expand(self, t: float, y: list[float], most: float, direction: float) -> Expanded:
        given = self.given(t, y, direction)
        try:
            found: Expanded = self.at(t).expand(t, y, *given, most, direction, *self.tolerances)
        except (ArithmeticError, ValueError):  # outside a torque's domain, or beyond the floats
            return 0.0, y, ()
        return found


class InterpretedEngine(_SeriesEngine):
    """The rows of the program one by one: for mechanisms whose straight-line code would be long."""

    def make(self, held: tuple[float, ...] | None) -> MotionProgram:
        return MotionProgram(self.mechanism, self.actuation, self.work, held)

    def reads(self, made: MotionProgram) -> tuple[bool, list[float]]:
        return bool(made.power), made.arms

    def watched(
        self, made: MotionProgram, t: float, y: list[float], given: Pieces
    ) -> Sequence[float]:
        start, pivoted = made.state(FLOATS, t, y, given), not elimination_is_safe(self.mechanism)
        found = made.expand(FLOATS, made.program.numbers, 1, start, pivoted=pivoted)
        return [each[0] for each in found.watched]

    def expand(self, t: float, y: list[float], most: float, direction: float) -> Expanded:
        made: MotionProgram = self.at(t)
        try:
            start = made.state(FLOATS, t, y, self.given(t, y, direction))
            numbers, pivoted = made.program.numbers, not elimination_is_safe(self.mechanism)
            found = made.expand(FLOATS, numbers, self.order, start, pivoted=pivoted)
            longest = longest_step(found, start.w, *self.tolerances)
        except (ArithmeticError, ValueError):  # outside a torque's domain, or beyond the floats
            return 0.0, y, ()
        if math.isnan(longest):
            return 0.0, y, ()
        power = [found.power] if found.power else []
        series = (*found.rho, *found.theta, *power, *found.watched)
        h = min(most, longest)
        closing, self.closing = self.closing, None
        new = self.states(y, series, np.array([h * direction]))[0].tolist()
        self.closing = closing
        return h, new, series


def _agree(series: Sequence[float], x: float, value: float, relative: float, small: float) -> bool:
    """Whether a series gives a value at x; it may miss by `small`, or that part of its terms."""
    total = most = 0.0
    power = 1.0
    for coefficient in series:
        term = coefficient * power
        total += term
        most = max(most, abs(term))
        power *= x
    return abs(total - value) <= max(small, relative * most)


@lru_cache(maxsize=64)
def _made(
    mechanism: Mechanism, order: int, constants: tuple[float, ...] | None, linear: bool, work: bool
) -> StepText:
    return step_text(mechanism, Actuation(constants, linear=linear), order, work)


def _step_text(
    mechanism: Mechanism,
    actuation: Actuation,
    order: int,
    work: bool,
    held: tuple[float, ...] | None,
) -> StepText:
    """The code, kept where it depends on nothing but numbers."""
    if actuation.constants is None and not actuation.linear:
        return step_text(mechanism, actuation, order, work, held)
    return _made(mechanism, order, actuation.constants, actuation.linear, work)
