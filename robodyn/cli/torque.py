"""`robodyn torque`: inverse dynamics."""

from __future__ import annotations

from robodyn.cli.options import Force, Model, Number, Qdd, load_with, option
from robodyn.cli.states import TableOptions, state_rows
from robodyn.cli.turns import tell_flywheel
from robodyn.dynamics.columns import TORQUE, column_names


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
        tell_flywheel(mechanism, given, quantities, fluctuation)
        return
    advice = ", or name the residuals in --columns"
    state_rows(mechanism, given, quantities, column_names(mechanism, TORQUE), advice=advice)
