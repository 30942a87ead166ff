"""`simulate --until, --event, --events` and `sweep --result events`: what they write and refuse."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from conftest import Outcome

from robodyn.sweeps import sweep_plan


def done(outcome: Outcome) -> Outcome:
    assert outcome.code == 0, outcome.err
    return outcome


Run = Callable[..., Outcome]
ARM = ("simulate", "robots/2r.yaml", "--q", "0,0", "--time", 2)
SWEEP = ("sweep", "robots/2r.yaml", "--vary", "q1=-1:1:5", "--time", 1)


@pytest.mark.parametrize("rows", [(), ("--every", 0.1), ("--points", 4)])
def test_until_ends_the_run(robodyn: Run, tmp_path: Path, rows: tuple) -> None:
    report, events = tmp_path / "report.json", tmp_path / "events.csv"
    given = done(robodyn(
        *ARM, *rows, "--until", "q1 < -90deg", "--event", "apex=qd2", "--events", events,
        "--report", report,
    ))  # fmt: skip
    assert float(given.rows[-1]["q1"]) == pytest.approx(-math.pi / 2, abs=1e-13)
    assert "ended by --until q1 < -90deg" in given.err
    facts = json.loads(report.read_text())
    assert facts["ended_by"] == "until"
    assert facts["outcome"] == "ended"
    assert facts["t_reached"] == float(given.rows[-1]["t"])
    assert facts["events"] == {"apex": 1, "until": 1}
    lines = events.read_text().splitlines()
    assert lines[0] == "event,t,q1,q2,qd1,qd2"
    assert [line.split(",")[0] for line in lines[1:]] == ["apex", "until"]
    assert float(lines[-1].split(",")[1]) == facts["t_reached"]
    times = given.column("t")
    assert all(a < b for a, b in pairwise(times))


def test_never_met_says_so(robodyn: Run) -> None:
    given = done(robodyn(*ARM, "--until", "q1 > 1000", "--every", 1))
    assert "not met up to the end: --until q1 > 1000" in given.err
    assert given.column("t") == [0.0, 1.0, 2.0]


def test_the_summary_counts(robodyn: Run) -> None:
    given = done(robodyn(*ARM, "--event", "apex=qd1", "--event", "no=q1 > 9", "--every", 2))
    assert "events: apex 1, no 0" in given.err


def test_a_graze_is_said(robodyn: Run) -> None:
    given = done(robodyn(*ARM, "--event", "touch=(t - 1)**2"))
    assert "touch touches zero at t = 1 s: rounding hides whether it passes" in given.err
    assert "touch 0" in given.err


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("t - 5ms", 0.005),
        ("t > 0.5s", 0.5),
        ("60rpm*t > 180deg", 0.5),
        ("t*20mm/s - 10 mm", 0.5),
        ("t*1rad/s > 0.25", 0.25),
        ("60rpm*t > 90° + π/2", 0.5),
        ("2^-1 * 1.0^2 s < t", 0.5),
        ("min(t, 3 min) > 250 ms", 0.25),
        ("sqrt(4 m^2)*t > 1/2 m*2 s", 0.5),
        ("t >= 1e2ms", 0.1),
    ],
)
def test_units(robodyn: Run, text: str, value: float) -> None:
    given = done(robodyn(*ARM, "--until", text))
    assert given.column("t")[-1] == pytest.approx(value, abs=1e-14)


def test_a_sum_of_a_plain_number_and_a_mass_is_refused(robodyn: Run) -> None:
    """A unit over its like is a plain number; other options and scenes refuse the sum as well."""
    text = "3 m/mm + 4 kg"
    for more in (("--event", f"x={text} - q1"), ("--until", f"{text} > q1")):
        robodyn(*ARM, *more).fails(2, more[0], "a sum of a plain number and kg")
    robodyn(*ARM, "--tau", f"{text},0").fails(2, "--tau", "a sum of a plain number and kg")
    robodyn(*ARM, "--tau", "min(4 kg, 3 m/mm),0").fails(2, "--tau", "kg and a plain number")
    robodyn(*ARM, "--time", text).fails(2, "--time", "a sum of a plain number and kg")


def test_a_run_that_fails_keeps_an_earlier_file_of_events(robodyn: Run, tmp_path: Path) -> None:
    """What it found goes where its rows would go: beside it, under the first free name."""
    events = tmp_path / "events.csv"
    events.write_text("before\n")
    run = (*ARM, "--event", "a=qd1", "--events", events)
    for most, name in ((800, "events.csv.partial"), (20, "events.csv.partial.1")):
        given = robodyn(*run, "--max-evals", most, "--quiet")
        assert given.code == 1
        assert f"the events up to there are in {tmp_path / name}\n" in given.err
        assert events.read_text() == "before\n"
        assert (tmp_path / name).read_text().startswith("event,t,q1,")
    found = (tmp_path / "events.csv.partial").read_text().splitlines()
    assert len(os.listdir(tmp_path)) == 3
    done(robodyn(*run, "--quiet"))
    assert len(found) == 2
    assert events.read_text().startswith("\n".join(found))
    # a run that cannot start has nothing to keep
    robodyn(*run, "--tau", "1/t,0", "--quiet").fails(1, "cannot start")
    assert len(os.listdir(tmp_path)) == 3


@pytest.mark.parametrize("workers", [1, 2])
def test_a_sweep_tells_events(robodyn: Run, workers: int) -> None:
    given = done(robodyn(
        *SWEEP, "--event", "low=q1 < -90deg", "--event", "never=q1 > 50", "--result",
        "final,events", "--workers", workers,
    ))  # fmt: skip
    header = given.out.splitlines()[0].split(",")
    assert header[-5:] == ["low_count", "low_first", "never_count", "never_first", "outcome"]
    for row in given.rows:
        told = done(robodyn(
            "simulate", "robots/2r.yaml", f"--q={row['q1']},0", "--time", 1, "--until",
            "q1 < -90deg", "--method", "taylor",
        ))  # fmt: skip
        assert row["never_first"] == ""
        assert float(row["never_count"]) == 0.0
        if float(row["low_count"]):
            assert float(row["low_first"]) == pytest.approx(told.column("t")[-1], abs=1e-9)
        else:
            assert row["low_first"] == ""
            assert "not met" in told.err


def test_a_sweep_with_events_goes_on(
    robodyn: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sweep_plan.CHUNKS, "DOP853", 10)  # points of a chunk
    out, vary = tmp_path / "out.csv", ("--vary", "q1=0:350deg:14")
    options = ("sweep", "robots/four-bar.yaml", *vary, "--qd", 5, "--time", 0.2)
    options += ("--event", "line=sin(q2)", "--result", "events", "--quiet")
    whole = robodyn(*options).succeeds()
    robodyn(*options, "-o", out).succeeds()
    text = out.read_text()
    assert text == whole.out
    assert any(x for x in whole.column("line_count"))
