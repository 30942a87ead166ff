"""`robodyn torque`: inverse dynamics, and in place of the rows of a turn its flywheel."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from robodyn.cli.options import Force, Model, Number, Qdd, load_with, option
from robodyn.cli.output import degrees
from robodyn.cli.states import Quantity, TableOptions, state_rows
from robodyn.dynamics.columns import TORQUE, column_names
from robodyn.dynamics.flywheel import Flywheel, flywheel
from robodyn.errors import InputError, at_place
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array
from robodyn.tables.summaries import KeptRows, Rows

FLYWHEEL = "--fluctuation"


def torque(
    model: Model,
    given: TableOptions = TableOptions(),
    qdd: Qdd = None,
    force: Force = None,
    fluctuation: Number = option(
        "In place of the rows, which are a turn of the one actuated joint: its mean torque and the "
        "flywheel that holds this fluctuation of speed, such as 0.02.",
        "DELTA",
    ),
) -> None:
    """The torques that a motion needs, and the pin forces.

    tau = M qdd + C qd + D qd + G - Q - Psi^T lambda, D the joint damping, Q friction and other
    forces without potential, lambda the pin forces.

    Columns: tau1.. (N m) of the actuated joints under their own joint number, for each closure
    the pin force fx1,fy1 (N, ground axes) on the side that the scene names first, and tc1 (N m),
    the torque of each coupling; contact1 (N), the force of a cam on its follower.  For each
    actuated joint with a motor there are its torque motor1 (N m), which is tau1/ratio, its speed
    motor_speed1 (rad/s), and by its constants volt1 (V), amp1 (A) and watt1 (W).  Rows of STATES
    pass through with these columns added; --columns chooses, as power1.. (W) = tau1 qd1.

    With fewer actuators than freedoms the motion must be one that the mechanism makes: a torque
    that is left at a free joint, residual2 (N m, or N), refuses its row unless it is below 1e-9 of
    the largest of M qdd, C qd, D qd, G and Q in that joint's equation (in a loop: along the motion
    of that joint alone, actuated ones held).  It is a column where --columns names it.

    --fluctuation DELTA takes whole turns of a machine with one actuated joint, the last row as the
    first, and tells mean_torque (N m), energy_fluctuation dE (J): the greatest less the least of
    the work about the mean torque, mean_speed w (rad/s): by t, else by the rates, and the inertia
    flywheel = dE/(DELTA w^2) (kg m^2), DELTA = (w_max - w_min)/w.

    \b
    Examples:
      robodyn torque 2r --q 30deg,45deg --qd 1,0.5 --qdd 0,0
      robodyn torque four-bar --q 60deg --qd 5
      robodyn torque 2r - < states.csv | head -3
      robodyn torque 2r states.csv --columns t,q1,tau,power | robodyn summary
      robodyn trajectory 2r --from 0,0 --to 1,2 --time 1 | cut -d, -f1-3 | \\
        robodyn torque 2r - --differentiate
      robodyn torque 2r --q 30deg,45deg --force tip2=0,-20
      robodyn simulate cart-pole --q 0,80deg --time 1 | \\
        robodyn torque cart-pole - --columns t,tau1,residual2
      robodyn trajectory four-bar --speed 60rpm --turns 1 --points 361 | \\
        robodyn torque four-bar - --fluctuation 0.02
    """
    mechanism = load_with(model, force)
    quantities = given.quantities(qdd=qdd)
    if fluctuation is not None:
        _tell_flywheel(mechanism, given, quantities, fluctuation)
        return
    advice = ", or name the residuals in --columns"
    state_rows(mechanism, given, quantities, column_names(mechanism, TORQUE), advice=advice)


def _tell_flywheel(
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
