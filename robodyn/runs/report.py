"""Outcome and report of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from robodyn.tables.short_repr import short_repr

if TYPE_CHECKING:
    from robodyn.mechanics.run_control import JointTracking


class Outcome(Enum):
    """Why a run ended, with a label and advice."""

    FINISHED = ("finished", "")
    STEP_TOO_SMALL = (
        "step too small",
        "the tolerance asks for more digits than the motion keeps here: loosen rtol and atol, or "
        "see whether a torque is undefined or the motion is singular at this time",
    )
    SINGULAR = (
        "singular",
        "the motion ran into a singular configuration: start beside it, or loosen rtol and atol",
    )
    TOO_MANY_EVALUATIONS = (
        "too many evaluations",
        "raise the limit (--max-evals), loosen rtol and atol, or try another method",
    )
    ENDLESS = (
        "without end",
        "by steps as short as those taken until now the end time (--time) is never reached",
    )
    STIFF = (
        "stiff",
        "the explicit method is held to tiny steps by its stability: take --method Radau",
    )
    LIMIT = (
        "limit",
        "the joint has no stop there; with a stiffness or a restitution in its limits it has one",
    )
    LAW = ("law", "a law of a coupling cannot be kept from there on")
    FRICTION = ("friction", "friction by the force in a pin or slide has no solution there")
    CHATTERING = (
        "chattering",
        "a hundred changes of contact followed one another without time passing: try another "
        "--method, or other tolerances",
    )
    INTERRUPTED = ("interrupted", "what was computed until then is kept")
    EVENT = ("ended", "by the event that was to end it")

    @property
    def label(self) -> str:
        return self.value[0]

    @property
    def advice(self) -> str:
        return self.value[1]


@short_repr
@dataclass(repr=False)
class Report:
    """Report of a run in SI units; drift is relative to the largest energy in motion."""

    outcome: str = Outcome.FINISHED.label
    advice: str = ""
    method: str = ""
    rtol: float = 0.0
    atol: float = 0.0
    stabilize: str = ""
    evaluator: str = ""
    t_end: float = 0.0
    t_reached: float = 0.0
    steps: int = 0
    evaluations: int = 0
    seconds: float = 0.0
    energy_start: float = 0.0
    energy_drift: float = 0.0  # largest |E(t) - E(0) - work done| / energy in motion
    energy_in_motion: float = 0.0  # largest KE, or change of PE, J
    work: float = 0.0  # of torques less dampers, J
    work_missed: float = 0.0  # of a torque between the steps, part of the energy in motion
    largest_gap: float = 0.0  # m
    largest_gap_rate: float = 0.0  # m/s
    nearest_singular: float | None = None  # least singular value of Psi against the loop's size
    nearest_singular_time: float | None = None
    missed: str = ""  # of a change point that the loops just miss there
    error_estimate: float | None = None  # largest of q and qd along the run, by a tighter run
    sensitivity_errors: dict[str, float] = field(default_factory=dict)  # of derivatives, relative
    until_sensitivity: dict[str, float] = field(default_factory=dict)  # d(time of --until)/d(name)
    tracking: list[JointTracking] | None = None  # of each actuated joint, over accepted steps
    events: dict[str, int] = field(default_factory=dict)  # how often each happened
    ended_by: str = ""  # the event that ended the run
    remarks: list[str] = field(default_factory=list)  # on events whose times are not sharp
    hint: str = ""  # what would make it faster, or safer


class InterruptedRun(Exception):
    """Raised to end a run from outside; the rows computed so far are kept."""
