"""Closing loops: positions, rates and accelerations, both branches, and what cannot be closed."""

import itertools
import os
import re

import numpy as np
import pytest
from conftest import ROOT
from each_case import each
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from sliding_scenes import BARREL, LEVER, SCISSORS, STARTED

import oracles
from random_mechanisms import (
    DYADIC,
    LOOPS,
    Pose,
    Shape,
    assert_close,
    mechanism,
    oracle_closures,
    oracle_tree,
    seeded_scene,
    sizes,
)
from robodyn.dynamics import closed_form as cf
from robodyn.errors import AssemblyError, InputError, RobodynError, SingularError
from robodyn.loops import assembly, closures, loop_rates
from robodyn.mechanics.mechanism import load
from robodyn.runs.simulation import simulate

SEEDS = range(8)
FRESH = bool(os.environ.get("FRESH"))  # as `make hard` has it: more of the slow
BRANCHES = ("open", "crossed")
FOUR_BAR = oracles.FourBar(
    *(0.6, 0.35, 0.15, 0.008),
    *(1.3, 0.95, 0.45, 0.102),
    *(1.0, 0.80, 0.36, 0.061),
    *(1.1, 0.07),
)
FAR_LINK = LOOPS["six-bar driven from its far link"]


def four_bar(l1, l2, l3, d, e=0.0, closure="[coupler, rocker]", actuated="crank"):
    return mechanism(
        "gravity: 9.81\n"
        "links:\n"
        f"  - {{name: crank, m: 0.6, l: {l1}, r: 0.15, I: 0.008}}\n"
        f"  - {{name: coupler, m: 1.3, l: {l2}, r: 0.45, I: 0.102}}\n"
        f"  - {{name: rocker, m: 1.0, l: {l3}, r: 0.36, I: 0.061, from: [{d}, {e}]}}\n"
        f"closures: [{closure}]\n"
        f"actuated: [{actuated}]\n"
    )


def slider_crank(crank, rod, y, along="[1, 0]", actuated="crank"):
    return mechanism(
        "links:\n"
        f"  - {{name: crank, m: 0.8, l: {crank}, r: 0.045, I: 0.0009}}\n"
        f"  - {{name: rod, m: 0.5, l: {rod}, r: 0.14, I: 0.0048, payload: 0.7}}\n"
        f"closures: [{{point: rod, on: {{through: [0, {y}], along: {along}}}}}]\n"
        f"actuated: [{actuated}]\n"
    )


def lecture_four_bar(**changes):
    p = FOUR_BAR
    return four_bar(p.l1, p.l2, p.l3, p.d, p.e, **changes)


def turn(angle):
    """The angle less whole turns, in [-pi, pi]."""
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi


def driven(mech, values):
    """The entries of the actuated joints."""
    return np.asarray(values)[..., list(mech.actuated)]


def gaps(mech, q):
    """Distance of each closure's points, m; for a slider the distance from its line."""
    pose = Pose(oracle_tree(mech.description), q)
    pairs = oracle_closures(mech.description)
    found = []
    for closure, (first, second) in zip(mech.description.closures, pairs, strict=True):
        gap = pose.position(first) - pose.position(second)
        if closure.along is not None:
            gap = (np.conj(1j * closure.along) * gap).real
        found.append(abs(gap))
    return np.array(found)


def left_of(a, d, p):
    """Whether p lies to the left of the line from a to d."""
    return ((d - a).conjugate() * (p - a)).imag > 0.0


def branches_of(mech, q):
    """The branches that lead to the closed configuration q (all of them tried), at most one."""
    found = []
    for choice in itertools.product(BRANCHES, repeat=len(mech.description.closures)):
        closed, missing = assembly.attempt(mech, driven(mech, q), choice, t=0.0)
        if missing <= 0.0 and np.abs(turn(closed - q)).max() < 1e-9:
            found.append(choice)
    return found


class TestBranches:
    """open: the pin P to the left of the line from A, the joint of the side named first, to D."""

    ANGLES = np.linspace(-np.pi, np.pi, 100)

    @pytest.mark.parametrize("branch", BRANCHES)
    def test_four_bar_equals_freudenstein(self, branch):
        q = assembly.assemble(lecture_four_bar(), self.ANGLES[:, None], [branch], t=0.0)
        expected = [oracles.four_bar_position(FOUR_BAR, theta, branch) for theta in self.ANGLES]
        assert_close(turn(q - expected), np.zeros_like(q), 2 * np.pi)
        assert np.array_equal(q[:, 0], self.ANGLES)

    @pytest.mark.parametrize("branch", BRANCHES)
    @pytest.mark.parametrize("closure", ["[coupler, rocker]", "[rocker, coupler]"])
    def test_four_bar_by_the_triangle(self, branch, closure):
        """Naming the rocker first makes A its pivot and D the crank's tip."""
        mech = lecture_four_bar(closure=closure)
        for theta in self.ANGLES:
            q = assembly.assemble(mech, [theta], [branch], t=0.0)
            pose = Pose(oracle_tree(mech.description), q)
            A, D, P = pose.joints[1], pose.joints[2], pose.position((2, FOUR_BAR.l3))
            if closure == "[rocker, coupler]":
                A, D = D, A
            assert left_of(A, D, P) == (branch == "open")

    @pytest.mark.parametrize("branch", BRANCHES)
    def test_rocker_driven_four_bar_by_the_triangle(self, branch):
        """Crank and coupler are unknown: A the crank's pivot, P the joint between, D the pin."""
        mech = lecture_four_bar(actuated="rocker")
        for rocker in np.linspace(1.8, 2.4, 10):
            q = assembly.assemble(mech, [rocker], [branch], t=0.0)
            pose = Pose(oracle_tree(mech.description), q)
            A, P, D = pose.joints[0], pose.joints[1], pose.position((2, FOUR_BAR.l3))
            assert left_of(A, D, P) == (branch == "open")

    @each("branch", BRANCHES)
    @each("seed", SEEDS)
    @each(
        ("name", "corners"),
        [
            ("four-bar", ("joint 1", "joint 2", "pin")),
            ("four-bar driven by its coupler joint", ("joint 0", "joint 2", "pin")),
            ("five-bar", ("joint 1", "joint 3", "pin")),
            ("chain closed to the ground", ("joint 1", "pin", "joint 2")),
        ],
    )
    def test_random_loops_by_the_triangle(self, name, corners, seed, branch):
        """A, D and P wherever on the links they are; of a chain, P is its middle joint."""
        scene = seeded_scene(seed, LOOPS[name])
        mech = scene.mechanism
        q, missing = assembly.attempt(mech, driven(mech, scene.q), [branch], t=0.0)
        assert missing <= 0.0
        pose = Pose(oracle_tree(mech.description), q)
        pin, _ = oracle_closures(mech.description)[0]
        points = {f"joint {k}": joint for k, joint in enumerate(pose.joints)}
        points["pin"] = pose.position(pin)
        assert left_of(*(points[corner] for corner in corners)) == (branch == "open")

    @each("branch", BRANCHES)
    @each("along", ["[1, 0]", "[-2, 0]", "[1, 1]", "[0, -3]"])
    def test_slider_lies_ahead_of_or_behind_the_crank(self, branch, along):
        mech = slider_crank(0.1, 0.32, 0.02, along)
        direction = mech.description.closures[0].along
        for theta in self.ANGLES:
            q = assembly.assemble(mech, [theta], [branch], t=0.0)
            pose = Pose(oracle_tree(mech.description), q)
            piston = pose.position((1, 0.32)) - pose.joints[1]
            assert ((np.conj(direction) * piston).real > 0.0) == (branch == "open")

    @pytest.mark.parametrize("branch", BRANCHES)
    def test_slider_crank_in_closed_form(self, branch):
        """x = r cos theta +- sqrt(l^2 - (y - r sin theta)^2) of the offset slider-crank."""
        mech = slider_crank(0.1, 0.32, 0.02)
        q = assembly.assemble(mech, self.ANGLES[:, None], [branch], t=0.0)
        side = 1.0 if branch == "open" else -1.0
        drop = 0.02 - 0.1 * np.sin(self.ANGLES)
        x = 0.1 * np.cos(self.ANGLES) + side * np.sqrt(0.32**2 - drop**2)
        tips = cf.point_motion(mech, mech.tips, q)[0][:, 1]
        assert_close(tips, np.stack([x, np.full_like(x, 0.02)], axis=-1), 0.42)

    def test_the_scene_chooses_the_branch_where_none_is_given(self):
        text = seeded_scene(1, LOOPS["four-bar"]).text
        q = seeded_scene(1, LOOPS["four-bar"]).q
        for branch in BRANCHES:
            mech = mechanism(text + f"assembly: {branch}\n")
            expected = assembly.assemble(mech, [q[0]], [branch], t=0.0)
            assert np.array_equal(assembly.assemble(mech, [q[0]], t=0.0), expected)


class TestPositions:
    @each("name", DYADIC)
    @each("seed", SEEDS)
    def test_a_closed_configuration_is_found_by_one_choice_of_branches(self, name, seed):
        """Loops closed by construction: at points of links, to the ground, on lines, in a row."""
        scene = seeded_scene(seed, DYADIC[name])
        mech = scene.mechanism
        (choice,) = branches_of(mech, scene.q)
        q = assembly.assemble(mech, driven(mech, scene.q), choice, t=0.0)
        assert np.array_equal(driven(mech, q), driven(mech, scene.q))
        assert_close(turn(q - scene.q), np.zeros(scene.n), 2 * np.pi, 1e-13)

    @each("name", DYADIC)
    @each("seed", SEEDS)
    def test_every_branch_that_closes_is_closed(self, name, seed):
        scene = seeded_scene(seed, DYADIC[name])
        mech, size = scene.mechanism, sizes(scene.mechanism.description).loop
        angles = np.linspace(-np.pi, np.pi, 12)[:, None] + driven(mech, scene.q)
        for choice in itertools.product(BRANCHES, repeat=len(mech.description.closures)):
            q, missing = assembly.attempt(mech, angles, choice, t=0.0)
            assert np.isfinite(missing).all()
            for state in q[missing <= 0.0]:
                assert_close(gaps(mech, state), np.zeros(len(choice)), size, 1e-14)
                assert np.abs(state[list(mech.passive)]).max() <= np.pi

    @pytest.mark.parametrize("shape", [(), (1,), (0,), (4, 0), (2, 3)])
    def test_leading_axes(self, shape):
        scene = seeded_scene(3, LOOPS["five-bar"])
        mech = scene.mechanism
        count = int(np.prod(shape))
        angles = driven(mech, scene.q) + np.linspace(0.0, 0.05, max(count, 1))[:, None]
        flat = assembly.assemble(mech, angles, branches_of(mech, scene.q)[0], t=0.0)
        shaped = assembly.assemble(
            mech, angles[:count].reshape(*shape, 2), branches_of(mech, scene.q)[0], t=0.0
        )
        assert np.array_equal(shaped, flat[:count].reshape(*shape, 4))

    @pytest.mark.parametrize("branch", BRANCHES)
    def test_a_passive_hub_turns_what_is_driven_on_it(self, branch):
        """An arm of 1 m driven from a passive hub on its own pivot, its tip on Y = 0.3."""
        mech = mechanism(
            "links:\n"
            "  - {name: hub, m: 1, l: 0.5, r: 0.1, I: 0.1}\n"
            "  - {name: arm, m: 1, l: 1, r: 0.5, I: 0.1, from: {link: hub, at: [0, 0]}}\n"
            "closures: [{point: arm, on: {through: [0, 0.3], along: [1, 0]}}]\n"
            "actuated: [arm]\n"
        )
        hub, arm = assembly.assemble(mech, [0.4], [branch], t=0.0)
        expected = np.arcsin(0.3) if branch == "open" else np.pi - np.arcsin(0.3)
        assert arm == 0.4
        assert hub + arm == pytest.approx(expected, abs=1e-15)

    def test_an_open_chain_needs_no_closing(self):
        mech = mechanism("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]")
        assert assembly.assemble(mech, [4.0], t=0.0).tolist() == [4.0]

    def test_a_loop_driven_at_every_joint_is_checked(self):
        scene = seeded_scene(1, LOOPS["four-bar"])
        mech = mechanism(scene.text.replace("actuated: [link0]", "actuated: [link0, link1, link2]"))
        assert np.array_equal(assembly.assemble(mech, scene.q, t=0.0), scene.q)
        with pytest.raises(AssemblyError, match="m are missing"):
            assembly.assemble(mech, scene.q + np.array([0.1, 0.0, 0.0]), t=0.0)


class TestRates:
    @each("name", LOOPS)
    @each("seed", SEEDS)
    def test_rates_and_accelerations_follow_from_the_actuated_ones(self, name, seed):
        """Psi qd = 0 and Psi qdd + Psidot qd = 0, with qd and qdd made without robodyn."""
        scene = seeded_scene(seed, LOOPS[name])
        mech, (q, qd, qdd) = scene.mechanism, scene.states
        found = loop_rates.loop_velocities(mech, q, driven(mech, qd), t=0.0)
        assert_close(found, qd, np.abs(qd).max(), 1e-12)
        found = loop_rates.loop_accelerations(mech, q, qd, driven(mech, qdd), t=0.0)
        assert_close(found, qdd, np.abs(qdd).max() + np.abs(qd).max() ** 2, 1e-12)

    @pytest.mark.parametrize("name", ["four-bar", "slider-crank", "six-bar, dyad on the coupler"])
    def test_they_are_the_derivatives_of_positions(self, name):
        """Central differences of assembled positions along q1(t) = q1 + qd1 t + qdd1 t^2 / 2."""
        scene = seeded_scene(5, LOOPS[name])
        mech = scene.mechanism
        (choice,) = branches_of(mech, scene.q)
        speed, push, h = 1.5, -4.0, 1e-3
        t = h * np.array([[-2.0], [-1.0], [0.0], [1.0], [2.0]])
        q = assembly.assemble(mech, scene.q[:1] + speed * t + push * t**2 / 2, choice, t=0.0)
        q = scene.q + turn(q - scene.q)
        first = (q[0] - 8 * q[1] + 8 * q[3] - q[4]) / (12 * h)
        second = (-q[0] + 16 * q[1] - 30 * q[2] + 16 * q[3] - q[4]) / (12 * h**2)
        qd = loop_rates.loop_velocities(mech, scene.q, [speed], t=0.0)
        qdd = loop_rates.loop_accelerations(mech, scene.q, qd, [push], t=0.0)
        size = np.abs(qdd).max() + np.abs(qd).max() ** 2
        assert_close(first, qd, size, 1e-8)
        assert_close(second, qdd, size, 1e-8)

    @each("seed", SEEDS)
    def test_four_bar_coefficients(self, seed):
        """qd = k theta1d, qdd = k theta1dd + k' theta1d^2."""
        rng = np.random.default_rng(seed)
        q = oracles.four_bar_position(FOUR_BAR, rng.uniform(-np.pi, np.pi))
        k, k_prime = oracles.four_bar_coefficients(FOUR_BAR, q)
        mech = lecture_four_bar()
        assert_close(loop_rates.loop_velocities(mech, q, [3.0], t=0.0), 3.0 * k, 3.0, 1e-12)
        qdd = loop_rates.loop_accelerations(mech, q, 3.0 * k, [5.0], t=0.0)
        assert_close(qdd, 5.0 * k + 9.0 * k_prime, np.abs(qdd).max() + 9.0, 1e-12)

    @pytest.mark.parametrize("name", LOOPS)
    def test_nearest_rates_keep_the_loops_and_change_no_rates_that_do(self, name):
        """The orthogonal projection of any rates onto Psi qd = 0."""
        scene = seeded_scene(4, LOOPS[name])
        mech, Psi = scene.mechanism, closures.closure_jacobian(scene.mechanism, scene.q, t=0.0)
        rates = np.random.default_rng(0).normal(size=(6, scene.n))
        found = loop_rates.nearest_velocities(mech, np.tile(scene.q, (6, 1)), rates, t=0.0)
        assert_close(found @ Psi.T, np.zeros((6, len(mech.rows))), 10.0)
        moves = np.linalg.svd(Psi)[2][len(mech.rows) :]
        assert_close((found - rates) @ moves.T, np.zeros((6, len(moves))), 10.0)

    def test_nearest_rates_of_closures_that_depend_on_one_another(self):
        """A parallelogram with a third crank, closed to 1e-12: the motion (1, -1, 1, 1) stays."""
        mech = load(ROOT / "tests/hard_cases/third-crank.yaml")
        k = np.array([1.0, -1.0, 1.0, 1.0])
        q = k * np.linspace(0.3, 2.8, 30)[:, None]
        q += 1e-12 * np.random.default_rng(0).normal(size=q.shape)
        found = loop_rates.nearest_velocities(mech, q, np.tile(k, (30, 1)), t=0.0)
        assert_close(found, np.tile(k, (30, 1)), 1.0, 1e-9)

    def test_leading_axes_broadcast(self):
        scene = seeded_scene(2, LOOPS["five-bar"])
        mech, rates = scene.mechanism, np.random.default_rng(0).normal(size=(3, 4, 2))
        together = loop_rates.loop_velocities(mech, scene.q, rates, t=0.0)
        assert together.shape == (3, 4, 4)
        alone = loop_rates.loop_velocities(mech, scene.q, rates[2, 1], t=0.0)
        assert_close(together[2, 1], alone, np.abs(alone).max(), 1e-14)
        assert loop_rates.loop_velocities(
            mech, np.zeros((0, 4)), np.zeros((0, 2)), t=0.0
        ).shape == (0, 4)


class TestReach:
    """Crank tip A and rocker pivot D must be |l2 - l3| to l2 + l3 apart."""

    @settings(deadline=None, max_examples=100 if FRESH else 40)
    @given(*[st.integers(10, 200)] * 4, st.integers(-180, 180), st.sampled_from(BRANCHES))
    def test_closes_where_the_triangle_inequality_allows(self, l1, l2, l3, d, degrees, branch):
        l1, l2, l3, d = (x / 100 for x in (l1, l2, l3, d))
        theta = np.radians(degrees)
        AD = abs(l1 * np.exp(1j * theta) - d)
        missing = max(AD - (l2 + l3), abs(l2 - l3) - AD)
        assume(abs(missing) > 1e-6)
        mech = four_bar(l1, l2, l3, d)
        if missing < 0.0:
            assert gaps(mech, assembly.assemble(mech, [theta], [branch], t=0.0)).max() < 1e-14 * 10
        else:
            with pytest.raises(AssemblyError) as failure:
                assembly.assemble(mech, [theta], [branch], t=0.0)
            (told,) = re.findall(r": (\S+) m are missing", str(failure.value))
            assert float(told) == pytest.approx(missing, rel=1e-5)

    def test_the_other_branch_is_told_where_it_alone_closes(self):
        """Below its ground line the parallelogram is crossed, and the third crank follows it."""
        mech = load(ROOT / "tests/hard_cases/third-crank.yaml")
        assert assembly.assembly_plan(mech).two_way == (0,)  # the third crank has no choice left
        with pytest.raises(AssemblyError) as caught:
            assembly.assemble(mech, [-1.0], t=0.0)
        assert "q1 (crank) can reach [-0.00" in str(caught.value)  # from 0 to 180, by tolerance
        assert "with assembly [crossed, open] it closes" in str(caught.value)
        assert_close(
            assembly.assemble(mech, [-1.0], ("crossed", "open"), t=0.0),
            [-1.0, 1.0, -1.0, -1.0],
            1.0,
        )

    def test_message_tells_where_what_and_the_range(self):
        """AD <= 1.1 where cos theta >= (0.81 + 1 - 1.21) / 1.8: up to 70.52878 deg, cut to 1e-4."""
        with pytest.raises(AssemblyError) as failure:
            assembly.assemble(four_bar(0.9, 0.5, 0.6, 1.0), [np.pi / 2], t=0.0)
        assert str(failure.value) == (
            "scene.yaml: cannot be closed at q1 = 90 deg: 0.245362 m are missing: "
            "q1 (crank) can reach [-70.5287, 70.5287] deg"
        )
        assert failure.value.exit_code == 1

    @pytest.mark.parametrize(
        ("lengths", "limits"),
        [
            ((0.9, 0.5, 0.6, 1.0), [(-70.5287793655, 70.5287793655)]),  # too far beyond
            ((0.6, 1.2, 0.6, 1.0), [(33.5573098, 326.4426902)]),  # too near about 0
            ((0.9, 1.1, 0.3, 1.0), [(-94.7801917, -49.4583981), (49.4583981, 94.7801917)]),
            ((0.3, 0.8, 0.7, 1.0), [(-180.0, 180.0)]),  # a Grashof crank
            ((0.1, 0.2, 0.3, 2.0), []),  # links that never meet
        ],
    )
    def test_reachable_range_is_that_of_the_triangle(self, lengths, limits):
        """cos theta = (l1^2 + d^2 - AD^2) / (2 l1 d) at the limits of AD."""
        found = assembly.reachable(four_bar(*lengths), [0.0], 0, t=0.0)
        assert len(found) == len(limits)
        l1, l2, l3, d = lengths
        for interval, expected in zip(found, limits, strict=True):
            assert np.degrees(interval) == pytest.approx(expected, abs=1e-5)
            for limit in interval if limits != [(-180.0, 180.0)] else ():
                AD = abs(l1 * np.exp(1j * limit) - d)
                assert min(abs(AD - (l2 + l3)), abs(AD - abs(l2 - l3))) < 1e-8

    @pytest.mark.parametrize("lengths", [(0.9, 0.5, 0.6, 1.0), (0.9, 1.1, 0.3, 1.0)])
    def test_the_limits_told_can_be_reached(self, lengths):
        """Whoever types a limit of the message back gets a configuration, not another error."""
        mech = four_bar(*lengths)
        with pytest.raises(AssemblyError) as failure:
            assembly.assemble(mech, [3.0], t=0.0)
        told = re.findall(r"\[(\S+), (\S+)\] deg", str(failure.value))
        assert told
        for limit in itertools.chain(*told):
            assert assembly.attempt(mech, [np.radians(float(limit))], t=0.0)[1] <= 0.0

    def test_no_angle_at_all(self):
        with pytest.raises(AssemblyError, match=r"q1 \(crank\) can reach no angle"):
            assembly.assemble(four_bar(0.1, 0.2, 0.3, 2.0), [0.0], t=0.0)

    def test_each_of_several_actuated_joints_has_its_range(self):
        """Five-bar with rods too short for cranks that point apart."""
        links = [("a", 0.3, ""), ("b", 0.4, ""), ("c", 0.3, ", from: [0.7, 0]"), ("d", 0.4, "")]
        mech = mechanism(
            "links:\n"
            + "".join(
                f"  - {{name: {name}, m: 1, l: {l}, r: 0.1, I: 0.01{place}}}\n"
                for name, l, place in links
            )
            + "closures: [[b, d]]\nactuated: [a, c]\n"
        )
        with pytest.raises(AssemblyError) as failure:
            assembly.assemble(mech, [np.pi, 0.0], t=0.0)
        text = str(failure.value)
        assert "q1 = 180 deg, q3 = 0 deg: 0.5 m are missing" in text
        assert "q1 (a) can reach [-" in text
        assert "q3 (c) can reach [" in text
        assert text.endswith("with the other actuated joints as given")

    def test_slider_too_far_from_the_crank(self):
        """|y - r sin theta| <= l: crank 1, rod 0.5, line at 0.8: sin theta >= 0.3."""
        mech = slider_crank(1.0, 0.5, 0.8)
        with pytest.raises(AssemblyError) as failure:
            assembly.assemble(mech, [-np.pi / 2], t=0.0)
        assert "1.3 m are missing" in str(failure.value)
        ((low, high),) = assembly.reachable(mech, [0.0], 0, t=0.0)
        assert np.sin([low, high]) == pytest.approx([0.3, 0.3], abs=1e-8)

    def test_the_worst_of_many_states_is_told(self):
        mech = four_bar(0.9, 0.5, 0.6, 1.0)
        with pytest.raises(AssemblyError, match=r"q1 = 180 deg: 0\.8 m are missing"):
            assembly.assemble(mech, [[0.3], [np.pi], [np.pi / 2]], t=0.0)


class TestSingular:
    """Dead centre: the actuated joint cannot move the others.  Change point: Psi loses rank."""

    DEAD = np.arccos((1.3**2 - 1.1**2 - 0.8**2) / (2 * 1.1 * 0.8))  # crank and coupler in line

    @pytest.mark.parametrize(
        ("mech", "angle", "kind"),
        [
            (four_bar(0.35, 0.95, 0.8, 1.1, actuated="rocker"), DEAD, "dead centre"),
            (four_bar(0.35, 0.95, 0.8, 1.1, actuated="rocker"), 2.0, ""),
            (four_bar(0.3, 0.7, 0.3, 0.7), 0.0, "change point"),
            (four_bar(0.3, 0.7, 0.3, 0.7), np.pi, "change point"),
            (four_bar(0.3, 0.7, 0.3, 0.7), 1.0, ""),
            (slider_crank(0.3, 0.3, 0.0), np.pi / 2, "change point"),
            (slider_crank(1.0, 0.5, 0.8), np.arcsin(0.3), "dead centre"),  # the rod upright
            (slider_crank(0.1, 0.32, 0.02), 1.0, ""),
        ],
    )
    def test_is_named(self, mech, angle, kind):
        q = assembly.assemble(mech, [angle], t=0.0)
        assert loop_rates.singular_kind(mech, q, t=0.0) == kind
        if not kind:
            assert np.isfinite(loop_rates.loop_velocities(mech, q, [1.0], t=0.0)).all()
            return
        with pytest.raises(SingularError, match=rf"singular configuration \({kind}\) at q = "):
            loop_rates.loop_velocities(mech, q, [1.0], t=0.0)
        with pytest.raises(SingularError, match=rf"\({kind}\)"):
            loop_rates.loop_accelerations(mech, q, np.zeros(mech.n), [1.0], t=0.0)

    def test_standing_still_is_possible_there(self):
        mech = four_bar(0.3, 0.7, 0.3, 0.7)
        q = assembly.assemble(mech, [0.0], t=0.0)
        assert loop_rates.loop_velocities(mech, q, [0.0], t=0.0).tolist() == [0.0] * 3

    def test_one_singular_state_among_others_is_told(self):
        mech = four_bar(0.3, 0.7, 0.3, 0.7)
        q = assembly.assemble(mech, [[1.0], [0.0], [2.0]], t=0.0)
        with pytest.raises(SingularError, match="at q = 0, 0, 0: "):
            loop_rates.loop_velocities(mech, q, [1.0], t=0.0)

    def test_both_branches_meet_at_the_limit_of_reach(self):
        mech = four_bar(0.9, 0.5, 0.6, 1.0)
        limit = np.arccos((0.81 + 1.0 - 1.21) / 1.8)
        both = [assembly.assemble(mech, [limit], [branch], t=0.0) for branch in BRANCHES]
        assert_close(turn(both[0] - both[1]), np.zeros(3), 1.0, 1e-6)
        assert loop_rates.singular_kind(mech, both[0], t=0.0) == "dead centre"

    def test_an_open_chain_has_none(self):
        mech = mechanism("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]")
        assert loop_rates.singular_kind(mech, [0.0], t=0.0) == ""


class TestLargerLoops:
    """A six-bar driven from its far link is no chain of dyads: it needs a `start`."""

    @each("seed", SEEDS)
    def test_start_itself(self, seed):
        scene = seeded_scene(seed, FAR_LINK)
        q = assembly.assemble(scene.mechanism, scene.q[4:], t=0.0)
        assert_close(turn(q - scene.q), np.zeros(5), 1.0, 1e-13)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_is_the_six_bar_driven_from_its_crank(self, seed):
        """From the crank it is a chain of dyads; its far link then leads back to the same."""
        scene = seeded_scene(seed, FAR_LINK)
        lines = [line for line in scene.text.splitlines() if not line.startswith("start")]
        by_crank = mechanism("\n".join(lines).replace("actuated: [link4]", "actuated: [link0]"))
        (choice,) = branches_of(by_crank, scene.q)
        steps = np.array([[-0.02], [-0.01], [0.01], [0.02]])
        expected, missing = assembly.attempt(by_crank, scene.q[:1] + steps, choice, t=0.0)
        expected = expected[missing <= 0.0]
        assert len(expected) >= 2
        q = assembly.assemble(scene.mechanism, expected[:, 4:], t=0.0)
        assert_close(turn(q - expected), np.zeros_like(q), 1.0, 1e-11)

    @pytest.mark.parametrize("seed", SEEDS if FRESH else SEEDS[:2])
    def test_what_lies_beyond_a_limit_is_not_reached(self, seed):
        """Along the way from the start, once the loops cannot close no farther angle is reached.

        A closure found beyond by Newton's method is another assembly, reached by a jump.
        """
        scene = seeded_scene(seed, FAR_LINK)
        for direction in (-1.0, 1.0):
            way = np.linspace(0.0, 3.1, 32 if FRESH else 12)[:, None]
            _, missing = assembly.attempt(scene.mechanism, scene.q[4:] + direction * way, t=0.0)
            closes = missing <= 0.0
            assert closes[0]
            assert (closes[1:] <= closes[:-1]).all(), "closes again beyond a gap"

    @pytest.mark.parametrize("seed", SEEDS if FRESH else SEEDS[:2])
    def test_neighbours_lie_close_together(self, seed):
        """The configurations along the way form one motion: no jumps up to the limits."""
        scene = seeded_scene(seed, FAR_LINK)
        ((low, high),) = assembly.reachable(scene.mechanism, scene.q[4:], 0, t=0.0)
        way = np.append(
            np.arange(max(low, scene.q[4] - 3.1), min(high, scene.q[4] + 3.1), 0.02), high
        )
        q, missing = assembly.attempt(scene.mechanism, way[:, None], t=0.0)
        assert (missing <= 0.0).all()
        assert len(q) > 5
        assert np.abs(turn(np.diff(q, axis=0))).max() < 0.7

    def test_out_of_reach_tells_the_range_about_the_start(self):
        scene = seeded_scene(1, FAR_LINK)
        with pytest.raises(AssemblyError) as failure:
            assembly.assemble(scene.mechanism, scene.q[4:] + 3.0, t=0.0)
        text = str(failure.value)
        ((low, high),) = re.findall(r"q5 \(link4\) can reach \[(\S+), (\S+)\] deg", text)
        assert float(low) < np.degrees(scene.q[4]) < float(high)
        assert re.search(r": \S+ m are missing", text)

    @pytest.mark.parametrize("seed", SEEDS if FRESH else SEEDS[:4])
    def test_the_range_ends_where_the_way_ends(self, seed):
        """Both ends can be reached; just beyond, short of half a turn, nothing closes."""
        scene = seeded_scene(seed, FAR_LINK)
        mech, start = scene.mechanism, scene.q[4]
        ((low, high),) = assembly.reachable(mech, scene.q[4:], 0, t=0.0)
        _, missing = assembly.attempt(mech, [[low], [high]], t=0.0)
        assert missing.tolist() == [0.0, 0.0]
        for beyond in (low - 0.005, high + 0.005):
            if abs(beyond - start) < np.pi:
                assert assembly.attempt(mech, [beyond], t=0.0)[1] > 0.0

    def test_start_may_be_rough_and_leave_out_the_driven_joint(self):
        scene = seeded_scene(2, FAR_LINK)
        angles = ", ".join(f"link{k}: {scene.q[k] + 0.02 * (-1) ** k}" for k in range(4))
        text = re.sub("start: .*", f"start: {{{angles}}}", scene.text)
        q = assembly.assemble(mechanism(text), scene.q[4:], t=0.0)
        assert_close(turn(q - scene.q), np.zeros(5), 1.0, 1e-12)

    def test_without_a_start_is_an_input_error(self):
        scene = seeded_scene(0, FAR_LINK)
        lines = [line for line in scene.text.splitlines() if not line.startswith("start")]
        with pytest.raises(InputError, match=r"cannot assemble q1 \(link0\), .*add a `start`"):
            assembly.assemble(mechanism("\n".join(lines)), [0.0], t=0.0)


class TestUndetermined:
    """The actuated joints must determine all others."""

    FIVE_BAR = seeded_scene(2, LOOPS["five-bar"])

    def test_a_joint_neither_actuated_nor_in_a_loop(self):
        scene = seeded_scene(1, LOOPS["loop in a tree"])
        mech = mechanism(scene.text.replace("[link0, link2, link3]", "[link0, link2]"))
        with pytest.raises(InputError, match=r"q4 \(link3\): neither actuated nor held by a loop"):
            assembly.assemble(mech, [0.0, 0.0], t=0.0)

    @pytest.mark.parametrize("start", [False, True])
    def test_fewer_actuators_than_freedoms(self, start):
        """Two freedoms and one actuator: a start does not make up for the actuator missing."""
        scene = self.FIVE_BAR
        text = scene.text.replace("actuated: [link0, link2]", "actuated: [link0]")
        if start:
            angles = ", ".join(f"link{k}: {angle}" for k, angle in enumerate(scene.q))
            text += f"start: {{{angles}}}\n"
        with pytest.raises(RobodynError, match="actuat"):
            assembly.assemble(mechanism(text), scene.q[:1] + 0.1, t=0.0)

    def test_rates_of_fewer_actuators_than_freedoms(self):
        text = self.FIVE_BAR.text.replace("actuated: [link0, link2]", "actuated: [link0]")
        with pytest.raises(RobodynError):
            loop_rates.loop_velocities(mechanism(text), self.FIVE_BAR.q, [1.0], t=0.0)

    @pytest.mark.parametrize(
        ("values", "place"),
        [
            ([0.1], r"q_actuated\.shape = \(1,\): must have 2 values .*\(link0, link2\)"),
            (0.1, r"q_actuated\.shape = \(\)"),
            ([0.1, np.nan], r"q_actuated.*must be finite"),
        ],
    )
    def test_values_that_do_not_fit(self, values, place):
        with pytest.raises(InputError, match=place):
            assembly.assemble(self.FIVE_BAR.mechanism, values, t=0.0)


DIRECTIONLESS = {
    "a slot through its own pivot": (mechanism(LEVER), "q2 (lever)"),
    "a slide on its pivot": (mechanism(BARREL), "q2 (barrel), q3 (rod)"),
    "equal bars whose pivots meet": (four_bar(1.0, 0.8, 0.8, 1.0), "q2 (coupler), q3 (rocker)"),
}


class TestDirectionsOfNothing:
    """Poses whose actuated joints leave the direction of another link open."""

    @each("name", DIRECTIONLESS)
    @each("turns", [0.0, 1.0, -3.0])  # but for rounding the pivots meet here too
    @each("branch", BRANCHES)
    def test_they_are_singular(self, name, turns, branch):
        mech, joints = DIRECTIONLESS[name]
        told = f"singular configuration at q1 = {360 * turns:g} deg.*{re.escape(joints)} here"
        with pytest.raises(SingularError, match=told):
            assembly.assemble(mech, [2 * np.pi * turns], [branch], t=0.0)

    @pytest.mark.parametrize(
        ("rocker", "closure"),
        [
            ("  - {name: rocker, m: 1, l: 1, r: 0, I: 1, from: [2, 0]}\n", "[forearm, rocker]"),
            ("", "{point: forearm, on: {through: [1, 0], along: [1, 1]}}"),
        ],
    )
    def test_links_folded_onto_one_another(self, rocker, closure):
        """A forearm of the coupler's length lies on it: the two of them turn as they like."""
        mech = mechanism(
            "links:\n"
            "  - {name: crank, m: 1, l: 1, r: 0, I: 1}\n"
            "  - {name: coupler, m: 1, l: 0.7, r: 0, I: 1}\n"
            "  - {name: forearm, m: 1, l: 0.7, r: 0, I: 1}\n"
            f"{rocker}closures: [{closure}]\nactuated: [crank, forearm]\n"
        )
        with pytest.raises(SingularError, match=re.escape("q2 (coupler)")):
            assembly.assemble(mech, [0.0, np.pi], t=0.0)
        assert np.isfinite(assembly.assemble(mech, [0.0, 3.0], t=0.0)).all()

    @each("name", DIRECTIONLESS)
    def test_beside_them_the_loops_close(self, name):
        mech, _ = DIRECTIONLESS[name]
        given = np.array([-0.1, -1e-6, 0.0, 1e-6, 0.1])[:, None]
        q, missing = assembly.attempt(mech, given, t=0.0)
        assert np.isnan(missing).tolist() == [False, False, True, False, False]
        closed = q[~np.isnan(missing)]
        assert np.abs(closures.closure_gap(mech, closed, t=0.0)).max() < 1e-15

    def test_the_slot_points_from_the_levers_pivot_to_the_pin(self):
        """A triangle with equal sides: its base turns by half the crank's angle and a quarter."""
        for angle, error in ((1e-9, 1e-6), (0.5, 1e-14), (2.0, 1e-14)):
            _, lever = assembly.assemble(mechanism(LEVER), [angle], t=0.0)
            assert lever == pytest.approx(np.pi / 2 + angle / 2, abs=error)

    @pytest.mark.parametrize("text", [SCISSORS, SCISSORS + STARTED])
    def test_a_branch_that_is_not_asked_for_never_decides(self, text):
        """On the other branch the arms lie on one another, and the table hangs free."""
        mech = mechanism(text)
        for angle in (0.3, np.pi / 6, 1.0):
            q = assembly.assemble(mech, [angle], t=0.0)
            wanted = [angle, np.pi - angle, -2.0 * angle]
            assert np.abs(q - wanted).max() < 1e-14
            with pytest.raises(SingularError, match=re.escape("q2 (table)")):
                assembly.assemble(mech, [angle], ["crossed", "open"], t=0.0)
        assert assembly.scene_branches(mech)[0] == "open"

    def test_a_range_runs_through_them(self):
        assert assembly.reachable(mechanism(LEVER), [1.0], 0, t=0.0) == [(-np.pi, np.pi)]


class TestProjection:
    @pytest.mark.parametrize("name", LOOPS)
    def test_newton_closes_what_is_nearly_closed(self, name):
        scene = seeded_scene(6, LOOPS[name])
        mech = scene.mechanism
        held = list(mech.actuated)
        rough = scene.q + 0.01 * np.random.default_rng(0).normal(size=(20, scene.n))
        rough[:, held] = scene.q[held]
        size = sizes(mech.description).loop
        for fixed in ((), held):
            q = assembly.close_positions(mech, rough, fixed, t=0.0)
            assert_close(
                closures.closure_gap(mech, q, t=0.0), np.zeros((20, len(mech.rows))), size, 1e-15
            )
            assert np.abs(q - rough).max() < 1.0
            assert np.array_equal(q[:, list(fixed)], rough[:, list(fixed)])

    def test_an_open_chain_and_no_states_are_left_alone(self):
        chain = mechanism("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]")
        assert assembly.close_positions(chain, [[1.0], [2.0]], t=0.0).tolist() == [[1.0], [2.0]]
        four = seeded_scene(1, LOOPS["four-bar"]).mechanism
        assert assembly.close_positions(four, np.zeros((0, 3)), t=0.0).shape == (0, 3)


class TestCheckClosed:
    scene = seeded_scene(7, LOOPS["six-bar with a piston"])

    def many(self):
        return [np.tile(state, (5, 1)) for state in self.scene.states]

    def test_a_closed_motion_passes(self):
        assert loop_rates.check_closed(self.scene.mechanism, *self.many(), t=0.0) is None

    @pytest.mark.parametrize(
        ("which", "text"),
        [(0, "gap in position"), (1, "gap in velocity"), (2, "gap in acceleration")],
    )
    def test_the_first_open_state_is_told_with_its_gap(self, which, text):
        states = self.many()
        states[which][3] += 0.01
        states[which][4] += 0.02
        index, error = loop_rates.check_closed(self.scene.mechanism, *states, t=0.0)
        assert index == 3
        assert isinstance(error, InputError)
        assert text in str(error)

    def test_the_gap_told_is_the_distance(self):
        """Links of 1 m: the coupler's tip at (1, 1), the rocker's at (2, 0)."""
        _, error = loop_rates.check_closed(
            four_bar(1, 1, 1, 1), np.array([0.0, np.pi / 2, 0.0]), t=0.0
        )
        assert "gap in position = 1.41421 m" in str(error)

    IN_LINE = np.array([np.pi / 2, -np.pi])  # a crank and a rod of 0.2 m, folded across the slide

    @each("rates", [(2.0, 0.0), (2.0, -4.0), (-0.1, 0.2), (0.0, 0.0), (2.0, -4.0000001)])
    def test_rates_along_a_branch_close(self, rates):
        mech = slider_crank(0.2, 0.2, 0.0)
        assert loop_rates.check_closed(mech, self.IN_LINE, np.array(rates), t=0.0) is None
        many = np.tile(self.IN_LINE, (5, 1)), np.tile(rates, (5, 1))
        assert loop_rates.check_closed(mech, *many, t=0.0) is None

    @each("rates", [(0.0, 3.0), (1.0, 1.0), (1e-3, 0.0011), (2.0, -3.999)])
    def test_rates_that_no_motion_has(self, rates):
        """The height 0.2 (sin a + sin b) of the pin has Psi = 0 here, and the second derivative
        0.2 (b'^2 - a'^2), whatever the accelerations."""
        mech = slider_crank(0.2, 0.2, 0.0)
        gap = abs(0.2 * ((rates[0] + rates[1]) ** 2 - rates[0] ** 2))
        q, qd = np.tile([1.0, -2.0], (5, 1)), np.tile([1.0, -2.0], (5, 1))
        q[3], qd[3] = self.IN_LINE, rates
        for qdd in (None, np.zeros((5, 2))):
            index, error = loop_rates.check_closed(mech, q, qd, qdd, t=0.0)
            assert index == 3
            assert f"no motion has these rates: gap in acceleration = {gap:.6g} m/s^2" in str(error)
        with pytest.raises(InputError, match="no motion has these rates"):
            simulate(mech, self.IN_LINE, rates, 0.1)

    @each("coupler", [0.0, 1.0])
    @each("off", [0.0, 0.1])
    def test_rates_of_a_parallelogram_in_line(self, coupler, off):
        """Where l a' + d b' = l c', the second derivative l a'^2 + d b'^2 - l c'^2 of the gap along
        the line is zero if b' is 0 or 2 a'/(1 - d/l)."""
        length, ground, crank = 0.3, 0.7, 2.0
        b = coupler * 2.0 * crank / (1.0 - ground / length) + off
        rocker = crank + ground / length * b
        gap = abs(length * crank**2 + ground * b**2 - length * rocker**2)
        mech = four_bar(length, ground, length, ground)
        fault = loop_rates.check_closed(
            mech, np.zeros(3), np.array([crank, b - crank, rocker]), t=0.0
        )
        if off:
            assert f"gap in acceleration = {gap:.6g} m/s^2" in str(fault[1])
        else:
            assert gap < 1e-13
            assert fault is None

    @each("beside", [1e-3, 1e-5, 1e-7, 1e-9])
    def test_motions_close_beside_a_change_point(self, beside):
        """On either branch: the pin stays at the crank's pivot, or the rod mirrors the crank."""
        mech = slider_crank(0.2, 0.2, 0.0)
        for way in (beside, -beside):
            for q, qd in (([way, 0.0], [1.0, 0.0]), ([way, -2.0 * way], [1.0, -2.0])):
                q = self.IN_LINE + q
                assert loop_rates.check_closed(mech, q, np.array(qd), t=0.0) is None

    def test_a_motion_that_misses_a_change_point_closes(self):
        """With a rod that is too short by a little the crank turns back before it is upright."""
        mech = slider_crank(0.2, 0.2 - 1e-13, 0.0)
        q = assembly.assemble(mech, [np.pi / 2 - 0.1], ["crossed"], t=0.0)
        qd = loop_rates.loop_velocities(mech, q, [1.0], t=0.0)
        motion = simulate(mech, q, qd, 0.2)
        assert motion.outcome.label == "finished"
        for k in range(len(motion.t)):
            assert loop_rates.check_closed(mech, motion.q[k], motion.qd[k], t=0.0) is None

    def test_closures_that_depend_on_one_another_everywhere(self):
        """A parallelogram with two couplers moves as one with one of them."""
        mech = mechanism(
            "links:\n"
            "  - {name: crank, m: 1, l: 0.3, r: 0, I: 1}\n"
            "  - {name: coupler, m: 1, l: 0.7, r: 0, I: 1}\n"
            "  - {name: rocker, m: 1, l: 0.3, r: 0, I: 1, from: [0.7, 0]}\n"
            "  - {name: second, m: 1, l: 0.7, r: 0, I: 1, from: 'crank@0.1,0'}\n"
            "closures: [[coupler, rocker], [second, 'rocker@0.1,0']]\n"
            "actuated: [crank]\n"
        )
        angles = np.linspace(-3.0, 3.0, 7)[:, None]
        q, qd = angles * [1, -1, 1, -1], np.tile([1.0, -1.0, 1.0, -1.0], (7, 1))
        assert loop_rates.check_closed(mech, q, qd, t=0.0) is None

    def test_open_chains_and_no_states_have_nothing_to_check(self):
        chain = mechanism("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]")
        assert loop_rates.check_closed(chain, np.zeros(1), t=0.0) is None
        assert loop_rates.check_closed(self.scene.mechanism, np.zeros((0, 4)), t=0.0) is None


def test_shapes_that_need_a_start_are_no_chains_of_dyads():
    for name, shape in LOOPS.items():
        plan = assembly.assembly_plan(seeded_scene(0, shape).mechanism)
        assert bool(plan.rest) == shape.start, name
    assert isinstance(FAR_LINK, Shape)
