"""`robodyn terms`: the terms of the equation of motion at one state."""

from __future__ import annotations

import numpy as np

from robodyn.cli.options import Model, Out, OutputStructured, Q, Qd
from robodyn.cli.output import Grid, write_structure
from robodyn.cli.states import Quantity, overflow, single_state
from robodyn.dynamics import closed_form
from robodyn.mechanics.mechanism import load


def terms(
    model: Model,
    q: Q = None,
    qd: Qd = None,
    format: OutputStructured = None,
    out: Out = None,
) -> None:
    """M, C, G, the closures' Psi, and the energies at a state.

    They are terms of M qdd + C qd + D qd + G = tau + Q + Psi^T lambda, in SI units and radians (D
    is the diagonal matrix of joint damping).  G holds springs too, Q what has no potential: dampers
    of springs, forces that turn, friction.
    JSON keys: q, qd, M, C, G, D and Q (where there are any), Psi, Psidot_qd, gap, KE, PE.

    \b
    Examples:
      robodyn terms robots/2r.yaml --q 30deg,45deg --qd 1,0.5
      robodyn terms robots/four-bar.yaml --q 60deg --qd 5 --format json | python -m json.tool
    """
    mechanism = load(model)
    q_, qd_ = single_state(mechanism, [Quantity("q", q, True), Quantity("qd", qd)])
    np.seterr(all="ignore")  # what leaves the range of floats is told below
    content: dict[str, np.ndarray] = {
        "q": q_,
        "qd": qd_,
        "M": closed_form.mass_matrix(mechanism, q_),
        "C": closed_form.coriolis_matrix(mechanism, q_, qd_),
        "G": closed_form.gravity_vector(mechanism, q_),
    }
    units = {"q": "rad", "qd": "rad/s", "M": "kg m²", "C": "kg m²/s", "G": "N m", "Q": "N m"}
    if any(mechanism.damping):
        content["D"] = np.diag(mechanism.damping)
        units["D"] = "N m s/rad"
    if mechanism.has_state_forces:
        content["Q"] = closed_form.other_forces(mechanism, q_, qd_)
    if mechanism.rows:
        content["Psi"] = closed_form.closure_jacobian(mechanism, q_)
        content["Psidot_qd"] = closed_form.closure_bias(mechanism, q_, qd_)
        content["gap"] = closed_form.closure_gap(mechanism, q_)
        units |= {"Psi": "m", "Psidot_qd": "m/s²", "gap": "m"}
    energies = {
        "KE": float(closed_form.kinetic_energy(mechanism, q_, qd_)),
        "PE": float(closed_form.potential_energy(mechanism, q_)),
    }
    values = [*content.values(), np.array(list(energies.values()))]
    if not all(np.isfinite(value).all() for value in values):
        raise overflow()

    def tables() -> list[Grid]:
        found = []
        for name, value in content.items():
            matrix = np.atleast_2d(value).tolist()
            title = f"{name.replace('_', ' ')} [{units[name]}]"
            found.append(Grid([str(k + 1) for k in range(len(matrix[0]))], matrix, title))
        return [*found, Grid(["KE [J]", "PE [J]"], [list(energies.values())])]

    plain = {name: value.tolist() for name, value in content.items()}
    write_structure(format, out, plain | energies, tables)
