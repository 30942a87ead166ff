"""`robodyn points`: where points are, and how they move."""

from __future__ import annotations

from robodyn.cli.options import Model, Qdd, option
from robodyn.cli.states import TableOptions, state_rows
from robodyn.dynamics.columns import column_names
from robodyn.dynamics.named_points import NamedPoint, named_points
from robodyn.mechanics.mechanism import Mechanism

POINTS = "[NAME=]POINT"
OF = "A link (its tip), tip2, centre1, joint3, LINK@x,y, or a point of the scene; repeatable."


def points(
    model: Model,
    given: TableOptions = TableOptions(),
    of: list[str] | None = option(OF, POINTS),
    qdd: Qdd = None,
) -> None:
    """Where points are, how fast they move, and how they speed up.

    Columns of each point P: P_x,P_y (m), P_vx,P_vy (m/s), P_ax,P_ay (m/s^2), along the ground's
    axes; rows of STATES pass through with these added.  Without --of they are of the scene's
    `points`, or of all tips.

    --columns chooses among these and all others: angle1,w1,wd1 (`links`) of each link from the
    ground's X axis (rad, rad/s, rad/s^2); transmission1 of each loop (rad), 90 degrees where a
    force is handed on best; rocker/crank, the ratio of two links' rates, empty where the second
    stands still, whose inverse is the mechanical advantage; P_Jx1,P_Jy1 (`jacobian`, m/rad) for
    each actuated joint, so that P_vx is their sum times the joints' rates; P_kappa, icx1,icy1, ...

    \b
    Examples:
      robodyn points four-bar --q 60deg --qd 5 --of P=coupler@0.3,0.1
      robodyn points four-bar --q 60deg \\
        --columns rocker_x,rocker_y,transmission1,rocker/crank
      robodyn simulate 2r --q 0,0 --time 2 | robodyn points 2r - --of tip2
      robodyn points 2r states.csv --columns t,tip2_x,tip2_y | robodyn summary
    """
    mechanism = model.load()
    named = named_points(mechanism, of or (), "--of")
    columns = column_names(mechanism, ["points"], named)
    state_rows(mechanism, given, given.quantities(qdd=qdd), columns, of=named, adds=True)


def points_given(
    mechanism: Mechanism, of: list[str] | None, trace: list[str] | None = None
) -> list[NamedPoint]:
    """The points of --of, and of --trace, which is another name of it; none without them."""
    found = {"--of": of or [], "--trace": trace or []}
    named = [named_points(mechanism, texts, where) for where, texts in found.items() if texts]
    return [point for points in named for point in points]
