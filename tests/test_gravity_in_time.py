"""Gravity that varies with the time, against frames that accelerate, Lagrange and exact motions."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import sympy
from conftest import Outcome
from scipy.integrate import solve_ivp
from test_scene_schema import obeys

import robodyn
from robodyn.control.laws import driving_torques, rest_torques
from robodyn.errors import DescriptionError, InputError
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.parameters.base_parameters import base_parameters
from robodyn.scene.description import from_text
from robodyn.scene.plain_scene import plain_scene
from robodyn.scene.scene_values import SceneValues

Run = Callable[..., Outcome]
EACH = pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau", "taylor"])
LINKS = """\
links:{base}
  - {{name: upper, m: 1.5, l: 0.8, r: [0.36, 0.05], I: 0.082, damping: 0.1, from: {root}}}
  - {{name: lower, m: 0.9, l: 0.6, r: [-0.1, 0.25], I: 0.031, payload: 0.4}}
  - {{name: rod, joint: prismatic, axis: [1, 0.5], m: 0.3, l: 0.1, r: [0.05, 0.02], I: 0.001,
     payload: 0.2, from: upper}}
  - {{name: block, joint: prismatic, axis: [1, -2], m: 0.7, l: 0.1, r: [0.03, 0.02], I: 0.01,
     from: {root}}}
  - {{name: top, joint: prismatic, axis: [2, 1], m: 0.25, l: 0.1, r: [0.05, 0.02], I: 0.001,
     from: block}}
  - {{name: arm, m: 0.6, l: 0.3, r: 0.2, I: 0.01, from: top}}
"""
BASE = """
  - {name: base, joint: prismatic, axis: [1, 0], m: 3, l: 0.1, r: 0, I: 1, from: [0.2, 0.1]}"""
A, W = 3.0, 5.0
FIXED = "constants: {a: 3 m/s^2, w: 5 rad/s}\ngravity: [-a cos(w t), -9.81]\n" + LINKS.format(
    base="", root="[0.3, 0.4]"
)
DRIVEN = "gravity: 9.81\n" + LINKS.format(base=BASE, root="{link: base, at: [0.3, 0.4]}")
TABLE = "{table: g.csv, over: t, column: g}"
NAMES = ["rx1", "ry1", "rx4", "ry6", "rm3", "rm5"]
SLIDER = """\
gravity: "9.81 m/s^2 + 4 m/s^2 sin(6 rad/s*t)"
links: [{name: block, joint: prismatic, axis: [0, 1], m: 2, l: 0, r: 0, I: 1}]
"""


def scene(text: str) -> Mechanism:
    return build(from_text(text, "my.yaml"))


def faults(text: str) -> list[str]:
    with pytest.raises(DescriptionError) as caught:
        from_text(text, "my.yaml")
    return [f"{fault.place}: {fault.limit}" for fault in caught.value.faults]


def test_it_is_what_is_felt_on_a_base_that_accelerates() -> None:
    """Torques, reactions and accelerations, with q1'' of the base a cos(w t) along X."""
    fixed, driven = scene(FIXED), scene(DRIVEN)
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.normal(size=(3, 7, fixed.n))
    t = rng.uniform(-1, 1, 7)
    base = [np.zeros((7, 1)), np.zeros((7, 1)), A * np.cos(W * t)[:, None]]
    whole = [np.hstack(pair) for pair in zip(base, (q, qd, qdd), strict=True)]
    tau = robodyn.inverse_dynamics(fixed, q, qd, qdd, t=t)
    assert tau == pytest.approx(robodyn.inverse_dynamics(driven, *whole)[:, 1:], rel=1e-12)
    one = robodyn.State(fixed, q, qd, qdd=qdd, t=t).columns(NAMES)
    other = robodyn.State(driven, *whole[:2], qdd=whole[2]).columns(
        ["rx2", "ry2", "rx5", "ry7", "rm4", "rm6"]
    )
    assert one == pytest.approx(other, rel=1e-11)
    back = robodyn.forward_dynamics(fixed, q, qd, tau, t=t)
    assert back == pytest.approx(qdd, rel=1e-10)


def test_lagrange_of_two_links() -> None:
    t, m1, m2, l1, r1, r2, I1, I2 = sympy.symbols("t m1 m2 l1 r1 r2 I1 I2")
    q1, q2 = (sympy.Function(name)(t) for name in ("q1", "q2"))
    gx, gy = sympy.sin(3 * t), -9 - 2 * t**2
    one = sympy.Matrix([r1 * sympy.cos(q1), r1 * sympy.sin(q1)])
    two = sympy.Matrix(
        [l1 * sympy.cos(q1) + r2 * sympy.cos(q1 + q2), l1 * sympy.sin(q1) + r2 * sympy.sin(q1 + q2)]
    )
    rates = [p.diff(t) for p in (one, two)]
    T = (m1 * rates[0].dot(rates[0]) + m2 * rates[1].dot(rates[1])) / 2
    T += (I1 * q1.diff(t) ** 2 + I2 * (q1 + q2).diff(t) ** 2) / 2
    g = sympy.Matrix([gx, gy])
    L = T + m1 * g.dot(one) + m2 * g.dot(two)
    tau = [L.diff(q.diff(t)).diff(t) - L.diff(q) for q in (q1, q2)]
    text = """\
gravity: [sin(3 t), "-9 - 2 t^2"]
links:
  - {name: upper, m: 1.5, l: 0.8, r: 0.36, I: 0.082}
  - {name: lower, m: 0.9, l: 0.6, r: 0.25, I: 0.031}
"""
    mechanism = scene(text)
    numbers = {m1: 1.5, l1: 0.8, r1: 0.36, I1: 0.082, m2: 0.9, r2: 0.25, I2: 0.031}
    rng = np.random.default_rng(1)
    for state in rng.normal(size=(5, 7)):
        q, qd, qdd = state[:2], state[2:4], state[4:6]
        values: list[tuple[object, float]] = []
        for order, each in ((2, qdd), (1, qd), (0, q)):
            values += [(x.diff(t, order), v) for x, v in zip((q1, q2), each, strict=True)]
        exact = [float(x.subs(numbers).subs(values).subs(t, state[6])) for x in tau]
        assert robodyn.inverse_dynamics(mechanism, q, qd, qdd, t=state[6]) == pytest.approx(
            exact, rel=1e-12
        )


@EACH
def test_an_exact_fall(method: str) -> None:
    """y'' = -9.81 - 4 sin(6 t), and the energy gained is the work of the field."""
    t = np.linspace(0.0, 1.0, 5)
    motion = robodyn.simulate(
        scene(SLIDER), [0.2], [0.5], 1.0, t_eval=t, method=method, rtol=1e-10, atol=1e-10
    )
    y = 0.2 + (0.5 - 4 / 6) * t - 9.81 / 2 * t**2 + 4 / 36 * np.sin(6 * t)
    assert motion.q[:, 0] == pytest.approx(y, rel=1e-7)
    v = (0.5 - 4 / 6) - 9.81 * t[-1] + 4 / 6 * math.cos(6 * t[-1])
    assert motion.report.work == pytest.approx(v**2 - 0.25, rel=1e-7)


@EACH
def test_the_lift_is_one_that_rides(method: str) -> None:
    """The balance by its closed form, the lamp by an equation of its own.

    m x'' + c x' + k x = m a sin(w t) from rest: a sine, and what decays.
    """
    a, w, m, k, c = 1.1, 2 * math.pi / 8, 0.8, 160.0, 3.0
    t, tolerance = np.linspace(0.0, 8.0, 9), 1e-8 if method == "Radau" else 1e-10
    start = [m * 9.81 / k, -1.2]
    found = robodyn.simulate(
        robodyn.load("lift"),
        start,
        [0.0, 0.0],
        8.0,
        t_eval=t,
        method=method,
        rtol=tolerance,
        atol=tolerance,
    )
    swing = a / (k / m - w * w + 1j * w * c / m)
    decay = np.roots([m, c, k])
    own = np.linalg.solve(
        np.array([[1, 1], decay]), [-swing.imag + 0j, -(1j * w * swing).imag + 0j]
    )
    x = (swing * np.exp(1j * w * t)).imag + (own @ np.exp(np.outer(decay, t))).real
    assert found.q[:, 0] == pytest.approx(start[0] + x, abs=1e-6)

    def lamp(t: float, y: np.ndarray) -> list[float]:
        g = 9.81 + a * math.sin(w * t)
        torque = -0.35 * 0.26 * g * math.cos(y[0]) - 0.002 * y[1]
        return [y[1], torque / (0.0017 + 0.35 * 0.26**2)]

    exact = solve_ivp(
        lamp, (0, 8), [start[1], 0], t_eval=t, method="DOP853", rtol=1e-12, atol=1e-12
    )
    assert found.q[:, 1] == pytest.approx(exact.y[0], abs=1e-6)


@EACH
def test_energy_balance(method: str) -> None:
    mechanism = scene(FIXED)
    motion = robodyn.simulate(
        mechanism, np.full(6, 0.1), np.zeros(6), 1.0, method=method, rtol=1e-10, atol=1e-10
    )
    assert motion.report.energy_drift < 1e-8
    assert abs(motion.report.work) > 1.0


def test_a_closed_loop_on_a_base_that_accelerates() -> None:
    links = """
  - {name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008, from: ROOT}
  - {name: coupler, m: 1.3, l: 0.95, r: [0.45, 0.1], I: 0.102}
  - {name: rocker, m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: OTHER}
closures: [[coupler, rocker]]
actuated: [%scrank]
"""
    here = links.replace("ROOT", "[0, 0]").replace("OTHER", "[1.1, 0]") % ""
    moved = links.replace("ROOT", "{link: base, at: [0, 0]}")
    moved = moved.replace("OTHER", "{link: base, at: [1.1, 0]}") % "base, "
    fixed = scene(f'gravity: ["-3 cos(5 t)", -9.81]\nlinks:{here}')
    driven = scene(f"gravity: 9.81\nlinks:{BASE}{moved}")
    t = np.linspace(0.0, 2.0, 6)
    q1 = np.linspace(0.3, 5.0, 6)[:, None]
    q = robodyn.assemble(fixed, q1)
    qd = robodyn.loop_velocities(fixed, q, 0 * q1 + 2.0)
    qdd = robodyn.loop_accelerations(fixed, q, qd, 0 * q1 - 3.0)
    zero, a = np.zeros((6, 1)), A * np.cos(W * t)[:, None]
    tau = robodyn.inverse_dynamics(fixed, q, qd, qdd, t=t)[:, 0]
    other = robodyn.inverse_dynamics(
        driven, np.hstack([zero, q]), np.hstack([zero, qd]), np.hstack([a, qdd])
    )[:, 1]
    assert tau == pytest.approx(other, rel=1e-11)


def test_the_regressor_has_it() -> None:
    mechanism = scene(FIXED)
    rng = np.random.default_rng(2)
    q, qd, qdd = rng.normal(size=(3, 4, mechanism.n))
    t = rng.uniform(0, 1, 4)
    found = robodyn.regressor(mechanism, q, qd, qdd, t=t)
    tau = robodyn.inverse_dynamics(mechanism, q, qd, qdd, t=t)
    assert found.Y @ found.values + found.known == pytest.approx(tau, rel=1e-11)
    assert np.abs(found.known).max() < 1e-12
    # of a block that gravity alone moves along its slide the mass is known
    assert [x.name for x in base_parameters(scene(SLIDER))] == ["m1", "d1"]


def test_derivatives_by_masses_have_it() -> None:
    mechanism = scene(FIXED)
    rng = np.random.default_rng(3)
    state = rng.normal(size=(3, 3, mechanism.n))
    t = rng.uniform(0, 1, 3)
    values = SceneValues(FIXED, "my.yaml")
    for name in ("links.lower.m", "links.rod.payload", "links.lower.r[1]", "constants.a"):
        found = robodyn.inverse_dynamics_derivatives(mechanism, *state, t=t, numbers=[name])
        now, h = values.number(name), 1e-4
        ends = [build(values.replaced({name: now + sign * h})) for sign in (1, -1)]
        up, down = (robodyn.inverse_dynamics(x, *state, t=t) for x in ends)
        assert found.by_numbers[..., 0] == pytest.approx((up - down) / (2 * h), abs=1e-7)


def test_equations_and_code(tmp_path: Path, robodyn: Run) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(FIXED)
    text = robodyn("equations", str(path))
    assert text.code == 0, text.err
    assert "gx = -a cos(w t)" in text.out
    assert "being 0 in this scene: gx" not in text.out
    code = robodyn("equations", str(path), "--format", "python")
    assert code.code == 0, code.err
    module = ModuleType("written")
    exec(code.out, module.__dict__)
    rng = np.random.default_rng(4)
    q, qd, qdd = rng.normal(size=(3, 6))
    tau = module.inverse_dynamics(q.tolist(), qd.tolist(), qdd.tolist(), 0.7)
    assert tau == pytest.approx(torques(q, qd, qdd, 0.7), rel=1e-11)


def torques(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, t: float) -> list[float]:
    found: list[float] = robodyn.inverse_dynamics(scene(FIXED), q, qd, qdd, t=t).tolist()
    return found


def test_check_and_sweep(tmp_path: Path, robodyn: Run) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(SLIDER.replace("6 rad/s", "w").replace("gravity", "constants: {w: 6}\ngravity"))
    assert robodyn("check", str(path)).code == 0
    swept = robodyn(
        "sweep", str(path), "--q", "0", "--time", "1", "--vary", "constants.w=3,6", "--quiet"
    )
    assert swept.code == 0, swept.err
    for row, w in zip(swept.rows, (3.0, 6.0), strict=True):
        assert float(row["q1_end"]) == pytest.approx(
            -9.81 / 2 - 4 / w + 4 / w**2 * math.sin(w), rel=1e-7
        )


def test_what_has_no_time_refuses_it_by_name() -> None:
    mechanism = scene(SLIDER.replace("axis: [0, 1]", "axis: [1, 1]"))
    for ask in (
        lambda: robodyn.linearize(mechanism, [0.0]),
        lambda: robodyn.equilibrium(mechanism),
        lambda: robodyn.equilibria(mechanism),
        lambda: driving_torques(mechanism),
        lambda: rest_torques(mechanism),
    ):
        with pytest.raises(InputError, match="gravity: varies with the time"):
            ask()


def test_how_it_is_written(tmp_path: Path) -> None:
    one = from_text(FIXED, "my.yaml")
    written = plain_scene(one)
    assert written["gravity"] == ["-a cos(w t)", -9.81]
    assert from_text(json.dumps(written), "my.yaml") == one
    down = from_text(SLIDER, "my.yaml")
    assert from_text(json.dumps(plain_scene(down)), "my.yaml") == down
    assert obeys(FIXED)
    assert obeys(SLIDER)
    names = SceneValues(FIXED, "my.yaml").names
    assert "gravity[1]" in names
    assert "gravity[0]" not in names
    assert "gravity" not in SceneValues(SLIDER, "my.yaml").names
    (found,) = faults(FIXED.replace("-a cos(w t)", "-a cos(q1) t"))
    assert found == "gravity[0]: has name q1; known: t, pi, e, a, w, at character 8"
    (found,) = faults(FIXED.replace("-a cos(w t)", "-w cos(w t)"))
    assert found.startswith("gravity[0]: must be in m/s²")
    (found,) = faults(SLIDER.replace("sin(6 rad/s*t)", "abs(sin(t))"))
    assert "gravity: has abs()" in found
    (tmp_path / "g.csv").write_text("t,g\n0,9\n1,11\n2,11\n")
    text = SLIDER.replace(
        '"9.81 m/s^2 + 4 m/s^2 sin(6 rad/s*t)"', "{table: g.csv, over: t, column: g}"
    )
    table = build(from_text(text, str(tmp_path / "my.yaml")))
    tau = robodyn.inverse_dynamics(table, *np.zeros((3, 3, 1)), t=[0.0, 0.5, 1.5])
    assert tau[:, 0] == pytest.approx([18.0, 20.0, 22.0])
