"""Forces as arrows: gravity on every mass, and the force in every pin, all to one scale."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.closed_form import phases
from robodyn.drawing import at, planar
from robodyn.dynamics import pin_forces
from robodyn.mechanism import Mechanism
from robodyn.reaction_forces import reactions

Array = NDArray[np.float64]

LONGEST = 0.3  # the longest arrow, as a part of the mechanism's span
SEEN = 1e-9  # forces below this part of the largest are none


class Force(NamedTuple):
    """A force on a link: where it acts, m, and what it is, N, as complex numbers."""

    kind: str  # gravity or pin
    name: str
    place: complex
    force: complex


def forces(
    mechanism: Mechanism, q: Array, qd: Array, qdd: Array, multipliers: Array
) -> list[Force]:
    """The weights, and the force in every pin, of one motion, each (n,).

    r1 is the force on link 1 at its own joint, f1 that on the side of closure 1 named first.
    Forces that are zero but for rounding are left out.
    """
    E = phases(mechanism, q)
    found = []
    for k, link in enumerate(mechanism.description.links):
        for mass, point, name in (
            (link.m, mechanism.centres[k], f"m{k + 1} g"),
            (link.payload, mechanism.tips[k], f"payload {k + 1} g"),
        ):
            found.append(Force("gravity", name, complex(at(point, E)), mass * mechanism.gamma))
    joints = reactions(mechanism, q, qd, qdd, multipliers) @ np.array([1, 1j])
    for k, force in enumerate(joints.tolist()):
        found.append(Force("pin", f"r{k + 1}", complex(at(mechanism.pivots[k], E)), force))
    pins = pin_forces(mechanism, multipliers) @ np.array([1, 1j])
    for c, force in enumerate(pins.tolist()):
        pin = planar(mechanism, mechanism.description.closures[c].first)
        found.append(Force("pin", f"f{c + 1}", complex(at(pin, E)), force))
    least = SEEN * max(abs(item.force) for item in found)
    return [item for item in found if abs(item.force) > least]


def metres_a_newton(found: list[Force], span: float) -> float:
    """The scale of arrows: the largest force is LONGEST of the span."""
    return LONGEST * span / max((abs(item.force) for item in found), default=1.0)
