"""Hard runs with events: many at one instant, and grazes of a long run."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.runs.simulation import simulate
from robodyn.scene.description import from_text

METHODS = ("DOP853", "taylor")
SPEED, DEPTH = 3.0, 1e-10
WHEEL = "gravity: 0\nlinks:\n  - {name: wheel, m: 1, l: 1, r: 1, I: 0}\n"  # q1 = SPEED t


def wheel() -> Mechanism:
    return build(from_text(WHEEL, "wheel"))


def at_one_instant(time: float) -> Iterator[tuple[str, float, float, float]]:
    """Five functions that pass zero together: what is missing, how far apart, what is unordered."""
    events = {
        "a": "sin(q1)",
        "b": "tan(q1/2)*cos(q1/2)**2",
        "c": "1 if sin(q1) > 0 else -1",
        "d": "sin(q1)**3",
        "e": "sin(q1)*exp(cos(q1))",
    }
    for method in METHODS:
        found = simulate(wheel(), [0.5], [SPEED], time, None, method, 1e-12, 1e-12, events=events)
        times = {name: [x.t for x in found.events if x.name == name] for name in events}
        exact = (np.arange(1, int((0.5 + time * SPEED) / math.pi) + 1) * math.pi - 0.5) / SPEED
        missing = sum(abs(len(each) - len(exact)) for each in times.values())
        apart = math.nan
        if not missing:
            apart = max(float(np.ptp(each)) for each in zip(*times.values(), strict=True))
        order = [event.t for event in found.events]
        yield method, float(missing), apart, float(order != sorted(order))


def long_grazes(time: float) -> Iterator[tuple[str, float, float]]:
    """sin(q1) that passes a level by DEPTH twice a turn, or misses it: how many are not told."""
    turns = int(0.75 + time * SPEED / (2.0 * math.pi))  # whose tops are passed
    events = {"over": f"sin(q1) - {1.0 - DEPTH!r}", "under": f"sin(q1) - {1.0 + DEPTH!r}"}
    for method in METHODS:
        run = simulate(wheel(), [0.0], [SPEED], time, None, method, 1e-12, 1e-12, events=events)
        counts = run.report.events
        yield method, abs(counts["over"] - 2.0 * turns), float(counts["under"])
