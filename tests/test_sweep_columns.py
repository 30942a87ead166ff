"""Sweeps of columns along references and under control, and what varies normally.

The oracles: the textbook's torques of the 2R, the commands themselves, scipy's distributions.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import TWO_LINK, Outcome
from scipy import stats
from scipy.integrate import trapezoid

import oracles
from robodyn import load, simulate
from robodyn.sweeps import sweep_plan
from robodyn.sweeps.sweep_chunks import run_chunk
from robodyn.sweeps.sweep_plan import Axis, Plan, Variation, spaced, stepped
from robodyn.sweeps.sweep_workers import results

Run = Callable[..., Outcome]
ARM, BAR = "robots/2r.yaml", "robots/four-bar.yaml"
NORMAL = ("--vary", "links.forearm.m=normal(0.9,0.05)")
PD = ("--control", "pd", "--kp", "200,100", "--kd", "30,10")


def mean(x: np.ndarray) -> float:
    """Of rows that are even in time, over time: of a closed turn the first pose counts once."""
    return trapezoid(x) / (len(x) - 1)


TAKEN = {
    "min": np.min, "max": np.max, "mean": mean, "rms": lambda x: np.sqrt(mean(x**2)),
    "range": np.ptp, "first": lambda x: x[0], "last": lambda x: x[-1],
}  # fmt: skip


@pytest.fixture
def reference(robodyn: Run, tmp_path: Path) -> Path:
    """A motion of the 2R."""
    path = tmp_path / "ref.csv"
    line = ("trajectory", ARM, "--from", "0,0", "--to", "90deg,45deg", "--time", 1, "--points", 41)
    robodyn(*line, "-o", path).succeeds()
    return path


@pytest.fixture
def turn(robodyn: Run, tmp_path: Path) -> Path:
    """A turn of the four-bar's crank."""
    path = tmp_path / "turn.csv"
    line = ("trajectory", BAR, "--speed", "60rpm", "--turns", 1, "--points", 25)
    robodyn(*line, "-o", path).succeeds()
    return path


def columns(text: str) -> dict[str, np.ndarray]:
    """The columns of a CSV of numbers."""
    header, *lines = text.splitlines()
    values = np.array([[float(x) for x in line.split(",")] for line in lines])
    return dict(zip(header.split(","), values.T, strict=True))


def test_torques_along_a_reference_are_the_textbooks(robodyn: Run, reference: Path) -> None:
    names = [f"{how}(tau{k})" for how in TAKEN for k in (1, 2)]
    given = robodyn(
        "sweep", ARM, "--kind", "torque", "--track", reference, *NORMAL, "--vary",
        "links.upper arm.l=0.7:0.9", "--sample", 5, "--result", ",".join(names), "--quiet",
    ).succeeds()  # fmt: skip
    t = columns(reference.read_text())
    for row in given.rows:
        arm = TWO_LINK._replace(
            m2=float(row["links.forearm.m"]), l1=float(row["links.upper arm.l"])
        )
        rows = zip(*(t[f"{x}{k}"] for x in ("q", "qd", "qdd") for k in (1, 2)), strict=True)
        tau = np.array([oracles.two_link_torque(arm, x[:2], x[2:4], x[4:]) for x in rows])
        for name in names:
            how, k = name.rstrip(")").split("(tau")
            assert float(row[name]) == pytest.approx(TAKEN[how](tau[:, int(k) - 1]), rel=1e-11)


def test_a_reference_without_rates_is_a_spline(robodyn: Run, tmp_path: Path) -> None:
    """Cubic in time: a spline of the angles alone is exact."""
    path, t = tmp_path / "ref.csv", np.linspace(0.0, 1.0, 11)
    q, qd, qdd = t**3 - t, 3 * t**2 - 1, 6 * t
    path.write_text(
        "t,q1,q2\n" + "".join(f"{a:.17g},{b:.17g},{-b:.17g}\n" for a, b in zip(t, q, strict=True))
    )
    given = robodyn(
        "sweep", ARM, "--kind", "torque", "--track", path, "--vary", "gravity=9.81", "--quiet",
        "--result", "max(tau1),last(qdd2)",
    ).succeeds()  # fmt: skip
    tau = [
        oracles.two_link_torque(TWO_LINK, (a, -a), (b, -b), (c, -c))[0]
        for a, b, c in zip(q, qd, qdd, strict=True)
    ]
    assert given.column("max(tau1)") == pytest.approx([max(tau)], rel=1e-9)
    assert given.column("last(qdd2)") == pytest.approx([-6.0], rel=1e-9)


def test_columns_of_loops_are_those_of_the_commands(robodyn: Run, turn: Path) -> None:
    names = ["rms(shake_fx)", "max(rx2)", "min(fy1)", "mean(P_vx)", "last(tip2_y)", "max(energy)"]
    names += ["max(transmission1)", "min(w3)", "rms(power1)"]
    given = robodyn(
        "sweep", BAR, "--kind", "torque", "--track", turn, "--vary", "links.coupler.m=1.2,1.4",
        "--vary", "links.rocker.l=0.79,0.81", "--of", "P=coupler@0.5,0.2", "--of", "tip2",
        "--result", ",".join(names), "--quiet",
    ).succeeds()  # fmt: skip
    driven = columns(turn.read_text())
    rows = np.stack([driven[x] for x in ("q1", "qd1", "qdd1")], axis=-1).tolist()
    states = "q1,qd1,qdd1\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)
    path = turn.with_name("states.csv")
    path.write_text(states)
    for row in given.rows:
        numbers = [("--set", f"{x}={row[x]}") for x in ("links.coupler.m", "links.rocker.l")]
        found = {}
        for line in (
            ("reactions",), ("energy",), ("torque", "--columns", "t,tau,power"),
            ("points", "--of", "P=coupler@0.5,0.2", "--of", "tip2"),
            ("points", "--columns", "links,transmission"),
        ):  # fmt: skip
            out = robodyn(line[0], BAR, path, *line[1:], *sum(numbers, ())).succeeds().out
            found |= columns(out)
        for name in names:
            how, column = name.rstrip(")").split("(")
            assert float(row[name]) == pytest.approx(TAKEN[how](found[column]), rel=1e-9)


def test_ratios_and_jacobians_are_columns(robodyn: Run, turn: Path) -> None:
    names = ["rocker/crank", "P_Jx1", "P_Jy1", "w3"]
    of = ["--of", "P=coupler@0.3,0.1"]
    result = ",".join(f"max({name})" for name in names)
    given = ["--kind", "torque", "--track", turn, *of, "--result", result, "--quiet"]
    swept = robodyn("sweep", BAR, *given, "--vary", "links.rocker.m=1,2").out.splitlines()
    more = ["--columns", "rocker/crank,jacobian,links"]
    rows = columns(robodyn("points", BAR, turn, *of, *more).out)
    for line in swept[1:]:
        assert line.endswith(",finished")
        found = [float(x) for x in line.split(",")[1:-1]]
        assert found == pytest.approx([rows[name].max() for name in names], rel=1e-12)


def test_under_control_rows_are_those_of_simulate(robodyn: Run, reference: Path) -> None:
    """The controller believes the scene as it is, while the arm varies."""
    law = ("--control", "computed-torque", "--kp", "50", "--kd", "12", "--track", reference)
    names = ["max(tau1)", "rms(e1)", "last(e2)", "mean(energy)", "min(qdd2)", "final"]
    given = robodyn(
        "sweep", ARM, "--set", "links.upper arm.m=1.4", *law, "--vary", "links.forearm.m=0.9,1.3",
        "--result", ",".join(names), "--points", 33, "--time", 1.5, "--quiet",
    ).succeeds()  # fmt: skip
    for row in given.rows:
        believed = reference.with_name("believed.yaml")
        text = Path(ARM).read_text()
        assert "m: 1.5" in text
        believed.write_text(text.replace("m: 1.5", "m: 1.4"))
        out = robodyn(
            "simulate", believed, "--set", f"links.forearm.m={row['links.forearm.m']}", *law,
            "--q", "0,0", "--control-model", believed, "--points", 33, "--time", 1.5, "--quiet",
        ).succeeds().out  # fmt: skip
        found = columns(out)
        for name in names[:-1]:
            how, column = name.rstrip(")").split("(")
            assert float(row[name]) == pytest.approx(TAKEN[how](found[column]), rel=1e-9)
        assert float(row["q1_end"]) == pytest.approx(found["q1"][-1], rel=1e-9)
    errors = given.column("rms(e1)")
    assert errors[1] > 10 * errors[0]


@pytest.mark.parametrize("law", [("--control", "pid", "--ki", "30"), ("--control", "pd+g")])
def test_controllers_hold_a_set_point(robodyn: Run, law: tuple[str, ...]) -> None:
    """What pd+g holds wrongly, by what it does not know of the arm, a pid takes away in time."""
    given = robodyn(
        "sweep", ARM, *law, "--kp", "80", "--kd", "16", "--hold", "0.5,0.3", "--q", "0.5,0.3",
        "--vary", "links.forearm.m=1.2", "--time", 40, "--quiet",
        "--result", "last(e1),last(e2),last(qd1)",
    ).succeeds()  # fmt: skip
    (error,) = given.column("last(e1)")
    # 0.3 kg more than is known, at rest where the arm then is: kp e holds their weight
    x = 0.8 * np.cos(0.5 - error) + 0.25 * np.cos(0.8 - error - given.column("last(e2)")[0])
    load = 0.3 * 9.81 * x / 80
    assert error == pytest.approx(0.0 if "pid" in law else load, abs=1e-7)
    assert abs(given.column("last(qd1)")[0]) < 1e-4


def test_families_stand_for_the_columns_of_a_sweep(robodyn: Run) -> None:
    grid = ("sweep", "2r", "--vary", "q1=0:1:2", "--quiet")
    torque = (*grid, "--kind", "torque", "--columns")
    assert robodyn(*torque, "tau,q").succeeds().out.startswith("tau1,tau2,q1\n")
    motion = (*grid, "--time", "0.1", "--columns")
    names = "t_end,q1_end,q2_end,qd1_end,qd2_end,q1_min,q1_max"
    assert robodyn(*motion, "final,q1_min,q1_max").succeeds().out.startswith(f"{names}\n")
    refused = robodyn(*torque, "pins")
    assert (refused.code, "--columns = pins: is no column here" in refused.err) == (2, True)


def test_one_state_has_columns_themselves(robodyn: Run) -> None:
    given = robodyn(
        "sweep", ARM, "--kind", "torque", "--vary", "q1=0,1", "--q", "0,0.5", "--qd", "1,2",
        "--result", "tau2,shake_m,tip2_vx", "--quiet",
    ).succeeds()  # fmt: skip
    assert given.out.splitlines()[0] == "q1,tau2,shake_m,tip2_vx,outcome"
    for row in given.rows:
        q = (float(row["q1"]), 0.5)
        tau = oracles.two_link_torque(TWO_LINK, q, (1, 2), (0, 0))
        assert float(row["tau2"]) == pytest.approx(tau[1], rel=1e-12)
        assert float(row["shake_m"]) == pytest.approx(-tau[0], rel=1e-12)  # the ground joint's
        assert float(row["tip2_vx"]) == pytest.approx(
            -0.8 * np.sin(q[0]) - 3 * 0.6 * np.sin(sum(q)), rel=1e-12
        )


def test_rows_of_free_motions(robodyn: Run) -> None:
    line = ("sweep", "robots/pendulum.yaml", "--vary", "q1=-1.2,-2", "--time", 2, "--quiet")
    given = robodyn(*line, "--result", "max(q1),min(q1),final,extremes", "--points", 2001)
    rows = given.succeeds().rows
    for row in rows:
        assert float(row["max(q1)"]) == pytest.approx(float(row["q1_max"]), abs=1e-5)
        assert float(row["min(q1)"]) == pytest.approx(float(row["q1_min"]), abs=1e-5)


# What varies normally


def test_a_normal_sample_is_scipys_quantile() -> None:
    axes = (Axis("m", low=0.9, deviation=0.01), Axis("l", low=1.0, high=2.0))
    points = Variation(axes, 4000, 5).points(0, 4000)
    u = np.random.Generator(np.random.PCG64(5)).random((4000, 2))
    assert points[:, 0] == pytest.approx(stats.norm.ppf(u[:, 0], 0.9, 0.01), rel=1e-14)
    assert stats.kstest(points[:, 0], stats.norm(0.9, 0.01).cdf).pvalue > 0.01
    assert np.array_equal(Variation(axes, 4000, 5).points(700, 711), points[700:711])
    assert axes[0].drawn(np.array([0.0]))[0] == pytest.approx(0.9 - 0.01 * 8.2, abs=0.001)


def test_what_is_drawn_out_of_limits_is_a_row(robodyn: Run) -> None:
    line = ("sweep", ARM, "--kind", "torque", "--vary", "links.forearm.m=normal(0.1,0.1)")
    given = robodyn(*line, "--sample", 100, "--result", "tau2", "--quiet").succeeds()
    for row in given.rows:
        refused = float(row["links.forearm.m"]) < 0
        assert row["outcome"] == ("not a scene" if refused else "finished")
        assert (row["tau2"] == "") == refused
    assert {row["outcome"] for row in given.rows} == {"not a scene", "finished"}


# No digit depends on how it is computed


def _whole(plan: Plan, workers: int) -> tuple[np.ndarray, list[str]]:
    parts = list(results(plan, workers=workers))
    return np.concatenate([x.values for x in parts]), [y for x in parts for y in x.outcomes]


@pytest.mark.parametrize("kind", ["torque", "motion"])
def test_digits_depend_on_no_worker_and_no_chunk(
    robodyn: Run, reference: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plans: list[Plan] = []

    def keep(plan: Plan, *_: object) -> object:
        plans.append(plan)
        return iter([])

    acts = () if kind == "torque" else (*PD, "--points", 9)
    with monkeypatch.context() as patch:
        patch.setattr("robodyn.cli.sweep.results", lambda *args: _empty(keep, *args))
        robodyn(
            "sweep", ARM, "--kind", kind, *acts, "--track", reference, *NORMAL, "--sample", 7,
            "--seed", 3, "--result", "max(tau1),rms(shake_fy)", "--quiet",
        ).succeeds()  # fmt: skip
    (plan,) = plans
    known, outcomes = _whole(plan, 1)
    assert outcomes == ["finished"] * 7
    assert len({*known[:, 1].tolist()}) == 7
    small = dataclasses.replace(plan, chunk=2)
    for found, _ in (_whole(small, 1), _whole(small, 2)):
        assert np.array_equal(found, known)
    assert np.array_equal(run_chunk(small, 2).values, known[4:6])


def _empty(keep: Callable[..., object], *args: object):
    keep(*args)
    yield from ()


def test_a_sweep_that_was_cut_off_goes_on(
    robodyn: Run, reference: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sweep_plan.CHUNKS, "DOP853", 5)  # points of a chunk
    out = reference.with_name("rows.csv")
    line = ("sweep", ARM, *PD, "--track", reference, *NORMAL, "--sample", 7, "--points", 3)
    line += ("--result", "max(tau1)", "--rtol", 1e-3, "--atol", 1e-3, "--workers", 1, "--quiet")
    whole = robodyn(*line).succeeds().out
    calls = []

    def limited(plan: Plan, number: int) -> object:
        if number == 1 and not calls:
            calls.append(number)
            raise KeyboardInterrupt
        return run_chunk(plan, number)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robodyn.sweeps.sweep_workers.run_chunk", limited)
        assert robodyn(*line, "-o", out).code == 130
    other = tuple("201,100" if x == "200,100" else x for x in line)
    robodyn(*other, "-o", out).fails(2, "rows.csv.partial", "control")
    robodyn(*line, "-o", out).succeeds()
    assert out.read_text() == whole


# What matters most


def test_correlations_are_scipys(robodyn: Run, turn: Path) -> None:
    line = (
        "sweep", BAR, "--kind", "torque", "--track", turn, "--vary",
        "links.coupler.m=normal(1.3,0.02)", "--vary", "links.rocker.l=uniform(0.79,0.81)",
        "--vary", "links.crank.m=0.5,0.6", "--sample", 40, "--quiet",
        "--result", "max(tau1),rms(shake_fx),last(tip2_y)",
    )  # fmt: skip
    rows = robodyn(*line).succeeds()
    varied = ["links.coupler.m", "links.rocker.l", "links.crank.m"]
    told = robodyn("summary", "-", "--correlations", ",".join(varied), stdin=rows.out).succeeds()
    assert told.out.splitlines()[0] == ",".join(["column", *varied])
    for row in told.rows:
        for name in varied:
            known = stats.spearmanr(rows.column(name), rows.column(row["column"])).statistic
            assert float(row[name]) == pytest.approx(known, abs=1e-12)
    assert float(told.rows[2]["links.rocker.l"]) == pytest.approx(1.0, abs=1e-12)


def test_a_sample_tells_what_matters_most_beside_its_rows(
    robodyn: Run, turn: Path, tmp_path: Path
) -> None:
    vary = ["--vary", "links.coupler.m=1.2:1.4", "--vary", "links.crank.I=0.008:0.0081"]
    given = ["--kind", "torque", "--track", turn, *vary, "--sample", 20, "--result", "max(tau1)"]
    done = robodyn("sweep", BAR, *given, "-o", tmp_path / "rows.csv")
    rows = robodyn("sweep", BAR, *given, "--quiet").out
    names = "links.coupler.m,links.crank.I"
    table = robodyn("summary", "-", "--correlations", names, stdin=rows).out.splitlines()[1]
    first, second = (float(x) for x in table.split(",")[1:])
    told = f"max(tau1) goes with links.coupler.m {first:.2f}, links.crank.I {second:.2f} (rank"
    assert told in done.err
    assert len((tmp_path / "rows.csv").read_text().splitlines()) == 21
    assert "goes with" not in robodyn("sweep", BAR, *given, "--quiet").err


def test_correlations_skip_what_has_no_result(robodyn: Run) -> None:
    line = ("sweep", BAR, "--kind", "torque", "--vary", "links.crank.l=0.3,0.35,1.2,0.32")
    line += ("--q", 3, "--qd", 5, "--result", "shake_fx,qd1")
    ranked = ("summary", "-", "--correlations", "links.crank.l")
    told = robodyn(*ranked, stdin=robodyn(*line, "--quiet").out)
    assert abs(float(told.succeeds().rows[0]["links.crank.l"])) == 1.0
    assert told.rows[1]["links.crank.l"] == ""  # constant
    every = robodyn("sweep", BAR, "--kind", "torque", "--vary", "links.crank.l=1.2", "--q", 3,
                    "--quiet")  # fmt: skip
    assert not robodyn(*ranked, stdin=every.succeeds().out).succeeds().rows


# What is refused


def test_what_does_not_finish_has_its_end_and_no_columns(robodyn: Run) -> None:
    line = ("sweep", ARM, "--vary", "qd1=3", "--max-steps", 100, "--time", 10, "--quiet")
    (row,) = robodyn(*line, "--result", "final,max(q1)", "--points", 4).succeeds().rows
    assert row["outcome"] == "too many evaluations"
    assert row["max(q1)"] == ""
    end = float(row["t_end"])
    assert 0.1 < end < 10.0 / 3.0
    motion = simulate(load(ARM), [0, 0], [3, 0], end, rtol=1e-11, atol=1e-11)
    assert float(row["q1_end"]) == pytest.approx(motion.q[-1, 0], abs=1e-7)


# Points of a sweep: grids against itertools, samples against one long draw.


GRID = Variation((Axis("a", (1.0, 2.0, 3.0)), Axis("b", (5.0, 6.0)), Axis("c", (0.0, -1.0))))


def test_a_grid_is_the_product_the_last_fastest() -> None:
    points = [*itertools.product((1.0, 2.0, 3.0), (5.0, 6.0), (0.0, -1.0))]
    assert GRID.size == len(points)
    assert GRID.points(0, GRID.size).tolist() == [list(point) for point in points]
    for begin, end in itertools.combinations(range(GRID.size + 1), 2):
        assert (GRID.points(begin, end) == np.array(points)[begin:end]).all()


def test_a_sample_is_one_long_draw_wherever_it_is_cut() -> None:
    axes = Axis("a", low=-1.0, high=3.0), Axis("b", (7.0, 8.0, 9.0))
    sample = Variation(axes, 1000, seed=5)
    u = np.random.Generator(np.random.PCG64(5)).random((1000, 2))
    whole = sample.points(0, 1000)
    assert (whole[:, 0] == -1.0 + u[:, 0] * 4.0).all()
    assert (whole[:, 1] == 7.0 + np.floor(u[:, 1] * 3)).all()
    cuts = [0, 1, 7, 500, 1000]
    parts = [sample.points(a, b) for a, b in itertools.pairwise(cuts)]
    assert (np.concatenate(parts) == whole).all()


def test_a_sample_is_uniform() -> None:
    axes = Axis("a", low=2.0, high=4.0), Axis("b", (0.0, 1.0, 2.0, 3.0))
    points = Variation(axes, 20_000, seed=1).points(0, 20_000)
    within, _ = np.histogram(points[:, 0], bins=10, range=(2.0, 4.0))
    assert within.sum() == 20_000
    assert np.abs(within - 2000).max() < 5 * math.sqrt(2000)
    assert np.abs(np.bincount(points[:, 1].astype(int)) - 5000).max() < 5 * math.sqrt(5000)
    assert abs(np.corrcoef(points.T)[0, 1]) < 0.03


def test_another_seed_is_another_sample() -> None:
    axis = (Axis("a", low=0.0, high=1.0),)
    first, second = (Variation(axis, 10, seed).points(0, 10) for seed in (1, 2))
    assert (first != second).all()


def test_steps_meet_the_end_exactly() -> None:
    turn = stepped(0.0, math.radians(360), math.radians(1))
    assert len(turn) == 361
    assert turn[-1] == math.radians(360)
    assert stepped(0.0, 1.0, 0.3) == (0.0, 0.3, 0.6, 0.8999999999999999)
    assert stepped(2.0, 1.0, -0.5) == (2.0, 1.5, 1.0)
    assert stepped(1.0, 1.0, 0.5) == (1.0,)


@pytest.mark.parametrize("step", [0.0, -0.1])
def test_a_step_that_leads_nowhere_is_refused(step: float) -> None:
    with pytest.raises(ValueError, match="nowhere"):
        stepped(0.0, 1.0, step)


def test_spaced_values_have_both_ends() -> None:
    assert spaced(0.5, 1.5, 3) == (0.5, 1.0, 1.5)
    assert spaced(2.0, 5.0, 1) == (2.0,)


def test_ends() -> None:
    assert Axis("a", (3.0, 1.0, 2.0)).ends == (1.0, 3.0)
    assert Axis("a", low=-1.0, high=4.0).ends == (-1.0, 4.0)
