"""Data beside laws of the time: regressors, identification and fits take the time of each row."""

import itertools
import json

import numpy as np
import pytest

from random_mechanisms import mechanism
from robodyn import (
    assemble,
    fit,
    forward_dynamics,
    inverse_dynamics,
    loop_accelerations,
    loop_velocities,
    points,
    simulate,
)
from robodyn.dynamics.derivatives import (
    forward_dynamics_derivatives,
    inverse_dynamics_derivatives,
)
from robodyn.errors import InputError, ResidualError
from robodyn.parameters.base_parameters import base_parameters, random_rows
from robodyn.parameters.identification import identify
from robodyn.parameters.motion_fit import fit_motion
from robodyn.parameters.regression_matrix import regressor

ROD = """
gravity: 9.81
links:
  - {name: rod, m: 1.0, l: 1, r: 0.5, I: 0.1}
  - {name: bead, joint: prismatic, axis: [1, 0], from: {link: rod, at: [0, 0.1]},
     m: 0.5, l: 0, r: 0, I: 0.01, damping: 0.2}
couplings: "q1 = 3 rad/s t + 0.2 sin(t)"
"""
# a four-bar whose pivot is shaken by a law
SHAKEN = """
gravity: 9.81
links:
  - {name: base, joint: prismatic, axis: [0, 1], m: 2, l: 0, r: 0, I: 0}
  - {name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008, from: base}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker, m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}
closures: [[coupler, rocker]]
couplings: "q1 = 0.05 m sin(4 t)"
actuated: [crank]
"""
DRIVEN = """
gravity: 9.81
constants: {w: 5 rad/s}
links:
  - {name: crank,   m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker,  m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}
closures: [[coupler, rocker]]
couplings: "q1 = w t + 0.3 sin(2 t)"
"""
MIXED = """
gravity: 9.81
links:
  - {name: a, m: 1.0, l: 0.8, r: 0.4, I: 0.06}
  - {name: b, m: 0.9, l: 0.6, r: 0.3, I: 0.03}
  - {name: c, m: 0.4, l: 0.3, r: 0.15, I: 0.004}
couplings: "q2 = 0.5 sin(2 t) + 0.3 q1 cos(t) + 0.1 q3^2"
actuated: [a, c]
"""
SCENES = {"rod": ROD, "shaken": SHAKEN, "mixed": MIXED}


def motion(mech, t):
    """Closed states of the actuated joints' motion 0.4 + 0.3 sin(2 t + k)."""
    k = np.arange(len(mech.actuated))
    phase = 2 * t[:, None] + k
    q = assemble(mech, 0.4 + 0.3 * np.sin(phase), t=t)
    qd = loop_velocities(mech, q, 0.6 * np.cos(phase), t=t)
    qdd = loop_accelerations(mech, q, qd, -1.2 * np.sin(phase), t=t)
    return q, qd, qdd


@pytest.mark.parametrize("name", SCENES)
class TestRegressor:
    def test_rows_of_the_regressor_take_their_times(self, name):
        mech = mechanism(SCENES[name])
        q, qd, qdd, t = random_rows(mech, 40)
        assert np.ptp(t) > 1.0
        found = regressor(mech, q, qd, qdd, t)
        tau = inverse_dynamics(mech, q, qd, qdd, t)[:, list(mech.actuated)]
        np.testing.assert_allclose(found.Y @ found.values + found.known, tau, atol=1e-11)

    def test_base_parameters_tell_all_torques(self, name):
        """As many as the rank of the regressor, and with it the same torques."""
        mech = mechanism(SCENES[name])
        base = base_parameters(mech)
        rows = random_rows(mech, 80, seed=5)
        found = regressor(mech, *rows)
        Y = found.Y.reshape(-1, len(found.names))
        size = np.linalg.norm(Y, axis=0)
        told = size > 1e-9 * size.max()
        s = np.linalg.svd(Y[:, told] / size[told], compute_uv=False)
        assert len(base) == (s > 1e-9 * s[0]).sum()
        columns = [found.names.index(x.name) for x in base]
        torques = Y[:, columns] @ [x.value for x in base]
        np.testing.assert_allclose(torques, Y @ found.values, atol=1e-10)

    def test_numbers_are_identified(self, name):
        mech = mechanism(SCENES[name])
        other = mechanism(SCENES[name].replace("m: 0.5,", "m: 0.8,").replace("m: 0.9,", "m: 1.4,"))
        other = mechanism(SCENES[name].replace("m: 1.3,", "m: 1.9,")) if name == "shaken" else other
        t = np.linspace(0, 3, 80)
        states = motion(mech, t)
        tau = inverse_dynamics(other, *states, t)[:, list(mech.actuated)]
        of = {"rod": "links.bead.m", "shaken": "links.coupler.m", "mixed": "links.b.m"}[name]
        found = identify(mech, *states, tau, t, of)
        wanted = {"rod": 0.8, "shaken": 1.9, "mixed": 1.4}[name]
        assert found.estimates[0].value == pytest.approx(wanted, rel=1e-9)
        assert identify(mech, *states, tau, t).rms == pytest.approx(0, abs=1e-9)
        with pytest.raises(InputError, match=r"couplings\[0\] = .* is a law of the time"):
            identify(mech, *states, tau)


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_take_their_times(name):
    mech = mechanism(SCENES[name])
    q, qd, qdd, t = random_rows(mech, 5)
    tau = np.zeros(q.shape)
    tau[:, list(mech.actuated)] = 1.3
    for function, slopes, states in (
        (forward_dynamics, forward_dynamics_derivatives, (q, qd, tau)),
        (inverse_dynamics, inverse_dynamics_derivatives, (q, qd, qdd)),
    ):
        found = slopes(mech, *states, t=t)[1:4]
        for k, h in itertools.product(range(mech.n), [1e-6]):
            for place, by in enumerate(found):
                ahead, behind = ([x.copy() for x in states] for _ in range(2))
                ahead[place][:, k] += h
                behind[place][:, k] -= h
                each = function(mech, *ahead, t=t) - function(mech, *behind, t=t)
                size = max(1.0, float(np.abs(by).max()))
                np.testing.assert_allclose(each / (2 * h), by[..., k], atol=1e-7 * size)


def test_a_torque_that_lacks_an_actuator_is_refused_as_in_other_scenes():
    mech = mechanism(MIXED.replace("actuated: [a, c]", "actuated: [a]"))
    q, qd, qdd, t = random_rows(mech, 3)
    with pytest.raises(ResidualError, match="name it in `actuated`"):
        inverse_dynamics(mech, q, qd, qdd, t)


class TestFit:
    @pytest.mark.parametrize("name", SCENES)
    def test_states_take_their_times(self, name):
        mech = mechanism(SCENES[name])
        changes = {
            "rod": (("m: 0.5,", "m: 0.8,"), "links.bead.m", 0.8, ["tau2"]),
            "shaken": (("l: 0.95,", "l: 0.9,"), "links.coupler.l", 0.9, ["q4", "qd4", "qdd4"]),
            "mixed": (("m: 0.9,", "m: 1.4,"), "links.b.m", 1.4, ["tau1", "tau3"]),
        }[name]
        (old, new), number, wanted, columns = changes
        other = mechanism(SCENES[name].replace(old, new))
        t = np.linspace(0, 3, 40)
        q, qd, qdd = motion(other, t)
        own = list(mech.actuated)
        tau = inverse_dynamics(other, q, qd, qdd, t)
        known = {
            f"{x}{k + 1}": y[:, k]
            for x, y in (("q", q), ("qd", qd), ("qdd", qdd), ("tau", tau))
            for k in range(mech.n)
        }
        target = np.stack([known[c] for c in columns], axis=-1)
        given = q[:, own], qd[:, own], qdd[:, own]
        found = fit(mech, {number: (0.5, 2.0)}, columns, *given, t, target=target, starts=6)
        assert found.numbers[number] == pytest.approx(wanted, rel=1e-9)
        assert found.rms == pytest.approx(0, abs=1e-9)
        with pytest.raises(InputError, match="is a law of the time"):
            fit(mech, {number: (0.5, 2.0)}, columns, *given, target=target)

    def test_a_number_of_the_law_itself(self):
        """The speed of a driven crank, from where the coupler's tip goes."""
        mech, other = mechanism(DRIVEN), mechanism(DRIVEN.replace("5 rad/s", "5.5 rad/s"))
        t = np.linspace(0, 1, 40)
        q = assemble(other, np.zeros((40, 0)), t=t)
        qd = loop_velocities(other, q, np.zeros((40, 0)), t=t)
        qdd = loop_accelerations(other, q, qd, np.zeros((40, 0)), t=t)
        _, place, speed, acceleration = points(other, q, qd, qdd, of=["coupler"])
        target = np.concatenate([place[:, 0], speed[:, 0], acceleration[:, 0]], axis=-1)
        columns = [f"coupler_{x}" for x in ("x", "y", "vx", "vy", "ax", "ay")]
        none = np.zeros((40, 0))
        found = fit(mech, {"constants.w": (4, 7)}, columns, none, t=t, target=target, starts=10)
        assert found.numbers["constants.w"] == pytest.approx(5.5, rel=1e-9)

    @pytest.mark.parametrize("text", [ROD, MIXED], ids="ab")
    def test_motions(self, text):
        mech = mechanism(text)
        other = mechanism(text.replace("m: 0.5,", "m: 0.8,").replace("m: 0.9,", "m: 1.4,"))
        name = "links.bead.m" if text is ROD else "links.b.m"
        q = assemble(other, [0.1] * len(mech.actuated))
        qd = loop_velocities(other, q, [0.0] * len(mech.actuated))
        t = np.linspace(0, 0.5, 11)
        run = simulate(other, q, qd, 0.5, t_eval=t, rtol=1e-12, atol=1e-12)
        target = run.q[:, list(mech.actuated)]
        columns = [f"q{k + 1}" for k in mech.actuated]
        given = [0.1] * len(mech.actuated), [0.0] * len(mech.actuated)
        found = fit_motion(mech, {name: (0.3, 2.0)}, columns, t, *given, target=target)
        assert found.numbers[name] == pytest.approx(0.8 if text is ROD else 1.4, rel=1e-6)


class TestCommands:
    def test_rows_need_a_column_t(self, robodyn, scene):
        path = scene(ROD)
        table = "q2,qd2,qdd2,tau2\n0.1,0,0,1\n0.2,0,0,1\n0.3,0,1,1\n"
        for command in (
            ["identify", path, "-"],
            ["fit", path, "--vary", "links.bead.m=0.1:2", "--match", "-"],
            ["regressor", path, "-", "--condition"],
        ):
            given = robodyn(*command, stdin=table)
            assert given.code == 2
            assert "couplings[0] = 3 rad/s t + 0.2 sin(t) is a law of the time" in given.err

    def test_a_table_is_fitted_and_identified(self, robodyn, scene):
        path = scene(ROD)
        t = np.linspace(0, 2, 60)
        mech = mechanism(ROD.replace("m: 0.5,", "m: 0.8,"))
        q, qd, qdd = motion(mech, t)
        tau = inverse_dynamics(mech, q, qd, qdd, t)[:, 1]
        rows = np.column_stack([t, q[:, 1], qd[:, 1], qdd[:, 1], tau])
        table = "t,q2,qd2,qdd2,tau2\n" + "".join(
            ",".join(map(repr, row)) + "\n" for row in rows.tolist()
        )
        given = robodyn("identify", path, "-", "--of", "links.bead.m", stdin=table)
        assert given.code == 0, given.err
        (parameter,) = json.loads(given.out)["parameters"]
        assert parameter["value"] == pytest.approx(0.8, rel=1e-9)
        vary = ["--vary", "links.bead.m=0.1:2"]
        given = robodyn("fit", path, *vary, "--match", "-", stdin=table)
        assert given.code == 0, given.err
        assert json.loads(given.out)["numbers"]["links.bead.m"] == pytest.approx(0.8, rel=1e-9)
        given = robodyn("regressor", path, "--base")
        assert given.code == 0, given.err
        assert {x["name"] for x in json.loads(given.out)["base"]} == {"m2", "mx2", "my2", "d2"}

    def test_a_wholly_driven_scene_has_no_torques_to_identify_by(self, robodyn, scene):
        t = np.linspace(0, 1, 20)
        table = "t\n" + "".join(f"{x!r}\n" for x in t.tolist())
        given = robodyn("identify", scene(DRIVEN), "-", stdin=table)
        assert given.code == 2
        assert "laws of the time lead the mechanism" in given.err
        for rest in (["--base"], [], ["-"]):
            given = robodyn("regressor", scene(DRIVEN), *rest, stdin=table)
            assert given.code == 2
            assert "laws of the time lead the mechanism" in given.err

    def test_a_wholly_driven_scene_is_fitted(self, robodyn, scene):
        """The length of the coupler, from where the rocker stands at some times."""
        t = np.linspace(0, 1, 20)
        other = mechanism(DRIVEN.replace("l: 0.95", "l: 0.9"))
        q = assemble(other, np.zeros((20, 0)), t=t)
        rows = zip(t.tolist(), q[:, 2].tolist(), strict=True)
        table = "t,q3\n" + "".join(f"{x!r},{y!r}\n" for x, y in rows)
        vary = ["--vary", "links.coupler.l=0.7:1.2"]
        given = robodyn("fit", scene(DRIVEN), *vary, "--match", "-", stdin=table)
        assert given.code == 0, given.err
        assert json.loads(given.out)["numbers"]["links.coupler.l"] == pytest.approx(0.9, rel=1e-9)
