"""Loads of a scene over the time of a run: where an integrator must step onto, and how far.

Rows of a table over t are kinks, as those of a table of torques are; expressions in t are looked at
as those of torques (`torque_times.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from robodyn.errors import InputError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.torque_times import over_a_run
from robodyn.scene.expressions import SCOPE
from robodyn.scene.scene import Law, Table, signal_place


def over_a_scene_run(
    mechanism: Mechanism,
    actuation: Actuation,
    state: Sequence[float],
    t_end: float,
    small: float = 0.0,
) -> Actuation:
    """`over_a_run` of the torques, and of loads that depend on the time.

    Raises InputError where the rows of a table do not cover the run.
    """
    if actuation.lines:
        actuation = over_a_run(actuation, state, t_end, small)
    if not mechanism.timed or not t_end:
        return actuation
    first, last = min(0.0, t_end), max(0.0, t_end)
    times: set[float] = set()
    lines: list[str] = []
    for signal in mechanism.signals:
        if isinstance(signal, Law) and "t" in signal.names:
            lines.append(f"tau{len(lines)} = {signal.code}")
        elif isinstance(signal, Table) and signal.over == "t":
            if signal.x[0] > first or signal.x[-1] < last:
                span = f"{signal.x[0]:g} to {signal.x[-1]:g} s"
                limit = f"the rows of {signal.file} must cover the simulation, {first:g} to "
                place = signal_place(mechanism.description, signal)
                raise InputError(
                    place, where=mechanism.source, value=span, limit=f"{limit}{last:g} s"
                )
            times.update(t for t in signal.x if first < t < last)
    found = over_a_run(Actuation(None, tuple(lines), dict(SCOPE)), state, t_end, small)
    leaves = {*actuation.leaves, *found.leaves}
    if actuation.control is not None:  # it takes kinks for samples
        leaves.update({abs(t) for t in times} | {0.0, abs(t_end)} if times else set())
    else:
        times.update(found.kinks)
    kinks = actuation.kinks
    if actuation.control is None and not times <= set(kinks):
        kinks = tuple(sorted({*kinks, *times}))
    enough = actuation.told_by_leaves and found.told_by_leaves
    return replace(actuation, kinks=kinks, leaves=tuple(sorted(leaves)), told_by_leaves=enough)
