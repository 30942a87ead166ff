"""Values with units and arithmetic in options and scenes: the same numbers, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from conftest import ROOT, Outcome
from named_case import case

Run = Callable[..., Outcome]
SCENE = """
gravity: {gravity}
links:
  - {{name: arm, m: {m}, l: {l}, r: {r}, I: {I}, damping: {damping}, payload: {payload}}}
  - {{name: boom, joint: prismatic, axis: [1, 0], m: 0.9, l: 0.5, r: [{x}, 2 cm], I: 0.03}}
springs:
  - {{joint: arm, stiffness: {stiffness}, angle: {angle}}}
loads:
  - {{link: boom, at: [{x}, 0], force: [{force}, "3*cos(q1)"]}}
  - {{link: arm, torque: {torque}}}
start: {{boom: {start}}}
points: {{P: {{link: boom, at: [{x}, 0]}}}}
"""
PLAIN = {
    "gravity": "9.81", "m": "1.5", "l": "0.35", "r": "0.125", "I": "0.0203125", "damping": "0.5",
    "payload": "0.25", "x": "0.2", "stiffness": "20", "angle": "0.5235987755982988",
    "force": "-12", "torque": "1.5", "start": "0.3",
}  # fmt: skip
WITH_UNITS = {
    "gravity": "9.81 m/s^2", "m": "1500 g", "l": "350 mm", "r": "1/8", "I": "203.125 kg*cm^2",
    "damping": "500 mN*m*s/rad", "payload": "250g", "x": "20 cm", "stiffness": '"20 N m/rad"',
    "angle": "30 deg", "force": "-12 N", "torque": '"1.5 N m"', "start": "300mm",
}  # fmt: skip
PAIRS = (
    (
        "torque 2r.yaml --q 30deg,pi/4 --qd 2*pi,-1",
        "torque 2r.yaml --q 30°,45deg --qd 60rpm,-1rad/s",
    ),
    (
        "torque rp-arm.yaml --q 0.1,0.35 --qdd 0,2",
        "torque rp-arm.yaml --q 0.1,350mm --qdd 0,2m/s^2",
    ),
    ("accel 2r.yaml --q 1,2 --tau 1.5,-0.5", "accel 2r.yaml --q 1,2rad --tau 1.5Nm,-500mN*m"),
    (
        "simulate 2r.yaml --q 0,0 --time 0.5 --every 0.1",
        "simulate 2r.yaml --q 0,0 --time 500ms --every 100ms",
    ),
    (
        "simulate 2r.yaml --q 0,0 --time 1 --tau 2,cos(t)",
        "simulate 2r.yaml --q 0,0 --time 1s --tau 2J,cos(t)",
    ),
    (
        "simulate 2r.yaml --q 0,0 --time 1 --rtol 1e-6",
        "simulate 2r.yaml --q 0,0 --time 1 --rtol 1/10^6",
    ),
    (
        "simulate pendulum.yaml --q 1 --time 1 --max-step 0.02",
        "simulate pendulum.yaml --q 1 --time 1 --max-step 1/50",
    ),
    (
        "trajectory 2r.yaml --from 0,0 --to 1,1 --time min --max-qd 2 --max-qdd 20",
        "trajectory 2r.yaml --from 0,0 --to 1,1 --time min --max-qd 2rad/s --max-qdd 20rad/s^2",
    ),
    (
        "sweep 2r.yaml --vary q1=0,0.5 --vary links.forearm.m=1:2:3 --q 0,0 --time 0.5",
        "sweep 2r.yaml --vary q1=0,1/2 --vary links.forearm.m=1kg:2000g:1+2 --q 0,0 --time 500ms",
    ),
    (
        "torque four-bar.yaml --q 1 --force coupler@0.5,0.2=10,-5",
        "torque four-bar.yaml --q 1 --force coupler@50cm,20cm=10N,-5N",
    ),
    (
        "simulate 2r.yaml --q 0,0 --time 0.1 --points 20 --quiet --tau 2*sin(3*t),-0.35*q1",
        "simulate 2r.yaml --q 0,0 --time 0.1 --points 2*1e1 --quiet "
        "--tau 2Nm*sin(3rad/s*t),-350mN*m*q1",
    ),
    (
        "simulate 2r.yaml --q 0,0 --hold 1,1 --control pd --kp 100,20 --kd 9 --time 0.1 --quiet",
        "simulate 2r.yaml --q 0,0 --hold 1,1 --control pd --kp 100N*m/rad,20 --kd 9N*m*s "
        "--time 0.1 --quiet",
    ),
    (
        "energy 2r.yaml --q 0,0 --set links.forearm.m=1.1",
        "energy 2r.yaml --q 0,0 --set links.forearm.m=1100g",
    ),
)


def words(line: str) -> list[str]:
    command, model, *rest = line.split()
    return [command, f"robots/{model}", *rest]


def test_options_with_units_are_the_same_numbers(robodyn: Run) -> None:
    for plain, written in PAIRS:
        with case(plain, written):
            assert robodyn(*words(plain)).out == robodyn(*words(written)).out != ""


def test_scenes_with_units_are_the_same_numbers(robodyn: Run, tmp_path: Path) -> None:
    outputs = []
    for name, values in (("plain", PLAIN), ("units", WITH_UNITS)):
        path = tmp_path / f"{name}.yaml"
        path.write_text(SCENE.format(**values))
        one = robodyn("accel", path, "--q", "0.3,0.2", "--qd", "1,-0.5").succeeds()
        outputs.append(one.out + robodyn("points", path, "--q", "0.3,0.2").succeeds().out)
    assert outputs[0] == outputs[1]


LARGE = [  # a scene's line or a command, and the angle that is told
    ("torque 2r.yaml --q 30,45", "30"),
    ("torque 2r.yaml --q 2*45,0 --qd 90,90 --qdd 90,90", "2*45"),
    ("accel 2r.yaml --q -30,45", "-30"),
    ("trajectory 2r.yaml --from 0,0 --to 90,-45 --time 1 --points 2", "90"),
    ("trajectory 2r.yaml --from 0,-45 --to 90deg,0 --time 1 --points 2", "-45"),
    (
        "trajectory 2r.yaml --profile sweep --from 0,0 --amplitude 10 --frequencies 1,2 --time 1 "
        "--points 2",
        "10",
    ),
    ("linearize 2r.yaml --q 0,90", "90"),
    ("simulate 2r.yaml --q 0,0 --until q1<-90 --time 0.01 --points 2", "90"),
    ("simulate 2r.yaml --q 0,0 --until 45>abs(q2) --time 0.01 --points 2", "45"),
    ("simulate 2r.yaml --q 0,0 --event up=q1-q2-90 --time 0.01 --points 2", "90"),
    ("sweep 2r.yaml --vary q1=0:90:3 --time 0.01 --result final", "90"),
    ("sweep 2r.yaml --vary q1=1,30 --time 0.01 --result final", "30"),
]
SMALL = [
    "torque 2r.yaml --q 6.28,-6.28 --qd 90,90",
    "torque 2r.yaml --q 30rad,720deg",
    "torque 2r.yaml --q 7pi,-9*pi/2",
    "torque rp-arm.yaml --q 1,45",
    "sweep 2r.yaml --vary q1=0:1:9 --vary links.forearm.m=7,8 --time 0.01 --result final --quiet",
    "simulate 2r.yaml --q 30,45 --time 0.01 --points 2 --quiet",
    "simulate 2r.yaml --q 0,0 --until qd1>90 --event x=q1-90deg --time 0.01 --points 2 --quiet",
    "simulate rp-arm.yaml --q 0,0.1 --until q2>90 --time 0.01 --points 2 --quiet",
    "equilibrium 2r.yaml --q 0,0 --hold forearm",
]
IN_SCENES = [  # what is added to the 2R, and what is told of it
    ("springs: [{joint: forearm, stiffness: 2, angle: ANGLE}]", "springs[0].angle = ANGLE"),
    ("start: {forearm: ANGLE}", "start.forearm = ANGLE"),
    ("couplings: q2 = -2 q1 + ANGLE", "q2 = -2 q1 + ANGLE"),
    ('couplings: ["q2 = ANGLE - q1"]', "q2 = ANGLE - q1"),
]


def test_large_angles_without_a_unit_are_told_once(robodyn: Run) -> None:
    """Never of joints that slide, rates, values with a unit or pi, nor with --quiet."""
    for line, text in LARGE:
        with case(line):
            given = robodyn(*words(line))
            assert given.code == 0
            told = f"an angle without a unit is in rad; write {text}deg"
            notes = [x for x in given.err.splitlines() if "without a unit" in x]
            assert [x.endswith(f"{told} for degrees") for x in notes] == [True]
    for line in SMALL:
        with case(line):
            given = robodyn(*words(line))
            assert (given.code, "without a unit" in given.err) == (0, False)


def test_rows_of_tables_may_run_over_many_turns(robodyn: Run) -> None:
    robodyn("torque", "robots/2r.yaml", "-", stdin="q1,q2\n30,45\n").succeeds()


def test_large_angles_of_scenes_without_a_unit_are_told(robodyn: Run, tmp_path: Path) -> None:
    text = (ROOT / "robots/2r.yaml").read_text()
    path = tmp_path / "my.yaml"
    for line, place in IN_SCENES:
        for angle, told in (("30", True), ("110.5", True), ("720deg", False), ("9 rad", False)):
            with case(line, angle):
                path.write_text(f"{text}{line.replace('ANGLE', angle)}\n")
                given = robodyn("check", path, "--format", "json")
                assert given.code == 0
                expected = f"Note: {path}: {place.replace('ANGLE', angle)}: an angle without"
                assert (expected in given.err) == told
                assert ("without a unit" in given.err) == told
    path.write_text(text.replace("I: 0.082", "I: 0.082, limits: {min: -90, max: 1}"))
    assert "links.upper arm.limits.min = -90" in robodyn("torque", path, "--q", "0,0").err
    given = robodyn("torque", path, "--q", "0,0", "--set", "links.upper arm.limits.min=-1")
    given.succeeds()
