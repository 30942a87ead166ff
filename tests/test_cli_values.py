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


def test_large_angles_of_springs_without_a_unit_are_told(robodyn: Run, tmp_path: Path) -> None:
    text = (ROOT / "robots/2r.yaml").read_text()
    for angle, told in (("30", True), ("-30", True), ("720deg", False), ("30 rad", False)):
        path = tmp_path / "my.yaml"
        path.write_text(f"{text}springs: [{{joint: forearm, stiffness: 2, angle: {angle}}}]\n")
        result = robodyn("torque", path, "--q", "0,0")
        assert result.code == 0
        expected = f"{path}: springs[0].angle = {angle} is in rad; write {angle}deg"
        assert (expected in result.err) == told
        assert bool(result.err) == told
