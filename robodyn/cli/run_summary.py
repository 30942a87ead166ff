"""What `simulate` tells of a run on stderr."""

from __future__ import annotations

from robodyn.cli.output import note
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.run_control import JointTracking
from robodyn.simulation.recording import Report

AT_REST = 1e-13  # part of the energy at the start below which nothing moves


def tell(mechanism: Mechanism, facts: Report) -> None:
    """The summary."""
    drift = "energy balance" if facts.work else "energy drift"
    lines = [
        f"{facts.outcome}: t = {facts.t_reached:.6g} s, {facts.method} (rtol {facts.rtol:g}, "
        f"atol {facts.atol:g}), {facts.steps} steps, {facts.evaluations} evaluations, "
        f"{facts.seconds:.3g} s",
        f"{drift}: {_part(facts)}" + (f"; work done {facts.work:.6g} J" if facts.work else ""),
    ]
    if mechanism.rows:
        lines.append(
            f"largest gap: {facts.largest_gap:.2g} m, {facts.largest_gap_rate:.2g} m/s "
            f"({facts.stabilize})"
        )
    if facts.error_estimate is not None:
        lines.append(f"error of q and qd: about {facts.error_estimate:.2g}, by a tighter run")
    if facts.tracking:
        lines += _tracking(facts.tracking)
    if facts.hint:
        lines.append(facts.hint)
    if facts.nearest_singular is not None and facts.nearest_singular_time is not None:
        lines.append(
            f"nearest to singular: {facts.nearest_singular:.3g} at "
            f"t = {facts.nearest_singular_time:.6g} s (least singular value of Psi, relative)"
        )
    if facts.missed:
        lines.append(facts.missed)
    note("\n".join(lines))


def _part(facts: Report) -> str:
    """The drift as a part of the energy in motion, where there is more of that than rounding."""
    moving = facts.energy_in_motion
    if moving <= AT_REST * max(abs(facts.energy_start), moving):
        return f"{facts.energy_drift * moving:.2g} J, at rest"
    return f"{facts.energy_drift:.2g} of the {moving:.4g} J in motion"


def _tracking(joints: list[JointTracking]) -> list[str]:
    errors = [
        f"{x.joint} {x.rms:.3g} rad rms, {x.largest:.3g} rad at most, at t = {x.at:.6g} s"
        for x in joints
    ]
    torques = ", ".join(f"{x.joint} {x.largest_torque:.6g} N m" for x in joints)
    return [f"tracking error: {'; '.join(errors)}", f"largest torque: {torques}"]
