"""What is told of a turn of a machine in place of its rows: its flywheel."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from robodyn.cli.output import degrees
from robodyn.cli.states import Quantity, TableOptions, state_rows
from robodyn.dynamics.flywheel import Flywheel, flywheel
from robodyn.errors import InputError, at_place
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array
from robodyn.tables.summaries import KeptRows, Rows

FLYWHEEL = "--fluctuation"


def tell_flywheel(
    mechanism: Mechanism, given: TableOptions, quantities: Sequence[Quantity], delta: float
) -> None:
    """Write the flywheel for a turn, the rows given; InputError naming what is none."""
    k = _driven_joint(mechanism, given, FLYWHEEL)
    if degrees.get():
        raise InputError(f"--degrees and {FLYWHEEL}", limit="exclude each other")
    if not 0.0 < delta < 2.0:
        limit = "must be > 0 and < 2: greatest less least speed, by their mean"
        raise InputError(FLYWHEEL, value=f"{delta:g}", limit=limit)

    def told(header: Sequence[str], rows: Array, own: Array) -> tuple[Sequence[str], Rows]:
        q, qd, tau = own.T
        t = rows[:, header.index("t")] if "t" in header else np.full(len(q), np.nan)
        seconds = _duration(t, q, qd)
        return Flywheel._fields, [list(flywheel(q, tau, seconds, delta))]

    names = [f"{name}{k + 1}" for name in ("q", "qd", "tau")]
    summary = partial(KeptRows, of=at_place(FLYWHEEL)(told))
    state_rows(mechanism, given, quantities, names, summary=summary)


def _driven_joint(mechanism: Mechanism, given: TableOptions, flag: str) -> int:
    """The one joint that is actuated, of a machine that turns; InputError where there is none."""
    if given.columns is not None:
        raise InputError(f"--columns and {flag}", limit="exclude each other")
    if given.states is None:
        raise InputError(flag, limit="needs STATES: rows over a turn")
    names = [mechanism.link_names[k] for k in mechanism.actuated]
    if len(names) != 1:
        limit = f"one actuated joint must drive the machine; here {', '.join(names) or 'none'}"
        raise InputError(flag, where=mechanism.source, limit=limit)
    if mechanism.actuated[0] in mechanism.slides:
        limit = f"the joint {names[0]} slides: it has no turns"
        raise InputError(flag, where=mechanism.source, limit=limit)
    return mechanism.actuated[0]


def _duration(t: Array, q: Array, qd: Array) -> float:
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
