"""What Python callers know loops by: as the functions inside, but t is 0 if it is left out.

Inside every call tells its time: one that is forgotten would be wrong in silence.
"""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from robodyn.dynamics import closed_form
from robodyn.loops import assembly, loop_rates
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array


def assemble(
    mechanism: Mechanism,
    q_actuated: ArrayLike,
    branches: Sequence[str] | None = None,
    t: ArrayLike = 0.0,
) -> Array:
    """All joint angles (..., n) from those of the actuated joints (..., actuated), radians.

    Joints that laws of the time give are where these have them at t (...), s.
    `branches` has "open" or "crossed" for each closure; None takes the scene's.  Raises InputError
    where a joint is neither actuated nor in a loop, SingularError where the loops close with joints
    at any value, and AssemblyError where the loops cannot close: it tells the distance missing and
    the range of the actuated joints that can be reached.
    """
    return assembly.assemble(mechanism, q_actuated, branches, t=t)


def loop_velocities(
    mechanism: Mechanism, q: ArrayLike, qd_actuated: ArrayLike, t: ArrayLike = 0.0
) -> Array:
    """All joint rates (..., n) from those of the actuated joints (..., actuated), rad/s.

    q (..., n) is a closed configuration at t (...), s.  Raises SingularError at a dead centre or
    change point.
    """
    return loop_rates.loop_velocities(mechanism, q, qd_actuated, t)


def loop_accelerations(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd_actuated: ArrayLike,
    t: ArrayLike = 0.0,
) -> Array:
    """All joint accelerations (..., n) from the actuated joints', rad/s^2.

    q and qd (..., n) are closed at t (...), s.  Raises SingularError at a dead centre or change
    point; next to a change point they are those of the motion which leads across.
    """
    return loop_rates.loop_accelerations(mechanism, q, qd, qdd_actuated, t)


def closure_gap(mechanism: Mechanism, q: ArrayLike, t: ArrayLike = 0.0) -> Array:
    """How far the closures are from closing at t (...), first side minus second, (..., r), m.

    Two components (x, y) for a pin, one (normal to the line) for a slider, and one for a coupling:
    what its joint is ahead, rad, times a length of the mechanism.
    """
    return closed_form.closure_gap(mechanism, q, t)


def closure_jacobian(mechanism: Mechanism, q: ArrayLike, t: ArrayLike = 0.0) -> Array:
    """Psi = d gap/dq at t (...), (..., r, n), m/rad, or 1 for joints that slide."""
    return closed_form.closure_jacobian(mechanism, q, t)
