"""A Taylor-series integrator for planar mechanisms: what its engines have in common.

The series of a motion costs a few convolutions an order and a link for any planar linkage, as
`engines/series.py` says.  Machine code makes them (`compiled.py`, with the extra `fast`), and
`run.py` drives it.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robodyn.errors import RobodynError
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.taylor.step_boxes import Kept


STEPS = 128  # at a time, at first: between them the run can be watched and interrupted
PARTS = (1.0, 0.85, 0.7, 0.55, 0.4)  # of a step, where it may land to avoid a suspect state


class Status(IntEnum):
    """Why an engine stopped."""

    REACHED = 0  # the bound
    FULL = 1  # as many steps as were asked for
    SINGULAR = 2  # the next step would start too near a singular configuration
    STUCK = 3  # the step is below the spacing of floats
    NOT_FINITE = 4  # an acceleration or a torque is not finite


class NoCodeError(RobodynError):
    """There is no machine code for a scene, or a phase of its motion: DOP853 serves."""


class Chunk(NamedTuple):
    """Some steps: their ends t (m,) and states y (m, N), and rows at output times (k,), (k, N).

    y = (q, qd) in joint coordinates, with the work done by torques less dampers appended where it
    was asked for.  `kept` is what engines keep of the steps where that was asked for.
    """

    t: Array
    y: Array
    row_t: Array
    row_y: Array
    status: Status
    kept: Kept | None = None

    def first(self, steps: int, direction: float) -> Chunk:
        """The first steps, and the rows within them."""
        t = self.t[:steps]
        end = t[-1] * direction if steps else -np.inf
        rows = int(np.searchsorted(self.row_t * direction, end, "right"))
        return Chunk(t, self.y[:steps], self.row_t[:rows], self.row_y[:rows], Status.FULL)


def order_where_steps_cost(tolerance: float) -> int:
    """The order that measured cheapest for one run, and for many in numpy's arrays.

    There a step costs much beside its series.
    """
    return max(8, math.ceil(6 - 0.7 * math.log(max(tolerance, 1e-16))))


def order_where_series_cost(tolerance: float) -> int:
    """The same for many side by side in lanes of machine code.

    There the series is most of a step.
    """
    return 2 * max(3, round((4.0 - 0.5 * math.log(tolerance)) / 2.0))
