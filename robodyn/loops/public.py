"""The functions on loops for Python callers, with t = 0 as default.

Inside the package every call states its time: a forgotten one would be wrong without notice.
"""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from robodyn.loops import assembly, closures, loop_rates
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array


def assemble(
    mechanism: Mechanism,
    q_actuated: ArrayLike,
    branches: Sequence[str] | None = None,
    t: ArrayLike = 0.0,
) -> Array:
    """Return all joint positions (..., n) from those of the actuated joints (..., actuated).

    Positions are in rad, or m for joints that slide.  Joints driven by laws of time take their
    values at t (...), s.  `branches` has "open" or "crossed" for each closure; None takes the
    scene's.  Raises InputError if a joint is neither actuated nor in a loop, SingularError if the
    loops close with a joint at any value, and AssemblyError if they cannot close; its message has
    the missing distance and the range in which the actuated joints can move.
    """
    return assembly.assemble(mechanism, q_actuated, branches, t=t)


def loop_velocities(
    mechanism: Mechanism, q: ArrayLike, qd_actuated: ArrayLike, t: ArrayLike = 0.0
) -> Array:
    """Return all joint rates (..., n) from those of the actuated joints (..., actuated).

    In rad/s or m/s. q (..., n) is a closed configuration at t (...), s.  Raises SingularError at a
    dead centre or change point.
    """
    return loop_rates.loop_velocities(mechanism, q, qd_actuated, t)


def loop_accelerations(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd_actuated: ArrayLike,
    t: ArrayLike = 0.0,
) -> Array:
    """Return all joint accelerations (..., n) from those of the actuated joints.

    In rad/s^2 or m/s^2. q and qd (..., n) are closed at t (...), s.  Raises SingularError at a dead
    centre or change point.  Next to a change point, the accelerations belong to the motion that
    leads across it.
    """
    return loop_rates.loop_accelerations(mechanism, q, qd, qdd_actuated, t)


def closure_gap(mechanism: Mechanism, q: ArrayLike, t: ArrayLike = 0.0) -> Array:
    """Return the closure gap at t (...), first side minus second, (..., r), m.

    A pin has two components (x, y), a slider one (normal to its line), and a coupling one: the lead
    of its joint (rad) times a length of the mechanism.
    """
    return closures.closure_gap(mechanism, q, t)


def closure_jacobian(mechanism: Mechanism, q: ArrayLike, t: ArrayLike = 0.0) -> Array:
    """Return Psi = d gap/dq at t (...), (..., r, n), in m/rad, or 1 for joints that slide."""
    return closures.closure_jacobian(mechanism, q, t)
