"""The evaluators of dy/dt against each other and against the oracles; the projection."""

import math
from functools import cache

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT, TWO_LINK
from each_case import each
from scipy.integrate import solve_ivp

import oracles
from random_mechanisms import (
    LOOPS,
    Shape,
    mechanism,
    seeded_scene,
    seeded_tree,
)
from robodyn import assemble, closure_gap, closure_jacobian, load, loop_velocities, simulate
from robodyn.dynamics import dense_dynamics
from robodyn.dynamics.closed_form import mass_matrix
from robodyn.dynamics.dynamics import forward_dynamics
from robodyn.loops.assembly import close_positions
from robodyn.loops.closures import closure_bias
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation, expressions
from robodyn.runs.right_hand_side import RightHandSide, right_hand_side

KINDS = ("straight-line", "dense")
EACH_KIND = each("kind", KINDS)


def sides(mech, source=None, **options):
    """The evaluators of a mechanism, by name."""
    source = source or Actuation((0.0,) * mech.n)
    return {kind: right_hand_side(mech, source, kind=kind, **options) for kind in KINDS}


def projection(mech, kind):
    """The projection of one of the evaluators."""
    return right_hand_side(mech, Actuation((0.0,) * mech.n), kind=kind).projection


def rates(side: RightHandSide, t, y):
    found = np.asarray(side.rates(t, y), float)
    assert found.shape == y.shape
    return found


def torque(mech):
    """An expression of time and state for each actuated joint."""
    n = mech.n
    return ", ".join(
        f"3*sin(2*t + {k}) - 0.4*qd{k % n + 1} + q{n - k % n}" for k in range(len(mech.actuated))
    )


def state(scene, work=False):
    return np.concatenate([scene.q, scene.qd, [0.25] * work])


def check_agreement(scene, **options):
    """All three to 1e-12 of the largest acceleration, with and without torque and work."""
    mech = scene.mechanism
    driven = actuation.expressions(mech, torque(mech), "tau")
    for source in (Actuation((0.0,) * mech.n), driven):
        for work in (False, True):
            y = state(scene, work)
            found = {
                kind: rates(side, 0.7, y)
                for kind, side in sides(mech, source, work=work, **options).items()
            }
            size = max(1.0, np.abs(found["dense"]).max()) * condition(scene)
            for kind in KINDS:
                assert found[kind][: mech.n] == pytest.approx(scene.qd, abs=1e-12 * size)
                assert found[kind] == pytest.approx(found["dense"], abs=1e-12 * size)


def condition(scene):
    """How much rounding can grow in the solve: the spread of the mass matrix."""
    M = mass_matrix(scene.mechanism, scene.q)
    scale = np.sqrt(M.diagonal())
    return np.linalg.cond(M / scale / scale[:, None])


class TestEvaluatorsAgree:
    @pytest.mark.parametrize("n", [12, 20])
    def test_on_larger_trees(self, n):
        check_agreement(seeded_tree(n, n))

    @each("name", LOOPS)
    def test_with_baumgarte(self, name):
        check_agreement(seeded_scene(1, LOOPS[name]), baumgarte=7.0)

    @each("name", LOOPS)
    def test_with_baumgarte_on_open_loops(self, name):
        """Off the closures the restoring terms act: in all three alike."""
        scene = seeded_scene(2, LOOPS[name])
        mech, rng = scene.mechanism, np.random.default_rng(0)
        y = state(scene) + 1e-2 * rng.normal(size=2 * mech.n)
        found = {k: rates(s, 0.0, y) for k, s in sides(mech, baumgarte=9.0).items()}
        size = np.abs(found["dense"]).max() * condition(scene)
        for kind in KINDS:
            assert found[kind] == pytest.approx(found["dense"], abs=1e-12 * size)

    def test_the_dense_one_is_the_public_forward_dynamics(self):
        scene = seeded_scene(3, LOOPS["five-bar"])
        mech = scene.mechanism
        tau = [2.0, 0.0, -1.0, 0.0]
        side = right_hand_side(mech, Actuation(tuple(tau)), kind="dense")
        expected = forward_dynamics(mech, scene.q, scene.qd, tau)
        assert rates(side, 0.0, state(scene))[mech.n :] == pytest.approx(expected, rel=1e-10)


class TestAgainstOracles:
    Q, QD, TAU = np.array([0.4, -1.1]), np.array([1.5, -2.0]), np.array([0.7, -0.3])

    @EACH_KIND
    def test_2r(self, kind):
        side = right_hand_side(load(ROOT / "robots/2r.yaml"), Actuation((0.7, -0.3)), kind=kind)
        found = rates(side, 0.0, np.concatenate([self.Q, self.QD]))
        qdd = oracles.two_link_acceleration(TWO_LINK, self.Q, self.QD, self.TAU)
        assert found == pytest.approx(np.concatenate([self.QD, qdd]), rel=1e-13)

    @EACH_KIND
    @each("theta", [0.3, 2.0, 4.5])
    def test_four_bar(self, kind, theta):
        q = oracles.four_bar_position(FOUR_BAR, theta)
        k, _ = oracles.four_bar_coefficients(FOUR_BAR, q)
        qd = 3.0 * k
        mech = load(ROOT / "robots/four-bar.yaml")
        side = right_hand_side(mech, Actuation((1.2, 0.0, 0.0)), kind=kind)
        qdd, _ = oracles.four_bar_acceleration(FOUR_BAR, q, qd, np.array([1.2, 0, 0]))
        found = rates(side, 0.0, np.concatenate([q, qd]))
        assert found[3:] == pytest.approx(qdd, abs=1e-12 * np.abs(qdd).max())

    @EACH_KIND
    def test_baumgarte_is_the_equation_that_it_says(self, kind):
        """Psi qdd + Psidot qd = -2 b Psi qd - b^2 gap, and M qdd - f in the range of Psi^T."""
        q = oracles.four_bar_position(FOUR_BAR, 1.0) + np.array([0.01, -0.02, 0.015])
        qd = np.array([2.0, -1.0, 0.5])
        tau, b = np.array([0.8, 0.0, 0.0]), 6.0
        mech = load(ROOT / "robots/four-bar.yaml")
        side = right_hand_side(mech, Actuation(tuple(tau)), baumgarte=b, kind=kind)
        qdd = rates(side, 0.0, np.concatenate([q, qd]))[3:]
        M, C, G, gap, Psi, Psidot = oracles.four_bar_terms(FOUR_BAR, q, qd)
        wanted = -2 * b * Psi @ qd - b**2 * gap
        assert Psi @ qdd + Psidot @ qd == pytest.approx(wanted, abs=1e-11)
        unbalanced = M @ qdd + C @ qd + G - tau
        free = np.cross(*Psi)  # the direction that no pin force pushes along
        assert unbalanced @ free == pytest.approx(0.0, abs=1e-11)

    @EACH_KIND
    def test_work_is_the_power_of_torques_less_dampers(self, kind):
        scene = seeded_scene(5, LOOPS["loop in a tree"])
        mech = scene.mechanism
        side = right_hand_side(
            mech, actuation.expressions(mech, torque(mech), "tau"), work=True, kind=kind
        )
        found = rates(side, 0.3, state(scene, True))[-1]
        q, qd = (dict(enumerate(x.tolist(), 1)) for x in (scene.q, scene.qd))
        n, power = mech.n, 0.0
        for k, joint in enumerate(mech.actuated):
            tau = 3 * math.sin(0.6 + k) - 0.4 * qd[k % n + 1] + q[n - k % n]
            power += tau * scene.qd[joint]
        power -= sum(
            link.damping * rate**2
            for link, rate in zip(mech.description.links, scene.qd, strict=True)
        )
        assert any(link.damping for link in mech.description.links)
        assert found == pytest.approx(power, rel=1e-12)

    @EACH_KIND
    def test_a_torque_outside_its_domain_is_no_number(self, kind):
        """The integrator must see that, and try a shorter step: no exception."""
        for name in ("2r", "four-bar"):
            mech = load(ROOT / f"robots/{name}.yaml")
            for text in ("sqrt(1 - t)", "1/(2 - t)", "exp(1000*t)", "(1 - t)**0.5"):
                source = actuation.expressions(mech, ", ".join([text] * len(mech.actuated)), "tau")
                side = right_hand_side(mech, source, work=True, kind=kind)
                q = [0.1, 0.2] if mech.n == 2 else oracles.four_bar_position(FOUR_BAR, 1.0)
                y = np.concatenate([q, np.zeros(mech.n), [0.0]])
                found = rates(side, 2.0, y)
                assert not np.isfinite(found).all()
                assert np.isfinite(rates(side, 0.5, y)).all()

    @EACH_KIND
    @each("bad", [math.nan, math.inf, 1e308])
    def test_a_state_beyond_the_floats_is_no_number(self, kind, bad):
        for name in ("2r", "four-bar"):
            mech = load(ROOT / f"robots/{name}.yaml")
            side = right_hand_side(mech, Actuation((0.0,) * mech.n), kind=kind)
            q = [0.1, 0.2] if mech.n == 2 else oracles.four_bar_position(FOUR_BAR, 1.0)
            y = np.concatenate([q, np.zeros(mech.n)])
            y[mech.n] = bad
            with np.errstate(all="ignore"):
                found = rates(side, 0.0, y)
            assert not np.isfinite(found).all()


N_FOUR_BAR = """
gravity: 9.81
links:
  - {{name: v0, m: 1, l: 1, r: 0.5, I: 0.08}}
{links}
closures:
{closures}
actuated: [v0]
"""


def n_four_bar(N):
    """N squares in a row: verticals v0.. from the ground, horizontals h1.. between their tips."""
    links, closures = [], []
    for k in range(1, N + 1):
        hangs = f"v{k - 1}"
        links.append(f"  - {{name: h{k}, m: 1, l: 1, r: 0.5, I: 0.08, from: {hangs}}}")
        links.append(f"  - {{name: v{k}, m: 1, l: 1, r: 0.5, I: 0.08, from: [{k}, 0]}}")
        closures.append(f"  - [h{k}, v{k}]")
    return mechanism(N_FOUR_BAR.format(links="\n".join(links), closures="\n".join(closures)))


def n_four_bar_state(N, theta, rate):
    """q and qd with all verticals parallel."""
    q, qd = [theta], [rate]
    for _ in range(N):
        q += [-theta, theta]
        qd += [-rate, rate]
    return np.array(q + qd)


class TestSwitches:
    def kind(self, mech):
        return right_hand_side(mech, Actuation((0.0,) * mech.n)).kind

    @pytest.mark.parametrize(
        "name", ["2r", "3r", "pendulum", "four-bar", "slider-crank", "five-bar", "parallelogram"]
    )
    def test_the_examples_are_straight_lines(self, name):
        assert self.kind(load(ROOT / f"robots/{name}.yaml")) == "straight-line"

    def test_long_chains_are_dense(self):
        chains = {n: seeded_scene(0, Shape((None, *range(n - 1)))).mechanism for n in (6, 24, 40)}
        assert [self.kind(mech) for mech in chains.values()] == ["straight-line"] * 2 + ["dense"]

    def test_many_loops_are_straight_lines(self):
        assert self.kind(n_four_bar(2)) == "straight-line"
        assert self.kind(n_four_bar(100)) == "straight-line"

    def test_a_massless_link_is_dense(self):
        scene = seeded_scene(0, LOOPS["four-bar"], massless=(1,))
        assert self.kind(scene.mechanism) == "dense"
        assert not dense_dynamics.elimination_is_safe(scene.mechanism)

    def test_a_kind_that_is_asked_for_is_taken(self):
        mech = load(ROOT / "robots/four-bar.yaml")
        for kind in KINDS:
            assert right_hand_side(mech, Actuation((0.0,) * 3), kind=kind).kind == kind

    @pytest.mark.parametrize("N", [1, 3, 30])
    def test_whatever_the_kind_the_motion_is_the_same(self, N):
        """N squares move as one: thetadd = -kappa cos theta."""
        mech = n_four_bar(N)
        theta, rate = 1.1, -0.7
        kappa = (3 * N + 1) / 2 * 9.81 / ((N + 1) * (0.25 + 0.08) + N)  # I = 0.08, not 1/12
        y = n_four_bar_state(N, theta, rate)
        for kind in KINDS:
            side = right_hand_side(mech, Actuation((0.0,) * mech.n), kind=kind)
            found = rates(side, 0.0, y)[mech.n :]
            thetadd = -kappa * math.cos(theta)
            expected = [thetadd, *[-thetadd, thetadd] * N]
            assert found == pytest.approx(expected, abs=1e-10)


class TestProjection:
    """Onto the nearest state that closes."""

    def off(self, name, size, seed=0):
        scene = seeded_scene(seed, LOOPS[name])
        rng = np.random.default_rng(seed)
        return scene, state(scene) + size * rng.normal(size=2 * scene.n)

    @EACH_KIND
    def test_an_open_tree_has_none(self, kind):
        mech = seeded_tree(0, 4).mechanism
        assert right_hand_side(mech, Actuation((0.0,) * 4), kind=kind).projection is None

    @EACH_KIND
    @each("name", LOOPS)
    def test_closes_positions_and_rates(self, kind, name):
        for seed in range(3):
            scene, y = self.off(name, 1e-3, seed)
            mech, n = scene.mechanism, scene.n
            given_state = y.copy()
            found = projection(mech, kind)(0.0, y)
            assert np.array_equal(y, given_state)
            assert np.abs(closure_gap(mech, y[:n])).max() > 1e-5
            assert np.abs(closure_gap(mech, found[:n])).max() < 2e-14
            rate = closure_jacobian(mech, found[:n]) @ found[n:]
            assert np.abs(rate).max() < 1e-13 * max(1.0, np.abs(found[n:]).max()) * n

    @EACH_KIND
    @each("name", LOOPS)
    def test_moves_no_more_than_it_must(self, kind, name):
        """Across the closures, not along the freedoms: the rates exactly, the angles in first
        order."""
        scene, y = self.off(name, 1e-5)
        n = scene.n
        found = projection(scene.mechanism, kind)(0.0, y)
        Psi = closure_jacobian(scene.mechanism, found[:n])
        freedoms = np.eye(n) - np.linalg.pinv(Psi) @ Psi
        moved = y - found
        assert np.abs(freedoms @ moved[:n]).max() < 1e-8
        assert np.abs(moved[:n]).max() > 1e-7
        nearest = y[n:] - np.linalg.pinv(Psi) @ (Psi @ y[n:])
        assert found[n:] == pytest.approx(nearest, abs=1e-8)

    @each("name", LOOPS)
    def test_all_kinds_find_the_same_state(self, name):
        scene, y = self.off(name, 1e-6)
        found = {kind: side.projection(0.0, y) for kind, side in sides(scene.mechanism).items()}
        for kind in KINDS:
            assert found[kind] == pytest.approx(found["dense"], abs=1e-10)

    @EACH_KIND
    @each("name", LOOPS)
    def test_what_is_closed_stays(self, kind, name):
        scene, y = self.off(name, 1e-3)
        project = projection(scene.mechanism, kind)
        once = project(0.0, y)
        assert project(0.0, once) == pytest.approx(once, abs=2e-14 * max(1.0, np.abs(once).max()))

    @EACH_KIND
    def test_the_work_is_left_alone(self, kind):
        scene, y = self.off("four-bar", 1e-3)
        side = right_hand_side(scene.mechanism, Actuation((1.0, 0.0, 0.0)), work=True, kind=kind)
        found = side.projection(0.0, np.append(y, 0.375))
        assert found[-1] == 0.375
        assert found[:-1] == pytest.approx(side.projection(0.0, y), abs=1e-15)

    @EACH_KIND
    def test_turns_are_kept(self, kind):
        """An angle of many revolutions stays where it is."""
        scene = seeded_scene(0, LOOPS["four-bar"])
        turns = 2 * math.pi * np.array([7.0, -3.0, 12.0])
        y = state(scene) + np.concatenate([turns + 1e-4, np.zeros(3)])
        found = projection(scene.mechanism, kind)(0.0, y)
        assert found[:3] == pytest.approx(y[:3], abs=2e-3)

    @EACH_KIND
    def test_closures_that_depend_on_one_another(self, kind):
        """A parallelogram with a third crank: as near as one gets, no division by zero."""
        mech = mechanism(
            """
links:
  - {name: crank, m: 0.45, l: 0.3, r: 0.14, I: 0.0041}
  - {name: coupler, m: 1.1, l: 0.7, r: 0.36, I: 0.049}
  - {name: rocker, m: 0.55, l: 0.3, r: 0.16, I: 0.0052, from: [0.7, 0.0]}
  - {name: third, m: 0.35, l: 0.3, r: 0.13, I: 0.0031, from: [0.4, 0.0]}
closures: [[coupler, rocker], [{link: coupler, at: [0.4, 0]}, third]]
actuated: [crank]
"""
        )
        y = np.array([1.0, -1.0, 1.0, 1.0, 2.0, -2.0, 2.0, 2.0])
        side = right_hand_side(mech, Actuation((0.0,) * 4), kind=kind)
        found = side.projection(0.0, y + 1e-6 * np.arange(8.0))
        assert np.abs(closure_gap(mech, found[:4])).max() < 1e-14
        assert found == pytest.approx(y, abs=2e-5)
        reduced = 0.0041 + 0.45 * 0.14**2 + 1.1 * 0.3**2 + 0.0052 + 0.55 * 0.16**2
        reduced += 0.0031 + 0.35 * 0.13**2
        assert rates(side, 0.0, y)[4:] == pytest.approx(np.zeros(4), abs=1e-9)
        driven = right_hand_side(mech, Actuation((0.5, 0.0, 0.0, 0.0)), kind=kind)
        thetadd = 0.5 / reduced
        expected = thetadd * np.array([1.0, -1.0, 1.0, 1.0])
        assert rates(driven, 0.0, y)[4:] == pytest.approx(expected, rel=1e-9)


class TestNearSingular:
    """At d from a change point a gap of e would err by e/d in the accelerations."""

    @staticmethod
    def exact(kind, theta):
        """The parallelogram as one link: (I1 + I3 + m2 l^2) thetadd = -W cos(theta)."""
        mech = load(ROOT / "robots/parallelogram.yaml")
        crank, coupler, rocker = mech.description.links
        inertia = sum(x.I + x.m * abs(x.r) ** 2 for x in (crank, rocker)) + coupler.m * crank.l**2
        weight = (crank.m * crank.r + rocker.m * rocker.r + coupler.m * crank.l).real
        thetadd = -9.81 * weight * math.cos(theta) / inertia
        side = right_hand_side(mech, Actuation((0.0,) * 3), kind=kind)
        return side, thetadd * np.array([1.0, -1.0, 1.0])

    @EACH_KIND
    @each("d", [0.1, 1e-2, 1e-4, 1e-8, 0.0, -1e-5])
    def test_the_accelerations_of_the_branch(self, kind, d):
        side, expected = self.exact(kind, d)
        y = np.array([d, -d, d, 3.0, -3.0, 3.0])
        assert rates(side, 0.0, y)[3:] == pytest.approx(expected, rel=1e-11)

    @EACH_KIND
    @pytest.mark.parametrize("d", [1e-2, 1e-4])
    def test_a_state_off_the_closures_is_brought_back(self, kind, d):
        """By the last step of a loose tolerance, say: its error is that of the state, no more."""
        side, expected = self.exact(kind, d)
        y = np.array([d, -d, d, 3.0, -3.0, 3.0])
        strayed = y + 1e-6 * np.array([1.0, -0.5, 0.25, 2.0, 1.0, -1.0])
        assert rates(side, 0.0, strayed)[3:] == pytest.approx(expected, abs=1e-4)
        closed = side.projection(0.0, strayed)
        assert closed == pytest.approx(y, abs=1e-5)
        assert np.ptp(closed[:3] * [1, -1, 1]) < 1e-12

    @EACH_KIND
    @pytest.mark.parametrize("bend", [0.25, 0.5])
    def test_a_torque_that_bends_beside_it(self, kind, bend):
        """The bend stays outside of what is interpolated: 0.5 of the torque acts at q1 = 0."""
        mech = load(ROOT / "robots/parallelogram.yaml")
        torque = expressions(mech, f"0.5 if q1 < {bend} else 0.5 + 4*(q1 - {bend})", "test")
        constant = Actuation((0.5, 0.0, 0.0))
        y = np.array([1e-4, -1e-4, 1e-4, 3.0, -3.0, 3.0])
        found = rates(right_hand_side(mech, torque, kind=kind), 0.0, y)
        expected = rates(right_hand_side(mech, constant, kind=kind), 0.0, y)
        assert found == pytest.approx(expected, rel=1e-10)

    @EACH_KIND
    @pytest.mark.parametrize("mismatch", [1e-3, 1e-6])
    def test_a_loop_that_turns_off_is_not_led_across(self, kind, mismatch):
        """Lengths that nearly make a change point: the acceleration is that of this branch."""
        text = (ROOT / "robots/parallelogram.yaml").read_text()
        shorter = text.replace("l: 0.3, r: 0.14", f"l: {0.3 - mismatch!r}, r: 0.14")
        assert shorter != text
        mech = mechanism(shorter)
        q = close_positions(mech, [1e-3, -1e-3, 1e-3], fixed=[0], t=0.0)
        qd = loop_velocities(mech, q, [3.0])
        side = right_hand_side(mech, Actuation((0.0,) * 3), kind=kind)
        found = rates(side, 0.0, np.concatenate([q, qd]))[3:]
        slope = closure_jacobian(mech, q) @ found + closure_bias(mech, q, qd, t=0.0)
        assert np.abs(slope).max() < 1e-10 * np.abs(found).max()

    @EACH_KIND
    def test_at_the_change_point_itself(self, kind):
        """All links in line: the parallelogram's own acceleration is one of many; no nan."""
        mech = load(ROOT / "robots/parallelogram.yaml")
        side = right_hand_side(mech, Actuation((0.0,) * 3), kind=kind)
        found = rates(side, 0.0, np.array([0.0, 0.0, 0.0, 3.0, -3.0, 3.0]))
        assert np.isfinite(found).all()
        assert side.projection(0.0, np.zeros(6)) == pytest.approx(np.zeros(6), abs=1e-12)


@cache
def one_link(torque, inertia, weight):
    """The angle and rate of a link after 0.3 s."""
    applied = expressions(mechanism("links: [{name: a, m: 1, l: 1, r: 0, I: 1}]\n"), torque, "t")
    tau = applied.function(1)

    def rates(t, y):
        return [y[1], (tau(t, y)[0] - 9.81 * weight * math.cos(y[0])) / inertia]

    found = solve_ivp(rates, (0.0, 0.3), [2.5, 6.0], rtol=1e-11, atol=1e-11, max_step=1e-3)
    return found.y[:, -1]


@pytest.mark.parametrize(
    ("torque", "method"),
    [
        ("3*max(0, sin(q1))", "DOP853"),
        ("2*sign(sin(q1))", "DOP853"),
        ("2*tanh(50*sin(q1))", "DOP853"),
        ("2*tanh(50*sin(q1))", "taylor"),
    ],
)
def test_a_torque_that_bends_at_the_change_point(torque, method):
    """A parallelogram is one link: (I1 + I3 + m2 l^2) qdd = tau - W cos q, whatever tau does."""
    mech = load(ROOT / "robots/parallelogram.yaml")
    crank, coupler, rocker = mech.description.links
    inertia = sum(x.I + x.m * abs(x.r) ** 2 for x in (crank, rocker)) + coupler.m * crank.l**2
    weight = (crank.m * crank.r + rocker.m * rocker.r + coupler.m * crank.l).real
    exact = one_link(torque, inertia, weight)
    start, speeds = np.array([2.5, -2.5, 2.5]), np.array([6.0, -6.0, 6.0])
    motion = simulate(
        mech, start, speeds, 0.3, tau=torque, method=method, rtol=1e-10, atol=1e-10, t_eval=[0.3]
    )
    assert motion.q[0, 0] == pytest.approx(exact[0], abs=1e-6)
    assert motion.qd[0, 0] == pytest.approx(exact[1], abs=1e-5)


def test_the_nearest_rates_are_so_in_the_sizes_of_angles_and_displacements():
    """By dense algebra they are nearest where displacements count in parts of the mechanism's size.

    With W^-1 = diag(u^2), u that size for displacements and 1 for angles, they are
    qd - W^-1 Psi^T (Psi W^-1 Psi^T)^-1 Psi qd.
    """
    mech = load(ROOT / "robots/hydraulic-boom.yaml")
    q = assemble(mech, [0.5])
    qd = np.linspace(1.0, -2.0, mech.n)
    nearest = projection(mech, "dense")
    rates = nearest(0.0, np.concatenate([q, qd]))[mech.n :]
    Psi, scale = closure_jacobian(mech, q), np.diag(mech.arrays.units**2)
    pull = scale @ Psi.T
    expected = qd - pull @ np.linalg.solve(Psi @ pull, Psi @ qd)
    assert rates == pytest.approx(expected, rel=1e-9)
    assert mech.arrays.units.max() != mech.arrays.units.min()
