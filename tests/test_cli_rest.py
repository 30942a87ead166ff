"""`robodyn equilibrium`, `robodyn linearize` and `robodyn animate --mode` on the command line."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import Outcome, relative_error
from sliding_scenes import SCISSORS, STARTED

import robodyn as rd

Run = Callable[..., Outcome]
CART = "robots/cart-pole.yaml"
BAR = "robots/four-bar.yaml"


def test_all_poses_of_a_double_pendulum(robodyn: Run) -> None:
    given = robodyn("equilibrium", "robots/2r.yaml", "--all").succeeds()
    assert given.out.splitlines()[0] == "q1,q2,PE,stable"
    assert [row["stable"] for row in given.rows] == ["yes", "no", "no", "no"]
    angles = {(round(math.degrees(float(x["q1"]))), float(x["q2"]) > 1) for x in given.rows}
    assert angles == {(-90, False), (-90, True), (90, False), (90, True)}


def test_the_turns_that_are_searched_are_told(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "coil.yaml"
    link = "gravity: 9.81\nlinks: [{name: a, m: 0.2, l: 1, r: 0.5, I: 0.1}]\n"
    path.write_text(link + "springs: [{joint: a, stiffness: 3, angle: 0}]\n")
    given = robodyn("equilibrium", path, "--all")
    assert "q1 (a) from -180 to 180 deg" in given.err
    path.write_text(link + "springs: [{joint: a, stiffness: 0.1, angle: 0}]\n")
    given = robodyn("equilibrium", path, "--all")
    told = re.search(r"q1 \(a\) from -(\d+) to (\d+) deg", given.err)
    assert told is not None
    reach = math.degrees(0.2 * 9.81 * 0.5 / 0.1)  # where the coil pulls as hard as the weight can
    assert all(reach < float(x) < 3 * reach for x in told.groups())


def test_held_joint_and_its_torque(robodyn: Run) -> None:
    given = robodyn("equilibrium", BAR, "--q", "60deg", "--hold", "crank").succeeds()
    needed = robodyn("torque", BAR, "--q", "60deg").succeeds()
    assert given.out.splitlines()[0] == "q1,q2,q3,tau1,PE,stable"
    assert float(given.rows[0]["tau1"]) == pytest.approx(needed.row["tau1"], rel=1e-12)
    rows = robodyn("equilibrium", BAR, "--tau", "2", "--all", "--format", "json").succeeds().json
    for row in rows:
        given = robodyn("torque", BAR, "--q", ",".join(str(row[f"q{k}"]) for k in (1, 2, 3)))
        assert given.row["tau1"] == pytest.approx(2.0, rel=1e-9)


def test_a_branch_that_is_not_asked_for_hides_no_rest(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "scissors.yaml"
    path.write_text(SCISSORS + STARTED)
    held = robodyn("equilibrium", path, "--hold", "armA").succeeds()
    assert float(held.rows[0]["tau1"]) == pytest.approx(2.4 * 9.81 * math.cos(math.pi / 6))
    rests = robodyn("equilibrium", path, "--all").succeeds()
    heights = [float(row["PE"]) / 9.81 for row in rests.rows]
    assert heights == pytest.approx([-3.2, -2.4, -1.6, 1.6, 3.2])


def test_torques_that_are_not_unique_are_told(robodyn: Run, tmp_path: Path) -> None:
    both = robodyn("equilibrium", BAR, "--q", "60deg", "--hold", "crank", "--hold", "rocker")
    assert "Warning: held joints share their torques in many ways (least norm given)" in both.err
    driven = tmp_path / "driven.yaml"
    driven.write_text(Path(BAR).read_text().replace("[crank]", "[crank, rocker]"))
    angles = ",".join(both.rows[0][f"q{k}"] for k in (1, 2, 3))
    assert "with the least torque that holds it" in robodyn("linearize", driven, "--q", angles).err


def test_linear_model_as_json(robodyn: Run) -> None:
    given = robodyn("linearize", "robots/2r.yaml", "--q", "-90deg,0", "--tau", "0,0").succeeds()
    keys = "coordinates q qd tau N A B modes stable controllable"
    assert list(given.json) == keys.split()
    assert given.json["coordinates"] == ["q1", "q2"]
    assert [list(mode) for mode in given.json["modes"]] == [
        ["eigenvalue", "frequency", "damping", "shape", "lag"]
    ] * 2
    assert given.json["stable"] is True
    model = rd.linearize(rd.load("robots/2r.yaml"), [-math.pi / 2, 0.0])
    assert relative_error(given.json["A"], model.A) == 0.0


def test_stderr_tells_the_torque_that_is_taken_and_why_there_are_no_modes(robodyn: Run) -> None:
    given = robodyn("linearize", BAR, "--q", "60deg")
    assert given.err == "Note: with the torque that holds it, tau1 = 1.34938005\n"
    assert given.json["modes"]
    for options, why in [
        (("--tau", "0"), "q1'' = -10.8086"),
        (("--qd", "2"), "it moves"),
    ]:
        given = robodyn("linearize", BAR, "--q", "60deg", *options)
        assert given.code == 0
        assert f"Note: this is no equilibrium ({why}): modes belong to those\n" in given.err
        assert given.json["A"]
        assert given.json["B"]
        assert [given.json[x] for x in ("modes", "stable", "controllable")] == [None] * 3


def test_tables(robodyn: Run) -> None:
    given = robodyn("linearize", CART, "--q", "0,90deg", "--lqr", "--format", "table")
    for part in ("A\n", "B\n", "modes\n", "gain\n", "frequency [Hz]", "controllable", "qd2'"):
        assert part in given.out


def test_the_gain_is_written_with_what_it_needs(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "gain.json"
    options = ("--lqr", "--weights-x", "1,10,1,1", "--weights-u", "0.1", "--gain-out", path)
    given = robodyn("linearize", CART, "--q", "0,90deg", *options)
    written = json.loads(path.read_text())
    assert list(written) == ["coordinates", "q", "tau", "gain"]
    assert written == {key: given.json[key] for key in written}
    assert written["coordinates"] == ["q1", "q2"]
    assert [len(written["tau"]), len(written["gain"]), len(written["gain"][0])] == [1, 1, 4]


def test_the_gain_holds_a_falling_four_bar(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "gain.json"
    made = robodyn("linearize", BAR, "--q", "60deg", "--lqr", "--gain-out", path)
    assert made.json["stable"] is False
    law = ("--control", "state-feedback", "--gain", path, "--time", 10, "--points", 2, "--quiet")
    given = robodyn("simulate", BAR, "--q", "70deg", *law).succeeds()
    assert given.column("q1")[-1] == pytest.approx(math.pi / 3, abs=1e-8)
    assert given.column("tau1")[-1] == pytest.approx(made.json["tau"][0], rel=1e-6)


def test_a_mode_is_shown_with_loops_closed(robodyn: Run, tmp_path: Path) -> None:
    page = tmp_path / "mode.html"
    robodyn("animate", BAR, "--mode", "1", "--q", "-1.8616182126637683", "-o", page)
    assert page.stat().st_size > 5000
    from robodyn.rest.linear_model import mode_motion

    mech = rd.load(BAR)
    model = rd.linearize(mech, rd.assemble(mech, [-1.0]))
    t, q = mode_motion(mech, model, 1, 2.0)
    assert abs(rd.closure_gap(mech, q)).max() < 1e-12
    assert 0.1 < abs(q[:, 0] - q[0, 0]).max() < 0.5
    assert t[-1] >= 2.0
    assert relative_error(q[-1], q[0]) < 1e-9
    cart = rd.load(CART)
    creeps = rd.linearize(cart, [0.0, math.pi / 2])  # by its bearings' damping, in minutes
    assert mode_motion(cart, creeps, 2, 2.0)[0][-1] == 2.0


@pytest.mark.parametrize(
    ("line", "code", "parts"),
    [
        (f"equilibrium {BAR} --hold crnk", 2, ("--hold = crnk", "did you mean crank?")),
        (f"equilibrium {BAR} --q 0.1,0.2,0.3", 2, ("--q: ", "the loops are open")),
        (
            f"equilibrium {BAR} --q 1 --tau 90",
            1,
            ("--tau = 90, 0, 0: no pose", "near q = 1,", " %"),
        ),
        (f"equilibrium {CART} --all", 1, ("no end of poses at rest",)),
        (f"linearize {BAR}", 2, ("--q: missing: give it\n",)),
        (f"linearize {BAR} --q 0.1,0.2,0.3", 2, ("--q: ", "the loops are open")),
        ("linearize robots/parallelogram.yaml --q 0,0,0", 1, ("change point", "two ways")),
        (f"linearize {BAR} --q 1 --weights-x 1", 2, ("--weights-x", "--lqr")),
        (f"linearize {BAR} --q 1 --gain-out x.json", 2, ("--gain-out", "--lqr")),
        (f"linearize {BAR} --q 1 --lqr --weights-u 0", 2, ("--weights-u = 0", "definite")),
        (f"linearize {BAR} --q 1 --lqr --weights-x 1,2,3", 2, ("--weights-x", "1, 2 or")),
        (f"linearize {BAR} --q 1 --lqr --tau 0", 1, ("no gain: this is no equilibrium",)),
        (f"animate {BAR} -o x.html", 2, ("CSV", "--mode")),
        (f"animate {BAR} rows.csv --mode 1 --q 1 -o x.html", 2, ("not both",)),
        (f"animate {BAR} rows.csv --q 1 -o x.html", 2, ("--q = 1", "--mode")),
        (f"animate {BAR} --mode 3 --q 1 -o x.html", 2, ("--mode = 3", "modes 1 to 2")),
        (f"animate {BAR} --mode 1 --q 1 --tau 0 -o x.html", 1, ("no modes", "no equilibrium")),
    ],
)
def test_what_cannot_be_done_is_named(
    robodyn: Run, line: str, code: int, parts: tuple[str, ...]
) -> None:
    given = robodyn(*line.split())
    assert given.code == code
    for part in parts:
        assert part in given.err
    assert code == 1 or "Note" not in given.err  # input is looked at first
    assert not Path("x.html").exists()


def test_what_is_left_out_is_told(robodyn: Run, tmp_path: Path) -> None:
    scene = tmp_path / "leg.yaml"
    leg = "{name: leg, m: 1, l: 1, r: 1, I: 0, friction: {static: 2, torque: 1}}"
    scene.write_text(f"gravity: 9.81\nlinks: [{leg}]\n")
    given = robodyn("equilibrium", scene, "--q", "-1")
    assert given.err == "Note: dry friction and hard stops hold nothing here\n"
    assert float(given.rows[0]["q1"]) == pytest.approx(-math.pi / 2, abs=1e-12)


# -- ends of joints, and bends ---------------------------------------------------------------------

ENDED = "gravity: 9.81\nlinks: [{{name: a, m: 1, l: 1, r: 0.5, I: 0.1, limits: {{{}}}}}]\n"


@pytest.mark.parametrize("hard", ["", ", restitution: 0.5"])
def test_rest_beyond_an_end_is_told_by_name(robodyn: Run, tmp_path: Path, hard: str) -> None:
    path = tmp_path / "lim.yaml"
    path.write_text(ENDED.format(f"min: -60deg, max: 60deg{hard}"))
    beyond = "q1 (a) = -1.57079633: ", "beyond the joint's min, -1.04719755"
    robodyn("equilibrium", path, "--all").fails(1, *beyond)
    robodyn("linearize", path, "--q=-90deg").fails(2, *beyond)
    assert robodyn("linearize", path, "--q=-60deg").code == 0
    for command in ("torque", "accel", "points", "terms"):
        assert robodyn(command, path, "--q=-90deg").code == 0


def test_a_compliant_stop_may_be_entered(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "soft.yaml"
    path.write_text(ENDED.format("min: -60deg, stiffness: 100"))
    told = robodyn("linearize", path, "--q=-90deg").json
    assert told["A"][1][0] == pytest.approx(-(100 + 9.81 * 0.5) / 0.35)


@pytest.mark.parametrize(
    ("keys", "springs", "q", "slope", "side"),
    [
        ("", "{joint: a, table: tr.csv, angle: 0}", "0", 50.0, "larger"),
        ("", "{joint: a, table: tr.csv, angle: 0}", "-0.5", 5.0, ""),
        ("limits: {max: 1, stiffness: 100},", "{joint: a, stiffness: 3, angle: 0}", "1", 3.0,
         "smaller"),
        ("limits: {max: 1, stiffness: 100},", "{joint: a, stiffness: 3, angle: 0}", "0.9", 3.0, ""),
    ],
)  # fmt: skip
def test_the_side_of_a_bend_is_told(
    robodyn: Run, tmp_path: Path, keys: str, springs: str, q: str, slope: float, side: str
) -> None:
    (tmp_path / "tr.csv").write_text("x,F\n-1,-5\n0,0\n1,50\n")
    path = tmp_path / "bent.yaml"
    link = f"{{name: a, m: 1, l: 1, {keys} r: 0.5, I: 0.1}}"
    path.write_text(f"links: [{link}]\nsprings: [{springs}]\n")
    given = robodyn("linearize", path, f"--q={q}")
    assert given.json["A"][1][0] == pytest.approx(-slope / 0.35)
    told = f"its slope is that towards {side} q1 (a)"
    assert (told in given.err) if side else ("slope" not in given.err)


PASSIVE = (
    "links: [{name: a, m: 1.1, l: 0.7, r: 0.33, I: 0.05}, {name: b, m: 0.8, l: 0.9, r: 0.5, I: 0.06"
    "}]\nactuated: [b]\ngravity: 9.81\n"
)


def test_a_pose_that_nothing_holds_is_told(robodyn: Run, tmp_path: Path) -> None:
    path, gain = tmp_path / "ab.yaml", tmp_path / "gain.json"
    path.write_text(PASSIVE)
    robodyn("linearize", path, "--q", "90deg,0", "--lqr", "--gain-out", gain)
    run = ("simulate", path, "--q", "0,0", "--control", "state-feedback", "--gain", gain)
    run = (*run, "--time", "0.01", "--points", "2", "--at")
    told = robodyn(*run, "0,0").err
    assert "no torque of the actuated joints holds it at --at" in told
    assert "it is held by" not in told
    assert "holds it" not in robodyn(*run, "90deg,0").err


# -- rests that only rounding leaves ---------------------------------------------------------------


def test_rounding_is_no_push(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "rest.yaml"
    path.write_text("gravity: 9.81\nlinks: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n")
    flip = ("sweep", path, "--quiet", "--result", "flip", "--time", "3", "--vary")
    rows = robodyn(*flip, "links.a.m=1,2", "--q", "90deg").succeeds().rows
    assert [row["flip"] for row in rows] == ["", ""]
    (swung,) = robodyn(*flip, "qd1=3", "--q", "80deg").succeeds().rows
    assert float(swung["flip"]) > 0.01
    only = "only rounding moves it"
    assert only in robodyn("simulate", path, "--q", "90deg", "--time", "1").err
    for others in (
        ("--q=-90deg",),
        ("--q", "90deg", "--tau", "0.1"),
        (
            "--q",
            "89.9deg",
        ),
    ):
        assert only not in robodyn("simulate", path, *others, "--time", "0.1").err
    timed = ("--q", "90deg", "--tau", "0.001*t", "--time", "0.1")
    assert only not in robodyn("simulate", path, *timed).err


def test_a_sweep_that_holds_a_pose_starts_at_zero(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    path.write_text("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n")
    given = robodyn(
        "sweep", path, "--quiet", "--vary", "links.a.m=1", "--control", "pd", "--kp", "20",
        "--kd", "0", "--hold", "1", "--time", "0.001", "--result", "final",
    ).succeeds()  # fmt: skip
    # q = 1 - cos(w t), w^2 = 20/0.35
    assert float(given.rows[0]["q1_end"]) == pytest.approx(20 / 0.35 * 0.5e-6, rel=1e-4)


def test_one_name_is_no_list_of_letters() -> None:
    mech = rd.load("robots/2r.yaml")
    q = [0.3, 0.4]
    (name,) = mech.link_names[:1]
    assert rd.equilibrium(mech, q, hold=name).q[0] == 0.3
    assert len(rd.equilibria(mech, q, hold=name)) == len(rd.equilibria(mech, q, hold=[name]))
    t = np.linspace(0.0, 2.0, 60)
    q, qd, qdd = (
        np.column_stack([np.sin(3 * t + a) * s, np.cos(2 * t) * s])
        for a, s in ((0, 1.0), (1, 2.0), (2, 3.0))
    )
    tau = rd.inverse_dynamics(mech, q, qd, qdd)
    found = rd.identify(mech, q, qd, qdd, tau, of="links.forearm.m")
    assert [x.name for x in found.estimates] == ["links.forearm.m"]
    assert found.estimates[0].value == pytest.approx(mech.description.links[1].m, rel=1e-9)
    both = rd.sweep(mech, {"q1": [0.0, 1.0]}, time=0.1, result=["final", "drift"])
    text = rd.sweep(mech, {"q1": [0.0, 1.0]}, time=0.1, result="final,drift")
    assert list(both) == list(text)
