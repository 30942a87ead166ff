"""The README and the pages of the guide, whichever there are, and what stands in their blocks."""

from __future__ import annotations

import re
import shlex
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
GUIDE = ROOT / "robodyn" / "guide"
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in sorted(GUIDE.glob("*.md"))}
DOCUMENTS = {"README": README} | PAGES
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Example(NamedTuple):
    """A command and what it prints."""

    command: str
    output: str


def blocks(*languages: str) -> list[tuple[str, str]]:
    """The document and the text of each fenced block in these languages."""
    return [
        (name, text)
        for name, document in DOCUMENTS.items()
        for language, text in _FENCE.findall(document)
        if language in languages
    ]


def is_whole(command: str) -> bool:
    """Whether a command ends here: no backslash at its end, no quotation that is open."""
    with suppress(ValueError):
        shlex.split(command)
        return not command.endswith("\\\n")
    return False


def example_blocks() -> list[tuple[str, list[Example]]]:
    """The document and the commands of each console block, each with the output below it."""
    found: list[tuple[str, list[Example]]] = []
    for name, block in blocks("console", "sh"):
        commands = []
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            lines = part.splitlines(keepends=True)
            end = next(k for k in range(1, len(lines) + 1) if is_whole("".join(lines[:k])))
            commands.append(Example("".join(lines[:end]), "".join(lines[end:])))
        found.append((name, commands))
    return found


def scene_files(name: str) -> dict[str, str]:
    """The scenes of a document whose first line, a comment, names a file."""
    found = {}
    for document, text in blocks("yaml"):
        first = re.match(r"# (\S+\.yaml)\n", text)
        if document == name and first:
            found[first[1]] = text
    return found


def rows_below(document: str, header: str) -> list[list[str]]:
    """The cells of the table with this header."""
    lines = document.split(header + "\n")[1].split("\n\n")[0].splitlines()[1:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
