"""The names of the columns of what acts in loops."""

from __future__ import annotations

from robodyn.mechanics.planar_model import Mechanism


def loop_columns(mechanism: Mechanism) -> list[str]:
    """The columns of `dynamics.loop_forces`: of closures forces, then moments; of couplings."""
    described = mechanism.description
    pins = [f"f{axis}{c + 1}" for c in range(len(described.closures)) for axis in "xy"]
    kept = [f"mz{c + 1}" for c, x in enumerate(described.closures) if x.aligned is not None]
    return [*pins, *kept, *(f"tc{c + 1}" for c in range(len(described.couplings)))]
