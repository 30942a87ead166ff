"""`robodyn energy` against 1/2 qd^T M qd of the lecture's M and the heights of the masses."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, TWO_LINK, Outcome, relative_error

import oracles

Run = Callable[..., Outcome]
COLUMNS = ("KE", "PE", "energy")


def text(vector: object) -> str:
    return ",".join(repr(float(x)) for x in np.ravel(vector))


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
def test_a_2r_arm(robodyn: Run, seed: int) -> None:
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
