"""`--degrees`: angles of rows times 180/pi, under their own names; all else to the last digit."""

from __future__ import annotations

import math
from collections.abc import Callable

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
    ("points robots/rp-arm.yaml - --links", ROWS),
    ("points robots/four-bar.yaml --q 60deg --qd 5 --links --transmission", ""),
    ("trajectory robots/rp-arm.yaml --from 0,0.1 --to 1,0.2 --time 1 --points 4", ""),
    ("simulate robots/rp-arm.yaml --q 1,0.2 --time 0.2 --points 4 --quiet", ""),
    ("equilibrium robots/2r.yaml --all", ""),
]


def turns(name: str, line: str) -> bool:
    """Whether a column is in degrees: of the RP arm joint 2 slides."""
    joint = name.removeprefix("q").removeprefix("d").removeprefix("d")
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
    (row, *_) = robodyn(*line.split(), "--extremes").rows
    assert (row["column"], row["max"], row["max_q1_deg"]) == ("q1_deg", "90.0", "90.0")
    line = "torque robots/four-bar.yaml - --fluctuation 0.1 --degrees"
    robodyn(*line.split(), stdin="q1\n0\n").fails(2, "--degrees", "exclude")
