"""`robodyn sweep`: what it reads, writes, refuses, and how it goes on after it was cut off."""

from __future__ import annotations

import cmath
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FRESH, ROOT, Outcome
from named_case import case
from scipy.integrate import solve_ivp
from sliding_scenes import BLOCK, LEVER, SCISSORS, STARTED

import robodyn as package
from robodyn import inverse_dynamics, load, simulate
from robodyn.sweeps import sweep_plan
from robodyn.sweeps.sweep_chunks import Rows, run_chunk

Run = Callable[..., Outcome]
ARM = ("sweep", "robots/2r.yaml")
BAR = ("sweep", "robots/four-bar.yaml")


# What varies


def test_a_grid_of_starts(robodyn: Run) -> None:
    given = robodyn(
        *ARM, "--vary", "q1=0:90deg:30deg", "--vary", "qd2=1,2.5", "--q", "0.5,0.2", "--time", 0.5,
        "--result", "final", "--quiet",
    ).succeeds()  # fmt: skip
    assert given.out.splitlines()[0] == "q1,qd2,t_end,q1_end,q2_end,qd1_end,qd2_end,outcome"
    starts = [(math.radians(k), w) for k in (0, 30, 60, 90) for w in (1.0, 2.5)]
    assert given.column("q1") == pytest.approx([q for q, _ in starts])
    assert given.column("qd2") == [w for _, w in starts]
    arm = load(ROOT / "robots/2r.yaml")
    for row, (q, w) in zip(given.rows, starts, strict=True):
        motion = simulate(arm, [q, 0.2], [0, w], 0.5, rtol=1e-11, atol=1e-11)
        end = [float(row[name]) for name in ("q1_end", "q2_end", "qd1_end", "qd2_end")]
        assert end == pytest.approx([*motion.q[-1], *motion.qd[-1]], abs=1e-7)


THE_GRAMMAR_OF_VALUES = [
    ("gravity=0:10:3", [0.0, 5.0, 10.0]),  # a whole number counts
    ("gravity=0:10:5.0", [0.0, 5.0, 10.0]),  # a point makes it a step
    ("gravity=0:10:4.", [0.0, 4.0, 8.0]),
    ("q1=0:180deg:90deg", [0.0, math.pi / 2, math.pi]),
    ("q1=-pi:pi:3", [-math.pi, 0.0, math.pi]),
    ("q1=1:0:-0.5", [1.0, 0.5, 0.0]),
    ("links.upper arm.m= 1, 2.5 ,3e-1", [1.0, 2.5, 0.3]),
    ("tau2=4", [4.0]),
]


def test_the_grammar_of_values(robodyn: Run) -> None:
    for spec, values in THE_GRAMMAR_OF_VALUES:
        with case(spec, values):
            given = robodyn(*ARM, "--vary", spec, "--time", 0.01, "--quiet").succeeds()
            name = spec.partition("=")[0]
            assert given.column(name) == pytest.approx(values, abs=1e-15)


def test_a_sample_is_the_same_for_the_same_seed(robodyn: Run) -> None:
    options = (*ARM, "--vary", "q1=0:1", "--vary", "gravity=3.7,9.81", "--sample", 9, "--quiet")
    options += ("--time", 0.1, "--result", "drift")
    first = robodyn(*options, "--seed", 1).succeeds()
    assert robodyn(*options, "--seed", 1).out == first.out
    assert robodyn(*options, "--seed", 2).out != first.out
    assert len(first.rows) == 9
    assert all(0.0 <= q < 1.0 for q in first.column("q1"))
    assert set(first.column("gravity")) <= {3.7, 9.81}


def test_a_grid_named_in_a_sample_is_drawn_from(robodyn: Run) -> None:
    """The values of links.forearm.m=0.5:1.5:11 and q1=0:360deg:1deg, at random."""
    given = robodyn(
        *ARM, "--vary", "links.forearm.m=0.5:1.5:11", "--vary", "q1=0:360deg:1deg", "--sample", 50,
        "--seed", 1, "--time", 0.1, "--quiet",
    ).succeeds()  # fmt: skip
    assert len(given.rows) == 50
    for mass, angle in zip(given.column("links.forearm.m"), given.column("q1"), strict=True):
        assert round(mass * 10) == pytest.approx(mass * 10, abs=1e-9)
        assert round(math.degrees(angle)) == pytest.approx(math.degrees(angle), abs=1e-9)


def test_torques(robodyn: Run) -> None:
    given = robodyn(
        *ARM, "--kind", "torque", "--vary", "q2=0,1", "--vary", "qdd1=0,2", "--q", "0.3,0",
        "--qd", "1,2", "--qdd", "0,0.5", "--quiet",
    ).succeeds()  # fmt: skip
    assert given.out.splitlines()[0] == "q2,qdd1,tau1,tau2,outcome"
    arm = load(ROOT / "robots/2r.yaml")
    for row in given.rows:
        tau = inverse_dynamics(arm, [0.3, float(row["q2"])], [1, 2], [float(row["qdd1"]), 0.5])
        assert [float(row["tau1"]), float(row["tau2"])] == pytest.approx(tau, rel=1e-12)


def test_a_point_that_cannot_be_assembled_is_a_row(robodyn: Run) -> None:
    given = robodyn(*BAR, "--vary", "links.crank.l=0.35,1.2", "--q", "3", "--time", 0.2)
    assert given.code == 0
    assert [row["outcome"] for row in given.rows] == ["finished", "cannot assemble"]
    assert set(given.rows[1].values()) == {"1.2", "", "cannot assemble"}
    assert "1 cannot assemble" in given.err


def test_a_point_whose_loops_close_in_any_direction_is_singular(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    vary = ("--vary", "q1=-0.2:0.2:5", "--quiet")
    for how in (("--kind", "torque"), ("--time", 0.01, "--result", "final")):
        given = robodyn("sweep", scene(LEVER), *vary, *how).succeeds()
        outcomes = [row["outcome"] for row in given.rows]
        assert outcomes == ["finished", "finished", "singular", "finished", "finished"]
        assert set(given.rows[2].values()) == {"0.0", "", "singular"}


def test_a_branch_that_is_not_asked_for_decides_no_sweep(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    """The table of 1 kg at half its length rises by the arms' tips, their own centres by less."""
    path = scene(SCISSORS + STARTED)
    given = robodyn("sweep", path, "--kind", "torque", "--vary", "q1=20deg,30deg,40deg")
    needed = [2.4 * 9.81 * math.cos(math.radians(angle)) for angle in (20, 30, 40)]
    assert given.column("tau1") == pytest.approx(needed, rel=1e-12)


def test_flip_of_a_link(robodyn: Run) -> None:
    options = (*ARM, "--vary", "qd1=0,9", "--time", 1, "--result", "flip", "--q", "-90deg,0")
    given = robodyn(*options, "--flip", "upper arm", "--quiet").succeeds()
    still, flips = given.rows
    assert still["flip"] == ""
    arm = load(ROOT / "robots/2r.yaml")
    at = float(flips["flip"])
    motion = simulate(arm, [-math.pi / 2, 0], [9, 0], at, rtol=1e-11, atol=1e-11)
    assert motion.q[-1, 0] == pytest.approx(math.pi / 2, abs=1e-7)


# Joints that neither an actuator nor a loop determines

POLE = """gravity: 9.81
links:
  - {name: cart, joint: prismatic, axis: [1, 0], m: 1.3, l: 0, r: 0, I: 0}
  - {name: pole, m: 0.4, l: 1, r: 0.6, I: 0.05}
actuated: [cart]
"""
CARRIED = """gravity: 9.81
links:
  - {name: cart, joint: prismatic, axis: [1, 0], m: 2, l: 0, r: 0, I: 0}
  - {name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker, m: 1, l: 0.8, r: 0.36, I: 0.061, from: "cart@1.1,0"}
closures: [[coupler, rocker]]
actuated: [crank]
"""


def _pole(start: list[float], force: float, m: float) -> list[float]:
    """The end after 0.8 s by Lagrange's equations: the pole's centre is at x + r cos q, r sin q."""

    def rates(t: float, y: list[float]) -> list[float]:
        _, q, xd, qd = y
        M = [[1.3 + m, -m * 0.6 * math.sin(q)], [-m * 0.6 * math.sin(q), 0.05 + m * 0.36]]
        right = [force + m * 0.6 * math.cos(q) * qd**2, -m * 9.81 * 0.6 * math.cos(q)]
        return [xd, qd, *np.linalg.solve(M, right)]

    end: list[float] = solve_ivp(rates, (0, 0.8), start, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    return end


def test_a_pole_on_a_cart(robodyn: Run, scene: Callable[[str], Path]) -> None:
    varied = ("q2=60deg,80deg", "qd1=0,0.5", "tau1=0,2", "links.pole.m=0.4,0.7")
    words = [x for text in varied for x in ("--vary", text)]
    given = robodyn(
        "sweep", scene(POLE), *words, "--q", "0.1,0", "--qd", "0,-0.3", "--time", 0.8,
        "--result", "final", "--quiet",
    ).succeeds()  # fmt: skip
    assert len(given.rows) == 16
    for row in given.rows:
        q, qd, force, m = (float(row[name.partition("=")[0]]) for name in varied)
        end = [float(row[f"{name}_end"]) for name in ("q1", "q2", "qd1", "qd2")]
        assert end == pytest.approx(_pole([0.1, q, qd, -0.3], force, m), abs=1e-7)


def test_a_four_bar_on_a_cart(robodyn: Run, scene: Callable[[str], Path]) -> None:
    """Cart and crank determine the rest; nothing pushes along X, so the centre stays above it."""

    def places(q: list[float]) -> tuple[float, complex]:
        x, a, b, c = q
        crank, coupler = cmath.rect(1, a), cmath.rect(1, a + b)
        rocker, tip = cmath.rect(1, c), 0.35 * crank + 0.95 * coupler
        parts = [(2, 0), (0.6, 0.15 * crank), (1.3, 0.35 * crank + 0.45 * coupler)]
        parts += [(1, 1.1 + 0.36 * rocker)]
        return x + sum(m * at.real for m, at in parts) / 4.9, tip - 1.1 - 0.8 * rocker

    path = scene(CARRIED)
    words = ("sweep", path, "--vary", "q1=0,0.5", "--time", 1, "--result", "final", "--quiet")
    given = robodyn(*words, "--q", "0,60deg").succeeds()
    # of the two circles about the pins, where the coupler's tip is to the left
    mid = 0.35 * cmath.rect(1, math.pi / 3)
    way, along = 1.1 - mid, (0.95**2 - 0.8**2 + abs(1.1 - mid) ** 2) / (2 * abs(1.1 - mid))
    tip = mid + way / abs(way) * complex(along, math.sqrt(0.95**2 - along**2))
    b, c = cmath.phase(tip - mid) - math.pi / 3, cmath.phase(tip - 1.1)
    for row, x in zip(given.rows, (0.0, 0.5), strict=True):
        end = [float(row[f"q{k}_end"]) for k in range(1, 5)]
        (before, closed), (after, gap) = places([x, math.pi / 3, b, c]), places(end)
        assert abs(closed) < 1e-12
        assert abs(gap) < 1e-9
        assert after == pytest.approx(before, abs=1e-8)
        assert abs(end[1] - math.pi / 3) > 1.0
    assert robodyn(*words, "--q", f"0,60deg,{b!r},{c!r}").succeeds().out == given.out
    refused = robodyn(*words, "--q", 1).fails(2, "needs 4 values", "or 2 (cart, crank)")
    assert refused.out == ""


def test_a_loop_that_nothing_drives(robodyn: Run, scene: Callable[[str], Path]) -> None:
    text = (ROOT / "robots/four-bar.yaml").read_text()
    words = ("--vary", "q1=0.5,1", "--vary", "qd1=0,2", "--time", 0.5, "--quiet")
    driven = robodyn("sweep", scene(text), *words).succeeds()
    free = robodyn("sweep", scene(text.replace("actuated: [crank]", "actuated: []")), *words)
    assert free.succeeds().out == driven.out


# Files


ONE_BY_ONE = ["--event", "zero=q1", "--result", "events"]  # so that it takes its time
SMALL = ("--vary", "q1=0:3:30", "--vary", "q2=0:3:30", "--time", 0.05)


@pytest.fixture
def _small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nine chunks for 900 points."""
    small = sweep_plan.Plan

    def plan(**options: object) -> sweep_plan.Plan:
        return small(**{**options, "chunk": 100})  # type: ignore[arg-type]

    monkeypatch.setattr("robodyn.sweeps.sweep_request.Plan", plan)


@pytest.mark.usefixtures("_small_chunks")
def test_cut_off_anywhere_it_goes_on_to_the_same_bytes(robodyn: Run, tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole.csv", tmp_path / "cut.csv"
    done = robodyn(*ARM, *SMALL, "-o", whole, "--workers", 1)
    assert "900 points" in done.err
    assert "900 finished" in done.err
    assert done.out == ""
    data = whole.read_bytes()
    assert robodyn(*ARM, *SMALL, "--quiet", "--workers", 1).succeeds().out.encode() == data
    other = robodyn(*ARM, *SMALL, "-o", tmp_path / "two.csv", "--workers", 2)
    assert other.code == 0
    assert (tmp_path / "two.csv").read_bytes() == data

    _cut_off(robodyn, cut, 9)
    kept = {end: cut.with_name(f"cut.csv.partial{end}") for end in ("", ".json", ".sums")}
    rows = kept[""].read_bytes()
    assert rows == data
    facts = json.loads(kept[".json"].read_text())
    assert facts["version"] == package.__version__
    assert facts["variation"][0]["name"] == "q1"
    refused = robodyn(*ARM, *SMALL, "--rtol", 1e-8, "-o", cut)
    refused.fails(2, "cut.csv.partial", "there: rtol 1e-09; here: rtol 1e-08")
    assert "nothing was left to do" in robodyn(*ARM, *SMALL, "-o", cut).err
    assert cut.read_bytes() == data
    cut.unlink()
    for chunks in (0, 3, 7):
        _cut_off(robodyn, cut, chunks)
        resumed = robodyn(*ARM, *SMALL, "-o", cut, "--workers", 1)
        assert ("of 900 points: going on from there" in resumed.err) == (chunks > 0)
        assert "Warning" not in resumed.err
        assert cut.read_bytes() == data
        cut.unlink()


@pytest.mark.usefixtures("_small_chunks")
def test_rows_that_were_changed_are_computed_again_and_told(robodyn: Run, tmp_path: Path) -> None:
    out, partial = tmp_path / "out.csv", tmp_path / "out.csv.partial"
    data = robodyn(*ARM, *SMALL, "--quiet", "--workers", 1).succeeds().out.encode()
    ends = [k for k, byte in enumerate(data) if byte == 10]
    middle = ends[450]
    for changed, points in (
        (data[:middle] + b"0" + data[middle:], 400),  # a digit more
        (data[: middle - 20], 400),
        (data[: ends[300] + 1], 300),
        (data + data[middle + 1 : ends[451] + 1], 900),
        (data[: ends[100] + 1] + data[ends[200] + 1 :], 100),
    ):
        _cut_off(robodyn, out, 9)
        partial.write_bytes(changed)
        resumed = robodyn(*ARM, *SMALL, "-o", out, "--workers", 1, "--quiet")
        assert resumed.code == 0
        assert f"what follows the first {points} points in {partial} does not match" in resumed.err
        assert out.read_bytes() == data
        assert list(tmp_path.iterdir()) == [out]
        out.unlink()


@pytest.mark.usefixtures("_small_chunks")
def test_a_failed_simulation_and_a_sweep_into_one_file(robodyn: Run, tmp_path: Path) -> None:
    """Neither takes the rows of the other, whichever begins; both say where theirs are."""
    out = tmp_path / "out.csv"
    names = [f"out.csv.partial{end}" for end in ("", ".json", ".sums", ".1")]
    failing = ("simulate", "robots/2r.yaml", "--q", "0,0", "--max-evals", 300, "--quiet")
    data = robodyn(*ARM, *SMALL, "--quiet", "--workers", 1).succeeds().out
    _cut_off(robodyn, out, 3)
    failed = robodyn(*failing, "-o", out)
    assert failed.code == 1
    assert f"what was computed is in {out}.partial.1\n" in failed.err
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
    assert (tmp_path / names[3]).read_text().startswith("t,q1,")
    resumed = robodyn(*ARM, *SMALL, "-o", out, "--workers", 1)
    assert "has 300 of 900 points: going on" in resumed.err
    assert out.read_text() == data
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.csv", names[3]]

    failed = robodyn(*failing, "-o", out)
    partial = tmp_path / names[0]
    before = partial.read_text()
    assert before == (tmp_path / names[3]).read_text()
    refused = robodyn(*ARM, *SMALL, "-o", out)
    refused.fails(2, f"{partial}: is not of this sweep", "remove or rename it")
    assert partial.read_text() == before
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.usefixtures("_small_chunks")
def test_a_failed_simulation_beside_a_sweep_that_runs(robodyn: Run, tmp_path: Path) -> None:
    out, ran = tmp_path / "out.csv", []

    def interfering(plan: sweep_plan.Plan, number: int) -> Rows:
        if number == 4:
            options = ("--q", "0,0", "--max-evals", 300, "--quiet", "-o", out)
            ran.append(robodyn("simulate", "robots/2r.yaml", *options).code)
        return run_chunk(plan, number)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robodyn.sweeps.sweep_workers.run_chunk", interfering)
        assert robodyn(*ARM, *SMALL, "-o", out, "--workers", 1).code == 0
    assert ran == [1]
    assert out.read_text() == robodyn(*ARM, *SMALL, "--quiet", "--workers", 1).out
    assert (tmp_path / "out.csv.partial.1").read_text().startswith("t,q1,")


@pytest.mark.usefixtures("_small_chunks")
def test_facts_of_brackets_are_no_defect(robodyn: Run, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    _cut_off(robodyn, out, 2)
    (tmp_path / "out.csv.partial.json").write_text("[" * 100_000)
    refused = robodyn(*ARM, *SMALL, "-o", out).fails(2, "out.csv.partial.json", "damaged")
    assert "defect" not in refused.err


SPRUNG = "links: [{name: a, m: 1, l: 1, r: 0, I: 1}]\nsprings: [{joint: a, table: F.csv, angle: 0}]"
STIFF, REVERSED = "x,F\n-9,-90\n9,90\n", "x,F\n-9,90.\n9,-90\n"  # as many bytes


def _replace_table(path: Path, text: str) -> None:
    """Put another table in place of one, with the time of that, as `cp -p` may."""
    times = path.stat().st_atime_ns, path.stat().st_mtime_ns
    path.write_text(text)
    os.utime(path, ns=times)


@pytest.mark.usefixtures("_small_chunks")
def test_a_table_replaced_after_a_cut(
    robodyn: Run, tmp_path: Path, scene: Callable[[str], Path]
) -> None:
    """The torque that holds the arm at 0.3 is that of the spring, 10 * 0.3, at every point."""
    table, out = tmp_path / "F.csv", tmp_path / "out.csv"
    table.write_text(STIFF)
    words = ("sweep", scene(SPRUNG), "--vary", "links.a.m=1:2:900", "--q", 0.3, "--kind", "torque")
    _cut_off(robodyn, out, 3, words)
    _replace_table(table, REVERSED)
    refused = robodyn(*words, "-o", out).fails(2, "out.csv.partial", "another computation")
    assert refused.err.count("table F.csv") == 2
    assert robodyn(*words, "--quiet").succeeds().column("tau1") == [-3.0] * 900
    _replace_table(table, STIFF)
    resumed = robodyn(*words, "-o", out, "--workers", 1)
    assert "300 of 900 points: going on" in resumed.err
    assert out.read_text().count(",3.0,finished\n") == 900


def _cut_off(
    robodyn: Run, path: Path, chunks: int, words: tuple[object, ...] = (*ARM, *SMALL)
) -> None:
    """A sweep cut off after so many of nine chunks; after all of them before it takes its place."""

    def limited(plan: sweep_plan.Plan, number: int) -> Rows:
        if number >= chunks:
            raise KeyboardInterrupt
        return run_chunk(plan, number)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robodyn.sweeps.sweep_workers.run_chunk", limited)
        patch.setattr("robodyn.sweeps.resumable_file.ResumableFile.finish", lambda file: None)
        cut = robodyn(*words, "-o", path, "--workers", 1)
    assert cut.code == (0 if chunks == 9 else 130)
    assert chunks == 9 or f"{100 * chunks} of 900 points are in" in cut.err
    assert not path.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_killed_process_leaves_whole_chunks(number: int, tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    command = [sys.executable, "-m", "robodyn", *ARM, "--vary", "q1=0:3:200", "--vary",
               "q2=0:3:200", "--time", "0.1", *ONE_BY_ONE, "-o", str(path)]  # fmt: skip
    command += ["--workers", "2" if number == signal.SIGTERM else "1"]
    partial = tmp_path / "out.csv.partial"
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 60
    while not (partial.exists() and partial.stat().st_size > 1000):
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        assert time.monotonic() < until
        time.sleep(0.02)
    process.send_signal(number)
    assert process.stderr is not None
    _, told = process.communicate(timeout=60)
    ended = -number if number == signal.SIGKILL else 128 + number
    assert process.returncode == ended
    if number != signal.SIGKILL:
        assert "the same command goes on" in told
        assert "Traceback" not in told
    assert not path.exists()
    # of the chunk that was being written a part may be there: it has no digest, and is left out
    sizes = [int(line[:15]) for line in Path(f"{partial}.sums").read_bytes().splitlines()]
    header, rest = partial.read_bytes().split(b"\n", 1)
    assert header.startswith(b"q1,q2,")
    assert rest[: sum(sizes)].count(b"\n") == len(sizes) * sweep_plan.CHUNKS["DOP853"]
    assert len(rest) >= sum(sizes)
    assert rest[: sum(sizes)][-1:] in (b"\n", b"")
    assert json.loads((tmp_path / "out.csv.partial.json").read_text())["kind"] == "motion"


@pytest.mark.parametrize("later", [0.0, 0.1, 0.3, 0.6, 1.0, 1.5] if FRESH else [0.0, 0.3, 1.0])
def test_ctrl_c_is_quiet_while_processes_begin_and_work(later: float, tmp_path: Path) -> None:
    """A terminal sends it to all processes: none has a traceback or a warning to show."""
    command = [sys.executable, "-m", "robodyn", *ARM, "--vary", "q1=0:3:9000", "--time", "5"]
    command += ONE_BY_ONE
    command += ["--workers", "2", "-o", str(tmp_path / "out.csv")]
    process = subprocess.Popen(
        command, cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    until = time.monotonic() + 60
    while not (tmp_path / "out.csv.partial").exists() and time.monotonic() < until:
        time.sleep(0.01)
    time.sleep(later)
    os.killpg(process.pid, signal.SIGINT)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 130
    assert [line for line in told.splitlines() if "the same command goes on" not in line] == []


BIN = Path(sys.executable).parent
PLANTED = ("socket", "pickle", "multiprocessing", "random", "json", "numpy")


@pytest.mark.parametrize(
    "line",
    [[BIN / "robodyn"], [sys.executable, "-m", "robodyn"], [sys.executable, "-E", BIN / "robodyn"]],
)
def test_no_code_of_the_working_directory_runs(line: list[str | Path], tmp_path: Path) -> None:
    for name in PLANTED:
        text = f"open({str(tmp_path / 'ran')!r}, 'a').write({name!r})\nraise ImportError\n"
        (tmp_path / f"{name}.py").write_text(text)
    words = ["sweep", ROOT / "robots/2r.yaml", "--vary", "q1=0:3:4001", "--kind", "torque"]
    words += ["--workers", "2", "--quiet"]
    done = subprocess.run(
        [*line, *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("finished") == 4001
    assert not (tmp_path / "ran").exists()


# Streams


def test_in_a_pipe_that_closes(shell: Run) -> None:
    line = f"{sys.executable} -m robodyn sweep robots/2r.yaml --vary q1=0:3:3000 --time 0.1 --quiet"
    done = shell(f"{line} --workers 2 | head -2 | wc -l")
    assert done.out.strip() == "2"
    assert done.err == ""
    assert done.code == 0


def test_a_device_is_written_as_it_comes(robodyn: Run) -> None:
    given = robodyn(*ARM, "--vary", "q1=0,1", "--time", 0.1, "-o", os.devnull, "--quiet")
    given.succeeds()
    assert not Path(f"{os.devnull}.partial").exists()


def test_the_rows_of_a_cluster(robodyn: Run) -> None:
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    failed = robodyn(*ARM, "--vary", "q1=0,1", "--scheduler", "nonsense://x:1")
    failed.fails(1, "nonsense", "no Dask scheduler")


def test_a_scheduler_that_dies(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    at = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli.dask_"]
    options = ["--scheduler-file", str(at), "--no-dashboard"]
    begun = []

    def begin(what: str, *more: str) -> None:
        command = [*dask[:2], dask[2] + what, *options, *more]
        begun.append(subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True))

    def wait_for(process: subprocess.Popen[str], words: str) -> None:
        assert process.stderr is not None
        assert any(words in line for line in process.stderr)

    try:
        begin("scheduler", "--port", "0")
        wait_for(begun[0], "Scheduler at")
        begin("worker", "--nthreads", "1")
        wait_for(begun[0], "Register worker")
        address = json.loads(at.read_text())["address"]
        command = [sys.executable, "-m", "robodyn", *ARM, "--vary", "q1=0:3:3000", "--time", "9"]
        command += [*ONE_BY_ONE, "--scheduler", address]
        sweep = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
        wait_for(begun[0], "Receive client")
        time.sleep(0.3)
        begun[0].kill()
        _, told = sweep.communicate(timeout=60)
    finally:
        for process in begun:
            process.kill()
            process.communicate()
    assert sweep.returncode == 1
    # its workers may be seen to be lost first
    assert told.endswith("Error: the scheduler was lost: it ended, or the way to it did\n")


def test_the_scheduler_needs_its_extra(robodyn: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    refused = robodyn(*ARM, "--vary", "q1=0,1", "--scheduler", "tcp://x:1")
    refused.fails(2, "--scheduler", ".[cluster]")


def test_torques_of_a_loop_that_keeps_an_angle(robodyn: Run, scene: Callable[[str], Path]) -> None:
    """The moment of the angle is among the columns, as in `torque`."""
    path = scene(BLOCK)
    swept = robodyn(
        "sweep", path, "--kind", "torque", "--vary", "qd1=1,2", "--q", 0.4, "--quiet"
    ).succeeds()
    for row in swept.rows:
        single = robodyn("torque", path, "--q", 0.4, "--qd", row["qd1"]).succeeds().row
        assert list(row) == ["qd1", *single, "outcome"]
        assert "mz1" in single
        for name, value in single.items():
            assert float(row[name]) == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_load_too_fast_for_samples_is_told_once_and_first(
    robodyn: Run, tmp_path: Path, workers: str
) -> None:
    path = tmp_path / "fast.yaml"
    link = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
    path.write_text(link + 'loads: [{link: a, torque: "sin(1e9*t)"}]\n')
    options = ["--vary", "q1=0:1:2", "--time", "1", "--max-steps", "500", "--workers", workers]
    given = robodyn("sweep", path, *options)
    first, *others = given.err.splitlines()
    assert first.startswith("Warning: the torque changes too fast to be sampled")
    assert not any("too fast" in line for line in others)
    assert [row["outcome"] for row in given.rows] == ["too many evaluations"] * 2
