"""`robodyn guide`: the pages of the guide, in a shell.

A page is a Markdown file of robodyn/guide/.  Its first line may be a comment that tells what kind
it is and which commands name it in their help: `<!-- reference: plot, draw -->`.  Its summary is
the first sentence below its heading.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Annotated, NamedTuple

from typer import Argument

from robodyn.cli.options import OutputFormat, Text, refuse
from robodyn.cli.output import row_writer
from robodyn.errors import InputError
from robodyn.scene.yaml_values import nearest
from robodyn.tables.output_file import on_terminal

FOLDER = Path(__file__).resolve().parent.parent / "guide"
KINDS = ("tutorial", "how-to", "reference", "background")  # as they are listed
WIDEST = 100  # characters of a line, as in the pages
_FRONT = re.compile(r"<!-- *([\w-]+)(?:: *([\w,\s]+?))? *-->\n+")


class Page(NamedTuple):
    """A page of the guide."""

    name: str
    kind: str
    commands: tuple[str, ...]  # whose help names it
    text: str

    @property
    def summary(self) -> str:
        """The first sentence below the heading, or the heading."""
        heading, _, rest = self.text.partition("\n")
        paragraph = " ".join(rest.strip().partition("\n\n")[0].split())
        plain = re.sub(r"\[(.+?)\]\(.+?\)|`", r"\1", paragraph)
        sentence = re.match(r"\w.*?[.?!](?= |$)", plain)
        return sentence[0] if sentence else heading.lstrip("# ")


def pages() -> list[Page]:
    """All pages, by kind and name."""
    found = []
    for path in FOLDER.glob("*.md"):
        text = path.read_text(encoding="utf-8")
        front = _FRONT.match(text)
        kind = front[1] if front and front[1] in KINDS else "how-to"
        commands = tuple((front[2] or "").replace(",", " ").split()) if front else ()
        found.append(Page(path.stem, kind, commands, text[front.end() if front else 0 :]))
    return sorted(found, key=lambda page: (KINDS.index(page.kind), page.name))


def page_of(command: str) -> str:
    """The name of the page that tells of a command."""
    told = pages()
    of_command = (page.name for page in told if command in page.commands)
    return next(of_command, command if command in [page.name for page in told] else "commands")


def _names() -> list[str]:
    return [page.name for page in pages()]


def guide(
    page: Annotated[
        Text, Argument(metavar="PAGE", help="Its name, such as scene.", autocompletion=_names)
    ] = None,
    format: OutputFormat = None,
) -> None:
    """The pages of the guide, or one of them.

    Without PAGE they are listed.  A page is laid out on a terminal, where a pager shows it, and is
    plain Markdown in a pipe.  The name of a command shows the page that tells of it; any other
    word is looked for in the pages.

    \b
    Examples:
      robodyn guide
      robodyn guide scene
      robodyn guide simulate | grep -A 5 Accuracy
    """
    told = pages()
    if page is None:
        with row_writer(format, None, ["page", "kind", "tells"]) as writer:
            for each in told:
                writer.write_row([each.name, each.kind, each.summary])
        return
    refuse("is for the list", format=format)
    texts = {command: each.text for each in told for command in each.commands}
    text = (texts | {each.name: each.text for each in told}).get(page)
    if text is None:
        raise InputError("PAGE", value=page, limit=_near(page, told))
    if on_terminal(None):
        _show(text)
    else:
        sys.stdout.write(text)


def _near(word: str, told: list[Page]) -> str:
    """Return page names similar to `word`, or the pages that contain it."""
    whole = re.compile(rf"\b{re.escape(word)}\b", re.IGNORECASE)
    hold = [page.name for page in told if whole.search(page.text)]
    if hold:
        return f"is no page, but stands in {', '.join(hold)}"
    names = [page.name for page in told]
    close = nearest(word, names).partition("; known")[0]
    return f"is no page{close}" if close else f"must be one of {', '.join(names)}"


def _show(text: str) -> None:
    """The page on the terminal, through the pager where there is one."""
    from rich.console import Console
    from rich.markdown import Markdown

    os.environ.setdefault("LESS", "FRX")  # it passes colours, and ends by itself on a short page
    console = Console()
    console.width = min(console.width, WIDEST)
    with console.pager(styles=True):
        console.print(Markdown(text, code_theme="ansi_light", hyperlinks=False))
