"""A scene as the mapping of its file: read again it is the same scene."""

from __future__ import annotations

import yaml
from documents import ROOT
from good_scenes import ARM, EVERYTHING, LOOP
from named_case import case

import robodyn
from random_mechanisms import LOOPS, forced, seeded_scene, seeded_tree
from robodyn.scene.description import from_text, read
from robodyn.scene.plain_scene import plain_scene
from robodyn.scene.scene import Description

SHIPPED = [*ROOT.glob("robots/*.yaml"), *ROOT.glob("tests/hard_cases/*.yaml")]
AT_JOINTS = """\
links:
  - {name: "3", m: 1, l: 1, r: 0.5, I: 0.1, friction: {torque: 0.3, speed: 0.1},
     limits: {min: -1, max: 2, stiffness: 90, damping: 0.1}}
  - {name: arm, m: 1, l: 1, r: [-0.5, 0.1], I: 0.1, friction: {torque: 0.3, static: 0.4},
     limits: {max: 2, restitution: 0}, motor: {ratio: -5, inertia: 0.01, torque_max: 3}}
  - {name: rod, joint: prismatic, axis: [3, 4], m: 1, l: 1, r: 0.5, I: 0.1, damping: 0.2,
     friction: {force: 0.3, static: 0.5, stribeck: 0.1}, limits: {min: -1},
     motor: {ratio: 5, inertia: 0.01, torque_constant: 0.1, resistance: 2}}
gravity: 0
couplings: ["q3 = -2 m/rad q1 + 3 mm", "q2 = 0"]
springs:
  - {joint: rod, law: "4*x + x^3 + 2*v", length: -0.2}
  - {joint: arm, stiffness: 2, angle: 30deg, damping: 1}
  - {between: [arm, [1, 2]], law: "4*x", length: 0.1}
loads:
  - {link: arm, torque: "2*sin(t)"}
  - {point: P, force: ["cos(q1)", 3], frame: link}
points: {P: {link: rod, at: [1, 2]}, Q: arm}
"""


def read_again(scene: Description, source: str) -> Description:
    """The description of the mapping, through YAML."""
    return from_text(
        yaml.safe_dump(plain_scene(scene), sort_keys=False, allow_unicode=True), source
    )


def test_shipped_scenes() -> None:
    for path in SHIPPED:
        with case(path):
            described = read(path)._replace(pins=())  # a drawing's alone
            assert read_again(described, str(path)) == described


def test_every_key() -> None:
    for text in (ARM, LOOP, EVERYTHING, AT_JOINTS):
        with case(text):
            described = from_text(text, "my.yaml")
            assert read_again(described, "my.yaml") == described


def test_random_scenes() -> None:
    for seed in range(24):
        for scene in (
            seeded_tree(seed, 4),
            seeded_scene(seed, [*LOOPS.values()][seed % len(LOOPS)]),
        ):
            with case(seed, scene.text):
                described = from_text(forced(seed, scene).text, "my.yaml")
                assert read_again(described, "my.yaml") == described


def test_load_takes_it() -> None:
    mechanism = robodyn.load("four-bar")
    again = robodyn.load(mechanism.to_dict())
    assert again.description._replace(source=mechanism.source) == mechanism.description


def test_what_a_file_may_leave_out_is_left_out() -> None:
    written = plain_scene(from_text(ARM, "my.yaml"))
    assert set(written) == {"name", "gravity", "links"}
    assert set(written["links"][0]) == {"name", "m", "l", "r", "I", "from"}
