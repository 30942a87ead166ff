"""Nothing that a command writes takes the place of what it reads, or of what else it writes."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer
from conftest import ROOT, Outcome
from named_case import case

from robodyn import cli

Run = Callable[..., Outcome]
ARM = (ROOT / "robots/2r.yaml").read_text()
NO_FILES = ("force", "names", "poses", "read")  # options that speak of files
OTHERS = {"trajectory": ["--time", "1"], "sweep": ["--vary", "q1=0,1"]}
OTHERS["fit"] = ["--vary", "gravity=1:2"]


def declared(command: str) -> list[tuple[Any, str]]:
    """The options and arguments of a command, and what it does with the files that they name."""
    roles = {"reads": "reads", "writes": "writes"}
    group: Any = typer.main.get_command(cli._application([command]))
    params = group.commands[command].params
    called = [getattr(param.callback, "__wrapped__", None) for param in params]
    names = [getattr(function, "__name__", "") for function in called]
    return [(param, roles.get(name, "")) for param, name in zip(params, names, strict=True)]


def clashes(command: str) -> list[tuple[Any, Any]]:
    """Each output of a command beside each of its inputs and further outputs."""
    named = [(param, role) for param, role in declared(command) if role]
    return [
        (first, second)
        for (first, one), (second, other) in itertools.combinations(named, 2)
        if "writes" in (one, other)
    ]


def words(param: Any, name: object) -> list[object]:
    return [param.opts[0], name] if param.opts[0].startswith("-") else [name]


def test_every_option_that_names_a_file_says_what_is_done_with_it() -> None:
    for command in cli.COMMANDS:
        with case(command):
            for param, role in declared(command):
                text = f"{param.metavar} {getattr(param, 'help', '')}"
                looks = any(
                    word in text for word in ("FILE", "CSV", "MODEL", "STATES", "PATH", "Write ")
                )
                if param.name not in NO_FILES:
                    assert bool(role) == looks, param.name
                if param.name in ("model", "out"):
                    assert role == {"model": "reads", "out": "writes"}[param.name]


def test_the_walk_finds_what_is_there() -> None:
    found = {(c, a.name, b.name) for c in cli.COMMANDS for a, b in clashes(c)}
    assert len(found) > 30
    for known in (
        *("simulate model report", "simulate control_model out", "simulate track out"),
        *("simulate tau_from out", "simulate report out", "trajectory via out"),
        *("plot files out", "draw model out", "draw states out", "animate states out"),
        *("bench plot out", "sweep model out", "export model out", "torque out states"),
    ):
        assert tuple(known.split()) in found


@pytest.mark.parametrize("kind", ["name", "detour", "symbolic link", "hard link"])
@pytest.mark.parametrize("command", cli.COMMANDS)
@pytest.mark.thinned
def test_no_two_name_one_file(robodyn: Run, tmp_path: Path, command: str, kind: str) -> None:
    path, alias = tmp_path / "one.html", tmp_path / "two.html"
    path.write_text(ARM)
    if kind == "name":
        alias = path
    elif kind == "detour":
        (tmp_path / "folder").mkdir()
        alias = tmp_path / "folder" / ".." / "one.html"
    elif kind == "symbolic link":
        alias.symlink_to(path)
    else:
        os.link(path, alias)
    before = sorted(tmp_path.iterdir())
    for first, second in clashes(command):
        for one, other in ((path, alias), (alias, path)):
            given = [*words(first, one), *words(second, other), *OTHERS.get(command, [])]
            if command not in ("plot", "summary") and first.name != "model":
                given = ["robots/2r.yaml", *given]
            robodyn(command, *given).fails(2, "would write over", str(one), str(other))
            assert path.read_text() == ARM
            assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("end", [".partial", ".partial.json", ".partial.sums"])
@pytest.mark.parametrize("command", ["sweep", "simulate"])
def test_what_is_kept_beside_an_output_is_no_input_either(
    robodyn: Run, tmp_path: Path, command: str, end: str
) -> None:
    """A sweep refuses the file by name; a run that fails takes another name."""
    path, link = tmp_path / f"out.csv{end}", tmp_path / "scene.yaml"
    path.write_text(ARM)
    link.symlink_to(path)
    before = sorted(tmp_path.iterdir())
    for model in (path, link):
        if command == "sweep":
            refused = robodyn("sweep", model, "--vary", "q1=0,1", "-o", tmp_path / "out.csv")
            refused.fails(2, str(path), "is not of this sweep", "remove or rename it")
            assert sorted(tmp_path.iterdir()) == before
        else:
            failing = ("--q", "0,0", "--max-evals", "300", "-o", tmp_path / "out.csv")
            assert robodyn("simulate", model, *failing).code == 1
            kept = set(tmp_path.iterdir()) - set(before)
            assert [name.read_text()[:2] for name in kept] == ["t,"]
            for name in kept:
                name.unlink()
        assert path.read_text() == ARM


TABLED = """gravity: 9.81
links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}, {name: b, m: 1, l: 1, r: 0.5, I: 0.1}]
springs: [{joint: a, table: tab.csv, angle: 0}]
loads: [{link: b, torque: {table: folder/push.csv, over: t, column: T}}]
"""
WITH_TABLES = [
    *("torque SCENE --q 0,0 -o OUT", "torque SCENE --q 0,0 --set gravity=3 -o OUT"),
    *("simulate SCENE --q 0,0 -o OUT", "simulate SCENE --q 0,0 --report OUT"),
    "simulate SCENE --q 0,0 --event a=qd1 --events OUT",
    "simulate robots/2r.yaml --q 0,0 --control pd --hold 0,0 --kp 1 --kd 1 --control-model SCENE "
    "-o OUT",
    *("sweep SCENE --vary q1=0,1 -o OUT", "sweep SCENE --vary links.b.m=1,2 -o OUT"),
    *("fit SCENE --vary gravity=1:9 --match ROWS -o OUT", "identify SCENE ROWS -o OUT"),
    *("identify SCENE ROWS --residuals OUT", "linearize SCENE --q 0,0 --lqr --gain-out OUT"),
    *("check SCENE -o OUT", "equations SCENE -o OUT", "export SCENE --format mjcf -o OUT"),
]


@pytest.mark.parametrize("line", WITH_TABLES)
def test_no_output_is_a_table_of_the_scene(robodyn: Run, tmp_path: Path, line: str) -> None:
    scene, link = tmp_path / "scene.yaml", tmp_path / "link.csv"
    (tmp_path / "folder").mkdir()
    table, push = tmp_path / "tab.csv", tmp_path / "folder" / "push.csv"
    scene.write_text(TABLED)
    table.write_text("x,F\n-9,-90\n9,90\n")
    push.write_text("t,T\n0,1\n20,2\n")
    (tmp_path / "rows.csv").write_text("q1,q2\n0,0\n")
    link.symlink_to(push)
    before = sorted(tmp_path.rglob("*"))
    line = line.replace("SCENE", str(scene)).replace("ROWS", str(tmp_path / "rows.csv"))
    for out, place in (
        (table, "springs[0].table"),
        (f"{tmp_path}/folder/../tab.csv", "springs[0].table"),
        *((push, "loads[0].torque"), (link, "loads[0].torque")),
    ):
        refused = robodyn(*line.replace("OUT", str(out)).split())
        refused.fails(2, str(out), f"would write over {place}", "name another file")
        assert table.read_text() == "x,F\n-9,-90\n9,90\n"
        assert push.read_text() == "t,T\n0,1\n20,2\n"
        assert sorted(tmp_path.rglob("*")) == before


def test_streams_are_files_too(robodyn: Run, quick_shell: Run, tmp_path: Path) -> None:
    rows = tmp_path / "rows.csv"
    rows.write_text("q1,q2\n1,2\n")
    torque = "robodyn torque robots/2r.yaml"
    for line in (
        f"{torque} - -o {rows} <{rows}",
        f"{torque} {rows} >>{rows}",
        f"{torque} - <{rows} >>{rows}",
        f"robodyn simulate robots/2r.yaml --q 0,0 --report {rows} >>{rows}",
    ):
        quick_shell(line).fails(2, "would write over")
        assert rows.read_text() == "q1,q2\n1,2\n"
    quick_shell(f"{torque} - <{rows} | {torque} - -o {rows}.new").replaces()
    given = robodyn("simulate", "robots/2r.yaml", "--q", "0,0", "--report", "-")
    given.fails(2, "would write over")


def test_a_device_takes_all(robodyn: Run) -> None:
    run = ("simulate", "robots/2r.yaml", "--q", "0,0", "--time", "0.1", "--quiet")
    robodyn(*run, "--report", os.devnull, "-o", os.devnull).succeeds()


def test_rows_that_a_failed_run_kept_can_be_read(robodyn: Run, tmp_path: Path) -> None:
    rows = tmp_path / "run.csv.partial"
    rows.write_text("q1,q2\n1,2\n")
    robodyn("torque", "robots/2r.yaml", rows, "-o", tmp_path / "run.csv").succeeds()


def test_an_empty_name_is_a_usage_error(robodyn: Run) -> None:
    for command in cli.COMMANDS:
        with case(command):
            for param, role in declared(command):
                if role:
                    own = param.name in ("model", "files") or command == "summary"
                    given = [] if own else ["robots/2r.yaml"]
                    shown = robodyn(command, *given, *words(param, "")).err
                    assert "is empty: name a file" in shown, param.name


LOG = ("t", "q1", "q2", "qd1", "qd2", "qdd1", "qdd2", "tau1", "tau2")
READERS = {
    "identify": ("2r", "{}"),
    "regressor": ("2r", "{}", "--condition"),
    "fit": ("2r", "--match", "{}", "--vary", "links.forearm.m=0.5:1.5", "--starts", "1", "--quiet"),
    "draw": ("2r", "{}", "-o", "-", "--format", "svg"),
    "simulate": ("2r", "--q", "0,0", "--tau-from", "{}", "--time", "0.1", "--quiet"),
    "sweep": (
        *("2r", "--vary", "links.forearm.m=1,2", "--kind", "torque", "--track", "{}"),
        *("--result", "max(tau1)", "--quiet"),
    ),
    "trajectory": ("2r", "--via", "{}", "--points", "5"),
    "summary": ("{}",),
    "energy": ("2r", "{}", "--columns", "KE,PE"),
}


@pytest.mark.parametrize("command", READERS)
def test_every_reader_takes_names_of_its_own(robodyn, tmp_path, command) -> None:
    given = ("--q", "0,0.5", "--tau", "sin(t),1", "--time", "1", "--points", "41", "--quiet")
    rows = robodyn("simulate", "2r", *given).succeeds().out
    rows = "\n".join(",".join(line.split(",")[:9]) for line in rows.splitlines()) + "\n"
    own, foreign = tmp_path / "own.csv", tmp_path / "foreign.csv"
    own.write_text(rows)
    names = [f"c{k}" for k in range(len(LOG))]
    foreign.write_text(",".join(names) + rows[rows.index("\n") :])
    read = ",".join(f"{new}={old}" for new, old in zip(LOG, names, strict=True))

    def result(path, *more: str):
        found = robodyn(command, *(x.format(path) for x in READERS[command]), *more)
        assert found.code == 0, found.err
        return found.out

    assert result(foreign, "--read", read) == result(own)
