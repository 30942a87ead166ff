"""Names, fields and arguments as terminals and figures show them: as they stand, or escaped."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from xml.dom import minidom

import pytest
from conftest import ROOT, Outcome
from each_case import each
from quick_robodyn import path_with_it

Run = Callable[..., Outcome]

EVIL = "a\x1b]0;owned\x07\x1b[8m\x9b31mb"  # a title, hidden text, and a colour by a single byte
SHOWN = r"a\x1b]0;owned\x07\x1b[8m\x9b31mb"
SCENE = rf"""
name: "arm {EVIL.encode("unicode_escape").decode()}"
links:
  - {{name: "{EVIL.encode("unicode_escape").decode()}", m: 1, l: 1, r: 0.5, I: 0.1}}
  - {{name: "tip\rof\nit", m: 1, l: 1, r: 0.5, I: 0.1}}
"""
OWN = re.compile(r"\x1b\[[0-9;]*m")  # styles of a table or a picture


def on_terminal(*arguments: object, **more: str) -> str:
    """All that a terminal of 80 columns is sent by a command, less styles."""
    return OWN.sub("", sent(*arguments, **more))


def sent(*arguments: object, **more: str) -> str:
    """All that a terminal of 80 columns is sent by a command, line ends as it writes them."""
    leader, follower = pty.openpty()
    child = subprocess.Popen(
        ["robodyn", *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=follower,
        stderr=follower,
        cwd=ROOT,
        env={**os.environ, "COLUMNS": "80", "LINES": "24", "PATH": path_with_it(), **more},
    )
    os.close(follower)
    all_of_it = b""
    try:
        while piece := os.read(leader, 65536):
            all_of_it += piece
    except OSError:
        pass  # how Linux tells that the other side of a terminal is closed
    os.close(leader)
    child.wait(60)
    return all_of_it.decode(errors="surrogateescape").replace("\r\n", "\n")


def check_harmless(text: str) -> None:
    """Only whole lines of characters that are printed."""
    assert all(line.isprintable() for line in text.split("\n")), repr(text)


@pytest.fixture
def evil(tmp_path: Path) -> Path:
    path = tmp_path / "evil.yaml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Rows whose header and fields hold controls."""
    path = tmp_path / "rows.csv"
    path.write_text(f"q1,q2,{EVIL}\n0,0.1,{EVIL}\n0.1,0.2,x\x1b[2J\x7f\n")
    return path


@each("line", [
    "check SCENE", "check SCENE --format json", "terms SCENE --q 0,0", "assemble SCENE --q 0,0",
    "torque SCENE TABLE", "torque SCENE TABLE --format csv", "torque SCENE TABLE --format json",
    "equations SCENE", "equations SCENE --format python", "export SCENE --format urdf -o -",
])  # fmt: skip
def test_names_and_fields_are_shown_escaped(line: str, evil: Path, table: Path) -> None:
    paths = {"SCENE": evil, "TABLE": table}
    shown = on_terminal(*(paths.get(word, word) for word in line.split()))
    assert "Error" not in shown, shown
    check_harmless(shown)


def test_a_table_shows_what_it_escapes(evil: Path, table: Path) -> None:
    assert SHOWN in on_terminal("check", evil)
    assert on_terminal("torque", evil, table).count(SHOWN) == 2
    assert on_terminal("torque", evil, table, "--format", "csv").count(SHOWN) == 2


def test_columns_of_a_chart_are_shown_escaped(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    path.write_text(f"t,{EVIL},\x1b[1mb,w\n0,1,0,\x1b[2J\n1,2,1,\x1b[3J\n2,3,2,\n")
    chart = on_terminal("plot", path, "--y", f"{EVIL},\x1b[1mb")
    assert r"\x1b]0;owned\x07" in chart
    check_harmless(chart)


@each("words", [
    ["torque", "no\x1b[2Jfile.yaml", "--q", "0,0"],
    ["torque", "robots/2r.yaml", "--q", "0,\x1b[2J"],
    ["torque", "robots/2r.yaml", "--q", "0,0", "-o", "/no\x1b[2J/file"],
    ["torque", "robots/2r.yaml", "--no\x1b[2Jsuch", "0"],
    ["no\x1b[2Jsuch"],
    ["simulate", "robots/2r.yaml", "--q", "0,0", "--time", "\x1b[2J"],
    ["simulate", "robots/2r.yaml", "--q", "0,0", "--tau", "'\x1b[2J',0"],
    ["sweep", "robots/2r.yaml", "--vary", "\x1b[2J=1:2:3"],
    ["animate", "robots/2r.yaml", "-", "-o", "a\x1b[2J"],
    ["plot", "no\x1b[2Jfile.csv"],
    ["draw", "robots/2r.yaml", "--size", "\x1b[2J"],
    ["export", "robots/2r.yaml", "--format", "\x1b[2J"],
    ["init", "\x1b[2J"],
])  # fmt: skip
def test_errors_are_shown_escaped(words: list[str]) -> None:
    shown = on_terminal(*words)
    assert "Error" in shown
    assert r"\x1b[2J" in shown
    check_harmless(shown)


def test_styles_of_our_own_stay(evil: Path, table: Path) -> None:
    """Titles in bold and curves in colours, with the names between them escaped."""
    assert "\x1b[1m" in sent("check", evil)
    assert "\x1b[34m" in sent("plot", table, "--y", "q2")
    assert "\x1b[34m" not in sent("plot", table, "--y", "q2", NO_COLOR="1")


def test_files_and_pipes_take_what_there_is(robodyn: Run, evil: Path, table: Path) -> None:
    assert robodyn("torque", evil, table, "--format", "csv").out.count(EVIL) == 2
    assert "\x1b[2J\x7f" in robodyn("torque", evil, table, "--format", "table").out
    assert "\x1b[8m" in robodyn("check", evil, "--format", "table").out


# Figures

NAMES = [
    *(r"$\frac{$", "$x$", "a$b", r"\$", "a\x1b[2Jb", "a\nb", "x" * 5000, "]]>--<&"),
    *("\u65e5\u672c", "%d {0}", "^{_{", "[red]x[/red]", "\u202eabc", "\U0001f600", "e\u0301", "\\"),
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
@pytest.mark.filterwarnings("ignore:Glyph")
def test_names_of_all_kinds_in_figures(robodyn: Run, tmp_path: Path, name: str) -> None:
    """A figure is drawn, and as XML is whole; no name is taken for mathematics or left out."""
    scene, rows, out = tmp_path / "s.yaml", tmp_path / "rows.csv", tmp_path / "x.svg"
    text = json.dumps(name, ensure_ascii=False)
    links = ", ".join(f"{{name: {x}, m: 1, l: 1, r: 0.5, I: 0.1}}" for x in (text, "b"))
    scene.write_text(f"name: {text}\nlinks: [{links}]\n")
    column = '"' + name.replace('"', '""') + '"'
    rows.write_text(f"t,{column},c\n0,1,{column}\n1,2,b\n")
    draw = ("draw", scene, "--q", "0,1", "--labels", "names")
    along = ("plot", rows, "--y", name)
    robodyn(*along, "-o", tmp_path / "x.txt").succeeds()
    for line in (draw, along, (*along, "--x", "t", "--colour", "c")):
        robodyn(*line, "-o", out).succeeds()
        minidom.parse(str(out))


@pytest.mark.filterwarnings("ignore:Glyph")
def test_a_figure_writes_a_name_as_it_stands(robodyn: Run, tmp_path: Path) -> None:
    """Matplotlib leaves the text of each label in the file, as a comment or a formula's parts."""
    rows, out = tmp_path / "rows.csv", tmp_path / "x.svg"
    rows.write_text("t," + ",".join(f"$x_{k}$,_n{k}" for k in range(20)) + "\n")
    rows.write_text(rows.read_text() + "0" + ",1" * 40 + "\n1" + ",2" * 40 + "\n")
    robodyn("plot", rows, "--y", "$*,_*", "-o", out).succeeds()
    drawn = out.read_text()
    for k in range(20):
        assert f"<!-- $x_{k}$ -->" in drawn
        assert f"<!-- _n{k} -->" in drawn


@pytest.mark.parametrize("where", [{"COLUMNS": "1000000"}, {"LINES": "1000000"}])
def test_an_endless_terminal(quick_shell: Run, where: dict[str, str]) -> None:
    line = "plot - < <(echo t,q1; echo 0,1; echo 1,2)"
    drawn = quick_shell(f"robodyn {line} --format text", env=where).succeeds().out
    assert max(map(len, drawn.splitlines())) < 2_500
