"""What a run and a torque that depends on the run's steps tell each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class JointTracking:
    """How a joint followed its reference; e = q_ref - q."""

    joint: str  # the link's name
    rms: float  # of e over time, rad
    largest: float  # |e|, rad
    at: float  # when, s
    largest_torque: float  # |tau|, N m


class Steps(Protocol):
    """What a torque is told that depends on the steps of the run."""

    restarts: bool  # whether the torque may jump at its kinks: an integrator starts afresh there

    def begin(self, y: Sequence[float], t_end: float) -> None:
        """A run starts at t = 0 in the state y = (q, qd, ...)."""

    def reach(self, t: float, y: Sequence[float]) -> None:
        """The run has come to a kink, in the accepted state y; later steps begin there."""


class Control(Steps, Protocol):
    """What a controller is told of the run besides, and what it tells.

    `hardest` is when it asked the largest torque of all steps, and in which state y.
    """

    hardest: tuple[float, NDArray[np.float64]] | None

    def observe(self, t: NDArray[np.float64], y: NDArray[np.float64]) -> None:
        """The run has taken steps, to states y (k, 2n or more) at times t (k,)."""

    def errors(self, t: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """q_ref - q of the actuated joints (k, actuated) in such states, rad."""

    def tracking(self) -> list[JointTracking]:
        """How far the run was from its reference."""
