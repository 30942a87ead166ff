"""`robodyn reactions`: the force in every pin, and what the ground feels."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Annotated, Optional

import numpy as np
import typer

from robodyn.cli.options import Model, Out, OutputFormat, Q, Qd, Qdd, States
from robodyn.cli.states import Quantity, evaluate, loop_columns, overflow
from robodyn.dynamics.dynamics import (
    RobodynWarning,
    forward_dynamics_and_forces,
    inverse_dynamics_and_forces,
    loop_forces,
)
from robodyn.dynamics.reaction_forces import (
    dependent_couplings,
    dependent_rows,
    not_unique,
    shaking_force,
)
from robodyn.dynamics.reaction_forces import reactions as joint_forces
from robodyn.errors import InputError
from robodyn.loops.loop_rates import check_way_on
from robodyn.mechanics.mechanism import Mechanism, load

Tau = Annotated[
    Optional[str],  # noqa: UP045 (typer reads the annotation at run time)
    typer.Option(
        "--tau",
        metavar="VECTOR",
        help="Joint torques, N m, in place of --qdd: all joints, or the actuated ones.",
        show_default=False,
    ),
]
AGREE = 1e-6  # part of the accelerations by which those given may miss those of the torques given


def reactions(
    model: Model,
    states: States = None,
    q: Q = None,
    qd: Qd = None,
    qdd: Qdd = None,
    tau: Tau = None,
    format: OutputFormat = None,
    out: Out = None,
) -> None:
    """The force in every pin, and the shaking force and moment on the ground.

    Columns, forces in N along the ground's axes: for each link k the force rx1,ry1 on it at its
    own joint, from the link (or the ground) that it hangs from; for each closure the pin force
    fx1,fy1 on the side that the scene names first; shake_fx,shake_fy the total force of the
    mechanism on the ground, by joints, closures and sliders there; shake_m (N m) its moment about
    the origin.  Torques and damping of ground joints act on the ground too, with the opposite
    sign: they are in shake_m.  Those between links are internal.

    With --qdd (or columns qdd1..; default zero) the torques follow, as in `torque`; with --tau (or
    columns tau1..) the accelerations follow, as in `accel`.  A table may hold both, as `simulate`
    writes them, if they belong together.  Rows of STATES pass through with the columns added.

    Where closures depend on one another, or at a change point, a note names the forces that are
    not unique.  shake_* always are.

    \b
    Examples:
      robodyn reactions robots/2r.yaml --q 30deg,45deg --qd 1,0.5
      robodyn reactions robots/four-bar.yaml --q 60deg --qd 5 --tau 1.5
      robodyn reactions robots/2r.yaml states.csv --format json
    """
    if qdd is not None and tau is not None:
        limit = "give one of them: the accelerations cause the torques, or the torques those"
        raise InputError("--qdd and --tau are both given", limit=limit)
    mechanism = load(model)
    columns = [f"r{axis}{k + 1}" for k in range(mechanism.n) for axis in "xy"]
    columns += [*loop_columns(mechanism), "shake_fx", "shake_fy", "shake_m"]
    motion = _Motion(mechanism)
    offered = [Quantity("qdd", qdd), Quantity("tau", tau)]

    def quantities(header: Sequence[str]) -> list[Quantity]:
        given = [x for x in offered if x.option is not None or _has(mechanism, x, header)]
        motion.given = [x.name for x in given] or ["qdd"]
        return [Quantity("q", q, True), Quantity("qd", qd), *(given or offered[:1])]

    def compute(state: list[np.ndarray]) -> np.ndarray:
        accelerations, multipliers = motion.solve(state)
        moving = state[0], state[1], accelerations
        joints = joint_forces(mechanism, *moving, multipliers)
        loops = loop_forces(mechanism, multipliers)
        shake = shaking_force(mechanism, *moving)
        return np.concatenate([joints.reshape(len(shake), -1), loops, shake], axis=-1)

    evaluate(mechanism, states, quantities, columns, compute, format, out)


def _has(mechanism: Mechanism, quantity: Quantity, header: Sequence[str]) -> bool:
    return any(name in header for name in quantity.columns(range(mechanism.n)))


class _Motion:
    """Completes states to motions and multipliers, and tells once what is not unique."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.given: list[str] = []  # qdd, tau or both
        self._mechanism = mechanism
        self._named = False

    def solve(self, state: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """qdd (T, n) and multipliers (T, r) of states [q, qd, *given], each (T, n).

        Raises InputError where qdd and tau are given and do not belong together, SingularError
        where the motion is not unique.
        """
        mechanism, (q, qd, *given) = self._mechanism, state
        with warnings.catch_warnings(record=True) as told:
            if self.given == ["qdd"]:
                qdd = given[0]
                multipliers = inverse_dynamics_and_forces(mechanism, q, qd, qdd).multipliers
            else:
                check_way_on(mechanism, q, qd)
                qdd, multipliers, _ = forward_dynamics_and_forces(mechanism, q, qd, given[-1])
        if not np.isfinite(qdd).all():
            raise overflow()
        dependent = dependent_rows(mechanism, q) if told and mechanism.rows else np.zeros(len(q))
        for warning in told:
            warnings.warn(warning.message, stacklevel=2)
        if dependent.any() and not self._named:
            self._name(q[np.argmax(dependent > 0)])
        if len(given) == 2:
            _check_agreement(qd, given[0], qdd)
        return qdd, multipliers

    def _name(self, q: np.ndarray) -> None:
        """Warn which forces are not unique at q (n,)."""
        self._named = True
        closures, links = not_unique(self._mechanism, q)
        names = [f"fx{c + 1},fy{c + 1}" for c in closures]
        names += [f"tc{c + 1}" for c in dependent_couplings(self._mechanism, q)]
        names += [f"rx{k + 1},ry{k + 1} ({self._mechanism.link_names[k]})" for k in links]
        warnings.warn(f"not unique: {'; '.join(names)}", RobodynWarning, stacklevel=3)


def _check_agreement(qd: np.ndarray, given: np.ndarray, caused: np.ndarray) -> None:
    """Raise InputError where the accelerations given are not those that the torques cause."""
    size = 1.0 + np.abs(caused).max(axis=-1) + np.abs(qd).max(axis=-1) ** 2
    wrong = np.argwhere(np.abs(given - caused) > AGREE * size[:, None])
    if len(wrong):
        row, k = map(int, wrong[0])
        raise InputError(
            f"qdd{k + 1}",
            value=f"{given[row, k]:.9g}",
            limit=f"the torques that are given too make it {caused[row, k]:.9g}; "
            "give one of qdd and tau",
        )
