"""`robodyn accel` against Cramer's rule, equation (33) and the four-bar's reduction."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, RP_ARM, TWO_LINK, Outcome, relative_error, text

import oracles

Run = Callable[..., Outcome]


def four_bar_state(seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """q, qd and crank torque at random."""
    theta1, rate, tau = np.random.default_rng(seed).uniform(-3, 3, 3)
    q = oracles.four_bar_position(FOUR_BAR, theta1)
    return q, oracles.four_bar_coefficients(FOUR_BAR, q)[0] * rate, tau


@pytest.mark.parametrize("seed", range(4))
def test_a_2r_arm(robodyn: Run, seed: int) -> None:
    q, qd, tau = np.random.default_rng(seed).uniform(-3, 3, (3, 2))
    given = robodyn(
        *("accel", "robots/2r.yaml", "--q", text(q), "--qd", text(qd), "--tau", text(tau))
    ).succeeds()
    expected = oracles.two_link_acceleration(TWO_LINK, q, qd, tau)
    assert given.out.splitlines()[0] == "qdd1,qdd2"
    assert relative_error(given.has("qdd1", "qdd2"), expected) < 1e-12


def test_rates_and_torques_left_out_are_zero(robodyn: Run) -> None:
    given = robodyn("accel", "robots/2r.yaml", "--q", "-30deg,45deg").succeeds()
    q = np.radians([-30, 45])
    expected = oracles.two_link_acceleration(TWO_LINK, q, np.zeros(2), np.zeros(2))
    assert relative_error(given.has("qdd1", "qdd2"), expected) < 1e-12


def test_a_pendulum_falls_as_a_pendulum_does(robodyn: Run) -> None:
    """thetadd = -omega0^2 sin theta, theta from the downward vertical."""
    given = robodyn("accel", "robots/pendulum.yaml", "--q", "-60deg").succeeds()
    omega0 = float(oracles.pendulum_frequency(0.4, 0.26, 0.0088))
    assert given.row["qdd1"] == pytest.approx(-(omega0**2) * math.sin(math.pi / 6), rel=1e-13)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("whole", [False, True])
def test_a_four_bar(robodyn: Run, seed: int, whole: bool) -> None:
    q, qd, tau = four_bar_state(seed)
    torques = [tau, 0.0, 0.0]
    given = [text(x) if whole else text(x[:1]) for x in (q, qd, torques)]
    found = robodyn(
        *("accel", "robots/four-bar.yaml", "--q", given[0], "--qd", given[1], "--tau", given[2])
    ).succeeds()
    qdd, force = oracles.four_bar_acceleration(FOUR_BAR, q, qd, torques)
    assert found.out.splitlines()[0] == "qdd1,qdd2,qdd3,fx1,fy1"
    columns = ("qdd1", "qdd2", "qdd3", "fx1", "fy1")
    assert relative_error(found.has(*columns), [*qdd, *force]) < 1e-11
    reduced = oracles.four_bar_reduced_acceleration(FOUR_BAR, q[0], qd[0], tau)
    assert found.row["qdd1"] == pytest.approx(reduced, rel=1e-10)


def test_torques_on_passive_joints_count(robodyn: Run) -> None:
    q, qd, tau = four_bar_state(9)
    torques = [tau, 0.7, -1.3]
    found = robodyn(
        *("accel", "robots/four-bar.yaml", "--q", text(q), "--qd", text(qd)),
        *("--tau", text(torques)),
    ).succeeds()
    qdd, force = oracles.four_bar_acceleration(FOUR_BAR, q, qd, torques)
    columns = ("qdd1", "qdd2", "qdd3", "fx1", "fy1")
    assert relative_error(found.has(*columns), [*qdd, *force]) < 1e-11


@pytest.mark.parametrize("count", [2, 600])
def test_a_batch_of_arms(robodyn: Run, count: int) -> None:
    rows = np.random.default_rng(2).uniform(-3, 3, (count, 6))
    stdin = "tau1,q1,tau2,q2,qd2,qd1\n" + "".join(text(row) + "\n" for row in rows)
    given = robodyn("accel", "robots/2r.yaml", "-", stdin=stdin).succeeds()
    assert given.out.splitlines()[0] == "tau1,q1,tau2,q2,qd2,qd1,qdd1,qdd2"
    expected = [
        oracles.two_link_acceleration(TWO_LINK, row[[1, 3]], row[[5, 4]], row[[0, 2]])
        for row in rows
    ]
    found = np.transpose([given.column("qdd1"), given.column("qdd2")])
    assert relative_error(found, expected) < 1e-11


@pytest.mark.parametrize("count", [2, 600])
def test_a_batch_of_four_bars(robodyn: Run, count: int) -> None:
    states = [four_bar_state(seed) for seed in range(count)]
    rows = [[q[0], qd[0], tau] for q, qd, tau in states]
    stdin = "q1,qd1,tau1\n" + "".join(text(row) + "\n" for row in rows)
    given = robodyn("accel", "robots/four-bar.yaml", "-", stdin=stdin).succeeds()
    expected = [
        np.hstack(oracles.four_bar_acceleration(FOUR_BAR, q, qd, [tau, 0, 0]))
        for q, qd, tau in states
    ]
    columns = ("qdd1", "qdd2", "qdd3", "fx1", "fy1")
    found = np.transpose([given.column(name) for name in columns])
    assert relative_error(found, expected) < 1e-10


def test_json_and_table(robodyn: Run) -> None:
    arguments = ["accel", "robots/2r.yaml", "--q", "1,2", "--tau", "3,-4", "--format"]
    expected = oracles.two_link_acceleration(TWO_LINK, [1, 2], [0, 0], [3, -4])
    (row,) = robodyn(*arguments, "json").succeeds().json
    assert relative_error([row["qdd1"], row["qdd2"]], expected) < 1e-12
    table = robodyn(*arguments, "table").succeeds().out
    assert "qdd1 [rad/s²]" in table
    assert f"{expected[0]:.6g}" in table


def test_the_unit_of_a_displacement(robodyn: Run, scene: Callable[[str], Path]) -> None:
    arguments = ["accel", scene(RP_ARM), "--q", "1,0.2", "--format", "table"]
    table = robodyn(*arguments).succeeds().out
    assert "qdd1 [rad/s²]" in table
    assert "qdd2 [m/s²]" in table


# A mechanism with a massless link, and one without any inertia


def test_a_massless_coupler_is_no_obstacle(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    """M alone is singular there; a coupler of a millionth of the mass moves all but the same."""
    before = "m: 1.3, l: 0.95, r: 0.45, I: 0.102"
    massless = scene(four_bar_text.replace(before, "m: 0, l: 0.95, r: 0.45, I: 0"))
    found = robodyn("accel", massless, "--q", "60deg", "--qd", "5", "--tau", "1.5").succeeds()
    nearly = FOUR_BAR._replace(m2=1e-9, r2=0.45, I2=1e-10)
    q = oracles.four_bar_position(nearly, math.pi / 3)
    qd = oracles.four_bar_coefficients(nearly, q)[0] * 5
    qdd, force = oracles.four_bar_acceleration(nearly, q, qd, [1.5, 0, 0])
    columns = ("qdd1", "qdd2", "qdd3", "fx1", "fy1")
    assert relative_error(found.has(*columns), [*qdd, *force]) < 1e-6


def test_a_joint_without_inertia_is_named(robodyn: Run, scene: Callable[[str], Path]) -> None:
    path = scene(
        "links: [{name: arm, m: 1, l: 1, r: 0.5, I: 0.1}, {name: tag, m: 0, l: 1, r: 0, I: 0}]\n"
    )
    failed = robodyn("accel", path, "--q", "1,2").fails(1, str(path), "tag", "inertia")
    assert failed.out == ""
    batch = robodyn("accel", path, "-", stdin="q1,q2\n1,2\n").fails(1, "stdin: line 2: ", "tag")
    assert batch.out == "q1,q2,qdd1,qdd2\n"


# Errors


@pytest.mark.parametrize("arguments", [[], ["--qd", "1"], ["--tau", "0.5"]])
def test_a_change_point_is_named(robodyn: Run, arguments: list[str]) -> None:
    """Both branches meet there, so that no one acceleration follows from a torque."""
    failed = robodyn("accel", "robots/parallelogram.yaml", "--q", "0", *arguments)
    failed.fails(1, "robots/parallelogram.yaml", "change point")
    assert failed.out == ""


FOLDED = """\
gravity: 9.81
links:
  - {name: crank, m: 0.8, l: 0.2, r: 0.09, I: 0.003}
  - {name: rod, m: 0.5, l: 0.2, r: 0.11, I: 0.0022, payload: 0.7}
closures: [{point: rod, on: {through: [0, 0], along: [1, 0]}}]
actuated: [crank]
"""


def test_rates_that_no_motion_has_are_refused(robodyn: Run, scene: Callable[[str], Path]) -> None:
    """The crank holds, the rod of its length turns: its pin is 0.2 m 3^2 off the slide."""
    path, pose = scene(FOLDED), ("--q", "90deg,-180deg")
    states = "q1,q2,qd1,qd2\n1,-2,1,-2\n1.5707963267948966,-3.141592653589793,0,3\n"
    for command in ("accel", "torque"):
        failed = robodyn(command, path, "-", stdin=states)
        assert len(failed.fails(2, "stdin: line 3: ", "1.8 m/s^2").rows) == 1
    commands = ("accel",), ("torque", "--qdd", "0,0"), ("torque",), ("simulate", "--time", "0.1")
    for command, *options in commands:
        failed = robodyn(command, path, *pose, "--qd", "0,3", *options)
        told = "no motion has these rates: gap in acceleration = 1.8 m/s^2", "along one of its"
        assert failed.fails(2, str(path), *told).out == ""
        for rates in ("2,0", "2,-4"):
            given = robodyn(command, path, *pose, "--qd", rates, *options)
            assert given.code == 0
            if command == "simulate":
                begun = [float(given.rows[0][name]) for name in ("qd1", "qd2")]
                assert begun == pytest.approx([float(x) for x in rates.split(",")], abs=1e-12)


@pytest.mark.parametrize("arguments", [["--qd", "1e200,1"], ["--tau", "1e308,-1e308"]])
@pytest.mark.parametrize("batch", [False, True])
@pytest.mark.parametrize("command", ["accel", "reactions"])
def test_a_result_beyond_the_floats_is_an_error(
    robodyn: Run, command: str, arguments: list[str], batch: bool
) -> None:
    states = ["-"] if batch else ["--q", "1,2"]
    given = robodyn(command, "robots/2r.yaml", *states, *arguments, stdin="q1,q2\n1,2\n")
    given.fails(1)
    assert "nan" not in given.out
