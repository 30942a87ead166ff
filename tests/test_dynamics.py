"""Inverse and forward dynamics against the lecture, Newton-Euler and 30 digits.

M qdd + C qd + D qd + G = S^T tau_act + Q + Psi^T lambda      Psi qdd + Psidot qd = 0    (1)
"""

import dataclasses
import re
import warnings

import numpy as np
import pytest
from conftest import ROOT
from each_case import each
from hypothesis import given, settings
from known_terms import DIGITS, Known
from mpmath import mp

import oracles
import robodyn
from random_mechanisms import (
    LOOPS,
    Shape,
    assert_close,
    mechanism,
    oracle_tree,
    seeded_scene,
    seeded_tree,
    sizes,
    trees,
)
from robodyn.dynamics import closed_form as cf
from robodyn.dynamics import dense_dynamics
from robodyn.dynamics import dynamics as dyn
from robodyn.elements.springs import PointSpring
from robodyn.engines import formulas
from robodyn.errors import InputError, ResidualError, RobodynError, SingularError
from robodyn.loops import closing, closures, loop_rates

SEEDS = range(8)
EACH_LOOP = each("name", LOOPS)

TWO_LINK = oracles.TwoLink(1.5, 0.8, 0.36, 0.082, 0.9, 0.6, 0.25, 0.031)
FOUR_BAR = oracles.FourBar(
    *(0.6, 0.35, 0.15, 0.008),
    *(1.3, 0.95, 0.45, 0.102),
    *(1.0, 0.80, 0.36, 0.061),
    *(1.1, 0.07),
)
FOUR_BAR_LINKS = """
gravity: 9.81
links:
  - {name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker, m: 1.0, l: 0.8, r: 0.36, I: 0.061, from: [1.1, 0.07]}
"""
FOUR_BAR_YAML = FOUR_BAR_LINKS + "closures: [[coupler, rocker]]\n"
TWO_LINK_YAML = """
gravity: 9.81
links:
  - {name: upper arm, m: 1.5, l: 0.8, r: 0.36, I: 0.082}
  - {name: forearm, m: 0.9, l: 0.6, r: 0.25, I: 0.031}
"""
PARALLELOGRAM_YAML = """
gravity: 9.81
links:
  - {name: crank, m: 0.45, l: 0.3, r: 0.14, I: 0.0041}
  - {name: coupler, m: 1.1, l: 0.7, r: 0.36, I: 0.049}
  - {name: rocker, m: 0.55, l: 0.3, r: 0.16, I: 0.0052, from: [0.7, 0]}
closures: [[coupler, rocker]]
"""
THREE_CRANKS_YAML = """
gravity: 9.81
links:
  - {name: crank, m: 0.45, l: 0.3, r: 0.14, I: 0.0041}
  - {name: coupler, m: 1.1, l: 0.7, r: 0.36, I: 0.049}
  - {name: rocker, m: 0.55, l: 0.3, r: 0.16, I: 0.0052, from: [0.7, 0]}
  - {name: third, m: 0.25, l: 0.3, r: 0.11, I: 0.0032, from: [0.3, 0]}
closures: [[coupler, rocker], [{link: coupler, at: [0.3, 0]}, third]]
actuated: [crank]
"""


def neighbours(scene, count, seed=0):
    """Many states (q, qd, qdd) around a scene's own; equation (1) holds for open loops too."""
    rng = np.random.default_rng(seed)
    spreads = (0.05, 1.0, 10.0)
    return tuple(
        state + spread * rng.normal(size=(count, scene.n))
        for state, spread in zip(scene.states, spreads, strict=True)
    )


def one_by_one(function, mech, states):
    """Joint values and multipliers of `function` called with each state by itself."""
    found = [function(mech, *state)[:2] for state in zip(*states, strict=True)]
    return tuple(np.array(part) for part in zip(*found, strict=True))


# ------------------------------------------------------------------------------------------------


class TestOpenInverse:
    @pytest.mark.parametrize("seed", SEEDS)
    def test_lecture_2r(self, seed):
        """tau = M qdd + C qd + G, equations (24)-(27)."""
        q, qd, qdd = np.random.default_rng(seed).normal(size=(3, 2)) * [[2.0], [5.0], [20.0]]
        mech = mechanism(TWO_LINK_YAML)
        tau = dyn.inverse_dynamics(mech, q, qd, qdd)
        size = sizes(mech.description).torque(qd, qdd)
        assert_close(tau, oracles.two_link_torque(TWO_LINK, q, qd, qdd), size)

    def test_damping_is_at_the_joint(self):
        """0.4 N m s/rad at the elbow, moving at 5 rad/s: 2 N m more there, nothing elsewhere."""
        damped = TWO_LINK_YAML.replace("I: 0.031}", "I: 0.031, damping: 0.4}")
        states = [0.1, 0.2], [3.0, 5.0], [0.0, 0.0]
        more = dyn.inverse_dynamics(mechanism(damped), *states) - dyn.inverse_dynamics(
            mechanism(TWO_LINK_YAML), *states
        )
        assert_close(more, [0.0, 2.0], 20.0)

    def test_the_public_name(self):
        mech = mechanism(TWO_LINK_YAML)
        states = [0.1, 0.2], [3.0, 5.0], [1.0, 2.0]
        tau = robodyn.inverse_dynamics(mech, *states)
        assert_close(robodyn.forward_dynamics(mech, *states[:2], tau), states[2], 10.0)


class TestOpenForward:
    @pytest.mark.parametrize("seed", SEEDS)
    def test_lecture_2r(self, seed):
        q, qd, tau = np.random.default_rng(seed).normal(size=(3, 2)) * [[2.0], [5.0], [20.0]]
        expected = oracles.two_link_acceleration(TWO_LINK, q, qd, tau)
        qdd = dyn.forward_dynamics(mechanism(TWO_LINK_YAML), q, qd, tau)
        assert_close(qdd, expected, np.abs(expected).max() + np.abs(qd).max() ** 2)


class TestMassRatios:
    """Masses up to a million million apart, at 30 digits."""

    CHAINS = ((1e-6, 1.0), (1.0, 1e-6), (1e6, 1.0, 1e-6), (1e-6, 1.0, 1e6), (1.0, 1e6, 1e-6, 1e6))

    @staticmethod
    def chain(masses):
        return mechanism(
            "gravity: 9.81\nlinks:\n"
            + "".join(
                f"  - {{name: l{k}, m: {m}, l: {0.8 - 0.1 * k}, r: 0.3, I: {0.02 * m}}}\n"
                for k, m in enumerate(masses)
            )
        )

    @pytest.mark.parametrize("masses", CHAINS)
    def test_torque_of_each_joint(self, masses):
        """To 1e-13 of what the links from that joint on weigh and bear."""
        mech, n = self.chain(masses), len(masses)
        q, qd, qdd = np.random.default_rng(n).normal(size=(3, n)) * [[2.0], [3.0], [9.0]]
        tree = oracle_tree(mech.description)
        exact = oracles.newton_euler_mp(tree, mech.gamma, q, qd, qdd)
        tau = dyn.inverse_dynamics(mech, q, qd, qdd)
        acceleration = np.abs(qdd).sum() + np.abs(qd).sum() ** 2 + 10.0
        for k in range(n):
            assert_close(tau[k], float(exact[k]), 3.0 * sum(masses[k:]) * acceleration)

    @pytest.mark.parametrize("masses", CHAINS)
    def test_accelerations_balance_the_forces(self, masses):
        mech, n = self.chain(masses), len(masses)
        q, qd = np.random.default_rng(n).normal(size=(2, n)) * [[2.0], [3.0]]
        tau = np.array([sum(masses[k:]) for k in range(n)]) * np.cos(np.arange(n))
        qdd = dyn.forward_dynamics(mech, q, qd, tau)
        at = Known(mech, q, qd)
        with mp.workdps(DIGITS):
            unbalance = float(max(abs(at.M @ qdd + at.h - tau)))
        assert unbalance <= 1e-13 * sizes(mech.description).torque(qd, qdd)

    @each("coupler", [1e-6, 1e6])
    @each("rocker", [1e-6, 1.0, 1e6])
    @each("count", [1, 200])
    def test_four_bar(self, coupler, rocker, count):
        p = FOUR_BAR._replace(m2=1.3 * coupler, I2=0.102 * coupler)
        p = p._replace(m3=1.0 * rocker, I3=0.061 * rocker)
        text = FOUR_BAR_YAML.replace("m: 1.3", f"m: {p.m2}").replace("I: 0.102", f"I: {p.I2}")
        text = text.replace("m: 1.0", f"m: {p.m3}").replace("I: 0.061", f"I: {p.I3}")
        mech = mechanism(text)
        q = oracles.four_bar_position(p, 1.0)
        k, _ = oracles.four_bar_coefficients(p, q)
        qd, tau = 3.0 * k, np.array([2.0 * (1.0 + coupler + rocker), 0.0, 0.0])
        motion = dyn.forward_dynamics_and_forces(mech, np.tile(q, (count, 1)), qd, tau)
        qdd, lam = (x.astype(float) for x in Known(mech, q, qd).accelerations(tau))
        assert_close(motion.qdd[0], qdd, np.abs(qdd).max(), 1e-10)
        assert_close(motion.multipliers[0], lam, np.abs(lam).max() + tau[0], 1e-10)

    @pytest.mark.parametrize("power", [-100, -14, 14, 100])
    @pytest.mark.parametrize("count", [1, 250])
    def test_the_unit_of_mass_does_not_matter(self, power, count):
        """Masses, inertias, torques and forces times a power of ten: the same motion."""
        text = re.sub(r"\b([mI]): ([\d.]+)", rf"\1: \g<2>e{power:+d}", FOUR_BAR_YAML)
        q = oracles.four_bar_position(FOUR_BAR, 1.0)
        qd, tau = 3.0 * oracles.four_bar_coefficients(FOUR_BAR, q)[0], np.array([5.0, 0.0, 0.0])
        qdd, lam = oracles.four_bar_acceleration(FOUR_BAR, q, qd, tau)
        states = np.tile(q, (count, 1)), qd, tau * 10.0**power
        motion = dyn.forward_dynamics_and_forces(mechanism(text), *states)
        assert_close(motion.qdd[0], qdd, np.abs(qdd).max(), 1e-12)
        assert_close(motion.multipliers[0] / 10.0**power, lam, np.abs(lam).max(), 1e-12)

    @pytest.mark.parametrize(
        ("name", "powers"),
        [
            ("five-bar", (6, 6, -6, -6)),  # one freedom heavy, one light
            ("five-bar", (6, 0, 0, 0)),
            ("five-bar", (0, 0, -6, 0)),
            ("loop in a tree", (6, 6, -6, -6, 6)),
            ("loop in a tree", (-6, -6, 6, -6, -6)),
        ],
    )
    def test_several_freedoms(self, name, powers):
        """Mass, inertia, payload and damping of each link times a power of ten."""
        scene = seeded_scene(2, LOOPS[name])
        lines = iter(scene.text.splitlines())
        text = [next(lines), next(lines)]
        for power in powers:
            scaled = rf"\1: \g<2>e{power:+d}"
            text.append(re.sub(r"\b(m|I|payload|damping): ([\d.]+)", scaled, next(lines)))
        mech = mechanism("\n".join([*text, *lines]))
        q, qd, qdd = scene.states
        exact = Known(mech, q, qd)
        tau = exact.torques(qdd)[0].astype(float)
        expected, lam = (x.astype(float) for x in exact.accelerations(tau))
        for count in (1, 200):
            motion = dyn.forward_dynamics_and_forces(mech, np.tile(q, (count, 1)), qd, tau)
            assert_close(motion.qdd[0], expected, np.abs(expected).max(), 1e-10)
            size = np.abs(lam).max() + np.abs(tau).max()
            assert_close(motion.multipliers[0], lam, size, 1e-10)


class TestFourBar:
    """The lecture's four-bar, broken at O3."""

    @each("assembly", ["open", "crossed"])
    @each("seed", SEEDS)
    def test_acceleration_is_equation_33(self, seed, assembly):
        """M qdd = f - Psi^T (Psi M^-1 Psi^T)^-1 (Psi M^-1 f + Psidot qd), f = tau - C qd - G."""
        rng = np.random.default_rng(seed)
        q = oracles.four_bar_position(FOUR_BAR, rng.uniform(-np.pi, np.pi), assembly)
        qd = oracles.four_bar_coefficients(FOUR_BAR, q)[0] * rng.uniform(-5.0, 5.0)
        tau = rng.uniform(-20.0, 20.0, 3)  # torques at every joint
        qdd, lam = oracles.four_bar_acceleration(FOUR_BAR, q, qd, tau)
        motion = dyn.forward_dynamics_and_forces(mechanism(FOUR_BAR_YAML), q, qd, tau)
        assert_close(motion.qdd, qdd, np.abs(qdd).max(), 1e-12)
        assert_close(motion.multipliers, lam, np.abs(lam).max(), 1e-12)

    @each("assembly", ["open", "crossed"])
    @each("seed", SEEDS)
    def test_torque_is_that_of_the_passive_rows(self, seed, assembly):
        rng = np.random.default_rng(seed)
        q = oracles.four_bar_position(FOUR_BAR, rng.uniform(-np.pi, np.pi), assembly)
        k, k_prime = oracles.four_bar_coefficients(FOUR_BAR, q)
        speed, acceleration = rng.uniform(-5.0, 5.0), rng.uniform(-20.0, 20.0)
        qd, qdd = k * speed, k * acceleration + k_prime * speed**2
        tau1, lam = oracles.four_bar_torque(FOUR_BAR, q, qd, qdd)
        found = dyn.inverse_dynamics_and_forces(mechanism(FOUR_BAR_YAML), q, qd, qdd)
        assert found.tau[1:].tolist() == [0.0, 0.0]
        assert_close(found.tau[0], tau1, abs(tau1) + np.abs(lam).max(), 1e-12)
        assert_close(found.multipliers, lam, np.abs(lam).max(), 1e-12)

        back = oracles.four_bar_reduced_acceleration(FOUR_BAR, q[0], speed, tau1, assembly)
        assert_close(back, acceleration, np.abs(qdd).max(), 1e-11)


class TestPinForces:
    """A multiplier is the force on the side that the closure names first."""

    def state(self):
        q = oracles.four_bar_position(FOUR_BAR, 0.9)
        return q, 4.0 * oracles.four_bar_coefficients(FOUR_BAR, q)[0], np.array([3.0, 0.0, 0.0])

    def test_moment_on_the_second_side_is_the_opposite(self):
        """(I3 + m3 r3^2) phi1dd = l3 x (-F) - weight, F on the coupler, -F on the rocker."""
        mech, p = mechanism(FOUR_BAR_YAML), FOUR_BAR
        q, qd, tau = self.state()
        motion = dyn.forward_dynamics_and_forces(mech, q, qd, tau)
        ((fx, fy),) = dyn.pin_forces(mech, motion.multipliers)
        c, s = np.cos(q[2]), np.sin(q[2])
        moment = p.l3 * (c * -fy - s * -fx) - p.m3 * p.g * p.r3 * c
        inertia = p.I3 + p.m3 * p.r3**2
        assert_close(inertia * motion.qdd[2], moment, abs(fx) + abs(fy))

    def test_naming_the_other_side_first_turns_the_force_around(self):
        swapped = mechanism(FOUR_BAR_LINKS + "closures: [[rocker, coupler]]\n")
        found = dyn.forward_dynamics_and_forces(mechanism(FOUR_BAR_YAML), *self.state())
        turned = dyn.forward_dynamics_and_forces(swapped, *self.state())
        size = np.abs(found.multipliers).max()
        assert_close(turned.multipliers, -found.multipliers, size, 1e-12)
        assert_close(turned.qdd, found.qdd, np.abs(found.qdd).max(), 1e-12)

    def test_a_line_bears_the_weight_of_a_rod(self):
        """A rod of 2 kg, l = 1, r = 0.25, at rest on Y = 0: the line lifts with m g r / l."""
        mech = mechanism(
            "gravity: 9.81\n"
            "links: [{name: rod, m: 2, l: 1, r: 0.25, I: 0.1}]\n"
            "closures: [{point: rod, on: {through: [0, 0], along: [-2, 0]}}]"
        )
        motion = dyn.forward_dynamics_and_forces(mech, [0.0], [0.0], [0.0])
        assert motion.qdd.tolist() == [0.0]
        expected = [[0.0, 2 * 9.81 * 0.25]]
        assert_close(dyn.pin_forces(mech, motion.multipliers), expected, 10.0)

    def test_an_inclined_line_pushes_along_its_normal_only(self):
        scene = seeded_scene(3, LOOPS["slider-crank"])
        mech = scene.mechanism
        found = dyn.inverse_dynamics_and_forces(mech, *scene.states)
        ((fx, fy),) = dyn.pin_forces(mech, found.multipliers)
        along = mech.description.closures[0].along
        size = float(np.hypot(fx, fy))
        assert size > 0.1
        assert_close(fx * along.real + fy * along.imag, 0.0, size)

    def test_each_closure_has_its_force(self):
        scene = seeded_scene(4, LOOPS["six-bar with a piston"])
        mech = scene.mechanism
        lam = np.array([[1.0, 2.0, 3.0]] * 5)
        forces = dyn.pin_forces(mech, lam)
        normal = 1j * mech.description.closures[1].along
        assert forces.shape == (5, 2, 2)
        assert_close(forces[4], [[1.0, 2.0], [3 * normal.real, 3 * normal.imag]], 3.0)


class TestMasslessLinks:
    CLOSED = (
        ("four-bar", (1,)),
        ("four-bar driven by its rocker", (0, 1)),
        ("slider-crank", (1,)),
        ("five-bar", (1, 3)),
        ("six-bar, dyad on the coupler", (3,)),
    )

    @pytest.mark.parametrize(("name", "massless"), CLOSED)
    def test_in_a_loop_that_moves_mass(self, name, massless):
        """M alone is singular; the constrained system is not."""
        for seed in SEEDS:
            scene = seeded_scene(seed, LOOPS[name], massless)
            mech = scene.mechanism
            assert not dense_dynamics.elimination_is_safe(mech)
            tau = 20.0 * np.cos(seed + np.arange(scene.n))
            qdd, lam = dyn.forward_dynamics_and_forces(mech, scene.q, scene.qd, tau)[:2]
            expected, forces = Known(mech, scene.q, scene.qd).accelerations(tau)
            assert_close(qdd, expected.astype(float), float(max(abs(expected))), 1e-12)
            assert_close(lam, forces.astype(float), float(max(abs(forces))), 1e-12)

    @pytest.mark.parametrize(("name", "massless"), CLOSED)
    def test_in_a_batch(self, name, massless):
        scene = seeded_scene(1, LOOPS[name], massless)
        q, qd, tau = neighbours(scene, 250)
        together = dyn.forward_dynamics(scene.mechanism, q, qd, tau)
        alone, _ = one_by_one(dyn.forward_dynamics_and_forces, scene.mechanism, (q, qd, tau))
        assert_close(together, alone, np.abs(alone).max(), 1e-12)

    @pytest.mark.parametrize("n", [1, 2, 4])
    @pytest.mark.parametrize("count", [1, 300])
    def test_at_the_end_of_an_open_chain_is_named(self, n, count):
        scene = seeded_scene(n, Shape((None, *range(n - 1))), massless=(n - 1,))
        q, qd, tau = neighbours(scene, count)
        with pytest.raises(SingularError, match=rf"link{n - 1} can move without any inertia"):
            dyn.forward_dynamics(scene.mechanism, q, qd, tau)

    def test_within_an_open_chain_is_no_trouble(self):
        scene = seeded_scene(5, Shape((None, 0, 1)), massless=(1,))
        mech = scene.mechanism
        tau = dyn.inverse_dynamics(mech, *scene.states)
        qdd = dyn.forward_dynamics(mech, scene.q, scene.qd, tau)
        assert_close(qdd, scene.qdd, np.abs(scene.qdd).max() + 100.0, 1e-12)

    @pytest.mark.parametrize("count", [1, 300])
    def test_singular_at_one_configuration_only(self, count):
        """A point mass at the tip of two massless rods: free to be pulled apart once stretched."""
        mech = mechanism(
            "links:\n"
            "  - {name: first, m: 0, l: 1, r: 0, I: 0}\n"
            "  - {name: second, m: 1, l: 1, r: 1, I: 0}\n"
        )
        q = np.zeros((count, 2))
        q[:, 1] = np.linspace(0.5, 2.0, count)
        assert np.isfinite(dyn.forward_dynamics(mech, q, 0 * q, [1.0, 0.0])).all()
        q[count // 2, 1] = 0.0
        with pytest.raises(SingularError, match="can move without any inertia"):
            dyn.forward_dynamics(mech, q, 0 * q, [1.0, 0.0])

    @each("count", [1, 300])
    @each("bend", [1e-7, -1e-8, np.pi - 1e-7])
    @each("carrier", ["", "  - {name: arm, m: 2, l: 1, r: 0.4, I: 0.1}\n"])
    def test_nearly_singular_at_one_configuration(self, count, bend, carrier):
        """Two massless rods with a payload, alone or on an arm: refused in a batch as alone."""
        mech = mechanism(
            f"links:\n{carrier}"
            "  - {name: first, m: 0, l: 1, r: 0, I: 0}\n"
            "  - {name: second, m: 0, l: 1, r: 0, I: 0, payload: 1.3}\n"
        )
        q = np.full((count, mech.n), 0.4)
        q[:, -1] = np.linspace(0.5, 2.0, count)
        found = dyn.forward_dynamics(mech, q, 0 * q, 0 * q)
        assert_close(found[0], dyn.forward_dynamics(mech, q[0], 0 * q[0], 0 * q[0]), 100.0)
        q[count // 2, -1] = bend
        with pytest.raises(SingularError, match="can move without any inertia"):
            dyn.forward_dynamics(mech, q, 0 * q, 0 * q)

    @pytest.mark.parametrize("count", [1, 300])
    def test_links_that_do_not_touch_are_judged_by_themselves(self, count):
        """A heavy link beside a light one, and beside a loop whose freedoms are light."""
        heavy = "{name: heavy, m: 0, l: 1, r: 0, I: 1e12}"
        light = "{name: light, m: 5e-4, l: 1, r: 1, I: 0, from: [0, 0]}"
        mech = mechanism(f"links: [{heavy}, {light}]\n")
        q = np.zeros((count, 2))
        found = dyn.forward_dynamics(mech, q, q, [1.0, 1.0])
        assert_close(found * [1e12, 5e-4], np.ones((count, 2)), 1.0, 1e-12)

        def four_bar(before):
            numbers = [("0.35", "[3, 0]"), ("0.95", "crank"), ("0.8", "[4.1, 0]")]
            names = ("crank", "coupler", "rocker")
            bars = [
                f"{{name: {name}, m: 0.001, l: {l}, r: 0.2, I: 1e-4, from: {place}}}"
                for name, (l, place) in zip(names, numbers, strict=True)
            ]
            return mechanism(
                f"links: [{', '.join([*before, *bars])}]\n"
                f"closures: [[coupler, rocker]]\nactuated: [{'heavy, ' * bool(before)}crank]\n"
            )

        q = np.tile(robodyn.assemble(four_bar([]), [1.0]), (count, 1))
        alone = dyn.forward_dynamics(four_bar([]), q, 0 * q, [1.0])
        q = np.column_stack([np.zeros(count), q])
        found = dyn.forward_dynamics(four_bar([heavy]), q, 0 * q, [1.0, 1.0])
        assert_close(found[:, 1:], alone, np.abs(alone).max(), 1e-12)
        assert_close(found[:, 0] * 1e12, np.ones(count), 1.0, 1e-12)

    def test_inverse_dynamics_needs_no_mass_at_all(self):
        mech = mechanism("links: [{name: wire, m: 0, l: 1, r: 0, I: 0, damping: 2}]")
        assert dyn.inverse_dynamics(mech, [1.0], [3.0], [5.0]).tolist() == [6.0]


class TestRedundantClosures:
    """A parallelogram with a third parallel crank: one freedom, four closure rows of rank three.

    With k = dq/dtheta = (1, -1, 1, 1), constant: k^T M k thetadd + k^T (C qd + G) = tau1.
    """

    K = np.array([1.0, -1.0, 1.0, 1.0])
    pytestmark = pytest.mark.filterwarnings("ignore::robodyn.dynamics.dynamics.RobodynWarning")

    def reduced(self, theta, speed):
        mech = mechanism(THREE_CRANKS_YAML)
        q, qd = theta * self.K, speed * self.K
        M, C, G = oracles.mp_terms(oracle_tree(mech.description), mech.gamma, q, qd)
        load = self.K @ (C @ qd + G)
        return mech, q, qd, float(self.K @ M @ self.K), float(load)

    @pytest.mark.parametrize("theta", [0.7, -2.0, 1.57])
    def test_accelerations(self, theta):
        mech, q, qd, inertia, load = self.reduced(theta, 4.0)
        motion = dyn.forward_dynamics_and_forces(mech, q, qd, [2.0, 0.0, 0.0, 0.0])
        expected = (2.0 - load) / inertia
        assert_close(motion.qdd, expected * self.K, abs(expected), 1e-12)

    @pytest.mark.parametrize("theta", [0.7, -2.0, 1.57])
    def test_torque(self, theta):
        mech, q, qd, inertia, load = self.reduced(theta, 4.0)
        tau = dyn.inverse_dynamics(mech, q, qd, 9.0 * self.K)
        expected = inertia * 9.0 + load
        assert_close(tau, [expected, 0.0, 0.0, 0.0], abs(expected), 1e-12)

    def test_pin_forces_balance_and_are_the_least(self):
        """M qdd + C qd + G = tau + Psi^T lambda with the lambda that has no part in null(Psi^T)."""
        mech, q, qd, _, _ = self.reduced(0.7, 4.0)
        tau = np.array([2.0, 0.0, 0.0, 0.0])
        qdd, lam = dyn.forward_dynamics_and_forces(mech, q, qd, tau)[:2]
        Psi = closures.closure_jacobian(mech, q, t=0.0)
        load = dense_dynamics.required_load(mech, q, qd, qdd)
        assert_close(load, tau + Psi.T @ lam, np.abs(lam).max(), 1e-12)
        U, s, _ = np.linalg.svd(Psi)
        assert s[3] < 1e-15 * s[0]
        assert_close(U[:, 3] @ lam, 0.0, np.abs(lam).max(), 1e-12)

    def test_pin_forces_that_are_not_unique_come_with_a_warning(self):
        mech, q, qd, _, _ = self.reduced(0.7, 4.0)
        with pytest.warns(dyn.RobodynWarning):
            dyn.forward_dynamics_and_forces(mech, q, qd, [2.0, 0.0, 0.0, 0.0])

    def test_in_a_batch(self):
        mech = mechanism(THREE_CRANKS_YAML)
        theta = np.linspace(0.2, 2.9, 250)[:, None]
        q, qd, tau = theta * self.K, 4.0 * self.K, np.array([2.0, 0.0, 0.0, 0.0])
        qdd = dyn.forward_dynamics(mech, q, qd, tau)
        alone = np.array([dyn.forward_dynamics(mech, state, qd, tau) for state in q])
        assert_close(qdd, alone, np.abs(alone).max(), 1e-12)
        back = dyn.inverse_dynamics(mech, q, qd, qdd)
        assert_close(back, np.broadcast_to(tau, back.shape), 20.0, 1e-11)


class TestActuation:
    @staticmethod
    def driven(shape, *actuated):
        return Shape(shape.parents, shape.closures, shape.sliders, actuated)

    @pytest.mark.parametrize("name", ["four-bar", "five-bar", "slider-crank", "loop in a tree"])
    @pytest.mark.parametrize("count", [1, 250])
    def test_more_actuators_than_freedoms_share_the_load(self, name, count):
        """Of all tau with N^T S tau = N^T load (N the null space of Psi) the shortest."""
        scene = seeded_scene(2, LOOPS[name])
        text = scene.text.replace("actuated: [", "actuated: [link1, ")
        mech = mechanism(text)
        states = tuple(np.tile(state, (count, 1)) for state in scene.states)
        with pytest.warns(dyn.RobodynWarning, match="least norm"):
            found = dyn.inverse_dynamics_and_forces(mech, *states)

        load = dense_dynamics.required_load(mech, *scene.states)
        Psi = closures.closure_jacobian(mech, scene.q, t=0.0)
        N = np.linalg.svd(Psi)[2][len(mech.rows) :].T
        driven = list(mech.actuated)
        least = np.linalg.lstsq(N[driven].T, N.T @ load)[0]
        assert_close(found.tau[-1, driven], least, np.abs(load).max(), 1e-11)
        balance = found.tau[-1] + Psi.T @ found.multipliers[-1]
        assert_close(balance, load, np.abs(load).max(), 1e-11)

    def test_the_exact_number_of_actuators_does_not_warn(self):
        scene = seeded_scene(2, LOOPS["five-bar"])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            dyn.inverse_dynamics(scene.mechanism, *scene.states)

    @pytest.mark.parametrize("count", [1, 250])
    def test_fewer_actuators_name_the_free_joint(self, count):
        scene = seeded_scene(2, self.driven(LOOPS["five-bar"], 0, 2))
        mech = mechanism(scene.text.replace("actuated: [link0, link2]", "actuated: [link0]"))
        states = [np.tile(state, (count, 1)) for state in scene.states]
        with pytest.raises(ResidualError, match=r"residual[234] = .* as joint link[123] is free"):
            dyn.inverse_dynamics(mech, *states)

    @pytest.mark.parametrize("count", [1, 250])
    def test_a_motion_of_fewer_actuators_than_freedoms(self, count):
        """A five-bar driven at one crank: torques come back from the accelerations they cause."""
        scene = seeded_scene(2, self.driven(LOOPS["five-bar"], 0, 2))
        mech = mechanism(scene.text.replace("actuated: [link0, link2]", "actuated: [link0]"))
        q, qd, _ = (np.tile(state, (count, 1)) for state in scene.states)
        tau = np.random.default_rng(1).normal(size=(len(q), 1))
        caused = dyn.forward_dynamics_and_forces(mech, q, qd, tau)
        found = dyn.inverse_dynamics_and_forces(mech, q, qd, caused.qdd)
        size = np.abs(dyn.required_load(mech, q, qd, caused.qdd)).max()
        assert_close(found.tau[:, :1], tau, size, 1e-11)
        assert not found.tau[:, 1:].any()
        assert_close(found.multipliers, caused.multipliers, size, 1e-10)
        left = dyn.inverse_dynamics(mech, q, qd, caused.qdd, residual=True)[:, 1:]
        assert np.abs(left).max() < 1e-11 * size

    def test_the_residual_of_a_loop_on_a_free_cart(self):
        """It is the horizontal force that the rail would have to give: the sum of m xdd."""
        mech = mechanism(
            """
gravity: 9.81
links:
  - {name: cart, joint: prismatic, axis: [1, 0], m: 2, l: 0, r: 0, I: 0}
  - {name: crank, m: 0.5, l: 0.35, r: 0.15, I: 0.01, from: cart}
  - {name: coupler, m: 0.8, l: 0.95, r: [0.4, 0.1], I: 0.06}
  - {name: rocker, m: 0.6, l: 0.8, r: 0.35, I: 0.03, from: "cart@1.1,0"}
closures: [[coupler, rocker]]
actuated: [crank]
"""
        )
        both = dataclasses.replace(mech, actuated=(0, 1))
        q = closing.close_positions(mech, np.array([0.2, 1.0, -0.7, 1.2]), t=0.0)
        qd = loop_rates.loop_velocities(both, q, [0.5, 2.0], t=0.0)
        qdd = loop_rates.loop_accelerations(both, q, qd, [1.5, -3.0], t=0.0)
        of = ["cart@0,0", "crank@0.15,0", "coupler@0.4,0.1", "rocker@0.35,0"]
        across = robodyn.points(mech, q, qd, qdd, of).acceleration[:, 0]
        tau = dyn.inverse_dynamics(mech, q, qd, qdd, residual=True)
        assert tau[0] == pytest.approx(across @ [2.0, 0.5, 0.8, 0.6], rel=1e-12)
        assert not tau[2:].any()
        with pytest.raises(ResidualError, match=rf"residual1 = {tau[0]:.6g} N: .*joint cart"):
            dyn.inverse_dynamics(mech, q, qd, qdd)

    @pytest.mark.parametrize(
        ("friction", "q", "holds"),
        [
            ("friction: {torque: 1, static: 2}", -1.2, True),  # 4.905 cos 1.2 = 1.78 N m
            ("friction: {torque: 1, static: 1.5}", -1.2, False),
            ("limits: {min: -1.2, restitution: 0}", -1.2, True),
            ("limits: {max: -1.2, restitution: 0}", -1.2, False),
            ("limits: {min: -1.3, restitution: 0}", -1.2, False),
        ],
    )
    def test_what_holds_a_free_joint_at_rest_is_no_residual(self, friction, q, holds):
        links = f"links: [{{name: a, m: 1, l: 1, r: 0.5, I: 0.1, {friction}}}]\n"
        mech = mechanism(f"gravity: 9.81\n{links}actuated: []\n")
        if holds:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of friction at rest
                assert dyn.inverse_dynamics(mech, [q], [0.0], [0.0]) == [0.0]
            return
        with pytest.raises(ResidualError, match=r"residual1 = 1\.77"):
            dyn.inverse_dynamics(mech, [q], [0.0], [0.0])

    def test_the_slopes_of_a_motion_of_fewer_actuators(self):
        """Those of the actuated joint's torque with the free joint's motion given as well."""
        mech = mechanism(TWO_LINK_YAML + "actuated: [upper arm]")
        state = [0.1, 0.2], [1.0, 2.0]
        qdd = dyn.forward_dynamics(mech, *state, [3.0])
        found = robodyn.inverse_dynamics_derivatives(mech, *state, qdd)
        whole = robodyn.inverse_dynamics_derivatives(mechanism(TWO_LINK_YAML), *state, qdd)
        assert found.tau == pytest.approx([3.0, 0.0], rel=1e-12)
        for few, every in zip(found[1:4], whole[1:4], strict=True):
            assert few[0] == pytest.approx(every[0], rel=1e-14)
            assert not few[1].any()

    def test_an_arm_with_a_passive_shoulder_names_it(self):
        mech = mechanism(TWO_LINK_YAML + "actuated: [forearm]")
        with pytest.raises(ResidualError, match=r"residual1 = .* joint upper arm is free"):
            dyn.inverse_dynamics(mech, [0.1, 0.2], [0.0, 0.0], [0.0, 0.0])

    def test_a_pendulum_on_a_loop_with_too_many_actuators_is_still_free(self):
        """Four-bar driven twice and a passive pendulum on its coupler: the numbers hide it."""
        scene = seeded_scene(2, LOOPS["loop in a tree"])
        mech = mechanism(scene.text.replace("[link0, link2, link3]", "[link0, link1, link2]"))
        with pytest.raises(RobodynError, match=r"joint q4 \(link3\) is free"):
            dyn.inverse_dynamics(mech, *scene.states)

    def test_a_passive_joint_of_an_open_chain_moves_freely(self):
        """Forward dynamics asks for no actuators: the acrobot falls as the 2R arm does."""
        states = [0.1, 0.2], [1.0, 2.0], [0.0, 3.0]
        expected = oracles.two_link_acceleration(TWO_LINK, *states[:2], np.array(states[2]))
        mech = mechanism(TWO_LINK_YAML + "actuated: [forearm]")
        assert_close(dyn.forward_dynamics(mech, *states), expected, np.abs(expected).max(), 1e-12)

    def test_dead_centre(self):
        """The rocker cannot drive the crank where crank and coupler lie in line."""
        mech = mechanism(FOUR_BAR_YAML.replace("0.07", "0") + "actuated: [rocker]")
        rocker = np.arccos((1.3**2 - 1.1**2 - 0.8**2) / (2 * 1.1 * 0.8))
        q = robodyn.assemble(mech, [rocker])
        k = np.linalg.svd(closures.closure_jacobian(mech, q, t=0.0))[2][
            2
        ]  # the motion possible here
        assert abs(k[2]) < 1e-7
        with pytest.raises(SingularError, match=r"dead centre.*\((crank|coupler)\) is free here"):
            dyn.inverse_dynamics(mech, q, [0.0] * 3, 10.0 * k)

    @pytest.mark.parametrize("count", [1, 300])
    @pytest.mark.parametrize("falling", [False, True])
    def test_a_balanced_load_at_a_dead_centre_warns(self, count, falling):
        """At rest without gravity, or falling freely: any torque of the rocker would do."""
        text = FOUR_BAR_YAML.replace("0.07", "0").replace("9.81", "9.81" if falling else "0")
        mech = mechanism(text + "actuated: [rocker]")
        rocker = np.arccos((1.3**2 - 1.1**2 - 0.8**2) / (2 * 1.1 * 0.8))
        angles = rocker + np.linspace(0.3, 0.0, count)[:, None]
        angles[-1] = rocker
        q = robodyn.assemble(mech, angles)
        k = np.linalg.svd(closures.closure_jacobian(mech, q, t=0.0))[2][:, 2]  # the motion possible
        M, G = cf.mass_matrix(mech, q), cf.gravity_vector(mech, q)
        k_G, k_M_k = (k * G).sum(-1), np.einsum("ti,tij,tj->t", k, M, k)
        qdd = -k * (k_G / k_M_k)[:, None]
        with pytest.warns(dyn.RobodynWarning, match="dead centre.*torques of least norm"):
            found = dyn.inverse_dynamics(mech, q, np.zeros(3), qdd)
        assert_close(found, np.zeros_like(q), 1.0, 1e-9)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            dyn.inverse_dynamics(mech, q[:-1], np.zeros(3), qdd[:-1])

    def test_the_torque_at_a_balanced_change_point_is_the_only_one(self):
        """A parallelogram in line without gravity, at rest: two freedoms, and the crank drives."""
        mech = mechanism(PARALLELOGRAM_YAML.replace("9.81", "0"))
        with pytest.warns(dyn.RobodynWarning, match="^the closures depend on one another"):
            tau = dyn.inverse_dynamics(mech, [0.0] * 3, [0.0] * 3, [0.0] * 3)
        assert tau.tolist() == [0.0, 0.0, 0.0]

    @pytest.mark.parametrize("count", [1, 300])
    def test_change_point(self, count):
        """All links in line: the crank alone cannot hold the second freedom."""
        mech = mechanism(PARALLELOGRAM_YAML)
        q = np.linspace(0.3, 1.2, count)[:, None] * [1.0, -1.0, 1.0]
        q[-1] = 0.0
        with pytest.raises(SingularError, match="change point"):
            dyn.inverse_dynamics(mech, q, [0.0] * 3, [0.0] * 3)


LINKS = "gravity: 9.81\nlinks:\n" + "".join(
    f"  - {{name: {name}, m: 1, l: 1, r: 0.5, I: 0.1}}\n" for name in "abc"
)
HUBS = LINKS.replace("l: 1, r: 0.5", "l: 0, r: 0")
# what the formulas divide by is zero at every state: a text of the scene, and a closed q
ZERO_EVERYWHERE = {
    "a slider that holds the actuated link": (
        LINKS + "closures: [{point: a, on: {through: [0, 1], along: [1, 1]}}]\nactuated: [a, c]\n",
        [np.pi, 0.5, 0.3],
    ),
    "two sliders that hold the actuated link": (
        LINKS + "closures: [{point: a, on: {through: [0, 1], along: [1, 1]}},"
        " {point: a, on: {through: [-1, 0], along: [1, 1]}}]\nactuated: [a]\n",
        [np.pi, 0.5, 0.3],
    ),
    "a pin that holds the actuated link": (
        LINKS + "closures: [[a, [-1, 0]]]\nactuated: [a]\n",
        [np.pi, 0.5, 0.3],
    ),
    "couplings that say the same": (
        LINKS + "couplings: [q1 = 2 q2, q2 = 0.5 q1]\nactuated: [a, c]\n",
        [1.0, 0.5, 0.3],
    ),
    "couplings of hubs that say the same": (
        HUBS + "couplings: [q1 = 2 q2, q2 = 0.5 q1]\nactuated: [a, c]\n",
        [1.0, 0.5, 0.3],
    ),
    "a spring that is never stretched": (
        HUBS + "springs: [{between: [a, [0, 0]], stiffness: 1, length: 0.1}]\n",
        [1.0, 0.5, 0.3],
    ),
    "a damper between equal points": (
        HUBS + "springs: [{between: [a, [0, 0]], stiffness: 0, length: 0, damping: 1}]\n",
        [1.0, 0.5, 0.3],
    ),
}


@pytest.mark.filterwarnings("ignore::robodyn.dynamics.dynamics.RobodynWarning")
@pytest.mark.parametrize(("text", "q"), ZERO_EVERYWHERE.values(), ids=ZERO_EVERYWHERE)
class TestZeroEverywhere:
    """Where no formula can be written the numpy evaluators answer, for one state and for many."""

    @each("function", [dyn.inverse_dynamics, dyn.forward_dynamics])
    def test_a_batch_gives_what_one_state_gives(self, function, text, q):
        mech = mechanism(text)
        many = np.tile(q, (dyn.BATCH, 1))
        try:
            alone = function(mech, q, [0.0] * 3, [0.0] * 3)
        except SingularError as error:
            with pytest.raises(SingularError, match=f"^{re.escape(str(error))}$"):
                function(mech, many, 0.0 * many, 0.0 * many)
        else:
            found = function(mech, many, 0.0 * many, 0.0 * many)
            assert found == pytest.approx(np.tile(alone, (dyn.BATCH, 1)), abs=1e-12)

    def test_a_run_starts(self, text, q):
        mech = mechanism(text)
        if mech.of(PointSpring):
            with pytest.raises(SingularError, match="coincide"):
                robodyn.simulate(mech, q, [0.0] * 3, t_end=0.01, method="DOP853")
        else:
            motion = robodyn.simulate(mech, q, [0.0] * 3, t_end=0.01, method="DOP853")
            assert motion.report.outcome == "finished"


class TestBatch:
    """From BATCH states on generated array code runs; it must give what single states give."""

    @EACH_LOOP
    def test_loops(self, name):
        scene = seeded_scene(1, LOOPS[name])
        mech, states = scene.mechanism, neighbours(scene, dyn.BATCH + 50)
        for function in (dyn.inverse_dynamics_and_forces, dyn.forward_dynamics_and_forces):
            together = function(mech, *states)[:2]
            some = one_by_one(function, mech, [part[::6] for part in states])
            for found, alone in zip(together, some, strict=True):
                size = np.abs(alone).max(axis=-1, keepdims=True)
                assert_close(found[::6] / size, alone / size, 1.0, 1e-12)

    @settings(deadline=None, max_examples=25)
    @given(trees(most=7))
    def test_trees(self, scene):
        mech, (q, qd, qdd) = scene.mechanism, neighbours(scene, dyn.BATCH)
        size = sizes(mech.description).torque(np.abs(qd).max(axis=0), np.abs(qdd).max(axis=0))
        tau, some = dyn.inverse_dynamics(mech, q, qd, qdd), slice(None, None, 6)
        alone, _ = one_by_one(dyn.inverse_dynamics_and_forces, mech, (q[some], qd[some], qdd[some]))
        assert_close(tau[some], alone, size)
        least = np.linalg.eigvalsh(cf.mass_matrix(mech, q))[:, 0].min()
        found = dyn.forward_dynamics(mech, q, qd, tau)
        alone, _ = one_by_one(dyn.forward_dynamics_and_forces, mech, (q[some], qd[some], tau[some]))
        assert_close(found[some], alone, size / least)

    @pytest.mark.filterwarnings("ignore::robodyn.dynamics.dynamics.RobodynWarning")
    @pytest.mark.parametrize("angle", [1e-2, 1e-4, 1e-6, 1e-9, 0.0])
    def test_states_near_a_change_point(self, angle):
        """Among good states one near, or at, the change point of a parallelogram."""
        mech, k = mechanism(PARALLELOGRAM_YAML), np.array([1.0, -1.0, 1.0])
        q = np.linspace(0.4, 1.3, dyn.BATCH + 1)[:, None] * k
        q[77] = angle * k
        qd, tau = np.tile(5.0 * k, (len(q), 1)), np.tile([2.0, 0.0, 0.0], (len(q), 1))
        together = dyn.forward_dynamics_and_forces(mech, q, qd, tau)[:2]
        alone = one_by_one(dyn.forward_dynamics_and_forces, mech, (q, qd, tau))
        for found, expected in zip(together, alone, strict=True):
            size = np.abs(expected).max(axis=-1, keepdims=True)
            assert_close(found / size, expected / size, 1.0, 1e-12)

    def test_states_near_a_change_point_are_right(self):
        """k^T M k thetadd + k^T (C qd + G) = tau1 with k = (1, -1, 1), at 30 digits."""
        mech, k = mechanism(PARALLELOGRAM_YAML), np.array([1.0, -1.0, 1.0])
        for angle in (1e-2, 1e-4, 1e-6):
            q, qd, tau = angle * k, 5.0 * k, [2.0, 0.0, 0.0]
            M, C, G = oracles.mp_terms(oracle_tree(mech.description), mech.gamma, q, qd)
            expected = float((2.0 - k @ (C @ qd + G)) / (k @ M @ k))
            for count in (1, dyn.BATCH):
                qdd = dyn.forward_dynamics(mech, np.tile(q, (count, 1)), qd, tau)
                assert_close(qdd[0], expected * k, abs(expected), 1e-14 / angle)

    def test_states_near_a_dead_centre(self):
        """Inverse dynamics where the rocker hardly moves the crank; the state is made closed."""
        mech = mechanism(FOUR_BAR_YAML.replace("0.07", "0") + "actuated: [rocker]")
        limit = np.arccos((1.3**2 - 1.1**2 - 0.8**2) / (2 * 1.1 * 0.8))
        rocker = limit + np.geomspace(1e-12, 0.3, dyn.BATCH)
        q = robodyn.assemble(mech, rocker[:, None])
        p = FOUR_BAR._replace(e=0.0)
        k = np.array([oracles.four_bar_coefficients(p, state)[0] for state in q])
        states = q, k, np.zeros_like(q)
        together = dyn.inverse_dynamics_and_forces(mech, *states)[:2]
        alone = one_by_one(dyn.inverse_dynamics_and_forces, mech, states)
        for found, expected in zip(together, alone, strict=True):
            size = np.abs(expected).max(axis=-1, keepdims=True)
            conditioned = np.abs(k).max(axis=-1, keepdims=True) / np.abs(k[:, 2:])
            assert_close(found / size / conditioned, expected / size / conditioned, 1.0, 1e-12)

    @pytest.mark.parametrize("count", [dyn.BATCH - 1, dyn.BATCH, 8193, 70_000])
    def test_sizes_of_batches(self, count):
        """Below and at the threshold, beyond one block, and shared among threads."""
        rng = np.random.default_rng(0)
        q, qd, qdd = rng.normal(size=(3, count, 2)) * [[[2.0]], [[5.0]], [[20.0]]]
        mech = mechanism(TWO_LINK_YAML)
        tau = dyn.inverse_dynamics(mech, q, qd, qdd)
        assert_close(tau, dense_dynamics.required_load(mech, q, qd, qdd), 500.0)
        for i in (0, count // 2, count - 1):
            expected = oracles.two_link_torque(TWO_LINK, q[i], qd[i], qdd[i])
            assert_close(tau[i], expected, 500.0)
        assert_close(dyn.forward_dynamics(mech, q, qd, tau), qdd, 5e4)

    def test_more_links_than_code_is_generated_for(self):
        n = formulas.MAX_GENERATED + 1
        scene = seeded_scene(0, Shape((None, *range(n - 1))))
        states = neighbours(scene, dyn.BATCH)
        tau = dyn.inverse_dynamics(scene.mechanism, *states)
        tree, gamma = oracle_tree(scene.mechanism.description), scene.mechanism.gamma
        state = [part[5] for part in states]
        expected = oracles.newton_euler(tree, gamma, *state) + state[1] * scene.mechanism.damping
        assert_close(tau[5], expected, sizes(scene.mechanism.description).torque(*state[1:]))

    def test_arrays_in_any_layout_and_untouched(self):
        scene = seeded_scene(1, LOOPS["four-bar"])
        states = neighbours(scene, 300)
        odd = [np.asfortranarray(states[0]), states[1][::-1][::-1], np.array(states[2])]
        copies = [state.copy() for state in odd]
        expected = dyn.inverse_dynamics(scene.mechanism, *states)
        assert np.array_equal(dyn.inverse_dynamics(scene.mechanism, *odd), expected)
        for state, copy in zip(odd, copies, strict=True):
            assert np.array_equal(state, copy)


class TestBroadcasting:
    FUNCTIONS = pytest.mark.parametrize(
        "function", [dyn.inverse_dynamics_and_forces, dyn.forward_dynamics_and_forces]
    )
    SCENES = pytest.mark.parametrize(
        "scene",
        [seeded_tree(1, 3), seeded_scene(1, LOOPS["four-bar"])],
        ids=["tree", "four-bar"],
    )

    @FUNCTIONS
    @SCENES
    @pytest.mark.parametrize("count", [5, 300])
    def test_one_configuration_many_rates(self, function, scene, count):
        mech, (_, qd, _) = scene.mechanism, neighbours(scene, count)
        found = function(mech, scene.q, qd, scene.qdd)[:2]
        alone = one_by_one(lambda mech, rate: function(mech, scene.q, rate, scene.qdd), mech, [qd])
        for part, expected in zip(found, alone, strict=True):
            assert_close(part, expected, np.abs(expected).max(initial=1.0), 1e-12)

    @FUNCTIONS
    @SCENES
    @each("shape", [(), (1,), (0,), (4, 0), (2, 3), (20, 15)])
    def test_leading_axes(self, function, scene, shape):
        mech, count = scene.mechanism, int(np.prod(shape))
        states = neighbours(scene, max(count, 1))
        flat = function(mech, *states)[:2]
        shaped = function(mech, *(state[:count].reshape(*shape, 3) for state in states))[:2]
        for part, expected in zip(shaped, flat, strict=True):
            wanted = expected[:count].reshape(*shape, expected.shape[-1])
            assert_close(part, wanted, np.abs(expected).max(initial=1.0), 1e-13)

    @FUNCTIONS
    @pytest.mark.parametrize(
        ("q", "qd", "qdd", "place"),
        [
            ([0.0, 0.0, 0.0], [0.0] * 2, [0.0] * 2, r"q\.shape = \(3,\)"),
            ([0.0, 0.0], [0.0, np.nan], [0.0] * 2, r"qd\[1\] = nan: must be finite"),
            (np.zeros((3, 2)), [0.0] * 2, np.zeros((3, 1)), r"(qdd|tau)\.shape = \(3, 1\)"),
            (np.zeros((3, 2)), np.zeros((4, 2)), [0.0] * 2, r"shape"),
        ],
    )
    def test_arrays_that_do_not_fit_are_input_errors(self, function, q, qd, qdd, place):
        with pytest.raises(InputError, match=place):
            function(mechanism(TWO_LINK_YAML), q, qd, qdd)


def test_torque_at_a_dead_centre_is_refused():
    """The rod square to the slider's line: the crank moves, the piston cannot move the crank."""
    q = [0.7297276562269663, -2.300523983021863]
    mech = mechanism(
        "gravity: 9.81\nlinks:\n"
        "  - {name: crank, m: 0.8, l: 0.3, r: 0.13, I: 0.007}\n"
        "  - {name: rod, m: 0.5, l: 0.2, r: 0.09, I: 0.002, payload: 0.7}\n"
        "closures:\n  - {point: rod, on: {through: [0, 0], along: [1, 0]}}\n"
    )
    with pytest.raises(SingularError, match="dead centre"):
        dyn.inverse_dynamics(mech, q, [0, 0], [0, 1])


class TestChangePoint:
    """The parallelogram in line moves on as one link of inertia I1 + I3 + m2 l^2."""

    BRANCH = np.array([1.0, -1.0, 1.0])

    def states(self, count):
        mech = robodyn.load(ROOT / "robots/parallelogram.yaml")
        theta = np.linspace(-0.2, 0.2, count)[:, None]
        return mech, theta * self.BRANCH, np.full_like(theta, 3.0) * self.BRANCH

    def exact(self, mech, theta, tau):
        crank, coupler, rocker = mech.description.links
        inertia = sum(x.I + x.m * abs(x.r) ** 2 for x in (crank, rocker)) + coupler.m * crank.l**2
        weight = (crank.m * crank.r + rocker.m * rocker.r + coupler.m * crank.l).real
        return (tau - 9.81 * weight * np.cos(theta)) / inertia

    @pytest.mark.filterwarnings("ignore::UserWarning")
    @pytest.mark.parametrize("count", [1, 21, 401])
    def test_forward_and_inverse_dynamics(self, count):
        mech, q, qd = self.states(count)
        tau = np.array([0.7, 0.0, 0.0])
        found = robodyn.forward_dynamics(mech, q, qd, tau)
        expected = self.exact(mech, q[:, :1], 0.7) * self.BRANCH
        assert found == pytest.approx(expected, rel=1e-10)
        again = robodyn.inverse_dynamics(mech, q, qd, expected)
        assert again == pytest.approx(np.broadcast_to(tau, again.shape), abs=1e-10)

    @pytest.mark.filterwarnings("ignore::UserWarning")
    @pytest.mark.parametrize("d", [0.0, 1e-13, 1e-10, 1e-7, 1e-4, 1e-2])
    def test_at_any_distance(self, d):
        mech, _, _ = self.states(1)
        q, qd = d * self.BRANCH, 3.0 * self.BRANCH
        expected = self.exact(mech, d, 0.7) * self.BRANCH
        found = robodyn.forward_dynamics(mech, q, qd, [0.7, 0.0, 0.0])
        assert found == pytest.approx(expected, rel=1e-10)
        assert robodyn.inverse_dynamics(mech, q, qd, found) == pytest.approx([0.7, 0, 0], abs=1e-10)


def test_a_state_whose_results_leave_the_floats_is_named() -> None:
    """An error in place of nan and numpy's warnings, of single states and of many."""
    arm, loop = (robodyn.load(ROOT / f"robots/{name}.yaml") for name in ("2r", "four-bar"))
    q = robodyn.assemble(loop, [1.0])
    ones = np.ones(2)
    at_states = (robodyn.inverse_dynamics, robodyn.forward_dynamics, robodyn.shaking_force)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for function in at_states:
            with pytest.raises(RobodynError, match=r"qd\[1\] = 1e\+300: is too large"):
                function(arm, ones, [1.0, 1e300], ones)
            with pytest.raises(RobodynError, match=r"qd\[\d\] = .*e\+300: is too large"):
                function(loop, q, robodyn.loop_velocities(loop, q, [1e300]), 0.0 * q)
        many = np.ones((300, 2))
        many[299, 0] = -1e200
        with pytest.raises(RobodynError, match=r"qd\[299, 0\] = -1e\+200: is too large"):
            robodyn.kinetic_energy(arm, many, many)
        with pytest.raises(RobodynError, match=r"qdd\[0\] = 1e\+308: is too large"):
            robodyn.inverse_dynamics(arm, ones, ones, qdd=[1e308, 1e308])
        assert np.isfinite(robodyn.inverse_dynamics(arm, ones, 1e100 * ones, ones)).all()
