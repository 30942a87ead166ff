"""`robodyn assemble`: all joints, and the points of all links, from the actuated joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from robodyn.cli.options import AtTime, Model, Qdd, Text, option, refuse, switch, time_from
from robodyn.cli.output import (
    Grid,
    RowOptions,
    default_format,
    degrees,
    in_told_units,
    note,
    write_structure,
)
from robodyn.cli.states import (
    Quantity,
    Source,
    StateOptions,
    chosen_columns,
    complete,
    option_source,
    single_state,
)
from robodyn.dynamics.columns import (
    OF_PARTS,
    column_names,
    in_degrees,
    result_names,
    scene_units,
    with_unit,
)
from robodyn.dynamics.joint_vectors import driver_of
from robodyn.dynamics.named_points import named_point, named_points
from robodyn.dynamics.state import State, find
from robodyn.errors import AssemblyError, InputError, SingularError, named_options, overflow
from robodyn.loops import assembly, loop_rates
from robodyn.mechanics.driven import refuse_driven
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import beyond, end_word
from robodyn.scene.point_names import PARTS
from robodyn.scene.quantities import parse_vector, value_from
from robodyn.tables.csv_fields import shown
from robodyn.trajectories.joint_ranges import joint_ranges
from robodyn.trajectories.postures import postures

(BRANCH,) = result_names("branch")
MOST_LOOPS = 3  # with more two-way closures than this only the scene's own branch is told
VECTORS = ("q", "qd", "qdd")
COMPONENTS = ("x", "y", "vx", "vy")
_OF = "The point that is to be at --to-xy: a link (its tip), tip2, centre1, LINK@x,y, a named one."
_TO_XY = "In place of the pose of --q: where --of is to be, m; the pose is sought near --q."
_ANGLE = "With --to-xy: the absolute angle of the point's link, from the X axis, plate=30deg."
Found = list[tuple[str, list[np.ndarray]]]  # poses by name: q, and what else there is
Ways = dict[str, tuple[str, ...] | None]  # the branches of each name


def assemble(
    model: Model,
    state: StateOptions = StateOptions(),
    qdd: Qdd = None,
    range: bool = switch("How far each actuated joint can go from there, in place of the points."),
    of: Text = option(_OF, "POINT"),
    to_xy: Text = option(_TO_XY, "X,Y"),
    angle: list[str] | None = option(_ANGLE, "LINK=VALUE"),
    at_time: AtTime = None,
    rows: RowOptions = RowOptions(),
) -> None:
    """Close the loops: all angles, rates and points.

    A closure between two links can close in two ways, open (the pin lies to the left of the line
    from the first side's joint to the other's; for a slider, ahead along its line) or crossed;
    both are told, one a row, the scene's own first.  For each link there are the position (m)
    and velocity (m/s) of its joint, its tip and its centre of gravity.

    With --range it tells in place of that how far each actuated joint can go from there, the others
    held: its least and largest angle (rad) or displacement (m), and what ends each way, a dead
    centre, a change point, a limit of a joint, or nothing but a full turn.

    With --to-xy it brings the point --of to a place (inverse kinematics): all postures of an arm of
    two joints, `left` where the second joint lies to the left of the line from the first to the
    point; else the one nearest to --q, the scene's `start`, or the first pose that closes.  A --q
    of all joints need not close, and picks the branch.

    \b
    Examples:
      robodyn assemble four-bar --q 60deg
      robodyn assemble slider-crank --q 50deg --qd 10 --format json
      robodyn assemble five-bar --q 120deg,60deg --range
      robodyn assemble 2r --of tip2 --to-xy 0.5,0.6
    """
    mechanism = model.load()
    given, t = state.quantities(qdd=qdd), time_from(at_time)
    if range or to_xy is not None:
        refuse_driven(mechanism, "--range and --to-xy")
    if to_xy is None:
        refuse("goes with --to-xy", of=of, angle=angle)
        found, ways, barred = found_poses(mechanism, given, t)
        kind = loop_rates.singular_kind(mechanism, found[0][1][0], t)
        if kind:
            note(f"Note: this is a singular configuration, a {kind}: both branches meet here")
    else:
        found, ways, barred = _led(mechanism, given, of, to_xy, angle or [])
    if range:
        reached = [branch for branch in found if branch[0] not in barred]
        _write_ranges(mechanism, reached, ways, rows)
        return
    branches, units = [_content(mechanism, *item) for item in found], scene_units(mechanism)
    chosen = default_format(rows.format, rows.out)
    if chosen == "csv" or rows.columns is not None:
        _write_rows(mechanism, found, rows, t)
    else:
        content = in_told_units({"branches": branches}, units)
        slides = mechanism.slides
        tables = [table for branch in content["branches"] for table in _tables(branch, slides)]
        write_structure(chosen, rows.out, content, lambda: tables)


def found_poses(
    mechanism: Mechanism, given: Sequence[Quantity], t: float
) -> tuple[Found, Ways, set[str]]:
    """The poses that close at the state of the options at t, the scene's own first.

    With the branches that their names stand for, and the names of those beyond limits, which a note
    tells; AssemblyError where the scene's own is.
    """
    ways = _branches(driver_of(mechanism), option_source(mechanism, given[0]).whole)
    found = [(ways[0][0], single_state(mechanism, given, t=t))]
    for name, way in ways[1:]:
        # a branch that was not asked for never makes the command fail
        with suppress(AssemblyError, SingularError, InputError):
            found.append((name, single_state(mechanism, given, way, t=t)))
    return found, dict(ways), _barred(mechanism, found)


def _barred(mechanism: Mechanism, found: Found) -> set[str]:
    """The names of poses beyond limits, with a note; AssemblyError where the first is."""
    barred: set[str] = set()
    for name, (q_there, *_) in found:
        for joint, side, end in beyond(mechanism, q_there.tolist(), turns=True):
            where = f"q{joint + 1} ({mechanism.link_names[joint]})"
            limit = f"is beyond the joint's {end_word(side)}, {end:.9g}"
            if name == found[0][0]:
                value = float(q_there[joint])
                raise AssemblyError(where, where=mechanism.source, value=value, limit=limit)
            note(f"Note: {name}: {where} = {float(q_there[joint]):.9g} {limit}")
            barred.add(name)
    return barred


def _led(
    mechanism: Mechanism,
    given: Sequence[Quantity],
    of: str | None,
    to_xy: str,
    angles: Sequence[str],
) -> tuple[Found, Ways, set[str]]:
    """Return the postures that bring a point to a place, those within limits first."""
    if of is None:
        raise InputError("--of", limit="missing: give the point that is to be at --to-xy")
    named = named_point(mechanism, of, "--of")
    xy = parse_vector(to_xy, where="--to-xy", unit="m")
    if len(xy) != 2 or not np.isfinite(xy).all():
        raise InputError("--to-xy", value=shown(to_xy), limit="must be x,y (m), 0.4,0.6")
    link = None if named.own.link is None else mechanism.link_names[named.own.link]
    if len(angles) > 1:
        raise InputError("--angle", value=len(angles), limit=f"give one, that of {link}")
    turned = None
    for text in angles:
        name, equals, value = text.rpartition("=")
        if not equals or name != link:
            limit = f"must be {link}=VALUE: {link} is the link of {named.name}"
            raise InputError("--angle", value=shown(text), limit=limit)
        turned = value_from(value, "rad", "--angle", f"{link}=30deg")
        if not math.isfinite(turned):
            raise InputError("--angle", value=shown(text), limit="must be finite")
    near = None if given[0].option is None else option_source(mechanism, given[0]).values
    with named_options(("of", "angle"), xy="to_xy", near="q"):
        every = postures(mechanism, xy, of, turned, near)
    every.sort(key=lambda each: bool(beyond(mechanism, each.q.tolist(), turns=True)))
    found: Found = []
    for branch, q in every:
        rest = [option_source(mechanism, each) for each in given[1:]]
        sources = [Source(given[0], q.tolist(), [], True), *rest]
        values = [np.array(source.values) for source in sources]
        found.append((branch, complete(mechanism, sources, values, t=0.0)))
    return found, dict.fromkeys(dict(every)), _barred(mechanism, found)


def _write_ranges(
    mechanism: Mechanism,
    found: list[tuple[str, list[np.ndarray]]],
    ways: Mapping[str, tuple[str, ...] | None],
    rows: RowOptions,
) -> None:
    """Write the range of each actuated joint, one per row, for each way to assemble."""
    with rows.writer([BRANCH, *result_names("range")]) as writer:
        for name, (q, *_) in found:
            try:
                ranges = joint_ranges(mechanism, q, ways[name])
            except (AssemblyError, SingularError) as error:
                if name == found[0][0]:
                    raise
                note(f"Note: {name}: {error}")
                continue
            for joint, low, high, low_end, high_end in ranges:
                told, factor = f"q{joint + 1}", 1.0
                if degrees.get():
                    told, factor = in_degrees(told, scene_units(mechanism))
                ends: list[float | str] = [name, told]
                for last, end in ((low, low_end), (high, high_end)):
                    ends += ["" if end == "nothing" else factor * last, end]
                writer.write_row(ends)


def _branches(mechanism: Mechanism, whole: bool) -> list[tuple[str, tuple[str, ...] | None]]:
    """Each way to assemble, by name; the scene's own first."""
    if whole or not mechanism.rows:
        return [("given", None)]
    own = assembly.scene_branches(mechanism)
    two_way = assembly.assembly_plan(mechanism).two_way
    if not two_way:
        return [("start", None)]
    ways = [own]
    if len(two_way) <= MOST_LOOPS:
        ways += [way for way in assembly.all_branches(mechanism) if way != own]
    return [(" ".join(way[closure] for closure in two_way), way) for way in ways]


def _content(mechanism: Mechanism, name: str, motion: list[np.ndarray]) -> dict[str, Any]:
    """One way to assemble: its name, q, qd, qdd, and the points of every link."""
    names = column_names(mechanism, ["places"])
    with np.errstate(all="ignore"):
        values = State(mechanism, *motion).columns(names)
    if not np.isfinite(values).all():
        raise overflow()
    places, links = dict(zip(names, values.tolist(), strict=True)), []
    for k, name_of_link in enumerate(mechanism.link_names):
        link: dict[str, Any] = {"name": name_of_link}
        for part in PARTS:
            own = {c: places[x] for c in COMPONENTS if (x := f"{part}_{c}{k + 1}") in places}
            link |= {part: own} if own else {}
        links.append(link)
    vectors = {vector: x.tolist() for vector, x in zip(VECTORS, motion, strict=True)}
    return {"branch": name, **vectors, "links": links}


def _write_rows(mechanism: Mechanism, found: Found, rows: RowOptions, t: float) -> None:
    """One way to assemble a row: its name, and the columns of the state, or those of --columns."""
    points = named_points(mechanism)
    columns = [BRANCH, *column_names(mechanism, ["q", "qd", "qdd", "places"])]
    if rows.columns is not None:
        columns, _ = chosen_columns(mechanism, rows.columns, columns, [], points)
    numeric = [name for name in columns if name != BRANCH]
    gaps = [family.gaps for name in numeric if (family := find(mechanism, name, points))]
    with rows.writer(columns, units=scene_units(mechanism), only=columns) as writer:
        for branch, motion in found:
            with np.errstate(all="ignore"):
                q, qd, qdd = motion
                values = State(mechanism, q, qd, qdd, t=t, of=points).columns(numeric)
            if not np.isfinite(values[np.logical_not(gaps)]).all() or np.isinf(values).any():
                raise overflow()
            row = [None if math.isnan(x) else x for x in values.tolist()]
            each: dict[str, float | str | None] = dict(zip(numeric, row, strict=True))
            each[BRANCH] = branch
            writer.write_row([each[name] for name in columns])


def _tables(branch: dict[str, Any], slides: Sequence[int]) -> list[Grid]:
    links = branch["links"]
    keys = [key for key in branch if key not in ("branch", "links")]  # q or q_deg, ...
    joints = [
        [f"{k + 1} {link['name']}", *(branch[key][k] for key in keys)]
        for k, link in enumerate(links)
    ]
    places = [
        [link["name"], part, *link[part].values()]
        for link in links
        for part in PARTS
        if part in link
    ]
    angles = ["joint", *(with_unit(key, OF_PARTS) for key in keys)]
    ways = ["joint", "q [m]", "qd [m/s]", "qdd [m/s²]"]
    where = ["link", "point", "x [m]", "y [m]", "vx [m/s]", "vy [m/s]"]
    turning = [row for k, row in enumerate(joints) if k not in slides]
    sliding = [joints[k] for k in slides]
    if "q" in keys:
        angles.insert(2, "q [deg]")
        turning = [[name, q, math.degrees(q), *rates] for name, q, *rates in turning]
    tables = [Grid(angles, turning)] if turning else []
    tables += [Grid(ways, sliding)] if sliding else []
    return [tables[0]._replace(title=branch["branch"]), *tables[1:], Grid(where, places)]
