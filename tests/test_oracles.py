"""The oracles against one another: solutions by different methods have to agree."""

import math

import mpmath
import numpy as np
import pytest
from conftest import FRESH
from each_case import each
from mpmath import mp, mpf

import oracles

G = 9.81
TWO_LINK = oracles.TwoLink(
    m1=1.5, l1=0.8, r1=0.36, I1=0.082, m2=0.9, l2=0.6, r2=0.25, I2=0.031, g=G
)
FOUR_BAR = oracles.FourBar(
    *(0.6, 0.35, 0.15, 0.008),  # crank m, l, r, I
    *(1.3, 0.95, 0.45, 0.102),  # coupler
    *(1.0, 0.80, 0.36, 0.061),  # rocker
    *(1.1, 0.0, G),  # ground pivot, gravity
)
SEEDS = range(5 if FRESH else 2)


def assert_close(actual, expected, rtol=1e-12):
    """Equal to within rtol of the largest entry (entries below 1 count as 1)."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    assert np.max(abs(actual - expected)) <= rtol * max(1, np.max(abs(expected)))


def draw_two_link(seed):
    """A generator and an arm: the example for seed 0, else with every parameter changed."""
    rng = np.random.default_rng(seed)
    if seed == 0:
        return rng, TWO_LINK
    return rng, oracles.TwoLink(*(x * rng.uniform(0.5, 1.5) for x in TWO_LINK))


def draw_four_bar(seed):
    """A generator and a four-bar whose crank turns fully: the example for seed 0, else changed."""
    rng = np.random.default_rng(seed)
    if seed == 0:
        return rng, FOUR_BAR
    values = FOUR_BAR._replace(e=0.1)._asdict()
    for name in values:
        spread = 0.03 if name in ("l1", "l2", "l3", "d") else 0.5
        values[name] *= rng.uniform(1 - spread, 1 + spread)
    return rng, oracles.FourBar(**values)


def random_tree(rng, parents=(None, 0, 1, 1, None)):
    """A tree with two links on one link, two on the ground, and centres of gravity off the line."""
    return [
        {
            "m": rng.uniform(0.3, 2.0),
            "l": 1.0,
            "r": complex(*rng.uniform(-0.5, 0.5, 2)),
            "I": rng.uniform(0.01, 0.3),
            "parent": parent,
            "at": complex(*rng.uniform(-1.0, 1.0, 2)),
        }
        for parent in parents
    ]


def random_closures(rng):
    """Link to link and link to ground, for random_tree."""
    points = [complex(*rng.uniform(-1.0, 1.0, 2)) for _ in range(4)]
    return [((2, points[0]), (4, points[1])), ((3, points[2]), (None, points[3]))]


def draw_assembled_four_bar(seed, assembly):
    """As draw_four_bar, with a state that keeps the loop closed: rng, p, q, qd."""
    rng, p = draw_four_bar(seed)
    q = oracles.four_bar_position(p, rng.uniform(-math.pi, math.pi), assembly)
    k, _ = oracles.four_bar_coefficients(p, q)
    return rng, p, q, k * rng.uniform(-5.0, 5.0)


def slope(motion, t, h=mpf(10) ** -15):
    """Time derivatives of angle and rate, by central differences (for motions at 60 digits)."""
    return [
        (after - before) / (2 * h)
        for before, after in zip(motion(t - h), motion(t + h), strict=True)
    ]


class TestTwoLink:
    def test_horizontal_arm_at_rest_carries_weight_times_lever(self):
        p = TWO_LINK
        weight1, weight2 = p.m1 * G, p.m2 * G
        expected = [weight1 * p.r1 + weight2 * (p.l1 + p.r2), weight2 * p.r2]
        assert_close(oracles.two_link_torque(p, [0, 0], [0, 0], [0, 0]), expected, 1e-15)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_lecture_equals_lagrange(self, seed):
        rng, p = draw_two_link(seed)
        q, qd = rng.normal(size=(2, 2)) * [[2.0], [5.0]]
        terms = oracles.sympy_terms(oracles.two_link_tree(p), -1j * p.g)(q, qd)
        for actual, expected in zip(oracles.two_link_terms(p, q, qd), terms[:3], strict=True):
            assert_close(actual, expected, 1e-14)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_lecture_equals_newton_euler(self, seed):
        rng, p = draw_two_link(seed)
        q, qd, qdd = rng.normal(size=(3, 2)) * [[2.0], [5.0], [20.0]]
        tree = oracles.two_link_tree(p)
        tau = oracles.two_link_torque(p, q, qd, qdd)
        assert_close(oracles.newton_euler(tree, -1j * p.g, q, qd, qdd), tau, 1e-14)
        assert_close(oracles.newton_euler_mp(tree, -1j * p.g, q, qd, qdd), tau, 1e-14)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_acceleration_inverts_torque(self, seed):
        rng, p = draw_two_link(seed)
        q, qd, qdd = rng.normal(size=(3, 2)) * [[2.0], [5.0], [20.0]]
        tau = oracles.two_link_torque(p, q, qd, qdd)
        assert_close(oracles.two_link_acceleration(p, q, qd, tau), qdd)


class TestFourBar:
    @pytest.mark.parametrize("seed", SEEDS)
    def test_lecture_equals_lagrange(self, seed):
        rng, p = draw_four_bar(seed)
        q, qd = rng.normal(size=(2, 3)) * [[2.0], [5.0]]
        tree, closures = oracles.four_bar_tree(p)
        actual = oracles.four_bar_terms(p, q, qd)
        expected = oracles.sympy_terms(tree, -1j * p.g, closures)(q, qd)
        for name in ("M", "C", "G", "gap", "Psi"):
            assert_close(getattr(actual, name), getattr(expected, name), 1e-14)
        assert_close(actual.Psidot @ qd, expected.Psidot_qd, 1e-14)

    @each("assembly", ["open", "crossed"])
    @each("theta1", np.linspace(-math.pi, math.pi, 9))
    def test_position_closes_the_loop_on_the_named_side(self, theta1, assembly):
        p = FOUR_BAR._replace(e=0.1)
        q = oracles.four_bar_position(p, theta1, assembly)
        assert q[0] == theta1
        assert_close(oracles.four_bar_terms(p, q, [0, 0, 0]).gap, [0, 0], 1e-15)
        A = p.l1 * np.exp(1j * theta1)
        D = complex(p.d, p.e)
        P = D + p.l3 * np.exp(1j * q[2])
        to_the_left = ((D - A).conjugate() * (P - A)).imag > 0
        assert to_the_left == (assembly == "open")

    def test_position_out_of_reach_is_an_error(self):
        with pytest.raises(ValueError, match="domain"):
            oracles.four_bar_position(FOUR_BAR._replace(l2=0.2), 3.0)

    @each("assembly", ["open", "crossed"])
    @each("seed", SEEDS)
    def test_coefficients_keep_the_loop_closed(self, seed, assembly):
        _, p, q, _ = draw_assembled_four_bar(seed, assembly)
        k, k_prime = oracles.four_bar_coefficients(p, q)
        terms = oracles.four_bar_terms(p, q, k)  # theta1d = 1
        assert_close(terms.Psi @ k, [0, 0])
        assert_close(terms.Psi @ k_prime + terms.Psidot @ k, [0, 0])

    @each("assembly", ["open", "crossed"])
    @each("seed", SEEDS)
    def test_one_coordinate_equals_lagrange_multipliers(self, seed, assembly):
        rng, p, q, qd = draw_assembled_four_bar(seed, assembly)
        tau1 = rng.uniform(-20.0, 20.0)
        theta1dd = oracles.four_bar_reduced_acceleration(p, q[0], qd[0], tau1, assembly)
        k, k_prime = oracles.four_bar_coefficients(p, q)

        qdd, lam = oracles.four_bar_acceleration(p, q, qd, np.array([tau1, 0.0, 0.0]))
        assert_close(qdd, k * theta1dd + k_prime * qd[0] ** 2)

        tau1_again, lam_again = oracles.four_bar_torque(p, q, qd, qdd)
        assert_close(tau1_again, tau1)
        assert_close(lam_again, lam)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_pin_force_acts_on_the_coupler_and_back_on_the_rocker(self, seed):
        _, p, q, qd = draw_assembled_four_bar(seed, "open")
        qdd, lam = oracles.four_bar_acceleration(p, q, qd, np.zeros(3))
        c3, s3 = math.cos(q[2]), math.sin(q[2])
        moment_on_rocker = p.l3 * (c3 * -lam[1] - s3 * -lam[0])
        weight = p.m3 * p.g * p.r3 * c3
        assert_close((p.I3 + p.m3 * p.r3**2) * qdd[2], moment_on_rocker - weight)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_inertia_and_potential_of_the_reduction_are_those_of_the_links(self, seed):
        _, p, q, _ = draw_assembled_four_bar(seed, "open")
        k, _ = oracles.four_bar_coefficients(p, q)
        terms = oracles.four_bar_terms(p, q, k)
        J, dJ, dPE = oracles.four_bar_reduction(p, q[0])
        assert_close([J, dPE], [k @ terms.M @ k, k @ terms.G])
        h = 1e-5
        J_after, J_before = (oracles.four_bar_reduction(p, q[0] + x)[0] for x in (h, -h))
        assert dJ == pytest.approx((J_after - J_before) / (2 * h), rel=1e-6, abs=1e-6)


class TestTree:
    gamma = complex(1.7, -9.2)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_lagrange_equals_newton_euler(self, seed):
        rng = np.random.default_rng(seed)
        tree = random_tree(rng)
        q, qd, qdd = rng.normal(size=(3, 5)) * [[2.0], [5.0], [20.0]]
        terms = oracles.sympy_terms(tree, self.gamma, random_closures(rng))(q, qd)
        tau = terms.M @ qdd + terms.C @ qd + terms.G
        assert_close(oracles.newton_euler(tree, self.gamma, q, qd, qdd), tau, 1e-14)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_jacobians_equal_lagrange_at_30_digits(self, seed):
        rng = np.random.default_rng(seed)
        tree = random_tree(rng)
        q, qd = rng.normal(size=(2, 5)) * [[2.0], [5.0]]
        closures = random_closures(rng)
        terms = oracles.sympy_terms(tree, self.gamma, closures, backend="mpmath")(q, qd)
        with mp.workdps(30):
            for actual, expected in zip(
                oracles.mp_terms(tree, self.gamma, q, qd), terms[:3], strict=True
            ):
                assert_close(actual, expected, 1e-28)
        floats = oracles.sympy_terms(tree, self.gamma, closures)(q, qd)
        for actual, expected in zip(floats, terms, strict=True):
            assert_close(actual, expected, 1e-14)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_jacobians_equal_newton_euler_at_30_digits(self, seed):
        rng = np.random.default_rng(seed)
        tree = random_tree(rng, parents=(None, 0, 1, 2, 0, None, 5))
        q, qd, qdd = rng.normal(size=(3, 7)) * [[2.0], [5.0], [20.0]]
        M, C, G = oracles.mp_terms(tree, self.gamma, q, qd)
        with mp.workdps(30):
            tau = M @ qdd + C @ qd + G
            assert_close(oracles.newton_euler_mp(tree, self.gamma, q, qd, qdd), tau, 1e-28)

    def test_digits_are_as_many_as_asked_for(self):
        rng = np.random.default_rng(1)
        tree = random_tree(rng)
        q, qd, qdd = rng.normal(size=(3, 5))
        exact = oracles.newton_euler_mp(tree, self.gamma, q, qd, qdd, digits=60)
        for digits in (20, 40):
            tau = oracles.newton_euler_mp(tree, self.gamma, q, qd, qdd, digits)
            with mp.workdps(60):
                error = np.max(abs(tau - exact))
            assert 0 < error < mpf(10) ** (3 - digits)

    def test_closures_and_energies_are_consistent_along_a_line(self):
        """Along q + s qd: d gap/ds = Psi qd, d2 gap/ds2 = Psidot qd, dPE/ds = G qd."""
        rng = np.random.default_rng(2)
        tree, closures = random_tree(rng), random_closures(rng)
        q, qd = rng.normal(size=(2, 5))
        evaluate = oracles.sympy_terms(tree, self.gamma, closures, backend="mpmath", digits=60)
        with mp.workdps(60):
            q, qd = (np.array([mpf(x) for x in xs], dtype=object) for xs in (q, qd))
            h = mpf(10) ** -15
            before, here, after = (evaluate(q + s * qd, qd) for s in (-h, 0, h))
            assert_close((after.gap - before.gap) / (2 * h), here.Psi @ qd, 1e-25)
            assert_close((after.gap - 2 * here.gap + before.gap) / h**2, here.Psidot_qd, 1e-25)
            assert_close((after.PE - before.PE) / (2 * h), here.G @ qd, 1e-25)
            assert_close(here.KE, qd @ here.M @ qd / 2, 1e-50)
            Mdot = (after.M - before.M) / (2 * h)
            assert_close(Mdot, here.C + here.C.T, 1e-25)

    def test_gap_is_the_difference_of_the_points_along_the_two_paths(self):
        """Link 2 (by 0 and 1) to link 4 (on the ground), and link 3 (by 0 and 1) to the ground."""
        rng = np.random.default_rng(3)
        tree, closures = random_tree(rng), random_closures(rng)
        q = rng.normal(size=5)
        at = [link["at"] for link in tree]
        (first, second), (third, fourth) = [[point for _, point in pair] for pair in closures]
        turn = np.exp(1j * q)
        joint1 = at[0] + turn[0] * at[1]
        tip2 = joint1 + turn[0] * turn[1] * (at[2] + turn[2] * first)
        tip3 = joint1 + turn[0] * turn[1] * (at[3] + turn[3] * third)
        tip4 = at[4] + turn[4] * second
        expected = [tip2 - tip4, tip3 - fourth]
        gap = oracles.sympy_terms(tree, self.gamma, closures)(q, np.zeros(5)).gap
        assert_close(gap[0::2] + 1j * gap[1::2], expected, 1e-15)


class TestPendulum:
    omega0 = oracles.pendulum_frequency(m=1.5, r=0.36, I=0.082, g=G)

    def test_frequency_is_that_of_the_rod(self):
        """A uniform rod of length l swings with omega0^2 = 3 g / (2 l)."""
        omega0 = oracles.pendulum_frequency(m=3.0, r=0.5, I=0.25, g=G)
        with mp.workdps(30):
            assert_close(omega0, mpmath.sqrt(mpf(3) * G / 2), 1e-29)

    @pytest.mark.parametrize("amplitude", [0.1, -1.2, 2.5, 3.1])
    def test_starts_at_rest_and_returns_after_a_period(self, amplitude):
        period = oracles.pendulum_period(self.omega0, amplitude)
        with mp.workdps(30):
            for cycles, sign in ((0, 1), (0.5, -1), (1, 1), (7, 1)):
                state = oracles.pendulum_exact(self.omega0, amplitude, cycles * period)
                assert_close(state, [sign * amplitude, 0], 1e-28)

    @each("amplitude", [0.1, -1.2, 2.5, 3.1])
    @each("t", [0.2, 1.3, 10.0])
    def test_keeps_its_equation_of_motion_and_its_energy(self, amplitude, t):
        def motion(t):
            return oracles.pendulum_exact(self.omega0, amplitude, t, digits=60)

        with mp.workdps(60):
            theta, thetad = motion(t)
            thetadd = -(self.omega0**2) * mpmath.sin(theta)
            assert_close(slope(motion, t), [thetad, thetadd], 1e-25)
            drop = mpmath.cos(theta) - mpmath.cos(amplitude)
            assert_close(thetad**2 / 2, self.omega0**2 * drop, 1e-40)

    def test_is_the_motion_of_a_one_link_tree(self):
        """Its angle from the downward vertical, on a link measured from +X, needs no torque."""
        link = {"m": 1.5, "l": 0.8, "r": 0.36, "I": 0.082, "parent": None, "at": 0j}
        theta, thetad = (float(x) for x in oracles.pendulum_exact(self.omega0, 2.0, 0.7))
        thetadd = -(float(self.omega0) ** 2) * math.sin(theta)
        tau = oracles.newton_euler([link], -1j * G, [theta - math.pi / 2], [thetad], [thetadd])
        assert_close(tau, [0], 1e-14)


class TestNFourBar:
    def test_stiffness_of_one_square(self):
        """J = 5/3 kg m^2 and PE = 2 g sin theta for N = 1."""
        with mp.workdps(30):
            assert_close(oracles.n_four_bar_stiffness(1), mpf(6) * G / 5, 1e-29)

    @pytest.mark.parametrize("N", [1, 2, 40])
    def test_starts_upright_and_returns_after_a_turn(self, N):
        kappa = oracles.n_four_bar_stiffness(N)
        with mp.workdps(40):
            turn = 4 * mpmath.ellipk(4 * kappa / (1 + 4 * kappa)) / mpmath.sqrt(1 + 4 * kappa)
            for turns in (0, 1, 10):
                state = oracles.n_four_bar_exact(N, turns * turn)
                assert_close(state, [mp.pi / 2 - 2 * turns * mp.pi, -1], 1e-27)
            theta, thetad = oracles.n_four_bar_exact(N, turn / 2)
            assert_close([theta, thetad], [-mp.pi / 2, -mpmath.sqrt(1 + 4 * kappa)], 1e-27)

    @each("N", [1, 2, 40])
    @each("t", [0.2, 1.3, 10.0])
    def test_keeps_its_equation_of_motion_and_its_energy(self, N, t):
        kappa = oracles.n_four_bar_stiffness(N, digits=60)

        def motion(t):
            return oracles.n_four_bar_exact(N, t, digits=60)

        with mp.workdps(60):
            theta, thetad = motion(t)
            thetadd = -kappa * mpmath.cos(theta)
            assert_close(slope(motion, t), [thetad, thetadd], 1e-25)
            assert_close(thetad**2 / 2 + kappa * mpmath.sin(theta), kappa + 0.5, 1e-40)

    def test_equals_an_integration_of_its_equation_of_motion(self):
        """Taylor series of theta' = w, w' = -kappa c, c' = -s w, s' = c w, in steps of 1/50 s."""
        with mp.workdps(40):
            kappa = oracles.n_four_bar_stiffness(2)
            theta, w, h, order = mp.pi / 2, mpf(-1), mpf(1) / 50, 30
            for _ in range(100):
                th, ws, c, s = [theta], [w], [mpmath.cos(theta)], [mpmath.sin(theta)]
                for n in range(order):
                    th.append(ws[n] / (n + 1))
                    ws.append(-kappa * c[n] / (n + 1))
                    c_next = -mpmath.fdot(s[: n + 1], ws[n::-1]) / (n + 1)
                    s_next = mpmath.fdot(c[: n + 1], ws[n::-1]) / (n + 1)
                    c.append(c_next)
                    s.append(s_next)
                theta, w = mpmath.polyval(th[::-1], h), mpmath.polyval(ws[::-1], h)
            assert_close(oracles.n_four_bar_exact(2, 2), [theta, w], 1e-20)

    def test_one_square_is_a_parallelogram_four_bar(self):
        rod = (1.0, 1.0, 0.5, 1.0 / 12)
        p = oracles.FourBar(*rod, *rod, *rod, d=1.0, e=0.0, g=G)
        theta1 = 1.1
        theta1dd = oracles.four_bar_reduced_acceleration(p, theta1, -2.0, 0.0)
        assert_close(theta1dd, -float(oracles.n_four_bar_stiffness(1)) * math.cos(theta1))
