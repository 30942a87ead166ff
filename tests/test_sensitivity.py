"""Sensitivities of motions, against differences of two runs and against closed forms."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pytest
from conftest import FRESH, ROOT, Outcome, relative_error
from contact_scenes import FIVE_BAR, FOUR_BAR, dry
from engine_cases import KINDS, plain_scene
from mpmath import mp, mpf
from scipy.integrate import DOP853

import robodyn as rd
from robodyn.control.state_feedback import StateFeedback
from robodyn.dynamics.named_numbers import with_variable
from robodyn.engines.expression import Graph
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.actuation import table as torque_table
from robodyn.mechanics.mechanism import build
from robodyn.scene.scene_values import read_numbers

Scene = Callable[[str], Path]
TIGHT = {"rtol": 1e-12, "atol": 1e-12}
END = 0.7


def times(end: float) -> list[float]:
    return [0.0, 0.4 * end, end]


class Law:
    """A controller that keeps to a pose, of any mechanism with the numbers of one file."""

    def __init__(self, path: Path, pose: Sequence[float], control: str, **given: object) -> None:
        self.reference = rd.ReferenceTable.set_point(pose, 2.0)
        self.believed = rd.load(path) if control in ("pd+g", "computed-torque") else None
        self.control, self.given = control, given

    def __call__(self, mech: rd.Mechanism) -> object:
        given = {"control_model": self.believed, **self.given}
        return rd.controller(mech, self.reference, self.control, **given)


def differences(
    path: Path, name: str, driven, rates, tau: object, end: float, bends: bool = False
) -> np.ndarray:
    """d(q, qd)/d(name) (T, 2n) of the motion that actuated joints at `driven`, `rates` begin.

    `bends`: its second derivative jumps there.
    """
    values = read_numbers(path.read_text(), str(path))

    own = rd.load(path)

    def motion(change: float) -> np.ndarray:
        mech, start = own, [np.array(driven, float), np.array(rates, float)]
        match = re.fullmatch(r"(qd?)(\d)", name)
        if match:
            start[match[1] == "qd"][int(match[2]) - 1] += change
        else:
            mech = build(values.replaced({name: values.number(name) + change}))
        q = rd.assemble(mech, start[0])
        qd = rd.loop_velocities(mech, q, start[1]) if mech.rows else start[1]
        torques = tau(mech) if isinstance(tau, Law) else tau
        run = rd.simulate(mech, q, qd, end, torques, t_eval=times(end), **TIGHT)
        return np.hstack([run.q, run.qd])

    cut_off = isinstance(tau, Law) and "tau_max" in tau.given  # which runs pass less exactly
    h = 1e-4 if bends or cut_off else 3e-5  # what is left: h^2 f'''/6, and the runs' own 1e-12 / h
    far = motion(h) - motion(-h)
    near = motion(0.5 * h) - motion(-0.5 * h) if bends else far / 2.0  # order 1 is taken out
    return (4.0 * near - far) / (2.0 * h)


WAYS = ["DOP853", "taylor"]


def check(
    path: Path, names: Sequence[str], driven, rates, tau=None, ways=WAYS, end=END, bends=False
) -> None:
    """Of each way against differences, and against one another to the last digits but few."""
    mech = rd.load(path)
    q = rd.assemble(mech, driven)
    start = q, rd.loop_velocities(mech, q, rates) if mech.rows else rates
    given = driven, rates, tau, end, bends
    expected = np.stack([differences(path, name, *given) for name in names], -1)
    size = np.abs(expected).max(axis=(0, 1)) + 1e-9
    first = None
    tau = tau(mech) if isinstance(tau, Law) else tau
    for method in ways:
        given = {"method": method, "t_eval": times(end), **TIGHT}
        run = rd.simulate(mech, *start, end, tau, sensitivity=names, **given)
        plain = rd.simulate(mech, *start, end, tau, **given) if method == "taylor" else run
        found = run.sensitivity
        assert found is not None
        assert found.shape == (3, 2 * mech.n, len(names))
        missed = np.abs(found - expected)[bends:]  # the start itself may jump
        assert (missed < 1e-6 * size).all(), method
        if method == "taylor":  # the motion is that without them, bit for bit
            assert np.array_equal(run.q, plain.q)
            assert np.array_equal(run.qd, plain.qd)
        first = found if first is None else first
        assert (np.abs(found - first) < 1e-9 * size).all(), method


@pytest.mark.parametrize("tau", [None, "2*sin(3*t)", "0.2*cos(q1)*t - 0.01*qd1**3", [0.3]])
def test_a_pendulum_under_torques(tau: object) -> None:
    check(
        ROOT / "robots/pendulum.yaml",
        ["links.rod.m", "links.rod.r", "q1"],
        [0.4],
        [0.7],
        tau,
    )


def test_a_2r() -> None:
    names = ["links.forearm.m", "links.upper arm.l", "gravity", "q1", "qd2"]
    check(ROOT / "robots/2r.yaml", names, [0.5, 0.8], [0.3, -0.4])


def test_a_four_bar() -> None:
    names = ["q1", "qd1", "links.coupler.m", "links.rocker.l", "links.rocker.from[0]", "gravity"]
    check(ROOT / "robots/four-bar.yaml", names, [1.0], [2.0], "sin(2*t) - 0.3*qd1")


def test_a_slider_crank_and_gears() -> None:
    check(ROOT / "robots/slider-crank.yaml", ["q1", "links[1].l"], [0.8], [1.5])
    check(ROOT / "robots/geared-five-bar.yaml", ["q1", "links[1].l"], [0.8], [0.5])


BLOCK = """
gravity: 9.81
links:
  - {name: crank, m: 0.8, l: 0.1, r: 0.03, I: 0.002}
  - {name: block, m: 0.3, l: 0, r: 0.01, I: 0.0005}
  - {name: lever, m: 1.5, l: 0.5, r: 0.25, I: 0.03, from: [0, -0.25]}
closures:
  - {point: {link: block, at: [0, 0]}, on: {link: lever, through: [0, 0.01], along: [1, 0]},
     aligned: 20deg}
actuated: [crank]
"""
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
    names = ["links.boom.axis[0]", "links.boom.axis[1]", "springs[1].length", "links.arm.I"]
    check(
        scene(BOOM),
        [*names, "links.arm.friction.torque", "qd2"],
        [0.3, 0.1],
        [1.0, 0.2],
    )


def test_torques_that_bend_and_jump() -> None:
    """At times that are told, or where an expression of time switches."""
    path = ROOT / "robots/2r.yaml"
    names = ["links.forearm.m", "q1", "qd2"]
    check(
        path, names, [0.5, 0.8], [0.3, -0.4], "2 if t < 0.31 else -1, 0.5*q1*(t > 0.5)", WAYS[1:3]
    )
    mech = rd.load(path)
    table = torque_table(mech, [0.0, 0.25, 0.7], [[1.0, 0.0], [-2.0, 1.0], [3.0, 0.5]])
    check(path, names, [0.5, 0.8], [0.3, -0.4], table)


GAIN = StateFeedback((0, 1), [0.3, 0.6], [1.0, 0.5], [[40.0, 3, 8, 1], [2, 30, 1, 5]])
PD = {"kp": [40, 20], "kd": [8, 4]}


@pytest.mark.parametrize(
    ("control", "given"),
    [
        ("pd", PD),
        ("pd", {**PD, "tau_max": [9.0, 2.5]}),
        ("pd", {**PD, "control_rate": 50}),
        ("pid", {**PD, "ki": [60, 30]}),
        ("pid", {**PD, "ki": [60, 30], "tau_max": [9.0, 2.5]}),
        ("pid", {**PD, "ki": [60, 30], "control_rate": 50}),
        ("pd+g", PD),
        ("computed-torque", {"kp": 40, "kd": 8, "tau_max": 20}),
        ("computed-torque", {"kp": 40, "kd": 8, "control_rate": 50}),
        ("state-feedback", {"gain": GAIN}),
    ],
)
def test_controllers(control: str, given: dict) -> None:
    """Where a torque is cut off, and where it is held between samples, too."""
    path = ROOT / "robots/2r.yaml"
    law = Law(path, [0.3, 0.6], control, **given)
    ways = WAYS if "control_rate" in given else WAYS[:1]
    names = ["links.forearm.m", "q1", "qd2"][: 3 if FRESH else 2]
    check(path, names, [0.5, 0.8], [0.3, -0.4], law, ways)


def test_a_controlled_loop() -> None:
    path = ROOT / "robots/four-bar.yaml"
    for control in ("pd", "pd+g", "computed-torque"):
        law = Law(path, [1.4], control, kp=60, kd=9)
        check(path, ["links.coupler.m", "q1"], [1.0], [2.0], law, WAYS[:1], 0.3)


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


def test_compliant_ends_and_dry_friction(scene: Scene) -> None:
    """By modes: where their accelerations jump so do d(qd)/dp, by when that happens."""
    limits = [f"links.arm.limits.{x}" for x in ("min", "stiffness", "damping")]
    names = [*limits, "q1", "qd2", "links.rod.m"]
    check(scene(ENDS), names[: 6 if FRESH else 3], *LOW, end=0.3)
    check(scene(STICKS), ["q1", "links.rod.m"], [0.6, 0.1], [3.0, 0.2], end=0.5)


def test_hard_stops(scene: Scene) -> None:
    """The arm is thrown back, twice, or comes to rest on its end."""
    for e in (0.6, 0.0):
        given = ENDS.replace("stiffness: 300, damping: 2", f"restitution: {e}")
        names = ["q1", "links.arm.limits.min"]
        names += ["links.arm.limits.restitution"] if e else ["links.rod.m"]
        more = ["qd2", "links.rod.I"] if FRESH else []
        check(scene(given), [*names, *more], *LOW, end=0.3)


def test_friction_that_falls_as_a_joint_starts(scene: Scene) -> None:
    """By the numbers of dry friction themselves: a release whose time depends on them."""
    names = ["q1", "links.arm.friction.torque", "links.arm.friction.static"]
    falls = STICKS.replace("static: 4.5", "static: 4.8")
    given = [0.6, 0.1], [3.0, 0.2], "2*sin(9*t) + 0.1*q2, 0"
    check(scene(falls), names[0 if FRESH else 1 :], *given, end=0.5)
    bell = falls.replace("4.8}", "4.8, stribeck: 0.3}")
    names = [*names[1:], "links.arm.friction.stribeck"][0 if FRESH else 2 :]
    check(scene(bell), names, *given[:2], None, WAYS[:1], 0.5)


def test_controllers_that_meet_ends_and_friction(scene: Scene) -> None:
    """2R, at rigid and compliant ends and with friction, by laws that go on or are sampled."""
    names = ["links.arm.limits.min", "q1"][: 2 if FRESH else 1]
    gains = {"kp": [40, 20], "kd": [3, 1]}
    law = {"ki": [60, 30], "control_rate": 100}
    for end, control, given, pose in (
        ("restitution: 0", "pd", {}, -0.6),
        ("restitution: 0", "pid", law, -0.4),
        ("stiffness: 300, damping: 2", "pd+g", {}, -0.9),
    ):
        path = scene(ENDS.replace("stiffness: 300, damping: 2", end))
        tau = Law(path, [pose, 0.6], control, **gains, **given)
        check(path, names, *LOW, tau, WAYS[:3:2] if given else WAYS[:1], 0.15)
    path = scene(STICKS.replace("static: 4.5", "static: 4.8"))
    tau = Law(path, [1.2, 0.6], "pid", ki=[60, 30], **gains)
    names = ["links.arm.friction.static", "qd2"][: 2 if FRESH else 1]
    given = names, [0.6, 0.1], [3.0, 0.2], tau, WAYS[:1], 0.5
    check(path, *given)


def test_a_joint_that_bounces_until_friction_holds_it(scene: Scene) -> None:
    """It comes to rest on its end: that it meets it there, and stops, is one order."""
    end = "limits: {min: -0.5, max: 2, restitution: 0.3}, friction: {torque: 0.5, static: 0.6}"
    path = scene(ENDS.replace("limits: {min: -0.5, max: 2, stiffness: 300, damping: 2}", end))
    mech, law = rd.load(path), Law(path, [-0.7, 0.3], "pd", kp=[40, 20], kd=[4, 2])

    def run(q: float, names: Sequence[str] = ()) -> rd.Motion:
        given = {"rtol": 1e-10, "atol": 1e-10, "t_eval": [0.0, 0.2], "sensitivity": names}
        return rd.simulate(mech, [q, LOW[0][1]], LOW[1], 0.2, law(mech), **given)

    found = run(LOW[0][0], ["q1"])
    h = 1e-4
    ahead, behind = (np.hstack([x.q, x.qd]) for x in (run(LOW[0][0] + h), run(LOW[0][0] - h)))
    expected = (ahead - behind)[1] / (2.0 * h)
    assert found.sensitivity is not None
    assert sum(event.name == "arm hits its min" for event in found.events) > 3
    assert np.abs(found.sensitivity[1, :, 0] - expected).max() < 1e-6 * np.abs(expected).max()


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
    """Each is told, and its sensitivities are those of each alone."""
    for end, m, rates, tau, names, what in (
        ("limits: {max: 0.3, restitution: 0.6}", 2, [1.0, 1.0], "-0.2, -0.4",
         ["q1", "q2", "links.b.m", "links.a.limits.max"], "hits its max"),
        ("friction: {force: 1, static: 1.5}", 1, [0.4, 0.4], None,
         ["q1", "qd2", "links.b.m", "links.a.friction.force"], "stops"),
    ):  # fmt: skip
        path = scene(BLOCKS.replace("END", end).replace("m: 2", f"m: {m}"))
        check(path, names, [0.0, 0.0], rates, tau, WAYS[:3] if m == 2 else WAYS[:2])
        for method in ("DOP853", "taylor"):
            run = rd.simulate(rd.load(path), [0, 0], rates, 0.5, tau, method=method)
            assert sorted(x.name for x in run.events) == [f"a {what}", f"b {what}"]
            assert np.ptp([x.t for x in run.events]) < 1e-9
    given = ["q2", "links.b.m"], [0.0, -0.2], [2.0, 1.0], "3, 1", WAYS[:3]
    check(scene(COUPLED), *given)  # the second hits as the first rests on its end


def test_closures_that_depend_on_one_another_are_refused() -> None:
    """On the branch of a parallelogram with a third crank, where other branches have full rank."""
    mech, ways = (
        rd.load(ROOT / "tests/hard_cases/third-crank.yaml"),
        np.array([1.0, -1.0, 1.0, 1.0]),
    )
    with pytest.raises(rd.InputError, match="closures that depend on one another"):
        rd.simulate(mech, ways, ways, 0.1, sensitivity=["q1"])


def test_coupled_joints_that_a_number_moves_apart_are_refused(scene: Scene) -> None:
    """Both meet their ends at 0.3 s; which is first decides what follows, b riding on a."""
    text = BLOCKS.replace(", from: [0, 0]", "").replace("[0, 1]", "[1, 1]")
    mech = rd.load(scene(text.replace("END", "limits: {max: 0.3, restitution: 0.6}")))
    for method in ("DOP853", "taylor"):
        for name in ("q2", "links.a.limits.max"):
            with pytest.raises(RobodynError, match=r"t = 0\.3 s.* the order: it has no derivative"):
                rd.simulate(mech, [0, 0], [1, 1], 0.5, method=method, sensitivity=[name])
        rd.simulate(mech, [0, 0], [1, 1], 0.5, method=method, sensitivity=["links.b.m"])
    first, second = (rd.simulate(mech, [0, x], [1, 1], 0.5).q[-1] for x in (-1e-7, 1e-7))
    assert np.abs(first - second).max() > 0.1


def test_several_tied_joints_of_loops_stop_and_start(scene: Scene) -> None:
    """What holds them is shared: all of one four-bar, or a five-bar's one after the other."""
    text = FOUR_BAR.format(**{x: dry(2, 3) for x in ("crank", "coupler", "rocker")})
    names = ["q1", "links.rocker.friction.static"]
    check(scene(text), names, [1.0], [0.3], "12-60*t", WAYS[: 2 if FRESH else 1], 0.25)
    if FRESH:
        text = FIVE_BAR.format(each=dry(1, 1.5)).replace("gravity: 9.81", "gravity: 0")
        names = ["q1", "links.d.friction.static", "links.b.friction.torque"]
        check(scene(text), names, [2.0, 1.0], [0.5, 0.3], "-30*t, 30*t", WAYS[:2], 0.3)


def test_starts_on_an_end_and_of_joints_that_are_held(scene: Scene) -> None:
    """An impact at the start; a joint at rest on its end or by friction loses its rate at once."""
    for held, rate, names, refused in (
        ("limits: {min: -0.5, restitution: 0.6}", -1.0, ["qd1", "q2"], {}),
        ("limits: {min: -0.5, restitution: 0.3}", 0.0, ["qd1"], {"q1": "arm rests on its end"}),
        ("limits: {min: -0.5, restitution: 1}", 0.0, [], {"qd1": "that takes no energy"}),
        ("friction: {torque: 12, static: 13}", 0.0, ["qd1", "q1"], {}),
        ("friction: {torque: 1, static: 2}", 0.0, [], {"qd1": "arm starts from rest"}),
    ):
        path = scene(ENDS.replace("limits: {min: -0.5, max: 2, stiffness: 300, damping: 2}", held))
        if names:
            check(path, names, [-0.5, 0.1], [rate, 0.2], None, WAYS[:2], 0.1, bends=True)
        for name, why in refused.items():
            for method in ("DOP853", "taylor"):
                given = {"method": method, "sensitivity": [name]}
                with pytest.raises(InputError, match=f"{name}: joint .*{why}.*no derivative"):
                    rd.simulate(rd.load(path), [-0.5, 0.1], [rate, 0.2], 0.2, **given)


def test_backwards_events_and_rows_in_steps() -> None:
    mech, names = rd.load(ROOT / "robots/four-bar.yaml"), ["q1", "links.coupler.m"]
    q = rd.assemble(mech, [1.0])
    start = q, rd.loop_velocities(mech, q, [2.0])
    t = np.linspace(0.0, -0.5, 301)
    given = {"rtol": 1e-11, "atol": 1e-11, "sensitivity": names}
    runs = [
        rd.simulate(mech, *start, -0.5, None, method=method, t_eval=t, **given) for method in WAYS
    ]
    for run in runs[1:]:
        assert relative_error(run.sensitivity, runs[0].sensitivity) < 1e-8
    ended = [
        rd.simulate(mech, *start, 2.0, method=method, until="qd1 < 1", **given) for method in WAYS
    ]
    for run in ended[1:]:
        assert run.sensitivity is not None
        assert run.sensitivity.shape == (len(run.t), 2 * mech.n, 2)
        assert relative_error(run.sensitivity[-1], ended[0].sensitivity[-1]) < 1e-7


def test_loose_steps_of_loops_vary_by_the_order_that_they_have() -> None:
    mechanism = rd.load("slider-crank")
    q = rd.assemble(mechanism, [1.0])
    qd = rd.loop_velocities(mechanism, q, [2.0])
    told = {"rtol": 1e-4, "atol": 1e-4, "method": "taylor"}
    own, ten = (
        rd.simulate(mechanism, q, qd, 0.3, order=order, sensitivity=["q1"], **told)
        for order in (None, 10)
    )
    np.testing.assert_array_equal(own.q, ten.q)
    np.testing.assert_array_equal(own.sensitivity, ten.sensitivity)


def test_near_a_singular_configuration_they_keep_close_to_the_motion(scene: Scene) -> None:
    """The series of tangents fall off more slowly than those of the motion, whose steps they take.

    The rod is hardly longer than crank and offset are together: it stands nearly upright.
    """
    text = (ROOT / "robots/slider-crank.yaml").read_text()
    mech = rd.load(scene(text.replace("l: 0.32, r: 0.14,", "l: 0.1205, r: 0.05,")))
    q = rd.assemble(mech, [0.2])
    names = ["links.rod.l", "links.crank.m", "qd1", "q1"]
    start = mech, q, rd.loop_velocities(mech, q, [3.0]), 2.0
    given = {"t_eval": np.linspace(0.0, 2.0, 21), "sensitivity": names}
    loose = rd.simulate(*start, method="taylor", rtol=1e-6, atol=1e-6, **given)
    tight = rd.simulate(*start, method="DOP853", **TIGHT, **given)
    assert np.abs(loose.q - tight.q).max() < 5e-6
    errors = np.abs(loose.sensitivity - tight.sensitivity).max(axis=(0, 1))
    assert (errors < 2e-4 * np.abs(tight.sensitivity).max(axis=(0, 1))).all()


def test_a_change_point_is_named() -> None:
    mech = rd.load(ROOT / "robots/parallelogram.yaml")
    q = rd.assemble(mech, [0.7])
    start = q, rd.loop_velocities(mech, q, [0.5])
    for method in ("taylor", "DOP853"):
        with pytest.raises(RobodynError, match="pass no change point"):
            rd.simulate(mech, *start, 0.5, method=method, sensitivity=["q1"])


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
                assert relative_error(motion.sensitivity[k], exact) < 1e-9


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
        assert np.allclose(given.column(name), plain.column(name), atol=1e-7)
    assert given.column("dq1/q1")[0] == 1.0
    assert given.column("dq1/links.forearm.m")[0] == 0.0
    mech = rd.load(ROOT / "robots/2r.yaml")
    motion = rd.simulate(
        mech, [0.5, 0.8], [0, 0], 1.0, t_eval=[0, 0.5, 1], sensitivity=["links.forearm.m", "q1"]
    )
    assert motion.sensitivity is not None
    assert np.array_equal(motion.sensitivity[:, 2, 1], given.column("dqd1/q1"))


def test_a_function_of_python_has_no_sensitivities() -> None:
    mech = rd.load(ROOT / "robots/2r.yaml")
    with pytest.raises(InputError, match="tau: a function of Python has no derivative: give"):
        rd.simulate(mech, [0, 0], [0, 0], 1.0, lambda t, q, qd: [q[0], 0.0], sensitivity=["q1"])


@pytest.mark.parametrize("kind", KINDS[::2])
def test_random_scenes(kind: str, scene: Scene) -> None:
    """Springs, couplings, slots, motors, loads: the series against a tight run by DOP853."""
    drawn = plain_scene(kind, 2)
    path = scene(drawn.text)
    mech, values = rd.load(path), read_numbers(drawn.text, str(path))
    rates = drawn.qd[list(mech.actuated)]
    start = drawn.q, rd.loop_velocities(mech, drawn.q, rates) if mech.rows else drawn.qd
    names = [f"q{mech.actuated[0] + 1}"]
    for name in values.names:
        try:
            with_variable(mech, name, Graph().variable("p"))
        except InputError:
            continue
        names.append(name)
    names = [*names[:1], *names[1 :: max(1, len(names) // 3)]]
    end, torques = 0.05, ["0.1*sin(3*t)"] * len(mech.actuated)
    tight = {"rtol": 1e-12, "atol": 1e-12, "t_eval": [0.0, 0.5 * end, end], "sensitivity": names}
    runs = []
    for method in WAYS:
        given = {"method": method, **tight}
        runs.append(rd.simulate(mech, *start, end, ",".join(torques), **given).sensitivity)
    size = np.abs(runs[0]).max(axis=(0, 1)) + 1e-9
    for run in runs[1:]:
        assert (np.abs(run - runs[0]) < 1e-8 * size).all(), names


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


@pytest.mark.parametrize("method", WAYS)
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
        with pytest.raises(InputError, match=r"sensitivity = .*: must be a list of names"):
            rd.simulate(mech, [0, 0], [0, 0], 0.1, sensitivity=names)  # type: ignore[arg-type]
