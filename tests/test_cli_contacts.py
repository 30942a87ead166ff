"""Scenes whose joints stick or end, on the command line: what is told, refused, and exits with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import Outcome

Run = Callable[..., Outcome]
ARM = """gravity: 9.81
links:
  - {name: arm, m: 1, l: 1, r: 0.5, I: 0.1, %s}
  - {name: fore, m: 1, l: 1, r: 0.5, I: 0.1, %s}
"""
ENDS, HIGH = "limits: {min: -150deg, max: 30deg}", "limits: {max: 60deg}"
STICKS = "friction: {torque: 1, static: 2, stribeck: 0.1}"
SOFT = "limits: {min: -150deg, max: 30deg, stiffness: 1e4, damping: 10}"
HARD = "limits: {min: -60deg, max: 60deg, restitution: 0.3}"


def scene(folder: Path, first: str, second: str) -> Path:
    """An arm of two links; the scene's file."""
    path = folder / "arm.yaml"
    path.write_text(ARM % (first, second))
    return path


def test_a_limit_ends_a_run_by_name(robodyn: Run, tmp_path: Path) -> None:
    out = tmp_path / "rows.csv"
    arm = scene(tmp_path, ENDS, HIGH)
    given = robodyn("simulate", arm, "--q", "0,0", "--every", 0.3)
    assert given.code == 0
    assert given.err.startswith("limit: t = ")
    assert "q1 (arm) passes its min, -2.61799388: the joint has no stop there" in given.err
    assert float(given.rows[-1]["q1"]) == pytest.approx(-2.6179938779914944, abs=1e-12)
    robodyn("simulate", arm, "--q", "0,0", "--every", 0.3, "-o", out, "--quiet").succeeds()
    assert (out.read_text(), [*tmp_path.glob("rows.csv?*")]) == (given.out, [])


def test_a_run_that_starts_on_a_limit_and_is_pushed_beyond_has_one_row(
    robodyn: Run, tmp_path: Path
) -> None:
    arm = scene(tmp_path, ENDS, "limits: {max: 0}")
    given = robodyn("simulate", arm, "--q", "0,0", "--qd", "0,1")
    assert given.code == 0
    assert (len(given.rows), given.err[:11]) == (1, "limit: t = ")


@pytest.mark.parametrize("method", ["DOP853", "taylor"])
def test_the_error_of_a_run_that_a_limit_ends_is_estimated(
    robodyn: Run, tmp_path: Path, method: str
) -> None:
    how = ["--q", "0,0", "--points", 5, "--method", method]
    loose, tight = (
        robodyn("simulate", scene(tmp_path, ENDS, HIGH), *how, *more)
        for more in (["--estimate-error", "--rtol", "1e-7", "--atol", "1e-7"], ["--rtol", "1e-13"])
    )
    told = float(loose.err.partition("error of q and qd: about ")[2].split(",")[0])
    columns = ("q1", "q2", "qd1", "qd2")
    assert len(loose.rows) > 1
    for one, other in zip(loose.rows[:-1], tight.rows[:-1], strict=True):
        assert max(abs(float(one[x]) - float(other[x])) for x in columns) <= 2.0 * told
    accurate = robodyn("simulate", scene(tmp_path, ENDS, HIGH), *how[:4], "--accuracy", "1e-8")
    assert (accurate.code, loose.code, tight.code) == (0, 0, 0)
    assert "by a tighter run" in accurate.err


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("simulate", "--q", "40deg,0"), 2, "q1 (arm) = 0.698"),
        (("simulate", "--q", "0,0", "--time", "-1"), 2, "must not be negative"),
        (("trajectory", "--from", "0,0", "--to", "20deg,90deg", "--time", 2), 1, "q2 (fore) at t"),
        (("assemble", "--q", "0,70deg"), 1, "q2 (fore) = 1.22"),
        (("bench", "--q", "0,0", "--time", 1), 1, "the reference is of smooth motions"),
    ],
)
def test_what_is_refused_is_named(
    robodyn: Run, tmp_path: Path, words: tuple, code: int, told: str
) -> None:
    command, *options = words
    given = robodyn(command, scene(tmp_path, ENDS, HARD), *options)
    assert given.code == code
    assert told in given.err
    assert not given.out


def test_an_angle_a_turn_off_is_within_limits(robodyn: Run, tmp_path: Path) -> None:
    assert robodyn("assemble", scene(tmp_path, ENDS, HARD), "--q", "340deg,0").code == 0


def test_states_tell_what_sticks_and_presses(robodyn: Run, tmp_path: Path) -> None:
    path = scene(tmp_path, SOFT, STICKS)
    held = robodyn("accel", path, "--q=-90deg,0", "--tau", "0,1.5")
    assert float(held.rows[0]["qdd2"]) == 0.0
    moved = robodyn("accel", path, "--q=-90deg,0", "--tau", "0,2.5")
    assert float(moved.rows[0]["qdd2"]) > 0.0
    needs = robodyn("torque", path, "--q=-90deg,0")
    assert "any torque within its static friction of this holds it" in needs.err
    slips = [
        float(robodyn("torque", path, "--q=-90deg,0", "--qd", f"0,{rate}").rows[0]["tau2"])
        for rate in (10.0, -10.0)
    ]
    assert slips == pytest.approx([1.0, -1.0], abs=1e-12)
    free, pressed = (
        float(robodyn("energy", path, "--q", f"{q}deg,0").rows[0]["PE"]) for q in (29, 31)
    )
    weights = [9.81 * (0.5 + 1.5) * s for s in (0.48480962024633706, 0.5150380749100542)]
    stored = 0.5 * 1e4 * 0.017453292519943295**2
    assert [free, pressed] == pytest.approx([weights[0], weights[1] + stored], rel=1e-12)


def test_what_is_left_out_is_said(robodyn: Run, tmp_path: Path) -> None:
    path = scene(tmp_path, SOFT, STICKS)
    assert "dry friction is that in motion" in robodyn("equations", path).err
    assert "Q is without the dry friction of fore" in robodyn("terms", path, "--q", "0,0").err
    robodyn("check", path).succeeds()
    hard = scene(tmp_path, STICKS, HARD)
    assert "hard stops and limits are left out" in robodyn("equations", hard).err


def test_contacts_are_events(robodyn: Run, tmp_path: Path) -> None:
    events = tmp_path / "events.csv"
    path = scene(tmp_path, STICKS, HARD)
    given = robodyn("simulate", path, "--q", "20deg,0", "--time", 3, "--events", events)
    assert given.code == 0, given.err
    names = [line.split(",")[0] for line in events.read_text().splitlines()[1:]]
    assert "fore hits its min" in names
    assert f"fore hits its min {names.count('fore hits its min')}" in given.err


def test_sweeps_go_one_by_one(robodyn: Run, tmp_path: Path) -> None:
    path = scene(tmp_path, STICKS, HARD)
    given = robodyn(
        "sweep", path, "--vary", "links.fore.limits.restitution=0,0.5", "--time", 4,
        "--event", "turns=qd2", "--result", "final,events",
    )  # fmt: skip
    assert given.code == 0, given.err
    assert [row["outcome"] for row in given.rows] == ["finished", "finished"]
    assert given.rows[0]["q2_end"] != given.rows[1]["q2_end"]
    assert all(float(row["turns_count"]) >= 0 for row in given.rows)
