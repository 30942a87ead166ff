"""How the torques of a law, and the rates of its integrals, change with the state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn.control.controlled_run import Law, Slopes
from robodyn.control.state_feedback import StateFeedback
from robodyn.mechanics.array_types import Array
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.parts import untimed


def law_slopes(
    mechanism: Mechanism,
    model: Mechanism,
    control: str,
    gains: Mapping[str, Sequence[float]],
    limits: Sequence[float],
    gain: StateFeedback | None,
    law: Law,
) -> Slopes | None:
    """The slopes of a law of `laws.py`; None where they are not known.

    That is computed torque, and the torques at rest of an open chain with passive joints.
    """
    n, driven = mechanism.n, list(mechanism.actuated)
    joints, states = len(driven), len(driven) if "ki" in gains else 0
    balanced = control == "pd+g"
    if control == "computed-torque" or (balanced and mechanism.passive and not mechanism.rows):
        return None
    if balanced:
        model = untimed(model)
    own = np.zeros((joints, 2 * n + states))
    rows = np.arange(joints)
    if gain is not None:
        wide, K = len(gain.coordinates), np.array(gain.gain).reshape(joints, -1)
        for i, k in enumerate(gain.coordinates):
            own[:, k], own[:, n + k] = -K[:, i], -K[:, wide + i]
    else:
        own[rows, driven], own[rows, np.add(n, driven)] = (
            -np.array(gains[x]) for x in ("kp", "kd")
        )
    if states:
        own[rows, 2 * n + rows] = gains["ki"]

    def slopes(t: float, y: Sequence[float]) -> Array:
        from robodyn.dynamics.derivatives import inverse_dynamics_derivatives

        found = own.copy()
        if balanced:
            still = np.zeros(n)
            found[:, :n] += inverse_dynamics_derivatives(model, y[:n], still, still).by_q[driven]
        cut = np.abs(law(t, *y)[:joints]) >= limits
        given = np.where(cut[:, None], 0.0, found)
        rates = np.zeros((states, found.shape[1]))
        for j in range(states):
            if gains["ki"][j]:
                rates[j, driven[j]] = -1.0
                if cut[j]:
                    rates[j] -= found[j] / gains["kp"][j]
        return np.concatenate([given, rates])

    return slopes
