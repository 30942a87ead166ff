"""Legs of a run: one mechanism in one mode, over one smooth piece of the torques."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from robodyn.loops.misses import Misses
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.right_hand_side import RightHandSide, right_hand_side
from robodyn.runs.series_engine import NoCodeError, SeriesEngine
from robodyn.runs.settings import Settings
from robodyn.tables.arrays import Array


@dataclass(eq=False)
class System:
    """The equations of motion of one mode of a run, as each stepper evaluates them, made once.

    With `work`, states end with the work done (J).
    """

    mechanism: Mechanism
    actuation: Actuation
    settings: Settings
    work: bool

    @property
    def projects(self) -> bool:
        """Whether states are projected onto closures."""
        return bool(self.mechanism.rows) and self.settings.stabilize == "projection"

    @cached_property
    def misses(self) -> Misses | None:
        """The change points met so far; None without closures."""
        return Misses(self.mechanism) if self.mechanism.rows else None

    @cached_property
    def side(self) -> RightHandSide:
        """The right-hand side dy/dt."""
        drifts = self.mechanism.rows and self.settings.stabilize == "baumgarte"
        return right_hand_side(
            self.mechanism,
            self.actuation,
            work=self.work,
            baumgarte=self.settings.baumgarte if drifts else 0.0,
            misses=self.misses,
        )

    @cached_property
    def engine(self) -> SeriesEngine | None:
        """The Taylor series in machine code; None if it does not serve this mode."""
        settings = self.settings
        try:
            return SeriesEngine(
                self.mechanism,
                self.actuation,
                rtol=float(settings.rtol),
                atol=float(settings.atol),
                order=settings.order,
                project=self.projects,
                work=self.work,
            )
        except NoCodeError:
            return None


class Leg(NamedTuple):
    """A system that moves from state y (N,) at t towards `t_end`.

    With `keeps`, states between steps will be asked for.  With `may_end`, steps beyond an event may
    be discarded, so fewer are taken at once.
    """

    system: System
    t: float
    y: Array
    t_end: float
    keeps: bool = False
    may_end: bool = False
