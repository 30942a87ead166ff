"""Derivatives next to change points, and of links whose inertias are far apart."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from engine_cases import case
from known_slopes import along

import robodyn
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text

Found = tuple[str, str, str, float, float]
MEASURE = "error of d qdd / (eps cond), by "
BOUND = 10.0  # times what the solve itself may lose


def _rows(name: str, hard: str, mechanism: Mechanism, angle: float) -> Iterator[Found]:
    q = robodyn.assemble(mechanism, [angle])
    at = case(mechanism, q, robodyn.loop_velocities(mechanism, q, [2.0]), 0)
    found = robodyn.forward_dynamics_derivatives(mechanism, at.q, at.qd, at.tau)
    rng = np.random.default_rng(1)
    for by, other, matrix in zip(("q", "qd", "tau"), ("q", "qd", "x"), found[1:4], strict=True):
        v = rng.normal(size=mechanism.n)
        error = np.abs(matrix @ v - along(at, "forward", other, v)).max()
        size = float((np.abs(matrix) @ np.abs(v)).max()) * at.at.condition * 2.2e-16
        yield name, hard, MEASURE + by, BOUND, float(error / size)


def near_change_points(parallelogram: Mechanism) -> Iterator[Found]:
    for angle in (0.1, 0.01, 1e-3, 1e-4):
        name = f"parallelogram {angle:g} rad from its change point"
        yield from _rows(name, "derivatives where branches meet", parallelogram, angle)


def far_apart() -> Iterator[Found]:
    for ratio in (1e2, 1e4, 1e6, 1e8):
        text = (
            "gravity: 9.81\nlinks:\n  - {name: a, m: 1, l: 0.35, r: 0.15, I: 0.01}\n"
            f"  - {{name: b, m: {1 / ratio!r}, l: 0.95, r: 0.45, I: {0.1 / ratio!r}}}\n"
            f"  - {{name: c, m: {ratio!r}, l: 0.8, r: 0.4, I: {0.1 * ratio!r}, from: [1.1, 0]}}\n"
            "closures: [[b, c]]\n"
        )
        mechanism = build(from_text(text, "ratio"))
        name = f"four-bar, rocker {ratio**2:g} times the coupler"
        yield from _rows(name, "derivatives at large ratios", mechanism, 1.0)
