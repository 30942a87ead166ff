"""`robodyn init`: a scene to start from."""

from __future__ import annotations

import os
import shlex
from typing import Annotated

from typer import Argument, Option

from robodyn.cli.files import output_file
from robodyn.cli.options import OutputFormat, Text, option, refuse, switch
from robodyn.cli.output import note, row_writer
from robodyn.errors import InputError
from robodyn.scene.example_scenes import (
    example_options,
    scene_names,
    scene_table,
    scene_text,
    summary,
)
from robodyn.tables.output_file import write_text

_NAME = "Of the scene, such as four-bar."
_OUT = "Write here, - for stdout. Default: NAME.yaml, or pmks.yaml, in this directory."
_PMKS = "A PMKS+ mechanism: its address, what stands after ? there, or a file that has it."


def init(
    name: Annotated[Text, Argument(metavar="NAME", help=_NAME, autocompletion=scene_names)] = None,
    names: bool = option("List the names, as without NAME.", default=False, flag="--list"),
    from_pmks: Annotated[Text, Option("--from-pmks", metavar="TEXT", help=_PMKS)] = None,
    out: Annotated[Text, output_file("--out", "-o", help=_OUT)] = None,
    force: bool = switch("Replace a file that exists."),
    format: OutputFormat = None,
) -> None:
    """Write a commented scene to start from.

    Without NAME the scenes are listed: an arm, a four-bar, a slider-crank and others.  A file
    that exists is replaced with --force only, and a table that the scene reads is written beside
    it.  A mechanism of PMKS+ becomes a scene as drawn; its
    address holds all of it, and nothing is fetched.

    \b
    Examples:
      robodyn init
      robodyn init four-bar -o my.yaml
      robodyn init --from-pmks "https://...?0P.TY.K,..." -o my.yaml
    """
    if from_pmks is not None:
        if name is not None or names:
            raise InputError("--from-pmks", limit="goes without NAME and --list")
        refuse("is for the list", format=format)
        _write_pmks(from_pmks, "pmks.yaml" if out is None else out, force)
        return
    if name is None or names:
        if name is not None or out is not None:
            raise InputError("--list", limit="goes without NAME and --out")
        with row_writer(format, None, ["name", "scene"]) as writer:
            for each in scene_names():
                writer.write_row([each, summary(scene_text(each))])
        return
    refuse("is for the list", format=format)
    text = scene_text(name)
    path = f"{name}.yaml" if out is None else out
    table = scene_table(name)
    beside = "" if table is None else os.path.join(os.path.dirname(path), table[0])
    for each in (path, beside):
        _check_new(each, force)
    write_text(text, path)
    if table is not None and path != "-":
        write_text(table[1], beside)
        note(f"wrote {beside}, the table of the scene")
    if path != "-":
        note(f"wrote {path}; try: robodyn terms {shlex.quote(path)} {example_options(text)}")


def _check_new(path: str, force: bool) -> None:
    if os.path.isfile(path) and not force:
        raise InputError("exists already", where=path, limit="give --force to replace it, or --out")


def _write_pmks(given: str, path: str, force: bool) -> None:
    """Write the scene of a PMKS+ mechanism, once it is read without a fault."""
    from robodyn.export.pmks import scene_from, text_from
    from robodyn.scene.description import from_text

    text, left_out = scene_from(text_from(given))
    _check_new(path, force)
    from_text(text, path)
    for each in left_out:
        note(f"Note: {each} is not known, and left out")
    write_text(text, path)
    if path != "-":
        note(f"wrote {path}; try: robodyn draw {shlex.quote(path)} -o picture.svg")
