"""The example scenes with springs and gears: what each of them shows."""

import numpy as np
import pytest
from conftest import ROOT

from random_mechanisms import exchanged
from robodyn import (
    assemble,
    forward_dynamics,
    gravity_vector,
    inverse_dynamics,
    kinetic_energy,
    load,
    loop_velocities,
    potential_energy,
    simulate,
)
from robodyn.elements.springs import PointSpring
from robodyn.engines.row_values import rows_of
from robodyn.mechanics import parts

ARM = load(ROOT / "robots/balanced-arm.yaml")
SLIDER = load(ROOT / "robots/spring-slider-crank.yaml")
GEARED = load(ROOT / "robots/geared-five-bar.yaml")


class TestBalancedArm:
    def test_every_pose_is_held_without_torque(self):
        q = np.random.default_rng(0).uniform(-np.pi, np.pi, (2000, 2))
        zero = np.zeros_like(q)
        assert np.abs(inverse_dynamics(ARM, q, zero, zero)).max() < 1e-13
        assert np.abs(forward_dynamics(ARM, q, zero, zero)).max() < 1e-12
        assert np.ptp(potential_energy(ARM, q)) < 1e-12

    @pytest.mark.parametrize("spring", range(3))
    def test_without_one_of_its_springs_it_falls(self, spring):
        fewer = tuple(x for k, x in enumerate(ARM.of(PointSpring)) if k != spring)
        lame = exchanged(ARM, {PointSpring: fewer})
        assert np.abs(gravity_vector(lame, [0.3, 0.5])).max() > 0.1

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_a_push_keeps_its_kinetic_energy(self, method):
        motion = simulate(ARM, [0.6, -1.0], [1.5, 0.5], 10.0, method=method)
        KE = kinetic_energy(ARM, motion.q, motion.qd)
        assert np.ptp(KE) < 1e-8 * KE[0]

    def test_at_rest_it_stays(self):
        motion = simulate(ARM, [0.6, -1.0], [0.0, 0.0], 60.0)
        assert np.abs(motion.q - motion.q[0]).max() < 1e-9


class TestSpringSliderCrank:
    def test_the_spring_pushes_the_piston_back(self):
        """By hand: stiffness times what is missing of its length, along the line."""
        for crank in np.linspace(0.0, 2 * np.pi, 13):
            q = assemble(SLIDER, [crank])
            force = rows_of(parts.acting, SLIDER).planar("forces", q)[0]
            piston = 0.09 * np.cos(crank) + np.sqrt(0.25**2 - (0.012 + 0.09 * np.sin(crank)) ** 2)
            length = 0.46 - piston
            assert 0.12 < length < 0.301
            assert force == pytest.approx(-350 * (0.32 - length), rel=1e-9)

    def test_its_damper_takes_what_the_energy_loses(self):
        q = assemble(SLIDER, [0.7])
        motion = simulate(SLIDER, q, loop_velocities(SLIDER, q, [9.0]), 5.0)
        assert motion.report.work < -1.0
        assert motion.report.energy_drift < 1e-7


class TestGearedFiveBar:
    def test_a_turn_of_the_motor(self):
        """The cranks come back after a turn of the left one, and two of the right."""
        q = assemble(GEARED, np.linspace(0.0, 2 * np.pi, 181)[:, None])
        assert q[-1, 2] - q[0, 2] == pytest.approx(-4 * np.pi)
        assert np.exp(1j * q[-1]) == pytest.approx(np.exp(1j * q[0]))

    def test_the_torque_of_one_motor_is_all_the_power(self):
        rng = np.random.default_rng(2)
        q = assemble(GEARED, rng.uniform(-np.pi, np.pi, (50, 1)))
        qd = loop_velocities(GEARED, q, rng.normal(size=(50, 1)))
        tau = inverse_dynamics(GEARED, q, qd, forward_dynamics(GEARED, q, qd, np.zeros(4)))
        assert np.abs(tau).max() < 1e-11
