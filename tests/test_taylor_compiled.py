"""Taylor series in machine code against known digits, DOP853, exact motions, its own restarts."""

import ctypes
import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT

import oracles
import random_mechanisms
from hard_cases.cases import n_four_bar
from random_mechanisms import seeded_scene, seeded_tree
from robodyn import (
    assemble,
    kinetic_energy,
    load,
    loop_velocities,
    potential_energy,
    simulate,
)
from robodyn.mechanics.actuation import Actuation, constant, expressions
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.machine_motion import Status

pytest.importorskip("llvmlite")

from robodyn.engines import machine
from robodyn.engines.arithmetic import FLOATS
from robodyn.engines.expression import Expression
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import build
from robodyn.runs import machine_motion, series_engine
from robodyn.runs.machine_motion import Observer
from robodyn.runs.machine_steps import Scene
from robodyn.runs.series_engine import NoCodeError, SeriesEngine, serves
from robodyn.scene.description import from_text

REFERENCES = Path(__file__).parent / "references"
ALL = 10**5  # steps, more than any motion here takes
NONE = np.zeros(0)
HARD = ROOT / "tests" / "hard_cases"


@cache
def scene(name: str) -> Mechanism:
    return load(ROOT / "robots" / f"{name}.yaml")


@cache
def reference(name: str):
    """The mechanism, times (T,) and states (T, 2n) of a motion known to 18 digits."""
    data = json.loads((REFERENCES / f"{name}.json").read_text())
    states = [[float(x) for x in s["q"] + s["qd"]] for s in data["states"]]
    return load(ROOT / data["scene"]), np.array([s["t"] for s in data["states"]]), np.array(states)


def engine(mechanism: Mechanism, tau=None, **options) -> SeriesEngine:
    torques = constant(mechanism, [0.0] * mechanism.n if tau is None else tau)
    return SeriesEngine(mechanism, torques, **{"rtol": 1e-14, "atol": 1e-14, **options})


def moved(mechanism, y, t, tau=None, **options):
    """The state at t from y at 0."""
    chunk = engine(mechanism, tau, **options).advance(0.0, np.array(y), t, NONE, ALL)
    assert chunk.status is Status.REACHED
    assert chunk.t[-1] == t
    return chunk.y[-1]


class TestReferences:
    @pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8, 1e-10, 1e-12])
    @pytest.mark.parametrize("name", ["2r-regular", "four-bar"])
    def test_error_follows_the_tolerance(self, name, rtol):
        mechanism, t, states = reference(name)
        found = moved(mechanism, states[0], t[2], rtol=rtol, atol=rtol)
        error = np.abs(found - states[2]).max()
        assert rtol / 1e3 < error < 300 * rtol

    def test_backwards(self):
        mechanism, t, states = reference("four-bar")
        chunk = engine(mechanism).advance(t[2], states[2], 0.0, t[[1, 0]], ALL)
        assert chunk.status is Status.REACHED
        assert (np.diff(chunk.t) < 0).all()
        assert np.abs(chunk.row_y - states[[1, 0]]).max() < 1e-11


class TestOrder:
    @pytest.mark.parametrize("order", [6, 8, 10])
    @pytest.mark.parametrize("name", ["2r-regular", "four-bar"])
    def test_slope_of_the_error(self, name, order):
        """w is kept up to `order`, so that a step errs by h^(order + 1)."""
        mechanism, t, states = reference(name)
        counts = np.array([16, 20, 24, 32]) * (1 if name == "2r-regular" else 4)
        steps, errors = t[1] / counts, []
        for count in counts:
            y, made = states[0], engine(mechanism, order=order, rtol=1e3, atol=1e3)
            for k in range(count):
                begin, end = t[1] * np.array([k, k + 1]) / count
                chunk = made.advance(begin, y, end, NONE, 2)
                assert len(chunk.t) == 1
                y = chunk.y[-1]
            errors.append(np.abs(y - states[1]).max())
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert slope == pytest.approx(order, abs=1.0)


class TestAgainstDOP853:
    """Damping, payloads, centres of gravity off the axis, gravity of any direction."""

    def compare(self, mechanism, q, qd, tau, time=0.5, bound=1e-9):
        motion = simulate(mechanism, q, qd, time, tau=tau, rtol=1e-12, atol=1e-12, t_eval=[time])
        if motion.t.size == 0:
            pytest.skip("the motion leaves what DOP853 can do")
        found = moved(mechanism, np.concatenate([q, qd]), time, tau)
        expected = np.concatenate([motion.q[-1], motion.qd[-1]])
        assert np.abs(found - expected).max() < bound * max(1.0, np.abs(expected).max())

    def test_long_chain(self):
        chain = random_mechanisms.Shape((None, *range(13)))
        drawn = seeded_scene(1, chain)
        self.compare(drawn.mechanism, drawn.q, 0.1 * drawn.qd, [0.0] * 14, 0.1)


class TestForces:
    """Springs, dampers, friction, turning loads, couplings, and torques of the state and time."""

    @pytest.mark.parametrize("name", ["geared-five-bar", "spring-slider-crank"])
    def test_plain_processors(self, name):
        mechanism, t, states = reference(name)
        found = moved(mechanism, states[0], t[1], rtol=1e-12, atol=1e-12, family=machine.PLAIN)
        assert np.abs(found - states[1]).max() < 1e-8


class TestWork:
    def test_balance(self):
        drawn = seeded_tree(4, 4)
        mechanism = drawn.mechanism
        assert any(mechanism.damping)
        y = np.concatenate([drawn.q, drawn.qd, [0.25]])
        end = moved(mechanism, y, 1.0, [1.0, -2.0, 0.5, 0.3], work=True)

        def energy(state):
            q, qd = state[:4], state[4:8]
            return kinetic_energy(mechanism, q, qd) + potential_energy(mechanism, q)

        assert end[8] - 0.25 == pytest.approx(energy(end) - energy(y), rel=1e-12)
        alone = moved(mechanism, y[:8], 1.0, [1.0, -2.0, 0.5, 0.3])
        assert np.abs(end[:8] - alone).max() < 1e-12


class TestAdvance:
    def test_the_state_given_is_not_touched(self):
        mechanism, t, states = reference("2r-regular")
        y, times = states[0].copy(), t[1:].copy()
        y.flags.writeable = times.flags.writeable = False
        engine(mechanism).advance(0.0, y, t[-1], times, ALL)
        assert (y == states[0]).all()

    def test_nothing_to_do(self):
        mechanism, _, states = reference("four-bar")
        chunk = engine(mechanism).advance(1.0, states[0], 1.0, NONE, 5)
        assert (chunk.status, len(chunk.t), len(chunk.row_t)) == (Status.REACHED, 0, 0)
        chunk = engine(mechanism).advance(0.0, states[0], 1.0, NONE, 0)
        assert (chunk.status, len(chunk.t)) == (Status.FULL, 0)


def parallel_bars(n):
    """The state of the N-four-bar benchmark at 0: verticals upright, turning at -1 rad/s."""
    q = np.concatenate([np.full(n + 1, np.pi / 2), np.full(n, -np.pi / 2)])
    return np.concatenate([q, np.full(n + 1, -1.0), np.full(n, 1.0)])


class TestParallelBars:
    @pytest.mark.parametrize("n", [1, 2, 5])
    def test_until_the_horizontal(self, n):
        mechanism = n_four_bar(n)
        chunk = engine(mechanism, rtol=1e-12, atol=1e-12).advance(
            0.0, parallel_bars(n), 10.0, NONE, ALL
        )
        for t, y in zip(chunk.t, chunk.y, strict=True):
            theta, rate = (float(x) for x in oracles.n_four_bar_exact(n, t))
            assert np.abs(y[: n + 1] - theta).max() < 1e-8
            assert np.abs(y[2 * n + 1 : 3 * n + 2] - rate).max() < 3e-8
        if chunk.status is Status.SINGULAR:  # as it was left: the horizontal is near
            assert abs(math.sin(chunk.y[-1][0])) < 0.3

    def test_10(self):
        times = np.linspace(0.05, 0.4, 8)
        chunk = engine(n_four_bar(10)).advance(0.0, parallel_bars(10), 0.4, times, ALL)
        assert chunk.status is Status.REACHED
        for t, y in zip(times, chunk.row_y, strict=True):
            theta, rate = (float(x) for x in oracles.n_four_bar_exact(10, t))
            assert np.abs(y[:11] - theta).max() < 1e-12
            assert np.abs(y[21:32] - rate).max() < 1e-11

    def test_a_singular_start(self):
        y = parallel_bars(1)
        y[:3] = 0.0
        chunk = engine(n_four_bar(1)).advance(0.0, y, 1.0, NONE, ALL)
        assert (chunk.status, len(chunk.t)) == (Status.SINGULAR, 0)

    def test_rows_within_a_step_that_landed_beside_the_horizontal(self):
        mechanism = load(ROOT / "robots/parallelogram.yaml")
        q = assemble(mechanism, [math.radians(5.0)])
        start, times = (q, loop_velocities(mechanism, q, [6.0])), np.linspace(0.0, 1.5, 1501)
        how = {"rtol": 1e-10, "atol": 1e-10, "t_eval": times}
        other = simulate(mechanism, *start, 1.5, **how)
        for order in (10, 14, 21, 22):
            motion = simulate(mechanism, *start, 1.5, **how, method="taylor", order=order)
            assert motion.q.shape == other.q.shape
            assert np.abs(motion.q - other.q).max() < 1e-8, order


def expanded(mechanism, tau, y, lanes=1, **options):
    """The code of a scene, and its block (items, lanes) after one expansion at y and t = 0."""
    made = Scene(mechanism, tau, 12, work=True, **options)
    code = machine_motion.compile(made, Observer(), lanes)
    block = np.zeros((code.items, lanes))
    made.fill(block, 1e-10, 1e-10)
    block[: len(y)] = y[:, None]
    code.code.function("expand", ctypes.c_void_p, result=None)(block.ctypes.data)
    return made, block


def rates(rho, theta):
    """The series of a link's rate, Im(conj(z) z'), order by order."""
    z = np.array(rho) + 1j * np.array(theta)
    slope = z[1:] * np.arange(1, len(z))
    return [np.vdot(z[: m + 1], slope[m::-1]).imag for m in range(len(slope))]


class TestOrderAsALoop:
    """What code finds, its order a loop, are the series of the rows one by one."""

    def test_series_of_rates(self):
        mechanism, _, states = reference("five-bar")
        y, still = np.append(states[0], 0.0), constant(mechanism, [0.0] * mechanism.n)
        made, block = expanded(mechanism, still, y, lanes=2, rate_series=True, link=1)
        start = made.motion.state(FLOATS, 0.0, y, ((), ()))
        found = made.motion.expand(FLOATS, made.motion.program.numbers, 12, start)
        w = np.array([rates(*z) for z in zip(found.rho, found.theta, strict=True)])
        above = np.array([0.0 * w[0] if x is None else w[x] for x in mechanism.parent])
        for name, known in (("rate0_0", (w - above).ravel()), ("link0_0", w[1])):
            there = block[made.whole[name] :][: known.size]
            assert np.abs(there - known[:, None]).max() <= 1e-11 * max(1.0, np.abs(known).max())

    def test_code_grows_with_loops_and_not_with_orders(self):
        still = Actuation((0.0,) * n_four_bar(20).n)
        sizes = []
        for n, order in ((10, 12), (10, 24), (20, 12)):
            mechanism = n_four_bar(n)
            scene = Scene(mechanism, Actuation(still.constants[: mechanism.n]), order)
            nodes = (
                scene.loop.start.graph.nodes,
                next(x.graph for x in scene.closing.outputs if isinstance(x, Expression)).nodes,
            )
            sizes.append(sum(map(len, nodes)))
        assert sizes[0] == sizes[1]
        assert sizes[2] < 2.2 * sizes[0]

    def test_40_loops(self):
        times = np.linspace(0.05, 0.4, 8)
        made = engine(n_four_bar(40), rtol=1e-12, atol=1e-12)
        chunk = made.advance(0.0, parallel_bars(40), 0.4, times, ALL)
        assert chunk.status is Status.REACHED
        for t, y in zip(times, chunk.row_y, strict=True):
            theta, rate = (float(x) for x in oracles.n_four_bar_exact(40, t))
            assert np.abs(y[:41] - theta).max() < 1e-10
            assert np.abs(y[81:122] - rate).max() < 1e-9


class TestServes:
    def test_torques_without_a_series_it_does_not(self):
        given = expressions(scene("2r"), "abs(q1), 0", "test")
        with pytest.raises(InputError, match="abs has no series"):
            SeriesEngine(scene("2r"), given)

    def test_very_large_mechanisms_it_does_not(self, monkeypatch):
        monkeypatch.setattr(series_engine, "LARGEST", 50)
        with pytest.raises(NoCodeError, match="160 loops"):
            engine(n_four_bar(6))

    def test_a_singular_inertia_it_does_not(self):
        with pytest.raises(NoCodeError, match="masses are missing"):
            engine(load(HARD / "massless-coupler.yaml"))

    def test_dependent_closures_are_singular(self):
        mechanism = load(HARD / "third-crank.yaml")
        y = np.concatenate([assemble(mechanism, [1.0]), np.zeros(4)])
        if serves(mechanism):  # as some branches are regular
            chunk = engine(mechanism).advance(0.0, y, 1.0, NONE, ALL)
            assert (chunk.status, len(chunk.t)) == (Status.SINGULAR, 0)

    def test_one_code_serves_all_numbers_of_a_shape(self):
        text = (ROOT / "robots/four-bar.yaml").read_text()
        made = [
            SeriesEngine(mechanism, constant(mechanism, tau), family=machine.PLAIN)
            for mechanism in (
                load(ROOT / "robots/four-bar.yaml"),
                build(
                    from_text(text.replace("{name: crank,   m: 0.6", "{name: crank, m: 0.9"), "x")
                ),
            )
            for tau in ([1.0, 0.0, 0.0], [2.5, 0.0, 0.0])
        ]
        assert len({id(x._made(None)[0].code) for x in made}) == 1
        assert len({x._made(None)[1].block.tobytes() for x in made}) == 4


def test_from_rest_at_right_angles_to_gravity_only_every_fourth_coefficient_is_left():
    mechanism = load(ROOT / "robots/2r.yaml")
    still = Actuation((0.0, 0.0))
    for order in range(8, 20):
        engine = SeriesEngine(mechanism, still, rtol=1e-8, atol=1e-8, order=order)
        chunk = engine.advance(0.0, np.zeros(4), 2.0, np.zeros(0), 1000)
        motion = simulate(mechanism, [0, 0], [0, 0], 2.0, rtol=1e-11, atol=1e-11, t_eval=[2.0])
        assert chunk.y[-1][:2] == pytest.approx(motion.q[-1], abs=1e-5)
