"""Many motions at once in machine code, against single motions of another method."""

import math
import re
from functools import cache

import numpy as np
import pytest
from conftest import FRESH, ROOT, TWO_LINK
from scipy.integrate import solve_ivp

import oracles
from random_mechanisms import LOOPS, forced, seeded_scene, seeded_tree
from robodyn import assemble, closure_gap, kinetic_energy, load, potential_energy, simulate
from robodyn.elements.joints import SmoothFriction
from robodyn.elements.springs import JointSpring, PointSpring
from robodyn.engines import machine
from robodyn.loops.loop_rates import loop_velocities
from robodyn.loops.projection import suspect_quality
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.runs.machine_motion import Status
from robodyn.scene.description import from_text
from robodyn.scene.scene_values import SceneValues
from robodyn.sweeps import lane_observer
from robodyn.sweeps.lane_observer import crossings, extremes
from robodyn.sweeps.lanes import Aims, Ends, Motions, integrate
from robodyn.sweeps.sweep_chunks import single
from robodyn.sweeps.sweep_plan import Plan, Variation

pytestmark = pytest.mark.skipif(not machine.available(), reason="needs llvmlite")


def run(mechanism: Mechanism, y, t_end: float, tau=None, angle=None, **aims) -> Ends:
    """Lanes of one mechanism, tau (L, n) or (n,)."""
    tau = np.broadcast_to(np.zeros(mechanism.n) if tau is None else tau, (len(y), mechanism.n))
    options = {"rtol": 1e-12, "atol": 1e-12, **aims}
    suspect = suspect_quality(mechanism) if mechanism.rows else 0.0
    angle = np.zeros(len(y)) if angle is None else angle
    chosen = Aims(suspect=suspect, work=True, **options)
    motions = Motions(mechanism, np.array(y), tau, angle)
    driven = [True] * mechanism.n
    (found,) = integrate([motions], t_end, chosen, driven)
    assert found is not None
    return found


@cache
def scene(name: str) -> Mechanism:
    return load(ROOT / "robots" / f"{name}.yaml")


def swings(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.hstack([rng.uniform(-math.pi, math.pi, (count, 2)), rng.normal(size=(count, 2))])


def turning(mechanism: Mechanism, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    q = assemble(mechanism, rng.uniform(-math.pi, math.pi, (count, len(mechanism.actuated))))
    return np.hstack([q, loop_velocities(mechanism, q, rng.normal(size=(count, 1)) * 3, t=0.0)])


class TestAgainstDOP853:
    def compare(self, mechanism, y, tau, time, bound) -> None:
        found = run(mechanism, y, time, tau)
        for k, state in enumerate(y):
            n = mechanism.n
            motion = simulate(
                mechanism, state[:n], state[n:], time, tau=tau, rtol=1e-12, atol=1e-12
            )
            assert found.status[k] == Status.REACHED
            assert found.t[k] == time
            expected = np.concatenate([motion.q[-1], motion.qd[-1]])
            assert np.abs(found.y[k] - expected).max() < bound * max(1.0, np.abs(expected).max())

    @pytest.mark.parametrize("seed", range(5))
    @pytest.mark.thinned
    def test_trees(self, seed) -> None:
        drawn = seeded_tree(seed, 1 + seed)
        rng = np.random.default_rng(seed)
        y = np.hstack([drawn.q, drawn.qd]) + rng.normal(scale=0.3, size=(3, 2 * drawn.n))
        self.compare(drawn.mechanism, y, rng.uniform(-3, 3, drawn.n), 0.4, 1e-9)

    @pytest.mark.parametrize("shape", LOOPS)
    @pytest.mark.thinned
    def test_loops(self, shape) -> None:
        drawn = seeded_scene(3, LOOPS[shape])
        tau = np.zeros(drawn.mechanism.n)
        tau[list(drawn.mechanism.actuated)] = 1.5
        y = np.hstack([drawn.q, drawn.qd])[None]
        self.compare(drawn.mechanism, y, tau, 0.05, 1e-8)

    @pytest.mark.parametrize("time", [1.0, -0.7])
    def test_either_way(self, time) -> None:
        self.compare(scene("2r"), swings(4), [0.3, -0.2], time, 1e-9)
        self.compare(scene("four-bar"), turning(scene("four-bar"), 4), [1, 0, 0], time, 1e-9)


class TestForces:
    """Springs, dampers, friction, turning forces and couplings, each lane with its own numbers."""

    @pytest.mark.parametrize("rubbing", [False, True])
    @pytest.mark.parametrize("seed", range(8) if FRESH else (1, 2, 3, 4, 5, 7))
    def test_against_dop853(self, seed, rubbing) -> None:
        shapes = list(LOOPS.values())
        plain = (
            seeded_tree(seed, 1 + seed % 4)
            if seed < 4
            else seeded_scene(seed, shapes[seed % len(shapes)])
        )
        text = forced(seed, plain).text
        if not rubbing:
            text = re.sub(r" friction: \{[^}]*\},", "", text)
        mechanism, t_end = build(from_text(text, "x")), 0.1 if rubbing else 0.3
        assert mechanism.of(PointSpring)
        assert mechanism.of(JointSpring)
        assert bool(mechanism.of(SmoothFriction)) == rubbing
        n, y = mechanism.n, np.hstack([plain.q, plain.qd])[None]
        found = run(mechanism, y, t_end)
        motion = simulate(mechanism, y[0, :n], y[0, n:], t_end, rtol=1e-12, atol=1e-12)
        expected = np.concatenate([motion.q[-1], motion.qd[-1]])
        assert found.status == Status.REACHED
        assert np.abs(found.y[0] - expected).max() < 1e-8 * max(1.0, np.abs(expected).max())
        assert found.drift < 1e-8
        energy = kinetic_energy(mechanism, motion.q, motion.qd)
        energy = energy + potential_energy(mechanism, motion.q) - mechanism.energy_offset
        assert found.energy[0, 0] == pytest.approx(energy.min(), rel=0.05, abs=0.5)

    @pytest.mark.parametrize("speed", [1e-3, 0.1, 10.0])
    @pytest.mark.parametrize("seed", range(2))
    @pytest.mark.thinned
    def test_friction_against_single_runs(self, seed, speed) -> None:
        text = forced(seed, seeded_tree(seed, 1 + seed)).text
        text = re.sub(r"speed: [^}]*}", f"speed: {speed}}}", text)
        mechanism = build(from_text(text, "x"))
        assert mechanism.of(SmoothFriction)
        n = mechanism.n
        y = np.random.default_rng(seed).normal(size=(2, 2 * n))
        found = run(mechanism, y, 0.4, rtol=1e-11, atol=1e-11)
        assert (found.status == Status.REACHED).all()
        assert found.drift.max() < 1e-7
        for k, state in enumerate(y):
            motion = simulate(
                mechanism, state[:n], state[n:], 0.4, method="Radau", rtol=1e-10, atol=1e-10
            )
            expected = np.concatenate([motion.q[-1], motion.qd[-1]])
            assert found.y[k] == pytest.approx(expected, rel=1e-6, abs=1e-6)

    @pytest.mark.parametrize("name", ["geared-five-bar", "spring-slider-crank"])
    def test_loops_against_single_runs(self, name) -> None:
        mechanism = scene(name)
        y, n = turning(mechanism, 3), mechanism.n
        tau = np.zeros(n)
        tau[mechanism.actuated[0]] = 1.0
        found = run(mechanism, y, 0.5, tau)
        assert np.abs(closure_gap(mechanism, found.y[:, :n])).max() < 1e-14
        for k, state in enumerate(y):
            motion = simulate(mechanism, state[:n], state[n:], 0.5, tau=tau, rtol=1e-12, atol=1e-12)
            expected = np.concatenate([motion.q[-1], motion.qd[-1]])
            assert found.y[k] == pytest.approx(expected, rel=1e-8, abs=1e-8)
            assert found.drift[k] < 1e-9

    @pytest.mark.parametrize("name", ["pendulum", "2r", "four-bar", "spring-slider-crank"])
    def test_lanes_are_the_same_to_the_last_bit(self, name) -> None:
        """However many go together."""
        mechanism, n = scene(name), scene(name).n
        rng = np.random.default_rng(5)
        y = turning(mechanism, 9) if mechanism.rows else rng.normal(size=(9, 2 * n))
        tau = np.zeros((9, n))
        tau[:, mechanism.actuated[0]] = rng.normal(size=9)
        angle = np.linspace(-1, 1, 9)
        options = {"rtol": 1e-9, "atol": 1e-9, "link": n - 1}
        time = 0.2 if mechanism.of(PointSpring) else 1.0
        together = run(mechanism, y, time, tau, angle, **options)
        for some in (slice(1, 3), slice(3, 9)):
            alone = run(mechanism, y[some], time, tau[some], angle[some], **options)
            for each in Ends.__slots__:
                expected = getattr(together, each)[some]
                assert np.array_equal(getattr(alone, each), expected, equal_nan=True), each

    def test_scenes_of_several_shapes_and_numbers(self) -> None:
        """No digit depends on what else is computed."""
        scene = (ROOT / "robots/spring-slider-crank.yaml").read_text()
        values = SceneValues(scene, "x")
        names = ("springs[0].stiffness", "springs[0].damping")
        given = [(100.0, 0.2), (350.0, 0.0), (700.0, 0.4)]
        made = [build(values.replaced(dict(zip(names, x, strict=True)))) for x in given]
        rest = np.zeros((2, 2))
        begin = [np.hstack([assemble(m, [[1.0], [1.2]]), rest]) for m in made]
        members = [Motions(m, y, rest, np.zeros(2)) for m, y in zip(made, begin, strict=True)]
        aims = Aims(1e-11, 1e-11, suspect=1e-3, work=True)
        together = integrate(members, 1.0, aims, [False, False])
        for mechanism, member, ends in zip(made, members, together, strict=True):
            (alone,) = integrate([member], 1.0, aims, [False, False])
            assert all((getattr(alone, x) == getattr(ends, x)).all() for x in ("y", "low", "drift"))
            for k, state in enumerate(member.y):
                motion = simulate(mechanism, state[:2], state[2:], 1.0, rtol=1e-12, atol=1e-12)
                assert ends.y[k, :2] == pytest.approx(motion.q[-1], abs=1e-8)


class TestResults:
    def test_error_follows_the_tolerance(self) -> None:
        y = swings(20)
        exact = run(scene("2r"), y, 1.0, rtol=1e-14, atol=1e-14).y
        for tolerance in (1e-4, 1e-6, 1e-8, 1e-10):
            found = run(scene("2r"), y, 1.0, rtol=tolerance, atol=tolerance)
            assert tolerance / 1e3 < np.abs(found.y - exact).max() < 1e4 * tolerance

    @pytest.mark.parametrize("name", ["2r", "four-bar"])
    @pytest.mark.thinned
    def test_extremes_are_those_of_a_fine_grid(self, name) -> None:
        mechanism = scene(name)
        y = swings(3, 5) if name == "2r" else turning(mechanism, 3, 5)
        n = mechanism.n
        found = run(mechanism, y, 2.0)
        for k, state in enumerate(y):
            times = np.linspace(0.0, 2.0, 40_001)
            motion = simulate(
                mechanism,
                state[:n],
                state[n:],
                2.0,
                method="taylor",
                rtol=1e-13,
                atol=1e-13,
                t_eval=times,
            )
            rows = np.hstack([motion.q, motion.qd])
            # a grid misses an extreme by half of curvature times (half a step) squared
            assert (found.low[k] < rows.min(axis=0) + 5e-10).all()
            assert (found.high[k] > rows.max(axis=0) - 5e-10).all()
            missed = np.abs(np.diff(rows, 2, axis=0)).max(axis=0)
            assert (found.low[k] > rows.min(axis=0) - missed - 5e-10).all()
            assert (found.high[k] < rows.max(axis=0) + missed + 5e-10).all()
            energy = kinetic_energy(mechanism, state[:n], state[n:])
            energy = energy + potential_energy(mechanism, state[:n]) - mechanism.energy_offset
            assert found.energy[k] == pytest.approx([energy, energy], abs=1e-9)

    @pytest.mark.parametrize("name", ["2r", "four-bar"])
    def test_steps_that_are_noted_are_taken_at_any_time(self, name, monkeypatch) -> None:
        """Room for one step of a vector, or for all: the same to the last bit."""
        mechanism = scene(name)
        y = swings(40, 3) if name == "2r" else turning(mechanism, 40, 3)
        found = []
        for room in (0, lane_observer.LARGEST):
            monkeypatch.setattr(lane_observer, "LARGEST", room)
            taken, take = [0], lane_observer.Notes.take

            def counted(notes, taken=taken, take=take) -> None:
                taken[0] += 1
                take(notes)

            with monkeypatch.context() as patch:
                patch.setattr(lane_observer.Notes, "take", counted)
                found.append(run(mechanism, y, 5.0, link=mechanism.n - 1))
            assert (taken[0] > 50) == (room == 0)
        assert name != "2r" or np.isfinite(found[0].flip).sum() > 5
        for name in ("low", "high", "flip", "y"):
            ours, theirs = (getattr(ends, name) for ends in found)
            assert np.array_equal(ours, theirs, equal_nan=True)

    def test_drift_takes_work_into_account(self) -> None:
        links = [
            f"{{name: {k}, m: 1, l: 1.{k}, r: 0.5, I: 0.1, damping: 0.{k}}}" for k in (1, 2, 3)
        ]
        mechanism = build(from_text(f"gravity: 9.81\nlinks: [{', '.join(links)}]\n", "x"))
        y = np.random.default_rng(0).normal(size=(5, 6))
        found = run(mechanism, y, 1.0, tau=[1.0, 0.5, -2.0])
        assert found.drift.max() < 1e-9
        assert (found.energy[:, 1] - found.energy[:, 0] > 1e-3).all()

    def test_loops_stay_closed(self) -> None:
        mechanism = scene("four-bar")
        found = run(mechanism, turning(mechanism, 50), 3.0)
        assert np.abs(closure_gap(mechanism, found.y[:, :3])).max() < 1e-14

    def test_change_points_stop_a_lane_and_are_told(self) -> None:
        mechanism = scene("parallelogram")
        found = run(mechanism, turning(mechanism, 20), 5.0)
        assert set(found.status) <= {Status.REACHED, Status.SINGULAR}
        assert Status.SINGULAR in found.status
        stopped = found.status == Status.SINGULAR
        assert (found.t[stopped] < 5.0).all()

    def test_too_many_steps_and_what_is_not_finite(self) -> None:
        found = run(scene("2r"), swings(3), 10.0, most=5)
        assert found.status.tolist() == [Status.FULL] * 3
        assert found.steps.tolist() == [5] * 3
        y = swings(3)
        y[1, 2] = 1e200
        found = run(scene("2r"), y, 0.1)
        assert found.status[[0, 2]].tolist() == [Status.REACHED] * 2
        assert found.status[1] in (Status.NOT_FINITE, Status.STUCK)


def flips_by_events(y: np.ndarray, t_end: float) -> np.ndarray:
    """When the forearm of the 2R passes upright, by scipy's events on equations of the oracle."""
    found = []
    for state in y:
        hanging = -math.pi / 2
        first = math.remainder(state[:2].sum() - hanging, 2 * math.pi)
        shift = first - state[:2].sum()

        def upright(t, x, shift=shift):
            return math.pi**2 - (x[0] + x[1] + shift) ** 2

        upright.terminal = True
        solution = solve_ivp(
            lambda t, x: np.concatenate(
                [x[2:], oracles.two_link_acceleration(TWO_LINK, x[:2], x[2:], np.zeros(2))]
            ),
            (0.0, t_end),
            state,
            method="DOP853",
            rtol=1e-11,
            atol=1e-11,
            max_step=0.05,
            events=upright,
        )
        found.append(solution.t_events[0][0] if len(solution.t_events[0]) else math.nan)
    return np.array(found)


def from_hanging(y: np.ndarray) -> np.ndarray:
    return np.remainder(y[:, :2].sum(axis=1) + 1.5 * math.pi, 2 * math.pi) - math.pi


@cache
def flips() -> tuple[np.ndarray, np.ndarray]:
    y = swings(24, 8)
    y[:, 2:] *= 3
    return y, flips_by_events(y, 2.0)


def test_flips_are_where_events_find_them() -> None:
    y, expected = flips()
    assert 5 < np.isnan(expected).sum() < 19
    found = run(scene("2r"), y, 2.0, angle=from_hanging(y), link=1)
    assert found.flip == pytest.approx(expected, abs=1e-8, nan_ok=True)


def alone(mechanism: Mechanism, y, t_end, aims, ends, lane=0, angle=0.0) -> str:
    """A single motion without torques."""
    given = Motions(mechanism, y[None], np.zeros((1, mechanism.n)), np.array([angle]))
    plan = Plan("", "", Variation(()), (), (), t_end=t_end)
    return single(plan, given, 0, aims, ends, lane, np.zeros(0))[0]


class TestSingle:
    def test_is_what_lanes_find(self) -> None:
        y, expected = flips()
        y = y[:6]
        together = run(scene("2r"), y, 2.0, angle=from_hanging(y), link=1)
        ends = Ends.room(6, 2)
        aims = Aims(1e-12, 1e-12, link=1)
        for k, state in enumerate(y):
            angle = float(from_hanging(y)[k])
            outcome = alone(scene("2r"), state, 2.0, aims, ends, k, angle)
            assert outcome == "finished"
        for name in ("t", "y", "low", "high", "energy", "flip"):
            wanted = getattr(together, name)
            assert getattr(ends, name) == pytest.approx(wanted, abs=1e-7, nan_ok=True)
        assert ends.flip == pytest.approx(expected[:6], abs=1e-7, nan_ok=True)
        assert ends.drift.max() < 1e-10

    def test_passes_change_points(self) -> None:
        mechanism = scene("parallelogram")
        y = turning(mechanism, 20)
        stopped = run(mechanism, y, 3.0).status == Status.SINGULAR
        (k,) = np.flatnonzero(stopped)[:1]
        ends = Ends.room(1, 3)
        outcome = alone(mechanism, y[k], 3.0, Aims(1e-9, 1e-9), ends)
        motion = simulate(mechanism, y[k, :3], y[k, 3:], 3.0, rtol=1e-11, atol=1e-11)
        assert outcome == "finished"
        assert ends.y[0, :3] == pytest.approx(motion.q[-1], abs=1e-5)

    @pytest.mark.parametrize("speed", [0.01, 1.0])
    def test_friction_as_radau_has_it(self, speed) -> None:
        text = "gravity: 9.81\nlinks: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1, "
        rubbing = build(from_text(f"{text}friction: {{torque: 0.5, speed: {speed}}}}}]\n", "x"))
        ends = Ends.room(1, 1)
        y = np.array([0.3, 0.0])
        assert alone(rubbing, y, 2.0, Aims(1e-9, 1e-9), ends) == "finished"
        motion = simulate(rubbing, [0.3], [0], 2.0, method="Radau", rtol=1e-9, atol=1e-9)
        assert ends.y[0] == pytest.approx([motion.q[-1, 0], motion.qd[-1, 0]], abs=1e-6)

    def test_outcomes_of_what_cannot_go_on(self) -> None:
        ends = Ends.room(2, 2)
        aims = Aims(1e-9, 1e-9, most=5)
        y = np.array([0.3, 0.2, 0.0, 0.0])
        outcome = alone(scene("2r"), y, 10.0, aims, ends)
        assert outcome == "too many evaluations"
        assert 0.0 < ends.t[0] < 10.0
        broken = np.array([math.nan, 0.0, 0.0, 0.0])
        assert alone(scene("2r"), broken, 1.0, aims, ends, 1) == "cannot start"


# Extremes and crossings of polynomials, against numpy's roots.


def series(seed: int, B: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Rates (9, 3, B) whose terms fall off over a step, and the steps."""
    rng = np.random.default_rng(seed)
    rates = (
        rng.normal(size=(9, 3, B)) / np.array([math.factorial(k) for k in range(9)])[:, None, None]
    )
    return rates, rng.uniform(0.2, 1.0, B) * rng.choice([-1, 1], B)


def exact(coefficients: np.ndarray, h: float) -> tuple[float, float]:
    """The least and largest value over a step, by the roots of the derivative."""
    p = np.polynomial.Polynomial(coefficients)
    roots = p.deriv().roots()
    inner = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real / h >= 0) & (roots.real / h <= 1)]
    found = p(np.concatenate([[0.0, h], inner]))
    return float(found.min()), float(found.max())


@pytest.mark.parametrize("seed", range(3))
def test_extremes(seed: int) -> None:
    rates, h = series(seed)
    found = extremes(rates, h)
    for i in range(3):
        for b in range(len(h)):
            rate = rates[:, i, b]
            turn = np.polynomial.Polynomial(rate).integ().coef
            expected = [*exact(turn, h[b]), *exact(rate, h[b])]
            assert [x[i, b] for x in found] == pytest.approx(expected, abs=1e-13)


def test_crossings() -> None:
    rates, h = series(11, 2000)
    angle = np.random.default_rng(1).uniform(-1, 1, 2000)
    found = crossings(angle, rates[:, 0], h, 1.0)
    crossed = 0
    for b in range(2000):
        p = np.polynomial.Polynomial(rates[:, 0, b]).integ() + angle[b]
        roots = np.concatenate([(p - 1.0).roots(), (p + 1.0).roots()])
        within = (np.abs(roots.imag) < 1e-9) & (roots.real / h[b] > 0) & (roots.real / h[b] <= 1)
        first = min(roots.real[within], key=abs, default=math.nan)
        assert found[b] == pytest.approx(first, abs=1e-12, nan_ok=True)
        crossed += not math.isnan(found[b])
    assert 300 < crossed < 1700


def test_crossing_that_turns_back_at_once() -> None:
    """1 + x - 5 x^2 less 1 is beyond 1 from 0 to 0.2 alone, within the first quarter."""
    rates = np.array([[1.0], [-10.0]])
    x = crossings(np.array([0.96]), rates, np.array([1.0]), 1.0)
    assert x == pytest.approx([(1 - math.sqrt(0.2)) / 10], abs=1e-14)


def test_what_is_beyond_at_once_crosses_at_once() -> None:
    assert crossings(np.array([1.5]), np.array([[1.0], [0.0]]), np.ones(1), 1.0) == [0.0]
