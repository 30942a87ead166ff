"""`robodyn assemble` against Freudenstein's equation and the geometry of the links."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, SCOTCH_YOKE, Outcome, relative_error
from sliding_scenes import LEVER, SCISSORS

import oracles

Run = Callable[..., Outcome]
RATE, ACCELERATION = 5.0, -7.0


def values(row: dict[str, str], name: str, count: int = 3) -> list[float]:
    return [float(row[f"{name}{k + 1}"]) for k in range(count)]


def place(row: dict[str, str], part: str, k: int) -> tuple[complex, complex]:
    """Position and velocity of a part of a link."""
    x, y, vx, vy = (float(row[f"{part}_{name}{k}"]) for name in ("x", "y", "vx", "vy"))
    return complex(x, y), complex(vx, vy)


@pytest.mark.parametrize("theta1", [0.3, math.pi / 3, 2.4, -1.0])
def test_a_four_bar_closes_in_two_ways(robodyn: Run, theta1: float) -> None:
    given = robodyn(
        *("assemble", "robots/four-bar.yaml", "--q", theta1, "--qd", RATE, "--qdd", ACCELERATION)
    ).succeeds()
    assert [row["branch"] for row in given.rows] == ["open", "crossed"]
    for row in given.rows:
        q = oracles.four_bar_position(FOUR_BAR, theta1, row["branch"])
        k, k_prime = oracles.four_bar_coefficients(FOUR_BAR, q)
        assert relative_error(values(row, "q"), q) < 1e-13
        assert relative_error(values(row, "qd"), k * RATE) < 1e-12
        assert relative_error(values(row, "qdd"), k * ACCELERATION + k_prime * RATE**2) < 1e-12


def test_every_point_of_a_four_bar(robodyn: Run) -> None:
    given = robodyn("assemble", "robots/four-bar.yaml", "--q", "60deg", "--qd", RATE).succeeds()
    for row in given.rows:
        q = oracles.four_bar_position(FOUR_BAR, math.pi / 3, row["branch"])
        qd = oracles.four_bar_coefficients(FOUR_BAR, q)[0] * RATE
        angles = [q[0], q[0] + q[1], q[2]]
        rates = [qd[0], qd[0] + qd[1], qd[2]]
        turns = [cmath.exp(1j * angle) for angle in angles]
        pin, pin_speed = 0.35 * turns[0], 0.35 * turns[0] * 1j * rates[0]
        joints = [(0j, 0j), (pin, pin_speed), (1.1 + 0j, 0j)]
        for k, (l, r) in enumerate([(0.35, 0.15), (0.95, 0.45), (0.80, 0.36)]):
            at, speed = joints[k]
            for part, along in (("joint", 0.0), ("tip", l), ("centre", r)):
                arm = along * turns[k]
                expected = [at + arm, speed + 1j * rates[k] * arm]
                found = place(row, part, k + 1)
                assert np.abs(np.array(found) - expected).max() < 1e-12
        tips = [place(row, "tip", k)[0] for k in (2, 3)]
        assert abs(tips[0] - tips[1]) < 1e-14


def test_open_has_the_pin_to_the_left_of_the_line_from_a_to_d(robodyn: Run) -> None:
    """A the joint of the side named first, D that of the other, P the pin."""
    for degrees in range(-170, 180, 20):
        given = robodyn("assemble", "robots/four-bar.yaml", "--q", f"{degrees}deg").succeeds()
        for row, side in zip(given.rows, (1, -1), strict=True):
            A, D, P = place(row, "joint", 2)[0], place(row, "joint", 3)[0], place(row, "tip", 2)[0]
            assert side * ((D - A).conjugate() * (P - A)).imag > 0


def test_the_scenes_own_branch_comes_first(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    crossed = scene(four_bar_text.replace("assembly: open", "assembly: crossed"))
    given = robodyn("assemble", crossed, "--q", "60deg").succeeds()
    assert [row["branch"] for row in given.rows] == ["crossed", "open"]
    q = oracles.four_bar_position(FOUR_BAR, math.pi / 3, "crossed")
    assert relative_error(values(given.rows[0], "q"), q) < 1e-13
    plain = robodyn("assemble", "robots/four-bar.yaml", "--q", "60deg").succeeds()
    assert given.rows == plain.rows[::-1]


def test_a_slider_lies_ahead_or_behind_along_its_line(robodyn: Run) -> None:
    given = robodyn("assemble", "robots/slider-crank.yaml", "--q", "50deg", "--qd", "10").succeeds()
    theta, l1, l2 = math.radians(50), 0.10, 0.32
    rise = 0.02 - l1 * math.sin(theta)
    for row, side in zip(given.rows, (1, -1), strict=True):
        reach = side * math.sqrt(l2**2 - rise**2)
        piston, speed = place(row, "tip", 2)
        assert abs(piston - complex(l1 * math.cos(theta) + reach, 0.02)) < 1e-15
        # d/dt of l1 cos theta +- sqrt(l2^2 - rise^2)
        slope = -l1 * math.sin(theta) + rise * l1 * math.cos(theta) / reach
        assert abs(speed - 10 * slope) < 1e-13
    assert [row["branch"] for row in given.rows] == ["open", "crossed"]


def test_a_five_bar_meets_at_its_pin(robodyn: Run) -> None:
    given = robodyn("assemble", "robots/five-bar.yaml", "--q", "120deg,60deg", "--qd", "1,-2")
    assert [row["branch"] for row in given.succeeds().rows] == ["open", "crossed"]
    A, D = 0.30 * cmath.exp(2j * math.pi / 3), 0.7 + 0.26 * cmath.exp(1j * math.pi / 3)
    for row, side in zip(given.rows, (1, -1), strict=True):
        P, speed = place(row, "tip", 2)
        assert abs(abs(P - A) - 0.68) < 1e-14
        assert abs(abs(P - D) - 0.64) < 1e-14
        assert side * ((D - A).conjugate() * (P - A)).imag > 0
        assert abs(P - place(row, "tip", 4)[0]) < 1e-14
        assert abs(speed - place(row, "tip", 4)[1]) < 1e-13
        # rods are rigid: the speed of P against A's is square to the rod
        assert abs(((P - A).conjugate() * (speed - 1j * 1 * A)).real) < 1e-14
        assert abs(((P - D).conjugate() * (speed + 2j * (D - 0.7))).real) < 1e-14
        assert values(row, "qd", 4)[::2] == [1.0, -2.0]


def test_an_open_chain_has_one_way(robodyn: Run) -> None:
    given = robodyn("assemble", "robots/2r.yaml", "--q", "30deg,45deg", "--qd", "1,0.5").succeeds()
    (row,) = given.rows
    first, second = cmath.exp(1j * math.pi / 6), cmath.exp(1j * math.radians(75))
    tip, speed = place(row, "tip", 2)
    assert abs(tip - (0.8 * first + 0.6 * second)) < 1e-15
    assert abs(speed - 1j * (0.8 * first * 1 + 0.6 * second * 1.5)) < 1e-14
    assert (values(row, "qd", 2), values(row, "qdd", 2)) == ([1.0, 0.5], [0.0, 0.0])


def test_all_joints_given_are_checked_and_kept(robodyn: Run) -> None:
    q = oracles.four_bar_position(FOUR_BAR, 1.0, "crossed")
    text = ",".join(map(repr, q.tolist()))
    (row,) = robodyn("assemble", "robots/four-bar.yaml", "--q", text).succeeds().rows
    assert values(row, "q") == q.tolist()


SIX_BAR = """\
links:
  - {name: crank,   m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker,  m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}
  - {name: rod,     m: 0.4, l: 0.90, r: 0.41, I: 0.03, from: {link: rocker, at: [0.5, 0.0]}}
closures:
  - [coupler, rocker]
  - {point: rod, on: {through: [0, 0.1], along: [1, 0]}}
actuated: [crank]
"""


def test_two_closures_close_in_four_ways(robodyn: Run, scene: Callable[[str], Path]) -> None:
    given = robodyn("assemble", scene(SIX_BAR), "--q", "60deg").succeeds()
    names = [row["branch"] for row in given.rows]
    assert names[0] == "open open"
    assert sorted(names) == ["crossed crossed", "crossed open", "open crossed", "open open"]
    for row in given.rows:
        loop, line = row["branch"].split()
        q = oracles.four_bar_position(FOUR_BAR, math.pi / 3, loop)
        assert relative_error(values(row, "q"), q) < 1e-13
        foot = 1.1 + 0.5 * cmath.exp(1j * q[2])
        reach = math.sqrt(0.9**2 - (foot.imag - 0.1) ** 2) * (1 if line == "open" else -1)
        assert abs(place(row, "tip", 4)[0] - complex(foot.real + reach, 0.1)) < 1e-13


def coupled(theta1: float) -> tuple[np.ndarray, complex]:
    """The four-bar's angles, and the point of its coupler that the rod of STEPHENSON holds."""
    q = oracles.four_bar_position(FOUR_BAR, theta1)
    turn = cmath.exp(1j * (q[0] + q[1]))
    return q, 0.35 * cmath.exp(1j * theta1) + turn * (0.5 + 0.3j)


# A six-bar whose four-bar is driven through a rod: no closure has two unknown links only.
CRANK, PIVOT = 0.3, 0.2 - 0.9j
ROD = abs(coupled(1.0)[1] - (PIVOT + CRANK * cmath.exp(0.7j)))
STEPHENSON = f"""\
links:
  - {{name: left,  m: 0.6, l: 0.35, r: 0.15, I: 0.008}}
  - {{name: plate, m: 1.3, l: 0.95, r: 0.45, I: 0.102}}
  - {{name: right, m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}}
  - {{name: crank, m: 0.5, l: {CRANK}, r: 0.13, I: 0.004, from: [{PIVOT.real}, {PIVOT.imag}]}}
  - {{name: rod,   m: 0.7, l: {ROD!r}, r: 0.5, I: 0.05}}
closures:
  - [plate, right]
  - [rod, {{link: plate, at: [0.5, 0.3]}}]
actuated: [crank]
"""


def started() -> tuple[list[float], str]:
    """Closed angles of STEPHENSON, and the scene with a start that is near them."""
    q, point = coupled(1.0)
    tip = PIVOT + CRANK * cmath.exp(0.7j)
    angles = [*q, 0.7, cmath.phase(point - tip) - 0.7]
    degrees = [round(math.degrees(angle)) for angle in angles]
    start = "left: {}deg, plate: {}deg, right: {}deg, crank: 0.7, rod: {}deg"
    return angles, STEPHENSON + f"start: {{{start.format(*degrees[:3], degrees[4])}}}\n"


@pytest.mark.parametrize("crank", [0.7, 0.5, 0.8])
def test_a_larger_loop_closes_from_its_start(
    robodyn: Run, scene: Callable[[str], Path], crank: float
) -> None:
    angles, text = started()
    path = scene(text)
    (row,) = robodyn("assemble", path, "--q", crank).succeeds().rows
    found = values(row, "q", 5)
    assert found[3] == crank
    if crank == 0.7:
        assert relative_error(found, angles) < 1e-12
    known, point = coupled(found[0])
    assert relative_error(found[:3], known) < 1e-12
    assert abs(place(row, "tip", 5)[0] - point) < 1e-12
    assert abs(abs(point - PIVOT - CRANK * cmath.exp(1j * crank)) - ROD) < 1e-12


# Formats


def test_json_names_links_and_parts(robodyn: Run) -> None:
    arguments = ["assemble", "robots/four-bar.yaml", "--q", "60deg", "--qd", "5"]
    found = robodyn(*arguments, "--format", "json").succeeds().json
    rows = robodyn(*arguments).succeeds().rows
    for branch, row in zip(found["branches"], rows, strict=True):
        assert branch["branch"] == row["branch"]
        for name in ("q", "qd", "qdd"):
            assert branch[name] == values(row, name)
        assert [link["name"] for link in branch["links"]] == ["crank", "coupler", "rocker"]
        for k, link in enumerate(branch["links"], start=1):
            for part in ("joint", "tip", "centre"):
                x, y, vx, vy = (link[part][name] for name in ("x", "y", "vx", "vy"))
                assert (complex(x, y), complex(vx, vy)) == place(row, part, k)


def test_the_table(robodyn: Run) -> None:
    arguments = ["assemble", "robots/four-bar.yaml", "--q", "60deg", "--format", "table"]
    given = robodyn(*arguments).succeeds().out
    for word in (
        *("open", "crossed", "crank", "coupler", "rocker", "joint", "tip", "centre"),
        *("q [rad]", "q [deg]", "qd [rad/s]", "qdd [rad/s²]", "x [m]", "vy [m/s]"),
    ):
        assert word in given
    for branch in ("open", "crossed"):
        q = oracles.four_bar_position(FOUR_BAR, math.pi / 3, branch)
        assert f"{math.degrees(q[2]):.6g}" in given


def test_joints_that_slide_have_a_table_of_their_own(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    arguments = ["assemble", scene(SCOTCH_YOKE), "--q", "60deg", "--qd", "2", "--format", "table"]
    given = robodyn(*arguments).succeeds().out
    turning, sliding = (given.index(head) for head in ("q [deg]", "q [m]"))
    assert turning < given.index("1 crank") < sliding < given.index("2 yoke") < given.index("x [m]")
    for word in ("qd [rad/s]", "qd [m/s]", "qdd [rad/s²]", "qdd [m/s²]", f"{0.1 * 0.5:.6g}"):
        assert word in given
    given = robodyn("assemble", scene(RAIL), "--q", "0.7", "--format", "table").succeeds().out
    assert given.startswith("given\n")
    assert "rad" not in given


RAIL = "links: [{name: a, joint: prismatic, axis: [1, 0], m: 1, l: 1, r: 0.5, I: 0.1}]\n"


@pytest.mark.parametrize("name", ["[red]arm", "[/red]arm", "[/]", "[bold]", ":smile:", r"a\[b"])
def test_names_are_shown_as_they_are(robodyn: Run, scene: Callable[[str], Path], name: str) -> None:
    path = scene(f"links: [{{name: '{name}', m: 1, l: 1, r: 0.5, I: 0.1}}]\n")
    given = robodyn("assemble", path, "--q", "1", "--format", "table").succeeds()
    assert f"1 {name} " in given.out


def test_out(robodyn: Run, tmp_path: Path) -> None:
    for format in ("csv", "json", "table"):
        file = tmp_path / format
        arguments = ["assemble", "robots/2r.yaml", "--q", "1,2", "--format", format]
        assert robodyn(*arguments, "-o", file).succeeds().out == ""
        assert file.read_text() == robodyn(*arguments).succeeds().out


# Errors


def test_what_cannot_be_closed_tells_distance_and_range(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    """With the rocker's pivot at 1.9 m crank and coupler reach the rocker only here and there."""
    path = scene(four_bar_text.replace("[1.1, 0.0]", "[1.9, 0.0]"))
    # |A - D| <= 0.95 + 0.80 where |A - D|^2 = 0.35^2 + 1.9^2 - 2 0.35 1.9 cos q1
    limit = math.degrees(math.acos((0.35**2 + 1.9**2 - 1.75**2) / (2 * 0.35 * 1.9)))
    failed = robodyn("assemble", path, "--q", "180deg")
    told = f"{math.floor(limit * 1e4) / 1e4:.8g}"  # rounded into the range
    failed.fails(1, str(path), "q1 = 180 deg", "0.5 m", f"[-{told}, {told}] deg", "crank")
    assert failed.out == ""
    inside = robodyn("assemble", path, "--q", f"{limit - 1e-3}deg").succeeds()
    assert len(inside.rows) == 2
    robodyn("assemble", path, "--q", f"{limit + 1e-3}deg").fails(1, "cannot be closed")


def test_what_can_never_be_closed(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    path = scene(four_bar_text.replace("[1.1, 0.0]", "[11, 0.0]"))
    robodyn("assemble", path, "--q", "0").fails(1, "8.9 m", "no angle")


def test_a_larger_loop_that_cannot_be_closed_is_soon_told(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    path = scene(started()[1])
    failed = robodyn("assemble", path, "--q", "1.1")
    failed.fails(1, str(path), "cannot be closed at q4 = 63.0254 deg", "q4 (crank) can reach")
    assert failed.seconds < 4


def test_a_change_point_is_named(robodyn: Run) -> None:
    still = robodyn("assemble", "robots/parallelogram.yaml", "--q", "0")
    assert still.code == 0
    assert "change point" in still.err
    open_, crossed = still.rows
    assert values(open_, "q") == values(crossed, "q") == [0.0, 0.0, 0.0]
    moving = robodyn("assemble", "robots/parallelogram.yaml", "--q", "0", "--qd", "1")
    assert moving.fails(1, "robots/parallelogram.yaml", "change point").out == ""


def test_branches_that_do_not_tell_a_pose_are_left_out(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    given = robodyn("assemble", scene(SCISSORS), "--q", "30deg").succeeds()
    assert [row["branch"] for row in given.rows] == ["open open", "open crossed"]
    wanted = [math.pi / 6, 5 * math.pi / 6, -math.pi / 3]
    assert values(given.rows[0], "q") == pytest.approx(wanted, abs=1e-14)
    path = scene(LEVER)
    for options in ((), ("--range",), ("--format", "json")):
        failed = robodyn("assemble", path, "--q", "0", *options)
        assert failed.fails(1, str(path), "singular configuration", "q2 (lever)").out == ""
    assert len(robodyn("assemble", path, "--q", "0,90deg").rows) == 1


def test_rates_beyond_the_floats_do_no_harm(process: Run) -> None:
    """Their squares overflow; what is told is a number, or there is a message."""
    for model, q, qd in (("2r", "1,2", "1e200,1"), ("four-bar", "1", "1e200")):
        given = process("assemble", f"robots/{model}.yaml", "--q", q, "--qd", qd)
        assert "nan" not in given.out
        assert "RuntimeWarning" not in given.err
        assert given.code in (0, 1)
