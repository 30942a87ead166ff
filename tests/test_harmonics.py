"""`reactions --harmonics`: orders of shaking forces, against closed forms and exact integrals."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import mpmath
import numpy as np
import pytest
from conftest import Outcome

from robodyn.dynamics.harmonics import harmonics
from robodyn.errors import InputError

Run = Callable[..., Outcome]
SPEED = 30.0  # rad/s
UNBALANCED = """
gravity: 9.81
links:
  - {name: crank, m: 2, l: 0.3, r: [0.04, 0.03], I: 0.01}
"""
ENGINE = """
links:
  - {name: crank, m: 0, l: 0.05, r: 0, I: 0}
  - {name: rod, m: 0, l: 0.16, r: 0, I: 0, payload: 0.8}
closures:
  - {point: rod, on: {through: [0, 0], along: [1, 0]}}
"""
RATIO = 0.05 / 0.16


def rows(robodyn: Run, tmp_path: Path, scene: str, *options: object) -> Outcome:
    """The harmonics of a turn at a constant speed."""
    model, turn = tmp_path / "scene.yaml", tmp_path / "turn.csv"
    model.write_text(scene)
    line = ("trajectory", model, "--speed", f"{SPEED}", "--turns", 1, "--points", 129)
    robodyn(*line, "-o", turn).succeeds()
    return robodyn("reactions", model, turn, *options)


def test_an_unbalanced_crank_has_its_weight_and_one_order(robodyn: Run, tmp_path: Path) -> None:
    given = rows(robodyn, tmp_path, UNBALANCED, "--harmonics", 3).succeeds()
    assert given.out.splitlines()[0] == (
        "order,shake_fx_amp,shake_fx_phase,shake_fy_amp,shake_fy_phase,shake_m_amp,shake_m_phase"
    )
    pull, ahead = 2 * 0.05 * SPEED**2, math.atan2(0.03, 0.04)
    assert given.column("order") == [0, 1, 2, 3]
    alone = rows(robodyn, tmp_path, UNBALANCED, "--harmonics").succeeds().out.splitlines()
    assert (alone[:5], len(alone)) == (given.out.splitlines(), 12)  # orders 0 to 10
    options = "--harmonics", "--format", "csv"
    assert rows(robodyn, tmp_path, UNBALANCED, *options).succeeds().out.splitlines() == alone
    assert given.column("shake_fx_amp") == pytest.approx([0, pull, 0, 0], rel=1e-12)
    assert given.column("shake_fx_phase")[1] == pytest.approx(ahead, rel=1e-12)
    assert given.column("shake_fy_amp") == pytest.approx([2 * 9.81, pull, 0, 0], rel=1e-12)
    assert given.column("shake_fy_phase")[0] == pytest.approx(math.pi)  # its weight pulls down
    assert given.column("shake_fy_phase")[1] == pytest.approx(ahead - math.pi / 2, rel=1e-12)
    weight = 2 * 9.81 * 0.05  # about the pivot: -m g (r cos(theta + ahead))
    assert given.column("shake_m_amp") == pytest.approx([0, weight, 0, 0], abs=1e-12)
    assert given.column("shake_m_phase")[1] == pytest.approx(ahead - math.pi, rel=1e-12)
    turned = rows(robodyn, tmp_path, UNBALANCED, "--harmonics", 3, "--degrees").succeeds()
    found = turned.column("shake_fx_phase_deg")[1]
    assert found == pytest.approx(math.degrees(ahead), rel=1e-12)


def test_a_piston_has_the_orders_of_textbooks(robodyn: Run, tmp_path: Path) -> None:
    """m r w^2 (cos + (lambda + lambda^3/4 + ..) cos 2 - (lambda^3/4 + ..) cos 4 + ..)."""
    given = rows(robodyn, tmp_path, ENGINE, "--harmonics", 8).succeeds()
    pull, x = 0.8 * 0.05 * SPEED**2, RATIO
    second = x + x**3 / 4 + 15 * x**5 / 128 + 35 * x**7 / 512
    fourth = x**3 / 4 + 3 * x**5 / 16 + 35 * x**7 / 256
    amplitudes, phases = given.column("shake_fx_amp"), given.column("shake_fx_phase")
    assert amplitudes[1] == pytest.approx(pull, rel=1e-12)
    assert amplitudes[2] == pytest.approx(pull * second, rel=x**8)
    assert amplitudes[4] == pytest.approx(pull * fourth, rel=x**5)
    assert [amplitudes[k] for k in (0, 3, 5, 7)] == [0.0] * 4
    assert given.column("shake_fy_amp") == pytest.approx([0.0] * 9, abs=1e-10)
    assert [phases[k] for k in (1, 2, 4)] == pytest.approx([0, 0, math.pi], abs=1e-12)

    # to all digits: the integrals that these series approach
    with mpmath.workdps(30):
        ratio = mpmath.mpf(5) / 16

        def place(theta: mpmath.mpf) -> mpmath.mpf:  # of the piston, over the crank's length
            return mpmath.cos(theta) + mpmath.sqrt(1 / ratio**2 - mpmath.sin(theta) ** 2)

        for k in (2, 4, 6, 8):
            whole = mpmath.quad(
                lambda a, k=k: place(a) * mpmath.cos(k * a), mpmath.linspace(0, 2 * mpmath.pi, 9)
            )
            known = float(k * k * whole / mpmath.pi) * pull
            found = amplitudes[k] * math.cos(phases[k])
            assert found == pytest.approx(known, rel=1e-11, abs=1e-11 * pull)


def test_the_series_is_the_force(robodyn: Run, tmp_path: Path) -> None:
    model = "robots/four-bar.yaml"
    turn = tmp_path / "turn.csv"
    line = ("trajectory", model, "--speed", "300rpm", "--turns", 1, "--points", 361)
    robodyn(*line, "-o", turn).succeeds()
    plain = robodyn("reactions", model, turn).succeeds()
    given = robodyn("reactions", model, turn, "--harmonics", 150).succeeds()
    angle = np.array(plain.column("q1"))
    for name in ("shake_fx", "shake_fy", "shake_m"):
        size, phase = (np.array(given.column(f"{name}_{x}")) for x in ("amp", "phase"))
        waves = size * np.cos(np.arange(151) * angle[:, None] + phase)
        force = np.array(plain.column(name))
        assert waves.sum(axis=1) == pytest.approx(force, abs=1e-9 * np.abs(force).max())


def test_the_last_row_may_be_left_out_and_the_crank_may_turn_back() -> None:
    angle = 0.3 + np.arange(16) * math.tau / 16
    values = np.stack([3 + 2 * np.cos(3 * angle - 0.4), -np.sin(angle)], axis=-1)
    again = np.append(angle, angle[0] + math.tau), np.concatenate([values, values[:1]])
    for given in ((angle, values), again, (angle[::-1], values[::-1])):
        sizes, phases = harmonics(*given, 7)
        known = np.zeros((8, 2))
        known[0, 0], known[3, 0], known[1, 1] = 3.0, 2.0, 1.0
        assert sizes == pytest.approx(known, abs=1e-14)
        assert phases[3, 0] == pytest.approx(-0.4, abs=1e-14)
        assert phases[1, 1] == pytest.approx(math.pi / 2, abs=1e-14)


@pytest.mark.parametrize(
    ("angle", "part"),
    [
        (np.linspace(0, 6, 50), "must go over one turn"),
        (np.linspace(0, 2 * math.tau, 50), "must go over one turn"),
        (np.linspace(0, 1, 50) ** 1.01 * math.tau, "off an even grid"),
        (np.zeros(50), "does not turn"),
        (np.zeros(1), "does not turn"),
        (np.linspace(0, math.tau, 15), "needs more than 14 rows in the turn; it has 14"),
    ],
)
def test_what_is_no_turn_is_refused(angle: np.ndarray, part: str) -> None:
    with pytest.raises(InputError, match=part):
        harmonics(angle, np.cos(angle)[:, None], 7)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--harmonics", "64"], "--harmonics = 64: needs more than 128 rows in the turn"),
        (["--harmonics", "-1"], "--harmonics = -1: must be in [0, 10000]"),
        (["--harmonics", "nan"], "'--harmonics': 'nan' must be a finite number"),
        (["--harmonics", "2.5"], "'--harmonics': '2.5' is 2.5, no whole number"),
        (["--harmonics", "many"], "'--harmonics': 'many' is not a number"),
        (["--harmonics", "3", "--extremes"], "--extremes and --harmonics: exclude each other"),
    ],
)
def test_options(robodyn: Run, tmp_path: Path, options: list[str], part: str) -> None:
    rows(robodyn, tmp_path, UNBALANCED, *options).fails(2, part)


def test_other_rows_are_refused_by_name(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    line = ("reactions", "robots/pendulum.yaml")
    speeds = "".join(f"{k * math.tau / 8:.17g},{5 + k}\n" for k in range(9))
    path.write_text("q1,qd1\n" + speeds)
    robodyn(*line, path, "--harmonics", 1).fails(2, "--harmonics: the forces: must end as they")
