"""`--degrees`: angles of rows times 180/pi, under their own names; all else to the last digit."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import Outcome
from named_case import case

Run = Callable[..., Outcome]
ROWS = "note,t,q1,q2,qd1,qd2\nfirst,0,0.5,0.1,1,0.2\nlast,1,-0.25,0.15,2,0.1\n"
LINES = [
    ("torque robots/rp-arm.yaml -", ROWS),
    ("accel robots/rp-arm.yaml -", ROWS),
    ("energy robots/rp-arm.yaml -", ROWS),
    ("reactions robots/rp-arm.yaml -", ROWS),
    ("points robots/rp-arm.yaml - --columns note,q1,points,links", ROWS),
    ("points robots/four-bar.yaml --q 60deg --qd 5 --columns links,transmission", ""),
    ("trajectory robots/rp-arm.yaml --from 0,0.1 --to 1,0.2 --time 1 --points 4", ""),
    ("simulate robots/rp-arm.yaml --q 1,0.2 --time 0.2 --points 4 --quiet", ""),
    ("equilibrium robots/2r.yaml --all", ""),
    ("assemble robots/rp-arm.yaml --q 1,0.2 --qd 0.1,0.2 --format csv", ""),
    ("sweep robots/rp-arm.yaml --vary q1=0,1 --vary q2=0.1,0.2 --time 0.1 --quiet", ""),
    ("sweep robots/rp-arm.yaml --vary q1=0:1:2 --kind torque --q 0,0.1 --quiet", ""),
]


def turns(name: str, line: str) -> bool:
    """Whether a column is in degrees: of the RP arm joint 2 slides."""
    joint = re.sub("^q(d?d?)|_(end|min|max)$", "", name)
    if name.startswith("q") and joint.isdecimal():
        return not ("rp-arm" in line and joint == "2")
    return name.rstrip("0123456789") in ("angle", "w", "wd", "transmission")


def test_columns_of_angles_alone_are_others(robodyn: Run) -> None:
    for line, stdin in LINES:
        with case(line, stdin):
            plain = robodyn(*line.split(), stdin=stdin)
            told = robodyn(*line.split(), "--degrees", stdin=stdin)
            assert (plain.code, told.code, told.err) == (0, 0, plain.err)
            assert len(plain.rows) == len(told.rows) > 0
            changed = 0
            for one, other in zip(plain.rows, told.rows, strict=True):
                assert len(one) == len(other)
                for (name, text), (new, value) in zip(one.items(), other.items(), strict=True):
                    if turns(name, line):
                        assert new == f"{name}_deg"
                        assert float(value) == pytest.approx(math.degrees(float(text)), rel=1e-15)
                        changed += 1
                    else:
                        assert (new, value) == (name, text)
            assert changed


def test_tables_json_and_extremes(robodyn: Run) -> None:
    line = "trajectory robots/2r.yaml --from 0,0 --to 90deg,45deg --time 1 --points 3 --degrees"
    assert "q1_deg [°]" in robodyn(*line.split(), "--format", "table").out
    assert robodyn(*line.split(), "--format", "json").json[2]["q2_deg"] == 45.0
    (row, *_) = robodyn("summary", "-", stdin=robodyn(*line.split()).out).rows
    assert (row["column"], row["max"], row["max_q1_deg"]) == ("q1_deg", "90.0", "90.0")
    line = "torque robots/four-bar.yaml - --fluctuation 0.1 --degrees"
    robodyn(*line.split(), stdin="q1\n0\n").fails(2, "--degrees", "exclude")


def test_results_with_parts(robodyn: Run) -> None:
    """Keys q_deg; displacements and matrices stay as they are."""
    for line, keys in (
        ("terms robots/rp-arm.yaml --q 30deg,0.1 --qd 1,0.5", ["q", "qd"]),
        ("linearize robots/cart-pole.yaml --q 0.1,-90deg", ["q", "qd"]),
        ("assemble robots/rp-arm.yaml --q 30deg,0.1 --qd 1,0.5 --format json", ["q", "qd", "qdd"]),
    ):
        plain, told = (robodyn(*line.split(), *more).json for more in ((), ("--degrees",)))
        if "branches" in plain:
            (plain,), (told,) = plain["branches"], told["branches"]
        turning = 1 if "cart" in line else 0
        for key in keys:
            values = plain.pop(key)
            values[turning] = math.degrees(values[turning])
            assert told.pop(f"{key}_deg") == pytest.approx(values, rel=1e-15)
        assert told == plain
    line = "terms robots/rp-arm.yaml --q 30deg,0.1 --format table --degrees"
    assert "1 [°]   2 [m]" in robodyn(*line.split()).out
    line = "assemble robots/four-bar.yaml --q 60deg --range --degrees"
    lines = robodyn(*line.split()).rows
    assert lines[0]["joint"] == "q1_deg"
    assert float(lines[0]["high"]) - float(lines[0]["low"]) == pytest.approx(360.0)


def test_columns_in_degrees_are_read(robodyn: Run, tmp_path: Path) -> None:
    """What --degrees wrote gives the same numbers, wherever rows are read."""
    line = "trajectory robots/2r.yaml --from 0,0 --to 1,2 --time 1 --points 9"
    plain, told = robodyn(*line.split()).out, robodyn(*line.split(), "--degrees").out
    for task in (
        "torque robots/2r.yaml -",
        "trajectory robots/2r.yaml --via -",
        "simulate robots/2r.yaml --q 0,0 --track - --control pd --kp 9 --kd 1 --points 3 --quiet",
        "fit robots/2r.yaml - --vary links.forearm.m=0.2:3 --minimize tau1 --residuals --quiet",
        "regressor robots/2r.yaml - --condition",
    ):
        one, other = (robodyn(*task.split(), stdin=text) for text in (plain, told))
        assert one.code == other.code == 0
        if task.startswith("reg"):
            assert one.json["condition"] == pytest.approx(other.json["condition"])
            continue
        assert len(one.rows) == len(other.rows) > 2
        for a, b in zip(one.rows, other.rows, strict=True):
            numbers = {k: float(x) for k, x in a.items() if k in b}
            assert "tau1" in numbers or "q1" in numbers
            assert numbers == pytest.approx({k: float(b[k]) for k in numbers}, abs=1e-7, rel=1e-6)
    # a displacement is none
    robodyn("torque", "robots/rp-arm.yaml", "-", stdin=told).fails(2, "column q2 is missing")


def test_an_angle_that_is_there_twice_is_refused(robodyn: Run, tmp_path: Path) -> None:
    """Nobody knows which of them is meant, wherever rows are read."""
    path, out = tmp_path / "two.csv", tmp_path / "a.html"
    path.write_text("t,q1,q1_deg,q2\n0,0.5,90,0\n1,0.5,90,0\n")
    for task in (
        *(
            f"torque robots/2r.yaml {path}",
            f"torque robots/2r.yaml {path} --degrees",
            f"trajectory robots/2r.yaml --via {path}",
        ),
        *(f"draw robots/2r.yaml {path} --format svg", f"animate robots/2r.yaml {path} -o {out}"),
        f"simulate robots/2r.yaml --q 0,0 --track {path} --control pd --kp 9 --kd 1",
        f"plot {path} --y q2 --x q1 --format text",
    ):
        refused = robodyn(*task.split()).fails(2, f"{path}: column q1", "again as q1_deg: leave")
        assert refused.out == ""
    # what passes through is the user's, unless it would have the name of another column
    path.write_text("q1,q2,angle2,angle2_deg\n0,0,1,2\n")
    points = robodyn("points", "robots/2r.yaml", path, "--of", "tip2").succeeds()
    assert points.rows[0]["angle2_deg"] == "2"
    refused = robodyn("points", "robots/2r.yaml", path, "--of", "tip2", "--degrees")
    refused.fails(2, "--degrees = angle2", "angle2_deg beside it")
    scene, table = tmp_path / "scene.yaml", tmp_path / "g.csv"
    scene.write_text(
        "links: [{name: a, l: 1, m: 1, r: 0.5, I: 0.1}]\n"
        "loads: [{link: a, torque: {table: g.csv, over: q1, column: T}}]\n"
    )
    table.write_text("q1,q1_deg,T\n-4,-180,1\n4,180,1\n")
    robodyn("torque", scene, "--q", "0").fails(2, "table = g.csv", "column q1", "again as q1_deg")
    # a displacement is no angle
    path.write_text("q1,q2,q2_deg\n0,0.1,7\n")
    robodyn("torque", "robots/rp-arm.yaml", path, "--degrees").succeeds()


@pytest.mark.parametrize("mark", [";", "\t"])
def test_tables_of_scenes_with_other_delimiters(robodyn: Run, tmp_path: Path, mark: str) -> None:
    scene, results = tmp_path / "scene.yaml", []
    scene.write_text(
        "gravity: 9.81\nlinks: [{name: a, l: 1, m: 1, r: 0.5, I: 0.1}]\n"
        "springs: [{joint: a, table: f.csv, angle: 0}]\n"
        "loads: [{link: a, torque: {table: g.csv, over: q1, column: T}}]\n"
    )
    pull, turn = [["x", "F"], ["-1", "2.5"], ["0.5", "-1"]], [["-180", "2.5"], ["180", "-1"]]
    radians = [[repr(math.radians(float(x))), T] for x, T in turn]
    for tables in (pull, [["q1", "T"], *radians]), (pull, [["q1_deg", "T"], *turn]):
        for delimiter in ",", mark:
            for name, rows in zip("fg", tables, strict=True):
                text = "\n".join(delimiter.join(row) for row in rows)
                text = text.replace(".", ",") if delimiter == ";" else text
                (tmp_path / f"{name}.csv").write_text(text + "\n")
            results.append(float(robodyn("torque", str(scene), "--q", "0.25").rows[0]["tau1"]))
    assert results == pytest.approx([3.725109337029455] * 4, rel=1e-14)
