"""`robodyn identify`: masses, inertias, friction and springs from measured torques."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Annotated

import numpy as np

from robodyn.cli.files import output_file, rows_argument
from robodyn.cli.motion_files import MotionFile, read_motion
from robodyn.cli.options import Model, Number, OutputStructured, Read, Text, Unwrap, option, switch
from robodyn.cli.output import Grid, note, row_writer, write_structure
from robodyn.cli.states import remarks
from robodyn.dynamics.columns import column_names, of_joints, scene_units
from robodyn.dynamics.free_joints import balanced_joints
from robodyn.errors import InputError, RobodynError, at_place, named_options
from robodyn.mechanics.mechanism import Mechanism
from robodyn.parameters.identification import Identification, changes, numbers, predicted
from robodyn.parameters.identification import identify as identified
from robodyn.scene.rewrite import write_scene

_DATA = "CSV file (t, q1.., tau1.., and qd, qdd where they are known), or - for stdin."
_PHYSICAL = "Masses and moments of inertia above 0, damping and friction not below it."
_CUTOFF = "Low-pass for joint values whose rates are to be found, Hz, of zero phase."
_NOISY = "rates found from q follow its noise: give --cutoff, such as 10 (Hz)"
_REST = (
    "Rate, rad/s or m/s, up to which a joint with static friction is at rest. Default: 0.001 of "
    "its largest rate."
)
_OF = (
    "Numbers of the scene to find, links.forearm.m,links.forearm.I: masses, r, I, payloads, "
    "damping, friction, rotors, springs; else base parameters. Lengths: see `fit`."
)
_SCENE = "Write the scene with the numbers found here; comments and order stay. - is stdout."
_RESIDUALS = "Write the rows here, with residual1..: tau less what the numbers found give."
LITTLE = 0.1  # of a torque's rms: where more is left, the scene does not tell the data
MOST = 0.5  # of it, with friction beside, that data of this mechanism leave, but for noise
NOISE = 0.5  # of what is left, by its steps from row to row: noise has 1, what is even has 0
ROUNDED = 1e-3  # of a torque's rms: less is left by rounding and by rates that were found
BELOW = 5.0  # standard errors by which what no body has below 0 is below it


def identify(
    model: Model,
    data: Annotated[str, rows_argument("DATA", _DATA)],
    of: Text = option(_OF, "NAMES"),
    physical: bool = switch(_PHYSICAL),
    cutoff: Number = option(_CUTOFF, "HZ"),
    unwrap: Unwrap = False,
    read: Read = None,
    rest: Number = option(_REST, "RATE"),
    fitted: Annotated[Text, output_file("--out", "-o", help=_SCENE)] = None,
    residuals: Annotated[Text, output_file("--residuals", help=_RESIDUALS)] = None,
    format: OutputStructured = None,
) -> None:
    """The parameters of a mechanism from its torques along a motion, by least squares.

    Without --of the base parameters are found: what the torques depend on (see regressor --base).
    Columns qd, qdd are used as they are; missing ones are found by quintic splines through t, after
    a low-pass with --cutoff. A joint with static friction is held by any torque within it while it
    rests (--rest), so its equation is left out there.

    JSON keys: rows, at_rest (rows left out of each torque), condition (of the columns that were
    fitted, each scaled to 1), parameters (name, value, error: the standard error, scene: the
    scene's value, unit), kept (what the data do not tell: it keeps the scene's number), rms and
    rms_torque (N m, of what is left of the torques, and of the torques).

    Joints are weighted by what a first fit leaves of their torques. The standard errors are those
    of noise in the torques that is independent from row to row; noise in q is not in them.

    \b
    Examples:
      robodyn identify 2r measured.csv --format table
      robodyn identify 2r measured.csv --of links.forearm.m -o new.yaml
      robodyn identify 2r measured.csv --cutoff 20 --physical --residuals left.csv
    """
    mechanism = model.load()
    names = [] if of is None else [x.strip() for x in of.split(",")]
    if "" in names:
        raise InputError("--of", value=of, limit="a name is missing at a comma")
    linear, values = numbers(mechanism.description), model.values()
    for name in names:
        if name in values and name not in linear:
            torques = ",".join(column_names(mechanism, ["tau"]))
            way = f"robodyn fit {model.model} --vary '{name}=LOW:HIGH' --match {data}"
            limit = "torques are not linear in it, as in masses, moments, friction and stiffness"
            limit += f"; find it by {way} --columns {torques} (the file needs qd and qdd)"
            raise InputError("--of", value=name, limit=limit)
    with remarks(), named_options(["cutoff", "rest"]):
        motion = read_motion(mechanism, data, True, cutoff, unwrap, read)
        q, qd, qdd = motion.states
        with at_place(motion.source, "rows", "tau"), at_place("--of", *names or "-"):
            measured = motion.tau, motion.t
            found = identified(mechanism, q, qd, qdd, *measured, names, physical, rest)
    joints = [k + 1 for k in balanced_joints(mechanism)]
    at_rest = _told_at_rest(found, joints)
    if not names and not physical:
        _check_told(mechanism, found, motion)
    _tell_left(mechanism, found, motion, joints)
    if residuals is not None:
        _write_residuals(mechanism, found, motion, residuals)
    content: dict[str, object] = {
        "rows": found.rows,
        "at_rest": at_rest,
        "condition": found.condition,
        "parameters": [x._asdict() for x in found.estimates],
        "kept": list(found.kept),
    }
    for name, left in (("rms", found.rms), ("rms_torque", found.rms_torque)):
        content[name] = dict(zip((f"tau{k}" for k in joints), left.tolist(), strict=True))
    if fitted is not None:
        _write_scene(mechanism, model, found, fitted)
    if "-" in (fitted, residuals):  # which took the place of the results
        return
    write_structure(format, None, content, lambda: list(_tables(found, joints)))


def _told_at_rest(found: Identification, joints: list[int]) -> dict[str, int]:
    """Return how many rows are left out of each torque, of those with any; a note tells them."""
    counts = dict(zip(joints, found.at_rest.sum(axis=0).tolist(), strict=True))
    at_rest = {f"tau{k}": count for k, count in counts.items() if count}
    if at_rest:
        each = ", ".join(f"{count} of {found.rows} for {tau}" for tau, count in at_rest.items())
        note(f"Note: rows in which static friction holds a joint at rest are left out: {each}")
    return at_rest


def _tell_left(
    mechanism: Mechanism, found: Identification, motion: MotionFile, joints: list[int]
) -> None:
    """Warn of torques that are not told and of numbers that no body has; note what stays."""
    untold = [
        f"{100 * left / usual:.3g} % of tau{k}"
        for k, left, usual in zip(joints, found.rms, found.rms_torque, strict=True)
        if left > LITTLE * usual > 0.0
    ]
    if untold:
        text = f"{', '.join(untold)} are not told by {mechanism.source} with the numbers found"
        why = f"{_NOISY}; or " if motion.noisy else ""
        why += "noise, friction, or data of another mechanism?"
        note(f"Warning: {motion.source}: {text}: {why}")
    rough = (found.rms > ROUNDED * found.rms_torque).any()
    for x in found.estimates if rough else ():
        if not re.search("m[xy]|[-.]", x.name) and x.value < -BELOW * x.error:
            text = f"{x.name} = {x.value:.6g}, below 0 by {-x.value / x.error:.3g} standard errors"
            note(f"Warning: {motion.source}: {text}: no body has that")
    if found.kept:
        note(f"Note: the data do not tell, and the scene's stay: {', '.join(found.kept)}")


def _check_told(mechanism: Mechanism, found: Identification, motion: MotionFile) -> None:
    """InputError where no parameters, nor friction or noise beside, tell the torques along t."""
    driven = mechanism.actuated
    places = [balanced_joints(mechanism).index(k) for k in driven]
    usual = found.rms_torque[places]
    usual[usual == 0.0] = np.inf  # rounding is left of torques that are none
    if not np.any(motion.t) or not (found.rms[places] > MOST * usual).any():
        return
    left = motion.tau - predicted(mechanism, found, motion.states, motion.t)[:, places]
    left[found.at_rest[:, places]] = 0.0
    slip = np.sign(motion.states[1][:, list(driven)])
    slip /= np.maximum(np.linalg.norm(slip, axis=0), 1.0)
    left -= slip * (slip * left).sum(axis=0)
    size = np.sqrt((left**2).mean(axis=0))
    steps = (np.diff(left, axis=0) ** 2).mean(axis=0) / np.maximum(2.0 * size**2, 1e-300)
    for k, part, rough in zip(driven, size / usual, steps, strict=True):
        if part > MOST and rough < NOISE:
            value = f"{100 * part:.3g} % of its rms is left by any masses, dampers and friction"
            limit = f"{100 * MOST:g} % at most, but for noise, which this is not: it is even from "
            limit += "row to row. These are data of another mechanism"
            if motion.noisy:
                limit = f"{_NOISY}; if it leaves more than {100 * MOST:g} % these are data of "
                limit += "another mechanism"
            raise InputError(f"tau{k + 1}", where=motion.source, value=value, limit=limit)


def _write_scene(mechanism: Mechanism, model: Model, found: Identification, out: str) -> None:
    if found.faults:
        limit = f"is no scene: {', '.join(found.faults)}; --physical keeps to what can be"
        raise RobodynError("what was found", where=out, limit=limit)
    found_there = changes(mechanism.description, found.description, model.values())
    write_scene(model.model, model.put() | found_there, out)


def _write_residuals(
    mechanism: Mechanism, found: Identification, motion: MotionFile, file: str
) -> None:
    told = predicted(mechanism, found, motion.states, motion.t)
    joints = balanced_joints(mechanism)
    left = motion.tau - told[:, [joints.index(k) for k in mechanism.actuated]]
    columns = of_joints("residual", mechanism.actuated)
    with row_writer("csv", file, columns, motion.header, scene_units(mechanism)) as writer:
        writer.write_rows(motion.lines, left)


def _tables(found: Identification, joints: list[int]) -> Iterator[Grid]:
    rows = [
        [x.name, f"{x.value:.6g}", f"{x.error:.2g}", f"{x.scene:.6g}", x.unit]
        for x in found.estimates
    ]
    yield Grid(["parameter", "value", "standard error", "scene", "unit"], rows)
    if found.kept:
        yield Grid(["keeps the scene's number"], [[x] for x in found.kept])
    left = zip(joints, found.rms, found.rms_torque, strict=True)
    yield Grid(["torque", "rms", "rms of what is left"], [[f"tau{k}", y, x] for k, x, y in left])
    yield Grid(["rows", "condition"], [[str(found.rows), f"{found.condition:.6g}"]])
