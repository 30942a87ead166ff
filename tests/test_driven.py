"""Laws of the time: driven joints against closed forms, scipy, and undriven mechanisms."""

import csv
import json
import math
import re
from itertools import pairwise

import numpy as np
import pytest
from conftest import ROOT
from scipy.integrate import quad, solve_ivp

from random_mechanisms import mechanism
from robodyn import (
    assemble,
    closure_gap,
    coupling_torques,
    forward_dynamics_and_forces,
    inverse_dynamics,
    inverse_dynamics_and_forces,
    load,
    loop_accelerations,
    loop_velocities,
    motor_loads,
    points,
    simulate,
)
from robodyn.dynamics import identities
from robodyn.dynamics.closed_form import energies
from robodyn.dynamics.columns import column_names
from robodyn.errors import InputError, LawError
from robodyn.loops import closures
from robodyn.mechanics.actuation import Actuation
from robodyn.runs.benchmark import reference
from robodyn.runs.report import Outcome

METHODS = ["DOP853", "RK45", "Radau", "taylor"]
ROD = """
links:
  - {name: rod, m: 1.0, l: 1, r: 0.5, I: 0.1}
  - {name: bead, joint: prismatic, axis: [1, 0], from: {link: rod, at: [0, 0]},
     m: 0.5, l: 0, r: 0, I: 0}
couplings: "q1 = 3 rad/s t"
"""
PENDULUM = """
gravity: 9.81
links:
  - {name: pivot, joint: prismatic, axis: [0, 1], m: 0.3, l: 0, r: 0, I: 0}
  - {name: arm, m: 0.5, l: 0.4, r: 0.25, I: 0.004, from: pivot, damping: 0.003}
couplings: "q1 = 0.02 m sin(300 rad/s t)"
"""
FOUR_BAR = """
gravity: 9.81
links:
  - {name: crank,   m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker,  m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}
closures: [[coupler, rocker]]
couplings: "q1 = 5 rad/s t + 0.3 sin(2 t)"
"""
TWO_SLIDES = """
links:
  - {{name: a, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0}}
  - {{name: b, joint: prismatic, axis: [0, 1], m: 0.5, l: 0, r: 0, I: 0, from: [0.3, 0]}}
couplings:
  - "q2 = {law}"
"""
CAR_AXIS = """
gravity: 1
links:
  - {name: axle, m: 0, l: 1, r: 0, I: 0}
  - {name: left, joint: prismatic, axis: [0, 1], m: 5e-4, l: 0, r: 0, I: 0,
     from: {link: axle, at: [0, 0]}}
  - {name: body, m: 5e-4, l: 1, r: 1, I: 0, from: left}
springs:
  - {between: [left, [0, 0]], stiffness: 1, length: 0.5}
  - {between: [body, axle], stiffness: 1, length: 0.5}
couplings: "q1 = asin(0.1 sin(10 t))"
"""
# a base that floats, with an arm whose joints follow given motions
FLOATING = """
links:
  - {name: along, joint: prismatic, axis: [1, 0], m: 0, l: 0, r: 0, I: 0}
  - {name: across, joint: prismatic, axis: [0, 1], m: 0, l: 0, r: 0, I: 0, from: along}
  - {name: base, m: 4, l: 0.3, r: 0, I: 0.3, from: across}
  - {name: upper, m: 1.0, l: 0.5, r: 0.25, I: 0.02, from: base}
  - {name: lower, m: 0.7, l: 0.4, r: 0.2, I: 0.01, from: upper}
couplings: ["q4 = 0.8 sin(2 t)", "q5 = -0.5 + 0.6 cos(3 t) + 0.1 q4"]
"""
# the law is on a joint between links that turn
RELATIVE = """
gravity: 9.81
links:
  - {name: a, m: 1.0, l: 0.8, r: 0.4, I: 0.06}
  - {name: b, m: 0.9, l: 0.6, r: 0.3, I: 0.03}
  - {name: c, m: 0.4, l: 0.3, r: 0.15, I: 0.004}
couplings: "q2 = 0.5 sin(2 t) + 0.3 q1 cos(t) + 0.1 q3^2"
"""


def started(mech, driven, rates):
    q = assemble(mech, driven)
    return q, loop_velocities(mech, q, rates)


class TestClosedForms:
    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("end", [1.0, -0.7])
    def test_a_bead_on_a_turning_rod(self, method, end):
        """x = x0 cosh(w t), and the torque of the drive is 2 m x v w."""
        mech, w = mechanism(ROD), 3.0
        motion = simulate(mech, [0, 0.1], [w, 0], end, method=method, rtol=1e-11, atol=1e-11)
        x = 0.1 * np.cosh(w * motion.t)
        np.testing.assert_allclose(motion.q, np.stack([w * motion.t, x], axis=-1), atol=2e-10)
        gained = np.sum(energies(mech, motion.q[-1], motion.qd[-1]), axis=0)
        gained -= np.sum(energies(mech, motion.q[0], motion.qd[0]), axis=0)
        assert motion.report.work == pytest.approx(gained, rel=1e-9)
        states = motion.q, motion.qd
        qdd, lam, _ = forward_dynamics_and_forces(
            mech, *states, np.zeros_like(x)[:, None], motion.t
        )
        v = 0.1 * w * np.sinh(w * motion.t)
        np.testing.assert_allclose(coupling_torques(mech, lam)[:, 0], x * v * w, atol=1e-9)
        np.testing.assert_allclose(qdd[:, 1], w * w * motion.q[:, 1], rtol=1e-13)

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_a_pendulum_on_a_shaken_pivot(self, method):
        """Kapitza's, a from upright: I a'' + d a' = m r (g - A w^2 sin w t) sin a; it stays."""
        mech = mechanism(PENDULUM)
        A, w, m, r = 0.02, 300.0, 0.5, 0.25
        inertia = 0.004 + m * r * r

        def rates(t, y):
            pull = 9.81 - A * w * w * math.sin(w * t)
            return [y[1], (m * r * pull * math.sin(y[0]) - 0.003 * y[1]) / inertia]

        start = [0.2, 0.0]
        exact = solve_ivp(rates, (0, 2), start, "DOP853", rtol=1e-12, atol=1e-12)
        motion = simulate(
            mech, [0, start[0]], [A * w, 0], 2.0, method=method, rtol=1e-12, atol=1e-12
        )
        assert motion.outcome is Outcome.FINISHED
        assert motion.q[-1, 1] == pytest.approx(exact.y[0, -1], abs=1e-8)
        assert abs(motion.q[:, 1]).max() < 0.4  # it does not fall

    def test_the_car_axis(self):
        """The index-3 problem of the IVP test set, with its reference solution at t = 3."""
        mech = mechanism(CAR_AXIS)
        start = [0, 0.5, -math.pi / 2], [1, 0, -1]
        motion = simulate(mech, *start, 3.0, rtol=1e-13, atol=1e-13)
        _, place, speed, _ = points(mech, motion.q[-1], motion.qd[-1], of=["left", "body"])
        known = [0.04934557842754028, 0.4969894602301711, 1.041742524885421, 0.3739110272653612]
        assert np.ravel(place) == pytest.approx(known, abs=1e-11)
        known = [-0.0770583684040972, 0.0074468665872377, 0.0175568157537232, 0.770341043779252]
        assert np.ravel(speed) == pytest.approx(known, abs=1e-11)

    def test_an_arm_on_a_floating_base(self):
        """Nothing acts from without: momentum and moment of momentum stay what they are."""
        mech = mechanism(FLOATING)
        q, qd = started(mech, [0.1, 0.2, 0.3], [0.0, 0.0, 0.0])
        motion = simulate(mech, q, qd, 3.0, rtol=1e-12, atol=1e-12)
        centres = ["centre3", "centre4", "centre5"]
        _, place, speed, _ = points(mech, motion.q, motion.qd, of=centres)
        mass = np.array([4, 1.0, 0.7])[:, None]
        momentum = (mass * speed).sum(axis=1)
        np.testing.assert_allclose(momentum, momentum[:1] + 0 * momentum, atol=1e-10)
        turned = np.cumsum(motion.qd[:, 2:], axis=1) @ [0.3, 0.02, 0.01]
        cross = place[..., 0] * speed[..., 1] - place[..., 1] * speed[..., 0]
        spin = turned + (mass[:, 0] * cross).sum(axis=1)
        np.testing.assert_allclose(spin, spin[0], atol=1e-10)


class TestDrives:
    def test_a_driven_crank_needs_the_torque_of_the_free_mechanism(self):
        mech, free = mechanism(FOUR_BAR), load(ROOT / "robots" / "four-bar.yaml")
        assert mech.actuated == ()
        t = np.linspace(-1, 2, 31)
        q = assemble(mech, np.zeros((31, 0)), t=t)
        qd = loop_velocities(mech, q, np.zeros((31, 0)), t=t)
        qdd = loop_accelerations(mech, q, qd, np.zeros((31, 0)), t=t)
        np.testing.assert_allclose(q[:, 0], 5 * t + 0.3 * np.sin(2 * t), rtol=1e-15, atol=1e-15)
        np.testing.assert_allclose(qdd[:, 0], -1.2 * np.sin(2 * t), atol=1e-13)
        lam = inverse_dynamics_and_forces(mech, q, qd, qdd, t).multipliers
        tau = inverse_dynamics(free, q, qd, qdd)[:, 0]
        np.testing.assert_allclose(coupling_torques(mech, lam)[:, 0], tau, atol=1e-12)
        caused = forward_dynamics_and_forces(mech, q, qd, np.zeros_like(q), t)
        np.testing.assert_allclose(caused.qdd, qdd, atol=1e-10)

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("end", [2.0, -1.5])
    def test_a_wholly_driven_mechanism_balances_its_energy(self, method, end):
        mech = mechanism(FOUR_BAR)
        q, qd = started(mech, [], [])
        times = np.linspace(0, end, 21)  # between the steps
        motion = simulate(mech, q, qd, end, method=method, rtol=1e-10, atol=1e-10, t_eval=times)
        assert motion.outcome is Outcome.FINISHED
        exact = 5 * times + 0.3 * np.sin(2 * times)
        np.testing.assert_allclose(motion.q[:, 0], exact, rtol=0, atol=1e-13)
        assert np.abs(closure_gap(mech, motion.q, motion.t)).max() < 1e-13
        assert motion.report.energy_drift < 1e-8

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("law", ["5 rad/s t", "0.3 sin(50 rad/s t)"])
    def test_the_work_of_a_law_has_a_tolerance_of_its_own(self, law, method):
        """Steps along which the motion is exact do not tell its work; damping has the rest."""
        link = "{name: crank, m: 1, l: 0.5, r: 0.2, I: 0.02, damping: 0.1}"
        mech = mechanism(f'gravity: 9.81\nlinks: [{link}]\ncouplings: "q1 = {law}"\n')
        q, qd = started(mech, [], [])
        motion = simulate(mech, q, qd, 3.0, method=method, rtol=1e-9, atol=1e-9)
        assert motion.report.energy_drift < 1e-8
        gained = np.sum(energies(mech, motion.q[-1], motion.qd[-1]), axis=0)
        gained -= np.sum(energies(mech, q, qd), axis=0)
        assert motion.report.work == pytest.approx(
            gained, abs=1e-8 * motion.report.energy_in_motion
        )

    @pytest.mark.parametrize("method", METHODS)
    def test_a_law_on_a_joint_between_turning_links(self, method):
        mech = mechanism(RELATIVE)
        q, qd = started(mech, [0.4, -0.7], [0.0, 0.3])
        motion = simulate(mech, q, qd, 1.5, method=method, rtol=1e-11, atol=1e-11)
        q1, q2, q3 = motion.q.T
        law = 0.5 * np.sin(2 * motion.t) + 0.3 * q1 * np.cos(motion.t) + 0.1 * q3**2
        np.testing.assert_allclose(q2, law, atol=1e-13)
        assert motion.report.energy_drift < 1e-9
        other = reference(mech, np.concatenate([q, qd]), np.array([1.5]), Actuation((0.0,) * 3))
        np.testing.assert_allclose(motion.q[-1], other.y[0, :3], atol=1e-8)

    @pytest.mark.parametrize("text", [ROD, FOUR_BAR, RELATIVE, PENDULUM], ids="abcd")
    def test_the_identities_hold(self, text):
        mech = mechanism(text)
        for x in identities.identities(mech, identities.sample_states(mech, 30)):
            assert x.residual is not None, x
            assert x.residual < 1e-9, x

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_events_between_steps(self, method):
        mech = mechanism(FOUR_BAR)
        q, qd = started(mech, [], [])
        motion = simulate(
            mech, q, qd, 2.0, method=method, events={"high": "q1 > 4"}, until="q1 > 7"
        )
        (event, *_) = motion.events
        at = event.t
        assert 5 * at + 0.3 * math.sin(2 * at) == pytest.approx(4, abs=1e-9)
        end = motion.t[-1]
        assert 5 * end + 0.3 * math.sin(2 * end) == pytest.approx(7, abs=1e-9)

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_a_pulse_is_not_stepped_over(self, method):
        text = ROD.replace("3 rad/s t", "0.5 rad exp(-((t - 5)/0.01)^2)")
        mech = mechanism(text)
        motion = simulate(mech, [0, 0.1], [0, 0], 10.0, method=method, rtol=1e-10, atol=1e-10)

        def rates(t, y):
            u = (t - 5) / 0.01
            w = -u / 0.01 * math.exp(-u * u)
            return [y[1], y[0] * w * w]

        exact = solve_ivp(
            rates, (4.9, 5.1), [0.1, 0.0], "DOP853", rtol=1e-12, atol=1e-13, max_step=1e-3
        )
        v = exact.y[1, -1]
        assert v > 0.1
        assert motion.qd[-1, 1] == pytest.approx(v, rel=1e-6)


class TestStates:
    def test_rows_take_their_time(self, robodyn, scene):
        path = scene(FOUR_BAR)
        one = robodyn("torque", path, "--at-time", "300ms").out
        given = robodyn("torque", path, "-", stdin="t\n0.3\n0.4\n").out.splitlines()
        assert given[1].split(",")[1:] == one.splitlines()[1].split(",")
        pose = json.loads(robodyn("assemble", path, "--at-time", "0.3", "--format", "json").out)
        assert pose["branches"][0]["q"][0] == pytest.approx(1.5 + 0.3 * math.sin(0.6))
        both = robodyn("torque", path, "-", "--at-time", "1", stdin="t\n0.3\n")
        assert (both.code, "column t" in both.err) == (2, True)

    def test_a_state_that_contradicts_the_law_is_refused(self, robodyn, scene):
        path = scene(ROD)
        given = robodyn("torque", path, "--q", "0.5,0.2", "--at-time", "0.1")
        assert given.code == 2
        assert "its law 3 rad/s t is 0.3 rad at t = 0.1 s" in given.err
        given = robodyn("torque", path, "--q", "0.3,0.2", "--qd", "2,1", "--at-time", "0.1")
        assert given.code == 2
        assert "q1 is off in velocity = 1 rad/s: its velocity by its law" in given.err
        assert given.err.startswith("Error: --qd: ")
        assert "3 rad/s t is 3 rad/s at t = 0.1 s" in given.err
        rates = ["--qd", "3,1", "--qdd", "0.5,0", "--at-time", "0.1"]
        given = robodyn("torque", path, "--q", "0.3,0.2", *rates)
        assert "its acceleration by its law 3 rad/s t is 0 rad/s^2 at t = 0.1 s" in given.err
        given = robodyn("simulate", path, "--q", "0.5,0.2", "--assemble", "--time", "0.1")
        assert given.code == 0
        assert robodyn("simulate", path, "--q", "0.2", "--time", "0.1").code == 0

    def test_the_power_of_a_drive_is_a_column(self, robodyn, scene):
        given = ["--q", "1.2,0.2", "--qd", "3,0.5", "--at-time", "0.4"]
        out = robodyn("accel", scene(ROD), *given, "--columns", "tc1,drive_power1").out
        torque, power = map(float, out.splitlines()[1].split(","))
        assert torque == pytest.approx(2 * 0.5 * 0.2 * 0.5 * 3)
        assert power == pytest.approx(3 * torque)

    def test_the_motor_of_a_drive_is_that_of_an_actuated_joint(self, robodyn, scene, tmp_path):
        """The same states with the crank actuated need the same volts and amperes."""
        own = "I: 0.008, motor: {ratio: -40, inertia: 2e-5, damping: 1e-5, torque_constant: 0.05,"
        text = FOUR_BAR.replace("I: 0.008", own + " resistance: 2}")
        path, free = scene(text), tmp_path / "free.yaml"
        free.write_text(text.partition("couplings")[0])
        names = "motor1,motor_speed1,volt1,amp1,watt1"
        rest = ["--rtol", "1e-11", "--atol", "1e-12"]
        run = ["simulate", path, "--time", "0.6", "--points", "7", *rest]
        motion = robodyn(*run, "--columns", f"t,q,qd,qdd,{names}")
        states = "".join(",".join(x.split(",")[:10]) + "\n" for x in motion.out.splitlines())
        found, *others = (
            [
                [float(row[x]) for x in names.split(",")]
                for row in csv.DictReader(y.out.splitlines())
            ]
            for y in (
                motion,
                robodyn("torque", free, "-", stdin=states),
                robodyn("torque", path, "-", stdin=states),
                robodyn("accel", path, "-", "--columns", names, stdin=states),
            )
        )
        volts = [row[2] for row in found]
        assert max(volts) - min(volts) > 0.5
        for other in others:
            np.testing.assert_allclose(found, other, rtol=1e-9, atol=1e-9)
        level = repr(0.5 * (volts[2] + volts[3]))
        ended = robodyn(*run, "--until", f"volt1 - {level}", "--columns", "t,volt1")
        t, volt = map(float, ended.out.splitlines()[-1].split(","))
        assert 0.0 < t < 0.6
        assert volt == pytest.approx(float(level), abs=1e-9)

    def test_motors_of_joints_that_are_no_drives_have_no_columns(self):
        """The gear of a drive turns the motor of a joint that follows; a law may leave one free."""
        motor = ", motor: {ratio: 10, inertia: 1e-5}"
        text, given = RELATIVE, [0.1, 0.2, 0.3]
        for inertia in ("I: 0.06", "I: 0.004"):
            text = text.replace(inertia, inertia + motor)
        for coupling, names in (
            ('["q1 = 2 t", "q3 = -2 q1"]', ["motor1"]),
            ('["q1 = 2 t + 0.1 sin(q3)"]', ["motor1", "motor3"]),
            ('["q1 = 2 t", "q3 = t"]', ["motor1", "motor3"]),
        ):
            mech = mechanism(text.partition("couplings")[0] + f"couplings: {coupling}\n")
            assert column_names(mech, ["motor"]) == names
            own = [x for x in names if int(x[-1]) - 1 in mech.actuated]
            told = motor_loads(mech, given, given)
            assert [*told] == own + [x.replace("motor", "motor_speed") for x in own]

    def test_actuated_and_driven_is_refused(self):
        with pytest.raises(InputError, match="names rod, which a law of the time drives"):
            mechanism(ROD + "actuated: [rod]\n")

    @pytest.mark.parametrize("format", ["mjcf", "urdf", "scene"])
    def test_a_model_file_has_no_time(self, robodyn, scene, format):
        """The law is named first, before a pose that contradicts it; then that there is no time."""
        pose = ["--q", "1,1"] * (format == "mjcf")
        rest = ["--format", format, *pose, "--at-time", "0.3"]
        given = robodyn("export", scene(ROD), *rest)
        told = "written for all times" if format == "scene" else "couplings[0] = 3 rad/s t"
        assert (given.code, told in given.err, "begins" in given.err) == (2, True, False)
        given = robodyn("export", scene(ROD.partition("I: 0}")[0] + "I: 1}"), *rest)
        told = "--at-time = 0.3: " + ("a scene is" if format == "scene" else "this scene is the")
        assert (given.code, told in given.err) == (2, True)

    @pytest.mark.parametrize(
        "command",
        [
            ["linearize"], ["equilibrium"], ["export", "--format", "mjcf"],
            ["export", "--format", "urdf"],
            ["trajectory", "--from", "0", "--to", "1", "--time", "min", "--max-qd", "1"],
            ["assemble", "--range"],
        ],
    )  # fmt: skip
    def test_what_cannot_take_a_law_of_the_time_says_so(self, robodyn, scene, command):
        rest = [] if command[0] in ("trajectory", "export", "equations") else ["--q", "0.1"]
        given = robodyn(command[0], scene(ROD), *command[1:], *rest)
        assert given.code == 2
        assert "couplings[0] = 3 rad/s t" in given.err

    @pytest.mark.parametrize(
        "command",
        [
            ["check"], ["torque"], ["accel"], ["reactions"], ["energy"], ["points"], ["assemble"],
            ["terms"], ["simulate", "--time", "0.2"], ["bench", "--time", "0.1"],
            ["simulate", "--time", "0.2", "--method", "taylor", "--accuracy", "1e-8"],
            ["sweep", "--vary", "links.crank.m=1,2", "--time", "0.1", "--result", "final"],
            ["export", "--format", "scene"],
        ],
    )  # fmt: skip
    def test_every_command_on_a_wholly_driven_scene(self, robodyn, scene, command):
        given = robodyn(command[0], scene(FOUR_BAR), *command[1:])
        assert given.code == 0, given.err

    def test_equations(self, robodyn, scene):
        path, mech = scene(RELATIVE), mechanism(RELATIVE)
        text = robodyn("equations", path).out
        assert "gap = 0    Psi qd + dgap/dt = 0    Psi qdd + Psidot qd = 0" in text
        assert "(dgap/dt)1 = -R1 h1_t" in text
        assert "(Psidot qd)1 = -R1 (2 h1_1_t qd1 + 0.2 qd3² + h1_t_t)" in text
        steps = robodyn("equations", path, "--steps").out
        assert "d/dt gap1 = -R1 (h1_1 qd1 - qd2" in steps
        assert "h1_1 qd1" in steps
        known: dict = {}
        exec(robodyn("equations", path, "--format", "python").out, known)
        q, qd, t = np.array([0.3, 0.2, -0.4]), np.array([1.0, 0.5, 0.2]), 0.7
        for name, given, right in (
            ("Psi", (q, t), closures.closure_jacobian(mech, q, t)),
            ("Psidot_qd", (q, qd, t), closures.closure_bias(mech, q, qd, t)),
            ("gap", (q, t), closures.closure_gap(mech, q, t)),
            ("gap_t", (q, t), closures.closure_drift(mech, q, t)),
        ):
            np.testing.assert_allclose(known[name](*given), right, atol=1e-14)


class TestFaults:
    def test_a_law_beyond_the_reach_of_a_loop(self):
        text = FOUR_BAR.replace("q1 = 5 rad/s t + 0.3 sin(2 t)", "q3 = 1.7 + 0.4 t")
        mech = mechanism(text)
        q, qd = started(mech, [], [])
        for method in ("DOP853", "taylor", "Radau"):
            motion = simulate(mech, q, qd, 10.0, method=method)
            assert motion.outcome is Outcome.LAW
            assert motion.report.t_reached == pytest.approx(2.2008, abs=1e-3)
            assert "couplings[0] = 1.7 + 0.4 t: cannot be kept at t = 2.2" in motion.report.advice

    def test_laws_that_contradict_one_another_later(self):
        free = load(ROOT / "robots" / "four-bar.yaml")
        q = assemble(free, [1.0])
        laws = f'["q1 = 1 + t", "q3 = q1 + {float(q[2]) - 1!r} + 0.1 t"]'
        start = "\nstart: {crank: 1, coupler: -0.5, rocker: 1.7}\n"
        mech = mechanism(FOUR_BAR.replace('"q1 = 5 rad/s t + 0.3 sin(2 t)"', laws) + start)
        with pytest.raises(InputError, match=r"off in velocity|loops are open"):
            simulate(mech, q, [1.0, 0.0, 1.1], 10.0)
        laws = laws.replace("0.1 t", "0.1 t^6").replace("1 + t", "1 + t^6")
        mech = mechanism(FOUR_BAR.replace('"q1 = 5 rad/s t + 0.3 sin(2 t)"', laws) + start)
        motion = simulate(mech, q, np.zeros(3), 10.0)
        assert motion.outcome is Outcome.LAW
        assert "cannot be kept" in motion.report.advice

    @pytest.mark.parametrize(
        ("law", "told"),
        [
            ("t^1.5", "has no second derivative at t = 0"),
            ("sqrt(t - 1)", "has no value at t = 0"),
        ],
    )
    def test_a_law_without_a_derivative(self, law, told):
        mech = mechanism(ROD.replace("3 rad/s t", law))
        with pytest.raises((LawError, InputError)) as caught:
            simulate(mech, [0, 0.1], [0, 0], 1.0)
        assert told in str(caught.value) or "nan" in str(caught.value)

    def test_a_law_that_ends_on_the_way(self):
        mech = mechanism(ROD.replace("3 rad/s t", "1 - sqrt(1 - t)"))
        motion = simulate(mech, [0, 0.1], [0.5, 0], 2.0)
        assert motion.outcome is Outcome.LAW
        assert motion.report.t_reached == pytest.approx(1.0, abs=1e-3)
        assert "couplings[0] = 1 - sqrt(1 - t)" in motion.report.advice

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("law", ["sqrt(q1)", "q1**1.5", "q1**2.5"])
    def test_a_law_of_joints_that_leaves_its_domain(self, law, method):
        """The free way s of two masses has s' = v0 (M(s0) / M(s))^(1/2), M = m1 + m2 f'^2."""
        mech = mechanism(TWO_SLIDES.format(law=law))
        k = {"sqrt(q1)": 0.5, "q1**1.5": 1.5, "q1**2.5": 2.5}[law]

        def mass(s):
            return 1.0 + 0.5 * (k * s ** (k - 1.0)) ** 2

        ends = quad(lambda s: (mass(s) / mass(0.5)) ** 0.5, 0.0, 0.5, limit=200)[0]
        start = [0.5, 0.5**k], [-1.0, -k * 0.5 ** (k - 1.0)]
        motion = simulate(mech, *start, 2.0, method=method)
        assert motion.outcome is Outcome.LAW
        assert motion.report.t_reached == pytest.approx(ends, abs=1e-4)
        assert np.isfinite(motion.q).all()
        why = r"(has no value at q1 = -|cannot be kept at t = 0\.)"
        assert re.match(re.escape(f"couplings[0] = {law}: ") + why, motion.report.advice)

    @pytest.mark.parametrize(
        ("law", "method"),
        [
            ("sqrt(q1)", "RK45"),
            ("0.1/q1", "DOP853"),
            ("0.1/q1", "taylor"),
            *(("q1**2.5", method) for method in METHODS),
        ],
    )
    def test_a_law_that_a_driven_joint_leads_out_of_its_domain(self, law, method):
        """The law that ends is named, not the one of the time that leads to its end."""
        mech = mechanism(TWO_SLIDES.format(law=law) + '  - "q1 = 0.5 - t"\n')
        value, slope = {
            "sqrt(q1)": (0.5**0.5, 0.5**0.5),
            "0.1/q1": (0.2, -0.4),
            "q1**2.5": (0.5**2.5, 2.5 * 0.5**1.5),
        }[law]
        motion = simulate(mech, [0.5, value], [-1.0, -slope], 2.0, method=method)
        assert motion.outcome is Outcome.LAW
        assert motion.report.t_reached == pytest.approx(0.5, abs=5e-3)
        assert f"couplings[0] = {law}: has " in motion.report.advice
        assert "q1 = " in motion.report.advice

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_the_limit_of_a_driven_joint_ends_a_run(self, method):
        mech = mechanism(ROD.replace("name: rod,", "name: rod, limits: {max: 2},"))
        motion = simulate(mech, [0, 0.1], [3, 0], 2.0, method=method)
        assert motion.outcome is Outcome.LIMIT
        assert motion.t[-1] == pytest.approx(2 / 3, abs=1e-12)


def test_steps_do_not_depend_on_rows():
    mech = mechanism(RELATIVE)
    q, qd = started(mech, [0.4, -0.7], [0.0, 0.3])
    times = np.linspace(0.0, 1.0, 50)
    few = simulate(mech, q, qd, 1.0, rtol=1e-10, atol=1e-10)
    many = simulate(mech, q, qd, 1.0, rtol=1e-10, atol=1e-10, t_eval=times)
    np.testing.assert_array_equal(few.q[-1], many.q[-1])
    assert all(a < b for a, b in pairwise(many.t))
