"""Input that is refused: a table a command in tests/refusals/, a row a case.

A row is `ARGUMENTS <<< STDIN => WORDS`: as in a shell, but that escapes (\\n) are understood; the
message holds the words in their order, anything being between them where `...` stands.  A line
`[ARGUMENTS <<< STDIN]` begins all rows below it, up to the next one; `@NAME: TEXT` is a file that
lies where the command runs.  The rows of scenes.txt are `OLD -> NEW => WORDS`, a change of the
scene named above them.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from conftest import ROOT, Outcome

FOLDER = ROOT / "tests/refusals"
COMMANDS = sorted(path.stem for path in FOLDER.glob("*.txt") if path.stem != "scenes")


class Row(NamedTuple):
    """One case: what is given and what is told."""

    arguments: list[str]
    stdin: str
    words: str


class Table(NamedTuple):
    """The cases of one command, and the files that they name."""

    files: dict[str, bytes]
    rows: list[Row]


def unescaped(text: str) -> str:
    return re.sub(r"\\(x..|u....|.)", lambda x: x[0].encode().decode("unicode_escape"), text)


def given(text: str) -> tuple[list[str], str]:
    """The arguments, and stdin, of a line."""
    arguments, _, stdin = f" {text} ".partition(" <<< ")
    return shlex.split(unescaped(arguments)), unescaped(stdin[:-1])


def table_of(command: str) -> Table:
    found, before, stdin = Table({}, []), [], ""
    for line in (FOLDER / f"{command}.txt").read_text().splitlines():
        if line.startswith("@"):
            name, _, text = line[1:].partition(": ")
            found.files[name] = contents_of(unescaped(text))
        elif line.startswith("["):
            before, stdin = given(line[1:-1])
        elif line and not line.startswith("#"):
            text, arrow, words = f" {line}".partition(" => ")
            assert arrow, line
            own, rows = given(text)
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


@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_refused(
    robodyn: Callable[..., Outcome], tmp_path: Path, monkeypatch: Any, command: str
) -> None:
    table = table_of(command)
    monkeypatch.chdir(tmp_path)
    for name, text in table.files.items():
        (tmp_path / name).write_bytes(text)
    faults = []
    for row in table.rows:
        kept = contents(tmp_path)
        done = robodyn(command, *row.arguments, stdin=row.stdin.encode("latin-1"))
        fault = fault_of(row, done)
        if contents(tmp_path) != kept:
            fault += "a file has changed"
        if fault:
            faults += [f"{fault}: {shlex.join(row.arguments)} <<< {row.stdin!r} => {row.words}"]
            faults += [done.out[:100], done.err]
    assert not faults, "\n".join(faults)
