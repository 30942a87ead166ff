"""`robodyn regressor`: the matrix that makes torques of parameters, and the base parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn.cli.motion_files import read_motion
from robodyn.cli.options import Model, Qdd, switch
from robodyn.cli.output import Grid, chosen_names, write_structure
from robodyn.cli.states import Quantity, TableOptions, Task, evaluate, remarks
from robodyn.dynamics.columns import result_names
from robodyn.dynamics.free_joints import balanced_joints, balanced_mechanism
from robodyn.errors import InputError
from robodyn.mechanics.driven import check_torques
from robodyn.mechanics.mechanism import Mechanism
from robodyn.parameters.base_parameters import base_parameters, excited, structural
from robodyn.parameters.regression_matrix import linear_parameters
from robodyn.parameters.regression_matrix import regressor as matrix


def regressor(
    model: Model,
    given: TableOptions = TableOptions(),
    qdd: Qdd = None,
    base: bool = switch(
        "The fewest combinations of parameters that torques depend on, with the scene's numbers; "
        "with states the columns of these alone."
    ),
    condition: bool = switch(
        "In place of the rows: the condition of the base parameters' columns, each scaled to 1, "
        "and the combinations that the motion does not excite."
    ),
) -> None:
    """Y(q, qd, qdd): the torques are linear in masses, moments, dampers and springs, tau = Y pi.

    Columns Y1_m2, ..: of joint 1 (actuated, or free: its torque is 0) by the mass of link 2, m2
    (kg, payload included). The others are mx2, my2 (its first moment m r in its own frame, kg m),
    J2 (its moment of inertia about its own joint, kg m^2), d2 (damping of its joint), f2
    (friction), Jr2 (its motor's rotor), k1 (stiffness of spring 1), ds1 (its damping). Where the
    scene has loads, laws of springs or stops, Y1_known is what they take: it counts once.

    --base tells the base parameters: name, text (J1 + l1^2 m2), value, unit.

    \b
    Examples:
      robodyn regressor 2r --q 30deg,45deg --qd 1,0.5
      robodyn regressor four-bar --base --format table
      robodyn trajectory 2r --from 0,0 --to 1,2 --time 1 | \\
        robodyn regressor 2r - --condition
    """
    mechanism = model.load()
    if mechanism.rows:
        mechanism = balanced_mechanism(mechanism)
    check_torques(mechanism)
    quantities = given.quantities(qdd=qdd)
    if condition:
        _tell_condition(mechanism, given, quantities)
        return
    if base and given.states is None and given.q is None:
        _tell_base(mechanism, given)
        return
    names = [x.name for x in linear_parameters(mechanism.description)]
    chosen = structural(mechanism).kept if base else list(range(len(names)))
    joints = [str(k + 1) for k in balanced_joints(mechanism)]
    columns = [x for j in joints for k in chosen for x in result_names("regressor", [j], names[k])]
    loaded = bool(mechanism.description.loads or mechanism.signals or mechanism.ranges)
    columns += result_names("regressor", joints, "known") if loaded else []

    def compute(**motion: np.ndarray) -> np.ndarray:
        found = matrix(mechanism, **motion)
        Y = found.Y[..., chosen].reshape(len(found.Y), -1)
        return np.concatenate([Y, found.known], axis=-1) if loaded else Y

    def task(header: Sequence[str]) -> Task:
        if given.columns is None:
            return Task(quantities, columns, compute)
        only = chosen_names(given.columns, [*header, *columns])
        return Task(quantities, columns, compute, only=only)

    evaluate(mechanism, given, task)


def _tell_base(mechanism: Mechanism, rows: TableOptions) -> None:
    with remarks():
        found = base_parameters(mechanism)
    content = [{"name": x.name, "text": x.text, "value": x.value, "unit": x.unit} for x in found]
    table = Grid(["text", "value", "unit"], [[x.text, x.value, x.unit] for x in found])
    write_structure(rows.format, rows.out, {"base": content}, lambda: [table])


def _tell_condition(mechanism: Mechanism, rows: TableOptions, quantities: list[Quantity]) -> None:
    told = next((f"--{x.name}" for x in quantities if x.option is not None), None)
    if rows.states is None or told:
        raise InputError(told or "--condition", limit="--condition takes a motion from STATES")
    motion = read_motion(mechanism, rows.states, torques=False, unwrap=rows.unwrap, read=rows.read)
    with remarks():
        base, kept = base_parameters(mechanism), structural(mechanism).kept
        q, qd, qdd = motion.states
        found = matrix(mechanism, q, qd, qdd, motion.t)
    every = found.Y.reshape(-1, len(found.names))
    Y, alike = every[:, kept], excited(mechanism, every)
    value = None
    if alike.kept:
        scaled = Y[:, alike.kept] / np.linalg.norm(Y[:, alike.kept], axis=0)
        singular = np.linalg.svd(np.linalg.qr(scaled, mode="r"), compute_uv=False)
        value = float(singular[0] / singular[-1])
    untold = [base[k].text for k in alike.dropped]
    content = {"rows": len(motion.t), "condition": value, "not_excited": untold}
    words = [str(len(motion.t)), "none" if value is None else f"{value:.6g}"]
    tables = [Grid(["rows", "condition"], [words])]
    tables += [Grid(["not excited"], [[x] for x in untold])] if untold else []
    write_structure(rows.format, rows.out, content, lambda: tables)
