"""Scenes with stops and dry friction, and the rates after an impact in many digits."""

from __future__ import annotations

from itertools import product

import mpmath
import numpy as np

from robodyn.dynamics import closed_form
from robodyn.loops import closures
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text


def scene(text: str) -> Mechanism:
    return build(from_text(text, "contacts"))


FOUR_BAR = """gravity: 9.81
links:
  - {{name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008, {crank}}}
  - {{name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102, {coupler}}}
  - {{name: rocker, m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0], {rocker}}}
closures: [[coupler, rocker]]
assembly: open
"""

SLIDER_CRANK = """gravity: 9.81
links:
  - {{name: crank, m: 0.6, l: 0.3, r: 0.15, I: 0.008, {crank}}}
  - {{name: rod, m: 1.3, l: 0.9, r: 0.45, I: 0.1}}
  - {{name: piston, joint: prismatic, axis: [1, 0], m: 0.8, l: 0, r: 0, I: 0,
     from: [0, 0], {piston}}}
closures: [[rod, piston]]
assembly: open
"""

FIVE_BAR = """gravity: 9.81
links:
  - {{name: a, m: 0.6, l: 0.5, r: 0.25, I: 0.02, {each}}}
  - {{name: b, m: 0.6, l: 0.8, r: 0.4, I: 0.03, {each}}}
  - {{name: c, m: 0.6, l: 0.5, r: 0.25, I: 0.02, from: [1, 0], {each}}}
  - {{name: d, m: 0.6, l: 0.8, r: 0.4, I: 0.03, from: c, {each}}}
closures: [[b, d]]
actuated: [a, c]
assembly: open
"""


def dry(moving: float, static: float, stribeck: float | None = None, name: str = "torque") -> str:
    more = "" if stribeck is None else f", stribeck: {stribeck}"
    return f"friction: {{{name}: {moving}, static: {static}{more}}}"


def kkt(mechanism: Mechanism, q: np.ndarray, qd: np.ndarray, joint: int, e: float) -> np.ndarray:
    """Rates after an impact at one joint, in 40 digits."""
    n, r = mechanism.n, len(mechanism.rows)
    M, Psi = (
        closed_form.mass_matrix(mechanism, q),
        closures.closure_jacobian(mechanism, q, t=0.0),
    )
    with mpmath.workdps(40):
        K = mpmath.zeros(n + r + 1)
        for i, k in product(range(n), range(n)):
            K[i, k] = mpmath.mpf(M[i, k])
        for i, k in product(range(r), range(n)):
            K[n + i, k] = K[k, n + i] = mpmath.mpf(Psi[i, k])
        K[n + r, joint] = K[joint, n + r] = 1
        right = mpmath.zeros(n + r + 1, 1)
        for i in range(n):
            right[i] = mpmath.fsum(mpmath.mpf(M[i, k]) * qd[k] for k in range(n))
        right[n + r] = -e * qd[joint]
        found = mpmath.lu_solve(K, right)
        return np.array([float(found[k]) for k in range(n)])
