"""Forces at places of a link that vary: those of the material point that is there."""

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
from test_scene_schema import obeys

import robodyn
from robodyn.control.laws import rest_torques
from robodyn.dynamics.identities import BOUND, identities, sample_states
from robodyn.errors import DescriptionError
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text
from robodyn.scene.plain_scene import plain_scene
from robodyn.scene.scene_values import SceneValues

Run = Callable[..., Outcome]
EACH = pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau", "taylor"])
LINKS = """\
gravity: 9.81
links:
  - {name: beam, m: 1.5, l: 0.8, r: [0.36, 0.05], I: 0.082, damping: 0.1}
  - {name: slide, joint: prismatic, axis: [1, 0.5], m: 0.3, l: 0.1, r: 0.05, I: 0.001}
  - {name: arm, m: 0.4, l: 0.3, r: 0.1, I: 0.002}
  - {name: cart, joint: prismatic, axis: [1, 0.2], m: 0.3, l: 0.1, r: 0.05, I: 0.001, from: [0, 0]}
  - {name: tool, joint: fixed, angle: 30deg, m: 0.1, l: 0.2, r: 0.1, I: 0.001, from: arm}
"""
MOVING = (
    "constants: {F: 20 N, c: 0.1 m}\n"
    + LINKS
    + """\
loads:
  - {link: beam, at: ["c + q2 + 0.2 sin(3 t)", 0.05], force: [1, -20]}
  - {link: slide, at: ["0.1 + q2^2", "0.3 q1"], force: ["2 q1", -F], frame: link}
  - {link: cart, at: ["0.1 + q2^2", "0.3 q1"], force: ["2 q1", -F]}
  - {link: arm, at: [0.2, "0.1 t"], force: [1, -F], frame: link}
  - {link: tool, at: ["0.2 q4", "0.1 q3"], force: [3, 2], frame: link}
  - {link: tool, at: ["0.2 q4", 0], force: [3, "t"]}
"""
)


def scene(text: str) -> Mechanism:
    return build(from_text(text, "my.yaml"))


def still(state: np.ndarray, t: float) -> Mechanism:
    """The scene with the places of a state q (4,) as numbers."""
    q1, q2, q3, q4 = map(float, state)
    beam, slide = 0.1 + q2 + 0.2 * math.sin(3 * t), f"[{0.1 + q2**2!r}, {0.3 * q1!r}]"
    return scene(
        LINKS
        + f"""\
loads:
  - {{link: beam, at: [{beam!r}, 0.05], force: [1, -20]}}
  - {{link: slide, at: {slide}, force: [{2 * q1!r}, -20], frame: link}}
  - {{link: cart, at: {slide}, force: [{2 * q1!r}, -20]}}
  - {{link: arm, at: [0.2, {0.1 * t!r}], force: [1, -20], frame: link}}
  - {{link: tool, at: [{0.2 * q4!r}, {0.1 * q3!r}], force: [3, 2], frame: link}}
  - {{link: tool, at: [{0.2 * q4!r}, 0], force: [3, {t!r}]}}
"""
    )


COLUMNS = """tau1 tau2 tau3 tau4 rx1 ry1 rx2 ry2 rx3 ry3 rx4 ry4 rm2 rm4 shake_fx shake_fy"""


def test_at_each_instant_it_is_a_force_at_a_fixed_place() -> None:
    """Torques, reactions, moments of slides and the shaking force; accelerations as well."""
    mechanism = scene(MOVING)
    rng = np.random.default_rng(0)
    names = [*COLUMNS.split(), "shake_m"]
    for state in rng.uniform(-1, 1, (6, 13)):
        q, qd, qdd, t = state[:4], state[4:8], state[8:12], float(state[12])
        each = [
            robodyn.State(x, q, qd, qdd=qdd, t=t).columns(names) for x in (mechanism, still(q, t))
        ]
        assert each[0] == pytest.approx(each[1], rel=1e-11, abs=1e-11)
        tau = each[0].ravel()[:4]
        assert robodyn.forward_dynamics(mechanism, q, qd, tau, t=t) == pytest.approx(qdd, rel=1e-9)


def test_virtual_work_of_the_material_point() -> None:
    """J^T F by sympy: the place is held while the joints are varied."""
    q1, q2, x, F = sympy.symbols("q1 q2 x F")
    l, slope = 0.8, sympy.atan2(0.5, 1)
    along = q1 + slope
    p = sympy.Matrix(
        [
            l * sympy.cos(q1) + (q2 + x) * sympy.cos(along),
            l * sympy.sin(q1) + (q2 + x) * sympy.sin(along),
        ]
    )
    work = F * p[1]
    Q = [work.diff(q).subs(x, sympy.Rational(1, 10) + q2**2) for q in (q1, q2)]
    links = "\n".join(LINKS.splitlines()[:4])
    load = '\nloads: [{link: slide, at: ["0.1 + q2^2", 0], force: [0, -7]}]'
    bare, mechanism = scene(links), scene(links + load)
    rng = np.random.default_rng(1)
    for q in rng.uniform(-1, 1, (5, 2)):
        exact = [float(-each.subs({q1: q[0], q2: q[1], F: -7.0})) for each in Q]
        zero = np.zeros(2)
        more = robodyn.inverse_dynamics(mechanism, q, zero, zero)
        more = more - robodyn.inverse_dynamics(bare, q, zero, zero)
        assert more == pytest.approx(exact, rel=1e-12)


@EACH
def test_an_exact_motion(method: str) -> None:
    """I q'' = F (a + v t) of a force across a lever; its work is the kinetic energy."""
    text = """\
links: [{name: lever, m: 1, l: 1, r: 0, I: 0.5}]
loads: [{link: lever, at: ["0.1 + 0.4 t", 0], force: [0, 2], frame: link}]
"""
    motion = robodyn.simulate(scene(text), [0.0], [0.0], 1.5, method=method, rtol=1e-10, atol=1e-10)
    t = 1.5
    assert motion.q[-1, 0] == pytest.approx(4 * (0.1 * t**2 / 2 + 0.4 * t**3 / 6), rel=1e-8)
    rate = 4 * (0.1 * t + 0.4 * t**2 / 2)
    assert motion.qd[-1, 0] == pytest.approx(rate, rel=1e-8)
    assert motion.report.work == pytest.approx(0.25 * rate**2, rel=1e-8)
    assert motion.report.energy_drift < 1e-8


@EACH
def test_energy_balance(method: str) -> None:
    motion = robodyn.simulate(
        scene(MOVING), np.full(4, 0.1), np.zeros(4), 0.5, method=method, rtol=1e-10, atol=1e-10
    )
    assert motion.report.energy_drift < 1e-8


def test_identities() -> None:
    mechanism = scene(MOVING)
    for found in identities(mechanism, sample_states(mechanism, 20)):
        assert found.residual is None or found.residual <= BOUND, found


def test_equations_in_code(tmp_path: Path, robodyn: Run) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(MOVING)
    text = robodyn("equations", str(path))
    assert text.code == 0, text.err
    assert "c1x = c + q2 + 0.2 sin(3 t)" in text.out
    assert robodyn("equations", str(path), "--steps").code == 0
    code = robodyn("equations", str(path), "--format", "python")
    module = ModuleType("written")
    exec(code.out, module.__dict__)
    q, qd, qdd = np.random.default_rng(3).uniform(-1, 1, (3, 4))
    tau = module.inverse_dynamics(q.tolist(), qd.tolist(), qdd.tolist(), 0.4)
    assert tau == pytest.approx(torques(q, qd, qdd, 0.4), rel=1e-11)


def torques(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, t: float) -> list[float]:
    found: list[float] = robodyn.inverse_dynamics(scene(MOVING), q, qd, qdd, t=t).tolist()
    return found


def test_a_controller_knows_no_place_that_follows_the_time() -> None:
    lever = "links: [{name: lever, m: 1, l: 1, r: 0, I: 0.5}]\nloads: [%s]"
    load = '{link: lever, at: ["0.1 + %s", 0], force: [0, 2], frame: link}'
    by_time, by_joint = (scene(lever % (load % x)) for x in ("t", "q1"))
    assert list(rest_torques(by_time)(0.5)) == [0.0]
    assert list(rest_torques(by_joint)(0.5)) == pytest.approx([-1.2])


def test_how_it_is_written(tmp_path: Path) -> None:
    one = from_text(MOVING, "my.yaml")
    written = plain_scene(one)
    assert written["loads"][0]["at"] == ["c + q2 + 0.2 sin(3 t)", 0.05]
    assert from_text(json.dumps(written), "my.yaml") == one
    assert obeys(MOVING)
    names = SceneValues(MOVING, "my.yaml").names
    assert "loads[0].at[1]" in names
    assert "loads[0].at[0]" not in names
    for old, new, why in (
        ("0.2 sin(3 t)", "0.2 qd1", "has name qd1; known: t, q1..q4"),
        ("0.2 sin(3 t)", "F", "a sum of m and N"),
        ("0.2 sin(3 t)", "abs(q2)", "has abs()"),
    ):
        with pytest.raises(DescriptionError) as caught:
            from_text(MOVING.replace(old, new), "my.yaml")
        (fault,) = caught.value.faults
        assert fault.place == "loads[0].at[0]"
        assert why in fault.limit
    (tmp_path / "x.csv").write_text("t,x\n0,0.1\n1,0.3\n2,0.3\n")
    text = """\
links: [{name: lever, m: 1, l: 1, r: 0, I: 0.5}]
loads: [{link: lever, at: [{table: x.csv, over: t, column: x}, 0], force: [0, 2], frame: link}]
"""
    lever = build(from_text(text, str(tmp_path / "my.yaml")))
    tau = robodyn.inverse_dynamics(lever, *np.zeros((3, 3, 1)), t=[0.0, 0.5, 1.5])
    assert tau[:, 0] == pytest.approx([-0.2, -0.4, -0.6])
