"""Postures of one place: against circles of the test's own, and poses that were drawn at random."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import Outcome

import robodyn as api

Run = Callable[..., Outcome]
FIVE = (0.30, 0.68, 0.26, 0.64, 0.7)  # of robots/five-bar.yaml: rods, and the second pivot's x


def elbows(a: float, b: float, p: complex) -> list[complex]:
    """Where two circles meet, about 0 and p: the one to the left of the way to p first."""
    d = abs(p)
    along = (a * a - b * b + d * d) / (2 * d)
    up = math.sqrt(a * a - along * along)
    return [p / d * complex(along, side * up) for side in (1.0, -1.0)]


def joints(elbow: complex, p: complex) -> list[float]:
    first = cmath.phase(elbow)
    return [first, cmath.phase((p - elbow) / elbow)]


def same(q: object, wanted: object) -> bool:
    apart = np.asarray(q, float) - np.asarray(wanted, float)
    return bool(np.abs(np.exp(1j * apart) - 1.0).max() < 1e-9)


def lengths() -> tuple[float, float]:
    first, second = api.load("2r").description.links[:2]
    return first.l, second.l


def scene_3rrr(start: str = "") -> api.Mechanism:
    """A plate on three legs of two links each, from three corners of a triangle."""
    at = {"2": "[1.0, 0.0]", "3": "[0.5, 0.9]"}
    links = [
        "  - {name: a1, m: 1, l: 0.4, r: 0.2, I: 0.02}",
        "  - {name: b1, m: 1, l: 0.4, r: 0.2, I: 0.02}",
        "  - {name: plate, m: 1, l: 0.2, r: 0.1, I: 0.02}",
    ]
    for leg, base in at.items():
        links.append(f"  - {{name: a{leg}, m: 1, l: 0.4, r: 0.2, I: 0.02, from: {base}}}")
        links.append(f"  - {{name: b{leg}, m: 1, l: 0.4, r: 0.2, I: 0.02}}")
    closures = "closures:\n  - [b2, plate]\n  - [b3, 'plate@0.1,0.17']\n"
    text = "name: 3rrr\nlinks:\n" + "\n".join(links) + "\n" + closures
    return api.load(text + "actuated: [a1, a2, a3]\n" + start)


@pytest.mark.parametrize("seed", range(10))
def test_an_arm_of_two_joints_has_both_postures(robodyn: Run, seed: int) -> None:
    a, b = lengths()
    rng = np.random.default_rng(seed)
    d, turn = rng.uniform(abs(a - b) + 0.02, a + b - 0.02), rng.uniform(-3, 3)
    p = cmath.rect(d, turn)
    given = robodyn("assemble", "2r", "--of", "tip2", f"--to-xy={p.real!r},{p.imag!r}").succeeds()
    assert sorted(row["branch"] for row in given.rows) == ["left", "right"]
    for row in given.rows:
        wanted = joints(elbows(a, b, p)[row["branch"] == "right"], p)
        assert same([float(row["q1"]), float(row["q2"])], wanted)
        assert float(row["tip_x2"]) == pytest.approx(p.real, abs=1e-12)
        assert float(row["tip_y2"]) == pytest.approx(p.imag, abs=1e-12)


def test_the_posture_nearest_to_q_comes_first(robodyn: Run) -> None:
    for near, first in (("0,1", "right"), ("1,-1", "left")):
        words = ("assemble", "2r", "--of", "tip2", "--to-xy", "0.5,0.6", "--q", near)
        assert robodyn(*words).succeeds().rows[0]["branch"] == first


def test_a_stretched_and_a_folded_arm_have_one_posture() -> None:
    arm, (a, b) = api.load("2r"), lengths()
    for d, word, bend in ((a + b, "stretched", 0.0), (abs(a - b), "folded", math.pi)):
        found = api.postures(arm, [d * math.cos(0.4), d * math.sin(0.4)], "tip2")
        assert [posture.branch for posture in found] == [word]
        assert abs(math.remainder(found[0].q[1] - bend, 2 * math.pi)) < 1e-6


def test_an_arm_that_slides_goes_ahead_or_behind() -> None:
    arm = api.load("rp-arm")
    found = api.postures(arm, [0.4, 0.6], "tip2")
    assert sorted(posture.branch for posture in found) == ["ahead", "behind"]
    for posture in found:
        assert np.allclose(api.points(arm, posture.q, [0, 0], [0, 0], of="tip2")[1], [0.4, 0.6])


def test_a_row_goes_on_to_torque(robodyn: Run) -> None:
    rows = robodyn("assemble", "2r", "--of", "tip2", "--to-xy", "0.5,0.6").succeeds().out
    given = robodyn("torque", "2r", "-", stdin=rows).succeeds()
    for row in given.rows:
        q = [float(row["q1"]), float(row["q2"])]
        tau = api.inverse_dynamics(api.load("2r"), q, [0, 0], [0, 0])
        assert [float(row["tau1"]), float(row["tau2"])] == pytest.approx(tau.tolist())


@pytest.mark.parametrize("near", range(4))
def test_a_five_bar_takes_the_posture_nearest_to_all_joints(near: int) -> None:
    bar, p = api.load("five-bar"), 0.33 + 0.6j
    a, b, c, d, x = FIVE
    every = [
        [*joints(left, p), *joints(right, p - x)]
        for left in elbows(a, b, p)
        for right in elbows(c, d, p - x)
    ]
    guess = np.add(every[near], [0.05, -0.04, 0.03, 0.05])
    (found,) = api.postures(bar, [p.real, p.imag], "left rod", near=guess)
    assert same(found.q, every[near])


def test_a_five_bar_keeps_the_word_of_the_scene(robodyn: Run) -> None:
    words = ("assemble", "five-bar", "--of", "left rod", "--to-xy")
    row = robodyn(*words, "0.3,0.7").succeeds().rows[0]
    assert row["branch"] == "open"
    q = api.assemble(api.load("five-bar"), [float(row["q1"]), float(row["q3"])])
    assert same(q, [float(row[f"q{k}"]) for k in range(1, 5)])
    below = robodyn(*words, "0.3,-0.7")
    assert below.code == 1
    assert "as open; as crossed it does" in below.err


@pytest.mark.parametrize("seed", range(8))
def test_a_plate_on_three_legs_takes_one_command(seed: int) -> None:
    plate = scene_3rrr()
    rng = np.random.default_rng(seed)
    p, turn = complex(*rng.uniform([0.35, 0.2], [0.5, 0.35])), rng.uniform(-0.3, 0.3)
    corners = [p, p + 0.2 * cmath.exp(1j * turn), p + (0.1 + 0.17j) * cmath.exp(1j * turn)]
    legs = [elbows(0.4, 0.4, z - o) for z, o in zip(corners, (0, 1, 0.5 + 0.9j), strict=True)]
    side = rng.integers(0, 2, 3)
    one, two, three = (
        joints(leg[k], z - o)
        for leg, k, z, o in zip(legs, side, corners, (0, 1, 0.5 + 0.9j), strict=True)
    )
    wanted = [*one, turn - sum(one), *two, *three]
    guess = np.array(wanted) + rng.uniform(-0.05, 0.05, 7)
    (found,) = api.postures(plate, [p.real, p.imag], "joint3", angle=turn, near=guess)
    assert same(found.q, wanted)
    (free,) = api.postures(plate, [p.real, p.imag], "joint3", angle=turn)
    assert np.abs(api.closure_gap(plate, free.q)).max() < 1e-12


@pytest.mark.parametrize("seed", range(6))
def test_a_redundant_arm_moves_least(seed: int) -> None:
    arm = api.load("3r")
    rng = np.random.default_rng(seed)
    near = np.add(rng.uniform(-1, 1, 3), [0, 1.2, 0.8])
    zero = np.zeros(3)
    xy = api.points(arm, near + rng.uniform(-0.3, 0.3, 3), zero, zero, of="tip3")[1][0]
    (found,) = api.postures(arm, xy, "tip3", near=near)
    _, there, _, _ = api.points(arm, found.q, zero, zero, of="tip3")
    assert np.allclose(there[0], xy, atol=1e-12)
    # of least change: the change is along what moves the point, by differences
    J = np.array(
        [
            api.points(arm, found.q + h, zero, zero, of="tip3")[1][0]
            - api.points(arm, found.q - h, zero, zero, of="tip3")[1][0]
            for h in 1e-6 * np.eye(3)
        ]
    )
    null = np.cross(J[:, 0], J[:, 1])
    assert abs((found.q - near) @ null) < 1e-4 * np.linalg.norm(null)


def test_a_stretched_start_is_left_too() -> None:
    arm = api.load("3r")
    (found,) = api.postures(arm, [0.4, 0.6], "tip3", near=[0.0, 0.0, 0.0])
    there = api.points(arm, found.q, [0, 0, 0], [0, 0, 0], of="tip3")[1][0]
    assert np.allclose(there, [0.4, 0.6], atol=1e-12)


def test_the_angle_of_the_link(robodyn: Run) -> None:
    words = ("assemble", "3r", "--of", "tip3", "--to-xy", "0.4,0.6")
    row = robodyn(*words, "--angle", "hand=30deg").succeeds().rows[0]
    assert math.isclose(sum(float(row[f"q{k}"]) for k in (1, 2, 3)) % math.tau, math.pi / 6)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("2r", "--to-xy", "0.5,0.6"), "--of: missing"),
        (("2r", "--of", "tip2"), "--of = tip2: goes with --to-xy"),
        (("2r", "--angle", "forearm=1", "--q", "0,0"), "--angle = forearm=1: goes with --to-xy"),
        (("2r", "--of", "tip2", "--to-xy", "0.5"), "--to-xy = 0.5: must be x,y"),
        (("2r", "--of", "tip9", "--to-xy", "0.5,0.6"), "--of = tip9"),
        (("2r", "--of", "tip2", "--to-xy", "0.5,0.6", "--angle", "forearm=1"), "need 3"),
        (("3r", "--of", "tip3", "--to-xy", "0.4,0.6", "--angle", "1"), "must be hand=VALUE"),
        (("3r", "--of", "tip3", "--to-xy", "0.4,0.6", "--angle", "foot=1"), "must be hand=VALUE"),
        (("3r", "--of", "tip3", "--to-xy", "0.4,0.6", "--q", "1"), "--q"),
        (("four-bar", "--of", "tip2", "--to-xy", "0.4,0.6"), "x and y need 2"),
    ],
)
def test_what_is_refused(robodyn: Run, words: tuple[str, ...], told: str) -> None:
    given = robodyn("assemble", *words)
    assert given.code == 2
    assert told in given.err


def test_out_of_reach(robodyn: Run) -> None:
    a, b = lengths()
    given = robodyn("assemble", "2r", "--of", "tip2", "--to-xy", "3,4")
    assert given.code == 1
    assert "tip2 does not reach (3, 4): it is 5 m from the joint of upper arm" in given.err
    assert f"{abs(a - b):.9g} to {a + b:.9g} m are reached" in given.err
    for words in (("3r", "--of", "tip3"), ("five-bar", "--of", "left rod")):
        given = robodyn("assemble", *words, "--to-xy", "3,4")
        assert given.code == 1
        assert "does not reach (3, 4): it is 5 m from the joint of" in given.err


def test_a_posture_beyond_limits_comes_last_with_a_note(robodyn: Run, tmp_path: Path) -> None:
    scene = tmp_path / "arm.yaml"
    link = "m: 1, l: 0.5, r: 0.2, I: 0.02"
    for limits, code in (("{min: -180deg, max: 0}", 0), ("{min: -1deg, max: 1deg}", 1)):
        scene.write_text(f"""links:
  - {{name: a, {link}}}
  - {{name: b, {link}, limits: {limits}}}
""")
        given = robodyn("assemble", scene, "--of", "b", "--to-xy", "0.5,0.4", "--q", "0,1")
        assert given.code == code
        if code == 0:
            assert [row["branch"] for row in given.rows] == ["left", "right"]
            assert "Note: right: q2 (b)" in given.err
        else:
            assert "is beyond the joint's" in given.err
