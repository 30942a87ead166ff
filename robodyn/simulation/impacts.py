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
from robodyn.dynamics.dynamics import motion_dynamics
from robodyn.dynamics.sticking import AT_REST, TOGETHER, forces_between, mode_at, resting
from robodyn.errors import SingularError
from robodyn.events.signs import ROUNDING
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode
from robodyn.tables.arrays import Array

SLACK = 1e-10  # part of the rates by which a condition may be missed
INSTANT = 8.0  # roundings of the time that are none
LOW = 4.0 * ROUNDING  # part of where its end is: so low a bounce rounding does not show
BLUR = 0.1  # part of its rate that a joint thrown back so little may lose or gain
ENDLESS = 1e-10  # of the time of a run: bounces that end within this part of it are over at once

End = tuple[int, int]  # a joint and a side


class Bounces:
    """The impacts of a run to t_end, whose steps may miss angles and rates by `small`.

    What would bounce for ever, or lower than is told from rest, is at rest at once.
    """

    def __init__(self, mechanism: Mechanism, t_end: float, small: float) -> None:
        self.mechanism, self.t_end, self.small = mechanism, t_end, small
        self.thrown: dict[int, float] = {}  # how fast a joint left its end last

    def after(
        self, q: Array, qd: Array, tau: Array, t: float, touches: set[End], over: set[End]
    ) -> tuple[Array, list[tuple[End, float]]]:
        """The rates (n) after an impact at the ends that are touched, and the restitution of each.

        At those that are `over` joints are at rest.  Torques are those before it.
        """
        ends, limits = sorted(touches), dict(self.mechanism.limits)
        own = [limits[joint].restitution or 0.0 for joint, _ in ends]
        p, jumps = impulses(self.mechanism, q, qd, ends, own)
        after = _settled(qd, jumps @ p)
        leaving = [-side * float(after[joint]) for joint, side in ends]
        tied = [
            [j for j in range(len(ends)) if j == k or (leaving[j] > 0.0 and _tied(jumps, [j], k))]
            for k in range(len(ends))
        ]
        qdd = np.zeros_like(qd)
        if max(leaving) > 0.0:
            on = [end for end in ends if not after[end[0]]]
            mode = mode_at(self.mechanism, q, after, tau, resting(self.mechanism, after), on, t=t)
            qdd = motion_dynamics(in_mode(self.mechanism, mode.mode), q, after, tau, t).qdd
        shows = []  # whether a bounce is told from rest: by any steps, and by those of the method
        for k, (joint, side) in enumerate(ends):
            back, leaves, e = side * float(qdd[joint]), leaving[k], max(own[j] for j in tied[k])
            brief = leaves < 0.5 * back * (1.0 - e) * ENDLESS * abs(self.t_end)
            low = leaves**2 < 2.0 * back * LOW * abs(q[joint])
            resolved = back <= 0.0 or self._resolves(joint, side * qd[joint], back)
            shows.append((not (brief or low), resolved) if leaves > 0.0 else (True, True))
            self.thrown[joint] = leaves
        kept: list[float | None] = list(own)
        for k, end in enumerate(ends):  # of ends that are tied to one another any may tell
            if end in over or not any(shows[j][0] for j in tied[k]):
                kept[k] = None
            elif not any(all(shows[j]) for j in tied[k]):
                kept[k] = 0.0
        changed = [k for k, part in enumerate(kept) if part != own[k]]
        if changed:
            least = None if any(kept[k] is None for k in changed) else 0.0
            kept = [least if _tied(jumps, changed, k) else part for k, part in enumerate(kept)]
            after = rates_after(self.mechanism, q, qd, ends, kept)
        return after, [(end, part or 0.0) for end, part in zip(ends, kept, strict=True)]

    def _resolves(self, joint: int, v: float, back: float) -> bool:
        """Whether a joint that meets its end with v was thrown back so far that steps show it.

        One that was not, and yet comes back faster than from so near, has moved off since.
        """
        last = self.thrown.get(joint, 0.0)
        fast = max(abs(v), last) ** 2 >= 2.0 * back * self.small
        return fast or abs(v - last) <= BLUR * last or not last


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
    return _settled(qd, jumps @ p)


def _settled(qd: Array, jump: Array) -> Array:
    """Return qd + jump (n), zero where rounding leaves no more."""
    after = qd + jump
    least = AT_REST * max(np.abs(qd).max(), np.abs(after).max())  # of which rounding leaves less
    return np.where(np.abs(after) <= least, 0.0, after)


def _tied(jumps: Array, ends: list[int], k: int) -> bool:
    """Whether the rate at which end k is left follows from those at `ends`, by jumps (n, ends)."""
    if k in ends:
        return True
    ranks = [np.linalg.matrix_rank(jumps[:, own], rtol=TOGETHER) for own in (ends, [*ends, k])]
    return bool(ranks[0] == ranks[1])


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
