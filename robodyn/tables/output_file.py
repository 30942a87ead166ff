"""Output files that take their place whole, or not at all."""

from __future__ import annotations

import io
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from io import BufferedIOBase
from typing import TYPE_CHECKING, BinaryIO, cast

from robodyn.errors import InputError, RobodynError, printable_lines

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

    Opener = Callable[[str, int], int]


class NamedFile(io.FileIO):
    """A file that is told by `shown` where a write fails, as on a full disk."""

    def __init__(self, path: str, mode: str, shown: str, opener: Opener | None = None) -> None:
        super().__init__(path, mode, opener=opener)
        self._shown = shown

    def write(self, data: ReadableBuffer, /) -> int:
        try:
            return super().write(data)
        except OSError as error:  # of a write, which knows no name
            raise OSError(error.errno, error.strerror, self._shown) from None


@contextmanager
def open_output(
    path: str | os.PathLike[str] | None,
    partial: Callable[[str], object] | None = None,
    styled: bool = False,
) -> Iterator[BinaryIO]:
    """A binary stream to a file that takes its place, whole, when the block ends well.

    Where the block raises, an older file stays as it was; what was written is removed, or, with
    `partial`, kept under the first free name of PATH.partial, PATH.partial.1, ..., which `partial`
    is told.  None and "-" are the standard output; a device or a pipe is written as it stands.  A
    terminal is shown what it would obey written out, unless the output is `styled`, made for a
    terminal.  Raises InputError where the file cannot be created.
    """
    if path is None or os.fspath(path) == "-":
        raw = on_terminal(None) and not styled
        if sys.__stdout__ is None:
            raise RobodynError("stdout is closed", limit="results have no place to go: give -o")
        yield cast(BinaryIO, _Terminal()) if raw else sys.stdout.buffer
        sys.stdout.buffer.flush()
        return
    shown = os.fspath(path)
    target = os.path.realpath(path)  # a link stays, the file that it names is replaced
    temporary = os.path.join(os.path.dirname(target), f".robodyn-{os.urandom(8).hex()}.tmp")
    is_file = os.path.isfile(path)
    in_place = os.path.exists(path) and not is_file
    with ExitStack() as cleanup:
        if not in_place:
            cleanup.callback(_remove, temporary)
        try:
            if is_file:
                os.close(os.open(path, os.O_WRONLY))  # a read-only file is not to be replaced
            if not os.path.basename(path):
                raise OSError("it names no file")
            mode, name = ("wb", shown) if in_place else ("xb", temporary)
            stream = io.BufferedWriter(NamedFile(name, mode, shown))
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise InputError("cannot be written", where=shown, limit=reason) from error
        cleanup.callback(close_quietly, stream)
        if is_file:
            shutil.copymode(target, temporary)
        try:
            yield stream
            stream.flush()
            if not in_place:
                check_same(temporary, stream)
            stream.close()
            if not in_place:
                os.replace(temporary, target)
        except BaseException:
            keeps = partial is not None and not in_place
            if keeps and not stream.closed:
                check_same(temporary, stream)
            close_quietly(stream)
            if partial is not None and keeps and os.path.getsize(temporary):
                kept = _first_free(f"{target}.partial")
                os.replace(temporary, kept)
                partial(kept)
            raise


def check_same(path: str, stream: BinaryIO) -> None:
    """Raise RobodynError if `path` no longer names the file that is open as `stream`."""
    with suppress(FileNotFoundError):
        if os.path.samestat(os.lstat(path), os.fstat(stream.fileno())):
            return
    raise RobodynError("was removed or replaced while it was written", where=path)


def _first_free(path: str) -> str:
    """Create an empty file at `path`, else at the first free of PATH.1, PATH.2, ...; its name."""
    name, number = path, 0
    while True:
        try:
            os.close(os.open(name, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        except FileExistsError:
            number += 1
            name = f"{path}.{number}"
        else:
            return name


def write_text(text: str, path: str | None) -> None:
    """Write a file of text, whole or not at all, as `open_output`."""
    with open_output(path) as stream:
        stream.write(text.encode())


def close_quietly(stream: BinaryIO) -> None:
    """Close after a failure: what waits to be written to a full disk fails again, untold."""
    with suppress(OSError):
        stream.close()


def _remove(path: str) -> None:
    with suppress(FileNotFoundError, NotADirectoryError):
        os.unlink(path)


def on_terminal(path: str | None) -> bool:
    """Whether an output goes to a terminal."""
    return path in (None, "-") and sys.stdout.isatty()


class _Terminal(BufferedIOBase):
    """The standard output for data that may hold what a terminal would obey."""

    def write(self, data: ReadableBuffer) -> int:
        text = bytes(data).decode(errors="surrogateescape")
        return sys.stdout.buffer.write(printable_lines(text).encode())

    def flush(self) -> None:
        sys.stdout.buffer.flush()
