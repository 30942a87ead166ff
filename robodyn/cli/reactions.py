"""`robodyn reactions`: the force in every pin, and what the ground feels."""

from __future__ import annotations

from robodyn.cli.options import Force, Model, Qdd, Text, load_with, option
from robodyn.cli.states import Quantity, TableOptions, state_rows
from robodyn.dynamics.columns import REACTIONS, column_names
from robodyn.errors import InputError

_TAU = "Joint torques, N m, in place of --qdd: all joints, or the actuated ones."


def reactions(
    model: Model,
    given: TableOptions = TableOptions(),
    qdd: Qdd = None,
    tau: Text = option(_TAU, "VECTOR"),
    force: Force = None,
) -> None:
    """The force in every pin, and the shaking force and moment on the ground.

    Columns, forces in N along the ground's axes: for each link k the force rx1,ry1 on it at its
    own joint, from the link (or the ground) that it hangs from; for each closure the pin force
    fx1,fy1 on the side that the scene names first; contact1 the force of a cam on its follower;
    shake_fx,shake_fy the total force of the
    mechanism on the ground, by joints, closures and sliders there; shake_m (N m) its moment about
    the origin.  Torques and damping of ground joints act on the ground too, with the opposite
    sign: they are in shake_m.  Those between links are internal.

    With --qdd (or columns qdd1..; default zero) the torques follow, as in `torque`; with --tau (or
    columns tau1..) the accelerations follow, as in `accel`.  A table may hold both, as `simulate`
    writes them, if they belong together.  Rows of STATES pass through with the columns added.

    Where closures depend on one another, or at a change point, a note names the forces that are
    not unique.  shake_* always are.

    \b
    Examples:
      robodyn reactions 2r --q 30deg,45deg --qd 1,0.5
      robodyn reactions four-bar --q 60deg --qd 5 --tau 1.5
      robodyn reactions 2r states.csv --format json
      robodyn reactions 2r states.csv | robodyn summary
      robodyn trajectory slider-crank --speed 300rpm --turns 1 --points 361 | \\
        robodyn reactions slider-crank - | robodyn summary --harmonics
    """
    if qdd is not None and tau is not None:
        limit = "give one of them: the accelerations cause the torques, or the torques those"
        raise InputError("--qdd and --tau are both given", limit=limit)
    mechanism = load_with(model, force)
    quantities = given.quantities()
    either = [Quantity("qdd", qdd), Quantity("tau", tau)]
    advice = f", or give --tau {','.join(['0'] * mechanism.n)}"
    columns = column_names(mechanism, REACTIONS)
    state_rows(mechanism, given, quantities, columns, either=either, advice=advice)
