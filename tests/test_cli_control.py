"""`robodyn simulate --control`: references from files and pipes, the summary, wrong usage."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, RP_ARM, TWO_LINK, Outcome
from named_case import case

import oracles

Run = Callable[..., Outcome]
ARM = ("simulate", "robots/2r.yaml", "--q", "0.1,0.05")
CRANK = ("simulate", "robots/four-bar.yaml", "--q", "1")
PD = ("--control", "pd", "--kp", "80,20", "--kd", "16,1")
FED_BACK = ("--control", "state-feedback", "--gain")
TORQUE = ("--control", "computed-torque", "--kp", "25", "--kd", "10")
HEADER = "t,q1,q2,qd1,qd2,qdd1,qdd2"
REFERENCE = "\n".join(
    [
        HEADER,
        *(
            f"{t},{math.sin(t)},{math.cos(t)},{math.cos(t)},{-math.sin(t)},"
            f"{-math.sin(t)},{-math.cos(t)}"
            for t in (k / 20 for k in range(31))
        ),
    ]
)


def cut(table: str, *names: str) -> str:
    """Some columns of a table."""
    rows = [line.split(",") for line in table.splitlines()]
    return "\n".join(",".join(row[rows[0].index(name)] for name in names) for row in rows)


@pytest.fixture
def ref(tmp_path: Path) -> Path:
    file = tmp_path / "ref.csv"
    file.write_text(REFERENCE)
    return file


# References


def test_rows_and_their_errors(robodyn: Run, ref: Path) -> None:
    given = robodyn(*ARM, *TORQUE, "--track", ref, "--points", 16, "--quiet").succeeds()
    assert given.out.splitlines()[0] == "t,q1,q2,qd1,qd2,qdd1,qdd2,tau1,tau2,energy,e1,e2"
    t = np.array(given.column("t"))
    assert t[-1] == 1.5  # the reference's end
    for name, at in (("1", np.sin), ("2", np.cos)):
        q, e = (np.array(given.column(x + name)) for x in "qe")
        assert e == pytest.approx(at(t) - q, abs=1e-9)
        # e and ed of edd + 10 ed + 25 e = 0, from the start at rest
        begin, rate = e[0], at(0.0 + np.pi / 2) * (1 if name == "1" else -1)
        known = (begin + (rate + 5.0 * begin) * t) * np.exp(-5.0 * t)
        assert e == pytest.approx(known, abs=1e-7)


def test_a_shorter_time(robodyn: Run, ref: Path) -> None:
    given = robodyn(*ARM, *PD, "--track", ref, "--time", 0.5, "--points", 2, "--quiet").succeeds()
    assert given.column("t") == [0.0, 0.5]


@pytest.mark.parametrize("names", [("q1", "q2"), ("q1", "q2", "qd1", "qd2")])
def test_what_rows_lack_is_interpolated(robodyn: Run, names: tuple[str, ...]) -> None:
    options = (*ARM, *TORQUE, "--track", "-", "--points", 4, "--quiet")
    found, known = (
        robodyn(*options, stdin=text).succeeds()
        for text in (cut(REFERENCE, "t", *names), REFERENCE)
    )
    for name in ("q1", "q2"):
        assert found.column(name) == pytest.approx(known.column(name), abs=1e-5)


def test_columns_in_any_order_and_others_beside(robodyn: Run, ref: Path) -> None:
    lines = cut(REFERENCE, "q2", "t", "qd2", "q1", "qd1").splitlines()
    mixed = "\n".join([f"note,{lines[0]}", *(f"x,{line}" for line in lines[1:])])
    plain = cut(REFERENCE, "t", "q1", "q2", "qd1", "qd2")
    outs = [
        robodyn(*ARM, *PD, "--track", "-", "--points", 3, "--quiet", stdin=text).succeeds().out
        for text in (mixed, plain)
    ]
    assert outs[0] == outs[1]


def test_of_a_closed_mechanism_the_actuated_joints_count(robodyn: Run, ref: Path) -> None:
    gains = ("--control", "pd+g", "--kp", 30, "--kd", 3, "--points", 3, "--quiet")
    part = robodyn(*CRANK, *gains, "--track", "-", stdin=cut(REFERENCE, "t", "q1", "qd1", "qdd1"))
    assert part.succeeds().out.splitlines()[0].endswith("energy,gap,e1")
    assert robodyn(*CRANK, *gains, "--track", ref).succeeds().out == part.out


def test_a_pipe_of_three(quick_shell: Run) -> None:
    """A reference written by awk; the torques that were applied are those that `torque` finds."""
    awk = """awk 'BEGIN {print "t,q1,q2"; for (k = 0; k <= 40; k++)
        printf "%.17g,%.17g,%.17g\\n", k/20, sin(k/20), 0.3*cos(k/10)}'"""
    simulated = f"robodyn {' '.join(PIPED)} --track -"
    line = f"{awk} | {simulated} | tee >(cat >&2) | robodyn torque robots/2r.yaml -"
    given = quick_shell(line)
    assert given.code == 0
    noted, rest = given.err.splitlines(), [x for x in given.err.splitlines() if "Note: " not in x]
    assert len(noted) == len(rest) + 1
    assert_the_same_torques(given, Outcome(0, "\n".join(rest) + "\n", ""))


def test_torques_that_were_applied_are_those_that_torque_finds(robodyn: Run) -> None:
    rows = [(k / 20, math.sin(k / 20), 0.3 * math.cos(k / 10)) for k in range(41)]
    table = "t,q1,q2\n" + "".join(f"{t!r},{a!r},{b!r}\n" for t, a, b in rows)
    for more in ("--tau-max 12", "--control-rate 100", "--control-rate 100 --method taylor"):
        with case(more):
            before = robodyn(*PIPED, *more.split(), "--track", "-", stdin=table).succeeds()
            given = robodyn("torque", "robots/2r.yaml", "-", stdin=before.out).replaces()
            assert_the_same_torques(given, before)


PIPED = ["simulate", "robots/2r.yaml", "--q", "0,0.3", "--control", "pd+g"]
PIPED += ["--kp", "90,20", "--kd", "12,1", "--quiet", "--every", "0.25"]


def assert_the_same_torques(given: Outcome, before: Outcome) -> None:
    assert given.out.splitlines()[0] == before.out.splitlines()[0]
    assert len(given.rows) == 9
    for name in ("tau1", "tau2"):
        assert given.column(name) == pytest.approx(before.column(name), abs=1e-9)


def test_trajectory_makes_references(robodyn: Run) -> None:
    way = ("--from", "0,0", "--to", "90deg,45deg", "--time", 2)
    made = robodyn("trajectory", "robots/2r.yaml", *way).succeeds()
    law = ("--control", "computed-torque", "--kp", 100, "--kd", 20, "--quiet")
    start = ("simulate", "robots/2r.yaml", "--q", "0,0", "--track", "-")
    given = robodyn(*start, *law, stdin=made.out).succeeds()
    numbers = [float(x) for x in given.out.splitlines()[-1].split(",")]
    assert numbers[:3] == pytest.approx([2.0, math.pi / 2, math.pi / 4], abs=1e-8)
    held = robodyn(*start, *law, "--time", 6, "--every", 1, stdin=made.out).succeeds()
    needed = robodyn("torque", "robots/2r.yaml", "--q", "90deg,45deg").row
    for name, end in (("q1", math.pi / 2), ("q2", math.pi / 4), ("qd1", 0.0), ("qd2", 0.0)):
        assert held.column(name)[-4:] == pytest.approx([end] * 4, abs=1e-7)
    for name in ("tau1", "tau2"):
        assert held.column(name)[-4:] == pytest.approx([needed[name]] * 4, abs=1e-5)


def test_held_at_its_end_and_held_throughout(robodyn: Run, ref: Path) -> None:
    options = (*ARM, *PD[:2], "--kp", "80,20", "--kd", "16,1", "--every", "0.5", "--quiet")
    given = robodyn(*options, "--track", ref, "--time", 3).succeeds()
    for name, end in (("1", math.sin(1.5)), ("2", math.cos(1.5))):
        q, e = (np.array(given.column(x + name))[-3:] for x in "qe")
        assert e == pytest.approx(end - q, abs=1e-12)
    still = f"t,q1,q2\n0,{math.radians(30)},-0.2\n1,{math.radians(30)},-0.2\n"
    runs = [
        robodyn(*options, *more, "--time", 4, stdin=still).succeeds().out
        for more in (("--track", "-"), ("--hold", "30deg,-0.2"))
    ]
    assert [float(x) for x in runs[0].splitlines()[-1].split(",")] == pytest.approx(
        [float(x) for x in runs[1].splitlines()[-1].split(",")], abs=1e-6
    )
    assert robodyn(*options, "--hold", "0,0").succeeds().column("t")[-1] == 10.0


# Laws


def test_an_integral_removes_what_pd_leaves(robodyn: Run) -> None:
    options = (*ARM, "--hold", "45deg,0.3", "--kp", "80,20", "--kd", "16,1", "--points", 2)
    left, none = (
        robodyn(*options, "--control", law, *more, "--time", 40, "--quiet")
        for law, *more in (("pd",), ("pid", "--ki", "60,20", "--tau-max", "60,20"))
    )
    for name in ("e1", "e2"):
        assert abs(left.succeeds().column(name)[-1]) > 0.01
        assert abs(none.succeeds().column(name)[-1]) < 1e-6


@pytest.mark.parametrize("more", [(), ("--control-rate", 50, "--method", "taylor")])
def test_state_feedback(robodyn: Run, tmp_path: Path, more: tuple[object, ...]) -> None:
    """The cart-pole comes to its pose, and to another that --at gives."""
    gain = tmp_path / "gain.json"
    facts = {"coordinates": ["q1", "q2"], "q": [0, math.pi / 2], "tau": [0], "other": 1}
    gain.write_text(json.dumps(facts | {"gain": [[-1, 50, -2, 12]]}))
    options = ("simulate", "robots/cart-pole.yaml", "--q", "0.2,440deg", *FED_BACK, gain, *more)
    for at, x in (((), 0.0), (("--at", "1,90deg"), 1.0)):
        given = robodyn(*options, *at, "--points", 3, "--time", 40, "--quiet").succeeds()
        end = {name: float(text) for name, text in given.rows[-1].items()}
        assert [end["q1"], end["q2"]] == pytest.approx([x, 2.5 * math.pi], abs=2e-3)
        assert end["e1"] == pytest.approx(x - end["q1"], abs=1e-12)
        first = {name: float(text) for name, text in given.rows[0].items()}
        wanted = (0.2 - x) + 50 * math.radians(10)
        assert first["tau1"] == pytest.approx(wanted, abs=1e-9)


def test_a_gain_is_a_regular_file_of_bounded_size(quick_shell: Run, tmp_path: Path) -> None:
    """Also from stdin, which may be a pipe, no more than 16 MiB are read."""
    gain, pipe, long = (tmp_path / name for name in ("gain.json", "pipe.json", "long.json"))
    facts = {"coordinates": ["q1", "q2"], "q": [0, 1.5], "tau": [0]}
    gain.write_text(json.dumps(facts | {"gain": [[-1, 50, -2, 12]]}))
    os.mkfifo(pipe)
    long.touch()
    os.truncate(long, 2**24 + 1)
    run = "robodyn simulate robots/cart-pole.yaml --q 0.2,80deg --time 0.1 --quiet "
    run += " ".join(FED_BACK)
    for name in (pipe, "/dev/zero"):
        quick_shell(f"timeout 60 {run} {name}").fails(2, f"{name}: cannot be read", "regular file")
    quick_shell(f"{run} {long}").fails(2, f"{long}: cannot be read: is larger than 16 MiB")
    quick_shell(f"{run} - </dev/zero").fails(2, "stdin: cannot be read: is larger than 16 MiB")
    assert quick_shell(f"cat {gain} | {run} -").out == quick_shell(f"{run} {gain}").out != ""


def test_another_pose_in_place_of_one_that_does_not_close(robodyn: Run, tmp_path: Path) -> None:
    gain = tmp_path / "gain.json"
    facts = {"coordinates": ["q1"], "q": [1, 1, 1], "tau": [0], "gain": [[9, 1]]}
    gain.write_text(json.dumps(facts))
    options = ("--at", "80deg", "--points", 2, "--time", 9, "--quiet")
    given = robodyn(*CRANK, *FED_BACK, gain, *options)  # by the torque that holds it there
    needed = robodyn("torque", "robots/four-bar.yaml", "--q", "80deg").row["tau1"]
    assert given.err == f"Note: at --at it is held by tau1 = {needed:.9g}\n"
    assert given.column("q1")[-1] == pytest.approx(math.radians(80), abs=1e-6)


def test_torques_are_those_of_the_law(robodyn: Run, ref: Path) -> None:
    options = ("--control", "pd+g", "--kp", "80,20", "--kd", "16", "--points", 5, "--quiet")
    given = robodyn(*ARM, *options, "--track", ref).succeeds()
    for row in given.rows:
        x = {name: float(text) for name, text in row.items()}
        t, q = x["t"], np.array([x["q1"], x["q2"]])
        ed = [math.cos(t) - x["qd1"], -math.sin(t) - x["qd2"]]
        _, _, G = oracles.two_link_terms(TWO_LINK, q, q)
        wanted = np.array([80.0, 20.0]) * [x["e1"], x["e2"]] + 16.0 * np.array(ed) + G
        assert [x["tau1"], x["tau2"]] == pytest.approx(wanted, abs=1e-5)


def test_sampled_torques_are_held(robodyn: Run, ref: Path) -> None:
    options = ("--track", ref, "--control-rate", "20Hz", "--every", 0.005, "--quiet")
    given = robodyn(*ARM, *PD, *options).succeeds()
    tau = np.array(given.column("tau1"))
    assert len(tau) == 301
    assert len(np.unique(tau)) == 31
    assert np.flatnonzero(np.diff(tau)).tolist() == list(range(9, 300, 10))
    assert robodyn(*ARM, *PD, *options, "--method", "taylor").succeeds()


def test_another_model(robodyn: Run, ref: Path, tmp_path: Path) -> None:
    text = (ROOT / "robots/2r.yaml").read_text()
    heavier, same = tmp_path / "heavier.yaml", tmp_path / "same.yaml"
    heavier.write_text(text.replace("m: 0.9", "m: 1.08"))
    same.write_text(text)
    options = (*ARM, *TORQUE, "--track", ref, "--points", 2, "--quiet")
    runs = [
        robodyn(*options, *more).succeeds()
        for more in ((), ("--control-model", same), ("--control-model", heavier))
    ]
    assert runs[0].out == runs[1].out
    assert abs(float(runs[0].rows[-1]["e2"])) < 0.005
    assert abs(float(runs[2].rows[-1]["e2"])) > 0.02


def test_limits(robodyn: Run, ref: Path) -> None:
    given = robodyn(*ARM, *PD, "--track", ref, "--tau-max", "10,3", "--quiet").succeeds()
    for name, most in (("tau1", 10.0), ("tau2", 3.0)):
        assert np.abs(given.column(name)).max() == most


# The summary


def test_the_summary_and_the_report(robodyn: Run, ref: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    given = robodyn(*ARM, *TORQUE, "--track", ref, "--report", report, "--every", 0.001)
    assert given.code == 0
    facts = json.loads(report.read_text())
    assert [set(joint) for joint in facts["tracking"]] == 2 * [
        {"joint", "rms", "largest", "at", "largest_torque"}
    ]
    assert facts["energy_drift"] < 1e-8
    for k, joint in enumerate(facts["tracking"], 1):
        e = np.array(given.column(f"e{k}"))
        t = np.array(given.column("t"))
        assert joint["joint"] == ("upper arm", "forearm")[k - 1]
        assert joint["rms"] == pytest.approx(np.sqrt(np.trapezoid(e**2, t) / 1.5), rel=1e-4)
        assert joint["largest"] == pytest.approx(np.abs(e).max(), rel=1e-5)
        assert joint["at"] == pytest.approx(t[np.abs(e).argmax()], abs=2e-3)
        largest = np.abs(given.column(f"tau{k}")).max()
        assert joint["largest_torque"] == pytest.approx(largest, rel=0.02)
        said = f"{joint['joint']} {joint['rms']:.3g} rad rms, {joint['largest']:.3g} rad at most"
        assert said in given.err
    assert "largest torque: upper arm " in given.err


def test_tracking_of_a_joint_that_slides_is_told_in_metres(
    robodyn: Run, scene: Callable[[str], Path], tmp_path: Path
) -> None:
    path, ref = scene(RP_ARM), tmp_path / "ref.csv"
    ref.write_text("t,q1,q2\n0,0,0\n1,0.3,0.2\n")
    options = ("--q", "0,0", "--track", ref, "--control", "pd", "--kp", 50, "--kd", 10)
    given = robodyn("simulate", path, *options, "--time", 0.2)
    assert given.code == 0
    assert re.search(r"tracking error: arm \S+ rad rms, \S+ rad at most, at t = ", given.err)
    assert re.search(r"; boom \S+ m rms, \S+ m at most, at t = ", given.err)
    assert re.search(r"largest torque: arm \S+ N m, boom \S+ N\n", given.err)


def test_of_a_run_without_control_there_is_no_tracking(robodyn: Run, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    given = robodyn(*ARM, "--time", 0.1, "--report", report)
    assert "tracking" not in given.err
    assert json.loads(report.read_text())["tracking"] is None


def test_a_run_that_does_not_finish(robodyn: Run, ref: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    options = ("--track", ref, "--max-evals", 50, "--report", report, "--quiet")
    robodyn(*ARM, *PD, *options).fails(1, "too many evaluations")
    assert len(json.loads(report.read_text())["tracking"]) == 2


def test_an_accuracy(robodyn: Run, ref: Path) -> None:
    options = ("--track", ref, "--accuracy", 1e-7, "--points", 2)
    given = robodyn(*ARM, *PD, *options)
    assert given.code == 0
    assert "DOP853" in given.err
    assert "taylor" in robodyn(*ARM, *PD, *options, "--control-rate", 50).err


# Backwards


def test_a_reference_may_run_backwards(robodyn: Run) -> None:
    table = "t,q1,q2\n-1,0,0\n0,1,1\n"
    options = ("--track", "-", "--time", "-0.02", "--quiet")
    robodyn(*ARM, *PD, *options, stdin=table).succeeds()


def test_help(robodyn: Run) -> None:
    given = robodyn("simulate", "--help").succeeds()
    options = "control track hold kp kd ki gain at tau-max control-rate control-model"
    for option in options.split():
        assert re.search(rf"^\s+--{option}\b", given.out, re.MULTILINE), option
    assert "--control computed-torque" in given.out
