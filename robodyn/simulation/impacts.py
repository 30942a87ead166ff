"""Impacts at hard stops: how the rates jump, by an impulse through M and the closures.

With K = [M Psi^T; Psi 0], v the rates at which touched stops are left (below zero: run into) and
R v's rows in qd, impulses p >= 0 make

    v+ = v + R K^-1 R^T p,      v+ + e v >= 0,      p . (v+ + e v) = 0,

e the restitution of each: of one stop p = -(1 + e) v / (R K^-1 R^T).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn.dynamics.dense_dynamics import responses
from robodyn.dynamics.sticking import AT_REST, forces_between
from robodyn.errors import SingularError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

SLACK = 1e-10  # part of the rates by which a condition may be missed


def rates_after(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    touches: Sequence[tuple[int, int]],
    restitutions: Sequence[float | None],
) -> Array:
    """qd (n) after an impact at q; `touches` are joints and the sides of their stops.

    Those whose restitution is None are at rest from then on: what they have left to bounce, others
    may have thrown them, is over at once, and the impulses of all that are one, p of any sign.

    Raises SingularError where no impulses throw all of them back.
    """
    p, jumps = impulses(mechanism, q, qd, touches, restitutions)
    after = qd + jumps @ p
    least = AT_REST * max(np.abs(qd).max(), np.abs(after).max())  # of which rounding leaves less
    return np.where(np.abs(after) <= least, 0.0, after)


def impulses(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    touches: Sequence[tuple[int, int]],
    restitutions: Sequence[float | None],
) -> tuple[Array, Array]:
    """Those of `rates_after`, p (k), and how each makes qd jump, (n, k)."""
    joints = [joint for joint, _ in touches]
    ways = -np.array([side for _, side in touches], float)  # in which stops are left
    jumps = (ways[:, None] * responses(mechanism, q, joints)).T  # of qd (n, k) by each impulse
    W, v = ways[:, None] * jumps[joints], ways * qd[joints]
    bounced = v + np.array([e or 0.0 for e in restitutions]) * v
    least = np.array([-np.inf if e is None else 0.0 for e in restitutions])
    p = forces_between(bounced, W, least, np.full(len(v), np.inf))
    if (W @ p + bounced >= -SLACK * np.abs(v).max(initial=0.0)).all():
        return p, jumps
    names = ", ".join(mechanism.link_names[joint] for joint in joints)
    limit = "no impulses throw all of them back"
    raise SingularError(f"impact of {names}", where=mechanism.source, limit=limit)
