"""The guide is true: its tables of rooms and of rows, and the files that it and the code name."""

from __future__ import annotations

import ast
import inspect
import math
import re
import tomllib
from collections.abc import Iterator
from typing import get_args

from documents import PAGES, README, ROOT, rows_below

from robodyn.elements.program import Row

PACKAGE = ROOT / "robodyn"
GUIDE = PAGES["how-it-works"]
SOURCES = sorted(PACKAGE.rglob("*.py"))
# the imports upwards, which the guide tells
UPWARDS = {
    ("planar_model.py", "notebook"),
    ("simulation.py", "notebook"),
}


def storeys() -> dict[str, int]:
    """The storey of each room."""
    table = rows_below(GUIDE, "| storey | room | what is in it |")
    return {room.strip("`"): int(storey) for storey, room, _ in table}


def imported_rooms(tree: ast.AST) -> Iterator[str]:
    """The rooms that a module imports from, wherever it does, but for types."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("robodyn"):
            names = [node.module or ""]
            if node.module == "robodyn":
                names = [f"robodyn.{alias.name}" for alias in node.names]
            yield from (name.split(".")[1] for name in names)
        yield from imported_rooms(node)


def files_named(text: str) -> set[str]:
    """What stands in backticks and ends in .py."""
    return set(re.findall(r"`([\w/]+\.py)`", text))


def unknown_files(text: str) -> set[str]:
    """Those of them that do not exist, or stand in several rooms."""
    paths = [f"/{path.relative_to(PACKAGE).as_posix()}" for path in SOURCES]
    return {
        name for name in files_named(text) if sum(path.endswith(f"/{name}") for path in paths) != 1
    }


def test_every_room_is_listed() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert set(storeys()) == folders
    table = rows_below(GUIDE, "| storey | room | what is in it |")
    assert [int(row[0]) for row in table] == sorted(storeys().values(), reverse=True)


def test_imports_run_downwards() -> None:
    levels = storeys()
    found = set()
    for path in SOURCES:
        room = path.parent.name
        for other in imported_rooms(ast.parse(path.read_text(encoding="utf-8"))):
            if room != other and levels.get(other, -1) >= levels.get(room, math.inf):
                found.add((path.name, other))
    assert found == UPWARDS
    for name, room in UPWARDS:
        assert re.search(rf"`{name}`[^.]*`{room}`", GUIDE)


def test_the_rows_are_those_of_the_program() -> None:
    told = {name.strip("`"): text for name, text in rows_below(GUIDE, "| row | is |")}
    documented = {}
    for row in get_args(Row):
        first, _, _ = (inspect.getdoc(row) or "").partition("\n\n")
        documented[row.__name__] = first.replace("\n", " ")
    assert list(told.items()) == list(documented.items())


def test_the_files_of_the_guide_exist() -> None:
    assert len(files_named(GUIDE)) > 20
    assert unknown_files(GUIDE) == set()


def test_files_that_the_code_names_exist() -> None:
    for path in SOURCES:
        assert unknown_files(path.read_text(encoding="utf-8")) == set(), path


def test_the_wheel_holds_every_room() -> None:
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    held = {"robodyn", "robodyn.robots", *(f"robodyn.{room}" for room in rooms)}
    assert sorted(tool["setuptools"]["packages"]) == sorted(held)


def test_the_wheel_holds_the_guide() -> None:
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    patterns = tool["setuptools"]["package-data"]["robodyn"]
    held = {path for pattern in patterns for path in PACKAGE.glob(pattern)}
    assert PACKAGE / "guide" / "how-it-works.md" in held


def test_the_readme_links_to_the_guide() -> None:
    assert "](robodyn/guide/how-it-works.md)" in README
