"""`robodyn init`, `robodyn schema`, and completion by the shell."""

from __future__ import annotations

import json
import os
import pty
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import ROOT, Outcome

from robodyn import cli
from robodyn.scene import example_scenes
from robodyn.scene.description import read
from robodyn.scene.scene_schema import scene_schema

Run = Callable[..., Outcome]
SCENES = sorted(path.stem for path in ROOT.glob("robots/*.yaml"))


@pytest.mark.parametrize("options", [(), ("--list",)])
def test_the_list_holds_all_scenes(robodyn: Run, options: tuple[str, ...]) -> None:
    given = robodyn("init", *options).succeeds()
    assert [row["name"] for row in given.rows] == SCENES
    assert all(len(row["scene"]) > 20 and row["scene"].endswith(".") for row in given.rows)
    assert robodyn("init", "--format", "json").json == given.rows


@pytest.mark.parametrize("name", SCENES)
def test_the_scene_is_the_file_of_robots(robodyn: Run, tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{name}.yaml"
    given = robodyn("init", name, "-o", path)
    assert (given.code, given.out) == (0, "")
    assert path.read_bytes() == (ROOT / "robots" / f"{name}.yaml").read_bytes()
    tables = [x.name for x in (ROOT / "robots").glob(f"{name}.csv")]
    assert [x.name for x in tmp_path.glob("*.csv")] == tables
    read(path)
    told = given.err.partition("try: robodyn ")[2]
    assert robodyn(*shlex.split(told)).code == 0


def test_by_default_it_is_written_here(shell: Run, tmp_path: Path) -> None:
    given = shell("python -m robodyn init 2r", cwd=tmp_path, env={"PYTHONPATH": str(ROOT)})
    assert (given.code, given.out) == (0, "")
    assert given.err.startswith("wrote 2r.yaml; try: robodyn terms 2r.yaml --q 30deg,45deg")
    assert [path.name for path in tmp_path.iterdir()] == ["2r.yaml"]


def test_to_stdout(robodyn: Run) -> None:
    given = robodyn("init", "pendulum", "-o", "-").succeeds()
    assert given.out == (ROOT / "robots/pendulum.yaml").read_text()


def test_an_existing_file_is_kept(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("precious")
    robodyn("init", "2r", "-o", path).fails(2, str(path), "exists already", "--force")
    assert path.read_text() == "precious"
    assert robodyn("init", "2r", "-o", path, "--force").code == 0
    assert path.read_text() == (ROOT / "robots/2r.yaml").read_text()


def test_an_installation_without_scenes_says_so(
    robodyn: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    places = (tmp_path / "a", tmp_path / "b")
    monkeypatch.setattr(example_scenes, "_PLACES", places)
    robodyn("init").fails(2, "example scenes are missing", str(places[0]))


def test_an_installed_package_has_the_scenes_inside(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "x.yaml").write_text("# One link.\n# try: --q 1\n")
    monkeypatch.setattr(example_scenes, "_PLACES", (tmp_path, ROOT / "robots"))
    assert example_scenes.scene_names() == ["x"]
    text = example_scenes.scene_text("x")
    assert (example_scenes.summary(text), example_scenes.example_options(text)) == (
        *("One link.", "--q 1"),
    )


def test_the_package_takes_its_scenes_from_robots() -> None:
    import tomllib

    tool = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert tool["package-dir"] == {"robodyn.robots": "robots"}
    assert "robodyn.robots" in tool["packages"]
    assert tool["package-data"]["robodyn.robots"] == ["*.yaml", "*.csv"]
    assert example_scenes._PLACES[0] == ROOT / "robodyn" / "robots"


# The schema


def test_schema(robodyn: Run, tmp_path: Path) -> None:
    given = robodyn("schema").succeeds()
    assert given.json == scene_schema()
    assert "m/s²" in given.out
    robodyn("schema", "-o", tmp_path / "x.json").succeeds()
    assert json.loads((tmp_path / "x.json").read_text()) == scene_schema()


# Completion


def completed(quick_shell: Run, words: str) -> list[str]:
    """What bash is offered after these words, the last of them to be completed."""
    count = len(words.split(" ")) - 1
    environment = {
        "_ROBODYN_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(count),
    }
    return quick_shell("robodyn", env=environment).succeeds().out.split()


def test_completion_lists_the_commands(quick_shell: Run) -> None:
    assert completed(quick_shell, "robodyn ") == list(cli.COMMANDS)
    assert completed(quick_shell, "robodyn an") == ["animate"]


def test_completion_lists_options_and_scenes(quick_shell: Run) -> None:
    assert {"--labels", "--forces", "--q"} <= set(completed(quick_shell, "robodyn draw --"))
    assert completed(quick_shell, "robodyn init f") == ["five-bar", "four-bar"]


def test_completion_says_nothing_on_stderr_of_a_terminal() -> None:
    """What a completion writes there stands in the line that is being typed."""
    leader, terminal = pty.openpty()
    asked = {"COMP_WORDS": "robodyn torque 2r --f", "COMP_CWORD": "3"}
    environment = {**os.environ, "_ROBODYN_COMPLETE": "complete_bash", **asked}
    line = [sys.executable, "-m", "robodyn"]
    streams = {"stdin": terminal, "stdout": subprocess.PIPE, "stderr": terminal}
    try:
        given = subprocess.run(line, **streams, env=environment, cwd=ROOT)
        os.write(terminal, b"end")
        assert os.read(leader, 1000) == b"end"
    finally:
        os.close(leader)
        os.close(terminal)
    assert given.stdout.split() == [b"--format", b"--force", b"--fluctuation"]


@pytest.mark.parametrize(
    ("name", "part"),
    [("bash", "complete -o default"), ("zsh", "#compdef"), ("fish", "complete --command robodyn")],
)
def test_the_script_of_each_shell(tmp_path: Path, name: str, part: str) -> None:
    """The shell is the one that started the command: here bash, by the name of each."""
    shell = tmp_path / name
    shell.symlink_to(shutil.which("bash") or "")
    command = f"{shlex.quote(sys.executable)} -m robodyn --show-completion; exit $?"
    given = subprocess.run([shell, "-c", command], capture_output=True, text=True, cwd=ROOT)
    assert given.returncode == 0, given.stderr
    assert "_ROBODYN_COMPLETE" in given.stdout
    assert part in given.stdout


def test_bash_itself_completes(shell: Run) -> None:
    """The script as a shell has it at a prompt."""
    line = 'eval "$(robodyn --show-completion)"; COMP_WORDS=(robodyn sim); COMP_CWORD=1; '
    line += '_robodyn_completion robodyn; echo "${COMPREPLY[@]}"'
    assert shell(line).succeeds().out == "simulate\n"
