"""Couplings by laws of joints: reduced by sympy, in every engine, and in what reads a scene."""

import json

import numpy as np
import pytest
import sympy as sp

from random_mechanisms import mechanism
from robodyn import (
    assemble,
    closure_gap,
    closure_jacobian,
    coriolis_matrix,
    gravity_vector,
    inverse_dynamics,
    loop_accelerations,
    loop_velocities,
    mass_matrix,
    regressor,
    simulate,
)
from robodyn.dynamics import identities
from robodyn.dynamics.closed_form import energies
from robodyn.dynamics.dynamics import coupling_torques, forward_dynamics_and_forces
from robodyn.engines.coupling_laws import law_derivatives
from robodyn.errors import InputError
from robodyn.loops.closures import closure_bias
from robodyn.mechanics.mechanism import build
from robodyn.runs.report import Outcome
from robodyn.scene.description import from_text

NESTED = """
gravity: 9.81
links:
  - {name: a, m: 1.0, l: 0.8, r: 0.4, I: 0.06}
  - {name: b, m: 0.9, l: 0.6, r: 0.3, I: 0.03}
  - {name: s, joint: prismatic, axis: [0.6, 0.8], m: 0.7, l: 0.1, r: 0.02, I: 0.01}
  - {name: d, m: 0.5, l: 0.4, r: 0.2, I: 0.012}
  - {name: e, m: 0.4, l: 0.3, r: [0.1, 0.05], I: 0.004}
couplings:
  - "q2 = 0.3 sin(q1) + 0.2 q4^2"
  - "q3 = 20 mm (1 - cos(2 q1)) exp(0.1 q4)"
  - "q5 = atan(q1)/(5 + q4) + tanh(0.5 q1) + sqrt(1 + q4^2)"
"""
U = sp.symbols("u1 u4")
LAWS = [
    U[0],
    0.3 * sp.sin(U[0]) + 0.2 * U[1] ** 2,
    0.02 * (1 - sp.cos(2 * U[0])) * sp.exp(0.1 * U[1]),
    U[1],
    sp.atan(U[0]) / (5 + U[1]) + sp.tanh(0.5 * U[0]) + sp.sqrt(1 + U[1] ** 2),
]
# the second and third joints before those that tell them, closures beside laws, and a chain of laws
CAM = """
gravity: 9.81
links:
  - {name: cam, m: 2, l: 0.1, r: 0.01, I: 0.02}
  - {name: lift, joint: prismatic, axis: [0, 1], m: 0.5, l: 0, r: 0, I: 0, from: [0.3, 0]}
couplings: "q2 = 30 mm (1 - cos(2 q1)) + 0.1 mm q1"
"""


@pytest.fixture(scope="module")
def nested():
    return mechanism(NESTED)


def states(count, seed=0):
    """u, ud and udd (count, 2) of the joints that tell the others."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.5, 1.5, (count, 2)), *rng.normal(size=(2, count, 2))


def reduced(u, ud):
    """q, T and Tdot of q = g(u), by sympy."""
    q = sp.Matrix(LAWS)
    T = q.jacobian(U)
    rates = sp.Matrix(sp.symbols("w1 w4"))
    Tdot = sp.Matrix(5, 2, lambda i, j: sum(T[i, j].diff(U[k]) * rates[k] for k in range(2)))
    made = sp.lambdify([*U, *rates], [q, T, Tdot], "numpy")
    q, T, Tdot = made(*u, *ud)
    return q[:, 0], T, Tdot


class TestReduction:
    """With q = g(u): T^T M T udd = T^T (tau - C qd - G - M Tdot ud)."""

    @pytest.mark.parametrize("count", [1, 300])
    def test_kinematics(self, nested, count):
        u, ud, udd = states(count)
        q = assemble(nested, u)
        qd = loop_velocities(nested, q, ud)
        qdd = loop_accelerations(nested, q, qd, udd)
        for k in range(min(count, 5)):
            exact, T, Tdot = reduced(u[k], ud[k])
            np.testing.assert_allclose(q[k], exact, rtol=1e-14, atol=1e-15)
            np.testing.assert_allclose(qd[k], T @ ud[k], rtol=1e-13, atol=1e-14)
            np.testing.assert_allclose(qdd[k], T @ udd[k] + Tdot @ ud[k], rtol=1e-12, atol=1e-13)
        assert np.abs(closure_gap(nested, q)).max() < 1e-15
        assert np.abs(closure_jacobian(nested, q) @ qd[..., None]).max() < 1e-14

    @pytest.mark.parametrize("count", [1, 300])
    def test_forward_and_inverse(self, nested, count):
        u, ud, _ = states(count, 1)
        q = assemble(nested, u)
        qd = loop_velocities(nested, q, ud)
        tau = np.zeros(q.shape)
        tau[:, [0, 3]] = np.random.default_rng(2).normal(size=(count, 2))
        found = forward_dynamics_and_forces(nested, q, qd, tau)
        forces = coupling_torques(nested, found.multipliers)
        for k in range(min(count, 5)):
            _, T, Tdot = reduced(u[k], ud[k])
            M, C = mass_matrix(nested, q[k]), coriolis_matrix(nested, q[k], qd[k])
            load = tau[k] - C @ qd[k] - gravity_vector(nested, q[k]) - M @ Tdot @ ud[k]
            qdd = T @ np.linalg.solve(T.T @ M @ T, T.T @ load) + Tdot @ ud[k]
            np.testing.assert_allclose(found.qdd[k], qdd, rtol=1e-10, atol=1e-11)
            held = M @ qdd + C @ qd[k] + gravity_vector(nested, q[k]) - tau[k]
            np.testing.assert_allclose(forces[k], held[[1, 2, 4]], rtol=1e-9, atol=1e-10)
        back = inverse_dynamics(nested, q, qd, found.qdd)
        np.testing.assert_allclose(back, tau, atol=1e-9)

    def test_the_identities_hold(self, nested):
        for x in identities.identities(nested, identities.sample_states(nested, 50)):
            assert x.residual is not None, x
            assert x.residual < 1e-9, x


class TestMotion:
    @pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau", "taylor"])
    def test_energy_and_laws_are_kept(self, nested, method):
        q = assemble(nested, [0.4, -0.7])
        tight = {"rtol": 1e-11, "atol": 1e-11}
        motion = simulate(nested, q, np.zeros(5), 1.5, method=method, **tight)
        other = simulate(nested, q, np.zeros(5), 1.5, method="taylor", rtol=1e-13, atol=1e-13)
        assert motion.outcome is Outcome.FINISHED
        np.testing.assert_allclose(motion.q[-1], other.q[-1], rtol=0, atol=3e-8)
        assert np.abs(closure_gap(nested, motion.q)).max() < 1e-12
        energy = np.sum(energies(nested, motion.q, motion.qd), axis=0)
        assert np.ptp(energy) < 1e-7

    def test_backwards(self, nested):
        q = assemble(nested, [0.4, -0.7])
        there = simulate(nested, q, np.zeros(5), 1.0, rtol=1e-12, atol=1e-12)
        back = simulate(nested, there.q[-1], there.qd[-1], -1.0, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(back.q[-1], q, atol=1e-9)

    def test_a_cam_on_a_free_flywheel(self):
        """The reduced equation of one coordinate: (J + m s'^2) w w' + m s' s'' w^2 = -m g s'."""
        from scipy.integrate import solve_ivp

        mech = mechanism(CAM)
        J = 0.02 + 2 * 0.01**2

        def rates(t, y):
            x, w = y
            s1 = 0.06 * np.sin(2 * x) + 1e-4
            s2 = 0.12 * np.cos(2 * x)
            weight = 2 * 9.81 * 0.01 * np.cos(x) + 0.5 * 9.81 * s1
            return [w, -(0.5 * s1 * s2 * w * w + weight) / (J + 0.5 * s1 * s1)]

        exact = solve_ivp(rates, (0, 3), [0.2, 9.0], rtol=1e-12, atol=1e-12, method="DOP853")
        q = assemble(mech, [0.2])
        qd = loop_velocities(mech, q, [9.0])
        for method in ("DOP853", "taylor"):
            motion = simulate(mech, q, qd, 3.0, method=method, rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(motion.q[-1, 0], exact.y[0, -1], rtol=0, atol=1e-9)


class TestReaders:
    def test_derivatives_by_one_joint(self, nested):
        q = np.zeros((7, 5))
        q[:, 0], q[:, 3] = np.linspace(-1, 2, 7), 0.3
        f, f1, f2 = law_derivatives(nested, 1, 0, q, 0.0)
        scale = np.exp(0.03)
        np.testing.assert_allclose(f, 0.02 * (1 - np.cos(2 * q[:, 0])) * scale, atol=1e-16)
        np.testing.assert_allclose(f1, 0.04 * np.sin(2 * q[:, 0]) * scale, atol=1e-16)
        np.testing.assert_allclose(f2, 0.08 * np.cos(2 * q[:, 0]) * scale, atol=1e-16)

    def test_equations_name_the_law_and_its_derivatives(self, robodyn, scene, nested):
        path = scene(NESTED)
        text = robodyn("equations", path).out
        assert "Psi11 = -R1 h1_1" in text
        assert "h1_1 = 0.3 cos(q1)" in text
        assert "h1 = 0.3 sin(q1) + 0.2 q4²" in text
        assert "(Psidot qd)1 = -R1 (h1_1_1 qd1² + 0.4 qd4²)" in text
        known: dict = {}
        exec(robodyn("equations", path, "--format", "python").out, known)
        u, ud, _ = states(1, 3)
        q = assemble(nested, u[0])
        qd = loop_velocities(nested, q, ud[0])
        np.testing.assert_allclose(known["Psi"](q), closure_jacobian(nested, q), atol=1e-15)
        bias = closure_bias(nested, q, qd, t=0.0)
        np.testing.assert_allclose(known["Psidot_qd"](q, qd), bias, rtol=1e-13, atol=1e-14)
        np.testing.assert_allclose(known["gap"](q + 0.1), closure_gap(nested, q + 0.1), atol=1e-15)

    def test_a_scene_is_written_back(self, nested):
        again = nested.to_dict()
        assert again["couplings"][0] == "q2 = 0.3 sin(q1) + 0.2 q4^2"
        other = build(from_text(json.dumps(again), "again"))
        assert other.description.couplings == nested.description.couplings
        mapped = build(from_text(CAM.replace('"q2', '{law: "q2').replace('q1"', 'q1"}'), "mapped"))
        assert mapped.description.couplings == mechanism(CAM).description.couplings

    @pytest.mark.parametrize("format", ["urdf", "mjcf"])
    def test_exports_refuse(self, robodyn, scene, format):
        given = robodyn("export", scene(NESTED), "--format", format)
        assert given.code == 2
        assert "couplings[0] = 0.3 sin(q1) + 0.2 q4^2" in given.err

    def test_the_regressor_makes_the_torques(self, nested):
        u, ud, udd = states(4, 5)
        q = assemble(nested, u)
        qd = loop_velocities(nested, q, ud)
        qdd = loop_accelerations(nested, q, qd, udd)
        found = regressor(nested, q, qd, qdd)
        tau = inverse_dynamics(nested, q, qd, qdd)[:, [0, 3]]
        np.testing.assert_allclose(found.Y @ found.values + found.known, tau, atol=1e-11)

    def test_lanes_are_single_runs(self, robodyn, scene):
        path = scene(NESTED)
        given = robodyn(
            "sweep", path, "--q", "0.4,-0.7", "--vary", "links.a.m=0.8,1,1.3",
            "--time", "0.5", "--result", "final",
        )  # fmt: skip
        rows = [line.split(",") for line in given.out.splitlines()]
        place = rows[0].index("q1_end")
        for row in rows[1:]:
            mech = mechanism(NESTED.replace("a, m: 1.0", f"a, m: {row[0]}"))
            q = assemble(mech, [0.4, -0.7])
            motion = simulate(mech, q, np.zeros(5), 0.5, rtol=1e-11, atol=1e-11)
            found = [float(x) for x in row[place : place + 5]]
            np.testing.assert_allclose(found, motion.q[-1], atol=1e-7)

    def test_the_joint_on_the_left_may_be_the_actuated_one(self):
        text = CAM + "actuated: [lift]\n"
        mech = mechanism(text + "start: {cam: 0.3}\n")
        q = assemble(mech, [0.02])
        assert abs(q[1] - 0.02) < 1e-15
        assert np.abs(closure_gap(mech, q)).max() < 1e-15
        with pytest.raises(InputError, match="start"):
            assemble(mechanism(text), [0.02])

    @pytest.mark.parametrize("law", ["abs(q1) m", "max(q1, 0) m", "q1 if q1 > 0 else 0", "q1 % 1"])
    def test_what_bends_is_refused(self, law):
        with pytest.raises(InputError, match="bends or jumps"):
            mechanism(CAM.replace("30 mm (1 - cos(2 q1)) + 0.1 mm q1", law))
