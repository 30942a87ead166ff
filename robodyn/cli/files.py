"""The options and arguments that name files: each is declared here as read or as written.

One guard holds for all of them, and for the tables that scenes name: nothing that a command writes
takes the place of what it reads, or of what else it writes, by whatever name.
"""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from robodyn.errors import InputError

if TYPE_CHECKING:
    from robodyn.mechanics.mechanism import Mechanism
    from robodyn.scene.scene import Description

_DECLARED = "robodyn.files"


def rows_argument(metavar: str, help: str) -> Any:
    """An argument that is a CSV file to read."""
    return typer.Argument(metavar=metavar, help=help, callback=_reads(metavar.strip(".")))


def input_file(flag: str, help: str) -> Any:
    """An option that is a file to read."""
    return typer.Option(flag, metavar="FILE", help=help, callback=_reads(flag))


def model_argument(help: str) -> Any:
    """The argument that is a scene: a file, or where there is none the name of an example."""
    reads = _reads("MODEL")
    return typer.Argument(metavar="MODEL", help=help, callback=reads, parser=scene_file)


def model_file(flag: str, help: str) -> Any:
    """An option that is a scene, as `model_argument`."""
    return typer.Option(flag, metavar="FILE", help=help, callback=_reads(flag), parser=scene_file)


def scene_file(name: str) -> str:
    """Return the scene's file: as it is named, else that of the example of this name.

    The latter is noted for who types at a terminal, by the first command of a pipe alone.
    """
    if os.path.lexists(name):
        return name
    from robodyn.scene.example_scenes import example_file

    example = example_file(name)
    if example is None:
        return name
    if sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty():
        from robodyn.cli.output import note

        note(f"Note: {name} is no file: the example scene of this name is taken")
    return str(example)


def load_scene(name: str) -> Mechanism:
    """The mechanism of a scene file; raises as `read_scene`."""
    from robodyn.mechanics.mechanism import build

    return build(read_scene(name))


def read_scene(name: str) -> Description:
    """The scene file; InputError if one of its tables is an output of the command.

    Raises DescriptionError for a faulty scene.
    """
    from robodyn.scene.description import read
    from robodyn.scene.scene import Table, signals_of

    scene = read(name)
    for place, signal in signals_of(scene):
        if isinstance(signal, Table):
            path = str(Path(name).parent / signal.file)
            _add(_declared.get([]), _File(place, path, False, _places(path, 0)))
    return scene


def output_file(*flags: str, help: str) -> Any:
    """An option that is a file to write."""

    def writes(ctx: typer.Context, param: typer.CallbackParam, value: Any) -> Any:
        if named(value) is not None or param.name == "out":  # which is stdout where it is left out
            name = value or "-"
            _declare(ctx, _File(flags[0], name, True, _places(name, 1)))
        return value

    return typer.Option(*flags, metavar="FILE", help=help, callback=writes)


def named(value: str | None) -> str | None:
    """A name as it is; an empty one is a usage error."""
    if value == "":
        raise typer.BadParameter("is empty: name a file")
    return value


class _File(NamedTuple):
    option: str  # --out, or MODEL
    name: str
    written: bool
    places: frozenset[object]


def _reads(option: str) -> Callable[..., Any]:
    """Make the callback of an option or argument that names a file to read, or several."""

    def reads(ctx: typer.Context, value: Any) -> Any:
        for name in value if isinstance(value, list | tuple) else [value]:
            if named(name) is not None:
                _declare(ctx, _File(option, name, False, _places(name, 0)))
        return value

    return reads


def _places(name: str, standard: int) -> frozenset[object]:
    """Return identifiers of an output: its path, and the existing file behind it.

    A device has none. "-" is the stream `standard`.
    """
    try:
        path = f"stream {standard}" if name == "-" else os.path.realpath(name)
        status = os.fstat(standard) if name == "-" else os.stat(path)
    except FileNotFoundError:
        return frozenset([path])
    except (OSError, ValueError):  # which is told when it is opened
        return frozenset()
    if stat.S_ISREG(status.st_mode):
        return frozenset([path, (status.st_dev, status.st_ino)])
    return frozenset([path] if name == "-" else [])


_declared: ContextVar[list[_File]] = ContextVar("declared")  # of the command that runs


def _declare(ctx: typer.Context, file: _File) -> None:
    """Add a file to those of the command; raises as `_add`."""
    if _DECLARED not in ctx.meta:
        _declared.set(ctx.meta.setdefault(_DECLARED, []))
    _add(_declared.get(), file)


def _add(known: list[_File], file: _File) -> None:
    """Add `file`; raise InputError if it and a known one exclude each other."""
    for other in known:
        if (file.written or other.written) and file.places & other.places:
            first, second = (file, other) if file.written else (other, file)
            if first.option == "--out" and second.written:
                first, second = second, first
            limit = f"would write over {second.option} ({second.name}): name another file"
            raise InputError(first.option, value=first.name, limit=limit)
    known.append(file)
