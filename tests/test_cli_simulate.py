"""`robodyn simulate`: rows, round trip, torques, outcomes, and what happens to files."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ARM, FOUR_BAR = "robots/2r.yaml", "robots/four-bar.yaml"


def simulate(*arguments: object, stdin: str | None = None) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "robodyn", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, cwd=ROOT, input=stdin, check=False)


def rows(text: str) -> list[list[float]]:
    return [[float(x) for x in line.split(",")] for line in text.splitlines()[1:]]


def test_columns_and_rows() -> None:
    done = simulate("simulate", ARM, "--q", "0.3,0.2", "--time", "1", "--every", "0.3")
    assert done.returncode == 0
    assert done.stdout.splitlines()[0] == "t,q1,q2,qd1,qd2,qdd1,qdd2,tau1,tau2,energy"
    assert [row[0] for row in rows(done.stdout)] == pytest.approx([0, 0.3, 0.6, 0.9, 1.0])
    assert "finished" in done.stderr
    done = simulate("simulate", FOUR_BAR, "--q", "60deg", "--time", "1", "--points", "3", "--quiet")
    names = "t,q1,q2,q3,qd1,qd2,qd3,qdd1,qdd2,qdd3,tau1,fx1,fy1,energy,gap"
    assert done.stdout.splitlines()[0] == names
    assert [row[0] for row in rows(done.stdout)] == [0.0, 0.5, 1.0]
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("scene", "q", "tau", "applied"),
    [(ARM, "0.3,0.2", "3,1", [3.0, 1.0]), (FOUR_BAR, "60deg", "1.5", [1.5])],
)
def test_torque_finds_what_was_applied(scene: str, q: str, tau: str, applied: list[float]) -> None:
    motion = simulate("simulate", scene, "--q", q, "--tau", tau, "--time", "1", "--quiet").stdout
    names = motion.splitlines()[0].split(",")
    kept = [k for k, name in enumerate(names) if not name.startswith(("tau", "fx", "fy"))]
    bare = "\n".join(",".join(line.split(",")[k] for k in kept) for line in motion.splitlines())
    back = simulate("torque", scene, "-", stdin=bare + "\n")
    assert back.returncode == 0
    header = back.stdout.splitlines()[0].split(",")
    places = [k for k, name in enumerate(header) if name.startswith("tau")]
    for row in rows(back.stdout):
        assert [row[k] for k in places] == pytest.approx(applied, rel=1e-9)


def test_torques_from_a_table() -> None:
    table = "t,tau1,tau2\n0,1,0\n0.5,2,0\n1,0,1\n"
    options = ("--q", "0,0", "--time", "1", "--points", "5", "--quiet", "--tau-from", "-")
    done = simulate("simulate", ARM, *options, stdin=table)
    assert [row[7:9] for row in rows(done.stdout)] == [[1, 0], [1.5, 0], [2, 0], [1, 0.5], [0, 1]]
    short = simulate("simulate", ARM, *options, stdin="t,tau1,tau2\n0,1,0\n0.5,2,0\n")
    assert short.returncode == 2
    assert "must cover the simulation" in short.stderr


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--time", "nan"), ["--time", "finite"]),
        (("--every", "0"), ["--every", "> 0"]),
        (("--points", "0"), ["--points", ">= 1"]),
        (("--every", "1", "--points", "3"), ["exclude each other"]),
        (("--rtol", "2"), ["rtol", "1)"]),
        (("--atol", "-1"), ["atol", "> 0"]),
        (("--tau", "1"), ["tau", "2 values"]),
        (("--tau", "open('x')"), ["does not allow"]),
        (("--tau", "q1.real, 0"), ["does not allow"]),
        (("--method", "Euler"), ["Euler"]),
        (("--max-evals", "0"), ["max_evals", ">= 1"]),
    ],
)
def test_wrong_input(options: tuple[str, ...], parts: list[str]) -> None:
    done = simulate("simulate", ARM, "--q", "0,0", *options)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    for part in parts:
        assert part in done.stderr


def test_what_does_not_finish_keeps_the_older_file(tmp_path: Path) -> None:
    out = tmp_path / "run.csv"
    out.write_text("older\n")
    options = ("--q", "0,0", "--time", "10", "--max-evals", "500", "--out", out)
    done = simulate("simulate", ARM, *options)
    assert done.returncode == 1
    assert "too many evaluations" in done.stderr
    assert "--max-evals" in done.stderr
    assert out.read_text() == "older\n"
    kept = tmp_path / "run.csv.partial"
    assert str(kept) in done.stderr
    assert len(kept.read_text().splitlines()) > 5
    done = simulate("simulate", ARM, "--q", "0,0", "--time", "1", "--out", out)
    assert done.returncode == 0
    assert len(out.read_text().splitlines()) == 1002


def test_report(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    simulate("simulate", FOUR_BAR, "--q", "1", "--time", "1", "--report", report, "--quiet")
    facts = json.loads(report.read_text())
    assert facts["outcome"] == "finished"
    assert facts["largest_gap"] < 1e-14
    assert facts["t_reached"] == 1.0


def test_ctrl_c_ends_at_a_whole_line(tmp_path: Path) -> None:
    options = ["--q", "0.3,0.2", "--time", "100000", "--every", "0.01"]
    line = [sys.executable, "-m", "robodyn", "simulate", ARM, *options]
    out = tmp_path / "motion.csv"
    with out.open("wb") as stream:
        child = subprocess.Popen(line, cwd=ROOT, stdout=stream, stderr=subprocess.PIPE)
        while out.stat().st_size < 1000:
            assert child.poll() is None
            time.sleep(0.05)
        child.send_signal(signal.SIGINT)
        _, err = child.communicate(timeout=60)
    assert child.returncode == 1
    assert b"interrupted" in err
    written = out.read_bytes()
    assert written.endswith(b"\n")
    assert {row.count(b",") for row in written.splitlines()} == {9}


def test_only_simulate_imports_scipy() -> None:
    code = (
        "import sys; from robodyn.cli import run; run(sys.argv[1:]); print('scipy' in sys.modules)"
    )
    for command, expected in (("simulate", "True"), ("accel", "False"), ("energy", "False")):
        line = [sys.executable, "-c", code, command, ARM, "--q", "0,0"]
        line += ["--time", "0.1", "--quiet"] if command == "simulate" else []
        done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT, check=True)
        assert done.stdout.splitlines()[-1] == expected
