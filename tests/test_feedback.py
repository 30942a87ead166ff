"""Integral action, set-points, references held at their end, and state feedback.

Known motions come from matrix exponentials, and from solve_ivp or loops of other equations.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import TWO_LINK
from named_case import case
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_are

import oracles
import random_mechanisms
from robodyn import (
    InputError,
    Motion,
    ReferenceTable,
    assemble,
    controller,
    load,
    loop_velocities,
    simulate,
)
from robodyn.control.state_feedback import StateFeedback, read_feedback
from robodyn.runs.accuracy import error_estimate, settings_for
from robodyn.runs.right_hand_side import right_hand_side
from robodyn.runs.settings import Settings

ROBOTS = Path(__file__).resolve().parent.parent / "robots"
ARM = load(ROBOTS / "2r.yaml")
G, MASS, DAMPING = 9.81, 1.4, 0.7
LIFT_TEXT = f"""gravity: {G}
links:
  - {{name: lift, joint: prismatic, axis: [0, 1], m: {MASS}, l: 0, r: 0, I: 0, damping: {DAMPING}}}
"""
LIFT = random_mechanisms.mechanism(LIFT_TEXT)  # MASS qdd = tau - DAMPING qd - MASS G
KP, KD, KI = 60.0, 12.0, 45.0
SCIPYS = ("DOP853", "RK45", "Radau")
METHODS = (*SCIPYS, "taylor")
TIGHT = {"rtol": 1e-11, "atol": 1e-11}
FINE = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
CART_TEXT = """gravity: 9.8
links:
  - {name: cart, joint: prismatic, axis: [1, 0], m: 1.0, l: 0, r: 0, I: 0}
  - {name: pole, m: 0.1, l: 1.0, r: 0.5, I: 0.008333333333333333}
actuated: [cart]
"""
CART = random_mechanisms.mechanism(CART_TEXT)


def set_point(*q: float, until: float = 10.0) -> ReferenceTable:
    return ReferenceTable.set_point(q, until)


class TestIntegral:
    """z of zd = e removes what a constant load leaves."""

    @pytest.mark.parametrize("method", SCIPYS)
    def test_of_a_lift_against_its_matrix_exponential(self, method: str) -> None:
        goal, q0, qd0 = 0.3, -0.1, 0.4
        tau = controller(LIFT, set_point(goal), "pid", KP, KD, ki=KI)
        times = np.linspace(0.0, 6.0, 25)
        motion = simulate(LIFT, [q0], [qd0], 6.0, tau, method, t_eval=times, **TIGHT)
        A = np.array(  # of (q - goal, qd, z - z at rest)
            [[0, 1, 0], [-KP / MASS, -(KD + DAMPING) / MASS, KI / MASS], [-1, 0, 0]]
        )
        begin = np.array([q0 - goal, qd0, -MASS * G / KI])
        known = expm(times[:, None, None] * A) @ begin
        small = 1e-8
        assert motion.outcome.label == "finished"
        assert motion.q[:, 0] - goal == pytest.approx(known[:, 0], abs=small)
        assert motion.qd[:, 0] == pytest.approx(known[:, 1], abs=small)
        wanted = -KP * known[:, 0] - KD * known[:, 1] + KI * known[:, 2] + MASS * G
        assert motion.tau[:, 0] == pytest.approx(wanted, abs=100 * small)
        assert motion.report.energy_drift < 1e-6

    def test_what_pd_leaves_it_removes(self) -> None:
        rest = {}
        for law, more in (("pd", {}), ("pid", {"ki": KI})):
            tau = controller(LIFT, set_point(0.3, until=40.0), law, KP, KD, **more)
            motion = simulate(LIFT, [0.0], [0.0], 40.0, tau, t_eval=[40.0], **TIGHT)
            rest[law] = 0.3 - motion.q[0, 0]
        assert rest["pd"] == pytest.approx(MASS * G / KP, abs=1e-9)
        assert abs(rest["pid"]) < 1e-9

    def test_backwards(self) -> None:
        tau = controller(LIFT, set_point(0.3, until=-0.7), "pid", KP, KD, ki=KI)
        motion = simulate(LIFT, [0.1], [0.2], -0.7, tau, t_eval=[-0.7], **TIGHT)
        run = solve_ivp(lift_rates(np.inf), (0.0, -0.7), [0.1, 0.2, 0.0], **FINE)
        assert [motion.q[0, 0], motion.qd[0, 0]] == pytest.approx(run.y[:2, -1], abs=1e-8)

    def test_of_an_arm_with_a_wrong_model(self) -> None:
        """pd+g with an integral, of joints of which one has none."""
        text = (ROBOTS / "2r.yaml").read_text().replace("m: 0.9", "m: 1.08")
        heavier = random_mechanisms.mechanism(text)
        kp, kd, ki, goal = (np.array(x) for x in ((80, 40), (20, 4), (60, 0), (0.6, 0.4)))
        reference = set_point(*goal)
        tau = controller(ARM, reference, "pd+g", kp, kd, control_model=heavier, ki=ki)
        times = np.linspace(0.0, 2.0, 9)
        motion = simulate(ARM, [0.2, 0.1], [0.0, 0.5], 2.0, tau, t_eval=times, **TIGHT)
        believed = TWO_LINK._replace(m2=1.08)

        def rates(t: float, y: np.ndarray) -> np.ndarray:
            q, qd, z = np.split(y, 3)
            held = oracles.two_link_terms(believed, q, qd)[2]
            u = kp * (goal - q) - kd * qd + held + ki * z
            return np.concatenate([qd, oracles.two_link_acceleration(TWO_LINK, q, qd, u), goal - q])

        run = solve_ivp(rates, (0, 2), [0.2, 0.1, 0, 0.5, 0, 0], t_eval=times, **FINE)
        assert np.hstack([motion.q, motion.qd]) == pytest.approx(run.y[:4].T, abs=1e-8)
        assert motion.report.energy_drift < 1e-9

    def test_of_every_evaluator(self) -> None:
        """Straight-line and dense: the same rates, those of the integrals among them."""
        mech = load(ROBOTS / "five-bar.yaml")
        driven = list(mech.actuated)
        q = assemble(mech, [2.0, 1.0])
        y = np.concatenate([q, loop_velocities(mech, q, [0.4, -0.3]), [0.2, -0.1], [0.0]])
        tau = controller(mech, set_point(1.7, 1.2), "pid", 9.0, 2.0, [4.0, 40.0], ki=5.0)
        found = [
            right_hand_side(mech, tau, work=True, kind=kind).rates(0.1, y)
            for kind in ("straight-line", "dense")
        ]
        assert np.array(found[0]) == pytest.approx(np.array(found[1]), rel=1e-9)
        e, qd = np.array([1.7, 1.2]) - q[driven], y[mech.n : 2 * mech.n][driven]
        u = 9.0 * e - 2.0 * qd + 5.0 * y[-3:-1]
        zd = e + (np.clip(u, [-4.0, -40.0], [4.0, 40.0]) - u) / 9.0
        assert found[0][-3:-1] == pytest.approx(zd, rel=1e-12)

    @pytest.mark.parametrize("method", ["DOP853", "Radau"])
    def test_across_change_points(self, method: str) -> None:
        mech = load(ROBOTS / "parallelogram.yaml")
        t = np.linspace(0.0, 1.5, 31)[:, None]
        joints = len(mech.actuated)
        reference = ReferenceTable(t[:, 0], np.repeat(0.5 + 3.0 * t, joints, axis=1))
        tau = controller(mech, reference, "pid", 20.0, 4.0, ki=8.0)
        q = assemble(mech, np.full(joints, 0.6))
        qd = loop_velocities(mech, q, np.full(joints, 3.0))
        motion = simulate(mech, q, qd, 1.5, tau, method, **TIGHT)
        assert motion.outcome.label == "finished"
        assert motion.q[:, 0].max() > np.pi
        driven = list(mech.actuated)
        known, rates = reference.at(motion.t)
        e = known - motion.q[:, driven]
        z = (motion.tau[:, driven] - 20.0 * e - 4.0 * (rates - motion.qd[:, driven])) / 8.0
        slopes = rates - motion.qd[:, driven]
        h = np.diff(motion.t)[:, None]  # z by Hermite's rule of its rate
        rule = h * (e[1:] + e[:-1]) / 2 - h**2 * np.diff(slopes, axis=0) / 12
        assert np.diff(z, axis=0) == pytest.approx(rule, abs=1e-5)
        assert motion.report.energy_drift < 1e-8

    def test_with_dry_friction_it_hunts(self) -> None:
        """A lift that sticks: the integral grows until it slips, again and again."""
        text = LIFT_TEXT.replace("damping: 0.7", "friction: {force: 4.0, static: 8.0}")
        mech = random_mechanisms.mechanism(text)
        tau = controller(mech, set_point(0.3), "pid", 60.0, 4.0, ki=90.0)
        runs = [
            simulate(mech, [0.0], [0.0], 10.0, tau, method, t_eval=[10.0], **TIGHT)
            for method in ("DOP853", "Radau")
        ]
        slips = [[event.name for event in run.events].count("lift starts") for run in runs]
        assert slips[0] == slips[1] > 2
        assert runs[0].q[0, 0] == pytest.approx(runs[1].q[0, 0], abs=1e-7)
        for run in runs:
            assert run.report.energy_drift < 1e-8

    def test_accuracy(self) -> None:
        tau = controller(LIFT, set_point(0.3), "pid", KP, KD, 20.0, ki=KI)
        begin = np.array([-0.1, 0.4])
        settings, estimate = settings_for(LIFT, begin, 3.0, tau, Settings("auto"), 1e-8)
        assert (settings.method, estimate < 1e-8) == ("DOP853", True)
        assert error_estimate(LIFT, begin, 3.0, tau, settings) < 1e-8

    @pytest.mark.parametrize("rate", [None, 40.0])
    def test_again(self, rate: float | None) -> None:
        tau = controller(LIFT, set_point(0.3), "pid", KP, KD, 20.0, rate, ki=KI)
        first, _, again = (simulate(LIFT, [q], [0.0], 1.0, tau) for q in (0.0, 0.5, 0.0))
        assert np.array_equal(first.tau, again.tau)
        assert first.report.tracking == again.report.tracking


def lift_rates(most: float, back: bool = True) -> Callable[[float, np.ndarray], list[float]]:
    """Of q, qd, z of the lift held at 0.3 m by a torque cut off; `back`: with anti-windup."""

    def rates(t: float, y: np.ndarray) -> list[float]:
        e = 0.3 - y[0]
        u = KP * e - KD * y[1] + KI * y[2]
        cut = float(np.clip(u, -most, most))
        zd = e + (cut - u) / KP if back else e
        return [y[1], (cut - DAMPING * y[1]) / MASS - G, zd]

    return rates


@cache
def finely(back: bool, *start: float) -> np.ndarray:
    """The height at each tenth of 4 s; `back`: whether the integral goes back."""
    given = {"t_eval": np.linspace(0.0, 4.0, 41), "max_step": 2e-3, **FINE}
    return solve_ivp(lift_rates(17.0, back), (0, 4), [*start, 0.0], **given).y[0]


class TestWindup:
    """Where the torque is cut off the integral goes back."""

    @pytest.mark.parametrize("method", SCIPYS)
    def test_against_a_fine_integration(self, method: str) -> None:
        times, start = np.linspace(0.0, 4.0, 41), [-2.0, 0.0]
        known, wound = (finely(back, *start) for back in (True, False))
        tau = controller(LIFT, set_point(0.3), "pid", KP, KD, 17.0, ki=KI)
        options = TIGHT | {"t_eval": times}
        motion = simulate(LIFT, start[:1], start[1:], 4.0, tau, method, **options)
        assert motion.q[:, 0] == pytest.approx(known, abs=1e-7)
        assert (motion.tau == 17.0).any()
        assert np.abs(motion.tau).max() <= 17.0
        assert motion.report.energy_drift < 1e-6
        over, others = (max(q.max() - 0.3, 0.0) for q in (motion.q[:, 0], wound))
        assert over < 0.5 * others  # what an integral that goes on makes

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("most", [17.0, None])
    @pytest.mark.thinned
    def test_sampled_against_a_loop(self, method: str, most: float | None) -> None:
        rate, count = 25.0, 100
        tau = controller(LIFT, set_point(0.3), "pid", KP, KD, most, rate, ki=KI)
        stamps = np.arange(count + 1) / rate
        motion = simulate(LIFT, [-0.5], [0.2], 4.0, tau, method, t_eval=stamps, **TIGHT)
        A = np.array([[0.0, 1.0], [0.0, -DAMPING / MASS]])
        block = expm(np.block([[A, np.array([[0.0], [1.0]])], [np.zeros((1, 3))]]) / rate)
        y, z, limit = np.array([-0.5, 0.2]), 0.0, most or np.inf
        for k in range(count + 1):
            e = 0.3 - y[0]
            u = KP * e - KD * y[1] + KI * z
            cut = np.clip(u, -limit, limit)
            assert motion.tau[k, 0] == pytest.approx(cut, abs=1e-6)
            assert [motion.q[k, 0], motion.qd[k, 0]] == pytest.approx(y, abs=1e-8)
            z += (e + (cut - u) / KP) / rate
            y = block[:2, :2] @ y + block[:2, 2] * (cut / MASS - G)

    def test_a_motor_is_a_limit(self) -> None:
        motor = "damping: 0.7, motor: {torque_max: 17, ratio: 1, inertia: 0}"
        text = LIFT_TEXT.replace("damping: 0.7", motor)
        mech = random_mechanisms.mechanism(text)
        runs = [
            simulate(
                x, [-2.0], [0.0], 2.0, controller(x, set_point(0.3), "pid", KP, KD, most, ki=KI)
            )
            for x, most in ((mech, None), (LIFT, 17.0))
        ]
        assert np.array_equal(runs[0].tau, runs[1].tau)


class TestReferences:
    def test_a_set_point_is_a_table_that_stays(self) -> None:
        table = ReferenceTable([0.0, 2.0], [[0.6, 0.4]] * 2, np.zeros((2, 2)))
        for law in ("pd", "pd+g", "computed-torque"):
            for rate in (None, 30.0):
                runs = [
                    simulate(
                        ARM,
                        [0.2, 0.1],
                        [0.3, 0.0],
                        2.0,
                        controller(ARM, reference, law, 30.0, [5.0, 0.5], None, rate),
                    )
                    for reference in (table, set_point(0.6, 0.4, until=2.0))
                ]
                assert np.array_equal(runs[0].q, runs[1].q)
                assert runs[0].report.tracking == runs[1].report.tracking

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("law", ["pid", "computed-torque"])
    @pytest.mark.thinned
    def test_held_beyond_an_end_at_speed(self, method: str, law: str) -> None:
        """q_ref goes up at 0.5 m/s until 0.61 s, and stays there."""
        rate = 20.0 if method == "taylor" else None
        table = ReferenceTable([0.0, 0.3, 0.61], [[0.1], [0.25], [0.405]], np.full((3, 1), 0.5))
        gains = (KP, KD) if law == "pid" else (30.0, 7.0)
        more = {"ki": KI} if law == "pid" else {}
        reference = table.until(2.0)
        tau = controller(LIFT, reference, law, *gains, control_rate=rate, **more)
        times = np.linspace(0.0, 2.0, 41)
        motion = simulate(LIFT, [0.0], [0.0], 2.0, tau, method, **TIGHT)
        assert motion.outcome.label == "finished"
        if rate is None:
            assert 0.61 in motion.t.tolist()

        def aim(t: float) -> tuple[float, float]:
            return (0.1 + 0.5 * t, 0.5) if t < 0.61 else (0.405, 0.0)

        def torque(t: float, q: float, qd: float, z: float) -> float:
            e, ed = (a - x for a, x in zip(aim(t), (q, qd), strict=True))
            if law == "pid":
                return KP * e + KD * ed + KI * z
            return MASS * (30.0 * e + 7.0 * ed + G) + DAMPING * qd

        held = [0.0]

        def rates(t: float, y: np.ndarray) -> list[float]:
            u = torque(t, *y) if rate is None else held[0]
            return [y[1], (u - DAMPING * y[1]) / MASS - G, aim(t)[0] - y[0]]

        ends = [0.0, 0.61, 2.0] if rate is None else list(np.arange(41) / rate)
        y, z, states = np.zeros(3), 0.0, []
        for begin, end in itertools.pairwise(ends):
            held[0] = torque(begin, *y[:2], z)
            z += (aim(begin)[0] - y[0]) / (rate or 1.0)
            before = np.nextafter(end, 0.0)
            due = times[(times >= begin) & (times < end)]
            run = solve_ivp(rates, (begin, before), y, dense_output=True, **FINE)
            states.append(run.sol(due)[:2])
            y = run.y[:, -1]
        dense = simulate(LIFT, [0.0], [0.0], 2.0, tau, method, t_eval=times, **TIGHT)
        known = np.hstack(states)
        assert dense.q[:-1, 0] == pytest.approx(known[0], abs=1e-8)
        assert dense.qd[:-1, 0] == pytest.approx(known[1], abs=1e-8)
        assert dense.report.energy_drift < 1e-6
        found = dense.report.tracking
        assert found is not None
        e = 0.1 + 0.5 * np.minimum(times, 0.61) - dense.q[:, 0]
        assert found[0].rms == pytest.approx(np.sqrt(np.trapezoid(e**2, times) / 2.0), rel=0.01)

    def test_a_reference_that_comes_to_rest(self) -> None:
        t = np.linspace(0.0, 1.0, 11)[:, None]
        rest = (3 * t**2 - 2 * t**3, 6 * t - 6 * t**2, 6 - 12 * t)
        held = ReferenceTable(t[:, 0], *rest).until(3.0)
        assert (held.stops, held.jumps, held.kinks) == (False, True, [1.0])
        assert held.times[-2:] == [1.0, 3.0]
        assert held.at([1.0, 2.0])[0].tolist() == [[1.0], [1.0]]
        assert not held.at([1.0, 2.0])[1].any()
        assert held.until(2.0) is held
        assert np.array_equal(held.of([0]).coefficients, held.coefficients)


def cart_terms() -> tuple[np.ndarray, np.ndarray]:
    """A and B of (x, angle from upright, rates) of the cart and its pole, a uniform bar."""
    M, m, r = 1.0, 0.1, 0.5
    J = 0.1 / 12 + m * r**2
    det = (M + m) * J - (m * r) ** 2
    # (M + m) xdd - m r thdd = F;  J thdd - m r xdd = m g r th
    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2, 1], A[3, 1] = m * r * m * 9.8 * r / det, (M + m) * m * 9.8 * r / det
    return A, np.array([[0], [0], [J / det], [m * r / det]])


class TestStateFeedback:
    A, B = cart_terms()
    K = B.T @ solve_continuous_are(A, B, np.diag([4.0, 9.0, 1.0, 1.0]), np.eye(1))
    UP = np.array([0.2, np.pi / 2])

    def feedback(self, q: np.ndarray | None = None) -> StateFeedback:
        pose = self.UP if q is None else q
        return StateFeedback((0, 1), pose.tolist(), [0.0], self.K.tolist())

    def run(self, q: list[float], end: float, method: str = "DOP853", **more: object) -> Motion:
        reference = set_point(self.UP[0], until=end)
        options = {x: more.pop(x) for x in ("tau_max", "control_rate") if x in more}
        tau = controller(CART, reference, "state-feedback", gain=self.feedback(), **options)
        return simulate(CART, q, [0.0, 0.0], end, tau, method, **(TIGHT | more))

    @pytest.mark.parametrize("method", SCIPYS)
    def test_of_small_deviations(self, method: str) -> None:
        times = np.linspace(0.0, 5.0, 21)
        away = np.array([2e-5, -1e-5])
        motion = self.run((self.UP + away).tolist(), 5.0, method, t_eval=times, **TIGHT)
        known = expm(times[:, None, None] * (self.A - self.B @ self.K)) @ [*away, 0, 0]
        found = np.hstack([motion.q - self.UP, motion.qd])
        small = 2e-9
        assert found == pytest.approx(known, abs=small)
        assert motion.tau[:, 0] == pytest.approx(-(known @ self.K[0]), abs=100 * small)

    @pytest.mark.parametrize("method", METHODS)
    def test_of_large_ones_sampled_and_cut_off(self, method: str) -> None:
        """By one method until it rests."""
        end = 12.0 if method == "DOP853" else 3.0
        motion = self.run(
            [-0.8, np.pi / 2 + 0.5 - 2 * np.pi],  # a turn back: the same pose
            end,
            method,
            tau_max=30.0,
            control_rate=50.0,
            t_eval=[0.0, 1.5, end],
            **TIGHT,
        )
        assert motion.tau[0, 0] == np.clip(-self.K[0] @ [-1.0, 0.5, 0, 0], -30.0, 30.0)
        rest = [*motion.q[-1] - self.UP + [0, 2 * np.pi], *motion.qd[-1]]
        assert end < 12.0 or np.abs(rest).max() < 1e-3
        other = sampled()
        apart = motion.q - other.q[np.isin(other.t, motion.t)] + [0, 2 * np.pi]
        assert np.abs(apart).max() < 1e-7

    @pytest.mark.parametrize("method", ["RK45", "Radau"])
    def test_where_an_angle_is_half_a_turn_away(self, method: str) -> None:
        """The torque jumps there; six times in this run."""
        start = [0.2, np.pi / 2 + 2.6]
        runs = [self.run(start, 3.0, each, tau_max=8.0) for each in ("DOP853", method)]
        below = np.floor((runs[0].q[:, 1] + np.pi / 2) / (2 * np.pi))
        assert np.abs(np.diff(below)).sum() == 6
        assert runs[0].q[-1] == pytest.approx(runs[1].q[-1], abs=1e-6)
        assert runs[0].report.energy_drift < 1e-9

    def test_of_a_closed_mechanism(self) -> None:
        """A four-bar held at a pose by its crank's and its rocker's displacements."""
        mech = load(ROBOTS / "four-bar.yaml")
        q = assemble(mech, [1.0])
        tau0 = controller(mech, set_point(1.0), "pd+g", 0.0, 0.0)
        hold = simulate(mech, q, 0 * q, 0.0, tau0).tau[0, 0]
        given = StateFeedback((0, 2), q.tolist(), [hold], [[30.0, 5.0, 6.0, 1.0]])
        tau = controller(mech, set_point(1.0), "state-feedback", gain=given)
        motion = simulate(mech, assemble(mech, [1.2]), 0 * q, 10.0, tau, **TIGHT)
        away = motion.q[:, [0, 2]] - q[[0, 2]]
        wanted = hold - np.hstack([away, motion.qd[:, [0, 2]]]) @ [30.0, 5.0, 6.0, 1.0]
        assert motion.tau[:, 0] == pytest.approx(wanted, abs=1e-9)
        assert motion.q[-1] == pytest.approx(q, abs=1e-6)
        assert motion.report.energy_drift < 1e-8


@cache
def sampled() -> Motion:
    """The run of large ones by a method of Runge and Kutta, from a turn further."""
    options = {"tau_max": 30.0, "control_rate": 50.0, "t_eval": [0.0, 1.5, 3.0, 12.0]}
    return TestStateFeedback().run([-0.8, np.pi / 2 + 0.5], 12.0, **options)


GAIN = {"coordinates": ["q1", "q2"], "q": [0.0, 1.5], "tau": [0], "gain": [[-1, 50, -2, 12]]}


WRONG_GAINS = [
    ({"gain": None}, ("gain = null", "a list")),
    ({"gain": [[1, 2, 3]]}, ("gain[0] = 3 values", "must have 4", "then their rates")),
    ({"gain": [[1, 2, 3, 4]] * 2}, ("gain = 2 rows", "must have 1", "actuated")),
    ({"gain": [[1, 2, 3, 10**400]]}, ("gain[0] = 1000", "finite")),
    ({"gain": [[1, 2, 3, float("nan")]]}, ("gain[0] = NaN", "finite")),
    ({"q": [0.0]}, ("q = 1 values", "must have 2: one a joint")),
    ({"q": [0.0, "1"]}, ('q = "1"', "finite numbers")),
    ({"tau": [True]}, ("tau = true", "finite numbers")),
    ({"tau": [0, 0]}, ("tau = 2 values", "must have 1: one an actuated joint")),
    ({"coordinates": ["q1", "q3"]}, ("coordinates = q3", "must be of q1, q2")),
    ({"coordinates": ["q1", "q1"]}, ("coordinates = q1", "once")),
    ({"coordinates": ["q1", ["q2"]]}, ("coordinates", "must be of q1, q2")),
]


def test_wrong_gains() -> None:
    for change, parts in WRONG_GAINS:
        with case(change, parts):
            with pytest.raises(InputError) as caught:
                read_feedback(CART, json.dumps(GAIN | change).encode(), "k.json")
            for part in ("k.json: ", *parts):
                assert part in str(caught.value)


def test_gains_that_are_none() -> None:
    for text, part in (
        (b"{", "is not JSON"),
        (b"\xff", "is not JSON"),
        (b"[1]", "must have coordinates, q, tau, gain"),
        (json.dumps({**GAIN, "tau": [0]}).replace('"tau"', '"torque"').encode(), "tau: is missing"),
    ):
        with pytest.raises(InputError, match=part):
            read_feedback(CART, text, "k.json")


def test_arguments_of_laws() -> None:
    for law, given, part in (
        ("pid", {"kp": 1.0, "kd": 1.0}, "ki: missing: --control pid"),
        ("pd", {"kp": 1.0, "kd": 1.0, "ki": 1.0}, "ki: is not for --control pd"),
        ("pd", {"kd": 1.0}, "kp: missing"),
        ("pid", {"kp": 0.0, "kd": 1.0, "ki": 1.0, "tau_max": 9.0}, "kp = 0: must be > 0 where ki"),
        ("pid", {"kp": 1.0, "kd": 1.0, "ki": -1.0}, "ki = -1: must be >= 0"),
        ("state-feedback", {}, "gain: missing"),
        ("state-feedback", {"kp": 1.0}, "kp: is not for"),
    ):
        with pytest.raises(InputError, match=part):
            controller(LIFT, set_point(0.3), law, **given)
