"""Manners of the command line: its help, what it imports, scenes by name."""

from __future__ import annotations

import inspect
import io
import os
import pty
import re
import shlex
import subprocess
import sys
import textwrap
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import typer
from conftest import ROOT, Outcome
from each_case import each
from named_case import case

from robodyn import cli
from robodyn.scene.example_scenes import example_file
from robodyn.tables.csv_fields import Delimited

Run = Callable[..., Outcome]


def function_of(command: str) -> Any:
    return getattr(import_module(f"robodyn.cli.{command}"), command)


def test_the_summaries_are_those_of_the_docstrings() -> None:
    for name in cli.COMMANDS:
        told = inspect.getdoc(function_of(name)) or ""
        assert cli.first_line(name) == told.split("\n\n")[0], name


def test_the_list_of_commands_is_grouped_and_whole(robodyn: Run) -> None:
    out = robodyn("--help").succeeds().out
    assert "..." not in out.partition("States:")[2]
    shown = out.partition("States:")[2]
    for name in cli.COMMANDS:
        words = r"\s+".join(map(re.escape, cli.first_line(name).split()))
        assert re.search(rf"^  {name} +{words}$", shown, re.M)
    headings = re.findall(r"^(\w+):$", out, re.M)
    assert headings == ["Options", *cli.GROUPS]


@each("name", cli.COMMANDS)
def test_every_option_stands_once_under_its_heading(robodyn: Run, name: str) -> None:
    out = robodyn(name, "--help").succeeds().out
    options: dict[str, list[str]] = {}
    for heading, body in re.findall(r"^(\w[^\n:]*):\n((?:  .*\n|\n(?=  ))+)", out, re.M):
        options[heading] = re.findall(r"^  (?:-\w, )?(--[\w-]+)", body, re.M)
    told = [flag for heading in options for flag in options[heading]]
    group: Any = typer.main.get_command(cli._application([name]))
    known = [
        p.opts[0]
        for p in group.commands[name].params
        if p.param_type_name == "option" and not p.hidden
    ]
    assert sorted(told) == sorted([*known, "--help"])
    if name in ("simulate", "sweep", "trajectory"):
        assert set(options["Options"]) <= {"--set", "--help"}
        assert list(options)[-1] == "Output"
    if name == "simulate":
        wanted = ["Arguments", "Options", "Start", "Torques", "Control", "Integration", "Output"]
        assert list(options) == wanted


def test_the_help_on_a_terminal_is_whole_and_flows(
    robodyn: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Brackets stay; paragraphs break where the terminal ends, and the examples' lines nowhere."""
    monkeypatch.setenv("COLUMNS", "80")
    for name in cli.COMMANDS:
        with case(name), monkeypatch.context() as patch:
            patch.setattr(type(sys.stdout), "isatty", lambda _: True)
            out = re.sub(r"\x1b\[[\d;]*m", "", robodyn(name, "--help").succeeds().out)
            told = {line.strip() for line in out.partition("─ Arguments")[0].splitlines()}
            for paragraph in (inspect.getdoc(function_of(name)) or "").split("\n\n"):
                lines = [line.strip() for line in paragraph.splitlines()[1:]]
                if not paragraph.startswith("\b"):
                    lines = textwrap.wrap(" ".join(paragraph.split()), 78, break_on_hyphens=False)
                assert {*lines} <= told


def imported(*words: str) -> set[str]:
    line = [sys.executable, "-X", "importtime", "-m", "robodyn", *words]
    told = subprocess.run(line, capture_output=True, text=True).stderr
    return set(re.findall(r"\| +([\w.]+)$", told, re.M))


@pytest.mark.parametrize("words", [["--version"], [], ["--help"]])
def test_nothing_is_imported_that_is_not_shown(words: list[str]) -> None:
    found = imported(*words)
    assert "robodyn.cli" in found
    assert not {"numpy", "yaml", "rich", "scipy", "robodyn.scene"} & found
    assert not {f"robodyn.cli.{name}" for name in cli.COMMANDS} & found


# Scenes by name


@pytest.fixture
def elsewhere(robodyn: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder that is the working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_bare_word_is_the_example_of_this_name(robodyn: Run, elsewhere: Path) -> None:
    by_file = robodyn("torque", ROOT / "robots/2r.yaml", "--q", "1,2").succeeds()
    named = robodyn("torque", "2r", "--q", "1,2")
    assert (named.code, named.out, named.err) == (0, by_file.out, "")
    changed = ["--set", "links.forearm.m=1.1"]
    assert robodyn("torque", "2r", "--q", "1,2", *changed).out != by_file.out
    believed = ["--hold", "0,0", "--control", "pd+g", "--kp", "9", "--kd", "1"]
    believed += ["--control-model", "3r"]
    robodyn("simulate", "2r", "--q", "1,2", *believed).fails(2, "3")


def test_only_the_first_command_of_a_pipe_on_a_terminal_notes_that_an_example_is_taken() -> None:
    """In a pipe at a prompt each command has the terminal's stderr, and one its stdin."""
    leader, terminal = pty.openpty()
    command = [sys.executable, "-m", "robodyn", "torque", "2r", "--q", "1,2"]
    try:
        for stdin in (terminal, subprocess.DEVNULL):
            subprocess.run(command, stdin=stdin, stdout=subprocess.DEVNULL, stderr=terminal)
        os.write(terminal, b"end")
        shown = ""
        while not shown.endswith("end"):
            shown += os.read(leader, 1000).decode()
    finally:
        os.close(leader)
        os.close(terminal)
    assert shown == "Note: 2r is no file: the example scene of this name is taken\r\nend"


def test_a_file_of_this_name_goes_first(robodyn: Run, elsewhere: Path) -> None:
    (elsewhere / "2r").write_text("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n")
    given = robodyn("torque", "2r", "--q", "0").succeeds()
    assert (list(given.rows[0]), given.err) == (["tau1"], "")
    (elsewhere / "pendulum").symlink_to(elsewhere / "gone")
    robodyn("torque", "pendulum", "--q", "0").fails(2, "no such file")


def help_examples() -> list[tuple[str, str]]:
    """Each command line of the help's examples, and the command whose help has it."""
    found = []
    for name, function in [(x, function_of(x)) for x in cli.COMMANDS] + [("", cli._root)]:
        examples = (inspect.getdoc(function) or "").partition("Examples:\n")[2]
        lines = examples.replace("\\\n", " ").splitlines()
        found += [(name, line.strip()) for line in lines if line.strip()]
    return found


@pytest.mark.parametrize(("name", "line"), help_examples())
def test_an_example_of_the_help_goes_without_a_file_of_this_project(name: str, line: str) -> None:
    calls: list[list[str]] = [[]]
    for word in shlex.split(line):
        if word in "|<>":
            calls.append([])
        calls[-1].append(word)
    ours = [call[call.index("robodyn") + 1 :] for call in calls if "robodyn" in call]
    assert ours
    for command, *rest in ours:
        group = cli._command([command], False)
        with group.commands[command].make_context(command, rest) as context:
            model = context.params.get("model")
            assert model is None or example_file(Path(model).stem)


# Delimiters

ROWS = 't;q1;q2;note\r\n0;0,5;1;a, b\r\n0,1;6e-1;-,25;"say ""x;y"""\r\n'
PLAIN = 't,q1,q2,note\r\n0,0.5,1,"a, b"\r\n0.1,6e-1,-.25,"say ""x;y"""\r\n'


@pytest.mark.parametrize("piece", [1, 5, 1 << 17])
def test_rows_with_semicolons_and_decimal_commas(piece: int) -> None:
    assert translated(ROWS, ";", piece) == PLAIN
    assert translated(ROWS[:-2], ";", piece) == PLAIN[:-2]
    lines = "x;y\n" + "".join(f"{k};{k},25\n" for k in range(300))
    wanted = "x,y\n" + "".join(f"{k},{k}.25\n" for k in range(300))
    assert translated(lines, ";", piece) == wanted
    assert translated('a;b\n"1\n;2";"3,5"\n', ";", piece) == 'a,b\n"1\n;2",3.5\n'
    assert translated("a\tb\n1.5\t2,5\n", "\t", piece) == "a,b\n1.5,2.5\n"
    assert translated("a\tb\n1,5\tx,y\n", "\t", piece) == 'a,b\n1.5,"x,y"\n'
    assert translated("a,b;c,d\n1;2,3,4\n", ",", piece) == "a,b;c,d\n1;2,3,4\n"
    assert translated('"a;b;c",d\n1,2\n', ",", piece) == '"a;b;c",d\n1,2\n'


def translated(text: str, mark: str, piece: int) -> str:
    class Slow(io.BytesIO):
        def read1(self, size: int | None = -1) -> bytes:
            return self.read(piece)

    stream = Delimited(Slow(text.encode()))
    found = b"".join(iter(stream.read1, b"")).decode()
    assert stream._mark == mark.encode()
    return found


LINES = [
    "torque robots/2r.yaml {}",
    "accel robots/2r.yaml {}",
    "reactions robots/2r.yaml {}",
    "points robots/2r.yaml {}",
    "energy robots/2r.yaml {}",
    "regressor robots/2r.yaml {}",
    "identify robots/2r.yaml {} --format json",
    "simulate robots/2r.yaml --q 0.1,0.2 --track {} --control pd --kp 9 --kd 1 --time 0.1",
    "simulate robots/2r.yaml --q 0.1,0.2 --tau-from {} --time 0.1",
    "trajectory robots/2r.yaml --via {} --profile cubic",
    "fit robots/2r.yaml --match {} --columns tau2 --vary links.forearm.m=0.5:1.5",
    "plot {} --y q1 --format text",
    "animate robots/2r.yaml {} -o {}.html",
    "draw robots/2r.yaml {} -o {}.svg",
]


@pytest.mark.parametrize("line", LINES)
def test_every_command_that_reads_rows_takes_semicolons(
    robodyn: Run, tmp_path: Path, line: str
) -> None:
    with_commas, other = tmp_path / "a.csv", tmp_path / "b.csv"
    move = "trajectory robots/2r.yaml --from 0.1,0.2 --to 0.5,0.6 --time 1 --points 21"
    states = robodyn(*move.split()).succeeds().out
    with_commas.write_text(robodyn("torque", "robots/2r.yaml", "-", stdin=states).succeeds().out)
    other.write_text(with_commas.read_text().replace(",", ";").replace(".", ","))
    told = []
    for file in (with_commas, other):
        command = robodyn(*line.format(file, tmp_path / "film").split())
        told.append((command.code, command.out, re.sub(r"[ab]\.csv|[\d.e-]+ s\n", "", command.err)))
    assert told[0] == told[1]
    assert told[0][0] == 0, told[0]


def test_a_tab_as_delimiter(robodyn: Run, tmp_path: Path) -> None:
    rows = tmp_path / "rows.csv"
    rows.write_text("q1\tq2\n1,5\t2\n")
    given = robodyn("torque", "robots/2r.yaml", rows)
    assert given.succeeds().out.startswith("q1,q2,tau1,tau2\n1.5,2,")


def test_an_unknown_key_gets_the_nearest_name(robodyn: Run, tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        "links:\n"
        "  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1, dampnig: 1, limits: [-1, 1]}\n"
        "  - {Name: b, m: 1, l: 1, R: 0.5, i: 0.1, theta: 1, FROM: a, lenght: 2}\n"
        "  - {name: d, m: 1, l: 1, r: 0.5, I: 0.1, limits: {Min: 0, mx: 1}}\n"
        "  - [0, 0, 1, 0]\n"
    )
    told = robodyn("check", scene)
    for key, way in {
        "dampnig": "did you mean damping?",
        "Name": "did you mean name?",
        "R": "did you mean r?",
        "i": "did you mean I?",
        "theta": "known: name, ",
        "FROM": "did you mean from?",
        "lenght": "known: ",
        "Min": "did you mean min?",
        "mx": "did you mean max?",
    }.items():
        line = next(
            x for x in told.err.splitlines() if re.search(rf"[ .]{key}: is an unknown key", x)
        )
        assert way in line, line
    told.fails(2, "limits = a list: must be a mapping with min, max", "must be a mapping with name")


def test_no_option_is_written_as_optional() -> None:
    for path in (ROOT / "robodyn").rglob("*.py"):
        assert not re.search(r"\bOptional\[", path.read_text(encoding="utf-8")), path


def test_memory_that_ends_is_told(shell):
    told = "the memory that this process may use is exhausted"
    line = "ulimit -v 60000; OPENBLAS_NUM_THREADS=1 robodyn simulate 2r --q 0,0 --time 1"
    shell(line).fails(1, told)
