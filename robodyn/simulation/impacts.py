"""Impacts at hard stops: how the rates jump, by an impulse through M and the closures.

With K = [M Psi^T; Psi 0], v the rates at which touched stops are left (below zero: run into) and
R v's rows in qd, impulses p >= 0 make

    v+ = v + R K^-1 R^T p,      v+ + e v >= 0,      p . (v+ + e v) = 0,

e the restitution of each: of one stop p = -(1 + e) v / (R K^-1 R^T).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.closed_form import closure_jacobian, mass_matrix
from robodyn.errors import SingularError
from robodyn.mechanics.mechanism import Mechanism

Array = NDArray[np.float64]

SLACK = 1e-10  # part of the rates by which a condition may be missed
SINGULAR = 1e-12  # relative singular value of K below which it is none


def rates_after(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    touches: Sequence[tuple[int, int]],
    restitutions: Sequence[float],
) -> Array:
    """qd (n) after an impact at q; `touches` are joints and the sides of their stops.

    Raises SingularError where no impulses throw all of them back.
    """
    n, r, count = mechanism.n, len(mechanism.rows), len(touches)
    K = np.zeros((n + r, n + r))
    K[:n, :n] = mass_matrix(mechanism, q)
    Psi = closure_jacobian(mechanism, q)
    K[:n, n:], K[n:, :n] = Psi.T, Psi
    R = np.zeros((count, n + r))
    for row, (joint, side) in zip(R, touches, strict=True):
        row[joint] = -side
    jumps = np.linalg.lstsq(K, R.T, rcond=SINGULAR)[0][:n]  # of qd by each impulse
    W, v = R[:, :n] @ jumps, R[:, :n] @ qd
    bounced = v + np.array(restitutions) * v
    least = -SLACK * float(np.abs(v).max(initial=0.0))
    for size in range(count + 1):
        for chosen in combinations(range(count), size):
            p = np.zeros(count)
            own = list(chosen)
            p[own] = np.linalg.lstsq(W[np.ix_(own, own)], -bounced[own], rcond=SINGULAR)[0]
            if (p >= 0.0).all() and (W @ p + bounced >= least).all():
                return np.asarray(qd + jumps @ p)
    joints = ", ".join(mechanism.link_names[joint] for joint, _ in touches)
    limit = "no impulses throw all of them back"
    raise SingularError(f"impact of {joints}", where=mechanism.source, limit=limit)
