"""`robodyn draw`: the mechanism in a pose, to scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from robodyn.cli.figures import PictureOptions
from robodyn.cli.options import (
    AtTime,
    Model,
    Q,
    Qd,
    Qdd,
    Read,
    States,
    Text,
    option,
    refuse,
    switch,
    time_from,
)
from robodyn.cli.output import note
from robodyn.cli.points import OF, POINTS, points_given
from robodyn.cli.row_files import read_columns
from robodyn.cli.states import (
    Quantity,
    Source,
    complete,
    remarks,
    single_state,
    table_source,
    tell_unknown_contacts,
)
from robodyn.dynamics.columns import column_names, scene_units
from robodyn.errors import InputError
from robodyn.loops.assembly import first_pose
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.drawing import Trace, drawing, even_rows, traced
from robodyn.tables.csv_fields import shown

if TYPE_CHECKING:
    from robodyn.dynamics.named_points import NamedPoint
    from robodyn.pictures.force_arrows import Force

DEFAULT_POSES = 8
MOST_POSES = 200
Labels = Literal["names", "numbers"]  # what is written beside the links
_TAU = "Joint torques, N m, in place of --qdd, for --forces."


def draw(
    model: Model,
    states: States = None,
    read: Read = None,
    q: Q = None,
    qd: Qd = None,
    qdd: Qdd = None,
    tau: Text = option(_TAU, "VECTOR"),
    forces: bool = switch("Arrows: weights, the force in every pin, driving torques."),
    of: list[str] | None = option(OF, POINTS),
    labels: Labels | None = option("Beside each link."),
    branches: bool = switch("All poses that `assemble` lists at --q, side by side."),
    at_time: AtTime = None,
    poses: int = option("Of STATES, the most that are drawn.", "N", default=DEFAULT_POSES),
    picture: PictureOptions = PictureOptions(),
) -> None:
    """The mechanism in a pose, to scale.

    Circles are joints, quartered circles centres of gravity, hatched lines the ground; a slider
    moves between walls.  Without --q the scene's `start`, all angles zero, or the first pose
    found that closes.  Of the rows of STATES the last is drawn in full, and others, evenly chosen,
    pale behind it.  --of marks points, joins them to their links, and draws their paths through all
    rows.  --branches draws every pose that `assemble` lists at --q, under its number and words.

    With --forces: m1 g is the weight of link 1, r1 the force on link 1 at its own joint, f1 that
    on the side of closure 1 that the scene names first, as in `reactions`; tau1 drives link 1.

    \b
    Examples:
      robodyn draw four-bar --q 60deg --labels names -o four-bar.svg
      robodyn draw 2r --q 30deg,45deg --qd 1,0.5 --forces -o forces.png
      robodyn draw five-bar --q 120deg,60deg -o five-bar.pdf
      robodyn draw four-bar --q 60deg --branches -o branches.png
    """
    mechanism = model.load()
    picture.checked()
    if states is None:
        refuse("needs STATES", read=read)
    _check(states, q, {"qd": qd, "qdd": qdd, "tau": tau}, forces, poses)
    marked, t = points_given(mechanism, of), time_from(at_time)
    texts = _texts(mechanism, labels)
    if branches:
        limit = "does not go with --branches"
        alone = {"STATES": states, "--forces": forces, "--poses": poses != DEFAULT_POSES}
        for name, there in alone.items():
            if there:
                raise InputError(name, limit=limit)
        refuse(limit, qd=qd, qdd=qdd, tau=tau)
        with remarks():
            picture.save(
                _side_by_side(mechanism, Quantity("q", q, True), t, marked, texts, picture)
            )
        return
    found: list[Force] = []
    traces: list[Trace] = []
    with remarks():
        if states is not None:
            rows, chosen_rows = _rows(mechanism, states, read, poses, bool(marked), t)
            drawn = drawing(mechanism, rows[chosen_rows], marked)
            traces = traced(mechanism, marked, rows)
        elif forces:
            if q is None and not mechanism.description.begin(mechanism.actuated):
                raise InputError("--q", limit="missing: --forces needs a state")
            from robodyn.pictures.force_arrows import forces_at

            given = [Quantity("q", q, True), Quantity("qd", qd)]
            given.append(Quantity("qdd", qdd) if tau is None else Quantity("tau", tau))
            pose, rates, moved = single_state(mechanism, given, t=t)
            drawn = drawing(mechanism, pose, marked)
            tell_unknown_contacts(mechanism, column_names(mechanism, ["reactions"]))
            found = forces_at(mechanism, pose, rates, t=t, **{given[2].name: moved})
            if not found:
                note("Note: all forces are zero")
        elif q is None:
            pose = first_pose(mechanism, t=t)
            note(f"Note: without --q drawn at q = {', '.join(f'{x:.6g}' for x in pose)}")
            drawn = drawing(mechanism, pose, marked)
        else:
            (pose,) = single_state(mechanism, [Quantity("q", q, True)], t=t)
            drawn = drawing(mechanism, pose, marked)
    traces = traces or traced(mechanism, marked, drawn.q[-1:])
    from robodyn.pictures.mechanism_picture import mechanism_figure

    picture.save(mechanism_figure(drawn, texts, traces, found, picture.extent))


def _texts(mechanism: Mechanism, labels: Labels | None) -> list[str]:
    """Return the labels of the links."""
    if labels == "names":
        return list(map(shown, mechanism.link_names))
    return [str(k + 1) for k in range(mechanism.n)] if labels else []


def _side_by_side(
    mechanism: Mechanism,
    q: Quantity,
    t: float,
    marked: Sequence[NamedPoint],
    texts: Sequence[str],
    picture: PictureOptions,
) -> Any:
    """A figure of all poses that `assemble` lists, each under its number and words."""
    from robodyn.cli.assemble import found_poses
    from robodyn.pictures.mechanism_picture import poses_figure

    found, _, _ = found_poses(mechanism, [q], t)
    drawn = drawing(mechanism, np.array([pose for _, (pose,) in found]), marked)
    titles = [f"{k} {name}" for k, (name, _) in enumerate(found, start=1)]
    traces = [traced(mechanism, marked, pose[None]) for pose in drawn.q]
    return poses_figure(drawn, titles, texts, traces, picture.extent)


def _check(
    states: str | None,
    q: str | None,
    loads: Mapping[str, str | None],
    forces: bool,
    poses: int,
) -> None:
    """InputError for options that do not go together; `loads` are those of --forces."""
    if loads["qdd"] is not None and loads["tau"] is not None:
        raise InputError("--qdd and --tau", limit="exclude each other")
    if not forces:
        refuse("is for --forces: give that too", **loads)
    if states is not None and (forces or q is not None):
        raise InputError("STATES", limit="are drawn without --q and --forces")
    if not 1 <= poses <= MOST_POSES:
        raise InputError("--poses", value=poses, limit=f"must be from 1 to {MOST_POSES}")


def _rows(
    mechanism: Mechanism, states: str, read: str | None, poses: int, whole: bool, t: float
) -> tuple[np.ndarray, np.ndarray]:
    """Closed configurations (T, n) of a table, and which of them are drawn.

    These are evenly chosen, the last one included; without `whole` the others are left out.  The
    time is that of the column t, if laws ask for it, or t.
    """

    def columns(header: Sequence[str], name: str) -> Sequence[str]:
        sources.append(table_source(mechanism, Quantity("q", None, True), header, name))
        timed = mechanism.driven and "t" in header
        return [*sources[0].columns, *(["t"] if timed else [])]

    sources: list[Source] = []
    values, *_ = read_columns(states, columns, scene_units(mechanism), read)
    wanted = even_rows(len(values), poses)
    if not whole:
        values, wanted = values[wanted], np.arange(len(wanted))
    count = len(sources[0].columns)
    times = values[:, count] if values.shape[1] > count else np.full(len(values), t)
    return complete(mechanism, sources, [values[:, :count]], t=times)[0], wanted
