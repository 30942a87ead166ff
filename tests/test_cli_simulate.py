"""`robodyn simulate`: what it writes, where it writes it, and how it ends."""

from __future__ import annotations

import itertools
import json
import math
import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT, TWO_LINK, Outcome

import oracles
from robodyn import assemble, load, simulate
from robodyn.cli import progress

Run = Callable[..., Outcome]
PATIENCE = 60.0  # s, on a busy machine
ARM = ("simulate", "robots/2r.yaml", "--q", "0.3,-0.7", "--qd", "1,2")
CRANK = ("simulate", "robots/four-bar.yaml", "--q", "1", "--qd", "3")
OPEN = "t,q1,q2,qd1,qd2,qdd1,qdd2,tau1,tau2,energy"
CLOSED = "t,q1,q2,q3,qd1,qd2,qd3,qdd1,qdd2,qdd3,tau1,fx1,fy1,energy,gap"
METHODS = ("DOP853", "RK45", "Radau")


def numbers(given: Outcome, *names: str) -> np.ndarray:
    """Columns of stdout as an array (rows, names)."""
    return np.array([given.column(name) for name in names]).T


def joints(name: str, n: int) -> list[str]:
    return [f"{name}{k}" for k in range(1, n + 1)]


# Rows and columns


def test_columns_of_an_open_chain(robodyn: Run) -> None:
    given = robodyn(*ARM, "--time", 0.5, "--points", 3, "--quiet", "--tau", "1.5, t").succeeds()
    assert given.out.splitlines()[0] == OPEN
    assert given.column("t") == [0.0, 0.25, 0.5]
    assert given.column("tau1") == [1.5] * 3
    assert given.column("tau2") == [0.0, 0.25, 0.5]
    first = given.rows[0]
    assert [float(first[name]) for name in ("q1", "q2", "qd1", "qd2")] == [0.3, -0.7, 1.0, 2.0]
    for row in given.rows:
        x = {name: float(text) for name, text in row.items()}
        q, qd = np.array([x["q1"], x["q2"]]), np.array([x["qd1"], x["qd2"]])
        qdd = oracles.two_link_acceleration(TWO_LINK, q, qd, np.array([x["tau1"], x["tau2"]]))
        assert [x["qdd1"], x["qdd2"]] == pytest.approx(qdd, rel=1e-11)
        M, _, _ = oracles.two_link_terms(TWO_LINK, q, qd)
        s1, s12 = math.sin(q[0]), math.sin(q.sum())
        height = 1.5 * 0.36 * s1 + 0.9 * (0.8 * s1 + 0.25 * s12)
        assert x["energy"] == pytest.approx(qd @ M @ qd / 2 + 9.81 * height, rel=1e-12)


def test_columns_of_a_four_bar(robodyn: Run) -> None:
    given = robodyn(*CRANK, "--time", 1, "--every", 0.1, "--quiet", "--tau", "0.4").succeeds()
    assert given.out.splitlines()[0] == CLOSED
    assert len(given.rows) == 11
    for row in given.rows:
        x = {name: float(text) for name, text in row.items()}
        q, qd, qdd = ([x[f"{name}{k}"] for k in (1, 2, 3)] for name in ("q", "qd", "qdd"))
        expected, force = oracles.four_bar_acceleration(
            FOUR_BAR, np.array(q), np.array(qd), np.array([0.4, 0, 0])
        )
        assert qdd == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())
        assert [x["fx1"], x["fy1"]] == pytest.approx(force, abs=1e-10 * np.abs(force).max())
        assert x["gap"] < 1e-14
        closed = oracles.four_bar_position(FOUR_BAR, q[0])
        assert np.exp(1j * np.array(q)) == pytest.approx(np.exp(1j * closed), abs=1e-12)


def test_the_gap_is_that_of_the_tips(robodyn: Run) -> None:
    given = robodyn(*CRANK, "--time", 5, "--stabilize", "none", "--rtol", "1e-5", "--quiet")
    gaps = [
        np.linalg.norm(oracles.four_bar_terms(FOUR_BAR, q, (0, 0, 0)).gap)
        for q in numbers(given.succeeds(), *joints("q", 3))
    ]
    assert given.column("gap") == pytest.approx(gaps, abs=1e-15)
    assert max(gaps) > 1e-7


@pytest.mark.parametrize(
    ("model", "q", "header"),
    [
        ("pendulum", "1", "t,q1,qd1,qdd1,tau1,energy"),
        ("slider-crank", "50deg", "t,q1,q2,qd1,qd2,qdd1,qdd2,tau1,fx1,fy1,energy,gap"),
        (
            "five-bar",
            "120deg,60deg",
            "t,q1,q2,q3,q4,qd1,qd2,qd3,qd4,qdd1,qdd2,qdd3,qdd4,tau1,tau3,fx1,fy1,energy,gap",
        ),
    ],
)
def test_columns_of_other_scenes(robodyn: Run, model: str, q: str, header: str) -> None:
    scene = f"robots/{model}.yaml"
    given = robodyn("simulate", scene, "--q", q, "--time", 0.1, "--points", 2, "--quiet")
    assert given.succeeds().out.splitlines()[0] == header
    assert all(math.isfinite(float(x)) for row in given.rows for x in row.values())


def test_the_motion_is_that_of_the_python_function(robodyn: Run) -> None:
    given = robodyn(*CRANK, "--time", 1, "--points", 5, "--quiet", "--tau", "sin(t)").succeeds()
    mech = load(ROOT / "robots/four-bar.yaml")
    start = numbers(given, *joints("q", 3), *joints("qd", 3))[0]
    motion = simulate(mech, start[:3], start[3:], 1.0, "sin(t)", t_eval=given.column("t"))
    assert numbers(given, *joints("q", 3)) == pytest.approx(motion.q, abs=1e-13)
    assert numbers(given, *joints("qdd", 3)) == pytest.approx(motion.qdd, abs=1e-10)
    assert start[:3] == pytest.approx(assemble(mech, [1.0]), abs=1e-15)


@pytest.mark.parametrize(
    ("options", "times"),
    [
        ("--time 1 --every 0.25", [0, 0.25, 0.5, 0.75, 1]),
        ("--time 1 --every 0.3", [0, 0.3, 0.6, 0.9, 1]),
        ("--time 0.3 --every 0.1", [0, 0.1, 0.2, 0.3]),
        ("--time 1 --every 5", [0, 1]),
        ("--time 1e-9 --every 5", [0, 1e-9]),
        ("--time 1 --every 1", [0, 1]),
        ("--time 1e-9 --every 3e-10", [0, 3e-10, 6e-10, 9e-10, 1e-9]),
        ("--time 1 --points 5", [0, 0.25, 0.5, 0.75, 1]),
        ("--time 1 --points 2", [0, 1]),
        ("--time 1 --points 1", [1]),
        ("--time 0", [0]),
        ("--time 0 --points 7", [0]),
        ("--time 0 --every 0.1", [0]),
        ("--time=-1 --every 0.4", [0, -0.4, -0.8, -1]),
        ("--time=-1 --points 3", [0, -0.5, -1]),
        ("--time 7", list(np.linspace(0, 7, 1001))),
        ("--points 11", list(range(11))),  # ten seconds, if nothing is said
    ],
)
def test_rows_at_0_every_so_often_and_at_the_end(
    robodyn: Run, options: str, times: list[float]
) -> None:
    given = robodyn(*ARM, *options.split(), "--quiet").succeeds()
    t = given.column("t")
    assert t == pytest.approx(times, rel=1e-14)
    assert t[-1] == times[-1]  # exactly
    assert t[0] == times[0]
    assert (np.diff(t) * np.sign(times[-1]) > 0).all()


def test_rows_of_a_time_that_nearly_is_a_multiple(robodyn: Run) -> None:
    """2 s less 1.5e-12 s every millisecond: a row at the end itself."""
    given = robodyn(*ARM, "--time", "1.9999999999985", "--every", "0.001", "--quiet").succeeds()
    assert given.column("t")[-1] == 1.9999999999985
    assert len(given.rows) in (2001, 2000)


def test_a_row_is_the_same_however_many_there_are(robodyn: Run) -> None:
    few = robodyn(*CRANK, "--time", 1, "--points", 3, "--quiet").succeeds()
    many = robodyn(*CRANK, "--time", 1, "--points", 1601, "--quiet").succeeds()  # several batches
    assert len(many.rows) == 1601
    names = few.out.splitlines()[0].split(",")
    assert numbers(many, *names)[::800] == pytest.approx(numbers(few, *names), abs=1e-10)


def test_floats_are_written_in_full(robodyn: Run) -> None:
    given = robodyn(*ARM, "--time", 1, "--points", 4, "--quiet").succeeds()
    assert given.out.endswith("\n")
    assert "\r" not in given.out
    for line in given.out.splitlines()[1:]:
        for text in line.split(","):
            assert repr(float(text)) == text


def test_a_state_of_all_joints_or_of_the_actuated_ones(robodyn: Run) -> None:
    short = robodyn(*CRANK, "--time", 0.5, "--points", 2, "--quiet").succeeds()
    row = short.rows[0]
    q, qd = (",".join(row[f"{name}{k}"] for k in (1, 2, 3)) for name in ("q", "qd"))
    whole = robodyn(
        *CRANK[:2], f"--q={q}", f"--qd={qd}", "--time", 0.5, "--points", 2, "--quiet"
    ).succeeds()
    names = CLOSED.split(",")
    assert numbers(whole, *names) == pytest.approx(numbers(short, *names), abs=1e-12)


def test_degrees_and_negative_vectors(robodyn: Run) -> None:
    options = ("--time", 0, "--quiet")
    given = robodyn("simulate", "robots/2r.yaml", "--q", "-30deg,pi/4", *options).succeeds()
    assert given.has("q1", "q2") == pytest.approx([-math.pi / 6, math.pi / 4], rel=1e-15)
    assert given.has("qd1", "qd2") == [0.0, 0.0]


# What goes out comes in again


@pytest.mark.parametrize(
    ("model", "start", "tau"),
    [
        ("2r", "--q 0.3,-0.7 --qd 1,2", "2*sin(3*t), -0.5*qd2"),
        ("2r", "--q 0.3,-0.7", "1,0"),
        ("3r", "--q 0.3,-0.7,0.2", "cos(t), -qd2, 0.1*q3"),
        ("four-bar", "--q 1 --qd 3", "2*sin(3*t) + 1"),
        ("slider-crank", "--q 1 --qd 6", "0.5 - 0.02*qd1"),
        ("five-bar", "--q 120deg,60deg", "sin(5*t), -0.3*qd3"),
    ],
)
def test_torque_of_the_motion_is_the_torque_applied(
    robodyn: Run, model: str, start: str, tau: str
) -> None:
    scene, options = f"robots/{model}.yaml", ("--time", 2, "--every", 0.01, "--quiet")
    given = robodyn("simulate", scene, *start.split(), *options, "--tau", tau).succeeds()
    header = given.out.splitlines()[0]
    names = [name for name in header.split(",") if name.startswith(("tau", "fx", "fy"))]
    applied = numbers(given, *names)
    assert len(applied) == 201
    size = np.abs(applied).max(axis=0)
    assert size.max() > 0.1
    kept = [k for k, name in enumerate(header.split(",")) if name not in names]
    bare = [",".join(line.split(",")[k] for k in kept) for line in given.out.splitlines()]
    # with the torques to replace, or without
    for motion, seen in ((given.out, Outcome.replaces), ("\n".join(bare) + "\n", Outcome.succeeds)):
        back = seen(robodyn("torque", scene, "-", stdin=motion))
        error = np.abs(numbers(back, *names) - applied).max(axis=0)
        assert (error <= 1e-9 * np.maximum(size, 1e-3)).all()
    again = robodyn("energy", scene, "-", stdin=given.out).replaces()
    assert numbers(again, "energy") == pytest.approx(numbers(given, "energy"), rel=1e-12)


def test_in_a_pipe(quick_shell: Run) -> None:
    """What simulate writes torque reads, as a shell runs it."""
    given = quick_shell(
        "robodyn simulate robots/2r.yaml --q 30deg,45deg --time 1 --every 0.25 --tau 1,0 --quiet "
        "| robodyn torque robots/2r.yaml -"
    ).replaces()
    assert given.column("tau1") == pytest.approx([1.0] * 5, abs=1e-12)
    assert given.column("tau2") == pytest.approx([0.0] * 5, abs=1e-12)


def test_its_own_torques_as_a_table_give_its_motion(robodyn: Run, tmp_path: Path) -> None:
    options = ("--time", 1, "--every", 0.001, "--quiet")
    first = robodyn(*CRANK, *options, "--tau", "sin(3*t)").succeeds()
    file = tmp_path / "motion.csv"
    file.write_text(first.out)
    second = robodyn(*CRANK, *options, "--tau-from", file).succeeds()
    names = [*joints("q", 3), *joints("qd", 3), "tau1"]
    difference = np.abs(numbers(second, *names) - numbers(first, *names)).max()
    assert 0.0 < difference < 1e-4  # linear between the rows: h^2 / 8 of the torque's bend
    third = robodyn(*CRANK, *options, "--tau-from", "-", stdin=first.out).succeeds()
    assert third.out == second.out


# Torques


def test_a_table_from_a_file_and_from_stdin(robodyn: Run, tmp_path: Path) -> None:
    table = "t,tau2,note,tau1\n-1,0,a,0\n0,1,b,2\n0.5,1,c,-2\n0.5000000001,5,d,-2\n2,5,e,0\n"
    file = tmp_path / "torques.csv"
    file.write_text(table)
    options = ("--time", 1, "--every", 0.25, "--quiet")
    given = robodyn(*ARM, *options, "--tau-from", file).succeeds()
    assert given.column("tau1") == pytest.approx([2, 0, -2, -2 + 2 / 1.5 * 0.25, -4 / 3], abs=1e-8)
    assert given.column("tau2") == pytest.approx([1, 1, 1, 5, 5], abs=1e-8)
    assert robodyn(*ARM, *options, "--tau-from", "-", stdin=table).succeeds().out == given.out


def test_the_integrator_steps_onto_the_kinks_of_a_table(robodyn: Run, tmp_path: Path) -> None:
    """A square wave costs no more than its steps, as rows and as an expression."""
    rows = ["t,tau1"]
    for k in range(20):
        rows += [f"{k / 20},{5 * (-1) ** k}", f"{(k + 1) / 20 - 1e-9},{5 * (-1) ** k}"]
    table = "\n".join([*rows, "1,5"]) + "\n"
    report = tmp_path / "report.json"
    options = ("--time", 1, "--points", 2, "--quiet", "--report", report)
    counts = []
    for torque in (("--tau-from", "-"), ("--tau", "5*sign(sin(20*pi*t + 1e-12))")):
        given = robodyn(*CRANK, *options, *torque, stdin=table).succeeds()
        facts = json.loads(report.read_text())
        counts.append(facts["evaluations"])
        first, last = given.column("energy")
        assert facts["energy_drift"] < 1e-7
        assert facts["work"] == pytest.approx(last - first, abs=1e-6)
    assert counts[1] < counts[0]  # without the ramps between the rows


def test_rows_that_hold_are_a_square_wave(robodyn: Run) -> None:
    """As samples, as steps of two rows at one time, and as an expression."""
    samples = "t,tau1\n" + "".join(f"{k / 20},{5 * (-1) ** k}\n" for k in range(21))
    steps = ["t,tau1"]
    for k in range(20):
        steps += [f"{k / 20},{5 * (-1) ** k}", f"{(k + 1) / 20},{5 * (-1) ** k}"]
    options = ("--time", 1, "--points", 11, "--quiet", "--tau-from", "-")
    held = robodyn(*CRANK, *options, "--tau-hold", stdin=samples).succeeds()
    stepped = robodyn(*CRANK, *options, stdin="\n".join(steps) + "\n").succeeds()
    assert stepped.out == held.out
    square = ("--tau", "5*sign(sin(20*pi*t + 1e-12))")
    wave = robodyn(*CRANK, *options[:-2], *square).succeeds()
    assert held.column("q1") == pytest.approx(wave.column("q1"), abs=1e-8)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("stabilize", ["projection", "baumgarte", "none"])
def test_every_method_with_every_stabilization(robodyn: Run, method: str, stabilize: str) -> None:
    rows = ("--time", 0.5, "--points", 2, "--quiet")
    options = ("--rtol", "1e-7", "--atol", "1e-7", "--method", method, "--stabilize", stabilize)
    given = robodyn(*CRANK, *rows, *options).succeeds()
    known = robodyn(*CRANK, *rows).succeeds()
    names = [*joints("q", 3), *joints("qd", 3)]
    assert numbers(given, *names) == pytest.approx(numbers(known, *names), abs=3e-4)


def test_the_baumgarte_rate_is_taken(robodyn: Run, tmp_path: Path) -> None:
    report, gaps = tmp_path / "report.json", []
    options = ("--time", 5, "--rtol", "1e-5", "--stabilize", "baumgarte", "--quiet")
    for rate in (1, 30):
        robodyn(*CRANK, *options, "--baumgarte-rate", rate, "--report", report).succeeds()
        gaps.append(json.loads(report.read_text())["largest_gap"])
    assert gaps[1] < 0.3 * gaps[0]


# The summary


def test_the_summary_of_an_open_chain(robodyn: Run) -> None:
    given = robodyn(*ARM, "--time", 1)
    assert given.code == 0
    assert len(given.out.splitlines()) == 1002
    for part in ("finished", "t = 1 s", "DOP853", "1e-09", "energy drift"):
        assert part in given.err
    assert re.search(r"\d+ steps, \d+ evaluations, [\d.e-]+ s\b", given.err)
    for word in ("gap", "singular", "work", "balance", "nan"):
        assert word not in given.err


def test_the_summary_of_a_driven_four_bar(robodyn: Run) -> None:
    given = robodyn(*CRANK, "--time", 1, "--tau", "0.5", "--method", "Radau")
    assert given.code == 0
    for part in ("finished", "Radau", "energy balance", "work done", "largest gap", "m/s"):
        assert part in given.err
    assert re.search(r"nearest to singular: 0\.\d+ at t = [\d.]+ s", given.err)


def test_quiet_says_nothing(robodyn: Run) -> None:
    loud = robodyn(*ARM, "--time", 1)
    quiet = robodyn(*ARM, "--time", 1, "--quiet").succeeds()
    assert loud.err
    assert loud.out == quiet.out


def test_the_report(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    options = ("--time", 2, "--tau", "0.5", "--rtol", "1e-8", "--quiet")
    given = robodyn(*CRANK, *options, "--report", file).succeeds()
    facts = json.loads(file.read_text(), parse_constant=pytest.fail)
    assert facts["outcome"] == "finished"
    assert facts["advice"] == ""
    assert (facts["method"], facts["rtol"], facts["atol"]) == ("DOP853", 1e-8, 1e-9)
    assert facts["stabilize"] == "projection"
    assert facts["t_reached"] == facts["t_end"] == 2.0
    assert facts["steps"] > 20
    assert facts["evaluations"] > 11 * facts["steps"]
    assert facts["seconds"] > 0.0
    energy, crank = given.column("energy"), given.column("q1")
    assert facts["energy_start"] == pytest.approx(energy[0], rel=1e-13)
    assert facts["work"] == pytest.approx(energy[-1] - energy[0], abs=1e-6)
    assert facts["work"] == pytest.approx(0.5 * (crank[-1] - crank[0]), abs=1e-6)
    assert 0.0 < facts["energy_drift"] < 1e-6
    assert 0.0 < facts["largest_gap"] < 1e-14
    assert 0.0 < facts["largest_gap_rate"] < 1e-13
    assert 0.1 < facts["nearest_singular"] < 0.5
    assert 0.0 <= facts["nearest_singular_time"] <= 2.0


def test_the_report_of_a_run_that_did_not_finish(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    given = robodyn(*ARM, "--max-evals", 300, "--report", file, "--quiet")
    given.fails(1, "too many evaluations", "--max-evals")
    facts = json.loads(file.read_text(), parse_constant=pytest.fail)
    assert facts["outcome"] == "too many evaluations"
    assert "--max-evals" in facts["advice"]
    assert 0.0 < facts["t_reached"] < facts["t_end"] == 10.0
    assert given.column("t")[-1] <= facts["t_reached"]


# Outcomes


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        ("--max-evals 200", ["too many evaluations at t = ", "of 1 s", "--max-evals"]),
        ("--tau sqrt(0.5-t),0", ["step too small at t = 0.5 s", "torque"]),
        ("--tau 1/(0.5-t),0", ["step too small at t = 0.5 s", "torque"]),
        ("--tau 0,-1e4*qd2", ["stiff at t = ", "--method Radau"]),
    ],
)
def test_a_run_that_does_not_finish(robodyn: Run, options: str, parts: list[str]) -> None:
    """Exit code 1, the outcome with its advice, and the rows until then."""
    every = 1e-3 if "stiff" not in parts[0] else 1e-4
    arguments = (*ARM, *options.split(), "--time", 1, "--every", every)
    given = robodyn(*arguments, "--quiet").fails(1, *parts)
    t = given.column("t")
    assert t == pytest.approx(every * np.arange(len(t)), abs=1e-12)
    assert 10 < len(t) < 0.9 / every
    loud = robodyn(*arguments)
    assert loud.code == 1
    assert loud.out == given.out
    assert parts[0].partition(" at ")[0] in loud.err
    assert loud.err.endswith(given.err.splitlines(keepends=True)[-1])


def test_the_advice_for_a_stiff_run_works(robodyn: Run) -> None:
    given = robodyn(*ARM, "--tau", "0, -1e4*qd2", "--time", 1, "--method", "Radau", "--quiet")
    assert given.succeeds().column("t")[-1] == 1.0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "tau", ["sqrt(0.5-t), 0", "1/(0.5-t), 0", "1e200, 0", "0, exp(2000*t)", "(0.5-t)**0.5, 0"]
)
@pytest.mark.thinned
def test_a_torque_that_ends_in_nothing_finite(robodyn: Run, method: str, tau: str) -> None:
    """Whatever the method makes of it: an outcome and rows of numbers, no defect."""
    options = ("--method", method, "--rtol", "1e-6", "--max-evals", 4000)
    given = robodyn(*ARM, "--tau", tau, "--time", 1, "--quiet", *options)
    given.fails(1, " at t = ", " of 1 s: ")
    assert given.rows
    assert all(math.isfinite(float(x)) for row in given.rows for x in row.values())


def test_a_start_that_cannot_be(robodyn: Run) -> None:
    robodyn(*ARM, "--tau", "1/t, 0", "--quiet").fails(1, "cannot start", "robots/2r.yaml", "finite")


def test_an_open_loop_is_refused_and_can_be_assembled(robodyn: Run) -> None:
    given = ("simulate", "robots/four-bar.yaml", "--q", "1,-0.4,1.6", "--time", 0.1, "--points", 2)
    fixed = robodyn(*given, "--assemble")
    assert fixed.code == 0
    told = re.search(r"assembled: joints moved by up to ([\d.e-]+) rad", fixed.err)
    assert told is not None
    q = numbers(fixed, *joints("q", 3))[0]
    assert np.linalg.norm(oracles.four_bar_terms(FOUR_BAR, q, (0, 0, 0)).gap) < 1e-14
    assert q == pytest.approx([1, -0.4, 1.6], abs=0.2)
    assert float(told[1]) == pytest.approx(np.abs(q - [1, -0.4, 1.6]).max(), rel=5e-3)


# Files


def test_out_writes_what_stdout_would_have(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_text("old\n")
    given = robodyn(*ARM, "--time", 1, "--quiet").succeeds()
    silent = robodyn(*ARM, "--time", 1, "--quiet", "--out", file).succeeds()
    assert silent.out == ""
    assert file.read_text() == given.out
    assert os.listdir(tmp_path) == ["run.csv"]


def kept(given: Outcome) -> Path:
    """The file that a failed run says it has kept."""
    told = re.search(r"what was computed is in (\S+)", given.err)
    assert told is not None, given.err
    return Path(told[1])


def test_a_failed_run_leaves_the_older_file_and_keeps_what_it_computed(
    robodyn: Run, tmp_path: Path
) -> None:
    file = tmp_path / "run.csv"
    file.write_text("old\n")
    given = robodyn(*ARM, "--every", 0.01, "--max-evals", 500, "--out", file)
    assert given.code == 1
    assert given.out == ""
    assert file.read_text() == "old\n"
    assert sorted(os.listdir(tmp_path)) == sorted(["run.csv", kept(given).name])
    part = Outcome(0, kept(given).read_text(), "")
    assert part.out.endswith("\n")
    assert part.out.splitlines()[0] == OPEN
    assert len(part.rows) > 10
    whole = robodyn(*ARM, "--every", 0.01, "--quiet").succeeds()
    names = OPEN.split(",")
    until = numbers(whole, *names)[: len(part.rows)]
    assert numbers(part, *names) == pytest.approx(until, rel=1e-12, abs=1e-12)


def test_what_the_last_failure_computed_is_what_is_kept(robodyn: Run, tmp_path: Path) -> None:
    file, counts = tmp_path / "run.csv", []
    for most in (300, 900):
        given = robodyn(*ARM, "--every", 0.01, "--max-evals", most, "--out", file, "--quiet")
        assert given.code == 1
        counts.append(len(kept(given).read_text().splitlines()))
    assert counts[1] > 1.5 * counts[0]
    assert not file.exists()


def test_a_run_that_cannot_start_leaves_nothing(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_text("old\n")
    robodyn(*ARM, "--tau", "1/t, 0", "--out", file, "--quiet").fails(1, "cannot start")
    assert os.listdir(tmp_path) == ["run.csv"]
    assert file.read_text() == "old\n"


@pytest.mark.parametrize("options", ["> /dev/full", "--out /dev/full", "--report /dev/full"])
def test_a_full_disk_is_told(shell: Run, quick_shell: Run, options: str) -> None:
    run = shell if options.startswith(">") else quick_shell
    given = run(f"robodyn simulate robots/2r.yaml --q 1,2 --time 1 --quiet {options}")
    given.fails(1, "No space left on device")


def test_a_closed_pipe_ends_quietly(quick_shell: Run) -> None:
    """Long before the end, and without a word."""
    given = quick_shell(
        "robodyn simulate robots/2r.yaml --q 1,2 --time 1e4 --every 0.1 --quiet | head -2; "
        "echo ${PIPESTATUS[0]}"
    )
    header, first, code = given.out.splitlines()
    assert header == OPEN
    assert first.startswith("0.0,1.0,2.0,")
    assert code == "0"
    assert given.err == ""


# Signals


@contextmanager
def running(*arguments: object, stdout: Path, stderr: int) -> Iterator[subprocess.Popen[bytes]]:
    """A simulation in a process of its own, its rows in a file."""
    with stdout.open("wb") as file:
        child = subprocess.Popen(
            [sys.executable, "-m", "robodyn", *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=stderr,
            cwd=ROOT,
        )
    try:
        yield child
    finally:
        child.kill()
        child.wait()
        if child.stderr is not None:
            child.stderr.close()


def wait_until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it never came"
        time.sleep(0.02)


def end(child: subprocess.Popen[bytes], number: signal.Signals) -> str:
    """What the simulation says when it gets a signal; it ends with 1."""
    child.send_signal(number)
    assert child.wait(PATIENCE) == 1
    assert child.stderr is not None
    said = child.stderr.read().decode()
    assert "Traceback" not in said
    return said


def check_whole_lines(text: str) -> int:
    """Rows of numbers, each line whole, at equal distances; their number."""
    assert text.endswith("\n")
    header, *rows = text.splitlines()
    assert header == OPEN
    for line in rows:
        assert len([float(x) for x in line.split(",")]) == len(header.split(","))
    t = [float(line.split(",")[0]) for line in rows]
    assert t == pytest.approx(np.arange(len(t)) * 0.01, rel=1e-9, abs=1e-12)
    return len(t)


ENDING = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.mark.parametrize("number", ENDING)
def test_an_interrupted_run_ends_at_a_whole_line(tmp_path: Path, number: signal.Signals) -> None:
    rows, report = tmp_path / "rows.csv", tmp_path / "report.json"
    run = (*ARM, "--time", 3000, "--every", 0.01, "--report", report)
    with running(*run, stdout=rows, stderr=subprocess.PIPE) as child:
        wait_until(lambda: rows.stat().st_size > 100_000)
        said = end(child, number)
    assert re.search(r"Error: interrupted at t = [\d.]+ s of 3000 s: .*kept", said)
    assert "steps" in said  # the summary
    count = check_whole_lines(rows.read_text())
    facts = json.loads(report.read_text())
    assert facts["outcome"] == "interrupted"
    assert count == math.floor(facts["t_reached"] / 0.01 + 1e-9) + 1


def test_an_interrupted_run_leaves_the_older_file(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    out = folder / "run.csv"
    out.write_text("old\n")
    run = (*ARM, "--time", 3000, "--every", 0.01, "--out", out, "--quiet")
    with running(*run, stdout=tmp_path / "none", stderr=subprocess.PIPE) as child:
        wait_until(lambda: sum(file.stat().st_size for file in folder.iterdir()) > 100_000)
        said = end(child, signal.SIGINT)
    assert out.read_text() == "old\n"
    assert check_whole_lines(kept(Outcome(1, "", said)).read_text()) > 500
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("method", ["DOP853", "Radau", "taylor"])
def test_a_run_within_one_long_step_is_interrupted(tmp_path: Path, method: str) -> None:
    rows = tmp_path / "rows.csv"
    run = (
        "simulate",
        "robots/pendulum.yaml",
        "--q=-90deg",
        "--points",
        20_000_000,
        "--method",
        method,
    )
    with running(*run, stdout=rows, stderr=subprocess.PIPE) as child:
        wait_until(lambda: rows.stat().st_size > 100_000)
        said = end(child, signal.SIGTERM)
    assert "Error: interrupted at t = " in said
    text = rows.read_text()
    assert text.endswith("\n")
    assert len(text.splitlines()) < 10_000_000


def test_a_run_whose_reader_waits_is_ended() -> None:
    read, write = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-m", "robodyn", *map(str, ARM), "--points", "1000000"],
        stdout=write,
        stderr=subprocess.PIPE,
        cwd=ROOT,
    ) as child:
        os.close(write)
        os.read(read, 1)
        time.sleep(0.5)  # until the pipe is full
        child.send_signal(signal.SIGTERM)
        assert child.wait(PATIENCE) in (1, 143)
        assert child.stderr is not None
        assert b"Traceback" not in child.stderr.read()
    os.close(read)


@pytest.mark.parametrize("reached", [0.5, 1.0])
def test_a_run_that_ends_finishes_its_files(
    monkeypatch: pytest.MonkeyPatch, reached: float
) -> None:
    """As long as it works on them (a long table of events); a run that waits is ended.

    The processor's clock is the test's own: on a busy machine a run that works may look idle.
    """
    monkeypatch.setattr(progress, "PATIENCE", 0.05)
    seconds = itertools.count()
    monkeypatch.setattr(time, "process_time", lambda: next(seconds))
    monkeypatch.setattr(progress, "received", [])
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    try:
        with progress.watching(1.0, quiet=True) as watch:
            watch(reached)
            signal.raise_signal(signal.SIGINT)
            assert reached == 1.0 or watch(reached)
            time.sleep(0.25)
            assert next(seconds) > 2, "it was not looked at"
            monkeypatch.setattr(time, "process_time", lambda: 0.0)
            with pytest.raises(KeyboardInterrupt):
                time.sleep(PATIENCE)
            signal.setitimer(signal.ITIMER_REAL, 0.0)  # or it is raised once more
    except KeyboardInterrupt:
        pytest.fail("it was ended while it worked")


def test_what_nohup_ignores_is_ignored(tmp_path: Path) -> None:
    def ignore() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    rows = tmp_path / "rows.csv"
    command = [sys.executable, "-m", "robodyn", *map(str, ARM), "--points", "50000", "-o", rows]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL, cwd=ROOT, preexec_fn=ignore) as child:
        wait_until(lambda: any(file.stat().st_size > 10_000 for file in tmp_path.iterdir()))
        child.send_signal(signal.SIGHUP)
        assert child.wait(PATIENCE) == 0
    assert len(rows.read_text().splitlines()) == 50_001


def test_a_progress_bar_on_a_terminal(tmp_path: Path) -> None:
    leader, follower = pty.openpty()
    rows, shown = tmp_path / "rows.csv", b""
    with running(*ARM, "--time", "1e5", "--points", 2, stdout=rows, stderr=follower) as child:
        os.close(follower)
        while b"simulating" not in shown:  # reading fails when the process ends
            shown += os.read(leader, 65536)
        child.send_signal(signal.SIGINT)
        try:
            while piece := os.read(leader, 65536):
                shown += piece
        except OSError:
            pass  # how Linux tells that the other side of a terminal is closed
        assert child.wait(PATIENCE) == 1
    os.close(leader)
    assert b"interrupted" in shown.rpartition(b"simulating")[2]
    assert len(rows.read_text().splitlines()) == 2  # the header, and the row at 0


# Wrong usage


def test_points_beyond_all_memory_are_refused(shell: Run) -> None:
    line = "robodyn simulate robots/2r.yaml --q 1,2 --time 1 --points 1000000000"
    shell(f"ulimit -v 4000000; {line}").fails(2, "--points", "1000000000")


def test_a_table_for_a_run_backwards(robodyn: Run) -> None:
    options = ("--time", "-1", "--points", 3, "--tau-from", "-", "--quiet")
    table = "t,tau1,tau2\n-1,4,0\n0,2,0\n"
    assert robodyn(*ARM, *options, stdin=table).succeeds().column("tau1") == [2, 3, 4]


def test_a_torque_of_zero_for_passive_joints(robodyn: Run) -> None:
    for tau in ("1,0,0", "t,0,0"):
        robodyn(*CRANK, "--time", 0.1, "--quiet", "--tau", tau).succeeds()


def test_closed_stdin_and_stdout(shell: Run, quick_shell: Run, tmp_path: Path) -> None:
    line = "robodyn simulate robots/2r.yaml --q 1,2 --time 0.1 --quiet"
    shell(f"{line} --tau-from - <&-").fails(2, "stdin", "closed")
    assert shell(f"{line} >&-").code == 1
    shell(f"{line} -o {tmp_path}/x.csv >&-").succeeds()
    assert (tmp_path / "x.csv").read_text() == quick_shell(line).succeeds().out


# Help and imports


def test_help(robodyn: Run) -> None:
    given = robodyn("simulate", "--help").succeeds()
    assert "Examples:" in given.out
    assert "robodyn simulate 2r " in given.out
    options = (
        *("--q", "--qd", "--time", "--every", "--points", "--tau", "--tau-from", "--method"),
        *("--rtol", "--atol", "--stabilize", "--baumgarte-rate", "--assemble", "--max-evals"),
        *("--quiet", "--report", "--out"),
    )
    for option in options:
        assert re.search(rf"^\s+(?:-\w, )?{option}\b", given.out, re.MULTILINE), option
    for method in METHODS:
        assert method in given.out


def test_only_simulate_imports_scipy() -> None:
    program = """
import sys
from robodyn import cli
commands = {
    "torque": ["robots/2r.yaml", "--q", "1,2"],
    "accel": ["robots/four-bar.yaml", "--q", "1"],
    "terms": ["robots/four-bar.yaml", "--q", "1"],
    "energy": ["robots/four-bar.yaml", "--q", "1"],
    "assemble": ["robots/four-bar.yaml", "--q", "1"],
    "check": ["robots/four-bar.yaml"],
    "simulate": ["robots/four-bar.yaml", "--q", "1", "--time", "0.1", "--quiet"],
}
sys.stdout = open("/dev/null", "w")
for name, arguments in commands.items():
    code = cli.run([name, *arguments])
    found = sorted({m.split(".")[0] for m in sys.modules} & {"scipy", "matplotlib", "llvmlite"})
    print(name, code, *found, file=sys.stderr)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, cwd=ROOT
    )
    names = ("torque", "accel", "terms", "energy", "assemble", "check")
    assert done.stderr.splitlines() == [*(f"{name} 0" for name in names), "simulate 0 scipy"]


@pytest.mark.parametrize("line", ["torque robots/2r.yaml --q 1,2", "simulate --help"])
def test_a_process_without_scipy(line: str) -> None:
    """As `python -X importtime` tells it."""
    program = [sys.executable, "-X", "importtime", "-m", "robodyn", *line.split()]
    done = subprocess.run(program, capture_output=True, text=True, timeout=120, cwd=ROOT)
    assert done.returncode == 0
    imported = {part.rpartition("|")[2].strip() for part in done.stderr.splitlines()}
    assert "robodyn.cli" in imported
    assert not [name for name in imported if name.split(".")[0] == "scipy"]


# Large and long


def test_many_rows(robodyn: Run) -> None:
    """Batch after batch, none lost and none twice."""
    given = robodyn("simulate", "robots/pendulum.yaml", "--q", "1", "--points", 50_001, "--quiet")
    lines = given.succeeds().out.splitlines()
    t = np.array([float(line.partition(",")[0]) for line in lines[1:]])
    assert np.array_equal(t, np.linspace(0.0, 10.0, 50_001))


def test_huge_numbers_end_with_an_outcome(robodyn: Run) -> None:
    given = robodyn(*ARM, "--time", "1e300", "--points", 3, "--max-evals", 5000, "--quiet")
    given.fails(1, "without end", "1e+300", "--time")
    assert len(given.rows) == 1
    start = ("simulate", "robots/2r.yaml", "--q", "0,0", "--qd", "1e200,0", "--max-evals", 5000)
    robodyn(*start, "--quiet").fails(1)


@pytest.mark.parametrize("method", ["DOP853", "Radau", "taylor"])
@pytest.mark.parametrize("end", ["1e308", "-9e19", "1e13"])
def test_an_end_that_is_never_reached_is_told_after_the_first_steps(
    robodyn: Run, method: str, end: str
) -> None:
    given = robodyn(*ARM, f"--time={end}", "--method", method, "--points", 3, "--quiet")
    assert "without end" in given.fails(1, f"of {float(end):g} s", "--time").err
    assert len(given.rows) == 1


def test_steps_that_grow_reach_any_end(robodyn: Run, scene: Callable[[str], Path]) -> None:
    """Nothing acts on it: each step is ten times as long as the one before."""
    path = scene("gravity: 0\nlinks: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n")
    options = ["--q", "0", "--qd", "1e-300", "--time", "1e290", "--quiet"]
    given = robodyn("simulate", path, *options).succeeds()
    assert float(given.rows[-1]["q1"]) == pytest.approx(1e-10)
