"""The identities that every mechanism must keep (DESIGN section 7), on random trees and loops.

And the package's own self-test: it holds on every example, and finds fault with a wrong model.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from conftest import FRESH
from hypothesis import given, settings
from scipy.integrate import solve_ivp

import oracles
from random_mechanisms import (
    LOOPS,
    Shape,
    assert_close,
    exchanged,
    loops,
    oracle_tree,
    seeded_scene,
    seeded_tree,
    sizes,
    trees,
)
from robodyn.dynamics import closed_form as cf
from robodyn.dynamics import dynamics as dyn
from robodyn.dynamics import identities as selftest
from robodyn.elements.springs import JointDamper
from robodyn.loops import closures
from robodyn.mechanics.mechanism import load

ROBOTS = sorted((Path(__file__).parent.parent / "robots").glob("*.yaml"))
examples = settings(deadline=None, max_examples=60 if FRESH else 25)


def derivative(function, speed):
    """d function(s)/ds at s = 0, by central differences of sixth order; `speed` rad per unit."""
    h = 5e-3 / (1.0 + speed)
    odd = [function(k * h) - function(-k * h) for k in (1, 2, 3)]
    return (45.0 * odd[0] - 9.0 * odd[1] + odd[2]) / (60.0 * h)


def speed_of(scene):
    return float(np.abs(scene.qd).sum())


class TestMassMatrix:
    @examples
    @given(trees(most=7))
    def test_is_symmetric_and_positive_definite(self, scene):
        mech, size = scene.mechanism, sizes(scene.mechanism.description).inertia
        M = cf.mass_matrix(mech, scene.q)
        assert_close(M, M.T, size, 1e-15)
        assert np.linalg.eigvalsh(M)[0] > 0.0

    @examples
    @given(trees(most=7))
    def test_makes_the_kinetic_energy_of_the_bodies(self, scene):
        """KE = 1/2 qd^T M qd = sum_b 1/2 m_b |v_b|^2 + 1/2 I_b w_b^2, v_b by differences."""
        mech = scene.mechanism
        size = sizes(mech.description).inertia * speed_of(scene) ** 2
        KE = cf.kinetic_energy(mech, scene.q, scene.qd)
        M = cf.mass_matrix(mech, scene.q)
        assert_close(KE, 0.5 * scene.qd @ M @ scene.qd, size)

        def velocities(points):
            def positions(s):
                return cf.point_motion(mech, points, scene.q + s * scene.qd)[0]

            return derivative(positions, speed_of(scene))

        links = mech.description.links
        m, I, payload = ([getattr(link, key) for link in links] for key in ("m", "I", "payload"))
        bodies = 0.5 * (
            m @ (velocities(mech.centres) ** 2).sum(axis=1)
            + payload @ (velocities(mech.tips) ** 2).sum(axis=1)
            + I @ cf.absolute_rates(mech, scene.qd) ** 2
        )
        assert_close(KE, bodies, size, 1e-10)


class TestCoriolis:
    @examples
    @given(trees(most=7))
    def test_mdot_less_two_c_is_skew_symmetric(self, scene):
        mech, speed = scene.mechanism, speed_of(scene)
        Mdot = derivative(lambda s: cf.mass_matrix(mech, scene.q + s * scene.qd), speed)
        C = cf.coriolis_matrix(mech, scene.q, scene.qd)
        skew = Mdot - 2.0 * C
        assert_close(skew, -skew.T, sizes(mech.description).inertia * (1.0 + speed), 1e-10)

    @examples
    @given(trees(most=5))
    def test_is_made_of_christoffel_symbols(self, scene):
        """C_ij = sum_k 1/2 (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i) qd_k."""
        mech, axes = scene.mechanism, np.eye(scene.n)
        dM = np.array(
            [derivative(lambda s, e=e: cf.mass_matrix(mech, scene.q + s * e), 1.0) for e in axes]
        )  # (k, i, j)
        C = 0.5 * (
            np.einsum("kij,k->ij", dM, scene.qd)
            + np.einsum("jik,k->ij", dM, scene.qd)
            - np.einsum("ijk,k->ij", dM, scene.qd)
        )
        size = sizes(mech.description).coriolis(scene.qd)
        assert_close(cf.coriolis_matrix(mech, scene.q, scene.qd), C, size, 1e-10)

    @examples
    @given(trees(most=5))
    def test_is_linear_in_the_rates(self, scene):
        mech, other = scene.mechanism, scene.qdd
        C = cf.coriolis_matrix(mech, scene.q, 2.0 * scene.qd - other)
        parts = 2.0 * cf.coriolis_matrix(mech, scene.q, scene.qd) - cf.coriolis_matrix(
            mech, scene.q, other
        )
        size = sizes(mech.description).coriolis(2.0 * np.abs(scene.qd) + np.abs(other))
        assert_close(C, parts, size)


class TestGravity:
    @examples
    @given(trees(most=7))
    def test_is_the_gradient_of_the_potential_energy(self, scene):
        mech = scene.mechanism
        gradient = [
            derivative(lambda s, e=e: cf.potential_energy(mech, scene.q + s * e), 1.0)
            for e in np.eye(scene.n)
        ]
        size = sizes(mech.description).gravity + abs(mech.energy_offset)
        assert_close(cf.gravity_vector(mech, scene.q), gradient, size, 1e-10)


class TestClosures:
    @examples
    @given(loops())
    def test_psi_is_the_gradient_of_the_gap_and_psidot_its_rate(self, scene):
        mech, speed = scene.mechanism, speed_of(scene)
        size = sizes(mech.description).loop
        assert_close(
            closures.closure_gap(mech, scene.q, t=0.0), np.zeros(len(mech.rows)), size, 1e-14
        )
        for axis, column in zip(
            np.eye(scene.n), closures.closure_jacobian(mech, scene.q, t=0.0).T, strict=True
        ):
            slope = derivative(
                lambda s, e=axis: closures.closure_gap(mech, scene.q + s * e, t=0.0), 1.0
            )
            assert_close(column, slope, size, 1e-10)

        def moving(s):
            return closures.closure_jacobian(mech, scene.q + s * scene.qd, t=0.0) @ scene.qd

        bias = closures.closure_bias(mech, scene.q, scene.qd, t=0.0)
        assert_close(bias, derivative(moving, speed), size * (1.0 + speed) ** 2, 1e-10)

    @examples
    @given(loops())
    def test_accelerations_keep_them_closed(self, scene):
        """Psi qdd + Psidot qd = 0 whatever the torques."""
        mech = scene.mechanism
        qdd = dyn.forward_dynamics(mech, scene.q, scene.qd, 20.0 * np.cos(np.arange(scene.n)))
        bend = closures.closure_jacobian(mech, scene.q, t=0.0) @ qdd
        bend = bend + closures.closure_bias(mech, scene.q, scene.qd, t=0.0)
        turning = np.abs(qdd).sum() + speed_of(scene) ** 2
        assert_close(bend, 0.0 * bend, sizes(mech.description).loop * turning)


class TestDynamics:
    @examples
    @given(trees(most=6))
    def test_forward_undoes_inverse_on_trees(self, scene):
        self.check_undone(scene)

    @examples
    @given(loops())
    def test_forward_undoes_inverse_on_loops(self, scene):
        self.check_undone(scene)

    @staticmethod
    def check_undone(scene):
        mech = scene.mechanism
        tau = dyn.inverse_dynamics(mech, *scene.states)
        least = np.linalg.eigvalsh(cf.mass_matrix(mech, scene.q))[0]
        load = sizes(mech.description).torque(scene.qd, scene.qdd) + np.abs(tau).sum()
        assert_close(dyn.forward_dynamics(mech, scene.q, scene.qd, tau), scene.qdd, load / least)

    @examples
    @given(trees(most=6))
    def test_power_in_is_the_growth_of_energy_on_trees(self, scene):
        self.check_power(scene)

    @examples
    @given(loops())
    def test_power_in_is_the_growth_of_energy_on_loops(self, scene):
        self.check_power(scene)

    @staticmethod
    def check_power(scene):
        """tau . qd - D qd . qd = dE/dt: damping takes, pins neither give nor take."""
        mech, (q, qd, _) = scene.mechanism, scene.states
        tau = 20.0 * np.cos(np.arange(scene.n))
        qdd = dyn.forward_dynamics(mech, q, qd, tau)

        def energy(s):
            rates = qd + s * qdd
            path = q + s * qd + s**2 / 2 * qdd
            return cf.kinetic_energy(mech, path, rates) + cf.potential_energy(mech, path)

        speed = speed_of(scene) + float(np.sqrt(np.abs(qdd).sum()))
        power = tau @ qd - np.array(mech.damping) @ qd**2
        size = sizes(mech.description).torque(qd, qdd) + 20.0 * scene.n + abs(mech.energy_offset)
        assert_close(derivative(energy, speed), power, size * (1.0 + speed), 1e-10)

    @pytest.mark.parametrize("n", [2, 3, 5])
    def test_terms_are_those_of_lagrange(self, n):
        """M, C and G equal to the Lagrangian that sympy derives."""
        scene = seeded_tree(n, n)
        mech, size = scene.mechanism, sizes(scene.mechanism.description)
        terms = oracles.sympy_terms(oracle_tree(mech.description), mech.gamma)(scene.q, scene.qd)
        assert_close(cf.mass_matrix(mech, scene.q), terms.M, size.inertia)
        C = cf.coriolis_matrix(mech, scene.q, scene.qd)
        assert_close(C, terms.C, size.coriolis(scene.qd))
        assert_close(cf.gravity_vector(mech, scene.q), terms.G, size.gravity)


class TestMotion:
    """Along an integrated motion; scipy's integrator and the dense forward dynamics only."""

    @pytest.mark.parametrize(
        "name", ["four-bar", "slider-crank", "five-bar", "six-bar, dyad on the coupler"]
    )
    def test_energy_is_constant_and_loops_stay_closed(self, name):
        """Without damping and torque: E(t) = E(0), gap = 0 and Psi qd = 0, to the tolerance."""
        scene = seeded_scene(0, LOOPS[name])
        mech, n = exchanged(scene.mechanism, {JointDamper: ()}), scene.n

        def rates(_, y):
            return [*y[n:], *dyn.forward_dynamics(mech, y[:n], y[n:], np.zeros(n))]

        start = [*scene.q, *(0.3 * scene.qd)]
        motion = solve_ivp(rates, (0.0, 0.3), start, method="DOP853", rtol=1e-11, atol=1e-11)
        assert motion.success
        q, qd = motion.y[:n].T, motion.y[n:].T
        assert np.abs(q - q[0]).max() > 0.05  # it moves
        energy = cf.kinetic_energy(mech, q, qd) + cf.potential_energy(mech, q)
        size = np.abs(energy).max() + sizes(mech.description).gravity
        assert_close(energy, np.full_like(energy, energy[0]), size, 1e-9)
        gap, loop = closures.closure_gap(mech, q, t=0.0), sizes(mech.description).loop
        assert_close(gap, np.zeros_like(gap), loop, 1e-9)
        moving = np.einsum("...ij,...j->...i", closures.closure_jacobian(mech, q, t=0.0), qd)
        assert_close(moving, np.zeros_like(moving), loop * np.abs(qd).max(), 1e-9)


# -- the package's self-test ---------------------------------------------------------------------


def residuals(mech, count=10):
    """The self-test's identities by name."""
    sample = selftest.sample_states(mech, count)
    assert len(sample.q) > 0
    return selftest.identities(mech, sample)


def broken(mech, count=10):
    return [identity.name for identity in residuals(mech, count) if not identity.holds]


class TestSelfTestHolds:
    @pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
    def test_on_every_example(self, path):
        assert broken(load(path), 20) == []

    @pytest.mark.parametrize("seed", range(5))
    def test_on_random_trees(self, seed):
        assert broken(seeded_tree(seed, seed + 1).mechanism) == []

    @pytest.mark.parametrize("name", [name for name, shape in LOOPS.items() if not shape.start])
    def test_on_random_loops(self, name):
        mech = seeded_scene(3, LOOPS[name]).mechanism
        assert broken(mech, 5) == []

    @pytest.mark.parametrize("seed", range(5))
    def test_on_a_massless_coupler(self, seed):
        assert broken(seeded_scene(seed, LOOPS["four-bar"], massless=(1,)).mechanism) == []

    def test_residuals_are_those_of_rounding(self):
        """Far below the bound, so that the bound cannot hide a fault."""
        for path in ROBOTS:
            mechanism = load(path)
            part = 0.1 if mechanism.driven else 0.01  # differences over the time of a fast law
            for identity in residuals(mechanism):
                assert identity.residual < part * selftest.BOUND, (path.stem, identity)

    @pytest.mark.parametrize("name", ["four-bar", "slider-crank", "five-bar"])
    def test_sampled_states_are_closed_and_move(self, name):
        mech = seeded_scene(0, LOOPS[name]).mechanism
        sample = selftest.sample_states(mech, 8)
        assert 0 < len(sample.q) <= 8
        assert 0.0 < sample.closing <= 1.0
        size = sizes(mech.description).loop
        gap = closures.closure_gap(mech, sample.q, t=0.0)
        assert_close(gap, np.zeros_like(gap), size, 1e-12)
        assert np.abs(sample.qd).max() > 0.1

    def test_every_identity_of_the_design_is_there(self):
        names = " | ".join(identity.name for identity in residuals(load_robot("four-bar")))
        for part in ("M = M^T", "positive", "KE", "Mdot - 2C", "dPE/dq", "gap", "Psi", "dE/dt"):
            assert part in names, part


def load_robot(name):
    return load(ROBOTS[0].parent / f"{name}.yaml")


def wrong_A(mech, diagonal):
    """One entry of A off by a third."""
    k = next(i for i, (j, k, _) in enumerate(mech.A) if (j == k) == diagonal)
    A = list(mech.A)
    A[k] = (*A[k][:2], A[k][2] * 4 / 3)
    return dataclasses.replace(mech, A=tuple(A))


def wrong_closure(mech):
    """One link of the loop a tenth longer than the links are."""
    row = mech.rows[0]
    (k, p), *rest = row.P
    rows = (row._replace(P=((k, 1.1 * p), *rest)), *mech.rows[1:])
    return dataclasses.replace(mech, rows=rows)


class TestSelfTestDetects:
    """A check that cannot fail is worthless."""

    MODELS = pytest.mark.parametrize("robot", ["2r", "four-bar", "slider-crank"])

    @MODELS
    @pytest.mark.parametrize("diagonal", [True, False])
    def test_a_wrong_inertia(self, robot, diagonal):
        assert broken(wrong_A(load_robot(robot), diagonal))

    @MODELS
    def test_a_wrong_first_moment(self, robot):
        mech = load_robot(robot)
        weights = (mech.weights[0] * 1.1, *mech.weights[1:])
        assert broken(dataclasses.replace(mech, weights=weights))

    @MODELS
    def test_a_wrong_gravity(self, robot):
        mech = load_robot(robot)
        weights = tuple(weight * 1.1 for weight in mech.weights)
        assert broken(dataclasses.replace(mech, weights=weights))

    @MODELS
    def test_a_wrong_height(self, robot):
        mech = load_robot(robot)
        assert broken(dataclasses.replace(mech, energy_offset=mech.energy_offset + 1.0))

    @MODELS
    def test_a_wrong_damping(self, robot):
        mech = load_robot(robot)
        assert broken(exchanged(mech, {JointDamper: [JointDamper(k, 0.5) for k in range(mech.n)]}))

    @pytest.mark.parametrize("robot", ["four-bar", "slider-crank", "five-bar"])
    def test_a_wrong_closure(self, robot):
        assert broken(wrong_closure(load_robot(robot)))

    def test_an_inertia_that_is_not_positive(self):
        mech = load_robot("2r")
        A = tuple((j, k, -value if j == k == 1 else value) for j, k, value in mech.A)
        assert any("M positive" in name for name in broken(dataclasses.replace(mech, A=A)))

    @MODELS
    @pytest.mark.parametrize(
        ("function", "wrong", "identity"),
        [
            ("mass_matrix", lambda M: np.triu(M) + 0.5 * np.tril(M, -1), "M = M^T"),
            ("kinetic_energy", lambda KE: 1.001 * KE, "KE = 1/2 qd^T M qd"),
            ("coriolis_matrix", lambda C: -C, "Mdot - 2C"),
            ("gravity_vector", lambda G: -G, "G = dPE/dq"),
        ],
    )
    def test_a_wrong_term(self, monkeypatch, robot, function, wrong, identity):
        right = getattr(cf, function)
        monkeypatch.setattr(cf, function, lambda *arguments: wrong(right(*arguments)))
        assert any(name.startswith(identity) for name in broken(load_robot(robot)))

    def test_the_misprint_of_equation_27(self, monkeypatch):
        """The second entry of the 2R arm's G without its r2 = 0.25."""
        right = cf.gravity_vector
        monkeypatch.setattr(cf, "gravity_vector", lambda *at: right(*at) / [1.0, 0.25])
        assert "G = dPE/dq" in broken(load_robot("2r"))

    @MODELS
    def test_a_coriolis_matrix_that_is_skew_but_wrong(self, monkeypatch, robot):
        """Mdot - 2 C^T is skew-symmetric too; but C^T qd is not C qd."""
        right = cf.coriolis_matrix
        monkeypatch.setattr(
            cf, "coriolis_matrix", lambda *state: np.swapaxes(right(*state), -1, -2)
        )
        assert broken(load_robot(robot))

    @pytest.mark.parametrize("robot", ["four-bar", "slider-crank", "five-bar"])
    @pytest.mark.parametrize(
        ("function", "identity"),
        [("closure_jacobian", "Psi = dgap/dq"), ("closure_bias", "Psidot qd")],
    )
    def test_a_wrong_closure_term(self, monkeypatch, robot, function, identity):
        mech, right = load_robot(robot), getattr(closures, function)
        sample = selftest.sample_states(mech, 5)
        monkeypatch.setattr(closures, function, lambda *arguments: 1.001 * right(*arguments))
        found = selftest.identities(mech, sample)
        assert any(not one.holds for one in found if one.name == identity)

    @MODELS
    def test_wrong_accelerations(self, monkeypatch, robot):
        right = dyn.forward_dynamics_and_forces

        def wrong(*arguments):
            motion = right(*arguments)
            return motion._replace(qdd=1.001 * motion.qdd)

        monkeypatch.setattr(dyn, "forward_dynamics_and_forces", wrong)
        names = broken(load_robot(robot))
        assert any("M qdd" in name for name in names)
        assert any("dE/dt" in name for name in names)

    def test_accelerations_that_open_the_loops(self, monkeypatch):
        """A massless coupler turned aside moves no mass and takes no power: only Psi qdd tells."""
        mech = seeded_scene(3, LOOPS["four-bar"], massless=(1,)).mechanism
        right = dyn.forward_dynamics_and_forces

        def wrong(*arguments):
            motion = right(*arguments)
            return motion._replace(qdd=motion.qdd + np.array([0.0, 1.0, 0.0]))

        monkeypatch.setattr(dyn, "forward_dynamics_and_forces", wrong)
        assert broken(mech)

    def test_states_off_the_closures(self):
        mech = load_robot("four-bar")
        sample = selftest.sample_states(mech, 5)
        opened = dataclasses.replace(sample, q=sample.q + 0.01)
        names = [one.name for one in selftest.identities(mech, opened) if not one.holds]
        assert "gap = 0" in names


class TestLongChains:
    def test_the_self_test_holds(self):
        """Its differences step by the links' own turns, which add up along a chain."""
        for n in (30, 100):
            found = residuals(seeded_scene(0, Shape((None, *range(n - 1)))).mechanism, 5)
            assert all(one.residual < 0.1 * selftest.BOUND for one in found), found
