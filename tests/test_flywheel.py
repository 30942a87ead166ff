"""`torque --power` and `torque --fluctuation`, against energies and closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import mpmath
import numpy as np
import pytest
from conftest import Outcome, relative_error

import robodyn as library
from robodyn.dynamics.flywheel import flywheel, harmonics
from robodyn.errors import InputError

Run = Callable[..., Outcome]
PENDULUM, YOKE = "robots/pendulum.yaml", "robots/scotch-yoke.yaml"
FIELDS = ("mean_torque", "energy_fluctuation", "mean_speed", "flywheel")


def turn(rows: int = 361, sense: float = 1.0, turns: int = 1, begin: float = 0.3) -> str:
    angles = (begin + sense * np.linspace(0.0, math.tau * turns, rows)).tolist()
    return "\n".join(["q1", *map(repr, angles)]) + "\n"


def yoke(w: float, M: float = 1.9, c: float = 4.0) -> tuple[float, float]:
    """Mean torque and energy fluctuation of the Scotch yoke at constant speed w.

    The yoke at x = a cos(theta) and the crank's centre of gravity b sin(theta) high need
    T = M a^2 w^2 sin cos + c a^2 w sin^2 + m g b cos.
    """
    a, b, m = 0.12, 0.04, 0.7
    x = np.linspace(0.0, math.tau, 2_000_001)
    mean = c * a * a * w / 2.0
    rest = -M * (a * w) ** 2 * np.cos(2 * x) / 4 - c * a * a * w * np.sin(2 * x) / 4
    return mean, float(np.ptp(rest + m * 9.81 * b * np.sin(x)))


@pytest.mark.parametrize(("w", "delta"), [(5.0, 0.02), (-30.0, 0.5)])
def test_a_pendulum_at_constant_speed(robodyn: Run, w: float, delta: float) -> None:
    """T = m g r cos(theta): the energy goes up and down by 2 m g r."""
    options = ("--qd", w, "--fluctuation", delta)
    given = robodyn("torque", PENDULUM, "-", *options, stdin=turn(sense=math.copysign(1, w)))
    mean, dE, speed, inertia = given.succeeds().has(*FIELDS)
    assert abs(mean) < 1e-12
    assert dE == pytest.approx(2 * 0.4 * 9.81 * 0.26, rel=1e-9)
    assert speed == pytest.approx(abs(w), rel=1e-14)
    assert inertia == pytest.approx(dE / (delta * w * w), rel=1e-12)


@pytest.mark.parametrize("w", [3.0, 12.0, 40.0])
@pytest.mark.parametrize("turns", [1, 3])
@pytest.mark.thinned
def test_a_scotch_yoke_with_losses(robodyn: Run, w: float, turns: int) -> None:
    table = turn(360 * turns + 1, turns=turns)
    given = robodyn("torque", YOKE, "-", "--qd", w, "--fluctuation", 0.05, stdin=table)
    mean, dE, speed, inertia = given.succeeds().has(*FIELDS)
    known = yoke(w)
    assert relative_error([mean, dE, speed], [*known, w]) < 1e-8
    assert inertia == pytest.approx(known[1] / (0.05 * w * w), rel=1e-8)


def test_from_times_with_uneven_rows(robodyn: Run) -> None:
    """The speed is that of t; rates may be found from it too."""
    u = np.linspace(0.0, 1.0, 721)
    angle = math.tau * (u + 0.05 * np.sin(math.tau * u) / math.tau)
    rows = zip((angle / 12.0).tolist(), angle.tolist(), strict=True)
    table = "t,q1,note\n" + "".join(f"{t!r},{q!r},x\n" for t, q in rows)
    options = ("--fluctuation", 0.05)
    for more in (("--qd", 12), ("--differentiate",)):
        given = robodyn("torque", YOKE, "-", *options, *more, stdin=table)
        found = given.succeeds().has(*FIELDS[:3])
        assert relative_error(found, [*yoke(12.0), 12.0]) < 1e-7


@pytest.mark.parametrize("name", ["four-bar", "slider-crank", "whitworth"])
def test_of_a_machine_without_losses_it_is_that_of_its_energy(robodyn: Run, name: str) -> None:
    """At constant speed all work is change of KE + PE, of which many poses are asked."""
    path = f"robots/{name}.yaml"
    mechanism = library.load(path)
    if any(mechanism.damping):
        pytest.skip("it has losses")
    (k,) = mechanism.actuated
    table = turn(721).replace("q1", f"q{k + 1}")
    given = robodyn("torque", path, "-", "--qd", "7", "--fluctuation", 0.03, stdin=table)
    mean, dE, *_ = given.succeeds().has(*FIELDS)
    crank = np.linspace(0.0, math.tau, 20_001)[:, None]
    q = library.assemble(mechanism, crank)
    qd = library.loop_velocities(mechanism, q, np.full_like(crank, 7.0))
    energy = library.kinetic_energy(mechanism, q, qd) + library.potential_energy(mechanism, q)
    assert abs(mean) < 1e-6 * dE
    assert dE == pytest.approx(np.ptp(energy), rel=1e-6)


@pytest.mark.parametrize("format", ["json", "table"])
def test_it_is_written_as_rows_are(robodyn: Run, tmp_path: Path, format: str) -> None:
    path = tmp_path / "wheel"
    options = ("--qd", 12, "--fluctuation", 0.05)
    robodyn("torque", YOKE, "-", *options, "-o", path, stdin=turn()).succeeds()
    assert path.read_text().splitlines()[0] == ",".join(FIELDS)
    given = robodyn("torque", YOKE, "-", *options, "--format", format, stdin=turn()).succeeds()
    if format == "json":
        (row,) = given.json  # type: ignore[misc]
        assert [repr(x) for x in row.values()] == path.read_text().splitlines()[1].split(",")
    else:
        assert "energy_fluctuation [J]" in given.out
        assert "flywheel [kg m²]" in given.out


def test_a_constant_torque_needs_no_flywheel() -> None:
    angle = np.linspace(0.0, math.tau, 9)
    mean, dE, speed, inertia = flywheel(angle, np.full(9, 3.0), 1.0, 0.1)
    assert (mean, speed) == (pytest.approx(3.0, rel=1e-15), math.tau)
    assert dE < 1e-14
    assert inertia < 1e-14


def test_convergence_is_that_of_cubic_splines() -> None:
    errors = []
    for rows in (31, 61, 121):
        x = np.linspace(0.0, math.tau, rows)
        torque = 2.0 + np.exp(np.sin(x + 0.4))
        dense = np.linspace(0.0, math.tau, 400_001)
        wave = np.exp(np.sin(dense + 0.4))
        work = np.concatenate([[0.0], np.cumsum((wave[1:] + wave[:-1]) / 2) * dense[1]])
        known = np.ptp(work - work[-1] * dense / math.tau)
        errors.append(abs(flywheel(x, torque, 1.0, 0.1).energy_fluctuation - known))
    assert errors[0] < 1e-4
    assert errors[1] < errors[0] / 10
    assert errors[2] < errors[1] / 10


def test_a_torque_that_does_not_come_back() -> None:
    x = np.linspace(0.0, math.tau, 50)
    with pytest.raises(InputError, match="must end as it began"):
        flywheel(x, x, 1.0, 0.1)


def test_power_is_torque_times_rate(robodyn: Run) -> None:
    state = ("--q", "1,2", "--qd", "-2,3", "--qdd", "1,1")
    row = robodyn("torque", "robots/2r.yaml", *state, "--columns", "tau,power").succeeds().row
    assert list(row) == ["tau1", "tau2", "power1", "power2"]
    assert row["power1"] == -2 * row["tau1"]
    assert row["power2"] == 3 * row["tau2"]
    chosen = ("--columns", "tau,power")
    closed = robodyn("torque", "robots/four-bar.yaml", "--q", 1, "--qd", 5, *chosen).succeeds()
    assert list(closed.row) == ["tau1", "power1"]
    assert closed.row["power1"] == 5 * closed.row["tau1"]
    shown = robodyn("torque", "robots/rp-arm.yaml", "--q", "1,0.1", *chosen, "--format", "table")
    assert "power2 [W]" in shown.succeeds().out


@pytest.mark.parametrize("name", ["2r", "four-bar"])
def test_work_is_change_of_energy(robodyn: Run, name: str) -> None:
    """Simpson's rule over the power of a motion without losses."""
    ends = {"2r": ("0,0", "90deg,45deg"), "four-bar": ("30deg", "150deg")}[name]
    path = f"robots/{name}.yaml"
    way = ("--from", ends[0], "--to", ends[1], "--time", 2, "--points", 401)
    motion = robodyn("trajectory", path, *way).succeeds().out
    powers = robodyn("torque", path, "-", "--columns", "power", stdin=motion).succeeds()
    energy = robodyn("energy", path, "-", stdin=motion).succeeds().column("energy")
    total = np.sum([powers.column(x) for x in powers.rows[0] if x.startswith("power")], axis=0)
    weights = np.array([1.0, *[4.0, 2.0] * 199, 4.0, 1.0])
    assert weights @ total * 0.005 / 3 == pytest.approx(energy[-1] - energy[0], rel=1e-8)


# `summary --harmonics`: orders of shaking forces, against closed forms and exact integrals.


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
    degrees = ["--degrees"] if "--degrees" in options else []
    forces = robodyn("reactions", model, turn, "--columns", "q1,shaking", *degrees).succeeds()
    return robodyn("summary", *(x for x in options if x != "--degrees"), stdin=forces.out)


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
    given = robodyn("summary", "--harmonics", 150, stdin=plain.out).succeeds()
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
    ],
)
def test_options(robodyn: Run, tmp_path: Path, options: list[str], part: str) -> None:
    rows(robodyn, tmp_path, UNBALANCED, *options).fails(2, part)


def test_other_rows_are_refused_by_name(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    forces = ("reactions", "robots/pendulum.yaml")
    speeds = "".join(f"{k * math.tau / 8:.17g},{5 + k}\n" for k in range(9))
    path.write_text("q1,qd1\n" + speeds)
    robodyn("summary", "--harmonics", 1, stdin=robodyn(*forces, path).out).fails(
        2, "--harmonics: the forces: must end as they"
    )
