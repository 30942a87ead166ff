"""The README and the guide are true: what they show runs, and nothing is left out."""

from __future__ import annotations

import math
import os
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
from documents import (
    DOCUMENTS,
    GUIDE,
    PAGES,
    README,
    ROOT,
    Example,
    blocks,
    example_blocks,
    scene_files,
)
from each_case import each
from quick_robodyn import path_with_it

import robodyn
from robodyn.cli import COMMANDS
from robodyn.scene.grammar import FORMS

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
RELATIVE = 1e-9  # a last digit may differ from machine to machine
ABSOLUTE = 1e-12  # so may what is zero but for rounding
# the series is machine code; a figure's file is matplotlib's
NEEDS_AN_EXTRA = re.compile(r"--method taylor|-o \S+\.(png|svg|pdf|gif|mp4)")
# which take minutes without machine code: two or more ranges of ten or more values
HUNDREDS_OF_MOTIONS = re.compile(r"(--vary \S+:\d\d+\s.*){2}", re.DOTALL)
COUNTS_THE_SERIES = "grep -c '^taylor,'"  # rows that the base installation does not measure


def examples() -> list[Example]:
    """The commands of all documents."""
    return [example for _, block in example_blocks() for example in block]


def assert_same(shown: str, real: str, relative: float = RELATIVE) -> None:
    """Equal texts, with numbers that are equal but for rounding."""
    assert NUMBER.sub("#", shown) == NUMBER.sub("#", real), f"the real output is\n{real}"
    for old, new in zip(NUMBER.findall(shown), NUMBER.findall(real), strict=True):
        close = math.isclose(float(old), float(new), rel_tol=relative, abs_tol=ABSOLUTE)
        assert close, f"{old} is shown, {new} is real, in\n{real}"


def plain_lines() -> list[str]:
    """The lines of the blocks that are not run."""
    return [line.partition("#")[0].strip() for _, text in blocks("") for line in text.splitlines()]


def labels(found: list[tuple[str, Any]]) -> list[str]:
    """Of blocks: the document and the number there."""
    names = [name for name, _ in found]
    return [f"{name}-{names[:k].count(name) + 1}" for k, name in enumerate(names)]


@pytest.mark.parametrize(("name", "block"), example_blocks(), ids=labels(example_blocks()))
def test_examples_run_and_print_what_is_shown(
    name: str, block: list[Example], tmp_path: Path
) -> None:
    """A block in a directory of its own, with the scenes that its page has the reader write."""
    (tmp_path / "robots").symlink_to(ROOT / "robots")
    for file, text in scene_files(name).items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    for example in block:
        done = _run(example.command, tmp_path)
        assert done.returncode == 0, done.stdout
        assert_same(example.output, done.stdout)


@pytest.mark.parametrize(("name", "block"), example_blocks(), ids=labels(example_blocks()))
def test_examples_run_without_the_extras(name: str, block: list[Example], tmp_path: Path) -> None:
    """The base installation prints the same, or refuses by name what an extra does."""
    (tmp_path / "robots").symlink_to(ROOT / "robots")
    for file, text in scene_files(name).items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    for example in block:
        if HUNDREDS_OF_MOTIONS.search(example.command):
            return
        done = _run(example.command, tmp_path, extras=False)
        if NEEDS_AN_EXTRA.search(example.command):
            assert done.returncode in (1, 2), done.stdout
            assert re.search(r"pip install '\.\[(fast|plot)\]'", done.stdout), done.stdout
            return  # what follows may read the file that was not written
        assert done.returncode == 0, done.stdout
        if COUNTS_THE_SERIES not in example.command:
            motions = "robodyn sweep" in example.command  # by DOP853 in place of the series
            assert_same(example.output, done.stdout, 1e-7 if motions else RELATIVE)


def _run(command: str, directory: Path, extras: bool = True) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["bash", "-o", "pipefail", "-c", command],
        cwd=directory,
        env=os.environ | {"PATH": path_with_it(extras), "LC_ALL": "C.UTF-8"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        timeout=120,
    )


@pytest.mark.parametrize(
    "block", [text for _, text in blocks("python")], ids=labels(blocks("python"))
)
def test_python_runs_and_prints_what_its_comments_say(
    block: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    exec(compile(block, "the guide", "exec", dont_inherit=True), {})
    shown = re.findall(r"^print\(.*\)  # (.*\n)", block, re.MULTILINE)
    assert block.count("print(") == len(shown)
    assert_same("".join(shown), capsys.readouterr().out)


def test_scenes_are_accepted(tmp_path: Path) -> None:
    scenes = blocks("yaml")
    assert scenes
    for k, (name, text) in enumerate(scenes):
        if text not in scene_files(name).values():  # those are read by the examples of their page
            scene = tmp_path / f"{k}.yaml"
            scene.write_text(text, encoding="utf-8")
            robodyn.load(scene)


def test_there_are_examples_of_every_kind() -> None:
    commands = [example.command for example in examples()]
    assert len(commands) >= 5
    assert blocks("python")
    assert any("| head" in command for command in commands)


def test_commands_are_documented_and_shown() -> None:
    table = README.split("\n## Commands\n")[1]
    shown = "\n".join(example.command for example in examples())
    assert [name for name in COMMANDS if not re.search(rf"`robodyn {name}[ `]", table)] == []
    assert [name for name in COMMANDS if f"robodyn {name} " not in shown] == []


def test_public_names_are_documented() -> None:
    names = robodyn._ROOM_OF
    assert [name for name in names if not re.search(rf"`{name}\b", PAGES["python"])] == []


def test_scene_keys_are_documented() -> None:
    keys = {key for form in FORMS.values() for key in form.keys}
    told = PAGES["scene"] + PAGES["drawn"]
    assert [key for key in keys if f"`{key}`" not in told] == []


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
    lines = [(name, line) for name, text in DOCUMENTS.items() for line in text.splitlines()]
    assert [(name, line) for name, line in lines if len(line) > 100] == []


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) <= 250


def anchor(heading: str) -> str:
    """What a link to a heading says, as on a repository's web page."""
    return re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")


@each("name", DOCUMENTS)
def test_links_lead_somewhere(name: str) -> None:
    folder = ROOT if name == "README" else GUIDE
    text = re.sub(r"^```.*?^```$", "", DOCUMENTS[name], flags=re.MULTILINE | re.DOTALL)
    targets = re.findall(r"\]\(([^)]+)\)", text) + re.findall(
        r"^\[[\w-]+\]: (\S+)", text, re.MULTILINE
    )
    for target in targets:
        if "://" in target:
            continue
        path, _, part = target.partition("#")
        there = folder / path if path else folder / f"{name}.md"
        assert there.exists(), target
        if part:
            headings = re.findall(r"^#+ (.+)$", there.read_text(encoding="utf-8"), re.MULTILINE)
            assert part in map(anchor, headings), target
