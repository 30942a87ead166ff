"""`torque --power` and `torque --fluctuation`, against energies and closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import Outcome, relative_error

import robodyn as library
from robodyn.dynamics.flywheel import flywheel
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
    row = robodyn("torque", "robots/2r.yaml", *state, "--power").succeeds().row
    assert list(row) == ["tau1", "tau2", "power1", "power2"]
    assert row["power1"] == -2 * row["tau1"]
    assert row["power2"] == 3 * row["tau2"]
    closed = robodyn("torque", "robots/four-bar.yaml", "--q", 1, "--qd", 5, "--power").succeeds()
    assert list(closed.row) == ["tau1", "fx1", "fy1", "power1"]
    assert closed.row["power1"] == 5 * closed.row["tau1"]
    shown = robodyn("torque", "robots/rp-arm.yaml", "--q", "1,0.1", "--power", "--format", "table")
    assert "power2 [W]" in shown.succeeds().out


@pytest.mark.parametrize("name", ["2r", "four-bar"])
def test_work_is_change_of_energy(robodyn: Run, name: str) -> None:
    """Simpson's rule over the power of a motion without losses."""
    ends = {"2r": ("0,0", "90deg,45deg"), "four-bar": ("30deg", "150deg")}[name]
    path = f"robots/{name}.yaml"
    way = ("--from", ends[0], "--to", ends[1], "--time", 2, "--points", 401)
    motion = robodyn("trajectory", path, *way).succeeds().out
    powers = robodyn("torque", path, "-", "--power", stdin=motion).succeeds()
    energy = robodyn("energy", path, "-", stdin=motion).succeeds().column("energy")
    total = np.sum([powers.column(x) for x in powers.rows[0] if x.startswith("power")], axis=0)
    weights = np.array([1.0, *[4.0, 2.0] * 199, 4.0, 1.0])
    assert weights @ total * 0.005 / 3 == pytest.approx(energy[-1] - energy[0], rel=1e-8)
