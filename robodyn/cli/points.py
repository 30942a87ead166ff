"""`robodyn points`: where points are, and how they move."""

from __future__ import annotations

import numpy as np

from robodyn.cli.options import Model, Qdd, Text, option, refuse
from robodyn.cli.output import chosen_names
from robodyn.cli.states import TableOptions, state_rows
from robodyn.dynamics.columns import column_names, of_joints, result_names
from robodyn.dynamics.named_points import NamedPoint, named_points
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism

POINTS = "[NAME=]POINT"
CAM = "In place of points: the profile of the cam that drives this link, x,y in the cam's frame."
ROWS = "Rows of the profile. Default: 721, one each half degree of a turn."
MOST_ROWS = 1_000_000
OF = "A link (its tip), tip2, centre1, joint3, LINK@x,y, or a point of the scene; repeatable."


def points(
    model: Model,
    given: TableOptions = TableOptions(),
    of: list[str] | None = option(OF, POINTS),
    qdd: Qdd = None,
    cam: Text = option(CAM, "LINK"),
    points: int | None = option(ROWS, "N"),
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

    With --cam FOLLOWER it writes the profile of that link's cam, along a turn of the cam's joint
    or between its limits, x,y (m) in the cam's frame: a file to cut.  Further --columns are the
    cam's angle (q1), the pitch curve's pitch_x,pitch_y, pressure1 (rad) and rho1 (m).

    \b
    Examples:
      robodyn points four-bar --q 60deg --qd 5 --of P=coupler@0.3,0.1
      robodyn points four-bar --q 60deg \\
        --columns rocker_x,rocker_y,transmission1,rocker/crank
      robodyn simulate 2r --q 0,0 --time 2 | robodyn points 2r - --of tip2
      robodyn points 2r states.csv --columns t,tip2_x,tip2_y | robodyn summary
      robodyn points disc-cam --cam follower -o cam.csv
    """
    mechanism = model.load()
    if cam is not None:
        _write_profile(mechanism, given, cam, points)
        return
    refuse("goes with --cam", points=points)
    named = named_points(mechanism, of or (), "--of")
    columns = column_names(mechanism, ["points"], named)
    state_rows(mechanism, given, given.quantities(qdd=qdd), columns, of=named, adds=True)


def _write_profile(
    mechanism: Mechanism, given: TableOptions, follower: str, points: int | None
) -> None:
    """Write the profile of a follower's cam, a row each point."""
    from robodyn.dynamics.cam_contacts import cam_named, outline

    states = {"STATES": given.states, "q": given.q, "qd": given.qd, "read": given.read}
    refuse("does not go with --cam: a profile belongs to no state", **states)
    cam = cam_named(mechanism, follower, "--cam")
    count = 721 if points is None else points
    if not 2 <= count <= MOST_ROWS:
        raise InputError("--points", value=count, limit=f"must be from 2 to {MOST_ROWS}")
    theta, touch = outline(mechanism, cam, count - 1)
    with np.errstate(divide="ignore"):
        rho = np.where(touch.curvature == 0.0, np.nan, 1.0 / touch.curvature)
    along = [*of_joints("q", [cam.driver]), *result_names("profile")]
    along += [x for family in ("pressure", "rho") for x in of_joints(family, [cam.coupling])]
    parts = (x for curve in (touch.profile, touch.pitch) for x in (curve.real, curve.imag))
    columns = dict(zip(along, (theta, *parts, touch.pressure, rho), strict=True))
    names = along[1:3] if given.columns is None else chosen_names(given.columns, along)
    with given.writer(names) as writer:
        for row in zip(*(columns[name].tolist() for name in names), strict=True):
            writer.write_row([None if np.isnan(x) else x for x in row])


def points_given(
    mechanism: Mechanism, of: list[str] | None, trace: list[str] | None = None
) -> list[NamedPoint]:
    """The points of --of, and of --trace, which is another name of it; none without them."""
    found = {"--of": of or [], "--trace": trace or []}
    named = [named_points(mechanism, texts, where) for where, texts in found.items() if texts]
    return [point for points in named for point in points]
