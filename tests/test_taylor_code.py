"""The coefficients that the straight-line series has, whatever steps are made of them."""

from functools import cache

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpf
from reference_motions import reference, scene, slope

import oracles
from random_mechanisms import LOOPS, mechanism, seeded_scene, seeded_tree
from robodyn.dynamics.placed import relative_matrix
from robodyn.mechanics.actuation import Actuation, constant, expressions
from robodyn.taylor.python_series import StraightEngine, step_text

ORDER = 12
FREE = 1e100  # a tolerance that holds no step


@cache
def drawn(name):
    """A random scene: a tree by its number of links, or a loop by its name."""
    return seeded_tree(name, name) if isinstance(name, int) else seeded_scene(11, LOOPS[name])


def torques(mech, seed=5):
    """A constant torque on every actuated joint."""
    values = np.random.default_rng(seed).uniform(-4, 4, len(mech.actuated))
    return constant(mech, values.tolist()).constants


def straight(mech, y, order=ORDER, tau=None, work=False):
    """z (n, order + 2) of straight-line floats, and the series of the power."""
    tau = torques(mech) if tau is None else tau
    actuation = tau if isinstance(tau, Actuation) else Actuation(tau)
    engine = StraightEngine(mech, None, order, 1e-9, 1e-9, actuation, work)
    _, _, series = engine.expand(0.0, list(y), 1e-3, 1.0)
    n = mech.n
    z = np.array(series[:n]) + 1j * np.array(series[n : 2 * n])
    return z, np.array(series[2 * n : 2 * n + engine._now.works])


def apart(found, known):
    """The largest difference, coefficient by coefficient, where |z_k| <= rho^k."""
    found, known = (np.asarray(x, np.clongdouble) for x in (found, known))
    assert found.shape == known.shape
    orders = np.arange(known.shape[1])
    rho = (np.abs(known[:, 1:]) ** (1.0 / orders[1:])).max()
    return float((np.abs(found - known) / rho**orders).max())


def joints(mech, z):
    """qd, qdd and the third derivative (n,) from the series."""
    z1, z2, z3 = z[:, 1], z[:, 2], z[:, 3]
    # log z = z1 x + (z2 - z1^2/2) x^2 + (z3 - z1 z2 + z1^3/3) x^3 = i times the angle
    turn = (z1, 2 * (z2 - z1**2 / 2), 6 * (z3 - z1 * z2 + z1**3 / 3))
    return [relative_matrix(mech) @ part.imag for part in turn]


class TestCoefficients:
    def test_pendulum_by_mpmath(self):
        """theta'' = -omega^2 sin theta, by a polynomial through elliptic functions."""
        omega, amplitude = oracles.pendulum_frequency(0.4, 0.26, 0.0088, digits=60), mpf(2)
        with mp.workdps(60):
            at = mpf("0.3")
            start, rate = oracles.pendulum_exact(omega, amplitude, at, 60)
            points = [mp.cos(mp.pi * (k + mpf("0.5")) / 41) / 20 for k in range(41)]
            turns = [
                mp.expj(oracles.pendulum_exact(omega, amplitude, at + x, 60)[0] - start)
                for x in points
            ]
            powers = mp.matrix([[x**k for k in range(41)] for x in points])
            known = mpmath.lu_solve(powers, mp.matrix(turns))[: ORDER + 2]
        y = [float(start - mp.pi / 2), float(rate)]
        z, _ = straight(scene("pendulum"), y, tau=(0.0,))
        assert apart(z, np.array([[complex(c) for c in known]])) < 1e-12

    def test_do_not_depend_on_tolerances_or_order(self):
        found = drawn("four-bar")
        mech, y = found.mechanism, [*found.q, *found.qd]
        short, _ = straight(mech, y, 6)
        long, _ = straight(mech, y, 30)
        assert np.array_equal(short, long[:, :8])

    @pytest.mark.parametrize("name", [3, "four-bar"])
    def test_constant_torques_as_expressions(self, name):
        """Given order by order, the series is the same."""
        found = drawn(name)
        mech, tau = found.mechanism, torques(found.mechanism)
        text = ", ".join(f"{tau[k]!r} + 0*t" for k in mech.actuated)
        pushed = expressions(mech, text, "test")
        y = [*found.q, *found.qd]
        assert apart(straight(mech, y, tau=pushed)[0], straight(mech, y)[0]) < 1e-13


class TestPower:
    @pytest.mark.parametrize("name", [1, 3, "four-bar", "slider-crank"])
    @pytest.mark.parametrize("kind", ["constant", "expression"])
    def test_is_that_of_torques_less_dampers(self, name, kind):
        found = drawn(name)
        mech, given = found.mechanism, torques(found.mechanism)
        tau = np.array(given)
        if kind == "expression":
            text = ", ".join(f"{given[k]!r} + 0*t" for k in mech.actuated)
            given = expressions(mech, text, "test")
        z, power = straight(mech, [*found.q, *found.qd, 0.0], tau=given, work=True)
        if not len(power):  # constant torques without dampers: the work is tau times the way
            assert not any(mech.damping)
            return
        qd, qdd, _ = joints(mech, z)
        net = tau * (kind == "expression") - mech.damping * qd  # of constants it is tau dq
        assert power[0, 0] == pytest.approx(net @ qd, rel=1e-12)
        assert power[0, 1] == pytest.approx(net @ qdd - mech.damping * qdd @ qd, rel=1e-10)


COUNTS = {"2r-regular": (20, 24, 30, 40), "four-bar": (80, 96, 120, 160)}  # steps in 0.5 s


class TestOrder:
    @pytest.mark.parametrize("order", [6, 8, 10])
    @pytest.mark.parametrize("name", COUNTS)
    def test_slope_of_the_error_of_equal_steps(self, name, order):
        """z is kept up to order + 1: a step errs by h^(order + 1) in the rates, so h^order."""
        known = reference(name)
        mech, t = known.mechanism, float(known.t[1])
        engine = StraightEngine(mech, None, order, FREE, FREE, Actuation((0.0,) * mech.n), False)
        counts = [round(2 * t) * count for count in COUNTS[name]]
        errors = []
        for count in counts:
            y = known.states[0].tolist()
            for _ in range(count):
                h, y, _ = engine.expand(0.0, y, t / count, 1.0)
                assert h == t / count
            errors.append(np.abs(np.array(y) - known.states[1]).max())
        assert slope(t / np.array(counts), errors) == pytest.approx(order, abs=0.7)


class TestGenerated:
    def test_no_pivot(self):
        """A link without any inertia."""
        massless = mechanism("links:\n  - {name: a, m: 0, l: 1, r: 0, I: 0}\n")
        with pytest.raises(ZeroDivisionError):
            step_text(massless, Actuation((0.0,)), 4, False)

    def test_half_a_turn_in_one_step(self):
        """The turn is counted."""
        wheel = mechanism("gravity: 0\nlinks:\n  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1}\n")
        expand = step_text(wheel, Actuation((0.0,)), 30, False).expand
        for direction in (1.0, -1.0):
            for turn in (0.5, 0.79, 0.81, 1.5, 2.0):
                h, y, _ = expand(0.0, [7.0, 3.0], (), (), turn / 3.0, direction, 1.0, 1.0)
                assert y == pytest.approx([7.0 + 3.0 * h * direction, 3.0], rel=1e-14)
                assert 3.0 * h == pytest.approx(turn)

    def test_a_turn_beyond_two_radians_is_none(self):
        wheel = mechanism("gravity: 0\nlinks:\n  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1}\n")
        expand = step_text(wheel, Actuation((0.0,)), 30, False).expand
        h, _, _ = expand(0.0, [0, 3.0], (), (), 9.0, 1.0, 0.9, 9e9)
        assert h <= 2.0 / 3.0

    @pytest.mark.parametrize("broken", [0, 1])
    def test_what_is_not_finite_makes_no_step(self, broken):
        """In whichever of two arms that share nothing."""
        pair = mechanism(
            """
links:
  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082}
  - {name: b, m: 0.9, l: 0.6, r: 0.25, I: 0.031, from: [1, 0]}
"""
        )
        for value in (1e300, np.inf, np.nan):
            tau = [0.0, 0.0]
            tau[broken] = value
            expand = step_text(pair, Actuation(tuple(tau)), 8, False).expand
            _, _, series = expand(0.0, [0.1, 0.2, 0.0, 0.0], (), (), 1.0, 1.0, 1e-9, 1e-9)
            assert series == ()
