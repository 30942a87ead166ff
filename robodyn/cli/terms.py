"""`robodyn terms`: the terms of the equation of motion at one state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn.cli.options import (
    AtTime,
    Model,
    Out,
    OutputStructured,
    Qdd,
    Tau,
    option,
    refuse,
    switch,
    time_from,
)
from robodyn.cli.output import Grid, in_told_units, note, write_structure
from robodyn.cli.states import StateOptions, remarks, single_state
from robodyn.dynamics import closed_form
from robodyn.dynamics.columns import DEGREES, SLIDING, scene_units
from robodyn.dynamics.derivatives import forward_dynamics_derivatives, inverse_dynamics_derivatives
from robodyn.dynamics.state import State
from robodyn.elements.contacts import COMPLIANT, HARD, STICKS
from robodyn.errors import InputError, RobodynError, overflow
from robodyn.loops import closures
from robodyn.loops.loop_rates import check_way_on
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.csv_fields import IN_DEGREES

OF_JOINTS = ("q", "qd", "G", "D", "Q", "Psi")  # a column a joint, with its unit
_BY = "By numbers of the scene too, links.forearm.m,gravity; repeatable."
MIXED = {"M": ("kg m", "kg"), "C": ("kg m/s", "kg/s")}  # where one joint slides, and where both do


def terms(
    model: Model,
    state: StateOptions = StateOptions(),
    derivatives: bool = switch("Those of torques and accelerations too."),
    by: list[str] | None = option(_BY, "NUMBER"),
    qdd: Qdd = None,
    tau: Tau = None,
    at_time: AtTime = None,
    format: OutputStructured = None,
    out: Out = None,
) -> None:
    """M, C, G, the closures' Psi, and the energies at a state.

    They are terms of M qdd + C qd + D qd + G = tau + Q + Psi^T lambda, in SI units and radians (D
    is the diagonal matrix of joint damping).  G holds springs too, Q what has no potential: dampers
    of springs, forces that turn, friction in motion; and pushes of compliant stops.
    --derivatives adds those of the torques that the motion with --qdd needs, dtau_dq, dtau_dqd and
    dtau_dqdd, and those of the accelerations that --tau causes, dqdd_dq, dqdd_dqd and dqdd_dtau:
    row i is of joint i, column j by that of joint j.  --by links.forearm.m,gravity adds
    dtau_dnumbers and dqdd_dnumbers, by numbers of the scene with q and qd held.  All are exact, not
    differences.

    JSON keys: q, qd, M, C, G, D and Q (where there are any), Psi, Psidot_qd, gap, KE, PE.

    \b
    Examples:
      robodyn terms 2r --q 30deg,45deg --qd 1,0.5
      robodyn terms four-bar --q 60deg --qd 5 --format json | python -m json.tool
      robodyn terms 2r --q 30deg,45deg --qd 1,0.5 --tau 3,1 --derivatives
    """
    mechanism = model.load()
    if not derivatives:
        refuse("is for --derivatives: give that too", by=by, qdd=qdd, tau=tau)
    t = time_from(at_time)
    more = {"qdd": qdd, "tau": tau} if derivatives else {}
    q_, qd_, *acting = single_state(mechanism, state.quantities(**more), t=t)
    at = State(mechanism, q_, qd_, t=t)
    if mechanism.rubbing:
        note("Note: Q is without the friction by forces in pins and slides: it depends on qdd")
    resting = [k for k in mechanism.sticks if not qd_[k]]
    if resting:
        dry = ", ".join(mechanism.link_names[k] for k in resting)
        note(
            f"Note: Q is without the dry friction of {dry}: at rest it holds any load up to static"
        )
    if HARD in mechanism.contacts:
        note("Note: Q is without what hard stops hold")
    np.seterr(all="ignore")  # what leaves the range of floats is told below
    content: dict[str, tuple[str, np.ndarray]] = {  # the unit and the value
        "q": ("rad", q_),
        "qd": ("rad/s", qd_),
    }
    moves = not (mechanism.massless and mechanism.rows)  # else closures alone have terms
    if moves:
        content["M"] = "kg m²", closed_form.mass_matrix(mechanism, q_)
        content["C"] = "kg m²/s", closed_form.coriolis_matrix(mechanism, q_, qd_)
        content["G"] = "N m", closed_form.gravity_vector(mechanism, q_)
    if any(mechanism.damping) and moves:
        content["D"] = "N m s/rad", np.diag(mechanism.damping)
    if moves and (mechanism.has_state_forces or mechanism.contacts & {STICKS, COMPLIANT}):
        content["Q"] = "N m", closed_form.other_forces(mechanism, q_, qd_, t)
    if mechanism.rows:
        content["Psi"] = "m", closures.closure_jacobian(mechanism, q_, t)
        content["Psidot_qd"] = "m/s²", closures.closure_bias(mechanism, q_, qd_, t)
        content["gap"] = "m", closures.closure_gap(mechanism, q_, t)
    if derivatives:
        with remarks():
            names = [name.strip() for each in by or () for name in each.split(",")]
            content |= _derivatives(mechanism, (q_, qd_), acting, t, names)
    names = ["KE", "PE"] if moves else []
    energies = dict(zip(names, at.columns(names).tolist(), strict=True))
    values = [*(value for _, value in content.values()), np.array(list(energies.values()))]
    if not all(np.isfinite(value).all() for value in values):
        raise overflow()

    def tables() -> list[Grid]:
        found = [_table(mechanism, name, *item) for name, item in content.items()]
        both = [Grid(["KE [J]", "PE [J]"], [list(energies.values())])] if energies else []
        return [*found, *both]

    plain = {name: value.tolist() for name, (_, value) in content.items()}
    write_structure(format, out, in_told_units(plain | energies, scene_units(mechanism)), tables)


def _derivatives(
    mechanism: Mechanism,
    state: tuple[np.ndarray, np.ndarray],
    acting: Sequence[np.ndarray],
    t: float,
    numbers: list[str],
) -> dict[str, tuple[str, np.ndarray]]:
    """The derivatives of torques by qdd, and of accelerations by tau, which are `acting`."""
    content: dict[str, tuple[str, np.ndarray]] = {}
    qdd, tau = acting
    torques = ("N m/rad", "N m s/rad", "kg m²", "SI units")
    rates = ("1/s²", "1/s", "1/(kg m²)", "SI units")
    for what, third, units in (("tau", "qdd", torques), ("qdd", "tau", rates)):
        found: tuple[np.ndarray, ...]
        try:
            if what == "tau":
                found = inverse_dynamics_derivatives(mechanism, *state, qdd, t, numbers)
            else:
                check_way_on(mechanism, *(x[None] for x in state))
                found = forward_dynamics_derivatives(mechanism, *state, tau, t, numbers)
        except InputError:
            raise
        except RobodynError as error:
            of = "torques" if what == "tau" else "accelerations"
            note(f"Note: no derivatives of {of}: {error}")
            continue
        for by, unit, value in zip(("q", "qd", third, "numbers"), units, found[1:], strict=True):
            if value.size:
                content[f"d{what}_d{by}"] = unit, value
    return content


def _table(mechanism: Mechanism, name: str, unit: str, value: np.ndarray) -> Grid:
    """A term with its unit, or with those of each joint where some slide."""
    other = {**SLIDING, "m": "1"}.get(unit) if name in OF_JOINTS else None
    title, units = name.replace("_", " "), scene_units(mechanism)
    ((name, rows),) = in_told_units({name: value.tolist()}, units).items()
    unit = DEGREES[unit] if name.endswith(IN_DEGREES) else unit
    matrix = np.atleast_2d(rows).tolist()
    columns = [str(k + 1) for k in range(len(matrix[0]))]
    if mechanism.slides and other is not None:
        own = [other if k in mechanism.slides else unit for k in range(mechanism.n)]
        columns = [f"{column} [{x}]" for column, x in zip(columns, own, strict=True)]
        return Grid(columns, matrix, title)
    if mechanism.slides and name in MIXED:
        one, both = MIXED[name]
        unit += f"; {one} and {both} where one or both joints slide"
    if mechanism.slides and " d" in title:
        unit = "SI units"
    return Grid(columns, matrix, f"{title} [{unit}]")
