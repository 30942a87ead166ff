"""Gears and belts between joints: reduced by hand, and in every evaluator."""

import json
import math
import re

import numpy as np
import pytest
from conftest import ROOT
from each_case import each

from random_mechanisms import mechanism, seeded_tree
from robodyn import (
    assemble,
    closure_gap,
    coriolis_matrix,
    coupling_torques,
    gravity_vector,
    inverse_dynamics,
    loop_velocities,
    mass_matrix,
    simulate,
)
from robodyn.dynamics import identities
from robodyn.dynamics.dynamics import forward_dynamics_and_forces, inverse_dynamics_and_forces
from robodyn.dynamics.evaluators import _accelerations
from robodyn.errors import InputError
from robodyn.mechanics.actuation import Actuation
from robodyn.runs.benchmark import reference
from robodyn.runs.right_hand_side import right_hand_side
from robodyn.scene.quantities import parse_coupling

FIVE_BAR = """
gravity: 9.81
links:
  - {name: left crank,  m: 0.5,  l: 0.30, r: 0.13, I: 0.0044}
  - {name: left rod,    m: 0.85, l: 0.68, r: 0.33, I: 0.037, damping: 0.01}
  - {name: right crank, m: 0.4,  l: 0.26, r: 0.12, I: 0.0028, from: [0.7, 0.0]}
  - {name: right rod,   m: 0.75, l: 0.64, r: 0.31, I: 0.029}
closures: [[left rod, right rod]]
couplings: ["q3 = -2 q1 + 20deg"]
"""
ARM = """
gravity: 9.81
links:
  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082}
  - {name: b, m: 0.9, l: 0.6, r: [0.25, 0.05], I: 0.031, damping: 0.2}
  - {name: c, m: 0.4, l: 0.3, r: 0.15, I: 0.004}
"""
COUPLED = [
    pytest.param("q2 = -2 q1 + 0.1", (0, 2), id="one"),
    pytest.param("q1 = 0.5 q2 - 0.05", (1, 2), id="a joint before"),
    pytest.param("q3 = q1 - 1/3 q2", (0, 1), id="a difference"),
    pytest.param('["q2 = -q1", "q3 = 20/37 q2 + 30deg"]', (0,), id="a chain"),
    pytest.param("q3 = 30deg", (0, 1), id="locked"),
]
EACH_KIND = each("kind", ["straight-line", "dense"])


def geared(couplings, actuated):
    names = ", ".join("abc"[k] for k in actuated)
    return mechanism(f"{ARM}couplings: {couplings}\nactuated: [{names}]\n")


def reduction(mech, actuated):
    """T (n, freedoms) and the constant: q = T q_actuated + constant."""
    zero = assemble(mech, np.zeros(len(actuated)))
    units = assemble(mech, np.eye(len(actuated)))
    return (units - zero).T, zero


class TestReduction:
    """With q = T u + constant: T^T M T udd = T^T (tau - C qd - D qd - G)."""

    @pytest.mark.parametrize(("couplings", "actuated"), COUPLED)
    @pytest.mark.parametrize("seed", range(3))
    def test_forward_and_inverse(self, couplings, actuated, seed):
        mech = geared(couplings, actuated)
        T, constant = reduction(mech, actuated)
        rng = np.random.default_rng(seed)
        u, ud = rng.normal(size=(2, len(actuated)))
        q, qd = T @ u + constant, T @ ud
        assert np.abs(closure_gap(mech, q)).max() < 1e-14
        assert loop_velocities(mech, q, ud) == pytest.approx(qd, abs=1e-12)
        tau = np.zeros(3)
        tau[list(actuated)] = rng.normal(size=len(actuated))
        rest = coriolis_matrix(mech, q, qd) @ qd + np.array(mech.damping) * qd
        rest += gravity_vector(mech, q)
        M = mass_matrix(mech, q)
        udd = np.linalg.solve(T.T @ M @ T, T.T @ (tau - rest))
        found = forward_dynamics_and_forces(mech, q, qd, tau)
        assert found.qdd == pytest.approx(T @ udd, rel=1e-10, abs=1e-10)
        # each coupling's torque is what its own joint is short of, through all that hold it
        short = M @ found.qdd + rest - tau
        torques = coupling_torques(mech, found.multipliers)
        acting = np.zeros(3)
        for coupling, torque in zip(mech.description.couplings, torques, strict=True):
            acting[coupling.joint] += torque
            for k, ratio in coupling.terms:
                acting[k] -= ratio * torque
        assert acting == pytest.approx(short, abs=1e-10)
        again = inverse_dynamics_and_forces(mech, q, qd, found.qdd)
        assert again.tau == pytest.approx(tau, abs=1e-10)
        assert coupling_torques(mech, again.multipliers) == pytest.approx(torques, abs=1e-9)

    def test_the_default_actuated_joints(self):
        assert mechanism(ARM + "couplings: q2 = -2 q1").actuated == (0, 2)
        assert mechanism(FIVE_BAR).actuated == (0,)


class TestEvaluators:
    @staticmethod
    def state(mech, angle=1.0, rate=2.0):
        q = assemble(mech, [angle])
        return q, loop_velocities(mech, q, [rate])

    @EACH_KIND
    def test_rates(self, kind):
        mech = mechanism(FIVE_BAR)
        q, qd = self.state(mech)
        side = right_hand_side(mech, Actuation((0.4, 0.0, 0.0, 0.0)), kind=kind)
        found = np.asarray(side.rates(0.0, np.concatenate([q, qd])))[4:]
        exact = [float(x) for x in _accelerations(mech, q, qd, np.array([0.4, 0.0, 0.0, 0.0]))]
        assert found == pytest.approx(exact, rel=1e-11, abs=1e-11)
        y = np.concatenate([q, qd]) + 1e-4
        closed = side.projection(0.0, side.projection(0.0, y))
        assert np.abs(closure_gap(mech, closed[:4])).max() < 1e-14

    @EACH_KIND
    def test_baumgarte(self, kind):
        """gapdd + 2 b gapd + b^2 gap = 0, of the coupling too."""
        mech = mechanism(FIVE_BAR)
        y = np.concatenate(self.state(mech)) + 1e-3 * np.arange(8)
        b = 20.0
        actuation = Actuation((0.4, 0.0, 0.0, 0.0))
        side = right_hand_side(mech, actuation, baumgarte=b, kind=kind)
        expected = right_hand_side(mech, actuation, baumgarte=b, kind="dense")
        found = np.asarray(side.rates(0.0, y))
        assert found == pytest.approx(np.asarray(expected.rates(0.0, y)), rel=1e-9)
        ahead = y[2] + 2 * y[0] - math.radians(20)
        faster = y[6] + 2 * y[4]
        assert found[6] + 2 * found[4] == pytest.approx(-2 * b * faster - b**2 * ahead, rel=1e-9)

    def test_the_identities_of_check(self):
        for mech in (mechanism(FIVE_BAR), geared("q3 = q1 - 1/3 q2", (0, 1))):
            sample = identities.sample_states(mech, 20)
            assert len(sample.q) == 20
            assert [x.name for x in identities.identities(mech, sample) if not x.holds] == []


class TestMotions:
    def test_every_method_agrees_with_extended_precision(self):
        mech = mechanism(FIVE_BAR)
        q = assemble(mech, [1.0])
        tau = Actuation((0.4, 0.0, 0.0, 0.0))
        exact = reference(mech, np.concatenate([q, np.zeros(4)]), np.array([1.0]), tau)
        assert exact.uncertainty < 1e-12
        for method, error in (("DOP853", 1e-9), ("taylor", 1e-9), ("Radau", 1e-6)):
            motion = simulate(
                mech,
                q,
                np.zeros(4),
                1.0,
                tau=tau,
                method=method,
                rtol=1e-10,
                atol=1e-10,
                t_eval=[1.0],
            )
            assert motion.q[0] == pytest.approx(exact.y[0, :4], abs=error)
            assert motion.report.largest_gap < 1e-14

    def test_a_gear_of_many_turns(self):
        """A flywheel behind 1 : 40 is 1600 times its inertia."""
        mech = mechanism(
            "links: [{name: arm, m: 0, l: 1, r: 0, I: 0.5}, {name: wheel, m: 0, l: 0, r: 0, "
            "I: 0.001, from: [2, 0]}]\ncouplings: q2 = 40 q1 + 1\n"
        )
        motion = simulate(mech, [0.0, 1.0], [0.0, 0.0], 10.0, tau=[3.0], t_eval=[10.0])
        angle = 0.5 * 3.0 / (0.5 + 1600 * 0.001) * 100.0
        assert motion.q[0] == pytest.approx([angle, 40 * angle + 1], rel=1e-12)

    def test_a_start_that_breaks_it_is_refused(self):
        mech = mechanism(FIVE_BAR)
        q = assemble(mech, [1.0])
        with pytest.raises(InputError, match="loops are open"):
            simulate(mech, q + np.array([0, 0, 0.1, 0]), np.zeros(4), 1.0)


class TestAssembly:
    def test_a_loop_behind_a_gear(self):
        mech = mechanism(FIVE_BAR)
        q1 = np.linspace(-3.0, 9.0, 50)
        q = assemble(mech, q1[:, None])
        assert q[:, 2] == pytest.approx(-2 * q1 + math.radians(20))
        assert np.abs(closure_gap(mech, q)).max() < 1e-14

    def test_passive_joints_coupled_to_one_another_need_a_start(self):
        """The rods are coupled, not the cranks: Newton's method from the start configuration."""
        q = assemble(mechanism(FIVE_BAR), [1.0])
        ahead = float(q[3] - 0.5 * q[1])
        text = FIVE_BAR.replace("q3 = -2 q1 + 20deg", f"q4 = 0.5 q2 + {ahead!r}")
        with pytest.raises(InputError, match="add a `start`"):
            assemble(mechanism(text), [1.0])
        names = ["left crank", "left rod", "right crank", "right rod"]
        start = ", ".join(
            f"{name}: {angle!r}" for name, angle in zip(names, q.tolist(), strict=True)
        )
        mech = mechanism(f"{text}start: {{{start}}}\n")
        assert assemble(mech, [1.0]) == pytest.approx(q, abs=1e-9)
        moved = assemble(mech, [1.2])
        assert np.abs(closure_gap(mech, moved)).max() < 1e-12
        assert moved[3] - 0.5 * moved[1] == pytest.approx(ahead)

    def test_a_tree_at_random(self):
        plain = seeded_tree(3, 5)
        mech = mechanism(plain.text + 'couplings: ["q4 = 0.3 q2 - q1", "q5 = -1.5 q4 + 1"]\n')
        assert mech.actuated == (0, 1, 2)  # as many as freedoms: two of five follow
        q = mechanism(
            plain.text + "couplings: q4 = 0.3 q2 - q1\nactuated: [link0, link1, link2, link4]\n"
        )
        full = assemble(q, [0.1, 0.2, 0.3, 0.4])
        assert full[3] == pytest.approx(0.3 * 0.2 - 0.1)
        tau = inverse_dynamics(q, full, np.zeros(5), np.zeros(5))
        assert tau[3] == 0.0


class TestFaults:
    def test_the_compiled_series_serve_them(self):
        pytest.importorskip("llvmlite")
        mech = mechanism(FIVE_BAR)
        q, options = assemble(mech, [1.0]), {"t_eval": [0.5, 1.0], "rtol": 1e-10, "atol": 1e-10}
        found = simulate(mech, q, np.zeros(4), 1.0, method="taylor", **options)
        assert found.q == pytest.approx(simulate(mech, q, np.zeros(4), 1.0, **options).q, abs=1e-7)

    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            ("q3 = -2 q1 + 0.1", (2, {0: -2.0}, 0.1)),
            ("q2=q1", (1, {0: 1.0}, 0.0)),
            ("q3 = 20/37 q1 - 1e-3*q2 - 180deg", (2, {0: 20 / 37, 1: -1e-3}, -math.pi)),
            ("q1 = -pi/2", (0, {}, -math.pi / 2)),
            ("q12 = q1 + q1 - 1e+1", (11, {0: 2.0}, -10.0)),
        ],
    )
    def test_what_an_equation_says(self, text, expected):
        assert parse_coupling(text, ["rad"] * 12)[:3] == expected


def test_the_columns_of_the_command_line(robodyn, scene):
    path = scene(FIVE_BAR)
    names = robodyn("torque", path, "--q", "1", "--qd", "2").out.splitlines()[0]
    assert names == "tau1,fx1,fy1,tc1"


class TestTiedJoints:
    """Which joints are driven where the scene does not say, and what is said of too many."""

    LOOPS = FIVE_BAR.replace('couplings: ["q3 = -2 q1 + 20deg"]\n', "")

    def test_a_locked_joint_is_not_driven(self):
        mech = mechanism(ARM + "couplings: q2 = 30deg")
        assert mech.actuated == (0, 2)
        q = assemble(mech, [0.3, -0.2])
        assert q[1] == pytest.approx(math.radians(30))
        tau = inverse_dynamics(mech, q, np.zeros(3), np.zeros(3))
        assert tau[1] == 0.0

    def test_a_loop_is_driven_by_a_joint_outside_that_it_follows(self):
        link = "links:\n  - {name: motor, m: 0.1, l: 0, r: 0, I: 0.01, from: [2, 0]}\n"
        text = self.LOOPS.replace("links:\n", link, 1) + 'couplings: ["q2 = 0.5 q1", "q4 = -q1"]\n'
        mech = mechanism(text)
        assert mech.actuated == (0,)
        assert assemble(mech, [0.9])[1] == pytest.approx(0.45)

    def test_two_loops_that_are_geared_have_one_motor(self):
        names = ("left crank", "left rod", "right crank", "right rod")
        second = self.LOOPS.split("links:\n")[1].split("closures")[0]
        for name in names:
            second = second.replace(name, f"other {name}")
        second = second.replace("other left crank,", "other left crank, from: [3, 0],")
        second = second.replace("[0.7, 0.0]", "[3.7, 0.0]")
        text = self.LOOPS.replace("closures: [[left rod, right rod]]\n", second)
        text += "closures: [[left rod, right rod], [other left rod, other right rod]]\n"
        text += 'couplings: ["q3 = -q1", "q5 = 2 q1", "q7 = q5"]\n'
        assert mechanism(text).actuated == (0,)

    def test_every_joint_of_a_loop_actuated(self, robodyn, scene):
        path = scene(FIVE_BAR + "actuated: [left crank, left rod, right crank, right rod]\n")
        q = assemble(mechanism(FIVE_BAR), [1.0])
        given = ",".join(map(repr, q.tolist()))
        assert robodyn("assemble", path, "--q", given).code == 0
        assert robodyn("check", path).code == 0

    def test_an_open_coupling_is_named(self):
        mech = mechanism(FIVE_BAR)
        q = assemble(mech, [1.0])
        both = q + np.array([0.0, 0.0, 0.1, 0.0])
        alone = mechanism(ARM + "couplings: q2 = 2 q1")
        with pytest.raises(InputError, match="coupling 1 does not hold: q2 is off in position"):
            simulate(alone, [0.1, 0.5, 0.0], np.zeros(3), 1.0)
        with pytest.raises(InputError, match="loops are open"):
            simulate(mech, both, np.zeros(4), 1.0)

    def test_couplings_that_depend_on_one_another(self, robodyn, scene):
        path = scene(ARM + 'couplings: ["q2 = 2 q1", "q1 = 0.5 q2"]\nactuated: [a, c]\n')
        given = robodyn("reactions", path, "--q", "0.2,0.4,0.1")
        assert given.code == 0
        assert "not unique: tc1; tc2" in given.err

    @pytest.mark.parametrize("text", ["q2 = 2 q1 2", "q2 = 1 0 q1", "q2 = q1 + 1 2deg"])
    def test_a_blank_within_a_number_is_no_number(self, text):
        with pytest.raises(InputError, match="couplings"):
            mechanism(f"{ARM}couplings: {text}\n")


class TestContradictions:
    """Couplings that cannot be kept are told, however the state is given."""

    @each(
        ("couplings", "worst"),
        [
            ('["q2 = q1", "q1 = q2 + 1"]', "coupling 2"),
            ('["q2 = 2 q1", "q3 = q2 + 0.1", "q1 = q3 + 1"]', "coupling 3"),
        ],
    )
    @each("command", ["torque", "accel", "terms", "assemble", "simulate"])
    def test_on_the_command_line(self, robodyn, scene, couplings, worst, command):
        path = scene(f"{ARM}couplings: {couplings}\nactuated: [a, c]\n")
        if "q3" in couplings:
            path = scene(f"{ARM}couplings: {couplings}\nactuated: [a]\n")
        driven = "1" if "q3" in couplings else "1,0.5"
        more = ["--time", "1"] if command == "simulate" else []
        given = robodyn(command, path, "--q", driven, *more)
        assert given.code == 1
        assert f"{worst} cannot be kept" in given.err

    def test_a_mechanism_that_cannot_move_keeps_its_identities(self, robodyn, scene):
        text = (ROOT / "robots/four-bar.yaml").read_text() + 'couplings: ["q3 = 2 q1"]\n'
        given = robodyn("check", scene(text))
        assert given.code == 0, given.err


def test_the_power_of_a_stiff_spring(robodyn, scene):
    text = ARM + "springs: [{between: [b, [0.5, 0.9]], stiffness: 1.0e+9, length: 0.3}]\n"
    assert robodyn("check", scene(text)).code == 0


@pytest.mark.parametrize(
    ("couplings", "told"),
    [
        (["q3 = q2", "q2 = q3"], "couplings[0] and couplings[1] repeat one another"),
        (["q3 = q2", "q2 = q3 + 1"], "couplings[0] and couplings[1] repeat one another, or contra"),
        (["q4 = q1 + q2", "q2 = q4"], "couplings[0] and couplings[1] fix q1 (a), which is actuat"),
        (["q3 = -q2", "q4 = q2 + 2*q3", "q2 = -q4"], "couplings[1] and couplings[2] repeat"),
    ],
)
def test_couplings_that_determine_nothing_are_named(couplings: list[str], told: str) -> None:
    """The last of them: q4 = q2 - 2 q2 = -q2 is what the third says of q2 and q4."""
    links = [f"{{name: {name}, m: 1, l: 1, r: 0.5, I: 0.1}}" for name in "abcd"]
    text = f"links: [{', '.join(links)}]\ncouplings: {json.dumps(couplings)}\n"
    scene = mechanism(text)
    with pytest.raises(InputError, match=re.escape(told)):
        assemble(scene, [0.1] * len(scene.actuated))
