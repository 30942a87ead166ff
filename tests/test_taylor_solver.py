"""The Taylor series as a solver class of solve_ivp: the steps of `simulate`, bit for bit."""

import math

import numpy as np
import pytest
from reference_motions import SENSITIVITY, reference, scene
from scipy.integrate import solve_ivp

from random_mechanisms import seeded_tree
from robodyn import closure_gap, simulate
from robodyn.mechanics import actuation
from robodyn.taylor.solver import TaylorSolver

EACH = pytest.mark.parametrize("name", SENSITIVITY)


def solved(mech, y, end, **options):
    return solve_ivp(None, (0.0, end), y, method=TaylorSolver, mechanism=mech, **options)


class TestSteps:
    @EACH
    @pytest.mark.parametrize("way", [1, -1])
    @pytest.mark.thinned
    def test_are_those_of_simulate(self, name, way):
        known = reference(name)
        mech, (q, qd) = known.mechanism, np.split(known.states[0], 2)
        options = {"tau": known.tau or None, "rtol": 1e-9, "atol": 1e-10}
        end = min(2.0, known.t[-1]) if way > 0 else -0.2
        motion = simulate(mech, q, qd, end, method="taylor", engine="python", **options)
        states = np.concatenate([motion.q, motion.qd], axis=1)
        found = solved(mech, states[0], end, **options)  # closed to the last bit
        assert found.success
        assert np.array_equal(found.t, motion.t)
        assert np.array_equal(found.y.T, states)
        assert found.nfev == len(found.t) - 1

    @pytest.mark.parametrize("seed", range(3))
    def test_of_random_trees(self, seed):
        drawn = seeded_tree(seed, 3)
        found = solved(drawn.mechanism, [*drawn.q, *drawn.qd], 0.5, tau=[1.0, -2.0, 0.5])
        motion = simulate(
            drawn.mechanism, drawn.q, drawn.qd, 0.5, [1.0, -2.0, 0.5], "taylor", engine="python"
        )
        assert np.array_equal(found.t, motion.t)
        assert np.array_equal(found.y[:3].T, motion.q)

    def test_steps_end_on_kinks(self):
        times = [0.0, 0.25, 0.3, 1.0]
        tau = actuation.table(scene("2r"), times, [[0, 0], [2, 1], [-1, 0], [0, 1]])
        found = solved(scene("2r"), [0.1, 0.2, 0, 0], 1.0, tau=tau)
        assert set(times) <= set(found.t.tolist())


class TestDenseOutput:
    @pytest.mark.parametrize("name", ["2r-regular", "2r-driven", "four-bar", "five-bar"])
    def test_between_steps(self, name):
        known = reference(name)
        mech, tau = known.mechanism, known.tau or None
        options = {"tau": tau, "rtol": 1e-11, "atol": 1e-11}
        found = solved(mech, known.states[0], 1.0, dense_output=True, **options)
        times = np.linspace(0.0, 1.0, 60)
        motion = solved(mech, known.states[0], 1.0, t_eval=times, **options)
        assert np.abs(found.sol(times) - motion.y).max() < 1e-13
        assert np.abs(found.sol(found.t) - found.y).max() < 1e-10
        if mech.rows:
            assert np.abs(closure_gap(mech, found.sol(times)[: mech.n].T)).max() < 2e-15
        assert found.sol(0.4).shape == (2 * mech.n,)
        assert found.sol(0.4) == pytest.approx(found.sol([0.4])[:, 0], abs=1e-14)

    def test_backwards(self):
        mech, y = scene("2r"), np.array([0.3, -0.4, 1.0, -2.0])
        mirror = np.array([1, 1, -1, -1])
        times = np.linspace(0.0, 1.0, 7)
        forth = solved(mech, y, 1.0, dense_output=True)
        back = solved(mech, y * mirror, -1.0, dense_output=True)
        assert np.array_equal(back.t, -forth.t)
        assert back.sol(-times).T * mirror == pytest.approx(forth.sol(times).T, abs=1e-12)


class TestEvents:
    def test_the_pendulum_at_its_lowest(self):
        """A zero of the angle, found on the series; a quarter of the period after the release."""

        def low(t, y):
            return y[0] + math.pi / 2

        def turned(t, y):
            return y[1]

        low.direction, turned.terminal = -1.0, 2
        mech = scene("pendulum")
        start = [1.0 - math.pi / 2, -1e-9]
        found = solved(mech, start, 10.0, events=[low, turned], rtol=1e-12, atol=1e-12)
        assert found.status == 1
        (first,), (half, whole) = found.t_events
        assert [half, whole] == pytest.approx([2 * first, 4 * first], abs=1e-8)
        assert found.t[-1] == whole
        assert found.y_events[0][0, 0] == pytest.approx(-math.pi / 2, abs=1e-11)


class TestFailures:
    @pytest.mark.parametrize(
        ("tau", "said"), [("1/(0.5 - t), 0", "step size"), ([1e200, 0.0], "not finite")]
    )
    def test_are_told(self, tau, said):
        found = solved(scene("2r"), [0.1, 0.2, 0, 0], 1.0, tau=tau)
        assert not found.success
        assert found.status == -1
        assert said in found.message
        assert np.isfinite(found.y).all()

    def test_at_the_end_of_a_domain(self):
        found = solved(scene("2r"), [0.1, 0.2, 0, 0], 1.0, tau="sqrt(0.5 - t), 0")
        assert not found.success
        assert 0.4999 < found.t[-1] <= 0.5

    def test_a_given_function_serves_nothing(self):
        def never(t, y):
            raise AssertionError

        solver = TaylorSolver(never, 0.0, [0.1, 0.2, 0, 0], 1.0, mechanism=scene("2r"))
        while solver.status == "running":
            assert solver.step() is None
        assert solver.t == 1.0
