"""`robodyn guide`: its list is the folder, its pages are the files, and every help names one."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import Outcome
from documents import PAGES, ROOT
from each_case import each

from robodyn.cli import COMMANDS, guide

Run = Callable[..., Outcome]


def without_front(text: str) -> str:
    """A page less the comment that it may begin with."""
    first, _, rest = text.partition("\n\n")
    return rest if first.startswith("<!--") else text


def test_the_list_is_the_folder(robodyn: Run) -> None:
    rows = robodyn("guide").succeeds().rows
    assert sorted(row["page"] for row in rows) == sorted(PAGES)
    kinds = [row["kind"] for row in rows]
    assert kinds == sorted(kinds, key=guide.KINDS.index)
    assert set(kinds) == set(guide.KINDS)
    for row in rows:
        assert 20 < len(row["tells"]) < 200, row
        assert row["tells"].endswith("."), row
    assert robodyn("guide", "--format", "json").json == rows


@each("name", PAGES)
def test_a_page_is_its_file(robodyn: Run, name: str) -> None:
    shown = robodyn("guide", name).succeeds().out
    assert shown == without_front(PAGES[name])
    assert shown.startswith("# ")


def test_a_new_page_needs_no_entry_anywhere(
    robodyn: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guide, "FOLDER", tmp_path)
    (tmp_path / "new.md").write_text("# New things\n\nOne `word` and [a link](x.md). More.\n")
    (tmp_path / "bare.md").write_text("# Nothing more\n")
    (tmp_path / "marked.md").write_text("<!-- tutorial: draw,\n  plot -->\n\n# First\n\nGo.\n")
    assert robodyn("guide").rows == [
        {"page": "marked", "kind": "tutorial", "tells": "Go."},
        {"page": "bare", "kind": "how-to", "tells": "Nothing more"},
        {"page": "new", "kind": "how-to", "tells": "One word and a link."},
    ]
    assert guide.page_of("plot") == "marked"
    assert guide.page_of("new") == "new"
    assert guide.page_of("torque") == "commands"
    assert robodyn("guide", "draw").out == "# First\n\nGo.\n"


@each("command", COMMANDS)
def test_every_help_names_its_page(robodyn: Run, command: str) -> None:
    page = guide.page_of(command)
    assert page in PAGES
    assert robodyn(command, "--help").succeeds().out.endswith(f"  More: robodyn guide {page}\n")
    assert page == "commands" or re.search(rf"robodyn {command}\b|`{command}\b", PAGES[page])


def test_pages_name_commands_that_there_are() -> None:
    named = [command for page in guide.pages() for command in page.commands]
    assert sorted(named) == sorted(set(named))
    assert set(named) <= set(COMMANDS)


def test_a_terminal_has_a_pager_and_a_layout() -> None:
    ours, its = os.openpty()
    done = subprocess.Popen(
        [sys.executable, "-m", "robodyn", "guide", "exit-codes"],
        cwd=ROOT,
        stdin=its,
        stdout=its,
        stderr=its,
        env=os.environ | {"PAGER": "sed s/Exit/PAGED/", "TERM": "xterm", "COLUMNS": "80"},
    )
    os.close(its)
    shown = b""
    with contextlib.suppress(OSError):  # the end of a terminal is an error
        while part := os.read(ours, 4096):
            shown += part
    os.close(ours)
    assert done.wait(60) == 0
    assert b"PAGED codes and errors" in shown
    assert b"# PAGED" not in shown
    assert b"\x1b[" in shown


def test_what_is_built_has_the_guide_and_the_scenes(tmp_path: Path) -> None:
    """A wheel holds what build_py makes: all pages and scenes, and a command that shows them."""
    source, built = tmp_path / "source", tmp_path / "built"
    source.mkdir()
    shutil.copytree(
        ROOT / "robodyn", source / "robodyn", ignore=shutil.ignore_patterns("__pycache__")
    )
    (source / "robots").mkdir()
    for path in [*ROOT.glob("robots/*.yaml"), ROOT / "pyproject.toml", ROOT / "README.md"]:
        shutil.copy(path, source / path.relative_to(ROOT))
    make = "import warnings; warnings.simplefilter('ignore'); from setuptools import setup; setup()"
    command = [sys.executable, "-c", make, "--quiet", "build_py", "--build-lib", str(built)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    notebook, typed = ROOT / "robodyn/guide/notebook.ipynb", ROOT / "robodyn/py.typed"
    pages = [*ROOT.glob("robodyn/guide/*.md"), notebook, typed]
    for path in [*pages, *ROOT.glob("robodyn/**/*.py")]:
        assert (built / path.relative_to(ROOT)).read_bytes() == path.read_bytes()
    for path in ROOT.glob("robots/*.yaml"):
        assert (built / "robodyn" / path.relative_to(ROOT)).read_bytes() == path.read_bytes()
    shown = subprocess.run(
        [sys.executable, "-m", "robodyn", "guide", "scene"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(built)},
        capture_output=True,
        encoding="utf-8",
    )
    assert shown.stdout == without_front(PAGES["scene"])
