"""Files of rows, opened: with whatever delimiter, from stdin too."""

from __future__ import annotations

import sys
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from typing import TYPE_CHECKING, BinaryIO, cast

from robodyn.cli.output import note
from robodyn.errors import InputError, named_options
from robodyn.tables.csv_fields import Delimited, shown
from robodyn.tables.input_file import read_bounded, read_regular
from robodyn.tables.table import Reader

if TYPE_CHECKING:
    from robodyn.tables.arrays import Array


def read_columns(
    file: str,
    choose: Callable[[Sequence[str], str], Sequence[str]],
    lengths: Container[str] = (),
    read: str | None = None,
) -> tuple[Array, Sequence[str], str, list[int]]:
    """Return columns (T, k) of a CSV file, their names, the file's name, and its lines (T,).

    `choose` tells the columns by the header and the file's name, the others are as of `open_rows`.
    A file without rows is an InputError.
    """
    import numpy as np

    with open_rows(file, lengths, read) as reader:
        name = reader.source
        names = choose(reader.names, name)
        chunks = list(reader.chunks(names))
    if not chunks:
        raise InputError("no rows", where=name, limit="the header is followed by no row")
    lines = list(chain(*(chunk.line_numbers for chunk in chunks)))
    return np.concatenate([chunk.values for chunk in chunks]), names, name, lines


@contextmanager
def open_rows(file: str, lengths: Container[str] = (), read: str | None = None) -> Iterator[Reader]:
    """The reader of a CSV file, `-` for stdin, with the names that --read (`read`) gives.

    `lengths` are columns that are no angles in degrees.
    """
    with open_input(file) as (stream, name):
        with named_options(["read"]):
            reader = Reader(stream, name, lengths, renamed=_renamed(read))
        yield reader


def _renamed(read: str | None) -> dict[str, str]:
    """The names that --read gives to columns, by the names that they have."""
    found: dict[str, str] = {}
    for pair in [] if read is None else read.split(","):
        new, equals, old = (part.strip() for part in pair.partition("="))
        if not (new and equals and old) or old in found or new in found.values():
            limit = "write NEW=OLD, each name once, such as q1=pos1,qd1=vel1"
            raise InputError("read", value=shown(pair) or "''", limit=limit)
        found[old] = new
    return found


@contextmanager
def open_input(states: str) -> Iterator[tuple[BinaryIO, str]]:
    """The binary stream and the name of a CSV file, `-` for stdin; its rows with commas."""
    with open_file(states) as (stream, name):
        yield cast(BinaryIO, Delimited(stream)), name


@contextmanager
def open_file(states: str) -> Iterator[tuple[BinaryIO, str]]:
    """The binary stream and the name of a file as it is, `-` for stdin."""
    if states == "-":
        if sys.stdin is None:
            raise InputError("is closed", where="stdin")
        if sys.stdin.isatty():
            note("reading CSV rows from the keyboard; end with Ctrl-D")
        yield sys.stdin.buffer, "stdin"
        return
    try:
        stream = open(states, "rb")  # noqa: SIM115 (closed by the with below)
    except (OSError, ValueError) as error:
        raise _unreadable(states, error) from None
    with stream:
        yield stream, states


def read_file(name: str) -> tuple[bytes, str]:
    """All bytes of a regular file, or of stdin for `-`, and its name; InputError beyond 16 MiB."""
    try:
        if name != "-":
            return read_regular(name), name
        with open_file(name) as (stream, told):
            return read_bounded(stream), told
    except (OSError, ValueError) as error:
        raise _unreadable("stdin" if name == "-" else name, error) from None


def _unreadable(name: str, error: OSError | ValueError) -> InputError:
    reason = getattr(error, "strerror", None) or str(error)
    return InputError("cannot be read", where=name, limit=reason[:1].lower() + reason[1:])
