"""`robodyn reactions` against hand-written free bodies, other commands, and its own manners."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, TWO_LINK, Outcome, relative_error, text

import oracles

Run = Callable[..., Outcome]
THIRD = "tests/hard_cases/third-crank.yaml"
G = 9.81j  # m/s^2, what a mass at rest needs


NAMES = ("q", "qd", "qdd")


def pairs(forces: list[complex]) -> list[float]:
    return [x for force in forces for x in (force.real, force.imag)]


def cross(a: complex, b: complex) -> float:
    return (a.conjugate() * b).imag


def two_link_forces(q, qd, qdd) -> list[float]:
    """rx1, ry1, rx2, ry2, shake_fx, shake_fy, shake_m of the 2R arm, by its two accelerations."""
    p = TWO_LINK
    e1, e2 = cmath.exp(1j * q[0]), cmath.exp(1j * (q[0] + q[1]))
    a1, a2 = 1j * qdd[0] - qd[0] ** 2, 1j * (qdd[0] + qdd[1]) - (qd[0] + qd[1]) ** 2
    second = p.m2 * (p.l1 * e1 * a1 + p.r2 * e2 * a2 + G)
    first = p.m1 * (p.r1 * e1 * a1 + G) + second
    torque = oracles.two_link_torque(p, q, qd, qdd)[0]
    return [*pairs([first, second]), -first.real, -first.imag, -torque]


TWO_LINK_COLUMNS = ("rx1", "ry1", "rx2", "ry2", "shake_fx", "shake_fy", "shake_m")


def four_bar_forces(q, qd, qdd, tau, force) -> list[float]:
    """All columns of the four-bar: from the coupler's pin force each link alone gives its joint."""
    p = FOUR_BAR
    pin = complex(*force)  # on the coupler
    angles = [q[0], q[0] + q[1], q[2]]
    e1, e2, e3 = (cmath.exp(1j * angle) for angle in angles)
    rates = [(1j * b - w**2) for w, b in zip(absolute(qd), absolute(qdd), strict=True)]
    coupler = p.m2 * (p.l1 * e1 * rates[0] + p.r2 * e2 * rates[1] + G) - pin
    crank = p.m1 * (p.r1 * e1 * rates[0] + G) + coupler
    rocker = p.m3 * (p.r3 * e3 * rates[2] + G) + pin
    shake = -crank - rocker
    moment = -tau - cross(complex(p.d, p.e), rocker)
    return [*pairs([crank, coupler, rocker, pin, shake]), moment]


def absolute(rates) -> list[float]:
    return [rates[0], rates[0] + rates[1], rates[2]]


FOUR_BAR_COLUMNS = (
    *("rx1", "ry1", "rx2", "ry2", "rx3", "ry3", "fx1", "fy1"),
    *("shake_fx", "shake_fy", "shake_m"),
)


def four_bar_motion(seed: int) -> tuple[list[np.ndarray], float, np.ndarray]:
    """q, qd, qdd, the crank's torque and the pin force, at random."""
    theta1, rate, acceleration = np.random.default_rng(seed).uniform(-3, 3, 3)
    q = oracles.four_bar_position(FOUR_BAR, theta1)
    k, k_prime = oracles.four_bar_coefficients(FOUR_BAR, q)
    motion = [q, k * rate, k * acceleration + k_prime * rate**2]
    tau, force = oracles.four_bar_torque(FOUR_BAR, *motion)
    return motion, tau, force


# One state


@pytest.mark.parametrize("seed", range(4))
def test_a_2r_arm(robodyn: Run, seed: int) -> None:
    q, qd, qdd = np.random.default_rng(seed).uniform(-3, 3, (3, 2))
    state = ["reactions", "robots/2r.yaml", "--q", text(q), "--qd", text(qd)]
    given = robodyn(*state, "--qdd", text(qdd)).succeeds()
    assert given.out.splitlines()[0] == ",".join(TWO_LINK_COLUMNS)
    expected = two_link_forces(q, qd, qdd)
    assert relative_error(given.has(*TWO_LINK_COLUMNS), expected) < 1e-13
    tau = oracles.two_link_torque(TWO_LINK, q, qd, qdd)
    given = robodyn(*state, "--tau", text(tau)).succeeds()
    assert relative_error(given.has(*TWO_LINK_COLUMNS), expected) < 1e-12


def test_what_is_left_out_is_zero(robodyn: Run) -> None:
    expected = two_link_forces([0.4, -1.1], [0, 0], [0, 0])
    given = robodyn("reactions", "robots/2r.yaml", "--q", "0.4,-1.1").succeeds()
    assert relative_error(given.has(*TWO_LINK_COLUMNS), expected) < 1e-13
    still = robodyn("reactions", "robots/2r.yaml", "--q", "0.4,-1.1", "--qdd", "0,0").succeeds()
    assert still.out == given.out
    falling = robodyn("reactions", "robots/2r.yaml", "--q", "0.4,-1.1", "--tau", "0,0").succeeds()
    qdd = oracles.two_link_acceleration(TWO_LINK, [0.4, -1.1], [0, 0], [0, 0])
    expected = two_link_forces([0.4, -1.1], [0, 0], qdd)
    assert relative_error(falling.has(*TWO_LINK_COLUMNS), expected) < 1e-12


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("whole", [False, True])
def test_a_four_bar(robodyn: Run, seed: int, whole: bool) -> None:
    motion, tau, force = four_bar_motion(seed)
    expected = four_bar_forces(*motion, tau, force)
    q, qd, qdd, torques = (text(x if whole else x[:1]) for x in (*motion, np.array([tau, 0, 0])))
    for cause in (("--qdd", qdd), ("--tau", torques)):
        state = ["reactions", "robots/four-bar.yaml", "--q", q, "--qd", qd, *cause]
        given = robodyn(*state).succeeds()
        assert given.out.splitlines()[0] == ",".join(FOUR_BAR_COLUMNS)
        assert relative_error(given.has(*FOUR_BAR_COLUMNS), expected) < 1e-10


def test_a_slider_pushes_the_ground(robodyn: Run) -> None:
    """At rest the ground carries the weight, the slider a part of it across its line."""
    given = robodyn("reactions", "robots/slider-crank.yaml", "--q", "50deg").succeeds()
    row = given.row
    assert row["fx1"] == pytest.approx(0, abs=1e-14)
    assert row["shake_fy"] == pytest.approx(-(0.8 + 0.5 + 0.7) * 9.81, rel=1e-13)
    assert row["ry1"] + row["fy1"] == pytest.approx(-row["shake_fy"], rel=1e-13)


def test_damping_of_a_ground_joint_acts_on_the_ground(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    """The link coasts: the damper brakes it, and takes the ground along."""
    path = scene("links: [{name: disc, m: 1, l: 1, r: 0, I: 0.1, damping: 0.4}]\n")
    given = robodyn("reactions", path, "--q", "1", "--qd", "3", "--tau", "0").succeeds()
    assert given.row["shake_m"] == pytest.approx(1.2, rel=1e-13)
    held = robodyn("reactions", path, "--q", "1", "--qd", "3", "--qdd", "0").succeeds()
    assert held.row["shake_m"] == pytest.approx(0, abs=1e-15)


# Streams


@pytest.mark.parametrize("count", [3, 700])
@pytest.mark.parametrize("name", ["qdd", "tau"])
def test_a_batch_of_four_bars(robodyn: Run, count: int, name: str) -> None:
    motions = [four_bar_motion(seed) for seed in range(count)]
    rows = []
    for (q, qd, qdd), tau, _ in motions:
        cause, rate, angle = text([qdd[0] if name == "qdd" else tau, qd[0], q[0]]).split(",")
        rows.append(f"{cause},note,{rate},{angle}\n")
    stdin = f"{name}1,remark,qd1,q1\n" + "".join(rows)
    given = robodyn("reactions", "robots/four-bar.yaml", "-", stdin=stdin).succeeds()
    assert given.out.startswith(f"{name}1,remark,qd1,q1,rx1,ry1,")
    assert {row["remark"] for row in given.rows} == {"note"}
    expected = [four_bar_forces(*motion, tau, force) for motion, tau, force in motions]
    found = np.transpose([given.column(column) for column in FOUR_BAR_COLUMNS])
    assert relative_error(found, expected) < 1e-9


@pytest.mark.parametrize("count", [3, 700])
def test_an_option_stands_for_its_columns_in_every_row(robodyn: Run, count: int) -> None:
    angles = np.random.default_rng(3).uniform(-3, 3, (count, 2))
    stdin = "q1,q2\n" + "".join(text(row) + "\n" for row in angles)
    options = ["--qd", "1,-2", "--tau", "3,4"]
    given = robodyn("reactions", "robots/2r.yaml", "-", *options, stdin=stdin).succeeds()
    expected = []
    for q in angles:
        qdd = oracles.two_link_acceleration(TWO_LINK, q, [1, -2], [3, 4])
        expected.append(two_link_forces(q, [1, -2], qdd))
    found = np.transpose([given.column(column) for column in TWO_LINK_COLUMNS])
    assert relative_error(found, expected) < 1e-10


@pytest.mark.parametrize("model", ["2r", "four-bar", "slider-crank", "five-bar"])
def test_what_simulate_writes(robodyn: Run, model: str) -> None:
    """It holds both, and they belong together; its pin forces come out again."""
    scene = f"robots/{model}.yaml"
    q, tau = ("120deg,60deg", "1,0.5") if model in ("2r", "five-bar") else ("60deg", "0.5")
    options = ["--q", q, "--tau", tau, "--time", "1", "--every", "0.25", "--quiet"]
    motion = robodyn("simulate", scene, *options).succeeds()
    given = robodyn("reactions", scene, "-", stdin=motion.out)
    assert given.code == 0, given.err
    assert len(given.rows) == 5
    for name in ("qdd1", "tau1", "energy"):
        assert given.column(name) == motion.column(name)
    if model != "2r":
        for name in ("fx1", "fy1"):
            assert relative_error(given.column(name), motion.column(name)) < 1e-9
    torques = robodyn("torque", scene, "-", stdin=motion.out).replaces()
    again = robodyn("reactions", scene, "-", stdin=torques.out)
    assert again.code == 0, again.err
    names = ("shake_fx", "shake_fy", "shake_m", "rx1", "ry2")
    for name in names:
        assert relative_error(again.column(name), given.column(name)) < 1e-8


@pytest.mark.parametrize("options", [[], ["--tau", "0,0"]])
def test_a_free_motion_needs_no_torques(
    robodyn: Run, scene: Callable[[str], Path], options: list[str]
) -> None:
    """A free double pendulum has forces too."""
    arm = Path("robots/2r.yaml").read_text() + "actuated: []\n"
    motion = robodyn(
        *("simulate", scene(arm), "--q", "1,2", "--time", "1", "--every", "0.5", "--quiet")
    ).succeeds()
    given = robodyn("reactions", scene(arm), "-", *options, stdin=motion.out)
    expected = [
        two_link_forces(*(np.array([float(row[f"{x}{k}"]) for k in (1, 2)]) for x in NAMES))
        for row in given.succeeds().rows
    ]
    found = np.transpose([given.column(column) for column in TWO_LINK_COLUMNS])
    assert relative_error(found, expected) < 1e-9


def test_without_actuators_at_rest(robodyn: Run, scene: Callable[[str], Path]) -> None:
    """Two links on springs: the joint of link 1 carries both weights less the spring's pull."""
    arm = scene(
        "gravity: 9.81\n"
        "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}, {name: b, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
        "springs: [{joint: a, stiffness: 30, angle: 30deg}, "
        "{between: [b, [0, 2]], stiffness: 20, length: 0.5}]\n"
        "actuated: []\n"
    )
    rest = robodyn("equilibrium", arm, "--format", "csv").succeeds()
    q1, q2 = (rest.column(name)[0] for name in ("q1", "q2"))
    tip = np.exp(1j * q1) + np.exp(1j * (q1 + q2))
    pull = 20.0 * (abs(tip - 2j) - 0.5) * (2j - tip) / abs(tip - 2j)
    held = 2 * 9.81 * 1j - pull
    found = robodyn("reactions", arm, "-", stdin=rest.out).succeeds()
    given = [found.column(name)[0] for name in ("rx1", "ry1")]
    assert given == pytest.approx([held.real, held.imag], abs=1e-9)
    away = f"{q1 + 1e-7!r},{q2!r}"
    found = robodyn("reactions", arm, "--q", away)
    found.fails(1, "residual1 = ", "joint a is free", "or give --tau 0,0")


def test_a_header_alone_is_a_table_without_rows(robodyn: Run) -> None:
    given = robodyn("reactions", "robots/2r.yaml", "-", stdin="q1,q2\n").succeeds()
    assert given.out == ",".join(("q1", "q2", *TWO_LINK_COLUMNS)) + "\n"


# Forms


def test_json_and_table(robodyn: Run) -> None:
    arguments = ["reactions", "robots/2r.yaml", "--q", "1,2", "--qdd", "3,-4", "--format"]
    expected = two_link_forces([1, 2], [0, 0], [3, -4])
    (row,) = robodyn(*arguments, "json").succeeds().json
    assert list(row) == list(TWO_LINK_COLUMNS)
    assert relative_error(list(row.values()), expected) < 1e-12
    table = robodyn(*arguments, "table").succeeds().out
    for part in ("rx1 [N]", "ry2 [N]", "shake_fx [N]", "shake_m [N m]", f"{expected[0]:.6g}"):
        assert part in table


def test_json_of_a_stream(robodyn: Run, tmp_path: Path) -> None:
    out = tmp_path / "forces.json"
    arguments = ["--format", "json", "--out", out]
    robodyn("reactions", "robots/2r.yaml", "-", *arguments, stdin="q1,q2\n1,2\n2,3\n").succeeds()
    assert out.read_text().count("shake_m") == 2


def test_help_says_what_acts_on_what(robodyn: Run) -> None:
    given = robodyn("reactions", "--help").succeeds()
    words = " ".join(given.out.split())
    for part in ("--qdd", "--tau", "on the ground", "opposite sign", "not unique", "Examples:"):
        assert part in words


# What is not unique


@pytest.mark.parametrize("cause", ["--qdd", "--tau"])
@pytest.mark.parametrize("count", [1, 2, 300])
def test_a_third_crank_is_named_once(robodyn: Run, cause: str, count: int) -> None:
    angles = np.linspace(0.4, 2.7, count)
    stdin = "q1\n" + "".join(f"{q}\n" for q in angles)
    given = robodyn("reactions", THIRD, "-", "--qd", "2", cause, "0.5", stdin=stdin)
    assert given.code == 0
    assert given.err.count("\n") == 2, given.err
    assert "the closures depend on one another" in given.err
    named = "fx1,fy1; fx2,fy2; rx1,ry1 (crank); rx2,ry2 (coupler); rx3,ry3 (rocker)"
    assert f"Warning: not unique: {named}; rx4,ry4 (third)\n" in given.err
    # what is given is one answer, and the ground feels the same of all
    crank = np.array(given.column("rx1")) + given.column("rx3") + given.column("rx4")
    assert np.abs(crank + given.column("shake_fx")).max() < 1e-10
    up = np.array(given.column("ry1")) + given.column("ry3") + given.column("ry4")
    assert np.abs(up + given.column("shake_fy")).max() < 1e-10


def test_what_hangs_from_the_loop_is_unique(robodyn: Run, scene: Callable[[str], Path]) -> None:
    bob = "  - {name: bob, m: 0.2, l: 0.2, r: 0.1, I: 0.001, from: coupler}\nclosures:"
    path = scene(Path(THIRD).read_text().replace("closures:", bob))
    given = robodyn("reactions", path, "--q", "60deg,20deg")
    assert given.code == 0
    assert "bob" not in given.err
    assert "rx4,ry4 (third)\n" in given.err
    assert given.row["ry5"] == pytest.approx(0.2 * 9.81, rel=1e-13)


def test_a_change_point(robodyn: Run) -> None:
    arguments = ["reactions", "robots/parallelogram.yaml", "--q", "0,0,0"]
    given = robodyn(*arguments, "--qd", "1,-1,1")
    assert given.code == 0
    named = "fx1,fy1; rx1,ry1 (crank); rx2,ry2 (coupler); rx3,ry3 (rocker)"
    assert f"Warning: not unique: {named}\n" in given.err
    weight = (0.45 + 1.1 + 0.55) * 9.81
    assert given.row["shake_fy"] == pytest.approx(-weight, rel=1e-12)
    assert robodyn(*arguments, "--tau", "1").fails(1, "change point").out == ""


@pytest.mark.parametrize("count", [2, 300])
def test_a_change_point_in_a_batch(robodyn: Run, count: int) -> None:
    """Torques cause no one acceleration there: the row is named, and its fields are empty."""
    stdin = "q1\n" + "".join(f"{q}\n" for q in [*np.linspace(0.5, 2.5, count - 1), 0.0])
    options = ["--tau", "1"]
    failed = robodyn("reactions", "robots/parallelogram.yaml", "-", *options, stdin=stdin)
    failed.fails(1, f"stdin: line {count + 1}", "change point")
    *_, before, last = failed.rows
    assert len(failed.rows) == count
    assert all(before.values())
    assert last == dict.fromkeys(before, "") | {"q1": "0.0"}


def test_too_many_actuators(robodyn: Run, scene: Callable[[str], Path], four_bar_text: str) -> None:
    """The torques are those of least norm, as `torque` has them; no pin is named."""
    path = scene(four_bar_text.replace("actuated: [crank]", "actuated: [crank, rocker]"))
    given = robodyn("reactions", path, "--q", text(oracles.four_bar_position(FOUR_BAR, 1.0)))
    assert given.code == 0
    assert "torques of least norm" in given.err
    assert "not unique" not in given.err


# Errors


@pytest.mark.parametrize("rates", [[], ["--qd", "1"]])
def test_a_dead_centre_is_named_as_torque_does(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str, rates: list[str]
) -> None:
    """The rocker cannot drive the crank where crank and coupler lie in line."""
    path = scene(four_bar_text.replace("actuated: [crank]", "actuated: [rocker]"))
    p = FOUR_BAR
    reach = (p.d**2 + p.l3**2 - (p.l1 + p.l2) ** 2) / (2 * p.d * p.l3)
    arguments = [path, "--q", repr(math.pi - math.acos(reach) - 1e-12), *rates]
    torque = robodyn("torque", *arguments)
    torque.fails(1, "dead centre")
    given = robodyn("reactions", *arguments)
    assert (given.code, given.err) == (torque.code, torque.err)
