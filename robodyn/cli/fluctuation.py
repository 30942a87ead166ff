"""What the torque of a turn asks of a flywheel, in place of its rows."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from robodyn.cli.output import degrees
from robodyn.cli.states import Quantity, TableOptions, evaluate
from robodyn.dynamics.dynamics import inverse_dynamics
from robodyn.dynamics.flywheel import Flywheel, flywheel
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.summaries import SummaryWriter

FLAG = "--fluctuation"


def tell_flywheel(
    mechanism: Mechanism,
    given: TableOptions,
    quantities: Sequence[Quantity],
    delta: float,
) -> None:
    """Write the flywheel for a turn, the rows given; InputError naming what is none."""
    if given.extremes:
        raise InputError("--extremes and --fluctuation", limit="exclude each other")
    if degrees.get():
        raise InputError("--degrees and --fluctuation", limit="exclude each other")
    if given.states is None:
        raise InputError(FLAG, limit="needs STATES: rows over a turn")
    if not 0.0 < delta < 2.0:
        limit = "must be > 0 and < 2: greatest less least speed, by their mean"
        raise InputError(FLAG, value=f"{delta:g}", limit=limit)
    k = driven_joint(mechanism, FLAG)

    def compute(q: np.ndarray, qd: np.ndarray, **motion: np.ndarray) -> np.ndarray:
        tau = inverse_dynamics(mechanism, q, qd, **motion)
        return np.stack([q[:, k], qd[:, k], tau[:, k]], axis=-1)

    columns = [f"{name}{k + 1}" for name in ("q", "qd", "tau")]
    summary = partial(TurnWriter, delta=delta)
    evaluate(mechanism, given, quantities, columns, compute, summary=summary)


def driven_joint(mechanism: Mechanism, flag: str) -> int:
    """The one joint that is actuated; InputError, naming `flag`, for none, and one that slides."""
    names = [mechanism.link_names[k] for k in mechanism.actuated]
    if len(names) != 1:
        limit = f"one actuated joint must drive the machine; here {', '.join(names) or 'none'}"
        raise InputError(flag, where=mechanism.source, limit=limit)
    if mechanism.actuated[0] in mechanism.slides:
        limit = f"the joint {names[0]} slides: it has no turns"
        raise InputError(flag, where=mechanism.source, limit=limit)
    return mechanism.actuated[0]


class TurnWriter(SummaryWriter):
    """Takes columns q, qd and tau of the driven joint, and tells its flywheel."""

    def __init__(self, *given: Any, delta: float) -> None:
        super().__init__(*given)
        self._delta, self._rows = delta, list[np.ndarray]()

    def write_columns(self, values: np.ndarray) -> None:
        t = self.numeric("t")
        times = np.full(len(values), np.nan) if t is None else values[:, t]
        self._rows.append(np.column_stack([times, values[:, self._places]]))

    def tell(self) -> tuple[Sequence[str], list[list[float | str | None]]]:
        t, q, qd, tau = np.concatenate(self._rows).T
        try:
            seconds = _duration(t, q, qd)
            found = flywheel(q, tau, seconds, self._delta)
        except InputError as error:
            error.add_place(FLAG)
            raise
        return Flywheel._fields, [list(found)]


def _duration(t: np.ndarray, q: np.ndarray, qd: np.ndarray) -> float:
    """The time of the rows, s: by their times, else by their rates."""
    if np.isfinite(t).all():
        if not (np.diff(t) > 0.0).all():
            raise InputError("t", limit="must rise from row to row")
        return float(np.ptp(t))
    if not qd.all() or (qd * (q[-1] - q[0]) < 0.0).any():
        limit = "needs the speed: a column t, or --qd (or columns) not zero, along the turn"
        raise InputError("the rows", limit=limit)
    paces = 1.0 / qd
    return float(np.diff(q) @ (paces[1:] + paces[:-1]) / 2.0)
