"""`robodyn fit` from the shell: what it reads, what it writes, and what it refuses."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Outcome

import robodyn as package

Run = Callable[..., Outcome]
FOUR_BAR = str(ROOT / "robots/four-bar.yaml")
PENDULUM = str(ROOT / "robots/pendulum.yaml")
VARY = ["--vary", "links.coupler.l=0.8:1.2", "--vary", "links.rocker.l=0.6:1"]


@pytest.fixture
def path(tmp_path: Path) -> str:
    """A path of the coupler's point, by the crank's angle, of another four-bar."""
    text = Path(FOUR_BAR).read_text().replace("l: 0.95", "l: 0.9").replace("l: 0.80", "l: 0.75")
    other = tmp_path / "other.yaml"
    other.write_text(text)
    mech = package.load(other)
    q = package.assemble(mech, np.linspace(0.0, 6.0, 13)[:, None])
    P = package.points(mech, q, of="coupler@0.3,0.2").position[:, 0]
    file = tmp_path / "path.csv"
    rows = np.column_stack([q[:, 0], P]).tolist()
    file.write_text("q1,P_x,P_y\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows))
    return str(file)


def test_a_path_as_json_and_as_a_scene(robodyn: Run, path: str, tmp_path: Path) -> None:
    out = tmp_path / "best.yaml"
    done = robodyn(
        "fit", FOUR_BAR, "--match", path, "--of", "P=coupler@0.3,0.2", *VARY, "-o", str(out)
    )
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert found["numbers"] == pytest.approx({"links.coupler.l": 0.9, "links.rocker.l": 0.75})
    assert max(found["rms"].values()) < 1e-12
    assert found["before"] == {"links.coupler.l": 0.95, "links.rocker.l": 0.8}
    assert found["starts"] == 30
    assert 1 <= found["reached"] <= 30
    written, before = out.read_text(), Path(FOUR_BAR).read_text()
    changed = [
        (x, y) for x, y in zip(before.splitlines(), written.splitlines(), strict=True) if x != y
    ]
    assert len(changed) == 2
    assert changed[1][1].endswith("# ground pivot")
    assert package.load(out).description.links[1].l == found["numbers"]["links.coupler.l"]


def test_a_table_for_people(robodyn: Run, path: str) -> None:
    vary = ["--vary", "links.coupler.l=0.92:1.2", "--vary", "links.rocker.l=0.6:1"]
    done = robodyn(
        *("fit", FOUR_BAR, "--match", path, "--of", "P=coupler@0.3,0.2", *vary),
        *("--format", "table", "--subject-to", "links.rocker.l <= 0.99"),
    )
    assert "of 30 starts reached it" in done.out
    assert "links.rocker.l <= 0.99" in done.out
    row = next(x for x in done.out.splitlines() if "links.coupler.l" in x)
    assert row.split() == ["links.coupler.l", "0.95", "0.92", "0.92", "1.2", "low"]


def test_residuals_of_every_row(robodyn: Run, path: str) -> None:
    done = robodyn(
        *("fit", FOUR_BAR, "--match", path, "--of", "P=coupler@0.3,0.2", "--residuals"),
        *("--columns", "P_x", "--vary", "links.coupler.l=0.8:1.2"),
    )
    rows = list(csv.DictReader(io.StringIO(done.out)))
    assert list(rows[0]) == ["q1", "P_x", "P_x_residual"]
    wanted = [float(x["P_x"]) for x in csv.DictReader(io.StringIO(Path(path).read_text()))]
    for row, target in zip(rows, wanted, strict=True):
        assert float(row["P_x"]) - float(row["P_x_residual"]) == pytest.approx(target, abs=1e-15)


def test_states_from_stdin_and_from_options(robodyn: Run) -> None:
    text = "q1,q2,q3\n" + "".join(f"{x},0,0\n" for x in (0.5, 1.5, 2.5))
    counter = ["--set", "links.crank.r=[0.15,0]", "--vary", "links.crank.r[0]=-1:1"]
    done = robodyn("fit", FOUR_BAR, "-", *counter, "--minimize", "tau1", stdin=text)
    assert done.code == 0, done.err
    assert set(json.loads(done.out)["rms"]) == {"tau1"}
    done = robodyn("fit", FOUR_BAR, *counter, "--minimize", "tau1", "--q", "30deg")
    assert json.loads(done.out)["rms"]["tau1"] < 1e-12


def test_a_scene_that_set_and_fit_change(robodyn: Run, tmp_path: Path) -> None:
    out = tmp_path / "best.yaml"
    done = robodyn(
        *("fit", FOUR_BAR, "--set", "links.crank.r=[0.15,0]", "--set", "gravity=1.6"),
        *("--vary", "links.crank.r[0]=-1:1", "--minimize", "tau1", "--q", "30deg", "-o", str(out)),
    )
    made, value = package.load(out), json.loads(done.out)["numbers"]["links.crank.r[0]"]
    assert made.description.links[0].r == complex(value, 0.0)
    assert made.description.gravity == -1.6j


def test_a_motion(robodyn: Run) -> None:
    rows = robodyn("simulate", PENDULUM, "--q", "0.7", "--time", "1", "--points", "9", "--quiet")
    done = robodyn(
        *("fit", PENDULUM, "--simulate", "--match", "-", "--columns", "q1,qd1", "--starts", "2"),
        *("--vary", "links.rod.I=0.001:0.5"),
        stdin=rows.out,
    )
    assert json.loads(done.out)["numbers"]["links.rod.I"] == pytest.approx(0.0088, rel=1e-6)
    assert json.loads(done.out)["starts"] == 2


def test_a_motion_that_goes_least_far(robodyn: Run) -> None:
    """A rod that begins with a push goes least far with the largest damping."""
    rows = "t,q1,qd1\n" + "".join(f"{k / 20},0,1\n" for k in range(9))
    line = ("fit", PENDULUM, "-", "--simulate", "--minimize", "q1", "--starts", "2")
    done = robodyn(*line, "--set", "gravity=0", "--vary", "links.rod.damping=0:0.1", stdin=rows)
    told = json.loads(done.out)
    assert told["at_bounds"] == {"links.rod.damping": "high"}
    assert told["rms"]["q1"] < told["rms_before"]["q1"]


def test_a_motion_of_a_free_joint(robodyn: Run) -> None:
    """Its start is in the table, or in options, and may be varied; torques may be expressions."""
    run = ("--tau", "sin(3*t)", "--time", "1", "--points", "9", "--quiet")
    rows = robodyn("simulate", "cart-pole", "--q", "0.1,70deg", *run).out
    given = ("fit", "cart-pole", "--simulate", "--match", "-", "--tau", "sin(3*t)", "--starts", "1")
    vary = ("--columns", "q1,q2", "--vary", "links.pole.m=0.05:0.3")
    for more in (), ("--q", "0.1,1.3", "--qd", "0,0", "--vary", "q2=1.2:1.3"):
        told = json.loads(robodyn(*given, *vary, *more, stdin=rows).out)["numbers"]
        assert told.pop("links.pole.m") == pytest.approx(0.1, rel=1e-6)
        assert list(told.values()) == pytest.approx([math.radians(70)][: len(more)], rel=1e-6)
    more = ("--subject-to", "q2 >= 20deg")
    wrong = robodyn(*given, *vary, *more, stdin=rows.replace("q2", "p2"))
    assert (wrong.code, "column q2 is missing" in wrong.err) == (2, True)


def test_rates_that_are_missing(robodyn: Run) -> None:
    """Are zero, with a warning where times run on and a column feels them."""
    told = "Warning: stdin: t runs on, but no qd and qdd given: taken as zero\n"
    table = "t,q1,tau1,rod_x\n0,0,1,0.3\n1,0.1,1,0.3\n"
    for columns, more, warned in (
        ("tau1", (), True),
        ("rod_x", (), False),
        ("tau1", ("--qd", "0"), False),
    ):
        line = ("fit", PENDULUM, "--match", "-", "--columns", columns, "--vary", "links.rod.r=0:1")
        line = (*line, "--vary", "links.rod.l=0.1:1") if columns == "rod_x" else line
        assert (told in robodyn(*line, *more, stdin=table).err) == warned


def test_energies_are_fitted_if_they_are_named(robodyn, tmp_path) -> None:
    """A link's mass and its centre, of the energies alone; --match by itself skips them."""
    run = tmp_path / "run.csv"
    given = ("--q", "0,0.5", "--tau", "2*sin(3*t),1", "--time", "1", "--points", "21", "--quiet")
    states = robodyn("simulate", "2r", *given).succeeds().out
    rows = robodyn("energy", "2r", "-", "--columns", "q,qd,KE,PE", stdin=states).succeeds().out
    run.write_text(rows)
    vary = ("--vary", "links.forearm.m=0.5:1.5", "--vary", "links.forearm.r=0.1:0.4")
    fit = ("fit", "2r", "--set", "links.forearm.m=1.2", "--match", str(run), *vary, "--quiet")
    found = robodyn(*fit, "--columns", "KE,PE").json
    assert found["numbers"]["links.forearm.m"] == pytest.approx(0.9, rel=1e-6)
    assert found["numbers"]["links.forearm.r"] == pytest.approx(0.25, rel=1e-6)
    refused = robodyn(*fit)
    assert refused.code == 2
    assert "has no column that can be fitted besides" in refused.err
