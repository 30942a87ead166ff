"""Input that is refused: a table a command in tests/refusals/, a row a case.

A row is `ARGUMENTS <<< STDIN => WORDS`: as in a shell, but that escapes (\\n) are understood; the
message holds the words in their order, anything being between them where `...` stands.  A line
`[ARGUMENTS <<< STDIN]` begins all rows below it, up to the next one; `@NAME: TEXT` is a file that
lies where the command runs; a line that begins with two spaces goes on.  The rows of scenes.txt
are `OLD -> NEW => WORDS`, a change of the
scene named above them.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import good_scenes
import pytest
from conftest import ROOT, Outcome

from robodyn import cli

FOLDER = ROOT / "tests/refusals"
TABLES = sorted(path.stem for path in FOLDER.glob("*.txt") if path.stem != "scenes")
NUMBERS = {"VECTOR", "N", "S", "HZ", "K"}  # what stands in the help for options of numbers
# what a command that writes is given to write over, beside what its row has
OLDER = {"animate": "older.gif", "draw": "older.svg", "plot": "older.svg"}


class Row(NamedTuple):
    """One case: what is given and what is told."""

    arguments: list[str]
    stdin: str
    words: str


class Table(NamedTuple):
    """The cases of one command, and the files that they name."""

    files: dict[str, bytes]
    rows: list[Row]


def lines_of(name: str) -> list[str]:
    """The lines of a table, those that go on put together, without remarks."""
    lines = (FOLDER / f"{name}.txt").read_text().replace("\n  ", " ").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def unescaped(text: str) -> str:
    return re.sub(r"\\(x..|u....|.)", lambda x: x[0].encode().decode("unicode_escape"), text)


def given(text: str) -> tuple[list[str], str]:
    """The arguments, and stdin, of a line."""
    arguments, _, stdin = f" {text} ".partition(" <<< ")
    return shlex.split(unescaped(arguments)), unescaped(stdin[:-1])


def table_of(command: str) -> Table:
    found, before, stdin = Table({}, []), [], ""
    for line in lines_of(command):
        if line.startswith("@"):
            name, _, kept = line[1:].partition(": ")
            found.files[name] = contents_of(unescaped(kept))
        elif line.startswith("[") and " => " not in line:
            before, stdin = given(line[1:-1])
        else:
            case, arrow, words = f" {line}".partition(" => ")
            assert arrow, line
            own, rows = given(case)
            found.rows.append(Row([*before, *own], rows or stdin, unescaped(words)))
    return found


def contents_of(text: str) -> bytes:
    """What a file holds; `%NAME:OLD>NEW` is an example with a change."""
    if not text.startswith("%"):
        return text.encode("latin-1")
    name, _, change = text[1:].partition(":")
    scene = (ROOT / f"robots/{name}.yaml").read_text()
    old, _, new = change.partition(">")
    assert old in scene
    return scene.replace(old, new, 1).encode() if change else scene.encode()


def scenes() -> Iterator[tuple[str, str]]:
    """Scenes that are refused, and the words of the refusal."""
    bases, base = {"ARM": good_scenes.ARM, "LOOP": good_scenes.LOOP, "": ""}, ""
    for line in lines_of("scenes"):
        if line.startswith("@"):
            name, _, text = line[1:].partition(": ")
            bases[name] = unescaped(text)
        elif " => " not in line:
            base = bases[line[1:-1]]
        else:
            change, _, words = f" {line}".partition(" => ")
            old, arrow, new = change.partition(" -> ")
            assert arrow, line
            old = unescaped(old[1:])
            assert not old or base.count(old) == 1, line
            text = base.replace(old, unescaped(new)) if old else base + unescaped(new)
            yield text, words


def pattern(words: str) -> str:
    return ".*".join(re.escape(part) for part in words.split(" ... "))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def fault_of(row: Row, done: Outcome) -> str:
    """What is wrong with a refusal, or nothing."""
    if done.code != 2:
        return f"exit code {done.code}"
    if not re.search(pattern(row.words), done.err, re.DOTALL):
        return "other words"
    told = [line for line in done.err.splitlines() if not line.startswith("Note: ")]
    if done.err.count("Error: ") != 1 or not told[0].startswith(("Error: ", "Usage: ")):
        return "not one error"
    if re.search(r"Traceback|defect|File \"|RuntimeWarning", done.err):
        return "a traceback"
    if not re.sub(r"[\n\t]", "", done.err).isprintable():
        return "control characters"
    # what streams has delivered the header and the rows before a bad one
    line = re.search(r"(?:line (\d+)|no rows): ", done.err)
    if done.out.count("\n") > (int(line[1] or 2) - 1 if line else 0):
        return "something on stdout"
    return ""


def writes(command: str) -> bool:
    return any("--out" in x.opts for x in parameters(command))


@cache
def parameters(command: str) -> list[Any]:
    group = cli._command([command], False)
    return group.commands[command].params if command in cli.COMMANDS else []


def can_write_over(command: str, row: Row) -> bool:
    """Whether `-o` can be added to a row."""
    told = f"{shlex.join(row.arguments)} {row.words}"
    return writes(command) and not re.search("-o |--out|an argument", told)


@pytest.mark.parametrize("command", TABLES)
def test_what_is_refused(
    robodyn: Callable[..., Outcome], tmp_path: Path, monkeypatch: Any, command: str
) -> None:
    table = table_of(command)
    monkeypatch.chdir(tmp_path)
    older = OLDER.get(command, "older")
    for name, text in {older: b"older", **table.files}.items():
        (tmp_path / name).write_bytes(text)
    before = [] if command == "robodyn" else [command]
    faults = []
    for row in table.rows:
        kept = contents(tmp_path)
        over = can_write_over(command, row)
        plain = not over or row.stdin or "-" in row.arguments  # rows of a stream may go out
        for more in ([[]] if plain else []) + ([["-o", older]] if over else []):
            stdin = row.stdin.encode("latin-1")
            done = robodyn(*before, *row.arguments, *more, stdin=stdin)
            fault = fault_of(row, done)
            if contents(tmp_path) != kept:
                fault += "a file has changed"
            if fault:
                told = f"{shlex.join([*row.arguments, *more])} <<< {row.stdin!r}"
                faults += [f"{fault}: {told} => {row.words}", done.out[:100], done.err]
    assert not faults, "\n".join(faults)


def test_scenes_that_are_refused(
    robodyn: Callable[..., Outcome], tmp_path: Path, monkeypatch: Any
) -> None:
    """Each fault is told once, with its line, field, value and limit."""
    monkeypatch.chdir(tmp_path)
    told = []
    for text, words in scenes():
        (tmp_path / "scene.yaml").write_text(text)
        done = robodyn("check", "scene.yaml")
        fault = fault_of(Row([], "", words), done)
        if done.err.count("scene.yaml:") != 1 + words.count(" ... "):
            fault += "more or less than one fault"
        told += [f"{fault}: {text}\n{words}\n{done.err}"] if fault else []
    assert not told, "\n".join(told)


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_command_has_its_table(command: str) -> None:
    """With an option's unknown value, a number that is none, a missing file, an older output."""
    (files, rows), own = table_of(command), parameters(command)
    lacks = []
    if any(hasattr(x.type, "choices") for x in own):
        lacks += [] if any("is not one of" in x.words for x in rows) else ["an unknown value"]
    if NUMBERS & {x.metavar for x in own}:
        lacks += [] if any("nan" in " ".join(x.arguments) for x in rows) else ["nan"]
    if {"model", "states", "data", "files"} & {x.name for x in own}:
        lacks += [] if any("no such file" in x.words for x in rows) else ["a missing file"]
    if writes(command):
        named = [y for x in rows for o, y in pairwise(x.arguments) if o == "-o" and y in files]
        over = named or any(can_write_over(command, row) for row in rows)
        lacks += [] if over else ["an older output"]
    assert not lacks
