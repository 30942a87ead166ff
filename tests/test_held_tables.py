"""Tables over time whose rows hold, and two rows at one time, against exact motions."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from contact_scenes import scene
from scipy.integrate import solve_ivp

from robodyn.control.laws import controller
from robodyn.control.tracking import ReferenceTable
from robodyn.errors import DescriptionError, InputError
from robodyn.mechanics.actuation import table
from robodyn.mechanics.mechanism import Mechanism, build, load
from robodyn.runs.simulation import simulate
from robodyn.scene.description import from_text

EACH = pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau", "taylor"])
TIMES, FORCES = [0.0, 0.3, 0.55, 1.0, 1.5, 2.0], [4.0, -7.0, 2.0, -1.0, 3.0, 9.0]
STEPS = [0.0, 0.3, 0.3, 0.55, 1.0, 1.0, 2.0], [4.0, -7.0, 2.0, -1.0, 3.0, -5.0, 2.0]
BLOCK = "{name: block, joint: prismatic, axis: [1, 0], m: 2, l: 0, r: 0, I: 1}"
ROWS = np.array([0.1, 0.3, 0.5, 0.55, 0.7, 1.0, 1.2, 1.5, 2.0])


def block(friction: str = "") -> Mechanism:
    return scene(f"links: [{BLOCK[:-1]}{friction}}}]")


def loaded(folder: Path, text: str, times: list[float], forces: list[float]) -> Mechanism:
    rows = "".join(f"{t!r},{F!r}\n" for t, F in zip(times, forces, strict=True))
    (folder / "force.csv").write_text("t,F\n" + rows)
    return build(from_text(text, str(folder / "scene.yaml")))


def load_of(hold: bool) -> str:
    held = ", hold: true" if hold else ""
    force = f"[{{table: force.csv, over: t, column: F{held}}}, 0]"
    return f"links: [{BLOCK}]\nloads: [{{link: block, at: [0, 0], force: {force}}}]\n"


def exact(t: float, hold: bool, v: float = 0.0, m: float = 2.0) -> tuple[float, float]:
    """Way and rate of a mass from rest at 0, piece by piece of TIMES or STEPS."""
    x, end = 0.0, t
    given = zip(*((TIMES, FORCES) if hold else STEPS), strict=True)
    for (a, F), (b, G) in pairwise(given):
        h = min(b, end) - a
        if h > 0.0:
            slope = 0.0 if hold else (G - F) / (b - a)
            x += h * (v + h * (F / 2.0 + h * slope / 6.0) / m)
            v += h * (F + h * slope / 2.0) / m
    return x, v


@EACH
@pytest.mark.parametrize("hold", [True, False])
@pytest.mark.parametrize("by_load", [True, False])
def test_a_mass_moves_as_piecewise_forces_have_it(
    tmp_path: Path, method: str, hold: bool, by_load: bool
) -> None:
    times, forces = (TIMES, FORCES) if hold else STEPS
    if by_load:
        mechanism, tau = loaded(tmp_path, load_of(hold), times, forces), None
    else:
        mechanism = block()
        tau = table(mechanism, times, [[x] for x in forces], until=2.0, hold=hold)
    run = simulate(mechanism, [0.0], [0.0], 2.0, tau, method, t_eval=ROWS)
    known = np.array([exact(t, hold) for t in ROWS])
    assert np.abs(run.q[:, 0] - known[:, 0]).max() < 1e-14
    assert np.abs(run.qd[:, 0] - known[:, 1]).max() < 1e-14
    assert run.report.work == pytest.approx(known[-1, 1] ** 2, abs=1e-13)  # m v^2/2
    # at a step the force is that which follows it
    assert 2.0 * run.qdd[[1, 5], 0] == pytest.approx([-7.0, -1.0] if hold else [2.0, -5.0])


@EACH
def test_backward_runs_come_back(tmp_path: Path, method: str) -> None:
    """From where a run ended, on tables that begin before it."""
    times = [t - 2.0 for t in TIMES]
    text = "gravity: 9.81\nlinks: [{name: rod, m: 1, l: 1, r: 0.5, I: 0.1}]\nloads: "
    text += "[{link: rod, torque: {table: force.csv, over: t, column: F, hold: true}}]"
    mechanism = loaded(tmp_path, text, times, FORCES)
    there = simulate(mechanism, [0.4], [0.0], -2.0, None, method, rtol=1e-12, atol=1e-12)

    def rate(t: float, y: np.ndarray, torque: float) -> list[float]:
        return [y[1], (torque - 0.5 * 9.81 * np.cos(y[0])) / 0.35]

    y = np.array([0.4, 0.0])
    for (a, b), torque in zip(reversed(list(pairwise(times))), FORCES[-2::-1], strict=True):
        y = solve_ivp(rate, (b, a), y, "DOP853", args=(torque,), rtol=1e-13, atol=1e-13).y[:, -1]
    assert np.abs([there.q[-1, 0] - y[0], there.qd[-1, 0] - y[1]]).max() < 1e-10


@EACH
@pytest.mark.parametrize("by_load", [True, False])
def test_what_sticks_starts_and_stops_at_the_steps(
    tmp_path: Path, method: str, by_load: bool
) -> None:
    """A block that 3 N hold at rest, and 2 N brake, under 2, 5, -1 and -4 N."""
    times, forces = [0.0, 0.4, 0.8, 1.9, 2.5], [2.0, 5.0, -1.0, -4.0, 0.0]
    friction = ", friction: {force: 2, static: 3}"
    if by_load:
        text = load_of(True).replace("I: 1}", f"I: 1{friction}}}")
        mechanism, tau = loaded(tmp_path, text, times, forces), None
    else:
        mechanism = block(friction)
        tau = table(mechanism, times, [[x] for x in forces], until=2.5, hold=True)
    run = simulate(mechanism, [0.0], [0.0], 2.5, tau, method)
    fastest = 0.4 * (5.0 - 2.0) / 2.0
    stop = 0.8 + fastest / ((2.0 + 1.0) / 2.0)
    end = 0.6 * (4.0 - 2.0) / 2.0
    assert [x.name for x in run.events] == ["block starts", "block stops", "block starts"]
    assert np.abs(np.array([x.t for x in run.events]) - [0.4, stop, 1.9]).max() < 1e-9
    assert run.qd[-1, 0] == pytest.approx(-end, abs=1e-9)
    assert run.report.steps < 60


@EACH
def test_controllers_keep_their_samples_beside_a_load_that_steps(
    tmp_path: Path, method: str
) -> None:
    """The run of a sampled PD law under a held load, against one of pieces written here."""
    mechanism = loaded(tmp_path, load_of(True), TIMES, FORCES)
    reference = ReferenceTable.set_point([0.2], 2.0)
    made = controller(mechanism, reference, "pd", [30.0], [4.0], control_rate=8.0)
    run = simulate(mechanism, [0.0], [0.0], 2.0, made, method, t_eval=[2.0])
    x = v = t = 0.0
    ends = sorted({*TIMES[1:], *(k / 8.0 for k in range(1, 17))})
    held = 30.0 * 0.2
    for end in ends:
        force = FORCES[max(k for k, begin in enumerate(TIMES) if begin <= t)]
        h, a = end - t, (held + force) / 2.0
        x, v, t = x + h * v + 0.5 * h * h * a, v + h * a, end
        if (t * 8.0).is_integer():
            held = 30.0 * (0.2 - x) - 4.0 * v
    assert run.q[-1, 0] == pytest.approx(x, abs=1e-12)


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (
            "0,1\n1,2\n1,3\n1,4\n2,1\n",
            "t must increase from row to row; two at one time are a step",
        ),
        ("0,1\n1,2\n0.5,3\n", "t must increase from row to row: 0.5 follows 1"),
        ("1,1\n1,2\n", "has one time, 1: it needs two"),
    ],
)
def test_faults_of_tables_are_named(tmp_path: Path, rows: str, told: str) -> None:
    (tmp_path / "force.csv").write_text("t,F\n" + rows)
    with pytest.raises(DescriptionError) as error:
        from_text(load_of(False), str(tmp_path / "scene.yaml"))
    assert told in str(error.value)


def test_a_step_or_a_held_row_is_over_time_alone(tmp_path: Path) -> None:
    (tmp_path / "force.csv").write_text("q1,F\n0,1\n1,2\n1,3\n2,3\n")
    text = load_of(True).replace("over: t", "over: q1")
    with pytest.raises(DescriptionError, match=r"hold = q1: is for tables over t alone"):
        from_text(text, str(tmp_path / "scene.yaml"))
    with pytest.raises(DescriptionError, match="q1 must increase from row to row: 1 follows 1"):
        from_text(text.replace(", hold: true", ""), str(tmp_path / "scene.yaml"))
    with pytest.raises(DescriptionError, match="hold = 2: must be true or false"):
        from_text(load_of(True).replace("hold: true", "hold: 2"), str(tmp_path / "scene.yaml"))


@pytest.mark.parametrize(
    ("times", "told"),
    [
        ([0.0, 1.0, 1.0, 1.0, 2.0], "two are a step"),
        ([0.0, 1.0, 0.5, 1.5, 2.0], "times must increase"),
        ([0.0, 0.0], "needs two times or more"),
        ([0.0, 1.0], "must cover the simulation, 0 to 2 s: the last row ends it"),
    ],
)
def test_faults_of_torques_are_named(times: list[float], told: str) -> None:
    with pytest.raises(InputError) as error:
        table(block(), times, [[1.0]] * len(times), until=2.0, hold=True)
    assert told in str(error.value)


@EACH
def test_the_bed_of_a_recovery_truck(method: str) -> None:
    """Two axles that move along it, held torques and friction by direction, by its equation."""
    folder = ROOT / "robots"
    rows = np.genfromtxt(folder / "recovery-truck.csv", delimiter=",", skip_header=1)
    mech = load(folder / "recovery-truck.yaml")

    def motion(held: float) -> Callable[[float, list[float]], list[float]]:
        def rates(t: float, y: list[float]) -> list[float]:
            places = 900 * 9.81 * 1.6 + 7e3 * (0.5 + 0.2 * t) + 7e3 * (0.5 - 2.5 + 0.2 * t)
            way = np.tanh(y[1] / 2e-3)
            rubs = (900 * (1 + way) + 600 * (1 - way)) / 2 * way
            acts = held - places * np.cos(y[0]) - 2e5 * y[1] - rubs
            return [y[1], acts / (3800 + 900 * 1.6**2)]

        return rates

    y = [0.05, -0.02]  # it sinks at first
    ends = [y]
    for (a, held), (b, _) in pairwise(rows):
        found = solve_ivp(motion(held), (a, b), y, method="DOP853", rtol=1e-12, atol=1e-14)
        y = found.y[:, -1].tolist()
        ends.append(y)
    rtol, bound = (1e-7, 1e-6) if method in ("RK45", "Radau") else (1e-11, 1e-9)
    start, times = ([0.05], [-0.02]), rows[:, 0]
    run = simulate(mech, *start, 10.0, method=method, t_eval=times, rtol=rtol, atol=rtol)
    assert np.abs(np.column_stack([run.q[:, 0], run.qd[:, 0]]) - ends).max() < bound
