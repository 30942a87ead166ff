"""Controllers: error equations with exact solutions, sampling, saturation, and wrong models."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from conftest import TWO_LINK
from contact_scenes import FIVE_BAR, scene
from named_case import case
from numpy.polynomial import Polynomial
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.optimize import brentq

import oracles
import random_mechanisms
from robodyn import (
    InputError,
    Motion,
    ReferenceTable,
    RobodynError,
    SingularError,
    assemble,
    controller,
    forward_dynamics,
    gravity_vector,
    inverse_dynamics,
    load,
    loop_accelerations,
    loop_velocities,
    mass_matrix,
    other_forces,
    reference_motion,
    simulate,
)
from robodyn.control import laws
from robodyn.control.laws import driving_torques, rest_torques
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.accuracy import error_estimate, settings_for
from robodyn.runs.settings import Settings

ROBOTS = Path(__file__).resolve().parent.parent / "robots"
ARM = load(ROBOTS / "2r.yaml")
FOUR_BAR = load(ROBOTS / "four-bar.yaml")
ONE = random_mechanisms.mechanism("links: [{name: arm, m: 0.7, l: 0.9, r: 0.4, I: 0.03}]\n")
INERTIA = 0.03 + 0.7 * 0.4**2  # kg m^2, of it
SCIPYS = ("DOP853", "RK45", "Radau")
METHODS = (*SCIPYS, "taylor")
TIGHT = {"rtol": 1e-11, "atol": 1e-11}


def swing(joints: int, end: float = 2.0, rows: int = 41, given: int = 3) -> ReferenceTable:
    """Sines of other sizes and frequencies for each joint."""
    t = np.linspace(0.0, end, rows)[:, None]
    w, size = 1.3 + 0.6 * np.arange(joints), 0.5 - 0.08 * np.arange(joints)
    known = (size * np.sin(w * t), size * w * np.cos(w * t), -size * w**2 * np.sin(w * t))
    return ReferenceTable(t[:, 0], *known[:given])


def errors(motion: Motion, reference: ReferenceTable) -> np.ndarray:
    """e and ed (T, 2, actuated)."""
    driven = list(motion.mechanism.actuated)
    q, qd = reference.at(motion.t)
    return np.stack([q - motion.q[:, driven], qd - motion.qd[:, driven]], axis=1)


def error_equation(t: np.ndarray, begin: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> np.ndarray:
    """The solution of edd + kd ed + kp e = 0 from e, ed = begin (2, m) at times t, (T, 2, m)."""
    joints = []
    for j, (p, d) in enumerate(zip(kp, kd, strict=True)):
        A = np.array([[0.0, 1.0], [-p, -d]])
        joints.append(expm(t[:, None, None] * A) @ begin[:, j])
    return np.stack(joints, axis=-1)


def check_error_equation(
    mech: Mechanism, q: np.ndarray, qd: np.ndarray, reference: ReferenceTable, end: float = 2.0
) -> None:
    """Of computed torque with the true model, with every damping among the joints."""
    joints = len(mech.actuated)
    kp = 30.0 + 7.0 * np.arange(joints)
    for shift in range(3):
        damping = np.array([(0.3, 1.0, 2.1)[(j + shift) % 3] for j in range(joints)])
        kd = 2.0 * damping * np.sqrt(kp)
        tau = controller(mech, reference, "computed-torque", kp, kd)
        times = np.linspace(0.0, end, 21)
        motion = simulate(mech, q, qd, end, tau=tau, t_eval=times, **TIGHT)
        assert motion.outcome.label == "finished"
        found = errors(motion, reference)
        assert np.abs(found[0]).max() > 0.01  # there is something to forget
        known = error_equation(times, found[0], kp, kd)
        assert np.abs(found - known).max() < 1e-8
        assert motion.report.energy_drift < 1e-8


class TestComputedTorque:
    """With the true model the error obeys a linear equation, whatever the mechanism does."""

    @pytest.mark.parametrize("given", [1, 2, 3])
    def test_of_the_arm(self, given: int) -> None:
        start = np.array([0.3, -0.5]), np.array([0.4, 1.0])
        check_error_equation(ARM, *start, swing(2, given=given))

    @pytest.mark.parametrize("seed", range(3))
    def test_of_random_trees(self, seed: int) -> None:
        scene = random_mechanisms.forced(seed, random_mechanisms.seeded_tree(seed, 2 + seed))
        check_error_equation(scene.mechanism, scene.q, scene.qd, swing(scene.n), 1.0)

    def test_of_the_four_bar(self) -> None:
        q = assemble(FOUR_BAR, [0.9])
        qd = loop_velocities(FOUR_BAR, q, [2.0])
        check_error_equation(FOUR_BAR, q, qd, swing(1))

    @pytest.mark.parametrize("name", ["slider-crank", "five-bar", "geared-five-bar"])
    def test_of_other_loops(self, name: str) -> None:
        mech = load(ROBOTS / f"{name}.yaml")
        known = swing(len(mech.actuated), 0.4, 9)
        q = assemble(mech, known.at(0.0)[0] + 1.2)
        shifted = ReferenceTable(known.times, known.at(known.times)[0] + 1.1)
        qd = loop_velocities(mech, q, known.at(0.0)[1])
        check_error_equation(mech, q, qd, shifted, 0.4)

    @pytest.mark.parametrize("method", SCIPYS)
    def test_where_the_reference_jumps(self, method: str) -> None:
        """Cubics between rows: qdd_ref jumps, and every method steps onto it and goes on."""
        known = swing(2, 1.0, 6, given=2)
        assert known.jumps
        tau = controller(ARM, known, "computed-torque", 40.0, 9.0)
        motion = simulate(ARM, [0.2, 0.1], [0.0, 0.0], 1.0, tau=tau, method=method, **TIGHT)
        assert set(known.times) <= set(motion.t.tolist())
        found = errors(motion, known)
        gains = np.full(2, 40.0), np.full(2, 9.0)
        apart = np.abs(found - error_equation(motion.t, found[0], *gains)).max()
        assert apart < 1e-8
        at = np.isin(motion.t, known.times[1:-1])
        ahead = forward_dynamics(ARM, motion.q, motion.qd, motion.tau)[at]
        wanted = 2.0 * known.coefficients[1:, :, 2]  # qdd_ref of the piece ahead
        v = wanted + 9.0 * found[at, 1] + 40.0 * found[at, 0]
        assert ahead == pytest.approx(v, abs=1e-9 * np.abs(v).max())

    @pytest.mark.parametrize("profile", ["quintic", "cubic", "trapezoidal", "cycloidal"])
    @pytest.mark.parametrize("mech", [ARM, FOUR_BAR], ids=lambda mech: f"{mech.n}")
    def test_a_reference_motion_is_followed(self, mech: Mechanism, profile: str) -> None:
        points = np.array([[0.9, 0.2], [1.5, 0.7], [1.2, 1.1]])[:, : len(mech.actuated)]
        known = reference_motion(mech, points, 1.5, profile=profile)
        times = np.linspace(0.0, 1.5, 31)
        q, qd, _ = known.states(times)
        tau = controller(mech, known, "computed-torque", 40.0, 9.0)
        motion = simulate(mech, q[0], qd[0], 1.5, tau=tau, t_eval=times, **TIGHT)
        assert np.abs(motion.q - q).max() < 1e-9
        assert np.abs(motion.qd - qd).max() < 1e-8

    def test_no_step_is_tried_in_vain_where_it_jumps(self) -> None:
        known = swing(2, 1.0, 21, given=2)
        tau = controller(ARM, known, "computed-torque", 4.0, 4.0)
        motion = simulate(ARM, [0.2, 0.1], [0, 0], 1.0, tau=tau, method="DOP853")
        assert motion.report.evaluations <= 14 * motion.report.steps

    @pytest.mark.parametrize("given", [2, 3])
    def test_backwards(self, given: int) -> None:
        t = np.linspace(-1.0, 0.0, 8)[:, None]
        w = np.array([1.1, 0.7])
        rows = (np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t))
        known = ReferenceTable(t[:, 0], *rows[:given])
        tau = controller(ARM, known, "computed-torque", 9.0, 2.0)
        motion = simulate(ARM, [0.1, 0.2], [1.0, 1.0], -1.0, tau=tau, **TIGHT)
        found = errors(motion, known)
        exact = error_equation(motion.t, found[0], np.full(2, 9.0), np.full(2, 2.0))
        assert np.abs(found - exact).max() < 1e-8
        assert motion.report.energy_drift < 1e-9


class TestLaws:
    """The torques of a run are those of the equations, at every row."""

    @pytest.mark.parametrize("law", ["pd", "pd+g", "computed-torque"])
    def test_torques(self, law: str) -> None:
        known = swing(2)
        kp, kd = np.array([60.0, 25.0]), np.array([8.0, 3.0])
        tau = controller(ARM, known, law, kp, kd)
        motion = simulate(ARM, [0.3, -0.2], [0.5, 0.0], 2.0, tau=tau)
        e, ed = np.moveaxis(errors(motion, known), 1, 0)
        if law == "computed-torque":
            w, size = np.array([1.3, 1.9]), np.array([0.5, 0.42])
            qdd = -size * w**2 * np.sin(w * motion.t[:, None])  # the rows are close enough
            for k, (q, qd) in enumerate(zip(motion.q, motion.qd, strict=True)):
                M, C, G = oracles.two_link_terms(TWO_LINK, q, qd)
                wanted = M @ (qdd[k] + kd * ed[k] + kp * e[k]) + C @ qd + G
                assert motion.tau[k] == pytest.approx(wanted, abs=1e-3)
            return
        wanted = kp * e + kd * ed
        if law == "pd+g":
            wanted = wanted + gravity_vector(ARM, motion.q)
        assert motion.tau == pytest.approx(wanted, abs=1e-11)

    def test_of_a_passive_joint_there_is_none(self) -> None:
        text = (ROBOTS / "2r.yaml").read_text() + "actuated: [forearm]\n"
        mech = random_mechanisms.mechanism(text)
        tau = controller(mech, swing(1), "pd+g", 20.0, 2.0)
        motion = simulate(mech, [0.3, -0.2], [0.5, 0.0], 1.0, tau=tau)
        assert not motion.tau[:, 0].any()
        G = gravity_vector(mech, motion.q)[:, 1]
        e, ed = np.moveaxis(errors(motion, swing(1)), 1, 0)
        assert motion.tau[:, 1] == pytest.approx((20 * e + 2 * ed)[:, 0] + G, abs=1e-11)

    def test_a_reference_of_all_joints_serves(self) -> None:
        t = np.linspace(0.0, 1.0, 5)
        q = assemble(FOUR_BAR, np.sin(t)[:, None])
        full = controller(FOUR_BAR, ReferenceTable(t, q), "pd", 9.0, 1.0)
        part = controller(FOUR_BAR, ReferenceTable(t, q[:, :1]), "pd", 9.0, 1.0)
        runs = [simulate(FOUR_BAR, q[2], 0 * q[2], 1.0, tau=tau) for tau in (full, part)]
        assert np.array_equal(runs[0].q, runs[1].q)

    @pytest.mark.parametrize("rate", [None, 50.0])
    def test_saturation(self, rate: float | None) -> None:
        most = np.array([9.0, 2.0])
        tau = controller(ARM, swing(2), "pd", [90.0, 12.0], [9.0, 1.0], most, rate)
        motion = simulate(ARM, [1.3, -0.2], [0.0, 0.0], 2.0, tau=tau)
        assert motion.outcome.label == "finished"
        assert (np.abs(motion.tau) <= most).all()
        free = controller(ARM, swing(2), "pd", [90.0, 12.0], [9.0, 1.0], None, rate)
        assert (np.abs(simulate(ARM, [1.3, -0.2], [0, 0], 2.0, tau=free).tau) > most).any(0).all()
        assert motion.report.energy_drift < 1e-7
        e, ed = np.moveaxis(errors(motion, swing(2)), 1, 0)
        if rate is None:
            wanted = np.clip([90.0, 12.0] * e + [9.0, 1.0] * ed, -most, most)
            assert motion.tau == pytest.approx(wanted, abs=1e-11)
        largest = [joint.largest_torque for joint in motion.report.tracking or []]
        assert largest == pytest.approx(np.abs(motion.tau).max(axis=0))
        assert (largest == most).any()


class TestWrongModel:
    """Twenty per cent of a mass: an error stays that the true model's gravity does not leave."""

    TARGET = np.array([0.6, 0.4])
    HOLD = ReferenceTable([0.0, 10.0], [TARGET, TARGET], np.zeros((2, 2)))

    def rest(self, law: str, believed: Mechanism | None = None) -> Motion:
        gains = ([80.0, 40.0], [20.0, 4.0]) if law != "computed-torque" else (30.0, 11.0)
        tau = controller(ARM, self.HOLD, law, *gains, control_model=believed)
        motion = simulate(ARM, [0.2, 0.1], [0.0, 0.0], 10.0, tau=tau, t_eval=[10.0])
        assert np.abs(motion.qd).max() < 1e-7
        return motion

    @pytest.fixture
    def heavier(self) -> Mechanism:
        text = (ROBOTS / "2r.yaml").read_text()
        assert "m: 0.9" in text
        return random_mechanisms.mechanism(text.replace("m: 0.9", "m: 1.08"))

    def test_the_true_model_leaves_none(self) -> None:
        for law in ("pd+g", "computed-torque"):
            assert self.rest(law).q[0] == pytest.approx(self.TARGET, abs=1e-7)

    def test_pd_alone_hangs_below(self) -> None:
        motion = self.rest("pd")
        e = self.TARGET - motion.q[0]
        assert np.abs(e).max() > 0.05
        assert np.array([80.0, 40.0]) * e == pytest.approx(
            gravity_vector(ARM, motion.q[0]), abs=1e-6
        )

    def test_the_wrong_model_leaves_what_its_gravity_misses(self, heavier: Mechanism) -> None:
        for law in ("pd+g", "computed-torque"):
            motion = self.rest(law, heavier)
            q, e = motion.q[0], self.TARGET - motion.q[0]
            assert np.abs(e).max() > 0.01
            missing = gravity_vector(ARM, q) - gravity_vector(heavier, q)
            stiffness = np.diag([80.0, 40.0])
            if law == "computed-torque":
                stiffness = 30.0 * mass_matrix(heavier, q)
            assert stiffness @ e == pytest.approx(missing, abs=1e-6)


def sampled_double_integrator(
    reference: list[Polynomial], start: tuple[float, float], rate: float, count: int, most: float
) -> tuple[np.ndarray, np.ndarray]:
    """States (count + 1, 2) and torques (count + 1,) of J qdd = held PD torque; kp 3, kd 0.8."""
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0 / INERTIA]])
    block = expm(np.block([[A, B], [np.zeros((1, 3))]]) / rate)
    state, states, torques = np.array(start), [], []
    for k in range(count + 1):
        q, qd = reference[0](k / rate), reference[0].deriv()(k / rate)
        tau = np.clip(3.0 * (q - state[0]) + 0.8 * (qd - state[1]), -most, most)
        states.append(state)
        torques.append(tau)
        state = block[:2, :2] @ state + block[:2, 2] * tau
    return np.array(states), np.array(torques)


class TestSampled:
    """A torque is computed from the state at each sample, and held until the next."""

    MOTION = (Polynomial([0.2, 0.4, -0.9, 0.3]),)

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("most", [0.4, 1e3])
    @pytest.mark.thinned
    def test_of_a_double_integrator(self, method: str, most: float) -> None:
        times = np.linspace(0.0, 3.0, 4)
        rows = [np.stack([p.deriv(d)(times) for p in self.MOTION], axis=1) for d in range(2)]
        reference = ReferenceTable(times, *rows)
        rate, count = 16.0, 48
        tau = controller(ONE, reference, "pd", 3.0, 0.8, most, rate)
        stamps = np.arange(count + 1) / rate
        motion = simulate(ONE, [1.0], [-0.5], 3.0, tau, method, t_eval=stamps, **TIGHT)
        known, torques = sampled_double_integrator(
            list(self.MOTION), (1.0, -0.5), rate, count, most
        )
        assert motion.outcome.label == "finished"
        assert motion.tau[:, 0] == pytest.approx(torques, abs=2e-9)
        assert motion.q[:, 0] == pytest.approx(known[:, 0], abs=1e-9)
        assert motion.qd[:, 0] == pytest.approx(known[:, 1], abs=1e-9)

    @pytest.mark.parametrize("method", ["DOP853", "Radau", "taylor"])
    def test_of_an_arm_against_runs_from_sample_to_sample(self, method: str) -> None:
        kp, kd, rate = np.array([70.0, 9.0]), np.array([11.0, 0.9]), 40.0
        reference = swing(2, 1.0)
        tau = controller(ARM, reference, "pd+g", kp, kd, control_rate=rate)
        stamps = np.arange(41) / rate
        start = np.array([0.3, -0.4, 0.2, 0.7])
        motion = simulate(ARM, start[:2], start[2:], 1.0, tau, method, t_eval=stamps, **TIGHT)
        y, states = start, [start]
        for begin, end in itertools.pairwise(stamps):
            e, ed = (x - z for x, z in zip(reference.at(begin), (y[:2], y[2:]), strict=True))
            held = kp * e + kd * ed + oracles.two_link_terms(TWO_LINK, y[:2], y[2:])[2]

            def rates(t: float, y: np.ndarray, held: np.ndarray = held) -> np.ndarray:
                qdd = oracles.two_link_acceleration(TWO_LINK, y[:2], y[2:], held)
                return np.concatenate([y[2:], qdd])

            run = solve_ivp(rates, (begin, end), y, method="DOP853", rtol=1e-12, atol=1e-12)
            y = run.y[:, -1]
            states.append(y)
        found = np.concatenate([motion.q, motion.qd], axis=1)
        assert found == pytest.approx(np.array(states), abs=1e-9)
        assert motion.report.energy_drift < 1e-9

    @pytest.mark.parametrize("method", METHODS)
    def test_the_torque_is_constant_between_samples(self, method: str) -> None:
        rate, end = 30.0, 1.0
        tau = controller(ARM, swing(2, 1.5), "pd", 20.0, 2.0, control_rate=rate)
        between = np.sort(np.concatenate([np.arange(31) / rate, np.linspace(0, end, 211)[1:-1]]))
        times = np.unique(between)
        loose = {"rtol": 1e-5, "atol": 1e-5}
        motion = simulate(ARM, [0.1, 0.2], [0, 0], end, tau, method, t_eval=times, **loose)
        index = np.floor(times * rate + 1e-9).astype(int)
        for k in range(31):
            assert len(np.unique(motion.tau[index == k], axis=0)) == 1
        assert len(np.unique(motion.tau, axis=0)) == 31
        steps = simulate(ARM, [0.1, 0.2], [0, 0], end, tau, method, **loose)
        assert {k / rate for k in range(31)} <= set(steps.t.tolist())
        e, ed = np.moveaxis(errors(steps, swing(2, 1.5)), 1, 0)
        at = np.isin(steps.t, [k / rate for k in range(31)])
        assert steps.tau[at] == pytest.approx((20.0 * e + 2.0 * ed)[at], abs=1e-12)

    def test_rows_between_steps_are_those_of_the_held_torque(self) -> None:
        """Dense output is asked for after the next sample has been taken."""
        tau = controller(ONE, ReferenceTable([0, 1], [[1.0], [1.0]]), "pd", 9.0, 0.0, None, 4.0)
        times = np.linspace(0.0, 1.0, 101)
        for method in METHODS:
            motion = simulate(ONE, [0.0], [0.0], 1.0, tau, method, t_eval=times, **TIGHT)
            k = np.searchsorted(np.arange(5) / 4, times, side="right") - 1
            begin = motion.t.searchsorted(k / 4)
            x = times - k / 4
            a = motion.tau[begin, 0] / INERTIA
            known = motion.q[begin, 0] + motion.qd[begin, 0] * x + a * x**2 / 2
            assert motion.q[:, 0] == pytest.approx(known, abs=1e-9), method

    def test_samples_that_do_not_fit_the_time(self) -> None:
        """0.37 s at 30 Hz; and a sample that is the end but for rounding."""
        tau = controller(ARM, swing(2), "pd", 20.0, 2.0, control_rate=30.0)
        for end in (0.37, 0.7, np.nextafter(0.7, 0.0), np.nextafter(0.7, 1.0)):
            for method in ("DOP853", "taylor"):
                motion = simulate(ARM, [0.1, 0.2], [0, 0], end, tau, method)
                assert motion.outcome.label == "finished"
                assert motion.t[-1] == end
                count = int(np.floor(end * 30.0 + 1e-9)) + 1
                assert len(np.unique(motion.tau, axis=0)) == count

    def test_faster_sampling_comes_nearer_to_the_continuous_law(self) -> None:
        known = simulate(
            ARM, [0.3, 0.0], [0, 0], 1.0, controller(ARM, swing(2), "pd", 30.0, 4.0), t_eval=[1.0]
        ).q[0]
        apart = []
        for rate in (200.0, 400.0, 800.0):
            tau = controller(ARM, swing(2), "pd", 30.0, 4.0, control_rate=rate)
            found = simulate(ARM, [0.3, 0.0], [0, 0], 1.0, tau, t_eval=[1.0]).q[0]
            apart.append(np.abs(found - known).max())
        assert apart[0] / apart[1] == pytest.approx(2.0, rel=0.1)
        assert apart[1] / apart[2] == pytest.approx(2.0, rel=0.1)

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_across_change_points(self, method: str) -> None:
        mech = load(ROBOTS / "parallelogram.yaml")
        t = np.linspace(0.0, 1.5, 31)[:, None]
        joints = len(mech.actuated)
        reference = ReferenceTable(t[:, 0], np.repeat(0.5 + 3.0 * t, joints, axis=1))
        tau = controller(mech, reference, "pd", 20.0, 4.0, control_rate=25.0)
        q = assemble(mech, np.full(joints, 0.6))
        qd = loop_velocities(mech, q, np.full(joints, 3.0))
        motion = simulate(mech, q, qd, 1.5, tau, method, t_eval=np.arange(38) / 25, **TIGHT)
        assert motion.outcome.label == "finished"
        assert motion.q[:, 0].max() > np.pi
        e, ed = np.moveaxis(errors(motion, reference), 1, 0)
        driven = list(mech.actuated)
        assert motion.tau[:, driven] == pytest.approx(20.0 * e + 4.0 * ed, abs=1e-9)
        assert motion.report.energy_drift < 1e-8

    def test_it_does_not_run_backwards(self) -> None:
        reference = ReferenceTable([-1.0, 0.0], [[0.0, 0.0], [1.0, 1.0]])
        tau = controller(ARM, reference, "pd", 1.0, 1.0, control_rate=10.0)
        with pytest.raises(InputError, match=r"control_rate.*backwards"):
            simulate(ARM, [0, 0], [0, 0], -1.0, tau)


class TestRuns:
    """What the report says of a run; that a controller serves again and again."""

    @pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau"])
    def test_tracking(self, method: str) -> None:
        kp, kd = np.array([30.0, 50.0]), np.array([2.0, 9.0])
        reference = swing(2)
        tau = controller(ARM, reference, "computed-torque", kp, kd)
        motion = simulate(ARM, [0.3, -0.5], [0.4, 1.0], 2.0, tau, method)
        t = np.linspace(0.0, 2.0, 2001)
        begin = errors(motion, reference)[0]
        e = error_equation(t, begin, kp, kd)[:, 0]
        found = motion.report.tracking
        assert found is not None
        assert [joint.joint for joint in found] == ["upper arm", "forearm"]
        for j, joint in enumerate(found):
            assert joint.rms == pytest.approx(
                np.sqrt(np.trapezoid(e[:, j] ** 2, t) / 2.0), rel=1e-4
            )
            worst = np.abs(e[:, j]).argmax()
            assert joint.largest == pytest.approx(np.abs(e[worst, j]), rel=1e-4)
            assert joint.at == pytest.approx(t[worst], abs=2e-3)
            assert joint.largest_torque == np.abs(motion.tau[:, j]).max()

    def test_without_a_controller_nothing_is_tracked(self) -> None:
        assert simulate(ARM, [0, 0], [0, 0], 0.1).report.tracking is None

    def test_of_no_time(self) -> None:
        tau = controller(ARM, swing(2), "pd", 1.0, 1.0)
        found = simulate(ARM, [0.25, 0.0], [0, 0], 0.0, tau).report.tracking
        assert found is not None
        assert (found[0].rms, found[0].largest, found[0].at) == (0.25, 0.25, 0.0)

    @pytest.mark.parametrize("options", [{}, {"control_rate": 20.0}])
    def test_again(self, options: dict[str, float]) -> None:
        reference = swing(2, 1.0, 6, given=2)
        tau = controller(ARM, reference, "computed-torque", 30.0, 8.0, **options)
        start = [0.2, 0.1], [0.0, 0.3]
        first = simulate(ARM, *start, 1.0, tau)
        other = simulate(ARM, [0.0, 1.0], [1.0, 0.0], 0.55, tau, "RK45")
        assert other.outcome.label == "finished"
        again = simulate(ARM, *start, 1.0, tau)
        assert np.array_equal(first.q, again.q)
        assert np.array_equal(first.tau, again.tau)
        assert first.report.tracking == again.report.tracking

    def test_accuracy(self) -> None:
        tau = controller(ARM, swing(2), "pd", [30.0, 5.0], [4.0, 0.6], control_rate=20.0)
        begin = np.array([0.2, 0.1, 0.0, 0.3])
        settings, estimate = settings_for(ARM, begin, 1.0, tau, Settings("auto"), 1e-8)
        assert settings.method == "taylor"
        assert estimate < 1e-8
        smooth = controller(ARM, swing(2), "pd", 30.0, 4.0)
        settings, estimate = settings_for(ARM, begin, 1.0, smooth, Settings("auto"), 1e-8)
        assert settings.method == "DOP853"
        assert error_estimate(ARM, begin, 1.0, smooth, settings) < 1e-8


class TestRefused:
    def refused(self, *parts: str, mech: Mechanism = ARM, **changes: object) -> None:
        options: dict = {"reference": swing(2), "control": "pd", "kp": 1.0, "kd": 1.0} | changes
        with pytest.raises(RobodynError) as caught:
            controller(mech, **options)
        for part in parts:
            assert part in str(caught.value)

    def test_gains(self) -> None:
        self.refused("kp = -1", ">= 0", kp=-1.0)
        self.refused("kd = nan", kd=[1.0, np.nan])
        self.refused("kp = 3 values", "needs 1 value, or 2", "upper arm, forearm", kp=[1, 2, 3])
        self.refused("tau_max = 0", "> 0", tau_max=0.0)
        self.refused("tau_max = inf", "finite", tau_max=[1.0, np.inf])

    def test_laws(self) -> None:
        self.refused("control = pi", "pd, pd+g, computed-torque", control="pi")

    def test_rates(self) -> None:
        for rate in (0.0, -1.0, np.nan, np.inf):
            self.refused("control_rate", "> 0", control_rate=rate)
        self.refused("control_rate = 1e+09", "2e+09 samples", control_rate=1e9)

    def test_models(self) -> None:
        self.refused("four-bar.yaml", "3 joints, but 2 joints in", control_model=FOUR_BAR)
        text = (ROBOTS / "2r.yaml").read_text() + "actuated: [forearm]\n"
        other = random_mechanisms.mechanism(text)
        self.refused("scene.yaml", "actuates q2, but actuates q1, q2 in", control_model=other)

    def test_references(self) -> None:
        self.refused("reference", "3 joints", "2 actuated", reference=swing(3))
        tau = controller(ARM, swing(2, 1.0), "pd", 1.0, 1.0)
        for end in (1.5, -0.1):
            with pytest.raises(InputError, match=r"reference = 0 to 1 s: must cover 0 to"):
                simulate(ARM, [0, 0], [0, 0], end, tau)

    def test_actuators(self) -> None:
        text = (ROBOTS / "2r.yaml").read_text() + "actuated: []\n"
        self.refused("no joint is actuated", mech=random_mechanisms.mechanism(text))
        text = text.replace("[]", "[forearm]")
        mech = random_mechanisms.mechanism(text)
        options = {"reference": swing(1), "control": "computed-torque"}
        self.refused("fewer actuators", mech=mech, **options)

    def test_series(self) -> None:
        tau = controller(ARM, swing(2), "pd", 1.0, 1.0)
        assert isinstance(tau, Actuation)
        with pytest.raises(InputError, match=r"continuously has no series.*DOP853"):
            simulate(ARM, [0, 0], [0, 0], 1.0, tau, "taylor")


def test_a_set_point_beyond_a_dead_centre_ends_the_run_soon() -> None:
    """The rods of a five-bar line up on the way: what is asked of the cranks has no bound there."""
    mechanism = scene(FIVE_BAR.format(each="damping: 0.01"))
    w, ways = np.sqrt(50.0 - 2.0**2), np.array([0.4, -0.3])

    def left(t: float) -> float:
        """Of the rods' 1.6 m between the cranks' tips; e decays as edd + 4 ed + 50 e = 0 has it."""
        still = np.exp(-2.0 * t) * (np.cos(w * t) + 2.0 / w * np.sin(w * t))
        tips = 0.5 * np.exp(1j * (np.array([2.0, 1.0]) + ways * (1.0 - still)))
        return float(1.6 - abs(1.0 + tips[1] - tips[0]))

    lined_up = brentq(left, 0.0, 0.3)
    q, beyond = assemble(mechanism, [2.0, 1.0]), ReferenceTable.set_point([2.4, 0.7], 2.0)
    for rate, most in ((None, 200_000), (100.0, 2_000)):
        law = controller(mechanism, beyond, "computed-torque", 50.0, 4.0, control_rate=rate)
        motion = simulate(mechanism, q, np.zeros(4), 2.0, tau=law, max_evals=most)
        assert motion.outcome.label == ("too many evaluations" if rate else "step too small")
        assert motion.report.evaluations < 10_000
        assert motion.t[-1] == pytest.approx(lined_up, abs=0.03 if rate else 1e-8)
        assert "of a at t = 0.1" in motion.report.advice
        assert "beside a dead centre" in motion.report.advice


# Reference tables: what lies between their rows, and where its derivatives jump.


TIMES = np.array([-0.3, 0.0, 0.4, 0.5, 1.1, 1.7])
BETWEEN = np.linspace(-0.3, 1.7, 201)


def rows(motion, times=TIMES, given=3):
    """q, qd, qdd (or the first of them) of a list of polynomials at times."""
    return [np.stack([p.deriv(d)(times) for p in motion], axis=1) for d in range(given)]


@pytest.mark.parametrize(("given", "degree"), [(3, 5), (2, 3), (1, 3)])
def test_a_polynomial_that_the_rows_determine_is_kept(given: int, degree: int) -> None:
    rng = np.random.default_rng(given)
    motion = [Polynomial(rng.normal(size=degree + 1)) for _ in range(2)]
    found = ReferenceTable(TIMES, *rows(motion, given=given))
    known = rows(motion, BETWEEN)
    for values, expected in zip(found.at(BETWEEN), known, strict=False):
        assert values == pytest.approx(expected, abs=1e-12)
    assert found.kinks == []
    assert not found.jumps


def test_rows_are_kept_with_their_derivatives() -> None:
    rng = np.random.default_rng(7)
    q, qd, qdd = rng.normal(size=(3, len(TIMES), 3))
    found = ReferenceTable(TIMES, q, qd, qdd)
    side = 1e-5  # a step for differences of qd
    for t, *known in zip(TIMES[1:-1], q[1:-1], qd[1:-1], qdd[1:-1], strict=True):
        assert found.at(t)[0] == pytest.approx(known[0], abs=1e-14)
        assert found.at(t)[1] == pytest.approx(known[1], abs=1e-13)
        for way in (-side, side):
            slope = (found.at(t + way)[1] - found.at(t)[1]) / way
            assert slope == pytest.approx(known[2], abs=0.5)
    assert found.kinks == TIMES[1:-1].tolist()  # of the third derivative
    assert not found.jumps


def test_angles_alone_make_scipys_spline() -> None:
    q = np.random.default_rng(3).normal(size=(len(TIMES), 2))
    found, known = ReferenceTable(TIMES, q), CubicSpline(TIMES, q)
    assert found.at(BETWEEN)[0] == pytest.approx(known(BETWEEN), abs=1e-12)
    assert found.at(BETWEEN)[1] == pytest.approx(known(BETWEEN, 1), abs=1e-11)
    assert found.kinks == TIMES[2:-2].tolist()  # not-a-knot at the second and the last but one
    assert not found.jumps


def test_rates_without_accelerations_make_these_jump() -> None:
    q, qd = np.random.default_rng(4).normal(size=(2, len(TIMES), 2))
    found = ReferenceTable(TIMES, q, qd)
    assert found.kinks == TIMES[1:-1].tolist()
    assert found.jumps


def test_close_rows_of_a_smooth_motion_are_no_kinks() -> None:
    t = np.linspace(0.0, 2.0, 2001)[:, None]
    smooth = ReferenceTable(t[:, 0], np.sin(t), np.cos(t), -np.sin(t))
    assert smooth.kinks == []
    bent = np.where(t < 1.0, 0.0, (t - 1.0) ** 2)
    slope = np.where(t < 1.0, 0.0, 2.0 * (t - 1.0))
    one = ReferenceTable(t[:, 0], bent, slope)
    assert one.kinks == [1.0]
    assert one.jumps


def test_two_rows_are_enough() -> None:
    line = ReferenceTable([0.0, 2.0], [[1.0], [3.0]])
    assert line.at([0.5, 2.0])[0].tolist() == [[1.5], [3.0]]
    assert line.at(0.5)[1].tolist() == [1.0]
    still = ReferenceTable([0.0, 2.0], [[1.0], [1.0]], [[0.0], [0.0]])
    assert still.at(1.3)[0].tolist() == [1.0]


def test_some_of_the_joints() -> None:
    q, qd = np.random.default_rng(5).normal(size=(2, len(TIMES), 3))
    chosen = ReferenceTable(TIMES, q, qd).of([2, 0])
    assert chosen.at(0.7)[0] == pytest.approx(ReferenceTable(TIMES, q, qd).at(0.7)[0][[2, 0]])


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (([0.0], [[1.0]]), ("rows = 1", "two or more")),
        (([0.0, 1.0, 1.0], np.ones((3, 1))), ("t = 1", "increase", "before has 1")),
        (([0.0, np.nan], np.ones((2, 1))), ("t", "finite")),
        (([0.0, 1.0], [[1.0], [np.inf]]), ("q", "finite")),
        (([0.0, 1.0], np.ones((3, 1))), ("shape of q", "(3, 1)", "(2, joints)")),
        (([0.0, 1.0], np.ones((2, 2)), np.ones((2, 1))), ("shape of qd", "(2, 1)")),
        (([0.0, 1.0], np.ones((2, 1)), None, np.ones((2, 1))), ("qdd", "needs qd")),
    ],
)
def test_what_is_no_reference(arguments: tuple, parts: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as caught:
        ReferenceTable(*arguments, where="ref.csv")
    for part in ("ref.csv", *parts):
        assert part in str(caught.value)


# The torques that hold a model at rest, and those that drive it.


def scenes() -> list[random_mechanisms.Scene]:
    trees = [random_mechanisms.seeded_tree(seed, n) for seed, n in enumerate((1, 2, 4, 6))]
    loops = [
        random_mechanisms.seeded_scene(seed, shape)
        for seed, shape in enumerate(random_mechanisms.LOOPS.values())
    ]
    forced = [random_mechanisms.forced(k, scene) for k, scene in enumerate(trees + loops)]
    return trees + loops + forced


def test_the_inverse_dynamics_of_what_the_actuated_joints_do() -> None:
    for made in scenes():
        with case(made):
            mech = made.mechanism
            driven = list(mech.actuated)
            v = made.qdd[driven]
            qdd = loop_accelerations(mech, made.q, made.qd, v)
            known = inverse_dynamics(mech, made.q, made.qd, qdd)[driven]
            found = driving_torques(mech)(*made.q, *made.qd, *v)
            assert found == pytest.approx(known, abs=1e-9 * max(1.0, np.abs(known).max()))
            still = inverse_dynamics(mech, made.q, 0 * made.q, 0 * made.q)[driven]
            found = rest_torques(mech)(*made.q)
            assert found == pytest.approx(still, abs=1e-9 * max(1.0, np.abs(still).max()))


def test_at_rest_an_open_chain_needs_its_gravity_vector() -> None:
    for seed in range(4):
        scene = random_mechanisms.forced(seed, random_mechanisms.seeded_tree(seed, 4))
        mech = scene.mechanism
        known = gravity_vector(mech, scene.q) - other_forces(mech, scene.q, 0 * scene.q)
        assert rest_torques(mech)(*scene.q) == pytest.approx(known, abs=1e-10)


def underactuated(text: str) -> Mechanism:
    return random_mechanisms.mechanism(text + "actuated: [upper arm]\n")


def test_fewer_actuators_than_freedoms() -> None:
    arm = underactuated((ROBOTS / "2r.yaml").read_text())
    q = [0.4, -0.9]
    assert rest_torques(arm)(*q) == pytest.approx(gravity_vector(arm, q)[:1], abs=1e-12)
    with pytest.raises(RobodynError, match=r"q2.*free"):
        driving_torques(arm)


def test_more_actuators_than_freedoms() -> None:
    text = (ROBOTS / "four-bar.yaml").read_text().replace("[crank]", "[crank, rocker]")
    mech = random_mechanisms.mechanism(text)
    with pytest.raises(InputError, match="2 actuators for a mobility of 1"):
        driving_torques(mech)
    q = assemble(load(ROBOTS / "four-bar.yaml"), [1.0])
    with pytest.warns(UserWarning, match="least norm"):
        found = rest_torques(mech)(*q)
    with pytest.warns(UserWarning, match="least norm"):
        known = inverse_dynamics(mech, q, 0 * q, 0 * q)
    assert found == pytest.approx(known[[0, 2]])


def test_many_links_go_without_code(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = random_mechanisms.seeded_tree(3, 4)
    q, qd, v = scene.q, scene.qd, scene.qdd
    known = driving_torques(scene.mechanism)(*q, *qd, *v), rest_torques(scene.mechanism)(*q)
    monkeypatch.setattr(laws.formulas, "MAX_GENERATED", 3)
    assert driving_torques(scene.mechanism)(*q, *qd, *v) == pytest.approx(known[0], abs=1e-11)
    assert rest_torques(scene.mechanism)(*q) == pytest.approx(known[1], abs=1e-11)


def test_a_dead_centre() -> None:
    """The rocker cannot drive the four-bar where crank and coupler are in line."""
    text = (ROBOTS / "four-bar.yaml").read_text().replace("[crank]", "[rocker]")
    mech = random_mechanisms.mechanism(text)
    a, b, c, d = 0.35, 0.95, 0.8, 1.1  # crank and coupler in line: rocker at its limit
    crank = np.arccos(((a + b) ** 2 + d**2 - c**2) / (2 * (a + b) * d))
    tip = (a + b) * np.exp(1j * crank)
    q = np.array([crank, 0.0, np.angle(tip - d)])
    with pytest.raises(SingularError, match="dead centre"):
        driving_torques(mech)(*q, 0.0, 0.0, 0.0, 1.0)
