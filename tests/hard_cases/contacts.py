"""Bounces without end, and 1,000 s of stick-slip: (case, hard, measure, bound, found)."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from robodyn.engines import machine
from robodyn.mechanics.mechanism import build
from robodyn.runs.report import Outcome
from robodyn.runs.simulation import simulate
from robodyn.scene.description import from_text

Found = tuple[str, str, str, float, float]
METHODS = ("DOP853", "taylor")
BLOCK = "joint: prismatic, m: 1, l: 0, r: 0, I: 0"


def zeno() -> Iterator[Found]:
    keys = "axis: [0, 1], limits: {min: 0, restitution: 0.95}"
    ball = build(from_text(f"gravity: 9.81\nlinks: [{{name: ball, {BLOCK}, {keys}}}]\n", "ball"))
    rest = math.sqrt(2.0 / 9.81) * (1.0 + 2.0 * 0.95 / 0.05)
    for method in METHODS:
        run = simulate(ball, [1.0], [0.0], 30.0, method=method, rtol=1e-10, atol=1e-10)
        at = run.events[-1].t if run.outcome is Outcome.FINISHED else math.inf
        yield f"bouncing ball, {method}", "bounces without end", "rest, s off", 3e-9, abs(at - rest)
        yield (
            f"bouncing ball, {method}",
            "bounces without end",
            "q at rest, m",
            0.0,
            abs(run.q[-1, 0]),
        )


def stick_slip(time: float) -> Iterator[Found]:
    keys = "axis: [1, 0], friction: {force: 1, static: 2, stribeck: 0.5}"
    block = build(from_text(f"gravity: 0\nlinks: [{{name: block, {BLOCK}, {keys}}}]\n", "block"))
    hard = f"phases that end by events for {time:,g} s"
    # each method repeats its own errors: the periods of one that changes on the way would differ
    for method in ("DOP853", "taylor") if machine.available() else ("DOP853",):
        options = {"method": method, "rtol": 1e-10, "atol": 1e-10}
        run = simulate(block, [0.0], [0.0], time, "3*(0.1*t - q1)", **options)
        case = f"stick-slip, {method}"
        bound = 1e-11 if method == "taylor" else 1e-5  # by its dense output at the events
        starts = np.array([x.t for x in run.events if x.name == "block starts"])
        done = run.outcome is Outcome.FINISHED
        periods = np.diff(starts)[2:]  # a cycle that repeats
        off = float(np.ptp(periods)) if done else math.inf
        yield case, hard, "periods apart, s", bound, off
        yield case, hard, "energy balance", 1e-7, run.report.energy_drift
