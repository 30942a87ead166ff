"""The interface between a run and a torque that depends on the run's steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class JointTracking:
    """How well a joint followed its reference; e = q_ref - q."""

    joint: str  # the link's name
    rms: float  # of e over time, rad
    largest: float  # |e|, rad
    at: float  # when, s
    largest_torque: float  # |tau|, N m


class Steps(Protocol):
    """Receives the progress of a run, for a torque that depends on it."""

    restarts: bool  # whether the torque may jump at its kinks: an integrator starts afresh there

    def begin(self, y: Sequence[float], t_end: float) -> None:
        """Tell that a run starts at t = 0 in the state y = (q, qd, ...)."""

    def reach(self, t: float, y: Sequence[float]) -> None:
        """Tell that the run has reached a kink in the accepted state y."""


class Control(Steps, Protocol):
    """A controller, which also observes the run.

    `hardest` is time and state y at which it demanded its largest torque.
    """

    hardest: tuple[float, NDArray[np.float64]] | None

    def observe(self, t: NDArray[np.float64], y: NDArray[np.float64]) -> None:
        """Tell the states y (k, 2n or more) at times t (k,) that the run has reached."""

    def errors(self, t: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return q_ref - q of the actuated joints (k, actuated), rad."""

    def tracking(self) -> list[JointTracking]:
        """Return how well each joint followed its reference."""
