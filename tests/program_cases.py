"""Scenes of every kind, each at one state, and the terms of their equations of motion.

The terms are independent of the program: M, C qd and G from Newton and Euler (`oracles.py`),
closures from the kinematics of points (`random_mechanisms.Pose`), springs, loads and friction from
virtual power (`test_forces.Forces`), all of what the description of the scene says.
"""

import functools
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from conftest import ROOT
from test_forces import Forces

import oracles
from random_mechanisms import (
    LOOPS,
    Pose,
    Scene,
    Shape,
    forced,
    mechanism,
    oracle_tree,
    seeded_scene,
    seeded_tree,
)
from robodyn.dynamics import identities
from robodyn.mechanics.mechanism import Mechanism

SEEDS = range(20)

# ---------------------------------------------------------------------------------------------
# The oracle
# ---------------------------------------------------------------------------------------------


class Known(NamedTuple):
    """M qdd + h = tau + Psi^T lambda, Psi qdd + bias = 0, and the gap."""

    M: np.ndarray
    h: np.ndarray
    Psi: np.ndarray
    bias: np.ndarray
    gap: np.ndarray


def known(mech, q, qd) -> Known:
    """All terms at a state, of the description alone (of a coupling's row only its scale `arm`)."""
    description, n = mech.description, len(q)
    tree, rest = oracle_tree(description), np.zeros(n)
    columns = [oracles.newton_euler(tree, 0j, q, rest, qdd) for qdd in np.eye(n)]
    h = np.array(oracles.newton_euler(tree, description.gravity, q, qd, rest))
    potential, other, _ = Forces(SimpleNamespace(mechanism=mech, q=q, qd=qd)).torques()
    h += np.array([link.damping for link in description.links]) * qd - potential - other
    pose = Pose(tree, q)
    Psi, bias, gap = [], [], []
    for closure in description.closures:
        sides = [(point.link, point.at) for point in (closure.first, closure.second)]
        along = closure.along
        for direction in (1.0, 1j) if along is None else (1j * along / abs(along),):
            d, slope, bend = (
                a - b
                for a, b in (
                    [pose.position(side) for side in sides],
                    [pose.slope(side) for side in sides],
                    [pose.bias(side, qd) for side in sides],
                )
            )
            gap.append((np.conj(direction) * d).real)
            Psi.append((np.conj(direction) * slope).real)
            bias.append((np.conj(direction) * bend).real)
    arms = [row.arm for row in mech.rows if row.closure is None]
    for coupling, arm in zip(description.couplings, arms, strict=True):
        row = np.eye(n)[coupling.joint]
        for k, ratio in coupling.terms:
            row[k] -= ratio
        Psi.append(arm * row)
        bias.append(0.0)
        gap.append(arm * (row @ q - coupling.angle))
    r = len(gap)
    return Known(np.array(columns).T, h, np.reshape(Psi, (r, n)), np.array(bias), np.array(gap))


def accelerations(at: Known, tau):
    """qdd and lambda, and the rounding that they may have."""
    n, r = len(at.h), len(at.gap)
    K = np.block([[at.M, -at.Psi.T], [at.Psi, np.zeros((r, r))]])
    solution = np.linalg.solve(K, np.concatenate([tau - at.h, -at.bias]))
    return np.split(solution, [n]), 1e-13 * (1.0 + np.linalg.cond(K))


def torques(at: Known, qdd, actuated):
    """tau and lambda."""
    n, r = len(at.h), len(at.gap)
    driven = np.eye(n)[:, list(actuated)]
    K = np.hstack([driven, at.Psi.T])
    solution = np.linalg.solve(K, at.M @ qdd + at.h)
    tau, multipliers = np.split(solution, [n - r])
    return [driven @ tau, multipliers], 1e-13 * (1.0 + np.linalg.cond(K))


# ---------------------------------------------------------------------------------------------
# The scenes
# ---------------------------------------------------------------------------------------------

SLIDERS = {
    "two sliders on a chain": Shape((None, 0, 1), sliders=(1, 2), actuated=(0,)),
    "two sliders on a crank": Shape((None, 0, 0), sliders=(1, 2), actuated=(0,)),
    "slider and pin": Shape((None, 0, None, 1), ((1, 2),), sliders=(3,), actuated=(0,)),
}


def geared(seed, plain, joint, other, actuated):
    """The scene with a gear between two joints, put where it fits."""
    numbers = np.random.default_rng(2000 + seed)
    ratio, angle = (round(float(x), 6) for x in numbers.uniform(0.3, 2.0, 2) * [(-1) ** seed, 1])
    q = plain.q.copy()
    if plain.mechanism.rows:
        angle = float(q[joint] - ratio * q[other])
    q[joint] = ratio * q[other] + angle
    lines = [line for line in plain.text.splitlines() if not line.startswith("actuated")]
    lines.append(f'couplings: ["q{joint + 1} = {ratio!r} q{other + 1} + {angle:.17f}"]')
    lines.append(f"actuated: [{', '.join(f'link{k}' for k in actuated)}]")
    return Scene("\n".join(lines).replace("+ -", "- ") + "\n", q, plain.qd, plain.qdd)


def plain_scene(name, seed):
    """A random scene of a kind."""
    if name == "tree":
        return seeded_tree(seed, 1 + seed % 6)
    if name == "geared tree":
        tree, n = seeded_tree(seed, 2 + seed % 4), 2 + seed % 4
        joint, other = (seed % n, (seed + 1) % n)
        return geared(seed, tree, joint, other, [k for k in range(n) if k != joint])
    if name == "geared five-bar":
        return geared(seed, seeded_scene(seed, LOOPS["five-bar"]), 2, 0, [0])
    return seeded_scene(seed, (LOOPS | SLIDERS)[name])


KINDS = ("tree", *LOOPS, *SLIDERS, "geared tree", "geared five-bar")
ROBOTS = sorted((ROOT / "robots").glob("*.yaml"))


class Case(NamedTuple):
    """A state of a scene, and torques tau."""

    mech: Mechanism
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray
    at: Known


def case(mech, q, qd, seed):
    """Rates and accelerations that keep the closures, torques at the actuated joints."""
    rng = np.random.default_rng(seed)
    at = known(mech, q, qd)
    qd = qd - np.linalg.pinv(at.Psi) @ (at.Psi @ qd)
    at = known(mech, q, qd)
    assert np.abs(at.gap).max(initial=0.0) < 1e-11
    qdd = rng.uniform(-15.0, 15.0, len(q))
    qdd -= np.linalg.pinv(at.Psi) @ (at.Psi @ qdd + at.bias)
    tau = np.zeros(len(q))
    tau[list(mech.actuated)] = rng.uniform(-5.0, 5.0, len(mech.actuated))
    return Case(mech, q, qd, qdd, tau, at)


@functools.cache
def random_case(name, seed, acted):
    scene = plain_scene(name, seed)
    if acted:
        scene = forced(seed, scene)
        more = "{joint: link0, stiffness: 2.5, angle: 0.7}, {joint: link0, stiffness: 3, angle: 2}"
        scene = replace(scene, text=scene.text.replace("springs: [", f"springs: [{more}, "))
    return case(scene.mechanism, scene.q, scene.qd, seed)


@functools.cache
def robot_cases(path):
    mech = mechanism(path.read_text())
    sample = identities.sample_states(mech, 3)
    assert len(sample.q) == 3
    return [case(mech, q, qd, k) for k, (q, qd) in enumerate(zip(sample.q, sample.qd, strict=True))]


def cases(name: str | Path, seeds: range) -> list[Case]:
    """Of a kind of random scene, plain and with forces; or of a file."""
    if isinstance(name, str):
        return [random_case(name, seed, acted) for seed in seeds for acted in (False, True)]
    return robot_cases(name)[: len(seeds)]
