"""`robodyn reactions`: the force in every pin, and what the ground feels."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from robodyn.cli.options import Force, Model, Qdd, Text, load_with, option
from robodyn.cli.states import Quantity, TableOptions, evaluate, overflow
from robodyn.cli.turns import tell_shaking_orders
from robodyn.dynamics import dynamics, reaction_forces
from robodyn.dynamics.state_columns import reaction_columns, reaction_values
from robodyn.errors import InputError, ResidualError
from robodyn.loops.loop_rates import check_way_on
from robodyn.mechanics.mechanism import Mechanism

_TAU = "Joint torques, N m, in place of --qdd: all joints, or the actuated ones."
_HARMONICS = "In place of the rows, a turn: orders of the shaking force and moment, 0 to N or 10."
AGREE = 1e-6  # part of the accelerations by which those given may miss those of the torques given


def reactions(
    model: Model,
    given: TableOptions = TableOptions(),
    qdd: Qdd = None,
    tau: Text = option(_TAU, "VECTOR"),
    force: Force = None,
    harmonics: int | None = option(_HARMONICS, "[N]"),
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

    --harmonics takes one turn of the one actuated joint, rows at equal steps of its angle theta,
    the last a step before the first or as it, and tells for each order k amplitude and phase (rad):
    shake_fx is the sum of shake_fx_amp cos(k theta + shake_fx_phase) over all orders.

    Where closures depend on one another, or at a change point, a note names the forces that are
    not unique.  shake_* always are.

    \b
    Examples:
      robodyn reactions 2r --q 30deg,45deg --qd 1,0.5
      robodyn reactions four-bar --q 60deg --qd 5 --tau 1.5
      robodyn reactions 2r states.csv --format json
      robodyn reactions 2r states.csv --extremes
      robodyn trajectory slider-crank --speed 300rpm --turns 1 --points 361 | \\
        robodyn reactions slider-crank - --harmonics
    """
    if qdd is not None and tau is not None:
        limit = "give one of them: the accelerations cause the torques, or the torques those"
        raise InputError("--qdd and --tau are both given", limit=limit)
    mechanism = load_with(model, force)
    columns = reaction_columns(mechanism)
    compute = _Reactions(mechanism)
    quantities = given.quantities()
    either = [Quantity("qdd", qdd), Quantity("tau", tau)]
    if harmonics is None:
        evaluate(mechanism, given, quantities, columns, compute, either)
        return
    tell_shaking_orders(mechanism, given, quantities, either, compute, harmonics)


@dataclass
class _Reactions:
    """The columns (T, columns) at states (T, n), with the accelerations or the torques there."""

    mechanism: Mechanism
    named: bool = False  # whether it was told which forces are not unique

    def __call__(self, q: np.ndarray, qd: np.ndarray, **given: np.ndarray) -> np.ndarray:
        mechanism, t = self.mechanism, given.pop("t", 0.0)
        with warnings.catch_warnings(record=True) as told:
            if "tau" in given:
                check_way_on(mechanism, q, qd)
                solution = dynamics.forward_dynamics_and_forces(mechanism, q, qd, given["tau"], t)
                qdd, multipliers = solution.qdd, solution.multipliers
            else:
                qdd = given["qdd"]
                try:
                    inverse = dynamics.inverse_dynamics_and_forces(mechanism, q, qd, qdd, t)
                except ResidualError as error:
                    error.limit += f", or give --tau {','.join(['0'] * mechanism.n)}"
                    raise
                multipliers = inverse.multipliers
        if not np.isfinite(qdd).all():
            raise overflow()
        for warning in told:
            warnings.warn(warning.message, stacklevel=2)
        if told and mechanism.rows and not self.named:
            dependent = reaction_forces.dependent_rows(mechanism, q)
            self.named = bool(dependent.any())
            if self.named:
                _name(mechanism, q[np.argmax(dependent > 0)])
        if len(given) == 2:
            _check_agreement(qd, given["qdd"], qdd)
        return reaction_values(mechanism, q, qd, qdd, multipliers, t)


def _name(mechanism: Mechanism, q: np.ndarray) -> None:
    """Warn which forces are not unique at q (n,)."""
    closures, links = reaction_forces.not_unique(mechanism, q)
    names = [f"fx{c + 1},fy{c + 1}" for c in closures]
    names += [f"tc{c + 1}" for c in reaction_forces.dependent_couplings(mechanism, q)]
    names += [f"rx{k + 1},ry{k + 1} ({mechanism.link_names[k]})" for k in links]
    text = f"not unique: {'; '.join(names)}"
    warnings.warn(text, dynamics.RobodynWarning, stacklevel=3)


def _check_agreement(qd: np.ndarray, given: np.ndarray, caused: np.ndarray) -> None:
    """Raise InputError where the accelerations given are not those that the torques cause."""
    size = 1.0 + np.abs(caused).max(axis=-1) + np.abs(qd).max(axis=-1) ** 2
    wrong = np.argwhere(np.abs(given - caused) > AGREE * size[:, None])
    if len(wrong):
        row, k = map(int, wrong[0])
        caused_too = f"{caused[row, k]:.9g}; give one of qdd and tau"
        limit = f"the torques that are given too make it {caused_too}"
        raise InputError(f"qdd{k + 1}", value=f"{given[row, k]:.9g}", limit=limit)
