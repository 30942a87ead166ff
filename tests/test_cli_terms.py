"""`robodyn terms` against the lecture's matrices."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT, RP_ARM, SCOTCH_YOKE, TWO_LINK, Outcome, relative_error, text

import oracles
import robodyn as rd

Run = Callable[..., Outcome]


def heights_energy(masses: list[float], heights: list[float]) -> float:
    return 9.81 * float(np.dot(masses, heights))


@pytest.mark.parametrize("seed", range(3))
def test_a_2r_arm(robodyn: Run, seed: int) -> None:
    q, qd = np.random.default_rng(seed).uniform(-3, 3, (2, 2))
    found = robodyn("terms", "robots/2r.yaml", "--q", text(q), "--qd", text(qd)).succeeds().json
    M, C, G = oracles.two_link_terms(TWO_LINK, q, qd)
    assert list(found) == ["q", "qd", "M", "C", "G", "KE", "PE"]
    assert relative_error(found["M"], M) < 1e-14
    assert relative_error(found["C"], C) < 1e-14
    assert relative_error(found["G"], G) < 1e-14
    assert (found["q"], found["qd"]) == (q.tolist(), qd.tolist())
    assert found["KE"] == pytest.approx(qd @ M @ qd / 2, rel=1e-13)
    y1, y12 = math.sin(q[0]), math.sin(q[0] + q[1])
    heights = [0.36 * y1, 0.8 * y1 + 0.25 * y12]
    assert found["PE"] == pytest.approx(heights_energy([1.5, 0.9], heights), rel=1e-13)


@pytest.mark.parametrize("theta1", [0.3, math.pi / 3, -2.0])
@pytest.mark.parametrize("whole", [False, True])
def test_a_four_bar(robodyn: Run, theta1: float, whole: bool) -> None:
    q = oracles.four_bar_position(FOUR_BAR, theta1)
    qd = oracles.four_bar_coefficients(FOUR_BAR, q)[0] * 5.0
    given = [text(x) if whole else text(x[:1]) for x in (q, qd)]
    found = robodyn("terms", "robots/four-bar.yaml", "--q", given[0], "--qd", given[1]).succeeds()
    known = oracles.four_bar_terms(FOUR_BAR, q, qd)
    expected = {
        "q": q,
        "qd": qd,
        "M": known.M,
        "C": known.C,
        "G": known.G,
        "Psi": known.Psi,
        "Psidot_qd": known.Psidot @ qd,
        "gap": known.gap,
        "KE": qd @ known.M @ qd / 2,
    }
    assert list(found.json) == [*expected, "PE"]
    for name, value in expected.items():
        assert relative_error(found.json[name], value) < 1e-12, name
    a, b, c = math.sin(q[0]), math.sin(q[0] + q[1]), math.sin(q[2])
    heights = [0.15 * a, 0.35 * a + 0.45 * b, 0.36 * c]
    assert found.json["PE"] == pytest.approx(heights_energy([0.6, 1.3, 1.0], heights), rel=1e-12)


def test_a_3r_arm_by_lagrange(robodyn: Run) -> None:
    tree = [
        {"m": 2.4, "r": 0.32, "I": 0.112, "parent": None, "at": 0j},
        {"m": 1.4, "r": 0.26, "I": 0.041, "parent": 0, "at": 0.70 + 0j},
        {"m": 0.75, "r": 0.14, "I": 0.0065, "parent": 1, "at": 0.55 + 0j},
    ]
    q, qd = np.random.default_rng(4).uniform(-3, 3, (2, 3))
    known = oracles.sympy_terms(tree, -9.81j)(q, qd)
    found = robodyn("terms", "robots/3r.yaml", "--q", text(q), "--qd", text(qd)).succeeds().json
    for name in ("M", "C", "G", "KE", "PE"):
        assert relative_error(found[name], getattr(known, name)) < 1e-13, name


def test_rates_left_out_are_zero(robodyn: Run) -> None:
    found = robodyn("terms", "robots/2r.yaml", "--q", "30deg,-1").succeeds().json
    assert found["q"] == [pytest.approx(math.pi / 6, abs=1e-16), -1.0]
    assert found["qd"] == [0.0, 0.0]
    assert (found["C"], found["KE"]) == ([[0, 0], [0, 0]], 0.0)


def test_a_slider_has_one_equation(robodyn: Run) -> None:
    found = robodyn("terms", "robots/slider-crank.yaml", "--q", "50deg", "--qd", "10").json
    q, qd, l1, l2 = found["q"], np.array(found["qd"]), 0.10, 0.32
    along = [l1 * math.cos(q[0]) + l2 * math.cos(q[0] + q[1]), l2 * math.cos(q[0] + q[1])]
    assert relative_error(found["Psi"], [along]) < 1e-14
    assert abs(np.dot(along, qd)) < 1e-13
    height = l1 * math.sin(q[0]) + l2 * math.sin(q[0] + q[1])
    assert height == pytest.approx(0.02, abs=1e-15)
    assert relative_error(found["gap"], [0.0]) < 1e-15
    bend = -l1 * math.sin(q[0]) * qd[0] ** 2 - l2 * math.sin(q[0] + q[1]) * (qd[0] + qd[1]) ** 2
    assert relative_error(found["Psidot_qd"], [bend]) < 1e-12


def test_a_horizontal_plane_has_no_gravity_terms(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    path = scene("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n")
    found = robodyn("terms", path, "--q", "1").succeeds().json
    assert (found["G"], found["PE"]) == ([0.0], 0.0)
    assert found["M"] == [[pytest.approx(0.35, rel=1e-15)]]


def test_the_table_shows_every_term_with_its_unit(robodyn: Run) -> None:
    arguments = ["terms", "robots/four-bar.yaml", "--q", "60deg", "--qd", "5", "--format", "table"]
    given = robodyn(*arguments).succeeds()
    for title in (
        *("q [rad]", "qd [rad/s]", "M [kg m²]", "C [kg m²/s]", "G [N m]"),
        *("Psi [m]", "Psidot qd [m/s²]", "gap [m]", "KE [J]", "PE [J]"),
    ):
        assert re.search(rf"(^|  ){re.escape(title)}( |$)", given.out, re.MULTILINE), title
    assert f"{oracles.four_bar_position(FOUR_BAR, math.pi / 3)[1]:.6g}" in given.out
    assert "\x1b" not in given.out


def test_the_table_shows_the_units_of_joints_that_slide(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    arguments = ["terms", scene(RP_ARM), "--q", "1,0.2", "--format", "table"]
    lines = [line.strip() for line in robodyn(*arguments).succeeds().out.splitlines()]
    for title, head in (
        ("q", "1 [rad]   2 [m]"),
        ("qd", "1 [rad/s]   2 [m/s]"),
        ("G", "1 [N m]   2 [N]"),
        ("D", "1 [N m s/rad]   2 [N s/m]"),
        ("M [kg m²; kg m and kg where one or both joints slide]", "1     2"),
        ("C [kg m²/s; kg m/s and kg/s where one or both joints slide]", "1   2"),
    ):
        below = lines[lines.index(title) + 2]
        assert " ".join(below.split()) == " ".join(head.split())
    arguments = ["terms", scene(SCOTCH_YOKE), "--q", "1", "--format", "table"]
    lines = [line.strip() for line in robodyn(*arguments).succeeds().out.splitlines()]
    assert lines[lines.index("Psi") + 2].split("   ") == ["1 [m]", "2 [1]"]


FRICTION = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1, friction: {torque: 1, static: 1.5}}]"


def test_dry_friction_stands_in_Q_in_motion(robodyn: Run, tmp_path: Path) -> None:
    (tmp_path / "dry.yaml").write_text(FRICTION)
    moves = robodyn("terms", str(tmp_path / "dry.yaml"), "--q", "1", "--qd", "1").succeeds()
    assert moves.json["Q"] == [-1.0]
    assert not moves.err
    rests = robodyn("terms", str(tmp_path / "dry.yaml"), "--q", "1")
    assert rests.json["Q"] == [0.0]
    assert rests.err == (
        "Note: Q is without the dry friction of a: at rest it holds any load up to static\n"
    )


def test_out(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "terms.json"
    arguments = ["terms", "robots/2r.yaml", "--q", "1,2"]
    assert robodyn(*arguments, "-o", file).succeeds().out == ""
    assert file.read_text() == robodyn(*arguments).succeeds().out


def test_terms_that_leave_the_floats_are_an_error(process: Run) -> None:
    """NaN is no JSON."""
    assert process("terms", "robots/2r.yaml", "--q", "1,2", "--qd", "1e200,1").fails(1).out == ""


def test_derivatives(robodyn: Run) -> None:
    given = ("terms", "robots/2r.yaml", "--q", "0.3,-0.8", "--qd", "1.2,-0.7", "--derivatives")
    found = robodyn(*given, "--tau", "2,0.4", "--qdd", "1,2").succeeds().json
    mech = rd.load(ROOT / "robots/2r.yaml")
    forward = rd.forward_dynamics_derivatives(mech, [0.3, -0.8], [1.2, -0.7], [2, 0.4])
    inverse = rd.inverse_dynamics_derivatives(mech, [0.3, -0.8], [1.2, -0.7], [1, 2])
    names = ("dqdd_dq", "dqdd_dqd", "dqdd_dtau", "dtau_dq", "dtau_dqd", "dtau_dqdd")
    for name, matrix in zip(names, (*forward[1:4], *inverse[1:4]), strict=True):
        assert np.array_equal(found[name], matrix)
    assert np.allclose(found["dtau_dqdd"], found["M"])
    by = robodyn(*given, "--by", "links.forearm.m", "--by", "gravity").succeeds().json
    assert by == robodyn(*given, "--by", "links.forearm.m, gravity").succeeds().json
    still = rd.inverse_dynamics_derivatives(
        mech, [0.3, -0.8], [1.2, -0.7], [0, 0], numbers=["links.forearm.m", "gravity"]
    )
    assert np.array_equal(by["dtau_dnumbers"], still.by_numbers)
    told = robodyn("terms", "robots/cart-pole.yaml", "--q", "0,1", "--derivatives")
    assert told.code == 0
    assert "no derivatives of torques" in told.err
    told = robodyn("terms", "robots/parallelogram.yaml", "--q", "0", "--derivatives")
    assert "no derivatives of accelerations: robots/parallelogram.yaml: singular" in told.err
    assert not [name for name in told.json if name.startswith("d")]


# `robodyn energy` against 1/2 qd^T M qd of the lecture's M and the heights of the masses.


COLUMNS = ("KE", "PE", "energy")


def arm_energies(q: np.ndarray, qd: np.ndarray) -> list[float]:
    KE = qd @ oracles.two_link_terms(TWO_LINK, q, qd)[0] @ qd / 2
    y1, y12 = math.sin(q[0]), math.sin(q[0] + q[1])
    PE = 9.81 * (1.5 * 0.36 * y1 + 0.9 * (0.8 * y1 + 0.25 * y12))
    return [KE, PE, KE + PE]


def four_bar_energies(theta1: float, rate: float) -> list[float]:
    q = oracles.four_bar_position(FOUR_BAR, theta1)
    KE = oracles.four_bar_reduction(FOUR_BAR, theta1)[0] * rate**2 / 2
    a, b, c = math.sin(q[0]), math.sin(q[0] + q[1]), math.sin(q[2])
    PE = 9.81 * (0.6 * 0.15 * a + 1.3 * (0.35 * a + 0.45 * b) + 1.0 * 0.36 * c)
    return [KE, PE, KE + PE]


@pytest.mark.parametrize("seed", range(3))
def test_a_2r_arm_energy(robodyn: Run, seed: int) -> None:
    q, qd = np.random.default_rng(seed).uniform(-3, 3, (2, 2))
    given = robodyn("energy", "robots/2r.yaml", "--q", text(q), "--qd", text(qd)).succeeds()
    assert given.out.splitlines()[0] == "KE,PE,energy"
    assert relative_error(given.has(*COLUMNS), arm_energies(q, qd)) < 1e-13


def test_at_rest_all_energy_is_potential(robodyn: Run) -> None:
    row = robodyn("energy", "robots/2r.yaml", "--q", "90deg,0").succeeds().row
    assert row["KE"] == 0.0
    assert row["energy"] == row["PE"] == pytest.approx(9.81 * (1.5 * 0.36 + 0.9 * 1.05))


@pytest.mark.parametrize("theta1", [0.4, 2.0, -1.0])
def test_a_four_bar_from_its_crank(robodyn: Run, theta1: float) -> None:
    given = robodyn("energy", "robots/four-bar.yaml", "--q", theta1, "--qd", "5").succeeds()
    assert relative_error(given.has(*COLUMNS), four_bar_energies(theta1, 5.0)) < 1e-12


@pytest.mark.parametrize("count", [1, 500])
def test_a_batch(robodyn: Run, count: int) -> None:
    rows = np.random.default_rng(1).uniform(-3, 3, (count, 4))
    stdin = "t,q1,qd2,q2,qd1\n" + "".join(f"{k},{text(x)}\n" for k, x in enumerate(rows))
    given = robodyn("energy", "robots/2r.yaml", "-", stdin=stdin).succeeds()
    assert given.out.splitlines()[0] == "t,q1,qd2,q2,qd1,KE,PE,energy"
    assert given.column("t") == list(range(count))
    expected = [arm_energies(x[[0, 2]], x[[3, 1]]) for x in rows]
    found = np.transpose([given.column(name) for name in COLUMNS])
    assert relative_error(found, expected) < 1e-13


def test_a_batch_of_four_bars(robodyn: Run) -> None:
    rows = np.random.default_rng(1).uniform(-3, 3, (20, 2))
    stdin = "q1,qd1\n" + "".join(text(row) + "\n" for row in rows)
    given = robodyn("energy", "robots/four-bar.yaml", "-", stdin=stdin).succeeds()
    found = np.transpose([given.column(name) for name in COLUMNS])
    assert relative_error(found, [four_bar_energies(*row) for row in rows]) < 1e-12


def test_gravity_along_any_direction_and_payload(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    """PE = -(m s + payload tip) . gravity, from the origin; one link on a shifted pivot."""
    path = scene(
        "gravity: [2, -3]\n"
        "links: [{name: a, m: 0.7, l: 1.5, r: [0.4, 0.1], I: 0.2, payload: 0.3, from: [5, 6]}]\n"
    )
    w, turn, pivot = 1.7, complex(math.cos(0.8), math.sin(0.8)), 5 + 6j
    masses = [(0.7, 0.4 + 0.1j), (0.3, 1.5 + 0j)]
    KE = (0.2 + sum(m * abs(r) ** 2 for m, r in masses)) * w**2 / 2
    places = [(m, pivot + turn * r) for m, r in masses]
    PE = -sum(m * (2 * s.real - 3 * s.imag) for m, s in places)
    given = robodyn("energy", path, "--q", "0.8", "--qd", w).succeeds()
    assert relative_error(given.has(*COLUMNS), [KE, PE, KE + PE]) < 1e-14


def test_json_and_table(robodyn: Run) -> None:
    arguments = ["energy", "robots/2r.yaml", "--q", "1,2", "--qd", "3,4", "--format"]
    expected = arm_energies(np.array([1, 2]), np.array([3, 4]))
    (row,) = robodyn(*arguments, "json").succeeds().json
    assert relative_error([row[name] for name in COLUMNS], expected) < 1e-13
    table = robodyn(*arguments, "table").succeeds().out
    for name, value in zip(COLUMNS, expected, strict=True):
        assert f"{name} [J]" in table
        assert f"{value:.6g}" in table


@pytest.mark.parametrize("batch", [False, True])
def test_an_energy_beyond_the_floats_is_an_error(process: Run, batch: bool) -> None:
    states = ["-"] if batch else ["--q", "1,2"]
    given = process(*("energy", "robots/2r.yaml", *states, "--qd", "1e200,1"), stdin="q1,q2\n1,2\n")
    given.fails(1)
    assert "nan" not in given.out
