"""Cams in scenes: forces, reactions and motions against closed forms and reduced equations."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from robodyn import closure_jacobian, inverse_dynamics, simulate
from robodyn.dynamics.cam_contacts import cam_named, cams_of, contact_along, outline, profile_of
from robodyn.dynamics.closed_form import point_motion
from robodyn.dynamics.state import State
from robodyn.errors import DescriptionError, InputError
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.runs.report import Outcome
from robodyn.scene.description import from_text
from robodyn.scene.plain_scene import plain_scene
from robodyn.scene.scene import Point
from robodyn.scene.scene_values import read_numbers

M, J, K, PRELOAD, G = 0.4, 0.002, 900.0, 0.03, 9.81
H, W = 0.02, 30.0
R, ROLLER, E = 0.03, 0.008, 0.006
S0 = math.sqrt((R + ROLLER) ** 2 - E * E)
SCENE = """
gravity: 9.81
links:
  - {{name: cam, m: 1.0, l: 0.0, r: 0.0, I: 0.002}}
  - {{name: follower, joint: prismatic, axis: [0, 1], m: 0.4, l: 0.1, r: 0.05, I: 0.0,
     from: [0.006, {y!r}]}}
springs:
  - {{joint: follower, stiffness: 900, length: -0.03}}
couplings:
  - {{law: "{law}", cam: {{{cam}}}}}
"""
# of each lift: its law, and s, s', s'' of the angle
LIFTS: dict[str, tuple[str, Callable[[Any], tuple[Any, Any, Any]]]] = {
    "harmonic": (
        "q2 = 10 mm (1 - cos(1.5 q1))",
        lambda x: (
            0.01 * (1 - np.cos(1.5 * x)),
            0.015 * np.sin(1.5 * x),
            0.0225 * np.cos(1.5 * x),
        ),
    ),
    "cycloidal": (
        "q2 = 20 mm (q1/2 - sin(pi q1)/(2 pi))",
        lambda x: (
            0.02 * (x / 2 - np.sin(np.pi * x) / (2 * np.pi)),
            0.01 * (1 - np.cos(np.pi * x)),
            0.01 * np.pi * np.sin(np.pi * x),
        ),
    ),
    "3-4-5": (
        "q2 = 20 mm (10*(q1/2)^3 - 15*(q1/2)^4 + 6*(q1/2)^5)",
        lambda x: (
            0.02 * (10 * (x / 2) ** 3 - 15 * (x / 2) ** 4 + 6 * (x / 2) ** 5),
            0.01 * (30 * (x / 2) ** 2 - 60 * (x / 2) ** 3 + 30 * (x / 2) ** 4),
            0.005 * (60 * (x / 2) - 180 * (x / 2) ** 2 + 120 * (x / 2) ** 3),
        ),
    ),
}
THETA = np.linspace(0.05, 1.95, 12)


def _scene(lift: str, cam: str = "roller: 8 mm", y: float = S0) -> Mechanism:
    return build(from_text(SCENE.format(law=LIFTS[lift][0], cam=cam, y=y), "scene.yaml"))


@pytest.mark.parametrize("lift", LIFTS)
def test_forces_of_a_turning_cam(lift: str) -> None:
    """Torque, contact force, pressure angle and radius, at constant speed, by hand."""
    mechanism, (s, s1, s2) = _scene(lift), LIFTS[lift][1](THETA)
    q = np.stack([THETA, s], axis=-1)
    qd, qdd = np.stack([np.full(12, W), s1 * W], axis=-1), np.stack([0 * s, s2 * W * W], axis=-1)
    force = M * (s2 * W * W + G) + K * (s + PRELOAD)  # along the way of the follower
    tangent = (s1 - E) / (s + S0)
    state = State(mechanism, q, qd, qdd)
    names = ["tau1", "tc1", "contact1", "pressure1", "rho1", "rx1", "ry1", "rx2", "ry2", "rm2"]
    tau, tc, contact, pressure, rho, rx1, ry1, rx2, ry2, rm2 = state.columns(names).T
    size = np.abs(force).max()
    np.testing.assert_allclose(tc, force, atol=1e-12 * size)
    np.testing.assert_allclose(tau, force * s1, atol=1e-12 * size * H)
    np.testing.assert_allclose(np.tan(pressure), tangent, atol=1e-12)
    np.testing.assert_allclose(contact, force * np.hypot(1.0, tangent), atol=1e-12 * size)
    radius = ((s + S0) ** 2 + (s1 - E) ** 2) ** 1.5
    radius /= (s + S0) ** 2 + (s1 - E) * (2 * s1 - E) - (s + S0) * s2
    np.testing.assert_allclose(rho, radius - ROLLER, rtol=1e-12)
    # the cam's bearing bears the contact, the guide what of it is across, and its moment
    np.testing.assert_allclose(rx1, -force * tangent, atol=1e-12 * size)
    np.testing.assert_allclose(ry1, 1.0 * G + force, atol=1e-12 * size)
    np.testing.assert_allclose(rx2, force * tangent, atol=1e-12 * size)
    np.testing.assert_allclose(ry2, -K * (s + PRELOAD), atol=1e-12 * size)
    np.testing.assert_allclose(rm2, 0.0, atol=1e-13 * size)


def test_a_flat_face_turns_its_follower_in_the_guide() -> None:
    mechanism, (s, s1, s2) = (
        _scene("harmonic", "face: {through: [0, 0], along: [0, 1]}", 0.04),
        (LIFTS["harmonic"][1](THETA)),
    )
    q = np.stack([THETA, s], axis=-1)
    qd, qdd = np.stack([np.full(12, W), s1 * W], axis=-1), np.stack([0 * s, s2 * W * W], axis=-1)
    names = ["contact1", "pressure1", "rho1", "rx2", "rm2"]
    contact, pressure, rho, rx2, rm2 = State(mechanism, q, qd, qdd).columns(names).T
    force = M * (s2 * W * W + G) + K * (s + PRELOAD)
    size = np.abs(force).max()
    np.testing.assert_allclose(contact, force, atol=1e-12 * size)
    np.testing.assert_allclose(pressure, 0.0, atol=1e-14)
    np.testing.assert_allclose(rho, 0.04 + s + s2, rtol=1e-12)
    np.testing.assert_allclose(rx2, 0.0, atol=1e-12 * size)
    # the cam touches at x = s', the guide is at x = e: the moment about the follower's joint
    np.testing.assert_allclose(rm2, -force * (s1 - E), atol=1e-13 * size)


NESTED = """
gravity: [1.5, -9.81]
links:
  - {name: arm, m: 1.2, l: 0.4, r: 0.2, I: 0.02}
  - {name: cam, m: 1.0, l: 0.02, r: [0.01, 0.004], I: 0.003, from: {link: arm, at: [0.3, 0.05]}}
  - {name: rocker, m: 0.6, l: 0.2, r: [0.09, 0.02], I: 0.004, from: {link: arm, at: [0.42, 0.08]}}
couplings:
  - {law: "q3 = 2.9 + 0.15 sin(q2) + 0.04 cos(2 q2)", cam: {CAM}}
"""
SIDES = {
    "roller": "roller: 12 mm, at: [0.11, 0.05]",
    "knife edge": "roller: 0, at: [0.11, 0.05]",
    "face": "face: {through: [0.05, 0.03], along: [1, 0.1]}",
}


@pytest.mark.parametrize("side", SIDES)
def test_euler_equation_of_each_link_with_the_contact(side: str) -> None:
    """Of a cam and a rocker on a turning arm: reactions and contact turn each body as it turns."""
    mechanism = build(from_text(NESTED.replace("CAM", SIDES[side]), "scene.yaml"))
    rng = np.random.default_rng(4)
    q1, q2 = rng.uniform(-3, 3, (2, 20))
    q = np.stack([q1, q2, 2.9 + 0.15 * np.sin(q2) + 0.04 * np.cos(2 * q2)], axis=-1)
    slope = 0.15 * np.cos(q2) - 0.08 * np.sin(2 * q2)
    bend = -0.15 * np.sin(q2) - 0.16 * np.cos(2 * q2)
    (w1, w2), (a1, a2) = rng.uniform(-4, 4, (2, 2, 20))
    qd = np.stack([w1, w2, slope * w2], axis=-1)
    qdd = np.stack([a1, a2, slope * a2 + bend * w2 * w2], axis=-1)
    state = State(mechanism, q, qd, qdd)
    tau = inverse_dynamics(mechanism, q, qd, qdd)
    names = ["rx2", "ry2", "rx3", "ry3", "contact1"]
    rx2, ry2, rx3, ry3, force = state.columns(names).T
    (cam,), tree = cams_of(mechanism), Tree(mechanism.description.links)
    touch = contact_along(mechanism, cam, q2)
    alpha = np.cumsum(qdd[:, :2], axis=1)[:, 1], q[:, 0] + q[:, 1]
    normal = touch.normal * np.exp(1j * alpha[1])

    def moves(k: int, at: complex) -> tuple[Any, Any]:
        place, _, a = point_motion(mechanism, [tree.point(Point(k, at))], q, qd, qdd)
        return place[:, 0] @ [1, 1j], a[:, 0] @ [1, 1j]

    place = np.array([
        (point_motion(mechanism, [tree.point(Point(1, z))], x)[0][0] @ [1, 1j])
        for z, x in zip(touch.profile, q, strict=True)
    ])  # fmt: skip
    # the contact lies on the follower too: at the roller's radius from its centre, or on its face
    centre, _ = moves(2, cam.follower.at)
    turn3 = np.exp(1j * (q[:, 0] + q[:, 2]))
    if cam.follower.face is None:
        np.testing.assert_allclose(centre - place, cam.follower.radius * normal, atol=1e-14)
    else:
        across = (np.conj(1j * turn3 * cam.follower.face) * (place - centre)).real
        np.testing.assert_allclose(across, 0.0, atol=1e-14)
    for k, pull, sign, turned in (
        (1, rx2 + 1j * ry2, -1.0, qdd[:, 0] + qdd[:, 1]),
        (2, rx3 + 1j * ry3, 1.0, qdd[:, 0] + qdd[:, 2]),
    ):
        link = mechanism.description.links[k]
        joint, _ = moves(k, 0j)
        mass, a = moves(k, link.r)
        np.testing.assert_allclose(
            link.m * (a - mechanism.gamma), pull + sign * force * normal, atol=1e-11
        )
        moment = (np.conj(joint - mass) * pull).imag
        moment += sign * (np.conj(place - mass) * force * normal).imag + tau[:, k]
        np.testing.assert_allclose(moment, link.I * turned, atol=1e-12)
    # the work of the contact is that of the law
    torque = state.columns(["tc1"])[:, 0]
    Psi = closure_jacobian(mechanism, q)[:, 0] / mechanism.rows[0].arm
    np.testing.assert_allclose(torque[:, None] * Psi[:, 1], torque[:, None] * -slope, atol=1e-12)


def test_reactions_lack_the_contact_of_a_law_without_a_cam(
    robodyn: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    """A note on stderr names the law, in whose bearings the contact force is missing."""
    cam = (ROOT / "robots" / "disc-cam.yaml").read_text()
    law = '{law: "q2 = 5 mm (1 - cos(q1))^2", cam: {roller: 8 mm, at: [-62.5 mm, 0]}}'
    texts = {
        "cam.yaml": cam,
        "law.yaml": cam.replace(law, '"q2 = 5 mm (1 - cos(q1))^2"'),
        "rack.yaml": cam.replace(law, '"q2 = 5 mm q1"'),
        "drive.yaml": cam.replace(law, '"q2 = 5 mm sin(t / 1 s)"'),
    }
    monkeypatch.chdir(tmp_path)
    for name, text in texts.items():
        Path(name).write_text(text)
    pose, named = ["--q", "150deg"], ["--columns", "reactions"]
    commands = (
        ["reactions", *pose],
        ["torque", *pose, *named],
        ["simulate", *pose, "--time", "0.01", *named],
        ["trajectory", "--from", "0", "--to", "1", "--time", "1", *named],
        ["sweep", "--kind", "torque", "--vary", "q1=1", "--result", "ry1,rx2"],
        ["draw", *pose, "--forces", "-o", "out.svg"],
    )
    told = "couplings[0] = 5 mm (1 - cos(q1))^2 has no `cam`"
    for command, *rest in commands:
        for name in texts:
            given = robodyn(command, name, *rest)
            assert given.code == 0, given.err
            assert given.err.count(told) == (name == "law.yaml")
    assert "cam" not in robodyn("torque", "law.yaml", *pose).err
    found = {}
    for name in ("cam.yaml", "law.yaml"):
        rest = [*pose, "--qd", "60", "--columns", "rx1,ry1,rx2,ry2"]
        out = robodyn("reactions", name, *rest).out
        found[name] = np.array([float(x) for x in out.splitlines()[1].split(",")])
    out = robodyn("torque", "cam.yaml", *pose, "--qd", "60", "--columns", "contact1").out
    force = float(out.splitlines()[1])
    lacking = (found["cam.yaml"] - found["law.yaml"]).reshape(2, 2)
    np.testing.assert_allclose(np.hypot(*lacking.T), force, rtol=1e-12)
    np.testing.assert_allclose(lacking.sum(axis=0), 0.0, atol=1e-12 * force)


def _reduced(theta: float, w: float) -> tuple[float, float]:
    """The acceleration of a free harmonic cam, and the contact force along the follower's way."""
    s, s1, s2 = (float(x) for x in LIFTS["harmonic"][1](theta))
    down = M * G + K * (s + PRELOAD)
    acceleration = -(M * s1 * s2 * w * w + down * s1) / (J + M * s1 * s1)
    return acceleration, M * (s2 * w * w + s1 * acceleration) + down


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau", "taylor"])
def test_a_free_flywheel(method: str) -> None:
    """The run, its energy and its contact force against the equation of one coordinate."""
    if method == "taylor":
        pytest.importorskip("llvmlite")
    t = np.linspace(0.0, 0.4, 41)
    exact = solve_ivp(
        lambda t, y: [y[1], _reduced(*y)[0]], (0, 0.4), [0.3, 25.0], "DOP853", t, rtol=3e-14,
        atol=3e-14,
    ).y  # fmt: skip
    mechanism = _scene("harmonic")
    s, s1, _ = LIFTS["harmonic"][1](0.3)
    tight = {"rtol": 1e-11, "atol": 1e-12} if method in ("DOP853", "taylor") else {"rtol": 1e-9}
    run = simulate(mechanism, [0.3, s], [25.0, 25.0 * s1], 0.4, method=method, t_eval=t, **tight)
    assert run.outcome is Outcome.FINISHED
    error = 2e-9 if method in ("DOP853", "taylor") else 3e-6
    np.testing.assert_allclose(run.q[:, 0], exact[0], rtol=error)
    np.testing.assert_allclose(run.qd[:, 0], exact[1], rtol=10 * error, atol=10 * error)
    assert run.report.energy_drift < 100 * error
    tangent = [(x[1] - E) / (x[0] + S0) for x in map(LIFTS["harmonic"][1], exact[0])]
    force = [_reduced(*y)[1] * math.hypot(1.0, x) for y, x in zip(exact.T, tangent, strict=True)]
    np.testing.assert_allclose(run.to_dict()["contact1"], force, rtol=1e3 * error)


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau", "taylor"])
@pytest.mark.parametrize("backward", [False, True])
def test_the_follower_leaves_the_cam(method: str, backward: bool) -> None:
    """`contact1 < 0` happens where the reduced equation says that nothing presses."""
    if method == "taylor":
        pytest.importorskip("llvmlite")
    way = -1.0 if backward else 1.0
    exact = solve_ivp(
        lambda t, y: [y[1], _reduced(*y)[0]], (0, way * 0.1), [0.0, way * 90.0], "DOP853",
        rtol=3e-14, atol=3e-14, dense_output=True,
    ).sol  # fmt: skip
    t = np.linspace(0.0, way * 0.1, 2001)
    forces = np.array([_reduced(*y)[1] for y in exact(t).T])
    first = int(np.argmax(forces < 0.0))
    assert first > 0
    leaves = brentq(lambda t: _reduced(*exact(t))[1], t[first - 1], t[first], xtol=1e-16)
    run = simulate(
        _scene("harmonic"), [0, 0], [way * 90.0, 0], way * 0.1, method=method, rtol=1e-10,
        atol=1e-12, until="contact1 < 0",
        events={"half": f"contact1 - {forces[0] / 2:.17g}"},
    )  # fmt: skip
    assert run.outcome is Outcome.EVENT
    np.testing.assert_allclose(run.t[-1], leaves, rtol=1e-8)
    assert abs(run.to_dict()["contact1"][-1]) < 1e-5 * forces[0]
    assert "half" in [event.name for event in run.events]


def test_an_event_of_a_force_under_a_torque_that_jumps() -> None:
    """A jump of the torque is one of the force: the event is at the jump."""
    run = simulate(
        _scene("harmonic"), [0.5, LIFTS["harmonic"][1](0.5)[0]], [0, 0], 0.03,
        tau="0.05 if t < 0.012 else -0.4", until="contact1 < 32.5 N",
    )  # fmt: skip
    assert run.outcome is Outcome.EVENT
    assert abs(run.t[-1] - 0.012) < 1e-12


def test_the_profile_of_a_scene() -> None:
    mechanism = _scene("harmonic")
    (cam,) = cams_of(mechanism)
    own = profile_of(mechanism, cam)
    assert abs(own.base_circle - R) < 1e-13
    assert abs(own.offset - E) < 1e-15
    assert not own.closed  # a law of 1.5 q1 does not come back after a turn
    assert own.one_side
    assert own.undercut is None
    s, s1, _ = LIFTS["harmonic"][1](np.linspace(0.0, 2 * np.pi, 200_001))
    tangent = np.arctan((s1 - E) / (s + S0))
    np.testing.assert_allclose(own.pressure, np.abs(tangent).max(), rtol=1e-9)
    _, touch = outline(mechanism, cam, 100)
    assert np.abs(touch.profile).min() >= R - 1e-15
    flat = _scene("harmonic", "face: {through: [0.002, 0.01], along: [0, -3]}", 0.04)
    (cam,) = cams_of(flat)
    face = profile_of(flat, cam)
    # from the point of the face, at x = e - 0.01, along x of the ground
    np.testing.assert_allclose(face.face, [0.01 - E - 0.015, 0.01 - E + 0.015], atol=1e-10)
    assert abs(face.base_circle - 0.042) < 1e-4
    limited = SCENE.replace("r: 0.0, I: 0.002", "r: 0.0, I: 0.002, limits: {{min: 0.2, max: 0.9}}")
    text = limited.format(law=LIFTS["harmonic"][0], cam="roller: 8 mm", y=S0)
    theta, _ = outline(build(from_text(text, "scene.yaml")), cams_of(mechanism)[0], 10)
    assert (theta[0], theta[-1]) == (0.2, 0.9)


def test_a_large_roller_and_a_hollow_are_undercut() -> None:
    sharp = _scene("harmonic", "roller: 0")
    least = profile_of(sharp, cams_of(sharp)[0]).least_radius
    for radius, cut in ((0.999 * least, False), (1.001 * least, True)):
        rolling = _scene("harmonic", f"roller: {radius!r}")
        assert (profile_of(rolling, cams_of(rolling)[0]).undercut is not None) == cut
    hollow = _scene("harmonic", "face: {through: [0, 0], along: [0, 1]}", 0.001)
    own = profile_of(hollow, cams_of(hollow)[0])
    assert own.undercut is not None
    np.testing.assert_allclose(math.cos(1.5 * own.undercut), -1.0, atol=1e-9)


@pytest.mark.parametrize(
    ("cam", "told"),
    [
        ("roller: -1 mm", "must be >= 0"),
        ("roller: 1, face: {through: [0, 0], along: [0, 1]}", "and face exclude each other"),
        ("at: [0, 0]", "roller: is missing"),
        ("face: {through: [0, 0], along: [0, 0]}", "must point somewhere"),
        ("face: {through: [0, 0], along: [2, 0]}", "the face lies along the way of follower"),
    ],
)
def test_cams_that_are_refused(cam: str, told: str) -> None:
    with pytest.raises((DescriptionError, InputError), match=told.replace("[", r"\[")):
        _scene("harmonic", cam)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("q2 = 10 mm (1 - cos(1.5 q1))", "q2 = 10 mm", "it names none"),
        ("q2 = 10 mm (1 - cos(1.5 q1))", "q1 = 10 q2", "q2 slides: a cam turns"),
        ("from: [0.006", "from: {link: cam, at: [0.006", "must hang from one link"),
    ],
)
def test_couplings_that_no_cam_has(old: str, new: str, told: str) -> None:
    text = SCENE.format(law=LIFTS["harmonic"][0], cam="roller: 8 mm", y=S0).replace(old, new)
    if "link: cam" in new:
        text = text.replace(f"{S0!r}]", f"{S0!r}]}}")
    with pytest.raises((DescriptionError, InputError), match=told):
        build(from_text(text, "scene.yaml"))


def test_a_roller_on_the_joint_of_a_follower_that_turns() -> None:
    text = NESTED.replace("CAM", "roller: 5 mm")
    with pytest.raises(InputError, match="the roller's centre is the joint of rocker"):
        build(from_text(text, "scene.yaml"))


def test_a_scene_with_a_cam_is_written_back() -> None:
    for cam in ("roller: 8 mm, at: [0, 0.001]", "face: {through: [0, 0], along: [0, 1]}"):
        described = _scene("harmonic", cam).description
        again = from_text(json.dumps(plain_scene(described)), "scene.yaml")
        assert again.couplings == described.couplings
    text = SCENE.format(law=LIFTS["harmonic"][0], cam="roller: 8 mm", y=S0)
    values = read_numbers(text, "scene.yaml")
    assert "couplings[0].cam.roller" in values.names
    changed = values.replaced({"couplings[0].cam.roller": 0.01})
    assert changed.couplings[0].cam is not None
    assert changed.couplings[0].cam.roller == 0.01


def test_the_profile_as_a_table(robodyn: Any, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    mechanism = _scene("harmonic")
    text = SCENE.format(law=LIFTS["harmonic"][0], cam="roller: 8 mm", y=S0)
    Path("scene.yaml").write_text(text)
    done = robodyn("points", "scene.yaml", "--cam", "follower", "-o", "cam.csv")
    assert done.code == 0
    rows = np.genfromtxt("cam.csv", delimiter=",", names=True)
    _, touch = outline(mechanism, cam_named(mechanism, "follower", "--cam"), 720)
    np.testing.assert_array_equal(rows["x"] + 1j * rows["y"], touch.profile)
    done = robodyn(
        "points", "scene.yaml", "--cam", "follower", "--points", "5", "--columns", "q1,rho1"
    )
    assert done.out.splitlines()[0] == "q1,rho1"
    assert len(done.out.splitlines()) == 6
    for words, told in (
        (["--cam", "folower"], "did you mean follower?"),
        (["--cam", "follower", "--points", "1"], "must be from 2 to"),
        (["--cam", "follower", "--q", "0"], "does not go with --cam"),
        (["--q", "0", "--points", "9"], "--points = 9: goes with --cam"),
        (["--cam", "follower", "--columns", "z"], "is no column here"),
    ):
        done = robodyn("points", "scene.yaml", *words)
        assert done.code == 2
        assert told in done.err


def test_the_commands_know_cams(robodyn: Any, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    text = SCENE.format(law=LIFTS["harmonic"][0], cam="roller: 8 mm", y=S0)
    Path("scene.yaml").write_text(text)
    found = robodyn("check", "scene.yaml").json["cams"]
    assert found[0]["follower"] == "follower"
    assert abs(found[0]["base_circle"] - R) < 1e-13
    done = robodyn("check", "scene.yaml", "--set", "couplings[0].cam.roller=0.05")
    assert "the profile of follower's cam is undercut" in done.err
    state = ("--q", "20deg", "--qd", "10")
    for command in ("torque", "reactions", "accel"):
        assert "contact1" in robodyn(command, "scene.yaml", *state).out.splitlines()[0]
    done = robodyn("torque", "2r", "--q", "0,0", "--columns", "contacts")
    assert "no coupling of this scene has a cam" in done.err
    done = robodyn("points", "scene.yaml", "--q", "20deg", "--columns", "pressure1", "--degrees")
    s, s1, _ = LIFTS["harmonic"][1](math.radians(20))
    name, value = done.out.split()
    assert name == "pressure1_deg"
    assert abs(float(value) - math.degrees(math.atan((s1 - E) / (s + S0)))) < 1e-12
    done = robodyn("simulate", "scene.yaml", "--q", "0", "--qd", "90", "--until", "contact1 < 0")
    assert done.code == 0
    assert "ended by --until contact1 < 0" in done.err
    assert robodyn("draw", "scene.yaml", "--q", "40deg", "-o", "x.svg").code == 0


def test_an_event_of_a_force_while_a_joint_sticks() -> None:
    """What dry friction holds has rows of its own behind those of couplings."""
    text = SCENE.format(law=LIFTS["harmonic"][0], cam="roller: 8 mm", y=S0)
    sticky = text.replace("I: 0.002}", "I: 0.002, friction: {torque: 0.6, static: 0.7}}")
    mechanism, s = build(from_text(sticky, "scene.yaml")), LIFTS["harmonic"][1](0.5)[0]
    held = {"tau": "4*t", "t_eval": np.linspace(0.0, 0.4, 401)}
    whole = simulate(mechanism, [0.5, s], [0, 0], 0.4, **held)
    contact = whole.to_dict()["contact1"]
    stands = M * G + K * (s + PRELOAD)
    tangent = (LIFTS["harmonic"][1](0.5)[1] - E) / (s + S0)
    still = np.abs(whole.qd[:, 0]) == 0.0
    assert 100 < still.sum() < 400
    np.testing.assert_allclose(contact[still], stands * math.hypot(1.0, tangent), rtol=1e-12)
    end = float(contact[still][0] + 0.5 * (contact[~still][-1] - contact[still][0]))
    way = "<" if end < contact[still][0] else ">"
    run = simulate(mechanism, [0.5, s], [0, 0], 0.4, until=f"contact1 {way} {end:.17g}", **held)
    assert run.outcome is Outcome.EVENT
    assert abs(run.to_dict()["contact1"][-1] - end) < 1e-6 * end
    assert run.t[-1] > whole.t[still][-1]


def test_friction_of_the_bearing_and_of_the_guide() -> None:
    """Friction by the forces of the cam's pin and of the follower's guide, by hand."""
    text = SCENE.format(law=LIFTS["harmonic"][0], cam="roller: 8 mm", y=S0)
    text = text.replace(
        "I: 0.002}", "I: 0.002, friction: {coefficient: 0.1, radius: 12 mm, speed: 0.5}}"
    ).replace("I: 0.0,\n", "I: 0.0, friction: {coefficient: 0.15, speed: 0.01},\n")
    mechanism, (s, s1, s2) = build(from_text(text, "scene.yaml")), LIFTS["harmonic"][1](THETA)
    q = np.stack([THETA, s], axis=-1)
    qd, qdd = np.stack([np.full(12, W), s1 * W], axis=-1), np.stack([0 * s, s2 * W * W], axis=-1)
    tau, contact, tc = State(mechanism, q, qd, qdd).columns(["tau1", "contact1", "tc1"]).T
    angle = np.arctan((s1 - E) / (s + S0))
    force = M * (s2 * W * W + G) + K * (s + PRELOAD)
    rubs = 0.15 * np.tanh(s1 * W / 0.01)
    N = force / (np.cos(angle) - rubs * np.abs(np.sin(angle)))
    np.testing.assert_allclose(contact, N, rtol=1e-11)
    np.testing.assert_allclose(tc, N * np.cos(angle), rtol=1e-11)
    bearing = np.hypot(N * np.sin(angle), 1.0 * G + N * np.cos(angle))
    turned = N * np.cos(angle) * s1 + 0.1 * 0.012 * np.tanh(W / 0.5) * bearing
    np.testing.assert_allclose(tau, turned, rtol=1e-11, atol=1e-12)
    caused = State(mechanism, q, qd, tau=np.stack([tau, 0 * tau], axis=-1))
    np.testing.assert_allclose(caused.columns(["qdd1", "contact1"]).T[1], N, rtol=1e-10)


def test_a_cam_whose_joint_is_driven() -> None:
    """A law of the time turns the cam: the follower leaves it where the cosine tells."""
    text = SCENE.format(law="q2 = 10 mm (1 - cos(q1))", cam="roller: 8 mm", y=S0)
    turned = text.replace("couplings:\n", 'couplings:\n  - "q1 = 130 rad/s t"\n')
    mechanism = build(from_text(turned, "scene.yaml"))
    cosine = -(M * G + K * (PRELOAD + 0.01)) / (0.01 * (M * 130.0**2 - K))
    run = simulate(mechanism, [0, 0], [130.0, 0], 1.0, until="contact2 < 0")
    assert run.outcome is Outcome.EVENT
    np.testing.assert_allclose(run.t[-1], math.acos(cosine) / 130.0, rtol=1e-9)
    with pytest.raises(DescriptionError, match="names t: the law of a cam"):
        from_text(text.replace("q2 = 10 mm", "q2 = 1 m/s t + 10 mm"), "scene.yaml")


@pytest.mark.parametrize("repeats", [True, False])
def test_a_cam_by_a_table(repeats: bool, tmp_path: Path) -> None:
    """A lift from a file: the profile of a spline is near that of the law it is drawn from."""
    angle = np.linspace(0.0, 2.0 * np.pi if repeats else 3.0, 241)
    rows = np.stack([angle, 0.01 * (1 - np.cos(angle))], axis=-1)
    rows[-1, 1] = rows[0, 1] if repeats else rows[-1, 1]
    lines = "".join(f"{a!r},{s!r}\n" for a, s in rows.tolist())
    (tmp_path / "lift.csv").write_text(f"q1,lift\n{lines}")
    text = SCENE.format(law="q2 = 10 mm (1 - cos(q1))", cam="roller: 8 mm", y=S0)
    exact = build(from_text(text, str(tmp_path / "exact.yaml")))
    whole = ", period: 360deg" * repeats
    table = f"joint: follower, table: lift.csv, over: q1, column: lift{whole}, "
    drawn = text.replace('law: "q2 = 10 mm (1 - cos(q1))",', table)
    mechanism = build(from_text(drawn, str(tmp_path / "scene.yaml")))
    (cam,), (own,) = cams_of(mechanism), cams_of(exact)
    theta, touch = outline(mechanism, cam, 100)
    assert (theta[0], theta[-1]) == (angle[0], angle[-1])
    near = contact_along(exact, own, theta)
    np.testing.assert_allclose(touch.profile, near.profile, atol=1e-6)
    np.testing.assert_allclose(touch.curvature, near.curvature, rtol=1e-2)
    assert profile_of(mechanism, cam).closed == repeats
    again = from_text(json.dumps(plain_scene(mechanism.description)), str(tmp_path / "again.yaml"))
    assert again.couplings[0].cam == mechanism.description.couplings[0].cam
    timed = drawn.replace("over: q1", "over: t").replace(", period: 360deg", "")
    (tmp_path / "lift.csv").write_text(f"t,lift\n{lines}")
    with pytest.raises(DescriptionError, match="names t: the law of a cam"):
        from_text(timed, str(tmp_path / "scene.yaml"))
