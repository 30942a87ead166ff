"""Placement, joint forces and ground forces as formulas of a recorded state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.cam_contacts import ContactForce, cams_of, forces_on_links
from robodyn.dynamics.dynamics import pins_at
from robodyn.dynamics.reaction_forces import Acts, Felt, Part
from robodyn.engines import expression
from robodyn.engines.expression import Value
from robodyn.engines.formulas import Recorded
from robodyn.engines.planar_numbers import Planar
from robodyn.engines.row_values import RowValues
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import Placed


def planar_values(values: Sequence[Value]) -> NDArray[Any]:
    """Return real values as `Planar`s."""
    return np.array([Planar(x, 0.0) for x in values], object)


def placed_formulas(state: Recorded) -> Placed:
    """Return the placement of the mechanism at a recorded state, in formulas (n,)."""
    mechanism, x = state.mechanism, state.absolute("q")
    E = [
        Planar(1.0, 0.0) if d is None else Planar(expression.cos(x[d]), expression.sin(x[d]))
        for d in mechanism.frames
    ]
    X = [e * x[k] if k in mechanism.slides else e for k, e in enumerate(E)]
    return Placed(*(np.array(values, object) for values in (x, X, E)))


def felt_formulas(
    state: Recorded,
    at: Placed,
    bent: Placed,
    accelerations: tuple[Sequence[Value], Sequence[Value]],
    lam: Sequence[Value],
    Psi: Sequence[Sequence[Value]],
) -> Felt:
    """Return `Felt` for a recorded state with placement `at`, with X'' in `bent`.

    `accelerations` are xdd and qdd (n), `lam` (r) the multipliers; Psi (r, n) is in joints.
    """
    mechanism, graph = state.mechanism, state.graph

    def rows(part: Part) -> Acts:
        """Return what acts, from the rows of its program."""
        found = RowValues(part(mechanism), graph)
        forces, couples = found.acting, found.couples
        parts = found.nodes("forces") if forces else []
        each = [Planar(x, y) for x, y in zip(parts[::2], parts[1::2], strict=True)]
        moments = found.nodes("moments") if couples else []
        return Acts(list(zip(forces, each, strict=True)), list(zip(couples, moments, strict=True)))

    kept = [x * row.arm for x, row in zip(lam, mechanism.rows, strict=True) if row.arm]
    pins = pins_at(mechanism, planar_values(lam), at.E)
    xdd, qdd, moments = (np.array(values, object) for values in (*accelerations, kept))
    contacts = contact_formulas(mechanism, at, lam, Psi)
    return Felt(mechanism, at, bent, xdd, qdd, pins, moments, rows, contacts)


def contact_formulas(
    mechanism: Mechanism, at: Placed, lam: Sequence[Value], Psi: Sequence[Sequence[Value]]
) -> list[ContactForce]:
    """Return the forces of cams on their followers."""
    rows = mechanism.rows
    first = mechanism.first_coupling
    slopes, torques = [], []
    for cam in cams_of(mechanism):
        r = first + cam.coupling
        slopes.append(Psi[r][cam.driver] * (-1.0 / rows[r].arm))
        torques.append(lam[r] * rows[r].arm)
    return forces_on_links(mechanism, at, slopes, torques)
