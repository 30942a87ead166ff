"""Motions that are known: reference digits, starts, and dampers whose work an oracle tells."""

import json
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from conftest import FOUR_BAR, FRESH, ROOT, TWO_LINK

import oracles
from robodyn import load, simulate
from robodyn.dynamics.identities import sample_states
from robodyn.runs.report import Outcome

REFERENCES = Path(__file__).parent / "references"


@cache
def scene(name):
    return load(ROOT / "robots" / f"{name}.yaml")


@dataclass(frozen=True)
class Reference:
    """A motion known to 18 digits: times (T,), states (T, 2n) as text, and the torque."""

    name: str
    scene: str
    tau: str
    t: np.ndarray
    q: list[list[str]]
    qd: list[list[str]]
    digits: int

    @property
    def states(self):
        return np.array([[float(x) for x in q + qd] for q, qd in zip(self.q, self.qd, strict=True)])

    @property
    def mechanism(self):
        return load(ROOT / self.scene)

    def run(self, **options):
        """The same motion simulated; the largest error at each time (T,).

        But with FRESH the first 2 s, and of a 2R all.
        """
        n = len(self.q[0])
        start = self.states[0]
        kept = (self.t <= 2.0) | FRESH | self.name.startswith("2r")
        t = self.t[kept]
        options = {"tau": self.tau or None, "t_eval": t, **options}
        motion = simulate(self.mechanism, start[:n], start[n:], t[-1], **options)
        assert motion.outcome is Outcome.FINISHED
        found = np.concatenate([motion.q, motion.qd], axis=1)
        return np.abs(found - self.states[kept]).max(axis=1)


@cache
def reference(name):
    data = json.loads((REFERENCES / f"{name}.json").read_text())
    times, q, qd = zip(*((s["t"], s["q"], s["qd"]) for s in data["states"]), strict=True)
    return Reference(
        name, data["scene"], data["tau"], np.array(times), q, qd, data["agreed_digits"]
    )


# How much an error grows until the last time: error over tolerance, a few times what is measured.
SENSITIVITY = {
    "2r-regular": 300,
    "2r-chaotic": 1e5,
    "2r-driven": 30,
    "3r": 500,
    "pendulum": 3e3,
    "four-bar": 3e3,
    "four-bar-driven": 30,
    "slider-crank": 5e4,
    "five-bar": 2e3,
    "watt-six-bar": 300,
    "stephenson-six-bar": 1e3,
    "spring-slider-crank": 2e3,
    "balanced-arm": 100,
    "geared-five-bar": 100,
    "hoeken": 3e3,
    "rp-arm": 3e3,
    "elliptic-trammel": 3e3,
    "whitworth": 3e3,
}


def slope(sizes, errors):
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


DAMPED_ARM = """
gravity: 9.81
links:
  - {name: upper arm, m: 1.5, l: 0.8, r: 0.36, I: 0.082, damping: 0.3}
  - {name: forearm,   m: 0.9, l: 0.6, r: 0.25, I: 0.031, damping: 0.12}
"""
DAMPED_FOUR_BAR = """
gravity: 9.81
links:
  - {name: crank,   m: 0.6, l: 0.35, r: 0.15, I: 0.008, damping: 0.05}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102, damping: 0.02}
  - {name: rocker,  m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0], damping: 0.07}
closures: [[coupler, rocker]]
actuated: [crank]
"""


def arm_energy(q, qd):
    p = TWO_LINK
    M, _, _ = oracles.two_link_terms(p, q, qd)
    s1, s12 = math.sin(q[0]), math.sin(q[0] + q[1])
    height = p.m1 * p.r1 * s1 + p.m2 * (p.l1 * s1 + p.r2 * s12)
    return qd @ M @ qd / 2 + p.g * height


def four_bar_energy(q, qd):
    p = FOUR_BAR
    M = oracles.four_bar_terms(p, q, qd).M
    s1, s12, s3 = math.sin(q[0]), math.sin(q[0] + q[1]), math.sin(q[2])
    height = p.m1 * p.r1 * s1 + p.m2 * (p.l1 * s1 + p.r2 * s12) + p.m3 * p.r3 * s3
    return qd @ M @ qd / 2 + p.g * height


DAMPED = {
    "arm": (DAMPED_ARM, [0.3, -0.5], [1.0, 2.0], arm_energy, [0.3, 0.12]),
    "four-bar": (DAMPED_FOUR_BAR, None, [3.0], four_bar_energy, [0.05, 0.02, 0.07]),
}
START = ([0.1, 0.2], [0.0, 0.0])


def moved_by_each(mechanism, methods, end, drift):
    """The start (2n,), the torques (n,), and where each method ends (methods, 2n)."""
    sample, tau, n = sample_states(mechanism, 1), np.zeros(mechanism.n), mechanism.n
    tau[list(mechanism.actuated)] = 0.3
    start, ends = np.concatenate([sample.q[0], 0.5 * sample.qd[0]]), []
    how = {"tau": tau.tolist(), "rtol": 1e-10, "atol": 1e-10}
    for method in methods:
        motion = simulate(mechanism, start[:n], start[n:], end, method=method, **how)
        assert motion.outcome is Outcome.FINISHED
        assert motion.report.energy_drift <= drift
        ends.append([*motion.q[-1], *motion.qd[-1]])
    return start, tau.tolist(), ends
