"""What long chains and loops that are nearly locked cost."""

from __future__ import annotations

import sys
from typing import Any

import robodyn
from robodyn.mechanics.mechanism import build
from robodyn.scene.description import from_text

EQUATIONS = [(20, 2.0), (40, 10.0)]  # links, and the bound
CHECKED = 100  # links
DERIVED = 8  # links
SPARE = [1e-12, 1e-3]  # m
NEARLY_LOCKED = """
links:
  - {{name: crank, m: 1, l: 0.1, r: 0.05, I: 0.001}}
  - {{name: coupler, m: 1, l: {}, r: 0.2, I: 0.01}}
  - {{name: rocker, from: [1, 0], m: 1, l: 0.5, r: 0.25, I: 0.02}}
closures: [[coupler, rocker]]
"""


def long_chains(bench: Any) -> list[Any]:
    """Whole processes; seconds are under "ours"."""
    from bench import BIN, chain_text, compared

    def row(command: str, n: int, *options: str, **limits: float) -> Any:
        scene = bench.folder / f"chain{n}.yaml"
        scene.write_text(chain_text(n), encoding="utf-8")
        scipy = (sys.executable, "-c", "from scipy.integrate import solve_ivp")
        times, _ = bench.processes(
            (BIN / "robodyn", command, scene, *options), scipy, 1 + 2 * (n < 40)
        )
        told = " ".join((command, *options))
        return compared(f"{told}, {n}R chain", times, 1, "import solve_ivp", **limits)

    rows = [row("equations", n, bound=bound) for n, bound in EQUATIONS]
    return [*rows, row("equations", DERIVED, "--steps"), row("check", CHECKED)]


def nearly_locked(bench: Any) -> list[Any]:
    """A step of a four-bar with 1e-12 m to spare beside one with 1e-3 m."""
    from bench import compared, in_turn

    runs, steps = [], []
    for spare, seconds in zip(SPARE, (0.01, 5.0), strict=True):
        mechanism = build(from_text(NEARLY_LOCKED.format(0.4 + spare), "four-bar"))
        q = robodyn.assemble(mechanism, [0.0])
        qd = robodyn.loop_velocities(mechanism, q, [0.03])

        def run(state: tuple[Any, ...] = (mechanism, q, qd, seconds)) -> Any:
            return robodyn.simulate(*state)

        runs.append(run)
        steps.append(run().report.steps)
    times = in_turn(*runs, min(bench.repeats, 5))
    each = [(ours / steps[0], theirs / steps[1]) for ours, theirs in times]
    return [compared("step of a four-bar that is nearly locked", each, 1, "1e-3 m", bound=5.0)]
