"""The summary of a run on stderr."""

from __future__ import annotations

from robodyn.cli.output import note
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.column_units import scene_units, unit_of
from robodyn.simulation.report import Report
from robodyn.simulation.simulation import UNTIL

AT_REST = 1e-13  # part of the energy at the start below which nothing moves


def tell_run(mechanism: Mechanism, facts: Report, until: str | None) -> None:
    """The summary on stderr."""
    moving = facts.energy_in_motion
    drift = f"{facts.energy_drift:.2g} of the {moving:.4g} J in motion"
    if moving <= AT_REST * max(abs(facts.energy_start), moving):
        drift = f"{facts.energy_drift * moving:.2g} J, at rest"
    drift = f"energy {'balance' if facts.work else 'drift'}: {drift}"
    lines = [
        f"{facts.outcome}: t = {facts.t_reached:.6g} s, {facts.method} (rtol {facts.rtol:g}, "
        f"atol {facts.atol:g}), {facts.steps} steps, {facts.evaluations} evaluations, "
        f"{facts.seconds:.3g} s",
        drift + (f"; work done {facts.work:.6g} J" if facts.work else ""),
    ]
    if mechanism.rows:
        lines.append(
            f"largest gap: {facts.largest_gap:.2g} m, {facts.largest_gap_rate:.2g} m/s "
            f"({facts.stabilize})"
        )
    if until is not None:
        way = "ended by" if facts.ended_by == UNTIL else "not met up to the end:"
        lines.append(f"{way} --until {until}")
    counts = {name: count for name, count in facts.events.items() if name != UNTIL}
    if counts:
        lines.append(f"events: {', '.join(f'{name} {count}' for name, count in counts.items())}")
    lines += facts.remarks
    if facts.error_estimate is not None:
        lines.append(f"error of q and qd: about {facts.error_estimate:.2g}, by a tighter run")
    if facts.tracking:
        errors, torques, units = [], [], scene_units(mechanism)
        for k, x in zip(mechanism.actuated, facts.tracking, strict=True):
            unit, of_torque = (unit_of(f"{name}{k + 1}", units) for name in ("e", "tau"))
            size = f"{x.rms:.3g} {unit} rms, {x.largest:.3g} {unit} at most"
            errors.append(f"{x.joint} {size}, at t = {x.at:.6g} s")
            torques.append(f"{x.joint} {x.largest_torque:.6g} {of_torque}")
        lines.append(f"tracking error: {'; '.join(errors)}")
        lines.append(f"largest torque: {', '.join(torques)}")
    if facts.hint:
        lines.append(facts.hint)
    if (
        mechanism.rows
        and facts.nearest_singular is not None
        and facts.nearest_singular_time is not None
    ):
        lines.append(
            f"nearest to singular: {facts.nearest_singular:.3g} at "
            f"t = {facts.nearest_singular_time:.6g} s (least singular value of Psi, relative)"
        )
    if facts.missed:
        lines.append(facts.missed)
    note("\n".join(lines))
