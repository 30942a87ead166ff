"""`robodyn assemble`: all joints, and the points of all links, from the actuated joints."""

from __future__ import annotations

from itertools import product

import numpy as np

from robodyn.cli.options import Model, Out, OutputFormat, Q, Qd, Qdd
from robodyn.cli.output import Grid, default_format, note, row_writer, write_structure
from robodyn.cli.states import Quantity, complete_from, option_source, overflow
from robodyn.dynamics.closed_form import point_motion
from robodyn.loops import assembly, loop_rates
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.scene.scene import BRANCHES

MOST_LOOPS = 3  # with more two-way closures than this only the scene's own branch is told
PARTS = ("joint", "tip", "centre")


def assemble(
    model: Model,
    q: Q = None,
    qd: Qd = None,
    qdd: Qdd = None,
    format: OutputFormat = None,
    out: Out = None,
) -> None:
    """Close the loops: all angles, rates and points.

    A closure between two links can close in two ways, open (the pin lies to the left of the line
    from the first side's joint to the other's; for a slider, ahead along its line) or crossed;
    both are told, one a row, the scene's own first.  For each link there are the position (m)
    and velocity (m/s) of its joint, its tip and its centre of gravity.

    \b
    Examples:
      robodyn assemble robots/four-bar.yaml --q 60deg
      robodyn assemble robots/slider-crank.yaml --q 50deg --qd 10 --format json
    """
    mechanism = load(model)
    given = [Quantity("q", q, True), Quantity("qd", qd), Quantity("qdd", qdd)]
    sources = [option_source(mechanism, quantity) for quantity in given]
    found = []
    for name, branches in _branches(mechanism, sources[0].whole):
        motion = complete_from(mechanism, sources, branches)
        found.append((name, motion))
    kind = loop_rates.singular_kind(mechanism, found[0][1][0])
    if kind:
        note(f"Note: this is a singular configuration, a {kind}: both branches meet here")

    chosen = default_format(format, out)
    if chosen == "json":
        write_structure(out, {"branches": [_content(mechanism, *item) for item in found]}, None)
    elif chosen == "csv":
        columns = _columns(mechanism)
        with row_writer("csv", out, ["branch", *columns]) as writer:
            for name, motion in found:
                writer.write_row([name, *_row(mechanism, motion)])
    else:
        write_structure(out, {}, [x for item in found for x in _tables(mechanism, *item)])


def _branches(mechanism: Mechanism, whole: bool) -> list[tuple[str, tuple[str, ...] | None]]:
    """Each way to assemble, by name; the scene's own first."""
    if whole or not mechanism.rows:
        return [("given", None)]
    own = mechanism.description.branches
    two_way = assembly.assembly_plan(mechanism).two_way
    if not two_way:
        return [("start", None)]
    ways = [own]
    if len(two_way) <= MOST_LOOPS:
        for words in product(BRANCHES, repeat=len(two_way)):
            way = list(own)
            for closure, word in zip(two_way, words, strict=True):
                way[closure] = word
            if tuple(way) != own:
                ways.append(tuple(way))
    return [(" ".join(way[closure] for closure in two_way), way) for way in ways]


def _points(mechanism: Mechanism, motion: list[np.ndarray]) -> np.ndarray:
    """Position and velocity (x, y, vx, vy) of each link's joint, tip, centre, (n, 3, 4)."""
    points = [*mechanism.pivots, *mechanism.tips, *mechanism.centres]
    with np.errstate(all="ignore"):
        position, velocity, _ = point_motion(mechanism, points, motion[0], motion[1])
    both = np.concatenate([position, velocity], axis=-1)
    if not np.isfinite(both).all():
        raise overflow()
    return both.reshape(len(PARTS), mechanism.n, 4).transpose(1, 0, 2)


def _columns(mechanism: Mechanism) -> list[str]:
    joints = range(1, mechanism.n + 1)
    names = [f"{name}{k}" for name in ("q", "qd", "qdd") for k in joints]
    return names + [
        f"{part}_{component}{k}"
        for k in joints
        for part in PARTS
        for component in ("x", "y", "vx", "vy")
    ]


def _row(mechanism: Mechanism, motion: list[np.ndarray]) -> list[float]:
    values = [value for vector in motion for value in vector.tolist()]
    return values + _points(mechanism, motion).reshape(-1).tolist()


def _content(mechanism: Mechanism, name: str, motion: list[np.ndarray]) -> dict[str, object]:
    points = _points(mechanism, motion).tolist()
    links = [
        {"name": link}
        | {
            part: dict(zip(("x", "y", "vx", "vy"), points[k][p], strict=True))
            for p, part in enumerate(PARTS)
        }
        for k, link in enumerate(mechanism.link_names)
    ]
    vectors = dict(zip(("q", "qd", "qdd"), (vector.tolist() for vector in motion), strict=True))
    return {"branch": name, **vectors, "links": links}


def _tables(mechanism: Mechanism, name: str, motion: list[np.ndarray]) -> list[Grid]:
    columns = ["joint", "q [rad]", "q [deg]", "qd [rad/s]", "qdd [rad/s²]"]
    rows = []
    for k, link in enumerate(mechanism.link_names):
        q, qd, qdd = (vector[k] for vector in motion)
        rows.append([f"{k + 1} {link}", *(f"{x:.6g}" for x in (q, np.degrees(q), qd, qdd))])
    places = [
        [link, part, *(f"{value:.6g}" for value in values)]
        for link, parts in zip(mechanism.link_names, _points(mechanism, motion), strict=True)
        for part, values in zip(PARTS, parts, strict=True)
    ]
    where = ["link", "point", "x [m]", "y [m]", "vx [m/s]", "vy [m/s]"]
    return [Grid(columns, rows, name), Grid(where, places)]
