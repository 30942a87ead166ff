"""`robodyn equations`: formats, files, errors, and what it costs to start."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import ROOT, Outcome
from unwritten import UNWRITTEN

Run = Callable[..., Outcome]
FORMATS = ("text", "latex", "python", "c", "json")
NAMES = sorted({path.stem for path in (ROOT / "robots").glob("*.yaml")} - UNWRITTEN)


@pytest.mark.parametrize("name", NAMES)
def test_every_format_of_every_scene(robodyn: Run, name: str) -> None:
    path = f"robots/{name}.yaml"
    for format in FORMATS:
        for numeric in ([], ["--numeric"]):
            given = robodyn("equations", path, "--format", format, *numeric).succeeds()
            assert given.out.endswith("\n")
            assert not given.out.endswith("\n\n")
            assert [line for line in given.out.splitlines() if line != line.rstrip()] == []
    assert robodyn("equations", path).out == robodyn("equations", path, "--format", "text").out


def test_text(robodyn: Run) -> None:
    found = robodyn("equations", "robots/2r.yaml").succeeds().out.splitlines()
    assert found[:5] == [
        "planar 2R arm: equations of motion",
        "",
        "  M qdd + C qd + G = tau",
        "",
        "  M11       = m1 r1² + I1 + m2 (l1² + r2² + 2 l1 r2 cos(q2)) + I2",
    ]
    assert "  m1  1.5    kg     mass of upper arm" in found
    assert "  q2    rad  angle of forearm from upper arm" in found
    assert max(map(len, found)) <= 100


def test_json(robodyn: Run) -> None:
    found = robodyn("equations", "robots/four-bar.yaml", "--format", "json").succeeds().json
    assert list(found) == [
        *("name", "equation", "q", "tau", "M", "C", "G", "Psi", "Psidot_qd", "gap"),
        *("symbols", "zero", "unused"),
    ]
    assert found["tau"] == ["tau1", "0", "0"]
    assert found["G"][2] == "m3*g*r3*cos(q3)"
    assert found["symbols"]["x3"] == {
        "value": 1.1,
        "unit": "m",
        "meaning": "ground pivot of rocker, x",
    }
    numeric = robodyn("equations", "robots/four-bar.yaml", "--format", "json", "--numeric").json
    assert (numeric["symbols"], numeric["unused"]) == ({}, [])
    assert numeric["G"][2] == "3.5316*cos(q3)"


def test_json_of_a_scene_with_springs(robodyn: Run, scene: Callable[[str], Path]) -> None:
    path = scene(
        """
links: [{name: a, m: 1, l: 1, r: 0, I: 1, damping: 2, friction: {torque: 1, speed: 0.1}}]
springs: [{between: [a, [2, 0]], stiffness: 5, length: 1}]
"""
    )
    found = robodyn("equations", path, "--format", "json").succeeds().json
    assert found["equation"] == "M qdd + D qd + G = tau + Q"
    assert found["D"] == [["d1"]]
    assert found["definitions"]["S1"] == "sqrt(S1x**2 + S1y**2)"
    assert found["Q"] == ["-tf1*tanh(qd1/wf1)"]
    assert found["zero"] == ["r1", "g"]


@pytest.mark.parametrize("format", FORMATS)
def test_a_file_is_written(robodyn: Run, tmp_path: Path, format: str) -> None:
    file = tmp_path / "equations"
    arguments = ["equations", "robots/2r.yaml", "--format", format]
    assert robodyn(*arguments, "--out", file).succeeds().out == ""
    assert file.read_text(encoding="utf-8") == robodyn(*arguments).out


def test_numbers_that_overflow(robodyn: Run, scene: Callable[[str], Path]) -> None:
    """A of the closed form is finite, the sum of its entries in M is not."""
    link = "{{name: {}, m: 1, l: 1, r: 1, I: 1e308}}"
    path = scene(f"links: [{link.format('a')}, {link.format('b')}]")
    for format in FORMATS:
        arguments = ["equations", path, "--format", format]
        robodyn(*arguments).succeeds()
        robodyn(*arguments, "--numeric").fails(2, "links", "overflow", path.name)
    spring = "springs: [{between: [a, [2, 0]], stiffness: 1e200, length: 1e200}]"
    path = scene(f"links: [{{name: a, m: 1, l: 1, r: 1, I: 1}}]\n{spring}\n")
    for format in ("python", "c"):
        robodyn("equations", path, "--format", format).succeeds()
        robodyn("equations", path, "--format", format, "--numeric").fails(2, "overflow", path.name)


def test_a_spring_without_a_direction(robodyn: Run, scene: Callable[[str], Path]) -> None:
    """Its ends coincide at every state: code would divide by zero."""
    head = (
        "links: [{name: a, m: 1, l: 1, r: 1, I: 1}]\nsprings: [{joint: a, stiffness: 1, angle: 0}"
    )
    ends = "{between: [{link: a, at: [0, 0]}, [0, 0]], stiffness: 2"
    told = "spring 2", "coincide"
    for rest in ("length: 0.4", "length: 0, damping: 1"):
        path = scene(f"{head}, {ends}, length: 0}}, {ends}, {rest}}}]\n")
        for format in ("python", "c"):
            robodyn("equations", path, "--format", format).fails(1, path.name, *told)
        robodyn("torque", path, "--q", "0.3").fails(1, path.name, *told)
    path = scene(f"{head}, {ends}, length: 0}}]\n")
    robodyn("equations", path, "--format", "python").succeeds()


def test_head_ends_it_quietly(shell: Run) -> None:
    given = shell("robodyn equations robots/3r.yaml --format c | head -1").succeeds()
    assert given.out == "/*\n"
    given = shell("{ sleep 0.1; robodyn equations robots/3r.yaml; echo $? >&2; } | exec 0<&-")
    assert given.err == "0\n"


def test_the_examples_of_the_help_work(quick_shell: Run, tmp_path: Path) -> None:
    text = quick_shell("robodyn equations --help").succeeds().out
    lines = [line.strip() for line in text.splitlines() if line.strip().startswith("robodyn ")]
    assert len(lines) >= 4
    for line in lines:
        given = quick_shell(line, cwd=tmp_path)
        assert (given.code, given.err) == (0, "")
    assert {"four-bar.tex", "arm.c"} <= {path.name for path in tmp_path.iterdir()}


def test_a_terminal_sets_the_width(shell: Run) -> None:
    """Of a pseudo-terminal of 60 columns that `script` makes."""
    code = (
        "import os, pty, sys; "
        "pty.spawn([sys.executable, '-m', 'robodyn', 'equations', 'robots/3r.yaml'])"
    )
    given = shell(f"{sys.executable} -c {code!r} < /dev/null", env={"COLUMNS": "60"})
    formulas = given.out.replace("\r", "").split("\nwhere\n")[0].splitlines()
    assert max(map(len, formulas)) <= 60
    assert "M33       = m3 r3² + I3" in given.out


def test_a_terminal_shows_how_far_a_long_text_is(shell: Run, tmp_path: Path) -> None:
    """A pseudo-terminal as stderr; nothing of the bar is in the file."""
    links = "".join(f"{{name: n{k}, m: 1, l: 1, r: 0.5, I: 0.1}}, " for k in range(4))
    (tmp_path / "long.yaml").write_text(f"gravity: 9.81\nlinks: [{links}]\n", encoding="utf-8")
    code = (
        "import pty, sys; from robodyn.cli import progress; progress.SILENT = 0.0; "
        "from robodyn import cli; sys.exit(cli.run(sys.argv[1:]))"
    )
    spawn = "import pty, sys; pty.spawn([sys.executable, *sys.argv[1:]])"
    for format in ("text", "latex", "json", "c"):
        given = shell(
            f"{sys.executable} -c {spawn!r} -c {code!r} equations long.yaml --format {format} "
            "-o out < /dev/null",
            cwd=tmp_path,
        ).succeeds()
        assert ("writing" in given.out) == (format != "c")
        assert "writing" not in (tmp_path / "out").read_text(encoding="utf-8")


def test_what_reads_back_is_the_same(robodyn: Run) -> None:
    """JSON in full digits: the product of the scene's decimal numbers, rounded once."""
    found = robodyn("equations", "robots/3r.yaml", "--format", "json", "--numeric").out
    assert json.loads(found)["M"][2][2] == "0.0212"  # 0.75 * 0.14^2 + 0.0065
