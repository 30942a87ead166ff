"""Joint torques as rows of the program: constants, tables, and smooth expressions.

Functions without a series (comparisons, abs, min, ... of the state, and Python functions) are
refused.  Those of time alone are constant between the times at which they switch.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence

from robodyn.elements.program import Given, Slot
from robodyn.errors import InputError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.equations_of_motion import EquationsOfMotion


def torque_slots(
    equations: EquationsOfMotion, actuation: Actuation, held: Sequence[float] | None = None
) -> list[Slot | None]:
    """Return the slots of the joint torques (n), None for no torque.

    Constants and torques linear between kinks are `Given` as tau0, tau1, ... `held` has the values
    of switches; None checks every branch.  Raises InputError for a torque without a series.
    """
    n, add = equations.mechanism.n, equations.program.add
    if actuation.constants is not None:
        return [add(Given(f"tau{j}")) if x else None for j, x in enumerate(actuation.constants)]
    if actuation.linear:
        driven = set(equations.mechanism.actuated)
        return [add(Given(f"tau{j}")) if j in driven else None for j in range(n)]
    if actuation.control is not None:
        more = ", or --control-rate, whose torques are held from sample to sample"
        raise _refused("a controller that acts continuously", more)
    from robodyn.mechanics.expression_rows import ExpressionRows, Slotted

    reader = ExpressionRows(equations.program, equations.variable, _refused, held)
    if not actuation.torques:
        raise _refused("a function of Python")
    slots: list[Slot | None] = []
    for node in actuation.torques:
        torque = reader.read(node)
        acts = isinstance(torque, Slotted) or torque
        slots.append(reader.slot(torque) if acts else None)
    return slots


def linear_piece(
    actuation: Actuation,
    torques: Callable[[float, Sequence[float]], Sequence[float]],
    t: float,
    y: Sequence[float],
    direction: float,
) -> tuple[list[float], list[float]]:
    """Return torques at t that are linear between kinks, and their slopes to the next kink."""
    kinks = actuation.kinks
    if direction > 0.0:
        end = kinks[min(bisect_right(kinks, t), len(kinks) - 1)]
    else:
        end = kinks[max(bisect_left(kinks, t) - 1, 0)]
    third = (end - t) / 3.0 or 1.0
    first, second = (torques(t + k * third, y) for k in (1, 2))
    slopes = [(b - a) / third for a, b in zip(first, second, strict=True)]
    return [a - s * third for a, s in zip(first, slopes, strict=True)], slopes


def _refused(what: str, more: str = "") -> InputError:
    limit = "the Taylor series expands arithmetic and smooth functions: take --method DOP853"
    return InputError(f"torque: {what} has no series", limit=limit + more)
