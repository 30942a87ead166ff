"""Springs with laws and tables, loads that vary: closed forms, quadratures, refusals.

All engines are held against 30 digits of such scenes in test_engines.py.
"""

import math
import os
import pickle
import random
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import Outcome
from jsonschema import Draft202012Validator
from mpmath import mp, mpf
from named_case import case

from random_mechanisms import mechanism
from robodyn import (
    forward_dynamics,
    inverse_dynamics,
    inverse_dynamics_derivatives,
    potential_energy,
    simulate,
)
from robodyn.engines import machine
from robodyn.engines.row_values import SignalError, TableLeftError
from robodyn.errors import DescriptionError, InputError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import build, load
from robodyn.runs.benchmark import reference
from robodyn.runs.machine_motion import Status
from robodyn.scene.description import from_text
from robodyn.scene.scene_schema import scene_schema
from robodyn.scene.scene_values import SceneValues
from robodyn.sweeps.lanes import Aims, Motions, integrate

Run = Callable[..., Outcome]
METHODS = ["DOP853", *(["taylor"] if machine.available() else [])]
EVERY = pytest.mark.parametrize("method", METHODS)
ARM = "links:\n  - {name: arm, m: 1.0, l: 1.0, r: 0.5, I: 0.05}\n"  # 0.3 kg m^2 about its joint
INERTIA = 0.3


def arm(rest: str):
    return mechanism(f"{ARM}{rest}")


def run(mech, q, qd, t_end, method, **given):
    tight = {"rtol": 1e-11, "atol": 1e-11} | given
    return simulate(mech, [q], [qd], t_end, method=method, **tight)


def table(folder: Path, name: str, header: str, rows) -> str:
    path = folder / name
    lines = [f"{x!r},{y!r}" for x, y in rows]
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return str(path)


class TestLaws:
    @EVERY
    @pytest.mark.parametrize("amplitude", [0.1, 1.2, 3.0])
    def test_the_period_of_a_duffing_spring(self, method, amplitude):
        """4 K(m)/w with w^2 = a + b A^2 and m = b A^2/(2 w^2), K by Legendre."""
        k, k3 = 10.0, 5.0
        mech = arm(f'springs: [{{joint: arm, law: "{k}*x + {k3}*x**3", angle: 0}}]')
        a, b = mpf(k) / INERTIA, mpf(k3) / INERTIA
        w2 = a + b * amplitude**2
        period = float(4 * mp.ellipk(b * amplitude**2 / (2 * w2)) / mp.sqrt(w2))
        times = np.array([period / 4, period / 2, period])
        motion = run(mech, amplitude, 0.0, period, method, t_eval=times)
        assert motion.q[:, 0] == pytest.approx([0.0, -amplitude, amplitude], abs=2e-9)
        assert motion.report.energy_drift < 1e-10
        assert motion.report.work == 0.0

    def test_a_spring_that_slides_and_one_between_points(self):
        """Both are k x + k3 x^3 along one line, by the displacement and by the distance."""
        cart = "links: [{name: cart, joint: prismatic, axis: [1, 0], m: 2, l: 0, r: 0, I: 0}]\n"
        law = "30*x + 200*x**3 + 0.5*v"
        one = mechanism(cart + f'springs: [{{joint: cart, law: "{law}", length: 0.4}}]')
        ends = "between: [cart, [-1, 0]]"
        two = mechanism(cart + f'springs: [{{{ends}, law: "{law}", length: 1.4}}]')
        for q, qd in ((0.9, -2.0), (0.1, 1.0)):
            x = q - 0.4
            force = 30 * x + 200 * x**3 + 0.5 * qd
            for mech in (one, two):
                assert forward_dynamics(mech, [q], [qd], [0.0]) == pytest.approx([-force / 2])
        motions = [run(x, 0.9, 0.0, 2.0, "taylor") for x in (one, two)]
        assert motions[0].q[-1] == pytest.approx(motions[1].q[-1], abs=1e-9)
        assert max(m.report.energy_drift for m in motions) < 1e-9
        gained = motions[0].qd[-1, 0] ** 2  # 1/2 m v^2: a law with v has no potential
        assert motions[0].report.work == pytest.approx(gained, abs=1e-9)

    @pytest.mark.parametrize(
        "law", ["40*tanh(30*x)", "5*(exp(3*x) - 1)", "sin(9*x)/(1 + x**2)", "9*sqrt(1 + x) - 9"]
    )
    def test_the_energy_is_the_integral_of_the_pull(self, law):
        mech = arm(f'springs: [{{joint: arm, law: "{law}", angle: 0.2}}]')
        scope = {name: getattr(mp, name) for name in ("tanh", "exp", "sin", "sqrt")}
        for q in (-0.6, 0.25, 2.0):
            ends = np.linspace(0.0, q - 0.2, 12).tolist()
            right = mp.quad(lambda x: eval(law, scope | {"x": x}), ends)
            assert potential_energy(mech, [q]) == pytest.approx(float(right), rel=2e-12)

    def test_a_damper_by_its_law(self):
        """v' = -c v |v| in the smooth form c v sqrt(v^2): v = v0/(1 + c v0 t/I)."""
        mech = arm('springs: [{joint: arm, law: "0.6*v**2", angle: 0}]')
        motion = run(mech, 0.0, 2.0, 3.0, "taylor")
        assert motion.qd[-1, 0] == pytest.approx(2.0 / (1.0 + 0.6 * 2.0 * 3.0 / INERTIA), rel=1e-9)
        lost = 0.5 * INERTIA * (motion.qd[-1, 0] ** 2 - 4.0)
        assert motion.report.work == pytest.approx(lost, rel=1e-9)


def test_the_energy_of_a_table_without_a_row_at_zero(tmp_path):
    """U is zero where the spring is free, between two rows: F = -1/3 + 8/3 x there."""
    file = table(tmp_path, "pull.csv", "x,F", [(-2.0, -4.0), (-1.0, -3.0), (2.0, 5.0), (3.0, 9.0)])
    mech = arm(f"springs: [{{joint: arm, table: {file}, angle: 0.25}}]")
    for x, energy in [(0.0, 0.0), (1.5, -0.5 + 3.0), (-1.0, 1 / 3 + 4 / 3), (-2.0, 5 / 3 + 3.5)]:
        assert potential_energy(mech, [x + 0.25]) == pytest.approx(energy, abs=1e-13)
    assert potential_energy(mech, [3.25]) == pytest.approx(-2 / 3 + 16 / 3 + 7.0, abs=1e-13)


@EVERY
def test_a_law_passes_where_it_divides_by_zero(method):
    """As sin(3 x)/x at x = 0; against the series of sin(3 x)/x, which needs no division."""
    powers = " ".join(
        f"{(-1) ** k * 3.0 ** (2 * k + 1) / math.factorial(2 * k + 1):+.17g}*x**{2 * k}"
        for k in range(14)
    )
    ends = []
    for law in ("sin(3*x)/x", powers):
        mech = arm(f'springs: [{{joint: arm, law: "4*x + {law} - 3", angle: 0}}]')
        ends.append(run(mech, 0.5, 0.0, 3.0, method).q[-1, 0])
    assert ends[0] == pytest.approx(ends[1], abs=1e-7)


class TestLoads:
    @EVERY
    def test_a_force_of_time(self, method):
        mech = arm('loads: [{link: arm, torque: "2*sin(3*t)"}]')
        motion = run(mech, 0.0, 0.0, 2.0, method)
        rate = 2.0 * (1.0 - math.cos(6.0)) / 3.0 / INERTIA
        assert motion.qd[-1, 0] == pytest.approx(rate, abs=1e-9)
        assert motion.report.work == pytest.approx(0.5 * INERTIA * rate**2, abs=1e-9)
        assert motion.report.energy_drift < 1e-9
        assert motion.qdd[-1, 0] == pytest.approx(2.0 * math.sin(6.0) / INERTIA, abs=1e-9)

    @EVERY
    def test_a_narrow_pulse_is_not_passed_over(self, method, tmp_path):
        """Of an expression in t; of a table over t, and one over the angle between flat parts."""
        mech = arm('loads: [{link: arm, torque: "800*exp(-((t - 2.37)/1e-3)**2)"}]')
        motion = run(mech, 0.0, 0.1, 4.0, method)
        rate = 0.1 + 800e-3 * math.sqrt(math.pi) / INERTIA
        assert motion.qd[-1, 0] == pytest.approx(rate, abs=1e-8)
        rows = [(0.0, 0.0), (2.0, 0.0), (2.001, 600.0), (2.002, 0.0), (4.0, 0.0)]
        file = table(tmp_path, "pulse.csv", "t,M", rows)
        mech = arm(f"loads: [{{link: arm, torque: {{table: {file}, over: t, column: M}}}}]")
        motion = run(mech, 0.0, 0.1, 4.0, method)
        assert motion.qd[-1, 0] == pytest.approx(0.1 + 0.6 / INERTIA, abs=1e-8)
        if method == "DOP853":  # its errors alone tell of rows over an angle
            return
        rows = [(x + 0.5, y) for x, y in rows]
        file = table(tmp_path, "place.csv", "q1,M", [*rows, (90.0, 0.0)])
        mech = arm(f"loads: [{{link: arm, torque: {{table: {file}, over: q1, column: M}}}}]")
        motion = run(mech, 0.5, 3.0, 4.0, method)
        gained = 0.5 * INERTIA * (motion.qd[-1, 0] ** 2 - 9.0)
        assert gained == pytest.approx(0.6, abs=1e-7)

    @EVERY
    @pytest.mark.parametrize("wide", [1e-6, 1e-9, 1e-12])
    def test_rows_far_nearer_than_the_others(self, method, wide, tmp_path):
        """1 N m up to 0.3 rad, -1 N m beyond: after 4 sqrt(2 0.3/a), a = 1/I, at rest at 0."""
        rows = [(-10.0, 1.0), (0.3 - wide, 1.0), (0.3 + wide, -1.0), (10.0, -1.0)]
        file = table(tmp_path, "edge.csv", "q1,M", rows)
        mech = arm(f"loads: [{{link: arm, torque: {{table: {file}, over: q1, column: M}}}}]")
        motion = run(mech, 0.0, 0.0, 4.0 * math.sqrt(0.6 * INERTIA), method)
        assert motion.outcome.label == "finished"
        assert abs(motion.q[-1, 0]) < 1e-8
        assert abs(motion.qd[-1, 0]) < 1e-5

    def test_time_is_a_column_or_zero(self, robodyn: Run, tmp_path):
        scene = tmp_path / "arm.yaml"
        scene.write_text(ARM + 'loads: [{link: arm, at: [1, 0], force: [0, "2 + 3*t"]}]\n')
        single = robodyn("torque", scene, "--q", "0")
        assert float(single.out.split()[1]) == -2.0
        states = "t,q1,qd1,qdd1\n0,0,0,0\n2,0,0,0\n"
        rows = robodyn("torque", scene, "-", stdin=states).out.splitlines()
        assert [float(row.split(",")[-1]) for row in rows[1:]] == [-2.0, -8.0]
        for command, states, column, right in (
            ("accel", "t,q1,qd1\n0,0,0\n2,0,0\n", "qdd1", [2 / 0.3, 8 / 0.3]),
            ("reactions", "t,q1,qd1,qdd1\n0,0,0,0\n2,0,0,0\n", "ry1", [-2.0, -8.0]),
        ):
            header, *rows = robodyn(command, scene, "-", stdin=states).out.splitlines()
            place = header.split(",").index(column)
            assert [float(row.split(",")[place]) for row in rows] == pytest.approx(right)

    def test_batches_have_a_time_each(self):
        mech = arm('loads: [{link: arm, at: [1, 0], force: ["-3*t*qd1", "5*cos(t)"]}]')
        rng = np.random.default_rng(4)
        q, qd, qdd, t = rng.normal(size=(4, 700))
        tau = inverse_dynamics(mech, q[:, None], qd[:, None], qdd[:, None], t)[:, 0]
        right = INERTIA * qdd - (3 * t * qd * np.sin(q) + 5 * np.cos(t) * np.cos(q))
        assert tau == pytest.approx(right, abs=1e-12)
        back = forward_dynamics(mech, q[:, None], qd[:, None], tau[:, None], t)[:, 0]
        assert back == pytest.approx(qdd, abs=1e-11)
        with pytest.raises(InputError, match=r"t\.shape"):
            inverse_dynamics(mech, q[:, None], qd[:, None], qdd[:, None], t[:5])


GAS = """gravity: 0
links:
  - {name: crank, m: 2.0, l: 0.05, r: 0, I: 0.6}
  - {name: rod, m: 0.4, l: 0.18, r: 0.06, I: 0.002, payload: 0.5}
closures:
  - {point: rod, on: {through: [0, 0], along: [1, 0]}}
loads:
  - {link: rod, at: [0.18, 0], force: [{table: gas.csv, over: q1, column: F}, 0]}
"""


def gas_force(k: int) -> float:
    """Of a four-stroke engine, N, every 20 degrees of two turns."""
    return -4000.0 * math.exp(-(((k - 19) / 3.0) ** 2)) - (400.0 if 13 <= k < 18 else 0.0)


class TestGas:
    @pytest.fixture
    def engine_scene(self, tmp_path):
        rows = [(4.0 * math.pi * k / 36, round(gas_force(k % 36), 3)) for k in range(37)]
        table(tmp_path, "gas.csv", "q1,F", rows)
        (tmp_path / "engine.yaml").write_text(GAS)
        return load(tmp_path / "engine.yaml"), rows

    @EVERY
    def test_its_work_is_that_of_a_quadrature(self, engine_scene, method):
        """Along x(q1) of the slider-crank, row by row, over the angle that was turned."""
        mech, rows = engine_scene
        q0, l, r = 0.3, mpf(0.18), mpf(0.05)
        start = np.array([q0, -q0 - math.asin(0.05 * math.sin(q0) / 0.18)])
        rate = -1.0 - 0.05 * math.cos(q0) / math.sqrt(0.18**2 - (0.05 * math.sin(q0)) ** 2)
        tight = {"rtol": 1e-11, "atol": 1e-11, "max_evals": 10**7}
        motion = simulate(mech, start, [60.0, 60.0 * rate], 0.25, method=method, **tight)
        assert motion.outcome.label == "finished"
        end = float(motion.q[-1, 0])
        assert end > 13.0  # more than two turns: the table repeats

        def slope(q):
            return -r * mp.sin(q) - r**2 * mp.sin(q) * mp.cos(q) / mp.sqrt(
                l**2 - (r * mp.sin(q)) ** 2
            )

        step, total = 4 * mp.pi / 36, mpf(0)
        k = int(q0 / step)
        while k * step < end:
            a, b = max(k * step, mpf(q0)), min((k + 1) * step, mpf(end))
            one, two = (mpf(rows[i % 36][1]) for i in (k, k + 1))
            total += mp.quad(
                lambda q, one=one, two=two, k=k: (one + (two - one) * (q / step - k)) * slope(q),
                [a, b],
            )
            k += 1
        bound = 1e-4 if method == "DOP853" else 1e-7  # it takes rows as they come
        assert motion.report.work == pytest.approx(float(total), abs=bound)
        assert motion.report.energy_drift < 1e-8

    def test_the_rows_are_stepped_onto_as_closely_as_tolerances_ask(self, engine_scene):
        mech, _ = engine_scene
        q = np.array([0.3, -0.3 - math.asin(0.05 * math.sin(0.3) / 0.18)])
        rate = -1.0 - 0.05 * math.cos(0.3) / math.sqrt(0.18**2 - (0.05 * math.sin(0.3)) ** 2)
        state = np.concatenate([q, [60.0, 60.0 * rate]])
        exact = reference(mech, state, np.array([0.02]), Actuation((0.0, 0.0)))
        assert exact.uncertainty < 1e-9
        for rtol, bound in ((1e-8, 1e-6), (1e-11, 1e-8)):
            motion = simulate(mech, q, state[2:], 0.02, method="taylor", rtol=rtol, atol=rtol)
            found = np.concatenate([motion.q[-1], motion.qd[-1]])
            assert np.abs(found - exact.y[-1]).max() < bound * 60.0

    def test_leaving_a_table_that_ends_names_it(self, tmp_path, robodyn: Run):
        table(tmp_path, "rope.csv", "x,F", [(-1.0, 0.0), (0.0, 0.0), (1.0, 2.0)])
        scene = tmp_path / "rope.yaml"
        scene.write_text(ARM + "springs: [{joint: arm, table: rope.csv, angle: 0.5}]\n")
        mech = load(scene)
        with pytest.raises(TableLeftError, match=r"springs\[0\].table: x = 1.5.* -1 to 1"):
            inverse_dynamics(mech, [2.0], [0.0], [0.0])
        for command in ("torque", "energy", "terms"):
            found = robodyn(command, scene, "--q", "2")
            assert found.code == 1
            assert "springs[0].table: x = 1.5: the rows of rope.csv end" in found.err
        for method in METHODS:
            motion = run(mech, 0.0, 9.0, 3.0, method)
            assert motion.outcome.label == "step too small"
            assert "it leaves the table" in motion.report.advice
            assert motion.q[-1, 0] == pytest.approx(1.5, abs=1e-3)
        found = robodyn("simulate", scene, "--q", "0", "--qd", "9", "--time", "3")
        assert found.code == 1
        assert "rope.csv" in found.err


class TestOthers:
    def test_lanes_follow_single_runs(self, tmp_path):
        """Of sweeps: laws and tables over joints; loads in time go one by one."""
        file = table(
            tmp_path, "rope.csv", "x,F", [(-9.0, -2.0), (0.0, 0.0), (0.3, 4.0), (9.0, 9.0)]
        )
        text = f"springs: [{{joint: arm, table: {file}, angle: 0.1}}, "
        text += '{joint: arm, law: "2*x + 3*x**3", angle: 0}]\n'
        mech = arm(text + 'loads: [{link: arm, torque: "cos(q1) - 0.2*qd1"}]')
        y = np.array([[0.4, 0.0], [-0.8, 1.0], [0.0, 3.0]])
        given = Motions(mech, y, np.zeros((3, 1)), np.zeros(3))
        (ends,) = integrate([given], 2.0, Aims(1e-10, 1e-10, work=True), [False])
        assert ends is not None
        assert (ends.status == Status.REACHED).all()
        for k, (q, qd) in enumerate(y):
            motion = run(mech, q, qd, 2.0, "taylor")
            right = [motion.q[-1, 0], motion.qd[-1, 0]]
            assert ends.y[k] == pytest.approx(right, abs=2e-7)
        assert ends.drift.max() < 1e-7
        timed = arm('loads: [{link: arm, torque: "sin(t)"}]')
        given = Motions(timed, y, np.zeros((3, 1)), np.zeros(3))
        assert integrate([given], 2.0, Aims(1e-9, 1e-9), [False]) == [None]

    def test_a_sweep_of_a_load_in_time(self, tmp_path, robodyn: Run):
        scene = tmp_path / "arm.yaml"
        scene.write_text(ARM + 'loads: [{link: arm, torque: "2*sin(3*t)"}]\n')
        found = robodyn("sweep", scene, "--vary", "q1=0,1", "--time", "2", "--result", "final")
        assert found.code == 0, found.err
        header, *rows = found.out.splitlines()
        place = header.split(",").index("qd1_end")
        rate = 2.0 * (1.0 - math.cos(6.0)) / 3.0 / INERTIA
        assert [float(row.split(",")[place]) for row in rows] == pytest.approx([rate] * 2)

    def test_what_equations_do_not_have_is_checked_and_drawn(self, tmp_path, robodyn: Run):
        scene = tmp_path / "arm.yaml"
        (tmp_path / "rope.csv").write_text("x,F\n0,0\n1,5\n")
        scene.write_text(ARM + "springs: [{joint: arm, table: rope.csv, angle: 0}]\n")
        assert robodyn("check", scene).code == 0
        assert robodyn("draw", scene, "--q", "1", "--out", tmp_path / "arm.svg").code == 0

    def test_the_arrow_of_a_load_is_its_value_there(self):
        from robodyn.pictures.force_arrows import forces

        mech = arm('loads: [{link: arm, at: [1, 0], force: ["3*q1", "8*cos(t)"]}]')
        q, zero = np.array([0.5]), np.zeros(1)
        arrows = {x.name: x.force for x in forces(mech, q, zero, zero, np.zeros(0))}
        assert arrows["load 1"] == pytest.approx(1.5 + 8j)


# ---------------------------------------------------------------------------------------------
# What is refused
# ---------------------------------------------------------------------------------------------

SPRING = "springs: [{{joint: arm, angle: 0, {}}}]"
POINTS = "springs: [{{between: [arm, [1, 1]], length: 1, {}}}]"
TORQUE = "loads: [{{link: arm, torque: {}}}]"
FORCE = "loads: [{{link: arm, at: [0, 1], force: {}}}]"
FAULTS = [
    (SPRING.format('law: "x", stiffness: 3'), "springs[0].law", "stands beside stiffness"),
    (SPRING.format('law: "x", table: a.csv'), "springs[0].table", "stands beside law"),
    (SPRING.format('law: "x", damping: 1'), "springs[0].damping", "stands beside law"),
    (SPRING.format("damping: 1"), "springs[0].stiffness", "is missing"),
    (SPRING.format('law: "y"'), "springs[0].law", "name y; known: x, v, pi, e"),
    (SPRING.format('law: "t"'), "springs[0].law", "name t"),
    (SPRING.format('law: "x +"'), "springs[0].law", "must be an expression"),
    (SPRING.format('law: ""'), "springs[0].law", "must be an expression"),
    (SPRING.format("law: [1, 2]"), "springs[0].law", "must be an expression"),
    (SPRING.format('law: "x, v"'), "springs[0].law", "a comma"),
    (SPRING.format('law: "abs(x)"'), "springs[0].law", "abs(), which bends"),
    (SPRING.format('law: "x if x > 0 else 0"'), "springs[0].law", "bends or jumps"),
    (SPRING.format('law: "x > 0"'), "springs[0].law", "a comparison"),
    (SPRING.format('law: "x % 2"'), "springs[0].law", "%, which bends"),
    (SPRING.format('law: "x**99"'), "springs[0].law", "an exponent above 64"),
    (SPRING.format('law: "open(x)"'), "springs[0].law", "function open"),
    (SPRING.format('law: "x.real"'), "springs[0].law", "'.' at character 2"),
    (SPRING.format('law: "3 N*x"'), "springs[0].law", "must be in N m, not in N"),
    (SPRING.format('law: "3 N m*x + 2 N"'), "springs[0].law", "a sum of N m and N"),
    (SPRING.format('law: "3 m/mm + 4 kg + x"'), "springs[0].law", "a plain number and kg"),
    (SPRING.format('law: "4 kg + 3 m/mm + x"'), "springs[0].law", "kg and a plain number"),
    (TORQUE.format('"3 N m*sin(2 s*t)"'), "loads[0].torque", "sin of s^2, at character 7"),
    (TORQUE.format('"3 N*q1"'), "loads[0].torque", "must be in N m, not in N"),
    (SPRING.format("table: none.csv"), "springs[0].table", "cannot be read"),
    (SPRING.format("table: [1]"), "springs[0].table", "must be a name"),
    (POINTS.format("table: one.csv"), "springs[0].table", "has 1 rows"),
    (POINTS.format("table: back.csv"), "springs[0].table", "x must increase"),
    (
        POINTS.format("table: text.csv"),
        "springs[0].table",
        "line 3: F = two: must be a finite number",
    ),
    (
        POINTS.format("table: short.csv"),
        "springs[0].table",
        "line 3: number of fields = 1: the header has 2",
    ),
    (POINTS.format("table: head.csv"), "springs[0].table", "column x is missing: the header has"),
    (POINTS.format("table: empty.csv"), "springs[0].table", "the input is empty"),
    (POINTS.format("table: steep.csv"), "springs[0].table", "overflow"),
    (POINTS.format('law: "q1"'), "springs[0].law", "name q1"),
    (TORQUE.format('"q2"'), "loads[0].torque", "name q2; known: t, q1..q1"),
    (TORQUE.format('"x"'), "loads[0].torque", "name x"),
    (TORQUE.format('"1/0"'), "loads[0].torque", "a division by zero"),
    (TORQUE.format('"5"'), "loads[0].torque", "must be a number"),
    (TORQUE.format("yes"), "loads[0].torque", "has name yes"),
    (TORQUE.format("[1, 2]"), "loads[0].torque", "must be a number"),
    (TORQUE.format(".inf"), "loads[0].torque", "must be a number"),
    (TORQUE.format("{table: good.csv, over: q1}"), "loads[0].torque.column", "is missing"),
    (TORQUE.format("{table: good.csv, over: q9, column: F}"), "loads[0].torque.over", "q1 to q1"),
    (TORQUE.format("{table: good.csv, over: qd1, column: F}"), "loads[0].torque.over", "q1 to q1"),
    (TORQUE.format("{table: good.csv, over: q1, column: G}"), "loads[0].torque.table", "column G"),
    (
        TORQUE.format("{table: good.csv, over: q1, column: q1}"),
        "loads[0].torque.table",
        "both axes",
    ),
    (TORQUE.format("{table: g, over: t, column: F, more: 1}"), "loads[0].torque.more", "unknown"),
    (FORCE.format('["sin(t)"]'), "loads[0].force", "two numbers"),
    (FORCE.format('"sin(t)"'), "loads[0].force", "two numbers"),
    (FORCE.format('["sin(t)", "floor(t)"]'), "loads[0].force[1]", "floor(), which bends"),
    (FORCE.format("[{over: q1}, 0]"), "loads[0].force[0].table", "is missing"),
]


@pytest.fixture(scope="module")
def tables(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    for name, text in {
        "good": "q1,F,t\n0,1,0\n1,2,1\n", "one": "x,F\n0,1\n", "back": "x,F\n0,1\n1,2\n1,3\n",
        "text": "x,F\n0,1\n1,two\n", "short": "x,F\n0,1\n1\n", "head": "y,F\n0,1\n1,2\n",
        "empty": "", "steep": "x,F\n0,-1e308\n1e-300,1e308\n",
    }.items():  # fmt: skip
        (folder / f"{name}.csv").write_text(text)
    return folder


def test_faults_are_told(tables):
    for text, place, limit in FAULTS:
        with case(text, place, limit):
            with pytest.raises(DescriptionError) as error:
                from_text(ARM + text, str(tables / "scene.yaml"))
            assert place in str(error.value)
            assert limit in str(error.value)


def test_a_table_is_a_regular_file_of_bounded_size(tmp_path):
    """A pipe that nobody writes is not waited for, a device not read."""
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    (tmp_path / "sparse.csv").touch()
    os.truncate(tmp_path / "sparse.csv", 2**24 + 1)
    table(tmp_path, "long.csv", "x,F", [(float(k), 1.0) for k in range(2001)])
    rows = [f"{k},{k},{'x' * 10**5}" for k in range(20)]
    (tmp_path / "wide.csv").write_text("\n".join(["x,F,note", *rows]))
    for name, limit in (
        ("pipe.csv", "is not a regular file"),
        ("zero.csv", "is not a regular file"),
        ("sparse.csv", "is larger than 16 MiB"),
        ("long.csv", "has more than 2000 rows below its header"),
        (".", "cannot be read: is a directory"),
    ):
        with pytest.raises(DescriptionError) as error:
            from_text(ARM + SPRING.format(f"table: {name}"), str(tmp_path / "scene.yaml"))
        assert f"springs[0].table = {name}: {limit}" in str(error.value)
    from_text(ARM + SPRING.format("table: wide.csv"), str(tmp_path / "scene.yaml"))


GOOD = """links:
  - {name: crank, m: 1, l: 1, r: 0.5, I: 0.1}
  - {name: rod, m: 1, l: 2, r: 1, I: 0.2}
springs:
  - {joint: crank, law: "3*x + 2*x**3 + 0.5*v", angle: 20deg}
  - {between: [rod, [3, 1]], table: rope.csv, length: 1.5, damping: 0.1}
loads:
  - {link: rod, at: [1, 0], force: [{table: gas.csv, over: q2, column: F}, "4*sin(2*t)"]}
  - {link: crank, torque: "cos(q1) - qd2"}
"""
HARMLESS = {("x**3", ""), ("cos(q1)", "")}  # signs stay behind
SLIPS = ["", "@", "((", "nan", "1e999", "true", "null", "[]", "{}", "__import__", "$", "'", "law"]


def test_a_hundred_slips_are_refused(tmp_path):
    """A word of a scene that is good replaced or lost: a fault is told, with its line."""
    table(tmp_path, "rope.csv", "x,F", [(-9.0, -1.0), (9.0, 1.0)])
    table(tmp_path, "gas.csv", "q2,F", [(-9.0, -1.0), (9.0, 1.0)])
    source = str(tmp_path / "scene.yaml")
    from_text(GOOD, source)
    begin = GOOD.index("springs")
    words = ["joint:", "law:", "angle:", "x**3", "20deg", "between:", "table:", "rope.csv",
             "length:", "1.5", "damping:", "0.1}", "link:", "force:", "gas.csv", "over:", "q2,",
             "column:", "F}", "sin(2", "torque:", "cos(q1)", "qd2"]  # fmt: skip
    pairs = [(word, slip) for word in words for slip in SLIPS]
    refused = 0
    for word, slip in random.Random(7).sample(pairs, len(pairs)):
        text = GOOD[:begin] + GOOD[begin:].replace(word, slip, 1)
        if (word, slip) in HARMLESS:
            from_text(text, source)
            continue
        with pytest.raises(DescriptionError) as error:
            from_text(text, source)
        assert all(fault.line is not None for fault in error.value.faults), (word, slip)
        refused += 1
    assert refused >= 100


def test_a_table_is_read_once(tmp_path):
    """A loaded scene keeps its tables, whatever becomes of their files; the next has the new."""
    path = tmp_path / "a.yaml"
    table(tmp_path, "F.csv", "x,F", [(-9.0, -90.0), (9.0, 90.0)])
    path.write_text(ARM + "springs: [{joint: arm, table: F.csv, angle: 0}]\n")
    old = pickle.loads(pickle.dumps(load(path)))
    times = (tmp_path / "F.csv").stat()
    table(tmp_path, "F.csv", "x,F", [(-9.0, 90.0), (9.0, -90.0)])
    os.utime(tmp_path / "F.csv", ns=(times.st_atime_ns, times.st_mtime_ns))
    assert inverse_dynamics(load(path), [0.3], [0], [0])[0] == pytest.approx(-3.0)
    heavy = SceneValues(old.description.written, old.source).replaced({"links.arm.m": 2.0})
    again = SceneValues(heavy.written, old.source).replaced({"links.arm.I": 1.0})
    for mech in (old, build(heavy), build(again)):
        assert inverse_dynamics(mech, [0.3], [0], [0])[0] == pytest.approx(3.0)
    found = inverse_dynamics_derivatives(old, [0.3], [0], [0], numbers=["links.arm.m"])
    assert found.by_numbers[0, 0] == pytest.approx(0.0, abs=1e-12)


def test_expressions_with_units(tmp_path):
    table(tmp_path, "rope.csv", "x,F", [(-9.0, -1.0), (9.0, 1.0)])
    table(tmp_path, "gas.csv", "q2,F", [(-9.0, -1.0), (9.0, 1.0)])
    other = GOOD.replace("3*x + 2*x**3 + 0.5*v", "3 N m/rad*x + 2 N m*x^3 + 500 mN*m*s/rad*v")
    other = other.replace("4*sin(2*t)", "0.004 kN*sin(2 rad/s · t)")
    one, two = (from_text(text, str(tmp_path / "a.yaml")) for text in (GOOD, other))
    assert other.count("N") == GOOD.count("N") + 4
    assert one.springs[0].law.node == two.springs[0].law.node
    assert one.loads[0].varying[1].node == two.loads[0].varying[1].node


def test_the_schema_takes_such_scenes_and_no_others(tables):
    obeys = Draft202012Validator(scene_schema()).is_valid
    assert obeys(yaml.safe_load(GOOD))
    assert obeys(yaml.safe_load(GOOD.replace("4*sin(2*t)", "4 N*sin(90°/s*t) + 3 mN")))
    told_by_it = [text for text, *_ in FAULTS if not obeys(yaml.safe_load(ARM + text))]
    assert len(told_by_it) >= 20  # files, names and signs are told by robodyn alone


@EVERY
def test_backwards_is_the_way_back(method, tmp_path):
    """Across the rows of tables over time and over a spring's extension."""
    file = table(tmp_path, "pulse.csv", "t,M", [(-1.0, 0.0), (0.2, 1.0), (0.7, -2.0), (2.0, 3.0)])
    rope = table(tmp_path, "rope.csv", "x,F", [(-9.0, -3.0), (0.0, 0.0), (9.0, 90.0)])
    text = f"springs: [{{joint: arm, table: {rope}, angle: 0.3}}]\n"
    text += f"loads: [{{link: arm, torque: {{table: {file}, over: t, column: M}}}}]"
    mech = arm(text)
    back = run(mech, 0.5, 1.0, -0.8, method)
    assert back.outcome.label == "finished"
    # the same forwards, in the mirrored time: the rates change their signs
    rows = [(-2.0, 3.0), (-0.7, -2.0), (-0.2, 1.0), (1.0, 0.0)]
    table(tmp_path, "pulse.csv", "t,M", rows)
    forth = run(arm(text), 0.5, -1.0, 0.8, method)
    assert back.q[-1] == pytest.approx(forth.q[-1], abs=1e-7)
    assert back.qd[-1] == pytest.approx(-forth.qd[-1], abs=1e-6)


@pytest.mark.parametrize(
    ("entry", "one", "all_of_them", "count", "methods"),
    [
        ('loads: [{point: arm, force: ["F*t", F]}]', 2, 600, 300, []),
        ('loads: [{link: arm, torque: "F*sin(t)"}]', 1, 300, 300, ["DOP853", "taylor"]),
        ("springs: [{between: [arm, [0, 1]], stiffness: F, length: 0.2}]", 1, 300, 300, ["DOP853"]),
        ("springs: [{joint: arm, stiffness: F, angle: 0}]", 1, 3000, 3000, ["DOP853"]),
    ],
)
def test_many_of_a_kind_act_as_one_of_their_sum(entry, one, all_of_them, count, methods):
    kind, part = entry.replace("F", str(one)).split(" ", 1)
    mechs = (
        arm(entry.replace("F", str(all_of_them))),
        arm(f"{kind} [{', '.join([part[1:-1]] * count)}]"),
    )
    torques = [inverse_dynamics(mech, [0.3], [0.7], [0.5], 0.2) for mech in mechs]
    np.testing.assert_allclose(torques[1], torques[0], rtol=1e-11)
    for method in methods:
        runs = [simulate(x, [0.3], [0.7], 0.01, method=method) for x in mechs]
        ends = [motion.q[-1] for motion in runs]
        np.testing.assert_allclose(ends[1], ends[0], rtol=1e-8)


@pytest.mark.parametrize(
    ("text", "at"),
    [
        ("1/q1", "q1 = 0"),
        ("q1/(t-t)", "q1 = 0, t = 0"),
        ("log(q1, 1)", "q1 = 0"),
        ("t/(t-t)", "t = 0"),
        ("(t-t)**-1 + qd1", "qd1 = 0, t = 0"),
        ("asin(q1-q1+2)", "q1 = 0"),
    ],
)
def test_a_load_without_a_value_at_a_state_is_named(text, at):
    mech = arm(f'loads: [{{link: arm, torque: "{text}"}}]')
    told = re.escape(f"loads[0].torque = {text}: is not finite at {at}")
    with pytest.raises(SignalError, match=told):
        inverse_dynamics(mech, [0.0], [0.0], [0.0])
    with pytest.raises(SignalError, match=told):
        forward_dynamics(mech, [[0.0]] * 3, [0.0], [0.0])
    for method in METHODS:
        with pytest.raises(SignalError, match=told):
            run(mech, 0.0, 0.0, 0.1, method)


def test_a_law_without_a_value_is_named_at_its_row(scene, robodyn):
    path = scene(f"{ARM}springs: [{{joint: arm, law: 2/x, angle: 0.5}}]")
    stdin = "q1,qd1,qdd1\n1,0,0\n0.5,0,0\n2,0,0\n"
    outcome = robodyn("torque", path, "-", stdin=stdin)
    outcome.fails(1, "line 3", "springs[0].law = 2/x: is not finite")
    assert [row["tau1"] for row in outcome.rows] == ["4.0", "", repr(2 / 1.5)]  # no gravity
