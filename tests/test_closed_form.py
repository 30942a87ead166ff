"""M, C, G, Psi and energies against the lecture, the sympy Lagrangian and 30 digits."""

import numpy as np
import pytest
from conftest import FRESH
from hypothesis import given, settings
from mpmath import mp

import oracles
from random_mechanisms import (
    LOOPS,
    Pose,
    assert_close,
    mechanism,
    oracle_tree,
    seeded_scene,
    seeded_tree,
    sizes,
    trees,
)
from robodyn.dynamics import closed_form as cf
from robodyn.errors import InputError
from robodyn.loops import closures, public

SEEDS = range(10)
FOUR_BAR_YAML = """
gravity: {g}
links:
  - {{name: crank, m: {m1}, l: {l1}, r: {r1}, I: {I1}}}
  - {{name: coupler, m: {m2}, l: {l2}, r: {r2}, I: {I2}}}
  - {{name: rocker, m: {m3}, l: {l3}, r: {r3}, I: {I3}, from: [{d}, {e}]}}
closures: [[coupler, rocker]]
"""
TWO_LINK_YAML = """
gravity: {g}
links:
  - {{name: upper arm, m: {m1}, l: {l1}, r: {r1}, I: {I1}}}
  - {{name: forearm, m: {m2}, l: {l2}, r: {r2}, I: {I2}}}
"""


def closure_bias(mechanism, q, qd):
    return closures.closure_bias(mechanism, q, qd, 0.0)


def random_parameters(kind, rng):
    """A TwoLink or FourBar of the oracles with parameters between 0.1 and 2."""
    return kind(**{name: float(rng.uniform(0.1, 2.0)) for name in kind._fields})


class TestLecture:
    @pytest.mark.parametrize("seed", SEEDS)
    def test_2r_arm(self, seed):
        """Equations (24)-(27), their misprints put right, on any parameters."""
        rng = np.random.default_rng(seed)
        p = random_parameters(oracles.TwoLink, rng)
        mech = mechanism(TWO_LINK_YAML.format(**p._asdict()))
        q, qd = rng.uniform(-np.pi, np.pi, 2), rng.normal(size=2) * 5.0
        M, C, G = oracles.two_link_terms(p, q, qd)
        size = sizes(mech.description)
        assert_close(cf.mass_matrix(mech, q), M, size.inertia)
        assert_close(cf.coriolis_matrix(mech, q, qd), C, size.coriolis(qd))
        assert_close(cf.gravity_vector(mech, q), G, size.gravity)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_four_bar(self, seed):
        """Its 3x3 M, C and G, gap and 2x3 Psi with q = (theta1, phi2, phi1), the loop broken."""
        rng = np.random.default_rng(seed)
        p = random_parameters(oracles.FourBar, rng)
        mech = mechanism(FOUR_BAR_YAML.format(**p._asdict()))
        q, qd = rng.uniform(-np.pi, np.pi, 3), rng.normal(size=3) * 5.0
        terms = oracles.four_bar_terms(p, q, qd)
        size = sizes(mech.description)
        assert_close(cf.mass_matrix(mech, q), terms.M, size.inertia)
        assert_close(cf.coriolis_matrix(mech, q, qd), terms.C, size.coriolis(qd))
        assert_close(cf.gravity_vector(mech, q), terms.G, size.gravity)
        assert_close(closures.closure_gap(mech, q, t=0.0), terms.gap, size.loop)
        assert_close(closures.closure_jacobian(mech, q, t=0.0), terms.Psi, size.loop)
        bias = closures.closure_bias(mech, q, qd, t=0.0)
        assert_close(bias, terms.Psidot @ qd, size.loop * np.abs(qd).sum() ** 2)


class TestThirtyDigits:
    @pytest.mark.parametrize("scale", [1e-150, 1e-6, 1e6, 1e140])
    def test_terms_scale_with_the_masses(self, scale):
        """All masses and inertias times a power of ten: M, C and G times the same."""
        text = "gravity: 9.81\nlinks:\n" + "".join(
            f"  - {{name: l{k}, m: {m * scale}, l: {l}, r: {r}, I: {I * scale}}}\n"
            for k, (m, l, r, I) in enumerate([(1.5, 0.8, 0.36, 0.082), (0.9, 0.6, 0.25, 0.031)])
        )
        mech, q, qd = mechanism(text), [0.3, -1.1], [2.0, 5.0]
        p = oracles.TwoLink(1.5, 0.8, 0.36, 0.082, 0.9, 0.6, 0.25, 0.031)
        M, C, G = oracles.two_link_terms(p, q, qd)
        assert_close(cf.mass_matrix(mech, q) / scale, M, 1.0)
        assert_close(cf.coriolis_matrix(mech, q, qd) / scale, C, 10.0)
        assert_close(cf.gravity_vector(mech, q) / scale, G, 10.0)

    def test_masses_a_million_million_apart(self):
        """1e-6 kg carries 1e6 kg carries 1e-6 kg: every entry to 1e-13 of its own terms."""
        masses = [1e-6, 1e6, 1e-6]
        text = "gravity: 9.81\nlinks:\n" + "".join(
            f"  - {{name: l{k}, m: {m}, l: 0.{7 - k}, r: 0.3, I: {0.02 * m}}}\n"
            for k, m in enumerate(masses)
        )
        mech, q, qd = mechanism(text), [0.4, 2.2, -0.7], [1.0, -3.0, 2.0]
        M, C, G = oracles.mp_terms(oracle_tree(mech.description), mech.gamma, q, qd)
        found = cf.mass_matrix(mech, q), cf.coriolis_matrix(mech, q, qd)
        with mp.workdps(30):
            for i in range(3):
                for j in range(3):
                    carried = sum(masses[max(i, j) :])  # what both joints move
                    assert_close(found[0][i, j], M[i, j], carried)
                    assert_close(found[1][i, j], C[i, j], 5.0 * carried)
                assert_close(cf.gravity_vector(mech, q)[i], G[i], 10.0 * sum(masses[i:]))


class TestStructure:
    @settings(deadline=None, max_examples=80 if FRESH else 40)
    @given(trees())
    def test_turning_all_ground_joints_changes_neither_M_nor_C(self, scene):
        """The angles of links that hang from the ground enter M and C by their differences only."""
        mech, size = scene.mechanism, sizes(scene.mechanism.description)
        turned = scene.q + [1.3 if parent is None else 0.0 for parent in mech.parent]
        M = cf.mass_matrix(mech, scene.q)
        assert_close(cf.mass_matrix(mech, turned), M, size.inertia)
        C = cf.coriolis_matrix(mech, scene.q, scene.qd)
        assert_close(cf.coriolis_matrix(mech, turned, scene.qd), C, size.coriolis(scene.qd))

    def test_no_gravity_no_gravity_term(self):
        text = "\n".join(seeded_tree(3, 4).text.splitlines()[1:])
        mech = mechanism(text)
        assert not cf.gravity_vector(mech, [1.0, 2.0, 3.0, 4.0]).any()
        assert cf.potential_energy(mech, [1.0, 2.0, 3.0, 4.0]) == 0.0

    def test_links_balanced_about_one_joint(self):
        """Centres of gravity on their joints, both joints in one place: M constant, C = G = 0."""
        mech = mechanism(
            "gravity: 9.81\n"
            "links: [{name: a, m: 2, l: 1, r: 0, I: 0.5},"
            " {name: b, m: 3, l: 1, r: 0, I: 0.25, from: {link: a, at: [0, 0]}}]"
        )
        q, qd = [1.0, 2.0], [3.0, 4.0]
        assert_close(cf.mass_matrix(mech, q), [[0.75, 0.25], [0.25, 0.25]], 1.0, 1e-15)
        assert_close(cf.coriolis_matrix(mech, q, qd), np.zeros((2, 2)), 1.0, 1e-15)
        assert not cf.gravity_vector(mech, q).any()


class TestPointMotion:
    @settings(deadline=None, max_examples=80 if FRESH else 40)
    @given(trees())
    def test_velocity_and_acceleration_follow_the_joints(self, scene):
        """v = sum_j i (s - joint_j) qd_j; a = the same with qdd, and the bias of qd."""
        mech, size = scene.mechanism, 10.0
        pose = Pose(oracle_tree(mech.description), scene.q)
        position, velocity, acceleration = cf.point_motion(mech, mech.tips, *scene.states)
        speed, turning = np.abs(scene.qd).sum(), np.abs(scene.qdd).sum()
        for k, link in enumerate(mech.description.links):
            tip = k, complex(link.l)
            slope = pose.slope(tip)
            v, a = slope @ scene.qd, slope @ scene.qdd + pose.bias(tip, scene.qd)
            assert_close(complex(*position[k]), pose.position(tip), size)
            assert_close(complex(*velocity[k]), v, size * speed)
            assert_close(complex(*acceleration[k]), a, size * (turning + speed**2))

    def test_rates_not_given_are_zero(self):
        mech = seeded_tree(5, 3).mechanism
        _, velocity, acceleration = cf.point_motion(mech, mech.centres, np.zeros((4, 3)))
        assert velocity.shape == acceleration.shape == (4, 3, 2)
        assert not velocity.any()
        assert not acceleration.any()


class TestLeadingAxes:
    scene = seeded_scene(6, LOOPS["five-bar"])
    ONE_ARGUMENT = (cf.mass_matrix, cf.gravity_vector, cf.potential_energy)
    ONE_ARGUMENT += (public.closure_gap, public.closure_jacobian)
    TWO_ARGUMENTS = (cf.coriolis_matrix, cf.kinetic_energy, closure_bias)
    names = staticmethod(lambda function: function.__name__)

    @pytest.mark.parametrize("function", ONE_ARGUMENT + TWO_ARGUMENTS, ids=names)
    def test_many_states_are_each_state_by_itself(self, function):
        rng = np.random.default_rng(7)
        count = 1 if function in self.ONE_ARGUMENT else 2
        states = [rng.normal(size=(2, 3, 4)) for _ in range(count)]
        mech = self.scene.mechanism
        together = function(mech, *states)
        for i in np.ndindex(2, 3):
            alone = function(mech, *(state[i] for state in states))
            assert_close(together[i], alone, np.abs(together).max(), 1e-15)

    @pytest.mark.parametrize("function", ONE_ARGUMENT + TWO_ARGUMENTS, ids=names)
    def test_no_states_at_all(self, function):
        count = 1 if function in self.ONE_ARGUMENT else 2
        mech = self.scene.mechanism
        one = function(mech, *[np.zeros(4)] * count)
        none = function(mech, *[np.zeros((0, 4))] * count)
        assert none.shape == (0, *one.shape)

    @pytest.mark.parametrize("function", TWO_ARGUMENTS, ids=names)
    def test_one_configuration_at_many_rates(self, function):
        mech, rates = self.scene.mechanism, np.random.default_rng(8).normal(size=(5, 4))
        q = self.scene.q
        together, each = function(mech, q, rates), [function(mech, q, qd) for qd in rates]
        assert_close(together, each, np.abs(together).max(), 1e-15)

    @pytest.mark.parametrize("dtype", [int, np.float32, bool])
    def test_numbers_of_other_types_are_taken_as_floats(self, dtype):
        mech, q = self.scene.mechanism, np.array([0, 1, 1, 0], dtype)
        M = cf.mass_matrix(mech, q)
        assert M.dtype == np.float64
        assert np.array_equal(M, cf.mass_matrix(mech, [0.0, 1.0, 1.0, 0.0]))


class TestInputErrors:
    mech = seeded_tree(9, 3).mechanism

    @pytest.mark.parametrize(
        ("q", "place"),
        [
            ([1.0, np.nan, 0.0], r"q\[1\] = nan: must be finite"),
            ([[1.0, 2.0, 3.0], [0.0, 0.0, -np.inf]], r"q\[1, 2\] = -inf: must be finite"),
            ([1.0, 2.0], r"q\.shape = \(2,\): must have 3 values along the last axis"),
            (np.zeros((3, 4)), r"q\.shape = \(3, 4\): must have 3 values"),
            (1.0, r"q\.shape = \(\): must have 3 values"),
            ([], r"q\.shape = \(0,\): must have 3 values"),
        ],
    )
    def test_states_that_do_not_fit(self, q, place):
        for function in (cf.mass_matrix, cf.gravity_vector, public.closure_jacobian):
            with pytest.raises(InputError, match=place):
                function(self.mech, q)

    def test_rates_are_named_as_rates(self):
        with pytest.raises(InputError, match=r"qd\[0\] = inf"):
            cf.coriolis_matrix(self.mech, [0.0] * 3, [np.inf, 0.0, 0.0])
        with pytest.raises(InputError, match=r"qd\.shape = \(2,\)"):
            cf.kinetic_energy(self.mech, [0.0] * 3, [0.0, 0.0])
        with pytest.raises(InputError, match=r"qdd\[2\] = nan"):
            cf.point_motion(self.mech, self.mech.tips, [0.0] * 3, None, [0.0, 0.0, np.nan])


@pytest.mark.parametrize("seed", SEEDS)
def test_sums_along_the_tree_are_products_of_whole_matrices(seed, monkeypatch):
    """J^T W J as it is computed of long chains, on trees with joints that turn and slide."""
    scene = seeded_tree(seed, 2 + seed % 5)
    mech, qd = scene.mechanism, scene.qd
    expected = cf.mass_matrix(mech, scene.q), cf.coriolis_matrix(mech, scene.q, qd)
    monkeypatch.setattr(cf, "LONG", 1)
    size = sizes(mech.description)
    assert_close(cf.mass_matrix(mech, scene.q), expected[0], size.inertia)
    assert_close(cf.coriolis_matrix(mech, scene.q, qd), expected[1], size.coriolis(qd))
