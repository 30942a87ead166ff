"""`robodyn animate`: a motion as a moving picture."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import numpy as np

from robodyn.cli.equilibrium import joint_torques
from robodyn.cli.figures import check_directory, parse_size
from robodyn.cli.files import output_file, rows_argument
from robodyn.cli.motion_files import whole_table, without_jumps
from robodyn.cli.options import HoldingTau, Model, Q, Read, Size, Text, Unwrap, option, refuse
from robodyn.cli.points import OF, POINTS, points_given
from robodyn.cli.progress import progress
from robodyn.cli.row_files import open_rows
from robodyn.cli.states import Quantity, complete, remarks, single_state, table_source
from robodyn.dynamics.columns import scene_units
from robodyn.errors import InputError, at_place, named_options
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.animation_files import (
    Frames,
    MovingPicture,
    check_animation,
    check_programs,
    frames,
)
from robodyn.rest.linear_model import linearize, mode_motion

SHOWN = 2.0  # s that a mode is watched at least
_OUT = "Write here, all or nothing: .gif, .mp4 or .html."
_MODE = "In place of rows: natural mode K, as linearize counts them, about --q."


def animate(
    model: Model,
    states: Annotated[Text, rows_argument("CSV", "Rows with t and q1..; - is stdin.")] = None,
    *,
    out: Annotated[str, output_file("--out", "-o", help=_OUT)],
    mode: int | None = option(_MODE, "K"),
    unwrap: Unwrap = False,
    read: Read = None,
    q: Q = None,
    tau: HoldingTau = None,
    of: list[str] | None = option(OF, POINTS),
    trace: list[str] | None = option("The same as --of.", POINTS),
    fps: float = option("Frames a second.", "N", default=25.0),
    speed: float = option("Seconds of the motion in one second.", "X", default=1.0),
    size: Size = None,
) -> None:
    """A motion as a moving picture, in real time.

    --of draws the paths of points behind it.  The rows are those that simulate, torque and others
    write: t and q1.., or the q of the actuated joints alone; with qd1.. what is between rows is
    smoother.  A gif plays anywhere, an html page holds everything in itself and can be halted and
    turned by hand (it needs no extra), an mp4 needs the program ffmpeg.

    --mode shows a natural mode of small motions about --q in place of rows: enlarged, undamped, for
    whole periods.

    \b
    Examples:
      robodyn animate four-bar run.csv --of coupler,centre2 -o run.html
      robodyn simulate 2r --q 0,0 --time 3 | robodyn animate 2r - -o arm.gif
      robodyn animate 3r --mode 2 --q -90deg,0,0 -o mode2.html
    """
    with named_options(["out", "fps", "speed"]):
        check_animation(out, fps, speed)
    extent = parse_size(size)
    if mode is None:
        refuse("is of a natural mode: give --mode K", q=q, tau=tau)
    if (states is None) == (mode is None):
        limit = "give rows, or --mode K and --q" + (", not both" if states else "")
        raise InputError("CSV", value=states, limit=limit)
    if unwrap and states is None:
        raise InputError("--unwrap", limit="goes with rows: CSV")
    if states is None:
        refuse("goes with rows: CSV", read=read)
    mechanism = model.load()
    traced = points_given(mechanism, of, trace)
    check_directory(out)
    check_programs(out)
    with remarks():
        if states is not None:
            shown_frames = _read(mechanism, states, read, fps, speed, unwrap)
        else:
            shown_frames = _of_mode(mechanism, mode or 0, q, tau, fps, speed)
    watched = partial(progress, "drawing", silent=0.0)
    MovingPicture.of(mechanism, shown_frames, speed, traced, extent).write(out, watched)


def _of_mode(
    mechanism: Mechanism, mode: int, q: Text, tau: Text, fps: float, speed: float
) -> Frames:
    (pose,) = single_state(mechanism, [Quantity("q", q, True)], t=0.0)
    torques = None if tau is None else joint_torques(mechanism, tau)
    with named_options(["mode"]):
        model = linearize(mechanism, pose, None, torques)
        t, poses = mode_motion(mechanism, model, mode, SHOWN * speed)
    return frames(mechanism, t, poses, None, fps, speed)


def _read(
    mechanism: Mechanism, states: str, read: str | None, fps: float, speed: float, unwrap: bool
) -> Frames:
    with open_rows(states, scene_units(mechanism), read) as reader:
        name = reader.source
        quantities = [Quantity("q", None, True), Quantity("qd", None)]
        sources = [table_source(mechanism, x, reader.names, name) for x in quantities]
        sources = [source for source in sources if source.columns]
        columns = [column for source in sources for column in source.columns]
        column, chunks = whole_table(reader, ["t", *columns])
    lines = [line for chunk in chunks for line in chunk.line_numbers]
    column = without_jumps(mechanism, column, lines, name, unwrap, columns)
    t = column["t"]
    with at_place(name):
        given = [np.array([column[x] for x in source.columns]).T for source in sources]
        q, *qd = complete(mechanism, sources, given, t=t)
        if not sources[0].whole:  # assembled angles lie in one turn
            turning = [k for k in range(mechanism.n) if k not in mechanism.slides]
            q[:, turning] = np.unwrap(q[:, turning], axis=0)
        return frames(mechanism, t, q, qd[0] if qd else None, fps, speed)
