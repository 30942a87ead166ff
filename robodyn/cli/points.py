"""`robodyn points`: where points are, and how they move."""

from __future__ import annotations

from robodyn.cli.options import Model, Qdd, option, switch
from robodyn.cli.states import TableOptions, state_rows
from robodyn.dynamics.columns import column_names
from robodyn.dynamics.named_points import NamedPoint, named_points
from robodyn.dynamics.transmission import ratio_named
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism

POINTS = "[NAME=]POINT"
OF = "A link (its tip), tip2, centre1, joint3, LINK@x,y, or a point of the scene; repeatable."
_RATIO = "The rate of one link over that of another, rocker/crank; repeatable."


def points(
    model: Model,
    given: TableOptions = TableOptions(),
    of: list[str] | None = option(OF, POINTS),
    qdd: Qdd = None,
    links: bool = switch("Each link's angle, its rate and acceleration."),
    transmission: bool = switch("The transmission angle of each loop, rad."),
    ratio: list[str] | None = option(_RATIO, "A/B"),
    jacobian: bool = switch("How far each point goes with each actuated joint."),
) -> None:
    """Where points are, how fast they move, and how they speed up.

    Columns of each point P: P_x,P_y (m), P_vx,P_vy (m/s), P_ax,P_ay (m/s^2), along the ground's
    axes; rows of STATES pass through with these added.  Without --of they are of the scene's
    `points`, or of all tips.

    --links adds angle1,w1,wd1 of each link (rad, rad/s, rad/s^2), from the ground's X axis;
    --transmission adds transmission1 of each loop (rad), 90 degrees where a force is handed on
    best; --ratio adds one column a ratio, empty where the second link stands still; its inverse is
    the mechanical advantage.  --jacobian adds P_Jx1,P_Jy1 (m/rad) for each actuated joint, so that
    P_vx is their sum times the joints' rates.

    \b
    Examples:
      robodyn points four-bar --q 60deg --qd 5 --of P=coupler@0.3,0.1
      robodyn points four-bar --q 60deg --of rocker --transmission \\
        --ratio rocker/crank
      robodyn simulate 2r --q 0,0 --time 2 | robodyn points 2r - --of tip2
      robodyn points 2r states.csv --of tip2 --extremes
    """
    mechanism = model.load()
    named = named_points(mechanism, of or (), "--of")
    families = ["points", *(["jacobian"] if jacobian else []), *(["links"] if links else [])]
    columns = column_names(mechanism, families, named)
    columns += _loops(mechanism) if transmission else []
    columns += [ratio_named(mechanism, text).name for text in ratio or ()]
    state_rows(mechanism, given, given.quantities(qdd=qdd), columns, of=named, adds=True)


def _loops(mechanism: Mechanism) -> list[str]:
    """The columns of --transmission; InputError where there are none."""
    loops = column_names(mechanism, ["transmission"])
    if not loops:
        limit = "no loop of this scene is closed by three pairs in a row"
        raise InputError("--transmission", where=mechanism.source, limit=limit)
    return loops


def points_given(
    mechanism: Mechanism, of: list[str] | None, trace: list[str] | None = None
) -> list[NamedPoint]:
    """The points of --of, and of --trace, which is another name of it; none without them."""
    found = {"--of": of or [], "--trace": trace or []}
    named = [named_points(mechanism, texts, where) for where, texts in found.items() if texts]
    return [point for points in named for point in points]
