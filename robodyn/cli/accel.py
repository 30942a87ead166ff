"""`robodyn accel`: forward dynamics at given states."""

from __future__ import annotations

from robodyn.cli.options import Force, Model, Tau, load_with
from robodyn.cli.states import TableOptions, state_rows
from robodyn.dynamics.columns import FORCES, column_names


def accel(
    model: Model,
    given: TableOptions = TableOptions(),
    tau: Tau = None,
    force: Force = None,
) -> None:
    """The accelerations that torques cause, and the pin forces.

    Columns: qdd1.. (rad/s^2) of all joints, for each closure the pin force fx1,fy1 (N, ground
    axes) on the side that the scene names first, tc1 (N m), the torque of each coupling, and
    contact1 (N), the force of a cam on its follower.  Rows of STATES pass through with these added.

    \b
    Examples:
      robodyn accel 2r --q 30deg,45deg --tau 12,2
      robodyn accel four-bar --q 60deg --qd 5 --tau 1.5
      robodyn accel 2r states.csv --format json
      robodyn accel 2r states.csv --force tip2=0,-20 | robodyn summary
    """
    mechanism = load_with(model, force)
    columns = column_names(mechanism, ["qdd", *FORCES])
    state_rows(mechanism, given, given.quantities(tau=tau), columns)
