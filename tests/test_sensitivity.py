"""Sensitivities of motions, against closed forms, many digits and differences of two runs."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Outcome, relative_error
from mpmath import mp, mpf
from scipy.integrate import DOP853
from sliding_scenes import BLOCK

import robodyn as rd
from robodyn.control.state_feedback import StateFeedback
from robodyn.errors import InputError
from robodyn.mechanics.actuation import table as torque_table
from robodyn.mechanics.mechanism import build
from robodyn.scene.scene_values import read_numbers

Scene = Callable[[str], Path]
TIGHT = {"rtol": 1e-12, "atol": 1e-12}
METHODS = ["DOP853", "taylor"]
LINKS = "gravity: 9.81\nlinks:\n"
MOTOR = (
    LINKS + "- {name: w, m: 2, l: 0.1, r: 0.05, I: 0.01, motor: {ratio: 20, inertia: 1e-5, %s}}\n"
)
ARM = LINKS + "- {name: a, m: 1, l: 1, r: 0.5, I: %s}\n"
STOPS = (
    LINKS
    + "- {name: a, m: 1.2, l: 0.6, r: 0.3, I: 0.04, limits: {min: -40deg, restitution: 0.5}}\n"
    "- {name: b, m: 0.7, l: 0.5, r: 0.22, I: 0.02,"
    " limits: {min: -50deg, stiffness: 40, damping: 2}}\n"
)
SPRING = "springs: [{between: [a, [0, 1]], table: f3.csv, length: 1.2}]\n"
KNOWN = [  # scene, options, and the last row's derivatives, to 6 digits or so
    (MOTOR % "torque_constant: 0.05, resistance: 2",
     '--q 0 --volt 12*sin(5*t) --time 0.5 --method taylor',
     {"links.w.motor.resistance": [-0.54708, 1.46204],
      "links.w.motor.torque_constant": [-51.100, -267.045],
      "links.w.motor.ratio": [-0.13978, -0.64545]}),
    (ARM % 0.05 + SPRING, "--q 60deg --time 3 --method taylor",
     {"links.a.m": [1.41003, -10.29207]}),
    (STOPS, "--q 0,0 --qd 0,2.5 --time 0.7267 --rtol 1e-12 --atol 1e-12",
     {"links.b.m": [0.00215, 0.27950, -6.49514, 14.63354]}),
    (MOTOR % "torque_max: 0.04", "--q 0 --control pd --kp 20 --kd 1 --hold 1 --time 0.3",
     {"links.w.motor.torque_max": [44.354, 257.175], "links.w.motor.ratio": [0.09687, 0.55782]}),
    (ARM % "0.1, friction: {torque: 0.3, speed: 0.02}", "--q 0 --time 2.5 --method taylor",
     {"links.a.m": [-1.23854, 0.19840]}),
    (ARM % 0.1, "--q 0 --time 0.2", {"links.a.damping": [0.053130, 0.791823]}),
]  # fmt: skip


@pytest.mark.parametrize(("text", "options", "known"), KNOWN)
def test_what_depends_on_motors_tables_friction_and_impacts(
    text: str, options: str, known: dict, scene: Scene, robodyn: Callable[..., Outcome]
) -> None:
    path = scene(text)
    path.with_name("f3.csv").write_text("x,F\n-3,0\n0,0\n3,60\n")
    told = robodyn(
        "simulate",
        path,
        *options.split(),
        "--points",
        2,
        "--quiet",
        "--sensitivity",
        ",".join(known),
    )
    assert (told.code, told.err) == (0, "")
    for name, values in known.items():
        columns = [x for x in told.out.splitlines()[0].split(",") if x.endswith("/" + name)]
        found = [told.column(x)[-1] for x in columns]
        assert found == pytest.approx(values, rel=1e-4, abs=1e-5), name


class Law:
    """A controller that keeps to a pose, of any mechanism with the numbers of one file."""

    def __init__(self, path: Path, pose: Sequence[float], control: str, **given: object) -> None:
        self.reference = rd.ReferenceTable.set_point(pose, 2.0)
        self.believed = rd.load(path) if control in ("pd+g", "computed-torque") else None
        self.control, self.given = control, given

    def __call__(self, mech: rd.Mechanism) -> object:
        given = {"control_model": self.believed, **self.given}
        return rd.controller(mech, self.reference, self.control, **given)


def differences(path: Path, name: str, driven, rates, tau: object, t: list[float]) -> np.ndarray:
    """d(q, qd)/d(name) (T, 2n) of the motion that actuated joints at `driven`, `rates` begin."""
    values, own = read_numbers(path.read_text(), str(path)), rd.load(path)

    def motion(change: float) -> np.ndarray:
        mech, start = own, [np.array(driven, float), np.array(rates, float)]
        if match := re.fullmatch(r"(qd?)(\d)", name):
            start[match[1] == "qd"][int(match[2]) - 1] += change
        else:
            mech = build(values.replaced({name: values.number(name) + change}))
        q = rd.assemble(mech, start[0])
        qd = rd.loop_velocities(mech, q, start[1]) if mech.rows else start[1]
        torques = tau(mech) if isinstance(tau, Law) else tau
        run = rd.simulate(mech, q, qd, t[-1], torques, t_eval=t, **TIGHT)
        return np.hstack([run.q, run.qd])

    h = 1e-4  # what is left: h^2 f'''/6, and the runs' own 1e-12 / h
    far, near = motion(h) - motion(-h), motion(0.5 * h) - motion(-0.5 * h)
    return (8.0 * near - far) / (6.0 * h)


def check(
    path: Path, names: Sequence[str], driven, rates, tau=None, end=0.7, methods=METHODS[:1]
) -> None:
    """Of each method against differences of two steps."""
    mech, t = rd.load(path), [0.0, 0.4 * end, end]
    q = rd.assemble(mech, driven)
    start = q, rd.loop_velocities(mech, q, rates) if mech.rows else rates
    expected = np.stack([differences(path, x, driven, rates, tau, t) for x in names], -1)
    size = np.abs(expected).max(axis=(0, 1)) + 1e-9
    for method in methods:
        torques = tau(mech) if isinstance(tau, Law) else tau
        given = {"method": method, "t_eval": t, **TIGHT}
        run = rd.simulate(mech, *start, end, torques, sensitivity=names, **given)
        plain = rd.simulate(mech, *start, end, torques, **given)
        assert run.sensitivity.shape == (3, 2 * mech.n, len(names))
        assert (np.abs(run.sensitivity - expected) < 1e-6 * size).all()
        assert (run.q == plain.q).all()
        assert (run.qd == plain.qd).all()
        assert all(0.0 <= error < 1e-5 for error in run.report.sensitivity_errors.values())


@pytest.mark.parametrize("tau", [None, "2*sin(3*t)", "0.2*cos(q1)*t - 0.01*qd1**3", [0.3]])
def test_a_pendulum_under_torques(tau: object) -> None:
    names = ["links.rod.m", "links.rod.r", "q1"]
    check(ROOT / "robots/pendulum.yaml", names, [0.4], [0.7], tau)


def test_a_function_of_python() -> None:
    path, names = ROOT / "robots/2r.yaml", ["q1", "links.forearm.m"]
    check(path, names, [0.5, 0.8], [0.3, -0.4], lambda t, q, qd: [math.sin(q[0]), -0.1 * qd[1]])


def test_a_2r() -> None:
    names = ["links.forearm.m", "links.upper arm.l", "gravity", "q1", "qd2"]
    check(ROOT / "robots/2r.yaml", names, [0.5, 0.8], [0.3, -0.4], methods=METHODS)


def test_loops() -> None:
    names = ["q1", "qd1", "links.coupler.m", "links.rocker.from[0]", "links.coupler.damping"]
    check(ROOT / "robots/four-bar.yaml", names[:4], [1.0], [2.0], "sin(2*t) - 0.3*qd1")
    check(ROOT / "robots/slider-crank.yaml", ["q1", "links[1].l"], [0.8], [1.5])
    check(ROOT / "robots/geared-five-bar.yaml", ["q1", "links[1].l"], [0.8], [0.5])


BOOM = """
gravity: 9.81
links:
  - {name: arm, m: 1.5, l: 0.3, r: 0.2, I: 0.05, friction: {torque: 0.5, speed: 0.2}}
  - {name: boom, joint: prismatic, axis: [3, 0.5], m: 0.9, l: 0.5, r: [0.2, 0.1], I: 0.03,
     damping: 3}
springs:
  - {joint: boom, stiffness: 90, length: 0.1}
  - {between: [{link: boom, at: [0.5, 0]}, [1, 1]], stiffness: 40, length: 0.3, damping: 2}
"""


def test_directions_and_angles_that_are_kept(scene: Scene) -> None:
    names = ["closures[0].aligned", "closures[0].on.along[1]", "closures[0].on.through[1]"]
    check(scene(BLOCK), names, [0.4], [3.0])
    names = ["links.boom.axis[0]", "springs[1].length", "links.arm.friction.torque", "qd2"]
    check(scene(BOOM), names, [0.3, 0.1], [1.0, 0.2])


def test_torques_that_bend_and_jump() -> None:
    """At times that are told, and where an expression of time or of the state switches."""
    path, start = ROOT / "robots/2r.yaml", ([0.5, 0.8], [0.3, -0.4])
    check(path, ["links.forearm.m", "q1"], *start, "2 if t < 0.31 else -1, 0.5*q1*(t > 0.5)")
    mech = rd.load(path)
    table = torque_table(mech, [0.0, 0.25, 0.7], [[1.0, 0.0], [-2.0, 1.0], [3.0, 0.5]])
    check(path, ["qd2"], *start, table)


def test_a_torque_that_switches_by_the_state(scene: Scene) -> None:
    """A mass under 1 N up to q = 0.3 m, then under -1 N: at a row beside the switch, too."""
    path = scene(SLIDE.replace("AXIS", "[1, 0]").replace("END", "damping: 0"))

    def mass(t, v, m):
        switch = (-v + mp.sqrt(v * v + mpf("0.6") / m)) * m  # 0.3 = v s + s^2/2m
        w = v + switch / m
        return [0.3 + w * (t - switch) - (t - switch) ** 2 / (2 * m), w - (t - switch) / m]

    given = mpf("0.4"), mpf(2)
    at = float((-given[0] + mp.sqrt(given[0] ** 2 + mpf("0.3"))) * 2)
    t = [0.0, at + 1e-4, 1.5]
    run = rd.simulate(
        rd.load(path), [0], [0.4], 1.5, "1 if q1 < 0.3 else -1", t_eval=t,
        sensitivity=["qd1", "links.a.m"], **TIGHT,
    )  # fmt: skip
    for k in (1, 2):
        exact = slopes_by_digits(partial(mass, mpf(t[k])), given)
        assert np.abs(run.sensitivity[k] - exact).max() < 3e-6 * np.abs(exact).max()


GAIN = StateFeedback((0, 1), [0.3, 0.6], [1.0, 0.5], [[40.0, 3, 8, 1], [2, 30, 1, 5]])
PD = {"kp": [40, 20], "kd": [8, 4]}


@pytest.mark.parametrize(
    ("control", "given"),
    [
        ("pd", {**PD, "tau_max": [9.0, 2.5]}),
        ("pid", {**PD, "ki": [60, 30], "tau_max": [9.0, 2.5]}),
        ("pid", {**PD, "ki": [60, 30], "control_rate": 50}),
        ("pd+g", PD),
        ("computed-torque", {"kp": 40, "kd": 8, "control_rate": 50}),
        ("state-feedback", {"gain": GAIN}),
    ],
)
def test_controllers(control: str, given: dict) -> None:
    """Where a torque is cut off, and where it is held between samples, too."""
    path = ROOT / "robots/2r.yaml"
    law = Law(path, [0.3, 0.6], control, **given)
    check(path, ["links.forearm.m", "q1"], [0.5, 0.8], [0.3, -0.4], law)


def test_a_controlled_loop() -> None:
    path = ROOT / "robots/four-bar.yaml"
    for control in ("pd+g", "computed-torque"):
        law = Law(path, [1.4], control, kp=60, kd=9)
        check(path, ["links.coupler.m", "q1"], [1.0], [2.0], law, 0.3)


ENDS = """
gravity: 9.81
links:
  - {name: arm, m: 1.5, l: 0.3, r: 0.2, I: 0.05,
     limits: {min: -0.5, max: 2, stiffness: 300, damping: 2}}
  - {name: rod, m: 0.9, l: 0.5, r: [0.2, 0.1], I: 0.03}
"""
STICKS = ENDS.replace(
    "limits: {min: -0.5, max: 2, stiffness: 300, damping: 2}",
    "friction: {torque: 4.5, static: 4.5}",
)


LOW = [-0.3, 0.1], [-1.0, 0.2]  # the arm comes to its end soon


def test_ends_and_dry_friction(scene: Scene) -> None:
    limits = [f"links.arm.limits.{x}" for x in ("min", "stiffness", "damping")]
    check(scene(ENDS), limits, *LOW, end=0.3)
    check(scene(STICKS), ["q1", "links.rod.m"], [0.6, 0.1], [3.0, 0.2], end=0.5)
    for e in (0.6, 0.0):  # thrown back, or at rest
        text = ENDS.replace("stiffness: 300, damping: 2", f"restitution: {e}")
        check(scene(text), ["q1", "links.arm.limits.min"], *LOW, end=0.3, methods=METHODS)


def test_friction_that_falls_as_a_joint_starts(scene: Scene) -> None:
    """By the numbers of dry friction themselves: a release whose time depends on them."""
    names = ["links.arm.friction.torque", "links.arm.friction.static"]
    falls = STICKS.replace("static: 4.5", "static: 4.8")
    check(scene(falls), names, [0.6, 0.1], [3.0, 0.2], "2*sin(9*t) + 0.1*q2, 0", 0.5)


BLOCKS = """
gravity: 0
links:
  - {name: a, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0, END}
  - {name: b, joint: prismatic, axis: [0, 1], m: 2, l: 0, r: 0, I: 0, END, from: [0, 0]}
"""
COUPLED = """
gravity: 0
links:
  - {name: a, m: 1, l: 0.4, r: 0.2, I: 0.05, limits: {max: 0.3, restitution: 0}}
  - {name: b, m: 1, l: 0.4, r: 0.2, I: 0.05, limits: {max: 0.3, restitution: 0.5}}
"""


def test_several_joints_stop_at_once(scene: Scene) -> None:
    """Their sensitivities are those of each alone."""
    for end, m, rates, tau, names in (
        ("limits: {max: 0.3, restitution: 0.6}", 2, [1.0, 1.0], "-0.2, -0.4", ["q1", "q2"]),
        ("friction: {force: 1, static: 1.5}", 1, [0.4, 0.4], None, ["q1", "links.b.m"]),
    ):
        path = scene(BLOCKS.replace("END", end).replace("m: 2", f"m: {m}"))
        check(path, names, [0.0, 0.0], rates, tau)
    check(scene(COUPLED), ["q2"], [0.0, -0.2], [2.0, 1.0], "3, 1")


def test_coupled_joints_that_a_number_moves_apart_have_none(scene: Scene) -> None:
    """Both meet their ends at 0.3 s; which is first decides what follows, b riding on a."""
    text = BLOCKS.replace(", from: [0, 0]", "").replace("[0, 1]", "[1, 1]")
    mech = rd.load(scene(text.replace("END", "limits: {max: 0.3, restitution: 0.6}")))
    t = [0.0, 0.2, 0.5]
    for name in ("q2", "links.a.limits.max"):
        run = rd.simulate(mech, [0, 0], [1, 1], 0.5, t_eval=t, sensitivity=[name])
        assert np.isfinite(run.sensitivity[:2]).all()
        assert np.isnan(run.sensitivity[2]).all()
        (line,) = run.report.remarks
        assert line.startswith(f"columns dq1/{name}.. are empty from t = 0.5 s on")
    run = rd.simulate(mech, [0, 0], [1, 1], 0.5, t_eval=t, sensitivity=["links.b.m"])
    assert np.isfinite(run.sensitivity).all()
    first, second = (rd.simulate(mech, [0, x], [1, 1], 0.5).q[-1] for x in (-1e-7, 1e-7))
    assert np.abs(first - second).max() > 0.1


def test_a_start_on_an_end_moves_to_one_side(scene: Scene) -> None:
    """By q1 upwards alone; by the rate of a joint that friction holds not at all."""
    text = ENDS.replace("stiffness: 300, damping: 2", "restitution: 0.6")
    run = rd.simulate(
        rd.load(scene(text)),
        [-0.5, 0.1],
        [1.0, 0.2],
        0.1,
        t_eval=[0, 0.1],
        sensitivity=["q1"],
        **TIGHT,
    )
    ahead = [
        rd.simulate(rd.load(scene(text)), [-0.5 + h, 0.1], [1, 0.2], 0.1, t_eval=[0, 0.1], **TIGHT)
        for h in (0.0, 2e-5, 4e-5)
    ]
    y = [np.hstack([x.q, x.qd])[1] for x in ahead]
    expected = (4.0 * y[1] - 3.0 * y[0] - y[2]) / 4e-5
    assert relative_error(run.sensitivity[1, :, 0], expected) < 1e-6
    path = scene(STICKS.replace("torque: 4.5, static: 4.5", "torque: 12, static: 13"))
    run = rd.simulate(
        rd.load(path), [-0.5, 0.1], [0, 0.2], 0.1, t_eval=[0, 0.1], sensitivity=["qd1"]
    )
    assert np.isnan(run.sensitivity[1]).all()
    (line,) = run.report.remarks
    assert line == "columns dq1/qd1.. are empty from t = 0.1 s on: the runs differ in their events"


def test_a_motion_that_forgets_its_start(robodyn: Callable[..., Outcome]) -> None:
    """Cells are right as long as they are written; from 20 s or so on they are empty."""
    run = "simulate", "2r", "--q", "0,0", "--time", 30, "--points", 61, "--sensitivity", "q1"
    told = [robodyn(*run, "--method", method, "--quiet") for method in METHODS]
    ends = []
    for one in told:
        match = re.fullmatch(
            r"columns dq1/q1\.\. are empty from t = (\S+) s on: differences do not settle\n",
            one.err,
        )
        assert one.code == 0
        assert match, one.err
        ends.append(2 * round(float(match[1])))
        rows = one.out.splitlines()[1:]
        for k, row in enumerate(rows):
            assert row.endswith(",,,,") == (k >= round(2 * float(match[1])))
    assert min(ends) > 30
    first, second = ([row.split(",")[-4:] for row in x.out.splitlines()[1:31]] for x in told)
    a, b = np.array(first, float), np.array(second, float)
    assert (np.abs(a - b).max(axis=1) < 1e-3 * np.maximum.accumulate(np.abs(a).max(axis=1))).all()


def test_backwards_events_and_rows_in_steps() -> None:
    mech, names = rd.load(ROOT / "robots/four-bar.yaml"), ["q1", "links.coupler.m"]
    q = rd.assemble(mech, [1.0])
    start = q, rd.loop_velocities(mech, q, [2.0])
    runs = [
        rd.simulate(mech, *start, -0.5, method=method, t_eval=[0.0, -0.2, -0.5], sensitivity=names)
        for method in METHODS
    ]
    assert relative_error(runs[1].sensitivity, runs[0].sensitivity) < 1e-9
    ended = rd.simulate(mech, *start, 2.0, until="qd1 < 1", sensitivity=names)
    assert ended.sensitivity.shape == (len(ended.t), 2 * mech.n, 2)
    assert np.isfinite(ended.sensitivity).all()
    h = 1e-5
    for name, slope in ended.report.until_sensitivity.items():
        ends = []
        for change in (h, -h):
            values = read_numbers((ROOT / "robots/four-bar.yaml").read_text(), "four-bar")
            moved = mech
            if name != "q1":
                moved = build(values.replaced({name: values.number(name) + change}))
            q = rd.assemble(moved, [1.0 + change * (name == "q1")])
            qd = rd.loop_velocities(moved, q, [2.0])
            ends.append(rd.simulate(moved, q, qd, 2.0, until="qd1 < 1", **TIGHT).t[-1])
        assert slope == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-5)


def test_the_time_of_until_in_the_summary(robodyn: Callable[..., Outcome], tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    run = robodyn(
        "simulate", "2r", "--q", "0,0", "--until", "q1 < -1", "--points", 2, "--report", file,
        "--sensitivity", "links.forearm.m",
    )  # fmt: skip
    last = [float(x) for x in run.out.splitlines()[-1].split(",")[-4:]]
    assert last == pytest.approx([0.18060, -0.42743, 1.56629, -3.95719], rel=1e-4)
    assert "derivative of the time of --until by links.forearm.m: 0.0465393" in run.err
    assert "error of derivatives by links.forearm.m: about " in run.err
    report = json.loads(file.read_text())
    assert report["until_sensitivity"]["links.forearm.m"] == pytest.approx(0.0465393, rel=1e-5)
    assert 0.0 < report["sensitivity_errors"]["links.forearm.m"] < 1e-8


def test_forces_of_the_command_line(robodyn: Callable[..., Outcome], scene: Scene) -> None:
    """As those of the scene; at a tip they move with the length."""
    text = ARM % 0.1
    run = ["--q", 0, "--time", 0.5, "--points", 2, "--quiet"]
    run += ["--sensitivity", "links.a.m,links.a.l"]
    given = robodyn("simulate", scene(text), "--force", "a=3,-4", *run)
    written = robodyn(
        "simulate", scene(text + "loads: [{link: a, at: [1, 0], force: [3, -4]}]"), *run
    )
    own, other = (x.out.splitlines()[-1].split(",") for x in (given, written))
    assert own[-4:-2] == other[-4:-2]
    assert own[-2:] != other[-2:]  # where the load stays where it is


def test_singular_configurations_and_change_points() -> None:
    """A parallelogram is led across its change point: its runs are, too."""
    mech = rd.load(ROOT / "robots/parallelogram.yaml")
    q = rd.assemble(mech, [0.7])
    qd = rd.loop_velocities(mech, q, [0.5])
    run = rd.simulate(mech, q, qd, 0.5, t_eval=[0.0, 0.25, 0.5], sensitivity=["q1"])
    assert np.isfinite(run.sensitivity[1]).all()


def test_a_mass_on_a_spring(scene: Scene) -> None:
    """x = a cos(w t), w^2 = k/m."""
    k, m, a = 50.0, 2.0, 0.1
    path = scene(
        f"gravity: 0\nlinks:\n  - {{name: cart, joint: prismatic, axis: [1, 0], m: {m}, l: 0.1,"
        f" r: 0, I: 1}}\nsprings:\n  - {{joint: cart, stiffness: {k}, length: 0}}\n"
    )
    t = np.linspace(0.0, 5.0, 26)
    names = ["springs[0].stiffness", "links.cart.m", "q1"]
    run = rd.simulate(rd.load(path), [a], [0.0], 5.0, t_eval=t, sensitivity=names)
    w = np.sqrt(k / m)
    by_w = np.stack([-a * t * np.sin(w * t), -a * np.sin(w * t) - a * w * t * np.cos(w * t)], 1)
    by_a = np.stack([np.cos(w * t), -w * np.sin(w * t)], 1)
    expected = np.stack([by_w * 0.5 / np.sqrt(k * m), by_w * -0.5 * w / m, by_a], -1)
    found = run.sensitivity
    assert found is not None
    size = np.abs(expected).max(axis=(0, 1))
    assert (np.abs(found - expected).max(axis=(0, 1)) < 1e-7 * size).all()


SLIDE = """
gravity: 9.81
links:
  - {name: a, joint: prismatic, axis: AXIS, m: 2, l: 0, r: 0, I: 0, END}
"""


def slopes_by_digits(found: Callable, given: Sequence[mpf]) -> np.ndarray:
    """d(each of two that are found)/d(each that is given), (2, k)."""
    places = [tuple(row) for row in np.eye(len(given), dtype=int)]
    by = [[mp.diff(lambda *x, j=j: found(*x)[j], given, at) for at in places] for j in (0, 1)]
    return np.array(by, float)


def test_a_ball_that_bounces_in_closed_form(scene: Scene) -> None:
    """By where and how fast it starts, g, what its floor gives back, where that is, and mass."""

    def ball(t, start, rate, g, e, floor, m):
        """It leaves its floor at e^k w for the k-th time."""
        w = mp.sqrt(rate**2 + 2 * g * (start - floor))
        at, up = (w + rate) / g, e * w
        while at + 2 * up / g < t:
            at, up = at + 2 * up / g, e * up
        t -= at
        return [floor + up * t - g * t**2 / 2, up - g * t]

    end = "limits: {min: 0.1, restitution: 0.75}"
    path = scene(SLIDE.replace("AXIS", "[0, 1]").replace("END", end))
    names = ["q1", "qd1", "gravity", "links.a.limits.restitution", "links.a.limits.min"]
    for start in ("0.6", "0.1"):  # the second is on the floor
        given = [mpf(x) for x in (start, "-1.5", "9.81", "0.75", "0.1", "2")]
        for method in ("DOP853", "taylor"):
            run = {"method": method, "sensitivity": [*names, "links.a.m"], **TIGHT}
            t, mech = [0.0, 0.3, 0.75], rd.load(path)
            motion = rd.simulate(mech, [float(start)], [-1.5], 0.75, t_eval=t, **run)
            assert len(motion.events) >= 2
            for k in (1, 2):
                exact = slopes_by_digits(partial(ball, mpf(str(t[k]))), given)
                assert relative_error(motion.sensitivity[k], exact) < 1e-8


def test_a_block_that_stops_and_starts_in_closed_form(scene: Scene) -> None:
    """By its rate, its mass and both numbers of its friction, under a force that grows, 4t."""

    def block(v, m, friction, static):
        """v - (friction t - 2 t^2)/m is zero first; it starts at 4t = static; where at 1.2 s?"""
        stop, go, t = (friction - mp.sqrt(friction**2 - 8 * m * v)) / 4, static / 4, mpf("1.2")
        x = v * stop - (friction * stop**2 / 2 - 2 * stop**3 / 3) / m
        x += (2 * (t**3 - go**3) / 3 - 2 * go**2 * (t - go) - friction * (t - go) ** 2 / 2) / m
        return [x, (2 * (t**2 - go**2) - friction * (t - go)) / m]

    end = "friction: {force: 3, static: 3.5}"
    path = scene(SLIDE.replace("AXIS", "[1, 0]").replace("END", end))
    names = ["qd1", "links.a.m", "links.a.friction.force", "links.a.friction.static"]
    exact = slopes_by_digits(block, [mpf(x) for x in ("0.4", "2", "3", "3.5")])
    for method in ("DOP853", "taylor"):
        run = {"method": method, "sensitivity": names, "t_eval": [0.0, 1.2], **TIGHT}
        motion = rd.simulate(rd.load(path), [0.0], [0.4], 1.2, "4*t", **run)
        assert [x.name for x in motion.events] == ["a stops", "a starts"]
        assert relative_error(motion.sensitivity[-1], exact) < 1e-9


def test_the_columns_and_a_run_that_stays_as_it_is(robodyn: Callable[..., Outcome]) -> None:
    run = ("simulate", "robots/2r.yaml", "--q", "0.5,0.8", "--time", "1", "--every", "0.5")
    plain = robodyn(*run)
    given = robodyn(*run, "--sensitivity", "links.forearm.m, q1")
    assert given.code == 0
    header = given.out.splitlines()[0].split(",")
    names = ["dq1", "dq2", "dqd1", "dqd2"]
    assert header[-8:] == [f"{x}/{by}" for by in ("links.forearm.m", "q1") for x in names]
    for name in header[:-8]:
        assert given.column(name) == plain.column(name)
    assert given.column("dq1/q1")[0] == pytest.approx(1.0, rel=1e-12)
    assert given.column("dq1/links.forearm.m")[0] == 0.0
    mech = rd.load(ROOT / "robots/2r.yaml")
    motion = rd.simulate(
        mech, [0.5, 0.8], [0, 0], 1.0, t_eval=[0, 0.5, 1], sensitivity=["links.forearm.m", "q1"]
    )
    assert motion.sensitivity is not None
    assert np.array_equal(motion.sensitivity[:, 2, 1], given.column("dqd1/q1"))


def two_links(q1, q2, w1, w2, m1, r1, i1, l1, m2, r2, i2, g):
    """The accelerations of robots/2r.yaml by its textbook equations."""
    c, s = mp.cos(q2), m2 * l1 * r2 * mp.sin(q2)
    a = i1 + m1 * r1**2 + i2 + m2 * (l1**2 + r2**2 + 2 * l1 * r2 * c)
    b, d = i2 + m2 * (r2**2 + l1 * r2 * c), i2 + m2 * r2**2
    g2 = m2 * r2 * g * mp.cos(q1 + q2)
    x = s * (2 * w1 * w2 + w2**2) - (m1 * r1 + m2 * l1) * g * mp.cos(q1) - g2
    y = -s * w1**2 - g2
    return [(d * x - b * y) / (a * d - b * b), (a * y - b * x) / (a * d - b * b)]


def yoke(q, w, m, r, i, l, mass, damping, g):
    """The acceleration of the crank of robots/scotch-yoke.yaml; the yoke is at l cos(q)."""
    s, c = l * mp.sin(q), l * mp.cos(q)
    force = mass * s * c * w**2 + damping * s**2 * w + m * g * r * mp.cos(q)
    return [-force / (i + m * r**2 + mass * s**2)]


SOON = 0.3


@lru_cache
def exact_slopes(rates, state, numbers, places, steps=20):
    """d(state at the end)/d(each place) (N, k), and the end, by equal steps of order 8."""
    weights = [[x for x in row[:i] if i] for i, row in enumerate(DOP853.A)]

    def end(place, change):
        values = [mpf(str(x)) for x in (*state, *numbers)]
        values[place] += change
        y, given, h = values[: len(state)], values[len(state) :], mpf(str(SOON)) / steps
        half = len(state) // 2

        def f(y):
            return [*y[half:], *rates(*y, *given)]

        for _ in range(steps):
            k: list = []
            for row in [*weights, DOP853.B]:
                at = [
                    x + h * sum(c * z[i] for c, z in zip(row, k, strict=True) if c)
                    for i, x in enumerate(y)
                ]
                k.append(f(at))
            y = at
        return [*y, *given]

    with mp.workdps(30):
        h = mpf("1e-10")
        both = [(end(i, h), end(i, -h)) for i in places]
        found = [[(a - b) / (2 * h) for a, b in zip(*x, strict=True)] for x in both]
        return np.array(found, float).T[: len(state)], end(0, 0)


@pytest.mark.parametrize("method", METHODS)
def test_an_open_and_a_closed_scene_against_many_digits(method: str) -> None:
    given = {"method": method, **TIGHT, "t_eval": [0.0, SOON]}
    numbers = 1.5, 0.36, 0.082, 0.8, 0.9, 0.25, 0.031, 9.81
    expected, _ = exact_slopes(two_links, (0.5, 0.8, 0.3, -0.4), numbers, (0, 7, 8))
    names = ["q1", "links.upper arm.l", "links.forearm.m"]
    mech = rd.load(ROOT / "robots/2r.yaml")
    run = rd.simulate(mech, [0.5, 0.8], [0.3, -0.4], SOON, sensitivity=names, **given)
    assert run.sensitivity is not None
    assert relative_error(run.sensitivity[-1], expected) < 1e-9
    numbers = 0.7, 0.04, 0.0021, 0.12, 1.9, 4, 9.81
    (dq, dw), end = exact_slopes(yoke, (0.7, 3), numbers, (0, 5, 6))
    names = ["q1", "links.crank.l", "links.yoke.m"]
    mech = rd.load(ROOT / "robots/scotch-yoke.yaml")
    q = rd.assemble(mech, [0.7])
    qd = rd.loop_velocities(mech, q, [3.0])
    run = rd.simulate(mech, q, qd, SOON, sensitivity=names, **given)
    slid = -0.12 * math.sin(end[0]) * dq + [0.0, math.cos(end[0]), 0.0]
    assert run.sensitivity is not None
    assert relative_error(run.sensitivity[-1][[0, 2, 1]], np.stack([dq, dw, slid])) < 1e-9


def test_no_names_and_what_are_none() -> None:
    mech = rd.load(ROOT / "robots/2r.yaml")
    for nothing in (None, (), []):
        assert rd.simulate(mech, [0, 0], [0, 0], 0.1, sensitivity=nothing).sensitivity is None
    wrong: list[object] = ["q1", [None], [1]]
    for names in wrong:
        with pytest.raises(InputError, match=r"sensitivity = .*: must be a list of texts"):
            rd.simulate(mech, [0, 0], [0, 0], 0.1, sensitivity=names)  # type: ignore[arg-type]


@pytest.mark.parametrize("names", ["", ",", "q1,", "q1,q1"])
def test_names_that_are_none_are_shown(robodyn: Callable[..., Outcome], names: str) -> None:
    given = robodyn("simulate", "2r", "--q", "0,0", "--time", 1, "--sensitivity", names)
    given.fails(2, f"--sensitivity = {names or repr('')}: needs names, each once")
