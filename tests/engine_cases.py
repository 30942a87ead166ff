"""Scenes of every kind, each at one state, and what every quantity of them is there."""

import functools
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from conftest import FRESH, ROOT
from known_terms import DIGITS, Known
from mpmath import mp
from unwritten import MASSLESS
from varied_scenes import AT, varied

from random_mechanisms import (
    LOOPS,
    Scene,
    Shape,
    forced,
    mechanism,
    motored,
    seeded_scene,
    seeded_tree,
    sizes,
    sliding,
)
from robodyn.dynamics import identities
from robodyn.mechanics.mechanism import Mechanism

SEEDS = range(20)

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
        return seeded_tree(seed, (12, 8, 4, 2, 1, 6)[seed % 6])
    if name == "geared tree":
        tree, n = seeded_tree(seed, 2 + seed % 4), 2 + seed % 4
        joint, other = (seed % n, (seed + 1) % n)
        return geared(seed, tree, joint, other, [k for k in range(n) if k != joint])
    if name == "tree with motors":
        return motored(seed, seeded_tree(seed, (2, 4, 3, 1)[seed % 4]))
    if name == "sliding tree with motors":
        n = 2 + seed % 3
        return motored(seed, sliding(seed, seeded_tree(seed, n), (seed // 4) % n))
    if name == "geared five-bar with motors":
        return motored(seed, plain_scene("geared five-bar", seed))
    if name == "six-bar with motors":
        return motored(seed, seeded_scene(seed, LOOPS["six-bar with a piston"]))
    if name == "geared five-bar":
        return geared(seed, seeded_scene(seed, LOOPS["five-bar"]), 2, 0, [0])
    if name in VARIED:
        return plain_scene(VARIED[name], seed)
    return seeded_scene(seed, (LOOPS | SLIDERS)[name])


MOTORED = (
    "tree with motors",
    "sliding tree with motors",
    "geared five-bar with motors",
    "six-bar with motors",
)
# with laws of springs and loads that vary; see `varied_scenes.py`
VARIED = {
    "varied tree": "tree",
    "varied four-bar": "four-bar",
    "varied slider": "two sliders on a crank",
}
KINDS = ("tree", *LOOPS, *SLIDERS, "geared tree", "geared five-bar", *MOTORED, *VARIED)
# of the cart-pole the torque of one joint alone makes no motion that is asked for
# a joint without an actuator, a zero along a weld, constants, friction by the forces in pins, the
# law of a coupling: the oracle does not know them
UNLIKE = ("cart-pole", "bell-crank", "weather-vane", "shaper", "disc-cam", "shaken-pendulum")
UNLIKE += ("recovery-truck", "lift", *MASSLESS)
ROBOTS = sorted(x for x in (ROOT / "robots").glob("*.yaml") if x.stem not in UNLIKE)


@dataclass(frozen=True)
class Case:
    """A state of a scene, accelerations that it may have, and torques tau."""

    mech: Mechanism
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray
    at: Known
    t: float = 0.0  # of loads

    @cached_property
    def rounding(self) -> float:
        """That of accelerations, relative."""
        return 1e-13 * (1.0 + self.at.condition)

    @cached_property
    def expected(self) -> dict[str, np.ndarray]:
        """Every quantity, as floats."""
        at = self.at
        qdd, outer = at.accelerations(self.tau)
        tau, inner = at.torques(self.qdd)
        with mp.workdps(DIGITS):
            power = (self.tau + at.Q) @ at.qd
            on_links = [[F.real, F.imag] for F in at.forces.on_links()]
        found = {name: getattr(at, name) for name in ("M", "C", "G", "Q", "KE", "PE")}
        found |= {"gap": at.gap, "Psi": at.Psi, "bias": at.bias, "power": power}
        found |= {"qdd": qdd, "outer": outer, "tau": tau, "inner": inner}
        found |= {"reactions": at.reactions(self.qdd, inner), "on links": on_links}
        return {name: np.array(x, float) for name, x in found.items()}

    @cached_property
    def allowed(self) -> dict[str, float]:
        """How far each quantity may be off: a part of the terms that it is a sum of."""
        size, expected = sizes(self.mech.description), self.expected
        w = float(np.abs(self.qd).sum())
        most = {name: float(np.abs(x).max(initial=0.0)) for name, x in expected.items()}
        ground = sum(link["m"] for link in self.at.tree) * abs(self.mech.gamma) * 1.5
        gravity, coriolis = size.gravity + most["G"] + most["Q"], size.inertia * w
        given = size.torque(self.qd, self.qdd) + most["G"] + most["Q"]
        terms = {"M": size.inertia, "C": coriolis, "G": gravity, "Q": gravity}
        terms |= {"KE": coriolis * w, "PE": gravity + ground + most["PE"], "power": given * w}
        terms |= {"gap": size.loop, "Psi": size.loop, "bias": size.loop * w**2}
        for coupling in self.mech.rows:
            if coupling.closure is None:
                for name in ("gap", "Psi"):
                    terms[name] += coupling.arm * (1.0 + most["Psi"] + np.abs(self.q).max())
        allowed = {name: 1e-14 * size for name, size in terms.items()}
        allowed["power"] *= 10.0
        size = max(most["tau"], most["inner"])
        allowed["tau"] = allowed["inner"] = 1e-13 * size if self.at.r else 1e-14 * given
        size = 1.0 + max(most["qdd"], most["outer"])
        for name in ("qdd", "outer"):
            allowed[name] = min(1e-12 * most[name], self.rounding * size)
        allowed["on links"] = 1e-12 * most["on links"]
        allowed["reactions"] = 1e-13 * (given + most["reactions"])
        return allowed

    def unbalance(self, qdd, outer) -> tuple[float, float]:
        """How far accelerations miss the two equations, against what rounding may make of it."""
        at, size = self.at, sizes(self.mech.description)
        with mp.workdps(DIGITS):
            torque = at.M @ qdd + at.h - self.tau - at.Psi.T @ outer
            bend = at.Psi @ qdd + at.bias
        turning = np.abs(qdd).sum() + np.abs(self.qd).sum() ** 2
        reach = self.allowed["Psi"] / 1e-14
        acting = size.torque(self.qd, qdd) + reach * np.abs(outer).sum()
        acting += np.abs(self.expected["G"]).max() + np.abs(self.expected["Q"]).max()
        return tuple(
            float(np.abs(left).max(initial=0.0)) / (1e-13 * most)
            for left, most in ((torque, acting), (bend, reach * turning + 1e-300))
        )


def case(mech, q, qd, seed, qdd=None, t=0.0):
    """Rates and accelerations that keep the closures, torques at the actuated joints."""
    rng = np.random.default_rng(seed)
    Psi = Known(mech, q, qd, t).Psi.astype(float)
    inverse = np.linalg.pinv(Psi)
    qd = qd - inverse @ (Psi @ qd)
    at = Known(mech, q, qd, t)
    assert np.abs(at.gap).max(initial=0.0) < 1e-11
    qdd = rng.uniform(-15.0, 15.0, len(q)) if qdd is None else qdd
    qdd = qdd - inverse @ (Psi @ qdd + at.bias.astype(float))
    tau = np.zeros(len(q))
    tau[list(mech.actuated)] = rng.uniform(-5.0, 5.0, len(mech.actuated))
    return Case(mech, q, qd, qdd, tau, at, t)


@functools.cache
def random_case(name, seed, acted):
    scene = plain_scene(name, seed)
    if acted and not scene.mechanism.slides:
        scene = forced(seed, scene)
        more = "{joint: link0, stiffness: 2.5, angle: 0.7}, {joint: link0, stiffness: 3, angle: 2}"
        scene = replace(scene, text=scene.text.replace("springs: [", f"springs: [{more}, "))
    if name in VARIED:
        scene = replace(scene, text=varied(seed, scene.text, scene.n))
    return case(scene.mechanism, scene.q, scene.qd, seed, t=AT if name in VARIED else 0.0)


@functools.cache
def robot_cases(path):
    mech = mechanism(path.read_text())
    sample = identities.sample_states(mech, 3)
    assert len(sample.q) == 3
    return [case(mech, q, qd, k) for k, (q, qd) in enumerate(zip(sample.q, sample.qd, strict=True))]


def plain_too(name: str | Path) -> bool:
    """Whether what takes long is asked of a scene without its forces as well."""
    return FRESH or name in KINDS[::3]


def cases(name: str | Path, seeds: range) -> list[Case]:
    """Of a kind of random scene, plain and with forces; or of a file."""
    if isinstance(name, str):
        return [random_case(name, seed, acted) for seed in seeds for acted in (False, True)]
    return robot_cases(name)[: len(seeds)]
