"""`robodyn trajectory`: rows, units, branches, limits, pipes, errors."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import sleep

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT, RP_ARM, Outcome, relative_error

import oracles
import robodyn as api

Run = Callable[..., Outcome]
ARM = ("trajectory", "robots/2r.yaml")
BAR = ("trajectory", "robots/four-bar.yaml")
TO = ("--from", "0,0", "--to", "90deg,45deg")
PROFILES = ("cubic", "quintic", "trapezoidal", "cycloidal")


def array(given: Outcome, name: str, joints: int = 2) -> np.ndarray:
    """The columns name1.. of all rows, (rows, joints)."""
    return np.transpose([given.column(f"{name}{k + 1}") for k in range(joints)])


def duration(given: Outcome) -> float:
    """What --time min tells on stderr."""
    assert given.code == 0, given.err
    assert given.err.startswith("shortest duration: ")
    return float(given.err.split()[2])


# Rest to rest


def test_rest_to_rest(robodyn: Run) -> None:
    given = robodyn(*ARM, *TO, "--time", "2", "--every", "0.3").succeeds()
    assert given.out.splitlines()[0] == "t,q1,q2,qd1,qd2,qdd1,qdd2"
    t = np.array(given.column("t"))
    assert t == pytest.approx([0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.0])
    motion = api.reference_motion(
        api.load(ROOT / "robots/2r.yaml"), [[0, 0], [math.pi / 2, math.pi / 4]], 2
    )
    for name, known in zip(("q", "qd", "qdd"), motion.states(t), strict=True):
        assert np.array_equal(array(given, name), known)
    assert given.rows[-1]["t"] == "2.0"
    assert given.rows[-1]["q1"] == repr(math.pi / 2)
    assert "-0.0" not in given.out


@pytest.mark.parametrize("profile", PROFILES)
def test_profiles_have_their_peaks(robodyn: Run, profile: str) -> None:
    arguments = [*ARM, "--from", "1,0", "--to", "-1,0.5", "--time", "500ms", "--points", "3"]
    given = robodyn(*arguments, "--profile", profile).succeeds()
    peak = {"cubic": 1.5, "quintic": 1.875, "trapezoidal": 1.5, "cycloidal": 2.0}[profile]
    assert array(given, "qd")[1] == pytest.approx(np.array([-2.0, 0.5]) * peak / 0.5)
    part = robodyn(*arguments, "--profile", "trapezoidal", "--acceleration", "0.1").succeeds()
    assert array(part, "qd")[1] == pytest.approx(np.array([-2.0, 0.5]) / 0.9 / 0.5)
    assert array(part, "qdd")[0] == pytest.approx(np.array([-2.0, 0.5]) / (0.1 * 0.9) / 0.25)


def test_number_of_rows(robodyn: Run) -> None:
    assert len(robodyn(*ARM, *TO, "--time", "2s").succeeds().rows) == 1001
    assert len(robodyn(*ARM, *TO, "--time", "2", "--points", "7").succeeds().rows) == 7
    assert robodyn(*ARM, *TO, "--time", "2", "--points", "1").succeeds().column("t") == [2.0]
    rows = robodyn(*ARM, *TO, "--time", "1", "--every", "100ms").succeeds().column("t")
    assert rows == pytest.approx(np.arange(11) / 10)


def test_json_and_table(robodyn: Run) -> None:
    arguments = [*ARM, *TO, "--time", "2", "--points", "3", "--format"]
    rows = robodyn(*arguments, "json").succeeds().json
    assert [row["t"] for row in rows] == [0.0, 1.0, 2.0]
    table = robodyn(*arguments, "table").succeeds().out
    for part in ("t [s]", "qdd2 [rad/s²]", "1.5708"):
        assert part in table


def test_the_table_tells_metres_of_joints_that_slide(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    options = ("--from", "0,0", "--to", "1,0.2", "--time", "1", "--points", "2")
    table = robodyn("trajectory", scene(RP_ARM), *options, "--format", "table").succeeds().out
    for part in ("q1 [rad]", "q2 [m]", "qd2 [m/s]", "qdd1 [rad/s²]", "qdd2 [m/s²]"):
        assert part in table


# Constant speed and sweeps


@pytest.mark.parametrize("speed", ["60rpm", "2*pi", "360deg/s", "6.283185307179586rad/s"])
def test_a_crank_through_its_circle(robodyn: Run, speed: str) -> None:
    given = robodyn(*BAR, "--speed", speed, "--turns", "1", "--points", "13").succeeds()
    q, qd, qdd = (array(given, name, 3) for name in ("q", "qd", "qdd"))
    assert given.column("t")[-1] == pytest.approx(1.0, rel=1e-15)
    assert qd[:, 0] == pytest.approx(np.full(13, 2 * np.pi), rel=1e-14)
    assert not qdd[:, 0].any()
    assert q[:, 0] == pytest.approx(np.linspace(0, 2 * np.pi, 13))
    for k in range(13):
        known = oracles.four_bar_position(FOUR_BAR, q[k, 0])
        assert np.abs(np.exp(1j * q[k]) - np.exp(1j * known)).max() < 1e-13


def test_speed_for_a_time_and_turns_in_a_time(robodyn: Run) -> None:
    backwards = robodyn(*BAR, "--speed=-60rpm", "--time", "0.5", "--from", "1", "--points", "2")
    assert array(backwards.succeeds(), "q", 3)[:, 0] == pytest.approx([1, 1 - np.pi])
    turned = robodyn(*BAR, "--turns", "-0.5", "--time", "0.25", "--points", "2").succeeds()
    assert array(turned, "qd", 3)[:, 0] == pytest.approx([-4 * np.pi] * 2)
    both = robodyn(
        "trajectory", "robots/five-bar.yaml", "--from", "120deg,60deg", "--points", "2",
        *("--speed", "-30rpm,15rpm", "--turns", "0.25"),
    ).succeeds()  # fmt: skip
    assert both.column("t")[-1] == pytest.approx(0.5)
    assert array(both, "q", 4)[1, [0, 2]] == pytest.approx(np.radians([30, 105]))


def test_a_sweep(robodyn: Run) -> None:
    given = robodyn(
        *ARM, "--profile", "sweep", "--from", "30deg,45deg", "--amplitude", "5deg,2deg",
        *("--frequencies", "0.5,3Hz", "--time", "4"),
    ).succeeds()  # fmt: skip
    t = np.array(given.column("t"))
    phase = 2 * np.pi * (0.5 * t + 2.5 * t**2 / 8)
    known = np.radians([30, 45]) + np.radians([5, 2]) * np.sin(phase)[:, None]
    assert np.abs(array(given, "q") - known).max() < 1e-14
    rate = 2 * np.pi * (0.5 + 2.5 * t / 4)
    known = np.radians([5, 2]) * (np.cos(phase) * rate)[:, None]
    assert np.abs(array(given, "qd") - known).max() < 1e-13


# Through points


def points(path: Path, header: str, *rows: tuple[float, ...]) -> Path:
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n")
    return path


@pytest.mark.parametrize("profile", PROFILES)
def test_points_at_given_times(robodyn: Run, tmp_path: Path, profile: str) -> None:
    rows = [(1.0, 0.0, 0.5), (2.0, 1.0, -0.5), (2.5, 1.5, 0.25), (4.0, 0.0, 0.0)]
    file = points(tmp_path / "via.csv", "t,q2,q1", *rows)
    given = robodyn(*ARM, "--via", file, "--profile", profile, "--every", "0.5").succeeds()
    t = given.column("t")
    assert t == pytest.approx(np.arange(1.0, 4.1, 0.5))
    q = array(given, "q")
    for time, q2, q1 in rows:
        assert q[t.index(time)] == pytest.approx([q1, q2], abs=1e-14)
    assert not array(given, "qd")[[0, -1]].any()
    stdin = robodyn(
        *ARM, "--via", "-", "--profile", profile, "--every", "0.5", stdin=file.read_bytes()
    )
    assert stdin.succeeds().out == given.out


def test_points_without_times_between_ends_of_options(robodyn: Run) -> None:
    """The way is 1 + 2 + 1 rad, so the points come after 1/4 and 3/4 of the time."""
    given = robodyn(
        *ARM, "--via", "-", "--from", "0,0", "--to", "1,-1", "--time", "4", "--every", "1",
        stdin="note,q1,q2\na,1,0\nb,1,-2\n",
    ).succeeds()  # fmt: skip
    assert array(given, "q")[[0, 1, 3, 4]] == pytest.approx(
        np.array([[0, 0], [1, 0], [1, -2], [1, -1]]), abs=1e-14
    )


def test_a_natural_cubic_spline_has_no_acceleration_at_its_ends(robodyn: Run) -> None:
    arguments = [*ARM, "--via", "-", "--profile", "cubic", "--points", "3"]
    stdin = "t,q1,q2\n0,0,0\n1,1,2\n2,-1,0.5\n"
    natural = robodyn(*arguments, "--ends", "natural", stdin=stdin).succeeds()
    assert np.abs(array(natural, "qdd")[[0, -1]]).max() < 1e-14
    assert np.abs(array(natural, "qd")[[0, -1]]).min() > 0.1
    rest = robodyn(*arguments, "--ends", "rest", stdin=stdin).succeeds()
    assert rest.out == robodyn(*arguments, stdin=stdin).succeeds().out
    assert not array(rest, "qd")[[0, -1]].any()


# Branches


@pytest.mark.parametrize("assembly", ["open", "crossed"])
def test_from_picks_the_branch(robodyn: Run, assembly: str) -> None:
    start, end = (oracles.four_bar_position(FOUR_BAR, x, assembly) for x in (0.5, 2.5))
    arguments = [*BAR, "--from", ",".join(map(repr, start.tolist())), "--time", "1"]
    given = robodyn(*arguments, "--to", "2.5", "--points", "5").succeeds()
    q = array(given, "q", 3)
    assert np.abs(np.exp(1j * q[-1]) - np.exp(1j * end)).max() < 1e-13
    whole = robodyn(*arguments, "--to", ",".join(map(repr, end.tolist())), "--points", "5")
    assert whole.succeeds().out == given.out
    other = oracles.four_bar_position(FOUR_BAR, 2.5, {"open": "crossed"}.get(assembly, "open"))
    failed = robodyn(*arguments, "--to", ",".join(map(repr, other.tolist())))
    failed.fails(2, "point 2: q2 (coupler)", "on the branch of the first point")


def test_a_loop_that_ends_on_the_way(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str, tmp_path: Path
) -> None:
    path = scene(four_bar_text.replace("[1.1, 0.0]", "[1.9, 0.0]"))
    out = tmp_path / "out.csv"
    arguments = ["trajectory", path, "--from", "0", "--to", "180deg", "--time", "2", "-o", out]
    failed = robodyn(*arguments).fails(1, str(path), "t = 0.81668", "q1 (crank) = 1.04285 rad")
    assert failed.out == ""
    assert not out.exists()


# Limits


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [
        ("--max-qd", "60deg/s", "qd1 (upper arm) at t = 1 s = 1.4726"),
        ("--max-qd", "2,30rpm", None),
        ("--max-qdd", "3,60deg/s^2", "qdd2 (forearm)"),
        ("--max-qdd", "100", None),
        ("--max-tau", "25,2", "tau2 (forearm)"),
        ("--max-tau", "25,8", None),
    ],
)
def test_limits_are_checked(
    robodyn: Run, tmp_path: Path, option: str, value: str, told: str | None
) -> None:
    out = tmp_path / "out.csv"
    given = robodyn(*ARM, *TO, "--time", "2", option, value, "-o", out)
    if told is None:
        given.succeeds()
        assert out.exists()
    else:
        given.fails(1, f"{option}: {told}", "exceeds the limit of")
        assert not out.exists()


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("way", ["--to", "--via"])
def test_the_shortest_time_keeps_the_limit_and_no_shorter_one(
    robodyn: Run, profile: str, way: str
) -> None:
    ends = TO if way == "--to" else ("--from", "0,0", "--via", "-")
    arguments = [*ARM, *ends, "--profile", profile, "--max-tau", "25,8"]
    stdin = "q1,q2\n1.5,0.7\n0.5,-0.5\n"
    T = duration(robodyn(*arguments, "--time", "min", stdin=stdin))
    if way == "--via" and profile in ("trapezoidal", "cycloidal"):
        return  # other times than in proportion to the distances
    robodyn(*arguments, "--time", repr(T), stdin=stdin).succeeds()
    robodyn(*arguments, "--time", repr(T * 0.999), stdin=stdin).fails(1, "--max-tau: tau")


def test_the_shortest_time_at_a_speed_limit(robodyn: Run) -> None:
    given = robodyn(*ARM, *TO, "--time", "min", "--max-qd", "60rpm", "--profile", "cubic")
    assert duration(given) == pytest.approx(1.5 * (math.pi / 2) / (2 * math.pi), rel=1e-14)
    assert "bounded by qd1 (upper arm)" in given.err
    assert given.column("t")[-1] == duration(given)


def test_the_fastest_turn(robodyn: Run) -> None:
    arguments = [*BAR, "--turns", "1", "--max-tau", "20"]
    T = duration(robodyn(*arguments, "--time", "min"))
    robodyn(*arguments, "--time", repr(T)).succeeds()
    robodyn(*arguments, "--time", repr(0.999 * T)).fails(1, "--max-tau: tau1 (crank) at t = ")


def test_times_of_a_file_are_stretched(robodyn: Run) -> None:
    stdin = "t,q1,q2\n1,0,0\n2,1,1\n4,0,0.5\n"
    given = robodyn(*ARM, "--via", "-", "--time", "min", "--max-qd", "1", stdin=stdin)
    T = duration(given)
    assert given.column("t")[0] == 1.0
    assert given.column("t")[-1] == 1.0 + T
    assert np.abs(array(given, "qd")).max() == pytest.approx(1.0, rel=1e-5)


def test_what_cannot_be_held_is_told(robodyn: Run) -> None:
    failed = robodyn(*ARM, *TO, "--time", "min", "--max-tau", "5,8")
    failed.fails(1, "--max-tau: tau1 (upper arm) at q = 0, 0 = 14.56785 N m: holding this pose")


# Pipes


@pytest.mark.parametrize(
    "line",
    [
        "robots/2r.yaml --from 0,0 --to 90deg,45deg --time 2 --points 11",
        "robots/2r.yaml --from 1,2 --to 3,0 --time 0.5 --points 11 --profile trapezoidal",
        "robots/four-bar.yaml --speed 60rpm --turns 1 --points 11",
        "robots/five-bar.yaml --from 120deg,60deg --to 200deg,10deg --time 1 --points 11",
    ],
)
def test_torque_and_accel_give_the_accelerations_back(quick_shell: Run, line: str) -> None:
    model = line.split()[0]
    sent = quick_shell(f"robodyn trajectory {line}").succeeds()
    given = quick_shell(
        f"robodyn trajectory {line} | robodyn torque {model} - | robodyn accel {model} -"
    ).replaces()
    n = sum(name.startswith("qdd") for name in sent.rows[0])
    assert relative_error(array(given, "qdd", n), array(sent, "qdd", n)) < 1e-11
    assert array(given, "q", n).tolist() == array(sent, "q", n).tolist()


def test_head_ends_it_quietly(quick_shell: Run) -> None:
    line = "robodyn trajectory robots/2r.yaml --from 0,0 --to 1,1 --time 2 --points 100000"
    assert quick_shell(f"{line} | head -1").succeeds().out.startswith("t,q1,")


@pytest.mark.parametrize(
    ("model", "motion", "start"),
    [
        ("2r", "--from=-90deg,0 --to=-30deg,45deg --time 1", "--q=-90deg,0"),
        ("four-bar", "--from 60deg --to 150deg --time 0.7", "--q 60deg"),
    ],
)
def test_simulation_under_the_torques_follows(
    quick_shell: Run, model: str, motion: str, start: str
) -> None:
    """The table is interpolated linearly, so loosely."""
    scene, time = f"robots/{model}.yaml", motion.split()[-1]
    torques = f"robodyn trajectory {scene} {motion} --every 1ms | robodyn torque {scene} -"
    run = f"robodyn simulate {scene} {start} --time {time} --tau-from - --quiet --points 2"
    last = quick_shell(f"{torques} | {run} | tail -1").succeeds()
    wanted = quick_shell(f"robodyn trajectory {scene} {motion} --points 1 | tail -1").succeeds()
    n = 2 if model == "2r" else 3
    found, known = (
        np.array([float(x) for x in given.out.strip().split(",")[1 : 2 * n + 1]])
        for given in (last, wanted)
    )
    assert np.abs(found - known).max() < 1e-4


def test_scipy_is_not_imported(shell: Run) -> None:
    program = (
        "import sys; from robodyn import cli; "
        "code = cli.run(sys.argv[1:]); "
        "assert not {'scipy', 'rich', 'matplotlib'} & set(sys.modules), 'imported'; sys.exit(code)"
    )
    stdin = "printf 'q1,q2\\n1,2\\n0,1\\n'"
    for line in (  # but for splines
        "robots/2r.yaml --from 0,0 --via - --time min --max-tau 30 --profile cycloidal",
        "robots/2r.yaml --from 0,0 --to 1,2 --time 1",
        "robots/four-bar.yaml --speed 1 --turns 1",
    ):
        given = shell(f'{stdin} | python -c "{program}" trajectory {line}')
        assert given.code == 0, given.err


# Errors


def test_too_fast_for_floats(process: Run) -> None:
    process(*ARM, *TO, "--time", "1e-200").fails(1, "not finite")


@pytest.mark.parametrize("rows", [3, 101, 1001])
def test_an_end_at_a_change_point_is_refused(rows: int, robodyn: Run) -> None:
    options = ["--from", "0.2", "--to", "pi", "--time", "2", "--points", str(rows)]
    given = robodyn("trajectory", ROOT / "robots/parallelogram.yaml", *options)
    assert given.code == 1
    assert "too near a change point" in given.err


# Long motions


def test_many_turns_of_a_closed_mechanism(robodyn: Run) -> None:
    given = robodyn(*BAR, "--speed", "1", "--turns", "1e6", "--points", "3").succeeds()
    q, qd = array(given, "q", 3), array(given, "qd", 3)
    assert q[:, 0] == pytest.approx(2 * np.pi * np.array([0.0, 5e5, 1e6]), rel=1e-15)
    assert np.exp(1j * q) == pytest.approx(np.exp(1j * q[[0, 0, 0]]), abs=1e-8)
    assert qd[1:] == pytest.approx(qd[[0, 0]], rel=1e-7)


@pytest.mark.parametrize("format", ["csv", "json", "table"])
def test_rows_leave_as_they_are_made(format: str) -> None:
    command = [sys.executable, "-m", "robodyn", *ARM, *TO, "--time", "2", "--points", "100000000"]
    with subprocess.Popen(
        [*command, "--format", format], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT
    ) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        for _ in range(1_000 if format == "table" else 20_000):  # which takes longer to draw
            assert child.stdout.readline()
        child.stdout.close()
        assert child.stderr.read() == b""
        assert child.wait() == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_no_file(tmp_path: Path, number: signal.Signals) -> None:
    command = [sys.executable, "-m", "robodyn", *ARM, *TO, "--time", "2", "--points", "100000000"]
    with subprocess.Popen(
        [*command, "-o", str(tmp_path / "out.csv")], stderr=subprocess.PIPE, cwd=ROOT
    ) as child:
        while not any(tmp_path.iterdir()):
            sleep(0.02)
        child.send_signal(number)
        assert child.wait() == 128 + number
        assert child.stderr is not None
        assert child.stderr.read() == b""
    assert not list(tmp_path.iterdir())


def test_static_friction_holds_what_the_torque_cannot_start(robodyn: Run, scene: Run) -> None:
    """The force that would follow the motion leaves the cart where it is."""
    slide = "joint: prismatic, axis: [1, 0], m: 2, l: 0, r: 0, I: 0"
    cart = scene(f"links: [{{name: c, {slide}, friction: {{force: 3, static: 4}}}}]")
    way = ("trajectory", cart, "--from", 0, "--to", 1, "--time")
    told = "--max-tau: tau1 (c) at t = 0 s = 4 N: starts it against its static friction, more than"
    for time in ("min", "9"):
        robodyn(*way, time, "--max-tau", 3.5).fails(1, f"{told} the limit of 3.5 N")
        assert robodyn(*way, time, "--max-tau", 4.01).code == 0
    motion = robodyn(*way, "9").out
    law = ("--track", "-", "--control", "pd", "--kp", 900, "--kd", 90, "--points", 2, "--quiet")
    for force, end in ((3.5, 0.0), (4.01, 1.0)):
        run = robodyn("simulate", cart, "--q", 0, *law, "--tau-max", force, stdin=motion)
        assert run.column("q1")[-1] == pytest.approx(end, abs=0.01)
