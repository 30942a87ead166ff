"""The README and the guide are true: what they show runs, and nothing is left out."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

import robodyn
from robodyn.cli import COMMANDS
from robodyn.scene.grammar import FORMS

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = sorted((ROOT / "robodyn" / "guide").glob("*.md"))
GUIDE = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
RELATIVE = 1e-9  # a last digit may differ from machine to machine
ABSOLUTE = 1e-12  # so may what is zero but for rounding


class Example(NamedTuple):
    """A command and what it prints."""

    command: str
    output: str


def blocks(*languages: str) -> list[str]:
    """The texts of the fenced blocks in these languages."""
    fences = re.findall(r"^```(\w*)\n(.*?)^```$", README + GUIDE, re.MULTILINE | re.DOTALL)
    return [text for language, text in fences if language in languages]


def example_blocks() -> list[list[Example]]:
    """The commands of each console block, each with the output below it."""
    found = []
    for block in blocks("console", "sh"):
        found.append([])
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            lines = part.splitlines(keepends=True)
            end = next(k for k, line in enumerate(lines) if not line.endswith("\\\n")) + 1
            found[-1].append(Example("".join(lines[:end]), "".join(lines[end:])))
    return found


def examples() -> list[Example]:
    """All of them."""
    return [example for block in example_blocks() for example in block]


def section(title: str) -> str:
    """The text of one section of the README."""
    return README.split(f"\n## {title}\n")[1].split("\n## ")[0]


def assert_same(shown: str, real: str) -> None:
    """Equal texts, with numbers that are equal but for rounding."""
    assert NUMBER.sub("#", shown) == NUMBER.sub("#", real), f"the real output is\n{real}"
    for old, new in zip(NUMBER.findall(shown), NUMBER.findall(real), strict=True):
        close = math.isclose(float(old), float(new), rel_tol=RELATIVE, abs_tol=ABSOLUTE)
        assert close, f"{old} is shown, {new} is real, in\n{real}"


def plain_lines() -> list[str]:
    """The lines of the blocks that are not run."""
    return [line.partition("#")[0].strip() for text in blocks("") for line in text.splitlines()]


@pytest.mark.parametrize("block", example_blocks(), ids=lambda block: block[0].command.strip())
def test_examples_run_and_print_what_is_shown(block: list[Example], tmp_path: Path) -> None:
    """A block in a directory of its own, where the files that it writes meet no other's."""
    (tmp_path / "robots").symlink_to(ROOT / "robots")
    for example in block:
        _check(example, tmp_path)


def _check(example: Example, directory: Path) -> None:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", example.command],
        cwd=directory,
        env=os.environ | {"PATH": path, "LC_ALL": "C.UTF-8"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        timeout=120,
    )
    assert done.returncode == 0, done.stdout
    assert_same(example.output, done.stdout)


@pytest.mark.parametrize("block", blocks("python"), ids=lambda block: block.splitlines()[0])
def test_python_runs_and_prints_what_its_comments_say(
    block: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    exec(compile(block, "README.md", "exec", dont_inherit=True), {})
    shown = re.findall(r"^print\(.*\)  # (.*\n)", block, re.MULTILINE)
    assert block.count("print(") == len(shown)
    assert_same("".join(shown), capsys.readouterr().out)


def test_scenes_are_accepted(tmp_path: Path) -> None:
    scenes = blocks("yaml")
    assert scenes
    for k, text in enumerate(scenes):
        scene = tmp_path / f"{k}.yaml"
        scene.write_text(text, encoding="utf-8")
        robodyn.load(scene)


def test_there_are_examples_of_every_kind() -> None:
    commands = [example.command for example in examples()]
    assert len(commands) >= 5
    assert blocks("python")
    assert any("| head" in command for command in commands)


@pytest.mark.parametrize("name", COMMANDS)
def test_command_is_documented_and_shown(name: str) -> None:
    assert f"`robodyn {name} " in section("Commands")
    assert any(f"robodyn {name} " in example.command for example in examples())


@pytest.mark.parametrize("name", sorted(robodyn._ROOM_OF))
def test_public_name_is_documented(name: str) -> None:
    assert re.search(rf"`{name}\b", section("Python"))


@pytest.mark.parametrize("key", sorted({key for form in FORMS.values() for key in form.keys}))
def test_scene_key_is_documented(key: str) -> None:
    assert f"`{key}`" in section("Scene format")


def test_make_targets_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = [line.split()[1] for line in plain_lines() if line.startswith("make ")]
    assert {"demo", "test", "bench"} <= set(targets)
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE)


def test_install_line_names_this_package() -> None:
    assert "pip install ." in plain_lines()
    assert (ROOT / "pyproject.toml").exists()


def test_lines_are_not_too_long() -> None:
    lines = README.splitlines() + GUIDE.splitlines()
    assert [line for line in lines if len(line) > 100] == []
